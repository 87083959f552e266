"""Bars show on a terminal and in a notebook; elsewhere there is not even a library for them, but lines."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tensegrity_mj.basics.progress import Lines, NoBar, bar

# A kernel of Jupyter is where a shell has this application; its stderr is no terminal.
RUN = """
import sys, types
if {kernel}:
    sys.modules["IPython"] = types.ModuleType("IPython")
    shell = types.SimpleNamespace(config={{"IPKernelApp": {{}}}})
    sys.modules["IPython"].get_ipython = lambda: shell
import tensegrity_mj as tmj
scene = tmj.load_scene("pinned_rod")
tmj.simulate(scene, None, tmj.MuJoCo(1e-3), duration=0.1, progress={progress})
print("tqdm" in sys.modules)
"""


@pytest.mark.parametrize(
    ("kernel", "progress", "shown"), [(True, True, True), (True, False, False), (False, True, False)]
)
def test_a_bar_shows_in_a_notebook_where_it_is_wanted(kernel: bool, progress: bool, shown: bool) -> None:
    code = RUN.format(kernel=kernel, progress=progress)
    child = subprocess.run([sys.executable, "-W", "ignore", "-c", code], capture_output=True, text=True)
    assert child.returncode == 0, child.stderr
    assert child.stdout.split()[-1] == str(shown)
    assert ("100%" in child.stderr and "0.10/0.10 s" in child.stderr) == shown


def test_a_bar_that_shows_nothing_takes_what_a_bar_does() -> None:
    with bar(False, "nothing", total=3) as silent:
        silent.update()
        silent.n = 2.0
        silent.refresh()
        silent.close()
    assert isinstance(silent, NoBar)


def test_without_a_terminal_lines_become_fewer(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture) -> None:
    """A unit a second: a line when 30 s and a tenth of all time have gone by since the last, e - e0 >= 30 + e/10."""
    clock = iter(float(second) for second in range(1000))
    monkeypatch.setattr("time.monotonic", lambda: next(clock))
    with bar(True, "all of them", total=200) as lines:
        for _ in range(160):
            lines.update()
    assert isinstance(lines, Lines)
    printed = capsys.readouterr().err.splitlines()
    assert printed == [f"all of them: {at / 2:.0f} % after {at} s" for at in (34, 72, 114, 160)]
