"""Rest lengths that are not above zero, and force densities that push: refused in files, warned of in runs."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import tensegrity_mj as tmj
from tensegrity_mj.controllers import Replay
from tensegrity_mj.errors import OptionError, StructureError

K, LENGTH = 8.0, 1.0
FORCE, REST = tmj.Command.FORCE_DENSITY, tmj.Command.REST_LENGTH
ENGINES = [
    tmj.MuJoCo(1e-3),
    tmj.MuJoCo(1e-3, locate_slack=True),
    tmj.MuJoCo(1e-3, tmj.Integrator.EULER),
    tmj.MuJoCo(1e-3, tmj.Integrator.DISCRETE),
    tmj.DAE(rtol=1e-9),
    tmj.DAE(tmj.Method.RADAU, rtol=1e-8),
    tmj.DAE(tmj.Method.RK4, timestep=1e-3),
    tmj.DAE(tmj.Method.RK4, timestep=1e-3, locate_slack=True),
    tmj.ODE(rtol=1e-9),
    tmj.ODE(tmj.Method.RK4, timestep=1e-3),
]
every_engine = pytest.mark.parametrize("engine", ENGINES, ids=str)
PERIOD = 0.01
ACTUATIONS = [
    tmj.Actuation.continuous(),
    tmj.Actuation.hold_force_density(PERIOD),
    tmj.Actuation.hold_rest_length(PERIOD),
]
every_actuation = pytest.mark.parametrize("actuation", ACTUATIONS, ids=lambda a: a.mode.value)


def mass_between_two(**changes: Any) -> tmj.Scene:
    """A point mass between two fixed nodes, 1 m from each, on strings of 8 N/m: still while both pull alike."""
    strings = tuple(tmj.String(name, (name, "mass"), K, rest_length=0.5) for name in ("left", "right"))
    structure = tmj.Structure(
        "two",
        {"left": (-LENGTH, 0, 0), "mass": (0, 0, 0), "right": (LENGTH, 0, 0)},
        strings=strings,
        fixed_nodes=("left", "right"),
        point_masses=(tmj.PointMass("mass", 1.0),),
    )
    return tmj.Scene(structure, duration=0.3, **changes)


class Command:
    """Values (2,) from a time on, others before."""

    def __init__(self, values: Any, command: tmj.Command, since: float = 0.0, until: float = np.inf) -> None:
        self.values, self.command, self.since, self.until = np.array(values, float), command, since, until

    def __call__(self, time: float, nodes: Any, velocities: Any) -> Any:
        usual = 0.5 if self.command is REST else 0.5 * K
        return self.values if self.since <= time < self.until else np.full(2, usual)


def warned(run: tmj.Trajectory, words: str) -> list[str]:
    return [text for text in run.reports["warnings"] if words in text]


@pytest.mark.third_means("watch.*", by="times and least values of a law that is written down")
@every_engine
@every_actuation
def test_a_commanded_rest_length_below_zero_is_reported(engine: Any, actuation: tmj.Actuation) -> None:
    """With the string, the first time and the cause; and the run is that of the string law, L0 not clipped at zero.

    Both strings pull alike, k (L - L0) with L0 = -0.25 m, so nothing moves: T = 8 (1 + 0.25) N, up to round-off.
    """
    law = Command([-0.25, -0.25], REST, since=0.1)
    run = tmj.simulate(mass_between_two(), law, engine, actuation=actuation)
    (text,) = warned(run, "cannot be negative")
    assert "string 'left' (and 1 more)" in text
    report = run.reports["nonpositive_rest_lengths"]
    assert report["strings"] == ["left", "right"]
    # A fixed step begins there; one that is chosen ends at the latest at the output that follows.
    assert 0.1 - 1e-9 <= report["first_time"] <= 0.1 + PERIOD + 1e-9
    assert report["least"] == pytest.approx(-0.25, rel=1e-12)
    late = run.time > 0.1 + PERIOD
    assert run.tensions[late] == pytest.approx(K * (LENGTH + 0.25), rel=1e-12)
    assert run.rest_lengths[late] == pytest.approx(-0.25, rel=1e-12)


@every_engine
@every_actuation
def test_a_force_density_above_the_stiffness_is_reported(engine: Any, actuation: tmj.Actuation) -> None:
    """u = 10 N/m > k = 8 N/m: L0 = L (1 - u/k) = -0.25 m in every mode, and T = u L."""
    law = Command([10.0, 10.0], FORCE)
    run = tmj.simulate(mass_between_two(), law, engine, actuation=actuation)
    assert len(warned(run, "cannot be negative")) == 1
    assert run.reports["nonpositive_rest_lengths"]["first_time"] == 0.0
    assert run.force_densities == pytest.approx(10.0, rel=1e-12)
    assert run.rest_lengths == pytest.approx(-0.25, rel=1e-12)
    assert not warned(run, "cannot push")


@pytest.mark.third_means("watch.*", by="times and least values of a law that is written down")
@every_engine
@every_actuation
def test_a_negative_force_density_is_reported(engine: Any, actuation: tmj.Actuation) -> None:
    """It pulls nothing, as a slack string does: the run is that of zero, and the warning says why."""
    run = tmj.simulate(mass_between_two(), Command([4.0, -3.0], FORCE, since=0.1), engine, actuation=actuation)
    (text,) = warned(run, "cannot push")
    assert "string 'right' from t = 0.1" in text
    report = run.reports["negative_force_densities"]
    assert report["strings"] == ["right"]
    assert report["least"] == -3.0
    assert 0.1 - 1e-9 <= report["first_time"] <= 0.1 + PERIOD + 1e-9
    assert not warned(run, "cannot be negative")
    assert np.all(run.force_densities[run.time > 0.1 + PERIOD, 1] == 0)


FIXED = [engine for engine in ENGINES if getattr(engine, "timestep", None) is not None]


@pytest.mark.parametrize("engine", FIXED, ids=str)
@pytest.mark.parametrize("law", [Command([-0.1, 0.5], REST, 0.104, 0.107), Command([-1.0, 4.0], FORCE, 0.104, 0.107)])
def test_what_happens_between_recorded_samples_is_counted(engine: Any, law: Command) -> None:
    """For 3 ms between samples each 10 ms: nothing of it is recorded, three steps of 1 ms see it."""
    run = tmj.simulate(mass_between_two(), law, engine, output_interval=PERIOD)
    below = law.command is REST
    report = run.reports["nonpositive_rest_lengths" if below else "negative_force_densities"]
    assert report["steps"] == 3
    assert report["first_time"] == pytest.approx(0.104, abs=1e-12)
    assert report["strings"] == ["left"]
    assert run.rest_lengths.min() > 0
    assert len(warned(run, "cannot be negative" if below else "cannot push")) == 1


@pytest.mark.parametrize("engine", ENGINES[3::3], ids=str)
def test_round_off_and_limits_are_no_push(engine: Any) -> None:
    """A law's solution may be zero less round-off; a `min_rest_length` above the length requires less than zero."""
    run = tmj.simulate(mass_between_two(), Command([-1e-12, 4.0], FORCE), engine)
    assert run.reports["warnings"] == []
    scene = mass_between_two()
    limited = scene.with_(structure=scene.structure.with_strings(min_rest_length=1.2))
    assert not warned(tmj.simulate(limited, Command([4.0, 4.0], FORCE), engine), "cannot push")


def test_many_runs_at_once_report_it_too() -> None:
    runs = tmj.simulate_many([mass_between_two()] * 2, Command([-0.25, -3.0], REST), tmj.MuJoCo(1e-3))
    for run in runs:
        assert len(warned(run, "cannot be negative")) == 1
        assert run.reports["nonpositive_rest_lengths"]["least"] == -3.0


def test_a_string_that_broke_is_none_of_it() -> None:
    scene = mass_between_two(breaks=(tmj.model.Break("left", 0.1), tmj.model.Break("right", 0.1)))
    run = tmj.simulate(scene, Command([-0.25, -0.25], REST, since=0.15), tmj.MuJoCo(1e-3))
    assert run.reports["warnings"] == []


@pytest.mark.parametrize("command", ["run", "compare"])
def test_the_command_line_prints_it(command: str, tmp_path: Any, capsys: pytest.CaptureFixture[str]) -> None:
    """The prism's law on strings of 0.05 N/m, below the force densities that it sets."""
    from tensegrity_mj.cli import main

    prism = tmj.load_scene("prism")
    soft = prism.with_(structure=prism.structure.with_strings(stiffness=0.05, force_density=0.0))
    path = tmj.save_scene(soft, tmp_path / "soft.toml")
    assert main([command, str(path), "--duration", "0.1"]) == 0
    said = capsys.readouterr().err
    assert said.count("has a rest length of zero or less from t = ") == (2 if command == "compare" else 1)


@pytest.mark.parametrize("value", [0.0, -1e-9, -0.5])
def test_a_structure_without_line_is_refused(value: float, tmp_path: Any) -> None:
    with pytest.raises(StructureError, match=r"'s': rest_length = .*must be a finite number > 0 m"):
        one_string(rest_length=value)
    text = tmj.save_scene(tmj.Scene(one_string(rest_length=0.25)), tmp_path / "s.toml").read_text(encoding="utf-8")
    (tmp_path / "s.toml").write_text(text.replace("rest_length = 0.25", f"rest_length = {value}"), encoding="utf-8")
    with pytest.raises(tmj.TensegrityError, match="'s': rest_length"):
        tmj.load_scene(tmp_path / "s.toml")


def one_string(**prestress: float) -> tmj.Structure:
    return tmj.Structure(
        "one",
        {"a": (0, 0, 0), "b": (2, 0, 0)},
        strings=(tmj.String("s", ("a", "b"), 10.0, **prestress),),
        fixed_nodes=("a",),
        point_masses=(tmj.PointMass("b", 1.0),),
    )


@pytest.mark.parametrize(("name", "value", "most"), [("tension", 20.0, "20 N"), ("force_density", 12.0, "10 N/m")])
def test_prestress_that_leaves_no_line_is_refused(name: str, value: float, most: str) -> None:
    with pytest.raises(StructureError, match=rf"string 's': {name} = {value:g} .* must be below {most}"):
        one_string(**{name: value})
    assert one_string(**{name: 0.99 * value * (10 / 12 if name == "force_density" else 1)}).rest_lengths[0] > 0


@pytest.mark.parametrize(
    ("command", "bad", "words"), [(REST, 0.0, "rest length 0"), (FORCE, -0.1, "force density -0.1")]
)
def test_a_recording_of_what_no_winch_can_set_is_refused(command: tmj.Command, bad: float, words: str) -> None:
    times, values = [0.0, 0.1, 0.2], np.full((3, 2), 0.4)
    Replay(times, values, command)
    values[1, 1] = bad
    with pytest.raises(OptionError, match=rf"{words} of string number 1 at t = 0\.1 s; it must be >"):
        Replay(times, values, command)


@pytest.mark.parametrize("engine", ENGINES[::3], ids=str)
def test_a_winch_that_pays_out_gets_work(engine: Any) -> None:
    """The mass is held by both strings, whose winches let out 0.1 m/s: T = k (0.5 - 0.1 t) each, power -0.1 T."""
    scene = mass_between_two()

    class PayOut:
        command = REST

        def __call__(self, time: float, nodes: Any, velocities: Any) -> Any:
            return np.full(2, 0.5 + 0.1 * time)

    from tensegrity_mj.runs.energy import winch_power

    run = tmj.simulate(scene, PayOut(), engine, output_interval=PERIOD)
    # Two strings of energy k (L - L0)²/2, all of which goes into the winches: nothing moves. Round-off of 4 J.
    expected = 0.5 * K * 2 * ((0.5 - 0.1 * run.time) ** 2 - 0.25)
    assert run.winch_work == pytest.approx(expected, abs=1e-12)
    assert run.winch_work[-1] < -0.1
    middle = 0.5 * (run.time[1:] + run.time[:-1])
    # The mean over 10 ms of what is linear in time is the value in the middle.
    assert winch_power(run) == pytest.approx(np.tile(-0.1 * K * (0.5 - 0.1 * middle)[:, None], 2), abs=1e-10)


@pytest.mark.parametrize("engine", ENGINES[::3], ids=str)
def test_a_winch_pays_out_no_faster_than_it_can(engine: Any) -> None:
    """From 0.5 m towards 0.9 m at 0.4 m/s: 4 mm each 10 ms, the first at t = 0."""
    scene = mass_between_two()
    limited = scene.with_(
        structure=replace(
            scene.structure, strings=tuple(replace(string, winch_speed=0.4) for string in scene.structure.strings)
        )
    )
    law = Command([0.9, 0.9], REST)
    run = tmj.simulate(limited, law, engine, actuation=ACTUATIONS[2], output_interval=PERIOD)
    expected = np.minimum(0.9, 0.5 + 0.004 * (1 + np.arange(31)))
    assert run.rest_lengths == pytest.approx(np.tile(expected[:, None], 2), rel=1e-12)
    assert run.reports["limits"]["winch_speed"]["exceeded"] is None
