"""The study of §7.2.3: the tower in waves, nine cases, in both engines."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from tensegrity_mj.studies.engine_names import engine_of
from tensegrity_mj.studies.waves import cases, task
from tensegrity_mj.thesis.appendix_c.beams import BeamStudy
from tensegrity_mj.thesis.disturbance import disturbance_of, disturbed
from tensegrity_mj.thesis.experiments import EngineName

STUDY = "waves"


def in_waves(point: dict[str, Any]) -> dict[str, Any]:
    """A case, with the error that the point has, if any, simulated, and how the tower bends."""
    from tensegrity_mj.simulation import simulate

    scene = disturbed(task.scene_of(point["tower"]), disturbance_of(point.get("disturbance")))
    engine = engine_of(point.get("engine", "dae"), point["timestep"])
    return task.measured(simulate(scene, None, engine, output_interval=task.INTERVAL), point["transient"])


STUDIES: Mapping[str, BeamStudy] = {
    STUDY: BeamStudy(
        STUDY,
        "Fig. 7.9: the tower in waves, 40 s, nine cases of stiffness and prestress",
        {label: cases.point(tower) for label, tower in cases.GRID.items()},
        dict.fromkeys((EngineName.DAE, EngineName.MUJOCO), in_waves),
        sources=("runs/deformation.py", "studies/waves/*.py"),
    )
}
