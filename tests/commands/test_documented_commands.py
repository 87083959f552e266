"""Command lines that the guides show are ones that the parser takes; those of --help are in test_cli."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from tensegrity_mj.cli import build_parser

ROOT = Path(__file__).resolve().parents[2]
PAGES = [
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")),
    *sorted((ROOT / "docs").rglob("*.md")),
    *sorted((ROOT / "models").glob("*/README.md")),
]
HELD_OPEN = re.compile(r"[<\[]|\.\.\.|^[A-Z][A-Z.]*$|=[A-Z]+$")  # a word to be put in or left out: <name>, SCENE, X=Y


def test_lines_of_code_are_taken() -> None:
    parser, count, wrong = build_parser(), 0, []
    for page in PAGES:
        for line in page.read_text(encoding="utf-8").replace("\\\n", " ").splitlines():
            found = re.match(r" *(?:\.venv/bin/)?tensegrity-mj (\S[^`]*)$", line)
            words = shlex.split(found[1].partition(" > ")[0], comments=True) if found else []
            if not words or any(HELD_OPEN.search(word) for word in words):
                continue
            count += 1
            try:
                parser.parse_args(words)
            except Exception as error:
                wrong.append(f"{page.name}: {line.strip()}: {error}")
    assert not wrong, "\n".join(wrong)
    assert count > 60


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_commands_and_options_named_in_the_text_exist(page: Path) -> None:
    for line in re.findall(r"`tensegrity-mj ([^`]+)`", page.read_text(encoding="utf-8")):
        command, words = build_parser(), line.split()
        while words and words[0] in command.commands:
            command = command.commands[words.pop(0)]
        assert command.words or words == ["--help"], line
        options = {word.partition("=")[0] for word in words if word.startswith("--")}
        assert options <= set(command._option_string_actions), line
