"""Trajectories and statics computed by other programs; tests/data/truth/README.md says by which, and what they hold."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

FOLDER = Path(__file__).resolve().parents[1] / "data" / "truth"


def load(name: str) -> dict[str, NDArray]:
    """The arrays of `name`.npz."""
    with np.load(FOLDER / f"{name}.npz") as file:
        return dict(file)
