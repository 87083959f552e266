"""Times at which two moving segments are near, or one passes through the other. Compiled; see `least_distance`."""

from __future__ import annotations

from math import sqrt

from tensegrity_mj.dynamics.native.compiling import njit
from tensegrity_mj.dynamics.native.vectors import cross, dot
from tensegrity_mj.runs.least_distance import SHORTEST, asleep
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
    sides,
)

RISE = 0.0625  # of an interval: rises above a level that are over sooner may go unnoticed
PARALLEL = 1e-5  # sine of the angle below which the normal of two lines is too uncertain
PARTS = 16  # of an interval, looked at for crossings


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
