"""Quantities that runs record, with their dimensions, units and meanings, and the names along each dimension."""

from __future__ import annotations

import enum

from tensegrity_mj.basics.files import table_beside
from tensegrity_mj.dynamics.native.law import Report
from tensegrity_mj.model.elements.element import state_names
from tensegrity_mj.model.scene import Scene


class Status(enum.Enum):
    """Ways in which a run ends."""

    COMPLETED = "completed"
    INFEASIBLE = "infeasible"  # the control problem had no admissible solution and the caller chose to stop
    DIVERGED = "diverged"
    SINGULAR = "singular"  # the engine's coordinates cannot hold the state that the run came to


Variables = dict[str, tuple[tuple[str, ...], str, str]]


def _table(name: str) -> Variables:
    """A table of `variables.toml`: dimensions, unit and meaning of each quantity."""
    return {key: (tuple(dimensions), unit, meaning) for key, (dimensions, unit, meaning) in _FILE[name].items()}


_FILE = table_beside(__file__)
VARIABLES = _table("variables")
STATES = _table("states")  # additional, of a scene that has what they are of
LOADS = _table("loads")  # additional, where they are wanted
LABELS: dict[str, str] = _FILE["labels"]  # what the names along each dimension are
AXES = ("x", "y", "z")
LAW_REPORTS = tuple(report.name.lower() for report in Report)  # those that are NaN where the law has none
DICTIONARIES = ("cost", "reports", "provenance")  # in the file as JSON


def variables_of(scene: Scene) -> Variables:
    """Quantities that runs of a scene record, as `VARIABLES`."""
    known = {"time", *labels_of(scene)}
    return VARIABLES | {name: one for name, one in STATES.items() if known.issuperset(one[0])}


def labels_of(scene: Scene) -> dict[str, tuple[str, ...]]:
    """The names along each dimension of `variables_of`, but for time."""
    structure, states = scene.structure, state_names(scene)
    constraints = tuple(one.name for one in structure.constraints)
    return {
        "node": tuple(structure.node_names),
        "axis": AXES,
        "string": tuple(string.name for string in structure.strings),
        "rod": tuple(rod.name for rod in structure.rods),
        **({"element_state": states} if states else {}),
        **({"constraint": constraints} if constraints else {}),
    }


def sizes_of(scene: Scene, samples: int) -> dict[str, int]:
    """Lengths of the dimensions of `variables_of`."""
    return {"time": samples, **{dimension: len(labels) for dimension, labels in labels_of(scene).items()}}
