"""Offsets of the fields of mjData and mjModel in memory, for compiled code that is given their addresses.

The offsets follow from the declarations in the package's own `mujoco.introspect` and the rules of C. Before they are
used they are checked against the addresses of the Python views of an MjData, so that another layout is an error
message and not a crash.
"""

from __future__ import annotations

import ctypes
from functools import cache
from typing import Any

import mujoco
import numpy as np

from tensegrity_mj.dynamics.native.pointers import address_of
from tensegrity_mj.errors import MissingLibraryError

_PLAIN: dict[str, Any] = {
    "int": ctypes.c_int,
    "float": ctypes.c_float,
    "char": ctypes.c_char,
    "unsigned char": ctypes.c_ubyte,
    "size_t": ctypes.c_size_t,
    "uintptr_t": ctypes.c_size_t,
    "uint64_t": ctypes.c_uint64,
    "mjtNum": ctypes.c_double,
    "mjtByte": ctypes.c_ubyte,
    "mjtBool": ctypes.c_bool,
    "mjtSize": ctypes.c_int64,
}


def _c_type(declared: Any) -> Any:
    from mujoco.introspect import ast_nodes, enums, structs

    if isinstance(declared, ast_nodes.PointerType):
        return ctypes.c_void_p
    if isinstance(declared, ast_nodes.ArrayType):
        kind = _c_type(declared.inner_type)
        for extent in reversed(declared.extents):
            kind = kind * extent
        return kind
    if isinstance(declared, ast_nodes.ValueType):
        name = declared.name.removeprefix("struct ")
        if name in _PLAIN:
            return _PLAIN[name]
        if name in enums.ENUMS:
            return ctypes.c_int
        for candidate in (name, name.rstrip("_")):
            if candidate in structs.STRUCTS:
                return _structure(candidate)
    if hasattr(declared, "fields"):  # an anonymous struct
        base = ctypes.Union if isinstance(declared, ast_nodes.AnonymousUnionDecl) else ctypes.Structure
        return type("anonymous", (base,), {"_fields_": [(f.name, _c_type(f.type)) for f in declared.fields]})
    raise MissingLibraryError(f"MuJoCo {mujoco.__version__} declares a type that is unknown here: {declared}")


@cache
def _structure(name: str) -> Any:
    from mujoco.introspect import structs

    fields = [(field.name, _c_type(field.type)) for field in structs.STRUCTS[name].fields]
    return type(name, (ctypes.Structure,), {"_fields_": fields})


def offset(structure: str, field: str) -> int:
    """Bytes from the start of an "mjData" or "mjModel" to one of its fields."""
    return int(getattr(_structure(structure), field).offset)


def check_layout(model: mujoco.MjModel, data: mujoco.MjData, fields: tuple[str, ...]) -> None:
    """Check that these arrays of mjData, its time, and the sizes and strings of mjModel are where the offsets say.

    Raises:
        MissingLibraryError: where one is not.
    """
    at = {"mjData": int(data._address), "mjModel": int(model._address)}

    def check(structure: str, field: str, kind: Any, value: Any) -> None:
        if kind.from_address(at[structure] + offset(structure, field)).value != value:
            raise MissingLibraryError(
                f"{structure}.{field} is not where MuJoCo {mujoco.__version__}'s own description says: install another "
                "version of mujoco (4.0 is known to work), or simulate runs one by one"
            )

    arrays = [("mjData", data, field) for field in fields]
    arrays += [("mjModel", model, field) for field in ("actuator_gainprm", "actuator_biasprm", "wrap_objid")]
    for structure, owner, field in arrays:
        if np.size(view := getattr(owner, field)):
            check(structure, field, ctypes.c_void_p, address_of(view))
    before = data.time
    try:
        data.time = 0.8414709848078965
        check("mjData", "time", ctypes.c_double, data.time)
    finally:
        data.time = before
    for field in ("nu", "nsite", "nbody", "ntendon", "nuserdata"):
        check("mjModel", field, ctypes.c_int64, getattr(model, field))
    check("mjModel", "signature", ctypes.c_uint64, model.signature)
