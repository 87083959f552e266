"""Rigid bodies as structures and files have them; `tests/engines/test_bodies.py` has how they move."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from body_scenes import CENTER, CORNERS, MOMENTS, slung, stone
from scipy.spatial.transform import Rotation

import tensegrity_mj as tmj
from evidence.thesis.disturbance import Disturbance, Quantity, disturbed
from tensegrity_mj.model import Body, format_schema, rods
from tensegrity_mj.model.bodies import frame_of
from tensegrity_mj.model.text.reading import scene_from_toml
from tensegrity_mj.model.text.writing import scene_to_toml


def solid(**changes):
    return tmj.Structure("solid", CORNERS, bodies=(stone(**changes),))


def solid_of(body):
    return tmj.Structure("solid", CORNERS, bodies=(body,))


TURNING = np.cross([2.0, -1.0, 1.5], np.array(list(CORNERS.values())) - CENTER)  # m/s, about its centre of mass

WRONG = {
    "three nodes": (lambda: stone(nodes=("a", "b", "c")), r"body 'stone': nodes = .*four or more"),
    "a node twice": (lambda: stone(nodes=("a", "b", "c", "c")), r"four or more, each of them once"),
    "no mass": (lambda: stone(mass=0.0), r"mass = 0.0; it must be > 0 kg"),
    "four moments": (lambda: stone(inertia=(1, 2, 3, 4)), r"inertia = .*give \[Ixx, Iyy, Izz\]"),
    "no body's moments": (lambda: stone(inertia=(1, 1, 3)), r"principal moments 1, 1, 3 kg m²; .*sum of the other two"),
    "a negative moment": (lambda: stone(inertia=(1, 1, 1, 2, 0, 0)), r"principal moments -1, 1, 3"),
    "an unknown node": (lambda: solid(nodes=("a", "b", "c", "e")), r"body 'stone': unknown node 'e'"),
    "nodes in a plane": (
        lambda: tmj.Structure("flat", {**CORNERS, "d": (0.09, 0.11, 0.07)}, bodies=(stone(),)),
        r"body 'stone': its nodes lie in a plane.*one more node of it off that plane",
    ),
    "a node of a rod": (
        lambda: replace(slung().structure, bodies=(stone(nodes=("a", "b", "c", "d", "p")),)),
        r"node 'p' of body 'stone' is rod 'r' already: a body has nodes of its own",
    ),
    "nothing that moves": (lambda: solid(held=True), "neither rods nor point masses: nothing can move"),
    "two of one name": (lambda: replace(solid(), bodies=(stone(), stone())), "body 'stone' is defined twice"),
    "a shared node": (
        lambda: replace(solid(), bodies=(stone(), stone(name="other"))),
        r"node 'a' of body 'other' is a node of body 'stone' already",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_is_no_body_is_refused(case):
    make, message = WRONG[case]
    with pytest.raises(tmj.errors.StructureError, match=message):
        make()


def test_starts_that_no_rigid_body_has_are_refused():
    scene = slung()
    nodes = np.array(scene.nodes0)
    nodes[0] += 0.01
    with pytest.raises(tmj.errors.SceneError, match=r"initial_nodes: a node of body .* m off; it is rigid"):
        scene.with_(initial_nodes=nodes)
    rates = np.array(scene.velocities0)
    rates[1] += 0.5
    with pytest.raises(tmj.errors.SceneError, match=r"initial_velocities: a node of body 'stone' is .* m/s off"):
        scene.with_(initial_velocities=rates)
    mirrored = scene.nodes0 * [[1, 1, 1]]
    mirrored[:4, 0] *= -1
    with pytest.raises(tmj.errors.SceneError, match="is rigid"):
        scene.with_(initial_nodes=mirrored)
    held = replace(scene.structure, bodies=(stone(held=True),))
    with pytest.raises(tmj.errors.SceneError, match="held, and at rest"):
        tmj.Scene(held, initial_velocities=scene.velocities0)


def test_files_hold_bodies_without_loss():
    scene = slung()
    scene = scene.with_(structure=replace(scene.structure, bodies=(stone(),)))
    assert scene_from_toml(scene_to_toml(scene)) == scene
    plain = Body("plain", tuple("abcd"), 1.0, (1, 1, 1), held=True)
    other = tmj.Scene(replace(scene.structure, bodies=(plain,)))
    assert scene_from_toml(scene_to_toml(other)) == other
    schema = format_schema()["definitions"]["Body"]
    assert set(schema["properties"]) == {"name", "nodes", "mass", "inertia", "center", "held"}
    assert schema["required"] == ["name", "nodes", "mass", "inertia"]


def test_moved_and_mirrored_bodies_have_the_same_energy_and_weight():
    """Of one motion seen from elsewhere: kinetic energy and height are those of integrals in closed form."""
    structure, spin, velocity = solid(), np.array([0.3, -1.0, 2.0]), np.array([1.0, 0.5, -0.2])
    rates = velocity + np.cross(spin, structure.positions - CENTER)
    energy = 0.5 * 2.0 * velocity @ velocity + 0.5 * spin @ stone().inertia_matrix @ spin
    rotation = Rotation.from_rotvec([0.4, -0.7, 1.1]).as_matrix()
    there = structure.moved(rotation, (1.0, 2.0, 3.0))
    glass = structure.mirrored((1.0, 2.0, 0.5), (0.1, 0.0, 0.0))
    normal = np.array([1.0, 2.0, 0.5]) / np.linalg.norm([1.0, 2.0, 0.5])
    flip = np.eye(3) - 2 * np.outer(normal, normal)
    for one, matrix in ((structure, np.eye(3)), (there, rotation), (glass, flip)):
        assert rods.kinetic_energy(one, rates @ matrix.T) == pytest.approx(energy, rel=1e-13)
        (frame,) = one.frames
        center = rods.lumped_masses(one) @ one.positions / 2.0
        assert center == pytest.approx(np.array(one.bodies[0].center), abs=1e-14)
        assert frame.fit[0].sum() == pytest.approx(1.0, rel=1e-14)
    assert there.bodies[0].center == pytest.approx(rotation @ CENTER + [1, 2, 3], abs=1e-15)
    assert there.moved(rotation.T).moved(None, -(rotation.T @ [1, 2, 3])).bodies[0].inertia == pytest.approx(MOMENTS)


def test_a_heavier_body_turns_more_slowly():
    """Its moments grow with its mass, and so does the energy of a turn."""
    body = stone()
    heavy = body.times(2.5)
    assert (heavy.mass, heavy.nodes, heavy.center) == (2.5 * body.mass, body.nodes, body.center)
    np.testing.assert_allclose(heavy.inertia_matrix, 2.5 * body.inertia_matrix, rtol=1e-15)
    scene = disturbed(slung(), Disturbance(Quantity.MASS, 2.5))
    assert scene.structure.bodies == (slung().structure.bodies[0].times(2.5),)
    kinetic = [
        tmj.simulate(one, None, tmj.DAE(), duration=0.01).kinetic_energy[0]
        for one in (
            tmj.Scene(solid(), initial_velocities=TURNING),
            tmj.Scene(solid_of(heavy), initial_velocities=TURNING),
        )
    ]
    assert kinetic[1] == pytest.approx(2.5 * kinetic[0], rel=1e-12)


def test_forces_on_its_nodes_accelerate_a_body_as_newton_and_euler_say():
    """From rest: F/m of the centre of mass, I⁻¹ of the moment about it, of a body that has turned. Round-off: 1e-12."""
    turned = solid().moved([0.3, -0.8, 1.1], [1.0, 2.0, 3.0])
    (body,) = turned.bodies
    nodes = turned.positions
    forces = np.random.default_rng(0).normal(size=nodes.shape)
    found = (frame_of(turned, body).mobility(nodes) @ forces.ravel()).reshape(-1, 3)
    away = nodes - np.array(body.center)
    spin = np.linalg.solve(body.inertia_matrix, np.cross(away, forces).sum(axis=0))
    expected = forces.sum(axis=0) / body.mass + np.cross(spin, away)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


def test_merged_structures_have_both_bodies():
    structure = solid()
    both = structure.merged(structure.moved(None, (5.0, 0.0, 0.0)), prefix="b_")
    assert [body.name for body in both.bodies] == ["stone", "b_stone"]
    assert both.bodies[1].nodes == ("b_a", "b_b", "b_c", "b_d")
    assert structure.merged(structure, join=True).bodies == structure.bodies


def test_many_simulations_have_the_same_bodies():
    scene = slung()
    alone = tmj.simulate(scene, None, tmj.MuJoCo(1e-3), duration=0.1, output_interval=0.01)
    (found,) = tmj.simulate_many([scene], None, tmj.MuJoCo(1e-3), duration=0.1, output_interval=0.01)
    assert np.abs(found.nodes - alone.nodes).max() <= 1e-13


def test_a_sweep_sets_the_mass_of_a_body():
    from tensegrity_mj.studies.scene_parameters import changed_scene

    changed = changed_scene(slung(), "structure", "bodies.mass", "structure.bodies.mass", 3.0)
    assert changed.structure.bodies[0].mass == 3.0
    held = changed_scene(tmj.load_scene("spine"), "structure", "bodies[vertebra3].mass", "mass", 0.2)
    assert [body.mass for body in held.structure.bodies] == [0.136, 0.136, 0.136, 0.2]
