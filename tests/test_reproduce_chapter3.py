"""Chapter 3 in the ledger: its series, rows and figures. The full series are slow; small ones run here."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tensegrity_mj.reproduction import figures3, series, statements3
from tensegrity_mj.reproduction.catalog import selected
from tensegrity_mj.reproduction.experiments import EXPERIMENTS, EngineName
from tensegrity_mj.reproduction.ledger import Verdict, judge
from tensegrity_mj.reproduction.page import counts, markdown, summary
from tensegrity_mj.reproduction.reproduce import reproduce
from tensegrity_mj.reproduction.runs import Computed
from tensegrity_mj.reproduction.series import SERIES, SeriesRun, run_series
from tensegrity_mj.studies.workers import Backend, Workers

HERE = Workers(backend=Backend.THIS_PROCESS)
BOTH = (EngineName.DAE, EngineName.MUJOCO)


def test_names_of_series_and_experiments_differ() -> None:
    assert not SERIES.keys() & EXPERIMENTS.keys()
    assert {name for one in (*statements3.STATEMENTS, *figures3.FIGURES) for name in one.needs} == set(SERIES)


def test_the_frequencies_are_those_of_the_thesis() -> None:
    """§3.3.2: 0.05 to 1.20 Hz and 0.10 to 1.10 Hz; §3.5.1: 13, 25, ..., 121 elements."""
    assert (series.IN_LINE[0], series.IN_LINE[-1], len(series.IN_LINE)) == (0.05, 1.2, 24)
    assert (series.CIRCULAR[0], series.CIRCULAR[-1], len(series.CIRCULAR)) == (0.1, 1.1, 21)
    assert series.ELEMENTS == (13, 25, 37, 49, 61, 73, 85, 97, 109, 121)


def test_elements_by_themselves() -> None:
    """(3.28) by hand: f ℓ^½ = √(1.5 · 9.81) / 2π = 0.61052; divided by 10, an element swings √10 times as fast."""
    c = math.sqrt(1.5 * 9.81) / (2 * math.pi)
    assert figures3.element_frequencies(13) == pytest.approx((c / 0.13**0.5, c / 0.5, c / 0.05**0.5))
    assert figures3.element_frequencies(121)[:2] == pytest.approx((c / 0.013**0.5, c / 0.025**0.5))


def test_rows_without_a_long_series(tmp_path: Path) -> None:
    """The model's data, both starts, the fixed step: every row as it must be, in both engines, and kept."""
    rows = [one for one in statements3.STATEMENTS if one.needs and set(one.needs) <= {"starts", "fixed-step"}]
    names = ("starts", "fixed-step")
    runs, failures = run_series(names, BOTH, tmp_path, workers=HERE)
    assert failures == {}
    assert set(runs[EngineName.MUJOCO]) == {"starts"}  # which drifts nowhere: it has no constraint
    judged = {one.statement.id: one for one in judge(rows, Computed(runs))}
    verdicts = {name: row.verdict for name, row in judged.items()}
    differ = {"3.3.3-rope", "3.11-load", "3.12-stable", "3.12-falls"}
    assert {name for name, verdict in verdicts.items() if verdict is Verdict.DIFFERS} == differ
    assert Verdict.UNEXPLAINED not in verdicts.values()
    assert judged["3.4-start-lab"].cells[EngineName.MUJOCO].value == pytest.approx(2.0, abs=0.01)
    assert judged["3.12-axis"].cells[EngineName.MUJOCO].verdict is Verdict.UNJUDGED
    again, _ = run_series(("starts",), (EngineName.DAE,), tmp_path, workers=HERE)
    assert again[EngineName.DAE]["starts"].cases.study.computed == 0


def test_a_case_that_fails_leaves_no_row_reproduced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A sweep with a case that ran away is no sweep: rows say so, with the case."""

    def coarse(engine: EngineName) -> list:
        from tensegrity_mj.engines.dae import DAE
        from tensegrity_mj.engines.integration import Method

        return [replace(case, engine=DAE(method=Method.RK4, timestep=0.05)) for case in series._starts(engine)]

    monkeypatch.setitem(series.SERIES, "starts", replace(SERIES["starts"], cases=coarse))  # type: ignore[arg-type]
    runs, _ = run_series(("starts",), (EngineName.DAE,), tmp_path, workers=HERE)
    (row,) = judge([one for one in statements3.STATEMENTS if one.id == "3.4-start-lab"], Computed(runs))
    assert row.verdict is Verdict.UNEXPLAINED
    assert "2 of 2 cases" in row.cause
    assert "unstable step" in row.cause


def made_up(relative: np.ndarray) -> SeriesRun:
    """A run of the in-line series with amplitudes (24, 2, 3) that are made up."""

    class Results:
        frequencies = np.array(series.IN_LINE)

    Results.relative = relative  # type: ignore[attr-defined]
    return SeriesRun("in-line", "dae", results=Results())  # type: ignore[arg-type]


def test_measures_of_made_up_amplitudes() -> None:
    """Each reads what its name says: markers 5 and 10 are the rows 0 and 1, in-plane and out-of-plane the columns."""
    relative = np.ones((24, 2, 3))
    f = np.array(series.IN_LINE)
    relative[np.isclose(f, 0.35), 1, 0] = 12.0
    relative[np.isclose(f, 0.90), 1, 0] = 6.0
    relative[np.isclose(f, 0.95), 1, 1] = 5.0
    relative[np.isclose(f, 1.20), 1, 0] = 3.0
    run = made_up(relative)
    assert statements3._first_peak(run, 10) == 0.35
    assert statements3._second_peak(run, 10) == 0.90
    assert statements3._ratio(run, 10) == 2.0
    assert statements3._ratio(run, 5) == 1.0
    assert statements3._out_over_in(run, 10, True) == pytest.approx(5.0 / 6.0)
    assert statements3._out_over_in(run, 10, False) == pytest.approx(1.0 / 12.0)
    assert statements3._violence(run) == 3.0
    assert statements3._largest(run, 10, 0) == 12.0


def test_measures_of_made_up_peaks(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = [(f, 0.324) if 0.2 <= f < 0.7 else (f, 0.93) if f >= 0.7 else (f,) for f in series.IN_LINE]
    monkeypatch.setattr(SeriesRun, "peaks", lambda self, number, axis=0: rows)
    run = made_up(np.ones((24, 2, 3)))
    assert statements3._input_part(run, 10) == 1.0
    assert statements3._present_from(run, 10, 0.27, 0.36) == 0.2
    assert statements3._present_from(run, 10, 0.8, 1.0) == 0.7
    assert statements3._first_part(run, 10, 0.75, 1.0) == 0.0
    assert statements3._first_part(run, 10, 0.4, 0.5) == 1.0
    assert math.isnan(statements3._present_from(run, 10, 1.5, 1.6))


def test_what_cannot_be_judged_is_said_and_counted() -> None:
    unjudged = [one for one in statements3.STATEMENTS if one.unjudged]
    assert len(unjudged) >= 6
    rows = judge(unjudged, Computed({engine: {} for engine in BOTH}))
    assert {row.verdict for row in rows} == {Verdict.UNJUDGED}
    assert counts(rows)["cannot be judged"] == len(rows)
    assert f"{len(rows)} of them cannot be judged" in summary(rows)
    text = markdown(rows, BOTH)
    assert "not in the thesis" in text
    assert "| – | – | cannot be judged |" in text


def test_figure_of_single_elements_without_any_run(tmp_path: Path) -> None:
    figures, _ = selected(["3.11"])
    assert [figure.needs for figure in figures] == [()]
    found = reproduce(["3.11"], tmp_path, engines=(EngineName.DAE,), workers=HERE)
    assert found.files["3.11"].read_bytes().startswith(b"\x89PNG")
    assert {row.verdict for row in found.rows} == {Verdict.REPRODUCED, Verdict.DIFFERS}


@pytest.mark.slow
@pytest.mark.study
def test_all_rows_of_chapter_3_are_reproduced_or_explained(tmp_path: Path) -> None:
    """Everything, in both engines; known differences are still there; the doc has the same values."""
    from test_reproduce import DOC, lines_of

    from tensegrity_mj.reproduction import page

    found = reproduce(["3"], tmp_path, engines=BOTH, workers=Workers(2))
    assert [row.statement.id for row in found.rows if row.verdict is Verdict.UNEXPLAINED] == []
    explained = {row.statement.id for row in found.rows if row.statement.known is not None}
    assert explained == {row.statement.id for row in found.rows if row.verdict is Verdict.DIFFERS}
    assert {figure.number for figure in figures3.FIGURES} <= set(found.files)
    lines = lines_of(DOC.read_text(encoding="utf-8"))
    for row in found.rows:
        assert lines[row.statement.id] == page.markdown_row(row)
