"""One HTML page about the study: the table by kind, by engine, and every run that is not right with its cause."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

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


def write_extremes_page(path: str | os.PathLike[str], data: dict[str, Any]) -> Path:
    """Write the page (.html) of the data of a study; returns its path."""
    setup = data["setup"]
    title = f"{setup['runs']} extreme runs, seed {setup['seed']}"
    sections = [
        Section(
            "What came of them",
            data["summary"],
            [_counts("By kind", data["table"]), _counts("By engine", data["by_engine"])],
        )
    ]
    for verdict, meaning in MEANINGS.items():
        found = [one for one in data["results"] if one["verdict"] == verdict.value]
        sections.append(Section(f"{verdict.value}: {len(found)}", [meaning], [_runs(found)] if found else []))
    how = "MuJoCo stepped by hand with its autoreset on (the test of the test)." if setup["autoreset"] else ""
    return write_sections(path, title, f"Seeded random runs at the extremes, each judged. {how}", sections)


def _counts(title: str, rows: Sequence[dict[str, Any]]) -> Table:
    heads = list(rows[0])
    return Table(title, ["", *heads[1:]], [[row[head] for head in heads] for row in rows])


def _runs(found: Sequence[dict[str, Any]]) -> Table:
    heads = ["run", "kind", "engine", "step [s]", "tolerance", "drawn", "own bound [m]", "error [m]", "cause"]
    rows = [
        [
            one["number"],
            Kind[one["kind"]].value,
            one["engine"],
            one.get("step"),
            one.get("tolerance"),
            one["facts"],
            one.get("bound"),
            one.get("error"),
            one["cause"],
        ]
        for one in found
    ]
    return Table("Each of them", heads, rows, folded=len(found) > 20)
