"""Limits of real strings: the largest force density, the smallest rest length, the speed of the winch."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import tensegrity_mj as tmj
from tensegrity_mj.errors import StructureError

K = 8.0  # N/m
ENGINES = [tmj.MuJoCo(1e-3), tmj.DAE(rtol=1e-11, atol=1e-12), tmj.DAE(method=tmj.Method.RK4, timestep=1e-3)]
HOLD_U, HOLD_L0 = tmj.Actuation.hold_force_density(0.05), tmj.Actuation.hold_rest_length(0.05)
every_engine = pytest.mark.parametrize("engine", ENGINES, ids=str)


def weight_on_a_string(**limits: float) -> tmj.Scene:
    """A point mass of 1 kg that hangs 1 m below a fixed node; the string balances its weight of 2 N."""
    structure = tmj.Structure(
        "lift",
        {"top": (0, 0, 0), "mass": (0, 0, -1)},
        strings=(tmj.String("s1", ("top", "mass"), K, rest_length=0.75, **limits),),
        fixed_nodes=("top",),
        point_masses=(tmj.PointMass("mass", 1.0),),
    )
    return tmj.Scene(structure, gravity=(0.0, 0.0, -2.0))


class Constant:
    """The same command always."""

    def __init__(self, value: float, command: tmj.Command) -> None:
        self.value, self.command = value, command

    def __call__(self, time: float, nodes: Any, velocities: Any) -> Any:
        return [self.value]


@every_engine
@pytest.mark.parametrize("actuation", [tmj.Actuation.continuous(), HOLD_U], ids=lambda a: a.mode.value)
def test_force_densities_stay_below_their_limit(engine: Any, actuation: tmj.Actuation) -> None:
    scene = weight_on_a_string(max_force_density=2.5)
    limited = tmj.simulate(scene, Constant(3.0, tmj.Command.FORCE_DENSITY), engine, duration=1.0, actuation=actuation)
    requested = Constant(2.5, tmj.Command.FORCE_DENSITY)
    same = tmj.simulate(weight_on_a_string(), requested, engine, duration=1.0, actuation=actuation)
    np.testing.assert_array_equal(limited.nodes, same.nodes)
    assert limited.max_force_density == pytest.approx(2.5, rel=1e-12)
    report = limited.reports["limits"]["max_force_density"]
    assert report["reached"] == [[0.0, 1.0]]
    assert report["strings"] == ["s1"]
    assert report["exceeded"] is None
    assert same.reports["limits"] == {}


@every_engine
@pytest.mark.parametrize("command", list(tmj.Command), ids=lambda c: c.value)
def test_rest_lengths_stay_above_their_limit(engine: Any, command: tmj.Command) -> None:
    # Both commands give a rest length of 0.3 m at the start; it may not be below 0.6 m.
    value = K * (1 - 0.3) if command is tmj.Command.FORCE_DENSITY else 0.3
    scene = weight_on_a_string(min_rest_length=0.6)
    run = tmj.simulate(scene, Constant(value, command), engine, duration=0.2)
    held = tmj.simulate(weight_on_a_string(), Constant(0.6, tmj.Command.REST_LENGTH), engine, duration=0.2)
    # The same rest length through u = k (1 - L0/L) and back: round-off, and the steps chosen for it.
    np.testing.assert_allclose(run.rest_lengths, 0.6, rtol=1e-14)
    np.testing.assert_allclose(run.nodes, held.nodes, atol=1e-11)
    assert run.reports["limits"]["min_rest_length"]["reached"] == [[0.0, 0.2]]
    assert run.energy_residual < 1e-9


@every_engine
def test_a_winch_moves_no_faster_than_it_can(engine: Any) -> None:
    scene = weight_on_a_string(winch_speed=0.4)
    law = Constant(0.5, tmj.Command.REST_LENGTH)
    run = tmj.simulate(scene, law, engine, duration=1.0, actuation=HOLD_L0, output_interval=0.05)
    # From 0.75 m to 0.5 m at 0.4 m/s in jumps of 0.02 m each 0.05 s, the first at t = 0.
    expected = np.maximum(0.5, 0.75 - 0.02 * (1 + np.arange(21)))
    np.testing.assert_allclose(run.rest_lengths[:, 0], expected, rtol=1e-14)
    assert run.reports["limits"]["winch_speed"]["exceeded"] is None
    assert run.energy_residual < 1e-9
    free = tmj.simulate(weight_on_a_string(), law, engine, duration=1.0, actuation=HOLD_L0, output_interval=0.05)
    assert np.max(np.abs(free.nodes - run.nodes)) > 0.01


def test_where_no_winch_is_held_its_speed_is_reported() -> None:
    scene = weight_on_a_string(winch_speed=0.01)
    law = Constant(2.5, tmj.Command.FORCE_DENSITY)
    run = tmj.simulate(scene, law, tmj.MuJoCo(1e-3), duration=1.0, output_interval=1e-3)
    report = run.reports["limits"]["winch_speed"]
    lengths = scene.structure.string_rates(run.nodes, run.velocities)
    # L0 = L (1 - u/k): its speed is that of the string times (1 - u/k), between samples 1 ms apart: h²/24 L''' ~ 1e-7.
    assert report["exceeded"] == pytest.approx(np.max(np.abs(lengths)) * (1 - 2.5 / K), rel=1e-2)
    assert any("winch_speed of string 's1' is exceeded" in text for text in run.reports["warnings"])


def test_limits_survive_a_file_and_can_be_lifted(tmp_path: Any) -> None:
    scene = weight_on_a_string(max_force_density=2.5, min_rest_length=0.1, winch_speed=0.3)
    assert tmj.load_scene(tmj.save_scene(scene, tmp_path / "lift.toml")) == scene
    lifted = scene.structure.with_strings(max_force_density=None, min_rest_length=None, winch_speed=None)
    assert lifted == weight_on_a_string().structure
    assert scene.structure.with_strings(winch_speed=0.5).strings[0].winch_speed == 0.5
    assert scene.structure.limits("max_force_density").tolist() == [2.5]
    assert lifted.limits("min_rest_length").tolist() == [-np.inf]


@pytest.mark.parametrize("name", ["max_force_density", "min_rest_length", "winch_speed"])
@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), "fast"])
def test_bad_limits_are_refused(name: str, value: Any) -> None:
    with pytest.raises(StructureError, match=f"string 's1': {name}"):
        weight_on_a_string(**{name: value})
