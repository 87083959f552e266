"""Derivatives of runs: against differences, closed forms, and where a damped string comes taut."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import pytest
from caught_fall import DEPTH, C, K, caught, slope
from features import FEATURES, IN_AIR, RESISTANCE

import tensegrity_mj as tmj
from tensegrity_mj.errors import DerivativeWarning, OptionError

jax = pytest.importorskip("jax")
pytest.importorskip("diffrax")

STEP, DURATION = 2e-3, 0.1  # s


@functools.cache
def program(name: str) -> Any:
    scene = FEATURES[name].scene().with_(resistance=RESISTANCE if name == "loads" else IN_AIR)
    return tmj.JAX(method="rk4", timestep=STEP).model(scene, duration=DURATION, output_interval=0.02)


@functools.cache
def compiled(name: str) -> Any:
    """A scalar of all that a run records, and its gradient."""
    model, generator = program(name), np.random.default_rng(7)
    N, M = model.parameters["nodes"].shape[0], len(model.parameters["rest_lengths"])
    weights = [generator.standard_normal(shape) for shape in ((6, N, 3), (6, N, 3), (6, M))]

    def scalar(parameters: Any) -> Any:
        run = model.run(parameters)
        parts = zip(weights, (run.nodes, 0.1 * run.velocities, 0.01 * run.tensions), strict=True)
        return sum((weight * part).sum() for weight, part in parts)

    return jax.jit(scalar), jax.jit(jax.grad(scalar))


def spread_of_an_ulp(name: str) -> float:
    """The largest change of the scalar in eight runs whose start is moved by up to an ulp of what is largest there."""
    model, (scalar, _), generator = program(name), compiled(name), np.random.default_rng(1)

    def moved(ulps: float) -> float:
        start = {key: np.asarray(model.parameters[key]) for key in ("nodes", "velocities")}
        sizes = {key: ulps * np.finfo(float).eps * np.abs(value).max() for key, value in start.items()}
        shifted = {key: value + sizes[key] * generator.uniform(-1, 1, value.shape) for key, value in start.items()}
        return float(scalar({**model.parameters, **shifted}))

    return max(abs(moved(1.0) - moved(0.0)) for _ in range(8))


# Each takes 9 s to compile. Bodies, with a rod, a point mass and drag, have parameters of all groups.
NAMES = ("bodies", pytest.param("loads", marks=pytest.mark.study))
GROUPS = ("rest_lengths", "stiffness", "damping", "rod_masses", "point_masses", "gravity", "nodes", "velocities")


@pytest.mark.parametrize("name", NAMES)
def test_derivatives_are_those_of_differences(name: str) -> None:
    """Along a direction in all parameters of a group, against fourth-order differences of steps of 3e-4.

    These err by (3e-4)⁴ = 1e-14 of the fifth derivative, for which 1e-9 of the slopes is allowed, and by the round-off
    of four runs times the sum of their weights over the step. Every step rounds the state to an ulp, which moves the
    end of a run as an ulp of its start does: that is measured, so that the bound holds however a processor sums.
    """
    model, (scalar, gradient) = program(name), compiled(name)
    found, generator = gradient(model.parameters), np.random.default_rng(3)
    round_off = (DURATION / STEP) * spread_of_an_ulp(name)
    groups = [key for key in GROUPS if np.size(model.parameters[key])]
    for key in groups:
        value = np.asarray(model.parameters[key])
        size = 3e-4 * max(float(np.abs(value).max()), 1e-1)
        direction = generator.uniform(-1, 1, value.shape)

        def moved(steps: float, key: str = key, change: Any = size * direction) -> float:
            return float(scalar({**model.parameters, key: model.parameters[key] + steps * change}))

        expected = (8 * (moved(1) - moved(-1)) - (moved(2) - moved(-2))) / 12 / size
        along = float((np.asarray(found[key]) * direction).sum())
        # Against what the slopes by single parameters add up to.
        scale = float(np.abs(np.asarray(found[key]) * direction).sum())
        print(name, key, along, expected, abs(along - expected) / scale)
        assert abs(along - expected) < 1e-9 * scale + (8 + 8 + 1 + 1) / 12 * round_off / size


def test_forwards_and_backwards_are_the_same() -> None:
    """The same sums in another order."""
    model, (scalar, gradient) = program("bodies"), compiled("bodies")
    backwards = gradient(model.parameters)["rest_lengths"]
    rest = model.parameters["rest_lengths"]
    way = np.random.default_rng(2).uniform(0.5, 1.0, len(rest))

    @jax.jit
    def forwards(rest: Any, way: Any) -> Any:
        return jax.jvp(lambda rest: scalar({**model.parameters, "rest_lengths": rest}), (rest,), (way,))[1]

    assert abs(forwards(rest, way) - backwards @ way) < 1e-11 * (np.abs(backwards) @ way)


def test_batches_of_jax_vmap_have_the_same_derivatives() -> None:
    """Of a sum over runs that `jax.vmap` makes, and of each by itself: the same sums in another order."""
    model = tmj.JAX(method="rk4", timestep=4e-3).model(caught(), duration=0.184, output_interval=0.184)
    damping = np.array([[0.5 * C], [C]])  # coming taut: the jump's term is in it

    def height(c: Any) -> Any:
        return model.run({**model.parameters, "damping": c}).nodes[-1, 1, 2]

    together = jax.jit(jax.grad(lambda c: jax.vmap(height)(c).sum()))(damping)
    single = jax.jit(jax.grad(height))
    alone = [single(one) for one in damping]
    np.testing.assert_allclose(together, alone, rtol=1e-12)


def test_a_controlled_step_has_the_derivatives_of_an_oscillator() -> None:
    """m z̈ = k (L - L0) - m g from rest: z(t) = z* + (z0 - z*) cos ω t, whose derivatives are written down."""
    scene = caught()
    start = scene.nodes0 - [[0, 0, 0], [0, 0, 0.3]]  # taut: 0.2 m of stretch
    scene = scene.with_(structure=scene.structure.with_strings(damping=0.0), initial_nodes=start)
    time = 0.04  # before a quarter of a period, where it goes slack
    model = tmj.JAX(rtol=1e-12, atol=1e-13).model(scene, times=[0.0, time])
    found = jax.jit(jax.grad(lambda p: model.run(p).nodes[-1, 1, 2]))(model.parameters)
    m, g, omega, z0 = 0.5, 9.81, np.sqrt(K / 0.5), -DEPTH - 0.3
    still = -1.0 - m * g / K
    cos, sin = np.cos(omega * time), np.sin(omega * time)
    by_omega = -(z0 - still) * time * sin
    np.testing.assert_allclose(found["rest_lengths"][0], -(1 - cos), rtol=1e-9)
    np.testing.assert_allclose(found["nodes"][1, 2], cos, rtol=1e-9)
    np.testing.assert_allclose(found["velocities"][1, 2], sin / omega, rtol=1e-9)
    np.testing.assert_allclose(found["stiffness"][0], m * g / K**2 * (1 - cos) + by_omega * omega / (2 * K), rtol=1e-9)
    np.testing.assert_allclose(found["point_masses"][0], -g / K * (1 - cos) - by_omega * omega / (2 * m), rtol=1e-9)


@functools.cache
def caught_slopes(step: float, window: float) -> tuple[float, float]:
    """Of the height after 0.184 s, by the start's depth and the damper, with the string taut after 0.143 s."""
    model = tmj.JAX(method="rk4", timestep=step, window=window).model(caught(), duration=0.184, output_interval=0.184)
    found = jax.jit(jax.grad(lambda p: model.run(p).nodes[-1, 1, 2]))(model.parameters)
    return -float(found["nodes"][1, 2]), float(found["damping"][0])


def test_the_jump_of_a_damped_string_that_comes_taut_is_in_the_derivatives() -> None:
    """Against the closed form, as the jump's instant moves with the start.

    Steps of h that are not split at the jump err by h/2 of the jump in time, so the derivative by a term of the first
    order, (h + w)/T of it with a window of w = 4 h and the oscillation's time T = √(m/k) = 35 ms: 1.4 % at 0.1 ms.
    """
    expected = slope(0.184, depth=DEPTH)
    for step in (4e-4, 1e-4):
        by_depth, by_damping = caught_slopes(step, 4 * step)
        print(step, by_depth / expected - 1, by_damping / slope(0.184, damping=C) - 1)
        assert abs(by_depth / expected - 1) < 5 * step / 0.035
        assert abs(by_damping / slope(0.184, damping=C) - 1) < 5 * step / 0.035


def test_without_the_jump_they_are_wrong_at_every_step_and_small_differences_agree_with_them() -> None:
    expected = slope(0.184, depth=DEPTH)
    for step in (4e-4, 1e-4):
        assert abs(caught_slopes(step, 0.0)[0] / expected - 1) > 0.1
    scene = caught()
    model = tmj.JAX(method="rk4", timestep=4e-4, window=0.0).model(scene, duration=0.184, output_interval=0.184)
    height = jax.jit(lambda p: model.run(p).nodes[-1, 1, 2])
    nodes = model.parameters["nodes"]

    def moved(h: float) -> float:
        return float(height({**model.parameters, "nodes": nodes + np.array([[0, 0, 0], [0, 0, -h]])}))

    small = (moved(1e-8) - moved(-1e-8)) / 2e-8
    assert abs(small / caught_slopes(4e-4, 0.0)[0] - 1) < 1e-5  # heights of 1 m have 1e-15 of it, over 2e-8 m
    # Over 5 mm of 100 mm the jump's instant moves by 2.5 % of 0.143 s, 9 steps, each way: half a step of 18 is 3 %.
    wide = (moved(5e-3) - moved(-5e-3)) / 1e-2
    assert abs(wide / expected - 1) < 0.05


def test_dopri8_without_a_window_warns_of_dampers_and_misses_the_jump(recwarn: pytest.WarningsRecorder) -> None:
    """65 % of it; with a window of 2 ms, as with fixed steps, (2 ms)/(35 ms) at most of it is left (0.2 % measured)."""
    expected = slope(0.184, depth=DEPTH)
    with pytest.warns(DerivativeWarning, match=r"string 's' has a damper: .* use window=2e-3"):
        model = tmj.JAX(derivatives="forward").model(caught(), times=[0.0, 0.184])
    found = {}
    for window in (None, 2e-3):
        model = (
            model
            if window is None
            else tmj.JAX(derivatives="forward", window=window).model(caught(), times=[0.0, 0.184])
        )
        start, down = model.parameters["nodes"], np.array([[0, 0, 0], [0, 0, -1.0]])

        def height(nodes: Any, model: Any = model) -> Any:
            return model.run({**model.parameters, "nodes": nodes}).nodes[-1, 1, 2]

        found[window] = float(jax.jit(lambda: jax.jvp(height, (start,), (down,)))()[1]) / expected - 1  # noqa: B023
    print(found)
    assert abs(found[None]) > 0.5
    assert abs(found[2e-3]) < 2e-3 / 0.035
    tmj.JAX(window=0.0).model(caught())
    assert not recwarn.list


def test_the_other_way_of_differentiating_is_named() -> None:
    model = tmj.JAX(window=0.0).model(caught(), times=[0.0, 0.1])
    with pytest.raises(OptionError, match='derivatives="forward"'):
        jax.jit(jax.jacfwd(lambda p: model.run(p).nodes[-1, 1, 2]))(model.parameters)  # traced alone


def aimed(p: Any, t: Any, x: Any, v: Any) -> Any:
    """Force densities of a prism by its heights and their rates."""
    return p["level"] * jax.numpy.ones(12) + p["gain"] * jax.numpy.tanh(x[:, 2].sum() + v[:, 2].sum())


# A law's own derivatives are compared in test_jax_laws.py: a policy, which compiles soon, shows that runs pass them on.
@pytest.mark.parametrize("name", [pytest.param("a law's gain", marks=pytest.mark.study), "a policy's parameter"])
def test_derivatives_by_what_a_law_has_are_those_of_differences(name: str) -> None:
    """Against fourth-order differences of 300 steps: steps of 0.3 % leave 8e-11/30 of the fifth derivative."""
    scene, key = tmj.load_scene("prism"), "decay_rate"
    law: Any = tmj.controllers.from_scene(scene, "lyapunov")
    if name == "a policy's parameter":
        law, key = tmj.engines.ArrayPolicy(aimed, {"level": 0.5, "gain": 0.1}), "gain"
    model = tmj.JAX(method="rk4", timestep=5e-3).model(scene, law, duration=0.3, output_interval=0.1)

    def scalar(value: Any) -> Any:
        run = model.run({**model.parameters, "law": {**model.parameters["law"], key: value}})
        return ((run.nodes[-1] - scene.nodes0) ** 2).sum() + (run.velocities[-1] ** 2).sum()

    value = float(model.parameters["law"][key])
    size = 3e-3 * value
    one, slope = jax.jit(scalar), jax.jit(jax.grad(scalar))(value)
    expected = (8 * (one(value + size) - one(value - size)) - (one(value + 2 * size) - one(value - 2 * size))) / 12
    print(name, value, float(slope), float(slope * size / expected - 1))
    assert abs(slope * size / expected - 1) < 1e-9
