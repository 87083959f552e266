"""Which steps a run can have so that its duration, samples, control periods, breaks and data are multiples of them."""

from __future__ import annotations

import math
from dataclasses import dataclass

from tensegrity_mj.engines.driving import DEFAULT_INTERVAL
from tensegrity_mj.engines.request import Request
from tensegrity_mj.errors import OptionError

COARSEST = 0.1  # s; steps are begun with here, where nothing requires less
FEWEST_STEPS = 20  # of the coarsest run
AS_ONE = 1e-9  # relative: what `whole_ratio` takes for a multiple
MOST_FINER = 16  # times, that steps are finer than they need be, so that they end at kinks of data
FINEST = 1e-6  # of the duration: times whose common divisor is less have none


@dataclass(frozen=True)
class Steps:
    """Steps unit / k, k = 1, 2, 4, 8, ...

    Attributes:
        unit: [s], the coarsest. A finer run records all times that a coarser one does, so that what is wrong for a
            moment only is compared too.
        count: of steps of that length in the run.
        interval: [s] between samples where the caller requested it, or None.
        aligned: whether they end at all kinks of data (`Request.kinks`).
    """

    unit: float
    count: int
    interval: float | None
    aligned: bool = True

    @classmethod
    def of(cls, request: Request, longest: float) -> Steps:
        """The steps of a request.

        Args:
            longest: [s], the coarsest step at most.

        Raises:
            OptionError: where duration, output interval, control period and breaks have no common divisor.
        """
        times = request.intervals
        base = common_divisor(list(times.values()), request.duration)
        if base is None:
            shown = ", ".join(f"{name} {value:.12g} s" for name, value in times.items())
            raise OptionError(f"accuracy: no step divides all of {shown}; use round numbers")
        most = min(COARSEST, request.duration / FEWEST_STEPS, longest)
        finer = common_divisor([base, *request.kinks], request.duration)
        aligned = finer is not None and (finer == base or finer >= most / MOST_FINER)
        base = finer if finer is not None and aligned else base
        unit = base / max(1, math.ceil(base / most * (1 - AS_ONE)))
        return cls(unit, round(request.duration / unit), request.output_interval, aligned)

    def fit(self, step: float) -> float:
        """The coarsest of them that is not coarser than this one [s]."""
        return self.unit / _power_of_two(self.unit / step)

    def recorded_each(self, step: float) -> float:
        """[s] between samples of its run: 0.005 to 0.01 s, a step at least, and multiples of unit hit."""
        if self.interval is not None:
            return self.interval
        if self.unit <= DEFAULT_INTERVAL:
            # Samples are counted from 0, and the unit divides the duration.
            return self.unit * math.floor(DEFAULT_INTERVAL / self.unit * (1 + AS_ONE))
        k = _power_of_two(self.unit / step)
        return step * (k // min(k, _power_of_two(self.unit / DEFAULT_INTERVAL)))


def _power_of_two(least: float) -> int:
    """The smallest that is not less, round-off apart."""
    return 1 << max(0, math.ceil(math.log2(max(least * (1 - AS_ONE), 1.0))))


def common_divisor(times: list[float], duration: float) -> float | None:
    """The largest number of which all are multiples, by Euclid's algorithm; None if that is next to nothing."""
    divisor = times[0]
    for time in times[1:]:
        a, b = max(divisor, time), min(divisor, time)
        while b > AS_ONE * max(divisor, time):
            a, b = b, abs(a - round(a / b) * b)
        divisor = a
    # Remainders gather round-off: the divisor of the first time is exact.
    return None if divisor < FINEST * duration else times[0] / round(times[0] / divisor)
