"""Measures that chapter 3 takes of runs of the cable: amplitudes and peaks about its eigenfrequencies."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from evidence.families.cables import MARKERS, pendulum_frequency
from evidence.thesis.chapter3.series import SHOWN, SeriesRun
from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.library.cable import (
    FASTENING_LENGTH,
    LOAD_LENGTH,
    ROPE_LENGTH,
    arc_lengths,
)

# Hz: between the first two eigenfrequencies, and where the second one is felt, by amplitude or whirling.
BETWEEN, SECOND = 0.6, (0.775, 1.075)
BESIDE = 0.035  # Hz from a frequency, within which a peak is its own: one and a half bins of 45 s


# ------------------------------------------------------------------------------------------------------- the model


def element_frequencies(elements: int) -> tuple[float, float, float]:
    """(3.28) [Hz] of an element of the fastening, of the rope and of the load; K of §3.5.1."""
    divisions = (elements - 1) // 12
    lengths = FASTENING_LENGTH / divisions, ROPE_LENGTH / (11 * divisions), LOAD_LENGTH
    fastening, rope, load = (pendulum_frequency(length) for length in lengths)
    return fastening, rope, load


def markers_off() -> float:
    """Largest distance [m] of a marker of Table 3.2 from a node of the model of 13 elements."""
    away = np.abs(np.subtract.outer(MARKERS, arc_lengths(13) - FASTENING_LENGTH))
    return float(away.min(axis=1).max())


# ------------------------------------------------------------------------------------------------------ amplitudes


def swings(run: SeriesRun, number: int, axis: int = 0) -> Array:
    """(C,) relative amplitudes of a marker of the figures along an axis."""
    return run.cases.relative[:, SHOWN.index(number), axis]


def peak_input(run: SeriesRun, marker: int, second: bool) -> float:
    """Input frequency of the largest in-plane amplitude above `BETWEEN`, or below it."""
    f = run.cases.frequencies
    return float(f[np.argmax(np.where(f > BETWEEN if second else f < BETWEEN, swings(run, marker), 0.0))])


def about(run: SeriesRun, second: bool) -> NDArray[np.bool_]:
    """The input frequencies about the second eigenfrequency, or about the first."""
    f = run.cases.frequencies
    return (f > SECOND[0]) & (f < SECOND[1]) if second else (f > 0.225) & (f < 0.425)


def largest(run: SeriesRun, marker: int, axis: int, second: bool | None = None) -> float:
    """Largest amplitude along an axis, of all inputs or of those about one eigenfrequency."""
    values = swings(run, marker, axis)
    return float(values.max() if second is None else values[about(run, second)].max())


def has(peaks: tuple[float, ...], low: float, high: float) -> bool:
    """Return whether a peak is in a range [Hz], or `BESIDE` it."""
    return any(low - BESIDE <= peak <= high + BESIDE for peak in peaks)


def other_peaks(run: SeriesRun, marker: int, frequency: float) -> int:
    """Return the number of main peaks without the largest, at an input frequency [Hz]."""
    return len(run.peaks(marker)[int(np.argmin(np.abs(run.cases.frequencies - frequency)))]) - 1


def input_part(run: SeriesRun, marker: int) -> float:
    """Return the part of the input frequencies at which a main peak is at the input."""
    rows = zip(run.cases.frequencies, run.peaks(marker), strict=True)
    return float(np.mean([has(peaks, f, f) for f, peaks in rows]))


def present_from(run: SeriesRun, marker: int, low: float, high: float) -> float:
    """The lowest input frequency with a main peak in a range that is not the input's own."""
    for f, peaks in zip(run.cases.frequencies, run.peaks(marker), strict=True):
        if any(low <= peak <= high and abs(peak - f) > BESIDE for peak in peaks):
            return float(f)
    return math.nan


def first_part(run: SeriesRun, marker: int, low: float, high: float, axis: int = 0) -> float:
    """Return the part of the input frequencies in a range at which the first eigenfrequency has a main peak."""
    rows = zip(run.cases.frequencies, run.peaks(marker, axis), strict=True)
    return float(np.mean([has(peaks, 0.324, 0.324) for f, peaks in rows if low - 1e-9 <= f <= high + 1e-9]))


def out_of_plane_peaks(run: SeriesRun, marker: int) -> float:
    """Lowest frequency of the largest out-of-plane peak of a run, among runs with whirling about the second one."""
    whirling = about(run, True) & (swings(run, marker, 1) > 1.0)
    return min(peaks[0] for peaks, yes in zip(run.peaks(marker, 1), whirling, strict=True) if yes)


def elements_of(run: SeriesRun) -> Array:
    """(C,) numbers of elements of the cases, or of the steps that were found."""
    if run.results is None:
        return np.array([one.elements for one in run.steps if math.isfinite(one.step)])
    return np.array([len(case.scene.structure.rods) for case in run.cases.cases])


def first_beyond(run: SeriesRun) -> float:
    """Return the number of elements from which on cases failed, half of the way to the one before; NaN for none."""
    failed = run.cases.failed
    return float(elements_of(run)[failed[0]]) - 6.0 if failed else math.nan


def drift_of_failed(run: SeriesRun) -> Array:
    """(C,) the drift of the cases that did not complete; NaN for the others."""
    return np.where(np.isin(np.arange(len(run.cases.drift)), run.cases.failed), run.cases.drift, np.nan)


def drift_trend(run: SeriesRun) -> float:
    """Spearman's correlation of the drift and the input frequency."""
    order = np.argsort(np.argsort(run.cases.drift))
    return float(np.corrcoef(order, np.arange(len(order)))[0, 1])


def refined_apart(*runs: SeriesRun) -> float:
    """Largest difference of relative amplitudes of marker 10 between models, away from the second one."""
    amplitudes = np.array([swings(run, 10) for run in runs])
    f = runs[0].cases.frequencies
    away = (f < 0.775) | (f > SECOND[1])
    return float(np.ptp(amplitudes[:, away], axis=0).max())


def violence(run: SeriesRun) -> float:
    """Amplitude of marker 10 at 1.20 Hz over the mean of those at 1.10 and 1.15 Hz."""
    values = dict(zip(np.round(run.cases.frequencies, 2), swings(run, 10), strict=True))
    return float(values[1.2] / (0.5 * (values[1.1] + values[1.15])))


def drift_falls(run: SeriesRun) -> bool:
    """Return whether the drift of the models that ran falls with the number of elements."""
    drift = run.cases.drift[~np.isnan(run.cases.drift)]
    return len(drift) > 1 and bool(drift[-1] < drift[0])
