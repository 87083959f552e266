"""The page of a static study: one HTML file that holds its pictures.

They show where the structure stands, what its members carry, paths and modes.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.jsontext import plain
from tensegrity_mj.basics.texts import figure_text
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.pictures import palette
from tensegrity_mj.pictures.figure import GREY, Axes, Figure, frame, grid_of_panels, new_figure, note
from tensegrity_mj.pictures.page import Picture, Section, Table, write_sections
from tensegrity_mj.pictures.run_panels import draw_curves
from tensegrity_mj.pictures.ticks import prefix_ticks
from tensegrity_mj.statics.findings import StaticResult, judgement, reactions
from tensegrity_mj.statics.modes import Modes
from tensegrity_mj.statics.path import Response
from tensegrity_mj.statics.path_steps import Kind
from tensegrity_mj.statics.state import StaticState

USES = {"member": "member", "criterion": "criterion", "force": "force [N]", "limit": "limit [N]"}  # heads of a `Use`
USES |= {"utilisation": "utilisation", "time": "time [s]"}
EXPLAINED = (
    "Grey is where the scene starts, colour the equilibrium. Rods are straight and carry axial forces alone, and "
    "strings only pull; notes say what of the scene has no part in it, and docs/statics.md what is computed and how."
)


def write_statics_page(path: str | os.PathLike[str], study: StaticResult) -> Path:
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
    found = judgement(study)
    lines = [("" if one.mark is None else one.mark.value, one.name, one.text) for one in found.findings]
    sections.append(Section("All that was found", parts=[Table("A line each", ("", "", ""), lines, folded=True)]))
    scene = study.model.scene
    source = f"The scene is from {scene.source}. " if scene.source else ""
    return write_sections(path, f"Statics of {scene.name}", source + EXPLAINED, sections, opening=found.html())


def _found(study: StaticResult, state: StaticState) -> list[Section]:
    sections = [
        Section(
            "Equilibrium",
            parts=[
                Picture(structure_figure(study.model.scene.nodes0, state), "Before (grey), and in equilibrium"),
                Picture(members_figure(state), "What members carry"),
                *_tables(study, state),
            ],
        )
    ]
    if study.response is not None:
        parts = [
            Picture(
                response_figure(study.response),
                "Along the path; dots where a string becomes slack or taut, other marks where stability changes",
            )
        ]
        buckled = buckling_figure(study.response)
        if buckled is not None:
            parts.append(Picture(buckled, "The motion that nothing resists at the critical points"))
        sections.append(Section("Path", parts=parts))
    if study.modes is not None:
        modes = modes_figure(study.modes)
        rows = list(enumerate(study.modes.frequencies.tolist(), start=1))
        rows = [(*row, *masses) for row, masses in zip(rows, study.modes.effective_masses.tolist(), strict=True)]
        columns = ("mode", "frequency [Hz]", "effective mass x [kg]", "y [kg]", "z [kg]")
        pictures = [] if modes is None else [Picture(modes, "The first modes, over the equilibrium (grey)")]
        numbers = Table("all modes", columns, rows, folded=True)
        sections.append(Section("Natural modes", study.modes.describe(), [*pictures, numbers]))
    return sections


def _tables(study: StaticResult, state: StaticState) -> list[Table]:
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


ELEVATION, AZIMUTH = np.radians(22.0), np.radians(-55.0)
FLAT = 1e-6  # of the largest extent: thinner is a plane
SLENDER = 0.35  # of the largest extent: a second one below it is seen from the side
NAMED = 40  # members that a bar chart names
PANELS = 6
MODE_SIZE = 0.12  # of the largest extent: how far the most moved node of a drawn mode goes
CURVES = 6
WIDTH, LEAST_WIDTH = 9.0, 4.0  # inches
BAR = 1.4  # inches, the scale of tensions with its numbers
FAINT = (0.72, 0.74, 0.77)


def structure_figure(before: Array, state: StaticState) -> Figure:
    """The structure before, in grey, and in equilibrium, its strings in the colours of their tensions."""
    points = np.concatenate([before, state.nodes])
    view = _view(points)
    tall, size = _height(points, view), np.ptp(points @ view.T, axis=0)
    # An upright structure leaves no empty space beside it, which would be all that a phone shows.
    figure = new_figure(float(np.clip(tall * size[0] / max(float(size[1]), 1e-12) + BAR, LEAST_WIDTH, WIDTH)), tall)
    panel = figure.subplots()
    structure, whole = state.model.structure, state.model.whole
    _draw(panel, structure, before @ view.T, whole, (FAINT, FAINT), 0.9)
    largest = float(state.tensions.max(initial=0.0))
    colors = palette.tension_colors(state.tensions / (largest or 1.0))
    colors[state.slack] = palette.SLACK
    _draw(panel, structure, state.nodes @ view.T, whole, (palette.ROD, colors), 1.1, 2.6)
    if largest > 0:
        from matplotlib.cm import ScalarMappable
        from matplotlib.colors import ListedColormap, Normalize

        scale = ScalarMappable(Normalize(0.0, largest), ListedColormap(palette.tension_colors(np.linspace(0, 1, 128))))
        bar = figure.colorbar(scale, ax=panel, shrink=0.7, label="tension [N]")
        bar.ax.tick_params(labelsize=8)
        prefix_ticks(bar.ax)
    _space(panel)
    _scale_bar(panel)
    return figure


def members_figure(state: StaticState) -> Figure:
    """Tensions of the strings and axial forces of the rods, the largest first; those that are a choice are hatched."""
    structure, whole = state.model.structure, state.model.whole
    kinds = [
        (
            "strings",
            "tension [N]",
            np.array([s.name for s in structure.strings])[whole].tolist(),
            state.tensions[whole],
        ),
        ("rods", "axial force [N]", [rod.name for rod in structure.rods], state.rod_forces),
    ]
    kinds = [kind for kind in kinds if len(kind[2])]
    figure = new_figure(WIDTH, 3.2)
    for panel, (title, unit, names, values) in zip(np.atleast_1d(figure.subplots(1, len(kinds))), kinds, strict=True):
        order = np.argsort(-np.abs(values), kind="stable")
        colors = [palette.CYCLE[0] if value >= 0 else palette.CYCLE[2] for value in values[order]]
        width, chosen = 0.8 if len(values) <= NAMED else 1.0, state.determinacy.chosen if title == "rods" else ()
        bars = panel.bar(np.arange(len(values)), values[order], color=colors, width=width)
        for bar, k in zip(bars, order, strict=True):
            if names[k] in chosen:
                bar.set(hatch="////", edgecolor="white")
        if len(values) <= NAMED:
            panel.set_xticks(np.arange(len(values)), [figure_text(names[k]) for k in order], rotation=90)
        else:
            panel.set_xlabel(f"{len(values)} {title}, the largest first", fontsize=9)
        frame(
            panel,
            f"rods: red in compression{', hatched: a choice' * bool(chosen)}" if title == "rods" else title,
            y=unit,
        )
    return figure


def response_figure(response: Response) -> Figure:
    """Force over displacement, the lowest stiffness, tensions and rod forces along a path."""
    path = response.path
    s = path.parameters
    figure = new_figure(WIDTH, 7.4)
    panels = figure.subplots(2, 2)
    for number, curve in enumerate(response.curves[:CURVES]):
        color = palette.CYCLE[number % len(palette.CYCLE)]
        panels[0, 0].plot(curve.displacement, curve.force, color=color, lw=1.4, label=figure_text(curve.name))
        for critical in path.criticals:
            at = _along(response, critical.parameter, critical.state.nodes)
            panels[0, 0].plot(
                np.interp(at, np.arange(len(s)), curve.displacement),
                np.interp(at, np.arange(len(s)), curve.force),
                **_mark(critical.kind),
            )
        for event in response.slack_events:
            panels[0, 0].plot(curve.displacement[event.point], curve.force[event.point], ".", ms=4, color=palette.SLACK)
    frame(panels[0, 0], "force over displacement", "displacement [m]", "force [N]")
    low = path.lowest.copy()
    low[~np.isfinite(low)] = np.nan
    panels[0, 1].plot(s, low, color=palette.CYCLE[0], lw=1.4)
    panels[0, 1].axhline(0.0, color=GREY, lw=0.8)
    for kind in dict.fromkeys(critical.kind for critical in path.criticals):
        points = [critical.parameter for critical in path.criticals if critical.kind is kind]
        panels[0, 1].plot(points, np.zeros(len(points)), label=kind.value, **_mark(kind))
    frame(panels[0, 1], "lowest stiffness", x="parameter", y="stiffness [N/m]")
    structure = path.model.structure
    for event in response.slack_events:
        panels[1, 0].plot(event.parameter, 0.0, ".", ms=4, color=palette.SLACK)
    for panel, values, members, title in (
        (panels[1, 0], path.tensions, structure.strings, "tensions"),
        (panels[1, 1], path.rod_forces, structure.rods, "axial forces of rods"),
    ):
        if members:
            draw_curves(panel, s, values, [one.name for one in members])
        else:
            note(panel, "none")
        frame(panel, title, "parameter", "force [N]")
    return figure


def modes_figure(modes: Modes) -> Figure | None:
    """The first modes, each drawn on one side over the equilibrium; None where there is none."""
    shapes = [modes.shapes[:, k].reshape(-1, 3) for k in range(min(PANELS, len(modes.squares)))]
    what = [
        "grows" if grows else "held by nothing" if loose else f"{frequency:.4g} Hz"
        for grows, loose, frequency in zip(modes.unstable, modes.loose, modes.frequencies, strict=True)
    ]
    titles = [f"{k + 1}: {what[k]}" for k in range(len(shapes))]
    return _shapes_figure(modes.state, shapes, titles)


def buckling_figure(response: Response) -> Figure | None:
    """Plot the motions by which the structure leaves its path at its critical points; None where there are none."""
    found = response.path.criticals[:PANELS]
    if not found:
        return None
    titles = [f"{critical.kind.value}, parameter {critical.parameter:.4g}" for critical in found]
    return _shapes_figure(found[0].state, [critical.mode for critical in found], titles, [c.state.nodes for c in found])


def _shapes_figure(
    state: StaticState, shapes: list[Array], titles: list[str], places: list[Array] | None = None
) -> Figure | None:
    if not shapes:
        return None
    structure, whole = state.model.structure, state.model.whole
    at = [state.nodes] * len(shapes) if places is None else places
    reach = MODE_SIZE * float(np.max(state.nodes.max(axis=0) - state.nodes.min(axis=0)) or 1.0)
    sizes = [float(np.linalg.norm(shape, axis=1).max()) for shape in shapes]
    moved = [x + shape * (reach / size) for x, shape, size in zip(at, shapes, sizes, strict=True)]
    # Looked at together: motions across a plane are not seen along its normal.
    view = _view(np.concatenate([*at, *moved]))
    width = WIDTH / min(3, len(shapes))
    height = _height(np.concatenate([*at, *moved]), view, width)
    figure, panels = grid_of_panels(len(shapes), 3, width, height + 0.3)
    for panel, x, there, title in zip(panels, at, moved, titles, strict=True):
        _draw(panel, structure, x @ view.T, whole, (FAINT, FAINT), 0.7)
        _draw(panel, structure, there @ view.T, whole, (palette.CYCLE[0], palette.CYCLE[5]), 0.8, 1.8)
        panel.set_title(title, fontsize=9)
        _space(panel)
    return figure


def _view(points: Array) -> Array:
    """(2, 3): right and up, as one looks at these points: along the normal of a plane, from the side of a beam."""
    look = np.array([np.cos(ELEVATION) * np.cos(AZIMUTH), np.cos(ELEVATION) * np.sin(AZIMUTH), np.sin(ELEVATION)])
    _, singular, axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)
    up = np.array([0.0, 0.0, 1.0])
    if singular[1] > FLAT * singular[0] and singular[2] <= FLAT * singular[0]:
        look = axes[2] * (np.sign(axes[2] @ look) or 1.0)
    elif singular[1] <= SLENDER * singular[0]:
        look = look - (look @ axes[0]) * axes[0]
    look = look / np.linalg.norm(look)
    if abs(up @ look) > 0.999:
        up = np.array([0.0, 1.0, 0.0])
    up = up - (up @ look) * look
    up = up / np.linalg.norm(up)
    view = np.array([np.cross(up, look), up])
    if singular[1] <= SLENDER * singular[0]:
        # Beams lie: they would be a narrow strip upright.
        along = view @ axes[0]
        along = along / np.linalg.norm(along) * (np.sign(along[0]) or 1.0)
        view = np.array([[along[0], along[1]], [-along[1], along[0]]]) @ view
    return view


def _height(points: Array, view: Array, width: float = WIDTH) -> float:
    """Inches, in proportion to what is drawn."""
    flat = points @ view.T
    size = flat.max(axis=0) - flat.min(axis=0)
    return float(np.clip(width * size[1] / max(float(size[0]), 1e-12), 0.22 * width, 0.62 * width))


def _draw(
    panel: Axes, structure: Structure, flat: Array, whole: Any, colors: tuple[Any, Any], width: float, rod: float = 0.0
) -> None:
    """Rods and edges of bodies, twice as wide as strings or `rod` wide, and the whole ones of M strings."""
    from matplotlib.collections import LineCollection

    segments, strings = structure.paths.nodes, structure.paths.strings
    drawn = whole[strings]
    each = colors[1][strings[drawn]] if isinstance(colors[1], np.ndarray) else colors[1]
    bars = np.concatenate([structure.rod_nodes, structure.body_edges])
    for pairs, color, wide in ((bars, colors[0], rod or 2 * width), (segments[drawn], each, width)):
        if len(pairs):
            panel.add_collection(LineCollection(flat[pairs], colors=color, linewidths=wide, capstyle="round"))


def _space(panel: Axes) -> None:
    panel.autoscale_view()
    panel.margins(0.04)
    panel.set_aspect("equal")
    panel.set_axis_off()


def _scale_bar(panel: Axes) -> None:
    left, right = panel.get_xlim()
    bottom, top = panel.get_ylim()
    wanted = 0.25 * (right - left)
    unit = 10.0 ** np.floor(np.log10(wanted))
    length = float(unit * max(step for step in (1, 2, 5) if step * unit <= wanted))
    y = bottom - 0.04 * (top - bottom)
    panel.plot([left, left + length], [y, y], color=GREY, lw=1.5, solid_capstyle="butt")
    panel.annotate(f"{length:g} m", (left, y), (0, -3), textcoords="offset points", fontsize=8, color=GREY, va="top")
    panel.set_ylim(bottom - 0.12 * (top - bottom), top)


def _along(response: Response, parameter: float, nodes: Array) -> float:
    """Return where a critical state lies on the path: the number of the point before it, plus a fraction."""
    path = response.path
    flat = np.concatenate([path.nodes.reshape(len(path.states), -1), path.parameters[:, None]], axis=1)
    here = np.append(nodes.ravel(), parameter)
    best = (np.inf, 0.0)
    for k in range(len(flat) - 1):
        span = flat[k + 1] - flat[k]
        part = float(np.clip((here - flat[k]) @ span / max(float(span @ span), 1e-300), 0.0, 1.0))
        best = min(best, (float(np.linalg.norm(here - flat[k] - part * span)), k + part))
    return best[1]


def _mark(kind: Kind) -> dict[str, Any]:
    shape, color = {
        Kind.LIMIT: ("^", palette.CYCLE[2]),
        Kind.BIFURCATION: ("o", palette.CYCLE[4]),
        Kind.SLACK: ("s", palette.SLACK),
    }[kind]
    return {"marker": shape, "color": color, "ls": "none", "ms": 6, "zorder": 5}
