"""A plant whose strings are not as stiff as the law believes.

What a law commands reaches the strings as rest lengths. A winch that believes in the stiffness k̂ sets
L0 = L (1 - u/k̂) for the force density u of the law; a string of stiffness k then has k (1 - L0/L) = u k/k̂.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from tensegrity_mj.dynamics.native.compiling import c_function
from tensegrity_mj.dynamics.native.law import SOLVED, WITHIN, Command, NativeLaw, native_law, wrapped
from tensegrity_mj.dynamics.native.pointers import LAW_SIGNATURE, call_law, floats
from tensegrity_mj.dynamics.native.views import view_of
from tensegrity_mj.model.structure import Structure

_Winches, _pack_winches = view_of(
    "NominalWinches",
    **WITHIN,
    ratio=("f8", "string_count"),  # of stiffnesses k/k̂
)


@c_function(LAW_SIGNATURE, "a law that believes in another stiffness of the strings")
def _nominal(t, nodes, velocities, context, command, report):  # type: ignore[no-untyped-def]
    own = _Winches(context)
    status = call_law(own.law, t, nodes, velocities, own.context, command, report)
    if status == SOLVED:
        u = floats(command, (own.string_count,))
        for m in range(len(u)):
            u[m] *= own.ratio[m]
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
        nominal, plant = nominal.massless, plant.massless
        lengths = getattr(law, "command", Command.FORCE_DENSITY) is Command.REST_LENGTH
        return law if lengths or np.array_equal(nominal.stiffness, plant.stiffness) else cls(law, nominal, plant)

    def __call__(self, time: float, nodes: Any, velocities: Any) -> Any:
        """Force densities (M,) [N/m] of the plant's strings."""
        return np.asarray(self.law(time, nodes, velocities)) * self._ratio

    @property
    def _ratio(self) -> Any:
        return self.plant.stiffness / self.nominal.stiffness

    def native(self, structure: Structure) -> NativeLaw:
        """Return the compiled law, with the same conversion of its force densities."""
        inner = native_law(self.law, self.nominal)
        packed = _pack_winches(law=inner.address, context=inner.context, ratio=self._ratio)
        return wrapped(inner, _nominal, packed)

    def describe(self) -> dict[str, Any]:
        """Plain values for the provenance of a run."""
        description = native_law(self.law, self.nominal).description or {}
        return {**description, "nominal_stiffness": self.nominal.stiffness.tolist()}
