"""The study of §7.2.3: the tower in waves, nine cases, in both engines."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from tensegrity_mj.reproduction.beams import BeamStudy
from tensegrity_mj.reproduction.experiments import EngineName
from tensegrity_mj.studies.waves import cases
from tensegrity_mj.studies.waves.task import in_waves

ENGINES = (EngineName.DAE, EngineName.MUJOCO)
STUDY = "waves"


def by_dae(point: dict[str, Any]) -> dict[str, Any]:
    """A case in the DAE."""
    return in_waves({**point, "engine": EngineName.DAE.value})


def by_mujoco(point: dict[str, Any]) -> dict[str, Any]:
    """A case in MuJoCo."""
    return in_waves({**point, "engine": EngineName.MUJOCO.value})


STUDIES: Mapping[str, BeamStudy] = {
    STUDY: BeamStudy(
        STUDY,
        "Fig. 7.9: the tower in waves, 40 s, nine cases of stiffness and prestress",
        {label: cases.point(tower) for label, tower in cases.GRID.items()},
        {EngineName.DAE: by_dae, EngineName.MUJOCO: by_mujoco},
        sources=("water.py", "waves.py", "deformation.py", "studies/waves/*.py"),
    )
}
