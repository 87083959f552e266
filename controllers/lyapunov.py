"""Lyapunov control of non-minimal realizations: chapter 5 of the thesis, for any number of rods.

V is quadratic in the errors of z and b and their rates, (5.3)-(5.5), summed over the rods (5.19). With
V̇ = β - fᵀu, the law demands V̇ = -δ V, that is fᵀu = β + δ V, (5.15), with the u >= ū of smallest norm (Lemma 5.1).
A moving target (path following, §5.2) adds its velocity and acceleration to the errors. `quadratic_terms` has the
equations, which chapter 6 shares.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from tensegrity_mj.controllers import known, quadratic_law, table


@dataclass(frozen=True, eq=False)
class Lyapunov(quadratic_law.QuadraticLaw):
    """The law of Theorem 5.1 with the explicit minima of Lemma 5.1; options and errors are those of `QuadraticLaw`."""

    def describe(self) -> dict[str, Any]:
        """Plain values for the provenance of a run."""
        return {"law": "lyapunov", **super().describe()}


LAW = table.NamedLaw(Lyapunov, {"water": known.KnownWater})
