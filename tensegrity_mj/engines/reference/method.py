"""Methods of integration of the DAE and the ODE, and the options that go with them."""

from __future__ import annotations

import enum
import sys

from tensegrity_mj.basics.fields import field, refused, value
from tensegrity_mj.basics.kinds import choice, flag, number, positive, whole
from tensegrity_mj.engines.accuracy.option import ACCURACY, check_accuracy
from tensegrity_mj.errors import OptionError
from tensegrity_mj.vibration.stepping import Scheme, Stepping


class Method(enum.Enum):
    """How the equations are integrated."""

    DOP853 = "dop853"  # SciPy's explicit Runge-Kutta 8(5,3), error-controlled
    RADAU = "radau"  # SciPy's implicit Radau IIA of order 5, error-controlled, for stiff strings
    RK4 = "rk4"  # classical, fixed step, compiled


# Kinds of options; below the first limit double precision cannot hold what is requested.
RTOL = number("from 2.3e-14 to 1e-2", lambda x: 100 * sys.float_info.epsilon <= x <= 1e-2)
ATOL = number("> 0 and at most 1e-2", lambda x: 0 < x <= 1e-2)
# What the methods work with, in numbers of the size of the state.
DOUBLE = 8  # bytes
RK4_VECTORS = 6  # the state, four rates, a trial state
DOP853_VECTORS = 22  # 16 rates with those of the dense output (SciPy's K_extended), state, old state, dense output
RADAU_VECTORS = 15  # three stages in three forms, state, rates, dense output
RADAU_MATRICES = 4  # the Jacobian, and two factored matrices of which one is complex
WORK = 3  # integrals of work beside q and q̇


@value(error=OptionError)
class Options:
    """What the integrators need of an engine's options; DAE and ODE have more of their own.

    Attributes:
        method: see `Method`.
        rtol, atol: tolerances of the error-controlled methods.
        timestep: [s], of RK4 only.
        max_steps: of the error-controlled methods, before the run is given up.
        accuracy: [m] largest node error over the run, from 1e-10 to 1e-2, in place of method, tolerances and step,
            which it chooses for each run (docs/accuracy.md).
        locate_slack: of RK4 only, whether steps are split at the instants where strings go slack or taut, so that it
            keeps its order of 4 there (docs/accuracy.md).
    """

    method: Method = field(choice(Method), default=Method.DOP853)
    rtol: float = field(RTOL, default=1e-10)
    atol: float = field(ATOL, default=1e-12)
    timestep: float | None = field(positive("s"), default=None, none="None")
    max_steps: int = field(whole(1), default=1_000_000)
    accuracy: float | None = field(ACCURACY, default=None, none="None")
    locate_slack: bool = field(flag(), default=False)

    def __attrs_post_init__(self) -> None:
        method, fixed = self.method, self.method is Method.RK4
        if fixed and self.timestep is None:
            raise refused(self, "timestep = None: Method.RK4 has a fixed one; it must be > 0 s")
        if not fixed and self.timestep is not None:
            raise refused(self, f"timestep = {self.timestep!r}: {method.name} chooses its steps; leave it out")
        if self.locate_slack and not fixed:
            raise refused(
                self,
                f"locate_slack = True with {method.name}, whose steps shorten where strings go slack; it belongs to "
                "Method.RK4: leave it out",
            )
        check_accuracy(self, ("method", "timestep", "rtol", "atol"))

    @property
    def stepping(self) -> Stepping:
        """How it steps, for small motions."""
        fixed = self.method is Method.RK4 and self.accuracy is None
        return Stepping(
            Scheme.RUNGE_KUTTA if fixed else None,
            float(self.timestep) if fixed and self.timestep is not None else None,
            against_all="Method.RADAU, which chooses its steps",
            by_accuracy=True,
        )

    def _described(self) -> str:
        """The method with its step or tolerances, for people; the accuracy that chooses them."""
        if self.accuracy is not None:
            return f"accuracy {self.accuracy:g} m"
        if self.method is Method.RK4:
            located = ", slack located" if self.locate_slack else ""
            return f"RK4, h = {self.timestep:g} s{located}"
        return f"{self.method.name}, rtol = {self.rtol:g}, atol = {self.atol:g}"

    def _bytes(self, nq: int) -> int:
        """Of state, stages and matrices for nq coordinates: the same on every run."""
        size = 2 * nq + WORK
        if self.method is Method.RK4:
            return DOUBLE * RK4_VECTORS * size
        if self.method is Method.DOP853:
            return DOUBLE * DOP853_VECTORS * size
        return DOUBLE * (RADAU_VECTORS * size + RADAU_MATRICES * size**2)
