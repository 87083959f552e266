"""One HTML page about the study: what came out, by kind and by engine, and every run that is not right."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tensegrity_mj.pictures.findings import Finding, Mark, opening_of
from tensegrity_mj.pictures.page import Section, Table, write_sections
from tensegrity_mj.studies.extremes.experiment import Kind
from tensegrity_mj.studies.extremes.verdicts import Verdict

MEANINGS = {
    Verdict.UNDETECTED: "Completed without a warning and wrong, a traceback, NaN, or a message that does not help.",
    Verdict.UNJUDGED: "Completed without a warning; no reference is accurate enough to judge by.",
    Verdict.WARNED: "Completed, and the run says that it is not to be trusted: by a warning, or because its error "
    "estimate does not settle or is larger than 5 % of the way that the nodes went.",
    Verdict.STOPPED: "Stopped on the way, with time, cause and remedy.",
    Verdict.REFUSED: "Refused before the first step, with cause and remedy.",
}
COLUMNS = {
    "number": "run",
    "kind": "kind",
    "engine": "engine",
    "step": "step [s]",
    "tolerance": "tolerance",
    "facts": "drawn",
    "bound": "own bound [m]",
    "error": "error [m]",
    "cause": "cause",
}


def write_extremes_page(path: str | os.PathLike[str], data: dict[str, Any]) -> Path:
    """Write the page (.html) of the data of a study; returns its path."""
    setup, total = data["setup"], data["table"][-1]
    wrong = total["undetected"]
    headline = (
        f"{wrong or 'None'} of {total['runs']} extreme runs {'was' if wrong < 2 else 'were'} wrong without a warning; "
        f"{total['right']} were right."
    )
    marks = (
        Mark.BAD if wrong else Mark.GOOD if data["passed"] else Mark.LIMITED,
        Mark.LIMITED if total["refused without need"] else Mark.GOOD,
        Mark.LIMITED if total["hidden"] else Mark.GOOD,
    )
    opening = opening_of(headline, list(map(Finding, marks, data["summary"])))
    tables = [_counts("By kind", data["table"]), _counts("By engine", data["by_engine"])]
    sections = [Section("What came of them", (), tables)]
    for verdict, meaning in MEANINGS.items():
        found = [one for one in data["results"] if one["verdict"] == verdict.value]
        sections.append(Section(f"{verdict.value}: {len(found)}", [meaning], [_runs(found)] if found else []))
    how = " MuJoCo stepped by hand with its autoreset on (the test of the test)." if setup["autoreset"] else ""
    introduction = f"Runs at the extremes, drawn by chance with seed {setup['seed']}, each judged.{how}"
    return write_sections(path, f"{setup['runs']} extreme runs", introduction, sections, opening=opening)


def _counts(title: str, rows: Sequence[dict[str, Any]]) -> Table:
    first, *others = rows[0]
    return Table.of(title, {first: "", **{head: head for head in others}}, rows, folded=len(rows) > 8)


def _runs(found: Sequence[dict[str, Any]]) -> Table:
    runs = [{**one, "kind": Kind[one["kind"]].value} for one in found]
    return Table.of("Each of them", COLUMNS, runs, folded=len(found) > 20)
