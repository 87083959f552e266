"""The planar beam of §4.6.2: its geometry, its motion, and how its force densities are shared out."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

import tensegrity_mj as tmj
from tensegrity_mj.dynamics.target import target_nodes
from tensegrity_mj.errors import OptionError
from tensegrity_mj.library.planar_beam import beam_nodes, cell_strings, inner_radius, lines_of, planar_beam

Array = NDArray[np.float64]
LENGTH, HEIGHT = np.sqrt(2.0), 1.0
HELD = tmj.Actuation.hold_force_density(0.01)


def on_target(scene: tmj.Scene, times: Array) -> list[tuple[float, Array, Array]]:
    """Times, nodes and velocities of the target, the latter by central differences (1e-9 of their size)."""
    assert scene.target is not None
    h = 1e-4
    before, at, after = (target_nodes(scene.structure, scene.target, times + shift) for shift in (-h, 0.0, h))
    return [(float(t), x, (b - a) / (2 * h)) for t, a, x, b in zip(times, before, at, after, strict=True)]


def force_densities(times: Array, **options: Any) -> tuple[Array, Array]:
    """u (T, M) of the law on its target, and the residuals of its allocation (T,)."""
    scene = planar_beam(**options)
    law = tmj.controllers.from_scene(scene)
    found = [(law(*state), law.report[-1]) for state in on_target(scene, times)]
    return np.array([u for u, _ in found]), np.array([residual for _, residual in found])


# Geometry ---------------------------------------------------------------------------------------------------


def test_the_radius_solves_the_equation_of_the_figure() -> None:
    for angle in (1e-4, 0.1, 0.4597, 1.0, 3.0):
        r = inner_radius(angle, LENGTH, HEIGHT)
        # (4.15) with its parenthesis in place: terms up to (r φ)² with r = h / φ lose r² φ⁴ 1e-16 / φ² at most.
        right = (HEIGHT + r * (1 - np.cos(angle))) ** 2 + r**2 * np.sin(angle) ** 2
        assert right == pytest.approx(LENGTH**2, abs=1e-7 if angle < 1e-3 else 1e-14)
    assert inner_radius(np.radians(0.01), LENGTH, HEIGHT) == pytest.approx(5729, abs=1)  # 10^3.76 in figure 4.7


def test_rods_strings_and_lengths_are_those_of_the_figures() -> None:
    scene = planar_beam()
    structure = scene.structure
    assert (len(structure.nodes), len(structure.rods), len(structure.strings)) == (80, 40, 196)
    assert [place for place, _ in lines_of(39)] == [0, *range(2, 40), 41]
    assert scene.target is not None
    start, end = (structure.string_lengths(nodes) for nodes in scene.target.nodes)
    assert start[0] == end[0] == pytest.approx(1.0, abs=1e-14)
    # Of each cell: top, bottom, rising, falling, right upright. The lengths of the diagonals are the published ones.
    wide, narrow = (start[1:6], end[1:6]), (start[6:11], end[6:11])
    np.testing.assert_allclose(wide[0][2:], [1.2019, 1.2019, 1.0], atol=6e-5)
    np.testing.assert_allclose(wide[1][2:], [1.2037, 1.2037, 1.0], atol=6e-5)
    np.testing.assert_allclose(narrow[0][2:], [1.0541, 1.0541, 1.0], atol=6e-5)
    np.testing.assert_allclose(narrow[1][2:], [1.0549, 1.0549, 1.0], atol=6e-5)
    np.testing.assert_allclose(narrow[0][:2], 1 / 3, atol=1e-4)
    np.testing.assert_allclose(wide[0][:2], 2 / 3, atol=1e-4)
    for lengths in (start, end):
        np.testing.assert_allclose(lengths[1:6], lengths[-5:], rtol=0, atol=1e-12)
        np.testing.assert_allclose(lengths[6:191].reshape(-1, 5) - lengths[6:11], 0, atol=1e-12)


def test_the_beam_closes_to_a_ring() -> None:
    nodes = planar_beam().target.nodes[-1]  # type: ignore[union-attr]
    np.testing.assert_allclose(nodes[[77, 79]], nodes[[2, 0]], rtol=0, atol=1e-11)  # lower and upper of the last line
    radius = inner_radius(6 * np.pi / 41, LENGTH, HEIGHT)
    from_center = np.linalg.norm(nodes - [0, 0, -radius], axis=1)
    expected = radius + np.isin(np.arange(80) % 4, (0, 3)) * HEIGHT
    np.testing.assert_allclose(from_center, expected, rtol=0, atol=1e-11)


def test_cells_have_six_strings_of_four_nodes() -> None:
    structure = planar_beam().structure
    named = {string.name: set(string.nodes) for string in structure.strings}
    cells = cell_strings(39)
    assert len(cells) == 39
    for number, cell in enumerate(cells):
        assert len(set(cell)) == 6
        assert len(set().union(*(named[name] for name in cell))) == 4
        if number:
            assert cells[number - 1][-1] == cell[0]  # the upright that two cells share
    assert len({name for cell in cells for name in cell}) == 196


def test_the_curve_is_that_of_the_formulas() -> None:
    along = planar_beam().target.along  # type: ignore[union-attr]
    assert along is not None
    angles = np.linspace(*along.interval, 201)
    exact = np.array([beam_nodes(angle, 39, LENGTH, HEIGHT) for angle in angles])
    assert np.abs(along.nodes(angles) - exact).max() < 1e-10


def test_the_shipped_scene_is_a_member_of_the_family() -> None:
    assert tmj.load_scene("planar_beam") == planar_beam()


@pytest.mark.parametrize("cells", [3, 5, 11])
def test_beams_of_any_odd_number_of_cells(cells: int) -> None:
    scene = planar_beam(cells=cells, angle=(0.02, 0.5), minimum_sum=50.0, duration=10.0)
    assert (len(scene.structure.rods), len(scene.structure.strings)) == (cells + 1, 5 * cells + 1)
    law = tmj.controllers.from_scene(scene)
    assert len(law.coordinates) == 3 * (cells + 1) - 3
    run = tmj.simulate(scene, law, tmj.DAE(rtol=1e-9, atol=1e-10), duration=2.0)
    assert run.target_error().max() < 1e-8


def test_parameters_that_are_refused() -> None:
    for options, part in (
        ({"cells": 4}, "odd"),
        ({"cells": 39.0}, "odd"),
        ({"cells": 1}, "odd"),
        ({"rod_length": 0.9}, "exceed the height"),
        ({"height": -1.0}, "height"),
        ({"angle": (0.1, 0.1)}, "two different angles"),
        ({"angle": (0.0, 0.1)}, "angle"),
        ({"cells": 3}, "3 cells close to no full circle"),
        ({"angle": None}, "angle = None"),
        ({"angle": (0.1,)}, "two angles"),
        ({"shapes": 1}, "shapes"),
        ({"shapes": 18.0}, "shapes"),
        ({"minimum_sum": np.nan}, "minimum_sum"),
    ):
        with pytest.raises(OptionError) as caught:
            planar_beam(**options)  # type: ignore[arg-type]
        assert part in str(caught.value)


def test_mujoco_has_planar_joints_only() -> None:
    model = tmj.MuJoCo().model(tmj.load_scene("planar_beam"))
    assert model.nv == model.nq == 117
    assert model.neq == 0
    kinds = [set(), set()]  # type: ignore[var-annotated]
    for joint in range(model.njnt):
        slide = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE
        kinds[0 if slide else 1].add(joint)
        assert slide or model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE
    assert (len(kinds[0]), len(kinds[1])) == (77, 40)  # rod1 slides along a line, rod2 turns only, 38 move in a plane


# How the force densities are shared out -----------------------------------------------------------------------


def test_strategy_1_on_the_reference() -> None:
    times = np.concatenate([[1.0, 3.0, 6.0], np.linspace(6.3, 18.5, 62), [25.0, 40.0, 59.0]])
    high, residual = force_densities(times, minimum_sum=1960.0)
    assert residual.max() < 1e-8
    assert high.min() >= 0
    np.testing.assert_allclose(high.sum(axis=1), 1960, rtol=1e-11)
    assert 60 < high.max() < 80  # the axis of figure 4.9
    middle, _ = force_densities(times, minimum_sum=980.0)
    total = middle.sum(axis=1)
    off = times[total > 980 * (1 + 1e-9)]
    assert total.min() > 980 * (1 - 1e-11)
    assert (off[0], off[-1]) == pytest.approx((6.5, 18.3), abs=0.21)  # sampled each 0.2 s
    np.testing.assert_array_equal(off, times[(times >= off[0]) & (times <= off[-1])])
    assert total.max() == pytest.approx(1249, abs=1.0)
    free, _ = force_densities(times, minimum_sum=None)
    np.testing.assert_allclose(free[total > 980 * (1 + 1e-9)], middle[total > 980 * (1 + 1e-9)], rtol=0, atol=1e-7)
    assert np.all(free.sum(axis=1) <= total + 1e-7)
    # Without a criterion and on the bound of the end nothing is needed at rest.
    assert free[-1].sum() < 0.05 * free.sum(axis=1).max()


@pytest.mark.parametrize(("minimum", "largest"), [(60.0, 150.0), (30.0, 105.0)])
def test_strategy_2_on_the_reference(minimum: float, largest: float) -> None:
    times = np.linspace(2.0, 58.0, 15)
    u, residual = force_densities(times, minimum_sum=None, minimum_cell_sum=minimum)
    assert residual.max() < 1e-8
    assert u.min() >= 0
    cells = np.array([[u[:, int(name[1:]) - 1] for name in cell] for cell in cell_strings(39)]).sum(axis=1)
    assert cells.min() > minimum * (1 - 1e-10)
    assert cells.max() < largest  # the axis of figure 4.11 ends at 150
    # Figure 4.11: cells 2, 4, ... must rise above their bound, cells 3, 5, ... 37 come near to it.
    assert cells[1::2].mean() > cells[2:-1:2].mean() + 0.2 * minimum


def test_zero_in_every_cell_is_no_criterion() -> None:
    times = np.array([5.0, 12.0, 30.0])
    cells, _ = force_densities(times, minimum_sum=None, minimum_cell_sum=0.0)
    none, _ = force_densities(times, minimum_sum=None)
    np.testing.assert_allclose(cells, none, rtol=0, atol=1e-9)


# Runs -------------------------------------------------------------------------------------------------------


def test_the_engines_agree() -> None:
    scene = tmj.load_scene("planar_beam")
    law = tmj.controllers.from_scene(scene)
    reference, *others = (
        tmj.simulate(scene, law, engine, duration=1.5)
        for engine in (tmj.DAE(rtol=1e-11, atol=1e-12), tmj.ODE(rtol=1e-11, atol=1e-12), tmj.MuJoCo(1e-2))
    )
    assert reference.status is tmj.Status.COMPLETED
    assert reference.target_error().max() < 1e-9
    for run in others:
        assert tmj.compare(run, reference).max_node_error < 1e-7
        np.testing.assert_allclose(run.force_densities.sum(axis=1), 1960, rtol=1e-9)


def test_a_beam_that_starts_beside_its_target_comes_to_it() -> None:
    # A short beam: the same law, with errors to dispose of. e = (1 + t) e^{-t} e(0) for every coordinate.
    scene = planar_beam(cells=5, angle=(0.02, 0.6), minimum_sum=100.0, duration=10.0)
    start = beam_nodes(0.1, 5, LENGTH, HEIGHT)
    scene = scene.with_(initial_nodes=start)
    law = tmj.controllers.from_scene(scene)
    run = tmj.simulate(scene, law, tmj.DAE(rtol=1e-11, atol=1e-12), duration=4.0)
    rows = zip(run.time, run.nodes, run.velocities, strict=True)
    e = np.array([law.error(t, nodes, velocities)[0] for t, nodes, velocities in rows])
    t = run.time[:, None]
    np.testing.assert_allclose(e, (1 + t) * np.exp(-t) * e[0], rtol=0, atol=1e-9 * np.abs(e[0]).max())


def test_a_sampled_run_follows() -> None:
    scene = tmj.load_scene("planar_beam")
    law = tmj.controllers.from_scene(scene)
    run = tmj.simulate(scene, law, tmj.MuJoCo(1e-2), duration=3.0, actuation=HELD)
    assert run.status is tmj.Status.COMPLETED
    assert run.reports["warnings"] == []
    assert run.target_error().max() < 2e-3
    assert run.rest_lengths.min() > 0
    assert np.nanmax(run.allocation_residual) < 1e-8


@pytest.mark.slow
@pytest.mark.parametrize(("mode", "duration"), [("continuous", 6.0), ("sampled", 60.0)])
def test_the_whole_motion(mode: str, duration: float) -> None:
    """Sampled; and its first tenth by a law that is called four times a step, which takes ten times as long."""
    scene = tmj.load_scene("planar_beam")
    law = tmj.controllers.from_scene(scene)
    sampled = mode == "sampled"
    actuation = HELD if sampled else tmj.Actuation.continuous()
    run = tmj.simulate(scene, law, tmj.MuJoCo(1e-2), duration=duration, actuation=actuation, output_interval=0.1)
    factor = duration / run.cost["wall_time"]
    print(f"\nplanar_beam, {mode}: {factor:.1f} times real time, error {run.target_error().max():.2g} m,")
    print(f"residual {np.nanmax(run.allocation_residual):.2g}, least u {run.force_densities.min():.3g} N/m")
    np.testing.assert_allclose(run.force_densities.sum(axis=1), 1960, rtol=1e-6 if sampled else 1e-9)
    assert run.target_error().max() < (2e-3 if sampled else 1e-8)
    assert run.force_densities.min() >= 0
