"""Effects that a law accounts for in addition to strings and gravity: loads, wind, water, elements.

They are part of its model, as gravity is: their forces are known forces, f of (7.1), and what they add to the mass of
rods is mass.
"""

from __future__ import annotations

import enum
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import instance, real_array
from tensegrity_mj.basics.jsontext import plain_values
from tensegrity_mj.dynamics.native import elements, law, pointers
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.capabilities import require_rigid
from tensegrity_mj.model.elements.element import Element
from tensegrity_mj.model.elements.resistance import Resistance
from tensegrity_mj.model.elements.water import Water
from tensegrity_mj.model.events import Load
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.scene_checks import check_target
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.model.target import Target

Effect = Load | Resistance | Water | Element


class KnownWater(enum.Enum):
    """Part of a scene's water that its law accounts for."""

    ALL = "all"  # waves and current as they are
    STILL = "still"  # buoyancy, added mass and drag, as if the water stood still: waves and current are unknown
    NONE = "none"  # a law for dry land

    def of(self, water: Water | None) -> Water | None:
        """Return that part of a scene's water; None for a dry scene."""
        if water is None or self is KnownWater.NONE:
            return None
        return water if self is KnownWater.ALL else replace(water, waves=(), current=(0.0, 0.0, 0.0))


def known_scene(structure: Structure, gravity: tuple[float, float, float], known: Iterable[Effect]) -> Scene:
    """Make the scene of a law's own model, with the effects that the law accounts for.

    Raises:
        OptionError: for what cannot act there, for two waters or resistances, and for elements with a state.
        SceneError: where it does not fit, see `Scene`.
    """
    several = isinstance(known, Iterable) and not isinstance(known, (str, np.ndarray))
    given = list(known) if several else [known]
    of_kind: dict[type, list[Any]] = {Load: [], Resistance: [], Water: [], Element: []}
    for one in given:
        kind = next((kind for kind in of_kind if isinstance(one, kind)), None)
        if kind is None:
            raise OptionError(
                f"known = {known!r}; it must hold what a law is to account for, Load, Resistance, Water or elements, "
                "as in known=(scene.water,)"
            )
        of_kind[kind].append(one)
    for kind in (Resistance, Water):
        if len(of_kind[kind]) > 1:
            raise OptionError(f"known: {len(of_kind[kind])} of {kind.__name__}; a scene has one: leave the others out")
    for one in of_kind[Element]:
        if one.has_state:
            raise OptionError(f"known: {one.label} has a state, which a law does not see: leave it out")
    return Scene(
        structure,
        gravity=gravity,
        loads=tuple(of_kind[Load]),
        resistance=next(iter(of_kind[Resistance]), None),
        water=next(iter(of_kind[Water]), None),
        elements=tuple(of_kind[Element]),
    )


@dataclass(frozen=True, eq=False)
class ModelLaw:
    """A law that has a model of what it controls; `target`, `gravity` and `known` are kept in one form.

    Attributes:
        structure: the law's own model of the structure (masses, supports, lengths), without strings with mass.
        target: set-point, path or curve; an array (N, 3) counts as a set-point.
        gravity: g [m/s²] that the law accounts for.
        known: other effects that the law accounts for: `Load`s, a `Resistance`, `Water`, elements, as (scene.water,).
        model: the scene in which these act.

    Raises:
        OptionError, SceneError: for what cannot be its model, and for a bad target.
    """

    structure: Structure
    target: Target | Array
    gravity: tuple[float, float, float] = field(default=(0.0, 0.0, 0.0), kw_only=True)
    known: Sequence[Effect] = field(default=(), kw_only=True)
    model: Scene = field(init=False, repr=False)

    command = law.Command.FORCE_DENSITY

    def __post_init__(self) -> None:
        instance("structure", self.structure, Structure, "use a Structure (scene.structure)")
        require_rigid(self.structure, "the laws of chapters 4 to 6 (use one of your own, a recording, or none) are")
        if self.target is None:
            raise OptionError("target = None: the law needs a target; give node positions (N, 3) or a Target")
        structure = self.structure.massless
        target = self.target if isinstance(self.target, Target) else Target.set_point(self.target)
        check_target(structure, target)
        x, y, z = real_array("gravity", self.gravity, (3,), "m/s²", scalar=False).tolist()
        model = known_scene(structure, (x, y, z), self.known)
        loads: Any = model.loads  # no function here
        known = tuple(one for one in (*loads, model.resistance, model.water, *model.elements) if one is not None)
        fields = {"structure": structure, "target": target, "gravity": (x, y, z), "known": known, "model": model}
        for name, value in fields.items():
            object.__setattr__(self, name, value)


class _Errors(list[Any]):
    """List of errors, without the elements that raised them."""

    def append(self, failed: tuple[Element, BaseException]) -> None:
        super().append(failed[1])


class PackedEffects:
    """Effects that a law accounts for, packed for `dynamics.native.elements.known_forces`; to be kept alive.

    Attributes:
        address: address of the table, 0 where nothing is known of.
        failure: the exception of an element in Python, in a list of at most one.
        in_python: whether there may be such elements.
    """

    def __init__(self, scene: Scene) -> None:
        self.failure: list[BaseException] = _Errors()
        self._elements = [elements.native_element(one, scene, self.failure) for one in scene.effects]
        self.in_python = any(not one.context for one in self._elements)
        records = [number for one in self._elements for number in (one.address, one.context)]
        self._table = np.array([len(self._elements), *records], np.int64)
        self.address = pointers.address_of(self._table) if self._elements else 0


def described(known: Iterable[Effect]) -> dict[str, Any]:
    """Plain values for the provenance of a run; nothing where nothing is known of."""
    found: dict[str, Any] = {}
    for one in known:
        if isinstance(one, Water):
            found["water"] = {
                **plain_values(one, "density", "current", "drag", "tangential_drag", "added_mass"),
                "waves": len(one.waves),
                "inertia": one.inertia_coefficient,
            }
        else:
            found.setdefault("known", []).append(repr(one))
    return found
