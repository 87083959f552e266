"""Measure what `--accuracy` promises, on shipped scenes and random structures. Goes on where it was stopped."""

from __future__ import annotations

import argparse

from tensegrity_mj import studies
from tensegrity_mj.commands.common import Outcome, wrote


def execute(options: argparse.Namespace) -> Outcome:
    """Run the study."""
    from evidence.promise.experiments import Kind
    from evidence.promise.study import promise

    found = promise(
        options.runs,
        options.seed,
        options.out,
        kind=Kind(options.kind),
        workers=studies.Workers(options.workers),
        progress=True,
    )
    data = found.data | {"status": "completed", "folder": options.out}
    return Outcome(data, notes=wrote(found.folder, "promise.html"), judgement=found.judgement)
