"""Radau IIA of order 5 by SciPy, as a method of `controlled`: it is called back for each step."""

from __future__ import annotations

from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.dynamics.native.compiling import called_from_c
from tensegrity_mj.dynamics.native.law import NO_SOLUTION
from tensegrity_mj.dynamics.native.pointers import TIMED
from tensegrity_mj.dynamics.native.views import Table
from tensegrity_mj.engines.reference.dop853 import BEYOND_FLOATS, FAILED, GOING, RAISED, STAGES, TOO_SHORT, UNHELD
from tensegrity_mj.engines.reference.equations import SINGULAR, WORK, rates

JACOBIAN_STEP = 1.5e-8  # √eps: round-off and curvature spoil the difference alike


class _Refused(Exception):
    """An evaluation has no rates; its argument is what the step answers."""


class RadauSteps:
    """Steps of Radau for a run.

    Attributes:
        address: of the C function.
        error: what a step raised.
        evaluations: so far.
    """

    def __init__(self, own: Table, plant: Table) -> None:
        self.own, self.plant = own, plant
        self.solver: Any = None
        self.error: BaseException | None = None
        self.evaluations = 0
        self._function, self.address = called_from_c(TIMED, self._step)

    def _rhs(self, t: float, y: Array) -> Array:
        out = np.empty(len(y))
        status = int(rates(t, y, out, self.own["table"]))
        self.evaluations += 1
        if status == SINGULAR:
            raise _Refused(UNHELD)
        if status > NO_SOLUTION or self.plant["status"]:
            self.own.set(answer=status, failed_at=t)
            raise _Refused(FAILED)
        return out

    def _jacobian(self, t: float, y: Array) -> Array:
        """∂(dy/dt)/∂y by forward differences.

        SciPy's own widens its step tenfold each time in a column that changes nothing, until it overflows; work
        integrals and the place of a rod without strings are such columns.
        """
        here = self._rhs(t, y)
        jacobian = np.zeros((len(y), len(y)))
        size = self.plant["state_size"]  # behind the work integrals: states of elements
        for column in (*range(size - WORK), *range(size, len(y))):
            aside = y.copy()
            aside[column] += JACOBIAN_STEP * max(1.0, abs(y[column]))
            jacobian[:, column] = (self._rhs(t, aside) - here) / (aside[column] - y[column])
        return jacobian

    def _begin(self, bound: float) -> None:
        from scipy.integrate import Radau

        own = self.own
        first, left, longest = own["first_step"], bound - own["t"], own["longest_step"]
        self.solver = Radau(
            self._rhs,
            own["t"],
            own["y"].copy(),
            bound,
            rtol=own["rtol"],
            atol=own["atol"],
            first_step=min(first, left, longest) if first else None,
            max_step=longest,
            jac=self._jacobian,
        )
        own.set(begun=1, h=float(self.solver.h_abs))

    def _step(self, bound: float, own_at: int, unused: int, none: int) -> int:
        """Take a step, as `dop853.dop853_step` does; its dense output is known."""
        try:
            return self._stepped(bound)
        except _Refused as refused:
            return int(refused.args[0])
        except BaseException as error:  # no exception passes through compiled code
            self.error = error
            return RAISED

    def _stepped(self, bound: float) -> int:
        own = self.own
        if not own["begun"]:
            self._begin(bound)
        else:
            self.solver.y[:], self.solver.f[:] = own["y"], own["stages"][0]  # which are projected
        solver = self.solver
        solver.t_bound, solver.max_step, solver.status = bound, own["longest_step"], "running"
        if not np.isfinite(solver.h_abs):  # SciPy would try such a step for ever
            return BEYOND_FLOATS
        if solver.step() is not None:
            return TOO_SHORT
        own["new"][:], own["stages"][STAGES] = solver.y, solver.f
        first, second, third = solver.dense_output().Q.T  # of x, x² and x³ along the step
        own["powers"][:3] = first + second + third, -second - third, -third
        own["powers"][3:] = 0.0
        own.set(end=float(solver.t), h=float(solver.h_abs), dense=1, fresh=0)
        return GOING
