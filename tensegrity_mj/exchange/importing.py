"""Scenes from files of other programs: the table of formats, and what came of a file."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from tensegrity_mj.basics.files import write_text
from tensegrity_mj.basics.texts import closest, file_name
from tensegrity_mj.errors import FormatError, OptionError, SceneError, StructureError, printable
from tensegrity_mj.exchange.draft import Draft, ImportOptions
from tensegrity_mj.model.plausibility import warnings_of
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.text.writing import scene_to_toml


@dataclass(frozen=True)
class Format:
    """A format of files: what it is, how the names of its files end, and the module whose `read` makes a draft."""

    title: str
    suffixes: tuple[str, ...]
    home: str


FORMATS = {
    "ntrt": Format("NTRT's YAML structures", (".yaml", ".yml"), "tensegrity_mj.exchange.ntrt"),
    "mat": Format("MATLAB data of STEDY, MOTES, TsgFEM", (".mat",), "tensegrity_mj.exchange.matlab_file"),
    "matlab": Format("MATLAB scripts of STEDY and MOTES", (".m",), "tensegrity_mj.exchange.matlab_script"),
    "csv": Format("tables nodes.csv and members.csv", (".csv",), "tensegrity_mj.exchange.tables"),
    "mjcf": Format("MJCF of capsules and tendons", (".xml", ".mjcf"), "tensegrity_mj.exchange.mjcf"),
}


@dataclass(frozen=True)
class Imported:
    """A scene from a file of another program.

    Attributes:
        scene: the scene.
        notes: what could not be carried over, and what was assumed, a sentence each.
        format: the name of the file's format in `FORMATS`.
    """

    scene: Scene
    notes: tuple[str, ...]
    format: str

    def to_toml(self) -> str:
        """The scene as TOML text, with the notes as comments at its top."""
        heading, _, rest = scene_to_toml(self.scene).partition("\n")
        title = [f"# Imported ({FORMATS[self.format].title}). Differences from the source file:"]
        notes = [f"# - {printable(note)}" for note in self.notes] or ["# - none"]
        return "\n".join([heading, *title, *notes, rest])

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write `to_toml`, atomically; returns the path.

        Raises:
            FormatError: if the file cannot be written.
        """
        return write_text(path, self.to_toml())


def import_scene(
    path: str | os.PathLike[str], format: str | None = None, options: ImportOptions | None = None
) -> Imported:
    """The scene of a file of another program; no code of the file is run.

    Args:
        path: the file.
        format: its name in `FORMATS`; by default what the file's name ends in.
        options: units, and values for what the file does not give.

    Raises:
        OptionError: for a format that does not exist, or a file whose name ends in no known way.
        FormatError, StructureError, SceneError: for what is wrong in the file, with its place.
    """
    file = Path(path)
    if format is not None and format not in FORMATS:
        raise OptionError(f"format = {format!r}{closest(str(format), FORMATS)}; allowed: {', '.join(FORMATS)}")
    name = format or next((key for key, one in FORMATS.items() if file.suffix.lower() in one.suffixes), None)
    if name is None:
        endings = ", ".join(f"{'/'.join(one.suffixes)} ({key})" for key, one in FORMATS.items())
        hint = "; a .toml file is a scene of this package already" if file.suffix == ".toml" else ""
        raise OptionError(f"{file}: no format has such a name: {endings}; name the format (--from){hint}")
    if options is not None and options.unit is not None and name != "ntrt":
        raise OptionError(
            f"unit = {options.unit:g}: only NTRT's files count in a unit of their own; others are in SI units"
        )
    read: Callable[[Path, ImportOptions], Draft] = import_module(FORMATS[name].home).read
    try:
        draft = read(file, options or ImportOptions())
        draft.name = file_name(draft.name)
        scene = draft.scene()
        return Imported(scene, (*draft.notes, *warnings_of(scene.structure)), name)
    except (StructureError, SceneError) as error:
        raise type(error)(f"{file}: {error}") from None
    except FormatError as error:
        raise (
            error if str(error).startswith((str(file), f"{file.parent}/")) else FormatError(f"{file}: {error}")
        ) from None
