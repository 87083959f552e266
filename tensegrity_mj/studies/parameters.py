"""Parameters by name, such as `structure.rods[rod1].mass` and `law.decay_rate`, and the experiment that they describe.

    scene.gravity, .duration                             also scene.gravity.x, .y, .z
    scene.initial_nodes[NODE], .initial_velocities[NODE] also with .x, .y, .z
    scene.target[NODE]                                   of a target that is one set-point; also with .x, .y, .z
    scene.breaks[STRING].time                            when a string breaks [s]
    scene.contact.friction, .stiffness, .damping, .floor  of a scene that has contact; .rods true or false
    scene.loads.force, .angular_frequency, .phase        of all loads, or loads[NODE]: of those on a node
    structure.rods.mass                                  of all rods; rods[rod1] or rods[rod1,rod2]: of some
    structure.strings.stiffness, .damping, ...           any number of a string, and so for point_masses
    structure.nodes[NODE]                                reference positions; also with .x, .y, .z
    structure.string_law                                 clipped, unclipped
    plant....                                            as structure.... and scene...., but of what is simulated only:
                                                         the law keeps believing in the nominal structure and scene
    law                                                  a name of `controllers.LAWS`, or none
    law.decay_rate, law.norm, ...                        the law's options
    engine                                               mujoco, dae, ode
    engine.timestep, engine.rtol, ...                    the options of the engine's class
    actuation, actuation.period                          continuous, hold force density, hold rest length; [s]
    on_infeasible, output_interval                       stop, passive; [s]

A value is a number, a text, a truth value, a list (vectors), or `Scaled(factor)`: that many times what it was. Changes
are made in the order structure, scene, plant, all else; those of a whole before those of its parts.
"""

from __future__ import annotations

import dataclasses
import difflib
import enum
import importlib
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from tensegrity_mj.actuation import Actuation, Mode, OnInfeasible
from tensegrity_mj.checks import finite
from tensegrity_mj.errors import OptionError
from tensegrity_mj.scene import Break, Scene
from tensegrity_mj.strings import StringLaw, elastic_tension, force_density
from tensegrity_mj.structure import Vector

ENGINES = {"mujoco": ("engines.mujoco", "MuJoCo"), "dae": ("engines.dae", "DAE"), "ode": ("engines.ode", "ODE")}
AXES = ("x", "y", "z")
MEMBERS = {"rods": "rod", "strings": "string", "point_masses": "point mass"}
REST = ("rest_length", "tension", "force_density")  # of a string, which has one of them at most
# Changes of one point are made in this order, so that what belongs together does not depend on how they were given.
ORDER = ("structure", "scene", "plant", "law", "engine", "actuation", "on_infeasible", "output_interval")
_PART = re.compile(r"[^.\[\]]+(\[.*\])?")
_MEMBER = re.compile(r"(?P<name>\w+)(\[(?P<which>.+)\])?")


@dataclass(frozen=True)
class Scaled:
    """A value that is `factor` times what the parameter was."""

    factor: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "factor", finite("Scaled: factor", self.factor))

    def __str__(self) -> str:
        return f"*{self.factor!r}"


def encoded(value: Any) -> Any:
    """A value as points hold it: `Scaled(0.8)` is the text *0.8."""
    return str(value) if isinstance(value, Scaled) else value


def decoded(value: Any) -> Any:
    """The value that a point holds."""
    if isinstance(value, str) and value.startswith("*"):
        try:
            return Scaled(float(value[1:]))
        except ValueError:
            raise OptionError(f"{value!r}: after * there must be a number, such as *0.8") from None
    return value


@dataclass
class Draft:
    """An experiment under change: a base, to which settings are applied one by one, then built."""

    scene: Scene
    plant: Scene | None = None
    law: str | None = None  # None: the scene's; "none": no law
    law_maker: str | None = None
    law_options: dict[str, Any] = field(default_factory=dict)
    engine: str = "mujoco"
    engine_options: dict[str, Any] = field(default_factory=dict)
    actuation: Mode = Mode.CONTINUOUS
    period: float | None = None
    on_infeasible: OnInfeasible = OnInfeasible.STOP
    output_interval: float | None = None

    def apply(self, settings: Mapping[str, Any]) -> Draft:
        """Change it by settings, path -> value, in the order of `ORDER`, wholes before their parts; returns itself.

        Raises:
            OptionError: for a path that names nothing, or a value of the wrong kind.
            StructureError, SceneError: for a value that the structure or the scene cannot have.
        """
        for path in sorted(settings, key=_rank):
            _setter(self, path)(decoded(settings[path]))
        return self

    def make_law(self) -> Any:
        """The law, for the nominal scene; None for none.

        Raises:
            OptionError: if it cannot be made so.
        """
        from tensegrity_mj import controllers

        options, control = dict(self.law_options), self.scene.control
        if self.law == "none" or (self.law is None and self.law_maker is None and control is None):
            if options:
                raise OptionError(f"law.{next(iter(options))} needs a law, and there is none: set law too")
            return None
        given = control.options if control is not None else {}
        for name, value in options.items():
            if isinstance(value, Scaled):
                options[name] = _scaled(f"law.{name}", value, given.get(name))
        if self.law_maker is not None and self.law is None:
            law = imported(self.law_maker)(self.scene, **options)
        else:
            law = controllers.from_scene(self.scene, self.law, **options)
        if self.plant is not None:
            from tensegrity_mj.studies.nominal import NominalWinches

            return NominalWinches.between(law, self.scene.structure, self.plant.structure)
        return law

    def make_engine(self) -> Any:
        """The engine."""
        kind = engine_class(self.engine)
        known = {item.name: item for item in dataclasses.fields(kind)}
        usual = kind()  # where an option's default hangs on others, it still tells what kind it is of
        chosen = {}
        for name, value in self.engine_options.items():
            if name not in known:
                raise OptionError(f"engine.{name}: {_unknown(name, known, f'option of engine {self.engine}')}")
            default = getattr(usual, name)
            if isinstance(value, Scaled):
                value = _scaled(f"engine.{name}", value, default)
            elif isinstance(default, enum.Enum):
                value = _choice(f"engine.{name}", type(default), value)
            chosen[name] = value
        return kind(**chosen)

    def make_actuation(self) -> Actuation:
        """The actuation."""
        return Actuation(self.actuation, self.period)


def engine_class(name: str) -> Any:
    """The class of an engine's options.

    Raises:
        OptionError: for a name that is none.
    """
    if name not in ENGINES:
        raise OptionError(f"engine = {name!r}: {_unknown(str(name), ENGINES, 'engine')}")
    module, attribute = ENGINES[name]
    return getattr(importlib.import_module(f"tensegrity_mj.{module}"), attribute)


def engine_settings(engine: Any) -> tuple[str, dict[str, Any]]:
    """The name of an engine and its options as plain values, those at their defaults left out.

    Raises:
        OptionError: if it is no engine of this package.
    """
    for name in ENGINES:
        if type(engine) is engine_class(name):
            items = {item.name: (getattr(engine, item.name), item.default) for item in dataclasses.fields(engine)}
            return name, {key: _word(value) for key, (value, default) in items.items() if value != default}
    allowed = ", ".join(attribute for _, attribute in ENGINES.values())
    raise OptionError(f"engine = {engine!r}; use one of {allowed}, an object and not a class")


def imported(name: str) -> Any:
    """The object of a dotted name, module.function."""
    module, _, attribute = name.rpartition(".")
    return getattr(importlib.import_module(module), attribute)


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
        known = _named(getattr(scene.structure, kind))
    elif kind in ("nodes", "initial_nodes", "initial_velocities"):
        known = scene.structure.node_names
    elif kind == "loads" and not callable(scene.loads):
        known = dict.fromkeys(load.node for load in scene.loads)
    names = [f"{head}[{name}]{tail}" for name in known]
    if not names:
        raise OptionError(f"{path}: [*] stands for each member of {', '.join(MEMBERS)}, nodes, ..., and there is none")
    return names


# ------------------------------------------------------------------------------------------------------- resolving


def _root(path: str) -> str:
    if not isinstance(path, str):
        raise OptionError(f"parameter {path!r}: it must be a text, such as law.decay_rate")
    root = path.partition(".")[0]
    if root not in ORDER:
        raise OptionError(f"{path}: {_unknown(root, ORDER, 'kind of parameter')}")
    return root


def _rank(path: str) -> tuple[Any, ...]:
    """When a parameter is set: what holds for much before what holds for less, else it would be lost.

    `engine` before `engine.rtol`, `rods.mass` before `rods[a,b].mass` before `rods[a].mass`, `gravity` before
    `gravity.z`; the path at last, so that equal settings give equal experiments, in whatever order they are given.
    """
    parts = re.sub(r"\[.*\]", "", path).count(".")
    return ORDER.index(_root(path)), parts, "[" in path, -path.count(","), path


def _setter(draft: Draft, path: str) -> Callable[[Any], None]:
    """What takes the value of a parameter."""
    root = _root(path)
    rest = path.partition(".")[2]
    if root in ("on_infeasible", "output_interval") and rest:
        raise OptionError(f"{path}: '{root}' has no parts; write {root}")
    if root in ("structure", "scene", "plant") and not rest:
        raise OptionError(f"{path}: name a part of it, such as {_EXAMPLE[root]}")
    match root:
        case "structure" | "scene":
            return partial(_set_scene, draft, path, _scene_change(draft.scene, root, rest, path))
        case "plant":
            part = _MEMBER.match(rest)
            kind = "structure" if part is not None and part["name"] in (*MEMBERS, "nodes", "string_law") else "scene"
            return partial(_set_plant, draft, _scene_change(draft.plant or draft.scene, kind, rest, path))
        case "law":
            return partial(_set_law, draft, rest, path)
        case "engine":
            return partial(_set_engine, draft, rest, path)
        case "actuation":
            return partial(_set_actuation, draft, rest, path)
    return partial(_set_plain, draft, root)


_EXAMPLE = {"structure": "structure.rods.mass", "scene": "scene.gravity", "plant": "plant.rods.mass"}

# What a change of the scene is: a value in, another scene out.
Change = Callable[[Scene, Any], Scene]


def _set_scene(draft: Draft, path: str, change: Change, value: Any) -> None:
    draft.scene = change(draft.scene, value)


def _set_plant(draft: Draft, change: Change, value: Any) -> None:
    draft.plant = change(draft.plant or draft.scene, value)


def _set_law(draft: Draft, option: str, path: str, value: Any) -> None:
    from tensegrity_mj.controllers import LAWS

    if not option:
        if value != "none" and value not in LAWS:
            raise OptionError(f"law = {value!r}: {_unknown(str(value), [*LAWS, 'none'], 'law')}")
        draft.law = value
        return
    if draft.law_maker is None:
        known = dict.fromkeys(name for entry in LAWS.values() for name in entry.options)
        if option not in known:
            raise OptionError(f"{path}: {_unknown(option, known, 'option of a law')}")
    draft.law_options[option] = value


def _set_engine(draft: Draft, option: str, path: str, value: Any) -> None:
    if not option:
        engine_class(value)
        if value != draft.engine:
            # The base's options belong to its own engine.
            draft.engine, draft.engine_options = value, {}
        return
    known = dict.fromkeys(item.name for name in ENGINES for item in dataclasses.fields(engine_class(name)))
    if option not in known:
        raise OptionError(f"{path}: {_unknown(option, known, 'option of an engine')}")
    base = draft.engine_options.get(option)
    draft.engine_options[option] = _scaled(path, value, base) if isinstance(value, Scaled) and base else value


def _set_actuation(draft: Draft, part: str, path: str, value: Any) -> None:
    if part not in ("", "period"):
        raise OptionError(f"{path}: {_unknown(part, ('period',), 'part of actuation')}")
    if part:
        draft.period = _scaled(path, value, draft.period) if isinstance(value, Scaled) else _number(path, value)
    else:
        draft.actuation = _choice(path, Mode, value)


def _set_plain(draft: Draft, name: str, value: Any) -> None:
    if name == "on_infeasible":
        draft.on_infeasible = _choice(name, OnInfeasible, value)
    elif isinstance(value, Scaled):
        draft.output_interval = _scaled(name, value, draft.output_interval)
    else:
        draft.output_interval = _number(name, value)


def _scene_change(scene: Scene, kind: str, rest: str, path: str) -> Change:
    """The change of a scene that a path under `structure` or `scene` names.

    Raises:
        OptionError: if it names nothing.
    """
    first, *others = _parts(rest, path)
    match = _MEMBER.fullmatch(first)
    if match is None:
        raise OptionError(f"{path}: '{first}' is no name, nor a name with members in brackets such as rods[rod1]")
    name, which = match["name"], match["which"]
    if kind == "structure":
        known: tuple[str, ...] = (*MEMBERS, "nodes", "string_law")
        if name not in known:
            raise OptionError(f"{path}: {_unknown(name, known, 'part of a structure')}")
        if name in MEMBERS:
            return _member_change(scene, name, which, others, path)
        if name == "nodes":
            return partial(_change_node, path, _node(scene, which, path), _axis(others, path))
        _no_more(which, others, path)
        return partial(_change_string_law, path)
    known = ("gravity", "duration", "initial_nodes", "initial_velocities", "target", "loads", "breaks", "contact")
    if name not in known:
        raise OptionError(f"{path}: {_unknown(name, known, 'part of a scene')}")
    if name == "loads":
        return _load_change(scene, which, others, path)
    if name in ("initial_nodes", "initial_velocities"):
        return partial(_change_state, path, name, _node(scene, which, path), _axis(others, path))
    if name == "target":
        if scene.target is None or len(scene.target.times) != 1 or scene.target.along is not None:
            raise OptionError(f"{path}: scene '{scene.name}' has no target that is one set-point")
        return partial(_change_target, path, _node(scene, which, path), _axis(others, path))
    if name == "contact":
        _no_more(which, others[1:], path)
        return _contact_change(scene, others, path)
    if name == "breaks":
        return _break_change(scene, which, others, path)
    if name == "gravity":
        _no_more(which, [], path)
        return partial(_change_gravity, path, _axis(others, path))
    _no_more(which, others, path)
    return partial(_change_duration, path)


def _member_change(scene: Scene, kind: str, which: str | None, others: list[str], path: str) -> Change:
    members = getattr(scene.structure, kind)
    by_name = _named(members)
    if which is None:
        chosen = list(by_name)
    else:  # a name may hold commas itself
        chosen = [which] if which in by_name else [name.strip() for name in which.split(",")]
    for name in chosen:
        if name not in by_name:
            raise OptionError(f"{path}: {_unknown(name, by_name, MEMBERS[kind])}")
    if not chosen:
        raise OptionError(f"{path}: structure '{scene.structure.name}' has no {MEMBERS[kind]}")
    known = _numbers_of(type(members[0]))
    if len(others) != 1 or others[0] not in known:
        given = others[0] if others else ""
        raise OptionError(f"{path}: {_unknown(given, known, f'number of a {MEMBERS[kind]}')}")
    return partial(_change_members, path, kind, frozenset(chosen), others[0])


def _change_members(path: str, kind: str, chosen: frozenset[str], name: str, scene: Scene, value: Any) -> Scene:
    structure = scene.structure
    members = []
    for number, (key, member) in enumerate(_named(getattr(structure, kind)).items()):
        if key in chosen:
            if isinstance(value, Scaled):
                new = _scaled(f"{path} of '{key}'", value, _now(structure, member, name, number))
            else:
                new = _number(path, value)
            others = dict.fromkeys(REST) if name in REST else {}
            member = replace(member, **(others | {name: new}))
        members.append(member)
    changed: dict[str, Any] = {kind: tuple(members)}
    return scene.with_(structure=replace(structure, **changed))


def _now(structure: Any, member: Any, name: str, number: int) -> Any:
    """What a number of a member is now; of strings, what follows from how they are given."""
    if name not in REST:
        return getattr(member, name)
    length, rest = structure.string_lengths(structure.positions)[number], structure.rest_lengths[number]
    if name == "rest_length":
        return float(rest)
    law = elastic_tension if name == "tension" else force_density
    return float(law(member.stiffness, length, rest))


def _change_node(path: str, node: str, axis: int | None, scene: Scene, value: Any) -> Scene:
    structure, target = scene.structure, scene.target
    row = _vector(path, value, axis, structure.nodes[node])
    changes: dict[str, Any] = {"structure": replace(structure, nodes={**structure.nodes, node: row})}
    if node in structure.fixed_nodes:
        # Where a fixed node is, it is in the start and in the target too.
        number = structure.node_index[node]
        if scene.initial_nodes is not None:
            changes["initial_nodes"] = _with_row(scene.initial_nodes, number, row)
        if target is not None and target.along is None:
            changes["target"] = replace(target, nodes=_with_row(target.nodes, number, row))
    return scene.with_(**changes)


def _with_row(nodes: Any, number: int, row: Vector) -> Any:
    """Node positions (..., N, 3) with one node elsewhere."""
    nodes = np.array(nodes)
    nodes[..., number, :] = row
    return nodes


def _change_string_law(path: str, scene: Scene, value: Any) -> Scene:
    return scene.with_(structure=replace(scene.structure, string_law=_choice(path, StringLaw, value)))


def _change_state(path: str, name: str, node: str, axis: int | None, scene: Scene, value: Any) -> Scene:
    rows = scene.nodes0 if name == "initial_nodes" else scene.velocities0
    number = scene.structure.node_index[node]
    return scene.with_(**{name: _with_row(rows, number, _vector(path, value, axis, rows[number].tolist()))})


def _change_target(path: str, node: str, axis: int | None, scene: Scene, value: Any) -> Scene:
    target, number = scene.target, scene.structure.node_index[node]
    assert target is not None
    row = _vector(path, value, axis, target.nodes[0, number].tolist())
    return scene.with_(target=replace(target, nodes=_with_row(target.nodes, number, row)))


def _change_break(path: str, name: str, scene: Scene, value: Any) -> Scene:
    times = {event.string: event.time for event in scene.breaks}
    times[name] = _scaled(path, value, times.get(name)) if isinstance(value, Scaled) else _number(path, value)
    return scene.with_(breaks=tuple(Break(string, time) for string, time in times.items()))


def _change_gravity(path: str, axis: int | None, scene: Scene, value: Any) -> Scene:
    return scene.with_(gravity=_vector(path, value, axis, scene.gravity))


def _change_duration(path: str, scene: Scene, value: Any) -> Scene:
    new = _scaled(path, value, scene.duration) if isinstance(value, Scaled) else _number(path, value)
    return scene.with_(duration=new)


def _break_change(scene: Scene, which: str | None, others: list[str], path: str) -> Change:
    strings = _named(scene.structure.strings)
    if which is None or others != ["time"]:
        raise OptionError(f"{path}: write breaks[STRING].time, with a string of {', '.join(strings)}")
    if which not in strings:
        raise OptionError(f"{path}: {_unknown(which, strings, 'string')}")
    return partial(_change_break, path, which)


def _contact_change(scene: Scene, others: list[str], path: str) -> Change:
    known = ("friction", "stiffness", "damping", "floor", "rods")
    name = others[0] if others else ""
    if name not in known:
        raise OptionError(f"{path}: {_unknown(name, known, 'part of contact')}")
    if scene.contact is None:
        raise OptionError(f"{path}: scene '{scene.name}' has no contact")
    return partial(_change_contact, path, name)


def _change_contact(path: str, name: str, scene: Scene, value: Any) -> Scene:
    assert scene.contact is not None
    new = value
    if name != "rods":
        now = getattr(scene.contact, name)
        new = _scaled(path, value, now) if isinstance(value, Scaled) else _number(path, value)
    return scene.with_(contact=replace(scene.contact, **{name: new}))


def _load_change(scene: Scene, which: str | None, others: list[str], path: str) -> Change:
    if callable(scene.loads) or not scene.loads:
        raise OptionError(f"{path}: scene '{scene.name}' has no loads")
    nodes = dict.fromkeys(load.node for load in scene.loads)
    if which is not None and which not in nodes:
        raise OptionError(f"{path}: {_unknown(which, nodes, 'node with a load')}")
    known = ("force", "angular_frequency", "phase")
    name = others[0] if others else ""
    if name not in known:
        raise OptionError(f"{path}: {_unknown(name, known, 'part of a load')}")
    if name != "force":
        _no_more(None, others[1:], path)
    return partial(_change_loads, path, which, name, _axis(others[1:], path))


def _change_loads(path: str, which: str | None, name: str, axis: int | None, scene: Scene, value: Any) -> Scene:
    assert not callable(scene.loads)
    loads = []
    for load in scene.loads:
        if which in (None, load.node):
            old, new = getattr(load, name), value
            if name == "force":
                new = _vector(path, value, axis, old)
            else:
                new = _scaled(path, value, old) if isinstance(value, Scaled) else _number(path, value)
            load = replace(load, **{name: new})
        loads.append(load)
    return scene.with_(loads=tuple(loads))


# ---------------------------------------------------------------------------------------------------------- pieces


def _parts(rest: str, path: str) -> list[str]:
    """The parts between dots; names in brackets may hold dots, and brackets in pairs."""
    parts, depth = [""], 0
    for letter in rest:
        depth += (letter == "[") - (letter == "]")
        if letter == "." and depth == 0:
            parts.append("")
        else:
            parts[-1] += letter
        if depth < 0:
            break
    if depth or not all(_PART.fullmatch(part) for part in parts):
        raise OptionError(f"{path}: it is no parameter; write it like structure.rods[rod1].mass")
    return parts


def _axis(others: Sequence[str], path: str) -> int | None:
    if not others:
        return None
    if len(others) > 1 or others[0] not in AXES:
        raise OptionError(f"{path}: {_unknown(others[0], AXES, 'component')}")
    return AXES.index(others[0])


def _node(scene: Scene, which: str | None, path: str) -> str:
    names = scene.structure.node_names
    if which is None:
        raise OptionError(f"{path}: name a node in brackets: {', '.join(names)}")
    if which not in names:
        raise OptionError(f"{path}: {_unknown(which, names, 'node')}")
    return which


def _no_more(which: str | None, others: Sequence[str], path: str) -> None:
    if which is not None or others:
        raise OptionError(f"{path}: it has no parts '{which or others[0]}'; leave them out")


def _named(members: Iterable[Any]) -> dict[str, Any]:
    return {getattr(member, "name", None) or member.node: member for member in members}


def _numbers_of(kind: type) -> list[str]:
    """The fields of a member that are numbers."""
    return [item.name for item in dataclasses.fields(kind) if str(item.type) in ("float", "float | None")]


def _vector(path: str, value: Any, axis: int | None, now: Sequence[float]) -> Vector:
    row = [float(x) for x in now]
    if isinstance(value, Scaled):
        row = [x * value.factor if axis in (None, i) else x for i, x in enumerate(row)]
    elif axis is not None:
        row[axis] = _number(path, value)
    elif not isinstance(value, Sequence) or isinstance(value, str) or len(value) != 3:
        raise OptionError(f"{path} = {value!r}; it must be a list of three numbers, or add .x, .y or .z")
    else:
        row = [_number(path, x) for x in value]
    x, y, z = row
    return (x, y, z)


def _number(path: str, value: Any) -> float:
    return finite(path, value)


def _scaled(path: str, scale: Scaled, now: Any) -> float:
    if not isinstance(now, (int, float)) or isinstance(now, bool) or not math.isfinite(now):
        what = "it has no value" if now is None or now is dataclasses.MISSING else f"{now!r} is no number"
        raise OptionError(f"{path} = {scale}: {what} that could be scaled; give one")
    return float(now) * scale.factor


def _choice(path: str, kind: type[enum.Enum], value: Any) -> Any:
    words = {str(one.value): one for one in kind}
    text = value.replace("-", " ") if isinstance(value, str) else value
    for word in (value, text):
        if isinstance(word, str) and word in words:
            return words[word]
    raise OptionError(f"{path} = {value!r}; allowed: {', '.join(words)}")


def _word(value: Any) -> Any:
    return value.value if isinstance(value, enum.Enum) else value


def _unknown(given: str, known: Iterable[str], what: str) -> str:
    """'rods' is no ...: what is allowed, and what was probably meant."""
    names = list(known)
    close = difflib.get_close_matches(given, names, n=1)
    meant = f" (did you mean '{close[0]}'?)" if close else ""
    return f"there is no {what} '{given}'{meant}; allowed: {', '.join(names)}"
