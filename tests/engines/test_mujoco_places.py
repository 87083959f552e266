"""The compiled model stands where the structure does, whatever the unit of length.

MuJoCo's compiler takes frames nearer than 1e-6 m for one. `test_mujoco_model` has the rest of the model.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest
from linked_scenes import four_bar, random_tree
from numpy.typing import NDArray

import tensegrity_mj as tmj
from evidence.random_structures import random_scene, random_structure
from tensegrity_mj.engines.mujoco import prepared
from tensegrity_mj.engines.mujoco import prepared as mujoco_prepared
from tensegrity_mj.engines.mujoco.mjcf import save_mjcf, scene_to_mjcf
from tensegrity_mj.engines.mujoco.mjcf_tree import Names, body_tree
from tensegrity_mj.errors import StructureError

Array = NDArray[np.float64]
SCALES = [1e-6, 3e-5, 1e-3, 1.0, 1e4]
STEP, DURATION = 2.5e-4, 0.05
NEAR = 4e-7  # m: below what MuJoCo distinguishes


def scaled(scene: tmj.Scene, size: float) -> tmj.Scene:
    """The same motion in another unit of length: lengths times `size`, moments of inertia and times as they are.

    With masses and stiffnesses over size², m ℓ² and k ℓ² stay: no limit of MuJoCo on masses and inertia is met.
    """
    structure = scene.structure
    strings = [
        replace(
            string,
            stiffness=string.stiffness / size**2,
            damping=string.damping / size**2,
            rest_length=float(rest * size),
            tension=None,
            force_density=None,
        )
        for string, rest in zip(structure.strings, structure.rest_lengths, strict=True)
    ]
    rods = [replace(rod, mass=rod.mass / size**2, radius=rod.radius * size) for rod in structure.rods]
    points = [replace(point, mass=point.mass / size**2) for point in structure.point_masses]
    nodes = {name: tuple((size * np.array(place)).tolist()) for name, place in structure.nodes.items()}
    made = replace(structure, nodes=nodes, rods=tuple(rods), strings=tuple(strings), point_masses=tuple(points))
    return tmj.Scene(
        made,
        gravity=tuple((size * np.array(scene.gravity)).tolist()),
        initial_nodes=size * scene.nodes0,
        initial_velocities=size * scene.velocities0,
        duration=DURATION,
    )


def near_frames() -> tmj.Scene:
    """A scene of a metre with everything that can come near a frame: the origin, a body's origin, a center of mass."""
    structure = tmj.Structure(
        "near",
        nodes={
            "foot": (1.0, 0.0, -NEAR),
            "tip": (2.0, 0.0, -NEAR),
            "o": (NEAR, -NEAR, 2 * NEAR),
            "a": (0.5, 1.0, 0.0),
            "b": (0.5, 2.0, 0.5),
            "c": (-1.0, 0.3, 0.7),
            "d": (-1.0, 1.1, 0.7),
            "mass": (0.4, -0.8, 0.6),
        },
        rods=(
            tmj.Rod("pinned near its end", ("foot", "tip"), 1.0, support=tmj.Support.pinned(NEAR)),
            tmj.Rod("held near its middle", ("a", "b"), 1.0, support=tmj.Support.constrained([1, 2, 3], 0.5 + NEAR)),
            tmj.Rod("free", ("c", "d"), 0.7, support=tmj.Support.free(1 - NEAR)),
        ),
        strings=tuple(
            tmj.String(f"s{number}", ends, 30.0, 0.4, force_density=6.0)
            for number, ends in enumerate(
                [
                    ("o", "tip"),
                    ("o", "a"),
                    ("b", "tip"),
                    ("c", "a"),
                    ("d", "o"),
                    ("d", "b"),
                    ("mass", "o"),
                    ("mass", "c"),
                ]
            )
        ),
        fixed_nodes=("o",),
        point_masses=(tmj.PointMass("mass", 0.5),),
    )
    return tmj.Scene(structure, gravity=(0.0, 0.0, -1.0), duration=DURATION)


def moving(seed: int) -> tmj.Scene:
    rng = np.random.default_rng([71, seed])
    structure = random_structure(rng, rods=3, stretch=(0.2, 0.4), point_masses=1, fixed_nodes=2)
    return random_scene(rng, structure, moving=0.3, gravity=True)


SCENES = {"near frames": near_frames(), "tree": random_tree(np.random.default_rng(8), 4, planar=False)}
SCENES |= {f"random {seed}": moving(seed) for seed in range(3)}
every_scene = pytest.mark.parametrize("name", SCENES)
every_scale = pytest.mark.parametrize("size", SCALES)


def places_in(model: mujoco.MjModel, scene: tmj.Scene) -> Array:
    """Where a model's sites are, (N, 3), found without the engine."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return np.array([data.site(name).xpos for name in scene.structure.node_names])


@every_scale
@every_scene
def test_sites_of_the_compiled_model_and_of_the_file_stand_where_nodes_do(
    name: str, size: float, tmp_path: Any
) -> None:
    """To 1e-12 of the size, also where another program loads the exported file: nothing is repaired afterwards."""
    scene = scaled(SCENES[name], size)
    extent = np.ptp(scene.nodes0, axis=0).max()
    file = save_mjcf(scene, tmp_path / "scene.xml")
    for model in (tmj.MuJoCo().model(scene), mujoco.MjModel.from_xml_path(str(file))):
        # Coordinates are of the order of the extent, and carry a few roundings.
        np.testing.assert_allclose(places_in(model, scene), scene.nodes0, rtol=0, atol=1e-12 * extent)


@every_scale
@every_scene
def test_motion_does_not_depend_on_the_unit_of_length(name: str, size: float) -> None:
    """MuJoCo against the DAE, both in units of the structure's size.

    RK4 at 0.25 ms and frequencies below 25 rad/s errs by (ω h)⁵/120 a step: 2e-11 of the motion over 200 steps, and as
    much where rods turn as fast; the DAE's tolerance adds 1e-12 a step. A node 4e-7 m off its place in a scene of a
    metre turns a string's pull of 6 m/s² by as much, and moves what it pulls by 6·4e-7·(0.05 s)²/2 = 3e-9 m; in a scene
    of micrometres it is anywhere. Strings stay taut.
    """
    scene = scaled(SCENES[name], size)
    run = tmj.simulate(scene, None, tmj.MuJoCo(STEP))
    truth = tmj.simulate(scene, None, tmj.DAE(rtol=1e-12, atol=1e-14 * min(size, 1.0)))
    assert tmj.compare(run, truth).max_node_error < 2e-10 * size
    assert np.max(np.abs(truth.nodes - truth.nodes[0])) > 0.05 * size
    assert np.all(truth.force_densities > 0)


def test_only_what_is_near_a_frame_is_turned() -> None:
    """Of a scene of metres nothing is: its file is as ever. Turned frames are turned differently, so none are one."""
    assert "quat" not in [key for site in sites_of(tmj.load_scene("prism")) for key in site]
    turned = {site["name"] for site in sites_of(near_frames()) if "quat" in site}
    assert turned == {"o", "foot", "d"}
    model = tmj.MuJoCo().model(scaled(near_frames(), 1e-6))
    same = mujoco.mjtSameFrame
    exact = np.all(model.site_pos == 0, axis=1)
    assert np.all(exact | (model.site_sameframe == int(same.mjSAMEFRAME_NONE)))


def sites_of(scene: tmj.Scene) -> list[dict[str, str]]:
    from xml.etree import ElementTree

    return [site.attrib for site in ElementTree.fromstring(scene_to_mjcf(scene)).iter("site")]


def test_a_floor_near_the_origin_stays_where_it_is() -> None:
    structure = tmj.Structure("ball", {"n": (0.0, 0.0, 1.0)}, point_masses=(tmj.PointMass("n", 1.0),))
    for height in (NEAR, -2 * NEAR, 0.0, 0.1 + NEAR):
        scene = tmj.Scene(structure, contact=tmj.model.Contact(floor=height))
        model = tmj.MuJoCo().model(scene)
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        assert data.geom("floor").xpos.tolist() == [0.0, 0.0, height]
        np.testing.assert_allclose(data.geom("floor").xmat.reshape(3, 3)[:, 2], [0, 0, 1], atol=1e-15)


@pytest.mark.parametrize("size", [1e-6, 1.0])
def test_a_law_in_a_batch_and_in_a_model_sees_the_nodes(size: float) -> None:
    """`simulate_many` is `simulate`, and `law_in` gives its model, both of which place the nodes right."""
    scene = scaled(near_frames(), size)
    alone = tmj.simulate(scene, None, tmj.MuJoCo(STEP))
    both = tmj.simulate_many([scene, scene], None, tmj.MuJoCo(STEP))
    np.testing.assert_array_equal(both[1].nodes, alone.nodes)

    def law(time: float, nodes: Array, velocities: Array) -> Array:
        return 6.0 / size**2 * np.ones(len(scene.structure.strings))

    with tmj.law_in(scene, law) as model:
        assert np.abs(places_in(model, scene) - scene.nodes0).max() < 1e-12 * size


@pytest.mark.parametrize("size", [1e-6, 1e-3, 1.0])
def test_dm_control_sees_the_nodes(size: float) -> None:
    """A Physics, an Environment, and an entity in an arena, whose frame is where the scene's world is."""
    pytest.importorskip("tensegrity_mj.learning.dm_control", exc_type=tmj.errors.MissingPackageError).repair()
    from dm_control import mjcf

    from tensegrity_mj.learning.dm_control import TensegrityEntity, adopt_options, environment, physics

    scene = scaled(near_frames(), size)
    within = {"rtol": 0, "atol": 1e-12 * 3 * size}
    np.testing.assert_allclose(physics(scene).nodes(), scene.nodes0, **within)
    first = environment(scene, control_timestep=1e-2, time_limit=0.1, reward=lambda *_: 0.0).reset()
    np.testing.assert_allclose(first.observation["nodes"], scene.nodes0, **within)
    arena = mjcf.RootElement(model="arena")
    adopt_options(arena, scene)
    entity = TensegrityEntity(scene)
    arena.worldbody.add("site").attach(entity.mjcf_model)
    whole = mjcf.Physics.from_mjcf_model(arena)
    entity.initialize_episode(whole)
    np.testing.assert_allclose(entity.nodes(whole), scene.nodes0, **within)


@pytest.mark.parametrize("kind", ["site", "body"])
def test_what_a_compiler_moves_is_refused_by_name(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The check itself: without the turns, MuJoCo puts node o onto the origin, and a center of mass onto its body."""
    scene = near_frames()
    monkeypatch.setattr(prepared, "_layouts", {})  # others have compiled it
    monkeypatch.setattr("tensegrity_mj.engines.mujoco.mjcf.must_turn", lambda *_: False)
    if kind == "body":  # of centers of mass alone
        monkeypatch.setattr(mujoco_prepared, "_compare", _without_nodes(mujoco_prepared._compare))
    complaint = (
        "node 'o' is 8e-07 m off" if kind == "site" else "center of mass of rod 'held near its middle' is 4e-07 m off"
    )
    with pytest.raises(StructureError, match=complaint):
        tmj.MuJoCo().model(scene)


def _without_nodes(compare: Any) -> Any:
    return lambda kind, *rest: None if kind == "node" else compare(kind, *rest)


def test_a_moved_capsule_or_a_joined_end_is_refused_too() -> None:
    """By the check alone, on models whose places were changed after compiling."""
    scene = SCENES["near frames"]
    model = tmj.MuJoCo().model(scene)
    model.geom_pos[model.geom("free").id, 2] += 1e-9
    with pytest.raises(StructureError, match="capsule of rod 'free' is 1e-09 m off"):
        mujoco_prepared.check_places(scene, model)
    loop = four_bar(planar=True)
    model = tmj.MuJoCo().model(loop)
    end = Names(loop, body_tree(loop)).ends[0]
    model.site_pos[model.site(end).id, 2] += 1e-9  # along a rod that does not stand upright
    with pytest.raises(StructureError, match=f"end '{end}' is 9.94e-10 m off"):
        mujoco_prepared.check_places(loop, model)
