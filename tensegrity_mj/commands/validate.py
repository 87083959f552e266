"""The controller's report: test a law on a scene in every engine, under everything that may be off."""

from __future__ import annotations

import argparse
import sys
from typing import Any

from tensegrity_mj.commands.common import Outcome, add_scene, add_several, add_workers, positive
from tensegrity_mj.engines.table import ENGINES
from tensegrity_mj.errors import OptionError

HELP = "test a control law: sampling, gains, robustness, attraction"
EXAMPLES = """\
examples:
  tensegrity-mj validate prism --out report
  tensegrity-mj validate pinned_rod --law projection --only starts delay --quick
  tensegrity-mj validate pinned_rod --law my_laws.py:damp --out report --workers 4
"""

# As in studies.validation.sections.SECTIONS: written here so that --help need not import it (tested to agree).
SECTIONS = ("nominal", "sampling", "gains", "mass", "stiffness", "noise", "delay", "breaks", "gravity", "starts")


def configure(parser: argparse.ArgumentParser) -> None:
    """The options of `validate`."""
    add_scene(parser)
    parser.add_argument(
        "--law",
        metavar="LAW",
        help="a built-in law, or module:name or path.py:name of a law or of a function scene -> law (the scene's)",
    )
    add_several(parser, "--only", SECTIONS, "SECTION")
    add_several(parser, "--engines", tuple(ENGINES), "ENGINE")
    parser.add_argument("--quick", action="store_true", help="a few points of each section")
    parser.add_argument("--duration", type=positive, metavar="S", help="of each run [s] (the scene's)")
    parser.add_argument("--timestep", type=positive, metavar="S", default=1e-3, help="of RK4 [s]; divides 0.01 (0.001)")
    parser.add_argument(
        "--control-period", type=positive, metavar="S", default=1e-3, help="of sampled runs [s]; divides 0.01 (0.001)"
    )
    parser.add_argument("--seed", type=int, default=0, help="of everything random (0)")
    add_workers(parser)
    parser.add_argument(
        "--out",
        metavar="FOLDER",
        help="write validation.json and validation.html there; go on there if interrupted",
    )


def execute(options: argparse.Namespace) -> Outcome:
    """Run the report."""
    if options.seed < 0:
        raise OptionError(f"--seed {options.seed}: it must be an integer >= 0")
    from tensegrity_mj.studies.validation.study import DATA, PAGE, validate
    from tensegrity_mj.studies.workers import Workers

    report = validate(
        options.scene,
        options.law,
        folder=options.out,
        engines=options.engines,
        sections=options.only,
        duration=options.duration,
        timestep=options.timestep,
        control_period=options.control_period,
        seed=options.seed,
        quick=options.quick,
        workers=None if options.workers is None else Workers(options.workers),
        progress=True,
    )
    data: dict[str, Any] = dict(report.data)
    lines = list(report.summary)
    if report.folder is not None:
        lines.append(f"All of it: {report.folder / PAGE} and {report.folder / DATA}.")
        print(f"wrote {report.folder / PAGE}", file=sys.stderr)
    return Outcome(data, "\n".join(lines))
