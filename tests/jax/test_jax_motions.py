"""Motions of supports as array functions of time: against `Motion.at`, closed forms and differences."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

pytest.importorskip("jax")
pytest.importorskip("diffrax")

import jax
import jax.numpy as jnp

import tensegrity_mj as tmj
from tensegrity_mj.engines.jax.system import displacements
from tensegrity_mj.errors import SceneError
from tensegrity_mj.model import Ground, Motion
from tensegrity_mj.model.motion import Harmonic

TIMES = (0.2, 0.5, 0.9, 1.6)
RNG = np.random.default_rng(4)
PLACES = RNG.normal(size=(len(TIMES), 3))
RATES = np.array([np.zeros(3), *RNG.normal(size=(2, 3)), np.zeros(3)])  # at rest where the data begin and end


def hung(*motions: Motion) -> tmj.Scene:
    """A rod that hangs on two fixed nodes, p and q, which move."""
    nodes = {"a": (0.0, 0.0, 0.0), "b": (1.0, 0.0, 0.0), "p": (0.0, 0.0, 1.0), "q": (1.0, 0.0, 1.0)}
    strings = (tmj.String("s", ("p", "a"), 10.0, 0.0, 0.9), tmj.String("t", ("q", "b"), 10.0, 0.0, 0.9))
    structure = tmj.Structure("hung", nodes, (tmj.Rod("r", ("a", "b"), 1.0),), strings, ("p", "q"))
    return tmj.Scene(structure, motions=motions)


def shaken() -> tmj.Scene:
    scene = hung()
    ground = Ground((0.1, 0.4, 0.9, 1.3), ((0.3, 0.0, 1.0), (-1.0, 0.5, 0.2), (0.4, 0.0, 0.0), (0.0, -1.0, 0.3)))
    return scene.with_(motions=ground.motions(scene.structure))


SCENES = {
    "line and circle": lambda: hung(
        Motion.in_line("p", 0.3, 1.7, (1.0, 2.0, 0.5)), Motion.circular("q", 0.2, 0.9, (0.0, 1.0, 2.0))
    ),
    "data": lambda: hung(Motion.data("p", TIMES, PLACES), Motion.data("q", TIMES, PLACES, RATES, 3 * RATES)),
    "both": lambda: hung(Motion("q", (Harmonic((0.1, 0.0, 0.2), 3.0, 0.4),), TIMES, tuple(map(tuple, PLACES)))),
    "ground": shaken,
    "none": hung,
}


def rates_of(function: Any) -> Any:
    """(m, 3, 3): displacement, velocity and acceleration, in that order, second axis."""

    def rate(t: Any) -> Any:
        return jax.jvp(function, (t,), (jnp.ones_like(t),))[1]

    def all_(t: Any) -> Any:
        return jnp.stack([function(t), rate(t), jax.jvp(rate, (t,), (jnp.ones_like(t),))[1]], axis=1)

    return jax.jit(all_)


@pytest.mark.parametrize("name", SCENES)
def test_displacement_velocity_and_acceleration_are_those_of_the_motion(name: str) -> None:
    scene = SCENES[name]()
    function = rates_of(displacements(scene))
    for t in (0.0, 0.2, 0.31, 0.5, 0.77, 0.9, 1.25, 1.3, 1.6, 2.4):
        found = np.asarray(function(jnp.asarray(t)))
        assert found.shape == (len(scene.motions), 3, 3)
        for motion, rows in zip(scene.motions, found, strict=True):
            # Of a harmonic the round-off of its angle and of three products; of a quintic that of twelve operations on
            # terms that two derivatives make 20 times as large at most.
            waves = [(item.angular_frequency, np.linalg.norm(item.amplitude)) for item in motion.harmonics]
            size = sum(amplitude * max(1.0, omega) ** 2 * (3 + omega * t) for omega, amplitude in waves)
            powers = np.diff(motion.times)[:, None, None] ** np.arange(-2, 4)[:, None]
            size += 20 * 12 * float(np.abs(motion.pieces * powers).sum(axis=1).max(initial=0.0))
            assert np.abs(rows - motion.at(t)).max() <= 2.3e-16 * size


def test_a_circle_is_one() -> None:
    # Radius 0.2 about y, 0.9 turns a second by the right hand.
    function = rates_of(displacements(hung(Motion.circular("q", 0.2, 0.9, (0.0, 1.0, 0.0)))))
    omega = 2 * np.pi * 0.9
    for t in (0.0, 0.4, 1.1):
        d, velocity, acceleration = np.asarray(function(jnp.asarray(t)))[0]
        middle = d + acceleration / omega**2  # the acceleration is -ω² times what leads there
        assert np.linalg.norm(acceleration) == pytest.approx(0.2 * omega**2, rel=1e-14)
        assert np.cross((0.0, omega, 0.0), d - middle) == pytest.approx(velocity, abs=1e-14)
        assert np.linalg.norm(middle) == pytest.approx(0.2, rel=1e-14)


@pytest.mark.parametrize("name", SCENES)
def test_times_may_have_a_batch_and_rates_are_those_of_differences(name: str) -> None:
    scene = SCENES[name]()
    function, t = jax.jit(displacements(scene)), jnp.array([0.31, 0.77, 1.2, 2.4])
    together = np.asarray(function(t))
    assert together.shape == (len(scene.motions), 3, 4)
    for k in range(4):
        # Fused products or not: 50 rounding errors of 2 m.
        assert together[..., k] == pytest.approx(np.asarray(function(t[k])), abs=50 * 2.3e-16)
    found, h = np.asarray(jax.jit(jax.jacfwd(function))(t).sum(axis=-1)), 1e-3
    near = [np.asarray(function(t + step * h)) for step in (-2, -1, 1, 2)]
    for motion, rates, *values in zip(scene.motions, found, *near, strict=True):
        # h⁴/30 of the fifth derivative, and 1.5 · 2e-16/h of 2 m.
        fifth = sum(np.linalg.norm(item.amplitude) * item.angular_frequency**5 for item in motion.harmonics)
        fifth += 120 * np.abs(motion.pieces[:, 5]).max(initial=0.0)
        difference = (values[0] - 8 * values[1] + 8 * values[2] - values[3]) / (12 * h)
        assert rates == pytest.approx(difference, abs=h**4 / 30 * fifth + 1e-12)


def test_a_python_function_is_refused_by_the_name_of_its_support() -> None:
    scene = hung(Motion.in_line("p", 0.3, 1.7, (1.0, 0.0, 0.0)), Motion.by_function("q", lambda t: np.zeros((3, 3))))
    with pytest.raises(SceneError, match=r"the motion of 'q' is a Python function, .* `motion.sampled\(times\)`"):
        displacements(scene)
