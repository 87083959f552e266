"""Measure speed as ratios, side by side: closed loop against bare MuJoCo, references, renderer, start-up."""

from __future__ import annotations

import argparse
import sys

from tensegrity_mj.commands.common import Outcome, positive

HELP = "speed of closed loops against bare MuJoCo, side by side"
EXAMPLES = """\
examples:
  tensegrity-mj audit speed
  tensegrity-mj audit speed prism --repeats 30 --threads 1,2,4
  tensegrity-mj audit speed my/scene.toml --simulations 0 --no-renderer --json

Each figure is the best of the repetitions, which are interleaved. Run it on an idle machine. Everything measured is
under "timing" of the JSON object.
"""


def configure(parser: argparse.ArgumentParser) -> None:
    """The options of `audit speed`."""
    parser.add_argument(
        "scenes",
        nargs="*",
        metavar="SCENE",
        default=["prism", "pinned_rod", "cross", "planar_beam"],
        help="names or paths, each with a control law (prism pinned_rod cross planar_beam)",
    )
    parser.add_argument("--repeats", metavar="N", type=int, default=15, help="interleaved repetitions (15)")
    parser.add_argument("--timestep", metavar="H", type=positive, default=1e-3, help="of every fixed step [s] (1e-3)")
    parser.add_argument(
        "--sample", metavar="SECONDS", type=positive, default=0.1, help="wall time of one sample of the bare loop (0.1)"
    )
    parser.add_argument("--simulations", metavar="S", type=int, default=1024, help="in a batch; 0 for none (1024)")
    parser.add_argument("--threads", metavar="LIST", type=_counts, default=(1, 2), help="of the batches (1,2)")
    parser.add_argument("--no-renderer", action="store_true", help="leave the renderer out")
    parser.add_argument("--no-startup", action="store_true", help="leave the start-up out")


def _counts(text: str) -> tuple[int, ...]:
    parts = text.split(",")
    if not all(part.isascii() and part.isdigit() and int(part) > 0 for part in parts):
        raise argparse.ArgumentTypeError(f"{text!r}: write whole numbers such as 1,2,4")
    return tuple(int(part) for part in parts)


def execute(options: argparse.Namespace) -> Outcome:
    """Measure, and say what came out."""
    from tensegrity_mj.studies.speed.benchmark import Benchmark, lines, run_benchmark, scenes_of

    settings = Benchmark(
        scenes_of(options.scenes),
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
