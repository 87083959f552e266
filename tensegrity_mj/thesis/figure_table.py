"""The figures of chapters 5 and 6, as `tables/figures.toml` has them: a row each, drawn by a function of `drawing`.

A row has `number`, `page` and `title`, the names of the `runs` that are drawn, `draw` (of `DRAWN`) and its `options`.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING

from tensegrity_mj.thesis import drawing
from tensegrity_mj.thesis.drawing import ThesisFigure
from tensegrity_mj.thesis.tables import FOLDER

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DRAWN: Mapping[str, Callable[..., Figure]] = {
    "landscape": drawing.landscape,
    "parts": drawing.parts_of_lyapunov,
    "paths": drawing.space_paths,
    "prism": drawing.prism_panels,
    "rows": drawing.rows_of_panels,
}


def figures() -> tuple[ThesisFigure, ...]:
    """The rows, in order."""
    rows = tomllib.loads((FOLDER / "figures.toml").read_text(encoding="utf-8"))["figures"]
    return tuple(
        ThesisFigure(
            row["number"],
            row["page"],
            row["title"],
            tuple(row["runs"]),
            partial(DRAWN[row["draw"]], names=row["runs"], **row.get("options", {})),
        )
        for row in rows
    )
