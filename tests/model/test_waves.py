"""Linear waves: dispersion, and fields that are checked against what they must satisfy rather than against formulas."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import brentq

import tensegrity_mj as tmj
from tensegrity_mj.model.elements.waves import angular_frequency, wave_number

G, RHO = 9.81, 1025.0
COMPONENTS = (
    tmj.model.Wave(0.5, 15.0, direction=0.3, phase=0.4),
    tmj.model.Wave(0.2, angular_frequency=2.0, direction=2.5, phase=-1.0),
)
DEPTHS = (None, 30.0, 4.0, 0.7)
# Central differences of a step δ of fields that vary as sin(κ s), κ <= 0.6 /m or 2.1 /s: δ² κ³/6 and round-off ε/δ of
# values up to 8: δ = 1e-4 gives 1.6e-8 of a unit of speed and 2e-11; shallow water of 0.7 m is faster by up to 4.
STEP, TOLERANCE = 1e-4, 1e-7


def sea(depth=None, **options):
    return tmj.model.Sea.of(COMPONENTS, G, depth, **options)


def test_a_sea_has_the_gravity_of_the_thesis_by_default() -> None:
    """9.81 m/s²; g = 9.80 would shorten waves of a given frequency by a thousandth."""
    one = tmj.model.Sea.of(COMPONENTS)
    assert one.gravity == 9.81
    assert one.number[1] == pytest.approx(2.0**2 / 9.81, rel=1e-15)  # deep water: ω² = g k
    assert one.frequency[0] == pytest.approx(math.sqrt(9.81 * 2 * math.pi / 15.0), rel=1e-15)


def samples(depth, count=40):
    """Times and points within the water."""
    rng = np.random.default_rng(5)
    bottom = -6.0 if depth is None else -depth
    points = np.column_stack([rng.uniform(-20, 20, (count, 2)), rng.uniform(0.95 * bottom, -1e-2, count)])
    return rng.uniform(0, 20, count), points


def gradient(field, t, points):
    """∂field/∂(x, y, z), a new first axis of three."""
    steps = STEP * np.eye(3)
    return np.array([(field(t, points + step) - field(t, points - step)) / (2 * STEP) for step in steps])


def pressure(depth, time, points):
    """The dynamic pressure of linear theory, ρ g ζ of each component times cosh k(z + h) / cosh kh."""
    total, (x, y, z) = np.zeros(len(points)), points.T
    for wave in COMPONENTS:
        one = tmj.model.Sea.of([wave], G, depth)
        (k,), h = one.number, depth
        fades = np.exp(k * z) if h is None else np.cosh(k * (z + h)) / np.cosh(k * h)
        total += RHO * G * one.elevation(time, x, y) * fades
    return total


@pytest.mark.parametrize("kh", [1e-6, 1e-3, 0.1, 0.5, 1.0, 1.2, 2.0, 5.0, 19.0, 21.0, 500.0])
def test_dispersion_is_solved_to_round_off_both_ways(kh: float) -> None:
    # k follows from ω² to ω²'s own round-off times d(ln k)/d(ln ω) <= 2; a few ulp for tanh.
    depth = 3.0
    omega = angular_frequency(kh / depth, G, depth)
    assert omega**2 == pytest.approx(G * kh / depth * math.tanh(kh), rel=4e-16 * 4)
    assert wave_number(omega, G, depth) == pytest.approx(kh / depth, rel=4e-15)


def test_dispersion_against_bisection_and_its_limits() -> None:
    rng = np.random.default_rng(2)
    for omega, depth in zip(rng.uniform(0.1, 6, 50), rng.uniform(0.2, 60, 50), strict=True):
        root = brentq(lambda k, h=depth, w=omega: G * k * math.tanh(k * h) - w**2, 1e-9, 50, xtol=1e-15, rtol=1e-14)
        assert wave_number(omega, G, depth) == pytest.approx(root, rel=1e-12)
    assert wave_number(2.0, G) == pytest.approx(4.0 / G, rel=1e-15)  # deep
    assert wave_number(1e-3, G, 1.0) == pytest.approx(1e-3 / math.sqrt(G), rel=1e-6)  # long waves: c = √(g h)


def test_elevation_is_that_of_the_thesis() -> None:
    # (7.2), component by component, each with the number that its dispersion gives.
    t, x, y = 1.7, 2.0, -3.0
    expected = 0.0
    for wave in COMPONENTS:
        omega = wave.angular_frequency or math.sqrt(G * 2 * math.pi / wave.wavelength)
        k = omega**2 / G
        along = x * math.cos(wave.direction) + y * math.sin(wave.direction)
        expected += wave.amplitude * math.sin(omega * t + wave.phase - k * along)
    assert float(sea().elevation(t, x, y)) == pytest.approx(expected, rel=1e-13)


@pytest.mark.parametrize("depth", DEPTHS)
def test_the_flow_is_a_potential_flow(depth: float | None) -> None:
    t, points = samples(depth)
    slopes = gradient(sea(depth).velocity, t, points)  # [i, sample, j] = ∂v_j/∂x_i
    assert np.max(np.abs(slopes)) > 0.05
    assert np.max(np.abs(np.trace(slopes, axis1=0, axis2=2))) < TOLERANCE
    assert np.max(np.abs(slopes - np.transpose(slopes, (2, 1, 0)))) < TOLERANCE


@pytest.mark.parametrize("depth", DEPTHS)
def test_acceleration_is_the_rate_of_velocity_and_follows_the_pressure(depth: float | None) -> None:
    t, points = samples(depth)
    water = sea(depth)
    acceleration = water.acceleration(t, points)
    rate = (water.velocity(t + STEP, points) - water.velocity(t - STEP, points)) / (2 * STEP)
    assert np.max(np.abs(acceleration - rate)) < 3 * TOLERANCE  # ω³ is up to 9
    # Linear Euler: ρ ∂v/∂t = -∇p, p of the order of ρ g A = 5e3: round-off of differences is 1e-8 of ρ.
    force = -gradient(lambda t, x: pressure(depth, t, x), t, points).T / RHO
    assert np.max(np.abs(acceleration - force)) < 3 * TOLERANCE


@pytest.mark.parametrize("depth", DEPTHS)
def test_conditions_at_the_surface_and_at_the_bottom(depth: float | None) -> None:
    t, points = samples(depth)
    points[:, 2] = 0.0
    water, (x, y) = sea(depth), points[:, :2].T
    rate = (water.elevation(t + STEP, x, y) - water.elevation(t - STEP, x, y)) / (2 * STEP)
    assert np.max(np.abs(water.velocity(t, points)[:, 2] - rate)) < 2 * TOLERANCE  # kinematic, linear
    fall = -G * gradient(lambda t, p: water.elevation(t, p[:, 0], p[:, 1]), t, points)[:2].T
    assert np.max(np.abs(water.acceleration(t, points)[:, :2] - fall)) < 2 * TOLERANCE  # dynamic, linear
    if depth is not None:
        points[:, 2] = -depth
        assert np.max(np.abs(water.velocity(t, points)[:, 2])) < 1e-15
        assert np.max(np.abs(water.velocity(t, points)[:, 0])) > 1e-6  # it slips along it


def test_finite_depth_is_that_of_hyperbolic_functions_and_becomes_deep() -> None:
    wave = tmj.model.Wave(0.3, 8.0)
    shallow = tmj.model.Sea.of([wave], G, 2.0)
    k, omega = float(shallow.number[0]), float(shallow.frequency[0])
    z = -0.7
    factor = omega * 0.3 * math.cosh(k * (z + 2.0)) / math.sinh(k * 2.0)
    # θ = π/2 at x = 0: horizontal velocity is at its largest.
    assert shallow.velocity(math.pi / 2 / omega, [0, 0, z])[0] == pytest.approx(factor, rel=1e-14)
    point, deep = [1.0, 2.0, z], tmj.model.Sea.of([wave], G)
    for depth in (60.0, 1e4, 1e300):  # e^{-2kh} is 3e-41 and less
        finite = tmj.model.Sea.of([wave], G, depth)
        assert np.allclose(finite.velocity(2.0, point), deep.velocity(2.0, point), rtol=1e-14, atol=0)
        assert np.allclose(finite.acceleration(2.0, point), deep.acceleration(2.0, point), rtol=1e-14, atol=0)


def test_components_and_current_are_superposed() -> None:
    t, points = samples(None)
    current = (0.3, -0.1, 0.05)
    parts = [tmj.model.Sea.of([wave], G) for wave in COMPONENTS]
    both = sea(current=current)
    assert np.allclose(both.velocity(t, points), sum(p.velocity(t, points) for p in parts) + np.array(current))
    assert np.allclose(both.acceleration(t, points), sum(p.acceleration(t, points) for p in parts))
    still = tmj.model.Sea.of([], 0.0, None, current)
    assert np.array_equal(still.velocity(t, points), np.broadcast_to(current, points.shape))
    assert np.all(still.elevation(t, 0.0, 0.0) == 0)


def test_above_the_level_and_below_the_bottom() -> None:
    above, level = [0.4, 0.2, 0.5], [0.4, 0.2, 0.0]
    grows = math.exp(float(sea().number[0]) * 0.5)
    single = tmj.model.Sea.of(COMPONENTS[:1], G)
    assert np.allclose(single.velocity(1.0, above), grows * single.velocity(1.0, level), rtol=1e-14)
    constant = sea(above=tmj.model.AboveLevel.CONSTANT)
    assert np.array_equal(constant.velocity(1.0, above), constant.velocity(1.0, level))
    assert np.array_equal(constant.acceleration(1.0, above), sea().acceleration(1.0, level))
    shallow = sea(4.0)
    assert np.array_equal(shallow.velocity(1.0, [0, 0, -9.0]), shallow.velocity(1.0, [0, 0, -4.0]))


def test_a_sea_needs_gravity() -> None:
    with pytest.raises(tmj.errors.SceneError, match="gravity = 0"):
        tmj.model.Sea.of(COMPONENTS, 0.0)
