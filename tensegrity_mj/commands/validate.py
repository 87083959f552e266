"""The controller's report: test a law on a scene in every engine, under everything that may be off."""

from __future__ import annotations

import argparse

from tensegrity_mj import controllers, studies
from tensegrity_mj.commands.common import Outcome, wrote
from tensegrity_mj.commands.experiment import law_options_of

GIVEN = ("engines", "duration", "timestep", "control_period", "seed", "quick")


def execute(options: argparse.Namespace) -> Outcome:
    """Run the report."""
    from tensegrity_mj.studies.validation.study import DATA, PAGE

    report = studies.validate(
        options.scene,
        options.law or controllers.SCENE_LAW,
        law_options=law_options_of(options),
        folder=options.out,
        sections=options.only,
        **{name: getattr(options, name) for name in GIVEN},
        workers=studies.Workers(options.workers),
        progress=True,
    )
    folder = report.folder
    text = "" if folder is None else f"Full report: {folder / PAGE} and {folder / DATA}."
    return Outcome(report.data, text, notes=wrote(folder, PAGE), judgement=report.judgement)
