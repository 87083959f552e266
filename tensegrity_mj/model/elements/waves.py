"""Linear (Airy) waves, superposed, and a constant current, in water of any depth.

The still surface is z = 0, the bottom z = -h. A component of amplitude A, wave number k, angular frequency ω, direction
χ and phase ε, with θ = ω t + ε - k (x cos χ + y sin χ), gives to first order in the steepness

    elevation         ζ = A sin θ                                                              (7.2)
    velocity          v = ω A (C cos χ sin θ, C sin χ sin θ, S cos θ)                          (7.4)
    acceleration      ∂v/∂t = ω² A (C cos χ cos θ, C sin χ cos θ, -S sin θ)                    (7.5)
    dynamic pressure  p = ρ g A cosh k(z+h) / cosh kh · sin θ
    dispersion        ω² = g k tanh kh

with C = cosh k(z+h) / sinh kh and S = sinh k(z+h) / sinh kh, both of them e^{kz} in deep water, as in the thesis. (Its
(7.5) prints cos χ for sin χ in the second row.) Everything is written in e^{kz} and e^{-2k(z+h)}, so that no depth
overflows. Waves and current do not act on each other: ω is that of still water, seen from the fixed frame, and the
acceleration is that of (7.5), without the part v·∇v of second order.

Irregular seas: the spectra of Pierson and Moskowitz and of JONSWAP, cut into components of equal energy.

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
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.fields import field, refused, value
from tensegrity_mj.basics.kinds import choice, finite, not_negative, positive, whole, within
from tensegrity_mj.errors import SceneError
from tensegrity_mj.model.members import Vector


class AboveLevel(enum.Enum):
    """Continuation of the waves' velocities and accelerations above the still surface, where linear theory has none.

    EXPONENTIAL takes the formulas as they are, as the thesis does: the fields stay solutions of Laplace's equation and
    meet the conditions of the linear free surface, but grow with height. CONSTANT takes the value at z = 0 instead,
    which is the usual choice where waves are much shorter than the highest crest is high, k ζ > 1.
    """

    EXPONENTIAL = "exponential"
    CONSTANT = "constant"


@value("wave", whole=True)
class Wave:
    """One component.

    Attributes:
        amplitude: A [m], >= 0: half the height.
        wavelength: 2 π / k [m], > 0; or None, and the angular frequency is given.
        angular_frequency: ω [rad/s], > 0; or None, and the wavelength is given.
        direction: χ [rad], to which it travels, from the x axis towards the y axis.
        phase: ε [rad].
    """

    amplitude: float = field(not_negative("m"))
    wavelength: float | None = field(positive("m"), default=None, none="None where the angular frequency is given")
    angular_frequency: float | None = field(positive("rad/s"), default=None, none="None where the wavelength is given")
    direction: float = field(finite("rad"), default=0.0)
    phase: float = field(finite("rad"), default=0.0)

    def __attrs_post_init__(self) -> None:
        if (self.wavelength is None) == (self.angular_frequency is None):
            raise refused(
                self,
                f"wavelength = {self.wavelength!r}, angular_frequency = {self.angular_frequency!r}; give one of the "
                "two, the depth and gravity decide the other",
            )


def angular_frequency(wave_number: float, gravity: float, depth: float = math.inf) -> float:
    """ω [rad/s] of waves of a wave number k [1/m] under g [m/s²], all of them positive."""
    return math.sqrt(gravity * wave_number * math.tanh(wave_number * depth))


def wave_number(angular_frequency: float, gravity: float, depth: float = math.inf) -> float:
    """k [1/m] of waves of an angular frequency ω [rad/s], to round-off.

    Newton's method on x tanh x = y, x = k h, y = ω² h / g: the function grows and is convex from x = 0 to 1.2 and all
    but linear beyond, and Eckart's y / √(tanh y) is within 6 % of the root.
    """
    deep = angular_frequency**2 / gravity
    y = deep * depth
    if y > 20:  # tanh is 1 to the last digit
        return deep
    x = y / math.sqrt(math.tanh(y))
    for _ in range(8):
        steep = math.tanh(x)
        x -= (x * steep - y) / (steep + x * (1 - steep**2))
    return x / depth


@dataclass(frozen=True, eq=False)
class Sea:
    """Motion of the water at any place and time: components with their dispersion solved, and the current.

    Attributes:
        amplitude, frequency, number, direction, phase: (W,) A [m], ω [rad/s], k [1/m], χ and ε [rad].
        depth: h [m], infinite for deep water.
        gravity: g [m/s²] >= 0, downwards.
        current: (3,) [m/s], everywhere the same.
        above: see `AboveLevel`.
    """

    amplitude: Array
    frequency: Array
    number: Array
    direction: Array
    phase: Array
    depth: float
    gravity: float
    current: Array
    above: AboveLevel

    @classmethod
    def of(
        cls,
        waves: Sequence[Wave],
        gravity: float = 9.81,
        depth: float | None = None,
        current: Vector = (0.0, 0.0, 0.0),
        above: AboveLevel = AboveLevel.EXPONENTIAL,
    ) -> Sea:
        """The sea of some components.

        Raises:
            SceneError: where there are waves without gravity.
        """
        h = math.inf if depth is None else float(depth)
        if waves and not gravity > 0:
            raise SceneError(f"waves: gravity = {gravity!r} m/s²; waves need one > 0")
        pairs = [_dispersed(wave, gravity, h) for wave in waves]
        return cls(
            amplitude=np.array([wave.amplitude for wave in waves], float),
            frequency=np.array([omega for omega, _ in pairs], float),
            number=np.array([k for _, k in pairs], float),
            direction=np.array([wave.direction for wave in waves], float),
            phase=np.array([wave.phase for wave in waves], float),
            depth=h,
            gravity=float(gravity),
            current=np.array(current, float),
            above=above,
        )

    def elevation(self, time: ArrayLike, x: ArrayLike, y: ArrayLike) -> Array:
        """ζ [m] (7.2) at times [s] and places [m], which broadcast."""
        return np.asarray(np.sum(self.amplitude * np.sin(self._angle(time, x, y)), axis=-1))

    def velocity(self, time: ArrayLike, points: ArrayLike) -> Array:
        """v (..., 3) [m/s] (7.3)-(7.4) at points (..., 3) [m] and times that broadcast with (...)."""
        angle, across, up = self._at(time, points)
        size = self.frequency * self.amplitude
        return self.current + self._vector(size * across * np.sin(angle), size * up * np.cos(angle))

    def orbit_speeds(self, heights: ArrayLike) -> Array:
        """The largest speed (..., W) [m/s] of each component's orbits at heights z (...) [m]."""
        z = np.asarray(heights, float)
        _, across, _ = self._at(np.zeros_like(z), np.stack([np.zeros_like(z), np.zeros_like(z), z], axis=-1))
        return np.asarray(self.frequency * self.amplitude * across)

    def acceleration(self, time: ArrayLike, points: ArrayLike) -> Array:
        """∂v/∂t (..., 3) [m/s²] (7.5), as `velocity`."""
        angle, across, up = self._at(time, points)
        size = self.frequency**2 * self.amplitude
        return self._vector(size * across * np.cos(angle), -size * up * np.sin(angle))

    def _angle(self, time: ArrayLike, x: ArrayLike, y: ArrayLike) -> Array:
        """θ (..., W)."""
        t, x, y = (np.asarray(value, float)[..., None] for value in (time, x, y))
        along = x * np.cos(self.direction) + y * np.sin(self.direction)
        return np.asarray(self.frequency * t + self.phase - self.number * along)

    def _at(self, time: ArrayLike, points: ArrayLike) -> tuple[Array, Array, Array]:
        """θ, C and S (..., W)."""
        x, y, z = np.moveaxis(np.asarray(points, float), -1, 0)
        height = np.maximum(np.minimum(z, 0.0) if self.above is AboveLevel.CONSTANT else z, -self.depth)[..., None]
        k = self.number
        fades = np.exp(k * height)
        if np.isinf(self.depth):
            return self._angle(time, x, y), fades, fades
        back, whole = np.exp(-2 * k * (height + self.depth)), -np.expm1(-2 * k * self.depth)
        return self._angle(time, x, y), fades * (1 + back) / whole, fades * (1 - back) / whole

    def _vector(self, across: Array, up: Array) -> Array:
        """Components (..., W) along each direction of travel and upwards, summed as (..., 3)."""
        parts = (across * np.cos(self.direction), across * np.sin(self.direction), up)
        return np.stack([np.sum(part, axis=-1) for part in parts], axis=-1)


def _dispersed(wave: Wave, gravity: float, depth: float) -> tuple[float, float]:
    """ω and k of a component."""
    if wave.angular_frequency is not None:
        return wave.angular_frequency, wave_number(wave.angular_frequency, gravity, depth)
    assert wave.wavelength is not None
    k = 2 * math.pi / wave.wavelength
    return angular_frequency(k, gravity, depth), k


MOST_COMPONENTS = 1000
NARROW, WIDE = 0.07, 0.09  # σ of JONSWAP, up to the peak and above
CELLS = 50_000  # of e: the midpoint rule is then off by 1e-9 of the energy, γ^r bending by 330 at most for γ = 7


class Shape(enum.Enum):
    """Shape of a sea's energy spectrum around its peak."""

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
