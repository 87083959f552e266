"""The control callbacks for many simulations on many threads, and for a law without a run.

Where `callback` finds the one run by the address of its MjData, here an MjData serves many simulations in turn
(`mujoco.batch`, `mujoco.rollout`). Two ways to tell what to do:

many runs      each simulation has a table of its own, as a single run has, and its number in MjData.userdata; the
               table is told where this MjData has its arrays before each stage.
a law alone    nothing is kept from stage to stage: a copy of one table, with scratch of its own, lies on the stack.

Both leave any other model alone, by the signature and the sizes of mjModel. These tell what a model is built of, not
its numbers; so a law alone also compares the strings, whose stiffness and rest lengths turn its answers into controls.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from tensegrity_mj.dynamics.native.actuation import ask_law, command_as_lengths
from tensegrity_mj.dynamics.native.compiling import c_function
from tensegrity_mj.dynamics.native.elements import lend_room, let_act, room_of_elements
from tensegrity_mj.dynamics.native.law import FAILED, SOLVED
from tensegrity_mj.dynamics.native.pointers import (
    STACK_LIMIT,
    address_of,
    borrowing,
    copy,
    floats,
    inlined,
    integers,
    owning,
    stack_doubles,
)
from tensegrity_mj.dynamics.native.slots import (
    ADDED,
    COMMAND,
    ELASTIC,
    ELEMENT_COUNT,
    FORCES,
    LENGTH,
    MOTION_COUNT,
    MOVED,
    NODE_COUNT,
    NODES,
    RATE,
    REPORT,
    REPORT_SIZE,
    REST,
    STATUS,
    STRING_COUNT,
    TABLE_SIZE,
    TENSION,
    VELOCITIES,
)
from tensegrity_mj.dynamics.native.strings import tighten_strings
from tensegrity_mj.engines.mujoco import callback
from tensegrity_mj.engines.mujoco.callback import (
    DRIVES,
    FLOATING,
    FORCE_RANGE,
    MASS_ROOM,
    apply_loads,
    control_stage,
    move_supports,
    read_nodes,
    set_controls,
)
from tensegrity_mj.engines.mujoco.install import CALLBACK, active_table
from tensegrity_mj.engines.mujoco.layout import check_layout, offset
from tensegrity_mj.engines.mujoco.water import add_mass, room_of_mass
from tensegrity_mj.model.scene import Scene

# Which slot of a run's table holds the address of which array of MjData.
_ARRAYS = {
    callback.SITE_XPOS: "site_xpos",
    callback.CVEL: "cvel",
    callback.SUBTREE_COM: "subtree_com",
    callback.XIPOS: "xipos",
    callback.XFRC: "xfrc_applied",
    callback.QACC: "qacc",
    callback.ACTUATOR_FORCE: "actuator_force",
    callback.CTRL: "ctrl",
    callback.QPOS: "qpos",
    callback.QVEL: "qvel",
    callback.APPLIED: "qfrc_applied",
    callback.CONSTRAINT_FORCE: "qfrc_constraint",
    callback.MASS_MATRIX: "M",
    callback.AXES: "cdof",
    callback.AXIS_RATES: "cdof_dot",
    callback.TWISTS: "cvel",
    callback.CENTERS: "subtree_com",
    callback.RATES: "qvel",
    callback.BIAS: "qfrc_bias",
    callback.PASSIVE_FORCES: "qfrc_passive",
    callback.DRIVES: "qfrc_applied",
    LENGTH: "ten_length",
    RATE: "ten_velocity",
}

USERDATA_SIZE = 2  # of a model whose simulations have runs: a token, and the number of the simulation

# Slots of the table that `ACTIVE` leads to: how a model is told, the fields to bind, and the tables of the runs.
(
    SIGNATURE,
    SIGNATURE_AT,
    STRINGS,
    STRINGS_AT,
    SITES,
    SITES_AT,
    BODIES,
    BODIES_AT,
    USERDATA,
    USERDATA_SIZE_AT,
    FIELDS,
    FIELD_COUNT,
    TIME_AT,
    USERDATA_AT,
    TOKEN,
    RUNS,
    RUN_COUNT,
    LAW_TABLE,
    ANSWERS,
    SPRINGS,
    GAINS_AT,
    BIASES_AT,
    ENDS,
    ENDS_AT,
) = range(24)
GUIDE_SIZE = 24
PARAMETERS = 10  # numbers that mjModel has for the gain and for the bias of each actuator
OTHER_STRINGS, ANSWER_COUNT = 4, 5  # places of the answers, after those of a law's status


@inlined
def _at(address: int, offset: int) -> int:
    """The integer, or the pointer, at an address and an offset."""
    return integers(address + offset, 1)[0]


@inlined
def _is_ours(guide: Any, model: int) -> bool:
    """Whether a model is the one that the tables were made for."""
    return (
        _at(model, guide[SIGNATURE_AT]) == guide[SIGNATURE]
        and _at(model, guide[STRINGS_AT]) == guide[STRINGS]
        and _at(model, guide[SITES_AT]) == guide[SITES]
        and _at(model, guide[BODIES_AT]) == guide[BODIES]
        and _at(model, guide[USERDATA_SIZE_AT]) == guide[USERDATA]
    )


@borrowing
def _has_our_strings(guide: Any, model: int) -> bool:
    """Whether the strings of a model tie the same sites in the same order, with the same springs and dampers."""
    M = guide[STRINGS]
    springs, ends = floats(guide[SPRINGS], (M, 4)), integers(guide[ENDS], (M,))
    gains = floats(_at(model, guide[GAINS_AT]), (M, PARAMETERS))
    biases = floats(_at(model, guide[BIASES_AT]), (M, PARAMETERS))
    found = integers(_at(model, guide[ENDS_AT]), (M,))
    same = True
    for m in range(M):
        same &= gains[m, 0] == springs[m, 0] and ends[m] == found[m]
        for k in range(3):
            same &= biases[m, k] == springs[m, 1 + k]
    return same


@inlined
def _bind(guide: Any, table: Any, data: int) -> None:
    """Tell a table where an MjData has its arrays."""
    fields = integers(guide[FIELDS], (guide[FIELD_COUNT], 2))
    for n in range(len(fields)):
        table[fields[n, 0]] = _at(data, fields[n, 1])


@borrowing
def stage_of_many(guide: Any, model: int, data: int) -> None:
    """A stage of the simulation whose number is in the MjData's userdata."""
    if not _is_ours(guide, model):
        return
    own = floats(_at(data, guide[USERDATA_AT]), (USERDATA_SIZE,))
    number = int(own[1])
    if own[0] != floats(guide[TOKEN], 1)[0] or number < 0 or number >= guide[RUN_COUNT]:
        return
    table = integers(integers(guide[RUNS], guide[RUN_COUNT])[number], (TABLE_SIZE,))
    _bind(guide, table, data)
    control_stage(table)


@borrowing
def _command(guide: Any, data: int, room: int) -> int:
    """Set the controls of an MjData from the law at its state; `room` is scratch of `law_room` numbers."""
    own = integers(guide[LAW_TABLE], (TABLE_SIZE,))
    table = integers(room, (TABLE_SIZE,))
    copy(own, table)
    N, M = table[NODE_COUNT], table[STRING_COUNT]
    at = room + 8 * TABLE_SIZE
    # Velocities of fixed nodes stay zero.
    for n in range(9 * N):
        floats(at, (9 * N,))[n] = 0.0
    table[NODES], table[VELOCITIES], table[FORCES] = at, at + 24 * N, at + 48 * N
    at += 72 * N
    table[COMMAND], table[REST], table[FORCE_RANGE] = at, at + 8 * M, at + 16 * M
    table[REPORT] = at + 32 * M
    table[TENSION], table[ELASTIC] = table[REPORT] + 8 * REPORT_SIZE, table[REPORT] + 8 * (REPORT_SIZE + M)
    table[MOVED] = table[ELASTIC] + 8 * M
    at = table[MOVED] + 72 * table[MOTION_COUNT]
    table[MASS_ROOM] = at
    lend_room(table, at + 8 * room_of_mass(table[FLOATING]))
    _bind(guide, table, data)
    t = floats(data + guide[TIME_AT], 1)[0]
    if not read_nodes(table):
        return SOLVED  # MuJoCo itself warns of such states
    if table[MOTION_COUNT] > 0:
        move_supports(table, t, False)
        if table[STATUS] != 0:
            return FAILED
    if table[ELEMENT_COUNT]:
        let_act(table, t)
        if table[STATUS] != 0:
            return FAILED
        apply_loads(table)
    status = SOLVED
    if M > 0:
        status = ask_law(table, t)
        if status == SOLVED:
            command_as_lengths(table, floats(table[REST], (M,)))
            tighten_strings(table)
            set_controls(table)
    if table[ADDED] and status == SOLVED:
        add_mass(table, table[FLOATING : DRIVES + 1])
        apply_loads(table)
    return status


@inlined
def law_room(table: Any) -> int:
    """Numbers of scratch that `_command` needs."""
    N, M = table[NODE_COUNT], table[STRING_COUNT]
    own = TABLE_SIZE + 9 * N + 6 * M + REPORT_SIZE + 9 * table[MOTION_COUNT]
    return own + room_of_mass(table[FLOATING]) + room_of_elements(table)


@owning
def stage_of_a_law(guide: Any, model: int, data: int) -> None:
    """A stage under a law alone. Where the law has no answer the controls stay, and the answer is marked."""
    if not _is_ours(guide, model):
        return
    if not _has_our_strings(guide, model):
        integers(guide[ANSWERS], (ANSWER_COUNT,))[OTHER_STRINGS] = 1
        return
    own = integers(guide[LAW_TABLE], (TABLE_SIZE,))
    size = law_room(own)
    if size <= STACK_LIMIT:
        status = _command(guide, data, stack_doubles(size))
    else:
        heap = np.empty(size)
        status = _command(guide, data, heap.ctypes.data)
        heap[0] = 0.0  # alive until here
    if status != SOLVED:
        integers(guide[ANSWERS], (ANSWER_COUNT,))[status] = 1  # threads only ever write the same


@c_function(CALLBACK, "the callback of many simulations in MuJoCo")
def many_runs(model, data):  # type: ignore[no-untyped-def]
    """The callback for many runs."""
    address = active_table()
    if address != 0:
        stage_of_many(integers(address, (GUIDE_SIZE,)), model, data)


@c_function(CALLBACK, "the callback of a law in MuJoCo's own loops")
def law_alone(model, data):  # type: ignore[no-untyped-def]
    """The callback for a law without a run."""
    address = active_table()
    if address != 0:
        stage_of_a_law(integers(address, (GUIDE_SIZE,)), model, data)


class Guide:
    """The table by which the callbacks find their way in a model, checked against that model.

    Attributes:
        table: (GUIDE_SIZE,) int64, see the slots above.

    Raises:
        MissingLibraryError: for a MuJoCo with another layout.
    """

    def __init__(self, scene: Scene, model: mujoco.MjModel) -> None:
        data = mujoco.MjData(model)
        check_layout(model, data, (*_ARRAYS.values(), "userdata"))
        self._fields = np.array([(slot, offset("mjData", name)) for slot, name in _ARRAYS.items()], np.int64)
        self.table = table = np.zeros(GUIDE_SIZE, np.int64)
        table[SIGNATURE] = np.array(model.signature, np.uint64).view(np.int64)
        table[SIGNATURE_AT] = offset("mjModel", "signature")
        sizes = {STRINGS: "nu", SITES: "nsite", BODIES: "nbody", USERDATA: "nuserdata"}
        for slot, name in sizes.items():
            table[slot], table[slot + 1] = getattr(model, name), offset("mjModel", name)
        table[FIELDS], table[FIELD_COUNT] = address_of(self._fields), len(self._fields)
        # Two sites a tendon, two 32-bit numbers: one of 64 bits.
        self._ends = np.array(model.wrap_objid, np.int32).view(np.int64)
        self._springs = np.column_stack([model.actuator_gainprm[:, :1], model.actuator_biasprm[:, :3]])
        table[SPRINGS], table[ENDS] = address_of(self._springs), address_of(self._ends)
        table[GAINS_AT], table[BIASES_AT] = offset("mjModel", "actuator_gainprm"), offset("mjModel", "actuator_biasprm")
        table[ENDS_AT] = offset("mjModel", "wrap_objid")
        table[TIME_AT], table[USERDATA_AT] = offset("mjData", "time"), offset("mjData", "userdata")
