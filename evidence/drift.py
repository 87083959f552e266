"""Long runs: how energy and constraints drift over a million steps, for each integrator and each treatment of drift.

The scene is made conservative (no law, no dampers, no loads) and set in motion, so that its energy must stay what it
was; every integrator takes the same steps. What is measured is the largest departure up to each power of ten of steps,
and the power of time by which it grew over the last one: 0 for bounded, 1/2 for round-off's random walk, 1 for steady
growth, 2 for growing growth.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np

from evidence.extremes.pace import pace
from evidence.random_linked import random_velocities
from tensegrity_mj.basics.checks import names_from, positive, whole
from tensegrity_mj.basics.texts import aligned
from tensegrity_mj.basics.units import quantity
from tensegrity_mj.engines.reference.dae import DAE
from tensegrity_mj.engines.reports import ENERGY_WARNING
from tensegrity_mj.engines.table import engine_of
from tensegrity_mj.errors import OptionError
from tensegrity_mj.library.named import load_scene
from tensegrity_mj.model import rods
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.text.reading import scene_from_toml
from tensegrity_mj.model.text.writing import scene_to_toml
from tensegrity_mj.pictures.figure import frame, new_figure
from tensegrity_mj.pictures.findings import Finding, Judgement, Mark
from tensegrity_mj.pictures.page import Picture, Section, Table
from tensegrity_mj.runs.energy import DRIFT_WARNING, energy_exchanged
from tensegrity_mj.runs.trajectory import Status, Trajectory
from tensegrity_mj.simulation import simulate_as_far
from tensegrity_mj.studies.many import RunOptions, run_study
from tensegrity_mj.studies.report import Page, Report, runs_in
from tensegrity_mj.vibration.stable_step import stable_step

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Data = Mapping[str, Any]

FORMAT = 1
PAGE = "drift.html"  # what a folder holds
# MuJoCo's integrators, and classical Runge-Kutta of the reference models with each treatment of drift.
METHODS = (
    "euler",
    "implicitfast",
    "implicit",
    "discrete",
    "rk4",
    "dae monitor",
    "dae normalize",
    "dae baumgarte",
    "ode",
)
COARSENESS = 0.1  # step times the fastest rate at the start: well within every integrator's limit
ROWS = 1000  # recorded times
LEAST_STEPS = 1000
RESOLVED = 1e-14  # a departure below it is none
LEAST = 1e-17  # of a course that is drawn on a logarithmic axis
QUANTITIES = {
    "energy": "largest change of the energy, of all that was exchanged",
    "length": "largest change of bᵀb",
    "rate": "largest bᵀḃ [1/s]",
}


@dataclass(frozen=True, eq=False)
class LongRuns(Report):
    """Finished long runs."""

    NAME = "drift"

    @property
    def text(self) -> str:
        """The table, for a terminal."""
        marks = [str(mark) for mark in self.data["setup"]["marks"]]
        lines = []
        for name, meaning in QUANTITIES.items():
            lines.append(f"{meaning}, up to so many steps, and its growth over the last power of ten")
            cells = [
                [row["method"], *(_cell(row[name].get(mark)) for mark in marks), _growth(row["growth"].get(name))]
                for row in self.data["rows"]
            ]
            lines += [*aligned([["", *marks, "growth"], *cells], numbers=True), ""]
        lines += [f"{row['method']}: {row['reason']}" for row in self.data["rows"] if row["reason"]]
        return "\n".join(lines).rstrip()

    @property
    def judgement(self) -> Judgement:
        """A finding a method."""
        setup, findings = self.data["setup"], tuple(_findings(self.data))
        kept = sum(one.mark is Mark.GOOD for one in findings)
        verdict = (
            f"{kept} of {len(findings)} methods keep energy and lengths over {setup['steps']:,} steps of "
            f"{quantity(setup['timestep'], 's')}: within {ENERGY_WARNING:.0%} of the energy exchanged, and bᵀb within "
            f"{DRIFT_WARNING:.1%} of 1."
        )
        return Judgement(verdict, findings)

    def page(self) -> Page:
        """A table and a course of each quantity."""
        data, setup = self.data, self.data["setup"]
        marks = [str(mark) for mark in setup["marks"]]
        heads = ["", *(f"{int(mark):,} steps" for mark in marks), "growth, power of time", ""]
        sections = []
        for name, meaning in QUANTITIES.items():
            table = [
                [row["method"], *(row[name].get(mark) for mark in marks), row["growth"].get(name), row["reason"]]
                for row in data["rows"]
            ]
            sections.append(
                Section(meaning, (), [Picture(course_figure(data, name), meaning), Table("", heads, table)])
            )
        introduction = (
            f"The scene {setup['scene']}, in motion, without law, dampers and loads (seed {setup['seed']}): nothing "
            "may change its energy. b is the direction of a rod, whose length is 1."
        )
        return Page(f"Long runs of {setup['scene']}", introduction, self.judgement, sections)


def long_runs(
    scene: Scene | str | os.PathLike[str],
    steps: int = 1_000_000,
    *,
    timestep: float | None = None,
    methods: Sequence[str] | None = None,
    seed: int = 0,
    folder: str | os.PathLike[str] | None = None,
    **how: Unpack[RunOptions],
) -> LongRuns:
    """Measure the drift of energy and constraints over long runs.

    Args:
        scene: a scene, or the name or path of one.
        steps: how many; a multiple of 1000.
        timestep: [s]; by default a tenth of the shortest time scale at the start.
        methods: of `METHODS`; all by default.
        seed: of the velocities of a scene that starts at rest.
        folder: where drift.json, drift.html and finished runs are kept, so that the same call goes on.
        how: workers and progress, see `run_many`.

    Raises:
        OptionError: for options out of range.
    """
    if not isinstance(scene, Scene):
        scene = load_scene(scene)
    if not isinstance(steps, int) or isinstance(steps, bool) or steps < LEAST_STEPS or steps % ROWS:
        raise OptionError(f"steps = {steps!r}; it must be a multiple of {ROWS}, at least {LEAST_STEPS}")
    whole("seed", seed, 0)
    chosen = names_from("methods", methods, METHODS)
    free = conservative(scene, seed)
    h = default_step(free) if timestep is None else positive("timestep", timestep, "s")
    common = {"scene": scene_to_toml(free), "steps": steps, "timestep": h}
    points = [{"method": name} for name in chosen]
    study = run_study(run_long, points, runs_in(folder), f"long runs of {scene.name}", how, common)
    none: dict[str, Any] = {"growth": {}, **{name: {} for name in QUANTITIES}}
    found = study.rows(lambda outcome: {"reason": outcome["reason"], **none})
    rows = [{"method": name, **row} for name, row in zip(chosen, found, strict=True)]
    setup = {"scene": scene.name, "steps": steps, "timestep": h, "seed": seed, "marks": marks_of(steps)}
    data = {"format": FORMAT, "setup": setup, "versions": study.identity["versions"], "rows": rows}
    return LongRuns(data, seconds=study.seconds).kept(folder)


def conservative(scene: Scene, seed: int) -> Scene:
    """The scene in motion, without law, dampers, loads, moving supports, resistance, water and breaks."""
    structure = scene.structure.with_strings(damping=0.0) if scene.structure.strings else scene.structure
    points = tuple(replace(one, damping=0.0) for one in structure.point_masses)
    structure = replace(structure, point_masses=points)
    velocities = scene.velocities0
    if scene.motions or not np.any(velocities):
        speed = 0.1 * float(np.max(np.ptp(scene.nodes0, axis=0)))
        velocities = random_velocities(np.random.default_rng(seed), structure, scene.nodes0, speed)
    return scene.with_(
        structure=structure,
        initial_velocities=velocities,
        loads=(),
        motions=(),
        breaks=(),
        resistance=None,
        water=None,
        control=None,
        target=None,
    )


def default_step(scene: Scene) -> float:
    """`COARSENESS` over the fastest rate at the start [s], to two digits."""
    fastest = pace(scene).fastest
    if scene.structure.class_number > 1:  # joints, of which the pace knows nothing, make rods swing faster
        fastest = max(fastest, stable_step(scene, DAE(), law=None).omega)
    step = COARSENESS / fastest
    digit = 10.0 ** (math.floor(math.log10(step)) - 1)
    return float(f"{round(step / digit) * digit:.6g}")


def marks_of(steps: int) -> list[int]:
    """Powers of ten from 1000, and the end."""
    return sorted({10**power for power in range(3, 16) if 10**power < steps} | {steps})


def run_long(point: dict[str, Any]) -> dict[str, Any]:
    """The task: one long run, by `method`, of `scene` (TOML), so many `steps` of `timestep` [s]."""
    scene, steps, h = scene_from_toml(point["scene"]), point["steps"], point["timestep"]
    run = simulate_as_far(
        scene, None, engine_of(point["method"], h), duration=steps * h, output_interval=steps // ROWS * h
    )
    reason = "" if run.status is Status.COMPLETED else run.message
    return {"method": point["method"], "reason": reason, **measured(run, h, steps)}


def measured(run: Trajectory, h: float, steps: int) -> dict[str, Any]:
    """Return for each quantity the largest up to each mark that the run reached, its growth, and its course."""
    scale = float(energy_exchanged(run)[-1]) if len(run.time) else 0.0
    energy = run.kinetic_energy + run.gravity_energy + run.string_energy
    b, b_rate = (rods.directions(run.scene.structure, rows) for rows in (run.nodes, run.velocities))
    courses = {
        "energy": np.abs(energy - energy[:1]) / (scale or 1.0),
        "length": np.abs(np.sum(b * b, axis=-1) - 1).max(axis=1, initial=0.0),
        "rate": np.abs(np.sum(b * b_rate, axis=-1)).max(axis=1, initial=0.0),
    }
    found: dict[str, Any] = {"growth": {}}
    for name, course in courses.items():
        largest = np.maximum.accumulate(course)
        reached = [mark for mark in marks_of(steps) if len(run.time) and run.time[-1] >= mark * h * (1 - 1e-9)]
        rows = np.searchsorted(run.time, np.multiply(reached, h * (1 + 1e-9)), side="right") - 1
        found[name] = {str(mark): float(largest[row]) for mark, row in zip(reached, rows, strict=True)}
        found["growth"][name] = growth([found[name][str(mark)] for mark in reached], reached)
    keep = np.unique(np.geomspace(1, max(2, len(run.time) - 1), 60).astype(int))
    keep = keep[keep < len(run.time)]
    found["course"] = {"steps": (run.time[keep] / h).round().tolist()} | {
        name: np.maximum.accumulate(course)[keep].tolist() for name, course in courses.items()
    }
    return found


def growth(values: Sequence[float], steps: Sequence[int]) -> float | None:
    """The power of time by which a quantity grew between the last two marks; None where it is below round-off."""
    if len(values) < 2 or values[-1] < RESOLVED:
        return None
    return math.log(values[-1] / max(values[-2], RESOLVED)) / math.log(steps[-1] / steps[-2])


def _cell(value: float | None) -> str:
    return "-" if value is None else f"{value:.2g}"


def _growth(power: float | None) -> str:
    return "-" if power is None else f"t^{max(0.0, power):.2f}"


def _findings(data: Data) -> Iterator[Finding]:
    """A method each, with how far energy and lengths went; what runs warn of is limited, or bad where rods stretch."""
    for row in data["rows"]:
        energy, length = (max(row[name].values(), default=0.0) for name in ("energy", "length"))
        mark = Mark.LIMITED if energy > ENERGY_WARNING else Mark.GOOD
        mark = Mark.BAD if row["reason"] or length > DRIFT_WARNING else mark
        text = f"{row['method']}: the energy changes by {energy:.2g} of all that was exchanged, bᵀb by {length:.2g}."
        yield Finding(mark, f"{row['method']}: {row['reason']}" if row["reason"] else text)


def course_figure(data: Data, name: str) -> Figure:
    """Plot how a quantity grew over the steps, for each method that let it grow at all."""
    figure = new_figure(9.0, 4.5)
    axes = figure.add_subplot()
    for row in data["rows"]:
        course = row.get("course", {})
        if any(value > 0 for value in course.get(name, [])):
            axes.loglog(course["steps"], np.maximum(course[name], LEAST), label=row["method"])
    frame(axes, "", "steps", QUANTITIES[name])
    return figure
