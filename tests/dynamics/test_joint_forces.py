"""Accelerations of rods that share nodes: three solvers of the package, and two models that share nothing with them."""

from __future__ import annotations

import natural_coordinates as natural
import numpy as np
import pytest
from cable_scaling import Evaluation, cable_scaling, exponent
from dense_equations import DENSE, SOLVERS, dae
from hanging_chain import HangingChain
from natural_coordinates import chain, random_class_k, request

import tensegrity_mj as tmj
from evidence.random_structures import random_structure
from tensegrity_mj.dynamics.joint_forces import plan_joints, project_linked
from tensegrity_mj.dynamics.linked import LinkedRecords
from tensegrity_mj.engines.reference.dae import DAE, Drift, Solver
from tensegrity_mj.model import rods
from tensegrity_mj.model.members import Support
from tensegrity_mj.model.motion import Motion
from tensegrity_mj.model.structure import Structure

GRAVITY = (0.3, -0.5, -9.81)


def on_manifold(structure, seed, **options):
    """A scene at the reference nodes with random velocities that fit."""
    rng = np.random.default_rng(seed)
    given = rng.normal(size=(len(structure.nodes), 3))
    velocities = natural.consistent_velocities(structure, structure.positions, given)
    return tmj.Scene(structure, gravity=GRAVITY, initial_velocities=velocities, **options)


def rates_of(scene, solver, shift=0.0, drift=Drift.MONITOR, time=0.0):
    """Node accelerations and λ of a solver at the scene's start, or beside it by a random `shift` of z, b and rates."""
    run = dae(solver, drift=drift).prepared(request(scene))
    records = run.records
    usual = LinkedRecords.of(scene.structure, scene.motions)
    q, rates = usual.state(scene.nodes0, scene.velocities0)
    noise = shift * np.random.default_rng(9).normal(size=2 * usual.nq)
    for row, motion in zip(usual.table["motions"], scene.motions, strict=True):
        row[:] = motion.at(time)
    nq, nodes, velocities = records.nq, *usual.place(q + noise[: usual.nq], rates + noise[usual.nq :])
    run.y[:nq], run.y[nq : 2 * nq] = records.state(nodes, velocities)
    found = records.node_accelerations(run.rates_at(time, run.y, None)[nq : 2 * nq])
    return found, run.multipliers[: len(records.rods)].copy()


def spread(a, b):
    """Largest difference, relative to the largest value."""
    return float(np.abs(a - b).max() / np.abs(b).max())


# Solutions of the three differ by round-off times the condition number of what they solve: trees of 8 rods whose masses
# and lengths vary tenfold have matrices of up to 1e5.
TOLERANCE = 1e-9


def chains_round_off(structure):
    """√K ε cond(M) cond(W): M of (3.13) is inverted, and W = Yᵀ M⁻¹ Y of (3.20) made of it and solved.

    M of the directions b is that of heights times one, W the product of M⁻¹ with b_i·b_j. The equations' own scales of
    W cost no digits. cond(M) grows as K², to 2e6 for 250 rods whose masses and lengths vary tenfold; cond(W) is 20.
    Each number is a sum of K terms, whose round-off has any sign.
    """
    M = HangingChain(structure.rod_lengths, structure.rod_masses).mass_matrix
    first, second = structure.positions[structure.rod_nodes.T]
    b = (second - first) / structure.rod_lengths[:, None]
    W = np.linalg.inv(M) * (b @ b.T)
    scale = 1 / np.sqrt(np.diag(W))
    return np.sqrt(len(M)) * np.finfo(float).eps * np.linalg.cond(M) * np.linalg.cond(scale[:, None] * W * scale)


@pytest.mark.parametrize("off", [False, True])
@pytest.mark.parametrize("count", [1, 2, 13, 100])
def test_three_solvers_agree_on_a_chain_with_a_moving_top_on_and_off_the_manifold(count, off):
    structure = chain(np.random.default_rng(count), count)
    motion = Motion.circular("r1", 0.05, 0.7, (1.0, 2.0, 3.0))
    scene = tmj.Scene(structure, gravity=GRAVITY, motions=(motion,))
    options = {"shift": 0.1 if off else 0.0, "drift": Drift.BAUMGARTE if off else Drift.MONITOR, "time": 0.3}
    joints, multipliers = rates_of(scene, Solver.JOINTS, **options)
    bound = max(1e-13, chains_round_off(structure))  # a single rod has sums of some terms, and nothing to invert
    for solver in (DENSE, Solver.FULL):
        other, forces = rates_of(scene, solver, **options)
        assert spread(other, joints) <= bound
        assert spread(forces, multipliers) <= bound


@pytest.mark.parametrize("planar", [False, True])
@pytest.mark.parametrize("seed", range(12))
def test_three_solvers_agree_on_random_trees_off_the_manifold(seed, planar):
    structure = random_class_k(np.random.default_rng(seed), rods=8, loops=0, planar=planar)
    scene = tmj.Scene(structure, gravity=GRAVITY)
    records = LinkedRecords.of(structure)
    plan = plan_joints(records)
    joints, multipliers = rates_of(scene, Solver.JOINTS, 0.1, Drift.BAUMGARTE)
    # In space every joint is needed, so that none may be taken for redundant; a plane leaves one direction of each.
    run = DAE(drift=Drift.BAUMGARTE).prepared(request(scene))
    run.rates_at(0.0, run.y, None)
    skipped = int(np.sum(run.plant.arrays["joints"]["pivots"] == 0))
    held = sum(len(rod.support.directions) > 0 for rod in structure.rods)
    assert len(plan["joints"]) == 7
    if held <= 1:
        assert skipped == (7 if planar else 0)
    for solver in (DENSE, Solver.FULL):
        other, forces = rates_of(scene, solver, 0.1, Drift.BAUMGARTE)
        if held <= 1:
            assert spread(other, joints) <= TOLERANCE
            assert spread(forces, multipliers) <= TOLERANCE


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("planar", [False, True])
@pytest.mark.parametrize("seed", range(12))
def test_accelerations_of_random_structures_with_loops_are_those_of_node_coordinates(seed, planar, solver):
    structure = random_class_k(np.random.default_rng(seed), rods=8, loops=seed % 4, planar=planar)
    scene = on_manifold(structure, seed)
    _, found = dae(solver).accelerations(request(scene))(0.0, scene.nodes0, scene.velocities0)
    forces = natural.string_forces(structure, scene.nodes0, scene.velocities0)
    expected, _ = natural.accelerations(structure, scene.nodes0, scene.velocities0, forces, GRAVITY)
    # Condition numbers of the constraints' Gram matrix reach 1e6 in these random loops, and it is solved twice.
    assert np.abs(found - expected).max() <= 1e-9 * max(1.0, np.abs(expected).max())


@pytest.mark.parametrize("seed", range(4))
def test_rods_alone_off_the_manifold_are_those_of_chapter_2(seed):
    """The three solvers against the equations that class 1 structures are run with, which share no code with them."""
    rng = np.random.default_rng(seed)
    structure = random_structure(rng, rods=3, planar=bool(seed % 2), own_planes=0.3, point_masses=1)
    scene = tmj.Scene(structure, gravity=GRAVITY)
    alone, multipliers = rates_of(scene, Solver.JOINTS, 0.1, Drift.BAUMGARTE)
    for solver in (DENSE, Solver.FULL):
        linked, forces = rates_of(scene, solver, 0.1, Drift.BAUMGARTE)
        assert spread(linked, alone) <= 1e-12  # matrices of three rods
        assert spread(forces, multipliers) <= 1e-12


@pytest.mark.parametrize("seed", range(8))
def test_rod_forces_of_trees_are_those_of_node_coordinates(seed):
    structure = random_class_k(np.random.default_rng(100 + seed), rods=7, loops=0)
    scene = on_manifold(structure, seed)
    _, multipliers = rates_of(scene, Solver.JOINTS)
    forces = natural.string_forces(structure, scene.nodes0, scene.velocities0)
    _, expected = natural.accelerations(structure, scene.nodes0, scene.velocities0, forces, GRAVITY)
    assert spread(rods.force_densities(structure, multipliers), expected) <= TOLERANCE


@pytest.mark.parametrize("count", [2, 5])
def test_a_planar_chain_obeys_lagrange_s_equations_of_its_angles(count):
    """T = ½ Σ M_ij cos(θ_i - θ_j) θ̇_i θ̇_j with (3.13) corrected, V = -Σ (m_i/2 + Σ_{k>i} m_k) ℓ_i g cos θ_i.

    Hence Σ_j M_ij (cos(θ_i - θ_j) θ̈_j + sin(θ_i - θ_j) θ̇_j²) = -(m_i/2 + Σ_{k>i} m_k) ℓ_i g sin θ_i.
    """
    rng = np.random.default_rng(count)
    mass, length = rng.uniform(0.3, 2, count), rng.uniform(0.2, 1, count)
    theta, rate = rng.uniform(-2, 2, count), rng.normal(size=count)
    below = np.array([mass[k + 1 :].sum() for k in range(count)])
    M = np.diag(mass * length**2 / 3 + length**2 * below)
    for i in range(count):
        for j in range(i + 1, count):
            M[i, j] = M[j, i] = length[i] * (0.5 * mass[j] * length[j] + length[j] * below[j])
    gap = theta[:, None] - theta[None, :]
    load = -(0.5 * mass + below) * length * 9.81 * np.sin(theta) - (M * np.sin(gap)) @ rate**2
    theta_acc = np.linalg.solve(M * np.cos(gap), load)

    def summed(rows):
        return np.concatenate([np.zeros((1, 3)), np.cumsum(length[:, None] * rows, axis=0)])

    zero = np.zeros(count)
    along = np.stack([np.sin(theta), zero, -np.cos(theta)], axis=1)
    across = np.stack([np.cos(theta), zero, np.sin(theta)], axis=1)
    for plane in (None, (0.0, 1.0, 0.0)):
        structure = Structure.from_arrays(
            summed(along),
            [(k, k + 1) for k in range(count)],
            [],
            rod_mass=mass,
            stiffness=1.0,
            supports=[Support.pinned(0.0, plane=plane)] + [Support.free(0.4, plane=plane)] * (count - 1),
        )
        scene = tmj.Scene(structure, gravity=(0, 0, -9.81), initial_velocities=summed(across * rate[:, None]))
        expected = summed(across * theta_acc[:, None] - along * rate[:, None] ** 2)
        for solver in Solver:
            _, found = dae(solver).accelerations(request(scene))(0.0, scene.nodes0, scene.velocities0)
            assert spread(found, expected) <= 1e-12  # matrices of 5 x 5 with condition numbers below 1e3


@pytest.mark.parametrize("seed", range(6))
def test_no_energy_comes_from_joints_and_loops(seed):
    """dT/dt = B(v, a) of the quadratic form T, exactly; it is the power of gravity and of the strings."""
    structure = random_class_k(np.random.default_rng(seed), rods=9, loops=2)
    scene = on_manifold(structure, seed)
    v = scene.velocities0
    _, a = DAE().accelerations(request(scene))(0.0, scene.nodes0, v)
    gained = 0.5 * (rods.kinetic_energy(structure, v + a) - rods.kinetic_energy(structure, v - a))
    weight = rods.lumped_masses(structure)[:, None] * np.array(GRAVITY)
    given = np.sum((natural.string_forces(structure, scene.nodes0, v) + weight) * v)
    # (T(v + a) - T(v - a))/2 has the round-off of T(a), 1e-16 a². Errors of a are as above.
    assert abs(gained - given) <= 1e-10 * max(1.0, rods.kinetic_energy(structure, a), rods.kinetic_energy(structure, v))


def braced_square(plane):
    """Four rods, both diagonals: one rod more than rigid in its plane, two more in space with nothing across it."""
    nodes = [[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]]
    pairs = [(0, 1), (1, 2), (2, 3), (3, 0), (0, 2), (1, 3)]
    supports = [Support.free(plane=plane)] * 6
    mass = [1.0, 2.0, 0.7, 1.3, 0.5, 0.9]
    return Structure.from_arrays(nodes, pairs, [], rod_mass=mass, stiffness=1.0, supports=supports, name="square")


def every_pair(plane):
    """Five nodes in a plane and a rod between any two: three rods too many in the plane, more in space."""
    nodes = [[0, 0, 0], [1, 0, 0.2], [1.3, 0, 1], [0.4, 0, 1.5], [-0.3, 0, 0.8]]
    pairs = [(i, j) for i in range(5) for j in range(i + 1, 5)]
    supports = [Support.free(plane=plane)] * 10
    mass = np.linspace(0.5, 1.5, 10)
    return Structure.from_arrays(nodes, pairs, [], rod_mass=mass, stiffness=1.0, supports=supports)


def pinned_at_both_ends(plane, slack=0.3):
    """Three rods between two pins: where they are straight, one row along them is too many."""
    nodes = [[0, 0, 0], [1, 0, -slack], [2, 0, -slack], [3, 0, 0]]
    supports = [Support.pinned(0.0, plane=plane), Support.free(plane=plane), Support.pinned(1.0, plane=plane)]
    pairs = [(0, 1), (1, 2), (2, 3)]
    return Structure.from_arrays(nodes, pairs, [], rod_mass=[1.0, 2.0, 0.5], stiffness=1.0, supports=supports)


@pytest.mark.parametrize("plane", [None, (0.0, 1.0, 0.0)])
@pytest.mark.parametrize(
    "build", [braced_square, every_pair, pinned_at_both_ends, lambda p: pinned_at_both_ends(p, 0.0)]
)
@pytest.mark.parametrize("solver", SOLVERS)
def test_redundant_joints_leave_the_accelerations_right(build, plane, solver):
    structure = build(plane)
    scene = on_manifold(structure, 3)
    if np.ptp(structure.positions[:, 2]) == 0:  # straight between pins, it can only be at rest
        scene = scene.with_(initial_velocities=None)
    if len(structure.rods) >= 6:  # flat and rigid, it turns and slides in its plane
        turning = np.array([0.3, 0.0, -0.4]) + np.cross([0.0, 1.7, 0.0], structure.positions)
        scene = scene.with_(initial_velocities=turning)
    _, found = dae(solver).accelerations(request(scene))(0.0, scene.nodes0, scene.velocities0)
    expected, _ = natural.accelerations(
        structure, scene.nodes0, scene.velocities0, np.zeros_like(scene.nodes0), GRAVITY
    )
    # The kept part of the system has a condition number below 1e3.
    assert np.abs(found - expected).max() <= 1e-11 * max(1.0, np.abs(expected).max())


def star(lightest):
    """Three rods of 1 to 3 kg at the end of a pinned rod of a mass [kg]."""
    nodes = [[0, 0, 0], [1, 0.1, 0], [1.5, 1, 0.2], [0.3, 0.4, -1], [2, -0.5, 0.7]]
    mass = [lightest, 1.0, 2.0, 3.0]
    supports = [Support.pinned(0.0), *3 * [Support.free()]]
    return Structure.from_arrays(
        nodes, [(0, 1), (1, 2), (1, 3), (1, 4)], [], rod_mass=mass, stiffness=1.0, supports=supports
    )


@pytest.mark.parametrize("lightest", [1e-3, 1e-6, 4e-10])
def test_a_light_rod_that_carries_heavy_ones_costs_forces_of_joints_as_many_digits_as_masses_are_apart(lightest):
    scene = tmj.Scene(star(lightest), gravity=GRAVITY)
    expected, _ = rates_of(scene, DENSE)
    found, _ = rates_of(scene, Solver.JOINTS)
    # What is left of pivots of 1/lightest is 1/3: round-off of 1e-16 / lightest, in three rods and two eliminations.
    assert spread(found, expected) <= 1e-12 + 1e-15 / lightest


def test_masses_too_far_apart_for_forces_of_joints_are_refused_in_words():
    """At 1e12 the light rod's joints would be taken for redundant, and all be wrong by a third."""
    scene = tmj.Scene(star(1e-12), gravity=GRAVITY)
    with pytest.raises(tmj.errors.OptionError, match=r"'r1' of 1e-12 kg and 'r4' of 3 kg.*1e\+10 times.*Solver.FULL"):
        tmj.simulate(scene, None, DAE(), duration=0.1)
    dense, full = (rates_of(scene, solver)[0] for solver in (DENSE, Solver.FULL))
    assert spread(full, dense) <= 1e-6  # 1e-10 as measured; the pinned rod itself hangs on digits of 1e-12


def test_a_braced_square_has_joints_that_others_satisfy_already():
    run = DAE().prepared(request(tmj.Scene(braced_square((0.0, 1.0, 0.0)), gravity=GRAVITY)))
    run.rates_at(0.0, run.y, None)
    # Eight joints are 24 rows. Six rods of constant length have 18 freedoms in their plane, the square has 3, so that
    # 15 rows are needed: of the others, 8 are across the plane and one is the rod too many.
    assert np.sum(run.plant.arrays["joints"]["pivots"] == 0) == 24 - 15


@pytest.mark.parametrize("seed", range(6))
def test_projection_closes_loops_and_lengths_to_round_off_with_the_least_change(seed):
    structure = random_class_k(np.random.default_rng(seed), rods=8, loops=2)
    records = LinkedRecords.of(structure)
    plan = plan_joints(records)
    rng = np.random.default_rng(seed)
    scene = on_manifold(structure, seed)
    q, rates = records.coordinates(scene.nodes0), records.coordinates(scene.velocities0)
    q = q + 1e-3 * rng.normal(size=q.shape)
    rates = rates + 1e-2 * rng.normal(size=q.shape)
    nodes, velocities = np.array(scene.nodes0), np.array(scene.velocities0)
    arguments = (records.table.address, plan.address)
    project_linked(*arguments, q, rates, nodes, velocities)
    # Sums of up to eight vectors of 1 m and 10 m/s.
    assert np.abs(records.table["gaps"][:, 0]).max() <= 1e-14
    assert np.abs(records.table["gaps"][:, 1]).max() <= 1e-12
    lengths = np.linalg.norm(np.diff(nodes[structure.rod_nodes], axis=1)[:, 0], axis=1)
    assert np.abs(lengths - structure.rod_lengths).max() <= 1e-14
    rows, _ = natural.constraints(structure, nodes, velocities)
    assert np.abs(rows @ velocities.ravel()).max() <= 1e-12
    again, again_rates = q.copy(), rates.copy()
    project_linked(*arguments, again, again_rates, nodes, velocities)
    assert np.abs(again - q).max() <= 1e-14
    assert np.abs(again_rates - rates).max() <= 1e-12


def test_scaling_is_measured_for_the_numbers_of_rods_requested_and_fits_a_power():
    points = cable_scaling((4, 9))
    assert [(point.elements, point.solver) for point in points] == [(4, Solver.JOINTS), (9, Solver.JOINTS)]
    assert all(point.seconds > 0 for point in points)
    cubes = [Evaluation(k, DENSE, 1e-9 * k**3) for k in (10, 20, 50)]
    assert exponent(cubes) == pytest.approx(3.0, abs=1e-12)
    with pytest.raises(tmj.errors.OptionError, match="two numbers of elements"):
        exponent(points[:1])
