"""Runs that begin later than at 0: the rest of a run from 0, from the state that it had then."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tensegrity_mj as tmj
from tensegrity_mj.dynamics.native.law import native_law
from tensegrity_mj.engines.accuracy.search import Steps
from tensegrity_mj.engines.driving import Grid
from tensegrity_mj.engines.request import Request
from tensegrity_mj.errors import OptionError, SceneError
from tensegrity_mj.model import Break, Ground, Load, Motion

H, BEGIN, END = 1e-3, 0.05, 0.1
EPS = np.finfo(float).eps
STIFFEST = 60.0  # 1/s: of the masses and strings here, (2 x 800 N/m / 0.5 kg)^1/2
RK4 = {"method": "rk4", "timestep": H}


def mass(**more: Any) -> tmj.Scene:
    structure = tmj.Structure(
        "mass",
        {"top": (0.0, 0.0, 1.0), "left": (-1.0, 0.0, 0.2), "p": (0.0, 0.0, 0.0)},
        point_masses=[tmj.PointMass("p", 0.5, damping=0.3)],
        strings=[
            tmj.String("y", ("top", "p"), 800.0, 1.0, rest_length=0.9),
            tmj.String("s", ("left", "p"), 300.0, 0.5, rest_length=0.8),
        ],
        fixed_nodes=("top", "left"),
    )
    return tmj.Scene(structure, gravity=(0, 0, -9.81), duration=END, **more)


def shaken() -> tmj.Scene:
    times = np.arange(11) * 0.01
    return Ground(times, np.column_stack([3 * np.sin(40 * times), 0 * times, 0 * times])).shake(mass())


def blown() -> tmj.Scene:
    """A rod in the wind, held by strings."""
    nodes = {"a": (0.0, 0.0, 0.0), "b": (0.6, 0.0, 0.8), "f": (1.1, 0.0, 0.8), "g": (0.1, 0.3, 0.8)}
    strings = [tmj.String(name, (name, "b"), 200.0, 0.2, rest_length=0.4) for name in "fg"]
    rod = tmj.Rod("rod", ("a", "b"), 1.0, support=tmj.Support.pinned(0.0))
    wind = tmj.Resistance(viscous=0.5, wind=(3.0, 2.0, 0.0))
    structure = tmj.Structure("mast", nodes, (rod,), strings, fixed_nodes=("f", "g"))
    return tmj.Scene(structure, gravity=(0, 0, -9.81), resistance=wind, duration=END)


SCENES: dict[str, Callable[[], tmj.Scene]] = {
    "supports and loads": lambda: mass(
        motions=(Motion.in_line("left", 0.05, 3.0, (1, 0, 0)),), loads=(Load("p", (3.0, 0.0, 1.0), 40.0),)
    ),
    "breaks": lambda: mass(breaks=(Break("s", 0.02), Break("y", 0.08))),
    "ground": shaken,
    "wind": blown,
}


def halves(scene: tmj.Scene, **options: Any) -> tuple[tmj.Trajectory, tmj.Trajectory]:
    """The rest of a run from 0, and the run that begins there."""
    whole = tmj.simulate(scene, None, output_interval=0.01, **options)
    row = int(np.argmin(np.abs(whole.time - BEGIN)))
    late = scene.with_(
        start_time=BEGIN,
        initial_nodes=whole.nodes[row],
        initial_velocities=whole.velocities[row],
        duration=END - BEGIN,
    )
    return whole, tmj.simulate(late, None, output_interval=0.01, **options)


def differs(whole: tmj.Trajectory, second: tmj.Trajectory) -> float:
    """[m], the largest of places, and of velocities by the highest frequency; times and tensions are looked at, too."""
    row = len(whole.time) - len(second.time)
    np.testing.assert_allclose(second.time, whole.time[row:], rtol=0, atol=2 * EPS)
    assert (second.time[0], second.time[-1]) == pytest.approx((BEGIN, END), abs=2 * EPS)
    apart = np.abs(second.velocities - whole.velocities[row:]).max() / STIFFEST
    apart = max(apart, np.abs(second.nodes - whole.nodes[row:]).max())
    # k s + c s', of k < 1 kN/m and c STIFFEST < 100 N/m
    assert np.abs(second.tensions - whole.tensions[row:]).max() <= 2 * (1000 + 100) * apart + 1e-12
    return float(apart)


@pytest.mark.parametrize("engine", ["dae", "ode"])
@pytest.mark.parametrize("case", list(SCENES)[:3])
def test_point_masses_go_on_to_the_bit(case: str, engine: str) -> None:
    whole, second = halves(SCENES[case](), engine=engine, **RK4)
    assert differs(whole, second) == 0.0
    row = len(whole.time) - len(second.time)
    for name in ("winch_work", "external_work", "dissipation"):  # but for the ulps of what was taken off
        one, other = getattr(whole, name)[row:], getattr(second, name)
        assert other[0] == 0.0
        np.testing.assert_allclose(other, one - one[0], rtol=0, atol=8 * EPS * (np.abs(one).max() + 10))


@pytest.mark.parametrize(("case", "engine"), [("wind", "dae"), ("wind", "ode"), *((one, "mujoco") for one in SCENES)])
def test_other_coordinates_round_and_nothing_else(case: str, engine: str) -> None:
    """Coordinates of the new start round by 16 eps of 2 m, and so does each step after it; what is off grows at most
    by exp(STIFFEST h) a step, 20 in all: 51 x 16 eps x 2 m x 20 = 7e-12 m."""
    options = {"timestep": H} if engine == "mujoco" else RK4
    steps = (END - BEGIN) / H
    assert differs(*halves(SCENES[case](), engine=engine, **options)) < (
        (steps + 1) * 16 * EPS * 2.0 * np.exp(STIFFEST * (END - BEGIN))
    )


@pytest.mark.parametrize("method", ["dop853", "radau"])
def test_methods_that_choose_their_steps_begin_later(method: str) -> None:
    """Each run is off by its tolerance of 1 m and 100 m/s a step at most, of 300 steps, growing by 400 at most."""
    whole, second = halves(SCENES["supports and loads"](), engine="dae", method=method, rtol=1e-9, atol=1e-12)
    assert second.cost["steps"] < whole.cost["steps"] <= 300
    growth = np.exp(STIFFEST * END)
    assert differs(whole, second) < 2 * 300 * (1e-9 * (1 + 100 / STIFFEST) + 1e-12) * growth


def test_supports_and_nodes_start_where_they_are_then(tmp_path: Path) -> None:
    scene = mass(motions=(Motion.in_line("left", 0.05, 3.0, (1, 0, 0)),), start_time=0.1)
    place, rate, _ = scene.motions[0].at(0.1)
    row = scene.structure.node_index["left"]
    np.testing.assert_array_equal(scene.nodes0[row], scene.structure.positions[row] + place)
    np.testing.assert_array_equal(scene.velocities0[row], rate)
    again = tmj.load_scene(tmj.save_scene(scene, tmp_path / "late.toml"))
    assert again.start_time == 0.1
    run = tmj.simulate(again, None, "dae", **RK4)
    assert (run.time[0], len(run.time)) == (pytest.approx(0.1, abs=EPS), 11)
    assert tmj.Trajectory.load(run.save(tmp_path / "run.nc")).scene.start_time == 0.1
    with pytest.raises(SceneError, match=r"fixed node 'left' is .* from its place"):
        scene.with_(start_time=0.2, initial_nodes=scene.nodes0)


def test_samples_of_laws_are_at_multiples_of_their_period() -> None:
    scene = tmj.load_scene("prism").with_(start_time=0.05)
    hold = tmj.Actuation.hold_rest_length(0.01)
    run = tmj.simulate(scene, "lyapunov", timestep=1e-3, duration=0.05, actuation=hold)
    assert run.time[0] == 0.05
    assert run.feasibility_margin[0] > 0
    with pytest.raises(OptionError, match=r"start over the control period: 0\.05 s is no multiple of 0\.02 s"):
        tmj.simulate(scene, "lyapunov", timestep=1e-3, actuation=tmj.Actuation.hold_rest_length(0.02))


def test_what_cannot_begin_later_says_so() -> None:
    scene = mass(start_time=0.05)
    with pytest.raises(OptionError, match=r"start over the time step: 0\.05 s is no multiple of 0\.004 s"):
        tmj.simulate(scene, None, timestep=4e-3, duration=0.1)
    with pytest.raises(OptionError, match=r"simulate_many: scenes\[0\]: it starts at 0\.05 s \(start_time\)"):
        tmj.simulate_many([scene], None, timestep=H)


@pytest.mark.parametrize(
    "engine", [tmj.MuJoCo(H), tmj.DAE(method="rk4", timestep=H), tmj.DAE(), tmj.MuJoCo(accuracy=1e-6)], ids=str
)
@pytest.mark.parametrize("interval", [None, 0.02])
def test_samples_are_counted_from_the_start(engine: Any, interval: float | None) -> None:
    """A start after 13 steps, a prime number, has as many samples as one at 0 s, and the same motion between them."""
    run = tmj.simulate(mass(), None, engine, duration=0.1, output_interval=interval)
    late = tmj.simulate(mass(start_time=0.013), None, engine, duration=0.1, output_interval=interval)
    assert len(late.time) == len(run.time) == 1 + round(0.1 / (interval or 0.01))
    # Sums of steps: round-off of 0.1 s.
    np.testing.assert_allclose(late.time - 0.013, run.time, rtol=0, atol=1e-15)


def test_an_accuracy_tries_all_methods_of_a_later_start() -> None:
    """The coarsest steps, 23 in a run and 115 before it, and their halves have the same samples from the start on."""
    request = Request(mass(start_time=0.5), native_law(None, mass().structure), duration=0.1)
    steps = Steps.of(request, 0.0045)
    assert steps.count == 23
    for step in (steps.unit, steps.unit / 2, steps.unit / 4):
        interval = steps.recorded_each(step)
        grid = Grid.of(replace(request, output_interval=interval), step)
        assert grid.times[1] - grid.times[0] == pytest.approx(interval, rel=1e-9)  # ulps of 0.5 s, of 4 ms
        assert grid.times[0] == pytest.approx(0.5, abs=EPS)


def test_a_start_that_leaves_no_time_between_samples_is_refused() -> None:
    """Doubles at 1e17 s are 16 s apart."""
    with pytest.raises(OptionError, match=r"start_time = 1e\+17 s"):
        tmj.simulate(mass(start_time=1e17), None, "dae")
