"""Supports that move as prescribed, in MuJoCo: their places, what hangs on them, and the work they do.

The yardsticks are a chain in angles, chains whose supports stand still and that inertia forces shake, the nodal
equations of `nodal`, and the DAE.
"""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
import scipy.integrate
from linked_scenes import GRAVITY, everything_moves, hanging_chain, thesis_cable
from nodal import solve
from numpy.typing import NDArray

import tensegrity_mj as tmj
from tensegrity_mj.engines.mujoco.mjcf import DRIVE, scene_to_mjcf
from tensegrity_mj.engines.mujoco.mjcf_tree import moved_directions
from tensegrity_mj.engines.request import request_for
from tensegrity_mj.errors import OptionError, SceneError
from tensegrity_mj.model import rods
from tensegrity_mj.model.events import Load
from tensegrity_mj.model.members import Rod, String, Support
from tensegrity_mj.model.motion import Harmonic, Motion
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure

Array = NDArray[np.float64]
EPS = np.finfo(float).eps
SLIDE, BALL = mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_BALL
X, Y, Z = np.eye(3)


def shaken_chain(motion: Motion) -> Scene:
    """Three unequal rods that hang from a moving support; at rest in its frame at the start."""
    return hanging_chain([0.4, 0.3, 0.5], [0.3, 0.1, 0.4], (motion,)).with_(duration=1.0)


def some_data(support: str) -> Motion:
    times = np.linspace(0.0, 1.0, 6)
    return Motion.data(support, times, np.outer(np.sin(2 * times) ** 2, [0.1, 0.05, -0.08]))


def a_function(time: float) -> list[list[float]]:
    """0.05 (1 - cos 5 t) along an oblique line."""
    line = np.array([1.0, -0.5, 0.7])
    angle = 5 * time
    return [(0.05 * part * line).tolist() for part in (1 - np.cos(angle), 5 * np.sin(angle), 25 * np.cos(angle))]


MOTIONS = {
    "in-line": Motion.in_line("r0", 0.05, 1.1, (0.6, 0.0, 0.8)),
    "circular": Motion.circular("r0", 0.05, 0.9, (0, 0, 1)),
    "data": some_data("r0"),
    "function": Motion.by_function("r0", a_function),
}


# Places --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", MOTIONS)
def test_the_model_has_a_drive_for_each_direction_of_a_motion(name: str) -> None:
    scene = shaken_chain(MOTIONS[name])
    model = tmj.MuJoCo().model(scene)
    count = {"in-line": 1, "circular": 2, "data": 1, "function": 3}[name]
    assert list(model.jnt_type) == count * [SLIDE] + 3 * [BALL]
    assert np.all(model.dof_armature[:count] == DRIVE * 0.8)
    assert not model.dof_armature[count:].any()
    assert (model.neq, model.nmocap) == (0, 0)
    assert "are not in this file" in scene_to_mjcf(scene)
    axes = moved_directions(MOTIONS[name], np.eye(3))
    assert np.abs(axes.T @ axes - np.eye(count)).max() < 4 * EPS
    for time in (0.0, 0.3, 0.77):
        values = MOTIONS[name].at(time)
        assert np.abs(values - values @ axes @ axes.T).max() <= 1e-12 * np.abs(values).max()


def test_only_held_directions_have_a_drive() -> None:
    line = Support.constrained([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    nodes = {"a": (0.0, 0.0, 0.0), "b": (0.0, 0.0, -1.0)}
    structure = Structure("slider", nodes, (Rod("r", ("a", "b"), 1.0, support=line),))
    motion = Motion.by_function(
        "r", lambda t: [[0.1 * np.sin(t), 0, 0], [0.1 * np.cos(t), 0, 0], [-0.1 * np.sin(t), 0, 0]]
    )
    scene = Scene(structure, gravity=GRAVITY, motions=(motion,), duration=0.5)
    model = tmj.MuJoCo().model(scene)
    assert list(model.jnt_type) == 3 * [SLIDE] + [BALL]
    assert np.flatnonzero(model.dof_armature).tolist() == [1, 2]
    # Free along y: nothing pushes there. Driven along x: the frame is that of a pendulum whose pivot moves along x.
    start = scene.with_(initial_velocities=scene.velocities0 + 0.3 * Y)
    run = tmj.simulate(start, None, tmj.MuJoCo(1e-3))
    reference = tmj.simulate(start, None, tmj.DAE(rtol=1e-12, atol=1e-13))
    assert np.abs(run.nodes - reference.nodes).max() < 1e-10
    assert run.nodes[-1, 0, 1] == pytest.approx(0.15, rel=1e-9)
    # λ of a rod that hangs on nothing accounts for the support's acceleration.
    scale = np.abs(reference.multipliers).max()
    assert np.abs(run.multipliers - reference.multipliers).max() < 1e-8 * scale


@pytest.mark.parametrize("integrator", list(tmj.Integrator))
@pytest.mark.parametrize("name", MOTIONS)
def test_supports_are_where_the_motion_says(name: str, integrator: tmj.Integrator) -> None:
    motion, h = MOTIONS[name], 1e-3
    run = tmj.simulate(shaken_chain(motion), None, tmj.MuJoCo(h, integrator))
    wanted = np.array([motion.at(float(t)) for t in run.time])
    # What one step leaves, since each starts from the exact place: RK4's error h⁵/120 of a fifth derivative and the
    # others' h²/2 of the second, which are below 0.1 m (10/s)ⁿ; of the velocity, one h less.
    order = 4 if integrator is tmj.Integrator.RK4 else 1
    step = 0.1 * (10 * h) ** (order + 1) / (120 if order == 4 else 2)
    assert np.abs(run.nodes[:, 0] - wanted[:, 0]).max() < step + 1e-14
    assert np.abs(run.velocities[:, 0] - wanted[:, 1]).max() < 4 * step / h + 1e-13
    assert np.abs(wanted[:, 0]).max() > 0.03


# What hangs on them --------------------------------------------------------------------------------------


def in_angles(scene: Scene, amplitude: float, omega: float, duration: float) -> Array:
    """Node positions (N, 2) across and up of a chain whose top moves as amplitude sin ωt, after a time."""
    lengths, masses = scene.structure.rod_lengths, scene.structure.rod_masses
    n = len(lengths)
    below = masses.sum() - np.cumsum(masses)
    lever = lengths * (below + masses / 2)
    M = np.array([[lengths[min(i, j)] * lever[max(i, j)] for j in range(n)] for i in range(n)])
    M[np.diag_indices(n)] = lengths**2 * (below + masses / 3)

    def rate(t: float, x: Array) -> Array:
        angle, speed = x[:n], x[n:]
        apart = angle[:, None] - angle
        push = -(M * np.sin(apart)) @ speed**2 - 9.81 * lever * np.sin(angle)
        push = push + amplitude * omega**2 * np.sin(omega * t) * lever * np.cos(angle)
        return np.concatenate([speed, np.linalg.solve(M * np.cos(apart), push)])

    found = scipy.integrate.solve_ivp(rate, (0, duration), np.zeros(2 * n), method="DOP853", rtol=1e-12, atol=1e-13)
    angle = np.concatenate([[0.0], found.y[:n, -1]])
    ends = np.concatenate([[0.0], lengths])
    across = amplitude * np.sin(omega * duration) + np.cumsum(ends * np.sin(angle))
    return np.stack([across, -np.cumsum(ends * np.cos(angle))], axis=1)


def test_the_cable_of_chapter_3_moves_as_a_chain_in_angles() -> None:
    scene = thesis_cable((Motion.in_line("r0", 0.05, 0.5, (0, 1, 0)),))
    wanted = in_angles(scene, 0.05, np.pi, 6.0)
    errors = {}
    for h in (2e-3, 1e-3):
        run = tmj.simulate(scene, None, tmj.MuJoCo(h), duration=6.0)
        errors[h] = float(np.abs(run.nodes[-1][:, 1:] - wanted).max())
        assert np.abs(run.nodes[-1][:, 0]).max() < 1e-12
        # Motion and ledger are of order 4 or more; what is exchanged is 0.1 J.
        assert run.energy_residual < 1e-8 * (h / 1e-3) ** 4
    assert errors[1e-3] < 1e-7  # issue 5
    assert 12 < errors[2e-3] / errors[1e-3] < 20
    reference = tmj.simulate(scene, None, tmj.DAE(rtol=1e-11, atol=1e-12), duration=6.0)
    assert np.abs(run.nodes - reference.nodes).max() < 1e-9
    assert np.abs(run.external_work - reference.external_work).max() < 1e-9
    scale = np.abs(reference.rod_force_densities).max()
    assert np.abs(run.rod_force_densities - reference.rod_force_densities).max() < 1e-9 * scale


@pytest.mark.parametrize("name", MOTIONS)
def test_a_moved_support_is_an_accelerated_frame(name: str) -> None:
    motion = MOTIONS[name]
    scene = shaken_chain(motion)
    masses = rods.lumped_masses(scene.structure)

    def inertia(time: float) -> Array:
        """-m d̈ on half a rod at each end: what gravity would do, exact for uniform rods."""
        return -np.outer(masses, motion.at(time)[2])

    frame = scene.with_(motions=(), loads=inertia)
    run, seen = (tmj.simulate(each, None, tmj.MuJoCo(1e-3)) for each in (scene, frame))
    moved = np.array([motion.at(float(t)) for t in run.time])
    # Both are RK4's solutions of the same equations in other coordinates: they differ by its error. It is that of the
    # finer half, of order 4 (data are quintics, whose fifth derivatives jump: a little more).
    halved = tmj.simulate(scene, None, tmj.MuJoCo(5e-4))
    error = 2 * float(np.abs(run.nodes - halved.nodes).max()) + 1e-13
    assert error < 1e-9
    assert np.abs(run.nodes - moved[:, None, 0] - seen.nodes).max() < error
    assert np.abs(run.velocities - moved[:, None, 1] - seen.velocities).max() < 100 * error
    assert (
        np.abs(run.rod_force_densities - seen.rod_force_densities).max() < 1e-6 * np.abs(seen.rod_force_densities).max()
    )


@pytest.mark.parametrize("phase", [0.0, 1.0, 2.0])
def test_accelerations_on_moved_supports_are_those_of_the_nodal_equations(phase: float) -> None:
    """What `linearize` requests from the engine."""
    motion = Motion("r0", (Harmonic((0.05, 0.02, -0.03), 6.0, phase),))
    scene = shaken_chain(motion).with_(loads=(Load("n2", (0.5, 0.3, 0.1)),))
    request = request_for(scene, None, None, None, tmj.OnInfeasible.STOP, None, False)
    places, found = tmj.MuJoCo().accelerations(request)(0.0, scene.nodes0, scene.velocities0)
    wanted = solve(scene, scene.nodes0, scene.velocities0)[0]
    # The drive gives way by 1e-14 of what the rods weigh, d̈ is read to a rounding, and C M⁻¹ Cᵀ is conditioned to 1e4.
    assert np.abs(found - wanted).max() < 1e4 * 100 * EPS * np.abs(wanted).max()
    assert np.abs(places - scene.nodes0).max() < 10 * EPS
    assert np.abs(wanted).max() > 0.1


@pytest.mark.parametrize("integrator", [tmj.Integrator.EULER, tmj.Integrator.IMPLICITFAST, tmj.Integrator.DISCRETE])
def test_other_integrators_are_of_order_1(integrator: tmj.Integrator) -> None:
    scene = shaken_chain(MOTIONS["circular"])
    exact = tmj.simulate(scene, None, tmj.MuJoCo(5e-4)).nodes
    errors = [
        np.abs(tmj.simulate(scene, None, tmj.MuJoCo(h, integrator)).nodes - exact).max() for h in (2e-3, 1e-3, 5e-4)
    ]
    assert errors[-1] < 1e-3
    assert 1.8 < errors[0] / errors[1] < 2.2
    assert 1.8 < errors[1] / errors[2] < 2.2


@pytest.mark.parametrize("planar", [False, True])
def test_supports_that_move_each_in_its_own_way(planar: bool) -> None:
    scene = everything_moves(planar)
    reference = tmj.simulate(scene, None, tmj.DAE(rtol=1e-12, atol=1e-13))
    assert np.all(reference.tensions > 0)
    errors, works, residuals = [], [], []
    for h in (1e-3, 5e-4, 2.5e-4):
        run = tmj.simulate(scene, None, tmj.MuJoCo(h))
        errors.append(np.abs(run.nodes - reference.nodes).max())
        works.append(np.abs(run.external_work - reference.external_work).max())
        residuals.append(run.energy_residual)
    # What `connect` leaves open falls with h², and places with it. Velocities err by the first order, by the little
    # that the constraint rings in the integrator's stages (`mjcf.CONNECT_STEPS`), and with them energy and work.
    assert errors[0] / errors[2] > 8
    for values in (works, residuals):
        assert 3 < values[0] / values[2] < 16
    assert errors[2] < 1e-7
    assert works[2] < 1e-4 * np.abs(reference.external_work).max()
    assert np.abs(reference.external_work).max() > 0.05


# The ledger ----------------------------------------------------------------------------------------------


def test_the_work_of_supports_is_that_of_their_reactions() -> None:
    """Against ∫ R ḋ dt with R from the nodal equations' constraint forces, by Simpson's rule over the recorded rows."""
    motion = MOTIONS["circular"]
    chain = shaken_chain(motion)
    structure = chain.structure
    nodes = {**structure.nodes, "p": (0.6, 0.2, 0.3)}
    strings = (
        String("s", ("p", "n2"), 6.0, rest_length=0.1),
        String("t", ("n0", "n3"), 4.0, rest_length=0.2),
    )
    tied = replace(structure, nodes=nodes, strings=strings, fixed_nodes=("p",))
    scene = Scene(
        tied,
        gravity=GRAVITY,
        motions=(motion, Motion.in_line("p", 0.1, 0.8, (0.5, 0.5, 1.0))),
        loads=(Load("n3", (0.3, 0.2, 0.0), 4.0, 0.3), Load("n0", (0.0, 1.0, 0.0))),
        duration=1.0,
    )
    run = tmj.simulate(scene, None, tmj.MuJoCo(1e-3), output_interval=2e-3)
    powers = []
    for t, here, speeds in zip(run.time, run.nodes, run.velocities, strict=True):
        held = solve(scene, here, speeds, time=float(t))[2]
        loads = scene.nodal_forces(float(t))
        powers.append(float(np.sum(held * speeds) + np.sum(loads * speeds)))
    # Simpson's error, (2e-3 s)⁴ / 180 of fourth derivatives (10/s)⁴ of 10 W over 1 s, is 1e-8 J.
    wanted = scipy.integrate.simpson(powers, x=run.time)
    assert abs(run.external_work[-1] - wanted) < 1e-8
    assert abs(run.external_work[-1]) > 0.1
    # Of order 4: what the step twice as long leaves, over 16.
    longer = tmj.simulate(scene, None, tmj.MuJoCo(2e-3), output_interval=2e-3)
    assert run.energy_residual < longer.energy_residual / 8
    assert longer.energy_residual < 1e-7


def test_the_ledger_counts_contact_under_a_moved_support() -> None:
    """A rod on a moved pivot that is pressed onto the floor: the support's work goes into what friction takes."""
    nodes = {"a": (0.0, 0.0, 0.3), "b": (0.52, 0.0, 0.02)}
    rod = Rod("r", ("a", "b"), 1.0, radius=0.015, support=Support.pinned())
    scene = Scene(
        Structure("dragged", nodes, (rod,)),
        gravity=GRAVITY,
        motions=(Motion.in_line("r", 0.1, 0.5, (1, 0, 0)),),
        contact=tmj.model.Contact(floor=0.0, friction=0.5),
        duration=1.0,
    )
    residuals = []
    for h in (4e-4, 2e-4, 1e-4):
        run = tmj.simulate(scene, None, tmj.MuJoCo(h))
        residuals.append(run.energy_residual)
        assert max(run.reports["contact"]["touching"]) >= 1
    # Contacts make it of first order, as without motion.
    assert residuals[2] < residuals[0] / 2
    assert residuals[2] < 1e-2 * run.kinetic_energy.max() + 1e-4


@pytest.mark.parametrize("integrator", [tmj.Integrator.EULER, tmj.Integrator.DISCRETE])
def test_the_ledger_of_other_integrators_falls_with_the_step(integrator: tmj.Integrator) -> None:
    scene = shaken_chain(MOTIONS["in-line"])
    residuals = [tmj.simulate(scene, None, tmj.MuJoCo(h, integrator)).energy_residual for h in (2e-3, 1e-3, 5e-4)]
    assert 1.7 < residuals[0] / residuals[1] < 2.3
    assert 1.7 < residuals[1] / residuals[2] < 2.3


# Elsewhere -----------------------------------------------------------------------------------------------


def test_many_runs_with_their_own_motions() -> None:
    engine = tmj.MuJoCo(1e-3)
    first = shaken_chain(MOTIONS["circular"]).with_(duration=0.3)
    others = [Motion.circular("r0", 0.03, 1.7, (0, 0, 1)), Motion.in_line("r0", 0.02, 1.3, (0.3, 0.4, 0.0))]
    # A motion that starts elsewhere than that of the first scene: the same model, other places.
    others.append(Motion("r0", (Harmonic((0.05, 0.0, 0.0), 7.0, 0.4),)))
    scenes = [first, *(hanging_chain([0.4, 0.3, 0.5], [0.3, 0.1, 0.4], (m,)).with_(duration=0.3) for m in others)]
    many = tmj.simulate_many(scenes, None, engine)
    for number, scene in enumerate(scenes):
        single = tmj.simulate(scene, None, engine)
        # Axes may be other ones, and with them roundings: a thousand steps of a few each.
        assert np.abs(many[number].nodes - single.nodes).max() < 1e-12
        assert np.abs(many[number].external_work - single.external_work).max() < 1e-12
        assert np.abs(many[number].multipliers - single.multipliers).max() < 1e-9 * np.abs(single.multipliers).max()
    upward = shaken_chain(Motion.in_line("r0", 0.02, 1.3, (0, 0, 1))).with_(duration=0.3)
    with pytest.raises(OptionError, match="in which it stands still in the first scene"):
        tmj.simulate_many([first, upward], None, engine)
    with pytest.raises(OptionError, match="other supports move than in the first scene"):
        tmj.simulate_many([first, first.with_(motions=())], None, engine)


def test_a_function_that_fails_ends_the_run_with_its_time() -> None:
    def failing(time: float) -> list[list[float]]:
        if time > 0.2:
            raise ValueError("no more")
        return a_function(time)

    scene = shaken_chain(Motion.by_function("r0", a_function))
    motion = Motion.by_function("r0", failing)
    object.__setattr__(scene, "motions", (motion,))  # one that its scene would have caught
    with pytest.raises(SceneError, match=r"motion of 'r0': the function failed at t = 0\.20\d* s: ValueError: no more"):
        tmj.simulate(scene, None, tmj.MuJoCo(1e-3))


def test_laws_and_strings_see_places_in_the_world() -> None:
    scene = everything_moves(planar=False).with_(duration=0.1)
    seen: list[tuple[float, Array, Array]] = []

    def law(time: float, nodes: Array, velocities: Array) -> Array:
        seen.append((time, nodes.copy(), velocities.copy()))
        return np.array(scene.structure.rest_lengths)

    tmj.simulate(scene, law, tmj.MuJoCo(1e-3))
    motion = scene.motions[2]
    row = scene.structure.node_index["p"]
    home = np.array(scene.structure.nodes["p"])
    assert len(seen) > 400
    for time, nodes, velocities in seen:
        place, speed, _ = motion.at(time)
        # RK4's second stage is at d + ḋ h/2, which is h² d̈ / 8 off; its velocity h² / 8 of the third derivative.
        assert np.abs(nodes[row] - home - place).max() < 1e-6 * 5 / 8
        assert np.abs(velocities[row] - speed).max() < 1e-6 * 40 / 8
