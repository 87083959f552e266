"""The laws of chapters 4, 5 and 6 of the thesis as array functions.

Coordinates of the feedback linearization of chapter 4 are functions of the nodes, and their rates and accelerations are
derivatives along the motion: q̈ is linear in the force densities, and the law demands q̈ = q̈_d - K_d ė - K_p e of it,
(4.6)-(4.9), with the u of least cost: quadratic programs of force densities, (4.10)-(4.13) of the thesis.

    minimise ½ uᵀHu   subject to   A u = d,   S u >= s,   lo <= u <= hi,   H diagonal

A primal-dual interior-point method finds which strings lie between their bounds and which sums are at theirs. With G
and b the equations and these sums, and the others' u at their bounds, the strings F between them are
u_F = H_F⁻¹ G_Fᵀ y with G_F H_F⁻¹ G_Fᵀ y = b - G_N u_N: that is the answer, and it alone is differentiated. So
derivatives are exact but where a string meets or leaves a bound, or a sum its least value.

V of chapters 5 and 6, (5.19) and (6.3), is stated as a function of time, positions and velocities, and its derivatives
are automatic: along the motion without strings V̇ is β, and the gradient by velocities, through how rods answer forces,
is f of V̇ = β - fᵀu. What follows is the smallest u with vᵀu = α between thresholds and ceilings: Lemma 5.1 with bounds.

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
from tensegrity_mj.dynamics.native.law import Report, check_made_for
from tensegrity_mj.engines.jax.arrays import ArrayLaw, Arrays, derivatives, lifted, mapped, norm, settled
from tensegrity_mj.engines.jax.nominal_model import NominalModel, ceilings
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.structure import Structure

ROUND_OFF = 8 * float(np.finfo(float).eps)  # of K_p times a coordinate: a smaller demand is none
POLE = 1e-6  # sin φ below which θ and φ say nothing


def linearizing_law(law: Any, structure: Structure) -> ArrayLaw:
    """The array function of `controllers.FeedbackLinearization`, for a plant of its nodes and strings.

    Its parameters are `natural_frequency`, `damping`, `weight` and `minimum_force_density` as numbers or arrays,
    `sums` (L,), and those of its `NominalModel`.

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
    nominal = NominalModel(law)
    coordinates = Coordinates(law.structure, nominal.sizes)
    limits, rows, M = allocator.limits, allocator.sum_rows, len(structure.strings)
    parameters = {
        "natural_frequency": np.array(law.natural_frequency, float),
        "damping": np.array(law.damping, float),
        "weight": np.array(allocation.weight, float),
        "minimum_force_density": np.array(allocation.minimum_force_density, float),
        "sums": np.array(allocator.sum_values),
        **nominal.parameters,
    }

    def q_of(places: Any) -> Any:
        return coordinates(places)[0]

    def command(p: Arrays, t: Any, x: Any, v: Any) -> tuple[Any, Any]:
        t, places, rates = jnp.asarray(t, float), nominal.places(x), nominal.places(v)
        (q, sine), (q_d, sine_d) = coordinates(places), coordinates(nominal.aim(p["target"], t))
        _, q_rate, curved = derivatives(lambda s: q_of(places + s * rates), 0.0)
        _, rate_d, acceleration_d = derivatives(lambda t: q_of(nominal.aim(p["target"], t)), t)
        e = q - q_d
        e = jnp.where(coordinates.turns, e - 2 * jnp.pi * jnp.round(jax.lax.stop_gradient(e) / (2 * jnp.pi)), e)
        omega = p["natural_frequency"]
        lengths, along = nominal.motion(p, t, x, v)
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
    """Coordinates q of §2.3 of places (P + R, 3), see `NominalModel`: each rod's z and angles, then each point mass' z.

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
        """Return q (n,), and sin φ (R,), 1 of planar rods."""
        z, spans = jnp.split(places, [len(places) - len(self._axes)])
        b = jnp.einsum("rxk,rx->rk", self._axes, spans)
        across, length = norm(b), norm(spans)
        angles = jnp.stack([jnp.arctan2(b[:, 1], b[:, 0]), jnp.arctan2(across, spans[:, 2])], axis=1)
        angles = jnp.concatenate([angles, jnp.zeros((len(z) - len(spans), 2))])
        q = jnp.concatenate([z, angles], axis=1).reshape(-1)[self._order]
        return q, jnp.where(self._planar, 1.0, across / length)


STEPS = 60  # at most; each makes the gap a tenth of what it was, where bounds leave it the way
GAP = 1e-13  # of the products of multipliers and distances from bounds, relative to the first
SHIFT = 1e-13  # of the diagonal of what is solved, since rows may depend on each other; refined away
ACCURACY = 1e-8  # relative to the terms of a row: what misses more has no solution


def least_cost(h: Any, A: Any, d: Any, S: Any, s: Any, lo: Any, hi: Any) -> tuple[Any, Any]:
    """Compute u (M,) of least cost, NaN where there is none, and the largest violation of a row.

    Args:
        h: (M,) > 0, the diagonal of H.
        A, d, S, s: (n, M), (n,), (L, M), (L,).
        lo, hi: (M,), finite, and finite or infinite.
    """
    n, L = len(d), len(s)
    G, b = jnp.concatenate([A, S]), jnp.concatenate([d, s])
    # Sums have slacks without a cost: S u - t = s, t >= 0.
    wide = jnp.concatenate([G, jnp.concatenate([jnp.zeros((n, L)), -jnp.eye(L)])], axis=1)
    none = jnp.zeros(L)
    bounds = jnp.concatenate([lo, none]), jnp.concatenate([hi, none + jnp.inf])
    low, high = _sides(*jax.lax.stop_gradient((jnp.concatenate([h, none]), wide, b, *bounds)))
    low, high, active = low[: len(h)], high[: len(h)], jnp.concatenate([jnp.ones(n, bool), low[len(h) :]])
    at = jnp.where(low, lo, jnp.where(high, hi, 0.0))
    y, first = _between(h, G, b, at, ~low & ~high, active)
    # Newton's step from there: the better one, where its own multipliers prove it.
    v = jax.lax.stop_gradient(G.T @ y / h)
    y, second = _between(h, G, b, jnp.clip(v, lo, hi), (v > lo) & (v < hi), active)
    proven = jnp.max(jnp.abs(jnp.clip(G.T @ y / h, lo, hi) - second)) <= ACCURACY * jnp.max(jnp.abs(second))
    proven &= jnp.all(y[n:] >= -ACCURACY * jnp.max(jnp.abs(y), initial=0.0))
    better = proven & _meets(G, b, lo, hi, n, second)[0]
    u = jnp.where(better, second, first)
    good, violation = _meets(G, b, lo, hi, n, u)
    return jnp.where(good, u, jnp.nan), violation


def _meets(G: Any, b: Any, lo: Any, hi: Any, n: int, u: Any) -> tuple[Any, Any]:
    """Return whether u meets n equations, sums and bounds, and its largest violation of the first two."""
    missed = G @ u - b
    missed = missed.at[n:].set(jnp.minimum(missed[n:], 0.0))
    within = jnp.all(jnp.maximum(lo - u, u - hi) <= ACCURACY * jnp.max(jnp.abs(u)))
    met = jnp.all(jnp.abs(missed) <= ACCURACY * (jnp.abs(G) @ jnp.abs(u) + jnp.abs(b)))
    return within & met, jnp.max(jnp.abs(missed), initial=0.0)


def _between(h: Any, G: Any, b: Any, u: Any, free: Any, active: Any) -> tuple[Any, Any]:
    """Solve for y and u, of which those not free are given, with the rows that are active."""
    columns = jnp.where(free & active[:, None], G, 0.0)
    K = (columns / h) @ columns.T
    y, left = jnp.zeros_like(b), jnp.where(active, b - G @ jnp.where(free, 0.0, u), 0.0)
    for _ in range(3):
        y = y + _solved(K, left - K @ y)
    return y, jnp.where(free, columns.T @ y / h, u)


def _solved(K: Any, right: Any) -> Any:
    """K x = right for a positive semidefinite K; rows of zeros have x = 0."""
    diagonal = jnp.diagonal(K)
    scale = jnp.where(diagonal > 0.0, 1.0 / jnp.sqrt(jnp.where(diagonal > 0.0, diagonal, 1.0)), 0.0)
    scaled = scale[:, None] * K * scale + jnp.diag(jnp.where(diagonal > 0.0, SHIFT, 1.0))
    return scale * jax.scipy.linalg.cho_solve(jax.scipy.linalg.cho_factor(scaled), scale * right)


def _sides(h: Any, G: Any, b: Any, lo: Any, hi: Any) -> tuple[Any, Any]:
    """Find which w (K,) are at their lower and at their upper bounds at the least ½ wᵀHw, h >= 0, with G w = b."""
    capped, fixed = jnp.isfinite(hi), hi <= lo
    width = jnp.where(capped, hi - lo, jnp.inf)
    rest = jnp.abs(b - G @ lo) / jnp.sqrt(jnp.maximum(jnp.sum(G * G, axis=1), jnp.finfo(float).tiny))
    far = jnp.where(jnp.max(rest) > 0.0, jnp.max(rest), 1.0)
    least = jnp.min(jnp.where(h > 0.0, h, jnp.inf))
    near = 1e-3 * GAP * (far + jnp.abs(lo))  # the least distance from a bound, against round-off

    def distances(w: Any) -> tuple[Any, Any]:
        return jnp.where(fixed, 1.0, jnp.maximum(w - lo, near)), jnp.where(
            capped & ~fixed, jnp.maximum(hi - w, near), 1.0
        )

    def gap(w: Any, down: Any, up: Any) -> Any:
        below, above = distances(w)
        return jnp.mean(below * down + above * up)

    def reach(x: Any, change: Any) -> Any:
        falls = change < 0.0
        return jnp.min(jnp.where(falls, -x / jnp.where(falls, change, 1.0), jnp.inf))

    def step(state: tuple[Any, ...]) -> tuple[Any, ...]:
        w, y, down, up, count = state
        below, above = distances(w)
        mu = 0.1 * gap(w, down, up)
        D = jnp.where(fixed, 0.0, 1.0 / (h + down / below + up / above))
        # Multipliers for the next gap, and what the bounds then push.
        to_down, to_up = mu / below - down, jnp.where(capped, mu / above - up, 0.0)
        push = to_down - to_up - (h * w - G.T @ y - down + up)
        dy = _solved((G * D) @ G.T, b - G @ w - G @ (D * push))
        dw = D * (G.T @ dy + push)
        d_down, d_up = to_down - down / below * dw, to_up + up / above * dw
        ways = ((below, dw), (above, jnp.where(capped, -dw, 0.0)), (down, d_down), (up, d_up))
        part = jnp.minimum(1.0, 0.99 * jnp.min(jnp.stack([reach(x, change) for x, change in ways])))
        return w + part * dw, y + part * dy, down + part * d_down, up + part * d_up, count + 1

    start = jnp.where(fixed, 0.0, least * far) * jnp.ones_like(h)
    first = (lo + jnp.minimum(far, 0.5 * width), jnp.zeros_like(b), start, jnp.where(capped, start, 0.0), 0)
    end = GAP * gap(first[0], first[2], first[3])
    w, _, down, up, _ = jax.lax.while_loop(lambda x: (x[4] < STEPS) & (gap(x[0], x[2], x[3]) > end), step, first)
    below, above = distances(w)
    weight = jnp.where(h > 0.0, h, least)
    return fixed | (weight * below < down), ~fixed & capped & (weight * above < up)


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
