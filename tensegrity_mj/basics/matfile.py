"""MATLAB's .mat files (version 5, which MATLAB, Octave and SciPy read). The same data make the same bytes."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

# SciPy writes the date into the 116 bytes of free text that a file begins with.
HEADER = b"MATLAB 5.0 MAT-file, written by tensegrity_mj".ljust(116)
MOST_LETTERS = 63  # of a name
# Keywords of MATLAB, which are no names, as its function iskeyword lists them.
KEYWORDS = frozenset(
    "break case catch classdef continue else elseif end for function global if otherwise parfor persistent return spmd "
    "switch try while".split()
)


def save_mat(path: Path, data: Mapping[str, Any]) -> None:
    """Write arrays, texts, tuples of texts (cell arrays) and dictionaries of these (structs) by their names.

    One-dimensional arrays become columns. Names must be legal ones, see `legal_names`.

    Raises:
        OSError: where the file cannot be written.
    """
    from scipy.io import savemat  # slow to load

    savemat(path, {name: _matlab(value) for name, value in data.items()}, long_field_names=True, oned_as="column")
    with path.open("r+b") as file:
        file.write(HEADER)


def _matlab(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {name: _matlab(item) for name, item in value.items()}
    return np.array(value, dtype=object)[:, None] if isinstance(value, tuple) else value


def legal_names(names: Iterable[str]) -> tuple[str, ...]:
    """Make unique names that MATLAB takes for variables and fields: letters, digits, underscores, a letter first.

    A name that is legal stays. In others "_" stands for what is not allowed, with an x in front where no letter or a
    keyword begins them; where two become the same, numbers follow.
    """
    given = tuple(names)
    taken = {name for name in given if _is_legal(name)}
    made = []
    for name in given:
        text = name
        if not _is_legal(name):
            text = re.sub(r"[^A-Za-z0-9_]", "_", name)[: MOST_LETTERS - 1]
            text = stem = text if _is_legal(text) else f"x{text}"
            number = 1
            while text in taken:
                text = f"{stem[: MOST_LETTERS - 8]}_{number}"
                number += 1
            taken.add(text)
        made.append(text)
    return tuple(made)


def _is_legal(name: str) -> bool:
    return bool(re.fullmatch(rf"[A-Za-z][A-Za-z0-9_]{{,{MOST_LETTERS - 1}}}", name)) and name not in KEYWORDS
