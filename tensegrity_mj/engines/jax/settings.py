"""Options of the engine `JAX`: a value, which imports nothing that runs."""

from __future__ import annotations

import enum
from collections.abc import Sequence
from importlib import import_module
from typing import TYPE_CHECKING, Any

from tensegrity_mj.basics.fields import field, refused, value
from tensegrity_mj.basics.kinds import choice, not_negative, number, positive, whole
from tensegrity_mj.controllers.scenes import SCENE_LAW
from tensegrity_mj.engines.table import ENGINES
from tensegrity_mj.errors import OptionError
from tensegrity_mj.vibration.stepping import Scheme, Stepping

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from tensegrity_mj.engines.request import Accelerations, Request
    from tensegrity_mj.model.actuation import Actuation
    from tensegrity_mj.model.scene import Scene
    from tensegrity_mj.runs.trajectory import Trajectory

WINDOW = 4  # steps over which derivatives spread the jump of a damped string that comes taut
DOPRI8_VECTORS = 20  # 14 rates, state, error, dense output


class Method(enum.Enum):
    """Integration methods of the equations."""

    DOPRI8 = "dopri8"  # explicit Runge-Kutta 8(7) of diffrax, error-controlled
    RK4 = "rk4"  # classical, fixed step


class Derivatives(enum.Enum):
    """Directions in which runs of DOPRI8 are differentiated; runs of fixed steps allow both."""

    REVERSE = "reverse"  # jax.grad, jax.jacrev: many parameters
    FORWARD = "forward"  # jax.jvp, jax.jacfwd: few parameters, many results


@value("JAX", OptionError)
class JAX:
    """Options of the differentiable engine.

    Attributes:
        method, derivatives: see `Method` and `Derivatives`.
        rtol, atol: tolerances of DOPRI8.
        timestep: [s], of RK4 only.
        max_steps: of DOPRI8, before the run is given up.
        window: [s] over which derivatives spread the jump of tension with which a damped string comes taut
            (docs/gradients.md); four steps of RK4 by default. DOPRI8 takes four steps within it, and by default has
            none: its derivatives are right where no damped string comes taut, and `model` warns of such strings.
    """

    descriptor = ENGINES["jax"]

    method: Method = field(choice(Method), default=Method.DOPRI8)
    rtol: float = field(number("from 2.3e-14 to 1e-2", lambda x: 2.3e-14 <= x <= 1e-2), default=1e-10)
    atol: float = field(number("> 0 and at most 1e-2", lambda x: 0 < x <= 1e-2), default=1e-12)
    timestep: float | None = field(positive("s"), default=None, none="None")
    max_steps: int = field(whole(1), default=1_000_000)
    window: float | None = field(not_negative("s"), default=None, none="None")
    derivatives: Derivatives = field(choice(Derivatives), default=Derivatives.REVERSE)

    def __attrs_post_init__(self) -> None:
        fixed = self.method is Method.RK4
        if fixed and self.timestep is None:
            raise refused(self, "timestep = None: Method.RK4 has a fixed one; it must be > 0 s")
        if not fixed and self.timestep is not None:
            raise refused(self, f"timestep = {self.timestep!r}: DOPRI8 chooses its steps; leave it out")

    def __str__(self) -> str:
        if self.method is Method.RK4:
            return f"JAX RK4, h = {self.timestep:g} s"
        return f"JAX DOPRI8, rtol = {self.rtol:g}, atol = {self.atol:g}"

    @property
    def stepping(self) -> Stepping:
        """Integrator and step, for the stability of small motions."""
        fixed = self.method is Method.RK4
        return Stepping(Scheme.RUNGE_KUTTA if fixed else None, self.timestep)

    def working_bytes(self, scene: Scene) -> int:
        """Bytes of state and stages."""
        size = 6 * len(scene.structure.nodes) + 4
        return 8 * size * (6 if self.method is Method.RK4 else DOPRI8_VECTORS)

    @property
    def spread(self) -> float:
        """Time [s] over which jumps are spread: `window`, or its default."""
        if self.window is None:
            return 0.0 if self.timestep is None else WINDOW * self.timestep
        return self.window

    def model(
        self,
        scene: Scene,
        controller: Any = SCENE_LAW,
        *,
        duration: float | None = None,
        actuation: Actuation | None = None,
        output_interval: float | None = None,
        times: ArrayLike | None = None,
    ) -> Any:
        """A run as an array function of its parameters, a `Program`; arguments as `simulate`.

        Args:
            times: (T,) [s] at which the run is recorded in place of `output_interval`, rising from its start or later;
                of DOPRI8 alone. The last ends the run.

        Warns:
            DerivativeWarning: of damped strings, whose jumps derivatives miss where they come taut, with DOPRI8 and
                no `window`; not for a window of 0.

        Raises:
            SceneError, StructureError, OptionError: as `simulate`.
        """
        return _program().program_of(self, scene, controller, duration, actuation, output_interval, times)

    def accelerations(self, request: Request) -> Accelerations:
        """Accelerations of the nodes at one state."""
        return _program().Program(self, request).accelerations()

    def ensemble(self, requests: Sequence[Request], threads: int) -> Any:
        """Many runs of RK4 on threads, for `simulate_many`."""
        return _program().JAXEnsemble(self, requests, threads)

    def run(self, request: Request) -> Trajectory:
        """Simulate; called by `simulate`."""
        return _program().Program(self, request).trajectory()


def _program() -> Any:
    """The module that runs these options; by its name, as it imports this one."""
    return import_module(f"{__package__}.program")
