"""The least distance of two moving segments over time, between the samples too. Compiled.

The nodes are cubics of time between samples (Hermite, from positions and velocities). Let D be the squared distance of
the segments. It is the least, over the points s and t of both, of functions g of time with g̈ = 2 |ẇ|² + 2 w · ẅ, w
being what is between the points. Where |ẇ| <= V and |ẅ| <= A, and D falls below r² somewhere in a stretch of length x,
the g that does so has |w| <= r + V x in all of it, and g̈ <= K = 2 V² + 2 (r + V x) A. A function with g̈ <= K lies above
its chord minus K/2 times the product of the distances from both ends. So D at both ends bounds D from below within the
stretch, whatever the segments do: pass, cross, or change the points that are closest. V and A are those of the Bézier
points of the four corners of w. A stretch whose bound is too low is halved.

Times of a stretch are parts of the interval between two samples, within [0, 1]; V, A and K are per such part.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.dynamics.native.compiling import njit
from tensegrity_mj.runs.moving_segments import (
    Between,
    Ends,
    Motion,
    at_sample,
    between,
    closest_at_sample,
    lower_bound,
    motion_bounds,
    moving,
    sample_before,
)

DEPTH = 64  # of halved stretches that wait
SHORTEST = 1e-12  # of a stretch in which a level is passed
GOLDEN = 0.6180339887498949
SAME = 1e-14  # of a squared distance: round-off, for which no other time is reported


@njit
def asleep(way: Array, pair: tuple[int, int], k: int, last: int, room: float) -> int:
    """The last sample before which two elements cannot have come nearer by `room` than they were at sample k."""
    i, j = pair
    base = way[i, k] + way[j, k] + room
    step = 1
    low = k
    while low + step <= last and way[i, low + step] + way[j, low + step] <= base:
        low += step
        step *= 2
    while step > 0:
        if low + step <= last and way[i, low + step] + way[j, low + step] <= base:
            low += step
        step //= 2
    return low


@njit
def put(stack: Array, count: int, left: float, at_left: float, right: float, at_right: float) -> int:
    """Put a stretch on the stack; returns its new height."""
    stack[count, 0], stack[count, 1], stack[count, 2], stack[count, 3] = left, at_left, right, at_right
    return count + 1


@njit
def halved(
    piece: Between, stretch: tuple[float, float, float, float], best: float, tolerance: float
) -> tuple[float, float, float]:
    """(distance, part, width) of the least distance within a stretch, if it is below `best` by the tolerance.

    The stretch is given by its ends and the distances there: (left, at left, right, at right).

    The width is that of the stretch that it was found in, negative where nothing is below `best`.
    """
    stack = np.empty((DEPTH, 4))
    part, found = 0.0, -1.0
    speed, bend = motion_bounds(piece)
    count = put(stack, 0, stretch[0], stretch[1], stretch[2], stretch[3])
    while count > 0:
        count -= 1
        left, at_left, right, at_right = stack[count, 0], stack[count, 1], stack[count, 2], stack[count, 3]
        width = right - left
        if lower_bound(at_left, at_right, width, speed, bend, best) >= best - tolerance or width < SHORTEST:
            continue
        middle = 0.5 * (left + right)
        at_middle = sqrt(moving(piece, middle)[0])
        if at_middle < best:
            best, part, found = at_middle, middle, 0.5 * width
        count = put(stack, count, middle, at_middle, right, at_right)
        count = put(stack, count, left, at_left, middle, at_middle)
    return best, part, found


@njit
def least(
    motion: Motion, pair: tuple[int, int], ends: Ends, span: tuple[float, float], limit: float, tolerance: float
) -> tuple[float, int, float, float]:
    """(distance, interval, part, width): the least distance between two times, if below the limit by the tolerance.

    It is at most that much above the least of all. `width` is the part of the interval that it was found in; it is
    negative where nothing is below the limit.
    """
    time = motion.time
    since, until = span
    last = sample_before(time, until)
    k = max(sample_before(time, since), 0)
    best, where, part, found = limit, k, 0.0, -1.0
    if k >= len(time) - 1:
        now = at_sample(motion.P, ends, len(time) - 1)
        return (now, len(time) - 1, 0.0, 1.0) if now < best else (best, where, part, found)
    begin = (since - time[k]) / (time[k + 1] - time[k])
    begin = begin if begin > 0.0 else 0.0
    now = sqrt(moving(between(motion, ends, k), begin)[0])
    if now < best:
        best, where, part, found = now, k, begin, 1.0
    while k < len(time) - 1 and time[k] < until:
        ahead = asleep(motion.way, pair, k, last, now - best + tolerance) if begin == 0.0 else k
        if ahead > k:
            k = ahead
            now = at_sample(motion.P, ends, k)
            if now < best:
                best, where, part, found = now, k, 0.0, 1.0
            continue
        piece = between(motion, ends, k)
        end = min(1.0, (until - time[k]) / piece.h)
        after = at_sample(motion.P, ends, k + 1) if end == 1.0 else sqrt(moving(piece, end)[0])
        if after < best:
            best, where, part, found = after, k, end, 1.0
        lower, x, width = halved(piece, (begin, now, end, after), best, tolerance)
        if width > 0.0:
            best, where, part, found = lower, k, x, width
        k += 1
        now, begin = after, 0.0
    return best, where, part, found


@njit
def sharpened(
    motion: Motion, ends: Ends, k: int, part: float, width: float, span: tuple[float, float]
) -> tuple[float, float, float, float]:
    """(distance, time, s, t) of the least distance near a part of an interval, by golden section on both its sides."""
    time = motion.time
    earliest, latest = span
    if len(time) == 1:
        D, s, t = closest_at_sample(motion.P, ends, 0)
        return sqrt(D), time[0], s, t
    if k == len(time) - 1:
        k, part = k - 1, 1.0
    piece = between(motion, ends, k)
    best, s_best, t_best = moving(piece, part)
    when = time[k] + part * piece.h
    for side in range(3):
        # About the part itself; and where that is at a sample, in the interval on the other side.
        number, low, high = k, part - width, part + width
        if side == 1:
            if part + width < 1.0 or k + 2 >= len(time):
                continue
            number, low, high = k + 1, 0.0, width
        elif side == 2:
            if part - width > 0.0 or k == 0:
                continue
            number, low, high = k - 1, 1.0 - width, 1.0
        piece = between(motion, ends, number)
        h = piece.h
        low = max(low, 0.0, (earliest - time[number]) / h)
        high = min(high, 1.0, (latest - time[number]) / h)
        if high < low:
            continue
        x, y = high - GOLDEN * (high - low), low + GOLDEN * (high - low)
        at_x, at_y = moving(piece, x)[0], moving(piece, y)[0]
        for _ in range(72):
            if at_x <= at_y:
                high, y, at_y = y, x, at_x
                x = high - GOLDEN * (high - low)
                at_x = moving(piece, x)[0]
            else:
                low, x, at_x = x, y, at_y
                y = low + GOLDEN * (high - low)
                at_y = moving(piece, y)[0]
        D, s, t = moving(piece, 0.5 * (low + high))
        if best * (1.0 - SAME) > D:
            best, s_best, t_best, when = D, s, t, time[number] + 0.5 * (low + high) * h
    return sqrt(best), when, s_best, t_best
