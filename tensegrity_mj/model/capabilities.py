"""What scenes have that not every engine simulates (`Trait`), and how an engine says what it cannot (`Descriptor`).

The engines' own are in `engines.table`; `engines.requirements.require` holds a scene against them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from tensegrity_mj.errors import SceneError, StructureError, TensegrityError

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
        shares_model: whether one compiled model of it makes many runs at a time (`simulate_many`, `law_in`).
    """

    title: str
    place: str
    fixed_step: Mapping[str, Any] = field(default_factory=dict)
    limits: tuple[Limit, ...] = ()
    shares_model: bool = False


def _joined(structure: Structure) -> str:
    if structure.class_number <= 1:
        return ""
    name = next(name for name, rows in structure.rods_at.items() if len(rows) > 1)
    rods = " and ".join(f"'{structure.rods[row].name}'" for row in structure.rods_at[name][:2])
    return f"rods {rods} share node '{name}'"


def _closed(structure: Structure) -> str:
    from tensegrity_mj.model.forest import spanning_forest

    closures = spanning_forest(structure).closures
    return f"rods close a loop at node '{structure.node_names[closures[0][0]]}'" if closures else ""


def _first(items: list[str]) -> str:
    return items[0] if items else ""


def _added(scene: Scene) -> str:
    return _first([f"{one.label} adds mass to rods" for one in scene.effects if one.adds_mass])


def _uneven(scene: Scene) -> str:
    return _first([f"the mass that {one.label} adds is not symmetric" for one in scene.effects if not one.symmetric])


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


def _contact(scene: Scene) -> str:
    return "" if scene.contact is None else f"scene '{scene.name}' has contact"


def _joined_rods(scene: Scene) -> str:
    return _joined(scene.structure)


def _constrained(scene: Scene) -> str:
    return _first([f"constraint '{one.name}' holds nodes" for one in scene.structure.constraints])


def _pushing(scene: Scene) -> str:
    structure = scene.structure
    pairs = zip(structure.strings, structure.clipped, strict=True)
    return _first([f"string '{one.name}' is damped and not clipped" for one, kept in pairs if one.damping and not kept])


def _string_that(words: str, has: Callable[[Any], bool]) -> Callable[[Scene], str]:
    """Words for the first string of a scene that has something."""
    return lambda scene: _first([f"string '{one.name}' {words}" for one in scene.structure.strings if has(one)])


def _bodies(scene: Scene) -> str:
    return _first([f"'{body.name}' is a body (structure.bodies)" for body in scene.structure.bodies])


def _elastic(scene: Scene) -> str:
    return _first([f"rod '{rod.name}' is elastic" for rod in scene.structure.rods if rod.stiffness is not None])


def _elastic_between(scene: Scene) -> str:
    """An elastic rod that something holds between its ends."""
    held = [rod for rod in scene.structure.rods if rod.stiffness is not None and rod.support.directions]
    return _first([f"elastic rod '{rod.name}' is held between its ends" for rod in held if rod.support.sigma % 1])


CONTACT = Trait("contact", _contact)
ELASTIC = Trait("elastic rods", _elastic)
ELASTIC_JOINED = Trait("elastic rods in a structure whose rods share nodes", _and(_elastic, _joined_rods))
ELASTIC_CONTACT = Trait("elastic rods and contact", _and(_elastic, _contact))
ELASTIC_ADDED_MASS = Trait("elastic rods and added mass", _and(_elastic, _added))
ELASTIC_HELD_BETWEEN = Trait("elastic rods held between their ends", _elastic_between)
BODIES = Trait("bodies", _bodies)
BODIES_IN_CONTACT = Trait("bodies and contact", _and(_bodies, _contact))
CLASS_K = Trait("rods that share nodes", _joined_rods)
CLOSED_LOOPS = Trait("closed loops", lambda scene: _closed(scene.structure))
MOVED_SUPPORTS = Trait(
    "moved supports",
    lambda scene: f"support '{scene.motions[0].support}' moves (scene.motions)" if scene.motions else "",
)
BREAKS = Trait(
    "strings that break",
    lambda scene: f"string '{scene.breaks[0].string}' breaks (scene.breaks)" if scene.breaks else "",
)
ADDED_MASS = Trait("added mass", _added)
UNEVEN_MASS = Trait("added mass that is not symmetric, on rods that share nodes", _and(_uneven, _joined_rods))
CONSTRAINTS = Trait("linear constraints on nodes", _constrained)
ELEMENTS = Trait(
    "elements beside loads",
    lambda scene: _first([f"{one.label} acts on nodes" for one in scene.effects if one.label != "loads"]),
)
ELEMENT_STATES = Trait(
    "elements with a state",
    lambda scene: _first([f"{one.label} has a state (state0)" for one in scene.elements if one.has_state]),
)
PUSHING_DAMPERS = Trait("damped strings that are not clipped", _pushing)
YIELDING = Trait("strings that yield", _string_that("yields", lambda one: one.yields))
NOT_LINEAR = Trait(
    "strings that are not linear", _string_that("has a curve, or a constant force", lambda one: not one.is_linear)
)
OWN_LAWS = Trait("strings with a law of their own", _string_that("has a string_law", lambda one: one.string_law))
JOINED_CONTACT = Trait("contact of rods that share nodes", _and(_contact, _joined_rods))
ADDED_MASS_IN_CONTACT = Trait("contact and added mass", _and(_added, _contact))
CONSTRAINTS_IN_CONTACT = Trait("contact and linear constraints", _and(_constrained, _contact))
CONSTRAINTS_IN_LOOPS = Trait(
    "closed loops and linear constraints", _and(_constrained, lambda scene: _closed(scene.structure))
)
ADDED_MASS_IN_LOOPS = Trait("closed loops and added mass", _and(_added, lambda scene: _closed(scene.structure)))


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
