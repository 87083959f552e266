"""The runs of the ledger: computed by `run_many`, each kept as a .nc file at once, and read again where it fits."""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, asdict, dataclass, field
from pathlib import Path
from typing import Any, Unpack

import numpy as np

from evidence.thesis.disturbance import Disturbance, disturbance_of, disturbed
from evidence.thesis.experiments import EngineName, experiment_of, simulate_experiment
from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.jsontext import to_exact_json
from tensegrity_mj.errors import DivergenceError, FormatError
from tensegrity_mj.model.text.writing import scene_to_toml
from tensegrity_mj.runs.trajectory import Status, Trajectory
from tensegrity_mj.simulation import versions
from tensegrity_mj.studies.many import RunOptions, run_many

STAMP = "reproduction"  # the key of a run's provenance that states what it is a run of
# Sources that simulate, as laws do: plots, pages and commands may change without a run becoming another one.
CODE = (
    "basics/*.py",
    "model/**/*.py",
    "dynamics/**/*.py",
    "engines/**/*.py",
    "library/*.py",
    "simulation/*.py",
)


@dataclass(frozen=True)
class Computed:
    """Runs by engine and experiment (or series: `SeriesRun`s); where there is none, the reason why."""

    runs: Mapping[EngineName, Mapping[str, Any]]
    failures: Mapping[tuple[EngineName, str], str] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class StudyRun:
    """Results of a series or a study in one engine.

    Attributes:
        name, engine: of the study, and in words.
        cost: wall time [s] of what was computed in this call.
        status, message, time: as of a `Trajectory`; it is complete if all that it consists of is.
    """

    name: str
    engine: str
    _: KW_ONLY
    cost: Mapping[str, float] = field(default_factory=dict)
    status: Status = Status.COMPLETED
    message: str = ""
    time: Array = field(default_factory=lambda: np.zeros(1))


def place_of(folder: Path, name: str, engine: EngineName, identity: Any) -> Path:
    """The folder of a study: a change of versions, code or settings is another study, in a folder of its own."""
    digest = hashlib.sha256(to_exact_json(identity).encode()).hexdigest()[:8]
    return folder / f"{name}-{engine.value}-{digest}"


def run_experiments(
    names: Sequence[str],
    engines: Sequence[EngineName],
    folder: Path,
    disturbance: Disturbance | None = None,
    **how: Unpack[RunOptions],
) -> Computed:
    """Runs of all these experiments in all these engines; only those are computed that the folder lacks.

    Args:
        folder: exists; holds a file <experiment>-<engine>.nc for each run.
        disturbance: of the plant or of the law.
        how: workers and progress, see `run_many`.

    Raises:
        KeyboardInterrupt: its message says how much is finished; what is finished is kept.
    """
    wanted = [(name, engine) for name in names for engine in engines]
    found = {key: run for key in wanted if (run := _cached(folder, *key, disturbance)) is not None}
    points = [{"experiment": name, "engine": engine.value} for name, engine in wanted if (name, engine) not in found]
    failures: dict[tuple[EngineName, str], str] = {}
    if points:
        how["label"] = "runs"
        common = {"folder": str(folder.absolute()), "disturbance": None if disturbance is None else disturbance.plain}
        try:
            study = run_many(compute, points, common=common, **how)
        except KeyboardInterrupt:
            done = sum(_path(folder, name, engine).exists() for name, engine in wanted)
            raise KeyboardInterrupt(
                f"{done} of {len(wanted)} runs are kept in {folder}; run the same again to go on from there"
            ) from None
        for point, outcome in zip(points, study.outcomes, strict=True):
            key = point["experiment"], EngineName(point["engine"])
            run = _cached(folder, *key, disturbance)
            if outcome["status"] == "done" and run is not None:
                found[key] = run
            else:
                failures[key[1], key[0]] = outcome.get("reason", "its file cannot be read")
    runs: dict[EngineName, dict[str, Trajectory]] = {engine: {} for engine in engines}
    for name, engine in wanted:
        if (name, engine) in found:
            runs[engine][name] = found[name, engine]
    return Computed(runs, failures)


def compute(point: dict[str, Any]) -> dict[str, Any]:
    """The task of the study: one run, written to its file.

    A run that diverges is kept as far as it came.
    """
    name, engine = point["experiment"], EngineName(point["engine"])
    disturbance = disturbance_of(point["disturbance"])
    try:
        run = simulate_experiment(experiment_of(name), engine, disturbance)
    except DivergenceError as error:
        partial = error.trajectory
        if not isinstance(partial, Trajectory) or len(partial.time) < 2:
            raise
        run = partial
    run.provenance[STAMP] = stamp(name, engine, disturbance)
    path = run.save(_path(Path(point["folder"]), name, engine))
    return {"file": path.name, "status": run.status.value, "wall_time": run.cost.get("wall_time")}


def stamp(name: str, engine: EngineName, disturbance: Disturbance | None) -> dict[str, Any]:
    """Return the stamp of a file of this run: settings, scene, versions, and the code that simulates."""
    experiment = experiment_of(name)
    scene = scene_to_toml(disturbed(experiment.load(), disturbance))
    return {
        "experiment": {**asdict(experiment), "options": dict(experiment.options)},
        "engine": repr(experiment.engine(engine)),
        **({} if disturbance is None else {"disturbance": disturbance.plain}),
        "scene": hashlib.sha256(scene.encode()).hexdigest(),
        "versions": versions(),
        "code": code_digest(),
    }


@functools.cache
def code_digest(others: tuple[str, ...] = ()) -> str:
    """A digest of the sources that decide what a run is: engines, laws, what they stand on; and others by patterns."""
    from tensegrity_mj import controllers, simulation

    package, laws, evidence = (
        Path(str(simulation.__file__)).parents[1],
        Path(str(controllers.__file__)).parent,
        Path(__file__).parents[1],
    )
    patterns = [(package, name) for name in CODE] + [(laws, "*.py"), (evidence, "cable/*.py")]
    patterns += [(folder, name) for name in others for folder in (package, evidence)]
    files = [path for folder, name in patterns for path in sorted(folder.glob(name))]
    digest = hashlib.sha256()
    for path in files:
        digest.update(path.name.encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


def _cached(folder: Path, name: str, engine: EngineName, disturbance: Disturbance | None) -> Trajectory | None:
    path = _path(folder, name, engine)
    if not path.is_file():
        return None
    try:
        run = Trajectory.load(path)
    except FormatError:
        return None
    return run if run.provenance.get(STAMP) == stamp(name, engine, disturbance) else None


def _path(folder: Path, name: str, engine: EngineName) -> Path:
    return folder / f"{name}-{engine.value}.nc"
