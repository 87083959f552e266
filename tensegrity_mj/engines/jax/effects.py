"""The elements of the package as array functions: all that acts on nodes except strings, gravity and water.

Formulas are those of `model.elements`, derived again from the words there: what has a potential states it, and its
forces come by differentiation. Functions (element, scene) -> `ArrayEffect`; see `array_effects`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.engines.jax.arrays import ArrayEffect, incidence, lifted, norm, times
from tensegrity_mj.errors import ElementError
from tensegrity_mj.model.capabilities import FUNCTION_LOADS
from tensegrity_mj.model.elements.elastic_rods import ElasticRods
from tensegrity_mj.model.elements.element import Element, Work, named_function
from tensegrity_mj.model.elements.resistance import (
    Bending,
    BendingDamping,
    BendingStiffness,
    FluidResistance,
    NodalDamping,
    bending_joints,
    nodal_damping,
)
from tensegrity_mj.model.events import NodalLoads
from tensegrity_mj.model.rods import diameters
from tensegrity_mj.model.scene import Scene


def array_effects(scene: Scene) -> list[ArrayEffect]:
    """Array functions of all that acts on the nodes of a scene (`Scene.effects`), in that order.

    Raises:
        ElementError: for an element without an array function, or whose function fails or returns something else.
    """
    return [array_effect(element, scene) for element in scene.effects]


def array_effect(element: Element, scene: Scene) -> ArrayEffect:
    """One element of a scene, by the function that its `arrays` names; `gives` is set by its `work`.

    Raises:
        ElementError: see `array_effects`.
    """
    what = f"element {element.label}"
    if not element.arrays:
        raise ElementError(
            f"{what} has no array function: name one in its attribute `arrays` (docs/elements.md), or take another "
            "engine"
        )
    effect = named_function(element, "arrays")(element, scene)
    if not isinstance(effect, ArrayEffect):
        raise ElementError(f"{what}: {element.arrays} returned {effect!r}; it must return an ArrayEffect")
    if (element.work is Work.STORED) == (effect.energy is None):
        raise ElementError(
            f"{what}: work = {element.work}; arrays of an element that stores its work have an energy, and no others"
        )
    N, R = len(scene.structure.nodes), len(scene.structure.rods)
    shapes = {"energy": (), "dissipation": (), "force": (N, 3), "given": (), "alpha": (R, 2, 2)}
    for name, shape in shapes.items():
        function = getattr(effect, name)
        for batch in ((), (2,)) if function is not None else ():
            state = [jax.ShapeDtypeStruct((N, 3, *batch), float)] * (1 if name in ("energy", "alpha") else 2)
            try:
                found = jax.eval_shape(function, effect.parameters, jax.ShapeDtypeStruct((), float), *state).shape
            except Exception as error:
                raise ElementError(f"{what}: {name} of its arrays failed: {type(error).__name__}: {error}") from error
            if found != (*shape, *batch):
                raise ElementError(
                    f"{what}: {name} of its arrays returned shape {found} for positions {(N, 3, *batch)}; it must "
                    f"return {(*shape, *batch)}, batches last"
                )
    return replace(effect, gives=element.work is Work.GIVEN)


def loads(element: NodalLoads, scene: Scene) -> ArrayEffect:
    """Forces f(t) = force · cos(ω t + phase) of every load; of a function in Python, ElementError."""
    if callable(scene.loads):
        raise ElementError(
            f"{FUNCTION_LOADS.find(scene)}, which arrays cannot call: give `Load`s, an element with array functions "
            "(docs/elements.md), or take another engine"
        )
    index = scene.structure.node_index
    at = np.eye(len(index))[:, [index[load.node] for load in scene.loads]]
    parameters = {
        "force": np.array([load.force for load in scene.loads]),
        "angular_frequency": np.array([load.angular_frequency for load in scene.loads]),
        "phase": np.array([load.phase for load in scene.loads]),
    }

    def force(p: Any, t: Any, x: Any, v: Any) -> Any:
        frequency, phase = (lifted(p[name], x[:, 0]) for name in ("angular_frequency", "phase"))
        return jnp.zeros_like(x) + times(at, lifted(p["force"], x) * jnp.cos(frequency * t + phase)[:, None])

    return ArrayEffect(parameters, force=force)


def fluid_resistance(element: FluidResistance, scene: Scene) -> ArrayEffect:
    """Viscous forces as a potential of dissipation, drag as forces: ½ρ C |u| u has one, but its quadrature has none."""
    structure, resistance = scene.structure, element.resistance
    pairs, lengths, count = structure.rod_nodes, structure.rod_lengths, len(structure.nodes)
    first, second, across = np.eye(count)[pairs[:, 0]], np.eye(count)[pairs[:, 1]], incidence(pairs, count)
    parameters: dict[str, Any] = {"viscous": resistance.viscous, "wind": np.array(resistance.wind)}
    drag = resistance.drag
    if drag is not None:
        parameters["drag"] = {"normal": drag.normal, "tangential": drag.tangential, "density": drag.density}
        parameters["drag"]["diameter"] = diameters(structure, drag.diameter)

    def slips(p: Any, v: Any) -> tuple[Any, Any]:
        wind = lifted(p["wind"], v[0])
        return times(first, v) - wind, times(second, v) - wind

    def dissipation(p: Any, t: Any, x: Any, v: Any) -> Any:
        # ∫ ½ c |u|² ds over a rod, along which u runs linearly from u1 to u2.
        u1, u2 = slips(p, v)
        squares = jnp.sum(u1 * u1 + u1 * u2 + u2 * u2, axis=1)
        return p["viscous"] / 6 * jnp.sum(lifted(lengths, x[:, 0]) * squares, axis=0)

    def force(p: Any, t: Any, x: Any, v: Any) -> Any:
        own = p["drag"]
        surface = 0.5 * own["density"] * lifted(lengths, x[:, 0]) * lifted(own["diameter"], x[:, 0])
        normal, tangential = own["normal"] * surface, np.pi * own["tangential"] * surface
        at_first, at_second = _drag(normal, tangential, times(across, x), *slips(p, v))
        return times(first.T, at_first) + times(second.T, at_second)

    def given(p: Any, t: Any, x: Any, v: Any) -> Any:
        u1, u2 = slips(p, v)
        total = -0.5 * p["viscous"] * jnp.sum(lifted(lengths, x[:, 0])[:, None] * (u1 + u2), axis=0)
        if drag is not None:
            total = total + jnp.sum(force(p, t, x, v), axis=0)
        return jnp.sum(lifted(p["wind"], x[0]) * total, axis=0)

    return ArrayEffect(parameters, dissipation=dissipation, force=None if drag is None else force, given=given)


_RULE = 0.5 * np.array(np.polynomial.legendre.leggauss(5)) + np.array([[0.5], [0.0]])  # points and weights on [0, 1]


def _drag(normal: Any, tangential: Any, spans: Any, u1: Any, u2: Any) -> tuple[Any, Any]:
    """Forces (R, 3, ...) on both ends of rods of such factors (R, ...) [N s²/m²], whose ends slip by u1 and u2.

    With u⊥ = p + s q at s from 0 to 1, |u⊥| is smallest at s = -p·q / q², where the rule of five points is split.
    """
    along = spans / norm(spans)[:, None]

    def across(u: Any) -> Any:
        return u - jnp.sum(u * along, axis=1, keepdims=True) * along

    p, q = across(u1), across(u2 - u1)
    nearest, square = -jnp.sum(p * q, axis=1), jnp.sum(q * q, axis=1)
    # Below the root of the least number 1/q⁴, of the derivative, has none.
    inside = (nearest > 0.0) & (nearest < square) & (square > jnp.finfo(square.dtype).tiny ** 0.5)
    split = jnp.where(inside, nearest / jnp.where(inside, square, 1.0), jnp.where(nearest > 0.0, 1.0, 0.0))
    points, shares = _RULE.reshape(2, 5, *(1,) * split.ndim)
    s = jnp.concatenate([points * split, split + points * (1.0 - split)])
    weights = jnp.concatenate([shares * split, shares * (1.0 - split)])
    u = p + s[:, :, None] * q
    pulls = -(weights * normal * norm(u, 2))[:, :, None] * u
    on_first, on_second = (jnp.sum(part[:, :, None] * pulls, axis=0) for part in (1.0 - s, s))
    slip = 0.5 * jnp.sum((u1 + u2) * along, axis=1)
    both = -0.5 * (tangential * jnp.abs(slip) * slip)[:, None] * along
    return on_first + both, on_second + both


def bending_stiffness(element: BendingStiffness, scene: Scene) -> ArrayEffect:
    """Energy ½ κ ‖e‖² of every joint."""
    bend = _bend(scene, element.bending)

    def energy(p: Any, t: Any, x: Any) -> Any:
        return 0.5 * p["stiffness"] * jnp.sum(times(bend, x) ** 2, axis=(0, 1))

    return ArrayEffect({"stiffness": element.bending.stiffness}, energy)


def bending_damping(element: BendingDamping, scene: Scene) -> ArrayEffect:
    """Dissipation potential ½ γ ‖ė‖² of every joint."""
    bend = _bend(scene, element.bending)

    def dissipation(p: Any, t: Any, x: Any, v: Any) -> Any:
        return 0.5 * p["damping"] * jnp.sum(times(bend, v) ** 2, axis=(0, 1))

    return ArrayEffect({"damping": element.bending.damping}, dissipation=dissipation)


def _bend(scene: Scene, bending: Bending) -> Array:
    """Matrix (J, N) from positions to e = d_a - d_b of each joint; of rigid rods, whose unit vectors are spans / ℓ."""
    structure = scene.structure
    joints, nodes = bending_joints(structure, bending), np.eye(len(structure.nodes))
    outer, joint, other = nodes[np.array([one.nodes for one in joints]).T]
    a, b = structure.rod_lengths[np.array([one.rods for one in joints]).T]
    return np.asarray((joint - outer) / a[:, None] - (other - joint) / b[:, None])


def nodal_damping_of(element: NodalDamping, scene: Scene) -> ArrayEffect:
    """Dissipation potential ½ c |v|² of every point mass that is damped."""
    rows, factors = nodal_damping(scene.structure)
    at = np.eye(len(scene.structure.nodes))[rows]

    def dissipation(p: Any, t: Any, x: Any, v: Any) -> Any:
        return 0.5 * jnp.sum(lifted(p["damping"], v[:, 0]) * jnp.sum(times(at, v) ** 2, axis=1), axis=0)

    return ArrayEffect({"damping": factors}, dissipation=dissipation)


def elastic_rods(element: ElasticRods, scene: Scene) -> ArrayEffect:
    """Stored energy ½ k (L - ℓ)², and dissipation potential ½ c (dL/dt)², of every elastic rod."""
    structure = scene.structure
    rows = np.flatnonzero(structure.elastic)
    across = incidence(structure.rod_nodes[rows], len(structure.nodes))
    parameters = {
        "stiffness": structure.rod_stiffness[rows],
        "damping": np.array([structure.rods[row].damping for row in rows], float),
        "length": structure.rod_lengths[rows],
    }

    def energy(p: Any, t: Any, x: Any) -> Any:
        stretch = norm(times(across, x)) - lifted(p["length"], x[:, 0])
        return 0.5 * jnp.sum(lifted(p["stiffness"], x[:, 0]) * stretch**2, axis=0)

    def dissipation(p: Any, t: Any, x: Any, v: Any) -> Any:
        spans = times(across, x)
        rates = jnp.sum(spans * times(across, v), axis=1) / norm(spans)
        return 0.5 * jnp.sum(lifted(p["damping"], x[:, 0]) * rates**2, axis=0)

    return ArrayEffect(parameters, energy, dissipation)
