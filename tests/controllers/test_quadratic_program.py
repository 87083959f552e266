"""The allocation's quadratic program: against other solvers, with an independent proof of each minimum."""

from __future__ import annotations

from typing import Any

import daqp
import numpy as np
import pytest
from numpy.typing import NDArray
from quadratic_problems import Problem, random_problem, solve
from scipy.optimize import linprog, lsq_linear

import tensegrity_mj as tmj
from tensegrity_mj.controllers import Allocation, Sum, WhenInfeasible
from tensegrity_mj.controllers.allocation import least_norm
from tensegrity_mj.controllers.optimal_allocation import Allocator, Equation
from tensegrity_mj.controllers.quadratic_program import NO_POINT, SETTLED, factor
from tensegrity_mj.controllers.quadratic_program import solve as solve_factored
from tensegrity_mj.errors import InfeasibleError, OptionError

Array = NDArray[np.float64]


def highs(p: Problem, cost: Array) -> Any:
    """The least costᵀu over the same constraints."""
    return linprog(
        cost,
        A_ub=-p.S if len(p.s) else None,
        b_ub=-p.s if len(p.s) else None,
        A_eq=p.A if len(p.d) else None,
        b_eq=p.d if len(p.d) else None,
        bounds=np.column_stack([p.lo, p.hi]),
        method="highs-ds",
    )


def lacking(p: Problem, u: Array) -> float:
    """Largest violation of a constraint."""
    parts = [np.abs(p.A @ u - p.d), p.s - p.S @ u, p.lo - u, u - p.hi]
    return max(float(np.max(part, initial=0.0)) for part in parts)


def test_minima_are_proved_by_a_linear_program() -> None:
    # u is the minimum if and only if no admissible w has ∇J(u)ᵀw < ∇J(u)ᵀu: a linear program, solved by HiGHS to
    # 1e-7 of feasibility, which its right-hand sides of size ten turn into some 1e-6 of the cost.
    rng = np.random.default_rng(11)
    settled = 0
    for _ in range(400):
        p = random_problem(rng, feasible=True)
        status, u = solve(p)
        settled += status == SETTLED
        if status != SETTLED:
            continue
        # Promised: 1e-12 of what each row sums up, here up to a hundred (and 1e-9 where u comes from huge terms).
        assert lacking(p, u) < 1e-9
        gradient = p.h * u
        best = highs(p, gradient)
        assert best.status == 0
        assert gradient @ u <= best.fun + 1e-6 * (1 + abs(best.fun))
    assert settled >= 399  # one in some thousands goes to the library


def test_minima_are_those_of_daqp() -> None:
    rng = np.random.default_rng(12)
    for _ in range(300):
        p = random_problem(rng, feasible=True)
        status, u = solve(p)
        above = np.concatenate([np.minimum(p.hi, 1e30), p.d, np.full(len(p.s), 1e30)])
        below = np.concatenate([p.lo, p.d, p.s])
        kinds = np.concatenate([np.zeros(len(u)), np.full(len(p.d), 5), np.zeros(len(p.s))]).astype(np.int32)
        G = np.vstack([p.A, p.S])
        other, _, flag, _ = daqp.solve(np.diag(p.h), np.zeros(len(u)), G, above, below, kinds, primal_tol=1e-10)
        if status != SETTLED or flag != 1 or lacking(p, np.asarray(other)) > 1e-9:
            continue  # daqp misses some of the degenerate ones by up to 1e-4
        # Strong convexity: ‖u - w‖² <= 2/h_min (J(w) - J(u) + multipliers times 1e-9).
        np.testing.assert_allclose(u, other, rtol=0, atol=1e-4)
        assert p.h @ (u * u) == pytest.approx(p.h @ (other * other), rel=1e-7, abs=1e-7)


def test_contradictions_are_found_where_highs_finds_them() -> None:
    rng = np.random.default_rng(13)
    found = {True: 0, False: 0}
    for _ in range(400):
        p = random_problem(rng, feasible=False)
        status, _ = solve(p)
        possible = highs(p, np.zeros(len(p.h))).status == 0
        if status in (SETTLED, NO_POINT):
            assert (status == SETTLED) == possible
        found[possible] += status in (SETTLED, NO_POINT)
    assert found[True] > 50
    assert found[False] > 200
    assert sum(found.values()) >= 398


def test_where_the_search_starts_has_no_part_in_its_end() -> None:
    rng = np.random.default_rng(14)
    for _ in range(200):
        p = random_problem(rng, feasible=True)
        _, u = solve(p)
        size = len(p.d) + len(p.s)
        for scale in (1e-3, 1.0, 1e3):
            status, again = solve(p, scale * rng.normal(size=size))
            if status == SETTLED:
                # Where u is degenerate it is exact to 1e-8 of the largest; elsewhere to round-off.
                np.testing.assert_allclose(again, u, rtol=0, atol=3e-8 * (1 + np.abs(u).max()))


def test_rows_that_depend_on_others_get_nothing() -> None:
    rng = np.random.default_rng(19)
    G = rng.normal(size=(5, 9))
    G[3] = 2 * G[0] - G[2]
    K, x = G @ G.T, G @ rng.normal(size=9)
    b, first = x.copy(), np.zeros(5, np.int64)
    whole = K.copy()
    factor(K, first, 1e-13)
    solve_factored(K, first, x)
    assert x[3] == 0
    np.testing.assert_allclose(whole @ x, b, rtol=0, atol=1e-10)  # condition 1e2, terms up to 1e2
    # An envelope leaves out zeros and changes nothing.
    band = np.tril(np.triu(rng.normal(size=(6, 6)), -2)) + 4 * np.eye(6)
    K, x = band @ band.T, rng.normal(size=6)
    expected = np.linalg.solve(K, x)
    factor(K, np.maximum(np.arange(6) - 2, 0), 1e-13)
    solve_factored(K, np.maximum(np.arange(6) - 2, 0), x)
    np.testing.assert_allclose(x, expected, rtol=1e-12)


def test_no_request_gives_the_floor() -> None:
    p = Problem(
        np.zeros((0, 3)), np.zeros(0), np.zeros((0, 3)), np.zeros(0), np.ones(3), np.array([0.0, 1, 2]), 9 * np.ones(3)
    )
    status, u = solve(p)
    assert status == SETTLED
    np.testing.assert_array_equal(u, [0.0, 1.0, 2.0])
    p = p._replace(A=np.ones((2, 3)), d=np.array([3.0, 3.0]))  # met by the floor, twice over
    np.testing.assert_array_equal(solve(p)[1], [0.0, 1.0, 2.0])


# Allocation -----------------------------------------------------------------------------------------------


def rod_with(strings: int, **limits: Any) -> tmj.Structure:
    """Anything with so many strings: s1 ... at (1, 0, 0) of a rod."""
    nodes = [[0.0, 0, 0], [1.0, 0, 0]] + [[i + 2.0, 1, 0] for i in range(strings)]
    made = tmj.Structure.from_arrays(
        nodes,
        [(0, 1)],
        [(1, i + 2) for i in range(strings)],
        rod_mass=1.0,
        stiffness=10.0,
        fixed_nodes=range(2, strings + 2),
    )
    return made.with_strings(**limits) if limits else made


def equations(count: int) -> list[Equation]:
    return [Equation(f"x{i + 1}", "m/s²") for i in range(count)]


def allocator(p: Problem, **options: Any) -> Allocator:
    names = [f"s{i + 1}" for i in range(len(p.h))]
    sums = [
        Sum(float(value), tuple(name for name, one in zip(names, row, strict=True) if one))
        for row, value in zip(p.S, p.s, strict=True)
    ]
    given: dict[str, Any] = {"weight": p.h, "minimum_force_density": p.lo, "maximum_force_density": p.hi, "sums": sums}
    return Allocator(Allocation(**(given | options)), rod_with(len(p.h)), equations(len(p.d)))


def test_a_full_weight_gives_its_minimum() -> None:
    rng = np.random.default_rng(15)
    different = 0
    for _ in range(60):
        p = random_problem(rng, feasible=True)
        B = rng.normal(size=(len(p.h), len(p.h)))
        H = B @ B.T + np.eye(len(p.h))
        u, violation = allocator(p, weight=H).solve(p.A, p.d)
        assert violation < 1e-6
        best = highs(p, H @ u)
        assert u @ H @ u <= best.fun + 1e-5 * (1 + abs(best.fun))
        different += bool(np.abs(solve(p)[1] - u).max() > 1e-3)
    assert different > 30  # the weight matters


def test_a_diagonal_matrix_is_a_diagonal() -> None:
    rng = np.random.default_rng(16)
    p = random_problem(rng, feasible=True)
    np.testing.assert_array_equal(allocator(p, weight=np.diag(p.h)).solve(p.A, p.d).u, allocator(p).solve(p.A, p.d).u)


def test_relaxed_violations_are_least_and_then_the_cost() -> None:
    rng = np.random.default_rng(17)
    contradictions = 0
    for _ in range(120):
        p = random_problem(rng, feasible=False)
        if rng.random() < 0.5:  # fewer strings than equations too
            rows = rng.normal(size=(3, len(p.h)))
            p = p._replace(A=np.vstack([p.A, rows]), d=np.append(p.d, 3 * rng.normal(size=3)))
        u, violation = allocator(p, on_infeasible=WhenInfeasible.RELAX).solve(p.A, p.d)
        assert np.all((u >= p.lo) & (u <= p.hi))
        missed, short = p.A @ u - p.d, np.maximum(p.s - p.S @ u, 0)
        assert violation == pytest.approx(max(np.abs(missed).max(initial=0), short.max(initial=0)), abs=1e-14)
        if solve(p)[0] == SETTLED:
            assert violation < 1e-9
            continue
        contradictions += 1
        # Bounded least squares with slacks t >= 0 of the sums, S u - t = s: the least sum of squares, to 1e-10.
        n, L, M = len(p.d), len(p.s), len(p.h)
        G = np.block([[p.A, np.zeros((n, L))], [p.S, -np.eye(L)]])
        bounds = (np.append(p.lo, np.zeros(L)), np.append(p.hi, np.full(L, np.inf)))
        least = lsq_linear(G, np.append(p.d, p.s), bounds, method="bvls", tol=1e-14)
        assert missed @ missed + short @ short <= 2 * least.cost + 1e-8
        # Of all u that violate no more, the cheapest: the program with that violation allowed has the same minimum.
        eased = p._replace(d=p.A @ u, s=np.minimum(p.s, p.S @ u))
        best = highs(eased, p.h * u)
        if best.status == 0:
            assert p.h @ (u * u) <= best.fun + 1e-5 * (1 + abs(best.fun))
        assert len(u) == M
    assert contradictions > 40


def test_one_equation_has_the_solutions_of_lemma_51() -> None:
    rng = np.random.default_rng(18)
    for _ in range(100):
        M = int(rng.integers(1, 8))
        v, alpha, floor = rng.normal(size=M), rng.normal(), rng.random(M) * rng.integers(0, 2)
        for norm, options in ((2.0, {}), (1.0, {"linear": np.ones(M)})):
            expected = np.empty(M)
            margin = least_norm(v, alpha, floor, np.full(M, np.inf), norm, expected)
            made = Allocator(Allocation(minimum_force_density=floor, **options), rod_with(M), equations(1))
            if margin > 0:
                # HiGHS meets its equation to 1e-7; an exact tie of two strings in the 1-norm has no measure.
                u = made.solve(v[None], np.array([alpha])).u
                np.testing.assert_allclose(u, expected, rtol=0, atol=1e-11 if norm == 2 else 1e-6 * (1 + u.max()))
            else:
                with pytest.raises(InfeasibleError, match="x1 is missed by"):
                    made.solve(v[None], np.array([alpha]))


def test_faults_name_what_cannot_be_met() -> None:
    ones = np.ones((1, 3))
    cases: list[tuple[Allocation, Array, float, tuple[str, ...]]] = [
        (Allocation(), ones, -2.0, ("x1 is missed by 2 m/s²", "'s1' at its minimum of 0 N/m")),
        (Allocation(maximum_force_density=1.0), ones, 5.0, ("x1 is missed by 2 m/s²", "'s1' at its maximum of 1 N/m")),
        (
            Allocation(maximum_force_density=[1.0, 2.0, 4.0], sums=[Sum(0.5), Sum(4.0, ("s1", "s2"))]),
            np.zeros((1, 3)),
            0.0,
            ("sum 2 (of s1, s2) >= 4 falls short by 1 N/m", "'s2' at its maximum of 2 N/m"),
        ),
        (
            Allocation(maximum_force_density=1.0, sums=[Sum(9.0)]),
            np.zeros((1, 3)),
            0.0,
            ("sum 1 (of all strings) >= 9 falls short by 6 N/m",),
        ),
    ]
    for allocation, A, d, parts in cases:
        with pytest.raises(InfeasibleError) as caught:
            Allocator(allocation, rod_with(3), equations(1)).solve(A, np.array([d]))
        for part in parts:
            assert part in str(caught.value)


def test_holding_gives_the_last_admissible() -> None:
    made = Allocator(Allocation(on_infeasible=WhenInfeasible.HOLD), rod_with(2), equations(1))
    A = np.ones((1, 2))
    with pytest.raises(InfeasibleError):
        made.solve(A, np.array([-1.0]))  # nothing to hold yet
    u, _ = made.solve(A, np.array([3.0]))
    held, violation = made.solve(A, np.array([-1.0]))
    np.testing.assert_array_equal(held, u)
    assert violation == pytest.approx(4.0, abs=1e-14)


def test_the_strings_own_limits_count() -> None:
    structure = rod_with(2, max_force_density=2.0, min_rest_length=1.0)
    nodes = structure.positions.copy()
    A, d = np.ones((1, 2)), np.array([3.0])
    lengths = structure.string_lengths(nodes)  # 1.41, 2.24: L0 >= 1 m leaves k (1 - 1/L) = 2.9 and 5.5 N/m
    np.testing.assert_allclose(
        Allocator(Allocation(weight=[1.0, 9.0]), structure, equations(1)).solve(A, d, nodes).u, [2.0, 1.0], atol=1e-14
    )
    nodes[2] = [2.0, 0.5, 0.0]  # 1.118 m: 1.056 N/m
    lengths = structure.string_lengths(nodes)
    most = 10.0 * (1 - 1 / lengths[0])
    u = Allocator(Allocation(weight=[1.0, 9.0]), structure, equations(1)).solve(A, d, nodes).u
    np.testing.assert_allclose(u, [most, 3 - most], atol=1e-14)
    free = Allocation(weight=[1.0, 9.0], respect_limits=False)
    np.testing.assert_allclose(Allocator(free, structure, equations(1)).solve(A, d, nodes).u, [2.7, 0.3], atol=1e-14)


@pytest.mark.parametrize(
    ("options", "part"),
    [
        ({"weight": 0.0}, "every value must be > 0"),
        ({"weight": [[1.0, 2.0], [2.0, 1.0]]}, "smallest eigenvalue"),
        ({"weight": [[1.0, 0.5], [0.0, 1.0]]}, "symmetric"),
        ({"weight": "heavy"}, "weight"),
        ({"minimum_force_density": -1.0}, "minimum_force_density"),
        ({"maximum_force_density": np.nan}, "maximum_force_density"),
        ({"minimum_force_density": 2.0, "maximum_force_density": [3.0, 1.0]}, "string 's2'"),
        ({"sums": [1.2]}, "sums[0]"),
        ({"sums": [Sum(1.0, ("s9",))]}, "unknown string 's9'"),
        ({"linear": [1.0, -1.0]}, "'s2'"),
        ({"on_infeasible": "stopp"}, "WhenInfeasible.STOP"),
    ],
)
def test_options_that_are_refused(options: dict[str, Any], part: str) -> None:
    with pytest.raises(OptionError) as caught:
        Allocator(Allocation(**options), rod_with(2), equations(1))
    assert part in str(caught.value)


@pytest.mark.parametrize("kind", ["diagonal", "full", "linear"])
def test_the_size_of_the_numbers_does_not_matter(kind: str) -> None:
    """Newton's method, daqp and HiGHS: a problem times 1e-10 or 1e6 has the answer times that."""
    structure = tmj.load_scene("cross").structure
    rng = np.random.default_rng(5)
    A = rng.normal(size=(2, 4))
    wanted = np.array([0.0, 0.7, 0.2, 1.1])
    mixed = rng.normal(size=(4, 4))
    weight: Any = mixed @ mixed.T + np.eye(4) if kind == "full" else 1.0
    linear = [1.0, 2.0, 3.0, 4.0] if kind == "linear" else None
    names = [Equation("x", "m/s²")] * 2

    def answer(size: float) -> Array:
        allocation = Allocation(weight=weight, linear=linear, sums=(Sum(2.1 * size),))
        return Allocator(allocation, structure, names).solve(A, size * (A @ wanted)).u

    for size in (1e-10, 1e6):
        # Each solver is within 1e-9 of the answer or better, for numbers of the size of one.
        np.testing.assert_allclose(answer(size) / size, answer(1.0), rtol=0, atol=1e-8)


def test_what_an_allocator_cannot_be_given() -> None:
    structure = tmj.load_scene("cross").structure
    rows = [Equation("lift", "N")]
    for arguments, words in (
        ((Allocation(weight=1j * np.eye(4)), structure, rows), "weight"),
        ((Allocation(), "cross", rows), "structure = 'cross'"),
        ((Allocation(), structure, 1), "equations = 1"),
    ):
        with pytest.raises(OptionError, match=words):
            Allocator(*arguments)  # type: ignore[arg-type]
    for make, words in (
        (lambda: Allocation(sums=3), "sums = 3"),  # type: ignore[arg-type]
        (lambda: Sum(np.inf), "sum: minimum = inf"),
        (lambda: Sum(1.0, "left"), "strings = 'left'"),  # type: ignore[arg-type]
        (lambda: Allocation(respect_limits="no"), "respect_limits"),  # type: ignore[arg-type]
    ):
        with pytest.raises(OptionError, match=words):
            make()
    allocator = Allocator(Allocation(), structure, rows)
    A, d = np.ones((1, 4)), np.ones(1)
    for bad_A, bad_d in ((A[:, :3], d), (A, np.ones(2)), (np.ones((3, 4)), np.ones(3)), ("rows", d)):
        with pytest.raises(OptionError, match=r"A .*d "):
            allocator.solve(bad_A, bad_d)  # type: ignore[arg-type]
    for bad_A, bad_d in ((A * np.nan, d), (A, d * np.inf)):
        with pytest.raises(tmj.errors.ControllerError, match="lift"):
            allocator.solve(bad_A, bad_d)


def test_the_fault_that_weighs_most_is_named_first() -> None:
    """At its start the cross needs no string; with u_max = 0.2 four of them give 0.8 at most, 1.2 is requested."""
    scene = tmj.load_scene("cross")
    law = tmj.controllers.from_scene(scene, maximum_force_density=0.2)
    with pytest.raises(InfeasibleError, match=r"at best sum 1 \(of all strings\) >= 1.2 falls short by 0.4"):
        law(0.0, scene.nodes0, scene.velocities0)
