"""`study_stability`: everything that `tensegrity-mj stability` finds out about a scene, as plain data."""

from __future__ import annotations

import math
import os
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Any

from tensegrity_mj.basics.checks import member, whole
from tensegrity_mj.basics.fields import function_of
from tensegrity_mj.basics.texts import aligned
from tensegrity_mj.controllers.scenes import SCENE_LAW, law_for
from tensegrity_mj.engines.names import NAMES, TITLES, engine_of, simulates
from tensegrity_mj.errors import OptionError, TensegrityError
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.studies.many import run_study
from tensegrity_mj.studies.stability.cases import AXES, joined_points, map_points, random_points, scene_at_rest
from tensegrity_mj.studies.stability.study import DRAWN, agreement, at_rest, limits_at, summary
from tensegrity_mj.studies.workers import Backend, Workers
from tensegrity_mj.vibration.stable_step import stable_step

MOST_RODS = 500
QUICK_RODS = 20
FINE = 0.1  # of the stable step and of contact's time: the step of the run that a scene with contact is looked along
RANDOM_RODS, QUICK_RANDOM_RODS = 30, 4
JOINED_RODS, QUICK_JOINED_RODS = 12, 4
JOINED_PART = 3  # for so many random taut structures one whose rods share nodes
MAPPED = ("euler", "implicit", "discrete", "rk4")  # engines of the maps: the others have the limits of one of these


@dataclass(frozen=True, eq=False)
class StabilityStudy:
    """Predicted and measured limits of a scene's structure, of its variations, and of random structures.

    Attributes:
        scene: its start and, with a law, a run are looked at; its structure, prestressed and at rest, is measured.
        law: closes the loop in the part about the scene's own motion; the scene's own by default, where it can be
            evaluated at every stage; None for none.
        engines: names from `engine_names.NAMES`.
        maps: axes of `cases.AXES`.
        quick: few values of each axis, maps of at most 20 rods, and random structures of at most 4.
        random: how many random taut structures; a third as many trees and loops of rods come on top.
        seed: of them.
        folder: where finished points are kept, so that an interrupted study goes on; None keeps them in memory.
        workers: who computes points; all cores by default. Results do not depend on it.
        progress: show bars on stderr.

    Raises:
        OptionError: for unknown names, and maps of a structure whose rods share nodes, or without strings.
    """

    scene: Scene
    _: KW_ONLY
    law: Any = SCENE_LAW
    engines: Sequence[str] = NAMES
    maps: Sequence[str] = ()
    quick: bool = False
    random: int = 0
    seed: int = 0
    folder: str | os.PathLike[str] | None = None
    workers: Workers | None = None
    progress: bool = False

    def __call__(self) -> dict[str, Any]:
        scene, engines = self.scene, list(self.engines)
        whole("seed", self.seed, 0)
        unknown = [name for name in engines if name not in NAMES] + [axis for axis in self.maps if axis not in AXES]
        if unknown or not engines:
            raise OptionError(f"stability: '{unknown[0] if unknown else ''}' is none of {', '.join((*NAMES, *AXES))}")
        if self.workers is not None:
            member("workers.backend", self.workers.backend, Backend)
        linked = scene.structure.class_number > 1
        if self.maps and (linked or not scene.structure.strings):
            raise OptionError(
                f"stability: maps vary the strings of structures of class 1; scene '{scene.name}' has "
                f"{'rods that share nodes' if linked else 'no strings'}: leave the maps out"
            )
        law = law_for(scene, self.law)
        if self.law is SCENE_LAW and getattr(law, "discontinuous", None):
            law = None
        measured = [name for name in engines if simulates(name, scene)]
        base, text = scene_at_rest(scene, bool(self.maps))
        data: dict[str, Any] = {
            "scene": scene.name,
            "engines": engines,
            "start": _start(scene, law, engines),
            "base": {
                "text": text,
                "stand_in": base.structure.node_names != scene.structure.node_names,
                "engines": {name: at_rest(base, name) for name in measured},
            },
        }
        if self.maps:
            data["maps"] = self._maps(base)
        if self.random:
            most = QUICK_RANDOM_RODS if self.quick else RANDOM_RODS
            joined = QUICK_JOINED_RODS if self.quick else JOINED_RODS
            data["random"] = self._drawn("random", random_points(self.random, self.seed, most))
            count = math.ceil(self.random / JOINED_PART)
            data["joined"] = self._drawn("joined", joined_points(count, self.seed, joined))
        return data

    def _maps(self, base: Scene) -> list[dict[str, Any]]:
        """The limits along each axis."""
        most = QUICK_RODS if self.quick else MOST_RODS
        points = map_points(base.structure, tuple(self.maps), self.quick, most)
        mapped = [name for name in self.engines if name in MAPPED] or list(self.engines)
        rows = self._limits("maps", "maps", points, mapped)
        keys = ("axis", "value", "values", "reason")
        return [{key: (row["point"] | row)[key] for key in keys} for row in rows]

    def _drawn(self, name: str, points: Sequence[dict[str, Any]]) -> dict[str, Any]:
        """The limits of structures that were drawn at random."""
        rows = self._limits(name, f"{name} structures", points, list(self.engines))
        kept = [row["values"] for row in rows if row["values"] is not None]
        return {"seed": self.seed, "rows": rows, "failed": len(rows) - len(kept), "summary": summary(kept)}

    def _limits(
        self, name: str, label: str, points: Sequence[dict[str, Any]], engines: list[str]
    ) -> list[dict[str, Any]]:
        tasks = [point | {"engines": engines} for point in points]
        place = None if self.folder is None else Path(self.folder) / name
        found = run_study(limits_at, tasks, place, label, {"workers": self.workers, "progress": self.progress})
        return [
            {"point": point, "values": outcome.get("values"), "reason": outcome.get("reason")}
            for point, outcome in zip(points, found.outcomes, strict=True)
        ]


study_stability = function_of(StabilityStudy)


def _start(scene: Scene, law: Any, engines: Sequence[str]) -> dict[str, Any]:
    """Predicted limits at the start, and the smallest along a run: of the DAE in tight tolerances, where it can."""
    from tensegrity_mj.simulation import simulate

    run, reason = None, ""
    try:
        run = simulate(scene, law, _engine_of_run(scene, law))
        if scene.contact is not None:
            reason = f" of {run.engine}, with contact (whose own limit is not among these)"
    except TensegrityError as error:
        reason = f"; no run to look along: {error}"
    found: dict[str, Any] = {}
    for name in engines:
        try:
            here = stable_step(scene, engine_of(name, 1.0), law=law)
            worst = here if run is None else stable_step(scene, engine_of(name, 1.0), law=law, run=run)
        except TensegrityError as error:
            found[name] = {"error": str(error)}
            continue
        found[name] = {"start": here.to_dict(), "worst": worst.to_dict()}
    loop = "in the loop with its law" if law is not None else "without a law"
    return {
        "text": f"Predicted {loop}, at the start and at the worst of 25 configurations along a run{reason}. A moving "
        "state has no limit of its own to measure.",
        "closed_loop": law is not None,
        "engines": found,
    }


def _engine_of_run(scene: Scene, law: Any) -> Any:
    """The DAE; of a scene with contact, which MuJoCo alone has, its RK4 with steps that resolve both it and contact."""
    from tensegrity_mj.engines.mujoco.settings import MuJoCo
    from tensegrity_mj.engines.reference.dae import DAE

    if scene.contact is None:
        return DAE()
    limit = stable_step(scene, MuJoCo(1.0), law=law).limit
    # Limits by contact: 1/√k of its spring and 2/b of its damper.
    contact = min(1 / math.sqrt(scene.contact.stiffness), 2 / max(scene.contact.damping, 1e-12))
    step = FINE * min(limit, contact)
    return MuJoCo(scene.duration / math.ceil(scene.duration / step))


def start_rows(part: Mapping[str, Any]) -> Iterator[tuple[Any, ...]]:
    """Yield for each engine the limits [s] at the start and at the worst, its time [s], rod, string and remarks."""
    for name, one in part["engines"].items():
        if "error" in one:
            yield TITLES[name], None, None, None, "", "", one["error"]
            continue
        worst = one["worst"]
        remarks = "; ".join(worst["notes"])
        yield TITLES[name], one["start"]["limit"], worst["limit"], worst["time"], worst["rod"], worst["string"], remarks


def rest_rows(part: Mapping[str, Any]) -> Iterator[tuple[Any, ...]]:
    """Yield for each engine the limits [s], their ratio, over 2/ω, rod and string, and what explains a difference."""
    for name, one in part["engines"].items():
        over = None if one["predicted"] is None else one["predicted"] * one["omega"] / 2
        rod, string = (f"{one[what]} ({one[f'{what}_share']:.0%})" if one[what] else "" for what in ("rod", "string"))
        yield TITLES[name], one["predicted"], one["measured"], one["ratio"], over, rod, string, one["cause"]


def describe(data: dict[str, Any]) -> list[str]:
    """Return the study as lines of text."""
    rows, failed = [("", "at the start", "worst on the way", "at", "")], []
    for name, first, worst, time, rod, string, remarks in start_rows(data["start"]):
        if time is None:
            failed.append(f"{name}: {remarks}")
        else:
            rows.append((name, _shown(first), _shown(worst), f"{time:.4g} s", f"{rod} on {string}" if string else rod))
    lines = [f"scene {data['scene']}: {data['start']['text']}", *aligned(rows), *failed]
    lines += ["", f"at rest: {data['base']['text']}"]
    rows = [("", "predicted", "measured", "ratio", "over 2/ω")]
    for name, predicted, measured, ratio, over, *_, cause in rest_rows(data["base"]):
        ending = f"{_shown(over, '.4g', '', '-')}  {cause}"
        rows.append((name, _shown(predicted), _shown(measured), _shown(ratio, ".4f", "", "-"), ending))
    lines += aligned(rows)
    if "maps" in data:
        known = [(row["axis"], row["values"]["engines"]) for row in data["maps"] if row["values"]]
        points = [(axis, one) for axis, engines in known for one in engines.values()]
        lines += ["", f"maps: {sum(one['agrees'] for _, one in points)} of {len(points)} points agree within 10 %"]
        causes = Counter((axis, one["cause"]) for axis, one in points if not one["agrees"])
        lines += [f"  {axis}: {count} differ: {cause}" for (axis, cause), count in sorted(causes.items())]
    for name, title in DRAWN.items():
        if name in data:
            part = data[name]
            lines += ["", f"{title} (seed {part['seed']}): {agreement(part)}"]
            lines += [f"  {count} differ: {cause}" for cause, count in part["summary"]["causes"].items()]
            if part["failed"]:
                lines.append(f"  {part['failed']} structures could not be computed (see the data)")
    return lines


def _shown(value: float | None, form: str = ".5g", unit: str = " s", none: str = "none") -> str:
    return none if value is None else f"{value:{form}}{unit}"
