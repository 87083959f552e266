"""The law and the winches, compiled: asking, sampling, limits, rest lengths, their work, breaks."""

from __future__ import annotations

from typing import Any

import numpy as np

from tensegrity_mj.dynamics.native.law import FAILED, NO_SOLUTION, NOT_FINITE, SOLVED
from tensegrity_mj.dynamics.native.pointers import (
    borrowing,
    call_law,
    copy,
    floats,
    integers,
)
from tensegrity_mj.dynamics.native.slots import (
    BREAK_TIMES,
    BREAKING,
    BROKEN,
    COMMAND,
    COMPLIANCE,
    CONTINUOUS,
    HELD,
    HOLD_FORCE_DENSITY,
    HOLDS_FORCE_DENSITY,
    LAW,
    LAW_CONTEXT,
    LENGTH,
    LIMITED,
    MAX_FORCE_DENSITY,
    MEMORY,
    MIN_REST_LENGTH,
    MODE,
    NO_LAW,
    NODES,
    REPORT,
    REST,
    RETURNS_LENGTHS,
    SAMPLED_LENGTH,
    STIFFNESS,
    STRING_COUNT,
    SUSPENDED,
    VELOCITIES,
    WINCH,
    WINCH_REACH,
)
from tensegrity_mj.dynamics.native.strings import string_energy


@borrowing
def _limit_command(table: Any) -> None:
    """Keep the command within the largest force densities and the smallest rest lengths of the strings."""
    M = table[STRING_COUNT]
    command, lengths = floats(table[COMMAND], (M,)), floats(table[LENGTH], (M,))
    stiffness, most = floats(table[STIFFNESS], (M,)), floats(table[MAX_FORCE_DENSITY], (M,))
    least = floats(table[MIN_REST_LENGTH], (M,))
    for m in range(M):
        if table[RETURNS_LENGTHS]:
            command[m] = max(command[m], least[m], lengths[m] * (1.0 - most[m] / stiffness[m]))
        else:
            command[m] = min(command[m], most[m], stiffness[m] * (1.0 - least[m] / lengths[m]))


@borrowing
def ask_law(table: Any, t: float) -> int:
    """Evaluate the law at the current nodes into the command; SOLVED, NO_SOLUTION, FAILED or NOT_FINITE."""
    M = table[STRING_COUNT]
    asked = floats(table[COMMAND], (M,))
    for m in range(M):
        asked[m] = np.nan  # what is left unwritten, as where an interrupt kills a law in Python, is no answer
    status = call_law(table[LAW], t, table[NODES], table[VELOCITIES], table[LAW_CONTEXT], table[COMMAND], table[REPORT])
    if status == SOLVED:
        command, finite = floats(table[COMMAND], (M,)), True
        for m in range(M):
            finite &= np.isfinite(command[m])
        if not finite:
            return NOT_FINITE
        if table[LIMITED]:
            _limit_command(table)
    elif status != NO_SOLUTION:
        return FAILED
    return status


@borrowing
def command_as_lengths(table: Any, out: Any) -> None:
    """Write the rest lengths that the command asks for at the current lengths."""
    M = table[STRING_COUNT]
    command = floats(table[COMMAND], (M,))
    if table[RETURNS_LENGTHS]:
        copy(command, out)
    else:
        compliance, lengths = floats(table[COMPLIANCE], (M,)), floats(table[LENGTH], (M,))
        for m in range(M):
            out[m] = lengths[m] * (1.0 - command[m] * compliance[m])


@borrowing
def set_rest_lengths(table: Any, t: float) -> int:
    """Rest lengths at this stage, from the law or from what is held; returns the law's status if it was asked."""
    M = table[STRING_COUNT]
    rest, held = floats(table[REST], (M,)), floats(table[HELD], (M,))
    if table[MODE] == CONTINUOUS and not table[SUSPENDED]:
        status = ask_law(table, t)
        if status == SOLVED:
            command_as_lengths(table, rest)
        else:
            copy(floats(table[MEMORY], (M,)), rest)
        return status
    if table[HOLDS_FORCE_DENSITY]:
        stiffness, lengths = floats(table[STIFFNESS], (M,)), floats(table[LENGTH], (M,))
        for m in range(M):
            rest[m] = lengths[m] * (1.0 - held[m] / stiffness[m])
    elif table[SUSPENDED]:
        copy(floats(table[MEMORY], (M,)), rest)
    else:
        copy(held, rest)
    return SOLVED


@borrowing
def remember(table: Any) -> None:
    """Keep the current rest lengths as the last admissible ones."""
    M = table[STRING_COUNT]
    copy(floats(table[REST], (M,)), floats(table[MEMORY], (M,)))


@borrowing
def start_ledger(table: Any) -> None:
    """Count winch work from here on, at the current lengths and rest lengths."""
    winch = floats(table[WINCH], (3,))
    winch[0], winch[1], winch[2] = 0.0, string_energy(table), 0.0
    M = table[STRING_COUNT]
    copy(floats(table[LENGTH], (M,)), floats(table[SAMPLED_LENGTH], (M,)))


@borrowing
def winch_work(table: Any, stored: float) -> float:
    """-∫ T dL0 up to now [J], T the elastic tension; `stored` is ∫ Σ T dL, integrated beside the state.

    Continuous: by parts, since L0 = L - T/k: -∫ T dL0 = Δ(T²/2k) - ∫ T dL (so the string energy drops out of the
    balance in this mode, which tests the rest of it). Sampled: the energy step at each jump of
    L0, and where the force density u is held, -∫ u L d(L (1 - u/k)) = -u (1 - u/k) Δ(L²)/2 between the jumps.
    """
    winch = floats(table[WINCH], (3,))
    if table[MODE] == NO_LAW:
        return 0.0
    if table[MODE] == CONTINUOUS:
        return string_energy(table) + winch[2] - winch[1] - stored
    total = winch[0]
    if table[HOLDS_FORCE_DENSITY]:
        M = table[STRING_COUNT]
        held, stiffness = floats(table[HELD], (M,)), floats(table[STIFFNESS], (M,))
        lengths, start = floats(table[LENGTH], (M,)), floats(table[SAMPLED_LENGTH], (M,))
        broken = integers(table[BROKEN], (M,))
        for m in range(M):
            if held[m] > 0.0 and not broken[m]:
                square = lengths[m] * lengths[m] - start[m] * start[m]
                total -= 0.5 * held[m] * (1.0 - held[m] / stiffness[m]) * square
    return total


@borrowing
def take_sample(table: Any, t: float) -> int:
    """Sample the law: renew what is held. Where it has no solution, the rest lengths of this moment are held."""
    M = table[STRING_COUNT]
    held, rest = floats(table[HELD], (M,)), floats(table[REST], (M,))
    set_rest_lengths(table, t)  # those in force until now
    work, before = winch_work(table, 0.0), string_energy(table)
    status = ask_law(table, t)
    if status != SOLVED:
        copy(rest, held)
        table[HOLDS_FORCE_DENSITY] = 0
    elif table[MODE] == HOLD_FORCE_DENSITY:
        command = floats(table[COMMAND], (M,))
        stiffness, lengths = floats(table[STIFFNESS], (M,)), floats(table[LENGTH], (M,))
        for m in range(M):
            held[m] = stiffness[m] * (1.0 - command[m] / lengths[m]) if table[RETURNS_LENGTHS] else command[m]
        table[HOLDS_FORCE_DENSITY] = 1
    else:
        command_as_lengths(table, held)
        if table[LIMITED]:
            reach = floats(table[WINCH_REACH], (M,))
            for m in range(M):
                held[m] = min(max(held[m], rest[m] - reach[m]), rest[m] + reach[m])
    set_rest_lengths(table, t)
    floats(table[WINCH], (3,))[0] = work + string_energy(table) - before
    copy(floats(table[LENGTH], (M,)), floats(table[SAMPLED_LENGTH], (M,)))
    return status


@borrowing
def break_strings(table: Any, t: float) -> bool:
    """Break the strings whose time has come; to be called at the start of a step. Their energy is lost."""
    M = table[STRING_COUNT]
    times, broken = floats(table[BREAK_TIMES], (M,)), integers(table[BROKEN], (M,))
    due = False
    for m in range(M):
        # Break times are multiples of fixed steps, up to round-off.
        due |= not broken[m] and times[m] <= t * (1.0 + 1e-12)
    if not due:
        return False
    set_rest_lengths(table, t)
    winch = floats(table[WINCH], (3,))
    work, before = winch_work(table, 0.0), string_energy(table)
    for m in range(M):
        if not broken[m] and times[m] <= t * (1.0 + 1e-12):
            broken[m] = 1
            table[BREAKING] -= 1
    winch[2] += before - string_energy(table)
    if table[MODE] != CONTINUOUS:
        winch[0] = work
        copy(floats(table[LENGTH], (M,)), floats(table[SAMPLED_LENGTH], (M,)))
    return True
