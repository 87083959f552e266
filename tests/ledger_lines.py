"""A Markdown ledger as data."""

from __future__ import annotations

import re


def lines_of(text: str) -> dict[str, str]:
    """The lines of a Markdown ledger by their row's id."""
    return {match[1]: line for line in text.splitlines() if (match := re.match(r"\| `([^`]+)` \|", line))}
