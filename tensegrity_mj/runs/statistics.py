"""Statistics of long runs: means, deviations, extremes, significant responses, and cycles by the rainflow method.

    found = run.statistics("tension", after=100.0)
    found.deviation, found.significant             # (K,) of the strings, `found.names`
    found.cycles("s1")                             # (C, 3): range, mean and count of each cycle (ASTM E1049-85)

Waves of a signal are counted from each crossing of its mean upwards to the next, as waves of the sea are; the
significant response is the mean height, from the lowest to the highest value, of the highest third of them. Of a narrow
spectrum that is four standard deviations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tensegrity_mj.basics import checks
from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import check_known
from tensegrity_mj.basics.dependencies import of_extra, optional
from tensegrity_mj.basics.units import quantity as shown
from tensegrity_mj.errors import OptionError
from tensegrity_mj.runs.flow_regime import water_loads
from tensegrity_mj.runs.recorded import AXES, RecordedRun, labels_of

OF_WATER = {"water_load": "rod", "string_water_load": "string"}
UNITS = {"tension": "N", "rod_force": "N", "position": "m", "velocity": "m/s"} | dict.fromkeys(OF_WATER, "N")
MOST_SHOWN = 8  # signals of a text
MEASURES = ("mean", "deviation", "least", "greatest", "significant", "period")


@dataclass(frozen=True, eq=False, repr=False)
class Statistics:
    """Statistics of K signals of a run.

    Attributes:
        quantity, unit: what the signals are.
        names: (K,) of strings, of rods, or of nodes (members, for loads of water) with their axis, such as "n1.x".
            Strings with mass are there as wholes, and their parts come last.
        time: (T,) [s], two or more.
        values: (T, K).
        mean, deviation, least, greatest: (K,), the first two over time, also where samples are not even.
        significant: (K,) mean height of the highest third of waves; NaN where there is no whole one.
        period: (K,) [s] mean time between crossings of the mean upwards; NaN where there is no whole wave.
        parts: how many of the signals are of parts of strings with mass.
    """

    quantity: str
    unit: str
    names: tuple[str, ...]
    time: Array
    values: Array
    mean: Array
    deviation: Array
    least: Array
    greatest: Array
    significant: Array
    period: Array
    parts: int = 0

    @classmethod
    def of(
        cls, quantity: str, unit: str, names: tuple[str, ...], time: Array, values: Array, parts: int = 0
    ) -> Statistics:
        """The statistics of signals (T, K) at times (T,) [s]."""
        span = time[-1] - time[0]
        mean = np.trapezoid(values, time, axis=0) / span
        deviation = np.sqrt(np.trapezoid((values - mean) ** 2, time, axis=0) / span)
        significant, period = np.array([_waves(time, signal) for signal in (values - mean).T]).reshape(-1, 2).T
        extremes = values.min(axis=0), values.max(axis=0)
        return cls(quantity, unit, names, time, values, mean, deviation, *extremes, significant, period, parts)

    def cycles(self, name: str) -> Array:
        """Range, mean and count (1 or 1/2) of each cycle of a signal (C, 3), in the order in which they close.

        Raises:
            OptionError: where there is no such signal.
        """
        rainflow = optional("rainflow", "the count of cycles", of_extra("fatigue"))

        check_known(f"statistics of {self.quantity}", name, self.names, "signal")
        series = self.values[:, self.names.index(name)].tolist()
        return np.array([cycle[:3] for cycle in rainflow.extract_cycles(series)], float).reshape(-1, 3)

    def equivalent_range(self, name: str, exponent: float, count: float = 1.0) -> float:
        """The range that `count` cycles need to do the damage of all, Σ n rᵐ, m being the exponent of an S-N curve.

        Raises:
            OptionError: where there is no such signal, and for an exponent or a count that is not > 0.
        """
        exponent, count = checks.positive("exponent", exponent), checks.positive("count", count)
        ranges, _, counts = self.cycles(name).T
        largest = ranges.max(initial=0.0) or 1.0  # of which powers cannot overflow
        return float(largest * (counts @ (ranges / largest) ** exponent / count) ** (1 / exponent))

    def report(self) -> dict[str, Any]:
        """Plain values, for JSON, by the names of the signals; `cycles` is their number by the rainflow method."""
        rows = {name: {one: float(getattr(self, one)[k]) for one in MEASURES} for k, name in enumerate(self.names)}
        return {name: row | {"cycles": float(self.cycles(name)[:, 2].sum())} for name, row in rows.items()}

    def lines(self) -> list[tuple[str, str]]:
        """Name and words of those signals whose greatest magnitude is largest, those of parts after all others."""
        is_part = np.arange(len(self.names)) >= len(self.names) - self.parts
        largest = np.lexsort((-np.maximum(np.abs(self.least), np.abs(self.greatest)), is_part))[:MOST_SHOWN]
        return [(self.names[k], self._words(k)) for k in largest.tolist()]

    def _words(self, k: int) -> str:
        mean, deviation, least, greatest, significant = (
            shown(float(getattr(self, one)[k]), self.unit) for one in MEASURES[:5]
        )
        count = self.cycles(self.names[k])[:, 2].sum()
        return (
            f"mean {mean}, deviation {deviation}, from {least} to {greatest}, significant {significant}, "
            f"{count:g} cycles"
        )

    def __repr__(self) -> str:
        parts = f" and {self.parts} parts" if self.parts else ""
        head = f"{self.quantity} of {len(self.names) - self.parts}{parts}, {self.time[0]:g} to {self.time[-1]:g} s"
        return "\n".join([head, *(f"{name}: {words}" for name, words in self.lines())])


def statistics(run: RecordedRun, quantity: str = "tension", after: float = 0.0) -> Statistics:
    """The statistics of what a run recorded from a time on.

    Args:
        run: recorded often enough for its fastest motion of interest; only samples count.
        quantity: "tension", "rod_force" (negative in compression), "position", "velocity", "water_load" (of rods) or
            "string_water_load".
        after: [s], where it has settled.

    Raises:
        OptionError: for another quantity, and where fewer than two samples are left.
    """
    after = checks.finite("after", after, " [s]")
    check_known("statistics", quantity, UNITS, "quantity")
    later, labels = run.time >= after, labels_of(run.scene)
    if later.sum() < 2:
        raise OptionError(f"statistics: after = {after!r} s leaves {later.sum()} samples of the run; two are needed")
    of, parts = OF_WATER.get(quantity), 0
    if quantity in ("tension", "rod_force"):
        members = labels["string" if quantity == "tension" else "rod"]
        found = (run.tensions if quantity == "tension" else run.rod_forces)[..., None]
    else:
        members = labels[of or "node"]
        found = water_loads(run, of) if of else run.nodes if quantity == "position" else run.velocities
    if run.scene.structure.ropes and (quantity == "tension" or of == "string"):
        members, found, parts = _as_given(run, members, found, quantity == "tension")
    axes = [""] if found.shape[-1] == 1 else [f".{axis}" for axis in AXES]
    names = tuple(f"{member}{axis}" for member in members for axis in axes)
    values = found.reshape(len(run.time), -1)[later]
    return Statistics.of(quantity, UNITS[quantity], names, run.time[later], values, parts * len(axes))


def _as_given(
    run: RecordedRun, names: Sequence[str], values: Array, is_mean: bool
) -> tuple[tuple[str, ...], Array, int]:
    """Regroup strings' values (T, M, k): those of strings as given, then those of the parts of strings with mass.

    A whole has the mean of its parts by their shares, or else their sum. Returns how many parts there are, too.
    """
    parts = [part.name for rope in run.scene.structure.ropes for part in rope.parts]
    given = [string.name for string in run.scene.structure.given.strings]
    weights = np.zeros((len(given) + len(parts), len(names)))
    for row, name in enumerate((*given, *parts)):
        own, shares = run.parts_of(name)
        weights[row, own] = shares if is_mean else 1.0
    return (*given, *parts), np.einsum("gm,tmk->tgk", weights, values), len(parts)


def _waves(time: Array, signal: Array) -> tuple[float, float]:
    """The significant height and the mean period of a signal (T,) about zero; NaN without a whole wave."""
    starts = np.flatnonzero((signal[:-1] <= 0) & (signal[1:] > 0)) + 1
    if len(starts) < 2:
        return np.nan, np.nan
    inside = signal[: starts[-1]]
    heights = np.maximum.reduceat(inside, starts[:-1]) - np.minimum.reduceat(inside, starts[:-1])
    highest = np.sort(heights)[-max(1, round(len(heights) / 3)) :]
    before, after = starts - 1, starts
    crossings = time[before] - signal[before] * (time[after] - time[before]) / (signal[after] - signal[before])
    return float(highest.mean()), float((crossings[-1] - crossings[0]) / len(heights))
