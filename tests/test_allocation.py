"""Lemma 5.1, with and without thresholds, against SciPy's LP and least-squares solvers."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import linprog, minimize

from tensegrity_mj.controllers.allocation import feasibility_margin, least_norm


def cases(count):
    """Random problems: every sign pattern, thresholds or none, some infeasible, some with α' = 0 or zeros in v."""
    rng = np.random.default_rng(5)
    for number in range(count):
        n = int(rng.integers(1, 9))
        v = rng.normal(size=n) * 10 ** rng.uniform(-2, 2)
        if number % 5 == 0:
            v = np.abs(v) * rng.choice([-1, 1])
        if number % 7 == 0:
            v[rng.integers(n)] = 0.0
        floor = np.zeros(n) if number % 2 else rng.uniform(0, 1, n) * rng.integers(0, 2, n)
        alpha = float(rng.normal() * 10 ** rng.uniform(-2, 2))
        if number % 11 == 0:
            alpha = float(v @ floor)
        yield v, alpha, floor


def reference(v, alpha, floor, norm):
    """The least norm by a solver, or None where it finds the problem infeasible."""
    n = len(v)
    if norm == 1:
        answer = linprog(np.ones(n), A_eq=v[None], b_eq=[alpha], bounds=list(zip(floor, [None] * n, strict=True)))
        return answer.fun if answer.status == 0 else None
    if norm == np.inf:
        answer = linprog(
            np.append(np.zeros(n), 1.0),
            A_ub=np.hstack([np.eye(n), -np.ones((n, 1))]),
            b_ub=np.zeros(n),
            A_eq=np.append(v, 0.0)[None],
            b_eq=[alpha],
            bounds=[*zip(floor, [None] * n, strict=True), (0, None)],
        )
        return answer.fun if answer.status == 0 else None
    if reference(v, alpha, floor, 1) is None:
        return None
    if not v.any():
        return float(np.linalg.norm(floor))
    scale = np.linalg.norm(v)
    answer = minimize(
        lambda u: 0.5 * u @ u,
        np.maximum(floor, alpha * v / scale**2),
        jac=lambda u: u,
        bounds=list(zip(floor, [None] * n, strict=True)),
        constraints={"type": "eq", "fun": lambda u: (v @ u - alpha) / scale, "jac": lambda u: v / scale},
        method="SLSQP",
        options={"ftol": 1e-15, "maxiter": 500},
    )
    return float(np.linalg.norm(answer.x))


@pytest.mark.parametrize("norm", [1.0, 2.0, np.inf])
def test_the_explicit_minimum_is_the_solvers(norm):
    infeasible = 0
    for v, alpha, floor in cases(500):
        u = np.zeros(len(v))
        margin = least_norm(v, alpha, floor, norm, u)
        expected = reference(v, alpha, floor, norm)
        feasible = margin > 0
        # α' = 0 to round-off is feasible by u = ū up to that round-off; the solver calls it feasible.
        rest = alpha - v @ floor
        if abs(rest) > 1e-12 * (1 + abs(alpha)):
            assert feasible == (expected is not None), (v, alpha, floor)
        if expected is None:
            infeasible += 1
            assert np.array_equal(u, floor)
            continue
        if not feasible:
            continue
        assert np.all(u >= floor)
        assert abs(v @ u - alpha) <= 1e-12 * (np.abs(v) @ np.abs(u) + abs(alpha))  # round-off of the sum
        # HiGHS and SLSQP keep their constraints to 1e-7 relative, and so their optimum.
        assert np.linalg.norm(u, norm) == pytest.approx(expected, rel=2e-6, abs=1e-9)
    assert infeasible > 50


def test_the_two_norm_solution_satisfies_the_optimality_conditions_to_round_off():
    checked = 0
    for v, alpha, floor in cases(500):
        u = np.zeros(len(v))
        if not least_norm(v, alpha, floor, 2.0, u) > 0 or alpha == v @ floor:
            continue
        # u = max(ū, μ v): where u is above its threshold, u/v is one number μ; elsewhere μ v <= ū.
        free = u > floor
        assert free.any()
        mu = (u[free] / v[free])[0]
        scale = np.abs(u).max()
        assert np.abs(u[free] - mu * v[free]).max() <= 1e-12 * scale
        assert np.all(mu * v[~free] <= floor[~free] + 1e-12 * scale)
        checked += 1
    assert checked > 200


def test_without_thresholds_the_lemma_as_printed():
    rng = np.random.default_rng(8)
    for _ in range(200):
        v, alpha = rng.normal(size=6), float(rng.normal())
        ratio = v / alpha
        positive = np.maximum(ratio, 0)
        margin = feasibility_margin(v, alpha, np.zeros(6))
        assert margin == ratio.max()
        if margin <= 0:
            continue
        u = np.zeros(6)
        least_norm(v, alpha, np.zeros(6), 2.0, u)
        assert np.allclose(u, positive / (positive @ positive), rtol=1e-13, atol=0)
        least_norm(v, alpha, np.zeros(6), 1.0, u)
        expected = np.zeros(6)
        expected[np.argmax(ratio)] = 1 / ratio.max()
        assert np.allclose(u, expected, rtol=1e-13, atol=0)
        least_norm(v, alpha, np.zeros(6), np.inf, u)
        assert np.allclose(u, np.where(ratio > 0, 1 / positive.sum(), 0.0), rtol=1e-13, atol=0)
