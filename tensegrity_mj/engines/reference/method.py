"""Methods of integration of the DAE and the ODE, and the options that go with them."""

from __future__ import annotations

import enum
from typing import Any, Protocol

import numpy as np

from tensegrity_mj.basics.checks import member, positive
from tensegrity_mj.engines.accuracy.option import check_accuracy
from tensegrity_mj.errors import OptionError


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


def check_options(engine: str, options: Any) -> None:
    """Validate the fields of `Options` in a frozen dataclass, and make floats of its numbers.

    Raises:
        OptionError: naming engine, option, value and what is allowed.
    """
    member(f"{engine}: method", options.method, Method)
    if options.method is Method.RK4:
        step = positive(f"{engine}: timestep (Method.RK4 has a fixed one)", options.timestep, "s")
        object.__setattr__(options, "timestep", step)
    elif options.timestep is not None:
        raise OptionError(
            f"{engine}: timestep = {options.timestep!r}: {options.method.name} chooses its steps; leave it out"
        )
    if not isinstance(options.locate_slack, bool):
        raise OptionError(f"{engine}: locate_slack = {options.locate_slack!r}; it must be True or False")
    if options.locate_slack and options.method is not Method.RK4:
        raise OptionError(
            f"{engine}: locate_slack = True with {options.method.name}, whose steps shorten where strings go slack; "
            "it belongs to Method.RK4: leave it out"
        )
    for name in ("rtol", "atol"):
        object.__setattr__(options, name, positive(f"{engine}: {name}", getattr(options, name)))
    if max(options.rtol, options.atol) > 1e-2:
        raise OptionError(f"{engine}: rtol = {options.rtol:g}, atol = {options.atol:g}; both must be <= 1e-2")
    if options.rtol < 100 * np.finfo(float).eps:
        raise OptionError(f"{engine}: rtol = {options.rtol:g} is below what double precision can hold; use >= 2.3e-14")
    if options.accuracy is not None:
        chosen = {
            "method": (options.method, Method.DOP853),
            "timestep": (options.timestep, None),
            "rtol": (options.rtol, 1e-10),
            "atol": (options.atol, 1e-12),
        }
        object.__setattr__(options, "accuracy", check_accuracy(engine, options.accuracy, chosen))
    if not isinstance(options.max_steps, int) or isinstance(options.max_steps, bool) or options.max_steps < 1:
        raise OptionError(f"{engine}: max_steps = {options.max_steps!r}; it must be an integer >= 1")


def describe_method(options: Options) -> str:
    """The method with its step or tolerances, for people; the accuracy that chooses them."""
    if options.accuracy is not None:
        return f"accuracy {options.accuracy:g} m"
    if options.method is Method.RK4:
        located = ", slack located" if options.locate_slack else ""
        return f"RK4, h = {options.timestep:g} s{located}"
    return f"{options.method.name}, rtol = {options.rtol:g}, atol = {options.atol:g}"
