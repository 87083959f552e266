"""numba's types of lanes: W numbers side by side in one register, masks of W, and addresses of what lies in lanes.

Imported where something compiles; `lanes` has what kernels call. Nothing here contracts a product and a sum, and no
sum is taken across lanes: each lane has the bits of a single run.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from itertools import product
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.imputils import lower_builtin, lower_cast
from numba.core.typeconv import Conversion
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import models, register_model


class Lanes(types.Type):  # type: ignore[misc]
    """numba's type of `width` float64 side by side."""

    def __init__(self, width: int) -> None:
        self.width, self.bitwidth = width, 64 * width
        super().__init__(name=f"Lanes{width}")

    def unify(self, typingctx: Any, other: Any) -> Any:
        """A number with lanes is in each of them."""
        return self if isinstance(other, (types.Float, types.Integer)) else None

    def can_convert_from(self, typingctx: Any, other: Any) -> Any:
        """From a number."""
        return Conversion.safe if isinstance(other, (types.Float, types.Integer)) else None


class Mask(types.Type):  # type: ignore[misc]
    """numba's type of `width` booleans side by side."""

    def __init__(self, width: int) -> None:
        self.width = width
        super().__init__(name=f"Mask{width}")

    def unify(self, typingctx: Any, other: Any) -> Any:
        """A boolean with a mask is in each lane."""
        return self if isinstance(other, types.Boolean) else None

    def can_convert_from(self, typingctx: Any, other: Any) -> Any:
        """From a boolean."""
        return Conversion.safe if isinstance(other, types.Boolean) else None


class LaneRecord(types.Record):  # type: ignore[misc]
    """numba's type of a record whose reals are in lanes; its whole numbers are those of the first one."""

    def __init__(self, of: Any, width: int) -> None:
        fields = []
        for name, info in of.fields.items():
            kind: Any = Lanes(width)
            if isinstance(info.type, types.NestedArray):
                kind = types.NestedArray(kind, info.type.shape)
            elif isinstance(info.type, types.Integer):
                kind = info.type
            fields.append((name, {"type": kind, "offset": info.offset * width}))
        super().__init__(fields, of.size * width, aligned=False)

    @property
    def dtype(self) -> Any:
        """NumPy's, of its size."""
        return np.dtype(f"V{self.size}")


register_model(LaneRecord)(models.RecordModel)


class LaneAddress(types.Type):  # type: ignore[misc]
    """numba's type of an address of what lies in lanes: what is added to it counts once a lane.

    Attributes:
        width: number of lanes.
        varied: whether the structure's numbers are in lanes, too, or the same for all of them.
    """

    def __init__(self, width: int, varied: bool) -> None:
        self.width, self.varied = width, varied
        super().__init__(name=f"LaneAddress{width}{'varied' if varied else ''}")


def _registered(kind: Any, backend: Callable[[Any], Any]) -> None:
    @register_model(kind)
    class _Model(models.PrimitiveModel):  # type: ignore[misc]
        def __init__(self, manager: Any, frontend: Any) -> None:
            super().__init__(manager, frontend, backend(frontend))


_registered(Lanes, lambda kind: ir.VectorType(ir.DoubleType(), kind.width))
_registered(Mask, lambda kind: ir.VectorType(ir.IntType(1), kind.width))
_registered(LaneAddress, lambda kind: ir.IntType(64))


def _splat(builder: Any, value: Any, width: int) -> Any:
    """A value in each lane."""
    undefined = ir.Constant(ir.VectorType(value.type, width), ir.Undefined)
    one = builder.insert_element(undefined, value, ir.Constant(ir.IntType(32), 0))
    return builder.shuffle_vector(one, undefined, ir.Constant(ir.VectorType(ir.IntType(32), width), [0] * width))


def laned(context: Any, builder: Any, kind: Any, value: Any, width: int) -> Any:
    """A value of a kind as lanes or as a mask."""
    if isinstance(kind, (Lanes, Mask)):
        return value
    number = types.boolean if isinstance(kind, types.Boolean) else types.float64
    value = context.cast(builder, value, kind, number)
    if number is types.boolean:
        value = cgutils.as_bool_bit(builder, value)
    return _splat(builder, value, width)


@lower_cast(types.Float, Lanes)
@lower_cast(types.Integer, Lanes)
@lower_cast(types.Boolean, Mask)
def _cast(context: Any, builder: Any, kind: Any, into: Any, value: Any) -> Any:
    return laned(context, builder, kind, value, into.width)


def _operation(function: Any, emit: Any, of: Any = Lanes, into: Any = Lanes, count: int = 2) -> None:
    """An operation of one or two values, one of them at least in lanes, and others the same in each."""
    plain, number = ((types.Boolean,), types.boolean) if of is Mask else ((types.Float, types.Integer), types.float64)

    @infer_global(function)
    class _Cases(AbstractTemplate):  # type: ignore[misc]
        def generic(self, args: Any, kws: Any) -> Any:
            """By the width of what is in lanes."""
            widths = {one.width for one in args if isinstance(one, of)}
            if len(args) != count or len(widths) != 1 or not all(isinstance(one, (of, *plain)) for one in args):
                return None
            return signature(into(*widths), *(one if isinstance(one, of) else number for one in args))

    def lowered(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        width = sig.return_type.width
        values = [laned(context, builder, kind, x, width) for kind, x in zip(sig.args, args, strict=True)]
        return emit(builder, *values)

    for kinds in product((of, *plain), repeat=count):
        if of in kinds:
            lower_builtin(function, *kinds)(lowered)


def _ordered(sign: str) -> Callable[[Any, Any, Any], Any]:
    return lambda builder, a, b: builder.fcmp_ordered(sign, a, b)


for _plain, _in_place, _name in (
    (operator.add, operator.iadd, "fadd"),
    (operator.sub, operator.isub, "fsub"),
    (operator.mul, operator.imul, "fmul"),
    (operator.truediv, operator.itruediv, "fdiv"),
):
    for _function in (_plain, _in_place):
        _operation(_function, lambda builder, a, b, name=_name: getattr(builder, name)(a, b))
for _function, _sign in (
    (operator.gt, ">"),
    (operator.lt, "<"),
    (operator.ge, ">="),
    (operator.le, "<="),
    (operator.eq, "=="),
):
    _operation(_function, _ordered(_sign), into=Mask)
_operation(operator.ne, lambda builder, a, b: builder.fcmp_unordered("!=", a, b), into=Mask)
for _function, _name in (
    (operator.and_, "and_"),
    (operator.iand, "and_"),
    (operator.or_, "or_"),
    (operator.ior, "or_"),
):
    _operation(_function, lambda builder, a, b, name=_name: getattr(builder, name)(a, b), Mask, Mask)


def _intrinsic(name: str) -> Any:
    def emit(builder: Any, value: Any) -> Any:
        of = ir.FunctionType(value.type, [value.type])
        found = cgutils.get_or_insert_function(builder.module, of, f"llvm.{name}.v{value.type.count}f64")
        return builder.call(found, [value])

    return emit


def _finite(builder: Any, value: Any) -> Any:
    size = _intrinsic("fabs")(builder, value)
    return builder.fcmp_ordered("<", size, ir.Constant(size.type, [float("inf")] * size.type.count))


_operation(operator.neg, lambda builder, a: builder.fneg(a), count=1)
_operation(np.sqrt, _intrinsic("sqrt"), count=1)
_operation(abs, _intrinsic("fabs"), count=1)
_operation(np.isfinite, _finite, into=Mask, count=1)
_operation(operator.not_, lambda builder, a: builder.not_(a), Mask, Mask, count=1)
# With Python's choice between equal ones, and of NaN.
_operation(max, lambda builder, a, b: builder.select(builder.fcmp_ordered(">", b, a), b, a))
_operation(min, lambda builder, a, b: builder.select(builder.fcmp_ordered("<", b, a), b, a))


@infer_global(operator.add)
class _Behind(AbstractTemplate):  # type: ignore[misc]
    def generic(self, args: Any, kws: Any) -> Any:
        """An address and what is added to it."""
        if len(args) == 2 and isinstance(args[0], LaneAddress) and isinstance(args[1], types.Integer):
            return signature(args[0], args[0], types.int64)
        return None


@lower_builtin(operator.add, LaneAddress, types.Integer)
def _behind(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    return builder.add(args[0], builder.mul(args[1], ir.Constant(ir.IntType(64), sig.args[0].width)))


def _is_in_lanes(kind: Any) -> bool:
    """Return whether a value of a kind, numbers of an array, or fields of a view are in lanes."""
    return any(hasattr(one, "width") for one in (kind, getattr(kind, "dtype", None), getattr(kind, "lanes", None)))


def alone(of: Any, result: Any) -> Any:
    """Return the type of a function that is another one's, and in lanes gives `result` and does nothing."""

    class Choice(AbstractTemplate):  # type: ignore[misc]
        key = object()

        def generic(self, args: Any, kws: Any) -> Any:
            """By whether something lies in lanes."""
            if any(map(_is_in_lanes, args)):
                return signature(self.context.resolve_value_type(result), *args)
            return of.get_call_type(self.context, args, kws)

    @lower_builtin(Choice.key, types.VarArg(types.Any))
    def lowered(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        if any(map(_is_in_lanes, sig.args)):
            return context.get_constant_generic(builder, sig.return_type, result)
        return context.get_function(of, sig)(builder, args)

    return types.Function(Choice)
