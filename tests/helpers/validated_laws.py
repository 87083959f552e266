"""Laws of a user's own, for the tests of `validate`: as workers and files find them."""

from __future__ import annotations

from typing import Any

import numpy as np

import tensegrity_mj as tmj


def damp(time: float, nodes: Any, velocities: Any) -> Any:
    """A Python law for any structure of three strings, with a margin of its own."""
    return np.array([0.03, 0.02, 0.01]) + 0.01 * np.tanh(velocities[1])


def slower(scene: tmj.Scene) -> Any:
    """Makes a law."""
    return tmj.controllers.from_scene(scene, decay_rate=0.1)


class Late:
    """A law that must be sampled, and that loses its solution at 0.5 s; its margin is (t - 0.3)² + 0.25."""

    discontinuous = "it switches at 0.1 s"
    report = (np.nan,) * 5

    def __init__(self, scene: tmj.Scene) -> None:
        self.size = len(scene.structure.strings)

    def __call__(self, time: float, nodes: Any, velocities: Any) -> Any:
        self.report = ((time - 0.3) ** 2 + 0.25, np.nan, np.nan, np.nan, np.nan)
        if time >= 0.4995:
            raise tmj.errors.InfeasibleError("its time is over")
        return np.full(self.size, 0.05 if time < 0.1 else 0.0)


no_law = 3
