"""Make a scene of a file of another program: NTRT, STEDY, MOTES, TsgFEM, tables, MJCF. No code of the file is run."""

from __future__ import annotations

import argparse

import tensegrity_mj.exchange as exchange
from tensegrity_mj.commands.common import Outcome

GIVEN = ("unit", "stiffness", "damping", "rod_mass", "rod_radius", "node_mass")


def execute(options: argparse.Namespace) -> Outcome:
    """Read the file, write the scene, and say on stderr what could not be carried over."""
    given = exchange.ImportOptions(**{key: getattr(options, key) for key in GIVEN})
    found = exchange.import_scene(options.file, options.format, given)
    found.save(out := options.out)
    structure = found.scene.structure
    counts = {"nodes": len(structure.nodes), "rods": len(structure.rods), "strings": len(structure.strings)}
    data = {"status": "ok", "scene": found.scene.name, "out": out, "format": found.format, "notes": list(found.notes)}
    text = f"{out}: {', '.join(f'{count} {what}' for what, count in counts.items())}"
    return Outcome(data | counts, text, notes=[f"note: {note}" for note in found.notes])
