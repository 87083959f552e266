"""Measure the time of one step of MuJoCo: its parts, a further step of a run, and features that the scene lacks."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from typing import Any

import tensegrity_mj.library as library
from tensegrity_mj.commands.common import Outcome, table


def execute(options: argparse.Namespace) -> Outcome:
    """Measure, and return the result as text."""
    from evidence.speed.step_timing import measure

    scene = library.load_scene(options.scene)
    timing = asdict(measure(scene))
    rows = [("scene", scene.name), *_rows(timing)]
    return Outcome({"status": "completed", "scene": scene.name, "timing": timing}, table(rows))


def _rows(timing: dict[str, Any]) -> list[tuple[str, str]]:
    """Rows about the cost of a step."""
    micro = 1e6
    found = {"without a law": timing["passive_run"], "with the law": timing["closed_loop"]}
    further = " and ".join(f"{micro * value:.3g} µs {which}" for which, value in found.items() if value is not None)
    if further:
        further += "; ledger and recording included, set-up not; median over the first "
        further += f"{timing['run_time']:.3g} s, h = {timing['timestep']:.3g} s"
    shares = [f"{100 * share:.0f} % {part}" for part, share in timing["shares"].items()]
    extras = [
        f"{extra['what']}: {'it is here, ' if extra['needed'] else ''}{extra['ratio']:.2f} x"
        for extra in timing["extras"]
    ]
    return [
        ("a step of the bare model", f"{micro * timing['step']:.3g} µs: {', '.join(shares)}"),
        ("a further step of a run", further or "no run succeeds"),
        *[("" if row else "what else would cost", text) for row, text in enumerate(extras)],
    ]
