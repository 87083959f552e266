"""Traits of scenes that not every engine simulates (`Trait`), and descriptions of engines' limits (`Descriptor`).

The engines' own are in `engines.table`; `require` there holds a scene against them.
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
    """Property that a scene may have: `find` describes the first item of a scene with it, "" where there is none."""

    find: Callable[[Scene], str]

    def __and__(self, other: Trait) -> Trait:
        """Return the trait of scenes that have both."""

        def find(scene: Scene) -> str:
            first = self.find(scene)
            second = other.find(scene) if first else ""
            return f"{first}, and {second}" if second else ""

        return Trait(find)


@dataclass(frozen=True)
class Limit:
    """Limit of an engine, or of a function that uses engines.

    Attributes:
        trait: which scenes it refuses.
        reason: why, by physics or by method.
        remedy: the change that helps.
        error: the class that is raised.
        setting: describes the options with which an engine (its argument) has this limit, "" for others; None: always.
    """

    trait: Trait
    reason: str
    remedy: str
    error: type[TensegrityError] = SceneError
    setting: Callable[[Any], str] | None = None


@dataclass(frozen=True)
class Descriptor:
    """Description of an engine and its limits, in the attribute `descriptor` of its class.

    Attributes:
        title: its name in texts and figures.
        place: its class, a frozen value of options with `run(request)`, as "module:class".
        fixed_step: the options with which it takes steps of `timestep` by the classical Runge-Kutta method.
        limits: traits of scenes that it cannot simulate; none for an engine that simulates all scenes.
        shares_model: whether one compiled model of it makes many runs at a time (`simulate_many`).
        extra: installs the additional packages that it needs; studies leave it out unless it is named.
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


def _held(scene: Scene) -> str:
    from tensegrity_mj.model.elements.contact import holds_spin

    return "contact holds the spin of rods" if holds_spin(scene) else ""


def _pushing(scene: Scene) -> str:
    pairs = zip(scene.structure.strings, scene.structure.clipped, strict=True)
    names = (string.name for string, clipped in pairs if string.damping and not clipped)
    return next((f"string '{name}' is damped and not clipped" for name in names), "")


def _dry(scene: Scene) -> str:
    resistance, bodies = scene.resistance, [body for body in scene.structure.bodies if not body.held]
    fluids = ["water (no buoyancy, no drag)"] if scene.water is not None else []
    if resistance is not None and (resistance.viscous or resistance.drag is not None):
        fluids.append("resistance (viscous, drag)")
    if not bodies or not fluids:
        return ""
    more = f" and {len(bodies) - 1} more" if len(bodies) > 1 else ""
    return f"body '{bodies[0].name}'{more} feel{'' if more else 's'} nothing of the scene's {' and '.join(fluids)}"


def _first(template: str, members: str, has: Callable[[Any], Any] = lambda one: True) -> Trait:
    """Trait of scenes one of whose members, as "structure.rods", has something; the first fills in the template."""
    of = attrgetter(members)
    return Trait(lambda scene: next((template.format(one) for one in of(scene) if has(one)), ""))


CONTACT = Trait(lambda scene: "" if scene.contact is None else f"scene '{scene.name}' has contact")
HELD_SPIN = Trait(_held)


def _contact_with(words: str, has: Callable[[Any], Any]) -> Trait:
    """Trait of scenes whose contact has something."""
    return Trait(
        lambda scene: f"scene '{scene.name}' has {words}" if scene.contact is not None and has(scene.contact) else ""
    )


CONTACT_OF_RODS = _contact_with("contact of rods with each other (rods = true)", lambda one: one.rods)
TERRAIN = _contact_with("a terrain", lambda one: one.terrain is not None)
TURNING_FRICTION = _contact_with("friction of turning or rolling", lambda one: one.torsion or one.rolling)
COULOMB = _contact_with("contact by the law 'coulomb'", lambda one: one.law.value == "coulomb")
ELASTIC = _first("rod '{0.name}' is elastic", "structure.rods", lambda rod: rod.stiffness is not None)
ELASTIC_HELD_BETWEEN = _first(
    "elastic rod '{0.name}' is held between its ends",
    "structure.rods",
    lambda rod: rod.stiffness is not None and rod.support.directions and rod.support.sigma % 1,
)
BODIES = _first("'{0.name}' is a body (structure.bodies)", "structure.bodies")
DRY_BODIES = Trait(_dry)  # bodies in a fluid, which they do not feel
CLASS_K = Trait(lambda scene: _joined(scene.structure))  # rods that share nodes
CLOSED_LOOPS = Trait(_closed)
MOVED_SUPPORTS = _first("support '{0.support}' moves (scene.motions)", "motions")
BREAKS = _first("string '{0.string}' breaks (scene.breaks)", "breaks")
ADDED_MASS = _first("{0.label} adds mass to rods", "adding_mass")
UNEVEN_MASS = _first("the mass that {0.label} adds is not symmetric", "adding_mass", lambda one: not one.symmetric)
CONSTRAINTS = _first("constraint '{0.name}' holds nodes", "structure.constraints")
ELEMENTS = _first("{0.label} acts on nodes", "effects", lambda one: one.label != "loads")
NO_ARRAYS = _first("{0.label} has no array function (arrays)", "effects", lambda one: not one.arrays)
FUNCTION_LOADS = Trait(
    lambda scene: f"the loads of scene '{scene.name}' are a Python function" if callable(scene.loads) else ""
)
FUNCTION_MOTIONS = _first(
    "the motion of '{0.support}' is a Python function", "motions", lambda motion: motion.function is not None
)
ELEMENT_STATES = _first("{0.label} has a state (state0)", "elements", lambda one: one.has_state)
LATER_START = Trait(lambda scene: f"it starts at {scene.start_time:g} s (start_time)" if scene.start_time else "")
PUSHING_DAMPERS = Trait(_pushing)
YIELDING = _first("string '{0.name}' yields", "structure.strings", lambda one: one.yields)
NOT_LINEAR = _first(
    "string '{0.name}' has a curve, or a constant force", "structure.strings", lambda one: not one.is_linear
)


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
