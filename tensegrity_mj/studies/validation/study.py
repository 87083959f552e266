"""`validate`: the controller's report of any law on any scene, as data, a page and sentences."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from tensegrity_mj.basics.checks import names_from, positive, whole
from tensegrity_mj.basics.jsontext import plain_values
from tensegrity_mj.basics.seconds import fitted
from tensegrity_mj.controllers import specs
from tensegrity_mj.controllers.scenes import SCENE_LAW, AnyLaw, named_in
from tensegrity_mj.engines.requirements import engines_for, only_one
from tensegrity_mj.engines.table import ENGINES, installed
from tensegrity_mj.errors import OptionError
from tensegrity_mj.library.named import load_scene
from tensegrity_mj.model.actuation import whole_ratio
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.text.writing import scene_to_toml
from tensegrity_mj.studies.many import run_study
from tensegrity_mj.studies.plain import plain
from tensegrity_mj.studies.report import Page, Report, runs_in
from tensegrity_mj.studies.validation.findings import findings
from tensegrity_mj.studies.validation.page import page_of
from tensegrity_mj.studies.validation.sections import SECTIONS, Extent, Setup, cases
from tensegrity_mj.studies.validation.task import TICK, run_point
from tensegrity_mj.studies.workers import Workers, workers_for

FORMAT = 2
DATA, PAGE = "validation.json", "validation.html"  # what a folder holds


@dataclass(frozen=True, eq=False)
class Validation(Report):
    """A finished report; docs/validate.md explains the keys of its `data`."""

    NAME = "validation"

    def page(self) -> Page:
        """Make the page of the report, section by section."""
        return page_of(self.data)

    @property
    def summary(self) -> list[str]:
        """Summary of the report, in sentences."""
        return list(self.data["summary"])


def validate(
    scene: Scene | str | os.PathLike[str],
    law: AnyLaw | str | os.PathLike[str] = SCENE_LAW,
    *,
    law_options: Mapping[str, Any] | None = None,
    folder: str | os.PathLike[str] | None = None,
    engines: Sequence[str] | None = None,
    sections: Sequence[str] | None = None,
    duration: float | None = None,
    timestep: float = 1e-3,
    control_period: float = 1e-3,
    seed: int = 0,
    quick: bool = False,
    extent: Extent | None = None,
    workers: Workers | None = None,
    progress: bool = False,
) -> Validation:
    """Test a law on a scene in every engine: as it is meant to be, sampled, and with everything off that may be.

    Args:
        scene: a scene, or the name or the path of one; its loads must not be a Python function.
        law: the scene's own by default; a built-in law's name; "module:name" or "path.py:name" of your own; or a law
            object or function. What no other process can import is run in this one.
        law_options: of a law that a text names, or of the scene's, by their names.
        folder: where the report is written (validation.json, validation.html) and finished runs are kept, so that the
            same call goes on after an interruption; None keeps nothing.
        engines: "mujoco", "dae", ...; all that can simulate the scene by default. Sentences are of the first.
        sections: of `SECTIONS`; all by default. `nominal` is always run.
        duration: of each run [s]; the scene's by default; rounded to hundredths.
        timestep: of RK4 in every engine [s]; it must divide 10 ms.
        control_period: of runs that must be sampled (noise, delay, laws that jump) [s]; it must divide 10 ms.
        seed: of everything random, an integer >= 0.
        quick: a few points of each section.
        extent: exactly how much is run, in place of `quick`.
        workers: who computes; all cores by default.
        progress: show a bar with the time left on stderr.

    Returns:
        The report. Runs that fail, diverge or have no solution are results in it.

    Raises:
        OptionError: for options out of range, no law, or workers that cannot have the law.
        SceneError: for loads that are a Python function.
    """
    scene = scene if isinstance(scene, Scene) else load_scene(scene)
    spec = specs.spec_of(law, scene, law_options)
    if spec == specs.NO_LAW:
        raise OptionError(f"validate: there is no law to test; leave law out to test '{named_in(scene)}'")
    made = specs.make(spec, scene)
    description = plain(specs.describe(spec, made, scene), "what the law says of itself")
    setup = Setup(
        scene,
        made,
        _engines(scene, engines),
        _duration(scene, duration),
        _part_of_a_tick("timestep", timestep),
        _part_of_a_tick("control_period", control_period),
        whole("seed", seed, 0),
        extent or (Extent.quick() if quick else Extent()),
    )
    chosen = names_from("sections", sections, tuple(SECTIONS))
    chosen = [name for name in SECTIONS if name == "nominal" or name in chosen]
    todo = cases(setup, chosen)
    study = run_study(
        run_point,
        [case.point for case in todo],
        runs_in(folder),
        f"validation of {scene.name}",
        {
            "identity": {"law": description, "format": FORMAT},
            "workers": workers_for(spec, workers),
            "progress": progress,
        },
        {"scene": scene_to_toml(scene), "spec": spec, **plain_values(setup, "duration", "timestep")},
    )
    data: dict[str, Any] = {
        "format": FORMAT,
        "scene": {"name": scene.name, "source": scene.source},
        "law": description,
        "setup": {
            "engines": list(setup.engines),
            "sections": chosen,
            **plain_values(setup, "duration", "timestep"),
            "control_period": setup.period,
            "seed": setup.seed,
            "runs": len(todo),
        },
        "versions": study.identity["versions"],
        **findings(setup, list(zip(todo, study.outcomes, strict=True))),
    }
    return Validation(data).kept(folder)


def _engines(scene: Scene, given: Sequence[str] | None) -> list[str]:
    able = engines_for(scene)
    if len(able) != 1:
        return names_from("engines", installed() if given is None else given, tuple(ENGINES))
    names = names_from("engines", able if given is None else given, tuple(ENGINES))
    others = [name for name in names if name not in able]
    if others:
        raise OptionError(f"engines: {', '.join(others)}: {only_one(scene)}: leave them out, or validate another scene")
    return names


def _duration(scene: Scene, duration: float | None) -> float:
    total = positive("duration", scene.duration if duration is None else duration, "s")
    return TICK * max(1, round(total / TICK))


def _part_of_a_tick(what: str, value: float) -> float:
    value, _ = fitted(positive(what, value, "s"), {"tick": TICK})
    try:
        whole_ratio(TICK, value, what)
    except OptionError:
        raise OptionError(
            f"{what} = {value:g}: it must divide {TICK:g} s, as 0.005, 0.002, 0.001 and 0.0005 do"
        ) from None
    return value
