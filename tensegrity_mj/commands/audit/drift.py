"""Measure how energy and constraints drift over long runs, for each integrator and each treatment of drift."""

from __future__ import annotations

import argparse
import sys

from tensegrity_mj import studies
from tensegrity_mj.commands.common import Outcome


def execute(options: argparse.Namespace) -> Outcome:
    """Make the runs."""
    from tensegrity_mj.studies.long_runs import PAGE, long_runs

    result = long_runs(
        options.scene,
        options.steps,
        timestep=options.timestep,
        methods=options.methods,
        seed=options.seed,
        folder=options.out,
        workers=studies.Workers(options.workers),
        progress=True,
    )
    if result.folder is not None:
        print(f"wrote {result.folder / PAGE}", file=sys.stderr)
    return Outcome(result.data | {"timing": {"seconds": result.seconds}}, result.text)
