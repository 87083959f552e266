"""The ledger as an HTML page (self-contained), and as JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from evidence.thesis.drawing import ThesisFigure
from evidence.thesis.experiments import TITLES, EngineName
from evidence.thesis.ledger import Row, Verdict, value_text
from evidence.thesis.statement import Class
from evidence.thesis.tables import FOLDER, noticed
from tensegrity_mj.basics.jsontext import plain, plain_values
from tensegrity_mj.pictures.page import data_url, page_of, table_of

THESIS = "A. S. Wroldsen, Modelling and Control of Tensegrity Structures, NTNU 2007:190"
CLASSES = ("class", "rows", "reproduced", "differ", "cannot be judged")  # heads of `class_rows`
# Classes of the page's rows.
KINDS = {
    Verdict.UNJUDGED: "open",
    Verdict.REPRODUCED: "good",
    Verdict.DIFFERS: "known",
    Verdict.UNEXPLAINED: "bad",
}


def counts(rows: Sequence[Row]) -> dict[str, int]:
    """Count the rows of each verdict."""
    return {verdict.value: sum(row.verdict is verdict for row in rows) for verdict in Verdict}


def counts_by_class(rows: Sequence[Row]) -> dict[str, dict[str, int]]:
    """Count the verdicts of each class; of numbers also how many are within 10 % of what is stated."""
    found = {}
    for kind in Class:
        own = [row for row in rows if row.statement.kind is kind]
        found[kind.value] = {"rows": len(own), **counts(own)}
    numbers = [row for row in rows if row.statement.kind is Class.NUMBER]
    found[Class.NUMBER.value]["within 10 %"] = sum(row.is_within_ten_percent for row in numbers)
    return found


def summary(rows: Sequence[Row]) -> str:
    """The headline: numbers and statements alone, and what differs otherwise than recorded in any class."""
    parts = []
    for kind, what in ((Class.NUMBER, "numbers that the thesis states"), (Class.STATEMENT, "of its statements")):
        own = [row for row in rows if row.statement.kind is kind]
        found = counts(own)
        differ = [row for row in own if row.verdict is Verdict.DIFFERS]
        unknown = sum(row.statement.known is not None and not row.statement.known.is_explained for row in differ)
        text = f"{len(own)} {what}: {found[Verdict.REPRODUCED.value]} are reproduced, {len(differ)} differ"
        text += f" ({unknown} without a known cause), {found[Verdict.UNJUDGED.value]} cannot be judged"
        if kind is Class.NUMBER:
            text += f"; {sum(row.is_within_ten_percent for row in own)} are within 10 % of what is stated"
        parts.append(text)
    text = ". ".join(parts)
    wrong = sum(row.verdict is Verdict.UNEXPLAINED for row in rows)
    return f"{text}. {wrong} of all {len(rows)} rows differ, and not as recorded" if wrong else text


def row_data(row: Row) -> dict[str, Any]:
    """A row as plain values, for JSON."""
    statement = row.statement
    return {
        "id": statement.id,
        "class": statement.kind.value,
        "figure": statement.figure or None,
        **plain_values(statement, "place", "page"),
        "line": statement.line or None,
        **plain_values(statement, "says", "stated", "value", "unit"),
        "accepted": {**plain(statement.accepted), "why": statement.tolerance},
        **plain_values(statement, "measure", "arguments"),
        "runs": list(statement.needs),
        "ours": plain(row.cells),
        **plain_values(row, "verdict", "cause"),
        "origin": statement.origin,
        "notices": noticed(statement),
    }


def class_rows(rows: Sequence[Row]) -> list[list[str]]:
    """Rows by class and verdict, under the heads `CLASSES`."""
    lines = []
    for name, found in counts_by_class(rows).items():
        differ = found[Verdict.DIFFERS.value] + found[Verdict.UNEXPLAINED.value]
        values = (found["rows"], found[Verdict.REPRODUCED.value], differ, found[Verdict.UNJUDGED.value])
        lines.append([name, *map(str, values)])
    return lines


def value_texts(row: Row, engines: Sequence[EngineName]) -> list[str]:
    """Our value and its unit in each engine; a dash where there is none."""
    statement = row.statement
    values = [value_text(statement, row.cells[one].value) if one in row.cells else "–" for one in engines]
    return [with_unit(text, statement.unit) for text in values]


def with_unit(text: str, unit: str) -> str:
    """A value and its unit, or a dash."""
    return text if text == "–" or not unit else f"{text}{'' if unit == '°' else ' '}{unit}"


# -------------------------------------------------------------------------------------------------------------- HTML


def html(
    rows: Sequence[Row],
    engines: Sequence[EngineName],
    figures: Sequence[tuple[ThesisFigure, bytes]],
    runs: Sequence[Mapping[str, Any]],
    note: str = "",
) -> str:
    """The page: the ledger above, the figures below, then what was run.

    Args:
        figures: with the content of a PNG file each.
        runs: a line for each run: experiment, about, engine, status, wall time, difference from the first engine.
    """
    parts = [f"<h1>The thesis, reproduced</h1><p>{escape(THESIS)}</p>"]
    if note:
        parts.append(f'<p class="note">{escape(note)}</p>')
    parts += [f"<p>{escape(summary(rows))}.</p>", table_of(CLASSES, class_rows(rows)), _ledger(rows, engines)]
    if figures:
        parts.append("<h2>Figures</h2>")
    for figure, content in figures:
        caption = f"Figure {figure.number} (page {figure.page} of the thesis): {figure.title}"
        parts.append(
            f'<figure id="f{figure.number}"><img alt="{escape(caption)}" src="{data_url("image/png", content)}">'
            f"<figcaption>{escape(caption)}</figcaption></figure>"
        )
    parts += ["<h2>Runs</h2>", table_of(list(runs[0]) if runs else [], [list(line.values()) for line in runs])]
    return page_of("The thesis, reproduced", parts, (FOLDER / "page.css").read_text(encoding="utf-8"))


def _ledger(rows: Sequence[Row], engines: Sequence[EngineName]) -> str:
    heads = ["where", "class", "what", "thesis", *(TITLES[engine] for engine in engines), "verdict"]
    lines = ["<thead><tr>", *(f"<th>{escape(head)}</th>" for head in heads), "</tr></thead>"]
    for row in rows:
        statement = row.statement
        kind = KINDS[row.verdict]
        place = escape(f"{statement.place}, p. {statement.page}")
        if statement.figure:
            place = f'<a href="#f{statement.figure}">{place}</a>'
        values = "".join(f'<td class="n">{escape(text)}</td>' for text in value_texts(row, engines))
        cause = f'<div class="cause">{escape(row.cause)}</div>' if row.cause else ""
        why = f"accepted: {statement.tolerance}"
        lines.append(
            f'<tr class="{kind}" id="{escape(statement.id)}"><td>{place}</td><td>{escape(statement.kind.value)}</td>'
            f"<td>{escape(statement.says)}</td>"
            f'<td title="{escape(why)}">{escape(statement.stated)}</td>{values}'
            f"<td><b>{escape(row.verdict.value)}</b>{cause}</td></tr>"
        )
    return f'<div class="table"><table>{"".join(lines)}</table></div>'
