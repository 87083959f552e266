"""Natural frequencies in water, by linear models of both engines, against closed forms."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import tensegrity_mj as tmj

G, RHO, D, LENGTH, K = 9.81, 1025.0, 0.1, 2.0, 400.0
AREA = np.pi * D**2 / 4
DISPLACED = RHO * AREA * LENGTH
ENGINES = [tmj.DAE(), tmj.MuJoCo(1e-3)]
both = pytest.mark.parametrize("engine", ENGINES, ids=["DAE", "MuJoCo"])
# Narrow differences have round-off of 4e-12 relative to the largest stiffness (`linearization/linearizing.py`), which
# is at most a thousand times those here: 4e-9 of ω², with a margin for solving with masses and for eigenvalues.
CLOSE = 1e-7


def scene(z: Any, mass: float, moored: bool = False) -> tmj.Scene:
    """A rod between two heights, without drag; moored, on two strings downwards that hold it at rest."""
    nodes = {"a": (0.0, 0.0, z[0]), "b": (0.0 if z[0] != z[1] else LENGTH, 0.0, z[1])}
    strings: tuple[tmj.String, ...] = ()
    if moored:
        nodes |= {"p": (0.0, 0.0, z[0] - 2.0), "q": (LENGTH, 0.0, z[0] - 2.0)}
        stretch = 0.5 * (DISPLACED - mass) * G / K
        strings = tuple(tmj.String(f"s{a}", (a, b), K, rest_length=2.0 - stretch) for a, b in (("a", "p"), ("b", "q")))
    fixed = ("p", "q") if moored else ()
    structure = tmj.Structure("rod", nodes, (tmj.Rod("r", ("a", "b"), mass, D / 2),), strings, fixed)
    return tmj.Scene(structure, gravity=(0, 0, -G), water=tmj.Water(drag=0.0))


@both
def test_a_moored_rod_heaves_and_sways_with_its_added_mass(engine: Any) -> None:
    """2 k / (m + m_w) in heave; T / h / (m + m_w) across as a pendulum upwards, T = (m_w - m) g on h = 2 m of string.

    Along its axis the rod has no added mass."""
    mass = 5.0
    found = 2 * np.pi * tmj.linearize(scene((-5.0, -5.0), mass, moored=True), engine=engine).frequencies
    pull = (DISPLACED - mass) * G / 2.0
    for expected in (2 * K / (mass + DISPLACED), pull / (mass + DISPLACED), pull / mass):
        assert np.abs(found**2 / expected - 1).min() < CLOSE


@both
def test_a_spar_heaves_by_its_waterplane(engine: Any) -> None:
    """ρ g A / m of a vertical rod that floats 1.5 m deep; it is not stable upright, which is what it shows besides."""
    mass = RHO * AREA * 1.5
    values = np.linalg.eigvals(tmj.linearize(scene((-1.5, 0.5), mass), engine=engine).A)
    assert np.abs(values.imag**2 / (RHO * G * AREA / mass) - 1).min() < CLOSE
    assert values.real.max() > 1.0
