"""What the engines that integrate equations of their own have in common."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

from tensegrity_mj.basics.fields import value
from tensegrity_mj.engines.reference.adaptive import ErrorControlled
from tensegrity_mj.engines.reference.integration import IntegratedRun
from tensegrity_mj.engines.reference.method import Method, Options
from tensegrity_mj.engines.request import Request
from tensegrity_mj.errors import OptionError
from tensegrity_mj.runs.trajectory import Trajectory


@value(error=OptionError)
class ReferenceEngine(Options):
    """DAE and ODE: options with an `accuracy` or without, and a run that is prepared before it is integrated."""

    def _prepared(self, request: Request) -> tuple[IntegratedRun, Any]:
        """A run that is ready to start, and the records of its structure."""
        raise NotImplementedError

    def prepared(self, request: Request) -> IntegratedRun:
        """A run that is ready to start: for those who want its right-hand side rather than a trajectory."""
        return self._prepared(request)[0]

    def run(self, request: Request) -> Trajectory:
        """Simulate; called by `simulate`."""
        if self.accuracy is None:
            return integrate(self.prepared(request))
        from tensegrity_mj.engines.reference.accuracy import run_accurately

        plain: Any = partial(replace, self, accuracy=None)
        return run_accurately(self.accuracy, request, plain, lambda options, made: integrate(options.prepared(made)))


def integrate(run: IntegratedRun) -> Trajectory:
    """The whole run: fixed steps of RK4, or a method that controls its error."""
    return run.fixed_steps() if run.options.method is Method.RK4 else ErrorControlled(run).integrate()
