"""How near rods and strings come to each other along a run, or in a scene's start: which, when and where."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from tensegrity_mj.commands.common import (
    PLOT_SUFFIXES,
    Outcome,
    finite,
    number,
    output_file,
    positive,
    table,
)
from tensegrity_mj.errors import OptionError

if TYPE_CHECKING:
    from tensegrity_mj.runs.approaches import Approach, Clearance

HELP = "the smallest distances between rods and strings along a run"
EXAMPLES = """\
examples:
  tensegrity-mj clearance prism.nc              # of tensegrity-mj run prism --out prism.nc
  tensegrity-mj clearance prism.nc --pairs rod-rod,rod-string --below 0.05 --out nearest.png
  tensegrity-mj clearance tower --json          # one shape: the scene's start

Distances are those of the surfaces, negative where elements overlap. Elements that share a node are left out. Between
samples the nodes follow cubics through positions and velocities, and nothing on these is missed.
"""
KINDS = ("rod-rod", "rod-string", "string-string")
SHOWN = 20  # events, to people


def configure(parser: argparse.ArgumentParser) -> None:
    """The options of `clearance`."""
    parser.add_argument("input", metavar="FILE.nc | SCENE", help="a run, or a scene, whose start is looked at")
    parser.add_argument("--pairs", type=kinds, metavar="KINDS", help=f"of {', '.join(KINDS)}, by commas (all)")
    parser.add_argument(
        "--below", type=finite, default=0.0, metavar="D", help="list all approaches to at most D [m] (0: touches)"
    )
    parser.add_argument("--string-radius", type=finite, default=0.0, metavar="M", help="of every string [m] (0)")
    parser.add_argument("--tolerance", type=positive, default=1e-6, metavar="M", help="of distances [m] (1e-6)")
    parser.add_argument("--every-pair", action="store_true", help="list the smallest distance of every pair, too")
    parser.add_argument("--out", metavar="FILE.png", help="write a plot over time (or .pdf, .svg)")


def kinds(text: str) -> list[str]:
    """argparse type: kinds of pairs, by commas."""
    names = [name.strip() for name in text.split(",") if name.strip()]
    for name in names:
        if name not in KINDS:
            raise argparse.ArgumentTypeError(f"{name!r}; allowed: {', '.join(KINDS)}")
    if not names:
        raise argparse.ArgumentTypeError("none given")
    return names


def execute(options: argparse.Namespace) -> Outcome:
    """Read the run or the scene, and search it."""
    out = output_file(options.out, "--out", PLOT_SUFFIXES)
    is_run = options.input.lower().endswith(".nc")
    if out and not is_run:
        raise OptionError(f"--out plots distances over time, and {options.input} is one shape: give the file of a run")

    from tensegrity_mj.library.load import load_scene
    from tensegrity_mj.runs.approaches import Pairs
    from tensegrity_mj.runs.clearances import clearance
    from tensegrity_mj.runs.trajectory import Trajectory

    what = Trajectory.load(options.input) if is_run else load_scene(options.input)
    found = clearance(
        what,
        pairs=[Pairs(name) for name in options.pairs or KINDS],
        below=options.below,
        string_radius=options.string_radius,
        tolerance=options.tolerance,
        every_pair=options.every_pair,
        over_time=out is not None,
        progress=True,
    )
    if out:
        from tensegrity_mj.pictures.plots import plot_clearance

        plot_clearance(found, out)
    closest = found.closest
    data = found.to_dict() | {"closest": None if closest is None else asdict(closest), "out": out}
    return Outcome(data, describe(found) + (f"\nwritten  {out}" if out else ""))


def describe(found: Clearance) -> str:
    """The clearance for people."""
    moving = found.samples > 1
    rows = [("scene", found.name)]
    if moving:
        rows.append(("time", f"{found.start:g} to {found.end:g} s, {found.samples} samples"))
        rows.append(("error of the cubics between samples", f"about {number(found.interpolation_error, 'm')}"))
    for kind, approach in found.smallest.items():
        rows.append((kind.value, "no such pair" if approach is None else _approach(approach, moving)))
    if found.planar:
        rows.append(("note", "all nodes lie in one plane: elements cross by construction, real ones lie in layers"))
    below = "touch or overlap" if found.below == 0 else f"are at most {found.below:g} m apart"
    rows.append((f"elements that {below}", str(len(found.events)) if found.events else "none"))
    lines = [table(rows)]
    for event in found.events[:SHOWN]:
        passed = [f"passes through at {time:.6g} s" for time in event.crossings[:3]]
        more = [f"and {len(event.crossings) - 3} times more"] if len(event.crossings) > 3 else []
        span = [f"{event.start:.6g} to {event.end:.6g} s"] if moving else []
        lines.append("  " + "; ".join([*span, _approach(event.closest, moving), *passed, *more]))
    if len(found.events) > SHOWN:
        lines.append(f"  and {len(found.events) - SHOWN} more: --json has all")
    if found.pairs is not None:
        lines.append(f"every pair ({len(found.pairs)}), the nearest first")
        lines += ["  " + _approach(approach, moving) for approach in found.pairs]
    return "\n".join(lines)


def _approach(a: Approach, moving: bool) -> str:
    when: Any = f" at {a.time:.6g} s" if moving else ""
    return f"{number(a.distance, 'm')}, {a.first} at {a.at[0]:.3f} and {a.second} at {a.at[1]:.3f} of its length{when}"
