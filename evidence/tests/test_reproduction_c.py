"""Appendix C and §7.2.3's form-finding in the ledger: studies, measures, rows and figures. The whole of C is slow."""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ledger_lines import lines_of

from evidence.families.thesis_towers import TABLE_C2
from evidence.pages import reproduction
from evidence.thesis.appendix_c import beam_tasks, beams, measures_c
from evidence.thesis.appendix_c.beams import BY_PRESTRESS, STUDIES, BeamRun
from evidence.thesis.catalog import FIGURES, STATEMENTS
from evidence.thesis.chapter3.series import SERIES
from evidence.thesis.experiments import EXPERIMENTS, EngineName
from evidence.thesis.ledger import Verdict, judge
from evidence.thesis.reproduction import WHOLES, compute_runs, reproduce
from evidence.thesis.runs import Computed
from tensegrity_mj.errors import OptionError
from tensegrity_mj.statics import Hold, follow
from tensegrity_mj.studies.workers import Backend, Workers

DOC = Path(__file__).resolve().parents[1] / "docs" / "reproduction.md"
HERE = Workers(backend=Backend.THIS_PROCESS)
BOTH = (EngineName.STATICS, EngineName.MUJOCO)


@cache
def found(beam: str) -> dict[str, Any]:
    return beam_tasks.found({"beam": beam})


def path_run(**values: Any) -> BeamRun:
    """A run of one beam "x", made up."""
    count = len(values["w"])
    filled = {"F": [0.0] * count, "turned": [False] * count, "least": [1.0] * count, **values}
    return BeamRun("made up", "statics", {"x": filled})


BEAMS = tuple(STUDIES["tension"].points)
STATIC = {name for name, one in STUDIES.items() if not one.sources}  # those that beam_tasks computes


# ------------------------------------------------------------------------------------------------------- the lists


def test_names_differ_and_all_studies_are_needed() -> None:
    assert not STUDIES.keys() & (EXPERIMENTS.keys() | SERIES.keys())
    assert set(STUDIES) <= {name for one in STATEMENTS for name in one.needs}
    assert set(BEAMS) == {*TABLE_C2, "TB6*", "TB7*"}


def test_rows_stand_beside_the_engines_that_know_of_them() -> None:
    one = next(row for row in STATEMENTS if row.id == "C.3-TB1-initial")
    assert (one.chapter, one.columns, one.figure) == ("C", BOTH, "C.3")
    with pytest.raises(OptionError, match=r"none of dae computes C\.3"):
        reproduce(["C.3"], engines=[EngineName.DAE])


# ---------------------------------------------------------------------------------------------------- made-up paths


def test_buckling_is_where_half_of_the_stiffness_is_left() -> None:
    """K = 10, 9, 3 at w = 0, 1, 2: 5 is two thirds of the way from 9 to 3."""
    run = path_run(w=[0.0, 1.0, 2.0], K=[10e3, 9e3, 3e3], F=[0.0, 9e3, 12e3])
    assert measures_c.buckling(run, "x") == pytest.approx((1 + 2 / 3, 11.0))
    assert measures_c.stiffest_before(run, "x") == 10.0


def test_a_path_that_turns_back_has_buckled_before_it() -> None:
    run = path_run(w=[0.0, 1.0, 0.9], K=[10e3, 9e3, 40e3], F=[0.0, 9e3, 5e3], turned=[False, False, True])
    assert measures_c.buckling(run, "x") == (1.0, 9.0)


def test_a_path_that_stays_stiff_has_not_buckled() -> None:
    run = path_run(w=[0.0, 1.0], K=[10e3, 9e3])
    assert all(map(math.isnan, measures_c.buckling(run, "x")))
    assert measures_c.first_slack(run, "x") == math.inf


def test_slack_and_spread() -> None:
    assert measures_c.first_slack(path_run(w=[0.0, 0.5, 0.7], K=[1.0] * 3, least=[4.0, 1.0, -3.0]), "x") == 0.55
    assert measures_c.spread([2.0, 3.0, 2.5]) == 0.5
    assert measures_c.rises([1.0, 2.0])
    assert not measures_c.rises([1.0, 1.0])


def test_no_beam_that_failed_leaves_a_row_reproduced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(
        WHOLES,  # type: ignore[arg-type]
        "broken",
        beams.BeamStudy("broken", "", {"x": {"beam": "TB8"}}, {EngineName.STATICS: beam_tasks.tension}),
    )
    runs = compute_runs(["broken"], BOTH, tmp_path, workers=HERE).runs
    run = runs[EngineName.STATICS]["broken"]
    assert "TB8" in run.message
    assert EngineName.MUJOCO not in {engine for engine, names in runs.items() if names}
    one = next(row for row in STATEMENTS if row.id == "C.3-increases")
    (judged,) = judge([one], Computed({EngineName.STATICS: {"tension": run}}))
    assert judged.verdict is Verdict.UNEXPLAINED
    assert "1 of 1 beams, the first x" in judged.cause


# ------------------------------------------------------------------------------------------------------ TB1 and TB4


@pytest.mark.parametrize("beam", ["TB1", "TB4"])
def test_table_c2(beam: str) -> None:
    run, row = BeamRun("beams", "statics", {beam: found(beam)}), TABLE_C2[beam]
    assert run.of(beam, "length") / 30 == pytest.approx(row.length_ratio, abs=0.01)
    assert np.median(run.of(beam, "stresses")) == pytest.approx(row.stress, rel=0.05)


def test_stiffness_at_zero_load_is_that_of_the_paths() -> None:
    """Condensed from the stiffness of all nodes, and dF/dw along paths: two ways to the same numbers, to round-off.

    Forces of 5e4 N have a round-off of 1e-11 N; stiffnesses of springs of 8e5 N/m leave 1e-9 of 139 N/m.
    """
    state, K = beam_tasks.standing({"beam": "TB1"}), np.array(found("TB1")["stiffness"])
    for axis in range(3):
        way = tuple(float(k == axis) * 0.01 for k in range(3))
        holds = (Hold(beam_tasks.BASE), Hold(beam_tasks.TOP, None, way))  # type: ignore[arg-type]
        path = follow(state, holds=holds, points=2)
        rate = path.reaction_rate(beam_tasks.TOP)[0] / 0.01
        np.testing.assert_allclose(rate, K[axis], rtol=0, atol=1e-6 * K[axis, axis])
        # Along the beam the stiffness falls by 17 kN/m a metre; across it, it grows with the square.
        secant = path.reaction(beam_tasks.TOP)[-1, axis] / 0.01
        assert secant == pytest.approx(K[axis, axis], rel=2e-3)


def test_lateral_stiffness_is_isotropic_at_zero_load() -> None:
    run = BeamRun("beams", "statics", {"TB1": found("TB1")})
    assert measures_c.anisotropy(run, "TB1") < 1e-6
    skewed = {"stiffness": np.diag([5.0, 2.0, 3.0])}
    assert measures_c.anisotropy(BeamRun("", "", {"x": skewed}), "x") == pytest.approx(0.5)


def test_mujoco_confirms_form_and_stiffness() -> None:
    """Its rods are rigid: 0.1 % stiffer and 0.2 % more stress than elastic ones."""
    other, own = beam_tasks.confirmed({"beam": "TB1"}), found("TB1")
    assert other["move"] < 1e-9  # m, what a step of Newton's method still moves
    assert other["neutral"] == 6
    assert other["length"] == pytest.approx(own["length"], rel=1e-4)
    mine, its = np.array(own["stiffness"]), np.array(other["stiffness"])
    np.testing.assert_allclose(np.diag(its), np.diag(mine), rtol=3e-3)
    assert np.all(np.diag(its) > np.diag(mine))


# ------------------------------------------------------------------------------------------------- rows and figures


def test_the_tower_of_chapter_7_is_what_the_doc_says(tmp_path: Path) -> None:
    made = reproduce(["7"], tmp_path, engines=[EngineName.STATICS], workers=HERE)
    written = lines_of(DOC.read_text(encoding="utf-8"))
    assert len(made.rows) > 8
    for one in made.rows:
        assert one.verdict is (Verdict.REPRODUCED if one.statement.known is None else Verdict.DIFFERS)
        assert written[one.statement.id] == reproduction.markdown_row(one, (*BOTH, EngineName.DAE))
    assert made.files["7.6"].read_bytes().startswith(b"\x89PNG")


def test_figure_c2_is_drawn_from_one_beam() -> None:
    figure = next(one for one in FIGURES if one.number == "C.2")
    canvas = figure.draw({EngineName.STATICS: {"beams": BeamRun("beams", "statics", {"TB1": found("TB1")})}})
    lines = [len(panel.get_lines()) for panel in canvas.axes]
    assert lines == [90, 90 + 444, 90, 90 + 444]  # cross sections without strings, as in the thesis


@pytest.mark.study
def test_the_whole_of_appendix_c_is_what_the_doc_says(tmp_path: Path) -> None:
    made = reproduce(["C"], tmp_path, engines=BOTH, workers=HERE)
    own = {one.id for one in STATEMENTS if one.chapter == "C" and set(one.needs) <= STATIC}
    rows = [one for one in made.rows if one.statement.id in own]  # those of motions are in test_beam_in_waves.py
    assert [one.statement.id for one in rows if one.verdict is Verdict.UNEXPLAINED] == []
    explained = {one.statement.id for one in rows if one.statement.known is not None}
    assert explained == {one.statement.id for one in rows if one.verdict is Verdict.DIFFERS}
    written = lines_of(DOC.read_text(encoding="utf-8"))
    for one in rows:
        assert written[one.statement.id] == reproduction.markdown_row(one, (*BOTH, EngineName.DAE))
    assert {"C.2", "C.3", "C.4", "C.6", "C.7"} <= set(made.files)
    confirmed = made.computed.runs[EngineName.MUJOCO]["beams"]
    assert set(confirmed.values) == set(BY_PRESTRESS)
