"""Elastic rods: closed forms, a third coding by nodes alone, and motions that the engines share.

The bar is the two-node one of finite elements: mass matrix m/6 [2 1; 1 2] for each axis of its nodes, axial force
N = k (L - ℓ) + c dL/dt. Its two ends apart, d = x_j - x_i, move with the mass m/12.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest
from dense_equations import SOLVERS, dae
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from soft_scenes import LENGTH, MASS, C, K, bar, rigid, soft_chain, soft_pair

import tensegrity_mj as tmj
from tensegrity_mj.engines.mujoco.mjcf_tree import place

Array = NDArray[np.float64]
FIXED: dict[str, Callable[[float], Any]] = {
    "mujoco": lambda step: tmj.MuJoCo(timestep=step),
    "dae": lambda step: tmj.DAE(method=tmj.Method.RK4, timestep=step),
}
EXACT = tmj.DAE(rtol=1e-12, atol=1e-13)
G = 9.81


def lengths(run: tmj.Trajectory) -> Array:
    return np.linalg.norm(run.nodes[:, 1] - run.nodes[:, 0], axis=1)


def damped(t: Array, omega: float, zeta: float, start: float) -> tuple[Array, Array]:
    """An oscillator from rest at `start`, and its rate."""
    nu = omega * math.sqrt(1 - zeta**2)
    decay = np.exp(-zeta * omega * t)
    return (
        start * decay * (np.cos(nu * t) + zeta * omega / nu * np.sin(nu * t)),
        -start * decay * (omega**2 / nu) * np.sin(nu * t),
    )


def rk4_error(omega: float, step: float, duration: float) -> float:
    """Of RK4, a part of the amplitude: n steps of (ω h)⁵/120 each, and one half more for the next terms."""
    return 1.5 * duration / step * (omega * step) ** 5 / 120


@pytest.mark.third_means(
    "elements.let_act of elastic rods",
    "elements.held_powers of elastic rods",
    by="a damped oscillator of m/12: motion, force, energy, loss",
)
@pytest.mark.parametrize("engine", FIXED)
def test_a_free_bar_vibrates_along_itself(engine: str) -> None:
    """m/12 s̈ + c ṡ + k s = 0: ω² = 12 k/m, ζ = c √(3 / (k m)); energy ½ k s² and loss ∫ c ṡ² follow."""
    omega, zeta, start = math.sqrt(12 * K / MASS), C * math.sqrt(3 / (K * MASS)), 0.05
    run = tmj.simulate(bar(stretch=start), None, FIXED[engine](1e-3), duration=0.5, output_interval=0.01)
    s, rate = damped(run.time, omega, zeta, start)
    error = rk4_error(omega, 1e-3, 0.5) * start
    np.testing.assert_allclose(lengths(run) - LENGTH, s, atol=error)
    np.testing.assert_allclose(run.rod_forces[:, 0], K * s + C * rate, atol=2 * K * error)
    np.testing.assert_allclose(run.rod_force("bar"), K * s + C * rate, atol=2 * K * error)
    np.testing.assert_allclose(run.element_energy, 0.5 * K * s**2, atol=2 * K * start * error)
    lost = 0.5 * K * start**2 - 0.5 * K * s**2 - 0.5 * (MASS / 12) * rate**2
    np.testing.assert_allclose(run.dissipation, lost, atol=4 * K * start * error)
    assert run.reports["drift"] == 0.0
    assert np.ptp(run.nodes.mean(axis=1), axis=0) == pytest.approx(np.zeros(3), abs=1e-14)


@pytest.mark.parametrize("engine", FIXED)
@pytest.mark.parametrize("sigma", [0, 1])
def test_a_bar_that_hangs_by_an_end_swings_about_its_extension(engine: str, sigma: int) -> None:
    """m/3 s̈ + k s = m g / 2: the extension m g / 2k of the continuum, and ω² = 3 k/m."""
    down = (0.0, 0.0, -1.0) if sigma == 0 else (0.0, 0.0, 1.0)
    scene = bar(tmj.Support.pinned(sigma), gravity=(0.0, 0.0, -G), damping=0.0, direction=down)
    run = tmj.simulate(scene, None, FIXED[engine](1e-3), duration=0.5, output_interval=0.01)
    omega, extension = math.sqrt(3 * K / MASS), MASS * G / (2 * K)
    s = extension * (1 - np.cos(omega * run.time))
    np.testing.assert_allclose(lengths(run), LENGTH + s, atol=1.1 * rk4_error(omega, 1e-3, 0.5))


@pytest.mark.third_means("elements.let_act of elastic rods", by="ℓ/(1 - m ω²/12 k)")
@pytest.mark.parametrize("engine", FIXED)
def test_a_spinning_bar_keeps_the_extension_of_its_spin(engine: str) -> None:
    """m/12 L ω² = k (L - ℓ): L = ℓ / (1 - m ω² / 12 k), and the bar turns by ω t."""
    spin = 10.0
    extended = LENGTH / (1 - MASS * spin**2 / (12 * K))
    scene = bar(stretch=extended - LENGTH, damping=0.0, direction=(1.0, 0.0, 0.0))
    velocities = np.array([[0.0, -0.5, 0.0], [0.0, 0.5, 0.0]]) * spin * extended
    run = tmj.simulate(scene.with_(initial_velocities=velocities), None, FIXED[engine](1e-3), duration=0.5)
    error = rk4_error(math.sqrt(12 * K / MASS), 1e-3, 0.5) * extended
    np.testing.assert_allclose(lengths(run), extended, atol=error)
    across = run.nodes[:, 1] - run.nodes[:, 0]
    angle = np.unwrap(np.arctan2(across[:, 1], across[:, 0]))
    np.testing.assert_allclose(angle, spin * run.time, atol=error)
    assert run.rod_forces == pytest.approx(K * (extended - LENGTH), abs=K * error)


def test_a_stiff_bar_is_a_rigid_one_to_the_first_order_in_its_compliance() -> None:
    """A bar that swings from level is longer by N/k at most twice: N is below 2.5 m g / 2 · 2, and halves with 1/k."""
    swing = {"gravity": (0.0, 0.0, -G), "direction": (1.0, 0.0, 0.0), "damping": 0.0}
    pinned = tmj.Support.pinned()
    exact = tmj.simulate(rigid(bar(pinned, **swing)), None, EXACT, duration=0.5, output_interval=0.01)  # type: ignore[arg-type]
    errors = []
    for k in (2e4, 4e4, 8e4):
        run = tmj.simulate(bar(pinned, stiffness=k, **swing), None, EXACT, duration=0.5, output_interval=0.01)  # type: ignore[arg-type]
        errors.append(np.abs(run.nodes - exact.nodes).max() * k)
    assert errors[1] == pytest.approx(errors[0], rel=0.25)
    assert errors[2] == pytest.approx(errors[1], rel=0.25)
    assert max(errors) < 5 * MASS * G


SUPPORTS = {
    "free": tmj.Support.free(0.3),
    "first end": tmj.Support.pinned(0),
    "second end": tmj.Support.pinned(1),
    "on a floor": tmj.Support.constrained([[0, 0, 1]]),
    "oblique": tmj.Support.constrained([[0, 1, 1], [1, 0, 0.5]], sigma=1),
    "planar": tmj.Support.free(0.5, plane=(0, 1, 0)),
    "planar, pinned": tmj.Support.pinned(0, plane=(0, 1, 0)),
}


def held(name: str, **options: Any) -> tmj.Scene:
    way = (0.6, 0.0, 0.8) if "planar" in name else (0.48, 0.6, 0.64)
    return bar(SUPPORTS[name], direction=way, **options)


@pytest.mark.parametrize("name", SUPPORTS)
@pytest.mark.parametrize("laden", [False, True])
def test_mujocos_mass_matrix_is_that_of_the_two_node_bar(name: str, laden: bool) -> None:
    """Jᵀ (m/6 [2 1; 1 2] ⊗ 1) J, by the speeds of its nodes for a unit of each joint; weights half at either node.

    A mass at the part s of the rod adds m [(1 - s)², s (1 - s); s (1 - s), s²], and its weight by 1 - s and s.
    """
    scene, lumps = held(name, gravity=(1.0, 2.0, -G)), ((0.8, 1.5), (0.1, 0.4), (1.0, 0.2)) if laden else ()
    rods = tuple(replace(rod, masses=[tmj.model.RodMass(*lump) for lump in lumps]) for rod in scene.structure.rods)
    scene = scene.with_(structure=replace(scene.structure, rods=rods))
    nodal, shares = MASS / 6 * np.array([[2.0, 1.0], [1.0, 2.0]]), MASS / 2 * np.ones(2)
    for at, mass in lumps:
        nodal += mass * np.outer([1 - at, at], [1 - at, at])
        shares += mass * np.array([1 - at, at])
    model = tmj.MuJoCo(1e-3).model(scene)
    data = mujoco.MjData(model)
    place(data, scene, scene.nodes0, scene.velocities0)
    mujoco.mj_forward(model, data)
    found = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, found)
    J = np.zeros((6, model.nv))
    for row, node in enumerate(scene.structure.node_names):
        mujoco.mj_jacSite(model, data, J[3 * row : 3 * row + 3], None, model.site(node).id)
    np.testing.assert_allclose(found, J.T @ np.kron(nodal, np.eye(3)) @ J, atol=2e-15 * MASS)  # some sums of round-off
    weight = J.T @ np.kron(shares, scene.gravity)
    np.testing.assert_allclose(data.qfrc_gravcomp - data.qfrc_bias, weight, atol=1e-14 * MASS * G)
    assert tmj.studies.requirements(scene).degrees_of_freedom == model.nv


@pytest.mark.parametrize("name", SUPPORTS)
def test_engines_agree_with_every_support(name: str) -> None:
    """At the order of RK4, and with it to the round-off of 500 steps: their equations are the same."""
    scene = held(name, gravity=(0.3, 0.5, -G), stretch=0.1)
    runs = {key: tmj.simulate(scene, None, FIXED[key](1e-3), duration=0.5, output_interval=0.01) for key in FIXED}
    exact = tmj.simulate(scene, None, EXACT, duration=0.5, output_interval=0.01)
    assert tmj.compare(runs["mujoco"], exact).max_node_error < 1e-8
    assert np.abs(runs["mujoco"].nodes - runs["dae"].nodes).max() < 1e-12
    # Of MuJoCo alone the λ of the thesis is made of forces, not of equations: they are one for an elastic rod.
    np.testing.assert_allclose(runs["mujoco"].multipliers, runs["dae"].multipliers, rtol=1e-9, atol=1e-9)


def nodal(scene: tmj.Scene) -> Callable[[float, Array], Array]:
    """The rates of (x, v) of a structure of elastic rods, by nodes: M v̇ = f, a third coding that shares nothing."""
    structure = scene.structure
    n = len(structure.nodes)
    M, weights = np.zeros((n, n)), np.zeros((n, 3))
    fixed = [structure.node_index[rod.nodes[0]] for rod in structure.rods if rod.support.directions]
    fixed += [structure.node_index[name] for name in structure.fixed_nodes]
    for rod in structure.rods:
        i, j = (structure.node_index[name] for name in rod.nodes)
        M[i, i] += rod.mass / 3
        M[j, j] += rod.mass / 3
        M[i, j] += rod.mass / 6
        M[j, i] += rod.mass / 6
        weights[[i, j]] += rod.mass / 2 * np.array(scene.gravity)
        for lump in rod.masses:
            shares = np.array([1 - lump.at, lump.at])
            M[np.ix_([i, j], [i, j])] += lump.mass * np.outer(shares, shares)
            weights[[i, j]] += lump.mass * np.outer(shares, scene.gravity)
    for point in structure.point_masses:
        M[structure.node_index[point.node], structure.node_index[point.node]] += point.mass
        weights[structure.node_index[point.node]] += point.mass * np.array(scene.gravity)
    free = [row for row in range(n) if row not in fixed]
    inverse = np.linalg.inv(M[np.ix_(free, free)])

    def rates(time: float, state: Array) -> Array:
        x, v = state.reshape(2, n, 3)
        forces = weights.copy()
        for member in (*structure.rods, *structure.strings):
            i, j = (structure.node_index[name] for name in member.nodes)
            span = x[j] - x[i]
            length = np.sqrt(span @ span)
            rate = span @ (v[j] - v[i]) / length
            reference = np.linalg.norm(structure.positions[j] - structure.positions[i])
            rest = reference if member.rest_length is None else member.rest_length
            pull = member.stiffness * (length - rest) + member.damping * rate
            if isinstance(member, tmj.String):
                pull = max(0.0, pull) if length > rest else 0.0
            forces[i] += pull / length * span
            forces[j] -= pull / length * span
        out = np.zeros((2, n, 3))
        out[0], out[1, free] = v, inverse @ forces[free]
        return out.ravel()

    return rates


def soft_diamond() -> tmj.Scene:
    """STEDY's D-bar with soft bars: four of them share nodes, with a string along each diagonal."""
    nodes = {"left": (-1.0, 0.0, 0.0), "top": (0.0, 0.0, 0.6), "right": (1.0, 0.0, 0.0), "bottom": (0.0, 0.0, -0.6)}
    pairs = (("left", "top"), ("top", "right"), ("right", "bottom"), ("bottom", "left"))
    rods = tuple(
        tmj.Rod(
            f"r{n}", pair, 0.8, support=tmj.Support.free() if n else tmj.Support.pinned(), stiffness=900.0, damping=2.0
        )
        for n, pair in enumerate(pairs)
    )
    strings = (
        tmj.String("across", ("left", "right"), 150.0, 1.0, rest_length=1.6),
        tmj.String("up", ("top", "bottom"), 150.0, 1.0, rest_length=0.9),
    )
    return tmj.Scene(tmj.Structure("soft diamond", nodes, rods, strings), gravity=(0.0, 0.3, -G))


@pytest.mark.third_means("elements.let_act of elastic rods", by="M v̇ = f by nodes alone")
@pytest.mark.parametrize(
    ("scene", "in_mujoco"), [(soft_pair(), True), (soft_diamond(), False)], ids=["pair", "diamond"]
)
def test_soft_bars_move_as_a_third_coding_by_nodes_says(scene: tmj.Scene, in_mujoco: bool) -> None:
    times = np.linspace(0.0, 0.5, 26)
    start = np.array([scene.nodes0, scene.velocities0]).ravel()
    found = solve_ivp(nodal(scene), (0.0, 0.5), start, "DOP853", times, rtol=1e-12, atol=1e-13)
    truth = found.y.T.reshape(len(times), 2, -1, 3)[:, 0]
    run = tmj.simulate(scene, None, EXACT, duration=0.5, output_interval=0.02)
    # Both integrate to their tolerances; motions of 1 m grow their errors by some tens.
    assert np.abs(run.nodes - truth).max() < 1e-10
    assert run.energy_residual < 1e-9
    if in_mujoco:
        runs = [tmj.simulate(scene, None, FIXED["mujoco"](h), duration=0.5, output_interval=0.02) for h in (1e-3, 5e-4)]
        errors = [float(np.abs(one.nodes - truth).max()) for one in runs]
        print(errors)
        assert errors[1] < 1e-8
        assert errors[1] < errors[0] / 2**3.5


@pytest.mark.parametrize("closed", [False, True])
def test_elastic_rods_among_rigid_ones_that_share_nodes(closed: bool) -> None:
    """Each solver codes what holds lengths in its own way; rigid rods keep theirs, forces are N."""
    scene = soft_chain(closed)
    exact = tmj.simulate(scene, None, EXACT, duration=0.4, output_interval=0.02)
    assert exact.energy_residual < 1e-9
    for solver in SOLVERS:
        engine = dae(solver, method=tmj.Method.RK4, timestep=1e-3)
        run = tmj.simulate(scene, None, engine, duration=0.4, output_interval=0.02)
        assert np.abs(run.nodes - exact.nodes).max() < 1e-8
        assert run.reports["drift"] < 1e-14
        span = run.nodes[:, 2] - run.nodes[:, 1]
        length = np.linalg.norm(span, axis=1)
        rate = np.sum(span * (run.velocities[:, 2] - run.velocities[:, 1]), axis=1) / length
        reference = np.linalg.norm(scene.structure.positions[2] - scene.structure.positions[1])
        np.testing.assert_allclose(run.rod_force("r2"), 300.0 * (length - reference) + 1.0 * rate, atol=1e-9)
    if closed:
        assert not scene.redundancy.singular


@pytest.mark.parametrize("engine", [*FIXED, "locating", "accurate"])
def test_other_ways_to_step_have_elastic_rods_too(engine: str) -> None:
    chosen = {
        "locating": tmj.MuJoCo(timestep=1e-3, locate_slack=True),
        "accurate": tmj.MuJoCo(accuracy=1e-8),
    }.get(engine) or FIXED[engine](1e-3)
    exact = tmj.simulate(soft_pair(), None, EXACT, duration=0.2, output_interval=0.02)
    run = tmj.simulate(soft_pair(), None, chosen, duration=0.2, output_interval=0.02)
    assert tmj.compare(run, exact).max_node_error < 1e-7


@pytest.mark.parametrize("integrator", ["euler", "implicit", "implicitfast", "discrete"])
def test_integrators_of_one_stage_are_of_the_first_order(integrator: str) -> None:
    exact = tmj.simulate(soft_pair(), None, EXACT, duration=0.2, output_interval=0.02)
    errors, residuals = [], []
    for step in (1e-3, 5e-4):
        engine = tmj.MuJoCo(timestep=step, integrator=integrator)  # type: ignore[arg-type]
        run = tmj.simulate(soft_pair(), None, engine, duration=0.2, output_interval=0.02)
        errors.append(tmj.compare(run, exact).max_node_error)
        residuals.append(run.energy_residual)
    assert errors[1] == pytest.approx(errors[0] / 2, rel=0.2)
    assert residuals[1] == pytest.approx(residuals[0] / 2, rel=0.3)


def test_many_simulations_at_once_are_those_of_single_ones() -> None:
    scene = soft_pair()
    faster = scene.with_(initial_velocities=np.where(np.arange(5)[:, None] == 3, [0.0, 0.0, 1.0], 0.0))
    many = tmj.simulate_many([scene, faster], duration=0.1)
    for one, run in zip((scene, faster), many, strict=True):
        alone = tmj.simulate(one, None, tmj.MuJoCo(), duration=0.1)
        assert np.array_equal(run.nodes, alone.nodes)
        assert np.array_equal(run.dissipation, alone.dissipation)


def test_a_law_of_ones_own_pulls_at_elastic_rods_too() -> None:
    def law(time: float, nodes: Array, velocities: Array) -> Array:
        return np.full(5, 10.0)

    runs = [tmj.simulate(soft_pair(), law, engine, duration=0.1) for engine in (tmj.MuJoCo(1e-3), EXACT)]
    assert tmj.compare(*runs).max_node_error < 1e-8
    assert runs[0].energy_residual < 1e-7
