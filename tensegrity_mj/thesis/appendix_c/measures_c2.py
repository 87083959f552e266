"""What the rows of appendix C.2 measure: how much beams swing in waves.

The amplitude is the largest of any stage along the waves, half the distance from its lowest to its highest place.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from tensegrity_mj.library.beam_in_waves import GRAVITY, STEEPNESS
from tensegrity_mj.thesis.appendix_c.beams import BY_PRESTRESS, BeamRun, wave_label
from tensegrity_mj.thesis.appendix_c.measures_c import rises


def amplitude(run: BeamRun, beam: str, height: float) -> float:
    """[m] of the stage that swings most along the waves."""
    return float(run.of(wave_label(beam, height), "along").max())


def swings_grow(run: BeamRun, heights: Sequence[float]) -> bool:
    """Whether every beam swings more in higher waves."""
    return all(rises([amplitude(run, beam, height) for height in heights]) for beam in BY_PRESTRESS)


def falls(run: BeamRun, height: float) -> bool:
    """Whether beams swing less the more they are prestressed."""
    return rises([-amplitude(run, beam, height) for beam in BY_PRESTRESS])


def swings_fall(run: BeamRun, heights: Sequence[float]) -> bool:
    """Whether at every height beams swing less the more they are prestressed."""
    return all(falls(run, height) for height in heights)


def no_swings_fall(run: BeamRun, heights: Sequence[float]) -> bool:
    """Whether at none of the heights they do."""
    return not any(falls(run, height) for height in heights)


def largest_swing(run: BeamRun) -> float:
    """[m] of all that were run."""
    return max(float(np.max(values["along"])) for values in run.values.values())


def resonant_height(run: BeamRun, label: str, pair: int) -> float:
    """[m] of the wave whose frequency is that of a pair of bending motions in water, counted from 0."""
    omega = float(run.of(label, "in_water")[2 * pair])
    return STEEPNESS * 2 * math.pi * GRAVITY / omega**2
