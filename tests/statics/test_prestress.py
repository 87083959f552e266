"""Statics against formulas on paper, against other codes' results, and against laws that hold for any structure."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest
import truth
from equilibria import equilibrium_residual
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from evidence.random_linked import random_velocities
from evidence.random_structures import random_configuration, random_rotation, random_structure
from tensegrity_mj.errors import InfeasibleError, OptionError, StructureError
from tensegrity_mj.library.named import load_scene
from tensegrity_mj.model import strings as string_law
from tensegrity_mj.model.members import Rod, String, Support
from tensegrity_mj.model.rigidity import (
    equilibrium_force_densities,
    equilibrium_matrix,
    free_motions,
    static_forces,
)
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.statics.self_stress import prestress, self_stress

Array = NDArray[np.float64]
GRAVITY = (0.0, 0.0, -9.81)
seeds = st.integers(0, 2**32 - 1)
fair = settings(derandomize=True, max_examples=40, deadline=None)


def free_prism(
    count: int = 3, bottom: float = 1.0, top: float = 1.0, height: float = 1.0, twist: float | None = None
) -> Structure:
    """A prism of `count` free rods with polygons below and above, and a string up from each lower node."""
    twist = math.pi / 2 - math.pi / count if twist is None else twist
    turn = 2 * math.pi / count

    def ring(radius: float, z: float, start: float) -> list[list[float]]:
        return [[radius * math.cos(start + turn * i), radius * math.sin(start + turn * i), z] for i in range(count)]

    around = [(i, (i + 1) % count) for i in range(count)]
    return Structure.from_arrays(
        ring(bottom, 0.0, 0.0) + ring(top, height, twist),
        rods=[(i, count + (i + 1) % count) for i in range(count)],
        strings=around + [(count + i, count + j) for i, j in around] + [(i, count + i) for i in range(count)],
        rod_mass=1.0,
        stiffness=100.0,
    )


def hanging_rod(side: float) -> Structure:
    """A level rod of 3 kg and 2 m, pinned at the origin; a string from its end runs `side` metres up (or down)."""
    return Structure(
        "hanging rod",
        {"o": (0.0, 0.0, 0.0), "e": (2.0, 0.0, 0.0), "f": (2.0, 0.0, side)},
        (Rod("rod", ("o", "e"), 3.0, support=Support.pinned(0.0)),),
        (String("s", ("e", "f"), 100.0),),
        ("f",),
    )


# Formulas on paper --------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [3, 4, 5, 6, 8])
@pytest.mark.parametrize(("bottom", "top", "height"), [(1.0, 1.0, 1.0), (0.5, 0.5, 2.0), (1.3, 0.4, 0.7)])
def test_prism_of_n_rods(count: int, bottom: float, top: float, height: float) -> None:
    """At the twist π/2 - π/n, and only there, verticals v, rods and polygons balance.

    Vertically a lower node gives rod = -v. Then the two pull it sideways by v R_top (e^(i twist) - e^(i (twist +
    2π/n))), of length 2 v R_top sin(π/n) and radial if twist + π/n = π/2. The polygon's two strings u_bottom pull it
    inwards by 2 u_bottom R_bottom (1 - cos 2π/n) = 4 u_bottom R_bottom sin²(π/n). So
    u_bottom = v (R_top / R_bottom) / (2 sin(π/n)); u_top the other way round.
    """
    prism = free_prism(count, bottom, top, height)
    polygon = 1 / (2 * math.sin(math.pi / count))
    expected = np.repeat([polygon * top / bottom, polygon * bottom / top, 1.0], count)
    u = prestress(prism, level=1.0)
    np.testing.assert_allclose(u / u[-1], expected, rtol=1e-12)
    assert u.min() == pytest.approx(1.0, rel=1e-14)
    forces = static_forces(prism, u)
    np.testing.assert_allclose(forces.rod_force_densities, -u[-1], rtol=1e-12)
    # 5 n coordinates; 3 n strings less one mode; 6 motions of the whole.
    stress = self_stress(prism)
    assert (len(stress.modes), stress.free_coordinates, stress.rigid_motions) == (1, 5 * count, 6)
    assert stress.mechanisms == 5 * count - (3 * count - 1) - 6


def test_default_prism_of_tnsgrt() -> None:
    data = truth.load("tnsgrt_prism_default")
    members, count = data["members"].T, int(data["n_strings"])
    prism = Structure.from_arrays(data["nodes"].T, members[count:], members[:count], rod_mass=1.0, stiffness=1.0)
    u = prestress(prism)
    scaled = u / u[count - 1]
    # The file's positions are exact to 1e-15; its force densities come from an optimizer that reports its residual.
    limit = 10 * float(data["residual_force"]) + 1e-12
    np.testing.assert_allclose(scaled, data["force_density"][:count], atol=limit)
    densities = static_forces(prism, scaled).rod_force_densities
    np.testing.assert_allclose(densities, data["force_density"][count:], atol=limit)


TRIANGLES, VERTICALS, CROSSING = [0, 2, 5, 7, 8, 11], [3, 4, 10], [1, 6, 9]


@pytest.mark.parametrize("height", [0.8, 0.6])
def test_thesis_prism_is_in_equilibrium_at_both_heights(height: float) -> None:
    """Section 5.5: it is the three-rod prism above (verticals √3 times the triangles), held without forces.

    The crossing strings (s2, s7, s10) stay slack. Turning any prestress by 120° and 240° and averaging gives a
    symmetric one, with v, w and -(v + w) in verticals, crossing strings and rods; the moment about the axis then
    requires w = 0 at this twist, so that no state has them all in tension.
    """
    scene = load_scene("prism")
    structure = scene.structure
    assert scene.target is not None
    nodes = {0.8: structure.positions, 0.6: scene.target.nodes[0]}[height]
    np.testing.assert_allclose(nodes[[1, 3, 5], 2], height, rtol=1e-15)
    u = prestress(structure, nodes=nodes, slack=("s2", "s7", "s10"))
    expected = np.zeros(12)
    expected[TRIANGLES], expected[VERTICALS] = 1.0, math.sqrt(3)
    np.testing.assert_allclose(u, expected, atol=1e-13)
    np.testing.assert_array_equal(u[CROSSING], 0.0)
    forces = static_forces(structure, u, nodes)
    np.testing.assert_allclose(forces.rod_force_densities, -math.sqrt(3), rtol=1e-13)
    np.testing.assert_allclose(forces.support_forces, 0.0, atol=1e-14)
    # Three redundant strings: 12 act on 9 coordinates, and no motion is left.
    stress = self_stress(structure, nodes)
    assert (len(stress.modes), stress.free_coordinates) == (3, 9)
    assert (stress.mechanisms, stress.rigid_motions) == (0, 0)
    with pytest.raises(InfeasibleError, match=r"strings 's2', 's7', 's10' can carry none .*slack="):
        prestress(structure, nodes=nodes)


@pytest.mark.parametrize("name", ["prism"])
def test_shipped_scenes_start_in_equilibrium(name: str) -> None:
    structure = load_scene(name).structure
    lengths = structure.string_lengths(structure.positions)
    u = string_law.force_density(structure.stiffness, lengths, structure.rest_lengths)
    # Rest lengths are rounded: u by eps k, and a coordinate sums a few of them.
    assert np.abs(equilibrium_residual(structure, None, u)).max() < 1e-14
    assert u.max() > 0.08


def test_pinned_rod_is_prestressed_upright_and_at_the_thesis_target() -> None:
    scene = load_scene("pinned_rod")
    structure = scene.structure
    assert scene.target is not None
    # The pull on the tip is u Σ (n_i - b) = -3 u b for equal u, since the n_i sum to zero: along the rod at any b.
    for nodes in (structure.positions, scene.target.nodes[0]):
        np.testing.assert_allclose(prestress(structure, 2.0, nodes), 2.0, rtol=1e-13)
        np.testing.assert_allclose(static_forces(structure, [2.0] * 3, nodes).rod_force_densities, -6.0, rtol=1e-13)


def test_stedy_ball_is_in_equilibrium_under_gravity() -> None:
    data = truth.load("stedy_ball")
    held = {0: Support.pinned(0.0), 1: Support.pinned(0.0), 2: Support.pinned(1.0)}
    assert np.array_equal(np.flatnonzero(data["fixed"].all(axis=0)), [0, 1, 8])  # node 8: second end of rod 2
    ball = Structure.from_arrays(
        data["N0"].T,
        [(int(np.argmin(row)), int(np.argmax(row))) for row in data["Cb"]],
        [(int(np.argmin(row)), int(np.argmax(row))) for row in data["Cs"]],
        rod_mass=data["bar_mass"],
        stiffness=data["k"],
        rest_length=data["L0"],
        supports=[held.get(i, Support.free()) for i in range(6)],
        point_masses={12: float(data["point_mass"][0])},
    )
    u = data["force_density_eq"]
    lengths = ball.string_lengths(ball.positions)
    # k ~ 1e4 N/m times the round-off of L0 (1e-16 relative) is 1e-12; the forces are up to 200 N.
    np.testing.assert_allclose(string_law.force_density(ball.stiffness, lengths, ball.rest_lengths), u, atol=2e-11)
    assert np.abs(equilibrium_residual(ball, None, u, data["g"])).max() < 1e-11
    assert np.abs(equilibrium_residual(ball, None, u)).max() > 1.0  # without its weight it is not
    # The file's state proves to be the one of the least sum of squares with no string below 10 N/m, to 2e-10 N/m.
    own = prestress(ball, 10.0, gravity=data["g"])
    assert np.abs(equilibrium_residual(ball, None, own, data["g"])).max() < 1e-11
    np.testing.assert_allclose(own, u, atol=1e-9 * u.max())
    # Together the supports carry the weight.
    forces = static_forces(ball, u, gravity=data["g"])
    weight = (data["bar_mass"].sum() + data["point_mass"][0]) * data["g"]
    np.testing.assert_allclose(forces.support_forces.sum(axis=0), -weight, atol=1e-10)


def test_hanging_rod() -> None:
    """Moments about the pin: 2 m · u · side = m g · 1 m, so u = 3 · 9.81 / (2 · 1.5) N/m; the pin has the rest."""
    rod = hanging_rod(1.5)
    expected = 3 * 9.81 / (2 * 1.5)
    for level in (1.0, expected * (1 - 1e-12)):
        np.testing.assert_allclose(prestress(rod, level, gravity=GRAVITY), [expected], rtol=1e-14)
    forces = static_forces(rod, [expected], gravity=GRAVITY)
    np.testing.assert_allclose(forces.support_forces, [[0, 0, 1.5 * 9.81]], rtol=1e-14)
    np.testing.assert_allclose(forces.anchor_forces[2], [0, 0, 1.5 * 9.81], rtol=1e-14)
    assert forces.rod_force_densities == pytest.approx([0.0], abs=1e-14)
    held = equilibrium_force_densities(rod, gravity=GRAVITY)
    np.testing.assert_allclose(held.force_densities, [expected], rtol=1e-14)
    assert held.residual == pytest.approx(0.0, abs=1e-14)
    with pytest.raises(
        InfeasibleError, match=r"at most 9\.81 N/m \(in string 's'\), below the level 10 N/m; choose a lower"
    ):
        prestress(rod, 10.0, gravity=GRAVITY)
    # From below a string would have to push: the best it can do is nothing, and half the weight is left.
    below = hanging_rod(-1.5)
    u, residual, modes = equilibrium_force_densities(below, gravity=GRAVITY)
    assert (u[0], modes) == (0.0, 0)
    assert residual == pytest.approx(1.5 * 9.81, rel=1e-14)
    with pytest.raises(InfeasibleError, match=r"at most -9\.81 N/m \(in string 's'\).*add strings"):
        prestress(below, 1.0, gravity=GRAVITY)


def test_loads_add_to_gravity() -> None:
    loads = np.zeros((3, 3))
    loads[1] = [7.0, 0.0, -2.0]  # on the end: along the rod, and down
    rod = hanging_rod(1.5)
    expected = (1.5 * 9.81 + 2.0) / 1.5
    u = prestress(rod, 1.0, gravity=GRAVITY, loads=loads)
    np.testing.assert_allclose(u, [expected], rtol=1e-14)
    forces = static_forces(rod, u, gravity=GRAVITY, loads=loads)
    # Pulled along itself by 7 N over 2 m: tension is positive.
    np.testing.assert_allclose(forces.rod_force_densities, [3.5], rtol=1e-14)
    np.testing.assert_allclose(forces.support_forces, [[-7.0, 0, 1.5 * 9.81]], rtol=1e-14)


def test_a_planar_support_takes_what_pulls_out_of_the_plane() -> None:
    rod = Structure(
        "planar rod",
        {"o": (0.0, 0.0, 0.0), "e": (2.0, 0.0, 0.0), "f": (2.0, 3.0, 0.0)},
        (Rod("rod", ("o", "e"), 3.0, support=Support.pinned(0.0, plane=(0, 1, 0))),),
        (String("s", ("e", "f"), 100.0),),
        ("f",),
    )
    np.testing.assert_array_equal(equilibrium_residual(rod, None, [5.0]), [0.0])
    forces = static_forces(rod, [5.0])
    # 15 N sideways at the end: the pin pulls back, and a moment 2 x × 15 y = 30 z is held by -30 z.
    np.testing.assert_allclose(forces.support_forces, [[0, -15.0, 0]], atol=1e-14)
    np.testing.assert_allclose(forces.support_moments, [[0, 0, -30.0]], atol=1e-14)


# Laws that hold for any structure -----------------------------------------------------------------------


def any_structure(seed: int) -> tuple[np.random.Generator, Structure, Array]:
    rng = np.random.default_rng(seed)
    planar = bool(rng.integers(2))
    count = int(rng.integers(1, 5))
    structure = random_structure(rng, rods=count, planar=planar, own_planes=0.4, fixed_nodes=2, point_masses=1)
    return rng, structure, random_configuration(rng, structure, 0.5)


@fair
@given(seeds)
def test_free_motions_are_the_admissible_velocities(seed: int) -> None:
    rng, structure, nodes = any_structure(seed)
    motions = free_motions(structure, nodes)
    assert np.linalg.matrix_rank(motions) == motions.shape[1]
    # Each is admissible: the scene's own check of velocities is the judge.
    velocities = (motions @ rng.normal(size=motions.shape[1])).reshape(-1, 3)
    Scene(structure, initial_nodes=nodes, initial_velocities=velocities)
    # And each admissible one is among them.
    other = random_velocities(rng, structure, nodes, 1.0).ravel()
    part = np.linalg.lstsq(motions, other, rcond=None)[0]
    np.testing.assert_allclose(motions @ part, other, atol=1e-13)


@fair
@given(seeds)
def test_residual_is_minus_the_slope_of_the_energy(seed: int) -> None:
    """Strings of constant force density u have the potential energy u ‖s‖² / 2; gravity and loads are linear.

    All are at most quadratic in the node positions, so that a central difference along a straight motion of the
    nodes is exact but for round-off: eps E / h with E < 1e3 J.
    """
    rng, structure, nodes = any_structure(seed)
    u = rng.uniform(0, 10, len(structure.strings))
    gravity, loads = rng.normal(size=3), rng.normal(size=nodes.shape)

    def energy(x: Array) -> float:
        total = 0.5 * float(u @ structure.string_lengths(x) ** 2) - float(np.sum(loads * x))
        for rod, (i, j) in zip(structure.rods, structure.rod_nodes, strict=True):
            total -= rod.mass * float(gravity @ (x[i] + x[j])) / 2  # the weight at the middle
        for point in structure.point_masses:
            total -= point.mass * float(gravity @ x[structure.node_index[point.node]])
        return total

    h = 1e-2
    slopes = [
        (energy(nodes + h * motion.reshape(-1, 3)) - energy(nodes - h * motion.reshape(-1, 3))) / (2 * h)
        for motion in free_motions(structure, nodes).T
    ]
    residual = equilibrium_residual(structure, nodes, u, gravity, loads)
    np.testing.assert_allclose(residual, -np.array(slopes), atol=1e-10)
    alone = equilibrium_matrix(structure, nodes) @ u
    np.testing.assert_allclose(alone, equilibrium_residual(structure, nodes, u), atol=1e-13)


@fair
@given(seeds)
def test_rods_and_supports_balance_every_rod(seed: int) -> None:
    """Forces and moments about the origin, with loads that balance whatever strings and gravity leave over."""
    rng, structure, nodes = any_structure(seed)
    u = rng.uniform(0, 10, len(structure.strings))
    gravity = rng.normal(size=3)
    motions = free_motions(structure, nodes)
    left = equilibrium_residual(structure, nodes, u, gravity)
    loads = -(np.linalg.pinv(motions.T) @ left).reshape(-1, 3)
    np.testing.assert_allclose(equilibrium_residual(structure, nodes, u, gravity, loads), 0.0, atol=1e-12)
    forces = static_forces(structure, u, nodes, gravity, loads)

    on_nodes = np.array(loads)
    for pull, string in zip(u, structure.strings, strict=True):
        i, j = (structure.node_index[name] for name in string.nodes)
        on_nodes[i] += pull * (nodes[j] - nodes[i])
        on_nodes[j] -= pull * (nodes[j] - nodes[i])
    for number, (rod, (i, j)) in enumerate(zip(structure.rods, structure.rod_nodes, strict=True)):
        sigma, span = rod.support.sigma, nodes[j] - nodes[i]
        weight, middle = rod.mass * gravity, (nodes[i] + nodes[j]) / 2
        at, reaction = (1 - sigma) * nodes[i] + sigma * nodes[j], forces.support_forces[number]
        total = on_nodes[i] + on_nodes[j] + weight + reaction
        moment = (
            np.cross(nodes[i], on_nodes[i])
            + np.cross(nodes[j], on_nodes[j])
            + np.cross(middle, weight)
            + np.cross(at, reaction)
            + forces.support_moments[number]
        )
        np.testing.assert_allclose(total, 0.0, atol=1e-11)
        np.testing.assert_allclose(moment, 0.0, atol=1e-11)
        # Cut next to the end that no support holds: the rod's force balances the end's along the rod.
        if sigma in (0.0, 1.0):
            far, away = (j, 1.0) if sigma == 0.0 else (i, -1.0)
            along = (on_nodes[far] + weight / 2) @ span / np.linalg.norm(span) ** 2
            assert forces.rod_force_densities[number] == pytest.approx(away * along, abs=1e-11)
        # A support pushes only where it holds: nothing along what is free.
        np.testing.assert_allclose(rod.support.translation_basis.T @ reaction, 0.0, atol=1e-12)
    fixed = [structure.node_index[name] for name in structure.fixed_nodes]
    np.testing.assert_allclose(forces.anchor_forces[fixed], -on_nodes[fixed], atol=1e-12)
    for point in structure.point_masses:
        row = structure.node_index[point.node]
        held = on_nodes[row] + point.mass * gravity + forces.anchor_forces[row]
        np.testing.assert_allclose(held, 0.0, atol=1e-11)


@fair
@given(seeds)
def test_modes_and_particular_state_solve_equilibrium(seed: int) -> None:
    rng, structure, nodes = any_structure(seed)
    structure = structure.with_strings(stiffness=1e6)  # above any force density, so that rest lengths are positive
    gravity = rng.normal(size=3)
    stress = self_stress(structure, nodes, gravity)
    modes, count = stress.modes, len(structure.strings)
    np.testing.assert_allclose(modes @ modes.T, np.eye(len(modes)), atol=1e-13)
    combined = stress.particular + rng.normal(size=len(modes)) @ modes
    np.testing.assert_allclose(equilibrium_residual(structure, nodes, combined, gravity), stress.residual, atol=1e-11)
    # Rank counts: coordinates - mechanisms - motions of the whole = strings - modes.
    rank = np.linalg.matrix_rank(equilibrium_matrix(structure, nodes), tol=1e-9)
    assert stress.free_coordinates - stress.mechanisms - stress.rigid_motions == rank == count - len(modes)
    for mode, forces in zip(modes, stress.forces, strict=True):
        again = static_forces(structure, mode, nodes)
        np.testing.assert_array_equal(forces.rod_force_densities, again.rod_force_densities)


@fair
@given(seeds)
def test_moving_the_whole_changes_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    slack: Sequence[str] = ()
    if rng.integers(2):
        structure, slack = load_scene("prism").structure, ("s2", "s7", "s10")
    else:
        structure = braced_prism(float(rng.uniform(0.5, 1.5)))
    # Leaving 17 digits, the nodes are in equilibrium to 1e-16 times the shift; singular values need some 10 times.
    turned = structure.moved(random_rotation(rng), rng.normal(size=3))
    before, after = self_stress(structure), self_stress(turned)
    np.testing.assert_allclose(after.singular_values, before.singular_values, rtol=1e-12, atol=1e-14)
    assert (after.mechanisms, after.rigid_motions) == (before.mechanisms, before.rigid_motions)
    np.testing.assert_allclose(prestress(turned, 0.7, slack=slack), prestress(structure, 0.7, slack=slack), rtol=1e-12)


@pytest.mark.parametrize(("other", "rigid"), [(Support.constrained([0, 0, 1]), 4), (Support.pinned(), 2)])
def test_motions_of_the_whole_that_supports_leave(other: Support, rigid: int) -> None:
    """Two rods whose feet slide on a floor, joined by strings, move as one body in 4 ways: 2 shifts, a turn about
    the vertical, and a turn about the line through the feet. Pinning a foot leaves the turns."""
    structure = Structure.from_arrays(
        [[0, 0, 0], [0, 0.1, 1], [2, 0, 0], [2, 0.3, 1.5]],
        rods=[(0, 1), (2, 3)],
        strings=[(0, 2), (1, 3), (0, 3)],
        rod_mass=1.0,
        stiffness=1.0,
        supports=[Support.constrained([0, 0, 1]), other],
    )
    stress = self_stress(structure)
    assert stress.rigid_motions == rigid
    assert stress.mechanisms == stress.free_coordinates - rigid - 3


def test_nodes_on_a_line_have_no_turn_about_it() -> None:
    masses = Structure.from_arrays(
        [[0, 0, 0], [0, 0, 1]],
        np.zeros((0, 2), int),
        [(0, 1)],
        rod_mass=[],
        stiffness=1.0,
        point_masses={0: 1.0, 1: 1.0},
    )
    stress = self_stress(masses)
    assert (stress.free_coordinates, stress.rigid_motions, stress.mechanisms, len(stress.modes)) == (6, 5, 0, 0)


# Several modes: the choice among them -------------------------------------------------------------------


def braced_prism(height: float = 1.0) -> Structure:
    """The prism of four rods, with the diagonals of both squares."""
    prism = free_prism(4, height=height)
    diagonals = [(0, 2), (1, 3), (4, 6), (5, 7)]
    strings = [*(tuple(pair) for pair in prism.string_nodes.tolist()), *diagonals]
    return Structure.from_arrays(prism.positions, prism.rod_nodes, strings, rod_mass=1.0, stiffness=100.0)


def test_a_symmetric_structure_gets_the_symmetric_least_prestress() -> None:
    """Four sides d, e of each square: the diagonals (length √2 sides) share the inward pull of the sides.

    A node of a square of circumradius R is pulled inwards by 4 u_side R sin²(π/4) = 2 u_side R by its sides and by
    2 u_diagonal R by its diagonal, so that u_side + u_diagonal = v / (2 sin(π/4)) = v / √2: a state for each split.
    The least sum of squares with all >= 1 over 8 sides, 4 diagonals and 4 verticals keeps the two equal at their
    bound, and v = 2 √2 follows: 8 + 4 + 4 · 8 = 44; more of either needs more of v.
    """
    braced = braced_prism()
    stress = self_stress(braced)
    assert len(stress.modes) == 3  # 16 strings, 20 coordinates: 12 with one mode, each square's bracing one more
    u = prestress(braced)
    expected = np.repeat([1.0, 2 * math.sqrt(2), 1.0], [8, 4, 4])
    np.testing.assert_allclose(u, expected, rtol=1e-12)
    assert float(u @ u) == pytest.approx(44.0, rel=1e-12)
    # No other admissible state is smaller: drawn over all of them, from the modes.
    rng = np.random.default_rng(1)
    for _ in range(200):
        other = u + rng.normal(size=len(stress.modes)) @ stress.modes
        if other.min() > 0:
            other /= other.min()
            assert np.linalg.norm(other) >= np.linalg.norm(u) * (1 - 1e-12)


@fair
@given(st.floats(1e-6, 1e6))
def test_prestress_scales_with_its_level(level: float) -> None:
    braced = braced_prism()
    np.testing.assert_allclose(prestress(braced, level), level * prestress(braced), rtol=1e-12)


# What there is not, and why -----------------------------------------------------------------------------


def test_without_self_stress_it_says_so_and_how_near_it_is() -> None:
    far = free_prism(twist=math.radians(60))
    with pytest.raises(InfeasibleError, match=r"'structure' has no self-stress: its 9 strings .* 15 free") as caught:
        prestress(far)
    assert "digits" not in str(caught.value)
    near = free_prism(twist=math.radians(30) + 1e-5)
    with pytest.raises(InfeasibleError, match=r"close to having one .*17 digits"):
        prestress(near)


def test_strings_that_would_push_are_named() -> None:
    """A rod in a plane, pinned at its foot: strings to the left balance strings to the right, not each other."""
    nodes = [[0, 0, 0], [0, 0, 1], [-1, 0, 0], [-2, 0, 0]]
    rod = Structure.from_arrays(
        nodes, [(0, 1)], [(1, 2), (1, 3)], rod_mass=1.0, stiffness=1.0, supports=[Support.pinned()], fixed_nodes=[2, 3]
    )
    assert len(self_stress(rod).modes) == 1
    with pytest.raises(InfeasibleError, match=r"strings 's1', 's2' can carry none while no string pushes"):
        prestress(rod)
    # With a third string against them all three are tight: horizontal pulls u1 + 2 u2 = u3.
    third = Structure.from_arrays(
        [*nodes, [1, 0, 0]],
        [(0, 1)],
        [(1, 2), (1, 3), (1, 4)],
        rod_mass=1.0,
        stiffness=1.0,
        supports=[Support.pinned()],
        fixed_nodes=[2, 3, 4],
    )
    np.testing.assert_allclose(prestress(third), [1.0, 1.0, 3.0], rtol=1e-13)
    # Left out, a string is slack; the others balance without it.
    np.testing.assert_allclose(prestress(third, slack=["s2"]), [1.0, 0.0, 1.0], rtol=1e-13)


def test_weight_that_nothing_holds() -> None:
    # A free prism falls, of 3 rods of 1 kg: it needs no supports to be prestressed as it does.
    with pytest.raises(InfeasibleError, match=r"push the whole with \(.*, -29.43\) N.*gravity=None.*falls freely"):
        prestress(free_prism(), gravity=GRAVITY)
    # A couple on it pushes along no straight line, and a force besides leaves more than a fall.
    twist = np.zeros((6, 3))
    twist[0], twist[1] = (0.0, 0.0, 1.0), (0.0, 0.0, -1.0)
    for gravity in (None, GRAVITY):
        with pytest.raises(
            InfeasibleError, match=r"push along motions that no string resists; add strings or supports"
        ):
            prestress(free_prism(), gravity=gravity, loads=twist)


def test_a_structure_without_strings() -> None:
    bare = Structure.from_arrays([[0, 0, 0], [0, 0, 1]], [(0, 1)], np.zeros((0, 2), int), rod_mass=1.0, stiffness=[])
    stress = self_stress(bare)
    assert (stress.modes.shape, stress.free_coordinates, stress.rigid_motions) == ((0, 0), 5, 5)
    assert prestress(bare).shape == (0,)
    held = equilibrium_force_densities(bare, gravity=GRAVITY)
    assert (held.force_densities.shape, held.self_stress_modes) == ((0,), 0)
    assert held.residual == pytest.approx(9.81, rel=1e-14)


@pytest.mark.parametrize("level", [0.0, -1.0, math.nan, math.inf, "high", None])
def test_levels_that_are_none(level: object) -> None:
    with pytest.raises(OptionError, match="level = "):
        prestress(free_prism(), level)  # type: ignore[arg-type]


def test_names_and_shapes_that_do_not_fit() -> None:
    prism = free_prism()
    with pytest.raises(OptionError, match=r"slack: there is no string 's99'.*s1, s2"):
        prestress(prism, slack=["s1", "s99"])
    with pytest.raises(StructureError, match=r"nodes = \[0, 0, 1\] of shape \(3,\); it must be .*\(6, 3\)"):
        self_stress(prism, [0, 0, 1])
    with pytest.raises(StructureError, match=r"force_densities = \[1, 2\] of shape \(2,\); it must be .*\(9,\)"):
        static_forces(prism, [1, 2])
    with pytest.raises(StructureError, match="gravity"):
        self_stress(prism, gravity=[0, 0, math.nan])
    with pytest.raises(StructureError, match="loads"):
        self_stress(prism, loads=np.zeros((2, 3)))


# Structures with it -------------------------------------------------------------------------------------


def test_prestress_holds_the_structure() -> None:
    tight = free_prism().with_strings(force_density=prestress(free_prism(), 2.0))
    lengths = tight.string_lengths(tight.positions)
    u = string_law.force_density(tight.stiffness, lengths, tight.rest_lengths)
    # L0 = L (1 - u/k) is rounded: u to eps k = 2e-14 N/m.
    assert u.min() == pytest.approx(2.0, abs=1e-13)
    assert np.abs(equilibrium_residual(tight, None, u)).max() < 1e-12
    scene = load_scene("prism")
    u = prestress(scene.structure, 0.05, slack=("s2", "s7", "s10"))
    again = scene.structure.with_strings(force_density=u)
    np.testing.assert_allclose(again.rest_lengths, scene.structure.rest_lengths, rtol=1e-14)


def test_a_structure_refuses_a_level_that_strings_cannot_have() -> None:
    prism = free_prism()
    # Verticals get √3 times the level: 100 N/m of stiffness are used up at 57.7 N/m.
    assert prism.with_strings(force_density=prestress(prism, 57.7)).rest_lengths.min() > 0
    with pytest.raises(StructureError, match=r"'s[789]': force_density = 100\.\d+ N/m leaves it a rest length of"):
        prism.with_strings(force_density=prestress(prism, 57.8))


def test_equilibrium_of_a_target_without_gravity() -> None:
    scene = load_scene("prism")
    assert scene.target is not None
    u, residual, modes = equilibrium_force_densities(scene.structure, scene.target.nodes[0])
    assert (np.abs(u).max(), residual, modes) == (0.0, 0.0, 3)
