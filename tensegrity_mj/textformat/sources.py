"""Where the text of a scene is: in a file, or in the package."""

from __future__ import annotations

import importlib.resources
import os
from pathlib import Path

from tensegrity_mj.errors import FormatError
from tensegrity_mj.textformat.table import closest


def scene_names() -> list[str]:
    """Names of the scenes that come with the package."""
    folders = importlib.resources.files("tensegrity_mj.models").iterdir()
    return sorted(folder.name for folder in folders if folder.joinpath("scene.toml").is_file())


def find(name_or_path: str | os.PathLike[str]) -> tuple[str, str, Path]:
    """The text of a file or of a scene of the package, what to call it, and the folder it stands in; or FormatError."""
    given = os.fspath(name_or_path)
    if isinstance(name_or_path, str) and not given.endswith(".toml") and not set(given) & {"/", os.sep}:
        if given not in scene_names():
            raise FormatError(
                f"unknown scene '{given}'{closest(given, scene_names())}; known: {', '.join(scene_names())}; "
                "the path of a .toml file works too, and so does a call of a family, as 'tower(stages=10)'"
            )
        path = Path(str(importlib.resources.files("tensegrity_mj.models").joinpath(given, "scene.toml")))
    else:
        path = Path(given)
    return read(path), str(path), path.parent


def read(path: Path) -> str:
    """The text of a file, or FormatError."""
    try:
        return path.read_bytes().decode("utf-8-sig")
    except FileNotFoundError:
        raise FormatError(f"{path}: no such file") from None
    except OSError as error:
        raise FormatError(f"{path}: cannot be read ({error.strerror})") from error
    except UnicodeDecodeError as error:
        raise FormatError(f"{path}: not a text in UTF-8 ({error.reason} at byte {error.start})") from error
