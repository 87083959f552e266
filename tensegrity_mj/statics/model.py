"""What statics reckons with: the potential of strings, weights and loads over the positions of the nodes.

    Π(x) = Σ ½ k (L - L0)₊² + Σ ½ κ ‖e‖² - Σ m g·x - Σ f·x        x (3N,): node positions, one after another

under rods of given length, L(x) = ℓ + N ℓ/EA, with the axial forces N [N] (positive in tension) as their multipliers:
a rigid rod has EA = ∞, and an elastic one enters by its compliance, so that one is the limit of the other. Equilibrium
is Zᵀ (∇Π + Cᵀ N) = 0, with C (R, 3N) the gradients of the rods' lengths and Z the free directions of `Boundary`.
Stiffness is K = ∇²Π + Σ N ∇²L on the motions that keep the rods' lengths; for elastic ones with Cᵀ (EA/ℓ) C.
"""

from __future__ import annotations

import enum
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from tensegrity_mj.checks import member, real_array
from tensegrity_mj.errors import InfeasibleError, OptionError, StructureError
from tensegrity_mj.resistance import bending_joints
from tensegrity_mj.rods import lumped_masses
from tensegrity_mj.scene import Scene
from tensegrity_mj.statics.boundary import Boundary, Hold
from tensegrity_mj.structure import Structure

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]


class Rods(enum.Enum):
    """Whether rods keep their lengths, or stretch by their sections' EA."""

    RIGID = "rigid"
    ELASTIC = "elastic"


class Members(NamedTuple):
    """Lengths (m,) [m] of members and their unit vectors (m, 3), from the first node to the second."""

    lengths: Array
    directions: Array


@dataclass(frozen=True, eq=False)
class StaticModel:
    """A problem of statics; N nodes, R rods, M strings, n = 3N.

    Attributes:
        scene: what it is of; its gravity, its loads at t = 0 and the bending stiffness of joints count, but neither
            contact nor what resists motion.
        start: (N, 3) [m] where the nodes are before anything is solved for; holds refer to it.
        rest_lengths: L0 (M,) [m].
        stiffness: k (M,) [N/m]; zero for a string that is broken.
        rod_lengths: ℓ (R,) [m] without force.
        compliance: ℓ/EA (R,) [m/N]; zero for rigid rods.
        forces: (N, 3) [N] weights and loads.
        loads: (N, 3) [N] further loads, which a path multiplies by its parameter.
        holds: further boundary conditions, whose displacements a path multiplies by its parameter.
    """

    scene: Scene
    start: Array
    rest_lengths: Array
    stiffness: Array
    rod_lengths: Array
    compliance: Array
    forces: Array
    loads: Array
    holds: tuple[Hold, ...] = ()

    @classmethod
    def of(
        cls,
        scene: Scene | Structure,
        *,
        rods: Rods = Rods.RIGID,
        nodes: ArrayLike | None = None,
        rest_lengths: ArrayLike | None = None,
        loads: ArrayLike | None = None,
        holds: Sequence[Hold] = (),
        broken: Sequence[str] = (),
    ) -> StaticModel:
        """The model of a scene.

        Args:
            scene: or a structure by itself, without weight.
            rods: rigid, or elastic: then every rod needs a `section`.
            nodes: (N, 3) [m] where to start; the scene's start by default. Rods keep the lengths of the structure.
            rest_lengths: (M,) [m]; the structure's by default.
            loads: (N, 3) [N] further loads, times the parameter of a path (1 in `find_equilibrium`).
            holds: further boundary conditions.
            broken: names of strings that carry nothing.

        Raises:
            OptionError: for arguments that do not fit.
            StructureError: where elastic rods lack a section.
        """
        if isinstance(scene, Structure):
            scene = Scene(scene)
        if not isinstance(scene, Scene):
            raise OptionError(f"scene = {scene!r}; use a Scene or a Structure, or load_scene(name or path)")
        member("rods", rods, Rods)
        structure = scene.structure
        count, strings = len(structure.nodes), len(structure.strings)
        names = [string.name for string in structure.strings]
        if isinstance(holds, Hold):
            holds = (holds,)
        if not isinstance(broken, Iterable):
            raise OptionError(f"broken = {broken!r}; give names of strings")
        for name in (broken,) if isinstance(broken, str) else broken:
            if name not in names:
                raise OptionError(f"broken: there is no string '{name}' in structure '{structure.name}'")
        whole = ~np.isin(names, list((broken,) if isinstance(broken, str) else broken)) if strings else np.ones(0, bool)
        given = structure.rest_lengths if rest_lengths is None else real_array("rest_lengths", rest_lengths, (strings,))
        start = scene.nodes0 if nodes is None else real_array("nodes", nodes, (count, 3), "m", scalar=False)
        extra = np.zeros((count, 3)) if loads is None else real_array("loads", loads, (count, 3), "N", scalar=False)
        weights = lumped_masses(structure)[:, None] * np.array(scene.gravity)
        compliance = np.zeros(len(structure.rods))
        if rods is Rods.ELASTIC:
            for row, rod in enumerate(structure.rods):
                if rod.section is None:
                    raise StructureError(
                        f"rod '{rod.name}' has no section, so its stiffness EA is unknown; give it one "
                        "(structure.with_sections(Section.tube(...))), or use Rods.RIGID"
                    )
                compliance[row] = structure.rod_lengths[row] / rod.section.axial_stiffness
        model = cls(
            scene=scene,
            start=np.array(start, float),
            rest_lengths=np.array(given, float),
            stiffness=np.where(whole, structure.stiffness, 0.0),
            rod_lengths=np.array(structure.rod_lengths),
            compliance=compliance,
            forces=weights + scene.nodal_forces(0.0),
            loads=np.array(extra, float),
            holds=tuple(holds),
        )
        model.boundary  # noqa: B018  its errors belong here
        return model

    def with_(self, **changes: object) -> StaticModel:
        """A copy with some attributes changed."""
        return replace(self, **changes)  # type: ignore[arg-type]

    # ------------------------------------------------------------------------------------------- what never changes

    @property
    def structure(self) -> Structure:
        """The structure."""
        return self.scene.structure

    @cached_property
    def boundary(self) -> Boundary:
        """Supports and holds."""
        return Boundary.of(self.structure, self.holds)

    @cached_property
    def scale(self) -> tuple[float, float]:
        """A length [m] and a stiffness [N/m] that are typical: the mean member, and the stiffest string or weight."""
        span = np.concatenate([self.rod_lengths, self.structure.string_lengths(self.start)])
        length = float(span.mean()) if span.size else 1.0
        weight = float(np.abs(self.forces).max(initial=0.0) + np.abs(self.loads).max(initial=0.0))
        return length, max(float(self.stiffness.max(initial=0.0)), weight / length) or 1.0

    @cached_property
    def _bending(self) -> sparse.csr_array | None:
        """The (constant) Hessian of the bent joints' energy."""
        bending = None if self.scene.resistance is None else self.scene.resistance.bending
        joints = bending_joints(self.structure, bending)
        if bending is None or not joints or bending.stiffness == 0:
            return None
        n = 3 * len(self.structure.nodes)
        e = sparse.lil_array((3 * len(joints), n))
        for row, joint in enumerate(joints):
            outer, node, other = joint.nodes
            a, b = (1.0 / self.rod_lengths[rod] for rod in joint.rods)
            for k in range(3):
                e[3 * row + k, 3 * node + k] = a + b
                e[3 * row + k, 3 * outer + k] = -a
                e[3 * row + k, 3 * other + k] = -b
        e = sparse.csr_array(e)
        return sparse.csr_array(bending.stiffness * (e.T @ e))

    @cached_property
    def _string_blocks(self) -> tuple[IntArray, IntArray]:
        return _block_places(self.structure.string_nodes)

    @cached_property
    def _rod_blocks(self) -> tuple[IntArray, IntArray]:
        return _block_places(self.structure.rod_nodes)

    # ---------------------------------------------------------------------------------------------- at given nodes

    def strings(self, x: Array) -> Members:
        """Lengths and directions of the strings at x (3N,)."""
        return _members(self.structure.string_nodes, x)

    def rods(self, x: Array) -> Members:
        """Lengths and directions of the rods."""
        return _members(self.structure.rod_nodes, x)

    def tensions(self, lengths: Array) -> Array:
        """(M,) [N]."""
        return self.stiffness * np.maximum(0.0, lengths - self.rest_lengths)

    def external(self, parameter: float = 1.0) -> Array:
        """(3N,) [N]: weights, loads, and the further loads times the parameter."""
        return np.asarray((self.forces + parameter * self.loads).ravel())

    def energy(self, x: Array, parameter: float = 1.0) -> float:
        """Π [J] at x (3N,): strings, bent joints and external forces, without elastic rods."""
        stretch = np.maximum(0.0, self.strings(x).lengths - self.rest_lengths)
        bent = 0.0 if self._bending is None else 0.5 * float(x @ (self._bending @ x))
        # From the start, so that heavy things far from the origin leave digits for the rest.
        work = float(self.external(parameter) @ (x - self.start.ravel()))
        return 0.5 * float(self.stiffness @ stretch**2) + bent - work

    def rod_energy(self, x: Array) -> float:
        """½ Σ (EA/ℓ) (L - ℓ)² [J] of the elastic rods."""
        elastic = self.compliance > 0
        stretch = (self.rods(x).lengths - self.rod_lengths)[elastic]
        return 0.5 * float(np.sum(stretch**2 / self.compliance[elastic]))

    def gradient(self, x: Array, parameter: float = 1.0) -> Array:
        """∇Π (3N,) [N]."""
        lengths, directions = self.strings(x)
        out = -self.external(parameter).reshape(-1, 3)
        pull = self.tensions(lengths)[:, None] * directions
        np.add.at(out, self.structure.string_nodes[:, 1], pull)
        np.add.at(out, self.structure.string_nodes[:, 0], -pull)
        return out.ravel() if self._bending is None else out.ravel() + self._bending @ x

    def hessian(self, x: Array, rod_forces: Array) -> sparse.csr_array:
        """∇²Π + Σ N ∇²L (3N, 3N) [N/m] for axial forces N (R,) of the rods."""
        n = len(x)
        lengths, s = self.strings(x)
        along = np.einsum("mi,mj->mij", s, s)
        tension = self.tensions(lengths)
        taut = np.where(lengths > self.rest_lengths, self.stiffness, 0.0)
        across = (tension / np.where(lengths > 0, lengths, 1.0))[:, None, None] * (np.eye(3) - along)
        blocks = taut[:, None, None] * along + across
        lengths, b = self.rods(x)
        turned = (rod_forces / lengths)[:, None, None] * (np.eye(3) - np.einsum("mi,mj->mij", b, b))
        rows, columns = (np.concatenate(pair) for pair in zip(self._string_blocks, self._rod_blocks, strict=True))
        values = np.concatenate([_block_values(blocks), _block_values(turned)])
        K = sparse.csr_array(sparse.coo_array((values, (rows, columns)), shape=(n, n)))
        return K if self._bending is None else sparse.csr_array(K + self._bending)

    def rod_slopes(self, x: Array) -> sparse.csr_array:
        """C (R, 3N): how the rods' lengths change."""
        pairs, b = self.structure.rod_nodes, self.rods(x).directions
        count = len(pairs)
        rows = np.repeat(np.arange(count), 6)
        columns = (3 * pairs[:, :, None] + np.arange(3)).reshape(-1)
        return sparse.csr_array((np.stack([-b, b], axis=1).reshape(-1), (rows, columns)), shape=(count, len(x)))

    def rod_forces_from_lengths(self, x: Array, rod_forces: Array) -> Array:
        """N (R,): of elastic rods from their lengths, of rigid ones as given."""
        elastic = self.compliance > 0
        out = np.array(rod_forces)
        out[elastic] = ((self.rods(x).lengths - self.rod_lengths)[elastic]) / self.compliance[elastic]
        return out

    def reactions(self, x: Array, rod_forces: Array, parameter: float = 1.0) -> Array:
        """(N, 3) [N]: what supports and holds push the nodes with, in equilibrium."""
        return np.asarray((self.gradient(x, parameter) + self.rod_slopes(x).T @ rod_forces).reshape(-1, 3))

    def require_held(self, parameter: float = 1.0) -> None:
        """Raise InfeasibleError where weights and loads push the whole along a straight line that nothing holds."""
        G, count = self.boundary.rows, len(self.structure.nodes)
        shifts = np.tile(np.eye(3), (count, 1))
        _, singular, right = np.linalg.svd(np.vstack([np.zeros((3, 3)), G @ shifts]))
        free = right[singular < 1e-9]
        force = free.T @ (free @ (self.external(parameter) @ shifts)) if len(free) else np.zeros(3)
        total = np.abs(self.external(parameter)).sum()
        if np.linalg.norm(force) > 1e-9 * total:
            raise InfeasibleError(
                f"'{self.scene.name}': weights and loads push the whole with ({force[0]:.6g}, {force[1]:.6g}, "
                f"{force[2]:.6g}) N, and nothing holds it in that direction: there is no equilibrium; give the "
                "structure a support, hold nodes, or take gravity out (gravity = (0, 0, 0))"
                + ("; statics leaves the scene's water and its buoyancy out" if self.scene.water is not None else "")
            )

    def neutral_motions(self, x: Array, parameter: float = 1.0, rod_forces: Array | None = None) -> Array:
        """Orthonormal motions (3N, p) of the whole as one body that change no energy: what no stiffness resists.

        Translations across the external forces, and turns about an axis to which all of these are parallel, as far as
        supports and holds leave them, and as far as these keep them on their way: a node that a guide holds on a
        straight line leaves the circle about an axis at once, and the reaction of the guide resists.

        Args:
            x: (3N,) [m].
            parameter: of the path.
            rod_forces: N (R,) [N] there; by default those that leave least.
        """
        from tensegrity_mj.statics.linear_systems import rod_forces as least

        nodes, Z = x.reshape(-1, 3), self.boundary.Z
        center = nodes.mean(axis=0)
        size = float(np.abs(nodes - center).max()) or 1.0
        shifts = [np.broadcast_to(axis, nodes.shape) for axis in np.eye(3)]
        turns = [np.cross(axis, (nodes - center) / size) for axis in np.eye(3)]
        bodies = np.array([motion.ravel() for motion in (*shifts, *turns)]).T
        forces = self.external(parameter)
        largest = float(np.abs(forces).max(initial=0.0))
        rows = [np.asarray(self.boundary.rows @ bodies)]

        def turned(force: Array) -> Array:
            """What turning does to forces (3N,), on the free coordinates (q, 6)."""
            out = np.zeros((len(forces), 6))
            for k, axis in enumerate(np.eye(3)):
                out[:, 3 + k] = np.cross(axis, force.reshape(-1, 3)).ravel()
            return np.asarray(Z.T @ out)

        if largest > 0:
            free = Z @ (Z.T @ forces) / largest
            rows += [(free @ bodies)[None], turned(free)]
        if self.boundary.rows.shape[0]:
            inside = self.gradient(x, parameter)
            N = least(self, x, inside) if rod_forces is None else rod_forces
            carried = np.concatenate([self.tensions(self.strings(x).lengths), N])
            scale = float(np.abs(carried).max(initial=0.0)) + largest
            held = inside + self.rod_slopes(x).T @ N
            if scale > 0:
                rows.append(turned((held - Z @ (Z.T @ held)) / scale))
        _, singular, right = np.linalg.svd(np.vstack([*rows, np.zeros((6, 6))]), full_matrices=False)
        found = bodies @ right[singular < 1e-7].T
        left, singular, _ = np.linalg.svd(found, full_matrices=False)
        # Nodes on one line: turning about it moves none; nearly on one: as little as the bound above lets through.
        return np.asarray(left[:, singular > 1e-6])


def _members(pairs: IntArray, x: Array) -> Members:
    nodes = x.reshape(-1, 3)
    span = nodes[pairs[:, 1]] - nodes[pairs[:, 0]]
    lengths = np.sqrt(np.einsum("mi,mi->m", span, span))
    # Nodes that coincide pull in no direction.
    return Members(lengths, span / np.where(lengths > 0, lengths, 1.0)[:, None])


def _block_places(pairs: IntArray) -> tuple[IntArray, IntArray]:
    """Rows and columns of the four blocks of (3, 3) of each member: ii, jj, ij, ji."""
    i, j = 3 * pairs[:, 0], 3 * pairs[:, 1]
    k, m = np.repeat(np.arange(3), 3), np.tile(np.arange(3), 3)
    first, second = np.stack([i, j, i, j], axis=1), np.stack([i, j, j, i], axis=1)
    return (first[:, :, None] + k).reshape(-1), (second[:, :, None] + m).reshape(-1)


def _block_values(blocks: Array) -> Array:
    flat = blocks.reshape(-1, 1, 9)
    return np.concatenate([flat, flat, -flat, -flat], axis=1).reshape(-1)
