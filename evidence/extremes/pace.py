"""Pace of a scene at its start, so that the study can choose steps and durations that mean something.

Nodes answer forces by the mobility W: v̇ = W f, block by block of the bodies of `vibration`; strings answer
displacements by the stiffness K, material and geometric. The fastest vibration has ω² = λmax(W K), the fastest decay
λmax(W C). This is a rougher thing than `stability`, so that the study can also try what that warns of.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.model.rigidity import members_at
from tensegrity_mj.model.rods import Bars
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.strings import Paths
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.vibration.blocks import spring_blocks
from tensegrity_mj.vibration.bodies import Bodies, motion_of_bodies

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
    """W (3N, 3N) sparse: accelerations of the nodes [m/s²] for forces on them [N], from rest; joints hold nothing."""
    from scipy import sparse

    bodies = Bodies.of(structure)
    motion = motion_of_bodies(bodies, nodes)
    count = len(bodies.length)
    # For each rod's two ends, all others with a node there; then for the nodes of other bodies.
    slides = (bodies.E @ motion.inverse[:, :3])[:count]
    ends = slides + bodies.ends.T[..., None, None] * (motion.T @ motion.inverse[:, 3:])[:count]
    others = np.flatnonzero((bodies.body >= count) & (bodies.body < len(bodies.mass)))
    blocks = np.concatenate([*ends, motion.turned[others]])
    rows = np.concatenate([*structure.rod_nodes.T, others])
    columns = np.concatenate([np.arange(count), np.arange(count), bodies.body[others]])
    order = np.argsort(rows, kind="stable")
    starts = np.searchsorted(rows[order], np.arange(len(nodes) + 1))
    shape = (3 * len(nodes), bodies.slots * len(bodies.mass))
    X = sparse.bsr_array((blocks[order], columns[order], starts), shape=shape)  # how nodes move with bodies of mass 1
    return X @ X.T


def _assembled(paths: Paths, count: int, blocks: Array) -> Any:
    """Σ over couples of segments of (e_j - e_i) block (e_j - e_i)ᵀ, (3N, 3N) sparse, from blocks (P, 3, 3)."""
    from scipy import sparse

    number = np.arange(len(blocks) + 1)
    signs = np.tile([-1.0, 1.0], len(blocks))
    first, second = (
        sparse.kron(sparse.csr_array((signs, paths.nodes[row].ravel(), 2 * number), (len(blocks), count)), np.eye(3))
        for row in paths.couples.T
    )
    size = 3 * len(blocks)
    return first.T @ sparse.bsr_array((blocks, number[:-1], number), shape=(size, size)) @ second


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
