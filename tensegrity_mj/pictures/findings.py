"""How a page begins: a verdict in a sentence, then what was found, the most important first, marked good to bad."""

from __future__ import annotations

import enum
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

MOST = 7  # findings that are shown at once


class Mark(enum.Enum):
    """What a finding means for whoever relies on the result, the worst first."""

    BAD = "bad"
    LIMITED = "limited"
    GOOD = "good"


@dataclass(frozen=True)
class Finding:
    """A mark, and a sentence or a few of plain text."""

    mark: Mark
    text: str


def mark_of(good: int, total: int) -> Mark:
    """Good where all are, bad where none is."""
    return Mark.GOOD if good == total else Mark.LIMITED if good else Mark.BAD


def opening_of(verdict: str, findings: Sequence[Finding] = ()) -> list[str]:
    """HTML for `write_sections`: the worst findings first, in their order, those beyond seven folded away."""
    ranked = sorted((one for one in findings if one.text), key=lambda one: list(Mark).index(one.mark))
    parts = [f'<p class="verdict">{escape(verdict)}</p>', *map(_shown, ranked[:MOST])]
    if len(ranked) > MOST:
        rest = "".join(map(_shown, ranked[MOST:]))
        parts.append(f"<details><summary>{len(ranked) - MOST} more</summary>{rest}</details>")
    return parts


def _shown(finding: Finding) -> str:
    mark = finding.mark.value
    return f'<div class="finding"><div class="mark {mark}">{mark}</div><div>{escape(finding.text)}</div></div>'
