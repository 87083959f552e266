"""What a structure stands on, by hand: distances from edges, landings of a run that is written down."""

from __future__ import annotations

import numpy as np
import pytest

import tensegrity_mj as tmj
from tensegrity_mj.errors import OptionError
from tensegrity_mj.library.prism import prism
from tensegrity_mj.runs.standing import Standing, edge_margins, standing


def test_distances_from_edges() -> None:
    """A right triangle with legs of 3 and 4 m, whose hypotenuse is 3x + 4y = 12."""
    corners = [[0, 0, 0], [4, 0, 5], [0, 3, -1]]
    np.testing.assert_allclose(edge_margins(corners, [1, 0.5, 9]), [0.5, (12 - 3 - 2) / 5, 1.0], rtol=1e-14)
    np.testing.assert_allclose(edge_margins(corners[::-1], [1, 0.5, 9]), [(12 - 3 - 2) / 5, 0.5, 1.0], rtol=1e-14)
    np.testing.assert_allclose(edge_margins(corners, [4, 3, 0])[1], -12 / 5, rtol=1e-14)
    square = [[0, 0, 0], [2, 2, 0], [2, 0, 0], [0, 2, 0], [1, 1, 0]]  # in any order, and one inside
    np.testing.assert_allclose(np.sort(edge_margins(square, [0.5, 0.9, 0])), [0.5, 0.9, 1.1, 1.5], rtol=1e-13)
    # On a slope along x the same corners, seen along its normal.
    turned = np.array(corners) @ np.array([[0, 0, -1.0], [0, 1, 0], [1, 0, 0]])
    up = np.array([0, 0, 1.0]) @ np.array([[0, 0, -1.0], [0, 1, 0], [1, 0, 0]])
    np.testing.assert_allclose(
        edge_margins(turned, np.array([1, 0.5, 9]) @ np.array([[0, 0, -1.0], [0, 1, 0], [1, 0, 0]]), up),
        edge_margins(corners, [1, 0.5, 9]),
        atol=1e-14,
    )
    assert edge_margins([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [0, 0, 0]).size == 0
    assert edge_margins([[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]], [0, 0, 0]).size == 0


def test_landings_are_those_that_last() -> None:
    bases = [("a", "b", "c")] * 5 + [("a", "b")] * 3 + [("a", "b", "d")] + [("b",)] + [("a", "b", "d")] * 4 + [()] * 2
    bases += [("a", "b", "d")] * 4
    found = Standing(np.arange(20) * 0.1, tuple(bases), np.zeros(20), np.zeros((20, 3))).landings(0.25)
    assert found == [(0.0, ("a", "b", "c")), (pytest.approx(1.0), ("a", "b", "d"))]


def test_a_prism_that_settles_stands_on_three_feet() -> None:
    """Its centre of mass is above the middle: a triangle's inner radius, half that of its corners, from every edge."""
    scene = prism(gravity=9.81)
    run = tmj.simulate(scene, None, tmj.MuJoCo(5e-4), duration=0.5)
    found = standing(run)
    assert found.bases[-1] == ("r1a", "r2a", "r3a")
    inner = np.linalg.norm(scene.nodes0[0, :2]) / 2
    assert found.margins[-1] == pytest.approx(
        inner, rel=0.01
    )  # the weight of 6 N widens the base by parts of a percent
    np.testing.assert_allclose(found.path[0], scene.nodes0.mean(axis=0), rtol=0, atol=1e-15)
    with pytest.raises(OptionError, match="has no floor to stand on"):
        standing(tmj.simulate("pinned_rod", None, "dae", duration=0.1))
