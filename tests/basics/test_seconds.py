"""Times as people write them, on the command line, in Python, in sweeps and in files."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tensegrity_mj as tmj
from tensegrity_mj.basics.seconds import Rounded, fitted, read
from tensegrity_mj.cli import main
from tensegrity_mj.model.text.reading import scene_from_toml
from tensegrity_mj.model.text.writing import scene_to_toml

CASES: dict[str, tuple[float, float]] = {
    "0.5": (0.5, 0.0),  # one digit: meant as it stands
    "1e-3": (1e-3, 0.0),
    "0.00300": (3e-3, 0.0),  # so do zeros at the end
    "10.0": (10.0, 0.0),
    "1200": (1200.0, 0.0),  # a whole number
    "1/4800": (1 / 4800, 0.0),
    "0.01 / 48": (0.01 / 48, 0.0),
    "2.0833e-4": (2.0833e-4, 0.5e-8),  # half a unit of the fifth digit
    "0.0167": (0.0167, 0.5e-4),
    "33.33": (33.33, 0.5e-2),
}


@pytest.mark.parametrize("text", CASES)
def test_a_time_is_read_with_what_its_digits_leave_open(text: str) -> None:
    found = read(text)
    assert type(found) is Rounded
    assert (float(found), found.open) == (CASES[text][0], pytest.approx(CASES[text][1], rel=1e-12))


@pytest.mark.parametrize("text", ["", "x", "1 ms", "1/0", "1/2/3", "/2", "nan", "inf", "1e", "--1", "0x10", "1_000"])
def test_what_is_no_time_stays_a_text(text: str) -> None:
    assert read(text) == text
    with pytest.raises(tmj.errors.OptionError, match=r"it must be > 0 s, or a text such as"):
        tmj.MuJoCo(timestep=text)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("step", "times", "expected"),
    [
        ("2.0833e-4", [1.0], 1 / 4800),
        ("2.0833e-4", [10.0], 1 / 4800),  # 10/48001 is nearer; one over a whole number is likelier
        ("2.0833e-4", [1.0, 1 / 480], 1 / 4800),
        ("3.33e-3", [1.0], 1 / 300),
        ("1.2349e-3", [math.pi], math.pi / 2544),  # 1/810 is within it, and does not divide π
    ],
)
def test_an_open_step_becomes_one_that_divides(step: str, times: list[float], expected: float) -> None:
    found, moved = fitted(read(step), {str(number): time for number, time in enumerate(times)})
    assert found == pytest.approx(expected, rel=4e-16)
    assert abs(found - float(step)) <= read(step).open
    assert [*moved.values()] == times


def test_where_nothing_divides_all_stays_as_it_is() -> None:
    assert fitted(read("3.33e-3"), {"duration": 1.0, "break": 0.701}) == (3.33e-3, {"duration": 1.0, "break": 0.701})


def test_open_times_move_where_the_step_is_exact() -> None:
    found = fitted(read("1/3000"), {"duration": read("0.33333"), "output interval": read("0.0167"), "break": 0.25})
    assert found == (1 / 3000, {"duration": 1000 * (1 / 3000), "output interval": 50 * (1 / 3000), "break": 0.25})


@pytest.mark.parametrize("step", ["3e-3", "0.6", "2.09e-4"])
def test_what_does_not_divide_is_refused_with_what_does(step: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Of 2.09e-4 half a unit is 5e-7 s: 1/4785 is within it, of a run of 1 s; a run of 1 ms has no such divisor."""
    duration = "0.001" if step == "2.09e-4" else "1"
    assert main(["run", "prism", "--timestep", step, "--duration", duration]) == 2
    said = capsys.readouterr().err
    assert f"duration over the time step: {float(duration):g} s is no multiple of {float(step):g} s" in said
    assert f"{float(duration):g}/{round(float(duration) / float(step))} s in place of {float(step):g} s" in said


@pytest.mark.parametrize("step", ["2.0833e-4", "2.0833333333333335e-4", "1/4800", "48 steps", "48steps"])
def test_a_command_takes_a_step_as_it_is_typed(step: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "run.nc"
    times = ["--timestep", step, "--duration", "0.01", "--output-interval", "2.083e-3"]
    assert main(["run", "prism", *times, "--out", str(file), "--json"]) == 0
    said = capsys.readouterr()
    run = tmj.Trajectory.load(file)
    assert run.timestep == pytest.approx(1 / 4800, rel=2e-16)
    assert run.cost["steps"] == 48
    assert run.time[1] == 10 * run.timestep
    taken = json.loads(said.out)["reports"]["taken"]
    assert f"output interval 2.083e-3 s is taken as {10 * run.timestep!r} s (10 steps)" in taken
    assert all(f"note: {text}" in said.err for text in taken)
    assert (f"time step 2.0833e-4 s is taken as {run.timestep!r} s (48 steps)" in taken) is (step == "2.0833e-4")


def test_python_sweeps_and_files_take_the_same_texts(tmp_path: Path) -> None:
    expected = tmj.simulate("prism", timestep=1 / 4800, duration=0.0125, output_interval=1 / 480)
    for step in ("1/4800", "2.0833e-4"):
        run = tmj.simulate("prism", timestep=step, duration="1/80", output_interval="1/480")
        assert np.array_equal(run.nodes, expected.nodes)
        assert (run.timestep, run.provenance["duration"]) == (1 / 4800, 0.0125)
        many = tmj.simulate_many(["prism"], timestep=step, duration="1/80", output_interval="1/480")
        assert np.array_equal(many[0].nodes, expected.nodes)
    held: Any = tmj.Actuation.hold_rest_length("1/1200")  # type: ignore[arg-type]
    assert tmj.simulate("prism", timestep="1/4800", actuation=held, duration="1/80").provenance["duration"] == 0.0125
    sweep = tmj.studies.Sweep("prism", fixed={"engine.timestep": "1/4800", "scene.duration": "1/80"})
    (settings,) = sweep.points()
    point: Any = tmj.studies.sweep.simulate_point({**sweep.common(), "parameters": settings})
    assert (point["end_time"], point["steps"]) == (0.0125, 60)
    text = scene_to_toml(tmj.load_scene("prism")).replace("duration = 10", 'duration = "1/80"#')
    assert scene_from_toml(text).duration == 1 / 80
    with pytest.raises(tmj.errors.FormatError, match=r'duration = .* it must be a number, or a text such as "1/4800"'):
        scene_from_toml(text.replace("1/80", "1 min"))
    assert math.isnan(tmj.simulate("prism", engine="dae", duration="1/80").timestep)


def test_a_float_in_python_stays_what_it_is() -> None:
    with pytest.raises(tmj.errors.OptionError, match=r"1 s is no multiple of 0\.00020833 s"):
        tmj.simulate("prism", timestep=2.0833e-4, duration=1.0)
    near = (1 / 4800) * (1 + 5e-10)  # a multiple to 1e-9 of it
    assert tmj.simulate("prism", timestep=near, duration=0.01).timestep == near
