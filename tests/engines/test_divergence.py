"""What goes wrong in a run is reported: too large steps, laws and loads that fail, runs that disturb each other."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

import tensegrity_mj as tmj
from evidence.random_linked import random_velocities
from evidence.random_structures import random_scene, random_structure
from tensegrity_mj import Actuation, Command, Integrator, Method, OnInfeasible, Status, Trajectory
from tensegrity_mj.engines.mujoco.settings import MuJoCo
from tensegrity_mj.errors import ControllerError, DivergenceError, OptionError
from tensegrity_mj.model import Load
from tensegrity_mj.model.members import PointMass, String
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.runs.energy import check_energy
from tensegrity_mj.runs.recorded import LAW_REPORTS, VARIABLES

Array = NDArray[np.float64]
EXPLICIT = [Integrator.EULER, Integrator.IMPLICITFAST, Integrator.IMPLICIT, Integrator.RK4]  # in springs, all of them


def engines(step: float) -> dict[str, object]:
    """Every engine with a fixed step."""
    found: dict[str, object] = {integrator.name: tmj.MuJoCo(step, integrator) for integrator in Integrator}
    return {**found, "DAE": tmj.DAE(method=Method.RK4, timestep=step)}


ENGINES = list(engines(1.0))


@pytest.fixture(autouse=True)
def _nothing_is_left_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> object:
    """After each test the process is as before, and MuJoCo has written no log."""
    monkeypatch.chdir(tmp_path)
    handler = mujoco.get_mju_user_warning()  # dm_control sets one when it is imported
    yield
    assert mujoco.get_mjcb_control() is None
    assert mujoco.get_mju_user_warning() is handler
    assert list(tmp_path.glob("MUJOCO_LOG*")) == []


def oscillator(frequency: float = 10.0, speed: float = 0.9, damping: float = 0.0, **changes: object) -> Scene:
    """A mass between two strings along x that stay taut: x'' = -ω² x - 2 c x' with ω = frequency [rad/s]."""
    k = 0.5 * frequency**2
    structure = Structure(
        "oscillator",
        {"left": (-1.0, 0.0, 0.0), "right": (1.0, 0.0, 0.0), "m": (0.0, 0.0, 0.0)},
        # Rest lengths near zero: no amplitude makes them slack, and they hold little energy across.
        strings=tuple(String(name, (name, "m"), k, damping, rest_length=1e-3) for name in ("left", "right")),
        fixed_nodes=("left", "right"),
        point_masses=(PointMass("m", 1.0),),
    )
    return Scene(structure, initial_velocities=np.array([[0, 0, 0], [0, 0, 0], [speed, 0, 0]], float), **changes)  # type: ignore[arg-type]


def prism_in_motion(stiffness: float = 1000.0, damping: float = 0.0) -> Scene:
    """The prism with tight strings, pushed; its fastest vibration is near 80 rad/s for 1000 N/m."""
    structure = tmj.load_scene("prism").structure
    lengths = structure.string_lengths(structure.positions)
    structure = structure.with_strings(stiffness=stiffness, damping=damping, rest_length=0.98 * lengths)
    velocities = random_velocities(np.random.default_rng(1), structure, structure.positions, 0.1)
    return Scene(structure, initial_velocities=velocities)


def diverging(
    scene: Scene, engine: object, duration: float, law: object = None, **options: object
) -> tuple[DivergenceError, Trajectory]:
    """The error of a run that must diverge, after checking that it says all and holds what came before."""
    with pytest.raises(DivergenceError) as caught:
        tmj.simulate(scene, law, engine, duration=duration, **options)  # type: ignore[arg-type]
    error, run = caught.value, caught.value.trajectory
    assert isinstance(run, Trajectory)
    assert 0 <= error.time <= duration
    step = engine.timestep  # type: ignore[attr-defined]
    assert f"t = {error.time:.6g} s: " in str(error)
    assert f"reduce the time step (h = {step:g} s)" in str(error)
    assert run.status is Status.DIVERGED or run.status is Status.COMPLETED
    assert run.time[0] == 0
    assert np.all(np.diff(run.time) > 0)
    assert run.time[-1] <= error.time
    for name in VARIABLES:
        if name not in LAW_REPORTS:
            assert np.all(np.isfinite(getattr(run, name))), name
    np.testing.assert_allclose(run.nodes[0], scene.nodes0, atol=1e-14)
    return error, run


# Steps that are too large --------------------------------------------------------------------------------


@pytest.mark.parametrize("name", [*(i.name for i in EXPLICIT), "DAE"])
@pytest.mark.parametrize("excess", [1.05, 3.0, 30.0])
def test_a_step_beyond_the_limit_of_stability_is_reported(name: str, excess: float) -> None:
    # x'' = -ω² x is stable for h ω < 2 with the semi-implicit Euler method (all of MuJoCo's one-stage integrators are
    # that for springs) and for h ω < 2 √2 with the classical Runge-Kutta method.
    limit = 2 * math.sqrt(2) if name in ("RK4", "DAE") else 2.0
    step = excess * limit / 10.0
    error, run = diverging(oscillator(10.0), engines(step)[name], 2000 * step)
    # It grows beyond all bounds, and the time of the error is not where it ended but where it began to be wrong.
    assert error.time < 500 * step
    assert len(run.time) > 0


@pytest.mark.parametrize("name", ENGINES)
def test_a_step_within_the_limit_passes(name: str) -> None:
    limit = 2 * math.sqrt(2) if name in ("RK4", "DAE") else 2.0
    step = 0.9 * limit / 10.0
    run = tmj.simulate(oscillator(10.0), None, engines(step)[name], duration=1000 * step)  # type: ignore[arg-type]
    assert run.status is Status.COMPLETED


def test_the_discrete_integrator_is_stable_far_beyond() -> None:
    # What the error message advises.
    step = 30.0
    run = tmj.simulate(oscillator(10.0), None, tmj.MuJoCo(step, Integrator.DISCRETE), duration=100 * step)
    assert np.abs(run.nodes[-1, 2]).max() < 1e-3


@pytest.mark.parametrize(
    ("integrator", "step", "damping"),
    [
        (Integrator.RK4, 0.04, 0.0),
        (Integrator.EULER, 0.02, 5.0),
        (Integrator.EULER, 0.008, 50.0),
        (Integrator.RK4, 0.04, 5.0),
        (Integrator.RK4, 0.01, 50.0),
        (Integrator.IMPLICITFAST, 0.04, 50.0),
    ],
    ids=str,
)
def test_just_past_the_limit_energy_comes_from_nowhere(integrator: Integrator, step: float, damping: float) -> None:
    # Strings that go slack and dampers keep these from growing further: MuJoCo is content, the numbers are finite, and
    # the motion is noise. A tenth of the step is stable.
    scene, duration = prism_in_motion(1000.0, damping), 4.0
    model = tmj.MuJoCo(step, integrator).model(scene)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_step(model, data, round(duration / step))
    assert not any(warning.number for warning in data.warning)
    assert np.all(np.isfinite(data.qvel))
    error, _ = diverging(scene, tmj.MuJoCo(step, integrator), duration, output_interval=5 * step)
    assert "energy came from nowhere" in str(error)
    tmj.simulate(scene, None, tmj.MuJoCo(step / 10, integrator), duration=duration)


@pytest.mark.parametrize("name", [*(i.name for i in EXPLICIT), "DAE"])
def test_a_controlled_run_with_too_large_a_step(name: str) -> None:
    scene = tmj.load_scene("prism")
    law = tmj.controllers.Lyapunov(scene.structure, scene.target, decay_rate=30.0, norm=2)
    diverging(scene, engines(1.0)[name], 20.0, law, on_infeasible=OnInfeasible.PASSIVE)


def test_rods_that_tear_are_reported() -> None:
    # The reference model's rods are held by a multiplier, and let go of when the step is too large.
    run = tmj.simulate(tmj.load_scene("prism"), None, tmj.DAE(), duration=0.1)
    nodes = run.nodes.copy()
    nodes[5:, 3] += 1.4 * (nodes[5:, 3] - nodes[5:, 2])
    with pytest.raises(
        tmj.errors.DivergenceError, match=r"t = 0\.05 s: rod 'rod2' has 2\.4 times its length"
    ) as caught:
        check_energy(replace(run, nodes=nodes), "reduce the time step")
    assert len(caught.value.trajectory.time) == 5


@pytest.mark.parametrize("integrator", Integrator)
def test_a_rest_length_that_mujoco_would_ignore_is_reported(integrator: Integrator) -> None:
    # Beyond 1e10 MuJoCo sets all controls to zero, warns, and goes on.
    class Runaway:
        command = Command.REST_LENGTH

        def __call__(self, time: float, nodes: Array, velocities: Array) -> Array:
            return np.array([1e11 if time > 0.5 else 1.0, 1.0])

    scene = oscillator(1.0, speed=0.0)
    error, run = diverging(scene, tmj.MuJoCo(1e-2, integrator), 1.0, Runaway())
    assert "rest lengths are beyond 1e+10 m, where MuJoCo ignores them" in str(error)
    # The stages of the step from 0.5 s see later times.
    assert error.time in (0.5, 0.51)
    assert run.time[-1] >= 0.49


@pytest.mark.parametrize("name", [*(i.name for i in EXPLICIT), "DAE"])
def test_a_law_is_not_blamed_for_what_a_step_did(name: str) -> None:
    def careful(time: float, nodes: Array, velocities: Array) -> Array:
        if not np.all(np.abs(nodes) < 1e10):
            raise ValueError("no such nodes")
        return np.full(2, 50.0)  # ω² = 100, whatever the stiffness

    error, _ = diverging(oscillator(10.0), engines(1.0)[name], 1000.0, careful)
    assert error.time < 20  # it grows nearly a hundredfold a step
    if name == "DAE":  # in MuJoCo the law is not even called there
        assert isinstance(error.__context__, ControllerError)
        assert "no such nodes" in str(error.__context__)
    else:
        assert error.__context__ is None


# No false alarm ------------------------------------------------------------------------------------------


def fastest(scene: Scene) -> float:
    """The largest frequency [rad/s] of the strings' vibrations at the start, or of their dampers' decay, if larger."""
    model = MuJoCo().model(scene)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    mass, jacobian = np.zeros((model.nv, model.nv)), np.zeros((model.ntendon, model.nv))
    mujoco.mj_fullM(model, data, mass)
    mujoco.mju_sparse2dense(
        jacobian, data.ten_J.ravel(), model.ten_J_rownnz, model.ten_J_rowadr, model.ten_J_colind.ravel()
    )
    structure = scene.structure
    stiff, damp = (jacobian.T @ np.diag(x) @ jacobian for x in (structure.stiffness, structure.damping))
    omega = math.sqrt(np.abs(np.linalg.eigvals(np.linalg.solve(mass, stiff))).max())
    return max(omega, float(np.abs(np.linalg.eigvals(np.linalg.solve(mass, damp))).max()))


@pytest.mark.parametrize("seed", range(20))
def test_a_coarse_run_is_no_divergence(seed: int) -> None:
    # A tenth of the vibration's own time: coarse, for a method of order one, but valid.
    rng = np.random.default_rng([8, seed])
    structure = random_structure(
        rng,
        rods=int(rng.integers(1, 4)),
        planar=bool(rng.integers(2)),
        stretch=(-0.1, 0.2),
        stiffness=(10.0, 10 ** rng.uniform(1.5, 4)),
        damping=(0.0, float(rng.choice([0.0, 2.0, 20.0]))),
        point_masses=int(rng.integers(2)),
        law=list(tmj.model.StringLaw)[seed % 2],
    )
    scene = random_scene(
        rng,
        structure,
        displaced=float(rng.choice([0.0, 0.1])),
        moving=float(rng.choice([0.0, 1.0])),
        gravity=bool(rng.integers(2)),
        loads=int(rng.integers(3)),
    )
    step = min(0.1 / fastest(scene), 0.01)
    for name, engine in engines(step).items():
        run = tmj.simulate(scene, None, engine, duration=200 * step, output_interval=step)  # type: ignore[arg-type]
        assert run.status is Status.COMPLETED, name


@pytest.mark.parametrize("name", ENGINES)
@pytest.mark.parametrize("mode", ["continuous", "hold force density", "hold rest length"])
@pytest.mark.parametrize("stiffness", [2.0, 100.0])
def test_a_coarse_controlled_run_is_no_divergence(name: str, mode: str, stiffness: float) -> None:
    scene = tmj.load_scene("prism")
    scene = scene.with_(structure=scene.structure.with_strings(stiffness=stiffness))
    step = 0.05
    actuation = {
        "continuous": Actuation.continuous(),
        "hold force density": Actuation.hold_force_density(step),
        "hold rest length": Actuation.hold_rest_length(step),
    }[mode]
    law = tmj.controllers.from_scene(scene)
    run = tmj.simulate(scene, law, engines(step)[name], duration=10.0, actuation=actuation)  # type: ignore[arg-type]
    assert run.status is Status.COMPLETED


@pytest.mark.parametrize("name", ENGINES)
def test_stiff_strings_under_a_continuous_law_are_no_divergence(name: str) -> None:
    # They hold next to no energy at the start, and what winches give in the first step an order-one ledger misses.
    scene = tmj.load_scene("prism")
    scene = scene.with_(structure=scene.structure.with_strings(stiffness=1e6))
    law = tmj.controllers.from_scene(scene)
    run = tmj.simulate(scene, law, engines(0.01)[name], duration=2.0)  # type: ignore[arg-type]
    assert run.status is Status.COMPLETED


@pytest.mark.parametrize("name", ENGINES)
@pytest.mark.parametrize("count", [1, 2, 5])
def test_a_run_of_few_steps_from_rest_is_no_divergence(name: str, count: int) -> None:
    # Nothing has been given at the start: what a force gives in the first step is all there is.
    free = Structure("m", {"m": (0.0, 0.0, 0.0)}, point_masses=(PointMass("m", 1.0),))
    for scene in (
        Scene(free, loads=(Load("m", (1.0, 0.0, 0.0)),)),
        Scene(free, gravity=(0.0, 0.0, -9.81)),
        oscillator(10.0, speed=0.0, loads=(Load("m", (1.0, 0.0, 0.0)),)),
    ):
        run = tmj.simulate(scene, None, engines(0.01)[name], duration=0.01 * count)  # type: ignore[arg-type]
        assert run.kinetic_energy[-1] > 0


# Laws that fail ------------------------------------------------------------------------------------------

BAD = {
    "nan": (lambda u: np.where(np.arange(3) == 1, np.nan, u), r"returned nan for string 's2' near t = {t} s"),
    "inf": (lambda u: np.where(np.arange(3) == 2, np.inf, u), r"returned inf for string 's3' near t = {t} s"),
    "wrong shape": (lambda u: u[:2], r"near t = {t} s: ValueError: it returned shape \(2,\); it must return \(3,\)"),
    "a scalar": (lambda u: 1.0, r"near t = {t} s: ValueError: it returned shape \(\); it must return \(3,\)"),
    "none": (lambda u: None, r"near t = {t} s: \w+Error: "),
    "a text": (lambda u: "tight", r"near t = {t} s: ValueError: could not convert"),
    "an exception": (lambda u: {}[u[0]], r"near t = {t} s: KeyError: "),
}


class FailsAt:
    """A constant law for the pinned rod that from a time on gives something else."""

    def __init__(self, time: float, change: Callable[[Array], object]) -> None:
        self.time, self.change = time, change

    def __call__(self, time: float, nodes: Array, velocities: Array) -> object:
        u = np.array([0.02, 0.03, 0.04])
        return u if time < self.time else self.change(u)


ALL_ENGINES = [*ENGINES, "DOP853", "RADAU"]


def engine_named(name: str, step: float) -> object:
    return tmj.DAE(method=Method[name]) if name in ("DOP853", "RADAU") else engines(step)[name]


@pytest.mark.parametrize("name", ALL_ENGINES)
@pytest.mark.parametrize("bad", BAD)
@pytest.mark.parametrize("start", [0.0, 0.5])
def test_a_law_that_returns_nonsense(bad: str, start: float, name: str) -> None:
    change, message = BAD[bad]
    scene = tmj.load_scene("pinned_rod")
    # An engine may call it at a later stage than the first one at or after that time, so the time is near it.
    expected = message.replace("{t}", r"0(\.\d+)?" if start == 0 else r"0\.(49|5)\d*")
    with pytest.raises(ControllerError, match=expected):
        tmj.simulate(scene, FailsAt(start, change), engine_named(name, 0.01), duration=1.0)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ALL_ENGINES)
@pytest.mark.parametrize("actuation", [Actuation.hold_force_density(0.02), Actuation.hold_rest_length(0.02)], ids=str)
def test_a_sampled_law_that_returns_nonsense(actuation: Actuation, name: str) -> None:
    scene = tmj.load_scene("pinned_rod")
    law = FailsAt(0.49, BAD["nan"][0])
    with pytest.raises(ControllerError, match=r"returned nan for string 's2' near t = 0\.5 s"):
        tmj.simulate(scene, law, engine_named(name, 0.01), duration=1.0, actuation=actuation)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ALL_ENGINES)
def test_a_law_that_fails_at_the_very_end(name: str) -> None:
    scene = tmj.load_scene("pinned_rod")
    with pytest.raises(ControllerError, match=r"near t = (0\.99|1) s"):  # RK4 calls it there in its last step
        tmj.simulate(scene, FailsAt(1.0, BAD["nan"][0]), engine_named(name, 0.01), duration=1.0)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ALL_ENGINES)
@pytest.mark.parametrize("error", [KeyboardInterrupt, SystemExit, GeneratorExit])
def test_an_interrupt_within_a_law_goes_through(error: type[BaseException], name: str) -> None:
    def interrupted(u: Array) -> object:
        raise error

    scene = tmj.load_scene("pinned_rod")
    with pytest.raises(error):
        tmj.simulate(scene, FailsAt(0.5, interrupted), engine_named(name, 0.01), duration=1.0)  # type: ignore[arg-type]


def test_the_cause_of_a_failure_is_kept() -> None:
    with pytest.raises(ControllerError) as caught:
        tmj.simulate(tmj.load_scene("pinned_rod"), FailsAt(0.5, BAD["an exception"][0]), duration=1.0)  # type: ignore[arg-type]
    assert isinstance(caught.value.__cause__, KeyError)


def test_a_run_after_failed_ones_is_as_ever() -> None:
    scene = tmj.load_scene("prism")

    def good() -> Trajectory:
        return tmj.simulate(scene, tmj.controllers.from_scene(scene), tmj.MuJoCo(1e-2), duration=1.0)

    before = good()
    for change, _ in BAD.values():
        with pytest.raises(ControllerError):
            tmj.simulate(tmj.load_scene("pinned_rod"), FailsAt(0.5, change), duration=1.0)  # type: ignore[arg-type]
    diverging(oscillator(10.0), tmj.MuJoCo(1.0), 100.0)
    after = good()
    for name in VARIABLES:
        np.testing.assert_array_equal(getattr(before, name), getattr(after, name))


# Loads that fail -----------------------------------------------------------------------------------------

BAD_LOADS = {
    "nan": (lambda f: f * np.nan, "finite"),
    "wrong shape": (lambda f: f[:2], r"returned shape \(2, 3\); it must return finite \(5, 3\)"),
    "an exception": (lambda f: {}[0], "KeyError"),
}


@pytest.mark.parametrize("name", ALL_ENGINES)
@pytest.mark.parametrize("bad", BAD_LOADS)
@pytest.mark.parametrize("start", [0.5, 1.0])
def test_loads_that_fail(bad: str, start: float, name: str) -> None:
    change, message = BAD_LOADS[bad]

    def loads(time: float) -> object:
        forces = np.zeros((5, 3))
        forces[1, 0] = 0.01
        return forces if time < start else change(forces)

    scene = tmj.load_scene("pinned_rod").with_(loads=loads)
    near = r"(0\.(49|[56])\d*|1)" if start == 0.5 else r"(0\.9\d*|1)"  # DOP853 makes long steps
    with pytest.raises(OptionError, match=rf"loads: the function failed near t = {near} s: .*{message}"):
        tmj.simulate(scene, None, engine_named(name, 0.01), duration=1.0)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ALL_ENGINES)
def test_an_interrupt_within_a_load_goes_through(name: str) -> None:
    def loads(time: float) -> Array:
        if time > 0.5:
            raise KeyboardInterrupt
        return np.zeros((5, 3))

    with pytest.raises(KeyboardInterrupt):
        tmj.simulate(tmj.load_scene("pinned_rod").with_(loads=loads), None, engine_named(name, 0.01), duration=1.0)  # type: ignore[arg-type]


# Runs that disturb each other ----------------------------------------------------------------------------


def test_a_callback_of_the_users_own_is_reported() -> None:
    # It would be called for models that it does not know, and it would be put out of action by ours.
    scene = tmj.load_scene("pinned_rod")
    mujoco.set_mjcb_control(lambda model, data: None)
    try:
        with pytest.raises(OptionError, match=r"callback of your own .* mujoco.set_mjcb_control\(None\)"):
            tmj.simulate(scene, None, tmj.MuJoCo(1e-2), duration=0.1)
        assert mujoco.get_mjcb_control() is not None
    finally:
        mujoco.set_mjcb_control(None)


def test_a_simulation_within_a_law() -> None:
    scene = tmj.load_scene("pinned_rod")

    def law_with(engine: object) -> Callable[[float, Array, Array], Array]:
        def law(time: float, nodes: Array, velocities: Array) -> Array:
            tmj.simulate(scene, None, engine, duration=0.1)  # type: ignore[arg-type]
            return np.array([0.02, 0.03, 0.04])

        return law

    with pytest.raises(ControllerError, match="OptionError: another MuJoCo run of this process is under way"):
        tmj.simulate(scene, law_with(tmj.MuJoCo(0.05)), tmj.MuJoCo(0.05), duration=0.1)
    # The reference model disturbs nobody.
    inner, plain = (
        tmj.simulate(scene, law, tmj.MuJoCo(0.05), duration=0.1)  # type: ignore[arg-type]
        for law in (law_with(engines(0.05)["DAE"]), FailsAt(math.inf, BAD["nan"][0]))
    )
    np.testing.assert_array_equal(inner.nodes, plain.nodes)


def test_another_thread_waits_for_its_turn() -> None:
    scene = tmj.load_scene("pinned_rod")
    started, go_on = threading.Event(), threading.Event()
    results: dict[str, Trajectory] = {}

    def waiting(time: float, nodes: Array, velocities: Array) -> Array:
        started.set()
        assert go_on.wait(60)
        return np.array([0.02, 0.03, 0.04])

    def run(name: str, law: object) -> None:
        results[name] = tmj.simulate(scene, law, tmj.MuJoCo(0.01), duration=0.5)  # type: ignore[arg-type]

    threads = [threading.Thread(target=run, args=("first", waiting))]
    threads[0].start()
    try:
        assert started.wait(60)
        # Now a run stands still within its law. Another one waits ...
        threads.append(threading.Thread(target=run, args=("second", None)))
        threads[1].start()
        # ... the reference model does not, nor a MuJoCo of one's own, which must not notice the callback.
        tmj.simulate(scene, None, engines(0.01)["DAE"], duration=0.5)  # type: ignore[arg-type]
        model = tmj.MuJoCo(0.01).model(scene)
        data = mujoco.MjData(model)
        mujoco.mj_step(model, data, 10)
        assert not data.ctrl.any()
        assert not results
    finally:
        go_on.set()
        for thread in threads:
            thread.join(60)
    for name, law in (("first", FailsAt(math.inf, BAD["nan"][0])), ("second", None)):
        alone = tmj.simulate(scene, law, tmj.MuJoCo(0.01), duration=0.5)  # type: ignore[arg-type]
        np.testing.assert_array_equal(results[name].nodes, alone.nodes)


def test_nobody_waits_for_a_law_in_mujocos_own_loops() -> None:
    """It ends when its caller wants, who may wait for that very thread."""
    scene, failures = tmj.load_scene("prism"), []

    def work() -> None:
        try:
            tmj.simulate(scene, None, tmj.MuJoCo(1e-2), duration=0.1)
        except OptionError as error:
            failures.append(str(error))

    with tmj.law_in(scene, tmj.controllers.from_scene(scene), tmj.MuJoCo(1e-2)):
        thread = threading.Thread(target=work)
        thread.start()
        thread.join(60)
    assert "another MuJoCo run of this process is under way, in the law" in failures[0]
    work()
    assert len(failures) == 1


def test_eight_threads_have_the_bits_of_one() -> None:
    """Runs of all kinds, three times each: laws compiled and in Python, contact, loops, many at once, a divergence, a
    law that fails, and one that is interrupted as by Ctrl-C.
    """
    prism, rod, drop = (tmj.load_scene(name) for name in ("prism", "pinned_rod", "prism_drop"))
    law, engine = tmj.controllers.from_scene(prism), tmj.MuJoCo(1e-2)
    strings = tuple(replace(one, stiffness=1e4 * one.stiffness) for one in prism.structure.strings)
    stiff = prism.with_(structure=replace(prism.structure, strings=strings))

    def interrupted(time: float, nodes: Array, velocities: Array) -> Array:
        raise KeyboardInterrupt

    def pulls(time: float, nodes: Array, velocities: Array) -> Array:
        return np.array([0.02, 0.03, 0.04 + 1e-3 * np.sin(time)])

    jobs: list[Callable[[], Any]] = [
        lambda: tmj.simulate(prism, law, engine, duration=1.0),
        lambda: tmj.simulate(rod, pulls, engine, duration=1.0),
        lambda: tmj.simulate(drop, None, tmj.MuJoCo(5e-4), duration=0.4),
        lambda: tmj.simulate(tmj.load_scene("dbar"), None, tmj.MuJoCo(1e-3), duration=0.2),
        lambda: tmj.simulate_many([prism, prism], law, engine, duration=0.5)[1],
        lambda: tmj.simulate(stiff, None, tmj.MuJoCo(0.1), duration=2.0),
        lambda: tmj.simulate(rod, FailsAt(0.3, BAD["nan"][0]), engine, duration=1.0),
        lambda: tmj.simulate(rod, interrupted, engine, duration=1.0),
    ]

    def outcome(job: Callable[[], Any]) -> tuple[Any, ...]:
        try:
            run = job()
        except (tmj.errors.TensegrityError, KeyboardInterrupt) as error:
            partial = getattr(error, "partial", None)
            return type(error), str(error), None if partial is None else partial.nodes.tobytes()
        return tuple(getattr(run, name).tobytes() for name in (*VARIABLES, "multipliers", "external_work"))

    alone = [outcome(job) for job in jobs]
    assert [one[0] for one in alone[5:]] == [DivergenceError, ControllerError, KeyboardInterrupt]
    barrier, outcomes = threading.Barrier(8), [[] for _ in jobs]

    def work(first: int) -> None:
        barrier.wait()
        for number in range(first, first + 3):  # no two threads do the same at the same time
            outcomes[number % 8].append(outcome(jobs[number % 8]))

    threads = [threading.Thread(target=work, args=(first,)) for first in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(300)
    assert mujoco.get_mjcb_control() is None
    for number, found in enumerate(outcomes):
        assert found == 3 * [alone[number]], number
