"""Runs that go on from where another ended: what is saved of its last whole step, and put back.

`provenance["end"]` of a run has, exactly, the engine's coordinates, what the winches and the law held, what elements
and strings that yield remember, and the ledger. Steps, samples, breaks, loads and motions go on by the run's own time.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.controllers.degraded import Delayed
from tensegrity_mj.dynamics.native.views import Table
from tensegrity_mj.errors import OptionError, SceneError
from tensegrity_mj.model.capabilities import CONTACT, ELEMENT_STATES, YIELDING
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.runs.recorded import parts_of, texts_of
from tensegrity_mj.runs.trajectory import Status, Trajectory

OF_STRINGS = ("held", "memory", "permanent", "last_stretch", "broken", "sampled_lengths")
ARRAYS = (*OF_STRINGS, "element_states", "winch", "held_mass", "report")
NUMBERS = ("yielded_at", "breaking", "suspended", "holds_force_density")


@dataclass(frozen=True)
class Start:
    """State from which a run goes on.

    Attributes:
        time: [s].
        parts: what `saved_state` has saved, by names.
    """

    time: float
    parts: Mapping[str, Array]

    def put_back(self, plant: Table, **own: Array) -> None:
        """Set a plant and an engine's own arrays to what they were.

        Raises:
            OptionError: where they are of another size.
        """
        numbers = {name: np.zeros(1) for name in NUMBERS}
        for name, target in {**{name: plant[name] for name in ARRAYS}, **own, **numbers}.items():
            part = self.parts.get(name, ())
            if target.size != len(part):
                raise OptionError(
                    f"the run to go on from has {len(part)} numbers of {name}, and this one {target.size}: "
                    "go on with the same scene, supports, elements and solver"
                )
            target.flat[:] = part
        for name, (number,) in numbers.items():
            plant[name] = type(plant[name])(number)


def saved_state(engine: Any, plant: Table, **own: Array) -> dict[str, Any]:
    """Encode as texts the state that `Start` puts back."""
    parts = {**{name: plant[name] for name in ARRAYS}, **own, **{name: [plant[name]] for name in NUMBERS}}
    return texts_of(_kind(engine), parts)


def start_of(run: Trajectory, engine: Any, law: Any) -> Start:
    """Read the state from which an engine is to continue a run.

    Raises:
        OptionError: for another engine, and laws that keep states.
    """
    end = run.provenance["end"]
    parts = parts_of(end, "the run to go on from")
    if end["engine"] != _kind(engine) or getattr(engine, "locate_slack", False):
        raise OptionError(f"engine = {engine}: the run to go on from is of {run.engine}: use that engine")
    while law is not None:
        if isinstance(law, Delayed):
            raise OptionError("the law Delayed keeps what it measured before, which no run records: leave it out")
        law = getattr(law, "law", None)
    return Start(float(run.time[-1]), parts)


def scene_at_end(run: Trajectory) -> Scene:
    """Return the scene to go on with: the run's, or one that starts at its last sample if it kept no state of its end.

    Raises:
        OptionError: for a run that ended early, and where its samples do not have all of the state.
    """
    scene, had = run.scene, run.provenance
    if run.status is Status.COMPLETED and had.get("end") is not None:
        return scene
    mode, passive = (had.get("actuation") or {}).get("mode", "continuous"), had.get("on_infeasible") == "passive"
    lost = [trait.find(scene) for trait in (CONTACT, YIELDING, ELEMENT_STATES)]
    lost += [f"it ended early ({run.status.value})" if run.status is not Status.COMPLETED else ""]
    lost += [f"winches hold the last command (actuation {mode})" if mode != "continuous" else ""]
    lost += ["rest lengths may be held (on_infeasible passive)" if passive and had.get("controller") else ""]
    begin = {"start_time": run.time[-1], "initial_nodes": run.nodes[-1], "initial_velocities": run.velocities[-1]}
    try:
        if any(lost):
            raise SceneError(next(filter(None, lost)))
        return scene.with_(**begin)
    except SceneError as error:
        raise OptionError(
            f"the run of {run.engine} cannot be continued from {run.time[-1]:.9g} s: {error}; the whole state is saved "
            "of the end of runs by MuJoCo, and by RK4 of DAE and ODE, without locate_slack, accuracy, or many at once: "
            "end a run there (its duration), and continue from its end"
        ) from None


def _kind(engine: Any) -> str:
    """An engine, and what decides its coordinates."""
    return " ".join([engine.descriptor.title, *(one.value for one in (getattr(engine, "solver", None),) if one)])
