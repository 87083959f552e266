"""Ground that shakes by a record: closed forms of its motion, an oscillator on it by SciPy, and two engines."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.signal import lsim

import tensegrity_mj as tmj
from tensegrity_mj.errors import FormatError, OptionError, SceneError
from tensegrity_mj.library.named import load_scene
from tensegrity_mj.model import Ground, load_ground
from tensegrity_mj.model.text.reading import scene_from_toml
from tensegrity_mj.model.text.writing import scene_to_toml

EPS = np.finfo(float).eps
ENGINES = [tmj.DAE(rtol=1e-12, atol=1e-13), tmj.MuJoCo(1e-3)]


def along_x(values: Any) -> Any:
    return np.outer(values, [1.0, 0.0, 0.0])


def record(seed: int, count: int = 60, start: float = 0.0) -> tuple[Any, Any]:
    """Noise, with an offset, as an instrument has it; every 0.02 s, from zero where it starts with the run."""
    values = np.random.default_rng(seed).normal(0.3, 1.0, (count, 3))
    values[0] *= start > 0
    return start + 0.02 * np.arange(count), values


def test_harmonic_acceleration_is_integrated_to_what_the_polygon_leaves_out() -> None:
    """Of a = -A ω² sin ω t, whose polygon errs by h²/8 A ω⁴: by that times t in the velocity, and ½ t² in the place."""
    A, omega, h = 0.1, 5.0, 1e-3
    t = h * np.arange(2001)
    polygon = -A * omega**2 * np.sin(omega * t)
    polygon[0] = 0.0
    d, v, _ = np.moveaxis(Ground(t, along_x(polygon), "none").states[..., 0], 1, 0)
    error = h**2 / 8 * A * omega**4
    assert np.abs(v - A * omega * (np.cos(omega * t) - 1)).max() < error * t[-1]
    assert np.abs(d - A * (np.sin(omega * t) - omega * t)).max() < error * t[-1] ** 2 / 2
    assert np.abs(d).max() > 0.5


def test_a_pulse_moves_the_ground_as_on_paper() -> None:
    """A constant a until T, then -a until 2 T: v up to a T, d = a T², and it rests there. Jumps take 1e-9 s."""
    a, T, jump = 3.0, 0.7, 1e-9
    pulse = Ground([0, T, T + jump, 2 * T], along_x([a, a, -a, -a]), "none")
    states = pulse.states[..., 0]
    assert states[1, 1] == pytest.approx(a * T, rel=4 * EPS)
    assert states[1, 0] == pytest.approx(0.5 * a * T**2, rel=4 * EPS)
    assert states[-1, 0] == pytest.approx(a * T**2, abs=2 * a * jump * T)
    assert states[-1, 1] == pytest.approx(0.0, abs=2 * a * jump)
    t = 0.4 * T  # between the record's times
    for motion in pulse.motions(hung().structure):
        np.testing.assert_allclose(motion.at(t)[:, 0], [0.5 * a * t**2, a * t, a], rtol=64 * EPS)


@pytest.mark.parametrize("start", [0.0, 0.7])
@pytest.mark.parametrize("seed", range(3))
def test_the_baseline_is_what_brings_the_ground_back(seed: int, start: float) -> None:
    """s (1 - s) times a line, or a constant for rest alone, found here from linear equations of its moments.

    Gauss' rule of three points in each interval is exact for these.
    """
    t, a = record(seed, start=start)
    h = t[1] - t[0]
    long = np.array([*([start - h] if start else []), *t, t[-1] + h])
    polygon = np.zeros((len(long), 3))
    polygon[-len(t) - 1 : -1] = a
    T, points = long[-1] - long[0], np.array([-1, 0, 1]) * np.sqrt(0.6)
    at = (long[:-1, None] + 0.5 * h * (1 + points)).ravel()
    weights = np.tile(0.5 * h * np.array([5, 8, 5]) / 9, len(long) - 1)
    values = np.stack([np.interp(at, long, polygon[:, k]) for k in range(3)], axis=1)
    s = (at - long[0]) / T
    bends = np.stack([s * (1 - s), s**2 * (1 - s)], axis=1)
    moments = np.stack([weights, weights * (long[-1] - at)])  # of the final velocity, and the final place
    shares = np.linalg.solve(moments @ bends, moments @ values)
    sums = (long - long[0]) / T
    back, stop = Ground(t, a), Ground(t, a, "stop")
    np.testing.assert_allclose(back.record[0], long, rtol=4 * EPS)
    expected = polygon - sums[:, None] * (1 - sums[:, None]) * (shares[0] + np.outer(sums, shares[1]))
    np.testing.assert_allclose(back.states[:, 2], expected, atol=1e-12)
    one = (moments[0] @ values) / (moments[0] @ bends[:, 0])
    np.testing.assert_allclose(stop.states[:, 2], polygon - np.outer(sums * (1 - sums), one), atol=1e-12)
    assert not back.states[[0, -1]].any()
    assert not stop.states[0].any()
    assert not stop.states[-1, 1:].any()
    # The motion is what its own acceleration makes of it: between the times too, by Gauss' rule.
    motion = back.motions(hung().structure)[0]
    speeds = np.cumsum(
        (weights[:, None] * np.array([motion.at(x)[2] for x in at])).reshape(-1, 3, 3).sum(axis=1), axis=0
    )
    np.testing.assert_allclose(back.states[1:, 1], speeds, atol=1e-13)
    assert np.abs(back.states[:, 0]).max() < 0.7 * np.abs(Ground(t, a, "none").states[:, 0]).max()


def hung(damping: float = 0.8) -> tmj.Scene:
    """A mass between two fixed nodes on taut strings along x: ẍ = -2 k/m (x - d) - 2 c/m (ẋ - ḋ), without gravity."""
    ends = (("s", "left"), ("t", "right"))
    strings = [tmj.String(name, (node, "m"), 30.0, damping, rest_length=0.4) for name, node in ends]
    nodes = {"left": (-1.0, 0.0, 0.0), "right": (1.0, 0.0, 0.0), "m": (0.0, 0.0, 0.0)}
    masses = (tmj.PointMass("m", 1.5),)
    structure = tmj.Structure("hung", nodes, (), strings, fixed_nodes=("left", "right"), point_masses=masses)
    return tmj.Scene(structure, duration=2.0)


@pytest.mark.parametrize("engine", ENGINES, ids=["DAE", "MuJoCo"])
def test_an_oscillator_on_the_ground_moves_as_scipy_says(engine: Any) -> None:
    """lsim takes inputs as linear between samples, so that what it gives for the relative motion is exact.

    RK4 errs by (ω h)⁴ ω T / 120 of motions of 1 m for ω = 6.3 rad/s, h = 1 ms, T = 2 s: 2e-10 m; each time of the
    record is a multiple of h. The DAE's error control of 1e-12 of a step grows to 1e-10. 2e-9 m is both with a margin.
    """
    t, a = record(4, 102)
    ground = Ground(t, along_x(a[:, 0]), "none")
    run = tmj.simulate(ground.shake(hung()), None, engine, output_interval=0.02)
    system = ([[0.0, 1.0], [-2 * 30.0 / 1.5, -2 * 0.8 / 1.5]], [[0.0], [-1.0]], np.eye(2), np.zeros((2, 1)))
    _, relative, _ = lsim(system, a[:-1, 0], t[:-1])
    place = ground.states[:-1, 0, 0]
    assert np.abs(relative[:, 0]).max() > 0.02
    assert np.abs(run.nodes[:, 2, 0] - place - relative[:, 0]).max() < 2e-9
    assert np.abs(run.nodes[:, 0, 0] + 1 - place).max() < 1e-12


def test_supports_follow_in_what_they_hold_and_planes_refuse() -> None:
    rod = tmj.Rod("r", ("a", "b"), 1.0, support=tmj.Support.constrained([(1.0, 1.0, 0.0)], 0.0))
    structure = tmj.Structure("slides", {"a": (0.0, 0.0, 0.0), "b": (0.0, 0.0, 1.0)}, (rod,))
    t, a = record(6)
    (motion,) = Ground(t, a).motions(structure)
    across = np.array([1.0, 1.0, 0.0]) / np.sqrt(2)
    whole = Ground(t, a).states
    np.testing.assert_allclose(motion.accelerations, np.outer(whole[:, 2] @ across, across), atol=1e-14)
    planar = replace(structure, rods=(replace(rod, support=tmj.Support.pinned(plane=(0.0, 1.0, 0.0))),))
    with pytest.raises(SceneError, match="ground: it shakes across the plane of rod 'r'"):
        Ground(t, a).motions(planar)
    assert Ground(t, a * [1.0, 0.0, 1.0]).motions(planar)[0].support == "r"


FILE = """\
format = 1
name = "shaken"

[structure]
nodes = { hook = [0, 0, 1], m = [0, 0, 0] }
fixed_nodes = ["hook"]
strings = [{ name = "s", nodes = ["hook", "m"], stiffness = 40, rest_length = 0.8 }]
point_masses = [{ node = "m", mass = 1 }]

[scene]
gravity = [0, 0, -9.81]

[scene.ground]
file = "quake.csv"
"""


def read(folder: Path, table: str, more: str = "") -> tmj.Scene:
    (folder / "quake.csv").write_text(table, encoding="utf-8")
    (folder / "shaken.toml").write_text(FILE + more, encoding="utf-8")
    return load_scene(str(folder / "shaken.toml"))


def test_a_scene_names_its_record_beside_it(tmp_path: Path) -> None:
    scene = read(tmp_path, "# station 7\ntime,az,ax\n0,0,1\n0.5,2,0\n1.5,-1,0.5\n", "scale = 9.81\n")
    expected = Ground([0, 0.5, 1.5], [[1, 0, 0], [0, 0, 2], [0.5, 0, -1]], scale=9.81)
    assert scene.motions == expected.motions(scene.structure)
    assert scene_from_toml(scene_to_toml(scene)).motions == scene.motions
    plain = read(tmp_path, "0,1,2\n1,3,4\n", 'baseline = "stop"\n')
    assert plain.motions == Ground([0, 1], [[1, 2, 0], [3, 4, 0]], "stop").motions(plain.structure)
    assert load_ground(tmp_path / "quake.csv", scale=2.0) == Ground([0, 1], [[1, 2, 0], [3, 4, 0]], scale=2.0)


@pytest.mark.parametrize(
    ("table", "more", "kind", "said"),
    [
        ("time,north\n0,1\n", "", FormatError, r"quake.csv, line 1: time, north; its columns must be time, ax, ay, az"),
        ("0,1,2,3,4\n", "", FormatError, "line 1: .*its columns must be"),
        ("time,ax\n0,1,2\n", "", FormatError, "line 2: 3 cells below 2 columns"),
        ("time,ax\n0,1\n1,nan\n", "", FormatError, "line 3: 1, nan; all must be finite numbers"),
        ("", "", FormatError, "scene.ground: .*quake.csv: 0 lines of numbers; a record needs two times or more"),
        ("time,ax\n0,1\n", "", FormatError, "quake.csv: 1 lines of numbers; a record needs two times or more"),
        ("time,ax\n0,1\n1,1\n1,2\n", "", FormatError, "quake.csv, line 4: time is 1 s after 1 s; times must increase"),
        ("time,ax\n-1,1\n1,1\n", "", SceneError, r"its times must increase from 0 or later; times\[0\] is -1 s"),
        ("0,1\n1,1\n", 'unit = "g"', FormatError, "scene.ground: unknown key 'unit'.*allowed: file, baseline, scale"),
        ("0,1\n1,1\n", 'baseline = "fit"', FormatError, 'baseline = \'fit\' .*must be "return" or "stop" or "none"'),
        ("0,1\n1,1\n", 'baseline = "none"', SceneError, "let them be at rest there, or cover the run of 10 s"),
        ("0,1\n1,1\n", "[scene.contact]\nfloor = -9.0", SceneError, "the floor of contacts stands still"),
    ],
)
def test_what_is_no_record_is_refused(tmp_path: Path, table: str, more: str, kind: Any, said: str) -> None:
    with pytest.raises(kind, match=said):
        read(tmp_path, table, more)


def test_what_is_no_path_or_no_order_of_times_is_refused() -> None:
    for path in (3, None):
        with pytest.raises(FormatError, match=f"{path}: that is no path; give the name of a record's CSV file"):
            load_ground(path)  # type: ignore[arg-type]
        with pytest.raises(OptionError, match=f"scene = {path}; use a Scene, or load_scene"):
            Ground([0, 1], [[0, 0, 0]] * 2).shake(path)  # type: ignore[arg-type]
    with pytest.raises(SceneError, match=r"from 0 or later; times\[2\] is 1 s after 2 s"):
        Ground([0, 2, 1], [[0, 0, 0]] * 3)


def test_a_text_alone_and_a_structure_without_supports_are_refused(tmp_path: Path) -> None:
    with pytest.raises(
        FormatError, match=r"scene.ground: file = 'quake.csv' .*no folder that a path could be relative"
    ):
        scene_from_toml(FILE)
    (tmp_path / "shaken.toml").write_text(FILE, encoding="utf-8")
    with pytest.raises(FormatError, match="quake"):
        load_scene(str(tmp_path / "shaken.toml"))
    t, a = record(1)
    with pytest.raises(SceneError, match=r"ground: structure .* has neither a support nor a fixed node"):
        Ground(t, a).shake(load_scene("prism_drop").with_(contact=None))
    twice = Ground(t, a).shake(hung())
    with pytest.raises(SceneError, match="motion of 'left': it is given twice"):
        Ground(t, a).shake(twice)
