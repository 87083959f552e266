"""Structures moved, mirrored and merged: lengths, supports and names, what is refused, and a motion in two engines."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import tensegrity_mj as tmj
from evidence.random_structures import random_rotation, random_structure
from tensegrity_mj.errors import OptionError, StructureError
from tensegrity_mj.model.members import PointMass, Rod, String, Support
from tensegrity_mj.model.strings import StringLaw
from tensegrity_mj.model.structure import Structure

EPS = np.finfo(float).eps


def half() -> Structure:
    """A rod beside the plane y = 0 on strings, one of them in that plane, to a fixed node and a mass there."""
    return Structure(
        "half",
        {"a": (0.0, 1.0, 0.0), "b": (0.0, 1.0, 2.0), "top": (0.0, 0.0, 3.0), "low": (0.0, 0.0, -1.0)},
        (Rod("r", ("a", "b"), 2.0, support=Support.constrained([[0, 1, 1]], 0.25, [1.5])),),
        (
            String("s1", ("b", "top"), 50.0, tension=3.0, group="upper"),
            String("s2", ("a", "low"), 60.0),
            String("mid", ("low", "top"), 70.0),
        ),
        ("top",),
        (PointMass("low", 0.5, (0.0, 1.0, 0.0)),),
    )


@pytest.mark.parametrize("seed", range(4))
def test_a_moved_structure_has_its_lengths_forces_and_supports_elsewhere(seed: int) -> None:
    rng = np.random.default_rng(seed)
    structure = random_structure(rng, rods=4, planar=seed % 2 == 1, own_planes=0.5, fixed_nodes=2, point_masses=2)
    vector, shift = rng.normal(size=3), rng.normal(size=3)

    def turned(points: np.ndarray) -> np.ndarray:
        """Rodrigues' formula."""
        angle = np.linalg.norm(vector)
        n = vector / angle
        return (
            points * np.cos(angle) + np.cross(n, points) * np.sin(angle) + np.outer(points @ n, n) * (1 - np.cos(angle))
        )

    moved = structure.moved(vector, shift)
    # Products of three terms, and their differences: some roundings of places within 10 m.
    np.testing.assert_allclose(moved.positions, turned(structure.positions) + shift, rtol=0, atol=80 * EPS)
    np.testing.assert_allclose(moved.rod_lengths, structure.rod_lengths, rtol=0, atol=80 * EPS)
    np.testing.assert_allclose(moved.rest_lengths, structure.rest_lengths, rtol=0, atol=80 * EPS)
    for before, after in zip(structure.rods, moved.rods, strict=True):
        held = before.support.constraint_rows
        now = after.support.constraint_rows
        # The same directions are held, turned: together they span no more.
        assert len(now) == len(held)
        assert np.linalg.matrix_rank(np.vstack([turned(held), now, np.zeros((1, 3))]), tol=1e-9) == len(held)
    turn = Rotation.from_rotvec(vector)
    for same in (turn, turn.as_matrix()):
        assert structure.moved(same, shift) == moved
    back = moved.moved(translation=-shift).moved(-vector)
    np.testing.assert_allclose(back.positions, structure.positions, rtol=0, atol=160 * EPS)


def test_moving_by_nothing_changes_nothing() -> None:
    structure = replace(half(), rods=(replace(half().rods[0], support=Support.pinned(0.0)),))
    assert structure.moved() == structure
    assert structure.moved([0, 0, 0.3]).rods == structure.rods  # a point that is held is held in any axes


def test_a_mirror_image() -> None:
    image = half().mirrored([0, -2, 0], through=[5.0, 0.5, 7.0])
    assert image.nodes["a"] == (0.0, 0.0, 0.0)
    assert image.nodes["top"] == (0.0, 1.0, 3.0)
    assert image.rods[0].support == Support.constrained([[0, -1, 1]], 0.25)
    assert image.point_masses[0].plane == (0.0, -1.0, 0.0)
    assert image.strings == half().strings
    twice = image.mirrored([0, 1, 0], through=[0, 0.5, 0])
    assert twice.nodes == half().nodes
    n = np.array([1.0, 2.0, -2.0]) / 3
    image = half().mirrored(n)
    np.testing.assert_allclose(
        (image.positions + half().positions) @ n, 0, atol=16 * EPS
    )  # as far on the other side, and beside each other
    np.testing.assert_allclose(np.cross(image.positions - half().positions, n), 0, atol=16 * EPS)


def test_half_a_structure_and_its_mirror_image_make_a_whole() -> None:
    whole = half().merged(half().mirrored([0, 1, 0]), join=True, prefix="m_")
    assert list(whole.nodes) == ["a", "b", "top", "low", "m_a", "m_b"]
    assert [rod.name for rod in whole.rods] == ["r", "m_r"]
    # What lies in the plane is there once: the string between both, the fixed node, the mass.
    assert [string.name for string in whole.strings] == ["s1", "s2", "mid", "m_s1", "m_s2"]
    assert whole.strings[3] == String("m_s1", ("m_b", "top"), 50.0, tension=3.0, group="upper")
    assert (whole.fixed_nodes, whole.name, len(whole.point_masses)) == (("top",), "half", 1)
    named = half().merged(half().mirrored([0, 1, 0]), join={"top": "top", "low": "low"}, prefix="m_")
    assert named == whole
    # A mass at the plane of symmetry stays there: the motion of both halves is the same, mirrored.
    scene = tmj.Scene(whole, gravity=(0.0, 0.0, -9.81))
    for engine in (tmj.MuJoCo(timestep=1e-3), tmj.DAE(method="rk4", timestep=1e-3)):
        run = tmj.simulate(scene, None, engine, duration=0.5, output_interval=0.1)
        row = whole.node_index
        left, right = run.nodes[:, row["b"]], run.nodes[:, row["m_b"]]
        assert np.ptp(left[:, 2]) > 1e-3
        # 500 steps of round-off of some 1e-15 m, in a motion that does not diverge.
        np.testing.assert_allclose(right, left * [1, -1, 1], rtol=0, atol=1e-11)


def test_merging_side_by_side() -> None:
    one = half()
    both = one.merged(one.moved(translation=(0, 0, 9)), prefix="up.")
    assert len(both.nodes) == 8
    assert both.fixed_nodes == ("top", "up.top")
    assert both.clusters == ((0,), (1,))
    # On each other, but not joined: structures may share places.
    assert len(one.merged(one, prefix="b_").nodes) == 8


def test_strings_keep_their_law_where_structures_have_different_ones() -> None:
    other = replace(half(), string_law=StringLaw.UNCLIPPED)
    both = half().merged(other.moved(translation=(0, 0, 9)), prefix="b_")
    count = len(half().strings)
    assert both.clipped.tolist() == [True] * count + [False] * count


WRONG = [
    (lambda s: s.merged(s.moved(translation=(0, 0, 9))),
     "merged: both have nodes 'a', 'b', 'top', 'low'; give the names of the other a prefix, as in merged(other, "),
    (lambda s: s.merged(s, {"tip": "top"}, "b_"), "merged: join, in 'half': unknown node 'tip' (did you mean 'top'?)"),
    (lambda s: s.merged(s, {"top": "tip"}, "b_"), "merged: join, in 'half': unknown node 'tip'"),
    (lambda s: s.merged(s.moved(translation=(0, 0, 2)), {"top": "top"}, "b_"),
     "merged: join: node 'top' is 2 m from 'top'; joined nodes stand at one place: other.moved(translation=[0.0"),
    (lambda s: s.merged(s.with_strings(stiffness=99.0), True, "b_"),
     "string 'b_s1' joins 'b' and 'top' as string 's1' does: remove one of them"),
]  # fmt: skip


@pytest.mark.parametrize(("make", "words"), WRONG, ids=[words[:40] for _, words in WRONG])
def test_what_does_not_fit_is_refused(make, words: str) -> None:
    with pytest.raises(StructureError) as caught:
        make(half())
    assert str(caught.value).startswith(words)


def test_what_is_no_structure_join_or_prefix_is_refused() -> None:
    for given, words in [
        ({"other": None}, "merged: other = None; it must be a Structure"),
        ({"other": half(), "join": "top"}, "merged: join = 'top'; it must be True, False, or a table"),
        ({"other": half(), "join": 1}, "merged: join = 1; it must be True, False, or a table"),
        ({"other": half(), "prefix": 3}, "merged: prefix = 3; it must be a text"),
    ]:
        with pytest.raises(OptionError) as caught:
            half().merged(**given)  # type: ignore[arg-type]
        assert str(caught.value).startswith(words)


def test_what_is_no_rotation_plane_or_shift_is_refused() -> None:
    for rotation, words in [
        ([1, 2], r"rotation = \[1, 2\] of shape \(2,\); it must be an array of shape \(3,\) \[rad, or a matrix"),
        (-np.eye(3), "right-handed .mirror images are made by mirrored"),
        (2 * np.eye(3), "its columns must be orthogonal, of length 1"),
        ("z", "rotation = 'z'"),
    ]:
        with pytest.raises(OptionError, match=words):
            half().moved(rotation)
    with pytest.raises(OptionError, match="moved: translation = 3; it must be an array of shape"):
        half().moved(translation=3)
    with pytest.raises(OptionError, match=r"mirrored: plane = \[0, 0, 0\]; its length must not be zero"):
        half().mirrored([0, 0, 0])
    assert random_rotation(np.random.default_rng(0)).shape == (3, 3)


def test_rows_of_several_lengths_are_no_rotation() -> None:
    with pytest.raises(OptionError, match="rotation"):
        tmj.load_scene("prism").structure.moved(rotation=[[1, 2], [3]])
