"""Integration of a model: fixed steps of classical Runge-Kutta by scan, or diffrax' Dopri8 with controlled errors.

Either is made in pieces, each of which begins with a state at an instant and gives the state at its end.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from itertools import chain
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

from tensegrity_mj.basics.arrays import Array, IntArray
from tensegrity_mj.engines.driving import Grid
from tensegrity_mj.engines.jax.model import Held, Model, Observed, Prepared, State
from tensegrity_mj.engines.jax.settings import JAX, Derivatives

TO_THE_END, GAVE_UP, UNDEFINED = range(3)  # how a piece ended: UNDEFINED where rates are not finite
SHORTEST = 1e-30  # s, far below round-off of times: to such steps Dopri8 comes where it can go no further
Split = Callable[[int], Iterable[int]]  # how many rows in which pieces


class Piece(NamedTuple):
    """A part of a run.

    Attributes:
        kind: what its compiled function depends on.
        given: the arguments of that function in addition to the state.
        recorded: which of its rows are recorded, that of its start being the first.
        end: [s].
    """

    kind: tuple[int, ...]
    given: Any
    recorded: Any
    end: float


class Advanced(NamedTuple):
    """Result of a piece: the state at its end, what is observed from its start on, steps, and how it ended."""

    state: State
    held: Held
    rows: Observed
    steps: Any
    ended: Any


class FixedSteps:
    """Steps of classical Runge-Kutta on a grid, on which strings break at times (M,), ∞ for never."""

    stages = 4

    def __init__(self, grid: Grid, breaks: Array) -> None:
        self.grid, self.times, self.stride = grid, grid.times, grid.stride
        within = breaks <= self.times[-1] * (1 + 1e-12)
        # The number of the step at whose start each string breaks.
        steps = np.round(np.where(within, breaks, 0.0) / grid.step)
        self.breaks: IntArray | None = np.where(within, steps, 2**53).astype(np.int64) if within.any() else None

    def pieces(self, split: Split) -> Iterator[Piece]:
        """Yield pieces of as many rows as `split` says; a shorter last row is a piece of its own."""
        rows, rest = divmod(self.grid.count, self.grid.stride)
        first = begin = self.grid.first
        for kind in chain(((size, self.grid.stride) for size in split(rows)), [(1, rest)] * (rest > 0)):
            end = first + kind[0] * kind[1]
            yield Piece(kind, first, slice(int(first > begin), None), end * self.grid.step)
            first = end

    def advance(
        self, kind: tuple[int, ...], model: Model, at: Prepared, state: State, held: Held, first: Any
    ) -> Advanced:
        """Take the rows and steps of a piece of this kind, from step `first` on.

        Derivatives backwards keep the state of every step, and take each again: what a step has in between is
        some hundred small arrays, which take longer to keep than to find again.
        """
        (rows, stride), h, ratio = kind, self.grid.step, self.grid.ratio

        def whole_at(number: Any) -> Any:
            return model.whole if self.breaks is None else (self.breaks > number).astype(float)

        @jax.checkpoint
        def take(carry: tuple[State, Held], number: Any) -> tuple[tuple[State, Held], None]:
            state, held = carry
            t, whole = (number + 1) * h, whole_at(number + 1)
            state = model.step(at, number * h, h, state, held, whole_at(number))
            if self.breaks is not None:
                state = model.lose(at, t, state, held, whole_at(number), whole)
            if ratio:
                again = lambda pair: model.sample(at, t, pair[0], pair[1], whole)  # noqa: E731
                state, held = jax.lax.cond((number + 1) % ratio == 0, again, lambda pair: pair, (state, held))
            return (state, held), None

        def row(carry: tuple[State, Held], number: Any) -> tuple[tuple[State, Held], tuple[State, Held]]:
            carry, _ = jax.lax.scan(take, carry, number + jnp.arange(stride))
            return carry, carry

        @jax.checkpoint
        def observe(moment: tuple[Any, State, Held]) -> Observed:
            number, state, held = moment
            return model.evaluate(at, number * h, state, held, whole_at(number))[1]

        numbers = first + stride * jnp.arange(rows + 1)
        last, later = jax.lax.scan(row, (state, held), numbers[:-1])
        observed = jax.lax.map(observe, (numbers, *_after((state, held), later)))
        return Advanced(last[0], last[1], observed, rows * stride, TO_THE_END)


class ControlledSteps:
    """Steps of Dopri8 from `begin` on, recorded at times (T,), anew where strings break, at times (M,), ∞ for never."""

    stages, stride = 13, 1  # steps a row, as far as they are known

    def __init__(self, begin: float, times: Array, breaks: Array, engine: JAX) -> None:
        near = times[np.argmin(np.abs(times - breaks[:, None]), axis=1)]
        # The very float of a recorded time where they coincide, so that no sliver of a step lies between.
        self.breaks = np.where(np.abs(near - breaks) <= 1e-12 * near, near, breaks)
        self.begin, self.times, self.engine = begin, times, engine

    def pieces(self, split: Split) -> Iterator[Piece]:
        """Yield pieces of as many of the times as `split` says; where strings break, a new one begins."""
        start, before = self.begin, self.breaks > self.begin
        ends = np.unique([*self.breaks[before & (self.breaks <= self.times[-1])], self.times[-1]])
        if ends[-1] in self.breaks:  # what breaks at the end is recorded as broken
            ends = np.append(ends, np.nextafter(ends[-1], np.inf))
        for end in ends:
            inside = self.times[(self.times > start) & (self.times < end)]
            marks, whole, first = np.array([start, *inside, end]), self.breaks > start, 0
            for size in split(len(marks) - 1):
                own = marks[first : first + size + 1]
                # Where strings break, it is the piece behind that is recorded.
                low, high = np.searchsorted(self.times, own[[0, -1]])
                recorded = (
                    np.isin(own, self.times[low : high + 1])
                    & ((own > own[0]) | (first == 0))
                    & ((own < end) | (end == ends[-1]))
                )
                given = own, before.astype(float), whole.astype(float)
                yield Piece((len(own),), given, np.flatnonzero(recorded), float(own[-1]))
                first, before = first + size, whole
            start = end

    def advance(
        self, kind: tuple[int, ...], model: Model, at: Prepared, state: State, held: Held, given: Any
    ) -> Advanced:
        """Integrate from the first of the times to the others; strings that break there lose their energy before."""
        (times, before, whole), own = given, self.engine

        def rates(t: Any, y: State, given: tuple[Prepared, Held, Any]) -> State:
            at, held, whole = given
            return model.rates(at, t, y, held, whole)

        def observe(moment: tuple[Any, State]) -> Observed:
            return model.evaluate(at, *moment, held, whole)[1]

        state = model.lose(at, times[0], state, held, before, whole)
        longest = 0.25 * own.spread or None
        controller = diffrax.PIDController(own.rtol, own.atol, dtmin=SHORTEST, dtmax=longest, force_dtmin=False)
        forward = own.derivatives is Derivatives.FORWARD
        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(rates),
            diffrax.Dopri8(),
            t0=times[0],
            t1=times[-1],
            dt0=None,
            y0=state,
            args=(at, held, whole),
            saveat=diffrax.SaveAt(ts=times[1:]),
            stepsize_controller=controller,
            max_steps=own.max_steps,
            adjoint=diffrax.ForwardMode() if forward else diffrax.RecursiveCheckpointAdjoint(),
            throw=False,
        )
        results, result = diffrax.RESULTS, solution.result
        failed = jnp.where(result == results.dt_min_reached, UNDEFINED, GAVE_UP)
        ended = jnp.where(result == results.successful, TO_THE_END, failed)
        rows = jax.lax.map(observe, (times, _after(state, solution.ys)))
        last = jax.tree.map(lambda x: x[-1], solution.ys)
        return Advanced(last, held, rows, solution.stats["num_steps"], ended)


def _after(first: Any, later: Any) -> Any:
    """Join arrays of the first instant and of the others."""
    return jax.tree.map(lambda one, more: jnp.concatenate([jnp.asarray(one)[None], more]), first, later)
