"""Bounds of the round-off that is left where forces cancel."""

from __future__ import annotations

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.statics.model import StaticModel

EPS = float(np.finfo(float).eps)


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
