"""The page of the study."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

from tensegrity_mj.basics.units import quantity
from tensegrity_mj.pictures.findings import Finding, Mark, mark_of
from tensegrity_mj.pictures.page import Picture, Section, Table
from tensegrity_mj.studies.engine_names import TITLES
from tensegrity_mj.studies.report import Page
from tensegrity_mj.studies.stability import figures
from tensegrity_mj.studies.stability.cases import AXES
from tensegrity_mj.studies.stability.report import rest_rows, start_rows
from tensegrity_mj.studies.stability.study import DRAWN, agreement

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
HEADS = ("", "predicted [s]", "measured [s]", "predicted / measured", "over 2/ω", "rod or mass", "string", "remark")


def page_of(data: Data) -> Page:
    """The page of a study's data."""
    # Pictures come before tables.
    ordered = sorted(sections(data), key=lambda section: not any(isinstance(part, Picture) for part in section.parts))
    title = f"The largest stable step: {data['scene']}"
    return Page(title, INTRODUCTION, _verdict(data), _findings(data), ordered)


def _verdict(data: Data) -> str:
    """How well predictions are met, and the step that is safe at the start."""
    ratios = [one["ratio"] for one in data["base"]["engines"].values() if one["ratio"]]
    off = max((abs(ratio - 1.0) for ratio in ratios), default=math.nan)
    met = f"predicted largest steps of {data['scene']} are within {off:.1%} of those measured"
    steps = [one["predicted"] for one in data["base"]["engines"].values() if one["predicted"]]
    span = f": {quantity(min(steps), 's')} to {quantity(max(steps), 's')} by engine" if steps else ""
    if not ratios and any(one["measured"] is not None for one in data["base"]["engines"].values()):
        return f"The step of {data['scene']} has limits that were measured and not predicted."
    return f"At rest, {met}{span}." if ratios else f"Nothing limits the step of {data['scene']} as far as was tried."


def _findings(data: Data) -> Iterator[Finding]:
    """An engine each, then the random structures."""
    for name, one in data["base"]["engines"].items():
        tried = f"none up to {quantity(one['largest'], 's')}"
        predicted = "none" if one["predicted"] is None else quantity(one["predicted"], "s")
        measured = tried if one["measured"] is None else quantity(one["measured"], "s")
        text = f"{TITLES[name]}: predicted {predicted}, measured {measured}"
        cause = f" ({one['cause']})" if one["cause"] else ""
        yield Finding(Mark.GOOD if one["agrees"] else Mark.LIMITED if cause else Mark.BAD, f"{text}{cause}.")
    for name, words in DRAWN.items():
        if data.get(name):
            total = data[name]["summary"]
            agree, count = total["structures_agree"], total["structures"]
            text = f"{agree} of {count} {words} agree within {total['allowed']:.0%} in every engine."
            yield Finding(mark_of(agree, count), text)


INTRODUCTION = (
    "Predicted from the linear model of each structure, measured by runs with tiny perturbations that either stay "
    "small or grow. ω is the stiffest motion's angular frequency without dampers; 2/ω is semi-implicit Euler's limit. "
    "A dash is no limit up to the largest step that was tried."
)


def sections(data: Data) -> Iterator[Section]:
    """The sections that the data has."""
    shown = {name: Picture(*drawn) for name, drawn in figures.pictures(data).items()}
    heads = ("", "at the start [s]", "worst on the way [s]", "at t [s]", "rod or mass", "string", "remarks")
    moving, resting = Table("", heads, list(start_rows(data["start"]))), Table("", HEADS, list(rest_rows(data["base"])))
    yield Section("As it starts and moves", (data["start"]["text"],), [moving])
    yield Section("At rest", (f"The base of the maps: {data['base']['text']}.",), [resting])
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
            yield _agreement(title.capitalize(), data[name], [shown[name]] if name in shown else [])


def _agreement(title: str, part: Data, pictures: list[Any]) -> Section:
    total = part["summary"]
    engines = [
        [TITLES[name], one["agree"], one["count"], one["largest_difference"]] for name, one in total["engines"].items()
    ]
    parts = [*pictures, Table("", ("", "agree", "of", "largest difference"), engines)]
    if total["causes"]:
        parts.append(Table("Why the others differ", ("cause", "comparisons"), list(total["causes"].items())))
    return Section(title, (f"Seed {part['seed']}: {agreement(part)}.",), parts)
