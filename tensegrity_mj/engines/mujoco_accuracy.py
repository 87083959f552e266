"""MuJoCo with an accuracy: which of its integrators are tried, and what each costs."""

from __future__ import annotations

import math

from tensegrity_mj.engines.accuracy import Way, can_locate, find, fixed_step_way
from tensegrity_mj.engines.accuracy_steps import Steps, fastest_rate, known_rate
from tensegrity_mj.engines.mujoco import Integrator, MuJoCo
from tensegrity_mj.engines.run import Request
from tensegrity_mj.joints import spanning_forest
from tensegrity_mj.trajectory import Trajectory

# Order, and work of an evaluation of the forces in those of Euler's: wall time a step over that of Euler, over the
# evaluations a step, on the pinned rod, the prism and random structures of three rods, 320 to 2560 steps (0.95 to 1.0,
# and 1.03 to 1.15). `discrete` and `implicit` are not tried: the first damps vibrations away that it does not resolve,
# at any two steps alike, so that two runs agree on what is wrong; the second differs from `implicitfast` by a part of
# the dampers' derivative that no thin rod feels, and costs more.
ORDER = {Integrator.EULER: 1, Integrator.IMPLICITFAST: 1, Integrator.RK4: 4}
LOOP_ORDER = 2  # at most, where `connect` closes loops: its gap is of that order in the step
WEIGHT = {Integrator.EULER: 1.0, Integrator.IMPLICITFAST: 1.1, Integrator.RK4: 0.95}

DAMPED = 0.5  # of the rate of the dampers times the coarsest step; explicit methods bear 2


def run_accurately(accuracy: float, request: Request) -> Trajectory:
    """The run of a request whose largest node error is at most `accuracy` [m], as far as it can be told.

    Raises:
        TensegrityError: what the finest runs raised, where no step was fine enough.
    """
    scene = request.scene
    steps = Steps.of(request, known_rate(request))
    integrators = [Integrator.EULER, Integrator.RK4]
    # The dampers' forces are implicit in it: it differs from Euler where those limit the step.
    damped = fastest_rate(scene.structure, scene.nodes0, with_stiffness=False) * steps.unit > DAMPED
    if damped and scene.water is None:
        integrators.insert(1, Integrator.IMPLICITFAST)
    return find(accuracy, [_way(integrator, steps, request) for integrator in integrators], request)


def _way(integrator: Integrator, steps: Steps, request: Request) -> Way:
    scene = request.scene
    located = integrator is Integrator.RK4 and scene.contact is None and can_locate(scene.structure)

    def make(step: float, adapted: Request) -> Trajectory:
        return MuJoCo(step, integrator, locate_slack=located).run(adapted)

    stages = MuJoCo(integrator=integrator).stages
    order = min(ORDER[integrator], LOOP_ORDER if spanning_forest(scene.structure).closures else math.inf)
    return fixed_step_way(integrator.value, int(order), WEIGHT[integrator], stages, steps, request, make, located)
