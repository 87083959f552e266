"""The law under test as plain values, so that any worker can make it: by name, from a module, or from a file's text.

A law object that no worker could make again stays in this process, and is run there.
"""

from __future__ import annotations

import dataclasses
import hashlib
import importlib
import inspect
import itertools
import os
import sys
import types
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tensegrity_mj.basics.texts import closest
from tensegrity_mj.controllers.gains import Gains
from tensegrity_mj.controllers.known import KnownWater
from tensegrity_mj.controllers.scenes import from_scene
from tensegrity_mj.controllers.table import LAWS
from tensegrity_mj.dynamics.native.law import native_law
from tensegrity_mj.errors import OptionError, TensegrityError
from tensegrity_mj.model.scene import Scene

Spec = dict[str, Any]

_numbers = itertools.count()
_here: dict[str, Any] = {}  # laws that only this process has
_sources: dict[str, types.ModuleType] = {}  # modules made of a file's text, by its digest


def spec_of(law: Any, scene: Scene) -> Spec:
    """What a law is, as plain values.

    Args:
        law: None for the scene's law; the name of a built-in one; "module:name" or "path.py:name"; a law object or a
            function. What a text names may be a law, or a function or class of one argument, the scene, that gives one.
        scene: what it controls.

    Raises:
        OptionError: if there is no such law.
    """
    if law is None:
        if scene.control is None:
            raise OptionError(
                f"scene '{scene.name}' names no control law: choose one of {', '.join(LAWS)}, or give your "
                "own (a function, module:name or path.py:name)"
            )
        return {"kind": "built-in", "name": scene.control.law, "options": {}}
    if isinstance(law, (str, os.PathLike)):
        return _named(os.fspath(law))
    if isinstance(law, type) or not callable(law):
        raise OptionError(f"law = {law!r}: it must be a law, a function (time, nodes, velocities) -> u, or a text")
    return _built_in(law, scene) or _imported(law) or _kept(law, scene)


def is_here(spec: Mapping[str, Any]) -> bool:
    """Whether the law exists in this process only."""
    return bool(spec["kind"] == "object")


def make(spec: Mapping[str, Any], scene: Scene) -> Any:
    """The law of a spec for a scene.

    Raises:
        OptionError: if it cannot be made.
    """
    if spec["kind"] == "built-in":
        return from_scene(scene, spec["name"], **spec["options"])
    if spec["kind"] == "object":
        return _here[spec["key"]]
    module = _module(spec) if spec["kind"] == "file" else _import(spec["module"])
    name = spec["name"]
    if not hasattr(module, name):
        raise OptionError(f"law {_title(spec)}: there is no '{name}' in it")
    found = getattr(module, name)
    return found(scene) if _makes_laws(found) else found


def describe(spec: Mapping[str, Any], law: Any, scene: Scene) -> dict[str, Any]:
    """What a law says of itself, and where it comes from, as plain values."""
    native = native_law(law, scene.structure)
    return {
        "from": spec["name"] if spec["kind"] in ("built-in", "object") else _title(spec),
        **({"sha256": spec["sha256"]} if "sha256" in spec else {}),
        "description": native.description,
        "discontinuous": native.discontinuous,
        "promised_rate": native.decay_rate,
        "has_gains": has_gains(law),
    }


# ----------------------------------------------------------------------------------------------------- variants


def has_gains(law: Any) -> bool:
    """Whether it has gains X, Y, Z of rods in the way of the laws of chapters 5 and 6."""
    return _has(law, "translation") and _has(law, "rotation") and _has(law, "decay_rate")


def with_gain(law: Any, scene: Scene, gain: str, factor: float) -> Any:
    """The law with one of X, Y, Z of all rods, or its decay rate, times a factor.

    Raises:
        OptionError: if gains so scaled are not positive definite.
    """
    if gain == "decay_rate":
        return dataclasses.replace(law, decay_rate=law.decay_rate * factor)
    names = [rod.name for rod in scene.structure.rods] + [point.node for point in scene.structure.point_masses]

    def scaled(given: Any) -> Any:
        every = given if isinstance(given, Mapping) else dict.fromkeys(names, given)
        own = {name: every.get(name, Gains()) for name in names}
        return {
            name: dataclasses.replace(g, **{gain: np.asarray(getattr(g, gain)) * factor}) for name, g in own.items()
        }

    return dataclasses.replace(law, translation=scaled(law.translation), rotation=scaled(law.rotation))


def knows_gravity(law: Any) -> bool:
    """Whether it can be given another gravity."""
    return _has(law, "gravity")


def with_gravity(law: Any, gravity: Any) -> Any:
    """The law for another gravity [m/s²]."""
    return dataclasses.replace(law, gravity=tuple(gravity))


def _has(law: Any, name: str) -> bool:
    return dataclasses.is_dataclass(law) and any(item.name == name and item.init for item in dataclasses.fields(law))


# --------------------------------------------------------------------------------------------------------- specs


def _named(text: str) -> Spec:
    if text in LAWS:
        return {"kind": "built-in", "name": text, "options": {}}
    place, colon, name = text.rpartition(":")
    if not colon or not place or not name.isidentifier():
        raise OptionError(
            f"law = {text!r}: it is no built-in law{closest(text, LAWS)}; built in are {', '.join(LAWS)}; for your own "
            "write module:name or path.py:name"
        )
    if not place.endswith(".py"):
        _import(place)
        return {"kind": "module", "module": place, "name": name}
    path = Path(place)
    try:
        source = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise OptionError(f"law {text}: the file cannot be read ({error})") from error
    digest = hashlib.sha256(source.encode()).hexdigest()
    # The text itself goes to the workers: what is run is what was read, and a changed file makes another study.
    return {
        "kind": "file",
        "file": path.name,
        "folder": str(path.resolve().parent),
        "source": source,
        "sha256": digest,
        "name": name,
    }


def _built_in(law: Any, scene: Scene) -> Spec | None:
    """A built-in law by its options, where that gives the same law again."""
    for name, entry in LAWS.items():
        if type(law) is not entry.law:
            continue
        fields = {item.name for item in dataclasses.fields(law)}
        options = {key: _plain_option(getattr(law, key)) for key in entry.options if key in fields}
        known = [one for one in KnownWater if law.known == ((water,) if (water := one.of(scene.water)) else ())]
        if not known:
            return None
        if known[0] is not KnownWater.ALL:
            options["water"] = known[0].value
        try:
            if (law.structure, law.target, law.gravity) == (scene.structure, scene.target, scene.gravity):
                again = from_scene(scene, name, **options)
                if native_law(again, scene.structure).description == native_law(law, scene.structure).description:
                    return {"kind": "built-in", "name": name, "options": options}
        except (TensegrityError, TypeError, ValueError):
            return None
    return None


def _plain_option(value: Any) -> Any:
    if isinstance(value, Gains):
        return {key: np.asarray(getattr(value, key)).tolist() for key in ("X", "Y", "Z")}
    if isinstance(value, Mapping):
        return {str(key): _plain_option(item) for key, item in value.items()}
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    if isinstance(value, float) and value == np.inf:
        return value
    return getattr(value, "value", value)


def _imported(law: Any) -> Spec | None:
    module, name = getattr(law, "__module__", None), getattr(law, "__qualname__", None)
    if not isinstance(module, str) or not isinstance(name, str) or module == "__main__":
        return None
    if getattr(sys.modules.get(module), name, None) is not law:
        return None
    return {"kind": "module", "module": module, "name": name}


def _kept(law: Any, scene: Scene) -> Spec:
    native_law(law, scene.structure)  # says now what is wrong with it
    key = f"{type(law).__name__} {next(_numbers)}"
    _here[key] = law
    return {"kind": "object", "name": getattr(law, "__name__", type(law).__name__), "key": key}


def _title(spec: Mapping[str, Any]) -> str:
    return f"{spec.get('file') or spec.get('module')}:{spec['name']}"


def _import(name: str) -> types.ModuleType:
    try:
        return importlib.import_module(name)
    except Exception as error:
        raise OptionError(
            f"law: module '{name}' cannot be imported ({type(error).__name__}: {error}); install it, or write "
            "path.py:name"
        ) from error


def _module(spec: Mapping[str, Any]) -> types.ModuleType:
    """The module that a file's text makes; its folder can be imported from, as for a script."""
    if spec["sha256"] not in _sources:
        module = types.ModuleType(Path(spec["file"]).stem)
        module.__file__ = str(Path(spec["folder"]) / spec["file"])
        if spec["folder"] not in sys.path:
            sys.path.append(spec["folder"])
        try:
            exec(compile(spec["source"], module.__file__, "exec"), module.__dict__)
        except Exception as error:
            raise OptionError(f"law {_title(spec)}: the file fails: {type(error).__name__}: {error}") from error
        _sources[spec["sha256"]] = module
    return _sources[spec["sha256"]]


def _makes_laws(found: Callable[..., Any]) -> bool:
    """Whether it takes one argument, the scene, rather than time, nodes and velocities."""
    try:
        parameters = inspect.signature(found).parameters.values()
    except (TypeError, ValueError):
        return isinstance(found, type)
    positional = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    needed = [one for one in parameters if one.kind in positional and one.default is inspect.Parameter.empty]
    return len(needed) == 1
