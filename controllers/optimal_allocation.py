"""Optimal allocation of force densities, §4.4-4.5: the string controls of least cost that meet linear equations.

    minimise ½ uᵀHu (or fᵀu)   subject to   A u = d,  A_sum u >= u_sum,  u_min <= u <= u_max,      (4.10)-(4.14)

for any law that demands A u = d. `Allocation` says what is wanted; `Allocator` finds it for a structure.
"""

from __future__ import annotations

import enum
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import check_definite, instance, real_array, sequence_of, shape_of
from tensegrity_mj.basics.dependencies import of_extra, optional
from tensegrity_mj.basics.fields import field, value
from tensegrity_mj.basics.kinds import choice, finite, flag, names, parts
from tensegrity_mj.controllers.allocation import StringLimits
from tensegrity_mj.controllers.quadratic_program import NO_POINT, SETTLED, Program, columns_of, maximize_dual
from tensegrity_mj.errors import ControllerError, InfeasibleError, OptionError
from tensegrity_mj.model.structure import Structure

ACCURACY = 1e-8  # relative; what a library's answer may violate before it counts as none
NEWTON_STEPS = 60
LEAST_VIOLATION = 1e-7  # of the curvature: the first step towards the least violation counts costs with this weight


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


class Equation(NamedTuple):
    """Name of one row of A u = d in messages, and its unit."""

    name: str
    unit: str


class Allotment(NamedTuple):
    """An answer: u (M,) [N/m], and by how much it violates equations and sums at most."""

    u: Array
    violation: float


class Allocator:
    """Solves an `Allocation` for a structure, again and again.

    The multipliers of the last answer are where the next search starts: it is short then, but its end is the same.

    Args:
        allocation: objective and constraints.
        structure: whose strings.
        equations: the rows of A, for messages.

    Raises:
        OptionError: for values that are out of range, or do not fit the structure.
    """

    def __init__(self, allocation: Allocation, structure: Structure, equations: Sequence[Equation]) -> None:
        instance("allocation", allocation, Allocation, "use Allocation(...)")
        instance("structure", structure, Structure, "use a Structure (scene.structure)")
        self.options = allocation
        self.names = [string.name for string in structure.strings]
        self.equations = list(sequence_of("equations", equations, OptionError))
        M = len(self.names)
        floor = allocation.minimum_force_density
        self.lower = np.array(real_array("minimum_force_density", floor, (M,), "N/m"))
        if np.any(self.lower < 0):
            raise OptionError(f"minimum_force_density = {floor!r}; every value must be >= 0 N/m")
        self._floor = self.lower
        self.limits = StringLimits.of(structure, allocation.maximum_force_density, allocation.respect_limits)
        self.upper = self.limits.max_force_density
        below = self.upper < self.lower
        if np.any(below):
            m = int(np.argmax(below))
            raise OptionError(
                f"string '{self.names[m]}': maximum force density {self.upper[m]:g} N/m is below the minimum of "
                f"{self.lower[m]:g} N/m"
            )
        self.sum_rows, self.sum_values = self._sums()
        self.weight = _weight(allocation.weight, M)
        self.linear = None if allocation.linear is None else np.array(real_array("linear", allocation.linear, (M,)))
        if self.linear is not None:
            free_to_fall = (self.linear < 0) & (self.upper == np.inf)
            if np.any(free_to_fall):
                name = self.names[int(np.argmax(free_to_fall))]
                raise OptionError(f"linear: f < 0 for string '{name}', which has no maximum: fᵀu has no least value")
        self._multipliers = np.zeros(len(self.equations) + len(self.sum_values))
        self._last: Array | None = None

    def _sums(self) -> tuple[Array, Array]:
        rows = []
        for number, one in enumerate(self.options.sums):
            chosen = self.names if one.strings is None else one.strings
            for name in chosen:
                if name not in self.names:
                    raise OptionError(
                        f"sums[{number}]: unknown string {name!r}; the strings are {', '.join(self.names)}"
                    )
            rows.append([float(name in chosen) for name in self.names])
        values = np.array([one.minimum for one in self.options.sums], float)
        return np.array(rows, float).reshape(len(rows), len(self.names)), values

    def solve(self, A: Array, d: Array, nodes: Array | None = None) -> Allotment:
        """The force densities for A (n, M) u = d (n,).

        `nodes` (N, 3) [m] give the strings' lengths, on which the limits of their rest lengths depend.

        Raises:
            InfeasibleError: with `WhenInfeasible.STOP` where there are none (or none was ever, with HOLD): it names the
                constraint at fault.
            OptionError: where A or d have other shapes than `equations` and strings need.
            ControllerError: where they are not finite.
        """
        A, d = self._checked(A, d)
        if nodes is not None and self.limits.of_state:
            self.upper = self.limits.ceilings(nodes)
            # A string too short for its rest length can only hang slack.
            self.lower = np.minimum(self._floor, self.upper)
        u = self._search(A, d)
        if u is None and self.options.on_infeasible is WhenInfeasible.RELAX:
            u = self._least_violation(A, d)
        elif u is None and self.options.on_infeasible is WhenInfeasible.HOLD:
            u = self._last
        if u is None:
            raise InfeasibleError(self.fault(A, d))
        self._last = u
        return Allotment(u, self.violation(A, d, u))

    def _checked(self, A: Any, d: Any) -> tuple[Array, Array]:
        shape = (len(self.equations), len(self.names))
        try:
            A, d = np.asarray(A, float), np.asarray(d, float)
        except (TypeError, ValueError) as error:
            raise OptionError(f"A and d must be arrays of real numbers ({error})") from None
        if A.shape != shape or d.shape != shape[:1]:
            raise OptionError(
                f"A of shape {A.shape} and d of shape {d.shape}; they must be {shape} and {shape[:1]}, a row for each "
                "equation and a column for each string"
            )
        finite_rows = np.isfinite(d) & np.isfinite(A).all(axis=1)
        if not finite_rows.all():
            row = int(np.argmin(finite_rows))
            raise ControllerError(
                f"the equation for {self.equations[row].name} has numbers that are not finite (d = {d[row]}); "
                "check the state and the gains that it is made of"
            )
        return A, d

    def violation(self, A: Array, d: Array, u: Array) -> float:
        """Return the largest violation of an equation or a sum by u, in its unit."""
        missed = float(np.max(np.abs(A @ u - d), initial=0.0))
        return max(missed, float(np.max(self.sum_values - self.sum_rows @ u, initial=0.0)))

    def _search(self, A: Array, d: Array) -> Array | None:
        """The optimal u, or None where there is none."""
        if self.linear is not None:
            found, size = self._program(A, d, self.linear)
            return np.clip(np.asarray(found.x, float) * size, self.lower, self.upper) if found.status == 0 else None
        if self.weight.ndim == 1:
            for start in (self._multipliers, np.zeros_like(self._multipliers)):
                y = start.copy()
                status, u = self._newton(A, d, y, y, 0.0)
                if status == SETTLED:
                    self._multipliers = y
                    return u
                if status == NO_POINT:
                    return None
        return self._library(A, d)

    def _newton(self, A: Array, d: Array, center: Array, y: Array, proximal: float) -> tuple[int, Array]:
        """`maximize_dual` from y, which it moves, with H's diagonal."""
        u = np.empty(len(self.names))
        b = np.concatenate([d, self.sum_values])
        h = self.weight if self.weight.ndim == 1 else np.ones(len(u))
        columns = columns_of(np.ascontiguousarray(A), self.sum_rows)
        program = Program(columns, len(d), h, self.lower, self.upper, b)
        status, _ = maximize_dual(program, center, proximal, y, u, NEWTON_STEPS)
        return int(status), u

    def _library(self, A: Array, d: Array) -> Array | None:
        """Find the optimal u by the library daqp: for a full H, and where Newton's method does not settle."""
        daqp = optional("daqp", "this allocation of force densities", of_extra("allocation"))
        H = np.diag(self.weight) if self.weight.ndim == 1 else self.weight
        M = len(self.names)
        # Rows of one size, for a tolerance in common.
        rows = np.vstack([A, self.sum_rows])
        norms = np.linalg.norm(rows, axis=1)
        scale = np.where(norms > 0, norms, 1.0)
        rows = rows / scale[:, None]
        b = np.concatenate([d, self.sum_values]) / scale
        # And a problem of size one: some of the library's tolerances are absolute.
        size = self._size(b)
        b, lower, upper = b / size, self.lower / size, np.minimum(self.upper / size, 1e30)
        above = np.concatenate([upper, b[: len(d)], np.full(len(self.sum_values), 1e30)])
        below = np.concatenate([lower, b])
        kinds = np.concatenate([np.zeros(M), np.full(len(d), 5), np.zeros(len(self.sum_values))]).astype(np.int32)
        u, _, flag, _ = daqp.solve(
            np.ascontiguousarray(H), np.zeros(M), rows, above, below, kinds, primal_tol=0.1 * ACCURACY
        )
        if flag <= 0:
            return None
        u = np.clip(np.asarray(u, float), lower, upper)
        lacking = rows @ u - b
        lacking[len(d) :] = np.minimum(lacking[len(d) :], 0.0)
        return u * size if np.all(np.abs(lacking) <= ACCURACY * (1.0 + np.abs(rows) @ np.abs(u))) else None

    def _size(self, b: Array) -> float:
        """Return the divisor that brings the numbers of a problem to the size of one."""
        return max(float(np.max(np.abs(b), initial=0.0)), float(np.max(self.lower, initial=0.0))) or 1.0

    def _program(self, A: Array, d: Array, cost: Any, slack: int = 0) -> tuple[Any, float]:
        """HiGHS' result for the least cost @ (u / size, x), and size; the `slack` x >= 0 take what is missed.

        They are what equations lack, what they have too much, and what sums are short of.
        """
        from scipy.optimize import linprog

        n, L = len(d), len(self.sum_values)
        size = self._size(np.concatenate([d, self.sum_values]))
        missed = np.hstack([np.eye(n), -np.eye(n), np.zeros((n, L))])[:, :slack]
        short = np.hstack([np.zeros((L, 2 * n)), -np.eye(L)])[:, :slack]
        lower, upper = np.append(self.lower / size, np.zeros(slack)), np.append(self.upper / size, [np.inf] * slack)
        found = linprog(
            cost,
            A_ub=np.hstack([-self.sum_rows, short]) if L else None,
            b_ub=-self.sum_values / size if L else None,
            A_eq=np.hstack([A, missed]) if n else None,
            b_eq=d / size if n else None,
            bounds=np.column_stack([lower, upper]),
            method="highs-ds",
        )
        return found, size

    def _least_violation(self, A: Array, d: Array) -> Array:
        """Find the u within bounds that violates equations and sums least; of several, the one of least cost.

        The proximal point method on the dual: its steps always have a solution, and u tends to the one sought.
        """
        squares = np.einsum("im,im->m", A, A) + np.einsum("im,im->m", self.sum_rows, self.sum_rows)
        h = self.weight if self.weight.ndim == 1 else np.ones(len(self.names))
        proximal = LEAST_VIOLATION * float(np.max(squares / h, initial=0.0)) or 1.0
        y = np.zeros(len(d) + len(self.sum_values))
        u = np.clip(np.zeros(len(self.names)), self.lower, self.upper)
        for _ in range(20):
            before, center = u, y.copy()
            _, u = self._newton(A, d, center, y, proximal)
            if np.max(np.abs(u - before), initial=0.0) <= 1e-10 * (1.0 + np.max(np.abs(u), initial=0.0)):
                break
        return u

    def fault(self, A: Array, d: Array) -> str:
        """Describe the equation or sum that cannot be met, by how much, and the bounds that prevent it."""
        n, L, M = len(d), len(self.sum_values), len(self.names)
        # Phase 1: the least sum of violations, with every bound kept.
        slack = 2 * n + L
        found, size = self._program(A, d, np.append(np.zeros(M), np.ones(slack)), slack)
        if found.status != 0:
            return f"no admissible force densities ({found.message})"
        missed = size * (found.x[M : M + n] - found.x[M + n : M + 2 * n])
        short = size * found.x[M + 2 * n :]
        # In other units a small miss is as good as none: the worst first, each relative to the terms of its row.
        terms = np.abs(np.vstack([A, self.sum_rows])) @ (size * found.x[:M]) + np.abs(
            np.concatenate([d, self.sum_values])
        )
        violations = np.concatenate([np.abs(missed), short])
        relative = violations / np.where(terms > 0, terms, 1.0)
        parts = [
            f"{self.equations[i].name} is missed by {violations[i]:.3g} {self.equations[i].unit}"
            if i < n
            else f"{self._sum_name(i - n)} falls short by {violations[i]:.3g} N/m"
            for i in np.argsort(-relative, kind="stable")[:3]
            if violations[i] > 0
        ]
        text = "no admissible force densities: at best " + (" and ".join(parts) or "all is met to round-off")
        prices = (("minimum", self.lower, found.lower.marginals), ("maximum", self.upper, -found.upper.marginals))
        walls = [
            (float(price[m]), f"'{self.names[m]}' at its {word} of {bound[m]:g} N/m")
            for word, bound, price in prices
            for m in range(M)
            if price[m] > 1e-9
        ]
        if walls:
            shown = [wall for _, wall in sorted(walls, reverse=True)[:3]]
            text += (
                "; in the way: string " + ", ".join(shown) + ("" if len(walls) <= 3 else f" and {len(walls) - 3} more")
            )
        return text

    def _sum_name(self, number: int) -> str:
        chosen = self.options.sums[number].strings
        what = "all strings" if chosen is None else ", ".join(chosen[:6]) + (", ..." if len(chosen) > 6 else "")
        return f"sum {number + 1} (of {what}) >= {self.sum_values[number]:g}"


def _weight(weight: ArrayLike, M: int) -> Array:
    """H as its diagonal (M,), or full (M, M)."""
    if M > 1 and shape_of(weight) == (M, M):
        H = np.array(real_array("weight", weight, (M, M)))
        check_definite("weight: H", H)
        return np.diag(H).copy() if np.array_equal(H, np.diag(np.diag(H))) else H
    diagonal = np.array(real_array("weight", weight, (M,)))
    if not np.all(diagonal > 0):
        raise OptionError(f"weight = {weight!r}; every value must be > 0")
    return diagonal
