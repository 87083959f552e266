"""The runs of chapter 3: series of excited cables, of which a statement reads measures and no single trajectory."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from dataclasses import field as plain_field
from pathlib import Path
from typing import Any, Unpack

import numpy as np

from evidence.cable.cases import (
    COARSENESS,
    Case,
    CaseResults,
    default_step,
    point_of,
    run_cases,
    simulated,
)
from evidence.cable.spectrum import Spectrum, peaks_of, picked
from evidence.cable.steps import FoundStep, steps_within
from evidence.families.cables import MARKERS, refined
from evidence.thesis.disturbance import Disturbance, Quantity, disturbance_of, disturbed
from evidence.thesis.experiments import EngineName
from evidence.thesis.runs import StudyRun, code_digest, place_of
from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.fields import field, value
from tensegrity_mj.basics.files import write_text
from tensegrity_mj.basics.jsontext import from_exact_json, to_exact_json
from tensegrity_mj.basics.kinds import choice, each, finite, flag, many, positive, text, whole
from tensegrity_mj.engines.table import engine_of
from tensegrity_mj.errors import FormatError
from tensegrity_mj.library.cable import FASTENING_LENGTH, Excitation, Start, cable
from tensegrity_mj.linearization.linearizing import linearize
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.text.codec import Table, read
from tensegrity_mj.runs.trajectory import Status
from tensegrity_mj.simulation import versions
from tensegrity_mj.studies.many import RunOptions, run_many

FILE = Path(__file__).parents[1] / "tables" / "series.toml"
# Hz between the frequencies of §3.3.2: so far apart "some 240 simulations" (§3.5.5), ten of each, would have them.
SPACING = 0.05
ELEMENTS = tuple(refined(divisions) for divisions in range(1, 11))
SHOWN = (5, 10)  # the markers of the figures
PLACES = tuple(FASTENING_LENGTH + MARKERS[number - 1] for number in SHOWN)  # m
AMPLITUDE = 0.05  # m
ALLOWED_DRIFT = 0.02  # §3.5.2
REFINED_COARSENESS = 0.7  # h ω of refined cables: that of thirteen elements at 0.01 s
ROPE = slice(1, -1)  # the rods between fastening and load
COUNTS = many(whole(1), "a list of integers")
ENDS = each("[first, last]", first=positive("Hz"), last=positive("Hz"))


@dataclass(frozen=True, eq=False)
class SeriesRun(StudyRun):
    """A series in one engine.

    Attributes:
        ...: those of `StudyRun`. Where a case of a sweep failed, the series did not complete. Of series that are there
            to see which steps are stable, cases may fail.
        results: of the cases, or None.
        steps: found by §3.5.4's search, or ().
        frequencies: (K,) [Hz] of small oscillations by the number of elements.
        seconds: wall time [s] of each run of a timed series.
    """

    results: CaseResults | None = None
    steps: tuple[FoundStep, ...] = ()
    frequencies: Mapping[int, Array] = plain_field(default_factory=dict)
    seconds: tuple[float, ...] = ()

    @property
    def cases(self) -> CaseResults:
        """The results of a series of cases."""
        assert self.results is not None
        return self.results

    def peaks(self, number: int, axis: int = 0) -> list[tuple[float, ...]]:
        """The main peaks [Hz] of each run by the thesis' two criteria, largest first."""
        grid, column = self.cases.spectral_frequencies, SHOWN.index(number)
        found = [
            () if np.isnan(density).any() else peaks_of(Spectrum(grid, density))
            for density in self.cases.densities[:, column, axis]
        ]
        return [tuple(peak.frequency for peak in row) for row in picked(found)]


@value("series {name!r}", FormatError)
class Series:
    """Definition of a series of runs.

    Attributes:
        name: unique among series and experiments.
        about: what it is, with the page.
        engines: that compute it.
        elements: numbers of elements of the cables that are excited; none for a series of another kind.
        inputs: first and last frequency of their excitation [Hz].
        excitation, starts, seed: see `Case`; each start has all inputs.
        timestep: of the thesis' runs of §3.5 [s]: fixed, and no treatment of drift; None for steps as in `_engine`.
        oscillations: numbers of elements whose small oscillations are looked for.
        search: whether it is the search for the step with a given drift.
        timed: whether the wall times of its runs are measured too, one after another, for figures alone.
    """

    name: str = field(text())
    about: str = field(text())
    engines: tuple[EngineName, ...] = field(many(choice(EngineName), "a list of engines"))
    elements: tuple[int, ...] = field(COUNTS, default=())
    inputs: tuple[float, float] = field(ENDS, default=(1.0, 1.0))
    excitation: Excitation = field(choice(Excitation), default=Excitation.IN_LINE)
    starts: tuple[Start, ...] = field(many(choice(Start), "a list of starts"), default=(Start.MOVING_FRAME,))
    seed: float = field(finite("rad"), default=0.0)
    timestep: float | None = field(positive("s"), default=None, none="None")
    oscillations: tuple[int, ...] = field(COUNTS, default=())
    search: bool = field(flag(), default=False)
    timed: bool = field(flag(), default=False)

    @property
    def frequencies(self) -> tuple[float, ...]:
        """Frequencies of the excitations [Hz]: from the first of `inputs` to the last, 0.05 Hz apart."""
        first, last = (round(one / SPACING) for one in self.inputs)
        return tuple(round(SPACING * k, 2) for k in range(first, last + 1))

    def cases(self, engine: EngineName) -> list[Case]:
        """The excited cables in an engine."""
        found = []
        for count in self.elements:
            scene, coarseness = hanging(count), COARSENESS if count == ELEMENTS[0] else REFINED_COARSENESS
            chosen = (
                _engine(engine, scene, coarseness) if self.timestep is None else engine_of("dae monitor", self.timestep)
            )
            found += [
                Case(scene, f, self.excitation, AMPLITUDE, start, self.seed, chosen)
                for start in self.starts
                for f in self.frequencies
            ]
        return found

    def compute(
        self, engine: EngineName, folder: Path, disturbance: Disturbance | None = None, **how: Unpack[RunOptions]
    ) -> SeriesRun:
        """Compute the results in one engine; those that are in its own folder in `folder` are not computed again."""
        cases = [replace(case, scene=disturbed(case.scene, disturbance, ROPE)) for case in self.cases(engine)]
        error = {} if disturbance is None else {"disturbance": disturbance.plain}
        identity = {"code": code_digest(), **error}
        settings = [point_of(case, str(len(case.scene.structure.rods))) for case in cases]
        place = place_of(folder, self.name, engine, [identity, versions(), self.oscillations, settings])
        how["identity"] = identity
        found = SeriesRun(self.name, engine.value)
        if self.oscillations:
            points = [{"elements": K, "engine": engine.value, **error} for K in self.oscillations]
            study = run_many(oscillations, points, place, **how)
            own = [np.array(values) for values in study.values("frequencies")]
            found = replace(found, frequencies=dict(zip(self.oscillations, own, strict=True)))
        elif self.search:
            found = replace(found, steps=tuple(steps_within(cases, ALLOWED_DRIFT, place, **how)))
            pairs = [pair for pair in zip(cases, found.steps, strict=True) if math.isfinite(pair[1].step)]
            cases = [replace(case, engine=replace(case.engine, timestep=one.step)) for case, one in pairs]
        else:
            found = replace(found, results=run_cases(cases, marker_places(disturbance), place, **how))
        lost = [] if found.results is None or self.timed else found.results.failed
        if lost and found.results is not None:
            text = f"{len(lost)} of {len(cases)} cases, the first at {cases[lost[0]].frequency:g} Hz: "
            found = replace(found, status=Status.DIVERGED, message=text + found.results.messages[lost[0]])
        if self.timed:
            found = replace(found, seconds=_timed(cases, found, folder / f"{place.name}-timing.json"))
        return found


def marker_places(disturbance: Disturbance | None) -> tuple[float, ...]:
    """Arc lengths [m] of the markers from the top: they sit on the rope, so their places scale with its lengths."""
    if disturbance is None or disturbance.quantity is not Quantity.GEOMETRY:
        return PLACES
    return tuple(disturbance.factor * place for place in PLACES)


def oscillations(point: dict[str, Any]) -> dict[str, Any]:
    """A task of `run_many`: the frequencies [Hz] of the small oscillations of a cable in an engine."""
    scene = disturbed(hanging(point["elements"]), disturbance_of(point.get("disturbance")), ROPE)
    found = linearize(scene, _engine(EngineName(point["engine"]), scene, COARSENESS)).frequencies
    return {"frequencies": np.sort(found)[::2].tolist()}  # each is there in two planes


def _timed(cases: Sequence[Case], found: SeriesRun, path: Path) -> tuple[float, ...]:
    """Wall time [s] of each run, the least of two, one after another; NaN for one that did not complete.

    Times are no part of a study's results, which are the same on every machine; they are kept in a file next to it.
    """
    if path.is_file():
        try:
            kept = from_exact_json(path.read_text(encoding="utf-8"))["wall_time"]
            if len(kept) == len(cases):
                return tuple(float(one) for one in kept)
        except (ValueError, KeyError, TypeError):
            pass  # damaged: measured again
    completed = Status.COMPLETED.value
    ran = [True] * len(cases) if found.results is None else [one == completed for one in found.results.statuses]
    times = []
    for case, right in zip(cases, ran, strict=True):
        step = float(case.engine.timestep)
        interval = step * max(1, round(0.1 / step))
        spent = [simulated(case, interval=interval).cost["wall_time"] for _ in range(2)] if right else [float("nan")]
        times.append(min(spent))
    write_text(path, to_exact_json({"wall_time": times}) + "\n")
    return tuple(times)


def hanging(elements: int) -> Scene:
    """The cable at rest."""
    return cable(elements, excitation=Excitation.NONE)


def _engine(name: EngineName, scene: Scene, coarseness: float) -> Any:
    """The engine of a series: classical Runge-Kutta in both, at the same step."""
    return engine_of("rk4" if name is EngineName.MUJOCO else "dae normalize", default_step(scene, coarseness))


def read_series(path: Path) -> dict[str, Series]:
    """The series of a table, by their names.

    Raises:
        FormatError: naming the file, the row and what is wrong with it.
    """
    table = Table(tomllib.loads(path.read_text(encoding="utf-8")), path.name, "", ("series",))
    return {row.data["name"]: read(Series, row) for row in table.tables("series", None, "name")}


SERIES: Mapping[str, Series] = read_series(FILE)
