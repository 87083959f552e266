"""Task of the report: one run, a point of plain values in, its measures out. A run that ends early is a result, too."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from tensegrity_mj.controllers import specs
from tensegrity_mj.controllers.degraded import Delayed, Noisy
from tensegrity_mj.controllers.gains import Gains
from tensegrity_mj.dynamics.native.law import native_law
from tensegrity_mj.errors import DivergenceError, SceneError
from tensegrity_mj.model.actuation import Actuation, Mode
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.runs.trajectory import Trajectory
from tensegrity_mj.simulation import simulate
from tensegrity_mj.studies.known_elements import scene_of
from tensegrity_mj.studies.nominal import NominalWinches
from tensegrity_mj.studies.parameters import Draft
from tensegrity_mj.studies.validation import measures

ROWS = 64 * 2**20  # bytes of recorded rows at most
TICK = 0.01  # s: what control periods, durations and break times are multiples or parts of
REFUSED = "refused"  # the status of a start that the scene does not admit
KEPT = 100  # times at which nodes are kept for comparison, as well as the start

# Values that a point may hold in addition to its engine; absent means nominal.
DEFAULTS: dict[str, Any] = {
    "engine_options": {},
    "mode": Mode.CONTINUOUS.value,
    "period": None,
    "law": None,  # another law than the one under test
    "gain": None,  # [X, Y, Z or decay_rate, factor]
    "settings": {},  # parameters of `studies.parameters`, of the plant
    "known_gravity": None,  # what the law believes in, where it is not the scene's
    "noise": None,  # [m, m/s, seed]
    "delay": 0,  # samples
    "nodes": None,  # (N, 3): another start
    "keep_nodes": False,
}


def run_point(point: dict[str, Any]) -> dict[str, Any]:
    """The task: simulate one point and measure it.

    Args:
        point: `scene` (TOML), `spec` of the law, `duration` [s], `timestep` [s], `engine`, and any of `DEFAULTS`.
    """
    case = DEFAULTS | point
    nominal = scene_of(case["scene"])
    draft = Draft(nominal, engine=case["engine"], engine_options=dict(case["engine_options"]))
    draft.apply(case["settings"])
    plant = draft.plant or draft.scene
    law = specs.make(case["law"] or case["spec"], nominal)
    if case["gain"] is not None:
        law = with_gain(law, nominal, *case["gain"])
    if case["known_gravity"] is not None:
        law = dataclasses.replace(law, gravity=tuple(case["known_gravity"]))
    if case["nodes"] is not None:
        try:
            plant = plant.with_(initial_nodes=np.array(case["nodes"]), initial_velocities=None)
        except SceneError as error:
            return {"status": REFUSED, "message": str(error), "end_time": 0.0}
    # The law promises nothing for another plant.
    promised = None if case["settings"] else native_law(law, nominal.structure).decay_rate
    floor = getattr(law, "minimum_force_density", 0.0)
    law = NominalWinches.between(law, nominal.structure, plant.structure)
    period = case["period"]
    if case["noise"] is not None:
        position, velocity, seed = case["noise"]
        law = Noisy(law, position, velocity, seed, period)
    if case["delay"]:
        law = Delayed(law, case["delay"], period)
    try:
        run = simulate(
            plant,
            law,
            draft.make_engine(),
            duration=case["duration"],
            actuation=Actuation(Mode(case["mode"]), period),
            output_interval=recording_interval(plant, period or case["timestep"], case["duration"]),
        )
    except DivergenceError as error:
        return {"status": "diverged", "message": str(error), "end_time": error.time}
    values = measures.of_run(run, promised, floor, known_plant=not case["settings"])
    if case["keep_nodes"]:
        values["kept"] = kept_nodes(run, case["duration"])
    return values


def recording_interval(scene: Scene, base: float, duration: float) -> float:
    """The least multiple of `base` that divides `TICK` and keeps rows within `ROWS`; else the larger of both."""
    width = 6 * len(scene.structure.nodes) + 3 * len(scene.structure.strings) + len(scene.structure.rods) + 8
    whole = round(TICK / base) if base < TICK else 1
    for factor in range(1, whole + 1):
        if whole % factor == 0 and 8.0 * width * duration / (factor * base) <= ROWS:
            return factor * base
    return whole * base


def kept_nodes(run: Trajectory, duration: float) -> dict[str, Any]:
    """Nodes, target error, V, margin and the largest u at times that all runs of one duration record."""
    step = TICK * max(1, math.ceil(round(duration / TICK) / KEPT))
    wanted = np.arange(0, math.floor(run.time[-1] / step + 1e-6) + 1) * step
    rows = np.clip(np.searchsorted(run.time, wanted - 1e-6), 0, len(run.time) - 1)
    good = np.abs(run.time[rows] - wanted) < 1e-6
    rows = rows[good]
    return {
        "times": wanted[good].tolist(),
        "nodes": run.nodes[rows].tolist(),
        "error": run.target_error()[rows].tolist(),
        "lyapunov": run.lyapunov[rows].tolist(),
        "margin": run.feasibility_margin[rows].tolist(),
        "force_density": run.force_densities[rows].max(axis=1, initial=0.0).tolist(),
    }


def with_gain(law: Any, scene: Scene, gain: str, factor: float) -> Any:
    """The law with one of X, Y, Z of all rods, or its decay rate, times a factor.

    Raises:
        OptionError: if gains so scaled are not positive definite.
    """
    if gain == "decay_rate":
        return dataclasses.replace(law, decay_rate=law.decay_rate * factor)
    names = [rod.name for rod in scene.structure.rods] + [point.node for point in scene.structure.lone_masses]

    def scaled(given: Any) -> Any:
        every = given if isinstance(given, Mapping) else dict.fromkeys(names, given)
        own = {name: every.get(name, Gains()) for name in names}
        return {
            name: dataclasses.replace(g, **{gain: np.asarray(getattr(g, gain)) * factor}) for name, g in own.items()
        }

    return dataclasses.replace(law, translation=scaled(law.translation), rotation=scaled(law.rotation))
