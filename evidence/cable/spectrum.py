"""Power spectral densities of a marker's motion, and which of their peaks are picked (§3.3.4)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.fields import field, value
from tensegrity_mj.basics.kinds import number
from tensegrity_mj.errors import OptionError

UNIFORM = 1e-6  # of the interval: what samples may be off equal distances


@dataclass(frozen=True, eq=False)
class Spectrum:
    """A one-sided power spectral density.

    Attributes:
        frequency: (F,) [Hz], at multiples of one over the length of the record.
        density: (F,) [m²/Hz].
    """

    frequency: Array
    density: Array

    def until(self, frequency: float) -> Spectrum:
        """The part up to a frequency [Hz]."""
        kept = self.frequency <= frequency * (1 + 1e-12)
        return Spectrum(self.frequency[kept], self.density[kept])


@dataclass(frozen=True)
class Peak:
    """A peak of a spectrum.

    Attributes:
        frequency: [Hz].
        density: [m²/Hz].
    """

    frequency: float
    density: float


PART = number("in (0, 1]", lambda x: 0 < x <= 1)


@value("PeakCriteria", OptionError)
class PeakCriteria:
    """Criteria by which peaks are picked, in addition to the largest of each run; a peak meets one of the two.

    Attributes:
        local: of the largest peak in the same run.
        overall: of the largest peak among all runs.
    """

    local: float = field(PART, default=0.10)
    overall: float = field(PART, default=0.01)


def spectrum(time: ArrayLike, values: ArrayLike) -> Spectrum:
    """The power spectral density of a motion about its mean: a periodogram with Hann's window over the whole record.

    The window's main lobe is two bins wide to each side; its side lobes are below 7e-4 of a peak.

    Args:
        time: (T,) [s], at equal distances, 16 or more.
        values: (T,) [m].

    Raises:
        OptionError: for other times or values.
    """
    from scipy.signal import periodogram

    t, x = np.asarray(time, float), np.asarray(values, float)
    if t.ndim != 1 or t.shape != x.shape or len(t) < 16 or not np.all(np.isfinite(x)):
        raise OptionError(f"spectrum: times {t.shape} and values {x.shape}; they must be (T,) of 16 or more, finite")
    steps = np.diff(t)
    interval = float(t[-1] - t[0]) / (len(t) - 1)
    if not interval > 0 or np.abs(steps - interval).max() > UNIFORM * interval:
        raise OptionError("spectrum: the times must be at equal distances; interpolate the motion first")
    frequency, density = periodogram(x, 1.0 / interval, window="hann", detrend="constant")
    return Spectrum(frequency, density)


def peaks_of(found: Spectrum, least: float = 1e-3) -> tuple[Peak, ...]:
    """The local maxima of a spectrum, largest first.

    Between bins a peak is that of the parabola through the logarithms of three densities, which a harmonic's main lobe
    nearly is: its frequency is right to 0.04 bins (0.9 mHz in 45 s), its height to 8 %.

    Args:
        found: the spectrum.
        least: of the largest one, below which a maximum is none; side lobes are below 7e-4.
    """
    from scipy.signal import find_peaks

    density = found.density
    if not len(density) or not density.max() > 0:
        return ()
    # A zero at the end: a maximum at the highest frequency is one too. At 0 Hz there is what is left of the mean.
    at = find_peaks(np.append(density, 0.0), height=least * float(density.max()))[0]
    peaks = []
    for k in at:
        shift, height = 0.0, float(density[k])
        if 0 < k < len(density) - 1 and density[k - 1] > 0 and density[k + 1] > 0:
            low, middle, high = np.log(density[k - 1 : k + 2])
            bend = low - 2.0 * middle + high
            if bend < 0:
                shift = float(0.5 * (low - high) / bend)
                height = float(np.exp(middle - 0.25 * (low - high) * shift))
        bin_width = float(found.frequency[1] - found.frequency[0])
        peaks.append(Peak(float(found.frequency[k]) + shift * bin_width, height))
    return tuple(sorted(peaks, key=lambda peak: -peak.density))


def picked(runs: Sequence[Sequence[Peak]], criteria: PeakCriteria | None = None) -> list[tuple[Peak, ...]]:
    """The main peaks of each of several runs of one marker, by the criteria of §3.3.4, largest first.

    Args:
        runs: the peaks of each run, as `peaks_of` finds them.
        criteria: the thesis' by default.
    """
    criteria = criteria or PeakCriteria()
    top = max((peak.density for run in runs for peak in run), default=0.0)
    chosen = []
    for run in runs:
        own = max((peak.density for peak in run), default=0.0)
        bound = min(criteria.local * own, criteria.overall * top, own)
        chosen.append(tuple(peak for peak in run if peak.density >= bound))
    return chosen
