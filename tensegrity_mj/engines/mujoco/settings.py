"""Options of the MuJoCo engine: a value, which imports nothing that runs."""

from __future__ import annotations

import enum
from collections.abc import Sequence
from importlib import import_module
from typing import TYPE_CHECKING, Any

from tensegrity_mj.basics.fields import field, refused, value
from tensegrity_mj.basics.kinds import choice, flag, positive
from tensegrity_mj.engines.accuracy import ACCURACY, check_accuracy
from tensegrity_mj.engines.table import ENGINES
from tensegrity_mj.errors import OptionError
from tensegrity_mj.vibration.stepping import Scheme, Stepping

if TYPE_CHECKING:
    import mujoco

    from tensegrity_mj.engines.request import Accelerations, ReadyRun, Request
    from tensegrity_mj.model.scene import Scene
    from tensegrity_mj.runs.trajectory import Trajectory


class Integrator(enum.Enum):
    """MuJoCo's integrators."""

    EULER = "euler"  # semi-implicit, order 1
    IMPLICITFAST = "implicitfast"  # implicit in velocity, symmetric part only, order 1
    IMPLICIT = "implicit"  # implicit in velocity, order 1
    RK4 = "rk4"  # classical Runge-Kutta, order 4
    DISCRETE = "discrete"  # implicit in position and velocity, order 1: for stability, not for accuracy


SCHEMES = {
    Integrator.EULER: Scheme.SEMI_IMPLICIT,
    Integrator.IMPLICITFAST: Scheme.VELOCITY_IMPLICIT,
    Integrator.IMPLICIT: Scheme.VELOCITY_IMPLICIT,
    Integrator.RK4: Scheme.RUNGE_KUTTA,
    Integrator.DISCRETE: Scheme.LINEARLY_IMPLICIT,
}

NAMES = {Integrator.EULER: "Euler", Integrator.RK4: "RK4"}  # MuJoCo's own; those of the others are their values


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
        import mujoco

        if self.accuracy is not None:
            return f"MuJoCo {mujoco.__version__}, accuracy {self.accuracy:g} m"
        located = ", slack located" if self.locate_slack else ""
        return f"MuJoCo {mujoco.__version__} {self.word}, h = {self.timestep:g} s{located}"

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
        return NAMES.get(self.integrator, self.integrator.value)

    @property
    def stepping(self) -> Stepping:
        """Integrator and step, for the stability of small motions."""
        if self.accuracy is not None:
            return Stepping(by_accuracy=True)
        # It knows the stiffness of strings, and nothing of what weight and joints hold.
        discrete = "" if self.integrator is Integrator.DISCRETE else "Integrator.DISCRETE (stable, not accurate)"
        scheme = SCHEMES[self.integrator]
        return Stepping(scheme, float(self.timestep), against_strings=discrete, by_accuracy=True)

    def model(self, scene: Scene) -> mujoco.MjModel:
        """Compile the model of a scene; it belongs to the caller.

        Raises:
            StructureError: for masses, sizes or depths that MuJoCo cannot hold, and where it compiles a node, a center
                of mass or a capsule to another place than the structure's.
            OptionError: where a control callback that is not this package's hinders MuJoCo.
        """
        return import_module(f"{__package__}.prepared").prepared(scene, self.timestep, self.word).model

    def working_bytes(self, scene: Scene) -> int:
        """Bytes of the compiled model's buffer and of one data object's: its arrays and its arena, taken whole."""
        import mujoco

        model = self.model(scene)
        data = mujoco.MjData(model)
        return int(model.nbuffer) + int(data.nbuffer) + int(data.narena)

    def ensemble(self, requests: Sequence[Request], threads: int) -> Any:
        """Many runs on threads, for `simulate_many`."""
        return import_module(f"{__package__}.ensemble").MuJoCoEnsemble(self, requests, threads)

    def prepare(self, request: Request) -> ReadyRun:
        """A run with its model, data and plant; called by `simulate`."""
        return _engine().prepare(self, request)

    def run(self, request: Request) -> Trajectory:
        """Simulate."""
        return self.prepare(request).run()

    def accelerations(self, request: Request) -> Accelerations:
        """Node accelerations J q̈ + J̇ q̇ of the model that `run` steps."""
        return _engine().accelerations(self, request)


def _engine() -> Any:
    """The module that runs these options; by its name, as it imports this one."""
    return import_module(f"{__package__}.engine")
