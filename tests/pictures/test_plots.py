"""Plots: the curves are the thesis' quantities in the thesis' colours, and files are whole or absent."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from analytic_runs import TILT, cone_run, planar_scene, run_of, two_masses

from tensegrity_mj.errors import OptionError
from tensegrity_mj.pictures import palette
from tensegrity_mj.pictures.plots import (
    plot_comparison,
    plot_coordinates,
    plot_errors,
    plot_paths,
    plot_run,
    save_figure,
)
from tensegrity_mj.runs.comparison import compare


def panels_of(figure):
    """Rows of the panels."""
    return [list(part.axes) for part in figure.subfigs]


def curve(panel, label):
    return next(line for line in panel.lines if line.get_label() == label)


def two_rods():
    """A run of two crossed rods that turn about the normal of their plane, with four strings."""
    scene = planar_scene((0, 0, 1))
    times = np.linspace(0.0, 1.0, 11)
    c, s, zero = np.cos(times), np.sin(times), np.zeros(11)
    turn = np.array([[c, -s, zero], [s, c, zero], [zero, zero, zero + 1]]).transpose(2, 0, 1)
    rate = np.array([[-s, -c, zero], [c, -s, zero], [zero, zero, zero]]).transpose(2, 0, 1)
    nodes = np.einsum("tij,nj->tni", turn, scene.structure.positions)
    velocities = np.einsum("tij,nj->tni", rate, scene.structure.positions)
    return run_of(scene, times, nodes, velocities, np.full((11, 4), 0.2), "formula")


def test_figure_5_4_shows_coordinates_controls_and_multiplier():
    run = cone_run(engine="one")
    rows = panels_of(plot_run([run, cone_run(engine="two")]))
    assert len(rows) == 2
    assert all(len(row) == 3 for row in rows)
    coordinates, controls, multiplier = rows[0]
    for axis, name in enumerate("xyz"):
        line = curve(coordinates, f"$b_{name}$")
        assert np.allclose(line.get_ydata(), run.nodes[:, 1, axis])  # the rod has length 1 and starts at the origin
        assert line.get_color() == palette.CYCLE[axis]
    assert curve(coordinates, "$b_x$").get_color()[2] > 0.7  # blue, as in the captions
    assert np.allclose(curve(coordinates, r"$\|b\|^2$").get_ydata(), 1.0)
    assert curve(coordinates, r"$\|b\|^2$").get_linestyle() == "--"
    dotted = [line for line in coordinates.lines if line.get_linestyle() == ":"]
    assert [float(line.get_ydata()[0]) for line in dotted] == [0.0, 0.0, 1.0]
    assert len(controls.lines) == 3
    assert np.array_equal(controls.lines[2].get_ydata(), run.force_densities[:, 2])
    assert np.array_equal(multiplier.lines[0].get_ydata(), run.multipliers[:, 0])


def test_figure_5_7_shows_error_norms():
    run = cone_run()
    errors = panels_of(plot_errors(run))[0][0]
    # From the tilted rod to the upright one: the chord of the angle between them; the pinned end has no error.
    (line,) = errors.lines
    assert np.allclose(line.get_ydata(), 2.0 * np.sin(TILT / 2.0))
    assert line.get_linestyle() == "-"


def test_several_rods_have_the_thesis_colours_and_r_is_dashed():
    run = two_rods()
    errors, controls, multipliers = panels_of(plot_run(run))[0]
    # No target: change since the start. b turns by t: a chord of 2 sin(t/2); r, the middle, goes round at its radius.
    solid = [line for line in errors.lines if line.get_linestyle() == "-"]
    dashed = [line for line in errors.lines if line.get_linestyle() == "--"]
    assert [line.get_color() for line in solid] == list(palette.CYCLE[:2])
    for line in solid:
        assert np.allclose(line.get_ydata(), 2.0 * np.sin(run.time / 2.0))
    positions = run.scene.structure.positions
    for line, pair in zip(dashed, run.scene.structure.rod_nodes, strict=True):
        radius = np.linalg.norm(positions[pair].mean(axis=0))
        assert np.allclose(line.get_ydata(), 2.0 * radius * np.sin(run.time / 2.0))
    assert len(multipliers.lines) == 2
    assert len(controls.lines) == 4


def test_the_colours_of_strings_repeat_after_seven():
    run = cone_run()
    run = replace(run, force_densities=np.zeros((21, 12)))
    colors = [line.get_color() for line in panels_of(plot_run(run))[0][1].lines]
    assert len(set(colors[:7])) == 7
    assert colors[7:] == colors[:5]


def test_point_masses_have_curves_too():
    scene, times = two_masses(), np.linspace(0.0, 1.0, 5)
    nodes = scene.structure.positions[None] + times[:, None, None] * np.array([0.0, 2.0, 0.0])
    run = run_of(scene, times, nodes, np.zeros_like(nodes), np.zeros((5, 1)))
    errors = panels_of(plot_run(run))[0][0]
    assert len(errors.lines) == 2
    assert np.allclose(errors.lines[0].get_ydata(), 2.0 * times)


def test_paths_follow_the_nodes_and_end_with_the_rods():
    run = cone_run()
    axes = plot_paths([run, run]).axes[0]
    paths = [line for line in axes.lines if len(line.get_data_3d()[0]) == len(run.time)]
    assert len(paths) == 2  # of the tip, in each run: the other nodes stand still
    assert np.allclose(np.transpose(paths[0].get_data_3d()), run.nodes[:, 1])
    assert paths[0].get_color() == palette.CYCLE[0]
    assert paths[1].get_linestyle() == "--"
    black = [line for line in axes.lines if line.get_color() == "black" and len(line.get_data_3d()[0]) == 2]
    assert np.allclose(np.transpose(black[0].get_data_3d()), run.nodes[-1, :2])


def test_a_comparison_is_drawn_with_both_balances():
    run = cone_run(engine="first, with options")
    nodes = run.nodes.copy()
    nodes[:, 1, 0] += 1e-7 * run.time
    other = replace(run, nodes=nodes, engine="second")
    figure = plot_comparison(compare(run, other), runs=[run, other])
    panel = figure.axes[0]
    assert panel.get_yscale() == "log"
    sizes = panel.lines[0].get_ydata()
    assert np.isnan(sizes[0])  # no difference at the start: not on a logarithmic scale
    assert np.allclose(sizes[1:], 1e-7 * run.time[1:])
    energy = figure.axes[5]
    balance = curve(energy, "balance of first")
    assert np.allclose(balance.get_ydata()[1:], 1e-9 * np.abs(np.sin(run.time[1:])))
    assert curve(energy, "balance of second").get_linestyle() == "--"


def test_equal_runs_are_said_to_be_equal():
    run = cone_run()
    figure = plot_comparison(compare(run, run))
    assert all([text.get_text() for text in panel.texts] == ["exactly equal"] for panel in figure.axes)


@pytest.mark.parametrize(("suffix", "start"), [("png", b"\x89PNG"), ("pdf", b"%PDF"), ("svg", b"<?xml")])
def test_figures_are_written_in_each_format(tmp_path: Path, suffix, start):
    target = tmp_path / f"plot.{suffix}"
    plot_run(cone_run(), target)
    assert target.read_bytes().startswith(start)
    first = target.read_bytes()
    plot_paths(cone_run(), target)
    assert target.read_bytes() != first
    assert [p.name for p in tmp_path.iterdir()] == [target.name]


def test_a_figure_that_fails_leaves_the_old_file(tmp_path: Path, monkeypatch):
    target = tmp_path / "plot.png"
    target.write_bytes(b"old")
    figure = plot_run(cone_run())

    def fail(path, **options):
        Path(path).write_bytes(b"half")
        raise KeyboardInterrupt

    monkeypatch.setattr(figure, "savefig", fail)
    with pytest.raises(KeyboardInterrupt):
        save_figure(figure, target)
    assert target.read_bytes() == b"old"
    assert [p.name for p in tmp_path.iterdir()] == ["plot.png"]


def test_what_cannot_be_plotted_is_refused(tmp_path: Path):
    run = cone_run()
    with pytest.raises(OptionError, match="at least one run"):
        plot_run([])
    with pytest.raises(OptionError, match="no samples"):
        plot_run(run.until(0))
    with pytest.raises(OptionError, match="Trajectory"):
        plot_run(["run.nc"])  # type: ignore[list-item]
    with pytest.raises(OptionError, match="its rods are rod"):
        plot_coordinates(run, rod="mast")
    with pytest.raises(OptionError, match="no rods"):
        plot_coordinates(run_of(two_masses(), run.time, run.nodes[:, :2], run.velocities[:, :2], np.zeros((21, 1))))
    with pytest.raises(OptionError, match="png"):
        plot_run(run, tmp_path / "plot.jpg")
    with pytest.raises(OptionError, match="no folder"):
        plot_run(run, tmp_path / "nowhere" / "plot.png")


def test_missing_numbers_leave_gaps():
    # What an engine does not know is NaN, which must not break a plot.
    run = cone_run()
    multipliers = run.multipliers.copy()
    multipliers[3:] = np.nan
    line = panels_of(plot_run(replace(run, multipliers=multipliers)))[0][2].lines[0]
    assert np.isnan(line.get_ydata()).sum() == 18


def test_pyplot_is_never_needed():
    code = (
        "import sys; sys.path.insert(0, sys.argv[1])\n"
        "from analytic_runs import cone_run; from tensegrity_mj.pictures.plots import plot_run, plot_paths\n"
        "plot_run(cone_run()); plot_paths(cone_run())\n"
        "assert 'matplotlib.pyplot' not in sys.modules and 'mujoco' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code, str(Path(__file__).parents[1] / "helpers")], check=True)
