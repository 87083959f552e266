"""Write a scene as MJCF, for any MuJoCo viewer, or as this package's TOML; or a recorded run as a table."""

from __future__ import annotations

import argparse

from tensegrity_mj.commands.common import Outcome, output_file
from tensegrity_mj.errors import OptionError

OF_SCENES, OF_RUNS = (".xml", ".toml"), (".csv", ".mat")


def execute(options: argparse.Namespace) -> Outcome:
    """Write the file; that of a run's scene too."""
    out = output_file(options.out, "--out", (*OF_SCENES, *OF_RUNS))

    from tensegrity_mj.library.load import load_scene
    from tensegrity_mj.model.text.writing import save_scene
    from tensegrity_mj.runs.trajectory import Trajectory

    run = Trajectory.load(options.scene) if options.scene.lower().endswith(".nc") else None
    if run is None and out.suffix.lower() in OF_RUNS:
        raise OptionError(
            f"--out {out}: a table is written of a run, and '{options.scene}' is a scene: first "
            f"tensegrity-mj run {options.scene} --out run.nc, then export run.nc"
        )
    scene = run.scene if run is not None else load_scene(options.scene)
    if run is not None and out.suffix.lower() in OF_RUNS:
        run.save(out)
    elif out.suffix.lower() == ".toml":
        save_scene(scene, out)
    else:
        from tensegrity_mj.engines.mujoco.mjcf import save_mjcf

        save_mjcf(scene, out)
    return Outcome({"status": "ok", "scene": scene.name, "out": out}, f"{out}")
