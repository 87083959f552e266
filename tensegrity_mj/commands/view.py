"""Look at a scene or at a recorded run: in MuJoCo's interactive viewer, or as one web page in 3-D.

A scene is simulated in the viewer as it is looked at, with its law; a recorded run is played. With --web, a scene is
simulated first, for its duration.
"""

from __future__ import annotations

import argparse
import contextlib
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import tensegrity_mj.library as library
from tensegrity_mj import model, pictures, runs, studies
from tensegrity_mj.basics.files import checked
from tensegrity_mj.basics.texts import file_name
from tensegrity_mj.commands import experiment
from tensegrity_mj.commands.common import Outcome, code_of_status, refuse
from tensegrity_mj.engines.table import make_engine
from tensegrity_mj.errors import OptionError, printable

_OF_SCENES = ("duration", "still", "law", *experiment.LAW_OPTIONS, *experiment.ACTUATION_OPTIONS)


def execute(options: argparse.Namespace) -> Outcome:
    """Check all options first; then write the page, or open the window."""
    recorded = options.source.lower().endswith(".nc")
    if recorded:
        refuse(options, _OF_SCENES, f"needs a scene, and {options.source} is a recorded run")
    else:
        experiment.check_control(options)
    if options.web is not None:
        refuse(options, ("speed", "thickness"), "belongs to the window; a page has a choice of its own")
        return _write_page(options, recorded)

    from tensegrity_mj.pictures import viewer

    if recorded:
        viewer.play(runs.Trajectory.load(options.source), options.speed or 1.0, thickness=bool(options.thickness))
        return Outcome({"status": "ok", "source": options.source, "shown": "recorded"})
    return _view_scene(options)


def _write_page(options: argparse.Namespace, recorded: bool) -> Outcome:
    from tensegrity_mj.pictures.web import plotly_script

    out = checked(options.web, (".html", ".htm"), "--web") if options.web else None
    plotly_script()
    load: Callable[[str], runs.Trajectory | model.Scene] = runs.Trajectory.load if recorded else library.load_scene
    source = load(options.source)
    name = file_name(source.name) if isinstance(source, model.Scene) else Path(options.source).stem
    out = out or checked(f"{name}.html", (".html",), "--web")
    if isinstance(source, model.Scene) and options.still is None:
        source = _simulated(options, source)
    page = pictures.make_web_page(source)
    page.save(out)
    data = {"status": "ok", "out": out, "frames": page.frames, "interval": page.interval}
    if recorded or isinstance(source, model.Scene):
        return Outcome(data, f"{out}: {page.describe()}")
    return Outcome(data | {"status": source.status}, f"{out}: {page.describe()}", code_of_status(source.status))


def _simulated(options: argparse.Namespace, scene: model.Scene) -> runs.Trajectory:
    law, actuation = experiment.law_of(options, scene), experiment.actuation_of(options)
    return experiment.simulated(options, scene, law, make_engine("mujoco", {}), actuation, options.duration)


def _view_scene(options: argparse.Namespace) -> Outcome:
    """Simulate a scene in the window; where that cannot be, before, and play the run."""
    from tensegrity_mj.model.actuation import Mode
    from tensegrity_mj.pictures import viewer

    scene = library.load_scene(options.source)
    law, reason = experiment.law_of(options, scene), ""
    viewer.require_display()  # before anything is simulated
    if experiment.actuation_of(options).mode is not Mode.CONTINUOUS:
        reason = f"--actuation {options.actuation} belongs to a run"
    elif options.duration or options.speed:
        reason = "it has a duration or a speed"
    elif options.thickness:
        reason = "--thickness belongs to a run that is played"
    if not reason:
        with contextlib.ExitStack() as opened:
            try:
                passive = model.OnInfeasible(options.on_infeasible or "stop")
                live = opened.enter_context(studies.law_in(scene, law or _held(scene), on_infeasible=passive))
            except OptionError as error:
                reason = str(error)
            else:
                viewer.view_model(live)
                return Outcome({"status": "ok", "source": options.source, "shown": "live"})
    print(f"simulated first, then played: {printable(reason)}", file=sys.stderr)
    run = _simulated(options, scene)
    viewer.play(run, options.speed or 1.0, thickness=bool(options.thickness))
    data = {"status": run.status, "source": options.source, "shown": "simulated first"}
    return Outcome(data, code=code_of_status(run.status))


def _held(scene: model.Scene) -> Any:
    """A law that leaves every string at its rest length, those with mass as wholes."""
    import numpy as np

    from tensegrity_mj.dynamics.native.law import Command

    rest = np.array(scene.structure.massless.rest_lengths)

    def law(time: float, nodes: Any, velocities: Any) -> Any:
        return rest

    law.command = Command.REST_LENGTH  # type: ignore[attr-defined]
    return law
