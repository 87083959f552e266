"""The cases of §7.2.3's study."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from tensegrity_mj.library.thesis_towers import PRESTRESS_MEASURES, STIFFNESSES

Tower = Mapping[str, Any]  # arguments of `tower_in_waves`, as in `task`

TRANSIENT, DURATION = 30.0, 40.0  # s; the rest is three periods of the wave
TIMESTEP = 4e-3  # s: half of it moves D by less than 1e-6 of itself


def label_of(stiffness: float, measure: float) -> str:
    """The name of a case of the grid."""
    return f"{stiffness / 1e3:g} kN/m {measure:g} m"


GRID: Mapping[str, Tower] = {
    label_of(k, p): {"stiffness": k, "prestress_measure": p} for k in STIFFNESSES for p in PRESTRESS_MEASURES
}


def point(tower: Tower) -> dict[str, Any]:
    """A point of the study, see `task`."""
    return {"tower": {"duration": DURATION, **tower}, "timestep": TIMESTEP, "transient": TRANSIENT}
