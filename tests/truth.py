"""Trajectories and statics computed by other codes, where they are beside the checkout (../shared/truth)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

FOLDER = Path(__file__).resolve().parents[2] / "shared" / "truth"


def load(name: str) -> dict[str, NDArray]:
    """The arrays of `name`.npz; skips the calling test where the data is absent."""
    path = FOLDER / f"{name}.npz"
    if not path.is_file():
        pytest.skip(f"reference data {name}.npz is not beside this checkout (../shared/truth)")
    with np.load(path) as file:
        return dict(file)
