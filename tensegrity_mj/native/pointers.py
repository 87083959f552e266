"""Raw addresses in compiled code: how one compiled engine calls any law, built-in or Python, at the speed of C.

A law is a C function

    int64 law(double time, int64 nodes, int64 velocities, int64 context, int64 command, int64 report)

whose integers are addresses of float64 arrays: nodes and velocities (N, 3) in, command (M,) and report (5,)
(see `law.Report`) out; `context` is the address of whatever the law keeps. External forces f(t) are C functions
`int64 forces(double time, int64 out)` that write (N, 3).
"""

from __future__ import annotations

import ctypes
from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

LAW_SIGNATURE = types.int64(types.float64, types.int64, types.int64, types.int64, types.int64, types.int64)
LAW_FUNCTION = ctypes.CFUNCTYPE(
    ctypes.c_int64,
    ctypes.c_double,
    ctypes.c_int64,
    ctypes.c_int64,
    ctypes.c_int64,
    ctypes.c_int64,
    ctypes.c_int64,
)
LOAD_FUNCTION = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_double, ctypes.c_int64)


@intrinsic
def _as_pointer(typingctx: Any, address: Any) -> Any:
    """An integer address as a void pointer, which numba.carray accepts."""
    signature = types.voidptr(types.int64)

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.inttoptr(args[0], context.get_value_type(types.voidptr))

    return signature, codegen


@intrinsic
def call_law(
    typingctx: Any, function: Any, time: Any, nodes: Any, velocities: Any, context_: Any, command: Any, report: Any
) -> Any:
    """Call the law at address `function`; the arguments are those of the C function above."""
    signature = types.int64(types.int64, types.float64, types.int64, types.int64, types.int64, types.int64, types.int64)

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        integer = ir.IntType(64)
        kind = ir.FunctionType(integer, [ir.DoubleType(), integer, integer, integer, integer, integer])
        return builder.call(builder.inttoptr(args[0], kind.as_pointer()), args[1:])

    return signature, codegen


@intrinsic
def call_load(typingctx: Any, function: Any, time: Any, out: Any) -> Any:
    """Call the force function at address `function`."""
    signature = types.int64(types.int64, types.float64, types.int64)

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        integer = ir.IntType(64)
        kind = ir.FunctionType(integer, [ir.DoubleType(), integer])
        return builder.call(builder.inttoptr(args[0], kind.as_pointer()), args[1:])

    return signature, codegen


@numba.njit(inline="always")
def floats(address: int, shape: Any) -> Any:
    """The float64 array of the given shape at an address."""
    return numba.carray(_as_pointer(address), shape, np.float64)


@numba.njit(inline="always")
def integers(address: int, shape: Any) -> Any:
    """The int64 array of the given shape at an address."""
    return numba.carray(_as_pointer(address), shape, np.int64)


def records_reader(dtype: np.dtype[Any]) -> Any:
    """A compiled function (address, count) -> record array of this dtype."""
    pointer = types.CPointer(numba.from_dtype(dtype))

    @intrinsic
    def typed(typingctx: Any, address: Any) -> Any:
        def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            return builder.inttoptr(args[0], context.get_value_type(pointer))

        return pointer(types.int64), codegen

    @numba.njit(inline="always")
    def read(address: int, count: int) -> Any:
        return numba.carray(typed(address), (count,))

    return read


def address_of(array: np.ndarray[Any, Any]) -> int:
    """Address of the first element; the caller keeps the array alive."""
    return int(array.ctypes.data)
