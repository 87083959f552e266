"""What is remembered of a scene between runs changes nothing of them."""

from __future__ import annotations

import warnings
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import tensegrity_mj as tmj
from tensegrity_mj.dynamics.native.law import Law
from tensegrity_mj.engines.mujoco.prepared import prepared
from tensegrity_mj.errors import DivergenceError, StabilityWarning
from tensegrity_mj.model.strings import StringLaw
from tensegrity_mj.vibration import step_warnings


def test_a_model_is_the_callers_own() -> None:
    scene, engine = tmj.load_scene("prism"), tmj.MuJoCo(1e-3)
    model = engine.model(scene)
    model.opt.gravity[:] = -5.0
    model.actuator_gainprm[:] = 0.0
    again = engine.model(scene)
    assert not again.opt.gravity.any()
    assert again.actuator_gainprm.any()


def test_steps_and_integrators_have_models_of_their_own() -> None:
    scene = tmj.load_scene("prism")
    for step, integrator in ((1e-3, tmj.Integrator.RK4), (2e-3, tmj.Integrator.RK4), (1e-3, tmj.Integrator.EULER)):
        engine = tmj.MuJoCo(step, integrator)
        fresh = prepared(tmj.load_scene("prism"), step, engine.word).model
        for model in (engine.model(scene), engine.model(scene)):
            assert model.opt.timestep == step
            assert model.opt.integrator == fresh.opt.integrator


@pytest.mark.parametrize("name", ["prism", "truss_arm", "tower_waves"])
def test_a_second_run_of_a_scene_is_the_first_one_bit_for_bit(name: str) -> None:
    """Limits of forces, which a run moves where strings are damped, and the data of contacts and motions included."""
    scene, fresh = tmj.load_scene(name), tmj.load_scene(name)
    scene, fresh = (
        one.with_(structure=replace(one.structure, string_law=StringLaw.UNCLIPPED), breaks=()) for one in (scene, fresh)
    )
    engine = tmj.MuJoCo(1e-3)
    tmj.simulate(scene, None, engine, duration=0.05)
    second, first = (tmj.simulate(one, None, engine, duration=0.1) for one in (scene, fresh))
    assert np.array_equal(second.nodes, first.nodes)
    assert np.array_equal(second.tensions, first.tensions)


def report_of(scene: tmj.Scene, law: Law | None, engine: tmj.MuJoCo) -> dict[str, Any]:
    """What the check before a run found, whatever became of the run."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StabilityWarning)
        try:
            run: Any = tmj.simulate(scene, law, engine, duration=engine.timestep)
        except DivergenceError as error:
            run = error.trajectory
    report: dict[str, Any] = run.reports["stability"]
    return report


def test_the_check_before_a_run_knows_laws_and_engines_apart() -> None:
    scene = tmj.load_scene("prism")
    slow, fast = (tmj.controllers.Lyapunov(scene.structure, scene.target, decay_rate=rate) for rate in (1.0, 500.0))
    short, long = tmj.MuJoCo(0.0001, tmj.Integrator.EULER), tmj.MuJoCo(0.01, tmj.Integrator.EULER)
    asked = [(slow, long), (fast, long), (fast, short), (slow, long), (fast, long)]
    found = [report_of(scene, law, engine) for law, engine in asked]
    # Euler's limit is below 2/δ, 0.004 s for δ = 500/s, and above 0.01 s for 1/s, where the strings' own is 0.3 s.
    assert [one["exceeded"] for one in found] == [False, True, False, False, True]
    assert found[1] == found[4]
    found[4]["notes"].append("a remark of somebody's")
    assert report_of(scene, fast, long) == found[1]  # reports are copies


def test_the_warning_comes_each_time() -> None:
    scene = tmj.load_scene("prism")
    law = tmj.controllers.Lyapunov(scene.structure, scene.target, decay_rate=500.0)
    for _ in range(2):
        with pytest.warns(StabilityWarning, match="beyond the largest stable one"), suppress(DivergenceError):
            tmj.simulate(scene, law, tmj.MuJoCo(0.01, tmj.Integrator.EULER), duration=0.01)


def test_the_check_is_made_once_for_what_stays_and_each_time_for_what_may_change(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made = []

    def count(*arguments: Any) -> tuple[dict[str, Any], str]:
        made.append(arguments)
        return {}, ""

    monkeypatch.setattr(step_warnings, "_before_run", count)
    scene = tmj.load_scene("prism")
    law = tmj.controllers.Lyapunov(scene.structure, scene.target)
    for _ in range(3):
        for step in (1e-3, 2e-3):
            tmj.simulate(scene, law, tmj.MuJoCo(step), duration=2e-3)
    assert len(made) == 2
    loaded = scene.with_(loads=lambda time: np.zeros((len(scene.structure.nodes), 3)))
    for _ in range(3):
        tmj.simulate(loaded, law, tmj.MuJoCo(1e-3), duration=2e-3)
    assert len(made) == 5
