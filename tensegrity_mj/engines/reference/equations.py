"""What the integrators use of a model: four compiled functions, reached through addresses in the plant's table.

    int64 rates(double t, int64 y, int64 dy, int64 table)   dy/dt; leaves nodes, strings and λ of the state in the table
    int64 place(int64 y, int64 table)                       node positions and velocities of a state, nothing else
    int64 project(int64 y, int64 table)                     puts a state back onto the model's constraints (0: none)
    int64 guard(int64 y, int64 table)                       whether the model can hold a state (0: it always can)

The integers are addresses: of the state y (state_size,), of its derivative, of the plant's table. They return SOLVED,
what the law returned, or SINGULAR. The last three numbers of y are the work integrals of the energy ledger. So one
compiled loop serves every model, and is cached for all of them.

Where elements have states, these are integrated behind all that (`element_states`), and no model has a part in it.
"""

from __future__ import annotations

from typing import Any

from tensegrity_mj.dynamics.native.actuation import break_strings, set_rest_lengths, take_sample
from tensegrity_mj.dynamics.native.compiling import intrinsic, njit
from tensegrity_mj.dynamics.native.curves import yield_strings
from tensegrity_mj.dynamics.native.elements import let_act
from tensegrity_mj.dynamics.native.law import SOLVED
from tensegrity_mj.dynamics.native.plant import write_row
from tensegrity_mj.dynamics.native.plant_view import PlantView
from tensegrity_mj.dynamics.native.pointers import address, call_by_address
from tensegrity_mj.dynamics.native.strings import add_string_forces, measure_strings, tighten_strings
from tensegrity_mj.dynamics.native.views import Fields, changing_view
from tensegrity_mj.engines.driving import STEPPED

# Of a plant whose equations are integrated here; a model's own fields come behind.
MODEL: Fields = (
    *STEPPED,
    ("rates_function", "size"),
    ("place_function", "size"),
    ("project_function", "size"),
    ("guard_function", "size"),
    ("model_rates", "size"),  # where elements have states: `rates_function` of the model alone
    ("state_size", "size"),
    ("multiplier_count", "size"),
    ("multipliers", ("f8", "multiplier_count")),
    ("search", "size"),  # address of a `slack.Search`, 0 where steps are not split
)
ModelView = changing_view("Model", MODEL)

WORK = 3  # work integrals at the end of y: elastic string work ∫ Σ T dL, dissipation, external work
SINGULAR = 4  # beside the law's answers: the model's coordinates cannot hold this state

RATES_SIGNATURE = "int64(float64, int64, int64, int64)"
STATE_SIGNATURE = "int64(int64, int64)"


@intrinsic
def call_rates(typingctx: Any, function: Any, time: Any, y: Any, dy: Any, table: int) -> Any:
    return call_by_address("diii")


@intrinsic
def _call_on_state(typingctx: Any, function: Any, y: Any, table: int) -> Any:
    return call_by_address("ii")


@njit
def rates(t: float, y: Any, dy: Any, table: int) -> int:
    """dy/dt of the model, and its answer."""
    return call_rates(ModelView(table).rates_function, t, address(y), address(dy), table)


@njit
def place(y: Any, table: int) -> int:
    """Place the nodes of a state and measure the strings."""
    status = _call_on_state(ModelView(table).place_function, address(y), table)
    measure_strings(table)
    return status


@njit
def project(y: Any, table: int) -> int:
    """Put a state back onto the model's constraints, where it does so."""
    model = ModelView(table)
    return _call_on_state(model.project_function, address(y), table) if model.project_function else SOLVED


@njit
def guard(y: Any, table: int) -> int:
    """SINGULAR where the model's coordinates cannot hold a state."""
    model = ModelView(table)
    return _call_on_state(model.guard_function, address(y), table) if model.guard_function else SOLVED


@njit
def let_forces_act(t: float, dwork: Any, table: int) -> int:
    """Forces of elements and strings on the nodes at their current places, for the rates of a model.

    Writes into dwork (3,) the powers of elastic tensions, of what is lost, and of what is given from outside but for
    what answers accelerations; returns the law's answer.
    """
    dwork[0] = 0.0
    dwork[2], dwork[1] = let_act(table, t)
    plant = PlantView(table)
    if plant.string_count == 0:
        return SOLVED
    measure_strings(table)
    status = set_rest_lengths(table, t)
    if plant.arrived:
        plant.arrived = 0
        yield_strings(table, t)
    dwork[0], damped = tighten_strings(table)
    dwork[1] += damped
    add_string_forces(table, plant.forces)
    return status


@njit
def observe(y: Any, table: int, row: Any) -> None:
    """Write the state that `rates` saw last as a row, λ behind it."""
    model = ModelView(table)
    work, width, multipliers = model.state_size - WORK, model.row_width, model.multipliers
    write_row(table, y[work], y[work + 1], y[work + 2], row)
    row[width : width + len(multipliers)] = multipliers


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
