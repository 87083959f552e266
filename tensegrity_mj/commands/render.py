"""Make a film of one recorded run, or of two, side by side or one over the other; or a still for a paper."""

from __future__ import annotations

import argparse
from typing import Any

from tensegrity_mj import pictures, runs
from tensegrity_mj.basics.files import checked
from tensegrity_mj.commands import experiment
from tensegrity_mj.commands.common import Outcome, finite, refuse
from tensegrity_mj.errors import OptionError

FILMS = (".mp4", ".webm", ".gif")
FILM_OPTIONS = ("size", "fps", "speed", "thickness")  # `film` of shared.toml
USUAL: dict[str, Any] = {"size": (1280, 720), "fps": 30.0, "speed": 1.0}


def moment(text: str) -> float:
    """argparse type: a time [s], written 1.5 or t=1.5."""
    return finite(text.removeprefix("t=").removesuffix("s"))


def film_of(options: argparse.Namespace) -> dict[str, Any]:
    """Keyword arguments of `render` from those of `FILM_OPTIONS` that were given."""
    given = {name: getattr(options, name) for name in FILM_OPTIONS}
    return {name: value for name, value in given.items() if value is not None}


def execute(options: argparse.Namespace) -> Outcome:
    out = checked(options.out, (*FILMS, ".html") if options.still is None else (".png",), "--out")
    if len(options.runs) > 2:
        raise OptionError(f"render {' '.join(options.runs)}: give one or two files, not {len(options.runs)}")
    if len(options.runs) == 1:
        refuse(options, ("layout",), "needs two files")
    if options.still is not None:
        refuse(options, ("layout", "fps", "speed"), "belongs to a film, which --still is not")
    if out.suffix.lower() == ".html":
        if len(options.runs) > 1:
            raise OptionError(f"--out {out}: a page in 3-D shows one run, not {len(options.runs)}; name one, or a film")
        refuse(options, FILM_OPTIONS, "belongs to a film, and --out names a page")
        page = pictures.make_web_page(runs.Trajectory.load(options.runs[0]))
        page.save(out)
        return Outcome({"status": "ok", "out": out, "frames": page.frames}, f"{out}: {page.describe()}")

    shown = [runs.Trajectory.load(path) for path in options.runs]
    experiment.require_off_screen_opengl()
    other = shown[1] if len(shown) > 1 else None
    film = film_of(options)
    if options.still is not None:
        pictures.still(shown[0], out, options.still, dpi=options.dpi or 300.0, other=other, **film)
        return Outcome({"status": "ok", "out": out, "time": options.still}, str(out))
    film = USUAL | film
    layout = pictures.Layout(options.layout or "overlay")
    pictures.render(shown[0], out, other=other, layout=layout, progress=True, **film)
    duration = float(max(run.time[-1] for run in shown)) / film["speed"]
    return Outcome(
        {"status": "ok", "out": out, "size": film["size"], "fps": film["fps"], "duration": duration}, str(out)
    )
