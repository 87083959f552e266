"""The least distance of two moving segments over time, between the samples too. Compiled.

The nodes are cubics of time between samples (Hermite, from positions and velocities). Let D be the squared distance of
the segments. It is the least, over the points s and t of both, of functions g of time with g̈ = 2 |ẇ|² + 2 w · ẅ, w
being what is between the points. Where |ẇ| <= V and |ẅ| <= A, and D falls below r² somewhere in a stretch of length x,
the g that does so has |w| <= r + V x in all of it, and g̈ <= K = 2 V² + 2 (r + V x) A. A function with g̈ <= K lies above
its chord minus K/2 times the product of the distances from both ends. So D at both ends bounds D from below within the
stretch, even where segments pass, cross, or change the points that are closest. V and A are those of the Bézier
points of the four corners of w. A stretch whose bound is too low is halved.

Times of a stretch are parts of the interval between two samples, within [0, 1]; V, A and K are per such part.
"""

from __future__ import annotations

from math import sqrt

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.dynamics.native.compiling import njit
from tensegrity_mj.runs.moving_segments import (
    Between,
    Ends,
    Motion,
    at_sample,
    between,
    distance,
    interval_of,
    lower_bound,
    motion_bounds,
    moving,
)

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
def halved(
    piece: Between, stretch: tuple[float, float, float, float], best: float, tolerance: float
) -> tuple[float, float, float]:
    """(distance, part, width) of the least distance within a stretch, if it is below `best` by the tolerance.

    The stretch is given by its ends and the distances there: (left, at left, right, at right).

    The width is that of the stretch that it was found in, negative where nothing is below `best`.
    """
    part, found = 0.0, -1.0
    speed, bend = motion_bounds(piece)
    waiting = [stretch]
    while len(waiting) > 0:
        left, at_left, right, at_right = waiting.pop()
        width = right - left
        if lower_bound(at_left, at_right, width, speed, bend, best) >= best - tolerance or width < SHORTEST:
            continue
        middle = 0.5 * (left + right)
        at_middle = distance(piece, middle)
        if at_middle < best:
            best, part, found = at_middle, middle, 0.5 * width
        waiting.append((middle, at_middle, right, at_right))
        waiting.append((left, at_left, middle, at_middle))
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
    k, last = interval_of(time, since), interval_of(time, until)
    best, where, part, found = limit, k, 0.0, -1.0
    begin = max((since - time[k]) / (time[k + 1] - time[k]), 0.0)
    now = distance(between(motion, ends, k), begin)
    if now < best:
        best, where, part, found = now, k, begin, 1.0
    while k < len(time) - 1 and time[k] < until:
        ahead = asleep(motion.way, pair, k, last, now - best + tolerance) if begin == 0.0 else k
        if ahead > k:
            k = ahead
            now = at_sample(motion, ends, k)
            if now < best:
                best, where, part, found = now, k, 0.0, 1.0
            continue
        piece = between(motion, ends, k)
        end = min(1.0, (until - time[k]) / piece.h)
        after = distance(piece, end)
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
    """(distance, time, s, t) of the least distance within a width of a part of an interval, by golden section.

    Where that reaches into the interval before or the one after, each has a section of its own.
    """
    time = motion.time
    earliest, latest = span
    piece = between(motion, ends, k)
    best, s_best, t_best = moving(piece, part)
    when = time[k] + part * piece.h
    for side in range(-1, 2):
        number = k + side
        if number < 0 or number > len(time) - 2:
            continue
        piece = between(motion, ends, number)
        low = max(part - width - side, 0.0, (earliest - time[number]) / piece.h)
        high = min(part + width - side, 1.0, (latest - time[number]) / piece.h)
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
            best, s_best, t_best, when = D, s, t, time[number] + 0.5 * (low + high) * piece.h
    return sqrt(best), when, s_best, t_best
