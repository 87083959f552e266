"""The study of extremes: what is drawn, how it is judged, that it sees what is wrong, and that it repeats."""

from __future__ import annotations

import itertools
import json
import math
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_words import choices_of
from engine_accelerations import dae_accelerations

import tensegrity_mj as tmj
from evidence.drift import conservative
from evidence.extremes import laws, naive, task
from evidence.extremes.experiment import Experiment
from evidence.extremes.kinds import Kind
from evidence.extremes.pace import mobility, pace
from evidence.extremes.references import reference_of, tight_dae
from evidence.extremes.setups import ENGINES, Attempt, Setup, attempt, caught, draw_setup
from evidence.extremes.study import conclusions, extremes, mixture
from evidence.extremes.verdicts import (
    Judgement,
    Verdict,
    has_kinks,
    is_hidden,
    judge_end,
    judge_error,
    lacks,
)
from evidence.random_structures import random_structure
from tensegrity_mj.cli import main
from tensegrity_mj.errors import ControllerError, DivergenceError, OptionError, StructureError
from tensegrity_mj.model.actuation import Mode
from tensegrity_mj.runs.convergence import Estimate, way_of
from tensegrity_mj.studies.workers import Backend, Workers

HERE = Workers(backend=Backend.THIS_PROCESS)
CHEAP = [kind for kind in Kind if kind not in (Kind.LARGE, Kind.LONG)]


@pytest.fixture(scope="module")
def run() -> tmj.Trajectory:
    """A good run of 0.5 s, in which the nodes move by some millimetres."""
    return tmj.simulate(tmj.load_scene("tbar"), None, tmj.DAE(), duration=0.5)


def ended(result: tmj.Trajectory | None = None, error: BaseException | None = None, *warned: str) -> Attempt:
    return Attempt(result, error, warned)


# Draws -------------------------------------------------------------------------------------------


def drawn(kind: Kind, count: int = 12) -> list[Experiment]:
    found = []
    for number in range(count):
        try:
            found.append(kind.draw(np.random.default_rng([5, number])))
        except tmj.TensegrityError as problem:  # as a user would meet it
            message = str(problem)
            assert not lacks(message, on_the_way=False)
            assert kind is Kind.VANISHING
    return found


def gaps(experiment: Experiment) -> Any:
    structure = experiment.scene.structure
    return structure.rest_lengths - structure.string_lengths(structure.positions)


def test_each_kind_is_what_it_says() -> None:
    assert max(one.scene.structure.stiffness.max() for one in drawn(Kind.STIFF, 40)) > 1e8
    assert all(np.all(gaps(one) > 0) for one in drawn(Kind.SLACK))
    assert all(np.allclose(gaps(one), 0, atol=1e-12) for one in drawn(Kind.NO_PRESTRESS))
    # L0 = L (1 - u/k) with u >= k.
    assert all(np.all(one.law(1.0).u >= one.scene.structure.stiffness) for one in drawn(Kind.NEGATIVE_REST))
    for one in drawn(Kind.VANISHING):
        structure = one.scene.structure
        tiny = structure.string_lengths(one.scene.nodes0).min() <= 1e-2
        assert tiny or one.facts["how"] == "passing by"
    for one in drawn(Kind.POLE):
        structure = one.scene.structure
        b = np.diff(structure.positions[structure.rod_nodes], axis=1)[:, 0] / structure.rod_lengths[:, None]
        # Displaced starts turn a rod by 0.05 at most; the tilt itself is up to 0.3.
        assert np.linalg.norm(b[0, :2]) <= math.sin(0.3) + 1e-9
    for one in drawn(Kind.DEGENERATE):
        nodes = one.scene.structure.positions
        rank = np.linalg.svd(nodes - nodes[0], compute_uv=False) > 1e-9
        assert rank.sum() <= (1 if one.facts["shape"] == "collinear" else 2)
        assert all(rod.support.plane is None for rod in one.scene.structure.rods)
    for one in drawn(Kind.CONTRAST):
        structure = one.scene.structure
        np.testing.assert_allclose([structure.rod_lengths.min(), structure.rod_lengths.max()], [1e-3, 1e3], rtol=1e-9)
        np.testing.assert_allclose([structure.rod_masses.min(), structure.rod_masses.max()], [1e-3, 1e3], rtol=1e-9)
    for one in drawn(Kind.SPIN):
        assert not one.scene.structure.fixed_nodes
        assert all(not rod.support.directions for rod in one.scene.structure.rods)
    joined = drawn(Kind.JOINED, 24)
    assert all(one.scene.structure.class_number > 1 for one in joined)
    assert {bool(one.facts["loops"]) for one in joined} == {True, False}
    assert {one.scene.structure.rods[0].support.plane is None for one in joined} == {True, False}
    moved = drawn(Kind.MOVED, 24)
    assert all(one.scene.motions for one in moved)
    assert {one.scene.structure.class_number > 1 for one in moved} == {True, False}
    resisted = [one.scene.resistance for one in drawn(Kind.RESISTED, 24)]
    assert all(one is not None and (one.viscous or one.bending or one.drag) for one in resisted)
    assert {one.bending is None for one in resisted if one is not None} == {True, False}
    assert all(one.scene.contact is not None for one in drawn(Kind.CONTACT))
    for kind in (Kind.PAST_LIMIT, Kind.MEMBER_PAST_LIMIT):
        assert {bool(one.excess and one.excess > 1) for one in drawn(kind)} == {True, False}
    assert all(len(one.scene.structure.strings[-1].nodes) >= 3 for one in drawn(Kind.THREADED))
    assert all(one.scene.structure.ropes for one in drawn(Kind.MASSIVE))
    bars = [one.scene.structure.rod_stiffness[0] for one in drawn(Kind.ELASTIC, 40)]
    assert min(bars) < 1e3
    assert 1e7 < max(bars) < math.inf
    curved = [string for one in drawn(Kind.CURVED, 24) for string in one.scene.structure.strings]
    assert {(string.is_constant, string.yields) for string in curved} == {(True, False), (False, True), (False, False)}
    pieces = [(string.stiffness, *string.curve) for string in curved if string.curve]
    slopes = [(b[1] - a[1]) / (b[0] - a[0]) / k for k, a, b in pieces]
    assert min(slopes) < 1e-2
    assert max(slopes) > 1e2
    masses = [one.scene.structure.bodies[0].mass for one in drawn(Kind.BODY, 40)]
    assert min(masses) < 1e-2
    assert max(masses) > 1e2
    assert {len(one.scene.structure.constraints) for one in drawn(Kind.CONSTRAINED, 24)} == {1, 2, 3}
    carried = [one.scene.structure for one in drawn(Kind.CARRIED, 24)]
    assert all(rod.masses for structure in carried for rod in structure.rods)
    assert {any(point.damping for point in structure.point_masses) for structure in carried} == {True, False}
    assert drawn(Kind.LONG, 1)[0].steps == 10**6


def test_landings_land() -> None:
    touched = 0
    for number in range(12):
        setup = draw_setup(np.random.default_rng([6, number]), Kind.CONTACT)
        found = attempt(setup, tmj.MuJoCo(setup.duration / 640)).run
        touched += found is not None and has_kinks(found) and max(found.reports["contact"]["touching"]) > 0
    assert touched >= 9


def test_every_kind_has_runs_of_many_engines() -> None:
    engines = {kind: set() for kind in CHEAP}
    for number, kind in enumerate(CHEAP * 12):
        try:
            engines[kind].add(draw_setup(np.random.default_rng([1, number]), kind).engine)
        except tmj.TensegrityError:
            continue
    assert set().union(*engines.values()) == set(ENGINES)
    assert min(len(found) for found in engines.values()) >= 4


def test_steps_divide_what_they_must() -> None:
    # With four times the step too, outputs and samples fall on steps: Grid.of refuses anything else.
    for number in range(12):
        setup = draw_setup(np.random.default_rng([2, number]), Kind.WILD_LAW)
        if setup.fixed:
            result = attempt(setup, setup.engine_at(4 * setup.step))
            assert not isinstance(result.error, OptionError)


MEMBERS = (Kind.ELASTIC, Kind.CURVED, Kind.BODY, Kind.CONSTRAINED, Kind.CARRIED)


def test_engines_are_those_that_take_the_scene() -> None:
    ode, implicit = {"ode rk4", "ode dop853"}, {"implicitfast", "implicit", "discrete"}
    refused = {Kind.ELASTIC: ode, Kind.BODY: ode, Kind.CONSTRAINED: ode | implicit}
    for kind in MEMBERS:
        engines = {draw_setup(np.random.default_rng([8, number]), kind).engine for number in range(40)}
        assert engines == set(ENGINES) - refused.get(kind, set())


@pytest.mark.slow
@pytest.mark.parametrize("kind", MEMBERS, ids=lambda kind: kind.name.lower())
def test_runs_of_new_members_are_held_against_another_formulation(kind: Kind) -> None:
    """Expect none wrong without a warning or stopped without need, and most right: within their own error bound."""
    found = [task.run_extreme({"kind": kind.name, "number": n, "seed": 12, "autoreset": False}) for n in range(2)]
    verdicts = [one["verdict"] for one in found]
    assert set(verdicts) <= {"right", "warned", "stopped"}, [one["cause"] for one in found]
    assert "right" in verdicts
    assert not any(one.get("false refusal") for one in found)


@pytest.mark.parametrize("kind", MEMBERS, ids=lambda kind: kind.name.lower())
def test_a_member_that_an_engine_has_wrong_shows(kind: Kind, monkeypatch: pytest.MonkeyPatch) -> None:
    """A run whose member is wrong by a tenth converges smoothly, and only the other formulation shows it."""

    def wrong(structure: tmj.Structure) -> tmj.Structure:
        rods = [replace(rod, masses=tuple(replace(m, mass=1.1 * m.mass) for m in rod.masses)) for rod in structure.rods]
        rods = [rod if rod.stiffness is None else replace(rod, stiffness=1.1 * rod.stiffness) for rod in rods]
        bodies = tuple(body.times(1.1) for body in structure.bodies)
        strings = tuple(
            replace(one, curve=tuple((s, 1.1 * T) for s, T in one.curve), stiffness=None) if one.curve else one
            for one in structure.strings
        )
        return replace(structure, rods=tuple(rods), bodies=bodies, strings=strings, constraints=())

    for number in range(40):
        point = {"kind": kind.name, "number": number, "seed": 12, "autoreset": False}
        setup = draw_setup(np.random.default_rng([12, number]), kind)
        if setup.experiment.law is None and task.run_extreme(point)["verdict"] == "right":
            break
    scene = setup.experiment.scene

    def attempted(one: Setup, level: Any) -> Attempt:
        other = scene.with_(structure=wrong(scene.structure))
        return attempt(replace(one, experiment=replace(one.experiment, scene=other)), level)

    monkeypatch.setattr(task, "attempt", attempted)
    assert task.run_extreme(point)["verdict"] == "undetected"


def test_the_mixture_has_few_expensive_runs_and_all_others_in_turn() -> None:
    kinds = mixture(1000, list(Kind))
    assert len(kinds) == 1000
    assert [kinds.count(kind) for kind in (Kind.LONG, Kind.LARGE)] == [4, 4]
    counts = [kinds.count(kind) for kind in CHEAP]
    assert max(counts) - min(counts) <= 1


# Pace of a scene -------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(8))
def test_the_mobility_is_what_the_engine_does_with_forces(seed: int) -> None:
    # From rest, without gravity and with slack strings, v̇ = W f: the DAE's own accelerations under that load.
    rng = np.random.default_rng([3, seed])
    structure = random_structure(rng, stretch=(-0.5, -0.1), own_planes=0.5, point_masses=1, planar=bool(seed % 2))
    forces = rng.normal(size=(len(structure.nodes), 3))
    scene = tmj.Scene(
        structure,
        loads=tuple(
            tmj.model.Load(name, tuple(force)) for name, force in zip(structure.nodes, forces.tolist(), strict=True)
        ),
    )
    ours = (mobility(structure, structure.positions) @ forces.ravel()).reshape(-1, 3)
    # Solutions of systems with condition numbers of some hundreds, in round-off.
    np.testing.assert_allclose(ours, dae_accelerations(scene), atol=1e-11 * np.abs(ours).max())


def test_the_pace_of_an_oscillator() -> None:
    # A mass between two strings along x: ω² = 2 k / m along, and less across; λ = 2 c / m.
    k, c, m = 50.0, 3.0, 2.0
    structure = tmj.Structure(
        "oscillator",
        {"left": (-1, 0, 0), "right": (1, 0, 0), "m": (0, 0, 0)},
        strings=tuple(tmj.String(end, (end, "m"), k, c, rest_length=0.9) for end in ("left", "right")),
        fixed_nodes=("left", "right"),
        point_masses=(tmj.PointMass("m", m),),
    )
    found = pace(tmj.Scene(structure))
    assert found.vibration == pytest.approx(math.sqrt(2 * k / m), rel=1e-12)
    assert found.decay == pytest.approx(2 * c / m, rel=1e-12)
    assert found.fastest == found.vibration
    # Across, a law's u pulls as a spring of that stiffness: u = 400 beats k = 50.
    assert pace(tmj.Scene(structure), 400.0).vibration == pytest.approx(math.sqrt(800 / m), rel=1e-12)


def test_the_pace_has_nodal_dampers_and_the_steepest_of_a_curve() -> None:
    # A mass on a string whose slope grows from 50 to 800 N/m, and a damper of 6 N s/m on it: ω² = 800 / m, λ = 6 / m.
    structure = tmj.Structure(
        "damped",
        {"hook": (0, 0, 0), "m": (1, 0, 0)},
        strings=(tmj.String("s", ("hook", "m"), curve=((0.1, 5.0), (0.2, 85.0))),),
        fixed_nodes=("hook",),
        point_masses=(tmj.PointMass("m", 2.0, damping=6.0),),
    )
    found = pace(tmj.Scene(structure))
    assert found.vibration == pytest.approx(math.sqrt(800 / 2.0), rel=1e-12)
    assert found.decay == pytest.approx(6.0 / 2.0, rel=1e-12)


def test_the_pace_of_a_large_structure_is_close_to_exact(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = tmj.Scene(random_structure(np.random.default_rng(4), rods=12, strings=30, stretch=(0.01, 0.2)))
    exact = pace(scene)
    monkeypatch.setattr("evidence.extremes.pace.DENSE", 0)
    # A hundred steps of the power method: a few percent, from below as the matrix is similar to a symmetric one
    # (its norm-based quotient may exceed it by as much).
    assert pace(scene).vibration == pytest.approx(exact.vibration, rel=0.1)


# Judgement of a run -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("message", "on_the_way", "missing"),
    [
        ("diverged by t = 0.5 s: rod 'a' has 3 times its length; reduce the time step", True, ""),
        ("diverged: rod 'a' has 3 times its length; reduce the time step", True, "a time"),
        ("at t = 1e-05 s something went wrong with rod 'a'", True, "a remedy"),
        ("stiffness = -1; it must be > 0", False, ""),
        ("bad structure; use another", False, "an item or a value"),
        ("string 'x' has length 0", False, "a remedy"),
        ("bad", True, "a time, an item or a value, a remedy"),
    ],
)
def test_what_a_message_must_have(message: str, on_the_way: bool, missing: str) -> None:
    assert lacks(message, on_the_way) == missing


def test_verdicts_on_how_a_run_ended(run: tmj.Trajectory) -> None:
    def verdict(one: Attempt) -> Verdict | None:
        judgement = judge_end(one, 0.5)
        return judgement and judgement.verdict

    good = "t = 0.2 s: energy came from nowhere: 3 J; reduce the time step"
    assert verdict(ended(run)) is None
    assert verdict(ended(error=ZeroDivisionError("division by zero; use t = 1 s"))) is Verdict.UNDETECTED
    assert verdict(ended(error=DivergenceError(good, 0.2))) is Verdict.STOPPED
    assert verdict(ended(error=DivergenceError("energy; reduce the step", 0.2))) is Verdict.UNDETECTED
    assert (
        verdict(ended(error=ControllerError("near t = 0 s: the law returned nan; it must be finite")))
        is Verdict.STOPPED
    )
    assert verdict(ended(error=StructureError("mass = 0; it must be > 0 kg"))) is Verdict.REFUSED
    assert verdict(ended(error=StructureError("bad mass"))) is Verdict.UNDETECTED
    assert verdict(ended(replace(run, status=tmj.Status.INFEASIBLE, message=good))) is Verdict.STOPPED
    assert verdict(ended(replace(run, status=tmj.Status.INFEASIBLE, message="no"))) is Verdict.UNDETECTED
    # Silent ends: NaN in what was recorded, a run that is shorter than requested, time that jumps back.
    tensions = run.tensions.copy()
    tensions[3, 0] = np.nan
    assert verdict(ended(replace(run, tensions=tensions))) is Verdict.UNDETECTED
    assert verdict(ended(run.until(10))) is Verdict.UNDETECTED
    time = run.time.copy()
    time[5] = time[3]
    assert verdict(ended(replace(run, time=time))) is Verdict.UNDETECTED
    # NaN is what a law without such a report has.
    assert np.all(np.isnan(run.lyapunov))


def test_verdicts_on_errors(run: tmj.Trajectory) -> None:
    way = float(np.linalg.norm(run.nodes - run.nodes[0], axis=-1).max())
    small = Estimate(1e-3 * way, True, "")

    def verdict(estimate: Estimate, error: float, doubt: float = 0.0, *warned: str) -> Verdict:
        return judge_error(ended(run, None, *warned), estimate, error, doubt).verdict

    assert verdict(small, 0.9e-3 * way) is Verdict.RIGHT
    assert verdict(small, 1.1e-3 * way) is Verdict.UNDETECTED
    assert verdict(small, 1.1e-3 * way, 0.2e-3 * way) is Verdict.RIGHT  # the reference may be that far off
    assert verdict(small, 4e-3 * way, 1.5e-3 * way) is Verdict.UNDETECTED  # more than both together
    assert verdict(small, 4e-3 * way, 2.5e-3 * way) is Verdict.UNJUDGED
    assert verdict(small, math.nan, math.nan) is Verdict.UNJUDGED
    assert verdict(small, math.inf) is Verdict.UNDETECTED  # the reference ended otherwise
    # A warning counts where a run would be wrong; one that is right stays right.
    assert verdict(small, 1.1e-3 * way, 0.0, "the energy balance is off") is Verdict.WARNED
    assert verdict(small, math.nan, math.nan, "the energy balance is off") is Verdict.WARNED
    assert verdict(small, 0.9e-3 * way, 0.0, "the step is beyond the limit") is Verdict.RIGHT
    assert verdict(Estimate(1e-9, False, "differences do not fall"), 1.0) is Verdict.WARNED
    assert verdict(Estimate(0.06 * way, True, ""), 0.01 * way) is Verdict.WARNED  # more than 5 % of the way
    # Without the estimate nobody would have said anything.
    assert is_hidden(ended(run), 0.06 * way, 0.0)
    assert not is_hidden(ended(run), 0.04 * way, 0.0)
    assert not is_hidden(ended(run), 0.06 * way, 0.02 * way)
    assert not is_hidden(ended(run, None, "a warning"), 0.06 * way, 0.0)


def test_a_touch_is_a_kink(run: tmj.Trajectory) -> None:
    taut = replace(run, tensions=np.ones_like(run.tensions))
    assert not has_kinks(taut)
    assert not has_kinks(replace(taut, reports={"contact": {"touching": [0, 0]}}))
    assert has_kinks(replace(taut, reports={"contact": {"touching": [0, 1]}}))


def test_what_a_script_of_ones_own_cannot_do_is_not_made_by_hand() -> None:
    kinds = ((Kind.JOINED, True), (Kind.MOVED, False), (Kind.CONTACT, True), (Kind.BODY, True))
    for kind, can in (*kinds, (Kind.CONSTRAINED, False), (Kind.CURVED, False)):
        setups = [draw_setup(np.random.default_rng([1, number]), kind) for number in range(30)]
        assert {naive.applies(one) for one in setups if not one.engine.startswith(("dae", "ode"))} == {can}


def test_a_string_that_lets_go_is_a_kink(run: tmj.Trajectory) -> None:
    tensions = np.ones_like(run.tensions)
    assert not has_kinks(replace(run, tensions=tensions))
    assert not has_kinks(replace(run, tensions=0 * tensions))
    tensions[2, 0] = 0
    # Where a damper would push a string has no tension, for any command of the law.
    assert has_kinks(replace(run, tensions=tensions, force_densities=np.ones_like(run.force_densities)))


def test_what_a_run_raises_and_says_is_kept() -> None:
    import warnings

    def warned() -> tmj.Trajectory:
        warnings.warn("beyond the limit", UserWarning, stacklevel=1)
        warnings.warn("MuJoCo: inertia", RuntimeWarning, stacklevel=1)
        warnings.warn("overflow in multiply", RuntimeWarning, stacklevel=1)  # numpy's, not for the user
        raise KeyError("x")

    result = caught(warned)
    assert isinstance(result.error, KeyError)
    assert result.warned == ("beyond the limit", "MuJoCo: inertia")


def test_only_stops_that_the_remedy_does_not_mend_are_refusals_without_need(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn_setups = (draw_setup(np.random.default_rng([1, number]), Kind.SLACK) for number in range(20))
    setup = next(one for one in drawn_setups if one.engine == "rk4")
    stopped = Judgement(Verdict.STOPPED, "t = 0 s")
    assert tight_dae(setup) is not None
    assert not task._false_refusal(setup, stopped)  # a smaller step completes
    broken = Attempt(None, DivergenceError("t = 0 s", 0.0), ())
    monkeypatch.setattr(task, "attempt", lambda *_: broken)
    assert task._false_refusal(setup, stopped)
    assert not task._false_refusal(setup, Judgement(Verdict.RIGHT))
    beyond = replace(setup, experiment=replace(setup.experiment, excess=2.0))
    assert not task._false_refusal(beyond, stopped)
    monkeypatch.setattr(task, "tight_dae", lambda *_: None)
    assert not task._false_refusal(setup, stopped)


# The study -----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def study() -> Any:
    return extremes(len(CHEAP), 15, kinds=CHEAP, workers=HERE)


def test_nothing_is_undetected(study: Any) -> None:
    total = study.data["table"][-1]
    found = [one for one in study.data["results"] if one["verdict"] == "undetected"]
    assert not found
    assert total["runs"] == len(CHEAP)
    assert sum(total[verdict.value] for verdict in Verdict) == len(CHEAP)
    # A run a kind: the shares that the whole study must have are for a thousand.
    assert total["right"] >= 0.4 * len(CHEAP)


def test_a_run_repeats_bit_by_bit_on_its_own(study: Any) -> None:
    for number in (0, 9, 16, 22):
        one = study.data["results"][number]
        point = {"kind": one["kind"], "number": number, "seed": 15, "autoreset": False}
        again = {"number": number, **task.run_extreme(point)}
        assert json.dumps(again, sort_keys=True, default=str) == json.dumps(one, sort_keys=True, default=str)


def by_engine_and_by_hand(kind: Kind, wanted: Callable[[Setup], bool], count: int) -> tuple[Any, Any]:
    """The first runs of a kind that are wanted, in MuJoCo, as rows of a study without and with --autoreset."""
    numbers = []
    for number in range(100):
        setup = draw_setup(np.random.default_rng([0, number]), kind)
        if naive.applies(setup) and wanted(setup):
            numbers.append(number)
        if len(numbers) == count:
            break
    points = [{"kind": kind.name, "number": number, "seed": 0} for number in numbers]
    return tuple([task.run_extreme(point | {"autoreset": by_hand}) for point in points] for by_hand in (False, True))


def test_with_autoreset_silent_resets_are_counted() -> None:
    # The test of the test: the same runs, once by the engine and once as by a script of one's own.
    ours, by_hand = by_engine_and_by_hand(Kind.PAST_LIMIT, lambda setup: (setup.experiment.excess or 0) > 5, 6)
    assert {one["verdict"] for one in ours} <= {"stopped", "warned"}
    silent = [one for one in by_hand if "its times do not go to the end" in one["cause"]]
    assert len(silent) >= 3
    assert conclusions(ours, [Kind.PAST_LIMIT])["table"][-1]["undetected"] == 0
    assert conclusions(by_hand, [Kind.PAST_LIMIT])["table"][-1]["undetected"] >= len(silent)
    assert not conclusions(by_hand, [Kind.PAST_LIMIT])["passed"]


@pytest.mark.parametrize(("mistake", "cause"), [("NaN for all", "off by inf m"), ("a text", "a traceback: ")])
def test_with_autoreset_nonsense_of_a_law_is_counted(mistake: str, cause: str) -> None:
    # MuJoCo takes NaN for zero, without a word; a text ends in numpy's words.
    ours, by_hand = by_engine_and_by_hand(Kind.BAD_LAW, lambda one: one.experiment.facts["mistake"] == mistake, 1)
    assert [one["verdict"] for one in ours] == ["stopped"]
    assert [one["verdict"] for one in by_hand] == ["undetected"]
    assert cause in by_hand[0]["cause"]


def test_with_autoreset_resets_of_joined_rods_are_counted() -> None:
    """Trees and loops at 20 times their limit: a script of one's own says nothing of its resets, the engine does."""
    silent = 0
    for number in range(30):
        setup = draw_setup(np.random.default_rng([4, number]), Kind.JOINED)
        if setup.experiment.law is not None or setup.engine not in ("euler", "rk4"):
            continue
        step = 20 * tmj.stable_step(setup.experiment.scene, setup.engine_at(1e-3)).limit
        fast = replace(setup, step=step, duration=320 * step)
        found = judge_end(naive.attempt(fast, fast.engine_at(step)), fast.duration)
        silent += found is not None and "its times do not go to the end" in found.cause
        ours = attempt(fast, fast.engine_at(step))
        assert ours.warned
        assert ours.run is None or ours.run.status is not tmj.Status.COMPLETED or ours.run.time[-1] > 319 * step
    assert silent > 0


def test_a_reset_behind_ones_back_shows() -> None:
    # At three times the stable step MuJoCo's state leaves the finite world and is put back to the start, unnoticed.
    scene = conservative(tmj.load_scene("prism"), 0)
    here = pace(scene)
    step = 3 * 2.0 / here.vibration
    setup = Setup(Kind.PAST_LIMIT, Experiment(scene, excess=3.0), "euler", step, 1e-6, 320 * step, here, here.fastest)
    engine = setup.engine_at(step)
    by_hand, ours = naive.attempt(setup, engine), attempt(setup, engine)
    assert by_hand.run is not None
    assert by_hand.run.time[-1] < setup.duration
    np.testing.assert_array_equal(by_hand.run.nodes[0], ours.error.trajectory.nodes[0])  # type: ignore[union-attr]
    silent, stopped = judge_end(by_hand, setup.duration), judge_end(ours, setup.duration)
    assert silent is not None
    assert silent.verdict is Verdict.UNDETECTED
    assert stopped is not None
    assert stopped.verdict is Verdict.STOPPED


def test_a_stable_loop_by_hand_is_as_good_as_the_engine() -> None:
    # The test of the test counts the loop's silence, not its own mistakes.
    scene = conservative(tmj.load_scene("prism"), 0)
    here = pace(scene)
    step = 0.1 / here.vibration
    setup = Setup(Kind.PAST_LIMIT, Experiment(scene), "euler", step, 1e-6, 320 * step, here, here.fastest)
    by_hand, ours = naive.attempt(setup, setup.engine_at(step)), attempt(setup, setup.engine_at(step))
    assert by_hand.run is not None
    assert ours.run is not None
    assert judge_end(by_hand, setup.duration) is None
    np.testing.assert_array_equal(by_hand.run.nodes, ours.run.nodes)


def test_nobody_may_complete_where_the_law_returns_nonsense() -> None:
    drawn_setups = (draw_setup(np.random.default_rng([1, number]), Kind.BAD_LAW) for number in range(20))
    setup = next(one for one in drawn_setups if one.experiment.facts["mistake"] == "NaN for all")
    reference = tight_dae(setup)
    assert reference is not None
    assert not reference.completed
    good = replace(setup, experiment=replace(setup.experiment, law=None, mode=Mode.CONTINUOUS))
    assert task._distance(attempt(good, tmj.DAE()), reference) == (math.inf, 0.0)


def setups_of(engine: str, kind: Kind = Kind.SLACK) -> Iterator[tuple[dict[str, Any], Setup]]:
    """Runs of a kind without a law by an engine whose name begins so: each as a point of a study, and in full."""
    for number in range(200):
        setup = draw_setup(np.random.default_rng([9, number]), kind)
        if setup.engine.startswith(engine) and setup.experiment.law is None:
            yield {"kind": kind.name, "number": number, "seed": 9, "autoreset": False}, setup


def test_a_mass_that_swings_through_its_anchor_does_not_claim_too_much() -> None:
    """Its string is slack for 20 mm of the way, between two samples; differences looked like an order of 3."""
    found = task.run_extreme({"kind": "VANISHING", "number": 760, "seed": 5, "autoreset": False})
    assert found["verdict"] in ("right", "warned")
    assert found["error"] < found["bound"]


@pytest.mark.parametrize(
    ("engine", "other"), [("dae rk4", "ODE"), ("dae dop853", "ODE"), ("rk4", "DAE"), ("euler", "DAE"), ("ode", "DAE")]
)
def test_a_reference_is_of_another_formulation_and_reports_its_doubt(engine: str, other: str) -> None:
    _, setup = next(setups_of(engine, Kind.SPIN))
    reference = reference_of(setup)
    assert reference is not None
    assert reference.run is not None
    assert reference.run.engine.startswith(other)
    assert 0 < reference.doubt < 1e-4 * way_of(reference.run.nodes)


@pytest.mark.parametrize("engine", ["dae rk4", "rk4", "ode dop853"])
def test_a_formulation_that_is_wrong_at_every_step_shows(engine: str, monkeypatch: pytest.MonkeyPatch) -> None:
    # An engine that takes strings for twice as stiff converges, and only another formulation can show it; where its own
    # estimate does not settle at the tolerance that was drawn, the run is warned of.
    right = (one for one in setups_of(engine, Kind.STIFF) if task.run_extreme(one[0])["verdict"] == "right")
    points = [point for point, _ in itertools.islice(right, 2)]

    def wrong(one: Setup, level: Any) -> Attempt:
        true = one.experiment.scene
        stiffer = true.with_(structure=true.structure.with_strings(stiffness=2 * true.structure.stiffness))
        return attempt(replace(one, experiment=replace(one.experiment, scene=stiffer)), level)

    monkeypatch.setattr(task, "attempt", wrong)
    verdicts = {task.run_extreme(point)["verdict"] for point in points}
    assert "undetected" in verdicts <= {"undetected", "warned"}


def test_the_estimate_of_a_run_with_kinks_claims_no_high_order(
    run: tmj.Trajectory, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Runs that differ by 1e-5 m and then by 1e-6 m: an order of log2(10), by which the last is wrong by a ninth of the
    # last difference, times 1.25. With kinks it is by twice the geometric mean of both, 2 √(1e-5 · 1e-6) = 6.3e-6 m.
    _, setup = next(setups_of("rk4"))

    def estimate(one: Setup, own: tmj.Trajectory, *gaps: float) -> Estimate:
        coarser = [replace(own, nodes=own.nodes + np.array([0, 0, sum(gaps[k:])])) for k in range(2)]
        runs = iter(coarser)
        monkeypatch.setattr(task, "attempt", lambda *_: ended(next(runs)))
        return task._estimate(one, ended(own))

    smooth = replace(run, tensions=np.ones_like(run.tensions), force_densities=np.ones_like(run.force_densities))
    kinks = np.ones_like(run.tensions)
    kinks[3, 0] = 0.0
    assert estimate(setup, smooth, 1e-5, 1e-6).value == pytest.approx(1.25e-6 / 9, rel=1e-2)
    kinked = estimate(setup, replace(smooth, tensions=kinks), 1e-5, 1e-6)
    assert kinked.value == pytest.approx(2 * math.sqrt(1e-11), rel=1e-6)
    # Nor where the coarsest run is off by more than a thousandth of the way.
    far = 2e-3 * way_of(smooth.nodes)
    assert estimate(setup, smooth, far, far / 16).value == pytest.approx(2 * far / 4, rel=1e-6)
    # Tolerances that make the very same steps: no less than the tolerance is claimed.
    _, adaptive = next(setups_of("dae dop853"))
    extent = float(np.abs(smooth.nodes).max())
    assert estimate(adaptive, smooth, 0.0, 0.0).value >= adaptive.tolerance * extent
    # Differences that do not fall settle nothing, and a run that fails with twice the step neither.
    assert not estimate(setup, smooth, 1e-5, 1e-5).settled
    monkeypatch.setattr(task, "attempt", lambda *_: ended(None, DivergenceError("t = 0 s", 0.0)))
    assert not task._estimate(setup, ended(smooth)).settled


def test_a_failed_task_is_counted_as_undetected() -> None:
    results = [{"kind": "SLACK", "engine": "rk4", "verdict": "right"}] * 9
    good = conclusions(results, [Kind.SLACK])
    assert good["passed"]
    assert not conclusions([*results, {**results[0], "verdict": "undetected"}], [Kind.SLACK])["passed"]
    assert not conclusions([*results, {**results[0], "false refusal": True}], [Kind.SLACK])["passed"]  # 10 %
    assert not conclusions([*results, *[{**results[0], "verdict": "warned"}] * 7], [Kind.SLACK])["passed"]  # 9 of 16
    from evidence.extremes.study import _lost

    died = _lost({"status": "failed", "error": "WorkerDied", "reason": "no memory"})
    assert died["verdict"] == "undetected"


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert [kind.name.lower() for kind in Kind] == choices_of("audit extremes", "--kinds")
    out = tmp_path / "study"
    words = "audit extremes --runs 4 --kinds spin bad_law --workers 1 --json --out"
    arguments = [*words.split(), str(out)]
    assert main(arguments) == 0
    reported = json.loads(capsys.readouterr().out)
    assert reported.pop("timing")["seconds"] > 0
    assert json.loads((out / "extremes.json").read_text()) == reported
    first = (out / "extremes.json").read_bytes()
    page = (out / "extremes.html").read_text()
    assert Kind.SPIN.value in page
    assert "it must return" in page  # the cause of a stop
    # Of two spins, right, and two bad laws, stopped: nothing is wrong, and fewer than 60 % are right.
    assert '<p class="verdict">None of 4 extreme runs was wrong without a warning; 2 were right.</p>' in page
    assert re.findall(r'class="mark (\w+)', page) == ["limited", "good", "good"]
    assert main(arguments) == 0  # all is there already
    assert (out / "extremes.json").read_bytes() == first
    capsys.readouterr()
    assert main(["audit", "extremes", "--runs", "0"]) == 2
    assert main(["audit", "extremes", "--seed", "-1"]) == 2
    assert main(["audit", "extremes", "--workers", "0"]) == 2


# Results of the study ------------------------------------------------------------------------------------


def flail(reach: float) -> tmj.Scene:
    """A free rod that turns at 3 rad/s, and a string to one end that is taut only while this end is farthest."""
    structure = tmj.Structure(
        "flail",
        {"a": (1.0, 0.0, 0.0), "b": (0.0, 0.0, 0.0), "anchor": (3.0, 0.0, 0.0)},
        rods=(tmj.Rod("rod", ("a", "b"), 1.0),),
        strings=(tmj.String("string", ("a", "anchor"), 100.0, rest_length=reach),),
        fixed_nodes=("anchor",),
    )
    return tmj.Scene(structure, initial_velocities=np.array([[0, 1.5, 0], [0, -1.5, 0], [0, 0, 0]], float))


@pytest.mark.parametrize("reach", [2.9, 2.999])
@pytest.mark.parametrize(
    "engine",
    [
        tmj.ODE(rtol=1e-6, atol=1e-8),
        tmj.ODE(),
        tmj.ODE(method=tmj.Method.RADAU, rtol=1e-6, atol=1e-8),
        tmj.DAE(rtol=1e-6, atol=1e-8),
    ],
    ids=str,
)
def test_a_moments_pull_is_not_stepped_over(engine: Any, reach: float) -> None:
    # Between the pulls the ODE's coordinates move evenly, so that its steps grow as long as the run: 2 s, of which the
    # string pulls for 0.2 s or 0.02 s. Stepped over, the error is 3e-3 m and more. RK4 at 2e-5 s is right to 1e-9 m.
    scene = flail(reach)
    fine = tmj.simulate(scene, None, tmj.DAE(method=tmj.Method.RK4, timestep=2e-5), duration=2.0, output_interval=0.5)
    run = tmj.simulate(scene, None, engine, duration=2.0, output_interval=0.5)
    # Local errors of rtol = 1e-6 where steps are cut by kinks: some tens of steps, each of 1e-6 of a metre or less.
    assert np.abs(run.nodes - fine.nodes).max() < 3e-5
    assert run.cost["steps"] < 500


def test_a_law_that_raises_has_an_error_that_names_what_it_must_do() -> None:
    law = laws.GoesWrong(np.full(3, 0.03), "an exception", 0.1)
    with pytest.raises(ControllerError) as caught_error:
        tmj.simulate(tmj.load_scene("pinned_rod"), law, tmj.DAE(), duration=0.5)
    assert not lacks(str(caught_error.value), on_the_way=True)
    assert "it must return 3 finite numbers" in str(caught_error.value)


@pytest.mark.parametrize("mass", [1e-3, 1e-5])
def test_a_tiny_rod_runs_in_mujoco(mass: float) -> None:
    # 1e-3 kg and 1e-3 m: 1e-5 of m ℓ²/12 = 8e-11 kg m² is below what MuJoCo takes for a moment of inertia, 1e-15.
    # Strings attach on the axis: with a moment about it of up to 1e-2 of the transverse one the motion is the same.
    structure = tmj.Structure(
        "tiny",
        {"a": (0.0, 0.0, 0.0), "b": (0.6e-3, 0.0, 0.8e-3), "f": (2e-3, 1e-3, 0.0)},
        rods=(tmj.Rod("rod", ("a", "b"), mass, 1e-5),),
        strings=(tmj.String("string", ("b", "f"), 1e3 * mass, rest_length=1e-6),),
        fixed_nodes=("f",),
    )
    scene = tmj.Scene(structure)
    # ω is at most √(4 k / m) = 63 1/s: h ω = 0.006, and RK4's error over ω t = 6 is 6 (0.006)⁴ / 120 of a way of 1 mm.
    runs = [tmj.simulate(scene, None, engine, duration=0.1) for engine in (tmj.MuJoCo(1e-4), tmj.DAE())]
    assert np.abs(runs[0].nodes - runs[1].nodes).max() < 1e-11
    assert np.abs(runs[1].nodes - runs[1].nodes[0]).max() > 1e-4
