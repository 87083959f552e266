"""The largest stable step of clustered and massive strings, curves, bodies, elastic rods and constraints."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import tensegrity_mj as tmj
from evidence.stability.cases import base_structure, scene_at_rest, varied
from evidence.stability.page import describe, judgement_of
from evidence.stability.study import at_rest, study_stability
from tensegrity_mj.engines.table import engine_of
from tensegrity_mj.errors import OptionError, TensegrityError
from tensegrity_mj.model.constraints import Constraint
from tensegrity_mj.model.moved_supports import velocities_with_supports
from tensegrity_mj.pictures.findings import Mark
from tensegrity_mj.statics.equilibrium import balance
from tensegrity_mj.statics.model import StaticModel


def elastic_pendulum() -> tmj.Scene:
    """An elastic rod that hangs from a pin, held aside by two strings."""
    nodes = {"top": (0, 0, 0), "end": (0, 0, -1), "left": (-1, 0, -1), "right": (1, 0, -1)}
    rod = tmj.Rod("rod", ("top", "end"), 2.0, support=tmj.Support.pinned(0.0, plane=(0, 1, 0)), stiffness=4e4)
    strings = tuple(tmj.String(side, (side, "end"), 100.0, tension=20.0) for side in ("left", "right"))
    structure = tmj.Structure("elastic", nodes, (rod,), strings, fixed_nodes=("left", "right"))
    return tmj.Scene(structure, name="elastic", gravity=(0.0, 0.0, -9.81))


def scene_of(name: str) -> tmj.Scene:
    return elastic_pendulum() if name == "elastic" else tmj.load_scene(name)


# The DAE's limit is that of its steps, whatever moves: of vertebrae it is the same as MuJoCo's RK4.
ENGINES = ("euler", "rk4", "dae")
CASES = [(name, ENGINES) for name in ("ladder", "pulley", "arrester", "elastic")]
CASES += [("massive_string", ("rk4",))]


@pytest.mark.parametrize(
    ("name", "engines"),
    [
        *CASES,
        ("massive_string", ENGINES[1:2]),
        ("spine", ENGINES[:2]),
        pytest.param("spine", ENGINES[2:], marks=pytest.mark.study),
    ],
)
def test_limits_are_measured_on_the_scene_itself(name: str, engines: tuple[str, ...]) -> None:
    scene, text = scene_at_rest(scene_of(name))
    assert text.startswith(f"{name} as it is, its supports still")
    assert balance(StaticModel.of(scene)).is_equilibrium
    for engine in engines:
        found = at_rest(scene, engine)
        # Bisection ends at 0.5 % of the limit; what a run of 1000 steps resolves is 0.1 %.
        assert found["ratio"] == pytest.approx(1, abs=0.006)


def test_what_nothing_holds_has_no_limit_up_to_the_scenes_duration() -> None:
    """Dead loads take all tension out of a chain, on every processor and however its loads are rounded.

    What is left of tensions is round-off: each force is moved by up to an ulp, as other orders of sums would move it.
    """
    scene, _ = scene_at_rest(tmj.load_scene("moored_chain"))
    rng = np.random.default_rng(0)
    eps = np.finfo(float).eps
    loads = tuple(
        replace(one, force=tuple(np.array(one.force) * (1 + eps * rng.uniform(-1, 1, 3)))) for one in scene.loads
    )
    found = at_rest(scene.with_(loads=loads), "rk4")
    assert (found["omega"], found["predicted"], found["rod"]) == (0.0, None, "")
    assert (found["measured"], found["ratio"]) == (None, 1.0)
    assert found["largest"] == pytest.approx(scene.duration)


@pytest.mark.parametrize(
    ("name", "engine", "words"),
    [
        ("ladder", "implicit", "MuJoCo with Integrator.IMPLICIT refuses the scene: constraint 'wall' holds nodes"),
        ("ladder", "discrete", "MuJoCo with Integrator.DISCRETE refuses the scene: constraint 'wall' holds nodes"),
        ("ladder", "ode", "ODE refuses the scene: constraint 'wall' holds nodes"),
        ("spine", "ode", "ODE refuses the scene: 'vertebra0' is a body"),
        ("elastic", "ode", "ODE refuses the scene: rod 'rod' is elastic"),
        ("moored_chain", "implicitfast", "IMPLICITFAST refuses the scene: water adds mass"),
    ],
)
def test_what_refuses_a_scene_has_no_step_for_it(name: str, engine: str, words: str) -> None:
    with pytest.raises(TensegrityError, match=words):
        tmj.stable_step(scene_of(name), engine_of(engine, 1e-3))


def test_contact_is_no_reason_to_refuse() -> None:
    """It is in no model of small motions, and `notes` says so."""
    scene = tmj.load_scene("prism_drop")
    assert tmj.stable_step(scene, tmj.DAE()).omega == tmj.stable_step(scene.with_(contact=None), tmj.DAE()).omega


def test_the_study_says_who_refuses_a_scene() -> None:
    scene = tmj.load_scene("ladder").with_(duration=0.5)
    data = study_stability(scene, engines=("rk4", "implicit", "ode"))
    assert list(data["base"]["engines"]) == ["rk4"]
    assert "refuses the scene" in data["start"]["engines"]["implicit"]["error"]
    text = "\n".join(describe(data))
    assert "MuJoCo implicit: MuJoCo with Integrator.IMPLICIT refuses the scene: constraint 'wall'" in text
    assert "ODE RK4: ODE refuses the scene: constraint 'wall'" in text


def test_a_page_says_which_structure_its_steps_are_of() -> None:
    """A taut structure is measured with strings of 1000 N/m, whose steps are not those of the scene; a net as it is."""
    engine = {"predicted": 0.0115, "measured": 0.0115, "ratio": 1.0, "agrees": True, "cause": "", "largest": 1.0}
    for name, words in (("prism", "with strings of 1000 N/m that are stretched by up to 2 %"), ("net", "net as it is")):
        base, text = scene_at_rest(scene := tmj.load_scene(name))
        shown = {"text": text, "stand_in": False, "engines": {"rk4": engine}}
        assert words in judgement_of({"scene": name, "base": shown}).verdict
        assert np.array_equal(base.structure.stiffness, scene.structure.stiffness) == (name == "net")


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_what_hangs_on_one_string_has_a_stand_in() -> None:
    """No force of one string is in balance but zero: the limits are those of another structure, by name."""
    hung = tmj.Structure(
        "hung",
        {"hook": (0.0, 0.0, 1.0), "m": (0.3, 0.0, 0.2)},
        strings=(tmj.String("s", ("hook", "m"), 300.0),),
        fixed_nodes=("hook",),
        point_masses=(tmj.PointMass("m", 1.0),),
    )
    scene = tmj.Scene(hung, gravity=(0.0, 0.0, -9.81))
    _, text = scene_at_rest(scene)
    assert text.startswith("a random taut structure of 1 rod")
    assert "in place of hung, which cannot be prestressed" in text
    (found,) = judgement_of(study_stability(scene, engines=("rk4",))).findings
    assert found.mark is Mark.UNJUDGED


def test_maps_of_a_structure_without_rods() -> None:
    base, text = base_structure(tmj.load_scene("spine"))
    assert "own self-stress" in text
    # c = 2 ζ √(k m/4), m being a vertebra's 0.136 kg.
    expected = 2 * 0.3 * np.sqrt(base.stiffness * 0.25 * 0.136)
    np.testing.assert_allclose(varied(base, "damping", 0.3).damping, expected, rtol=1e-12)
    with pytest.raises(OptionError, match="varies the mass of a rod, and structure 'spine' has none"):
        varied(base, "mass_ratio", 2.0)


def test_velocities_of_what_is_wholly_held_are_zero() -> None:
    """A pinned planar rod with a constraint on its end: round-off of what is taken away is no velocity."""
    rod = tmj.Rod("rod", ("a", "b"), 1.0, support=tmj.Support.pinned(0.0, plane=(0, 1, 0)))
    held = Constraint("held", {"b": 3.0}, (0.3, 0.0, 1.0))
    structure = tmj.Structure("held", {"a": (0, 0, 0), "b": (0.8, 0, 0.6)}, (rod,), constraints=(held,))
    rng = np.random.default_rng(0)
    for _ in range(20):
        wild = rng.normal(size=(2, 3)) * [1, 0, 1]
        found = velocities_with_supports(structure, structure.positions, (), wild)
        assert not found.any()
        tmj.Scene(structure, initial_velocities=found)
