"""Elements as array functions: which are found, and what is refused by name."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
import pytest

pytest.importorskip("jax")
pytest.importorskip("diffrax")

from ground_spring import GroundSpring, tethered

import tensegrity_mj as tmj
from tensegrity_mj.engines.jax.arrays import ArrayEffect
from tensegrity_mj.engines.jax.effects import array_effects
from tensegrity_mj.errors import ElementError
from tensegrity_mj.model.capabilities import FUNCTION_LOADS, FUNCTION_MOTIONS, NO_ARRAYS


@dataclass(frozen=True)
class Pull(tmj.model.Element):
    """A constant force on all nodes."""

    force: tuple[float, float, float]
    arrays = "pull_of_a_test:pull"

    def act(self, scene: Any, time: float, nodes: Any, velocities: Any) -> Any:
        return np.zeros_like(nodes) + np.array(self.force)


@pytest.fixture
def home(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """Where `Pull` finds its array function."""
    module = ModuleType("pull_of_a_test")
    monkeypatch.setitem(sys.modules, module.__name__, module)
    return module


def test_an_element_of_ones_own_names_its_array_function(home: Any) -> None:
    scene, seen = tethered((Pull((1.0, 0.0, -2.0)),)), []

    def pull(element: Any, scene: Any) -> ArrayEffect:
        seen.append((element, scene))
        return ArrayEffect({"force": element.force}, gives=True)

    home.pull = pull
    assert [effect.parameters for effect in array_effects(scene)] == [{"force": (1.0, 0.0, -2.0)}]
    assert seen == [(scene.elements[0], scene)]
    assert NO_ARRAYS.find(scene) == ""


def test_what_has_no_array_function_is_refused_by_its_name(home: Any) -> None:
    scene = tethered((Pull((1.0, 0.0, -2.0)), GroundSpring("a", 12.0)))
    assert NO_ARRAYS.find(scene) == "GroundSpring has no array function (arrays)"
    with pytest.raises(ElementError, match=r"Pull: arrays = 'pull_of_a_test:pull' cannot be imported.*'module:func"):
        array_effects(scene)
    home.pull = lambda element, scene: 3.0
    with pytest.raises(ElementError, match=r"Pull: pull_of_a_test:pull returned 3.0; it must return an ArrayEffect"):
        array_effects(scene)
    home.pull = lambda element, scene: ArrayEffect()
    with pytest.raises(ElementError, match="element GroundSpring has no array function"):
        array_effects(scene)


def test_functions_in_python_are_traits_of_a_scene(prism: tmj.Scene) -> None:
    assert FUNCTION_LOADS.find(prism) == FUNCTION_MOTIONS.find(prism) == ""
    pushed = prism.with_(loads=lambda t: np.zeros((6, 3)))
    assert FUNCTION_LOADS.find(pushed) == "the loads of scene 'prism' are a Python function"
    nodes = {"a": (0.0, 0.0, 0.0), "b": (1.0, 0.0, 0.0), "p": (0.0, 0.0, 1.0)}
    structure = tmj.Structure(
        "hung", nodes, (tmj.Rod("r", ("a", "b"), 1.0),), (tmj.String("s", ("p", "a"), 1.0, 0.0, 1.0),), ("p",)
    )
    moved = tmj.Scene(structure, motions=(tmj.model.Motion.by_function("p", lambda t: np.zeros((3, 3))),))
    assert FUNCTION_MOTIONS.find(moved) == "the motion of 'p' is a Python function"
