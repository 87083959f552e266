"""Many simulations with contact at once, and a law in MuJoCo's own loops, against single runs."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest
from mujoco import rollout
from mujoco.batch import Batch

import tensegrity_mj as tmj
from tensegrity_mj.controllers import Delayed, Noisy
from tensegrity_mj.engines import driving
from tensegrity_mj.engines.mujoco import many
from tensegrity_mj.engines.mujoco.ensemble import MuJoCoEnsemble
from tensegrity_mj.engines.mujoco.install import installed
from tensegrity_mj.engines.request import request_for
from tensegrity_mj.model.actuation import OnInfeasible

STEP = 5e-4
RK4 = tmj.MuJoCo(STEP)
EVERYTHING = ("nodes", "velocities", "rest_lengths", "tensions", "multipliers", "winch_work", "dissipation")


def same(run: tmj.Trajectory, alone: tmj.Trajectory) -> None:
    """To the last bit: what is recorded, the work of contacts, and their forces."""
    for name in (*EVERYTHING, "external_work"):
        assert np.array_equal(getattr(run, name), getattr(alone, name)), name
    assert run.reports["contact"] == alone.reports["contact"]
    assert run.energy_residual == alone.energy_residual


def thrown(scene: tmj.Scene, seed: int, count: int) -> list[tmj.Scene]:
    """The scene with rigid motions of its structure to begin with, so that it lands on other nodes at other times."""
    draws = np.random.default_rng(seed)
    middle = scene.nodes0.mean(axis=0)
    starts = []
    for _ in range(count):
        velocity, spin = draws.normal(0.0, 1.0, 3), draws.normal(0.0, 3.0, 3)
        moving = scene.velocities0 + velocity + np.cross(spin, scene.nodes0 - middle)
        starts.append(scene.with_(initial_velocities=moving))
    return starts


@pytest.mark.filterwarnings("ignore::tensegrity_mj.errors.StabilityWarning")  # of first order: it is bits that count
@pytest.mark.parametrize(
    ("name", "duration", "integrator"),
    [
        ("prism_drop", 0.4, tmj.Integrator.EULER),
        ("prism_drop", 0.4, tmj.Integrator.DISCRETE),
        ("six_bar_drop", 0.4, tmj.Integrator.RK4),
        ("six_bar_roll", 0.6, tmj.Integrator.RK4),
    ],
)
def test_a_run_with_contact_among_many_is_the_single_run_to_the_last_bit(name, duration, integrator) -> None:
    scene = tmj.load_scene(name)
    law = tmj.controllers.from_scene(scene) if scene.control else None
    engine = tmj.MuJoCo(STEP, integrator)
    alone = tmj.simulate(scene, law, engine, duration=duration)
    assert max(alone.reports["contact"]["touching"]) >= 1
    for threads in (1, 2):
        for run in tmj.simulate_many([scene] * 3, law, engine, duration=duration, threads=threads):
            same(run, alone)


def test_robots_that_land_apart_keep_apart(monkeypatch) -> None:
    """In pieces of any size, between which each one's last forces are another simulation's in MjData."""
    scenes = thrown(tmj.load_scene("six_bar_drop"), 1, 5)
    alone = [tmj.simulate(scene, None, RK4, duration=0.4) for scene in scenes]
    assert len({tuple(run.reports["contact"]["touching"]) for run in alone}) == 5
    for sizes in ([1, 2, 7], [1000]):

        def pieces(count: int, sizes: list[int] = sizes) -> Any:
            first = 0
            while first < count:
                yield first, min(sizes[first % len(sizes)], count - first)
                first += sizes[first % len(sizes)]

        monkeypatch.setattr(driving, "chunks", pieces)
        for run, one in zip(tmj.simulate_many(scenes, None, RK4, duration=0.4, threads=2), alone, strict=True):
            same(run, one)


def test_robots_that_start_turned_land_as_alone() -> None:
    scene = tmj.load_scene("six_bar_drop")
    draws, middle, turned = np.random.default_rng(4), scene.nodes0.mean(axis=0), [scene]
    for _ in range(3):
        rotation, _ = np.linalg.qr(draws.normal(size=(3, 3)))
        rotation *= np.linalg.det(rotation)
        nodes = (scene.nodes0 - middle) @ rotation.T + middle + [*draws.normal(size=2), 0.1]
        turned.append(scene.with_(initial_nodes=nodes))
    for run, one in zip(tmj.simulate_many(turned, None, RK4, duration=0.4, threads=2), turned, strict=True):
        alone = tmj.simulate(one, None, RK4, duration=0.4)
        touching = alone.reports["contact"]["touching"]
        assert run.reports["contact"]["touching"] == touching
        assert max(touching) >= 1
        # Joints count from the first scene's start: round-off of 2e-16 m a step over 1000 steps, which a landing
        # amplifies at most tenfold.
        assert np.abs(run.nodes - alone.nodes).max() < 1000 * 10 * 2.2e-16
        # And of energies of some 10 J, at each of as many steps.
        assert abs(run.external_work - alone.external_work).max() < 1000 * 10 * 2.2e-15


def test_floors_frictions_and_masses_may_differ() -> None:
    scene = tmj.load_scene("six_bar_drop")
    contact, structure = scene.contact, scene.structure
    heavy = [replace(rod, mass=(1.0 + 0.1 * k) * rod.mass) for k, rod in enumerate(structure.rods)]
    scenes = [
        scene,
        scene.with_(contact=replace(contact, friction=0.2)),
        scene.with_(contact=replace(contact, friction=0.0)),
        scene.with_(contact=replace(contact, floor=contact.floor - 0.02, stiffness=1e5)),
        scene.with_(structure=replace(structure, rods=heavy)),
        *thrown(scene, 2, 2),
    ]
    runs = tmj.simulate_many(scenes, None, RK4, duration=0.4, threads=2)
    for run, one in zip(runs, scenes, strict=True):
        same(run, tmj.simulate(one, None, RK4, duration=0.4))
    assert len({run.nodes[-1].tobytes() for run in runs}) == len(scenes)


def test_each_robot_may_have_ground_of_its_own() -> None:
    scene = tmj.load_scene("six_bar_drop")
    ground = replace(scene.contact, floor=scene.contact.floor - 0.15, rolling=1e-3)
    rough = [tmj.model.Rough(size=(2.0, 2.0), roughness=0.02, length=0.3, seed=seed) for seed in range(3)]
    scenes = [scene.with_(contact=replace(ground, terrain=one)) for one in rough]
    for run, one in zip(tmj.simulate_many(scenes, None, RK4, duration=0.4, threads=2), scenes, strict=True):
        alone = tmj.simulate(one, None, RK4, duration=0.4)
        assert max(alone.reports["contact"]["touching"]) >= 1
        same(run, alone)


def test_work_of_contacts_and_of_a_moved_hook_are_counted_side_by_side() -> None:
    drop = tmj.load_scene("six_bar_drop")
    structure = drop.structure
    nodes: dict[str, Any] = dict(zip(structure.node_names, structure.positions, strict=True))
    top = max(nodes, key=lambda name: nodes[name][2])
    line = replace(structure.strings[0], name="line", nodes=("hook", top))
    nodes["hook"] = nodes[top] + [0.0, 0.0, 0.3]
    hooked = replace(structure, nodes=nodes, fixed_nodes=("hook",), strings=(*structure.strings, line))
    times = np.array([0.0, 0.5])
    lowered = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, -0.1]])
    motion = tmj.model.Motion.data("hook", times, lowered, 0 * lowered, 0 * lowered)
    floor = replace(drop.contact, floor=float(structure.positions[:, 2].min()) - 0.035)
    scene = tmj.Scene(hooked, gravity=drop.gravity, contact=floor, motions=(motion,))
    alone = tmj.simulate(scene, None, RK4, duration=0.4)
    assert max(alone.reports["contact"]["touching"]) >= 1
    for run in tmj.simulate_many([scene] * 3, None, RK4, duration=0.4, threads=2):
        same(run, alone)


def test_scenes_that_touch_in_other_ways_are_refused() -> None:
    scene = tmj.load_scene("six_bar_drop")
    rods = scene.with_(contact=tmj.model.Contact(rods=True))
    for pair in ([scene, rods], [scene, scene.with_(contact=None)], [rods, rods.with_(contact=None)]):
        with pytest.raises(tmj.errors.OptionError, match=r"scenes.*built otherwise than the first's.*use run_many"):
            tmj.simulate_many(pair, None, RK4, duration=0.1)


def test_held_commands_delays_and_noise_with_contact() -> None:
    scene = tmj.load_scene("six_bar_roll")
    law = tmj.controllers.from_scene(scene)
    hold = tmj.Actuation.hold_rest_length(0.01)
    for one in (law, Delayed(law, 2, 0.01), Noisy(law, 1e-3, 1e-3, 3, 0.01)):
        alone = tmj.simulate(scene, one, RK4, duration=0.6, actuation=hold)
        for run in tmj.simulate_many([scene] * 3, one, RK4, duration=0.6, actuation=hold, threads=2):
            same(run, alone)


def test_a_run_that_enters_again_remembers_nothing() -> None:
    scene = tmj.load_scene("prism_drop")
    rough = scene.with_(contact=replace(scene.contact, friction=0.1))
    requests = [request_for(one, None, 0.4, None, OnInfeasible.STOP, None, False) for one in (scene, rough)]
    ensemble = MuJoCoEnsemble(RK4, requests, 1)
    with installed(ensemble.guide, many.many_runs):
        ensemble.batch.step(nstep=round(0.3 / STEP))  # it has landed
    for number in (0, 1):  # the other way round
        ready = ensemble.prepare(requests[1 - number].scene)
        ensemble.give_models({number: ready})
        ensemble.enter(number, requests[1 - number], ready)
    ensemble.run()
    for member, one in zip(ensemble.members, (rough, scene), strict=True):
        same(member.conclude(0.0), tmj.simulate(one, None, RK4, duration=0.4))


def test_one_that_ends_early_stops_no_other_that_touches() -> None:
    scene = tmj.load_scene("six_bar_drop")
    count = len(scene.structure.strings)

    def explosive(time: float, nodes: Any, velocities: Any) -> Any:
        return np.full(count, 1e9 if time > 0.3 else 0.0)

    runs = tmj.simulate_many([scene] * 3, [None, explosive, None], RK4, duration=0.4, threads=2)
    done = tmj.Status.COMPLETED
    assert runs.status == (done, tmj.Status.DIVERGED, done)
    alone = tmj.simulate(scene, None, RK4, duration=0.4)
    same(runs[0], alone)
    same(runs[2], alone)
    with pytest.raises(tmj.errors.DivergenceError) as single:
        tmj.simulate(scene, explosive, RK4, duration=0.4)
    assert runs.message(1) == str(single.value)


@pytest.mark.parametrize("threads", [1, 2])
def test_a_law_in_rollout_and_batch_touches_as_in_simulate(threads) -> None:
    scene = tmj.load_scene("prism_drop")
    structure = scene.structure

    def law(time: float, nodes: Any, velocities: Any) -> Any:
        lengths = structure.string_lengths(nodes)
        return np.clip(structure.stiffness * (1.0 - 0.99 * structure.rest_lengths / lengths), 0.0, None)

    alone = tmj.simulate(scene, law, RK4, duration=0.4)
    assert alone.reports["contact"]["touching"][-1] >= 1
    steps = round(0.4 / STEP)
    with tmj.law_in(scene, law, RK4) as model:
        batch = Batch(model, 3, threads)
        places = batch.bind("qpos")
        for _ in range(4):  # warm starts are part of a simulation's state
            batch.step(nstep=steps // 4)
        full = mujoco.mjtState.mjSTATE_FULLPHYSICS.value
        start = np.zeros((3, mujoco.mj_stateSize(model, full)))
        for row in start:
            mujoco.mj_getState(model, mujoco.MjData(model), row, full)
        found, _ = rollout.rollout(model, [mujoco.MjData(model) for _ in range(threads)], start, nstep=steps)
    data = mujoco.MjData(model)
    for qpos in (*places, *found[:, -1, 1 : 1 + model.nq]):
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        nodes = data.site_xpos[[model.site(name).id for name in structure.nodes]]
        assert np.array_equal(nodes, alone.nodes[-1])
