"""The cases of §7.2.3's study, what it leaves open, and what its result must not depend on."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from tensegrity_mj.library.thesis_towers import PRESTRESS_MEASURES, STIFFNESSES

Tower = Mapping[str, Any]  # arguments of `tower_in_waves`, as in `task`

TRANSIENT, DURATION = 30.0, 40.0  # s; the rest is three periods of the wave
TIMESTEP = 4e-3  # s, see `SENSITIVITY`: half of it moves D by less than 1e-6 of itself
COARSE = ((1e4, 0.10), (2e4, 0.10), (1e4, 0.20), (3e4, 0.20))  # what a percentage of each kind needs


def label_of(stiffness: float, measure: float) -> str:
    """The name of a case of the grid."""
    return f"{stiffness / 1e3:g} kN/m {measure:g} m"


GRID: Mapping[str, Tower] = {
    label_of(k, p): {"stiffness": k, "prestress_measure": p} for k in STIFFNESSES for p in PRESTRESS_MEASURES
}

# What the thesis does not tell: each is tried in the cases of `COARSE`, all else as in the grid.
OPEN: Mapping[str, Tower] = {
    "full, R = 0.498 m, phase 0°, 1 m deep": {},
    **{f"R = {radius:g} m": {"radius": radius} for radius in (0.40, 0.45, 0.55, 0.60, 0.64)},
    **{
        f"{topology}{text}": {"topology": topology, **more}
        for topology in ("reduced_a", "reduced_b")
        for text, more in (("", {}), (", R = 0.6 m", {"radius": 0.60}))
    },
    **{f"phase {degrees}°": {"phase": float(np.radians(degrees))} for degrees in (90, 180, 270)},
    **{f"{depth:g} m deep": {"start_depth": depth} for depth in (0.5, 2.0)},
}

# What the result should hardly depend on; the first is what the others are compared with.
SENSITIVITY: Mapping[str, Tower] = {
    "as in the grid": {},
    "20 segments": {"segments": 20},
    "Ca = 0.5": {"added_mass": 0.5},
    "Ca = 0": {"added_mass": 0.0},
    "Hermite weights": {"weights": "hermite"},
}
HALF = "half the step"


def point(tower: Tower, *, engine: str = "dae", timestep: float = TIMESTEP) -> dict[str, Any]:
    """A point of `task.in_waves`."""
    chosen = {"duration": DURATION, **tower}
    return {"tower": chosen, "engine": engine, "timestep": timestep, "transient": TRANSIENT}
