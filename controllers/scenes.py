"""The law that a scene names, or that a scene is given by a text."""

from __future__ import annotations

import enum
from collections.abc import Callable, Mapping
from typing import Any, Final, Literal

from numpy.typing import ArrayLike

from tensegrity_mj.basics import checks, hints, texts
from tensegrity_mj.controllers.known import KnownWater
from tensegrity_mj.controllers.own import OwnLaw, found, is_own, named
from tensegrity_mj.controllers.table import LAWS, NamedLaw
from tensegrity_mj.dynamics.native.law import Law
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.scene import Scene


class SceneLaw(enum.Enum):
    """The default of every call that runs a scene under a law."""

    SCENE_LAW = "the scene's own law"

    def __repr__(self) -> str:
        return self.name


SCENE_LAW: Final[Literal[SceneLaw.SCENE_LAW]] = SceneLaw.SCENE_LAW
AnyLaw = Law | Callable[..., ArrayLike] | SceneLaw | None


def law_for(scene: Scene, law: Any) -> Any:
    """Return the law that a call runs: for SCENE_LAW the scene's own, None where it has none; any other unchanged.

    Raises:
        OptionError: where the scene's own law cannot be made.
    """
    if law is not SCENE_LAW:
        return law
    return None if scene.control is None else from_scene(scene)


def from_scene(scene: Scene, law: str | None = None, **overrides: Any) -> Any:
    """The law that a scene names in its `control`, or `law`, with the scene's target, gravity and water.

    `law` is a name of `LAWS`, or "path.py:name" or "module:name" of a law of your own (docs/own-law.md). `overrides`
    win over the scene's options.

    A built-in law other than the scene's takes those of the scene's options that it has too. Options in a scene file
    are those of the law's class; `norm` may be "inf", `onto` is "current" or "target", gains are tables {X = , Y = ,
    Z = } of numbers or matrices, or tables of such by rod name, `water` is a `KnownWater` by name.

    Raises:
        OptionError: if there is no law or an unknown one, no target, no string, or an option that the law has not; if
            a law of your own cannot be made.
    """
    checks.instance("scene", scene, Scene, "use a Scene, or load_scene(name or path)")
    where = f"scene '{scene.name}'"
    name = law if law is not None else named_in(scene)
    entry = law_named(name, where)
    given: dict[str, Any] = {}
    if scene.control is not None:
        own = scene.control.law == name
        shared = entry.options if isinstance(entry, NamedLaw) else {}
        given = {key: value for key, value in scene.control.options.items() if own or key in shared}
    given.update(overrides)
    if not scene.structure.strings:
        raise OptionError(
            f"{where}: law '{name}' commands strings, and its structure '{scene.structure.name}' has none: leave the "
            "law out"
        )
    return entry.make(scene, given) if isinstance(entry, OwnLaw) else _made(entry, name, scene, given)


def named_in(scene: Scene) -> str:
    """The name of the scene's own law; OptionError where it has none."""
    if scene.control is None:
        raise OptionError(
            f"scene '{scene.name}' names no control law: add [scene.control], or choose one of {', '.join(LAWS)}, or "
            "path.py:name or module:name of your own"
        )
    return scene.control.law


def law_named(name: Any, where: str) -> NamedLaw | OwnLaw:
    """Return the law of a name, or of a text with a colon or the path of a Python file.

    Raises:
        OptionError: if it is none; `where` begins the message.
    """
    if isinstance(name, str) and is_own(name):
        return found(named(name))
    if not isinstance(name, str) or name not in LAWS:
        meant = texts.closest(name, LAWS) if isinstance(name, str) else ""
        raise OptionError(
            f"{where}: unknown law {name!r}{meant}; allowed: {', '.join(LAWS)}, and path.py:name or module:name of "
            "your own"
        )
    return LAWS[name]


def _made(entry: NamedLaw, name: str, scene: Scene, given: Mapping[str, Any]) -> Any:
    """A built-in law with options as files hold them."""
    where = f"scene '{scene.name}'"
    for key in given:
        if key not in entry.options:
            allowed = f"{texts.closest(key, entry.options)}; allowed: {', '.join(entry.options)}"
            raise OptionError(f"{where}: law '{name}' has no option '{key}'{allowed}")
    if scene.target is None and entry.needs_target:
        raise OptionError(
            f"{where} has no target, which its law needs: add [scene.target], or run it without a law "
            "(controller=None, --law none)"
        )
    options = {key: hints.fitted(f"{where}: {key}", value, entry.options[key]) for key, value in given.items()}
    water = options.pop("water", KnownWater.ALL).of(scene.water)
    known = () if water is None else (water,)
    return entry.law(scene.structure, scene.target, gravity=scene.gravity, known=known, **options)
