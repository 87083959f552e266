"""What the report says of a run, against closed forms, hand-made trajectories and the engines' own ledgers."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import tensegrity_mj as tmj
from tensegrity_mj.studies.validation import task as measures
from tensegrity_mj.studies.validation.findings import trend, way
from tensegrity_mj.studies.validation.judging import judged
from tensegrity_mj.studies.validation.sections import is_pinned_rod, perturbed, turned
from tensegrity_mj.studies.validation.task import KEPT, ROWS, TICK, kept_nodes, recording_interval

HOLD_U, HOLD_L0 = tmj.Actuation.hold_force_density(5e-3), tmj.Actuation.hold_rest_length(5e-3)


@pytest.fixture(scope="module")
def run(prism: Any) -> Any:
    law = tmj.controllers.from_scene(prism)
    return tmj.simulate(prism, law, tmj.MuJoCo(1e-3), duration=3.0, output_interval=1e-3)


# Numbers ---------------------------------------------------------------------------------------------------


def test_rates_and_settling_times_of_an_exponential() -> None:
    time = np.linspace(0, 10, 1001)
    values = 3.0 * np.exp(-0.7 * time)
    assert measures.decay_rate(time, values, 1e-3) == pytest.approx(0.7, rel=1e-12)
    # e^(-0.7 t) = 0.1 at 3.289 s: 3.29 is the next time.
    assert measures.settling_time(time, values, 0.3) == pytest.approx(3.29)
    assert measures.settling_time(time, values, 3.0) == 0.0
    assert measures.settling_time(time, values, 1e-3) is None
    assert measures.decay_rate(time, values, 2.99) is None  # two samples
    overshooting = np.abs(np.cos(time)) * np.exp(-0.1 * time)
    at = measures.settling_time(time, overshooting, 0.5)
    assert np.all(overshooting[time >= at] <= 0.5)
    assert overshooting[np.searchsorted(time, at) - 1] > 0.5


def test_target_error_and_lyapunov_of_a_run(run: Any) -> None:
    law = tmj.controllers.from_scene(run.scene)
    found = measures.of_run(run, promised_rate=1.0)
    aim = np.array(run.scene.target.nodes[0])
    error = np.linalg.norm(run.nodes - aim, axis=-1).max(axis=1)
    assert found["error"]["initial"] == pytest.approx(error[0], rel=1e-14)
    assert found["error"]["final"] == pytest.approx(error[-1], rel=1e-14)
    assert found["lyapunov"]["initial"] == pytest.approx(law.evaluate(0.0, run.nodes[0], run.velocities[0])[2])
    # V follows e^-t to 1e-9 (tests of the closed loop): so does the fit.
    assert found["lyapunov"]["fitted_rate"] == pytest.approx(1.0, abs=1e-8)
    assert found["lyapunov"]["promised_rate"] == 1.0
    assert found["lyapunov"]["decay_error"] == run.reports["decay_error"]
    # Rods' directions, from the nodes of each rod.
    cosines = []
    for rod in run.scene.structure.rods:
        i, j = (run.scene.structure.node_index[name] for name in rod.nodes)
        b, b_d = run.nodes[-1, j] - run.nodes[-1, i], aim[j] - aim[i]
        cosines.append(b @ b_d / np.linalg.norm(b) / np.linalg.norm(b_d))
    np.testing.assert_allclose(found["arrival"]["alignment"], cosines, rtol=1e-9)
    assert found["arrival"]["speed"] == np.linalg.norm(run.velocities[-1], axis=1).max()


def test_the_smallest_margin_and_where(run: Any) -> None:
    law = tmj.controllers.from_scene(run.scene)
    found = measures.margin(run)
    assert found is not None
    row = int(np.searchsorted(run.time, found["time"] - 1e-9))
    nodes = np.array(list(found["nodes"].values()))
    np.testing.assert_array_equal(nodes, run.nodes[row])
    assert found["smallest"] == pytest.approx(law.evaluate(found["time"], nodes, run.velocities[row])[1], rel=1e-12)
    others = [law.evaluate(t, run.nodes[i], run.velocities[i])[1] for i, t in enumerate(run.time)][::50]
    assert found["smallest"] <= min(others)
    nothing = replace(run, feasibility_margin=np.full(len(run.time), np.nan))
    assert measures.margin(nothing) is None


def test_peaks_name_member_and_time(run: Any) -> None:
    # Values that no run has, planted in the arrays.
    u, tensions, rods = run.force_densities.copy(), run.tensions.copy(), run.rod_force_densities.copy()
    u[120, 4], tensions[7, 11], rods[30, 2], rods[40, 0] = 9.0, 8.0, -7.0, 6.0
    found = measures.peaks(replace(run, force_densities=u, tensions=tensions, rod_force_densities=rods))
    assert found["force_density"] == {"value": 9.0, "of": "s5", "time": run.time[120]}
    assert found["tension"] == {"value": 8.0, "of": "s12", "time": run.time[7]}
    # All rods are 1 m long: force and force density are equal; compression is the negative one.
    assert found["compression"] == {"value": pytest.approx(7.0), "of": "rod3", "time": run.time[30]}
    assert found["rod_tension"] == {"value": pytest.approx(6.0), "of": "rod1", "time": run.time[40]}
    assert found["rms_force_density"] == pytest.approx(math.sqrt(float(np.mean(u**2))))


def test_switches_are_counted(run: Any) -> None:
    u = np.zeros_like(run.force_densities)
    u[:, 1] = 0.5  # always
    u[100:200, 2] = 0.5  # begins and ceases
    u[300:, 3] = 0.5  # begins
    u[50::2, 4] = 1e-9  # round-off
    found = measures.switching(replace(run, force_densities=u))
    assert found["count"] == 3
    assert found["rate"] == pytest.approx(3 / 3.0)
    assert [found["strings"][f"s{m}"] for m in (2, 3, 4, 5)] == pytest.approx([0.0, 2 / 3, 1 / 3, 0.0])
    # With a floor of 0.5 N/m none of this is a switch; what rises above it is.
    u[:, :] = 0.5
    u[10:20, 0] = 0.8
    assert measures.switching(replace(run, force_densities=u), floor=0.5)["count"] == 2


@pytest.mark.parametrize("engine", [tmj.MuJoCo(1e-3), tmj.DAE(method=tmj.Method.RK4, timestep=1e-3)], ids=str)
@pytest.mark.parametrize("actuation", [HOLD_U, HOLD_L0], ids=lambda one: one.mode.value)
@pytest.mark.parametrize("breaks", [(), (tmj.model.Break("s8", 0.5),)], ids=["whole", "broken"])
def test_winch_work_of_held_strings_is_the_ledger(prism: Any, engine: Any, actuation: Any, breaks: Any) -> None:
    scene = prism.with_(breaks=breaks)
    law = tmj.controllers.from_scene(scene)
    run = tmj.simulate(scene, law, engine, duration=1.5, actuation=actuation, output_interval=5e-3)
    found = measures.winch(run)
    # The same sums in another order: round-off of 300 terms of up to 1e-3 J.
    assert abs(found["closure"]) < 1e-14
    assert found["net"] == pytest.approx(float(run.winch_work[-1]), abs=1e-14)
    assert found["net"] == pytest.approx(found["done"] - found["recovered"], abs=1e-15)
    assert sum(one["done"] for one in found["strings"].values()) == pytest.approx(found["done"])
    assert found["mean"] == pytest.approx((found["done"] + found["recovered"]) / 1.5)
    assert abs(found["net"]) > 1e-4


def test_winch_work_at_every_stage_is_the_ledger_to_second_order() -> None:
    structure = tmj.Structure(
        "lift",
        {"top": (0, 0, 0), "mass": (0, 0, -1)},
        strings=(tmj.String("s1", ("top", "mass"), 8.0, rest_length=0.75),),
        fixed_nodes=("top",),
        point_masses=(tmj.PointMass("mass", 1.0),),
    )

    class Hoist:
        command = tmj.Command.REST_LENGTH

        def __call__(self, time: float, nodes: Any, velocities: Any) -> Any:
            return [0.75 + 0.05 * math.sin(3 * time)]

    scene = tmj.Scene(structure, gravity=(0.0, 0.0, -2.0))
    engine = tmj.DAE(rtol=1e-12, atol=1e-13)
    closures = []
    for interval in (2e-2, 2e-3):
        run = tmj.simulate(scene, Hoist(), engine, duration=2.0, output_interval=interval)
        assert np.all(run.tensions > 0)
        closures.append(abs(measures.winch(run)["closure"]))
    # The trapezoidal rule where nothing has kinks: a tenth of the interval, a hundredth of the error.
    assert closures[0] / closures[1] == pytest.approx(100, rel=0.01)
    assert closures[0] < 1e-4  # h²/12 T f', f = T dL0/dt with T of 2 N and dL0/dt of 0.15 m/s at 3 rad/s


def test_winch_power_is_tension_times_speed(run: Any) -> None:
    fine = measures.winch(run)
    assert abs(fine["closure"]) < 1e-7  # u has kinks here; see the test above
    # Power against the strings' rates: P = -T dL0/dt with L0 = L - T/k, by differences over two samples.
    k = run.scene.structure.stiffness
    T = run.force_densities * run.scene.structure.string_lengths(run.nodes)
    power = -T * (run.scene.structure.string_rates(run.nodes, run.velocities) - np.gradient(T, run.time, axis=0) / k)
    row, column = np.unravel_index(np.argmax(np.abs(power)), power.shape)
    assert fine["peak"]["of"] == f"s{column + 1}"
    assert fine["peak"]["time"] == pytest.approx(run.time[row], abs=3e-3)
    # Means over 1 ms against values there: the power changes by itself within some 0.2 s.
    assert fine["peak"]["value"] == pytest.approx(np.abs(power).max(), rel=1e-2)


def test_nodes_are_kept_at_common_times(prism: Any) -> None:
    law = tmj.controllers.from_scene(prism)
    runs = [
        tmj.simulate(prism, law, tmj.MuJoCo(1e-3), duration=2.5, output_interval=interval)
        for interval in (1e-3, 5e-3, TICK)
    ]
    kept = [kept_nodes(run, 2.5) for run in runs]
    assert all(one["times"] == kept[0]["times"] for one in kept)
    assert kept[0]["times"][-1] == pytest.approx(2.49)  # each 3 hundredths: at most KEPT of them
    assert len(kept[0]["times"]) <= KEPT + 1
    np.testing.assert_array_equal(kept[0]["nodes"], kept[2]["nodes"])
    np.testing.assert_array_equal(kept[0]["nodes"][3], runs[0].nodes[90])


def test_runs_are_recorded_as_finely_as_memory_allows(prism: Any) -> None:
    assert recording_interval(prism, 1e-3, 10.0) == 1e-3
    assert recording_interval(prism, TICK, 10.0) == TICK
    width = 6 * 6 + 3 * 12 + 3 + 8
    tight = ROWS / 8 / width * 1e-4  # s that just fit at 0.1 ms
    assert recording_interval(prism, 1e-4, 0.99 * tight) == 1e-4
    assert recording_interval(prism, 1e-4, 1.01 * tight) == 2e-4
    assert recording_interval(prism, 1e-4, 1e6) == pytest.approx(TICK)


# Judgements ------------------------------------------------------------------------------------------------


def ended(error: float, speed: float, alignment: float, status: str = "completed") -> dict[str, Any]:
    reports = {"message": "", "growth": [], "doubts": [], "acts": True}
    arrival = {"speed": speed, "alignment": [1.0, alignment]}
    return {"status": status, "error": {"final": error}, "arrival": arrival, **reports}


@pytest.mark.parametrize(
    ("values", "outcome", "word"),
    [
        (ended(0.04, 1.0, 1.0), "converged", "good"),
        (ended(0.04, 1.0, 1.0) | {"doubts": ["it warned"]}, "converged", "limited"),
        (ended(0.04, 1.0, 1.0) | {"growth": ["the energy grows"]}, "grows", "bad"),
        (ended(0.04, 1.0, 1.0) | {"acts": False}, "converged", "not judged"),
        (ended(0.06, 0.001, 1.0), "off target", "bad"),
        (ended(0.06, 0.1, -0.999), "still moving", "limited"),
        (ended(2.0, 0.001, -0.999), "mirrored", "bad"),
        (ended(0.01, 0.0, 1.0, "infeasible"), "infeasible", "bad"),
        (ended(0.01, 0.0, 1.0, "singular"), "singular", "not judged"),
        ({"status": "diverged", "message": ""}, "diverged", "bad"),
    ],
)
def test_how_runs_come_out(values: dict[str, Any], outcome: str, word: str) -> None:
    found = judged(values, tolerance=0.05, duration=10.0)
    assert (found[0], found[1].word) == (outcome, word)
    beside = judged(values, tolerance=0.05, duration=10.0, nominal={"outcome": "converged"})
    assert (beside[0], beside[1].word) == (outcome, "bad" if outcome == "still moving" else word)


@pytest.mark.parametrize(
    ("values", "sign", "unsettled", "verdict"),
    [
        ([1.0, 2.0, 3.0], 1, False, "yes"),
        ([1.0, 2.0, 3.0], -1, False, "no"),
        ([1.0, 2.0, 1.5], 1, False, "mixed"),
        ([1.0, 1.005, 1.009], 1, False, "none"),
        ([1.0, 1.005, 2.0], 1, False, "yes"),
        ([1.0, 2.0, None, None], 1, True, "yes"),
        ([None, 2.0], 1, True, "no"),
        ([None, 2.0], 1, False, "unknown"),
    ],
)
def test_trends(values: list[float | None], sign: int, unsettled: bool, verdict: str) -> None:
    assert trend(values, sign, unsettled) == verdict


def test_the_way_to_the_target(prism: Any) -> None:
    farthest = np.linalg.norm(prism.nodes0 - prism.target.nodes[0], axis=1).max()
    assert way(prism, 5.0) == pytest.approx(farthest)
    there = prism.with_(target=tmj.Target.set_point(prism.nodes0))
    assert way(there, 5.0) == pytest.approx(np.ptp(prism.nodes0, axis=0).max())


# Starts ----------------------------------------------------------------------------------------------------


def test_a_turned_rod_keeps_its_pin() -> None:
    scene = tmj.load_scene("pinned_rod")
    assert is_pinned_rod(scene.structure)
    assert not is_pinned_rod(tmj.load_scene("prism").structure)
    b = np.array([0.6, 0.0, -0.8])
    nodes = turned(scene, b)
    np.testing.assert_allclose(nodes[scene.structure.node_index["n1"]], b, atol=1e-15)
    np.testing.assert_array_equal(nodes[0], [0, 0, 0])
    scene.with_(initial_nodes=nodes)  # is a state of the structure


@pytest.mark.parametrize("name", ["prism", "tbar"])
def test_perturbed_starts_are_states_of_the_structure(name: str) -> None:
    scene = tmj.load_scene(name)
    for amplitude in (0.1, 1.0):
        nodes = perturbed(scene, amplitude, np.random.default_rng(5))
        scene.with_(initial_nodes=nodes, initial_velocities=None)  # raises where a rod or a support is violated
        for i, j in scene.structure.rod_nodes:
            turn = (nodes[j] - nodes[i]) @ (scene.nodes0[j] - scene.nodes0[i])
            length2 = np.sum((nodes[j] - nodes[i]) ** 2)
            assert turn / length2 == pytest.approx(math.cos(amplitude), abs=1e-9)
