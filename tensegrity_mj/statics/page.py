"""The page of a static study: one HTML file that holds its pictures."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tensegrity_mj.basics.jsontext import plain
from tensegrity_mj.pictures.page import Picture, Section, Table, write_sections
from tensegrity_mj.statics import figures
from tensegrity_mj.statics.words import reactions

if TYPE_CHECKING:
    from tensegrity_mj.statics.state import StaticState
    from tensegrity_mj.statics.study import StaticStudy

USES = {"member": "member", "criterion": "criterion", "force": "force [N]", "limit": "limit [N]"}  # heads of a `Use`
USES |= {"utilisation": "utilisation", "time": "time [s]"}
EXPLAINED = (
    "Grey is where the scene starts, colour the equilibrium. Rods are straight and carry axial forces alone, and "
    "strings only pull; notes say what of the scene has no part in it, and docs/statics.md what is computed and how."
)


def write_statics_page(path: str | os.PathLike[str], study: StaticStudy) -> Path:
    """Write it; returns its path.

    Raises:
        OptionError: for a path that cannot be written.
    """
    sections = []
    if study.state is not None:
        sections += _found(study, study.state)
    if study.sizing is not None:
        data = study.sizing.to_dict()
        rows = [
            (name, one["mass"], 1e3 * one["radius"], one["governs"])
            for kind in ("rods", "strings")
            for name, one in data[kind].items()
        ]
        columns = ("member", "mass [kg]", "radius [mm]", "decided by")
        members = Table("members", columns, rows, folded=True)
        sections.append(Section("Lightest members", study.sizing.describe(), [members]))
    if study.run is not None:
        uses = [Table.of("largest uses", USES, plain(study.run.uses), folded=True)] if study.run.uses else []
        sections.append(Section("Members over the run", study.run.describe(), uses))
    judgement = study.judgement
    lines = [("" if one.mark is None else one.mark.value, one.name, one.text) for one in judgement.findings]
    sections.append(Section("All that was found", parts=[Table("A line each", ("", "", ""), lines, folded=True)]))
    scene = study.model.scene
    title = f"Statics of {scene.name}" + (f": {scene.source}" if scene.source else "")
    return write_sections(path, title, EXPLAINED, sections, opening=judgement.html())


def _found(study: StaticStudy, state: StaticState) -> list[Section]:
    sections = [
        Section(
            "Equilibrium",
            parts=[
                Picture(figures.structure_figure(study.model.scene.nodes0, state), "Before (grey), and in equilibrium"),
                Picture(figures.members_figure(state), "What members carry"),
                *_tables(study, state),
            ],
        )
    ]
    if study.response is not None:
        parts = [
            Picture(
                figures.response_figure(study.response),
                "Along the path; dots where a string becomes slack or taut, other marks where stability changes",
            )
        ]
        buckled = figures.buckling_figure(study.response)
        if buckled is not None:
            parts.append(Picture(buckled, "The motion that nothing resists at the critical points"))
        sections.append(Section("Path", parts=parts))
    if study.modes is not None:
        modes = figures.modes_figure(study.modes)
        rows = list(enumerate(study.modes.frequencies.tolist(), start=1))
        rows = [(*row, *masses) for row, masses in zip(rows, study.modes.effective_masses.tolist(), strict=True)]
        columns = ("mode", "frequency [Hz]", "effective mass x [kg]", "y [kg]", "z [kg]")
        pictures = [] if modes is None else [Picture(modes, "The first modes, over the equilibrium (grey)")]
        numbers = Table("all modes", columns, rows, folded=True)
        sections.append(Section("Natural modes", study.modes.describe(), [*pictures, numbers]))
    return sections


def _tables(study: StaticStudy, state: StaticState) -> list[Table]:
    model, check, found = study.model, study.members, study.prestressability
    structure = model.structure
    strings = []
    for row, string in enumerate(structure.strings):
        use = float("nan") if check is None else float(check.loads.breaking[0, row])
        can = "" if found is None else "yes" if found.can_pull[row] else "no"
        tension = state.tensions[row] if model.whole[row] else "broken"
        strings.append((string.name, model.rest_lengths[row], state.lengths[row], tension, use, can))
    rods = []
    for row, rod in enumerate(structure.rods):
        loads = None if check is None else check.loads
        parts = () if loads is None else (loads.stresses, loads.yielding, loads.buckling)
        uses = [float(part[0, row]) for part in parts] or [np.nan] * 3
        can = "" if found is None else "yes" if found.can_push[row] else "no"
        chosen = "no: a choice" if rod.name in state.determinacy.chosen else "yes"
        rods.append((rod.name, state.rod_lengths[row], state.rod_forces[row], *uses, can, chosen))
    heads = ("string", "rest length [m]", "length [m]", "tension [N]", "of its strength", "can pull in self-stress")
    rod_heads = (
        "rod",
        "length [m]",
        "force [N]",
        "stress [Pa]",
        "of yield",
        "of buckling",
        "can push in self-stress",
        "determined",
    )
    nodes = [
        (name, *load, *reaction)
        for name, load, reaction in zip(structure.node_names, state.loads, reactions(state), strict=True)
        if np.any(load) or np.any(reaction)
    ]
    nodes.append(("all", *state.loads.sum(axis=0), *reactions(state).sum(axis=0)))
    node_heads = ("node", *(f"{what} {axis} [N]" for what in ("load", "reaction") for axis in "xyz"))
    both = ((node_heads, nodes, "loads and reactions"), (heads, strings, "strings"), (rod_heads, rods, "rods"))
    return [Table(title, columns, rows, folded=True) for columns, rows, title in both if rows]
