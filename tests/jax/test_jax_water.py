"""Water as array functions: against the element's Python, Airy's problem, closed forms and differences."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("jax")
pytest.importorskip("diffrax")

import jax
import jax.numpy as jnp
from features import in_water
from scipy.integrate import quad

import tensegrity_mj as tmj
from tensegrity_mj.engines.jax.effects import array_effect
from tensegrity_mj.engines.jax.water import Waves, wave_number, wet_part
from tensegrity_mj.model import AboveLevel, IrregularSea, Weights, Work

G, RHO = 9.81, 1025.0
SEA = IrregularSea("jonswap", 0.8, 3.0, seed=2, components=12)
BOTH = (tmj.model.Wave(0.3, 6.0, direction=0.3, phase=0.4), tmj.model.Wave(0.2, angular_frequency=2.3, direction=2.0))


def changed(below: float, **water: Any) -> tmj.Scene:
    """`in_water`, its nodes so deep, with other water."""
    scene = in_water(below)
    return scene.with_(water=replace(scene.water, **water))


SCENES: dict[str, Callable[[], tmj.Scene]] = {
    "under water": in_water,
    "across the surface": lambda: in_water(0.1),
    "mostly in air": lambda: in_water(-0.4),
    "Hermite, with strings": lambda: changed(0.1, weights=Weights.HERMITE, string_diameter=0.1),
    "irregular sea": lambda: in_water(0.1, sea=SEA),
    "shallow, constant above": lambda: changed(0.1, depth=1.5, waves=BOTH, sea=SEA, above=AboveLevel.CONSTANT),
    "into the bottom": lambda: changed(0.5, depth=0.6),
    "own coefficients": lambda: changed(0.1, waves=BOTH, inertia=1.3, diameter=0.2, tangential_drag=0.5, segments=1),
    "still": lambda: changed(0.1, waves=(), current=(0.0, 0.0, 0.0), added_mass=0.0, drag=0.0),
    "moored_chain": lambda: tmj.load_scene("moored_chain"),
    "fish_net": lambda: tmj.load_scene("fish_net"),
    "tower_waves": lambda: tmj.load_scene("tower_waves"),
    "beam_in_waves": lambda: tmj.load_scene("beam_in_waves('TB1', 6.0)"),
}


def states(scene: tmj.Scene, count: int = 4, seed: int = 0) -> tuple[Any, Any]:
    """Random positions and velocities (N, 3, count)."""
    rng = np.random.default_rng(seed)
    shape = (*scene.nodes0.shape, count)
    return scene.nodes0[..., None] + 0.2 * rng.normal(size=shape), rng.normal(size=shape)


def loads_of(scene: tmj.Scene) -> tuple[Any, Any]:
    """The parameters of a scene's water, and (p, t, x, v) -> forces and α, compiled."""
    effect = array_effect(scene.water, scene)
    return effect.parameters, jax.jit(lambda p, t, x, v: (effect.force(p, t, x, v), effect.alpha(p, t, x)))


@pytest.mark.parametrize("name", SCENES)
def test_forces_and_added_mass_are_those_of_the_element(name: str) -> None:
    # u, the depth over ½ d cos φ >= 3 mm, has rounding errors of 2 m · 2^-53 over that, 1e-13; and the element's own
    # rule divides those of u by the step of u along a segment, which is above 1e-3 here. A segment's load is off by
    # five of these at most; the whole by 1e-12 of what is added up.
    scene = SCENES[name]()
    water = scene.water
    p, loads = loads_of(scene)
    x, v = states(scene)
    forces, alpha = (np.asarray(part) for part in loads(p, 2.7, x, v))
    for k in range(x.shape[-1]):
        wanted = water.act(scene, 2.7, x[..., k], v[..., k])
        assert np.abs(forces[..., k] - wanted).max() <= 1e-12 * np.abs(wanted).sum()
        added = water.alpha(scene, 2.7, x[..., k])
        assert np.abs(alpha[..., k] - added).max(initial=0.0) <= 1e-12 * np.abs(added).sum()
    effect = array_effect(water, scene)
    assert effect.gives == (water.work is Work.GIVEN)  # all of its work is external, so that nothing is `given` besides
    assert effect.given is effect.energy is effect.dissipation is None


def test_what_is_wet_is_the_integral_over_a_cylinder() -> None:
    def area(u: float) -> float:
        x = min(max(u, -1.0), 1.0)
        return 0.5 + (np.arcsin(x) + x * np.sqrt(1 - x * x)) / np.pi

    def integral(first: float, second: float, power: int) -> float:
        """∫ sᵖ w ds over 0 to 1: by angles, whose integrand is analytic, between u = -1 and 1, and what is beyond 1."""
        step = second - first

        def inside(angle: float) -> float:
            u = np.sin(angle)
            return float(((u - first) / step) ** power * area(u) * np.cos(angle) / step)

        between = quad(inside, *np.arcsin(np.clip((first, second), -1, 1)), epsabs=1e-15, epsrel=1e-14)[0]
        edge = min(max((1 - first) / step, 0.0), 1.0) ** (power + 1)  # from where, or up to where, all is wet
        return float(between + (1 - edge if step > 0 else edge) / (power + 1))

    rng = np.random.default_rng(3)
    cases = [(-0.3, 0.7), (-3, 5), (2, -0.5), (-1.5, -0.9), (-50, 3), (4, -4), (1.5, 2.5), (-2, -1), (-1, 1), (1, -1)]
    pairs = np.array(cases + [tuple(pair) for pair in rng.normal(size=(40, 2)) * 1.5], float)
    wet = jax.jit(wet_part)
    parts, places = (np.asarray(one) for one in wet(pairs.T))
    for (first, second), part, place in zip(pairs, parts, places, strict=True):
        # Ten rounding errors of numbers up to 1, and those of differences of u.
        margin = 2e-15 * (1 + 1 / abs(second - first))
        assert part == pytest.approx(integral(first, second, 0), abs=margin)
        assert part * place == pytest.approx(integral(first, second, 1), abs=margin)
    # All but level, and level, w is linear to within h²: to round-off, where differences of u had none left.
    for h in (0.0, 1e-15, 1e-12, 1e-9):
        u = np.linspace(-0.9, 0.9, 7)
        ends = np.stack([u - h / 2, u + h / 2])
        part, place = (np.asarray(one) for one in wet(ends))
        slope, step = 2 / np.pi * np.sqrt(1 - u * u), ends[1] - ends[0]
        assert np.asarray(part) == pytest.approx(np.array([area(one) for one in ends.mean(0)]), abs=1e-15)
        assert np.asarray(part * (place - 0.5)) == pytest.approx(slope * step / 12, abs=1e-15)
    # Across u = ±1 by h either way, w and 1 - w are 4 √2/(3 π) e^{3/2} of the depth e from there, to within e of that:
    # its mean over the segment has 1/5 of it at h, its centre is at e = 5/7 h. Round-off of 1 is 1e-4 of 4e-12.
    h = 1e-7
    part, place = (np.asarray(one) for one in wet(np.array([[-1 - h, 1 + h], [-1 + h, 1 - h]])))
    small = 4 * np.sqrt(2) / (15 * np.pi) * h**1.5
    assert part == pytest.approx([small, 1 - small], abs=1e-4 * small)
    assert place[0] == pytest.approx(6 / 7, abs=2e-4)


@pytest.mark.parametrize("depth", [None, 1.7])
def test_waves_solve_the_linear_problem_of_the_free_surface(depth: float | None) -> None:
    # ∇·v = 0 and ∇×v = 0; at the bottom v_z = 0; at z = 0, v_z = ∂ζ/∂t and ∂v/∂t = -g ∇ζ along it, which takes the
    # right dispersion; and ∂v/∂t is that of v. All to round-off of some 100 operations of sums of magnitude 10.
    frequency = np.array([[1.3], [2.9], [6.0]])
    number = wave_number(frequency, G, depth)
    if depth is not None:
        assert np.asarray(number * np.tanh(number * depth)) == pytest.approx(frequency**2 / G, rel=4e-15)
    size, way, phase = (np.array(rows)[:, None] for rows in ((0.4, 0.3, 0.1), (0.3, 2.0, -1.0), (0.0, 0.7, 1.9)))
    rows = (rows[:, None, None] for rows in (size, frequency, number, way, phase))
    waves = Waves(*rows, None if depth is None else jnp.array([depth]))

    def flow(t: Any, place: Any) -> Any:
        return waves.flow(t, *place[:, None, None, None])[:, :, 0, 0, 0]

    @jax.jit
    def fields(place: Any) -> Any:
        """∇v, ∂v/∂t by differentiation and as stated, both at a place; ∂ζ/∂t and ∇ζ above it."""
        by_place, by_time = jax.jacfwd(flow, 1)(0.8, place)[0], jax.jacfwd(flow)(0.8, place)[0]

        def elevation(t: Any, x: Any, y: Any) -> Any:
            return waves.elevation(t, *(one[None, None, None] for one in (x, y)))[0, 0, 0]

        return by_place, by_time, flow(0.8, place), jax.jacfwd(elevation, (0, 1, 2))(0.8, place[0], place[1])

    for x, y, z in np.random.default_rng(1).uniform(-1.5, 0.3, (4, 3)):
        by_place, by_time, (_, stated), _ = (np.asarray(part) for part in fields(np.array([x, y, z])))
        assert np.trace(by_place) == pytest.approx(0.0, abs=1e-13)
        assert by_place == pytest.approx(by_place.T, abs=1e-13)
        assert by_time == pytest.approx(stated, abs=1e-13)
        _, _, (velocity, gain), slopes = (np.asarray(part) for part in fields(np.array([x, y, 0.0])))
        assert velocity[2] == pytest.approx(slopes[0], abs=1e-13)
        assert gain[:2] == pytest.approx(-G * slopes[1:], abs=1e-13)
        if depth is not None:
            assert float(fields(np.array([x, y, -depth]))[2][0, 2]) == pytest.approx(0.0, abs=1e-15)


LEVEL = np.array([(0, 0, 0), (1.2, 0, 0), (0.4, 0, -0.8)])
UPRIGHT = np.array([(0.3, 0, -0.7), (0.3, 0, 0.5), (0.7, 0, -0.8)])


def slopes_of(loads: Any) -> Callable[..., list[Any]]:
    """(p, x) -> derivatives of forces by x and by velocities, at rest; those of α, too, are the same in reverse."""

    def both(p: Any, x: Any, v: Any) -> Any:
        return [jacobian(lambda at: loads(p, 0.0, *at), 0)((x, v)) for jacobian in (jax.jacfwd, jax.jacrev)]

    compiled = jax.jit(both)

    def slopes(p: Any, x: Any) -> list[Any]:
        forward, reverse = compiled(p, x, np.zeros(x.shape))
        for one, other in zip(jax.tree.leaves(forward), jax.tree.leaves(reverse), strict=True):
            assert np.isfinite(one).all()
            assert np.asarray(one) == pytest.approx(np.asarray(other), abs=1e-12 * max(1.0, np.abs(one).max()))
        return [np.asarray(part) for part in forward[0]]

    return slopes


@pytest.fixture(scope="module")
def rod() -> tuple[Any, Any]:
    """A level rod of 1.2 m by 0.1 m with a string below it; parameters of still water, and `slopes_of` all that."""
    nodes = dict(zip("abc", LEVEL.tolist(), strict=True))
    rods, strings = (tmj.Rod("r", ("a", "b"), 3.0, 0.05),), (tmj.String("s", ("a", "c"), 1.0, 0.0, 1.0),)
    structure = tmj.Structure("rod", nodes, rods, strings, (), (tmj.PointMass("c", 1.0),))
    water = tmj.Water(RHO, waves=(tmj.model.Wave(0.3, 0.5),), segments=3, string_diameter=0.02)
    p, loads = loads_of(tmj.Scene(structure, gravity=(0.0, 0.0, -G), water=water))
    return {**p, "waves": {**p["waves"], "amplitude": np.zeros(1)}}, slopes_of(loads)


def test_derivatives_in_the_surface_are_those_of_hydrostatics(rod: Any) -> None:
    # A level rod in the surface has the stiffness ρ g d ℓ (2, 1; 1, 2)/6 of its waterplane, whatever its segments are:
    # the centre of each wet part makes its moment exact. At rest no drag has a slope.
    still, slopes = rod
    by_place, by_speed = slopes(still, LEVEL)
    stiffness = RHO * G * 0.1 * 1.2 / 6 * np.array([[2, 1, 0], [1, 2, 0], [0, 0, 0]])
    assert -by_place[:, 2, :, 2] == pytest.approx(stiffness, rel=1e-12)
    assert not by_speed.any()
    # The waterplane of an upright one is a circle. It is wet to within 1e-6 of the radius, by the least cosine.
    by_place, by_speed = slopes(still, UPRIGHT)
    assert -by_place[:, 2, :, 2].sum() == pytest.approx(RHO * G * np.pi * 0.05**2, rel=1e-9)
    assert not by_speed.any()


@pytest.mark.parametrize("height", [-0.05, 0.05, 2.0, 1e4], ids=["just under", "just above", "in air", "far above"])
def test_derivatives_exist_at_kinks_and_where_all_is_dry(rod: Any, height: float) -> None:
    # At u = ±1 the waterplane has no width. Far above, fields of the wave are beyond all floats.
    still, slopes = rod
    rough = {**still, "waves": {**still["waves"], "amplitude": np.full(1, 0.3)}}
    by_place, by_speed = slopes(still if abs(height) < 1 else rough, LEVEL + np.array([0, 0, height]))
    assert not by_place[:, 2, :, 2].any()
    assert not by_speed.any()


def test_derivatives_exist_where_the_ends_of_a_string_meet(rod: Any) -> None:
    still, slopes = rod
    slopes({**still, "current": np.ones(3)}, LEVEL[[0, 1, 0]] - np.array([0, 0, 2]))


def everything() -> tmj.Scene:
    water = {"depth": 3.5, "waves": BOTH, "sea": SEA, "inertia": 1.3, "diameter": 0.1, "string_diameter": 0.07}
    return changed(1.5, tangential_drag=0.5, segments=3, **water)


def test_derivatives_are_those_of_differences() -> None:
    scene, rng = everything(), np.random.default_rng(4)
    p, loads = loads_of(scene)
    x = {"deep": scene.nodes0, "at the surface": scene.nodes0 + np.array([0.0, 0.0, 1.3])}
    v, t = rng.normal(size=scene.nodes0.shape), 0.7
    weights = jax.tree.map(lambda part: rng.normal(size=part.shape), jax.eval_shape(loads, p, t, v, v))

    @jax.jit
    def total(at: Any) -> Any:
        return sum((one * weight).sum() for one, weight in zip(loads(*at), weights, strict=True))

    gradient = jax.jit(jax.grad(total))
    # Under water, loads change at rates r of up to 10 along a way of a metre, as its shortest waves are of k = 7 /m:
    # differences leave out (r h)⁴/30. At the surface the derivatives of w have no derivatives at u = ±1, and steps are
    # as short as round-off lets them be.
    for name, h in (("deep", 1e-3), ("at the surface", 1e-5)):
        at = jax.tree.map(np.asarray, (p, t, x[name], v))
        leaves, tree = jax.tree.flatten(at)
        size = sum(np.abs(one * weight).sum() for one, weight in zip(loads(*at), weights, strict=True))
        found = jax.tree.leaves(gradient(at))
        for number, (leaf, slopes) in enumerate(zip(leaves, found, strict=True)):
            way = rng.choice([-1.0, 1.0], leaf.shape) * np.maximum(np.abs(leaf), 0.1)

            beside = []
            for steps in (-2, -1, 1, 2):
                moved = [*leaves[:number], leaf + steps * h * way, *leaves[number + 1 :]]
                beside.append(float(total(jax.tree.unflatten(tree, moved))))
            differences = np.dot(beside, (1, -8, 8, -1)) / (12 * h)
            terms = np.asarray(slopes) * way
            assert abs(differences - terms.sum()) <= 1e-9 * np.abs(terms).sum() + 1e-14 / h * size, (name, number)


def test_batches_of_states_and_parameters_are_one_after_another() -> None:
    scene = everything()
    p, loads = loads_of(scene)
    x, v = states(scene, 3)
    x, scales = x + np.array([0.0, 0.0, 1.3])[:, None], np.array([1.0, 0.8, 1.2])
    many = jax.tree.map(lambda value: value[..., None] * scales, p)
    together = loads(many, 0.7, x, v)
    for k in range(3):
        alone = loads(jax.tree.map(lambda value, k=k: value * scales[k], p), 0.7, x[..., k], v[..., k])
        for part, wanted in zip(together, alone, strict=True):
            assert np.abs(part[..., k] - wanted).max() <= 1e-13 * np.abs(wanted).sum()  # sums in other orders
