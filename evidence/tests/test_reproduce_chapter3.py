"""Chapter 3 in the ledger: its series, rows and figures. The full series are slow; small ones run here."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hanging_chain import linear_model

from evidence.cable.amplitude import response_amplitude
from evidence.cable.cases import Case, run_cases, simulated
from evidence.cable.spectrum import PeakCriteria, Spectrum, peaks_of, picked
from evidence.cable.steps import FoundStep
from evidence.pages import reproduction
from evidence.thesis.catalog import FIGURES, STATEMENTS, selected
from evidence.thesis.chapter3 import measures3, series
from evidence.thesis.chapter3.measures3 import element_frequencies
from evidence.thesis.chapter3.series import SERIES, SeriesRun
from evidence.thesis.experiments import EXPERIMENTS, EngineName
from evidence.thesis.ledger import Verdict, judge
from evidence.thesis.lookup import measured
from evidence.thesis.page import counts, summary
from evidence.thesis.reproduction import WHOLES, compute_runs, reproduce
from evidence.thesis.runs import Computed
from evidence.thesis.statement import Class
from tensegrity_mj.engines.reference.dae import DAE, Drift
from tensegrity_mj.engines.reference.method import Method
from tensegrity_mj.library.cable import Excitation, Start
from tensegrity_mj.model.elements.resistance import Drag, Resistance
from tensegrity_mj.model.motion import Motion
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.simulation import simulate
from tensegrity_mj.studies.workers import Backend, Workers

HERE = Workers(backend=Backend.THIS_PROCESS)
IN_LINE, CIRCULAR = SERIES["in-line"].frequencies, SERIES["circular"].frequencies
BOTH = (EngineName.DAE, EngineName.MUJOCO)
ROWS = {one.id: one for one in STATEMENTS if one.chapter == "3"}
OF_CHAPTER = [one for one in FIGURES if one.number.startswith("3.")]
GRID = 0.05  # Hz, between two inputs


def test_names_of_series_and_experiments_differ() -> None:
    assert not SERIES.keys() & EXPERIMENTS.keys()
    assert {name for one in (*ROWS.values(), *OF_CHAPTER) for name in one.needs} == set(SERIES)


def test_the_frequencies_are_those_of_the_thesis() -> None:
    """§3.3.2: 0.05 to 1.20 Hz and 0.10 to 1.10 Hz; §3.5.1: 13, 25, ..., 121 elements."""
    assert (IN_LINE[0], IN_LINE[-1], len(IN_LINE)) == (0.05, 1.2, 24)
    assert (CIRCULAR[0], CIRCULAR[-1], len(CIRCULAR)) == (0.1, 1.1, 21)
    assert series.ELEMENTS == (13, 25, 37, 49, 61, 73, 85, 97, 109, 121)


def test_elements_by_themselves() -> None:
    """(3.28) by hand: f ℓ^½ = √(1.5 · 9.81) / 2π = 0.61052; divided by 10, an element swings √10 times as fast."""
    c = math.sqrt(1.5 * 9.81) / (2 * math.pi)
    assert element_frequencies(13) == pytest.approx((c / 0.13**0.5, c / 0.5, c / 0.05**0.5))
    assert element_frequencies(121)[:2] == pytest.approx((c / 0.013**0.5, c / 0.025**0.5))


def test_rows_without_a_long_series(tmp_path: Path) -> None:
    """The model's data, both starts, the fixed step: every row as it must be, in both engines, and kept."""
    rows = [one for one in ROWS.values() if one.needs and set(one.needs) <= {"starts", "fixed-step"}]
    names = ("starts", "fixed-step")
    computed = compute_runs(names, BOTH, tmp_path, workers=HERE)
    runs = computed.runs
    assert computed.failures == {}
    assert set(runs[EngineName.MUJOCO]) == {"starts"}  # which drifts nowhere: it has no constraint
    judged = {one.statement.id: one for one in judge(rows, Computed(runs))}
    verdicts = {name: row.verdict for name, row in judged.items()}
    differ = {"3.3.3-rope", "3.11-load", "3.12-stable", "3.12-falls"}
    assert {name for name, verdict in verdicts.items() if verdict is Verdict.DIFFERS} == differ
    assert Verdict.UNEXPLAINED not in verdicts.values()
    assert judged["3.3.3-rope"].cells[EngineName.MUJOCO].value == pytest.approx(0.1419)
    assert judged["3.12-axis"].cells[EngineName.MUJOCO].verdict is Verdict.UNJUDGED
    again = compute_runs(("starts",), (EngineName.DAE,), tmp_path, workers=HERE).runs
    assert again[EngineName.DAE]["starts"].cases.study.computed == 0


def test_a_case_that_fails_leaves_no_row_reproduced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A sweep with a case that ran away is no sweep: rows say so, with the case."""
    monkeypatch.setitem(WHOLES, "starts", replace(SERIES["starts"], timestep=0.05))  # type: ignore[attr-defined]
    runs = compute_runs(("starts",), (EngineName.DAE,), tmp_path, workers=HERE).runs
    (row,) = judge([ROWS["3.3.3-length"]], Computed(runs))
    assert row.verdict is Verdict.UNEXPLAINED
    assert "2 of 2 cases" in row.cause
    assert "unstable step" in row.cause


def made_up(relative: np.ndarray) -> SeriesRun:
    """A run of the in-line series with amplitudes (24, 2, 3) that are made up."""

    class Results:
        frequencies = np.array(IN_LINE)

    Results.relative = relative  # type: ignore[attr-defined]
    return SeriesRun("in-line", "dae", results=Results())  # type: ignore[arg-type]


def test_measures_of_made_up_amplitudes() -> None:
    """Each reads what its name says: markers 5 and 10 are the rows 0 and 1, in-plane and out-of-plane the columns."""
    relative = np.ones((24, 2, 3))
    f = np.array(IN_LINE)
    relative[np.isclose(f, 0.35), 1, 0] = 12.0
    relative[np.isclose(f, 0.90), 1, 0] = 6.0
    relative[np.isclose(f, 0.95), 1, 1] = 5.0
    relative[np.isclose(f, 1.20), 1, 0] = 3.0
    run = made_up(relative)
    assert measures3.peak_input(run, 10, False) == 0.35
    assert measures3.peak_input(run, 10, True) == 0.90
    assert measured(ROWS["3.4-ratio"], {"in-line": run}) == 2.0
    assert measured(ROWS["3.6-ratio"], {"in-line": run}) == 1.0
    assert [measures3.largest(run, 10, axis, True) for axis in (0, 1)] == [6.0, 5.0]
    assert [measures3.largest(run, 10, axis, False) for axis in (0, 1)] == [12.0, 1.0]
    assert measures3.violence(run) == 3.0
    assert measures3.largest(run, 10, 0) == 12.0


def test_measures_of_made_up_peaks(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = [(f, 0.324) if 0.2 <= f < 0.7 else (f, 0.93) if f >= 0.7 else (f,) for f in IN_LINE]
    monkeypatch.setattr(SeriesRun, "peaks", lambda self, number, axis=0: rows)
    run = made_up(np.ones((24, 2, 3)))
    assert measures3.input_part(run, 10) == 1.0
    assert measures3.present_from(run, 10, 0.27, 0.36) == 0.2
    assert measures3.present_from(run, 10, 0.8, 1.0) == 0.7
    assert measures3.first_part(run, 10, 0.75, 1.0) == 0.0
    assert measures3.first_part(run, 10, 0.4, 0.5) == 1.0
    assert math.isnan(measures3.present_from(run, 10, 1.5, 1.6))


def test_what_cannot_be_judged_is_said_and_counted() -> None:
    unjudged = [one for one in ROWS.values() if one.unjudged]
    assert len(unjudged) >= 6
    rows = judge(unjudged, Computed({engine: {} for engine in BOTH}))
    assert {row.verdict for row in rows} == {Verdict.UNJUDGED}
    assert counts(rows)["cannot be judged"] == len(rows)
    requested = sum(one.kind is Class.STATEMENT for one in unjudged)
    assert (
        f"{requested} of its statements: 0 are reproduced, 0 differ (0 without a known cause), {requested} cannot be"
        in summary(rows)
    )
    text = reproduction.markdown(rows)
    assert "not in the thesis" in text
    assert "| – | – | cannot be judged | – |" in text


def test_panels_of_steps_are_over_their_elements() -> None:
    """Wall times of the steps that were found alone, and all limits; the pale band of the thesis' axis is no line."""
    steps = [FoundStep(K, math.nan if K == 121 else 0.26 / K, 0.02, 0.3 / K, 0.03, 5) for K in series.ELEMENTS]
    run = SeriesRun("fixed-drift", "dae", steps=tuple(steps), seconds=tuple(np.arange(9.0)))
    figure = next(one for one in OF_CHAPTER if one.number == "3.13").draw({EngineName.DAE: {run.name: run}})
    times, found = ([line.get_xydata().T for line in panel.get_lines()] for panel in figure.axes)
    np.testing.assert_array_equal(times, [(series.ELEMENTS[:9], np.arange(9.0))])
    np.testing.assert_array_equal(found[0], (series.ELEMENTS, [one.step for one in steps]))
    np.testing.assert_array_equal(found[1], (series.ELEMENTS, [one.limit for one in steps]))
    assert "DAE; times are those of this machine" in figure.get_supxlabel()


@pytest.mark.parametrize(("failed", "start"), [([], None), ([8, 9], 103.0)])
def test_what_did_not_complete_is_shaded(failed: list[int], start: float | None) -> None:
    """Shade from half of the way between the last cable that completed (97 elements) and the first that did not."""
    cables = [SimpleNamespace(scene=series.hanging(K)) for K in series.ELEMENTS]
    results = SimpleNamespace(cases=cables, failed=failed, drift=np.full(10, 0.01))
    run = SeriesRun("fixed-step", "dae", results=results, seconds=(1.0,) * 10)  # type: ignore[arg-type]
    figure = next(one for one in OF_CHAPTER if one.number == "3.12").draw({EngineName.DAE: {run.name: run}})
    for panel in figure.axes:
        assert [patch.get_x() for patch in panel.patches] == ([] if start is None else [start])
        np.testing.assert_array_equal(panel.get_lines()[0].get_xdata(), series.ELEMENTS)


def test_figure_of_single_elements_without_any_run(tmp_path: Path) -> None:
    figures, _ = selected(["3.11"])
    assert [figure.needs for figure in figures] == [()]
    found = reproduce(["3.11"], tmp_path, engines=(EngineName.DAE,), workers=HERE)
    assert found.files["3.11"].read_bytes().startswith(b"\x89PNG")
    assert {row.verdict for row in found.rows} == {Verdict.REPRODUCED, Verdict.DIFFERS}


# ------------------------------------------------------------------------------------ the causes that rows name


def simulated_amplitudes(scene: Scene, motion: Motion | None, frequency: float, start: Start) -> tuple[float, float]:
    """Relative in-plane amplitudes of markers 5 and 10 (nodes 7 and 12) on a circle, or on a motion that is given."""
    engine = DAE(method=Method.RK4, timestep=0.01, drift=Drift.NORMALIZE)  # h ω = 0.7: right to 1e-4, see 3.8-axis
    if motion is None:
        case = Case(scene, frequency, Excitation.CIRCULAR, series.AMPLITUDE, start, SERIES["in-line"].seed, engine)
        run = simulated(case)
    else:
        moved = scene.with_(motions=(motion,), initial_velocities=None)
        run = simulate(moved, None, engine, duration=45.0, output_interval=0.02)
    five, ten = (response_amplitude(run.time, run.nodes[:, n, 1], run.velocities[:, n, 1]) / 0.1 for n in (7, 12))
    return five, ten


def cause_of(name: str) -> str:
    """Return the cause of the difference that a row records."""
    known = ROWS[name].known
    assert known is not None
    return known.cause


def growing_circle(scene: Scene, frequency: float, within: float) -> Motion:
    """A circle whose radius grows from nothing in a time [s] as 10 s³ - 15 s⁴ + 6 s⁵, at rest at both ends."""
    t = np.arange(0.0, 45.01, 0.05)
    s, w = np.minimum(t / within, 1.0), 2.0 * np.pi * frequency
    size = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    rate, bend = 30.0 * (s * (1.0 - s)) ** 2 / within, 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s) / within**2
    turn = series.AMPLITUDE * np.exp(1j * w * t)
    z = np.array([size, rate + 1j * w * size, bend + 2j * w * rate - w**2 * size]) * turn
    d, v, a = np.stack([z.real, z.imag, np.zeros(z.shape)], axis=-1)
    return Motion.data(scene.structure.rods[0].name, t, d, v, a)


@pytest.mark.slow
@pytest.mark.study
def test_what_the_circular_amplitudes_hang_on() -> None:
    """The numbers of the causes of 3.8-axis and 3.8-ratio, to half of their last digits, and what they do to rows."""
    scene = series.hanging(13)
    lab, moving = Start.LAB_FRAME, Start.MOVING_FRAME
    values = {f: simulated_amplitudes(scene, None, f, lab)[1] for f in (0.30, 0.33, 0.34, 0.35)}
    assert values == {0.30: pytest.approx(15, abs=0.5), 0.33: pytest.approx(34, abs=0.5),
                      0.34: pytest.approx(40, abs=0.5), 0.35: pytest.approx(27, abs=0.5)}  # fmt: skip
    assert simulated_amplitudes(scene, None, 0.35, moving)[1] == pytest.approx(33, abs=0.5)
    for within, value in ((2.0, 22), (10.0, 21)):
        grown = growing_circle(scene, 0.35, within)
        assert simulated_amplitudes(scene, grown, 0.35, lab)[1] == pytest.approx(value, abs=0.5)
    air = scene.with_(resistance=Resistance(drag=Drag(diameter=0.006)))
    slow = [simulated_amplitudes(scene, growing_circle(scene, f, 20.0), f, lab) for f in (0.35, 1.0)]
    damped = [simulated_amplitudes(air, None, f, lab) for f in (0.35, 1.0)]
    for (first, second), value, ratio in ((slow, 18, 2.5), (damped, 15, 2.4)):
        assert first[1] == pytest.approx(value, abs=0.5)
        assert first[1] in ROWS["3.8-axis"].accepted  # it would be reproduced
        assert second[0] > first[0]  # and so would 3.9-ratio,
        assert first[1] / second[1] == pytest.approx(ratio, abs=0.05)  # but not 3.8-ratio
    for text in ("15 at 0.30 Hz", "34 at 0.33 Hz", "40 at 0.34 Hz", "27 from", "33 from", "18 if", "15 in air"):
        assert text in cause_of("3.8-axis")
    assert "still 2.5" in cause_of("3.8-ratio")
    assert "air 2.4" in cause_of("3.8-ratio")


def test_what_splits_the_peak_at_the_input() -> None:
    """The causes of 3.4-input, 3.6-absent and 3.6-input.

    In the plane, without whirling: marker 10 has no main peak at an input of 0.85 Hz, but one at 0.95 Hz; marker 5 has
    none of the first mode at 0.85 Hz. The forced motion of marker 5.
    """
    scene = series.hanging(13)
    engine = DAE(method=Method.RK4, timestep=0.01, drift=Drift.NORMALIZE)
    inputs = (0.30, 0.85, 0.95)  # the first for the criterion of all runs
    cases = [Case(scene, f, amplitude=series.AMPLITUDE, start=Start.LAB_FRAME, engine=engine) for f in inputs]
    run = SeriesRun("in-line", "dae", results=run_cases(cases, series.PLACES, workers=HERE))
    assert [measures3.has(peaks, f, f) for f, peaks in zip(inputs, run.peaks(10), strict=True)] == [
        True,
        False,
        True,
    ]
    assert measures3.first_part(run, 5, 0.8, 1.0) == 0.0
    chain = linear_model(scene)
    forced = []
    for f in (0.40, 0.45, 0.50, 0.55):
        w = 2.0 * np.pi * f
        turned = np.linalg.solve(np.diag(chain.stiffness) - w**2 * chain.mass_matrix, w**2 * chain.input)
        forced.append(abs(1.0 + float(np.sum((chain.lengths * turned)[:7]))))
    np.testing.assert_allclose(forced[1:3], 0.14, atol=0.005)
    assert min(forced[0], forced[3]) > 0.3


@pytest.mark.slow
@pytest.mark.study
def test_all_rows_of_chapter_3_are_reproduced_or_explained(tmp_path: Path) -> None:
    """Everything, in both engines; known differences are still there; the doc has the same values."""
    from ledger_lines import DOC, lines_of

    found = reproduce(["3"], tmp_path, engines=BOTH, workers=Workers(2))
    assert [row.statement.id for row in found.rows if row.verdict is Verdict.UNEXPLAINED] == []
    explained = {row.statement.id for row in found.rows if row.statement.known is not None}
    assert explained == {row.statement.id for row in found.rows if row.verdict is Verdict.DIFFERS}
    assert {figure.number for figure in OF_CHAPTER} <= set(found.files)
    lines = lines_of(DOC.read_text(encoding="utf-8"))
    for row in found.rows:
        assert lines[row.statement.id] == reproduction.markdown_row(row)
    # The cause of 3.4-f1-from: the input from which on a frequency is a main peak moves with the threshold.
    runs = compute_runs(("in-line", "circular"), (EngineName.DAE,), tmp_path / "runs", workers=HERE).runs
    moved = set()
    for name, marker, low, high in (("in-line", 10, 0.27, 0.36), ("in-line", 5, 0.8, 1.0), ("circular", 10, 0.8, 1.02)):
        run = runs[EngineName.DAE][name]
        assert run.cases.study.computed == 0
        grid = run.cases.spectral_frequencies
        spectra = [peaks_of(Spectrum(grid, one)) for one in run.cases.densities[:, series.SHOWN.index(marker), 0]]
        begins = []
        for local in (0.05, 0.2):
            rows = zip(run.cases.frequencies, picked(spectra, PeakCriteria(local)), strict=True)
            begins.append(next(f for f, row in rows if any(
                low <= peak.frequency <= high and abs(peak.frequency - f) > measures3.BESIDE for peak in row
            )))  # fmt: skip
        moved.add(round((begins[1] - begins[0]) / GRID))
    assert moved == {1, 3}
