"""The study of §7.2.3: the tower in waves, nine cases, in both engines."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from tensegrity_mj.studies.waves import cases, task
from tensegrity_mj.thesis.appendix_c.beams import BeamStudy
from tensegrity_mj.thesis.disturbance import disturbance_of, disturbed
from tensegrity_mj.thesis.experiments import EngineName

ENGINES = (EngineName.DAE, EngineName.MUJOCO)
STUDY = "waves"


def by_dae(point: dict[str, Any]) -> dict[str, Any]:
    """A case in the DAE."""
    return _in_waves(point, EngineName.DAE)


def by_mujoco(point: dict[str, Any]) -> dict[str, Any]:
    """A case in MuJoCo."""
    return _in_waves(point, EngineName.MUJOCO)


def _in_waves(point: dict[str, Any], engine: EngineName) -> dict[str, Any]:
    """A case, with the error that the point has, if any."""
    from tensegrity_mj.simulation import simulate

    scene = disturbed(task.scene_of(point["tower"]), disturbance_of(point.get("disturbance")))
    run = simulate(scene, None, task.engine_of(engine.value, point["timestep"]), output_interval=task.INTERVAL)
    return task.measured(run, point["transient"])


STUDIES: Mapping[str, BeamStudy] = {
    STUDY: BeamStudy(
        STUDY,
        "Fig. 7.9: the tower in waves, 40 s, nine cases of stiffness and prestress",
        {label: cases.point(tower) for label, tower in cases.GRID.items()},
        {EngineName.DAE: by_dae, EngineName.MUJOCO: by_mujoco},
        sources=("runs/deformation.py", "studies/waves/*.py"),
    )
}
