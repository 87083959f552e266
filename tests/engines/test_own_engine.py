"""A new engine is a module of its own and a row of the table: every command and study then has it.

The engine is `tests/helpers/verlet.py`, for a mass of 1.5 kg on a string of 60 N/m from which it is let go at a stretch
of 0.4 m: ω = √(k/m) = 6.32 rad/s, amplitude A = 0.4 - m g/k = 0.155 m, for T = 2 s. From rest, velocity Verlet has
x_n = A cos(ω' t_n) exactly, with sin(ω' h/2) = ω h/2: ω' - ω = ω (ω h)²/24, an error of A ω t (ω h)²/24 |sin(ω t)|. The
last peak of the sine is at ω t = 7π/2, t = 1.74 s, where t |sin(ω t)|/T = 0.87 is largest: 2.8e-6 m at h = 1 ms. Speeds
are off by cos(ω' h/2), so that ½ m v² is by (ω h)²/4 of k A²/2 at most.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from verlet import Verlet

import tensegrity_mj as tmj
from tensegrity_mj.cli import main
from tensegrity_mj.engines.table import ENGINES, engine_settings

K, M, G, T = 60.0, 1.5, 9.81, 2.0
OMEGA = np.sqrt(K / M)


@pytest.fixture
def hung(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """The row, and a file of the scene."""
    monkeypatch.setitem(ENGINES, "verlet", Verlet.descriptor)
    structure = tmj.Structure(
        "hung",
        {"hook": (0.0, 0.0, 0.0), "m": (0.0, 0.0, -1.4)},
        strings=(tmj.String("s", ("hook", "m"), K, rest_length=1.0),),
        fixed_nodes=("hook",),
        point_masses=(tmj.PointMass("m", M),),
    )
    path = tmp_path / "hung.toml"
    tmj.save_scene(tmj.Scene(structure, gravity=(0.0, 0.0, -G), duration=T), path)
    return path


def answer(capsys: pytest.CaptureFixture[str], *words: Any) -> Any:
    assert main([*map(str, words), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def error_of(step: float) -> float:
    return float(0.87 * (0.4 - M * G / K) * OMEGA * T * (OMEGA * step) ** 2 / 24)


def test_the_commands_have_it(hung: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    run = answer(capsys, "run", hung, "--engine", "verlet", "--timestep", 2e-3, "--out", tmp_path / "run.nc")
    assert run["engine"] == "Verlet, h = 0.002 s"
    assert tmj.Trajectory.load(tmp_path / "run.nc").engine == run["engine"]
    for step in (1e-3, 2e-3):
        found = answer(capsys, "compare", hung, "--engine", "verlet", "--reference", "dae", "--timestep", step)
        assert found["first"] == f"Verlet, h = {step:g} s"
        assert found["max_node_error"] == pytest.approx(error_of(step), rel=0.01)  # 0.87 is rounded
    model = answer(capsys, "linearize", hung, "--engine", "verlet")
    # Along the string √(k/m); across it, as a pendulum whose string pulls with k (L - 1) over L.
    assert max(model["frequencies"]) == pytest.approx(OMEGA / (2 * np.pi), rel=1e-5)
    assert answer(capsys, "statics", hung, "--check-engine", "verlet")["engine"]["same"]


def test_studies_have_it(hung: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    words = ["--vary", "engine=verlet,mujoco", "--vary", "engine.timestep=0.001,0.002", "--backend", "this-process"]
    found = answer(capsys, "sweep", hung, *words, "--set", "scene.duration=0.1", "--out", tmp_path / "out")
    assert found["ended"] == {"completed": 4}
    points = [json.loads(line)["outcome"] for line in (tmp_path / "out" / "points.jsonl").read_text().splitlines()]
    # Evaluations: one a step and one before the first; MuJoCo's Runge-Kutta has four a step.
    assert [one["values"]["evaluations"] for one in points][:2] == [101, 51]
    # Half the step, a quarter of the error, to the phase error itself: ω t (ω h)²/24 = 1e-3.
    words = ["--engines", "verlet", "--steps", "0.01", "0.005", "--duration", "1", "--repeats", "1"]
    answer(capsys, "tradeoff", hung, *words, "--out", tmp_path / "tradeoff")
    data = json.loads(next((tmp_path / "tradeoff").rglob("tradeoff.json")).read_text())
    coarse, fine = (one["error"] for one in data["experiments"][0]["points"])
    assert coarse / fine == pytest.approx(4, rel=0.01)
    assert engine_settings(Verlet(2e-3)) == ("verlet", {"timestep": 2e-3})


def test_what_it_has_not_is_refused(hung: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for words, message in {
        f"run {hung} --engine verlt": "'verlt': allowed: mujoco, dae, ode, jax, verlet; did you mean verlet?",
        f"run {hung} --engine verlet --rtol 1e-9": "--rtol belongs to --engine dae or ode",
        f"run {hung} --engine verlet --accuracy 1e-6": "--accuracy belongs to --engine mujoco or dae or ode; verlet ",
        f"run {hung} --engine verlet --timestep 3e-4": "time step",
        "run prism --engine verlet": "structure has rods: it moves point masses on strings alone; use MuJoCo or DAE",
    }.items():
        assert main(words.split()) == 2
        assert message in capsys.readouterr().err


def test_its_energy_is_kept_and_its_order_is_two(hung: Path) -> None:
    scene = tmj.load_scene(hung)
    errors = []
    for step in (1e-3, 2e-3):
        run = tmj.simulate(scene, engine=Verlet(step))
        stretch = M * G / K + (0.4 - M * G / K) * np.cos(OMEGA * run.time)
        errors.append(np.abs(run.nodes[:, 1, 2] + 1 + stretch).max())
        expected = (OMEGA * step) ** 2 / 8 * K * (0.4 - M * G / K) ** 2
        assert run.energy_residual == pytest.approx(expected, rel=1e-3)  # some sample is within 1e-2 of a peak's phase
    assert errors[1] / errors[0] == pytest.approx(4, rel=1e-3)
