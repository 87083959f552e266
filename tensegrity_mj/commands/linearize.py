"""Linearize a scene about a state: A, B, C, natural frequencies and damping, from any engine's equations."""

from __future__ import annotations

import argparse
import math
import sys
from typing import Any

import tensegrity_mj.library as library
from tensegrity_mj import linearization, runs
from tensegrity_mj.commands.common import Outcome, number, refuse, table
from tensegrity_mj.commands.experiment import law_of
from tensegrity_mj.engines.table import engine_class
from tensegrity_mj.errors import OptionError

MOST_LINES = 20
MANY_JOINED = 50  # rods: at 121 MuJoCo takes 118 s, the DAE 7 s


def execute(options: argparse.Namespace) -> Outcome:
    """Linearize, and write what the options name."""
    if options.law is None and not options.closed_loop:
        refuse(options, ("law-option",), "needs --law, or --closed-loop for the scene's law")

    from tensegrity_mj.dynamics.native.law import Command

    scene = library.load_scene(options.scene)
    if options.closed_loop and (options.law == "none" or (options.law is None and scene.control is None)):
        raise OptionError(f"--closed-loop: scene '{scene.name}' names no control law: add --law")
    law = law_of(options, scene) if options.closed_loop or options.law is not None else None
    state = {} if options.state is None else _state_of(options, [*scene.structure.node_names])
    if law is not None:
        state.pop("rest_lengths", None)
    if options.engine == "mujoco" and len(scene.structure.rods) >= MANY_JOINED and scene.structure.clusters:
        text = f"MuJoCo differentiates {len(scene.structure.rods)} rods that share nodes column by column, slowly"
        print(f"note: {text}; --engine dae gives the same model in a fraction of the time", file=sys.stderr)
    model = linearization.linearize(
        scene,
        engine_class(options.engine)(),
        law=law,
        inputs=Command.FORCE_DENSITY if options.inputs == "force-density" else Command.REST_LENGTH,
        **state,
    )
    if out := options.out:
        model.save(out)
    data = {"status": "ok", **model.to_dict(), "out": out}
    return Outcome(data, describe(model) + (f"\nwritten  {out}" if out else ""))


def describe(model: linearization.Linearization) -> str:
    largest = float(abs(model.residual[len(model.coordinates) :]).max(initial=0.0))
    rows = [
        ("engine", model.engine),
        ("state", f"{len(model.A)} numbers, at t = {model.time:g} s"),
        ("inputs", f"{model.B.shape[1]} ({model.inputs.value})"),
        ("equilibrium", "yes" if model.is_equilibrium else "no: accelerations up to " + number(largest)),
        ("fastest growth", number(float(model.eigenvalues.real.max(initial=-math.inf)), "1/s")),
    ]
    frequencies, damping = model.frequencies, model.damping_ratios
    rows += [
        (f"mode {k + 1}", f"{number(float(f), 'Hz')}, damping ratio {number(float(d))}")
        for k, (f, d) in enumerate(zip(frequencies[:MOST_LINES], damping[:MOST_LINES], strict=True))
    ]
    if len(frequencies) > MOST_LINES:
        rows.append(("", f"and {len(frequencies) - MOST_LINES} more (--json)"))
    rows += [("note", warning) for warning in model.warnings]
    return table(rows)


def _state_of(options: argparse.Namespace, node_names: list[str]) -> dict[str, Any]:
    """The state of a recorded run."""
    run = runs.Trajectory.load(options.state)
    if len(run.time) == 0:
        raise OptionError(f"--state {options.state}: that run has no samples")
    if [*run.scene.structure.node_names] != node_names:
        raise OptionError(f"--state {options.state}: a run of scene '{run.scene.name}', whose nodes are others")
    row = len(run.time) - 1 if options.time is None else int(abs(run.time - options.time).argmin())
    return {
        "nodes": run.nodes[row],
        "velocities": run.velocities[row],
        "rest_lengths": run.rest_lengths[row],
        "time": float(run.time[row]),
    }
