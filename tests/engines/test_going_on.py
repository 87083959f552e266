"""Runs that go on from where another ended: the same, to the bit, as one run of the whole time."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from thrown_mass import hung

import tensegrity_mj as tmj
from tensegrity_mj.cli import main
from tensegrity_mj.runs.recorded import STATES, VARIABLES

H, HALF = 1e-3, 0.05
WINCH = tmj.Actuation.hold_rest_length(0.012)  # whose samples do not fall on the middle


SCENES: dict[str, tuple[Any, Any, Any]] = {  # scene, law, actuation
    "yielded strings and a load in time": (
        lambda: hung(loads=(tmj.model.Load("p", (3.0, 0.0, 1.0), 40.0),)),
        None,
        None,
    ),
    "a broken string and one to break": (
        lambda: hung(breaks=(tmj.model.Break("s", 0.02), tmj.model.Break("y", 0.08))),
        None,
        None,
    ),
    "a support that moves": (
        lambda: hung(motions=(tmj.model.Motion.in_line("left", amplitude=0.05, direction=(1, 0, 0), frequency=3.0),)),
        None,
        None,
    ),
    "a sampled law": (lambda: tmj.load_scene("prism"), "lyapunov", WINCH),
    "a law": (lambda: tmj.load_scene("prism"), "lyapunov", None),
}
ENGINES: dict[str, Any] = {
    "MuJoCo": tmj.MuJoCo(H),
    "MuJoCo Euler": tmj.MuJoCo(H, "euler"),  # type: ignore[arg-type]
    "DAE": tmj.DAE(method=tmj.Method.RK4, timestep=H),
}


def check(whole: tmj.Trajectory, second: tmj.Trajectory) -> None:
    """All that is recorded, to the bit; the ledger from the middle on, to the ulps of what was taken off."""
    row = int(np.searchsorted(whole.time, second.time[0]))
    for name in (*VARIABLES, *STATES):
        one, other = getattr(whole, name)[row:], getattr(second, name)
        if name in ("winch_work", "external_work", "dissipation"):
            scale = np.abs(getattr(whole, name)).max(initial=0.0) + np.abs(whole.string_energy).max(initial=0.0)
            np.testing.assert_allclose(other, one - one[:1], rtol=0, atol=8 * np.finfo(float).eps * scale)
        else:
            assert np.array_equal(one, other, equal_nan=True) or one.size == other.size == 0, name


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("case", SCENES)
def test_two_halves_are_the_whole(case: str, engine: str, tmp_path: Path) -> None:
    make, law, actuation = SCENES[case]
    scene, options = make(), {"actuation": actuation, "output_interval": 0.01}
    whole = tmj.simulate(scene, law, ENGINES[engine], duration=2 * HALF, **options)
    first = tmj.simulate(scene, law, ENGINES[engine], duration=HALF, **options)
    check(whole, tmj.simulate(first, law, ENGINES[engine], duration=HALF, output_interval=0.01))
    again = tmj.Trajectory.load(first.save(tmp_path / "run.nc"))
    check(whole, tmj.simulate(again, law, ENGINES[engine], duration=HALF, output_interval=0.01))


def test_a_landing_goes_on() -> None:
    """With spins, and what MuJoCo's solver of contact starts with."""
    scene = tmj.load_scene("prism_drop")
    engine = tmj.MuJoCo(5e-4)
    whole = tmj.simulate(scene, None, engine, duration=0.8)
    check(whole, tmj.simulate(tmj.simulate(scene, None, engine, duration=0.6), None, engine, duration=0.2))


def test_what_cannot_go_on_says_why() -> None:
    scene = hung()
    first = tmj.simulate(scene, engine=tmj.MuJoCo(H), duration=HALF)
    rest = tmj.simulate(first, engine=tmj.MuJoCo(H))
    assert (rest.time[0], rest.time[-1]) == (first.time[-1], scene.duration)
    for run, engine, message in (
        (first, tmj.DAE(), "the run to go on from is of MuJoCo"),
        (rest, tmj.MuJoCo(H), "has reached the scene's duration"),
        (tmj.simulate(scene, engine="dae", duration=HALF), tmj.DAE(), "cannot be continued from.*string 'y' yields"),
        (first, tmj.MuJoCo(3e-3), "no multiple"),
        (first.until(0), tmj.MuJoCo(H), "the run has no samples"),
    ):
        with pytest.raises(tmj.errors.OptionError, match=message):
            tmj.simulate(run, engine=engine)
    prism = tmj.simulate("prism", None, tmj.MuJoCo(H), duration=HALF)
    with pytest.raises(tmj.errors.OptionError, match="was not under the scene's own law"):
        tmj.simulate(prism, engine=tmj.MuJoCo(H))
    law = tmj.controllers.Delayed(tmj.controllers.from_scene(prism.scene), 1, 0.01)
    with pytest.raises(tmj.errors.OptionError, match="the law Delayed keeps"):
        tmj.simulate(prism, law, tmj.MuJoCo(H), actuation=tmj.Actuation.hold_rest_length(0.01))


def test_the_command_goes_on_from_a_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first, second = str(tmp_path / "first.nc"), str(tmp_path / "second.nc")
    assert main(["run", "prism", "--duration", "0.05", "--out", first]) == 0
    assert main(["run", "prism", "--from", first, "--duration", "0.05", "--out", second]) == 0
    assert "warning" not in capsys.readouterr().err
    check(tmj.simulate("prism", duration=0.1), tmj.Trajectory.load(second))
    assert main(["run", "prism", "--from", first, "--duration", "0.02", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["duration"] == pytest.approx(0.02, rel=1e-12)  # ulps of 0.07 s
    assert main(["run", "tbar", "--from", first]) == 2
    assert "a run of scene 'prism', whose nodes are others" in capsys.readouterr().err
    prism = tmj.load_scene("prism")
    wider = replace(
        prism.structure, nodes=dict(zip(prism.structure.node_names, 1.1 * prism.structure.positions, strict=True))
    )
    other = str(tmj.save_scene(tmj.Scene(wider, name="prism", duration=1.0), tmp_path / "wider.toml"))
    assert main(["run", other, "--from", first, "--out", second]) == 2  # its rods are longer by a tenth
    assert "a run of scene 'prism', whose rods, or the places of its nodes, are others" in capsys.readouterr().err
    assert main(["run", "prism", "--from", first, "--out", first]) == 2
    assert "--from and --out both name" in capsys.readouterr().err


def still(**more: Any) -> tmj.Scene:
    """As `hung`, of strings that do not yield."""
    scene = hung(**more)
    strings = [replace(one, curve=(), yields=False) for one in scene.structure.strings]
    return scene.with_(structure=replace(scene.structure, strings=strings))


def test_a_run_goes_on_from_any_of_its_samples(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """In the DAE, whose coordinates of point masses are the nodes, to the bit."""
    engine = ENGINES["DAE"]
    whole = tmj.simulate(still(), None, engine, output_interval=0.01)
    assert whole.at(0.1).provenance is whole.provenance
    check(whole, tmj.simulate(whole.at("1/25"), None, engine, output_interval=0.01))
    file, rest = str(whole.save(tmp_path / "run.nc")), str(tmp_path / "rest.nc")
    scene = str(tmj.save_scene(still(), tmp_path / "still.toml"))
    given = ["run", scene, "--engine", "dae", "--method", "rk4", "--timestep", "1e-3", "--output-interval", "0.01"]
    assert main([*given, "--from", f"{file}@0.04", "--out", rest]) == 0
    check(whole, tmj.Trajectory.load(rest))
    assert main([*given, "--from", f"{file}@0.044"]) == 2
    assert "has no sample at 0.044 s; the nearest: 0.04 s and 0.05 s" in capsys.readouterr().err
    assert main([*given, "--from", f"{file}@soon"]) == 2
    assert "time = 'soon'; it must be a finite number [s]" in capsys.readouterr().err
    assert main([*given, "--from", f"{file}@"]) == 2
    assert "time = ''; it must be a finite number [s]" in capsys.readouterr().err
    with pytest.raises(tmj.errors.OptionError, match=r"no sample at 0\.2 s; the nearest: 0\.1 s"):
        whole.at(0.2)
    # The kept state is that of the end alone.
    assert "end" in whole.provenance
    assert "end" not in whole.until(3).provenance


def test_samples_that_lack_a_part_of_the_state_are_refused_by_name_and_ends_are_not() -> None:
    for scene, law, options, message in (
        (hung(), None, {"timestep": H}, "string 'y' yields"),
        (tmj.load_scene("prism_drop"), None, {"timestep": 5e-4}, "scene 'prism_drop' has contact"),
        (
            tmj.load_scene("prism"),
            tmj.controllers.SCENE_LAW,
            {"timestep": H, "actuation": tmj.Actuation.hold_rest_length(0.01)},
            "winches hold the last",
        ),
        (
            tmj.load_scene("prism"),
            tmj.controllers.SCENE_LAW,
            {"timestep": H, "on_infeasible": "passive"},
            "rest lengths may be held",
        ),
    ):
        run = tmj.simulate(scene, law, duration=0.05, **options)
        remedy = "end a run there .its duration., and continue from its end"
        with pytest.raises(tmj.errors.OptionError, match=rf"continued from 0\.02 s: .*{message}.*: {remedy}"):
            tmj.simulate(run.at(0.02), law, **options)
        first = tmj.simulate(scene, law, duration=0.02, **options)
        check(run, tmj.simulate(first, law, duration=0.03, **options))
