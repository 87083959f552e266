"""MATLAB's data files (.mat) of level 5: numbers, and fields of structures, by the names of STEDY and MOTES.

The reader is our own: those of libraries make what a file's headers claim, such as a list of 10⁹ cells of a file of 100
bytes. Here little is made that is not in the file: arrays are views of it, structures of one element are gone into,
and all else (cells, texts, functions, objects) is listed by its name and passed over.
"""

from __future__ import annotations

import math
import os
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from tensegrity_mj.basics import matfile
from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.files import checked, content_of, replacing
from tensegrity_mj.errors import FormatError, StructureError, printable
from tensegrity_mj.exchange.importing import AXES, Draft, ImportOptions, held_axes
from tensegrity_mj.exchange.matlab import Variables, draft_of
from tensegrity_mj.exchange.tables import left_out
from tensegrity_mj.model.rods import own_masses
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure_checks import check_bars_alone

MOST_BYTES, MOST_UNPACKED = 20_000_000, 100_000_000  # of a file, and of all that is in it
MOST_DEPTH = 4  # of structures in each other
MATRIX, COMPRESSED = 14, 15
TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
CELL, STRUCT, OBJECT, CHAR, SPARSE, DOUBLE, LAST_NUMBER = 1, 2, 3, 4, 5, 6, 15
COMPLEX = 0x0800


class Broken(Exception):
    """Data that are no level 5 data."""


def read(path: Path, options: ImportOptions) -> Draft:
    """The draft of a .mat file.

    Raises:
        FormatError: for a file of another level, one that is broken or too large, or without what a scene needs.
    """
    content = content_of(path, MOST_BYTES)
    if content[:8] == b"\x89HDF\r\n\x1a\n" or b"MATLAB 7.3" in content[:116]:
        raise FormatError(f"{path}: a MATLAB file of version 7.3, which is not read; save it with -v7")
    if len(content) < 128 or content[126:128] not in (b"IM", b"MI"):
        raise FormatError(f"{path}: no MATLAB file of level 5, as save writes it; save it with -v7")
    values: dict[str, Array] = {}
    unread: list[str] = []
    try:
        order = "<" if content[126:128] == b"IM" else ">"
        left = MOST_UNPACKED
        for kind, data in _elements(content[128:], order):
            if kind == COMPRESSED:
                unpack = zlib.decompressobj()
                data = unpack.decompress(data, left + 1)
                left -= len(data)
                if left < 0:
                    raise FormatError(
                        f"{path}: more than {MOST_UNPACKED / 1e6:g} MB when unpacked; save the variables that are "
                        "named in docs/exchange.md alone"
                    )
                inner = list(_elements(data, order))
                if len(inner) != 1:
                    raise Broken("a packed variable that is none")
                kind, data = inner[0]
            if kind == MATRIX:
                _add_matrix(data, order, "", values, unread, 0)
    except (Broken, zlib.error, struct.error, ValueError, IndexError) as error:
        raise FormatError(
            f"{path}: a broken MATLAB file ({error or type(error).__name__}); save it again with -v7"
        ) from None
    return draft_of(Variables(path, values, unread), options)


def _elements(data: bytes, order: str) -> Iterator[tuple[int, bytes]]:
    """The types and contents of the elements that data consist of."""
    at = 0
    while at + 8 <= len(data):
        kind, size = struct.unpack_from(f"{order}II", data, at)
        start = at + 8
        if kind >> 16:  # small: type and size in four bytes, the content in the next four
            kind, size, start = kind & 0xFFFF, kind >> 16, at + 4
            at += 8
            if size > 4:
                raise Broken("an element that is longer than it can be")
        else:
            # Packed ones alone are not filled up to eight bytes.
            at = start + size + (0 if kind == COMPRESSED else -size % 8)
        if start + size > len(data):
            raise Broken(f"it ends within an element of {size} bytes")
        yield kind, data[start : start + size]


def _numbers(kind: int, data: bytes, order: str) -> Array:
    if kind not in TYPES:
        raise Broken(f"numbers of type {kind}")
    return np.frombuffer(data, np.dtype(f"{order}{TYPES[kind]}"))


def _text(data: bytes) -> str:
    return printable(data.split(b"\0")[0].decode("latin-1"))


def _add_matrix(data: bytes, order: str, place: str, values: dict[str, Array], unread: list[str], depth: int) -> None:
    """Add what a variable holds, under its name or that of the field, or its name to what is not read."""
    parts = list(_elements(data, order))
    if not parts:
        return  # an empty field
    flags, shape = parts[0][1], _numbers(*parts[1], order).astype(int).tolist() if len(parts) > 2 else []
    word = struct.unpack(f"{order}I", flags[:4])[0]
    kind = word & 0xFF
    name = place or (_text(parts[2][1]) if len(parts) > 2 else "")
    if not name:
        return  # what MATLAB keeps for itself
    count = int(np.prod(shape, dtype=object)) if shape else 0
    if kind == STRUCT and count == 1 and depth < MOST_DEPTH:
        width = int(_numbers(*parts[3], order)[0])
        text = parts[4][1]
        names = [_text(text[at : at + width]) for at in range(0, len(text), width)] if width > 0 else []
        for field, (_, inner) in zip(names, parts[5:], strict=False):
            _add_matrix(inner, order, f"{name}.{field}", values, unread, depth + 1)
    elif DOUBLE <= kind <= LAST_NUMBER and not word & COMPLEX and len(parts) > 3:
        numbers = _numbers(*parts[3], order)
        if numbers.size != count:
            raise Broken(f"variable {name} has {numbers.size} numbers for a shape of {shape}")
        values[name] = numbers.reshape(shape, order="F")
    elif kind == SPARSE and len(parts) > 5 and not word & COMPLEX and len(shape) == 2:
        _add_sparse(name, shape, parts, order, values)
    elif DOUBLE <= kind <= LAST_NUMBER and not word & COMPLEX and count == 0:
        values[name] = np.zeros(shape)
    else:
        unread.append(name)


def _add_sparse(
    name: str, shape: list[int], parts: list[tuple[int, bytes]], order: str, values: dict[str, Array]
) -> None:
    rows, starts, numbers = (_numbers(*part, order) for part in parts[3:6])
    filled = 8 * shape[0] * shape[1] + sum(one.nbytes for one in values.values())
    if filled > MOST_UNPACKED or len(starts) != shape[1] + 1:
        raise Broken(f"the sparse variable {name} of shape {shape}")
    from scipy.sparse import csc_array

    used = int(starts[-1])
    whole = csc_array((numbers[:used], rows[:used].astype(np.int64), starts.astype(np.int64)), shape=tuple(shape))
    whole.check_format(full_check=True)
    values[name] = whole.toarray()


STRING_RADIUS = 1e-3  # m: STEDY has strings by radius and modulus, of which only E π r² counts
CARRIED_OVER = ("gravity", "initial_nodes", "initial_velocities", "constraints")


def save_mat(scene: Scene, path: str | os.PathLike[str]) -> tuple[Path, list[str]]:
    """Write N, C_b, C_s and what else STEDY and MOTES need; returns the path, and what the file does not hold.

    Raises:
        OptionError: for another suffix, or a place where no file can be written.
        FormatError: if the file cannot be written.
    """
    destination = checked(path, (".mat",), "MATLAB data")
    structure = scene.structure
    check_bars_alone(
        structure,
        "MATLAB data of STEDY and MOTES have two nodes a member, in C_b and C_s; save the scene as MJCF",
    )
    for string in structure.strings:
        if string.is_constant:
            raise StructureError(
                f"string '{string.name}' pulls with a constant force: MATLAB data of STEDY and MOTES have a "
                "stiffness for each string; save the scene as MJCF or CSV"
            )
    # Where supports move, the start is that of their motion, which is left out.
    start, speeds = (scene.nodes0, scene.velocities0) if not scene.motions else (structure.positions, 0 * scene.nodes0)
    nodes = start.T
    held, notes = held_axes(structure)
    lengths, rest = structure.string_lengths(start), structure.rest_lengths
    bars, strings = (_connectivity(pairs, nodes.shape[1]) for pairs in (structure.rod_nodes, structure.string_nodes))
    radii = np.array([rod.radius for rod in structure.rods])
    density = own_masses(structure) / (math.pi * radii**2 * structure.rod_lengths)
    fixed = np.array([[float(axis in held.get(name, ())) for name in structure.node_names] for axis in AXES])
    masses = {point.node: point.mass for point in structure.point_masses}
    ends = {name for rod in structure.rods for name in rod.nodes}
    lone = np.array([masses.get(name, 0.0) for name in structure.node_names if name not in ends])
    loose = [name for name in structure.node_names if name not in ends and held.get(name) != frozenset(AXES)]
    area = math.pi * STRING_RADIUS**2
    values: dict[str, Any] = {
        "N": nodes,
        "C_b": bars,
        "C_s": strings,
        "Cb": bars,
        "Cs": strings,
        "Nd0": speeds.T,
        "node_names": tuple(structure.node_names),
        "bar_names": tuple(rod.name for rod in structure.rods),
        "string_names": tuple(string.name for string in structure.strings),
        "fixedNodes": fixed,
        "g": np.array(scene.gravity)[:, None],
        "m": own_masses(structure),
        "k": structure.stiffness,
        "c": structure.damping,
        "s_0": rest,
        "ms": np.array([masses[name] for name in loose if name in masses]),
        "Mp_STEDY": lone,  # one for each node without a bar, fixed ones included
        "bars": {"r": radii, "rho": density},
        "strings": {
            "r": np.full(len(rest), STRING_RADIUS),
            "E": structure.stiffness * rest / area,
            "rLP": rest / lengths,
        },
        "tf": scene.duration,
    }
    if scene.loads and not callable(scene.loads) and all(load.angular_frequency == 0 for load in scene.loads):
        values["W"] = scene.nodal_forces(float(scene.start_time)).T
        notes += left_out(scene, (*CARRIED_OVER, "loads"))
    else:
        notes += left_out(scene, CARRIED_OVER)
    if ends & masses.keys():
        notes.append("point masses where rods end are left out")
    if any(rod.section is not None for rod in structure.rods):
        notes.append("sections of rods are left out")
    if structure.elastic.any():
        notes.append("bars are rigid in the file: what rods have of stiffness, damping and rest length is left out")
    with replacing(destination) as part:
        matfile.save_mat(part, values)
    return destination, notes


def _connectivity(pairs: Any, count: int) -> Any:
    matrix = np.zeros((len(pairs), count))
    rows = np.arange(len(pairs))
    matrix[rows, pairs[:, 0]], matrix[rows, pairs[:, 1]] = -1.0, 1.0
    return matrix
