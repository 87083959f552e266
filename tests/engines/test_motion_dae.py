"""Supports that move: the compiled motions, DAE and ODE with them, and the work that moving them takes."""

from __future__ import annotations

import itertools

import natural_coordinates as natural
import numpy as np
import pytest
from dense_equations import SOLVERS, dae
from natural_coordinates import chain, request
from scipy.integrate import solve_ivp

import tensegrity_mj as tmj
from tensegrity_mj.dynamics.native.motion import PackedMotions, motion_at
from tensegrity_mj.dynamics.native.pointers import address_of
from tensegrity_mj.engines.reference.dae import DAE, Drift
from tensegrity_mj.engines.reference.method import Method
from tensegrity_mj.engines.reference.ode import ODE
from tensegrity_mj.model import rods
from tensegrity_mj.model.members import Support
from tensegrity_mj.model.motion import Harmonic, Motion
from tensegrity_mj.model.structure import Structure

GRAVITY = 9.81
FINE = DAE(rtol=1e-12, atol=1e-13)


def wave(time):
    """A function of time with its derivatives (3, 3): 0.04 (cos 3t - 1, 0, t²) and what follows from it."""
    return 0.04 * np.array(
        [
            [np.cos(3 * time) - 1, 0.0, time**2],
            [-3 * np.sin(3 * time), 0.0, 2 * time],
            [-9 * np.cos(3 * time), 0.0, 2.0],
        ]
    )


MOTIONS = {
    "in-line": Motion.in_line("r1", 0.05, 1.3, (1.0, 0.0, 1.0)),
    "circular": Motion.circular("r1", 0.07, 0.8, (0.0, 1.0, 0.0)),
    "data": Motion.data("r1", (0.0, 0.4, 0.7, 1.5), ((0, 0, 0), (0.1, 0, 0.02), (0.05, 0, -0.1), (0.2, 0, 0.1))),
    "function": Motion.by_function("r1", wave),
}


def test_compiled_motions_are_those_of_python_at_before_between_and_after_their_times():
    several = Motion(
        "r5",
        (Harmonic((0.1, 0.2, -0.3), 2.0, 0.4), Harmonic((0.0, 0.5, 0.1), 7.0)),
        (0.5, 1.0, 2.5),
        ((0, 0, 0), (1, 2, 3), (2, 0, 1)),
    )
    motions = [*MOTIONS.values(), several]
    packed = PackedMotions(motions)
    for time in (-0.3, 0.0, 0.2, 0.4, 0.55, 1.0, 1.5, 2.0, 2.5, 4.0):
        found = np.zeros((len(motions), 3, 3))
        assert not any(motion_at(packed.address, k, time, address_of(found[k])) for k in range(len(motions)))
        # Sums of six terms of quintics whose accelerations are of the order of 100 m/s².
        for number, motion in enumerate(motions):
            assert np.abs(found[number] - motion.at(time)).max() <= 1e-13 * max(1.0, np.abs(found[number]).max())


def test_a_motion_s_function_that_fails_stops_the_run_with_its_name():
    def late(time):
        if time > 0.3:
            raise ValueError("no data")
        return np.zeros((3, 3))

    structure = chain(np.random.default_rng(0), 2)
    scene = tmj.Scene(structure, motions=(Motion.by_function("r1", late),), duration=0.2)
    for engine in (DAE(), DAE(method=Method.RK4, timestep=0.01)):
        with pytest.raises(tmj.errors.SceneError, match=r"motion of 'r1'.*no data"):
            tmj.simulate(scene, None, engine, duration=1.0)


def pendulum(motion, plane=None):
    """A thin rod of 0.8 m that hangs at σ = 0.2 of it, a little aside."""
    theta = 0.4
    along = np.array([np.sin(theta), 0.0, -np.cos(theta)])
    nodes = np.array([[0.0, 0.0, 0.0]]) + np.array([[-0.2], [0.8]]) * 0.8 * along
    structure = Structure.from_arrays(
        nodes, [(0, 1)], [], rod_mass=1.7, stiffness=1.0, supports=[Support.pinned(0.2, plane=plane)]
    )
    return tmj.Scene(structure, gravity=(0, 0, -GRAVITY), motions=(motion,), duration=1.5), theta


@pytest.mark.parametrize("name", MOTIONS)
@pytest.mark.parametrize("plane", [None, (0.0, 1.0, 0.0)])
def test_a_pendulum_with_a_moving_pivot_obeys_its_closed_equation(name, plane):
    """J θ̈ = -m c ((g + d̈_z) sin θ + d̈_x cos θ), J about the pivot, c from there to the centre of mass."""
    motion = MOTIONS[name]
    scene, theta = pendulum(motion, plane)
    length, sigma, mass = 0.8, 0.2, 1.7
    centre, J = (0.5 - sigma) * length, mass * length**2 * (1 - 3 * sigma + 3 * sigma**2) / 3

    def fall(time, y):
        acceleration = motion.at(time)[2]
        drive = (GRAVITY + acceleration[2]) * np.sin(y[0]) + acceleration[0] * np.cos(y[0])
        return [y[1], -mass * centre * drive / J]

    stops = [0.0, *(t for t in motion.times if 0 < t < 1.5), 1.5]
    y, expected, times = [theta, 0.0], [], []
    for start, end in itertools.pairwise(stops):
        grid = np.arange(np.ceil(start / 0.01 - 1e-9), np.floor(end / 0.01 + 1e-9) + 1) * 0.01
        grid = np.clip(grid, start, end)
        part = solve_ivp(fall, (start, end), y, method="DOP853", t_eval=grid, rtol=1e-13, atol=1e-14)
        y = part.y[:, -1]
        expected += part.y[0].tolist()
        times += grid.tolist()
    times, first = np.unique(np.round(times, 9), return_index=True)
    theta = np.array(expected)[first]
    along = np.stack([np.sin(theta), 0 * theta, -np.cos(theta)], axis=1)
    d = np.array([motion.at(float(t))[0] for t in times])
    # DOP853 at rtol = 1e-12 errs by some 1e-12 of 1 m a second where nothing amplifies it, as here.
    for engine in (FINE, DAE(rtol=1e-12, atol=1e-13, drift=Drift.NORMALIZE), ODE(rtol=1e-12, atol=1e-13)):
        if isinstance(engine, ODE) and plane is None:
            continue  # the rod swings through the z axis, where its angles end
        run = tmj.simulate(scene, None, engine)
        assert np.abs(run.time - times).max() <= 1e-12
        assert np.abs(run.nodes[:, 1] - (d + 0.8 * length * along)).max() <= 1e-10
        assert np.abs(run.nodes[:, 0] - (d - sigma * length * along)).max() <= 1e-10


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("seed", range(4))
def test_accelerations_with_moved_rods_and_nodes_are_those_of_node_coordinates(seed, solver):
    """Two chains, hung on moved supports of each kind, and joined by a rod, which closes a loop."""
    rng = np.random.default_rng(seed)
    nodes = rng.uniform(-1, 1, size=(7, 3))
    pairs = [(0, 1), (2, 1), (2, 3), (3, 4)]
    line = Support.constrained([[1.0, 2.0, 2.0], [0.0, 1.0, -1.0]], 1.0)
    supports = [Support.pinned(0.3), Support.free(0.7), Support.free(), line]
    structure = Structure.from_arrays(
        nodes,
        pairs,
        [(5, 1), (6, 3), (5, 6)],
        rod_mass=rng.uniform(0.3, 2, 4),
        stiffness=40.0,
        force_density=3.0,
        supports=supports,
        fixed_nodes=(5, 6),
    )
    motions = (
        Motion.circular("r1", 0.05, 0.9, (1.0, 1.0, 0.0)),
        Motion("r4", (Harmonic((0.1, 0.2, 0.2), 3.0, 0.0), Harmonic((0.0, 0.1, -0.1), 2.0, 0.0))),
        Motion.in_line("n6", 0.2, 0.5, (1.0, 1.0, 1.0)),
    )
    moved = {motion.support: motion.at(0.0) for motion in motions}
    velocities = natural.consistent_velocities(structure, nodes, rng.normal(size=nodes.shape), moved)
    scene = tmj.Scene(structure, gravity=(0, 0, -GRAVITY), motions=motions, initial_velocities=velocities)
    engine = dae(solver)
    placed, found = engine.accelerations(request(scene))(0.0, scene.nodes0, scene.velocities0)
    forces = natural.string_forces(structure, nodes, velocities)
    expected, _ = natural.accelerations(structure, nodes, velocities, forces, (0, 0, -GRAVITY), moved)
    # Condition numbers of the constraints' Gram matrices are below 1e4.
    assert np.abs(placed - nodes).max() <= 1e-14
    assert np.abs(found - expected).max() <= 1e-11 * np.abs(expected).max()
    # The power of all supports is what gravity and strings do not give the kinetic and the elastic energy.
    run = engine.prepared(request(scene))
    power = run.rates_at(0.0, run.y, None)[-1]
    ahead, behind = (rods.kinetic_energy(structure, velocities + sign * found) for sign in (1, -1))
    gained = 0.5 * (ahead - behind)
    weight = rods.lumped_masses(structure)[:, None] * np.array([0, 0, -GRAVITY])
    given = np.sum((forces + weight) * velocities)
    assert abs(gained - given - power) <= 1e-11 * max(1.0, abs(power), rods.kinetic_energy(structure, found))


def moved_strings():
    """A rod held by a moved pivot in its plane, strings with dampers to a moved node, a free rod: class 1."""
    nodes = [[0, 0, 0], [0.3, 0, -0.8], [1.4, 0, -0.2], [1.5, 0, 0.7], [0.2, 0, 1.5]]
    plane = (0.0, 1.0, 0.0)
    structure = Structure.from_arrays(
        nodes,
        [(0, 1), (2, 3)],
        [(1, 2), (4, 1), (4, 3)],
        rod_mass=[1.0, 2.0],
        stiffness=35.0,
        damping=0.2,
        force_density=[15.0, 25.0, 30.0],
        supports=[Support.pinned(0.3, plane=plane), Support.free(0.2, plane=plane)],
        fixed_nodes=(4,),
    )
    motions = (Motion.circular("r1", 0.05, 2.0, plane), Motion.in_line("n5", 0.1, 2.5, (1.0, 0.0, 1.0)))
    load = tmj.model.Load("n3", (0.0, 0.0, 3.0), 4.0)
    return tmj.Scene(structure, gravity=(0, 0, -GRAVITY), motions=motions, loads=(load,), duration=0.25)


def test_ode_and_dae_agree_with_moved_supports_and_their_ledgers_close():
    scene = moved_strings()
    first = tmj.simulate(scene, None, FINE)
    second = tmj.simulate(scene, None, ODE(rtol=1e-12, atol=1e-13))
    # Truncation at rtol = 1e-12 over 0.25 s; strings never go slack here, or steps would end at kinks.
    assert np.all(first.tensions > 0)
    assert np.abs(first.nodes - second.nodes).max() <= 1e-10
    assert np.abs(first.velocities - second.velocities).max() <= 1e-9
    assert np.abs(first.multipliers - second.multipliers).max() <= 1e-8
    # Energies are about 10 J; the works are integrated with the same tolerance.
    assert abs(first.external_work[-1]) > 0.1
    for run in (first, second):
        assert run.energy_residual <= 1e-9
        assert np.abs(run.external_work - first.external_work).max() <= 1e-9


@pytest.mark.parametrize("solver", SOLVERS)
def test_the_ledger_of_a_driven_cable_closes_with_each_solver_and_step(solver):
    structure = chain(np.random.default_rng(2), 5)
    scene = tmj.Scene(structure, gravity=(0, 0, -GRAVITY), motions=(Motion.circular("r1", 0.1, 1.0),), duration=0.5)
    run = tmj.simulate(scene, None, dae(solver, rtol=1e-12, atol=1e-13))
    assert run.external_work.max() > 0.1
    assert run.energy_residual <= 1e-9
    # Fourth order: half the step leaves a sixteenth, of all that is not round-off.
    coarse, fine = (
        tmj.simulate(scene, None, dae(solver, method=Method.RK4, timestep=h)).energy_residual for h in (2e-3, 1e-3)
    )
    assert fine <= coarse / 10


def test_the_frame_of_a_support_that_moves_uniformly_is_inertial():
    """A start that moves with the support, in a frame that does: the motion is that at rest, carried along."""
    structure = chain(np.random.default_rng(1), 4)
    velocity = np.array([0.3, -0.2, 0.1])
    motion = Motion.by_function("r1", lambda t: np.array([velocity * t, velocity, 0 * velocity]))
    scene = tmj.Scene(structure, gravity=(0, 0, -GRAVITY), duration=0.6)
    still = tmj.simulate(scene, None, FINE)
    moved = tmj.simulate(scene.with_(motions=(motion,)), None, FINE)
    carried = still.nodes + still.time[:, None, None] * velocity
    assert np.abs(moved.nodes - carried).max() <= 1e-9  # truncation, of a chain that falls in sharp bends


def test_steps_end_where_data_begin_and_end():
    """Error control alone, over a jerk at an unlucky time, would leave a few 1e-9; here it is truncation."""
    times = (0.0, 0.317, 0.6, 1.1)
    motion = Motion.data("r1", times, ((0, 0, 0), (0.2, 0, 0), (0.1, 0, 0), (0, 0, 0)))
    scene, _ = pendulum(motion)
    from tensegrity_mj.engines.driving import output_times
    from tensegrity_mj.engines.reference.adaptive import marks_of

    marks = [mark for mark, _, _ in marks_of(request(scene), output_times(request(scene)), with_outputs=False)]
    assert marks == [0.317, 0.6, 1.0]


@pytest.mark.parametrize("engine", [DAE, ODE])
@pytest.mark.parametrize("method", [{}, {"method": Method.RK4, "timestep": 1e-3}])
def test_a_sampled_law_sees_the_supports_where_they_are_at_its_time(engine, method):
    scene = moved_strings()
    rest = scene.structure.rest_lengths
    seen = []

    def law(time, nodes, velocities):
        seen.append((time, nodes.copy(), velocities.copy()))
        return scene.structure.stiffness * (1 - rest / scene.structure.string_lengths(nodes))

    tmj.simulate(scene, law, engine(**method), actuation=tmj.Actuation.hold_rest_length(0.01))
    pivot, node = scene.motions
    held, start = np.array([0.7, 0.3]), scene.structure.positions
    assert len({time for time, _, _ in seen}) >= 25
    for time, nodes, velocities in seen:
        # The state carries the time as a sum of up to 250 steps: some 1e-15 s at 2 m/s.
        for (d, d_rate, _), place, rate in (
            (pivot.at(time), held @ (nodes - start)[:2], held @ velocities[:2]),
            (node.at(time), (nodes - start)[4], velocities[4]),
        ):
            assert np.abs(place - d).max() <= 1e-13
            assert np.abs(rate - d_rate).max() <= 1e-12
