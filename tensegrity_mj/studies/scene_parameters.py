"""Changes of a structure or a scene, by the names of their parts."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from tensegrity_mj.basics.checks import check_known, finite
from tensegrity_mj.basics.fields import item_of
from tensegrity_mj.basics.texts import unknown
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.elements.resistance import Resistance
from tensegrity_mj.model.events import Break
from tensegrity_mj.model.members import Vector
from tensegrity_mj.model.motion import Motion
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.studies import parameter_values
from tensegrity_mj.studies.parameter_values import Draw, changed

PARTS_OF_SCENE = tuple(key for key in item_of(Scene).keys if key not in ("structure", "name", "source", "control"))
MEMBERS = {
    "rods": "rod",
    "strings": "string",
    "point_masses": "point mass",
    "bodies": "body",
    "constraints": "constraint",
}
REST = ("rest_length", "tension", "force_density")  # of a string, which has one of them at most


def member_names(scene: Scene, path: str) -> list[str] | None:
    """The paths of each member by itself of a path with [*], such as structure.rods[*].mass; None without [*].

    Raises:
        OptionError: if [*] stands where there are no members.
    """
    if "[*]" not in path:
        return None
    head, _, tail = path.partition("[*]")
    kind = head.rpartition(".")[2]
    known: Iterable[str] = ()
    if kind in MEMBERS:
        known = _named(_members(scene.structure, kind))
    elif kind in ("nodes", "initial_nodes", "initial_velocities"):
        known = scene.structure.node_names
    elif kind == "motions":
        known = [motion.support for motion in scene.motions]
    elif kind == "loads" and not callable(scene.loads):
        known = dict.fromkeys(load.node for load in scene.loads)
    names = [f"{head}[{name}]{tail}" for name in known]
    if not names:
        raise OptionError(f"{path}: [*] stands for each member of {', '.join(MEMBERS)}, nodes, ..., and there is none")
    return names


def single_draws(scene: Scene, draws: Iterable[Draw]) -> tuple[Draw, ...]:
    """Draws of which each has one parameter: those with [*] for each member by itself; see `member_names`."""
    return tuple(
        replace(draw, parameter=path)
        for draw in draws
        for path in member_names(scene, draw.parameter) or [draw.parameter]
    )


def changed_scene(scene: Scene, kind: str, rest: str, path: str, value: Any) -> Scene:
    """The scene with another value of what a path under `structure` or `scene` names.

    Args:
        kind: "structure" or "scene".
        rest: what is left of the path.
        path: all of it, for messages.

    Raises:
        OptionError: if it names nothing, or for a value of the wrong kind.
    """
    first, *others = parameter_values.parts_of(rest, path)
    match = parameter_values.MEMBER.fullmatch(first)
    if match is None:
        raise OptionError(f"{path}: '{first}' is no name, nor a name with members in brackets such as rods[rod1]")
    name, which = match["name"], match["which"]
    if kind == "structure":
        known: tuple[str, ...] = (*MEMBERS, "nodes", "string_law")
        check_known(path, name, known, "part of a structure")
        if name in MEMBERS:
            return _with_members(scene, name, which, others, path, value)
        if name == "nodes":
            return _with_node(scene, which, others, path, value)
        return scene.with_(structure=changed(scene.structure, [first, *others], path, "structure", value))
    check_known(path, name, PARTS_OF_SCENE, "part of a scene")
    if name in ("initial_nodes", "initial_velocities"):
        number, axis = _node(scene, which, path), parameter_values.axis_of(others, path)
        rows = scene.nodes0 if name == "initial_nodes" else scene.velocities0
        return scene.with_(
            **{name: _with_row(rows, number, parameter_values.vector_from(path, value, axis, rows[number].tolist()))}
        )
    if name == "target":
        target = scene.target
        if target is None or len(target.times) != 1 or target.along is not None:
            raise OptionError(f"{path}: scene '{scene.name}' has no target that is one set-point")
        number, axis = _node(scene, which, path), parameter_values.axis_of(others, path)
        row = parameter_values.vector_from(path, value, axis, target.nodes[0, number].tolist())
        return scene.with_(target=replace(target, nodes=_with_row(target.nodes, number, row)))
    if name == "breaks":
        return _with_break(scene, which, others, path, value)
    if name == "motions":
        return with_motions(scene, which, others, path, value)
    if name == "resistance":
        parameter_values.no_more(which, [], path)
        # Missing values begin with the defaults, and one that resists nothing becomes None.
        new = changed(scene.resistance or Resistance(), others, path, "resistance", value)
        if others[0] == "viscous" and new.viscous == 0 and new.drag is None:  # nothing is left that wind could act on
            new = replace(new, wind=Resistance.wind)
        return scene.with_(resistance=None if new == Resistance() else new)
    if name in ("contact", "water") and getattr(scene, name) is None:
        raise OptionError(f"{path}: scene '{scene.name}' has no {name}")
    return changed(scene, [first, *others], path, f"scene '{scene.name}'", value)


def _with_members(scene: Scene, kind: str, which: str | None, others: Sequence[str], path: str, value: Any) -> Scene:
    structure = scene.structure
    by_name = _named(_members(structure, kind))
    meant: dict[str, list[str]] = {}  # members by their groups, or by their own names, which come first
    for key, member in by_name.items():
        meant.setdefault(getattr(member, "group", None) or key, []).append(key)
    meant |= {key: [key] for key in by_name}
    if which is None:
        wanted = list(by_name)
    else:  # a name may hold commas itself
        wanted = [which] if which in meant else [name.strip() for name in which.split(",")]
    for word in wanted:
        check_known(path, word, meant, MEMBERS[kind])
    chosen = [key for word in wanted for key in meant[word]]
    if not chosen:
        raise OptionError(f"{path}: structure '{structure.name}' has no {MEMBERS[kind]}")
    keys = item_of(type(by_name[chosen[0]])).keys
    inner = keys.get(others[0].partition("[")[0]) if others else None
    inside = inner is not None and (inner.kind.row or (inner.kind.part is not None and len(others) > 1))
    plain = [key for key, one in keys.items() if one.kind.single or one.kind.row]
    known = [*plain, *(["curve"] if "curve" in keys and isinstance(value, parameter_values.Scaled) else [])]
    if not inside and (len(others) != 1 or others[0] not in known):
        given = others[0] if others else ""
        raise OptionError(f"{path}: {unknown(given, known, f'number of a {MEMBERS[kind]}')}")
    part = others[0]
    for number, (name, member) in enumerate(by_name.items()):
        if name in chosen and inside:
            by_name[name] = changed(member, others, path, f"{MEMBERS[kind]} '{name}'", value)
        elif name in chosen:
            where = f"{path} of '{name}'" if isinstance(value, parameter_values.Scaled) else path
            new = parameter_values.single(keys[part].kind, where, value, _now(structure.massless, member, part, number))
            given_by = dict.fromkeys(REST) if part in REST else {}
            if kind == "strings" and part in ("stiffness", "curve"):  # tensions in proportion
                by_name[name] = member.scaled_to(new)
            else:
                by_name[name] = replace(member, **(given_by | {part: new}))
    members = structure.given._asdict() | {kind: tuple(by_name.values())}
    changes: dict[str, Any] = {"structure": replace(structure, **members)}
    if len(changes["structure"].nodes) != len(structure.nodes):  # ropes have other points, which stand straight
        rows = len(structure.nodes) - sum(len(rope.points) for rope in structure.ropes)
        starts = {key: getattr(scene, key) for key in ("initial_nodes", "initial_velocities")}
        changes |= {key: start[:rows] for key, start in starts.items() if start is not None}
    return scene.with_(**changes)


def _now(structure: Any, member: Any, name: str, number: int) -> Any:
    """Return the present value of a member's number; of strings, as it follows from how they are given."""
    if name not in REST:
        return getattr(member, "stiffness" if name == "curve" else name)
    length, rest = structure.string_lengths(structure.positions)[number], structure.rest_lengths[number]
    if name == "rest_length":
        return float(rest)
    tensions = structure.curves.tension(structure.string_lengths(structure.positions) - structure.rest_lengths)
    return float(tensions[number] / (1.0 if name == "tension" else length))


def _with_node(scene: Scene, which: str | None, others: Sequence[str], path: str, value: Any) -> Scene:
    structure, target = scene.structure, scene.target
    number, axis = _node(scene, which, path), parameter_values.axis_of(others, path)
    node = structure.node_names[number]
    row = parameter_values.vector_from(path, value, axis, structure.nodes[node])
    changes: dict[str, Any] = {"structure": replace(structure, nodes={**structure.nodes, node: row})}
    if node in structure.fixed_nodes:
        # Where a fixed node is, it is in the start and in the target too.
        if scene.initial_nodes is not None:
            changes["initial_nodes"] = _with_row(scene.initial_nodes, number, row)
        if target is not None and target.along is None:
            changes["target"] = replace(target, nodes=_with_row(target.nodes, number, row))
    return scene.with_(**changes)


def _with_row(nodes: Any, number: int, row: Vector) -> Any:
    """Return node positions (..., N, 3) with one node elsewhere."""
    nodes = np.array(nodes)
    nodes[..., number, :] = row
    return nodes


def _with_break(scene: Scene, which: str | None, others: Sequence[str], path: str, value: Any) -> Scene:
    strings = _named((*scene.structure.strings, *scene.structure.given.strings))
    parts = {rope.string.name: rope.parts[0].name for rope in scene.structure.ropes}
    if which is None or others != ["time"]:
        raise OptionError(f"{path}: write breaks[STRING].time, with a string of {', '.join(strings)}")
    check_known(path, which, strings, "string")
    times = {event.string: event.time for event in scene.breaks}
    broken = parts.get(which, which)  # a rope breaks at its first part
    times[broken] = parameter_values.number_from(path, value, times.get(broken))
    return scene.with_(breaks=tuple(Break(string, time) for string, time in times.items()))


def _node(scene: Scene, which: str | None, path: str) -> int:
    names = scene.structure.node_names
    if which is None:
        raise OptionError(f"{path}: name a node in brackets: {', '.join(names)}")
    check_known(path, which, names, "node")
    return scene.structure.node_index[which]


def _members(structure: Any, kind: str) -> Any:
    """Return the members of a kind as they were given, strings with mass among them."""
    return getattr(structure.given, kind, getattr(structure, kind))


def _named(members: Iterable[Any]) -> dict[str, Any]:
    return {getattr(member, "name", None) or member.node: member for member in members}


OF_MOTION = ("amplitude", "frequency", "angular_frequency", "phase")
# Amplitudes of one size, such as those of a circle, differ by round-off.
SAME = 1e-12


def with_motions(scene: Scene, which: str | None, others: Sequence[str], path: str, value: Any) -> Scene:
    """The scene with one motion changed, or all, as a path names them.

    Raises:
        OptionError: if it names nothing, or for a value of the wrong kind.
    """
    if not scene.motions:
        raise OptionError(f"{path}: scene '{scene.name}' has no motions of supports")
    supports = [motion.support for motion in scene.motions]
    if which is not None and which not in supports:
        raise OptionError(f"{path}: {unknown(which, supports, 'support with a motion')}")
    name = others[0] if others else ""
    check_known(path, name, OF_MOTION, "part of a motion")
    if name != "amplitude":
        parameter_values.no_more(None, others[1:], path)
    for motion in scene.motions:
        if which in (None, motion.support) and motion.function is not None:
            raise OptionError(f"{path}: the motion of '{motion.support}' is a function, which has no parts to change")
    axis = parameter_values.axis_of(others[1:], path)

    change = {
        "amplitude": partial(_with_amplitude, path, axis, value),
        "phase": partial(_with_phase, path, value),
        "frequency": partial(_with_frequency, path, 2 * math.pi, value),
        "angular_frequency": partial(_with_frequency, path, 1.0, value),
    }[name]
    motions = (change(one) if which in (None, one.support) else one for one in scene.motions)
    return scene.with_(motions=tuple(motions))


def _with_amplitude(path: str, axis: int | None, value: Any, motion: Motion) -> Motion:
    """A factor is of all that the motion makes, data too; a number is the length of all amplitudes, or a component."""
    rows = [item.amplitude for item in motion.harmonics]
    if not isinstance(value, parameter_values.Scaled):
        _no_data(path, motion)
        if axis is not None:
            _one(path, motion, "components of amplitudes", [row[axis] for row in rows])
        elif isinstance(value, Sequence):
            _one(path, motion, "amplitudes", rows)
        else:
            new = finite(path, value)
            now = _one(path, motion, "lengths of amplitudes", [math.hypot(*row) for row in rows])
            if now == 0:
                raise OptionError(
                    f"{path} = {value!r}: an amplitude of zero has no direction; give a list of three numbers"
                )
            value = parameter_values.Scaled(new / now)
    data = {
        key: tuple(parameter_values.vector_from(path, value, axis, row) for row in getattr(motion, key))
        for key in ("displacements", "velocities", "accelerations")
    }
    return _with(motion, "amplitude", [parameter_values.vector_from(path, value, axis, row) for row in rows], **data)


def _with_frequency(path: str, unit: float, value: Any, motion: Motion) -> Motion:
    """A factor is one of the pace of all that the motion makes, data too; what stands still goes on standing."""
    omegas = [item.angular_frequency for item in motion.harmonics]
    moving = [omega for omega in omegas if omega]
    if not isinstance(value, parameter_values.Scaled):
        _no_data(path, motion)
        new = unit * finite(path, value)
        if moving:
            _one(path, motion, "frequencies", moving)
        return _with(motion, "angular_frequency", [new if omega or not moving else omega for omega in omegas])
    pace = value.factor
    if motion.times and pace <= 0:
        raise OptionError(f"{path} = {value}: the motion of '{motion.support}' has data; their pace must be > 0")
    return _with(
        motion,
        "angular_frequency",
        [omega * pace if omega else omega for omega in omegas],
        times=tuple(time / pace for time in motion.times),
        velocities=tuple((pace * x, pace * y, pace * z) for x, y, z in motion.velocities),
        accelerations=tuple((pace**2 * x, pace**2 * y, pace**2 * z) for x, y, z in motion.accelerations),
    )


def _with_phase(path: str, value: Any, motion: Motion) -> Motion:
    """Harmonics that stand still keep their place."""
    moving = [item.phase for item in motion.harmonics if item.angular_frequency]
    _no_data(path, motion)
    if not moving:
        raise OptionError(f"{path}: nothing of the motion of '{motion.support}' has a frequency")
    now = _one(path, motion, "phases", moving)
    new = parameter_values.number_from(path, value, now)
    return _with(motion, "phase", [new if h.angular_frequency else h.phase for h in motion.harmonics])


def _with(motion: Motion, name: str, values: Sequence[Any], **changed: Any) -> Motion:
    """The motion with these values of a part of its harmonics, and what else is changed."""
    harmonics = (replace(h, **{name: value}) for h, value in zip(motion.harmonics, values, strict=True))
    return replace(motion, harmonics=tuple(harmonics), **changed)


def _no_data(path: str, motion: Motion) -> None:
    if motion.times:
        raise OptionError(
            f"{path}: the motion of '{motion.support}' has data; scale their amplitude or frequency by a factor such "
            "as *0.5"
        )


def _one(path: str, motion: Motion, what: str, values: Sequence[Any]) -> Any:
    """The value that all have."""
    first = values[0]
    for other in values[1:]:
        pairs = zip(first, other, strict=True) if isinstance(first, tuple) else [(first, other)]
        if any(abs(a - b) > SAME * max(abs(a), abs(b)) for a, b in pairs):
            raise OptionError(
                f"{path}: the motion of '{motion.support}' has harmonics of different {what}, which one value cannot "
                "stand for; scale them by a factor such as *0.5, or change the scene"
            )
    return first
