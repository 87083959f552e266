"""What a sweep goes through: values of parameters, several together, and seeded random draws."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tensegrity_mj.basics.checks import finite, positive
from tensegrity_mj.errors import OptionError
from tensegrity_mj.studies.parameter_values import Scaled, encoded
from tensegrity_mj.studies.plain import plain


@dataclass(frozen=True)
class Vary:
    """A parameter and the values that it takes.

    Attributes:
        parameter: its path (see `parameters`).
        values: plain values, or `Scaled(factor)`.
    """

    parameter: str
    values: Sequence[Any]

    def __post_init__(self) -> None:
        _path("Vary", self.parameter)
        values = _values(f"Vary {self.parameter}", self.values)
        object.__setattr__(self, "values", tuple(values))


@dataclass(frozen=True)
class Together:
    """Parameters that go through their values together, the first of each, the second of each, ..."""

    axes: Sequence[Vary]

    def __post_init__(self) -> None:
        axes = tuple(self.axes)
        if not axes or not all(isinstance(axis, Vary) for axis in axes):
            raise OptionError(f"Together: axes = {self.axes!r}; give a list of Vary(parameter, values)")
        lengths = {axis.parameter: len(axis.values) for axis in axes}
        if len(set(lengths.values())) > 1:
            counts = ", ".join(f"{name}: {count}" for name, count in lengths.items())
            raise OptionError(f"Together: parameters that go together need as many values each ({counts})")
        object.__setattr__(self, "axes", axes)


@dataclass(frozen=True)
class Uniform:
    """Evenly between low and high."""

    low: float
    high: float

    def __post_init__(self) -> None:
        _interval("Uniform", self.low, self.high)

    def sample(self, generator: np.random.Generator) -> Any:
        """One draw."""
        return float(generator.uniform(self.low, self.high))


@dataclass(frozen=True)
class LogUniform:
    """Between low and high, both > 0, the logarithm evenly."""

    low: float
    high: float

    def __post_init__(self) -> None:
        positive("LogUniform: low", self.low)
        _interval("LogUniform", self.low, self.high)

    def sample(self, generator: np.random.Generator) -> Any:
        """One draw."""
        value = math.exp(generator.uniform(math.log(self.low), math.log(self.high)))
        return min(max(value, self.low), self.high)


@dataclass(frozen=True)
class Normal:
    """Normally distributed."""

    mean: float
    deviation: float

    def __post_init__(self) -> None:
        finite("Normal: mean", self.mean)
        positive("Normal: deviation", self.deviation)

    def sample(self, generator: np.random.Generator) -> Any:
        """One draw."""
        return float(generator.normal(self.mean, self.deviation))


@dataclass(frozen=True)
class Choice:
    """One of some values, each as likely."""

    values: Sequence[Any]

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", tuple(_values("Choice", self.values)))

    def sample(self, generator: np.random.Generator) -> Any:
        """One draw."""
        return self.values[int(generator.integers(len(self.values)))]


Distribution = Uniform | LogUniform | Normal | Choice


@dataclass(frozen=True)
class Draw:
    """A parameter and the distribution that it is drawn from.

    Attributes:
        parameter: its path; with [*] for the members, such as structure.rods[*].mass, a draw for each of them.
        distribution: `Uniform`, `LogUniform`, `Normal` or `Choice`.
        scaled: whether what is drawn is a factor on what the parameter was.
    """

    parameter: str
    distribution: Distribution
    scaled: bool = False

    def __post_init__(self) -> None:
        _path("Draw", self.parameter)
        if not isinstance(self.distribution, Distribution):
            raise OptionError(
                f"Draw {self.parameter}: distribution = {self.distribution!r}; "
                "use Uniform, LogUniform, Normal or Choice"
            )

    def sample(self, generator: np.random.Generator) -> Any:
        """One draw, as points hold it."""
        value = self.distribution.sample(generator)
        return encoded(Scaled(value)) if self.scaled else encoded(value)


@dataclass(frozen=True)
class Grid:
    """Every combination of the axes, the last fastest, each with every sample of the draws.

    Sample j of a seed is the same at every combination, and whatever the number of samples: combinations are compared
    under equal conditions, and a larger study contains the smaller one.
    """

    axes: Sequence[Vary | Together] = ()
    draws: Sequence[Draw] = ()
    samples: int = 1
    seed: int | None = None
    fixed: Mapping[str, Any] = field(default_factory=dict)

    def points(self) -> Iterator[dict[str, Any]]:
        """Path -> value, as points hold it."""
        groups = [axis.axes if isinstance(axis, Together) else (axis,) for axis in self.axes]
        rows = [list(zip(*(axis.values for axis in group), strict=True)) for group in groups]
        names = [[axis.parameter for axis in group] for group in groups]
        samples = [self.sample(number) for number in range(self.samples)]
        fixed = {name: encoded(value) for name, value in self.fixed.items()}
        for combination in itertools.product(*rows):
            settings = dict(fixed)
            for group, values in zip(names, combination, strict=True):
                settings |= {name: encoded(value) for name, value in zip(group, values, strict=True)}
            for sample in samples:
                yield settings | sample

    def sample(self, number: int) -> dict[str, Any]:
        """The draws of one sample."""
        if not self.draws:
            return {}
        assert self.seed is not None
        generator = np.random.default_rng([self.seed, number])
        return {draw.parameter: draw.sample(generator) for draw in self.draws}


def _path(what: str, parameter: Any) -> None:
    if not isinstance(parameter, str) or not parameter:
        raise OptionError(f"{what}: parameter = {parameter!r}; it must be a text, such as law.decay_rate")


def _values(what: str, values: Any) -> list[Any]:
    if isinstance(values, (str, Mapping, Scaled)) or not hasattr(values, "__iter__"):
        raise OptionError(f"{what}: values = {values!r}; give a list of them")
    listed = [value if isinstance(value, Scaled) else plain(value, what) for value in values]
    if not listed:
        raise OptionError(f"{what}: give at least one value")
    return listed


def _interval(what: str, low: Any, high: Any) -> None:
    if not finite(f"{what}: low", low) <= finite(f"{what}: high", high):
        raise OptionError(f"{what}: low = {low!r} is above high = {high!r}; give the lower one first")
