"""Cases that §7.2.3's study leaves open, that its result should not depend on, and the distance of its engines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

import tensegrity_mj as tmj
from evidence.families.in_waves import tower_in_waves
from evidence.thesis.appendix_c.beams import STUDIES
from tensegrity_mj.engines.table import engine_of

Tower = Mapping[str, Any]  # arguments of `tower_in_waves`, as in `tower_wave_tasks`
CASES = STUDIES["waves"].points
GRID: Mapping[str, Tower] = {
    label: {key: value for key, value in case["tower"].items() if key != "duration"} for label, case in CASES.items()
}

DURATION = 5.001  # s, whole numbers of 3 ms and of 0.75 ms

# Parameters that the thesis leaves open; all else as in the grid.
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

# Choices that should hardly change the result; the others are compared with the first.
SENSITIVITY: Mapping[str, Tower] = {
    "as in the grid": {},
    "20 segments": {"segments": 20},
    "Ca = 0.5": {"added_mass": 0.5},
    "Ca = 0": {"added_mass": 0.0},
    "Hermite weights": {"weights": "hermite"},
}


def point(tower: Tower) -> dict[str, Any]:
    """Another tower in place of the study's."""
    usual = CASES["10 kN/m 0.1 m"]
    return {**usual, "tower": {"duration": usual["tower"]["duration"], **tower}}


def agreement(tower: Tower, steps: Sequence[float], rtol: float) -> list[float]:
    """Return the largest distance of MuJoCo's nodes [m] from those of the DAE with error control, for each step [s]."""
    scene = tower_in_waves(**tower)
    kept = {"duration": DURATION, "output_interval": max(steps)}
    reference = tmj.simulate(scene, None, tmj.DAE(rtol=rtol, atol=1e-2 * rtol), **kept)
    runs = (tmj.simulate(scene, None, engine_of("mujoco", step), **kept) for step in steps)
    return [float(np.linalg.norm(run.nodes - reference.nodes, axis=-1).max()) for run in runs]
