"""The control callbacks for many simulations on many threads, and for a law without a run.

Where `callback` finds the one run by the address of its MjData, here an MjData serves many simulations in turn
(`mujoco.batch`, `mujoco.rollout`). Two ways to control it:

many runs      each simulation has a table of its own, as a single run has, and its number in MjData.userdata; the
               table is given where this MjData has its arrays before each stage.
a law alone    nothing is kept from stage to stage: a copy of one table, with scratch of its own, lies on the stack.

Both leave any other model alone, by the signature and the sizes of mjModel. These show what a model is built of, not
its numbers; so a law alone also compares the strings, whose stiffness and rest lengths turn its answers into controls.
"""

from __future__ import annotations

import ctypes
from functools import cache
from typing import Any

import mujoco
import numpy as np
from mujoco.introspect import ast_nodes, enums, structs

from tensegrity_mj.dynamics.native.actuation import command_as_lengths, evaluate_law
from tensegrity_mj.dynamics.native.compiling import c_function
from tensegrity_mj.dynamics.native.elements import lend_room, let_act, room_of_elements, set_motions
from tensegrity_mj.dynamics.native.law import FAILED, SOLVED
from tensegrity_mj.dynamics.native.plant import Plant
from tensegrity_mj.dynamics.native.pointers import (
    STACK_LIMIT,
    address,
    address_of,
    borrowing,
    copy,
    floats,
    inlined,
    integers,
    owning,
    stack_doubles,
)
from tensegrity_mj.dynamics.native.strings import tighten_strings
from tensegrity_mj.dynamics.native.views import Table, fields_of, view_of
from tensegrity_mj.engines.mujoco.callback import (
    apply_loads,
    control_stage,
    read_nodes,
    set_controls,
    settle,
)
from tensegrity_mj.engines.mujoco.implicit_forces import add_implicit_forces
from tensegrity_mj.engines.mujoco.install import CALLBACK, active_table
from tensegrity_mj.engines.mujoco.motion import drive
from tensegrity_mj.engines.mujoco.run_view import ALIASES, OF_DATA, RUN, USERDATA_SIZE, RunView
from tensegrity_mj.errors import MissingLibraryError

TABLE_SIZE = len(RUN)
PARAMETERS = 10  # numbers that mjModel has for the gain and for the bias of each actuator
OTHER_STRINGS, STATUS_COUNT = 4, 5  # places of the statuses, after those of a law
# What a law alone writes of a run's table: room on the stack is lent to it.
LENT = (
    *("nodes", "velocities", "forces", "command", "rest", "force_range", "report", "tensions", "elastic", "moved"),
    *("segment_lengths", "held_mass"),
)
GUIDE = fields_of(
    sizes=("i8", "size_count", 2),  # how a model is recognized: where mjModel has a whole number, and which
    gains_at="size",
    biases_at="size",
    ends_at="size",
    springs=("f8", "strings", 4),
    last_word="size",
    ends=("i8", "end_words"),
    # Of an MjData: where it has what, and at which places of a run's table that belongs.
    time_at="size",
    data_at="size",  # of its userdata
    fields=("i8", "field_count", 2),
    # Many runs: the token, the addresses of their tables, and whether they are under way.
    token="real",
    runs=("i8", "run_count"),
    running=("i8", "run_count"),
    # What outlives an MjData: the place in a run's table, the address for the first run, and bytes from run to run.
    copies=("i8", "copy_count", 3),
    # A law alone: the table that is copied, places and sizes of what is lent, and statuses.
    law_table="size",
    lent=("i8", "lent_count", 2),
    implicit_size="size",  # numbers of scratch for `implicit_forces`, and in all
    room="size",
    statuses=("i8", STATUS_COUNT),
)
_GuideView, _ = view_of("Guide", **dict(GUIDE))


@inlined
def _at(address: int, offset: int) -> int:
    """The integer, or the pointer, at an address and an offset."""
    return integers(address + offset, 1)[0]


@inlined
def _is_ours(guide: Any, model: int) -> bool:
    """Return whether a model is the one that the tables were made for."""
    sizes, same = guide.sizes, True
    for n in range(len(sizes)):
        same &= _at(model, sizes[n, 0]) == sizes[n, 1]
    return same


@borrowing
def _has_our_strings(guide: Any, model: int) -> bool:
    """Return whether a model's strings tie the same sites in the same order, with the same springs and dampers."""
    springs, ends = guide.springs, guide.ends
    M, words = len(springs), len(ends)
    gains = floats(_at(model, guide.gains_at), (M, PARAMETERS))
    biases = floats(_at(model, guide.biases_at), (M, PARAMETERS))
    found = integers(_at(model, guide.ends_at), (words,))
    same = True
    for n in range(words - 1):
        same &= ends[n] == found[n]
    if words > 0:
        same &= (ends[words - 1] ^ found[words - 1]) & guide.last_word == 0
    for m in range(M):
        same &= gains[m, 0] == springs[m, 0]
        for k in range(3):
            same &= biases[m, k] == springs[m, 1 + k]
    return same


@inlined
def _bind(guide: Any, table: int, data: int) -> None:
    """Set in a table where an MjData has its arrays."""
    fields, words = guide.fields, integers(table, TABLE_SIZE)
    for n in range(len(fields)):
        words[fields[n, 0]] = _at(data, fields[n, 1])


@borrowing
def stage_of_many(guide: Any, model: int, data: int) -> None:
    """A stage of the simulation whose number is in the MjData's userdata."""
    if not _is_ours(guide, model):
        return
    own = floats(_at(data, guide.data_at), (USERDATA_SIZE,))
    number = int(own[1])
    if own[0] != guide.token or number < 0 or number >= guide.run_count:
        return
    table = guide.runs[number]
    _bind(guide, table, data)
    control_stage(table)


@borrowing
def settle_many(guide: Any) -> None:
    """Complete the last stage of each simulation after the steps of all, from the copies that the batch has kept."""
    copies = guide.copies
    for number in range(guide.run_count):
        if guide.running[number]:
            words = integers(guide.runs[number], TABLE_SIZE)
            for n in range(len(copies)):
                words[copies[n, 0]] = copies[n, 1] + number * copies[n, 2]
            settle(guide.runs[number])


@borrowing
def _command(guide: Any, data: int, table: int) -> int:
    """Set the controls of an MjData from the law at its state; at `table` is scratch."""
    words, lent = integers(table, TABLE_SIZE), guide.lent
    copy(integers(guide.law_table, TABLE_SIZE), words)
    room = table + 8 * TABLE_SIZE
    for n in range(len(lent)):
        words[lent[n, 0]] = room
        for k in range(lent[n, 1]):
            floats(room, lent[n, 1])[k] = 0.0  # velocities of fixed nodes stay so
        room += 8 * lent[n, 1]
    run = RunView(table)
    run.implicit_room = room
    lend_room(table, room + 8 * guide.implicit_size)
    _bind(guide, table, data)
    t = floats(data + guide.time_at, 1)[0]
    if not read_nodes(table):
        return SOLVED  # MuJoCo itself warns of such states
    if run.motion_count > 0:
        set_motions(table, t)
        if run.status != 0:
            return FAILED
        drive(run, False)
    if run.element_count > 0 or run.implicit != 0:
        let_act(table, t)
        if run.status != 0:
            return FAILED
        apply_loads(table)
    status = SOLVED
    if run.string_count > 0:
        status = evaluate_law(table, t)
        if status == SOLVED:
            command_as_lengths(table, run.rest)
            tighten_strings(table)
            set_controls(table)
    if run.implicit != 0 and status == SOLVED:
        add_implicit_forces(table, -1.0)
        apply_loads(table)
    return status


@owning
def stage_of_a_law(guide: Any, model: int, data: int) -> None:
    """A stage under a law alone. Where the law has no solution the controls stay, and its status is marked."""
    if not _is_ours(guide, model):
        return
    if not _has_our_strings(guide, model):
        guide.statuses[OTHER_STRINGS] = 1
        return
    if guide.room <= STACK_LIMIT:
        status = _command(guide, data, stack_doubles(guide.room))
    else:
        heap = np.empty(guide.room)
        status = _command(guide, data, address(heap))
        heap[0] = 0.0  # alive until here
    if status != SOLVED:
        guide.statuses[status] = 1  # threads only ever write the same


@c_function(CALLBACK, "the callback of many simulations in MuJoCo")
def many_runs(model, data):  # type: ignore[no-untyped-def]
    """The callback for many runs."""
    guide = active_table()
    if guide != 0:
        stage_of_many(_GuideView(guide), model, data)


@c_function("int64(int64)", "the end of steps of many simulations in MuJoCo")
def end_of_steps(guide):  # type: ignore[no-untyped-def]
    """`settle_many` by the guide at an address, for Python."""
    settle_many(_GuideView(guide))
    return 0


@c_function(CALLBACK, "the callback of a law in MuJoCo's own loops")
def law_alone(model, data):  # type: ignore[no-untyped-def]
    """The callback for a law without a run."""
    guide = active_table()
    if guide != 0:
        stage_of_a_law(_GuideView(guide), model, data)


def law_room(plant: Plant, implicit_size: int = 0) -> int:
    """Numbers of scratch that a law alone needs, with those for `implicit_forces`."""
    return TABLE_SIZE + sum(plant[name].size for name in LENT) + implicit_size + room_of_elements(plant)


class Guide(Table):
    """The table by which the callbacks find their way in a model, checked against that model; see `GUIDE`.

    Raises:
        MissingLibraryError: for a MuJoCo with another layout.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        super().__init__("guide", GUIDE)
        data = mujoco.MjData(model)
        names = {name: name for name in OF_DATA} | ALIASES
        check_layout(model, data, (*names.values(), "userdata"))
        places = {name: place for place, (name, _) in enumerate(RUN)}
        sites = np.array(model.wrap_objid, np.int32)
        fields = np.array([(places[name], offset("mjData", of)) for name, of in names.items()], np.int64)
        sizes = [
            (offset("mjModel", of), getattr(model, of)) for of in ("signature", "nu", "nsite", "nbody", "nuserdata")
        ]
        self.set(
            sizes=np.array(sizes, np.uint64).view(np.int64),
            gains_at=offset("mjModel", "actuator_gainprm"),
            biases_at=offset("mjModel", "actuator_biasprm"),
            ends_at=offset("mjModel", "wrap_objid"),
            springs=np.column_stack([model.actuator_gainprm[:, :1], model.actuator_biasprm[:, :3]]),
            # Sites are 32-bit numbers, two of them one of 64 bits; of the last, half may be beyond them.
            ends=np.append(sites, np.zeros(len(sites) % 2, np.int32)).view(np.int64),
            last_word=0xFFFFFFFF if len(sites) % 2 else -1,
            time_at=offset("mjData", "time"),
            data_at=offset("mjData", "userdata"),
            fields=fields,
        )

    def set_copies(self, copies: dict[str, Any]) -> None:
        """Set where copies of MjData's arrays are, each a row a simulation, by their names in a run's table."""
        places = {name: place for place, (name, _) in enumerate(RUN)}
        found = [(places[name], array.ctypes.data, array.strides[0]) for name, array in copies.items()]
        self.set(copies=np.array(found, np.int64))


# Offsets of the fields of mjData and mjModel in memory, from the declarations in the package's own `mujoco.introspect`
# and the rules of C. Before they are used they are checked against the addresses of the Python views of an MjData, so
# that another layout is an error message and not a crash.

_PLAIN: dict[str, Any] = {
    "int": ctypes.c_int,
    "float": ctypes.c_float,
    "char": ctypes.c_char,
    "unsigned char": ctypes.c_ubyte,
    "size_t": ctypes.c_size_t,
    "uintptr_t": ctypes.c_size_t,
    "uint64_t": ctypes.c_uint64,
    "mjtNum": ctypes.c_double,
    "mjtByte": ctypes.c_ubyte,
    "mjtBool": ctypes.c_bool,
    "mjtSize": ctypes.c_int64,
}


def _c_type(declared: Any) -> Any:
    if isinstance(declared, ast_nodes.PointerType):
        return ctypes.c_void_p
    if isinstance(declared, ast_nodes.ArrayType):
        kind = _c_type(declared.inner_type)
        for extent in reversed(declared.extents):
            kind = kind * extent
        return kind
    if isinstance(declared, ast_nodes.ValueType):
        name = declared.name.removeprefix("struct ")
        if name in _PLAIN:
            return _PLAIN[name]
        if name in enums.ENUMS:
            return ctypes.c_int
        for candidate in (name, name.rstrip("_")):
            if candidate in structs.STRUCTS:
                return _structure(candidate)
    if hasattr(declared, "fields"):  # an anonymous struct
        base = ctypes.Union if isinstance(declared, ast_nodes.AnonymousUnionDecl) else ctypes.Structure
        return type("anonymous", (base,), {"_fields_": [(f.name, _c_type(f.type)) for f in declared.fields]})
    raise MissingLibraryError(f"MuJoCo {mujoco.__version__} declares a type that is unknown here: {declared}")


@cache
def _structure(name: str) -> Any:
    fields = [(field.name, _c_type(field.type)) for field in structs.STRUCTS[name].fields]
    return type(name, (ctypes.Structure,), {"_fields_": fields})


def offset(structure: str, field: str) -> int:
    """Bytes from the start of an "mjData" or "mjModel" to one of its fields."""
    return int(getattr(_structure(structure), field).offset)


def check_layout(model: mujoco.MjModel, data: mujoco.MjData, fields: tuple[str, ...]) -> None:
    """Check that these arrays of mjData, its time, and the sizes and strings of mjModel are where the offsets say.

    Raises:
        MissingLibraryError: where one is not.
    """
    at = {"mjData": int(data._address), "mjModel": int(model._address)}

    def check(structure: str, field: str, kind: Any, value: Any) -> None:
        if kind.from_address(at[structure] + offset(structure, field)).value != value:
            raise MissingLibraryError(
                f"{structure}.{field} is not where MuJoCo {mujoco.__version__}'s own description says: install another "
                "version of mujoco (4.0 is known to work), or simulate runs one by one"
            )

    arrays = [("mjData", data, field) for field in fields]
    arrays += [("mjModel", model, field) for field in ("actuator_gainprm", "actuator_biasprm", "wrap_objid")]
    for structure, owner, field in arrays:
        if np.size(view := getattr(owner, field)):
            check(structure, field, ctypes.c_void_p, address_of(view))
    before = data.time
    try:
        data.time = 0.8414709848078965
        check("mjData", "time", ctypes.c_double, data.time)
    finally:
        data.time = before
    for field in ("nu", "nsite", "nbody", "ntendon", "nuserdata"):
        check("mjModel", field, ctypes.c_int64, getattr(model, field))
    check("mjModel", "signature", ctypes.c_uint64, model.signature)
