"""The water of a scene in compiled code: loads on nodes, and how they answer the rods' accelerations. See `water`."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tensegrity_mj.dynamics.native.compiling import c_function
from tensegrity_mj.dynamics.native.elements import ACT_SIGNATURE, Effect, Motion, NativeElement
from tensegrity_mj.dynamics.native.law import SOLVED
from tensegrity_mj.dynamics.native.pointers import borrowing, inlined
from tensegrity_mj.dynamics.native.vectors import ZERO, add, dot, minus, plus, row_of, times, vector
from tensegrity_mj.dynamics.native.views import Table, view_of
from tensegrity_mj.model.elements.water import (
    ANGLE_WEIGHTS,
    ANGLES,
    GAUSS_POINTS,
    GAUSS_WEIGHTS,
    LEAST_COSINE,
    NEARLY_LEVEL,
    Water,
    Weights,
    sea_of,
)
from tensegrity_mj.model.elements.waves import AboveLevel
from tensegrity_mj.model.rods import diameters
from tensegrity_mj.model.scene import Scene

ROD = np.dtype(
    [
        ("nodes", "i8", (2,)),
        ("half", "f8"),  # ½ d
        ("mass", "f8"),  # of the water in place of a segment, ρ π d²/4 ℓ/L
        ("drag", "f8"),  # ½ ρ C_d d ℓ/L
        ("tangential", "f8"),  # ½ ρ C_t π d ℓ/L
        ("stretches", "i8"),  # a piece of a string: no mass, and drag of 1 m, times the length that it has
    ],
    align=True,
)
WAVE = np.dtype(
    [(name, "f8") for name in ("amplitude", "frequency", "number", "cosine", "sine", "phase", "whole")], align=True
)  # whole: 1 - e^{-2kh}
Sea, pack = view_of(
    "Sea",
    rods=(ROD, "count"),
    waves=(WAVE, "wave_count"),
    segments="size",
    hermite="size",
    constant="size",
    depth="real",
    added_mass="real",
    inertia="real",
    current=("f8", 3),
    gravity=("f8", 3),
)


def packed_sea(scene: Scene) -> Table:
    """The water of a scene as compiled code sees it."""
    structure, water, sea = scene.structure, scene.water, sea_of(scene)
    assert water is not None
    strings = np.zeros((0, 2), int) if water.string_diameter is None else structure.paths.nodes
    R, count = len(structure.rods), scene.water_segments.count
    rods = np.zeros(R + len(strings), ROD)
    d = np.concatenate([diameters(structure, water.diameter), np.full(len(strings), water.string_diameter or 0.0)])
    length = np.concatenate([structure.rod_lengths, np.ones(len(strings))]) / count
    rods["nodes"], rods["half"] = np.concatenate([structure.rod_nodes, strings]), 0.5 * d
    rods["mass"][:R] = water.density * np.pi * d[:R] ** 2 / 4 * length[:R]
    rods["stretches"][R:] = 1
    rods["drag"] = 0.5 * water.density * water.drag * d * length
    rods["tangential"] = 0.5 * water.density * water.tangential_drag * np.pi * d * length
    waves = np.zeros(len(sea.amplitude), WAVE)
    for name in ("amplitude", "frequency", "number", "phase"):
        waves[name] = getattr(sea, name)
    waves["cosine"], waves["sine"] = np.cos(sea.direction), np.sin(sea.direction)
    waves["whole"] = -np.expm1(-2 * sea.number * sea.depth)
    return pack(
        rods=rods,
        waves=waves,
        segments=count,
        hermite=water.weights is Weights.HERMITE,
        constant=water.above is AboveLevel.CONSTANT,
        depth=sea.depth,
        added_mass=water.added_mass,
        inertia=water.inertia_coefficient,
        current=np.array(sea.current, float),
        gravity=np.array(scene.gravity, float),
    )


def pack_water(element: Water, scene: Scene) -> NativeElement:
    """The water of a scene."""
    packed = packed_sea(scene)
    return NativeElement(act_water.address, packed.address, (packed,))


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
def immerse(packed: int, t: float, nodes: Any, velocities: Any, forces: Any, added: Any) -> None:
    """Add F⁰ to nodal forces (N, 3), and α of the rods to `added` (R, 4) [kg], rows (α_11, α_12, α_21, α_22)."""
    sea = Sea(packed)
    count, rods, waves = sea.segments, sea.rods, sea.waves
    depth, C_a, C_M, hermite, constant = sea.depth, sea.added_mass, sea.inertia, sea.hermite, sea.constant
    current, gravity = vector(sea.current), vector(sea.gravity)
    for r in range(len(rods)):
        rod = rods[r]
        i, j = rod.nodes[0], rod.nodes[1]
        x1, v1 = row_of(nodes, i), row_of(velocities, i)
        span, turn = minus(row_of(nodes, j), x1), minus(row_of(velocities, j), v1)
        length = math.sqrt(dot(span, span))
        if length == 0.0:
            continue
        axis = times(1.0 / length, span)
        scale = length if rod.stretches != 0 else 1.0
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
            normal = plus(normal, times(scale * rod.drag * part * math.sqrt(dot(past, past)), past))
            normal = minus(normal, times(mass, _across(gravity, axis)))
            axial = times(scale * rod.tangential * part * abs(slip) * slip - mass * dot(gravity, axis), axis)
            share = s * s * (3.0 - 2.0 * s) if hermite else s
            half = 0.5 if hermite else s
            first = plus(first, plus(times(1.0 - share, normal), times(1.0 - half, axial)))
            second = plus(second, plus(times(share, normal), times(half, axial)))
            mass *= C_a
            a11 += mass * (1.0 - share) * (1.0 - s)
            a12 += mass * (1.0 - share) * s
            a21 += mass * share * (1.0 - s)
            a22 += mass * share * s
        if rod.stretches == 0:
            added[r, 0] += a11
            added[r, 1] += a12
            added[r, 2] += a21
            added[r, 3] += a22
        add(forces, i, first)
        add(forces, j, second)


@c_function(ACT_SIGNATURE, "water and waves")
def act_water(t: Any, motion_at: Any, context_at: Any, effect_at: Any) -> Any:
    """See `native.elements`."""
    motion, effect = Motion(motion_at), Effect(effect_at)
    immerse(context_at, t, motion.nodes, motion.velocities, effect.forces, effect.added)
    return SOLVED
