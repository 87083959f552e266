"""The Python in the pages runs as printed."""

from __future__ import annotations

import importlib
import re
import sys
from pathlib import Path

import pytest
from pages import NOTEBOOKS, PAGES, ROOT, blocks, name_of

# Pages whose blocks another test runs.
ELSEWHERE = {
    "docs/dm_control.md": "tests/learning/test_dm_control_viewer.py",
    "docs/format/running.md": "tests/model/test_textformat.py",
    "docs/format/scene.md": "tests/model/test_textformat.py",
    "docs/gymnasium.md": "tests/learning/test_gymnasium.py",
    "docs/own-law.md": "tests/house/test_recipes.py",
    "docs/tutorial.md": "tests/house/test_tutorial.py",
    "docs/tutorials/controller.md": "tests/house/test_tutorial.py",
    "docs/tutorials/footbridge.md": "tests/house/test_tutorial.py",
    "docs/tutorials/robot.md": "tests/house/test_tutorial.py",
}
SLOW = {"docs/clearance.md", "docs/studies.md", "docs/waves.md"}  # more than a few seconds
RUN_HERE = [
    pytest.param(page, id=name_of(page), marks=[pytest.mark.slow] if name_of(page) in SLOW else [])
    for page in PAGES
    if blocks(page, "python") and name_of(page) not in ELSEWHERE
]
SAVED = re.compile(r"as `(\w+)\.py`:\n\n```python\n(.*?)```", re.DOTALL)  # a block that is a file


@pytest.mark.parametrize("page", RUN_HERE)
def test_python_blocks_run_as_printed(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))  # of workers
    if name_of(page) == "docs/view.md":
        monkeypatch.setattr(importlib.import_module("mujoco.viewer"), "launch", lambda model: None)  # no display
    importlib.invalidate_caches()
    files = dict(SAVED.findall(page.read_text(encoding="utf-8")))
    for name, code in files.items():
        Path(f"{name}.py").write_text(code, encoding="utf-8")
    names: dict[str, object] = {}
    try:
        for block in blocks(page, "python"):
            if block not in files.values():
                exec(compile(block, name_of(page), "exec"), names)
    finally:
        for name in files:
            sys.modules.pop(name, None)


def test_every_page_with_python_is_run_somewhere() -> None:
    assert len(RUN_HERE) > 15
    for page, test in ELSEWHERE.items():
        assert Path(page).name in (ROOT / test).read_text(encoding="utf-8"), page


@pytest.mark.parametrize("path", NOTEBOOKS, ids=name_of)
def test_notebooks_keep_no_output(path: Path) -> None:
    """They run where the site is built: tests/house/test_site.py."""
    text = path.read_text(encoding="utf-8")
    assert len(text) < 10_000
    assert '"output_type"' not in text
