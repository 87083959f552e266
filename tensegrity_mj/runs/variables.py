"""What runs record: the quantities with their dimensions, units and meanings, and the names along each dimension."""

from __future__ import annotations

import enum

from tensegrity_mj.dynamics.native.law import Report
from tensegrity_mj.model.elements.element import state_names
from tensegrity_mj.model.scene import Scene


class Status(enum.Enum):
    """How a run ended."""

    COMPLETED = "completed"
    INFEASIBLE = "infeasible"  # the control problem had no admissible solution and the caller chose to stop
    DIVERGED = "diverged"
    SINGULAR = "singular"  # the engine's coordinates cannot hold the state that the run came to


# Every recorded quantity: dimensions, unit, meaning. One table for the class, the file and the docs.
VARIABLES: dict[str, tuple[tuple[str, ...], str, str]] = {
    "time": (("time",), "s", "simulated time"),
    "nodes": (("time", "node", "axis"), "m", "node positions, world frame"),
    "velocities": (("time", "node", "axis"), "m/s", "node velocities, world frame"),
    "force_densities": (("time", "string"), "N/m", "u: elastic force density of the strings"),
    "rest_lengths": (("time", "string"), "m", "L0: rest lengths of the strings"),
    "tensions": (("time", "string"), "N", "tension of the strings, damping included"),
    "multipliers": (("time", "rod"), "1/s2", "λ of (2.31)"),
    "rod_force_densities": (("time", "rod"), "N/m", "J λ / ℓ²; negative in compression"),
    "kinetic_energy": (("time",), "J", "kinetic energy"),
    "gravity_energy": (("time",), "J", "potential energy of gravity"),
    "string_energy": (("time",), "J", "elastic energy of the strings"),
    "winch_work": (("time",), "J", "-∫ T dL0, T the elastic tension: work of the winches on the strings"),
    "external_work": (("time",), "J", "work of external nodal forces, contact, moved supports, wind and water"),
    "dissipation": (("time",), "J", "energy taken by the strings' dampers and by what resists motion"),
    "feasibility_margin": (("time",), "m2 or as the law defines", "max(v/α) of (5.18); NaN without such a law"),
    "lyapunov": (("time",), "as the law defines", "V of (5.3); NaN without such a law"),
    "lyapunov_error": (("time",), "as the law defines", "terms of V in the errors alone; NaN without such a law"),
    "lyapunov_velocity": (("time",), "as the law defines", "terms of V with velocities; NaN without such a law"),
    "allocation_residual": (
        ("time",),
        "as the law defines",
        "largest violation of what a law with an optimal allocation required of the strings; NaN without such a law",
    ),
}
# Besides, of a scene whose elements have states.
STATES: dict[str, tuple[tuple[str, ...], str, str]] = {
    "element_states": (("time", "element_state"), "as the elements define", "states of the elements, in their order"),
}
AXES = ("x", "y", "z")
LAW_REPORTS = tuple(report.name.lower() for report in Report)  # those that are NaN where the law has none
DICTIONARIES = ("cost", "reports", "provenance")  # in the file as JSON


def variables_of(scene: Scene) -> dict[str, tuple[tuple[str, ...], str, str]]:
    """What runs of a scene have recorded, as `VARIABLES`."""
    return VARIABLES | (STATES if state_names(scene) else {})


def labels_of(scene: Scene) -> dict[str, tuple[str, ...]]:
    """The names along each dimension of `variables_of`, but for time."""
    structure, states = scene.structure, state_names(scene)
    return {
        "node": tuple(structure.node_names),
        "axis": AXES,
        "string": tuple(string.name for string in structure.strings),
        "rod": tuple(rod.name for rod in structure.rods),
        **({"element_state": states} if states else {}),
    }


def sizes_of(scene: Scene, samples: int) -> dict[str, int]:
    """Lengths of the dimensions of `variables_of`."""
    return {"time": samples, **{dimension: len(labels) for dimension, labels in labels_of(scene).items()}}
