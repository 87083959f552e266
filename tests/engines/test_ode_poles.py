"""The poles φ = 0, π of the minimal coordinates: a run is right, or it stops there and says so; it is never garbage."""

from __future__ import annotations

import functools
import json
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import tensegrity_mj as tmj
from tensegrity_mj.cli import main
from tensegrity_mj.model import rods
from tensegrity_mj.model.members import Rod, Support
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure

Array = NDArray[np.float64]
SPEED = 6.0  # rad/s
REFERENCE = tmj.DAE(rtol=1e-13, atol=1e-14)

# Engine, and what its nodes may be off by [m] where it goes on. Error-controlled: rtol a step, some hundred steps.
# RK4: θ = arctan(ω t / ε) past a pole has a fifth derivative of 24 (ω / ε)⁵. With h ω / ε = MAX_TURN = 0.1 that is an
# error of 24 / 120 0.1⁵ = 2e-6 rad a step, and the ten or so steps near the pole make 2e-5 rad.
ENGINES = {
    "dop853": (tmj.ODE(rtol=1e-12, atol=1e-13), 1e-9),
    "default": (tmj.ODE(), 1e-7),
    "radau": (tmj.ODE(tmj.Method.RADAU, rtol=1e-8, atol=1e-10), 1e-5),
    "rk4 10 ms": (tmj.ODE(tmj.Method.RK4, timestep=1e-2), 5e-5),
    "rk4 1 ms": (tmj.ODE(tmj.Method.RK4, timestep=1e-3), 5e-5),
    "rk4 0.1 ms": (tmj.ODE(tmj.Method.RK4, timestep=1e-4), 5e-5),
}
DISTANCES = [0.0, 1e-9, 1e-6, 9e-4, 2e-3, 1e-2, 0.1]  # rad


def passing(distance: float, gravity: float, below: bool = False, free: bool = False) -> Scene:
    """A rod of 1 m on a great circle that passes a pole at this distance [rad], 0.8 rad before it."""
    across = np.array([0.0, 1.0, 0.0])
    nearest = np.array([np.sin(distance), 0.0, np.cos(distance) * (-1 if below else 1)])
    angle = np.pi / 2 - 0.8
    b = across * np.cos(angle) + nearest * np.sin(angle)
    rate = SPEED * (nearest * np.cos(angle) - across * np.sin(angle))
    if free:
        support, start, speeds = Support.free(), -0.5 * b, np.array([-0.5 * rate, 0.5 * rate])
    else:
        support, start, speeds = Support.pinned(0.0), np.zeros(3), np.array([np.zeros(3), rate])
    structure = Structure(
        "swinging rod",
        {"a": tuple(start), "b": tuple(start + b)},
        rods=(Rod("mast", ("a", "b"), 1.0, support=support),),
    )
    return Scene(structure, initial_velocities=speeds, gravity=(0.0, 0.0, -gravity), duration=0.5)


@functools.cache
def reference_of(distance: float, below: bool) -> tmj.Trajectory:
    """The rod that passes above without gravity, or below with it."""
    return tmj.simulate(passing(distance, gravity=9.81 if below else 0.0, below=below), None, REFERENCE)


def angles(run: tmj.Trajectory) -> tuple[Array, Array]:
    """sin φ (T,) and the angle of b to the pole that it passes."""
    first, second = rods.ends(run.scene.structure, run.nodes)
    b = (second - first)[:, 0]
    return np.hypot(b[:, 0], b[:, 1]), b


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("below", [False, True], ids=["above", "below"])
@pytest.mark.parametrize("distance", DISTANCES)
def test_a_rod_that_passes_a_pole_is_right_or_stopped(engine: str, below: bool, distance: float) -> None:
    options, bound = ENGINES[engine]
    reference = reference_of(distance, below)
    run = tmj.simulate(reference.scene, None, options)
    stopped = run.status is tmj.Status.SINGULAR
    assert stopped or run.status is tmj.Status.COMPLETED
    if distance < options.least_sine:
        assert stopped
    elif options.method is not tmj.Method.RK4:
        assert not stopped
    if stopped:
        assert f"t = {run.time[-1]:.6g} s" in run.message
        assert "'mast'" in run.message
        assert "DAE" in run.message
        # The last sample is where it stopped; the others are those of the reference.
        assert run.time[-1] < 0.2
    kept = len(run.time) - stopped
    assert kept > 5
    assert np.abs(run.nodes[:kept] - reference.nodes[:kept]).max() <= bound
    assert np.all(np.isfinite(run.nodes))
    assert np.all(np.isfinite(run.velocities))
    assert np.all(np.isfinite(run.multipliers))
    # Half a kilogram at 6 m/s: 6 J. RK4 within MAX_TURN errs by some 1e-4 of it.
    assert run.energy_residual <= 6 * 1e-3


def test_a_step_across_the_pole_is_called_so() -> None:
    run = tmj.simulate(passing(0.0, 0.0), None, tmj.ODE(tmj.Method.RK4, timestep=1e-2))
    assert "'mast' swings across the z axis within a step" in run.message


def test_rk4_goes_on_where_its_step_resolves_the_pole() -> None:
    """Or "right or stopped" could be had by always stopping."""
    for distance, step in ((1e-2, 1e-4), (0.1, 1e-3)):
        run = tmj.simulate(passing(distance, 0.0), None, tmj.ODE(tmj.Method.RK4, timestep=step))
        assert run.status is tmj.Status.COMPLETED, run.message


def test_the_stop_is_where_sin_phi_is_the_least_allowed() -> None:
    scene = passing(0.0, 0.0)
    for least in (1e-3, 1e-2, 0.2):
        run = tmj.simulate(scene, None, tmj.ODE(least_sine=least, rtol=1e-11, atol=1e-13))
        sine, _ = angles(run)
        # Without forces the rod turns by 6 rad/s: the stop is least_sine before the pole. Located to 1e-10 s.
        assert sine[-1] == pytest.approx(least, abs=1e-8)
        assert run.time[-1] == pytest.approx((0.8 - np.arcsin(least)) / SPEED, abs=1e-8)


def test_a_coarse_step_never_leaves_garbage_behind() -> None:
    """Steps that jump past the pole: whatever their phase, the run stops before, with its energy as it was."""
    stopped = 0
    for step in (0.1, 0.05, 0.04, 0.025, 0.02, 0.0125):
        for distance in (1e-3, 1e-2, 5e-2, 0.1, 0.2):
            scene = passing(distance, 0.0, free=True).with_(duration=20 * step)
            run = tmj.simulate(scene, None, tmj.ODE(tmj.Method.RK4, timestep=step))
            stopped += run.status is tmj.Status.SINGULAR
            # At rest in its own frame: 1.5 J, of which a step of 0.6 rad, the coarsest here, may lose a few per cent.
            assert run.energy_residual <= 0.05 * 1.5, (step, distance, run.message)
    assert stopped >= 20


@pytest.mark.parametrize("method", list(tmj.Method))
@pytest.mark.parametrize("tilt", [0.0, 1e-5])
def test_a_scene_that_starts_at_a_pole_stops_there(method: tmj.Method, tilt: float) -> None:
    b = np.array([np.sin(tilt), 0.0, -np.cos(tilt)])
    rate = np.cross(b, [0.3, 0.5, 0.0])
    structure = Structure(
        "hanging", {"a": (0, 0, 0), "b": tuple(b)}, rods=(Rod("mast", ("a", "b"), 1.0, support=Support.pinned(0.0)),)
    )
    scene = Scene(structure, initial_velocities=np.array([np.zeros(3), rate]), gravity=(0, 0, -9.81), duration=1.0)
    engine = tmj.ODE(method, timestep=1e-3 if method is tmj.Method.RK4 else None)
    run = tmj.simulate(scene, None, engine)
    assert run.status is tmj.Status.SINGULAR
    assert "at t = 0 s rod 'mast'" in run.message
    assert run.time.tolist() == [0.0]
    # Coordinates hold it, if barely: positions and velocities are the scene's, λ that of the DAE.
    assert np.abs(run.nodes[0] - scene.nodes0).max() < 1e-15
    assert np.abs(run.velocities[0] - scene.velocities0).max() < 1e-15
    dae = tmj.simulate(scene, None, tmj.DAE())
    assert run.multipliers[0] == pytest.approx(dae.multipliers[0], rel=1e-13)


def test_the_ledger_of_a_controlled_scene_that_starts_at_a_pole_is_empty() -> None:
    scene = tmj.load_scene("pinned_rod")
    upright = np.array(scene.nodes0)
    upright[1] = (0.0, 0.0, 1.0)
    start = scene.with_(initial_nodes=upright)
    for engine in (tmj.ODE(), tmj.ODE(tmj.Method.RK4, timestep=1e-2)):
        run = tmj.simulate(start, lambda time, nodes, velocities: np.full(3, 0.1), engine)
        assert run.status is tmj.Status.SINGULAR
        assert run.string_energy[0] > 1e-3
        assert run.winch_work.tolist() == [0.0]


def test_rods_in_a_plane_have_no_pole() -> None:
    """A planar rod swings through the z axis as through any other."""
    structure = Structure(
        "pendulum",
        {"a": (0, 0, 0), "b": (0, 0, -1)},
        rods=(Rod("mast", ("a", "b"), 1.0, support=Support.pinned(0.0, plane=(0, 1, 0))),),
    )
    scene = Scene(structure, initial_velocities=np.array([[0, 0, 0], [9.0, 0, 0]]), gravity=(0, 0, -9.81), duration=2.0)
    run = tmj.simulate(scene, None, tmj.ODE(rtol=1e-12, atol=1e-13))
    assert run.status is tmj.Status.COMPLETED
    assert tmj.compare(run, tmj.simulate(scene, None, REFERENCE)).max_node_error < 1e-9


def test_a_controlled_run_stops_with_what_was_held(tmp_path: Path) -> None:
    """A law that lifts the pinned rod to the pole: all is recorded up to the stop, and the file holds it."""
    scene = tmj.load_scene("pinned_rod")
    aim = np.array(scene.target.nodes[0])
    aim[1] = (0.0, 0.0, 1.0)
    law = tmj.controllers.Lyapunov(scene.structure, aim, decay_rate=1.0)
    for actuation in (tmj.Actuation.continuous(), tmj.Actuation.hold_force_density(1e-2)):
        dae = tmj.simulate(scene, law, tmj.DAE(rtol=1e-11), duration=20.0, actuation=actuation)
        for engine in (tmj.ODE(rtol=1e-11), tmj.ODE(tmj.Method.RK4, timestep=1e-2)):
            run = tmj.simulate(scene, law, engine, duration=20.0, actuation=actuation)
            assert run.status is tmj.Status.SINGULAR, run.message
            assert 1.0 < run.time[-1] < 20.0
            assert "rod" in run.message
            kept = len(run.time) - 1
            assert np.abs(run.nodes[:kept] - dae.nodes[:kept]).max() < 1e-5  # RK4 at 10 ms, u with kinks
            loaded = tmj.Trajectory.load(run.save(tmp_path / "run.nc"))
            assert loaded.status is tmj.Status.SINGULAR
            assert loaded.message == run.message


def test_the_command_line_says_so_and_fails(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "swing.toml"
    tmj.save_scene(passing(0.0, 9.81), path)
    assert main(["run", str(path), "--engine", "ode", "--out", str(tmp_path / "run.nc"), "--json"]) == 6
    answer = json.loads(capsys.readouterr().out)
    assert answer["status"] == "singular"
    assert "mast" in answer["message"]
    assert tmj.Trajectory.load(tmp_path / "run.nc").status is tmj.Status.SINGULAR
    assert main(["compare", str(path), "--engine", "ode", "--json"]) == 6
    answer = json.loads(capsys.readouterr().out)
    assert (answer["first_status"], answer["second_status"]) == ("singular", "completed")
    assert answer["max_node_error"] < 1e-6
    assert main(["compare", str(path), "--engine", "ode", "--reference", "ode"]) == 2
    assert main(["run", str(path), "--engine", "ode", "--drift", "normalize"]) == 2
    assert main(["run", str(path), "--engine", "ode", "--integrator", "rk4"]) == 2
