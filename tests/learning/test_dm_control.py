"""dm_control's Physics of a scene steps to the same state as the engine, and needs a repair only beside MuJoCo 4.0."""

from __future__ import annotations

import subprocess
import sys
from importlib.metadata import version
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

import tensegrity_mj as tmj
from evidence.random_structures import random_scene, random_structure
from tensegrity_mj import Actuation, Integrator
from tensegrity_mj.engines.mujoco.mjcf import scene_to_mjcf
from tensegrity_mj.engines.mujoco.mjcf_tree import initial_velocities
from tensegrity_mj.errors import OptionError, SceneError, StructureError
from tensegrity_mj.model import strings
from tensegrity_mj.model.scene import Scene

pytest.importorskip("tensegrity_mj.learning.dm_control", exc_type=tmj.errors.MissingPackageError)
from tensegrity_mj.learning.dm_control import element, physics, repair

Array = NDArray[np.float64]


def moving_scene(seed: int) -> Scene:
    rng = np.random.default_rng([3, seed])
    structure = random_structure(rng, rods=2, own_planes=0.3, planar=seed % 3 == 0, point_masses=seed % 2)
    return random_scene(rng, structure, displaced=0.2, moving=0.5, gravity=True)


def nodes_of(env: Any, scene: Scene) -> Array:
    return np.array(env.named.data.site_xpos[list(scene.structure.node_names)])


def velocities_of(env: Any, scene: Scene) -> Array:
    rows = []
    for name in scene.structure.node_names:
        block = np.zeros((3, env.model.nv))
        mujoco.mj_jacSite(env.model.ptr, env.data.ptr, block, None, env.model.site(name).id)
        rows.append(block @ env.data.qvel)
    return np.array(rows)


@pytest.mark.parametrize("integrator", Integrator)
@pytest.mark.parametrize("seed", range(4))
def test_a_passive_scene_steps_to_the_same_state_bit_by_bit(seed: int, integrator: Integrator) -> None:
    scene, step, count = moving_scene(seed), 2e-3, 100
    run = tmj.simulate(scene, None, tmj.MuJoCo(step, integrator), duration=count * step, output_interval=step)
    model = tmj.MuJoCo(step, integrator).model(scene)
    data = mujoco.MjData(model)
    data.qvel[:] = initial_velocities(scene)
    env = physics(scene, step, integrator)
    for row in range(count + 1):
        np.testing.assert_array_equal(env.data.qpos, data.qpos)
        np.testing.assert_array_equal(env.data.qvel, data.qvel)
        np.testing.assert_array_equal(nodes_of(env, scene), run.nodes[row])
        mujoco.mj_step(model, data)
        env.step()
    assert np.abs(run.nodes[-1] - run.nodes[0]).max() > 1e-2  # it did move


@pytest.mark.parametrize("integrator", [Integrator.EULER, Integrator.RK4])
def test_a_control_loop_in_dm_control_is_the_engine_with_held_rest_lengths(integrator: Integrator) -> None:
    scene, step, count = tmj.load_scene("prism"), 5e-3, 200
    structure = scene.structure
    law = tmj.controllers.from_scene(scene)
    run = tmj.simulate(
        scene,
        law,
        tmj.MuJoCo(step, integrator),
        duration=count * step,
        actuation=Actuation.hold_rest_length(step),
        output_interval=step,
    )
    env = physics(scene, step, integrator)
    positions, ctrl = [], []
    for _ in range(count):
        nodes = nodes_of(env, scene)
        u = np.asarray(law(env.time(), nodes, velocities_of(env, scene)))
        rest = strings.rest_length(structure.stiffness, structure.string_lengths(nodes), u)
        positions.append(nodes)
        ctrl.append(rest)
        env.set_control(rest - structure.rest_lengths)
        env.step()
    positions.append(nodes_of(env, scene))
    # The law and the node velocities are summed up in other orders here: some hundred roundings a step, of rest lengths
    # below 1.2 m. A stiffness of 2 N/m on inertias from 1/12 kg m² turns each into at most 24 times as much
    # acceleration, and the motion (slower than 1 rad/s) does not amplify it in the second that it lasts.
    assert np.max(np.abs(np.array(ctrl) - run.rest_lengths[:count])) <= 100 * 24 * 2.3e-16
    assert np.max(np.abs(np.array(positions) - run.nodes)) <= 100 * 24 * 2.3e-16
    assert np.max(np.abs(run.nodes[-1] - run.nodes[0])) > 1e-2


def test_reset_to_the_keyframe_is_the_start() -> None:
    scene = moving_scene(1)
    env = physics(scene)
    start = env.data.qvel.copy()
    assert np.linalg.norm(start) > 0.1
    env.step(10)
    env.reset(keyframe_id=0)
    np.testing.assert_array_equal(env.data.qvel, start)
    np.testing.assert_array_equal(nodes_of(env, scene), nodes_of(physics(scene), scene))


def test_elements_have_the_names_of_the_scene() -> None:
    scene = tmj.load_scene("prism")
    env = physics(scene)
    assert list(env.named.data.ctrl.axes.row.names) == [string.name for string in scene.structure.strings]
    assert set(scene.structure.node_names) <= set(env.named.data.site_xpos.axes.row.names)
    assert {rod.name for rod in scene.structure.rods} <= set(env.named.data.xpos.axes.row.names)


def test_pymjcf_reads_the_model_without_loss() -> None:
    scene = tmj.load_scene("prism")
    repair()
    from dm_control import mjcf

    env = mjcf.Physics.from_mjcf_model(mjcf.from_xml_string(scene_to_mjcf(scene, 1e-3)))
    same = physics(scene, 1e-3)
    for each in (env, same):
        each.set_control(np.linspace(-0.2, 0.1, 12))
        each.step(100)
    np.testing.assert_array_equal(env.data.qpos, same.data.qpos)


def test_bad_options_are_refused() -> None:
    scene = tmj.load_scene("pinned_rod")
    with pytest.raises(OptionError, match="timestep"):
        physics(scene, timestep=-1.0)
    with pytest.raises(OptionError, match="integrator"):
        physics(scene, integrator="rk5")  # type: ignore[arg-type]


def test_scenes_that_it_cannot_hold_are_refused() -> None:
    rod = tmj.Rod("r", ("a", "b"), 1.0, support=tmj.Support.pinned())
    nodes = {"a": (0.0, 0.0, 0.0), "b": (0.0, 0.0, -1.0)}
    structure = tmj.Structure("one", nodes, (rod,))
    chain = tmj.Structure("two", {**nodes, "c": (0.0, 0.0, -2.0)}, (rod, tmj.Rod("s", ("b", "c"), 1.0)))
    moved = (tmj.model.Motion.in_line("r", 0.1, 1.0, (1, 0, 0)),)
    for scene, error, message in (
        (Scene(chain), StructureError, "rods .r. and .s. share node .b.: .* structures of class 1"),
        (Scene(structure, motions=moved), SceneError, "support .r. moves .* supports that stand still"),
        (
            Scene(structure, gravity=(0, 0, -9.81), water=tmj.Water()),
            SceneError,
            "water adds mass to rods: .* each stage",
        ),
    ):
        for call in (physics, element):
            with pytest.raises(error, match=f"dm_control models: {message}"):
                call(scene)


def test_a_scene_with_contact_touches_and_is_no_element() -> None:
    scene = tmj.load_scene("prism_drop")
    with pytest.raises(OptionError, match=r"has contact.*with_\(contact=None\)"):
        element(scene)
    held = physics(scene, timestep=1e-3)
    held.step(500)
    assert held.data.ptr.ncon > 0


CODE = """
import sys, warnings
warnings.simplefilter("ignore")
if sys.argv[1] == "repaired":
    from tensegrity_mj.learning.dm_control import repair
    print(len(repair()), len(repair()))
from dm_control.mujoco import Physics
Physics.from_xml_string("<mujoco><worldbody/></mujoco>").step()
"""


def child(argument: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", CODE, argument], capture_output=True, text=True)


def test_the_repair_is_needed_and_is_enough() -> None:
    plain, repaired = child("plain"), child("repaired")
    assert repaired.returncode == 0, repaired.stderr
    first, second = (int(count) for count in repaired.stdout.split())
    assert second == 0  # a second call finds nothing to do
    if plain.returncode == 0:
        assert first == 0
        pytest.skip(
            f"dm_control {version('dm_control')} works beside MuJoCo {version('mujoco')} by itself: "
            "tensegrity_mj.learning.dm_control.repair can go once pyproject.toml requires that dm_control"
        )
    assert first > 0
    assert "has no attribute" in plain.stderr


def test_the_repair_leaves_what_is_there() -> None:
    repair()
    from dm_control.mujoco.wrapper.mjbindings import sizes

    assert {"qpos", "qvel", "site_xpos", "ctrl"} <= set(sizes.array_sizes["mjdata"])
    assert {"qpos0", "body_mass", "actuator_gainprm"} <= set(sizes.array_sizes["mjmodel"])
