"""Measure speed as ratios, side by side: closed loop against bare MuJoCo, references, renderer, start-up."""

from __future__ import annotations

import argparse
import sys

import tensegrity_mj.library as library
from tensegrity_mj.commands.common import Outcome


def counts(text: str) -> tuple[int, ...]:
    """argparse type: whole numbers > 0, by commas."""
    parts = text.split(",")
    if not all(part.isascii() and part.isdigit() and int(part) > 0 for part in parts):
        raise argparse.ArgumentTypeError(f"{text!r}: write whole numbers such as 1,2,4")
    return tuple(int(part) for part in parts)


def execute(options: argparse.Namespace) -> Outcome:
    """Measure the speed, and return the result as text."""
    from evidence.speed.benchmark import Benchmark, lines, run_benchmark

    settings = Benchmark(
        tuple(map(library.load_scene, options.scenes)),
        repeats=options.repeats,
        timestep=options.timestep,
        sample=options.sample,
        simulations=options.simulations,
        threads=options.threads,
        renderer=not options.no_renderer,
        startup=not options.no_startup,
    )
    result = run_benchmark(settings, lambda text: print(f"{text} ...", file=sys.stderr, flush=True))
    return Outcome({"status": "completed", **result}, "\n".join(lines(result)))
