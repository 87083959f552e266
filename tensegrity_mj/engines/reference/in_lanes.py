"""Runs side by side: blocks of as many as a processor's registers hold, through the kernels of single runs.

A block has a table as a plant has, in which each number that a run has of its own is there once a lane
(`dynamics.native.lanes`), and is stepped as one run is. What a block cannot do makes its lane NaN: that run is made
anew by itself. So each run has the bits of `simulate`, whatever its neighbours, the width and the threads.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.dynamics.native.compiling import CFunction
from tensegrity_mj.dynamics.native.kept import processors
from tensegrity_mj.dynamics.native.lanes import WIDTHS, in_lanes
from tensegrity_mj.dynamics.native.views import Table, lanes_of
from tensegrity_mj.engines.driving import chunks
from tensegrity_mj.engines.reference.equations import rates_of_state
from tensegrity_mj.engines.reference.integration import FixedSteps, rk4_steps
from tensegrity_mj.engines.reference.method import Method
from tensegrity_mj.engines.request import Request
from tensegrity_mj.runs.trajectory import Trajectory

# What a run has of its own at the end of its steps; the rest of a plant follows from its state.
OWN = ("held", "memory", "winch", "sampled_lengths", "watched", "resolution", "report", "rows")
FEWEST = 4  # runs that lanes are worth their preparation for
FUNCTIONS = ("place", "accelerate", "project")


def native_width() -> int:
    """How many lanes this processor's registers hold."""
    return max(WIDTHS) if "+avx512f" in processors()[0] else min(WIDTHS)


def why_alone(options: Any, request: Request) -> str:
    """Why a run cannot go into a lane, or "" where it can."""
    scene, law = request.scene, request.law
    reasons = (
        (options.method is not Method.RK4, f"{options.method.name} chooses its steps"),
        (bool(options.locate_slack), "its steps are split where strings change"),
        (request.start is not None, "it goes on from another run"),
        (request.sampled, "its law is sampled"),
        (bool(law.address) and law.function is None, "its law is not one of chapters 5 and 6 without limits"),
        (bool(scene.breaks), "strings break"),
        (bool(scene.effects), "elements act"),
        (not scene.structure.curves.linear, "strings have tension curves"),
    )
    return next((reason for holds, reason in reasons if holds), "")


def kind_of(request: Request) -> tuple[Any, ...]:
    """What runs of one block have in common."""
    scene, law = request.scene, request.law
    return id(scene.structure), scene.gravity, law.address, law.context, request.on_infeasible, request.begin


class LaneRun:
    """A run of a block, as `FixedSteps` is for those who conclude it; alone where its lane could not go on.

    Attributes:
        number: among all runs; `place` is that in its group.
        fell_out: whether its lane could not go on.
    """

    def __init__(self, group: LaneGroup, place: int, number: int, request: Request) -> None:
        self.group, self.place, self.number, self.request = group, place, number, request
        self.fell_out = False

    @cached_property
    def single(self) -> FixedSteps:
        """The run with a plant of its own, at the end of the steps that its lane has taken."""
        made = FixedSteps(self.group.options.prepared(self.request))
        if not self.fell_out:
            self.group.put_back(self.place, made)
        return made

    def go(self) -> None:
        """Take the steps alone."""
        self.single.go()

    @property
    def cost(self) -> dict[str, int]:
        """Steps and evaluations."""
        return self.single.cost if self.fell_out else self.group.cost

    @property
    def rows(self) -> Array:
        """Recorded rows (T, row_size)."""
        return self.single.rows

    @property
    def ended_early(self) -> float | None:
        """The time [s] at which it ended before its time, or None."""
        return self.single.ended_early

    def conclude(self, seconds: float) -> Trajectory:
        """Return the run's trajectory, or raise the error that it ended with."""
        return self.single.conclude(seconds)


class LaneGroup:
    """Runs that differ in what lanes can have of their own, in blocks.

    Attributes:
        runs: of the group.
        blocks: their number.
        cost: steps and evaluations of each run.
    """

    def __init__(self, options: Any, given: Mapping[int, Request], pattern: FixedSteps, width: int) -> None:
        self.options, self.width, self.pattern, requests = options, width, pattern, list(given.values())
        self.runs = [LaneRun(self, place, *one) for place, one in enumerate(given.items())]
        self.blocks = -(-len(requests) // width)
        plant, run = pattern.plant, pattern.run
        wanted = {f"{name}_function": getattr(run.equations, name) for name in FUNCTIONS}
        wanted |= {"rates_function": rates_of_state, "law": requests[0].law.function}
        self._functions = {name: self._laned(one).address if one else 0 for name, one in wanted.items()}
        self._steps = self._laned(rk4_steps)
        _ = self._steps.address  # compiles
        # Every block's numbers, lane by lane: (blocks, ..., width).
        self.own = {name: lanes_of(plant[name], width, (self.blocks,)) for name in OWN}
        self.y = lanes_of(run.y, width, (self.blocks,))
        nq, scenes = run.records.nq, [request.scene for request in requests]
        states = run.records.state(
            np.array([scene.nodes0 for scene in scenes]), np.array([scene.velocities0 for scene in scenes])
        )
        for part, values in enumerate(states):
            self._spread(values, self.y[:, part * nq : (part + 1) * nq])
        self.cost = pattern.cost

    def _laned(self, function: CFunction) -> CFunction:
        return in_lanes(function, self.width, False)

    def _spread(self, values: Array, out: Array) -> None:
        """Put numbers of each run (runs, n) into their lanes; lanes of no run repeat the last one."""
        places = np.minimum(np.arange(self.blocks * self.width), len(values) - 1).reshape(self.blocks, self.width)
        out[:] = values[places].swapaxes(1, 2)

    def tables(self) -> tuple[Table, Table]:
        """Tables of a run in fixed steps and of its plant, in lanes, for one thread: all but what is a block's own."""
        plant = self.pattern.plant.in_lanes(self.width)
        plant.set(**self._functions)
        own = self.pattern.own.in_lanes(self.width)
        own["table"] = plant
        return own, plant

    def go(self, block: int, tables: tuple[Table, Table]) -> list[LaneRun]:
        """Take the steps of a block; return those of its runs that are to be made alone."""
        own, plant = tables
        grid, y = self.pattern.grid, self.y[block]
        for name, arrays in self.own.items():
            plant.lend(name, arrays[block])
        own.lend("y", y)
        own.set(steps=grid.first, evaluations=0)
        runs = self.runs[block * self.width : (block + 1) * self.width]
        sound = np.ones(self.width, bool)
        for first, count in chunks(grid.count):
            status = self._steps(own.address, grid.first + first, count)
            sound = np.isfinite(y).all(axis=0) & (status == 0)
            if not sound.any():
                break
        if sound.any():
            self.cost = {"steps": own["steps"] - grid.first, "evaluations": own["evaluations"]}
        lost = [run for run, stands in zip(runs, sound, strict=False) if not stands]
        for run in lost:
            run.fell_out = True
        return lost

    def put_back(self, place: int, made: FixedSteps) -> None:
        """Bring a single run to where its lane is, and let it arrive there."""
        block, lane = divmod(place, self.width)
        for name, arrays in self.own.items():
            made.plant[name][:] = arrays[block, ..., lane]
        made.run.y[:] = self.y[block, :, lane]
        made.own.set(steps=made.grid.first + self.cost["steps"], evaluations=self.cost["evaluations"])
        made.arrive()


def groups_of(
    options: Any, requests: Sequence[Request], first: Any, width: int | None = None
) -> tuple[list[LaneGroup], dict[str, int]]:
    """Sort runs into lanes.

    Args:
        options, requests: of the engine and the runs.
        first: the first run, ready to start.
        width: of the lanes; by default what the processor's registers hold.

    Returns:
        The groups, and how many runs are made alone, by the reason.
    """
    width = native_width() if width is None else width
    kinds: dict[Any, dict[int, Request]] = {}
    alone: Counter[str] = Counter()
    for number, request in enumerate(requests):
        reason = why_alone(options, request)
        if reason:
            alone[reason] += 1
        else:
            kinds.setdefault(kind_of(request), {})[number] = request
    groups = []
    for given in kinds.values():
        number, request = next(iter(given.items()))
        if len(given) < FEWEST:
            alone["too few others are like it"] += len(given)
            continue
        pattern = first if number == 0 else FixedSteps(options.prepared(request))
        if pattern.run.equations.lanes:
            groups.append(LaneGroup(options, given, pattern, width))
        else:
            alone["its equations are those of one run"] += len(given)
    return groups, dict(alone)
