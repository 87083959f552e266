"""The control callback inside MuJoCo, compiled: law, actuation, elements, work integrals and recording at every stage.

MuJoCo calls it once a stage: four times a step with RK4, once with the other integrators. At the first stage of a
step the state is that of the step's start: there the law is sampled and rows are written. Accelerations and
actuator forces of that state are only known after the callback returns, so they are copied when it is next called.

The callback is process-wide. It finds its run through `ACTIVE`, and does nothing for other MjData. `many` has
the callbacks for many simulations at once and for a law without a run.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from tensegrity_mj.dynamics.native.actuation import break_strings, remember, set_rest_lengths, start_ledger, take_sample
from tensegrity_mj.dynamics.native.curves import yield_strings
from tensegrity_mj.dynamics.native.elements import clear, held_powers, let_act, set_motions
from tensegrity_mj.dynamics.native.law import NO_SOLUTION, SOLVED
from tensegrity_mj.dynamics.native.plant import write_row
from tensegrity_mj.dynamics.native.plant_view import CONTINUOUS
from tensegrity_mj.dynamics.native.pointers import address, borrowing, copy, floats, inlined
from tensegrity_mj.dynamics.native.resolution import resolve_stage, resolve_start
from tensegrity_mj.dynamics.native.strings import is_slack, measure_segments, rest_moves, tighten_strings
from tensegrity_mj.dynamics.native.vectors import cross, minus, put, row_of
from tensegrity_mj.dynamics.native.watch import watch_strings
from tensegrity_mj.engines.mujoco.contact import spin_energy, write_state
from tensegrity_mj.engines.mujoco.implicit_forces import add_implicit_forces
from tensegrity_mj.engines.mujoco.mjcf import UNLIMITED
from tensegrity_mj.engines.mujoco.motion import carried, count_constraints, drive, note_rates, support_power
from tensegrity_mj.engines.mujoco.run_view import FINISHED, LOST, LOST_CONTROL, RUNNING, Counters, RunView
from tensegrity_mj.runs.energy import BEYOND

SEEN, RATES, WHOLE, SUM = range(4)  # rows of the states of elements: see `plant_view`


class Moment(NamedTuple):
    """A stage of a step.

    Attributes:
        time: [s].
        step, stage: their numbers.
        begins: whether it is the start of a whole step: the law is sampled, and rows are written.
        one_stage: whether the integrator has no other.
        h: the step [s].
        weight, before: in the step's integral, of this stage and of the one whose forces are known now [s].
    """

    time: float
    step: int
    stage: int
    begins: bool
    one_stage: bool
    h: float
    weight: float
    before: float


@inlined
def _moment(run: Any, counters: Any) -> Moment:
    h, one_stage, stage, step = run.step, run.stages == 1, counters.stage, counters.step
    before = h if one_stage else h / 6.0 if stage < 2 else h / 3.0
    weight = h if one_stage else h / 6.0 if stage == 0 or stage == 3 else h / 3.0
    along = 0.0 if stage == 0 else 1.0 if stage == 3 else 0.5  # of the step
    t, begins = (step + along) * h, stage == 0
    if run.part:
        t, begins = run.begins + along * h, False
    return Moment(t, step, stage, begins, one_stage, h, weight, before)


@borrowing
def control_stage(table: int) -> None:
    """Do everything that happens at one stage of MuJoCo's integrator."""
    run = RunView(table)
    counters = Counters(address(run.counters))
    finish_row(table)
    if counters.ended != RUNNING:
        return
    now = _moment(run, counters)
    ended = _stage(table, now)
    if ended != RUNNING:
        counters.ended, counters.end_step = ended, now.step
        return
    counters.stage += 1
    if counters.stage == run.stages:
        counters.stage = 0
        counters.step += 1


@borrowing
def _stage(table: int, now: Moment) -> int:
    """Do all that a stage has to do, in order; return how the run has ended, or RUNNING."""
    run = RunView(table)
    if not read_nodes(table):
        return LOST
    _resolve(table, now)
    _move_supports(table, now)
    given, spent = _let_elements_act(table, now)
    sampled = _begin_strings(table, now)
    answer, stored, lost = _set_strings(table, now)
    if answer <= NO_SOLUTION and sampled <= NO_SOLUTION and not set_controls(table):
        return LOST_CONTROL
    if run.implicit != 0:
        given += add_implicit_forces(table, 0.0 if now.stage > 0 else now.h if now.begins and run.resets else -1.0)
        apply_loads(table)
    given += _support_power(table, now)
    lost += (0.5 if now.one_stage else 1.0) * spent
    if now.begins:
        ended = _account_step(table, now, sampled, answer)
        if ended != RUNNING:
            return ended
    elif answer > NO_SOLUTION:
        return answer
    if run.status != 0:
        return run.status
    _count(table, now, stored, lost, given)
    return RUNNING


@borrowing
def finish_row(table: int) -> None:
    """Complete the waiting row: MuJoCo's tensions, and the accelerations of the rods' points r along their slides."""
    run = RunView(table)
    counters = Counters(address(run.counters))
    if counters.waiting < 0:
        return
    row, force, slides, acceleration = run.rows[counters.waiting], run.actuator_force, run.slides, run.qacc
    counters.waiting = -1
    at, width = 6 * run.node_count + 2 * run.string_count, run.row_width
    for m in range(len(force)):
        row[at + m] = 0.0 - force[m]  # not -0
    for r in range(len(slides)):
        for k in range(3):
            total = 0.0
            for p in range(int(slides[r, 0])):
                total += slides[r, 2 + 3 * k + p] * acceleration[int(slides[r, 1]) + p]
            row[width + 3 * r + k] = total


@borrowing
def read_nodes(table: int) -> bool:
    """Node positions from the sites, node velocities from the bodies' spatial velocities.

    False where a position or a velocity is beyond all reason, or no number.
    """
    run = RunView(table)
    nodes, velocities, xpos, cvel, com = run.nodes, run.velocities, run.site_xpos, run.cvel, run.subtree_com
    sites, bodies, roots = run.node_sites, run.node_bodies, run.node_roots
    sane = True
    for n in range(len(nodes)):
        body = bodies[n]
        place = row_of(xpos, sites[n])
        put(nodes, n, place)
        sane &= _is_sane(place)
        if body == 0:
            continue
        # cvel is (ω, v) at the centre of mass of the kinematic tree.
        x, y, z = minus(place, row_of(com, roots[n]))
        wx, wy, wz = row_of(cvel, body)
        moves = (cvel[body, 3] + wy * z - wz * y, cvel[body, 4] + wz * x - wx * z, cvel[body, 5] + wx * y - wy * x)
        put(velocities, n, moves)
        sane &= _is_sane(moves)
    return sane


@inlined
def _is_sane(v: Any) -> bool:
    return (abs(v[0]) < BEYOND) & (abs(v[1]) < BEYOND) & (abs(v[2]) < BEYOND)


@inlined
def _resolve(table: int, now: Moment) -> None:
    if now.stage == 0:
        resolve_start(table, now.h)
    elif not now.one_stage:
        resolve_stage(table, now.stage, now.h)


@inlined
def _move_supports(table: int, now: Moment) -> None:
    """Move the supports to where they are at a stage; count the work of constraints over the stage before."""
    run = RunView(table)
    if run.motion_count > 0:
        set_motions(table, now.time)
    if run.constrained:
        count_constraints(run, now.before, now.one_stage)
    if run.motion_count > 0 and run.status == 0:
        drive(run, now.stage == 0)


@borrowing
def settle(table: int) -> None:
    """Complete the row and the work of constraints, which are lost once another simulation uses the same MjData."""
    finish_row(table)
    run = RunView(table)
    counters = Counters(address(run.counters))
    if counters.ended != RUNNING or counters.stage != 0:
        return
    if run.constrained:
        if run.motion_count > 0:
            set_motions(table, counters.step * run.step)
        one_stage = run.stages == 1
        count_constraints(run, run.step if one_stage else run.step / 6.0, one_stage)


@borrowing
def _support_power(table: int, now: Moment) -> float:
    """Power [W] of what moves the supports; with one stage, work counts the speeds at both ends of a step."""
    run = RunView(table)
    if run.motion_count == 0:
        return 0.0
    measure_segments(table)
    power = support_power(run)
    if now.one_stage and now.step > 0:
        run.work[2] += 0.5 * now.h * power
    return power


@borrowing
def _let_elements_act(table: int, now: Moment) -> tuple[float, float]:
    """Forces of elements on the bodies; the powers that are given and lost [W]."""
    run = RunView(table)
    if run.element_count == 0 and run.implicit == 0:
        return 0.0, 0.0
    if now.one_stage and now.step > 0:
        # One-stage integrators hold forces over the step: their work counts the speeds at both ends.
        given, spent = held_powers(table)
        run.work[1] += 0.5 * now.h * spent
        run.work[2] += 0.5 * now.h * given
    given, spent = _act_at_stage(table, now.time, now.stage, run.stages, now.h)
    apply_loads(table)
    return given, spent


@borrowing
def _act_at_stage(table: int, t: float, stage: int, stages: int, h: float) -> Any:
    """`let_act` at a stage of a step of h [s], with the elements' states of the stage.

    They are integrated with the weights of MuJoCo's integrator, and become those of a whole step with its last stage.
    Where trial steps are taken back (`LocatedRun`), so are they.
    """
    run = RunView(table)
    S, states = run.element_state_count, run.element_states
    if S == 0:
        return let_act(table, t)
    ahead = 0.0 if stage == 0 else h if stage == 3 else 0.5 * h
    for k in range(S):
        states[SEEN, k] = states[WHOLE, k] + ahead * states[RATES, k]
    powers = let_act(table, t)
    weight = 1.0 if stage == 0 or stage == 3 else 2.0
    for k in range(S):
        states[SUM, k] = weight * states[RATES, k] + (0.0 if stage == 0 else states[SUM, k])
        if stage == stages - 1:
            states[WHOLE, k] += h * states[SUM, k] / (1.0 if stages == 1 else 6.0)
    return powers


@borrowing
def apply_loads(table: int) -> None:
    """Nodal forces of elements as forces and torques at the bodies' centres of mass."""
    run = RunView(table)
    nodes, forces, bodies, centers, xfrc = run.nodes, run.forces, run.node_bodies, run.xipos, run.xfrc_applied
    clear(xfrc)
    for n in range(len(nodes)):
        body = bodies[n]
        if body == 0:
            continue
        force = row_of(forces, n)
        torque = cross(minus(row_of(nodes, n), row_of(centers, body)), force)
        for k in range(3):
            xfrc[body, k] += force[k]
            xfrc[body, 3 + k] += torque[k]


@inlined
def _begin_strings(table: int, now: Moment) -> int:
    """Break strings and sample the law at the start of a step; return the law's answer."""
    run = RunView(table)
    if now.begins and run.breaking > 0:
        break_strings(table, now.time)
    if now.begins and run.ratio > 0 and now.step % run.ratio == 0:
        return take_sample(table, now.time)
    return SOLVED


@inlined
def _set_strings(table: int, now: Moment) -> tuple[int, float, float]:
    """Rest lengths and tensions; the law's answer, and the powers of elastic tensions and of dampers [W]."""
    run = RunView(table)
    if run.string_count == 0:
        return SOLVED, 0.0, 0.0
    if run.answered:
        answer = run.answered - 1
        run.answered = 0
    else:
        answer = set_rest_lengths(table, now.time)
    if run.yielding and now.stage == 0:
        yield_strings(table, now.time)
    stored, lost = tighten_strings(table)
    return answer, stored, lost


@borrowing
def _curved_control(run: Any, m: int, slack: bool) -> float:
    """Control of a string where some have curves: by its tension, and well beyond zero tension where it is slack."""
    k, length, damper = run.stiffness[m], run.lengths[m], run.damping[m] * run.rates[m]
    if k == 0.0:  # [N] off its pull, of which a broken one has nothing
        return run.pieces[run.piece_ranges[m, 0], 1] + abs(damper) if slack else 0.0
    if slack:
        return max(run.rest[m], length) + length + max(0.0, damper / k) - run.designed[m]
    return length - run.elastic[m] / k - run.designed[m]


@borrowing
def set_controls(table: int) -> bool:
    """Set controls such that neither spring nor damper of a slack string acts; False for one beyond.

    They follow from rest lengths, and where strings have curves from tensions: the rest length L - T/k has the same.

    A slack string's control takes its actuator well beyond the limit of zero tension, where MuJoCo gives exactly zero
    and implicit integrators know that no damper is there. Without clipping, only slack strings have that limit.
    """
    run = RunView(table)
    rest, designed, lengths, rates = run.rest, run.designed, run.lengths, run.rates
    stiffness, damping, ctrl, force_range = run.stiffness, run.damping, run.ctrl, run.force_range
    broken, damped, clipped, curved, moves = run.broken, run.damped, run.clipped, run.curved, rest_moves(run)
    sane = True
    for m in range(len(ctrl)):
        slack = is_slack(run, m, moves)
        if curved:
            ctrl[m] = _curved_control(run, m, slack)
        else:
            L0 = rest[m]
            if slack and (damped or broken[m]):
                L0 = max(L0, lengths[m]) + lengths[m] + max(0.0, damping[m] * rates[m] / stiffness[m])
            ctrl[m] = L0 - designed[m]
        if not clipped[m]:
            force_range[m, 1] = 0.0 if slack else UNLIMITED
        sane &= abs(ctrl[m]) < BEYOND
    return sane


@borrowing
def _account_step(table: int, now: Moment, sampled: int, answer: int) -> int:
    """Start the ledger, watch the strings and record a row at the start of a step, by what the law answered.

    Returns how the run has ended, or RUNNING.
    """
    run = RunView(table)
    if now.step == 0:
        start_ledger(table)
        if run.motion_count > 0:
            run.work[2] -= carried(run)
    status = sampled if run.ratio > 0 else answer
    if run.string_count > 0:
        fresh = now.step % run.ratio == 0 if run.ratio > 0 else run.mode == CONTINUOUS
        watch_strings(table, now.time, fresh and status == SOLVED)
    if run.ratio == 0 and status == SOLVED and run.mode == CONTINUOUS:
        remember(table)
    stopped = status > NO_SOLUTION or (status == NO_SOLUTION and not run.passive)
    last = now.step == run.total
    if (now.step - run.first_step) % run.stride == 0 or last or stopped:
        _record(table)
    return status if stopped else FINISHED if last else RUNNING


@borrowing
def _record(table: int) -> None:
    """Write a row, which waits for its accelerations."""
    run = RunView(table)
    counters, work = Counters(address(run.counters)), run.work
    row, external_work = run.rows[counters.next_row], work[2]
    if run.touches:
        external_work -= spin_energy(run)
        write_state(run, row)
    if run.motion_count > 0:
        external_work += carried(run)
    if run.writes_state:
        at = run.row_width + 3 * run.rod_count
        copy(run.qpos, row[at:])
        copy(run.qvel, row[at + run.nq :])
        if run.implicit != 0:
            copy(floats(address(run.held_mass), 3 * run.node_count), row[at + run.nq + run.nv :])
    if run.implicit != 0:
        forces = floats(run.implicit_room, run.constraint_count)
        copy(forces, row[len(row) - len(forces) :])
    write_row(table, work[0], work[1], external_work, row)
    counters.waiting = counters.next_row
    counters.next_row += 1


@borrowing
def _count(table: int, now: Moment, stored: float, lost: float, given: float) -> None:
    """Count the work of a stage's powers [W], and keep what is needed once its other forces are known."""
    run = RunView(table)
    work, powers = run.work, run.powers
    work[0] += now.weight * stored
    work[1] += now.weight * lost
    work[2] += (0.5 * now.weight if now.one_stage else now.weight) * given
    powers[0], powers[1], powers[2] = stored, lost, given
    if run.constrained:
        note_rates(run)
