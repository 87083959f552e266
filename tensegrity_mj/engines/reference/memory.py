"""How many bytes a method of the DAE and the ODE works with, from the size of the state: the same on every run."""

from __future__ import annotations

from tensegrity_mj.engines.reference.method import Method

DOUBLE = 8
RK4_VECTORS = 6  # the state, four rates, a trial state
DOP853_VECTORS = 22  # 16 rates with those of the dense output (SciPy's K_extended), state, old state, dense output
RADAU_VECTORS = 15  # three stages in three forms, state, rates, dense output
RADAU_MATRICES = 4  # the Jacobian, and two factored matrices of which one is complex
WORK = 3  # integrals of work beside q and q̇


def working_bytes(method: Method, nq: int) -> int:
    """Bytes of state, stages and matrices for nq coordinates."""
    size = 2 * nq + WORK
    if method is Method.RK4:
        return DOUBLE * RK4_VECTORS * size
    if method is Method.DOP853:
        return DOUBLE * DOP853_VECTORS * size
    return DOUBLE * (RADAU_VECTORS * size + RADAU_MATRICES * size**2)
