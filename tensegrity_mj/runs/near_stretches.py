"""When two moving segments are near, and when one passes through the other. Compiled; see `least_distance`."""

from __future__ import annotations

from math import sqrt

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.dynamics.native.compiling import njit
from tensegrity_mj.runs.least_distance import DEPTH, SHORTEST, asleep, put
from tensegrity_mj.runs.moving_segments import (
    Between,
    Ends,
    Motion,
    at_sample,
    between,
    lower_bound,
    motion_bounds,
    moving,
    sample_before,
    sides,
)

RISE = 0.125  # of an interval: rises above a level that are over sooner may go unnoticed
PARALLEL = 1e-5  # sine of the angle below which the normal of two lines is too uncertain
PARTS = 16  # of an interval, looked at for crossings


@njit
def stretches(
    motion: Motion, pair: tuple[int, int], ends: Ends, until: float, level: float, tolerance: float, out: Array
) -> int:
    """Write the times [start, end] between which the distance is at most the level; returns how many they are.

    None is missed in which it is below the level at all. Rises above it that are over within the part RISE of an
    interval may be. Those beyond the length of `out` are counted only.
    """
    time = motion.time
    stack = np.empty((DEPTH * 3, 4))
    last = sample_before(time, until)
    number, k = 0, 0
    now = at_sample(motion.P, ends, 0)
    inside = now <= level
    start = time[0]
    while k < len(time) - 1 and time[k] < until:
        if now > level:
            ahead = asleep(motion.way, pair, k, last, now - level)
            if ahead > k:
                k = ahead
                now = at_sample(motion.P, ends, k)
                if now <= level:
                    start, inside = time[k], True
                continue
        piece = between(motion, ends, k)
        h = piece.h
        end = min(1.0, (until - time[k]) / h)
        after = at_sample(motion.P, ends, k + 1) if end == 1.0 else sqrt(moving(piece, end)[0])
        speed, bend = motion_bounds(piece)
        count = put(stack, 0, 0.0, now, end, after)
        while count > 0:
            count -= 1
            left, at_left, right, at_right = stack[count, 0], stack[count, 1], stack[count, 2], stack[count, 3]
            width = right - left
            if at_left <= level and at_right <= level:
                if width > RISE and max(at_left, at_right) + 0.5 * speed * width > level:
                    middle = 0.5 * (left + right)
                    at_middle = sqrt(moving(piece, middle)[0])
                    count = put(stack, count, middle, at_middle, right, at_right)
                    count = put(stack, count, left, at_left, middle, at_middle)
                continue
            if at_left > level and at_right > level:
                bound = lower_bound(at_left, at_right, width, speed, bend, level)
                if bound > level or bound >= min(at_left, at_right) - tolerance or width < SHORTEST:
                    continue
                middle = 0.5 * (left + right)
                at_middle = sqrt(moving(piece, middle)[0])
                count = put(stack, count, middle, at_middle, right, at_right)
                count = put(stack, count, left, at_left, middle, at_middle)
                continue
            if width <= SHORTEST:
                if at_left > level:
                    start, inside = time[k] + h * right, True
                else:
                    if number < len(out):
                        out[number, 0], out[number, 1] = start, time[k] + h * left
                    number, inside = number + 1, False
                continue
            # The level is passed in it: bisect, then look at what is before and after the passage.
            low, at_low, high, at_high = left, at_left, right, at_right
            while high - low > SHORTEST:
                middle = 0.5 * (low + high)
                at_middle = sqrt(moving(piece, middle)[0])
                if (at_middle > level) == (at_left > level):
                    low, at_low = middle, at_middle
                else:
                    high, at_high = middle, at_middle
            count = put(stack, count, high, at_high, right, at_right)
            count = put(stack, count, low, at_low, high, at_high)
            count = put(stack, count, left, at_left, low, at_low)
        k += 1
        now = after
    if inside:
        if number < len(out):
            out[number, 0], out[number, 1] = start, min(until, time[-1])
        number += 1
    return number


@njit
def height(piece: Between, x: float) -> float:
    """How far [m] one line is from the other along their common normal u × v: its sign is the side.

    Zero where the lines are so nearly parallel that round-off would choose the side.
    """
    w, u, v = sides(piece, x)
    n0, n1, n2 = u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]
    nn = n0 * n0 + n1 * n1 + n2 * n2
    uu = u[0] * u[0] + u[1] * u[1] + u[2] * u[2]
    vv = v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
    return (w[0] * n0 + w[1] * n1 + w[2] * n2) / sqrt(nn) if nn > PARALLEL**2 * uu * vv else 0.0


@njit
def crossings(motion: Motion, ends: Ends, span: tuple[float, float], noise: float, out: Array) -> int:
    """Write the times of a span at which one segment passes through the other; returns how many they are.

    There the lines change sides while the segments touch. Heights below `noise` [m] have no side: elements of a plane
    never pass through each other. Times beyond the length of `out` are counted only.
    """
    time = motion.time
    start, end = span
    number = 0
    k = max(sample_before(time, start), 0)
    known, when = 0.0, 0  # the last height that has a side, and where it was
    part = 0.0
    while k < len(time) - 1 and time[k] <= end:
        piece = between(motion, ends, k)
        h = piece.h
        first, final = max((start - time[k]) / h, 0.0), min((end - time[k]) / h, 1.0)
        for step in range(PARTS + 1):
            x = first + (final - first) * step / PARTS
            side = height(piece, x)
            if abs(side) <= noise:
                continue
            if known * side < 0.0:
                low, high = (part if when == k else 0.0), x
                for _ in range(60):
                    middle = 0.5 * (low + high)
                    if height(piece, middle) * side > 0.0:
                        high = middle
                    else:
                        low = middle
                if moving(piece, high)[0] <= (2.0 * noise) ** 2:
                    if number < len(out):
                        out[number] = time[k] + h * high
                    number += 1
            known, when, part = side, k, x
        k += 1
    return number
