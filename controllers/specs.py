"""A law as plain values, its spec, so that any process can make it: by name, from a module, or from a file's text.

A law object that no other process could make stays in this one, and is run there. The spec of a user-defined law has
the digest of its source, so that a study knows a law that has changed for another one.
"""

from __future__ import annotations

import dataclasses
import itertools
import os
import sys
from collections.abc import Mapping
from typing import Any

from tensegrity_mj.basics.jsontext import plain
from tensegrity_mj.controllers.known import KnownWater
from tensegrity_mj.controllers.own import OwnLaw, Spec, digest_of, found, imported, is_of_text, is_own, named, title_of
from tensegrity_mj.controllers.scenes import SCENE_LAW, from_scene, law_named
from tensegrity_mj.controllers.table import LAWS, NamedLaw, built_in
from tensegrity_mj.dynamics.native.law import native_law
from tensegrity_mj.errors import OptionError, TensegrityError
from tensegrity_mj.model.scene import Scene

_numbers = itertools.count()
NO_LAW: Spec = {"kind": "built-in", "name": "none", "options": {}}
_here: dict[str, Any] = {}  # laws that only this process has


def spec_of(law: Any, scene: Scene, options: Mapping[str, Any] | None = None) -> Spec:
    """Describe a law by plain values, from which it can be made again.

    Args:
        law: SCENE_LAW for the scene's; None or "none" for none; a name of `LAWS`; "module:name" or "path.py:name"; a
            law object or a function. What a text names may be a law, or a function or class of the scene that makes
            one (see `own`).
        scene: the scene that it controls.
        options: options of a law that is given by a text, by their names.

    Raises:
        OptionError: if there is no such law, and for options of none or of an object, which has been made with its own.
    """
    given = dict(options or {})
    if law is SCENE_LAW and scene.control is not None:
        return _of_name(scene.control.law, given)
    if law is None or law is SCENE_LAW or (isinstance(law, str) and law == "none"):
        if given:
            raise OptionError(f"law_options: {', '.join(given)}: there is no law that could have them; give law, too")
        return NO_LAW
    if isinstance(law, (str, os.PathLike)):
        return _of_text(os.fspath(law), given)
    if isinstance(law, type) or not callable(law):
        raise OptionError(f"law = {law!r}: it must be a law, a function (time, nodes, velocities) -> u, or a text")
    if given:
        raise OptionError(f"law_options: {', '.join(given)}: they are for laws that a text names; make it with its own")
    return _built_in(law, scene) or _imported(law) or _registered(law, scene)


def is_here(spec: Mapping[str, Any]) -> bool:
    """Return whether the law exists in this process only."""
    return bool(spec["kind"] == "object")


def make(spec: Mapping[str, Any], scene: Scene, more: Mapping[str, Any] | None = None) -> Any:
    """The law of a spec for a scene, with more options than it holds; None for NO_LAW.

    Raises:
        OptionError: if it cannot be made.
    """
    options = {**spec.get("options", {}), **(more or {})}
    if spec == NO_LAW:
        return None
    if spec["kind"] == "built-in":
        return from_scene(scene, spec["name"], **options)
    if spec["kind"] == "object":
        return _here[spec["key"]]
    return found(spec).make(scene, options)


def own_of(spec: Mapping[str, Any]) -> OwnLaw | None:
    """Return the law that a spec names if it is user-defined or of an installed package, otherwise None.

    Raises:
        OptionError: if its file fails, its module cannot be imported, or it has no such name.
    """
    if spec["kind"] == "built-in":
        entry = LAWS.get(spec["name"])
        return entry if isinstance(entry, OwnLaw) else None
    return None if is_here(spec) else found(spec)


def describe(spec: Mapping[str, Any], law: Any, scene: Scene) -> dict[str, Any]:
    """Collect a law's own description and its origin, as plain values."""
    native = native_law(law, scene.structure)
    return {
        "from": spec["name"] if spec["kind"] in ("built-in", "object") else title_of(spec),
        **({"sha256": spec["sha256"]} if "sha256" in spec else {}),
        **({"options": spec["options"]} if "sha256" in spec and spec["options"] else {}),
        "description": native.description,
        "discontinuous": native.discontinuous,
        "promised_rate": native.decay_rate,
        "has_gains": has_gains(law),
    }


def has_gains(law: Any) -> bool:
    """Return whether a law has gains X, Y, Z of rods like the laws of chapters 5 and 6."""
    return all(has_option(law, name) for name in ("translation", "rotation", "decay_rate"))


def has_option(law: Any, name: str) -> bool:
    """Return whether `dataclasses.replace` can set an option of that name."""
    return dataclasses.is_dataclass(law) and any(item.name == name and item.init for item in dataclasses.fields(law))


def _of_name(name: str, options: dict[str, Any]) -> Spec:
    spec: Spec = {"kind": "built-in", "name": name, "options": options}
    if name not in LAWS or name in built_in():
        return spec
    home = getattr(LAWS[name].found, "__module__", None)  # type: ignore[union-attr]
    return spec | (digest_of(imported(home)) if isinstance(home, str) else {})


def _of_text(text: str, options: dict[str, Any]) -> Spec:
    if text in LAWS:
        return _of_name(text, options)
    if not is_own(text):
        law_named(text, "law")  # which says what there is
    return named(text) | {"options": options}


def _built_in(law: Any, scene: Scene) -> Spec | None:
    """A built-in law by its options, where that gives the same law again."""
    for name in built_in():
        entry = LAWS[name]
        if not (isinstance(entry, NamedLaw) and type(law) is entry.law and dataclasses.is_dataclass(entry.law)):
            continue
        fields = {item.name for item in dataclasses.fields(law)}
        options = {key: plain(getattr(law, key)) for key in entry.options if key in fields}
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


def _imported(law: Any) -> Spec | None:
    module, name = getattr(law, "__module__", None), getattr(law, "__qualname__", None)
    if not isinstance(module, str) or not isinstance(name, str) or module == "__main__" or is_of_text(module):
        return None
    home = sys.modules.get(module)
    if home is None or getattr(home, name, None) is not law:
        return None
    return {"kind": "module", "module": module, "name": name, "options": {}, **digest_of(home)}


def _registered(law: Any, scene: Scene) -> Spec:
    if OwnLaw(getattr(law, "__name__", type(law).__name__), law).makes:
        raise OptionError(
            f"law {law!r}: what makes a law must stand at the top of its module, where it can be imported"
        )
    native_law(law, scene.structure)  # says now what is wrong with it
    key = f"{type(law).__name__} {next(_numbers)}"
    _here[key] = law
    return {"kind": "object", "name": getattr(law, "__name__", type(law).__name__), "key": key, "options": {}}
