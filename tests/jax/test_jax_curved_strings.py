"""Strings with curves, constant forces and limits in runs of the differentiable engine."""

from __future__ import annotations

import functools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("jax")
pytest.importorskip("diffrax")

import jax
import jax.numpy as jnp
from linked_scenes import hung

import tensegrity_mj as tmj
from tensegrity_mj.engines.jax.arrays import ArrayLaw
from tensegrity_mj.engines.jax.model import Model
from tensegrity_mj.engines.jax.settings import JAX
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.actuation import Actuation

POINTS = ((0.1, 10.0), (0.2, 40.0), (0.3, 40.0), (0.5, 60.0))


def with_curves() -> tmj.Scene:
    """Rods that hang on strings that stiffen or give way, and on a constant force."""
    structure = hung().structure
    first = replace(structure.strings[0], stiffness=0.0, tension=8.0, rest_length=None, force_density=None)
    strings = [first]
    for number, one in enumerate(structure.strings[1:]):
        k = one.stiffness
        curve = ((1e-3, 1e-3 * k), (2e-3, (4e-3 if number % 2 else 1.5e-3) * k))
        strings.append(replace(one, stiffness=None, curve=curve))
    return hung().with_(structure=replace(structure, strings=tuple(strings)))


def test_a_run_with_curves_is_that_of_the_dae_and_its_ledger_closes() -> None:
    scene = with_curves()
    run = tmj.simulate(scene, engine=JAX(rtol=1e-12, atol=1e-13), duration=0.1)
    reference = tmj.simulate(scene, engine=tmj.DAE(rtol=1e-12, atol=1e-13), duration=0.1)
    # The stated tolerances of both, ten times over, of motions of a metre and energies of ten joules.
    assert tmj.compare(run, reference).max_node_error < 2e-11
    assert run.energy_residual < 2e-10
    assert np.abs(run.tensions - reference.tensions).max() < 1e-8  # up to 4e-11 m of strings with 4 k
    straight = tmj.simulate(hung(), engine=tmj.DAE(), duration=0.1)
    assert tmj.compare(run, straight).max_node_error > 1e-3


def hanging(**given: Any) -> tmj.Scene:
    """Two masses below two nodes, on strings of 1.25 m."""
    nodes = {f"{end}{n}": (float(n), 0.0, 0.0 if end == "h" else -1.25) for n in range(2) for end in "hm"}
    strings = tuple(tmj.String(f"s{n}", (f"h{n}", f"m{n}"), **given[f"s{n}"]) for n in range(2))
    masses = tuple(tmj.PointMass(f"m{n}", 2.0) for n in range(2))
    return tmj.Scene(tmj.Structure("hanging", nodes, strings=strings, fixed_nodes=("h0", "h1"), point_masses=masses))


def model_of(scene: tmj.Scene, command: Any, actuation: Actuation, lengths: bool = False) -> Model:
    law = ArrayLaw({"command": np.array(command)}, lambda p, t, x, v: (p["command"], jnp.full(5, jnp.nan)), lengths)
    return Model(scene, [], law, actuation, 0.0)


@functools.partial(jax.jit, static_argnums=0)
def rest_lengths(model: Model, drop: Any = 0.0) -> Any:
    """L0 now, of what was sampled at the start where the law is; the first mass is lower by a drop meanwhile."""
    at = model.prepare(model.parameters)
    _, held = model.start(at)
    low = jnp.asarray(model.parameters["nodes"]).at[1, 2].add(-drop)
    at = model.prepare({**model.parameters, "nodes": low})
    places, rates = model.system.state(low, jnp.zeros_like(low))
    state = model.start(at)[0]._replace(places=places, rates=rates)
    return model.evaluate(at, 0.0, state, held, model.whole)[1].rest_lengths


def test_commands_to_curves_are_their_inverses() -> None:
    scene = hanging(s0={"curve": POINTS}, s1={"stiffness": 70.0})
    # 25 N are at a stretch of 0.15 m, 40 N first at 0.2 m; 25 N of the linear one at 25/70 m.
    always = model_of(scene, [20.0, 20.0], Actuation.continuous())
    assert np.asarray(rest_lengths(always)) == pytest.approx([1.1, 1.25 - 25 / 70], abs=1e-15)
    # 0.15 m lower u L is 28 N, at 0.16 m.
    assert float(rest_lengths(always, 0.15)[0]) == pytest.approx(1.4 - 0.16, abs=1e-15)
    held = model_of(scene, [20.0, 20.0], Actuation.hold_force_density(0.1))
    assert float(rest_lengths(held, 0.15)[0]) == pytest.approx(1.4 - 0.16, abs=1e-15)
    wound = model_of(scene, [20.0, 20.0], Actuation.hold_rest_length(0.1))
    assert float(rest_lengths(wound, 0.15)[0]) == pytest.approx(1.1, abs=1e-15)
    # A rest length of 1.1 m is a force density of 25 N / 1.25 m, which is held.
    given = model_of(scene, [1.1, 1.1], Actuation.hold_force_density(0.1), lengths=True)
    assert float(rest_lengths(given, 0.15)[0]) == pytest.approx(1.4 - 0.16, abs=1e-15)
    # A curve that stays at 30 N is held at what was commanded, which is more, not at what it gave: 24.5 N/m of 1.25 m,
    # and 29.4 N of the 1.2 m that come then, which the first piece has.
    level = hanging(s0={"curve": ((0.2, 30.0), (0.6, 30.0))}, s1={"stiffness": 70.0})
    held = model_of(level, [24.5, 20.0], Actuation.hold_force_density(0.1))
    assert float(rest_lengths(held)[0]) == pytest.approx(1.25 - 0.2, abs=1e-15)
    assert float(rest_lengths(held, -0.05)[0]) == pytest.approx(1.2 - 29.4 / 150, abs=1e-15)


@pytest.mark.parametrize("lengths", [False, True])
def test_limits_of_some_strings_leave_derivatives_of_all(lengths: bool) -> None:
    # The first may have 16 N/m: 20 N, which its curve has at 0.1 + 0.1 / 3 m. The second keeps 0.9 m.
    scene = hanging(s0={"curve": POINTS, "max_force_density": 16.0}, s1={"stiffness": 70.0, "min_rest_length": 0.9})
    model = model_of(scene, [0.5, 0.5] if lengths else [50.0, 50.0], Actuation.continuous(), lengths)
    found, slope = jax.jit(jax.value_and_grad(lambda drop: rest_lengths(model, drop).sum()))(0.0)
    assert float(found) == pytest.approx(1.25 - 0.1 - 0.1 / 3 + 0.9, abs=1e-15)
    # d(L - f⁻¹(u L))/dL = 1 - u/300 on that piece.
    assert float(slope) == pytest.approx(1 - 16 / 300, abs=1e-14)


def test_no_law_sets_a_rest_length_of_a_constant_force() -> None:
    scene = hanging(s0={"stiffness": 0.0, "tension": 15.0}, s1={"stiffness": 70.0})
    with pytest.raises(OptionError, match="string 's0' pulls with a constant force at any length"):
        tmj.simulate(scene, lambda t, x, v: np.zeros(2), engine=JAX(), duration=0.1)
