"""Laws as hand-written ones go wrong, and laws that are right and command the extreme."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array


def _one_string(bad: float) -> Callable[[Array], Any]:
    def spoil(u: Array) -> Array:
        u = u.copy()
        u[len(u) // 2] = bad
        return u

    return spoil


def _raising(u: Array) -> Any:
    forces: dict[str, float] = {}
    return forces["no such string"]


# Values that a law returns from some time on in place of u (M,).
MISTAKES: dict[str, Callable[[Array], Any]] = {
    "NaN for one string": _one_string(np.nan),
    "NaN for all": lambda u: u * np.nan,
    "infinity for one string": _one_string(np.inf),
    "minus infinity": _one_string(-np.inf),
    "one number too few": lambda u: u[:-1],
    "a column": lambda u: u[:, None],
    "a scalar": lambda u: float(u.sum()),
    "None": lambda u: None,
    "a text": lambda u: "tight",
    "complex numbers": lambda u: u + 1j,
    "an exception": _raising,
}


@dataclass(frozen=True)
class GoesWrong:
    """A constant u (M,) [N/m] that turns into a mistake at a time [s]."""

    u: Array
    mistake: str
    time: float

    def __call__(self, time: float, nodes: Array, velocities: Array) -> Any:
        return self.u if time < self.time else MISTAKES[self.mistake](self.u)


@dataclass(frozen=True)
class Alternating:
    """u (M,) [N/m] and low · u by turns, a half period [s] each; it jumps, so it is run sampled."""

    u: Array
    low: float
    half_period: float
    discontinuous = "it jumps between two values"

    def __call__(self, time: float, nodes: Array, velocities: Array) -> Array:
        # Samples fall on the jumps: half of one is added so that round-off does not choose.
        turn = int(np.floor(time / self.half_period + 0.25))
        return self.u if turn % 2 == 0 else self.low * self.u


@dataclass(frozen=True)
class Waving:
    """u (M,) [N/m] times 1 + depth · sin(ω t + string number): smooth; beyond [0, 1] for depth > 1, constant for 0."""

    u: Array
    depth: float = 0.0
    frequency: float = 0.0

    def __call__(self, time: float, nodes: Array, velocities: Array) -> Array:
        return np.asarray(self.u * (1 + self.depth * np.sin(self.frequency * time + np.arange(len(self.u)))))
