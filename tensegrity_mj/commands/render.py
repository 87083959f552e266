"""Make a film of one recorded run, or of two, side by side or one over the other; or a still for a paper."""

from __future__ import annotations

import argparse

from tensegrity_mj.commands import experiment
from tensegrity_mj.commands.common import Outcome, finite, output_file, refuse
from tensegrity_mj.errors import OptionError

FILMS = (".mp4", ".webm", ".gif")
FPS = 30.0


def moment(text: str) -> float:
    """argparse type: a time [s], written 1.5 or t=1.5."""
    return finite(text.removeprefix("t=").removesuffix("s"))


def execute(options: argparse.Namespace) -> Outcome:
    """Draw the video."""
    out = output_file(options.out, "--out", FILMS if options.still is None else (".png",))
    if len(options.runs) > 2:
        raise OptionError(f"render {' '.join(options.runs)}: give one or two files, not {len(options.runs)}")
    if len(options.runs) == 1:
        refuse(options, ("layout",), "needs two files")
    if options.still is None:
        refuse(options, ("dpi",), "needs --still TIME")
    else:
        refuse(options, ("layout", "fps", "speed"), "belongs to a film, which --still is not")

    from tensegrity_mj.pictures.video import render, still
    from tensegrity_mj.pictures.view import Layout, ViewOptions
    from tensegrity_mj.runs.trajectory import Trajectory

    runs = [Trajectory.load(path) for path in options.runs]
    experiment.require_off_screen_opengl()
    other = runs[1] if len(runs) > 1 else None
    if options.still is not None:
        view: ViewOptions = {} if options.size is None else {"size": options.size}
        view["thickness"] = options.thickness
        still(runs[0], out, options.still, dpi=options.dpi or 300.0, other=other, **view)
        return Outcome({"status": "ok", "out": out, "time": options.still}, str(out))
    size = options.size or (1280, 720)
    render(
        runs[0],
        out,
        other=other,
        layout=Layout.SIDE_BY_SIDE if options.layout == "side-by-side" else Layout.OVERLAY,
        fps=options.fps or FPS,
        speed=options.speed or 1.0,
        progress=True,
        size=size,
        thickness=options.thickness,
    )
    data = {
        "status": "ok",
        "out": out,
        "size": size,
        "fps": options.fps or FPS,
        "duration": float(max(run.time[-1] for run in runs)) / (options.speed or 1.0),
    }
    return Outcome(data, str(out))
