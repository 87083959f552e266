"""What the laws of chapters 5 and 6 have in common as objects: their options, and how they are asked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.controllers.gains import Gains
from tensegrity_mj.controllers.quadratic_form import Onto, QuadraticForm, Terms
from tensegrity_mj.dynamics.native.law import Command, NativeLaw, Report
from tensegrity_mj.model.elements.water import Water
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.model.target import Target


@dataclass(frozen=True, eq=False)
class QuadraticLaw:
    """A law that makes a quadratic V fall as V̇ = -δ V, with the explicit minima of Lemma 5.1.

    Attributes:
        structure: what the law believes it controls (masses, supports, lengths).
        target: set-point, path or curve; an array (N, 3) counts as a set-point.
        decay_rate: δ [1/s] > 0 of V̇ = -δ V.
        norm: 1, 2 or math.inf. 1 and ∞ give discontinuous laws, which run sampled only.
        translation, rotation: gains of every rod, or a mapping rod name -> Gains (others keep the default).
        minimum_force_density: ū [N/m] >= 0, scalar or (M,): the residual prestress at the end of §5.3.
        maximum_force_density: [N/m], scalar or (M,), inf for none.
        respect_limits: keep within the strings' `max_force_density` and `min_rest_length` too.
        gravity: g [m/s²] that the law knows of.
        water: what the law knows of it, waves and current included; None for nothing.

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
    water: Water | None = None

    command = Command.FORCE_DENSITY

    def __post_init__(self) -> None:
        form = self.form  # checks everything
        object.__setattr__(self, "target", form.target)
        object.__setattr__(self, "decay_rate", form.decay_rate)
        object.__setattr__(self, "gravity", form.gravity)
        object.__setattr__(self, "water", form.water)

    @cached_property
    def form(self) -> QuadraticForm:
        """The law's equations, compiled."""
        return self._form()

    def _form(self, onto: Onto | None = None, stiffness: ArrayLike | Mapping[str, ArrayLike] = 0.0) -> QuadraticForm:
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
            self.water,
            onto,
            stiffness,
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
        """Is the (last) target an equilibrium, as the theorems assume? Residual [N], u [N/m], self-stress modes."""
        return self.form.target_equilibrium()
