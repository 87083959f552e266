"""The benchmark pack as a folder for other programs: each scene as TOML, tables and MJCF, with its reference."""

from __future__ import annotations

import os
from pathlib import Path

from tensegrity_mj.basics.files import made_folder, said_in_comments, write_text
from tensegrity_mj.basics.units import quantity
from tensegrity_mj.engines.mujoco.mjcf import save_mjcf
from tensegrity_mj.errors import OptionError
from tensegrity_mj.exchange.tables import save_csv
from tensegrity_mj.model.text.reading import scene_from_toml
from tensegrity_mj.model.text.sources import find, pack_names, read

COPIED = ("scene.toml", "reference.csv")


def save_pack(folder: str | os.PathLike[str]) -> list[Path]:
    """Write the whole pack, and a README; returns the paths of all files.

    Raises:
        OptionError: where no folder can be made, or it holds files and is no pack.
        FormatError: if a file cannot be written.
    """
    files = [made_folder(folder) / "README.md"]
    text = Path(__file__).with_suffix(".md").read_text(encoding="utf-8")
    own = files[0].is_file() and files[0].read_text(encoding="utf-8", errors="replace").startswith(text.splitlines()[0])
    if not own and any(files[0].parent.iterdir()):
        raise OptionError(
            f"{folder} holds other files, which the pack's might replace: name a folder that is new or empty"
        )
    for name in pack_names():
        scene_text, where, source = find(name)
        scene, place = scene_from_toml(scene_text, where), made_folder(files[0].parent / source.name)
        for copied in COPIED:
            write_text(place / copied, read(source / copied))
        save_mjcf(scene, place / "scene.xml")
        tables, notes = save_csv(scene, place / "nodes.csv")
        files += [place / "scene.xml", *tables, *(place / copied for copied in COPIED)]
        said = said_in_comments(read(source / COPIED[1]).splitlines())
        absent = "; ".join(note for note in notes if "gravity" not in note) or "-"
        bar, weight = quantity(said["error"], "m", 2), f"{abs(scene.gravity[2]):g} m/s²"
        text += f"| {source.name} | {said['about']} | {weight} | {absent} | {bar} |\n"
    write_text(files[0], text)
    return files
