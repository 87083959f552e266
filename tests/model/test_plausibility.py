"""Tables in other units than SI are recognised by numbers that no bar has; the column and the unit are named."""

from __future__ import annotations

from pathlib import Path

import pytest

import tensegrity_mj as tmj
from tensegrity_mj.exchange import import_scene
from tensegrity_mj.model.section import Section, hardly_possible, warnings_of
from tensegrity_mj.statics.lightest import ALUMINIUM, STEEL

LENGTH = 2.0
PIPE = {"area": 1.85e-3, "second_moment": 2.1e-6, "elasticity_modulus": 210e9, "yield_stress": 355e6}


def strut(**section: float | None) -> tmj.Structure:
    """Of steel, with what its pipe weighs, whatever its section says."""
    given = Section(**(PIPE | section))  # type: ignore[arg-type]
    rod = tmj.Rod("r", ("a", "b"), 7850 * PIPE["area"] * LENGTH, 0.05, section=given)
    return tmj.Structure("strut", {"a": (0.0, 0.0, 0.0), "b": (0.0, 0.0, LENGTH)}, (rod,), ())


def test_bars_of_usual_materials_are_possible() -> None:
    assert not hardly_possible(strut())
    assert not hardly_possible(strut(yield_stress=None))
    for material in (STEEL, ALUMINIUM):
        for radius in (1e-4, 1e-2, 0.5):
            section = Section.solid(radius, material.elasticity_modulus, material.yield_stress)
            rod = tmj.Rod("r", ("a", "b"), material.density * section.area * LENGTH, radius, section=section)
            nodes = {"a": (0.0, 0.0, 0.0), "b": (0.0, 0.0, LENGTH)}
            assert not hardly_possible(tmj.Structure("bar", nodes, (rod,), ()))


@pytest.mark.parametrize(
    ("column", "factor", "unit"),
    [
        ("area", 1e6, "mm²"),
        ("area", 1e4, "mm²"),
        ("second_moment", 1e12, "mm⁴"),
        ("second_moment", 1e8, "mm⁴"),
        ("elasticity_modulus", 1e-9, "GPa"),
        ("elasticity_modulus", 1e-6, "GPa"),
        ("yield_stress", 1e-6, "MPa"),
        ("yield_stress", 1e3, "MPa"),
    ],
)
def test_a_column_in_another_unit_is_named(column: str, factor: float, unit: str) -> None:
    (warning,) = warnings_of(strut(**{column: factor * PIPE[column]}))
    assert warning.startswith(f"column {column}: ")
    assert "rod 'r'" in warning
    assert f"if these are {unit}, multiply" in warning


def test_import_and_statics_say_so_and_call_no_such_member_ok(tmp_path: Path) -> None:
    (tmp_path / "nodes.csv").write_text("name,x,y,z,fixed\na,0,0,0,xyz\nb,0,0,1,\nc,0,0,2,xyz\n", encoding="utf-8")
    columns = "area,second_moment,elasticity_modulus,yield_stress,strength,stiffness"
    (tmp_path / "members.csv").write_text(
        f"name,kind,i,j,mass,radius,{columns}\nr,rod,a,b,14.5,0.05,1850,2.1e-6,210,355,,\ns,string,b,c,,,,,,,1e3,1e4\n",
        encoding="utf-8",
    )
    found = import_scene(tmp_path / "nodes.csv")
    assert [note.split(":")[0] for note in found.notes] == [
        "column area",
        "column elasticity_modulus",
        "column yield_stress",
    ]
    study = tmj.statics.analyse(found.scene)
    assert set(found.notes) <= set(study.notes)
    assert study.members is not None
    assert not study.members.ok
    assert "rod 'r' (its area is hardly possible)" in study.members.unchecked
