"""Loops of rods: closing them from a start that is nearly closed, by Newton's method."""

from __future__ import annotations

from typing import Any

import numpy as np

from tensegrity_mj.dynamics.joint_forces import (
    _add_joint_forces,
    _assemble,
    _factor,
    _solve,
    answer_of_rod,
)
from tensegrity_mj.dynamics.joint_plan import Joints
from tensegrity_mj.dynamics.kernels import direction_of
from tensegrity_mj.dynamics.linked import (
    Linked,
    normalize_linked,
    place_linked,
)
from tensegrity_mj.dynamics.native.elements import clear
from tensegrity_mj.dynamics.native.pointers import borrowing
from tensegrity_mj.dynamics.native.vectors import ZERO, column_of, dot, put, row_of

NEWTON_STEPS = 12


@borrowing
def _close(address: int, joints_at: int, q: Any, change: Any, row: int) -> None:
    """Add to `change` (q itself, or q̇) the least change, weighted by masses, that takes the gaps of row 0 or 1 away."""
    linked, joints = Linked(address), Joints(joints_at)
    for e in range(len(joints.x)):
        joints.x[e] = 0.0
    for a in range(len(joints.closures)):
        for x in range(3):
            joints.x[3 * joints.closures[a] + x] = -linked.gaps[a, row, x]
    _solve(joints)
    for k in range(len(linked.rods)):
        clear(joints.ends[k])
    _add_joint_forces(joints)
    for k in range(len(linked.links)):
        link = linked.links[k]
        rod = linked.rods[link.rod]
        b, ends = row_of(joints.b, link.rod), (row_of(joints.ends[link.rod], 0), row_of(joints.ends[link.rod], 1))
        r, turn, _ = answer_of_rod(rod, link, b, 0.0, ends, ZERO, ZERO, None)
        for p in range(link.nz):
            change[rod.q + p] += dot(column_of(rod.E, p), r)
        for p in range(rod.nb):
            change[rod.q + link.nz + p] += dot(column_of(rod.B, p), turn)


@borrowing
def largest_gap(address: int, row: int) -> float:
    """The longest gap of any closure: its length [m] (row 0), or its rate [m/s] (row 1)."""
    linked = Linked(address)
    square = 0.0
    for a in range(len(linked.gaps)):
        gap = row_of(linked.gaps[a], row)
        square = max(square, dot(gap, gap))
    return np.sqrt(square)


@borrowing
def _prepare_to_close(address: int, joints_at: int, q: Any) -> None:
    """S of q, factored."""
    linked, joints = Linked(address), Joints(joints_at)
    for k in range(len(linked.links)):
        link = linked.links[k]
        b = direction_of(linked.rods[link.rod], q, linked.rods[link.rod].q + link.nz)
        put(joints.b, link.rod, b)
    _assemble(linked, joints, None)
    _factor(joints)


@borrowing
def project_linked(address: int, joints_at: int, q: Any, rates: Any, nodes: Any, velocities: Any) -> None:
    """Put q and q̇ back onto all constraints: (3.23)-(3.24) for the lengths, and Newton's method for the closures.

    The latter are the least changes in the metric of the masses, as impulses at the joints are; the former are not, and
    change momenta. The nodes and velocities (N, 3) are those of the corrected state afterwards.
    """
    normalize_linked(address, q, rates)
    place_linked(address, q, rates, nodes, velocities)
    joints = Joints(joints_at)
    if len(joints.closures) == 0:
        return
    before = np.inf
    for _ in range(NEWTON_STEPS):
        gap = largest_gap(address, 0)
        if not gap > 0.0 or gap > 0.5 * before:
            break  # round-off does not fall any further
        before = gap
        _prepare_to_close(address, joints_at, q)
        _close(address, joints_at, q, q, 0)
        normalize_linked(address, q, rates)
        place_linked(address, q, rates, nodes, velocities)
    _prepare_to_close(address, joints_at, q)
    _close(address, joints_at, q, rates, 1)
    place_linked(address, q, rates, nodes, velocities)
