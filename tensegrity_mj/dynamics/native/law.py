"""Control laws: what they are, and how every engine calls them.

The simplest law is a function `law(time, nodes, velocities) -> u`: time [s], node positions and velocities
(N, 3) in the world frame, force densities (M,) [N/m] out. A law may be any callable object, with these optional
attributes:

    command = Command.REST_LENGTH     it returns rest lengths [m] instead of force densities
    discontinuous = "why"             it jumps, and so cannot be evaluated at every stage of an integrator
    describe()                        a dict of plain values for the provenance of a run
    report                            after each call, five numbers about it (see `Report`); NaN where it has none
    native(structure)                 a `NativeLaw`, compiled; the built-in laws have it
    arrays = "module:function"        of a function (law, structure) -> ArrayLaw, for the differentiable engine

A law that has no admissible answer at a state raises `InfeasibleError`. See docs/laws.md.
"""

from __future__ import annotations

import enum
import json
import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics import interrupts
from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import member
from tensegrity_mj.dynamics.native.compiling import CFunction, c_function, called_from_c
from tensegrity_mj.dynamics.native.pointers import LAW_SIGNATURE, array_at, borrowing, call_law, floats
from tensegrity_mj.dynamics.native.vectors import dot, minus, row_of
from tensegrity_mj.dynamics.native.views import Table, view_of
from tensegrity_mj.errors import InfeasibleError, OptionError
from tensegrity_mj.model.structure import Structure


class Command(enum.Enum):
    """Quantity that a law returns."""

    FORCE_DENSITY = "force density"
    REST_LENGTH = "rest length"


@runtime_checkable
class Law(Protocol):
    """A control law: (time [s], nodes (N, 3) [m], velocities (N, 3) [m/s]) -> u (M,) [N/m], or rest lengths [m]."""

    def __call__(self, time: float, nodes: Array, velocities: Array, /) -> ArrayLike: ...


class Report(enum.IntEnum):
    """Numbers that a law may report of each evaluation, as well as its command; recorded, NaN where it has none."""

    FEASIBILITY_MARGIN = 0  # an admissible solution exists while it is > 0
    LYAPUNOV = 1  # V
    LYAPUNOV_ERROR = 2  # the terms of V in the errors alone
    LYAPUNOV_VELOCITY = 3  # the terms of V with velocities
    ALLOCATION_RESIDUAL = 4  # largest violation of what was required of the strings


# Statuses that a native law returns.
SOLVED, NO_SOLUTION, FAILED, NOT_FINITE = 0, 1, 2, 3


@dataclass(frozen=True)
class LaneLaw:
    """A law for several runs side by side (`native.lanes`), which answers by NaN where there is no solution.

    Attributes:
        function: the C function.
        table: its data.
        kind: () -> what laws have in common whose data can be in lanes of their own.
    """

    function: CFunction
    table: Table
    kind: Callable[[], Any]


@dataclass
class NativeLaw:
    """A law as a C function (see `native.pointers`): what engines call.

    Attributes:
        address, context: of the function and of its data; 0 for no law.
        keep: objects that must stay alive while the law is called.
        command: what it returns.
        discontinuous: why it cannot run continuously, or "".
        period: [s] that a sampled recording must be played with, or None.
        until: [s] at which a recording ends, or None.
        kinks: [s] of a table, where what it commands is not smooth.
        gravity: [m/s²] that it accounts for, or None if it has no such notion.
        known: what else acts on nodes and is accounted for: loads, resistance, water, elements.
        decay_rate: δ [1/s] of the V̇ = -δ V that it promises, or None if it promises none.
        failure: the exception of a Python law that failed with FAILED, in a list of at most one.
        reason: why a Python law had no solution when it was last called, in a list of at most one text.
        spent: of a Python law: how often it was called, and the seconds that it took, in a list of two.
        lanes: what it is to several runs side by side, where it can answer them.
        stateless: its answer depends on its arguments alone, and threads may call it at the same time.
        own: the law as it was given, for an engine that does not call C functions.
    """

    address: int
    context: int
    keep: tuple[Any, ...]
    command: Command = Command.FORCE_DENSITY
    discontinuous: str = ""
    description: dict[str, Any] | None = None
    failure: list[BaseException] | None = None
    reason: list[str] | None = None
    period: float | None = None
    until: float | None = None
    kinks: tuple[float, ...] = ()
    gravity: tuple[float, ...] | None = None
    known: tuple[Any, ...] = ()
    decay_rate: float | None = None
    spent: list[float] | None = None
    lanes: LaneLaw | None = None
    stateless: bool = False
    own: Any = None


# Fields of a view of a function that wraps a law: the law within, as a C function.
WITHIN: dict[str, Any] = {"law": "size", "context": "size"}


def wrapped(inner: NativeLaw, function: Any, packed: Table) -> NativeLaw:
    """Wrap a law in a C function, which finds it in `packed`, a table with the fields WITHIN."""
    return replace(inner, address=function.address, context=packed.address, keep=(inner, packed), lanes=None)


def check_made_for(own: Structure, structure: Structure) -> None:
    """Raise OptionError unless a law's own structure has the nodes and strings of the plant's, in the same order."""
    one, other = ((len(s.nodes), s.paths.nodes.tolist(), s.paths.ranges.tolist()) for s in (own.massless, structure))
    if one != other:
        raise OptionError(
            f"the law was made for '{own.name}' with {len(own.nodes)} nodes and {len(own.strings)} strings; "
            f"'{structure.name}' has other nodes or strings"
        )


def native_law(
    law: Law | Callable[..., ArrayLike] | None, structure: Structure, description: dict[str, Any] | None = None
) -> NativeLaw:
    """The law as a C function: its own where it has one, else a call back into Python.

    A structure with ropes is to it one whose strings have no mass, and its command is spread over their parts.

    Args:
        description: what the law says of itself, where that is known.

    Raises:
        OptionError: if it is neither callable nor a law.
    """
    if law is None:
        return NativeLaw(0, 0, ())
    if isinstance(law, type) or not callable(law):
        raise OptionError(
            f"controller = {law!r}: it must be a function (time, nodes, velocities) -> u, or a law (an object, "
            "not a class)"
        )
    if callable(getattr(law, "native", None)):
        native: NativeLaw = law.native(structure.massless)  # type: ignore[union-attr]
    else:
        native = _python_law(law, structure.massless)
    if structure.ropes:
        densities = native.command is Command.FORCE_DENSITY
        curved = [string.name for string in structure.massless.strings if not string.is_linear]
        if densities and curved:
            raise OptionError(
                f"string '{curved[0]}' is not linear, and other strings have mass: only rest lengths are commanded to "
                "both; use a law that returns these, or leave out the masses or the curve"
            )
        spread = wrapped(native, *rope_law(structure, native.address, native.context, densities))
        native = replace(spread, command=Command.REST_LENGTH)
    return replace(native, description=_description(law) if description is None else description, own=law)


def _description(law: Any) -> dict[str, Any]:
    """Return the law's description of itself, checked before the run, as it is written to files."""
    describe = getattr(law, "describe", None)
    if not callable(describe):
        return {"law": getattr(law, "__name__", type(law).__name__)}
    try:
        description = describe()
        json.dumps(description)
    except Exception as error:
        raise OptionError(
            f"{law!r}.describe() must return a dict of plain values (texts, numbers, lists, dicts): "
            f"{type(error).__name__}: {error}"
        ) from error
    if not isinstance(description, dict):
        raise OptionError(f"{law!r}.describe() returned {description!r}; it must return a dict")
    return description


def _python_law(law: Callable[..., ArrayLike], structure: Structure) -> NativeLaw:
    count, size = len(structure.nodes), len(structure.strings)
    command = getattr(law, "command", Command.FORCE_DENSITY)
    member(f"{law!r}.command", command, Command)
    discontinuous = getattr(law, "discontinuous", "")
    if not isinstance(discontinuous, str):
        raise OptionError(f"{law!r}.discontinuous = {discontinuous!r}; it must be a text that says why, or absent")
    failure: list[BaseException] = []
    reason: list[str] = []
    spent = [0.0, 0.0]
    here = threading.local()  # whether this thread is within the law

    def call(time: float, nodes: int, velocities: int, context: int, out: int, report: int) -> int:
        if getattr(here, "inside", False) or (failure and not isinstance(failure[0], Exception)):
            # Called within itself, by a simulation that it steps; or after an interrupt, which shall come to be heard.
            if not failure:
                failure.append(RuntimeError("it was called within itself: it steps a simulation that it controls"))
            return FAILED
        start = perf_counter()
        try:
            here.inside = True
            if interrupts.requested():
                raise KeyboardInterrupt
            status = SOLVED
            try:
                value = np.asarray(law(time, array_at(nodes, count, 3).copy(), array_at(velocities, count, 3).copy()))
                if np.iscomplexobj(value):
                    raise ValueError("it returned complex numbers; it must return real ones")
                value = value.astype(float)
                if value.shape != (size,):
                    raise ValueError(f"it returned shape {value.shape}; it must return ({size},), a value a string")
                array_at(out, size)[:] = value
            except InfeasibleError as error:
                reason[:], status = [str(error)], NO_SOLUTION
            reported = getattr(law, "report", None)
            array_at(report, len(Report))[:] = np.nan if reported is None else reported
            return status
        except BaseException as error:
            if not failure:
                failure.append(error)
            array_at(report, len(Report))[:] = np.nan
            return FAILED
        finally:
            here.inside = False
            spent[0] += 1.0
            spent[1] += perf_counter() - start

    function, address = called_from_c(LAW_SIGNATURE, call)
    return NativeLaw(
        address=address,
        context=0,
        keep=(function, law),
        command=command,
        discontinuous=discontinuous,
        failure=failure,
        reason=reason,
        spent=spent,
        stateless=True,  # as docs/laws.md requires; Python takes one thread at a time
    )


# A law knows of ropes as massless strings (`Structure.massless`), and commands each as one: a force density u is one of
# the whole, T = u L with L the length of all its parts, so that its rest length is L - T/k, of which each part has its
# share. Tensions of the parts differ from T by what moves their masses; their mean by shares is T.
_Ropes, _pack_ropes = view_of(
    "RopeLaw",
    law="size",
    context="size",
    densities="size",  # whether the law returns force densities
    node_count="size",
    segments=("i8", "segment_count", 2),
    limits=("i8", "given_count", 2),  # first segment of each string as given, and one behind the last
    shares=("f8", "string_count"),
    firsts=("i8", "first_count"),  # likewise of its parts, the last behind all
    compliance=("f8", "given_count"),
)


@borrowing
def spread(table: int, nodes_at: int, command_at: int) -> None:
    """Make rest lengths of the parts of a command to strings as given, in its place."""
    own = _Ropes(table)
    nodes, command = floats(nodes_at, (own.node_count, 3)), floats(command_at, (own.string_count,))
    firsts, shares, segments, limits, compliance = own.firsts, own.shares, own.segments, own.limits, own.compliance
    for n in range(own.given_count):
        g = own.given_count - 1 - n  # from the last on: parts of a string are never before its own command
        rest = command[g]
        if own.densities:
            length = 0.0
            for p in range(limits[g, 0], limits[g, 1]):
                span = minus(row_of(nodes, segments[p, 1]), row_of(nodes, segments[p, 0]))
                length += np.sqrt(dot(span, span))
            rest = length * (1.0 - rest * compliance[g])
        for m in range(firsts[g], firsts[g + 1]):
            command[m] = shares[m] * rest


@c_function(LAW_SIGNATURE, "a law on strings with mass")
def _rope_law(t, nodes, velocities, context, command, report):  # type: ignore[no-untyped-def]
    own = _Ropes(context)
    status = call_law(own.law, t, nodes, velocities, own.context, command, report)
    spread(context, nodes, command)
    return status


def rope_law(structure: Structure, law: int, context: int, densities: bool) -> tuple[Any, Table]:
    """The C function to be put around a law on `structure.massless`, and its table; together they command rest lengths.

    Args:
        law, context: addresses of the law's C function and of its data.
        densities: whether it returns force densities, or rest lengths.
    """
    shares = {rope.string.name: rope.shares for rope in structure.ropes}
    parts = [shares.get(string.name, np.ones(1)) for string in structure.massless.strings]
    firsts = np.cumsum([0, *map(len, parts)])
    ranges = structure.paths.ranges
    packed = _pack_ropes(
        law=law,
        context=context,
        densities=densities,
        node_count=len(structure.nodes),
        segments=structure.paths.nodes,
        limits=np.stack([ranges[firsts[:-1], 0], ranges[firsts[1:] - 1, 1]], axis=1),
        shares=np.concatenate(parts),
        firsts=firsts,
        compliance=1.0 / structure.massless.stiffness,
    )
    return _rope_law, packed
