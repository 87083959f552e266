"""Measure what accuracy costs on a scene: error and cost of every engine, integrator, step and tolerance."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tensegrity_mj.basics.texts import file_name
from tensegrity_mj.commands import experiment
from tensegrity_mj.commands.common import Outcome, add_several, positive
from tensegrity_mj.engines.table import ENGINES
from tensegrity_mj.errors import OptionError

if TYPE_CHECKING:
    from tensegrity_mj.studies.tradeoff.options import TradeoffOptions

HELP = "speed against accuracy of every engine; what to use"
EXAMPLES = """\
examples:
  tensegrity-mj tradeoff prism --out tradeoff/
  tensegrity-mj tradeoff my_scene.toml --engines mujoco --families RK4 Euler --actuations continuous
  tensegrity-mj tradeoff prism --loops closed --actuations hold-rest-length --periods 0.02 0.01 0.005 --json
  tensegrity-mj tradeoff prism cross tbar --out tradeoff/ --docs docs

Errors are the largest distance of a node from where a tight reference has it [m]; docs/tradeoff.md says against which.
Nothing else should use the machine: wall times are measured one run at a time. Interrupted, the same command goes on.
"""

# The values of `Loop`: written here so that --help need not import them (tested to agree).
LOOPS = ("open", "closed")


def configure(parser: argparse.ArgumentParser) -> None:
    """The options of `tradeoff`."""
    parser.add_argument(
        "scenes", nargs="+", metavar="SCENE", help="shipped scenes (see `scenes`) or paths to .toml files"
    )
    parser.add_argument(
        "--law",
        metavar="LAW",
        help="of the closed loop: a built-in law, or module:name or path.py:name of a law or of a function "
        "scene -> law (the scene's)",
    )
    parser.add_argument("--duration", type=positive, metavar="S", help="of each run [s] (the scene's)")
    sweep = parser.add_argument_group("what is swept")
    sweep.add_argument("--loops", nargs="+", choices=LOOPS, metavar="LOOP", help="of open, closed (both)")
    add_several(sweep, "--engines", tuple(ENGINES), "ENGINE")
    sweep.add_argument(
        "--families", nargs="+", metavar="WORD", help="only those whose name has one of these: RK4, Euler, DOP853, ..."
    )
    add_several(sweep, "--actuations", experiment.ACTUATIONS, "MODE")
    sweep.add_argument(
        "--periods", nargs="+", type=positive, metavar="S", help="between control samples where held [s] (0.01 0.001)"
    )
    sweep.add_argument("--steps", nargs="+", type=positive, metavar="S", help="fixed steps [s] (a grid of 1-2-5)")
    sweep.add_argument("--tolerances", nargs="+", type=positive, metavar="RTOL", help="(1e-3 ... 1e-11)")
    sweep.add_argument("--repeats", type=int, metavar="N", help="how often each point is timed (3)")
    sweep.add_argument(
        "--budget", type=positive, metavar="N", help="right-hand sides times strings of a run, at most (1e6)"
    )
    output = parser.add_argument_group("output")
    output.add_argument(
        "--out",
        metavar="FOLDER",
        help="write SCENE/tradeoff.json, .html and .png there for each scene; go on there if interrupted",
    )
    output.add_argument("--docs", metavar="FOLDER", help="write the pictures and tables of FOLDER/tradeoff.md anew")


def execute(options: argparse.Namespace) -> Outcome:
    """Run the studies, one scene after the other."""
    from tensegrity_mj.library.load import load_scene
    from tensegrity_mj.studies.tradeoff.docs import TEXT, write_docs
    from tensegrity_mj.studies.tradeoff.figure import has_diagram
    from tensegrity_mj.studies.tradeoff.results import sentences
    from tensegrity_mj.studies.tradeoff.study import PICTURE, tradeoff

    chosen = _options(options)
    scenes = [load_scene(name) for name in options.scenes]
    names = [file_name(scene.name) for scene in scenes]
    if len(set(names)) < len(names):
        raise OptionError(f"scenes {', '.join(names)}: each must have a name of its own")
    if options.docs is not None and not (Path(options.docs) / TEXT).is_file():
        raise OptionError(f"--docs {options.docs}: there is no {TEXT} in it; name the folder of the documentation")
    found: list[dict[str, Any]] = []
    lines: list[str] = []
    for scene, name in zip(scenes, names, strict=True):
        folder = None if options.out is None else Path(options.out) / name
        study = tradeoff(scene, options.law, folder=folder, options=chosen, progress=True)
        found.append(study.data)
        lines += [f"{scene.name}:", *(f"  {text}" for text in sentences(study.data)), ""]
        if folder is not None:
            if has_diagram(study.data):
                study.save_figure(folder / PICTURE)
            print(f"wrote {folder}", file=sys.stderr)
        if options.docs is not None:
            for path in write_docs(options.docs, [study.data]):
                print(f"wrote {path}", file=sys.stderr)
    return Outcome({"status": "completed", "scenes": found}, "\n".join(lines).rstrip())


def _options(options: argparse.Namespace) -> TradeoffOptions:
    from tensegrity_mj.model.actuation import Mode
    from tensegrity_mj.studies.tradeoff.options import Loop, TradeoffOptions

    given: dict[str, Any] = {
        name: getattr(options, name)
        for name in ("engines", "families", "periods", "steps", "tolerances", "duration", "repeats", "budget")
        if getattr(options, name) is not None
    }
    if options.loops is not None:
        given["loops"] = [Loop(name) for name in options.loops]
    if options.actuations is not None:
        given["actuations"] = [Mode(name.replace("-", " ")) for name in options.actuations]
    return TradeoffOptions(**given)
