"""The shipped scenes hold the numbers of their sources."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import truth
from numpy.typing import NDArray

import tensegrity_mj as tmj
from tensegrity_mj.library.cable import cable
from tensegrity_mj.library.hanging import net, suspended_cable
from tensegrity_mj.library.named import load_scene
from tensegrity_mj.library.truss_arm import truss_arm
from tensegrity_mj.model.events import ControlSpec
from tensegrity_mj.model.members import Support
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.strings import StringLaw

HALF_UNIT = 0.5e-4  # of numbers printed with four digits after the point


def test_pinned_rod_is_that_of_section_5_4() -> None:
    scene = load_scene("pinned_rod")
    structure = scene.structure
    assert structure.node_names == ("O", "n1", "n2", "n3", "n4")
    rod = structure.rods[0]
    assert (rod.nodes, rod.mass, rod.support) == (("O", "n1"), 1.0, Support.pinned(0.0))
    start = np.array([1, -math.sqrt(2), math.sqrt(2)]) / math.sqrt(5)
    np.testing.assert_allclose(structure.positions[1] - structure.positions[0], start, rtol=4e-16)
    for i in (2, 3, 4):
        angle = 2 * math.pi * (i - 2) / 3
        expected = [1.2 * math.cos(angle), 1.2 * math.sin(angle), 0.0]
        np.testing.assert_allclose(structure.positions[i], expected, atol=5e-16)
    assert structure.fixed_nodes == ("n2", "n3", "n4")
    assert [set(string.nodes) for string in structure.strings] == [{"n1", "n2"}, {"n1", "n3"}, {"n1", "n4"}]
    assert scene.target is not None
    aim = scene.target.nodes[0, 1] - scene.target.nodes[0, 0]
    np.testing.assert_allclose(aim, np.array([0, math.sqrt(2), 1]) / math.sqrt(3), rtol=4e-16)
    assert scene.control == ControlSpec("lyapunov", {"decay_rate": 0.15, "norm": 2})
    assert (scene.duration, scene.gravity) == (60.0, (0.0, 0.0, 0.0))


def test_prism_is_that_of_section_5_5() -> None:
    scene = load_scene("prism")
    structure = scene.structure
    assert structure.node_names == ("O", "n1", "n2", "n3", "n4", "n5")
    assert [rod.nodes for rod in structure.rods] == [("O", "n1"), ("n2", "n3"), ("n4", "n5")]
    assert [rod.mass for rod in structure.rods] == [1.0, 1.0, 1.0]
    held = [Support.pinned(0.0), Support.constrained([0, 0, 1]), Support.constrained([[1, 0, 0], [0, 0, 1]])]
    assert [rod.support for rod in structure.rods] == held
    names = structure.node_names
    pairs = [
        {i, j}
        for a, i in enumerate(names)
        for j in names[a + 1 :]
        if {i, j} not in [set(r.nodes) for r in structure.rods]
    ]
    assert [set(string.nodes) for string in structure.strings] == pairs
    assert [string.name for string in structure.strings] == [f"s{i}" for i in range(1, 13)]
    assert scene.target is not None
    # As printed in the thesis.
    printed = {
        0.8: ([[0.4243, 0.4243, 0.8], [-0.5796, 0.1553, 0.8], [0.1553, -0.5796, 0.8]], [0.4659, 0.2690], 0.5379),
        0.6: ([[0.5657, 0.5657, 0.6], [-0.7727, 0.2071, 0.6], [0.2071, -0.7727, 0.6]], [0.6212, 0.3586], 0.7173),
    }
    for height, nodes in ((0.8, structure.positions), (0.6, scene.target.nodes[0])):
        directions, z2, z3 = printed[height]
        np.testing.assert_allclose(nodes[[1, 3, 5]] - nodes[[0, 2, 4]], directions, atol=HALF_UNIT)
        np.testing.assert_allclose(nodes[2], [*z2, 0.0], atol=HALF_UNIT)
        np.testing.assert_allclose(nodes[4], [0.0, z3, 0.0], atol=HALF_UNIT)
        # The exact numbers behind them: rods at 45°, 165°, 285°, their feet on a circle of radius R.
        c = math.sqrt(1 - height**2)
        angles = np.radians([45.0, 165.0, 285.0])
        exact = np.column_stack([c * np.cos(angles), c * np.sin(angles), np.full(3, height)])
        side = c / (2 * math.sin(math.radians(75))) * math.sqrt(3)
        np.testing.assert_allclose(nodes[[1, 3, 5]] - nodes[[0, 2, 4]], exact, atol=3e-16)
        feet = [[0, 0, 0], [side * math.cos(math.pi / 6), side / 2, 0], [0, side, 0]]
        np.testing.assert_allclose(nodes[[0, 2, 4]], feet, atol=3e-16)
    assert scene.control == ControlSpec("lyapunov", {"decay_rate": 1.0, "norm": 2})
    assert (scene.duration, scene.gravity) == (10.0, (0.0, 0.0, 0.0))


def published(name: str, file: str) -> tuple[Scene, dict[str, NDArray]]:
    """A shipped scene and the published data, after all numbers that both have are found equal."""
    data = truth.load(file)
    scene = load_scene(name)
    structure = scene.structure
    np.testing.assert_array_equal(structure.positions, data["N0"].T)
    for pairs, matrix in ((structure.rod_nodes, data["Cb"]), (structure.string_nodes, data["Cs"])):
        np.testing.assert_array_equal(pairs[:, 0], np.argmin(matrix, axis=1))
        np.testing.assert_array_equal(pairs[:, 1], np.argmax(matrix, axis=1))
    np.testing.assert_array_equal(structure.rod_masses, data["bar_mass"])
    np.testing.assert_array_equal([rod.radius for rod in structure.rods], data["bar_radius"])
    np.testing.assert_array_equal(structure.stiffness, data["k"])
    np.testing.assert_array_equal(structure.damping, data["c"])
    np.testing.assert_array_equal(structure.rest_lengths, data["L0"])
    np.testing.assert_array_equal(scene.gravity, data["g"])
    np.testing.assert_array_equal(scene.velocities0, data["V0"].T)
    assert scene.duration == data["t"][-1]
    return scene, data


def test_tbar_is_the_published_one() -> None:
    scene, data = published("tbar", "stedy_tbar_undamped")
    # Held coordinates: all of the two feet, and y of the rest.
    assert [rod.support for rod in scene.structure.rods] == [Support.pinned(0.0, plane=(0, 1, 0))] * 2
    np.testing.assert_array_equal(data["fixed"], [[1, 1, 0, 0], [1, 1, 1, 1], [1, 1, 0, 0]])
    assert scene.duration == 10.0


def test_dbar_is_the_published_one() -> None:
    scene, data = published("dbar", "stedy_dbar")
    structure = scene.structure
    assert structure.string_law is StringLaw.UNCLIPPED
    # One node is held, n1: by the bar that ends there. There the others may leave the plane, and do not.
    np.testing.assert_array_equal(data["fixed"], [[1, 0, 0, 0]] * 3)
    np.testing.assert_array_equal(data["pos"][:, :, 1], 0.0)
    plane = (0.0, 1.0, 0.0)
    assert [rod.support for rod in structure.rods] == [Support.pinned(1.0, plane), *[Support.free(plane=plane)] * 3]
    assert structure.rods[0].nodes[1] == "n1"
    assert structure.class_number == 2
    assert scene.duration == 4.0


def test_dbar_moves_as_published() -> None:
    data = truth.load("stedy_dbar")
    run = tmj.simulate(load_scene("dbar"), None, tmj.DAE(rtol=1e-11, atol=1e-12), output_interval=0.01)
    np.testing.assert_allclose(run.time, data["t"], rtol=0, atol=1e-12)
    # What the data's own two tolerances differ by: its strings go slack, and its error is that of their instants.
    assert np.abs(run.nodes - data["pos"]).max() < float(data["selfconv_maxdpos"])


@pytest.mark.parametrize("build", [cable, suspended_cable, net, truss_arm])
def test_scenes_of_families_are_their_defaults(build: Callable[[], Scene]) -> None:
    built = build()
    shipped = load_scene(built.name)
    # Equilibria are good to round-off, which other machines' libraries have otherwise.
    np.testing.assert_allclose(shipped.structure.positions, built.structure.positions, rtol=0, atol=1e-13)
    same = replace(shipped.structure, nodes=built.structure.nodes)
    assert shipped.with_(structure=same) == built


def test_what_the_readmes_of_linked_rods_promise() -> None:
    """To the digits that they give; the runs' own errors are far below."""

    def run(name: str, **options: float) -> tmj.Trajectory:
        return tmj.simulate(load_scene(name), None, tmj.DAE(rtol=1e-7, atol=1e-9, **options))  # type: ignore[arg-type]

    hanging, sagging, net_run, arm, bars = (run(n) for n in ("cable", "suspended_cable", "net", "truss_arm", "dbar"))
    for node, swing in ((12, 0.44), (7, 0.19)):
        y = hanging.nodes[:, node, 1]
        turns = np.flatnonzero(np.diff(np.sign(np.diff(y)))) + 1
        assert np.abs(np.diff(y[turns])).max() == pytest.approx(swing, abs=5e-3)
    pull = hanging.rod_force_densities * hanging.scene.structure.rod_lengths
    assert (pull.min(), pull.max()) == pytest.approx((0.25, 2.16), abs=5e-3)
    assert np.abs(hanging.nodes[:, :, 0]).max() == 0.0
    middle = sagging.nodes[:, 11, 2]
    assert (middle.min(), middle[0], middle.max()) == pytest.approx((-0.864, -0.843, -0.820), abs=5e-4)
    end = sagging.rod_force_densities[:, 0] * 0.125
    assert (end.min(), end.max()) == pytest.approx((0.85, 0.90), abs=5e-3)
    assert np.abs(sagging.nodes[:, :, 1]).max() < 1e-12
    row = net_run.scene.structure.node_index["n2_2"]
    drop = net_run.nodes[0, row, 2] - net_run.nodes[:, row, 2]
    assert drop.max() == pytest.approx(0.062, abs=5e-4)
    assert net_run.time[drop.argmax()] == pytest.approx(1.08, abs=0.011)
    pull = net_run.rod_force_densities * 0.25
    assert (pull.min(), pull.max()) == pytest.approx((0.05, 1.41), abs=5e-3)
    tip = arm.nodes[:, arm.scene.structure.node_index["b4"], 2]
    assert (tip.min(), tip[-1]) == pytest.approx((-0.030, -0.015), abs=5e-4)
    assert arm.time[tip.argmin()] == pytest.approx(0.11, abs=0.011)
    assert (arm.tensions.min(), arm.tensions.max()) == pytest.approx((4.4, 15.4), abs=0.05)
    assert bars.tensions[0, 1] == pytest.approx(94, abs=0.5)
    assert bars.tensions[:, 0].max() == pytest.approx(78, abs=0.5)
    slack = bars.time[(bars.tensions[:, 1] == 0) & (bars.time < 0.3)]
    assert (slack[0], slack[-1]) == pytest.approx((0.06, 0.22), abs=0.011)
    assert bars.dissipation[-1] == pytest.approx(11.5, abs=0.05)
    assert bars.string_energy[0] == pytest.approx(20.0, abs=0.05)
