"""Measure how energy and constraints drift over long runs, for each integrator and each treatment of drift."""

from __future__ import annotations

import argparse

from tensegrity_mj import studies
from tensegrity_mj.commands.common import Outcome, wrote


def execute(options: argparse.Namespace) -> Outcome:
    """Make the runs."""
    from evidence.drift import PAGE, long_runs

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
    data = result.data | {"timing": {"seconds": result.seconds}}
    return Outcome(data, result.text, notes=wrote(result.folder, PAGE), judgement=result.judgement)
