"""Contact of rods that share nodes: those that do never touch each other, and all others do, by the documented law."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from contact_law import acceleration
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

import tensegrity_mj as tmj
from tensegrity_mj.engines.mujoco.mjcf import scene_to_mjcf
from tensegrity_mj.engines.mujoco.needs import requirements
from tensegrity_mj.engines.request import request_for
from tensegrity_mj.errors import SceneError
from tensegrity_mj.model import rods
from tensegrity_mj.model.elements.contact import Contact
from tensegrity_mj.model.text.reading import scene_from_toml

Array = NDArray[np.float64]
G = 9.81
BASE, ARM, RADIUS, ARM_MASS, BASE_MASS, SPEED = 0.3, 0.5, 0.02, 0.4, 0.9, 2.4
BETWEEN = Contact(rods=True, friction=0.0, stiffness=4e4, damping=120.0, impedance=(0.95, 0.95, 2e-3, 0.5, 2.0))


def clapping(planar: bool) -> tmj.Scene:
    """A free rod with an arm upright on each end; the arms turn towards each other, without momentum in all."""
    plane = (0.0, 1.0, 0.0) if planar else None
    nodes = {"b": (0, 0, 0), "c": (BASE, 0, 0), "a": (0, 0, ARM), "d": (BASE, 0, ARM)}
    members = (("left", ("b", "a"), ARM_MASS), ("base", ("b", "c"), BASE_MASS), ("right", ("d", "c"), ARM_MASS))
    free = tmj.Support.free(0.5, plane)
    structure = tmj.Structure("clap", nodes, tuple(tmj.Rod(*member, RADIUS, free) for member in members))
    velocities = np.zeros((4, 3))
    velocities[2:, 0] = SPEED * ARM, -SPEED * ARM
    return tmj.Scene(structure, initial_velocities=velocities, contact=BETWEEN)


def turning(angle: Array, rate: Array) -> tuple[Array, Array]:
    """θ̈ of the arms, θ from upright, and the force [N] between their tips, by the law: no MuJoCo.

    Without forces from outside the base rises at m ℓ sin θ θ̇/(M + 2 m), which leaves T = ½ I(θ) θ̇² with
    I = 2 m ℓ²/3 - (m ℓ sin θ)²/(M + 2 m). The tips are L - 2 ℓ sin θ - 2 r apart.
    """
    m, total, sine, cosine = ARM_MASS, BASE_MASS + 2 * ARM_MASS, np.sin(angle), np.cos(angle)
    inertia = 2 * m * ARM**2 / 3 - (m * ARM * sine) ** 2 / total
    free = (m * ARM) ** 2 * sine * cosine / total * rate**2 / inertia  # -½ I' θ̇²/I
    lever = -2 * ARM * cosine  # of the gap by θ
    without = lever * free + 2 * ARM * sine * rate**2
    gap = BASE - 2 * ARM * sine - 2 * RADIUS
    gained = np.array([acceleration(BETWEEN, *one) for one in np.broadcast(gap, lever * rate, without)]) - without
    return free + gained / lever, gained * inertia / lever**2


@pytest.mark.parametrize("planar", [True, False])
def test_links_of_a_chain_that_share_no_node_collide_and_neighbours_do_not(planar: bool) -> None:
    """One contact, of the arms' tips, though both arms overlap the base about their nodes all the time.

    RK4 steps over the touch, where the damper makes the acceleration of the gap jump by 120 /s · 2.3 m/s = 280 m/s²: a
    step of h = 1e-5 s over it errs by up to 2.8e-3 m/s, in half a period of the contact, 16 ms, by 4.5e-5 m, and with
    the release in the 0.09 s after the touch by 5e-4 m of the gap. Forces err by 4e4 /s² · 4.5e-5 m of some 280 m/s².
    """
    run = tmj.simulate(clapping(planar), None, tmj.MuJoCo(1e-5), duration=0.2, output_interval=1e-3)
    how = {"rtol": 1e-11, "atol": 1e-13, "max_step": 1e-4, "t_eval": run.time}
    found = solve_ivp(lambda _, y: [y[1], *turning(y[:1], y[1:])[0]], (0, 0.2), [0.0, SPEED], **how)
    angle, rate = found.y
    spans = np.diff(run.nodes[:, run.scene.structure.rod_nodes], axis=2)[:, :, 0]
    tolerance = 5e-4 / (2 * ARM * 0.96)
    np.testing.assert_allclose(np.arctan2(spans[:, 0, 0], spans[:, 0, 2]), angle, rtol=0, atol=tolerance)
    np.testing.assert_allclose(np.arctan2(spans[:, 2, 0], -spans[:, 2, 2]), angle, rtol=0, atol=tolerance)
    assert rate[-1] < -0.2 * SPEED  # they have bounced off
    near = BASE - 2 * ARM * np.sin(angle) - 2 * RADIUS < 0
    assert run.reports["contact"]["touching"] == near.astype(int).tolist()
    # λ of an arm: its centre moves as the forces on the tip and where it hangs say.
    turn, force = turning(angle, rate)
    sine, cosine, half = np.sin(angle), np.cos(angle), ARM / 2
    rise = ARM_MASS * ARM * (cosine * rate**2 + sine * turn) / (BASE_MASS + 2 * ARM_MASS)
    centre = np.array([half * (cosine * turn - sine * rate**2), rise - half * (sine * turn + cosine * rate**2)])
    tip = np.array([-force, 0 * force])
    along = np.sum([sine, cosine] * (2 * tip - ARM_MASS * centre), axis=0)
    expected = rate**2 + half * along / (ARM_MASS * ARM**2 / 12)
    scale = np.abs(expected).max()
    np.testing.assert_allclose(run.multipliers[:, [0, 2]], np.stack(2 * [expected], axis=1), rtol=0, atol=0.01 * scale)


def test_momentum_stays_and_the_ledger_closes_where_links_collide_in_space() -> None:
    """With friction, so that arms spin about themselves, and turned out of their plane.

    Momentum is that of 20,000 steps' round-off of 1 kg m/s each, and the ledger errs at touch and release as that of
    single rods (`test_contact`): by 1e-4 of what is lost.
    """
    scene = clapping(planar=False)
    velocities = scene.velocities0 + np.cross([0.3, 0.4, 3.0], scene.nodes0) * [[0], [0], [1], [0]]
    scene = scene.with_(initial_velocities=velocities, contact=replace(BETWEEN, friction=0.8, spin="free"))
    run = tmj.simulate(scene, None, tmj.MuJoCo(1e-5), duration=0.2)
    assert max(run.reports["contact"]["touching"]) == 1
    pairs, masses = run.scene.structure.rod_nodes, np.array([ARM_MASS, BASE_MASS, ARM_MASS])
    momentum = np.einsum("r,trk->tk", masses, run.velocities[:, pairs].mean(axis=2))
    np.testing.assert_allclose(momentum, momentum[:1] + np.zeros((len(momentum), 1)), rtol=0, atol=2e4 * 1e-16)
    lost = -run.external_work[-1]
    assert lost > 0.1
    assert run.energy_residual < 1e-4 * lost


def frame(loops: bool) -> tmj.Structure:
    """Three legs that meet at the top, spread by strings; or a tetrahedron of six rods, of which three close loops."""
    corners = [(0.3 * np.cos(a), 0.3 * np.sin(a), 0.05) for a in np.radians([90, 210, 330])]
    nodes = {"t": (0.02, 0.01, 0.45)} | dict(zip("abc", corners, strict=True))
    members = [tmj.Rod(f"leg {name}", ("t", name), 0.3, 0.01 + 0.002 * k) for k, name in enumerate("abc")]
    pairs = list(itertools.combinations("abc", 2))
    strings = [tmj.String("".join(pair), pair, 900.0, 4.0, rest_length=0.5) for pair in pairs]
    if loops:
        members += [tmj.Rod("".join(pair), pair, 0.2, 0.01) for pair in pairs]
        strings = []
    return tmj.Structure("frame", nodes, tuple(members), tuple(strings))


@pytest.mark.parametrize("loops", [False, True])
def test_a_frame_of_joined_rods_rests_on_the_floor_and_every_node_is_in_balance(loops: bool) -> None:
    """Each rod at a foot touches the floor with its own half ball; the forces of rods know of them.

    At 200 /s nothing is left of the landing after 6 s. Joints that close loops stay open by 1.6e-3 h² a₀ (`mjcf`), here
    8e-9 m, which turns forces of up to 15 N on rods of 0.4 m: by 3e-7 N. The ledger errs at each touch of the feet by
    at most a step's power of the damper's jump, 0.01 · 421 /s · 0.9 m/s · 1.5 kg · 0.9 m/s · 5e-4 s = 2.6e-3 J.
    """
    contact = Contact(floor=0.0, rods=True, friction=0.0)
    scene = tmj.Scene(frame(loops), gravity=(0, 0, -G), contact=contact, duration=6.0)
    run = tmj.simulate(scene, None, tmj.MuJoCo(5e-4), output_interval=0.1)
    structure, masses = scene.structure, rods.lumped_masses(scene.structure)
    floor = np.array([run.reports["contact"]["final_forces"].get(name, [0, 0, 0]) for name in structure.node_names])
    np.testing.assert_allclose(floor.sum(axis=0), [0, 0, G * masses.sum()], rtol=0, atol=3e-7)
    total = floor + rods.string_forces(structure, run.nodes[-1], run.tensions[-1]) - masses[:, None] * [0, 0, G]
    for (i, j), density in zip(structure.rod_nodes, run.rod_force_densities[-1], strict=True):
        pull = density * (run.nodes[-1, j] - run.nodes[-1, i])
        total[i] += pull
        total[j] -= pull
    np.testing.assert_allclose(total, 0, rtol=0, atol=3e-7)
    assert run.energy_residual < 2.6e-3
    assert run.external_work[-1] < -0.3


def test_accelerations_of_a_landing_loop_are_those_of_its_run() -> None:
    """Joints are made rigid, and contacts keep the forces of their law. By differences over 2 h of velocities.

    Contacts of a rate of 400 /s: (400 h)²/6 = 2.7e-4 of them, at steps of 1e-4 s; without friction, which turns rods
    about their axes, as no state of nodes tells. The joints of the run are soft: they
    leave 1e-4 of the accelerations that there would be without them, of light rods up to ten times as large.
    """
    scene = tmj.Scene(
        frame(loops=True), gravity=(0, 0, -G), contact=Contact(floor=0.0, rods=True, friction=0.0), duration=0.1
    )
    run = tmj.simulate(scene, None, tmj.MuJoCo(1e-4), output_interval=1e-4)
    touching = np.array(run.reports["contact"]["touching"])
    row = int(np.flatnonzero(touching == touching.max())[20])
    assert np.ptp(touching[row - 3 : row + 4]) == 0
    state = request_for(scene, None, None, None, tmj.OnInfeasible.STOP, None, False)
    _, found = tmj.MuJoCo(1e-4).accelerations(state)(0.0, run.nodes[row], run.velocities[row])
    moved = np.gradient(run.velocities, run.time, axis=0)[row]
    assert np.abs(moved).max() > 20
    np.testing.assert_allclose(found, moved, rtol=0, atol=1e-3 * np.abs(moved).max())


@pytest.mark.parametrize("loops", [False, True])
def test_the_file_has_bare_mujoco_leave_out_rods_that_share_a_node(loops: bool) -> None:
    """Those that hang side by side, and those that a constraint joins, too."""
    scene = tmj.Scene(frame(loops), contact=Contact(rods=True, spin="free"))
    model = mujoco.MjModel.from_xml_string(scene_to_mjcf(scene))
    joined = sum(bool({*one.nodes} & {*other.nodes}) for one, other in itertools.combinations(scene.structure.rods, 2))
    assert model.nexclude == joined == (12 if loops else 3)
    assert requirements(scene).contact_pairs == (15 - 12 if loops else 0)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert data.ncon == 0
    floor = mujoco.MjModel.from_xml_string(scene_to_mjcf(scene.with_(contact=Contact(floor=0.0, spin="free"))))
    assert floor.nexclude == 0


@pytest.mark.parametrize("name", ["net", "dbar", "cable"])
def test_shipped_scenes_of_joined_rods_take_contact(name: str) -> None:
    """Where nothing touches they move as without it: round-off of 50 steps of some 1e3 additions, 1e-16 of 1 m each."""
    scene = tmj.load_scene(name)
    run, free = (
        tmj.simulate(scene.with_(contact=one), None, tmj.MuJoCo(1e-4), duration=5e-3)
        for one in (Contact(rods=True, spin="free"), None)
    )
    assert max(run.reports["contact"]["touching"]) == 0
    np.testing.assert_allclose(run.nodes, free.nodes, rtol=0, atol=5e-12)


def test_rods_that_cross_are_refused_by_name_and_may_be_excluded(tmp_path: Path) -> None:
    """Of the 91 pairs of 14 rods those that share a node are left out, and those that the scene names."""
    scene = tmj.load_scene("truss_arm")
    with pytest.raises(
        SceneError, match=r"'rising1' and 'falling1' overlap by 0.01 m: .* name such pairs in `exclude`"
    ):
        scene.with_(contact=Contact(rods=True))
    with pytest.raises(SceneError, match=r"no rod to exclude 'falling' \(did you mean 'falling1'\?\)"):
        scene.with_(contact=Contact(rods=True, exclude=[("rising1", "falling")]))
    with pytest.raises(SceneError, match="exclude: rod 'rising1' with itself; name two"):
        scene.with_(contact=Contact(rods=True, exclude=[("rising1", "rising1")]))
    with pytest.raises(SceneError, match="exclude needs rods = True"):
        scene.with_(contact=Contact(floor=-9.0, exclude=[("rising1", "falling1")]))
    excluding = scene.with_(contact=Contact(rods=True, exclude=[("falling1", "rising1")]))
    tmj.save_scene(excluding, tmp_path / "arm.toml")
    assert tmj.load_scene(tmp_path / "arm.toml").contact == excluding.contact
    rods = scene.structure.rods
    joined = sum(bool({*one.nodes} & {*other.nodes}) for one, other in itertools.combinations(rods, 2))
    assert mujoco.MjModel.from_xml_string(scene_to_mjcf(excluding)).nexclude == joined + 1
    run = tmj.simulate(excluding, None, tmj.MuJoCo(1e-4), duration=2e-3)
    assert max(run.reports["contact"]["touching"]) == 0


def test_all_rods_that_cross_are_named() -> None:
    """Three rods across one: each lies within it, and they are apart from each other."""
    nodes, rods = {"a": (0.0, 0.0, 0.0), "b": (3.0, 0.0, 0.0)}, [tmj.Rod("beam", ("a", "b"), 1.0, radius=0.01)]
    for k in (1, 2, 3):
        nodes |= {f"c{k}": (0.7 * k, -1.0, 0.01), f"d{k}": (0.7 * k, 1.0, 0.01)}
        rods.append(tmj.Rod(f"cross{k}", (f"c{k}", f"d{k}"), 1.0, radius=0.01))
    pairs = "; ".join(f"rods 'beam' and 'cross{k}' overlap by 0.01 m" for k in (1, 2, 3))
    with pytest.raises(SceneError, match=f"at the start {pairs}: move them apart"):
        tmj.Scene(tmj.Structure("crossed", nodes, rods), contact=Contact(rods=True))


def test_two_joined_rods_of_a_file_land_alone_and_among_many() -> None:
    text = """
        format = 1
        name = "joined"
        structure.nodes = { a = [0, 0, 0.2], b = [0.5, 0, 0.2], c = [0.9, 0, 0.4] }
        structure.rods = [
            { name = "r1", nodes = ["a", "b"], mass = 1.0 }, { name = "r2", nodes = ["b", "c"], mass = 1.0 }
        ]
        scene.gravity = [0, 0, -9.81]
        scene.contact = { floor = 0.0, rods = true, spin = "free" }
    """
    scene = scene_from_toml(text)
    engine = tmj.MuJoCo(5e-4)
    alone = tmj.simulate(scene, None, engine, duration=0.4)
    assert max(alone.reports["contact"]["touching"]) >= 3  # two at the node that they share
    for run in tmj.simulate_many([scene, scene], None, engine, duration=0.4):
        for name in ("nodes", "velocities", "multipliers", "external_work"):
            np.testing.assert_array_equal(getattr(run, name), getattr(alone, name))
