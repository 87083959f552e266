"""Least distances of moving segments over time, between the samples too, and when pairs of them are near. Compiled.

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
from typing import NamedTuple

import numpy as np

from tensegrity_mj.basics.arrays import Array, IntArray
from tensegrity_mj.dynamics.native.compiling import njit
from tensegrity_mj.dynamics.native.vectors import cross, dot
from tensegrity_mj.runs.segments import (
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
    sides,
)

SHORTEST = 1e-12  # of a stretch in which a level is passed
GOLDEN = 0.6180339887498949
SAME = 1e-14  # of a squared distance: round-off, for which no other time is reported
RISE = 0.0625  # of an interval: rises above a level that are over sooner may go unnoticed
PARALLEL = 1e-5  # sine of the angle below which the normal of two lines is too uncertain
PARTS = 16  # of an interval, looked at for crossings


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


@njit
def stretches(
    motion: Motion, pair: tuple[int, int], ends: Ends, until: float, level: float, tolerance: float
) -> list[tuple[float, float]]:
    """The times [start, end] between which the distance is at most the level.

    None is missed in which it is below the level at all. Rises above it that are over within the part RISE of an
    interval may be.
    """
    time = motion.time
    last = interval_of(time, until)
    found = []
    k, start = 0, time[0]
    now = at_sample(motion, ends, 0)
    inside = now <= level
    while k < len(time) - 1 and time[k] < until:
        ahead = asleep(motion.way, pair, k, last, now - level) if now > level else k
        if ahead > k:
            k = ahead
            now = at_sample(motion, ends, k)
            if now <= level:
                start, inside = time[k], True
            continue
        piece = between(motion, ends, k)
        end = min(1.0, (until - time[k]) / piece.h)
        after = distance(piece, end)
        speed, bend = motion_bounds(piece)
        waiting = [(0.0, now, end, after)]
        while len(waiting) > 0:
            left, at_left, right, at_right = waiting.pop()
            width = right - left
            low, high = min(at_left, at_right), max(at_left, at_right)
            if high <= level:
                whole = width <= RISE or high + 0.5 * speed * width <= level
            elif low > level:
                bound = lower_bound(at_left, at_right, width, speed, bend, level)
                whole = bound > level or bound >= low - tolerance or width < SHORTEST
            else:
                whole = width <= SHORTEST
                if whole and at_left > level:
                    start, inside = time[k] + piece.h * right, True
                elif whole:
                    found.append((start, time[k] + piece.h * left))
                    inside = False
            if not whole:
                middle = 0.5 * (left + right)
                at_middle = distance(piece, middle)
                waiting.append((middle, at_middle, right, at_right))
                waiting.append((left, at_left, middle, at_middle))
        k += 1
        now = after
    if inside:
        found.append((start, min(until, time[-1])))
    return found


@njit
def height(piece: Between, x: float) -> float:
    """Distance [m] of one line from the other along their common normal u × v: its sign is the side.

    Zero where the lines are so nearly parallel that round-off would choose the side.
    """
    w, u, v = sides(piece, x)
    n = cross(u, v)
    nn = dot(n, n)
    return dot(w, n) / sqrt(nn) if nn > PARALLEL**2 * dot(u, u) * dot(v, v) else 0.0


@njit
def crossings(motion: Motion, ends: Ends, span: tuple[float, float], noise: float) -> list[float]:
    """The times of a span at which one segment passes through the other.

    There the lines change sides while the segments touch. Heights below `noise` [m] have no side: elements of a plane
    never pass through each other.
    """
    time = motion.time
    start, end = span
    found = []
    k = interval_of(time, start)
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
                    found.append(time[k] + h * high)
            known, when, part = side, k, x
        k += 1
    return found


class Elements(NamedTuple):
    """Rods, then strings.

    Attributes:
        nodes: (E, 2).
        until: (E,) [s] when each is gone.
        radii: (E,) [m].
    """

    nodes: IntArray
    until: Array
    radii: Array


class Couples(NamedTuple):
    """Pairs of elements (P, 2) and their kinds (P,)."""

    pairs: IntArray
    kinds: IntArray


@njit
def couple(elements: Elements, i: int, j: int) -> tuple[Ends, float, float]:
    """The four nodes of two elements, the sum of their radii [m], and when the first of them is gone [s]."""
    nodes, until, radii = elements
    ends = (nodes[i, 0], nodes[i, 1], nodes[j, 0], nodes[j, 1])
    return ends, radii[i] + radii[j], min(until[i], until[j])


@njit
def search(
    motion: Motion, elements: Elements, couples: Couples, limits: Array, own: bool, tolerance: float, out: Array
) -> None:
    """Write (surface distance, interval, part, width) of the least distance of pairs of elements (P, 2).

    Of each kind only what is below limits[kind] is found, which it then becomes; with `own` that of every pair.
    """
    pairs, kinds = couples
    for p in range(len(pairs)):
        i, j = pairs[p]
        ends, thick, stop = couple(elements, i, j)
        limit = np.inf if own else limits[kinds[p]] + thick
        best, where, part, width = least(motion, (i, j), ends, (motion.time[0], stop), limit, tolerance)
        out[p, 0], out[p, 1], out[p, 2], out[p, 3] = best - thick, where, part, width
        if width >= 0.0:
            limits[kinds[p]] = min(limits[kinds[p]], best - thick)


@njit
def history(motion: Motion, elements: Elements, couples: Couples, out: Array) -> None:
    """Lower out (3, T) to the least surface distances of each kind at the samples."""
    time, way = motion.time, motion.way
    pairs, kinds = couples
    for p in range(len(pairs)):
        i, j = pairs[p]
        ends, thick, stop = couple(elements, i, j)
        kind = kinds[p]
        known, base = -np.inf, 0.0
        for k in range(len(time)):
            if time[k] > stop:
                break
            if known - (way[i, k] + way[j, k] - base) >= out[kind, k]:
                continue
            known, base = at_sample(motion, ends, k) - thick, way[i, k] + way[j, k]
            out[kind, k] = min(out[kind, k], known)


@njit
def all_stretches(
    motion: Motion, elements: Elements, pairs: IntArray, level: float, tolerance: float
) -> list[tuple[int, float, float]]:
    """Stretches of time at a surface distance of at most the level: the pair's row, start and end [s]."""
    found = []
    for p in range(len(pairs)):
        i, j = pairs[p]
        ends, thick, stop = couple(elements, i, j)
        if level + thick >= 0.0:
            for start, end in stretches(motion, (i, j), ends, stop, level + thick, tolerance):
                found.append((p, start, end))
    return found
