"""Projection based control of non-minimal realizations: chapter 6 of the thesis, for any number of rods.

The error of b enters V through its part across the rod only, p = P e_b, so that the law does not push along rods, where
their rigidity resists anyway. P projects onto b⊥, the rod as it is (6.2), or onto b_d⊥, the rod as it shall be (6.20).
Without K, V is zero also at the mirror image b = -b_d: the law then converges to one of the two, and only locally.
With K ≻ 0 only b_d is left. Otherwise the law is that of chapter 5; `quadratic_form` has the equations of both.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tensegrity_mj.checks import member
from tensegrity_mj.controllers.gains import Gains
from tensegrity_mj.controllers.quadratic_form import Onto, QuadraticForm, Terms
from tensegrity_mj.law import Command, NativeLaw, Report
from tensegrity_mj.scene import Target
from tensegrity_mj.structure import Structure

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Projection:
    """The law of Theorem 6.1 with the explicit minima of Lemma 5.1.

    Attributes:
        structure: what the law believes it controls (masses, supports, lengths).
        target: set-point, path or curve; an array (N, 3) counts as a set-point.
        decay_rate: δ [1/s] > 0 of V̇ = -δ V.
        norm: 1, 2 or math.inf. 1 and ∞ give discontinuous laws, which run sampled only.
        translation, rotation: gains of every rod, or a mapping rod name -> Gains (others keep the default).
        minimum_force_density: ū [N/m] >= 0, scalar or (M,): the residual prestress at the end of §5.3.
        gravity: g [m/s²] that the law knows of.
        maximum_force_density: [N/m], scalar or (M,), inf for none.
        respect_limits: keep within the strings' `max_force_density` and `min_rest_length` too.
        onto: what the error of b is projected onto.
        stiffness: K of (6.3), symmetric and positive semidefinite: a number or a (3, 3) matrix for every rod, or a
            mapping rod name -> K (others have none).

    Raises:
        OptionError, SceneError: for gains that are not positive definite, K that is not positive semidefinite, δ <= 0,
            another norm, a bad target, a ceiling below its threshold.
    """

    structure: Structure
    target: Target | Array
    decay_rate: float = 1.0
    norm: float = 2
    translation: Gains | Mapping[str, Gains] = field(default_factory=Gains)
    rotation: Gains | Mapping[str, Gains] = field(default_factory=Gains)
    minimum_force_density: ArrayLike = 0.0
    gravity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    maximum_force_density: ArrayLike = np.inf
    respect_limits: bool = True
    onto: Onto = Onto.CURRENT
    stiffness: ArrayLike | Mapping[str, ArrayLike] = 0.0

    command = Command.FORCE_DENSITY

    def __post_init__(self) -> None:
        member("onto", self.onto, Onto)
        form = self.form  # checks everything else
        object.__setattr__(self, "target", form.target)
        object.__setattr__(self, "decay_rate", form.decay_rate)
        object.__setattr__(self, "gravity", form.gravity)

    @cached_property
    def form(self) -> QuadraticForm:
        """The law's equations, compiled."""
        return QuadraticForm(
            self.structure,
            self.target,
            self.decay_rate,
            self.norm,
            self.translation,
            self.rotation,
            self.minimum_force_density,
            self.maximum_force_density,
            self.respect_limits,
            self.gravity,
            self.onto,
            self.stiffness,
        )

    @property
    def discontinuous(self) -> str:
        """Why the law cannot run continuously; empty for norm 2."""
        return self.form.discontinuous

    def native(self, structure: Structure) -> NativeLaw:
        """The compiled law, for a plant with the same nodes and strings.

        Raises:
            OptionError: for any other.
        """
        return self.form.native(structure)

    def __call__(self, time: float, nodes: Array, velocities: Array) -> Array:
        """u (M,) [N/m] at one state.

        Raises:
            InfeasibleError: where no admissible u exists, with the margin.
        """
        return self.form.control(time, nodes, velocities)

    def evaluate(self, time: float, nodes: Array, velocities: Array) -> tuple[Array, float, float]:
        """u (M,) [N/m], the feasibility margin max(v/α) and V at one state."""
        u, report = self.form.evaluate(time, nodes, velocities)
        return u, float(report[Report.FEASIBILITY_MARGIN]), float(report[Report.LYAPUNOV])

    def terms(self, time: float, nodes: Array, velocities: Array) -> Terms:
        """The parts of V, and β and f of V̇ = β - fᵀu, at one state."""
        return self.form.terms(time, nodes, velocities)

    def target_equilibrium(self) -> dict[str, Any]:
        """Is the (last) target an equilibrium, as Theorem 6.1 assumes? Residual [N], u [N/m], self-stress modes."""
        return self.form.target_equilibrium()

    def describe(self) -> dict[str, Any]:
        """Plain values for the provenance of a run."""
        K = [self.form.gains[number]["Kb"].tolist() for number in range(len(self.structure.rods))]
        return {"law": "projection", "onto": self.onto.value, "stiffness": K, **self.form.describe()}
