"""What each engine and each function cannot do is a row of a table, and one function says so."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from maxwell import Maxwell

import tensegrity_mj as tmj
from tensegrity_mj.engines.requirements import USES, engines_for, require
from tensegrity_mj.engines.table import ENGINES, engine_class, installed
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.runs.trajectory import Status

ROD = tmj.Rod("r", ("a", "b"), 1.0, support=tmj.Support.pinned())
PLACES = {"a": (0.0, 0.0, 0.0), "b": (0.6, 0.0, -0.8), "c": (1.2, 0.0, 0.0)}
ONE = tmj.Structure("one", {name: PLACES[name] for name in "ab"}, (ROD,))
TWO = tmj.Structure("two", PLACES, (ROD, tmj.Rod("s", ("b", "c"), 1.0)))
LOOP = tmj.Structure("loop", PLACES, (*TWO.rods, tmj.Rod("t", ("c", "a"), 1.0)))
DOWN = (0.0, 0.0, -9.81)
FLOOR = tmj.model.Contact(floor=-2.0)
WATER = tmj.Water()
HERMITE = tmj.Water(weights=tmj.model.Weights.HERMITE)
MOVED = (tmj.model.Motion.in_line("r", 0.1, 1.0, (1, 0, 0)),)
SCENES = {
    "plain": Scene(ONE, gravity=DOWN),
    "joined": Scene(TWO, gravity=DOWN),
    "closed": Scene(LOOP, gravity=DOWN),
    "moved": Scene(ONE, gravity=DOWN, motions=MOVED),
    "contact": Scene(ONE, gravity=DOWN, contact=FLOOR),
    "joined contact": Scene(TWO, gravity=DOWN, contact=replace(FLOOR, spin="free")),
    "joined contact, held": Scene(TWO, gravity=DOWN, contact=FLOOR),
    "water": Scene(ONE, gravity=DOWN, water=WATER),
    "joined water": Scene(TWO, gravity=DOWN, water=WATER),
    "joined uneven": Scene(TWO, gravity=DOWN, water=HERMITE),
    "closed water": Scene(LOOP, gravity=DOWN, water=WATER),
    "water contact": Scene(ONE, gravity=DOWN, water=WATER, contact=FLOOR),
}


@pytest.mark.parametrize(
    ("scene", "able"),
    [
        ("plain", ["mujoco", "dae", "ode"]),
        ("joined", ["mujoco", "dae"]),
        ("closed", ["mujoco", "dae"]),
        ("moved", ["mujoco", "dae", "ode"]),
        ("contact", ["mujoco", "dae"]),
        ("joined contact", ["mujoco"]),
        ("joined contact, held", []),
        ("water", ["mujoco", "dae", "ode"]),
        ("joined water", ["mujoco", "dae"]),
        ("joined uneven", ["mujoco", "dae"]),
        ("closed water", ["dae"]),
        ("water contact", []),
    ],
)
def test_the_table_says_what_engines_do(scene: str, able: list[str]) -> None:
    """Each engine is run, but for steps: what it refuses is what the table says, and nothing else."""
    assert engines_for(SCENES[scene]) == able
    for name in installed():
        # Of the DAE, the solver that takes all there is but contact.
        full = name == "dae" and SCENES[scene].contact is None
        options: dict[str, Any] = {"solver": tmj.engines.Solver.FULL} if full else {}
        engine = engine_class(name)(**options)
        if name in able:
            assert tmj.simulate(SCENES[scene], engine=engine, duration=0.002).status is Status.COMPLETED
        else:
            with pytest.raises((tmj.errors.SceneError, tmj.errors.StructureError, tmj.errors.OptionError)) as caught:
                tmj.simulate(SCENES[scene], engine=engine, duration=0.002)
            said = str(caught.value)
            assert said.startswith(ENGINES[name].title)
            others = " or ".join(ENGINES[one].title for one in able)
            assert (f"use {others}, or" if able else "no engine simulates it") in said


@pytest.mark.parametrize(
    ("engine", "scene", "words"),
    [
        (tmj.MuJoCo(integrator=tmj.Integrator.DISCRETE), "water", r"MuJoCo with Integrator\.DISCRETE: water adds mass"),
        (tmj.MuJoCo(locate_slack=True), "contact", r"MuJoCo with locate_slack = True: .*has contact"),
        (tmj.DAE(), "joined uneven", r"DAE with Solver\.JOINTS: .*not symmetric, and rods 'r' and 's' share node 'b'"),
    ],
)
def test_options_that_do_not_go_with_a_scene(engine: Any, scene: str, words: str) -> None:
    with pytest.raises(tmj.errors.OptionError, match=words):
        tmj.simulate(SCENES[scene], engine=engine, duration=0.01)


def test_functions_have_limits_of_their_own() -> None:
    broken = tmj.load_scene("prism").with_(breaks=(tmj.model.Break("s1", 0.1),))
    stateful = SCENES["plain"].with_(elements=(Maxwell(SCENES["plain"].structure.node_names[0], 1.0, 1.0),))
    scenes = {**SCENES, "broken": broken, "stateful": stateful}
    for use, refused in {
        "linearize": ["moved"],
        "engine_equilibrium": ["moved", "stateful"],
        "statics": ["stateful"],
        "simulate_many": [],
        "law_in": ["broken", "stateful"],
        "MuJoCo's model": [],
        "random starts": ["closed", "closed water"],
        "dm_control models": [*(set(SCENES) - {"plain", "contact"}), "stateful"],
    }.items():
        found, said = [], []
        for name, scene in scenes.items():
            try:
                require(None, scene, use)
            except tmj.errors.TensegrityError as error:
                said.append(str(error))
                found.append(name)
        assert all(one.startswith(f"{use}: ") for one in said)
        assert sorted(found) == sorted(refused), use
    assert set(USES) == {
        "linearize", "engine_equilibrium", "statics", "simulate_many", "law_in", "MuJoCo's model", "dm_control models",
        "random starts",
    }  # fmt: skip


class OneByOne:
    """An engine of one's own, which makes single runs."""

    def run(self, request: Any) -> Any:
        raise NotImplementedError


def test_only_an_engine_that_makes_many_runs_is_taken_for_them() -> None:
    scene = SCENES["plain"]
    for engine, words in {
        OneByOne(): r"simulate_many runs in MuJoCo\(\.\.\.\) or DAE\(\.\.\.\) or .*; run_many takes any engine",
        tmj.MuJoCo(accuracy=1e-4): "simulate_many: accuracy = 0.0001 m chooses a step for each run",
    }.items():
        with pytest.raises(tmj.errors.OptionError, match=words):
            tmj.simulate_many([scene], engine=engine)  # type: ignore[arg-type]
