"""The largest stable step where rods share nodes, hang by gravity, or have no strings: closed forms, and runs."""

from __future__ import annotations

import math
import warnings
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest
from linked_scenes import (
    FOUR_BAR,
    GRAVITY,
    four_bar,
    four_bar_nodes,
    hanging_chain,
    random_tree,
    suspended,
    thesis_cable,
)
from numpy.typing import NDArray

import tensegrity_mj as tmj
from evidence.random_linked import random_linked_structure
from evidence.stability.cases import joined_points, joined_scene, scene_at_rest
from evidence.stability.study import at_rest
from tensegrity_mj import Integrator, Method, Scene, Structure, stable_step
from tensegrity_mj.engines import Drift
from tensegrity_mj.engines.mujoco.mjcf import scene_to_mjcf
from tensegrity_mj.engines.table import engine_of
from tensegrity_mj.errors import StabilityWarning, StructureError
from tensegrity_mj.library.cable import Excitation, cable
from tensegrity_mj.model import Motion
from tensegrity_mj.model.elements.resistance import Bending, Resistance
from tensegrity_mj.model.forest import spanning_forest
from tensegrity_mj.model.members import Rod, String, Support
from tensegrity_mj.model.motion import Harmonic
from tensegrity_mj.model.moved_supports import velocities_with_supports
from tensegrity_mj.model.rods import lumped_masses, string_forces
from tensegrity_mj.statics.equilibrium import balance
from tensegrity_mj.statics.model import StaticModel
from tensegrity_mj.vibration.bodies import Bodies
from tensegrity_mj.vibration.bounds import bounds_at
from tensegrity_mj.vibration.integrators import limit_of, system_matrix, tree_limit, tree_model
from tensegrity_mj.vibration.small_motions import Vibration, vibration
from tensegrity_mj.vibration.step_warnings import explain_warnings
from tensegrity_mj.vibration.stepping import Scheme

Array = NDArray[np.float64]
G = 9.81
Y = (0.0, 1.0, 0.0)


def model_of(scene: Scene, time: float = 0.0) -> Vibration:
    return vibration(scene, scene.nodes0, scene.velocities0, scene.structure.rest_lengths, time=time)


def squares(model: Vibration) -> Array:
    """ω² of the motions that joints and supports allow, ascending."""
    K = model.material + model.geometric
    K = K if isinstance(K, np.ndarray) else K.toarray()
    P = np.eye(model.size) if model.state.joints is None else model.state.joints.projection
    moved = np.array([model.motion(column) for column in P]).reshape(model.size, -1)
    # An orthonormal basis of what moves nodes at all: y of what supports forbid moves nothing.
    U, size, _ = np.linalg.svd(P @ moved)
    Z = U[:, : int(np.sum(size > 1e-9 * size[0]))]
    return np.linalg.eigvalsh(Z.T @ K @ Z)


# Closed forms -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("sigma", [0.0, 0.25])
def test_a_pendulum_without_strings(sigma: float) -> None:
    # Uniform rod about the point at σ, centre of mass d = (1/2 - σ) ℓ below: ω² = m g d / J,
    # J = m ℓ² (1 - 3 σ + 3 σ²) / 3; for σ = 0 it is 3 g / 2 ℓ.
    length = 0.7
    rod = Rod("rod", ("a", "b"), 2.0, support=Support.pinned(sigma))
    structure = Structure("pendulum", {"a": (0, 0, 0), "b": (0, 0, -length)}, rods=(rod,))
    omega = math.sqrt(G * (0.5 - sigma) / (length * (1 - 3 * sigma + 3 * sigma**2) / 3))
    scene = Scene(structure, gravity=GRAVITY)
    for name, reach in (("euler", 2.0), ("implicitfast", 2.0), ("discrete", 2.0), ("rk4", 8**0.5), ("dae", 8**0.5)):
        found = stable_step(scene, engine_of(name, 1.0))
        assert found.omega == pytest.approx(omega, rel=1e-12)
        assert found.limit == pytest.approx(reach / omega, rel=1e-12)
        assert (found.rod, found.string) == ("rod", "")


def test_a_double_pendulum() -> None:
    # Two unequal uniform rods, small angles: M = [[m1/3 + m2, m2/2], [m2/2, m2/3]] of θ ℓ, K = g diag((m1/2 + m2)/ℓ1,
    # m2/(2 ℓ2)), from T = m1 ℓ1² θ1'²/6 + m2 (ℓ1² θ1'² + ℓ1 ℓ2 θ1' θ2' + ℓ2² θ2'²/3)/2 and V; det(K - ω² M) = 0.
    (l1, l2), (m1, m2) = (0.4, 0.9), (1.3, 0.6)
    a, b, c = m1 / 3 + m2, m2 / 2, m2 / 3
    k1, k2 = G * (m1 / 2 + m2) / l1, G * m2 / (2 * l2)
    expected = np.sort(np.roots([a * c - b * b, -(a * k2 + c * k1), k1 * k2]).real)
    np.testing.assert_allclose(squares(model_of(hanging_chain((l1, l2), (m1, m2), planar=True))), expected, rtol=1e-12)
    in_space = squares(model_of(hanging_chain((l1, l2), (m1, m2))))
    np.testing.assert_allclose(in_space, np.repeat(expected, 2), rtol=1e-12)


def chain_squares(lengths: Array, masses: Array) -> Array:
    """ω² of (3.13), corrected: small angles θ_i of a hanging chain, M θ'' + K θ = 0.

    Velocities of the centre of rod k: Σ_{i<k} ℓ_i θ_i' + ℓ_k θ_k'/2. V = Σ_i ℓ_i (m_i/2 + Σ_{k>i} m_k) g θ_i²/2.
    """
    count = len(lengths)
    below = np.cumsum(masses[::-1])[::-1] - masses
    to_centers = np.tril(np.tile(lengths, (count, 1)), -1) + np.diag(lengths / 2)
    M = to_centers.T @ np.diag(masses) @ to_centers + np.diag(masses * lengths**2 / 12)
    K = np.diag(G * lengths * (masses / 2 + below))
    return np.sort(np.linalg.eigvals(np.linalg.solve(M, K)).real)


def test_the_cable_of_chapter_3() -> None:
    scene = thesis_cable()
    lengths, masses = scene.structure.rod_lengths, scene.structure.rod_masses
    expected = chain_squares(lengths, masses)
    # f1 and f2 as ERRATA 23 has them to four digits.
    np.testing.assert_allclose(np.sqrt(expected[:2]) / (2 * np.pi), [0.3242, 0.9329], atol=6e-5)
    np.testing.assert_allclose(squares(model_of(scene)), np.repeat(expected, 2), rtol=1e-10)


@pytest.mark.parametrize(("elements", "printed"), [(13, 0.70), (25, 1.51), (37, 2.32), (49, 3.14), (121, 8.09)])
def test_the_stiffest_motion_of_refined_cables(elements: int, printed: float) -> None:
    scene = cable(elements, excitation=Excitation.NONE)
    found = stable_step(scene, tmj.DAE(method=Method.RK4, timestep=0.01))
    assert 0.01 * found.omega == pytest.approx(printed, abs=5.1e-3)
    structure = scene.structure
    expected = math.sqrt(chain_squares(structure.rod_lengths, structure.rod_masses)[-1])
    # Up to 30 rods from dense matrices; beyond from iterations that stop at 1e-9 of ω².
    assert found.omega == pytest.approx(expected, rel=1e-8)
    # ERRATA 26: the thesis' step of 0.01 s is within RK4's limit at 37 elements and beyond it at 49.
    assert (found.limit > 0.01) == (elements < 49)


def test_a_spinning_double_pendulum_is_held_by_what_its_joints_carry() -> None:
    # Two equal rods in line turn about a pin with Ω, without gravity. Small tilts θ1, θ2 out of the plane: distances
    # from the axis are ρ = s cos θ1, then ℓ cos θ1 + s cos θ2, and V = -Ω² ∫ ρ² dm / 2 gives
    # K = m ℓ² Ω² diag(1/3 + 3/2, 1/2 + 1/3), with M = m ℓ² [[4/3, 1/2], [1/2, 1/3]]. One ω is Ω: the plane tilts.
    rate = 3.0
    M, K = np.array([[4 / 3, 1 / 2], [1 / 2, 1 / 3]]), rate**2 * np.diag([11 / 6, 5 / 6])
    across = np.sort(np.linalg.eigvals(np.linalg.solve(M, K)).real)
    assert across[0] == pytest.approx(rate**2)
    # In the plane, joints alone hold (a rod by itself turns freely): 3/2, and 3/4 of what its center is held with at
    # ℓ/2. The whole truth is [[1, -1], [-1, 1]]/2, less by [[4, 2], [2, 1]]/4, which is not below zero.
    inside = np.linalg.eigvals(np.linalg.solve(M, rate**2 * np.diag([3 / 2, 3 / 4]))).real
    expected = np.sort(np.concatenate([across, inside]))
    np.testing.assert_allclose(squares(model_of(spinning(rate))), expected, rtol=1e-9)
    assert np.abs(squares(model_of(spinning(0.0)))).max() < 1e-12


def spinning(rate: float) -> Scene:
    structure = Structure(
        "spinning",
        {"o": (0, 0, 0), "a": (1, 0, 0), "b": (2, 0, 0)},
        rods=(Rod("r0", ("o", "a"), 1.0, support=Support.pinned()), Rod("r1", ("a", "b"), 1.0)),
    )
    nodes = structure.positions
    return Scene(structure, initial_velocities=np.cross([0, 0, rate], nodes))


@pytest.mark.parametrize("planar", [False, True])
def test_a_pendulum_whose_support_moves(planar: bool) -> None:
    # d = a sin(w t + π/2) upwards: d̈(0) = -a w², so that the rod weighs m (g - a w²) at t = 0, m g where d = 0.
    amplitude, omega = 0.02, 12.0
    motion = Motion("r0", (Harmonic((0.0, 0.0, amplitude), omega, math.pi / 2),))
    scene = hanging_chain((0.7,), (2.0,), (motion,), planar)
    for time, gravity in ((0.0, G - amplitude * omega**2), (math.pi / 2 / omega, G)):
        squared = 1.5 * gravity / 0.7
        assert squares(model_of(scene, time))[-1] == pytest.approx(squared, rel=1e-12)
        nodes = scene.nodes0 + motion.at(time)[0] - motion.at(0.0)[0]
        limit = stable_step(scene, tmj.MuJoCo(integrator=Integrator.EULER), nodes=nodes, time=time).limit
        assert limit == pytest.approx(2 / math.sqrt(squared), rel=1e-12)


def test_two_links_of_a_chain_whose_support_moves() -> None:
    # Weighed by g - d̈ as a whole: ω² in proportion.
    motion = Motion("r0", (Harmonic((0.0, 0.0, -0.03), 10.0, math.pi / 2),))  # d̈(0) = +3 m/s²
    moved, still = (model_of(hanging_chain((0.4, 0.9), (1.3, 0.6), motions)) for motions in ((motion,), ()))
    np.testing.assert_allclose(squares(moved), squares(still) * (G + 3.0) / G, rtol=1e-12)


def bent(kappa: float, gamma: float, viscous: float) -> tuple[Scene, Array, Array, Array]:
    """A double pendulum in the plane with resistance, and its M, K, D in the angles."""
    (l1, l2), (m1, m2) = (0.4, 0.9), (1.3, 0.6)
    resistance = Resistance(viscous, Bending(kappa, gamma))
    scene = hanging_chain((l1, l2), (m1, m2), planar=True).with_(resistance=resistance)
    relative = np.array([[1.0, -1.0], [-1.0, 1.0]])
    M = np.array([[(m1 / 3 + m2) * l1**2, m2 * l1 * l2 / 2], [m2 * l1 * l2 / 2, m2 * l2**2 / 3]])
    K = np.diag([G * l1 * (m1 / 2 + m2), G * m2 * l2 / 2]) + kappa * relative
    # ∫ v² ds with v = s θ1', then l1 θ1' + s θ2'.
    fluid = np.array([[l1**3 / 3 + l1**2 * l2, l1 * l2**2 / 2], [l1 * l2**2 / 2, l2**3 / 3]])
    return scene, M, K, gamma * relative + viscous * fluid


@pytest.mark.parametrize(
    ("kappa", "gamma", "viscous"), [(3.0, 0.0, 0.0), (0.0, 0.2, 0.0), (0.0, 0.0, 0.7), (3.0, 0.2, 0.7)]
)
def test_bending_and_viscous_forces(kappa: float, gamma: float, viscous: float) -> None:
    scene, M, K, D = bent(kappa, gamma, viscous)
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.linalg.solve(M, K), -np.linalg.solve(M, D)]])
    expected = np.linalg.eigvals(A)
    found = np.linalg.eigvals(system_matrix(model_of(scene)))
    for value in expected:
        assert np.abs(found - value).min() < 1e-9 * np.abs(expected).max()
    # No integrator of MuJoCo knows these forces beforehand: all three have z = -1 at h² K/4 + h D/2 = 1.
    limits = [stable_step(scene, engine_of(name, 1.0)).limit for name in ("euler", "implicitfast", "discrete")]
    h = limits[0]
    values = np.linalg.eigvals(np.linalg.solve(M, h * h * K / 4 + h * D / 2)).real
    assert values.max() == pytest.approx(1.0, rel=1e-9)
    assert limits[1:] == pytest.approx([h, h], rel=1e-9)
    bounds = bounds_at(scene, Bodies.of(scene.structure), scene.nodes0, scene.velocities0, scene.structure.rest_lengths)
    for scheme in Scheme:
        assert 0 < bounds.stable_step(scheme) <= limit_of(model_of(scene), scheme)[0] * (1 + 1e-12)


@pytest.mark.parametrize("name", ["implicitfast", "discrete", "rk4"])
def test_predicted_and_measured_limits_agree_with_bending_and_viscous_forces(name: str) -> None:
    found = at_rest(bent(3.0, 0.2, 0.7)[0], name)
    assert found["ratio"] == pytest.approx(1.0, abs=0.02), found


# Two ways ---------------------------------------------------------------------------------------------------


def test_a_loop_against_its_one_coordinate() -> None:
    # φ turns the crank; V(φ) and T = I(φ) φ'²/2 by five-point differences: truncation h⁴, round-off 1e-15 V/h² = 1e-8.
    masses, h = FOUR_BAR[1], 1e-3
    phi = equilibrium_angle()
    centers = np.array([bar_centers(phi + k * h)[0] for k in range(-2, 3)])
    heights = centers[:, :, 1] @ masses * G
    second = float(np.array([-1, 16, -30, 16, -1]) @ heights) / (12 * h * h)
    first = np.array([1, -8, 0, 8, -1]) / (12 * h)
    turns = np.unwrap(np.array([bar_centers(phi + k * h)[1] for k in range(-2, 3)]), axis=0)
    lengths = FOUR_BAR[0]
    rates = np.einsum("k,kri->ri", first, centers)
    inertia = float(np.sum(masses * np.sum(rates**2, axis=1)) + np.sum(masses * lengths**2 / 12 * (first @ turns) ** 2))
    scene = four_bar_at(phi, True)
    assert squares(model_of(scene))[-1] == pytest.approx(second / inertia, rel=1e-6)
    found = stable_step(scene, tmj.MuJoCo(integrator=Integrator.EULER))
    assert found.limit == pytest.approx(2 / math.sqrt(second / inertia), rel=1e-6)
    # In space the same motion is among others: planes of the rods may fold.
    in_space = squares(model_of(four_bar_at(phi, False)))
    assert np.abs(in_space - second / inertia).min() < 1e-6 * second / inertia


def bar_centers(angle: float) -> tuple[Array, Array]:
    """Centres (3, 2) and angles (3,) of the rods."""
    B, C = (np.array(node) for node in four_bar_nodes(angle))
    ends = [(np.zeros(2), B), (C, B), (C, np.array([FOUR_BAR[2], 0.0]))]
    return np.array([(p + q) / 2 for p, q in ends]), np.array([math.atan2(*(q - p)[::-1]) for p, q in ends])


def equilibrium_angle() -> float:
    """Where the loop hangs lowest, by bisection of V'."""

    def slope(angle: float) -> float:
        ahead, behind = (float(bar_centers(angle + x)[0][:, 1] @ FOUR_BAR[1]) for x in (1e-5, -1e-5))
        return ahead - behind

    low, high = -2.2, -0.6
    assert slope(low) < 0 < slope(high)
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if slope(middle) < 0 else (low, middle)
    return low


def four_bar_at(angle: float, planar: bool) -> Scene:
    B, C = four_bar_nodes(angle)
    nodes = np.array([[0, 0, 0], [B[0], 0, B[1]], [C[0], 0, C[1]], [FOUR_BAR[2], 0, 0]], float)
    return four_bar(planar).with_(initial_nodes=nodes)


def nodal_squares(scene: Scene) -> Array:
    """ω² from node positions: consistent masses, rods as constraints on lengths, whose forces λ stiffen (Lagrange)."""
    structure, x = scene.structure, scene.nodes0
    N = len(x)
    M, C = np.zeros((N, N)), []
    for (i, j), m in zip(structure.rod_nodes, structure.rod_masses, strict=True):
        M[np.ix_((i, j), (i, j))] += m / 6 * np.array([[2, 1], [1, 2]])
        row = np.zeros((N, 3))
        row[j], row[i] = x[j] - x[i], x[i] - x[j]
        C.append(row.ravel())
    for rod, (i, j) in zip(structure.rods, structure.rod_nodes, strict=True):
        for direction in rod.support.constraint_rows:
            row = np.zeros((N, 3))
            row[i], row[j] = (1 - rod.support.sigma) * direction, rod.support.sigma * direction
            C.append(row.ravel())
    rows = np.array(C)
    force = lumped_masses(structure)[:, None] * np.array(scene.gravity)
    multipliers = np.linalg.lstsq(rows.T, force.ravel(), rcond=1e-10)[0]
    assert np.abs(rows.T @ multipliers - force.ravel()).max() < 1e-12 * np.abs(force).sum()
    K = np.zeros((N, N))
    for (i, j), pull in zip(structure.rod_nodes, multipliers, strict=False):
        K[np.ix_((i, j), (i, j))] += pull * np.array([[1, -1], [-1, 1]])
    _, size, V = np.linalg.svd(rows)
    Z = V[int(np.sum(size > 1e-10 * size[0])) :].T
    mass, stiffness = (Z.T @ np.kron(matrix, np.eye(3)) @ Z for matrix in (M, K))
    return np.sort(np.linalg.eigvals(np.linalg.solve(mass, stiffness)).real)


@pytest.mark.parametrize("name", ["suspended_cable", "net"])
def test_hanging_loops_against_constraints_on_lengths(name: str) -> None:
    # Loops, rods that four of share a node, forces in every joint; the two have no coordinate in common.
    scene, text = scene_at_rest(tmj.load_scene(name))
    assert text.endswith("its supports still")
    expected = nodal_squares(scene)
    np.testing.assert_allclose(squares(model_of(scene)), expected, rtol=1e-8)
    assert stable_step(scene, tmj.DAE()).omega == pytest.approx(math.sqrt(expected[-1]), rel=1e-8)


@pytest.mark.parametrize("planar", [False, True])
@pytest.mark.parametrize("held", ["pinned", "free"])
def test_trees_with_strings_against_linearize(held: str, planar: bool) -> None:
    # In equilibrium: elsewhere a stiffness depends on the coordinates.
    scene, _ = scene_at_rest(random_tree(np.random.default_rng(7), 5, planar, held))
    bending = Bending(2.0, 0.0)
    scene, _ = scene_at_rest(scene.with_(loads=(), resistance=Resistance(0.0, bending)))
    linear = tmj.linearize(scene, tmj.DAE())
    n = len(linear.coordinates)
    expected = np.sort(np.linalg.eigvals(-linear.A[n:, :n]).real)
    # Both are good to some 1e-12 of the largest; what nothing holds is zero.
    np.testing.assert_allclose(squares(model_of(scene)), expected, rtol=1e-7, atol=1e-8 * expected[-1])


@pytest.mark.parametrize("make", ["cable", "suspended", "tree"])
def test_sparse_and_dense_agree(make: str, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = {
        "cable": thesis_cable,
        "suspended": lambda: scene_at_rest(suspended(False))[0],
        "tree": lambda: scene_at_rest(random_tree(np.random.default_rng(5), 8, True, "free"))[0],
    }[make]()
    monkeypatch.setattr("tensegrity_mj.vibration.blocks.DENSE", 1000)
    dense = [limit_of(model_of(scene), scheme)[0] for scheme in Scheme]
    assert isinstance(model_of(scene).material, np.ndarray)
    monkeypatch.setattr("tensegrity_mj.vibration.blocks.DENSE", 10)
    assert not isinstance(model_of(scene).material, np.ndarray)
    # Lanczos iterations stop at 1e-9 of an eigenvalue, those of damped models at 1e-8.
    np.testing.assert_allclose([limit_of(model_of(scene), scheme)[0] for scheme in Scheme], dense, rtol=1e-7)


@pytest.mark.parametrize(
    "scene",
    [
        hanging_chain((0.7,), (2.0,)),
        thesis_cable(),
        spinning(3.0),
        scene_at_rest(suspended(False))[0],
        random_tree(np.random.default_rng(3), 6, False),
        random_tree(np.random.default_rng(4), 6, True, "free"),
    ],
    ids=["pendulum", "cable", "spinning", "suspended", "tree in motion", "free tree in motion"],
)
def test_the_cheap_bound_is_one(scene: Scene) -> None:
    structure, model = scene.structure, model_of(scene)
    bounds = bounds_at(scene, Bodies.of(structure), scene.nodes0, scene.velocities0, structure.rest_lengths)
    for matrix, bound in zip((model.material, model.geometric, model.damper), bounds[:3], strict=True):
        assert np.linalg.eigvalsh(matrix)[-1] <= bound * (1 + 1e-12)
    for scheme in Scheme:
        least, real = bounds.stable_step(scheme), limit_of(model, scheme)[0]
        assert 0 < least <= real * (1 + 1e-12)


# Runs -------------------------------------------------------------------------------------------------------


RUNS = {
    "pendulum": lambda: hanging_chain((0.7,), (2.0,)),
    "chain": lambda: hanging_chain((0.3, 0.5, 0.2), (1.0, 0.4, 2.0), planar=True),
    "loop": lambda: four_bar_at(equilibrium_angle(), True),
    "suspended": lambda: scene_at_rest(suspended(True))[0],
}


@pytest.mark.parametrize(
    ("what", "name"),
    [("chain", name) for name in ("euler", "implicitfast", "discrete", "rk4", "dae")]
    + [(what, name) for what in ("pendulum", "loop") for name in ("euler", "dae")],
)
def test_predicted_and_measured_limits_agree(what: str, name: str) -> None:
    found = at_rest(RUNS[what](), name)
    # Bisection stops at 0.5 %, and growth is seen from 0.1 % on: see `measure`.
    assert found["ratio"] == pytest.approx(1.0, abs=0.02), found


@pytest.mark.parametrize("name", ["euler", "rk4", "dae"])
@pytest.mark.parametrize("what", list(RUNS))
def test_a_step_beyond_the_limit_is_flagged_and_grows(what: str, name: str) -> None:
    scene = RUNS[what]()
    limit = stable_step(scene, engine_of(name, 1.0)).limit
    push = 1e-7 * np.random.default_rng(1).normal(size=scene.nodes0.shape)
    push = velocities_with_supports(scene.structure, scene.nodes0, (), push)
    pushed = scene.with_(initial_velocities=push)

    def reach(step: float) -> float:
        try:
            run = tmj.simulate(pushed, None, engine_of(name, step), duration=300 * step, output_interval=step)
            calm = tmj.simulate(scene, None, engine_of(name, step), duration=300 * step, output_interval=step)
        except tmj.errors.DivergenceError:
            return math.inf
        return float(np.abs(run.nodes - calm.nodes).max())

    with warnings.catch_warnings():
        warnings.simplefilter("error", StabilityWarning)
        below = reach(0.8 * limit)
    with pytest.warns(StabilityWarning, match="beyond the largest stable one"):
        beyond = reach(1.2 * limit)
    # Below, 1e-7 m/s over 300 steps of at most a second each cannot get beyond 1e-4 m. Beyond, Runge-Kutta's R is
    # 1.15 and more at 1.2 times its limit on the imaginary axis, semi-implicit Euler's 3.4: 300 steps make it 1e10.
    assert below < 1e-4
    assert beyond > 1e-2


def test_the_thesis_own_step_is_flagged_for_its_finer_cables() -> None:
    for elements, flagged in ((37, False), (49, True), (121, True)):
        scene = cable(elements)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", StabilityWarning)
            engine = tmj.DAE(method=Method.RK4, timestep=0.01)
            run = tmj.simulate(scene, None, engine, duration=0.02)
        assert run.reports["stability"]["exceeded"] == flagged
        texts = [str(item.message) for item in caught if item.category is StabilityWarning]
        assert len(texts) == flagged
        assert all("small motions of 'rod" in text and "on string" not in text for text in texts)


def test_what_does_not_help_is_not_recommended() -> None:
    # `discrete` knows strings alone: of what weight holds it has semi-implicit Euler's limit.
    scene = hanging_chain((0.3, 0.5), (1.0, 0.4))
    limits = [stable_step(scene, engine_of(name, 1.0)).limit for name in ("euler", "discrete")]
    assert limits[1] == pytest.approx(limits[0], rel=1e-12)
    with pytest.warns(StabilityWarning) as caught:
        tmj.simulate(scene, None, tmj.MuJoCo(1.2 * limits[0], Integrator.EULER), duration=2.4 * limits[0])
    assert "DISCRETE" not in str(caught[0].message)


def test_a_cable_that_swings_is_stiffer_than_one_at_rest() -> None:
    scene = cable(13)
    engine = tmj.MuJoCo(integrator=Integrator.EULER)
    start = stable_step(scene, engine)
    run = tmj.simulate(scene, None, tmj.DAE(), duration=3.0)
    worst = stable_step(scene, engine, run=run)
    assert worst.limit < start.limit * (1 - 1e-3)
    assert worst.time > 0
    assert worst.limit > 0.5 * start.limit


def test_a_run_that_gets_beyond_the_limit_on_its_way_says_so() -> None:
    # The support moves so that the chain weighs g + 9 sin(3 t): the step is 0.95 of the limit at the start, and 1.3 of
    # that at t = 0.52 s, where |R(1.3 · 2.83 i)| = 5: within a second the fastest motion grows by more than 1e4.
    motion = Motion("r0", (Harmonic((0.0, 0.0, -1.0), 3.0),))
    scene = hanging_chain((0.3, 0.5, 0.2), (1.0, 0.4, 2.0), (motion,), True)
    push = velocities_with_supports(scene.structure, scene.nodes0, scene.motions)
    push = push + 1e-3 * np.outer([0, 1, 1, 1], [1.0, 0, 0])
    scene = scene.with_(initial_velocities=velocities_with_supports(scene.structure, scene.nodes0, (motion,), push))
    engine = tmj.MuJoCo(integrator=Integrator.RK4)
    step = 0.95 * stable_step(scene, engine).limit
    with warnings.catch_warnings():
        warnings.simplefilter("error", StabilityWarning)
        run = tmj.simulate(scene, None, tmj.MuJoCo(step), duration=round(1.2 / step) * step, output_interval=step)
    explain_warnings(run, tmj.MuJoCo(step))
    assert run.reports["stability"]["exceeded"]
    assert run.reports["stability"]["time"] > 0
    assert run.reports["stability"]["limit"] < step
    assert "beyond the largest stable one" in run.reports["warnings"][-1]


def test_baumgartes_frequency_counts_in_chains() -> None:
    scene = hanging_chain((0.7, 0.7), (1.0, 1.0))
    engine = tmj.DAE(method=Method.RK4, timestep=1.0, drift=Drift.BAUMGARTE, baumgarte_frequency=500.0)
    assert stable_step(scene, engine).limit == pytest.approx(2.785294 / 500.0, rel=1e-5)


def test_a_law_in_the_loop_of_a_chain() -> None:
    # A string from the fixed node straight below pulls with u = 5 + g x of its lower end; on a double pendulum in the
    # plane. K_law by hand: u pulls -u (x, ...) horizontally, so that x'' has u more stiffness; the gain's pull is along
    # the string, across x, of second order. So only u counts: geometric stiffness of a constant force density.
    structure = Structure(
        "held",
        {"o": (0, 0, 0), "a": (0, 0, -0.7), "f": (1.0, 0, -0.7), "g": (-1.0, 0, -0.7), "b": (0, 0, -1.2)},
        rods=(
            Rod("r0", ("o", "a"), 2.0, support=Support.pinned(0.0, Y)),
            Rod("r1", ("a", "b"), 1.0, support=Support.free(plane=Y)),
        ),
        strings=(String("s0", ("a", "f"), 500.0, tension=5.0), String("s1", ("a", "g"), 500.0, tension=5.0)),
        fixed_nodes=("f", "g"),
    )
    gain = 40.0

    def law(time: float, nodes: Array, velocities: Array) -> Array:
        x = nodes[1, 0]
        return np.array([5.0 - gain * x, 5.0 + gain * x])

    scene = Scene(structure, gravity=GRAVITY)
    found = stable_step(scene, tmj.MuJoCo(integrator=Integrator.EULER), law=law)
    # u0 (1 - x) - u1 (1 + x) = -(10 + 2 gain) x on node a; mass and gravity as in the double pendulum, in θ.
    (l1, l2), (m1, m2) = (0.7, 0.5), (2.0, 1.0)
    M = np.array([[(m1 / 3 + m2) * l1**2, m2 * l1 * l2 / 2], [m2 * l1 * l2 / 2, m2 * l2**2 / 3]])
    K = np.diag([G * l1 * (m1 / 2 + m2) + (10 + 2 * gain) * l1**2, G * m2 * l2 / 2])
    squared = np.linalg.eigvals(np.linalg.solve(M, K)).real.max()
    # The allowance of 1e-3 a step lets a step pass that is by less than (1e-3)²/8 beyond the limit.
    assert found.closed_loop
    assert found.limit == pytest.approx(2 / math.sqrt(squared), rel=1e-5)


# Refusals, and the study --------------------------------------------------------------------------------------


def test_the_ode_is_refused_where_rods_share_nodes() -> None:
    with pytest.raises(StructureError, match="share node"):
        stable_step(thesis_cable(), tmj.ODE(method=Method.RK4, timestep=1e-3))


def test_forces_that_cancel_leave_no_stiffness() -> None:
    # Held by dead loads, a four-bar loop carries nothing: round-off of 1e-15 of its weight is no frequency.
    for planar in (True, False):
        scene, _ = scene_at_rest(four_bar(planar))
        assert stable_step(scene, tmj.MuJoCo()).limit == math.inf


def test_what_is_not_known_of_dampers_between_joined_rods_is_named() -> None:
    engine = tmj.MuJoCo(integrator=Integrator.IMPLICIT)

    def named(scene: Scene) -> bool:
        return any("depends on how the rods hang" in note for note in stable_step(scene, engine).notes)

    assert named(tmj.load_scene("truss_arm"))  # a loop
    assert not named(thesis_cable())  # no dampers
    tree = random_linked_structure(np.random.default_rng(4), damping=(1.0, 5.0))
    assert not named(Scene(tree))
    assert named(Scene(tree, motions=(Motion.in_line("r0", 0.1, 1.0, (1, 0, 0)),)))


def damped_tree(seed: int) -> Scene:
    """Two to five rods, planar or not, pinned or free, taut and with dampers, at rest."""
    rng = np.random.default_rng(seed)
    structure = random_linked_structure(
        rng,
        rods=int(rng.integers(2, 6)),
        planar=bool(rng.integers(2)),
        pinned=bool(rng.integers(2)),
        strings=int(rng.integers(3, 7)),
        stretch=(0.1, 0.3),
        stiffness=(10, 1000),
        damping=(0.1, 10.0 ** rng.uniform(0, 1.5)),
    )
    return scene_at_rest(Scene(structure))[0]


@pytest.mark.parametrize("seed", [4, 7])
def test_dampers_in_a_tree_are_in_the_limit_of_the_implicit_integrators(seed: int) -> None:
    """Measured to 0.5 %; without the dampers the prediction is 33 and 18 % off."""
    scene = damped_tree(seed)
    found = at_rest(scene, "implicitfast")
    assert found["ratio"] == pytest.approx(1.0, abs=0.02), found
    model = model_of(scene)
    bare = limit_of(replace(model, damping=0 * model.damping), Scheme.VELOCITY_IMPLICIT)[0]
    assert abs(bare / found["measured"] - 1) > 0.05  # or the test would be empty


@pytest.mark.parametrize("seed", range(6))
def test_the_limit_of_a_damped_tree_is_where_its_step_begins_to_grow(seed: int) -> None:
    """Against the eigenvalues of the step's own matrix: inside the unit circle below, outside beyond."""
    tree = tree_model(model_of(damped_tree(seed)))
    limit = tree_limit(tree)[0]
    n = len(tree.mass)

    def radius(h: float) -> float:
        # The spin of the last rods, which nothing holds, keeps its eigenvalue 1, twice.
        W = tree.mass + h * tree.known
        push = h * np.linalg.solve(W, np.hstack([tree.stiffness, tree.damper]))
        from_q, from_v = -push[:, :n], np.eye(n) - push[:, n:]
        step = np.block([[np.eye(n) + h * from_q, h * from_v], [from_q, from_v]])
        return float(np.abs(np.linalg.eigvals(step)).max())

    # Beyond by 1 %, 1 + √0.08 or so for a mode without damping; a defective 1 is off by √round-off.
    assert max(radius(part * limit) for part in (0.2, 0.5, 0.8, 0.95, 0.999)) < 1 + 1e-6
    assert radius(1.01 * limit) > 1 + 1e-3


@pytest.mark.parametrize("seed", range(4))
def test_the_tree_has_the_mass_matrix_of_mujocos_model(seed: int) -> None:
    """Both are written in rates of their own, which differ by turned axes: the eigenvalues are the same."""
    rng = np.random.default_rng(seed)
    structure = random_linked_structure(rng, rods=5, planar=seed % 2 == 0, pinned=seed < 2, damping=(1.0, 2.0))
    scene = Scene(structure)
    tree = tree_model(model_of(scene))
    model = mujoco.MjModel.from_xml_string(scene_to_mjcf(scene, 1e-3, "implicit"))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    assert len(tree.mass) == model.nv
    # Smallest eigenvalues, of spins, are 1e-4 of the largest; round-off of both.
    np.testing.assert_allclose(np.linalg.eigvalsh(tree.mass), np.linalg.eigvalsh(full), rtol=1e-9)


def test_points_of_joined_structures_are_trees_and_loops_at_rest() -> None:
    points = joined_points(12, 3)
    assert points == joined_points(20, 3)[:12]
    assert points != joined_points(12, 4)
    scenes = [joined_scene(point) for point in points]
    assert all(scene.structure.class_number > 1 and balance(StaticModel.of(scene)).is_equilibrium for scene in scenes)
    assert {bool(spanning_forest(scene.structure).closures) for scene in scenes} == {True, False}
    assert {scene.structure.rods[0].support.plane is None for scene in scenes} == {True, False}


def test_a_run_of_a_damped_tree_warns_by_its_own_limit() -> None:
    scene = damped_tree(4)
    limit = stable_step(scene, tmj.MuJoCo(integrator=Integrator.IMPLICITFAST)).limit
    for part, flagged in ((0.95, False), (1.05, True)):
        step = part * limit
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            tmj.simulate(scene, None, tmj.MuJoCo(step, Integrator.IMPLICITFAST), duration=2 * step)
        assert any(item.category is StabilityWarning for item in caught) == flagged


def test_scenes_at_rest_are_in_equilibrium() -> None:
    for name in ("cable", "suspended_cable", "net", "truss_arm", "dbar"):
        scene, text = scene_at_rest(tmj.load_scene(name))
        assert balance(StaticModel.of(scene)).is_equilibrium
        assert ("dead loads" in text) == (name in ("truss_arm", "dbar"))
        assert not scene.motions
        assert not scene.velocities0.any()
    scene, text = scene_at_rest(random_tree(np.random.default_rng(3), 6, False))
    # By hand: each node's strings, and half the weight of each rod there.
    structure = scene.structure
    pulls = np.maximum(0, structure.stiffness * (structure.string_lengths(scene.nodes0) - structure.rest_lengths))
    total = string_forces(structure, scene.nodes0, pulls) + lumped_masses(structure)[:, None] * np.array(GRAVITY)
    np.testing.assert_allclose(scene.nodal_forces(0.0), -total, atol=1e-12)
    assert not balance(StaticModel.of(scene.with_(loads=()))).is_equilibrium


def test_the_study_of_a_scene_of_class_k() -> None:
    from evidence.stability.page import describe
    from evidence.stability.study import study_stability

    scene = hanging_chain((0.3, 0.5), (1.0, 0.4), (Motion.in_line("r0", 0.01, 0.5, (1, 0, 0)),), True).with_(
        duration=0.2
    )
    data: dict[str, Any] = study_stability(scene, engines=("rk4", "ode"))
    assert data["base"]["engines"]["rk4"]["agrees"]
    assert "ode" not in data["base"]["engines"]
    assert "ODE refuses the scene: rods 'r0' and 'r1' share node" in data["start"]["engines"]["ode"]["error"]
    assert "class 1" in "\n".join(describe(data))
    with pytest.raises(tmj.errors.OptionError, match="share nodes"):
        study_stability(scene, engines=("rk4",), maps=("damping",))
    pendulum = hanging_chain((0.5,), (1.0,)).with_(duration=0.2)
    assert study_stability(pendulum, engines=("rk4",))["base"]["engines"]["rk4"]["agrees"]
    with pytest.raises(tmj.errors.OptionError, match="no strings"):
        study_stability(pendulum, engines=("rk4",), maps=("damping",))
