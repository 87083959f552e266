"""The study as one self-contained HTML page, made of its data alone."""

from __future__ import annotations

import enum
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from tensegrity_mj.basics.texts import figure_text, shortened
from tensegrity_mj.basics.units import quantity
from tensegrity_mj.errors import OptionError
from tensegrity_mj.pictures import palette
from tensegrity_mj.pictures.figure import GREY, Axes, Figure, common_legend, frame, grid_of_panels
from tensegrity_mj.pictures.findings import Finding, Judgement, Mark
from tensegrity_mj.pictures.page import Picture, Section, Table
from tensegrity_mj.runs.judgement import in_short, judge
from tensegrity_mj.studies.report import Page
from tensegrity_mj.studies.tradeoff import advising
from tensegrity_mj.studies.tradeoff.advising import with_timing
from tensegrity_mj.studies.tradeoff.reference import SURE

Data = Mapping[str, Any]

COLUMNS = {
    "family": "engine",
    "knob": "step or tolerance",
    "error": "largest error [m]",
    "final_error": "error at the end [m]",
    "wall_time": "wall time [s]",
    "real_time_factor": "x real time",
    "steps": "steps",
    "evaluations": "right-hand sides",
    "megabytes": "memory [MB]",
    "remark": "remark",
}
USUAL = 1e-6  # m, the accuracy that the verdict is about
MOST_LETTERS = 160  # of a reason


def page_of(data: Data) -> Page:
    scene = data["scene"]
    members = ", ".join(f"{kind}: {scene[kind]}" for kind in ("rods", "bodies", "strings") if scene.get(kind))
    introduction = (
        f"{scene['name']} ({members}). Errors are the largest distance of a node from where the reference has it, at "
        "the recorded times: of the same experiment, solved tightly. What holding a control does to the motion is the "
        "modelling floor, the distance of a held experiment's reference from the continuous law's. Wall times are the "
        "smallest of several runs on one machine, without compiling and loading."
    )
    title = f"Speed against accuracy: {scene['name']}"
    return Page(title, introduction, Judgement(_verdict(data), tuple(_findings(data))), _sections(data))


def _verdict(data: Data) -> str:
    """Name the fastest setting for a usual accuracy of the first experiment that has advice."""
    for _, timing in advising.with_timing(data):
        advice = [one for one in timing["advice"] if one["text"]]
        if advice:
            one = min(advice, key=lambda one: abs(math.log(one["tolerance"] / USUAL)))
            best = advising.advice_alone(one)
            return f"For errors of at most {quantity(one['tolerance'], 'm')} here: {best}."
    return f"No setting of {data['scene']['name']} is advised: see each experiment."


def _findings(data: Data) -> Iterator[Finding]:
    """Yield findings on how sure each experiment's reference is, and on what holding a control costs."""
    for experiment, timing in advising.with_timing(data):
        reference, title = experiment["reference"], experiment["title"]
        head = title[:1].upper() + title[1:]
        if reference["engine"] is None:
            yield Finding(Mark.BAD, f"{head}: no reference ({reference['reason']}).")
            continue
        second, allowed = reference["second_formulation"], SURE * (reference["motion"] or 0.0)
        error = math.inf if reference["own_error"] is None else reference["own_error"]
        own = f", known to {quantity(error, 'm', 2)} (allowed {quantity(allowed, 'm', 2)})"
        confirmed = "no second formulation confirms it" if second is None else f"{second['engine']} confirms it"
        if error > allowed:
            confirmed = "too little to measure errors against"
        found = judge(
            "own error", error, allowed, "m", [*([confirmed] if second is None else []), *reference["doubts"]]
        )
        doubt = f"; it is in doubt: {in_short(reference['doubts'])}" if reference["doubts"] else ""
        yield Finding(Mark(found.word), f"{head}{own}: {confirmed}{doubt}.")
        if timing["floor"] is not None:
            yield Finding(Mark.UNJUDGED, f"{timing['floor'][:1].upper()}{timing['floor'][1:]}.")


def _sections(data: Data) -> Iterator[Section]:
    if has_diagram(data):
        pictures = [
            Picture(diagram(data, Cost.WALL_TIME), "Error against wall time"),
            Picture(diagram(data, Cost.RIGHT_HAND_SIDES), "Error against right-hand sides: the same on any machine"),
        ]
        yield Section("Work and precision", (), pictures)
    yield Section("What to use", (), list(_advice(data)))
    for experiment, timing in advising.with_timing(data):
        run = f"{experiment['duration']:g} s, recorded each {experiment['interval']:g} s."
        parts = [Table("Reference", ("", ""), _reference(experiment))]
        if experiment["reference"]["engine"] is not None:
            title = f"All {len(experiment['points'])} settings"
            parts.append(Table.of(title, COLUMNS, rows(experiment, timing), folded=True))
        text = [run, *advising.remarks(experiment, data["scene"].get("duration", experiment["duration"]))]
        yield Section(experiment["title"][:1].upper() + experiment["title"][1:], text, parts)
    versions = [[name, value] for name, value in data["versions"].items()]
    options = [[name.replace("_", " "), value] for name, value in data["options"].items()]
    yield Section(
        "How it was run",
        (),
        [Table("Options", ("", ""), options, folded=True), Table("Versions", ("", ""), versions, folded=True)],
    )


def _advice(data: Data) -> Iterator[Table]:
    floors = []
    for experiment, timing in advising.with_timing(data):
        if timing["floor"] is not None:
            floors.append((experiment["title"], timing["floor"].partition(": ")[2]))
            continue
        facts = advising.advice_rows(experiment, timing)
        title = experiment["title"][:1].upper() + experiment["title"][1:]
        yield Table(title, advising.ADVICE, facts, "" if facts else advising.why_none(experiment))
    if floors:
        yield Table(
            "Held controls", ("", "modelling error, which no step reduces, and a setting that is fine enough"), floors
        )


def _reference(experiment: Data) -> list[tuple[str, object]]:
    reference, floor = experiment["reference"], experiment["modelling_floor"]
    facts: list[tuple[str, object]] = [("reference", reference["engine"] or f"none: {reference['reason']}")]
    if reference["engine"] is not None:
        looser, second = reference["looser"], reference["second_formulation"]
        facts += [
            ("largest motion of a node [m]", reference["motion"]),
            ("its own error, at most about [m]", reference["own_error"]),
            (f"difference from {looser['engine']} [m]", looser["difference"]),
        ]
        if second is None:
            facts.append(("second formulation", "none that can do this"))
        else:
            facts.append((f"difference from {second['engine']} [m]", second["difference"]))
    if floor is not None:
        distance = floor["reason"] if floor["distance"] is None else floor["distance"]
        facts.append(("modelling floor: distance from the continuous law's motion [m]", distance))
        facts.append(("the same at the end [m]", floor["final_distance"]))
    return facts


def rows(experiment: Data, timing: Data) -> list[Data]:
    """The table of all settings; a family that is refused for one reason throughout is one row."""
    found: list[Data] = []
    for one, clocked in zip(experiment["points"], timing["points"], strict=True):
        if one["status"] == "refused":
            row: Data = {"family": one["family"], "knob": "", "remark": remark(one)}
            if row not in found:
                found.append(row)
            continue
        wall = clocked["wall_time"] if one["error"] is not None else None
        memory = None if one["memory"] is None else one["memory"] / 1e6
        found.append({**one, **clocked, "wall_time": wall, "megabytes": memory, "remark": remark(one)})
    return found


def remark(point: Data) -> str:
    """Return a remark on a point that its numbers alone do not show."""
    if point["error"] is None:
        return f"{point['status']}: {shortened(point['reason'], MOST_LETTERS)}"
    notes = ["at the reference's floor"] if point["at_reference_floor"] else []
    if not point["repeatable"]:
        notes.append("not the same at each run")
    return ", ".join(notes)


BLUE, GREEN, RED, CYAN, VIOLET, ORANGE, DARK = palette.CYCLE
BROWN = (0.55, 0.33, 0.16)
PANEL = (3.1, 2.6)  # inches
MOST_BESIDE = 4
LEGEND_ROW, LEGEND_COLUMN = 0.2, 2.0  # inches
LEAST = 1e-16  # m: errors of nothing at all are drawn here
TOP = 0.955  # of a panel's height: where runs without an error stand
CROSS: Any = {"ls": "none", "marker": "x", "ms": 5, "mew": 1.4}  # how these are drawn


class Cost(enum.Enum):
    """Quantity on the horizontal axis."""

    WALL_TIME = "wall time [s]"
    RIGHT_HAND_SIDES = "right-hand sides"


class Style(NamedTuple):
    """Style in which a family is drawn."""

    color: tuple[float, float, float]
    marker: str
    line: str = "-"
    hollow: bool = False


STYLES = {
    "MuJoCo Euler": Style(BLUE, "o"),
    "MuJoCo implicitfast": Style(CYAN, "s"),
    "MuJoCo implicit": Style(VIOLET, "^"),
    "MuJoCo discrete": Style(ORANGE, "v"),
    "MuJoCo RK4": Style(RED, "D"),
    "DAE RK4": Style(GREEN, "o"),
    "DAE DOP853": Style(DARK, "s"),
    "DAE Radau": Style(BROWN, "^"),
    "ODE RK4": Style(GREEN, "o", "--", True),
    "ODE DOP853": Style(DARK, "s", "--", True),
    "ODE Radau": Style(BROWN, "^", "--", True),
    "DAE RK4, monitor": Style(CYAN, "o"),
    "DAE RK4, Baumgarte": Style(VIOLET, "o"),
    "DAE DOP853, normalize": Style(BLUE, "s"),
    "DAE DOP853, Baumgarte": Style(ORANGE, "s"),
}
TREATED = ("DAE RK4", "DAE DOP853")  # families that drift treatments are compared on
ONLY_TREATED = (", monitor", ", normalize", ", Baumgarte")
DRIFT = "drift treatments"


def has_diagram(data: Data) -> bool:
    """Return whether some experiment has a reference, and so errors to draw."""
    return any(one["reference"]["engine"] is not None for one in data["experiments"])


def diagram(data: Data, cost: Cost) -> Figure:
    """The diagram of a study's data, of all experiments that have a reference.

    Args:
        cost: the horizontal axis.

    Raises:
        OptionError: where there is nothing to draw.
    """
    panels = _panels(data)
    if not panels:
        raise OptionError(
            f"scene '{data['scene']['name']}': no experiment has a reference, so there are no errors to draw"
        )
    columns = min(MOST_BESIDE, len(panels)) if len(panels) not in (5, 6) else 3
    across = int(max(columns, 2) * PANEL[0] / LEGEND_COLUMN)
    legend = LEGEND_ROW * math.ceil((len({name for *_, families in panels for name in families}) + 4) / across)
    width = PANEL[0] if columns > 1 else 2 * PANEL[0]
    figure, places = grid_of_panels(len(panels), columns, width, PANEL[1], legend + 0.3)
    for place, panel in zip(places, panels, strict=True):
        _draw(place, cost, *panel)
    limits = np.array([place.get_xlim() for place in places])
    for number, place in enumerate(places):
        place.set_xlim(limits[:, 0].min(), limits[:, 1].max())
        if number % columns == 0:
            place.set_ylabel("largest node error [m]", fontsize=8)
        if number + columns >= len(panels):
            place.set_xlabel(cost.value, fontsize=8)
    common_legend(figure, places, across, 7.5)
    law = data["law"] and (data["law"]["description"] or {}).get("law", data["law"]["from"])
    name = data["scene"]["name"] + (f", law {law}" if law else "")
    figure.suptitle(f"{figure_text(name)}: error and cost", fontsize=10)
    return figure


def _panels(data: Data) -> list[tuple[Data, Data, str, list[str]]]:
    """Experiments with their timing, title and families, or a part of these."""
    found = []
    drawn = [pair for pair in with_timing(data) if pair[0]["reference"]["engine"] is not None]
    # Treatments of drift are compared where the law is at work, if there is one.
    unheld = [one["key"] for one, _ in drawn if one["actuation"] == "continuous"]
    for experiment, timing in drawn:
        run = [one for one in experiment["points"] if one["status"] != "refused"]
        names = list(dict.fromkeys(one["family"] for one in run))
        treated = [name for name in names if name.endswith(ONLY_TREATED)]
        found.append((experiment, timing, _title(experiment), [name for name in names if name not in treated]))
        if treated and experiment["key"] == unheld[-1]:
            own = [name for name in names if name in TREATED or name in treated]
            found.append((experiment, timing, f"{_title(experiment)}: {DRIFT}", own))
    return found


def costs(experiment: Data, timing: Data, cost: Cost) -> list[float | None]:
    """Return the cost of each point; of runs that ended early, what the whole would have cost at that pace."""
    found: list[float | None] = []
    for one, clocked in zip(experiment["points"], timing["points"], strict=True):
        value = clocked["wall_time"] if cost is Cost.WALL_TIME else one.get("evaluations")
        simulated = one.get("simulated")
        if value and one["error"] is None and simulated:
            value *= experiment["duration"] / simulated
        found.append(value or None)
    return found


def _draw(place: Axes, cost: Cost, experiment: Data, timing: Data, title: str, families: Sequence[str]) -> None:
    own = experiment["reference"]["own_error"]
    spent = np.array(costs(experiment, timing, cost), float)  # NaN where there is none
    errors = np.maximum(np.array([one["error"] for one in experiment["points"]], float), LEAST)
    failed = np.isnan(errors)
    family_of = np.array([one["family"] for one in experiment["points"]])
    for family in families:
        style, members = STYLES.get(family, Style(GREY, "x")), family_of == family
        place.plot(
            spent[members & ~failed], errors[members & ~failed], color=style.color, ls=style.line, lw=0.9,
            marker=style.marker, ms=3.4, mfc="white" if style.hollow else style.color, mew=0.8, zorder=3, label=family,
        )  # fmt: skip
        lost = spent[members & failed]
        place.plot(
            lost, [TOP] * len(lost), color=style.color, in_layout=False, transform=place.get_xaxis_transform(),
            zorder=4, **CROSS,
        )  # fmt: skip
    shown = np.isin(family_of, families)
    if np.any(shown & failed):
        place.plot([], [], color=GREY, label="unstable or failed", **CROSS)
    front = timing["front"] if cost is Cost.WALL_TIME else experiment["by_right_hand_sides"]["front"]
    best = [number for number in front if shown[number]]
    place.plot(
        spent[best], errors[best], color=(0.78, 0.80, 0.83), lw=6, solid_capstyle="round", solid_joinstyle="round",
        zorder=1, label="Pareto front",
    )  # fmt: skip
    place.set_xscale("log")
    place.set_yscale("log")
    drawn = errors[shown & ~failed]
    low = float(drawn.min(initial=own or LEAST))
    place.set_ylim(max(low, LEAST) / 30, float(drawn.max(initial=10 * low)) * 300)
    _lines(place, experiment, own)
    frame(place, title, legend=False, small=1.0)


def _lines(place: Axes, experiment: Data, own: float | None) -> None:
    """The reference's own error as a band, and the modelling floor as a line."""
    floor = experiment["modelling_floor"]
    if floor is not None and floor["distance"]:
        place.axhline(
            floor["distance"], color=palette.WARNING, lw=1.0, ls=(0, (4, 2)), zorder=2, label="modelling floor"
        )
        place.text(
            0.985, floor["distance"], f"modelling floor {quantity(floor['distance'], 'm', 2)}", fontsize=6.5,
            color=palette.WARNING, va="bottom", ha="right", transform=place.get_yaxis_transform(),
            bbox={"facecolor": "white", "alpha": 0.7, "edgecolor": "none", "pad": 0.6}, zorder=2.5,
            in_layout=False,
        )  # fmt: skip
    if own:
        below = "below the reference's own error"
        place.axhspan(LEAST / 1e4, own, color=(0.93, 0.93, 0.95), lw=0, zorder=0, label=below)
        place.text(
            0.02, 0.02, f"reference known to {quantity(own, 'm', 2)}", fontsize=6.5, color=palette.FAINT_TEXT,
            va="bottom", transform=place.transAxes, in_layout=False,
        )  # fmt: skip


def _title(experiment: Data) -> str:
    """A panel's title: short."""
    if experiment["loop"] == "open":
        return "Open loop"
    if experiment["period"] is None:
        return "Law at every stage"
    text = str(experiment["title"]).partition(", ")[2]
    return text[:1].upper() + text[1:]
