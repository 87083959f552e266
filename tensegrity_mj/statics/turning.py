"""Moves that turn members as far as they are meant to, where a straight move of their nodes would stretch them.

A step of Newton's method is linear in the nodes: what turns by an angle θ grows by θ²/2 of its length. Long structures
gather turns, as a tower whose stages twist each against the next does, so that straight steps had to be the shorter the
longer it is. Here a node's turn ω is the one that fits best what its members' other ends do,

    min Σ ‖δe - ω × e‖²        e (3,) a member's span, δe its change in the step

each span is turned by the mean of its ends and keeps the change that is no turn, e' = R(ω) (e + δe - ω × e), and the
nodes are those whose spans fit e' best. For small ω that is the straight step to first order, so that the order of
Newton's method stays.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.linalg import expm
from scipy.sparse.linalg import splu
from scipy.spatial.transform import Rotation

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.model.rigidity import turned
from tensegrity_mj.statics.linear_systems import neutral_motions
from tensegrity_mj.statics.model import EPS, StaticModel

# Of the sum of squares of a node's spans: what resists turns that none shows, as of a straight chain about itself.
UNSEEN = 1e-6
# Of one span in the fit: what keeps nodes that no member holds in place, far below the (π/n)² of n members in a row.
LOOSE = 1e-9
ALIGNED = 30  # motions of the whole at most, of which each leaves a part of the last one; and round-offs left


class Turning:
    """The fit of spans and turns to a model's members, within its supports and holds."""

    def __init__(self, model: StaticModel) -> None:
        self.pairs = np.concatenate([model.bars, model.structure.paths.nodes])
        count, nodes = len(self.pairs), len(model.start)
        signs, places = np.tile([-1.0, 1.0], count), (np.repeat(np.arange(count), 2), self.pairs.ravel())
        ends = sparse.csr_array((signs, places), shape=(count, nodes))
        self.around = sparse.csr_array(abs(ends).T)
        self.Z = model.boundary.Z
        self.spans = sparse.csr_array(sparse.kron(ends, sparse.eye_array(3)) @ self.Z)
        loose = LOOSE * sparse.eye_array(self.Z.shape[1], format="csc")
        self.fit = splu(sparse.csc_array(self.spans.T @ self.spans + loose))

    def move(self, x: Array, step: Array) -> tuple[Array, float]:
        """The move (3N,) [m] that a step (3N,) at x (3N,) means, and by how much it changes a member at most [m].

        That is the largest change of a span that is no turn, or a span's length times the turn of one end against the
        other.
        """
        i, j = self.pairs.T
        nodes, moved = x.reshape(-1, 3), step.reshape(-1, 3)
        e, change = nodes[j] - nodes[i], moved[j] - moved[i]
        square = np.einsum("mk,mk->m", e, e)
        resisting = square[:, None, None] * np.eye(3) - e[:, :, None] * e[:, None, :]
        A = (self.around @ resisting.reshape(-1, 9)).reshape(-1, 3, 3)
        A += (UNSEEN * np.trace(A, axis1=1, axis2=2) + (self.around @ square == 0))[:, None, None] * np.eye(3)
        turns = np.linalg.solve(A, (self.around @ np.cross(e, change))[:, :, None])[:, :, 0]
        turn = 0.5 * (turns[i] + turns[j])
        strain = change - np.cross(turn, e)
        bent = np.sqrt(square) * np.linalg.norm(turns[j] - turns[i], axis=1)
        largest = max(float(bent.max(initial=0.0)), float(np.linalg.norm(strain, axis=1).max(initial=0.0)))
        further = Rotation.from_rotvec(turn).apply(e + strain) - (e + change)
        return step + self.Z @ self.fit.solve(self.spans.T @ further.ravel()), largest


def nearest(model: StaticModel, x: Array, parameter: float, forces: Array) -> Array:
    """An equilibrium x (3N,) moved as one body, where nothing resists that, to where it is nearest to the start.

    `forces` are the rods' (R,) [N]. That does not depend on the way on which it was found.
    """
    start = model.start.ravel() + parameter * model.boundary.moved
    for _ in range(ALIGNED):
        free = neutral_motions(model, x, parameter, forces)
        back = free @ (free.T @ (start - x))
        if np.abs(back).max(initial=0.0) <= EPS * max(np.abs(x).max(initial=0.0), model.scale[0]) * ALIGNED:
            break
        nodes = x.reshape(-1, 3)
        centre = nodes.mean(axis=0)
        offsets = nodes - centre
        motions = np.hstack([np.tile(np.eye(3), (len(nodes), 1)), turned(offsets)])
        shift, turn = np.split(np.linalg.lstsq(motions, back)[0], 2)
        rate = np.zeros((4, 4))
        rate[:3] = np.column_stack([(turned(np.eye(3)) @ turn).reshape(3, 3).T, shift])
        moved = expm(rate)
        x = (centre + offsets @ moved[:3, :3].T + moved[:3, 3]).ravel()
    return x
