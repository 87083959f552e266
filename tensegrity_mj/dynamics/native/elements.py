"""Elements in compiled code: a C function each, and one loop that calls those of a scene.

    int64 act(double t, int64 motion, int64 context, int64 effect)

The integers are addresses of tables (`views`): a `Motion`, the element's own table, and an `Effect`, to whose
forces (N, 3) [N] it adds its own. Each element has an effect to itself, whose forces are zero when it is called. The
rest follows from forces and speeds: the power F·v of an element is given, lost or stored as its `Work` says, and so is
that of forces which an integrator of one stage holds over a step.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tensegrity_mj.dynamics.native.compiling import called_from_c
from tensegrity_mj.dynamics.native.lanes import alone
from tensegrity_mj.dynamics.native.law import FAILED, SOLVED
from tensegrity_mj.dynamics.native.motion import motion_at
from tensegrity_mj.dynamics.native.plant_view import PlantView
from tensegrity_mj.dynamics.native.pointers import (
    TIMED,
    address,
    address_of,
    array_at,
    borrowing,
    call_timed,
    copy,
    floats,
    inlined,
    integers,
    reader_of,
    stack_doubles,
)
from tensegrity_mj.dynamics.native.views import Table, changing_view, fields_of, view_of
from tensegrity_mj.errors import ElementError, OptionError
from tensegrity_mj.model.elements.element import (
    Element,
    Work,
    acted,
    named_function,
    rated,
    split_states,
    states_at_start,
)
from tensegrity_mj.model.events import NodalLoads
from tensegrity_mj.model.scene import Scene

Motion, _ = view_of("Motion", nodes=("f8", "count", 3), velocities=("f8", "count", 3))
# given: of surroundings that move, the power that they give [W], or what an element that stores its work loses of it;
# added: α of the rods [kg], of all elements together, rows (α_11, α_12, α_21, α_22), of which there are none where no
# element adds mass; state: of an element that has one, as it is now; rates: its derivative, for it to write.
_EFFECT = fields_of(
    forces=("f8", "count", 3),
    added=("f8", "rods", 4),
    given="real",
    state=("f8", "states"),
    rates=("f8", "states"),
)
Effect, pack_effect = view_of("Effect", **dict(_EFFECT))
_Own = changing_view("Own", _EFFECT)  # an `Effect` as the loop over all sees it: it may lie on a stack
MOTION_SIZE, EFFECT_SIZE = 3, len(_EFFECT)
_PLACES = {name: place for place, (name, _) in enumerate(_EFFECT)}
_COUNT, _RODS = _PLACES["count"], _PLACES["rods"]

ACT_SIGNATURE = TIMED
ELEMENT = np.dtype([("function", "i8"), ("context", "i8"), ("effect", "i8"), ("work", "i8")], align=True)
RECORD_SIZE = 4  # numbers of a record
_read_elements = reader_of(ELEMENT)
_WORKS = {Work.GIVEN: 0, Work.LOST: 1, Work.STORED: 2}
GIVEN, LOST = _WORKS[Work.GIVEN], _WORKS[Work.LOST]
LOSING = 3  # of what stores its work and loses some of it


@borrowing
def let_act(table: int, t: float) -> Any:
    """Set the nodal forces to those of all elements at time t; powers [W] that are given and that are lost.

    What answers the rods' accelerations is not among the forces: the engine adds it, from α.
    """
    plant = PlantView(table)
    forces, velocities, added = plant.forces, plant.velocities, plant.added
    clear(forces)
    clear(added)
    given, lost = 0.0, 0.0
    elements = _read_elements(plant.elements, plant.element_count)
    for e in range(len(elements)):
        element, own = elements[e], _Own(elements[e].effect)
        pushes = own.forces
        clear(pushes)
        own.given = 0.0
        if call_timed(element.function, t, plant.seen, element.context, element.effect) != SOLVED:
            plant.status = FAILED
        for n in range(len(pushes)):
            for x in range(3):
                forces[n, x] += pushes[n, x]
        given, lost = _counted(element, own, velocities, given, lost)
    return given, lost


@inlined
def _counted(element: Any, own: Any, velocities: Any, given: float, lost: float) -> Any:
    """Powers that are given and lost, with those of an element."""
    power = power_of(own.forces, velocities)
    if element.work == GIVEN:
        given += power
    elif element.work == LOST:
        given += own.given
        lost += own.given - power
    elif element.work == LOSING:
        lost += own.given
    return given, lost


@alone(SOLVED)
def known_forces(known: int, t: float, nodes: Any, velocities: Any, forces: Any, added: Any) -> int:
    """Set forces on nodes (N, 3; more rows are zero) and α (R, 4) of rods to what a law accounts for; a status.

    `known` is the address of a table: how many there are, and function and context of each. Only those that have no
    state can be known of.
    """
    clear(forces)
    clear(added)
    frame = stack_doubles(MOTION_SIZE + EFFECT_SIZE)
    at = frame + 8 * MOTION_SIZE
    seen, effect, own = integers(frame, MOTION_SIZE), integers(at, EFFECT_SIZE), _Own(at)
    seen[0], seen[1], seen[2] = len(nodes), address(nodes), address(velocities)
    for x in range(EFFECT_SIZE):
        effect[x] = 0
    effect[_COUNT], effect[_RODS] = len(nodes), len(added)
    own.forces, own.added = forces, added
    status, count = SOLVED, integers(known, 1)[0]
    records = integers(known + 8, (count, 2))
    for e in range(count):
        if call_timed(records[e, 0], t, frame, records[e, 1], at) != SOLVED:
            status = FAILED
    return status


@borrowing
def held_powers(table: int) -> Any:
    """Powers [W] that the forces found last give and lose at the current velocities; added mass included."""
    plant = PlantView(table)
    velocities, given, lost = plant.velocities, 0.0, 0.0
    elements = _read_elements(plant.elements, plant.element_count)
    for e in range(len(elements)):
        given, lost = _counted(elements[e], _Own(elements[e].effect), velocities, given, lost)
    return given + power_of(plant.held_mass, velocities), lost


@inlined
def clear(rows: Any) -> None:
    """Set all numbers of (n, m) to zero."""
    for n in range(rows.shape[0]):
        for x in range(rows.shape[1]):
            rows[n, x] = 0.0


@inlined
def power_of(forces: Any, velocities: Any) -> float:
    """Σ F·v [W]."""
    power = 0.0
    for n in range(len(forces)):
        for x in range(3):
            power += forces[n, x] * velocities[n, x]
    return power


@borrowing
def lend_room(table: int, room: int) -> None:
    """Give a copy of a table's elements, and all that they write, room of its own: `room_of_elements` numbers there."""
    plant = PlantView(table)
    N, R, count = plant.node_count, plant.wet_rods, plant.element_count
    seen = integers(room, MOTION_SIZE)
    seen[0], seen[1], seen[2] = N, address(plant.nodes), address(plant.velocities)
    plant.seen = room
    room += 8 * MOTION_SIZE
    if R > 0:
        plant.added = floats(room, (R, 4))
        room += 32 * R
    copy(integers(plant.elements, RECORD_SIZE * count), integers(room, RECORD_SIZE * count))
    plant.elements = room
    elements = _read_elements(room, count)
    room += 8 * RECORD_SIZE * count
    for e in range(count):
        copy(integers(elements[e].effect, EFFECT_SIZE), integers(room, EFFECT_SIZE))
        elements[e].effect = room
        own = _Own(room)
        room += 8 * EFFECT_SIZE
        own.forces = floats(room, (N, 3))
        room += 24 * N
        if R > 0:
            own.added = plant.added


def room_of_elements(plant: Table) -> int:
    """Numbers that `lend_room` takes."""
    N, count, R = plant["node_count"], plant["element_count"], plant["wet_rods"]
    return int(MOTION_SIZE + 4 * R + count * (RECORD_SIZE + EFFECT_SIZE + 3 * N))


@borrowing
def set_motions(table: int, t: float) -> None:
    """Set the displacements, velocities and accelerations of the moved supports to those at time t."""
    plant = PlantView(table)
    moved = plant.moved
    for number in range(len(moved)):
        if motion_at(plant.motions, number, t, address(moved[number])) != 0:
            plant.status = FAILED


@dataclass(frozen=True)
class NativeElement:
    """An element as a C function.

    Attributes:
        address, context: of the function and of its data.
        keep: objects that must stay alive while it is called.
    """

    address: int
    context: int
    keep: tuple[Any, ...] = ()


Failures = list[tuple[Element, BaseException]]


def native_element(element: Element, scene: Scene, failures: Failures) -> NativeElement:
    """An element of a scene as a C function: its own where it has one, else a call back into Python.

    Args:
        element, scene: which.
        failures: where what it raises goes, the first alone.
    """
    if not element.compiled:
        return called_back(element, scene, failures)
    pack: Callable[[Element, Scene], NativeElement | None] = named_function(element, "compiled")
    return pack(element, scene) or called_back(element, scene, failures)


def called_back(element: Element, scene: Scene, failures: Failures) -> NativeElement:
    """`act` of an element in Python as a C function, with `rates` of one that has a state."""
    N, S = len(scene.structure.nodes), len(element.state0(scene)) if element.has_state else 0

    def call(time: float, motion: int, context: int, effect: int) -> int:
        try:
            _, nodes, velocities = (ctypes.c_int64 * MOTION_SIZE).from_address(motion)
            x, v = array_at(nodes, N, 3).copy(), array_at(velocities, N, 3).copy()
            own = (ctypes.c_int64 * EFFECT_SIZE).from_address(effect)
            state = [array_at(own[_PLACES["state"]], S).copy()] if S else []
            array_at(own[_PLACES["forces"]], N, 3)[:] += acted(element, scene, time, x, v, *state)
            if S:
                array_at(own[_PLACES["rates"]], S)[:] = rated(element, scene, time, x, v, *state)
            if element.work is Work.LOST or (S and element.work is Work.STORED):
                report = element.given if element.work is Work.LOST else element.lost
                array_at(effect + 8 * _PLACES["given"], 1)[:] = float(report(scene, time, x, v, *state))
        except BaseException as error:
            if not failures:
                failures.append((element, error))
            return FAILED
        return SOLVED

    function, address = called_from_c(ACT_SIGNATURE, call)
    return NativeElement(address, 0, (function,))


class PackedElements:
    """Elements of a scene, packed for a plant's table; to be kept alive while the table is read.

    Attributes:
        states: (4, S) of elements that have one, see `plant_view`.
        failures: what an element in Python raised: it, and the first exception.
    """

    def __init__(self, scene: Scene, plant: Table, effects: Sequence[Element]) -> None:
        self.failures: Failures = []
        N, R = len(scene.structure.nodes), len(scene.structure.rods)
        records = np.zeros(len(effects), ELEMENT)
        seen = np.array([N, address_of(plant["nodes"]), address_of(plant["velocities"])], np.int64)  # a `Motion`
        self.added = np.zeros((R if any(one.adds_mass for one in effects) else 0, 4))
        start = states_at_start(effects, scene)
        self.states = np.array([start, 0.0 * start, start, 0.0 * start])
        self._keep: list[Any] = []
        parts = zip(*(split_states(effects, scene, row) for row in self.states[:2]), strict=True)
        for record, element, own in zip(records, effects, parts, strict=True):
            state, rates = (part[0] if part else np.zeros(0) for part in own)
            native = native_element(element, scene, self.failures)
            effect = pack_effect(forces=np.zeros((N, 3)), added=self.added, given=0.0, state=state, rates=rates)
            losing = (element.has_state or element.loses) and element.work is Work.STORED
            record["function"], record["context"] = native.address, native.context
            record["effect"], record["work"] = effect.address, LOSING if losing else _WORKS[element.work]
            self._keep += [native, effect]
        plant.set(element_count=len(effects), elements=records, seen=seen)
        plant.set(added=self.added, held_mass=np.zeros((N, 3)), element_states=self.states)

    def raise_if_failed(self, time: float) -> None:
        """Raise what an element in Python did wrong.

        Raises:
            ElementError: with its name and the time; OptionError for a function of loads.
        """
        if not self.failures:
            return
        element, error = self.failures[0]
        if not isinstance(error, Exception):
            raise error  # KeyboardInterrupt
        cause = f"failed near t = {time:.6g} s: {type(error).__name__}: {error}"
        if isinstance(element, NodalLoads):
            raise OptionError(f"loads: the function {cause}") from error
        raise ElementError(f"element {element.label} {cause}") from error
