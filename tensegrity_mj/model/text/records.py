"""Records of the ground's acceleration (CSV): a column `time` [s], and `ax`, `ay`, `az` or some of them.

The first line may name the columns; without it they are in this order. A line that begins with # is a comment.
"""

from __future__ import annotations

import csv
import math
import os
from typing import Any

from tensegrity_mj.basics.files import path_of
from tensegrity_mj.errors import FormatError
from tensegrity_mj.model.ground import Ground
from tensegrity_mj.model.text.sources import read

COLUMNS = ("time", "ax", "ay", "az")
FORM = f"its columns must be {', '.join(COLUMNS)}, or time and some of the others"


def load_ground(path: str | os.PathLike[str], **options: Any) -> Ground:
    """The ground of a record, with `baseline` and `scale` as `Ground` has them.

    Raises:
        FormatError: for what is no such table, and times that do not increase.
        SceneError: for a first time below zero, and options that are none.
    """
    source, columns = path_of(path, "a record's CSV file"), list[str]()
    times, accelerations = list[float](), list[list[float]]()
    lines = read(source).splitlines()
    rows = csv.reader("" if line.startswith("#") else line for line in lines)
    try:
        for cells in filter(None, rows):
            named = [cell.strip().lower() for cell in cells]
            if not columns:
                columns = named if "time" in named else list(COLUMNS[: len(cells)])
                if len(set(columns)) < max(2, len(cells)) or not {*columns} <= {*COLUMNS}:
                    raise FormatError(f"{source}, line {rows.line_num}: {', '.join(named)[:60]}; {FORM}")
                if columns == named:
                    continue
            if len(cells) != len(columns):
                raise FormatError(f"{source}, line {rows.line_num}: {len(cells)} cells below {len(columns)} columns")
            row = dict(zip(columns, map(_number, named), strict=True))
            if not all(map(math.isfinite, row.values())):
                raise FormatError(
                    f"{source}, line {rows.line_num}: {', '.join(cells)[:60]}; all must be finite numbers"
                )
            if times and row["time"] <= times[-1]:
                before = f"time is {row['time']:g} s after {times[-1]:g} s"
                raise FormatError(f"{source}, line {rows.line_num}: {before}; times must increase")
            times.append(row["time"])
            accelerations.append([row.get(name, 0.0) for name in COLUMNS[1:]])
    except csv.Error as error:
        raise FormatError(f"{source}, line {rows.line_num}: {error}") from None
    if len(times) < 2:
        raise FormatError(f"{source}: {len(times)} lines of numbers; a record needs two times or more")
    return Ground(times, accelerations, **options)  # type: ignore[arg-type]


def _number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return math.nan
