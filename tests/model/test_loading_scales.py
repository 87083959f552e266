"""Loading takes time and memory in proportion to what a file holds: counted in operations, never by a clock."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from tensegrity_mj.library.named import load_scene
from tensegrity_mj.model.elements import contact
from tensegrity_mj.model.elements.contact import Contact, overlaps, rod_gaps, segment_distances, touching_boxes
from tensegrity_mj.model.events import Break
from tensegrity_mj.model.members import Rod, String, Support
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.model.text.writing import save_scene


def lattice(rods: int) -> Structure:
    """A row of parallel rods, each tied to the next by two strings."""
    nodes = {f"{end}{i}": (0.5 * i, 0.0, height) for i in range(rods) for end, height in (("a", 0.0), ("b", 1.0))}
    return Structure(
        "lattice",
        nodes,
        tuple(Rod(f"r{i}", (f"a{i}", f"b{i}"), 1.0) for i in range(rods)),
        tuple(String(f"{end}s{i}", (f"{end}{i}", f"{end}{i + 1}"), 10.0) for i in range(rods - 1) for end in "ab"),
    )


def star(rods: int) -> Structure:
    """Rods from one hub."""
    angles = np.linspace(0, 2 * np.pi, rods, endpoint=False)
    nodes = {"hub": (0.0, 0.0, 0.0)} | {
        f"e{i}": (float(np.cos(a)), float(np.sin(a)), 0.0) for i, a in enumerate(angles)
    }
    return Structure("star", nodes, tuple(Rod(f"r{i}", ("hub", f"e{i}"), 1.0) for i in range(rods)))


def calls(work: Callable[[], object]) -> tuple[int, int]:
    """How many functions of Python and of C the work calls, and how many numbers it gives to `numpy.array`."""
    found = [0, 0]
    array = np.array

    def count(frame: object, event: str, argument: object) -> None:
        found[0] += event in ("call", "c_call")

    def counted(values: object, *given: object, **options: object) -> object:
        made = array(values, *given, **options)  # type: ignore[call-overload]
        found[1] += made.size
        return made

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(np, "array", counted)
        sys.setprofile(count)
        try:
            work()
        finally:
            sys.setprofile(None)
    return found[0], found[1]


def broken(rods: int) -> Scene:
    structure = lattice(rods)
    return Scene(structure, breaks=tuple(Break(string.name, 1.0) for string in structure.strings))


@pytest.mark.parametrize("make", [lattice, broken, star, lambda n: Scene(lattice(n), contact=Contact(rods=True))])
def test_checks_take_work_in_proportion(make: Callable[[int], object]) -> None:
    # Twice the rods: twice the calls and twice the numbers, and what does not grow. Work of the second order, were it
    # as little as a hundredth of the whole at the first size, would show at 3 times.
    make(40)  # imports
    first, second = calls(lambda: make(200)), calls(lambda: make(400))
    for few, many in zip(first, second, strict=True):
        assert many <= 2.05 * few


def test_loading_takes_work_in_proportion(tmp_path: Path) -> None:
    path = tmp_path / "lattice.toml"
    save_scene(Scene(lattice(300)), path)
    few = calls(lambda: load_scene(path))
    save_scene(Scene(lattice(600)), path)
    many = calls(lambda: load_scene(path))
    assert many[0] <= 2.05 * few[0]
    assert many[1] <= 2.05 * few[1]


def test_clusters_of_a_hub_are_found_by_looking_at_each_node_once() -> None:
    looked = 0

    class Rows(tuple[int, ...]):
        def __iter__(self) -> Iterator[int]:
            nonlocal looked
            for row in tuple.__iter__(self):
                looked += 1
                yield row

    structure = star(50)
    del structure.__dict__["clusters"]  # found already, when it was made
    structure.__dict__["rods_at"] = {name: Rows(rows) for name, rows in structure.rods_at.items()}
    assert structure.clusters == (tuple(range(50)),)
    assert looked == 100  # the hub's rods once, and the one rod of each other node


def test_names_of_breaks_are_compared_a_few_times_each() -> None:
    compared = 0

    class Name(str):
        def __eq__(self, other: object) -> bool:
            nonlocal compared
            compared += 1
            return str.__eq__(self, other)

        __hash__ = str.__hash__

    structure = lattice(100)
    Scene(structure, breaks=tuple(Break(Name(string.name), 1.0) for string in structure.strings))
    assert compared <= 4 * len(structure.strings)


# Rods that touch are found among those whose boxes do ---------------------------------------------------------------


def every_gap(structure: Structure, nodes: np.ndarray) -> dict[tuple[int, int], float]:
    """Of all pairs of rods, without boxes."""
    i, j = np.triu_indices(len(structure.rods), 1)
    start, end = nodes[structure.rod_nodes[:, 0]], nodes[structure.rod_nodes[:, 1]]
    radii = np.array([rod.radius for rod in structure.rods])
    gaps = segment_distances(start[i], end[i], start[j], end[j]) - radii[i] - radii[j]
    return {(int(a), int(b)): float(gap) for a, b, gap in zip(i, j, gaps, strict=True)}


@pytest.mark.parametrize("piece", [1, 7, 10**6])
@pytest.mark.parametrize("seed", range(12))
def test_no_rods_that_touch_are_missed(seed: int, piece: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(contact, "PIECE", piece)
    rng = np.random.default_rng(seed)
    count = int(rng.integers(2, 40))
    points = rng.uniform(-1, 1, (2 * count, 3)) * rng.choice([0.01, 1.0, 10.0], 3)
    nodes = {f"n{i}": tuple(map(float, point)) for i, point in enumerate(points)}
    rods = tuple(
        Rod(f"r{i}", (f"n{2 * i}", f"n{2 * i + 1}"), 1.0, float(rng.uniform(0.01, 0.3)), Support.free())
        for i in range(count)
    )
    structure = Structure("random", nodes, rods)  # type: ignore[arg-type]
    pairs, gaps = rod_gaps(structure, structure.positions)
    expected = every_gap(structure, structure.positions)
    assert pairs.tolist() == sorted(pairs.tolist())
    assert {tuple(pair) for pair in pairs.tolist()} >= {pair for pair, gap in expected.items() if gap <= 0}
    for pair, gap in zip(pairs.tolist(), gaps, strict=True):
        assert gap == expected[tuple(pair)]


def test_boxes_that_only_touch_count() -> None:
    low = np.array([[0.0, 0, 0], [1.0, 0, 0], [2.5, 0, 0]])
    found = [(int(a), int(b)) for one, two in touching_boxes(low, low + 1.0) for a, b in zip(one, two, strict=True)]
    assert found == [(0, 1)]
    assert not list(touching_boxes(low[:1], low[:1] + 1.0))
    assert not overlaps(lattice(1), Contact(floor=-1.0), lattice(1).positions)
