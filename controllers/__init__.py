"""The thesis' control laws, one a file: state in, string force densities out."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from tensegrity_mj.controllers import feedback_linearization
from tensegrity_mj.controllers.allocation_options import Allocation, Sum, WhenInfeasible
from tensegrity_mj.controllers.degraded import Delayed, Noisy
from tensegrity_mj.controllers.feedback_linearization import FeedbackLinearization
from tensegrity_mj.controllers.gains import Gains
from tensegrity_mj.controllers.known_water import KnownWater
from tensegrity_mj.controllers.lyapunov import Lyapunov
from tensegrity_mj.controllers.projection import Projection
from tensegrity_mj.controllers.quadratic_terms import Onto
from tensegrity_mj.controllers.replay import Replay
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.scene import Scene

__all__ = [
    "LAWS",
    "Allocation",
    "Delayed",
    "FeedbackLinearization",
    "Gains",
    "KnownWater",
    "Lyapunov",
    "Noisy",
    "Onto",
    "Projection",
    "Replay",
    "Sum",
    "WhenInfeasible",
    "from_scene",
]


class _Entry(NamedTuple):
    """A law that scene files and the command line can name."""

    law: Callable[..., Any]  # (structure, target, *, gravity, water, **options)
    options: Mapping[str, Callable[[Any, str], Any]]  # by name: (value as in a file, what it is) -> the law's value


def from_scene(scene: Scene, law: str | None = None, **overrides: Any) -> Any:
    """The law that a scene names in its `control`, or `law`, with the scene's target, gravity and water.

    `overrides` win over the scene's options.

    A law other than the scene's takes those of the scene's options that it has too. Options in a scene file are those
    of the law's class; `norm` may be "inf", `onto` is "current" or "target", gains are tables {X = , Y = , Z = } of
    numbers or matrices, or tables of such by rod name, `water` is a `KnownWater` by name.

    Raises:
        OptionError: if there is no law or an unknown one, no target, no string, or an option that the law has not.
    """
    if not isinstance(scene, Scene):
        raise OptionError(f"scene = {scene!r}; use a Scene, or load_scene(name or path)")
    where = f"scene '{scene.name}'"
    if law is None and scene.control is None:
        raise OptionError(f"{where} names no control law: add [scene.control], or choose one: {', '.join(LAWS)}")
    name = law if law is not None else scene.control.law  # type: ignore[union-attr]
    if not isinstance(name, str) or name not in LAWS:
        raise OptionError(f"{where}: unknown law {name!r}; allowed: {', '.join(LAWS)}")
    entry = LAWS[name]
    given: dict[str, Any] = {}
    if scene.control is not None:
        own = scene.control.law == name
        given = {key: value for key, value in scene.control.options.items() if own or key in entry.options}
    given.update(overrides)
    for key in given:
        if key not in entry.options:
            raise OptionError(f"{where}: law '{name}' has no option '{key}'; allowed: {', '.join(entry.options)}")
    if scene.target is None:
        raise OptionError(f"{where} has no target, which its law needs: add [scene.target]")
    if not scene.structure.strings:
        raise OptionError(
            f"{where}: law '{name}' commands strings, and its structure '{scene.structure.name}' has none: leave the "
            "law out"
        )
    options = {key: entry.options[key](value, f"{where}: {key}") for key, value in given.items()}
    water = options.pop("water", KnownWater.ALL).of(scene.water)
    return entry.law(scene.structure, scene.target, gravity=scene.gravity, water=water, **options)


def _as_it_is(value: Any, what: str) -> Any:
    return value


def _norm(value: Any, what: str) -> Any:
    return math.inf if value == "inf" else value


def _gains(value: Any, what: str) -> Gains | dict[str, Gains]:
    if isinstance(value, Gains):
        return value
    if not isinstance(value, Mapping):
        raise OptionError(f"{what} = {value!r}; it must be a table with X, Y, Z, or one by rod name")
    if set(value) <= {"X", "Y", "Z"}:
        return Gains(**value)
    gains: dict[str, Gains] = {}
    for name, entry in value.items():
        if isinstance(entry, Gains):
            gains[name] = entry
        elif isinstance(entry, Mapping) and set(entry) <= {"X", "Y", "Z"}:
            gains[name] = Gains(**entry)
        else:
            raise OptionError(f"{what}.{name} = {entry!r}; it must be a table with X, Y, Z")
    return gains


def _onto(value: Any, what: str) -> Any:
    names = [one.value for one in Onto]
    if isinstance(value, str) and value not in names:
        raise OptionError(f"{what} = {value!r}; allowed: {', '.join(names)}")
    return Onto(value) if isinstance(value, str) else value


def _known_water(value: Any, what: str) -> Any:
    names = [one.value for one in KnownWater]
    if not isinstance(value, KnownWater) and value not in names:
        raise OptionError(f"{what} = {value!r}; allowed: {', '.join(names)}")
    return KnownWater(value)


def _when_infeasible(value: Any, what: str) -> Any:
    names = [one.value for one in WhenInfeasible]
    if isinstance(value, str) and value not in names:
        raise OptionError(f"{what} = {value!r}; allowed: {', '.join(names)}")
    return WhenInfeasible(value) if isinstance(value, str) else value


_QUADRATIC = {
    "decay_rate": _as_it_is,
    "norm": _norm,
    "translation": _gains,
    "rotation": _gains,
    "minimum_force_density": _as_it_is,
    "maximum_force_density": _as_it_is,
    "respect_limits": _as_it_is,
    "water": _known_water,
}

_LINEARIZING: dict[str, Callable[[Any, str], Any]] = {
    "natural_frequency": _as_it_is,
    "damping": _as_it_is,
    "sums": _as_it_is,
    "weight": _as_it_is,
    "minimum_force_density": _as_it_is,
    "maximum_force_density": _as_it_is,
    "linear": _as_it_is,
    "on_infeasible": _when_infeasible,
    "respect_limits": _as_it_is,
    "water": _known_water,
}

LAWS: Mapping[str, _Entry] = {
    "lyapunov": _Entry(Lyapunov, _QUADRATIC),
    "feedback_linearization": _Entry(feedback_linearization.from_options, _LINEARIZING),
    "projection": _Entry(Projection, {**_QUADRATIC, "onto": _onto, "stiffness": _as_it_is}),
}
