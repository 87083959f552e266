"""Searches for the least distance of two moving segments over time, between the samples too. Compiled.

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

from tensegrity_mj.basics.arrays import Array, IntArray
from tensegrity_mj.dynamics.native.compiling import njit
from tensegrity_mj.runs.moving_segments import at_sample, lower_bound, motion_bounds, moving, sample_before, sides
from tensegrity_mj.runs.segments import closest

DEPTH = 64  # of halved stretches that wait
SHORTEST = 1e-12  # of a stretch in which a level is passed
RISE = 0.125  # of an interval: rises above a level that are over sooner may go unnoticed
GOLDEN = 0.6180339887498949
SAME = 1e-14  # of a squared distance: round-off, for which no other time is told
PARALLEL = 1e-5  # sine of the angle below which the normal of two lines is too uncertain
PARTS = 16  # of an interval, looked at for crossings


@njit
def asleep(way: Array, i: int, j: int, k: int, last: int, room: float) -> int:
    """The last sample before which two elements cannot have come nearer by `room` than they were at sample k."""
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
    P: Array,
    V: Array,
    ends: tuple,  # type: ignore[type-arg]
    k: int,
    h: float,
    first: float,
    at_first: float,
    final: float,
    at_final: float,
    best: float,
    tolerance: float,
) -> tuple[float, float, float]:
    """(distance, part, width) of the least distance within a stretch, if it is below `best` by the tolerance.

    The width is that of the stretch that it was found in, negative where nothing is below `best`.
    """
    stack = np.empty((DEPTH, 4))
    part, found = 0.0, -1.0
    speed, bend = motion_bounds(P, V, ends, k, h)
    stack[0, 0], stack[0, 1], stack[0, 2], stack[0, 3] = first, at_first, final, at_final
    count = 1
    while count > 0:
        count -= 1
        left, at_left, right, at_right = stack[count, 0], stack[count, 1], stack[count, 2], stack[count, 3]
        width = right - left
        if lower_bound(at_left, at_right, width, speed, bend, best) >= best - tolerance or width < SHORTEST:
            continue
        middle = 0.5 * (left + right)
        at_middle = sqrt(moving(P, V, ends, k, h, middle)[0])
        if at_middle < best:
            best, part, found = at_middle, middle, 0.5 * width
        stack[count, 0], stack[count, 1], stack[count, 2], stack[count, 3] = middle, at_middle, right, at_right
        count += 1
        stack[count, 0], stack[count, 1], stack[count, 2], stack[count, 3] = left, at_left, middle, at_middle
        count += 1
    return best, part, found


@njit
def least(
    P: Array,
    V: Array,
    time: Array,
    way: Array,
    i: int,
    j: int,
    ends: tuple,  # type: ignore[type-arg]
    since: float,
    until: float,
    limit: float,
    tolerance: float,
) -> tuple[float, int, float, float]:
    """(distance, interval, part, width): the least distance between two times, if below the limit by the tolerance.

    It is at most that much above the least of all. `width` is the part of the interval that it was found in; it is
    negative where nothing is below the limit.
    """
    last = sample_before(time, until)
    k = max(sample_before(time, since), 0)
    best, where, part, found = limit, k, 0.0, -1.0
    if k >= len(time) - 1:
        now = at_sample(P, ends, len(time) - 1)
        return (now, len(time) - 1, 0.0, 1.0) if now < best else (best, where, part, found)
    begin = (since - time[k]) / (time[k + 1] - time[k])
    begin = begin if begin > 0.0 else 0.0
    now = sqrt(moving(P, V, ends, k, time[k + 1] - time[k], begin)[0])
    if now < best:
        best, where, part, found = now, k, begin, 1.0
    while k < len(time) - 1 and time[k] < until:
        ahead = asleep(way, i, j, k, last, now - best + tolerance) if begin == 0.0 else k
        if ahead > k:
            k = ahead
            now = at_sample(P, ends, k)
            if now < best:
                best, where, part, found = now, k, 0.0, 1.0
            continue
        h = time[k + 1] - time[k]
        end = min(1.0, (until - time[k]) / h)
        after = at_sample(P, ends, k + 1) if end == 1.0 else sqrt(moving(P, V, ends, k, h, end)[0])
        if after < best:
            best, where, part, found = after, k, end, 1.0
        lower, x, width = halved(P, V, ends, k, h, begin, now, end, after, best, tolerance)
        if width > 0.0:
            best, where, part, found = lower, k, x, width
        k += 1
        now, begin = after, 0.0
    return best, where, part, found


@njit
def sharpened(
    P: Array,
    V: Array,
    time: Array,
    ends: tuple,  # type: ignore[type-arg]
    k: int,
    part: float,
    width: float,
    earliest: float,
    latest: float,
) -> tuple[float, float, float, float]:
    """(distance, time, s, t) of the least distance near a part of an interval, by golden section on both its sides."""
    if len(time) == 1:
        D, s, t = closest_at_sample(P, ends, 0)
        return sqrt(D), time[0], s, t
    if k == len(time) - 1:
        k, part = k - 1, 1.0
    h = time[k + 1] - time[k]
    best, s_best, t_best = moving(P, V, ends, k, h, part)
    when = time[k] + part * h
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
        h = time[number + 1] - time[number]
        low = max(low, 0.0, (earliest - time[number]) / h)
        high = min(high, 1.0, (latest - time[number]) / h)
        if high < low:
            continue
        x, y = high - GOLDEN * (high - low), low + GOLDEN * (high - low)
        at_x, at_y = moving(P, V, ends, number, h, x)[0], moving(P, V, ends, number, h, y)[0]
        for _ in range(72):
            if at_x <= at_y:
                high, y, at_y = y, x, at_x
                x = high - GOLDEN * (high - low)
                at_x = moving(P, V, ends, number, h, x)[0]
            else:
                low, x, at_x = x, y, at_y
                y = low + GOLDEN * (high - low)
                at_y = moving(P, V, ends, number, h, y)[0]
        D, s, t = moving(P, V, ends, number, h, 0.5 * (low + high))
        if best * (1.0 - SAME) > D:
            best, s_best, t_best, when = D, s, t, time[number] + 0.5 * (low + high) * h
    return sqrt(best), when, s_best, t_best


@njit
def closest_at_sample(P: Array, ends: tuple, k: int) -> tuple[float, float, float]:  # type: ignore[type-arg]
    """(D, s, t) at the sample k."""
    a, b, c, d = ends
    w = (P[a, k, 0] - P[c, k, 0], P[a, k, 1] - P[c, k, 1], P[a, k, 2] - P[c, k, 2])
    u = (P[b, k, 0] - P[a, k, 0], P[b, k, 1] - P[a, k, 1], P[b, k, 2] - P[a, k, 2])
    v = (P[d, k, 0] - P[c, k, 0], P[d, k, 1] - P[c, k, 1], P[d, k, 2] - P[c, k, 2])
    return closest(w, u, v)


@njit
def stretches(
    P: Array,
    V: Array,
    time: Array,
    way: Array,
    i: int,
    j: int,
    ends: tuple,  # type: ignore[type-arg]
    until: float,
    level: float,
    tolerance: float,
    out: Array,
) -> int:
    """Write the times [start, end] between which the distance is at most the level; returns how many they are.

    None is missed in which it is below the level at all. Rises above it that are over within the part RISE of an
    interval may be. Those beyond the length of `out` are counted only.
    """
    stack = np.empty((DEPTH * 3, 4))
    last = sample_before(time, until)
    number, k = 0, 0
    now = at_sample(P, ends, 0)
    inside = now <= level
    start = time[0]
    while k < len(time) - 1 and time[k] < until:
        if now > level:
            ahead = asleep(way, i, j, k, last, now - level)
            if ahead > k:
                k = ahead
                now = at_sample(P, ends, k)
                if now <= level:
                    start, inside = time[k], True
                continue
        h = time[k + 1] - time[k]
        end = min(1.0, (until - time[k]) / h)
        after = at_sample(P, ends, k + 1) if end == 1.0 else sqrt(moving(P, V, ends, k, h, end)[0])
        speed, bend = motion_bounds(P, V, ends, k, h)
        stack[0, 0], stack[0, 1], stack[0, 2], stack[0, 3] = 0.0, now, end, after
        count = 1
        while count > 0:
            count -= 1
            left, at_left, right, at_right = stack[count, 0], stack[count, 1], stack[count, 2], stack[count, 3]
            width = right - left
            if at_left <= level and at_right <= level:
                if width > RISE and max(at_left, at_right) + 0.5 * speed * width > level:
                    middle = 0.5 * (left + right)
                    at_middle = sqrt(moving(P, V, ends, k, h, middle)[0])
                    stack[count, 0], stack[count, 1] = middle, at_middle
                    stack[count, 2], stack[count, 3] = right, at_right
                    count += 1
                    stack[count, 0], stack[count, 1], stack[count, 2], stack[count, 3] = (
                        left,
                        at_left,
                        middle,
                        at_middle,
                    )
                    count += 1
                continue
            if at_left > level and at_right > level:
                bound = lower_bound(at_left, at_right, width, speed, bend, level)
                if bound > level or bound >= min(at_left, at_right) - tolerance or width < SHORTEST:
                    continue
                middle = 0.5 * (left + right)
                at_middle = sqrt(moving(P, V, ends, k, h, middle)[0])
                stack[count, 0], stack[count, 1], stack[count, 2], stack[count, 3] = middle, at_middle, right, at_right
                count += 1
                stack[count, 0], stack[count, 1], stack[count, 2], stack[count, 3] = left, at_left, middle, at_middle
                count += 1
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
                at_middle = sqrt(moving(P, V, ends, k, h, middle)[0])
                if (at_middle > level) == (at_left > level):
                    low, at_low = middle, at_middle
                else:
                    high, at_high = middle, at_middle
            stack[count, 0], stack[count, 1], stack[count, 2], stack[count, 3] = high, at_high, right, at_right
            count += 1
            stack[count, 0], stack[count, 1], stack[count, 2], stack[count, 3] = low, at_low, high, at_high
            count += 1
            stack[count, 0], stack[count, 1], stack[count, 2], stack[count, 3] = left, at_left, low, at_low
            count += 1
        k += 1
        now = after
    if inside:
        if number < len(out):
            out[number, 0], out[number, 1] = start, min(until, time[-1])
        number += 1
    return number


@njit
def height(P: Array, V: Array, ends: tuple, k: int, h: float, x: float) -> float:  # type: ignore[type-arg]
    """How far [m] one line is from the other along their common normal u × v: its sign is the side.

    Zero where the lines are so nearly parallel that round-off would choose the side.
    """
    w, u, v = sides(P, V, ends, k, h, x)
    n0, n1, n2 = u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]
    nn = n0 * n0 + n1 * n1 + n2 * n2
    uu = u[0] * u[0] + u[1] * u[1] + u[2] * u[2]
    vv = v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
    return (w[0] * n0 + w[1] * n1 + w[2] * n2) / sqrt(nn) if nn > PARALLEL**2 * uu * vv else 0.0


@njit
def crossings(
    P: Array,
    V: Array,
    time: Array,
    ends: tuple,  # type: ignore[type-arg]
    start: float,
    end: float,
    noise: float,
    out: Array,
) -> int:
    """Write the times within [start, end] at which one segment passes through the other; returns how many they are.

    There the lines change sides while the segments touch. Heights below `noise` [m] have no side: elements of a plane
    never pass through each other. Times beyond the length of `out` are counted only.
    """
    number = 0
    k = max(sample_before(time, start), 0)
    known, when = 0.0, 0  # the last height that has a side, and where it was
    part = 0.0
    while k < len(time) - 1 and time[k] <= end:
        h = time[k + 1] - time[k]
        first, final = max((start - time[k]) / h, 0.0), min((end - time[k]) / h, 1.0)
        for step in range(PARTS + 1):
            x = first + (final - first) * step / PARTS
            side = height(P, V, ends, k, h, x)
            if abs(side) <= noise:
                continue
            if known * side < 0.0:
                low, high = (part if when == k else 0.0), x
                for _ in range(60):
                    middle = 0.5 * (low + high)
                    if height(P, V, ends, k, h, middle) * side > 0.0:
                        high = middle
                    else:
                        low = middle
                if moving(P, V, ends, k, h, high)[0] <= (2.0 * noise) ** 2:
                    if number < len(out):
                        out[number] = time[k] + h * high
                    number += 1
            known, when, part = side, k, x
        k += 1
    return number


@njit
def search(
    P: Array,
    V: Array,
    time: Array,
    way: Array,
    nodes: IntArray,
    until: Array,
    radii: Array,
    pairs: IntArray,
    kinds: IntArray,
    limits: Array,
    own: bool,
    tolerance: float,
    out: Array,
) -> None:
    """For pairs of elements (P, 2) write (surface distance, interval, part, width) of the least distance.

    Of each kind only what is below limits[kind] is found, which it then becomes; with `own` that of every pair.
    """
    for p in range(len(pairs)):
        i, j = pairs[p]
        ends = (nodes[i, 0], nodes[i, 1], nodes[j, 0], nodes[j, 1])
        thick = radii[i] + radii[j]
        limit = np.inf if own else limits[kinds[p]] + thick
        stop = min(until[i], until[j])
        best, where, part, width = least(P, V, time, way, i, j, ends, time[0], stop, limit, tolerance)
        out[p, 0], out[p, 1], out[p, 2], out[p, 3] = best - thick, where, part, width
        if width >= 0.0:
            limits[kinds[p]] = min(limits[kinds[p]], best - thick)


@njit
def history(
    P: Array,
    time: Array,
    way: Array,
    nodes: IntArray,
    until: Array,
    radii: Array,
    pairs: IntArray,
    kinds: IntArray,
    out: Array,
) -> None:
    """Lower out (3, T) to the least surface distances of each kind at the samples."""
    for p in range(len(pairs)):
        i, j = pairs[p]
        ends = (nodes[i, 0], nodes[i, 1], nodes[j, 0], nodes[j, 1])
        thick, kind = radii[i] + radii[j], kinds[p]
        stop = min(until[i], until[j])
        known, base = -np.inf, 0.0
        for k in range(len(time)):
            if time[k] > stop:
                break
            if known - (way[i, k] + way[j, k] - base) >= out[kind, k]:
                continue
            known, base = at_sample(P, ends, k) - thick, way[i, k] + way[j, k]
            out[kind, k] = min(out[kind, k], known)


@njit
def all_stretches(
    P: Array,
    V: Array,
    time: Array,
    way: Array,
    nodes: IntArray,
    until: Array,
    radii: Array,
    pairs: IntArray,
    level: float,
    tolerance: float,
    out: Array,
    owner: IntArray,
) -> int:
    """Write the stretches (·, 2) [s] of all pairs at a surface distance of at most the level, and each one's pair.

    Returns how many they are; those beyond the length of `out` are counted only.
    """
    number = 0
    for p in range(len(pairs)):
        i, j = pairs[p]
        ends = (nodes[i, 0], nodes[i, 1], nodes[j, 0], nodes[j, 1])
        reach = level + radii[i] + radii[j]
        if reach < 0.0:
            continue
        stop = min(until[i], until[j])
        first = min(number, len(out))
        found = stretches(P, V, time, way, i, j, ends, stop, reach, tolerance, out[first:])
        owner[first : min(number + found, len(out))] = p
        number += found
    return number
