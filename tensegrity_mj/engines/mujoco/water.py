"""Rods in water inside MuJoCo: added mass, which MuJoCo's isotropic bodies have no place for.

MuJoCo solves M q̈ = Q with the thin rods' own M. In water each rod feels -Σ_j α_ij P a_j at its nodes besides, a_j being
the accelerations that are to be found. So the callback finds them first, rod by rod, from the numbers that MuJoCo has
for its degrees of freedom when it calls: with J_i the velocities of node i for each of them (from `cdof`), M = the
body's own inertia in these (and `dof_armature`), Q = `qfrc_passive` - `qfrc_bias` + `qfrc_applied` + Σ J_iᵀ f_i, where
f_i are loads, pulls of strings and F⁰ of the water, it solves

    (M + Σ_ij α_ij J_iᵀ P J_j) q̈ = Q - Σ_ij α_ij J_iᵀ P ω × (ω × (x_j - x_0)),

x_0 being the origin of the body, which is where all its joints are, and applies -Σ_j α_ij P a_j of this q̈ as external
forces. MuJoCo then finds the same q̈ by itself. No number of the DAE takes part, and both agree to round-off.

An integrator whose step is not made of these accelerations would apply these forces all the same, and be wrong:
`implicit`, `implicitfast` and `discrete` solve M + h D, not M. They are refused.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from tensegrity_mj.dynamics.native.pointers import address_of, borrowing, floats, inlined, integers
from tensegrity_mj.dynamics.native.slots import FORCES, NODE_COUNT, NODES, STRING_COUNT, VELOCITIES, WATER
from tensegrity_mj.dynamics.native.strings import add_string_forces
from tensegrity_mj.dynamics.native.vectors import dot, minus, plus, row_of, times
from tensegrity_mj.dynamics.native.water import added_masses
from tensegrity_mj.model.scene import Scene

MOST = 6  # degrees of freedom of a body

# The table: rows (first node, second node, body, first dof, number of dofs) of the rods, addresses of MuJoCo's arrays,
# and room: all forces on the nodes (N, 3), and for one rod its J_1, J_2, its equations and q̈.
(
    ROD_COUNT,
    PLACES,
    BODY_COUNT,
    DOF_COUNT,
    MASS,
    INERTIA,
    ARMATURE,
    FRAMES,
    ORIGINS,
    AXES,
    TWISTS,
    BIAS,
    PASSIVE,
    APPLIED,
    PULLS,
    JACOBIANS,
    EQUATIONS,
) = range(17)
SIZE = 17


class WaterTable:
    """The table of a run in water, kept alive with what it points to.

    Attributes:
        table: (17,) int64.
    """

    def __init__(self, scene: Scene, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        structure = scene.structure
        bodies = [int(model.site_bodyid[model.site(rod.nodes[0]).id]) for rod in structure.rods]
        rows = [
            [*pair, body, model.body_dofadr[body], model.body_dofnum[body]]
            for pair, body in zip(structure.rod_nodes, bodies, strict=True)
        ]
        arrays: dict[int, np.ndarray[Any, Any]] = {
            PLACES: np.array(rows, np.int64),
            MASS: model.body_mass,
            INERTIA: model.body_inertia,
            ARMATURE: model.dof_armature,
            FRAMES: data.ximat,
            ORIGINS: data.xpos,
            AXES: data.cdof,
            TWISTS: data.cvel,
            BIAS: data.qfrc_bias,
            PASSIVE: data.qfrc_passive,
            APPLIED: data.qfrc_applied,
            PULLS: np.zeros((len(structure.nodes), 3)),
            JACOBIANS: np.zeros((2, MOST, 3)),
            EQUATIONS: np.zeros((MOST, MOST + 1)),
        }
        self._keep = arrays
        self.table = np.zeros(SIZE, np.int64)
        self.table[ROD_COUNT], self.table[BODY_COUNT], self.table[DOF_COUNT] = len(rows), model.nbody, model.nv
        for slot, array in arrays.items():
            self.table[slot] = address_of(array)


@borrowing
def add_mass(table: Any, wet: Any, centers: Any) -> float:
    """Add the forces of the added mass to the nodal forces; returns their power [W].

    Args:
        table: of the plant, whose nodal forces are all but those of strings, whose tensions are known.
        wet: of a `WaterTable`.
        centers: (bodies, 3) [m] centres of mass.
    """
    N, power = table[NODE_COUNT], 0.0
    forces, pulls = floats(table[FORCES], (N, 3)), floats(wet[PULLS], (N, 3))
    nodes, velocities = floats(table[NODES], (N, 3)), floats(table[VELOCITIES], (N, 3))
    for n in range(N):
        for x in range(3):
            pulls[n, x] = forces[n, x]
    if table[STRING_COUNT] > 0:
        own = table[FORCES]
        table[FORCES] = wet[PULLS]
        add_string_forces(table)
        table[FORCES] = own
    rods, nv = integers(wet[PLACES], (wet[ROD_COUNT], 5)), wet[DOF_COUNT]
    added = floats(added_masses(table[WATER]), (wet[ROD_COUNT], 4))
    mass, inertia = floats(wet[MASS], (wet[BODY_COUNT],)), floats(wet[INERTIA], (wet[BODY_COUNT], 3))
    frames, origins = floats(wet[FRAMES], (wet[BODY_COUNT], 3, 3)), floats(wet[ORIGINS], (wet[BODY_COUNT], 3))
    twists, axes = floats(wet[TWISTS], (wet[BODY_COUNT], 6)), floats(wet[AXES], (nv, 6))
    bias, passive, applied = floats(wet[BIAS], (nv,)), floats(wet[PASSIVE], (nv,)), floats(wet[APPLIED], (nv,))
    armature = floats(wet[ARMATURE], (nv,))
    J, A = floats(wet[JACOBIANS], (2, MOST, 3)), floats(wet[EQUATIONS], (MOST, MOST + 1))
    for r in range(len(rods)):
        alpha = (added[r, 0], added[r, 1], added[r, 2], added[r, 3])
        if alpha[0] + alpha[1] + alpha[2] + alpha[3] == 0.0:
            continue
        i, j, body, start, count = rods[r, 0], rods[r, 1], rods[r, 2], rods[r, 3], rods[r, 4]
        x1, x2, center, origin = row_of(nodes, i), row_of(nodes, j), row_of(centers, body), row_of(origins, body)
        span = minus(x2, x1)
        axis, spin = times(1.0 / np.sqrt(dot(span, span)), span), row_of(twists, body)
        bent1 = _cross(spin, _cross(spin, minus(x1, origin)))
        bent2 = _cross(spin, _cross(spin, minus(x2, origin)))
        held1, held2 = _added(alpha, axis, bent1, bent2)
        f1, f2 = minus(row_of(pulls, i), held1), minus(row_of(pulls, j), held2)
        for d in range(count):
            turn, slide = _dof(axes, start + d)
            for x, value in enumerate(plus(slide, _cross(turn, minus(x1, center)))):
                J[0, d, x] = value
            for x, value in enumerate(plus(slide, _cross(turn, minus(x2, center)))):
                J[1, d, x] = value
        for e in range(count):
            turn, slide = _dof(axes, start + e)
            momentum, swing = times(mass[body], slide), _turned(frames, inertia, body, turn)
            held1, held2 = _added(alpha, axis, row_of(J[0], e), row_of(J[1], e))
            for d in range(count):
                other, moves = _dof(axes, start + d)
                A[d, e] = dot(moves, momentum) + dot(other, swing)
                A[d, e] += dot(row_of(J[0], d), held1) + dot(row_of(J[1], d), held2)
            A[e, e] += armature[start + e]
            A[e, MOST] = passive[start + e] - bias[start + e] + applied[start + e]
            A[e, MOST] += dot(row_of(J[0], e), f1) + dot(row_of(J[1], e), f2)
        _solve(A, count)
        a1, a2 = bent1, bent2
        for d in range(count):
            a1, a2 = plus(a1, times(A[d, MOST], row_of(J[0], d))), plus(a2, times(A[d, MOST], row_of(J[1], d)))
        held1, held2 = _added(alpha, axis, a1, a2)
        power -= dot(held1, row_of(velocities, i)) + dot(held2, row_of(velocities, j))
        for x in range(3):
            forces[i, x] -= held1[x]
            forces[j, x] -= held2[x]
    return power


@inlined
def _dof(axes: Any, d: int) -> Any:
    """Angular velocity, and velocity of the centre of mass, of a degree of freedom."""
    return (axes[d, 0], axes[d, 1], axes[d, 2]), (axes[d, 3], axes[d, 4], axes[d, 5])


@inlined
def _cross(a: Any, b: Any) -> Any:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inlined
def _added(alpha: Any, axis: Any, a1: Any, a2: Any) -> Any:
    """Σ_j α_ij P a_j of both ends."""
    p1, p2 = minus(a1, times(dot(a1, axis), axis)), minus(a2, times(dot(a2, axis), axis))
    return plus(times(alpha[0], p1), times(alpha[1], p2)), plus(times(alpha[2], p1), times(alpha[3], p2))


@inlined
def _turned(frames: Any, inertia: Any, body: int, w: Any) -> Any:
    """The body's moment of inertia, in the world's axes, times w."""
    out = (0.0, 0.0, 0.0)
    for k in range(3):
        column = (frames[body, 0, k], frames[body, 1, k], frames[body, 2, k])
        out = plus(out, times(inertia[body, k] * dot(column, w), column))
    return out


@borrowing
def _solve(A: Any, n: int) -> None:
    """Solve the n x n equations in A, whose right-hand sides are in the last column, in place, with pivots."""
    for k in range(n):
        best = k
        for i in range(k + 1, n):
            if abs(A[i, k]) > abs(A[best, k]):
                best = i
        if best != k:
            for x in range(k, n):
                A[k, x], A[best, x] = A[best, x], A[k, x]
            A[k, MOST], A[best, MOST] = A[best, MOST], A[k, MOST]
        for i in range(k + 1, n):
            factor = A[i, k] / A[k, k]
            for x in range(k, n):
                A[i, x] -= factor * A[k, x]
            A[i, MOST] -= factor * A[k, MOST]
    for k in range(n - 1, -1, -1):
        for x in range(k + 1, n):
            A[k, MOST] -= A[k, x] * A[x, MOST]
        A[k, MOST] /= A[k, k]
