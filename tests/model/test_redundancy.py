"""Rods of which there are too many: named, warned of where the start is singular, and by whom."""

from __future__ import annotations

import natural_coordinates as natural
import numpy as np
import pytest
from natural_coordinates import random_class_k

import tensegrity_mj as tmj
from tensegrity_mj.commands.scenes import describe
from tensegrity_mj.model.members import Support
from tensegrity_mj.model.redundancy import MOST_RODS, Redundancy, redundancy
from tensegrity_mj.model.structure import Structure

Y = (0.0, 1.0, 0.0)


def between_pins(nodes, plane=None):
    """A chain of rods whose first and last nodes are pinned."""
    count = len(nodes) - 1
    free = Support.free(plane=plane)
    supports = [Support.pinned(0.0, plane), *(count - 2) * [free], Support.pinned(1.0, plane)]
    pairs = [(k, k + 1) for k in range(count)]
    return Structure.from_arrays(nodes, pairs, [], rod_mass=1.0, stiffness=1.0, supports=supports)


def square(plane):
    """Four rods and both diagonals."""
    nodes = [[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]]
    pairs = [(0, 1), (1, 2), (2, 3), (3, 0), (0, 2), (1, 3)]
    free = [Support.free(plane=plane)] * 6
    return Structure.from_arrays(nodes, pairs, [], rod_mass=1.0, stiffness=1.0, supports=free)


@pytest.mark.parametrize("seed", range(16))
def test_a_force_is_not_unique_where_the_rod_may_go_without_a_further_freedom(seed):
    """By counting: a rod is in a state of self-stress if, and only if, the rank is the same without its row."""
    rng = np.random.default_rng(seed)
    structure = random_class_k(rng, rods=9, loops=seed % 4 + 1, planar=seed % 3 == 0)
    rows, _ = natural.constraints(structure, structure.positions, np.zeros_like(structure.positions))
    rows /= np.linalg.norm(rows, axis=1)[:, None]
    rank = np.linalg.matrix_rank(rows, tol=1e-8)
    expected = [
        rod.name
        for k, rod in enumerate(structure.rods)
        if np.linalg.matrix_rank(np.delete(rows, k, axis=0), tol=1e-8) == rank
    ]
    found = redundancy(structure, structure.positions)
    assert list(found.undetermined) == expected
    assert found.skipped == 0


def test_some_of_those_random_structures_have_such_rods_and_some_have_none():
    found = []
    for seed in range(16):
        structure = random_class_k(np.random.default_rng(seed), rods=9, loops=seed % 4 + 1, planar=seed % 3 == 0)
        found.append(len(redundancy(structure, structure.positions).undetermined))
    assert min(found) == 0 < sum(count > 0 for count in found)


def test_a_truss_arm_reports_its_braced_cell_and_a_run_of_it_does():
    scene = tmj.load_scene("truss_arm")
    braced = ("lower1", "upper1", "post1", "rising1", "falling1")
    assert redundancy(scene.structure, scene.nodes0) == Redundancy(braced)
    assert describe(scene)["undetermined_forces"] == braced
    run = tmj.simulate(scene, None, tmj.DAE(), duration=0.01)
    assert run.reports["undetermined_forces"] == list(braced)
    assert run.reports["singular_start"] == []
    assert not any("singular" in warning for warning in run.reports["warnings"])


@pytest.mark.parametrize(
    ("structure", "singular"),
    [
        (between_pins([[0, 0, 0], [1, 0, 0], [2, 0, 0]]), True),  # in a line
        (between_pins([[0, 0, 0], [1, 0, 1e-7], [2, 0, 0]], Y), True),  # but for what pivots cannot show
        (between_pins([[0, 0, 0], [1, 0, 1e-4], [2, 0, 0]], Y), False),  # a flat arch
        (between_pins([[0, 0, 0], [1, 0, 0], [3, 0, 0], [2, 0, 0]], Y), True),  # a parallelogram at its change point
        (between_pins([[0, 0, 0], [0, 0, 1], [2, 0, 1], [2, 0, 0]], Y), False),  # and away from it
        (square(Y), False),  # one rod too many, which moves as a body does
        (square(None), True),  # out of its plane it would warp, and the diagonals stop it
    ],
)
def test_a_start_is_singular_where_lengths_stop_what_rows_allow(structure, singular):
    found = redundancy(structure, structure.positions)
    names = tuple(rod.name for rod in structure.rods)
    assert found.singular == (names if singular else ())
    assert found.warning == "" if not singular else "'r1', 'r2'" in found.warning


@pytest.mark.parametrize("engine", [tmj.DAE(max_steps=300), tmj.DAE(method=tmj.Method.RK4, timestep=1e-3)])
def test_a_run_from_a_singular_start_says_so_whether_it_ends_or_not(engine):
    structure = between_pins([[0, 0, 0], [1, 0, 0], [2, 0, 0]])
    still = tmj.simulate(tmj.Scene(structure, duration=0.01), None, engine)  # nothing pulls it out of its line
    assert any("start is singular: rods 'r1', 'r2'" in warning for warning in still.reports["warnings"])
    assert np.array_equal(still.nodes[-1], structure.positions)
    with pytest.raises(tmj.errors.DivergenceError, match=r"; the start is singular: rods 'r1', 'r2'.* start beside it"):
        tmj.simulate(tmj.Scene(structure, gravity=(0, 0, -9.81), duration=0.05), None, engine)


def test_a_run_whose_support_draws_rods_further_than_they_reach_says_so():
    """A bent pair of rods of 2.06 m between pins 2 m apart, one of which moves off at 0.5 m/s: straight at 0.12 s."""
    structure = between_pins([[0, 0, 0], [1, 0, 0.25], [2, 0, 0]], Y)
    motion = tmj.model.Motion.by_function("r2", lambda t: np.array([[0.5 * t, 0, 0], [0.5, 0, 0], [0, 0, 0]]))
    scene = tmj.Scene(structure, motions=(motion,), duration=0.2)
    with pytest.raises(
        tmj.errors.DivergenceError, match=r"near a singular configuration, 'r[12]' and 'r[12]' most.*reach"
    ):
        tmj.simulate(scene, None, tmj.DAE(max_steps=500))


def test_very_many_rods_are_left_out_and_counted():
    angle = np.linspace(np.pi, 2 * np.pi, MOST_RODS + 2)
    structure = between_pins(np.stack([np.cos(angle), 0 * angle, np.sin(angle)], axis=1))
    assert redundancy(structure, structure.positions).skipped == MOST_RODS + 1
