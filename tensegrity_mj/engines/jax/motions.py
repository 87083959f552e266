"""Moved supports as array functions: the displacement of each at a time, whose rates come by differentiation."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np

from tensegrity_mj.engines.jax.arrays import times
from tensegrity_mj.errors import SceneError
from tensegrity_mj.model.capabilities import FUNCTION_MOTIONS
from tensegrity_mj.model.motion import Motion
from tensegrity_mj.model.scene import Scene


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
    """Σ amplitude · sin(ω t + phase), and Σ c_k (t - t_i)^k by the data's quintics; still before and after these."""
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
