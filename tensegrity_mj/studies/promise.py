"""What `accuracy=` promises, measured: true errors, costs and doubts over many experiments that nothing was tuned to.

Each experiment is drawn from a seed (`promise_experiments`), run with an accuracy, and compared with the truth and with
the cheapest adequate setting of a sweep (`promise_truth`).
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tensegrity_mj.convergence import node_difference
from tensegrity_mj.errors import TensegrityError
from tensegrity_mj.studies.many import Study, run_many
from tensegrity_mj.studies.workers import Workers
from tensegrity_mj.trajectory import Status

DATA, PAGE = "promise.json", "promise.html"
WITHIN, BEYOND, COST, UNSETTLED = 0.95, 3.0, 5.0, 0.05  # what is promised
RESOLVED = 1 / 3  # of the request: what the truth may be wrong by


def measure(point: Mapping[str, Any]) -> dict[str, Any]:
    """One experiment: what was asked, what was told, what is true, and what it cost. The task of `run_many`."""
    import tensegrity_mj as tmj
    from tensegrity_mj.actuation import OnInfeasible
    from tensegrity_mj.engines.run import Request
    from tensegrity_mj.law import native_law
    from tensegrity_mj.studies.promise_experiments import draw
    from tensegrity_mj.studies.promise_truth import cheapest_of, truth_of

    experiment = draw(int(point["seed"]), int(point["number"]))
    scene, asked = experiment.scene, experiment.accuracy
    told: dict[str, Any] = {"experiment": experiment.words, "engine": experiment.engine, "requested": asked}
    engine = getattr(tmj, experiment.engine)(accuracy=asked)
    try:
        run = tmj.simulate(scene, experiment.law, engine, actuation=experiment.actuation)
    except TensegrityError as error:
        return told | {"outcome": "refused", "cause": f"{type(error).__name__}: {error}"}
    report = run.reports["accuracy"]
    told |= {
        "estimate": report["error_estimate"],
        "settled": report["settled"],
        "met": report["met"],
        "reason": report["reason"],
        "chosen": report["chosen"],
        "runs": report["total_cost"]["runs"],
        "work": report["total_cost"]["work"],
        "last_work": report["tried"][-1]["work"],
    }
    if run.status is not Status.COMPLETED:
        return told | {"outcome": "stopped", "cause": run.message}
    try:
        truth = truth_of(experiment, run)
    except TensegrityError as error:
        return told | {"outcome": "no truth", "cause": f"{type(error).__name__}: {error}"}
    told |= {"truth_error": truth.error, "kinks": truth.kinks, "error": node_difference(run, truth.run)}
    told["smooth"] = not truth.kinks and experiment.actuation.period is None
    if not truth.error <= RESOLVED * asked:
        return told | {"outcome": "no truth", "cause": f"two references differ by {truth.error:.2g} m"}
    law = native_law(experiment.law, scene.structure)
    request = Request(scene, law, experiment.actuation, OnInfeasible.STOP, scene.duration, None, False)
    if not report["met"]:
        return told | {"outcome": "measured"}
    cheapest, lucky = cheapest_of(experiment, request, truth, told["work"])
    # Where no setting of the sweep is adequate for the work of this run, it costs no more than the cheapest.
    told |= {"cost_ratio": 1.0, "lucky_ratio": told["work"] / lucky.work if lucky else 1.0}
    if cheapest is not None:
        told |= {
            "cheapest": cheapest.words,
            "cheapest_work": cheapest.work,
            "cheapest_error": cheapest.error,
            "cost_ratio": told["work"] / cheapest.work,
            "timing": {"ratio": run.cost["wall_time"] / max(cheapest.wall_time, 1e-9)},
        }
    return told | {"outcome": "measured"}


@dataclass(frozen=True)
class Promise:
    """The study of the promise.

    Attributes:
        rows: one an experiment, as `measure` returns it, or with outcome "failed".
        seed: of the experiments.
        folder: where it is kept, or None.
    """

    rows: tuple[dict[str, Any], ...]
    seed: int
    folder: Path | None

    @property
    def fractions(self) -> dict[str, Any]:
        """The four promises, each with what it was measured on."""
        known = [row for row in self.rows if row["outcome"] == "measured"]
        smooth = [row for row in known if row["smooth"]]
        met = [row for row in known if row["met"]]
        return {
            "runs": len(self.rows),
            "outcomes": {name: sum(row["outcome"] == name for row in self.rows) for name in OUTCOMES},
            "within": _part(row["error"] <= row["requested"] for row in known),
            "within_if_met": _part(row["error"] <= row["requested"] for row in met),
            "silently_beyond": [row["number"] for row in met if row["error"] > BEYOND * row["requested"]],
            "estimate_below_error": _part(row["estimate"] < row["error"] for row in known if row["settled"]),
            "cost": _ratios(row["cost_ratio"] for row in met),
            "cost_smooth": _ratios(row["cost_ratio"] for row in met if row["smooth"]),
            "cost_of": {
                name: _ratios(row["cost_ratio"] for row in met if row["engine"] == name)
                for name in sorted({row["engine"] for row in met})
            },
            "cost_by_luck": _ratios(row["lucky_ratio"] for row in met),
            "unsettled_smooth": _part(not row["settled"] for row in smooth),
            "unmet": _part(not row["met"] for row in known),
        }

    @property
    def failures(self) -> list[dict[str, Any]]:
        """The experiments that broke a promise, each with why."""
        return [row | {"broken": ", ".join(broken)} for row in self.rows if (broken := _broken(row))]

    @property
    def summary(self) -> list[tuple[str, str]]:
        """The promises in words and numbers."""
        now = self.fractions

        def part(name: str) -> str:
            one = now[name]
            return f"{one['count']} of {one['of']} ({100 * one['fraction']:.1f} %)"

        ended = ", ".join(f"{count} {name}" for name, count in now["outcomes"].items() if count)

        def ratios(one: Mapping[str, Any]) -> str:
            share = f"{one['count']} of {one['of']} ({100 * one['fraction']:.1f} %)"
            return f"{share}; median {one['median']:.3g}, largest {one['largest']:.3g}"

        return [
            ("experiments", f"{now['runs']}, seed {self.seed}: {ended}"),
            ("true error within the request", f"{part('within')}; promised {100 * WITHIN:g} %"),
            ("of those that say that they met it", part("within_if_met")),
            (f"more than {BEYOND:g} times it without saying so", f"{len(now['silently_beyond'])}; promised 0"),
            (f"cost at most {COST:g} times the cheapest adequate", f"{ratios(now['cost'])}; promised of all"),
            ("  of smooth runs", ratios(now["cost_smooth"])),
            *((f"  of {name}", ratios(one)) for name, one in now["cost_of"].items()),
            (f"cost at most {COST:g} times the cheapest, be it by luck", ratios(now["cost_by_luck"])),
            ("smooth runs that did not settle", f"{part('unsettled_smooth')}; promised {100 * UNSETTLED:g} %"),
            ("requests not met, said so", part("unmet")),
        ]

    def to_dict(self) -> dict[str, Any]:
        """Everything, as plain values; what was measured in time is under `timing` alone."""
        return {
            "seed": self.seed,
            "promised": {"within": WITHIN, "beyond": BEYOND, "cost": COST, "unsettled_smooth": UNSETTLED},
            "fractions": self.fractions,
            "failures": [row["number"] for row in self.failures],
            "rows": list(self.rows),
        }


OUTCOMES = ("measured", "stopped", "no truth", "refused", "failed")


def promise(
    runs: int,
    seed: int,
    folder: str | os.PathLike[str] | None = None,
    *,
    workers: Workers | None = None,
    progress: bool = False,
) -> Promise:
    """Measure the promise on `runs` experiments; in a folder, go on where an earlier call stopped.

    Raises:
        OptionError: what `run_many` refuses.
    """
    points = [{"seed": seed, "number": number} for number in range(runs)]
    study = run_many(measure, points, folder, workers=workers, progress=progress, label="promise")
    return Promise(_rows(study), seed, None if folder is None else Path(folder))


def _rows(study: Study) -> tuple[dict[str, Any], ...]:
    rows = []
    for point, outcome in zip(study.points, study.outcomes, strict=True):
        values = outcome.get("values") or {"outcome": "failed", "cause": outcome.get("reason", "")}
        rows.append({"number": point["number"], **values})
    return tuple(rows)


def _broken(row: Mapping[str, Any]) -> list[str]:
    """Which promises one experiment broke."""
    if row["outcome"] == "failed":
        return ["failed"]
    if row["outcome"] != "measured":
        return []
    found = []
    if row["error"] > row["requested"]:
        beyond = "beyond 3 times, silently" if row["met"] and row["error"] > BEYOND * row["requested"] else "beyond"
        found.append(beyond)
    if row["smooth"] and not row["settled"]:
        found.append("unsettled though smooth")
    if row["met"] and row.get("cost_ratio", 0.0) > COST:
        found.append("cost")
    return found


def _ratios(costs: Iterable[float]) -> dict[str, Any]:
    """How many are within `COST`, their median and the largest."""
    known = sorted(costs)
    return {
        **_part(ratio <= COST for ratio in known),
        "median": known[len(known) // 2] if known else math.nan,
        "largest": known[-1] if known else math.nan,
    }


def _part(true: Any) -> dict[str, Any]:
    """How many of how many."""
    found: Sequence[bool] = [bool(one) for one in true]
    count, total = sum(found), len(found)
    return {"count": count, "of": total, "fraction": count / total if total else math.nan}
