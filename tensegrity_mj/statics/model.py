"""Model of statics: the potential of strings, weights and loads over the positions of the nodes.

    Π(x) = Σ ½ k (L - L0)₊² + Σ ½ κ ‖e‖² + Σ E - Σ m g·x - Σ f·x        x (3N,): node positions, one after another

with the energies E of elements of the scene that store their work; those of others push as they do at the start,

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

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from tensegrity_mj.basics.arrays import Array, IntArray
from tensegrity_mj.basics.checks import instance, member, real_array
from tensegrity_mj.engines.requirements import require
from tensegrity_mj.errors import OptionError, StructureError
from tensegrity_mj.model.elements.element import Element, Work, energy_of, forces_of, slopes_of
from tensegrity_mj.model.elements.resistance import bending_joints
from tensegrity_mj.model.redundancy import MOST_RODS
from tensegrity_mj.model.rigidity import Members, members_at, spans_at
from tensegrity_mj.model.rods import lumped_masses
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.strings import TensionCurves
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.statics.boundary import Boundary, Hold
from tensegrity_mj.statics.stress_signs import strings_named

RANK = 1e-9  # of the largest singular value
EPS = float(np.finfo(float).eps)


class Rods(enum.Enum):
    """Treatment of rods without a stiffness of their own: they keep their lengths, or stretch by their sections' EA."""

    RIGID = "rigid"
    ELASTIC = "elastic"


@dataclass(frozen=True, eq=False)
class StaticModel:
    """A problem of statics; N nodes, R rods, M strings, n = 3N. Rods are here all that keep distances: `bars`.

    Attributes:
        scene: what it is of; its gravity, its loads at t = 0 and the bending stiffness of joints count, but neither
            contact nor what resists motion.
        start: (N, 3) [m] where the nodes are before anything is solved for; holds refer to it.
        rest_lengths: L0 (M,) [m].
        whole: (M,) whether a string is not broken.
        rod_lengths: ℓ (R,) [m] without force.
        compliance: 1/k, or ℓ/EA, (R,) [m/N]; zero for rigid rods.
        forces: (N, 3) [N] weights, loads, wind, water, and elements without energy, at rest where the model starts.
        loads: (N, 3) [N] further loads, which a path multiplies by its parameter.
        holds: further boundary conditions, whose displacements a path multiplies by its parameter.
    """

    scene: Scene
    start: Array
    rest_lengths: Array
    whole: NDArray[np.bool_]
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
            rods: rigid, or elastic: then every rod needs a `stiffness` or a `section`. One with a stiffness always is.
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
        instance("scene", scene, Scene, "use a Scene or a Structure, or load_scene(name or path)")
        require(None, scene, "statics")
        member("rods", rods, Rods)
        structure = scene.structure
        count, strings = len(structure.nodes), len(structure.strings)
        if isinstance(holds, Hold):
            holds = (holds,)
        if not isinstance(broken, Iterable):
            raise OptionError(f"broken = {broken!r}; give names of strings")
        given = structure.rest_lengths if rest_lengths is None else real_array("rest_lengths", rest_lengths, (strings,))
        start = scene.nodes0 if nodes is None else real_array("nodes", nodes, (count, 3), "m", scalar=False)
        extra = np.zeros((count, 3)) if loads is None else real_array("loads", loads, (count, 3), "N", scalar=False)
        compliance = 1.0 / structure.rod_stiffness
        if rods is Rods.ELASTIC:
            for row, rod in enumerate(structure.rods):
                if rod.stiffness is not None:
                    continue
                if rod.section is None:
                    raise StructureError(
                        f"rod '{rod.name}' has no section, so its stiffness EA is unknown; give it one "
                        "(structure.with_sections(Section.tube(...))), or use Rods.RIGID"
                    )
                compliance[row] = structure.rod_lengths[row] / rod.section.axial_stiffness
        braces = members_at(_braces(structure), structure.positions)
        model = cls(
            scene=scene,
            start=np.array(start, float),
            rest_lengths=np.array(given, float),
            whole=~strings_named("broken", broken, structure),
            rod_lengths=np.concatenate([structure.rod_lengths, braces.lengths]),
            compliance=np.concatenate([compliance, np.zeros(len(braces.lengths))]),
            forces=weights_and_loads(scene, np.array(start, float)),
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
    def curves(self) -> TensionCurves:
        """The strings' tensions; none of a broken one. Those that yield go on along their curves."""
        return self.structure.curves.only(self.whole)

    @cached_property
    def bars(self) -> IntArray:
        """(R, 2) node rows of the rods, and of six braces that keep each body rigid."""
        return np.concatenate([self.structure.rod_nodes, _braces(self.structure)])

    @cached_property
    def elements(self) -> tuple[Element, ...]:
        """Elements of the scene that store energy."""
        return tuple(one for one in self.scene.elements if one.work is Work.STORED)

    def element_forces(self, x: Array) -> Array:
        """(3N,) [N]: minus the gradient of the elements' energy at x (3N,)."""
        nodes = x.reshape(-1, 3)
        return forces_of(self.elements, self.scene, float(self.scene.start_time), nodes, np.zeros_like(nodes)).ravel()

    def element_stiffness(self, x: Array) -> Array:
        """(3N, 3N) [N/m] the Hessian of the elements' energy at x (3N,), symmetric."""
        nodes = x.reshape(-1, 3)
        K = slopes_of(self.elements, self.scene, float(self.scene.start_time), nodes, np.zeros_like(nodes))[0]
        return np.asarray(0.5 * (K + K.T))

    @cached_property
    def boundary(self) -> Boundary:
        """Supports and holds."""
        return Boundary.of(self.structure, self.holds)

    @cached_property
    def has_redundant_rods(self) -> bool:
        """True where rigid rods have states of self-stress at the start; not checked for more than `MOST_RODS` rods."""
        rigid = np.flatnonzero(self.compliance == 0)
        if not 0 < len(rigid) <= MOST_RODS:
            return False
        slopes = (self.rod_slopes(self.start.ravel())[rigid] @ self.boundary.Z).toarray()
        return int(np.linalg.matrix_rank(slopes, rtol=RANK)) < len(rigid)

    @cached_property
    def _element_diagonal(self) -> Array:
        """[N/m] sizes of the elements' stiffness at the start."""
        return np.abs(self.element_stiffness(self.start.ravel()).diagonal()) if self.elements else np.zeros(0)

    @cached_property
    def scale(self) -> tuple[float, float]:
        """A typical length [m] and stiffness [N/m]: of the mean member, and of the stiffest string, joint or load."""
        span = np.concatenate([self.rod_lengths, self.structure.string_lengths(self.start)])
        length = float(span.mean()) if span.size else 1.0
        weight = float(np.abs(self.forces).max(initial=0.0) + np.abs(self.loads).max(initial=0.0))
        bent = 0.0 if self.bending_stiffness is None else float(self.bending_stiffness.diagonal().max())
        own = float(self._element_diagonal.max(initial=0.0))
        return length, max(float(self.curves.steepest.max(initial=0.0)), bent, own, weight / length) or 1.0

    @cached_property
    def stiffest(self) -> tuple[float, float]:
        """Largest resistances: [N] to a strain of 1 of a rod and a bend of 1 rad of a joint; [N/m] of any member."""
        axial = 1.0 / self.compliance[self.compliance > 0]
        strained = float(np.max(self.rod_lengths[self.compliance > 0] * axial, initial=0.0))
        stiffness = max(float(np.max(k, initial=0.0)) for k in (self.curves.steepest, axial, self._element_diagonal))
        if self.bends is None or self.bending_stiffness is None:
            return strained, stiffness
        bent = float(np.max(self.bends.data**2 * self.rod_lengths[self.bends.indices // 3]))
        return strained + bent, max(stiffness, float(self.bending_stiffness.diagonal().max()))

    @cached_property
    def bends(self) -> sparse.csr_array | None:
        """(3J, 3R) [√(N m)/m]: from the spans of the rods to √κ e of the J bent joints; None without bending stiffness.

        It acts on spans, not on positions: rods far from the origin then bend as exactly as those near it.
        """
        bending = None if self.scene.resistance is None else self.scene.resistance.bending
        joints = bending_joints(self.structure, bending)
        if bending is None or not joints or bending.stiffness == 0:
            return None
        out = sparse.lil_array((3 * len(joints), 3 * len(self.rod_lengths)))
        for row, joint in enumerate(joints):
            for rod, tail, side in zip(joint.rods, joint.nodes[:2], (1.0, -1.0), strict=True):
                # Along the two rods: to the joint, and away from it.
                along = side if self.bars[rod, 0] == tail else -side
                for k in range(3):
                    out[3 * row + k, 3 * rod + k] = along * np.sqrt(bending.stiffness) / self.rod_lengths[rod]
        return sparse.csr_array(out)

    @cached_property
    def bending_stiffness(self) -> sparse.csr_array | None:
        """(3N, 3N) [N/m] the Hessian of the bent joints' energy, which is constant; None without."""
        if self.bends is None:
            return None
        count = len(self.rod_lengths)
        ends = sparse.csr_array(
            (np.tile([-1.0, 1.0], count), (np.repeat(np.arange(count), 2), self.bars.ravel())),
            shape=(count, len(self.structure.nodes)),
        )
        rates = sparse.csr_array(self.bends @ sparse.kron(ends, sparse.eye_array(3)))
        return sparse.csr_array(rates.T @ rates)

    @cached_property
    def _blocks(self) -> tuple[IntArray, IntArray]:
        paths, rods = self.structure.paths, self.bars
        first, second = (np.concatenate([paths.nodes[rows], rods]) for rows in paths.couples.T)
        return block_places(first, second)

    def _spans(self, x: Array) -> Array:
        return spans_at(self.bars, x.reshape(-1, 3)).ravel()

    # ---------------------------------------------------------------------------------------------- at given nodes

    def segments(self, x: Array) -> Members:
        """Lengths and directions of the strings' segments at x (3N,)."""
        return members_at(self.structure.paths.nodes, x.reshape(-1, 3))

    def lengths(self, x: Array) -> Array:
        """(M,) [m] of the strings."""
        return np.asarray(self.structure.paths.total(self.segments(x).lengths))

    def rods(self, x: Array) -> Members:
        """Lengths and directions of the rods."""
        return members_at(self.bars, x.reshape(-1, 3))

    def tensions(self, lengths: Array) -> Array:
        """(M,) [N]."""
        return self.curves.tension(lengths - self.rest_lengths)

    def external(self, parameter: float = 1.0) -> Array:
        """(3N,) [N]: weights, loads, and the further loads times the parameter."""
        return np.asarray((self.forces + parameter * self.loads).ravel())

    def energy(self, x: Array, parameter: float = 1.0) -> float:
        """Π [J] at x (3N,): strings, bent joints and external forces, without elastic rods."""
        bent = 0.0 if self.bends is None else 0.5 * float(np.sum((self.bends @ self._spans(x)) ** 2))
        # From the start, so that heavy things far from the origin leave digits for the rest.
        work = float(self.external(parameter) @ (x - self.start.ravel()))
        own = float(energy_of(self.elements, self.scene, x.reshape(-1, 3))) if self.elements else 0.0
        return self.curves.total_energy(self.lengths(x) - self.rest_lengths) + bent + own - work

    def rod_energy(self, x: Array) -> float:
        """½ Σ (EA/ℓ) (L - ℓ)² [J] of the elastic rods."""
        elastic = self.compliance > 0
        stretch = (self.rods(x).lengths - self.rod_lengths)[elastic]
        return 0.5 * float(np.sum(stretch**2 / self.compliance[elastic]))

    def gradient(self, x: Array, parameter: float = 1.0) -> Array:
        """∇Π (3N,) [N]."""
        out = -self.external(parameter)
        paths, (lengths, directions) = self.structure.paths, self.segments(x)
        tensions = self.tensions(paths.total(lengths))[paths.strings]
        add_spans(out, paths.nodes, tensions[:, None] * directions)
        if self.bends is not None:
            bent = self.bends.T @ (self.bends @ self._spans(x))
            add_spans(out, self.bars, bent.reshape(-1, 3))
        if self.elements:
            out -= self.element_forces(x)
        return out

    def rod_pulls(self, x: Array, rod_forces: Array) -> Array:
        """Cᵀ N (3N,) [N] for axial forces N (R,)."""
        out = np.zeros_like(x)
        add_spans(out, self.bars, rod_forces[:, None] * self.rods(x).directions)
        return out

    def hessian(self, x: Array, rod_forces: Array) -> sparse.csr_array:
        """∇²Π + Σ N ∇²L (3N, 3N) [N/m] for axial forces N (R,) of the rods."""
        values, places = self._hessian_entries(x, rod_forces)
        K = sparse.csr_array(sparse.coo_array((values, places), shape=(len(x), len(x))))
        if self.elements:
            K = sparse.csr_array(K + sparse.csr_array(self.element_stiffness(x)))
        return K if self.bending_stiffness is None else sparse.csr_array(K + self.bending_stiffness)

    def dense_hessian(self, x: Array, rod_forces: Array) -> Array:
        """Return the Hessian as a dense array; faster than the sparse one for few nodes."""
        n = len(x)
        values, (rows, columns) = self._hessian_entries(x, rod_forces)
        K: Array = np.bincount(rows * n + columns, values, n * n).astype(float).reshape(n, n)
        if self.elements:
            K = K + self.element_stiffness(x)
        return K if self.bending_stiffness is None else K + self.bending_stiffness.toarray()

    def _hessian_entries(self, x: Array, rod_forces: Array) -> tuple[Array, tuple[IntArray, IntArray]]:
        """Return the sums of strings' and rods' entries of the Hessian, and their places; without bending."""
        paths, (parts, s) = self.structure.paths, self.segments(x)
        lengths = paths.total(parts)
        first, second = paths.couples.T
        along = s[first, :, None] * s[second, None, :]
        taut = self.curves.slope(lengths - self.rest_lengths, loading=True)[paths.strings[first], None, None]
        across = self.tensions(lengths)[paths.strings] / np.where(parts > 0, parts, 1.0)
        turning = np.where(first == second, across[first], 0.0)[:, None, None]
        blocks = (taut - turning) * along + turning * np.eye(3)
        lengths, b = self.rods(x)
        turned = (rod_forces / lengths)[:, None, None] * (np.eye(3) - b[:, :, None] * b[:, None, :])
        return np.concatenate([block_values(blocks), block_values(turned)]), self._blocks

    def rod_slopes(self, x: Array) -> sparse.csr_array:
        """C (R, 3N): how the rods' lengths change."""
        values, (rows, columns) = self._slope_entries(x)
        return sparse.csr_array((values, (rows, columns)), shape=(len(self.rod_lengths), len(x)))

    def dense_rod_slopes(self, x: Array) -> Array:
        """Return the slopes of the rods' lengths as a dense array."""
        values, places = self._slope_entries(x)
        C = np.zeros((len(self.rod_lengths), len(x)))
        C[places] = values
        return C

    def _slope_entries(self, x: Array) -> tuple[Array, tuple[IntArray, IntArray]]:
        pairs, b = self.bars, self.rods(x).directions
        columns = (3 * pairs[:, :, None] + np.arange(3)).reshape(-1)
        return np.stack([-b, b], axis=1).reshape(-1), (np.repeat(np.arange(len(pairs)), 6), columns)

    def rod_forces_from_lengths(self, x: Array, rod_forces: Array) -> Array:
        """N (R,): of elastic rods from their lengths, of rigid ones as given."""
        elastic = self.compliance > 0
        out = np.array(rod_forces)
        out[elastic] = ((self.rods(x).lengths - self.rod_lengths)[elastic]) / self.compliance[elastic]
        return out

    def reactions(self, x: Array, rod_forces: Array, parameter: float = 1.0) -> Array:
        """(N, 3) [N]: what supports and holds push the nodes with, in equilibrium."""
        return np.asarray((self.gradient(x, parameter) + self.rod_pulls(x, rod_forces)).reshape(-1, 3))


def _braces(structure: Structure) -> IntArray:
    """(b, 2) node rows between which bodies that are not held keep their distances."""
    return np.concatenate([np.zeros((0, 2), np.int64), *(frame.braces for frame in structure.moving_frames)])


def steady_forces(scene: Scene, nodes: Array) -> Array:
    """(N, 3) [N]: what loads, wind, water and elements without energy push nodes (N, 3) with, at rest at t = 0."""
    others = [one for one in scene.effects if one.work is not Work.STORED]
    return forces_of(others, scene, float(scene.start_time), nodes, np.zeros_like(nodes))


def weights_and_loads(scene: Scene, nodes: Array) -> Array:
    """(N, 3) [N]: `steady_forces` and weights."""
    return np.asarray(lumped_masses(scene.structure)[:, None] * np.array(scene.gravity) + steady_forces(scene, nodes))


def round_off(model: StaticModel, x: Array, parameter: float, rod_forces: Array) -> float:
    """[N] what round-off leaves of forces that cancel at x (3N,), under axial forces N (R,) of the rods.

    Lengths and directions have errors of some ε, which strings' and elastic rods' stiffness times their length, joints'
    bending stiffness over their rods' lengths, and all forces multiply. Positions have errors of ε times how far they
    are from the origin, which stiffness multiplies.
    """
    strained, stiffness = model.stiffest
    pulled = float(np.max(model.curves.steepest * model.lengths(x), initial=0.0))
    forces = (rod_forces, model.external(parameter), model.element_forces(x))
    largest = strained + pulled + sum(float(np.abs(part).max(initial=0.0)) for part in forces)
    return EPS * max(8 * largest + stiffness * float(np.abs(x).max(initial=0.0)), 1e-290)


def add_spans(out: Array, pairs: IntArray, pulls: Array) -> None:
    """Add to (3N,) forces that grow with the spans of members: plus at the second node, minus at the first."""
    places = out.reshape(-1, 3)
    np.add.at(places, pairs[:, 1], pulls)
    np.subtract.at(places, pairs[:, 0], pulls)


def block_places(first: IntArray, second: IntArray) -> tuple[IntArray, IntArray]:
    """Rows and columns of the four blocks of (3, 3) that couple two spans, of a member or of two: ii, jj, ij, ji."""
    k, m = np.repeat(np.arange(3), 3), np.tile(np.arange(3), 3)
    rows, columns = 3 * first[:, [0, 1, 0, 1]], 3 * second[:, [0, 1, 1, 0]]
    return (rows[:, :, None] + k).reshape(-1), (columns[:, :, None] + m).reshape(-1)


def block_values(blocks: Array) -> Array:
    """The numbers at these places, of one block (3, 3) each that couples the spans themselves."""
    flat = blocks.reshape(-1, 1, 9)
    return np.concatenate([flat, flat, -flat, -flat], axis=1).reshape(-1)
