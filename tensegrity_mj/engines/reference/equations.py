"""Interface of models to the integrators: four compiled functions, reached through addresses in the plant's table.

    place           node positions and velocities of a state at a time, nothing else
    accelerate      q̈ into the derivative, for the forces on the nodes; leaves λ in the table
    project         puts a state back onto the model's constraints (0: none)
    guard           whether the model can hold a state (0: it always can)

Each is `int64 f(double t, int64 y, int64 dy, int64 table)`, whose integers are addresses: of the state y, of its
derivative (for `accelerate` alone), of the plant's table. They return SOLVED or SINGULAR, or `OUTSIDE` where no nodes
can be placed. Every model also has `rates`: one such function that places the nodes, lets forces act, and has the model
accelerate. So one compiled loop serves every model, and is cached for all of them.

State y: q and q̇, the time where supports move (so that a state alone says where its nodes are), and the work integrals
of the energy ledger, of which the last counts what moves supports and what answers accelerations, too: `state_size`
numbers. Behind these are the states of elements, in which no model has a part.
"""

from __future__ import annotations

from typing import Any

from tensegrity_mj.dynamics.native.actuation import break_strings, set_rest_lengths, take_sample
from tensegrity_mj.dynamics.native.compiling import c_function, njit
from tensegrity_mj.dynamics.native.curves import yield_strings
from tensegrity_mj.dynamics.native.elements import let_act
from tensegrity_mj.dynamics.native.lanes import one_of
from tensegrity_mj.dynamics.native.law import SOLVED
from tensegrity_mj.dynamics.native.plant import write_row
from tensegrity_mj.dynamics.native.plant_view import PlantView
from tensegrity_mj.dynamics.native.pointers import TIMED, address, borrowing, call_timed, copy, floats, inlined
from tensegrity_mj.dynamics.native.strings import add_string_forces, measure_strings, tighten_strings
from tensegrity_mj.dynamics.native.views import changing_view, fields_of
from tensegrity_mj.dynamics.records import POINT, ROD
from tensegrity_mj.engines.driving import STEPPED

# Of a plant whose equations are integrated here; a model's own fields come behind.
MODEL = fields_of(
    STEPPED,
    rates_function="size",  # of `rates_of_state`
    place_function="size",
    accelerate_function="size",
    project_function="size",
    guard_function="size",
    coordinates="size",
    state_size="size",
    given="each",  # [W] from outside at a stage: models add that of supports and of what answers accelerations
    gravity=("f8", 3),
    kp="real",  # Baumgarte's gains of (3.25), or zero
    kd="real",
    multipliers=("f8", "multiplier_count"),
    search="size",  # address of a `slack.Search`, 0 where steps are not split
)
ModelView = changing_view("Model", MODEL)
RODS = fields_of(  # of one that has rods alone and point masses
    MODEL,
    rods=(ROD, "rod_count"),
    points=(POINT, "point_count"),
)

WORK = 3  # work integrals at the end of y: elastic string work ∫ Σ T dL, dissipation, external work
SINGULAR = 4  # in addition to the law's answers: the model's coordinates cannot hold this state
OUTSIDE = -1  # nor place its nodes


@inlined
def halves(model: Any, y_at: int) -> Any:
    """q and q̇ (nq,) of a state, or q̇ and q̈ of its derivative."""
    nq = model.coordinates
    return floats(y_at, nq), floats(y_at + 8 * nq, nq)


@borrowing
def let_forces_act(t: float, table: int) -> Any:
    """Forces of elements and strings on the nodes at their current places.

    Returns the law's answer, and the powers [W] of elastic tensions, of what is lost, and of what is given from outside
    but for what answers accelerations.
    """
    given, lost = let_act(table, t)
    plant = PlantView(table)
    status, stored, damped = SOLVED, 0.0, 0.0
    if plant.string_count > 0:
        measure_strings(table)
        status = set_rest_lengths(table, t)
        if plant.arrived:
            plant.arrived = 0
            yield_strings(table, t)
        stored, damped = tighten_strings(table)
        add_string_forces(table, plant.forces)
    return status, stored, lost + damped, given


@borrowing
def _rates(t: float, y_at: int, dy_at: int, table: int) -> int:
    model = ModelView(table)
    size, S, states = model.state_size, model.element_state_count, model.element_states
    work = floats(dy_at + 8 * (size - WORK), WORK)
    copy(floats(y_at + 8 * size, S), states[0])
    placed = call_timed(model.place_function, t, y_at, 0, table)
    if placed == OUTSIDE:
        return SINGULAR
    status, work[0], work[1], model.given = let_forces_act(t, table)
    copy(halves(model, y_at)[1], halves(model, dy_at)[0])
    if model.motion_count > 0:
        floats(dy_at + 16 * model.coordinates, 1)[0] = 1.0
    call_timed(model.accelerate_function, t, y_at, dy_at, table)
    work[2] = model.given
    copy(states[1], floats(dy_at + 8 * size, S))
    return max(status, placed)


@c_function(TIMED, "what all equations of motion have in common")
def rates_of_state(t, y_at, dy_at, table):  # type: ignore[no-untyped-def]
    """dy/dt of a state, and the worst answer of law and model."""
    return _rates(t, y_at, dy_at, table)


@njit
def rates(t: float, y: Any, dy: Any, table: int) -> int:
    """dy/dt of the model, and its answer."""
    return call_timed(ModelView(table).rates_function, t, address(y), address(dy), table)


@inlined
def _on_state(function: int, y: Any, table: int) -> int:
    """Call a function of the model on a state, whose time it has where supports move; return its answer."""
    at = one_of(y[2 * ModelView(table).coordinates])
    return call_timed(function, at, address(y), 0, table) if function else SOLVED


@njit
def place(y: Any, table: int) -> int:
    """Place the nodes of a state and measure the strings."""
    status = _on_state(ModelView(table).place_function, y, table)
    measure_strings(table)
    return status


@njit
def project(y: Any, table: int) -> int:
    """Put a state back onto the model's constraints, where it does so."""
    return _on_state(ModelView(table).project_function, y, table)


@njit
def guard(y: Any, table: int) -> int:
    """SINGULAR where the model's coordinates cannot hold a state."""
    return _on_state(ModelView(table).guard_function, y, table)


@njit
def observe(y: Any, table: int, row: Any) -> None:
    """Write the state that `rates` saw last as a row, λ behind it."""
    model = ModelView(table)
    work = model.state_size - WORK
    write_row(table, y[work], y[work + 1], y[work + 2], row)
    copy(model.multipliers, row[model.row_width :])


@njit
def sample_law(t: float, y: Any, table: int) -> int:
    """Sample the law at a state."""
    place(y, table)
    return take_sample(table, t)


@njit
def break_due_strings(t: float, y: Any, table: int) -> bool:
    """Break the strings whose time has come; whether any was there."""
    if PlantView(table).breaking <= 0:
        return False
    place(y, table)
    return break_strings(table, t)
