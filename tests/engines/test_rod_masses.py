"""Rods that carry masses, and damped point masses: closed forms and equations of the test's own, in every engine."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import natural_coordinates as natural
import numpy as np
import pytest
from dense_equations import dae
from loaded_rods import cloud, loaded, mass_of_nodes
from natural_coordinates import chain, random_class_k, request
from scipy.integrate import solve_ivp
from scipy.special import ellipk

import tensegrity_mj as tmj
from evidence.extremes.pace import mobility
from tensegrity_mj.controllers import from_scene
from tensegrity_mj.engines.accuracy.rates import string_rates
from tensegrity_mj.model import PointMass, RodMass
from tensegrity_mj.model.moved_supports import velocities_with_supports
from tensegrity_mj.vibration.stable_step import stable_step

G = 9.81
GRAVITY = (0.0, 0.0, -G)
Y = (0.0, 1.0, 0.0)
TIGHT = tmj.DAE(rtol=1e-12, atol=1e-13)
NAMES = ("joints", "dense", "full", "general")
SOLVERS = [dae(solver, rtol=1e-12, atol=1e-13) for solver in NAMES]
FIXED: dict[str, Callable[[float], Any]] = {
    "mujoco": lambda step: tmj.MuJoCo(timestep=step),
    "dae": lambda step: tmj.DAE(method=tmj.Method.RK4, timestep=step),
    "ode": lambda step: tmj.ODE(method=tmj.Method.RK4, timestep=step),
}
TRUTH = {"dae": TIGHT, "ode": tmj.ODE(rtol=1e-12, atol=1e-13)}

ROD, LENGTH, LUMP, BOB = 0.4, 0.9, RodMass(0.35, 0.3, 4e-3), 0.6
TOTAL = ROD + LUMP.mass + BOB
# About an end: of the rod, the lump and its own, and a bob at the other end.
ABOUT_END = ROD * LENGTH**2 / 3 + LUMP.mass * (LUMP.at * LENGTH) ** 2 + LUMP.inertia + BOB * LENGTH**2
CENTER = (0.5 * ROD + LUMP.at * LUMP.mass + BOB) / TOTAL  # of the length, from that end
ABOUT_CENTER = ABOUT_END - TOTAL * (CENTER * LENGTH) ** 2


def rod_with_bob(ends: dict[str, Any], support: tmj.Support, damping: float = 0.0) -> tmj.Structure:
    rod = tmj.Rod("rod", tuple(ends), ROD, 0.01, support, masses=(LUMP,))  # type: ignore[arg-type]
    return tmj.Structure("bob", ends, (rod,), point_masses=(PointMass(list(ends)[1], BOB, damping=damping),))


def pendulum(angle: float, damping: float = 0.0, gravity: tuple[float, float, float] = GRAVITY) -> tmj.Scene:
    ends = {"pin": (0.0, 0.0, 0.0), "bob": (LENGTH * math.sin(angle), 0.0, -LENGTH * math.cos(angle))}
    return tmj.Scene(rod_with_bob(ends, tmj.Support.pinned(0.0, Y), damping), gravity=gravity)


@pytest.mark.parametrize("engine", FIXED)
def test_a_pendulum_with_a_bob_has_the_period_of_the_elliptic_integral(engine: str) -> None:
    """T = 4 K(sin²(α/2)) √(J / m g d), from rest at α: after T/4 it passes the vertical, in the other sense after 3T/4.

    RK4 errs by n (ω h)⁵/120 of the amplitude at most, some times that for the higher harmonics of a swing of 1.2 rad.
    """
    alpha, omega = 1.2, math.sqrt(TOTAL * G * CENTER * LENGTH / ABOUT_END)
    quarter = ellipk(math.sin(alpha / 2) ** 2) / omega
    steps = 400
    run = tmj.simulate(
        pendulum(alpha), None, FIXED[engine](quarter / steps), duration=3 * quarter, output_interval=quarter
    )
    error = 3 * steps * (omega * quarter / steps) ** 5 / 120
    np.testing.assert_allclose(run.nodes[[1, 3], 1, 0], 0.0, atol=10 * error * LENGTH)
    np.testing.assert_allclose(run.nodes[2, 1, 0], -LENGTH * math.sin(alpha), atol=10 * error * LENGTH)


@pytest.mark.parametrize("engine", TRUTH)
def test_its_small_swings_and_their_decay_are_in_closed_form(engine: str) -> None:
    """J θ̈ + c ℓ² θ̇ + m g d θ = 0 of the linear model at rest, by its eigenvalues; differences are good to 1e-6."""
    c = 0.3
    model = tmj.linearize(pendulum(0.0, c), engine=TRUTH[engine])
    decay = c * LENGTH**2 / (2 * ABOUT_END)
    frequency = math.sqrt(TOTAL * G * CENTER * LENGTH / ABOUT_END - decay**2)
    found = np.linalg.eigvals(model.A)
    np.testing.assert_allclose(sorted(found.imag), [-frequency, frequency], rtol=1e-6)
    np.testing.assert_allclose(found.real, -decay, rtol=1e-6)


@pytest.mark.parametrize("engine", FIXED)
@pytest.mark.parametrize("sigma", [0.0, 0.5, 0.8])
def test_a_free_rod_spins_about_its_centre_of_mass(engine: str, sigma: float) -> None:
    """c = c₀ + v t and b turns at a constant rate: with ends at c + (s - CENTER) ℓ b.

    RK4 errs by n (ω h)⁵/120 of the distance to the centre in b, which here turns by three radians in 1000 steps.
    """
    along, across, spin = np.array([0.6, 0.0, 0.8]), np.array([-0.8, 0.0, 0.6]), 3.0
    drift = np.array([0.3, -0.2, 0.1])
    levers = LENGTH * np.array([-CENTER, 1 - CENTER])

    def ends(t: float) -> np.ndarray:
        b = math.cos(spin * t) * along + math.sin(spin * t) * across
        return drift * t + levers[:, None] * b

    first, second = ends(0.0).tolist()
    structure = rod_with_bob({"i": tuple(first), "j": tuple(second)}, tmj.Support.free(sigma))
    rates = drift + spin * levers[:, None] * across
    scene = tmj.Scene(structure, initial_velocities=rates)
    run = tmj.simulate(scene, None, FIXED[engine](1e-3), duration=1.0, output_interval=0.1)
    exact = np.array([ends(t) for t in run.time])
    assert np.abs(run.nodes - exact).max() < 1000 * (spin * 1e-3) ** 5 / 120 * LENGTH + 1e-12
    energy = 0.5 * TOTAL * drift @ drift + 0.5 * ABOUT_CENTER * spin**2
    np.testing.assert_allclose(run.kinetic_energy, energy, rtol=1e-10)


def test_a_double_pendulum_with_bobs_follows_lagranges_equations() -> None:
    """Two bodies of masses m, with centres at d and moments J about their upper ends, in the angles from the vertical:
    the bob at the joint is of the upper one. Integrated here by SciPy to 1e-13.
    """
    l1, l2, m1, m2 = 0.7, 0.9, (0.5, 0.4), (0.3, 0.8)  # lengths; rod and bob at its lower end
    lump = RodMass(0.25, 0.6, 2e-2)  # on the lower rod, from its upper end
    J1 = m1[0] * l1**2 / 3 + m1[1] * l1**2
    first1 = 0.5 * m1[0] * l1 + m1[1] * l1
    below = m2[0] + m2[1] + lump.mass
    J2 = m2[0] * l2**2 / 3 + m2[1] * l2**2 + lump.mass * (lump.at * l2) ** 2 + lump.inertia
    first2 = 0.5 * m2[0] * l2 + m2[1] * l2 + lump.mass * lump.at * l2

    def swing(_: float, y: np.ndarray) -> list[float]:
        a, b, u, v = y
        both = first2 * l1 * math.cos(a - b)
        M = [[J1 + below * l1**2, both], [both, J2]]
        turn = first2 * l1 * math.sin(a - b)
        load = [-turn * v**2 - (first1 + below * l1) * G * math.sin(a), turn * u**2 - first2 * G * math.sin(b)]
        return [u, v, *np.linalg.solve(M, load)]

    times = np.arange(51) * 0.02
    y = solve_ivp(swing, (0, 1.0), [0.9, -0.4, 0, 0], method="DOP853", t_eval=times, rtol=1e-13, atol=1e-14).y
    upper = l1 * np.stack([np.sin(y[0]), 0 * y[0], -np.cos(y[0])], axis=-1)
    lower = upper + l2 * np.stack([np.sin(y[1]), 0 * y[1], -np.cos(y[1])], axis=-1)
    nodes = {"o": (0.0, 0.0, 0.0), "a": tuple(upper[0].tolist()), "b": tuple(lower[0].tolist())}
    rods = (
        tmj.Rod("upper", ("o", "a"), m1[0], support=tmj.Support.pinned()),
        # From below: what is at 0.25 from above is at 0.75.
        tmj.Rod("lower", ("b", "a"), m2[0], masses=(replace(lump, at=1 - lump.at),)),
    )
    points = (PointMass("a", m1[1]), PointMass("b", m2[1]))
    scene = tmj.Scene(tmj.Structure("two", nodes, rods, point_masses=points), gravity=GRAVITY, duration=1.0)
    exact = np.stack([np.zeros_like(upper), upper, lower], axis=1)
    for engine in SOLVERS:
        run = tmj.simulate(scene, None, engine, output_interval=0.02)
        # Truncation of some 1e-12, which this start, before the first somersault, amplifies less than tenfold.
        assert np.abs(run.nodes - exact).max() < 1e-10, engine.solver
    errors = [
        float(np.abs(tmj.simulate(scene, None, tmj.MuJoCo(h), output_interval=0.02).nodes - exact).max())
        for h in (2e-3, 1e-3)
    ]
    print(errors)
    assert errors[1] < errors[0] / 2**3.5  # order 4, but for half an order of the terms beyond
    assert errors[1] < 1e-8


@pytest.mark.parametrize("planar", [False, True])
@pytest.mark.parametrize("seed", range(6))
def test_accelerations_are_those_of_points_of_mass(seed: int, planar: bool) -> None:
    """Gauss's principle in the nodes' coordinates, whose mass matrix is summed over points along the rods.

    Condition numbers of the constraints' Gram matrix reach 1e6 in these random loops, and it is solved twice.
    """
    loops = seed % 3
    scene = loaded(tmj.Scene(random_class_k(np.random.default_rng(seed), 7, loops, planar), gravity=GRAVITY), seed)
    structure, rng = scene.structure, np.random.default_rng(seed)
    velocities = natural.consistent_velocities(structure, scene.nodes0, rng.normal(size=scene.nodes0.shape))
    scene = scene.with_(initial_velocities=velocities)
    forces = natural.string_forces(structure, scene.nodes0, velocities)
    expected, pulls = natural.accelerations(structure, scene.nodes0, velocities, forces, GRAVITY)
    for engine in [*SOLVERS, *([] if loops else [tmj.MuJoCo()])]:
        _, found = engine.accelerations(request(scene))(0.0, scene.nodes0, velocities)
        assert np.abs(found - expected).max() <= 1e-9 * max(1.0, np.abs(expected).max()), engine
        if not loops:  # where the forces in rods are the only ones
            run = tmj.simulate(scene, None, engine, duration=2e-3)
            np.testing.assert_allclose(run.rod_force_densities[0], pulls, atol=1e-9 * np.abs(pulls).max())


MOVING = dict(zip(NAMES, SOLVERS, strict=True)) | {
    "mujoco": tmj.MuJoCo(1e-3),
    "ode": TRUTH["ode"],
}


@pytest.mark.parametrize(("engine", "count"), [(name, n) for name in MOVING for n in (1, 3) if (name, n) != ("ode", 3)])
def test_what_moves_a_support_does_the_work_of_all_that_is_carried(engine: str, count: int) -> None:
    """Energy of points of mass, with their velocities along the rods, less what gravity did, is the support's work."""
    motion = tmj.model.Motion.in_line("r1", 0.05, 1.3, (1.0, 0.4, 1.0))
    scene = loaded(tmj.Scene(chain(np.random.default_rng(count), count), gravity=GRAVITY, motions=(motion,)))
    if count == 1:  # of which `loaded` spares the first
        rods = (replace(scene.structure.rods[0], masses=(LUMP, RodMass(0.8, 0.2))),)
        scene = scene.with_(structure=replace(scene.structure, rods=rods))
    run = tmj.simulate(scene, None, MOVING[engine], duration=0.5, output_interval=0.05)
    mass = mass_of_nodes(scene.structure)
    kinetic = 0.5 * np.einsum("tik,ij,tjk->t", run.velocities, mass, run.velocities)
    np.testing.assert_allclose(run.kinetic_energy, kinetic, rtol=1e-12)
    heights = sum(
        m * ((1 - s) * run.nodes[:, i, 2] + s * run.nodes[:, j, 2])
        for row, s, m in cloud(scene.structure)
        for i, j in [scene.structure.rod_nodes[row]]
    )
    heights += sum(
        one.mass * run.nodes[:, scene.structure.node_index[one.node], 2] for one in scene.structure.point_masses
    )
    total = kinetic + G * heights
    # RK4 with a step of 1 ms of swings at 10 /s at most: 500 (1e-2)⁵/120 of 10 J; the DAE's tolerance is below.
    np.testing.assert_allclose(run.external_work, total - total[0], atol=1e-8)
    assert np.ptp(run.external_work) > 0.1


@pytest.mark.third_means("resistance.add_fluid at dampers of nodes", by="e^{-ct/m}; e^{-cℓ²t/J} of a rod's end")
@pytest.mark.parametrize("engine", FIXED)
def test_the_damping_of_a_point_mass_is_e_to_the_minus_ct_over_m(engine: str) -> None:
    """A free mass: v = v₀ e^{-ct/m}. One at the end of a rod without gravity: θ̇ = ω₀ e^{-c ℓ² t/J}.

    RK4 errs by n (c h/m)⁵/120 of v₀; what is lost is the kinetic energy that is gone.
    """
    c, m, v, h = 0.8, 0.5, np.array([1.0, -2.0, 0.5]), 2e-3
    free = tmj.Structure("free", {"p": (0.0, 0.0, 0.0)}, point_masses=(PointMass("p", m, damping=c),))
    scene = tmj.Scene(free, initial_velocities=v[None])
    run = tmj.simulate(scene, None, FIXED[engine](h), duration=1.0, output_interval=0.1)
    left = np.exp(-c / m * run.time)
    error = 500 * (c / m * h) ** 5 / 120
    np.testing.assert_allclose(run.velocities[:, 0], left[:, None] * v, atol=2 * error * 3)
    np.testing.assert_allclose(run.nodes[:, 0], m / c * (1 - left)[:, None] * v, atol=2 * error * 3)
    np.testing.assert_allclose(run.dissipation, 0.5 * m * v @ v * (1 - left**2), atol=20 * error)
    rate = 2.0
    turning = pendulum(0.3, c, (0.0, 0.0, 0.0))
    velocity = np.zeros((2, 3))
    velocity[1] = rate * LENGTH * np.array([math.cos(0.3), 0.0, math.sin(0.3)])
    run = tmj.simulate(turning.with_(initial_velocities=velocity), None, FIXED[engine](h), duration=1.0)
    slow = c * LENGTH**2 / ABOUT_END
    angle = 0.3 + rate / slow * (1 - np.exp(-slow * run.time))
    np.testing.assert_allclose(run.nodes[:, 1, 0], LENGTH * np.sin(angle), atol=500 * (rate * h) ** 5)


def test_laws_know_what_rods_carry_and_what_damps_them() -> None:
    """V falls as e^{-δt} of a law that was made for the structure as it is, in MuJoCo: its error is truncation alone,
    and falls with the step by more than four a halving. Of one that knows the rods alone, it does not fall so at all.
    """
    scene = tmj.load_scene("pinned_rod")
    (rod,), bob = scene.structure.rods, scene.structure.rods[0].nodes[1]
    heavy = replace(
        scene.structure,
        rods=(replace(rod, masses=(RodMass(0.3, 0.5, 1e-2),)),),
        point_masses=(PointMass(bob, 0.2, damping=0.05),),
    )

    def residual(known: tmj.Structure, step: float) -> float:
        law = from_scene(scene.with_(structure=known))
        run = tmj.simulate(scene.with_(structure=heavy), law, tmj.MuJoCo(step), duration=5.0)
        true = from_scene(scene.with_(structure=heavy))
        rows = zip(run.time, run.nodes, run.velocities, strict=True)
        V = np.array([true.evaluate(t, n, v)[2] for t, n, v in rows])
        return float(np.max(np.abs(V / (V[0] * np.exp(-law.decay_rate * run.time)) - 1)))

    errors = [residual(heavy, h) for h in (1e-2, 5e-3, 2.5e-3)]
    print(errors)
    assert errors[0] > 4 * errors[1] > 16 * errors[2]
    assert residual(scene.structure, 2.5e-3) > 1e-2


@pytest.mark.parametrize("end", [0, 1])
def test_the_stable_step_is_that_of_the_end_that_is_heavier_or_lighter(end: int) -> None:
    """A string along z at an end of a free level rod: ω² = k (1/m + a²/I), a from the centre to that end.

    RK4's limit of an oscillator without damping is √8/ω.
    """
    k = 200.0
    ends = {"i": (0.0, 0.0, 0.0), "j": (LENGTH, 0.0, 0.0)}
    structure = rod_with_bob(ends, tmj.Support.free())
    at = structure.positions[end]
    nodes = structure.nodes | {"hook": (float(at[0]), 0.0, 1.0)}
    string = (tmj.String("s", ("hook", "ij"[end]), k, rest_length=1.0),)
    scene = tmj.Scene(replace(structure, nodes=nodes, strings=string, fixed_nodes=("hook",)))
    arm = (CENTER if end == 0 else 1 - CENTER) * LENGTH
    omega = math.sqrt(k * (1 / TOTAL + arm**2 / ABOUT_CENTER))
    for engine in (tmj.MuJoCo(), tmj.DAE(method=tmj.Method.RK4, timestep=1e-3)):
        found = stable_step(scene, engine)
        assert found.omega == pytest.approx(omega, rel=1e-10)
        assert found.limit == pytest.approx(math.sqrt(8) / omega, rel=1e-6)


def test_bounds_of_rates_and_the_pace_know_what_rods_carry() -> None:
    """Of one string across a rod the bound is its frequency; forces at rest accelerate nodes by points of mass."""
    k = 200.0
    nodes = {"i": (0.0, 0.0, 0.0), "j": (LENGTH, 0.0, 0.0), "hook": (LENGTH, 0.0, 1.0)}
    alone = rod_with_bob({name: nodes[name] for name in "ij"}, tmj.Support.free())
    string = (tmj.String("s", ("hook", "j"), k, 3.0, rest_length=1.0),)
    structure = replace(alone, nodes=nodes, strings=string, fixed_nodes=("hook",))
    mobility_of_end = 1 / TOTAL + ((1 - CENTER) * LENGTH) ** 2 / ABOUT_CENTER
    found = string_rates(structure, structure.positions)
    np.testing.assert_allclose(found, (math.sqrt(k * mobility_of_end), 3.0 * mobility_of_end), rtol=1e-12)
    scene = loaded(tmj.load_scene("prism"))
    forces = np.random.default_rng(3).normal(size=scene.nodes0.shape)
    expected, _ = natural.accelerations(scene.structure, scene.nodes0, np.zeros_like(forces), forces, (0.0, 0.0, 0.0))
    W = mobility(scene.structure, scene.nodes0)
    np.testing.assert_allclose((W @ forces.ravel()).reshape(-1, 3), expected, atol=1e-12 * np.abs(expected).max())


def test_a_damped_point_mass_limits_the_step() -> None:
    """RK4 of ẋ = -(c/m) x is stable up to h c/m = 2.7852936, where |1 + z + z²/2 + z³/6 + z⁴/24| = 1."""
    c, m = 0.8, 0.05
    free = tmj.Structure("free", {"p": (0.0, 0.0, 0.0)}, point_masses=(PointMass("p", m, damping=c),))
    limit = stable_step(tmj.Scene(free), tmj.MuJoCo()).limit
    assert limit == pytest.approx(2.785293563405282 * m / c, rel=1e-9)


def test_a_blow_of_the_support_leaves_the_momentum_about_it() -> None:
    """A rod that moves across itself at v when its pin is found at rest turns at f v / J, by what it carries."""
    scene = pendulum(0.0)
    motion = tmj.model.Motion.in_line("rod", 0.1, 1.0, (0.0, 0.0, 1.0))
    v = 0.7
    rates = velocities_with_supports(scene.structure, scene.nodes0, (motion,), np.full((2, 3), (v, 0.0, 0.0)))
    up = motion.at(0.0)[1]
    turning = TOTAL * CENTER * LENGTH / ABOUT_END * v * LENGTH
    np.testing.assert_allclose(rates, [up, up + np.array([turning, 0.0, 0.0])], atol=1e-12)


def test_on_a_floor_a_rod_presses_by_its_centre_of_mass() -> None:
    """Each end carries its share of the weight, once the contact's damping of some 100 /s has let nothing move."""
    ends = {"i": (0.0, 0.0, 0.0105), "j": (LENGTH, 0.0, 0.0105)}
    scene = tmj.Scene(
        rod_with_bob(ends, tmj.Support.free()), gravity=GRAVITY, contact=tmj.model.Contact(floor=0.0), duration=2.0
    )
    run = tmj.simulate(scene, None, tmj.MuJoCo(1e-3), output_interval=1.0)
    pressed = run.reports["contact"]["final_forces"]
    shares = {"i": TOTAL * G * (1 - CENTER), "j": TOTAL * G * CENTER}
    for name, share in shares.items():
        assert pressed[name][2] == pytest.approx(share, rel=1e-6)
