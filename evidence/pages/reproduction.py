"""Write the tables of evidence/docs/reproduction.md: the ledger of what the thesis states, computed anew.

    .venv/bin/python -m evidence.pages.reproduction [--out FOLDER] [--workers N]

Runs that are in the folder, of `tensegrity-mj reproduce` too, are not computed again. What the page says above `MARK`
stays. The last column is that of tensegrity_mj/thesis/tables/sensitivity.json (evidence/pages/sensitivity.py).
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from evidence import pages
from evidence.thesis.experiments import TITLES, EngineName
from evidence.thesis.ledger import Row
from evidence.thesis.page import CLASSES, class_rows, summary, value_texts
from evidence.thesis.reproduction import reproduce
from evidence.thesis.tables import FORMULA, NOT_STUDIED, NOTHING, noticed
from tensegrity_mj.studies.workers import Workers

DOC = Path(__file__).resolve().parents[1] / "docs" / "reproduction.md"
MARK = "<!-- below: made by evidence/pages/reproduction.py -->\n"


def markdown(rows: Sequence[Row]) -> str:
    """The text below the mark."""
    lines = [
        "",
        f"**{summary(rows)}.**",
        "",
        *pages.table_lines(CLASSES, class_rows(rows)),
        "",
        _notices(rows),
        "",
    ]
    for chapter in sorted({row.statement.chapter for row in rows}):
        own = [row for row in rows if row.statement.chapter == chapter]
        title = f"Chapter {chapter}" if chapter.isdigit() else f"Appendix {chapter}"
        columns = list(dict.fromkeys(engine for row in own for engine in row.cells))
        heads = ["row", "class", "where", "what", "thesis", *(TITLES[one] for one in columns), "verdict", "notices"]
        lines += [f"## {title}", "", *pages.table_lines(heads, [_cells(row, columns) for row in own])]
        lines += _listed("Why rows differ, or cannot be judged:", {row.statement.id: row.cause for row in own})
        chosen = "Choices made so that rows are reproduced, and origins of values that the thesis lacks:"
        lines += [*_listed(chosen, {row.statement.id: row.statement.origin for row in own}), ""]
    return "\n".join(lines)


def _listed(head: str, texts_of: Mapping[str, str]) -> list[str]:
    """Each text with the ids of all rows that have it, below a head; nothing where no row has one."""
    lines = []
    for text in dict.fromkeys(filter(None, texts_of.values())):
        lines.append(f"- {', '.join(f'`{name}`' for name, own in texts_of.items() if own == text)}: {text}.")
    return ["", head, "", *lines] if lines else []


def _notices(rows: Sequence[Row]) -> str:
    """Say how many numbers and statements notice an error."""
    found = [noticed(row.statement) for row in rows if row.statement.kind.is_evidence and not row.statement.unjudged]
    studied = [text for text in found if text not in (NOT_STUDIED, FORMULA)]
    left = found.count(NOT_STUDIED)
    return (
        f"Of the {len(found)} numbers and statements that are judged, {len(studied)} were studied for errors: "
        f"{studied.count(NOTHING)} notice none of up to 10 %. {found.count(FORMULA)} are formulas, of no run"
        + (f"; {left} were not studied." if left else ".")
    )


def markdown_row(row: Row, engines: Sequence[EngineName] | None = None) -> str:
    """Return one line of the table, with a column for each engine; by default for those that the row has."""
    return pages.table_row(_cells(row, list(row.cells) if engines is None else engines))


def _cells(row: Row, engines: Sequence[EngineName]) -> list[str]:
    statement = row.statement
    where = f"{statement.place}, p. {statement.page}"
    head = [f"`{statement.id}`", statement.kind.value, where, statement.says, statement.stated]
    return [*head, *value_texts(row, engines), row.verdict.value, noticed(statement)]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", metavar="FOLDER", default="reproduction", help="of the runs (reproduction)")
    parser.add_argument("--workers", type=int, metavar="N", help="runs at a time (all cores)")
    given = parser.parse_args()
    made = reproduce(out=given.out, workers=Workers(given.workers), progress=True, draw=False)
    head, mark, _ = DOC.read_text(encoding="utf-8").partition(MARK)
    DOC.write_text(head + mark + markdown(made.rows), encoding="utf-8")
    print(f"{summary(made.rows)}. Written: {DOC}")
    sys.exit(bool(made.unexplained))
