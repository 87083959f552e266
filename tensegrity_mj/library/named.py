"""Scenes by name, path or the call of a family, a text such as "tower(stages=10, stiffness=2e4)".

The call is one of a family with literals for arguments: numbers, texts in quotes, True, False, None, and tuples or
lists of them; options that are enums in Python are given by the text of their value. Nothing of it is executed.
"""

from __future__ import annotations

import ast
import inspect
import os
import re
import typing
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any

from tensegrity_mj.basics.dependencies import EVIDENCE_MISSING, installed, load
from tensegrity_mj.basics.hints import fitted
from tensegrity_mj.basics.texts import closest, value_text
from tensegrity_mj.errors import FormatError
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.model.text.reading import scene_from_toml, structure_from_toml
from tensegrity_mj.model.text.sources import find

_HOME = {
    "cable": "cable",
    "cross": "cross",
    "fish_net": "fish_farm",
    "moored_chain": "fish_farm",
    "icosahedron": "six_bar",
    "net": "hanging",
    "planar_beam": "planar_beam",
    "prism": "prism",
    "six_bar_roll": "rolling",
    "superball": "six_bar",
    "spine": "spine",
    "suspended_cable": "hanging",
    "three_bar_robot": "prism",
    "tower": "tower",
    "truss_arm": "truss_arm",
}
OF_EVIDENCE = ("appendix_beam", "beam_in_waves", "chapter7_tower", "tower_in_waves")
MOST_LETTERS = 10_000  # of a call
_CALL = re.compile(r"\s*[^\W\d]\w*\s*\(")


def family_names() -> list[str]:
    """Names of the families that a text can call: those of the package, and of installed ones."""
    return sorted(_HOME.keys() | installed("families").keys())


def is_family_call(text: str) -> bool:
    """Return whether a text is meant as a call of a family: a name with "(", and no path of a .toml file."""
    return _CALL.match(text) is not None and not text.endswith(".toml")


def family_scene(text: str, changes: Mapping[str, Any] | None = None) -> Scene:
    """The scene that a call in a text makes.

    Args:
        changes: values of arguments that replace those of the text, or add to them.

    Raises:
        FormatError: for a text that is no such call, an unknown family, and arguments that it does not have.
        OptionError, InfeasibleError, StructureError, SceneError: from the family, for what it cannot build.
    """
    shown = text if len(text) <= 80 else text[:77] + "..."
    if len(text) > MOST_LETTERS:
        raise FormatError(f"{shown}: a call of {len(text)} characters; at most {MOST_LETTERS} are read")
    try:
        call = ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        why = error.msg if isinstance(error, SyntaxError) else "it is nested too deeply, or a number is too long"
        raise FormatError(f"{shown}: {why}; write a family and its arguments, as tower(stages=10)") from None
    if not isinstance(call, ast.Call) or not isinstance(call.func, ast.Name):
        raise FormatError(f"{shown}: it must be one call of a family by its name, as tower(stages=10)")
    name = call.func.id
    builder = _builder(name, shown)
    scene = builder(**_arguments(name, call, builder, changes or {}))
    if not isinstance(scene, Scene):
        raise FormatError(f"{name}: this family made {value_text(scene)}; it must make a Scene")
    return scene


def _builder(name: str, shown: str) -> Callable[..., Any]:
    """The family of a name: of this package, else of an installed one (entry points of `tensegrity_mj.families`)."""
    if name in _HOME:
        return getattr(import_module(f"tensegrity_mj.library.{_HOME[name]}"), name)
    point = installed("families").get(name)
    if point is not None:
        return load(point)
    if name in OF_EVIDENCE:
        raise FormatError(f"{shown}: family '{name}' {EVIDENCE_MISSING}")
    known = family_names()
    raise FormatError(f"{shown}: unknown family '{name}'{closest(name, known)}; families: {', '.join(known)}")


def _arguments(name: str, call: ast.Call, builder: Callable[..., Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """The arguments of a call and of changes to it by name, as the family takes them."""
    parameters = inspect.signature(builder).parameters
    places = [key for key, one in parameters.items() if one.kind is one.POSITIONAL_OR_KEYWORD]
    if len(call.args) > len(places):
        raise FormatError(
            f"{name}: {len(call.args)} arguments without a name, and it takes {len(places)} ({', '.join(places)}); "
            "give the others by name"
        )
    given: dict[str, ast.expr] = dict(zip(places, call.args, strict=False))
    for keyword in call.keywords:
        key = keyword.arg
        if key is None:
            raise FormatError(f"{name}: ** is no literal; write every argument by its name")
        if key in given:
            raise FormatError(f"{name}: argument '{key}' is given twice")
        given[key] = keyword.value
    for key in (*given, *changes):
        if key not in parameters:
            raise FormatError(
                f"{name}: unknown argument '{key}'{closest(key, parameters)}; it has {', '.join(parameters)}"
            )
    known = given.keys() | changes.keys()
    missing = [key for key, one in parameters.items() if one.default is one.empty and key not in known]
    if missing:
        raise FormatError(f"{name}: argument '{missing[0]}' is missing; it needs a value")
    values = dict(changes)
    for key, node in given.items():
        if key in changes:
            continue
        try:
            values[key] = ast.literal_eval(node)
        except (ValueError, TypeError, SyntaxError, RecursionError, MemoryError):
            raise FormatError(
                f"{name}: {key} = {ast.unparse(node)} is no literal; write a number, a text in quotes, True, False, "
                "None, or a tuple of them"
            ) from None
    own = inspect.unwrap(builder)
    if hasattr(own, "__item__"):  # of a value class, whose fields check what they are given
        return values
    hints = typing.get_type_hints(own)
    return {key: fitted(f"{name}: {key}", value, hints.get(key), FormatError) for key, value in values.items()}


def load_scene(name_or_path: str | os.PathLike[str]) -> Scene:
    """The scene of that name in the package (see `scene_names`), in that .toml file, or of a call of a family.

    A text such as "tower(stages=10)" is a call of a family, see `library.named`. Another text without a path separator
    that does not end in .toml is a name.

    Raises:
        FormatError: if there is no such scene, file or family, or it is not of this format.
        StructureError, SceneError: if what it describes is not valid.
        OptionError, InfeasibleError: if a family cannot build what is wanted of it.
    """
    called = _called(name_or_path)
    if called is not None:
        return called
    text, where, folder = find(name_or_path)
    return scene_from_toml(text, where, folder, _made)


def load_structure(name_or_path: str | os.PathLike[str]) -> Structure:
    """The structure of a file, of a scene of the package, or of a family's; named, and failing, as `load_scene`."""
    called = _called(name_or_path)
    if called is not None:
        return called.structure
    text, where, folder = find(name_or_path)
    return structure_from_toml(text, where, folder, _made)


def _made(text: str) -> Structure | None:
    called = _called(text)
    return None if called is None else called.structure


def _called(name_or_path: str | os.PathLike[str]) -> Scene | None:
    """The scene of a family's call, or None where it is none."""
    if not isinstance(name_or_path, str) or not is_family_call(name_or_path):
        return None
    return family_scene(name_or_path)
