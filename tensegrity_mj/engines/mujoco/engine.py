"""The MuJoCo engine: the scene's MJCF, stepped by MuJoCo, with the law inside its control callback.

With an accuracy it tries several of its integrators.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.fields import field, refused, value
from tensegrity_mj.basics.kinds import choice, flag, positive
from tensegrity_mj.dynamics.native.law import NO_SOLUTION
from tensegrity_mj.engines.accuracy.ladder import Ladder
from tensegrity_mj.engines.accuracy.rates import Rates, rates_at_start
from tensegrity_mj.engines.accuracy.search import ACCURACY, check_accuracy, find, fixed_steps
from tensegrity_mj.engines.mujoco import install, joints, run_view
from tensegrity_mj.engines.mujoco.mjcf_tree import place
from tensegrity_mj.engines.mujoco.prepared import give_back, prepared
from tensegrity_mj.engines.mujoco.settings import SCHEMES, WORDS, Integrator
from tensegrity_mj.engines.request import Accelerations, Request
from tensegrity_mj.engines.table import ENGINES
from tensegrity_mj.errors import InfeasibleError, OptionError
from tensegrity_mj.model.forest import spanning_forest
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.runs.trajectory import Trajectory
from tensegrity_mj.vibration.stepping import Stepping

if TYPE_CHECKING:
    from tensegrity_mj.engines.mujoco.ensemble import MuJoCoEnsemble
    from tensegrity_mj.engines.mujoco.run import MuJoCoRun


@value("MuJoCo", OptionError)
class MuJoCo:
    """Options of the MuJoCo engine.

    Attributes:
        timestep: h [s].
        integrator: see `Integrator`.
        accuracy: [m] largest node error over the run, from 1e-10 to 1e-2, in place of the other two, which it chooses
            for each run (evidence/docs/accuracy.md).
        locate_slack: whether steps of RK4 are split where strings begin or cease to pull, so that it keeps its order
            there.
    """

    descriptor = ENGINES["mujoco"]

    timestep: float = field(positive("s"), default=1e-3)
    integrator: Integrator = field(choice(Integrator), default=Integrator.RK4)
    accuracy: float | None = field(ACCURACY, default=None, none="None")
    locate_slack: bool = field(flag(), default=False)

    def __attrs_post_init__(self) -> None:
        if self.locate_slack and self.integrator is not Integrator.RK4:
            raise refused(
                self,
                f"locate_slack = True with {self.integrator.name}, of order 1 with strings slack or taut; it belongs "
                "to Integrator.RK4: leave it out",
            )
        check_accuracy(self, ("timestep", "integrator", "locate_slack"))

    def __str__(self) -> str:
        if self.accuracy is not None:
            return f"MuJoCo {mujoco.__version__}, accuracy {self.accuracy:g} m"
        located = ", slack located" if self.locate_slack else ""
        return f"MuJoCo {mujoco.__version__} {self.word}, h = {self.timestep:g} s{located}"

    def model(self, scene: Scene) -> mujoco.MjModel:
        """Compile the model of a scene; it belongs to the caller.

        Raises:
            StructureError: for masses, sizes or depths that MuJoCo cannot hold, and where it compiles a node, a center
                of mass or a capsule to another place than the structure's.
            OptionError: where a control callback that is not this package's hinders MuJoCo.
        """
        return prepared(scene, self.timestep, self.word).model

    @property
    def stages(self) -> int:
        """Evaluations of the forces a step."""
        return 4 if self.integrator is Integrator.RK4 else 1

    @property
    def is_explicit(self) -> bool:
        """True where the forces that act over a step are those computed at its stages."""
        return self.integrator in (Integrator.EULER, Integrator.RK4)

    @property
    def word(self) -> str:
        """Name of the integrator in MuJoCo."""
        return WORDS.get(self.integrator, self.integrator.value)

    @property
    def stepping(self) -> Stepping:
        """Integrator and step, for the stability of small motions."""
        if self.accuracy is not None:
            return Stepping(by_accuracy=True)
        # It knows the stiffness of strings, and nothing of what weight and joints hold.
        discrete = "" if self.integrator is Integrator.DISCRETE else "Integrator.DISCRETE (stable, not accurate)"
        scheme = SCHEMES[self.integrator]
        return Stepping(scheme, float(self.timestep), against_strings=discrete, by_accuracy=True)

    def working_bytes(self, scene: Scene) -> int:
        """Bytes of the compiled model's buffer and of one data object's: its arrays and its arena, taken whole."""
        model = self.model(scene)
        data = mujoco.MjData(model)
        return int(model.nbuffer) + int(data.nbuffer) + int(data.narena)

    def ensemble(self, requests: Sequence[Request], threads: int) -> MuJoCoEnsemble:
        """Many runs on threads, for `simulate_many`."""
        from tensegrity_mj.engines.mujoco.ensemble import MuJoCoEnsemble

        return MuJoCoEnsemble(self, requests, threads)

    def run(self, request: Request) -> Trajectory:
        """Simulate; called by `simulate`."""
        from tensegrity_mj.engines.mujoco.run import MuJoCoRun

        if self.accuracy is not None:
            return run_accurately(self.accuracy, request, type(self))
        if self.locate_slack:
            from tensegrity_mj.engines.mujoco.located import LocatedRun

            run: MuJoCoRun = LocatedRun(self, request)
        else:
            run = MuJoCoRun(self, request)
        found = run.run()
        give_back(run.ready)
        return found

    def accelerations(self, request: Request) -> Accelerations:
        """Node accelerations J q̈ + J̇ q̇ of the model that `run` steps."""
        from tensegrity_mj.engines.mujoco.run import MuJoCoRun

        return node_accelerations(MuJoCoRun(self, request))


def node_accelerations(run: MuJoCoRun) -> Accelerations:
    """See `engines.request.Accelerations`. The engine's callback sets controls and loads, as in a run.

    Joints that close loops are rigid here (`close_rigidly`), which a run has soft.
    """
    model, data, scene = run.model, run.data, run.request.scene
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


# `discrete`, `implicit` and `euler` are not tried. The first damps vibrations away that it does not resolve, at any two
# steps alike, so that two runs agree on what is wrong; the second differs from `implicitfast` by a part of the dampers'
# derivative that no thin rod feels, and costs more; the third, of order 1, is cheaper than RK4 only where nearly any
# step would do.
ORDER = {Integrator.IMPLICITFAST: 1, Integrator.RK4: 4}
LOOP_ORDER = 2  # at most, where `connect` closes loops: its gap is of that order in the step


def run_accurately(accuracy: float, request: Request, engine: Callable[..., Any]) -> Trajectory:
    """Make a run whose largest node error is at most `accuracy` [m], as far as it can be known.

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
