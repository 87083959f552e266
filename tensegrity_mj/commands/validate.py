"""The controller's report: test a law on a scene in every engine, under everything that may be off."""

from __future__ import annotations

import argparse
import sys

from tensegrity_mj import studies
from tensegrity_mj.commands.common import Outcome
from tensegrity_mj.errors import OptionError


def execute(options: argparse.Namespace) -> Outcome:
    """Run the report."""
    if options.seed < 0:
        raise OptionError(f"--seed {options.seed}: it must be an integer >= 0")
    from tensegrity_mj.studies.validation.study import DATA, PAGE

    report = studies.validate(
        options.scene,
        options.law,
        law_options=dict(options.law_option or ()),
        folder=options.out,
        engines=options.engines,
        sections=options.only,
        duration=options.duration,
        timestep=options.timestep,
        control_period=options.control_period,
        seed=options.seed,
        quick=options.quick,
        workers=studies.Workers(options.workers),
        progress=True,
    )
    lines = list(report.summary)
    if report.folder is not None:
        lines.append(f"All of it: {report.folder / PAGE} and {report.folder / DATA}.")
        print(f"wrote {report.folder / PAGE}", file=sys.stderr)
    return Outcome(dict(report.data), "\n".join(lines))
