"""The Python in the guides runs as printed."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize(
    "page",
    [
        "README.md",
        "docs/beams_in_waves.md",
        "docs/cable.md",
        "docs/contact.md",
        "docs/data.md",
        "docs/elements.md",
        "docs/engines.md",
        "docs/exchange.md",
        "docs/laws.md",
        "docs/pictures.md",
        "docs/shape_control.md",
        "docs/speed.md",
        "docs/statics.md",
        "docs/validate.md",
    ],
)
def test_python_blocks_run_as_printed(page, tmp_path, monkeypatch):
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / page).read_text(), re.DOTALL)
    assert blocks, f"{page} has no Python block"
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    for block in blocks:
        exec(compile(block, page, "exec"), names)
