"""The largest stable step of every engine with a fixed step: predicted at a scene's start and along a run."""

from __future__ import annotations

import argparse
from typing import Any

import tensegrity_mj.library as library
from tensegrity_mj.commands.common import Outcome, refuse, wrote
from tensegrity_mj.commands.experiment import law_of
from tensegrity_mj.errors import OptionError


def execute(options: argparse.Namespace) -> Outcome:
    """Predict, and write what the options name."""
    from tensegrity_mj.studies.stable_steps import predict_steps

    scene, folder = library.load_scene(options.scene), options.out
    found = predict_steps(scene, law=continuous_law_of(scene, options), engines=options.engines).kept(folder)
    data, page = {"status": "ok", **found.data, "out": folder}, f"{found.NAME}.html"
    return Outcome(data, "\n".join(found.lines()), notes=wrote(folder, page), judgement=found.judgement)


def continuous_law_of(scene: Any, options: argparse.Namespace) -> Any:
    """The law; the scene's only where it can be evaluated at every stage."""
    if options.open_loop:
        refuse(options, ("law", "law-option"), "is of the closed loop, and --open-loop was given")
        return None
    law = law_of(options, scene)
    why = getattr(law, "discontinuous", "")
    if why and options.law is not None:
        raise OptionError(f"--law {options.law}: {why}")
    return None if why else law
