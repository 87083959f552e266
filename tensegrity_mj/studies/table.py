"""A sweep's outcome as rows: parameters, how it ended, measures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from tensegrity_mj.errors import OptionError
from tensegrity_mj.runs.trajectory import Status
from tensegrity_mj.studies.attempt import DONE
from tensegrity_mj.studies.many import Study
from tensegrity_mj.studies.measures import MEASURES
from tensegrity_mj.studies.parameter_values import Scaled, decoded


@dataclass(frozen=True)
class Row:
    """One point.

    Attributes:
        parameters: path -> value.
        status: how its run ended, or failed.
        reason: why it was not completed.
        values: its measures; none where it failed.
    """

    parameters: dict[str, Any]
    status: str
    reason: str
    values: dict[str, Any]


def rows_of(study: Study) -> list[Row]:
    """The rows of a sweep's study."""
    rows = []
    for point, outcome in zip(study.points, study.outcomes, strict=True):
        if outcome["status"] == DONE:
            values = outcome["values"]
            rows.append(Row(point["parameters"], values["status"], values["message"], values))
        else:
            rows.append(Row(point["parameters"], "failed", f"{outcome['error']}: {outcome['reason']}", {}))
    return rows


def counts(rows: Sequence[Row]) -> dict[str, int]:
    """How many points ended how, those that there are."""
    order = (*(status.value for status in Status), "failed")
    return {status: count for status in order if (count := sum(row.status == status for row in rows))}


def check_measures(names: Sequence[str]) -> list[str]:
    """The names.

    Raises:
        OptionError: for one that is no measure.
    """
    for name in names:
        if name not in MEASURES:
            raise OptionError(f"there is no measure '{name}'; allowed: {', '.join(MEASURES)}")
    return list(names)


def as_number(value: Any) -> float | None:
    """A number, or the factor of a scaled value; None for all else."""
    value = decoded(value)
    value = value.factor if isinstance(value, Scaled) else value
    return float(value) if isinstance(value, (int, float)) and not isinstance(value, bool) else None


def shown(value: Any) -> str:
    """A value for people."""
    if isinstance(value, str) and value.startswith("*"):
        return f"×{as_number(value):.6g}"
    if isinstance(value, float):
        return f"{value:.6g}"
    return "-" if value is None else str(value)


def parameter_label(path: str) -> str:
    """A path for people: what is clear without it is left out."""
    return path.removeprefix("structure.")


def measure_label(name: str) -> str:
    """A measure for people, with its unit."""
    unit = MEASURES[name].unit
    return name.replace("_", " ") + (f" [{unit}]" if unit else "")
