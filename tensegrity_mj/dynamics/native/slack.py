"""When strings begin and cease to pull within a step: what every engine that splits its steps there has in common.

So it is where the tension of a string passes a corner of its curve, at a level of its stretch that takes the place of
zero, and where one that yields turns back: there its rate is the margin, and the level ∞.

A string pulls where its margin min(k s, k s + c ds/dt) > 0, with its stretch s = L - L0: it must be taut, and a damper
must not outweigh it. What is known of the strings at a time is `look`ed up after the engine has set lengths, rates and
rest lengths, in an array (3, M) of margins [N], stretches [m] and their rates [m/s]. Slack strings stay so while the
instant of a change is searched, so that no stage of a trial sees the force that is yet to come. A law at every stage
must be evaluated once more for it in each trial. Strings that it lets go have a margin of 0, which says nothing of when
it will have them pull again: there, the time is halved.

A step, or what is left of one, goes with a `Search`

    look_at_start(table, search)
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

from tensegrity_mj.dynamics.native.curves import corner_between, cubic, curved_pull, turn_of_cubic
from tensegrity_mj.dynamics.native.law import NO_SOLUTION
from tensegrity_mj.dynamics.native.plant_view import CONTINUOUS, PlantView
from tensegrity_mj.dynamics.native.pointers import borrowing, inlined
from tensegrity_mj.dynamics.native.views import Table, view_of

MOST_SPLITS = 4  # of a step; one with more changes is too coarse for any order
MOST_TRIALS = 40  # for one instant
SECANTS = 8  # after so many of them, every other trial halves where the instant may lie
# To what part ε of the step an instant is located: past a kink, a step errs by a part of h² ε, past a jump, of h ε.
# Where a kink lies off the chord between the ends of the step by a part δ of it, δ falls as h does, and the step
# errs by a part of h² δ² all the same: ε is some of δ². A law costs more, and nothing is known of its slopes.
JUMP_WITHIN, LAW_WITHIN = 1e-8, 1e-3
KINK_LEAST, KINK_MOST, KINK_PART = 1e-6, 1e-2, 0.3
HALVINGS = 40  # for the root of a cubic
WHOLE, KEPT_SLACK = 0, 2  # of BROKEN, beside 1: slack as long as an instant is searched
MARGIN, STRETCH, SPEED = 0, 1, 2  # of each string: [N], [m], [m/s]

# What a search keeps of the strings: at the start of the step; after a part in which none has changed and after one in
# which some have; after the last trial, and after the one before. CHORDS is scratch.
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
    known="state",  # whether strings are known to have changed at `high` in a step in which none was kept slack
    tried="state",  # whether they have in one where they were
)


def search_of(count: int) -> Table:
    """A `Search` for so many strings."""
    numbers = dict.fromkeys(("low", "high", "at_now", "at_before", "trials", "known", "tried"), 0)
    marks = np.zeros((2, count), np.bool_)
    strings = np.zeros((CHORDS + 1, 3, count))
    levels = np.zeros(count)
    return _pack_search(strings=strings, pulled=marks[0], slack=marks[1], levels=levels, **numbers)


@borrowing
def _look(plant: Any, levels: Any, out: Any) -> None:
    """Margin, stretch over its level, and rate of each string now (3, M)."""
    stiffness, damping, clipped, broken = plant.stiffness, plant.damping, plant.clipped, plant.broken
    lengths, speeds, rest, curved = plant.lengths, plant.rates, plant.rest, plant.curved
    for m in range(len(rest)):
        stretch = lengths[m] - rest[m]
        if curved:
            stretch -= plant.permanent[m]
        margin = stiffness[m] * stretch
        if curved and stretch > 0.0:
            margin = curved_pull(plant, m, stretch + plant.permanent[m])
        if clipped[m]:
            margin = min(margin, margin + damping[m] * speeds[m])
        out[MARGIN, m] = -1.0 if broken[m] == 1 else margin
        out[STRETCH, m], out[SPEED, m] = stretch, speeds[m]
        if curved and levels[m] != 0.0:
            _over_level(levels[m], m, out)


@borrowing
def _over_level(level: float, m: int, out: Any) -> None:
    """What `_look` says of a string whose stretch has a level."""
    if level == np.inf:
        out[MARGIN, m] = out[SPEED, m]
    else:
        out[STRETCH, m] -= level
        out[MARGIN, m] = out[STRETCH, m]


@borrowing
def _set_levels(plant: Any, search: Any) -> None:
    """Levels of strings that pull at both ends of a step, or at its start, and come past a corner first, or turn."""
    strings, levels, broken = search.strings, search.levels, plant.broken
    start, end = strings[START], strings[ABOVE]
    for m in range(len(levels)):
        s0, s1, shift = start[STRETCH, m], end[STRETCH, m], plant.permanent[m]
        if broken[m] != WHOLE or not search.pulled[m]:
            continue
        corner = corner_between(plant, m, s0 + shift, s1 + shift)
        if corner > 0.0:
            levels[m] = corner - shift
        elif plant.yields[m] and start[SPEED, m] > 0.0 > end[SPEED, m] and s0 + shift >= plant.last_stretch[m, 2]:
            levels[m] = np.inf
        else:
            continue
        _over_level(levels[m], m, start)
        _over_level(levels[m], m, end)
        search.pulled[m] = start[MARGIN, m] > 0.0


@inlined
def _follows_law(plant: Any) -> bool:
    return plant.mode == CONTINUOUS and not plant.suspended


@borrowing
def follows_law(table: int) -> bool:
    """Whether rest lengths follow a law that must be evaluated."""
    return _follows_law(PlantView(table))


@borrowing
def look_at_start(table: int, searched: int) -> None:
    """Note which strings pull at the start of a step, and which are slack."""
    search = Search(searched)
    start, pulled, slack, levels = search.strings[START], search.pulled, search.slack, search.levels
    for m in range(len(levels)):
        levels[m] = 0.0
    _look(PlantView(table), levels, start)
    for m in range(len(pulled)):
        pulled[m], slack[m] = start[MARGIN, m] > 0.0, start[STRETCH, m] <= 0.0


@borrowing
def _any_changes(search: Any, state: int) -> bool:
    """Whether any string pulls that did not, or the reverse."""
    pulled, now, changes = search.pulled, search.strings[state], False
    for m in range(len(pulled)):
        changes |= pulled[m] != (now[MARGIN, m] > 0.0)
    return changes


@borrowing
def look_at_end(table: int, searched: int, h: float) -> float:
    """What to search for in a step of h [s] that was taken whole.

    Returns:
        0 for nothing; 1 where some strings have changed at its end; otherwise the part of the step after which a
        string turns back that was taut, or slack, for a moment within.

    A kink at the very start is none within the step: such a string counts as changed, in `pulled` and `slack`.
    """
    plant, search = PlantView(table), Search(searched)
    _look(plant, search.levels, search.strings[ABOVE])
    if plant.curved and not (_follows_law(plant) or plant.holds_force_density):
        _set_levels(plant, search)
    if _any_changes(search, ABOVE):
        return 1.0 if _matters(plant, search, h) else 0.0
    part = _turn(plant, search, h)
    return 0.0 if part == 1.0 else part


@borrowing
def _cubic_root(s0: float, s1: float, d0: float, d1: float) -> float:
    """Where a cubic between two ends, as in `curves`, changes its sign."""
    low, high = 0.0, 1.0
    for _ in range(HALVINGS):
        x = 0.5 * (low + high)
        if (cubic(x, s0, s1, d0, d1) > 0.0) == (s1 > 0.0):
            high = x
        else:
            low = x
    return 0.5 * (low + high)


@borrowing
def _turn(plant: Any, search: Any, h: float) -> float:
    """The part of a step after which a string turns back that was taut, or slack, for a moment within; 1 for none."""
    broken, start, end, first = plant.broken, search.strings[START], search.strings[ABOVE], 1.0
    if _follows_law(plant) or plant.holds_force_density:
        return first
    for m in range(len(broken)):
        s0, s1, d0, d1 = start[STRETCH, m], end[STRETCH, m], h * start[SPEED, m], h * end[SPEED, m]
        if broken[m] != WHOLE or d0 * d1 >= 0.0 or (s0 > 0.0) != (s1 > 0.0) or (s0 > 0.0) == (d0 > 0.0):
            continue
        x = turn_of_cubic(s0, s1, d0, d1)
        if 0.0 < x < first and (cubic(x, s0, s1, d0, d1) > 0.0) != (s0 > 0.0):
            first = x
    return first


@borrowing
def _matters(plant: Any, search: Any, h: float) -> bool:
    """Whether any change lies far enough from the ends of the step for it to be split there."""
    start, end, pulled, slack = search.strings[START], search.strings[ABOVE], search.pulled, search.slack
    any_matters = False
    for m in range(len(pulled)):
        if pulled[m] == (end[MARGIN, m] > 0.0):
            continue
        if not _by_stretch(plant, search, m):
            any_matters = True
            continue
        at = _cubic_root(start[STRETCH, m], end[STRETCH, m], h * start[SPEED, m], h * end[SPEED, m])
        if _jumps(plant, m, slack[m]) or KINK_LEAST < at < 1.0 - KINK_LEAST:
            any_matters = True
        elif at <= KINK_LEAST:
            pulled[m], slack[m] = not pulled[m], False
    return any_matters


@inlined
def _jumps(plant: Any, m: int, slack: bool) -> bool:
    """Whether the force of a string jumps where it changes: it has a damper, and comes taut."""
    return slack and plant.damping[m] > 0.0


@borrowing
def _within(plant: Any, m: int, slack: bool, off_chord: float) -> float:
    """To what part of a step the instant of a string must be known."""
    if _jumps(plant, m, slack):
        return JUMP_WITHIN
    if _follows_law(plant):
        return LAW_WITHIN
    return min(max(KINK_PART * off_chord * off_chord, KINK_LEAST), KINK_MOST)


@inlined
def _by_stretch(plant: Any, search: Any, m: int) -> bool:
    """Whether a string changes where its stretch does, the rate of which is known."""
    if _follows_law(plant) or plant.holds_force_density:
        return False
    if search.levels[m] != 0.0:
        return search.levels[m] < np.inf
    return search.slack[m] or plant.damping[m] == 0.0


@borrowing
def _copy(strings: Any, source: int, target: int) -> None:
    """Of what a search keeps of the strings."""
    for k in range(3):
        for m in range(strings.shape[2]):
            strings[target, k, m] = strings[source, k, m]


@borrowing
def begin_search(table: int, searched: int, part: float) -> None:
    """Begin to search the first instant at which a string changes: slack strings stay slack, as if they were broken.

    `part`: 1 where some have changed at the end of the step; otherwise a part of it after which some may have.
    """
    search, broken = Search(searched), PlantView(table).broken
    strings, slack = search.strings, search.slack
    _copy(strings, START, BELOW)
    _copy(strings, START, BEFORE)
    _copy(strings, ABOVE, NOW)
    for m in range(len(broken)):
        fall = strings[START, MARGIN, m] - strings[ABOVE, MARGIN, m]
        strings[CHORDS, 0, m] = strings[START, MARGIN, m] / fall if fall != 0.0 else 0.0
        if slack[m] and broken[m] == WHOLE:
            broken[m] = KEPT_SLACK
    search.low, search.high, search.at_before, search.at_now = 0.0, part, 0.0, 1.0
    search.trials, search.known, search.tried = 0, part == 1.0, 0


@borrowing
def next_part(table: int, searched: int, h: float) -> float:
    """What part of the step of h [s] to take next; 0 where the last that was taken is the one sought, or none is.

    By cubics of the stretches, or secants of the margins, between a part where none has changed and one where some
    have.
    """
    plant, search = PlantView(table), Search(searched)
    pulled, slack, strings = search.pulled, search.slack, search.strings
    above, below, now, before = strings[ABOVE], strings[BELOW], strings[NOW], strings[BEFORE]
    low, high, at_now, at_before = search.low, search.high, search.at_now, search.at_before
    trial, part = search.trials, high
    if trial > 0 or search.known:
        first, within = high, KINK_MOST
        for m in range(len(pulled)):
            if pulled[m] == (above[MARGIN, m] > 0.0):
                continue
            at = 0.5 * (low + high)
            if _by_stretch(plant, search, m):
                d = (high - low) * h
                s0, s1, d0, d1 = below[STRETCH, m], above[STRETCH, m], below[SPEED, m], above[SPEED, m]
                at = low + (high - low) * _cubic_root(s0, s1, d * d0, d * d1)
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
    if trial == MOST_TRIALS:
        search.tried = 0
        return 0.0
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
    elif part == search.high:
        search.tried = 0  # no string changes after all
        return False
    else:
        search.low = part
        _copy(strings, NOW, BELOW)
    return True


@borrowing
def end_search(table: int, searched: int) -> float:
    """Strings that were kept slack may pull again; the part of the step that the last trial took, 0 for no instant."""
    search, broken = Search(searched), PlantView(table).broken
    for m in range(len(broken)):
        if broken[m] == KEPT_SLACK:
            broken[m] = WHOLE
    return search.high if search.tried else 0.0
