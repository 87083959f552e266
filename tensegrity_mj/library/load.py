"""Scenes and structures by name, path or the call of a family."""

from __future__ import annotations

import os

from tensegrity_mj.library.named import family_scene, is_family_call
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.model.text.reading import scene_from_toml, structure_from_toml
from tensegrity_mj.model.text.sources import find


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
