"""Check of `accuracy=`: true errors, costs and doubts over many experiments that nothing was tuned to.

Each experiment is drawn from a seed (`promise_experiments`), run with an accuracy, and compared with the truth and with
the cheapest adequate setting of a sweep (`promise_truth`).
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np

from evidence.promise.experiments import Kind
from tensegrity_mj.basics.checks import whole
from tensegrity_mj.errors import TensegrityError
from tensegrity_mj.pictures.figure import frame, new_figure
from tensegrity_mj.pictures.findings import Finding, Judgement, Mark
from tensegrity_mj.pictures.page import Picture, Table, pictures_and_tables
from tensegrity_mj.runs.convergence import node_difference, way_of
from tensegrity_mj.runs.trajectory import Status
from tensegrity_mj.studies.many import RunOptions, run_study
from tensegrity_mj.studies.report import Page, Report

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Values = Mapping[str, Any]

WITHIN, BEYOND = 0.995, 3.0  # what is promised: the part that is within the request, and that none is so far beyond
UNKNOWN = 0.05  # most of the experiments may have references that differ
IDLE = 10.0  # a run that moves by less than so many times its request is no trial of it
COSTED = 8  # one of so many experiments is swept for its cheapest setting, which takes longer than all the rest
COLUMNS = {
    "number": "",
    "experiment": "experiment",
    "engine": "engine",
    "requested": "requested [m]",
    "estimate": "estimate [m]",
    "error": "true error [m]",
    "settled": "settled",
    "cost_ratio": "evaluations over the cheapest adequate",
    "lucky_ratio": "even by chance",
    "outcome": "outcome",
}


def measure(point: Mapping[str, Any]) -> dict[str, Any]:
    """Measure one experiment: request, report, truth and cost. The task of `run_many`."""
    from evidence.promise.experiments import ENGINES, draw
    from evidence.promise.truth import RESOLVED, cheapest_of, truth_of
    from tensegrity_mj.dynamics.native.law import native_law
    from tensegrity_mj.engines.accuracy.ladder import WEIGHTS
    from tensegrity_mj.engines.request import Request
    from tensegrity_mj.engines.table import make_engine
    from tensegrity_mj.model.actuation import OnInfeasible
    from tensegrity_mj.simulation import simulate

    number = int(point["number"])
    experiment = draw(int(point["seed"]), number, Kind(point["kind"]))
    scene, requested = experiment.scene, experiment.accuracy
    row: dict[str, Any] = {"experiment": experiment.description, "engine": experiment.engine, "requested": requested}
    engine = make_engine(experiment.engine.lower(), {"accuracy": requested})
    try:
        run = simulate(scene, experiment.law, engine, actuation=experiment.actuation)
    except TensegrityError as error:
        return row | {"outcome": "refused", "cause": f"{type(error).__name__}: {error}"}
    report = run.reports["accuracy"]
    weighed = sum(WEIGHTS.get(one["method"], 1.0) * one["evaluations"] for one in report["tried"])
    row |= {
        "estimate": report["error_estimate"],
        "settled": report["settled"],
        "met": report["met"],
        "reason": report["reason"],
        "chosen": report["chosen"],
        "runs": report["total_cost"]["runs"],
        "evaluations": weighed,
        "moved": way_of(run.nodes),
    }
    if run.status is not Status.COMPLETED:
        return row | {"outcome": "stopped", "cause": run.message}
    law = native_law(experiment.law, scene.structure)
    request = Request(scene, law, experiment.actuation, OnInfeasible.STOP, scene.duration, None, False)
    try:
        truth = truth_of(experiment, request, run)
    except TensegrityError as error:
        return row | {"outcome": "no truth", "cause": f"{type(error).__name__}: {error}"}
    row |= {"truth_error": truth.error, "kinks": truth.kinks, "error": node_difference(run, truth.run)}
    row["smooth"] = not truth.kinks and experiment.actuation.period is None
    if not truth.error <= RESOLVED * requested:
        return row | {"outcome": "no truth", "cause": f"two references differ by {truth.error:.2g} m"}
    if not report["met"] or number // len(ENGINES) % COSTED:
        return row | {"outcome": "measured"}
    cheapest, lucky = cheapest_of(experiment, request, truth, row["evaluations"])
    # Where no setting of the sweep is adequate for the cost of this run, it costs no more than the cheapest.
    row |= {"cost_ratio": 1.0, "lucky_ratio": row["evaluations"] / lucky.evaluations if lucky else 1.0}
    if cheapest is not None:
        row |= {
            "cheapest": cheapest.description,
            "cheapest_evaluations": cheapest.evaluations,
            "cheapest_error": cheapest.error,
            "cost_ratio": row["evaluations"] / cheapest.evaluations,
        }
    return row | {"outcome": "measured"}


@dataclass(frozen=True, eq=False)
class Promise(Report):
    """The study of the promise; `rows` of its data are one an experiment, as `measure` returns it, or "failed"."""

    NAME = "promise"

    @classmethod
    def of(cls, rows: Sequence[Values], seed: int, kind: Kind = Kind.RANDOM) -> Promise:
        """The study of experiments' rows, with the seed of these and what they were drawn from."""
        data = {
            "seed": seed,
            "kind": kind.value,
            "promised": {"within": WITHIN, "beyond": BEYOND, "unknown": UNKNOWN},
            "fractions": fractions(rows),
            "failures": [row["number"] for row in rows if _broken(row)],
            "rows": list(rows),
        }
        return cls(data)

    @property
    def failures(self) -> list[dict[str, Any]]:
        """The experiments that broke a promise, each with why."""
        return [row | {"broken": ", ".join(broken)} for row in self.data["rows"] if (broken := _broken(row))]

    @property
    def summary(self) -> list[tuple[str, str, Mark | None]]:
        """The promises in words and numbers, each with what it means where there is an aim."""
        now = self.data["fractions"]

        def part(name: str) -> str:
            one = now[name]
            return f"{one['count']} of {one['of']} ({100 * one['fraction']:.1f} %)"

        ended = ", ".join(f"{count} {name}" for name, count in now["outcomes"].items() if count)

        def ratios(one: Mapping[str, Any]) -> str:
            median, most, largest = (f"{one[name]:.3g}" for name in ("median", "most", "largest"))
            return f"median {median}, 95 % within {most}, largest {largest}, of {one['of']}"

        def mark(kept: bool, otherwise: Mark = Mark.LIMITED) -> Mark:
            return Mark.GOOD if kept else otherwise

        known = mark(now["no_truth"]["count"] <= UNKNOWN * now["runs"])
        met = now["within_if_met"]
        within = mark(met["count"] >= WITHIN * met["of"], Mark.BAD) if met["of"] else Mark.LIMITED
        failed = Mark.BAD if now["outcomes"].get("failed") else None
        silent = len(now["silently_beyond"])
        return [
            ("experiments", f"{now['runs']}, seed {self.data['seed']}: {ended}", failed),
            ("of which two references differ", f"{part('no_truth')}; at most {100 * UNKNOWN:g} %", known),
            (f"moved less than {IDLE:g} times the request", part("idle"), None),
            ("true error within the request, where met", f"{part('within_if_met')}; aim {100 * WITHIN:g} %", within),
            ("the same, runs that did not meet it included", part("within"), None),
            (f"more than {BEYOND:g} times it, reported as met", f"{silent}; aim 0", mark(not silent, Mark.BAD)),
            ("evaluations over the cheapest adequate setting", ratios(now["cost"]), None),
            *((f"  of {name}", ratios(one), None) for name, one in now["cost_of"].items()),
            ("evaluations over the cheapest, be it by luck", ratios(now["cost_by_luck"]), None),
            ("smooth runs that did not settle", part("unsettled_smooth"), mark(not now["unsettled_smooth"]["count"])),
            ("requests not met, reported so", part("unmet"), mark(not now["unmet"]["count"])),
        ]

    @property
    def judgement(self) -> Judgement:
        """Judgement of how often the promise was kept, and a finding for each line of the summary."""
        kept, cost = self.data["fractions"]["within_if_met"], self.data["fractions"]["cost"]["median"]
        verdict = f"None of {len(self.data['rows'])} experiments reported its accuracy as met."
        if kept["of"]:
            verdict = (
                f"{kept['count']} of {kept['of']} accuracies reported as met were met, at a median of {cost:.3g} times "
                "the evaluations of the cheapest setting that would have done."
            )
        return Judgement(verdict, tuple(Finding(mark, text, name) for name, text, mark in self.summary))

    def page(self) -> Page:
        """The promises, those that were broken, and every experiment."""
        data, rows = self.data, self.data["rows"]
        which = ("number", "broken", "experiment", "engine")
        failures = [[*(row.get(name, "") for name in which), *_why(row)] for row in self.failures]
        silent = [[row["number"], row["outcome"], row.get("cause", "")] for row in rows if row.get("cause")]
        broken = ["", "which", "experiment", "engine", "requested, true [m]", "cost", "why"]
        pictures = [
            Picture(_errors(rows), "True error and estimate against what was requested."),
            Picture(_costs(rows), "Evaluations of all runs, over those of the cheapest adequate setting."),
        ]
        tables = [
            Table("The promise", ["", ""], [line[:2] for line in self.summary]),
            Table("Promises broken", broken, failures),
            Table("Not measured", ["", "outcome", "cause"], silent),
            Table.of("All experiments", COLUMNS, rows, folded=True),
        ]
        title, introduction = "What an accuracy promises, measured", f"Experiments drawn with seed {data['seed']}."
        sections = pictures_and_tables(pictures, [table for table in tables if table.rows])
        return Page(title, introduction, self.judgement, sections)


OUTCOMES = ("measured", "stopped", "no truth", "refused", "failed")


def fractions(rows: Sequence[Values]) -> dict[str, Any]:
    """The four promises, each with what it was measured on."""
    known = [row for row in rows if row["outcome"] == "measured"]
    smooth = [row for row in known if row["smooth"]]
    met = [row for row in known if row["met"]]
    return {
        "runs": len(rows),
        "outcomes": {name: sum(row["outcome"] == name for row in rows) for name in OUTCOMES},
        "within": _part(row["error"] <= row["requested"] for row in known),
        "within_if_met": _part(row["error"] <= row["requested"] for row in met),
        "silently_beyond": [row["number"] for row in met if row["error"] > BEYOND * row["requested"]],
        "estimate_below_error": _part(row["estimate"] < row["error"] for row in known if row["settled"]),
        "cost": _ratios(row["cost_ratio"] for row in met if "cost_ratio" in row),
        "cost_of": {
            name: _ratios(row["cost_ratio"] for row in met if row["engine"] == name and "cost_ratio" in row)
            for name in sorted({row["engine"] for row in met})
        },
        "cost_by_luck": _ratios(row["lucky_ratio"] for row in met if "lucky_ratio" in row),
        "unsettled_smooth": _part(not row["settled"] for row in smooth),
        "unmet": _part(not row["met"] for row in known),
        "idle": _part(row["moved"] <= IDLE * row["requested"] for row in known),
        "no_truth": _part(row["outcome"] == "no truth" for row in rows),
    }


def promise(
    runs: int,
    seed: int,
    folder: str | os.PathLike[str] | None = None,
    *,
    kind: Kind = Kind.RANDOM,
    **how: Unpack[RunOptions],
) -> Promise:
    """Measure the promise on `runs` experiments; in a folder, go on where an earlier call stopped.

    `how` has workers and progress, see `run_many`.

    Raises:
        OptionError: for options out of range, and what `run_many` refuses.
    """
    runs, seed = whole("runs", runs, 1), whole("seed", seed, 0)
    points = [{"seed": seed, "number": number, "kind": kind.value} for number in range(runs)]
    study = run_study(measure, points, folder, "promise", how)
    rows = study.rows(lambda outcome: {"outcome": "failed", "cause": outcome["reason"]})
    return Promise.of([{"number": number, **row} for number, row in enumerate(rows)], seed, kind).kept(folder)


def _broken(row: Mapping[str, Any]) -> list[str]:
    """Name the promises that one experiment broke."""
    if row["outcome"] == "failed":
        return ["failed"]
    if row["outcome"] != "measured":
        return []
    found = []
    if row["error"] > row["requested"]:
        beyond = (
            "beyond 3 times, reported as met" if row["met"] and row["error"] > BEYOND * row["requested"] else "beyond"
        )
        found.append(beyond)
    if row["smooth"] and not row["settled"]:
        found.append("unsettled though smooth")
    return found


def _ratios(costs: Iterable[float]) -> dict[str, Any]:
    """Return the number of costs, their median, what 95 % are within, and the largest."""
    known = list(costs)
    median, most, largest = np.quantile(known or [math.nan], (0.5, 0.95, 1.0), method="higher").tolist()
    return {"of": len(known), "median": median, "most": most, "largest": largest}


def _part(true: Any) -> dict[str, Any]:
    """Count how many of how many are true."""
    found: Sequence[bool] = [bool(one) for one in true]
    count, total = sum(found), len(found)
    return {"count": count, "of": total, "fraction": count / total if total else math.nan}


def _why(row: Values) -> list[Any]:
    if "error" not in row:
        return ["", "", row.get("cause", "")]
    return [f"{row['requested']:.1e}, {row['error']:.1e}", row.get("cost_ratio"), row["reason"]]


def _errors(all_rows: Sequence[Values]) -> Figure:
    figure = new_figure(6.5, 4.5)
    axes = figure.add_subplot()
    for settled, colour, label in ((True, "tab:blue", "settled"), (False, "tab:red", "not settled")):
        rows = [row for row in all_rows if row["outcome"] == "measured" and row["settled"] is settled]
        requested = [row["requested"] for row in rows]
        axes.loglog(requested, [row["error"] or 1e-17 for row in rows], "o", color=colour, ms=4, label=f"true, {label}")
        axes.loglog(requested, [row["estimate"] for row in rows], "_", color=colour, ms=7, label=f"estimate, {label}")
    ends = [1e-10, 1e-2]
    axes.loglog(ends, ends, "k-", lw=0.8, label="requested")
    axes.loglog(ends, [3 * end for end in ends], "k:", lw=0.8, label="three times that")
    frame(axes, "", "requested [m]", "largest node error [m]")
    return figure


def _costs(all_rows: Sequence[Values]) -> Figure:
    figure = new_figure(6.5, 4.0)
    axes = figure.add_subplot()
    for engine in sorted({row["engine"] for row in all_rows if "engine" in row}):
        rows = [row for row in all_rows if row.get("engine") == engine and "cost_ratio" in row and row["met"]]
        axes.loglog([row["requested"] for row in rows], [row["cost_ratio"] for row in rows], "o", ms=4, label=engine)
    frame(axes, "", "requested [m]", "cost over the cheapest")
    return figure
