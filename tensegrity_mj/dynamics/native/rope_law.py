"""Commands of a law to a string with mass, spread over its parts, compiled.

A law knows of ropes as massless strings (`Structure.massless`), and commands each as one: a force density u is one of
the whole, T = u L with L the length of all its parts, so that its rest length is L - T/k, of which each part has its
share. Tensions of the parts differ from T by what moves their masses; their mean by shares is T.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tensegrity_mj.dynamics.native.compiling import c_function
from tensegrity_mj.dynamics.native.pointers import LAW_SIGNATURE, borrowing, call_law, floats
from tensegrity_mj.dynamics.native.vectors import dot, minus, row_of
from tensegrity_mj.dynamics.native.views import Table, view_of
from tensegrity_mj.model.structure import Structure

_Ropes, _pack_ropes = view_of(
    "RopeLaw",
    law="size",
    context="size",
    densities="size",  # whether the law returns force densities
    node_count="size",
    segments=("i8", "segment_count", 2),
    limits=("i8", "given_count", 2),  # first segment of each string as given, and one behind the last
    shares=("f8", "string_count"),
    firsts=("i8", "first_count"),  # likewise of its parts, the last behind all
    compliance=("f8", "given_count"),
)


@borrowing
def spread(table: int, nodes_at: int, command_at: int) -> None:
    """Make rest lengths of the parts of a command to strings as given, in its place."""
    own = _Ropes(table)
    nodes, command = floats(nodes_at, (own.node_count, 3)), floats(command_at, (own.string_count,))
    firsts, shares, segments, limits, compliance = own.firsts, own.shares, own.segments, own.limits, own.compliance
    for n in range(own.given_count):
        g = own.given_count - 1 - n  # from the last on: parts of a string are never before its own command
        rest = command[g]
        if own.densities:
            length = 0.0
            for p in range(limits[g, 0], limits[g, 1]):
                span = minus(row_of(nodes, segments[p, 1]), row_of(nodes, segments[p, 0]))
                length += np.sqrt(dot(span, span))
            rest = length * (1.0 - rest * compliance[g])
        for m in range(firsts[g], firsts[g + 1]):
            command[m] = shares[m] * rest


@c_function(LAW_SIGNATURE, "a law on strings with mass")
def _rope_law(t, nodes, velocities, context, command, report):  # type: ignore[no-untyped-def]
    own = _Ropes(context)
    status = call_law(own.law, t, nodes, velocities, own.context, command, report)
    spread(context, nodes, command)
    return status


def rope_law(structure: Structure, law: int, context: int, densities: bool) -> tuple[Any, Table]:
    """The C function to be put around a law on `structure.massless`, and its table; together they command rest lengths.

    Args:
        law, context: addresses of the law's C function and of its data.
        densities: whether it returns force densities, or rest lengths.
    """
    shares = {rope.string.name: rope.shares for rope in structure.ropes}
    parts = [shares.get(string.name, np.ones(1)) for string in structure.massless.strings]
    firsts = np.cumsum([0, *map(len, parts)])
    ranges = structure.paths.ranges
    packed = _pack_ropes(
        law=law,
        context=context,
        densities=densities,
        node_count=len(structure.nodes),
        segments=structure.paths.nodes,
        limits=np.stack([ranges[firsts[:-1], 0], ranges[firsts[1:] - 1, 1]], axis=1),
        shares=np.concatenate(parts),
        firsts=firsts,
        compliance=1.0 / structure.massless.stiffness,
    )
    return _rope_law, packed
