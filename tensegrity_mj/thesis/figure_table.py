"""The figures, as `tables/figures.toml` has them: a row each.

A row has `number`, `page` and `title`, the names of the `runs` that are drawn, `draw` (the function, with its module of
`MODULES`) and its `options`. A function that takes `names` is given those of the runs.
"""

from __future__ import annotations

import inspect
import tomllib
from collections.abc import Mapping
from functools import partial
from types import ModuleType
from typing import Any

from tensegrity_mj.thesis import drawing
from tensegrity_mj.thesis.appendix_c import figures_c, figures_c2
from tensegrity_mj.thesis.chapter3 import figures3
from tensegrity_mj.thesis.chapter4 import figures4
from tensegrity_mj.thesis.chapter7 import figures7, figures7_waves
from tensegrity_mj.thesis.drawing import ThesisFigure
from tensegrity_mj.thesis.tables import FOLDER

MODULES: Mapping[str, ModuleType] = {
    module.__name__.rpartition(".")[2]: module
    for module in (drawing, figures3, figures4, figures7, figures7_waves, figures_c, figures_c2)
}


def figures() -> tuple[ThesisFigure, ...]:
    """The rows, in order."""
    rows = tomllib.loads((FOLDER / "figures.toml").read_text(encoding="utf-8"))["figures"]
    return tuple(map(_figure, rows))


def _figure(row: Mapping[str, Any]) -> ThesisFigure:
    module, _, name = row["draw"].partition(".")
    function, options = getattr(MODULES[module], name), dict(row.get("options", {}))
    if "names" in inspect.signature(function).parameters:
        options["names"] = row["runs"]
    return ThesisFigure(row["number"], row["page"], row["title"], tuple(row["runs"]), partial(function, **options))
