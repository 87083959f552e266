"""A prepared run, integrated by the method that its options request."""

from __future__ import annotations

from tensegrity_mj.engines.reference.adaptive import ErrorControlled
from tensegrity_mj.engines.reference.integration import IntegratedRun
from tensegrity_mj.engines.reference.method import Method
from tensegrity_mj.runs.trajectory import Trajectory


def integrate(run: IntegratedRun) -> Trajectory:
    """The whole run: fixed steps of RK4, or a method that controls its error."""
    return run.fixed_steps() if run.options.method is Method.RK4 else ErrorControlled(run).integrate()
