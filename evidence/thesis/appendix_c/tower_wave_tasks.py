"""The task of §7.2.3's study, the tower in waves: what one run of it gives, plain values in and out.

A point has "tower", arguments of `tower_in_waves` with topology and weights by their values; "engine", "dae" (the
default) or "mujoco", both with the classical Runge-Kutta method; "timestep" [s]; "transient" [s], what is not counted
for the steady measures; and it may have a "disturbance", plain as `disturbance_of` takes it.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from evidence.families.in_waves import tower_in_waves
from evidence.thesis.disturbance import disturbance_of, disturbed
from tensegrity_mj.engines.table import engine_of
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.elements.water import sea_of
from tensegrity_mj.runs.deformation import centres, distances_from_line, interconnections
from tensegrity_mj.runs.trajectory import Status, Trajectory
from tensegrity_mj.simulation import simulate

INTERVAL = 0.02  # s between recorded samples: the largest D of them is low by 3e-4 of itself at most
SNAPSHOTS = 3  # over the last wave period, as figure 7.8


def in_waves(point: dict[str, Any]) -> dict[str, Any]:
    """A case, with the error that the point has, if any, simulated, and how the tower bends."""
    scene = disturbed(tower_in_waves(**point["tower"]), disturbance_of(point.get("disturbance")))
    engine = engine_of(point.get("engine", "dae"), point["timestep"])
    return measured(simulate(scene, None, engine, output_interval=INTERVAL), point["transient"])


def measured(run: Trajectory, transient: float) -> dict[str, Any]:
    """D [m], forces [kN] and where the tower is, of a run that was completed.

    "times" and "nodes" are those of the largest D and of the snapshots.

    Raises:
        OptionError: where the run ends before the transient does, or stopped.
    """
    if run.status is not Status.COMPLETED or run.time[-1] <= transient:
        raise OptionError(
            f"the run ended at {run.time[-1]:g} s ({run.status.value}); {transient:g} s are the transient"
        )
    points = centres(run.nodes, interconnections(run.scene.structure))
    D, steady = distances_from_line(points), run.time > transient
    forces, axis = run.rod_forces, points[:, -1] - points[:, 0]
    rows, worst, structure = _snapshots(run), int(D.max(axis=1).argmax()), run.scene.structure
    return {
        "largest": float(D.max()),
        "at": float(run.time[worst]),
        "where": int(D[worst].argmax()) + 1,
        "steady": float(D[steady].max()),
        "mean_force": float(-forces.mean()) / 1e3,
        "steady_force": float(-forces[steady].mean()) / 1e3,
        "start_force": float(-forces[0].mean()) / 1e3,
        "most_compressed": float(-forces.min()) / 1e3,
        "slack": float(np.mean(run.tensions == 0)),
        "steady_slack": float(np.mean(run.tensions[steady] == 0)),
        "drift": (points[-1].mean(axis=0) - points[0].mean(axis=0)).tolist(),
        "heading": float(np.degrees(np.arctan2(axis[-1, 1], axis[-1, 0]))),
        "length": float(np.linalg.norm(axis[0])),
        "time": run.time.tolist(),
        "D": D.max(axis=1).tolist(),
        "profile": D[steady].max(axis=0).tolist(),
        "height": points[:, :, 2].mean(axis=1).tolist(),
        "period": _period(run),
        "times": run.time[[worst, *rows]].tolist(),
        "nodes": run.nodes[[worst, *rows]].tolist(),
        "rods": structure.rod_nodes.tolist(),
        "strings": structure.string_nodes.tolist(),
        "flow": run.reports.get("water"),
    }


def _period(run: Trajectory) -> float:
    """[s] of the wave; the whole run in still water."""
    sea = sea_of(run.scene)
    return 2 * np.pi / float(sea.frequency.max()) if len(sea.frequency) else float(run.time[-1])


def _snapshots(run: Trajectory) -> list[int]:
    """Recorded times a third of a period apart, the last of them the end."""
    times = run.time[-1] - _period(run) * np.arange(SNAPSHOTS)[::-1] / SNAPSHOTS
    return [int(np.argmin(np.abs(run.time - time))) for time in times]
