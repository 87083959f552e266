"""Axes of a sweep: values of parameters, several together, and seeded random draws."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from tensegrity_mj.basics import kinds
from tensegrity_mj.basics.fields import field, refused, value
from tensegrity_mj.basics.kinds import Kind, Wrong
from tensegrity_mj.errors import OptionError
from tensegrity_mj.studies.parameter_values import Scaled, encoded
from tensegrity_mj.studies.plain import plain

PATH = kinds.printable_name("a text, such as law.decay_rate")


def _values(value: Any) -> tuple[Any, ...]:
    try:
        given = kinds.sequence("" if isinstance(value, (Mapping, Scaled)) else value)
    except Wrong:
        raise Wrong(f" = {value!r}; give a list of them") from None
    listed = tuple(one if isinstance(one, Scaled) else plain(one, "values") for one in given)
    if not listed:
        raise Wrong(": give at least one value")
    return listed


class Axis:
    """A parameter and its values, or several that go together."""


@value("Vary {parameter}", OptionError)
class Vary(Axis):
    """A parameter and the values that it takes.

    Attributes:
        parameter: its path (see `parameters`).
        values: plain values, or `Scaled(factor)`.
    """

    parameter: str = field(PATH)
    values: Sequence[Any] = field(Kind(_values))

    @property
    def axes(self) -> tuple[Vary]:
        """This axis alone, as `Together` has several."""
        return (self,)


@value("Together", OptionError)
class Together(Axis):
    """Parameters that go through their values together, the first of each, the second of each, ..."""

    axes: Sequence[Vary] = field(kinds.parts(Vary, "a list of Vary(parameter, values)"))

    def __attrs_post_init__(self) -> None:
        if not self.axes:
            raise refused(self, "axes = (); give a list of Vary(parameter, values)")
        lengths = {axis.parameter: len(axis.values) for axis in self.axes}
        if len(set(lengths.values())) > 1:
            counts = ", ".join(f"{name}: {count}" for name, count in lengths.items())
            raise refused(self, f"parameters that go together need as many values each ({counts})")


@value("Uniform", OptionError)
class Uniform:
    """Uniform distribution between low and high."""

    low: float = field(kinds.finite())
    high: float = field(kinds.finite())

    def __attrs_post_init__(self) -> None:
        if self.low > self.high:
            raise refused(self, f"low = {self.low:g} is above high = {self.high:g}; give the lower one first")

    def sample(self, generator: np.random.Generator) -> Any:
        """Draw one value."""
        return float(generator.uniform(self.low, self.high))


@value("LogUniform", OptionError)
class LogUniform(Uniform):
    """Distribution between low and high, both > 0, whose logarithm is uniform."""

    low: float = field(kinds.positive())
    high: float = field(kinds.positive())

    def sample(self, generator: np.random.Generator) -> Any:
        """Draw one value."""
        value = math.exp(generator.uniform(math.log(self.low), math.log(self.high)))
        return min(max(value, self.low), self.high)


@value("Normal", OptionError)
class Normal:
    """Normal distribution."""

    mean: float = field(kinds.finite())
    deviation: float = field(kinds.positive())

    def sample(self, generator: np.random.Generator) -> Any:
        """Draw one value."""
        return float(generator.normal(self.mean, self.deviation))


@value("Choice", OptionError)
class Choice:
    """Choice of one of some values, each as likely."""

    values: Sequence[Any] = field(Kind(_values))

    def sample(self, generator: np.random.Generator) -> Any:
        """Draw one value."""
        return self.values[int(generator.integers(len(self.values)))]


Distribution = Uniform | Normal | Choice


def _distribution(value: Any) -> Distribution:
    if not isinstance(value, Distribution):
        raise Wrong(f" = {value!r}; use Uniform, LogUniform, Normal or Choice")
    return value


@value("Draw {parameter}", OptionError)
class Draw:
    """A parameter and the distribution that it is drawn from.

    Attributes:
        parameter: its path; with [*] for the members, such as structure.rods[*].mass, a draw for each of them.
        distribution: `Uniform`, `LogUniform`, `Normal` or `Choice`.
        scaled: whether what is drawn is a factor on what the parameter was.
    """

    parameter: str = field(PATH)
    distribution: Distribution = field(Kind(_distribution))
    scaled: bool = field(kinds.flag(), default=False)

    def sample(self, generator: np.random.Generator) -> Any:
        """Draw one value, as points hold it."""
        value = self.distribution.sample(generator)
        return encoded(Scaled(value)) if self.scaled else encoded(value)
