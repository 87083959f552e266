"""docs/own-law.md runs as it is shown: files, commands and Python, in order; and its recipes do what it says."""

from __future__ import annotations

import re
import shlex
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tensegrity_mj.cli import main

PAGE = Path(__file__).resolve().parents[2] / "docs" / "own-law.md"
Names = dict[str, Any]


def run_blocks(text: str, folder: Path, names: Names) -> int:
    """Run the blocks of a text: those of Python that begin with the name of a file are written there, too."""
    count = 0
    for kind, block in re.findall(r"```(python|bash)\n(.*?)```", text, re.DOTALL):
        count += 1
        if kind == "bash":
            for line in block.splitlines():
                words = shlex.split(line)
                assert words[0] == "tensegrity-mj"
                assert main(words[1:]) == 0, line
            continue
        if file := re.match(r"# (\w+\.py)\n", block):
            (folder / file[1]).write_text(block, encoding="utf-8")
        exec(compile(block, str(PAGE), "exec"), names)
    return count


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The current folder, where modules are found."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    yield tmp_path
    for name in ("my_laws", "near", "pid", "cpg", "lqr"):
        sys.modules.pop(name, None)


def section(title: str) -> str:
    parts = re.split(r"^## ", PAGE.read_text("utf-8"), flags=re.MULTILINE)
    return next(part for part in parts if part.startswith(title))


def recipe(title: str, folder: Path) -> Names:
    """What the names of a recipe are after it, with what comes before all recipes."""
    names: Names = {"__name__": "recipe"}
    assert run_blocks(section("Recipes"), folder, names) == 1
    assert run_blocks(section(title), folder, names) == 3
    return names


@pytest.mark.slow
def test_what_stands_before_the_recipes_runs(folder: Path) -> None:
    names: Names = {"__name__": "page"}
    assert run_blocks(section("In five minutes"), folder, names) == 1
    assert run_blocks(section("By its file"), folder, names) == 2
    rest = PAGE.read_text("utf-8").partition("## Attributes of a law")[2].partition("## Recipes")[0]
    assert run_blocks(rest, folder, names) == 1  # an `ArrayPolicy`


@pytest.mark.slow
def test_the_pid_leaves_no_error_where_a_load_does_without_it(folder: Path) -> None:
    without, with_integral = recipe("PID of rest lengths", folder)["left"]
    # At rest without the integral the load's moment is held by the strings' alone: the tip stays aside. With it e = 0,
    # to what 40 s leave of its slowest motion.
    assert without > 0.01
    assert with_integral < 1e-3


@pytest.mark.slow
def test_the_cpg_walks(folder: Path) -> None:
    names = recipe("CPG gait", folder)
    step = names["centre"][-1] - names["centre"][names["landed"]]
    assert np.linalg.norm(step) > 0.05
    # Oscillators that have locked differ by a third of a turn: sin(φ_j - φ_i + (i - j) ψ) = 0 for all pairs.
    # What differs contracts, so that a step's error is left: 1e-8 (1 + |φ|) of each phase.
    phase = names["CPG"](names["scene"]).phase(20.0)
    apart = np.exp(1j * np.diff(phase)) - np.exp(1j * np.radians([-120, -120]))
    assert abs(apart).max() < 2e-8 * (1 + phase.max())


@pytest.mark.slow
def test_the_lqr_has_its_own_eigenvalues(folder: Path) -> None:
    names = recipe("LQR", folder)
    loop, law, closed = names["loop"], names["law"], names["closed"]
    assert np.linalg.eigvals(loop).real.max() < 0
    # linearize differentiates the law, which is linear in x: central differences have the round-off of u over the
    # step, ε |u|/h with |u| < 1 and the least of its steps h = 1e-6 rad, times |B| = 1.3 and less than 10 columns.
    bound = np.finfo(float).eps / 1e-6 * 10 * abs(law.model.B).max()
    assert abs(closed.A - loop).max() < bound
    # Eigenvalues move by no more than the condition of the eigenvectors times that (Bauer and Fike).
    values, vectors = np.linalg.eig(loop)
    gaps = abs(values[:, None] - closed.eigenvalues[None, :])
    assert gaps.min(axis=0).max() < np.linalg.cond(vectors) * 4 * bound
    assert gaps.min(axis=1).max() < np.linalg.cond(vectors) * 4 * bound
    # Against e^{(A - BK) t} x(0) a run leaves terms of second order in the turn at least: a tenth leaves a hundredth.
    large, small = names["error"][1e-2], names["error"][1e-3]
    assert small < 1.1 * large / 100
    assert large < 1e-3 * 1e-2
