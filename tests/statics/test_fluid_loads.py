"""Water and wind in statics: a rod on two strings, whose equilibrium is known in closed form.

The rod is level, and its strings are parallel: it moves as a whole, so that what a current pushes it with is the same
wherever it goes, and each string has half of the sum of weight, buoyancy and drag, in whose direction it hangs.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import tensegrity_mj as tmj
from tensegrity_mj.statics.engines import engine_equilibrium
from tensegrity_mj.statics.equilibrium import find_equilibrium

LENGTH, MASS, RADIUS, DEPTH = 1.2, 3.0, 0.04, 4.0  # m, kg, m, m
STIFFNESS, REST, GRAVITY = 900.0, 0.6, 9.81
WEIGHT = MASS * GRAVITY
# A Newton iteration ends at a step of 1e-10 of the size, which is 1 m.
AGREEMENT = 1e-9  # m


def hung(above: bool, **scene: Any) -> tmj.Scene:
    """The rod at its strings' rest length below its pins, or above them."""
    side = 1.0 if above else -1.0
    nodes = {"a": (0.0, 0.0, -DEPTH), "b": (0.0, LENGTH, -DEPTH)}
    nodes |= {"p": (0.0, 0.0, -DEPTH - side * REST), "q": (0.0, LENGTH, -DEPTH - side * REST)}
    strings = tuple(
        tmj.String(name, pair, STIFFNESS, 0.0, REST) for name, pair in (("s", ("p", "a")), ("t", ("q", "b")))
    )
    rod = tmj.Rod("r", ("a", "b"), MASS, radius=RADIUS)
    structure = tmj.Structure("hung", nodes, (rod,), strings, fixed_nodes=("p", "q"))
    return tmj.Scene(structure, gravity=(0.0, 0.0, -GRAVITY), **scene)


def expected(scene: tmj.Scene, force: tuple[float, float, float]) -> np.ndarray:
    """Where the rod's first node is under a force on the whole."""
    size = float(np.linalg.norm(force))
    return scene.structure.positions[2] + (REST + 0.5 * size / STIFFNESS) * np.array(force) / size


BUOYANCY = 1000.0 * np.pi * RADIUS**2 * LENGTH * GRAVITY
CASES = {
    "buoyant in still water": (
        hung(True, water=tmj.Water(density=1000.0)), (0.0, 0.0, BUOYANCY - WEIGHT),
    ),
    "in a current": (  # ½ ρ C_d d ℓ U² across the rod
        hung(True, water=tmj.Water(density=1000.0, drag=1.2, current=(0.5, 0.0, 0.0))),
        (0.5 * 1000.0 * 1.2 * 2 * RADIUS * LENGTH * 0.25, 0.0, BUOYANCY - WEIGHT),
    ),
    "in wind": (  # c ℓ U, the fluid viscous
        hung(False, resistance=tmj.Resistance(viscous=0.7, wind=(9.0, 0.0, 0.0))),
        (0.7 * LENGTH * 9.0, 0.0, -WEIGHT),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_a_rod_on_two_strings(name: str) -> None:
    scene, force = CASES[name]
    there = expected(scene, force)
    state = find_equilibrium(scene)
    assert np.abs(state.nodes[0] - there).max() < AGREEMENT
    np.testing.assert_allclose(state.tensions, 0.5 * np.linalg.norm(force), rtol=1e-9)
    assert np.abs(engine_equilibrium(scene, tmj.DAE()).nodes[0] - there).max() < AGREEMENT


def test_notes_name_what_pushes() -> None:
    study = tmj.statics.analyse(CASES["in a current"][0], modes=1)
    assert "water: applied as constant loads, computed at the start, at rest" in study.notes
    assert "frequencies leave the mass that water adds out" in study.notes
    assert not tmj.statics.analyse(hung(False, resistance=tmj.Resistance(viscous=0.7)), modes=1).notes
