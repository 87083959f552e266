"""The thesis' control laws, one a file: state in, string force densities out."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from tensegrity_mj.controllers.lyapunov import Gains, Lyapunov
from tensegrity_mj.controllers.replay import Replay
from tensegrity_mj.errors import OptionError
from tensegrity_mj.scene import Scene

__all__ = ["Gains", "Lyapunov", "Replay", "from_scene"]

LAWS = ("lyapunov",)
LYAPUNOV_OPTIONS = ("decay_rate", "norm", "translation", "rotation", "minimum_force_density")


def from_scene(scene: Scene, **overrides: Any) -> Lyapunov:
    """The law that a scene names in its `control`, with the scene's target and gravity; `overrides` win.

    Options in a scene file are those of the law's class; `norm` may be "inf", and `translation` and `rotation` are
    tables {X = , Y = , Z = } of numbers or matrices, or tables of such by rod name.

    Raises:
        OptionError: if the scene names no law or an unknown one, or an option that the law has not.
    """
    if not isinstance(scene, Scene):
        raise OptionError(f"scene = {scene!r}; use a Scene, or load_scene(name or path)")
    if scene.control is None:
        raise OptionError(f"scene '{scene.name}' names no control law: add [scene.control], or make a law yourself")
    if scene.control.law not in LAWS:
        raise OptionError(f"scene '{scene.name}': unknown law '{scene.control.law}'; allowed: {', '.join(LAWS)}")
    options: dict[str, Any] = {**scene.control.options, **overrides}
    for name in options:
        if name not in LYAPUNOV_OPTIONS:
            raise OptionError(
                f"scene '{scene.name}': law 'lyapunov' has no option '{name}'; allowed: {', '.join(LYAPUNOV_OPTIONS)}"
            )
    if options.get("norm") == "inf":
        options["norm"] = math.inf
    for name in ("translation", "rotation"):
        if name in options:
            options[name] = _gains(options[name], f"scene '{scene.name}': {name}")
    if scene.target is None:
        raise OptionError(f"scene '{scene.name}' has no target, which its law needs: add [scene.target]")
    return Lyapunov(scene.structure, scene.target, gravity=scene.gravity, **options)


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
