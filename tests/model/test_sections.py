"""Sections of rods and strengths of strings: their formulas, what is refused, and that files keep them."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

import tensegrity_mj as tmj
from tensegrity_mj.engines.mujoco.mjcf import scene_to_mjcf
from tensegrity_mj.errors import FormatError, StructureError
from tensegrity_mj.model.members import Rod, String
from tensegrity_mj.model.section import Section
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.model.text.reading import structure_from_toml
from tensegrity_mj.model.text.writing import scene_to_toml, structure_to_toml

# Table C.1 of the thesis: the steel pipe of appendix C.
PIPE = Section.tube(0.05, 0.01095, 210e9, 200e6)
NODES = {"a": (0.0, 0.0, 0.0), "b": (1.0, 0.0, 0.0), "c": (0.0, 1.0, 0.0), "d": (1.0, 1.0, 0.5)}
CORDS = (String("s", ("a", "c"), 10.0), String("t", ("b", "d"), 10.0, strength=25.0))


def pair(first: Section | None = PIPE, second: Section | None = None) -> Structure:
    rods = (Rod("r", ("a", "b"), 2.0, section=first), Rod("q", ("c", "d"), 1.0, section=second))
    return Structure("pair", NODES, rods, CORDS)


# Formulas -------------------------------------------------------------------------------------------------


def test_the_pipe_of_table_c1() -> None:
    """The thesis prints 3189 kN and 1041 MPa: what its data give with π = 3.14, and not 3194.3 kN and 1042.8 MPa."""
    length = math.sqrt(2.0)  # printed as 1414 mm: the diagonal of a cell of 1 m by 1 m
    load = PIPE.euler_load(length)
    exact = math.pi**3 * 210e9 * (0.05**4 - 0.03905**4) / (4 * length**2)
    assert load == pytest.approx(exact, rel=1e-12)  # a dozen roundings
    assert math.floor(load * (3.14 / math.pi) ** 3 / 1e3) == 3189
    assert math.floor(load / PIPE.area * (3.14 / math.pi) ** 2 / 1e6) == 1041
    assert load == pytest.approx(3189e3, rel=2e-3)
    assert load / PIPE.area == pytest.approx(1041e6, rel=2e-3)
    assert PIPE.yield_load == pytest.approx(200e6 * math.pi * (0.05**2 - 0.03905**2), rel=1e-12)
    assert PIPE.axial_stiffness == pytest.approx(210e9 * PIPE.area, rel=1e-15)


@settings(derandomize=True, max_examples=40, deadline=None)
@given(st.floats(1e-3, 1.0), st.floats(1e-3, 1.0))
def test_tubes_against_integrals_over_the_ring(outer: float, part: float) -> None:
    """A = ∫ 2π r dr and I = ∫ π r³ dr, each by quadrature; the polynomial is integrated to round-off."""
    tube = Section.tube(outer, part * outer, 1.0)
    inner = outer - part * outer
    area = quad(lambda r: 2 * math.pi * r, inner, outer)[0]
    second = quad(lambda r: math.pi * r**3, inner, outer)[0]
    # The inner radius is rounded to 1.1e-16 of the outer: at a wall of 1e-3 of it this is 1.1e-13 of the wall.
    assert tube.area == pytest.approx(area, rel=1e-12)
    assert tube.second_moment == pytest.approx(second, rel=1e-12)


def test_a_tube_without_a_hole_is_solid() -> None:
    tube, solid = Section.tube(0.02, 0.02, 7e10, 1e8), Section.solid(0.02, 7e10, 1e8)
    assert tube.area == pytest.approx(solid.area, rel=1e-15)
    assert tube.second_moment == pytest.approx(solid.second_moment, rel=1e-15)
    assert solid.second_moment == pytest.approx(math.pi * 0.02**4 / 4, rel=1e-14)
    assert Section.solid(0.02, 7e10).yield_load is None


def test_the_euler_load_is_the_lowest_eigenvalue_of_a_pinned_column() -> None:
    """-E I w'' = P w with w = 0 at both ends, by finite differences: their error is (π h / ℓ)² / 12 of P."""
    cells, length = 400, 1.7
    h = length / cells
    matrix = (2 * np.eye(cells - 1) - np.eye(cells - 1, k=1) - np.eye(cells - 1, k=-1)) / h**2
    lowest = PIPE.elasticity_modulus * PIPE.second_moment * np.linalg.eigvalsh(matrix)[0]
    assert PIPE.euler_load(length) == pytest.approx(lowest, rel=1.1 * (math.pi / cells) ** 2 / 12)


# What is refused ------------------------------------------------------------------------------------------

BAD: list[tuple[str, Any]] = [
    ("area", 0.0),
    ("area", -1.0),
    ("area", math.nan),
    ("area", None),
    ("second_moment", math.inf),
    ("second_moment", "1"),
    ("elasticity_modulus", 0.0),
    ("elasticity_modulus", True),
    ("yield_stress", 0.0),
    ("yield_stress", math.nan),
]


@pytest.mark.parametrize(("name", "value"), BAD)
def test_numbers_of_a_section_are_checked(name: str, value: Any) -> None:
    with pytest.raises(StructureError) as caught:
        pair(None, replace(PIPE, **{name: value}))
    assert str(caught.value).startswith(f"section: {name} = {value!r}; it must be > 0")


def test_what_is_no_section() -> None:
    with pytest.raises(StructureError, match=r"rod 'r': section = 0\.1; use Section"):
        pair(0.1)  # type: ignore[arg-type]


@pytest.mark.parametrize("value", [0.0, -2.0, math.nan, math.inf, "3"])
def test_strengths_are_checked(value: Any) -> None:
    with pytest.raises(StructureError, match=r"string 't': strength = .*; it must be > 0 N, or absent"):
        replace(pair(), strings=(CORDS[0], replace(CORDS[1], strength=value)))


@pytest.mark.parametrize(
    ("build", "words"),
    [
        (lambda: Section.tube(0.0, 0.01, 1e9), "outer_radius = 0.0"),
        (lambda: Section.tube(0.05, math.nan, 1e9), "wall = nan"),
        (lambda: Section.tube(0.05, 0.06, 1e9), "wall = 0.06 m is thicker than outer_radius = 0.05"),
        (lambda: Section.tube(0.05, 0.01, -1e9), "elasticity_modulus = -1000000000.0"),
        (lambda: Section.solid(-0.05, 1e9), "radius = -0.05"),
        (lambda: Section.solid(0.05, 1e9, 0.0), "yield_stress = 0.0"),
    ],
)
def test_sizes_of_tubes_and_bars_are_checked(build: Any, words: str) -> None:
    with pytest.raises(StructureError) as caught:
        build()
    assert words in str(caught.value)


# Structures keep them -------------------------------------------------------------------------------------


def test_numbers_become_plain() -> None:
    section = Section(np.float64(1e-3), 1, np.float32(2e11), np.int64(5))  # type: ignore[arg-type]
    kept = pair(section).rods[0].section
    assert kept is not None
    assert [type(value) for value in vars(kept).values()] == [float] * 4
    assert hash(pair(section).rods[0]) == hash(pair(replace(section)).rods[0])


def test_with_sections() -> None:
    bare = pair(None)
    assert [rod.section for rod in bare.with_sections(PIPE).rods] == [PIPE, PIPE]
    assert bare.with_sections([PIPE, None]) == pair()
    assert pair(PIPE, PIPE).with_sections(None) == bare
    with pytest.raises(StructureError, match="1 sections for 2 rods"):
        bare.with_sections([PIPE])
    with pytest.raises(StructureError, match="with_sections"):
        bare.with_sections(3)  # type: ignore[arg-type]
    with pytest.raises(StructureError, match="section: area = -1"):
        bare.with_sections([None, replace(PIPE, area=-1.0)])


def test_with_strengths() -> None:
    assert [s.strength for s in pair().with_strings(strength=[3, 4.5]).strings] == [3.0, 4.5]
    assert [s.strength for s in pair().with_strings(strength=None).strings] == [None, None]
    kept = pair().with_strings(stiffness=7.0, rest_length=0.5)
    assert [s.strength for s in kept.strings] == [None, 25.0]
    with pytest.raises(StructureError, match="strength"):
        pair().with_strings(strength=-1.0)


def test_a_moved_structure_keeps_them() -> None:
    turned = pair().moved(np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), np.array([1.0, 2, 3]))
    assert [rod.section for rod in turned.rods] == [PIPE, None]
    assert [s.strength for s in turned.strings] == [None, 25.0]


def test_engines_do_not_see_them() -> None:
    """The MJCF of a structure with sections and strengths is that of one without, byte by byte."""
    bare = pair(None).with_strings(strength=None)
    assert scene_to_mjcf(tmj.Scene(pair(PIPE, PIPE))) == scene_to_mjcf(tmj.Scene(bare))


# Files ----------------------------------------------------------------------------------------------------

numbers = st.floats(min_value=1e-100, max_value=1e100)


@settings(derandomize=True, max_examples=60, deadline=None)
@given(st.builds(Section, numbers, numbers, numbers, st.none() | numbers), st.none() | numbers)
def test_files_keep_every_bit(section: Section, strength: float | None) -> None:
    structure = replace(pair(section), strings=(replace(CORDS[0], strength=strength), CORDS[1]))
    again = structure_from_toml(structure_to_toml(structure))
    assert again == structure
    assert repr(again.rods) == repr(structure.rods)  # the last bit and the sign too


def test_what_is_not_given_is_not_written() -> None:
    text = structure_to_toml(pair(None).with_strings(strength=None))
    assert "section" not in text
    assert "strength" not in text
    text = structure_to_toml(pair(replace(PIPE, yield_stress=None)))
    assert text.count("section") == 1
    assert "yield_stress" not in text


@pytest.mark.parametrize("name", ["prism", "tbar", "cable", "truss_arm"])
def test_scenes_of_the_package_are_written_as_before(name: str) -> None:
    text = scene_to_toml(tmj.load_scene(name))
    assert "section =" not in text
    assert "strength =" not in text


def from_file(section: str) -> Structure:
    text = structure_to_toml(pair(None))
    old = 'nodes = ["a", "b"],'
    assert text.count(old) == 1
    return structure_from_toml(text.replace(old, f"{old} section = {section},"), "mine.toml")


def test_a_tube_in_a_file() -> None:
    tube = "{ outer_radius = 0.05, wall = 0.01095, elasticity_modulus = 210e9, yield_stress = 200e6 }"
    assert from_file(tube).rods[0].section == PIPE
    assert from_file(tube.replace(", yield_stress = 200e6", "")).rods[0].section == replace(PIPE, yield_stress=None)
    plain = "{ area = 1e-3, second_moment = 2e-6, elasticity_modulus = 7e10 }"
    assert from_file(plain).rods[0].section == Section(1e-3, 2e-6, 7e10)


@pytest.mark.parametrize(
    ("section", "error", "words"),
    [
        ("3", FormatError, ("section = 3", "a table")),
        ("{ area = 1 }", FormatError, ("'second_moment' is missing", "'r'.section")),
        ("{ area = 1, elasticity_modulus = 1 }", FormatError, ("'second_moment' is missing",)),
        ("{ wall = 1, elasticity_modulus = 1 }", FormatError, ("'outer_radius' is missing",)),
        ("{ wall = 1, area = 1, elasticity_modulus = 1 }", FormatError, ("unknown key 'area'", "outer_radius")),
        ("{ aera = 1, second_moment = 1, elasticity_modulus = 1 }", FormatError, ("did you mean 'area'?",)),
        ("{ area = '1', second_moment = 1, elasticity_modulus = 1 }", FormatError, ("area = '1' (a text)",)),
        (
            "{ area = -1, second_moment = 1, elasticity_modulus = 1 }",
            StructureError,
            ("'r'.section: area = -1",),
        ),
        (
            "{ outer_radius = 1, wall = 2, elasticity_modulus = 1 }",
            StructureError,
            ("'r'.section: wall = 2.0",),
        ),
    ],
)
def test_wrong_sections_in_files(section: str, error: type[Exception], words: tuple[str, ...]) -> None:
    with pytest.raises(error) as caught:
        from_file(section)
    assert type(caught.value) is error
    assert str(caught.value).startswith("mine.toml: ")
    for word in words:
        assert word in str(caught.value)
