"""The benchmark measures what it says, on a tiny setting; no number of it is checked."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

import tensegrity_mj as tmj
from evidence.speed.benchmark import Benchmark, lines, run_benchmark
from tensegrity_mj.cli import main


def test_it_prints_json_with_all_that_was_measured(capsys) -> None:
    code = main(
        "audit speed prism cross --repeats 1 --sample 1e-4 --simulations 3 --threads 1,2 --no-renderer --json".split()
    )
    assert code == 0
    data = json.loads(capsys.readouterr().out)
    assert set(data) == {"status", "settings", "machine", "timing"}
    timing = data["timing"]
    assert set(timing) == {"single", "batch", "references", "startup"}
    assert [(row["scene"], row["integrator"]) for row in timing["single"]] == [
        (scene, integrator) for scene in ("prism", "cross") for integrator in ("rk4", "euler")
    ]
    assert [row["law"] for row in timing["single"][::2]] == ["at every stage", "each 0.01 s"]
    batches = [row for row in timing["batch"] if row["scene"] == "prism"]
    assert [(r["integrator"], r["threads"], r["loop"]) for r in batches] == [
        (integrator, threads, loop)
        for integrator in ("rk4", "euler")
        for threads in (1, 2)
        for loop in ("law_in", "simulate_many")
    ]
    for row in timing["single"] + batches:
        assert row["ratio"] == pytest.approx(row["closed"] / row["open"])
    assert "skipped" in timing["batch"][-1]
    assert len(timing["references"]) == 8
    assert {"help", "python", "slowest_imports"} == set(timing["startup"])


def test_its_lines_name_each_scene() -> None:
    options = Benchmark((tmj.load_scene("pinned_rod"),), repeats=1, sample=1e-4, simulations=0, startup=False)
    text = "\n".join(lines(run_benchmark(options)))
    assert "pinned_rod" in text
    assert "renderer" in text
    assert "start-up" not in text


@pytest.mark.parametrize(
    "options",
    [{"scenes": ()}, {"scenes": ("prism",)}, {"repeats": 0}, {"sample": 0.0}, {"simulations": -1}, {"threads": (0,)}],
)
def test_bad_options_are_refused(options) -> None:
    with pytest.raises(tmj.errors.OptionError, match="benchmark"):
        Benchmark(**({"scenes": (tmj.load_scene("prism"),)} | options))


def test_help_loads_nothing_heavy() -> None:
    # What keeps --help under half a second: numpy alone takes a tenth of one.
    code = (
        "import sys; from tensegrity_mj.cli import build_parser; build_parser().format_help()\n"
        "heavy = {'numpy', 'numba', 'mujoco', 'scipy', 'matplotlib', 'xarray', 'joblib', 'dask'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
    )
    child = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert child.returncode == 0, child.stderr
