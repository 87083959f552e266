"""Feedback linearization as an array function, and its quadratic program."""

from __future__ import annotations

import numpy as np
import pytest

jax = pytest.importorskip("jax")
pytest.importorskip("diffrax")

from quadratic_problems import random_problem, solve  # noqa: E402

import tensegrity_mj as tmj  # noqa: E402
from tensegrity_mj.controllers import Allocation, FeedbackLinearization, WhenInfeasible, from_scene  # noqa: E402
from tensegrity_mj.dynamics.native.law import Report  # noqa: E402
from tensegrity_mj.engines.jax.laws import array_law  # noqa: E402
from tensegrity_mj.engines.jax.thesis_laws import least_cost  # noqa: E402
from tensegrity_mj.errors import InfeasibleError, OptionError  # noqa: E402

ROWS, STRINGS, SUMS = 29, 30, 4


def padded(p):
    """The same problem with rows and strings of no meaning behind, so that all are of one shape."""
    M = len(p.h)
    A, S = np.zeros((ROWS, STRINGS)), np.zeros((SUMS, STRINGS))
    A[: len(p.d), :M], S[: len(p.s), :M] = p.A, p.S
    d, s = np.pad(p.d, (0, ROWS - len(p.d))), np.pad(p.s, (0, SUMS - len(p.s)), constant_values=-1.0)
    h, hi = (np.pad(x, (0, STRINGS - M), constant_values=fill) for x, fill in ((p.h, 1.0), (p.hi, np.inf)))
    return h, A, d, S, s, np.pad(p.lo, (0, STRINGS - M)), hi


def test_quadratic_programs_and_that_some_have_no_solution():
    """Against the compiled search; both solve for strings between their bounds with conditions of 1e3 and less."""
    rng = np.random.default_rng(0)
    search, counts = jax.jit(least_cost), [0, 0]
    for number in range(400):
        problem = random_problem(rng, feasible=number % 4 != 0)
        status, u = solve(problem)
        found, violation = map(np.asarray, search(*padded(problem)))
        solved = status == 0
        counts[solved] += 1
        assert bool(np.all(np.isfinite(found))) is solved, number
        if solved:
            np.testing.assert_allclose(
                found[: len(u)], u, rtol=0, atol=1e-10 * (1 + np.abs(u).max()), err_msg=str(number)
            )
            assert violation <= 1e-10 * (1 + np.abs(u).max())
    assert min(counts) > 50


@pytest.mark.parametrize(
    ("name", "until", "room"), [("cross", 6.0, 1e-13), ("shape_control", 4.0, 1e-11), ("planar_beam", 2.0, 1e-10)]
)
def test_shipped_scenes(name, until, room):
    """u of both is that of rows met to 1e-12 of their terms, times their condition: 100 for the beam's 117 rows.

    The law of `shape_control` knows of the water, whose forces come from sums over segments.
    """
    scene = tmj.load_scene(name)
    law = from_scene(scene)
    own = array_law(law, scene.structure)
    command = jax.jit(own.command)
    run = tmj.simulate(scene, law, tmj.DAE(), duration=until, output_interval=0.5)
    for t, x, v in zip(run.time, run.nodes, run.velocities, strict=True):
        u, report = command(own.parameters, t, x, v)
        expected = law(t, x, v)
        np.testing.assert_allclose(u, expected, rtol=0, atol=room * np.abs(expected).max())
        assert np.isnan(report[Report.LYAPUNOV])
        assert report[Report.ALLOCATION_RESIDUAL] <= 1e-10


def test_points_in_space_with_bounds_and_sums():
    """A free rod in space and a point mass, held on all sides; a path, thresholds, ceilings, two sums, a load."""
    structure, law = held_rod()
    own = array_law(law, structure)
    command = jax.jit(own.command)
    rng = np.random.default_rng(2)
    solved = at_floor = at_ceiling = 0
    for t in np.linspace(-0.1, 1.2, 14):
        x, v = perturbed(structure, rng)
        u, _ = command(own.parameters, t, x, v)
        try:
            expected = law(t, x, v)
        except InfeasibleError:
            assert np.all(np.isnan(u))
            continue
        solved, at_floor, at_ceiling = solved + 1, at_floor + sum(expected == 6.0), at_ceiling + sum(expected == 28.0)
        # Some 50 operations on numbers of 100, of which the rows have a condition of 10.
        np.testing.assert_allclose(u, expected, rtol=0, atol=1e-12 * np.abs(expected).max())
    assert 6 <= solved < 14
    assert at_floor > 10
    assert at_ceiling > 2


def held_rod():
    corners = {f"c{n}": tuple(2.0 * (np.array([n & 1, n >> 1 & 1, n >> 2 & 1]) - 0.5)) for n in range(8)}
    nodes = corners | {"a": (0.3, 0.1, -0.1), "b": (-0.3, 0.2, 0.2), "m": (0.1, -0.4, 0.1)}
    pairs = [(end, corner) for end in ("a", "b", "m") for corner in corners]
    strings = tuple(tmj.String(f"{a}{b}", (a, b), 500.0, rest_length=0.5) for a, b in pairs)
    structure = tmj.Structure(
        "held", nodes, (tmj.Rod("rod", ("a", "b"), 1.0),), strings, tuple(corners), (tmj.PointMass("m", 0.5),)
    )
    turned = structure.positions.copy()
    turned[8:10] += [[0.05, 0.1, 0.1], [0.05, 0.1, 0.1]]
    target = tmj.Target.path([0.0, 1.0], [structure.positions, turned])
    sums = (tmj.controllers.Sum(300.0), tmj.controllers.Sum(60.0, ("ac0", "ac1", "bc0")))
    allocation = Allocation(np.linspace(1, 2, 24), 6.0, 28.0, sums)
    gravity = (0.0, 0.0, -9.81)
    known = (tmj.model.Load("m", (1.0, 0.5, -2.0)), tmj.model.Resistance(viscous=0.4, wind=(0.5, -0.2, 0.1)))
    return structure, FeedbackLinearization(structure, target, 4.0, 0.8, allocation, gravity=gravity, known=known)


def perturbed(structure, rng):
    """A state in motion: a rigid motion of the rod, and the point mass."""
    way = rng.normal(size=(2, 3))
    x, v = structure.positions.copy(), np.zeros_like(structure.positions)
    x[8:10] += 0.05 * way[0]
    x[10] += 0.05 * way[1]
    v[8:10] = 0.2 * way[1] + 0.3 * np.cross(way[0], x[8:10])
    v[10] = 0.3 * way[0]
    return x, v


def test_derivatives_and_batches():
    """Away from changes of the active set, against differences of order 4, whose error is what halving h changes."""
    structure, law = held_rod()
    own = array_law(law, structure)
    x, v = perturbed(structure, np.random.default_rng(3))
    weights = np.random.default_rng(4).normal(size=24)
    result = jax.jit(lambda p, x, v=v: own.command(p, 0.4, x, v)[0] @ weights)
    slopes, by_x = jax.jit(jax.grad(result, (0, 1)))(own.parameters, x)
    value = 100.0
    rng = np.random.default_rng(5)
    leaves, tree = jax.tree_util.tree_flatten((own.parameters, x))
    found = jax.tree_util.tree_leaves((slopes, by_x))
    assert len(leaves) >= 10
    for number, (leaf, slope) in enumerate(zip(leaves, found, strict=True)):
        way = rng.normal(size=np.shape(leaf))
        h = 1e-4 * float(np.abs(leaf).max() or 1.0)

        def moved(s, number=number, way=way):
            changed = [one + s * way if n == number else one for n, one in enumerate(leaves)]
            return float(result(*jax.tree_util.tree_unflatten(tree, changed)))

        wide, narrow = ((moved(-2 * d) - 8 * moved(-d) + 8 * moved(d) - moved(2 * d)) / (12 * d) for d in (h, h / 2))
        own_slope = float(np.sum(np.asarray(slope) * way))
        room = abs(wide - narrow) + 1e-12 * value / h
        assert room <= 1e-5 * (abs(own_slope) + value)
        assert abs(own_slope - narrow) <= room, (number, own_slope, narrow)
    factors = np.array([1.0, 1.05])
    p = own.parameters | {"damping": own.parameters["damping"] * factors}
    many = np.repeat(x[..., None], 2, axis=2)
    together, reports = jax.jit(own.command)(p, 0.4, many, v[..., None] * factors)
    assert reports.shape == (5, 2)
    for n, factor in enumerate(factors):
        single = own.parameters | {"damping": own.parameters["damping"] * factor}
        room = 1e-11 * (np.abs(together[:, n]) @ np.abs(weights))
        assert abs(together[:, n] @ weights - result(single, x, v * factor)) < room


def test_where_there_is_no_solution_it_is_not_a_number():
    """A rod along z, whose θ says nothing; and a demand beyond the ceilings."""
    structure, law = held_rod()
    own = array_law(law, structure)
    command = jax.jit(own.command)
    x = structure.positions.copy()
    steep = x.copy()
    steep[8:10, :2] = 0.1
    for t, nodes, velocities in ((0.4, steep, 0 * x), (0.4, x, 50.0 + 0 * x)):
        with pytest.raises(InfeasibleError):
            law(t, nodes, velocities)
        assert np.all(np.isnan(command(own.parameters, t, nodes, velocities)[0]))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"linear": 1.0}, "linear: the differentiable engine"),
        ({"weight": np.eye(24) + 0.1}, "takes the diagonal of H"),
        ({"on_infeasible": WhenInfeasible.HOLD}, "stops where it has no solution"),
        ({"on_infeasible": WhenInfeasible.RELAX}, "stops where it has no solution"),
    ],
)
def test_options_without_an_array_function_are_refused(options, message):
    structure, law = held_rod()
    with pytest.raises(OptionError, match=message):
        array_law(FeedbackLinearization(structure, law.target, allocation=Allocation(**options)), structure)
