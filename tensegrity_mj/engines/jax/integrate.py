"""Integration of a model: fixed steps of classical Runge-Kutta by scan, or diffrax' Dopri8 with controlled errors."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from tensegrity_mj.basics.arrays import Array, IntArray
from tensegrity_mj.engines.jax.model import Held, Model, Observed, Prepared, State


class Steps(NamedTuple):
    """Fixed steps.

    Attributes:
        step: [s].
        stride: how many a recorded row.
        ratio: how many a sample of the law; 0: it is not sampled.
        breaks: (M,) the number of the step at whose start each string breaks, or None where none does.
    """

    step: float
    stride: int
    ratio: int
    breaks: IntArray | None


class Tolerances(NamedTuple):
    """Of Dopri8: relative and absolute tolerance, most steps, longest step [s] or None, and diffrax' adjoint."""

    rtol: float
    atol: float
    most: int
    longest: float | None
    adjoint: Any


def fixed_steps(
    model: Model, at: Prepared, state: State, held: Held, first: Any, rows: int, steps: Steps
) -> tuple[State, Held, Observed]:
    """`rows` times `stride` steps from number `first` on, and what is observed after each row.

    Derivatives backwards keep the states of rows alone, and take the steps of one row at a time again.
    """
    h = steps.step

    def whole_at(number: Any) -> Any:
        return model.whole if steps.breaks is None else (steps.breaks > number).astype(float)

    def take(carry: tuple[State, Held], number: Any) -> tuple[tuple[State, Held], None]:
        state, held = carry
        state = model.step(at, number * h, h, state, held, whole_at(number))
        if steps.breaks is not None:
            state = model.lose(at, (number + 1) * h, state, held, whole_at(number), whole_at(number + 1))
        if steps.ratio:
            t, due = (number + 1) * h, (number + 1) % steps.ratio == 0
            again = lambda pair: model.sample(at, t, pair[0], pair[1], whole_at(number + 1))  # noqa: E731
            state, held = jax.lax.cond(due, again, lambda pair: pair, (state, held))
        return (state, held), None

    @jax.checkpoint
    def row(carry: tuple[State, Held], number: Any) -> tuple[tuple[State, Held], Observed]:
        carry, _ = jax.lax.scan(take, carry, number + jnp.arange(steps.stride))
        last = number + steps.stride
        return carry, model.evaluate(at, last * h, *carry, whole_at(last))[1]

    numbers = first + steps.stride * jnp.arange(rows)
    (state, held), observed = jax.lax.scan(row, (state, held), numbers)
    return state, held, observed


def controlled_steps(
    model: Model, at: Prepared, state: State, held: Held, times: Any, whole: Array, tolerances: Tolerances
) -> tuple[State, Observed, dict[str, Any]]:
    """From times[0] to the others (T,), what is observed at these, and what it took: `steps`, `failed`."""
    import diffrax

    def rates(t: Any, y: State, at: Prepared) -> State:
        return model.rates(at, t, y, held, whole)

    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(rates),
        diffrax.Dopri8(),
        t0=times[0],
        t1=times[-1],
        dt0=None,
        y0=state,
        args=at,
        saveat=diffrax.SaveAt(ts=times[1:]),
        stepsize_controller=diffrax.PIDController(rtol=tolerances.rtol, atol=tolerances.atol, dtmax=tolerances.longest),
        max_steps=tolerances.most,
        adjoint=tolerances.adjoint,
        throw=False,
    )

    def observe(pair: tuple[Any, State]) -> Observed:
        return model.evaluate(at, pair[0], pair[1], held, whole)[1]

    observed = jax.lax.map(observe, (times[1:], solution.ys))
    last = jax.tree.map(lambda x: x[-1], solution.ys)
    took = {"steps": solution.stats["num_steps"], "failed": solution.result != diffrax.RESULTS.successful}
    return last, observed, took


def one_row(model: Model, at: Prepared, t: Any, state: State, held: Held, whole: Any) -> Observed:
    """What is observed at one time, with times first."""
    return jax.tree.map(lambda x: x[None], model.evaluate(at, t, state, held, whole)[1])


def joined(parts: list[Observed]) -> Observed:
    """One after the other."""
    return jax.tree.map(lambda *pieces: jnp.concatenate(pieces), *parts)


def break_steps(times: Array, step: float) -> IntArray | None:
    """(M,) of the times at which strings break (∞: never), multiples of the step; None where none does."""
    if not np.isfinite(times).any():
        return None
    return np.where(np.isfinite(times), np.round(np.where(np.isfinite(times), times, 0.0) / step), 2**53).astype(
        np.int64
    )
