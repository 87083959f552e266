"""All figures and statements, and which of them a user means by "5.4" or "5"."""

from __future__ import annotations

from collections.abc import Sequence

from tensegrity_mj.errors import OptionError
from tensegrity_mj.thesis import figure_table
from tensegrity_mj.thesis.drawing import ThesisFigure
from tensegrity_mj.thesis.statement import Statement
from tensegrity_mj.thesis.tables import all_statements

FIGURES: tuple[ThesisFigure, ...] = figure_table.figures()
STATEMENTS: tuple[Statement, ...] = all_statements()


def selected(chosen: Sequence[str]) -> tuple[list[ThesisFigure], list[Statement]]:
    """The figures and the statements that are meant; all of them where nothing is chosen.

    Args:
        chosen: numbers of figures ("5.4") and of chapters ("5", "C"). A chapter's statements that belong to no figure
            come with the chapter only.

    Raises:
        OptionError: for a number that is neither.
    """
    numbers = [figure.number for figure in FIGURES]
    chapters = sorted({number.partition(".")[0] for number in numbers})
    for text in chosen:
        if text not in numbers and text not in chapters:
            raise OptionError(
                f"figure {text!r}: it is not among the figures {', '.join(numbers)} and chapters {', '.join(chapters)}"
            )
    if not chosen:
        return list(FIGURES), list(STATEMENTS)
    figures = [one for one in FIGURES if one.number in chosen or one.number.partition(".")[0] in chosen]
    statements = [one for one in STATEMENTS if one.figure in chosen or one.chapter in chosen]
    return figures, statements
