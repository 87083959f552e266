"""Write a scene as MJCF, for any MuJoCo viewer, or as this package's TOML."""

from __future__ import annotations

import argparse

from tensegrity_mj.commands.common import Outcome, output_file


def execute(options: argparse.Namespace) -> Outcome:
    """Write the file."""
    out = output_file(options.out, "--out", (".xml", ".toml"))

    from tensegrity_mj.library.load import load_scene
    from tensegrity_mj.model.text.writing import save_scene

    scene = load_scene(options.scene)
    if out.suffix.lower() == ".toml":
        save_scene(scene, out)
    else:
        from tensegrity_mj.engines.mujoco.mjcf import save_mjcf

        save_mjcf(scene, out)
    return Outcome({"status": "ok", "scene": scene.name, "out": out}, f"{out}")
