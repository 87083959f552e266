"""Rigid bodies: Euler's and Lagrange's tops, a plate on strings, the limit of a thin rod, and both engines."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from body_scenes import CENTER, CORNERS, slung, stone, thrown, turned
from scipy.special import ellipj

import tensegrity_mj as tmj
from tensegrity_mj.cli import main
from tensegrity_mj.model import Body
from tensegrity_mj.model.capabilities import DRY_BODIES

TIMES = 0.1 * np.arange(21)
SPIN = (1.0, 5.0, -2.0)


def flight(run, body):
    """Where a thrown body's nodes are without gravity, by quaternions."""
    rotations = turned(body.inertia_matrix, SPIN, run.time)
    offsets = run.scene.structure.positions - CENTER
    moved = np.array(CENTER) + np.array([0.1, 0.2, 0.3]) * run.time[:, None]
    return moved[:, None] + np.einsum("tij,nj->tni", rotations, offsets)


@pytest.mark.parametrize("engine", ["dae", "mujoco"])
def test_eulers_top_is_that_of_its_quaternion_at_the_fourth_order(engine):
    body = stone()
    scene = thrown(body, SPIN)
    errors = []
    for step in (4e-3, 2e-3):
        chosen = {"dae": tmj.DAE(method="rk4", timestep=step), "mujoco": tmj.MuJoCo(step)}[engine]
        run = tmj.simulate(scene, None, chosen, duration=2.0, output_interval=0.1)
        errors.append(np.abs(run.nodes - flight(run, body)).max())
        # A spin of 5 rad/s: (5 h)^5/120 a step of 1 m, in 500 steps, and some times that.
        assert errors[-1] <= 20 * (5 * step) ** 5 / 120 * 2.0 / step
    assert errors[1] <= errors[0] / 2**3.5


def test_eulers_top_is_jacobis_elliptic_functions():
    """ω about the principal axes of moments 1, 2 and 3, from rest about the first: cn, sn and dn in closed form.

    I1 < I2 < I3 and 2 E I2 < L²: ω1 = a cn, ω2 = b sn, ω3 = c dn of τ = n t with a sign, Landau and Lifshitz § 37.
    """
    I1, I2, I3 = 0.1, 0.2, 0.25
    start = np.array([0.4, 0.0, 3.0])
    E2, L2 = I1 * start[0] ** 2 + I3 * start[2] ** 2, (I1 * start[0]) ** 2 + (I3 * start[2]) ** 2
    assert L2 > E2 * I2
    n = np.sqrt((I3 - I2) * (L2 - E2 * I1) / (I1 * I2 * I3))
    m = (I2 - I1) * (E2 * I3 - L2) / ((I3 - I2) * (L2 - E2 * I1))
    nodes = {"o": (0, 0, 0), "x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1)}
    body = Body("top", tuple(nodes), 1.0, (I1, I2, I3), (0, 0, 0))
    scene = thrown(body, start, (0, 0, 0), nodes=nodes)
    run = tmj.simulate(scene, None, tmj.DAE(rtol=1e-12, atol=1e-13), duration=2.0, output_interval=0.1)
    sn, cn, dn, _ = ellipj(n * run.time, m)
    spins = np.array(
        [
            np.sqrt((E2 * I3 - L2) / (I1 * (I3 - I1))) * cn,
            np.sqrt((E2 * I3 - L2) / (I2 * (I3 - I2))) * sn,
            np.sqrt((L2 - E2 * I1) / (I3 * (I3 - I1))) * dn,
        ]
    ).T
    axes = np.swapaxes(run.nodes[:, 1:], 1, 2)  # columns: the body's axes
    rates = np.swapaxes(run.velocities[:, 1:], 1, 2)
    turning = np.swapaxes(axes, 1, 2) @ rates
    found = np.stack([turning[:, 2, 1], turning[:, 0, 2], turning[:, 1, 0]], axis=1)
    # A hundred times the tolerance.
    assert np.abs(found - spins).max() <= 1e-10


@pytest.mark.parametrize("engine", [tmj.DAE(method="rk4", timestep=1e-3), tmj.MuJoCo(1e-3)])
def test_momentum_and_energy_of_a_free_body_stay(engine):
    body = stone()
    run = tmj.simulate(thrown(body, SPIN), None, engine, duration=2.0, output_interval=0.1)
    frame = run.scene.structure.frames[0]
    moments = []
    for nodes, velocities in zip(run.nodes, run.velocities, strict=True):
        (_, rotation), (_, spin) = frame.placed(nodes), frame.moving(nodes, velocities)
        moments.append(rotation @ body.inertia_matrix @ rotation.T @ spin)
    # As above: (5 h)^5/120 a step.
    assert np.abs(np.array(moments) - body.inertia_matrix @ SPIN).max() <= 1e-10
    assert np.ptp(run.kinetic_energy) <= 1e-10
    expected = 0.5 * 2.0 * 0.14 + 0.5 * np.array(SPIN) @ body.inertia_matrix @ SPIN
    assert run.kinetic_energy[0] == pytest.approx(expected, rel=1e-13)


def test_a_symmetric_top_that_falls_precesses_steadily():
    """Its axis turns about the angular momentum with |L| / I, in closed form, and its centre of mass falls freely."""
    thick, slim = 0.02, 0.05
    nodes = {"o": (0, 0, 0), "x": (0.2, 0, 0), "y": (0, 0.2, 0), "z": (0, 0, 0.4)}
    body = Body("top", tuple(nodes), 1.0, (slim, slim, thick), (0, 0, 0.1))
    spin = np.array([0.5, 0.0, 20.0])
    scene = thrown(body, spin, (0, 0, 0), gravity=(0, 0, -9.81), nodes=nodes)
    run = tmj.simulate(scene, None, tmj.MuJoCo(1e-3), duration=1.0, output_interval=0.05)
    momentum = body.inertia_matrix @ spin
    rate, about = np.linalg.norm(momentum) / slim, momentum / np.linalg.norm(momentum)
    angles = rate * run.time[:, None]
    axis = np.array([0.0, 0.0, 1.0])
    along = (about @ axis) * about
    across = axis - along
    expected = along + np.cos(angles) * across + np.sin(angles) * np.cross(about, axis)
    found = (run.nodes[:, 3] - run.nodes[:, 0]) / 0.4
    # RK4 at a spin of 20 rad/s: (20 h)^5/120 a step, 1000 of them.
    assert np.abs(found - expected).max() <= 1e-7
    fall = 0.1 - 0.5 * 9.81 * run.time**2
    center = 0.75 * run.nodes[:, 0, 2] + 0.25 * run.nodes[:, 3, 2]
    assert np.abs(center - fall).max() <= 1e-10


@pytest.mark.parametrize("engine", [tmj.DAE(rtol=1e-12, atol=1e-13), tmj.MuJoCo(1e-3)])
def test_a_heavy_top_about_a_fixed_point_precesses_steadily(engine):
    """Lagrange's top, its point held by three constraints: I1 Ω² cos θ - I3 ω3 Ω + m g l = 0, I1 about the point."""
    mass, far, thick, slim, tilt, rate = 1.0, 0.1, 0.02, 0.05, 1.0, 2.0  # kg, m, kg m², kg m², rad, rad/s
    about_point = slim + mass * far**2
    along = (about_point * rate**2 * np.cos(tilt) + mass * 9.81 * far) / (thick * rate)  # ω3, 29 rad/s
    c, s = np.cos(tilt), np.sin(tilt)
    turn = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    nodes = {name: tuple(turn @ at) for name, at in zip("oxyz", 0.2 * np.diag([1, 1, 1, 2])[:, 1:], strict=True)}
    xx, yy, zz, xy, xz, yz = (turn @ np.diag([slim, slim, thick]) @ turn.T)[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    body = Body("top", tuple(nodes), mass, (xx, yy, zz, xy, xz, yz), tuple(far * turn[:, 2]))
    held = tuple(
        tmj.model.Constraint(f"o{axis}", {"o": 1.0}, unit) for axis, unit in zip("xyz", np.eye(3), strict=True)
    )
    structure = tmj.Structure("top", nodes, bodies=(body,), constraints=held)
    spin = (along - rate * c) * turn[:, 2] + [0, 0, rate]
    scene = tmj.Scene(structure, gravity=(0, 0, -9.81), initial_velocities=np.cross(spin, structure.positions))
    run = tmj.simulate(scene, None, engine, duration=1.0, output_interval=0.05)
    angles = rate * run.time
    expected = 0.4 * np.stack([s * np.cos(angles), s * np.sin(angles), np.full_like(angles, c)], axis=1)
    off = np.abs(run.nodes[:, 3] - expected).max()
    # RK4 at a spin of 29 rad/s: (29 h)^5/120 of 0.4 m a step, 1000 of them, and some times that; 100 tolerances.
    assert off <= (3e-7 if isinstance(engine, tmj.MuJoCo) else 1e-10)
    assert np.abs(run.nodes[:, 0]).max() <= off


def test_a_plate_on_four_strings_swings_as_its_closed_form_says():
    """Four equal stiff vertical strings of length L carry it as a pendulum: it shifts without turning, ω² = g/L.

    And it turns about the vertical: a string at the distance d gives a torque m g d²/(4 L) an angle, I ω² = m g d²/L.
    """
    length, half, mass, moment = 0.8, 0.3, 2.0, 0.15
    corners = {f"c{k}": (x * half, y * half, 0.0) for k, (x, y) in enumerate(((1, 1), (-1, 1), (-1, -1), (1, -1)))}
    above = {f"f{k}": (x, y, length) for k, (x, y, _) in enumerate(corners.values())}
    nodes = {**corners, **above, "top": (0, 0, 0.1)}
    pull = mass * 9.81 / 4
    strings = tuple(tmj.String(f"s{k}", (f"f{k}", f"c{k}"), 1e7, tension=pull) for k in range(4))
    body = Body("plate", (*corners, "top"), mass, (0.08, 0.08, moment), (0, 0, 0))
    structure = tmj.Structure("plate", nodes, strings=strings, fixed_nodes=tuple(above), bodies=(body,))
    scene = tmj.Scene(structure, gravity=(0, 0, -9.81))
    found = np.sort(np.abs(tmj.linearize(scene, tmj.DAE()).eigenvalues.imag))[::2]
    swinging = [np.sqrt(9.81 / length)] * 2 + [np.sqrt(mass * 9.81 * 2 * half**2 / (length * moment))]
    # Strings stretch by T/k = 5e-7 of a metre, a part of 6e-7 of their length.
    assert found[:3] == pytest.approx(np.sort(swinging), rel=3e-6)


def test_a_slender_body_moves_as_a_rod():
    """Its moment about the axis is 1e-9 of the others; its nodes are a rod's ends and two beside them."""
    mass, length = 1.3, 0.9
    moment = mass * length**2 / 12
    rod = tmj.Structure(
        "rod",
        {"i": (0, 0, 0), "j": (length, 0, 0), "f": (0.2, 0.3, 1.0)},
        (tmj.Rod("r", ("i", "j"), mass),),
        (tmj.String("s", ("f", "j"), 40.0, 0.5, rest_length=0.2),),
        ("f",),
    )
    beside = {"k": (0.3, 0.1, 0.0), "l": (0.3, 0.0, 0.1)}
    body = Body("r", ("i", "j", *beside), mass, (1e-9 * moment, moment, moment), (length / 2, 0, 0))
    solid = replace(rod, nodes={**rod.nodes, **beside}, rods=(), bodies=(body,))
    engine = tmj.DAE(rtol=1e-11, atol=1e-13)
    runs = [
        tmj.simulate(tmj.Scene(one, gravity=(0, 0, -9.81)), None, engine, duration=0.5, output_interval=0.05)
        for one in (rod, solid)
    ]
    # The moment about the axis feels no torque: what is left is the tolerance of the method, times a hundred.
    assert np.abs(runs[0].nodes[:, :3] - runs[1].nodes[:, :3]).max() <= 1e-9
    assert runs[1].kinetic_energy == pytest.approx(runs[0].kinetic_energy, abs=1e-8)


def test_a_held_body_stays_and_carries():
    scene = slung()
    structure = replace(scene.structure, bodies=(stone(held=True),))
    held = tmj.Scene(structure, gravity=scene.gravity)
    fixed = replace(structure, bodies=(), fixed_nodes=(*structure.fixed_nodes, *CORNERS))
    same = tmj.Scene(fixed, gravity=scene.gravity)
    for engine in (tmj.DAE(method="rk4", timestep=1e-3), tmj.MuJoCo(1e-3)):
        run, other = (tmj.simulate(one, None, engine, duration=0.2, output_interval=0.02) for one in (held, same))
        assert np.abs(run.nodes - other.nodes).max() <= 1e-12
        assert run.energy_residual == pytest.approx(other.energy_residual, abs=1e-11)


def test_what_cannot_be_done_is_refused_with_its_reason():
    scene = slung()
    with pytest.raises(
        tmj.errors.StructureError, match=r"ODE: 'stone' is a body.*minimal coordinates.*use MuJoCo or DAE"
    ):
        tmj.simulate(scene, None, tmj.ODE(), duration=0.1)
    with pytest.raises(tmj.errors.SceneError, match=r"MuJoCo: 'stone' is a body.*no shape that could touch"):
        tmj.simulate(scene.with_(contact=tmj.model.Contact(floor=-3.0)), duration=0.1)
    with pytest.raises(tmj.errors.StructureError, match="'stone' is a body"):
        tmj.simulate(scene, tmj.controllers.Lyapunov(scene.structure, scene.nodes0))
    with pytest.raises(tmj.errors.OptionError, match=r"prestressability: 'stone' is a body.*lowest_stiffness"):
        tmj.statics.prestressability(scene)


def test_statics_modes_and_steps_are_those_of_the_engines_linear_models():
    """Three models that share no equation: Newton's method on distances, differences of engines, and 6 x 6 blocks."""
    still = slung(initial_velocities=None)
    still = still.with_(structure=still.structure.with_strings(damping=0.0))
    state = tmj.statics.find_equilibrium(still)
    scene = state.scene()
    models = [tmj.linearize(scene, engine) for engine in (tmj.DAE(), tmj.MuJoCo())]
    # Both engines' differences: 1e-8 of stiffness over mass, as where joints close loops.
    assert np.abs(models[0].A - models[1].A).max() <= 1e-8 * np.abs(models[0].A).max()
    assert np.abs(models[0].residual).max() <= 1e-10
    omega = np.sort(np.abs(models[0].eigenvalues.imag))[::2]
    modes = tmj.statics.natural_modes(state)
    assert 2 * np.pi * modes.frequencies == pytest.approx(omega, rel=1e-7)
    assert modes.effective_masses.sum(axis=0) == pytest.approx([4.3] * 3, rel=1e-9)
    step = tmj.stable_step(scene, tmj.MuJoCo(1e-3))
    # |R(iy)| = 1 of classical Runge-Kutta at y = 2√2.
    assert step.limit == pytest.approx(np.sqrt(8) / omega[-1], rel=1e-4)
    assert step.rod == "stone"
    assert state.reactions.sum(axis=0) == pytest.approx([0, 0, 4.3 * 9.81], abs=1e-9)


def test_a_body_of_many_nodes_has_the_statics_of_its_four():
    scene = slung(initial_velocities=None)
    more = {"e": (0.25, 0.2, 0.3), "k": (-0.1, 0.05, 0.25)}
    structure = scene.structure
    moved = [replace(one, nodes=("f", "e")) if one.name == "s3" else one for one in structure.strings]
    found = []
    for body in (stone(nodes=(*CORNERS, *more)), stone(nodes=("a", "k", "b", "c", "e", "d"))):
        whole = replace(structure, nodes={**structure.nodes, **more}, strings=tuple(moved), bodies=(body,))
        found.append(tmj.statics.find_equilibrium(tmj.Scene(whole, gravity=scene.gravity)))
        frame = whole.frames[0]
        assert frame.out_of_shape(found[-1].nodes) <= 1e-12
    assert found[0].nodes == pytest.approx(found[1].nodes, abs=1e-10)


def test_runs_and_scenes_report_that_bodies_feel_no_fluid(tmp_path, capsys):
    spine = tmj.load_scene("spine")
    windy = spine.with_(resistance=tmj.Resistance(viscous=0.01), water=tmj.Water(string_diameter=0.01))
    words = (
        "body 'vertebra1' and 2 more feel nothing of the scene's water (no buoyancy, no drag) and resistance "
        "(viscous, drag)"
    )
    assert DRY_BODIES.find(windy) == words
    path = tmj.save_scene(windy, tmp_path / "windy.toml")
    for command in (["run", str(path), "--duration", "0.01"], ["scenes", str(path)]):
        assert main(command) == 0
        assert re.search(rf"^left out +{re.escape(words)}$", capsys.readouterr().out, re.MULTILINE)
    one = windy.with_(structure=slung().structure, water=None, initial_velocities=None, duration=0.01)
    report = tmj.simulate(one.with_(initial_nodes=None), engine=tmj.DAE()).reports
    assert report["left_out"] == "body 'stone' feels nothing of the scene's resistance (viscous, drag)"
    for scene in (spine, tmj.load_scene("tower_waves")):
        assert not DRY_BODIES.find(scene)
