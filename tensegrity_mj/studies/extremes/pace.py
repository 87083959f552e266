"""How fast a scene can move at its start, so that the study can choose steps and durations that mean something.

Nodes answer forces by the mobility W: v̇ = W f, block by block of the rods; strings answer displacements by the
stiffness K, material and geometric. The fastest vibration has ω² = λmax(W K), the fastest decay λmax(W C). This is a
rougher thing than `stability`, and knows nothing of it, so that the study can also try what that warns of.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.model.elements.elastic_rods import Bars
from tensegrity_mj.model.rigidity import members_at
from tensegrity_mj.model.rods import mass_products
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.string_paths import Paths
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.vibration.blocks import spring_blocks

DENSE = 300  # coordinates up to which eigenvalues are computed whole
ITERATIONS = 100  # of the power method beyond; it gives λmax to a few percent, which is enough to choose a step


@dataclass(frozen=True)
class Pace:
    """Rates at the start of a scene.

    Attributes:
        vibration: ω of the fastest vibration of all strings taut [1/s].
        decay: rate of the fastest decay by their dampers [1/s].
        spin: fastest turning of a rod [1/s].
    """

    vibration: float
    decay: float
    spin: float

    @property
    def fastest(self) -> float:
        """The largest of the three [1/s]; 1 where nothing moves or pulls."""
        return max(self.vibration, self.decay, self.spin) or 1.0


def pace(scene: Scene, force_density: float = 0.0) -> Pace:
    """The rates of a scene; `force_density` [N/m] is the largest that a law will command of any string."""
    from scipy.sparse import diags_array

    structure = scene.structure
    W = mobility(structure, scene.nodes0)
    paths = structure.paths
    lengths, along = members_at(paths.nodes, scene.nodes0)
    tension = structure.curves.tension(paths.total(lengths) - structure.rest_lengths)
    held = force_density * paths.shares(lengths)
    across = np.maximum(tension[paths.strings] / lengths, held)
    material = np.maximum(structure.curves.steepest, force_density)
    N, bars = len(structure.nodes), Bars.of(structure)
    bar_paths, bar_along = Paths.of(bars.nodes), members_at(bars.nodes, scene.nodes0).directions
    none = np.zeros(len(bars.rows))
    K = _assembled(paths, N, spring_blocks(paths, along, material, across))
    K = K + _assembled(bar_paths, N, spring_blocks(bar_paths, bar_along, bars.stiffness, none))
    C = _assembled(paths, N, spring_blocks(paths, along, structure.damping, 0.0 * across))
    C = C + _assembled(bar_paths, N, spring_blocks(bar_paths, bar_along, bars.damping, none))
    nodal = np.zeros((N, 3))
    for point in structure.point_masses:
        nodal[structure.node_index[point.node]] = point.damping
    C = C + diags_array(nodal.ravel())
    first, second = (scene.velocities0[structure.rod_nodes[:, end]] for end in (0, 1))
    spins = np.linalg.norm(second - first, axis=1) / structure.rod_lengths
    return Pace(float(np.sqrt(_largest(W, K))), _largest(W, C), float(spins.max(initial=0.0)))


def mobility(structure: Structure, nodes: Array) -> Any:
    """W (3N, 3N) sparse: accelerations of the nodes [m/s²] for forces on them [N], from rest."""
    from scipy import sparse

    rows, columns, values = [], [], []

    def add(which: list[int], block: Array) -> None:
        index = np.concatenate([3 * n + np.arange(3) for n in which])
        rows.append(np.repeat(index, len(index)))
        columns.append(np.tile(index, len(index)))
        values.append(block.ravel())

    for rod, (i, j), lumps in zip(structure.rods, structure.rod_nodes, structure.rod_lumps.T, strict=True):
        b, sigma = nodes[j] - nodes[i], rod.support.sigma
        E = rod.support.translation_basis
        swings = np.cross(_axes(rod.support.plane, b), b).T  # (3, 1 or 2): d b / d angle
        swings = swings if rod.stiffness is None else rod.support.rotation_basis  # which lengthens, too
        J = np.vstack([np.hstack([E, -sigma * swings]), np.hstack([E, (1 - sigma) * swings])])
        # A thin rod's kinetic energy in its ends' velocities: m/6 (v1·v1 + v1·v2 + v2·v2).
        first, second, both = mass_products(0.0, lumps)
        M = rod.mass / 6 * np.array([[2.0, 1.0], [1.0, 2.0]]) + np.array([[first, both], [both, second]])
        M = np.kron(M, np.eye(3))
        add([int(i), int(j)], J @ np.linalg.solve(J.T @ M @ J, J.T))
    for point in structure.lone_masses:
        E = point.translation_basis
        add([structure.node_index[point.node]], E @ E.T / point.mass)
    for frame in structure.moving_frames:
        add(frame.rows.tolist(), frame.mobility(nodes))
    size = 3 * len(structure.nodes)
    if not values:
        return sparse.csr_matrix((size, size))
    parts = (np.concatenate(part) for part in (values, rows, columns))
    data, row, column = parts
    return sparse.csr_matrix((data, (row, column)), shape=(size, size))


def _axes(plane: Any, b: Array) -> Array:
    """Unit axes (1 or 2, 3) that a rod along b turns about."""
    if plane is not None:
        normal = np.array(plane, float)
        return np.asarray(normal / np.linalg.norm(normal))[None]
    _, _, vt = np.linalg.svd(b[None] / np.linalg.norm(b))
    return np.asarray(vt[1:])


def _assembled(paths: Paths, count: int, blocks: Array) -> Any:
    """Σ over couples of segments of (e_j - e_i) block (e_j - e_i)ᵀ, (3N, 3N) sparse, from blocks (P, 3, 3)."""
    from scipy import sparse

    size, axes = 3 * count, np.arange(3)
    rows, columns, values = [], [], []
    first, second = (paths.nodes[row] for row in paths.couples.T)
    for one, sign in ((0, -1.0), (1, 1.0)):
        for other, other_sign in ((0, -1.0), (1, 1.0)):
            a, b = first[:, one], second[:, other]
            rows.append(np.broadcast_to(3 * a[:, None, None] + axes[:, None], blocks.shape).ravel())
            columns.append(np.broadcast_to(3 * b[:, None, None] + axes, blocks.shape).ravel())
            values.append((sign * other_sign * blocks).ravel())
    return sparse.csr_matrix(
        (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=(size, size)
    )


def _largest(W: Any, K: Any) -> float:
    """λmax of W K, both symmetric and positive semidefinite."""
    product = (W @ K).tocsr()
    if product.nnz == 0:
        return 0.0
    if product.shape[0] <= DENSE:
        return float(np.abs(np.linalg.eigvals(product.toarray())).max())
    x = np.random.default_rng(0).normal(size=product.shape[0])
    size = 0.0
    for _ in range(ITERATIONS):
        x = product @ x
        size = float(np.linalg.norm(x))
        if size == 0.0:
            return 0.0
        x /= size
    return size
