"""Long runs: what is measured on synthetic courses, and what the treatments of drift are known to do."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_words import choices_of

import tensegrity_mj as tmj
from evidence import drift as module
from evidence.drift import (
    COARSENESS,
    METHODS,
    PAGE,
    conservative,
    default_step,
    growth,
    long_runs,
    marks_of,
    measured,
)
from evidence.extremes.pace import pace
from tensegrity_mj.cli import main
from tensegrity_mj.errors import OptionError
from tensegrity_mj.studies.workers import Backend, Workers

HERE = Workers(backend=Backend.THIS_PROCESS)


@pytest.mark.parametrize("power", [0.0, 0.5, 1.0, 2.0])
def test_the_growth_of_a_power_of_time(power: float) -> None:
    steps = [1000, 10_000, 100_000]
    assert growth([1e-9 * n**power for n in steps], steps) == pytest.approx(power, abs=1e-12)


def test_no_growth_of_what_is_below_round_off() -> None:
    assert growth([1e-16, 5e-16], [1000, 10_000]) is None
    assert growth([1e-3], [1000]) is None


def test_marks() -> None:
    assert marks_of(1_000_000) == [1000, 10_000, 100_000, 1_000_000]
    assert marks_of(5000) == [1000, 5000]
    assert marks_of(1000) == [1000]


def test_departures_are_measured_from_the_start_and_of_what_was_exchanged() -> None:
    # 1000 rows of a pinned rod whose nodes and velocities are doctored: b grows by 1 % at the end, ḃ leans along b.
    scene = conservative(tmj.load_scene("pinned_rod"), 0)
    run = tmj.simulate(scene, None, tmj.DAE(), duration=1.0, output_interval=1e-3)
    clean = measured(run, 1e-3, 1000)
    assert max(clean[name]["1000"] for name in ("energy", "length", "rate")) < 1e-8
    i, j = scene.structure.rod_nodes[0]
    length = scene.structure.rod_lengths[0]
    nodes, velocities, kinetic = run.nodes.copy(), run.velocities.copy(), run.kinetic_energy.copy()
    nodes[-1, j] = nodes[-1, i] + 1.01 * (nodes[-1, j] - nodes[-1, i])
    b = (nodes[500, j] - nodes[500, i]) / length
    velocities[500, j] = velocities[500, j] + 0.3 * length * b
    kinetic[200] += 0.5 * kinetic.max()
    found = measured(replace(run, nodes=nodes, velocities=velocities, kinetic_energy=kinetic), 1e-3, 1000)
    assert found["length"]["1000"] == pytest.approx(1.01**2 - 1, rel=1e-6)
    assert found["rate"]["1000"] == pytest.approx(0.3, rel=1e-6)
    assert found["energy"]["1000"] > 0.1
    assert found["course"]["steps"][-1] == 1000


def test_the_scene_is_conservative_and_moves() -> None:
    scene = tmj.load_scene("prism")
    structure = scene.structure.with_strings(damping=0.3)
    busy = scene.with_(
        structure=structure, loads=(tmj.model.Load("n1", (1.0, 0, 0)),), breaks=(tmj.model.Break("s1", 0.1),)
    )
    free = conservative(busy, 0)
    assert not free.loads
    assert not free.breaks
    assert free.control is None
    assert not np.any(free.structure.damping)
    assert np.any(free.velocities0)
    np.testing.assert_array_equal(free.velocities0, conservative(busy, 0).velocities0)
    assert np.any(free.velocities0 != conservative(busy, 1).velocities0)
    np.testing.assert_array_equal(conservative(free, 5).velocities0, free.velocities0)  # what moves, moves as it does
    # Two digits of the step: within 5 %.
    assert default_step(free) * pace(free).fastest == pytest.approx(COARSENESS, rel=0.05)


def test_drift_of_the_prism(tmp_path: Path) -> None:
    result = long_runs("prism", 10_000, methods=["euler", "rk4", *METHODS[5:]], folder=tmp_path / "a", workers=HERE)
    rows = {row["method"]: row for row in result.data["rows"]}
    assert not any(row["reason"] for row in rows.values())
    end = {name: {key: row[key]["10000"] for key in ("energy", "length", "rate")} for name, row in rows.items()}
    # MuJoCo's quaternions and the ODE's angles cannot stretch a rod; normalization leaves round-off: (1 + ε)² - 1 of a
    # few operations.
    for name in ("euler", "rk4", "dae normalize", "ode"):
        assert end[name]["length"] < 1e-13
    # Where drift is only watched it grows with time; Baumgarte's treatment bounds it, normalization removes it.
    assert end["dae monitor"]["length"] > 100 * end["dae baumgarte"]["length"] > 1e-10
    assert rows["dae monitor"]["growth"]["length"] > 0.9
    assert rows["dae baumgarte"]["growth"]["length"] < 0.5
    assert end["dae normalize"]["rate"] < 1e-13 < end["dae monitor"]["rate"]
    # Semi-implicit Euler keeps the energy within a band of the order of the step; RK4 loses it steadily and slowly.
    assert rows["euler"]["growth"]["energy"] < 0.6
    assert 0.6 < rows["rk4"]["growth"]["energy"] < 1.5
    assert end["rk4"]["energy"] < 0.1 * end["euler"]["energy"]
    # The same again, bit by bit, from what is kept and anew; the page and the table hold every method.
    text = (tmp_path / "a" / "drift.json").read_bytes()
    long_runs("prism", 10_000, methods=["euler", "rk4", *METHODS[5:]], folder=tmp_path / "a", workers=HERE)
    assert (tmp_path / "a" / "drift.json").read_bytes() == text
    page = (tmp_path / "a" / "drift.html").read_text()
    assert all(name in page and name in result.text for name in rows)
    # What a run warns of, energy off by more than 1 % or bᵀb by more than 0.1 %, is counted in the verdict.
    bad = [name for name in rows if end[name]["length"] > 1e-3]
    limited = [name for name in rows if end[name]["energy"] > 0.01 and name not in bad]
    assert f"{len(rows) - len(bad) - len(limited)} of {len(rows)} methods keep energy and lengths over 10,000" in page
    assert re.findall(r'class="mark (\w+)', page)[: len(bad) + len(limited)] == ["bad"] * len(bad) + ["limited"] * len(
        limited
    )


def test_a_page_of_runs_that_have_no_numbers_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Write the page where a worker dies, or an engine refuses the scene."""

    def refuse(scene: tmj.Scene, *_: object, **__: object) -> None:
        raise OptionError("it cannot")

    monkeypatch.setattr(module, "simulate_as_far", refuse)
    result = long_runs("prism", 1000, methods=["ode"], folder=tmp_path, workers=HERE)
    assert result.data["rows"][0]["reason"] == "it cannot"
    assert "ode: it cannot" in result.text
    page = (tmp_path / PAGE).read_text(encoding="utf-8")
    assert "0 of 1 methods" in page
    assert '<div class="mark bad">bad</div><div>ode: it cannot</div>' in page


def test_a_run_that_diverges_is_a_row() -> None:
    step = 3.0 / pace(conservative(tmj.load_scene("prism"), 0)).fastest
    with pytest.warns(tmj.errors.StabilityWarning):
        result = long_runs("prism", 1000, timestep=step, methods=["euler"], workers=HERE)
    assert "diverged by t = " in result.data["rows"][0]["reason"]
    assert "diverged by t = " in result.text


def test_the_command(capsys: pytest.CaptureFixture[str]) -> None:
    assert choices_of("audit drift", "--methods") == list(METHODS)
    words = "audit drift pinned_rod --steps 1000 --workers 1 --json --methods"
    arguments = [*words.split(), "dae normalize"]
    assert main(arguments) == 0
    reported = json.loads(capsys.readouterr().out)
    assert reported["rows"][0]["method"] == "dae normalize"
    assert set(reported["setup"]) == {"scene", "steps", "timestep", "seed", "marks"}
    assert main(["audit", "drift", "pinned_rod", "--steps", "1500"]) == 2
    assert main(["audit", "drift", "pinned_rod", "--workers", "0"]) == 2
    for bad in ({"steps": 10}, {"seed": -1}, {"methods": ["heun"]}):
        with pytest.raises(OptionError):
            long_runs("pinned_rod", **{"steps": 1000, **bad})  # type: ignore[arg-type]


def spinning_rod() -> tmj.Scene:
    """A free rod of 1 m that turns at 2 rad/s."""
    nodes = {"a": (0.0, -0.5, 0.0), "b": (0.0, 0.5, 0.0)}
    structure = tmj.Structure("rod", nodes=nodes, rods=(tmj.Rod("rod", ("a", "b"), 1.0),), strings=())
    return tmj.Scene(structure, initial_velocities=[[1.0, 0, 0], [-1.0, 0, 0]])


@pytest.mark.parametrize(("steps", "reported"), [(1000, False), (1300, True)])
def test_a_run_whose_rods_drift_off_their_lengths_says_so_before_the_energy_does(steps: int, reported: bool) -> None:
    """RK4 shrinks an oscillation at ω by (hω)⁶/144 a step: bᵀb by 2 n 0.2⁶/144, 8.9e-4 and 1.16e-3; so the energy."""
    engine = tmj.DAE(method=tmj.Method.RK4, timestep=0.1, drift=tmj.engines.Drift.MONITOR)
    run = tmj.simulate(spinning_rod(), None, engine, duration=steps * 0.1)
    assert run.reports["drift"] == pytest.approx(2 * steps * 0.2**6 / 144, rel=0.03)
    warnings = run.reports["warnings"]
    assert len(warnings) == reported
    if reported:
        first = 0.1 * 1e-3 * 144 / (2 * 0.2**6)  # s, at which bᵀb is off by 1e-3: 112.5
        assert f"{run.reports['drift'] / 2:.2g} of it" in warnings[0]
        assert float(warnings[0].split("t = ")[1].split(" s")[0]) == pytest.approx(first, rel=0.03)
        assert "Drift.NORMALIZE" in warnings[0]
    kept = tmj.simulate(spinning_rod(), None, replace(engine, drift=tmj.engines.Drift.NORMALIZE), duration=steps * 0.1)
    assert kept.reports["drift"] < 1e-14
    assert kept.reports["warnings"] == []


def test_a_million_steps_that_only_watch_their_drift_say_that_they_are_not_to_be_trusted() -> None:
    scene = conservative(tmj.load_scene("prism"), 0)
    h = default_step(scene)
    run = tmj.simulate(
        scene,
        None,
        tmj.DAE(method=tmj.Method.RK4, timestep=h, drift=tmj.engines.Drift.MONITOR),
        duration=1e6 * h,
        output_interval=1000 * h,
    )
    assert run.reports["drift"] > 0.1
    for what in ("energy balance", "drifts off its length"):
        assert any(what in text for text in run.reports["warnings"])
