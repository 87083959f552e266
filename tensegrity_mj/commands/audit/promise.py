"""Measure what `--accuracy` promises, on shipped scenes and random structures. Goes on where it was stopped."""

from __future__ import annotations

import argparse
import sys
from typing import Any

from tensegrity_mj.commands.common import Outcome, table
from tensegrity_mj.errors import OptionError


def execute(options: argparse.Namespace) -> Outcome:
    """Run the study."""
    for name, least in (("runs", 1), ("seed", 0), ("workers", 1)):
        value = getattr(options, name)
        if value is not None and value < least:
            raise OptionError(f"--{name} {value}: it must be an integer >= {least}")
    from tensegrity_mj.studies.promise import promise
    from tensegrity_mj.studies.promise_experiments import Kind
    from tensegrity_mj.studies.promise_page import write_promise
    from tensegrity_mj.studies.workers import Workers

    try:
        found = promise(
            options.runs,
            options.seed,
            options.out,
            kind=Kind(options.kind),
            workers=Workers(options.workers),
            progress=True,
        )
    except KeyboardInterrupt as interrupt:
        print(f"tensegrity-mj: {interrupt}", file=sys.stderr)
        raise
    data: dict[str, Any] = found.to_dict() | {"status": "completed", "folder": options.out}
    if options.out is not None:
        page = write_promise(options.out, found)
        print(f"wrote {page}", file=sys.stderr)
    return Outcome(data, table(found.summary))
