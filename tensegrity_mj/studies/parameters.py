"""Parameters by name, such as `structure.rods[rod1].mass` and `law.decay_rate`, and the experiment that they describe.

The paths begin with family, scene, structure, plant, law, engine, actuation, on_infeasible or output_interval;
docs/studies.md lists them. Parts of `plant` are those of `structure` and `scene`, but of what is simulated only: the
law keeps believing in the nominal structure and scene.

A value is a number, a text, a truth value, a list (vectors), or `Scaled(factor)`: that many times what it was. Changes
are made in the order family, structure, scene, plant, all else; those of a whole before those of its parts.

What a law commands reaches the plant's strings as rest lengths. A winch that believes in the stiffness k̂ sets
L0 = L (1 - u/k̂) for the force density u of the law; a string of stiffness k then has k (1 - L0/L) = u k/k̂.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tensegrity_mj.basics.checks import check_known, choice_from
from tensegrity_mj.basics.texts import unknown
from tensegrity_mj.controllers.own import Spec
from tensegrity_mj.controllers.scenes import SCENE_LAW
from tensegrity_mj.controllers.specs import NO_LAW, make, own_of, spec_of
from tensegrity_mj.dynamics.native.compiling import c_function
from tensegrity_mj.dynamics.native.law import SOLVED, WITHIN, Command, NativeLaw, native_law, wrapped
from tensegrity_mj.dynamics.native.pointers import LAW_SIGNATURE, call_law, floats
from tensegrity_mj.dynamics.native.views import view_of
from tensegrity_mj.engines.table import ENGINES, engine_class, make_engine, option_names
from tensegrity_mj.errors import FormatError, OptionError
from tensegrity_mj.model.actuation import Mode, OnInfeasible
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.studies.parameter_values import MEMBER, Scaled, decoded, number_from, scaled
from tensegrity_mj.studies.scene_parameters import MEMBERS, changed_scene

# Changes of one point are made in this order, so that what belongs together does not depend on how they were given.
ORDER = ("family", "structure", "scene", "plant", "law", "engine", "actuation", "on_infeasible", "output_interval")
_EXAMPLE = {"structure": "structure.rods.mass", "scene": "scene.gravity", "plant": "plant.rods.mass"}


@dataclass
class Draft:
    """An experiment under change: a base, to which settings are applied one by one, then built."""

    scene: Scene
    family: str = ""  # the call that makes the scene, if one does
    plant: Scene | None = None
    law: str | None = None  # None: the scene's; "none": no law
    law_spec: Spec | None = None  # of the law where none is chosen, in place of the scene's
    own_laws: Mapping[str, Spec] = field(default_factory=dict)  # of laws of one's own that `law` may choose, by text
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
        arguments = {path: decoded(value) for path, value in settings.items() if _root(path) == "family"}
        if arguments:
            self.scene = _remade(self, arguments)
        for path in sorted(settings.keys() - arguments.keys(), key=_rank):
            _set(self, path, decoded(settings[path]))
        return self

    def make_law(self) -> Any:
        """Make the law, for the nominal scene; None for none; raise OptionError if it cannot be made so."""
        options, control = dict(self.law_options), self.scene.control
        if self.law is None:
            spec = self.law_spec or spec_of(SCENE_LAW, self.scene)
        else:
            spec = self.own_laws.get(self.law, {"kind": "built-in", "name": self.law, "options": {}})
        if spec == NO_LAW:
            if options:
                raise OptionError(f"law.{next(iter(options))} needs a law, and there is none: set law too")
            return None
        given = {} if control is None or spec["kind"] != "built-in" else control.options
        given = {**(own.usual() if (own := own_of(spec)) else {}), **given, **spec["options"]}
        for name, value in options.items():
            if isinstance(value, Scaled):
                options[name] = scaled(f"law.{name}", value, given.get(name))
        law = make(spec, self.scene, options)
        if self.plant is not None:
            return NominalWinches.between(law, self.scene.structure, self.plant.structure)
        return law

    def make_engine(self) -> Any:
        usual = engine_class(self.engine)()
        options = {
            name: scaled(f"engine.{name}", value, getattr(usual, name))
            if isinstance(value, Scaled) and hasattr(usual, name)
            else value
            for name, value in self.engine_options.items()
        }
        return make_engine(self.engine, options)


def _root(path: str) -> str:
    if not isinstance(path, str):
        raise OptionError(f"parameter {path!r}: it must be a text, such as law.decay_rate")
    root = path.partition(".")[0]
    check_known(path, root, ORDER, "kind of parameter")
    return root


def _rank(path: str) -> tuple[Any, ...]:
    """Return the rank by which parameters are set: general ones before special ones, which would be lost otherwise.

    `engine` before `engine.rtol`, `rods.mass` before `rods[a,b].mass` before `rods[a].mass`, `gravity` before
    `gravity.z`; the path at last, so that equal settings give equal experiments, in any order.
    """
    plain = re.sub(r"\[.*\]", "", path)
    # Wind after all that it could act on, without which it is refused.
    parts = 3 if plain.split(".")[1:2] == ["resistance"] else plain.count(".")
    return ORDER.index(_root(path)), parts, "[" in path, -path.count(","), path


def _set(draft: Draft, path: str, value: Any) -> None:
    """Give a parameter its value."""
    root = _root(path)
    rest = path.partition(".")[2]
    if root in ("on_infeasible", "output_interval") and rest:
        raise OptionError(f"{path}: '{root}' has no parts; write {root}")
    if root in _EXAMPLE and not rest:
        raise OptionError(f"{path}: name a part of it, such as {_EXAMPLE[root]}")
    match root:
        case "structure" | "scene":
            draft.scene = changed_scene(draft.scene, root, rest, path, value)
        case "plant":
            part = MEMBER.match(rest)
            kind = "structure" if part is not None and part["name"] in (*MEMBERS, "nodes", "string_law") else "scene"
            draft.plant = changed_scene(draft.plant or draft.scene, kind, rest, path, value)
        case "law":
            _set_law(draft, rest, path, value)
        case "engine" if not rest:
            engine_class(value)
            if value != draft.engine:  # the base's options belong to its own engine
                draft.engine, draft.engine_options = value, {}
        case "engine":
            known = dict.fromkeys(option for name in ENGINES for option in option_names(name))
            check_known(path, rest, known, "option of an engine")
            base = draft.engine_options.get(rest)
            draft.engine_options[rest] = scaled(path, value, base) if isinstance(value, Scaled) and base else value
        case "actuation" if rest not in ("", "period"):
            raise OptionError(f"{path}: {unknown(rest, ('period',), 'part of actuation')}")
        case _:
            name, words = rest or root, {"actuation": Mode, "on_infeasible": OnInfeasible}.get(path)
            now = getattr(draft, name)
            setattr(draft, name, number_from(path, value, now) if words is None else choice_from(path, words, value))


def _remade(draft: Draft, arguments: Mapping[str, Any]) -> Scene:
    """The family's scene for other arguments, path -> value."""
    from tensegrity_mj.library.named import family_scene

    for path, value in arguments.items():
        if path == "family":
            raise OptionError("family: name one of its arguments, such as family.stiffness")
        if not draft.family:
            raise OptionError(
                f"{path}: scene '{draft.scene.name}' is not given by a call of a family, such as tower(stages=10)"
            )
        if isinstance(value, Scaled):
            raise OptionError(f"{path}: arguments of a family take values, not factors; write the value itself")
    try:
        return family_scene(draft.family, {path.partition(".")[2]: value for path, value in arguments.items()})
    except FormatError as error:
        raise OptionError(str(error)) from None


def _set_law(draft: Draft, option: str, path: str, value: Any) -> None:
    from tensegrity_mj.controllers.table import LAWS, built_in

    if not option:
        if value != "none" and value not in draft.own_laws and value not in LAWS:
            raise OptionError(f"law = {value!r}: {unknown(str(value), [*LAWS, 'none'], 'law')}")
        draft.law = value
        return
    base = None if draft.law_spec is None else own_of(draft.law_spec)
    others = [one for spec in draft.own_laws.values() if (one := own_of(spec)) is not None]
    if base is not None and not others:
        base.check(option)  # it alone is simulated
    else:
        entries = [*([base] if base else []), *others, *(LAWS[name] for name in built_in())]
        known = dict.fromkeys(name for entry in entries for name in entry.options)
        if option not in known and not any(getattr(entry, "takes_any", False) for entry in entries):
            raise OptionError(f"{path}: {unknown(option, known, 'option of a law')}")
    draft.law_options[option] = value


_Winches, _pack_winches = view_of(
    "NominalWinches",
    **WITHIN,
    ratio=("f8", "string_count"),  # of stiffnesses k/k̂
)


@c_function(LAW_SIGNATURE, "a law that believes in another stiffness of the strings")
def _nominal(t, nodes, velocities, context, command, report):  # type: ignore[no-untyped-def]
    own = _Winches(context)
    status = call_law(own.law, t, nodes, velocities, own.context, command, report)
    if status == SOLVED:
        u = floats(command, (own.string_count,))
        for m in range(len(u)):
            u[m] *= own.ratio[m]
    return status


@dataclass(frozen=True, eq=False)
class NominalWinches:
    """A law whose force densities are set by winches that believe in the nominal stiffness.

    Attributes:
        law: the law, or a Python function.
        nominal: what the law and the winches believe in.
        plant: what is simulated.
    """

    law: Any
    nominal: Structure
    plant: Structure

    @classmethod
    def between(cls, law: Any, nominal: Structure, plant: Structure) -> Any:
        """The law itself where stiffnesses are equal, or where it commands rest lengths, which need none."""
        nominal, plant = nominal.massless, plant.massless
        lengths = getattr(law, "command", Command.FORCE_DENSITY) is Command.REST_LENGTH
        return law if lengths or np.array_equal(nominal.stiffness, plant.stiffness) else cls(law, nominal, plant)

    def __call__(self, time: float, nodes: Any, velocities: Any) -> Any:
        """Force densities (M,) [N/m] of the plant's strings."""
        return np.asarray(self.law(time, nodes, velocities)) * self._ratio

    @property
    def _ratio(self) -> Any:
        return self.plant.stiffness / self.nominal.stiffness

    def native(self, structure: Structure) -> NativeLaw:
        """Return the compiled law, with the same conversion of its force densities."""
        inner = native_law(self.law, self.nominal)
        packed = _pack_winches(law=inner.address, context=inner.context, ratio=self._ratio)
        return wrapped(inner, _nominal, packed)

    def describe(self) -> dict[str, Any]:
        """Plain values for the provenance of a run."""
        description = native_law(self.law, self.nominal).description or {}
        return {**description, "nominal_stiffness": self.nominal.stiffness.tolist()}
