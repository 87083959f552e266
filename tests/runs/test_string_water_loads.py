"""Loads of water on strings along a run: by their closed form, by the momentum that they leave, and in files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tensegrity_mj as tmj
from tensegrity_mj.cli import main
from tensegrity_mj.errors import OptionError

RHO, D, C, ALONG, G = 1025.0, 0.02, 1.2, 0.05, 9.81
ENGINES = [tmj.DAE(rtol=1e-11, atol=1e-12), tmj.MuJoCo(1e-3)]
both = pytest.mark.parametrize("engine", ENGINES, ids=["DAE", "MuJoCo"])


def water(**more: Any) -> tmj.Water:
    return tmj.Water(density=RHO, drag=C, tangential_drag=ALONG, string_diameter=D, **more)


def pull(start: tuple[float, ...], end: tuple[float, ...], current: tuple[float, ...]) -> np.ndarray:
    """½ ρ C d ℓ |u_n| u_n + ½ ρ C_t π d ℓ |u_t| u_t of a straight line that stands still."""
    span = np.subtract(end, start)
    length = float(np.linalg.norm(span))
    slip = (span @ current) / length
    past = np.array(current) - slip * span / length
    across = C * np.linalg.norm(past) * past
    return 0.5 * RHO * D * length * (across + ALONG * np.pi * abs(slip) * slip * span / length)


@both
def test_a_current_pulls_strings_that_stand_still_as_the_closed_form_says(engine: Any) -> None:
    """A string, one over a pulley and, before it moves, one with mass; sums of 30 segments of 200 N to round-off."""
    current = (1.5, -0.4, 0.3)
    nodes = {"a": (0.0, 0, -5), "b": (2.0, 1, -6), "c": (0.0, 3, -4), "d": (5.0, 1, -4), "e": (5.0, 1, -9)}
    strings = (
        tmj.String("one", ("a", "b"), 50.0, rest_length=1.0),
        tmj.String("over", ("a", "c", "b"), 50.0, rest_length=1.0),
        tmj.String("line", ("d", "e"), 50.0, rest_length=4.0, mass=2.0, segments=7),
    )
    structure = tmj.Structure("still", nodes, (), strings, tuple(nodes))
    run = tmj.simulate(tmj.Scene(structure, water=water(current=current), duration=0.01), None, engine)
    loads, (a, b, c, d, e) = run.water_loads("string"), nodes.values()
    assert loads.shape == (len(run.time), 10, 3)
    one, over = pull(a, b, current), pull(a, c, current) + pull(c, b, current)
    np.testing.assert_allclose(loads[:, :2], np.broadcast_to([one, over], (len(run.time), 2, 3)), atol=1e-11)
    np.testing.assert_allclose(run.water_load("line", "string")[0], pull(d, e, current), atol=1e-11)
    np.testing.assert_array_equal(run.water_load("over", "string"), loads[:, 1])


def adrift() -> tmj.Scene:
    """Three sets of masses in waves and a current: two on a string, three on one over a pulley, two on a rope."""
    paths = {"one": ("a", "b"), "over": ("c", "d", "e"), "line": ("f", "g")}
    nodes = {name: (float(k), 0.3 * (k % 2), -5.0) for k, name in enumerate("abcdefg")}
    strings = tuple(
        tmj.String(name, path, 50.0, rest_length=0.9, **({"mass": 8.0, "segments": 4} if name == "line" else {}))
        for name, path in paths.items()
    )
    masses = tuple(tmj.PointMass(name, 2.0) for name in nodes)
    structure = tmj.Structure("adrift", nodes, (), strings, point_masses=masses)
    waves = (tmj.model.Wave(0.3, 12.0, direction=0.6),)
    sea = water(waves=waves, current=(0.4, 2.0, 0.0))
    return tmj.Scene(structure, gravity=(0.0, 0.0, -G), water=sea, duration=0.4)


@both
def test_loads_leave_the_momentum_that_what_they_hold_has(engine: Any) -> None:
    """M v of what hangs on a string is ∫ (F + M g) dt, by Simpson's rule over samples 2 ms apart.

    Drag slows 2 kg at 3 m/s or less by K u = 9 /s: the fourth derivative of F = 110 N/(1 + K u t)² is 120 (9 /s)⁴ F at
    first, 2e6 N/s³ in all, h⁴/180 of which are 2e-7 N s. Where a string slackens or tightens at 3 m/s, k ṡ/m = 75 m/s³
    make the second derivative jump by 2 c u 75 = 5.5e3 N/s², c = ½ ρ C_d d ℓ = 12 kg/m: of such a jump, Simpson's rule
    misses h³/12 at the most, 4e-6 N s. Five of them in 0.4 s are 2e-5 N s.
    """
    scene = adrift()
    run = tmj.simulate(scene, None, engine, output_interval=2e-3)
    structure, h = scene.structure, 2e-3
    for name, count in {"one": 2, "over": 3, "line": 6}.items():
        string = next(one for one in structure.given.strings if one.name == name)
        held = [row for node, row in structure.node_index.items() if node in string.nodes or node.startswith("line.")]
        held = held if name == "line" else held[:count]
        assert len(held) == count
        momentum = 2.0 * run.velocities[:, held].sum(axis=1)
        force = run.water_load(name, "string") + 2.0 * count * np.array(scene.gravity)
        simpson = h / 3 * np.cumsum(force[:-2:2] + 4 * force[1:-1:2] + force[2::2], axis=0)
        assert np.abs(momentum[2::2] - momentum[0] - simpson).max() < 2e-5
        assert np.abs(run.water_load(name, "string")).max() > 20.0


def test_engines_agree_on_the_loads_of_a_net_in_waves() -> None:
    """RK4 with equal steps is one function in both: nodes within 1e-11 m, so velocities within 1e-9 m/s at 100 rad/s.

    F = c u² with c = ½ ρ C_d d ℓ = 65 kg/m, and u < 2 m/s: 2 c u 1e-9 m/s.
    """
    scene = tmj.load_scene("fish_net")
    engines = (tmj.MuJoCo(2e-3), tmj.DAE(method="rk4", timestep=2e-3))
    first, second = (tmj.simulate(scene, None, engine, duration=1.0) for engine in engines)
    loads = first.water_loads("string")
    assert np.abs(loads - second.water_loads("string")).max() < 2 * 65 * 2 * 1e-9
    assert np.abs(loads).max() > 10.0


def test_files_and_tables_have_them_by_the_names_of_strings(tmp_path: Path) -> None:
    xarray = pytest.importorskip("xarray")
    run = tmj.simulate(adrift(), None, tmj.MuJoCo(1e-3), duration=0.05)
    loads, names = run.water_loads("string"), [string.name for string in run.scene.structure.strings]
    file = run.save(tmp_path / "run.nc", water_loads=True)
    with xarray.open_dataset(file) as data:
        xarray.testing.assert_identical(run.to_xarray(water_loads=True), data.load())
        assert "water_loads" not in data  # there are no rods
        assert data.string_water_loads.units == "N"
        np.testing.assert_array_equal(data.string_water_loads.sel(string="line.2"), loads[:, names.index("line.2")])
    again = tmj.Trajectory.load(file)
    np.testing.assert_array_equal(again.water_loads("string"), loads)
    frame = run.to_dataframe(water_loads=True)
    np.testing.assert_array_equal(frame["over.drag_y"], loads[:, 1, 1])
    found = run.statistics("string_water_load")
    assert found.names[3:10] == ("over.x", "over.y", "over.z", "line.x", "line.y", "line.z", "line.1.x")
    line = run.water_load("line", "string")  # the whole, in place of its parts, which come last
    in_order = np.concatenate([loads[:, :2].reshape(len(line), -1), line, loads[:, 2:].reshape(len(line), -1)], axis=1)
    np.testing.assert_allclose(found.values, in_order, rtol=1e-13, atol=1e-13)
    assert found.parts == 3 * len(run.scene.structure.ropes[0].parts)
    csv = run.save(tmp_path / "run.csv", water_loads=True).read_text().splitlines()[0].split(",")
    assert csv == ["time", *frame.columns]
    assert "over.drag_y" not in run.save(tmp_path / "without.csv").read_text()


def test_the_command_writes_them_where_there_are_any(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = str(tmp_path / "run.nc")
    assert main(["run", "fish_net", "--duration", "0.02", "--out", file, "--water-loads"]) == 0
    with pytest.importorskip("xarray").open_dataset(file) as data:
        np.testing.assert_array_equal(data.string_water_loads, tmj.Trajectory.load(file).water_loads("string"))
    capsys.readouterr()
    for arguments, words in ((["fish_net"], "needs --out FILE.nc"), (["prism", "--out", file], "has no water")):
        assert main(["run", *arguments, "--water-loads"]) == 2
        assert words in capsys.readouterr().err


def test_what_takes_no_load_is_refused() -> None:
    run = tmj.simulate(adrift(), None, tmj.DAE(), duration=0.01)
    for of, words in (("rod", "scene 'adrift' has no rods"), ("strings", "did you mean 'string'")):
        with pytest.raises(OptionError, match=words):
            run.water_loads(of)
    with pytest.raises(OptionError, match="no string 'lines'"):
        run.water_load("lines", "string")
    chain = tmj.simulate(tmj.load_scene("moored_chain"), None, tmj.MuJoCo(2e-3), duration=0.01)
    with pytest.raises(OptionError, match="has no string_diameter in its water"):
        chain.water_loads("string")
    first = chain.scene.structure.rods[0].name
    np.testing.assert_array_equal(chain.water_load(first), chain.water_loads()[:, 0])
