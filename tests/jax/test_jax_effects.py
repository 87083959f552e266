"""Elements of the package as array functions: against their Python, closed forms and differences."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

pytest.importorskip("jax")
pytest.importorskip("diffrax")

import jax
from linked_scenes import hanging_chain
from random_states import random_state
from soft_scenes import soft_pair

import tensegrity_mj as tmj
from tensegrity_mj.engines.jax.effects import array_effect
from tensegrity_mj.errors import ElementError
from tensegrity_mj.model import Bending, Drag, Resistance, Work

AIR = Resistance(0.7, None, Drag(1.1, 0.3, 1.2, 0.05), (0.4, -0.3, 0.2))


def damped_points() -> tmj.Scene:
    nodes = {"a": (0.0, 0.0, 0.0), "b": (1.0, 0.0, 0.0), "p": (0.0, 0.0, 1.0)}
    masses = (tmj.PointMass("p", 0.2, damping=0.3), tmj.PointMass("b", 0.1, damping=1.7))
    strings = (tmj.String("s", ("p", "a"), 10.0, 0.1, 1.0),)
    return tmj.Scene(tmj.Structure("points", nodes, (tmj.Rod("r", ("a", "b"), 1.0),), strings, (), masses))


def scenes() -> dict[str, tmj.Scene]:
    chain = hanging_chain([0.3, 0.5, 0.4], [1.0, 1.0, 1.0])
    return {
        "loads": random_state(3, False).with_(
            loads=(tmj.model.Load("a1", (1.0, -2.0, 0.5), 3.0, 0.4), tmj.model.Load("b2", (0.0, 1.0, 0.0)))
        ),
        "air": random_state(4, False).with_(resistance=AIR),
        "viscous": random_state(4, False).with_(resistance=Resistance(0.7, None, None, AIR.wind)),
        "joints": chain.with_(resistance=Resistance(0.0, Bending(3.0, 0.2))),
        "points": damped_points(),
        "elastic rods": soft_pair(),
    }


SCENES = scenes()
CASES = [
    pytest.param(name, number, id=f"{name}-{number}")
    for name, scene in SCENES.items()
    for number in range(len(scene.effects))
]


def state(scene: tmj.Scene, seed: int = 0) -> tuple[Any, Any]:
    """Random positions and velocities (N, 3, 3) with a batch of three, off by a tenth of a metre."""
    rng = np.random.default_rng(seed)
    shape = (*scene.nodes0.shape, 3)
    return scene.nodes0[..., None] + 0.1 * rng.normal(size=shape), 2.0 * rng.normal(size=shape)


def forces_of(effect: Any) -> Any:
    """(p, t, x, v) -> what an effect does to nodes: minus its gradients, and its force. Batches are last."""

    @jax.jit
    def forces(p: Any, t: Any, x: Any, v: Any) -> Any:
        out = jax.numpy.zeros_like(x)
        if effect.energy is not None:
            out -= jax.grad(lambda x: effect.energy(p, t, x).sum())(x)
        if effect.dissipation is not None:
            out -= jax.grad(lambda v: effect.dissipation(p, t, x, v).sum())(v)
        return out if effect.force is None else out + effect.force(p, t, x, v)

    return forces


@pytest.mark.parametrize(("name", "number"), CASES)
def test_forces_energies_and_what_is_given_are_those_of_the_element(name: str, number: int) -> None:
    scene, element = SCENES[name], SCENES[name].effects[number]
    effect = array_effect(element, scene)
    forces = forces_of(effect)
    x, v = state(scene)
    found = np.asarray(forces(effect.parameters, 0.7, x, v))
    for k in range(x.shape[-1]):
        wanted = element.act(scene, 0.7, x[..., k], v[..., k])
        # Sums of at most 20 rods' forces, each of some 50 operations: 50 · 2^-53 = 6e-15 of what is added up, of which
        # the largest force is a tenth at least here.
        assert np.abs(found[..., k] - wanted).max() < 1e-13 * np.abs(wanted).max()
        alone = np.asarray(forces(effect.parameters, 0.7, x[..., k], v[..., k]))
        assert np.abs(alone - wanted).max() < 1e-13 * np.abs(wanted).max()
    assert effect.gives == (element.work is Work.GIVEN)
    for which, function in (("energy", effect.energy), ("given", effect.given)):
        if function is not None:
            values = np.asarray(jax.jit(function)(effect.parameters, 0.7, *((x,) if which == "energy" else (x, v))))
            assert values.shape == (3,)
            for k in range(3):
                here = (scene, x[..., k]) if which == "energy" else (scene, 0.7, x[..., k], v[..., k])
                # 50 rounding errors of terms of one sign, or of terms ten times the sum.
                assert values[k] == pytest.approx(float(getattr(element, which)(*here)), rel=1e-13)


def test_each_kind_is_among_them() -> None:
    kinds = {type(element).__name__ for scene in SCENES.values() for element in scene.effects}
    own = ["NodalLoads", "FluidResistance", "BendingStiffness", "BendingDamping", "NodalDamping", "ElasticRods"]
    assert kinds == set(own)


def test_drag_on_a_rod_that_slides_and_spins_is_that_of_its_integrals() -> None:
    # Across itself at u: ½ ρ C_n d ℓ u², along itself: ½ ρ C_t π d ℓ u², half of each at an end. About its centre at ω:
    # the moment 2 ∫ ½ ρ C_n d (ω r)² r dr up to ℓ/2, which is ρ C_n d ω² ℓ⁴/64, by two forces ℓ apart. In round-off.
    length, density, normal, tangential, diameter = 1.6, 1.2, 1.1, 0.3, 0.05
    rod = tmj.Rod("r", ("a", "b"), 1.0)
    structure = tmj.Structure("rod", {"a": (0.0, 0.0, 0.0), "b": (length, 0.0, 0.0)}, (rod,))
    scene = tmj.Scene(structure, resistance=Resistance(drag=Drag(normal, tangential, density, diameter)))
    effect = array_effect(scene.effects[0], scene)
    forces = forces_of(effect)
    for v, wanted in (
        ([[0.0, 2.0, 0.0]] * 2, [[0.0, -0.25 * density * normal * diameter * length * 4.0, 0.0]] * 2),
        ([[-3.0, 0.0, 0.0]] * 2, [[0.25 * density * tangential * np.pi * diameter * length * 9.0, 0.0, 0.0]] * 2),
        (
            [[0.0, 0.0, -2.0 * length], [0.0, 0.0, 2.0 * length]],  # ω = 4
            [[0.0, 0.0, sign * density * normal * diameter * 16.0 * length**3 / 64] for sign in (1.0, -1.0)],
        ),
    ):
        found = forces(effect.parameters, 0.0, jax.numpy.array(structure.positions), jax.numpy.array(v))
        assert np.asarray(found) == pytest.approx(np.array(wanted), abs=1e-15)


def slope(function: Any, at: Any, way: Any) -> float:
    """The derivative of a function of a tree along a way, by differences of fourth order."""
    h = 1e-3

    def value(size: float) -> float:
        return float(function(jax.tree.map(lambda a, b: np.asarray(a + size * b), at, way)))

    return (8 * (value(h) - value(-h)) - (value(2 * h) - value(-2 * h))) / (12 * h)


@pytest.mark.parametrize(("name", "number"), CASES)
def test_derivatives_are_those_of_differences(name: str, number: int) -> None:
    scene = SCENES[name]
    effect, rng = array_effect(scene.effects[number], scene), np.random.default_rng(5)
    forces = forces_of(effect)
    x, v = state(scene, 1)
    weights = rng.normal(size=x.shape)

    @jax.jit
    def work(at: Any) -> Any:
        p, t, x, v = at
        total = (weights * forces(p, t, x, v)).sum()
        return total if effect.given is None else total + effect.given(p, t, x, v).sum()

    at = jax.tree.map(np.asarray, (effect.parameters, 0.7, x, v))
    way = jax.tree.map(lambda a: rng.normal(size=np.shape(a)), at)
    reverse = jax.tree.map(np.asarray, jax.jit(jax.grad(work))(at))
    forward = jax.jit(lambda at, way: jax.jvp(work, (at,), (way,))[1])
    # Along a way of up to 3 (metres, m/s, parameters) forces change with rates r up to 13, as spans of 0.3 m turn:
    # differences leave out (h r)⁴/30 = 1e-9 of the derivative, and 1.5 · 2e-16/h of the value.
    for part in range(4):
        here = tuple(w if k == part else jax.tree.map(np.zeros_like, w) for k, w in enumerate(way))
        terms = [np.sum(a * b) for a, b in zip(jax.tree.leaves(reverse), jax.tree.leaves(here), strict=True)]
        sizes = [np.sum(np.abs(a * b)) for a, b in zip(jax.tree.leaves(reverse), jax.tree.leaves(here), strict=True)]
        assert abs(slope(work, at, here) - sum(terms)) <= 1e-9 * sum(sizes) + 1e-12 * abs(float(work(at)))
        # Forward and reverse add up the same products, of some 100 operations, in other orders.
        assert abs(float(forward(at, here)) - sum(terms)) <= 1e-13 * sum(sizes)


def test_derivatives_exist_where_nothing_moves() -> None:
    scene = SCENES["air"].with_(resistance=Resistance(0.7, None, AIR.drag))
    effect = array_effect(next(one for one in scene.effects if one.label == "resistance"), scene)
    forces = forces_of(effect)
    x = jax.numpy.array(scene.nodes0)
    way = np.random.default_rng(1).normal(size=x.shape[-2:])

    @jax.jit
    def gradient(x: Any, v: Any) -> Any:
        return jax.grad(lambda x, v: (way * forces(effect.parameters, 0.0, x, v)).sum(), (0, 1))(x, v)

    still, alike = jax.numpy.zeros_like(x), jax.numpy.ones_like(x)
    for v in (still, alike, *(one + size * way for one in (still, alike) for size in (1e-16, 1e-80, 1e-152, 1e-160))):
        found = gradient(x, v)
        assert all(np.isfinite(part).all() for part in found)
    # At rest there is no drag, and viscous forces are linear in v: Σ_ends -c ℓ/6 (2 way + the other end's).
    at_rest = gradient(x, jax.numpy.zeros_like(x))
    pairs, lengths, wanted = scene.structure.rod_nodes, scene.structure.rod_lengths, np.zeros_like(way)
    for (i, j), length in zip(pairs, lengths, strict=True):
        wanted[i] -= 0.7 * length / 6 * (2 * way[i] + way[j])
        wanted[j] -= 0.7 * length / 6 * (2 * way[j] + way[i])
    assert np.asarray(at_rest[1]) == pytest.approx(wanted, abs=1e-14)
    assert not np.asarray(at_rest[0]).any()


@pytest.mark.parametrize("name", ["air", "points", "elastic rods", "joints", "loads"])
def test_parameters_may_have_a_batch(name: str) -> None:
    scene = SCENES[name]
    x, v = state(scene)
    scales = np.array([1.0, 0.5, 2.0])
    for element in scene.effects:
        effect = array_effect(element, scene)
        forces = forces_of(effect)
        many = jax.tree.map(lambda a: np.asarray(a)[..., None] * scales, effect.parameters)
        together = np.asarray(forces(many, 0.7, x, v))
        for k in range(3):
            one = jax.tree.map(lambda a, k=k: np.asarray(a) * scales[k], effect.parameters)
            alone = forces(one, 0.7, x[..., k], v[..., k])
            # As above, of forces of up to 100 N.
            assert together[..., k] == pytest.approx(np.asarray(alone), rel=1e-13, abs=1e-12)


def test_loads_by_a_function_are_refused_by_name() -> None:
    scene = damped_points().with_(loads=lambda t: np.zeros((3, 3)))
    with pytest.raises(ElementError, match="the loads of scene 'points' are a Python function, which arrays cannot"):
        array_effect(scene.effects[0], scene)
