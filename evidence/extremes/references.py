"""References of runs: another formulation of the experiment, at a tighter tolerance, with its own doubt."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import Any

from evidence.extremes.setups import GRAIN, Setup, attempt
from tensegrity_mj.engines.reference.dae import DAE
from tensegrity_mj.engines.reference.method import Method
from tensegrity_mj.engines.reference.ode import ODE
from tensegrity_mj.errors import ControllerError
from tensegrity_mj.runs.convergence import node_difference
from tensegrity_mj.runs.trajectory import Status, Trajectory

TIGHT, LOOSE = 1e-11, 1e-9  # rtol; the second shows how far the first may be off
STIFF_TIGHT, STIFF_LOOSE = 1e-9, 1e-8
MOST_STEPS = 20_000  # of an error-controlled method
FINE = 0.02  # h times the fastest rate, of fixed steps
MOST_FINE_STEPS = 400_000
MOST_TURNS = 3000.0  # [rad] of the fastest vibration: beyond, no method has an answer in that many steps
MANY_RODS = 50  # beyond, some rod is near a pole, and fine steps are dear


@dataclass(frozen=True, eq=False)
class Reference:
    """A run that others are held against.

    Attributes:
        run: the trajectory; it may have stopped where the law has no solution. None where the law returned nonsense,
            which no run may complete.
        doubt: how far it may be off itself [m]: twice its distance from a coarser one.
    """

    run: Trajectory | None
    doubt: float

    @property
    def completed(self) -> bool:
        """True where the run completed."""
        return self.run is not None and self.run.status is Status.COMPLETED


def reference_of(setup: Setup) -> Reference | None:
    """The DAE for MuJoCo and the ODE; for the DAE the ODE, or at a pole or in contact MuJoCo; None if none will do."""
    if not setup.engine.startswith("dae"):
        return tight_dae(setup)
    pairs = _fixed("mujoco", setup)
    if len(setup.experiment.scene.structure.rods) <= MANY_RODS:
        pairs = [*_adaptive(ODE, setup), *_fixed("ode", setup), *pairs]
    return _first(setup, pairs)


def tight_dae(setup: Setup) -> Reference | None:
    """The DAE, error-controlled, or with fine fixed steps where that gives up."""
    return _first(setup, [*_adaptive(DAE, setup), *_fixed("dae", setup)])


def _adaptive(engine: Any, setup: Setup) -> list[tuple[Any, Any]]:
    stiff = setup.pace.decay > 20 * max(setup.pace.vibration, setup.pace.spin)
    method, *tolerances = (Method.RADAU, STIFF_TIGHT, STIFF_LOOSE) if stiff else (Method.DOP853, TIGHT, LOOSE)
    tight, loose = (engine(method=method, rtol=r, atol=1e-2 * r, max_steps=MOST_STEPS) for r in tolerances)
    return [(tight, loose)]


def _fixed(family: str, setup: Setup) -> list[tuple[Any, Any]]:
    rate = setup.rate + setup.pace.decay + setup.pace.vibration
    fineness = FINE if len(setup.experiment.scene.structure.rods) <= MANY_RODS else 5 * FINE
    steps = GRAIN * math.ceil(setup.duration * rate / fineness / GRAIN)
    if steps > MOST_FINE_STEPS:
        return []
    fine = setup.duration / steps
    scene = setup.experiment.scene
    # Of steps that are not split where strings go slack, two may be wrong by nearly the same.
    located = scene.contact is None
    if family == "mujoco":
        from tensegrity_mj.engines.mujoco.settings import MuJoCo

        return [(MuJoCo(fine, locate_slack=located), MuJoCo(2 * fine, locate_slack=located))]
    make: Any = partial(DAE if family == "dae" else ODE, method=Method.RK4, locate_slack=located)
    return [(make(timestep=fine), make(timestep=2 * fine))]


def _first(setup: Setup, pairs: list[tuple[Any, Any]]) -> Reference | None:
    if setup.duration * setup.rate > MOST_TURNS:
        return None
    for tight, loose in pairs:
        best = attempt(setup, tight)
        if isinstance(best.error, ControllerError):
            return Reference(None, 0.0)
        if best.run is None or best.run.status is Status.SINGULAR:
            continue
        if best.run.status is Status.INFEASIBLE:  # fixed steps might step over the moment
            return Reference(best.run, 0.0)
        other = attempt(setup, loose)
        doubt = 2 * node_difference(best.run, other.run) if other.run is not None else math.inf
        return Reference(best.run, doubt)
    return None
