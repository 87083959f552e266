"""The controller's report: of the thesis' law and of a user's own, its sections, failures, page and command."""

from __future__ import annotations

import dataclasses
import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import validated_laws
from command_words import choices_of

import tensegrity_mj as tmj
from tensegrity_mj.cli import main
from tensegrity_mj.controllers import specs
from tensegrity_mj.engines.table import installed
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.text.writing import scene_to_toml
from tensegrity_mj.studies.validation import findings, sections, study, task
from tensegrity_mj.studies.validation.judging import (
    _break_sentences,
    _delay_sentences,
    _noise_sentences,
    _plant_sentences,
    _start_sentences,
)
from tensegrity_mj.studies.validation.sections import SECTIONS, Extent

HERE = tmj.studies.Workers(backend=tmj.studies.Backend.THIS_PROCESS)
LAWS = Path(__file__).parents[1] / "helpers" / "validated_laws.py"


@pytest.fixture(scope="module")
def report(pinned_rod: Any, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Every section, in every engine; runs of 6 s with steps of 5 ms."""
    folder = tmp_path_factory.mktemp("report")
    return tmj.studies.validate(
        pinned_rod,
        folder=folder,
        quick=True,
        duration=6.0,
        timestep=5e-3,
        control_period=5e-3,
        workers=tmj.studies.Workers(2),
    )


def small(scene: Any, law: Any = tmj.controllers.SCENE_LAW, **options: Any) -> Any:
    """A report of one engine and short runs, in this process."""
    chosen = {"engines": ["mujoco"], "duration": 1.0, "timestep": 5e-3, "control_period": 5e-3, "workers": HERE}
    return tmj.studies.validate(scene, law, quick=True, **(chosen | options))


def rows(report: Any, section: str, engine: str = "mujoco") -> Any:
    return report.data[section][engine]["rows"]


# All of it ---------------------------------------------------------------------------------------------------


def test_every_section_is_there_in_every_engine(report: Any) -> None:
    data = report.data
    assert data["setup"]["engines"] == list(installed())
    assert list(data["nominal"]["engines"]) == list(installed())
    for section in SECTIONS:
        if section != "nominal":
            assert list(data[section]) == list(installed()), section
            for engine in installed():
                assert data[section][engine]["rows"], (section, engine)
                assert {one["outcome"] for one in rows(report, section, engine)} <= set(findings.OUTCOMES)
    assert not [one for section in SECTIONS for one in _failed(report, section)]


def _failed(report: Any, section: str) -> list[Any]:
    if section == "nominal":
        return [one for one in report.data["nominal"]["engines"].values() if one["outcome"] == "failed"]
    return [one for engine in installed() for one in rows(report, section, engine) if one["outcome"] == "failed"]


def test_the_nominal_run_is_that_of_simulate(report: Any, pinned_rod: Any) -> None:
    law = tmj.controllers.from_scene(pinned_rod)
    run = tmj.simulate(pinned_rod, law, tmj.MuJoCo(5e-3), duration=6.0, output_interval=5e-3)
    found = report.data["nominal"]["engines"]["mujoco"]
    assert found["error"]["final"] == pytest.approx(run.target_error()[-1], rel=1e-12)
    assert found["peaks"]["force_density"]["value"] == pytest.approx(run.max_force_density, rel=1e-12)
    assert found["margin"]["smallest"] == pytest.approx(run.min_feasibility_margin, rel=1e-12)
    assert found["lyapunov"]["promised_rate"] == 0.15
    assert found["lyapunov"]["fitted_rate"] == pytest.approx(0.15, rel=1e-6)
    # RK4 at 5 ms against an error-controlled DAE and ODE, of the fourth order where u has no kink and of the second
    # where it has one (README: 2.5e-9 m at 1 ms over 60 s, times 25).
    for one in report.data["nominal"]["differences"]:
        assert one["node_error"] < 1e-7


def test_sampling_costs_the_first_order(pinned_rod: Any) -> None:
    extent = Extent(periods=(1e-2, 5e-3, 2e-3, 1e-3))
    report = small(pinned_rod, sections=["sampling"], extent=extent, duration=2.0, timestep=1e-3)
    law = tmj.controllers.from_scene(pinned_rod)
    reference = tmj.simulate(pinned_rod, law, tmj.MuJoCo(1e-3), duration=2.0, output_interval=0.02)
    assert report.data["sampling"]["mujoco"]["reference"] == "continuous"
    for mode in (tmj.Actuation.hold_force_density, tmj.Actuation.hold_rest_length):
        own = [one for one in rows(report, "sampling") if one["mode"] == mode(1.0).mode.value]
        errors = [one["node_error"] for one in own]
        # What is held is late by half a period on average: first order.
        assert np.polyfit(np.log(extent.periods), np.log(errors), 1)[0] == pytest.approx(1.0, abs=0.1)
        run = tmj.simulate(pinned_rod, law, tmj.MuJoCo(1e-3), duration=2.0, actuation=mode(5e-3), output_interval=0.02)
        assert own[1]["node_error"] == pytest.approx(tmj.compare(run, reference).max_node_error, rel=1e-9)
    assert any("Hold force density at 5 ms costs" in sentence for sentence in report.summary)


def test_a_law_that_jumps_is_compared_with_its_finest_period(pinned_rod: Any) -> None:
    law = tmj.controllers.from_scene(pinned_rod, norm=math.inf)
    report = small(pinned_rod, law, sections=["sampling"])
    part = report.data["sampling"]["mujoco"]
    assert part["reference"] == "the finest period of the mode"
    # A run is not compared with itself.
    assert [one["node_error"] is None for one in part["rows"]] == [False, True, False, True]
    assert report.data["law"]["discontinuous"]
    assert report.data["law"]["description"]["norm"] == "inf"


# What is off -------------------------------------------------------------------------------------------------


def point(report: Any, section: str, number: int) -> Any:
    """The values that a case of a report's run folder has, as the store kept them."""
    kept = json.loads((report.folder / "runs" / "result.json").read_text())["points"]
    label = rows(report, section)[number]["label"]
    setup = _setup(report)
    case = next(one for one in sections.cases(setup, [section]) if (one.section, one.label) == (section, label))
    return case.point, next(one["outcome"]["values"] for one in kept if one["point"] == case.point)


def _setup(report: Any) -> Any:
    scene = tmj.load_scene("pinned_rod")
    law = tmj.controllers.from_scene(scene)
    return sections.Setup(scene, law, ["mujoco"], 6.0, 5e-3, 5e-3, 0, Extent.quick())


def test_a_sampled_run_has_the_longest_step_that_divides_its_period() -> None:
    setup = _setup(None)  # whose step is 5 ms
    for period, steps in ((5e-3, 1), (4e-3, 1), (1e-2, 2), (0.011, 3), (0.1, 20)):
        made = setup.sampled("dae", sections.Mode.HOLD_REST_LENGTH, period)
        assert made["period"] == period
        # A quotient of two numbers, once rounded.
        assert made["engine_options"]["timestep"] == pytest.approx(period / steps, rel=2e-16)


def test_masses_are_off_in_the_plant_alone(report: Any, pinned_rod: Any) -> None:
    rod = pinned_rod.structure.rods[0]
    _, values = point(report, "mass", 0)
    lighter = dataclasses.replace(pinned_rod.structure, rods=(dataclasses.replace(rod, mass=0.8),))
    law = tmj.controllers.from_scene(pinned_rod)  # believes in 1 kg
    run = tmj.simulate(pinned_rod.with_(structure=lighter), law, tmj.MuJoCo(5e-3), duration=6.0)
    assert values["error"]["final"] == pytest.approx(run.target_error()[-1], rel=1e-12)
    assert values["lyapunov"]["promised_rate"] is None  # V' = -δ V is a promise about the nominal plant


def test_a_stiffer_string_pulls_harder_than_commanded(report: Any, pinned_rod: Any) -> None:
    _, values = point(report, "stiffness", 1)
    nominal = report.data["nominal"]["engines"]["mujoco"]
    # At t = 0 the law commands the same u, and the string pulls k/k̂ = 1.2 times as hard.
    ratio = values["peaks"]["force_density"]["value"] / nominal["peaks"]["force_density"]["value"]
    assert ratio == pytest.approx(1.2, rel=1e-12)


def test_noise_and_delay_are_those_of_the_wrappers(report: Any, pinned_rod: Any) -> None:
    law, hold = tmj.controllers.from_scene(pinned_rod), tmj.Actuation.hold_force_density(5e-3)
    noisy = tmj.controllers.Noisy(law, 1e-3, 1e-2, 0, 5e-3)
    for section, number, wrapped in (("noise", 2, noisy), ("delay", 1, tmj.controllers.Delayed(law, 10, 5e-3))):
        run = tmj.simulate(pinned_rod, wrapped, tmj.MuJoCo(5e-3), duration=6.0, actuation=hold)
        assert rows(report, section)[number]["final_error"] == pytest.approx(run.target_error()[-1], rel=1e-12)
    for section in ("noise", "delay"):
        for one, other in zip(rows(report, section), rows(report, section, "dae"), strict=True):
            assert one["final_error"] == pytest.approx(other["final_error"], abs=1e-8)


def test_strings_break_and_gravity_acts(report: Any, pinned_rod: Any) -> None:
    law = tmj.controllers.from_scene(pinned_rod)
    first = rows(report, "breaks")[0]
    assert (first["string"], first["time"]) == ("s1", pytest.approx(0.6))
    broken = pinned_rod.with_(breaks=(tmj.model.Break("s1", 0.6),))
    run = tmj.simulate(broken, law, tmj.MuJoCo(5e-3), duration=6.0)
    assert first["final_error"] == pytest.approx(run.target_error()[-1], rel=1e-12)
    heavy = pinned_rod.with_(gravity=(0.0, 0.0, -0.0981))
    for one in rows(report, "gravity"):
        known = one["known_to_the_law"]
        run = tmj.simulate(heavy, tmj.controllers.from_scene(heavy) if known else law, tmj.MuJoCo(5e-3), duration=6.0)
        assert one["final_error"] == pytest.approx(run.target_error()[-1], rel=1e-12)


def test_gains_are_scaled_and_bad_ones_are_data(pinned_rod: Any) -> None:
    extent = Extent(factors={"Z": (0.5, 1.0, 2.0)}, rates=(2.0,))
    report = small(pinned_rod, sections=["gains"], extent=extent)
    bad, same, double, faster = rows(report, "gains")
    assert bad["outcome"] == "failed"  # X - Y Z⁻¹ Yᵀ = 1 - 1/0.75 < 0
    assert "positive definite" in bad["message"]
    nominal = report.data["nominal"]["engines"]["mujoco"]
    assert same["final_error"] == nominal["error"]["final"]
    for one, options in (
        (double, {"rotation": {"X": 1.0, "Y": 1.0, "Z": 3.0}}),
        (faster, {"decay_rate": 0.3}),
    ):
        law = tmj.controllers.from_scene(pinned_rod, **options)
        run = tmj.simulate(pinned_rod, law, tmj.MuJoCo(5e-3), duration=1.0)
        assert one["final_error"] == pytest.approx(run.target_error()[-1], rel=1e-12)


def test_the_map_lays_the_laws_side_by_side(report: Any, pinned_rod: Any) -> None:
    part = report.data["starts"]["mujoco"]
    names = ["Lyapunov (under test)", "projection onto b⊥", "projection onto b_d⊥"]
    assert [one["law"] for one in part["fractions"]] == names
    directions = {name: [one["direction"] for one in part["rows"] if one["law"] == name] for name in names}
    assert directions[names[0]] == directions[names[1]] == directions[names[2]]  # the same starts
    np.testing.assert_allclose(np.linalg.norm(directions[names[0]], axis=1), 1.0)
    one = [row for row in part["rows"] if row["law"] == names[2]][1]
    law = tmj.controllers.from_scene(pinned_rod, "projection", onto="target")
    nodes = sections.turned(pinned_rod, np.array(one["direction"]))
    run = tmj.simulate(pinned_rod.with_(initial_nodes=nodes), law, tmj.MuJoCo(5e-3), duration=6.0)
    assert one["end_time"] == pytest.approx(run.time[-1])
    assert one["final_error"] == pytest.approx(run.target_error()[-1], rel=1e-12)
    assert (one["outcome"] == "infeasible") == (run.status is tmj.Status.INFEASIBLE)


def test_starts_of_other_structures_grow_apart() -> None:
    prism = tmj.load_scene("prism")
    report = small(prism, sections=["starts"], extent=Extent(amplitudes=(0.01, 0.5), starts=2), duration=0.5)
    part = report.data["starts"]["mujoco"]
    assert [one["amplitude"] for one in part["fractions"]] == [0.01, 0.5]
    assert [one["draw"] for one in part["rows"]] == [0, 1, 0, 1]
    again = small(prism, sections=["starts"], extent=Extent(amplitudes=(0.01, 0.5), starts=2), duration=0.5, seed=1)
    assert part["rows"][0]["final_error"] != again.data["starts"]["mujoco"]["rows"][0]["final_error"]


def test_fractions_and_differences_are_counted() -> None:
    outcomes = (("converged", 1e-9), ("infeasible", 1e-9), ("converged", 0.02), ("diverged", None), ("refused", None))
    made = [{"amplitude": 0.1, "outcome": one, "decay_error": error} for one, error in outcomes]
    assert findings._fractions(made) == [
        {
            "amplitude": 0.1,
            "starts": 5,
            "judged": 4,  # a start that was refused shows nothing of the law
            "converged": 0.5,
            "kept": 0.25,  # the second of those that converge left its promise
            "outcomes": {"converged": 2, "infeasible": 1, "diverged": 1, "refused": 1},
        }
    ]
    (refused,) = findings._fractions([made[-1]])
    assert refused["converged"] is None
    starts = {
        "mujoco": {"rows": [{"label": "a", "outcome": "converged"}, {"label": "b", "outcome": "converged"}]},
        "dae": {"rows": [{"label": "a", "outcome": "converged"}, {"label": "b", "outcome": "mirrored"}]},
    }
    assert findings._differing(starts) == [{"label": "b", "outcomes": {"mujoco": "converged", "dae": "mirrored"}}]


# Sentences ---------------------------------------------------------------------------------------------------


def test_the_summary_says_what_a_user_can_act_on(report: Any) -> None:
    setup = _setup(report)

    def say(maker: Any, section: str, *outcomes: str, **facts: Any) -> str:
        made = [
            {"outcome": outcome, "end_time": 1.5, "label": "x", "final_error": 0.1, "time": 0.3, "message": ""}
            | {key: values[number] for key, values in facts.items()}
            for number, outcome in enumerate(outcomes)
        ]
        return str(maker(setup, section, {"rows": made})[0])

    delay = _delay_sentences
    one_two_three = {"samples": [1, 2, 3]}
    assert say(delay, "delay", "converged", "converged", "converged", **one_two_three) == (
        "Tolerates a delay of up to 3 samples of 5 ms (more was not tried)."
    )
    assert say(delay, "delay", "converged", "infeasible", "converged", **one_two_three) == (
        "Tolerates a delay of up to 1 sample of 5 ms (infeasible at 1.5 s with more)."
    )
    assert say(delay, "delay", "diverged", "converged", "converged", **one_two_three) == (
        "Does not tolerate a delay of 1 sample of 5 ms (diverged at 1.5 s)."
    )
    breaks = _break_sentences
    assert say(breaks, "breaks", "converged", "infeasible", "mirrored", string=["s1", "s2", "s3"]) == (
        "Infeasible when s2 breaks; mirrored when s3 breaks at 0.3 s (2 of 3 strings tried)."
    )
    assert say(breaks, "breaks", "converged", "converged", string=["s1", "s2"]) == (
        "Converges whichever of the 2 strings tried breaks at 0.3 s."
    )
    assert say(_plant_sentences, "mass", "converged") == (
        "Converges with masses off by up to 20 % (final error up to 0.1 m)."
    )
    assert say(_plant_sentences, "stiffness", "diverged") == (
        "Does not tolerate stiffnesses off by 20 %: x: diverged at 1.5 s."
    )
    fractions = [
        {"law": "mine", "starts": 4, "converged": 0.5, "kept": 0.25},
        {"law": "other", "starts": 4, "converged": 1.0, "kept": None},
    ]
    assert _start_sentences(setup, "starts", {"fractions": fractions}) == [
        "Random starts that converge, of 4 each: mine: 50 % (25 % with V as promised all the way); other: 100 %.",
        "Where V leaves its promise, fixed steps of 5 ms passed a singularity of the law, or were too long for it: do "
        "not count on these starts.",
    ]
    stds = {"position_std": [1e-3, 1e-2], "velocity_std": [0.0, 0.0]}
    assert say(_noise_sentences, "noise", "converged", "off target", **stds) == (
        "Tolerates noise of positions of up to 0.001 m (off target with more)."
    )
    stds = {"position_std": [1e-3, 0.0, 1e-3, 1e-2], "velocity_std": [0.0, 1e-2, 1e-2, 1e-1]}
    rows = [{key: stds[key][i] for key in stds} | {"outcome": "converged", "end_time": 1.0} for i in range(3)]
    rows.append({key: stds[key][3] for key in stds} | {"outcome": "infeasible", "end_time": 1.5})
    assert _noise_sentences(setup, "noise", {"rows": rows}) == [
        "Tolerates noise of positions of up to 0.001 m (more was not tried).",
        "Tolerates noise of velocities of up to 0.01 m/s (more was not tried).",
        "Tolerates noise of positions and velocities together of up to 0.001 m and 0.01 m/s (infeasible at 1.5 s with "
        "more).",
    ]


def test_a_run_that_does_not_converge_does_not_set_what_converging_is(pinned_rod: Any) -> None:
    # 2 s of the 60 s that it takes: nearly all of the way of 1.5 m is left, in the nominal run and in all others.
    extent = Extent(delays=(1,), periods=(1e-2, 5e-3))
    report = small(pinned_rod, sections=["delay", "sampling"], extent=extent, duration=2.0)
    assert report.data["tolerance"] == pytest.approx(0.05 * findings.way(pinned_rod, 2.0), rel=1e-12)
    assert report.data["nominal"]["engines"]["mujoco"]["outcome"] == "still moving"
    assert [one["outcome"] for one in rows(report, "delay")] == ["still moving"]
    assert not any("olerate a delay" in sentence for sentence in report.summary)
    (unjudged,) = [sentence for sentence in report.summary if "not judged" in sentence]
    assert unjudged == (
        "Delay: not judged, because the law misses its goal even undisturbed (still moving); give it more time "
        "(--duration). The table has the runs."
    )
    assert [one.mark.value for one in report.judgement.findings] == ["limited", "good", "not judged"]
    assert any(sentence.startswith("Hold force density at 5 ms costs") for sentence in report.summary)


def test_the_map_marks_starts_whose_V_left_its_promise() -> None:
    row = {"law": "mine", "outcome": "converged", "direction": [1.0, 0.0, 0.0]}
    rows = [row | {"decay_error": error} for error in (None, 1e-9, 0.1)]
    (picture,) = study.of_section("starts", {"starts": {"mujoco": {"rows": rows}}})
    (legend,) = picture.figure.legends
    assert [text.get_text() for text in legend.get_texts()] == ["converged", "converged, V not as promised"]
    kept, left = picture.figure.axes[0].collections
    assert len(kept.get_offsets()) == 2
    assert len(left.get_offsets()) == 1
    assert len(left.get_facecolor()) == 0  # hollow


# Laws of one's own ---------------------------------------------------------------------------------------------


def test_a_python_law_that_workers_cannot_have_runs_here(pinned_rod: Any) -> None:
    calls = []

    def law(time: float, nodes: Any, velocities: Any) -> Any:
        calls.append(time)
        return validated_laws.damp(time, nodes, velocities)

    report = small(pinned_rod, law, sections=["delay"], duration=0.05, workers=None)
    assert calls
    assert report.data["law"]["from"] == "law"
    run = tmj.simulate(pinned_rod, law, tmj.MuJoCo(5e-3), duration=0.05)
    nominal = report.data["nominal"]["engines"]["mujoco"]
    assert nominal["error"]["final"] == run.target_error()[-1]
    assert nominal["lyapunov"] is None
    assert nominal["margin"] is None
    with pytest.raises(OptionError, match=r"law 'law': it exists in this process only.*path\.py:name"):
        small(pinned_rod, law, workers=tmj.studies.Workers(2))


@pytest.mark.parametrize(
    "law",
    [validated_laws.damp, "validated_laws:damp", f"{LAWS}:damp"],
    ids=["function", "module", "file"],
)
def test_a_law_that_workers_can_have_goes_to_them(pinned_rod: Any, law: Any) -> None:
    spec = specs.spec_of(law, pinned_rod)
    assert not specs.is_here(spec)
    json.dumps(spec)
    nodes, velocities = np.array(pinned_rod.nodes0), np.zeros((5, 3))
    made = specs.make(json.loads(json.dumps(spec)), pinned_rod)
    np.testing.assert_array_equal(made(0.0, nodes, velocities), validated_laws.damp(0.0, nodes, velocities))


@pytest.mark.workers
def test_a_law_from_a_file_in_worker_processes(pinned_rod: Any) -> None:
    report = small(pinned_rod, f"{LAWS}:slower", sections=["delay"], workers=tmj.studies.Workers(2))
    assert report.data["law"]["from"] == "validated_laws.py:slower"
    assert report.data["law"]["promised_rate"] == 0.1
    assert report.data["nominal"]["engines"]["mujoco"]["lyapunov"]["fitted_rate"] == pytest.approx(0.1, rel=1e-6)


def test_built_in_law_objects_are_known_by_their_options(pinned_rod: Any) -> None:
    for law in (
        tmj.controllers.Lyapunov(pinned_rod.structure, pinned_rod.target, decay_rate=0.3, norm=1),
        tmj.controllers.from_scene(pinned_rod, "projection", onto="target", rotation={"rod": {"X": 2.0}}),
    ):
        spec = specs.spec_of(law, pinned_rod)
        assert spec["kind"] == "built-in"
        again = specs.make(json.loads(json.dumps(spec)), pinned_rod)
        assert again.describe() == law.describe()
        assert np.asarray(again.evaluate(0.0, pinned_rod.nodes0, pinned_rod.velocities0)[0]).tolist() == (
            np.asarray(law.evaluate(0.0, pinned_rod.nodes0, pinned_rod.velocities0)[0]).tolist()
        )
    other = tmj.controllers.Lyapunov(pinned_rod.structure, np.array(pinned_rod.nodes0))  # another target
    assert specs.spec_of(other, pinned_rod)["kind"] == "object"
    program = tmj.controllers.Program(pinned_rod.structure, moves=[("s1", 0.0, 1.0, 0.9)])  # no dataclass
    assert specs.spec_of(program, pinned_rod)["kind"] == "object"


def test_a_margin_of_ones_own_and_a_lost_solution(pinned_rod: Any) -> None:
    report = small(pinned_rod, f"{LAWS}:Late", sections=["sampling", "noise", "gravity", "gains"], engines=["dae"])
    found = report.data["nominal"]["engines"]["dae"]
    assert found["outcome"] == "infeasible"
    assert found["end_time"] == pytest.approx(0.5)
    assert found["margin"]["smallest"] == pytest.approx(0.25)  # (t - 0.3)² + 0.25
    assert found["margin"]["time"] == pytest.approx(0.3)
    assert found["switching"]["count"] == 3  # at 0.1 s all three strings cease to pull
    assert "its time is over" in report.summary[0]
    assert all(one["outcome"] == "infeasible" for one in rows(report, "noise", "dae"))
    assert [one["known_to_the_law"] for one in rows(report, "gravity", "dae")] == [False]
    assert "gains" not in report.data


def test_a_scene_without_a_target_is_no_failure() -> None:
    report = small("tbar", lambda t, n, v: np.full(4, 1.0), sections=["mass", "starts"], duration=0.05)
    assert report.data["nominal"]["engines"]["mujoco"]["outcome"] == "completed"
    assert {one["outcome"] for one in rows(report, "mass")} == {"completed"}
    assert report.summary


@pytest.mark.parametrize(
    ("law", "words"),
    [
        ("nothing", "unknown law 'nothing'"),
        (f"{LAWS}:absent", "there is no law 'absent'"),
        (f"{LAWS}:no_law", "it must be a function"),
        ("no_such_module:law", "cannot be imported"),
        ("no_such_file.py:law", "there is no file no_such_file.py"),
        (3, "law = 3"),
        (validated_laws.Late, "it must be a law"),
    ],
)
def test_laws_that_are_none_are_refused(pinned_rod: Any, law: Any, words: str) -> None:
    with pytest.raises(OptionError, match=words):
        small(pinned_rod, law)


def test_a_file_that_fails_says_how(pinned_rod: Any, tmp_path: Path) -> None:
    path = tmp_path / "bad.py"
    path.write_text("import numpy\n1 / 0\n")
    with pytest.raises(OptionError, match=r"law bad\.py:law: the file fails: ZeroDivisionError"):
        small(pinned_rod, f"{path}:law")


def test_a_law_that_fails_is_data(pinned_rod: Any) -> None:
    def law(time: float, nodes: Any, velocities: Any) -> Any:
        return np.full(3, 0.01) if time < 0.03 else [0.01]

    report = small(pinned_rod, law, sections=["mass"], duration=0.05)
    assert "it returned shape (1,)" in report.data["nominal"]["engines"]["mujoco"]["message"]
    assert all("ControllerError" in one["message"] for one in rows(report, "mass"))
    assert "fails" in report.summary[0]


# Options, files, command ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"engines": ["abacus"]}, "engines: there is no name 'abacus'"),
        ({"engines": []}, "engines: name at least one"),
        ({"sections": ["luck"]}, "sections: there is no name 'luck'; allowed: nominal, sampling"),
        ({"timestep": 3e-3}, r"timestep = 0\.003: it must divide 0\.01 s, as 0\.005"),
        ({"control_period": 0.02}, r"control_period = 0\.02: it must divide 0\.01 s"),
        ({"duration": -1.0}, "duration = -1.0"),
        ({"seed": -1}, "seed = -1"),
    ],
)
def test_bad_options_are_refused(pinned_rod: Any, options: dict[str, Any], words: str) -> None:
    with pytest.raises(OptionError, match=words):
        tmj.studies.validate(pinned_rod, quick=True, **options)


def test_a_scene_without_a_law_needs_one() -> None:
    words = "'tbar' names no control law: .*choose one of feedback_linearization, lyapunov, program, projection"
    with pytest.raises(OptionError, match=words):
        tmj.studies.validate("tbar")


def test_the_same_call_gives_the_same_bytes_and_computes_nothing_again(
    report: Any, pinned_rod: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = (report.folder / study.DATA).read_bytes()
    options: dict[str, Any] = {"quick": True, "duration": 6.0, "timestep": 5e-3, "control_period": 5e-3}
    with monkeypatch.context() as patched:
        patched.setattr(task, "simulate", lambda *_, **__: pytest.fail("it was computed again"))
        tmj.studies.validate(pinned_rod, folder=report.folder, workers=HERE, **options)
    assert (report.folder / study.DATA).read_bytes() == before
    assert b"wall" not in before
    first, second = (
        tmj.studies.validate(
            pinned_rod, folder=tmp_path / name, workers=HERE, sections=["noise"], engines=["dae"], **options
        )
        for name in ("a", "b")
    )
    assert (tmp_path / "a" / study.DATA).read_bytes() == (tmp_path / "b" / study.DATA).read_bytes()
    assert first.data["noise"]["dae"] == report.data["noise"]["dae"] == second.data["noise"]["dae"]


def test_the_page_holds_every_section_and_loads_nothing(report: Any) -> None:
    page = (report.folder / study.PAGE).read_text(encoding="utf-8")
    for title in SECTIONS.values():
        if title != SECTIONS["nominal"]:
            assert f"{title[0].upper()}{title[1:]}</h2>" in page
    for sentence in report.summary:
        assert sentence.split("<")[0][:60] in page.replace("&#x27;", "'").replace("&lt;", "<")
    assert page.count("data:image/png") == 6  # nominal, sampling, gains, noise, delay, starts
    assert not re.search("https?:", page)  # bare "http" may stand in the pixels of a picture


def test_the_command_writes_the_report(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["validate", "pinned_rod", "--only", "delay", "--engines", "dae", "--quick", "--duration", "1"]
    arguments += ["--timestep", "5e-3", "--control-period", "5e-3", "--workers", "1", "--out", str(tmp_path)]
    assert main([*arguments, "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer == json.loads((tmp_path / study.DATA).read_text())
    assert set(answer) >= {"summary", "nominal", "delay"}
    assert main(arguments) == 0
    out = capsys.readouterr().out
    assert "Delay: not judged" in out  # 1 s of the 60 s that it takes to converge
    assert out.startswith(answer["verdict"])
    assert str(tmp_path / study.PAGE) in out
    assert main(["validate", "pinned_rod", "--seed", "-1"]) == 2
    assert main(["validate", "tbar"]) == 2


def test_choices_of_the_command_are_those_of_the_study() -> None:
    assert list(SECTIONS) == choices_of("validate", "--only")


def test_a_scene_whose_loads_are_a_function_is_refused(pinned_rod: Any) -> None:
    scene = pinned_rod.with_(loads=lambda t: np.zeros((5, 3)))
    with pytest.raises(tmj.errors.SceneError, match="Python function"):
        tmj.studies.validate(scene, quick=True)
    assert scene_to_toml(pinned_rod)
