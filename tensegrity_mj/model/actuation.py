"""Actuation: what happens to the rest lengths between two evaluations of the law. One meaning in every engine."""

from __future__ import annotations

import enum
import math

from tensegrity_mj.basics.fields import field, refused, value
from tensegrity_mj.basics.kinds import choice, positive
from tensegrity_mj.errors import OptionError


class Mode(enum.Enum):
    """Quantity that is held between control samples."""

    CONTINUOUS = "continuous"
    HOLD_FORCE_DENSITY = "hold force density"
    HOLD_REST_LENGTH = "hold rest length"


class OnInfeasible(enum.Enum):
    """Action of a run where the law has no admissible solution."""

    STOP = "stop"  # end there, with status infeasible
    PASSIVE = "passive"  # hold the last admissible rest lengths until it is solvable again


@value(error=OptionError)
class Actuation:
    """Way in which a law drives the rest lengths; use the three constructors.

    All three set the rest length:
        continuous: the law is evaluated at every stage of the integrator.
        hold_force_density: sampled each `period`; L0 = L (1 - u/k) is renewed as the string moves.
        hold_rest_length: sampled each `period`; L0 stands still between samples, as a winch would hold it.
    """

    mode: Mode = field(choice(Mode), default=Mode.CONTINUOUS, key="actuation mode")
    period: float | None = field(positive("s"), default=None, none="None", key="control period")

    @classmethod
    def continuous(cls) -> Actuation:
        """The law at every stage."""
        return cls(Mode.CONTINUOUS, None)

    @classmethod
    def hold_force_density(cls, period: float) -> Actuation:
        """The force density sampled each `period` [s]."""
        return cls(Mode.HOLD_FORCE_DENSITY, period)

    @classmethod
    def hold_rest_length(cls, period: float) -> Actuation:
        """The rest length sampled each `period` [s]."""
        return cls(Mode.HOLD_REST_LENGTH, period)

    def __attrs_post_init__(self) -> None:
        if self.mode is Mode.CONTINUOUS and self.period is not None:
            raise refused(self, f"control period = {self.period!r}: the continuous mode has none; leave it out")
        if self.mode is not Mode.CONTINUOUS and self.period is None:
            raise refused(self, "control period = None; it must be > 0 s")


def whole_ratio(larger: float, smaller: float, what: str) -> int:
    """larger / smaller as an integer.

    Raises:
        OptionError: if it is none within 1e-9, naming the nearest values that would do.
    """
    ratio = larger / smaller
    if not ratio < 2**53:
        raise OptionError(
            f"{what}: {larger:.6g} s over {smaller:.6g} s are more steps than can be counted; make the first smaller"
        )
    count = round(ratio)
    if count < 1 or abs(ratio - count) > 1e-9 * max(1.0, ratio):
        low, high = max(1, math.floor(ratio)), max(1, math.floor(ratio)) + 1
        part = f"{larger:.12g}/{count}" if count > 1 else f"{larger:.12g}"
        raise OptionError(
            f"{what}: {larger:.12g} s is no multiple of {smaller:.12g} s (ratio {ratio:.9g}); "
            f"use {low * smaller:.12g} s or {high * smaller:.12g} s, or {part} s in place of {smaller:.12g} s"
        )
    return count
