"""The study of what `accuracy=` promises: how it counts, that it draws the same again, and a small one."""

from __future__ import annotations

import json
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import tensegrity_mj as tmj
from tensegrity_mj.cli import main
from tensegrity_mj.studies import promise_truth
from tensegrity_mj.studies.promise import BEYOND, Promise, measure
from tensegrity_mj.studies.promise_experiments import draw
from tensegrity_mj.studies.promise_page import write_promise


def row(number: int, **changes: Any) -> dict[str, Any]:
    """An experiment that keeps every promise, but for the changes."""
    kept = {
        "number": number,
        "experiment": "made up",
        "engine": "DAE",
        "requested": 1e-6,
        "estimate": 9e-7,
        "error": 5e-7,
        "settled": True,
        "met": True,
        "smooth": True,
        "cost_ratio": 3.0,
        "lucky_ratio": 6.0,
        "reason": "",
        "outcome": "measured",
    }
    return kept | changes


ROWS = (
    row(0),
    row(1, error=2e-6),  # beyond, by less than three times
    row(2, error=BEYOND * 1e-6 * 1.01),  # silently beyond
    row(3, error=1e-3, settled=False, met=False, estimate=1e-3),  # beyond, but says so; smooth
    row(4, cost_ratio=7.0, smooth=False),
    row(5, settled=False, met=False, smooth=False),
    {"number": 6, "experiment": "made up", "engine": "ODE", "outcome": "stopped", "cause": "at a pole"},
    {"number": 7, "outcome": "failed", "cause": "a bug"},
)


def test_how_promises_are_counted() -> None:
    found = Promise(ROWS, 1, None).fractions
    assert found["runs"] == 8
    assert found["outcomes"] == {"measured": 6, "stopped": 1, "no truth": 0, "refused": 0, "failed": 1}
    assert (found["within"]["count"], found["within"]["of"]) == (3, 6)
    assert (found["within_if_met"]["count"], found["within_if_met"]["of"]) == (2, 4)
    assert found["silently_beyond"] == [2]
    # Of those that say they met it: 3, 3, 3 and 7.
    assert (found["cost"]["count"], found["cost"]["of"], found["cost"]["largest"]) == (3, 4, 7.0)
    assert (found["cost_smooth"]["count"], found["cost_smooth"]["of"]) == (3, 3)
    assert found["cost_of"] == {"DAE": found["cost"]}
    assert (found["cost_by_luck"]["count"], found["cost_by_luck"]["median"]) == (0, 6.0)
    assert (found["unsettled_smooth"]["count"], found["unsettled_smooth"]["of"]) == (1, 4)
    assert found["unmet"]["count"] == 2


def test_failures_are_listed_with_what_they_broke() -> None:
    broken = {one["number"]: one["broken"] for one in Promise(ROWS, 1, None).failures}
    assert broken == {
        1: "beyond",
        2: "beyond 3 times, silently",
        3: "beyond, unsettled though smooth",
        4: "cost",
        7: "failed",
    }


def test_nothing_measured_is_no_division_by_zero() -> None:
    found = Promise(ROWS[6:], 1, None).fractions
    assert math.isnan(found["within"]["fraction"])
    assert math.isnan(found["cost"]["median"])


def test_a_number_draws_the_same_experiment_again() -> None:
    for number in (0, 1, 3, 4):
        first, second = draw(5, number), draw(5, number)
        assert (first.words, first.accuracy, first.engine) == (second.words, second.accuracy, second.engine)
        assert first.scene == second.scene
    # Kinds, engines and decades go round, so that 72 experiments hold every combination.
    drawn = [draw(5, number).engine for number in (0, 3, 6, 9)]
    assert drawn == ["MuJoCo", "DAE", "ODE", "MuJoCo"]


def test_a_setting_is_adequate_only_with_all_finer_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    """Errors by work of two methods, against a request of 1: 0.5 at work 2 is luck, since 3 is wrong again."""
    methods = (
        {1.0: 9.0, 2.0: 0.5, 3.0: 2.0, 4.0: 0.9, 6.0: 0.8, 8.0: 0.3, 99.0: 5.0},
        {1.5: 7.0, 5.0: 0.9, 7.0: 0.1},  # dearer, though adequate
    )

    def run(_: Any, errors: Any, work: float) -> Any:
        return SimpleNamespace(
            status=tmj.Status.COMPLETED, error=errors[work], cost={"evaluations": work, "wall_time": 1}
        )

    settings = [[promise_truth.Setting(errors, 1.0, work, work) for work in errors] for errors in methods]
    monkeypatch.setattr(promise_truth, "_sweeps", lambda *_: settings)
    monkeypatch.setattr(promise_truth, "_simulate", run)
    monkeypatch.setattr(promise_truth, "node_difference", lambda made, _: made.error)
    experiment: Any = SimpleNamespace(accuracy=1.0)
    truth: Any = SimpleNamespace(run=SimpleNamespace(time=[0.0, 0.1]))
    # What costs more than the whole run, 20, is not run.
    adequate, lucky = promise_truth.cheapest_of(experiment, truth, truth, 20.0)
    assert adequate is not None
    assert lucky is not None
    assert (adequate.work, lucky.work) == (4.0, 2.0)
    assert promise_truth.cheapest_of(experiment, truth, truth, 1.2) == (None, None)


def test_a_measured_experiment_is_true_and_reproducible() -> None:
    point = {"seed": 3, "number": 4}
    first, second = measure(point), measure(point)
    assert first["outcome"] == "measured"
    # The same two numbers from the public interface alone.
    experiment = draw(3, 4)
    run = tmj.simulate(experiment.scene, experiment.law, tmj.DAE(accuracy=experiment.accuracy))
    tight = tmj.DAE(rtol=1e-13, atol=1e-15)
    reference = tmj.simulate(experiment.scene, experiment.law, tight, output_interval=float(run.time[1]))
    assert first["estimate"] == run.error_estimate
    assert first["error"] == tmj.compare(run, reference).max_node_error
    assert first["error"] <= first["requested"]
    assert 0 < first["cost_ratio"] < 100
    assert first.pop("timing").keys() == second.pop("timing").keys()
    assert first == second


def test_the_page_and_the_data(tmp_path: Path) -> None:
    page = write_promise(tmp_path, Promise(ROWS, 1, tmp_path))
    text = page.read_text(encoding="utf-8")
    assert "at a pole" in text
    assert "beyond 3 times, silently" in text
    data = json.loads((tmp_path / "promise.json").read_text(encoding="utf-8"))
    assert data["failures"] == [1, 2, 3, 4, 7]


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["promise", "--runs", "2", "--seed", "3", "--workers", "1", "--out", str(tmp_path / "p"), "--json"]
    assert main(arguments) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["fractions"]["runs"] == 2
    assert (tmp_path / "p" / "promise.html").is_file()
    assert main(["promise", "--runs", "0", "--json"]) == 2
    assert "--runs 0" in capsys.readouterr().out


@pytest.mark.slow
def test_the_promise_holds_on_a_few() -> None:
    """Not the study itself, which takes an hour: every engine and kind once, at two requests."""
    rows = [{"number": n, **measure({"seed": 21, "number": n})} for n in (*range(9), *range(27, 36))]
    found = Promise(tuple(rows), 21, None).fractions
    assert found["outcomes"]["failed"] == found["outcomes"]["refused"] == 0
    assert found["silently_beyond"] == []
    assert found["within_if_met"]["fraction"] >= 0.95
