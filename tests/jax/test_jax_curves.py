"""Tension curves as array functions: against `TensionCurves`, numbers by hand, and derivatives."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

pytest.importorskip("jax")
pytest.importorskip("diffrax")

import jax
import jax.numpy as jnp

import tensegrity_mj as tmj
from tensegrity_mj.engines.jax.strings import Curves

POINTS = ((0.1, 10.0), (0.2, 40.0), (0.3, 40.0), (0.5, 60.0))
LEVEL = ((0.2, 30.0), (0.6, 30.0))  # stays level for ever


def structure(kinds: str) -> tmj.Structure:
    """One string a letter: a polygon, one that stays level, linear, of constant force."""
    given: dict[str, dict[str, Any]] = {
        "p": {"curve": POINTS},
        "v": {"curve": LEVEL},
        "l": {"stiffness": 70.0},
        "c": {"stiffness": 0.0, "tension": 15.0},
    }
    nodes = {f"{end}{n}": (float(n), 0.0, 0.0 if end == "h" else -1.0) for n in range(len(kinds)) for end in "hm"}
    strings = tuple(tmj.String(f"s{n}", (f"h{n}", f"m{n}"), **given[kind]) for n, kind in enumerate(kinds))
    masses = tuple(tmj.PointMass(f"m{n}", 2.0) for n in range(len(kinds)))
    fixed = tuple(f"h{n}" for n in range(len(kinds)))
    return tmj.Structure("hung", nodes, strings=strings, fixed_nodes=fixed, point_masses=masses)


def made(kinds: str) -> tuple[Any, Any, Any]:
    """Curves, their parameters and what NumPy has."""
    found = structure(kinds)
    curves = Curves(found)
    return curves, {"stiffness": found.stiffness, **curves.parameters(found)}, found.curves


def test_a_polygon_by_hand() -> None:
    curves, p, _ = made("pvlc")
    stretch = np.tile([-0.1, 0.0, 0.05, 0.15, 0.25, 0.4, 1.5], (4, 1))
    tension, energy = curves.pull(p, stretch)
    wanted = [[0, 0, 5, 25, 40, 50, 160], [0, 0, 7.5, 22.5, 30, 30, 30], 70 * stretch[2].clip(0), [0, 0, *[15] * 5]]
    assert np.asarray(tension) == pytest.approx(np.array(wanted, float), abs=1e-14 * 160)
    # Areas: 0.5 up to 0.1, 3 up to 0.2, 7 up to 0.3, then trapezoids.
    areas = [
        [0, 0, 0.125, 0.5 + 0.05 * 17.5, 5.0, 7 + 4.5, 7 + 1.2 * 100],
        [0, 0, 0.1875, 1.6875, 3 + 0.05 * 30, 3 + 0.2 * 30, 3 + 1.3 * 30],
        35 * stretch[2].clip(0) ** 2,
        15 * stretch[3].clip(0),
    ]
    assert np.asarray(energy) == pytest.approx(np.array(areas), abs=1e-14 * 160)


@pytest.mark.parametrize("kinds", ["pvlc", "ll", "pp", "c"])
def test_tensions_energies_and_stretches_are_those_of_numpy(kinds: str) -> None:
    curves, p, known = made(kinds)
    assert curves.linear == known.linear
    stretch = np.random.default_rng(2).uniform(-0.2, 0.8, (len(kinds), 50))
    stretch[p["stiffness"] == 0.0] += 0.2  # a constant force has L0 = 0
    pull = jax.jit(curves.pull)
    tension, energy = pull(p, stretch)
    # Sums of five positive terms of four operations each.
    assert np.asarray(tension) == pytest.approx(known.tension(stretch.T).T, rel=5e-15)
    assert np.asarray(energy) == pytest.approx(known.energy(stretch.T).T, rel=5e-15)
    one = pull(p, stretch[:, 0])
    assert np.asarray(one[0]) == pytest.approx(np.asarray(tension[:, 0]), rel=5e-15)
    pulls = np.random.default_rng(3).uniform(-5.0, 90.0, (len(kinds), 50))
    found = jax.jit(curves.stretch)(p, pulls)
    if kinds == "c":  # NumPy's has no energy to find a stretch of
        assert not np.asarray(found).any()
        return
    assert np.asarray(found) == pytest.approx(known.stretch(pulls.T).T, rel=5e-15)


def test_the_inverse_finds_the_least_stretch() -> None:
    curves, p, _ = made("pvlc")
    stretch = jax.jit(curves.stretch)
    for tension, wanted in (
        (40.0, (0.2, 0.2, 4 / 7, 0.0)),  # the polygon is level there, and the second stays below
        (30.0, (0.1 + 0.2 / 3, 0.2, 3 / 7, 0.0)),
        (60.0, (0.5, 0.2, 6 / 7, 0.0)),
        (-7.0, (-0.07, -7 / 150, -0.1, 0.0)),
    ):
        assert np.asarray(stretch(p, np.full(4, tension))) == pytest.approx(wanted, rel=1e-14)
    assert np.asarray(stretch(p, np.full((4, 2), np.inf))).tolist() == [[np.inf] * 2] * 4


@pytest.mark.parametrize("kinds", ["pvlc", "ll"])
def test_a_tension_is_the_gradient_of_its_energy_and_has_that_of_differences(kinds: str) -> None:
    curves, p, _ = made(kinds)
    stretch = np.random.default_rng(5).uniform(-0.2, 0.8, (len(kinds), 20))
    slope = jax.jit(jax.grad(lambda s: curves.pull(p, s)[1].sum()))(jnp.asarray(stretch))
    tension = jax.jit(lambda s: curves.pull(p, s)[0])
    assert np.asarray(slope) == pytest.approx(np.asarray(tension(stretch)), rel=5e-15)
    # All is linear in p, and piecewise linear in s: differences within a piece are exact but for 2e-16/h of 60 N.
    h, pulls = 1e-4, np.random.default_rng(6).uniform(1.0, 55.0, (len(kinds), 20))
    for function, at, away in (
        (tension, stretch, np.abs(stretch[..., None] - [0.0, 0.1, 0.2, 0.3, 0.5, 0.6])),
        (jax.jit(lambda pull: curves.stretch(p, pull)), pulls, np.abs(pulls[..., None] - [10.0, 30.0, 40.0, 60.0])),
    ):
        found = np.asarray(jax.jit(jax.grad(lambda x, f=function: f(x).sum()))(jnp.asarray(at)))
        near = (np.asarray(function(at + h)) - np.asarray(function(at - h))) / (2 * h)
        clear = away.min(axis=-1) > h
        assert clear.mean() > 0.9
        assert found[clear] == pytest.approx(near[clear], abs=1e-9)

    @jax.jit
    def total(p: Any) -> Any:
        return (curves.pull(p, stretch)[0] * (1 + stretch)).sum() + curves.pull(p, stretch)[1].sum()

    gradient = jax.jit(jax.grad(total))(p)
    for name, values in p.items():
        found = np.asarray(gradient[name])
        for m in range(len(kinds)):
            step = np.zeros(len(kinds))
            step[m] = 1.0
            difference = float(total({**p, name: values + step})) - float(total({**p, name: values - step}))
            # Linear; of sums of a thousand newtons.
            assert found[m] == pytest.approx(difference / 2, abs=1e-11)


def test_nothing_is_undefined_at_corners_and_parameters_may_have_a_batch() -> None:
    curves, p, _ = made("pvlc")
    corners = np.tile([0.0, 0.1, 0.2, 0.3, 0.5, 0.6], (4, 1))
    # As of `TensionCurves.slope`: a corner belongs to the piece before it, and nothing is taut at zero.
    slopes = jax.jit(jax.grad(lambda s: curves.pull(p, s)[0].sum()))(corners)
    assert np.asarray(slopes) == pytest.approx(made("pvlc")[2].slope(np.asarray(corners).T).T, rel=1e-14)
    for gradient in jax.tree.leaves(jax.jit(jax.grad(lambda p: curves.stretch(p, 100 * corners).sum()))(p)):
        assert np.isfinite(gradient).all()
    scales = np.array([1.0, 0.5, 3.0])
    many = {name: values[:, None] * scales for name, values in p.items()}
    stretch = np.random.default_rng(8).uniform(-0.1, 0.7, (4, 3))
    pull, inverse = jax.jit(curves.pull), jax.jit(curves.stretch)
    tension, energy = pull(many, stretch)
    alone, stored = pull(p, stretch)
    assert np.asarray(tension) == pytest.approx(np.asarray(alone) * scales, rel=1e-14)
    assert np.asarray(energy) == pytest.approx(np.asarray(stored) * scales, rel=1e-14)
    again = inverse(many, np.asarray(alone) * scales)
    assert np.asarray(again) == pytest.approx(np.asarray(inverse(p, alone)), rel=1e-14)
