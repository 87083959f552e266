"""The equations of motion of any structure as one system (`assembly`): M q̈ + Jᵀλ = forces, J q̈ = γ."""

from __future__ import annotations

from typing import Any

import numpy as np

from tensegrity_mj.dynamics.assembly import Assembly
from tensegrity_mj.dynamics.kernels import forces_of_ends, hold, own_mass
from tensegrity_mj.dynamics.native.pointers import borrowing, owning
from tensegrity_mj.dynamics.native.vectors import dot, row_of, vector

# Singular values of the scaled matrix below this part of the largest are those of constraints that others imply.
LEAST_SINGULAR_VALUE = 1e-11
NEWTON_STEPS = 12


@owning
def place_assembly(address: int, moved: Any, q: Any, rates: Any, nodes: Any, velocities: Any) -> None:
    """Node positions and velocities (N, 3) of q and q̇."""
    system = Assembly(address)
    places, speeds = np.dot(system.maps, q), np.dot(system.maps, rates)
    for n in range(system.node_count):
        motion = system.carried[n]
        for x in range(3):
            nodes[n, x] = system.bases[n, x] + places[3 * n + x]
            velocities[n, x] = speeds[3 * n + x]
            if motion >= 0:
                nodes[n, x] += moved[motion, 0, x]
                velocities[n, x] += moved[motion, 1, x]


@borrowing
def _driven(system: Any, moved: Any, row: int, order: int) -> float:
    """Sum of what the support motions add to g of a row, or to its first or second time derivative (`order`)."""
    total = 0.0
    for m in range(system.motion_count):
        total += dot(row_of(system.drives[row], m), row_of(moved[m], order))
    return total


@owning
def deviations(system: Any, moved: Any, q: Any, rates: Any, off: Any) -> None:
    """Write how far pairs and rows are from their values, and how fast they leave them: off (2, pairs + rows)."""
    P = system.pair_count
    for a in range(P):
        one, other, factor = system.pairs[a, 0], system.pairs[a, 1], system.factors[a]
        v, w, v_rate, w_rate = vector(q[one:]), vector(q[other:]), vector(rates[one:]), vector(rates[other:])
        if one == other:
            factor *= 0.5
        off[0, a] = factor * (dot(v, w) - system.values[a])
        off[1, a] = factor * (dot(v, w_rate) + dot(v_rate, w))
    gaps, speeds = np.dot(system.rows, q), np.dot(system.rows, rates)
    for a in range(system.row_count):
        off[0, P + a] = gaps[a] - system.offsets[a] - _driven(system, moved, a, 0)
        off[1, P + a] = speeds[a] - _driven(system, moved, a, 1)


@borrowing
def _largest(system: Any, off: Any) -> Any:
    """The most of `deviations` that rows are off [m], and bodies out of shape, and the rate of that."""
    largest = (0.0, 0.0)
    for a in range(off.shape[1]):
        length = system.lengths[a] / system.factors[a] if a < system.pair_count else 1.0
        largest = (max(largest[0], length * abs(off[0, a])), max(largest[1], length * abs(off[1, a])))
    return largest


@owning
def _matrix(system: Any, added: Any, q: Any, scale: Any) -> Any:
    """[[M, Jᵀ], [J, 0]] at q, to unit diagonals and rows; writes what was made of each row and column into `scale`."""
    n, P = system.size, system.pair_count
    total = n + P + system.row_count
    matrix = np.zeros((total, total))
    matrix[:n, :n] = system.mass
    if added is not None:
        _add_mass(system, added, q, matrix)
    for a in range(P):
        one, other, factor = system.pairs[a, 0], system.pairs[a, 1], system.factors[a]
        if one == other:
            factor *= 0.5
        for x in range(3):
            matrix[n + a, one + x] += factor * q[other + x]
            matrix[n + a, other + x] += factor * q[one + x]
    matrix[n + P :, :n] = system.rows
    scale[:n] = system.scale
    for i in range(n, total):
        square = 0.0
        for j in range(n):
            square += (matrix[i, j] * scale[j]) ** 2
        scale[i] = 1.0 / np.sqrt(square)
    for i in range(total):
        for j in range(n):
            matrix[i, j] *= scale[i] * scale[j]
            if i >= n:
                matrix[j, i] = matrix[i, j]
    return matrix


@owning
def _solve(system: Any, matrix: Any, scale: Any, x: Any) -> Any:
    """Solve the scaled equations; return the solution of least norm where constraints depend on each other."""
    scaled = scale * x
    if not (np.all(np.isfinite(scaled)) and np.all(np.isfinite(matrix))):  # of a run that diverges
        return np.full(len(x), np.nan)
    if system.redundant:
        return scale * np.linalg.lstsq(matrix, scaled, LEAST_SINGULAR_VALUE)[0]
    return scale * np.linalg.solve(matrix, scaled)


@owning
def _add_mass(system: Any, added: Any, q: Any, matrix: Any) -> None:
    """Σ Φᵀ_i α_ij P Φ_j of the rods' ends to the mass matrix."""
    n, maps, W = system.size, np.empty((6, system.size)), np.empty((6, 6))
    for k in range(system.rod_count):
        rod = system.rods[k]
        b = vector(q[rod.q :])
        square = dot(b, b)
        maps[:3], maps[3:] = system.maps[3 * rod.i : 3 * rod.i + 3], system.maps[3 * rod.j : 3 * rod.j + 3]
        for i in range(6):
            for j in range(6):
                across = (1.0 if i % 3 == j % 3 else 0.0) - b[i % 3] * b[j % 3] / square
                W[i, j] = added[0][k, 2 * (i // 3) + j // 3] * across
        matrix[:n, :n] += np.dot(np.dot(maps.T, W), maps)


@owning
def assembled_accelerations(model: Any, added: Any, q: Any, rates: Any, out: Any) -> float:
    """q̈ (nq,) into `out`, for the forces (N, 3) [N] of a model, and λ of its R rods, and how far constraints are off.

    Returns the power [W] of what moves supports: that of their constraints, and of the forces on fixed nodes.
    """
    system, moved, kp, kd = Assembly(model.assembly), model.moved, model.kp, model.kd
    n, P = system.size, system.pair_count
    scale, x = np.empty(n + P + system.row_count), np.empty(n + P + system.row_count)
    x[:n] = np.dot(model.forces.copy().reshape(-1), system.maps)
    for k in range(n):
        x[k] += system.weights[k] * model.gravity[k % 3]
    off = np.empty((2, P + system.row_count))
    deviations(system, moved, q, rates, off)
    R = system.rod_count
    model.multipliers[R], model.multipliers[R + 1] = _largest(system, off)
    for a in range(P + system.row_count):
        x[n + a] = -kd * off[1, a] - kp * off[0, a]
    for a in range(P):
        one, other = system.pairs[a, 0], system.pairs[a, 1]
        turning = system.factors[a] * dot(vector(rates[one:]), vector(rates[other:]))
        x[n + a] -= turning if one == other else 2.0 * turning
    for a in range(system.row_count):
        x[n + P + a] += _driven(system, moved, a, 2)
    solved = _solve(system, _matrix(system, added, q, scale), scale, x)
    out[:n] = solved[:n]
    for a in range(P):
        if system.members[a] >= 0:
            model.multipliers[system.members[a]] = solved[n + a]
    power, forces = 0.0, model.multipliers[len(model.multipliers) - model.constraint_count :]
    for a in range(system.row_count):
        if system.links[a] >= 0:
            forces[system.links[a]] = -system.shares[a] * solved[n + P + a]
        power -= solved[n + P + a] * _driven(system, moved, a, 1)
    for node in range(system.node_count):
        if system.carried[node] >= 0:
            power -= dot(row_of(model.forces, node), row_of(moved[system.carried[node]], 1))
    if added is not None:
        _hold_mass(system, added, q, out)
    return power


@owning
def _hold_mass(system: Any, added: Any, q: Any, accelerations: Any) -> None:
    """Write the forces of the added mass on the nodes."""
    added[1][:] = 0.0
    moves = np.dot(system.maps, accelerations)
    for k in range(system.rod_count):
        rod = system.rods[k]
        first, second = vector(moves[3 * rod.i :]), vector(moves[3 * rod.j :])
        hold(rod, forces_of_ends(vector(q[rod.q :]), own_mass(added, k), first, second), added[1])


@owning
def project_assembly(address: int, moved: Any, q: Any, rates: Any) -> None:
    """Put q and q̇ back onto all constraints by Newton's method: the least changes in the metric of the masses."""
    system = Assembly(address)
    n, count = system.size, system.pair_count + system.row_count
    if count == 0:
        return
    off, scale, x = np.empty((2, count)), np.empty(n + count), np.zeros(n + count)
    before = np.inf
    for _ in range(NEWTON_STEPS):
        deviations(system, moved, q, rates, off)
        matrix = _matrix(system, None, q, scale)
        largest = np.max(np.abs(scale[n:] * off[0]))
        if not largest > 0.0 or largest > 0.5 * before:
            break  # round-off does not fall any further
        before = largest
        x[n:] = -off[0]
        q += _solve(system, matrix, scale, x)[:n]
    x[n:] = -off[1]
    rates += _solve(system, matrix, scale, x)[:n]
