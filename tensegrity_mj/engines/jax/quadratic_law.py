"""The laws of chapters 5 and 6 of the thesis as array functions.

V of (5.19) and (6.3) is stated as a function of time, positions and velocities, and its derivatives are automatic:
along the motion without strings V̇ is β, and the gradient by velocities, through how rods answer forces, is f of
V̇ = β - fᵀu.

The smallest u with vᵀu = α between thresholds and ceilings, as array functions: Lemma 5.1 with bounds.

With α' = α - vᵀū left to do above the thresholds ū, and w = v sign(α'), only strings with w > 0 help. The optimum of
norms 2 and ∞ is u = min(max(ū, μ g), c) with g = w or g = 1: what it gives grows with μ by pieces, so that between
which of their ends μ lies also says which strings have reached their bounds, and μ follows from the others. Derivatives
are those of that solution: right but where a string reaches its bound, or another becomes the best of norm 1.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.dynamics.native.law import check_made_for
from tensegrity_mj.engines.jax.arrays import ArrayLaw, Arrays, derivatives, lifted, settled
from tensegrity_mj.engines.jax.nominal_model import NominalModel, ceilings
from tensegrity_mj.model.structure import Structure


def quadratic_law(law: Any, structure: Structure) -> ArrayLaw:
    """The array function of a law of `controllers.quadratic_law`, for a plant of its nodes and strings.

    Its parameters are `decay_rate`, the gains `translation` and `rotation` with X, Y and Z, of the law of chapter 6
    `stiffness`, `minimum_force_density` (M,) where there are thresholds or ceilings, and those of its `NominalModel`. A
    gain is one number where it is the same for all and in all directions, (R,) where it is in all directions; else
    (R, 3, 3).

    Raises:
        OptionError: for another plant.
        ElementError: where it accounts for an element that has no array function.
    """
    check_made_for(law.structure, structure)
    nominal = NominalModel(law)
    P, R = len(nominal.sizes), len(structure.rods)
    onto = None if law.projected_onto is None else law.projected_onto.value
    z_gains = {name: _gain(law.gains[f"{name}z"], nominal.sizes) for name in "XYZ"}
    b_gains = {name: _gain(law.gains[f"{name}b"][:R], np.full(R, 3)) for name in "XYZK"}
    limits = law.limits
    capped = np.isfinite(limits.max_force_density) | np.isfinite(limits.min_rest_length)
    bounded = bool(np.any(law.floor > 0.0) or np.any(capped))
    parameters: dict[str, Any] = {
        "decay_rate": float(law.decay_rate),
        "translation": z_gains,
        "rotation": {name: b_gains[name] for name in "XYZ"},
        **nominal.parameters,
    }
    if onto is not None:
        parameters["stiffness"] = b_gains["K"]
    if bounded:
        parameters["minimum_force_density"] = np.array(law.floor)

    def value(p: Arrays, q: Any, rates: Any, aim: Any, aim_rates: Any) -> tuple[Any, tuple[Any, Any]]:
        """V (...), and its parts, of the errors alone and with velocities, of places (P + R, 3, ...) and rates."""
        e, e_rates = q - aim, rates - aim_rates
        across = e[P:]
        if onto is not None:
            axis = (q if onto == "current" else aim)[P:]
            across = across - axis * (jnp.sum(axis * across, axis=1) / jnp.sum(axis * axis, axis=1))[:, None]
        error = velocity = 0.0
        blocks = ((p["translation"], z_gains, e[:P], e_rates[:P]), (p["rotation"], b_gains, across, e_rates[P:]))
        for gains, own, e_own, rate in blocks:
            Xe, Ye, Ze = (_scaled(gains[n], own[n], a) for n, a in (("X", e_own), ("Y", rate), ("Z", rate)))
            error += 0.5 * jnp.sum(e_own * Xe, axis=(0, 1))
            velocity += jnp.sum(e_own * Ye + 0.5 * rate * Ze, axis=(0, 1))
        if onto is not None:
            error += 0.5 * jnp.sum(e[P:] * _scaled(p["stiffness"], b_gains["K"], e[P:]), axis=(0, 1))
        return error + velocity, (error, velocity)

    def command(p: Arrays, t: Any, x: Any, v: Any) -> tuple[Any, Any]:
        q, rates = nominal.places(x), nominal.places(v)
        aim, aim_rates, changes = (
            jnp.broadcast_to(lifted(one, q), q.shape) for one in derivatives(lambda t: nominal.aim(p["target"], t), t)
        )
        V, back, (error, velocity) = jax.vjp(lambda *at: value(p, *at), q, rates, aim, aim_rates, has_aux=True)
        by_q, by_rates, *by_aims = back(jnp.ones_like(V))
        lengths, along = nominal.motion(p, t, x, v)
        drift, work = along(by_rates)
        pairs = ((by_q, rates), *zip(by_aims, (aim_rates, changes), strict=True))
        beta = drift + sum(jnp.sum(slope * change, axis=(0, 1)) for slope, change in pairs)
        f, alpha = -settled(work), beta + p["decay_rate"] * V
        if not bounded and law.norm == 2:
            u, margin = least_squares(f, alpha)
        else:
            floor = lifted(p["minimum_force_density"], f) if bounded else jnp.zeros_like(f)
            u, margin = least_norm(
                f, alpha, floor, jnp.where(lifted(capped, f), ceilings(limits, lengths), 0.0), capped, law.norm
            )
        return settled(u), jnp.stack([margin, V, error, velocity, jnp.full_like(V, jnp.nan)])

    return ArrayLaw(parameters, command)


def _gain(matrices: Array, sizes: Array) -> Any:
    """Gains (R, 3, 3) as one number, (R,) or as they are, see `quadratic_law`; beyond a block's size nothing counts."""
    numbers = matrices[:, 0, 0]
    for matrix, number, size in zip(matrices, numbers, sizes, strict=True):
        if not np.array_equal(matrix[:size, :size], number * np.eye(size)):
            return np.array(matrices)
    used = numbers[sizes > 0]
    if len(used) == 0 or np.all(used == used[0]):
        return float(used[0]) if len(used) else 0.0
    return np.array(numbers)


def _scaled(gain: Any, own: Any, vectors: Any) -> Any:
    """A gain times vectors (R, 3, ...); `own` is it as it was built, without a batch."""
    if np.ndim(own) == 0:
        return gain * vectors
    if np.ndim(own) == 1:
        return lifted(gain, vectors[:, 0])[:, None] * vectors
    return jnp.einsum("rij...,rj...->ri...", lifted(gain, vectors[:, None]), vectors)


def least_squares(v: Any, alpha: Any) -> tuple[Any, Any]:
    """Return u (M, ...) of least norm 2 without bounds, and the margin max(v/α) (...); 0 where that is not positive."""
    w = jnp.where(alpha > 0.0, v, -v)
    need, best = jnp.abs(alpha), jnp.max(w, axis=0)
    solved = (best > 0.0) & (need > 0.0)
    helpful = jnp.where(w > 0.0, w, 0.0)
    u = jnp.where(solved, need * helpful / jnp.where(solved, jnp.sum(helpful**2, axis=0), 1.0), 0.0)
    return u, jnp.where(need > 0.0, best / jnp.where(need > 0.0, need, 1.0), jnp.inf)


def least_norm(v: Any, alpha: Any, floor: Any, ceiling: Any, capped: Any, norm: float) -> tuple[Any, Any]:
    """Return u (M, ...) of least norm 1, 2 or ∞, and the feasibility margin (...); u = ū where that is not positive.

    Args:
        v: (M, ...).
        alpha: (...).
        floor, ceiling: (M, ...), ū and c; ceilings count where `capped` (M,), and shall be finite everywhere.
        capped: (M,), which strings have a ceiling.
        norm: 1, 2 or math.inf.
    """
    capped = capped.reshape(capped.shape + (1,) * (v.ndim - 1))
    rest = alpha - jnp.sum(v * floor, axis=0)
    w, need = jnp.where(rest > 0.0, v, -v), jnp.abs(rest)
    helps = w > 0.0
    room = jnp.where(capped, ceiling - floor, 0.0)
    capacity = jnp.sum(jnp.where(helps, w, 0.0) * room, axis=0)
    endless = jnp.any(helps & ~capped, axis=0)
    some = jnp.where(need > 0.0, need, 1.0)
    best = jnp.max(w, axis=0) / some
    scarce = (best > 0.0) & ~endless & (capacity < 2.0 * need)
    margin = jnp.where(need > 0.0, jnp.where(scarce, best * (capacity / some - 1.0), best), jnp.inf)
    margin = jnp.where(jnp.any(room < 0.0, axis=0), -jnp.inf, margin)
    if norm == 1.0:
        u = _least_sum(w, need, floor, room, capped)
    elif norm == 2.0:
        u = _fill(w, w, need, floor, ceiling, capped)
    else:
        highest = jnp.max(floor, axis=0)
        level = jnp.where(capped, jnp.minimum(highest, ceiling), highest)
        slack = jnp.sum(jnp.where(helps, w * (level - floor), 0.0), axis=0)
        # Below the highest threshold the level is not unique: the part of the way there that suffices.
        part = need / jnp.where(slack > 0.0, slack, 1.0)
        low = jnp.where(helps, floor + (level - floor) * part, floor)
        u = jnp.where(need <= slack, low, _fill(w, jnp.ones_like(w), need, floor, ceiling, capped))
    return jnp.where((margin > 0.0) & (need > 0.0), u, floor), margin


def _fill(w: Any, g: Any, need: Any, floor: Any, ceiling: Any, capped: Any) -> Any:
    """Return u = min(max(ū, μ g), c) of the strings with w > 0, with wᵀ(u - ū) = need."""
    helps = w > 0.0
    g = jnp.where(helps, g, 1.0)
    rises, stops = floor / g, jnp.where(capped, ceiling / g, jnp.inf)
    ends = jnp.concatenate([rises, jnp.where(capped, stops, 0.0)])  # (2M, ...)
    lift = jnp.clip(ends[:, None], rises, stops) - rises  # (2M, M, ...): of string i where μ is at end k
    given = jnp.sum(jnp.where(helps, w * g * lift, 0.0), axis=1)
    mu = jax.lax.stop_gradient(jnp.max(jnp.where((given < need) & (ends > 0.0), ends, 0.0), axis=0))
    full = helps & (stops <= mu)
    moving = helps & (rises <= mu) & ~full
    slope = jnp.sum(jnp.where(moving, w * g, 0.0), axis=0)
    left = need + jnp.sum(jnp.where(moving, w * floor, 0.0) - jnp.where(full, w * (ceiling - floor), 0.0), axis=0)
    mu = jnp.where(slope > 0.0, left / jnp.where(slope > 0.0, slope, 1.0), mu)
    return jnp.where(moving, mu * g, jnp.where(full, ceiling, floor))


def _least_sum(w: Any, need: Any, floor: Any, room: Any, capped: Any) -> Any:
    """The most effective strings first, each up to its ceiling; of equal ones the first."""
    helps = w > 0.0
    order = jnp.arange(len(w)).reshape((-1,) + (1,) * (w.ndim - 1))
    ahead = helps & ((w > w[:, None]) | ((w == w[:, None]) & (order < order[:, None])))  # (M, M, ...)
    before = jnp.sum(jnp.where(ahead, w * room, 0.0), axis=1)
    left = jnp.where(jnp.any(ahead & ~capped, axis=1), 0.0, need - before)
    lift = jnp.maximum(left, 0.0) / jnp.where(helps, w, 1.0)
    return jnp.where(helps, floor + jnp.where(capped, jnp.minimum(lift, room), lift), floor)
