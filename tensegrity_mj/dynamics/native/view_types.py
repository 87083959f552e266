"""numba's type of a view (`views`): the code that reads and writes its fields, imported where something compiles."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.core.typing.templates import AttributeTemplate
from numba.extending import infer_getattr, lower_getattr_generic, lower_setattr_generic, models, register_model
from numba.np import arrayobj

from tensegrity_mj.dynamics.native.lane_types import LaneRecord, Lanes

Field = str | tuple[Any, ...]

WORD = ir.IntType(64)


class View(types.Type):  # type: ignore[misc]
    """numba's type of a view; its name holds all that compiled code depends on.

    Attributes:
        fields: (name, field) of each, in the order of the table.
        fixed: whether sizes and addresses never change.
        lanes: the type of the address of a table in lanes, or None.
        same: names of the arrays of reals that lanes have in common.
    """

    def __init__(
        self, name: str, fields: tuple[tuple[str, Field], ...], fixed: bool, lanes: Any = None, same: Any = ()
    ) -> None:
        self.fields, self.fixed, self.lanes, self.same = fields, fixed, lanes, same
        of = ", ".join(f"{key}: {_text(field)}" for key, field in fields)
        super().__init__(name=f"{name}{'' if fixed else ' changing'}{'' if lanes is None else f' {lanes}'}({of})")

    def place(self, name: str) -> int:
        """Return the place of a field in the table; -1 for none."""
        return next((place for place, (key, _) in enumerate(self.fields) if key == name), -1)

    def type_of(self, name: str) -> Any:
        """numba's type of a field, or None."""
        field = dict(self.fields).get(name)
        if field is None:
            return None
        if field == "table" and self.lanes is not None:
            return self.lanes
        if field == "each" and self.lanes is not None:
            return Lanes(self.lanes.width)
        if isinstance(field, str):
            return types.float64 if field in ("real", "each") else types.int64
        kind = numba.from_dtype(np.dtype(field[0]))
        if self.lanes is not None and kind is types.float64 and name not in self.same:
            kind = Lanes(self.lanes.width)
        elif self.lanes is not None and self.lanes.varied and isinstance(kind, types.Record):
            kind = LaneRecord(kind, self.lanes.width)
        return types.Array(kind, len(field) - 1, "C")


def _text(field: Field) -> str:
    if isinstance(field, str):
        return field
    dtype = np.dtype(field[0])
    return f"{dtype.descr if dtype.names else dtype} {field[1:]} {dtype.itemsize}"


@register_model(View)
class _Model(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, WORD)


@infer_getattr
class _Attributes(AttributeTemplate):  # type: ignore[misc]
    key = View

    def generic_resolve(self, view: View, name: str) -> Any:
        """numba's type of a field."""
        return view.type_of(name)


def _address(builder: Any, view: View, value: Any, name: str, kind: Any) -> Any:
    at = builder.add(value, WORD(8 * view.place(name)))
    return builder.inttoptr(at, kind.as_pointer())


def _word(builder: Any, view: View, value: Any, name: str) -> Any:
    """A whole number or an address; where the view is fixed, the same whenever it is read."""
    word = builder.load(_address(builder, view, value, name, WORD))
    if view.fixed and dict(view.fields)[name] != "state":
        word.set_metadata("invariant.load", builder.module.add_metadata([]))
    return word


@lower_getattr_generic(View)
def _get(context: Any, builder: Any, view: View, value: Any, name: str) -> Any:
    field = dict(view.fields)[name]
    if field == "real" or (field == "each" and view.lanes is None):
        return builder.load(_address(builder, view, value, name, ir.DoubleType()))
    word = _word(builder, view, value, name)
    if field == "each":
        return builder.load(builder.inttoptr(word, context.get_value_type(view.type_of(name)).as_pointer()))
    if isinstance(field, str):
        return word
    kind = view.type_of(name)
    array = context.make_array(kind)(context, builder)
    extents = [_word(builder, view, value, extent) if isinstance(extent, str) else WORD(extent) for extent in field[1:]]
    in_lanes = isinstance(kind.dtype, (Lanes, LaneRecord))
    size = WORD(np.dtype(field[0]).itemsize * (view.lanes.width if in_lanes else 1))
    strides = [size]
    for extent in reversed(extents[1:]):
        strides.insert(0, builder.mul(strides[0], extent))
    data = builder.inttoptr(word, array.data.type)
    arrayobj.populate_array(array, data, extents, strides, size, None)
    return array._getvalue()


@lower_setattr_generic(View)
def _set(context: Any, builder: Any, signature: Any, args: Any, name: str) -> None:
    view = signature.args[0]
    field, kind = dict(view.fields)[name], view.type_of(name)
    elsewhere = not view.fixed and not isinstance(field, str)
    assert elsewhere or field in ("real", "each", "state"), f"{name} is not for compiled code to change"
    value = context.cast(builder, args[1], signature.args[1], kind)
    if field == "each" and view.lanes is not None:
        builder.store(value, builder.inttoptr(_word(builder, view, args[0], name), value.type.as_pointer()))
        return
    if elsewhere:  # an array, of which the table has the address
        kind, value = types.int64, builder.ptrtoint(context.make_array(kind)(context, builder, value).data, WORD)
    builder.store(value, _address(builder, view, args[0], name, context.get_value_type(kind)))
