"""A command as docs/developing/tools.md makes one: the mass of a scene's structure."""

from __future__ import annotations

import argparse

from tensegrity_mj.commands.common import Outcome, number, table


def execute(options: argparse.Namespace) -> Outcome:
    """Add the masses up."""
    from tensegrity_mj.library.named import load_scene

    structure = load_scene(options.scene).structure
    parts = {"rods": structure.rods, "point-masses": structure.point_masses}
    chosen = parts.values() if options.of == "all" else [parts[options.of]]
    mass = sum(one.mass for part in chosen for one in part)
    return Outcome({"status": "ok", "mass": mass}, table([("mass", number(mass, "kg"))]))
