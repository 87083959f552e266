"""Any structure as vectors of the world: where they are, how they move, and what keeps members rigid and supports held.

Moving nodes of rods and point masses are vectors y of their own, and a body has four, its centre of mass and its axes;
nodes that rods share are one vector, so that joints need no equation. Nodes are linear in the vectors, x = Φ y + x_f,
and so is what supports, planes and linear constraints hold, G y = g(t). With an orthonormal basis Z of what G leaves
free, y = Z s + G⁺ g(t): what is held neither drifts nor takes an unknown. Rods and bodies keep their shape by
products of vectors e = E y that are constant, e_a·e_b = const, whose multipliers μ follow from

    M ÿ = F - Eᵀ Jᵀ μ + Gᵀ ν,    J E ÿ + 2 κ ė_a·ė_b = 0,    κ = ½ where a = b, else 1.

J E W Eᵀ Jᵀ μ = J E ÿ₀ + 2 κ ė_a·ė_b then, W = Z (Zᵀ M Z)⁻¹ Zᵀ being the mobility of what is free and ÿ₀ the
acceleration without μ. Of a rod μ is its force density [N/m], positive in tension. The mass matrix is that of
velocities that are linear along rods (2.25). Nothing of it is the thesis' r and b, or MuJoCo's joints.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.engines.jax.arrays import Arrays, derivatives, incidence, lifted, times
from tensegrity_mj.errors import SceneError
from tensegrity_mj.model.capabilities import FUNCTION_MOTIONS
from tensegrity_mj.model.members import null_space_basis
from tensegrity_mj.model.motion import Motion
from tensegrity_mj.model.scene import Scene

RANK_TOLERANCE = 1e-9  # of rows of unit length: what is less comes from others but for round-off
REDUNDANT = 1e-11  # of eigenvalues, squares of singular values, of constraints that depend on each other


class Place(NamedTuple):
    """Places prescribed at an instant: G⁺ g (C, 3) and x_f (N, 3), or a derivative of these."""

    vectors: Any
    nodes: Any


class Mobility(NamedTuple):
    """W (C, 3, C, 3, ...), or (C, C) where it is the same in all directions; E W Eᵀ likewise; M (C, C); and what
    also answers accelerations (C, 3, C, 3, ...), or None."""

    whole: Any
    between: Any
    mass: Any
    added: Any = None

    def answer(self, accelerations: Any) -> Any:
        """Forces (C, 3, ...) [N] by which added mass answers accelerations of the vectors."""
        return -_applied(self.added, accelerations)

    @property
    def transposed(self) -> Mobility:
        """Mobility of Wᵀ: added mass need not be symmetric."""
        if self.whole.ndim == 2 or self.added is None:
            return self
        order = (2, 3, 0, 1, *range(4, self.whole.ndim))
        return self._replace(whole=self.whole.transpose(order), between=self.between.transpose(order))

    def inertia(self, accelerations: Any) -> Any:
        """Inertia forces of all masses (C, 3, ...) [N]."""
        own = times(self.mass, accelerations)
        return own if self.added is None else own - self.answer(accelerations)


class System:
    """The vectors of a scene's structure, and its equations of motion.

    Attributes:
        maps: Φ (N, C).
        fit: (C, N) which vectors nodes give.
        spans: E (V, C), rods first.
        rods: (2, R, C) the ends of all rods by the vectors.
        rigid: (V_rods,) rows of the rods that keep their length.
        of_constraints: (K, 3 C), times forces (C, 3) of all that holds, those of linear constraints.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene, self.structure = scene, scene.structure
        structure, index = self.structure, self.structure.node_index
        bodied = {row for frame in structure.frames for row in frame.rows.tolist()}
        still = {index[name] for name in structure.fixed_nodes}
        own = [row for row in range(len(structure.nodes)) if row not in bodied | still]
        C, N = len(own) + 4 * len(structure.moving_frames), len(structure.nodes)
        self.maps, self.fit, self.shifted = np.zeros((N, C)), np.zeros((C, N)), np.zeros(C)
        self.maps[own, range(len(own))] = self.fit[range(len(own)), own] = self.shifted[: len(own)] = 1.0
        self.base = np.where(np.isin(np.arange(N), list(own))[:, None], 0.0, structure.positions)
        self.carried = np.zeros((N, len(scene.motions)))
        for number, motion in enumerate(scene.motions):
            if motion.support in structure.fixed_nodes:
                self.carried[index[motion.support], number] = 1.0
        self.rods = np.stack([self.maps[structure.rod_nodes[:, end]] for end in range(2)])
        self.rigid = np.flatnonzero(~structure.elastic)
        spans = [*(self.rods[1] - self.rods[0])[self.rigid]]
        pairs = [(number, number) for number in range(len(spans))]
        values = [*structure.rod_lengths[self.rigid] ** 2]
        for number, frame in enumerate(structure.moving_frames):
            at = len(own) + 4 * number
            self.maps[frame.rows, at], self.maps[frame.rows, at + 1 : at + 4] = 1.0, frame.offsets
            self.base[frame.rows], self.shifted[at] = 0.0, 1.0
            self.fit[at : at + 4, frame.rows] = frame.fit
            first = len(spans)
            spans += list(np.eye(C)[at + 1 : at + 4])
            pairs += [(first + i, first + j) for i in range(3) for j in range(i + 1)]
            values += [float(i == j) for i in range(3) for j in range(i + 1)]
        self.spans, self.size = np.array(spans).reshape(-1, C), C
        self.pairs, self.values = np.array(pairs, int).reshape(-1, 2), np.array(values)
        same = self.pairs[:, 0] == self.pairs[:, 1]
        self.kappa, self.alone = np.where(same, 0.5, 1.0), bool(same.all())
        self.values *= 2 * self.kappa
        self._hold()
        self.still, self.displaced = not scene.motions, displacements(scene)
        self.wet = any(element.adds_mass for element in scene.effects)
        self.redundant = bool(scene.redundancy.undetermined)
        # Each rod's equation by itself, where none hangs on another.
        self.apart = self.alone and not self.wet and self._is_apart()

    def _hold(self) -> None:
        """G, g and what motions add to it, of supports, planes and linear constraints; rows that repeat others go."""
        structure, C = self.structure, self.size
        numbers = {motion.support: number for number, motion in enumerate(self.scene.motions)}
        rows: list[Array] = []
        values: list[float] = []
        drives: list[Array] = []
        links: list[int] = []  # the linear constraint of a row, or -1

        def hold(weights: Array, direction: Array, value: float, motion: str = "", link: int = -1) -> None:
            rows.append(np.outer(weights, direction).ravel())
            values.append(value)
            drives.append(np.zeros((len(numbers), 3)))
            if motion in numbers:
                drives[-1][numbers[motion]] = direction
            links.append(link)

        for row, rod in enumerate(structure.rods):
            support = rod.support
            weights = (1 - support.sigma) * self.rods[0, row] + support.sigma * self.rods[1, row]
            place = weights @ self.fit @ structure.positions
            for direction in support.constraint_rows:
                unit = direction / np.linalg.norm(direction)
                hold(weights, unit, float(unit @ place), rod.name)
            if support.plane is not None:
                hold(self.rods[1, row] - self.rods[0, row], np.array(support.plane), 0.0)
        for point in structure.lone_masses:
            at = structure.node_index[point.node]
            for unit in null_space_basis(point.translation_basis.T).T:
                hold(self.maps[at], unit, float(unit @ structure.positions[at]))
        whole = structure.constraint_rows.reshape(len(structure.constraints), len(structure.nodes), 3)
        for number, one in enumerate(structure.constraints):
            weights = whole[number] @ one.unit @ self.maps
            hold(weights, one.unit, float(whole[number].ravel() @ structure.positions.ravel()), one.name, number)
        held: Array = np.array(rows).reshape(-1, 3 * C)
        self.offsets, self.drives = np.array(values), np.array(drives).reshape(len(rows), len(numbers), 3)
        self.free: Any = None
        self.inverse: Array = np.zeros((3 * C, 0))
        if len(rows):
            from scipy.linalg import null_space, qr

            triangle, order = qr((held / np.linalg.norm(held, axis=1)[:, None]).T, mode="r", pivoting=True)
            independent = np.sort(order[: min(triangle.shape)][np.abs(np.diag(triangle)) > RANK_TOLERANCE])
            held, self.offsets, self.drives = held[independent], self.offsets[independent], self.drives[independent]
            links = [links[k] for k in independent]
            self.free = null_space(held, rcond=RANK_TOLERANCE)
            self.inverse = np.asarray(np.linalg.pinv(held), float)
        self.of_constraints = (np.arange(len(structure.constraints))[:, None] == np.array(links, int)) @ self.inverse.T

    def _is_apart(self) -> bool:
        between = self.mobility(self.parameters()).between
        V = len(self.spans)
        blocks = np.abs(between) if between.ndim == 2 else np.abs(between).max(axis=(1, 3))
        return V == 0 or float((blocks * (1 - np.eye(V))).max(initial=0.0)) <= 1e-12 * float(blocks.max())

    def parameters(self) -> dict[str, Any]:
        """Masses [kg] of rods alone (R,) and of point masses that no rod carries (P,), and gravity (3,) [m/s²]."""
        return {
            "rod_masses": np.array([rod.mass for rod in self.structure.rods], float),
            "point_masses": np.array([point.mass for point in self.structure.lone_masses], float),
            "gravity": np.array(self.scene.gravity, float),
        }

    def mass(self, parameters: Arrays) -> Any:
        """M (C, C) [kg] of ½ ẏᵀ M ẏ."""
        structure = self.structure
        own, (total, first, second) = parameters["rod_masses"], structure.rod_lumps
        ends = (own / 3 + total - 2 * first + second, own / 3 + second)  # ∫ (1 - s)² dm, ∫ s² dm
        i, j = self.rods
        both = i.T @ ((own / 6 + first - second)[:, None] * j)
        M = both + both.T + sum(end.T @ (m[:, None] * end) for end, m in zip((i, j), ends, strict=True))
        rows = [structure.node_index[point.node] for point in structure.lone_masses]
        M = M + self.maps[rows].T @ (parameters["point_masses"][:, None] * self.maps[rows])
        constant = np.zeros((self.size, self.size))
        at = self.size - 4 * len(structure.moving_frames)
        for frame in structure.moving_frames:
            constant[at, at] = frame.masses.sum()
            constant[at + 1 : at + 4, at + 1 : at + 4] = frame.second
            at += 4
        return M + constant

    def mobility(self, parameters: Arrays, added: Any = None) -> Mobility:
        """W, E W Eᵀ and M of masses; `added` (C, 3, C, 3, ...) of what also answers accelerations."""
        M = self.mass(parameters)
        xp = (M if added is None else added).__array_namespace__()  # NumPy where all is known
        if added is None and self.free is None:
            inverse = xp.linalg.inv(M)
            return Mobility(inverse, self.spans @ inverse @ self.spans.T, M)
        C, Z = self.size, np.eye(3 * self.size) if self.free is None else self.free
        full, batch = xp.kron(M, np.eye(3))[None], () if added is None else added.shape[4:]
        if added is not None:
            full = full + xp.moveaxis(added.reshape(3 * C, 3 * C, -1), -1, 0)
        W = xp.moveaxis(Z @ xp.linalg.inv(Z.T @ full @ Z) @ Z.T, 0, -1).reshape(C, 3, C, 3, *batch)
        return Mobility(W, xp.einsum("vc,cidj...,wd->viwj...", self.spans, W, self.spans, optimize=True), M, added)

    def prescribed(self, t: Any) -> tuple[Place, Place, Place]:
        """Places prescribed by supports and fixed nodes at a time [s], and their first two derivatives."""

        def place(t: Any) -> Place:
            if self.still:
                return Place((self.inverse @ self.offsets).reshape(-1, 3), self.base)
            d = self.displaced(t)
            given = self.offsets + jnp.einsum("kmx,mx->k", self.drives, d)
            return Place((self.inverse @ given).reshape(-1, 3), self.base + self.carried @ d)

        if self.still:
            none = Place(np.zeros((self.size, 3)), np.zeros_like(self.base))
            return place(t), none, none

        return derivatives(place, t)

    def state(self, nodes: Any, velocities: Any, t: Any = 0.0) -> tuple[Any, Any]:
        """Return s and ṡ of node positions and velocities (N, 3, ...)."""
        place, rate, _ = self.prescribed(t)
        return self.reduced(times(self.fit, nodes), place), self.reduced(times(self.fit, velocities), rate)

    def reduced(self, vectors: Any, place: Place) -> Any:
        """Return s of y, or its rates of ẏ: (C, 3, ...), or (n, ...) where something is held."""
        if self.free is None:
            return vectors
        off = vectors - lifted(place.vectors, vectors)
        return times(self.free.T, off.reshape(3 * self.size, *off.shape[2:]))

    def vectors(self, reduced: Any, place: Place) -> Any:
        """Return y (C, 3, ...) of s, and ẏ of ṡ."""
        if self.free is None:
            return reduced
        own = times(self.free, reduced).reshape(self.size, 3, *reduced.shape[1:])
        return own + lifted(place.vectors, own)

    def nodes(self, vectors: Any, place: Place) -> Any:
        """Return x (N, 3, ...) of y, velocities of ẏ, or accelerations of ÿ."""
        return times(self.maps, vectors) + lifted(place.nodes, vectors)

    def accelerate(self, mobility: Mobility, y: Any, rates: Any, forces: Any, place: Place) -> tuple[Any, Any, Any]:
        """Solve for ÿ (C, 3, ...), μ (P, ...), and the forces of supports and constraints (C, 3, ...) [N].

        `forces` (C, 3, ...) act on the vectors, Φᵀ F; `place` has the accelerations of what is prescribed.
        """
        driven = lifted(place.vectors, y)
        start = _applied(mobility.whole, forces - mobility.inertia(driven)) + driven
        e, e_rates = times(self.spans, y), times(self.spans, rates)
        mu = self._solved(mobility, e, self.inner(e, times(self.spans, start)) + self.inner(e_rates, e_rates))
        back = times(self.spans.T, self._spread(e, mu))
        found = start - _applied(mobility.whole, back)
        return found, mu, mobility.inertia(found) - forces + back

    def projected(self, mobility: Mobility, y: Any, rates: Any) -> tuple[Any, Any]:
        """Project y and ẏ, in the metric of the masses, to where rods and bodies have their shape: one Newton step."""
        e = times(self.spans, y)
        y = y - self._moved(mobility, e, 0.5 * (self.inner(e, e) - lifted(self.values, e[0])))
        e = times(self.spans, y)
        return y, rates - self._moved(mobility, e, self.inner(e, times(self.spans, rates)))

    def _moved(self, mobility: Mobility, e: Any, off: Any) -> Any:
        """The change of y, or ẏ, that takes away `off` (P, ...) of the products."""
        return _applied(mobility.whole, times(self.spans.T, self._spread(e, self._solved(mobility, e, off))))

    def inner(self, e: Any, other: Any) -> Any:
        """κ (e_a·f_b + f_a·e_b) (P, ...) with other vectors f; of changes of e, J times these."""
        if self.alone:
            return jnp.sum(e * other, axis=1)
        a, b = self.pairs.T
        return lifted(self.kappa, e[a, 0]) * jnp.sum(e[a] * other[b] + other[a] * e[b], axis=1)

    def _spread(self, e: Any, mu: Any) -> Any:
        """Jᵀ μ (V, 3, ...)."""
        if self.alone:
            return mu[:, None] * e
        return jax.linear_transpose(lambda other: self.inner(e, other), e)(mu)[0]

    def _solved(self, mobility: Mobility, e: Any, right: Any) -> Any:
        """Solve J E W Eᵀ Jᵀ μ = right for μ (P, ...)."""
        if not len(self.pairs):
            return right
        between, isotropic = mobility.between, mobility.between.ndim == 2
        if self.apart:
            own = np.arange(len(self.pairs))
            if isotropic:
                return right / (lifted(between[own, own], right) * jnp.sum(e * e, axis=1))
            return right / jnp.einsum("vi...,vij,vj...->v...", e, between[own, :, own, :], e)
        if self.alone and isotropic:
            matrix = lifted(between, right[None]) * jnp.einsum("vi...,wi...->vw...", e, e)
        elif self.alone:
            matrix = jnp.einsum("vi...,viwj...,wj...->vw...", e, between, e)
        else:
            J = jax.vmap(lambda one: self._spread(e, lifted(one, right)), out_axes=0)(np.eye(len(self.pairs)))
            form = "pvi...,vw,qwi...->pq..." if isotropic else "pvi...,viwj...,qwj...->pq..."
            matrix = jnp.einsum(form, J, between, J)
        batched, sides = (jnp.moveaxis(x.reshape(*x.shape[:k], -1), -1, 0) for x, k in ((matrix, 2), (right, 1)))
        if self.redundant:
            inverse = jnp.linalg.pinv(batched, rtol=REDUNDANT, hermitian=not self.wet)
            found = (inverse @ sides[..., None])[..., 0]
        else:
            found = jnp.linalg.solve(batched, sides[..., None])[..., 0]
        return jnp.moveaxis(found, 0, -1).reshape(right.shape)

    def added(self, alpha: Any, x: Any) -> Any:
        """Added mass (C, 3, C, 3, ...) [kg], for `mobility`, of α (R, 2, 2, ...) across rods at nodes x."""
        spans = times(incidence(self.structure.rod_nodes, len(x)), x)
        d = spans / jnp.sqrt(jnp.sum(spans**2, axis=1, keepdims=True))
        across = lifted(np.eye(3)[None], d[:, None]) - d[:, :, None] * d[:, None, :]  # P = 1 - d dᵀ
        return jnp.einsum("arc,rab...,rij...,brd->cidj...", self.rods, alpha, across, self.rods)


def _applied(mobility: Any, forces: Any) -> Any:
    """W f (C, 3, ...)."""
    if mobility.ndim == 2:
        return times(mobility, forces)
    if mobility.ndim == 4:
        size = 3 * len(forces)
        return times(mobility.reshape(size, size), forces.reshape(size, *forces.shape[2:])).reshape(forces.shape)
    return jnp.einsum("cidj...,dj...->ci...", mobility, forces)


def displacements(scene: Scene) -> Callable[[Any], Any]:
    """A function of a time [s] (...) -> (m, 3, ...) [m], of all motions of a scene.

    Raises:
        SceneError: for a motion by a Python function.
    """
    if found := FUNCTION_MOTIONS.find(scene):
        raise SceneError(
            f"{found}, which arrays cannot call: give `motion.sampled(times)` in its place, or take another engine"
        )
    moves = [_displacement(motion) for motion in scene.motions]

    def displaced(t: Any) -> Any:
        return jnp.stack([move(t) for move in moves]) if moves else jnp.zeros((0, 3, *jnp.shape(t)))

    return displaced


def _displacement(motion: Motion) -> Callable[[Any], Any]:
    """Return Σ amplitude · sin(ω t + phase) + Σ c_k (t - t_i)^k, by the data's quintics; constant outside of these."""
    amplitudes = np.array([item.amplitude for item in motion.harmonics]).reshape(-1, 3)
    frequencies = np.array([item.angular_frequency for item in motion.harmonics])
    phases = np.array([item.phase for item in motion.harmonics])
    instants, pieces = np.array(motion.times), motion.pieces

    def move(t: Any) -> Any:
        t = jnp.asarray(t)
        waves = jnp.sin(jnp.multiply.outer(frequencies, t) + phases.reshape(-1, *(1,) * t.ndim))
        total = times(amplitudes.T, waves)
        if not len(instants):
            return total
        at = jnp.clip(jnp.searchsorted(instants, t, side="right") - 1, 0, len(instants) - 2)
        within = (instants[0] <= t) & (t <= instants[-1])
        since = jnp.where(within, t, jnp.where(t < instants[0], instants[0], instants[-1])) - jnp.asarray(instants)[at]
        coefficients = jnp.moveaxis(jnp.asarray(pieces)[at], (-2, -1), (0, 1))  # (6, 3, ...)
        found = coefficients[5]
        for k in range(4, -1, -1):
            found = found * since + coefficients[k]
        return total + found

    return move
