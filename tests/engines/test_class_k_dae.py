"""Runs of structures whose rods share nodes: against models of few coordinates, and what must stay as it is."""

from __future__ import annotations

import natural_coordinates as natural
import numpy as np
import pytest
from dense_equations import SOLVERS, dae
from momenta import angular_momentum, linear_momentum
from natural_coordinates import chain, random_class_k, request
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import tensegrity_mj as tmj
from tensegrity_mj.engines.reference.dae import DAE, Drift
from tensegrity_mj.engines.reference.engine import integrate
from tensegrity_mj.engines.reference.method import Method
from tensegrity_mj.engines.reference.ode import ODE
from tensegrity_mj.model.members import Support
from tensegrity_mj.model.structure import Structure

GRAVITY = (0.0, 0.0, -9.81)
FINE = DAE(rtol=1e-12, atol=1e-13)


def test_a_double_pendulum_follows_lagrange_s_equations():
    """Two thin rods of length ℓ_i and mass m_i: the textbook's equations, integrated in the angles."""
    (m1, m2), (l1, l2), g = (1.3, 0.8), (0.7, 0.9), 9.81

    def swing(_, y):
        a, b, u, v = y
        M = np.array(
            [
                [(m1 / 3 + m2) * l1**2, 0.5 * m2 * l1 * l2 * np.cos(a - b)],
                [0.5 * m2 * l1 * l2 * np.cos(a - b), m2 * l2**2 / 3],
            ]
        )
        load = [
            -0.5 * m2 * l1 * l2 * np.sin(a - b) * v**2 - (0.5 * m1 + m2) * g * l1 * np.sin(a),
            0.5 * m2 * l1 * l2 * np.sin(a - b) * u**2 - 0.5 * m2 * g * l2 * np.sin(b),
        ]
        return [u, v, *np.linalg.solve(M, load)]

    start = [0.9, -0.4, 0.0, 0.0]
    times = np.arange(101) * 0.01
    angles = solve_ivp(swing, (0, 1.0), start, method="DOP853", t_eval=times, rtol=1e-13, atol=1e-14).y

    def bar(angle, length):
        return length * np.stack([np.sin(angle), 0 * angle, -np.cos(angle)], axis=-1)

    first = bar(angles[0], l1)
    second = first + bar(angles[1], l2)
    nodes = [[0, 0, 0], first[0], second[0]]
    structure = Structure.from_arrays(
        nodes, [(0, 1), (1, 2)], [], rod_mass=[m1, m2], stiffness=1.0, supports=[Support.pinned(0.0), Support.free(0.2)]
    )
    for solver in SOLVERS:
        run = tmj.simulate(
            tmj.Scene(structure, gravity=GRAVITY), None, dae(solver, rtol=1e-12, atol=1e-13), duration=1.0
        )
        # Truncation of some 1e-12 that this start, before the first somersault, amplifies less than tenfold.
        assert np.abs(run.nodes[:, 1] - first).max() <= 1e-10
        assert np.abs(run.nodes[:, 2] - second).max() <= 1e-10


CRANK, COUPLER, ROCKER, GROUND = 0.5, 1.1, 0.9, 1.0
MASSES = (1.2, 0.7, 2.0)


def four_bar_places(theta):
    """Joints A and B (…, 2) of the four-bar with its crank at an angle from the ground line, in the open branch."""
    a = CRANK * np.array([np.cos(theta), np.sin(theta)])
    to = np.array([GROUND, 0.0]) - a
    distance = np.hypot(*to)
    along = (COUPLER**2 - ROCKER**2 + distance**2) / (2 * distance)
    height = np.sqrt(COUPLER**2 - along**2)
    return a, a + (along * to + height * np.array([-to[1], to[0]])) / distance


def four_bar_slopes(theta):
    """Their first and second derivatives to θ, from |AB| and |BD| being constant."""
    a, b = four_bar_places(theta)
    ground = np.array([GROUND, 0.0])
    slope_a = CRANK * np.array([-np.sin(theta), np.cos(theta)])
    G = np.array([b - a, b - ground])
    slope_b = np.linalg.solve(G, [(b - a) @ slope_a, 0.0])
    bend_a = -a
    bend_b = np.linalg.solve(
        G,
        [
            (b - a) @ bend_a - (slope_b - slope_a) @ (slope_b - slope_a),
            -slope_b @ slope_b,
        ],
    )
    return slope_a, slope_b, bend_a, bend_b


def four_bar_acceleration(theta, rate):
    """θ̈ of ½ I(θ) θ̇² + V(θ): I = dT/d(θ̇²/2) of three rods, its derivative from the second derivatives."""
    slope_a, slope_b, bend_a, bend_b = four_bar_slopes(theta)
    m1, m2, m3 = MASSES
    inertia = (m1 * slope_a @ slope_a + m2 * (slope_a @ slope_a + slope_a @ slope_b + slope_b @ slope_b)) / 3
    inertia += m3 * slope_b @ slope_b / 3
    change = 2 * m1 * slope_a @ bend_a / 3 + 2 * m3 * slope_b @ bend_b / 3
    change += m2 * (2 * slope_a @ bend_a + bend_a @ slope_b + slope_a @ bend_b + 2 * slope_b @ bend_b) / 3
    weight = 9.81 * (0.5 * m1 * slope_a[1] + 0.5 * m2 * (slope_a[1] + slope_b[1]) + 0.5 * m3 * slope_b[1])
    return (-weight - 0.5 * change * rate**2) / inertia


def four_bar(plane=None):
    """The four-bar as a scene: two pinned rods and a coupler, in the xz plane."""
    a, b = four_bar_places(1.2)
    nodes = [[0, 0, 0], [a[0], 0, a[1]], [b[0], 0, b[1]], [GROUND, 0, 0]]
    structure = Structure.from_arrays(
        nodes,
        [(0, 1), (1, 2), (2, 3)],
        [],
        rod_mass=MASSES,
        stiffness=1.0,
        supports=[Support.pinned(0.0, plane=plane), Support.free(0.3, plane=plane), Support.pinned(1.0, plane=plane)],
        name="four-bar",
    )
    return tmj.Scene(structure, gravity=GRAVITY, duration=2.0)


@pytest.mark.parametrize("plane", [None, (0.0, 1.0, 0.0)])
@pytest.mark.parametrize("drift", Drift)
def test_a_four_bar_loop_follows_its_one_coordinate_for_two_seconds(plane, drift):
    times = np.arange(201) * 0.01
    answer = solve_ivp(
        lambda _, y: [y[1], four_bar_acceleration(y[0], y[1])],
        (0, 2.0),
        [1.2, 0.0],
        method="DOP853",
        t_eval=times,
        rtol=1e-13,
        atol=1e-14,
    ).y
    assert np.ptp(answer[0]) > 2  # it swings
    expected = np.array([np.concatenate(four_bar_places(theta)) for theta in answer[0]])
    run = tmj.simulate(four_bar(plane), None, DAE(rtol=1e-12, atol=1e-13, drift=drift))
    found = run.nodes[:, 1:3][:, :, [0, 2]].reshape(-1, 4)
    assert np.abs(found - expected).max() <= 1e-9  # the requirement; truncation is a tenth of it
    assert np.abs(run.nodes[:, :, 1]).max() <= 1e-12
    # A gap is linear in the coordinates, and its second derivative is zero to round-off; that of velocities of 10 m/s.
    assert run.reports["closure_drift"] <= 1e-11
    assert run.energy_residual <= 1e-9


def test_reports_say_how_far_loops_have_opened_and_normalizing_closes_them():
    """A start with an open loop: the gap stays, is projected away, or decays as e^(-ωt)(1 + ωt) by Baumgarte."""
    scene = four_bar()
    gaps = {}
    for drift in Drift:
        engine = DAE(method=Method.RK4, timestep=1e-3, drift=drift, baumgarte_frequency=20.0)
        run = engine.prepared(request(scene))
        records = run.records
        records.place(run.y[: records.nq], np.zeros(records.nq))
        run.y[: records.nq] += 1e-4 * np.array([0.3, 0.0, 0.5, -0.2, 0.0, 0.7, 0.1, 0.0, 0.4])
        records.place(run.y[: records.nq], np.zeros(records.nq))
        before = np.linalg.norm(records.table["gaps"][0, 0])
        made = integrate(run)
        records.place(run.y[: records.nq], np.zeros(records.nq))
        gaps[drift] = np.linalg.norm(records.table["gaps"][0, 0]) / before
        assert made.reports["closure_drift"] == pytest.approx(before, rel=1e-6)
    assert gaps[Drift.MONITOR] == pytest.approx(1.0, abs=1e-9)
    assert gaps[Drift.NORMALIZE] <= 1e-11  # 1e-16 m of 1e-4 m
    # Truncation of RK4, (ω h)⁵/120 a step, is 3e-8 of it after 1000 steps; round-off of 1e-16 m is 1e-4 of 4e-12 m.
    assert gaps[Drift.BAUMGARTE] == pytest.approx(np.exp(-20.0) * 21, rel=1e-3)


def test_a_free_chain_keeps_its_momenta_and_its_energy():
    structure = chain(np.random.default_rng(4), 6, top=Support.free(0.4))
    rng = np.random.default_rng(5)
    velocities = natural.consistent_velocities(structure, structure.positions, rng.normal(size=(7, 3)))
    scene = tmj.Scene(structure, initial_velocities=velocities, duration=1.0)
    run = tmj.simulate(scene, None, FINE)
    linear = linear_momentum(structure, run.velocities)
    angular = angular_momentum(structure, run.nodes, run.velocities)
    # Linear momentum is linear in q̇, with round-off alone; the others err by the truncation.
    assert np.abs(linear - linear[0]).max() <= 1e-12
    assert np.abs(angular - angular[0]).max() <= 1e-9
    assert run.energy_residual <= 1e-9
    assert np.abs(run.kinetic_energy - run.kinetic_energy[0]).max() <= 1e-9


@pytest.mark.parametrize("drift", Drift)
def test_the_energy_of_an_undamped_cable_stays_to_the_order_of_the_method(drift):
    structure = chain(np.random.default_rng(3), 4)
    scene = tmj.Scene(structure, gravity=GRAVITY, duration=0.4)
    errors = [
        tmj.simulate(scene, None, DAE(method=Method.RK4, timestep=h, drift=drift)).energy_residual for h in (2e-3, 1e-3)
    ]
    # Fourth order at least; Baumgarte's terms are of the size of the drift, which falls as fast.
    assert errors[1] <= errors[0] / 10


def test_random_structures_run_with_loops_that_are_redundant_or_rigid():
    """Whatever chance has made: energy closes, lengths and joints stay."""
    for seed in range(4):
        structure = random_class_k(np.random.default_rng(seed), rods=8, loops=2, planar=bool(seed % 2))
        scene = tmj.Scene(structure, gravity=GRAVITY, duration=0.3)
        run = tmj.simulate(scene, None, DAE(drift=Drift.NORMALIZE))
        assert run.energy_residual <= 1e-6 * max(1.0, run.kinetic_energy.max())
        lengths = np.linalg.norm(np.diff(run.nodes[:, structure.rod_nodes], axis=2)[:, :, 0], axis=-1)
        assert np.abs(lengths - structure.rod_lengths).max() <= 1e-8


def test_the_solver_leaves_class_1_alone_and_may_be_chosen_there():
    from evidence.random_structures import random_scene, random_structure

    rng = np.random.default_rng(2)
    structure = random_structure(rng, rods=3)
    scene = random_scene(rng, structure, displaced=0.2, moving=1.0).with_(duration=0.2)
    runs = [tmj.simulate(scene, None, dae(solver)) for solver in SOLVERS]
    for run in runs[1:]:
        assert np.abs(run.nodes - runs[0].nodes).max() <= 1e-9
        assert np.abs(run.multipliers - runs[0].multipliers).max() <= 1e-6


@pytest.mark.parametrize("solver", SOLVERS)
def test_point_masses_alone_have_no_matrix_to_solve(solver):
    """x = 0.1 cos √10 t of 1 kg between two springs of 5 N/m; RK4 at ω h = 0.0032 errs by (ω h)⁴ ω t / 1200, 3e-13."""
    strings = tuple(tmj.String(name, ("m", name), 5.0, rest_length=0.8) for name in ("left", "right"))
    structure = tmj.Structure(
        "spring",
        {"m": (0.1, 0.0, 0.0), "left": (-1.0, 0.0, 0.0), "right": (1.0, 0.0, 0.0)},
        strings=strings,
        fixed_nodes=("left", "right"),
        point_masses=(tmj.PointMass("m", 1.0),),
    )
    run = tmj.simulate(tmj.Scene(structure, duration=1.0), None, dae(solver, method=Method.RK4, timestep=1e-3))
    np.testing.assert_allclose(run.nodes[:, 0, 0], 0.1 * np.cos(np.sqrt(10.0) * run.time), rtol=0, atol=1e-12)


def test_the_minimal_model_and_the_laws_of_class_1_refuse_shared_nodes_in_words():
    scene = four_bar()
    with pytest.raises(tmj.errors.StructureError, match=r"ODE: rods 'r1' and 'r2' share node 'n2'.*use MuJoCo or DAE"):
        tmj.simulate(scene, None, ODE())
    scene = tmj.load_scene("dbar")
    target = tmj.Target.set_point(scene.nodes0)
    for law in (tmj.controllers.Lyapunov, tmj.controllers.FeedbackLinearization):
        with pytest.raises(tmj.errors.StructureError, match=r"class 1"):
            tmj.simulate(scene, law(scene.structure, target), DAE(), duration=0.1)
    with pytest.raises(tmj.errors.OptionError, match="solver"):
        DAE(solver="joint")


def test_the_cable_has_the_frequencies_of_chapter_3():
    """f1 = 0.3242 Hz, f2 = 0.9329 Hz with the data of §3.3.3, to four digits as they are given."""
    for plane, each in ((None, 2), ((1.0, 0.0, 0.0), 1)):
        lengths = np.array([0.13] + [0.25] * 11 + [0.05])
        places = np.zeros((14, 3))
        places[1:, 2] = -np.cumsum(lengths)
        structure = Structure.from_arrays(
            places,
            [(k, k + 1) for k in range(13)],
            [],
            rod_mass=[0.0506] + [0.0129] * 11 + [0.0513],
            stiffness=1.0,
            supports=[Support.pinned(0.0, plane=plane)] + [Support.free(plane=plane)] * 12,
        )
        model = tmj.linearize(tmj.Scene(structure, gravity=GRAVITY), DAE())
        assert model.is_equilibrium
        assert model.frequencies[0] == pytest.approx(0.3242, abs=6e-5)
        assert model.frequencies[each] == pytest.approx(0.9329, abs=6e-5)
        # Against V'' and M of the angles: M = (3.13), V'' = diag(g ℓ_i (m_i/2 + Σ_{k>i} m_k)).
        mass, count = structure.rod_masses, 13
        below = np.array([mass[k + 1 :].sum() for k in range(count)])
        M = np.diag(mass * lengths**2 / 3 + lengths**2 * below)
        for i in range(count):
            for j in range(i + 1, count):
                M[i, j] = M[j, i] = lengths[i] * lengths[j] * (0.5 * mass[j] + below[j])
        squares = np.linalg.eigvals(np.linalg.solve(M, np.diag(9.81 * lengths * (0.5 * mass + below))))
        expected = np.sort(np.sqrt(squares.real)) / (2 * np.pi)
        # The eigenvalues span 1e3, and A's entries are right to 1e-13 of the largest.
        assert np.abs(np.sort(model.frequencies)[::each] / expected - 1).max() <= 1e-9


def test_the_linear_model_of_a_loop_has_its_one_coordinate():
    """A four-bar at the bottom of its potential: ω² = V''/I, by differences of the one-coordinate model."""
    hanging = brentq(lambda theta: four_bar_acceleration(theta, 0.0), -2.4, -0.6, xtol=1e-15)
    a, b = four_bar_places(hanging)
    scene = four_bar((0.0, 1.0, 0.0))
    nodes = np.array([[0, 0, 0], [a[0], 0, a[1]], [b[0], 0, b[1]], [GROUND, 0, 0]])
    model = tmj.linearize(scene, DAE(), nodes=nodes)
    assert len(model.coordinates) == 1
    assert model.is_equilibrium
    h = 1e-3
    weights, steps = np.array([1, -8, 8, -1]) / (12 * h), np.array([-2, -1, 1, 2]) * h
    slope = float(weights @ [four_bar_acceleration(hanging + step, 0.0) for step in steps])
    # The differences' truncation is h⁴ of derivatives of the order of 100.
    assert model.frequencies[0] == pytest.approx(np.sqrt(-slope) / (2 * np.pi), rel=1e-8)
    delta = model.deviation(nodes, np.zeros((4, 3)))
    assert np.abs(delta).max() <= 1e-15


def test_linear_models_refuse_moved_supports():
    motion = tmj.model.Motion.in_line("r1", 0.1, 1.0, (1.0, 0.0, 0.0))
    scene = tmj.Scene(chain(np.random.default_rng(0), 2), motions=(motion,))
    with pytest.raises(tmj.errors.SceneError, match=r"linearize: support 'r1' moves .*depend on time"):
        tmj.linearize(scene, DAE())
