"""`accuracy=`: the true error is within the request, and the run says what it cost and what it does not know."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from linked_scenes import four_bar
from scipy.integrate import solve_ivp

import tensegrity_mj as tmj
from tensegrity_mj.basics.jsontext import to_exact_json
from tensegrity_mj.cli import main
from tensegrity_mj.dynamics.native.law import native_law
from tensegrity_mj.engines.accuracy import rates
from tensegrity_mj.engines.accuracy.ladder import CERTIFIER
from tensegrity_mj.engines.accuracy.rates import Rates, rates_along, rates_at_start, string_rates
from tensegrity_mj.engines.accuracy.search import Steps, common_divisor
from tensegrity_mj.engines.mujoco.engine import LOOP_ORDER, ORDER, run_accurately
from tensegrity_mj.engines.reference.engine import RK4_ORDER
from tensegrity_mj.engines.request import Request
from tensegrity_mj.runs.convergence import node_difference

ENGINES = (tmj.MuJoCo, tmj.DAE, tmj.ODE)
GRAVITY = 9.81
START = 1.0  # rad from the downward vertical


def pendulum(duration: float = 2.0) -> tmj.Scene:
    """A rod of 1 kg and 1 m that swings about a pin in the plane y = 0."""
    structure = tmj.Structure(
        "pendulum",
        {"pin": (0.0, 0.0, 0.0), "end": (math.sin(START), 0.0, -math.cos(START))},
        rods=(tmj.Rod("rod", ("pin", "end"), 1.0, 0.01, tmj.Support.pinned(0.0, (0.0, 1.0, 0.0))),),
    )
    return tmj.Scene(structure, gravity=(0.0, 0.0, -GRAVITY), duration=duration)


def pendulum_angles(times: np.ndarray) -> np.ndarray:
    """θ'' = -3 g / (2 l) sin θ, by an integrator that is none of the package's."""
    found = solve_ivp(
        lambda _, y: [y[1], -1.5 * GRAVITY * math.sin(y[0])],
        (0.0, float(times[-1])),
        [START, 0.0],
        method="LSODA",
        rtol=1e-13,
        atol=1e-14,
        t_eval=times,
    )
    return np.asarray(found.y[0])


def string_pendulum() -> tmj.Scene:
    """A rod held by taut strings, which swings without their going slack."""
    # The rod points along x: along z it would be at the ODE's pole.
    anchors = {"a": (1.0, 0.0, 1.5), "b": (1.0, 0.5, -1.5), "c": (1.2, -1.5, 0.0)}
    structure = tmj.Structure(
        "held",
        {"pin": (0.0, 0.0, 0.0), "tip": (0.99, 0.05, 0.1), **anchors},
        rods=(tmj.Rod("rod", ("pin", "tip"), 1.0, 0.01, tmj.Support.pinned(0.0)),),
        strings=tuple(tmj.String(f"s{key}", ("tip", key), 20.0, rest_length=0.8) for key in anchors),
        fixed_nodes=tuple(anchors),
    )
    return tmj.Scene(structure, duration=2.0)


def truth(scene: tmj.Scene, run: tmj.Trajectory, law: Any = None) -> tmj.Trajectory:
    """The DAE at a tolerance that leaves 1e-12 m here (tested where it matters)."""
    return tmj.simulate(scene, law, tmj.DAE(rtol=1e-12, atol=1e-14), output_interval=float(run.time[1]))


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("accuracy", [1e-2, 1e-4, 1e-6, 1e-8, 1e-10])
def test_the_pendulum_is_as_accurate_as_was_requested(engine: Any, accuracy: float) -> None:
    run = tmj.simulate(pendulum(), None, engine(accuracy=accuracy))
    angles = pendulum_angles(run.time)
    ends = np.stack([np.sin(angles), 0 * angles, -np.cos(angles)], axis=1)
    # LSODA at 1e-13 over 3 s of a swing leaves some 1e-12 m, a hundredth of the least that is requested.
    error = np.max(np.linalg.norm(run.nodes[:, 1] - ends, axis=1))
    assert error <= accuracy
    report = run.reports["accuracy"]
    assert report["settled"]
    assert report["met"]
    assert run.error_estimate == report["error_estimate"] <= accuracy
    # What is reported is an upper estimate: SAFETY leaves room for what orders leave out.
    assert error <= run.error_estimate + 1e-11


@pytest.mark.parametrize(
    ("make", "order"),
    [
        *((lambda step, word=word: tmj.MuJoCo(step, word), order) for word, order in ORDER.items()),
        (lambda step: tmj.DAE(method=tmj.Method.RK4, timestep=step), RK4_ORDER),
        (lambda step: tmj.ODE(method=tmj.Method.RK4, timestep=step), RK4_ORDER),
    ],
)
def test_methods_have_the_order_that_estimates_count_with(make: Any, order: int) -> None:
    """Errors of h and h / 2 against LSODA; the next term of the error, a part of order ω h = 0.04, leaves 0.1 of p."""
    errors = []
    for step in (0.01, 0.005):
        run = tmj.simulate(pendulum(), None, make(step), output_interval=0.1)
        angles = pendulum_angles(run.time)
        ends = np.stack([np.sin(angles), 0 * angles, -np.cos(angles)], axis=1)
        errors.append(np.max(np.linalg.norm(run.nodes[:, 1] - ends, axis=1)))
    assert math.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.3)


@pytest.mark.parametrize("engine", ENGINES)
def test_taut_strings(engine: Any) -> None:
    scene = string_pendulum()
    for accuracy in (1e-3, 1e-7):
        run = tmj.simulate(scene, None, engine(accuracy=accuracy))
        assert np.all(run.force_densities > 0)
        assert node_difference(run, truth(scene, run)) <= accuracy


def test_a_closed_loop_of_rods_in_mujoco() -> None:
    """`connect` has order 2, so that an error is a third of the last difference and not a fifteenth."""
    scene = four_bar(planar=False)
    runs = [tmj.simulate(scene, None, tmj.MuJoCo(step), output_interval=0.1) for step in (4e-3, 2e-3)]
    ratio = node_difference(runs[0], truth(scene, runs[0])) / node_difference(runs[1], truth(scene, runs[1]))
    assert math.log2(ratio) == pytest.approx(LOOP_ORDER, abs=0.3)  # RK4's own h⁴ is a thousandth here
    for accuracy in (1e-5, 1e-6):
        run = tmj.simulate(scene, None, tmj.MuJoCo(accuracy=accuracy))
        error = node_difference(run, truth(scene, run))
        assert run.error_estimate is not None
        assert error <= run.error_estimate <= accuracy


@pytest.mark.parametrize("actuation", [tmj.Actuation.hold_force_density(0.02), tmj.Actuation.hold_rest_length(0.02)])
def test_a_sampled_run_is_as_accurate_as_the_same_sampled_experiment(actuation: tmj.Actuation) -> None:
    scene = tmj.load_scene("pinned_rod").with_(duration=1.0)
    law = tmj.controllers.from_scene(scene)
    run = tmj.simulate(scene, law, tmj.MuJoCo(accuracy=1e-6), actuation=actuation)
    same = tmj.DAE(rtol=1e-12, atol=1e-14)
    reference = tmj.simulate(scene, law, same, actuation=actuation, output_interval=float(run.time[1]))
    assert run.reports["accuracy"]["met"]
    assert node_difference(run, reference) <= 1e-6


def test_mujoco_makes_one_run_that_the_dae_certifies() -> None:
    scene = string_pendulum()
    run = tmj.simulate(scene, None, tmj.MuJoCo(accuracy=1e-6))
    report = run.reports["accuracy"]
    *before, last = [one["method"] for one in report["tried"]]
    assert (set(before), last) == ({CERTIFIER}, "rk4")
    assert report["reason"].startswith(f"certified by {CERTIFIER}")
    assert report["met"]
    assert run.error_estimate is not None
    assert node_difference(run, truth(scene, run)) <= run.error_estimate <= 1e-6


def test_a_run_that_is_wrong_at_any_step_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its runs agree with each other, as its gravity is 1e-4 m/s² too large in all of them.

    The pendulum is then 5e-6 of its time ahead: at 2 s and up to 5 rad/s, by some 1e-5 m.
    """
    make = tmj.MuJoCo.run

    def heavier(options: tmj.MuJoCo, request: Request) -> tmj.Trajectory:
        return make(options, replace(request, scene=request.scene.with_(gravity=(0.0, 0.0, -GRAVITY - 1e-4))))

    monkeypatch.setattr(tmj.MuJoCo, "run", heavier)
    run = run_accurately(1e-6, request_of(pendulum()))
    report = run.reports["accuracy"]
    assert report["reason"].startswith(f"refuted by {CERTIFIER}")
    assert not report["met"]
    assert 1e-6 < report["error_estimate"] < 1e-3
    assert any("1e-06 m were requested: refuted" in warning for warning in run.reports["warnings"])


def test_what_the_dae_cannot_certify_is_climbed() -> None:
    """Contact, where its order is not known; a law in Python, which takes the time of both alike; and bodies, or linear
    constraints on nodes, with which all is one system of the DAE, of dearer steps than MuJoCo's.
    """
    drop, spine, ladder = (tmj.load_scene(name).with_(duration=0.1) for name in ("prism_drop", "spine", "ladder"))
    push = np.full(3, 1.0)
    laws = [(scene, None) for scene in (drop, spine, ladder)] + [(string_pendulum(), lambda *state: push)]
    for scene, law in laws:
        report = tmj.simulate(scene, law, tmj.MuJoCo(accuracy=1e-2)).reports["accuracy"]
        assert CERTIFIER not in {one["method"] for one in report["tried"]}
        assert report["met"]


def test_a_climb_beside_one_system_of_the_dae_keeps_its_promise() -> None:
    scene = tmj.load_scene("spine").with_(duration=0.1)
    run = tmj.simulate(scene, None, tmj.MuJoCo(accuracy=1e-6))
    assert run.reports["accuracy"]["met"]
    assert run.error_estimate is not None
    assert node_difference(run, truth(scene, run)) <= 1e-6


def test_cost_counts_every_run() -> None:
    run = tmj.simulate(pendulum(), None, tmj.MuJoCo(accuracy=1e-6))
    report = run.reports["accuracy"]
    tried = report["tried"]
    assert len(tried) == report["total_cost"]["runs"] >= 2
    assert run.cost["evaluations"] == sum(one["evaluations"] for one in tried) == report["total_cost"]["evaluations"]
    assert run.cost["steps"] == sum(one["steps"] for one in tried)
    assert run.cost["steps"] > tried[-1]["steps"]
    assert tried[-1]["timestep"] == report["chosen"]["timestep"]
    assert "chosen for 1e-06 m" in run.engine
    assert run.provenance["engine"]["accuracy"] == 1e-6


@pytest.mark.parametrize("engine", ENGINES)
def test_the_same_request_gives_the_same_run(engine: Any) -> None:
    first, second = (tmj.simulate(string_pendulum(), None, engine(accuracy=1e-6)) for _ in range(2))
    assert np.array_equal(first.nodes, second.nodes)
    reports = [{k: v for k, v in r.reports["accuracy"].items() if k != "total_cost"} for r in (first, second)]
    assert to_exact_json(reports[0]) == to_exact_json(reports[1])


def test_files_keep_it(tmp_path: Path) -> None:
    run = tmj.simulate(pendulum(0.5), None, tmj.MuJoCo(accuracy=1e-4))
    again = tmj.Trajectory.load(run.save(tmp_path / "run.nc"))
    assert again.error_estimate == run.error_estimate
    assert again.reports["accuracy"] == run.reports["accuracy"]
    assert math.isnan(tmj.simulate(pendulum(0.5), None, tmj.MuJoCo(timestep=0.01)).error_estimate)


def test_a_law_without_a_solution_is_reported_and_does_not_settle() -> None:
    def fails_later(time: float, nodes: np.ndarray, velocities: np.ndarray) -> np.ndarray:
        if time > 0.3:
            raise tmj.errors.InfeasibleError("nothing is left")
        return np.full(3, 1.0)

    run = tmj.simulate(string_pendulum(), fails_later, tmj.MuJoCo(accuracy=1e-6))
    assert run.status is tmj.Status.INFEASIBLE
    report = run.reports["accuracy"]
    assert not report["settled"]
    assert not report["met"]
    assert "the run stops at t = 0.3" in report["reason"]
    assert any("not known" in warning for warning in run.reports["warnings"])


def test_a_law_that_jumps_does_not_meet_a_tight_request_without_a_warning() -> None:
    """Where a force jumps no method has an order, and two runs may agree by chance."""

    def bang(time: float, nodes: np.ndarray, velocities: np.ndarray) -> np.ndarray:
        return np.where(velocities[1, 0] > 0, [1.0, 9.0, 1.0], [9.0, 1.0, 1.0])

    scene = string_pendulum().with_(duration=0.5)
    run = tmj.simulate(scene, bang, tmj.DAE(accuracy=1e-9))
    # Steps of fixed length are wrong by a part of h at each jump; error-controlled ones find where it is.
    finer = tmj.simulate(scene, bang, tmj.DAE(rtol=1e-12, atol=1e-14), output_interval=float(run.time[1]))
    assert not run.reports["accuracy"]["met"] or node_difference(run, finer) <= 3e-9


def test_what_the_accuracy_chooses_is_refused_beside_it() -> None:
    for make in (
        lambda: tmj.MuJoCo(accuracy=1e-6, timestep=1e-2),
        lambda: tmj.MuJoCo(accuracy=1e-6, integrator=tmj.Integrator.EULER),
        lambda: tmj.DAE(accuracy=1e-6, rtol=1e-6),
        lambda: tmj.ODE(accuracy=1e-6, method=tmj.Method.RADAU),
        lambda: tmj.DAE(accuracy=1e-6, method=tmj.Method.RK4, timestep=1e-3),
    ):
        with pytest.raises(tmj.errors.OptionError, match="accuracy"):
            make()
    for value in (1e-1, 1e-11, 0.0, -1e-3, math.nan, "1e-6"):
        with pytest.raises(tmj.errors.OptionError, match="accuracy"):
            tmj.MuJoCo(accuracy=value)  # type: ignore[arg-type]


def test_times_without_a_common_divisor_are_refused() -> None:
    with pytest.raises(tmj.errors.OptionError, match="no step divides all of"):
        tmj.simulate(pendulum(math.pi), None, tmj.MuJoCo(accuracy=1e-4), output_interval=0.1)
    # Alone, any duration will do.
    run = tmj.simulate(pendulum(math.pi / 3), None, tmj.MuJoCo(accuracy=1e-4))
    assert run.time[-1] == pytest.approx(math.pi / 3, rel=1e-12)


@pytest.mark.parametrize(
    ("times", "expected"),
    [
        ([2.0, 0.3], 0.1),
        ([1.0, 0.01, 0.015], 0.005),
        ([0.7], 0.7),
        ([3.0, math.pi], None),
        ([0.1, 0.1 * (1 + 3e-9), 0.3], None),  # next to nothing divides the first two, whatever follows
    ],
)
def test_common_divisors(times: list[float], expected: float | None) -> None:
    found = common_divisor(times, times[0])
    assert found is None if expected is None else found == pytest.approx(expected, rel=1e-9)


def request_of(scene: tmj.Scene) -> Request:
    law = native_law(None, scene.structure)
    return Request(scene, law, tmj.Actuation.continuous(), tmj.OnInfeasible.STOP, scene.duration, None, progress=False)


def test_every_run_records_multiples_of_the_unit() -> None:
    request = request_of(pendulum(3.0))
    steps = Steps.of(request, math.inf)
    assert steps.unit == pytest.approx(0.1)
    for wanted in (0.1, 0.04, 0.013, 0.0031, 1e-4):
        step = steps.fit(wanted)
        assert step <= wanted * (1 + 1e-9)
        interval = steps.recorded_each(step)
        assert abs(steps.unit / interval - round(steps.unit / interval)) < 1e-9
        assert abs(interval / step - round(interval / step)) < 1e-9
        assert interval <= max(0.01, step) * (1 + 1e-9)
        coarser = steps.recorded_each(min(2 * step, steps.unit))
        assert abs(coarser / interval - round(coarser / interval)) < 1e-9


def test_the_rates_of_strings_bound_the_linearized_frequencies(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = tmj.load_scene("prism")
    A = tmj.linearize(scene, engine=tmj.DAE()).A
    omega = np.max(np.abs(np.linalg.eigvals(A).imag))
    bound, decay = string_rates(scene.structure, scene.nodes0)
    # Geometric stiffness and supports change less than a factor of 2 here.
    assert (1 - 1e-6) * omega <= bound <= 2 * omega
    assert decay == 0.0
    damped = scene.structure.with_strings(damping=scene.structure.stiffness)
    assert string_rates(damped, scene.nodes0)[1] == pytest.approx(bound**2, rel=1e-9)  # D = K, so λ = ω²
    # The power method of larger structures comes from below, on average over starts to 0.871 ln n/(k - 1) of the
    # largest of n λ after k steps (Kuczynski and Wozniakowski, 1992): 5.5 % of λ of 12 after 40, 2.8 % of ω.
    monkeypatch.setattr(rates, "DENSE", 0)
    assert 0.97 * bound <= string_rates(scene.structure, scene.nodes0)[0] <= bound * (1 + 1e-9)


def test_the_rates_of_a_short_rod_and_of_a_spin() -> None:
    """A short rod between two strings that pull with T along its axis swings with ω² = 6 (T + T) / m l."""
    length, mass, pull = 1e-3, 0.5, 3.0
    structure = tmj.Structure(
        "short",
        {"a": (0.0, 0.0, 0.0), "b": (length, 0.0, 0.0), "f": (-1.0, 0.0, 0.0), "g": (1.0, 0.0, 0.0)},
        rods=(tmj.Rod("rod", ("a", "b"), mass, 1e-4),),
        strings=(
            tmj.String("s", ("f", "a"), 10.0, tension=pull),
            tmj.String("t", ("b", "g"), 10.0, tension=pull),
        ),
        fixed_nodes=("f", "g"),
    )
    scene = tmj.Scene(structure, duration=1e-2)
    omega = np.max(np.abs(np.linalg.eigvals(tmj.linearize(scene, engine=tmj.DAE()).A).imag))
    found = rates_at_start(request_of(scene))
    # Strings of 1 m turn by 1 / 1000 of what the rod does, and their 10 N/m are 1 / 300 of T / l: both count half in ω.
    assert found.turn == pytest.approx(omega, rel=1e-2)
    run = tmj.simulate(scene, None, tmj.DAE(method=tmj.Method.RK4, timestep=1e-3))
    assert rates_along(run, request_of(scene)).turn == pytest.approx(omega, rel=1e-2)
    spinning = scene.with_(initial_velocities=[(0, 0, -0.5), (0, 0, 0.5), (0, 0, 0), (0, 0, 0)])
    assert rates_at_start(request_of(spinning)).turn == pytest.approx(1 / length)


def test_a_step_resolves_what_it_leaves_a_vibration() -> None:
    """RK4 multiplies x' = i ω x by R(z) a step: |R|^(ω T / z) >= 1/e, with log |R| = -z⁶/144 (1 - z²/8 + ...)."""
    for turns in (10.0, 1e3, 1e6):
        z = Rates(turns, 0.0).resolving_step(1.0, 4) * turns
        left = abs(1 + 1j * z - z**2 / 2 - 1j * z**3 / 6 + z**4 / 24) ** (turns / z)
        assert left >= math.exp(-1)
        assert z == 1.0 or left == pytest.approx(math.exp(-1), rel=math.exp(z**2 / 8) - 1)
    assert Rates(10.0, 400.0).resolving_step(1.0, 4) == pytest.approx(1 / 400)
    assert Rates(10.0, 400.0).resolving_step(1.0, 1, damped=False) == pytest.approx(0.1)
    assert Rates(0.0, 0.0).resolving_step(1.0, 4) == math.inf


@pytest.mark.parametrize("engine", ["mujoco", "dae", "ode"])
def test_the_command_line(engine: str, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["run", "pinned_rod", "--engine", engine, "--accuracy", "1e-5", "--duration", "0.5", "--json"]
    assert main(options) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["error_estimate"] <= 1e-5
    assert answer["reports"]["accuracy"]["met"]
    assert main([*options, "--timestep", "1e-3"]) == 2
    assert "--timestep is chosen by --accuracy" in capsys.readouterr().out


def test_compare_reports_both_estimates(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["compare", "pinned_rod", "--accuracy", "1e-6", "--duration", "0.5", "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["first_error_estimate"] <= 1e-6
    assert answer["max_node_error"] <= answer["first_error_estimate"] + answer["second_error_estimate"]
