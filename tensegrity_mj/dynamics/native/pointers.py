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
from numba.core import cgutils
from numba.extending import intrinsic
from numba.np import arrayobj

from tensegrity_mj.dynamics.native.compiling import compiled

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


def _viewer(dtype: types.Type) -> Any:
    """A compiled function (address, shape or length) -> array of this dtype, which owns nothing."""

    @intrinsic
    def view(typingctx: Any, address: Any, shape: Any) -> Any:
        kinds = list(shape) if isinstance(shape, types.BaseTuple) else [shape]
        array_type = types.Array(dtype, len(kinds), "C")

        def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            array = context.make_array(array_type)(context, builder)
            given = cgutils.unpack_tuple(builder, args[1]) if isinstance(shape, types.BaseTuple) else [args[1]]
            extents = [context.cast(builder, x, kind, types.intp) for x, kind in zip(given, kinds, strict=True)]
            strides = [context.get_constant(types.intp, context.get_abi_sizeof(context.get_data_type(dtype)))]
            for extent in reversed(extents[1:]):
                strides.insert(0, builder.mul(strides[0], extent))
            data = builder.inttoptr(args[0], array.data.type)
            arrayobj.populate_array(array, data, extents, strides, strides[-1], None)
            return array._getvalue()

        return array_type(types.int64, shape), codegen

    return view


floats, integers = _viewer(types.float64), _viewer(types.int64)


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


@intrinsic
def stack_doubles(typingctx: Any, count: Any) -> Any:
    """Address of `count` float64 on the stack of the calling function, gone when that returns."""
    signature = types.int64(types.int64)

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.ptrtoint(builder.alloca(ir.DoubleType(), args[0]), ir.IntType(64))

    return signature, codegen


STACK_LIMIT = 2**14  # numbers, 128 KiB: what a thread's stack has room for in any case

# Compiled code that owns no memory, only looks at it: numba then counts no references to arrays, which takes as long as
# the law of a few rods. `borrowing` functions must not create arrays, nor copy slices; what they call inherits that,
# unless it is `owning`. `inlined` is for the small ones that are called everywhere.
borrowing = compiled(_nrt=False)
inlined = compiled(_nrt=False, forceinline=True)
owning = compiled(_nrt=True)


def records_reader(dtype: np.dtype[Any]) -> Any:
    """A compiled function (address, shape or length) -> record array of this dtype."""
    return _viewer(numba.from_dtype(dtype))


@inlined
def copy(source: Any, target: Any) -> None:
    """Copy a one-dimensional array into another of its length."""
    for i in range(len(source)):
        target[i] = source[i]


def address_of(array: np.ndarray[Any, Any]) -> int:
    """Address of the first element; the caller keeps the array alive. Its rows must follow each other."""
    assert array.flags.c_contiguous, "compiled code reads arrays row by row"
    return int(array.ctypes.data)
