"""The pages that the checkout shows, their blocks of code and their links."""

from __future__ import annotations

import json
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted(
    path
    for pattern in ("*.md", "docs/**/*.md", "evidence/*.md", "evidence/docs/*.md", "[mt]*/**/README.md")
    for path in ROOT.glob(pattern)
    if path.name != "paper.md"
)
NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))


def name_of(page: Path) -> str:
    """A page's path in the checkout."""
    return page.relative_to(ROOT).as_posix()


def blocks(page: Path, language: str) -> list[str]:
    """The blocks of code of a language."""
    found = re.findall(rf"^( *)```{language}\n(.*?)^ *```$", page.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)
    return [re.sub(rf"^{indent}", "", code, flags=re.MULTILINE) for indent, code in found]


def cells(path: Path, kind: str = "code") -> list[str]:
    """The cells of a notebook."""
    found = json.loads(path.read_text(encoding="utf-8"))["cells"]
    return ["".join(cell["source"]) for cell in found if cell["cell_type"] == kind]


def text_of(page: Path) -> str:
    """A page without its code, where no link is one; a notebook's cells of text."""
    if page.suffix == ".ipynb":
        return "\n\n".join(cells(page, "markdown"))
    text = re.sub(r"^( *)```.*?^ *```$", "", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
    return re.sub(r"`[^`\n]+`", "code", text)


def anchors(page: Path) -> set[str]:
    """The anchors of a page's headings, as the code host makes them of their text."""
    outside = re.sub(r"^( *)```.*?^ *```$", "", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
    found: set[str] = set()
    for heading in re.findall(r"^#+ +(.+?) *$", outside, re.MULTILINE):
        words = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading)  # a link counts by its text
        slug = re.sub(r"[^\w\- ]", "", words.lower()).replace(" ", "-")
        found.add(next(one for one in (slug, *(f"{slug}-{k}" for k in range(1, 99))) if one not in found))
    return found


def links(page: Path) -> list[str]:
    """Where the links and pictures of a page lead to."""
    return re.findall(r"\]\(([^()\s]+)\)", text_of(page))
