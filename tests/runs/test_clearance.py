"""Clearance: closest points of segments, least distances of moving elements, passages; three ways each."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline
from scipy.optimize import lsq_linear

import tensegrity_mj as tmj
from tensegrity_mj import cli
from tensegrity_mj.model.elements.contact import segment_distances
from tensegrity_mj.runs import Pairs
from tensegrity_mj.runs.recorded import VARIABLES
from tensegrity_mj.runs.segments import closest_points
from tensegrity_mj.statics import find_equilibrium

Array = NDArray[np.float64]
EPS = np.finfo(float).eps


def segments(rng: np.random.Generator, count: int) -> Array:
    """(count, 4, 3): ends of pairs of segments of all kinds: skew, planar, parallel, collinear, touching, points."""
    ends = rng.normal(size=(count, 4, 3))
    kind = np.arange(count) % 8
    ends[kind == 1, :, 2] = 0.0
    for parallel, spread in ((2, 1.0), (3, 0.0)):
        rows = kind == parallel
        a, u = ends[rows, 0], ends[rows, 1] - ends[rows, 0]
        ends[rows, 2] = a + rng.normal(size=(rows.sum(), 1)) * u + spread * ends[rows, 2]
        ends[rows, 3] = ends[rows, 2] + rng.normal(size=(rows.sum(), 1)) * u
    rows = kind == 4  # nearly parallel
    ends[rows, 3] = ends[rows, 2] + ends[rows, 1] - ends[rows, 0] + 1e-6 * rng.normal(size=(rows.sum(), 3))
    rows = kind == 5  # they touch or cross
    on = rng.uniform(size=(rows.sum(), 1)) * (ends[rows, 1] - ends[rows, 0]) + ends[rows, 0]
    v = ends[rows, 3] - ends[rows, 2]
    ends[rows, 2] = on - rng.choice([0.0, 0.3, 1.0], size=(rows.sum(), 1)) * v
    ends[rows, 3] = ends[rows, 2] + v
    ends[kind == 6, 1] = ends[kind == 6, 0]
    rows = (kind == 7) & (np.arange(count) % 16 < 8)
    ends[rows, 1], ends[rows, 3] = ends[rows, 0], ends[rows, 2]
    return ends


def test_closest_points_in_closed_form() -> None:
    """Skew, parallel, collinear, touching, crossing, end to side, points. Arithmetic of a few operations: 1e-15."""
    cases: list[tuple[Any, ...]] = [
        ((-1, 0, 0), (1, 0, 0), (0, -1, 0.3), (0, 3, 0.3), 0.3, 0.5, 0.25),
        ((0, 0, 0), (1, 0, 0), (1, 1, 0), (1, 2, 0), 1.0, 1.0, 0.0),
        ((0, 0, 0), (1, 0, 0), (2, 1, 0), (3, 1, 0), np.sqrt(2.0), 1.0, 0.0),
        ((0, 0, 0), (1, 0, 0), (3, 0, 0), (2, 0, 0), 1.0, 1.0, 1.0),
        ((0, 0, 0), (2, 0, 0), (1, -1, 0), (1, 1, 0), 0.0, 0.5, 0.5),
        ((0, 0, 0), (2, 0, 0), (1, 0, 0), (1, 5, 0), 0.0, 0.5, 0.0),
        ((1, 1, 1), (1, 1, 1), (0, 0, 0), (0, 0, 2), np.sqrt(2.0), None, 0.5),
        ((1, 1, 1), (1, 1, 1), (1, 1, 3), (1, 1, 3), 2.0, None, None),
    ]
    for a, b, c, d, apart, s, t in cases:
        found = closest_points(a, b, c, d)
        for value, expected in zip(found, (apart, s, t), strict=True):
            assert expected is None or abs(value - expected) < 1e-15
    over = closest_points((0, 0, 0), (1, 0, 0), (0.25, 0, 2), (0.75, 0, 2))  # parallel: one of many pairs of points
    assert over[0] == 2.0
    assert abs(over[1] - (0.25 + 0.5 * over[2])) < 1e-15


def test_closest_points_against_bounded_least_squares() -> None:
    """Another minimiser of the same convex problem, which stops within 1e-15 of D's scale: of d within some 1e-8.

    From above nothing stops short: the points that are returned are that far apart.
    """
    ends = segments(np.random.default_rng(0), 1600)
    distance, s, t = closest_points(*ends.transpose(1, 0, 2))
    assert np.all((s >= 0) & (s <= 1) & (t >= 0) & (t <= 1))
    a, b, c, d = ends.transpose(1, 0, 2)
    apart = np.linalg.norm(a + s[:, None] * (b - a) - c - t[:, None] * (d - c), axis=1)
    np.testing.assert_allclose(apart, distance, rtol=0, atol=1e-14)
    for (p, q, r, w), found in zip(ends, distance, strict=True):
        other = lsq_linear(np.stack([q - p, r - w], axis=1), r - p, (0, 1), method="bvls", tol=1e-15)
        assert abs(np.sqrt(2 * other.cost) - found) < 1e-7
        assert found <= np.sqrt(2 * other.cost) + 1e-13


def test_closest_points_do_not_depend_on_place_order_or_direction() -> None:
    """Round-off of coordinates up to 10 moves segments by 1e-15, and the distance by no more than that."""
    rng = np.random.default_rng(1)
    ends = segments(rng, 4000)
    a, b, c, d = ends.transpose(1, 0, 2)
    distance, s, t = closest_points(a, b, c, d)
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    moved = ends @ q.T + rng.normal(size=3)
    for other in (
        closest_points(c, d, a, b),
        closest_points(b, a, c, d),
        closest_points(a, b, d, c),
        closest_points(*moved.transpose(1, 0, 2)),
    ):
        np.testing.assert_allclose(other[0], distance, rtol=0, atol=2e-14)
    skew = np.arange(4000) % 8 == 0
    np.testing.assert_allclose(closest_points(b, a, c, d)[1][skew], 1 - s[skew], rtol=0, atol=1e-10)
    np.testing.assert_allclose(closest_points(c, d, a, b)[1][skew], t[skew], rtol=0, atol=1e-10)
    contact = segment_distances(*ends[skew].transpose(1, 0, 2))
    np.testing.assert_allclose(contact, distance[skew], rtol=0, atol=1e-13)


def test_nearly_parallel_segments_that_cross_are_found_to_cross() -> None:
    """Two lines at an angle φ through one point: a distance of zero, to round-off over φ."""
    for angle in (1e-2, 1e-4, 1e-6, 1e-7):
        u = np.array([np.cos(angle), np.sin(angle), 0.0])
        distance = closest_points((-1, 0, 0), (1, 0, 0), -0.7 * u, 1.3 * u)[0]
        assert distance < 10 * EPS / angle


def two_rods(radii: tuple[float, float] = (0.01, 0.02), string: bool = False) -> tmj.Structure:
    """A rod along x; and one, or a string between two masses, along y, which starts 1 m above it."""
    nodes = {"a": (-1.0, 0.0, 0.0), "b": (1.0, 0.0, 0.0), "c": (0.0, -1.0, 1.0), "d": (0.0, 1.0, 1.0)}
    first = tmj.Rod("lower", ("a", "b"), 1.0, radii[0])
    if string:
        masses = tuple(tmj.PointMass(name, 1.0) for name in "cd")
        return tmj.Structure("pair", nodes, (first,), (tmj.String("wire", ("c", "d"), 1.0),), point_masses=masses)
    return tmj.Structure("pair", nodes, (first, tmj.Rod("upper", ("c", "d"), 1.0, radii[1])))


def motion(structure: tmj.Structure, time: Array, path: Any) -> tuple[Array, Array]:
    """Nodes and velocities (T, N, 3) where c and d move by path(t) (T, 3), from the reference; a and b stand still."""
    shift, rate = path(time)
    nodes = np.repeat(structure.positions[None], len(time), axis=0)
    velocities = np.zeros_like(nodes)
    nodes[:, 2:] += shift[:, None]
    velocities[:, 2:] += rate[:, None]
    return nodes, velocities


def along(z: Any, z_rate: Any, x: float = 0.0) -> Any:
    """A path with a height z(t) and a constant speed along x."""
    return lambda t: (
        np.stack([x * t, 0 * t, z(t)], axis=1),
        np.stack([x + 0 * t, 0 * t, z_rate(t)], axis=1),
    )


def test_the_least_distance_between_samples_has_the_closed_form() -> None:
    """z = 1 - 0.9 (1 - (t - 0.55)²/0.3025) is a parabola: the cubics are it. Least at 0.55 s, between two samples.

    A distance flat to second order is known to round-off, its time to the root of that.
    """
    structure, time = two_rods(), np.linspace(0.0, 1.0, 6)
    z = lambda t: -0.9 * (1 - (t - 0.55) ** 2 / 0.3025)  # noqa: E731
    rate = lambda t: 1.8 * (t - 0.55) / 0.3025  # noqa: E731
    nodes, velocities = motion(structure, time, along(z, rate, x=0.4))
    found = tmj.clearance(structure, nodes, time=time, velocities=velocities, below=0.3, over_time=True)
    closest = found.closest
    assert closest is not None
    assert found.smallest[Pairs.ROD_ROD] == closest
    assert (closest.kind, closest.first, closest.second) == (Pairs.ROD_ROD, "lower", "upper")
    assert abs(closest.distance - (0.1 - 0.03)) < 1e-14
    assert abs(closest.axis_distance - 0.1) < 1e-14
    assert abs(closest.time - 0.55) < 1e-7
    np.testing.assert_allclose(closest.at, (0.5 + 0.2 * 0.55, 0.5), rtol=0, atol=1e-7)
    np.testing.assert_allclose(closest.points, [(0.22, 0, 0), (0.22, 0, 0.1)], rtol=0, atol=1e-7)
    # At most 0.3 m apart (and the radii) while 0.9 (t - 0.55)² / 0.3025 <= 0.23; the level is 1e-6 m higher.
    (event,) = found.events
    half = np.sqrt(0.230001 * 0.3025 / 0.9)
    np.testing.assert_allclose((event.start, event.end), (0.55 - half, 0.55 + half), rtol=0, atol=1e-9)
    assert event.crossings == ()
    assert abs(event.closest.distance - 0.07) < 1e-14
    assert found.over_time is not None
    np.testing.assert_allclose(found.over_time[Pairs.ROD_ROD], 1 + z(time) - 0.03, rtol=0, atol=1e-14)
    assert np.min(found.over_time[Pairs.ROD_ROD]) > 0.07 + 1e-3
    assert found.interpolation_error < 1e-14


@pytest.mark.parametrize("string", [False, True])
def test_what_passes_through_another_between_two_samples_is_found(string: bool) -> None:
    """Down through the rod at 40 m/s: 0.5 m above it at one sample, 1.5 m below it at the next."""
    structure, time = two_rods(string=string), np.linspace(0.0, 0.05 * 4, 5)
    nodes, velocities = motion(structure, time, along(lambda t: 0.5 - 40 * t, lambda t: -40 + 0 * t))
    found = tmj.clearance(structure, nodes, time=time, velocities=velocities)
    (event,) = found.events
    kind, radii = (Pairs.ROD_STRING, 0.01) if string else (Pairs.ROD_ROD, 0.03)
    assert event.closest.kind is kind
    assert event.closest == found.closest
    assert abs(event.closest.distance + radii) < 1e-9
    assert len(event.crossings) == 1
    assert abs(event.crossings[0] - 1.5 / 40) < 1e-12
    np.testing.assert_allclose(
        (event.start, event.end), (1.5 / 40 - (radii + 1e-6) / 40, 1.5 / 40 + (radii + 1e-6) / 40), rtol=0, atol=1e-12
    )
    beside = motion(structure, time, along(lambda t: 0.5 - 40 * t, lambda t: -40 + 0 * t, x=30.0))
    missed = tmj.clearance(structure, beside[0], time=time, velocities=beside[1])
    assert missed.events == ()  # it passes beyond the rod's end, 0.125 m beside it


def test_what_turns_back_touches_and_does_not_pass() -> None:
    """z = 4 (t - 0.5)²: down to the centre line and up again. And twice through it, by 4 (t - 0.5)² - 0.16."""
    structure, time = two_rods((1e-3, 1e-3)), np.linspace(0.0, 1.0, 4)
    for depth, crossings in ((0.0, ()), (0.16, (0.3, 0.7))):
        path = along(lambda t, depth=depth: 4 * (t - 0.5) ** 2 - 1 - depth, lambda t: 8 * (t - 0.5))
        nodes, velocities = motion(structure, time, path)
        found = tmj.clearance(structure, nodes, time=time, velocities=velocities)
        assert abs(found.closest.distance + 2e-3) < 1e-12  # type: ignore[union-attr]
        times = [time for event in found.events for time in event.crossings]
        np.testing.assert_allclose(times, crossings, rtol=0, atol=1e-9)


def random_motion(seed: int, samples: int = 9) -> tuple[tmj.Structure, Array, Array, Array]:
    """Three rods and three strings on separate nodes, every node on cubics of its own through random values."""
    rng = np.random.default_rng(seed)
    structure = tmj.Structure.from_arrays(
        rng.normal(size=(12, 3)),
        [(0, 1), (2, 3), (4, 5)],
        [(6, 7), (8, 9), (10, 11)],
        rod_mass=1.0,
        stiffness=1.0,
        rod_radius=0.01,
        point_masses=dict.fromkeys(range(6, 12), 1.0),
    )
    time = np.cumsum(rng.uniform(0.5, 1.5, samples))
    return structure, time, rng.normal(size=(samples, 12, 3)), rng.normal(size=(samples, 12, 3))


def sampled(time: Array, nodes: Array, velocities: Array, parts: int) -> tuple[Array, Array]:
    """Times and nodes of the cubics, by SciPy's."""
    fine = np.unique(np.concatenate([np.linspace(a, b, parts + 1) for a, b in pairwise(time)]))
    return fine, CubicHermiteSpline(time, nodes, velocities)(fine)


@pytest.mark.parametrize("seed", range(8))
def test_least_distances_against_dense_sampling(seed: int) -> None:
    """Every pair's least distance. Samples at 1/2000 of an interval miss it by up to the speed times half of that.

    Speeds of the cubics' nodes are below 15 m/s, in intervals up to 1.5 s: 2 · 15 · 1.5 / 4000 = 1.2e-2 m from above;
    and no sample may be nearer than what was found by more than the tolerance.
    """
    structure, time, nodes, velocities = random_motion(seed)
    tolerance = 1e-7
    found = tmj.clearance(
        structure, nodes, time=time, velocities=velocities, every_pair=True, tolerance=tolerance, over_time=True
    )
    assert found.pairs is not None
    assert len(found.pairs) == 15
    _, dense = sampled(time, nodes, velocities, 2000)
    ends = {m.name: m.nodes for m in (*structure.rods, *structure.strings)}
    index = structure.node_index
    least: dict[Pairs, list[float]] = {kind: [] for kind in Pairs}
    curves = {kind: np.full(len(time), np.inf) for kind in Pairs}
    for pair in found.pairs:
        rows = [index[name] for e in (pair.first, pair.second) for name in ends[e]]
        apart = closest_points(*dense[:, rows].transpose(1, 0, 2))[0]
        assert apart.min() >= pair.axis_distance - tolerance
        assert apart.min() <= pair.axis_distance + 1.2e-2
        radii = pair.axis_distance - pair.distance
        least[pair.kind].append(pair.distance)
        at = closest_points(*nodes[:, rows].transpose(1, 0, 2))[0] - radii
        curves[pair.kind] = np.minimum(curves[pair.kind], at)
        # Where it was found the cubics are that far apart.
        when = sampled_at(time, nodes, velocities, pair.time)
        a, b, c, d = when[rows]
        s, t = pair.at
        assert abs(np.linalg.norm(a + s * (b - a) - c - t * (d - c)) - pair.axis_distance) < 1e-12
    quick = tmj.clearance(structure, nodes, time=time, velocities=velocities, tolerance=tolerance)
    assert found.over_time is not None
    for kind in Pairs:
        assert abs(quick.smallest[kind].distance - min(least[kind])) <= tolerance  # type: ignore[union-attr]
        np.testing.assert_allclose(found.over_time[kind], curves[kind], rtol=0, atol=1e-12)


def sampled_at(time: Array, nodes: Array, velocities: Array, when: float) -> Array:
    return np.asarray(CubicHermiteSpline(time, nodes, velocities)(when))


@pytest.mark.parametrize("seed", range(4))
def test_events_and_crossings_against_dense_sampling(seed: int) -> None:
    """Below 0.1 m: a dense sample is below it where it is in an event, but for those at its very ends.

    Crossings: changes of the sign of the volume of the four ends, where the segments are next to each other.
    """
    structure, time, nodes, velocities = random_motion(seed, samples=30)
    below = 0.1
    found = tmj.clearance(structure, nodes, time=time, velocities=velocities, below=below)
    fine, dense = sampled(time, nodes, velocities, 1000)
    members = [*structure.rods, *structure.strings]
    passed = 0
    for i, first in enumerate(members):
        for second in members[i + 1 :]:
            rows = [structure.node_index[name] for name in (*first.nodes, *second.nodes)]
            a, b, c, d = dense[:, rows].transpose(1, 0, 2)
            radii = sum(m.radius for m in (first, second) if isinstance(m, tmj.Rod))
            near = closest_points(a, b, c, d)[0]
            mine = [e for e in found.events if (e.closest.first, e.closest.second) == (first.name, second.name)]
            reported = np.zeros(len(fine), bool)
            for event in mine:
                reported |= (fine >= event.start) & (fine <= event.end)
            assert np.all(reported[near - radii < below - 1e-9])
            # Reported although it is above: in rises that are over within a sixteenth of the time between two samples.
            high = np.concatenate([[False], reported & (near - radii > below + 1e-5), [False]])
            rises = np.flatnonzero(np.diff(high.astype(int))).reshape(-1, 2)
            assert np.all(rises[:, 1] - rises[:, 0] < 63)
            assert np.mean(reported & (near - radii > below + 1e-5)) < 2e-3
            volume = np.einsum("ti,ti->t", a - c, np.cross(b - a, d - c))
            change = np.flatnonzero((volume[1:] * volume[:-1] < 0) & (np.minimum(near[1:], near[:-1]) < 2e-2))
            change = np.array([k for k in change if _meets(dense[k : k + 2, rows])], int)
            times = np.array([t for event in mine for t in event.crossings])
            assert len(times) == len(change)
            assert np.all((times >= fine[change]) & (times <= fine[change + 1]))
            passed += len(times)
    assert passed > 0


def _meets(ends: Array) -> bool:
    """Whether two segments meet where their lines do, between two shapes (2, 4, 3) a small step apart."""
    volume = np.einsum("ti,ti->t", ends[:, 0] - ends[:, 2], np.cross(ends[:, 1] - ends[:, 0], ends[:, 3] - ends[:, 2]))
    part = volume[0] / (volume[0] - volume[1])
    between = ends[0] + part * (ends[1] - ends[0])
    return bool(closest_points(*between)[0] < 1e-4)


def test_rigid_motion_changes_nothing() -> None:
    """Turned in space, and seen from a place that moves on at a constant speed: cubics are cubics there, too.

    Times of least distances that are flat to second order are known to 1e-8, and points at 15 m/s to some 1e-7 m.
    """
    structure, time, nodes, velocities = random_motion(11)
    rng = np.random.default_rng(2)
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    drift = rng.normal(size=3)
    other = nodes @ q.T + drift * time[:, None, None]
    rates = velocities @ q.T + drift
    first = tmj.clearance(structure, nodes, time=time, velocities=velocities, every_pair=True, below=0.05)
    second = tmj.clearance(structure, other, time=time, velocities=rates, every_pair=True, below=0.05)
    assert first.pairs is not None
    assert second.pairs is not None
    others = {(a.first, a.second): a for a in second.pairs}
    assert len(others) == len(first.pairs) == 15
    for a in first.pairs:
        b = others[a.first, a.second]
        assert abs(a.distance - b.distance) < 1e-12
        np.testing.assert_allclose(b.points, np.array(a.points) @ q.T + drift * a.time, rtol=0, atol=1e-6)
    spans = [sorted((e.start, e.end, *e.crossings) for e in found.events) for found in (first, second)]
    assert len(spans[0]) == len(spans[1]) > 0
    for one, other_one in zip(*spans, strict=True):
        np.testing.assert_allclose(one, other_one, rtol=0, atol=1e-9)


def test_a_broken_string_is_no_obstacle_any_more() -> None:
    """It would pass the rod at 37.5 ms; it breaks at 20 ms, 0.3 m above the rod's line less its radius."""
    structure, time = two_rods(string=True), np.linspace(0.0, 0.2, 5)
    nodes, velocities = motion(structure, time, along(lambda t: 0.5 - 40 * t, lambda t: -40 + 0 * t))
    scene = tmj.Scene(structure, breaks=(tmj.model.Break("wire", 0.02),))
    run = tmj.simulate(scene, None, tmj.DAE(), duration=0.1)
    zeros: dict[str, Any] = {name: np.zeros((5, *getattr(run, name).shape[1:])) for name in VARIABLES}
    found = tmj.clearance(replace(run, **(zeros | {"time": time, "nodes": nodes, "velocities": velocities})))
    assert found.events == ()
    assert abs(found.closest.distance - (1.5 - 40 * 0.02 - 0.01)) < 1e-12  # type: ignore[union-attr]


def test_the_estimate_of_the_cubics_error() -> None:
    """Of z = sin(3 t) sampled each 0.1 s: 2 h⁴ / 384 · 81; the estimate looks at samples, and at every second one.

    The mean of the fourth derivative over two intervals is below its largest by at most (3 h)² / 2 = 4.5 %.
    """
    structure, time = two_rods(), np.linspace(0.0, 2.0, 21)
    nodes, velocities = motion(structure, time, along(lambda t: np.sin(3 * t), lambda t: 3 * np.cos(3 * t)))
    found = tmj.clearance(structure, nodes, time=time, velocities=velocities)
    assert abs(found.interpolation_error / (2 * 0.1**4 / 384 * 81) - 1) < 0.045


def test_the_first_touch_is_where_the_contact_of_mujoco_begins() -> None:
    """Two rods approach at 1 m/s, their surfaces 0.3704 m apart. Without contact between them they pass through.

    Contact begins at the first sample after the touch: samples are 1 ms apart. Until then both runs are the same.
    """
    structure = two_rods()
    structure = tmj.Structure(
        "pair", {**structure.nodes, "c": (0.1, -1.0, 0.4004), "d": (0.1, 1.0, 0.4004)}, structure.rods
    )
    speed = np.zeros((4, 3))
    speed[2:, 2] = -1.0
    scene = tmj.Scene(structure, initial_velocities=speed, duration=0.6)
    engine = tmj.MuJoCo(5e-4)
    through = tmj.simulate(scene, None, engine, output_interval=0.1)
    (event,) = tmj.clearance(through).events
    assert abs(event.start - (0.3704 - 1e-6)) < 1e-9
    assert event.crossings == pytest.approx([0.4004], abs=1e-9)

    # Soft enough for samples of 1 ms, between which positions are interpolated.
    soft = tmj.model.Contact(rods=True, friction=0.0, stiffness=4e4, impedance=(0.01, 0.95, 2e-3, 0.5, 2.0))
    touching = scene.with_(contact=soft)
    run = tmj.simulate(touching, None, engine, output_interval=1e-3)
    counts = np.array(run.reports["contact"]["touching"])
    first = int(np.flatnonzero(counts)[0])
    assert run.time[first - 1] < 0.3704 < run.time[first]
    event, *_ = tmj.clearance(run).events
    assert abs(event.start - (0.3704 - 1e-6)) < 1e-6
    assert event.crossings == ()
    # As deep as MuJoCo has it at its samples; a little deeper between them.
    deepest = run.reports["contact"]["deepest"]
    assert deepest <= -event.closest.distance <= deepest + 1e-5
    assert np.all((counts > 0) == (run.time > event.start) & (run.time < event.end - 1e-9))


def test_runs_scenes_structures_and_states_are_taken() -> None:
    scene = tmj.load_scene("prism")
    still = tmj.clearance(scene)
    assert (still.samples, still.events, still.planar) == (1, (), False)
    closest = still.closest
    assert closest is not None
    same = tmj.clearance(scene.structure, scene.nodes0, pairs=[Pairs.ROD_ROD])
    assert same.closest == closest
    assert set(same.smallest) == {Pairs.ROD_ROD}
    thick = tmj.clearance(scene, string_radius=0.005)
    assert thick.smallest[Pairs.STRING_STRING].distance == pytest.approx(  # type: ignore[union-attr]
        still.smallest[Pairs.STRING_STRING].distance - 0.01,
        abs=1e-15,  # type: ignore[union-attr]
    )
    state = find_equilibrium(scene)
    assert tmj.clearance(state).closest == tmj.clearance(scene.structure, state.nodes).closest
    rod = tmj.load_scene("pinned_rod")
    assert tmj.clearance(rod).smallest[Pairs.ROD_ROD] is None
    assert tmj.clearance(tmj.load_scene("cross")).planar


def test_elements_that_share_a_node_are_not_looked_at() -> None:
    structure = tmj.load_scene("prism").structure
    found = tmj.clearance(structure, every_pair=True)
    assert found.pairs is not None
    ends = {m.name: set(m.nodes) for m in (*structure.rods, *structure.strings)}
    names = list(ends)
    free = {frozenset((a, b)) for i, a in enumerate(names) for b in names[i + 1 :] if not ends[a] & ends[b]}
    assert {frozenset((p.first, p.second)) for p in found.pairs} == free
    assert [p.distance for p in found.pairs] == sorted(p.distance for p in found.pairs)


def test_mistakes_are_reported() -> None:
    structure = two_rods()
    nodes = np.repeat(structure.positions[None], 2, axis=0)
    for arguments, text in (
        (("prism",), "must be a Trajectory"),
        ((structure, np.zeros((3, 3))), "nodes"),
        ((structure, np.full((4, 3), np.nan)), "nodes"),
    ):
        with pytest.raises(tmj.errors.OptionError, match=text):
            tmj.clearance(*arguments)  # type: ignore[arg-type]
    for options, text in (
        ({"nodes": nodes, "time": [0, 1]}, "velocities are missing"),
        ({"nodes": nodes, "time": [1, 1], "velocities": nodes}, "increasing"),
        ({"velocities": nodes}, "leave it out"),
        ({"pairs": ()}, "empty"),
        ({"pairs": ("rod-rods",)}, "ROD_ROD"),
        ({"tolerance": 0.0}, "tolerance"),
        ({"string_radius": -1.0}, "string_radius"),
        ({"below": np.nan}, "below"),
    ):
        with pytest.raises(tmj.errors.OptionError, match=text):
            tmj.clearance(structure, **options)
    with pytest.raises(tmj.errors.OptionError, match="broadcast"):
        closest_points(np.zeros((2, 3)), np.zeros((3, 3)), np.zeros(3), np.zeros(3))


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = tmj.load_scene("prism")
    run = tmj.simulate(scene, tmj.controllers.from_scene(scene), tmj.DAE(), duration=1.0)
    file, picture = run.save(tmp_path / "run.nc"), tmp_path / "near.png"
    assert cli.main(["clearance", str(file), "--below", "0.09", "--out", str(picture), "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    direct = tmj.clearance(run, below=0.09)
    assert data["smallest"]["rod-rod"]["distance"] == direct.smallest[Pairs.ROD_ROD].distance  # type: ignore[union-attr]
    assert len(data["events"]) == len(direct.events) > 0
    assert picture.read_bytes()[:4] == b"\x89PNG"
    assert cli.main(["clearance", "prism", "--pairs", "rod-rod,rod-string"]) == 0
    text = capsys.readouterr().out
    assert "rod1" in text
    assert "string-string" not in text
    for wrong in (["--pairs", "rod"], ["--out", "x.txt"], ["--below", "x"], ["--string-radius", "-1"]):
        assert cli.main(["clearance", "prism", *wrong]) == 2
    assert cli.main(["clearance", "prism", "--out", str(picture)]) == 2  # one shape has no time to plot


@pytest.mark.parametrize("one", [Pairs.ROD_ROD, Pairs.ROD_ROD.value])
def test_one_kind_of_pairs_is_enough(one: Any) -> None:
    scene = tmj.load_scene("cross")
    assert tmj.clearance(scene, pairs=one).smallest == tmj.clearance(scene, pairs=[Pairs.ROD_ROD]).smallest
