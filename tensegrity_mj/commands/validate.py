"""The controller's report: test a law on a scene in every engine, under everything that may be off."""

from __future__ import annotations

import argparse
import sys
from typing import Any

from tensegrity_mj.commands.common import Outcome, positive
from tensegrity_mj.errors import OptionError

HELP = "test a control law: convergence, sampling, gains, robustness, region of attraction"
EXAMPLES = """\
examples:
  tensegrity-mj validate prism --out report
  tensegrity-mj validate pinned_rod --law projection --only starts delay --quick
  tensegrity-mj validate pinned_rod --law my_laws.py:damp --out report --workers 4
"""

# As in studies.validation.sections.SECTIONS and studies.parameters.ENGINES: written here so that --help need not
# import them (tested to agree).
SECTIONS = ("nominal", "sampling", "gains", "mass", "stiffness", "noise", "delay", "breaks", "gravity", "starts")
ENGINES = ("mujoco", "dae", "ode")


def configure(parser: argparse.ArgumentParser) -> None:
    """The options of `validate`."""
    parser.add_argument("scene", metavar="SCENE", help="a scene (see `scenes`), a .toml file, or a family's call")
    parser.add_argument(
        "--law",
        metavar="LAW",
        help="a built-in law, or module:name or path.py:name of a law or of a function scene -> law (the scene's)",
    )
    parser.add_argument(
        "--only", nargs="+", choices=SECTIONS, metavar="SECTION", help=f"of {', '.join(SECTIONS)} (all)"
    )
    parser.add_argument(
        "--engines", nargs="+", choices=ENGINES, metavar="ENGINE", help=f"of {', '.join(ENGINES)} (all)"
    )
    parser.add_argument("--quick", action="store_true", help="a few points of each section")
    parser.add_argument("--duration", type=positive, metavar="S", help="of each run [s] (the scene's)")
    parser.add_argument("--timestep", type=positive, metavar="S", default=1e-3, help="of RK4 [s]; divides 0.01 (0.001)")
    parser.add_argument(
        "--control-period", type=positive, metavar="S", default=1e-3, help="of sampled runs [s]; divides 0.01 (0.001)"
    )
    parser.add_argument("--seed", type=int, default=0, help="of everything random (0)")
    parser.add_argument("--workers", type=int, metavar="N", help="how many runs at a time (all cores)")
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
