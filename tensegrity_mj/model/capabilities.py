"""What scenes have that not every engine simulates (`Trait`), and how an engine says what it cannot (`Descriptor`).

The engines' own are in `engines.table`; `engines.requirements.require` holds a scene against them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from operator import attrgetter
from typing import TYPE_CHECKING, Any

from tensegrity_mj.errors import OptionError, SceneError, StructureError, TensegrityError

if TYPE_CHECKING:  # the table of engines is read for --help, which loads neither numpy nor a scene
    from tensegrity_mj.model.scene import Scene
    from tensegrity_mj.model.structure import Structure


@dataclass(frozen=True)
class Trait:
    """What a scene may have.

    Attributes:
        name: for people.
        find: words that name the first item of a scene that has it; "" where there is none.
    """

    name: str
    find: Callable[[Scene], str]


@dataclass(frozen=True)
class Limit:
    """What an engine, or a function that uses engines, cannot do.

    Attributes:
        trait: which scenes it refuses.
        reason: why, by physics or by method.
        remedy: what to change.
        error: what is raised.
        setting: words for the options with which an engine (its argument) has this limit, "" for others; None: always.
    """

    trait: Trait
    reason: str
    remedy: str
    error: type[TensegrityError] = SceneError
    setting: Callable[[Any], str] | None = None


@dataclass(frozen=True)
class Descriptor:
    """An engine, and what it can do; its class has it as the attribute `descriptor`.

    Attributes:
        title: what texts and figures call it.
        place: its class, a frozen value of options with `run(request)`, as "module:class".
        fixed_step: the options with which it takes steps of `timestep` by the classical Runge-Kutta method.
        limits: what it cannot simulate; without any, it is held to simulate all scenes.
        shares_model: whether one compiled model of it makes many runs at a time (`simulate_many`).
        extra: what installs the packages that it needs beside the rest; studies leave it out unless it is named.
    """

    title: str
    place: str
    fixed_step: Mapping[str, Any] = field(default_factory=dict)
    limits: tuple[Limit, ...] = ()
    shares_model: bool = False
    extra: str = ""


def _joined(structure: Structure) -> str:
    if structure.class_number <= 1:
        return ""
    name = next(name for name, rows in structure.rods_at.items() if len(rows) > 1)
    rods = " and ".join(f"'{structure.rods[row].name}'" for row in structure.rods_at[name][:2])
    return f"rods {rods} share node '{name}'"


def _closed(scene: Scene) -> str:
    from tensegrity_mj.model.forest import spanning_forest

    closures = spanning_forest(scene.structure).closures
    return f"rods close a loop at node '{scene.structure.node_names[closures[0][0]]}'" if closures else ""


def _first(words: str, members: str, has: Callable[[Any], bool] = lambda one: True) -> Callable[[Scene], str]:
    """Words for the first of a scene's members, such as "structure.rods", that has something; it fills their braces."""
    of = attrgetter(members)
    return lambda scene: next((words.format(one) for one in of(scene) if has(one)), "")


def _and(*traits: Callable[[Scene], str]) -> Callable[[Scene], str]:
    """Words for scenes that have all of these."""

    def find(scene: Scene) -> str:
        found = []
        for trait in traits:
            found.append(trait(scene))
            if not found[-1]:
                return ""
        return ", and ".join(found)

    return find


_added = _first("{0.label} adds mass to rods", "effects", lambda one: one.adds_mass)
_uneven = _first("the mass that {0.label} adds is not symmetric", "effects", lambda one: not one.symmetric)
_constrained = _first("constraint '{0.name}' holds nodes", "structure.constraints")
_bodies = _first("'{0.name}' is a body (structure.bodies)", "structure.bodies")
_elastic = _first("rod '{0.name}' is elastic", "structure.rods", lambda rod: rod.stiffness is not None)


def _contact(scene: Scene) -> str:
    return "" if scene.contact is None else f"scene '{scene.name}' has contact"


def _joined_rods(scene: Scene) -> str:
    return _joined(scene.structure)


def _pushing(scene: Scene) -> str:
    pairs = zip(scene.structure.strings, scene.structure.clipped, strict=True)
    names = (string.name for string, clipped in pairs if string.damping and not clipped)
    return next((f"string '{name}' is damped and not clipped" for name in names), "")


CONTACT = Trait("contact", _contact)
ELASTIC = Trait("elastic rods", _elastic)
ELASTIC_JOINED = Trait("elastic rods in a structure whose rods share nodes", _and(_elastic, _joined_rods))
ELASTIC_CONTACT = Trait("elastic rods and contact", _and(_elastic, _contact))
ELASTIC_ADDED_MASS = Trait("elastic rods and added mass", _and(_elastic, _added))
ELASTIC_HELD_BETWEEN = Trait(
    "elastic rods held between their ends",
    _first(
        "elastic rod '{0.name}' is held between its ends",
        "structure.rods",
        lambda rod: rod.stiffness is not None and rod.support.directions and rod.support.sigma % 1,
    ),
)
BODIES = Trait("bodies", _bodies)
BODIES_IN_CONTACT = Trait("bodies and contact", _and(_bodies, _contact))
CLASS_K = Trait("rods that share nodes", _joined_rods)
CLOSED_LOOPS = Trait("closed loops", _closed)
MOVED_SUPPORTS = Trait("moved supports", _first("support '{0.support}' moves (scene.motions)", "motions"))
BREAKS = Trait("strings that break", _first("string '{0.string}' breaks (scene.breaks)", "breaks"))
ADDED_MASS = Trait("added mass", _added)
UNEVEN_MASS = Trait("added mass that is not symmetric, on rods that share nodes", _and(_uneven, _joined_rods))
CONSTRAINTS = Trait("linear constraints on nodes", _constrained)
ELEMENTS = Trait(
    "elements beside loads", _first("{0.label} acts on nodes", "effects", lambda one: one.label != "loads")
)
NO_ARRAYS = Trait(
    "elements without array functions",
    _first("{0.label} has no array function (arrays)", "effects", lambda one: not one.arrays),
)
FUNCTION_LOADS = Trait(
    "loads by a Python function",
    lambda scene: f"the loads of scene '{scene.name}' are a Python function" if callable(scene.loads) else "",
)
FUNCTION_MOTIONS = Trait(
    "supports moved by a Python function",
    _first("the motion of '{0.support}' is a Python function", "motions", lambda motion: motion.function is not None),
)
ELEMENT_STATES = Trait(
    "elements with a state",
    _first("{0.label} has a state (state0)", "elements", lambda one: one.has_state),
)
PUSHING_DAMPERS = Trait("damped strings that are not clipped", _pushing)
YIELDING = Trait("strings that yield", _first("string '{0.name}' yields", "structure.strings", lambda one: one.yields))
NOT_LINEAR = Trait(
    "strings that are not linear",
    _first("string '{0.name}' has a curve, or a constant force", "structure.strings", lambda one: not one.is_linear),
)
OWN_LAWS = Trait(
    "strings with a law of their own",
    _first("string '{0.name}' has a string_law", "structure.strings", lambda one: one.string_law),
)
JOINED_CONTACT = Trait("contact of rods that share nodes", _and(_contact, _joined_rods))
ADDED_MASS_IN_CONTACT = Trait("contact and added mass", _and(_added, _contact))
CONSTRAINTS_IN_CONTACT = Trait("contact and linear constraints", _and(_constrained, _contact))
CONSTRAINTS_IN_LOOPS = Trait("closed loops and linear constraints", _and(_constrained, _closed))
ADDED_MASS_IN_LOOPS = Trait("closed loops and added mass", _and(_added, _closed))


def refusal(engine: Any, scene: Scene) -> tuple[Limit, str, str] | None:
    """The first limit of an engine's options that a scene meets, words for what meets it, and for the setting that has
    the limit, "" where all have; None where the engine takes the scene, or has no `descriptor`.
    """
    descriptor: Descriptor | None = getattr(engine, "descriptor", None)
    for limit in () if descriptor is None else descriptor.limits:
        setting = "" if limit.setting is None else limit.setting(engine)
        if (setting or limit.setting is None) and (found := limit.trait.find(scene)):
            return limit, found, setting
    return None


def require_rest_lengths(structure: Structure) -> None:
    """Raise OptionError where a law has a string of constant force to command."""
    for string in structure.strings:
        if string.is_constant:
            raise OptionError(
                f"string '{string.name}' pulls with a constant force at any length (stiffness = 0), and a law sets "
                "rest lengths: give it a stiffness, or make it a load"
            )


def require_rigid(structure: Structure, who: str) -> None:
    """Raise StructureError where a rod is elastic; `who` begins the sentence."""
    for rod in structure.rods:
        if rod.stiffness is not None:
            raise StructureError(f"{who} for rods of constant length; here rod '{rod.name}' is elastic")


def require_class_1(structure: Structure, who: str) -> None:
    """Raise StructureError where rods share nodes; `who` begins the sentence, as "the laws of chapters 4 to 6 are"."""
    if structure.bodies:
        raise StructureError(f"{who} for rods and point masses; here '{structure.bodies[0].name}' is a body")
    shared = _joined(structure)
    if shared:
        raise StructureError(f"{who} for structures of class 1, whose rods share no node; here {shared}")
