"""Measures that a sweep keeps of each run, with units and meanings, and the outcome of a sweep as rows of them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from tensegrity_mj.basics.checks import check_known
from tensegrity_mj.runs.deformation import deformation, is_tower
from tensegrity_mj.runs.judgement import doubts, in_short
from tensegrity_mj.runs.trajectory import Status, Trajectory
from tensegrity_mj.studies.many import Study
from tensegrity_mj.studies.parameter_values import Scaled, decoded
from tensegrity_mj.studies.plain import value_at
from tensegrity_mj.studies.workers import DONE


class Measure(NamedTuple):
    """One number of a run."""

    unit: str
    meaning: str
    of: Callable[[Trajectory], Any]


def _last(values: Any) -> Any:
    return values[-1] if len(values) else None


def _largest(values: Any) -> Any:
    return np.max(values) if values.size else None


def _margin_time(run: Trajectory) -> Any:
    margins = run.feasibility_margin
    return run.time[np.nanargmin(margins)] if np.any(~np.isnan(margins)) else None


def _bent(run: Trajectory, late: bool = False) -> Any:
    """The largest D of a tower; that of the last quarter of the run."""
    if not is_tower(run.scene.structure) or not len(run.time):
        return None
    rows = run.time >= (run.scene.start_time + 0.75 * run.scene.duration if late else 0.0)
    return np.max(deformation(run)[rows]) if rows.any() else None


def _mean_rod_force(run: Trajectory) -> Any:
    return np.mean(run.rod_forces) if run.rod_force_densities.size else None


# Shown unless others are chosen.
USUAL = ("final_error", "max_force_density", "min_margin", "energy_residual")


def _at(part: str, *keys: str) -> Callable[[Trajectory], Any]:
    """Make a function that returns the value at the end of these keys in a run's reports, or in its cost."""
    return lambda run: value_at(getattr(run, part), keys)


_report, _cost = partial(_at, "reports"), partial(_at, "cost")
BELOW = "nonpositive_rest_lengths"  # a report
DOUBTFUL = "in doubt"  # how a completed run counts that something speaks against


LAW = "as the law defines"
MEASURES: dict[str, Measure] = {
    "status": Measure("", "how the run ended", lambda run: run.status.value),
    "message": Measure("", "why it was not completed", lambda run: run.message),
    "end_time": Measure("s", "simulated time that was reached", lambda run: _last(run.time)),
    "final_error": Measure(
        "m", "largest distance of a node from its target at the end", lambda run: _last(run.target_error())
    ),
    "max_force_density": Measure("N/m", "largest u of a string", lambda run: _largest(run.force_densities)),
    "max_tension": Measure("N", "largest tension of a string", lambda run: _largest(run.tensions)),
    "max_compression": Measure(
        "N/m", "largest compressive force density -Jλ/ℓ² of a rod", lambda run: _largest(-run.rod_force_densities)
    ),
    "mean_rod_force": Measure("N", "internal force of rods, their mean over rods and time", _mean_rod_force),
    "deformation": Measure("m", "of a tower: largest D, of the centres between stages from a line", _bent),
    "late_deformation": Measure("m", "the same in the last quarter of the scene's duration", partial(_bent, late=True)),
    "min_margin": Measure(LAW, "smallest feasibility margin", lambda run: run.min_feasibility_margin),
    "min_margin_time": Measure("s", "when the feasibility margin is smallest", _margin_time),
    "final_lyapunov": Measure(LAW, "V at the end", lambda run: _last(run.lyapunov)),
    "decay_error": Measure("", "largest relative error of V against V(0) exp(-δt)", _report("decay_error")),
    "energy_residual": Measure("J", "largest error of the energy balance", lambda run: run.energy_residual),
    "drift": Measure("", "largest error of bᵀb = 1", _report("drift")),
    "nonpositive_rest_lengths": Measure("", "recorded samples with a rest length <= 0", _report(BELOW, "samples")),
    "nonpositive_since": Measure("s", "when the first was, at any step", _report(BELOW, "first_time")),
    "holding_ratio": Measure("", "largest ratio of what holding adds to the load", _report("largest_holding_ratio")),
    "steps": Measure("", "steps of the integrator", _cost("steps")),
    "evaluations": Measure("", "evaluations of the right-hand side", _cost("evaluations")),
    "warnings": Measure("", "what the run warned of", lambda run: list(run.reports.get("warnings", []))),
    "doubts": Measure("", "all that speaks against the run: growth, warnings, limits that were reached", doubts),
}


def measure(run: Trajectory) -> dict[str, Any]:
    """Every measure of a run as a plain value; None where a run has no such thing."""
    return {name: _plain(one.of(run)) for name, one in MEASURES.items()}


def _plain(value: Any) -> Any:
    value = value.item() if isinstance(value, np.generic) else value
    return None if isinstance(value, float) and math.isnan(value) else value


@dataclass(frozen=True)
class Row:
    """One point.

    Attributes:
        parameters: path -> value.
        status: how its run ended, or failed; "in doubt" where it was completed and something speaks against it.
        reason: why it was not completed.
        values: its measures; none where it failed.
    """

    parameters: dict[str, Any]
    status: str
    reason: str
    values: dict[str, Any]


def rows_of(study: Study) -> list[Row]:
    rows = []
    for point, outcome in zip(study.points, study.outcomes, strict=True):
        if outcome["status"] == DONE:
            values = outcome["values"]
            doubtful = values["doubts"] if values["status"] == Status.COMPLETED.value else []
            status = DOUBTFUL if doubtful else values["status"]
            rows.append(Row(point["parameters"], status, values["message"] or in_short(doubtful), values))
        else:
            rows.append(Row(point["parameters"], "failed", f"{outcome['error']}: {outcome['reason']}", {}))
    return rows


def counts(rows: Sequence[Row]) -> dict[str, int]:
    """Count the points by how they ended, without ends that no point has."""
    order = (Status.COMPLETED.value, DOUBTFUL, *(status.value for status in Status), "failed")
    order = tuple(dict.fromkeys(order))
    return {status: count for status in order if (count := sum(row.status == status for row in rows))}


def check_measures(names: Sequence[str]) -> list[str]:
    """Return the names; raise OptionError for one that is no measure."""
    for name in names:
        check_known("measures", name, MEASURES, "measure")
    return list(names)


def as_number(value: Any) -> float | None:
    """A number, or the factor of a scaled value; None for all else."""
    value = decoded(value)
    value = value.factor if isinstance(value, Scaled) else value
    return float(value) if isinstance(value, (int, float)) and not isinstance(value, bool) else None


def shown(value: Any) -> str:
    if isinstance(value, str) and value.startswith("*"):
        return f"×{as_number(value):.6g}"
    if isinstance(value, float):
        return f"{value:.6g}"
    return "-" if value is None else str(value)


def parameter_label(path: str) -> str:
    """Return a path as text, without its `structure.`."""
    return path.removeprefix("structure.")


def measure_label(name: str) -> str:
    """Return a measure's name as text, with its unit."""
    unit = MEASURES[name].unit
    return name.replace("_", " ") + (f" ({unit})" if unit == LAW else f" [{unit}]" if unit else "")
