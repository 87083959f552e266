"""Reader of [structure], with the parts that are no tables of fields: supports by their kind, sections as tubes.

Keys that members share by `defaults` and `groups` are first written out in each of them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from tensegrity_mj.basics.checks import checked
from tensegrity_mj.basics.fields import item_of
from tensegrity_mj.basics.texts import closest
from tensegrity_mj.errors import FormatError, StructureError
from tensegrity_mj.model.members import PRESTRESS, Rod, String, Support
from tensegrity_mj.model.section import Section
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.model.structure_checks import names_of
from tensegrity_mj.model.text.codec import READERS, WRITERS, Table, built, fields_of, read_fields, read_key
from tensegrity_mj.model.text.keys import STRUCTURE_KEYS, SUPPORT_KEYS, TUBE_KEYS

SUPPORTS: dict[str, Callable[..., Support]] = {
    "free": Support.free,
    "pinned": Support.pinned,
    "constrained": Support.constrained,
}
PINNED = Support.pinned().directions
SHARING: dict[str, type] = {"rods": Rod, "strings": String}  # members with defaults and groups
# The keys that these members may share.
SHARED = {
    kind: [key for key in item_of(cls).keys if key not in ("name", "nodes", "group")] for kind, cls in SHARING.items()
}


def structure_of(table: Table, name: str) -> Structure:
    """The structure of a table, called `name` unless it says otherwise."""
    nodes = table.inside("nodes", None, "a table of node name = [x, y, z]")
    keys = item_of(Structure).keys
    whole = Table(table.data | _written_out(table), table.file, table.path, None)
    read = [key for key in STRUCTURE_KEYS if key in table.data and key in keys and key != "nodes"]
    given = {key: read_key(keys[key], whole, key) for key in read}
    return Structure(**{"name": name, "nodes": {key: nodes.vector(key) for key in nodes.data}, **given})


def _written_out(table: Table) -> dict[str, list[dict[str, Any]]]:
    """The rods and strings of a structure's table; what one of them leaves out is its group's, or else that of all."""
    defaults, groups = (table.inside(key) if key in table.data else None for key in ("defaults", "groups"))
    if defaults is not None:
        defaults.allow(list(SHARING))
    found: dict[str, list[dict[str, Any]]] = {}
    used: dict[str, dict[str, Any]] = {}
    for kind in SHARING:
        found[kind], of_group, of_all = [], {}, _shared(defaults, kind, kind)
        for member in table.tables(kind, None):
            group = member.text("group", "")
            if group and groups is not None and group not in groups.data:
                raise FormatError(
                    f"{member.where}: group = '{group}'{closest(group, groups.data)}; [{groups.path}] has "
                    f"{names_of(groups.data)}: give it a table there, too, an empty one where it shares nothing"
                )
            if group not in of_group:
                of_group[group] = _shared(groups, group, kind)
            found[kind].append(_over(_over(member.data, of_group[group]), of_all))
        used |= of_group
    unused = [] if groups is None else [group for group in groups.data if group not in used]
    for group in unused[:1]:
        raise FormatError(
            f"{table.where}.groups.{group}: no rod or string has group = '{group}'; give it to some, or leave it out"
        )
    return found


def _shared(tables: Table | None, name: str, kind: str) -> dict[str, Any]:
    """Read and check the keys that a table gives to a group, or to all, of a kind of members."""
    if tables is None or name not in tables.data:
        return {}
    place = f"{tables.path}.{name}" + (f" (of {kind})" if name != kind else "")
    table = Table(tables.data[name], tables.file, place, SHARED[kind])
    for key in table.data:
        one = item_of(SHARING[kind]).keys[key]
        checked(f"{place}: {key}", read_key(one, table, key), one.kind, StructureError)
    if len(given := [key for key in PRESTRESS if key in table.data]) > 1:
        raise StructureError(f"{place}: {' and '.join(given)} are given; give at most one of them")
    return table.data


def _over(own: dict[str, Any], shared: dict[str, Any]) -> dict[str, Any]:
    """A member's table over a shared one; of the three keys that say how taut a string is, the own one alone holds."""
    taut = any(key in own for key in PRESTRESS)
    return {key: value for key, value in shared.items() if not (taut and key in PRESTRESS)} | own


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
    if rod.stiffness is None:
        del table["damping"]
    last = {"support": Support.free(), "masses": ()}
    own = {key: table.pop(key) for key in last}
    return table | {key: held for key, held in own.items() if held != last[key]}


def _support_table(support: Support) -> dict[str, Any]:
    pinned = support.directions == PINNED and support.values is None
    kind = "free" if not support.directions else "pinned" if pinned else "constrained"
    given = {key: value for key, value in vars(support).items() if value is not None}
    if kind == "constrained":
        given["D"] = support.directions
    return {"kind": kind} | {key: given[key] for key in ("sigma", "D", "values", "plane") if key in given}


def _string_table(string: String) -> dict[str, Any]:
    table = fields_of(string)
    if string.curve:  # which has it
        del table["stiffness"]
    return table


READERS[Section], READERS[Support] = _section, _support
WRITERS[Rod], WRITERS[Support], WRITERS[String] = _rod_table, _support_table, _string_table
