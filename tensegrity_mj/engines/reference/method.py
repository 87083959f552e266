"""Methods of integration of the DAE and the ODE, and the options that go with them."""

from __future__ import annotations

import enum
import sys
from typing import Any, Protocol

from tensegrity_mj.basics.fields import refused
from tensegrity_mj.basics.kinds import number
from tensegrity_mj.engines.accuracy.option import check_accuracy
from tensegrity_mj.vibration.stepping import Scheme, Stepping


class Method(enum.Enum):
    """How the equations are integrated."""

    DOP853 = "dop853"  # SciPy's explicit Runge-Kutta 8(5,3), error-controlled
    RADAU = "radau"  # SciPy's implicit Radau IIA of order 5, error-controlled, for stiff strings
    RK4 = "rk4"  # classical, fixed step, compiled


class Options(Protocol):
    """What the integrators need of an engine's options."""

    @property
    def method(self) -> Method: ...
    @property
    def rtol(self) -> float: ...
    @property
    def atol(self) -> float: ...
    @property
    def timestep(self) -> float | None: ...
    @property
    def locate_slack(self) -> bool: ...
    @property
    def max_steps(self) -> int: ...
    @property
    def accuracy(self) -> float | None: ...


# Kinds of these options; below the first limit double precision cannot hold what is requested.
RTOL = number("from 2.3e-14 to 1e-2", lambda x: 100 * sys.float_info.epsilon <= x <= 1e-2)
ATOL = number("> 0 and at most 1e-2", lambda x: 0 < x <= 1e-2)


def check_options(options: Any) -> None:
    """Check how `Options` of a value class fit each other.

    Raises:
        OptionError: naming engine, option, value and what is allowed.
    """
    method, fixed = options.method, options.method is Method.RK4
    if fixed and options.timestep is None:
        raise refused(options, "timestep = None: Method.RK4 has a fixed one; it must be > 0 s")
    if not fixed and options.timestep is not None:
        raise refused(options, f"timestep = {options.timestep!r}: {method.name} chooses its steps; leave it out")
    if options.locate_slack and not fixed:
        raise refused(
            options,
            f"locate_slack = True with {method.name}, whose steps shorten where strings go slack; it belongs to "
            "Method.RK4: leave it out",
        )
    check_accuracy(options, ("method", "timestep", "rtol", "atol"))


def stepping_of(options: Options, constraints: tuple[complex, ...] = (), polar: bool = False) -> Stepping:
    """How an engine with these options steps, for small motions; arguments as `Stepping` has them."""
    fixed = options.method is Method.RK4 and options.accuracy is None
    return Stepping(
        Scheme.RUNGE_KUTTA if fixed else None,
        float(options.timestep) if fixed and options.timestep is not None else None,
        constraints,
        polar,
        against_all="Method.RADAU, which chooses its steps",
        by_accuracy=True,
    )


def describe_method(options: Options) -> str:
    """The method with its step or tolerances, for people; the accuracy that chooses them."""
    if options.accuracy is not None:
        return f"accuracy {options.accuracy:g} m"
    if options.method is Method.RK4:
        located = ", slack located" if options.locate_slack else ""
        return f"RK4, h = {options.timestep:g} s{located}"
    return f"{options.method.name}, rtol = {options.rtol:g}, atol = {options.atol:g}"
