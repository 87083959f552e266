"""Predicted largest stable steps of a scene in every engine with a fixed step: at its start, and along a run."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from tensegrity_mj.basics.checks import names_from
from tensegrity_mj.basics.texts import aligned
from tensegrity_mj.basics.units import quantity
from tensegrity_mj.controllers.scenes import SCENE_LAW, law_for
from tensegrity_mj.engines.table import NAMES, TITLES, engine_of
from tensegrity_mj.errors import TensegrityError
from tensegrity_mj.model.capabilities import refusal
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.pictures.findings import Finding, Judgement, Mark
from tensegrity_mj.pictures.page import Section, Table
from tensegrity_mj.studies.report import Page, Report
from tensegrity_mj.vibration.stable_step import StableStep, stable_step

FINE = 0.1  # of the stable step and of contact's time: the step of the run that a scene with contact is looked along
HEADS = ("", "at the start [s]", "worst on the way [s]", "at t [s]", "rod or mass", "string", "remarks")
INTRODUCTION = (
    "The limit at which a small motion begins to grow, from the linear model of the structure and its law in each "
    "configuration. A dash is no limit. tensegrity-mj audit stability, of the evidence, measures limits, too."
)


@dataclass(frozen=True, eq=False)
class StableSteps(Report):
    """Predicted limits of the step, by engine: `data` has everything, as plain values."""

    NAME = "stability"

    @property
    def judgement(self) -> Judgement:
        """The smallest limit of all engines, refusals, and effects that no limit covers."""
        scene, engines = self.data["scene"], self.data["start"]["engines"]
        worst = [one["worst"] for one in engines.values() if "error" not in one]
        known = [one["limit"] for one in worst if one["limit"] is not None]
        least = f"; the smallest limit is {quantity(min(known), 's')}" if known else ""
        found = [Finding(Mark.UNJUDGED, f"{TITLES[k]}: {one['error']}") for k, one in engines.items() if "error" in one]
        notes = dict.fromkeys(note for one in worst for note in one["notes"])
        found += [Finding(Mark.LIMITED, note) for note in notes]
        return Judgement(f"{len(known)} of {len(engines)} engines limit the step of {scene}{least}.", found)

    def page(self) -> Page:
        """Make the page: the limits of all engines in one table."""
        start = self.data["start"]
        title = f"The largest stable step: {self.data['scene']}"
        return Page(title, INTRODUCTION, self.judgement, [start_section(start)])

    def lines(self) -> list[str]:
        """Return the limits as lines of text."""
        return start_lines(self.data["scene"], self.data["start"])


def predict_steps(scene: Scene, *, law: Any = SCENE_LAW, engines: Sequence[str] = NAMES) -> StableSteps:
    """Predict the largest stable step of engines at the scene's start and along a run.

    Args:
        scene: its start, and a run from there, are looked at.
        law: closes the loop; the scene's own by default, where it can be evaluated at every stage; None for none.
        engines: names from `engines.table.NAMES`.

    Returns:
        The limits. An engine that refuses the scene has its reason in place of them.

    Raises:
        OptionError: for unknown names.
    """
    names = names_from("engines", engines, NAMES)
    return StableSteps(
        {"scene": scene.name, "engines": names, "start": at_start(scene, continuous_law(scene, law), names)}
    )


def continuous_law(scene: Scene, law: Any) -> Any:
    """Return the law, or the scene's own where it can be evaluated at every stage; None where there is none."""
    found = law_for(scene, law)
    return None if law is SCENE_LAW and getattr(found, "discontinuous", None) else found


def at_start(scene: Scene, law: Any, engines: Sequence[str]) -> dict[str, Any]:
    """Predict limits at the start, and the smallest along a run: of the DAE in tight tolerances, where it can."""
    from tensegrity_mj.simulation import simulate

    run, reason = None, ""
    try:
        run = simulate(scene, law, _engine_of_run(scene, law))
        if scene.contact is not None:
            reason = f" of {run.engine}, with contact (whose own limit is not among these)"
    except TensegrityError as error:
        reason = f"; no run to look along: {error}"

    def limits(name: str) -> dict[str, Any]:
        try:
            here = stable_step(scene, engine_of(name, 1.0), law=law)
            worst = here if run is None else stable_step(scene, engine_of(name, 1.0), law=law, run=run)
        except TensegrityError as error:
            return {"error": str(error)}
        return {"start": here.to_dict(), "worst": worst.to_dict()}

    loop = "in the loop with its law" if law is not None else "without a law"
    return {
        "text": f"Predicted {loop}, at the start and at the worst of 25 configurations along a run{reason}. A moving "
        "state has no limit of its own to measure.",
        "closed_loop": law is not None,
        "engines": {name: limits(name) for name in engines},
    }


def _engine_of_run(scene: Scene, law: Any) -> Any:
    """The DAE; where it refuses the scene's contact, MuJoCo's RK4 with steps that resolve both it and contact."""
    from tensegrity_mj.engines.mujoco.settings import MuJoCo
    from tensegrity_mj.engines.reference.dae import DAE

    if scene.contact is None or refusal(DAE(), scene) is None:
        return DAE()
    found: StableStep = stable_step(scene, MuJoCo(1.0), law=law)
    # Limits by contact: 1/√k of its spring and 2/b of its damper.
    contact = min(1 / math.sqrt(scene.contact.stiffness), 2 / max(scene.contact.spring.damping, 1e-12))
    step = FINE * min(found.limit, contact)
    return MuJoCo(scene.duration / math.ceil(scene.duration / step))


def start_section(part: Mapping[str, Any]) -> Section:
    """The limits at the start and along a run, a row an engine."""
    return Section("As it starts and moves", (part["text"],), [Table("", HEADS, list(_rows(part)))])


def start_lines(scene: str, part: Mapping[str, Any]) -> list[str]:
    """The same as lines of text, engines that refuse the scene after the others."""
    rows, failed = [("", "at the start", "worst on the way", "at", "")], []
    for name, first, worst, time, rod, string, remarks in _rows(part):
        if time is None:
            failed.append(f"{name}: {remarks}")
        else:
            where = f"{rod} on {string}" if string else rod
            rows.append((name, _seconds(first), _seconds(worst), f"{time:.4g} s", where))
    return [f"scene {scene}: {part['text']}", *aligned(rows), *failed]


def _rows(part: Mapping[str, Any]) -> Iterator[tuple[Any, ...]]:
    """Yield for each engine the limits [s] at the start and at the worst, its time [s], rod, string and remarks."""
    for name, one in part["engines"].items():
        if "error" in one:
            yield TITLES[name], None, None, None, "", "", one["error"]
            continue
        worst = one["worst"]
        remarks = "; ".join(worst["notes"])
        yield TITLES[name], one["start"]["limit"], worst["limit"], worst["time"], worst["rod"], worst["string"], remarks


def _seconds(value: float | None) -> str:
    return "none" if value is None else f"{value:.5g} s"
