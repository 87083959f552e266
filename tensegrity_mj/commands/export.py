"""Write a scene for other programs: MJCF, TOML, tables, MATLAB data, a shape to print; or a recorded run as a table."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import parse

import tensegrity_mj.exchange as exchange
import tensegrity_mj.library as library
from tensegrity_mj import model, runs
from tensegrity_mj.basics.files import checked
from tensegrity_mj.commands.common import Outcome, refuse

SUFFIXES = (".xml", ".toml", ".csv", ".mat", ".stl")
OF_RUNS = (".csv", ".mat")  # of a run: its data, not those of its scene


def execute(options: argparse.Namespace) -> Outcome:
    """Write the file, and say on stderr what it does not hold; or the folder of the benchmark pack."""
    if options.scene == "pack":
        refuse(options, ("for", "scale"), "means nothing for the pack")
        written = exchange.save_pack(options.out)
        return Outcome({"status": "ok", "out": options.out, "files": written}, "\n".join(map(str, written)))
    out = checked(options.out, SUFFIXES, "--out")
    suffix = out.suffix.lower()
    if suffix != ".xml":
        refuse(options, ("for",), "is for MJCF (.xml)")
    if suffix != ".stl":
        refuse(options, ("scale",), "is for shapes (.stl)")

    run = runs.Trajectory.load(options.scene) if options.scene.lower().endswith(".nc") else None
    scene = library.load_scene(options.scene) if run is None else run.scene
    files: list[Path] = [out]
    notes: list[str] = []
    if run is not None and suffix in OF_RUNS:
        run.save(out)
    elif suffix == ".toml":
        model.save_scene(scene, out)
    elif suffix == ".csv":
        files, notes = exchange.save_csv(scene, out)
    elif suffix == ".mat":
        _, notes = exchange.save_mat(scene, out)
    elif suffix == ".stl":
        exchange.save_stl(scene, out, 1.0 if options.scale is None else options.scale)
    else:
        files, notes = exchange.save_mjcf_for(scene, out, getattr(options, "for"))
    data = {"status": "ok", "scene": scene.name, "out": out}
    more: dict[str, Any] = {"files": files, "notes": notes} if notes or len(files) > 1 else {}
    said = [f"note: {note}" for note in notes]
    if suffix == ".xml":
        from tensegrity_mj.engines.mujoco.mjcf_versions import oldest

        more["oldest_mujoco"] = oldest(parse(files[0]).getroot())
        said.append(f"loads in MuJoCo {more['oldest_mujoco']} and newer")
    return Outcome(data | more, "\n".join(map(str, files)), notes=said)
