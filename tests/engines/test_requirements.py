"""A scene's model holds what the scene requires and nothing else; what more would add is really more."""

from __future__ import annotations

import json
import re
from pathlib import Path

import mujoco
import numpy as np
import pytest

import tensegrity_mj as tmj
from evidence.random_structures import random_scene, random_structure
from tensegrity_mj.cli import main
from tensegrity_mj.engines.mujoco.mjcf import scene_to_mjcf
from tensegrity_mj.engines.mujoco.needs import (
    JOINTS,
    MOST_HANGING,
    degrees_of_freedom,
    engine_for_size,
    largest_tree,
)
from tensegrity_mj.model.elements.contact import Contact
from tensegrity_mj.model.text.sources import scene_names

OFF = ("constraint off", "contact off", "autoreset off")
LOOPS = ("contact off", "autoreset off", "diagexact on")
# Scene: degrees of freedom, nv, nq, (free, ball, slide, hinge), strings, pairs that may touch, flags. By hand:
# pinned rod: two angles and the spin. Prism: 3 · 5 - 6 and three spins; its rods slide in 0, 2 and 1 directions. Cross:
# two angles and a slide. Planar beam: 40 rods of 3, less 2 + 1 of two supports. T-bar: two angles. Falling prism: 3 · 5
# and three spins, each of three rods with the floor; six-bar robots likewise. Derrick: an angle and two slides of its
# load. Towers: 5 and a spin for each of 45 or 87 free rods, 2 if pinned. Moored chain: 2 and a spin for each of 13
# rods. Net: three slides for each of 12 knots. Spine: three free bodies.
EXPECTED = {
    "pinned_rod": (2, 3, 4, (0, 1, 0, 0), 3, 0, OFF),
    "pinned_rod_mirror": (2, 3, 4, (0, 1, 0, 0), 3, 0, OFF),
    "prism": (9, 12, 15, (0, 3, 3, 0), 12, 0, OFF),
    "shape_control": (9, 12, 15, (0, 3, 3, 0), 12, 0, OFF),
    "cross": (3, 3, 3, (0, 0, 1, 2), 4, 0, OFF),
    "planar_beam": (117, 117, 117, (0, 0, 77, 40), 196, 0, OFF),
    "tbar": (2, 2, 2, (0, 0, 0, 2), 4, 0, OFF),
    "prism_drop": (15, 18, 21, (3, 0, 0, 0), 12, 3, ("autoreset off", "diagexact on")),
    # A rod of a chain has a ball joint, or a hinge in the plane, and a slide drives a support that moves.
    "cable": (26, 40, 53, (0, 13, 1, 0), 0, 0, OFF),
    "suspended_cable": (41, 67, 89, (0, 22, 1, 0), 0, 0, LOOPS),
    "net": (23, 120, 160, (0, 40, 0, 0), 0, 0, LOOPS),
    "truss_arm": (3, 14, 14, (0, 0, 0, 14), 6, 0, LOOPS),
    "dbar": (2, 4, 4, (0, 0, 0, 4), 2, 0, LOOPS),
    "pulley": (3, 3, 3, (0, 0, 2, 1), 2, 0, OFF),
    "spine": (18, 18, 21, (3, 0, 0, 0), 24, 0, OFF),
    "tower": (225, 270, 315, (45, 0, 0, 0), 219, 0, OFF),
    "tower_waves": (225, 270, 315, (45, 0, 0, 0), 219, 0, OFF),
    "moored_chain": (26, 39, 52, (0, 13, 0, 0), 0, 0, OFF),
    "fish_net": (36, 36, 36, (0, 0, 36, 0), 28, 0, OFF),
    # A boom that turns and a load in a plane; a foot that slides, turned by the wall; 20 points and a post that shakes.
    "arrester": (3, 3, 3, (0, 0, 2, 1), 3, 0, OFF),
    "ladder": (1, 2, 2, (0, 0, 1, 1), 1, 0, OFF),
    "massive_string": (60, 61, 61, (0, 0, 61, 0), 21, 0, OFF),
    "tower_beam": (441, 531, 621, (87, 3, 0, 0), 444, 0, OFF),
    **dict.fromkeys(
        ("six_bar_drop", "six_bar_push", "six_bar_roll"),
        (30, 36, 42, (6, 0, 0, 0), 24, 6, ("autoreset off", "diagexact on")),
    ),
}
# Joints that a forest of R rods leaves open. N nodes join 2 R ends by 2 R - N joints, and a rod hangs by one of them
# unless it is held: R - N + held ones, 22 - 23 + 2, 40 - 25 + 4, 14 - 10 + 2 and 4 - 4 + 1, of three rows each.
CLOSURES = {"suspended_cable": 1, "net": 19, "truss_arm": 6, "dbar": 1}


def test_every_shipped_scene_is_in_the_table() -> None:
    assert sorted(EXPECTED) == scene_names()


@pytest.mark.parametrize("name", EXPECTED)
def test_shipped_scenes_hold_the_least(name: str) -> None:
    needs = tmj.studies.requirements(tmj.load_scene(name))
    dof, nv, nq, joints, strings, pairs, flags = EXPECTED[name]
    assert (needs.degrees_of_freedom, needs.velocities, needs.positions) == (dof, nv, nq)
    assert needs.joints == dict(zip(JOINTS, joints, strict=True))
    open_joints = CLOSURES.get(name, 0)
    assert (needs.tendons, needs.actuators, needs.sensors, needs.equalities) == (strings, strings, 0, open_joints)
    assert (needs.contact_pairs, needs.constraint_rows) == (pairs, 3 * open_joints)
    scene = tmj.load_scene(name)
    assert set(needs.flags) == set(flags) | ({"gravity off"} if not any(scene.gravity) else set())
    text = " ".join(needs.reasons)
    assert ("floor" in text) is (pairs > 0)
    assert ("control law" in text) is (scene.control is not None)
    assert ("gravity" in text) is any(scene.gravity)
    spins = joints[0] + joints[1] - len(scene.structure.moving_frames)  # whose spin is a motion of nodes
    assert ("spin of" in text) is (spins > 0)
    assert (f"spin of {spins} rod" in text) is (spins > 0)
    if name not in CLOSURES and not scene.motions:
        assert nv == dof + spins + len(scene.structure.constraints)  # which MuJoCo has no rows for
    assert "discrete" not in text


@pytest.mark.parametrize("seed", range(12))
def test_random_scenes_hold_the_least(seed: int) -> None:
    """By counting supports: a rod in space has 3 - rows translations and 2 turns, one in a plane 1, masses 3 or 2."""
    rng = np.random.default_rng(seed)
    planar = seed % 3 == 0
    structure = random_structure(
        rng, rods=1 + seed % 4, planar=planar, own_planes=0.3, point_masses=seed % 3, damping=(0.0, 1.0)
    )
    scene = random_scene(rng, structure, moving=True, gravity=bool(seed % 2), loads=seed % 2)
    dof = spins = 0
    for rod in structure.rods:
        support = rod.support
        held = np.array(support.directions, float).reshape(-1, 3)
        if support.plane is not None:
            held = np.vstack([held, support.plane])  # a planar rod stays at its height
        dof += 3 - int(np.linalg.matrix_rank(held)) if len(held) else 3
        dof += 2 if support.plane is None else 1
        spins += support.plane is None
    dof += sum(3 if mass.plane is None else 2 for mass in structure.point_masses)
    needs = tmj.studies.requirements(scene)
    assert (needs.degrees_of_freedom, needs.velocities) == (dof, dof + spins)
    assert degrees_of_freedom(scene) == dof
    balls, frees = needs.joints["ball"], needs.joints["free"]
    assert balls + frees == spins
    assert needs.positions == needs.velocities + spins
    assert needs.joints["hinge"] == len(structure.rods) - spins
    assert needs.bodies == len(structure.rods) + len(structure.point_masses)
    assert (needs.tendons, needs.actuators) == (len(structure.strings),) * 2
    assert (needs.sensors, needs.equalities, needs.contact_pairs, needs.constraint_rows) == (0, 0, 0, 0)
    assert set(needs.flags) == {*OFF, *(() if any(scene.gravity) else ("gravity off",))}


def test_contact_brings_what_it_requires_alone() -> None:
    scene = tmj.load_scene("prism_drop")
    floor = tmj.studies.requirements(scene)
    assert floor.rows_per_contact == 3
    both = tmj.studies.requirements(scene.with_(contact=Contact(floor=0.0, rods=True, friction=0.0)))
    assert (both.contact_pairs, both.rows_per_contact) == (6, 1)
    assert any("rods may touch" in reason for reason in both.reasons)
    none = tmj.studies.requirements(scene.with_(contact=None))
    assert (none.contact_pairs, none.rows_per_contact, none.flags) == (0, 0, OFF)
    assert none.velocities == floor.velocities
    # Three feet on the floor: three rows each, and none before.
    model = mujoco.MjModel.from_xml_string(scene_to_mjcf(scene, 5e-4))
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 400)
    assert data.nefc == 0
    mujoco.mj_step(model, data, 3600)
    mujoco.mj_forward(model, data)
    assert (data.ncon, data.nefc) == (3, 9)


def test_stiff_strings_are_a_reason_for_discrete() -> None:
    """Strings of 1e12 N/m on rods of 20 kg: ω is some (3 k / m)^½ = 4e5 /s, and RK4's limit 2.8 / ω = 7e-6 s."""
    scene = tmj.load_scene("tbar")
    strings = tuple(tmj.String(s.name, s.nodes, 1e12, rest_length=s.rest_length) for s in scene.structure.strings)
    structure = tmj.Structure("stiff", dict(scene.structure.nodes), scene.structure.rods, strings)
    needs = tmj.studies.requirements(tmj.Scene(structure))
    assert 2e-6 < needs.stable_step < 2e-5
    assert any("discrete" in reason for reason in needs.reasons)


def test_the_command_prints_it(capsys: pytest.CaptureFixture[str]) -> None:
    answers = []
    for _ in range(2):
        assert main(["scenes", "prism_drop", "--json"]) == 0
        answers.append(json.loads(capsys.readouterr().out))
    assert answers[0] == answers[1]
    assert answers[0]["needs"]["velocities"] == answers[0]["mujoco_velocities"] == 18
    assert answers[0]["needs"]["contact_pairs"] == 3
    assert answers[0]["contact"]["floor"] == 0.0
    assert main(["scenes", "prism_drop"]) == 0
    text = capsys.readouterr().out
    for part in ("nv = 18", "3 pairs may touch", "the scene has a floor"):
        assert part in text


def test_what_is_no_scene_is_refused() -> None:
    with pytest.raises(tmj.errors.OptionError, match="use a Scene"):
        tmj.studies.requirements("prism")  # type: ignore[arg-type]


def test_the_engine_that_a_structures_size_calls_for() -> None:
    # A cable of n rods is a chain. Of the net's 40 rods four are held, so that none of its trees has them all.
    assert largest_tree(tmj.load_scene("cable(elements=13)").structure) == 13
    assert largest_tree(tmj.load_scene("prism").structure) == 1
    assert 10 <= largest_tree(tmj.load_scene("net").structure) < 40
    short, long = (tmj.load_scene(f"cable(elements={n})") for n in (MOST_HANGING, MOST_HANGING + 1))
    assert engine_for_size(short).startswith("MuJoCo or the DAE")
    assert engine_for_size(long).startswith(f"the DAE: {MOST_HANGING + 1} rods hang on each other")
    assert engine_for_size(tmj.load_scene("prism_drop")).startswith("MuJoCo: it alone")
    assert tmj.studies.requirements(short).engine == engine_for_size(short)


def looped_bars() -> tmj.Scene:
    """A pinned elastic rod, and a triangle at its end of two elastic rods and a rigid one, with a string to the ground.

    MuJoCo has elastic rods of class 1 alone.
    """
    nodes = {"a": (0, 0, 1), "b": (1, 0, 1), "c": (2, 0, 1.3), "d": (1, 0, 2.3), "f": (1, 0, 0)}
    rods = (
        tmj.Rod("r1", ("a", "b"), 1.0, support=tmj.Support.pinned(0.0), stiffness=1e4),
        tmj.Rod("r2", ("b", "c"), 1.0, stiffness=1e4),
        tmj.Rod("r3", ("c", "d"), 1.0, stiffness=1e4),
        tmj.Rod("r4", ("d", "b"), 1.0),
    )
    strings = (tmj.String("s", ("c", "f"), 100.0, tension=3.0),)
    return tmj.Scene(tmj.Structure("bars", nodes, rods, strings, fixed_nodes=("f",)), gravity=(0.0, 0.0, -9.81))


def test_what_mujoco_refuses_has_its_requirements_all_the_same(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = looped_bars()
    needs = tmj.studies.requirements(scene)
    # Nodes b, c and d move, and the rigid rod keeps two of them apart: 9 - 1.
    assert needs.degrees_of_freedom == 8
    assert (needs.positions, needs.velocities, needs.constraint_rows) == (None, None, None)
    assert (needs.joints, needs.reasons, needs.flags) == ({}, (), ())
    assert needs.engine.startswith("the DAE: MuJoCo refuses it: rod 'r1' is elastic, and rods 'r1' and 'r2' share node")
    assert needs.stable_step == tmj.stable_step(scene, tmj.DAE(method=tmj.Method.RK4, timestep=1e-3)).limit
    path = tmp_path / "bars.toml"
    tmj.save_scene(scene, path)
    assert main(["scenes", str(path)]) == 0
    text = capsys.readouterr().out
    assert re.search("degrees of freedom +8\n", text)
    assert "the DAE: MuJoCo refuses it: rod 'r1' is elastic" in text
    assert "nv =" not in text
    assert tmj.simulate(scene, None, tmj.DAE(), duration=0.1).status is tmj.Status.COMPLETED


def test_reasons_of_strings_with_mass_and_of_constraints() -> None:
    needs = tmj.studies.requirements(tmj.load_scene("massive_string"))
    # A chain of points, and the motion's slide; 3 slides a point.
    assert "slides for each of the 20 point masses that strings with mass consist of" in needs.reasons
    assert needs.joints["slide"] == 3 * 20 + 1
    ladder = tmj.load_scene("ladder")
    taking = "the integrator `euler` or `rk4`: the others refuse the scene"
    assert taking in tmj.studies.requirements(ladder).reasons
    assert not any("the others refuse" in reason for reason in needs.reasons)
    # Where steps are short, `discrete` is no advice: it refuses the scene.
    stiff = ladder.with_(structure=ladder.structure.with_strings(stiffness=1e12, tension=1.0))
    reasons = tmj.studies.requirements(stiff).reasons
    assert tmj.studies.requirements(stiff).stable_step < 1e-4
    assert not any("discrete" in reason for reason in reasons)


def test_what_no_engine_simulates_is_refused_with_the_reason() -> None:
    scene = looped_bars().with_(contact=Contact(floor=-5.0))
    with pytest.raises(tmj.errors.TensegrityError, match="no engine simulates it"):
        tmj.studies.requirements(scene)
