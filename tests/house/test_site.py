"""The documentation site: pages made of what they describe, and a build without a warning."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest
from only_extra import only_extra
from pages import PAGES, ROOT

import tensegrity_mj as tmj
from tensegrity_mj.cli import build_parser
from tensegrity_mj.commands.parser import Parser
from tensegrity_mj.model.text.sources import scene_names


@pytest.fixture
def site_pages(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """scripts/site_pages.py."""
    monkeypatch.syspath_prepend(ROOT / "scripts")
    import site_pages

    return site_pages


def test_the_gallery_has_every_scene_with_picture_source_and_film(site_pages: ModuleType) -> None:
    text = site_pages.gallery()
    assert site_pages.scenes() == scene_names()
    for name in scene_names():
        card = text.partition(f"](scenes/{name}.md)**")[2].partition("\n-   ")[0]
        assert f"scenes/{name}.png" in card
        assert tmj.load_scene(name).source[:40].replace("&", "&amp;") in card
        assert re.search(rf"^ +tensegrity-mj run {name} .*--video", card, re.MULTILINE)
        assert 10 < len(site_pages.summary(name)) < 250
    for words in ("posts, one of which shakes it; 1 string, 8 s", "sway on the lowest; 24 strings, 4 bodies, 3 s"):
        assert words in text


def commands_in(parser: Parser) -> Iterator[Parser]:
    """Every command that runs something."""
    for command in parser.commands.values():
        yield from commands_in(command) if command.commands else [command]


def test_the_page_of_commands_has_every_command_and_option(site_pages: ModuleType) -> None:
    sections = re.split(r"^#{3,4} ", site_pages.commands(), flags=re.MULTILINE)
    found = {section.partition("\n")[0]: section for section in sections}
    commands = list(commands_in(build_parser()))
    assert len(commands) > 15
    for command in commands:
        for option in set(command._option_string_actions) - {"-h", "--help", "--json"}:
            assert f"<code>{option}".replace("_", "&#95;") in found[command.words], f"{command.words} {option}"


def test_the_pages_of_the_api_have_every_name_once(site_pages: ModuleType) -> None:
    pages = site_pages.api()
    shown = [path for text in pages.values() for path in re.findall(r"^::: (\S+)$", text, re.MULTILINE)]
    assert len(shown) == len(set(shown)) > 100
    rooms = {
        path.parent for path in (ROOT / "tensegrity_mj").rglob("__init__.py") if "face(__name__)" in path.read_text()
    }
    assert {".".join(path.relative_to(ROOT / "tensegrity_mj").parts) for path in rooms} - {""} <= set(site_pages.ROOMS)
    ends = {path.rpartition(".")[2] for path in shown}
    for name in tmj.__all__:
        assert name in ends or f"{name}.md" in pages, name


@pytest.mark.slow
def test_the_site_builds_without_a_warning(tmp_path: Path) -> None:
    pytest.importorskip("mkdocs", reason="the extra docs is not installed")
    pytest.importorskip("mkdocstrings")
    # Not --quiet, with which mkdocs 1.6 counts no warning.
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path / "site")]
    environment = {**only_extra(tmp_path, "docs"), "NO_MKDOCS_2_WARNING": "1", "SITE_SEARCH": "false"}
    build = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)
    assert build.returncode == 0, build.stderr
    assert '"$schema"' in (tmp_path / "site" / "schema.json").read_text(encoding="utf-8")
    assert "simulate" in (tmp_path / "site" / "api" / "index.html").read_text(encoding="utf-8")
    assert (tmp_path / "site" / "scenes" / "prism.html").exists()
    notebook = (tmp_path / "site" / "notebooks" / "first_structure.html").read_text(encoding="utf-8")
    assert notebook.count("m between MuJoCo and the DAE") == 2  # in the cell, and printed by it
    assert notebook.count("data:image/png;base64,") == 1
    # By this class docs/site.css breaks the lines of commands, which cards and phones would cut off.
    assert 'class="language-bash highlight"' in (tmp_path / "site" / "gallery.html").read_text(encoding="utf-8")
    # No page loads anything from elsewhere.
    for page in (tmp_path / "site").glob("*.html"):
        loaded = re.findall(r'<(?:script|img|link)[^>]* (?:src|href)="(https?://[^"]+)"', page.read_text("utf-8"))
        assert not loaded, page.name


def test_commands_stand_in_blocks_whose_lines_break_on_a_phone() -> None:
    for path in PAGES:
        kind = None
        for line in path.read_text(encoding="utf-8").splitlines():
            if line.lstrip().startswith("```"):
                kind = line.strip().strip("`") if kind is None else None
            elif re.match(r"(    )?tensegrity-mj [a-z]+ ", line):
                assert kind == "bash", f"{path.name}: {line}"


def test_the_paper_cites_what_is_there_and_its_numbers_are_those_of_the_docs() -> None:
    text = (ROOT / "paper.md").read_text(encoding="utf-8")
    entries = set(re.findall(r"^@\w+\{(\w+),", (ROOT / "paper.bib").read_text(encoding="utf-8"), re.MULTILINE))
    assert set(re.findall(r"[\[ ]@(\w+)(?=[\];])", text)) == entries
    measured = text.partition("# Accuracy, size and speed")[2].partition("**Speed.**")[0]
    flat = " ".join((ROOT / "docs" / "trust.md").read_text(encoding="utf-8").split())
    numbers = re.findall(
        r"\d+\.\d+e-\d+|\d{3,} of \d{3,}|median of [\d.]+|\d+ were right|\d+ warned|\d+ of \d+ random", measured
    )
    assert len(numbers) > 6
    assert not [number for number in numbers if number not in flat]
