"""Cheap bounds of the matrices of small motions, and the step that is stable for all matrices within them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.vibration.bodies import Bodies
from tensegrity_mj.vibration.small_motions import Vibration
from tensegrity_mj.vibration.state import State, geometric_of_rods
from tensegrity_mj.vibration.stepping import Scheme

# |z| within which Runge-Kutta's |R(z)| <= 1 for all Re z <= 0 (its smallest radius there is 2.615), and <= e^(2 Re z)
# for all others: R(z) e^(-2z) is largest on the edge of a half disc, and at most 1 on the imaginary axis up to 2.828.
HALF_DISC = 2.6


class Bounds(NamedTuple):
    """Upper bounds of the largest eigenvalues.

    Attributes:
        material, damper: [1/s²], [1/s] of strings, as the implicit integrators know them.
        rest, other: the same of all else, which none of them knows.
    """

    material: float
    rest: float
    damper: float
    other: float

    def stable_step(self, scheme: Scheme) -> float:
        """A step [s] that is stable for every structure with up to these stiffnesses and dampers."""
        whole, all_dampers = self.material + self.rest, self.damper + self.other
        match scheme:
            case Scheme.RUNGE_KUTTA:
                # Of |λ|² <= d |λ| + k.
                fastest = 0.5 * (all_dampers + math.sqrt(all_dampers * all_dampers + 4 * whole))
                return HALF_DISC / fastest if fastest > 0 else math.inf
            case Scheme.SEMI_IMPLICIT:
                return _explicit_bound(whole, all_dampers)
            case Scheme.VELOCITY_IMPLICIT:
                return _explicit_bound(whole, self.other)
            case Scheme.LINEARLY_IMPLICIT:
                return _explicit_bound(self.rest, self.other)


def bounds_at(scene: Scene, bodies: Bodies, nodes: Array, velocities: Array, rest_lengths: Array) -> Bounds:
    """Bounds at the start and a state, (N, 3) [m] and [m/s], with rest lengths (M,) [m], without a law."""
    structure, curves = scene.structure, scene.structure.curves
    state = State(scene, bodies, nodes, velocities, float(scene.start_time))
    stretch = state.lengths - rest_lengths
    elastic = curves.stiffness * stretch if curves.linear else curves.tension(stretch)
    pulls = np.where(stretch >= 0, np.abs(elastic + structure.damping * state.rates), 0.0)
    blocks, _ = geometric_of_rods(state, state.segments.directions * pulls[structure.paths.strings, None])
    more = curves.steepest - curves.stiffness  # `discrete` knows the first slopes alone
    return _bounds(state, (curves.stiffness, more), structure.damping, pulls, blocks)


def bounds_of(model: Vibration) -> Bounds:
    """Bounds of a model, for integrators that know nothing of its strings: of |x* K x| and |x* D x| of unit vectors x.

    A law's matrices, which are not symmetric, count by the roots of the sums of their squares.
    """
    bounds = _bounds(model.state, (model.stiffness,), model.damping, np.abs(model.tension), model.rods[0])
    if model.law is None:
        return bounds
    rest, other = (float(np.linalg.norm(matrix)) for matrix in (model.law.stiffness, model.law.damping))
    return bounds._replace(rest=bounds.rest + rest, other=bounds.other + other)


def _bounds(state: State, stiffness: tuple[Array, ...], damping: Array, pulls: Array, blocks: Array) -> Bounds:
    """Bounds for strings of these stiffnesses, of which integrators know the first, dampers and pulls >= 0, (M,) each.

    (Σ a)² <= n Σ a² of n terms makes a sum over bodies of the quadratic form of a string, along it with a term for
    either end of each segment, across it for the two ends of one; the largest eigenvalue of a body is at most the sum
    of those of its strings. An end that is fixed is no term. Joints only lower them.
    """
    bodies, paths = state.bodies, state.scene.structure.paths
    ends = bodies.body[paths.nodes.T]
    B = len(bodies.mass)
    ends_free = np.sum((ends < B).astype(float), axis=0)
    free_along = paths.total(ends_free)
    mobility = bodies.mobilities[paths.nodes.T]
    length = state.segments.lengths
    density = pulls[paths.strings] / np.where(length > 0, length, np.inf)

    def along(weight: Array) -> float:
        return largest((free_along * weight)[paths.strings])

    def largest(each: Array) -> float:
        return float(np.bincount(ends.ravel(), (each * mobility).ravel(), minlength=B + 1)[:B].max(initial=0.0))

    # Two directions across, and each rod's own part.
    rest, other = largest(ends_free * (2 * density)) + float(np.abs(blocks).sum(axis=2).max(initial=0.0)), 0.0
    stiff, lossy = ([*parts, bars] for parts, bars in zip(state.resisting, state.bars(), strict=True))
    rest += sum(part.row_sums(B) for part in stiff)
    other += sum(part.row_sums(B) for part in lossy)
    known, *more = map(along, stiffness)
    return Bounds(known, sum(more, rest), along(damping), other)


def _explicit_bound(stiffness: float, damper: float) -> float:
    """h with h² k / 4 + h d / 2 = 1."""
    largest = damper + math.sqrt(damper**2 + 4 * stiffness)
    return 4 / largest if largest > 0 else math.inf
