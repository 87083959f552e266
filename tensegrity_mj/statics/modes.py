"""Natural frequencies and shapes of small motions about a state of equilibrium, without damping.

    K φ = ω² M φ        on the motions that supports, holds and rigid rods admit, neutral ones apart

K is the state's tangent stiffness and M the masses of the nodes: of a uniform rod m/6 [[2, 1], [1, 2]] for each
component, which is exact for a rigid thin rod and linear along an elastic one, and point masses. Neutral motions move
the whole as one body and have ω = 0 by construction: all other shapes are M-orthogonal to them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.linalg import eigh, qr
from scipy.sparse.linalg import ArpackNoConvergence

from tensegrity_mj.basics import kinds
from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import checked, instance, positive, whole
from tensegrity_mj.basics.jsontext import plain_values
from tensegrity_mj.basics.texts import at_a_glance
from tensegrity_mj.errors import InfeasibleError, OptionError
from tensegrity_mj.model import rods as thin
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.runs.recorded import LAW_REPORTS, VARIABLES, sizes_of
from tensegrity_mj.runs.trajectory import Trajectory
from tensegrity_mj.statics import linear_systems
from tensegrity_mj.statics.listing import counted
from tensegrity_mj.statics.state import StaticState

Flags = NDArray[np.bool_]

LEAST_COUNT = 12  # shapes that are found of a large structure unless another number is given
SHIFT = 1e-8  # of the largest stiffness over the smallest mass: where large structures' eigenvalues are sought from
AMPLITUDE = 0.1  # of the mean member, of the node that moves most


@dataclass(frozen=True, eq=False)
class Modes:
    """Small motions about an equilibrium; N nodes, n shapes.

    Attributes:
        state: the equilibrium.
        squares: ω² (n,) [1/s²], ascending; below zero where the state is not stable.
        shapes: (3N, n) [1/√kg], each of unit modal mass φᵀ M φ; nodes one after another.
        neutral: (3N, p) orthonormal motions of the whole that nothing resists: ω = 0, and none of `shapes`.
        masses: M (3N, 3N) [kg], sparse.
        complete: whether these are all the modes there are.
        round_off: [1/s²] what round-off makes of ω² = 0: smaller ones cannot be distinguished from it.
    """

    state: StaticState
    squares: Array
    shapes: Array
    neutral: Array
    masses: sparse.csr_array
    complete: bool
    round_off: float

    def __repr__(self) -> str:
        return at_a_glance([("modes", f"of {self.state.model.scene.name}"), *(("", line) for line in self.describe())])

    @property
    def unstable(self) -> Flags:
        """(n,) modes that grow instead of swinging: ω² below zero, beyond round-off."""
        return np.asarray(self.squares < -self.round_off)

    @property
    def loose(self) -> Flags:
        """(n,) modes that nothing holds, within round-off, and that are no neutral motions: unstressed mechanisms."""
        return np.asarray(np.abs(self.squares) <= self.round_off)

    @property
    def frequencies(self) -> Array:
        """(n,) [Hz] of the modes; 0 where nothing holds one, NaN where one grows."""
        held = np.where(self.loose, 0.0, self.squares)
        return np.where(self.unstable, np.nan, np.sqrt(np.maximum(held, 0.0)) / (2 * np.pi))

    @property
    def growth(self) -> Array:
        """(n,) [1/s] √(-ω²) of the modes that grow, 0 of the others."""
        return np.where(self.unstable, np.sqrt(np.maximum(-self.squares, 0.0)), 0.0)

    @cached_property
    def participation(self) -> Array:
        """(n, 3) [√kg]: φᵀ M e of each mode for translations e of all nodes along x, y and z."""
        along = np.tile(np.eye(3), (len(self.state.nodes), 1))
        return np.asarray(self.shapes.T @ (self.masses @ along))

    @property
    def effective_masses(self) -> Array:
        """(n, 3) [kg]: `participation` squared; over all modes and neutral motions they add up to what moves."""
        return self.participation**2

    def describe(self) -> list[str]:
        """Return a description of the modes, a sentence a line."""
        lines = (
            [f"{counted(self.neutral.shape[1], 'motion')} of the whole that nothing resists, at 0 Hz"]
            if self.neutral.size
            else []
        )
        if not len(self.squares):
            return [*lines, "no further motion is free"]
        grow, loose = int(self.unstable.sum()), int(self.loose.sum())
        if grow:
            lines.append(
                f"{counted(grow, 'unstable mode')}, with a growth rate of up to {self.growth.max():.6g} 1/s: this "
                "equilibrium is left"
            )
        if loose:
            lines.append(f"{counted(loose, 'zero-frequency mode')}: mechanisms that prestress does not stiffen")
        held = self.frequencies[~self.unstable & ~self.loose]
        if len(held):
            which = "all there are" if self.complete else "the lowest of all"
            lines.append(f"{counted(len(held), 'swinging mode')}, {which}: {held[0]:.6g} to {held[-1]:.6g} Hz")
        return lines

    def to_dict(self) -> dict[str, Any]:
        """Return plain values, for JSON."""
        return {
            "scene": self.state.model.scene.name,
            "nodes": list(self.state.model.structure.node_names),
            **plain_values(self, "squares", "frequencies", "unstable", "loose", "growth"),
            "neutral": self.neutral.shape[1],
            "shapes": self.shapes.T.tolist(),
            **plain_values(self, "complete", "effective_masses"),
        }


def mass_matrix(structure: Structure) -> sparse.csr_array:
    """M (3N, 3N) [kg] of rods, point masses and bodies, nodes one after another."""
    count = len(structure.nodes)
    i, j = structure.rod_nodes.T
    m, (a, b, both) = thin.own_masses(structure) / 6, thin.mass_products(0.0, structure.rod_lumps)
    points = [structure.node_index[point.node] for point in structure.lone_masses]
    at = np.array(points, np.int64)
    rows, columns = np.concatenate([i, j, i, j, at]), np.concatenate([i, j, j, i, at])
    masses = [point.mass for point in structure.lone_masses]
    values = np.concatenate([2 * m + a, 2 * m + b, m + both, m + both, masses])
    for frame in structure.frames:
        rows = np.concatenate([rows, np.repeat(frame.rows, len(frame.rows))])
        columns = np.concatenate([columns, np.tile(frame.rows, len(frame.rows))])
        values = np.concatenate([values, frame.masses.ravel()])
    by_node = sparse.coo_array((values, (rows, columns)), shape=(count, count))
    return sparse.csr_array(sparse.kron(by_node, sparse.eye_array(3)))


def natural_modes(state: StaticState, count: int | None = None) -> Modes:
    """The natural modes about a state, those of the lowest ω² first.

    Args:
        state: from `find_equilibrium` or any other of statics; at rest.
        count: how many; by default all, and `LEAST_COUNT` where there are more than `linear_systems.DENSE` free
            coordinates. There the ω² nearest to zero are found, by inverse iteration.

    Raises:
        OptionError: for arguments that do not fit.
        InfeasibleError: where the iteration does not converge.
    """
    instance("state", state, StaticState, "use a StaticState, as find_equilibrium(scene) returns")
    wanted = None if count is None else whole("count", count, 1)
    M = mass_matrix(state.model.structure)
    if state.model.boundary.Z.shape[1] <= linear_systems.DENSE:
        squares, shapes, largest, free = _dense(state, M, wanted)
    else:
        squares, shapes, largest, free = _sparse(state, M, wanted or LEAST_COUNT)
    return Modes(
        state=state,
        squares=squares,
        shapes=shapes,
        neutral=state.neutral_motions,
        masses=M,
        complete=len(squares) >= free,
        round_off=8 * np.finfo(float).eps * free * largest,
    )


def _dense(state: StaticState, M: sparse.csr_array, wanted: int | None) -> tuple[Array, Array, float, int]:
    """ω², shapes, the largest ω² and the number of all modes."""
    at, Z, neutral = state.linearized, state.model.boundary.Z, state.neutral_motions
    T = at.tangent_basis()
    if neutral.shape[1]:
        # Admissible motions that are M-orthogonal to neutral ones.
        Q, _ = qr(T.T @ (Z.T @ (M @ neutral)), mode="full")
        T = T @ Q[:, neutral.shape[1] :]
    n = T.shape[1]
    if not n:
        return np.zeros(0), np.zeros((len(state.x), 0)), 0.0, 0
    K = T.T @ (at.stiffness @ T)
    mass = T.T @ ((Z.T @ M @ Z) @ T)
    last = n if wanted is None else min(wanted, n)
    squares, vectors = eigh(0.5 * (K + K.T), 0.5 * (mass + mass.T))
    shapes = np.asarray(Z @ (T @ vectors[:, :last]))
    return squares[:last], _signed(shapes), float(np.abs(squares).max()), n


def _sparse(state: StaticState, M: sparse.csr_array, wanted: int) -> tuple[Array, Array, float, int]:
    """Compute the modes by shift and invert, with rods' lengths and neutral motions as constraints."""
    at, Z, neutral = state.linearized, state.model.boundary.Z, state.neutral_motions
    K, rows = sparse.csr_array(at.stiffness), [sparse.csr_array(at.held_lengths)]
    mass = sparse.csr_array(Z.T @ M @ Z)
    if neutral.shape[1]:
        pushed = sparse.csr_array((Z.T @ (M @ neutral)).T)
        rows.append(pushed / float(np.abs(pushed.data).max()))
    C = sparse.csr_array(sparse.vstack(rows))
    heavy = mass.diagonal()
    largest = float(np.abs(K.diagonal()).max()) / float(heavy[heavy > 0].min())
    shift = -SHIFT * largest
    scale = float(np.abs(K.diagonal()).max()) or 1.0
    free = K.shape[0] - C.shape[0]
    last = min(wanted, free - 1)
    if last < 1:
        return np.zeros(0), np.zeros((len(state.x), 0)), 0.0, max(free, 0)
    try:
        squares, vectors = linear_systems.nearest_pairs(K, mass, C, shift, scale, last)
    except ArpackNoConvergence as error:
        raise InfeasibleError(
            f"natural modes of '{state.model.scene.name}' were not found: {error}; request fewer (count=...)"
        ) from error
    return squares, _signed(np.asarray(Z @ vectors)), largest, free


def _signed(shapes: Array) -> Array:
    """Shapes whose largest component is positive: the sign of an eigenvector means nothing."""
    if not shapes.size:
        return shapes
    rows = np.argmax(np.abs(shapes) > (1 - 1e-6) * np.abs(shapes).max(axis=0), axis=0)
    return np.asarray(shapes * np.where(shapes[rows, np.arange(shapes.shape[1])] < 0, -1.0, 1.0))


def mode_trajectory(
    modes: Modes, number: int, *, amplitude: float | None = None, periods: float = 2.0, frames: int = 120
) -> Trajectory:
    """A mode as a motion that can be filmed (`tmj.render`) and saved: x = P(x₀ + A φ sin ωt).

    P puts rigid rods back to their lengths, so that they keep them at any amplitude; the motion is that of the mode to
    first order. Tensions are those of the strings there, forces of rods those that leave the nodes' accelerations. A
    mode that nothing holds, or that grows, swings once a second.

    Args:
        modes: from `natural_modes`.
        number: which, from 0.
        amplitude: [m] of the node that moves most; by default `AMPLITUDE` of the mean member.
        periods: how many.
        frames: samples a period.

    Raises:
        OptionError: for arguments that do not fit, and an amplitude at which rods cannot keep their lengths.
    """
    instance("modes", modes, Modes, "use natural_modes(state)")
    count = len(modes.squares)
    number = checked("number of the mode", number, kinds.whole(0, count - 1))
    samples = whole("frames", frames, 8)
    state, shape = modes.state, modes.shapes[:, number]
    size = positive("amplitude", AMPLITUDE * state.model.scale[0] if amplitude is None else amplitude, "m")
    moved = shape * (size / float(np.linalg.norm(shape.reshape(-1, 3), axis=1).max()))
    if size > state.model.scale[0]:
        raise OptionError(
            f"amplitude = {size:g} m is longer than the mean member, {state.model.scale[0]:g} m, where a mode says "
            "nothing any more; choose a smaller one"
        )
    frequency = float(modes.frequencies[number])
    omega = 2 * math.pi * (frequency if frequency > 0 else 1.0)
    duration = positive("periods", periods) * 2 * math.pi / omega
    time = np.linspace(0.0, duration, math.ceil(samples * periods) + 1)
    step = 1e-3 / omega  # of a central difference: 1e-6 of the velocity

    def at(t: float) -> Array:
        x = state.x + math.sin(omega * t) * moved
        target = np.where(state.model.compliance > 0, state.model.rods(x).lengths, state.bar_lengths)
        placed = linear_systems.projected(state.model, x, target)
        if placed is None:
            raise OptionError(
                f"amplitude = {size:g} m: rods cannot keep their lengths so far along mode {number}; choose a "
                "smaller one"
            )
        return placed

    places = np.array([at(t) for t in time])
    rates = np.array([(at(t + step) - at(t - step)) / (2 * step) for t in time])
    swing = np.sin(omega * time)
    return _film(modes, number, time, places, rates, -(omega**2) * swing[:, None] * moved)


def _film(modes: Modes, number: int, time: Array, places: Array, rates: Array, accelerations: Array) -> Trajectory:
    """The trajectory of positions, velocities and accelerations (T, 3N)."""
    state, model = modes.state, modes.state.model
    structure = model.structure
    scene = state.scene()
    T, N, R = len(time), len(state.nodes), len(structure.rods)
    sizes = sizes_of(scene, T)
    data: dict[str, Any] = {
        name: np.full([sizes[d] for d in dims], np.nan if name in LAW_REPORTS else 0.0)
        for name, (dims, _, _) in VARIABLES.items()
    }
    data["time"] = time
    data["nodes"], data["velocities"] = places.reshape(T, N, 3), rates.reshape(T, N, 3)
    data["rest_lengths"] = np.tile(model.rest_lengths, (T, 1))
    _, J = thin.inertia_of_rods(structure)
    for row, (x, a) in enumerate(zip(places, accelerations, strict=True)):
        lengths = model.lengths(x)
        data["tensions"][row] = model.tensions(lengths)
        data["force_densities"][row] = data["tensions"][row] / np.where(lengths > 0, lengths, 1.0)
        N_rods = linear_systems.rod_forces(model, x, model.gradient(x, state.parameter) + modes.masses @ a)
        data["rod_force_densities"][row] = (N_rods / model.rods(x).lengths)[:R]
        data["string_energy"][row] = model.curves.total_energy(lengths - model.rest_lengths)
    data["multipliers"] = data["rod_force_densities"] * structure.rod_lengths**2 / J
    data["kinetic_energy"] = 0.5 * np.einsum("tm,tm->t", rates, (modes.masses @ rates.T).T)
    data["gravity_energy"] = np.asarray(thin.gravity_energy(structure, data["nodes"], np.array(model.scene.gravity)))
    frequency = modes.frequencies[number]
    what = f"{frequency:.6g} Hz" if frequency > 0 else "unstable" if modes.unstable[number] else "held by nothing"
    return Trajectory(
        scene=scene, **data, engine=f"mode {number + 1} of '{model.scene.name}': {what}", cost={}, reports={}
    )
