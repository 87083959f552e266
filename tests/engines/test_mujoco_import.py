"""MUJOCO_GL settles whether MuJoCo can be imported at all, although only pictures need OpenGL."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from tensegrity_mj.pictures.opengl import has_osmesa


def answer_with(chosen: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Of a command, in a process of its own: MuJoCo is imported once in each.

    A test that drew before may have settled PyOpenGL's platform, which children would inherit.
    """
    others = {name: value for name, value in os.environ.items() if name != "PYOPENGL_PLATFORM"}
    return subprocess.run(
        [sys.executable, "-m", "tensegrity_mj", *arguments],
        env={**others, "MUJOCO_GL": chosen},
        capture_output=True,
        text=True,
        check=False,
    )


COMMANDS = [("scenes", "pinned_rod"), ("audit", "speed", "--json"), ("run", "pinned_rod", "--engine", "dae", "--view")]


@pytest.mark.parametrize("arguments", COMMANDS, ids=lambda one: one[0])
def test_a_value_that_means_nothing_is_refused_with_those_that_are_allowed(arguments: tuple[str, ...]) -> None:
    answer = answer_with("paper", *arguments)
    assert answer.returncode == 2, answer.stderr
    assert "MUJOCO_GL=paper" in answer.stderr
    assert "allowed are egl, osmesa, glfw, and off; unset it" in answer.stderr
    assert "Traceback" not in answer.stderr


@pytest.mark.skipif(sys.platform != "linux" or has_osmesa(), reason="OSMesa is here")
def test_a_kind_that_is_not_installed_is_missing() -> None:
    answer = answer_with("osmesa", "scenes", "pinned_rod")
    assert answer.returncode == 5, answer.stderr
    assert "MUJOCO_GL=osmesa" in answer.stderr
    assert "Traceback" not in answer.stderr


@pytest.mark.parametrize("chosen", ["", "off"])
def test_without_opengl_all_but_pictures_works(chosen: str) -> None:
    answer = answer_with(chosen, "scenes", "pinned_rod")
    assert answer.returncode == 0, answer.stderr
