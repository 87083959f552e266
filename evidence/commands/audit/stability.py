"""The largest stable step of every engine with a fixed step: predicted, measured, and mapped."""

from __future__ import annotations

import argparse
from functools import partial

import tensegrity_mj.library as library
from tensegrity_mj import studies
from tensegrity_mj.basics.files import write_text
from tensegrity_mj.basics.jsontext import to_json
from tensegrity_mj.commands.common import Outcome, whole
from tensegrity_mj.commands.stability import continuous_law_of

SMALL_DPI = 65
count = partial(whole, most=10**6)


def execute(options: argparse.Namespace) -> Outcome:
    """Predict, measure, and write what the options name."""
    from evidence.stability.cases import AXES
    from evidence.stability.page import describe, judgement_of, page_of, pictures
    from evidence.stability.study import study_stability
    from tensegrity_mj.pictures.figure import save_figure

    scene, folder = library.load_scene(options.scene), options.out
    maps = () if options.maps is None else tuple(options.maps or AXES)
    data = study_stability(
        scene,
        law=continuous_law_of(scene, options),
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
