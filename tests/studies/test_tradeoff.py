"""The trade-off study: errors that are known, references that are honest about themselves, the same data each time."""

from __future__ import annotations

import itertools
import json
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_words import choices_of
from hypothesis import given, settings
from hypothesis import strategies as st

import tensegrity_mj as tmj
from evidence.pages import tradeoff as docs
from tensegrity_mj.basics.units import quantity
from tensegrity_mj.cli import main
from tensegrity_mj.engines.reference.method import Method
from tensegrity_mj.engines.table import ENGINES
from tensegrity_mj.errors import FormatError, OptionError
from tensegrity_mj.model.actuation import Mode
from tensegrity_mj.runs import reference_of
from tensegrity_mj.studies.tradeoff import advising, reference
from tensegrity_mj.studies.tradeoff.advising import cheapest, decades, pareto
from tensegrity_mj.studies.tradeoff.experiments import (
    BUDGET,
    Experiment,
    Loop,
    TradeoffOptions,
    grid_of_steps,
    most_evaluations,
    open_loop,
    radau_steps,
    recording_interval,
    settings_of,
)
from tensegrity_mj.studies.tradeoff.reference import FLOOR_FACTOR, Ended, Motion, attempt, find_reference, record
from tensegrity_mj.studies.tradeoff.study import tradeoff

# ------------------------------------------------------------------------------------------------------- the front

NUMBERS = st.one_of(
    st.none(),
    st.just(math.inf),
    st.just(math.nan),
    st.floats(1e-12, 1e3),
    st.integers(-12, 3).map(lambda power: 10.0**power),
)


def known(point: tuple[float | None, float | None]) -> bool:
    return all(value is not None and math.isfinite(value) for value in point)


@settings(derandomize=True, deadline=None)
@given(st.lists(st.tuples(NUMBERS, NUMBERS), max_size=20), st.sampled_from([0.0, 1e-6, 1.0]))
def test_no_point_beats_one_on_the_front_and_some_point_of_it_matches_any_other(
    points: list[tuple[float | None, float | None]], floor: float
) -> None:
    costs, errors = [cost for cost, _ in points], [error for _, error in points]
    front = pareto(costs, errors, floor)
    at = {n: (costs[n], max(errors[n], floor)) for n in range(len(points)) if known(points[n])}  # type: ignore[type-var]
    assert set(front) <= set(at)
    for n in front:
        assert not any(at[m][0] <= at[n][0] and at[m][1] <= at[n][1] and at[m] != at[n] for m in at)  # type: ignore[operator]
    for m in at:
        assert any(at[n][0] <= at[m][0] and at[n][1] <= at[m][1] for n in front)  # type: ignore[operator]
    along = [at[n] for n in front]
    assert all(a[0] < b[0] and a[1] > b[1] for a, b in itertools.pairwise(along))  # type: ignore[operator]


@settings(derandomize=True, deadline=None)
@given(st.lists(st.tuples(NUMBERS, NUMBERS), max_size=20), st.floats(1e-6, 1e2))
def test_the_cheapest_adequate_point_is_adequate_and_costs_least(
    points: list[tuple[float | None, float | None]], tolerance: float
) -> None:
    costs, errors = [cost for cost, _ in points], [error for _, error in points]
    number = cheapest(costs, errors, tolerance)
    adequate = [cost for cost, error in points if known((cost, 0.0)) and error is not None and error <= tolerance]
    assert (number is None) == (not adequate)
    if number is not None:
        assert errors[number] <= tolerance  # type: ignore[operator]
        assert costs[number] == min(adequate)  # type: ignore[type-var]


def test_what_lies_below_the_floor_counts_as_equal() -> None:
    assert pareto([1.0, 2.0, 3.0], [1e-3, 1e-7, 1e-9], floor=1e-6) == [0, 1]
    assert pareto([1.0, 2.0, 3.0], [1e-3, 1e-7, 1e-9]) == [0, 1, 2]


def test_costs_that_a_clock_cannot_distinguish_go_to_the_first() -> None:
    assert cheapest([1.2, 1.0, 3.0], [0.1, 0.1, 0.1], 0.5, alike=1.25) == 0
    assert cheapest([1.3, 1.0, 3.0], [0.1, 0.1, 0.1], 0.5, alike=1.25) == 1
    assert cheapest([1.2, 1.0, 3.0], [0.9, 0.1, 0.1], 0.5, alike=1.25) == 1


def test_decades_lie_below_the_motion_and_end_with_the_first_that_nothing_reaches() -> None:
    assert decades(0.3, [2e-3, None, 5e-4]) == [1e-1, 1e-2, 1e-3, 1e-4]
    assert decades(5e-3, [2e-5]) == [1e-3, 1e-4, 1e-5]
    assert decades(0.3, [None]) == [1e-1]
    assert len(decades(0.3, [0.0])) == 12


# -------------------------------------------------------------------------------------------------------- settings


@settings(derandomize=True, deadline=None)
@given(st.floats(1e-3, 1e3), st.sampled_from([None, 0.1, 0.01, 0.001, 0.004]), st.floats(10, 1e5))
def test_every_step_divides_run_interval_and_period(duration: float, period: float | None, most: float) -> None:
    duration = float(f"{duration:.3g}")
    interval = recording_interval(duration)
    rows = duration / interval
    assert abs(rows - round(rows)) < 1e-9 * rows
    assert rows > 50 * (1 - 1e-9)
    steps = grid_of_steps(interval, period, most, duration)
    assert steps == sorted(steps, reverse=True)
    for step in steps:
        for whole in (duration, interval) if period is None else (duration, interval, period):
            assert abs(whole / step - round(whole / step)) < 1e-8 * whole / step
    # Two are there even where the budget has none; beyond those the budget holds.
    assert len(steps) >= 2 or period is not None
    assert all(duration / step <= most * (1 + 1e-9) for step in steps[2:])


def test_the_sweep_covers_every_integrator_and_keeps_its_budget() -> None:
    scene = tmj.load_scene("prism")
    experiment = open_loop(scene, TradeoffOptions(), None)
    found = {kind: settings_of(experiment, TradeoffOptions(engines=[kind])) for kind in ENGINES}
    assert {one.engine.integrator for one in found["mujoco"]} == set(tmj.Integrator)  # type: ignore[union-attr]
    for kind in ("dae", "ode"):
        assert {one.engine.method for one in found[kind]} == set(Method)  # type: ignore[union-attr]
    assert {one.engine.drift for one in found["dae"]} == set(tmj.engines.Drift)  # type: ignore[union-attr]
    for one in found["dae"]:  # a name says what is not the default
        default = tmj.DAE(method=one.engine.method, timestep=one.engine.timestep).drift  # type: ignore[union-attr]
        assert (one.engine.drift is default) == (one.family in ("DAE RK4", "DAE DOP853", "DAE Radau"))  # type: ignore[union-attr]
    most = most_evaluations(scene, None, BUDGET)
    for one in found["mujoco"]:
        assert one.engine.stages * scene.duration / one.engine.timestep <= most * (1 + 1e-9)  # type: ignore[union-attr]
    labels = [advising.label(one.to_dict()) for kind in ENGINES for one in found[kind]]
    assert len(set(labels)) == len(labels)
    assert "MuJoCo RK4, 10 ms" in labels
    held = replace(experiment, actuation=tmj.Actuation.hold_force_density(1e-2))
    sampled = settings_of(held, TradeoffOptions(engines=["mujoco"]))
    assert max(one.engine.timestep for one in sampled) == 1e-2  # type: ignore[union-attr]


def test_radau_has_the_budget_of_a_body_as_of_four_points() -> None:
    # Three free vertebrae, 24 strings: r, three base vectors and their rates, a clock of three more.
    scene = tmj.load_scene("spine")
    assert radau_steps(scene, None, budget=1e6) == int(1e6 / (10 * 24 + (3 * 24 + 3) ** 3 / 100))


IMPLICIT = ("implicit", "implicitfast", "discrete")


@pytest.mark.parametrize(
    ("name", "members", "refused"),
    [
        ("ladder", "ladder (rods: 1, strings: 1)", {*(f"MuJoCo {word}" for word in IMPLICIT), "ODE RK4"}),
        ("spine", "spine (bodies: 4, strings: 24)", {"ODE RK4"}),
    ],
)
def test_what_engines_refuse_is_in_the_study_with_the_reason(
    name: str, members: str, refused: set[str], tmp_path: Path
) -> None:
    options = TradeoffOptions(
        families=("MuJoCo", "DAE RK4, monitor", "ODE RK4"), steps=(2e-3, 1e-3), duration=0.1, repeats=1, budget=1e5
    )
    data = tradeoff(tmj.load_scene(name), folder=tmp_path, options=options).data
    points = data["experiments"][0]["points"]
    assert {one["family"] for one in points if one["status"] == "refused"} == refused
    assert all(one["status"] == "completed" for one in points if one["family"] not in refused)
    assert all("use " in one["reason"] for one in points if one["family"] in refused)
    page = (tmp_path / "tradeoff.html").read_text(encoding="utf-8")
    assert members in page
    assert page.count("refused: ") == len(refused)


def test_options_that_make_no_sense_are_refused() -> None:
    with pytest.raises(OptionError, match="loops"):
        TradeoffOptions(loops=[])
    with pytest.raises(OptionError, match="engines"):
        TradeoffOptions(engines=["mujoko"])
    with pytest.raises(OptionError, match="periods"):
        TradeoffOptions(periods=[-1.0])
    with pytest.raises(OptionError, match="repeats"):
        TradeoffOptions(repeats=0)
    with pytest.raises(OptionError, match="nonsense: no setting has one of these words; there are MuJoCo Euler"):
        small_study(None, families=["nonsense"])
    with pytest.raises(OptionError, match="no control law"):
        tradeoff("tbar", options=TradeoffOptions(loops=[Loop.CLOSED]))


# ---------------------------------------------------------------------------------------- errors of a known motion

MASS, STIFFNESS, START, DURATION = 2.0, 18.0, 0.2, 2.0


def spring_scene(stiffness: float = STIFFNESS) -> tmj.Scene:
    """A point mass between two equal springs, 1 m apart from either wall: x = START cos(ω t), ω = √(2 k/m).

    Both strings are at tension throughout: their rest lengths are 0.5 m, and 1 - START > 0.5. Their sum of forces is
    -2 k x whatever the prestress, and the motion is along the strings.
    """
    structure = tmj.Structure(
        "spring",
        {"m": (0.0, 0.0, 0.0), "left": (-1.0, 0.0, 0.0), "right": (1.0, 0.0, 0.0)},
        strings=(
            tmj.String("s1", ("m", "left"), stiffness, rest_length=0.5),
            tmj.String("s2", ("m", "right"), stiffness, rest_length=0.5),
        ),
        fixed_nodes=("left", "right"),
        point_masses=(tmj.PointMass("m", MASS),),
    )
    nodes = structure.positions.copy()
    nodes[list(structure.nodes).index("m"), 0] = START
    return tmj.Scene(structure, initial_nodes=nodes, duration=DURATION)


def spring_motion(times: Any) -> Any:
    scene = spring_scene()
    nodes = np.repeat(scene.nodes0[None], len(times), axis=0)
    nodes[:, list(scene.structure.nodes).index("m"), 0] = START * np.cos(math.sqrt(2 * STIFFNESS / MASS) * times)
    return nodes


def test_errors_are_those_of_the_formula() -> None:
    study = tradeoff(
        spring_scene(),
        options=TradeoffOptions(engines=["mujoco"], families=["Euler", "RK4"], steps=[2e-2, 5e-3], repeats=1),
    )
    (experiment,) = study.data["experiments"]
    assert experiment["interval"] == 0.02
    own = experiment["reference"]["own_error"]
    # Error control at 1e-12 and 1e-13 over six radians: not far from round-off of 0.2 m, times the steps taken.
    assert 0 <= own < 1e-10
    step, omega = experiment["interval"], math.sqrt(2 * STIFFNESS / MASS)
    times = np.arange(round(DURATION / step) + 1) * step
    for point in experiment["points"]:
        assert point["status"] == "completed"
        run = tmj.simulate(
            spring_scene(),
            None,
            tmj.MuJoCo(
                point["options"].get("timestep", 1e-3), tmj.Integrator(point["options"].get("integrator", "rk4"))
            ),
            output_interval=step,
        )
        true = np.linalg.norm(run.nodes - spring_motion(times), axis=-1).max(axis=1)
        assert point["error"] == pytest.approx(true.max(), abs=2 * own + 1e-14)
        assert point["final_error"] == pytest.approx(true[-1], abs=2 * own + 1e-14)
        # Semi-implicit Euler and RK4 of x¨ = -ω² x err in phase by ω³ h² t/24 and ω^5 h^4 t/120, Euler in amplitude
        # by ω h/2 at first order. Within a factor of two, the higher orders being (ω h)² = 0.03 at most.
        h = point["options"].get("timestep", 1e-3)
        order = 1 if "Euler" in point["family"] else 4
        bound = START * (omega * h / 2 if order == 1 else (omega * h) ** 4 * omega * DURATION / 120)
        assert bound / 4 < point["error"] < 2 * bound
        assert not point["at_reference_floor"]


def test_a_held_experiment_is_measured_against_itself_and_its_distance_from_the_law_is_the_floor() -> None:
    options = TradeoffOptions(
        loops=[Loop.CLOSED],
        engines=["dae"],
        families=["RK4"],
        actuations=[Mode.CONTINUOUS, Mode.HOLD_FORCE_DENSITY],
        periods=[0.05],
        steps=[0.01],
        duration=1.0,
        repeats=1,
    )
    scene = tmj.load_scene("prism")
    study = tradeoff(scene, options=options)
    continuous, held = study.data["experiments"]
    assert continuous["modelling_floor"] is None
    law = tmj.controllers.from_scene(scene)
    tight = tmj.DAE(rtol=1e-12, atol=1e-13)
    runs = [
        tmj.simulate(scene, law, tight, duration=1.0, actuation=actuation, output_interval=held["interval"])
        for actuation in (tmj.Actuation.continuous(), tmj.Actuation.hold_force_density(0.05))
    ]
    distance = tmj.compare(*runs).node_error
    floor = held["modelling_floor"]
    assert floor["distance"] == pytest.approx(distance.max(), abs=floor["resolved"] + 1e-12)
    assert floor["final_distance"] == pytest.approx(distance[-1], abs=floor["resolved"] + 1e-12)
    # Forces held for 50 ms are old by 25 ms on average: far more than what RK4 at 10 ms gets wrong of the held motion.
    (point,) = [one for one in held["points"] if one["family"] == "DAE RK4"]
    assert point["error"] < 1e-2 * floor["distance"]
    reported = study.data["timing"]["experiments"][held["key"]]["floor"]
    assert "whatever the step; fine enough for it is DAE RK4, 10 ms" in reported


# ------------------------------------------------------------------------------------------------------ references


def spring_experiment(stiffness: float = STIFFNESS) -> Experiment:
    return Experiment(spring_scene(stiffness), None, None, tmj.Actuation.continuous(), DURATION)


def test_a_reference_knows_how_wrong_it_is() -> None:
    experiment = spring_experiment()
    found = find_reference(experiment, 1e6)
    assert found.motion is not None
    true = np.linalg.norm(found.motion.nodes - spring_motion(found.motion.time), axis=-1).max()
    # The formula's cosine is round-off of 0.2 m, 3e-17; the reference is as good as it says or within ten units of it.
    assert true <= found.own_error + 10 * np.finfo(float).eps * START
    assert found.facts["second_formulation"]["engine"].startswith("ODE")


def test_with_contact_the_dae_is_the_reference_and_mujoco_confirms_it_by_the_same_steps() -> None:
    """Both engines differ by the fourth order of the step and roundings, 1e-11 m, and each errs by 1e-4 m as it touches
    (tests/runs/test_scoring.py has both), which would be the own error of the reference without the DAE's steps.
    """
    scene, known = tmj.load_scene("pack/contact"), reference_of("contact")
    found = find_reference(Experiment(scene, None, None, tmj.Actuation.continuous(), scene.duration), 3e5)
    assert found.motion is not None
    assert found.facts["engine"].startswith("DAE DOP853")
    assert found.facts["second_formulation"]["engine"].startswith("MuJoCo")
    assert found.own_error < 1e-9
    rows = np.searchsorted(found.motion.time, known.time - 1e-9)
    error = np.linalg.norm(found.motion.nodes[rows] - known.positions, axis=-1).max()
    assert error <= found.own_error + known.header["error"]


def test_a_coarse_reference_says_so_and_points_below_it_are_marked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reference, "RTOL", 1e-3)
    monkeypatch.setattr(reference, "TIGHTER", 1e-4)
    found = find_reference(spring_experiment(), 1e6)
    assert found.motion is not None
    true = float(np.linalg.norm(found.motion.nodes - spring_motion(found.motion.time), axis=-1).max())
    assert true > 1e-7  # it is coarse
    assert found.own_error > true / FLOOR_FACTOR
    study = tradeoff(
        spring_scene(), options=TradeoffOptions(engines=["mujoco"], families=["RK4"], steps=[1e-3], repeats=1)
    )
    (experiment,) = study.data["experiments"]
    # RK4 at 1 ms errs by 1e-13 m: what is measured is the reference.
    (point,) = experiment["points"]
    assert point["at_reference_floor"]
    advice = experiment["by_right_hand_sides"]["advice"]
    assert all(one["point"] is None for one in advice if one["tolerance"] <= experiment["reference"]["own_error"])
    assert "the reference itself is known to" in advice[-1]["text"]


def test_a_reference_is_not_compared_with_itself() -> None:
    experiment = spring_experiment()
    found = find_reference(experiment, 1e6)
    kinds = TradeoffOptions(engines=["mujoco"], families=["MuJoCo RK4"], steps=[2e-3, 1e-3])
    chosen = settings_of(experiment, kinds)
    same = reference.Reference(found.motion, found.facts | {"engine": str(chosen[0].engine)})
    records = [[record(attempt(experiment, one.engine), one.engine, found.motion)] for one in chosen]
    facts, timing = advising.result_of(experiment, same, None, chosen, records)
    own, other = facts["points"]
    assert (own["error"], own["reason"]) == (None, "it is the reference itself")
    assert other["error"] is not None
    assert facts["by_right_hand_sides"]["front"] == timing["front"] == [1]


def test_doubts_of_a_reference_are_those_of_all_errors() -> None:
    kinds = TradeoffOptions(engines=["mujoco"], families=["MuJoCo RK4"], steps=[1e-3], repeats=1)
    study = tradeoff(spring_scene(), options=kinds)
    (experiment,) = study.data["experiments"]
    (sure,) = study.judgement.findings
    assert sure.mark.value == "good"
    allowed = 1e-2 * experiment["reference"]["motion"]
    assert f"(allowed {quantity(allowed, 'm', 2)})" in sure.text
    experiment["reference"]["doubts"] = ["the energy balance is off"]
    (doubtful,) = study.judgement.findings
    assert doubtful.mark.value == "limited"
    assert any("all errors with it: the energy balance is off" in text for text in study.sentences)
    experiment["reference"]["own_error"] = 2 * allowed  # a second formulation that is far away confirms nothing
    (unsure,) = study.judgement.findings
    assert unsure.mark.value == "bad"
    assert "confirms it" not in unsure.text


def test_where_the_dae_refuses_mujoco_at_two_steps_is_the_reference_and_there_is_no_second_formulation(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    experiment = spring_experiment()

    def run(of: Experiment, engine: Any) -> Any:
        if not isinstance(engine, tmj.MuJoCo):
            from tensegrity_mj.studies.tradeoff.reference import Attempt

            return Attempt(Ended.REFUSED, "it knows no contact", None)
        return attempt(of, engine)

    monkeypatch.setattr(reference, "attempt", run)
    found = find_reference(experiment, 1e5)
    assert found.motion is not None
    assert found.facts["engine"].startswith("MuJoCo")
    assert found.facts["second_formulation"] is None
    assert "there is no second formulation" in advising.reference_sentence({"reference": found.facts})
    # The finer step is the reference: it lies nearer to the truth than the coarser by the order of the method.
    true = np.linalg.norm(found.motion.nodes - spring_motion(found.motion.time), axis=-1).max()
    assert true <= found.own_error + 1e-13
    assert [one["status"] for one in found.facts["tried"]].count("refused") == 2  # each of the DAE's ways once


def test_without_any_reference_the_reason_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    from tensegrity_mj.studies.tradeoff.reference import Attempt

    monkeypatch.setattr(reference, "attempt", lambda *_: Attempt(Ended.REFUSED, "not today", None))
    found = find_reference(spring_experiment(), 1e5)
    assert found.motion is None
    assert math.isinf(found.own_error)
    assert found.facts["reason"] == "not today"


def test_a_motion_of_other_times_or_nodes_is_infinitely_far() -> None:
    times = np.array([0.0, 1.0])
    here = Motion(times, np.zeros((2, 3, 3)))
    assert here.distance(Motion(times, np.ones((2, 3, 3)))).tolist() == pytest.approx([math.sqrt(3)] * 2)
    assert math.isinf(here.distance(Motion(times * 2, np.zeros((2, 3, 3)))).max())
    assert math.isinf(here.distance(Motion(times, np.zeros((2, 2, 3)))).max())
    assert math.isinf(Motion(times, np.full((2, 3, 3), np.nan)).distance(here).max())


# -------------------------------------------------------------------------------------- unstable and failed points


def test_unstable_refused_and_expensive_runs_are_results() -> None:
    experiment = spring_experiment()
    target = find_reference(experiment, 1e6).motion
    # The stiff spring has ω h = 4.2, beyond the limit 2√2 of RK4; 0.03 s does not divide 2 s; 3 steps are too few.
    cases = {
        "diverged": (spring_experiment(1e4 * STIFFNESS), tmj.MuJoCo(0.01)),
        "refused": (experiment, tmj.MuJoCo(0.03)),
        "over budget": (experiment, tmj.DAE(rtol=1e-12, atol=1e-13, max_steps=3)),
    }
    cases["failed"] = (
        Experiment(spring_scene(), lambda time, nodes, velocities: 1 / 0, None, tmj.Actuation.continuous(), DURATION),
        tmj.MuJoCo(0.01),
    )
    for status, (one, engine) in cases.items():
        values = record(attempt(one, engine), engine, target)
        assert values["status"] == status, values
        assert values["error"] is None
        assert values["reason"]


def test_failed_points_are_drawn_and_listed(finished: Any) -> None:
    data = json.loads(json.dumps(finished.data))
    for experiment in data["experiments"]:
        experiment["points"][0] |= {"error": None, "status": "diverged", "reason": "energy came from nowhere"}
        front = experiment["by_right_hand_sides"]["front"]
        experiment["by_right_hand_sides"]["front"] = [number for number in front if number]
    from tensegrity_mj.studies.tradeoff.page import TOP, Cost, diagram, rows

    figure = diagram(data, Cost.RIGHT_HAND_SIDES)
    crosses = [line for line in figure.axes[0].get_lines() if line.get_marker() == "x" and len(line.get_xdata())]
    assert [list(line.get_ydata()) for line in crosses] == [[TOP]]
    (x,) = crosses[0].get_xdata()
    assert x == data["experiments"][0]["points"][0]["evaluations"]
    experiment = data["experiments"][0]
    first = rows(experiment, data["timing"]["experiments"][experiment["key"]])[0]
    assert first["remark"] == "diverged: energy came from nowhere"


# ------------------------------------------------------------------------------------------------- the whole study


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """The small study, kept."""
    return small_study(tmp_path_factory.mktemp("kept") / "a")


def small_study(folder: Path | None, **changes: Any) -> Any:
    chosen = {"engines": ["mujoco", "dae"], "families": ["Euler", "RK4"], "steps": [0.02, 0.005], "repeats": 2}
    return tradeoff(spring_scene(), folder=folder, options=TradeoffOptions(**{**chosen, **changes}))


def without_timing(data: dict[str, Any]) -> str:
    by_clock = ("timing", "verdict", "findings")  # the latter two name what is fastest
    return json.dumps({key: value for key, value in data.items() if key not in by_clock}, sort_keys=True)


def test_two_studies_are_the_same_but_for_the_clock(finished: Any, tmp_path: Path) -> None:
    first, second = finished, small_study(tmp_path / "b")
    texts = [(one.folder / "tradeoff.json").read_text(encoding="utf-8") for one in (first, second)]
    assert without_timing(json.loads(texts[0])) == without_timing(json.loads(texts[1]))
    assert "wall_time" not in without_timing(first.data)
    assert "wall_time" in json.dumps(second.data["timing"])
    assert all(point["repeatable"] for one in first.data["experiments"] for point in one["points"])


def test_it_goes_on_where_it_stopped(finished: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from tensegrity_mj.studies.tradeoff import study as module

    calls = []

    def interrupted(*arguments: Any) -> Any:
        calls.append(arguments)
        if len(calls) == 6:
            raise KeyboardInterrupt
        return attempt(*arguments)

    monkeypatch.setattr(module, "attempt", interrupted)
    with pytest.raises(KeyboardInterrupt, match="runs are finished and kept in"):
        small_study(tmp_path / "a")
    kept = (tmp_path / "a" / "runs" / "points.jsonl").read_text(encoding="utf-8").splitlines()
    assert len(kept) >= 2
    monkeypatch.setattr(module, "attempt", attempt)
    small_study(tmp_path / "a")
    lines = (tmp_path / "a" / "runs" / "points.jsonl").read_text(encoding="utf-8").splitlines()
    assert lines[: len(kept)] == kept
    keys = [json.loads(line)["key"] for line in lines]
    assert len(set(keys)) == len(keys)  # nothing was computed again
    assert without_timing(json.loads((tmp_path / "a" / "tradeoff.json").read_text(encoding="utf-8"))) == without_timing(
        json.loads(json.dumps(finished.data))
    )
    with pytest.raises(OptionError, match="another study"):
        small_study(tmp_path / "a", repeats=1)


def test_a_finished_study_computes_nothing_again(finished: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    from tensegrity_mj.studies.tradeoff import study as module

    def never(*_: object, **__: object) -> None:
        raise AssertionError("something was computed again")

    for name in ("attempt", "find_reference", "record"):
        monkeypatch.setattr(module, name, never)
    again, first = small_study(finished.folder), json.loads(json.dumps(finished.data))
    assert again.data["timing"] == first["timing"]  # even the clock's readings are kept
    assert without_timing(json.loads(json.dumps(again.data))) == without_timing(first)


def test_what_stands_still_starts_from_where_its_law_moves_it() -> None:
    options = TradeoffOptions(engines=["mujoco"], families=["RK4"], steps=[0.01], repeats=1, duration=1.0, periods=[])
    opened, closed = tradeoff("prism", options=options).data["experiments"]
    assert (opened["loop"], closed["loop"]) == ("open", "closed")
    assert "most kinetic energy" in opened["note"]
    assert opened["reference"]["motion"] > 1e-3
    still = tradeoff(tmj.load_scene("prism").with_(control=None), options=options).data["experiments"][0]
    assert still["reference"]["engine"] is None
    assert "nothing moves" in still["reference"]["reason"]


def test_page_picture_and_documentation_are_written(finished: Any, tmp_path: Path) -> None:
    study, folder = finished, finished.folder
    page = (folder / "tradeoff.html").read_text(encoding="utf-8")
    assert not re.search("https?:", page)  # bare "http" may stand in the pixels of a picture
    assert page.count("data:image/png") == 2
    assert study.save_figure(tmp_path / "a.svg").is_file()
    (tmp_path / "tradeoff.md").write_text("# Title\n\nText.\n", encoding="utf-8")
    kept = json.loads((folder / "tradeoff.json").read_text(encoding="utf-8"))
    written = docs.write_docs(tmp_path, [kept])
    assert [path.name for path in written] == ["spring.png", "tradeoff.md"]
    assert written[0].stat().st_size < 80_000
    once = written[1].read_text(encoding="utf-8")
    assert once.startswith("# Title\n\nText.\n")
    assert "![Error against wall time of scene spring](tradeoff/spring.png)" in once
    docs.write_docs(tmp_path, [study.data])
    assert written[1].read_text(encoding="utf-8") == once
    written[1].write_text(once.replace(docs.END.format(name="spring"), ""), encoding="utf-8")
    with pytest.raises(FormatError, match="damaged"):
        docs.write_docs(tmp_path, [study.data])


# -------------------------------------------------------------------------------------------------------- sentences


def experiment_of(points: list[tuple[str, str, float | None, int]], own: float = 1e-9) -> dict[str, Any]:
    return {
        "title": "open loop",
        "reference": {"own_error": own, "motion": 0.05},
        "points": [
            {"family": family, "knob": knob, "error": error, "engine": family.split()[0].lower(), "evaluations": count}
            for family, knob, error, count in points
        ],
    }


def test_a_sentence_names_the_cheapest_setting_and_how_fast_it_is() -> None:
    experiment = experiment_of(
        [
            ("MuJoCo Euler", "1 ms", 5e-3, 10),
            ("MuJoCo RK4", "10 ms", 3e-5, 400),
            ("DAE RK4", "10 ms", 3e-5, 400),
            ("DAE DOP853", "rtol 1e-9", 2e-8, 900),
            ("DAE Radau", "rtol 1e-9", None, 5),
        ]
    )
    walls = [0.1, 0.5, 0.25, 1.0, 0.01]
    timing = [{"real_time_factor": 10 / wall} for wall in walls]
    reported = {one["tolerance"]: one["text"] for one in advising.advice(experiment, walls, timing)}
    assert reported[1e-2] == "for 1e-2 m use MuJoCo Euler, 1 ms: 100 x real time"
    assert reported[1e-4] == "for 1e-4 m use DAE RK4, 10 ms: 40 x real time; in MuJoCo RK4, 10 ms: 20 x real time"
    assert reported[1e-7] == "for 1e-7 m use DAE DOP853, rtol 1e-9: 10 x real time"
    assert reported[1e-8] == "for 1e-8 m: no setting of this sweep; the best is DAE DOP853, rtol 1e-9 with 2.1e-8 m"
    counts = [one["evaluations"] for one in experiment["points"]]
    reported = {one["tolerance"]: one["text"] for one in advising.advice(experiment, counts)}
    assert reported[1e-4] == "for 1e-4 m use MuJoCo RK4, 10 ms: 400 right-hand sides"


@settings(derandomize=True, deadline=None)
@given(
    st.lists(st.tuples(st.one_of(st.none(), st.floats(1e-12, 1.0)), st.integers(1, 1000)), min_size=1, max_size=12),
    st.floats(1e-12, 1e-1),
)
def test_what_is_recommended_completed_and_is_good_enough_even_if_the_reference_is_off(
    drawn: list[tuple[float | None, int]], own: float
) -> None:
    families = ("MuJoCo Euler", "DAE RK4", "ODE DOP853")
    experiment = experiment_of(
        [(families[n % 3], f"{n} ms", error, count) for n, (error, count) in enumerate(drawn)], own
    )
    counts = [count for _, count in drawn]
    for reported in advising.advice(experiment, counts):
        if reported["point"] is None:
            assert not any(error is not None and error + own <= reported["tolerance"] for error, _ in drawn)
            continue
        error, count = drawn[reported["point"]]
        assert error is not None
        assert error + own <= reported["tolerance"]
        assert count == min(c for e, c in drawn if e is not None and e + own <= reported["tolerance"])
        # The alternative in MuJoCo, where one is named, is as good.
        if "; in MuJoCo" in reported["text"]:
            named = reported["text"].partition("; in MuJoCo Euler, ")[2].partition(" ms")[0]
            other = drawn[int(named)][0]
            assert other is not None
            assert other + own <= reported["tolerance"]


def test_below_the_references_own_error_the_front_has_one_point_the_cheapest() -> None:
    from tensegrity_mj.studies.tradeoff.advising import result_of

    options = TradeoffOptions(engines=["mujoco"], steps=[0.02, 0.01, 0.005])
    chosen = settings_of(spring_experiment(), options)[:3]
    costs_and_errors = [(1.0, 1e-3), (2.0, 5e-7), (4.0, 1e-7)]
    records = [
        [
            {"status": "completed", "reason": "", "error": error, "final_error": error, "steps": 1, "memory": 1}
            | {"evaluations": int(cost), "simulated": DURATION, "timing": {"wall_time": cost}}
        ]
        for cost, error in costs_and_errors
    ]
    reported = {
        "engine": "one",
        "own_error": 1e-6,
        "looser": None,
        "second_formulation": None,
        "motion": 0.2,
        "reason": "",
    }
    experiment = spring_experiment()
    motion = Motion(np.zeros(1), experiment.scene.nodes0[None])
    values, timing = result_of(experiment, reference.Reference(motion, reported), None, chosen, records)
    assert values["by_right_hand_sides"]["front"] == [0, 1]
    assert timing["front"] == [0, 1]
    assert [one["at_reference_floor"] for one in values["points"]] == [False, True, True]
    reported["own_error"] = 1e-9
    values, timing = result_of(experiment, reference.Reference(motion, reported), None, chosen, records)
    assert values["by_right_hand_sides"]["front"] == timing["front"] == [0, 1, 2]


def test_long_runs_are_timed_less_often() -> None:
    from tensegrity_mj.studies.tradeoff.study import _again

    experiment, chosen = spring_experiment(), TradeoffOptions(budget=1000.0, repeats=5)

    def times(evaluations: int, status: str = "completed") -> int:
        first = {"status": status, "evaluations": evaluations}
        return 1 + sum(_again(experiment, first, number, chosen) for number in range(1, 5))

    # Two strings: a right-hand side weighs 2, so that 125 and 500 are a quarter of the budget and all of it.
    assert [times(count) for count in (1, 125, 126, 500, 501)] == [5, 5, 2, 2, 1]
    assert times(1, "diverged") == 1


@pytest.mark.parametrize(
    ("own", "taken"),
    [((1e-3, 0, 0), 2.0), ((3e-3, 1e-9, 0), 0.2), ((math.inf, 1.0, 1e-3), 0.02), ((math.inf, 1.0, 0.5), 0.02)],
)
def test_an_open_loop_is_shortened_until_its_reference_means_something(
    own: tuple[float, ...], taken: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    from tensegrity_mj.studies.tradeoff import study as module

    errors = iter(own)
    moving = Motion(np.array([0.0, 1.0]), np.stack([np.zeros((1, 3)), np.full((1, 3), START)]))

    def reported(experiment: Experiment, *_: Any) -> reference.Reference:
        error = next(errors)
        motion = moving if math.isfinite(error) else None
        return reference.Reference(motion, {"own_error": error if motion else None, "motion": START})

    monkeypatch.setattr(module, "_reference", reported)
    experiment, _ = module._shortened(spring_experiment(), TradeoffOptions(), None)  # type: ignore[arg-type]
    assert experiment.duration == taken
    assert ("Shortened from 2 s" in experiment.note) == (taken < 2)


def test_without_a_reference_or_a_run_the_sentence_has_the_reason() -> None:
    experiment = experiment_of([("MuJoCo RK4", "30 ms", None, 1)])
    experiment["points"][0]["reason"] = "30 ms does not divide 1 s"
    (reported,) = advising.advice(experiment, [1])
    assert reported["text"] == "for 1e-2 m: no setting completed (30 ms does not divide 1 s)"
    long = tradeoff(spring_scene(), options=TradeoffOptions(loops=[Loop.OPEN], duration=1e9, repeats=1))
    (text,) = long.sentences
    assert text.startswith("open loop: no reference: the run would record")


def short_study(scene: Any, duration: float, **changes: Any) -> Any:
    options = {"engines": ["mujoco"], "families": ["RK4"], "periods": [], "repeats": 1, "budget": 1e4} | changes
    return tradeoff(scene, options=TradeoffOptions(duration=duration, **options))


def test_advice_of_a_short_run_says_that_it_is_short_and_that_nothing_touched() -> None:
    """prism_drop falls 0.3 m, for 0.25 s, before its first foot touches."""
    free = short_study("prism_drop", 0.02)
    assert free.data["experiments"][0]["reference"]["touches"] == 0
    assert free.sentences[0].startswith("open loop: for 1e-3 m use MuJoCo RK4")
    assert free.sentences[-2] == "Runs are 0.02 s long, the scene's 3 s: what is advised holds for the short ones."
    assert free.sentences[-1].startswith("Nothing touches anything within 0.02 s: this is advice for free flight")
    scene = tmj.load_scene("prism_drop")
    low = scene.with_(initial_nodes=scene.nodes0 - [0, 0, 0.2999], duration=0.02)  # lands at once, at its full length
    landed = short_study(low, 0.02)
    assert landed.data["experiments"][0]["reference"]["touches"] > 0
    assert not any("touches" in text or "long" in text for text in landed.sentences)
    law = short_study("tbar", 0.1)
    assert law.data["experiments"][0]["reference"]["touches"] is None
    # One sentence for both loops.
    assert [text for text in law.sentences if "touches" in text or "Runs are" in text] == law.sentences[-1:]


def test_a_run_in_which_nothing_moves_yet_says_so() -> None:
    # g t²/2 in 1e-7 s: 5e-14 m, a part of 1e-13 of its size; closed loops move even less.
    (text,) = short_study("prism_drop", 1e-7).sentences
    assert text.startswith("open loop: no reference: without a law nothing moves by more than ")
    assert text.endswith(
        " m in 1e-07 s, so that there is no error to measure: run longer, or start where something moves"
    )
    study = short_study("pinned_rod", 1e-9, loops=[Loop.CLOSED])
    assert study.sentences[0].startswith("closed loop, law at every stage: no node moves by more than ")
    assert study.sentences[0].endswith(
        "no accuracy to choose a setting for: run longer, or start where something moves"
    )


def test_steps_that_no_run_can_have_are_refused() -> None:
    with pytest.raises(OptionError, match=r"steps = 0.001: runs of 0.02 s are recorded each 0.0002 s.*or run longer"):
        short_study("prism_drop", 0.02, steps=[1e-3])


def test_the_reference_is_part_of_every_bound() -> None:
    experiment = experiment_of([("MuJoCo RK4", "1 ms", 6e-4, 10)], own=5e-4)
    reported = {one["tolerance"]: one["point"] for one in advising.advice(experiment, [10])}
    assert reported == {1e-2: 0, 1e-3: None}


# ------------------------------------------------------------------------------------------------------ the command


def test_the_commands_words_are_those_of_the_enums() -> None:
    assert choices_of("tradeoff", "--loops") == [one.value for one in Loop]
    for name, option in (("tradeoff", "--actuations"), ("run", "--actuation")):
        assert choices_of(name, option) == [one.value.replace(" ", "-") for one in Mode]


def test_the_command_writes_what_it_says(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["tradeoff", "tbar", "--engines", "mujoco", "--families", "RK4", "--steps", "0.01", "0.002"]
    arguments += ["--duration", "1", "--repeats", "1", "--out", str(tmp_path / "out")]
    assert main([*arguments, "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    (scene,) = data["scenes"]
    assert scene["scene"]["name"] == "tbar"
    assert [one["knob"] for one in scene["experiments"][0]["points"]] == ["10 ms", "2 ms"]
    assert sorted(path.name for path in (tmp_path / "out" / "tbar").iterdir()) == [
        "runs",
        "tradeoff.html",
        "tradeoff.json",
        "tradeoff.png",
    ]
    assert main(arguments) == 0
    assert "open loop: for 1e-2 m use MuJoCo RK4" in capsys.readouterr().out
    assert main(["tradeoff", "tbar", "tbar"]) == 2
