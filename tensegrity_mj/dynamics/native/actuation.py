"""The law and the winches, compiled: evaluation, sampling, limits, rest lengths, their work, breaks."""

from __future__ import annotations

from typing import Any

import numpy as np

from tensegrity_mj.dynamics.native.curves import curved_energy, curved_pull, spent_since, stretch_of, yield_strings
from tensegrity_mj.dynamics.native.lanes import all_of, alone, any_of, select
from tensegrity_mj.dynamics.native.law import FAILED, NO_SOLUTION, NOT_FINITE, SOLVED
from tensegrity_mj.dynamics.native.plant_view import CONTINUOUS, HOLD_FORCE_DENSITY, NO_LAW, PlantView
from tensegrity_mj.dynamics.native.pointers import address, borrowing, call_law, copy
from tensegrity_mj.dynamics.native.strings import string_energy


@borrowing
def _limit_command(table: int) -> None:
    """Keep the command within the largest force densities and the smallest rest lengths of the strings."""
    plant = PlantView(table)
    command, lengths, stiffness = plant.command, plant.lengths, plant.stiffness
    most, least, returns_lengths = plant.max_force_density, plant.min_rest_length, plant.returns_lengths
    for m in range(len(command)):
        if returns_lengths and plant.curved:
            command[m] = max(max(command[m], least[m]), lengths[m] - stretch_of(plant, m, most[m] * lengths[m]))
        elif returns_lengths:
            command[m] = max(max(command[m], least[m]), lengths[m] * (1.0 - most[m] / stiffness[m]))
        else:
            command[m] = min(min(command[m], most[m]), stiffness[m] * (1.0 - least[m] / lengths[m]))


@borrowing
def evaluate_law(table: int, t: float) -> int:
    """Evaluate the law at the current nodes into the command; SOLVED, NO_SOLUTION, FAILED or NOT_FINITE."""
    plant = PlantView(table)
    command = plant.command
    for m in range(len(command)):
        command[m] = np.nan  # what is left unwritten, as where an interrupt kills a law in Python, is no answer
    nodes, velocities, report = address(plant.nodes), address(plant.velocities), address(plant.report)
    status = call_law(plant.law, t, nodes, velocities, plant.law_context, address(command), report)
    if status == SOLVED:
        finite = True
        for m in range(len(command)):
            finite &= np.isfinite(command[m])
        if not any_of(finite):
            return NOT_FINITE
        if not all_of(finite):
            for m in range(len(command)):
                command[m] = select(finite, command[m], np.nan)
        if plant.limited:
            _limit_command(table)
    elif status != NO_SOLUTION:
        return FAILED
    return status


@alone(None)
def _curved_lengths(plant: Any, densities: Any, out: Any) -> None:
    """Rest lengths of force densities u, by the curves: L - f⁻¹(u L)."""
    lengths = plant.lengths
    for m in range(len(out)):
        out[m] = lengths[m] - stretch_of(plant, m, densities[m] * lengths[m])


@borrowing
def command_as_lengths(table: int, out: Any) -> None:
    """Write the rest lengths of the command at the current lengths."""
    plant = PlantView(table)
    command, compliance, lengths = plant.command, plant.compliance, plant.lengths
    if plant.returns_lengths:
        copy(command, out)
    elif plant.curved:
        _curved_lengths(plant, command, out)
    else:
        for m in range(len(command)):
            out[m] = lengths[m] * (1.0 - command[m] * compliance[m])


@borrowing
def set_rest_lengths(table: int, t: float) -> int:
    """Rest lengths at this stage, from the law or from what is held; returns the law's status if it was evaluated."""
    plant = PlantView(table)
    rest, held = plant.rest, plant.held
    if plant.mode == CONTINUOUS and not plant.suspended:
        status = evaluate_law(table, t)
        if status == SOLVED:
            command_as_lengths(table, rest)
        else:
            copy(plant.memory, rest)
        return status
    if plant.holds_force_density and plant.curved:
        _curved_lengths(plant, held, rest)
    elif plant.holds_force_density:
        stiffness, lengths = plant.stiffness, plant.lengths
        for m in range(len(rest)):
            rest[m] = lengths[m] * (1.0 - held[m] / stiffness[m])
    elif plant.suspended:
        copy(plant.memory, rest)
    else:
        copy(held, rest)
    return SOLVED


@borrowing
def remember(table: int) -> None:
    """Keep the current rest lengths as the last admissible ones."""
    plant = PlantView(table)
    copy(plant.rest, plant.memory)


@borrowing
def start_ledger(table: int) -> None:
    """Count winch work from here on, at the current lengths and rest lengths."""
    plant = PlantView(table)
    winch = plant.winch
    if plant.yielding:
        yield_strings(table, 0.0)
    winch[0], winch[1], winch[2] = 0.0, string_energy(table), 0.0
    copy(plant.lengths, plant.sampled_lengths)


@borrowing
def winch_work(table: int, stored: float) -> float:
    """-∫ T dL0 up to now [J], T the elastic tension; `stored` is ∫ Σ T dL, integrated along with the state.

    Continuous: by parts, since L0 = L - T/k: -∫ T dL0 = Δ(T²/2k) - ∫ T dL (so the string energy drops out of the
    balance in this mode, which tests the rest of it). Sampled: the energy step at each jump of
    L0, and where the force density u is held, -∫ u L d(L (1 - u/k)) = -u (1 - u/k) Δ(L²)/2 between the jumps: by parts
    ΔE - u Δ(L²)/2, as it is of any tension curve.
    """
    plant = PlantView(table)
    winch = plant.winch
    if plant.mode == NO_LAW:
        return 0.0
    spent = spent_since(table) if plant.yielding else 0.0
    if plant.mode == CONTINUOUS:
        return string_energy(table) + (winch[2] + spent) - winch[1] - stored
    return _held_work(plant, winch[0] + spent) if plant.holds_force_density else winch[0]


@alone(0.0)
def _held_work(plant: Any, total: float) -> float:
    """The work so far with that since the last sample, of force densities that are held."""
    held, stiffness, broken = plant.held, plant.stiffness, plant.broken
    lengths, start = plant.lengths, plant.sampled_lengths
    for m in range(len(held)):
        if held[m] > 0.0 and not broken[m]:
            square = lengths[m] * lengths[m] - start[m] * start[m]
            if plant.curved:
                total -= 0.5 * held[m] * square
                for end, sign in ((lengths[m], 1.0), (start[m], -1.0)):
                    total += sign * curved_energy(plant, m, stretch_of(plant, m, held[m] * end))
                continue
            total -= 0.5 * held[m] * (1.0 - held[m] / stiffness[m]) * square
    return total


@alone(SOLVED)
def take_sample(table: int, t: float) -> int:
    """Sample the law: renew what is held. Where it has no solution, the rest lengths of this moment are held."""
    plant = PlantView(table)
    held, rest = plant.held, plant.rest
    set_rest_lengths(table, t)  # those in force until now
    if plant.yielding:
        yield_strings(table, t)
    work, before, spent = winch_work(table, 0.0), string_energy(table), plant.winch[2]
    status = evaluate_law(table, t)
    if status != SOLVED:
        copy(rest, held)
        plant.holds_force_density = 0
    elif plant.mode == HOLD_FORCE_DENSITY:
        command, stiffness, lengths = plant.command, plant.stiffness, plant.lengths
        for m in range(len(held)):
            held[m] = stiffness[m] * (1.0 - command[m] / lengths[m]) if plant.returns_lengths else command[m]
            if plant.curved and plant.returns_lengths:
                held[m] = curved_pull(plant, m, lengths[m] - command[m]) / lengths[m]
        plant.holds_force_density = 1
    else:
        command_as_lengths(table, held)
        if plant.limited:
            reach = plant.winch_reach
            for m in range(len(held)):
                held[m] = min(max(held[m], rest[m] - reach[m]), rest[m] + reach[m])
    set_rest_lengths(table, t)
    if plant.yielding:  # what strings lose by the jump is the winches' work, too
        yield_strings(table, t)
    plant.winch[0] = work + string_energy(table) - before + (plant.winch[2] - spent)
    copy(plant.lengths, plant.sampled_lengths)
    return status


@alone(False)
def break_strings(table: int, t: float) -> bool:
    """Break the strings whose time has come; to be called at the start of a step. Their energy is lost."""
    plant = PlantView(table)
    times, broken, winch = plant.break_times, plant.broken, plant.winch
    due = False
    for m in range(len(broken)):
        # Break times are multiples of fixed steps, up to round-off.
        due |= not broken[m] and times[m] <= t * (1.0 + 1e-12)
    if not due:
        return False
    set_rest_lengths(table, t)
    if plant.yielding:
        yield_strings(table, t)
    work, before = winch_work(table, 0.0), string_energy(table)
    for m in range(len(broken)):
        if not broken[m] and times[m] <= t * (1.0 + 1e-12):
            broken[m] = 1
            plant.breaking -= 1
    winch[2] += before - string_energy(table)
    if plant.mode != CONTINUOUS:
        winch[0] = work
        copy(plant.lengths, plant.sampled_lengths)
    return True
