"""The largest stable step of every engine with a fixed step: predicted, measured, and mapped."""

from __future__ import annotations

import argparse
from functools import partial
from typing import Any

import tensegrity_mj.library as library
from tensegrity_mj import studies
from tensegrity_mj.basics.files import write_text
from tensegrity_mj.basics.jsontext import to_json
from tensegrity_mj.commands.common import Outcome, refuse, whole
from tensegrity_mj.commands.experiment import law_of
from tensegrity_mj.errors import OptionError

SMALL_DPI = 65
count = partial(whole, most=10**6)


def execute(options: argparse.Namespace) -> Outcome:
    """Predict, measure, and write what the options name."""
    from tensegrity_mj.pictures.figure import save_figure
    from tensegrity_mj.studies.stability.cases import AXES
    from tensegrity_mj.studies.stability.page import describe, judgement_of, page_of, pictures
    from tensegrity_mj.studies.stability.study import study_stability

    scene, folder = library.load_scene(options.scene), options.out
    maps = () if options.maps is None else tuple(options.maps or AXES)
    data = study_stability(
        scene,
        law=_law_of(scene, options),
        engines=options.engines,
        maps=maps,
        quick=options.quick,
        random=options.random,
        seed=options.seed,
        folder=folder,
        workers=studies.Workers(options.workers),
        progress=True,
    )
    lines = describe(data)
    if folder is not None:
        write_text(folder / "stability.json", to_json({**data, **judgement_of(data).to_dict()}) + "\n")
        for name, (figure, _) in pictures(data).items():
            save_figure(figure, folder / f"{name}.png", SMALL_DPI if options.small else None)
        lines.append(f"written  {page_of(data).write(folder / 'index.html')}")
    return Outcome({"status": "ok", **data, "out": folder}, "\n".join(lines), judgement=judgement_of(data))


def _law_of(scene: Any, options: argparse.Namespace) -> Any:
    """The law; the scene's only where it can be evaluated at every stage."""
    if options.open_loop:
        refuse(options, ("law", "law-option"), "is of the closed loop, and --open-loop was given")
        return None
    law = law_of(options, scene)
    why = getattr(law, "discontinuous", "")
    if why and options.law is not None:
        raise OptionError(f"--law {options.law}: {why}")
    return None if why else law
