"""Measure what `--accuracy` promises, on shipped scenes and random structures. Goes on where it was stopped."""

from __future__ import annotations

import argparse
import sys
from typing import Any

from tensegrity_mj.commands.common import Outcome, add_workers, table
from tensegrity_mj.errors import OptionError

HELP = "what --accuracy promises: true errors, costs and doubts"
EXAMPLES = """\
examples:
  tensegrity-mj audit promise --runs 72 --seed 1
  tensegrity-mj audit promise --runs 1000 --seed 11 --out promise/
  tensegrity-mj audit promise --runs 72 --kind shipped

Each run draws an experiment, an engine and an accuracy from 1e-2 to 1e-10 m: a random structure of 1 to 6 rods, strings
of 1e-3 to 1e10 N/m, any damping and spin, or a shipped scene in open or closed loop. Its true error is measured against
two references that are not computed as it was, and its evaluations, of one in eight, against those of the cheapest
adequate setting of a sweep.
"""


def configure(parser: argparse.ArgumentParser) -> None:
    """The options of `audit promise`."""
    parser.add_argument("--runs", type=int, default=72, metavar="N", help="how many experiments (72)")
    parser.add_argument("--seed", type=int, default=1, help="of the experiments (1)")
    parser.add_argument("--kind", choices=("random", "shipped"), default="random", help="what is drawn from (random)")
    add_workers(parser, "experiments")
    parser.add_argument("--out", metavar="FOLDER", help="write promise.json and promise.html; go on if interrupted")


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
