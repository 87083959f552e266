"""Fastest rates of a structure, at its start and along a run: steps must resolve them before errors have an order.

A step that is long against a vibration damps it away or turns it the wrong way round, and half that step may do the
same: two such runs agree, and both are wrong. So runs count as evidence only from where their steps are short against
the fastest motion, which is bounded here whether or not it takes part.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array, IntArray
from tensegrity_mj.basics.remembered import once
from tensegrity_mj.dynamics.native.law import Command
from tensegrity_mj.engines.request import Request
from tensegrity_mj.model.actuation import Mode
from tensegrity_mj.model.rods import Bars, centers_and_moments, own_masses
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.strings import tension
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.runs.trajectory import Trajectory

RESOLVED = 1.0  # rad or time constants a step, at most, of a run that is evidence: where orders begin
LOOKED_AT = 3  # samples of a run whose strings' directions are looked at
AS_ONE = 1e-12  # of a size: round-off
DENSE = 100  # strings; of more, the power method takes less time than the norm of a matrix
ITERATIONS = 40  # of the power method, good to some percent


@dataclass(frozen=True)
class Rates:
    """Upper bounds of the rates of a motion.

    Attributes:
        turn: [1/s] of vibrations, all strings taut, and of rods' turning.
        decay: [1/s] of what dampers stop.
    """

    turn: float
    decay: float

    def resolving_step(self, duration: float, order: int, damped: bool = True) -> float:
        """The longest step [s] whose error has an order, over a run of that duration [s].

        A step h takes a part z⁶/144 from a vibration's amplitude by classical Runge-Kutta, z = ω h, from
        |R(iz)|² = 1 - z⁶/72 + z⁸/576. In a run of ω T / z steps, less than 1/e of it goes where
        z <= (144 / ω T)^(1/5): a coarser run may have lost the vibration before its first recorded sample, and a finer
        one with it.

        Args:
            order: of the method; those of an order below 4 here leave vibrations their amplitude.
            damped: whether the method must resolve what dampers stop; an implicit one need not.
        """
        found = math.inf
        if self.turn > 0:
            in_phase = (144 / (self.turn * duration)) ** 0.2 if order == 4 else math.inf
            found = min(RESOLVED, in_phase) / self.turn
        return min(found, RESOLVED / self.decay) if damped and self.decay > 0 else found


def rates_at_start(request: Request) -> Rates:
    """Rates at a request's start.

    A law in force densities sets the elastic tension itself, so that the strings' stiffness does not act.
    """
    scene, structure = request.scene, request.scene.structure
    nodes, velocities = scene.nodes0, scene.velocities0
    lengths, moving = structure.string_lengths(nodes), structure.string_rates(nodes, velocities)
    pulls = tension(structure.curves, structure.damping, lengths, moving, structure.rest_lengths, structure.clipped)
    return _rates(scene, nodes[None], velocities[None], pulls[None], stiffness_acts(request))


def rates_along(run: Trajectory, request: Request) -> Rates:
    """Largest rates of a run's recorded samples."""
    return _rates(run.scene, run.nodes, run.velocities, run.tensions, stiffness_acts(request))


def stiffness_acts(request: Request) -> bool:
    """Return whether a string's tension follows its length: not where a law sets the force density at every stage."""
    law, mode = request.law, request.actuation.mode
    return not (law.address and law.command is Command.FORCE_DENSITY and mode is not Mode.HOLD_REST_LENGTH)


def _rates(scene: Scene, nodes: Array, velocities: Array, tensions: Array, stiff: bool) -> Rates:
    """Rates of samples of nodes (T, N, 3), velocities (T, N, 3) and tensions (T, M)."""
    structure = scene.structure
    some = np.unique(np.linspace(0, len(nodes) - 1, LOOKED_AT).astype(int))
    at_start = np.abs(nodes[0] - scene.nodes0).max(initial=0.0) <= AS_ONE * np.abs(scene.nodes0).max(initial=0.0)
    first = _strings_at_start(scene) if at_start else string_rates(structure, nodes[0])
    vibration, decay = np.max([first, *(string_rates(structure, nodes[one]) for one in some[1:])], axis=0)
    sway, spin = _turning(scene, nodes, velocities, tensions)
    own, slowing = _of_rods(structure)
    return Rates(max(math.hypot(vibration * stiff, sway, math.sqrt(own)), spin), float(decay) + slowing)


@once
def _strings_at_start(scene: Scene) -> tuple[float, float]:
    return string_rates(scene.structure, scene.nodes0)


@once
def _of_rods(structure: Structure) -> tuple[float, float]:
    """ω² [1/s²] of an elastic rod by itself, 12 k/m of a free uniform one, and twice its decay [1/s], 12 c/m."""
    bars = Bars.of(structure)
    moments = centers_and_moments(own_masses(structure), structure.rod_lengths, structure.rod_lumps)[1][bars.rows]
    stiff, damped = (np.max(part * bars.lengths**2 / moments, initial=0.0) for part in (bars.stiffness, bars.damping))
    return float(stiff), float(damped)


def _turning(scene: Scene, nodes: Array, velocities: Array, tensions: Array) -> tuple[float, float]:
    """Frequencies ω [1/s] of rods that swing in the pull on their ends and in their weight, and their spin [rad/s].

    Forces f along fixed directions at the ends of a rod of length l turn it back by (f1 + f2) l / 2 an angle at most,
    and its moment of inertia is m l²/12: ω² <= 6 (f1 + f2) / m l. About an end it is 3 f / m l. Where a rod carries
    masses, its arms and moment about its centre of mass take their place. Joints hand on what pulls at other rods.
    """
    structure = scene.structure
    if not len(structure.rods):
        return 0.0, 0.0
    at_nodes = np.zeros(nodes.shape[:2])
    for string, ends in zip(structure.paths.strings, structure.paths.nodes, strict=True):
        at_nodes[:, ends] += np.abs(tensions[:, string, None])
    rods, masses = structure.rod_nodes, structure.rod_masses
    weight = masses * float(np.linalg.norm(scene.gravity))
    forces = at_nodes[:, rods[:, 0]] + at_nodes[:, rods[:, 1]] + weight  # (T, R)
    if structure.class_number > 1:
        for cluster in structure.clusters:
            forces[:, list(cluster)] = forces[:, list(cluster)].sum(axis=1, keepdims=True)
    sway = np.sqrt(6 * forces / (masses * structure.rod_lengths) * _mobilities(structure).max(axis=0))
    apart = velocities[:, rods[:, 1]] - velocities[:, rods[:, 0]]
    spin = np.linalg.norm(apart, axis=-1) / structure.rod_lengths
    return _finite_max(sway), _finite_max(spin)


def _finite_max(values: Array) -> float:
    """The largest; 0 of a run that left the finite numbers, whose differences say so."""
    return float(np.max(values, initial=0.0, where=np.isfinite(values)))


@once
def _mobilities(structure: Structure) -> Array:
    """Ratio (2, R) of the turning of rods by a force at an end, over arms of half a rod, to that of uniform rods."""
    centers, moments = centers_and_moments(own_masses(structure), structure.rod_lengths, structure.rod_lumps)
    uniform = structure.rod_masses * structure.rod_lengths**2 / 12
    return np.stack([2 * centers, 2 * (1 - centers)]) * (uniform / moments)


def string_rates(structure: Structure, nodes: Array) -> tuple[float, float]:
    """Upper bounds [1/s] of √λ(M⁻¹K) of the strings' stiffness and of λ(M⁻¹D) of their dampers, all strings taut.

    Free thin rods move most: an impulse at one end of a rod of mass m moves it by I/m + 3 (I - bbᵀ)/m, the other end by
    I/m - 3 (I - bbᵀ)/m; one that carries masses moves by its own arms and moment. Supports only take freedom away, and
    cannot raise a frequency (Cauchy's interlacing). Of many strings by power iteration from the same start each time.
    """
    paths = structure.paths
    if not len(paths.nodes):
        return 0.0, 0.0
    span = paths.spans(nodes)
    along = span / np.maximum(np.linalg.norm(span, axis=1), 1e-300)[:, None]
    places, axes = 3 * paths.nodes.T[:, :, None] + np.arange(3), np.stack([-along, along])
    few = len(paths.ranges) <= DENSE
    strings = np.tile(np.repeat(paths.strings, 3), 2)
    slopes = _matrix(places.ravel(), strings, axes.ravel(), (nodes.size, len(paths.ranges)), few)
    answers = slopes.T @ (_matrix(*_mobility(structure, nodes), (nodes.size, nodes.size), few) @ slopes)

    def largest(weights: Array) -> float:
        """The largest eigenvalue of W^½ ∂L/∂q M⁻¹ (∂L/∂q)ᵀ W^½."""
        if not np.any(weights):
            return 0.0
        root = np.sqrt(weights)
        if few:
            matrix = root[:, None] * answers * root
            # Where rods share nodes it is not symmetric, and the norm a bound.
            return float(np.linalg.norm(matrix, 2)) if np.isfinite(matrix).all() else 0.0
        x, value = np.cos(np.arange(len(weights)) + 1.0), 0.0  # of no string's pattern
        for _ in range(ITERATIONS):
            x = root * (answers @ (root * (x / max(float(np.linalg.norm(x)), 1e-300))))
            value = float(np.linalg.norm(x))
        return value

    stiffness, damping = structure.curves.steepest, structure.damping
    found, hardest, most = largest(stiffness), float(stiffness.max()), float(damping.max())
    if hardest * most > 0 and np.allclose(damping / most, stiffness / hardest, rtol=0.0, atol=AS_ONE):
        return math.sqrt(found), found * most / hardest
    return math.sqrt(found), largest(damping)


def _matrix(rows: IntArray, columns: IntArray, values: Array, shape: tuple[int, int], dense: bool) -> Any:
    """The matrix of sums of entries: sparse, or dense where that is faster."""
    if not dense:
        from scipy import sparse  # which the runs of small structures need not import

        return sparse.csr_array((values, (rows, columns)), shape=shape)
    return np.bincount(rows * shape[1] + columns, values, shape[0] * shape[1]).reshape(shape)


def _mobility(structure: Structure, nodes: Array) -> tuple[IntArray, IntArray, Array]:
    """Rows, columns and values of M⁻¹ (3N, 3N) [1/kg]: how forces on nodes (N, 3) move them.

    Joints: a node moves as the last of its rods lets it, of which supports and the other rods only take away.
    """
    rods, eye = structure.rod_nodes, np.eye(3)
    entries: list[tuple[IntArray, IntArray, Array]] = []
    owner, end = np.full(len(nodes), -1), np.zeros(len(nodes), int)
    for last in (0, 1):
        owner[rods[:, last]], end[rods[:, last]] = np.arange(len(rods)), last
    for frame in structure.moving_frames:
        owner[frame.rows] = -1
        flat = (3 * frame.rows[:, None] + np.arange(3)).ravel()
        entries.append((np.repeat(flat, len(flat)), np.tile(flat, len(flat)), frame.mobility(nodes).ravel()))
    for point in structure.lone_masses:
        row = structure.node_index[point.node]
        owner[row], flat = -1, 3 * row + np.arange(3)
        entries.append((flat, flat, np.full(3, 1 / point.mass)))
    own = np.flatnonzero(owner >= 0)
    rod, side = owner[own], end[own]
    axes = nodes[rods[rod, 1]] - nodes[rods[rod, 0]]
    b = axes / np.maximum(np.linalg.norm(axes, axis=1), 1e-300)[:, None]
    b = np.where(structure.elastic[rod, None], 0.0, b)  # an elastic rod's ends move along it as they do across
    across = eye - b[:, :, None] * b[:, None, :]
    arms, masses = _mobilities(structure)[:, rod], structure.rod_masses[rod]
    shares = np.stack([-arms[0], arms[1]]) / arms.sum(axis=0)
    for other in (0, 1):
        turned = 6 * np.where(side, arms[1], -arms[0]) * shares[other] / masses
        blocks = eye / masses[:, None, None] + turned[:, None, None] * across
        rows = np.broadcast_to(3 * own[:, None, None] + np.arange(3)[:, None], blocks.shape)
        columns = np.broadcast_to(3 * rods[rod, other][:, None, None] + np.arange(3), blocks.shape)
        entries.append((rows.ravel(), columns.ravel(), blocks.ravel()))
    first, second, values = zip(*entries, strict=True)
    return np.concatenate(first), np.concatenate(second), np.concatenate(values)
