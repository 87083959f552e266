"""Projection based control of non-minimal realizations: chapter 6 of the thesis, for any number of rods.

The error of b enters V through its part across the rod only, p = P e_b, so that the law does not push along rods, where
their rigidity resists anyway. P projects onto b⊥, the rod as it is (6.2), or onto b_d⊥, the rod as it shall be (6.20).
Without K, V is zero also at the mirror image b = -b_d: the law then converges to one of the two, and only locally.
With K ≻ 0 only b_d is left. Otherwise the law is that of chapter 5; `quadratic_terms` has the equations of both.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics.checks import member
from tensegrity_mj.controllers import known, quadratic_law, quadratic_terms, table
from tensegrity_mj.controllers.quadratic_terms import gain_records


@dataclass(frozen=True, eq=False)
class Projection(quadratic_law.QuadraticLaw):
    """The law of Theorem 6.1 with the explicit minima of Lemma 5.1.

    Attributes:
        ...: those of `QuadraticLaw`.
        onto: plane that the error of b is projected onto.
        stiffness: K of (6.3), symmetric and positive semidefinite: a number or a (3, 3) matrix for every rod, or a
            mapping rod name -> K (others have none).

    Raises:
        OptionError, SceneError: as `QuadraticLaw`, and for K that is not positive semidefinite.
    """

    onto: quadratic_terms.Onto = quadratic_terms.Onto.CURRENT
    stiffness: ArrayLike | Mapping[str, ArrayLike] = 0.0

    def __post_init__(self) -> None:
        member("onto", self.onto, quadratic_terms.Onto)
        super().__post_init__()

    @property
    def projected_onto(self) -> quadratic_terms.Onto:
        """Plane that the errors of b are projected onto."""
        return self.onto

    @cached_property
    def gains(self) -> np.ndarray[Any, Any]:
        """X, Y, Z and K of every rod and point mass, as records of dtype `quadratic_terms.GAINS`."""
        return gain_records(self.structure, self.translation, self.rotation, self.stiffness)

    def describe(self) -> dict[str, Any]:
        """Plain values for the provenance of a run."""
        K = [self.gains[number]["Kb"].tolist() for number in range(len(self.structure.rods))]
        return {"law": "projection", "onto": self.onto.value, "stiffness": K, **super().describe()}


LAW = table.NamedLaw(Projection, {"water": known.KnownWater})
