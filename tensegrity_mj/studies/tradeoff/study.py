"""`tradeoff`: what accuracy costs on a scene, in every engine, with and without its law."""

from __future__ import annotations

import contextlib
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from tensegrity_mj.controllers import specs
from tensegrity_mj.controllers.scenes import SCENE_LAW
from tensegrity_mj.dynamics.native.law import native_law
from tensegrity_mj.errors import OptionError, SceneError
from tensegrity_mj.library.named import load_scene
from tensegrity_mj.model.actuation import Mode
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.text.writing import scene_to_toml
from tensegrity_mj.simulation import versions
from tensegrity_mj.studies.many import bar_of
from tensegrity_mj.studies.plain import digest, plain
from tensegrity_mj.studies.report import Page, Report, runs_in
from tensegrity_mj.studies.store import Store, opened
from tensegrity_mj.studies.tradeoff import advising
from tensegrity_mj.studies.tradeoff.advising import result_of, sentences
from tensegrity_mj.studies.tradeoff.experiments import (
    Experiment,
    Loop,
    Setting,
    TradeoffOptions,
    closed_loops,
    divides,
    open_loop,
    settings_of,
    weight,
)
from tensegrity_mj.studies.tradeoff.page import page_of
from tensegrity_mj.studies.tradeoff.reference import (
    FLOOR_FACTOR,
    SURE,
    Ended,
    Reference,
    attempt,
    find_reference,
    record,
)

PICTURE = "tradeoff.png"
FORMAT = 1
# Points that cost more than a part of the budget are timed so many times at most: long runs vary less.
REPEATS_BEYOND = ((1.0, 1), (0.25, 2))
SHORTER = (1.0, 0.1, 0.01)  # of the duration: an open loop that is too stiff or too wild for a reference is shortened

Data = dict[str, Any]


@dataclass(frozen=True, eq=False)
class Tradeoff(Report):
    """A finished study; everything but data["timing"] is the same each time."""

    NAME = "tradeoff"

    def page(self) -> Page:
        """Diagrams, advice, and each experiment with its settings."""
        return page_of(self.data)

    @property
    def sentences(self) -> list[str]:
        """Sentences on what to use for which accuracy, by the wall times measured here."""
        return sentences(self.data)

    def save_figure(self, path: str | os.PathLike[str]) -> Path:
        """Write the diagram, error against wall time, as .png, .svg or .pdf; returns its path."""
        from tensegrity_mj.pictures.figure import save_figure
        from tensegrity_mj.studies.tradeoff.page import Cost, diagram

        return save_figure(diagram(self.data, Cost.WALL_TIME), Path(path))


def tradeoff(
    scene: Scene | str | os.PathLike[str],
    law: Any = SCENE_LAW,
    *,
    law_options: Mapping[str, Any] | None = None,
    folder: str | os.PathLike[str] | None = None,
    options: TradeoffOptions | None = None,
    progress: bool = False,
) -> Tradeoff:
    """Measure error and cost of every engine, integrator, step and tolerance on a scene.

    Args:
        scene: a scene, or the name or the path of one. Its loads must not be a Python function.
        law: of the closed loop: the scene's own by default, None for none; the name of a built-in one, "module:name",
            "path.py:name", a law or a function.
        law_options: of a law that a text names, or of the scene's, by their names.
        folder: made where it is absent; tradeoff.json and tradeoff.html are written there, and the same call goes on
            after an interruption. None keeps nothing.
        options: what is swept; see `TradeoffOptions`.
        progress: show bars on stderr.

    Returns:
        The study. Runs that diverge, are refused or have no solution are results in it.

    Raises:
        OptionError: for options out of range, families that do not exist, a closed loop alone without a law, a folder
            of another study.
        SceneError: for loads that are a Python function.
        KeyboardInterrupt: what is finished is kept in the folder.
    """
    if not isinstance(scene, Scene):
        scene = load_scene(scene)
    chosen = options or TradeoffOptions()
    given = specs.spec_of(law, scene, law_options)
    spec = None if given == specs.NO_LAW else given
    if spec is None and Loop.OPEN not in chosen.loops:
        raise OptionError(f"scene '{scene.name}' names no control law, and only the closed loop is requested: give one")
    made = specs.make(spec, scene) if spec is not None else None
    facts = None if spec is None else plain(specs.describe(spec, made, scene), "what the law says of itself")
    study = {
        "task": "tradeoff",
        "scene": scene_to_toml(scene),
        "law": spec,
        "law_description": facts,
        "options": chosen.to_dict(),
        "versions": versions(),
    }
    with opened(runs_in(folder), plain(study, "the study")) as store:
        try:
            found = _measure(scene, made, chosen, store, progress)
        except KeyboardInterrupt:
            raise KeyboardInterrupt(store.stopped("{} runs are finished")) from None
    data: Data = {
        "format": FORMAT,
        "scene": {
            "name": scene.name,
            "source": scene.source,
            "rods": len(scene.structure.rods),
            "bodies": len(scene.structure.bodies),
            "strings": len(scene.structure.strings),
            "duration": scene.duration,
        },
        "law": facts,
        "options": chosen.to_dict(),
        "versions": versions(),
        **found,
    }
    return Tradeoff(data).kept(folder)


# ---------------------------------------------------------------------------------------------------- references


def _measure(scene: Scene, law: Any, options: TradeoffOptions, store: Store, progress: bool) -> Data:
    """The experiments with their references, then every setting of each, pass by pass."""
    native = None if law is None else native_law(law, scene.structure)
    closed = [] if law is None or native is None else closed_loops(scene, law, native, options)
    wanted = closed if Loop.CLOSED in options.loops else []
    requested = [*wanted, *([open_loop(scene, options, None)] if Loop.OPEN in options.loops else [])]
    _check(requested, options)
    todo: list[tuple[Experiment, Reference]] = []
    with bar_of(f"{scene.name}: references", len(closed) + (Loop.OPEN in options.loops), 0, progress) as bar:
        references: dict[str, Reference] = {}
        for experiment in closed:
            # The open loop alone may need the state of one closed loop to start from.
            if wanted or not any(one.motion for one in references.values()):
                references[experiment.key] = _reference(experiment, options, store)
            bar.update()
        if Loop.OPEN in options.loops:
            todo.append(_open(scene, options, list(references.values()), store))
            bar.update()
    todo += [(experiment, references[experiment.key]) for experiment in wanted]
    settings = {experiment.key: settings_of(experiment, options) for experiment, _ in todo}
    records = _passes(scene.name, todo, settings, options, store, progress)
    continuous = references.get(Mode.CONTINUOUS.value)
    results = [
        result_of(experiment, reference, continuous, settings[experiment.key], records[experiment.key])
        for experiment, reference in todo
    ]
    return {
        "floor_factor": FLOOR_FACTOR,
        "experiments": [experiment for experiment, _ in results],
        "timing": {"experiments": {experiment["key"]: timing for experiment, timing in results}},
    }


def _reference(experiment: Experiment, options: TradeoffOptions, store: Store) -> Reference:
    point = {"kind": "reference", "experiment": experiment.to_dict()}
    return Reference.from_dict(store.once(point, lambda: find_reference(experiment, options.budget).to_dict()))


def _open(
    scene: Scene, options: TradeoffOptions, closed: Sequence[Reference], store: Store
) -> tuple[Experiment, Reference]:
    """The open loop and its reference: from the scene's start or, if nothing moves there, from a state of the law's."""
    experiment, reference = _shortened(open_loop(scene, options, None), options, store)
    starts = [one.facts["fastest"] for one in closed if one.motion is not None]
    if not reference.stays:
        return experiment, reference
    if starts:
        with contextlib.suppress(SceneError):  # a state that has drifted is no start
            return _shortened(open_loop(scene, options, starts[0]), options, store)
    motion = reference.facts["motion"]
    most = f" by more than {advising.metres(motion)} in {experiment.duration:g} s" if motion else ""
    reason = f"without a law nothing moves{most}, so that there is no error to measure"
    if motion:
        reason += ": run longer, or start where something moves"
    return experiment, Reference(None, reference.facts | {"engine": None, "own_error": None, "reason": reason})


def _shortened(experiment: Experiment, options: TradeoffOptions, store: Store) -> tuple[Experiment, Reference]:
    """The experiment, shortened until a reference within the budget is known to `SURE` of its motion."""
    found: list[tuple[Experiment, Reference]] = []
    for part in SHORTER:
        tried = experiment
        if part < 1:
            note = (
                f"Shortened from {experiment.duration:g} s: of the whole, no reference within the budget is known to "
                f"{100 * SURE:.0f} % of the motion."
            )
            shorter = float(f"{part * experiment.duration:.12g}")
            tried = replace(experiment, duration=shorter, note=f"{experiment.note} {note}".strip())
        reference = _reference(tried, options, store)
        found.append((tried, reference))
        if _uncertainty(reference) <= SURE or reference.stays:
            return tried, reference
    # None is good: the one that is known best, the longer of equals.
    return min(found, key=lambda one: _uncertainty(one[1]))


def _uncertainty(reference: Reference) -> float:
    motion = reference.facts["motion"]
    return reference.own_error / motion if motion else math.inf


# -------------------------------------------------------------------------------------------------------- settings


def _check(experiments: Sequence[Experiment], options: TradeoffOptions) -> None:
    if not any(settings_of(experiment, options) for experiment in experiments):
        every = replace(options, families=())
        names = dict.fromkeys(one.family for experiment in experiments for one in settings_of(experiment, every))
        raise OptionError(
            f"tradeoff: families = {', '.join(options.families) or 'all'}: no setting has one of these words; there "
            f"are {'; '.join(names) or 'none, with these periods and this budget'}"
        )
    for one in experiments:
        if options.steps is not None and not any(divides(one.interval, step) for step in options.steps):
            raise OptionError(
                f"tradeoff: steps = {', '.join(f'{step:g}' for step in options.steps)}: runs of {one.duration:g} s are "
                f"recorded each {one.interval:g} s, and a step must divide that: use {one.interval:g} s over a whole "
                "number, or run longer"
            )


def _passes(
    name: str,
    todo: Sequence[tuple[Experiment, Reference]],
    settings: Mapping[str, Sequence[Setting]],
    options: TradeoffOptions,
    store: Store,
    progress: bool,
) -> dict[str, list[list[Data]]]:
    """The records of every setting, one a pass: each pass runs all of them once, so that load hits all alike."""
    runs: dict[str, list[list[Data]]] = {key: [[] for _ in own] for key, own in settings.items()}
    warm: set[tuple[str, str]] = set()
    for number in range(options.repeats):
        points = [
            (experiment, reference, place, setting)
            for experiment, reference in todo
            if reference.motion is not None
            for place, setting in enumerate(settings[experiment.key])
            if number == 0 or _again(experiment, runs[experiment.key][place][0], number, options)
        ]
        with bar_of(f"{name}: pass {number + 1} of {options.repeats}", len(points), 0, progress) as bar:
            for experiment, reference, place, setting in points:
                point = {"kind": "run", "pass": number, "experiment": experiment.key, "setting": setting.to_dict()}
                if digest(point) not in store.outcomes and (experiment.key, setting.family) not in warm:
                    attempt(experiment, setting.engine, experiment.interval)  # compiles and loads
                    warm.add((experiment.key, setting.family))

                def compute(of: Experiment = experiment, to: Reference = reference, by: Setting = setting) -> Data:
                    return record(attempt(of, by.engine), by.engine, to.motion)

                runs[experiment.key][place].append(store.once(point, compute))
                bar.update()
    return runs


def _again(experiment: Experiment, first: Data, number: int, options: TradeoffOptions) -> bool:
    """Return whether to time a point once more; decided by what it computed, never by how long that took."""
    if first["status"] != Ended.COMPLETED.value:
        return False
    part = first["evaluations"] * weight(experiment.scene, experiment.native) / options.budget
    most = next((count for above, count in REPEATS_BEYOND if part > above), options.repeats)
    return number < min(options.repeats, most)
