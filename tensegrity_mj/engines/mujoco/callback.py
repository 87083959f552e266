"""The control callback inside MuJoCo, compiled: law, actuation, elements, work integrals and recording at every stage.

MuJoCo calls it once a stage: four times a step with RK4, once with the other integrators. At the first stage of a
step the state is that of the step's start: there the law is sampled and rows are written. Accelerations and
actuator forces of that state are only known after the callback returns, so they are copied when it is next called.

The callback is process-wide. It finds its run through `ACTIVE`, and does nothing for other MjData. `many` has
the callbacks for many simulations at once and for a law without a run.
"""

from __future__ import annotations

from typing import Any

from tensegrity_mj.dynamics.native.actuation import break_strings, remember, set_rest_lengths, start_ledger, take_sample
from tensegrity_mj.dynamics.native.elements import held_powers, set_motions
from tensegrity_mj.dynamics.native.law import NO_SOLUTION, SOLVED
from tensegrity_mj.dynamics.native.plant import row_width, write_row
from tensegrity_mj.dynamics.native.pointers import borrowing, copy, floats, inlined, integers
from tensegrity_mj.dynamics.native.resolution import resolve_stage, resolve_start
from tensegrity_mj.dynamics.native.slots import (
    ADDED,
    BREAKING,
    BROKEN,
    CLIPPED,
    CONTINUOUS,
    DAMPED,
    DAMPING,
    ELEMENT_COUNT,
    ENGINE_SLOTS,
    FORCES,
    HELD_MASS,
    LENGTH,
    MODE,
    MOTION_COUNT,
    MOVED,
    NODE_COUNT,
    NODES,
    PASSIVE,
    RATE,
    REST,
    STATUS,
    STIFFNESS,
    STRING_COUNT,
    STRING_NODES,
    TENSION,
    VELOCITIES,
)
from tensegrity_mj.dynamics.native.strings import tighten_strings
from tensegrity_mj.dynamics.native.vectors import minus, row_of
from tensegrity_mj.dynamics.native.watch import watch_strings
from tensegrity_mj.engines.mujoco.contact import keep_stage, last_stage_work, spin_energy, state_width, write_state
from tensegrity_mj.engines.mujoco.element_states import act_at_stage
from tensegrity_mj.engines.mujoco.mjcf import UNLIMITED
from tensegrity_mj.engines.mujoco.motion import (
    SUPPORTS_SIZE,
    carried,
    constraint_work,
    drive,
    keep_rates,
    support_power,
)
from tensegrity_mj.engines.mujoco.water import add_mass
from tensegrity_mj.runs.energy import BEYOND

# Addresses of MjData's arrays, and of ours.
(
    SITE_XPOS,
    CVEL,
    SUBTREE_COM,
    XIPOS,
    XFRC,
    QACC,
    ACTUATOR_FORCE,
    CTRL,
    DESIGNED,
    NODE_SITE,
    NODE_BODY,
    NODE_ROOT,
    BODY_COUNT,
    SLIDES,
    COUNTERS,
    WORK_INTEGRALS,
    ROWS,
    ROW_SIZE,
    ROW_COUNT,
    DATA,
    STEP_SIZE,
    STRIDE,
    RATIO,
    TOTAL,
    STAGES,
    ROD_COUNT,
    FORCE_RANGE,
    CONTACT,
    CONTACT_SIZE,
    QPOS,
    QVEL,
    APPLIED,
    CONSTRAINT_FORCE,
    STATE_SIZES,
    SUPPORTS,
    CONSTRAINED,
    PART,  # of a step that is split: address of the time [s] at which the part begins that STEP_SIZE is of
    ANSWERED,  # where rest lengths of this very state are known already: 1 + what the law answered
    POWERS,  # address where the powers of the last stage go whose work was counted
    FLOATING,  # what `add_mass` takes, eleven in a row: of an `AddedMass`, its room, and arrays of MjData
    MASS_ROOM,
    MASS_MATRIX,
    AXES,
    AXIS_RATES,
    TWISTS,
    CENTERS,
    RATES,
    BIAS,
    PASSIVE_FORCES,
    DRIVES,
) = range(ENGINE_SLOTS, ENGINE_SLOTS + 50)

# Counters: calls within the step, steps begun, next row, row waiting for its accelerations, final status.
STAGE, STEP, NEXT_ROW, WAITING, ENDED, END_STEP = range(6)
RUNNING, FINISHED, LOST, LOST_CONTROL = -1, -2, -3, -4


@borrowing
def read_nodes(table: Any) -> bool:
    """Node positions from the sites, node velocities from the bodies' spatial velocities.

    False where a position or a velocity is beyond all reason, or no number.
    """
    N = table[NODE_COUNT]
    nodes, velocities = floats(table[NODES], (N, 3)), floats(table[VELOCITIES], (N, 3))
    sites = integers(table[NODE_SITE], (N,))
    bodies, roots = integers(table[NODE_BODY], (N,)), integers(table[NODE_ROOT], (N,))
    bodies_total = table[BODY_COUNT]
    xpos = floats(table[SITE_XPOS], (N, 3))
    cvel, com = floats(table[CVEL], (bodies_total, 6)), floats(table[SUBTREE_COM], (bodies_total, 3))
    sane = True
    for n in range(N):
        body = bodies[n]
        place = row_of(xpos, sites[n])
        nodes[n, 0], nodes[n, 1], nodes[n, 2] = place
        sane &= _is_sane(place)
        if body == 0:
            continue
        # cvel is (ω, v) at the centre of mass of the kinematic tree.
        x, y, z = minus(place, row_of(com, roots[n]))
        wx, wy, wz = row_of(cvel, body)
        moves = (cvel[body, 3] + wy * z - wz * y, cvel[body, 4] + wz * x - wx * z, cvel[body, 5] + wx * y - wy * x)
        velocities[n, 0], velocities[n, 1], velocities[n, 2] = moves
        sane &= _is_sane(moves)
    return sane


@inlined
def _is_sane(v: Any) -> bool:
    return (abs(v[0]) < BEYOND) & (abs(v[1]) < BEYOND) & (abs(v[2]) < BEYOND)


@borrowing
def apply_loads(table: Any) -> None:
    """Nodal forces of elements as forces and torques at the bodies' centres of mass."""
    N, bodies_total = table[NODE_COUNT], table[BODY_COUNT]
    nodes, forces = floats(table[NODES], (N, 3)), floats(table[FORCES], (N, 3))
    bodies = integers(table[NODE_BODY], (N,))
    centers, xfrc = floats(table[XIPOS], (bodies_total, 3)), floats(table[XFRC], (bodies_total, 6))
    for body in range(bodies_total):
        for k in range(6):
            xfrc[body, k] = 0.0
    for n in range(N):
        body = bodies[n]
        if body == 0:
            continue
        x, y, z = nodes[n, 0] - centers[body, 0], nodes[n, 1] - centers[body, 1], nodes[n, 2] - centers[body, 2]
        fx, fy, fz = forces[n, 0], forces[n, 1], forces[n, 2]
        xfrc[body, 0] += fx
        xfrc[body, 1] += fy
        xfrc[body, 2] += fz
        xfrc[body, 3] += y * fz - z * fy
        xfrc[body, 4] += z * fx - x * fz
        xfrc[body, 5] += x * fy - y * fx


@borrowing
def move_supports(table: Any, t: float, first_stage: bool) -> None:
    """Drive the moved supports as they move at time t."""
    set_motions(table, t)
    if table[STATUS] == 0:
        supports = integers(table[SUPPORTS], (SUPPORTS_SIZE,))
        drive(supports, table[MOVED], table[QPOS], table[QVEL], table[APPLIED], first_stage)


@borrowing
def settle_constraints(table: Any) -> None:
    """Count what constraints did to moved supports over the last stage of a step, before their forces are lost."""
    counters = integers(table[COUNTERS], (6,))
    if counters[ENDED] != RUNNING or counters[STAGE] != 0:
        return
    h = floats(table[STEP_SIZE], (1,))[0]
    set_motions(table, counters[STEP] * h)
    supports, one_stage = integers(table[SUPPORTS], (SUPPORTS_SIZE,)), table[STAGES] == 1
    weight = h if one_stage else h / 6.0
    work = constraint_work(supports, table[MOVED], table[CONSTRAINT_FORCE], weight, one_stage)
    floats(table[WORK_INTEGRALS], (3,))[2] += work


@borrowing
def power_of_supports(table: Any) -> float:
    """See `motion.support_power`."""
    return support_power(
        integers(table[SUPPORTS], (SUPPORTS_SIZE,)),
        table[MOVED],
        table[NODES],
        table[VELOCITIES],
        table[FORCES] if table[ELEMENT_COUNT] else 0,
        table[STRING_NODES],
        table[TENSION],
        table[LENGTH],
    )


@borrowing
def write_coordinates(table: Any, row: Any) -> None:
    """Write qpos and qvel into a row, and the forces of added mass where there are any."""
    sizes = integers(table[STATE_SIZES], (2,))
    copy(floats(table[QPOS], (sizes[0],)), row)
    copy(floats(table[QVEL], (sizes[1],)), row[sizes[0] :])
    if table[ADDED]:
        copy(floats(table[HELD_MASS], (3 * table[NODE_COUNT],)), row[sizes[0] + sizes[1] :])


@borrowing
def set_controls(table: Any) -> bool:
    """Controls from rest lengths, such that neither spring nor damper of a slack string acts; False for one beyond.

    A slack string's control takes its actuator well beyond the limit of zero tension, where MuJoCo gives exactly zero
    and implicit integrators know that no damper is there. Without clipping, only slack strings have that limit.
    """
    M = table[STRING_COUNT]
    rest, designed = floats(table[REST], (M,)), floats(table[DESIGNED], (M,))
    lengths, rates = floats(table[LENGTH], (M,)), floats(table[RATE], (M,))
    stiffness, damping = floats(table[STIFFNESS], (M,)), floats(table[DAMPING], (M,))
    ctrl, force_range = floats(table[CTRL], (M,)), floats(table[FORCE_RANGE], (M, 2))
    broken, damped, clipped = integers(table[BROKEN], (M,)), table[DAMPED], table[CLIPPED]
    sane = True
    for m in range(M):
        L0 = max(rest[m], lengths[m]) if broken[m] else rest[m]
        slack = lengths[m] <= L0
        if slack and (damped or broken[m]):
            L0 += lengths[m] + max(0.0, damping[m] * rates[m] / stiffness[m])
        if not clipped:
            force_range[m, 1] = 0.0 if slack else UNLIMITED
        ctrl[m] = L0 - designed[m]
        sane &= abs(ctrl[m]) < BEYOND
    return sane


@borrowing
def finish_row(table: Any) -> None:
    """Complete the waiting row: MuJoCo's tensions, and the accelerations of the rods' points r along their slides."""
    counters = integers(table[COUNTERS], (6,))
    row_number = counters[WAITING]
    if row_number < 0:
        return
    counters[WAITING] = -1
    N, M, R = table[NODE_COUNT], table[STRING_COUNT], table[ROD_COUNT]
    row = floats(table[ROWS], (table[ROW_COUNT], table[ROW_SIZE]))[row_number]
    force = floats(table[ACTUATOR_FORCE], (M,))
    at = 6 * N + 2 * M
    for m in range(M):
        row[at + m] = 0.0 - force[m]  # not -0
    # For each rod: number of translational coordinates, their first dof, and their axes.
    slides = floats(table[SLIDES], (R, 11))
    width = row_width(table)
    for r in range(R):
        for k in range(3):
            total = 0.0
            for p in range(int(slides[r, 0])):
                total += slides[r, 2 + 3 * k + p] * floats(table[QACC], (int(slides[r, 1]) + 3,))[int(slides[r, 1]) + p]
            row[width + 3 * r + k] = total


@borrowing
def control_stage(table: Any) -> None:
    """Everything that happens at one stage of MuJoCo's integrator."""
    counters = integers(table[COUNTERS], (6,))
    if counters[WAITING] >= 0:
        finish_row(table)
    if counters[ENDED] != RUNNING:
        return
    M = table[STRING_COUNT]
    work = floats(table[WORK_INTEGRALS], (3,))
    h = floats(table[STEP_SIZE], (1,))[0]
    stages, stage, step = table[STAGES], counters[STAGE], counters[STEP]
    contact = integers(table[CONTACT], (table[CONTACT_SIZE],))
    supports = integers(table[SUPPORTS], (SUPPORTS_SIZE,))
    before = h if stages == 1 else h / 6.0 if stage < 2 else h / 3.0  # of the stage whose forces are known now
    if table[CONTACT]:
        work[2] += last_stage_work(contact, before, stages == 1)
    weight = h if stages == 1 else h / 6.0 if stage == 0 or stage == 3 else h / 3.0
    along = 0.0 if stage == 0 else 1.0 if stage == 3 else 0.5  # of the step
    t, begins = (step + along) * h, stage == 0
    if table[PART]:
        t, begins = floats(table[PART], (1,))[0] + along * h, False
    if not read_nodes(table):
        counters[ENDED], counters[END_STEP] = LOST, step
        return
    if stage == 0:
        resolve_start(table, h)
    elif stages == 4:
        resolve_stage(table, stage, h)
    if table[MOTION_COUNT] > 0:
        move_supports(table, t, stage == 0)
        if table[CONSTRAINED]:
            work[2] += constraint_work(supports, table[MOVED], table[CONSTRAINT_FORCE], before, stages == 1)
    given, spent, moving = 0.0, 0.0, 0.0
    if table[ELEMENT_COUNT]:
        if stages == 1 and step > 0:
            # One-stage integrators hold forces over the step: their work counts the speeds at both ends.
            given, spent = held_powers(table)
            work[1] += 0.5 * h * spent
            work[2] += 0.5 * h * given
        given, spent = act_at_stage(table, t, stage, stages, h)
        apply_loads(table)
    status, asked, stored, lost = SOLVED, SOLVED, 0.0, 0.0
    if begins and table[BREAKING] > 0:
        break_strings(table, t)
    if begins and table[RATIO] > 0 and step % table[RATIO] == 0:
        status = take_sample(table, t)
    if M > 0:
        if table[ANSWERED]:
            asked = table[ANSWERED] - 1
            table[ANSWERED] = 0
        else:
            asked = set_rest_lengths(table, t)
        stored, lost = tighten_strings(table)
        if asked <= NO_SOLUTION and status <= NO_SOLUTION and not set_controls(table):
            counters[ENDED], counters[END_STEP] = LOST_CONTROL, step
            return
    if table[ADDED]:
        given += add_mass(table, table[FLOATING : DRIVES + 1])
        apply_loads(table)
    lost += (1.0 if stages == 4 else 0.5) * spent
    if table[MOTION_COUNT] > 0:
        moving = power_of_supports(table)
        if stages == 1 and step > 0:
            work[2] += 0.5 * h * moving
    if begins:
        if step == 0:
            start_ledger(table)
            if table[MOTION_COUNT] > 0:
                work[2] -= carried(supports, table[MOVED], table[VELOCITIES])
        if M > 0:
            sampled = table[RATIO] > 0
            answer = status if sampled else asked
            fresh = step % table[RATIO] == 0 if sampled else table[MODE] == CONTINUOUS
            watch_strings(table, t, fresh and answer == SOLVED)
        if table[RATIO] == 0:
            status = asked
            if status == SOLVED and table[MODE] == CONTINUOUS:
                remember(table)
        stopped = status > NO_SOLUTION or (status == NO_SOLUTION and not table[PASSIVE])
        last = step == table[TOTAL]
        if step % table[STRIDE] == 0 or last or stopped:
            rows = floats(table[ROWS], (table[ROW_COUNT], table[ROW_SIZE]))
            row, external_work = rows[counters[NEXT_ROW]], work[2]
            if table[CONTACT]:
                external_work -= spin_energy(contact)
                end = table[ROWS] + 8 * table[ROW_SIZE] * (counters[NEXT_ROW] + 1)
                write_state(contact, end - 8 * state_width(contact))
            if table[MOTION_COUNT] > 0:
                external_work += carried(supports, table[MOVED], table[VELOCITIES])
            if table[STATE_SIZES]:
                write_coordinates(table, row[row_width(table) + 3 * table[ROD_COUNT] :])
            write_row(table, work[0], work[1], external_work, row)
            counters[WAITING] = counters[NEXT_ROW]
            counters[NEXT_ROW] += 1
        if stopped or last:
            counters[ENDED], counters[END_STEP] = (status if stopped else FINISHED), step
            return
    elif asked > NO_SOLUTION:
        counters[ENDED], counters[END_STEP] = asked, step
        return
    if table[STATUS] != 0:
        counters[ENDED], counters[END_STEP] = table[STATUS], step
        return
    work[0] += weight * stored
    work[1] += weight * lost
    work[2] += (weight if stages == 4 else 0.5 * weight) * (given + moving)
    if table[POWERS]:
        powers = floats(table[POWERS], (3,))
        powers[0], powers[1], powers[2] = stored, lost, given + moving
    if table[CONTACT]:
        keep_stage(contact)
    if table[MOTION_COUNT] > 0 and table[CONSTRAINED]:
        keep_rates(supports, table[MOVED])
    counters[STAGE] += 1
    if counters[STAGE] == stages:
        counters[STAGE] = 0
        counters[STEP] += 1
