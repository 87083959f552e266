"""Plots: the curves are the thesis' quantities in the thesis' colours, and files are whole or absent."""

from __future__ import annotations

import itertools
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from analytic_runs import TILT, cone_run, planar_scene, run_of, two_masses
from matplotlib.figure import Figure
from matplotlib.text import Text

import tensegrity_mj as tmj
from tensegrity_mj.basics.units import quantity
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.events import Load
from tensegrity_mj.pictures import palette
from tensegrity_mj.pictures.figure import MAX_LEGEND, frame, new_figure
from tensegrity_mj.pictures.plots import (
    paper,
    plot_comparison,
    plot_coordinates,
    plot_errors,
    plot_motion,
    plot_paths,
    plot_run,
    save_figure,
)
from tensegrity_mj.pictures.run_panels import draw_curves, string_groups
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
    red, green, blue = curve(coordinates, "$b_x$").get_color()
    assert blue > max(red, green)  # blue, as in the captions
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


def test_several_rods_have_the_thesis_colours_and_r_a_panel_of_its_own():
    run = two_rods()
    errors, places, controls, multipliers = panels_of(plot_errors(run))[0]
    # No target: change since the start. b turns by t: a chord of 2 sin(t/2); r, the middle, goes round at its radius.
    solid, dashed = errors.lines, places.lines
    assert [line.get_color() for line in solid] == list(palette.CYCLE[:2])
    for line in solid:
        assert np.allclose(line.get_ydata(), 2.0 * np.sin(run.time / 2.0))
    positions = run.scene.structure.positions
    for line, pair in zip(dashed, run.scene.structure.rod_nodes, strict=True):
        radius = np.linalg.norm(positions[pair].mean(axis=0))
        assert np.allclose(line.get_ydata(), 2.0 * radius * np.sin(run.time / 2.0))
    assert len(multipliers.lines) == 2
    assert len(controls.lines) == 4


def test_of_many_strings_the_largest_have_names_and_the_others_are_a_band():
    run = cone_run()
    u = np.linspace(0.1, 1.2, 12) * (1.0 + np.cos(run.time))[:, None]
    names = [f"s{k}" for k in range(12)]
    panel = new_figure(4.0, 3.0).subplots()
    draw_curves(panel, run.time, u, names)
    assert [line.get_label() for line in panel.lines] == names[4:]
    assert np.array_equal(panel.lines[0].get_ydata(), u[:, 4])
    (band,) = panel.collections
    assert band.get_label() == "4 others"
    edge = band.get_paths()[0].vertices[:, 1]
    assert np.isclose(edge.max(), u[:, 3].max())
    assert np.isclose(edge.min(), u[:, 0].min())


def test_named_curves_differ_in_colour_or_style_and_neighbours_in_both():
    looks = [palette.look_of(k) for k in range(MAX_LEGEND)]
    assert len(set(looks)) == MAX_LEGEND
    for (color, style), (next_color, next_style) in itertools.pairwise(looks):
        assert color != next_color
        assert style != next_style


def prism_run():
    """The dropped prism, falling freely for the first half of a second, then lying on its floor."""
    scene = tmj.load_scene("prism_drop")
    times = np.linspace(0.0, 1.0, 11)
    fall = np.where(times <= 0.5, times, 0.0)
    g = np.array(scene.gravity)
    nodes = scene.nodes0 + 0.5 * g * fall[:, None, None] ** 2
    velocities = np.broadcast_to(g * fall[:, None, None], nodes.shape)
    return run_of(scene, times, nodes, velocities, np.full((11, 12), 0.2))


def test_alike_strings_are_drawn_together_by_their_names_or_by_their_numbers():
    scene = tmj.load_scene("prism_drop")
    assert [label for label, _ in string_groups(scene.structure)] == ["bottom (3)", "top (3)", "side (3)", "cross (3)"]
    plain = replace(
        scene.structure, strings=tuple(replace(s, name=f"s{k}") for k, s in enumerate(scene.structure.strings))
    )
    groups = string_groups(plain)
    assert [len(rows) for _, rows in groups] == [6, 3, 3]  # bottom and top are alike in stiffness and rest length
    for label, rows in groups:
        assert f"L₀ = {quantity(float(plain.rest_lengths[rows[0]]), 'm')} " in label
        assert np.allclose(plain.rest_lengths[rows], plain.rest_lengths[rows[0]], rtol=1e-6)
    run = prism_run()
    pulls = panels_of(plot_run(run))[0][1]
    assert len(pulls.lines) == 4
    assert np.allclose(pulls.lines[0].get_ydata(), run.tensions[:, :3].mean(axis=1))


def test_without_a_law_a_run_shows_height_tension_and_the_force_of_the_floor():
    run = prism_run()
    height, tension, force = panels_of(plot_run(run))[0]
    assert height.get_title() == "Height above the floor"
    scene = run.scene
    low = curve(height, "lowest node").get_ydata()
    assert np.allclose(low, run.nodes[:, :, 2].min(axis=1) - scene.contact.floor)
    assert tension.get_ylabel() == "tension [N]"
    across, along = force.patches
    weight = float(scene.structure.rod_masses.sum()) * 9.81
    stop = np.argmax(run.time > 0.5 + 1e-9) - 1  # the interval in which it stops
    values = across.get_data().values
    # Free fall, then the stop: g t of momentum in 0.1 s, and the weight; then the weight alone.
    assert np.allclose(values[:stop], 0.0, atol=1e-9 * weight)
    assert np.isclose(values[stop], weight * (1.0 + 0.5 / 0.1))
    assert np.allclose(values[stop + 1 :], weight)
    assert np.allclose(along.get_data().values, 0.0, atol=1e-9 * weight)


def test_where_more_than_a_floor_acts_rods_show_their_forces():
    run = prism_run()
    loaded = replace(run, scene=run.scene.with_(loads=(Load(run.scene.structure.node_names[0], (1.0, 0.0, 0.0)),)))
    force = panels_of(plot_motion(loaded))[0][2]
    assert force.get_title() == "Force of the rods, negative in compression"
    pulls = run.rod_force_densities * run.scene.structure.rod_lengths
    assert np.allclose([line.get_ydata() for line in force.lines], pulls.T)


@pytest.mark.parametrize(
    ("top", "label", "ticks"),
    [
        (2400.0, "force [kN]", {"0.0", "0.5", "2.0"}),
        (0.0024, "force [mN]", {"0.0", "2.0"}),
        (24.0, "force [N]", {"20"}),
    ],
)
def test_ticks_are_written_with_prefixes(top, label, ticks):
    figure = new_figure(4.0, 3.0)
    panel = figure.subplots()
    panel.plot([0.0, 1.0], [0.0, top])
    frame(panel, y="force [N]")
    figure.draw_without_rendering()
    assert panel.get_ylabel() == label
    assert ticks <= {text.get_text() for text in panel.get_yticklabels()}


@pytest.mark.parametrize(
    ("ends", "written"), [((0.013, 0.09), ["0.02", "0.03", "0.05"]), ((0.021, 0.049), ["0.03", "0.04"])]
)
def test_marks_within_a_decade_are_written_where_they_have_room(ends, written):
    figure = new_figure(2.2, 2.2)
    panel = figure.subplots()
    panel.loglog(ends, [1.0, 2.0])
    panel.set_xlim(ends)
    frame(panel, x="wall time [s]", small=1.0)
    figure.draw_without_rendering()
    low, high = ends
    shown = [text for text in panel.get_xticklabels(which="minor") if low <= text.get_position()[0] <= high]
    shown = [text for text in shown if text.get_text()]
    assert [text.get_text() for text in shown] == written
    boxes = sorted(text.get_window_extent().extents[[0, 2]].tolist() for text in shown)
    assert all(first[1] < second[0] for first, second in itertools.pairwise(boxes))


def test_the_legend_below_hides_neither_curves_nor_the_axis():
    figure = plot_run(cone_run())
    figure.draw_without_rendering()
    for panel in panels_of(figure)[0][:2]:
        legend = panel.get_legend().get_window_extent()
        assert legend.y1 < panel.xaxis.label.get_window_extent().y0
        assert legend.y0 >= 0.0


@pytest.mark.parametrize(("columns", "width"), [(1, 88.0), (2, 181.0)])
def test_figures_for_papers_have_their_width_and_letters(tmp_path: Path, columns, width):
    with paper(columns):
        figure = plot_run(prism_run(), tmp_path / "plot.pdf")
    assert np.isclose(figure.get_figwidth() * 25.4, width)
    sizes = {text.get_fontsize() for text in figure.findobj(Text) if text.get_text()}
    assert sizes <= {7.0, 7.2, 8.0, 8.8}
    rows = [panel.get_subplotspec().get_gridspec().nrows for panel in panels_of(figure)[0]]
    assert rows == ([3] * 3 if columns == 1 else [1] * 3)
    assert plot_run(cone_run()).get_figwidth() > 10.0  # as on the screen again


def test_a_paper_has_one_or_two_columns():
    with pytest.raises(OptionError, match="columns=3"), paper(3):
        pass


def test_paths_in_a_plane_are_drawn_in_it():
    scene = planar_scene((0, 1, 0))
    times = np.linspace(0.0, 1.0, 5)
    nodes = scene.structure.positions + times[:, None, None] * np.array([0.3, 0.0, 0.1])
    run = run_of(scene, times, nodes, np.zeros_like(nodes), np.full((5, 4), 0.2))
    panel = plot_paths(run).axes[0]
    assert panel.name == "rectilinear"
    assert (panel.get_xlabel(), panel.get_ylabel()) == ("x [m]", "z [m]")
    x, z = panel.lines[0].get_data()
    assert np.allclose(x[:5], nodes[:, 0, 0])
    assert np.allclose(z[:5], nodes[:, 0, 2])


def test_point_masses_have_curves_too():
    scene, times = two_masses(), np.linspace(0.0, 1.0, 5)
    nodes = scene.structure.positions[None] + times[:, None, None] * np.array([0.0, 2.0, 0.0])
    run = run_of(scene, times, nodes, np.zeros_like(nodes), np.zeros((5, 1)))
    errors = panels_of(plot_errors(run))[0][0]
    assert len(errors.lines) == 2
    assert np.allclose(errors.lines[0].get_ydata(), 2.0 * times)


def test_paths_follow_the_nodes_and_end_with_the_rods():
    run = cone_run()
    axes = plot_paths([run, run]).axes[0]
    paths = [line for line in axes.lines if len(line.get_data_3d()[0]) == len(run.time)]
    assert len(paths) == 2  # of the tip, in each run: the other nodes stand still
    assert np.allclose(np.transpose(paths[0].get_data_3d()), run.nodes[:, 1])
    assert paths[0].get_linewidth() > paths[1].get_linewidth()  # so that it shows under the second
    assert paths[0].get_color() == palette.CYCLE[0]
    labels = [text.get_text() for text in axes.figure.legends[0].get_texts()]
    assert labels.count("target") == 1
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

    def fail(path, *more, **options):
        Path(path).write_bytes(b"half")
        raise KeyboardInterrupt

    monkeypatch.setattr(figure.canvas, "print_png", fail)
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
    with pytest.raises(OptionError, match=r"there is no rod 'mast'; allowed: rod"):
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


def test_a_figure_is_drawn_once_when_it_is_written(tmp_path: Path, monkeypatch):
    # Axes that share a scale in two subfigures have their canvas draw all of it, each time that a limit changes.
    drawn = []
    draw = Figure.draw
    monkeypatch.setattr(Figure, "draw", lambda self, renderer: (drawn.append(1), draw(self, renderer))[1])
    figure = plot_run([cone_run(engine="one"), cone_run(engine="two")])
    assert not drawn
    save_figure(figure, tmp_path / "plot.png")
    assert len(drawn) == 1  # with its layout, for which savefig draws it once before


def test_pyplot_is_never_needed():
    code = (
        "import sys; sys.path.insert(0, sys.argv[1])\n"
        "from analytic_runs import cone_run; from tensegrity_mj.pictures.plots import plot_run, plot_paths\n"
        "plot_run(cone_run()); plot_paths(cone_run())\n"
        "assert 'matplotlib.pyplot' not in sys.modules and 'mujoco' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code, str(Path(__file__).parents[1] / "helpers")], check=True)


def test_logarithmic_axes_of_many_decades_have_no_marks_within_them():
    panel = new_figure(3.0, 2.0).subplots()
    panel.loglog([1e-6, 1.0], [1.0, 50.0])
    frame(panel, x="x [m]", y="y [N]")
    assert len(panel.xaxis.get_minorticklocs()) == 0
    assert len(panel.yaxis.get_minorticklocs()) >= 8


def test_saving_a_picture_leaves_the_figure_as_it_was(tmp_path: Path) -> None:
    figure = Figure()
    figure.dpi = 77.0
    save_figure(figure, tmp_path / "a.png")
    assert figure.dpi == 77.0
    assert (tmp_path / "a.png").read_bytes()[:4] == b"\x89PNG"
