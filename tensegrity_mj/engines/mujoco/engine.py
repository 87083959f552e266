"""The MuJoCo engine: the scene's MJCF, stepped by MuJoCo, with the law inside its control callback."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import mujoco

from tensegrity_mj.basics.fields import field, refused, value
from tensegrity_mj.basics.kinds import choice, flag, positive
from tensegrity_mj.engines.accuracy.option import ACCURACY, check_accuracy
from tensegrity_mj.engines.mujoco.prepared import give_back, prepared
from tensegrity_mj.engines.mujoco.settings import SCHEMES, WORDS, Integrator
from tensegrity_mj.engines.request import Accelerations, Request
from tensegrity_mj.engines.table import ENGINES
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.runs.trajectory import Trajectory
from tensegrity_mj.vibration.stepping import Stepping

if TYPE_CHECKING:
    from tensegrity_mj.engines.mujoco.ensemble import MuJoCoEnsemble


@value("MuJoCo", OptionError)
class MuJoCo:
    """Options of the MuJoCo engine.

    Attributes:
        timestep: h [s].
        integrator: see `Integrator`.
        accuracy: [m] largest node error over the run, from 1e-10 to 1e-2, in place of the other two, which it chooses
            for each run (docs/accuracy.md).
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
        """The compiled model of a scene, the caller's own.

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
        """Whether the forces that act over a step are those computed at its stages."""
        return self.integrator in (Integrator.EULER, Integrator.RK4)

    @property
    def word(self) -> str:
        """MuJoCo's own word for the integrator."""
        return WORDS.get(self.integrator, self.integrator.value)

    @property
    def stepping(self) -> Stepping:
        """How it steps, for small motions."""
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
            from tensegrity_mj.engines.mujoco.accuracy import run_accurately

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
        from tensegrity_mj.engines.mujoco.accelerations import node_accelerations
        from tensegrity_mj.engines.mujoco.run import MuJoCoRun

        return node_accelerations(MuJoCoRun(self, request))
