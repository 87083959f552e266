"""Reads a [structure]."""

from __future__ import annotations

from tensegrity_mj.errors import StructureError
from tensegrity_mj.model.members import LIMITS, PointMass, Rod, String, Support
from tensegrity_mj.model.section import Section
from tensegrity_mj.model.strings import StringLaw
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.model.text.keys import POINT_MASS_KEYS, ROD_KEYS, SECTION_KEYS, STRING_KEYS, SUPPORT_KEYS, TUBE_KEYS
from tensegrity_mj.model.text.table import Table, is_list, is_row


def structure_of(table: Table, name: str) -> Structure:
    """The structure of a table, called `name` unless it says otherwise."""
    nodes = table.table("nodes", None)
    if nodes is None:
        raise table.fail("nodes", "a table of node name = [x, y, z]")
    laws = [law.value for law in StringLaw]
    return Structure(
        name=table.text("name", name),
        nodes={key: nodes.vector(key) for key in nodes.data},
        rods=tuple(_rod(item) for item in table.tables("rods", ROD_KEYS)),
        strings=tuple(_string(item) for item in table.tables("strings", STRING_KEYS)),
        fixed_nodes=table.texts("fixed_nodes", ()),
        point_masses=tuple(
            PointMass(item.text("node"), item.number("mass"), item.vector("plane", None))
            for item in table.tables("point_masses", POINT_MASS_KEYS, title="node")
        ),
        string_law=StringLaw(table.choice("string_law", laws, StringLaw.CLIPPED.value)),
    )


def _rod(table: Table) -> Rod:
    support, section = table.table("support", None), table.table("section", None)
    return Rod(
        table.text("name"),
        table.texts("nodes"),
        table.number("mass"),
        table.number("radius", Rod.radius),
        Support.free() if support is None else _support(support),
        None if section is None else _section(section, f"rod '{table.text('name')}'"),
    )


def _section(table: Table, rod: str) -> Section:
    """A section by its area and second moment, or as a round tube."""
    tube = "outer_radius" in table.data or "wall" in table.data
    table.allow(TUBE_KEYS if tube else SECTION_KEYS)
    modulus, stress = table.number("elasticity_modulus"), table.number("yield_stress", None)
    if not tube:
        return Section(table.number("area"), table.number("second_moment"), modulus, stress)
    try:
        return Section.tube(table.number("outer_radius"), table.number("wall"), modulus, stress)
    except StructureError as error:
        raise StructureError(f"{rod}: {error}") from None


def _support(table: Table) -> Support:
    kind = table.choice("kind", SUPPORT_KEYS)
    table.allow(SUPPORT_KEYS[kind])
    plane = table.vector("plane", None)
    if kind == "free":
        return Support.free(table.number("sigma", 0.5), plane)
    sigma = table.number("sigma", 0.0)
    if kind == "pinned":
        return Support.pinned(sigma, plane)
    rows = table.get("D", "rows of three numbers, as [[0, 0, 1]]", lambda x: bool(x) and is_list(x, is_row))
    return Support.constrained(rows, sigma, table.numbers("values", "a number a row of D", len(rows), None), plane)


def _string(table: Table) -> String:
    return String(
        table.text("name"),
        table.texts("nodes"),
        table.number("stiffness"),
        table.number("damping", String.damping),
        table.number("rest_length", None),
        table.number("tension", None),
        table.number("force_density", None),
        *(table.number(name, None) for name in (*LIMITS, "strength")),
    )
