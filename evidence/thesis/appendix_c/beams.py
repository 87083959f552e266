"""The studies of appendix C and of §7.2.3, as `tables/studies.toml` has them: what is computed of which beams."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Unpack

import numpy as np

from evidence.thesis.appendix_c import beam_tasks, beam_wave_tasks, tower_wave_tasks
from evidence.thesis.disturbance import Disturbance
from evidence.thesis.experiments import EngineName
from evidence.thesis.runs import StudyRun, code_digest, place_of
from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.runs.trajectory import Status
from tensegrity_mj.simulation import versions
from tensegrity_mj.studies.many import RunOptions, run_many

Values = Mapping[str, Any]

BY_PRESTRESS = ("TB1", "TB2", "TB3", "TB4")
BY_STIFFNESS = ("TB1", "TB5", "TB6*", "TB7*")  # of equal prestress, the springs ever stiffer
HEIGHTS = (1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0)  # m, of the waves of C.2's text
SOURCES = ("statics/*.py", "thesis/appendix_c/beam_tasks.py")  # decide these studies' results, as engines do
FILE = Path(__file__).parents[1] / "tables" / "studies.toml"
MODULES = {"beam_tasks": beam_tasks, "beam_wave_tasks": beam_wave_tasks, "tower_wave_tasks": tower_wave_tasks}


@dataclass(frozen=True, eq=False)
class BeamRun(StudyRun):
    """Results of a study in one engine.

    Attributes:
        ...: those of `StudyRun`.
        values: of each beam, see `beam_tasks`; of a study in two directions "TB1 y" and "TB1 z".
        results: None; a series of cables has some.
    """

    values: Mapping[str, Values]
    results: None = None

    def of(self, beam: str, name: str) -> Array:
        """A value of a beam as an array."""
        return np.asarray(self.values[beam][name])


@dataclass(frozen=True)
class BeamStudy:
    """Definition of a study of beams.

    Attributes:
        name: unique among series and experiments.
        about: what it is, with the page.
        points: what the task is given, by the name of its values.
        tasks: a function of `beam_tasks` for each engine that computes it.
        of_mujoco: the points that MuJoCo computes; all of them where none are given.
        sources: of the package, by patterns: what else decides the results, in addition to engines and statics.
    """

    name: str
    about: str
    points: Mapping[str, Values]
    tasks: Mapping[EngineName, Callable[[dict[str, Any]], dict[str, Any]]]
    of_mujoco: tuple[str, ...] = ()
    sources: tuple[str, ...] = ()

    @property
    def engines(self) -> tuple[EngineName, ...]:
        """Engines that compute the study."""
        return tuple(self.tasks)

    def compute(
        self, engine: EngineName, folder: Path, disturbance: Disturbance | None = None, **how: Unpack[RunOptions]
    ) -> BeamRun:
        """Compute the study's values in one engine; see `Series.compute`."""
        chosen = self.of_mujoco if engine is EngineName.MUJOCO and self.of_mujoco else tuple(self.points)
        error = {} if disturbance is None else {"disturbance": disturbance.plain}
        points = [{**self.points[label], "engine": engine.value, **error} for label in chosen]
        identity = {"code": code_digest((*SOURCES, *self.sources)), "versions": versions()}
        place = place_of(folder, self.name, engine, [identity, points])
        how["identity"] = identity
        study = run_many(self.tasks[engine], points, place, **how)
        values = {
            label: outcome["values"]
            for label, outcome in zip(chosen, study.outcomes, strict=True)
            if "values" in outcome
        }
        status, message = Status.COMPLETED, ""
        if study.failed:
            first = study.failed[0]
            text = f"{len(study.failed)} of {len(points)} beams, the first {chosen[first]}: "
            status, message = Status.DIVERGED, text + study.outcomes[first]["reason"]
        return BeamRun(self.name, engine.value, values, status=status, message=message)


def wave_label(beam: str, height: float) -> str:
    """The name of a beam's values in waves."""
    return f"{beam} {height:g} m"


def _study(name: str, row: Mapping[str, Any]) -> BeamStudy:
    """Make the study of a row of the table, whose tasks are functions of `MODULES` by their names."""
    places = {EngineName(engine): place.partition(".") for engine, place in row["tasks"].items()}
    tasks = {engine: getattr(MODULES[module], task) for engine, (module, _, task) in places.items()}
    more = {key: tuple(row.get(key, ())) for key in ("of_mujoco", "sources")}
    return BeamStudy(name, row["about"], row["points"], tasks, **more)


STUDIES: Mapping[str, BeamStudy] = {
    name: _study(name, row) for name, row in tomllib.loads(FILE.read_text(encoding="utf-8")).items()
}
