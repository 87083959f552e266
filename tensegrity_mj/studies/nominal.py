"""A plant whose strings are not as stiff as the law believes.

What a law commands reaches the strings as rest lengths. A winch that believes in the stiffness k̂ sets
L0 = L (1 - u/k̂) for the force density u of the law; a string of stiffness k then has k (1 - L0/L) = u k/k̂.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tensegrity_mj.dynamics.native.compiling import c_function
from tensegrity_mj.dynamics.native.law import SOLVED, Command, NativeLaw, native_law
from tensegrity_mj.dynamics.native.pointers import LAW_SIGNATURE, address_of, call_law, floats, integers
from tensegrity_mj.model.structure import Structure


@c_function(LAW_SIGNATURE, "a law that believes in another stiffness of the strings")
def _nominal(t, nodes, velocities, context, command, report):  # type: ignore[no-untyped-def]
    table = integers(context, (4,))
    status = call_law(table[0], t, nodes, velocities, table[1], command, report)
    if status == SOLVED:
        u, ratio = floats(command, (table[2],)), floats(table[3], (table[2],))
        for m in range(len(u)):
            u[m] *= ratio[m]
    return status


@dataclass(frozen=True, eq=False)
class NominalWinches:
    """A law whose force densities are set by winches that believe in the nominal stiffness.

    Attributes:
        law: the law, or a Python function.
        nominal: what the law and the winches believe in.
        plant: what is simulated.
    """

    law: Any
    nominal: Structure
    plant: Structure

    @classmethod
    def between(cls, law: Any, nominal: Structure, plant: Structure) -> Any:
        """The law itself where stiffnesses are equal, or where it commands rest lengths, which need none."""
        lengths = getattr(law, "command", Command.FORCE_DENSITY) is Command.REST_LENGTH
        return law if lengths or np.array_equal(nominal.stiffness, plant.stiffness) else cls(law, nominal, plant)

    def __call__(self, time: float, nodes: Any, velocities: Any) -> Any:
        """Force densities (M,) [N/m] of the plant's strings."""
        return np.asarray(self.law(time, nodes, velocities)) * self._ratio

    @property
    def _ratio(self) -> Any:
        return np.ascontiguousarray(self.plant.stiffness / self.nominal.stiffness)

    def native(self, structure: Structure) -> NativeLaw:
        """The same, compiled."""
        inner = native_law(self.law, self.nominal)
        ratio = self._ratio
        table = np.array([inner.address, inner.context, len(ratio), address_of(ratio)], np.int64)
        return replace(
            inner, address=_nominal.address, context=address_of(table), keep=(inner, inner.keep, ratio, table)
        )

    def describe(self) -> dict[str, Any]:
        """Plain values for the provenance of a run."""
        description = native_law(self.law, self.nominal).description or {}
        return {**description, "nominal_stiffness": self.nominal.stiffness.tolist()}
