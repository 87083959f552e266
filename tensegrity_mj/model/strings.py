"""The one string law, used by every formulation and tested against each of them.

A string of stiffness k [N/m], damping c [N s/m] and rest length L0 [m], at length L [m] and rate
dL/dt [m/s], pulls with the tension [N]

    T = max(0, k (L - L0) + c dL/dt)   where L > L0,   else 0          (CLIPPED)
    T =        k (L - L0) + c dL/dt    where L > L0,   else 0          (UNCLIPPED)

A string that grows longer from L = L0, to round-off, is taut already, so that its damper acts from then on: else a
start there would have its damper missed for a stage, and steps of order 2. Where rest lengths follow a law at every
stage dL/dt is not the rate of L - L0, and L > L0 alone counts. Here k (L - L0) stands for the elastic tension f(L - L0)
of a string with a tension curve: functions take a structure's `curves` for its stiffness.

The clipped law is a string: it never pushes. The unclipped variant lets the damper push in a taut string
that shortens fast; it exists to compare with codes that compute so. The elastic part k (L - L0) over L is
the force density u [N/m] of the thesis, (2.58); its inverse is L0 = L (1 - u/k).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.model.members import StringLaw as StringLaw
from tensegrity_mj.model.tension_curves import TensionCurves

EDGE = 1e-12  # of its length: within round-off of its rest length, a string is at the edge of slackness


def elastic_tension(stiffness: ArrayLike | TensionCurves, length: ArrayLike, rest_length: ArrayLike) -> Array:
    """Elastic part k max(0, L - L0) of the tension [N]; arguments broadcast."""
    if isinstance(stiffness, TensionCurves):
        return stiffness.tension(np.asarray(length) - np.asarray(rest_length))
    return np.asarray(stiffness) * np.maximum(0.0, np.asarray(length) - np.asarray(rest_length))


def tension(
    stiffness: ArrayLike | TensionCurves,
    damping: ArrayLike,
    length: ArrayLike,
    length_rate: ArrayLike,
    rest_length: ArrayLike,
    law: StringLaw | NDArray[np.bool_] = StringLaw.CLIPPED,
) -> Array:
    """Tension T [N] of the law above; arguments broadcast. `law`: or whether each string is clipped."""
    elastic = elastic_tension(stiffness, length, rest_length)
    stretch, rate = np.asarray(length) - np.asarray(rest_length), np.asarray(length_rate)
    total = elastic + np.asarray(damping) * rate
    clipped = law is StringLaw.CLIPPED if isinstance(law, StringLaw) else law
    taut = (elastic > 0.0) | ((np.abs(stretch) <= EDGE * np.asarray(length)) & (rate > 0.0))
    return np.where(taut, np.where(clipped, np.maximum(0.0, total), total), 0.0)


def energy(stiffness: ArrayLike | TensionCurves, length: ArrayLike, rest_length: ArrayLike) -> Array:
    """Elastic energy k max(0, L - L0)^2 / 2 [J]; arguments broadcast."""
    if isinstance(stiffness, TensionCurves):
        return stiffness.energy(np.asarray(length) - np.asarray(rest_length))
    stretch = np.maximum(0.0, np.asarray(length) - np.asarray(rest_length))
    return 0.5 * np.asarray(stiffness) * stretch**2


def force_density(stiffness: ArrayLike | TensionCurves, length: ArrayLike, rest_length: ArrayLike) -> Array:
    """Force density u = k (1 - L0/L)+ [N/m], thesis (2.58); arguments broadcast."""
    return elastic_tension(stiffness, length, rest_length) / np.asarray(length)


def rest_length(stiffness: ArrayLike | TensionCurves, length: ArrayLike, force_density: ArrayLike) -> Array:
    """Rest length L0 = L (1 - u/k) [m] that gives the force density u [N/m], below (2.58)."""
    if isinstance(stiffness, TensionCurves) and not stiffness.linear:
        found = np.asarray(length) - stiffness.stretch(np.asarray(force_density) * np.asarray(length))
        return np.asarray(np.where(stiffness.constant, 0.0, found))
    if isinstance(stiffness, TensionCurves):
        stiffness = stiffness.stiffness
    return np.asarray(length) * (1.0 - np.asarray(force_density) / np.asarray(stiffness))


def on_taut_side(
    lengths: Array, rest_lengths: Array, nodes: Array, broken: NDArray[np.bool_] | None = None
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return masks (M,) of the strings that are taut in a linear model, and of those at the edge of slackness.

    At the edge, where a string is as long as at rest to round-off, the model is that of the taut side. What is broken,
    or has no length and so no direction, is not taut. Nodes (N, 3) far from the origin have fewer digits for lengths:
    each of the two ends is rounded by half an ulp in three components, which is below 2 ε of the largest.
    """
    stretch = lengths - rest_lengths
    far = 2 * np.finfo(float).eps * float(np.abs(nodes).max(initial=0.0))
    edge = EDGE * np.maximum(lengths, np.abs(rest_lengths)) + far
    taut = (stretch >= -edge) & (lengths > 0)
    if broken is not None:
        taut &= ~broken
    return taut, taut & (np.abs(stretch) <= edge)
