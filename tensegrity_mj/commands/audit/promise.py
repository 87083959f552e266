"""Measure what `--accuracy` promises, on shipped scenes and random structures. Goes on where it was stopped."""

from __future__ import annotations

import argparse
import sys
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
    if options.out is not None:
        page = write_promise(options.out, found)
        print(f"wrote {page}", file=sys.stderr)
    return Outcome(data, table([line[:2] for line in found.summary]))
