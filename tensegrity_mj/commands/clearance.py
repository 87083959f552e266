"""Find how near rods and strings come to each other along a run, or at a scene's start: which, when and where."""

from __future__ import annotations

import argparse
from typing import Any

import tensegrity_mj.library as library
from tensegrity_mj import pictures, runs
from tensegrity_mj.basics.jsontext import plain_values
from tensegrity_mj.commands.common import Outcome, number, table
from tensegrity_mj.errors import OptionError

SHOWN = 20  # events, to people


def kinds(text: str) -> list[runs.Pairs]:
    """argparse type: kinds of pairs, by commas."""
    known = {one.value: one for one in runs.Pairs}
    names = [name.strip() for name in text.split(",") if name.strip()]
    for name in names:
        if name not in known:
            raise argparse.ArgumentTypeError(f"{name!r}; allowed: {', '.join(known)}")
    if not names:
        raise argparse.ArgumentTypeError("none given")
    return [known[name] for name in names]


def execute(options: argparse.Namespace) -> Outcome:
    """Read the run or the scene, and search it."""
    out, is_run = options.out, options.input.lower().endswith(".nc")
    if out and not is_run:
        raise OptionError(f"--out plots distances over time, and {options.input} is one shape: give the file of a run")

    what = runs.Trajectory.load(options.input) if is_run else library.load_scene(options.input)
    found = runs.clearance(
        what,
        pairs=options.pairs or list(runs.Pairs),
        below=options.below,
        string_radius=options.string_radius,
        tolerance=options.tolerance,
        every_pair=options.every_pair,
        over_time=out is not None,
        progress=True,
    )
    if out:
        pictures.plots.plot_clearance(found, out)
    data = found.to_dict() | plain_values(found, "closest") | {"out": out}
    return Outcome(data, describe(found) + (f"\nwritten  {out}" if out else ""))


def describe(found: runs.Clearance) -> str:
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


def _approach(a: runs.Approach, moving: bool) -> str:
    when: Any = f" at {a.time:.6g} s" if moving else ""
    return f"{number(a.distance, 'm')}, {a.first} at {a.at[0]:.3f} and {a.second} at {a.at[1]:.3f} of its length{when}"
