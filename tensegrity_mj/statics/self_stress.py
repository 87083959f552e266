"""Statics of a structure at given nodes: self-stress, prestress, and how far from equilibrium it is.

Rods are rigid and strings pull with force densities u [N/m], so that equilibrium is linear in u: A u + f = 0.
Its rows are the free coordinates of every kind of support (2.41): for a rod the translation E of its point at
σ, and the two ways b can turn (one if planar); for a point mass its free directions. What supports and rigid
rods carry drops out, and follows from u (`static_forces`). All rows are forces [N]:

    Eᵀ (F_i + F_j)        and        Tᵀ ((1 - σ) F_j - σ F_i),        T spans the free directions of δb,

with F the forces on a rod's two nodes; the second is the moment about the support point over ℓ. Where rods share nodes,
the free coordinates are combinations of these: an orthonormal basis of those that keep the joints together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import positive
from tensegrity_mj.errors import InfeasibleError
from tensegrity_mj.model import rigidity
from tensegrity_mj.model.rigidity import static_forces
from tensegrity_mj.model.rods import lumped_masses
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.statics.boundary import Boundary
from tensegrity_mj.statics.stress_signs import Flags, can_pull, linear_program, listed, strings_named


@dataclass(frozen=True, eq=False)
class SelfStress:
    """Self-stress of a structure at given nodes: S independent states.

    Attributes:
        modes: (S, M) [N/m] orthonormal force densities of the strings; any combination is in equilibrium.
        forces: what rods and supports carry in each mode.
        particular: (M,) [N/m] smallest force densities that balance gravity and loads as well as any can.
        residual: (q,) [N] what `particular` leaves unbalanced, on the q free coordinates.
        free_coordinates: q.
        rigid_motions: motions of the whole as one body that the supports leave.
        mechanisms: further independent motions that change no string's length, to first order.
        singular_values: of A, decreasing; which show how clear the rank is.
    """

    modes: Array
    forces: tuple[rigidity.StaticForces, ...]
    particular: Array
    residual: Array
    free_coordinates: int
    rigid_motions: int
    mechanisms: int
    singular_values: Array


def self_stress(
    structure: Structure,
    nodes: ArrayLike | None = None,
    gravity: ArrayLike | None = None,
    loads: ArrayLike | None = None,
) -> SelfStress:
    """Self-stress modes and mechanisms, by the singular values of A; arguments as `static_forces`."""
    positions = rigidity.nodes_of(structure, nodes)
    motions = rigidity.free_motions(structure, positions)
    matrix, external = rigidity.equilibrium_equations(structure, positions, motions, gravity, loads)
    states = rigidity.balanced_states(matrix, external)
    rigid = rigidity.count_rigid_motions(positions, motions)
    return SelfStress(
        modes=states.modes,
        forces=tuple(static_forces(structure, mode, positions) for mode in states.modes),
        particular=states.particular,
        residual=states.residual,
        free_coordinates=len(matrix),
        rigid_motions=rigid,
        mechanisms=len(matrix) - (matrix.shape[1] - len(states.modes)) - rigid,
        singular_values=states.singular_values,
    )


def prestress(
    structure: Structure,
    level: float = 1.0,
    nodes: ArrayLike | None = None,
    gravity: ArrayLike | None = None,
    loads: ArrayLike | None = None,
    slack: Sequence[str] = (),
) -> Array:
    """Force densities u (M,) [N/m] in equilibrium, none below `level` [N/m] but those of the `slack` strings, 0.

    Of all such states it is the one of the smallest sum of u². That one is unique: a symmetric structure gets a
    symmetric prestress, and moving the whole changes nothing. All of it holds to round-off. `slack` names strings;
    the other arguments are as in `static_forces`.

    Raises:
        InfeasibleError: if there is none; it says which strings cannot be in tension, and why.
        OptionError: if the level is not positive, or a name in `slack` unknown.
    """
    level = positive("level", level, "N/m")
    tight = ~strings_named("slack", slack, structure)
    positions = rigidity.nodes_of(structure, nodes)
    motions, forces = rigidity.free_motions(structure, positions), rigidity.loads_on(structure, gravity, loads)
    matrix, external = rigidity.equilibrium_equations(structure, positions, motions, gravity, loads)
    states = rigidity.balanced_states(matrix[:, tight], external)
    # Not the norm of `external`: supports may take all of the weight, and leave its round-off.
    weight = float(np.linalg.norm(forces))
    unbalanced = float(np.linalg.norm(states.residual))
    if unbalanced > rigidity.RANK_TOLERANCE * weight:
        free, masses = Boundary.of(structure).straight_ways(), lumped_masses(structure)
        push = free @ (free.T @ forces.sum(axis=0))
        push = np.where(np.abs(push) > rigidity.RANK_TOLERANCE * weight, push, 0.0)
        falling = forces - masses[:, None] * push / masses.sum()
        if np.any(push) and np.linalg.norm(
            rigidity.balanced_states(matrix[:, tight], motions.T @ falling.ravel()).residual
        ) < (rigidity.RANK_TOLERANCE * weight):
            sizes = ", ".join(f"{size:.6g}" for size in push)
            raise InfeasibleError(
                f"structure '{structure.name}': gravity and loads push the whole with ({sizes}) N, and nothing holds "
                "it; leave gravity out (gravity=None) where it falls freely, or give it supports where it stands"
            )
        raise InfeasibleError(
            f"structure '{structure.name}': {unbalanced:.3g} N of gravity and loads push along motions that no string "
            "resists; add strings or supports against them"
        )
    shift = _least_distance(states.modes.T, (level - states.particular) / level)
    if shift is None:
        names = [string.name for string, is_tight in zip(structure.strings, tight, strict=True) if is_tight]
        raise InfeasibleError(_why_infeasible(structure.name, names, states, level, loaded=weight > 0))
    u = np.zeros(len(tight))
    u[tight] = states.particular + level * (states.modes.T @ shift)
    return u


def _least_distance(matrix: Array, lower: Array) -> Array | None:
    """The shortest x with matrix @ x >= lower, or None if there is none.

    It is the dual of a non-negative least squares problem (Lawson and Hanson, Solving Least Squares Problems,
    chapter 23), which an active set method solves to round-off in finitely many steps.
    """
    from scipy.optimize import nnls

    size = matrix.shape[1]
    if not size:
        return np.zeros(0) if np.all(lower <= rigidity.RANK_TOLERANCE) else None
    if linear_program(np.zeros(size), -matrix, -lower, tolerance=None).status != 0:
        return None
    if len(lower) == 0 or np.all(lower <= 0.0):
        return np.zeros(size)
    goal = np.zeros(size + 1)
    goal[-1] = 1.0
    dual, _ = nnls(np.vstack([matrix.T, lower]), goal)
    rest = np.append(matrix.T @ dual, lower @ dual - 1.0)
    return -rest[:-1] / rest[-1]


def _why_infeasible(name: str, strings: list[str], states: rigidity.BalancedStates, level: float, loaded: bool) -> str:
    if loaded:
        best, deciding = _largest_minimum(states)
        remedy = "choose a lower level" if best > 0 else "add strings, or move nodes"
        return (
            f"structure '{name}': under gravity and loads the smallest force density is at most {best:.6g} N/m (in "
            f"{listed(strings, deciding, 'string')}), below the level {level:.6g} N/m; {remedy}"
        )
    if len(states.modes) == 0:
        message = (
            f"structure '{name}' has no self-stress: its {len(strings)} strings resist independent motions of its "
            f"{len(states.residual)} free coordinates, so that none can be tightened against the others; "
            "add strings or change the nodes"
        )
        values = states.singular_values
        if values.size and values[-1] < 1e-2 * values[0]:
            message += (
                f". It is close to having one (smallest singular value {values[-1] / values[0]:.1e} of the largest): "
                "if these nodes are meant to be in equilibrium, give them all 17 digits"
            )
        return message
    barred = listed(strings, ~can_pull(states.modes, len(strings)), "string")
    return (
        f"structure '{name}' has no prestress with every string in tension: {barred} can carry none "
        "while no string pushes, since a motion of the nodes lengthens each of them and shortens no string (or the "
        "reverse); leave them slack (slack=[...]), move the nodes, or add strings against that motion"
    )


def _largest_minimum(states: rigidity.BalancedStates) -> tuple[float, Flags]:
    """The largest possible smallest force density [N/m] under the loads, and which strings decide it."""
    size, count = states.modes.shape
    rows = np.hstack([-states.modes.T, np.ones((count, 1))])
    result = linear_program(np.append(np.zeros(size), -1.0), rows, states.particular, tolerance=None)
    return float(-result.fun), np.abs(result.ineqlin.marginals) > 1e-9
