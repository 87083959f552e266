"""A scene attached to other models moves as it does alone, wherever and however often it is attached."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import tensegrity_mj as tmj
from evidence.random_structures import random_rotation, random_scene, random_structure
from tensegrity_mj import Command, Integrator
from tensegrity_mj.engines.mujoco.mjcf_tree import initial_velocities, quaternion
from tensegrity_mj.errors import ControllerError, OptionError, StructureError
from tensegrity_mj.model.events import Break
from tensegrity_mj.model.scene import Scene

pytest.importorskip("tensegrity_mj.learning.dm_control", exc_type=tmj.errors.MissingPackageError)
from tensegrity_mj.learning.dm_control import TensegrityEntity, adopt_options, element, physics, repair

repair()
from dm_control import composer, mjcf  # noqa: E402 - after the repair, which keeps its import quiet

Array = NDArray[np.float64]

# The attached model computes the same motion in another frame: about a hundred roundings a step of coordinates below
# 8 m, 2.2e-16 each in relation. Were all of one sign, 250 steps would add up to 250 · 100 · 8 · 2.2e-16 = 4.4e-11 m.
ROUND_OFF = 4.4e-11
STEP, COUNT = 2e-3, 250


def some_scene(seed: int, gravity: bool = True) -> Scene:
    """Free, pinned and constrained rods in motion, point masses, dampers, loads, a string that breaks."""
    rng = np.random.default_rng([9, seed])
    damping = (0.0, 1.0) if seed % 2 else (0.0, 0.0)
    structure = random_structure(
        rng, rods=3, own_planes=0.3, point_masses=seed % 2, planar=seed % 3 == 0, damping=damping
    )
    scene = random_scene(rng, structure, displaced=0.2, moving=0.5, gravity=gravity, loads=2)
    return scene.with_(breaks=(Break("s1", 0.2),)) if seed % 2 else scene


def attached(scene: Scene, places: list[Array], rotation: Array, command: Command) -> tuple[Any, list[Any]]:
    """A model with one copy of the scene at each place, all turned alike, at its start."""
    root = mjcf.RootElement(model="arena")
    adopt_options(root, scene, STEP, Integrator.RK4, rotation)
    root.worldbody.add("geom", type="plane", size=[5, 5, 0.1], pos=[0, 0, -5])  # contacts stay enabled
    entities = [TensegrityEntity(scene, command) for _ in places]
    for entity, place in zip(entities, places, strict=True):
        root.worldbody.add("site", pos=place, quat=quaternion(rotation)).attach(entity.mjcf_model)
    model = mjcf.Physics.from_mjcf_model(root)
    for entity in entities:
        entity.after_compile(model)
        entity.initialize_episode(model)
    model.forward()
    return model, entities


@pytest.mark.parametrize("seed", range(3))
def test_two_attached_copies_each_move_as_the_lone_scene(seed: int) -> None:
    scene, command = some_scene(seed), list(Command)[seed % 2]
    structure = scene.structure
    rng = np.random.default_rng([10, seed])
    rotation, place = random_rotation(rng), rng.uniform(-2, 2, 3)
    model, entities = attached(scene, [place, place + 0.3], rotation, command)
    alone = physics(scene, STEP, command=command)
    for number in range(COUNT):
        if number == 50:
            values = structure.rest_lengths * rng.uniform(0.8, 1.0, len(structure.strings))
            if command is Command.FORCE_DENSITY:
                values = structure.stiffness * rng.uniform(0, 0.3, len(structure.strings))
            alone.set_command(values)
            for entity in entities:
                entity.set_command(model, values)
        for entity in entities:
            np.testing.assert_allclose(entity.nodes(model), alone.nodes(), rtol=0, atol=ROUND_OFF)
            entity.before_substep(model)
        model.step()
        alone.step()
    for entity in entities:
        # Stiffnesses below 50 N/m, dampers below 1 N s/m, and frequencies below 100 rad/s carry the error further.
        np.testing.assert_allclose(entity.velocities(model), alone.velocities(), rtol=0, atol=100 * ROUND_OFF)
        np.testing.assert_allclose(entity.string_lengths(model), alone.string_lengths(), rtol=0, atol=2 * ROUND_OFF)
        np.testing.assert_allclose(entity.rest_lengths(model), alone.rest_lengths(), rtol=0, atol=2 * ROUND_OFF)
        np.testing.assert_allclose(entity.force_densities(model), alone.force_densities(), rtol=0, atol=1e3 * ROUND_OFF)
        np.testing.assert_allclose(entity.tensions(model), alone.tensions(), rtol=0, atol=1e3 * ROUND_OFF)
    assert np.max(np.abs(alone.nodes() - scene.nodes0)) > 0.1
    world = model.bind(entities[0].mjcf_model.find_all("site")).xpos
    assert np.max(np.abs(np.asarray(world).mean(axis=0) - alone.nodes().mean(axis=0))) > 0.1  # it is elsewhere


def test_copies_move_each_on_its_own() -> None:
    scene = tmj.load_scene("prism")
    model, (first, second) = attached(scene, [np.zeros(3), np.ones(3)], np.eye(3), Command.REST_LENGTH)
    alone = physics(scene, STEP)
    first.set_command(model, scene.structure.rest_lengths * np.linspace(0.5, 1, 12))
    model.step(COUNT)
    alone.step(COUNT)
    np.testing.assert_allclose(second.nodes(model), alone.nodes(), rtol=0, atol=ROUND_OFF)
    assert np.max(np.abs(first.nodes(model) - alone.nodes())) > 0.01


def test_a_law_made_for_the_scene_runs_on_an_attached_copy() -> None:
    scene = tmj.load_scene("prism")
    law = tmj.controllers.from_scene(scene)
    rotation = random_rotation(np.random.default_rng(3))
    model, (entity,) = attached(scene, [np.array([1.0, -2.0, 0.5])], rotation, Command.FORCE_DENSITY)
    for number in range(COUNT):
        if number % 5 == 0:
            entity.set_command(model, law(number * STEP, entity.nodes(model), entity.velocities(model)))
        model.step()
    run = tmj.simulate(
        scene,
        law,
        tmj.MuJoCo(STEP),
        duration=COUNT * STEP,
        actuation=tmj.Actuation.hold_force_density(5 * STEP),
        output_interval=COUNT * STEP,
    )
    np.testing.assert_allclose(entity.nodes(model), run.nodes[-1], rtol=0, atol=ROUND_OFF)


def test_velocities_are_relative_to_a_frame_that_moves() -> None:
    scene = tmj.load_scene("prism")
    root = mjcf.RootElement(model="carrier")
    entity = TensegrityEntity(scene)
    frame = root.worldbody.add("site").attach(entity.mjcf_model)
    frame.add("freejoint")
    frame.add("inertial", pos=[0, 0, 0], mass=1.0, diaginertia=[1, 1, 1])
    model = mjcf.Physics.from_mjcf_model(root)
    entity.initialize_episode(model)
    model.bind(mjcf.get_frame_freejoint(entity.mjcf_model)).qvel = [1.0, 2.0, 3.0, 0.4, 0.5, 0.6]
    model.bind(entity.joints).qvel = np.arange(12) * 0.1
    model.forward()
    still = physics(scene)
    still.data.qvel[:] = np.arange(12) * 0.1
    still.forward()
    # Some tens of roundings of speeds below 10 m/s.
    np.testing.assert_allclose(entity.velocities(model), still.velocities(), rtol=0, atol=1e-13)


def test_an_element_has_no_settings_of_its_own() -> None:
    scene = some_scene(4)
    root = element(scene, name="one")
    for part in ("timestep", "integrator", "gravity"):
        assert getattr(root.option, part) is None
    assert not root.keyframe.key
    assert not root.worldbody.light
    assert root.statistic.extent is None
    assert root.model == "one"
    # Two scenes with other gravities and an arena with its own time step: nothing conflicts.
    arena = mjcf.RootElement(model="arena")
    arena.option.timestep = 0.004
    for other in (root, element(some_scene(1))):
        arena.worldbody.add("site").attach(other)
    model = mjcf.Physics.from_mjcf_model(arena)
    assert model.timestep() == 0.004
    np.testing.assert_array_equal(model.model.opt.gravity, [0, 0, -9.81])  # MuJoCo's own


def test_free_rods_keep_the_coordinates_of_a_free_joint() -> None:
    rng = np.random.default_rng(4)
    structure = random_structure(rng, rods=2, support="free")
    scene = random_scene(rng, structure, moving=0.5)
    model, (entity,) = attached(scene, [np.zeros(3)], np.eye(3), Command.REST_LENGTH)
    assert [joint.type for joint in entity.joints] == ["slide", "slide", "slide", "ball"] * 2
    np.testing.assert_array_equal(model.bind(entity.joints).qvel, initial_velocities(scene))
    np.testing.assert_allclose(entity.velocities(model), scene.velocities0, rtol=0, atol=1e-14)


class Hold(composer.Task):  # type: ignore[misc]
    """Two copies in an arena whose rest lengths are held."""

    def __init__(self, scene: Scene) -> None:
        self._arena = composer.Arena()
        adopt_options(self._arena.mjcf_model, scene, STEP)
        self.entities = [TensegrityEntity(scene, name=name) for name in ("left", "right")]
        for number, entity in enumerate(self.entities):
            self._arena.attach(entity, self._arena.mjcf_model.worldbody.add("site", pos=[0, 3 * number, 1]))
            entity.observables.enable_all()
        self.set_timesteps(5 * STEP, STEP)

    @property
    def root_entity(self) -> Any:
        return self._arena

    def get_reward(self, physics: Any) -> float:
        return 0.0


def test_in_a_composer_environment() -> None:
    scene = some_scene(1)
    env = composer.Environment(Hold(scene), time_limit=0.2, strip_singleton_obs_buffer_dim=True)
    alone = physics(scene, STEP)
    structure = scene.structure
    names = {"nodes", "velocities", "string_lengths", "rest_lengths", "tensions"}
    first: list[Array] = []
    for episode in range(2):
        timestep = env.reset()
        alone.reset()
        assert set(timestep.observation) == {f"{name}/{key}" for name in ("left", "right") for key in names}
        while not timestep.last():
            for name in ("left", "right"):
                seen = {key: timestep.observation[f"{name}/{key}"] for key in names}
                assert seen["nodes"].shape == (len(structure.nodes), 3)
                np.testing.assert_allclose(seen["nodes"], alone.nodes(), rtol=0, atol=ROUND_OFF)
                np.testing.assert_allclose(seen["velocities"], alone.velocities(), rtol=0, atol=100 * ROUND_OFF)
                np.testing.assert_allclose(seen["tensions"], alone.tensions(), rtol=0, atol=1e3 * ROUND_OFF)
            timestep = env.step(np.zeros(env.action_spec().shape))
            alone.step(5)
        first.append(alone.nodes())
        assert np.max(np.abs(alone.nodes() - scene.nodes0)) > 0.05, episode
    np.testing.assert_array_equal(first[0], first[1])


@pytest.mark.parametrize(
    "setting", [{"inertiafromgeom": True}, {"boundmass": 3.0}, {"boundinertia": 1e-4}, {"settotalmass": 9.0}]
)
def test_an_arena_that_changes_masses_is_found_out(setting: dict[str, Any]) -> None:
    root = mjcf.RootElement(model="arena")
    for name, value in setting.items():
        setattr(root.compiler, name, str(value).lower() if isinstance(value, bool) else value)
    entity = TensegrityEntity(tmj.load_scene("prism"))
    root.worldbody.add("site").attach(entity.mjcf_model)
    model = mjcf.Physics.from_mjcf_model(root)
    with pytest.raises(OptionError, match=r"body 'prism/rod1' has .*take inertiafromgeom"):
        entity.after_compile(model)


def test_what_pymjcf_cannot_hold_is_refused() -> None:
    prism = tmj.load_scene("prism")
    strings = (replace(prism.structure.strings[0], name="s/1"), *prism.structure.strings[1:])
    slashed = prism.with_(structure=replace(prism.structure, strings=strings))
    with pytest.raises(StructureError, match=r"'s/1'.*rename"):
        element(slashed)
    assert element(prism.with_(name="a/b")).model == "a b"
    for name in ("", "a/b", 3):
        with pytest.raises(OptionError, match="name = "):
            element(prism, name=name)  # type: ignore[arg-type]
    with pytest.raises(OptionError, match=r"command = .*Command\.REST_LENGTH"):
        element(prism, "rest length")  # type: ignore[arg-type]
    for rotation in (np.ones((3, 3)), np.diag([1.0, 1.0, -1.0]), np.eye(2)):
        with pytest.raises(OptionError, match="rotation"):
            adopt_options(mjcf.RootElement(), prism, rotation=rotation)
    model, (entity,) = attached(prism, [np.zeros(3)], np.eye(3), Command.REST_LENGTH)
    with pytest.raises(ControllerError, match=r"rest length has shape \(3,\)"):
        entity.set_command(model, np.zeros(3))


def test_gravity_turns_with_the_frame() -> None:
    scene = some_scene(2)
    rotation = random_rotation(np.random.default_rng(1))
    root = mjcf.RootElement()
    adopt_options(root, scene, rotation=rotation)
    np.testing.assert_allclose(root.option.gravity, rotation @ np.array(scene.gravity), rtol=0, atol=1e-14)
    model, (entity,) = attached(scene, [np.zeros(3)], rotation, Command.REST_LENGTH)
    model.model.opt.gravity[:] = scene.gravity  # not turned: another experiment
    alone = physics(scene, STEP)
    model.step(COUNT)
    alone.step(COUNT)
    assert np.max(np.abs(entity.nodes(model) - alone.nodes())) > 1e-2
