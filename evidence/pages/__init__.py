"""Scripts that write pages and references anew: `python -m evidence.pages.NAME`."""

from __future__ import annotations

from collections.abc import Iterable, Sequence


def table_lines(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """The lines of a table in Markdown."""
    return [table_row(heads), f"|{'---|' * len(heads)}", *map(table_row, rows)]


def table_row(cells: Sequence[str]) -> str:
    """The line of one row of it."""
    bar = r"\|"
    return f"| {' | '.join(cell.replace('|', bar) for cell in cells)} |"
