"""How pages begin: the verdict first, the worst findings before others, no more than seven at once."""

from __future__ import annotations

import re
from html import escape

import pytest

import tensegrity_mj as tmj
from tensegrity_mj.pictures.findings import MOST, Finding, Judgement, Mark, mark_of
from tensegrity_mj.pictures.page import Section, Table, write_sections
from tensegrity_mj.statics.study import analyse
from tensegrity_mj.studies.page import _findings
from tensegrity_mj.studies.sweep import Row
from tensegrity_mj.studies.validation import judging
from tensegrity_mj.studies.validation import study as validation_page


@pytest.mark.parametrize(("good", "total", "mark"), [(3, 3, "good"), (1, 3, "limited"), (0, 3, "bad")])
def test_marks_go_by_how_many_are_good(good, total, mark):
    assert mark_of(good, total) is Mark(mark)


def test_findings_are_ranked_and_those_beyond_seven_are_folded():
    marks = [Mark.GOOD, Mark.BAD, Mark.LIMITED] * 3
    html = "".join(Judgement("All is <well>.", [Finding(mark, f"number {k}") for k, mark in enumerate(marks)]).html())
    assert html.startswith('<p class="verdict">All is &lt;well&gt;.</p>')
    assert [int(k) for k in re.findall(r"number (\d)", html)] == [1, 4, 7, 2, 5, 8, 0, 3, 6]
    before, _, folded = html.partition("<details>")
    assert before.count('class="finding"') == MOST
    assert folded.startswith("<summary>2 more</summary>")


def test_what_is_empty_is_no_finding():
    assert len(Judgement("It is.", [Finding(Mark.GOOD, ""), Finding(None, "A fact.")]).html()) == 1


def test_the_opening_stands_before_everything_else(tmp_path):
    table = Table("all", ("a",), [("b",)], folded=True)
    path = write_sections(
        tmp_path / "p.html", "T", "intro", [Section("S", (), [table])], opening=Judgement("So.").html()
    )
    text = path.read_text(encoding="utf-8")
    assert text.index("<h1>") < text.index('class="verdict">') < text.index("intro") < text.index("<details>")


def test_the_page_of_statics_says_whether_it_stands_and_shows_pictures_before_tables(tmp_path):
    scene = tmj.load_scene("truss_arm")
    text = analyse(scene).save_page(tmp_path / "s.html").read_text(encoding="utf-8")
    assert "<h1>Statics of truss_arm</h1>" in text  # a line on a phone; where it is from comes below
    assert f"<p>The scene is from {escape(scene.source)}. " in text
    assert '<p class="verdict">truss_arm is in stable equilibrium; ' in text
    assert text.index("<figure>") < text.index("<table>")
    assert 1 <= text.count('class="finding"') <= MOST


def validation(outcome: str, word: str, value: float, words: dict[str, str]) -> dict:
    error = {"initial": 1.0, "final": value}
    judged = {"word": word, "quantity": "it is", "value": value, "bound": 0.05, "unit": "m", "reason": ""}
    nominal = {"outcome": outcome, "error": error, "end_time": 2.0, "judgement": judged}
    return {
        "scene": {"name": "prism"},
        "law": {"description": None, "from": "lyapunov"},
        "nominal": {"engines": {"mujoco": nominal}},
        **{section: {"mujoco": {"word": one}} for section, one in words.items()},
        "summary": ["It runs.", "Masses.", "More.", "Sampling."],
        "summary_sections": ["nominal", "mass", "mass", "sampling"],
    }


def test_a_validation_is_judged_by_its_sections():
    data = validation("converged", "good", 0.0045, {"sampling": "good", "mass": "limited"})
    assert judging.verdict(data) == (
        "lyapunov brings prism in MuJoCo to its target, to 4.5 mm; of 2 tests it is good in 1, limited in 1."
    )
    found = validation_page.judgement_of(data).findings
    assert [one.mark for one in found] == [Mark.GOOD, Mark.LIMITED, Mark.GOOD]
    assert found[1].text == "Masses. More."


def test_a_run_that_needs_more_time_is_no_failure():
    data = validation("still moving", "limited", 0.2, {"sampling": "good", "mass": "not judged"})
    assert judging.verdict(data) == ("lyapunov on prism in MuJoCo is still moving after 2 s, 0.2 m from its target.")
    assert [one.mark for one in validation_page.judgement_of(data).findings] == [Mark.LIMITED, Mark.UNJUDGED, Mark.GOOD]
    assert "does not do" in judging.verdict(validation("off target", "bad", 0.2, {}))


def test_what_is_not_judged_has_a_mark_of_its_own():
    (_, shown) = Judgement("It is.", [Finding(Mark.UNJUDGED, "No target.")]).html()
    assert '<div class="mark not-judged">not judged</div>' in shown


def test_a_sweep_counts_its_doubtful_points_in_words():
    bad, good = (Row({"law.gain": 1}, status, reason, {}) for status, reason in (("failed", "no"), ("completed", "")))
    (one,) = _findings([bad, good], [], [])
    assert (one.mark, one.text) == (Mark.LIMITED, "1 point ended early or is in doubt, by: no.")
    (one,) = _findings([bad, bad], [], [])
    assert (one.mark, one.text) == (Mark.BAD, "2 points ended early or are in doubt, the first: no.")
