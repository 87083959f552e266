"""When strings begin and cease to pull within a step: what every engine that splits its steps there has in common.

A string pulls where its margin min(k s, k s + c ds/dt) > 0, with its stretch s = L - L0: it must be taut, and a damper
must not outweigh it. What is known of the strings at a time is `look`ed up after the engine has set lengths, rates and
rest lengths, in an array (3, M) of margins [N], stretches [m] and their rates [m/s]. Slack strings stay so while the
instant of a change is searched, so that no stage of a trial sees the force that is yet to come. A law at every stage
must be asked once more for it in each trial. Strings that it lets go have a margin of 0, which says nothing of when
it will have them pull again: there, the time is halved.

A search goes, with steps from the same start,

    begin_search(strings, part, search)
    while (part := next_part(table, h, strings, pulled, slack, search)) > 0:
        ... take `part` of the step, and look(table, strings[NOW]) ...
        if not learn(strings, pulled, part, search):
            break

and has found an instant where `next_part` is 0: the end of the last step that was taken with search[TRIED].
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tensegrity_mj.dynamics.native.pointers import borrowing, floats, integers
from tensegrity_mj.dynamics.native.slots import (
    BROKEN,
    CLIPPED,
    CONTINUOUS,
    DAMPING,
    HOLDS_FORCE_DENSITY,
    LENGTH,
    MODE,
    RATE,
    REST,
    STIFFNESS,
    STRING_COUNT,
    SUSPENDED,
)

MOST_SPLITS = 4  # of a step; one with more changes is too coarse for any order
MOST_TRIALS = 40  # for one instant
SECANTS = 8  # after so many of them, every other trial halves where the instant may lie
# To what part ε of the step an instant is located: past a kink, a step errs by a part of h² ε, past a jump, of h ε.
# Where a kink lies off the chord between the ends of the step by a part δ of it, δ falls as h does, and the step
# errs by a part of h² δ² all the same: ε is some of δ². A law costs more to ask, and nothing is known of its slopes.
JUMP_WITHIN, LAW_WITHIN = 1e-8, 1e-3
KINK_LEAST, KINK_MOST, KINK_PART = 1e-6, 1e-2, 0.3
HALVINGS = 40  # for the root of a cubic
WHOLE, KEPT_SLACK = 0, 2  # of BROKEN, beside 1: slack as long as an instant is searched
MARGIN, STRETCH, SPEED = 0, 1, 2  # of each string: [N], [m], [m/s]

# What a search keeps of the strings, (SEARCHED, 3, M): at the start of the step; after a part in which none has changed
# and after one in which some have; after the last trial, and after the one before. CHORDS is scratch.
START, ABOVE, BELOW, NOW, BEFORE, CHORDS = range(6)
SEARCHED = 6
# And of itself: the parts of the step of those; trials so far; whether strings are known to have changed at HIGH in a
# step in which none was kept slack; whether they have in one where they were.
LOW, HIGH, AT_NOW, AT_BEFORE, TRIALS, KNOWN, TRIED = range(7)
SEARCH_SIZE = 7


@borrowing
def look(table: Any, out: Any) -> None:
    """Margin, stretch and rate of each string now (3, M)."""
    M = table[STRING_COUNT]
    stiffness, damping = floats(table[STIFFNESS], (M,)), floats(table[DAMPING], (M,))
    lengths, speeds = floats(table[LENGTH], (M,)), floats(table[RATE], (M,))
    rest, broken = floats(table[REST], (M,)), integers(table[BROKEN], (M,))
    for m in range(M):
        stretch = lengths[m] - rest[m]
        margin = stiffness[m] * stretch
        if table[CLIPPED]:
            margin = min(margin, margin + damping[m] * speeds[m])
        out[MARGIN, m] = -1.0 if broken[m] == 1 else margin
        out[STRETCH, m], out[SPEED, m] = stretch, speeds[m]


@borrowing
def asks(table: Any) -> bool:
    """Whether rest lengths follow a law that must be asked."""
    return table[MODE] == CONTINUOUS and not table[SUSPENDED]


@borrowing
def note(start: Any, pulled: Any, slack: Any) -> None:
    """Which strings pull, and which are slack, by what is known of them (3, M)."""
    for m in range(len(pulled)):
        pulled[m], slack[m] = start[MARGIN, m] > 0.0, start[STRETCH, m] <= 0.0


@borrowing
def keep_slack(table: Any, slack: Any) -> None:
    """Have these strings stay slack, as if they were broken."""
    broken = integers(table[BROKEN], (len(slack),))
    for m in range(len(slack)):
        if slack[m] and broken[m] == WHOLE:
            broken[m] = KEPT_SLACK


@borrowing
def let_go(table: Any) -> None:
    """End what `keep_slack` began."""
    broken = integers(table[BROKEN], (table[STRING_COUNT],))
    for m in range(len(broken)):
        if broken[m] == KEPT_SLACK:
            broken[m] = WHOLE


@borrowing
def any_changes(pulled: Any, now: Any) -> bool:
    """Whether any string pulls now that did not, or the reverse."""
    changes = False
    for m in range(len(pulled)):
        changes |= pulled[m] != (now[MARGIN, m] > 0.0)
    return changes


@borrowing
def first_change(table: Any, strings: Any, pulled: Any, slack: Any, h: float) -> float:
    """What to search for in a step of h [s] that was taken whole, its ends looked at as START and ABOVE.

    Returns:
        0 for nothing; 1 where some strings have changed at its end; otherwise the part of the step after which a
        string turns back that was taut, or slack, for a moment within.

    A kink at the very start is none within the step: such a string counts as changed, in `pulled` and `slack`.
    """
    start, end = strings[START], strings[ABOVE]
    if any_changes(pulled, end):
        return 1.0 if _matters(table, pulled, slack, start, end, h) else 0.0
    part = _turn(table, start, end, h)
    return 0.0 if part == 1.0 else part


@borrowing
def _cubic(x: float, s0: float, s1: float, d0: float, d1: float) -> float:
    """At 0 <= x <= 1, the cubic with values s0 and s1 and derivatives d0 and d1 at 0 and 1."""
    r = 1.0 - x
    return r * r * ((1.0 + 2.0 * x) * s0 + x * d0) + x * x * ((3.0 - 2.0 * x) * s1 - r * d1)


@borrowing
def _cubic_root(s0: float, s1: float, d0: float, d1: float) -> float:
    """Where it changes its sign."""
    low, high = 0.0, 1.0
    for _ in range(HALVINGS):
        x = 0.5 * (low + high)
        if (_cubic(x, s0, s1, d0, d1) > 0.0) == (s1 > 0.0):
            high = x
        else:
            low = x
    return 0.5 * (low + high)


@borrowing
def _turn(table: Any, start: Any, end: Any, h: float) -> float:
    """The part of a step after which a string turns back that was taut, or slack, for a moment within; 1 for none."""
    broken = integers(table[BROKEN], (table[STRING_COUNT],))
    first = 1.0
    if asks(table) or table[HOLDS_FORCE_DENSITY]:
        return first
    for m in range(len(broken)):
        s0, s1, d0, d1 = start[STRETCH, m], end[STRETCH, m], h * start[SPEED, m], h * end[SPEED, m]
        if broken[m] != WHOLE or d0 * d1 >= 0.0 or (s0 > 0.0) != (s1 > 0.0) or (s0 > 0.0) == (d0 > 0.0):
            continue
        # The derivative a x² + b x + d0 of the cubic changes its sign once between 0 and 1.
        a, b = 6.0 * (s0 - s1) + 3.0 * (d0 + d1), -6.0 * (s0 - s1) - 4.0 * d0 - 2.0 * d1
        root = np.sqrt(max(b * b - 4.0 * a * d0, 0.0))
        q = -0.5 * (b + root if b > 0.0 else b - root)
        x = d0 / q if q != 0.0 and 0.0 < d0 / q < 1.0 else q / a
        if 0.0 < x < first and (_cubic(x, s0, s1, d0, d1) > 0.0) != (s0 > 0.0):
            first = x
    return first


@borrowing
def _matters(table: Any, pulled: Any, slack: Any, start: Any, end: Any, h: float) -> bool:
    """Whether any change lies far enough from the ends of the step for it to be split there."""
    any_matters = False
    for m in range(len(pulled)):
        if pulled[m] == (end[MARGIN, m] > 0.0):
            continue
        if not _by_stretch(table, m, slack[m]):
            any_matters = True
            continue
        at = _cubic_root(start[STRETCH, m], end[STRETCH, m], h * start[SPEED, m], h * end[SPEED, m])
        if _jumps(table, m, slack[m]) or KINK_LEAST < at < 1.0 - KINK_LEAST:
            any_matters = True
        elif at <= KINK_LEAST:
            pulled[m], slack[m] = not pulled[m], False
    return any_matters


@borrowing
def _jumps(table: Any, m: int, slack: bool) -> bool:
    """Whether the force of a string jumps where it changes: it has a damper, and comes taut."""
    return slack and floats(table[DAMPING], (m + 1,))[m] > 0.0


@borrowing
def _within(table: Any, m: int, slack: bool, off_chord: float) -> float:
    """To what part of a step the instant of a string must be known."""
    if _jumps(table, m, slack):
        return JUMP_WITHIN
    if asks(table):
        return LAW_WITHIN
    return min(max(KINK_PART * off_chord * off_chord, KINK_LEAST), KINK_MOST)


@borrowing
def _by_stretch(table: Any, m: int, slack: bool) -> bool:
    """Whether a string changes where its stretch does, the rate of which is known."""
    if asks(table) or table[HOLDS_FORCE_DENSITY]:
        return False
    return slack or floats(table[DAMPING], (m + 1,))[m] == 0.0


@borrowing
def _copy(strings: Any, source: int, target: int) -> None:
    """Of what a search keeps of the strings."""
    for k in range(3):
        for m in range(strings.shape[2]):
            strings[target, k, m] = strings[source, k, m]


@borrowing
def begin_search(strings: Any, part: float, search: Any) -> None:
    """Begin to search the first instant at which a string changes, with START and ABOVE of `strings` looked up.

    Args:
        strings: (SEARCHED, 3, M).
        part: 1 where some have changed at the end of the step; otherwise a part of it after which some may have.
        search: (SEARCH_SIZE,) float64.
    """
    _copy(strings, START, BELOW)
    _copy(strings, START, BEFORE)
    _copy(strings, ABOVE, NOW)
    for m in range(strings.shape[2]):
        fall = strings[START, MARGIN, m] - strings[ABOVE, MARGIN, m]
        strings[CHORDS, 0, m] = strings[START, MARGIN, m] / fall if fall != 0.0 else 0.0
    search[LOW], search[HIGH], search[AT_BEFORE], search[AT_NOW] = 0.0, part, 0.0, 1.0
    search[TRIALS], search[KNOWN], search[TRIED] = 0.0, 1.0 if part == 1.0 else 0.0, 0.0


@borrowing
def next_part(table: Any, h: float, strings: Any, pulled: Any, slack: Any, search: Any) -> float:
    """What part of the step of h [s] to take next; 0 where the last that was taken is the one sought, or none is.

    By cubics of the stretches, or secants of the margins, between a part where none has changed and one where some
    have.

    Args:
        pulled, slack: (M,) whether each string pulls at the start, and is slack there.
    """
    low, high = search[LOW], search[HIGH]
    at_now, at_before, trial, part = search[AT_NOW], search[AT_BEFORE], int(search[TRIALS]), search[HIGH]
    above, below, now, before = strings[ABOVE], strings[BELOW], strings[NOW], strings[BEFORE]
    if trial > 0 or search[KNOWN] != 0.0:
        first, within = high, KINK_MOST
        for m in range(len(pulled)):
            if pulled[m] == (above[MARGIN, m] > 0.0):
                continue
            at = 0.5 * (low + high)
            if _by_stretch(table, m, slack[m]):
                d = (high - low) * h
                s0, s1, d0, d1 = below[STRETCH, m], above[STRETCH, m], below[SPEED, m], above[SPEED, m]
                at = low + (high - low) * _cubic_root(s0, s1, d * d0, d * d1)
            elif now[STRETCH, m] != 0.0 and before[STRETCH, m] != 0.0:
                secant = at_now - now[MARGIN, m] * (at_now - at_before) / (now[MARGIN, m] - before[MARGIN, m])
                at = secant if low < secant < high else at
            if at < first:
                first, within = at, _within(table, m, slack[m], at - strings[CHORDS, 0, m])
        if search[TRIED] != 0.0 and at_now == high and high - first <= within:
            return 0.0
        if high - low <= within:
            part = high
        elif trial < SECANTS or trial % 2:
            part = min(first + 0.5 * within, 0.5 * (first + high))
        else:
            part = 0.5 * (low + high)
    if trial == MOST_TRIALS:
        search[TRIED] = 0.0
        return 0.0
    search[TRIALS] += 1.0
    _copy(strings, NOW, BEFORE)
    search[AT_BEFORE] = at_now
    return part


@borrowing
def learn(strings: Any, pulled: Any, part: float, search: Any) -> bool:
    """Take in what was seen after a part of the step; false where no string changes after all."""
    search[AT_NOW] = part
    if any_changes(pulled, strings[NOW]):
        search[TRIED], search[HIGH] = 1.0, part
        _copy(strings, NOW, ABOVE)
    elif part == search[HIGH]:
        search[TRIED] = 0.0
        return False
    else:
        search[LOW] = part
        _copy(strings, NOW, BELOW)
    return True
