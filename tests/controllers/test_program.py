"""A program of rest lengths: its cubic in closed form, compiled as in Python, the same in engines; wrong ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import tensegrity_mj as tmj
from tensegrity_mj.controllers import Program
from tensegrity_mj.errors import OptionError
from tensegrity_mj.library.prism import prism

MOVES = [["top1", 0.1, 0.3, 0.8], ["side2", 0.2, 0.5, 0.9], ["top1", 0.3, 0.4, 1.1]]


def scene() -> tmj.Scene:
    return prism().with_(contact=None, gravity=(0.0, 0.0, 0.0), duration=0.6)


def test_each_move_is_the_cubic_from_rest_to_rest() -> None:
    structure = scene().structure
    law = Program(structure, moves=MOVES)
    names = [string.name for string in structure.strings]
    top, side = names.index("top1"), names.index("side2")
    for time in np.linspace(0.0, 0.7, 141):
        x = np.clip((time - 0.1) / 0.2, 0, 1), np.clip((time - 0.3) / 0.1, 0, 1), np.clip((time - 0.2) / 0.3, 0, 1)
        one, two, three = (3 * v**2 - 2 * v**3 for v in x)
        expected = np.array(structure.rest_lengths)
        expected[top] *= 1 - 0.2 * one + 0.3 * two
        expected[side] *= 1 - 0.1 * three
        np.testing.assert_allclose(law(time), expected, rtol=1e-13)


def test_compiled_it_is_the_same_and_ends_where_it_ends() -> None:
    run = tmj.simulate(scene(), law := Program(scene().structure, moves=MOVES), tmj.MuJoCo(1e-3), output_interval=0.01)
    np.testing.assert_allclose(run.rest_lengths, [law(time) for time in run.time], rtol=1e-13)
    assert not run.reports["warnings"]
    assert run.provenance["controller"]["law"] == "program"
    still = tmj.simulate(scene(), Program(scene().structure), tmj.MuJoCo(1e-3), duration=0.1)
    np.testing.assert_array_equal(still.rest_lengths, np.broadcast_to(still.rest_lengths[0], still.rest_lengths.shape))


def test_engines_agree_at_fourth_order() -> None:
    """The ends of moves are steps, between which all is smooth: halving RK4's step divides the error by 16."""
    law = Program(scene().structure, moves=MOVES)
    reference = tmj.simulate(scene(), law, tmj.DAE(rtol=1e-12, atol=1e-13), output_interval=0.1)
    errors = [
        tmj.compare(tmj.simulate(scene(), law, tmj.MuJoCo(step), output_interval=0.1), reference).max_node_error
        for step in (5e-4, 2.5e-4)
    ]
    assert errors[0] / errors[1] == pytest.approx(16, rel=0.25)
    assert reference.nodes.std(axis=0).max() > 1e-3


def test_a_scene_names_it_without_a_target(tmp_path: Path) -> None:
    named = scene().with_(control=tmj.model.ControlSpec("program", {"moves": MOVES}))
    tmj.save_scene(named, tmp_path / "scene.toml")
    again = tmj.load_scene(tmp_path / "scene.toml")
    law = tmj.controllers.from_scene(again)
    np.testing.assert_array_equal(law(0.25), Program(named.structure, moves=MOVES)(0.25))
    with pytest.raises(OptionError, match="has no target, which its law needs"):
        tmj.controllers.from_scene(again, "lyapunov")


@pytest.mark.parametrize(
    ("moves", "message"),
    [
        ([["top9", 0, 1, 0.5]], "there is no string 'top9'"),
        ([["top1", 1, 1, 0.5]], r"moves\[0\] = .*0 <= begin < end"),
        ([["top1", -1, 1, 0.5]], r"moves\[0\] = .*0 <= begin < end"),
        ([["top1", 0, 1, 0]], "a fraction > 0"),
        ([["top1", 0, 1]], r"each move is \[string, begin, end, fraction\]"),
        ([["top1", 0, "x", 1]], r"each move is \[string, begin, end, fraction\]"),
        ([["top1", 0, float("nan"), 1]], r"each move is \[string, begin, end, fraction\]"),
        ([[1, 0, 1, 1]], r"each move is \[string, begin, end, fraction\]"),
        (3, "moves"),
        ([["top1", 0, 1, 0.5], ["top1", 0.5, 2, 1]], "is to move from 0.5 s on, while it moves until 1 s"),
    ],
)
def test_wrong_moves_are_refused(moves: object, message: str) -> None:
    with pytest.raises(OptionError, match=message):
        Program(scene().structure, moves=moves)  # type: ignore[arg-type]
    with pytest.raises(OptionError, match="was made for"):
        Program(scene().structure).native(tmj.load_scene("pinned_rod").structure)
