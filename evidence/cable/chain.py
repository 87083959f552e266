"""A hanging chain as the studies see it: its nodes from the top down, and places of markers along it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.structure import Structure

DIRECTION = (0.0, 1.0, 0.0)  # of the thesis' in-line excitation


@dataclass(frozen=True, eq=False)
class Chain:
    """A chain of rods that hangs from one pinned end.

    Attributes:
        nodes: (K + 1,) rows of its nodes in the structure, from the top down.
        rods: (K,) rows of its rods.
        lengths: (K,) [m].
        masses: (K,) [kg].
    """

    nodes: NDArray[np.int64]
    rods: NDArray[np.int64]
    lengths: Array
    masses: Array

    @classmethod
    def of(cls, structure: Structure) -> Chain:
        """The chain that a structure is.

        Raises:
            OptionError: if it is none: rods that branch or part, more supports than the one at the top, strings or
                point masses.
        """
        where = f"structure '{structure.name}'"
        if structure.strings or structure.point_masses or structure.rod_lumps.any():
            raise OptionError(f"{where}: a chain is of rods alone; this has strings or point masses")
        held = [row for row, rod in enumerate(structure.rods) if len(rod.support.directions)]
        if len(held) != 1 or structure.rods[held[0]].support.sigma not in (0.0, 1.0):
            raise OptionError(f"{where}: a hanging chain is held at one end of one rod; {len(held)} rods are held")
        if len(structure.rods[held[0]].support.directions) != 3 and structure.rods[held[0]].support.plane is None:
            raise OptionError(f"{where}: the chain's top must be pinned")
        pairs = structure.rod_nodes
        rod, end = held[0], int(structure.rods[held[0]].support.sigma)
        nodes, rods = [int(pairs[rod, end])], [rod]
        nodes.append(int(pairs[rod, 1 - end]))
        left = set(range(len(pairs))) - {rod}
        while left:
            following = [row for row in left if nodes[-1] in pairs[row]]
            if len(following) != 1:
                raise OptionError(
                    f"{where}: its rods are no chain; it branches or parts at '{list(structure.nodes)[nodes[-1]]}'"
                )
            (rod,) = following
            i, j = (int(one) for one in pairs[rod])
            rods.append(rod)
            nodes.append(j if i == nodes[-1] else i)
            left.remove(rod)
        if len(set(nodes)) != len(nodes):
            raise OptionError(f"{where}: its rods are no chain; they close a loop")
        order = np.array(rods)
        return cls(np.array(nodes), order, structure.rod_lengths[order], structure.rod_masses[order])

    @property
    def arc_lengths(self) -> Array:
        """(K + 1,) [m] from the top, along the chain."""
        return np.concatenate([[0.0], np.cumsum(self.lengths)])

    def weights(self, places: Sequence[float]) -> Array:
        """(P, K + 1): rows times the positions of `nodes` are those of points at arc lengths [m] from the top.

        Raises:
            OptionError: for a place beyond the chain's ends.
        """
        s = self.arc_lengths
        at = np.asarray(places, float)
        if at.ndim != 1 or not np.all((at >= 0.0) & (at <= s[-1] * (1 + 1e-9))):
            raise OptionError(f"markers at {list(places)!r} m; each must be within the chain, 0 to {s[-1]:g} m")
        # Linear functions of the arc length are what they are at the nodes: those that are 1 at one of them.
        return np.stack([np.interp(at, s, row) for row in np.eye(len(s))], axis=1)
