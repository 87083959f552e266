"""Feedback linearization of chapter 4 of the thesis as an array function.

Its coordinates are functions of the nodes, and the rates and accelerations of these are derivatives along the motion:
q̈ is linear in the force densities, and the law demands q̈ = q̈_d - K_d ė - K_p e of it, (4.6)-(4.9), with the u of least
cost.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.dynamics.native.law import Report, check_made_for
from tensegrity_mj.engines.jax.arrays import ArrayLaw, Arrays, derivatives, mapped, norm
from tensegrity_mj.engines.jax.belief import Belief, ceilings
from tensegrity_mj.engines.jax.quadratic_program import least_cost
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.structure import Structure

ROUND_OFF = 8 * float(np.finfo(float).eps)  # of K_p times a coordinate: a smaller demand is none
POLE = 1e-6  # sin φ below which θ and φ say nothing


def linearizing_law(law: Any, structure: Structure) -> ArrayLaw:
    """The array function of `controllers.FeedbackLinearization`, for a plant of its nodes and strings.

    Its parameters are `natural_frequency`, `damping`, `weight` and `minimum_force_density` as numbers or arrays,
    `sums` (L,), and those of its `Belief`.

    Raises:
        OptionError: for a full weight H, a linear objective, what is done where there is no solution but to stop, and
            for another plant.
        ElementError: where it accounts for an element that has no array function.
    """
    check_made_for(law.structure, structure)
    allocation, allocator = law.allocation, law.allocator
    if allocation.linear is not None:
        raise OptionError("linear: the differentiable engine has no array function of the least fᵀu; use weight")
    if allocator.weight.ndim == 2:
        raise OptionError("weight: the differentiable engine's allocation takes the diagonal of H, not a full matrix")
    if allocation.on_infeasible.value != "stop":
        raise OptionError(
            f"on_infeasible = {allocation.on_infeasible}: in the differentiable engine a law stops where it has no "
            "solution (WhenInfeasible.STOP): there are no derivatives beyond"
        )
    belief = Belief(law)
    coordinates = Coordinates(law.structure, belief.sizes)
    limits, rows, M = allocator.limits, allocator.sum_rows, len(structure.strings)
    parameters = {
        "natural_frequency": np.array(law.natural_frequency, float),
        "damping": np.array(law.damping, float),
        "weight": np.array(allocation.weight, float),
        "minimum_force_density": np.array(allocation.minimum_force_density, float),
        "sums": np.array(allocator.sum_values),
        **belief.parameters,
    }

    def q_of(places: Any) -> Any:
        return coordinates(places)[0]

    def command(p: Arrays, t: Any, x: Any, v: Any) -> tuple[Any, Any]:
        t, places, rates = jnp.asarray(t, float), belief.places(x), belief.places(v)
        (q, sine), (q_d, sine_d) = coordinates(places), coordinates(belief.aim(p["target"], t))
        _, q_rate, curved = derivatives(lambda s: q_of(places + s * rates), 0.0)
        _, rate_d, acceleration_d = derivatives(lambda t: q_of(belief.aim(p["target"], t)), t)
        e = q - q_d
        e = jnp.where(coordinates.turns, e - 2 * jnp.pi * jnp.round(jax.lax.stop_gradient(e) / (2 * jnp.pi)), e)
        omega = p["natural_frequency"]
        lengths, along = belief.motion(p, t, x, v)
        drift, A = jax.vmap(along)(jax.jacrev(q_of)(places))
        d = acceleration_d - 2 * p["damping"] * omega * (q_rate - rate_d) - omega**2 * e - curved - drift
        d = jnp.where(jnp.abs(d) <= ROUND_OFF * omega**2 * (jnp.abs(q) + jnp.abs(q_d)), 0.0, d)
        hi = ceilings(limits, lengths)
        lo = jnp.minimum(p["minimum_force_density"] * jnp.ones(M), hi)
        u, violation = least_cost(p["weight"] * jnp.ones(M), A, d, jnp.asarray(rows), p["sums"], lo, hi)
        defined = jnp.minimum(jnp.min(sine, initial=1.0), jnp.min(sine_d, initial=1.0)) > POLE
        report = jnp.full(len(Report), jnp.nan).at[Report.ALLOCATION_RESIDUAL].set(violation)
        return jnp.where(defined, u, jnp.nan), report

    return ArrayLaw(parameters, mapped(command, parameters))


class Coordinates:
    """q of §2.3, of places (P + R, 3), see `Belief`: every rod's z and angles, then every point mass' z.

    Attributes:
        turns: (n,), which of them go round.
    """

    def __init__(self, structure: Structure, sizes: Array) -> None:
        supports, P, R = [rod.support for rod in structure.rods], len(sizes), len(structure.rods)
        self._planar = np.array([one.plane is not None for one in supports], bool)
        B = [one.rotation_basis if one.plane is not None else np.eye(3) for one in supports]
        self._axes = np.array([one[:, :2] for one in B]).reshape(-1, 3, 2)
        # Rows of points with their z, θ and φ; those that are none have no place in q.
        places = np.arange(5 * P).reshape(P, 5)
        used = np.concatenate([np.arange(3) < sizes[:, None], np.zeros((P, 2), bool)], axis=1)
        used[:R, 3], used[:R, 4] = True, ~self._planar
        self._order = places[used]
        self.turns = self._order % 5 == 3

    def __call__(self, places: Any) -> tuple[Any, Any]:
        """q (n,), and sin φ (R,), 1 of planar rods."""
        z, spans = jnp.split(places, [len(places) - len(self._axes)])
        b = jnp.einsum("rxk,rx->rk", self._axes, spans)
        across, length = norm(b), norm(spans)
        angles = jnp.stack([jnp.arctan2(b[:, 1], b[:, 0]), jnp.arctan2(across, spans[:, 2])], axis=1)
        angles = jnp.concatenate([angles, jnp.zeros((len(z) - len(spans), 2))])
        q = jnp.concatenate([z, angles], axis=1).reshape(-1)[self._order]
        return q, jnp.where(self._planar, 1.0, across / length)
