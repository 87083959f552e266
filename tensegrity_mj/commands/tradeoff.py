"""Measure what accuracy costs on a scene: error and cost of every engine, integrator, step and tolerance."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import tensegrity_mj.library as library
from tensegrity_mj import controllers
from tensegrity_mj.basics.texts import file_name
from tensegrity_mj.commands.common import Outcome
from tensegrity_mj.commands.experiment import law_options_of
from tensegrity_mj.errors import OptionError


def execute(options: argparse.Namespace) -> Outcome:
    """Run the studies, one scene after the other."""
    from tensegrity_mj.basics.fields import item_of
    from tensegrity_mj.studies.tradeoff.advising import sentences
    from tensegrity_mj.studies.tradeoff.experiments import TradeoffOptions
    from tensegrity_mj.studies.tradeoff.page import has_diagram
    from tensegrity_mj.studies.tradeoff.study import PICTURE, tradeoff

    fields, values = item_of(TradeoffOptions).keys, vars(options).items()
    chosen = TradeoffOptions(**{name: value for name, value in values if name in fields and value is not None})
    scenes = [library.load_scene(name) for name in options.scenes]
    names = [file_name(scene.name) for scene in scenes]
    if len(set(names)) < len(names):
        raise OptionError(f"scenes {', '.join(names)}: each must have a name of its own")
    found: list[dict[str, Any]] = []
    lines: list[str] = []
    for scene, name in zip(scenes, names, strict=True):
        folder = None if options.out is None else Path(options.out) / name
        own = law_options_of(options)
        law = options.law or controllers.SCENE_LAW
        study = tradeoff(scene, law, law_options=own, folder=folder, options=chosen, progress=True)
        found.append(study.answer)
        findings = [*study.judgement.lines(), *sentences(study.data)]
        lines += [f"{scene.name}:", *(f"  {text}" for text in findings), ""]
        if folder is not None:
            if has_diagram(study.data):
                study.save_figure(folder / PICTURE)
            print(f"wrote {folder}", file=sys.stderr)
    return Outcome({"status": "completed", "scenes": found}, "\n".join(lines).rstrip())
