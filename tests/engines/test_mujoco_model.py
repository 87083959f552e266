"""The generated MJCF: no more than the scene needs, exact, readable by any MuJoCo, whatever the names."""

from __future__ import annotations

import math
from pathlib import Path

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

import tensegrity_mj as tmj
from evidence.random_structures import random_scene, random_structure
from tensegrity_mj.engines.mujoco.mjcf import save_mjcf, scene_to_mjcf
from tensegrity_mj.engines.mujoco.mjcf_tree import initial_velocities
from tensegrity_mj.errors import FormatError, OptionError, StructureError
from tensegrity_mj.model import rods
from tensegrity_mj.model.events import Load
from tensegrity_mj.model.members import PointMass, Rod, String, Support
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure

Array = NDArray[np.float64]
EPS = np.finfo(float).eps
SLIDE, BALL, HINGE, FREE = (getattr(mujoco.mjtJoint, f"mjJNT_{name}") for name in ("SLIDE", "BALL", "HINGE", "FREE"))
Y, OBLIQUE = (0.0, 1.0, 0.0), (1.0, 0.0, 2.0)

# Degrees of freedom that move nodes, and the joints. A rod that is not planar has one degree of freedom more in MuJoCo,
# the spin about its axis, which a free or a ball joint brings along: strings attach on the axis, so it stays at rest.
SUPPORTS = {
    "free": (Support.free(0.3), 5, [FREE]),
    "pinned": (Support.pinned(0.3), 2, [BALL]),
    "on a plane": (Support.constrained([0, 0, 1], 0.3), 4, [SLIDE, SLIDE, BALL]),
    "on an oblique plane": (Support.constrained([1, 2, 3], 1.0), 4, [SLIDE, SLIDE, BALL]),
    "on a line": (Support.constrained([[1, 0, 0], [1, 0, 1]]), 3, [SLIDE, BALL]),
    "pinned by rows": (Support.constrained([[1, 0, 0], [0, 1, 1], [0, 1, -1]]), 2, [BALL]),
    "free in a plane": (Support.free(0.3, plane=Y), 3, [SLIDE, SLIDE, HINGE]),
    "pinned in a plane": (Support.pinned(0.0, plane=Y), 1, [HINGE]),
    "on a line in a plane": (Support.constrained([1, 0, 1], plane=Y), 2, [SLIDE, HINGE]),
    "turning in a plane, held out of it": (Support.constrained([0, 1, 0], plane=Y), 3, [SLIDE, SLIDE, HINGE]),
}


def one_rod(support: Support = Support.free(), name: str = "rod", ends: tuple[str, str] = ("a", "b")) -> Scene:  # noqa: B008
    nodes = {ends[0]: (0.1, 0.2, 0.3), ends[1]: (0.7, 0.2, -0.6)}
    return Scene(Structure("one rod", nodes, rods=(Rod(name, ends, 1.3, support=support),)))


def model_of(scene: Scene) -> mujoco.MjModel:
    return tmj.MuJoCo(2e-3).model(scene)


def node_jacobian(model: mujoco.MjModel, scene: Scene) -> Array:
    """Node velocities (3 N, nv) for unit velocities of the joints, at the start."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    blocks = []
    for name in scene.structure.node_names:
        block = np.zeros((3, model.nv))
        mujoco.mj_jacSite(model, data, block, None, model.site(name).id)
        blocks.append(block)
    return np.vstack(blocks)


def every_support(rng: np.random.Generator, number: int) -> Scene:
    """A random scene in motion; among ten, every support, planar and not, with and without point masses."""
    structure = random_structure(
        rng,
        rods=3 if number % 5 else 0,
        planar=number % 2 == 1,
        own_planes=0.3,
        point_masses=2 if number % 5 == 0 else number % 2,
        damping=(0.0, 1.0) if number % 3 else (0.0, 0.0),
    )
    return random_scene(rng, structure, displaced=0.8, moving=2.0, gravity=True)


SCENES = [every_support(np.random.default_rng([5, number]), number) for number in range(20)]


@pytest.mark.parametrize("name", SUPPORTS)
def test_joints_are_no_more_than_the_support_needs(name: str) -> None:
    support, useful, joints = SUPPORTS[name]
    scene = one_rod(support)
    model = model_of(scene)
    assert list(model.jnt_type) == joints
    assert model.nv == useful + (support.plane is None)
    # Of what the joints can do, all but the spin moves nodes. The Jacobian's entries are of the order of one.
    singular = np.linalg.svd(node_jacobian(model, scene), compute_uv=False)
    assert np.sum(singular > 1e-6) == useful


def test_point_masses_slide() -> None:
    structure = Structure(
        "masses",
        {"a": (0.0, 0.0, 0.0), "b": (1.0, 0.0, 0.0)},
        point_masses=(PointMass("a", 1.0), PointMass("b", 2.0, plane=OBLIQUE)),
    )
    model = model_of(Scene(structure))
    assert list(model.jnt_type) == [SLIDE] * 5
    normal = np.array(OBLIQUE) / np.linalg.norm(OBLIQUE)
    assert np.max(np.abs(model.jnt_axis[3:] @ normal)) <= 4 * EPS


@pytest.mark.parametrize("scene", SCENES)
def test_degrees_of_freedom_of_random_scenes(scene: Scene) -> None:
    model = model_of(scene)
    bases = [
        rod.support.translation_basis.shape[1] + rod.support.rotation_basis.shape[1] - 1 for rod in scene.structure.rods
    ]
    useful = sum(bases) + sum(point.translation_basis.shape[1] for point in scene.structure.point_masses)
    spins = sum(rod.support.plane is None for rod in scene.structure.rods)
    assert model.nv == useful + spins
    singular = np.linalg.svd(node_jacobian(model, scene), compute_uv=False)
    assert np.sum(singular > 1e-6) == useful


@pytest.mark.parametrize("scene", SCENES)
def test_masses_and_inertia_are_those_of_thin_rods(scene: Scene) -> None:
    structure, model = scene.structure, model_of(scene)
    for rod, length in zip(structure.rods, structure.rod_lengths, strict=True):
        body = model.body(rod.name)
        transverse = rod.mass * float(length) ** 2 / 12
        assert body.mass[0] == rod.mass
        assert body.inertia.tolist() == [transverse, transverse, 1e-5 * transverse]
        assert body.ipos.tolist() == [0, 0, (0.5 - rod.support.sigma) * length]
        assert body.iquat.tolist() == [1, 0, 0, 0]
    for point in structure.point_masses:
        assert model.body(point.node).mass[0] == point.mass
    # And so the kinetic energy is the thesis' (2.25), which knows nothing of frames and inertia matrices.
    data = mujoco.MjData(model)
    data.qvel[:] = initial_velocities(scene)
    mujoco.mj_forward(model, data)
    matrix = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, matrix)
    energy = rods.kinetic_energy(structure, scene.velocities0)
    # Some tens of roundings of positive terms; terms of f v ω, of either sign, are not above their sum.
    assert abs(0.5 * data.qvel @ matrix @ data.qvel - energy) <= 100 * EPS * energy


@pytest.mark.parametrize("scene", SCENES)
def test_the_start_is_that_of_the_scene(scene: Scene) -> None:
    run = tmj.simulate(scene, None, tmj.MuJoCo(1e-6), duration=1e-6)
    # A place is r plus a rotation matrix, made from a quaternion, times a length: about ten roundings of numbers not
    # above the distance from the origin and the length. A velocity is one more product of that kind.
    size = np.abs(scene.nodes0).max() + scene.structure.rod_lengths.max(initial=0.0)
    assert np.max(np.abs(run.nodes[0] - scene.nodes0)) <= 10 * EPS * size
    speed = np.linalg.norm(scene.velocities0, axis=1).max()
    assert speed > 0.1
    assert np.max(np.abs(run.velocities[0] - scene.velocities0)) <= 20 * EPS * speed


@pytest.mark.parametrize("scene", SCENES)
def test_rods_start_without_spin(scene: Scene) -> None:
    model, qvel = model_of(scene), initial_velocities(scene)
    for rod in scene.structure.rods:
        if rod.support.plane is None:
            joint = model.joint(rod.name)
            last = joint.dofadr[0] + (5 if joint.type[0] == FREE else 2)  # about the body's z axis, the rod's
            assert abs(qvel[last]) <= 10 * EPS * np.linalg.norm(qvel)


@pytest.mark.parametrize("scene", SCENES)
def test_nothing_but_what_the_scene_uses(scene: Scene) -> None:
    structure, model = scene.structure, model_of(scene)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert (data.nefc, data.ncon) == (0, 0)
    counts = (
        "nsensor",
        "neq",
        "npair",
        "nexclude",
        "nmesh",
        "nhfield",
        "ntex",
        "nmat",
        "ncam",
        "na",
        "nmocap",
        "nuserdata",
    )
    assert {name: getattr(model, name) for name in counts} == dict.fromkeys(counts, 0)
    assert model.nbody == 1 + len(structure.rods) + len(structure.point_masses)
    assert model.ntendon == model.nu == len(structure.strings)
    assert model.nsite == len(structure.nodes)
    assert not model.geom_contype.any()
    assert not model.geom_conaffinity.any()
    for name in (
        "dof_damping",
        "dof_armature",
        "dof_frictionloss",
        "jnt_stiffness",
        "tendon_stiffness",
        "tendon_damping",
    ):
        assert not getattr(model, name).any()
    assert tuple(model.opt.gravity) == scene.gravity


@pytest.mark.parametrize("scene", SCENES)
def test_numbers_are_exact_and_a_file_reloads_to_the_same_model(scene: Scene, tmp_path: Path) -> None:
    structure, model = scene.structure, model_of(scene)
    np.testing.assert_array_equal(model.actuator_gainprm[:, 0], structure.stiffness)
    np.testing.assert_array_equal(model.actuator_biasprm[:, 0], structure.stiffness * structure.rest_lengths)
    np.testing.assert_array_equal(model.actuator_biasprm[:, 1], -structure.stiffness)
    np.testing.assert_array_equal(model.actuator_biasprm[:, 2], -structure.damping)
    np.testing.assert_array_equal(model.key("start").qvel, initial_velocities(scene))
    path = save_mjcf(scene, tmp_path / "scene.xml", timestep=2e-3)
    assert path.read_text(encoding="utf-8") == scene_to_mjcf(scene, 2e-3)
    again = mujoco.MjModel.from_xml_path(str(path))
    compared = 0
    for name in dir(model):
        value = getattr(model, name)
        if isinstance(value, (np.ndarray, int, bytes)) and not name.startswith("_"):
            assert np.array_equal(value, getattr(again, name)), name
            compared += 1
    assert compared > 300


@pytest.fixture
def warned(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[str]:
    """What MuJoCo warns of during the test; its log file would land in the current folder."""
    monkeypatch.chdir(tmp_path)
    texts: list[str] = []
    mujoco.set_mju_user_warning(texts.append)
    yield texts
    mujoco.set_mju_user_warning(None)


def test_models_compile_without_warnings(warned: list[str]) -> None:
    for scene in [*SCENES, *(one_rod(support) for support, _, _ in SUPPORTS.values())]:
        model_of(scene)
    assert warned == []
    # The fixture would have seen one.
    mujoco.MjModel.from_xml_string('<mujoco><compiler settotalmass="1"/><worldbody/></mujoco>')
    assert len(warned) == 1


def test_without_control_the_prism_stands_still() -> None:
    scene = tmj.load_scene("prism")
    model = model_of(scene)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert not data.ctrl.any()
    tensions = np.array([string.force_density or 0.0 for string in scene.structure.strings])
    tensions *= scene.structure.string_lengths(scene.structure.positions)
    # Lengths below 1.1 m carry some four roundings, which k = 2 N/m makes forces of 1e-15 N.
    np.testing.assert_allclose(-data.actuator_force, tensions, rtol=0, atol=2 * 1.1 * 4 * EPS)
    # Four strings at a node and a rod's two nodes: eight such forces, with levers of at most 1 m.
    assert np.max(np.abs(data.qfrc_actuator)) <= 8 * 2 * 1.1 * 4 * EPS
    for _ in range(500):
        mujoco.mj_step(model, data)
    # Those forces would move a rod (J >= 1/12 kg m² at its centre) by ½ 2e-14 · 12 t² in t = 1 s.
    mujoco.mj_kinematics(model, data)
    for name, position in scene.structure.nodes.items():
        assert np.linalg.norm(data.site(name).xpos - position) <= 2e-13


def test_the_integrator_and_the_step_are_those_requested() -> None:
    for integrator in tmj.Integrator:
        model = tmj.MuJoCo(0.0123, integrator).model(one_rod())
        assert model.opt.timestep == 0.0123
        assert model.opt.integrator == getattr(mujoco.mjtIntegrator, f"mjINT_{integrator.name}")
        assert model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_AUTORESET


# Names ---------------------------------------------------------------------------------------------------

STRANGE = ["a b", " a ", "<&>\"'", "été", "漢字", "🜁", "--", "a/b", "world", "1e5", "x" * 3000, "]]>", "&amp;", "%s %n"]


@pytest.mark.parametrize("name", STRANGE)
def test_any_printable_name_will_do(name: str) -> None:
    structure = Structure(
        name,
        {name: (0.0, 0.0, 0.0), "b": (1.0, 0.0, 0.0), f"{name}{name}": (0.0, 2.0, 0.0)},
        rods=(Rod(name, (name, "b"), 1.0, support=Support.free(0.2)),),
        strings=(String(name, ("b", f"{name}{name}"), 5.0, rest_length=2.0),),
        fixed_nodes=(f"{name}{name}",),
    )
    scene = Scene(structure)
    model = model_of(scene)
    for found in (
        model.site(name),
        model.site(f"{name}{name}"),
        model.tendon(name),
        model.actuator(name),
        model.joint(name),
    ):
        assert found.id >= 0
    run = tmj.simulate(scene, None, tmj.MuJoCo(1e-2), duration=0.1)
    reference = tmj.simulate(scene, None, tmj.DAE(), duration=0.1)
    # RK4's local error (ω h)⁵ / 120 of the string's vibration, ω² = k / J = 15 / s² and half a metre, in ten steps.
    error = 10 * 0.5 * (math.sqrt(15) * 1e-2) ** 5 / 120
    assert tmj.compare(run, reference).max_node_error < error
    # λ changes with positions as accelerations do, by k / J, and with velocities by less.
    assert np.abs(run.multipliers - reference.multipliers).max() < 2 * 15 * error


def test_names_shared_by_all_kinds() -> None:
    # A rod, a string, a node and a fixed node may share a name; a rod also with a point mass' node, and with the
    # names that slides get.
    structure = Structure(
        "same",
        {
            "m": (0.0, 0.0, 0.0),
            "r": (1.0, 0.0, 0.0),
            "p": (0.0, 1.0, 0.0),
            "q": (0.0, 1.0, 1.0),
            "r 1": (2.0, 1.0, 1.0),
            "s": (2.0, 1.0, 2.0),
            "world": (3.0, 3.0, 3.0),
            "m (2)": (4.0, 3.0, 3.0),
        },
        rods=(
            Rod("r", ("m", "p"), 1.0, support=Support.constrained([0, 0, 1])),
            Rod("r 1", ("q", "r 1"), 2.0, support=Support.pinned()),
        ),
        strings=(
            String("r", ("p", "q"), 10.0, force_density=1.0),
            String("r 1", ("r", "r 1"), 10.0, force_density=1.0),
            String("world", ("world", "s"), 10.0, force_density=1.0),
        ),
        point_masses=(PointMass("r", 1.0), PointMass("s", 1.0), PointMass("world", 1.0), PointMass("m (2)", 1.0)),
    )
    scene = Scene(structure)
    plain = Structure(
        "plain",
        {f"n{i}": position for i, position in enumerate(structure.nodes.values())},
        rods=tuple(
            Rod(f"rod{i}", tuple(f"n{structure.node_index[n]}" for n in rod.nodes), rod.mass, support=rod.support)
            for i, rod in enumerate(structure.rods)
        ),
        strings=tuple(
            String(f"s{i}", tuple(f"n{structure.node_index[n]}" for n in s.nodes), 10.0, force_density=1.0)
            for i, s in enumerate(structure.strings)
        ),
        point_masses=tuple(PointMass(f"n{structure.node_index[p.node]}", p.mass) for p in structure.point_masses),
    )
    run = tmj.simulate(scene, None, tmj.MuJoCo(1e-2), duration=0.5)
    same = tmj.simulate(Scene(plain), None, tmj.MuJoCo(1e-2), duration=0.5)
    np.testing.assert_array_equal(run.nodes, same.nodes)
    np.testing.assert_array_equal(run.multipliers, same.multipliers)


def test_a_rod_named_as_the_node_of_a_point_mass() -> None:
    rod = Rod("c", ("a", "b"), 1.0, support=Support.pinned())
    nodes = {"a": (0.0, 0.0, 0.0), "b": (1.0, 0.0, 0.0), "c": (0.0, 1.0, 0.0), "d": (0.0, 2.0, 0.0)}
    points = (PointMass("c", 1.0), PointMass("d", 3.0))
    model = model_of(Scene(Structure("x", nodes, rods=(rod,), point_masses=points)))
    assert model.body("c").mass[0] == 1.0
    assert model.nbody == 4
    assert model.body_mass[model.site_bodyid[model.site("d").id]] == 3.0


def test_the_name_of_a_scene_may_be_any_text() -> None:
    scene = one_rod().with_(name="line 1\nline 2\t\x00\x07 <&> --> 漢")
    assert model_of(scene).nv == 6
    assert "漢" in scene_to_mjcf(scene)


# What MuJoCo cannot hold ---------------------------------------------------------------------------------


def test_a_mass_that_mujoco_cannot_hold_is_refused_by_name() -> None:
    structure = Structure("mote", {"p": (0.0, 0.0, 0.0)}, point_masses=(PointMass("p", 1e-16),))
    with pytest.raises(StructureError, match=r"structure 'mote': MuJoCo cannot hold it .*'p'.*above 1e-15"):
        tmj.simulate(Scene(structure), None, tmj.MuJoCo())


def test_a_place_that_mujoco_takes_for_a_divergence_is_refused() -> None:
    structure = Structure("far", {"p": (0.0, 0.0, 1e11)}, point_masses=(PointMass("p", 1.0),))
    with pytest.raises(StructureError, match=r"node 'p' is at \[0.0, 0.0, 100000000000.0\] m.*beyond 1e\+10 m"):
        tmj.simulate(Scene(structure), None, tmj.MuJoCo())


# Files ---------------------------------------------------------------------------------------------------


def test_files_are_written_whole_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = save_mjcf(one_rod(), tmp_path / "a.xml")
    before = path.read_text(encoding="utf-8")

    def fail(*_: object, **__: object) -> None:
        raise OSError("disk full")

    monkeypatch.setattr(Path, "write_text", fail)
    with pytest.raises(FormatError, match="disk full"):
        save_mjcf(one_rod(Support.pinned()), path)
    assert path.read_text(encoding="utf-8") == before
    assert [file.name for file in tmp_path.iterdir()] == ["a.xml"]
    with pytest.raises(OptionError, match=r"must end in \.xml"):
        save_mjcf(one_rod(), tmp_path / "a.txt")
    with pytest.raises(OptionError, match="there is no folder"):
        save_mjcf(one_rod(), tmp_path / "none" / "a.xml")


def test_the_file_says_what_is_not_in_it() -> None:
    still = one_rod()
    assert "keyframe" not in scene_to_mjcf(still)
    assert "loads" not in scene_to_mjcf(still)
    loaded = still.with_(loads=(Load("a", (1.0, 0.0, 0.0)),))
    assert "external loads are not in this file" in scene_to_mjcf(loaded)
    moving = still.with_(initial_velocities=np.array([[0.0, 1.0, 0.0], [0.0, 2.0, 0.0]]))
    assert 'velocities of the keyframe "start"' in scene_to_mjcf(moving)
