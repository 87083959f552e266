"""Members of a structure from arrays of numbers, for `Structure.from_arrays`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from tensegrity_mj.basics.checks import real_array, sequence_of, shape_of
from tensegrity_mj.basics.texts import value_text
from tensegrity_mj.errors import StructureError
from tensegrity_mj.model.members import PointMass, Rod, String, Support


def members_from(given: Mapping[str, Any]) -> dict[str, Any]:
    """Nodes and members for the constructor of a structure, of the arguments of `Structure.from_arrays` by name.

    Raises:
        StructureError: for arrays of the wrong shape.
    """
    shape = shape_of(given["nodes"]) or ()
    if shape[1:] != (3,):
        shown = value_text(given["nodes"]) + (f" of shape {shape}" if shape else "")
        raise StructureError(f"nodes = {shown}; it must be an array of shape (N, 3) [m], a row a node")
    count = shape[0]
    positions = real_array("nodes", given["nodes"], (count, 3), "m", False, StructureError)
    names = [f"n{i + 1}" for i in range(count)]
    rods = index_pairs("rods", given["rods"], count)
    paths = index_pairs("strings", given["strings"], count, more=True)

    def columns(members: list[tuple[int, ...]], *what: str) -> list[tuple[Any, ...]]:
        """A row of these numbers for each member; None for what is not given."""
        size, found = len(members), []
        for key in what:
            if given[key] is None:
                found.append([None] * size)
            else:
                found.append(real_array(key, given[key], (size,), error=StructureError).tolist())
        return list(zip(*found, strict=True))

    def single(what: str, rows: Any) -> list[str]:
        return [names[i] for i, _ in index_pairs(what, [(i, i) for i in rows], count)]

    supports = given["supports"]
    held = [Support.free()] * len(rods) if supports is None else list(supports)
    if len(held) != len(rods):
        raise StructureError(f"supports: {len(held)} for {len(rods)} rods; give one a rod")
    bars = columns(rods, "rod_mass", "rod_radius")
    strings = columns(paths, "stiffness", "damping", "rest_length", "tension", "force_density")
    massive = [
        {"mass": mass, "segments": given["segments"]} if mass else {} for (mass,) in columns(paths, "string_mass")
    ]
    heavy = dict(given["point_masses"] or {})
    return {
        "nodes": dict(zip(names, map(tuple, positions.tolist()), strict=True)),
        "rods": tuple(
            Rod(f"r{a + 1}", (names[i], names[j]), mass, radius, support)
            for a, ((i, j), (mass, radius), support) in enumerate(zip(rods, bars, held, strict=True))
        ),
        "strings": tuple(
            String(f"s{a + 1}", tuple(names[i] for i in path), *strings[a], **massive[a])
            for a, path in enumerate(paths)
        ),
        "fixed_nodes": tuple(single("fixed_nodes", given["fixed_nodes"])),
        "point_masses": tuple(
            PointMass(name, m) for name, m in zip(single("point_masses", heavy), heavy.values(), strict=True)
        ),
    }


def index_pairs(what: str, values: Any, count: int, more: bool = False) -> list[tuple[int, ...]]:
    """The values as pairs (with `more`, paths of two or more) of node indices below `count`."""
    found = []
    for row, value in enumerate(sequence_of(what, values, StructureError)):
        try:
            path = tuple(int(x) for x in value)
            if len(path) < 2 or (len(path) > 2 and not more):
                raise ValueError
        except (TypeError, ValueError, OverflowError):
            need = "a pair of node indices" + ", or more" * more
            raise StructureError(f"{what}[{row}] = {value!r}: it must be {need}") from None
        if any(i != x for i, x in zip(path, value, strict=True)):
            raise StructureError(f"{what}[{row}] = {list(value)}: node indices must be integers")
        if not all(0 <= i < count for i in path):
            raise StructureError(f"{what}[{row}] = {path}: node indices run from 0 to {count - 1}")
        found.append(path)
    return found


def joined_rods(ends: Sequence[tuple[str, str]], rods_at: Mapping[str, tuple[int, ...]]) -> tuple[tuple[int, ...], ...]:
    """See `Structure.clusters`."""
    seen: set[int] = set()
    left = dict(rods_at)  # each node is visited once, however many rods it has
    found = []
    for first in range(len(ends)):
        if first in seen:
            continue
        cluster, todo = {first}, [first]
        while todo:
            for name in ends[todo.pop()]:
                new = [row for row in left.pop(name, ()) if row not in cluster]
                cluster.update(new)
                todo.extend(new)
        seen |= cluster
        found.append(tuple(sorted(cluster)))
    return tuple(found)
