"""Towers in waves: the scene, the deformation measure, the engines against each other, and the study."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from wave_cases import GRID, OPEN, SENSITIVITY, agreement
from wave_cases import point as point_of

import tensegrity_mj as tmj
from evidence.families.in_waves import tower_in_waves
from evidence.families.thesis_towers import PRESTRESS_MEASURES, STIFFNESSES
from evidence.pages import reproduction
from evidence.thesis.appendix_c.beams import BeamRun
from evidence.thesis.appendix_c.tower_wave_tasks import in_waves
from evidence.thesis.catalog import STATEMENTS
from evidence.thesis.chapter7.measures7 import label_of
from evidence.thesis.experiments import EngineName
from evidence.thesis.ledger import Verdict, judge
from evidence.thesis.reproduction import reproduce
from evidence.thesis.runs import Computed
from tensegrity_mj.cli import main
from tensegrity_mj.engines.table import engine_of
from tensegrity_mj.errors import OptionError
from tensegrity_mj.library.named import family_scene
from tensegrity_mj.library.tower import Axis, Topology, tower
from tensegrity_mj.model.elements.water import sea_of
from tensegrity_mj.runs.deformation import (
    centres,
    deformation,
    distances_from_line,
    interconnections,
    is_tower,
)
from tensegrity_mj.studies.sweep import Sweep
from tensegrity_mj.studies.workers import Backend, Workers

HERE = Workers(backend=Backend.THIS_PROCESS)


# The scene


def test_the_tower_lies_below_the_surface_with_its_base_towards_the_waves() -> None:
    scene = tower_in_waves()
    ends = scene.nodes0[:3].mean(axis=0), scene.nodes0[-3:].mean(axis=0)
    assert ends[0] == pytest.approx((0, 0, -1), abs=1e-6)
    assert ends[1] == pytest.approx((10.67, 0, -1), abs=0.01)  # the README of the tower
    assert not scene.velocities0.any()
    assert len(scene.structure.rods) == 45
    assert len(scene.structure.strings) == 219
    assert not any(string.damping for string in scene.structure.strings)
    sea, at = sea_of(scene), np.linspace(0.0, 15.0, 5)
    # A sin(ω t - k x): 0, -A, 0, A, 0 over a wavelength at t = 0; crests go to larger x.
    np.testing.assert_allclose(sea.elevation(0.0, at, 0 * at), [0, -0.5, 0, 0.5, 0], atol=1e-15)
    speed = math.sqrt(9.81 * 15 / (2 * math.pi))  # of crests in deep water
    assert float(sea.elevation(1.0, np.array(3.75 + speed + 7.5), np.array(0.0))) == pytest.approx(0.5)


def test_other_towers_and_other_seas() -> None:
    scene = family_scene(
        "tower_in_waves(stages=4, topology='reduced_a', wave_height=0.3, wavelength=6.0, direction=0.4, "
        "water_depth=3.0, segments=7, weights='hermite', start_depth=-0.2, current=(0.1, 0, 0))"
    )
    water = scene.water
    assert water is not None
    assert (len(scene.structure.rods), water.segments, water.weights) == (12, 7, tmj.model.Weights.HERMITE)
    assert (water.depth, water.current) == (3.0, (0.1, 0, 0))
    assert (water.waves[0].amplitude, water.waves[0].direction) == (0.15, 0.4)
    assert scene.nodes0[:3, 2].mean() == pytest.approx(0.2, abs=1e-6)
    still = tower_in_waves(stages=3, wave_height=0.0).water
    assert still is not None
    assert still.waves == ()


@pytest.mark.parametrize(
    ("given", "reported"),
    [
        ({"wave_height": -1.0}, "wave_height = -1.0; it must be >= 0 m"),
        ({"wavelength": 0.0}, "wavelength"),
        ({"weights": "stiff"}, "weights = 'stiff'"),
        ({"phase": math.nan}, "phase"),
        ({"start_depth": math.inf}, "start_depth"),
        ({"stages": 0}, "stages = 0"),
    ],
)
def test_bad_arguments_are_refused_in_words(given: dict[str, Any], reported: str) -> None:
    with pytest.raises(OptionError, match=reported):
        tower_in_waves(**given)


# The measure


def test_the_distance_is_the_least_over_the_line() -> None:
    """Against a search along each line, where distance is convex: the parameter is found to √ε, 1e-8 of its scale."""
    rng = np.random.default_rng(5)
    points = rng.normal(size=(4, 6, 3))
    found = distances_from_line(points)
    assert found.shape == (4, 6)
    for moment, distances in zip(points, found, strict=True):
        for place, distance in zip(moment, distances, strict=True):
            low, high = -50.0, 50.0
            for _ in range(200):
                left, right = low + 0.382 * (high - low), low + 0.618 * (high - low)
                far = [np.linalg.norm(moment[0] + s * (moment[-1] - moment[0]) - place) for s in (left, right)]
                low, high = (low, right) if far[0] < far[1] else (left, high)
            assert distance == pytest.approx(min(far), abs=1e-7)
        assert distances[[0, -1]] == pytest.approx((0, 0), abs=1e-12)
    # A line of no length: distances from where both ends are.
    assert distances_from_line([[1, 0, 0], [1, 2, 0], [1, 0, 0]]) == pytest.approx((0, 2, 0))


@pytest.mark.parametrize("turned", [False, True])
def test_the_measure_of_an_arc_is_its_sagitta(turned: bool) -> None:
    """The centres of a tower that is laid on an arc of radius R over an angle 2 θ: D is R (cos φ - cos θ).

    The arc is flat or turned in space, where distances stay what they were.
    """
    structure = tower(9, form_found=False).structure
    x = structure.positions[:, 0]
    groups = interconnections(structure)
    middles = np.array([x[group].mean() for group in groups])
    radius, centre = 7.0, 0.5 * (middles[0] + middles[-1])
    # Cross-sections turn with the arc, so that centres of six nodes of two levels stay on it only to second order:
    # each group is moved as a whole, by where its own centre goes.
    bent = structure.positions.copy()
    for group, at in zip(groups, middles, strict=True):
        angle = (at - centre) / radius
        bent[group] += np.array([radius * math.sin(angle), 0, radius * math.cos(angle)]) - [at, 0, 0]
    if turned:
        q, _ = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))
        bent = bent @ q.T + [1.0, -2.0, 3.0]
    half = (middles[-1] - centre) / radius
    wanted = radius * (np.cos((middles - centre) / radius) - math.cos(half))
    np.testing.assert_allclose(distances_from_line(centres(bent, groups)), wanted, atol=1e-13)
    assert wanted.max() > 0.4


def test_the_six_nodes_of_an_interconnection() -> None:
    structure = tower(4).structure
    names = structure.node_names
    assert [{names[n] for n in group} for group in interconnections(structure)] == [
        {f"t{s}_{i}" for i in (1, 2, 3)} | {f"b{s + 1}_{i}" for i in (1, 2, 3)} for s in (1, 2, 3)
    ]
    # They are a hexagon: six of one distance from their centre, in two levels.
    nodes = tower(4, form_found=False, axis=Axis.Z).nodes0
    for group in interconnections(structure):
        away = nodes[group] - nodes[group].mean(axis=0)
        assert np.hypot(away[:, 0], away[:, 1]) == pytest.approx([1.22 / math.sqrt(6)] * 6)
        angles = np.sort(np.degrees(np.arctan2(away[:, 1], away[:, 0])))
        assert np.diff(angles) == pytest.approx([60] * 5)
    for other in (tower(2), tower(3), tmj.load_scene("prism"), tmj.load_scene("planar_beam")):
        assert not is_tower(other.structure)
        with pytest.raises(OptionError, match="no tower of four stages"):
            interconnections(other.structure)
    assert is_tower(tower(4, topology=Topology.REDUCED_B).structure)


def test_rod_forces_balance_the_strings_at_the_start() -> None:
    """Expect the prestress in still water without weight, where rods carry -Σ of what statics finds."""
    scene = tower(5).with_(gravity=(0.0, 0.0, 0.0))
    run = tmj.simulate(scene, None, engine_of("dae", 1e-2), duration=0.01)
    from tensegrity_mj.statics import find_equilibrium

    np.testing.assert_allclose(run.rod_forces[0], find_equilibrium(scene).rod_forces, rtol=1e-7)
    assert deformation(run).max() < 1e-9  # straight


# Both engines


def test_engines_agree_in_waves() -> None:
    """Another tower in another sea; the limits are those of the whole tower over 5 s, see below."""
    tower_ = {"stages": 5, "wavelength": 6.0, "wave_height": 0.6, "direction": 0.7, "water_depth": 4.0}
    scene = tower_in_waves(**tower_, current=(0.2, 0.1, 0.0))
    kept: dict[str, Any] = {"duration": 1.5, "output_interval": 0.03}
    fine = tmj.simulate(scene, None, tmj.DAE(rtol=1e-10, atol=1e-12), **kept)
    errors = [
        np.linalg.norm(tmj.simulate(scene, None, engine_of("mujoco", h), **kept).nodes - fine.nodes, axis=-1).max()
        for h in (3e-3, 7.5e-4)
    ]
    assert np.abs(fine.nodes[-1] - fine.nodes[0]).max() > 0.2
    assert errors[0] < 1e-4
    assert errors[1] < 2e-6
    assert errors[1] < errors[0] / 16  # 256 for a smooth motion; where rods cross the surface, loads have corners


@pytest.mark.slow
@pytest.mark.study
@pytest.mark.parametrize("label", GRID)
def test_engines_agree_in_every_case_of_the_study(label: str) -> None:
    """The numbers that docs/waves.md has: the limits are those that the project set, and were met with room."""
    errors = agreement(GRID[label], (3e-3, 7.5e-4), 1e-10)
    assert errors[0] <= 1e-4
    assert errors[1] <= 2e-6


# The study


def test_a_point_of_the_study_reports_what_the_run_reports() -> None:
    tower_ = {"stages": 4, "radius": 0.5, "duration": 4.0}
    point = {**point_of(tower_), "transient": 2.0}
    found = in_waves(point)
    run = tmj.simulate(tower_in_waves(**tower_), None, engine_of("dae", point["timestep"]), output_interval=0.02)
    D = deformation(run)
    row, column = np.unravel_index(D.argmax(), D.shape)
    assert found["largest"] == D.max()
    assert (found["at"], found["where"]) == (run.time[row], column + 1)
    assert found["steady"] == D[run.time > 2.0].max()
    assert found["profile"] == D[run.time > 2.0].max(axis=0).tolist()
    assert found["mean_force"] == pytest.approx(-run.rod_forces.mean() / 1e3, rel=1e-14)
    assert found["mean_force"] > 0  # of compression
    assert found["period"] == pytest.approx(math.sqrt(2 * math.pi * 15 / 9.81), rel=1e-12)
    assert np.diff(found["times"][1:]) == pytest.approx([found["period"] / 3] * 2, abs=0.02)
    assert found["times"][0] == found["at"]
    np.testing.assert_array_equal(found["nodes"][0], run.nodes[row])
    with pytest.raises(OptionError, match="4 s \\(completed\\); 4 s are the transient"):
        in_waves({**point, "transient": 4.0})


def test_the_cases_are_those_of_the_thesis() -> None:
    assert len(GRID) == 9
    assert GRID["10 kN/m 0.1 m"] == {"stiffness": 1e4, "prestress_measure": 0.10}
    assert GRID["30 kN/m 0.2 m"] == {"stiffness": 3e4, "prestress_measure": 0.20}
    # Four stages each: what is checked of arguments does not depend on their number, and 15 take ten times as long.
    for tower_ in (*GRID.values(), *OPEN.values(), *SENSITIVITY.values()):
        assert tower_in_waves(**{**point_of(tower_)["tower"], "stages": 4}).water is not None


def test_a_stiffer_and_a_tighter_tower_bends_less() -> None:
    """Short towers in short waves, so that the trend is no matter of the shipped case alone."""
    sea = {"stages": 7, "wavelength": 8.0, "wave_height": 0.6, "duration": 6.0}
    D = {
        (k, p): in_waves({**point_of({**sea, "stiffness": k, "prestress_measure": p}), "transient": 1.0})["largest"]
        for k, p in ((1e4, 0.1), (3e4, 0.1), (1e4, 0.2))
    }
    assert D[3e4, 0.1] < 0.95 * D[1e4, 0.1]
    assert D[1e4, 0.2] < 0.95 * D[1e4, 0.1]


# The ledger


# [m] what the thesis' percentages make of its 1.19 and 0.49 m; the middles of the first and the last row are free.
THESIS = np.array(
    [
        [1.19, 1.0, 1.19 * (1 - 0.275)],
        [1.19 * (1 - 0.259), 1.0 * (1 - 0.275), 1.19 * (1 - 0.259) * (1 - 0.301)],
        [0.49 / (1 - 0.346), 0.6, 0.49],
    ]
)


def made_up(scale: float = 1.0) -> dict[str, BeamRun]:
    """A study whose D is the thesis', times a scale, and whose tower comes to float and repeats its motion."""
    D = {(k, p): scale * THESIS[i, j] for i, k in enumerate(STIFFNESSES) for j, p in enumerate(PRESTRESS_MEASURES)}
    time = np.linspace(0.0, 40.0, 2001)
    values = {
        label_of(k, p): {
            "largest": d,
            "steady": d,
            "mean_force": 1.45 if k == 1e4 else 8.68,
            "period": 4.0,
            "time": time,
            "D": d * np.abs(np.sin(np.pi * time / 4.0)),
            "height": np.where(time < 5, -1.0, 0.0),
            "nodes": np.array([[[0, 0, 9.0]], [[0, 0, -1.4]], [[0, 0, 0.4]], [[0, 0, 0.0]]]),
        }
        for (k, p), d in D.items()
    }
    return {"waves": BeamRun("waves", "made up", values)}


def verdicts(runs: dict[str, BeamRun]) -> dict[str, Verdict]:
    requested = [one for one in STATEMENTS if one.needs == ("waves",)]
    return {row.statement.id: row.verdict for row in judge(requested, Computed({EngineName.DAE: runs}))}


def test_rows_of_the_ledger_distinguish_the_thesis_from_what_is_not() -> None:
    assert set(verdicts(made_up()).values()) == {Verdict.REPRODUCED}
    twice = verdicts(made_up(2.0))  # percentages are the same
    assert twice["7.9-soft"] is twice["7.9-stiff"] is Verdict.UNEXPLAINED
    assert twice["7.9-stiffness-0.1"] is Verdict.REPRODUCED
    soft, stiffer, tighter = (label_of(*one) for one in ((1e4, 0.1), (2e4, 0.1), (1e4, 0.15)))
    for label, change, name, other in (
        (stiffer, {"largest": 1.2}, "7.9-falls-stiffness", "7.9-falls-prestress"),
        (tighter, {"largest": 1.2}, "7.9-falls-prestress", "7.9-falls-stiffness"),
        (soft, {"height": np.full(2001, -1.0)}, "7.2.3-cyclic", "7.9-soft"),
        (soft, {"D": np.linspace(0.0, 1.0, 2001)}, "7.2.3-cyclic", "7.9-soft"),  # by 10 % from period to period
    ):
        runs = made_up()
        runs["waves"].values[label].update(change)  # type: ignore[attr-defined]
        found = verdicts(runs)
        assert (found[name], found[other]) == (Verdict.UNEXPLAINED, Verdict.REPRODUCED)


@pytest.mark.slow
@pytest.mark.study
def test_the_study_is_what_the_doc_says(tmp_path: Path) -> None:
    made = reproduce(["7.7", "7.8", "7.9"], tmp_path, engines=[EngineName.DAE, EngineName.MUJOCO])
    assert {"7.7", "7.8", "7.9"} <= set(made.files)
    text = (Path(__file__).resolve().parents[1] / "docs" / "reproduction.md").read_text(encoding="utf-8")
    order = (EngineName.STATICS, EngineName.MUJOCO, EngineName.DAE)
    for row in made.rows:
        assert reproduction.markdown_row(row, order) in text


# The sweep over arguments of a family


def test_a_sweep_makes_the_familys_scene_anew() -> None:
    call = "tower_in_waves(stages=4, duration=0.3)"
    sweep = Sweep(
        call,
        [tmj.studies.Vary("family.stiffness", [1e4, 2e4])],
        fixed={"family.topology": "reduced_a", "scene.gravity": [0, 0, -9.0], "engine": "dae"},
    )
    study = sweep.run(workers=HERE)
    assert not study.failed
    for point, deformed, late, force in zip(
        study.points, *map(study.values, ("deformation", "late_deformation", "mean_rod_force")), strict=True
    ):
        k = point["parameters"]["family.stiffness"]
        scene = tower_in_waves(k, stages=4, topology=Topology.REDUCED_A, duration=0.3).with_(gravity=(0, 0, -9.0))
        run = tmj.simulate(scene, None, tmj.DAE())
        assert deformed == deformation(run).max()
        assert late == deformation(run)[run.time >= 0.225].max()
        assert force == run.rod_forces.mean()
    forces = study.values("mean_rod_force")
    assert forces[1] == pytest.approx(2 * forces[0], rel=0.05)  # the same form, strings twice as stiff, and some water
    assert Sweep("prism", fixed={"scene.duration": 0.1}).run(workers=HERE).values("deformation") == [None]


@pytest.mark.parametrize(
    ("scene", "path", "value", "reported"),
    [
        ("tower(stages=3)", "family.stage", 3, "unknown argument 'stage'"),
        ("tower(stages=3)", "family.stages", 0, "stages = 0"),
        ("tower(stages=3)", "family.topology", "some", "topology = 'some'"),
        ("tower(stages=3)", "family.stiffness", tmj.studies.Scaled(2), "take values, not factors"),
        ("tower(stages=3)", "family", 2, "family: name one of its arguments"),
        ("prism", "family.stiffness", 2.0, "scene 'prism' is not given by a call of a family"),
    ],
)
def test_arguments_that_mean_nothing_are_refused_before_anything_runs(
    scene: str, path: str, value: Any, reported: str
) -> None:
    with pytest.raises(OptionError, match=reported):
        Sweep(scene, fixed={path: value})


def test_the_study_of_another_tower_from_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    call = "tower_in_waves(stages=3, wavelength=5.0, wave_height=0.4, duration=0.2)"
    words = [
        *("sweep", call, "--vary", "family.prestress_measure=0.1,0.15", "--vary", "family.radius=0.45,0.5"),
        *("--set", "engine=dae", "--set", "engine.method=rk4", "--set", "engine.timestep=5e-3"),
        *("--measures", "deformation,late_deformation,mean_rod_force", "--backend", "this-process"),
    ]
    assert main([*words, "--out", str(tmp_path / "study")]) == 0
    assert "late deformation" in capsys.readouterr().out
    result = json.loads((tmp_path / "study" / "result.json").read_text())
    assert [point["outcome"]["status"] for point in result["points"]] == ["done"] * 4
    assert "late_deformation" in (tmp_path / "study" / "index.html").read_text()
