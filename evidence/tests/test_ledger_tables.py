"""The tables of the ledger: rows are data, numbers stand in the thesis, classes are honest, and errors are noticed."""

from __future__ import annotations

import json
import re
from collections import Counter
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import tensegrity_mj as tmj
from evidence.cable.chain import Chain
from evidence.families.in_waves import tower_in_waves
from evidence.pages import sensitivity
from evidence.thesis import tables
from evidence.thesis.catalog import STATEMENTS
from evidence.thesis.chapter3.series import ELEMENTS, PLACES, SERIES, hanging, marker_places
from evidence.thesis.disturbance import GAINS, Disturbance, Quantity, disturbance_of, disturbed, disturbed_options
from evidence.thesis.experiments import EXPERIMENTS, EngineName, simulate_experiment
from evidence.thesis.expression import compiled, evaluate
from evidence.thesis.ledger import Cell, Row, Verdict
from evidence.thesis.lookup import all_measures, measured
from evidence.thesis.page import counts_by_class, summary
from evidence.thesis.statement import Class, Interval, KnownDifference
from evidence.thesis.tables import FILES, FOLDER, read_table
from tensegrity_mj.errors import FormatError, OptionError
from tensegrity_mj.studies.workers import Backend, Workers

ROWS = {one.id: one for one in STATEMENTS}
NUMBERS = [one for one in STATEMENTS if one.kind is Class.NUMBER]
THESIS = sorted((Path(__file__).resolve().parents[3] / "shared" / "thesis").glob("*.txt"))
HERE = Workers(backend=Backend.THIS_PROCESS)
# Values that were read from no curve: another coding of the same equations gave them.
CODED = (
    "4.4-off-1 4.4-off-2 4.4-off-3 4.4-off-4 4.4-peak 4.4-least 4.9-off-1 4.9-off-2 4.9-peak-beam-980 4.9-peak-beam-0 "
    "C.3-TB1-initial C.3-TB2-initial C.3-TB3-initial C.3-TB4-initial"
).split()


# ------------------------------------------------------------------------------------------------------ the numbers


def test_a_number_has_its_digits_its_line_and_a_band_about_it() -> None:
    assert len(NUMBERS) > 40
    for one in NUMBERS:
        digits = [float(text) for text in re.findall(r"\d+(?:\.\d+)?", " ".join(one.printed))]
        assert digits == list(one.value), one.id
        assert one.line > 0, one.id
        assert all(value in one.accepted for value in one.value), one.id
        assert not one.origin, one.id
    assert not [one.id for one in STATEMENTS if one.printed and one.kind is not Class.NUMBER]


@pytest.mark.skipif(not THESIS, reason="the text of the thesis is not part of the repository")
def test_every_number_stands_where_its_row_says() -> None:
    """Find each on its line, to one line either way, and on its page by the numbers at the feet of the pages."""
    lines = THESIS[0].read_text(encoding="utf-8").split("\n")
    feet = page_feet(lines)
    assert len(feet) > 90
    for one in NUMBERS:
        found = " ".join(lines[one.line - 2 : one.line + 1])
        for text in one.printed:
            assert re.search(rf"(?<![\d.]){re.escape(text)}(?!\d|\.\d)", found), one.id
        first = max(line for page, line in feet.items() if page < one.page)
        last = min(line for page, line in feet.items() if page >= one.page)
        assert first <= one.line <= last, one.id


def page_feet(lines: list[str]) -> dict[int, int]:
    """Line of the number at the foot of each page from 66 on, before the next page's running head; some are lost."""
    feet, line = {65: 1390}, 1390
    for page in range(66, 197):
        head = (
            r"(?:\d\. [A-Z]|[A-C]\. [A-Z]|Chapter |Appendix |Discussion|Examples|Concluding|[A-Z][A-Za-z\-]+ [A-Za-z]+)"
        )
        foot = re.compile(rf"(?<![\d.,])\b{page}(?: {head}|$| C$)")
        for number in range(line, min(len(lines), line + 45) + 1):
            if foot.search(lines[number - 1]):
                feet[page] = line = number
                break
    return feet


# ------------------------------------------------------------------------------------------------------ the classes


def test_values_of_another_coding_are_no_numbers_of_the_thesis() -> None:
    assert {one.id for one in STATEMENTS if one.kind is Class.INDEPENDENT} == set(CODED)
    assert all("another coding" in ROWS[name].origin for name in CODED)


def test_rows_say_what_was_chosen() -> None:
    for one in STATEMENTS:
        assert bool(one.origin) is (one.kind in (Class.CALIBRATED, Class.INDEPENDENT)), one.id
    # The seed and the start of chapter 3, the second start of chapter 6, and springs with a star fit what they show.
    assert all(ROWS[f"3.{figure}-axis"].kind is Class.CALIBRATED for figure in (4, 5, 6, 7))
    for one in STATEMENTS:
        starred = "*" in json.dumps(dict(one.arguments)) or '*"' in one.measure
        if starred or set(one.needs) & {"mirror-b", "mirror-bd", "beam-waves-doubled"}:
            assert one.kind is not Class.NUMBER, one.id
            assert one.kind is not Class.STATEMENT, one.id


def test_no_row_is_a_repeat() -> None:
    """Check that the same measure of the same runs against the same band is one row."""
    requested = Counter(
        (one.needs, one.measure, json.dumps(dict(one.arguments), sort_keys=True), one.accepted)
        for one in STATEMENTS
        if one.measure and not one.unjudged
    )
    assert [key for key, times in requested.items() if times > 1] == []


def test_a_band_that_accepts_whatever_the_axis_shows_judges_nothing() -> None:
    names = [f"C.4-TB{k}-deformation" for k in ("1", "2", "3", "4", "5", "6", "7", "6*", "7*")]
    assert all(ROWS[name].unjudged for name in names)


def test_the_same_words_have_the_same_band() -> None:
    about = [one for one in STATEMENTS if one.tolerance.startswith("'about': one step")]
    assert len(about) == 8
    for one in about:
        stated = float(re.findall(r"0\.\d+", one.stated)[0]) if "0." in one.stated else 0.20
        # Inputs are 0.05 Hz apart: the band ends between two of them, and none lies on its edge.
        assert (one.accepted.low, one.accepted.high) == pytest.approx((stated - 0.075, stated + 0.075)), one.id
    assert ROWS["C.4b-load"].accepted.high == 0.3
    assert (ROWS["C.4a-scaled"].accepted.low, ROWS["C.4a-scaled"].accepted.high) == (0.98, 1.02)
    assert ROWS["3.4-whirl-first"].accepted == ROWS["3.4-whirl"].accepted


def test_the_headline_counts_numbers_and_statements_alone() -> None:
    def row(kind: Class, verdict: Verdict, value: float = 1.0, cause: str = "because") -> Row:
        known = KnownDifference(cause, Interval(2.0, 3.0))
        statement = replace(ROWS["3.4.1-f1"], kind=kind, value=(1.0,), known=known)
        return Row(statement, {EngineName.DAE: Cell(value, verdict)})

    rows = [
        row(Class.NUMBER, Verdict.REPRODUCED, 1.09),
        row(Class.NUMBER, Verdict.REPRODUCED, 1.11),
        row(Class.NUMBER, Verdict.DIFFERS, 2.5, "no cause known"),
        row(Class.STATEMENT, Verdict.UNJUDGED),
        *[row(Class.INPUT, Verdict.REPRODUCED)] * 7,
        *[row(Class.AXIS, Verdict.DIFFERS)] * 5,
    ]
    assert summary(rows) == (
        "3 numbers that the thesis states: 2 are reproduced, 1 differ (1 without a known cause), 0 cannot be judged; 1 "
        "are within 10 % of what is stated. 1 of its statements: 0 are reproduced, 0 differ (0 without a known cause), "
        "1 cannot be judged"
    )
    found = counts_by_class(rows)
    assert (found["input"]["rows"], found["axis"]["differs"], found["number"]["within 10 %"]) == (7, 5, 1)


def test_within_ten_percent_of_a_range_or_of_a_negative_number() -> None:
    one = replace(ROWS["3.4.1-f1"], value=(0.30, 0.35))
    assert [one.is_within(x, 0.1) for x in (0.269, 0.271, 0.32, 0.384, 0.386)] == [False, True, True, True, False]
    assert replace(one, value=(-2.0,)).is_within(-2.19, 0.1)
    assert not replace(one, value=()).is_within(1.0, 0.1)


# ------------------------------------------------------------------------------------------------------- the tables


def test_every_table_is_read_and_every_measure_of_a_row_exists() -> None:
    assert sum(len(read_table(FOLDER / f"{name}.toml")) for name in FILES) == len(STATEMENTS)
    for one in STATEMENTS:
        assert not one.measure or one.measure in all_measures() or compiled(one.measure, tuple(all_measures()))
    with pytest.raises(OptionError, match="'nothing'"):
        measured(replace(STATEMENTS[0], measure="nothing"), {})


GOOD = """
[texts]
why = "because"
[[rows]]
id = "5.9-x"
class = "number"
where = "§5"
page = 120
words = "what"
stated = "1 m"
band = [0.9, 1.1]
reason = "why"
measure = "spread_of_active"
runs = ["pinned"]
differs.ours = [2, 3]
differs.cause = "why"
"""


def test_texts_stand_for_their_names(tmp_path: Path) -> None:
    path = tmp_path / "t.toml"
    path.write_text(GOOD, encoding="utf-8")
    (one,) = read_table(path)
    assert (one.tolerance, one.kind, one.accepted) == ("because", Class.NUMBER, Interval(0.9, 1.1))
    assert one.known == KnownDifference("because", Interval(2.0, 3.0))


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (('class = "number"', 'class = "nice"'), "independent computation"),
        (('measure = "spread_of_active"', 'measure = "none"'), "measure = 'none'"),
        (('measure = "spread_of_active"', ""), "neither a measure"),
        (("band = [0.9, 1.1]", "band = [1.1, 0.9]"), "not above the second"),
        (("band = [0.9, 1.1]", "band = [1.1]"), "two numbers"),
        (("page = 120", 'page = "120"'), "page = '120'"),
        (("page = 120\n", ""), "'page' is missing"),
        (('unit = "m"', ""), ""),
        (("page = 120", "page = 120\npaige = 1"), "unknown key 'paige'"),
        (("[[rows]]", "[[rows"), "cannot be read"),
    ],
)
def test_a_bad_table_is_refused_with_its_row(tmp_path: Path, change: tuple[str, str], word: str) -> None:
    path = tmp_path / "t.toml"
    path.write_text(GOOD.replace(*change), encoding="utf-8")
    if not word:
        assert len(read_table(path)) == 1
        return
    with pytest.raises(FormatError, match=re.escape(word)) as caught:
        read_table(path)
    assert "t.toml" in str(caught.value)


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("max(sums(a)", "is no expression"),
        ("max(total(a))", "has the name 'total'"),
        ("a.nodes.tofile('x')", "is none of a measure or function"),
        ("a.__class__", "is not allowed"),
        ("{x for x in a}", "is not allowed"),
        ("[y for x in a]", "has the name 'y'"),
        ("norm(a, axis=0)", "is none of a measure or function"),
        ("(lambda: 0)()", "is none of a measure or function"),
    ],
)
def test_an_expression_is_made_of_measures_alone(text: str, word: str) -> None:
    with pytest.raises(ValueError, match=re.escape(word)):
        compiled(text, tuple(all_measures()))


def test_an_expression_has_the_runs_of_its_row_in_their_order() -> None:
    first, second = (SimpleNamespace(lyapunov=np.array(values)) for values in ([6.0, 1.0], [3.0, 8.0]))
    assert evaluate("a.lyapunov[0] / b.lyapunov[0]", {}, [first, second]) == 2.0
    assert evaluate("max(a.lyapunov - b.lyapunov)", {}, [first, second]) == 3.0
    assert evaluate("max(1, 2 * b.lyapunov[1])", {}, [first, second]) == 16.0
    scaled = {"scaled": lambda run, label: (run.lyapunov[0], label)}
    assert evaluate('[scaled(a, k) for k in ["x", "y"] if k != "x"]', scaled, [first]) == [(6.0, "y")]


def test_two_rows_of_one_id_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "t.toml"
    path.write_text(GOOD + GOOD[GOOD.index("[[rows]]") :], encoding="utf-8")
    with pytest.raises(FormatError, match=r"two rows have the id '5\.9-x'"):
        read_table(path)


# ----------------------------------------------------------------------------------------------------- disturbances


def test_a_disturbance_changes_its_quantity_alone() -> None:
    scene = tmj.load_scene("prism")
    heavy = disturbed(scene, Disturbance(Quantity.MASS, 1.1))
    np.testing.assert_allclose(heavy.structure.rod_masses, 1.1 * scene.structure.rod_masses, rtol=1e-15)
    assert heavy.structure.strings == scene.structure.strings
    stiff = disturbed(scene, Disturbance(Quantity.STIFFNESS, 1.1))
    assert [s.stiffness for s in stiff.structure.strings] == [1.1 * s.stiffness for s in scene.structure.strings]
    np.testing.assert_allclose(stiff.structure.rest_lengths, scene.structure.rest_lengths, rtol=1e-15)
    long = disturbed(scene, Disturbance(Quantity.GEOMETRY, 1.1))
    np.testing.assert_allclose(long.structure.rod_lengths, 1.1 * scene.structure.rod_lengths, rtol=1e-14)
    assert long.target is not None
    assert scene.target is not None
    np.testing.assert_allclose(long.target.nodes, 1.1 * scene.target.nodes, rtol=1e-14)
    np.testing.assert_array_equal(long.structure.rod_masses, scene.structure.rod_masses)
    assert disturbed(scene, None) is scene
    for nothing in (Quantity.DAMPING, Quantity.GAIN):  # the prism's strings have none, and the gain is the law's
        assert disturbed(scene, Disturbance(nothing, 1.1)) is scene


def test_damping_is_that_of_the_water_too() -> None:
    scene = tower_in_waves(stages=3, duration=0.1)
    assert scene.water is not None
    less = disturbed(scene, Disturbance(Quantity.DAMPING, 0.9)).water
    assert less is not None
    assert (less.drag, less.added_mass) == (0.9 * scene.water.drag, scene.water.added_mass)


def test_the_gain_is_that_of_the_law() -> None:
    error = Disturbance(Quantity.GAIN, 1.1)
    cross, prism = tmj.load_scene("cross"), tmj.load_scene("prism")
    assert disturbed_options(cross, None, {"sums": []}, error) == {"sums": [], "natural_frequency": 1.1}
    assert disturbed_options(prism, "projection", {"decay_rate": 0.2}, error)["decay_rate"] == pytest.approx(0.22)
    assert disturbed_options(prism, "projection", {"decay_rate": 0.2}, None) == {"decay_rate": 0.2}
    assert {one.law or one.load().control.law for one in EXPERIMENTS.values()} <= set(GAINS)  # type: ignore[union-attr]


@pytest.mark.parametrize("factor", [0.9, 1.1])
def test_markers_stay_where_they_are_on_a_rope_of_another_length(factor: float, tmp_path: Path) -> None:
    """The second is at 2.88 m of 2.93 m: in place it would hang below a rope a tenth shorter."""
    longer = Disturbance(Quantity.GEOMETRY, factor)
    rope = hanging(ELEMENTS[0])
    there = Chain.of(rope.structure).weights(PLACES)
    scaled = Chain.of(disturbed(rope, longer).structure).weights(marker_places(longer))
    np.testing.assert_allclose(scaled, there, atol=1e-14)  # sums of some ten lengths, relative to one of them
    assert marker_places(Disturbance(Quantity.MASS, factor)) == PLACES
    run = SERIES["starts"].compute(EngineName.DAE, tmp_path, longer, workers=HERE)
    assert run.results is not None
    assert np.isfinite(run.results.amplitudes).all()


def test_a_bad_disturbance_is_refused() -> None:
    with pytest.raises(OptionError, match="factor"):
        Disturbance(Quantity.MASS, 0.0)
    with pytest.raises(OptionError, match="quantity"):
        Disturbance("weight", 1.1)  # type: ignore[arg-type]
    assert disturbance_of(Disturbance(Quantity.MASS, 1.1).plain) == Disturbance(Quantity.MASS, 1.1)


def test_stiffness_changes_nothing_where_the_law_sets_u() -> None:
    """Check the reason for which `applies` leaves it out: rest lengths follow from u, so forces agree to round-off."""
    one = replace(EXPERIMENTS["prism"], interval=1.0)
    usual = simulate_experiment(one, EngineName.DAE)
    stiff = simulate_experiment(one, EngineName.DAE, Disturbance(Quantity.STIFFNESS, 1.1))
    np.testing.assert_allclose(stiff.nodes, usual.nodes, rtol=0, atol=1e-9)  # error control at 1e-10 over 10 s
    assert not sensitivity.applies("prism", Quantity.STIFFNESS)


# ------------------------------------------------------------------------------------------------------ sensitivity


def test_what_rows_notice_is_found_and_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A band that accepts any value notices no mass, a narrow one some; a second call runs nothing."""
    file = tmp_path / "table.json"
    file.write_text(json.dumps({"rows": {"5.4-uniform": {"mass": 1}, "gone": {}}}), encoding="utf-8")
    wide = replace(ROWS["6.8-similar"], accepted=Interval(0.0, 100.0))
    narrow = replace(ROWS["6.8-similar"], id="6.9-similar", accepted=Interval(0.0012, 0.0014))  # it is 0.0013 m
    monkeypatch.setattr(sensitivity, "selected", lambda chosen: ([], [wide, narrow] if chosen else STATEMENTS))
    made = sensitivity.sensitivity(["6.8"], tmp_path, file, sizes=(10,), workers=HERE)
    assert "mass" not in made["rows"]["6.8-similar"]
    assert made["rows"]["6.9-similar"]["mass"] == 10
    assert made["rows"]["5.4-uniform"] == {"mass": 1}  # rows that are not requested stay
    assert "gone" not in made["rows"]

    def nothing(*arguments: object) -> None:
        raise AssertionError("it runs again")

    monkeypatch.setattr("evidence.thesis.runs.simulate_experiment", nothing)
    assert sensitivity.sensitivity(["6.8"], tmp_path, file, sizes=(10,), workers=HERE) == made


def test_the_table_of_errors_is_of_rows_that_are_studied(monkeypatch: pytest.MonkeyPatch) -> None:
    table = json.loads(tables.SENSITIVITY.read_text(encoding="utf-8"))
    requested = {one.id for one in sensitivity.evidence(STATEMENTS)}
    assert set(table["rows"]) <= requested
    for name, found in table["rows"].items():
        assert set(found) <= {quantity.value for quantity in Quantity}, name
        assert set(found.values()) <= set(sensitivity.SIZES), name
    monkeypatch.setattr(tables, "_notices", lambda: {"3.4.1-f1": {"geometry": 10, "mass": 1}, "3.4.1-f2": {}})
    assert tables.noticed(ROWS["3.4.1-f1"]) == "geometry 10 %, mass 1 %"
    assert tables.noticed(ROWS["3.4.1-f2"]) == "nothing"
    assert tables.noticed(ROWS["3.8-first"]) == "not studied"
    assert tables.noticed(ROWS["3.4-axis"]) == "–"
    assert tables.noticed(ROWS["C.1.3-euler"]) == "a formula, of no run"
