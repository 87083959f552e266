"""Strictly convex quadratic programs with few kinds of constraints, solved on their dual, compiled:

    minimise ½ uᵀHu   subject to   A u = d,   S u >= s,   lo <= u <= hi,   H diagonal and positive.

With multipliers y = (of A u = d, of S u >= s) and G = [A; S], b = [d; s], the u that minimises the Lagrangian within
its bounds is u(y) = clip(H⁻¹Gᵀy, lo, hi). The dual θ(y) is concave, its slope is what the constraints lack,
b - G u(y), and its curvature G_F H_F⁻¹ G_Fᵀ over the strings F between their bounds. Newton's method on it with an
exact line search ends after finitely many steps: with u(y) that meets the constraints, which proves it the minimum, or
with a direction in which θ grows without bound, which proves that there is none. The minimum is unique; where the
search starts has no part in it. Rows may depend on each other.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from tensegrity_mj.dynamics.native.compiling import njit

SETTLED, NO_POINT, UNSETTLED = 0, 1, 2

TOLERANCE = 1e-12  # of what a row lacks, relative to the terms that it sums up
REGULARIZATION = 1e-12  # of the largest curvature: makes every step solvable, and is not in the result
NEAR = 1e-8  # of the same: the strings and sums at their bounds are known then
FLAT = 1e-9  # a direction of no curvature changes no string by more than this part
RAY = 1e-10  # relative size of a growth of θ that counts as one


class Columns(NamedTuple):
    """The non-zeros of G = [A; S] by columns.

    Attributes:
        starts: (M + 1,), where each column starts.
        rows, values: row and value of each non-zero; rows of a column increase.
        first: the first row that each row of G H⁻¹Gᵀ is coupled with; nothing fills in before it.
    """

    starts: Any
    rows: Any
    values: Any
    first: Any


class Program(NamedTuple):
    """Objective and constraints of a quadratic program.

    Attributes:
        columns: the non-zeros of G.
        equalities: n; the rows after them are S u >= s, whose multipliers stay >= 0.
        h: (M,) the diagonal of H.
        lo, hi: (M,) bounds of u.
        b: (n + L,) [d; s].
    """

    columns: Columns
    equalities: int
    h: Any
    lo: Any
    hi: Any
    b: Any


@njit
def columns_of(A: Any, S: Any) -> Columns:
    """The non-zeros of [A; S]."""
    n, M = A.shape
    L = len(S)
    starts = np.zeros(M + 1, np.int64)
    for m in range(M):
        count = 0
        for i in range(n):
            count += A[i, m] != 0.0
        for i in range(L):
            count += S[i, m] != 0.0
        starts[m + 1] = starts[m] + count
    rows, values = np.empty(starts[M], np.int64), np.empty(starts[M])
    for m in range(M):
        at = starts[m]
        for i in range(n + L):
            value = A[i, m] if i < n else S[i - n, m]
            if value != 0.0:
                rows[at], values[at] = i, value
                at += 1
    first = np.arange(n + L)
    for m in range(M):
        if starts[m + 1] > starts[m]:
            lowest = rows[starts[m]]
            for at in range(starts[m], starts[m + 1]):
                first[rows[at]] = min(first[rows[at]], lowest)
    return Columns(starts, rows, values, first)


@njit
def curvature(columns: Columns, h: Any, free: Any, active: Any, shift: float, K: Any) -> None:
    """Write G_F H_F⁻¹ G_Fᵀ + shift I over the active rows into the lower triangle of K, within the envelope."""
    starts, rows, values, first = columns
    for i in range(len(active)):
        for j in range(first[i], i):
            K[i, j] = 0.0
        K[i, i] = shift if active[i] else 1.0
    for m in range(len(h)):
        if free[m]:
            for p in range(starts[m], starts[m + 1]):
                i = rows[p]
                if active[i]:
                    weight = values[p] / h[m]
                    for q in range(starts[m], p + 1):
                        if active[rows[q]]:
                            K[i, rows[q]] += weight * values[q]


@njit
def factor(K: Any, first: Any, smallest: float) -> None:
    """Cholesky's factor of K in place, within the envelope; a row that depends on others gets an infinite pivot.

    A row is taken to depend on others where elimination leaves less than `smallest` of its diagonal. With its infinite
    pivot its unknown is zero in `solve`, which is right where the right-hand side is consistent.
    """
    for i in range(len(first)):
        for j in range(first[i], i):
            total = K[i, j]
            for k in range(max(first[i], first[j]), j):
                total -= K[i, k] * K[j, k]
            K[i, j] = total / K[j, j]
        pivot = K[i, i]
        for k in range(first[i], i):
            pivot -= K[i, k] * K[i, k]
        K[i, i] = np.sqrt(pivot) if pivot > smallest * K[i, i] else np.inf


@njit
def solve(K: Any, first: Any, x: Any) -> None:
    """x becomes the solution of L Lᵀ x = x."""
    n = len(first)
    for i in range(n):
        total = x[i]
        for k in range(first[i], i):
            total -= K[i, k] * x[k]
        x[i] = total / K[i, i]
    for i in range(n - 1, -1, -1):
        x[i] /= K[i, i]
        for k in range(first[i], i):
            x[k] -= K[i, k] * x[i]


@njit
def _spread(program: Program, y: Any, out: Any, size: Any) -> None:
    """out = H⁻¹Gᵀy, and the size of its terms; zero where they cancel."""
    starts, rows, values, _ = program.columns
    h = program.h
    for m in range(len(h)):
        total, terms = 0.0, 0.0
        for p in range(starts[m], starts[m + 1]):
            term = values[p] * y[rows[p]]
            total += term
            terms += abs(term)
        out[m] = total / h[m] if abs(total) > 1e-15 * terms else 0.0
        size[m] = terms / h[m]


@njit
def _lacking(program: Program, u: Any, size: Any, r: Any, scale: Any) -> None:
    """r = b - G u, and what a row may lack is relative to: its terms, and a hundredth of those that u came from."""
    starts, rows, values, _ = program.columns
    b = program.b
    origin = np.zeros(len(b))
    for i in range(len(b)):
        r[i], scale[i] = b[i], abs(b[i])
    for m in range(len(u)):
        for p in range(starts[m], starts[m + 1]):
            term = values[p] * u[m]
            r[rows[p]] -= term
            scale[rows[p]] += abs(term)
            origin[rows[p]] += 1e-2 * abs(values[p]) * size[m]
    for i in range(len(b)):
        scale[i] += min(origin[i], 1e3 * scale[i])
    floor = 0.0
    for i in range(len(b)):
        floor = max(floor, scale[i])
    for i in range(len(b)):
        scale[i] = max(scale[i], 1e-3 * floor)


@njit
def _longest_step(program: Program, slope: float, base: float, v: Any, s: Any) -> tuple[float, float]:
    """Find the step at which θ's slope along a direction falls to zero: (step, 0); or stops falling, and its rest.

    `slope` > 0 is that at the start, `base` what the proximal term adds to its fall; v and s are u without bounds and
    its rate.
    """
    h, lo, hi = program.h, program.lo, program.hi
    M = len(h)
    times, changes = np.empty(2 * M), np.empty(2 * M)
    count, fall = 0, base
    for m in range(M):
        if s[m] == 0.0:
            continue
        enter, leave = (lo[m] - v[m]) / s[m], (hi[m] - v[m]) / s[m]
        if enter > leave:
            enter, leave = leave, enter
        gain = h[m] * s[m] * s[m]
        if leave <= 0.0:
            continue
        if enter <= 0.0:
            fall += gain
        else:
            times[count], changes[count] = enter, gain
            count += 1
        if leave < np.inf:
            times[count], changes[count] = leave, -gain
            count += 1
    order = np.argsort(times[:count])
    at, largest = 0.0, fall
    for position in range(count):
        k = order[position]
        step = times[k] - at
        if slope - fall * step <= 0.0:
            return at + slope / fall, 0.0
        slope -= fall * step
        at = times[k]
        fall += changes[k]
        largest = max(largest, fall)
        if fall <= 1e-14 * largest:  # round-off of what came and went
            fall = 0.0
    if fall > 0.0:
        return at + slope / fall, 0.0
    return at, slope


@njit
def _direction(program: Program, free: Any, active: Any, shift: float, proximal: float, K: Any, r: Any, p: Any) -> bool:
    """p: Newton's direction over the active rows, or one in which θ is not curved; True for the latter."""
    first = program.columns.first
    curvature(program.columns, program.h, free, active, shift + proximal, K)
    factor(K, first, 1e-15)
    square, missed = 0.0, 0.0
    for i in range(len(r)):
        p[i] = r[i] if active[i] else 0.0
        square += p[i] * p[i]
    solve(K, first, p)
    for i in range(len(r)):
        missed += (shift * p[i]) ** 2
    flat = missed > 1e-6 * square
    if flat:
        # No string between its bounds acts on some of what is lacking: go in that direction alone, made clean of the
        # others by a second solution.
        again = shift * p
        solve(K, first, again)
        longest = 0.0
        for i in range(len(r)):
            longest = max(longest, abs(again[i]))
        for i in range(len(r)):
            p[i] = shift * again[i] if abs(again[i]) > FLAT * longest else 0.0
    return flat


@njit
def polish(program: Program, y: Any, v: Any, u: Any, K: Any) -> bool:
    """Replace a u near the minimum by the exact one, given which strings and sums are at their bounds; True if it is.

    The result depends on nothing else of y. Where the strings between their bounds do not suffice (several minima of
    the dual), those that are at a bound without a multiplier are let go too.
    """
    lo, hi, first = program.lo, program.hi, program.columns.first
    count, M = len(program.b), len(program.h)
    r, scale, x = np.empty(count), np.empty(count), np.empty(count)
    free, active = np.empty(M, np.bool_), np.empty(count, np.bool_)
    fine, raw, size = np.empty(M), np.empty(M), np.empty(M)
    largest = 0.0
    for m in range(M):
        largest = max(largest, abs(u[m]))
    for i in range(count):
        active[i] = i < program.equalities or y[i] > 0.0
    for attempt in range(2):
        margin = attempt * NEAR * largest
        for m in range(M):
            free[m] = lo[m] - margin < v[m] < hi[m] + margin
            fine[m] = 0.0 if free[m] else u[m]
            size[m] = 0.0
        for _ in range(1 + 4 * attempt):
            curvature(program.columns, program.h, free, active, 0.0, K)
            factor(K, first, 1e-13)
            x[:] = 0.0
            for m in range(M):
                if free[m]:
                    fine[m] = 0.0
            for _ in range(3):  # iterative refinement
                _lacking(program, fine, size, r, scale)
                for i in range(count):
                    if not active[i]:
                        r[i] = 0.0
                solve(K, first, r)
                for i in range(count):
                    x[i] += r[i]
                _spread(program, x, raw, size)
                for m in range(M):
                    if free[m]:
                        fine[m] = raw[m]
                    else:
                        size[m] = 0.0
            change = 0.0
            for m in range(M):
                if free[m] and not lo[m] <= fine[m] <= hi[m]:
                    free[m] = False
                    fine[m] = min(max(fine[m], lo[m]), hi[m])
                change = max(change, abs(fine[m] - u[m]))
            _lacking(program, fine, size, r, scale)
            exact = change <= 10.0 * NEAR * largest
            for i in range(count):
                exact = exact and (abs(r[i]) if active[i] else r[i]) <= TOLERANCE * scale[i]
            if exact:
                for m in range(M):
                    u[m] = fine[m]
                return True
    return False


@njit
def maximize_dual(program: Program, center: Any, proximal: float, y: Any, u: Any, limit: int) -> tuple[int, int]:
    """Take y (n + L,) to the maximum of θ(y) - proximal/2 ‖y - center‖² in `limit` iterations, and write its u(y).

    Returns:
        SETTLED, NO_POINT (the constraints contradict each other) or UNSETTLED; and the number of iterations.
    """
    h, lo, hi = program.h, program.lo, program.hi
    starts, _, values, _ = program.columns
    count, M = len(program.b), len(h)
    K = np.empty((count, count))
    r, scale, p = np.empty(count), np.empty(count), np.empty(count)
    v, s, size = np.empty(M), np.empty(M), np.empty(M)
    free, active = np.empty(M, np.bool_), np.empty(count, np.bool_)
    largest = 0.0
    for m in range(M):
        for q in range(starts[m], starts[m + 1]):
            largest = max(largest, values[q] * values[q] / h[m])
    shift = REGULARIZATION * largest if largest > 0.0 else 1.0
    for i in range(program.equalities, count):
        y[i] = max(y[i], 0.0)
    for iteration in range(limit):
        _spread(program, y, v, size)
        for m in range(M):
            u[m] = min(max(v[m], lo[m]), hi[m])
            free[m] = lo[m] < v[m] < hi[m]
            if not free[m]:
                size[m] = 0.0
        _lacking(program, u, size, r, scale)
        met, near = True, proximal == 0.0
        for i in range(count):
            r[i] -= proximal * (y[i] - center[i])
            scale[i] += proximal * (abs(y[i]) + abs(center[i]))
            active[i] = i < program.equalities or y[i] > 0.0 or r[i] > TOLERANCE * scale[i]
            if active[i]:
                met = met and abs(r[i]) <= TOLERANCE * scale[i]
                near = near and abs(r[i]) <= NEAR * scale[i]
        if near and polish(program, y, v, u, K):
            return SETTLED, iteration
        if met:
            return SETTLED, iteration
        turned, flat = True, False
        while turned:
            flat = _direction(program, free, active, shift, proximal, K, r, p)
            # A multiplier at zero that would fall stays there.
            turned = False
            for i in range(program.equalities, count):
                if active[i] and y[i] == 0.0 and p[i] < 0.0:
                    active[i], turned = False, True
        slope, reach, base, longest = 0.0, 0.0, 0.0, 0.0
        for i in range(count):
            slope += p[i] * r[i]
            reach += abs(p[i]) * scale[i]
            base += proximal * p[i] * p[i]
            longest = max(longest, abs(p[i]))
        if not slope > 0.0:
            return UNSETTLED, iteration
        _spread(program, p, s, size)
        for m in range(M):  # of a flat direction these are round-off
            whole = 0.0
            for q in range(starts[m], starts[m + 1]):
                whole += abs(values[q])
            if flat and abs(s[m]) * h[m] <= FLAT * whole * longest:
                s[m] = 0.0
        blocked = np.inf
        for i in range(program.equalities, count):
            if p[i] < 0.0:
                blocked = min(blocked, y[i] / -p[i])
        step, remains = _longest_step(program, slope, base, v, s)
        if remains > RAY * reach:
            if blocked == np.inf:
                return NO_POINT, iteration
            step = blocked
        step = min(step, blocked)
        for i in range(count):
            y[i] += step * p[i]
        for i in range(program.equalities, count):
            if y[i] < 0.0 or (p[i] < 0.0 and y[i] <= 1e-15 * step * -p[i]):
                y[i] = 0.0
    return UNSETTLED, limit
