"""Step grid, stopwatch, progress, and the pieces between which Ctrl-C is handled."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from tensegrity_mj.basics import interrupts
from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.progress import bar
from tensegrity_mj.dynamics.native.plant_view import PLANT
from tensegrity_mj.dynamics.native.views import Table, fields_of
from tensegrity_mj.engines.recording import check_rows
from tensegrity_mj.engines.request import Request
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.actuation import whole_ratio

DEFAULT_INTERVAL = 0.01  # s: a hundred samples a second
STEPPED = fields_of(  # the table of a plant that is driven in fixed steps: the grid, and the rows that are recorded
    PLANT,
    step="real",  # [s]
    stride="size",
    ratio="size",
    total="size",
    first_step="size",
    rows=("f8", "row_count", "row_size"),
)


@dataclass(frozen=True)
class Grid:
    """Fixed steps: how many, how many a row, how many a control period (0: the law is not sampled), and the first."""

    step: float
    count: int
    stride: int
    ratio: int
    first: int = 0

    @classmethod
    def of(cls, request: Request, step: float) -> Grid:
        """The grid of a request.

        Raises:
            OptionError: where duration, output interval, control period or a break is no multiple of the step.
        """
        intervals = request.intervals.items()
        steps = {what: whole_ratio(time, step, f"{what} over the time step") for what, time in intervals}
        count = steps["duration"]
        stride = steps.get("output interval", max(1, int(np.floor(DEFAULT_INTERVAL / step * (1 + 1e-12)))))
        first, stride = steps.get("start", 0), min(stride, count)
        check_rows(count / stride, least_width(request))
        return cls(step, count, stride, steps.get("control period", 0), first)

    def describe(self, plant: Table, rows: Array) -> None:
        """Set it in the table of a plant (`STEPPED`), with the rows to be recorded."""
        plant.set(step=self.step, stride=self.stride, ratio=self.ratio, rows=rows)
        plant.set(first_step=self.first, total=self.first + self.count)

    @property
    def times(self) -> Array:
        """Output times [s]: every stride, and the end."""
        steps = np.arange(0, self.count + 1, self.stride)
        if steps[-1] != self.count:
            steps = np.append(steps, self.count)
        return np.asarray((self.first + steps) * self.step, float)


def least_width(request: Request) -> int:
    """Least number of values in a recorded row: too many rows are refused before their times are made."""
    return 6 * len(request.scene.structure.node_names)


def output_times(request: Request) -> Array:
    """Output times (T,) [s] of a run without a grid: multiples of the output interval, and the end."""
    interval = request.output_interval or DEFAULT_INTERVAL
    count = int(np.floor(request.duration / interval * (1 + 1e-12)))
    check_rows(count, least_width(request))
    times: Array = np.arange(count + 1, dtype=float) * interval
    if request.duration - times[-1] > 1e-9 * interval:
        times = np.append(times, request.duration)
    times[-1] = request.duration
    times += request.begin
    if not (np.diff(times) > 0).all():
        raise OptionError(
            f"start_time = {request.begin:g} s: double precision has no samples {interval:g} s apart there"
        )
    return times


class Stopwatch:
    """Wall time of the integration alone, not of compiling, loading or drawing; that of laws in Python likewise."""

    def __init__(self, *requests: Request) -> None:
        for request in requests:
            if request.law.spent is not None:
                request.law.spent[:] = [0.0, 0.0]  # they were called to compile, and by earlier runs
        self.start = time.perf_counter()

    @property
    def seconds(self) -> float:
        """Seconds since the start."""
        return time.perf_counter() - self.start


@contextmanager
def progress(request: Request, label: str) -> Iterator[Callable[[float], Any]]:
    """Show a bar over simulated time on stderr if requested; call the result with the time that is reached [s]."""
    form = "{desc} {percentage:3.0f}% |{bar}| {n:.2f}/{total:.2f} s [{elapsed} < {remaining}]"
    with bar(request.progress, label, total=request.duration, bar_format=form) as shown:
        yield lambda time: shown.update(time - shown.n)


def drive(grid: Grid, request: Request, label: str, advance: Callable[[int, int], int]) -> bool:
    """Take the steps of a grid in pieces, with progress and Ctrl-C between them; return whether all were taken.

    `advance(first, count)` takes `count` steps from number `first`, and returns the step that it has come to.
    """
    with progress(request, label) as show:
        for first, count in chunks(grid.count):
            reached = advance(first, count)
            show(reached * grid.step)
            if reached < first + count:
                return False
    return True


def chunks(count: int) -> Iterator[tuple[int, int]]:
    """Yield pieces (first, number) of `count` steps, of a fraction of a second each, and handle Ctrl-C in between."""
    size, first = 64, 0
    while first < count:
        piece = min(size, count - first)
        start = time.perf_counter()
        yield first, piece
        interrupts.raise_if_requested()
        first += piece
        seconds = time.perf_counter() - start
        if seconds < 0.1:
            size *= 8 if seconds < 0.01 else 2
        elif seconds > 0.4:
            size = max(1, size // 2)
