"""Events that act on a structure from outside during a scene: loads, breaks, and the law that a file names."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics import kinds
from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.fields import field, value
from tensegrity_mj.basics.texts import value_text
from tensegrity_mj.model.elements.element import Element, as_forces
from tensegrity_mj.model.members import Vector

if TYPE_CHECKING:
    from tensegrity_mj.model.scene import Scene

LoadFunction = Callable[[float], ArrayLike]


OptionValue = float | int | bool | str | list[Any]  # what a controller's option may be in a scene file


@value("load on node {node!r}", whole=True)
class Load:
    """A force on one node, f(t) = force · cos(ω t + phase) [N] in the world frame; constant where ω = phase = 0.

    Attributes:
        node: the node's name.
        force: amplitude [N].
        angular_frequency: ω [rad/s].
        phase: [rad]; -π/2 makes it force · sin(ω t).
    """

    node: str = field(kinds.printable_name())
    force: Vector = field(kinds.vector("N"))
    angular_frequency: float = field(kinds.finite("rad/s"), default=0.0)
    phase: float = field(kinds.finite("rad"), default=0.0)


def loads_kind() -> kinds.Kind:
    """Kind of loads: several `Load`s, or a function of time, which no file can hold."""
    several = kinds.parts(Load, "Load(node, force), or a function t -> (N, 3) in place of them all")
    return several._replace(plain=lambda value: value if callable(value) else several.plain(value))


@dataclass(frozen=True)
class NodalLoads(Element):
    """The `loads` of its scene: `Load`s, or a function of time."""

    smooth = True
    vectorized = True
    compiled = "tensegrity_mj.dynamics.native.loads:pack_loads"
    arrays = "tensegrity_mj.engines.jax.effects:loads"
    label = "loads"

    def act(self, scene: Scene, time: Array | float, nodes: Array, velocities: Array) -> Array:
        times = np.broadcast_to(np.asarray(time, float), nodes.shape[:-2])
        forces = [as_forces(scene.nodal_forces(float(t)), nodes.shape[-2:]) for t in times.ravel()]
        return np.array(forces, float).reshape(nodes.shape)


@value("break of string {string!r}")
class Break:
    """A string that breaks at a time [s], >= 0, and carries nothing from then on; laws do not account for it."""

    string: str = field(kinds.printable_name())
    time: float = field(kinds.not_negative("s"))


def _option(value: Any) -> OptionValue:
    if isinstance(value, (np.ndarray, np.generic)):
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return list(kinds.tuple_of(_option, value))
    if isinstance(value, str):
        return str(kinds.text().plain(value))
    if not isinstance(value, (bool, int, float)) or value != value:
        raise kinds.not_allowed(value, "a number, a text or a truth value, or a list of them")
    return value


def _option_name(given: Any) -> str:
    if not given:
        raise kinds.Wrong("; its name must be a non-empty string")
    return str(kinds.text().plain(given))


def _law_name() -> kinds.Kind:
    """Kind of a law's name: no path and no module, which would run code of the scene's author."""
    name = kinds.printable_name("the name of a law")

    def plain(given: Any) -> str:
        law: str = name.plain(given)
        if ":" in law or law.endswith(".py"):
            raise kinds.Wrong(
                f" = {value_text(law)}; a scene names a law by its name alone, so that no file runs code: give this "
                "one by --law, in Python by from_scene(scene, law), or install it as an entry point tensegrity_mj.laws"
            )
        return law

    return name._replace(plain=plain)


@value("control", whole=True)
class ControlSpec:
    """The control law that a scene is run with by default: the name of a built-in or installed one, and its options.

    Options are numbers, texts, truth values, or (nested) lists of them; tuples and arrays become lists.
    """

    law: str = field(_law_name())
    options: Mapping[str, OptionValue] = field(
        kinds.mapping(
            kinds.Kind(_option_name), kinds.Kind(_option), "a map of each option's name to its value", "option"
        ),
        factory=dict,
    )
