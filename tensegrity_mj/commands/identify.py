"""Find parameters of a scene from measurements: what these determine, estimates with intervals, and a page."""

from __future__ import annotations

import argparse

import tensegrity_mj.library as library
from tensegrity_mj import model, studies
from tensegrity_mj.commands import experiment
from tensegrity_mj.commands.common import Outcome, finite, positive, refuse, wrote
from tensegrity_mj.errors import OptionError


def noise(text: str) -> tuple[str, float]:
    """argparse type: a number, of node positions, or QUANTITY=NUMBER."""
    quantity, _, number = text.rpartition("=")
    return quantity or "nodes", positive(number)


def share(text: str) -> float:
    """argparse type: a number between 0 and 1."""
    if not 0 < finite(text) < 1:
        raise argparse.ArgumentTypeError(f"{text}: it must be between 0 and 1")
    return finite(text)


def execute(options: argparse.Namespace) -> Outcome:
    """Check all options first; then fit, and write what they name."""
    from tensegrity_mj.studies.identification.measurements import measured_together

    experiment.check_control(options)
    experiment.refuse_options_of_other_engines(options, (options.engine,))
    refuse(options, ("output-interval", "on-infeasible"), "means nothing here: runs are seen when it was measured")
    scene, sigmas = library.load_scene(options.scene), options.sigma or ()
    if len(dict(sigmas)) < len(sigmas):
        raise OptionError("--sigma: a quantity is given twice; give each once")
    found = studies.identify(
        scene,
        measured_together(options.data, options.members, dict(sigmas)),
        options.parameter,
        experiment.engine_of(options.engine, options),
        law=experiment.law_of(options, scene),
        options=studies.FitOptions(options.level or 0.95, options.hold_unseen, experiment.actuation_of(options)),
        folder=options.out,
        progress=True,
    )
    if options.scene_out is not None:
        model.save_scene(found.scene, options.scene_out)
    status = "completed" if found.data["converged"] else "not converged"
    return Outcome(
        {"status": status, **found.data},
        "\n".join(found.table()),
        notes=wrote(found.folder, "identification.html"),
        judgement=found.judgement,
    )
