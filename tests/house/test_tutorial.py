"""The tutorials, walked as a reader would: files saved, code and commands run in order, and what is shown printed."""

from __future__ import annotations

import contextlib
import io
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from pages import ROOT
from stable_baselines import stand_in

from tensegrity_mj.cli import main
from tensegrity_mj.commands.doctor import check_opengl
from tensegrity_mj.commands.render import USUAL

PAGE = (ROOT / "docs" / "tutorial.md").read_text(encoding="utf-8")
SAVED = re.compile(r"this\s+as\s+`([\w.]+)`.*?\n```\w+\n(.*?)^```$", re.DOTALL | re.MULTILINE)
COMMANDS = re.compile(r"^```bash\n(.*?)^```$(?:\n\n```text\n(.*?)^```$)?", re.DOTALL | re.MULTILINE)


TRADES = ["robot.md", "footbridge.md", "controller.md"]  # of docs/tutorials
FENCED = re.compile(r"^```(\w+)\n(.*?)^```$", re.DOTALL | re.MULTILINE)


def missing(shown: str, printed: str) -> list[str]:
    """The lines of what a page shows that were not printed; "..." and blanks stand for anything and any blanks."""
    lines = [" ".join(line.split()) for line in printed.splitlines()]
    patterns = [re.escape(" ".join(line.split())).replace(re.escape("..."), ".*") for line in shown.splitlines()]
    return [pattern for pattern in patterns if not any(re.fullmatch(pattern, line) for line in lines)]


def test_lines_that_were_not_printed_are_found() -> None:
    assert missing("a  1\nb ... m\n", "a 1\nb   2.5 m\n") == []
    assert missing("a 1\nb 3\n", "a 1\nb 3.5\n") == [r"b\ 3"]


def printed_by(language: str, code: str, page: str, names: dict[str, object]) -> str:
    """Run a block and return what it printed on stdout.

    Commands of the package run here, as its entry point runs them: a process of its own takes a second to import it.
    """
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        if language == "python":
            exec(compile(code, page, "exec"), names)
            return out.getvalue()
        lines = [shlex.split(line) for line in code.splitlines()]
        if all(words[:1] == ["tensegrity-mj"] for words in lines):
            for words in lines:
                assert main(words[1:]) == 0, words
            return out.getvalue()
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    run = subprocess.run(["bash", "-ec", code], env={**os.environ, "PATH": path}, capture_output=True, text=True)
    assert run.returncode == 0, f"{code}\n{run.stderr}"
    return run.stdout


@pytest.mark.slow
def test_the_tutorial_runs_in_an_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(USUAL, "fps", 5.0)  # of its film
    files = dict(SAVED.findall(PAGE))
    assert set(files) == {"mast.toml", "calm.py", "swing.py"}
    for name, text in files.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    found = COMMANDS.findall(PAGE)
    assert len(found) >= 8
    draws = check_opengl().works
    for command, shown in found:
        if ".mp4" in command and not draws:
            continue
        printed = printed_by("bash", command, "docs/tutorial.md", {})
        assert not missing(shown, printed), f"{command}\n{printed}"
    assert (tmp_path / "report" / "validation.html").stat().st_size > 10_000
    assert (tmp_path / "free.png").exists()
    assert (tmp_path / "mast.mp4").exists() == draws


@pytest.mark.slow
@pytest.mark.parametrize("page", TRADES)
def test_the_tutorials_of_the_trades_run_in_an_empty_folder(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if page == "robot.md":
        pytest.importorskip("gymnasium")
    text = (ROOT / "docs" / "tutorials" / page).read_text(encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    files = dict(SAVED.findall(text))
    for name, content in files.items():
        Path(name).write_text(content, encoding="utf-8")
    for name in files:
        monkeypatch.delitem(sys.modules, Path(name).stem, raising=False)
    names: dict[str, object] = {}
    printed, checked = None, 0
    with stand_in(monkeypatch) if page == "robot.md" else contextlib.nullcontext():
        for language, code in FENCED.findall(text):
            if ".gif" in code and not check_opengl().works:
                printed = None
            elif language in ("python", "bash") and code not in files.values():
                printed = printed_by(language, code, page, names)
            elif language == "text" and printed is not None:
                assert not missing(code, printed), f"{code}\n{printed}"
                checked += 1
    assert checked > 3
