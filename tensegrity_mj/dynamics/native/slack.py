"""Instants within a step at which string forces have kinks or jumps; shared by all engines that split their steps.

A string pulls where its margin min(k s, k s + c ds/dt) > 0, with its stretch s = L - L0: it must be taut, and a damper
must not outweigh it. Where its tension passes a corner, a level of its stretch takes the place of zero, and where one
that yields turns back its rate is the margin, and the level ∞. Where some strings have curves each has two rows, one
for its pull and one for its level, so that the first of all instants is found.

What is known of the strings at a time is `look`ed up after the engine has set lengths, rates and rest lengths, in an
array (3, W) of margins [N], stretches [m] and their rates [m/s]. While an instant is searched, slack strings stay slack
and those whose damper may push taut, so that no stage of a trial sees the force that is yet to come; where it jumps, in
whole steps, too: a stage may lie beyond a jump that the end does not show. A law at every stage must be evaluated once
more for it in each trial. Strings that it lets go have a margin of 0, which says nothing of when it will have them pull
again: there, the time is halved.

A step, or what is left of one, goes with a `Search`

    look_at_start(table, search, last)
    ... take the step; set lengths, rates and rest lengths at its end ...
    part = look_at_end(table, search, h)    # 0: nothing to search for
    begin_search(table, search, part)
    while (part := next_part(table, search, h)) > 0:
        ... take `part` of the step from the same start; set lengths, rates and rest lengths there ...
        if not look_at_trial(table, search, part, answer):
            break
    part = end_search(table, search)        # after which some string changes, as the last trial has it; 0: none does
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tensegrity_mj.dynamics.native.curves import (
    corner_between,
    cubic,
    cubic_root,
    curved_pull,
    dip,
    turn_of_cubic,
)
from tensegrity_mj.dynamics.native.law import NO_SOLUTION
from tensegrity_mj.dynamics.native.plant_view import PlantView
from tensegrity_mj.dynamics.native.pointers import borrowing, inlined
from tensegrity_mj.dynamics.native.strings import KEPT_SLACK, KEPT_TAUT, over_rest, rest_moves
from tensegrity_mj.dynamics.native.views import Table, view_of
from tensegrity_mj.model.strings import EDGE

MOST_SPLITS = 12  # of a step; one with more changes is too coarse for any order
MOST_TRIALS = 40  # for one instant
SECANTS = 8  # after so many of them, every other trial halves where the instant may lie
# To what part ε of the step an instant is located: past a kink, a step errs by a part of h² ε, past a jump, of h ε.
# Where a kink lies off the chord between the ends of the step by a part δ, δ falls as h does, and the step errs by a
# part of h² δ² all the same: ε is some of δ². A law costs more, and nothing is known of its slopes.
JUMP_WITHIN, LAW_WITHIN = 1e-8, 1e-3
KINK_LEAST, KINK_MOST, KINK_PART = 1e-6, 1e-2, 0.3
WHOLE, (MARGIN, STRETCH, SPEED) = 0, range(3)  # of BROKEN; of each string: [N], [m], [m/s]

# States of the strings that a search keeps: at the start of the step; after a part in which none has changed, and after
# one in which some have; after the last trial, and after the one before. CHORDS is scratch.
START, ABOVE, BELOW, NOW, BEFORE, CHORDS = range(6)
Search, _pack_search = view_of(
    "Search",
    strings=("f8", 6, 3, "count"),
    pulled=("b1", "count"),  # whether each string pulls at the start, and is slack there
    slack=("b1", "count"),
    levels=("f8", "count"),  # of the stretch, of what is searched: zero, a corner, or ∞
    low="real",  # the parts of the step of BELOW, ABOVE, NOW and BEFORE
    high="real",
    at_now="real",
    at_before="real",
    trials="state",  # so far
    known="state",  # whether strings are known to have changed at `high`
    later="state",  # whether they are at the end of the step, where `high` is before
    tried="state",  # whether a trial has found so
)


def search_of(strings: int, curved: bool = False) -> Table:
    """A `Search` for so many strings; `curved`: whether any has more than its stiffness."""
    count = strings * (1 + curved)
    numbers = dict.fromkeys(("low", "high", "at_now", "at_before", "trials", "known", "later", "tried"), 0)
    marks = np.zeros((2, count), np.bool_)
    rows = np.zeros((CHORDS + 1, 3, count))
    return _pack_search(strings=rows, pulled=marks[0], slack=marks[1], levels=np.zeros(count), **numbers)


@borrowing
def _look(plant: Any, levels: Any, out: Any) -> None:
    """Margin, stretch and rate of each string now, and of its level (3, W)."""
    stiffness, damping, clipped, broken = plant.stiffness, plant.damping, plant.clipped, plant.broken
    speeds, curved, moves, M = plant.rates, plant.curved, rest_moves(plant), plant.string_count
    for m in range(M):
        stretch = over_rest(plant, m, moves)
        margin = stiffness[m] * stretch
        if curved and stretch > 0.0:
            margin = curved_pull(plant, m, stretch + plant.permanent[m])
        if clipped[m]:
            margin = min(margin, margin + damping[m] * speeds[m])
        out[MARGIN, m] = -1.0 if broken[m] == 1 else margin
        out[STRETCH, m], out[SPEED, m] = stretch, speeds[m]
        if curved:
            _over_level(levels, m, M + m, out)


@borrowing
def _over_level(levels: Any, m: int, w: int, out: Any) -> None:
    """Write margin, stretch and rate of a string relative to its level in row w; without a level it counts as above."""
    stretch, speed = out[STRETCH, m], out[SPEED, m]
    if levels[w] != 0.0 and levels[w] != np.inf:
        stretch -= levels[w]
    out[MARGIN, w] = 1.0 if levels[w] == 0.0 else speed if levels[w] == np.inf else stretch
    out[STRETCH, w], out[SPEED, w] = stretch, speed


@borrowing
def _set_levels(plant: Any, search: Any, h: float) -> float:
    """Levels of strings that pull at the start of a step and come past a corner, or turn.

    Returns the part of the step after which one turns back that passed a corner for a moment; 1 for none.
    """
    strings, levels, M, first = search.strings, search.levels, plant.string_count, 1.0
    start, end, moves = strings[START], strings[ABOVE], rest_moves(plant)
    for m in range(M):
        w, shift = M + m, plant.permanent[m]
        s0, s1, d0, d1 = start[STRETCH, m], end[STRETCH, m], h * start[SPEED, m], h * end[SPEED, m]
        if plant.broken[m] != WHOLE or not search.pulled[m]:
            continue
        corner = corner_between(plant, m, s0 + shift, s1 + shift)
        if corner == 0.0 and d0 * d1 < 0.0 and not moves:
            x = turn_of_cubic(s0, s1, d0, d1)
            corner = corner_between(plant, m, s0 + shift, cubic(x, s0, s1, d0, d1) + shift)
            if corner > 0.0:
                first = min(first, x)
            elif plant.yields[m] and d0 > 0.0 and s0 + shift >= plant.last_stretch[m, 2]:
                levels[w] = np.inf
        if corner > 0.0:
            levels[w] = corner - shift
        if levels[w] != 0.0:
            _over_level(levels, m, w, start)
            _over_level(levels, m, w, end)
            search.pulled[w] = start[MARGIN, w] > 0.0
    return float(first)


@inlined
def _follows_law(plant: Any) -> bool:
    return rest_moves(plant) and not plant.holds_force_density


@borrowing
def follows_law(table: int) -> bool:
    """Return whether rest lengths follow a law that must be evaluated."""
    return _follows_law(PlantView(table))


@borrowing
def look_at_start(table: int, searched: int, last: bool) -> None:
    """Note which strings pull at the start of a step, and which are slack.

    Those whose force jumps where they change are kept, but for the `last` part of a step, which is not searched.
    """
    plant, search = PlantView(table), Search(searched)
    start, pulled, slack, levels = search.strings[START], search.pulled, search.slack, search.levels
    for w in range(len(levels)):
        levels[w] = 0.0
    _look(plant, levels, start)
    for w in range(len(pulled)):
        pulled[w], slack[w] = start[MARGIN, w] > 0.0, start[STRETCH, w] <= 0.0
    if plant.damped and not last and not rest_moves(plant):
        for m in range(plant.string_count):
            if plant.damping[m] > 0.0 and not -EDGE * plant.lengths[m] <= start[STRETCH, m] <= 0.0:
                _keep(plant, m, slack[m])


@inlined
def _keep(plant: Any, m: int, slack: bool) -> None:
    """Keep a string slack, or one whose damper may push taut, until `_let_change`."""
    if plant.broken[m] == WHOLE and slack:
        plant.broken[m] = KEPT_SLACK
    elif plant.broken[m] == WHOLE and plant.damping[m] > 0.0 and not plant.clipped[m]:
        plant.broken[m] = KEPT_TAUT


@borrowing
def _let_change(plant: Any) -> None:
    """Let strings that were kept slack or taut be what they are."""
    broken = plant.broken
    for m in range(len(broken)):
        if broken[m] == KEPT_SLACK or broken[m] == KEPT_TAUT:
            broken[m] = WHOLE


@borrowing
def _any_changes(search: Any, state: int) -> bool:
    """Return whether any string has begun or ceased to pull."""
    pulled, now, changes = search.pulled, search.strings[state], False
    for m in range(len(pulled)):
        changes |= pulled[m] != (now[MARGIN, m] > 0.0)
    return changes


@borrowing
def look_at_end(table: int, searched: int, h: float) -> float:
    """Decide what to search for in a step of h [s] that was taken whole.

    Returns:
        0 for nothing; 1 where some strings have changed at its end; otherwise the part of the step after which a
        string turns back that was taut, or slack, for a moment within.

    A kink at the very start is none within the step: such a string counts as changed, in `pulled` and `slack`.
    """
    plant, search, first = PlantView(table), Search(searched), 1.0
    _let_change(plant)
    _look(plant, search.levels, search.strings[ABOVE])
    by_law = _follows_law(plant)
    if plant.curved and not plant.holds_force_density and (plant.returns_lengths or not by_law):
        first = _set_levels(plant, search, h)
    search.later = _any_changes(search, ABOVE) and _matters(plant, search, h)
    if not rest_moves(plant):
        first = min(first, _turn(plant, search, h))
    return first if first < 1.0 or search.later else 0.0


@borrowing
def _turn(plant: Any, search: Any, h: float) -> float:
    """The part of a step after which a string turns back that pulled, or did not, for a moment within; 1 for none.

    By the cubic of its stretch; of a taut string with a damper, by that of k s + c ds/dt, whose rate is k ds/dt + c s̈,
    s̈ of the former.
    """
    broken, damping, start, end, first = plant.broken, plant.damping, search.strings[START], search.strings[ABOVE], 1.0
    for m in range(len(broken)):
        s0, s1, d0, d1 = start[STRETCH, m], end[STRETCH, m], h * start[SPEED, m], h * end[SPEED, m]
        if broken[m] != WHOLE:
            continue
        first = min(first, dip(s0, s1, d0, d1))
        if damping[m] > 0.0 and plant.clipped[m] and s0 > 0.0 and s1 > 0.0:
            k, c, chord = plant.stiffness[m], damping[m] / h, 6.0 * (s1 - s0)
            m0, m1 = start[MARGIN, m] + c * max(d0, 0.0), end[MARGIN, m] + c * max(d1, 0.0)
            r0, r1 = k * d0 + c * (chord - 4.0 * d0 - 2.0 * d1), k * d1 + c * (2.0 * d0 + 4.0 * d1 - chord)
            first = min(first, dip(m0, m1, r0, r1))
    return float(first)


@borrowing
def _matters(plant: Any, search: Any, h: float) -> bool:
    """Return whether any change lies far enough from the ends of the step for the step to be split there."""
    start, end, pulled, slack = search.strings[START], search.strings[ABOVE], search.pulled, search.slack
    any_matters = False
    for m in range(len(pulled)):
        if pulled[m] == (end[MARGIN, m] > 0.0):
            continue
        if not _by_stretch(plant, search, m):
            any_matters = True
            continue
        s0, d0 = start[STRETCH, m], start[SPEED, m]
        at = cubic_root(s0, end[STRETCH, m], h * d0, h * end[SPEED, m])
        if m < plant.string_count and slack[m] and d0 >= 0.0 and s0 >= -EDGE * plant.lengths[m]:
            at = 0.0  # it begins to move from zero, where nothing jumps
        if KINK_LEAST < at < 1.0 - KINK_LEAST or (at > 0.0 and _jumps(plant, m, slack[m])):
            any_matters = True
        elif at <= KINK_LEAST:
            pulled[m], slack[m] = not pulled[m], False
    return any_matters


@inlined
def _jumps(plant: Any, m: int, slack: bool) -> bool:
    """Return whether a string's force jumps where it changes: it has a damper, and it becomes taut or may push."""
    return m < plant.string_count and plant.damping[m] > 0.0 and (slack or not plant.clipped[m])


@borrowing
def _within(plant: Any, m: int, slack: bool, off_chord: float) -> float:
    """Return the part of a step to which the instant of a string must be known."""
    if _jumps(plant, m, slack):
        return JUMP_WITHIN
    if _follows_law(plant):
        return LAW_WITHIN
    return min(max(KINK_PART * off_chord * off_chord, KINK_LEAST), KINK_MOST)


@inlined
def _by_stretch(plant: Any, search: Any, m: int) -> bool:
    """Return whether a string changes where its stretch, whose rate is known, changes its sign."""
    if rest_moves(plant):
        return False
    if m >= plant.string_count:
        return search.levels[m] < np.inf
    return search.slack[m] or plant.damping[m] == 0.0 or not plant.clipped[m]


@borrowing
def _copy(strings: Any, source: int, target: int) -> None:
    """Copy margins, stretches and rates of the strings from one state of a search to another."""
    for k in range(3):
        for m in range(strings.shape[2]):
            strings[target, k, m] = strings[source, k, m]


@borrowing
def begin_search(table: int, searched: int, part: float) -> None:
    """Begin to search the first instant at which a string changes; until it ends, strings are kept as they are.

    `part`: 1 where some have changed at the end of the step; otherwise a part of it after which some may have.
    """
    search, plant = Search(searched), PlantView(table)
    strings, slack = search.strings, search.slack
    _copy(strings, START, BELOW)
    _copy(strings, START, BEFORE)
    _copy(strings, ABOVE, NOW)
    for m in range(len(slack)):
        fall = strings[START, MARGIN, m] - strings[ABOVE, MARGIN, m]
        strings[CHORDS, 0, m] = strings[START, MARGIN, m] / fall if fall != 0.0 else 0.0
    for m in range(plant.string_count):
        _keep(plant, m, slack[m])
    search.low, search.high, search.at_before, search.at_now = 0.0, part, 0.0, 1.0
    search.trials, search.known, search.tried = 0, part == 1.0, 0


@borrowing
def next_part(table: int, searched: int, h: float) -> float:
    """Choose the part of the step of h [s] to take next; 0 where the last part is the one sought, or none is.

    By cubics of the stretches, or secants of the margins, between a part where none has changed and one where some
    have.
    """
    plant, search = PlantView(table), Search(searched)
    pulled, slack, strings = search.pulled, search.slack, search.strings
    above, below, now, before = strings[ABOVE], strings[BELOW], strings[NOW], strings[BEFORE]
    low, high, at_now, at_before = search.low, search.high, search.at_now, search.at_before
    trial, part = search.trials, high
    if trial or search.known:
        first, within = high, KINK_MOST
        for m in range(len(pulled)):
            if pulled[m] == (above[MARGIN, m] > 0.0):
                continue
            at = 0.5 * (low + high)
            if _by_stretch(plant, search, m):
                d = (high - low) * h
                s0, s1, d0, d1 = below[STRETCH, m], above[STRETCH, m], below[SPEED, m], above[SPEED, m]
                at = low + (high - low) * cubic_root(s0, s1, d * d0, d * d1)
            elif now[STRETCH, m] != 0.0 and before[STRETCH, m] != 0.0:
                secant = at_now - now[MARGIN, m] * (at_now - at_before) / (now[MARGIN, m] - before[MARGIN, m])
                at = secant if low < secant < high else at
            if at < first:
                first, within = at, _within(plant, m, slack[m], at - strings[CHORDS, 0, m])
        if search.tried and at_now == high and high - first <= within:
            return 0.0
        if high - low <= within:
            part = high
        elif trial < SECANTS or trial % 2:
            part = min(first + 0.5 * within, 0.5 * (first + high))
        else:
            part = 0.5 * (low + high)
    if trial >= MOST_TRIALS:
        search.tried = search.tried and at_now == high
        if search.tried or trial > MOST_TRIALS:
            return 0.0
        part = high
    search.trials += 1
    _copy(strings, NOW, BEFORE)
    search.at_before = at_now
    return part


@borrowing
def look_at_trial(table: int, searched: int, part: float, answer: int) -> bool:
    """Take in what a part of the step came to; false where the search ends without an instant.

    `answer`: of the trial; one that failed ends the search.
    """
    search = Search(searched)
    strings = search.strings
    if answer > NO_SOLUTION:
        search.tried = 0
        return False
    _look(PlantView(table), search.levels, strings[NOW])
    search.at_now = part
    if _any_changes(search, NOW):
        search.tried, search.high = 1, part
        _copy(strings, NOW, ABOVE)
    elif part == search.high and part < 1.0 and search.later:  # none has turned back
        search.low, search.high, search.known = part, 1.0, 1
        _copy(strings, NOW, BELOW)
    elif part == search.high:
        search.tried = 0  # no string changes after all
        return False
    else:
        search.low = part
        _copy(strings, NOW, BELOW)
    return True


@borrowing
def end_search(table: int, searched: int) -> float:
    """Let strings change again; the part of the step that the last trial took, 0 for no instant."""
    _let_change(PlantView(table))
    return Search(searched).high if Search(searched).tried else 0.0
