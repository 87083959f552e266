"""The report as one self-contained HTML page, made of its data alone."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

from tensegrity_mj.basics.files import table_beside
from tensegrity_mj.basics.texts import shortened
from tensegrity_mj.pictures.findings import Finding, Judgement, Mark
from tensegrity_mj.pictures.page import Picture, Section, Table
from tensegrity_mj.studies.plain import value_at
from tensegrity_mj.studies.report import Page
from tensegrity_mj.studies.validation import figures
from tensegrity_mj.studies.validation.sections import SECTIONS
from tensegrity_mj.studies.validation.sentences import law_name, title, verdict

Data = Mapping[str, Any]

LONG = 8  # rows of a table, beyond which it is folded
MOST_NODES = 12  # that a cell holds
MOST_LETTERS = 30  # of a label that stays in one line
TABLE = table_beside(__file__)
COLUMNS, NOTES = TABLE["columns"], TABLE["notes"]


def page_of(data: Data) -> Page:
    """The page of a report's data."""
    setup, law = data["setup"], data["law"]
    name = law_name(law)
    scene = data["scene"]
    introduction = (
        f"Law {name} on scene {scene['name']} ({scene['source'] or 'no source given'}); {setup['runs']} runs of "
        f"{setup['duration']:g} s in {', '.join(title(engine) for engine in setup['engines'])}; RK4 at "
        f"{1e3 * setup['timestep']:g} ms where the step is fixed; control period {1e3 * setup['control_period']:g} ms "
        f"where the law must be sampled; seed {setup['seed']}. A run has converged if it ends within "
        f"{data['tolerance']:.2g} m of its target, or of where the nominal run rests if there is none."
    )
    parts = [*_sections(data), _details(data)]
    return Page(f"Validation of {name} on {scene['name']}", introduction, judgement_of(data), parts)


def judgement_of(data: Data) -> Judgement:
    """The verdict, and a finding a section, with its sentences."""
    engine, nominal = next(iter(data["nominal"]["engines"].items()))
    texts: dict[str, list[str]] = {}
    for section, sentence in zip(data["summary_sections"], data["summary"], strict=True):
        texts.setdefault(section, []).append(sentence)
    words = {section: data[section][engine]["word"] for section in texts if section != "nominal"}
    words["nominal"] = nominal["judgement"]["word"]
    found = [Finding(Mark(words[section]), " ".join(sentences)) for section, sentences in texts.items()]
    return Judgement(verdict(data), found)


def _sections(data: Data) -> Iterator[Section]:
    yield _nominal(data)
    for section, heading in SECTIONS.items():
        if section == "nominal" or section not in data:
            continue
        parts: list[Picture | Table] = list(figures.of_section(section, data))
        text = NOTES.get(section, "")
        for number, (engine, part) in enumerate(data[section].items()):
            text = text.replace("{reference}", _reference(part))
            parts += [
                replace(table, folded=number > 0 or len(table.rows) > LONG) for table in _engine(section, engine, part)
            ]
        if section == "starts" and data.get("starts_that_differ"):
            rows = [[one["label"], one["outcomes"]] for one in data["starts_that_differ"]]
            parts.append(Table("Starts that come out differently in two engines", ("start", "outcomes"), rows))
        yield Section(heading[0].upper() + heading[1:], [text] if text else [], parts)


def _reference(part: Data) -> str:
    reference = part.get("reference", "")
    return "the law at every stage" if reference == "continuous" else str(reference)


def _engine(section: str, engine: str, part: Data) -> Iterator[Table]:
    if section == "gains" and part["trends"]:
        rows = [[one["statement"], one["shows"], _values(one)] for one in part["trends"]]
        yield Table(f"What §5.6 says, {title(engine)}", ("statement", "shows", "factor on the gain: value"), rows)
    if section == "starts":
        head = "law" if "law" in part["fractions"][0] else "amplitude"
        rows = [
            [one[head], one["starts"], _percent(one["converged"]), _percent(one["kept"]), one["outcomes"]]
            for one in part["fractions"]
        ]
        yield Table(title(engine), (head, "starts", "converge", "with V as promised", "outcomes"), rows)
        return
    columns = TABLE["shown"].get(section, TABLE["usual"])
    rows = [
        [*map(_whole, (one["label"], one["outcome"])), *map(one.get, columns[1:]), shortened(one["message"] or "", 160)]
        for one in part["rows"]
    ]
    if not any(row[-1] for row in rows):
        rows = [row[:-1] for row in rows]
        yield Table(title(engine), ("", *(COLUMNS[column] for column in columns)), rows)
    else:
        yield Table(title(engine), ("", *(COLUMNS[column] for column in columns), "why"), rows)


def _percent(part: float | None) -> str:
    return "–" if part is None else f"{part:.0%}"


def _values(one: Data) -> list[str]:
    texts = ["not settled" if value is None else f"{value:.4g}" for value in one["values"]]
    return [f"{factor:g}: {text}" for factor, text in zip(one["factors"], texts, strict=True)]


def _whole(text: str) -> str:
    """A short text that is not broken into lines."""
    return text.replace(" ", "\u00a0") if len(text) <= MOST_LETTERS else text


def _nominal(data: Data) -> Section:
    engines = data["nominal"]["engines"]
    runs = [one for one in engines.values() if "peaks" in one]
    heads = ["", *(title(engine) for engine, one in engines.items() if "peaks" in one)]
    rows = [[label, *(_value(one, *keys) for one in runs)] for label, keys in TABLE["nominal"].items()]
    parts: list[Picture | Table] = list(figures.of_section("nominal", data))
    if runs:
        parts.append(Table("All numbers", heads, rows, folded=True))
    failed = [[title(engine), one["outcome"], one["message"]] for engine, one in engines.items() if one not in runs]
    if failed:
        parts.append(Table("Without a result", ("engine", "outcome", "why"), failed))
    if data["nominal"]["differences"]:
        rows = [
            [" and ".join(title(engine) for engine in one["engines"]), one["node_error"]]
            for one in data["nominal"]["differences"]
        ]
        parts.append(Table("Agreement", ("engines", "largest node difference [m]"), rows))
    if runs:
        parts += list(_strings(runs[0], next(engine for engine, one in engines.items() if one is runs[0])))
    return Section("As it is meant to be", (), parts)


def _value(one: Data, *keys: str) -> Any:
    value = value_at(one, keys)
    if isinstance(value, Mapping) and {"value", "time"} <= set(value):
        member = f"{value['of']}, " if "of" in value else ""
        return f"{value['value']:.4g} ({member}{value['time']:.4g} s)"
    if isinstance(value, Mapping) and keys[-1] == "nodes":
        if len(value) > MOST_NODES:
            return "see validation.json"
        return {name: ", ".join(f"{x + 0.0:.4f}" for x in place) for name, place in value.items()}
    return value


def _strings(one: Data, engine: str) -> Iterator[Table]:
    strings = one["winch"]["strings"]
    if not strings:
        return
    rates = one["switching"]["strings"]
    rows = [
        [name, work["done"], work["recovered"], work["peak"], work["mean"], rates[name]]
        for name, work in strings.items()
    ]
    heads = ("string", "work done [J]", "got back [J]", "peak power [W]", "mean |power| [W]", "switches [1/s]")
    yield Table(f"Each winch, {title(engine)}", heads, rows, folded=len(rows) > LONG)


def _details(data: Data) -> Section:
    rows: Sequence[Sequence[object]] = [
        ["law", data["law"]["from"]],
        ["what it says of itself", data["law"]["description"]],
        ["setup", data["setup"]],
        ["versions", data["versions"]],
    ]
    return Section("How it was run", (), [Table("All options", ("", ""), rows, folded=True)])
