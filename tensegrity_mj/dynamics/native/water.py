"""The water of a scene in compiled code: loads on nodes, and how they answer the rods' accelerations. See `water`."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tensegrity_mj.dynamics.native.pointers import address_of, borrowing, floats, inlined, integers, records_reader
from tensegrity_mj.dynamics.native.vectors import ZERO, dot, minus, plus, row_of, times
from tensegrity_mj.model.elements.water import (
    ANGLE_WEIGHTS,
    ANGLES,
    GAUSS_POINTS,
    GAUSS_WEIGHTS,
    LEAST_COSINE,
    NEARLY_LEVEL,
    Weights,
    diameters,
    sea_of,
)
from tensegrity_mj.model.elements.waves import AboveLevel
from tensegrity_mj.model.scene import Scene

ROD = np.dtype(
    [
        ("nodes", "i8", (2,)),
        ("half", "f8"),  # ½ d
        ("mass", "f8"),  # of the water in place of a segment, ρ π d²/4 ℓ/L
        ("drag", "f8"),  # ½ ρ C_d d ℓ/L
        ("tangential", "f8"),  # ½ ρ C_t π d ℓ/L
    ],
    align=True,
)
WAVE = np.dtype(
    [(name, "f8") for name in ("amplitude", "frequency", "number", "cosine", "sine", "phase", "whole")], align=True
)  # whole: 1 - e^{-2kh}
_read_rods, _read_waves = records_reader(ROD), records_reader(WAVE)

# The table; NUMBERS are the depth, C_a, C_M, current (3,) and gravity (3,), ADDED is α (R, 4) as last found. Threads of
# a law without a run would share ADDED, and water has none of these (`capabilities.require_dry`).
_ROD_COUNT, _RODS, _WAVE_COUNT, _WAVES, _NUMBERS, _SEGMENTS, _HERMITE, _CONSTANT, _ADDED = range(9)
_SIZE = 9


class PackedWater:
    """The arrays of a scene's water and a table of their addresses, to be kept alive while it is read.

    Attributes:
        table: (9,) int64.
    """

    def __init__(self, scene: Scene) -> None:
        structure, water, sea = scene.structure, scene.water, sea_of(scene)
        assert water is not None
        rods, d = np.zeros(len(structure.rods), ROD), diameters(structure, water)
        count = scene.water_segments.count
        length = structure.rod_lengths / count
        rods["nodes"], rods["half"] = structure.rod_nodes, 0.5 * d
        rods["mass"] = water.density * np.pi * d**2 / 4 * length
        rods["drag"] = 0.5 * water.density * water.drag * d * length
        rods["tangential"] = 0.5 * water.density * water.tangential_drag * np.pi * d * length
        waves = np.zeros(len(sea.amplitude), WAVE)
        for name in ("amplitude", "frequency", "number", "phase"):
            waves[name] = getattr(sea, name)
        waves["cosine"], waves["sine"] = np.cos(sea.direction), np.sin(sea.direction)
        waves["whole"] = -np.expm1(-2 * sea.number * sea.depth)
        numbers = np.array([sea.depth, water.added_mass, water.inertia_coefficient, *sea.current, *scene.gravity])
        self._arrays = (rods, waves, numbers, np.zeros((len(rods), 4)))
        at = [address_of(array) for array in self._arrays]
        hermite, constant = water.weights is Weights.HERMITE, water.above is AboveLevel.CONSTANT
        sizes = (count, hermite, constant)
        self.table = np.array([len(rods), at[0], len(waves), at[1], at[2], *sizes, at[3]], np.int64)

    @property
    def address(self) -> int:
        """Of the table."""
        return address_of(self.table)


@inlined
def _elevation(waves: Any, t: float, x: float, y: float) -> float:
    """ζ, (7.2)."""
    total = 0.0
    for w in range(len(waves)):
        wave = waves[w]
        along = x * wave.cosine + y * wave.sine
        total += wave.amplitude * math.sin(wave.frequency * t + wave.phase - wave.number * along)
    return total


@inlined
def _flow(waves: Any, depth: float, constant: int, t: float, point: Any) -> Any:
    """Velocity and acceleration of the water that waves make, (7.4)-(7.5)."""
    x, y, z = point
    vx, vy, vz, ax, ay, az = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    z = max(min(z, 0.0) if constant else z, -depth)
    for w in range(len(waves)):
        wave = waves[w]
        along = x * wave.cosine + y * wave.sine
        angle = wave.frequency * t + wave.phase - wave.number * along
        sine, cosine = math.sin(angle), math.cos(angle)
        speed = wave.frequency * wave.amplitude * math.exp(wave.number * z)
        across, up = speed, speed
        if depth < np.inf:
            back = math.exp(-2.0 * wave.number * (z + depth))
            across, up = speed * (1.0 + back) / wave.whole, speed * (1.0 - back) / wave.whole
        vx += across * wave.cosine * sine
        vy += across * wave.sine * sine
        vz += up * cosine
        ax += wave.frequency * across * wave.cosine * cosine
        ay += wave.frequency * across * wave.sine * cosine
        az -= wave.frequency * up * sine
    return (vx, vy, vz), (ax, ay, az)


@inlined
def _wet(u: float) -> float:
    x = max(-1.0, min(1.0, u))
    return 0.5 + (math.asin(x) + x * math.sqrt(1.0 - x * x)) / math.pi


@inlined
def _wet_part(first: float, second: float) -> Any:
    """See `water.wet_parts`."""
    if first >= 1.0 and second >= 1.0:
        return 1.0, 0.5
    if first <= -1.0 and second <= -1.0:
        return 0.0, 0.5
    step, part, moment = second - first, 0.0, 0.0
    if abs(step) < NEARLY_LEVEL:
        for k in range(len(GAUSS_POINTS)):
            wet = GAUSS_WEIGHTS[k] * _wet(first + GAUSS_POINTS[k] * step)
            part += wet
            moment += GAUSS_POINTS[k] * wet
    else:
        per_step = 1.0 / step
        start = math.asin(max(-1.0, min(1.0, first)))
        turn = math.asin(max(-1.0, min(1.0, second))) - start
        for k in range(len(ANGLES)):
            angle = start + ANGLES[k] * turn
            sine, cosine = math.sin(angle), math.cos(angle)
            wet = ANGLE_WEIGHTS[k] * cosine * (0.5 + (angle + sine * cosine) / math.pi)
            part += wet
            moment += wet * (sine - first)
        part *= turn * per_step
        moment *= turn * per_step * per_step
        if first > 1.0 or second > 1.0:
            crossing = (1.0 - first) * per_step
            low, high = (0.0, crossing) if first > 1.0 else (crossing, 1.0)
            part += high - low
            moment += 0.5 * (high - low) * (low + high)
    return (part, moment / part) if part > 0.0 else (0.0, 0.5)


@inlined
def _across(v: Any, axis: Any) -> Any:
    """P v."""
    return minus(v, times(dot(v, axis), axis))


@borrowing
def immerse(packed: int, t: float, nodes: Any, velocities: Any, forces: Any) -> float:
    """Add F⁰ to nodal forces (N, 3) and keep α of the rods; returns the power of F⁰ [W]."""
    table = integers(packed, (_SIZE,))
    numbers, count = floats(table[_NUMBERS], (9,)), table[_SEGMENTS]
    depth, C_a, C_M, hermite, constant = numbers[0], numbers[1], numbers[2], table[_HERMITE], table[_CONSTANT]
    current, gravity = (numbers[3], numbers[4], numbers[5]), (numbers[6], numbers[7], numbers[8])
    rods, waves = _read_rods(table[_RODS], table[_ROD_COUNT]), _read_waves(table[_WAVES], table[_WAVE_COUNT])
    added, power = floats(table[_ADDED], (len(rods), 4)), 0.0
    for r in range(len(rods)):
        rod = rods[r]
        i, j = rod.nodes[0], rod.nodes[1]
        x1, v1 = row_of(nodes, i), row_of(velocities, i)
        span, turn = minus(row_of(nodes, j), x1), minus(row_of(velocities, j), v1)
        axis = times(1.0 / math.sqrt(dot(span, span)), span)
        flat = math.sqrt(axis[0] * axis[0] + axis[1] * axis[1])
        per_half = 1.0 / (rod.half * max(flat, LEAST_COSINE))
        first, second = ZERO, ZERO
        a11, a12, a21, a22 = 0.0, 0.0, 0.0, 0.0
        last = per_half * (_elevation(waves, t, x1[0], x1[1]) - x1[2])
        for k in range(count):
            cut = plus(x1, times((k + 1) / count, span))
            ahead = per_half * (_elevation(waves, t, cut[0], cut[1]) - cut[2])
            part, along = _wet_part(last, ahead)
            last = ahead
            if part == 0.0:
                continue
            s = (k + along) / count
            moves, gains = _flow(waves, depth, constant, t, plus(x1, times(s, span)))
            flow = minus(minus(plus(moves, current), v1), times(s, turn))
            mass, slip = rod.mass * part, dot(flow, axis)
            past = minus(flow, times(slip, axis))
            normal = times(C_M * mass, _across(gains, axis))
            normal = plus(normal, times(rod.drag * part * math.sqrt(dot(past, past)), past))
            normal = minus(normal, times(mass, _across(gravity, axis)))
            axial = times(rod.tangential * part * abs(slip) * slip - mass * dot(gravity, axis), axis)
            share = s * s * (3.0 - 2.0 * s) if hermite else s
            half = 0.5 if hermite else s
            first = plus(first, plus(times(1.0 - share, normal), times(1.0 - half, axial)))
            second = plus(second, plus(times(share, normal), times(half, axial)))
            mass *= C_a
            a11 += mass * (1.0 - share) * (1.0 - s)
            a12 += mass * (1.0 - share) * s
            a21 += mass * share * (1.0 - s)
            a22 += mass * share * s
        added[r, 0], added[r, 1], added[r, 2], added[r, 3] = a11, a12, a21, a22
        power += dot(first, v1) + dot(second, plus(v1, turn))
        for x in range(3):
            forces[i, x] += first[x]
            forces[j, x] += second[x]
    return power


@borrowing
def added_masses(packed: int) -> int:
    """Address of α (R, 4) [kg], rows (α_11, α_12, α_21, α_22), of the state that `immerse` saw last."""
    return integers(packed, (_SIZE,))[_ADDED]
