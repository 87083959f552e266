"""Measure how energy and constraints drift over long runs, for each integrator and each treatment of drift."""

from __future__ import annotations

import argparse
import sys

from tensegrity_mj.commands.common import Outcome, add_scene, add_several, add_workers, positive

HELP = "drift of energy and constraints over a million steps"
EXAMPLES = """\
examples:
  tensegrity-mj audit drift prism --steps 1000000 --out drift
  tensegrity-mj audit drift pinned_rod --steps 100000 --methods rk4 "dae normalize" ode
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
    """The options of `audit drift`."""
    add_scene(parser)
    parser.add_argument("--steps", type=int, metavar="N", default=1_000_000, help="a multiple of 1000 (1000000)")
    parser.add_argument("--timestep", type=positive, metavar="S", help="[s] (a tenth of the shortest time scale)")
    add_several(parser, "--methods", METHODS, "METHOD")
    parser.add_argument("--seed", type=int, metavar="N", default=0, help="of the motion of a scene at rest (0)")
    add_workers(parser)
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
