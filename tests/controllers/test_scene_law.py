"""Which law runs: the scene's own unless another is given, in every call and on the command line."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tensegrity_mj as tmj
from evidence.stability.study import StabilityStudy
from tensegrity_mj import simulation, studies
from tensegrity_mj.cli import main
from tensegrity_mj.controllers import SCENE_LAW
from tensegrity_mj.controllers.specs import NO_LAW
from tensegrity_mj.engines.jax.settings import JAX
from tensegrity_mj.simulation import ensemble
from tensegrity_mj.studies.stable_steps import predict_steps
from tensegrity_mj.studies.sweep import simulate_point
from tensegrity_mj.studies.tradeoff.study import tradeoff
from tensegrity_mj.studies.validation.study import validate
from tensegrity_mj.vibration.stable_step import stable_step
from tensegrity_mj.vibration.step_warnings import explain_warnings

SHORT: dict[str, Any] = {"duration": 0.02}
CALLS: list[tuple[Any, str]] = [
    *((tmj.simulate, "controller"), (simulation.simulate, "controller"), (JAX.model, "controller")),
    *((tmj.simulate_many, "controllers"), (ensemble.simulate_many, "controllers")),
    *((one, "law") for one in (tmj.law_in, ensemble.law_in, tmj.stable_step, stable_step, explain_warnings)),
    *((one, "law") for one in (tmj.identify, studies.identify, studies.Sweep, tradeoff)),
    *((one, "law") for one in (validate, predict_steps, StabilityStudy)),
]


@pytest.mark.parametrize(("call", "law"), CALLS)
def test_the_default_of_every_call_is_the_scenes_own_law(call: Any, law: str) -> None:
    default = inspect.signature(call).parameters[law].default
    assert default is SCENE_LAW
    assert repr(default) == "SCENE_LAW"


def test_a_scenes_own_law_runs_in_python_as_on_the_command_line(prism: tmj.Scene, tmp_path: Path) -> None:
    file = tmp_path / "run.nc"
    assert main(["run", "prism", "--duration", "0.02", "--out", str(file)]) == 0
    there, given = tmj.Trajectory.load(file), tmj.simulate(prism, "lyapunov", **SHORT)
    for run in (
        tmj.simulate("prism", **SHORT),
        simulation.simulate(prism, **SHORT),
        tmj.simulate_many([prism], **SHORT)[0],
    ):
        assert run.provenance["controller"] == there.provenance["controller"] == given.provenance["controller"]
        assert np.array_equal(run.nodes, there.nodes)
        assert np.array_equal(run.nodes, given.nodes)
    assert tmj.stable_step(prism, "mujoco").closed_loop
    with tmj.law_in(prism) as model:
        assert model.nu == len(prism.structure.strings)


@pytest.mark.parametrize("none", [None, "none"])
def test_none_is_no_law(prism: tmj.Scene, none: Any) -> None:
    """Without its law the prism stays where it stands in equilibrium, to round-off.

    Forces of 0.1 N that cancel to ε of them move 1 kg by 5e-21 m in 0.02 s; places below 1 m have ulps of 1e-16 m.
    """
    for run in (tmj.simulate(prism, none, **SHORT), tmj.simulate_many([prism], none, **SHORT)[0]):
        assert run.provenance["controller"] is None
        np.testing.assert_allclose(run.nodes[-1], run.nodes[0], rtol=0, atol=1e-14)
    assert not tmj.stable_step(prism, "mujoco", law=none).closed_loop
    sweep = studies.Sweep(prism, fixed={"scene.duration": 0.02}, law=none)
    assert sweep.common()["law"] == NO_LAW
    (point,) = sweep.points()
    values: Any = simulate_point({**sweep.common(), "parameters": point})
    assert values["final_lyapunov"] is None
    with pytest.raises(tmj.errors.OptionError, match="validate: there is no law to test"):
        studies.validate(prism, none)


def test_a_scene_without_a_law_runs_without_one_and_each_of_many_runs_its_own() -> None:
    assert tmj.simulate("tbar", **SHORT).provenance["controller"] is None
    prism = tmj.load_scene("prism")
    assert prism.control is not None
    slower = prism.with_(control=tmj.model.ControlSpec("lyapunov", {"decay_rate": 0.5}))
    runs = tmj.simulate_many([prism, slower, prism.with_(control=None)], **SHORT)
    for run, scene in zip(runs, runs.scenes, strict=True):
        assert np.array_equal(run.nodes, tmj.simulate(scene, **SHORT).nodes)
    assert not np.array_equal(runs[0].nodes, runs[1].nodes)
    assert runs[2].provenance["controller"] is None


def test_a_law_that_cannot_be_made_says_how_to_run_without_it(prism: tmj.Scene) -> None:
    with pytest.raises(
        tmj.errors.OptionError, match=r"no target, which its law needs: .* \(controller=None, --law none\)"
    ):
        tmj.simulate(prism.with_(target=None), **SHORT)


def test_a_model_is_that_of_the_plant_unless_the_loop_is_requested(prism: tmj.Scene) -> None:
    assert tmj.linearize(prism, "dae").gain is None
    closed = tmj.linearize(prism, "dae", law=SCENE_LAW)
    assert np.array_equal(closed.A, tmj.linearize(prism, "dae", law="lyapunov").A)
