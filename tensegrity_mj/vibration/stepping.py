"""Description of an engine's steps, for the stability of small motions; every engine has one as `stepping`."""

from __future__ import annotations

import enum
from dataclasses import dataclass


class Scheme(enum.Enum):
    """The integrators that differ for small motions about a state of rest."""

    SEMI_IMPLICIT = "semi-implicit Euler"
    VELOCITY_IMPLICIT = "Euler, implicit in velocity"
    LINEARLY_IMPLICIT = "Euler, implicit in position and velocity"
    RUNGE_KUTTA = "classical Runge-Kutta"


@dataclass(frozen=True)
class Stepping:
    """Steps of an engine with its options. `Stepping()` for one that chooses its steps itself, or is not known here.

    Attributes:
        scheme: of its fixed steps, or None.
        timestep: [s] of these, or None where it chooses them or has none yet.
        constraints: eigenvalues [1/s] of the constraints that it also stabilizes.
        polar: whether the directions of rods in space are angles with a pole at the z axis, of class 1 alone.
        against_strings: an option that helps where a string limits the step, in words for messages; "" for none.
        against_all: one that helps in every case.
        by_accuracy: whether it takes an accuracy in place of a step.
    """

    scheme: Scheme | None = None
    timestep: float | None = None
    constraints: tuple[complex, ...] = ()
    polar: bool = False
    against_strings: str = ""
    against_all: str = ""
    by_accuracy: bool = False
