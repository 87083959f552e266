"""The task of §7.2.3's study: the tower in waves."""

from __future__ import annotations

from typing import Any

from tensegrity_mj.simulation import simulate
from tensegrity_mj.studies.engine_names import engine_of
from tensegrity_mj.studies.waves import task
from tensegrity_mj.thesis.disturbance import disturbance_of, disturbed


def in_waves(point: dict[str, Any]) -> dict[str, Any]:
    """A case, with the error that the point has, if any, simulated, and how the tower bends."""
    scene = disturbed(task.scene_of(point["tower"]), disturbance_of(point.get("disturbance")))
    engine = engine_of(point.get("engine", "dae"), point["timestep"])
    return task.measured(simulate(scene, None, engine, output_interval=task.INTERVAL), point["transient"])
