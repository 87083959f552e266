"""What `validate` judges, by which quantity, and what it does not judge: no run that grows or is doubtful is good.

A mass m = 2 kg between two strings of k = 18 N/m moves by ẍ = -(2 k/m) x. Rest lengths L0 + g dL/dt make of it
m ẍ = -2 k (x - g ẋ): amplitudes follow e^(σ t) with σ = k g/m = 9 g, and energies e^(2 σ t).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import tensegrity_mj as tmj
from tensegrity_mj.runs.judgement import combined, doubts, growth
from tensegrity_mj.studies.validation import findings, judging, study
from tensegrity_mj.studies.validation.sections import Extent

HERE = tmj.studies.Workers(backend=tmj.studies.Backend.THIS_PROCESS)
PUMPS, CALMS = 0.08, -0.08  # s: σ = ±0.72/s


def swing(start: float = 0.01, velocity: float = 0.0, target: bool = False, **strings: Any) -> tmj.Scene:
    """The mass between its two strings, 2 m long; the target is the middle."""
    structure = tmj.Structure(
        "swing",
        {"m": (0.0, 0.0, 0.0), "left": (-1.0, 0.0, 0.0), "right": (1.0, 0.0, 0.0)},
        strings=tuple(tmj.String(f"{n}", ("m", n), 18.0, rest_length=0.5, **strings) for n in ("left", "right")),
        fixed_nodes=("left", "right"),
        point_masses=(tmj.PointMass("m", 2.0),),
    )
    nodes, velocities = structure.positions.copy(), np.zeros((3, 3))
    nodes[0, 0], velocities[0, 0] = start, velocity
    aim = tmj.Target.set_point(structure.positions) if target else None
    return tmj.Scene(structure, initial_nodes=nodes, initial_velocities=velocities, target=aim)


class Rates:
    """Rest lengths that follow the strings' rates."""

    command = tmj.Command.REST_LENGTH

    def __init__(self, scene: tmj.Scene, gain: float) -> None:
        self.structure, self.gain = scene.structure, gain

    def __call__(self, time: float, nodes: Any, velocities: Any) -> Any:
        return self.structure.rest_lengths + self.gain * self.structure.string_rates(nodes, velocities)


def validated(scene: tmj.Scene, gain: float, **options: Any) -> Any:
    chosen = {"engines": ["mujoco"], "sections": ["mass"], "duration": 6.0, "timestep": 5e-3, "control_period": 5e-3}
    law = Rates(scene, gain)
    return tmj.studies.validate(scene, law, quick=True, workers=HERE, **(chosen | options))


def marks(report: Any) -> list[str]:
    return [one.mark.value for one in report.judgement.findings]


def nominal(report: Any) -> Any:
    return report.data["nominal"]["engines"]["mujoco"]


@pytest.mark.parametrize("scene", [swing(), swing(0.0, 0.01, target=True)], ids=["no target", "target"])
def test_a_law_that_pumps_energy_is_bad_with_and_without_a_target(scene: tmj.Scene) -> None:
    # From 10 mm: energies grow by e^(2 σ 6 s / 4) = 8.7 in the last quarter, and 10 mm e^(σ 6 s) = 0.75 m is beyond
    # what strings of 0.5 m bear; from 10 mm/s, 2.4 mm at first, 0.18 m.
    report = validated(scene, PUMPS, duration=5.0)
    assert nominal(report)["outcome"] == "grows"
    judged = nominal(report)["judgement"]
    assert judged["word"] == "bad"
    assert "the energy since the start grows" in judged["reason"]
    assert marks(report) == ["bad", "not judged"]
    assert not any(word in " ".join(report.summary) for word in ("onverges", "olerates", "ood"))
    assert "does not do what it is meant to" in report.judgement.verdict


@pytest.mark.parametrize("engine", [tmj.DAE, tmj.ODE])
def test_a_law_that_drives_on_without_end_is_given_up(engine: Any) -> None:
    """Its steps shrink without end. Strings of 18 N/m stretched by 2 m hold 72 J, and 100 times that ends it.

    The rest lengths 0.5 m + g dL/dt are ten sizes below zero, -20 m, from 41 m/s on for g = 0.5 s, with 1.7 kJ.
    """
    with pytest.raises(tmj.errors.DivergenceError, match="the law drives the structure on: it moves with") as stopped:
        tmj.simulate(swing(), Rates(swing(), 0.5), engine(), duration=10.0)
    run = stopped.value.trajectory
    assert isinstance(run, tmj.Trajectory)
    assert run.time[-1] < 9.0


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("engine", [tmj.MuJoCo(), tmj.DAE(method="rk4", timestep=1e-3)], ids=["mujoco", "dae"])
def test_no_number_of_a_run_is_beyond_what_mujoco_has(engine: Any) -> None:
    """A push of 1e12 N on 2 kg gives 1e12 m/s sin(ω t)/2ω, ω² = 18/s²: 9.99e9 m/s after 20 ms, 1.049e10 after 21."""
    pushed = swing().with_(loads=[tmj.model.Load("m", (0.0, 0.0, 1e12))])
    with pytest.raises(tmj.errors.DivergenceError, match=r"beyond 1e.10 m or m/s") as stopped:
        tmj.simulate(pushed, None, engine, duration=0.1, output_interval=1e-3)
    run = stopped.value.trajectory
    assert isinstance(run, tmj.Trajectory)
    assert run.time[-1] == pytest.approx(0.02, abs=1e-9)


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_what_overflows_is_an_error_and_no_warning() -> None:
    """Past 1e154 squares overflow: rates by 1e160 s, in the law itself and in SciPy's norms of errors."""
    for engine in (tmj.MuJoCo(), tmj.DAE(), tmj.DAE(method="rk4", timestep=1e-3), tmj.ODE()):
        with pytest.raises(tmj.errors.TensegrityError, match=r"diverged|stopped|not finite"):
            tmj.simulate(swing(), Rates(swing(velocity=1.0), 1e160), engine, duration=1.0)
    report = validated(swing(velocity=1.0), 1e160, sections=["nominal"], duration=0.5)
    assert marks(report)[0] == "bad"


def test_a_law_that_calms_is_judged_against_rest_and_what_is_off_against_the_nominal_run() -> None:
    report = validated(swing(), CALMS)
    judged = nominal(report)["judgement"]
    assert nominal(report)["outcome"] == "at rest"
    # Speeds follow e^(σ t): in the last quarter at most e^(-0.72 · 4.5) = 3.9 % of the first amplitude, of which the
    # largest speed, at a quarter of a period of 1.48 s, is at least e^(-0.72 · 0.37) = 77 %: 5.1 % at most.
    assert judged["word"] == "good"
    assert judged["value"] <= judged["bound"] == pytest.approx(0.05 * nominal(report)["rest"]["largest_speed"])
    assert {one["outcome"] for one in report.data["mass"]["mujoco"]["rows"]} <= {"at rest", "still moving"}
    assert report.judgement.verdict.startswith("Rates brings swing in MuJoCo to rest")


@pytest.mark.parametrize(
    ("scene", "duration", "why"),
    [
        (swing(), 2.0, "the scene has no target, and the run does not come to rest"),
        (swing(0.0), 2.0, "the scene has no target, and nothing moves"),
        (swing(0.001, target=True), 2.0, "the law never moves a winch"),
    ],
    ids=["swings", "stands", "target"],
)
def test_a_law_that_does_nothing_is_not_judged(scene: tmj.Scene, duration: float, why: str) -> None:
    # 1 mm from the target is within the 5 % of 1 mm at the end of a period only by chance: judged where it ends there.
    report = validated(scene, 0.0, duration=duration)
    judged = nominal(report)["judgement"]
    if scene.target is None or nominal(report)["outcome"] == "converged":
        assert judged["word"] == "not judged"
        assert why in judged["reason"]
    assert judged["word"] != "good"
    assert marks(report)[1] == "not judged"


@pytest.mark.parametrize("acts", [True, False])
@pytest.mark.parametrize("target", [True, False])
def test_no_law_is_praised_for_where_a_run_ends_without_it(target: bool, acts: bool) -> None:
    """The same run, at its target or at rest, is the law's merit only where it moved a winch."""
    values = {"status": "completed", "growth": [], "doubts": [], "acts": acts}
    values |= {"error": {"final": 0.01} if target else None, "arrival": {"speed": 0.0, "alignment": []}}
    values |= {"rest": {"last_speed": 0.0, "largest_speed": 1.0, "moved": 0.1}}
    outcome, found = judging.judged(values, 0.05, 1.0)
    assert found.word == ("good" if acts else "not judged")
    assert ("the law never moves a winch" in found.reason) == (not acts)
    assert outcome == ("converged" if target else "at rest" if acts else "completed")


@pytest.mark.parametrize(("moved", "moves"), [(0.9e-6, False), (1.1e-6, True)])
def test_what_moves_by_less_than_a_millionth_of_its_size_does_not_move(moved: float, moves: bool) -> None:
    values = {"status": "completed", "growth": [], "doubts": [], "error": None, "acts": True}
    values |= {"rest": {"last_speed": 0.0, "largest_speed": 1e-6, "moved": moved}}
    outcome, found = judging.judged(values, 1e-3, 1.0)
    assert outcome == ("at rest" if moves else "completed")
    assert ("nothing moves" in found.reason) == (not moves)


def test_a_run_that_warned_or_reached_a_limit_is_limited() -> None:
    calm = {"start": 0.01, "target": True}
    # Rest lengths fall by up to 0.08 s · 10 mm · 4.24/s = 3.4 mm at first. A limit that lets them fall by 1 mm takes at
    # most half of the damping, until amplitudes are 2.9 mm (after 3.5 s at most); e^(-0.72 · 4.5) of them are left.
    report = validated(swing(**calm, min_rest_length=0.499), CALMS, sections=["nominal"], duration=8.0)
    assert nominal(report)["outcome"] == "converged"
    assert nominal(report)["judgement"]["word"] == "limited"
    assert "min_rest_length is reached by left, right" in nominal(report)["judgement"]["reason"]
    assert "with a doubt" in report.judgement.verdict
    free = validated(swing(**calm), CALMS, sections=["nominal"])
    assert nominal(free)["judgement"]["word"] == "good"


def test_doubts_are_all_that_a_run_reports() -> None:
    scene = swing()
    run = tmj.simulate(scene, Rates(scene, CALMS), tmj.MuJoCo(5e-3), duration=2.0)
    assert doubts(run) == []
    run.reports["warnings"].append("the law assumes gravity (0, 0, 1), the scene has none")
    run.reports["stability"] = {"step": 5e-3, "exceeded": True}
    assert doubts(run) == [run.reports["warnings"][0], "the step of 5 ms is beyond the largest stable one"]
    assert doubts(run, of_the_law=False) == ["the step of 5 ms is beyond the largest stable one"]
    heavy = tmj.load_scene("prism").with_(gravity=(0.0, 0.0, -0.1))
    told = tmj.simulate(heavy, tmj.controllers.from_scene(tmj.load_scene("prism")), tmj.MuJoCo(5e-3), duration=0.5)
    assert told.reports["warnings"]  # of gravity and V that the law does not know, in the words that are left out
    assert doubts(told, of_the_law=False) == []


def test_growth_is_more_than_a_constant_force_makes() -> None:
    # A free mass that falls: distances and energies go with t², 16/9 in the last quarter.
    scene = swing().with_(gravity=(0.0, 0.0, -1.0), breaks=[tmj.model.Break(n, 0.0) for n in ("left", "right")])
    fallen = tmj.simulate(scene, None, tmj.MuJoCo(5e-3), duration=2.0)
    assert fallen.nodes[-1, 0, 2] < -1.0
    assert growth(fallen) == []
    # Amplitudes of 1 mm e^(0.72 · 8) = 0.32 m, e^(0.72 · 2) = 4.2 times in the last quarter.
    pumped = tmj.simulate(swing(0.001), Rates(swing(), PUMPS), tmj.MuJoCo(5e-3), duration=8.0)
    assert [text.split(" grows")[0] for text in growth(pumped)] == [
        "the energy since the start",
        "the distance from the start",
    ]


def test_words_are_combined_without_praise() -> None:
    assert combined(["good", "good"]) == "good"
    assert combined(["good", "not judged"]) == combined(["bad", "good"]) == "limited"
    assert combined(["not judged"]) == combined([]) == "not judged"
    assert combined(["bad", "bad"]) == "bad"


def test_a_start_that_was_refused_is_counted_apart() -> None:
    # Rods 20 mm above a floor: starts that are turned by a radian and moved by their length are partly in it.
    scene = tmj.load_scene("prism")
    scene = scene.with_(contact=tmj.model.Contact(floor=scene.nodes0[:, 2].min() - 0.02))
    extent = Extent(amplitudes=(1.0,), starts=4)
    report = tmj.studies.validate(
        scene, lambda t, n, v: np.full(12, 5.0), extent=extent, sections=["starts"], duration=0.05, workers=HERE
    )
    part = report.data["starts"]["mujoco"]
    refused = [one for one in part["rows"] if one["outcome"] == "refused"]
    assert refused
    assert {one["judgement"]["word"] for one in refused} == {"not judged"}
    assert "inside the floor" in refused[0]["message"]
    (fraction,) = part["fractions"]
    assert fraction["judged"] == 4 - len(refused)
    assert any("not judged" in sentence or "none is judged" in sentence for sentence in report.summary)


def test_engines_that_disagree_are_a_doubt() -> None:
    values = {
        "status": "completed",
        "error": {"final": 0.01},
        "arrival": {"speed": 0.0, "alignment": []},
        "doubts": [],
        "growth": [],
        "acts": True,
    }
    assert judging.judged(values, 0.05, 1.0)[1].word == "good"
    found = judging.judged(values, 0.05, 1.0, more=["DAE: diverged"])[1]
    assert (found.word, found.reason) == ("limited", "DAE: diverged")
    assert found.text == "limited: the distance from the target at the end is 10 mm (allowed 50 mm); DAE: diverged"


@pytest.mark.parametrize(
    ("apart", "other", "words"),
    [
        (0.04, "converged", []),
        (0.06, "converged", ["the DAE is 60 mm away, more than 50 mm"]),
        (math.nan, "converged", ["the DAE is – away, more than 50 mm"]),
        (0.04, "diverged", ["the DAE: diverged"]),
        (0.04, "refused", []),
    ],
)
def test_engines_disagree_by_their_ends_and_by_the_tolerance(apart: float, other: str, words: list[str]) -> None:
    """Nodes that are 40 mm apart agree within 50 mm, and an engine that refuses its start says nothing."""
    found = {"mujoco": {"outcome": "converged"}, "dae": {"outcome": other}}
    differences = [{"engines": ["mujoco", "dae"], "node_error": apart}]
    doubts = findings._disagreements("mujoco", found, differences, 0.05)
    assert [text.lower() for text in doubts] == [text.removeprefix("the ").lower() for text in words]


def test_a_page_has_no_empty_panels() -> None:
    """Starts of which none is judged, and settling times of runs without a target."""
    fractions = [{"amplitude": 0.1, "converged": None}]
    starts = {"mujoco": {"rows": [{"amplitude": 0.1}], "fractions": fractions}}
    assert not list(study.of_section("starts", {"starts": starts}))
    row = {"gain": "decay_rate", "settling_10": None, "peak_force_density": 3.0}
    gains = {"mujoco": {"rows": [row | {"factor": factor} for factor in (0.5, 2.0)]}}
    (drawn,) = study.of_section("gains", {"gains": gains})
    assert [panel.get_ylabel() for panel in drawn.figure.axes] == ["peak u [N/m]"]
    for one in gains["mujoco"]["rows"]:
        one["peak_force_density"] = None
    assert not list(study.of_section("gains", {"gains": gains}))
