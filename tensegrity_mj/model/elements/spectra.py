"""Irregular seas: the spectra of Pierson and Moskowitz and of JONSWAP, cut into components of equal energy.

By the significant height H_s and the peak period T_p = 2 π / ω_p, with the enhancement γ (1 for Pierson and Moskowitz),

    S(ω) = c · 5/16 H_s² ω_p⁴ ω⁻⁵ exp(-5/4 (ω_p/ω)⁴) γ^r,   r = exp(-(ω/ω_p - 1)² / 2 σ²),   σ = 0.07 (0.09 above ω_p)

and c such that the elevation has the variance ∫ S dω = H_s²/16: 1 for γ = 1, and otherwise found by quadrature, not by
the usual fit 1 - 0.287 ln γ, which is 0.2 % off for γ = 3.3. For γ = 1, e(ω) = exp(-5/4 (ω_p/ω)⁴) is the part of the
energy below ω. In e for ω the spectrum is c γ^r on [0, 1], without tails, so that nothing of it is cut off.

**Bins of equal energy.** N components have one amplitude, H_s/√(8 N), which keeps the variance exactly, and each the
frequency that halves the energy of its bin. Bins of equal width would let the sea repeat itself after 2 π / Δω: 100 of
them between ½ ω_p and 4 ω_p after 28 peak periods. Here no two frequencies have a common period, most components are
where the energy is, and the last one is at 4 ω_p for N = 100. What is lost is in the tail: ∫ ω² S dω is too small by
0.34/√N of itself for γ = 1, the mean period between zero crossings 0.17/√N too long (1.7 % for 100).

Phases are even over the circle, by the seed and the same on every machine (`numpy.random.RandomState`, whose numbers
are frozen). The elevation is a sum of N sines of one amplitude: its kurtosis is 3 - 3/(2 N), that of a real sea 3.
"""

from __future__ import annotations

import enum
import math
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.fields import field, refused, value
from tensegrity_mj.basics.kinds import choice, finite, positive, whole, within
from tensegrity_mj.model.elements.waves import Wave

MOST_COMPONENTS = 1000
NARROW, WIDE = 0.07, 0.09  # σ of JONSWAP, up to the peak and above
CELLS = 50_000  # of e: the midpoint rule is then off by 1e-9 of the energy, γ^r bending by 330 at most for γ = 7


class Shape(enum.Enum):
    """How the energy of a sea lies around its peak."""

    JONSWAP = "jonswap"  # of a growing sea under wind, with a sharp peak
    PIERSON_MOSKOWITZ = "pierson_moskowitz"  # of a fully grown one


@value("sea", whole=True)
class IrregularSea:
    """A sea by its spectrum; long-crested.

    Attributes:
        spectrum: see `Shape`.
        significant_height: H_s [m], > 0: four standard deviations of the elevation.
        peak_period: T_p [s], > 0, of the most energetic component.
        seed: of the phases, from 0 to 4294967295.
        components: N, from 1 to 1000.
        direction: to which it travels [rad], from the x axis towards the y axis.
        peak_enhancement: γ of JONSWAP, from 1 to 7; None for 3.3.
    """

    spectrum: Shape = field(choice(Shape))
    significant_height: float = field(positive("m"))
    peak_period: float = field(positive("s"))
    seed: int = field(whole(0, 2**32 - 1), default=0)
    components: int = field(whole(1, MOST_COMPONENTS), default=100)
    direction: float = field(finite("rad"), default=0.0)
    peak_enhancement: float | None = field(within(1.0, 7.0), default=None, none="None for 3.3")

    def __attrs_post_init__(self) -> None:
        if self.spectrum is Shape.PIERSON_MOSKOWITZ and self.peak_enhancement is not None:
            raise refused(self, "the spectrum of Pierson and Moskowitz has no peak_enhancement: leave it out")

    @property
    def gamma(self) -> float:
        """γ."""
        if self.spectrum is Shape.PIERSON_MOSKOWITZ:
            return 1.0
        return 3.3 if self.peak_enhancement is None else self.peak_enhancement

    def density(self, angular_frequency: ArrayLike) -> Array:
        """S(ω) [m² s/rad] at frequencies > 0 [rad/s]; in water of any depth, as measured there."""
        peak = 2 * math.pi / self.peak_period
        ratio = np.asarray(angular_frequency, float) / peak
        smooth = 5 / 16 * self.significant_height**2 / peak * ratio**-5 * np.exp(-1.25 * ratio**-4)
        return np.asarray(smooth * _enhanced(ratio, self.gamma) / self._energies[-1])

    @cached_property
    def frequencies(self) -> Array:
        """(N,) ω of the components [rad/s], increasing."""
        parts = (np.arange(self.components) + 0.5) / self.components
        e = np.interp(parts * self._energies[-1], self._energies, np.linspace(0, 1, CELLS + 1))
        return np.asarray(2 * math.pi / self.peak_period * _ratio(e))

    @cached_property
    def waves(self) -> tuple[Wave, ...]:
        """The components."""
        amplitude = self.significant_height / math.sqrt(8 * self.components)
        phases = np.random.RandomState(self.seed).uniform(0, 2 * math.pi, self.components)
        pairs = zip(self.frequencies.tolist(), phases.tolist(), strict=True)
        return tuple(Wave(amplitude, None, omega, self.direction, phase) for omega, phase in pairs)

    @cached_property
    def _energies(self) -> Array:
        """∫ γ^r de from 0 to each end of the cells, (CELLS + 1,)."""
        middles = _ratio((np.arange(CELLS) + 0.5) / CELLS)
        return np.concatenate([[0.0], np.cumsum(_enhanced(middles, self.gamma)) / CELLS])


def _ratio(e: Array) -> Array:
    """ω/ω_p below which the part e of the energy of Pierson and Moskowitz' spectrum lies."""
    return np.asarray((-0.8 * np.log(e)) ** -0.25)


def _enhanced(ratio: Array, gamma: float) -> Array:
    """γ^r."""
    width = np.where(ratio <= 1, NARROW, WIDE)
    return np.asarray(gamma ** np.exp(-0.5 * ((ratio - 1) / width) ** 2))
