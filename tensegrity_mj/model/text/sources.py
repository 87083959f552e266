"""Sources of a scene's text: a file, or the package."""

from __future__ import annotations

import importlib.resources
import os
from pathlib import Path

from tensegrity_mj.basics.files import content_of
from tensegrity_mj.basics.texts import closest
from tensegrity_mj.errors import FormatError
from tensegrity_mj.model.text.keys import MOST_BYTES


def scene_names(within: str = "") -> list[str]:
    """Names of the scenes that come with the package, or of those in a folder of them."""
    folders = importlib.resources.files("tensegrity_mj.models").joinpath(within).iterdir()
    return sorted(within + folder.name for folder in folders if folder.joinpath("scene.toml").is_file())


def pack_names() -> list[str]:
    """Names of the scenes of the benchmark pack (docs/benchmark.md): "pack/free", ..."""
    return scene_names("pack/")


def find(name_or_path: str | os.PathLike[str]) -> tuple[str, str, Path]:
    """The text of a file or of a scene of the package, what to call it, and the folder it stands in; or FormatError."""
    given = os.fspath(name_or_path) if isinstance(name_or_path, (str, os.PathLike)) else None
    if not isinstance(given, str):
        raise FormatError(
            f"scene = {name_or_path!r}; it must be the name of a scene, the path of a .toml file, or a family's call"
        )
    named = isinstance(name_or_path, str) and not given.endswith(".toml")
    packed = given in pack_names() or (named and given.startswith("pack/") and not os.path.exists(given))
    if packed or (named and not set(given) & {"/", os.sep}):
        known = pack_names() if packed else scene_names()
        if given not in known:
            raise FormatError(
                f"unknown scene '{given}'{closest(given, known)}; known: {', '.join(known)}; "
                "the path of a .toml file works too, and so does a call of a family, as 'tower(stages=10)'"
            )
        path = Path(str(importlib.resources.files("tensegrity_mj.models").joinpath(given, "scene.toml")))
    else:
        path = Path(given)
    return read(path), str(path), path.parent


def read(path: Path) -> str:
    """The text of a regular file of at most `MOST_BYTES`, or FormatError."""
    try:
        return content_of(path, MOST_BYTES).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise FormatError(f"{path}: not a text in UTF-8 ({error.reason} at byte {error.start})") from error
