"""The MuJoCo engine: the scene's MJCF, stepped by MuJoCo, with the law inside its control callback.

With an accuracy the reference engine certifies one run where it simulates the scene; elsewhere it tries several of its
integrators.
"""

from __future__ import annotations

from functools import partial

import mujoco
import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.dynamics.native.law import NO_SOLUTION
from tensegrity_mj.engines.accuracy.ladder import CERTIFIER, Ladder
from tensegrity_mj.engines.accuracy.rates import Rates, rates_at_start
from tensegrity_mj.engines.accuracy.search import find, fixed_steps
from tensegrity_mj.engines.mujoco import install, joints, run_view
from tensegrity_mj.engines.mujoco.mjcf_tree import place
from tensegrity_mj.engines.mujoco.prepared import give_back
from tensegrity_mj.engines.mujoco.run import LocatedRun, MuJoCoRun
from tensegrity_mj.engines.mujoco.settings import Integrator, MuJoCo
from tensegrity_mj.engines.request import Accelerations, ReadyRun, Request
from tensegrity_mj.engines.table import ENGINES, make_engine
from tensegrity_mj.errors import InfeasibleError
from tensegrity_mj.model.capabilities import FUNCTION_LOADS, refusal
from tensegrity_mj.model.forest import spanning_forest
from tensegrity_mj.runs.trajectory import Trajectory


def prepare(options: MuJoCo, request: Request) -> ReadyRun:
    """A run with its model, data and plant; with an accuracy, one of several steps and integrators."""
    if options.accuracy is not None:
        return ReadyRun(partial(run_accurately, options.accuracy, request))
    made = (LocatedRun if options.locate_slack else MuJoCoRun)(options, request)

    def run() -> Trajectory:
        found = made.run()
        give_back(made.ready)
        return found

    return ReadyRun(run, made.plant)


def accelerations(options: MuJoCo, request: Request) -> Accelerations:
    """See `engines.request.Accelerations`. The engine's callback sets controls and loads, as in a run.

    Joints that close loops are rigid here (`close_rigidly`), which a run has soft.
    """
    run, scene = MuJoCoRun(options, request), request.scene
    model, data = run.model, run.data
    model.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    run.plant["stages"] = 4  # a stage is no step: states of elements stay those of the start
    sites = np.array([model.site(name).id for name in scene.structure.nodes])
    run.plant.set(resets=0, yielding=0)  # the state is the one that is requested, and no string was longer before

    def at(time: float, nodes: Array, velocities: Array, rest_lengths: Array | None = None) -> tuple[Array, Array]:
        mujoco.mj_resetData(model, data)
        place(data, scene, nodes, velocities, run.tree)
        if rest_lengths is not None:
            run.plant["held"][:] = rest_lengths
        # The callback counts time in steps: one step of this length.
        run.plant["step"] = time
        run.counters[:] = [0, 1 if time else 0, 0, -1, run_view.RUNNING, 0]
        with install.installed(run.plant):
            mujoco.mj_forward(model, data)
        ended, failed = int(run.counters[run_view.ENDED]), run.plant["status"]
        run.plant.raise_if_failed(max(ended, failed, 0), time)
        if ended == NO_SOLUTION:
            raise InfeasibleError(run.plant.infeasible_message(time))
        return data.site_xpos[sites].copy(), joints.site_accelerations(model, data, sites)

    return at


# `implicit` and `euler` are not tried, and `discrete` only beside the DAE: it damps vibrations away that it does not
# resolve, at any two steps alike, so that two of its runs agree on what is wrong. `implicit` differs from
# `implicitfast` by a part of the dampers' derivative that no thin rod feels, and costs more; `euler`, of order 1, is
# cheaper than RK4 only where nearly any step would do.
ORDER = {Integrator.DISCRETE: 1, Integrator.IMPLICITFAST: 1, Integrator.RK4: 4}
LOOP_ORDER = 2  # at most, where `connect` closes loops: its gap is of that order in the step


def run_accurately(accuracy: float, request: Request) -> Trajectory:
    """Make a run whose largest node error is at most `accuracy` [m], as far as it can be known.

    Args:
        accuracy: [m].
        request: the run.

    Raises:
        TensegrityError: what the finest runs raised, where no step was fine enough.
    """
    start = rates_at_start(request)
    integrators = [Integrator.RK4]
    # The dampers' forces are implicit in it: it differs from Euler's method where those limit the step.
    if start.decay > start.turn and request.scene.water is None:
        integrators.append(Integrator.IMPLICITFAST)
    ladders = [_ladder(integrator, start, request) for integrator in integrators]
    cheap = _ladder(Integrator.DISCRETE, start, request) if len(ladders) > 1 else None
    return find(accuracy, ladders, request, _reference(start, request), cheap)


def _reference(start: Rates, request: Request) -> Ladder | None:
    """The runs of the DAE that certify; None where it cannot simulate the scene or go on from another run, or where
    Python functions take the time, which it calls as often; where it takes all as one system, so that its step costs
    more than MuJoCo's; and with contact, where neither engine's order is known.
    """
    scene, options, dae = request.scene, ENGINES["dae"].fixed_step, make_engine("dae", {})
    in_python = request.law.spent is not None or FUNCTION_LOADS.find(scene)
    if (
        in_python
        or scene.contact is not None
        or request.start is not None
        or refusal(dae, scene) is not None
        or dae.as_one(scene)
    ):
        return None

    def make(step: float, adapted: Request) -> Trajectory:
        engine = make_engine("dae", {**options, "timestep": step, "locate_slack": True})
        made: Trajectory = engine.run(adapted)
        return made

    order, stages = ORDER[Integrator.RK4], MuJoCo(integrator=Integrator.RK4).stages

    def longest(rates: Rates) -> float:
        return rates.resolving_step(request.duration, order)

    return fixed_steps(CERTIFIER, order, stages, longest, start, request, make, located=True)


def _ladder(integrator: Integrator, start: Rates, request: Request) -> Ladder:
    scene = request.scene
    located = integrator is Integrator.RK4 and scene.contact is None
    order = min(ORDER[integrator], LOOP_ORDER) if spanning_forest(scene.structure).closures else ORDER[integrator]

    def longest(rates: Rates) -> float:
        if integrator is Integrator.IMPLICITFAST:
            return rates.resolving_step(request.duration, ORDER[integrator], damped=False)
        return rates.resolving_step(request.duration, ORDER[Integrator.RK4])  # the steps that the DAE has, too

    def make(step: float, adapted: Request) -> Trajectory:
        return MuJoCo(step, integrator, locate_slack=located).run(adapted)

    stages = MuJoCo(integrator=integrator).stages
    return fixed_steps(integrator.value, order, stages, longest, start, request, make, located)
