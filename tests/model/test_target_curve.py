"""Targets along a curve of shapes: quintics in time (4.2)-(4.5), polynomials through shapes, exact derivatives."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
import numpy as np
import pytest
from numpy.typing import NDArray

import tensegrity_mj as tmj
from tensegrity_mj.dynamics.native.vectors import put
from tensegrity_mj.dynamics.records import StructureRecords
from tensegrity_mj.dynamics.target import Aim, pack_target, point_target, rod_target, target_nodes
from tensegrity_mj.errors import FormatError, SceneError
from tensegrity_mj.model.target import Curve, chebyshev_points, quintic
from tensegrity_mj.model.text.reading import scene_from_toml
from tensegrity_mj.model.text.writing import scene_to_toml

Array = NDArray[np.float64]
INTERVAL = (-0.3, 1.4)
polyval = np.polynomial.polynomial.polyval


def rows_of_45(t: float) -> list[list[float]]:
    """y, ẏ, ÿ of (4.2)-(4.4) as rows over c₁ ... c₆."""
    return [
        [t**5, t**4, t**3, t**2, t, 1],
        [5 * t**4, 4 * t**3, 3 * t**2, 2 * t, 1, 0],
        [20 * t**3, 12 * t**2, 6 * t, 2, 0, 0],
    ]


def test_the_closed_form_solves_the_linear_system() -> None:
    rng = np.random.default_rng(1)
    for _ in range(100):
        start, end = rng.normal(size=3), rng.normal(size=3)
        first = rng.uniform(0, 2)
        last = first + rng.uniform(0.5, 2)
        c = np.linalg.solve(np.array(rows_of_45(first) + rows_of_45(last)), np.concatenate([start, end]))
        t = np.linspace(first, last, 9)
        # The system in absolute time has condition numbers up to some 1e8 at these times: 1e-16 of it, and of
        # values up to 1e2. The closed form has no such loss.
        np.testing.assert_allclose(polyval(t - first, quintic(last - first, start, end)), np.polyval(c, t), atol=1e-6)


def test_the_closed_form_meets_its_ends() -> None:
    rng = np.random.default_rng(2)
    for span in (1e-3, 0.7, 60.0, 1e4):
        start, end = rng.normal(size=3), rng.normal(size=3)
        c = quintic(span, start, end)
        for order in range(3):
            derivative = np.polynomial.polynomial.polyder(c, order)
            # What cancels at the end: |y|, |v| span, |a| span² over span^order, times up to 15 · 20 in derivatives.
            size = (1 + span + span**2) / span**order
            assert polyval(0.0, derivative) == pytest.approx(start[order], abs=1e-15 * size)
            assert polyval(span, derivative) == pytest.approx(end[order], abs=2e-13 * size)


def test_rest_to_rest_is_the_timing_of_paths() -> None:
    x = np.linspace(0, 1, 11)
    expected = 3 + 4 * (10 * x**3 - 15 * x**4 + 6 * x**5)
    np.testing.assert_allclose(polyval(2.5 * x, quintic(2.5, (3, 0, 0), (7, 0, 0))), expected, rtol=0, atol=2e-14)


# Rods on a curve ------------------------------------------------------------------------------------------


def structure() -> tmj.Structure:
    """A rod pinned at its foot, a free one with an odd σ, and a point mass; one fixed node."""
    return tmj.Structure(
        "swinging",
        {"a": (0, 0, 0), "b": (1, 0, 0), "c": (0, 2, 0), "d": (0, 2, 1), "p": (3, 0, 0), "f": (4, 4, 4)},
        (
            tmj.Rod("pinned", ("a", "b"), 1.0, support=tmj.Support.pinned()),
            tmj.Rod("free", ("c", "d"), 1.0, support=tmj.Support.free(0.3)),
        ),
        (tmj.String("s", ("b", "f"), 5.0), tmj.String("t", ("p", "f"), 5.0)),
        ("f",),
        (tmj.PointMass("p", 1.0),),
    )


def shape(p: Any) -> Array:
    """Nodes (..., 6, 3) in closed form: both rods turn, the free one and the point mass travel too."""
    p = np.asarray(p, float)
    zero = np.zeros_like(p)
    turned = np.stack([np.cos(p), 0.6 * np.sin(p), 0.8 * np.sin(p)], -1)
    middle = np.stack([p**2, 2 + np.sin(2 * p), -p], -1)
    b = np.stack([np.sin(3 * p), zero, np.cos(3 * p)], -1)
    return np.stack(
        [
            np.stack([zero, zero, zero], -1),
            turned,
            middle - 0.3 * b,
            middle + 0.7 * b,
            np.stack([3 + p, np.exp(p) - 1, zero], -1),
            np.stack([zero + 4, zero + 4, zero + 4], -1),
        ],
        -2,
    )


def target(count: int = 24, **changes: Any) -> tmj.Target:
    parameters = chebyshev_points(*INTERVAL, count)
    values: dict[str, Any] = {
        "times": [1.0, 2.5, 3.0],
        "values": [0.1, 1.0, 0.6],
        "parameters": parameters,
        "shapes": shape(parameters),
        "rates": [0.2, -0.1, 0.0],
        "accelerations": [0.5, -1.0, 0.3],
    }
    return tmj.Target.curve(**(values | changes))


def parameter(t: float) -> tuple[float, float, float]:
    """p, ṗ, p̈ of `target` by another way: the linear system (4.5), solved in time from the segment's start."""
    given = target().along
    assert given is not None
    times = target().times
    k = int(np.searchsorted(times, t, side="right")) - 1
    span = times[k + 1] - times[k]
    ends = [[given.values[i], given.rates[i], given.accelerations[i]] for i in (k, k + 1)]
    c = np.linalg.solve(np.array(rows_of_45(0.0) + rows_of_45(span)), np.concatenate(ends))
    return tuple(float(np.polyval(np.polyder(c, order), t - times[k])) for order in range(3))  # type: ignore[return-value]


@numba.njit
def rod_target_at(rod: Any, t: float, aim: int, r: Any, b: Any) -> None:
    places, directions = rod_target(rod, t, Aim(aim))
    for order in range(3):
        put(r, order, places[order])
        put(b, order, directions[order])


@numba.njit
def point_target_at(point: Any, t: float, aim: int, r: Any) -> None:
    places = point_target(point, t, Aim(aim))
    for order in range(3):
        put(r, order, places[order])


def test_rods_and_points_have_exact_derivatives() -> None:
    made = structure()
    records = StructureRecords.of(made)
    packed = pack_target(target())
    r, b = np.empty((3, 3)), np.empty((3, 3))

    def derivatives(of: Callable[[float], Array], at: tuple[float, float, float]) -> Array:
        # Of the closed form, by complex-free central differences in the parameter, then the chain rule.
        p, rate, acc = at
        h = 1e-4
        first = (of(p + h) - of(p - h)) / (2 * h)
        second = (of(p + h) - 2 * of(p) + of(p - h)) / h**2
        return np.array([of(p), first * rate, second * rate**2 + first * acc])

    for t in (1.0 + 1e-9, 1.3, 2.2, 2.5, 2.9):
        at = parameter(t)
        for number, (i, j, sigma) in enumerate(((0, 1, 0.0), (2, 3, 0.3))):
            rod_target_at(records.rods[number], t, packed.address, r, b)
            for found, of in (
                (r, lambda p, i=i, j=j, s=sigma: (1 - s) * shape(p)[i] + s * shape(p)[j]),
                (b, lambda p, i=i, j=j: shape(p)[j] - shape(p)[i]),
            ):
                # Differences: h² |f''''|/12 ~ 1e-7 (81 for sin 3p), and 1e-16/h² ~ 1e-8.
                np.testing.assert_allclose(found, derivatives(of, at), rtol=0, atol=1e-6)
            # b is of unit length to round-off, and so are its derivatives consistent: bᵀḃ = 0, bᵀb̈ = -‖ḃ‖².
            assert b[0] @ b[0] == pytest.approx(1, abs=4e-16)
            assert b[0] @ b[1] == pytest.approx(0, abs=1e-14)
            assert b[0] @ b[2] == pytest.approx(-(b[1] @ b[1]), abs=1e-12)
        point_target_at(records.points[0], t, packed.address, r)
        np.testing.assert_allclose(r, derivatives(lambda p: shape(p)[4], at), rtol=0, atol=1e-6)


def test_the_polynomial_passes_through_everything_between() -> None:
    along = target().along
    assert along is not None
    p = np.linspace(*INTERVAL, 300)
    # sin 3p over ±0.85: the Chebyshev coefficients J_n(2.55) fall below 1e-16 beyond n = 22.
    np.testing.assert_allclose(along.nodes(p), shape(p), rtol=0, atol=1e-13)
    np.testing.assert_array_equal(along.shapes, shape(np.array(along.parameters)))


def test_it_stands_still_outside_and_starts_where_it_is_placed() -> None:
    made, aim = structure(), target()
    times = np.array([-1.0, 0.0, 1.0, 3.0, 7.0])
    nodes = target_nodes(made, aim, times)
    for row, p in zip(nodes, (0.1, 0.1, 0.1, 0.6, 0.6), strict=True):
        np.testing.assert_allclose(row, shape(p), rtol=0, atol=1e-14)
    np.testing.assert_allclose(aim.nodes, shape(np.array([0.1, 1.0, 0.6])), rtol=0, atol=1e-14)
    records, packed = StructureRecords.of(made), pack_target(aim)
    r, b = np.empty((3, 3)), np.empty((3, 3))
    rod_target_at(records.rods[1], 3.0, packed.address, r, b)
    assert not r[1:].any()
    assert not b[1:].any()
    # It starts with the rates that it is given, not a moment later.
    here, later = np.empty((2, 3, 3)), np.empty((2, 3, 3))
    rod_target_at(records.rods[1], 1.0, packed.address, *here)
    rod_target_at(records.rods[1], 1.0 + 1e-9, packed.address, *later)
    assert np.abs(here[:, 1:]).max() > 0.01
    np.testing.assert_allclose(here, later, rtol=0, atol=1e-6)  # third derivatives of some 100/s³ over 1e-9 s


def test_compiled_code_reads_the_packed_arrays() -> None:
    @numba.njit
    def copies(address: int) -> Any:
        """Views of foreign memory never leave compiled code: nothing would own them."""
        aim = Aim(address)
        return aim.times.copy(), aim.nodes.copy(), aim.quintics.copy(), aim.shapes.copy()

    packed = pack_target(target())
    for own, read in zip(packed.arrays.values(), copies(packed.address), strict=True):
        np.testing.assert_array_equal(own, read)


def test_it_is_saved_without_loss() -> None:
    for aim in (target(), target(rates=None, accelerations=None), target(accelerations=[0.0, 1e-300, 0.0])):
        scene = tmj.Scene(structure(), target=aim)
        text = scene_to_toml(scene)
        assert scene_from_toml(text) == scene
        assert scene_to_toml(scene_from_toml(text)) == text
    assert target() != target(rates=None)
    assert target() != tmj.Target.path(target().times, target().nodes)
    assert ("rates" in text, "accelerations" in text) == (True, True)


def test_the_lyapunov_law_follows_a_curve() -> None:
    scene = tmj.load_scene("pinned_rod")
    begin, end = (nodes[1] for nodes in (scene.nodes0, scene.target.nodes[0]))  # type: ignore[union-attr]
    side = end - (begin @ end) * begin
    side /= np.linalg.norm(side)
    angle = float(np.arccos(begin @ end))
    parameters = chebyshev_points(0.0, angle, 20)
    shapes = np.array([scene.nodes0] * 20)
    shapes[:, 1] = [np.cos(p) * begin + np.sin(p) * side for p in parameters]
    curve = tmj.Target.curve([0.0, 20.0], [0.0, angle], parameters, shapes)
    path = tmj.Target.path([0.0, 20.0], [shapes[0], shapes[-1]])
    # The same motion given in two ways. To leave it, start beside it.
    velocities = np.zeros((5, 3))
    velocities[1] = 0.02 * np.cross(begin, side)
    runs = [
        tmj.simulate(
            scene.with_(initial_velocities=velocities, target=aim),
            tmj.controllers.Lyapunov(scene.structure, aim, decay_rate=0.15),
            tmj.DAE(rtol=1e-11, atol=1e-13),
            duration=2.0,
        )
        for aim in (path, curve)
    ]
    # Interpolation to 1e-15, integration to some 1e-11.
    assert tmj.compare(*runs).max_node_error < 1e-9
    decay = runs[1].lyapunov / (runs[1].lyapunov[0] * np.exp(-0.15 * runs[1].time))
    np.testing.assert_allclose(decay, 1, rtol=0, atol=1e-7)


# What is refused ------------------------------------------------------------------------------------------

REFUSED: dict[str, tuple[dict[str, Any], tuple[str, ...]]] = {
    "times that fall": ({"times": [1.0, 0.5, 3.0]}, ("times", "increase")),
    "a time too many": ({"times": [1.0, 2.0, 3.0, 4.0]}, ("4 times", "one set of them a time")),
    "rates of another number": ({"rates": [1.0]}, ("1 rates for 3 values",)),
    "a rate that is not finite": ({"rates": [0.0, np.nan, 0.0]}, ("rates", "finite")),
    "texts": ({"values": ["a", "b", "c"]}, ("values = ['a', 'b', 'c']", "finite numbers")),
    "no values": ({"values": None}, ("values = None", "finite numbers")),
    "no times": ({"times": None}, ("times = None", "finite numbers")),
    "parameters that fall": ({"parameters": [1.0, 0.0], "shapes": shape([1.0, 0.0])}, ("parameters", "increase")),
    "one shape": ({"parameters": [1.0], "shapes": shape([1.0])}, ("two or more",)),
    "shapes of another number": ({"shapes": shape([0.0, 1.0])}, ("shapes of shape (2, 6, 3)", "24 parameters")),
    "shapes of other nodes": ({"shapes": np.zeros((24, 5, 3))}, ("(3, 5, 3)", "(W, 6, 3)")),
    "a shape that is not finite": (
        {"shapes": np.where(np.arange(24)[:, None, None] == 3, np.nan, shape(chebyshev_points(*INTERVAL, 24)))},
        ("target shape 3", "finite"),
    ),
    "a shape that stretches a rod": (
        {"shapes": shape(chebyshev_points(*INTERVAL, 24)) * (1 + 0.1 * (np.arange(6) == 3))[:, None]},
        ("target shape 0", "rod 'free'"),
    ),
    "values beyond the shapes": ({"values": [0.1, 1.5, 0.6]}, ("known in [-0.3, 1.4]", "1.5")),
    "rates that lead beyond the shapes": ({"rates": [-8.0, 0.0, 0.0]}, ("known in", "smaller rates")),
    "too few shapes": (
        {"parameters": chebyshev_points(*INTERVAL, 5), "shapes": shape(chebyshev_points(*INTERVAL, 5))},
        ("5 shapes", "stretches rods", "rod 'free'", "more shapes"),
    ),
}


def test_arrays_are_taken_for_lists() -> None:
    assert target(rates=np.array([0.2, -0.1, 0.0]), times=np.array([1.0, 2.5, 3.0])) == target()


def test_quintics_and_points_that_are_none() -> None:
    for span, start, words in ((0.0, (0, 0, 0), "span"), (1.0, (0, 0), "start"), (1.0, "abc", "start")):
        with pytest.raises(tmj.errors.OptionError, match=words):
            quintic(span, start, (1, 0, 0))  # type: ignore[arg-type]
    for first, last, count in ((0.0, 1.0, 1), (0.0, 1.0, 2.0), (1.0, 0.0, 3)):
        with pytest.raises(tmj.errors.OptionError, match="chebyshev_points"):
            chebyshev_points(first, last, count)  # type: ignore[arg-type]


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_refused(case: str) -> None:
    changes, parts = REFUSED[case]
    with pytest.raises(SceneError) as caught:
        tmj.Scene(structure(), target=target(**changes))
    for part in ("target", *parts):
        assert part in str(caught.value)


def test_equidistant_shapes_are_refused_where_their_polynomial_swings() -> None:
    p = np.linspace(*INTERVAL, 70)  # Runge: round-off grows by 2^70 / (70 e ln 70)
    with pytest.raises(SceneError, match="chebyshev_points"):
        tmj.Scene(structure(), target=target(parameters=p, shapes=shape(p)))


def test_the_turning_points_between_times_are_found() -> None:
    aim = target()
    assert aim.along is not None
    low, high = aim.along.extremes(aim.times)
    t, dt = np.linspace(1.0, 3.0, 500, endpoint=False, retstep=True)
    p, _, p_second = np.array([parameter(x) for x in t]).T
    # Of samples, an extreme is missed by at most |p̈| dt²/8, about 2e-5; at a turning point |p̈| is not the largest.
    missed = np.abs(p_second).max() * dt**2 / 8
    assert missed < 3.2e-4
    assert low == pytest.approx(p.min(), abs=missed)
    assert high == pytest.approx(p.max(), abs=missed)
    assert high > 1.0  # neither end


@pytest.mark.parametrize(
    ("change", "parts"),
    [
        (("values = ", "valves = "), ("unknown key 'valves'", "did you mean 'values'")),
        (("times = [1.0, 2.5, 3.0]\n", ""), ("'times' is missing",)),
        (("values = [0.1, 1.0, 0.6]", "values = [0.1, 1.0]"), ("values", "one a time")),
        (("parameter = ", "parametre = "), ("shapes[0]", "unknown key 'parametre'")),
        (("[scene.target]", "[scene.target]\nnodes = {}"), ("one of 'nodes'", "'waypoints'", "'shapes'")),
    ],
)
def test_what_is_wrong_in_a_file_is_said(change: tuple[str, str], parts: tuple[str, ...]) -> None:
    text = scene_to_toml(tmj.Scene(structure(), target=target()))
    assert change[0] in text
    with pytest.raises(FormatError) as caught:
        scene_from_toml(text.replace(change[0], change[1], 1), "swing.toml")
    for part in ("swing.toml", *parts):
        assert part in str(caught.value)


def test_only_curves_are_given_as_curves() -> None:
    with pytest.raises(SceneError, match=r"Target\.curve"):
        tmj.Target((0.0,), shape([0.0]), "along")  # type: ignore[arg-type]
    with pytest.raises(SceneError, match="too close"):
        Curve((0.0,), (0.0, 5e-324, 1.0), shape([0.0, 0.0, 1.0]), ()).coefficients  # noqa: B018
