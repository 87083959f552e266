"""Strings in a linear model: which pull, how they are kept slack or taut, and the rest lengths that a law sets."""

from __future__ import annotations

import itertools
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.kinds import SMALLEST
from tensegrity_mj.dynamics.native.actuation import set_rest_lengths
from tensegrity_mj.dynamics.native.law import NO_SOLUTION, Command, native_law
from tensegrity_mj.dynamics.native.plant import Plant
from tensegrity_mj.dynamics.native.strings import measure_strings
from tensegrity_mj.errors import InfeasibleError, OptionError
from tensegrity_mj.linearization.chart import Chart
from tensegrity_mj.linearization.differences import STEP, central
from tensegrity_mj.model.actuation import Actuation, OnInfeasible
from tensegrity_mj.model.members import PRESTRESS
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.strings import force_density, on_taut_side
from tensegrity_mj.model.structure import Structure


class KeptStrings:
    """Strings that pull, and the rest lengths that keep them taut or slack.

    Attributes:
        taut: (M,) bool.
        input_step: (M,) of an input, [m] or [N/m].
    """

    def __init__(
        self,
        structure: Structure,
        scene: Scene,
        rest: Array,
        broken: NDArray[np.bool_],
        inputs: Command,
        move: float,
        reach: float,
    ) -> None:
        self.structure, self.rest, self.broken, self.inputs = structure, rest, broken, inputs
        lengths = structure.string_lengths(scene.nodes0)
        if np.any(lengths == 0):
            name = structure.strings[int(np.argmin(lengths))].name
            raise OptionError(f"string '{name}' has no length at this state, and so no direction: linearize elsewhere")
        rates = structure.string_rates(scene.nodes0, scene.velocities0)
        stretch = lengths - rest
        taut, self.at_edge = on_taut_side(lengths, rest, scene.nodes0, broken)
        self.k, self.pull, self.free = self._tangents(lengths, rest)
        elastic = self.pull if self.curved else structure.stiffness * stretch
        dampers = structure.damping * rates
        # A clipped string whose damper pushes more than it pulls carries nothing, and goes on so.
        self.taut = taut & ~(structure.clipped & ~self.at_edge & (elastic + dampers <= 0))
        self.u = elastic / lengths
        self.input_step = (
            np.full(len(rest), STEP * reach)
            if inputs is Command.REST_LENGTH
            else STEP * np.where(structure.curves.constant, self.u, structure.stiffness)
        )
        # Above all that nodes that move by `move`, inputs, and dampers at unit rates of δ can make of a tension.
        self.offset = (
            (np.abs(self.pull) + self.k * 4 * move if self.curved else self.k * (np.abs(stretch) + 4 * move))
            + 2 * self.input_step * (self.k if inputs is Command.REST_LENGTH else lengths)
            + 2 * structure.damping * (np.abs(rates) + 2 * float(structure.rod_lengths.max(initial=1.0)))
        )

    def rest_lengths(self, lengths: Array, change: Array, offsets: float) -> Array:
        """Rest lengths (M,) [m] for the tension at these lengths and inputs plus a number of offsets."""
        if self.inputs is Command.REST_LENGTH:
            elastic = self.k * (lengths - self.free - change)
        else:
            elastic = (self.u + change) * lengths
        if self.curved:
            elastic = np.where(self.structure.curves.constant | (self.k == 0), self.pull, elastic)
        k = self.linear.stiffness
        return np.where(self.taut, lengths - (elastic + offsets * self.offset) / k, 3 * lengths)

    def _tangents(self, lengths: Array, rest: Array) -> tuple[Array, Array, Array]:
        """Slopes [N/m] and elastic tensions [N] (M,) at the state, and where tangents of that slope are at zero [m]."""
        curves = self.structure.curves
        if not self.curved:
            return curves.stiffness, curves.stiffness * (lengths - rest), rest
        stretch = lengths - rest
        k, pull = curves.slope(np.maximum(stretch, SMALLEST)), curves.tension(stretch)
        one = np.array([string.is_linear for string in self.structure.strings], bool)
        return k, pull, np.where(one, rest, lengths - pull / np.where(k > 0, k, np.inf))

    @property
    def curved(self) -> bool:
        """True where any string has more than its stiffness."""
        return not self.structure.curves.linear

    @cached_property
    def linear(self) -> Structure:
        """The structure, with linear strings that engines give any tension by their rest lengths."""
        if not self.curved:
            return self.structure
        none = dict.fromkeys(PRESTRESS)
        strings = [
            one if one.is_linear else replace(one, stiffness=one.stiffness or 1.0, curve=(), yields=False, **none)  # type: ignore[arg-type]
            for one in self.structure.strings
        ]
        return replace(self.structure, strings=tuple(strings))

    def remarks(self) -> list[str]:
        """Remarks about strings at the edge of slackness, and about those that yield."""
        remarks = []
        if names := self._named(self.at_edge):
            remarks.append(
                f"strings {names} are at the edge of slackness (their length is their rest length): the model "
                "is that of the taut side; it has a kink there"
            )
        if names := self._named(self.structure.curves.yields & self.taut):
            remarks.append(f"strings {names} yield: the model has them unload and reload, with their first slope")
        return remarks

    def losses(self) -> list[str]:
        """Remarks about broken strings."""
        names = self._named(self.broken)
        return [f"strings {names} have broken by this time: the model is that of the others"] if names else []

    def _named(self, chosen: NDArray[np.bool_]) -> str:
        return ", ".join(s.name for s, one in zip(self.structure.strings, chosen, strict=True) if one)


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
        """Rest lengths (M,) [m] that the law sets at a state.

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
        """Derivative ∂v/∂x (M, 2n) by central differences, and remarks about kinks.

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
