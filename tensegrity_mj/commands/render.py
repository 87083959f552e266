"""Make a video of one recorded run, or of two, side by side or one over the other."""

from __future__ import annotations

import argparse

from tensegrity_mj.commands import experiment
from tensegrity_mj.commands.common import Outcome, output_file, refuse
from tensegrity_mj.errors import OptionError


def execute(options: argparse.Namespace) -> Outcome:
    """Draw the video."""
    out = output_file(options.out, "--out", (".mp4",))
    if len(options.runs) > 2:
        raise OptionError(f"render {' '.join(options.runs)}: give one or two files, not {len(options.runs)}")
    if len(options.runs) == 1:
        refuse(options, ("layout",), "needs two files")

    from tensegrity_mj.pictures.video import render
    from tensegrity_mj.pictures.view import Layout
    from tensegrity_mj.runs.trajectory import Trajectory

    runs = [Trajectory.load(path) for path in options.runs]
    experiment.require_off_screen_opengl()
    render(
        runs[0],
        out,
        other=runs[1] if len(runs) > 1 else None,
        layout=Layout.SIDE_BY_SIDE if options.layout == "side-by-side" else Layout.OVERLAY,
        size=options.size,
        fps=options.fps,
        speed=options.speed,
        progress=True,
    )
    data = {
        "status": "ok",
        "out": out,
        "size": options.size,
        "fps": options.fps,
        "duration": float(max(run.time[-1] for run in runs)) / options.speed,
    }
    return Outcome(data, str(out))
