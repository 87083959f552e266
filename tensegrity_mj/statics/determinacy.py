"""Rods' forces and reactions that equilibrium determines, and those that are a choice.

Where rigid rods and supports have states of self-stress s of their own, Zᵀ Cᵀ s = 0, every N + Σ a s is in equilibrium
with the same loads. The forces of all rods in some s are a choice, and so are the reactions that it changes, (1 - Z Zᵀ)
Cᵀ s. Chosen is the least sum of squares: Σ N² is, but for a factor, the energy of rods of equal stiffness EA/ℓ, so that
these are the forces of such rods as they become stiff.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.model.redundancy import MOST_RODS, SHARE
from tensegrity_mj.statics import linear_systems
from tensegrity_mj.statics.model import StaticModel

RULE = "the least sum of squares, as of rods of one stiffness EA/ℓ"
REMEDY = "--rods elastic finds the forces of rods with sections"


@dataclass(frozen=True)
class Determinacy:
    """Determined and chosen forces of one state.

    Attributes:
        states: how many states of self-stress rigid rods and supports have alone; None where it was not looked at.
        chosen: names of the rods whose forces are a choice.
        reactions: names of the nodes whose reactions are.
        is_clear: whether their number does not hang on digits that the nodes do not have.
    """

    states: int | None = 0
    chosen: tuple[str, ...] = ()
    reactions: tuple[str, ...] = ()
    is_clear: bool = True

    def describe(self) -> str:
        """What is to be said beside the forces, or ""."""
        if self.states is None:
            return f"not looked at whether forces are determined: more than {MOST_RODS} rigid rods; {REMEDY}"
        if not self.is_clear:
            return f"undecided whether forces are determined: rods are nearly redundant; {REMEDY}"
        if not self.chosen:
            return ""
        rods = ", ".join(f"'{name}'" for name in self.chosen[:8]) + (", ..." if len(self.chosen) > 8 else "")
        held = f", and the reactions at {len(self.reactions)} nodes with them" if self.reactions else ""
        return (
            f"{len(self.chosen)} of them ({rods}) are a choice{held}: these rigid rods are redundant, so that "
            f"equilibrium does not determine their forces; shown is {RULE}; {REMEDY}"
        )


def determinacy(model: StaticModel, x: Array) -> Determinacy:
    """Of rigid rods at x (3N,); those of elastic ones are determined by their lengths."""
    rigid = int(np.sum(model.compliance == 0))
    if not rigid:
        return Determinacy()
    if rigid > MOST_RODS:
        return Determinacy(None)
    own, clear = linear_systems.own_stresses(model, x)
    # A state of unit length is known to 1e-12 over the least singular value that counts: SHARE.
    inside = np.abs(own).max(axis=1, initial=0.0) > SHARE
    pushed = model.rod_slopes(x).T @ own
    pushed = pushed - model.boundary.Z @ (model.boundary.Z.T @ pushed)
    held = np.abs(pushed).max(axis=1, initial=0.0).reshape(-1, 3).max(axis=1) > SHARE
    structure = model.structure
    rods = tuple(rod.name for rod, chosen in zip(structure.rods, inside, strict=False) if chosen)
    nodes = tuple(name for name, chosen in zip(structure.node_names, held, strict=True) if chosen)
    return Determinacy(own.shape[1], rods, nodes if rods else (), clear)
