"""A law in a linear model: the rest lengths that it sets, and their derivative."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.dynamics.native.actuation import set_rest_lengths
from tensegrity_mj.dynamics.native.law import NO_SOLUTION, Command, native_law
from tensegrity_mj.dynamics.native.plant import Plant
from tensegrity_mj.dynamics.native.strings import measure_strings
from tensegrity_mj.errors import InfeasibleError, OptionError
from tensegrity_mj.linearization.chart import Chart
from tensegrity_mj.linearization.differences import central
from tensegrity_mj.model.actuation import Actuation, OnInfeasible
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.strings import force_density

# A law's derivative: steps tried, relative to R. Where its kinks are near, only short ones are right.
LAW_STEPS = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)
KINK = 1e-3  # of the largest derivative: what the two sides may differ by


class SetRestLengths:
    """The rest lengths that a law sets, as a function of the state."""

    def __init__(self, scene: Scene, law: Any, time: float) -> None:
        native = native_law(law, scene.structure)
        if native.discontinuous:
            raise OptionError(native.discontinuous)
        self.scene, self.time = scene, time
        self.plant = Plant(scene, native, Actuation.continuous(), OnInfeasible.STOP)

    def __call__(self, nodes: Array, velocities: Array) -> Array:
        """(M,) [m].

        Raises:
            InfeasibleError, ControllerError: what the law says there.
        """
        plant = self.plant
        plant["nodes"][:], plant["velocities"][:] = nodes, velocities
        measure_strings(plant.address)
        status = int(set_rest_lengths(plant.address, self.time))
        plant.raise_if_failed(max(status, plant["status"]), self.time)
        if status == NO_SOLUTION:
            raise InfeasibleError(plant.infeasible_message(self.time))
        return np.array(plant["rest"])

    def derivative(self, chart: Chart, rate0: Array, reach: float, inputs: Command) -> tuple[Array, list[str]]:
        """∂v/∂x (M, 2n) by central differences, and remarks about kinks.

        For each column that step is taken whose result differs least from that of the next shorter one.
        """
        structure = self.scene.structure
        n = chart.size

        def value(x: Array) -> Array:
            nodes, velocities = chart.state(x[:n], rate0 + x[n:])
            rest = self(nodes, velocities)
            if inputs is Command.REST_LENGTH:
                return rest
            lengths = structure.string_lengths(nodes)
            if not structure.curves.linear:
                return force_density(structure.curves, lengths, rest)
            return structure.stiffness * (1 - rest / lengths)

        here = value(np.zeros(2 * n))
        gain = np.zeros((len(structure.strings), 2 * n))
        gaps = np.zeros_like(gain)
        for k in range(2 * n):
            unit = np.eye(2 * n)[k]
            scale = reach / chart.lever(k % n)
            tried = [central(lambda x, u=unit: value(x * u), h * scale) for h in LAW_STEPS]  # type: ignore[misc]
            changes = [float(np.abs(a - b).max(initial=0.0)) for a, b in itertools.pairwise(tried)]
            gain[:, k] = tried[int(np.argmin(changes)) + 1 if changes[0] > min(changes) else 0]
            h = LAW_STEPS[-1] * scale
            ahead, behind = value(h * unit) - here, here - value(-h * unit)
            gaps[:, k] = (ahead - behind) / h
        rows = np.abs(gaps).max(axis=1, initial=0.0) > KINK * np.abs(gain).max(initial=0.0)
        if not rows.any():
            return gain, []
        names = ", ".join(s.name for s, kink in zip(structure.strings, rows, strict=True) if kink)
        return gain, [f"the law has a kink at this state in strings {names}: the closed loop is the mean of its sides"]
