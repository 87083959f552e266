"""Options of the allocation of force densities, §4.4-4.5: objective, bounds and sums of `optimal_allocation`."""

from __future__ import annotations

import enum
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics.fields import field, value
from tensegrity_mj.basics.kinds import choice, finite, flag, names, parts
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.structure import Structure

LINEAR = (
    "the least fᵀu jumps from string to string, so an integrator's stages would see different laws: run it sampled "
    "(hold force density or hold rest length)"
)
HELD = (
    "what it holds where there is no admissible u depends on when it was called before: run it sampled (hold force "
    "density or hold rest length), or choose WhenInfeasible.STOP or RELAX"
)


class WhenInfeasible(enum.Enum):
    """Action to take where no admissible u exists."""

    STOP = "stop"  # raise InfeasibleError, which names the constraint at fault
    RELAX = "relax"  # the u within its bounds that violates equations and sums least (sum of squares, SI units)
    HOLD = "hold"  # the last admissible u


@value("sum", OptionError)
class Sum:
    """One row of A_sum u >= u_sum, (4.13).

    Attributes:
        minimum: u_sum [N/m].
        strings: names of the strings that count; None for all (strategy 1).
    """

    minimum: float = field(finite("N/m"))
    strings: tuple[str, ...] | None = field(names("string"), default=None, none='None, in files "all"')


@value("allocation", OptionError, eq=False)
class Allocation:
    """Objective and constraints of the force densities.

    Attributes:
        weight: H: a number or (M,) for the diagonal, or a symmetric positive definite (M, M).
        minimum_force_density, maximum_force_density: u_min >= 0 and u_max [N/m], numbers or (M,).
        sums: strategy 1 is one sum over all strings, strategy 2 one over the strings of each cell.
        linear: f (M,) of the objective fᵀu, which then replaces the quadratic one; f >= 0, or u_max finite.
        on_infeasible: see `WhenInfeasible`.
        respect_limits: whether the strings' own `max_force_density` and `min_rest_length` bound u too.
    """

    weight: ArrayLike = field(None, default=1.0)
    minimum_force_density: ArrayLike = field(None, default=0.0)
    maximum_force_density: ArrayLike = field(None, default=np.inf)
    sums: tuple[Sum, ...] = field(parts(Sum), default=())
    linear: ArrayLike | None = field(None, default=None)
    on_infeasible: WhenInfeasible = field(choice(WhenInfeasible), default=WhenInfeasible.STOP)
    respect_limits: bool = field(flag(), default=True)

    @property
    def discontinuous(self) -> str:
        """Reason why a law with this allocation cannot run continuously, or ""."""
        if self.linear is not None:
            return LINEAR
        return HELD if self.on_infeasible is WhenInfeasible.HOLD else ""

    def describe(self, structure: Structure) -> dict[str, Any]:
        """Plain values for the provenance of a run."""
        everything = [string.name for string in structure.strings]
        return {
            "weight": np.asarray(self.weight, float).tolist(),
            "minimum_force_density": np.asarray(self.minimum_force_density, float).tolist(),
            "maximum_force_density": [None if x == np.inf else float(x) for x in np.ravel(self.maximum_force_density)],
            "sums": [[list(one.strings or everything), float(one.minimum)] for one in self.sums],
            "linear": None if self.linear is None else np.asarray(self.linear, float).tolist(),
            "on_infeasible": self.on_infeasible.value,
            "respect_limits": self.respect_limits,
        }
