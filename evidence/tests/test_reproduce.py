"""`reproduce`: the ledger's rows and verdicts, its figures, what it keeps, and that it can turn red."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_words import choices_of
from ledger_lines import lines_of
from matplotlib.layout_engine import ConstrainedLayoutEngine

import tensegrity_mj as tmj
from evidence.pages import reproduction
from evidence.thesis import ledger, measures, runs
from evidence.thesis.catalog import FIGURES, STATEMENTS, selected
from evidence.thesis.disturbance import Disturbance, Quantity
from evidence.thesis.experiments import EXPERIMENTS, EngineName, cell_strings, simulate_experiment
from evidence.thesis.expression import evaluate
from evidence.thesis.ledger import Verdict, judge, value_text, verdict_of
from evidence.thesis.lookup import measured
from evidence.thesis.reproduction import WHOLES, Reproduction, reproduce
from evidence.thesis.runs import run_experiments
from evidence.thesis.statement import HOLDS, Class, Interval, KnownDifference, Statement
from tensegrity_mj.cli import build_parser, main
from tensegrity_mj.commands.common import ExitCode
from tensegrity_mj.errors import OptionError
from tensegrity_mj.runs.trajectory import Trajectory
from tensegrity_mj.studies.workers import Backend, Workers

DOC = Path(__file__).resolve().parents[1] / "docs" / "reproduction.md"
BOTH = (EngineName.DAE, EngineName.MUJOCO)
HERE = Workers(backend=Backend.THIS_PROCESS)

# The figures that the project promises.
PROMISED = (
    "3.3 3.4 3.5 3.6 3.7 3.8 3.9 3.11 3.12 3.13 3.14 3.15 "
    "4.2 4.3 4.4 4.7 4.8 4.9 4.10 4.11 5.1 5.3 5.4 5.6 5.7 6.2 6.3 6.4 6.5 6.6 6.7 6.8 6.9 7.6 7.7 7.8 7.9 "
    "C.2 C.3 C.4 C.6 C.7 C.8"
).split()  # fmt: skip
# Of the chapters in the thesis.
PAGES = {
    "3": range(57, 90),
    "4": range(89, 107),
    "5": range(107, 127),
    "6": range(107, 141),
    "7": range(141, 159),
    "C": range(185, 197),
}
HEAVY = Disturbance(Quantity.MASS, 1.1)
CHEAP = ("4.2", "4.3", "4.4", "5", "6")  # all but the beam


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Reproduction:
    """Everything but the beam, in both engines, with figures: drawn in full, but not laid out, which takes as long.

    Layouts are those of `save_figure` for every figure; tests/pictures looks at them.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ConstrainedLayoutEngine, "execute", lambda *_: None)
        return reproduce(CHEAP, tmp_path_factory.mktemp("ledger"), engines=BOTH, workers=HERE)


def row(made: Reproduction, name: str) -> ledger.Row:
    return next(one for one in made.rows if one.statement.id == name)


# ------------------------------------------------------------------------------------------------------ the rows


def test_every_promised_figure_is_drawn_and_has_rows() -> None:
    assert [figure.number for figure in FIGURES] == PROMISED
    # Figure 7.7 shows what D is: nothing is stated there.
    assert {one.figure for one in STATEMENTS} - {""} == set(PROMISED) - {"7.7"}


def test_rows_are_complete_and_consistent() -> None:
    assert len({one.id for one in STATEMENTS}) == len(STATEMENTS) > 200
    for one in STATEMENTS:
        assert one.says, one.id
        assert one.stated, one.id
        assert one.tolerance or one.accepted == HOLDS or one.unjudged, one.id
        assert set(one.needs) <= EXPERIMENTS.keys() | WHOLES.keys(), one.id
        assert one.measure or one.unjudged, one.id
        assert one.accepted.low <= one.accepted.high, one.id
        assert one.page in PAGES[one.chapter], one.id
        if one.known is not None:
            # A known difference is one: nothing in it would count as reproduced.
            assert one.known.ours.high < one.accepted.low or one.known.ours.low > one.accepted.high, one.id


@pytest.mark.parametrize("chapter", ["5", "6"])
def test_all_rows_of_a_chapter_are_reproduced_or_explained(made: Reproduction, chapter: str) -> None:
    own = [one for one in made.rows if one.statement.id.startswith(chapter)]
    assert len(own) > 50
    assert [one.statement.id for one in own if one.verdict is Verdict.UNEXPLAINED] == []


def test_all_rows_of_the_cross_are_reproduced(made: Reproduction) -> None:
    own = [one for one in made.rows if one.statement.id.startswith("4.")]
    assert len(own) > 30
    assert [one.statement.id for one in own if one.verdict is not Verdict.REPRODUCED] == []


def test_known_differences_are_still_there(made: Reproduction) -> None:
    """A cause that explains nothing any more must go."""
    explained = {one.statement.id for one in made.rows if one.statement.known is not None}
    assert explained == {one.statement.id for one in made.rows if one.verdict is Verdict.DIFFERS}
    assert all(one.cause for one in made.rows if one.verdict is Verdict.DIFFERS)


@pytest.mark.slow
@pytest.mark.study
def test_all_rows_of_the_beam_are_reproduced_or_explained(tmp_path: Path) -> None:
    """Run the DAE alone; tests/engines/test_every_scene_agrees.py compares MuJoCo with it."""
    found = reproduce(("4.7", "4.8", "4.9", "4.10", "4.11"), tmp_path, engines=BOTH[:1], workers=HERE)
    assert len(found.rows) > 40
    assert [one.statement.id for one in found.rows if one.verdict is Verdict.UNEXPLAINED] == []
    sure = {one.statement.id for one in found.rows if one.verdict is Verdict.DIFFERS}
    assert sure == {"4.7-constant"}


def test_both_engines_give_the_same_values(made: Reproduction) -> None:
    """The engines' nodes are within 1e-7 m, so values of order one agree to 1e-5 unless they are nearly zero."""
    for one in made.rows:
        dae, mujoco = (one.cells[engine].value for engine in BOTH)
        if one.statement.accepted.low != 0.0 and one.verdict is not Verdict.UNJUDGED:  # else: what rounding leaves
            assert mujoco == pytest.approx(dae, rel=1e-4), one.statement.id


# --------------------------------------------------------------------------------------------- rows, computed anew


@pytest.mark.parametrize(("experiment", "decay_rate"), [("pinned", 0.15), ("pinned-fast", 0.20)])
def test_first_control_of_the_pinned_rod_by_hand(made: Reproduction, experiment: str, decay_rate: float) -> None:
    """The value that differs from the thesis' axis, from the printed data alone, without this package's law.

    At rest V̇ = eᵀY b̈ with b̈ = (I - bbᵀ) Σ u_i (n_i - b) / J (ℓ = 1), and u = δV f₊/‖f₊‖² by Lemma 5.1 b).
    """
    b = np.array([1.0, -math.sqrt(2.0), math.sqrt(2.0)]) / math.sqrt(5.0)
    goal = np.array([0.0, math.sqrt(2.0), 1.0]) / math.sqrt(3.0)
    turns = 2.0 * np.pi * np.arange(3) / 3.0
    anchors = 1.2 * np.column_stack([np.cos(turns), np.sin(turns), np.zeros(3)])
    error = b - goal
    across = np.eye(3) - np.outer(b, b)
    influence = -(anchors - b) @ across @ error / (1.0 / 3.0)
    pulls = np.maximum(influence, 0.0)
    u = decay_rate * 0.5 * float(error @ error) * pulls / float(pulls @ pulls)
    run = made.computed.runs[EngineName.DAE][experiment]
    np.testing.assert_allclose(run.force_densities[0], u, rtol=0, atol=1e-12)
    known = row(made, "5.4a-u-first" if experiment == "pinned" else "6.4c-u-first").statement.known
    assert known is not None
    assert u.max() in known.ours


def test_spread_and_counts_of_strings_on_made_up_controls(made: Reproduction) -> None:
    run = made.computed.runs[EngineName.DAE]["pinned"].until(4)
    u = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [2.0, 1.0, 0.0], [0.0, 1.0, 1.0]])
    run = replace(run, force_densities=u)
    assert evaluate("max(sum(a.force_densities > 1e-9, 1))", {}, [run]) == 2
    assert measures.spread_of_active(run) == 0.5
    later = replace(run, time=run.time + 1.0)  # from where on the rows look
    named = {one.id: one for one in STATEMENTS}
    assert measured(named["4.9-rough"], {"beam-1960": later}) == 1 + 1 + 2
    assert measured(named["5.4a-continuous"], {"pinned": later}) == 1.0


def test_times_off_a_bound_on_made_up_sums(made: Reproduction) -> None:
    run = made.computed.runs[EngineName.DAE]["pinned"].until(6)
    u = np.zeros((6, 3))
    u[:, 0] = [1.0, 1.2, 1.3, 1.0, 1.0005, 1.5]
    run = replace(run, force_densities=u)
    t = run.time
    assert measures.times_off(run, 1.0) == [(t[1], t[2]), (t[5], t[5])]


def test_time_below_is_the_last_time_above(made: Reproduction) -> None:
    run = made.computed.runs[EngineName.DAE]["pinned"]
    error = run.target_error()
    found = measures.time_below(run, 0.5)
    assert np.all(error[run.time > found] <= 0.5 * error[0])
    assert error[np.searchsorted(run.time, found)] > 0.5 * error[0]


def test_cells_of_the_beam_share_their_verticals() -> None:
    assert [list(cell_strings(cell)) for cell in (1, 2, 39)] == [
        [0, 1, 2, 3, 4, 5],
        [5, 6, 7, 8, 9, 10],
        [190, 191, 192, 193, 194, 195],
    ]


def test_shape_of_the_beam_from_its_nodes() -> None:
    """φ and radii of a cell that is built here: r_i = 2, r_o = 3, φ = 0.4."""
    scene = tmj.load_scene("planar_beam")
    inner, outer, phi = 2.0, 3.0, 0.4

    def place(radius: float, angle: float) -> list[float]:
        return [radius * math.sin(angle), 0.0, radius * math.cos(angle)]

    nodes = np.array(scene.nodes0)
    nodes[[0, 1, 2, 3]] = [place(outer, 0.0), place(inner, phi), place(inner, 0.0), place(outer, phi)]
    fake = _Fake(scene, nodes[None])
    assert measures.sector_angle(fake)[0] == pytest.approx(phi, rel=1e-14)  # type: ignore[arg-type]
    np.testing.assert_allclose(measures.radii(fake)[0], [inner, outer], rtol=1e-14)  # type: ignore[arg-type]


class _Fake:
    """Run with no more than the measures of shape read."""

    def __init__(self, scene: tmj.Scene, nodes: np.ndarray) -> None:
        self.scene, self.nodes = scene, nodes


# -------------------------------------------------------------------------------------------------------- verdicts


def near(value: float, tolerance: float) -> Interval:
    return Interval(value - tolerance, value + tolerance)


def made_up(accepted: Interval, known: KnownDifference | None = None, unit: str = "m") -> Statement:
    return Statement(
        id="5.9-x", kind=Class.NUMBER, figure="5.4", place="§5", page=120, says="what", stated="1 m", accepted=accepted,
        tolerance="why", needs=("pinned",), measure="max(a.force_densities)", unit=unit, value=(1.0,), known=known,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("value", "verdict"),
    [
        (1.0, Verdict.REPRODUCED),
        (1.1, Verdict.REPRODUCED),
        (1.1001, Verdict.UNEXPLAINED),
        (2.0, Verdict.DIFFERS),
        (2.2, Verdict.UNEXPLAINED),
        (-math.inf, Verdict.UNEXPLAINED),
        (math.nan, Verdict.UNEXPLAINED),
    ],
)
def test_a_known_cause_explains_only_its_own_difference(value: float, verdict: Verdict) -> None:
    one = made_up(near(1.0, 0.1), KnownDifference("because", near(2.0, 0.1)))
    assert verdict_of(one, value) is verdict
    without = made_up(near(1.0, 0.1))
    assert verdict_of(without, value) is (Verdict.REPRODUCED if verdict is Verdict.REPRODUCED else Verdict.UNEXPLAINED)


def test_a_row_is_as_bad_as_its_worst_engine() -> None:
    one = made_up(near(1.0, 0.1), KnownDifference("because", near(2.0, 0.1)))
    cells = {EngineName.DAE: ledger.Cell(1.0, Verdict.REPRODUCED), EngineName.MUJOCO: ledger.Cell(2.0, Verdict.DIFFERS)}
    assert ledger.Row(one, cells).verdict is Verdict.DIFFERS
    assert ledger.Row(one, cells).cause == "because"
    cells[EngineName.ODE] = ledger.Cell(3.0, Verdict.UNEXPLAINED)
    assert ledger.Row(one, cells).verdict is Verdict.UNEXPLAINED
    assert ledger.Row(one, cells).cause == "it is not the recorded value"


def test_a_run_that_stopped_or_failed_gives_no_value(made: Reproduction) -> None:
    run = made.computed.runs[EngineName.DAE]["pinned"]
    one = made_up(near(1.0, 0.1))
    stopped = runs.Computed({EngineName.DAE: {"pinned": replace(run, status=tmj.Status.INFEASIBLE, message="no u")}})
    failed = runs.Computed({EngineName.DAE: {}}, {(EngineName.DAE, "pinned"): "it diverged"})
    for computed, reason in ((stopped, "infeasible at 60 s: no u"), (failed, "it diverged")):
        (found,) = judge([one], computed)
        assert found.verdict is Verdict.UNEXPLAINED
        assert math.isnan(found.cells[EngineName.DAE].value)
        assert reason in found.cause
    # A pole of the ODE's angles is known, and no difference of the physics.
    pole = runs.Computed({EngineName.ODE: {"pinned": replace(run, status=tmj.Status.SINGULAR, message="rod at pole")}})
    assert judge([one], pole)[0].verdict is Verdict.DIFFERS


def test_reading_an_axis() -> None:
    """The bands of axes: ticks to 0.06 by 0.01 end in [0.06, 0.07), and a curve that was made for them passes 0.03."""
    checked = 0
    for one in STATEMENTS:
        ticks = re.fullmatch(r"axis (?:of|to) ([−0-9.]+)(?: k?[NmsH1][/²mzs]*)?, ticks of ([0-9.]+)", one.stated)
        if ticks and one.tolerance.endswith("fills more than half of it") and "coordinates" not in one.id:
            last, tick = (float(text.replace("−", "-")) for text in ticks.groups())
            ends = sorted((0.5 * last, last + math.copysign(tick, last)))
            assert (one.accepted.low, one.accepted.high) == pytest.approx(ends), one.id
            checked += 1
    assert checked > 40


@pytest.mark.parametrize(
    ("accepted", "value", "text"),
    [
        (near(0.6, 0.005), 0.60004999, "0.6000"),  # a hundredth of 0.01
        (Interval(0.0, 1e-9), 3e-16, "< 1e-10"),  # what rounding leaves differs from machine to machine
        (Interval(0.0, 1e-9), 0.0, "< 1e-10"),
        (Interval(0.0, 0.02), 0.0178, "0.0178"),
        (Interval(-0.35, -0.15), -0.28042, "−0.280"),
        (near(12.0, 0.0), 12.0, "12"),
        (Interval(1.0), 138.0, "138.0"),
        (Interval(0.2), 0.99998, "1.000"),
        (Interval(0.2), 1.0, "1.000"),
        (Interval(1.05), 1.21238, "1.212"),
        (HOLDS, 1.0, "true"),
        (HOLDS, 0.0, "false"),
        (near(1.0, 0.1), math.nan, "–"),
    ],
)
def test_values_have_the_digits_that_their_tolerance_requires(accepted: Interval, value: float, text: str) -> None:
    assert value_text(made_up(accepted), value) == text


# ------------------------------------------------------------------------------------------------------- turns red


# The rows that must turn red with masses 10 % off, by chapter: what the law promises, and the printed masses.
@pytest.mark.parametrize(
    ("figure", "names"),
    [
        ("4.3", {"4.3-tracking", "4.3-error"}),
        ("5.7", {"5.7-decay"}),
        ("6.9", {"6.9-decay"}),
    ],
)
def test_rows_turn_red_with_masses_ten_percent_off(tmp_path: Path, figure: str, names: set[str]) -> None:
    found = reproduce([figure], tmp_path, engines=[EngineName.DAE], disturbance=HEAVY, workers=HERE, draw=False)
    red = {one.statement.id for one in found.rows if one.verdict is Verdict.UNEXPLAINED}
    assert names <= red
    assert "mass x 1.1" in (tmp_path / "reproduction.html").read_text(encoding="utf-8")


def test_the_printed_mass_is_a_row_that_turns_red() -> None:
    found = {}
    for disturbance in (None, HEAVY):
        run = simulate_experiment(replace(EXPERIMENTS["prism"], interval=1.0), EngineName.DAE, disturbance)
        one = next(each for each in STATEMENTS if each.id == "5.6-mass")
        found[disturbance] = verdict_of(one, measured(one, {"prism": run}))
    assert found == {None: Verdict.REPRODUCED, HEAVY: Verdict.UNEXPLAINED}


# ---------------------------------------------------------------------------------------------- files and the page


def test_figures_page_and_data_are_written(made: Reproduction) -> None:
    drawn = [number for number in PROMISED if number in made.files]
    assert drawn == [number for number in PROMISED if not re.fullmatch(r"[37C]\..*|4\.([789]|10|11)", number)]
    for number in drawn:
        assert made.files[number].read_bytes().startswith(b"\x89PNG")
    html = made.files["page"].read_text(encoding="utf-8")
    for number in drawn:
        assert f'id="f{number}"' in html
    for one in made.rows:
        assert f'id="{one.statement.id}"' in html
    assert not re.search("https?:", html)  # nothing is loaded from elsewhere
    data = json.loads(made.files["data"].read_text(encoding="utf-8"))
    assert [one["id"] for one in data["rows"]] == [one.statement.id for one in made.rows]
    assert sum(data["counts"].values()) == len(made.rows)
    apart = [
        line["from the first engine [m]"] for line in data["runs"] if line["from the first engine [m]"] is not None
    ]
    assert len(apart) == len(data["runs"]) // 2
    assert max(apart) <= 1e-7  # what the experiments' settings are chosen for


def test_figures_are_drawn_from_one_engine_too(made: Reproduction) -> None:
    figure = next(one for one in FIGURES if one.number == "5.1")
    alone = figure.draw({EngineName.MUJOCO: made.computed.runs[EngineName.MUJOCO]})
    lines = alone.axes[0].get_lines()
    assert all(line.get_marker() != "o" or len(line.get_xdata()) == 1 for line in lines)  # a dot, no circles


def test_panels_are_drawn_of_their_expressions(made: Reproduction) -> None:
    figure = next(one for one in FIGURES if one.number == "6.6")
    runs_of = made.computed.runs[EngineName.DAE]
    for panel, name in zip(figure.draw({EngineName.DAE: runs_of}).axes, ("mirror-b", "mirror-bd"), strict=True):
        run = runs_of[name]
        curves = {line.get_label(): line.get_ydata() for line in panel.get_lines()}
        assert list(curves) == ["orientation", "velocity", "sum"]
        wanted = (run.lyapunov_error, run.lyapunov_velocity, run.lyapunov)
        assert all(np.array_equal(curve, values) for curve, values in zip(curves.values(), wanted, strict=True))


def test_a_second_call_computes_nothing_and_damage_is_repaired(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    requested: list[str] = []
    real = simulate_experiment

    def counted(experiment: object, engine: EngineName, disturbance: Disturbance | None) -> Trajectory:
        requested.append(experiment.name)  # type: ignore[attr-defined]
        return real(experiment, engine, disturbance)  # type: ignore[arg-type]

    monkeypatch.setattr(runs, "simulate_experiment", counted)

    def call(disturbance: Disturbance | None = None) -> tuple[list[str], Trajectory]:
        requested.clear()
        found = run_experiments(["prism"], [EngineName.DAE], tmp_path, disturbance=disturbance, workers=HERE)
        return list(requested), found.runs[EngineName.DAE]["prism"]

    first = call()
    again = call()
    assert (first[0], again[0]) == (["prism"], [])
    np.testing.assert_array_equal(first[1].nodes, again[1].nodes)
    (tmp_path / "prism-dae.nc").write_bytes(b"damaged")
    assert call()[0] == ["prism"]
    assert call(HEAVY)[0] == ["prism"]  # another plant is another run
    monkeypatch.setattr(runs, "code_digest", lambda: "other code")
    assert call(HEAVY)[0] == ["prism"]


def test_the_digest_of_the_code_reads_all_that_simulates(monkeypatch: pytest.MonkeyPatch) -> None:
    read: set[Path] = set()
    monkeypatch.setattr(Path, "read_bytes", lambda path: read.add(path) or b"")
    runs.code_digest.__wrapped__()
    # One file of each place: kinds, scenes, equations, engines, families, `simulate`, laws, cables.
    wanted = ("kinds", "scene", "assembly", "located", "prism", "single", "lyapunov", "amplitude")
    assert set(wanted) <= {path.stem for path in read}


def test_an_interrupt_says_what_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stopped(*arguments: object, **options: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(runs, "run_many", stopped)
    with pytest.raises(KeyboardInterrupt, match=r"0 of 2 runs are kept in .*; run the same again"):
        run_experiments(["prism"], BOTH, tmp_path)


def test_a_run_that_cannot_be_made_is_data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*arguments: object) -> None:
        raise OptionError("nothing to see")

    monkeypatch.setattr(runs, "simulate_experiment", broken)
    found = run_experiments(["prism"], [EngineName.DAE], tmp_path, workers=HERE)
    assert found.failures == {(EngineName.DAE, "prism"): "nothing to see"}


# -------------------------------------------------------------------------------------------------------- the doc


def test_the_doc_has_every_row_as_it_is_in_the_code() -> None:
    found = lines_of(DOC.read_text(encoding="utf-8"))
    assert list(found) == [one.id for one in STATEMENTS]
    for one in STATEMENTS:
        empty = ledger.Row(one, {EngineName.DAE: ledger.Cell(math.nan, Verdict.REPRODUCED)})
        head = reproduction.markdown_row(empty).split(" | ")[:5]
        assert found[one.id].split(" | ")[:5] == head, one.id


def test_the_doc_agrees_with_a_fresh_computation(made: Reproduction) -> None:
    found = lines_of(DOC.read_text(encoding="utf-8"))
    for one in made.rows:
        assert found[one.statement.id] == reproduction.markdown_row(one)


def test_the_doc_counts_its_rows_by_class() -> None:
    """The headline and the table of classes, counted again from the lines of the doc."""
    text = DOC.read_text(encoding="utf-8")
    cells = {name: line.strip("| ").split(" | ") for name, line in lines_of(text).items()}
    for kind in Class:
        own = [row for row in cells.values() if row[1] == kind.value]
        verdicts = [row[-2] for row in own]
        counted = [verdicts.count(name) for name in ("reproduced", "differs", "cannot be judged")]
        assert sum(counted) == len(own)  # and none differs otherwise than recorded
        assert f"| {kind.value} | {len(own)} | " + " | ".join(map(str, counted)) + " |" in text
        if kind.is_evidence:
            what = "numbers that the thesis states" if kind is Class.NUMBER else "of its statements"
            assert f"{len(own)} {what}: {counted[0]} are reproduced, {counted[1]} differ (" in text


# ---------------------------------------------------------------------------------------------------- the command


def test_engines_of_the_command_line_are_those_of_the_ledger() -> None:
    assert [engine.value for engine in EngineName] == choices_of("reproduce", "--engine")
    help_ = build_parser().commands["reproduce"]._option_string_actions["--disturb"].help or ""
    *others, last = (quantity.value for quantity in Quantity)
    assert help_.endswith(f"{', '.join(others)} or {last}")


@pytest.mark.parametrize("chosen", ["9.9", "5.2", "8", "c", "prism"])
def test_unknown_figures_are_refused_before_anything_runs(
    chosen: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert main(["reproduce", chosen, "--out", str(tmp_path / "out")]) == ExitCode.BAD_INPUT
    assert f"'{chosen}'" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("options", "word"),
    [
        (["--disturb", "mass"], "QUANTITY=FACTOR"),
        (["--disturb", "mass=-1"], "factor"),
        (["--disturb", "charge=2"], "geometry"),
        (["--workers", "0"], "count = 0"),
        (["--out", "/dev/null/x"], "/dev/null/x"),
    ],
)
def test_bad_options_are_refused(options: list[str], word: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["reproduce", "5.7", "--no-figures", *options]) == ExitCode.BAD_INPUT
    assert word in capsys.readouterr().err


@pytest.fixture
def command(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> Callable[..., tuple[int, dict]]:
    def call(*arguments: str) -> tuple[int, dict]:
        code = main(["reproduce", *arguments, "--out", str(tmp_path / "out"), "--json"])
        return code, json.loads(capsys.readouterr().out)

    return call


def test_the_command_answers_in_json(command: Callable[..., tuple[int, dict]]) -> None:
    code, data = command("5.7", "--engine", "dae", "--workers", "1", "--format", "svg")
    assert code == ExitCode.SUCCESS
    assert data["status"] == "completed"
    assert {one["figure"] for one in data["rows"]} == {"5.7"}
    assert list(data["rows"][0]["ours"]) == ["dae"]
    assert Path(data["files"]["5.7"]).read_text(encoding="utf-8").startswith("<?xml")


def test_the_command_fails_where_a_difference_has_no_known_cause(command: Callable[..., tuple[int, dict]]) -> None:
    code, data = command("5.7", "--engine", "dae", "--workers", "1", "--no-figures", "--disturb", "mass=1.1")
    assert code == ExitCode.PROGRAM_ERROR
    assert data["status"] == "unexplained"
    assert data["counts"]["differs, not as recorded"] >= 1


def test_a_chapter_brings_the_statements_of_its_text() -> None:
    figures, rows = selected(["5"])
    assert [figure.number for figure in figures] == ["5.1", "5.3", "5.4", "5.6", "5.7"]
    assert {one.figure for one in rows} == {"", "5.1", "5.3", "5.4", "5.6", "5.7"}
    assert all(one.figure == "5.4" for one in selected(["5.4"])[1])
