"""Reads structures and scenes from texts and files."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from tensegrity_mj.errors import FormatError, SceneError, StructureError
from tensegrity_mj.scene import Scene
from tensegrity_mj.structure import Structure
from tensegrity_mj.textformat.keys import FILE_KEYS, FORMAT, SCENE_KEYS, STRUCTURE_KEYS
from tensegrity_mj.textformat.parsing import parse
from tensegrity_mj.textformat.scenes import scene_of
from tensegrity_mj.textformat.sources import find, read
from tensegrity_mj.textformat.structures import structure_of
from tensegrity_mj.textformat.table import Table, shown

T = TypeVar("T")


def load_scene(name_or_path: str | os.PathLike[str]) -> Scene:
    """The scene of that name in the package (see `scene_names`), in that .toml file, or of a call of a family.

    A text such as "tower(stages=10)" is a call of a family, see `families.named`. Another text without a path separator
    that does not end in .toml is a name.

    Raises:
        FormatError: if there is no such scene, file or family, or it is not of this format.
        StructureError, SceneError: if what it describes is not valid.
        OptionError, InfeasibleError: if a family cannot build what it is asked for.
    """
    called = _called(name_or_path)
    if called is not None:
        return called
    text, where, folder = find(name_or_path)
    return scene_from_toml(text, where, folder)


def load_structure(name_or_path: str | os.PathLike[str]) -> Structure:
    """The structure of a file, of a scene of the package, or of a family's; named, and failing, as `load_scene`."""
    called = _called(name_or_path)
    if called is not None:
        return called.structure
    text, where, folder = find(name_or_path)
    return structure_from_toml(text, where, folder)


def scene_from_toml(text: str, where: str = "TOML text", folder: Path | None = None) -> Scene:
    """The scene that a TOML text describes.

    Args:
        text: the text.
        where: what error messages call it.
        folder: what a `structure = "other.toml"` in it is relative to; without one it is refused.
    """
    top = _top(text, where)
    structure = _read_structure(top, folder)
    return _validated(where, lambda: scene_of(top, structure))


def structure_from_toml(text: str, where: str = "TOML text", folder: Path | None = None) -> Structure:
    """The structure that a TOML text describes; a [scene] in it is checked for its keys only."""
    return _read_structure(_top(text, where), folder)


def _called(name_or_path: str | os.PathLike[str]) -> Scene | None:
    """The scene of a family's call, or None where it is none."""
    from tensegrity_mj.families.named import family_scene, is_family_call  # which takes `closest` from here

    if not isinstance(name_or_path, str) or not is_family_call(name_or_path):
        return None
    return family_scene(name_or_path)


def _top(text: str, where: str) -> Table:
    data = parse(text, where)
    if "format" not in data:
        raise FormatError(f"{where}: 'format' is missing; a file of this format starts with: format = {FORMAT}")
    if type(data["format"]) is not int or data["format"] != FORMAT:
        raise FormatError(f"{where}: format = {shown(data['format'])}; this version reads format = {FORMAT}")
    top = Table(data, where, "", FILE_KEYS)
    top.table("scene", SCENE_KEYS)
    return top


def _read_structure(top: Table, folder: Path | None) -> Structure:
    if isinstance(top.data.get("structure"), str):
        return _other_structure(top, folder)
    if "structure" not in top.data:
        raise top.fail("structure", "a table [structure], or the path of the file that holds it")
    table = top.table("structure", STRUCTURE_KEYS)
    assert table is not None
    return _validated(top.where, lambda: structure_of(table, top.text("name")))


def _other_structure(top: Table, folder: Path | None) -> Structure:
    reference = top.text("structure")
    if folder is None:
        raise top.fail("structure", "a table here: a text on its own has no folder that a path could be relative to")
    path = folder / reference
    other = _top(read(path), str(path))
    if isinstance(other.data.get("structure"), str):
        raise FormatError(
            f"{top.where}: structure = '{reference}', which refers to another file in turn: name that file here"
        )
    return _read_structure(other, None)


def _validated(where: str, build: Callable[[], T]) -> T:
    """What `build` returns; an error of validation gets the file in front."""
    try:
        return build()
    except (StructureError, SceneError) as error:
        raise type(error)(f"{where}: {error}") from error
