"""Cables, nets and trusses: their data, their equilibria, the procedure of §3.6, and what is refused."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from equilibria import equilibrium_residual
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.linalg import eigh
from scipy.optimize import brentq

import tensegrity_mj as tmj
from evidence.families.cables import pendulum_frequency, refined, suggest_elements
from tensegrity_mj.errors import InfeasibleError, OptionError, SceneError, StructureError, TensegrityError
from tensegrity_mj.library.cable import (
    Excitation,
    RopeMass,
    Start,
    arc_lengths,
    cable,
    parts,
)
from tensegrity_mj.library.hanging import Held, catenary, hung, net, suspended_cable
from tensegrity_mj.library.truss_arm import truss_arm
from tensegrity_mj.model.members import Rod, Support
from tensegrity_mj.model.motion import Harmonic, Motion
from tensegrity_mj.model.rigidity import free_motions, static_forces
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.statics.self_stress import self_stress

Array = NDArray[np.float64]
G = 9.81


# The cable of chapter 3 ----------------------------------------------------------------------------------


def test_the_default_is_that_of_section_3_3_3() -> None:
    scene = cable()
    structure = scene.structure
    np.testing.assert_allclose(structure.rod_lengths, [0.13, *[0.25] * 11, 0.05], rtol=1e-14)
    np.testing.assert_array_equal(structure.rod_masses, [0.0506, *[0.0129] * 11, 0.0513])
    np.testing.assert_array_equal(structure.rod_nodes, [[k, k + 1] for k in range(13)])
    assert [rod.support.directions != () for rod in structure.rods] == [True] + [False] * 12
    assert (structure.class_number, scene.gravity, scene.duration) == (2, (0.0, 0.0, -9.81), 45.0)
    for t in (0.0, 0.4, 1.9):
        expected = [0.0, 0.05 * math.sin(2 * math.pi * 0.5 * t), 0.0]
        np.testing.assert_allclose(scene.motions[0].at(t)[0], expected, atol=1e-16)


@pytest.mark.parametrize("divisions", range(1, 11))
def test_refined_models_are_those_of_section_3_5_1(divisions: int) -> None:
    elements = refined(divisions)
    assert elements == [13, 25, 37, 49, 61, 73, 85, 97, 109, 121][divisions - 1]
    structure = cable(elements).structure
    n = divisions
    lengths = [0.13 / n] * n + [0.25 / n] * (11 * n) + [0.05]
    masses = [0.0506 / n] * n + [0.0129 / n] * (11 * n) + [0.0513]
    np.testing.assert_allclose(structure.rod_lengths, lengths, rtol=1e-11)  # round-off of coordinates up to 3 m
    np.testing.assert_allclose(structure.rod_masses, masses, rtol=1e-14)
    # Each marker is a node: sums of at most 121 lengths up to 3 m.
    away = np.abs(np.subtract.outer([0.25 * number for number in range(2, 12)], arc_lengths(elements) - 0.13))
    assert away.min(axis=1).max() < 1e-13


@settings(derandomize=True, max_examples=60, deadline=None)
@given(st.integers(3, 600))
def test_any_number_of_elements_keeps_lengths_and_masses(elements: int) -> None:
    along, (fastening, rope) = arc_lengths(elements), parts(elements)
    assert (len(along), fastening + rope + 1) == (elements + 1, elements)
    assert min(fastening, rope) >= 1
    assert along[fastening] == 0.13
    assert along[-2:].tolist() == [2.88, 2.93]
    for mass in RopeMass:
        if elements <= 40:
            total = cable(elements, rope_mass=mass).structure.rod_masses.sum()
            assert total == pytest.approx(0.0506 + 0.0513 + (0.1419, 0.165)[mass is RopeMass.TABLE], rel=1e-12)


def linear_frequencies(scene: Scene) -> Array:
    """Natural frequencies [Hz] of a hanging chain by (3.13) as corrected, and the torques of its weight."""
    length, mass = scene.structure.rod_lengths, scene.structure.rod_masses
    f, J = mass * length / 2, mass * length**2 / 3
    below = np.cumsum(mass[::-1])[::-1] - mass
    M = np.diag(J + length**2 * below)
    for i in range(len(mass)):
        for j in range(i + 1, len(mass)):
            M[i, j] = M[j, i] = length[i] * f[j] + length[i] * length[j] * below[j]
    K = np.diag((mass / 2 + below) * length * G)
    return np.asarray(np.sqrt(eigh(K, M, eigvals_only=True)) / (2 * math.pi))


def test_natural_frequencies_are_those_of_the_hanging_rope() -> None:
    # As computed independently: 0.3242 and 0.9329 Hz, to the digits that these have.
    np.testing.assert_allclose(linear_frequencies(cable())[:2], [0.3242, 0.9329], atol=5e-5)
    found = [linear_frequencies(cable(refined(n)))[:2] for n in (1, 2, 4)]
    # Rods for a rope err as K⁻²: half the element, a fourth of the error, within a tenth of it.
    ratio = (found[0] - found[1]) / (found[1] - found[2])
    np.testing.assert_allclose(ratio, 4.0, rtol=0.1)
    assert linear_frequencies(cable(rope_mass=RopeMass.TABLE))[0] != pytest.approx(0.3242, abs=5e-5)


def test_the_start_is_at_rest_in_the_frame_that_is_requested() -> None:
    rate = 2 * math.pi * 0.5 * 0.05
    moving = cable(5)
    np.testing.assert_allclose(moving.velocities0, np.tile([0.0, rate, 0.0], (6, 1)), rtol=1e-15)
    lab = cable(5, start=Start.LAB_FRAME)
    np.testing.assert_allclose(lab.velocities0, [[0.0, rate, 0.0]] + [[0.0] * 3] * 5, rtol=1e-15)
    for start in Start:
        still = cable(5, start=start, excitation=Excitation.NONE)
        assert still.motions == ()
        assert not np.any(still.velocities0)
    # A motion along the rod takes what hangs on it along, in the lab frame too.
    down = cable(3, motion=Motion.in_line("rod1", 0.1, 1.0, (0, 0, 1)), start=Start.LAB_FRAME)
    np.testing.assert_allclose(down.velocities0[:, 2], 0.2 * math.pi, rtol=1e-13)


def test_a_seed_leans_the_cable_out_of_the_plane_of_excitation() -> None:
    lean = 0.01
    for start in Start:
        scene = cable(seed=lean, start=start)
        np.testing.assert_array_equal(scene.nodes0[:, 1], 0.0)
        np.testing.assert_allclose(scene.nodes0[:, 0], arc_lengths(13) * math.sin(lean), rtol=1e-15)
        np.testing.assert_allclose(scene.nodes0[:, 2], -arc_lengths(13) * math.cos(lean), rtol=1e-15)
        assert not np.any(scene.structure.positions[:, 0])
    shifted = cable(seed=lean, motion=Motion("rod1", (Harmonic((0.2, 0, 0), 1.0, math.pi / 2),)))
    np.testing.assert_allclose(shifted.nodes0[0], [0.2, 0, 0])


def test_a_circle_and_a_plane() -> None:
    circle = cable(excitation=Excitation.CIRCULAR, frequency=0.7)
    d = np.array([circle.motions[0].at(t)[0] for t in np.linspace(0, 1 / 0.7, 200)])
    np.testing.assert_allclose(np.ptp(d, axis=0), [0.1, 0.1, 0.0], rtol=1e-3)  # peak to peak, in 200 samples
    planar = cable(planar=True)
    assert {rod.support.plane for rod in planar.structure.rods} == {(1.0, 0.0, 0.0)}
    np.testing.assert_array_equal(planar.velocities0, cable().velocities0)


def test_the_start_decides_how_far_marker_10_swings() -> None:
    """In-line 0.7 Hz: relative amplitude 4.30 from rest in the moving frame, 2.00 from rest in the lab (ERRATA 27).

    The largest distance of successive extremes over 45 s, which other formulations have found to these digits.
    """
    for start, expected in ((Start.MOVING_FRAME, 4.30), (Start.LAB_FRAME, 2.00)):
        scene = cable(frequency=0.7, start=start, planar=True)
        run = tmj.simulate(scene, None, tmj.DAE(rtol=1e-7, atol=1e-8), output_interval=0.01)
        y = run.nodes[:, 12, 1]
        turns = np.flatnonzero(np.diff(np.sign(np.diff(y)))) + 1
        # Samples 0.01 s apart miss an extreme by (ω h)²/8 of it, 1e-3 at 1 Hz.
        assert np.abs(np.diff(y[turns])).max() / 0.1 == pytest.approx(expected, abs=0.01)


# The procedure of §3.6 -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("length", "printed"), [(0.25, 1.22), (0.05, 2.73), (0.13, 1.69), (0.025, 3.86), (0.013, 5.35)]
)
def test_pendulum_frequencies_are_those_of_figure_3_11(length: float, printed: float) -> None:
    found = pendulum_frequency(length)
    assert found == pytest.approx(printed, abs=0.006)  # the text has two, the figure's curves end near the others
    # The frequency that the linearized model of one such rod has.
    rod = Rod("rod", ("a", "b"), 0.7, support=Support.pinned(plane=(0, 1, 0)))
    scene = Scene(Structure("rod", {"a": (0, 0, 0), "b": (0, 0, -length)}, (rod,)), gravity=(0, 0, -G))
    assert found == pytest.approx(float(tmj.linearize(scene).frequencies[0]), rel=1e-7)  # differences of its forces


@settings(derandomize=True, max_examples=100, deadline=None)
@given(st.floats(0.05, 5.0), st.floats(0.1, 30.0), st.floats(0.5, 4.0), st.floats(1.0, 25.0))
def test_the_suggestion_is_the_fewest_that_will_do(frequency: float, length: float, ratio: float, g: float) -> None:
    found = suggest_elements(frequency, length, ratio, g)
    assert found.length * found.elements == pytest.approx(length, rel=1e-15)
    assert found.frequency == pendulum_frequency(found.length, g)
    assert found.frequency >= ratio * frequency * (1 - 1e-11)
    if found.elements > 1:
        assert pendulum_frequency(length / (found.elements - 1), g) < ratio * frequency


def test_suggestions_for_the_cable() -> None:
    # Twice 0.6105 Hz is what elements of 0.25 m have: just enough of them, and one more a little above.
    exact = pendulum_frequency(0.25) / 2
    assert suggest_elements(exact, 2.75).elements == 11
    assert suggest_elements(exact * 1.0001, 2.75).elements == 12
    # The thesis' conclusion: 49 or 61 elements for up to 1.20 Hz, by elements of 0.0625 and 0.05 m.
    suggestion = suggest_elements(1.2, 2.88)
    assert pendulum_frequency(0.0647) == pytest.approx(2.4, abs=0.002)
    assert (suggestion.elements, round(suggestion.length, 4)) == (45, 0.064)
    assert suggest_elements(1e-3, 2.75).elements == 1


# Equilibria ----------------------------------------------------------------------------------------------


def chain_by_statics(count: int, length: float, span: float, rise: float) -> Array:
    """Joints of a hanging chain of equal rods: the slope of a rod is the vertical force in it over the horizontal."""
    ell, share = length / count, (np.arange(count) + 0.5) / count

    def ends(V: float, H: float) -> Array:
        slope = (share - V) / H  # weights in that of the chain; V is what the left support carries
        b = ell * np.column_stack([np.ones(count), slope]) / np.sqrt(1 + slope**2)[:, None]
        return np.vstack([np.zeros(2), np.cumsum(b, axis=0)])

    def right(H: float) -> float:
        return float(brentq(lambda V: ends(V, H)[-1, 1] - rise, -50, 50, xtol=1e-15))

    H = float(brentq(lambda H: ends(right(H), H)[-1, 0] - span, 1e-3, 50, xtol=1e-15))
    return ends(right(H), H)


@pytest.mark.parametrize(
    ("count", "span", "rise"), [(3, 2.0, 0.0), (22, 2.0, 0.0), (22, 2.7, 0.0), (22, 1.0, 1.5), (60, 0.5, -1.0)]
)
def test_a_suspended_cable_starts_where_it_hangs(count: int, span: float, rise: float) -> None:
    scene = suspended_cable(count, span=span, rise=rise, amplitude=0.0)
    nodes = scene.nodes0
    expected = chain_by_statics(count, 2.75, span, rise)
    # Both solve to round-off of 1e-15; a taut chain's shape has a condition number of up to 10³ against its ends.
    np.testing.assert_allclose(nodes[:, [0, 2]], expected, atol=1e-11)
    np.testing.assert_array_equal(nodes[:, 1], 0.0)
    np.testing.assert_allclose(scene.structure.rod_lengths, 2.75 / count, rtol=1e-12)
    assert scene.structure.rod_masses.sum() == pytest.approx(0.165)
    assert [k for k, rod in enumerate(scene.structure.rods) if rod.support.directions] == [0, count - 1]


def test_many_rods_hang_as_a_catenary() -> None:
    a = brentq(lambda a: 2 * a * math.sinh(1.0 / a) - 2.75, 0.3, 10.0)
    sag = a * (math.cosh(1.0 / a) - 1)
    misses = [abs(-suspended_cable(n, amplitude=0.0).nodes0[n // 2, 2] - sag) for n in (20, 40, 80)]
    # The polygon's error is of order n⁻²: a fourth for twice as many, within a tenth of it.
    assert misses[0] / misses[1] == pytest.approx(4, rel=0.1)
    assert misses[1] / misses[2] == pytest.approx(4, rel=0.1)


@pytest.mark.parametrize(
    ("count", "span", "rise"),
    [(500, 2.0, 0.3), (22, 1e-100, 0.0), (21, 1e-3, 0.0), (40, 0.1, -2.6), (22, 2.75 - 1e-9, 0.0)],
)
def test_fine_folded_steep_and_taut_cables_hang(count: int, span: float, rise: float) -> None:
    scene = suspended_cable(count, span=span, rise=rise, amplitude=0.0)
    # From where it hangs nothing has to move: that is what an equilibrium is.
    again = hung(scene.structure, 2.75 / count, G).positions
    # A fold less wide than its rods are long turns about its lowest joints by little: their height is of second order.
    np.testing.assert_allclose(scene.nodes0[:, 2], again[:, 2], atol=1e-9)
    np.testing.assert_allclose(scene.nodes0[[0, -1]], [[0, 0, 0], [span, 0, rise]], atol=1e-15)
    np.testing.assert_allclose(scene.structure.rod_lengths, 2.75 / count, rtol=1e-10)


@pytest.mark.parametrize(("span", "rise"), [(2.0, 0.0), (0.3, 1.0), (1.0, -2.0)])
def test_the_catenary_has_its_length_and_its_curvature(span: float, rise: float) -> None:
    nodes = catenary(span, rise, 2.75, 4000)
    steps = np.diff(nodes[:, [0, 2]], axis=0)
    # Chords of a smooth curve are short by (length / count)² / 24 curvature², here 2e-8 / a² of the whole.
    np.testing.assert_allclose(nodes[[0, -1]], [[0, 0, 0], [span, 0, rise]], atol=1e-14)
    assert np.linalg.norm(steps, axis=1).sum() == pytest.approx(2.75, rel=1e-5)
    # Equal weights: the slope grows by the same for each step, as horizontal pull times slope is the weight below.
    slopes = np.diff(steps[:, 1] / steps[:, 0])
    np.testing.assert_allclose(slopes, slopes.mean(), rtol=1e-3)


def unbalanced(structure: Structure, held: list[int]) -> float:
    """The largest force [N] left on a joint when rods carry what they can, their weights on their ends."""
    i, j = structure.rod_nodes.T
    b = structure.positions[j] - structure.positions[i]
    forces = np.zeros((len(structure.nodes), 3))
    for ends in (i, j):
        np.add.at(forces[:, 2], ends, -structure.rod_masses / 2 * G)
    matrix = np.zeros((len(structure.nodes), 3, len(b)))
    rows = np.arange(len(b))
    matrix[i, :, rows], matrix[j, :, rows] = b, -b
    keep = np.setdiff1d(np.arange(len(structure.nodes)), held)
    flat, load = matrix[keep].reshape(-1, len(b)), forces[keep].ravel()
    tension = np.linalg.lstsq(flat, -load, rcond=None)[0]
    return float(np.abs(flat @ tension + load).max())


NETS: list[dict[str, Any]] = [
    {},
    {"cells": (5, 3), "slack": 0.25},
    {"cells": (6, 3), "held": Held.EDGES},
    {"cells": (2, 1), "held": Held.EDGES},
    {"cells": (2, 2), "gravity": 1.6, "spacing": 3.0},
    {"cells": (12, 3)},  # whose first guess is so far off that springs must lead to where it hangs
]


@pytest.mark.parametrize("options", NETS, ids=str)
def test_a_net_starts_where_it_hangs(options: dict[str, Any]) -> None:
    scene = net(**options)
    structure = scene.structure
    across, along = options.get("cells", (4, 4))
    spacing, slack = options.get("spacing", 0.25), options.get("slack", 0.1)
    edges = options.get("held") is Held.EDGES
    np.testing.assert_allclose(structure.rod_lengths, spacing, rtol=1e-12)
    assert len(structure.rods) == across * (along + 1) + along * (across + 1) - (2 * along if edges else 0)
    names = [f"n{i}_{j}" for i in (0, across) for j in (range(along + 1) if edges else (0, along))]
    rows = [structure.node_index[name] for name in names]
    held = sorted(
        structure.node_index[rod.nodes[int(rod.support.sigma)]] for rod in structure.rods if rod.support.directions
    )
    assert held == sorted(rows)
    corners = structure.positions[[structure.node_index[f"n0_{0}"], structure.node_index[f"n{across}_{along}"]]]
    wide = np.array([across * (1 - slack), along * (1.0 if edges else 1 - slack)]) * spacing
    np.testing.assert_allclose(corners, [[0, 0, 0], [*wide, 0]], atol=1e-15)
    weight = structure.rod_masses.sum() * G
    assert unbalanced(structure, rows) < 1e-11 * weight  # eps times a few hundred rods
    # As it is symmetric, so does it hang.
    z = structure.positions[:, 2].reshape(across + 1, along + 1)
    for other in (z[::-1], z[:, ::-1]):
        np.testing.assert_allclose(other, z, atol=1e-9)
    # Stable: whatever the rods allow lifts it, to second order, by their tensions.
    i, j = structure.rod_nodes.T
    again = hung(structure, spacing, options.get("gravity", G))
    np.testing.assert_allclose(again.positions, structure.positions, atol=1e-9 * spacing)
    found = static_forces(structure, np.zeros(0), gravity=(0.0, 0.0, -G))
    free = np.setdiff1d(np.arange(len(structure.nodes)), rows)
    rigidity = np.zeros((len(i), len(structure.nodes), 3))
    rigidity[np.arange(len(i)), j] = structure.positions[j] - structure.positions[i]
    rigidity[np.arange(len(i)), i] = -rigidity[np.arange(len(i)), j]
    _, singular, vt = np.linalg.svd(rigidity[:, free].reshape(len(i), -1))
    moves = vt[int(np.sum(singular > 1e-9 * singular[0])) :]
    incidence = np.zeros((len(i), len(structure.nodes)))
    incidence[np.arange(len(i)), j], incidence[np.arange(len(i)), i] = 1.0, -1.0
    stress = np.kron((incidence.T @ (found.rod_force_densities[:, None] * incidence))[np.ix_(free, free)], np.eye(3))
    assert len(moves) > 0
    assert np.linalg.eigvalsh(moves @ stress @ moves.T).min() > 0


def test_what_hangs_stays() -> None:
    """No node of a cable or net at rest in its equilibrium moves: the engine sees the balance that the builder made."""
    for scene in (suspended_cable(12, amplitude=0.0, duration=0.3), net(load=0.0, duration=0.3)):
        run = tmj.simulate(scene, None, tmj.DAE())
        # Round-off of forces, 1e-15 of a weight, gives accelerations of 1e-13 m/s² at most: 1e-14 m in 0.3 s. The
        # tolerance of the integrator, 1e-12 m, hides them.
        assert np.abs(run.nodes - scene.nodes0).max() < 1e-10


def chain(nodes: Array, mass: float) -> Structure:
    """Rods of that mass [kg] one after another along nodes (K + 1, 3), held at both ends."""
    count = len(nodes) - 1
    held = {0: Support.pinned(0.0), count - 1: Support.pinned(1.0)}
    supports = [held.get(k, Support.free()) for k in range(count)]
    pairs = [(k, k + 1) for k in range(count)]
    return Structure.from_arrays(nodes, pairs, [], rod_mass=mass, stiffness=[], supports=supports)


def test_a_guess_that_stands_on_its_head_still_hangs() -> None:
    """From an arch, whose rods are compressed, the energy falls to where the chain hangs."""
    count, span = 9, 2.0
    along = np.linspace(0, 1, count + 1)
    arch = np.column_stack([span * along, 0.02 * np.sin(np.pi * along), 3.0 * along * (1 - along)])
    found = hung(chain(arch, 0.165 / count), 2.75 / count, G)
    np.testing.assert_allclose(found.positions[:, [0, 2]], chain_by_statics(count, 2.75, span, 0.0), atol=1e-11)
    assert static_forces(found, np.zeros(0), gravity=(0.0, 0.0, -G)).rod_force_densities.min() > 0


@pytest.mark.parametrize("build", [suspended_cable, net])
def test_the_statics_of_linked_rods_are_those_of_the_engine(build: Callable[..., Scene]) -> None:
    scene = build(**({"amplitude": 0.0} if build is suspended_cable else {"load": 0.0}))
    structure, weight = scene.structure, scene.structure.rod_masses.sum() * G
    left = equilibrium_residual(structure, None, np.zeros(0), scene.gravity)
    assert np.abs(left).max() < 1e-12 * weight
    found = static_forces(structure, np.zeros(0), gravity=scene.gravity)
    run = tmj.simulate(scene, None, tmj.DAE(), duration=0.01)
    # Both solve for what rods pass on to each other, to round-off.
    scale = np.abs(run.rod_force_densities[0]).max()
    np.testing.assert_allclose(found.rod_force_densities, run.rod_force_densities[0], atol=1e-10 * scale)
    np.testing.assert_allclose(found.support_forces.sum(axis=0), [0, 0, weight], atol=1e-11 * weight)


def test_motions_and_self_stress_of_linked_rods() -> None:
    """By hand: what is free, of the whole as one body, and what of the rest no string feels."""
    expected = {
        # 13 rods that swing both ways; the whole turns about two of the axes (its own is none).
        "cable": (26, 2, 24, 0),
        # 21 joints move in space, and keep 40 lengths.
        "net": (23, 0, 23, 0),
        # Three cells shear, each kept from it by two strings.
        "truss_arm": (3, 0, 0, 3),
        # The square turns as a whole in its plane, and shears, which both strings feel: one of them would do.
        "dbar": (2, 1, 0, 1),
    }
    for name, (free, rigid, mechanisms, modes) in expected.items():
        stress = self_stress(tmj.load_scene(name).structure)
        counted = (stress.free_coordinates, stress.rigid_motions, stress.mechanisms, len(stress.modes))
        assert counted == (free, rigid, mechanisms, modes), name
    # Both strings of the square pull alike, and so much are the bars compressed.
    structure = tmj.load_scene("dbar").structure
    mode = self_stress(structure)
    np.testing.assert_allclose(mode.modes[0], np.sqrt([0.5, 0.5]), rtol=1e-12)
    np.testing.assert_allclose(mode.forces[0].rod_force_densities, -np.sqrt(0.5), rtol=1e-12)


@settings(derandomize=True, max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 3))
def test_free_motions_of_linked_rods_keep_what_is_rigid(seed: int, loops: int) -> None:
    """Their span is the null space of the rods' lengths and of the supports, which is found without them."""
    rng = np.random.default_rng(seed)
    places = rng.normal(size=(7, 3))
    pairs = [(int(rng.integers(k)), k) for k in range(1, 7)]
    while len(pairs) < 6 + loops:
        pair = tuple(sorted(rng.choice(7, 2, replace=False).tolist()))
        if pair not in pairs:
            pairs.append(pair)
    supports = [Support.free(float(rng.uniform())) for _ in pairs]
    supports[2] = Support.constrained(rng.normal(size=(2, 3)), 0.3)
    structure = Structure.from_arrays(places, pairs, [], rod_mass=1.0, stiffness=[], supports=supports)
    rows = np.zeros((len(pairs) + 2, 7, 3))
    for row, (i, j) in enumerate(pairs):
        rows[row, i], rows[row, j] = places[i] - places[j], places[j] - places[i]
    i, j = pairs[2]
    rows[-2:, i], rows[-2:, j] = 0.7 * np.array(supports[2].directions), 0.3 * np.array(supports[2].directions)
    flat = rows.reshape(len(rows), -1)
    motions = free_motions(structure)
    rank = np.linalg.matrix_rank(flat, tol=1e-9)
    assert motions.shape == (21, 21 - rank)
    assert np.linalg.matrix_rank(motions, tol=1e-9) == 21 - rank
    assert np.abs(flat @ motions).max() < 1e-12


def test_no_equilibrium_is_said() -> None:
    apart = chain(np.array([[0.0, 0, 0], [1, 0, 0], [3, 0, 0]]), 1.0)
    with pytest.raises(InfeasibleError, match="in no equilibrium that could be found"):
        hung(apart, 1.0, G)


# The truss -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("cells", "braced"), [(4, 1), (1, 0), (3, 3), (6, 2), (5, 0)])
def test_a_truss_arm_is_as_free_as_its_strings_and_has_one_rod_too_many_a_brace(cells: int, braced: int) -> None:
    structure = truss_arm(cells, braced).structure
    assert len(structure.rods) == 3 * cells + 2 * braced
    assert len(structure.strings) == 2 * (cells - braced)
    free = [row for name, row in structure.node_index.items() if name not in ("b0", "t0")]
    i, j = structure.rod_nodes.T
    b = structure.positions[j] - structure.positions[i]
    rigidity = np.zeros((len(b), len(structure.nodes), 3))
    rigidity[np.arange(len(b)), i], rigidity[np.arange(len(b)), j] = -b, b
    rank = np.linalg.matrix_rank(rigidity[:, free][:, :, [0, 2]].reshape(len(b), -1), tol=1e-9)
    assert len(b) - rank == braced
    assert 2 * len(free) - rank == cells - braced
    # Straight and without weight it is in balance: rods take up what the strings pull.
    s = np.zeros((len(structure.nodes), 3))
    for string, (k, m) in zip(structure.strings, structure.string_nodes, strict=True):
        pull = (string.tension or 0.0) * (structure.positions[m] - structure.positions[k])
        s[k] += pull
        s[m] -= pull
    matrix, load = rigidity[:, free].reshape(len(b), -1).T, s[free].ravel()
    rest = matrix @ np.linalg.lstsq(matrix, load, rcond=None)[0] - load
    assert np.abs(rest).max() < 1e-13


def test_the_truss_arm_sags_and_its_braced_cell_stays() -> None:
    scene = truss_arm(duration=0.2)
    run = tmj.simulate(scene, None, tmj.DAE())
    still = [scene.structure.node_index[name] for name in ("b0", "t0", "b1", "t1")]
    np.testing.assert_allclose(
        run.nodes[:, still], np.broadcast_to(scene.nodes0[still], run.nodes[:, still].shape), atol=1e-8
    )
    assert run.nodes[-1, scene.structure.node_index["b4"], 2] < -1e-3
    assert np.abs(run.nodes[:, :, 1]).max() == 0.0


# What is refused -----------------------------------------------------------------------------------------

REFUSED: dict[str, tuple[Callable[[], object], type[TensegrityError], tuple[str, ...]]] = {
    "elements": (lambda: cable(2), OptionError, ("cable: elements = 2", ">= 3")),
    "elements that are none": (lambda: cable(13.0), OptionError, ("elements = 13.0", "integer")),  # type: ignore[arg-type]
    "true elements": (lambda: cable(True), OptionError, ("elements = True", "integer")),
    "divisions": (lambda: refined(0), OptionError, ("divisions = 0", ">= 1")),
    "rope mass": (lambda: cable(rope_mass="chair"), OptionError, ("'chair'", "RopeMass.ELEMENTS, RopeMass.TABLE")),  # type: ignore[arg-type]
    "excitation": (lambda: cable(excitation=1), OptionError, ("excitation = 1", "Excitation.IN_LINE")),  # type: ignore[arg-type]
    "start": (lambda: cable(start="lab"), OptionError, ("start = 'lab'", "Start.LAB_FRAME")),  # type: ignore[arg-type]
    "amplitude": (lambda: cable(amplitude=-0.1), OptionError, ("cable: amplitude = -0.1", "> 0 m")),
    "frequency": (lambda: cable(frequency=math.nan), OptionError, ("cable: frequency = nan", "> 0 Hz")),
    "motion": (lambda: cable(motion="sine"), OptionError, ("motion = 'sine'", "Motion.in_line('rod1'")),  # type: ignore[arg-type]
    "motion of another rod": (
        lambda: cable(motion=Motion.in_line("rod2", 1, 1, (1, 0, 0))),
        OptionError,
        ("motion is that of 'rod2'", "'rod1'"),
    ),
    "seed": (lambda: cable(seed="small"), OptionError, ("cable: seed = 'small'", "[rad]")),  # type: ignore[arg-type]
    "planar": (lambda: cable(planar=1), OptionError, ("planar = 1", "True or False")),  # type: ignore[arg-type]
    "planar and leaning": (lambda: cable(planar=True, seed=0.1), OptionError, ("seed = 0.1 rad", "planar")),
    "planar circle": (
        lambda: cable(planar=True, excitation=Excitation.CIRCULAR),
        OptionError,
        ("circular", "planar", "in-line"),
    ),
    "planar motion": (
        lambda: cable(planar=True, motion=Motion.in_line("rod1", 1, 1, (1, 0, 0))),
        SceneError,
        ("'rod1'", "plane of normal (1.0, 0.0, 0.0)"),
    ),
    "gravity": (lambda: cable(gravity=0.0), OptionError, ("cable: gravity = 0.0", "> 0 m/s²")),
    "duration": (lambda: cable(duration=0.0), SceneError, ("duration = 0.0", "> 0 s")),
    "name": (lambda: cable(name=3), OptionError, ("cable: name = 3", "text")),  # type: ignore[arg-type]
    "suggested frequency": (lambda: suggest_elements(0, 1), OptionError, ("frequency = 0", "> 0 Hz")),
    "suggested length": (lambda: suggest_elements(1, -1), OptionError, ("length = -1", "> 0 m")),
    "suggested ratio": (lambda: suggest_elements(1, 1, 0.0), OptionError, ("ratio = 0.0", "> 0")),
    "suggested gravity": (lambda: suggest_elements(1, 1, 2.0, 0.0), OptionError, ("gravity = 0.0", "> 0 m/s²")),
    "too many": (lambda: suggest_elements(1e4, 1e3), OptionError, ("frequency = 10000.0 Hz", "more than a million")),
    "pendulum": (lambda: pendulum_frequency(0.0), OptionError, ("length = 0.0", "> 0 m")),
    "suspended elements": (lambda: suspended_cable(2), OptionError, ("suspended_cable: elements = 2", ">= 3")),
    "taut": (lambda: suspended_cable(span=2.75), OptionError, ("length = 2.75 m", "2.78 m", "apart")),
    "taut by its motion": (lambda: suspended_cable(span=2.74), OptionError, ("2.77 m",)),
    "taut by its rise": (lambda: suspended_cable(rise=2.0), OptionError, ("2.84972 m", "apart")),
    "suspended amplitude": (lambda: suspended_cable(amplitude=-1.0), OptionError, ("amplitude = -1.0;", ">= 0 m")),
    "suspended frequency": (lambda: suspended_cable(frequency=0.0), OptionError, ("frequency = 0.0", "> 0 Hz")),
    "suspended mass": (lambda: suspended_cable(mass=0.0), OptionError, ("mass = 0.0", "> 0 kg")),
    "cells": (lambda: net((4,)), OptionError, ("net: cells = (4,)", "two numbers")),  # type: ignore[arg-type]
    "cells as a number": (lambda: net(4), OptionError, ("net: cells = 4", "two numbers")),  # type: ignore[arg-type]
    "cells of halves": (lambda: net((4, 1.5)), OptionError, ("cells = 1.5", "integer")),  # type: ignore[arg-type]
    "one cell": (lambda: net((2, 1)), OptionError, ("net: cells = (2, 1)", "2 or more")),
    "net held": (lambda: net(held="edge"), OptionError, ("held = 'edge'", "Held.EDGES")),  # type: ignore[arg-type]
    "slack": (lambda: net(slack=0.0), OptionError, ("slack = 0.0", "(0, 1)")),
    "net load": (lambda: net(load=-1.0), OptionError, ("load = -1.0;", ">= 0 N")),
    "viscous": (lambda: cable(viscous=np.ones(2)), OptionError, ("cable: viscous = [1.0, 1.0]",)),  # type: ignore[arg-type]
    "bending": (lambda: cable(bending_stiffness=-1.0), OptionError, ("cable: bending_stiffness = -1.0", ">= 0")),
    "drag": (lambda: cable(drag=np.ones(2)), OptionError, ("cable: drag = [1.0, 1.0]",)),  # type: ignore[arg-type]
    "cells that are none": (lambda: net(None), OptionError, ("net: cells = None", "two numbers")),  # type: ignore[arg-type]
    "very fast": (lambda: cable(frequency=1e60), SceneError, ("6.28319e+60 rad/s", "no finite acceleration")),
    "very long": (lambda: suspended_cable(length=1e300), OptionError, ("length = 1e+300", "magnitude")),
    "very long cells": (lambda: truss_arm(cell_length=1e300), OptionError, ("cell_length = 1e+300", "magnitude")),
    "truss cells": (lambda: truss_arm(0), OptionError, ("truss_arm: cells = 0", ">= 1")),
    "braced": (lambda: truss_arm(2, 3), OptionError, ("braced = 3", "at most", "2")),
    "line mass": (lambda: truss_arm(line_mass=0.0), OptionError, ("line_mass = 0.0", "> 0 kg/m")),
    "truss tension": (lambda: truss_arm(tension=-1.0), StructureError, ("tension = -1.0", ">= 0")),
}


@pytest.mark.parametrize("case", REFUSED)
def test_bad_parameters_are_refused_and_named(case: str) -> None:
    make, error, words = REFUSED[case]
    with pytest.raises(error) as caught:
        make()
    for word in words:
        assert word in str(caught.value)
