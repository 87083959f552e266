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

from tensegrity_mj.dynamics.native.kept import processors
from tensegrity_mj.dynamics.native.lanes import WIDTHS, in_lanes
from tensegrity_mj.dynamics.native.views import Table, lanes_of
from tensegrity_mj.engines.driving import chunks
from tensegrity_mj.engines.reference.equations import rates_of_state
from tensegrity_mj.engines.reference.integration import FixedSteps, rk4_steps
from tensegrity_mj.engines.reference.method import Method
from tensegrity_mj.engines.request import Request

# What a run has of its own at the end of its steps; the rest of a plant follows from its state.
OWN = ("held", "memory", "winch", "sampled_lengths", "watched", "resolution", "report", "rows")
FEWEST = 4  # runs that lanes are worth their preparation for
# Addresses of what each plant has of its own, and what is not read.
APART = ("law_context", "elements", "seen", "damped")
OTHERS_EQUATIONS = "lanes are of the DAE of rods that share no nodes, by its default solver"
FUNCTIONS = ("place", "accelerate", "project")


def native_width() -> int:
    """Number of lanes that this processor's registers hold."""
    return max(WIDTHS) if "+avx512f" in processors()[0] else min(WIDTHS)


def why_alone(options: Any, request: Request) -> str:
    """Why a run cannot go into a lane, or "" where it can."""
    scene, law = request.scene, request.law
    reasons = (
        (options.method is not Method.RK4, f"{options.method.name} chooses its steps"),
        (bool(options.locate_slack), "its steps are split where strings change"),
        (request.start is not None, "it goes on from another run"),
        (request.sampled, "its law is sampled"),
        (bool(law.address) and law.lanes is None, "its law is not one of chapters 5 and 6 without limits"),
        (bool(scene.breaks), "strings break"),
        (bool(scene.effects), "elements act"),
        (bool(scene.motions), "supports move"),
        (scene.contact is not None, "it may touch something"),
        (not scene.structure.curves.linear, "strings have tension curves"),
    )
    return next((reason for holds, reason in reasons if holds), "")


def kind_of(request: Request) -> tuple[Any, ...]:
    """Key of a run: equal for those that may share a block."""
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
        made = self.group.singles.get(self.number) or FixedSteps(self.group.options.prepared(self.request))
        if not self.fell_out:
            self.group.put_back(self.place, made)
        return made

    @property
    def cost(self) -> dict[str, int]:
        """Steps and evaluations."""
        return self.single.cost if self.fell_out else self.group.cost

    def __getattr__(self, name: str) -> Any:
        return getattr(self.single, name)


class LaneGroup:
    """Runs of one kind, in blocks.

    Attributes:
        runs: of the group.
        singles: by number; of runs that differ in starts alone there is the first one, or none.
        blocks: their number.
        cost: steps and evaluations of each run.
    """

    def __init__(
        self, options: Any, given: Mapping[int, Request], singles: Mapping[int, FixedSteps], width: int, varied: bool
    ) -> None:
        self.options, self.singles, self.width, self.varied = options, singles, width, varied
        self.runs = [LaneRun(self, place, *one) for place, one in enumerate(given.items())]
        self.blocks = -(-len(given) // width)
        self.pattern = pattern = next(iter(singles.values()))
        run, law = pattern.run, pattern.request.law
        wanted = {f"{name}_function": getattr(run.equations, name) for name in FUNCTIONS}
        wanted |= {"rates_function": rates_of_state, "law": law.lanes.function if law.lanes else None}
        self._functions = {name: in_lanes(one, width, varied).address if one else 0 for name, one in wanted.items()}
        self._steps, self.cost = in_lanes(rk4_steps, width, varied), pattern.cost
        _ = self._steps.address  # compiles
        # What each run has of its own, (..., width) of every block.
        self.own: dict[str, Any]
        if varied:
            of_blocks = [[singles[self._run_of(block, lane).number] for lane in range(width)] for block in self._all]
            self._tables = [self._laned(ones) for ones in of_blocks]
            self.own = {name: [plant.arrays[name] for _, plant in self._tables] for name in OWN}
            self.own["y"] = [own.arrays["y"] for own, _ in self._tables]
            return
        self.own = {name: lanes_of(pattern.plant[name], width, (self.blocks,)) for name in OWN}
        self.own["y"] = lanes_of(run.y, width, (self.blocks,))
        scenes, nq = [self._run_of(0, place).request.scene for place in range(self.blocks * width)], run.records.nq
        nodes, velocities = (np.array([getattr(scene, name) for scene in scenes]) for name in ("nodes0", "velocities0"))
        for part, values in enumerate(run.records.state(nodes, velocities)):
            lanes = values.reshape(self.blocks, width, nq).swapaxes(1, 2)
            self.own["y"][:, part * nq : (part + 1) * nq] = lanes

    @property
    def _all(self) -> range:
        return range(self.blocks)

    def _run_of(self, block: int, lane: int) -> LaneRun:
        """The run in a lane; those of no run repeat the last one."""
        return self.runs[min(block * self.width + lane, len(self.runs) - 1)]

    def _laned(self, singles: Sequence[FixedSteps]) -> tuple[Table, Table]:
        """Tables in lanes, of runs in fixed steps and of their plants."""
        first = singles[0]
        plant = first.plant.in_lanes([one.plant for one in singles], self.varied)
        plant.set(**self._functions)
        if self.varied and first.request.law.lanes:
            laws = [one.request.law.lanes.table for one in singles if one.request.law.lanes]
            plant["law_context"] = laws[0].in_lanes(laws, True)
        own = first.own.in_lanes([one.own for one in singles], self.varied)
        own["table"] = plant
        return own, plant

    def tables(self) -> list[tuple[Table, Table]]:
        """Tables of all blocks, for one thread: where runs differ in starts alone, those of each are the same ones."""
        return self._tables if self.varied else [self._laned([self.pattern] * self.width)] * self.blocks

    def go(self, block: int, tables: Sequence[tuple[Table, Table]]) -> list[LaneRun]:
        """Take the steps of a block; return those of its runs that are to be made alone."""
        own, plant = tables[block]
        grid, y = self.pattern.grid, self.own["y"][block]
        for name in OWN:
            plant.lend(name, self.own[name][block])
        own.lend("y", y)
        own.set(steps=grid.first, evaluations=0)
        sound = np.ones(self.width, bool)
        for first, count in chunks(grid.count):
            status = self._steps(own.address, grid.first + first, count)
            sound = np.isfinite(y).all(axis=0) & (status == 0)
            if not sound.any():
                break
        if sound.any():
            self.cost = {"steps": own["steps"] - grid.first, "evaluations": own["evaluations"]}
        runs = self.runs[block * self.width : (block + 1) * self.width]
        lost = [run for run, stands in zip(runs, sound, strict=False) if not stands]
        for run in lost:
            run.fell_out = True
        return lost

    def put_back(self, place: int, made: FixedSteps) -> None:
        """Bring a single run to where its lane is, and let it arrive there."""
        block, lane = divmod(place, self.width)
        for name in OWN:
            made.plant[name][:] = self.own[name][block][..., lane]
        made.run.y[:] = self.own["y"][block][:, lane]
        made.own.set(steps=made.grid.first + self.cost["steps"], evaluations=self.cost["evaluations"])
        made.arrive()


def groups_of(
    options: Any, requests: Sequence[Request], first: Any
) -> tuple[list[LaneGroup], dict[int, FixedSteps], dict[str, int]]:
    """Sort runs into lanes.

    Args:
        options, requests: of the engine and the runs.
        first: the first run, ready to start.

    Returns:
        The groups; runs that are ready and go alone, by number; and how many runs go alone, by the reason.
    """
    kinds: dict[Any, dict[int, Request]] = {}
    alone: Counter[str] = Counter()
    for number, request in enumerate(requests):
        reason = why_alone(options, request)
        if reason:
            alone[reason] += 1
        else:
            kinds.setdefault(kind_of(request), {})[number] = request
    width, groups, ready = native_width(), [], {}
    mixed: dict[Any, dict[int, Request]] = {}  # of which each has its own structure or law
    for given in kinds.values():
        for number, request in given.items():
            ready[number] = one = first if number == 0 else FixedSteps(options.prepared(request))
            if not one.run.equations.lanes:
                alone[OTHERS_EQUATIONS] += 1
            elif len(given) >= FEWEST:
                groups.append(LaneGroup(options, given, {number: ready.pop(number)}, width, False))
                break
            else:
                law = request.law.lanes.kind() if request.law.lanes else None
                mixed.setdefault((one.plant.alike(APART), law), {})[number] = request
    for given in mixed.values():
        if len(given) < FEWEST:
            alone["too few others are like it"] += len(given)
        else:
            groups.append(LaneGroup(options, given, {number: ready.pop(number) for number in given}, width, True))
    return groups, ready, dict(alone)
