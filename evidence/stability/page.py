"""The study as lines of text, as a page and as figures, from its data."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from evidence.stability.cases import AXES
from evidence.stability.study import AGREEMENT, DRAWN, UNEXPLAINED, agreement
from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.texts import aligned
from tensegrity_mj.basics.units import quantity
from tensegrity_mj.engines.table import NAMES, TITLES
from tensegrity_mj.pictures import palette
from tensegrity_mj.pictures.figure import COLUMN, Figure, common_legend, frame, grid_of_panels
from tensegrity_mj.pictures.findings import Finding, Judgement, Mark, mark_of
from tensegrity_mj.pictures.page import Picture, Section, Table
from tensegrity_mj.studies.report import Page
from tensegrity_mj.studies.stable_steps import start_lines, start_section

Data = Mapping[str, Any]

POINTS = {
    "property": "property",
    "value": "value",
    "engine": "engine",
    "predicted": "predicted [s]",
    "measured": "measured [s]",
    "ratio": "ratio",
    "cause": "cause of the difference",
}
COLORS = dict(zip(NAMES, palette.CYCLE, strict=True))
MARKERS = dict(zip(NAMES, "osD^vPX", strict=True))
WITH_ZERO = ("damping", "prestress")
INTRODUCTION = (
    "Predicted from the linear model of each structure, measured by runs with tiny perturbations that either stay "
    "small or grow. ω is the stiffest motion's angular frequency without dampers; 2/ω is semi-implicit Euler's limit. "
    "A dash is no limit up to the largest step that was tried."
)
HEADS = ("", "predicted [s]", "measured [s]", "predicted / measured", "over 2/ω", "rod or mass", "string", "remark")


def page_of(data: Data) -> Page:
    # Pictures come before tables.
    ordered = sorted(sections(data), key=lambda section: not any(isinstance(part, Picture) for part in section.parts))
    title = f"The largest stable step: {data['scene']}"
    return Page(title, INTRODUCTION, judgement_of(data), ordered)


def judgement_of(data: Data) -> Judgement:
    """The verdict, and a finding an engine."""
    return Judgement(_verdict(data), tuple(_findings(data)))


def _verdict(data: Data) -> str:
    """Return a sentence on how well predictions are met, and on the step that is safe at the start."""
    known = [one for one in data["base"]["engines"].values() if one["ratio"]]
    known = [one for one in known if one["measured"] is not None or not one["agrees"]]  # else nothing was measured
    ratios = [one["ratio"] for one in known]
    off = max((abs(ratio - 1.0) for ratio in ratios), default=math.nan)
    steps = [one["predicted"] for one in data["base"]["engines"].values() if one["predicted"]]
    span = f": {quantity(min(steps), 's')} to {quantity(max(steps), 's')} by engine" if steps else ""
    if not data["base"]["engines"]:
        return f"The step of {data['scene']} is not judged: no engine that was chosen simulates it."
    if not ratios and any(one["measured"] is not None for one in data["base"]["engines"].values()):
        return f"The step of {data['scene']} has limits that were measured and not predicted."
    if not ratios:
        return f"Nothing limits the step of {data['scene']} as far as was tried."
    what = f"predicted largest steps of {data['base']['text']}"
    return f"At rest, {what}, are within {100 * off:.1f} % of those measured{span}."


def _findings(data: Data) -> Iterator[Finding]:
    """An engine each, then the random structures."""
    for name, one in data["base"]["engines"].items():
        tried = f"none up to {quantity(one['largest'], 's')}"
        predicted = "none" if one["predicted"] is None else quantity(one["predicted"], "s")
        measured = tried if one["measured"] is None else quantity(one["measured"], "s")
        text = f"{TITLES[name]}: predicted {predicted}, measured {measured}"
        cause = f" ({one['cause']})" if one["cause"] else ""
        known = not one["cause"].startswith(UNEXPLAINED)
        mark = Mark.LIMITED if known else Mark.BAD
        if one["agrees"]:
            # Agreement on a structure that stands in for this one is no praise of it.
            mark = Mark.UNJUDGED if one["measured"] is None or data["base"]["stand_in"] else Mark.GOOD
            cause = "" if one["measured"] is None else f" (ratio {one['ratio']:.3f}, allowed 1 ± {AGREEMENT:g})"
        yield Finding(mark, f"{text}{cause}.")
    for name, words in DRAWN.items():
        if data.get(name):
            total = data[name]["summary"]
            agree, count = total["structures_agree"], total["structures"]
            text = f"{agree} of {count} {words} agree within {100 * total['allowed']:.0f} % in every engine."
            text += f" {failed} could not be computed." if (failed := data[name]["failed"]) else ""
            yield Finding(mark_of(agree, count), text)


def sections(data: Data) -> Iterator[Section]:
    shown = {name: Picture(*drawn) for name, drawn in pictures(data).items()}
    yield start_section(data["start"])
    what = "The base of the maps" if data.get("maps") else "What was measured"
    yield Section("At rest", (f"{what}: {data['base']['text']}.",), [Table("", HEADS, list(rest_rows(data["base"])))])
    if data.get("maps"):
        points = [
            {"property": AXES[row["axis"]][0], "value": row["value"], "engine": TITLES[name], **one}
            for row in data["maps"]
            if row["values"] is not None
            for name, one in row["values"]["engines"].items()
        ]
        drawn = [shown[name] for name in ("maps", "heat") if name in shown]
        yield Section("Maps", (), [*drawn, Table.of("Every point", POINTS, points, folded=True)])
    for name, title in DRAWN.items():
        if data.get(name):
            part, total = data[name], data[name]["summary"]
            engines = [
                [TITLES[engine], one["agree"], one["count"], one["largest_difference"]]
                for engine, one in total["engines"].items()
            ]
            parts: list[Any] = [shown[name]] if name in shown else []
            parts.append(Table("", ("", "agree", "of", "largest difference"), engines))
            if total["causes"]:
                causes = list(total["causes"].items())
                parts.append(Table("Causes of the differences", ("cause", "comparisons"), causes))
            yield Section(title.capitalize(), (f"Seed {part['seed']}: {agreement(part)}.",), parts)


def pictures(data: Data) -> dict[str, tuple[Figure, str]]:
    """All figures that the data has, by name, with their captions."""
    found = {}
    if data.get("maps") and _mapped(data):
        found["maps"] = (
            maps(data),
            "Lines: predicted. Marks: measured. The largest stable step over 2/ω of each structure. A line without "
            "marks: stable at all steps that were tried, up to 300 of 2/ω for discrete and 100 for the others.",
        )
        found["heat"] = (heat(data), "The predicted limit over 2/ω of every engine and map, as a colour.")
    if data.get("random") and any(row["values"] for row in data["random"]["rows"]):
        found["random"] = (
            scatter(data),
            "Random taut structures: predicted against measured limits, and their differences.",
        )
    return found


def maps(data: Data) -> Figure:
    """A panel an axis: predicted lines and measured marks over the property varied."""
    axes = _mapped(data)
    figure, panels = grid_of_panels(len(axes), 3, 1.15 * COLUMN, 0.95 * COLUMN, 0.4)
    for panel, (axis, rows) in zip(panels, axes.items(), strict=True):
        for order, name in enumerate(_engines(data)):
            # The first ones broader: limits that coincide stay visible.
            x, color, width = np.array([row["value"] for row in rows]), COLORS[name], 4.0 - 0.9 * min(order, 3)
            panel.plot(x, _over(rows, name, "predicted"), color=color, lw=width, alpha=0.75, label=TITLES[name])
            panel.plot(x, _over(rows, name, "measured"), MARKERS[name], color=color, ms=3 + width, mfc="none", mew=1.2)
            if axis in WITH_ZERO and x.max() > 0:
                panel.set_xscale("symlog", linthresh=x[x > 0].min())
            else:
                panel.set_xscale("log")
            panel.set_yscale("log")
        frame(panel, "", AXES[axis][0], "limit / (2/ω)", legend=False)
    common_legend(figure, panels)
    return figure


def _mapped(data: Data) -> dict[str, list[Data]]:
    """The points with values of each axis that has some."""
    rows = {axis: [row for row in data["maps"] if row["axis"] == axis and row["values"] is not None] for axis in AXES}
    return {axis: own for axis, own in rows.items() if own}


def _engines(data: Data) -> list[str]:
    """Return the engines that some point of the maps has."""
    return [name for name in NAMES if any(row["values"] and name in row["values"]["engines"] for row in data["maps"])]


def _over(rows: Sequence[Data], name: str, key: str) -> Array:
    """(T,) limits of an engine over 2/ω: ∞ for none, NaN in rows that do not have the engine."""
    found = []
    for row in rows:
        one = row["values"]["engines"].get(name) if row["values"] else None
        found.append(math.nan if one is None else math.inf if one[key] is None else one[key] * one["omega"] / 2)
    return np.array(found)


def heat(data: Data) -> Figure:
    """A panel an axis: engines down, values across, the predicted limit over 2/ω as a colour."""
    from matplotlib.colors import LogNorm

    axes, names = _mapped(data), _engines(data)
    figure, panels = grid_of_panels(len(axes), 3, 1.15 * COLUMN, 0.62 * COLUMN, 0.3)
    image = None
    for panel, (axis, rows) in zip(panels, axes.items(), strict=True):
        table = np.array([_over(rows, name, "predicted") for name in names])
        image = panel.imshow(np.minimum(table, 300.0), aspect="auto", norm=LogNorm(0.01, 300.0), cmap="cividis")
        panel.set_yticks(range(len(names)), [TITLES[name] for name in names], fontsize=7)
        every = max(1, len(rows) // 5)
        ticks = list(range(0, len(rows), every))
        panel.set_xticks(ticks, [_written(rows[k]["value"]) for k in ticks], fontsize=7)
        panel.set_xlabel(AXES[axis][0], fontsize=8)
    if image is not None:
        bar = figure.colorbar(image, ax=panels.tolist(), shrink=0.8)
        bar.set_label("limit / (2/ω), 300 and none alike", fontsize=8)
    return figure


def _written(value: float) -> str:
    """A number in full, 500, or as a power of ten where that is long."""
    if value == 0.0 or 1e-3 < abs(value) < 1e4:
        return f"{value:.3g}" if abs(value) < 1e3 else f"{value:.0f}"
    factor, power = f"{value:.1e}".split("e")
    times = "" if float(factor) == 1.0 else rf"{float(factor):g} \cdot "
    return f"${times}10^{{{int(power)}}}$"


def scatter(data: Data) -> Figure:
    """Predicted against measured, and the distribution of their differences."""
    figure, (left, right) = grid_of_panels(2, 2, 1.2 * COLUMN, 1.05 * COLUMN, 0.4)
    rows, allowed = data["random"]["rows"], data["random"]["summary"]["allowed"]
    for name in data["engines"]:
        x, y = (_over(rows, name, key) for key in ("measured", "predicted"))
        known = np.isfinite(x) & np.isfinite(y)
        left.loglog(x[known], y[known], MARKERS[name], color=COLORS[name], ms=4, mfc="none", label=TITLES[name])
        parts = np.sort(np.abs(y[known] / x[known] - 1))
        if len(parts):
            share = (np.arange(len(parts)) + 1) / len(parts)
            right.step(np.maximum(parts, 1e-5), share, where="post", color=COLORS[name], lw=1.3, label=TITLES[name])
    span = left.get_xlim()
    left.plot(span, span, color=palette.GUIDE, lw=0.8, zorder=0)
    right.axvline(allowed, color=palette.WARNING, lw=0.9, ls="--", label="largest difference allowed")
    right.set_xscale("log")
    frame(left, "", "measured limit / (2/ω)", "predicted limit / (2/ω)", legend=False)
    frame(right, "", "|predicted / measured - 1|", "part of the structures", legend=False)
    common_legend(figure, (left, right), 4, 7.5)
    return figure


def rest_rows(part: Mapping[str, Any]) -> Iterator[tuple[Any, ...]]:
    """Yield for each engine the limits [s], their ratio, over 2/ω, rod and string, and what explains a difference."""
    for name, one in part["engines"].items():
        over = None if one["predicted"] is None else one["predicted"] * one["omega"] / 2
        rod, string = (
            f"{one[what]} ({100 * one[f'{what}_share']:.0f} %)" if one[what] else "" for what in ("rod", "string")
        )
        yield TITLES[name], one["predicted"], one["measured"], one["ratio"], over, rod, string, one["cause"]


def describe(data: dict[str, Any]) -> list[str]:
    """Return the study as lines of text."""
    lines = start_lines(data["scene"], data["start"])
    lines += ["", f"at rest: {data['base']['text']}"]
    rows = [("", "predicted", "measured", "ratio", "over 2/ω")]
    for name, predicted, measured, ratio, over, *_, cause in rest_rows(data["base"]):
        ending = f"{_shown(over, '.4g', '', '-')}  {cause}"
        rows.append((name, _shown(predicted), _shown(measured), _shown(ratio, ".4f", "", "-"), ending))
    lines += aligned(rows)
    if "maps" in data:
        known = [(row["axis"], row["values"]["engines"]) for row in data["maps"] if row["values"]]
        points = [(axis, one) for axis, engines in known for one in engines.values()]
        lines += ["", f"maps: {sum(one['agrees'] for _, one in points)} of {len(points)} points agree within 10 %"]
        causes = Counter((axis, one["cause"]) for axis, one in points if not one["agrees"])
        lines += [f"  {axis}: {count} differ: {cause}" for (axis, cause), count in sorted(causes.items())]
    for name, title in DRAWN.items():
        if name in data:
            part = data[name]
            lines += ["", f"{title} (seed {part['seed']}): {agreement(part)}"]
            lines += [f"  {count} differ: {cause}" for cause, count in part["summary"]["causes"].items()]
            if part["failed"]:
                lines.append(f"  {part['failed']} structures could not be computed (see the data)")
    return lines


def _shown(value: float | None, form: str = ".5g", unit: str = " s", none: str = "none") -> str:
    return none if value is None else f"{value:{form}}{unit}"
