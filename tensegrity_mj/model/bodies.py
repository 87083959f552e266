"""Rigid bodies other than rods: nodes placed rigidly on a mass with moments of inertia."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tensegrity_mj.basics.arrays import Array, IntArray
from tensegrity_mj.basics.fields import field, refused, value
from tensegrity_mj.basics.kinds import flag, pair, positive, printable_name, rows, vector
from tensegrity_mj.errors import StructureError
from tensegrity_mj.model.members import Vector

if TYPE_CHECKING:
    from tensegrity_mj.model.structure import Structure

# Tolerance of I1 + I2 = I3 for rounded numbers of a flat body, as a part of the largest moment of inertia.
ROUNDED = 1e-9
# Part of a body's size: nodes nearer to one plane than that do not determine its rotation.
FLAT = 1e-3


@value("body {name!r}", StructureError)
class Body:
    """A rigid body. Four of its nodes at least are not in one plane, so that nodes say how it stands.

    Attributes:
        name: unique among the bodies.
        nodes: names of the nodes that are placed on it, four or more.
        mass: [kg], > 0.
        inertia: moments about the centre of mass [kg m²] in the axes of the world, the structure at its reference:
            (Ixx, Iyy, Izz) or (Ixx, Iyy, Izz, Ixy, Ixz, Iyz).
        center: of mass [m], at the reference; the mean of its nodes by default.
        held: whether it stays where it is.
    """

    name: str = field(printable_name())
    nodes: tuple[str, ...] = field(pair("node", more=True))
    mass: float = field(positive("kg"))
    inertia: tuple[float, ...] = field(rows(need="three or six numbers")._replace(row=True))
    center: Vector | None = field(vector("m"), default=None, none="absent")
    held: bool = field(flag(), default=False)

    def __attrs_post_init__(self) -> None:
        if len(set(self.nodes)) < max(4, len(self.nodes)):
            raise refused(self, f"nodes = {list(self.nodes)}: it needs four or more, each of them once")
        if len(self.inertia) not in (3, 6):
            raise refused(
                self, f"inertia = {list(self.inertia)}: give [Ixx, Iyy, Izz], or [Ixx, Iyy, Izz, Ixy, Ixz, Iyz]"
            )
        low, middle, high = np.linalg.eigvalsh(self.inertia_matrix).tolist()
        if not (low > 0 and low + middle >= (1 - ROUNDED) * high):
            raise refused(
                self,
                f"inertia = {list(self.inertia)} has principal moments {low:.6g}, {middle:.6g}, {high:.6g} kg m²; "
                "those of a body are above zero, and none is larger than the sum of the other two",
            )

    @property
    def inertia_matrix(self) -> Array:
        """(3, 3) [kg m²]."""
        xx, yy, zz, xy, xz, yz = (*self.inertia, 0.0, 0.0, 0.0)[:6]
        return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])

    def times(self, factor: float) -> Body:
        """Return the body with its mass and moments of inertia times a factor."""
        return replace(self, mass=self.mass * factor, inertia=tuple(factor * x for x in self.inertia))

    def placed(self, frame: Frame, nodes: Array) -> Body:
        """Return the body moved to where nodes (N, 3) [m] place it."""
        center, rotation = frame.placed(nodes)
        return self.mapped(rotation, center - rotation @ (self.center or np.zeros(3)))

    def mapped(self, matrix: Array, shift: Array) -> Body:
        """Return the body turned by an orthogonal matrix (3, 3) and moved by a shift (3,) [m], as its nodes are."""
        I = matrix @ self.inertia_matrix @ matrix.T  # noqa: E741
        moments = (*np.diag(I).tolist(), float(I[0, 1]), float(I[0, 2]), float(I[1, 2]))
        center = None if self.center is None else (matrix @ np.array(self.center) + shift).tolist()
        return replace(self, inertia=moments if any(moments[3:]) else moments[:3], center=center)


class Frame(NamedTuple):
    """A body by its n nodes, about which all is linear: x = r + L ξ, with r its centre of mass.

    Attributes:
        rows: (n,) of its nodes.
        offsets: ξ (n, 3) [m], from the centre at the reference.
        fit: (4, n): r, and the rows of Lᵀ, of node positions (n, 3); of velocities their rates.
        second: (3, 3) [kg m²] ∫ ξ ξᵀ dm.
        masses: (n, n) [kg] of the kinetic energy ½ Σ m_ab v_a·v_b.
    """

    rows: IntArray
    offsets: Array
    fit: Array
    second: Array
    masses: Array

    @property
    def inertia(self) -> Array:
        """(3, 3) [kg m²] about the centre of mass, at the reference."""
        return np.asarray(np.trace(self.second) * np.eye(3) - self.second)

    def placed(self, nodes: Array) -> tuple[Array, Array]:
        """r (3,) and the rotation (3, 3) that comes nearest, of the nodes (N, 3) of a structure."""
        fitted = self.fit @ nodes[self.rows]
        left, _, right = np.linalg.svd(fitted[1:].T)
        turned = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
        return fitted[0], turned

    def moving(self, nodes: Array, velocities: Array) -> tuple[Array, Array]:
        """ṙ (3,) and the angular velocity (3,) in the world, of node positions and velocities (N, 3)."""
        fitted, rotation = self.fit @ velocities[self.rows], self.placed(nodes)[1]
        spin = fitted[1:].T @ rotation.T
        return fitted[0], 0.5 * np.array([spin[2, 1] - spin[1, 2], spin[0, 2] - spin[2, 0], spin[1, 0] - spin[0, 1]])

    @property
    def base(self) -> IntArray:
        """(4,) which of its nodes span it best: where they are, all of it is."""
        from scipy.linalg import qr

        spread = np.hstack([np.ones((len(self.rows), 1)), self.offsets / np.abs(self.offsets).max()])
        return np.sort(qr(spread.T, mode="r", pivoting=True)[1][:4])

    @property
    def braces(self) -> IntArray:
        """(6, 2) rows of nodes whose distances keep it rigid."""
        corners = self.rows[self.base]
        return np.array([(corners[i], corners[j]) for i in range(4) for j in range(i)], np.int64)

    @property
    def followers(self) -> list[tuple[int, Array]]:
        """Rows of its other nodes, and the weights (4,) of `base` that place each."""
        affine = np.hstack([np.ones((len(self.rows), 1)), self.offsets])
        weights = affine @ np.linalg.inv(affine[self.base])
        return [(int(self.rows[k]), weights[k]) for k in range(len(self.rows)) if k not in self.base]

    def motions(self, nodes: Array) -> Array:
        """(N, 3, 6): how nodes (N, 3) move with it, by three shifts and three turns about its centre of mass."""
        moved = np.zeros((len(nodes), 3, 6))
        moved[self.rows, :, :3] = np.eye(3)
        away = nodes[self.rows] - self.fit[0] @ nodes[self.rows]
        for axis in range(3):
            moved[self.rows, :, 3 + axis] = np.cross(np.eye(3)[axis], away)
        return moved

    def mobility(self, nodes: Array) -> Array:
        """(3n, 3n) [1/kg]: how forces on its nodes, where nodes (N, 3) are, accelerate them from rest."""
        X = self.motions(nodes)[self.rows].reshape(-1, 6)
        return np.asarray(X @ np.linalg.solve(X.T @ np.kron(self.masses, np.eye(3)) @ X, X.T))

    @property
    def edges(self) -> IntArray:
        """(e, 2) of the hull of its nodes, by their number in the body: what pictures draw."""
        from scipy.spatial import ConvexHull

        corners = ConvexHull(self.offsets).simplices
        return np.unique(np.sort(np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [0, 2]]])), axis=0)

    def out_of_shape(self, nodes: Array) -> float:
        """Return the largest deviation [m] of a node from its place on the body."""
        r, rotation = self.placed(nodes)
        return float(np.abs(nodes[self.rows] - r - self.offsets @ rotation.T).max())

    def strain_rate(self, nodes: Array, velocities: Array) -> float:
        """Return the largest deviation [m/s] of a node's velocity from that of its place on the body."""
        r_rate, spin = self.moving(nodes, velocities)
        turning = np.cross(spin, nodes[self.rows] - self.placed(nodes)[0])
        return float(np.abs(velocities[self.rows] - r_rate - turning).max())


def frame_of(structure: Structure, body: Body) -> Frame:
    """A body of a structure by its nodes.

    Raises:
        StructureError: where its nodes lie in a plane.
    """
    rows = np.array([structure.node_index[name] for name in body.nodes], np.int64)
    places = structure.positions[rows]
    offsets = places - (places.mean(axis=0) if body.center is None else np.array(body.center))
    spread = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
    if spread[2] <= FLAT * spread[0]:
        raise StructureError(
            f"body '{body.name}': its nodes lie in a plane, or nearly so, and do not say how it is turned: name one "
            "more node of it off that plane, to which nothing need be attached"
        )
    size = float(spread[0])
    fit = np.linalg.pinv(np.hstack([np.ones((len(rows), 1)), offsets / size]))
    fit[1:] /= size
    second = 0.5 * np.trace(body.inertia_matrix) * np.eye(3) - body.inertia_matrix
    masses = body.mass * np.outer(fit[0], fit[0]) + fit[1:].T @ second @ fit[1:]
    return Frame(rows, offsets, fit, second, masses)
