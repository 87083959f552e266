"""Judgements: a verdict in a sentence and a list of findings, from which text, page and JSON are all made."""

from __future__ import annotations

import enum
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

from tensegrity_mj.basics.texts import aligned

MOST = 7  # findings that are shown at once


class Mark(enum.Enum):
    """Marks of findings by their meaning for whoever relies on the result, the worst first."""

    BAD = "bad"
    LIMITED = "limited"
    UNJUDGED = "not judged"
    GOOD = "good"


@dataclass(frozen=True)
class Finding:
    """A mark, and a sentence or a few of plain text.

    Attributes:
        mark: None of a fact that is not judged; the opening of a page leaves it out.
        name: subject of the text; one without goes on with the finding before.
    """

    mark: Mark | None
    text: str
    name: str = ""


@dataclass(frozen=True)
class Judgement:
    """A verdict, and findings in the order in which they are reported."""

    verdict: str
    findings: Sequence[Finding] = ()

    def sentences(self) -> Iterator[tuple[Mark, str]]:
        """The judged findings in words, each with the name that it is under."""
        name = ""
        for one in self.findings:
            name = one.name or name
            if one.mark is not None and one.text:
                yield one.mark, f"{name[:1].upper()}{name[1:]}: {one.text}" if name else one.text

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON, under "verdict" and "findings"."""
        findings = [
            {"mark": None if one.mark is None else one.mark.value, "name": one.name, "text": one.text}
            for one in self.findings
            if one.text
        ]
        return {"verdict": self.verdict, "findings": findings}

    def lines(self) -> list[str]:
        """Lines for a terminal: the verdict, then the findings with their marks and names in columns."""
        rows = [("" if one.mark is None else one.mark.value, one.name, one.text) for one in self.findings if one.text]
        columns = [0, *([1] if any(row[1] for row in rows) else []), 2]
        return [*([self.verdict] if self.verdict else []), *aligned([[row[k] for k in columns] for row in rows])]

    def html(self) -> list[str]:
        """The opening of a page: the worst findings first, in their order, those beyond seven folded away."""
        ranked = sorted(self.sentences(), key=lambda one: list(Mark).index(one[0]))
        shown = [
            f'<div class="finding"><div class="mark {mark.value.replace(" ", "-")}">{mark.value}</div>'
            f"<div>{escape(text)}</div></div>"
            for mark, text in ranked
        ]
        parts = [f'<p class="verdict">{escape(self.verdict)}</p>', *shown[:MOST]]
        if len(shown) > MOST:
            parts.append(f"<details><summary>{len(shown) - MOST} more</summary>{''.join(shown[MOST:])}</details>")
        return parts


def mark_of(good: int, total: int) -> Mark:
    """Good where all are, bad where none is, not judged where there is none."""
    if not total:
        return Mark.UNJUDGED
    return Mark.GOOD if good == total else Mark.LIMITED if good else Mark.BAD
