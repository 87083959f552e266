"""Prestress that no stretch has, and engines of extras in remedies."""

from __future__ import annotations

from typing import Any

import pytest

import tensegrity_mj as tmj
from tensegrity_mj.errors import SceneError, StructureError
from tensegrity_mj.model import Water

NODES = {"hook": (0.0, 0.0, 2.0), "m": (0.0, 0.0, 0.0)}


def hanging(**string: Any) -> tmj.Structure:
    return tmj.Structure(
        "hanging",
        nodes=NODES,
        rods=(),
        strings=(tmj.String("s", ("hook", "m"), curve=((0.1, 20.0), (0.2, 20.0)), **string),),
        fixed_nodes=("hook",),
        point_masses=(tmj.PointMass("m", 2.0),),
    )


@pytest.mark.parametrize(
    ("prestress", "said"),
    [
        ({"tension": 25.0}, r"string 's': its curve is level at 20 N, and its prestress would be 25 N"),
        ({"force_density": 12.5}, r"its curve is level at 20 N, and its prestress would be 25 N"),
        ({"tension": 25.0, "mass": 0.5, "segments": 3}, r"its curve is level at 20 N"),
    ],
)
def test_a_tension_above_a_level_curve_is_refused(prestress: dict[str, Any], said: str) -> None:
    with pytest.raises(StructureError, match=said):
        hanging(**prestress)


@pytest.mark.parametrize("prestress", [{"tension": 20.0}, {"tension": 15.0}, {"force_density": 10.0}])
def test_a_tension_that_the_curve_has_is_the_strings(prestress: dict[str, Any]) -> None:
    structure = hanging(**prestress)
    run = tmj.simulate(tmj.Scene(structure, duration=0.01), controller=None, engine="dae")
    wanted = prestress.get("tension", 2.0 * prestress.get("force_density", 0.0))
    assert run.tensions[0, 0] == pytest.approx(wanted, rel=1e-14)  # a handful of operations


def test_a_remedy_names_the_engine_of_an_extra_where_no_other_has_the_scene() -> None:
    rod = tmj.Rod("r", ("a", "b"), 3.0, 0.05, stiffness=5.0)
    structure = tmj.Structure("r", nodes={"a": (0, 0, -3.0), "b": (1.2, 0, -3.0)}, rods=(rod,), strings=())
    scene = tmj.Scene(structure, duration=0.1, water=Water(added_mass=1.0))
    for engine in ("mujoco", "dae", "ode"):
        with pytest.raises((SceneError, StructureError), match=r"use JAX \(of the extra 'jax'\), or "):
            tmj.simulate(scene, controller=None, engine=engine)
