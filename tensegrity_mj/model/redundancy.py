"""Redundant rods, whose forces joints and supports do not determine, and starts that are singular.

In node coordinates the constraints on velocities are rows: e·(v_j - v_i) = 0 of each rod of direction e, and those of
supports and planes. A state of self-stress s is a combination of rows that is zero. The forces of the rods in it are
not unique: any multiple of it may be added, and accelerations do not depend on it.

Differentiated, the rows give Σ s ‖v_j - v_i‖²/ℓ = 0 over the rods, for every s, of any motion that can go on. Where a
velocity satisfies all rows but not this, it is one that the lengths stop at once: rods in a line between two supports,
or a loop at its change point. Which way such a start moves, and with which forces, accelerations do not show.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.model.forest import spanning_forest
from tensegrity_mj.model.structure import Structure

RANK = 1e-6  # singular values below this part count as zero: as the solvers' pivots do, which are their squares
SHARE = 1e-6  # of a state of unit length, what counts as being in it
APPROACHED = 1 / 3  # of the smallest singular value at the start, what is near a singular configuration
MOST_RODS = 250  # that hang together; more take seconds


@dataclass(frozen=True)
class Redundancy:
    """Redundant members of a structure at some node positions.

    Attributes:
        undetermined: names of the rods whose forces are not unique, and of such constraints.
        singular: names of the rods that stop a motion which all rows allow.
        skipped: number of rods that were not checked, as more than `MOST_RODS` hang together.
    """

    undetermined: tuple[str, ...] = ()
    singular: tuple[str, ...] = ()
    skipped: int = 0

    @property
    def warning(self) -> str:
        """Warning about a run that starts at these nodes, or ""."""
        if not self.singular:
            return ""
        names = ", ".join(f"'{name}'" for name in self.singular[:6]) + (", ..." if len(self.singular) > 6 else "")
        return (
            f"the start is singular: rods {names} allow velocities that their lengths stop at once, as rods in a line "
            "between supports and loops at a change point do: motion and forces are not determined there, and no step "
            "or tolerance helps: start beside it, or take out what holds the rods twice"
        )


def redundancy(structure: Structure, nodes: Array) -> Redundancy:
    """Rods with forces that are not unique, and rods that make the place singular, at nodes (N, 3) [m]."""
    if structure.class_number <= 1 and not structure.constraints:
        return Redundancy()
    closed = {rod for _, _, rod in spanning_forest(structure).closures}
    undetermined: list[int] = []
    singular: list[int] = []
    skipped = 0
    clusters, constrained = _clusters(structure)
    for number, cluster in enumerate(clusters):
        linked = constrained and number == 0
        if not (closed & set(cluster) or linked) or structure.elastic[list(cluster)].any():
            continue  # as many joints as a tree needs, and rods of constant length; or rods that give way
        if len(cluster) > MOST_RODS:
            skipped += len(cluster)
            continue
        found, blocked = _of_cluster(structure, nodes, cluster, linked)
        undetermined += found
        singular += blocked
    names = [rod.name for rod in structure.rods] + [one.name for one in structure.constraints]
    return Redundancy(
        tuple(names[row] for row in sorted(undetermined)), tuple(names[row] for row in sorted(singular)), skipped
    )


def approached(structure: Structure, start: Array, end: Array) -> str:
    """Return the warning about a run that stopped near a singular configuration that it did not start near, or "".

    `start` and `end` are node positions (N, 3) [m]. Clusters of more than `MOST_RODS` rods are not checked.
    """
    for cluster in structure.clusters if spanning_forest(structure).closures else ():
        if len(cluster) > MOST_RODS or structure.elastic[list(cluster)].any():
            continue
        values = np.linalg.svd(_rows(structure, start, cluster)[0], compute_uv=False)
        last = int(np.sum(values > RANK * values[0])) - 1
        left, now, _ = np.linalg.svd(_rows(structure, end, cluster)[0])
        if now[last] < APPROACHED * values[last]:
            most = np.argsort(-np.abs(left[: len(cluster), last]))
            names = [structure.rods[cluster[k]].name for k in most]
            return (
                f"rods were coming near a singular configuration, '{names[0]}' and '{names[1]}' most: a chain drawn "
                "straight between its supports, or a loop at its change point. Where supports or loads draw rods "
                "further than they reach, no motion goes on from there"
            )
    return ""


def _clusters(structure: Structure) -> tuple[list[Sequence[int]], bool]:
    """Clusters of rods, those that linear constraints join being one, the first; whether there are constraints."""
    held = {name for one in structure.constraints for name in one.nodes}
    joined: list[int] = []
    others: list[Sequence[int]] = []
    for cluster in structure.clusters:
        if not held.isdisjoint(name for row in cluster for name in structure.rods[row].nodes):
            joined += cluster
        else:
            others.append(cluster)
    return ([sorted(joined), *others] if held else others), bool(held)


def _of_cluster(
    structure: Structure, nodes: Array, cluster: Sequence[int], constrained: bool
) -> tuple[list[int], list[int]]:
    """Rows of the rods in states of self-stress, and of those in states that stop a motion; constraints behind rods."""
    rows, apart, lengths = _rows(structure, nodes, cluster, constrained)
    links = len(structure.constraints) if constrained else 0
    count = len(cluster)
    left, values, right = np.linalg.svd(rows)
    rank = int(np.sum(values > RANK * values[0]))
    members = np.r_[:count, len(rows) - links : len(rows)]
    stresses = left[members, rank:]  # the rods' part of each state, and that of constraints
    inside = np.abs(stresses).max(axis=1, initial=0.0) > SHARE
    free = apart @ right[rank:].T  # (count, 3, mechanisms)
    stopped = np.zeros(len(members), bool)
    for stress in stresses.T:
        form = np.einsum("k,kxm,kxn->mn", stress[:count] / lengths, free, free) * float(np.sum(lengths) / max(count, 1))
        if np.abs(form).max(initial=0.0) > SHARE:
            stopped |= np.abs(stress) > SHARE
    chosen = np.array([*cluster, *range(len(structure.rods), len(structure.rods) + links)], int)
    return chosen[inside].tolist(), chosen[stopped].tolist()


def _rows(
    structure: Structure, nodes: Array, cluster: Sequence[int], constrained: bool = False
) -> tuple[Array, Array, Array]:
    """Unit rows (c, n) of constraints on a cluster's nodes, rods first; v_j - v_i (R, 3, n) and ℓ (R,) of these."""
    pairs = structure.rod_nodes[list(cluster)]
    linear = structure.constraint_rows.reshape(-1, len(nodes), 3)[: None if constrained else 0]
    places = np.union1d(pairs, np.flatnonzero(linear.any(axis=(0, 2))))
    ends = np.searchsorted(places, pairs)
    count, size = len(cluster), 3 * len(places)
    lengths = structure.rod_lengths[list(cluster)]
    apart = np.zeros((count, 3, size))  # v_j - v_i of each rod
    held: list[Array] = []
    for k, (row, (i, j)) in enumerate(zip(cluster, ends, strict=True)):
        apart[k, :, 3 * i : 3 * i + 3], apart[k, :, 3 * j : 3 * j + 3] = -np.eye(3), np.eye(3)
        support = structure.rods[row].support
        at_sigma = np.zeros((3, size))
        at_sigma[:, 3 * i : 3 * i + 3] = (1 - support.sigma) * np.eye(3)
        at_sigma[:, 3 * j : 3 * j + 3] = support.sigma * np.eye(3)
        held += [direction @ at_sigma for direction in support.constraint_rows]
        if support.plane is not None:
            held.append(np.array(support.plane) @ apart[k])
    directions = (nodes[pairs[:, 1]] - nodes[pairs[:, 0]]) / lengths[:, None]
    for point in structure.lone_masses:
        if point.plane is not None and structure.node_index[point.node] in places:
            at_point = np.zeros((len(places), 3))
            at_point[np.searchsorted(places, structure.node_index[point.node])] = point.plane
            held.append(at_point.ravel())
    held += list(linear[:, places].reshape(-1, size))
    rows = np.concatenate([np.einsum("kx,kxn->kn", directions, apart), np.array(held).reshape(-1, size)])
    rows /= np.linalg.norm(rows, axis=1)[:, None]
    return rows, apart, lengths
