"""All figures and statements, and which of them a user means by "5.4" or "5".

Figures are rows of `tables/figures.toml`: `number`, `page` and `title`, the names of the `runs` that are drawn, `draw`
(the function, with its module of `MODULES`) and its `options`. A function that takes `names` has those of the runs.
Most are panels of curves, see `panels`.
"""

from __future__ import annotations

import inspect
import tomllib
from collections.abc import Mapping, Sequence
from functools import partial
from types import ModuleType
from typing import Any

from evidence.thesis import drawing, panels
from evidence.thesis.appendix_c import figures_c
from evidence.thesis.chapter3 import figures3
from evidence.thesis.chapter7 import figures7
from evidence.thesis.drawing import ThesisFigure
from evidence.thesis.statement import Statement
from evidence.thesis.tables import FOLDER, all_statements
from tensegrity_mj.errors import OptionError

MODULES: Mapping[str, ModuleType] = {
    module.__name__.rpartition(".")[2]: module for module in (drawing, panels, figures3, figures7, figures_c)
}


def _figure(row: Mapping[str, Any]) -> ThesisFigure:
    module, _, name = row["draw"].partition(".")
    function, options = getattr(MODULES[module], name), dict(row.get("options", {}))
    if "panels" in options:
        options["panels"] = [[_LIKE[one.get("like", "none")] | one for one in line] for line in options["panels"]]
    if "names" in inspect.signature(function).parameters:
        options["names"] = row["runs"]
    return ThesisFigure(row["number"], row["page"], row["title"], tuple(row["runs"]), partial(function, **options))


_TABLE = tomllib.loads((FOLDER / "figures.toml").read_text(encoding="utf-8"))
_LIKE = {"none": {}, **_TABLE["panels"]}  # what panels have that are like another
FIGURES: tuple[ThesisFigure, ...] = tuple(map(_figure, _TABLE["figures"]))
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
