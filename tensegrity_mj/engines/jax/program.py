"""A run as an array function of its parameters, and as a trajectory."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from tensegrity_mj.basics import interrupts
from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.engines.driving import Grid, progress
from tensegrity_mj.engines.jax.effects import array_effects
from tensegrity_mj.engines.jax.integrate import (
    Steps,
    break_steps,
    controlled_steps,
    fixed_steps,
    joined,
    one_row,
)
from tensegrity_mj.engines.jax.laws import array_law
from tensegrity_mj.engines.jax.model import Held, Model, Observed, Prepared, State
from tensegrity_mj.engines.request import Request
from tensegrity_mj.model.capabilities import require_rest_lengths
from tensegrity_mj.runs.trajectory import Trajectory

if TYPE_CHECKING:
    from tensegrity_mj.engines.jax.engine import JAX

PIECES = 16  # of a run, between which Ctrl-C is heard
QUIET = 2.0  # s of compiling without a word


class Program:
    """What `JAX.model` gives: `parameters`, `times` (T,) [s], and `run`.

    Attributes:
        parameters: of the scene and its law as they are; see `Model`.
        times: (T,) [s] at which runs are recorded.
    """

    def __init__(self, engine: JAX, request: Request, times: Array | None = None) -> None:
        scene, self.engine, self.request = request.scene, engine, request
        own = request.law.own
        if own is not None:
            require_rest_lengths(scene.structure)
        law = None if own is None else array_law(own, scene.structure)
        self.law = law
        self._model = Model(scene, array_effects(scene), law, request.actuation, engine.spread)
        self.parameters = self._model.parameters
        breaks = scene.break_times
        self.segments: list[Segment] = []
        if engine.timestep is not None:
            grid = Grid.of(request, engine.timestep)
            self.times, self.grid = grid.times, grid
            self.steps = Steps(grid.step, grid.stride, grid.ratio, break_steps(breaks, grid.step))
            return
        interval = request.output_interval or 0.01
        if times is None:
            count = max(1, int(np.ceil(request.duration / interval * (1 - 1e-12))))
            times = np.minimum(interval * np.arange(count + 1), request.duration)
        self.times = times
        ends = sorted({t for t in breaks.tolist() if 0 < t < times[-1]} | {float(times[-1])})
        start = 0.0
        for end in ends:
            inside = times[(times > start) & ((times < end) | (times == times[-1]) & (end == times[-1]))]
            whole = np.unique(np.concatenate([[start], inside, [end]]))
            self.segments.append(Segment(whole, (breaks > start).astype(float), bool(start in times), len(inside)))
            start = end

    def run(self, parameters: Any) -> Observed:
        """A run, with times first, as a function to be compiled and differentiated: (T, N, 3) nodes and so on."""
        model, at = self._model, self._model.prepare(parameters)
        state, held = model.start(at)
        parts = [] if self.segments else [one_row(model, at, 0.0, state, held, model.whole)]
        if self.engine.timestep is not None:
            count, rest = divmod(self.grid.count, self.grid.stride)
            state, held, rows = fixed_steps(model, at, state, held, 0, count, self.steps)
            parts.append(rows)
            if rest:
                last = self.steps._replace(stride=rest)
                parts.append(fixed_steps(model, at, state, held, self.grid.count - rest, 1, last)[2])
            return joined(parts)
        previous = model.whole
        for times, whole, begins, count in self.segments:
            state, rows = self._entered(at, times[0], state, held, previous, whole)
            parts += [rows] if begins else []
            state, rows, took = controlled_steps(model, at, state, held, times, whole, self.engine.tolerances)
            failed, previous = took["failed"], whole
            parts.append(jax.tree.map(lambda x, n=count, failed=failed: jnp.where(failed, jnp.nan, x[:n]), rows))
        return joined(parts)

    def _entered(
        self, at: Prepared, t: Any, state: State, held: Held, before: Any, whole: Any
    ) -> tuple[State, Observed]:
        """The state at the start of a segment, without the energy of what broke there, and what is observed there."""
        state = self._model.lose(at, t, state, held, before, whole)
        return state, one_row(self._model, at, t, state, held, whole)

    def accelerations(self) -> Callable[..., tuple[Array, Array]]:
        """See `Accelerations`."""
        model, p = self._model, self.parameters

        @jax.jit
        def found(t: Any, nodes: Any, velocities: Any, rest: Any) -> tuple[Any, Any]:
            at = model.prepare({**p, "rest_lengths": rest})
            places, rates = model.system.state(nodes, velocities, t)
            state = State(places, rates, jnp.zeros(4))
            _, observed, accelerations = model.evaluate(at, t, state, Held(rest, jnp.zeros(5)), model.whole)
            return observed.nodes, accelerations

        def at(t: float, nodes: Array, velocities: Array, rest_lengths: Array | None = None) -> tuple[Array, Array]:
            rest = p["rest_lengths"] if rest_lengths is None else rest_lengths
            places, accelerations = found(float(t), nodes, velocities, rest)
            return np.array(places), np.array(accelerations)

        return at

    def trajectory(self) -> Trajectory:
        """The run of the parameters as they are, in pieces."""
        from tensegrity_mj.engines.jax.recording import trajectory_of

        rows, cost, failed = self.fixed() if self.engine.timestep is not None else self._controlled()
        return trajectory_of(self.engine, self.request, rows, cost, failed)

    def fixed(self, label: str = "") -> tuple[Observed, dict[str, float], bool]:
        """The rows of fixed steps, what they cost, and whether they failed; taken in pieces, with progress."""
        model, grid = self._model, self.grid
        whole, rest = divmod(grid.count, grid.stride)
        at, state, held, row = self._begin()
        kinds: dict[tuple[int, int], Callable[..., Any]] = {}
        parts, first = [row], 0
        plan = [(rows, grid.stride) for rows in pieces(whole)] + ([(1, rest)] if rest else [])
        watch = Watch()
        with progress(self.request, label or str(self.engine)) as show:
            for rows, stride in plan:
                if (rows, stride) not in kinds:
                    steps = self.steps._replace(stride=stride)

                    def advance(at: Any, state: Any, held: Any, first: Any, n: int = rows, own: Steps = steps) -> Any:
                        return fixed_steps(model, at, state, held, first, n, own)

                    with watch.paused():
                        kinds[rows, stride] = compiled(advance, at, state, held, first)
                state, held, found = kinds[rows, stride](at, state, held, first)
                parts.append(jax.tree.map(np.asarray, found))
                first += rows * stride
                show(first * grid.step)
                interrupts.raise_if_requested()
                if not np.any(np.isfinite(parts[-1].nodes[-1])):
                    break
        cost = {"wall_time": watch.seconds, "steps": first, "evaluations": 4 * first}
        return jax.tree.map(lambda *x: np.concatenate(x), *parts), cost, False

    def _controlled(self) -> tuple[Observed, dict[str, float], bool]:
        model, tolerances = self._model, self.engine.tolerances
        at, state, held, _ = self._begin()
        kinds: dict[int, Callable[..., Any]] = {}
        parts: list[Any] = []
        watch, steps = Watch(), 0

        def advance(at: Any, state: Any, held: Any, times: Any, whole: Any) -> Any:
            return controlled_steps(model, at, state, held, times, whole, tolerances)

        enter, previous, failed = jax.jit(self._entered), model.whole, False
        with progress(self.request, str(self.engine)) as show:
            for times, whole, begins, count in self.segments:
                with watch.paused():
                    state, found = enter(at, times[0], state, held, previous, whole)
                parts += [jax.tree.map(np.asarray, found)] if begins else []
                previous, first = whole, 0
                for size in pieces(len(times) - 1):
                    wanted = times[first : first + size + 1]
                    if size not in kinds:
                        with watch.paused():
                            kinds[size] = compiled(advance, at, state, held, wanted, whole)
                    state, found, took = kinds[size](at, state, held, wanted, whole)
                    parts.append(jax.tree.map(lambda x, n=count - first: np.asarray(x)[: max(0, n)], found))
                    steps, failed, first = steps + int(took["steps"]), bool(took["failed"]), first + size
                    show(float(wanted[-1]))
                    interrupts.raise_if_requested()
                    if failed or not np.all(np.isfinite(np.asarray(found.nodes)[-1])):
                        break
                if failed:
                    break
        cost = {"wall_time": watch.seconds, "steps": steps, "evaluations": 13 * steps}
        return jax.tree.map(lambda *x: np.concatenate(x), *parts), cost, failed

    def _begin(self) -> tuple[Prepared, State, Held, Observed]:
        model = self._model

        def begin(p: Any) -> tuple[Prepared, State, Held, Observed]:
            at = model.prepare(p)
            state, held = model.start(at)
            return at, state, held, one_row(model, at, 0.0, state, held, model.whole)

        at, state, held, row = jax.jit(begin)(self.parameters)
        return at, state, held, jax.tree.map(np.asarray, row)


def pieces(rows: int) -> list[int]:
    """Rows in some twenty pieces, of one size where a divisor is near."""
    if not rows:
        return []
    count = next((n for n in range(PIECES, 2 * PIECES) if rows % n == 0), min(rows, PIECES))
    size = -(-rows // count)
    return [size] * (rows // size) + ([rows % size] if rows % size else [])


class Segment(NamedTuple):
    """A part of a run between breaks of strings.

    Attributes:
        times: [s] its start, those at which it is recorded, its end.
        whole: (M,) which strings are.
        begins: whether its start is recorded.
        kept: how many of the times behind that are.
    """

    times: Array
    whole: Array
    begins: bool
    kept: int


class Watch:
    """Wall time without that of compiling."""

    def __init__(self) -> None:
        self._start = time.perf_counter()

    @contextmanager
    def paused(self) -> Iterator[None]:
        """Do not count the block."""
        begun = time.perf_counter()
        yield
        self._start += time.perf_counter() - begun

    @property
    def seconds(self) -> float:
        """Since the start [s]."""
        return time.perf_counter() - self._start


def compiled(function: Callable[..., Any], *arguments: Any) -> Callable[..., Any]:
    """A function compiled for arguments like these; who waits long for it reads why."""
    words = "tensegrity-mj: JAX compiles this run, once: it is kept for the next process"
    timer = threading.Timer(QUIET, lambda: print(words, file=sys.stderr, flush=True))
    timer.start()
    try:
        return jax.jit(function).lower(*arguments).compile()
    finally:
        timer.cancel()
