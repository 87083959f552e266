"""One run from its start to its end, and many on threads, for every model and method of the reference engines.

Each run is a loop of compiled code by itself, with a table and scratch of its own, during which Python does not hold
its lock: so many runs are one after another on each thread, and each has the bits of `simulate`, whatever the threads.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from tensegrity_mj.basics import interrupts
from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.engines.driving import Stopwatch, progress
from tensegrity_mj.engines.recording import check_rows
from tensegrity_mj.engines.reference.adaptive import ErrorControlled
from tensegrity_mj.engines.reference.in_lanes import LaneRun, groups_of
from tensegrity_mj.engines.reference.integration import FixedSteps, IntegratedRun
from tensegrity_mj.engines.reference.method import Method
from tensegrity_mj.engines.request import Request
from tensegrity_mj.runs.trajectory import Trajectory


def _ready(run: IntegratedRun) -> FixedSteps | ErrorControlled:
    """A run with its method, compiled."""
    return FixedSteps(run) if run.options.method is Method.RK4 else ErrorControlled(run)


def integrate(run: IntegratedRun) -> Trajectory:
    """The whole run: fixed steps of RK4, or a method that controls its error."""
    one = _ready(run)
    clock = Stopwatch(run.request)
    one.go()
    return one.conclude(clock.seconds)


class IntegratedEnsemble:
    """Runs of one engine on threads.

    Attributes:
        members: a run each, which `conclude`s with its trajectory or its error.
        times: (T,) [s] of their rows.
        seconds: wall time of the integration of all.
    """

    def __init__(self, options: Any, requests: Sequence[Request], threads: int) -> None:
        self.requests, self.label, self.seconds = requests, f"{options}, {len(requests)} runs", 0.0
        self.threads = min(threads or os.cpu_count() or 1, len(requests))
        requests = [replace(request, progress=False) for request in requests]
        first = _ready(options.prepared(requests[0]))
        check_rows(float(len(requests)) * first.rows.shape[0], first.rows.shape[1])
        self.groups, ready, self.alone = groups_of(options, requests, first)
        in_lanes = {run.number: run for group in self.groups for run in group.runs}
        self.members: list[FixedSteps | ErrorControlled | LaneRun] = [
            in_lanes.get(number) or ready.get(number) or (_ready(options.prepared(request)) if number else first)
            for number, request in enumerate(requests)
        ]
        self.times: Array = first.times

    def run(self) -> None:
        """Simulate all; nothing is raised for what becomes of a simulation."""
        from concurrent.futures import ThreadPoolExecutor  # single runs do without it

        first, done = self.requests[0], []
        parts: list[Any] = [(group, block) for group in self.groups for block in range(group.blocks)]
        parts += [(None, member) for member in self.members if not isinstance(member, LaneRun)]
        left = iter(parts)

        def work(number: int) -> None:
            tables = {group: group.tables() for group in self.groups}
            with np.errstate(over="ignore", invalid="ignore"):  # what diverges is an error by itself
                for group, part in left:  # which threads share
                    runs = [part] if group is None else group.go(part, tables[group])
                    for run in runs:
                        run.go()
                        interrupts.raise_if_requested()
                    done.append(part)
                    show(first.duration * len(done) / len(parts))

        clock = Stopwatch(*self.requests)
        with progress(first, self.label) as show, ThreadPoolExecutor(self.threads) as pool:
            list(pool.map(work, range(self.threads)))
        self.seconds = clock.seconds

    @property
    def cost(self) -> dict[str, Any]:
        """Wall time [s], steps and evaluations of all runs together; how many went in lanes, and why others did not."""
        costs = [member.cost for member in self.members]
        totals = {key: sum(one[key] for one in costs) for key in costs[0]}
        lost = sum(run.fell_out for group in self.groups for run in group.runs)
        alone = self.alone | ({"it ended early, or its law had no solution": lost} if lost else {})
        lanes = {"width": self.groups[0].width if self.groups else 1, "runs": len(costs) - sum(alone.values())}
        return {"wall_time": self.seconds, **totals, "lanes": {**lanes, "alone": alone}}
