"""The ledger of evidence/docs/reproduction.md as data."""

from __future__ import annotations

import re
from pathlib import Path

DOC = Path(__file__).resolve().parents[2] / "docs" / "reproduction.md"


def lines_of(text: str) -> dict[str, str]:
    """The lines of a Markdown ledger by their row's id."""
    return {match[1]: line for line in text.splitlines() if (match := re.match(r"\| `([^`]+)` \|", line))}
