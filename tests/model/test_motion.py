"""Motions of supports: what they are at each time, which are refused, and how a scene starts with them."""

from __future__ import annotations

import math
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

import tensegrity_mj as tmj
from evidence.random_structures import random_rotation
from tensegrity_mj.errors import SceneError
from tensegrity_mj.model.members import Rod, String, Support
from tensegrity_mj.model.motion import Harmonic, Motion
from tensegrity_mj.model.moved_supports import (
    _least_energy,
    check_motions_until,
    held_directions,
    velocities_with_supports,
)
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.model.text.reading import scene_from_toml
from tensegrity_mj.model.text.writing import scene_to_toml

Array = NDArray[np.float64]
NAN = math.nan
Y = (0.0, 1.0, 0.0)


# What a motion is at a time ------------------------------------------------------------------------------


def test_in_line_is_a_sine() -> None:
    motion = Motion.in_line("rod", 0.05, 0.5, (0, 3, 4))
    omega = math.pi
    for t in (0.0, 0.3, 1.7):
        along = [math.sin(omega * t), omega * math.cos(omega * t), -(omega**2) * math.sin(omega * t)]
        # sin and cos of arguments up to 6 are good to 1e-15, times ω² = 10 and the amplitude.
        np.testing.assert_allclose(motion.at(t), 0.05 * np.outer(along, [0, 0.6, 0.8]), rtol=0, atol=2e-15)


@pytest.mark.parametrize("normal", [(0.0, 0.0, 2.0), (1.0, -2.0, 0.5)])
def test_a_circle_is_one(normal: tuple[float, float, float]) -> None:
    a, f = 0.05, 0.7
    motion = Motion.circular("rod", a, f, normal)
    unit, omega = np.array(normal) / np.linalg.norm(normal), 2 * np.pi * f
    np.testing.assert_array_equal(motion.at(0.0)[0], np.zeros(3))
    rows = np.array([motion.at(t) for t in np.linspace(0, 3, 40)])
    d, v, acc = rows[:, 0], rows[:, 1], rows[:, 2]
    # Of a steady turn about a centre: v = ω × (d - c) and a = -ω² (d - c), at the distance a.
    centre = d - (-acc / omega**2)
    np.testing.assert_allclose(centre, np.broadcast_to(centre[0], d.shape), atol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(d - centre, axis=1), a, rtol=1e-14)
    np.testing.assert_allclose(np.cross(omega * unit, d - centre), v, atol=1e-15)
    np.testing.assert_allclose(d @ unit, 0.0, atol=1e-16)


def random_data(rng: np.random.Generator, count: int, ratio: float = 100.0) -> tuple[Array, Array]:
    """Times of very uneven steps, and displacements."""
    return rng.normal() + np.cumsum(ratio ** rng.uniform(-1, 0, count)), rng.normal(size=(count, 3))


@settings(derandomize=True, max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(3, 25))
def test_data_are_joined_by_the_quintic_spline_at_rest(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    times, displacements = random_data(rng, count, 10.0)
    motion = Motion.data("rod", times, displacements)
    still = [(1, np.zeros(3)), (2, np.zeros(3))]
    spline = make_interp_spline(times, displacements, 5, bc_type=(still, still))
    within = np.linspace(times[0], times[-1], 97)
    found = np.array([motion.at(float(t)) for t in within])
    for order in range(3):
        other = spline(within, order)
        # Both solve a system of condition number C; with steps within a factor of 10, C < 1e8 eps-wise in the scaled
        # unknowns of either, so that they agree to 1e-8 of the largest value.
        np.testing.assert_allclose(found[:, order], other, atol=1e-8 * np.abs(other).max())


@settings(derandomize=True, max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(2, 40), st.booleans())
def test_pieces_meet_the_data_and_each_other(seed: int, count: int, hermite: bool) -> None:
    rng = np.random.default_rng(seed)
    times, d = random_data(rng, count, 10.0)
    rates = rng.normal(size=(2, count, 3)) if hermite else ()
    motion = Motion.data("rod", times, d, *rates)
    spans = np.diff(times)
    values = []
    coefficients = motion.pieces
    for _ in range(5):
        ends = np.einsum("kjx,kj->kx", coefficients, spans[:, None] ** np.arange(coefficients.shape[1]))
        values.append((coefficients[:, 0], ends))
        coefficients = np.arange(1, coefficients.shape[1])[None, :, None] * coefficients[:, 1:]
    for order, (left, right) in enumerate(values[: 3 if hermite else 5]):
        # Round-off of a derivative: eps d / h^order for the shortest h, times 1e5 for the elimination, whose blocks
        # differ by up to 10⁵ as the steps differ by 10.
        gap = np.abs(left[1:] - right[:-1])
        assert np.all(gap <= 2e-11 * (np.abs(d).max() + 1) / spans.min() ** order), order
    for t, row in zip(times, d, strict=True):
        np.testing.assert_allclose(motion.at(float(t))[0], row, rtol=0, atol=1e-11)
    if hermite:
        at = np.array([motion.at(float(t)) for t in times])
        np.testing.assert_allclose(at[:, 1], rates[0], atol=1e-9)
        np.testing.assert_allclose(at[:, 2], rates[1], atol=1e-7)
    else:
        np.testing.assert_array_equal(motion.at(float(times[0]))[1:], 0.0)
    for outside, row in ((times[0] - 1.0, d[0]), (times[-1] + 1.0, d[-1])):
        np.testing.assert_array_equal(motion.at(float(outside)), [row, np.zeros(3), np.zeros(3)])


def test_two_times_make_the_quintic_from_rest_to_rest() -> None:
    motion = Motion.data("rod", [1.0, 3.0], [[0, 0, 0], [1, 0, 0]])
    for t in (1.0, 1.5, 2.0, 2.9):
        s = (t - 1.0) / 2.0
        assert motion.at(t)[0, 0] == pytest.approx(10 * s**3 - 15 * s**4 + 6 * s**5, abs=1e-15)
        assert motion.at(t)[2, 0] == pytest.approx((60 * s - 180 * s**2 + 120 * s**3) / 4, abs=1e-14)


def kinds() -> dict[str, Motion]:
    rng = np.random.default_rng(3)
    times, d = np.linspace(-0.5, 4.0, 12), rng.normal(size=(12, 3))
    harmonics = (Harmonic((0.1, 0, 0.2), 3.0, 0.4), Harmonic((0, 0.3, 0), 1.0), Harmonic((1, 2, 3), 0.0, 0.5))
    return {
        "harmonics": Motion("rod", harmonics),
        "spline": Motion.data("rod", times, d),
        "hermite": Motion.data("rod", times, d, rng.normal(size=(12, 3)), rng.normal(size=(12, 3))),
        "both": Motion("rod", harmonics, tuple(times), tuple(map(tuple, d))),
    }


@pytest.mark.parametrize("kind", list(kinds()))
def test_velocity_and_acceleration_are_the_slopes(kind: str) -> None:
    motion, h = kinds()[kind], 1e-5
    for t in (0.11, 1.3, 2.77, 3.9):
        slopes = (motion.at(t + h) - motion.at(t - h)) / (2 * h)
        # h²/6 times third and fourth derivatives (of data 0.4 s apart: up to 60 · 6 / 0.4³ and 360 · 6 / 0.4⁴ at about
        # unit size, 1e5) is 2e-6; round-off eps / h is 1e-10 of values below 100.
        np.testing.assert_allclose(slopes[:2], motion.at(t)[1:], atol=1e-5)


def test_harmonics_and_data_add_up() -> None:
    motions = kinds()
    for t in (0.0, 1.234):
        total = motions["harmonics"].at(t) + motions["spline"].at(t)
        np.testing.assert_allclose(motions["both"].at(t), total, atol=1e-14)


def test_a_function_says_all_itself_and_can_be_sampled() -> None:
    plain = kinds()["harmonics"]
    motion = Motion.by_function("rod", plain.at)
    np.testing.assert_array_equal(motion.at(0.7), plain.at(0.7))
    times = np.linspace(0, 2, 81)
    data = motion.sampled(times)
    for t in times[::9]:
        np.testing.assert_allclose(data.at(float(t)), plain.at(float(t)), atol=1e-11)
    # Between, a quintic misses by h⁶/(6! 2⁶) of the sixth derivative, 3⁶ · 0.3: 0.025⁶ · 219 / 46080 = 1.2e-12 m.
    for t in times[:-1] + 0.0125:
        np.testing.assert_allclose(data.at(float(t))[0], plain.at(float(t))[0], atol=2e-12)


def test_motions_are_values() -> None:
    one, same = (Motion.data("rod", [0.0, 1.0], np.array([[0, 0, 0], [1.0, 0, 0]])) for _ in range(2))
    assert one == same
    assert hash(one) == hash(same)
    assert pickle.loads(pickle.dumps(one)) == one
    listed = Motion("rod", [Harmonic([1, 0, 0], np.float64(2))])  # type: ignore[arg-type]
    assert listed == Motion("rod", (Harmonic((1.0, 0.0, 0.0), 2.0, 0.0),))
    assert type(listed.harmonics[0].angular_frequency) is float
    assert repr(one.displacements) == "((0.0, 0.0, 0.0), (1.0, 0.0, 0.0))"


WRONG_MOTIONS: dict[str, tuple[Callable[[], object], tuple[str, ...]]] = {
    "support": (lambda: Motion(3), ("support = 3", "name of a rod")),  # type: ignore[arg-type]
    "nothing": (lambda: Motion("rod"), ("'rod'", "nothing says how it moves")),
    "amplitude": (lambda: Motion.in_line("rod", NAN, 1.0, Y), ("'rod': amplitude = nan", "finite")),
    "amplitude that is a text": (lambda: Motion.in_line("rod", "big", 1.0, Y), ("amplitude = 'big'", "finite")),  # type: ignore[arg-type]
    "frequency": (lambda: Motion.circular("rod", 1.0, math.inf), ("frequency = inf", "finite")),
    "direction": (lambda: Motion.in_line("rod", 1.0, 1.0, (0, 0, 0)), ("direction = (0, 0, 0)", "must not be zero")),
    "direction of two": (
        lambda: Motion.in_line("rod", 1.0, 1.0, (0, 1)),
        ("direction = (0, 1)", "three finite"),
    ),
    "normal": (lambda: Motion.circular("rod", 1.0, 1.0, (0, NAN, 1)), ("direction", "nan", "finite")),
    "one harmonic": (lambda: Motion("rod", Harmonic((1, 0, 0), 1.0)), ("harmonics", "sequence")),  # type: ignore[arg-type]
    "harmonics": (lambda: Motion("rod", 3), ("harmonics = 3", "sequence")),  # type: ignore[arg-type]
    "no harmonic": (lambda: Motion("rod", ((1, 2, 3),)), ("harmonics[0] = (1, 2, 3)", "use Harmonic(")),  # type: ignore[arg-type]
    "harmonic of one number": (
        lambda: Motion("rod", (Harmonic(1.0, 1.0),)),  # type: ignore[arg-type]
        ("harmonic: amplitude = 1.0", "three finite numbers [m]"),
    ),
    "harmonic NaN": (lambda: Motion("rod", (Harmonic((0, NAN, 0), 1.0),)), ("amplitude", "nan", "finite")),
    "phase": (lambda: Motion("rod", (Harmonic((0, 1, 0), 1.0, NAN),)), ("phase = nan", "finite")),
    "times NaN": (lambda: Motion.data("rod", [0, NAN], np.zeros((2, 3))), ("times", "nan", "finite numbers, (T,)")),
    "times that are texts": (lambda: Motion.data("rod", ["0", "1"], np.zeros((2, 3))), ("times = ['0', '1']",)),  # type: ignore[arg-type]
    "times that are true": (lambda: Motion.data("rod", [False, True], np.zeros((2, 3))), ("times = [False, True]",)),
    "too fast": (lambda: Motion.in_line("rod", 1.0, 1e90, Y), ("6.28319e+90 rad/s", "no finite acceleration")),
    "direction too long": (lambda: Motion.in_line("rod", 1.0, 1.0, (0, 1e200, 1e200)), ("1e+200", "at most 1e+100")),
    "times that stand": (lambda: Motion.data("rod", [0, 1, 1], np.zeros((3, 3))), ("must increase", "(0.0, 1.0, 1.0)")),
    "one time": (lambda: Motion.data("rod", [0], np.zeros((1, 3))), ("one time alone", "two or more")),
    "shape": (lambda: Motion.data("rod", [0, 1], np.zeros((2, 2))), ("displacements", "(T, 3)")),
    "count": (lambda: Motion.data("rod", [0, 1], np.zeros((3, 3))), ("2 times and 3 displacements", "one a time")),
    "displacements alone": (lambda: Motion("rod", displacements=((0, 0, 1),)), ("0 times and 1 displacements",)),
    "velocities alone": (
        lambda: Motion.data("rod", [0, 1], np.zeros((2, 3)), np.zeros((2, 3))),
        ("velocities and accelerations", "together"),
    ),
    "count of velocities": (
        lambda: Motion.data("rod", [0, 1], np.zeros((2, 3)), np.zeros((1, 3)), np.zeros((2, 3))),
        ("2 times and 1 velocities",),
    ),
    "times too near": (lambda: Motion.data("rod", [0, 5e-324], [[0, 0, 0], [1, 0, 0]]), ("too close",)),
    "function": (lambda: Motion("rod", function=3), ("function = 3", "t -> (3, 3)")),  # type: ignore[arg-type]
    "function and data": (
        lambda: Motion("rod", (Harmonic((1, 0, 0), 1.0),), function=lambda t: np.zeros((3, 3))),
        ("a function stands alone",),
    ),
    "function that fails": (lambda: Motion.by_function("rod", lambda t: 1 / 0).at(0.5), ("0.5 s", "ZeroDivision")),
    "function of another shape": (
        lambda: Motion.by_function("rod", lambda t: np.zeros(3)).at(0.5),
        ("(3,)", "0.5 s", "(3, 3)"),
    ),
    "function NaN": (
        lambda: Motion.by_function("rod", lambda t: np.full((3, 3), NAN)).at(0.5),
        ("gave [[nan,", "finite (3, 3)"),
    ),
}


@pytest.mark.parametrize("case", WRONG_MOTIONS)
def test_wrong_motions_are_refused_and_named(case: str) -> None:
    make, words = WRONG_MOTIONS[case]
    with pytest.raises(SceneError) as caught:
        make()
    for word in words:
        assert word in str(caught.value)


# In a scene ----------------------------------------------------------------------------------------------

STRUCTURE = Structure(
    "kinds of supports",
    {
        "a": (0.0, 0.0, 0.0),
        "b": (0.0, 0.0, -1.0),
        "c": (0.0, 0.5, -1.5),
        "d": (2.0, 0.0, 0.0),
        "e": (2.0, 0.0, 1.0),
        "g": (0.0, 4.0, 0.0),
        "h": (1.0, 4.0, 0.0),
        "k": (5.0, 0.0, 0.0),
        "l": (6.0, 0.0, 0.0),
        "f": (4.0, 0.0, 0.0),
    },
    (
        Rod("pinned", ("a", "b"), 1.0, support=Support.pinned(0.0)),
        Rod("hanging", ("b", "c"), 1.0),
        Rod("sliding", ("d", "e"), 1.0, support=Support.constrained([0, 0, 2])),
        Rod("planar", ("g", "h"), 1.0, support=Support.pinned(0.5, plane=(0, 1, 0))),
        Rod("free", ("k", "l"), 1.0),
    ),
    (String("s", ("e", "f"), 5.0), String("t", ("l", "f"), 5.0)),
    ("f",),
)
ROWS = STRUCTURE.node_index


def scene(*motions: Any, **changes: Any) -> Scene:
    return Scene(STRUCTURE, motions=motions, **({"duration": 3.0} | changes))


def test_the_start_moves_with_its_support() -> None:
    shift, rate = np.array([0.1, -0.2, 0.3]), np.array([1.0, 2.0, 3.0])
    harmonics = (Harmonic(tuple(shift), 0.0, math.pi / 2), Harmonic(tuple(rate / 2), 2.0))
    up = (Harmonic((0, 0, 0.25), 0.0, math.pi / 2), Harmonic((0, 0, 0.5), 2.0))
    made = scene(Motion("pinned", harmonics), Motion("sliding", up), Motion("f", harmonics))
    moved = {"a": shift, "b": shift, "c": shift, "d": (0, 0, 0.25), "e": (0, 0, 0.25), "f": shift}
    rates = {"a": rate, "b": rate, "c": rate, "d": (0, 0, 1), "e": (0, 0, 1), "f": rate}
    for name, row in ROWS.items():
        place = STRUCTURE.positions[row] + moved.get(name, np.zeros(3))
        np.testing.assert_allclose(made.nodes0[row], place, atol=1e-15)
        np.testing.assert_allclose(made.velocities0[row], rates.get(name, np.zeros(3)), atol=1e-15)
    assert scene().nodes0 is STRUCTURE.positions
    assert scene_from_toml(scene_to_toml(made)) == made
    given = made.with_(initial_nodes=made.nodes0, initial_velocities=made.velocities0)
    np.testing.assert_array_equal(given.nodes0, made.nodes0)


def other(support: str = "pinned", rate: float = 1.0, size: float = 0.1) -> Motion:
    return Motion.in_line(support, size, rate / (2 * math.pi * size), (1, 0, 0))


def at_rest() -> Array:
    return np.zeros_like(STRUCTURE.positions)


def moving_out(t: float) -> Array:
    return np.array([[0, 0, t], [0, 0, 1], [0, 0, 0]])


WRONG_SCENES: dict[str, tuple[Callable[[], object], tuple[str, ...]]] = {
    "no sequence": (lambda: Scene(STRUCTURE, motions=other()), ("motions", "sequence")),  # type: ignore[arg-type]
    "another kind": (lambda: scene("pinned"), ("motions[0]", "'pinned'", "Motion.in_line")),
    "unknown": (lambda: scene(other("post")), ("'post'", "no such support", "'pinned', 'sliding', 'planar', 'f'")),
    "a node that moves": (lambda: scene(other("b")), ("'b'", "no such support")),
    "twice": (lambda: scene(other(), other()), ("'pinned'", "twice", "harmonics of both")),
    "free rod": (lambda: scene(other("free")), ("'free'", "[0.1, 0.0, 0.0]", "nowhere: it is free")),
    "rod that hangs": (lambda: scene(other("hanging")), ("'hanging'", "nowhere: it is free")),
    "across what is held": (lambda: scene(other("sliding")), ("'sliding'", "along [[0.0, 0.0, 1.0]] only", "σ = 0.0")),
    "out of the plane": (
        lambda: scene(Motion.in_line("planar", 0.1, 1.0, (0, 1, 0))),
        ("'planar'", "[0.0, 0.1, 0.0]", "plane of normal (0.0, 1.0, 0.0) stands still"),
    ),
    "data across": (
        lambda: scene(Motion.data("sliding", [0, 1, 2], [[0, 0, 0], [0, 1e-3, 1], [0, 0, 0]])),
        ("'sliding'", "[0.0, 0.001, 1.0]"),
    ),
    "function across": (
        lambda: scene(Motion.by_function("sliding", lambda t: moving_out(t)[:, ::-1])),
        ("'sliding'", "leaves the directions"),
    ),
    "function that fails": (
        lambda: scene(Motion.by_function("pinned", lambda t: np.eye(3) if t == 0 else 1 / 0)),
        ("'pinned'", "failed at t = 1 s", "ZeroDivisionError"),
    ),
    "velocity that is none of the displacement's": (
        lambda: scene(Motion.by_function("pinned", lambda t: np.array([[t, 0, 0], [2, 0, 0], [0, 0, 0]]))),
        ("'pinned'", "the velocity [2.0, 0.0, 0.0]", "displacement, velocity and acceleration"),
    ),
    "acceleration that is none of the velocity's": (
        lambda: scene(Motion.by_function("pinned", lambda t: np.array([[t**2, 0, 0], [2 * t, 0, 0], [0, 0, 0]]))),
        ("'pinned'", "the acceleration [0.0, 0.0, 0.0]"),
    ),
    "nodes that stay": (
        lambda: scene(Motion("pinned", (Harmonic((1, 0, 0), 0.0, 1.0),)), initial_nodes=STRUCTURE.positions),
        ("initial_nodes", "'pinned'", "support by 0.841 m", "moved by [0.841"),
    ),
    "a fixed node that stays": (
        lambda: scene(Motion("f", (Harmonic((1, 0, 0), 0.0, 1.0),)), initial_nodes=STRUCTURE.positions),
        ("initial_nodes", "fixed node 'f' is 0.841 m from its place"),
    ),
    "velocities that stay": (
        lambda: scene(other(), initial_velocities=at_rest()),
        ("initial_velocities", "'pinned'", "support at 1 m/s", "its motion starts with [1.0, 0.0, 0.0] m/s"),
    ),
    "velocity of a fixed node": (
        lambda: scene(other("f"), initial_velocities=at_rest()),
        ("fixed node 'f' has [0.0, 0.0, 0.0] m/s", "starts with [1.0, 0.0, 0.0]"),
    ),
    "data that end on their way": (
        lambda: scene(Motion.data("pinned", [0, 1], [[0, 0, 0]] * 2, [[0, 0, 0], [1, 0, 0]], [[0, 0, 0]] * 2)),
        ("'pinned'", "1 m/s at its last time 1 s", "cover the run of 3 s"),
    ),
    "data that start on their way": (
        lambda: scene(Motion.data("pinned", [0.5, 4], [[0, 0, 0]] * 2, [[1, 0, 0], [0, 0, 0]], [[0, 0, 0]] * 2)),
        ("'pinned'", "1 m/s at its first time 0.5 s"),
    ),
}


@pytest.mark.parametrize("case", WRONG_SCENES)
def test_wrong_motions_of_a_scene_are_refused_and_named(case: str) -> None:
    make, words = WRONG_SCENES[case]
    with pytest.raises(SceneError) as caught:
        make()
    for word in words:
        assert word in str(caught.value)


def test_what_names_a_rod_and_a_fixed_node_is_refused() -> None:
    nodes = {"a": (0, 0, 0), "b": (1, 0, 0), "f": (2, 0, 0)}
    rods = (Rod("f", ("a", "b"), 1.0, support=Support.pinned()),)
    made = Structure("both", nodes, rods, (String("s", ("b", "f"), 1.0),), ("f",))
    with pytest.raises(SceneError, match=r"'f': a rod and a fixed node both have that name"):
        Scene(made, motions=(other("f"),))


def test_a_function_with_a_kink_passes() -> None:
    def kinked(t: float) -> Array:
        out = max(t - 1.0, 0.0)
        return np.array([[out, 0, 0], [float(t > 1.0), 0, 0], [0, 0, 0]])

    assert scene(Motion.by_function("pinned", kinked)).velocities0[0, 0] == 0.0


def test_a_run_longer_than_data_that_move_at_their_end_is_refused() -> None:
    rows = [[0, 0, 0], [1.0, 0, 0]]
    motion = Motion.data("pinned", [0, 3], rows, [[0, 0, 0], [0.5, 0, 0]], [[0, 0, 0]] * 2)
    made = scene(motion)
    check_motions_until(made, 3.0)
    with pytest.raises(SceneError, match=r"0\.5 m/s at its last time 3 s.*cover the run of 3\.5 s"):
        tmj.simulate(made, None, tmj.DAE(), duration=3.5)


def test_what_holds_a_rod_may_be_moved() -> None:
    s = 1 / math.sqrt(2)
    cases: list[tuple[Support, list[list[float]]]] = [
        (Support.free(), []),
        (Support.free(plane=(0, 1, 0)), []),
        (Support.constrained([[0, 0, 3]]), [[0, 0, 1]]),
        (Support.constrained([[1, 0, 0], [1, 1, 0]]), [[1, 0, 0], [0, 1, 0]]),
        (Support.pinned(), np.eye(3).tolist()),
        (Support.pinned(plane=(0, 1, 0)), [[1, 0, 0], [0, 0, 1]]),
        (Support.constrained([0, 1, 0], plane=(0, 1, 0)), []),
        (Support.constrained([1, 1, 0], plane=(0, 2, 0)), [[1, 0, 0]]),
        (Support.constrained([1, 1, 0]), [[s, s, 0]]),
    ]
    for support, rows in cases:
        found = held_directions(Rod("r", ("a", "b"), 1.0, support=support))
        expected = np.array(rows).reshape(-1, 3)
        assert found.shape == expected.shape
        np.testing.assert_allclose(found @ found.T, np.eye(len(found)), atol=1e-15)
        np.testing.assert_allclose(found.T @ found, expected.T @ np.linalg.pinv(expected).T, atol=1e-15)


# Velocities that fit -------------------------------------------------------------------------------------


def random_web(rng: np.random.Generator, rods: int, loops: int, moved: int) -> tuple[Structure, list[Motion]]:
    """A random tree of rods with some loops, and motions of some of the nodes that it is held at."""
    places, pairs = [rng.normal(size=3)], []
    for _ in range(rods):
        start = int(rng.integers(len(places)))
        places.append(places[start] + rng.normal(size=3))
        pairs.append((start, len(places) - 1))
    while loops:
        i, j = sorted(rng.choice(len(places), 2, replace=False).tolist())
        if (i, j) not in pairs:
            pairs.append((i, j))
            loops -= 1
    supports = [Support.free()] * len(pairs)
    motions = []
    for row in rng.choice(len(pairs), moved + 1, replace=False).tolist():
        turn = random_rotation(rng)[: int(rng.integers(1, 4))]
        supports[row] = Support.constrained(turn, float(rng.uniform()))
        if len(motions) < moved:
            harmonic = Harmonic(
                tuple(turn.T @ rng.normal(size=len(turn))), float(rng.uniform(1, 3)), rng.uniform(-3, 3)
            )
            motions.append(Motion(f"r{row + 1}", (harmonic,)))
    mass = rng.uniform(0.5, 2.0, len(pairs))
    made = Structure.from_arrays(np.array(places), pairs, [], rod_mass=mass, stiffness=[], supports=supports)
    return made, motions


def misses(structure: Structure, nodes: Array, velocities: Array, motions: list[Motion]) -> Array:
    """By how much velocities miss each thing that rods and supports require [m/s], from what these are."""
    rates = {motion.support: motion.at(0.0)[1] for motion in motions}
    found = []
    for rod, (i, j) in zip(structure.rods, structure.rod_nodes, strict=True):
        b = nodes[j] - nodes[i]
        found.append([b @ (velocities[j] - velocities[i]) / np.linalg.norm(b)])
        r = (1 - rod.support.sigma) * velocities[i] + rod.support.sigma * velocities[j]
        D = np.array(rod.support.directions).reshape(-1, 3)
        found.append(D @ (r - rates.get(rod.name, np.zeros(3))))
    return np.concatenate(found)


def broken(structure: Structure, nodes: Array, velocities: Array, motions: list[Motion]) -> float:
    return float(np.abs(misses(structure, nodes, velocities, motions)).max())


def least_miss(structure: Structure, nodes: Array, motions: list[Motion]) -> float:
    """By how much the best velocities miss it [m/s]: 0 but where the web is too stiff to follow its supports.

    What is missed is linear in the velocities: its columns are those of single velocities of 1 m/s.
    """
    zero = misses(structure, nodes, np.zeros(nodes.shape), motions)
    units = np.eye(nodes.size).reshape(-1, *nodes.shape)
    columns = np.array([misses(structure, nodes, unit, motions) - zero for unit in units]).T
    best = np.linalg.lstsq(columns, -zero, rcond=1e-12)[0]
    return float(np.abs(columns @ best + zero).max())


def kinetic_energy(structure: Structure, velocities: Array) -> float:
    """Of thin rods: centre and half the difference of the ends, m/2 (‖v‖² + ‖w‖²/3)."""
    i, j = structure.rod_nodes.T
    centre, half = (velocities[i] + velocities[j]) / 2, (velocities[j] - velocities[i]) / 2
    return float(np.sum(structure.rod_masses / 2 * (np.sum(centre**2, axis=1) + np.sum(half**2, axis=1) / 3)))


@settings(derandomize=True, max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(3, 8), st.integers(0, 2), st.integers(1, 2), st.booleans())
@example(seed=0, rods=3, loops=2, moved=2, given_some=True)  # too stiff to follow
def test_velocities_fit_and_change_least(seed: int, rods: int, loops: int, moved: int, given_some: bool) -> None:
    rng = np.random.default_rng(seed)
    structure, motions = random_web(rng, rods, loops, moved)
    nodes = structure.positions
    start = rng.normal(size=nodes.shape) if given_some else None
    # Loops may make a web rigid between two supports that move apart: the draws are a number of order 1 or round-off of
    # 1e-16 times a condition number below 1e5, and one between these limits is as good as impossible.
    if (least := least_miss(structure, nodes, motions)) > 1e-6:
        with pytest.raises(SceneError, match="start at velocities that the rods between them cannot follow"):
            velocities_with_supports(structure, nodes, motions, start)
        return
    assert least < 1e-10
    found = velocities_with_supports(structure, nodes, motions, start)
    # Round-off of a least-squares problem whose condition number here stays below 1e5.
    assert broken(structure, nodes, found, motions) < 1e-10
    if start is None:
        return
    # Of all velocities that fit, these differ by the least kinetic energy: any other, found by adding what rods and
    # still supports allow, differs by more.
    least = kinetic_energy(structure, found - start)
    for _ in range(5):
        allowed = velocities_with_supports(structure, nodes, [], rng.normal(size=nodes.shape))
        assert broken(structure, nodes, allowed, []) < 1e-10
        for size in (1e-3, 1.0):
            assert kinetic_energy(structure, found + size * allowed - start) >= least * (1 - 1e-12)
    np.testing.assert_allclose(velocities_with_supports(structure, nodes, motions, found), found, atol=1e-10)


def test_velocities_of_a_chain_struck_at_its_top() -> None:
    """Two equal rods in line, at rest, the top set moving across at 1: the rest by hand.

    With ends at rates u, v, w the energy is m/6 (u² + u v + v² + v² + v w + w²). It is least for u = 1 where
    u + 4 v + w = 0 and v + 2 w = 0: w = 1/7 and v = -2/7.
    """
    nodes = {"a": (0, 0, 0), "b": (0, 0, -1), "c": (0, 0, -2)}
    rods = (Rod("r1", ("a", "b"), 2.0, support=Support.pinned()), Rod("r2", ("b", "c"), 2.0))
    made = Structure("two", nodes, rods)
    found = velocities_with_supports(made, made.positions, [other("r1")], np.zeros((3, 3)))
    np.testing.assert_allclose(found, [[1, 0, 0], [-2 / 7, 0, 0], [1 / 7, 0, 0]], atol=5e-15)


def test_supports_that_pull_a_rod_apart_are_refused() -> None:
    nodes = {"a": (0, 0, 0), "b": (1, 0, 0), "c": (2, 0, 0)}
    rods = (
        Rod("r1", ("a", "b"), 1.0, support=Support.pinned(0.0)),
        Rod("r2", ("b", "c"), 1.0, support=Support.pinned(1.0)),
    )
    made = Structure("taut", nodes, rods)
    with pytest.raises(SceneError, match=r"supports of rods 'r1', 'r2' start at velocities .*cannot follow \(off by"):
        Scene(made, motions=(other("r2"),))
    across = Scene(made, motions=(Motion.in_line("r2", 0.1, 1.0, (0, 0, 1)),))
    assert across.velocities0[2, 2] == pytest.approx(0.2 * math.pi, rel=1e-12)


def test_a_joint_that_two_rods_hold_can_not_be_moved_by_one() -> None:
    nodes = {"a": (0, 0, 0), "b": (1, 0, 0), "c": (0, 1, 0)}

    def held(first: Support, second: Support, *motions: Motion) -> Scene:
        rods = (Rod("r1", ("a", "b"), 1.0, support=first), Rod("r2", ("c", "a"), 1.0, support=second))
        return Scene(Structure("corner", nodes, rods), motions=motions)

    twice = (Support.pinned(0.0), Support.pinned(1.0))
    assert held(*twice).motions == ()
    with pytest.raises(SceneError, match="node 'a' is held by rods 'r1' and 'r2' in the same direction"):
        held(*twice, other("r1"))
    # Held by one in x, by the other one in y and z: each moves what it holds.
    made = held(Support.constrained([1, 0, 0]), Support.constrained([[0, 1, 0], [0, 0, 1]], 1.0), other("r1"))
    np.testing.assert_allclose(made.velocities0, [[1, 0, 0]] * 3, atol=1e-15)


# Files ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", list(kinds()))
def test_motions_come_back_from_files(kind: str) -> None:
    motion = kinds()[kind]
    fields = {name: getattr(motion, name) for name in ("harmonics", "times", "displacements")}
    fields |= {name: getattr(motion, name) for name in ("velocities", "accelerations")}
    made = scene(Motion("pinned", **fields))
    text = scene_to_toml(made)
    assert scene_from_toml(text) == made
    assert scene_to_toml(scene_from_toml(text)) == text


def test_a_function_is_refused_by_files_and_kept_as_data_by_runs(tmp_path: Any) -> None:
    line = Motion.in_line("pinned", 0.05, 0.5, (0, 1, 0))
    made = scene(Motion.by_function("pinned", line.at), duration=0.05)
    with pytest.raises(SceneError, match=r"motion of 'pinned' is a Python function.*sampled"):
        scene_to_toml(made)
    run = tmj.simulate(made, None, tmj.DAE(), output_interval=0.01)
    again = tmj.Trajectory.load(run.save(tmp_path / "run.nc"))
    assert again.scene.motions[0].function is None
    np.testing.assert_array_equal(again.scene.velocities0, made.velocities0)
    for t in run.time:
        np.testing.assert_allclose(again.scene.motions[0].at(float(t)), line.at(float(t)), atol=1e-14)
    # A run that stopped, or was not as long as its scene, is one of a scene whose support moves on.
    short = run.until(2)
    assert tmj.Trajectory.load(short.save(tmp_path / "short.nc")).scene.motions[0].times[-1] >= 0.05 - 1e-12
    none = run.until(0)
    assert len(tmj.Trajectory.load(none.save(tmp_path / "none.nc")).time) == 0


def test_constraints_that_repeat_each_other_take_away_the_same() -> None:
    rng = np.random.default_rng(5)
    root = rng.normal(size=(4, 4))
    mass, C, missing = root @ root.T + np.eye(4), rng.normal(size=(5, 12)), rng.normal(size=5)
    once = _least_energy(mass, C, missing, 1e-12)
    # Of all that fit, that of the least energy: it is orthogonal, by the mass, to all that keep the constraints.
    np.testing.assert_allclose(C @ once, missing, atol=1e-13)
    free = np.linalg.svd(C)[2][5:]
    np.testing.assert_allclose(free @ np.kron(mass, np.eye(3)) @ once, 0.0, atol=1e-12)
    twice = _least_energy(mass, np.concatenate([C, C[:2]]), np.concatenate([missing, missing[:2]]), 1e-12)
    np.testing.assert_allclose(twice, once, atol=1e-12)
