"""The work-precision diagram: error against cost on logarithmic axes, a panel for each experiment."""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from tensegrity_mj.basics.texts import figure_text
from tensegrity_mj.errors import OptionError
from tensegrity_mj.pictures import palette
from tensegrity_mj.pictures.figure import GREY, frame, new_figure
from tensegrity_mj.studies.tradeoff.sentence import metres

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Data = Mapping[str, Any]

BLUE, GREEN, RED, CYAN, VIOLET, ORANGE, DARK = palette.CYCLE
BROWN = (0.55, 0.33, 0.16)
PANEL = (3.1, 2.6)  # inches
COLUMNS = 4
LEGEND_ROW, LEGEND_COLUMN = 0.2, 2.0  # inches
LEAST = 1e-16  # m: errors of nothing at all are drawn here
TOP = 0.955  # of a panel's height: where runs without an error stand


class Cost(enum.Enum):
    """What the horizontal axis shows."""

    WALL_TIME = "wall time [s]"
    RIGHT_HAND_SIDES = "right-hand sides"


@dataclass(frozen=True)
class Style:
    """How a family is drawn."""

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


@dataclass(frozen=True)
class Panel:
    """One experiment, or a part of its families."""

    experiment: Data
    timing: Data
    title: str
    families: Sequence[str]


def has_diagram(data: Data) -> bool:
    """Whether some experiment has a reference, and so errors to draw."""
    return any(one["reference"]["engine"] is not None for one in data["experiments"])


def diagram(data: Data, cost: Cost, experiments: Sequence[str] | None = None) -> Figure:
    """The diagram of a study's data.

    Args:
        cost: the horizontal axis.
        experiments: keys of those that are drawn; all that have a reference by default.

    Raises:
        OptionError: where there is nothing to draw.
    """
    panels = _panels(data, experiments)
    if not panels:
        raise OptionError(
            f"scene '{data['scene']['name']}': no experiment has a reference, so there are no errors to draw"
        )
    columns = min(COLUMNS, len(panels)) if len(panels) not in (5, 6) else 3
    rows = math.ceil(len(panels) / columns)
    handles = _handles(panels)
    width = max(columns, 2) * PANEL[0]
    across = int(width / LEGEND_COLUMN)
    legend = LEGEND_ROW * math.ceil(len(handles) / across)
    figure = new_figure(width, rows * PANEL[1] + legend + 0.3)
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    for place, panel in zip(grid, panels, strict=False):
        _draw(place, panel, cost)
    limits = [place.get_xlim() for place, _ in zip(grid, panels, strict=False)]
    for number, place in enumerate(grid):
        if number >= len(panels):
            place.set_axis_off()
            continue
        place.set_xlim(min(low for low, _ in limits), max(high for _, high in limits))
        if number % columns == 0:
            place.set_ylabel("largest node error [m]", fontsize=8)
        if number + columns >= len(panels):
            place.set_xlabel(cost.value, fontsize=8)
    figure.legend(handles=handles, loc="outside lower center", fontsize=7.5, frameon=False, ncols=across)
    law = data["law"] and (data["law"]["description"] or {}).get("law", data["law"]["from"])
    name = data["scene"]["name"] + (f", law {law}" if law else "")
    figure.suptitle(f"{figure_text(name)}: error and cost", fontsize=10)
    return figure


def _panels(data: Data, experiments: Sequence[str] | None) -> list[Panel]:
    found = []
    drawn = [
        one
        for one in data["experiments"]
        if one["reference"]["engine"] is not None and (not experiments or one["key"] in experiments)
    ]
    # Treatments of drift are compared where the law is at work, if there is one.
    unheld = [one["key"] for one in drawn if one["actuation"] == "continuous"]
    for experiment in drawn:
        timing = data["timing"]["experiments"][experiment["key"]]
        run = [one for one in experiment["points"] if one["status"] != "refused"]
        names = list(dict.fromkeys(one["family"] for one in run))
        treated = [name for name in names if name.endswith(ONLY_TREATED)]
        found.append(Panel(experiment, timing, _title(experiment), [name for name in names if name not in treated]))
        if treated and experiment["key"] == unheld[-1]:
            own = [name for name in names if name in TREATED or name in treated]
            found.append(Panel(experiment, timing, f"{_title(experiment)}: {DRIFT}", own))
    return found


def costs(experiment: Data, timing: Data, cost: Cost) -> list[float | None]:
    """One a point; of runs that ended early, what the whole would have cost at that pace."""
    found: list[float | None] = []
    for one, clocked in zip(experiment["points"], timing["points"], strict=True):
        value = clocked["wall_time"] if cost is Cost.WALL_TIME else one.get("evaluations")
        simulated = one.get("simulated")
        if value and one["error"] is None and simulated:
            value *= experiment["duration"] / simulated
        found.append(value or None)
    return found


def _draw(place: Axes, panel: Panel, cost: Cost) -> None:
    experiment, reference = panel.experiment, panel.experiment["reference"]
    spent = [math.nan if value is None else value for value in costs(experiment, panel.timing, cost)]
    own = reference["own_error"]
    drawn: list[float] = []
    front = panel.timing["front"] if cost is Cost.WALL_TIME else experiment["by_right_hand_sides"]["front"]
    shown = [number for number in front if experiment["points"][number]["family"] in panel.families]
    place.plot(
        [spent[number] for number in shown],
        [max(experiment["points"][number]["error"], LEAST) for number in shown],
        color=(0.78, 0.80, 0.83), lw=6, solid_capstyle="round", solid_joinstyle="round", zorder=1,
    )  # fmt: skip
    for family in panel.families:
        style = STYLES.get(family, Style(GREY, "x"))
        members = [number for number, one in enumerate(experiment["points"]) if one["family"] == family]
        known = [number for number in members if experiment["points"][number]["error"] is not None]
        x = [spent[number] for number in known]
        y = [max(experiment["points"][number]["error"], LEAST) for number in known]
        drawn += y
        place.plot(
            x, y, color=style.color, ls=style.line, lw=0.9, marker=style.marker, ms=3.4,
            mfc="white" if style.hollow else style.color, mew=0.8, zorder=3,
        )  # fmt: skip
        lost = [spent[number] for number in members if experiment["points"][number]["error"] is None]
        place.plot(
            lost, [TOP] * len(lost), color=style.color, ls="none", marker="x", ms=5, mew=1.4, in_layout=False,
            transform=place.get_xaxis_transform(), zorder=4,
        )  # fmt: skip
    place.set_xscale("log")
    place.set_yscale("log")
    low = min([own or LEAST, *drawn], default=LEAST)
    high = max([*drawn, low * 10], default=1.0)
    place.set_ylim(max(low, LEAST) / 30, high * 300)
    _lines(place, experiment, own)
    frame(place, panel.title, legend=False, small=1.0)


def _lines(place: Axes, experiment: Data, own: float | None) -> None:
    """The reference's own error as a band, and the modelling floor as a line."""
    if own:
        place.axhspan(LEAST / 1e4, own, color=(0.93, 0.93, 0.95), lw=0, zorder=0)
        place.text(
            0.02, 0.02, f"reference known to {metres(own)}", fontsize=6.5, color=palette.FAINT_TEXT, va="bottom",
            transform=place.transAxes, in_layout=False,
        )  # fmt: skip
    floor = experiment["modelling_floor"]
    if floor is not None and floor["distance"]:
        place.axhline(floor["distance"], color=palette.WARNING, lw=1.0, ls=(0, (4, 2)), zorder=2)
        place.text(
            0.985, floor["distance"], f"modelling floor {metres(floor['distance'])}", fontsize=6.5,
            color=palette.WARNING, va="bottom", ha="right", transform=place.get_yaxis_transform(),
            bbox={"facecolor": "white", "alpha": 0.7, "edgecolor": "none", "pad": 0.6}, zorder=5,
            in_layout=False,
        )  # fmt: skip


def _handles(panels: Sequence[Panel]) -> list[Any]:
    """What the legend holds."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    names = [name for name in STYLES if any(name in panel.families for panel in panels)]
    handles: list[Any] = [
        Line2D(
            [],
            [],
            color=STYLES[name].color,
            ls=STYLES[name].line,
            lw=1.1,
            marker=STYLES[name].marker,
            ms=4,
            mfc="white" if STYLES[name].hollow else STYLES[name].color,
            label=name,
        )
        for name in names
    ]
    every = [one for panel in panels for one in panel.experiment["points"] if one["family"] in panel.families]
    if any(one["error"] is None for one in every):
        handles.append(Line2D([], [], color=GREY, ls="none", marker="x", ms=5, mew=1.4, label="unstable or failed"))
    handles.append(Line2D([], [], color=(0.78, 0.80, 0.83), lw=6, label="Pareto front"))
    if any(panel.experiment["modelling_floor"] for panel in panels):
        handles.append(Line2D([], [], color=palette.WARNING, lw=1.0, ls=(0, (4, 2)), label="modelling floor"))
    handles.append(Patch(color=(0.93, 0.93, 0.95), label="below the reference's own error"))
    return handles


def _title(experiment: Data) -> str:
    """A panel's title: short."""
    if experiment["loop"] == "open":
        return "Open loop"
    if experiment["period"] is None:
        return "Law at every stage"
    text = str(experiment["title"]).partition(", ")[2]
    return text[:1].upper() + text[1:]
