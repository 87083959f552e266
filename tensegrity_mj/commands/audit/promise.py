"""Measure what `--accuracy` promises, on shipped scenes and random structures. Goes on where it was stopped."""

from __future__ import annotations

import argparse
from typing import Any

from tensegrity_mj import studies
from tensegrity_mj.commands.common import Outcome, table


def execute(options: argparse.Namespace) -> Outcome:
    """Run the study."""
    from tensegrity_mj.studies.promise import promise
    from tensegrity_mj.studies.promise_experiments import Kind
    from tensegrity_mj.studies.promise_page import write_promise

    found = promise(
        options.runs,
        options.seed,
        options.out,
        kind=Kind(options.kind),
        workers=studies.Workers(options.workers),
        progress=True,
    )
    data: dict[str, Any] = found.to_dict() | {"status": "completed", "folder": options.out}
    notes = () if options.out is None else (f"wrote {write_promise(options.out, found)}",)
    return Outcome(data, table([line[:2] for line in found.summary]), notes=notes)
