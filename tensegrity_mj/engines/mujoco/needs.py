"""Size of a scene's MuJoCo model, and the reason for each part of it.

    needs = tmj.studies.requirements(scene)
    needs.velocities, needs.joints, needs.contact_pairs, needs.reasons

A thin rod has no spin about its own axis. MuJoCo has no joint that leaves it out, so that each rod that turns in space
has one velocity more there than it has degrees of freedom. Each direction in which a motion drives a support is a
velocity more, too: the support's place is a joint that nothing but the motion moves.

Rods that share nodes hang on each other as a tree, which needs no constraint. Where they close a loop, or hold each
other between two supports, MuJoCo has three rows of constraints a joint.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

import mujoco
import numpy as np

from tensegrity_mj.basics.checks import instance
from tensegrity_mj.engines.mujoco.settings import Integrator, MuJoCo
from tensegrity_mj.engines.requirements import engines_for, require
from tensegrity_mj.engines.table import ENGINES, engine_of
from tensegrity_mj.model.capabilities import refusal
from tensegrity_mj.model.forest import spanning_forest
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.vibration.bodies import Bodies
from tensegrity_mj.vibration.stable_step import stable_step
from tensegrity_mj.vibration.state import State

EXPLICIT_STEP = 1e-4  # s: where RK4's largest stable step is below it, a run of seconds takes minutes
MOST_HANGING = 30  # rods that hang on each other, beyond which a step of the DAE takes less than half of MuJoCo's
MOST_RODS = 1000  # beyond which MuJoCo takes seconds to compile the model
JOINTS = ("free", "ball", "slide", "hinge")  # in the order of MuJoCo's mjtJoint


@dataclass(frozen=True, kw_only=True)
class Requirements:
    """Size of the model of a scene; MuJoCo's numbers are None, or empty, where MuJoCo refuses the scene.

    Attributes:
        scene: its name.
        degrees_of_freedom: independent velocities at the start, of thin rods, bodies and point masses.
        positions, velocities: MuJoCo's nq and nv.
        joints: how many of each kind.
        bodies, tendons, actuators, sensors, equalities: how many; the world is no body here.
        contact_pairs: pairs of geoms that may touch.
        constraint_rows: rows that MuJoCo's solver has at the start; contacts add theirs as they touch.
        rows_per_contact: rows that each contact adds (0 where nothing may touch).
        flags: what is switched off or on of what MuJoCo does by default.
        stable_step: RK4's largest stable step at the start by the linear model [s], ∞ for none; the DAE's without
            MuJoCo.
        hanging: rods of the largest tree of rods that hang on each other; 1 where none share nodes, 0 without rods.
        engine: which engine the structure's size calls for, in words.
        reasons: why each thing beyond the least is there.
    """

    scene: str
    degrees_of_freedom: int
    positions: int | None = None
    velocities: int | None = None
    joints: dict[str, int] = field(default_factory=dict)
    bodies: int | None = None
    tendons: int | None = None
    actuators: int | None = None
    sensors: int | None = None
    equalities: int | None = None
    contact_pairs: int | None = None
    constraint_rows: int | None = None
    rows_per_contact: int | None = None
    flags: tuple[str, ...] = ()
    stable_step: float
    hanging: int
    engine: str
    reasons: tuple[str, ...]

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        return asdict(self)


def requirements(scene: Scene) -> Requirements:
    """Count what MuJoCo's model of a scene holds.

    Raises:
        OptionError: if it is no Scene.
        SceneError, StructureError: for what no engine simulates.
    """
    instance("scene", scene, Scene, "use a Scene, or load_scene(name or path)")
    if not (able := engines_for(scene)):
        require(MuJoCo(), scene)
    in_mujoco = "mujoco" in able
    engine = MuJoCo() if in_mujoco else engine_of(able[0], 1.0)
    limit = float(stable_step(scene.with_(contact=None), engine, law=None).limit)
    return Requirements(
        scene=scene.name,
        degrees_of_freedom=degrees_of_freedom(scene),
        **(_counts(scene) if in_mujoco else {}),
        stable_step=limit,
        hanging=largest_tree(scene.structure),
        engine=engine_for_size(scene),
        reasons=tuple(_reasons(scene, limit)) if in_mujoco else (),
    )


def _counts(scene: Scene) -> dict[str, Any]:
    """Count what MuJoCo's model of a scene holds."""
    model = MuJoCo().model(scene)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return {
        "positions": int(model.nq),
        "velocities": int(model.nv),
        "joints": {name: int(np.sum(model.jnt_type == kind)) for kind, name in enumerate(JOINTS)},
        "bodies": int(model.nbody) - 1,
        "tendons": int(model.ntendon),
        "actuators": int(model.nu),
        "sensors": int(model.nsensor),
        "equalities": int(model.neq),
        "contact_pairs": _contact_pairs(model),
        "constraint_rows": int(data.nefc),
        "rows_per_contact": 0 if scene.contact is None else int(model.geom_condim[model.geom_conaffinity > 0].max()),
        "flags": _flags(model),
    }


def degrees_of_freedom(scene: Scene) -> int:
    """Number of independent velocities at the start; the spin of a thin rod about its axis, which has no inertia, is
    none.
    """
    structure = scene.structure
    apart = sum(
        rod.support.translation_basis.shape[1] + rod.support.rotation_basis.shape[1] - (rod.stiffness is None)
        for rod in structure.rods
    )
    apart += sum(point.translation_basis.shape[1] for point in structure.lone_masses)
    joints = State(scene, Bodies.of(structure), scene.nodes0, scene.velocities0, 0.0).joints
    return int(apart + 6 * len(structure.moving_frames) - (0 if joints is None else joints.rank))


def largest_tree(structure: Structure) -> int:
    """Rods of the largest tree of rods that hang on each other; 1 where none share nodes."""
    forest = spanning_forest(structure)
    size = np.ones(len(structure.rods), int)
    for rod in forest.order[::-1]:
        if forest.parent[rod] >= 0:
            size[forest.parent[rod]] += size[rod]
    return int(size.max(initial=0))


def engine_for_size(scene: Scene) -> str:
    """Recommend an engine for the size of a scene's structure (evidence/docs/speed.md, "Large structures")."""
    hanging, rods = largest_tree(scene.structure), len(scene.structure.rods)
    if (refused := refusal(MuJoCo(), scene)) and (able := engines_for(scene)):
        others, (limit, found, _) = " or the ".join(ENGINES[name].title for name in able), refused
        return f"the {others}: MuJoCo refuses it: {found}: {limit.reason}"
    if scene.contact is not None:
        return "MuJoCo: it alone has contact"
    if hanging > MOST_HANGING:
        return (
            f"the DAE: {hanging} rods hang on each other; a step of MuJoCo takes a time that grows with about the cube "
            "of their number, and one of the DAE in proportion to it"
        )
    if rods > MOST_RODS:
        return f"the DAE: MuJoCo's time to set up {rods} rods grows with the square of their number"
    return "MuJoCo or the DAE: their steps take about the same time at this size"


def _contact_pairs(model: Any) -> int:
    """Pairs of geoms of different bodies whose bits let them touch, excluded ones left out; the world's never do."""
    types, affinities, bodies = model.geom_contype, model.geom_conaffinity, model.geom_bodyid
    meet = (types[:, None] & affinities) | (affinities[:, None] & types)
    return int(np.sum(np.triu(meet.astype(bool) & (bodies[:, None] != bodies), 1))) - int(model.nexclude)


def _flags(model: Any) -> tuple[str, ...]:
    names = []
    for kinds, bits, word in (
        (mujoco.mjtDisableBit, model.opt.disableflags, "off"),
        (mujoco.mjtEnableBit, model.opt.enableflags, "on"),
    ):
        for kind, bit in kinds.__members__.items():
            if not kind.startswith("mjN") and bits & bit.value:
                names.append(f"{kind.partition('_')[2].lower()} {word}")
    return tuple(names)


def _reasons(scene: Scene, limit: float) -> list[str]:
    structure, contact = scene.structure, scene.contact
    spinning = sum(rod.support.plane is None and rod.stiffness is None for rod in structure.rods)
    found = []
    if spinning:
        found.append(
            f"spin of {spinning} rod{'s' if spinning > 1 else ''}: one that turns in space has a ball or free joint, "
            "which also spins it about its own axis"
        )
    if elastic := int(structure.elastic.sum()):
        found.append(f"two bodies and up to four tendons for each elastic rod, of which there are {elastic}")
    if points := sum(len(rope.points) for rope in structure.ropes):
        found.append(f"slides for each of the {points} point masses that strings with mass consist of")
    closures = spanning_forest(structure).closures
    if closures:
        found.append(
            f"constraint rows: {len(closures)} joint{'s' if len(closures) > 1 else ''} "
            f"({_listed({structure.node_names[node] for node, _, _ in closures})}) close loops, or join rods that have "
            "supports of their own"
        )
        found.append("exact diagonal of the constraints' inertia: so that gaps close as they should")
    if scene.motions:
        moved = _listed({motion.support for motion in scene.motions})
        found.append(f"slides of enormous armature and a callback that drives them: {moved} move")
    if any(scene.gravity):
        found.append("gravity: the scene has it")
    if contact is not None:
        if contact.floor is not None:
            found.append("contact and constraint rows: the scene has a floor")
        if contact.rods:
            found.append("contact and constraint rows: the scene's rods may touch each other")
        found.append("exact diagonal of the constraints' inertia: so that each contact obeys the stated law")
    water = "water, which finds each rod's acceleration with its added mass" if scene.adding_mass else "forces of water"
    callbacks = (
        (np.any(structure.damping > 0), "the string law: the damper of a slack string must not act"),
        (any(len(one.curve) > 1 for one in structure.strings), "tension curves: controls that make up for them"),
        (scene.loads, "external forces: the scene has loads"),
        (
            scene.resistance or any(point.damping for point in structure.point_masses),
            "what resists motion: the scene has resistance, or dampers on nodes",
        ),
        (scene.water, f"{water}: the scene has water"),
        (structure.constraints, "linear constraints on nodes: MuJoCo has none, and their forces are found there"),
        (scene.breaks, "breaking strings"),
    )
    found += [f"a callback for {what}" for there, what in callbacks if there]
    if scene.control is not None:
        found.append(f"a callback for the control law '{scene.control.law}'")
    taking = [one for one in Integrator if not refusal(MuJoCo(integrator=one), scene)]
    if len(taking) < len(Integrator):
        found.append(f"the integrator {' or '.join(f'`{one.value}`' for one in taking)}: the others refuse the scene")
    if limit < EXPLICIT_STEP and Integrator.DISCRETE in taking:
        found.append(
            f"the integrator `discrete`, if seconds are to be simulated quickly: the stiffest motion lets RK4 step "
            f"{limit:.3g} s at most"
        )
    return found


def _listed(names: set[str]) -> str:
    shown = sorted(names)
    return ", ".join(f"'{name}'" for name in shown[:6]) + (f" and {len(shown) - 6} more" if len(shown) > 6 else "")
