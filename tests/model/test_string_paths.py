"""Strings through more than two nodes, as structures and files have them: see `test_pulleys` for how they move."""

from __future__ import annotations

import json
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pulley_scenes import atwood, ringed, slung, threaded

import tensegrity_mj as tmj
from tensegrity_mj import errors
from tensegrity_mj.model import format_schema, rods
from tensegrity_mj.model.rigidity import equilibrium_matrix, free_motions
from tensegrity_mj.model.strings import Paths
from tensegrity_mj.model.text.writing import scene_to_toml


def test_lengths_and_rates_are_sums_over_the_segments() -> None:
    structure = slung().structure
    # 0.45, 0.6 and 0.75 are a right triangle, as 0.55, 0.6 and √0.6625.
    assert structure.string_lengths(structure.positions) == pytest.approx([0.75 + 0.6625**0.5], rel=1e-15)
    velocities = np.array([[0.0, 0, 0], [1.0, 0, 2.0], [0.0, 0, 0]])
    rate = (0.45 * 1.0 - 0.6 * 2.0) / 0.75 + (-0.55 * 1.0 - 0.6 * 2.0) / 0.6625**0.5
    assert structure.string_rates(structure.positions, velocities) == pytest.approx([rate], rel=1e-14)
    # Of more samples at once.
    many = structure.string_lengths(np.stack([structure.positions, 2 * structure.positions]))
    assert many[:, 0] == pytest.approx([0.75 + 0.6625**0.5, 2 * (0.75 + 0.6625**0.5)])


def test_paths_know_their_segments_and_which_of_them_a_string_couples() -> None:
    paths = Paths.of([(4, 5), (0, 1, 2, 1), (3, 0)])
    assert paths.nodes.tolist() == [[4, 5], [0, 1], [1, 2], [2, 1], [3, 0]]
    assert paths.ranges.tolist() == [[0, 1], [1, 4], [4, 5]]
    assert paths.strings.tolist() == [0, 1, 1, 1, 2]
    assert paths.total(np.arange(5.0)).tolist() == [0.0, 6.0, 4.0]
    three = [[i, j] for i in (1, 2, 3) for j in (1, 2, 3)]
    assert paths.couples.tolist() == [[0, 0], *three, [4, 4]]
    both = paths.followed_by(np.array([[7, 8]]))
    assert both.nodes[-1].tolist() == [7, 8]
    assert both.ranges[-1].tolist() == [5, 6]
    none = Paths.of([])
    assert none.total(np.zeros(0)).shape == (0,)
    assert none.couples.shape == (0, 2)


@pytest.mark.parametrize("scene", [atwood, slung, ringed, threaded])
def test_forces_are_minus_the_gradient_of_the_energy(scene) -> None:  # type: ignore[no-untyped-def]
    """By central differences of Σ ½ k (L - L0)², over h = 1e-5 m: their error is h²/6 times the third derivative, and
    round-off of the energy over h.
    """
    structure = scene().structure
    nodes = structure.positions + np.random.default_rng(1).normal(scale=0.02, size=structure.positions.shape)
    k, rest = structure.stiffness, structure.rest_lengths * 0.9

    def energy(x: np.ndarray) -> float:
        return float(0.5 * k @ np.maximum(0.0, structure.string_lengths(x) - rest) ** 2)

    tensions = k * np.maximum(0.0, structure.string_lengths(nodes) - rest)
    found = rods.string_forces(structure, nodes, tensions)
    h, expected = 1e-5, np.zeros_like(nodes)
    for place in np.ndindex(*nodes.shape):
        step = np.zeros_like(nodes)
        step[place] = h
        expected[place] = -(energy(nodes + step) - energy(nodes - step)) / (2 * h)
    # T/l² is the size of a third derivative of a length times T: some 1e4 N/m² here.
    np.testing.assert_allclose(found, expected, atol=h**2 * 1e4 + 1e-15 * energy(nodes) / h * 10)


def test_a_force_density_is_the_tension_over_the_whole_length() -> None:
    """Its column of A is L times the sum of the segments' unit vectors, on what can move."""
    structure = slung(rise=0.2).structure
    a, m, b = structure.positions
    first, second = np.linalg.norm(a - m), np.linalg.norm(b - m)
    pull = (first + second) * ((a - m) / first + (b - m) / second)
    expected = free_motions(structure).T[:, 3:6] @ pull
    np.testing.assert_allclose(equilibrium_matrix(structure)[:, 0], expected, atol=1e-15)
    tense = structure.with_strings(force_density=5.0)
    assert 800 * ((first + second) - tense.rest_lengths[0]) == pytest.approx(5.0 * (first + second), rel=1e-12)


def test_files_hold_paths(tmp_path: Path) -> None:
    for number, scene in enumerate((atwood(), ringed())):
        path = tmp_path / f"{number}.toml"
        tmj.save_scene(scene, path)
        assert tmj.load_scene(path) == scene
    assert '["a", "p", "q", "b"]' in (tmp_path / "0.toml").read_text()


def test_the_schema_of_files_allows_paths_and_refuses_single_nodes() -> None:
    jsonschema = pytest.importorskip("jsonschema")
    check = jsonschema.Draft4Validator(json.loads(json.dumps(format_schema())))
    good = scene_to_toml(atwood())
    check.validate(tomllib.loads(good))
    assert not check.is_valid(tomllib.loads(good.replace('["a", "p", "q", "b"]', '["a"]')))


@pytest.mark.parametrize(
    ("path", "words"),
    [
        (("a", "p", "p", "b"), ("passes node 'p' twice in a row", "name it once")),
        (("a",), ("two or more nodes",)),
        (("a", "x", "b"), ("unknown node 'x'",)),
        (("a", "a"), ("starts and ends on node 'a'",)),
    ],
)
def test_paths_that_are_none_are_refused(path: tuple[str, ...], words: tuple[str, ...]) -> None:
    structure = atwood().structure
    with pytest.raises(errors.StructureError) as caught:
        replace(structure, strings=(replace(structure.strings[0], nodes=path),))
    for word in words:
        assert word in str(caught.value)


def test_paths_whose_pairs_of_segments_would_fill_the_memory_are_refused() -> None:
    structure = atwood().structure
    (string,) = structure.strings
    longest = replace(string, nodes=("a", "p") * 500)  # 999 segments, 998,001 pairs
    replace(structure, strings=(longest,))
    longer = replace(string, nodes=("a", "p") * 501)
    with pytest.raises(errors.StructureError, match=r"string 's' runs through 1002 nodes: .* 1002001 pairs .* at most"):
        replace(structure, strings=(longer,))
    # 41² + 43² + ... + 63² = 33,020 pairs more.
    others = tuple(replace(string, name=f"s{n}", nodes=("a", "p", *("q", "p") * n)) for n in range(20, 32))
    with pytest.raises(errors.StructureError, match=r"string 's' runs through 1000 nodes: .* 1031021 pairs"):
        replace(structure, strings=(longest, *others))


def test_segments_without_length_and_the_same_path_twice_are_refused() -> None:
    structure = atwood().structure
    (string,) = structure.strings
    with pytest.raises(errors.StructureError, match="has length 0 m between 'p' and 'q'"):
        replace(structure, nodes={**structure.nodes, "q": structure.nodes["p"]})
    back = replace(string, name="again", nodes=string.nodes[::-1])
    with pytest.raises(errors.StructureError, match="joins 'b' and 'q' and 'p' and 'a' as string 's' does"):
        replace(structure, strings=(string, back))
    # Other ways between the same ends are other strings.
    replace(structure, strings=(string, replace(string, name="short", nodes=("a", "q", "b"))))


def test_a_string_may_run_along_a_rod_if_it_goes_on() -> None:
    nodes = {"a": (0, 0, 0), "b": (0, 0, 1), "c": (1, 0, 1)}
    rod, anchor = tmj.Rod("r", ("a", "b"), 1.0), ("c",)
    with pytest.raises(errors.StructureError, match=r"runs along rod 'r' .* its length cannot change"):
        tmj.Structure("s", nodes, (rod,), (tmj.String("s", ("a", "b", "a"), 1.0), _tie()), anchor)
    tmj.Structure("s", nodes, (rod,), (tmj.String("s", ("a", "b", "c"), 1.0),), anchor)


def _tie() -> tmj.String:
    return tmj.String("tie", ("b", "c"), 1.0)


def test_arrays_may_have_paths_of_several_lengths() -> None:
    nodes = np.array([[0.0, 0, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1]])
    made = tmj.Structure.from_arrays(
        nodes, [(0, 1)], [(1, 2), [0, 2, 3, 1]], rod_mass=1.0, stiffness=5.0, fixed_nodes=[2, 3]
    )
    assert [string.nodes for string in made.strings] == [("n2", "n3"), ("n1", "n3", "n4", "n2")]
    with pytest.raises(errors.StructureError, match=r"strings\[0\] = \(1,\): .* a pair of node indices, or more"):
        tmj.Structure.from_arrays(nodes, [(0, 1)], [(1,)], rod_mass=1.0, stiffness=5.0, fixed_nodes=[2, 3])
    with pytest.raises(errors.StructureError, match=r"rods\[0\] = \(0, 1, 2\): it must be a pair of node indices"):
        tmj.Structure.from_arrays(nodes, [(0, 1, 2)], [(1, 2)], rod_mass=1.0, stiffness=5.0, fixed_nodes=[2, 3])


def test_arrays_of_pairs_are_refused_where_they_have_no_room() -> None:
    with pytest.raises(errors.StructureError, match=r"string 's' runs through 4 nodes: string_nodes .* use `paths`"):
        _ = atwood().structure.string_nodes
    assert tmj.load_scene("prism").structure.string_nodes.shape == (12, 2)


def test_moved_mirrored_and_merged_structures_keep_their_paths() -> None:
    structure = ringed().structure
    moved = structure.moved((0.1, 0.2, 0.3), (1.0, 2.0, 3.0))
    assert moved.string_lengths(moved.positions) == pytest.approx(structure.string_lengths(structure.positions))
    mirrored = structure.mirrored((1.0, 0.0, 0.0))
    assert [s.nodes for s in mirrored.strings] == [s.nodes for s in structure.strings]
    # The same path, read from its other end, is the same string.
    turned = replace(structure, strings=tuple(replace(s, nodes=s.nodes[::-1]) for s in structure.strings))
    both = structure.merged(turned, join=True, prefix="other ")
    assert len(both.strings) == len(structure.strings)
    apart = structure.merged(structure.moved(translation=(5.0, 0.0, 0.0)), prefix="other ")
    assert apart.strings[-1].nodes == ("other t0", "other t1", "other t2", "other t0")


def test_scenes_are_described_with_their_paths(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    from tensegrity_mj import cli

    path = tmp_path / "atwood.toml"
    tmj.save_scene(atwood(), path)
    assert cli.main(["scenes", str(path), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["strings"][0]["nodes"] == ["a", "p", "q", "b"]
    assert cli.main(["scenes", str(path)]) == 0


def test_no_segment_of_a_path_may_vanish_at_the_start() -> None:
    nodes = {"a": (0.0, 0.0, 0.0), "b": (2.0, 0.0, 0.0), "c": (1.0, 0.0, -1.0)}
    rope = (tmj.String("rope", ("a", "c", "b"), 5.0),)
    structure = tmj.Structure("s", nodes, (), rope, fixed_nodes=("a", "b"), point_masses=(tmj.PointMass("c", 1.0),))
    with pytest.raises(errors.SceneError, match="string 'rope' has length 0 m between 'a' and 'c'; it must be longer"):
        tmj.Scene(structure, initial_nodes=[(0, 0, 0), (2, 0, 0), (0, 0, 0)])
