"""The motion of a hanging chain by modal superposition: what small amplitudes must give."""

from __future__ import annotations

import numpy as np
from hanging_chain import HangingChain
from numpy.typing import ArrayLike

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import positive
from tensegrity_mj.library.cable import Start


def response(
    chain: HangingChain, times: ArrayLike, amplitude: float, frequency: float, start: Start = Start.MOVING_FRAME
) -> tuple[Array, Array]:
    """Displacements (T, K + 1) [m] and velocities [m/s] of the nodes, the top moved by amplitude · sin(2π f t).

    Exact in time, at resonance too. In the lab frame, the first rod alone turns at t = 0, so that all nodes but the
    top are at rest.

    Args:
        times: (T,) [s] from 0.
        amplitude: [m].
        frequency: f [Hz].
        start: in which frame the chain is at rest at t = 0.
    """
    t = np.asarray(times, float)[:, None]
    A, drive = positive("amplitude", amplitude, "m"), 2.0 * np.pi * positive("frequency", frequency, "Hz")
    omega, X = chain.modes
    force = (X.T @ chain.input) * A * drive**2
    first = np.zeros(len(omega))
    if start is Start.LAB_FRAME:
        first[0] = -A * drive / chain.lengths[0]
    rate = X.T @ (chain.mass_matrix @ first)  # of the modal coordinates at t = 0
    # η = force (ω sin Ωt - Ω sin ωt) / (ω (ω² - Ω²)) + rate sin ωt / ω, without the division by ω - Ω.
    half, mean = 0.5 * (omega - drive), 0.5 * (omega + drive)
    sine, cosine = np.sin(omega * t), np.cos(omega * t)
    slow = np.sinc(half * t / np.pi)  # sin(half t) / (half t)
    eta = force / omega * (sine - omega * t * np.cos(mean * t) * slow) / (omega + drive) + rate * sine / omega
    # η' = force Ω (cos Ωt - cos ωt) / (ω² - Ω²) + rate cos ωt, likewise.
    eta_rate = force * drive * t * np.sin(mean * t) * slow / (omega + drive) + rate * cosine
    modes = np.vstack([np.zeros(len(omega)), np.cumsum(chain.lengths[:, None] * X, axis=0)])
    top = A * np.sin(drive * t), A * drive * np.cos(drive * t)
    return top[0] + eta @ modes.T, top[1] + eta_rate @ modes.T
