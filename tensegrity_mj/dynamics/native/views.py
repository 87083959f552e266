"""Tables of numbers and arrays that compiled code reads by named fields.

    Spring, pack_spring = view_of("Spring", count="size", stiffness="real", places=("f8", "count", 3))
    packed = pack_spring(count=2, stiffness=10.0, places=np.zeros((2, 3)))

and in compiled code, which gets `packed.address`,

    spring = Spring(address)
    for k in range(spring.count):
        pull = times(-spring.stiffness, row_of(spring.places, k))

A table is int64 numbers: sizes, the bits of reals, and addresses of arrays. A view is its address and nothing else; its
fields are resolved while it is compiled, and are read from where the table is. Compiled code may take the sizes and
addresses of a table for constants: a table that changes them must not be read by a view. Reals may be written.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from tensegrity_mj.dynamics.native.compiling import intrinsic
from tensegrity_mj.dynamics.native.pointers import address_of

# A field: "size" (a whole number), "real", or an array as (dtype, extents...), each a size by name or a number.
Field = str | tuple[Any, ...]
# Of the code that a view compiles to: what is kept from an older one is not taken.
STAMP = zlib.crc32(Path(__file__).with_name("view_types.py").read_bytes())
Fields = tuple[tuple[str, Field], ...]


class Table:
    """A table and the arrays that it leads to, to be kept alive while it is read.

    Attributes:
        table: (fields,) int64.
        arrays: by field.
    """

    def __init__(self, view: str, fields: Fields, values: dict[str, Any]) -> None:
        assert values.keys() == dict(fields).keys(), f"{view}: given {sorted(values)}"
        self.arrays: dict[str, Any] = {}
        self.table = np.zeros(len(fields), np.int64)
        for place, (name, field) in enumerate(fields):
            if isinstance(field, str):
                kind = np.int64 if field == "size" else np.float64
                self.table[place] = np.array([values[name]], kind).view(np.int64)[0]
                continue
            shape = tuple(values[extent] if isinstance(extent, str) else extent for extent in field[1:])
            array = np.ascontiguousarray(values[name], dtype=field[0])
            assert array.shape == shape, f"{view}: {name} has shape {array.shape}, not {shape}"
            self.arrays[name] = array
            self.table[place] = address_of(array)

    @property
    def address(self) -> int:
        """Of the table."""
        return address_of(self.table)


def view_of(name: str, **fields: Field) -> tuple[Any, Callable[..., Table]]:
    """A view by its fields: a compiled function (address) -> view, and a function of the fields' values -> `Table`."""
    given: Fields = tuple(fields.items())

    @intrinsic
    def at(typingctx: Any, address: Any) -> Any:
        from numba import types

        from tensegrity_mj.dynamics.native.view_types import View

        assert STAMP >= 0  # what is compiled depends on it

        def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            return args[0]

        return View(name, given)(types.int64), codegen

    def pack(**values: Any) -> Table:
        return Table(name, given, values)

    return at, pack
