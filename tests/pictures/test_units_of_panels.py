"""One unit an axis in all panels of all plots, one prefix for forces on a page; commands' pages: test_judgements."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from analytic_runs import cone_run, planar_scene, run_of, two_masses
from matplotlib.figure import Figure
from pages import ROOT
from panels import base_of, check_one_prefix, check_panels, unit_of

import tensegrity_mj as tmj
from evidence.thesis.landscape import draw_landscape
from tensegrity_mj.controllers import from_scene
from tensegrity_mj.model.members import PointMass
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.pictures import plots
from tensegrity_mj.pictures.figure import frame, new_figure
from tensegrity_mj.pictures.page import Picture, Section, Table, write_sections
from tensegrity_mj.pictures.web import make_web_page
from tensegrity_mj.runs.comparison import compare
from tensegrity_mj.runs.trajectory import Trajectory
from tensegrity_mj.studies.identification import result
from tensegrity_mj.studies.page import figures as sweep_figures
from tensegrity_mj.studies.sweep import Row


def shaken() -> Trajectory:
    """Crossed rods that shift by a tenth of a millimetre."""
    scene, times = planar_scene((0, 0, 1)), np.linspace(0.0, 1.0, 11)
    nodes = scene.structure.positions + 1e-4 * np.sin(times)[:, None, None] * np.array([1.0, 0.0, 0.0])
    return run_of(scene, times, nodes, np.zeros_like(nodes), np.full((11, 4), 0.2))


def masses() -> Trajectory:
    scene, times = two_masses(), np.linspace(0.0, 1.0, 5)
    nodes = scene.structure.positions[None] + times[:, None, None] * np.array([0.0, 2e-3, 0.0])
    return run_of(scene, times, nodes, np.zeros_like(nodes), np.zeros((5, 1)))


PLOTS = {
    "run": lambda: plots.plot_run([cone_run(), cone_run()]),
    "errors": lambda: plots.plot_errors([cone_run(), shaken()]),
    "errors of masses": lambda: plots.plot_errors(masses()),
    "motion": lambda: plots.plot_motion(shaken()),
    "coordinates": lambda: plots.plot_coordinates(cone_run()),
    "comparison": lambda: plots.plot_comparison(compare(cone_run(), cone_run()), runs=[cone_run(), cone_run()]),
    "clearance": lambda: plots.plot_clearance(tmj.clearance(shaken(), over_time=True)),
    "landscape": lambda: draw_landscape(from_scene(tmj.load_scene("pinned_rod")), cone_run()),
    "paths": lambda: plots.plot_paths(shaken()),
}


@pytest.mark.parametrize(
    ("name", "paper"), [*((name, False) for name in PLOTS), *((name, True) for name in [*PLOTS][:3])]
)
def test_axes_of_plots_have_one_unit_each(name: str, paper: bool) -> None:
    if paper:
        with plots.paper(1):
            figure: Figure = PLOTS[name]()
    else:
        figure = PLOTS[name]()
    check_panels(figure)


@pytest.mark.parametrize("name", PLOTS)
def test_no_legend_stands_over_curves(name: str) -> None:
    figure: Figure = PLOTS[name]()
    figure.draw_without_rendering()
    panels = [panel.get_window_extent() for panel in figure.axes]
    legends = [*figure.legends, *filter(None, (panel.get_legend() for panel in figure.axes))]
    assert legends or name in ("comparison", "landscape")
    for legend in legends:
        box = legend.get_window_extent()
        assert not any(box.overlaps(panel) for panel in panels)
        assert figure.bbox.x0 <= box.x0 < box.x1 <= figure.bbox.x1  # nor is it cut off


def test_the_one_frame_alone_places_legends() -> None:
    for path in (ROOT / "tensegrity_mj").rglob("*.py"):
        if path.name != "figure.py" or path.parent.name != "pictures":
            assert not re.findall(r"\b(?:axes|panel|place|figure|left|right)\.legend\(", path.read_text("utf-8")), path


def test_directions_and_places_have_axes_of_their_own_and_ticks_of_their_size() -> None:
    run = shaken()
    turns, shifts, *_ = plots.plot_errors(run).subfigs[0].axes
    shifts.figure.figure.draw_without_rendering()
    assert turns.get_ylabel().endswith("[1]")
    assert shifts.get_ylabel() == "distance [µm]"
    # The largest shift is 1e-4 sin 1 m, 84.1 µm.
    largest = max(float(line.get_ydata().max()) for line in shifts.lines)
    assert largest == pytest.approx(1e-4 * np.sin(1.0))
    written = [float(text.get_text().replace("−", "-")) for text in shifts.get_yticklabels()]
    assert 50 < max(written) < 120


def test_under_a_law_without_a_target_rest_lengths_are_shown() -> None:
    scene = tmj.load_scene("prism_drop")
    times = np.linspace(0.0, 1.0, 5)
    nodes = np.broadcast_to(scene.nodes0, (5, *scene.nodes0.shape))
    run = run_of(scene, times, nodes, np.zeros_like(nodes), np.full((5, 12), 0.2))
    run.provenance["controller"] = {"law": "own"}
    panels = plots.plot_run(run).subfigs[0].axes
    assert [panel.get_ylabel() for panel in panels] == ["height [m]", "tension [N]", "rest length [m]", "force [N]"]
    assert np.allclose(panels[2].lines[0].get_ydata(), run.rest_lengths[:, :3].mean(axis=1))


def test_the_scale_of_a_sweeps_map_has_a_prefix() -> None:
    names = ["law.amplitude", "engine.timestep"]
    rows = [
        Row({names[0]: a, names[1]: h}, "completed", "", {"energy_residual": a * h})
        for a in (1, 2)
        for h in (1e-5, 2e-5)
    ]
    (picture,) = sweep_figures(rows, names, [], ["energy_residual"])
    picture.figure.draw_without_rendering()
    scale = picture.figure.axes[-1]
    assert scale.get_ylabel() == "energy residual [µJ]"
    assert max(float(text.get_text()) for text in scale.get_yticklabels()) >= 40


def test_a_page_has_one_prefix_for_forces(tmp_path: Path) -> None:
    figures = []
    for top in (2.0, 5e4):
        figures.append(new_figure(3.0, 2.0))
        panel = figures[-1].subplots()
        panel.plot([0, 1], [0, top])
        frame(panel, "", "place [m]", "force [N]")
    table = Table("", ("rod", "force [N]", "length [m]"), [("a", 5.77, 0.25), ("b", None, 0.5), ("c", float("nan"), 1)])
    sections = [Section("S", (), [Picture(figures[0]), Picture(figures[1]), table])]
    text = write_sections(tmp_path / "p.html", "T", "", sections).read_text(encoding="utf-8")
    assert [figure.axes[0].get_ylabel() for figure in figures] == ["force [kN]"] * 2
    assert "<th>force [kN]</th>" in text
    assert '<td class="n">0.00577</td>' in text
    assert '<td class="n">0.25</td>' in text
    assert table.rows[0][1] == 5.77  # the table given is as it was


def test_panels_of_an_identification_have_one_prefix_and_whole_numbers() -> None:
    times = [0.0, 0.1, 0.2]
    series = [
        {"label": name, "unit": unit, "time": times, "measured": values, "fitted": values}
        for name, unit, values in (
            ("a.x", "m", [0.24, 0.25, 0.26]),
            ("b.x", "m", [0.0, 0.012, 0.004]),
            ("s1", "N", [20.0, 25.0, 21.0]),
        )
    ]
    figure = result._fitted({"series": series})
    figure.draw_without_rendering()
    labels = {panel.get_title(): panel.get_ylabel() for panel in figure.axes if panel.get_title()}
    assert labels == {"a.x": "[m]", "b.x": "[m]", "s1": "[N]"}
    row = {"name": "k", "deviation": 0.1, "value": 1.0, "high": 1.1, "start": 1.2}
    seen = {"eigenvalues": [6e3, 4e4]}
    white = {"lags": 1, "autocorrelation": [0.1], "bound": None}
    drawn = result._information_figure({"parameters": [row], "before": seen, "after": seen, "whiteness": white})
    numbers = drawn.axes[1]
    assert list(numbers.lines[0].get_xdata()) == [1, 2]
    assert all(float(place).is_integer() for place in numbers.get_xticks())


def test_the_page_in_3d_writes_its_scale_in_one_unit() -> None:
    run = cone_run()
    html = make_web_page(run).text
    (unit,) = re.findall(r'"tick_texts": ?\[[^\]]*\], ?"unit": ?"([^"]*)"', html)
    assert base_of(unit) == "N"


@pytest.mark.parametrize("label", ["b [1], r [mm]", "amplitude [rad; of the mean rod length]", "x [m1]", "x [m] or so"])
def test_the_check_sees_what_it_is_for(label: str) -> None:
    with pytest.raises(AssertionError):
        base_of(unit_of(label))
    with pytest.raises(AssertionError):
        check_one_prefix({"N", "kN"})


def test_panels_that_share_a_scale_share_its_prefix_and_those_of_other_units_do_not_share() -> None:
    runs = [cone_run(), cone_run()]
    for run, size in zip(runs, (0.02, 0.05), strict=True):
        run.force_densities[:] = size * np.sin(run.time)[:, None]
    figure = plots.plot_run(runs)
    figure.draw_without_rendering()
    for column in zip(*(row.axes for row in figure.subfigs), strict=True):
        assert len({panel.get_ylabel() for panel in column}) == 1
    one, other = (row.axes[1] for row in figure.subfigs)
    assert other.get_ylabel() == "force density [mN/m]"
    assert one.get_ylim() == other.get_ylim()
    top = max(float(line.get_ydata().max()) for line in other.lines)
    assert top < one.get_ylim()[1] < 1.1 * top  # the margin is 5 % of the range
    loose = Structure("loose", {"p": (0.0, 0.0, 0.0)}, point_masses=(PointMass("p", 1.0),))
    still = np.zeros((5, 1, 3))
    mixed = plots.plot_motion([shaken(), run_of(Scene(loose), np.arange(5.0), still, still, np.zeros((5, 0)))])
    mixed.draw_without_rendering()
    pulls, speeds = (row.axes[1] for row in mixed.subfigs)
    assert base_of(unit_of(pulls.get_ylabel())) == "N"
    assert base_of(unit_of(speeds.get_ylabel())) == "m/s"


@pytest.mark.parametrize(
    ("top", "written"), [(0.6, {"0.2", "0.5"}), (8.0, {"0.1", "1"}), (30.0, {"$\\mathdefault{10^{1}}$"})]
)
def test_logarithmic_axes_write_numbers_in_full_by_the_limits_that_are_set_last(top: float, written: set[str]) -> None:
    panel = new_figure(3.0, 2.0).subplots()
    panel.loglog([0.1, 0.5], [1.0, 2.0])
    frame(panel, "", "time [s]")
    panel.set_xlim(0.09, top)
    panel.figure.draw_without_rendering()
    labels = [*panel.xaxis.get_ticklabels(), *panel.xaxis.get_ticklabels(minor=True)]
    texts = {text.get_text() for text in labels} - {""}
    assert written <= texts
    assert top < 30 or not any(re.fullmatch("[.0-9]+", text) for text in texts)


def test_of_many_rest_lengths_those_are_drawn_that_change_most() -> None:
    scene, times = tmj.load_scene("six_bar_roll"), np.linspace(0.0, 1.0, 5)
    nodes = np.broadcast_to(scene.nodes0, (5, *scene.nodes0.shape))
    run = run_of(scene, times, nodes, np.zeros_like(nodes), np.full((5, 24), 0.2))
    run.provenance["controller"] = {"law": "own"}
    run.rest_lengths[:] = scene.structure.rest_lengths
    run.rest_lengths[:, 20] -= 0.01 * times  # a winch that winds in: its peak is that of all
    lines = plots.plot_run(run).subfigs[0].axes[2].lines
    assert any(np.array_equal(line.get_ydata(), run.rest_lengths[:, 20]) for line in lines)
    prism = tmj.load_scene("prism_drop")
    nodes = np.broadcast_to(prism.nodes0, (5, *prism.nodes0.shape))
    run = run_of(prism, times, nodes, np.zeros_like(nodes), np.full((5, 12), 0.2))
    run.provenance["controller"] = {"law": "own"}
    run.rest_lengths[:, 0] += 0.1 * times  # apart from the two that are like it
    panel = plots.plot_run(run).subfigs[0].axes[2]
    assert prism.structure.strings[0].name in [line.get_label() for line in panel.lines]
