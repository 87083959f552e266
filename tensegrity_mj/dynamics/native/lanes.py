"""Several runs side by side, a lane each: what kernels call so that the same source is one run's and a block's.

A kernel that branches on a state says so by `select` and `any_of`: of plain numbers they are the branch. Which of the
two a kernel is compiled for follows from the type of the addresses that it gets (`at_width`): what is read from behind
a `LaneAddress` has W numbers in place of each, one a lane.

What only single runs have, such as samples or strings that yield, is `alone`: in lanes it is never reached.
A lane in which something happens that a block cannot do, as a law without a solution, becomes NaN: its run is made
anew by itself, from its start.
"""

from __future__ import annotations

import functools
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tensegrity_mj.dynamics.native.compiling import CFunction, Kernel, intrinsic
from tensegrity_mj.dynamics.native.pointers import LAW_SIGNATURE, TIMED

# Version of the code that lanes compile to: compiled code of an older one is not used.
WIDTHS = (4, 8)  # of registers of 256 and 512 bits
STAMP = zlib.crc32(Path(__file__).with_name("lane_types.py").read_bytes())


@intrinsic
def select(typingctx: Any, condition: Any, a: Any, b: Any) -> Any:
    """a where the condition holds, else b; both are computed."""
    kind = typingctx.unify_types(a, b)
    if hasattr(condition, "width"):
        from tensegrity_mj.dynamics.native.lane_types import Lanes

        kind = Lanes(condition.width)

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        first, second = (context.cast(builder, x, one, kind) for x, one in zip(args[1:], sig.args[1:], strict=True))
        return builder.select(args[0], first, second)

    return kind(condition, a, b), codegen


def _across(operation: str) -> Any:
    @intrinsic
    def across(typingctx: Any, condition: Any) -> Any:
        from numba import types

        def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            from llvmlite import ir

            if not hasattr(condition, "width"):
                return args[0]
            bits = builder.bitcast(args[0], ir.IntType(condition.width))
            none = ir.Constant(bits.type, 0 if operation == "!=" else 2**condition.width - 1)
            return builder.icmp_unsigned(operation, bits, none)

        return types.boolean(condition), codegen

    return across


any_of, all_of = _across("!="), _across("==")  # whether a condition holds in any lane, in all lanes; of one run, it


@intrinsic
def one_of(typingctx: Any, value: Any) -> Any:
    """The number of the first lane, for what is the same in all."""
    from numba import types

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        from llvmlite import ir

        return builder.extract_element(args[0], ir.IntType(32)(0)) if hasattr(value, "width") else args[0]

    return types.float64(value), codegen


@intrinsic
def room_like(typingctx: Any, like: Any, given: Any, count: Any) -> Any:
    """An address if given, else that of `count` float64 on the caller's stack, each in lanes where `like` is."""
    from numba import types

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        from llvmlite import ir

        width = getattr(like, "width", 0)
        kind = ir.VectorType(ir.DoubleType(), width) if width else ir.DoubleType()
        none = builder.icmp_unsigned("==", args[1], args[1].type(0))
        stack = builder.alloca(kind, builder.select(none, args[2], args[2].type(0)))
        return builder.select(none, builder.ptrtoint(stack, ir.IntType(64)), args[1])

    return like(like, types.int64, types.int64), codegen


@functools.cache
def at_width(width: int, varied: bool) -> Any:
    """A compiled function that says of an address that what is there lies in so many lanes."""
    stamp = STAMP

    @intrinsic
    def at(typingctx: Any, address: Any) -> Any:
        from numba import types

        from tensegrity_mj.dynamics.native.lane_types import LaneAddress

        assert stamp >= 0  # what is compiled depends on it

        def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            return args[0]

        return LaneAddress(width, varied)(types.int64), codegen

    return at


class _Alone(Kernel):
    """See `alone`."""

    def __init__(self, function: Callable[..., Any], result: Any) -> None:
        super().__init__(function, {"_nrt": False})
        self.result = result

    @functools.cached_property
    def _numba_type_(self) -> Any:
        of = super()._numba_type_
        from tensegrity_mj.dynamics.native.lane_types import alone as choice

        return choice(of, self.result)


def alone(result: Any) -> Callable[[Callable[..., Any]], Any]:
    """A compiled function that lanes do not reach: for them it is `result`."""
    return lambda function: _Alone(function, result)


@functools.cache
def in_lanes(function: CFunction, width: int, varied: bool) -> CFunction:
    """A C function for so many runs side by side, whose addresses are those of what lies in lanes."""
    body, at = Kernel(function.py_func, {"_nrt": False}), at_width(width, varied)
    if function.signature == TIMED:

        def made(t, y, dy, table):  # type: ignore[no-untyped-def]
            return body(t, at(y), at(dy), at(table))

    elif function.signature == LAW_SIGNATURE:
        own = at if varied else int  # the address of what all lanes have in common

        def made(t, nodes, velocities, context, command, report):  # type: ignore[no-untyped-def,misc]
            return body(t, at(nodes), at(velocities), own(context), at(command), at(report))

    else:

        def made(own, first, count):  # type: ignore[no-untyped-def,misc]
            return body(at(own), first, count)

    where = function.py_func.__module__.rpartition(".")[2]
    made.__name__ = made.__qualname__ = f"{where}_{function.py_func.__name__}_{width}{'varied' if varied else ''}"
    return CFunction(made, function.signature, f"{function.what}, {width} at a time")
