"""A run under error control, compiled: steps onto marks, and what is looked for within each.

The law may lose or regain its solution within a step, a string that yields may turn, and the model's coordinates may
come to a state that they cannot hold: such an instant is located on the dense output, and the step ends there. Strings
that are slack at both ends may pull for a moment (`pulls`): then the step is taken again in shorter ones.
"""

from __future__ import annotations

import math
from typing import Any

from tensegrity_mj.dynamics.native.actuation import evaluate_law, remember, start_ledger
from tensegrity_mj.dynamics.native.compiling import c_function
from tensegrity_mj.dynamics.native.law import NO_SOLUTION, SOLVED
from tensegrity_mj.dynamics.native.pointers import borrowing, call_timed, copy
from tensegrity_mj.dynamics.native.watch import watch_strings
from tensegrity_mj.engines.reference.dop853 import (
    ENDED,
    FAILED,
    GOING,
    PAUSED,
    PULLED,
    SLIDES,
    STAGES,
    TOO_SHORT,
    UNHELD,
    UNSOLVED,
    Controlled,
    evaluate,
    interpolate,
    spacing,
)
from tensegrity_mj.engines.reference.equations import (
    SINGULAR,
    ModelView,
    break_due_strings,
    guard,
    observe,
    place,
    project,
    sample_law,
)
from tensegrity_mj.engines.reference.pulls import LOOKS, pulls_within

JUMP, SAMPLE = 1, 2  # at a mark: something jumps there, by a sample of the law
# A law that loses and regains its solution more often than this slides along the boundary of the admissible set.
MAX_SWITCHES = 1000
SWITCH_TOLERANCE = 1e-10  # s, to which the time of a switch is located
RETREAT = 0.2  # of a step, after a stage that the model's coordinates cannot hold: what a method takes at least, too
HELD, ANSWERED, STRETCHED = range(3)  # what ceases at an instant that is located


@borrowing
def _answers(own: Any, t: float, y: Any) -> bool:
    """Return whether the law has a solution at a state; `trouble` where that is not known."""
    trouble = evaluate(own, t, y, own.dy)
    if trouble:
        own.trouble = trouble
        return False
    if ModelView(own.table).suspended:
        return evaluate_law(own.table, t) != NO_SOLUTION
    return own.answer != NO_SOLUTION


@borrowing
def _stretched(own: Any, y: Any) -> bool:
    """Return whether all strings that turn within the step still grow longer at a state."""
    place(y, own.table)
    own.fresh = 0
    turning, rates = own.near, ModelView(own.table).rates
    stretched = True
    for m in range(len(turning)):
        stretched &= not (turning[m] and rates[m] <= 0.0)
    return stretched


@borrowing
def _holds(own: Any, what: int, t: float) -> bool:
    own.trouble = interpolate(own, t, own.x)
    if own.trouble:
        return False
    if what == HELD:
        return guard(own.x, own.table) != SINGULAR
    if what == STRETCHED:
        return _stretched(own, own.x)
    return _answers(own, t, own.x) != (ModelView(own.table).suspended != 0)


@borrowing
def _bracket(own: Any, what: int, end: float, within: float) -> tuple[float, float]:
    """Bisect from t to an end within the step for the instant at which something ceases to hold [s]."""
    start = own.t
    while end - start > within and own.trouble == GOING:
        middle = 0.5 * (start + end)
        if not start < middle < end:
            break
        if _holds(own, what, middle):
            start = middle
        else:
            end = middle
    return start, end


@borrowing
def _turns(own: Any) -> bool:
    """Mark the strings that yield and grow longer at t, and shorter at `end`."""
    plant, turning, any_turning = ModelView(own.table), own.near, False
    yields, rates = plant.yields, plant.rates
    place(own.y, own.table)
    for m in range(len(turning)):
        turning[m] = yields[m] != 0 and rates[m] > 0.0
    place(own.new, own.table)
    own.fresh = 0
    for m in range(len(turning)):
        turning[m] = turning[m] and rates[m] < 0.0
        any_turning |= turning[m] != 0
    return any_turning


@borrowing
def _record(own: Any, t: float, y: Any) -> int:
    """Write the next row, a state at a time."""
    if not (own.fresh and t == own.end):
        answer = evaluate(own, t, y, own.dy)
        if answer:
            return answer
    suspended = ModelView(own.table).suspended != 0
    watch_strings(own.table, t, own.continuous and not suspended and own.answer == SOLVED)
    if suspended:
        evaluate_law(own.table, t)  # for its margin and V; what it holds stays held
    observe(y, own.table, own.rows[own.next])
    own.next += 1
    return GOING


@borrowing
def _sample(own: Any) -> int:
    """Sample the law; what it holds jumps."""
    model = ModelView(own.table)
    own.answer, own.failed_at = sample_law(own.t, own.y, own.table), own.t
    own.begun = 0
    if own.answer > NO_SOLUTION or model.status != 0:
        return FAILED
    watch_strings(own.table, own.t, own.answer == SOLVED)
    return UNSOLVED if own.answer == NO_SOLUTION and not model.passive else GOING


@borrowing
def _suspend(own: Any) -> int:
    model = ModelView(own.table)
    if not model.passive:
        return UNSOLVED
    model.suspended = 1
    return GOING


@borrowing
def _switch(own: Any) -> int:
    """Let the law go or take it up again, at the instant at which it loses or regains its solution."""
    model = ModelView(own.table)
    own.switches += 1
    if own.switches > MAX_SWITCHES:
        return SLIDES
    if model.suspended:
        model.suspended = 0
        return GOING
    answer = evaluate(own, own.t, own.y, own.dy)
    if answer == GOING and own.answer == SOLVED:
        remember(own.table)
    return answer or _suspend(own)


@borrowing
def _start(own: Any) -> int:
    table = own.table
    if guard(own.y, table) == SINGULAR:
        evaluate(own, own.t, own.y, own.dy)  # for the lengths of strings
        start_ledger(table)
        return UNHELD
    break_due_strings(own.t, own.y, table)
    answer = (_sample(own) if own.sampled else GOING) or evaluate(own, own.t, own.y, own.dy)
    if answer:
        return answer
    watch_strings(table, own.t, own.continuous and own.answer == SOLVED)
    start_ledger(table)
    if own.continuous and own.answer == NO_SOLUTION:
        answer = _suspend(own)
    elif own.continuous:
        remember(table)
    return answer or _record(own, own.t, own.y)


@borrowing
def _try(own: Any, own_at: int, mark: float) -> int:
    """A step of the method, shortened until all its stages are states that the model can hold."""
    while True:
        answer = call_timed(own.method, mark, own_at, 0, 0)
        if answer != UNHELD:
            break
        left = mark - own.t
        tried = own.h if own.begun else own.first_step
        own.first_step = RETREAT * (min(tried, left) if tried > 0.0 else left)
        own.begun = 0
        if not own.first_step >= 16.0 * spacing(max(own.t, 1e-3 * mark)):
            return UNHELD
    new = own.new
    for i in range(len(new)):
        if answer == GOING and not math.isfinite(new[i]):
            answer = TOO_SHORT
    return answer


@borrowing
def _step(own: Any, own_at: int, mark: float, jumps: bool) -> int:
    """One accepted step, its rows, and an event within it that ends it."""
    model, new, x = ModelView(own.table), own.new, own.x
    answer = _try(own, own_at, mark)
    if answer:
        return answer
    own.steps += 1
    holds = own.continuous or model.holds_force_density
    if model.string_count > 0 and not holds and own.end - own.t >= own.least_searched:
        answer = pulls_within(own)
        if answer == PULLED:  # again from where it began, in steps that cannot miss it
            own.longest_step, own.careful_until = (own.end - own.t) / LOOKS, max(own.careful_until, own.end)
            own.begun = 0
            return GOING
        if answer:
            return answer
    if own.end >= own.careful_until:
        own.longest_step = own.widest_step
    own.first_step = own.h
    end, stuck, switched, turned = own.end, guard(new, own.table) == SINGULAR, False, False
    if stuck:
        end, _ = _bracket(own, HELD, own.end, SWITCH_TOLERANCE)
        interpolate(own, end, x)
    if own.continuous:
        was = model.suspended == 0
        if own.fresh and not stuck and was:
            switched = own.answer == NO_SOLUTION
        else:
            switched = _answers(own, end, x if stuck else new) != was
        if switched and own.trouble == GOING:
            stuck = False
            # On the far side when regained (the law must have a solution there), on the near side when lost.
            before, after = _bracket(own, ANSWERED, end, SWITCH_TOLERANCE)
            end = before if was else after
    if model.yielding and not switched and _turns(own):
        _, turn = _bracket(own, STRETCHED, end, 0.0)
        turned, stuck, end = turn < end, stuck and turn == end, turn
    if own.trouble:
        return own.trouble
    answer = _outputs(own, end, jumps and end == mark)
    if answer == GOING and end < own.end:
        answer = interpolate(own, end, x)
    if answer:
        return answer
    if end < own.end:
        copy(x, own.y)
    else:
        copy(new, own.y)
        copy(own.stages[STAGES], own.stages[0])
    own.t = end
    if stuck:
        return UNHELD
    if switched or turned:
        own.begun = 0
        answer = _switch(own) if switched else GOING
    else:
        answer = _arrive(own)
    if answer == GOING and model.yielding:
        model.arrived = 1
        answer = evaluate(own, own.t, own.y, own.dy)
    own.fresh = 0
    return answer


@borrowing
def _outputs(own: Any, end: float, before: bool) -> int:
    """Write the rows at times up to an end, or `before` it."""
    times = own.times
    while own.next < len(times) and (times[own.next] < end or (times[own.next] == end and not before)):
        t = times[own.next]
        answer = _record(own, t, own.new) if t == own.end else interpolate(own, t, own.x) or _record(own, t, own.x)
        if answer:
            return answer
    return GOING


@borrowing
def _arrive(own: Any) -> int:
    """Go on from the end of a whole step."""
    model, table = ModelView(own.table), own.table
    if model.project_function:
        project(own.y, table)
        answer = evaluate(own, own.t, own.y, own.stages[0])
        if answer:
            return answer
        own.fresh = 1
    if own.continuous and not model.suspended:
        if not own.fresh:
            answer = evaluate(own, own.t, own.y, own.dy)
            if answer:
                return answer
        watch_strings(table, own.t, True)
        remember(table)
    return GOING


@c_function("int64(int64, int64)", "runs under error control")
def advance(own_at, count):  # type: ignore[no-untyped-def]
    """Take up to `count` steps of a run, whose table is at an address; return ENDED, PAUSED or what it came to."""
    own = Controlled(own_at)
    marks, kinds, taken = own.marks, own.kinds, 0
    if not own.started:
        own.started = 1
        answer = _start(own)
        if answer:
            return answer
    while own.mark < len(marks):
        mark, kind = marks[own.mark], kinds[own.mark]
        while own.t < mark:
            if taken == count:
                return PAUSED
            taken += 1
            answer = _step(own, own_at, mark, kind & JUMP != 0)
            if answer:
                return answer
        if break_due_strings(own.t, own.y, own.table):
            own.begun = 0
        answer = _sample(own) if kind & SAMPLE else GOING
        while answer == GOING and kind & JUMP and own.next < len(own.times) and own.times[own.next] <= mark:
            answer = _record(own, own.t, own.y)
        if answer:
            return answer
        own.mark += 1
    while own.next < len(own.times):
        answer = _record(own, own.t, own.y)
        if answer:
            return answer
    return ENDED
