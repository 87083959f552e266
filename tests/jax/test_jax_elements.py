"""Elements as array functions: which are found, and what is refused by name."""

from __future__ import annotations

import re
import sys
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

pytest.importorskip("jax")
pytest.importorskip("diffrax")

import jax
from ground_spring import GroundSpring, tethered
from pages import ROOT

import tensegrity_mj as tmj
from tensegrity_mj.engines.jax.arrays import ArrayEffect
from tensegrity_mj.engines.jax.effects import array_effects
from tensegrity_mj.engines.jax.settings import JAX
from tensegrity_mj.errors import ElementError, SceneError
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
        return ArrayEffect({"force": element.force})

    home.pull = pull
    (effect,) = array_effects(scene)
    assert effect.parameters == {"force": (1.0, 0.0, -2.0)}
    assert effect.gives  # by its `work`
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


def test_what_array_functions_return_is_checked_with_a_batch_and_without(home: Any) -> None:
    scene = tethered((Pull((1.0, 0.0, -2.0)),))
    for effect, message in (
        (ArrayEffect(energy=lambda p, t, x: x.sum()), "work = Work.GIVEN; arrays of an element that stores its work"),
        (ArrayEffect(force=lambda p, t, x, v: x[0]), r"force .* returned shape \(3,\) for positions \(4, 3\)"),
        (
            ArrayEffect(force=lambda p, t, x, v: jax.numpy.zeros((4, 3))),
            r"force .* returned shape \(4, 3\) for positions \(4, 3, 2\); it must return \(4, 3, 2\), batches last",
        ),
        (
            ArrayEffect(dissipation=lambda p, t, x, v: (v**2).sum()),
            r"dissipation .* it must return \(2,\), batches last",
        ),
        (ArrayEffect(force=lambda p, t, x, v: np.sin(x)), "force of its arrays failed: TracerArrayConversionError"),
    ):
        home.pull = lambda element, scene, effect=effect: effect
        with pytest.raises(ElementError, match=f"element Pull: {message}"):
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


@dataclass(frozen=True)
class Lagging(Pull):
    """One with a state, too."""

    def state0(self, scene: Any) -> Any:
        return np.zeros(1)

    def rates(self, scene: Any, time: float, nodes: Any, velocities: Any, state: Any) -> Any:
        return -state

    def act(self, scene: Any, time: float, nodes: Any, velocities: Any, state: Any) -> Any:
        return state + np.zeros_like(nodes)


def test_the_engine_refuses_what_is_no_array_function_by_name() -> None:
    scene = tethered(())
    moved = tmj.model.Motion.by_function(scene.structure.fixed_nodes[0], lambda t: np.zeros((3, 3)))
    for given, message in (
        (
            {"elements": (GroundSpring("a", 12.0),)},
            "JAX: GroundSpring has no array function .*use MuJoCo or DAE or ODE",
        ),
        ({"elements": (Lagging((1.0, 0.0, 0.0)),)}, r"JAX: Lagging has a state \(state0\)"),
        ({"loads": lambda t: np.zeros((4, 3))}, "JAX: the loads of scene '.*' are a Python function.*`Load`s"),
        ({"motions": (moved,)}, f"JAX: the motion of '{moved.support}' is a Python function"),
    ):
        with pytest.raises(SceneError, match=message):
            tmj.simulate(scene.with_(**given), engine=JAX(), duration=0.1)


def test_the_element_of_the_docs_is_the_same_as_arrays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = (ROOT / "docs/elements.md").read_text(encoding="utf-8")
    ((name, code),) = re.findall(r"as `(\w+)\.py`:\n\n```python\n(.*?)```", page, re.DOTALL)
    (tmp_path / f"{name}.py").write_text(code, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, name, raising=False)
    element = import_module(name).Tether("b", 40.0)
    scene = tethered((element,))
    (effect,) = array_effects(scene)
    x = scene.nodes0 + 0.1 * np.random.default_rng(3).normal(size=scene.nodes0.shape)
    # Products of three numbers.
    assert float(effect.energy(effect.parameters, 0.0, x)) == pytest.approx(element.energy(scene, x), rel=1e-15)
    found = -jax.grad(lambda x: effect.energy(effect.parameters, 0.0, x))(x)
    assert np.asarray(found) == pytest.approx(element.act(scene, 0.0, x, 0 * x), rel=1e-15)
    del sys.modules[name]
