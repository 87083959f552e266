"""Make seeded random runs at the extremes, and judge each: right, refused, stopped, or wrong without a warning."""

from __future__ import annotations

import argparse

from tensegrity_mj import studies
from tensegrity_mj.commands.common import ExitCode, Outcome, wrote


def execute(options: argparse.Namespace) -> Outcome:
    """Run the study; exit code 1 where its demands are not met."""
    from evidence.extremes.kinds import Kind
    from evidence.extremes.study import PAGE, extremes

    report = extremes(
        options.runs,
        options.seed,
        kinds=None if options.kinds is None else [Kind[name.upper()] for name in options.kinds],
        autoreset=options.autoreset,
        folder=options.out,
        workers=studies.Workers(options.workers),
        progress=True,
    )
    # Parts of the demands are meant for the whole mixture only: nothing undetected holds for any part.
    undetected = report.data["table"][-1]["undetected"]
    passed = report.passed if options.kinds is None else undetected == 0
    code = ExitCode.SUCCESS if passed or options.autoreset else ExitCode.PROGRAM_ERROR
    data = report.data | {"timing": {"seconds": report.seconds}}
    return Outcome(data, report.text, code, wrote(report.folder, PAGE), report.judgement)
