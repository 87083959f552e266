"""The largest force density that each string may have: a law's own ceiling, and the limits of real strings."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.dynamics.native.compiling import njit
from tensegrity_mj.dynamics.native.strings import string_length
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.structure import Structure


@njit
def write_ceilings(nodes: Any, segments: Any, ranges: Any, limits: Any, out: Any) -> None:
    """Write the ceilings at node positions (N, 3) into out (M,); limits are the rows of `StringLimits.packed`."""
    for m in range(len(ranges)):
        highest, k, shortest = limits[0, m], limits[1, m], limits[2, m]
        if shortest > -np.inf:
            length = string_length(nodes, segments, ranges[m])
            highest = min(highest, max(k * (1.0 - shortest / length), 0.0))
        out[m] = highest


@dataclass(frozen=True, eq=False)
class StringLimits:
    """Ceilings of the strings' force densities, min(u_max, k (1 - L0_min/L)) and at least 0.

    A string shorter than its smallest rest length hangs slack, whence u = 0.

    Attributes:
        structure: whose strings.
        max_force_density: u_max (M,) [N/m], ∞ where there is none.
        min_rest_length: L0_min (M,) [m], -∞ where there is none.
    """

    structure: Structure
    max_force_density: Array
    min_rest_length: Array

    @classmethod
    def of(cls, structure: Structure, maximum: ArrayLike = np.inf, respect_strings: bool = True) -> StringLimits:
        """A law's own ceiling u_max, a number or (M,), and the strings' own limits where they are to be respected.

        Raises:
            OptionError: for a ceiling that is not >= 0, or of another shape.
        """
        size = len(structure.strings)
        try:
            if np.ndim(maximum) and np.shape(maximum) != (size,):
                raise ValueError
            highest = np.broadcast_to(np.asarray(maximum, float), (size,))
            if not np.all(highest >= 0):
                raise ValueError
        except (TypeError, ValueError, OverflowError):
            raise OptionError(
                f"maximum_force_density = {maximum!r}; it must be a number >= 0 or an array of shape ({size},) [N/m], "
                "inf for no limit"
            ) from None
        if not respect_strings:
            return cls(structure, np.array(highest), np.full(size, -np.inf))
        return cls(
            structure,
            np.minimum(highest, structure.limits("max_force_density")),
            structure.limits("min_rest_length"),
        )

    @property
    def of_state(self) -> bool:
        """True where the ceilings depend on the strings' lengths."""
        return bool(np.any(self.min_rest_length > -np.inf))

    @cached_property
    def packed(self) -> Array:
        """u_max, k and L0_min as rows (3, M), for compiled code."""
        return np.array([self.max_force_density, self.structure.stiffness, self.min_rest_length])

    def ceilings(self, nodes: Array) -> Array:
        """The largest admissible u (M,) [N/m] at node positions (N, 3) [m]."""
        out = np.empty(len(self.structure.strings))
        paths = self.structure.paths
        write_ceilings(np.asarray(nodes, float), paths.nodes, paths.ranges, self.packed, out)
        return out
