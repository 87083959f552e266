"""Reads a [structure], and what of it is not a table of its fields: supports by their kind, sections as tubes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from tensegrity_mj.basics.fields import item_of
from tensegrity_mj.model.members import Rod, Support
from tensegrity_mj.model.section import Section
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.model.text.codec import READERS, WRITERS, built, fields_of, read_fields, read_key
from tensegrity_mj.model.text.keys import STRUCTURE_KEYS, SUPPORT_KEYS, TUBE_KEYS
from tensegrity_mj.model.text.table import Table

SUPPORTS: dict[str, Callable[..., Support]] = {
    "free": Support.free,
    "pinned": Support.pinned,
    "constrained": Support.constrained,
}
PINNED = Support.pinned().directions


def structure_of(table: Table, name: str) -> Structure:
    """The structure of a table, called `name` unless it says otherwise."""
    nodes = table.inside("nodes", None, "a table of node name = [x, y, z]")
    keys = item_of(Structure).keys
    given = {key: read_key(keys[key], table, key) for key in STRUCTURE_KEYS if key in table.data and key != "nodes"}
    return Structure(**{"name": name, "nodes": {key: nodes.vector(key) for key in nodes.data}, **given})


def _section(table: Table) -> Section:
    """A section by its area and second moment, or as a round tube."""
    if "outer_radius" not in table.data and "wall" not in table.data:
        return read_fields(Section, table)
    table.allow(TUBE_KEYS)
    given = {key: table.number(key) for key in TUBE_KEYS if key in table.data or key != "yield_stress"}
    return built(table, Section, lambda: Section.tube(**given))


def _support(table: Table) -> Support:
    kind = table.choice("kind", SUPPORT_KEYS)
    table.allow(SUPPORT_KEYS[kind])
    keys = item_of(Support).keys
    given = {key: read_key(keys[key], table, key) for key in SUPPORT_KEYS[kind][1:] if key in table.data or key == "D"}
    return built(table, Support, lambda: SUPPORTS[kind](**given))


def _rod_table(rod: Rod) -> dict[str, Any]:
    table = fields_of(rod)
    support = table.pop("support")
    return table if support == Support.free() else table | {"support": support}


def _support_table(support: Support) -> dict[str, Any]:
    pinned = support.directions == PINNED and support.values is None
    kind = "free" if not support.directions else "pinned" if pinned else "constrained"
    given = {key: value for key, value in vars(support).items() if value is not None}
    if kind == "constrained":
        given["D"] = support.directions
    return {"kind": kind} | {key: given[key] for key in ("sigma", "D", "values", "plane") if key in given}


READERS[Section], READERS[Support] = _section, _support
WRITERS[Rod], WRITERS[Support] = _rod_table, _support_table
