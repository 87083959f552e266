"""Lemma 5.1, with thresholds and ceilings, against LP and QP solvers, its optimality conditions, and as printed."""

from __future__ import annotations

from ctypes import c_int

import daqp
import numpy as np
import pytest
from scipy.optimize import linprog

from tensegrity_mj.controllers.allocation import feasibility_margin, least_norm

NORMS = [1.0, 2.0, np.inf]
TOLERANCE = 1e-7  # HiGHS keeps constraints and reduced costs to this; daqp is set to keep 1e-10


def cases(count, seed=5):
    """Random problems of order one: all sign patterns, thresholds, ceilings, or none; some infeasible, some at an edge.

    Every seventh has a zero in v, every fifth one sign only, every eleventh α' = 0; half have ceilings, of which some
    lie on their threshold; of those, half need nearly all, or a bit more than all, that the ceilings allow.
    """
    rng = np.random.default_rng(seed)
    for number in range(count):
        n = int(rng.integers(1, 13))
        v = rng.normal(size=n)
        if number % 5 == 0:
            v = np.abs(v) * rng.choice([-1, 1])
        if number % 7 == 0:
            v[rng.integers(n)] = 0.0
        if number % 13 == 0:
            v = np.full(n, v[0])  # ties
        floor = np.zeros(n) if number % 2 else rng.integers(0, 64, n) * rng.integers(0, 2, n) / 64
        ceiling = np.full(n, np.inf)
        alpha = float(rng.normal() * 2)
        if number % 4 < 2:
            limited = rng.uniform(size=n) < 0.8
            ceiling[limited] = (floor + rng.uniform(0, 2, n) * rng.integers(0, 5, n).clip(0, 1))[limited]
            room = ceiling - floor
            capacity = np.sum(v[v > 0] * room[v > 0])
            if np.isfinite(capacity) and capacity > 0 and rng.uniform() < 0.5:
                alpha = float(v @ floor + capacity * rng.choice([0.5, 0.9, 0.999, 1.001, 1.1]))
        if number % 11 == 0:
            v = np.round(64 * v) / 64
            alpha = float(v @ floor)  # without round-off
        yield v, alpha, floor, ceiling


def linear_program(v, alpha, floor, ceiling, norm):
    """The least 1-norm or ∞-norm by HiGHS, and its tolerance; None where it finds no solution."""
    n, bounds = len(v), list(zip(floor, ceiling, strict=True))
    if norm == 1:
        answer = linprog(np.ones(n), A_eq=v[None], b_eq=[alpha], bounds=bounds, method="highs")
    else:
        answer = linprog(
            np.append(np.zeros(n), 1.0),
            A_ub=np.hstack([np.eye(n), -np.ones((n, 1))]),
            b_ub=np.zeros(n),
            A_eq=np.append(v, 0.0)[None],
            b_eq=[alpha],
            bounds=[*bounds, (0, None)],
            method="highs",
        )
    if answer.status != 0:
        assert answer.status == 2, answer.message  # infeasible, not failed
        return None
    # Constraints that are off by 1e-7 change the optimum by that times their multipliers; reduced costs likewise.
    multipliers = np.abs(answer.eqlin.marginals).sum() + np.abs(answer.lower.marginals).sum()
    multipliers += np.abs(answer.upper.marginals).sum() + np.abs(answer.ineqlin.marginals).sum()
    return answer.fun, TOLERANCE * (multipliers + np.abs(answer.x).sum() + 1)


def quadratic_program(v, alpha, floor, ceiling):
    """The minimizer of ‖u‖₂ by daqp; None where it finds no solution."""
    n = len(v)
    sense = np.zeros(n + 1, dtype=c_int)
    sense[-1] = 5
    u, _, flag, info = daqp.solve(
        np.eye(n),
        np.zeros(n),
        v[None].copy(),
        np.append(np.where(np.isfinite(ceiling), ceiling, 1e30), alpha),
        np.append(floor, alpha),
        sense,
        primal_tol=1e-10,
    )
    assert flag in (1, -1), flag
    return (u, np.abs(info["lam"]).sum()) if flag == 1 else None


def is_at_an_edge(v, alpha, floor, ceiling):
    """Whether a change of α by the solvers' tolerance decides if there is a solution."""
    rest = alpha - v @ floor
    w = v * np.sign(rest)
    capacity = np.sum(w[w > 0] * (ceiling - floor)[w > 0])
    return abs(rest) < 1e-6 or abs(capacity - abs(rest)) < 1e-6


@pytest.mark.parametrize("norm", NORMS)
def test_the_explicit_minimum_is_the_solvers(norm):
    infeasible = limited = 0
    for v, alpha, floor, ceiling in cases(300):
        u = np.full(len(v), np.nan)
        margin = least_norm(v, alpha, floor, ceiling, norm, u)
        assert margin == feasibility_margin(v, alpha, floor, ceiling)
        expected = linear_program(v, alpha, floor, ceiling, 1.0 if norm == 2 else norm)
        if is_at_an_edge(v, alpha, floor, ceiling):
            if alpha == v @ floor:
                assert margin > 0
        else:
            assert (margin > 0) == (expected is not None), (v, alpha, floor, ceiling)
        if not margin > 0:
            infeasible += 1
            assert np.array_equal(u, floor)
            continue
        assert np.all(u >= floor)
        assert np.all(u <= ceiling)
        limited += bool(np.any((u == ceiling) & (floor < ceiling)))
        # Round-off of sums of n terms, a few times over.
        assert abs(v @ u - alpha) <= 1e-14 * len(v) * (np.abs(v) @ np.abs(u) + abs(alpha))
        if expected is None:
            continue
        if norm == 2:
            reference, multipliers = quadratic_program(v, alpha, floor, ceiling)
            # ‖u‖²/2 is 1-strongly convex: half the distance squared is at most what the objectives differ by, which
            # is 1e-10 times the multipliers; √2e-10 ~ 1.5e-5 of their root.
            assert np.linalg.norm(u - reference) <= 2e-5 * np.sqrt(1 + multipliers)
            assert 0.5 * u @ u <= 0.5 * reference @ reference + 1e-10 * (1 + multipliers + np.abs(reference).sum())
        else:
            least, tolerance = expected
            assert abs(np.linalg.norm(u, norm) - least) <= tolerance
    assert infeasible > 50
    assert limited > 20


def test_the_two_norm_solution_satisfies_the_optimality_conditions_to_round_off():
    checked = clipped = 0
    for v, alpha, floor, ceiling in cases(1000, seed=6):
        u = np.zeros(len(v))
        if not least_norm(v, alpha, floor, ceiling, 2.0, u) > 0 or alpha == v @ floor:
            continue
        # u = min(max(ū, μ v), c): between the bounds u/v is one number μ; at them μ v is beyond.
        free = (u > floor) & (u < ceiling)
        low, high = (u == floor) & ~free, (u == ceiling) & ~free
        scale = np.abs(u).max()
        if not free.any():
            continue  # all at bounds: any solution of the equation is then unique or decided by the solvers above
        mu = (u[free] / v[free])[0]
        assert mu * (alpha - v @ floor) > 0
        assert np.abs(u[free] - mu * v[free]).max() <= 1e-12 * scale
        assert np.all((mu * v)[low & ~high] <= floor[low & ~high] + 1e-12 * scale)
        assert np.all((mu * v)[high & ~low] >= ceiling[high & ~low] - 1e-12 * scale)
        checked += 1
        clipped += bool(np.any(high & ~low))
    assert checked > 400
    assert clipped > 80


@pytest.mark.parametrize("norm", NORMS)
def test_units_do_not_matter(norm):
    """Other units of v or u, by powers of two, change nothing but the units: bit by bit, also far from one."""
    for v, alpha, floor, ceiling in cases(100, seed=7):
        u, other = np.zeros(len(v)), np.zeros(len(v))
        margin = least_norm(v, alpha, floor, ceiling, norm, u)
        for exponent in (-40, -3, 5, 60):
            s = 2.0**exponent
            assert least_norm(s * v, s * alpha, floor, ceiling, norm, other) == margin
            assert np.array_equal(other, u)
            assert least_norm(v, s * alpha, s * floor, s * ceiling, norm, other) == margin / s
            assert np.array_equal(other, s * u)
            assert least_norm(-v, -alpha, floor, ceiling, norm, other) == margin
            assert np.array_equal(other, u)


@pytest.mark.parametrize("norm", [2.0])
def test_the_minimum_is_continuous(norm):
    """From one problem to another, u moves by no more than the path's step times a bound: no jump at any ceiling."""
    rng = np.random.default_rng(9)
    for _ in range(40):
        n = 6
        first, second = rng.normal(size=(2, n))
        floor = rng.uniform(0, 0.3, n)
        ceiling = floor + rng.uniform(0.05, 1.0, n)
        weight = rng.uniform(0.1, 0.9)

        def solve(s, first=first, second=second, floor=floor, ceiling=ceiling, weight=weight, n=n):
            v = (1 - s) * first + s * second
            positive = np.maximum(v, 0)
            alpha = v @ floor + weight * positive @ (ceiling - floor)  # solvable wherever some v is positive
            u = np.zeros(n)
            margin = least_norm(v, alpha, floor, ceiling, norm, u)
            return u, margin, positive

        for s in rng.uniform(0, 1, 20):
            u, margin, positive = solve(s)
            if positive.max() < 0.2:
                continue
            assert margin > 0
            # u is Lipschitz in v and α: with |dv/ds| <= 6, u <= 1.3 and some moving string of |v| >= 0.2, du/ds is
            # of the order of 6 · 1.3 / 0.2² ~ 2e2: 1e-8 of s moves u by some 1e-6. A jump would be 1e-2 or more.
            assert np.abs(solve(s + 1e-8)[0] - u).max() < 1e-4


def test_the_margin_is_continuous_where_it_changes_sign():
    v, floor = np.array([1.0, -0.5, 2.0]), np.array([0.1, 0.0, 0.2])
    free = np.full(3, np.inf)
    alpha = v @ floor + 3.0
    assert feasibility_margin(v, alpha, floor, free) == pytest.approx(2.0 / 3.0, rel=1e-15)  # max(v/α'), (5.18)
    # All ceilings at threshold + h: C = 3 h, what is needed is 3.
    for h, expected in ((10.0, 2 / 3), (2.0, 2 / 3), (1.5, 1 / 3), (1.0, 0.0), (0.5, -1 / 3), (0.0, -2 / 3)):
        assert feasibility_margin(v, alpha, floor, floor + h) == pytest.approx(expected, abs=1e-14)
    # As the last helpful string ceases to help, the margin passes zero without a jump, ceilings or not.
    for ceiling in (free, floor + 0.1):
        small = [feasibility_margin(np.array([x, -0.5, -1.0]), 3.0, 0 * floor, ceiling) for x in (1e-9, 0.0, -1e-9)]
        assert np.abs(small).max() <= 1e-9
        assert small[1] == 0.0
        assert small[2] < 0.0
    assert small[0] < 0.0  # 1e-10 is not enough for 3


def test_a_ceiling_below_its_threshold_leaves_no_solution():
    v, floor = np.array([1.0, -0.5]), np.array([0.1, 0.3])
    u = np.zeros(2)
    assert least_norm(v, 1.0, floor, np.array([5.0, 0.2]), 2.0, u) == -np.inf
    assert least_norm(v, v @ floor, floor, np.array([5.0, 0.2]), 2.0, u) == -np.inf


def test_without_thresholds_the_lemma_as_printed():
    rng = np.random.default_rng(8)
    none, free = np.zeros(6), np.full(6, np.inf)
    for _ in range(200):
        v, alpha = rng.normal(size=6), float(rng.normal())
        ratio = v / alpha
        positive = np.maximum(ratio, 0)
        margin = feasibility_margin(v, alpha, none, free)
        assert margin == ratio.max()
        if margin <= 0:
            continue
        u = np.zeros(6)
        least_norm(v, alpha, none, free, 2.0, u)
        assert np.allclose(u, positive / (positive @ positive), rtol=1e-13, atol=0)
        least_norm(v, alpha, none, free, 1.0, u)
        expected = np.zeros(6)
        expected[np.argmax(ratio)] = 1 / ratio.max()
        assert np.allclose(u, expected, rtol=1e-13, atol=0)
        least_norm(v, alpha, none, free, np.inf, u)
        assert np.allclose(u, np.where(ratio > 0, 1 / positive.sum(), 0.0), rtol=1e-13, atol=0)
