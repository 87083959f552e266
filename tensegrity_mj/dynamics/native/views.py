"""Tables of numbers and arrays that compiled code reads by named fields.

    Spring, pack_spring = view_of("Spring", stiffness="real", places=("f8", "count", 3))
    packed = pack_spring(stiffness=10.0, places=np.zeros((2, 3)))

and in compiled code, which gets `packed.address`,

    spring = Spring(address)
    for k in range(spring.count):
        pull = times(-spring.stiffness, row_of(spring.places, k))

`count` is the number of rows of `places`: a size that is an extent of an array is a field of its own, in front of the
first array that has it, and is that array's unless it is set.

A table is int64 numbers: sizes, the bits of reals, and addresses of arrays. A view is its address and nothing else; its
fields are resolved while it is compiled, and are read from where the table is. Compiled code may take the sizes and
addresses of a table for constants: one that changes them is read by a `changing_view` alone, whose sizes and arrays are
to be taken once, before a loop. Reals and states may be written; setting an array of a changing view sets its address.
"""

from __future__ import annotations

import functools
import math
import zlib
from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tensegrity_mj.dynamics.native.compiling import intrinsic
from tensegrity_mj.dynamics.native.pointers import address_of

# A field: "size" (a whole number: of an array, a choice, an address), "state" (one that compiled code changes), "table"
# (the address of another), "real", or an array as (dtype, extents...), each a size by name or a number. In lanes
# (`native.lanes`) arrays of reals have one of each a lane, but for the names in `SAME`; and so have "each",
# which are reals elsewhere, and of which the table then has addresses.
Field = str | tuple[Any, ...]
# Version of the code that a view compiles to: compiled code of an older one is not used.
STAMP = zlib.crc32(Path(__file__).with_name("view_types.py").read_bytes())
Fields = tuple[tuple[str, Field], ...]
REALS = ("real", "each")
# What all lanes have in common where a structure's numbers do not vary.
SAME = frozenset(
    ("stiffness", "compliance", "damping", "gravity", "max_force_density", "min_rest_length", "winch_reach")
)
ALIGNMENT = 64  # bytes of the widest register
_NUMBERS = {number: number for number in range(64)}  # that extents may be


def fields_of(before: Fields = (), /, **more: Field) -> Fields:
    """Fields behind those before, with the sizes that are extents of theirs and no field yet."""
    found = dict(before)
    for name, field in more.items():
        if not isinstance(field, str):
            extents = [extent for extent in field[1:] if isinstance(extent, str) and extent not in more]
            found |= {extent: "size" for extent in extents if extent not in found}
        found[name] = field
    return tuple(found.items())


@functools.cache
def _layout(fields: Fields) -> dict[str, tuple[int, str, Any, tuple[Any, ...]]]:
    """Return place, kind ("" for an array), dtype and extents of each field, by its name."""
    return {
        name: (place, field, None, ()) if isinstance(field, str) else (place, "", np.dtype(field[0]), field[1:])
        for place, (name, field) in enumerate(fields)
    }


class Table:
    """A table and the arrays that it leads to, to be kept alive while it is read; its fields by their names.

    Attributes:
        table: (fields,) int64.
        arrays: by field.
        address: of the table.
    """

    def __init__(self, view: str, fields: Fields) -> None:
        self.view, self._layout = view, _layout(fields)
        self.table = np.zeros(len(fields), np.int64)
        self._reals = self.table.view(np.float64)
        self.arrays: dict[str, Any] = {}
        self.sizes: dict[Any, Any] = dict(_NUMBERS)  # the whole numbers as they were set, and those among extents
        self.address = address_of(self.table)

    def place(self, name: str) -> int:
        """Return the place of a field in the table."""
        return self._layout[name][0]

    def __getitem__(self, name: str) -> Any:
        """Return the array or the number of a field."""
        place, kind, _, _ = self._layout[name]
        if not kind:
            return self.arrays[name]
        return float(self._reals[place]) if kind in REALS else int(self.table[place])

    def __setitem__(self, name: str, value: Any) -> None:
        """Set one field, as `set` does."""
        self.set(**{name: value})

    def set(self, **values: Any) -> None:
        """Set several fields, sizes before arrays; a size that was never set is that of the first array with it.

        An array is C-ordered, of the field's dtype and shape. A size or a state that is an address may be given as what
        is there, a table or an array, which is kept alive.
        """
        layout, sizes, table = self._layout, self.sizes, self.table
        for name, value in values.items():
            place, kind, _, _ = layout[name]
            if kind in REALS:
                self._reals[place] = value
            elif kind:
                if isinstance(value, Table | np.ndarray):
                    self.arrays[name] = value
                    value = address_of(value) if isinstance(value, np.ndarray) else value.address
                table[place] = sizes[name] = value
        for name, value in values.items():
            place, kind, dtype, extents = layout[name]
            if kind:
                continue
            shape = tuple(map(sizes.get, extents))
            if None in shape:
                for one, size in zip(extents, value.shape, strict=False):
                    if one not in sizes:
                        table[layout[one][0]] = sizes[one] = size
                shape = tuple(map(sizes.get, extents))
            if value.shape != shape or (value.dtype is not dtype and value.dtype != dtype):
                raise AssertionError(f"{self.view}: {name} is {value.dtype} {value.shape}, not {dtype} {shape}")
            self.arrays[name] = value
            table[place] = address_of(value)

    def in_lanes(self, tables: Sequence[Table], varied: bool) -> Table:
        """A table for `native.lanes`, with the reals of these tables in its lanes, and all else of this one.

        `varied`: whether records, and arrays that are the SAME where it is False, have lanes.
        """
        made = Table.__new__(Table)
        made.view, made._layout, made.sizes = self.view, self._layout, dict(self.sizes)
        made.table, made.arrays = self.table.copy(), dict(self.arrays)
        made._reals, made.address = made.table.view(np.float64), address_of(made.table)
        for name, (_, kind, dtype, _) in self._layout.items():
            if kind != "each" and (kind or dtype.kind == "i" or not (varied or (dtype == "f8" and name not in SAME))):
                continue
            values = [np.asarray(one[name]) for one in tables]
            if not kind and dtype.names:
                values = [value.view(np.float64).reshape(len(value), dtype.itemsize // 8) for value in values]
            out = lanes_of(values[0], len(tables))
            for lane, value in enumerate(values[1:], 1):
                out[..., lane] = value
            made.lend(name, out)
        return made

    def alike(self, apart: Collection[str] = ()) -> tuple[Any, ...]:
        """Key of a table, equal for those that may share lanes: of all but reals and the fields `apart`."""
        found: list[Any] = []
        for name, (place, kind, dtype, _) in self._layout.items():
            if kind and kind != "each" and name not in apart:
                found.append(int(self.table[place]))
            elif not kind and dtype.names:
                array = self.arrays[name]
                found += [array[part].tobytes() for part in dtype.names if dtype[part].kind == "i"]
            elif not kind and dtype.kind == "i":
                found.append(self.arrays[name].tobytes())
        return tuple(found)

    def lend(self, name: str, array: np.ndarray[Any, Any]) -> None:
        """Set the address of an array in lanes."""
        self.arrays[name] = array
        self.table[self._layout[name][0]] = address_of(array)

    def take(self, other: Table) -> None:
        """Take over what another table of these fields has set, and share its arrays."""
        given = other.table != 0
        self.table[given] = other.table[given]
        self.arrays |= other.arrays
        self.sizes |= other.sizes


def lanes_of(array: np.ndarray[Any, Any], width: int, blocks: Sequence[int] = ()) -> np.ndarray[Any, Any]:
    """An array (*blocks, ..., width) of float64 with this one (...) in each lane, where registers can load it."""
    shape = (*blocks, *array.shape, width)
    room = np.empty(math.prod(shape) + ALIGNMENT // 8)
    first = -room.ctypes.data % ALIGNMENT // 8
    out = room[first : first + math.prod(shape)].reshape(shape)
    out[:] = array[..., None]
    return out


def view_of(name: str, **fields: Field) -> tuple[Any, Callable[..., Table]]:
    """A view by its fields: a compiled function (address) -> view, and a function of the fields' values -> `Table`."""
    given = fields_of(**fields)

    def pack(**values: Any) -> Table:
        for key, value in values.items():
            if not isinstance(fields.get(key, ""), str):
                values[key] = np.ascontiguousarray(value, dtype=fields[key][0])
        table = Table(name, given)
        table.set(**values)
        assert values.keys() | table.sizes.keys() >= fields.keys(), f"{name}: given {sorted(values)}"
        return table

    return _viewer(name, given, True), pack


def changing_view(name: str, fields: Fields) -> Any:
    """A compiled function (address) -> view of a table whose sizes and addresses may change."""
    return _viewer(name, fields, False)


def _viewer(name: str, given: Fields, fixed: bool) -> Any:
    @intrinsic
    def at(typingctx: Any, address: Any) -> Any:
        from numba import types

        from tensegrity_mj.dynamics.native.view_types import View

        assert STAMP >= 0  # what is compiled depends on it
        typingctx.refresh()  # attributes of views, just imported

        def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            return args[0]

        if hasattr(address, "width"):
            return View(name, given, True, address, () if address.varied else SAME)(address), codegen
        return View(name, given, fixed)(types.int64), codegen

    return at
