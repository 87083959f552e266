"""A scene with contact through every public door: studies, replays, environments; who refuses it, and how."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tensegrity_mj as tmj
from tensegrity_mj.cli import main
from tensegrity_mj.controllers import Replay
from tensegrity_mj.engines.table import NAMES
from tensegrity_mj.model.elements.contact import floor_gaps
from tensegrity_mj.model.text.writing import scene_to_toml
from tensegrity_mj.studies.stable_steps import predict_steps

HERE = tmj.studies.Workers(backend=tmj.studies.Backend.THIS_PROCESS)
LANDED = 0.4  # s: the first foot touches at 0.25 s


@pytest.fixture(scope="module")
def scene() -> tmj.Scene:
    return tmj.load_scene("prism_drop")


def pull(time: float, nodes: Any, velocities: Any) -> Any:
    """A law of twelve strings without any target, that follows the motion."""
    return 100.0 + 20.0 * np.sin(30.0 * time) * np.ones(12) + 50.0 * np.tanh(velocities[0, 2])


def height(scene: tmj.Scene, nodes: Any, velocities: Any, u: Any) -> float:
    return float(nodes[:, 2].mean())


def touches(run: tmj.Trajectory) -> int:
    return int(max(run.reports["contact"]["touching"]))


def test_a_replay_does_the_same_to_the_floor(scene: tmj.Scene) -> None:
    """Held lengths are the same run bit by bit; splined ones err by the spline, h⁴ d⁴u/dt⁴/384 away from the kinks.

    Where a foot touches, u has a kink (its law follows the velocity): there a spline errs by parts of h² u″.
    """
    held = tmj.Actuation.hold_rest_length(1e-2)
    run = tmj.simulate(scene, pull, tmj.MuJoCo(1e-3), duration=LANDED, actuation=held)
    again = tmj.simulate(scene, Replay.of_run(run), tmj.MuJoCo(1e-3), duration=LANDED, actuation=held)
    assert touches(run) > 0
    np.testing.assert_array_equal(again.nodes, run.nodes)
    assert again.reports["contact"] == run.reports["contact"]
    errors = []
    for step in (5e-4, 2.5e-4):  # the last resolves the landing
        run = tmj.simulate(scene, pull, tmj.MuJoCo(step), duration=LANDED, output_interval=step)
        law = Replay.of_run(run, tmj.Command.FORCE_DENSITY)
        again = tmj.simulate(scene, law, tmj.MuJoCo(step), duration=LANDED, output_interval=step)
        errors.append(tmj.compare(run, again).max_node_error)
    assert errors[1] < errors[0] / 2
    assert errors[0] < 1e-3


def test_a_sweep_changes_the_floor_and_keeps_what_is_refused(scene: tmj.Scene) -> None:
    sweep = tmj.studies.Sweep(
        scene, [tmj.studies.Vary("scene.contact.floor", [0.0, -0.05, 0.5])], fixed={"scene.duration": LANDED}
    )
    study = sweep.run(workers=HERE)
    low, lower, inside = study.outcomes
    assert low["values"]["status"] == lower["values"]["status"] == "completed"
    assert low["values"]["energy_residual"] != lower["values"]["energy_residual"]
    assert "inside the floor" in inside["reason"]


def test_an_episode_is_the_engines_run(scene: tmj.Scene) -> None:
    """Both hold modes. An integrator of one stage, with which slackness of damped strings is the same in both.

    Only round-off differs, some 1e-16 m a step, which a landing amplifies by less than a hundredfold in 0.15 s.
    """
    environment = pytest.importorskip(
        "tensegrity_mj.learning.dm_control", exc_type=tmj.errors.MissingPackageError
    ).environment
    for command, held in (
        (tmj.Command.REST_LENGTH, tmj.Actuation.hold_rest_length(1e-2)),
        (tmj.Command.FORCE_DENSITY, tmj.Actuation.hold_force_density(1e-2)),
    ):
        env = environment(
            scene,
            command,
            control_timestep=1e-2,
            timestep=1e-3,
            time_limit=LANDED,
            reward=height,
            integrator=tmj.Integrator.EULER,
        )
        seen, taken, touched = env.reset(), [], 0
        while not seen.last():
            n = len(taken)
            action = scene.structure.rest_lengths * (1 - 0.05 * np.sin(0.3 * n))
            if command is tmj.Command.FORCE_DENSITY:
                action = np.full(12, 100.0 + 20.0 * np.sin(0.3 * n))
            taken.append(action)
            seen = env.step(action)
            touched = max(touched, env.physics.data.ptr.ncon)
        law = Replay(1e-2 * np.arange(len(taken)), np.array(taken), command, held=True, period=1e-2)
        run = tmj.simulate(scene, law, tmj.MuJoCo(1e-3, tmj.Integrator.EULER), duration=LANDED, actuation=held)
        assert touched > 0
        np.testing.assert_allclose(seen.observation["nodes"], run.nodes[-1], rtol=0, atol=1e-13)


def test_random_starts_overlap_nothing(scene: tmj.Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of starts within half a metre a good part of those 0.3 m above the floor would be inside it."""
    contact = scene.contact
    assert contact is not None
    dm_control = pytest.importorskip("tensegrity_mj.learning.dm_control", exc_type=tmj.errors.MissingPackageError)
    from tensegrity_mj.learning.tasks import definition as drawing

    def starts(of: tmj.Scene, displacement: float, count: int) -> Any:
        start = dm_control.RandomStart(displacement, 1.0, 3)
        env = dm_control.environment(of, time_limit=0.1, reward=height, start=start)
        return np.array([env.reset().observation["nodes"] for _ in range(count)])

    drawn = starts(scene, 0.5, 20)
    gaps = np.array([floor_gaps(scene.structure, contact, nodes).min() for nodes in drawn])
    assert gaps.min() >= 0
    free = starts(scene.with_(contact=None), 0.5, 20)
    assert min(floor_gaps(scene.structure, contact, nodes).min() for nodes in free) < -0.1
    np.testing.assert_array_equal(drawn, starts(scene, 0.5, 20))
    # The first draw that overlaps nothing is the one without contact: no draw is spent before it is needed.
    np.testing.assert_array_equal(drawn[0], free[0])
    monkeypatch.setattr(drawing, "MOST_DRAWS", 1)
    with pytest.raises(tmj.errors.OptionError, match=r"1 starts in a row overlap .*inside the floor: draw smaller"):
        starts(scene, 0.5, 20)


def test_validate_runs_in_mujoco_alone_and_says_so(scene: tmj.Scene) -> None:
    assert scene.contact is not None
    scene = scene.with_(contact=replace(scene.contact, torsion=1e-3))
    options: dict[str, Any] = {"sections": ["gravity"], "duration": LANDED, "quick": True, "workers": HERE}
    report = tmj.studies.validate(scene, pull, **options)
    assert report.data["setup"]["engines"] == ["mujoco"]
    assert report.data["nominal"]["engines"]["mujoco"]["outcome"] != "failed"
    assert "MuJoCo alone has contact: no other engine confirms what is said here." in report.summary
    assert not any("DAE" in text for text in report.summary)
    with pytest.raises(
        tmj.errors.OptionError, match=r"engines: dae, ode: scene 'prism_drop' has friction of turning.*leave them out"
    ):
        tmj.studies.validate(scene, pull, engines=["dae", "mujoco", "ode"], **options)


def test_compare_says_how_to_compare(scene: tmj.Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert scene.contact is not None
    (tmp_path / "turning.toml").write_text(scene_to_toml(scene.with_(contact=replace(scene.contact, torsion=1e-3))))
    for wrong in ([], ["--engine", "dae", "--reference", "ode"], ["--accuracy", "1e-4"]):
        assert main(["compare", str(tmp_path / "turning.toml"), "--duration", "0.1", *wrong]) == 2
        reported = capsys.readouterr().err
        assert "has contact, which MuJoCo alone simulates: there is no second engine" in reported
        assert "compare a.nc b.nc" in reported
    # As it says:
    for name, step in (("a", "1e-3"), ("b", "5e-4")):
        run = [
            "run",
            "prism_drop",
            "--duration",
            str(LANDED),
            "--timestep",
            step,
            "--out",
            str(tmp_path / f"{name}.nc"),
        ]
        assert main([*run, "--output-interval", "0.01"]) == 0
    capsys.readouterr()
    assert main(["compare", str(tmp_path / "a.nc"), str(tmp_path / "b.nc"), "--json"]) == 0
    assert 0 < json.loads(capsys.readouterr().out)["max_node_error"] < 0.01


def test_compare_takes_a_landing_to_the_dae(capsys: pytest.CaptureFixture[str]) -> None:
    """At the same RK4 step of 0.1 ms: truncation of both, in other coordinates, falls with h⁴ and is 1e-10 m here."""
    words = ["--duration", str(LANDED), "--timestep", "1e-4", "--method", "rk4", "--json"]
    assert main(["compare", "prism_drop", *words]) == 0
    assert 0 < json.loads(capsys.readouterr().out)["max_node_error"] < 1e-9


def test_stability_looks_along_a_run_that_lands(scene: tmj.Scene) -> None:
    """By the DAE. Where it refuses the scene, the step of that run is a tenth of the limit, or of the contact's time
    constant 2/b where that is shorter.
    """
    text = predict_steps(scene.with_(duration=LANDED), engines=["rk4"]).data["start"]["text"]
    assert "along a run of DAE DOP853" in text
    assert "with contact" in text
    assert scene.contact is not None
    scene = scene.with_(contact=replace(scene.contact, torsion=1e-3))
    start = predict_steps(scene.with_(duration=LANDED), engines=["rk4"]).data["start"]
    assert "along a run of MuJoCo 4.0.0 RK4, h = 0.000233" in start["text"]
    assert "with contact" in start["text"]
    assert start["engines"]["rk4"]["worst"]["time"] > 0
    assert scene.contact is not None
    hard = scene.with_(duration=0.02, contact=replace(scene.contact, damping=4e4))
    assert "h = 5e-06 s" in predict_steps(hard, engines=["rk4"]).data["start"]["text"]
    assert "rk4" in NAMES
