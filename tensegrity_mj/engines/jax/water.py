"""Water around rods and strings as array functions: waves, what is under the surface, and Morison's loads.

Nothing here calls `model.elements.water` or its compiled twin but for enums and the components of an irregular sea.
Where each formula is from:

**Waves** (Airy). ∇²Φ = 0 between the bottom, ∂Φ/∂z = 0 at z = -h, and z = 0, where ∂ζ/∂t = ∂Φ/∂z and g ζ = -∂Φ/∂t,
has for ζ = A sin θ, θ = ω t + ε - k (x cos χ + y sin χ), the potential Φ = (ω A / k) C cos θ, where ω² = g k tanh kh,
C = cosh k(z+h) / sinh kh and S = sinh k(z+h) / sinh kh. So v = ∇Φ is ω A C sin θ along χ and ω A S cos θ upwards, and
∂v/∂t is ω² A C cos θ and -ω² A S sin θ. With a = e^{kz} and b = e^{-k(z+2h)}, C, S = (a ± b) / (1 - e^{-2kh}).

**Loads** (Morison's equation, the cross-flow principle, Archimedes; coefficients as in `Water`). Per volume of water
displaced ρ (C_M P a - g), P = 1 - b bᵀ; per projected area ½ ρ C_d |P u| P u, and per surface ½ ρ C_t |u∥| u∥, with
u = v + current - v_s; and -ρ C_a P v̇_s, which is `alpha`. They act at the centres of the wet parts of segments.

**Wet parts.** u is the depth of the axis over ½ d cos φ, linear along a segment from u_1 to u_2. A cross-section is wet
by w(u), 0 below -1 and 1 above 1, whose slope is the chord of the circle over its area, w' = (2/π) √(1 - u²), so that
w = ½ + (θ + sin θ cos θ) / π for u = sin θ. Between θ = μ ± δ, by parts, the means over λ, 0 to 1 along that piece, are

    of w           ½ + (μ + s c (cos² δ - sin² δ / 3) - τ δ³ E) / π
    of (λ - ½) w   δ (c² P + s² δ² (Q - τ² R)) / 4π

with s = sin μ, c = cos μ, τ = δ tan μ, |τ| <= 1 as |μ| + |δ| <= π/2, and functions of δ² alone (`_series`). Nothing is
divided by u_2 - u_1, so that neither rods that lie in the surface nor their derivatives are cases of their own.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.engines.jax.arrays import ArrayEffect, Arrays, norm, settled, times
from tensegrity_mj.model.elements.water import LEAST_COSINE, Water, Weights
from tensegrity_mj.model.elements.waves import AboveLevel
from tensegrity_mj.model.scene import Scene

TERMS = 16  # of `_series`: from δ = π, where sin δ is 0, they fall as 13.9^-n, by Bernstein's ellipse: 1e-18
STEPS = 5  # of Newton's method for k, from 6 % off: it squares the error each time


class _Fixed(NamedTuple):
    """Constants, not parameters, of R rods and then the pieces of the paths of strings that take drag: M members."""

    water: Water
    ends: tuple[Array, Array]  # (M, N) each: they take the first and the second nodes
    lengths: Array  # (R, 1) [m]
    radii: Array  # (R, 1) [m]
    segments: int  # L of each member
    gravity: float  # g [m/s²]
    ranks: Any  # of the parameters without batches


def water(element: Water, scene: Scene) -> ArrayEffect:
    """A scene's water; its parameters have the names of the fields of `Water`.

    Those of its waves are in "waves", each (W,) in the waves' order, "wavelength" and "angular_frequency" of those
    waves alone that have it. Those of an irregular sea, whose phases and shape of spectrum stay, are in "sea". `depth`,
    `inertia`, `diameter` and `string_diameter` are among them where they are given. The number of segments stays.
    """
    structure, sea = scene.structure, element.sea
    names = ["density", "current", "drag", "tangential_drag", "added_mass"]
    names += [one for one in ("depth", "inertia", "diameter", "string_diameter") if getattr(element, one) is not None]
    parameters: dict[str, Any] = {name: np.array(getattr(element, name), float) for name in names}
    for name in ("amplitude", "wavelength", "angular_frequency", "direction", "phase"):
        values = [getattr(wave, name) for wave in element.waves if getattr(wave, name) is not None]
        if values:
            parameters.setdefault("waves", {})[name] = np.array(values, float)
    if sea is not None:
        names = ["significant_height", "peak_period", "direction"]
        parameters["sea"] = {name: np.array(getattr(sea, name), float) for name in names}
    strings = [] if element.string_diameter is None else [structure.paths.nodes]
    first, second = np.concatenate([structure.rod_nodes, *strings]).T
    every, radii = np.eye(len(structure.nodes)), np.array([rod.radius for rod in structure.rods], float)
    lengths, count, g = structure.rod_lengths[:, None], scene.water_segments.count, -float(scene.gravity[2])
    ranks = jax.tree.map(np.ndim, parameters)
    fixed = _Fixed(element, (every[first], every[second]), lengths, radii[:, None], count, g, ranks)
    return ArrayEffect(parameters, force=partial(_force, fixed), alpha=partial(_alpha, fixed))


class Waves(NamedTuple):
    """Components (W, 1, 1, B), or of size 1 where they have no batch; functions of time and of places (L, M, B)."""

    amplitude: Any  # A [m]
    frequency: Any  # ω [rad/s]
    number: Any  # k [1/m]
    direction: Any  # χ [rad]
    phase: Any  # ε [rad]
    depth: Any  # h [m], or None for deep water

    def angle(self, t: Any, x: Any, y: Any) -> Any:
        """Phase angle θ (W, L, M, B)."""
        along = jnp.cos(self.direction) * x + jnp.sin(self.direction) * y
        return self.frequency * t + self.phase - self.number * along

    def elevation(self, t: Any, x: Any, y: Any) -> Any:
        """Surface elevation ζ (L, M, B)."""
        return _total([self.amplitude], jnp.sin(self.angle(t, x, y)))[0]

    def flow(self, t: Any, x: Any, y: Any, z: Any) -> Any:
        """Velocity v and acceleration ∂v/∂t of the water (2, 3, L, M, B)."""
        angle, k, h = self.angle(t, x, y), self.number, self.depth
        if h is None:
            across = up = jnp.exp(k * z)
        else:
            z = jnp.maximum(z, -h)
            grows, fades, whole = jnp.exp(k * z), jnp.exp(-k * (z + 2 * h)), -jnp.expm1(-2 * k * h)
            across, up = (grows + fades) / whole, (grows - fades) / whole
        sine, cosine, size = jnp.sin(angle), jnp.cos(angle), self.frequency * self.amplitude
        ways, gain = (jnp.cos(self.direction), jnp.sin(self.direction)), self.frequency * size
        velocity = *_total([size * way for way in ways], across * sine), *_total([size], up * cosine)
        acceleration = *_total([gain * way for way in ways], across * cosine), *_total([-gain], up * sine)
        return settled(jnp.stack([jnp.stack(velocity), jnp.stack(acceleration)]))


def _total(sizes: list[Any], fields: Any) -> Any:
    """Sums over components of sizes (W, 1, 1, B) times fields (W, L, M, B); if they have no batch, by a product."""
    stacked = jnp.stack(sizes)[:, :, 0, 0]
    if stacked.shape[-1] == 1:
        return times(stacked[:, :, 0], fields)
    return jnp.einsum("cwb,wlmb->clmb", stacked, fields, precision="highest")


def _components(fixed: _Fixed, p: Arrays) -> list[Waves]:
    """Make the waves that have a wavelength, those that have a frequency, and those of the irregular sea."""
    found, h, g, sea = [], p.get("depth"), fixed.gravity, fixed.water.sea
    for name in ("wavelength", "angular_frequency"):
        rows = [row for row, wave in enumerate(fixed.water.waves) if getattr(wave, name) is not None]
        if not rows:
            continue
        size, way, phase = (p["waves"][own][np.array(rows)] for own in ("amplitude", "direction", "phase"))
        if name == "wavelength":
            k = 2 * np.pi / p["waves"][name]
            frequency = jnp.sqrt(g * k * (1.0 if h is None else jnp.tanh(k * h)))
        else:
            frequency = p["waves"][name]
            k = wave_number(frequency, g, h)
        found.append((size, frequency, k, way, phase))
    if sea is not None:
        height, period, way = (p["sea"][name][None] for name in ("significant_height", "peak_period", "direction"))
        frequency = (sea.frequencies * sea.peak_period)[:, None] / period  # the spectrum is one of ω/ω_p
        phase, size = np.array([[wave.phase] for wave in sea.waves]), height / np.sqrt(8 * sea.components)
        found.append((size * np.ones_like(phase), frequency, wave_number(frequency, g, h), way, phase))
    return [Waves._make([*(rows[:, None, None] for rows in waves), h]) for waves in found]


def wave_number(frequency: Any, gravity: float, depth: Any) -> Any:
    """Solve ω² = g k tanh kh for k, by Newton's method on x tanh x = y, x = k h, which has its derivatives, too."""
    deep = frequency**2 / gravity
    if depth is None:
        return deep
    y = deep * depth
    x = y / jnp.sqrt(jnp.tanh(y))  # Eckart's, at most 6 % off
    for _ in range(STEPS):
        steep = jnp.tanh(x)
        x = x - (x * steep - y) / (steep + x * (1 - steep**2))
    return x / depth


def _series() -> Array:
    """E, P, Q and R (TERMS, 4) as polynomials of 8 δ²/π² - 1, the highest power first; integrated by Gauss's rule.

    With φ = δ λ, -1 <= λ <= 1, x = (cos φ - cos δ) / sin² δ and σ = sin φ / δ: E = sinc δ ∫ x σ² dλ,
    P = ∫ x (cos φ + cos δ) cos² φ, Q = ∫ x (σ² (5 cos φ + cos δ) - x sinc² δ cos² φ), R = ∫ x² sinc² δ σ².
    """
    points, weights = np.polynomial.legendre.leggauss(40)

    def integrals(place: Array) -> Array:
        delta = np.pi / np.sqrt(8) * np.sqrt(place + 1)[:, None]
        phi, sinc = delta * points, np.sinc(delta / np.pi)
        x = (
            0.5
            * (1 - points**2)
            * np.sinc((delta + phi) / (2 * np.pi))
            * np.sinc((delta - phi) / (2 * np.pi))
            / sinc**2
        )
        sigma, near, far = (points * np.sinc(phi / np.pi)) ** 2, np.cos(phi), np.cos(delta)
        parts = [sinc * sigma, (near + far) * near**2, sigma * (5 * near + far) - x * (sinc * near) ** 2]
        return np.stack([(x * part) @ weights for part in (*parts, x * sinc**2 * sigma)], axis=-1)

    nodes = np.polynomial.chebyshev.chebpts1(TERMS)
    found = np.polynomial.chebyshev.chebfit(nodes, integrals(nodes), TERMS - 1)
    return np.stack([np.polynomial.chebyshev.cheb2poly(column)[::-1] for column in found.T], axis=-1)


SERIES = _series()


def wet_part(u: Any) -> tuple[Any, Any]:
    """Part of a segment that is under water, and the place of that part's centre along the segment.

    Between its ends' u (2, ...) a segment is a piece inside -1 < u < 1 (the module's formulas), and what is dry or
    under water outside, at either end. Ends at u = ±1 are outside in value and derivative alike.
    """
    step = jnp.where(u[0] == u[1], 1.0, jnp.abs(u[1] - u[0]))
    inside = jnp.abs(u) < 1
    angles = jnp.where(inside, jnp.arcsin(jnp.where(inside, u, 0.0)), jnp.sign(u) * np.pi / 2)
    mean, half = 0.5 * (angles[0] + angles[1]), 0.5 * (angles[1] - angles[0])
    square, s, c = half**2, jnp.sin(mean), jnp.cos(mean)
    E, P, Q, R = jnp.polyval(SERIES.reshape(TERMS, 4, *(1,) * square.ndim), 8 / np.pi**2 * square - 1)
    tau = half * s / c  # a piece of length 0 at u = ±1 has 0, as c is 1e-16 there
    wet = 0.5 + (mean + s * c * (1 - 4 / 3 * jnp.sin(half) ** 2) - tau * half * square * E) / np.pi
    moment = half * (c**2 * P + s**2 * square * (Q - tau**2 * R)) / (4 * np.pi)
    alike = ~inside[0] & ~inside[1] & (jnp.sign(u[0]) == jnp.sign(u[1]))
    out = jnp.where(inside, 0.0, jnp.where(alike, 0.5, (jnp.abs(u) - 1) / step))  # parts of the segment
    bow, sunk = jnp.where(alike, 0.0, 1 - out[0] - out[1]), jnp.where(u >= 1, out, 0.0)
    part = bow * wet + sunk[0] + sunk[1]
    moment = bow * (bow * moment + 0.5 * (out[0] - out[1]) * wet)  # about the middle
    moment += 0.5 * (sunk[1] * (1 - out[1]) - sunk[0] * (1 - out[0]))
    place = jnp.clip(0.5 + moment / jnp.where(part > 0, part, 1.0), 0.0, 1.0)
    return jnp.maximum(part, 0.0), jnp.where(part > 0, place, 0.5)


class _Wet(NamedTuple):
    """Wet parts of segments."""

    axis: Any  # (M, 3, B) unit vectors from first to second nodes, 0 where a string's ends meet
    place: Any  # (L, M, 1, B) s of their centres, along the whole member
    points: Any  # (3, L, M, B) [m] the same; of a dry segment, z <= 0
    mass: Any  # (L, M, 1, B) [kg] of the water in their place; strings displace none
    area: Any  # (L, M, 1, B) [m²] diameter times length
    share: Any  # (L, M, 1, B) of loads across the member, what goes to the second node


def _wet(fixed: _Fixed, waves: list[Waves], p: Arrays, t: Any, x: Any) -> _Wet:
    R, L, (M, _), B = len(fixed.lengths), fixed.segments, fixed.ends[0].shape, x.shape[-1]
    start = times(fixed.ends[0], x)
    span = times(fixed.ends[1], x) - start
    size = norm(span)
    axis = span / jnp.where(size > 0, size, 1.0)[:, None]
    rods, strings = p.get("diameter", 2 * fixed.radii), p.get("string_diameter", 0.0)
    d = jnp.concatenate([jnp.broadcast_to(rods, (R, B)), jnp.broadcast_to(strings, (M - R, B))])
    length = jnp.concatenate([jnp.broadcast_to(fixed.lengths, (R, B)), size[R:]]) / L
    cuts = start + (np.arange(L + 1) / L)[:, None, None, None] * span
    depth = sum((one.elevation(t, cuts[:, :, 0], cuts[:, :, 1]) for one in waves), -cuts[:, :, 2])
    u = depth / (0.5 * d * jnp.sqrt(jnp.maximum(jnp.sum(axis[:, :2] ** 2, 1), LEAST_COSINE**2)))
    ends = times(np.stack([np.eye(L, L + 1), np.eye(L, L + 1, 1)]), u)
    part, along = settled(jnp.stack(wet_part(ends)))
    place = ((np.arange(L)[:, None, None] + along) / L)[:, :, None]
    x, y, z = jnp.moveaxis(start + place * span, 2, 0)
    # Of a dry segment nothing counts, but high above the water the fields are beyond all floats.
    z = jnp.where((part > 0) & (fixed.water.above is AboveLevel.EXPONENTIAL), z, jnp.minimum(z, 0.0))
    area = (d * length * part)[:, :, None]
    mass = p["density"] * np.pi / 4 * d[:, None] * area * (np.arange(M) < R)[:, None, None]
    share = place if fixed.water.weights is Weights.RIGID else place**2 * (3 - 2 * place)
    return _Wet(axis, place, (x, y, z), mass, area, share)


def _force(fixed: _Fixed, p: Arrays, t: Any, x: Any, v: Any) -> Any:
    """F⁰ (N, 3, ...): all but what answers the rods' own accelerations."""
    shape, (p, t, x, v) = x.shape, _flat(fixed, p, t, x, v)
    waves = _components(fixed, p)
    wet = _wet(fixed, waves, p, t, x)
    flow, gain = jnp.moveaxis(sum((one.flow(t, *wet.points) for one in waves), jnp.zeros((2, 3, 1, 1, 1))), 1, -2)
    first, second = (times(ends, v) for ends in fixed.ends)
    moves = first + wet.place * (second - first)
    slip, past = _split(flow + p["current"] - moves, wet.axis)
    up, aside = _split(np.array([0.0, 0.0, fixed.gravity])[:, None], wet.axis)
    drag, share, inertia = 0.5 * p["density"] * wet.area, wet.share, p.get("inertia", 1 + p["added_mass"])
    normal = p["drag"] * drag * norm(past, 2)[:, :, None] * past + wet.mass * (
        inertia * _split(gain, wet.axis)[1] + aside
    )
    axial = (p["tangential_drag"] * np.pi * drag * jnp.abs(slip) * slip + wet.mass * up) * wet.axis
    along = share if fixed.water.weights is Weights.RIGID else 0.5
    loads = (1 - share) * normal + (1 - along) * axial, share * normal + along * axial
    return sum(times(ends.T, jnp.sum(one, 0)) for ends, one in zip(fixed.ends, loads, strict=True)).reshape(shape)


def _alpha(fixed: _Fixed, p: Arrays, t: Any, x: Any) -> Any:
    """Added mass (R, 2, 2, ...) [kg]: Σ C_a m h_i n_j, a load's weights h by places' weights n, of accelerations."""
    batch, R, (p, t, x) = x.shape[2:], len(fixed.lengths), _flat(fixed, p, t, x)
    wet = _wet(fixed, _components(fixed, p), p, t, x)
    mass, (n, h) = p["added_mass"] * wet.mass, (jnp.concatenate([1 - s, s], 2) for s in (wet.place, wet.share))
    return jnp.sum(mass[..., None, :] * h[..., None, :] * n[:, :, None], 0)[:R].reshape(R, 2, 2, *batch)


def _split(vectors: Any, axis: Any) -> tuple[Any, Any]:
    """Components (..., 1, B) along axes of vectors (..., 3, B), and what is across."""
    along = jnp.sum(vectors * axis, -2, keepdims=True)
    return along, vectors - along * axis


def _flat(fixed: _Fixed, p: Arrays, t: Any, *vectors: Any) -> tuple[Any, ...]:
    """Parameters, time and vectors, each with one axis at its end for all batches, of size 1 if it has none."""

    def flat(value: Any, rank: int) -> Any:
        return jnp.reshape(value, (*np.shape(value)[:rank], -1))

    return (jax.tree.map(flat, dict(p), fixed.ranks), flat(t, 0), *(flat(each, 2) for each in vectors))
