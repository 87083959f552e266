"""Reads structures and scenes from texts and files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from tensegrity_mj.errors import FormatError, SceneError, StructureError
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.model.text.keys import FILE_KEYS, FORMAT, SCENE_KEYS, STRUCTURE_KEYS
from tensegrity_mj.model.text.parsing import parse
from tensegrity_mj.model.text.scenes import scene_of
from tensegrity_mj.model.text.sources import read
from tensegrity_mj.model.text.structures import structure_of
from tensegrity_mj.model.text.table import Table, shown

T = TypeVar("T")


Families = Callable[[str], Structure | None]  # the structure that a call of a family makes; None for another text


def scene_from_toml(
    text: str, where: str = "TOML text", folder: Path | None = None, families: Families | None = None
) -> Scene:
    """The scene that a TOML text describes.

    Args:
        text: the text.
        where: what error messages call it.
        folder: what a `structure = "other.toml"` and a record in it are relative to; without one they are refused.
        families: what reads a `structure = "tower(stages=3)"` in it; without one that is the path of a file.
    """
    top = _top(text, where)
    structure = _read_structure(top, folder, families)
    return _validated(where, lambda: scene_of(top, structure, folder))


def structure_from_toml(
    text: str, where: str = "TOML text", folder: Path | None = None, families: Families | None = None
) -> Structure:
    """The structure that a TOML text describes; a [scene] in it is checked for its keys only."""
    return _read_structure(_top(text, where), folder, families)


def _top(text: str, where: str) -> Table:
    data = parse(text, where)
    if "format" not in data:
        raise FormatError(f"{where}: 'format' is missing; a file of this format starts with: format = {FORMAT}")
    if type(data["format"]) is not int or data["format"] != FORMAT:
        raise FormatError(f"{where}: format = {shown(data['format'])}; this version reads format = {FORMAT}")
    top = Table(data, where, "", FILE_KEYS)
    if "scene" in data:
        top.inside("scene", SCENE_KEYS)
    return top


def _read_structure(top: Table, folder: Path | None, families: Families | None = None) -> Structure:
    if isinstance(top.data.get("structure"), str):
        called = None if families is None else families(top.data["structure"])
        return _other_structure(top, folder) if called is None else called
    need = "a table [structure], or the path of the file that holds it"
    table = top.inside("structure", STRUCTURE_KEYS, need)
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
