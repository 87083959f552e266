"""MuJoCo with an accuracy: which of its integrators are tried."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from tensegrity_mj.engines.accuracy.ladder import Ladder
from tensegrity_mj.engines.accuracy.rates import Rates, rates_at_start
from tensegrity_mj.engines.accuracy.search import find, fixed_steps
from tensegrity_mj.engines.mujoco.settings import Integrator
from tensegrity_mj.engines.request import Request
from tensegrity_mj.model.forest import spanning_forest
from tensegrity_mj.runs.trajectory import Trajectory

# `discrete`, `implicit` and `euler` are not tried. The first damps vibrations away that it does not resolve, at any two
# steps alike, so that two runs agree on what is wrong; the second differs from `implicitfast` by a part of the dampers'
# derivative that no thin rod feels, and costs more; the third, of order 1, is cheaper than RK4 only where nearly any
# step would do.
ORDER = {Integrator.IMPLICITFAST: 1, Integrator.RK4: 4}
LOOP_ORDER = 2  # at most, where `connect` closes loops: its gap is of that order in the step


def run_accurately(accuracy: float, request: Request, engine: Callable[..., Any]) -> Trajectory:
    """The run of a request whose largest node error is at most `accuracy` [m], as far as it can be known.

    Args:
        accuracy: [m].
        request: the run.
        engine: makes MuJoCo's options of a time step, an integrator and `locate_slack`.

    Raises:
        TensegrityError: what the finest runs raised, where no step was fine enough.
    """
    start = rates_at_start(request)
    integrators = [Integrator.RK4]
    # The dampers' forces are implicit in it: it differs from Euler's method where those limit the step.
    if start.decay > start.turn and request.scene.water is None:
        integrators.append(Integrator.IMPLICITFAST)
    return find(accuracy, [_ladder(integrator, start, request, engine) for integrator in integrators], request)


def _ladder(integrator: Integrator, start: Rates, request: Request, engine: Callable[..., Any]) -> Ladder:
    scene = request.scene
    explicit = integrator is Integrator.RK4
    located = explicit and scene.contact is None
    order = min(ORDER[integrator], LOOP_ORDER) if spanning_forest(scene.structure).closures else ORDER[integrator]

    def longest(rates: Rates) -> float:
        return rates.resolving_step(request.duration, ORDER[integrator], damped=explicit)

    def make(step: float, adapted: Request) -> Trajectory:
        return engine(step, integrator, locate_slack=located).run(adapted)

    stages = engine(integrator=integrator).stages
    return fixed_steps(integrator.value, order, stages, longest, start, request, make, located)
