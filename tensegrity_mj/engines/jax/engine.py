"""The engine `JAX`: a scene's `Model`, integrated and differentiated by JAX."""

from __future__ import annotations

import enum
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics.checks import positive as positive_number
from tensegrity_mj.basics.fields import field, refused, value
from tensegrity_mj.basics.kinds import choice, not_negative, number, positive, whole
from tensegrity_mj.dynamics.native.law import NativeLaw
from tensegrity_mj.engines.jax.integrate import Tolerances
from tensegrity_mj.engines.jax.program import Program
from tensegrity_mj.engines.request import Accelerations, Request
from tensegrity_mj.engines.requirements import require
from tensegrity_mj.engines.table import ENGINES
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.actuation import Actuation, OnInfeasible
from tensegrity_mj.model.moved_supports import check_motions_until
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.runs.trajectory import Trajectory
from tensegrity_mj.vibration.stepping import Scheme, Stepping

if TYPE_CHECKING:
    from tensegrity_mj.engines.jax.ensemble import JAXEnsemble

WINDOW = 4  # steps over which derivatives spread the jump of a damped string that comes taut
DOPRI8_VECTORS = 20  # 14 rates, state, error, dense output


class Method(enum.Enum):
    """How the equations are integrated."""

    DOPRI8 = "dopri8"  # explicit Runge-Kutta 8(7) of diffrax, error-controlled
    RK4 = "rk4"  # classical, fixed step


class Derivatives(enum.Enum):
    """Which way runs of DOPRI8 are differentiated; those of fixed steps are both ways."""

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
            none: its derivatives are right where no damped string comes taut.
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
        """How it steps, for small motions."""
        fixed = self.method is Method.RK4
        return Stepping(Scheme.RUNGE_KUTTA if fixed else None, self.timestep)

    def working_bytes(self, scene: Scene) -> int:
        """Bytes of state and stages."""
        size = 6 * len(scene.structure.nodes) + 4
        return 8 * size * (6 if self.method is Method.RK4 else DOPRI8_VECTORS)

    @property
    def spread(self) -> float:
        """[s]: `window`, or its default."""
        if self.window is None:
            return 0.0 if self.timestep is None else WINDOW * self.timestep
        return self.window

    @property
    def tolerances(self) -> Tolerances:
        """Of DOPRI8."""
        import diffrax

        forward = self.derivatives is Derivatives.FORWARD
        adjoint = diffrax.ForwardMode() if forward else diffrax.RecursiveCheckpointAdjoint()
        return Tolerances(self.rtol, self.atol, self.max_steps, 0.25 * self.spread or None, adjoint)

    def model(
        self,
        scene: Scene,
        controller: Any = None,
        *,
        duration: float | None = None,
        actuation: Actuation | None = None,
        output_interval: float | None = None,
        times: ArrayLike | None = None,
    ) -> Program:
        """A run as an array function of its parameters; arguments as `simulate`.

        Args:
            times: (T,) [s] at which the run is recorded in place of `output_interval`, rising from 0 or later; of
                DOPRI8 alone. The last is the run's duration.

        Raises:
            SceneError, StructureError, OptionError: as `simulate`.
        """
        require(self, scene)
        if times is not None:
            times = np.asarray(times, float)
            rising = times.ndim == 1 and len(times) > 1 and times[0] >= 0 and np.all(np.diff(times) > 0)
            if self.method is Method.RK4 or not rising:
                raise OptionError("times: two or more must rise from 0 s or later; RK4 has output_interval")
            duration = float(times[-1])
        law = NativeLaw(0, 0, (), own=controller)
        total = scene.duration if duration is None else positive_number("duration", duration, "s")
        check_motions_until(scene, total)
        request = Request(scene, law, actuation or Actuation.continuous(), OnInfeasible.STOP, total, output_interval)
        return Program(self, request, times)

    def accelerations(self, request: Request) -> Accelerations:
        """Accelerations of the nodes at one state."""
        require(self, request.scene)
        return Program(self, request).accelerations()

    def ensemble(self, requests: Sequence[Request], threads: int) -> JAXEnsemble:
        """Many runs of RK4 on threads, for `simulate_many`."""
        from tensegrity_mj.engines.jax.ensemble import JAXEnsemble

        return JAXEnsemble(self, requests, threads)

    def run(self, request: Request) -> Trajectory:
        """Simulate; called by `simulate`."""
        require(self, request.scene)
        return Program(self, request).trajectory()
