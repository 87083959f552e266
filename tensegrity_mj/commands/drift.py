"""Measure how energy and constraints drift over long runs, for each integrator and each treatment of drift."""

from __future__ import annotations

import argparse
import sys

from tensegrity_mj.commands.common import Outcome, positive

HELP = "drift of energy and constraints over a million steps, for each integrator"
EXAMPLES = """\
examples:
  tensegrity-mj drift prism --steps 1000000 --out drift
  tensegrity-mj drift pinned_rod --steps 100000 --methods rk4 "dae normalize" ode
"""

# As in studies.long_runs.METHODS: written here so that --help need not import it (tested to agree).
METHODS = (
    "euler",
    "implicitfast",
    "implicit",
    "discrete",
    "rk4",
    "dae monitor",
    "dae normalize",
    "dae baumgarte",
    "ode",
)


def configure(parser: argparse.ArgumentParser) -> None:
    """The options of `drift`."""
    parser.add_argument("scene", metavar="SCENE", help="a scene (see `scenes`), a .toml file, or a family's call")
    parser.add_argument("--steps", type=int, metavar="N", default=1_000_000, help="a multiple of 1000 (1000000)")
    parser.add_argument("--timestep", type=positive, metavar="S", help="[s] (a tenth of the shortest time scale)")
    parser.add_argument(
        "--methods", nargs="+", choices=METHODS, metavar="METHOD", help=f"of {', '.join(METHODS)} (all)"
    )
    parser.add_argument("--seed", type=int, metavar="N", default=0, help="of the motion of a scene at rest (0)")
    parser.add_argument("--workers", type=int, metavar="N", help="how many runs at a time (all cores)")
    parser.add_argument("--out", metavar="FOLDER", help="write drift.json and drift.html there; go on if interrupted")


def execute(options: argparse.Namespace) -> Outcome:
    """Make the runs."""
    from tensegrity_mj.studies.long_runs import PAGE, long_runs
    from tensegrity_mj.studies.workers import Workers

    result = long_runs(
        options.scene,
        options.steps,
        timestep=options.timestep,
        methods=options.methods,
        seed=options.seed,
        folder=options.out,
        workers=None if options.workers is None else Workers(options.workers),
        progress=True,
    )
    if result.folder is not None:
        print(f"wrote {result.folder / PAGE}", file=sys.stderr)
    return Outcome(result.data | {"timing": {"seconds": result.seconds}}, result.text)
