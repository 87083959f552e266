"""A plant (or a law) that is not as stated: one quantity in error, to see which rows of the ledger notice it."""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from tensegrity_mj.basics.fields import field, value
from tensegrity_mj.basics.kinds import choice, positive
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.elements.resistance import nodal_damping
from tensegrity_mj.model.members import Rod
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.model.target import Target


class Quantity(enum.Enum):
    """Quantities that are in error.

    MASS: of rods; of a hanging cable those between its ends, since one factor on all of them changes nothing there.
    STIFFNESS: of strings, at their rest lengths.
    DAMPING: of strings, of joints, and by fluids and water.
    GAIN: the decay rate, or the natural frequency, that the law is given.
    GEOMETRY: all lengths of rods, places of supports, targets and a cable's markers; rest lengths of strings stay.
    """

    MASS = "mass"
    STIFFNESS = "stiffness"
    DAMPING = "damping"
    GAIN = "gain"
    GEOMETRY = "geometry"


# The option of each law that is its gain.
GAINS = {"feedback_linearization": "natural_frequency", "lyapunov": "decay_rate", "projection": "decay_rate"}
DEFAULT_GAIN = 1.0  # of every law that is given none


@value("disturbance", OptionError)
class Disturbance:
    """One quantity, and the factor that it is wrong by.

    Raises:
        OptionError: for another quantity, or a factor that is not positive.
    """

    quantity: Quantity = field(choice(Quantity))
    factor: float = field(positive())

    @property
    def plain(self) -> list[Any]:
        """Plain values, for files and tasks."""
        return [self.quantity.value, self.factor]

    def __str__(self) -> str:
        return f"{self.quantity.value} x {self.factor:g}"


def disturbance_of(plain: Any) -> Disturbance | None:
    """The disturbance of plain values; None for None."""
    return None if plain is None else Disturbance(Quantity(plain[0]), plain[1])


def disturbed(scene: Scene, disturbance: Disturbance | None, rods: slice = slice(None)) -> Scene:
    """The scene with its error; itself where there is none, or where the scene lacks what is in error.

    Args:
        rods: of which the mass is in error.
    """
    if disturbance is None:
        return scene
    structure, factor = scene.structure, disturbance.factor
    match disturbance.quantity:
        case Quantity.MASS:
            chosen = set(range(len(structure.rods))[rods])
            heavy = tuple(_heavier(rod, factor) if k in chosen else rod for k, rod in enumerate(structure.rods))
            points = tuple(_times(point, factor, "mass") for point in structure.point_masses)
            bodies = tuple(one.times(factor) for one in structure.bodies)
            return scene.with_(structure=replace(structure, rods=heavy, point_masses=points, bodies=bodies))
        case Quantity.STIFFNESS:
            if not structure.strings:
                return scene
            stiffness = [factor * string.stiffness for string in structure.strings]
            return scene.with_(structure=_cut(structure).with_strings(stiffness=stiffness))
        case Quantity.DAMPING:
            return _damped(scene, factor)
        case Quantity.GEOMETRY:
            return _scaled(scene, factor)
    return scene  # of the gain: the law's


def disturbed_options(
    scene: Scene, law: str | None, options: Mapping[str, Any], disturbance: Disturbance | None
) -> dict[str, Any]:
    """The options that a law of a scene is given in place of the scene's, with their error."""
    if disturbance is None or disturbance.quantity is not Quantity.GAIN:
        return dict(options)
    own = {} if scene.control is None else scene.control.options
    name = GAINS[str(law if law is not None or scene.control is None else scene.control.law)]
    return {**options, name: disturbance.factor * options.get(name, own.get(name, DEFAULT_GAIN))}


def _cut(structure: Structure) -> Structure:
    """The structure with rest lengths where strings are given by tensions or force densities."""
    strings = tuple(
        string
        if string.tension is None and string.force_density is None
        else replace(string, rest_length=float(length), tension=None, force_density=None)
        for string, length in zip(structure.strings, structure.rest_lengths, strict=True)
    )
    return replace(structure, strings=strings)


def _damped(scene: Scene, factor: float) -> Scene:
    changes: dict[str, Any] = {}
    structure = scene.structure
    if any(string.damping for string in structure.strings):
        changes["structure"] = structure.with_strings(damping=[factor * one.damping for one in structure.strings])
    if len(nodal_damping(structure)[0]):
        points = tuple(_times(point, factor, "damping") for point in structure.point_masses)
        changes["structure"] = replace(changes.get("structure", structure), point_masses=points)
    if scene.resistance is not None:
        given = scene.resistance
        drag, bending = _times(given.drag, factor, "normal", "tangential"), _times(given.bending, factor, "damping")
        changes["resistance"] = replace(_times(given, factor, "viscous"), drag=drag, bending=bending)
    if scene.water is not None:
        changes["water"] = _times(scene.water, factor, "drag", "tangential_drag")
    return scene.with_(**changes) if changes else scene


def _times(item: Any, factor: float, *names: str) -> Any:
    """The item with these of its numbers times a factor; None for None."""
    return None if item is None else replace(item, **{name: factor * getattr(item, name) for name in names})


def _heavier(rod: Rod, factor: float) -> Rod:
    """The rod and what it carries, times a factor."""
    carried = tuple(_times(one, factor, "mass", "inertia") for one in rod.masses)
    return replace(rod, mass=factor * rod.mass, masses=carried)


def _scaled(scene: Scene, factor: float) -> Scene:
    structure = _cut(scene.structure)
    rods = tuple(_scaled_support(rod, factor) for rod in structure.rods)
    nodes = dict(zip(structure.nodes, (factor * structure.positions).tolist(), strict=True))
    changes: dict[str, Any] = {"structure": replace(structure, nodes=nodes, rods=rods)}
    for name in ("initial_nodes", "initial_velocities"):
        if getattr(scene, name) is not None:
            changes[name] = factor * np.asarray(getattr(scene, name))
    if scene.target is not None:
        changes["target"] = _scaled_target(scene.target, factor)
    return scene.with_(**changes)


def _scaled_support(rod: Rod, factor: float) -> Rod:
    values = rod.support.values
    if values is None:
        return rod
    return replace(rod, support=replace(rod.support, values=tuple(factor * value for value in values)))


def _scaled_target(target: Target, factor: float) -> Target:
    if target.along is None:
        return Target.path(target.times, factor * np.asarray(target.nodes))
    return replace(target, along=replace(target.along, shapes=factor * np.asarray(target.along.shapes)))
