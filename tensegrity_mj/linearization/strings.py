"""Strings in a linear model: which of them pull, and how they are kept from becoming slack or taut."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.dynamics.native.law import Command
from tensegrity_mj.errors import OptionError
from tensegrity_mj.linearization.differences import STEP
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.strings import StringLaw, on_taut_side
from tensegrity_mj.model.structure import Structure


class KeptStrings:
    """Which strings pull, and the rest lengths that keep it so.

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
        taut, self.at_edge = on_taut_side(lengths, rest, broken)
        elastic = structure.stiffness * stretch
        dampers = structure.damping * rates
        clipped = structure.string_law is StringLaw.CLIPPED
        # A clipped string whose damper pushes more than it pulls carries nothing, and goes on so.
        self.taut = taut & ~(clipped & ~self.at_edge & (elastic + dampers <= 0))
        self.u = structure.stiffness * stretch / lengths
        self.input_step = (
            np.full(len(rest), STEP * reach)
            if inputs is Command.REST_LENGTH
            else STEP * structure.stiffness * np.ones(len(rest))
        )
        # Above all that nodes that move by `move`, inputs, and dampers at unit rates of δ can make of a tension.
        self.offset = (
            structure.stiffness * (np.abs(stretch) + 4 * move)
            + 2 * self.input_step * (structure.stiffness if inputs is Command.REST_LENGTH else lengths)
            + 2 * structure.damping * (np.abs(rates) + 2 * float(structure.rod_lengths.max(initial=1.0)))
        )

    def rest_lengths(self, lengths: Array, change: Array, offsets: float) -> Array:
        """(M,) [m] for the tension at these lengths and inputs plus a number of offsets."""
        k = self.structure.stiffness
        if self.inputs is Command.REST_LENGTH:
            elastic = k * (lengths - self.rest - change)
        else:
            elastic = (self.u + change) * lengths
        return np.where(self.taut, lengths - (elastic + offsets * self.offset) / k, 3 * lengths)

    def remarks(self) -> list[str]:
        """What the caller should know about strings at the edge."""
        names = self._named(self.at_edge)
        if not names:
            return []
        return [
            f"strings {names} are at the edge of slackness (their length is their rest length): the model "
            "is that of the taut side; it has a kink there"
        ]

    def losses(self) -> list[str]:
        """What the caller should know about broken strings."""
        names = self._named(self.broken)
        return [f"strings {names} have broken by this time: the model is that of the others"] if names else []

    def _named(self, chosen: NDArray[np.bool_]) -> str:
        return ", ".join(s.name for s, one in zip(self.structure.strings, chosen, strict=True) if one)
