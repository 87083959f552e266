"""Rods, point masses and bodies in small motions: their coordinates, masses and how nodes move with them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from tensegrity_mj.basics.arrays import Array, IntArray, cross, norm
from tensegrity_mj.model.bodies import Frame
from tensegrity_mj.model.forest import spanning_forest
from tensegrity_mj.model.rods import directions, inertia_of_rods
from tensegrity_mj.model.structure import Structure

SLOTS = 5  # coordinates each; one more where rods lengthen, which are elastic, and where there are rigid bodies


@dataclass(frozen=True, eq=False)
class Bodies:
    """Data of a structure that do not depend on its state; B bodies, N nodes.

    Attributes:
        body: (N,) of each node, the first in the forest of those that share it; B for a fixed one.
        lever: (N,) [m] from the point at σ of that body to the node, along b.
        ends: (R, 2) [m] from the point at σ of a rod to its ends, along b.
        joints: (J, 3) node, its body, and another body that ends there.
        mass, f, J: (B,) of (2.30); f = 0 and J = 1 for a point mass.
        length, sigma: (R,) of the rods.
        E: (B, 3, 3) translations, padded with zero columns.
        planes: (R, 3) unit normals of planar rods, zero for others.
    """

    structure: Structure
    body: IntArray
    lever: Array
    ends: Array
    joints: IntArray
    mass: Array
    f: Array
    J: Array
    length: Array
    sigma: Array
    E: Array
    planes: Array

    @classmethod
    def of(cls, structure: Structure) -> Bodies:
        """The bodies of a structure."""
        R, P, frames = len(structure.rods), len(structure.lone_masses), structure.moving_frames
        B = R + P + len(frames)
        body = np.full(len(structure.nodes), B)
        lever = np.zeros(len(structure.nodes))
        E, planes = np.zeros((B, 3, 3)), np.zeros((R, 3))
        sigma = np.array([rod.support.sigma for rod in structure.rods], float)
        length = structure.rod_lengths
        f, J = np.zeros(B), np.ones(B)
        f[:R], J[:R] = inertia_of_rods(structure)
        more = [*(point.mass for point in structure.lone_masses), *(frame.masses.sum() for frame in frames)]
        mass = np.concatenate([structure.rod_masses, more])
        ends = np.stack([-sigma * length, (1 - sigma) * length], axis=1)
        forest = spanning_forest(structure)
        for rod in forest.order[::-1]:  # so that the first one stays
            body[structure.rod_nodes[rod]], lever[structure.rod_nodes[rod]] = rod, ends[rod]
        joints = np.array(forest.joints, np.int64).reshape(-1, 3)
        for number, rod in enumerate(structure.rods):
            basis = rod.support.translation_basis
            E[number, :, : basis.shape[1]] = basis
            if rod.support.plane is not None:
                planes[number] = np.array(rod.support.plane) / np.linalg.norm(rod.support.plane)
        for number, point in enumerate(structure.lone_masses):
            body[structure.node_index[point.node]] = R + number
            basis = point.translation_basis
            E[R + number, :, : basis.shape[1]] = basis
        for number, frame in enumerate(frames, R + P):
            body[frame.rows], E[number] = number, np.eye(3)
        return cls(structure, body, lever, ends, joints, mass, f, J, length, sigma, E, planes)

    @property
    def frames(self) -> list[tuple[int, Frame]]:
        """Bodies other than rods and point masses, with their numbers."""
        frames = self.structure.moving_frames
        return list(enumerate(frames, len(self.mass) - len(frames)))

    @cached_property
    def joint_ends(self) -> IntArray:
        """(J, 2) which end, 0 or 1, of each joint's two bodies is there."""
        return (self.structure.rod_nodes[self.joints[:, 1:], 1] == self.joints[:, :1]).astype(int)

    @cached_property
    def slots(self) -> int:
        """Coordinates of each body."""
        return SLOTS + bool(self.structure.elastic.any() or self.structure.moving_frames)

    @property
    def mobilities(self) -> Array:
        """(N,) [1/kg] bound on what a force at a node accelerates it by: that of a free rod, 0 for a fixed node."""
        moment = self.J - self.f**2 / self.mass  # about the center of mass
        per_body_mass, per_body_moment = np.append(1 / self.mass, 0.0), np.append(1 / moment, 0.0)
        # From the center of mass, r + (f/m) b.
        arm = self.lever - np.append(self.f / self.mass, 0.0)[self.body]
        found = np.asarray(per_body_mass[self.body] + arm**2 * per_body_moment[self.body])
        for _, frame in self.frames:
            found[frame.rows] += np.sum(frame.offsets**2, axis=1) / np.linalg.eigvalsh(frame.inertia)[0]
        return found


class Motion(NamedTuple):
    """Derivatives of the node positions by the coordinates y."""

    b: Array  # (R, 3)
    T: Array  # (B, 3, slots - 3) the ways that b can turn, and lengthen
    inverse: Array  # (B, slots, slots) L⁻ᵀ
    turned: Array  # (N, 3, slots) X


def motion_of_bodies(bodies: Bodies, nodes: Array) -> Motion:
    """Compute the small motions of a structure's bodies about these node positions (N, 3) [m]."""
    R, B, slots = len(bodies.length), len(bodies.mass), bodies.slots
    b = directions(bodies.structure, nodes)
    b = b / norm(b)[:, None]
    planar = np.any(bodies.planes != 0, axis=1)
    one = cross(np.where(planar[:, None], bodies.planes, np.eye(3)[np.argmin(np.abs(b), axis=1)]), b)
    one = one / norm(one)[:, None]
    T = np.zeros((B, 3, slots - 3))
    T[:R, :, 2:] = np.where(bodies.structure.elastic[:, None], b, 0.0)[:, :, None]
    T[:R, :, 0] = one
    T[:R, :, 1] = np.where(planar[:, None], 0.0, cross(b, one))

    M = np.zeros((B, slots, slots))
    M[:, :3, :3] = bodies.mass[:, None, None] * np.eye(3)
    M[:, 3:, 3:] = bodies.J[:, None, None] * np.eye(slots - 3)
    coupling = bodies.f[:, None, None] * (np.swapaxes(bodies.E, 1, 2) @ T)
    M[:, :3, 3:], M[:, 3:, :3] = coupling, np.swapaxes(coupling, 1, 2)
    for number, frame in bodies.frames:
        rotation = frame.placed(nodes)[1]
        M[number, 3:, 3:] = rotation @ frame.inertia @ rotation.T
    inverse = np.swapaxes(np.linalg.inv(np.linalg.cholesky(M)), 1, 2)

    moved = np.zeros((B + 1, 3, slots))
    moved[:B, :, :3] = bodies.E
    levered = np.zeros((B + 1, 3, slots))
    levered[:B, :, 3:] = T
    padded = np.zeros((B + 1, slots, slots))
    padded[:B] = inverse
    turned = (moved[bodies.body] + bodies.lever[:, None, None] * levered[bodies.body]) @ padded[bodies.body]
    for number, frame in bodies.frames:
        turned[frame.rows] = frame.motions(nodes)[frame.rows] @ inverse[number]
    return Motion(b, T, inverse, turned)
