"""Every link between the pages of the checkout leads somewhere, anchors included; the code host needs no site."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from pages import NOTEBOOKS, PAGES, ROOT, anchors, links, name_of


def broken(page: Path, link: str) -> str:
    """What is wrong with a link, or nothing."""
    if link.startswith(("https://", "http://", "mailto:")):
        return ""
    path, _, anchor = link.partition("#")
    target = (page.parent / path).resolve() if path else page
    if not target.exists():
        return f"{link}: there is no such file"
    if anchor and target.suffix == ".md" and anchor not in anchors(target):
        return f"{link}: the page has no such heading"
    return ""


@pytest.mark.parametrize("page", [*PAGES, *NOTEBOOKS], ids=name_of)
def test_links_lead_to_files_and_headings(page: Path) -> None:
    assert not [wrong for link in links(page) if (wrong := broken(page, link))]


def test_there_are_links_and_a_broken_one_is_found(tmp_path: Path) -> None:
    assert sum(len(links(page)) for page in PAGES) > 150
    page, other = tmp_path / "page.md", tmp_path / "other.md"
    page.write_text(
        "# A `b`: c, d\n\n# Twice\n\n# Twice\n\n```\n# no heading [a](nowhere.md)\n```\n[x](#a-b-c-d) [y](#twice-1)\n"
    )
    other.write_text("[a](page.md#twice) [b](page.md#no-heading) [c](missing.md) [d](https://toml.io)\n")
    assert anchors(page) == {"a-b-c-d", "twice", "twice-1"}
    assert [broken(page, link) for link in links(page)] == ["", ""]
    assert [broken(other, link) for link in links(other)] == [
        "",
        "page.md#no-heading: the page has no such heading",
        "missing.md: there is no such file",
        "",
    ]


def test_the_changelog_is_one_page_of_short_entries() -> None:
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert text.count("\n## [Unreleased]\n") == 1
    for release in text.partition("\n## ")[2].split("\n## "):
        assert len(release) < 12_000, (
            f"{release[:20]}: more than a page; a rebase may bring entries of before 0.1.0 back"
        )
    long = [line for line in text.splitlines() if len(line) > 200]
    assert not long, "an entry has one line of at most 200 characters; its details belong into the docs"


def test_the_readme_is_short_and_its_first_commands_set_everything_up() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(text.encode()) <= 5000
    commands = re.findall(r"^(bash scripts/\w+\.sh|tensegrity-mj .*?)(?: +#.*)?$", text, re.MULTILINE)
    assert commands == ["bash scripts/demo.sh", "bash scripts/test.sh"]
    code = text.partition("```python\n")[2].partition("```")[0]
    assert len([line for line in code.splitlines() if line]) <= 13


def test_contributing_is_short_and_has_every_room() -> None:
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    assert len(text.encode()) <= 8000
    folders = {path.parent.name for path in (ROOT / "tensegrity_mj").glob("*/__init__.py")}
    table = text.partition("## The rooms")[2].partition("\n\n`models/`")[0]
    assert folders <= set(re.findall(r"`(\w+)/`", table))


def test_the_page_of_scenes_has_every_scene() -> None:
    rows = re.findall(r"^\| `(\w+)` \|", (ROOT / "docs" / "scenes.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert sorted(rows) == sorted(path.parent.name for path in ROOT.glob("models/*/scene.toml"))


def test_each_row_of_the_table_of_peers_links_a_test_in_our_column() -> None:
    table = [line for line in (ROOT / "docs" / "peers.md").read_text(encoding="utf-8").splitlines() if line[:1] == "|"]
    rows = [line.split("|")[1:3] for line in table[2:]]
    assert len(rows) > 15
    for what, ours in rows:
        if what.strip() != "language":
            assert re.search(r"\]\(\.\./tests/\w+/test_\w+\.py\)", ours), what
