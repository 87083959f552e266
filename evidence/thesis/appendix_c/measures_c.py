"""Measures that the rows of appendix C take of its beams.

C.1: stiffness [kN/m], stress [MPa], buckling, slack strings. C.2: how much beams swing in waves, whose amplitude is the
largest of any stage along the waves, half the distance from its lowest to its highest place.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from evidence.families.in_waves import STEEPNESS
from evidence.families.thesis_towers import appendix_beam
from evidence.thesis.appendix_c.beams import BY_PRESTRESS, BeamRun, wave_label
from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.library.cable import GRAVITY
from tensegrity_mj.model.structure import Structure

DROPPED = 0.5  # of the stiffness at zero load: below it, a beam has buckled


class Buckling(NamedTuple):
    """Point at which the stiffness drops: deformation [m] and load [kN]; NaN where it does not."""

    deformation: float
    load: float


def initial(run: BeamRun, beam: str, axis: int = 0) -> float:
    """[kN/m] at zero load: 0 along the beam, 1 and 2 across it."""
    return float(run.of(beam, "stiffness")[axis, axis]) / 1e3


def anisotropy(run: BeamRun, beam: str) -> float:
    """Return the anisotropy of the stiffness across the beam at zero load: the largest over the least, less one."""
    values = np.linalg.eigvalsh(run.of(beam, "stiffness")[1:, 1:])
    return float(values[-1] / values[0] - 1.0)


def spread(values: Sequence[float]) -> float:
    """The largest over the smallest, less one."""
    return max(values) / min(values) - 1.0


def rises(values: Sequence[float] | Array) -> bool:
    """Return whether each value is larger than the one before."""
    return bool(np.all(np.diff(values) > 0))


def stiffness(run: BeamRun, label: str) -> Array:
    """[kN/m] along a path."""
    return run.of(label, "K").astype(float) / 1e3


def buckling(run: BeamRun, label: str) -> Buckling:
    """Find where the stiffness falls below half of what it was at zero load, or the deformation turns back."""
    K, w, F = (run.of(label, name).astype(float) for name in ("K", "w", "F"))
    k = _stiff_points(run, label)
    if k == len(K):
        return Buckling(math.nan, math.nan)
    turned = run.of(label, "turned")
    part = 0.0 if turned[k] else float((K[k - 1] - DROPPED * K[0]) / (K[k - 1] - K[k]))
    return Buckling(float(w[k - 1] + part * (w[k] - w[k - 1])), float(F[k - 1] + part * (F[k] - F[k - 1])) / 1e3)


def stiffest_before(run: BeamRun, label: str) -> float:
    """[kN/m] the largest stiffness before it buckles."""
    return float(stiffness(run, label)[: _stiff_points(run, label)].max())


def _stiff_points(run: BeamRun, label: str) -> int:
    """Return the number of points before the beam buckles."""
    K = stiffness(run, label)
    gone = np.flatnonzero(run.of(label, "turned") | (K / K[0] < DROPPED))
    return int(gone[0]) if len(gone) else len(K)


def first_slack(run: BeamRun, label: str) -> float:
    """[m] the deformation at which the first string becomes slack, between two points; infinite where none does."""
    least, w = run.of(label, "least"), run.of(label, "w")
    found = np.flatnonzero(least < 0)
    if not len(found) or found[0] == 0:
        return 0.0 if len(found) else math.inf
    k = int(found[0])
    return float(w[k - 1] + (w[k] - w[k - 1]) * least[k - 1] / (least[k - 1] - least[k]))


def before_buckling(run: BeamRun, imperfect: BeamRun, label: str) -> float:
    """Return the relative change of the perfect beam's stiffness up to where the imperfect one buckles."""
    K, w = stiffness(run, label), run.of(label, "w")
    there = float(np.interp(buckling(imperfect, label).deformation, w, K))
    return there / float(K[0]) - 1.0


def apart(run: BeamRun, beam: str) -> float:
    """[kN/m] the largest difference of the stiffness in y from that in z, at equal deformation."""
    y, z = f"{beam} y", f"{beam} z"
    other = np.interp(run.of(beam + " y", "w"), run.of(z, "w"), stiffness(run, z))
    return float(np.abs(stiffness(run, y) - other).max())


# ------------------------------------------------------------------------------------------------------- the model


def beam_structure() -> Structure:
    """TB1 as it is laid out."""
    return appendix_beam("TB1", form_found=False).structure


def euler_load() -> float:
    """[kN] of a rod."""
    structure = beam_structure()
    section = structure.rods[0].section
    assert section is not None
    return section.euler_load(float(structure.rod_lengths[0])) / 1e3


# ------------------------------------------------------------------------------------------------- several beams


def higher_everywhere(run: BeamRun, labels: Sequence[str]) -> bool:
    """Return whether the stiffness is higher from one to the next at every deformation."""
    return all(
        bool(np.all(np.interp(run.of(a, "w"), run.of(b, "w"), stiffness(run, b)) > stiffness(run, a)))
        for a, b in itertools.pairwise(labels)
    )


def changed_at(run: BeamRun, label: str, deformation: float) -> float:
    """Return the change of the stiffness there [kN/m]."""
    K = stiffness(run, label)
    return float(np.interp(deformation, run.of(label, "w"), K) - K[0])


# -------------------------------------------------------------------------------------------------- beams in waves


def amplitude(run: BeamRun, beam: str, height: float) -> float:
    """[m] of the stage that swings most along the waves."""
    return float(run.of(wave_label(beam, height), "along").max())


def swings_grow(run: BeamRun, heights: Sequence[float]) -> bool:
    """Return whether every beam swings more in higher waves."""
    return all(rises([amplitude(run, beam, height) for height in heights]) for beam in BY_PRESTRESS)


def falls(run: BeamRun, height: float) -> bool:
    """Return whether beams swing less the more they are prestressed."""
    return rises([-amplitude(run, beam, height) for beam in BY_PRESTRESS])


def resonant_height(run: BeamRun, label: str, pair: int) -> float:
    """[m] of the wave whose frequency is that of a pair of bending motions in water, counted from 0."""
    omega = float(run.of(label, "in_water")[2 * pair])
    return STEEPNESS * 2 * math.pi * GRAVITY / omega**2
