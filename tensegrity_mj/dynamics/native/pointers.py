"""Raw addresses in compiled code: how one compiled engine calls any law, built-in or Python, at the speed of C.

A law is a C function

    int64 law(double time, int64 nodes, int64 velocities, int64 context, int64 command, int64 report)

whose integers are addresses of float64 arrays: nodes and velocities (N, 3) in, command (M,) and report (5,)
(see `law.Report`) out; `context` is the address of the data that the law keeps. External forces f(t) are C functions
`int64 forces(double time, int64 out)` that write (N, 3).
"""

from __future__ import annotations

import ctypes
import functools
import math
from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.dynamics.native.compiling import compiled, intrinsic

LAW_SIGNATURE = "int64(float64, int64, int64, int64, int64, int64)"
TIMED = "int64(float64, int64, int64, int64)"  # of elements, and of models that integrators call
LOAD_SIGNATURE = "int64(float64, int64)"


def reader_of(dtype: Any) -> Any:
    """A compiled function (address, shape or length) -> array of this dtype, records or numbers, which owns nothing.

    Numbers behind an address of what lies in lanes (`native.lanes`) are in lanes.
    """

    @intrinsic
    def view(typingctx: Any, address: Any, shape: Any) -> Any:
        import numba
        from numba import types
        from numba.core import cgutils
        from numba.np import arrayobj

        kind, counted = numba.from_dtype(np.dtype(dtype)), types.int64
        if hasattr(address, "width"):
            from tensegrity_mj.dynamics.native.lane_types import Lanes

            kind, counted = Lanes(address.width), address
        kinds = list(shape) if isinstance(shape, types.BaseTuple) else [shape]
        array_type = types.Array(kind, len(kinds), "C")

        def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            array = context.make_array(array_type)(context, builder)
            given = cgutils.unpack_tuple(builder, args[1]) if isinstance(shape, types.BaseTuple) else [args[1]]
            extents = [context.cast(builder, x, one, types.intp) for x, one in zip(given, kinds, strict=True)]
            strides = [context.get_constant(types.intp, context.get_abi_sizeof(context.get_data_type(kind)))]
            for extent in reversed(extents[1:]):
                strides.insert(0, builder.mul(strides[0], extent))
            data = builder.inttoptr(args[0], array.data.type)
            arrayobj.populate_array(array, data, extents, strides, strides[-1], None)
            return array._getvalue()

        return array_type(counted, shape), codegen

    return view


floats, integers, octets = reader_of("f8"), reader_of("i8"), reader_of("u1")


def call_by_address(parameters: str, *given: Any) -> Any:
    """Return what numba wants of an intrinsic (address, *arguments) -> int64 that calls the C function at the address.

    Args:
        parameters: a letter each, d for float64 and i for int64.
        given: numba's types of the last ones; addresses of what lies in lanes are whole numbers to a C function.
    """
    from llvmlite import ir
    from numba import types

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        integer = ir.IntType(64)
        kind = ir.FunctionType(integer, [ir.DoubleType() if one == "d" else integer for one in parameters])
        return builder.call(builder.inttoptr(args[0], kind.as_pointer()), args[1:])

    kinds = [{"d": types.float64, "i": types.int64}[one] for one in parameters]
    for place, one in enumerate(given, len(kinds) - len(given)):
        kinds[place] = one if hasattr(one, "width") else kinds[place]
    return types.int64(types.int64, *kinds), codegen


@intrinsic
def call_law(
    typingctx: Any, function: Any, time: Any, nodes: Any, velocities: Any, context: Any, command: Any, report: Any
) -> Any:
    """Call the law at address `function`; the arguments are those of the C function above."""
    return call_by_address("diiiii", nodes, velocities, context, command, report)


@intrinsic
def call_load(typingctx: Any, function: Any, time: Any, out: Any) -> Any:
    """Call the force function at address `function`."""
    return call_by_address("di")


@intrinsic
def call_timed(typingctx: Any, function: Any, time: Any, one: Any, other: Any, third: Any) -> Any:
    """Call the function of a time and three addresses, `TIMED`, that is at address `function`."""
    return call_by_address("diii", one, other, third)


@intrinsic
def address(typingctx: Any, array: Any) -> Any:
    """Address of the first element, in compiled code."""
    from llvmlite import ir
    from numba import types

    kind = types.int64
    if hasattr(array.dtype, "width"):
        from tensegrity_mj.dynamics.native.lane_types import LaneAddress

        kind = LaneAddress(array.dtype.width, False)

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.ptrtoint(context.make_array(sig.args[0])(context, builder, args[0]).data, ir.IntType(64))

    return kind(array), codegen


@intrinsic
def stack_doubles(typingctx: Any, count: Any) -> Any:
    """Address of `count` float64 on the stack of the calling function, gone when that returns."""
    from llvmlite import ir
    from numba import types

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.ptrtoint(builder.alloca(ir.DoubleType(), args[0]), ir.IntType(64))

    return types.int64(types.int64), codegen


def own_integer(name: str) -> Any:
    """A compiled function () -> int64: the value of a variable of the C function's own, which Python sets.

    `CFunction.variable(name)` is its address. Code that is kept holds no address of the process that compiled it.
    """

    @intrinsic
    def read(typingctx: Any) -> Any:
        from llvmlite import ir
        from numba import types

        def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            place = builder.module.globals.get(name)
            if place is None:
                place = ir.GlobalVariable(builder.module, ir.IntType(64), name)
                place.linkage, place.initializer = "common", ir.Constant(ir.IntType(64), 0)
            return builder.load(place)

        return types.int64(), codegen

    return read


STACK_LIMIT = 2**14  # numbers, 128 KiB: what a thread's stack has room for in any case

# Compiled code that owns no memory, only looks at it: numba then counts no references to arrays, which takes as long as
# the law of a few rods. `borrowing` functions must not create arrays, nor copy slices; what they call inherits that,
# unless it is `owning`. `inlined` is for the small ones that are called everywhere.
borrowing = compiled(_nrt=False)
inlined = compiled(_nrt=False, forceinline=True)
owning = compiled(_nrt=True)


@inlined
def copy(source: Any, target: Any) -> None:
    """Copy a one-dimensional array into another of its length."""
    for i in range(len(source)):
        target[i] = source[i]


@functools.lru_cache(128)  # threads come and go
def array_at(address: int, *shape: int) -> Array:
    """float64 at an address, for Python: an array that owns nothing."""
    return np.ctypeslib.as_array((ctypes.c_double * math.prod(shape)).from_address(address)).reshape(shape)


def address_of(array: np.ndarray[Any, Any]) -> int:
    """Address of the first element; the caller keeps the array alive. Its rows must follow each other."""
    assert array.flags.c_contiguous, "compiled code reads arrays row by row"
    if array.size and array.flags.writeable:  # a fourth of the time
        return ctypes.addressof(ctypes.c_char.from_buffer(array.data))
    return int(array.ctypes.data)
