"""The forest of rods that share nodes: every rod once, every joint once."""

from __future__ import annotations

import numpy as np
import pytest
from natural_coordinates import chain, random_class_k

from tensegrity_mj.model.forest import spanning_forest
from tensegrity_mj.model.members import Support
from tensegrity_mj.model.structure import Structure


def bars(pairs, supports=None, nodes=None):
    """Rods between nodes on a circle, one a pair."""
    count = 1 + max(max(pair) for pair in pairs)
    angle = np.linspace(0, 5, count)
    places = np.stack([np.cos(angle), np.sin(angle), 0.1 * angle], axis=1) if nodes is None else nodes
    held = [(supports or {}).get(k, Support.free()) for k in range(len(pairs))]
    return Structure.from_arrays(places, pairs, [], rod_mass=1.0, stiffness=1.0, supports=held)


def depth(forest, rod):
    """How many rods a rod hangs on."""
    return 0 if forest.parent[rod] < 0 else 1 + depth(forest, forest.parent[rod])


@pytest.mark.parametrize("planar", [False, True])
@pytest.mark.parametrize("seed", range(20))
def test_each_rod_comes_once_after_its_parent_and_each_node_of_k_rods_has_k_minus_1_joints(seed, planar):
    structure = random_class_k(np.random.default_rng(seed), rods=9, loops=3, planar=planar)
    forest = spanning_forest(structure)
    assert sorted(forest.order) == list(range(9))
    place = {int(rod): k for k, rod in enumerate(forest.order)}
    for rod, parent in enumerate(forest.parent):
        node = forest.hinge[rod]
        assert (parent < 0) == (node < 0)
        if parent >= 0:
            assert place[int(parent)] < place[rod]
            assert node in structure.rod_nodes[parent]
            assert structure.rod_nodes[rod][int(forest.flipped[rod])] == node
            assert not structure.rods[rod].support.directions
    joined = {}
    for node, owner, other in forest.joints:
        assert forest.owner[node] == owner
        assert place[owner] < place[other]
        joined.setdefault(node, set()).add(other)
    for row, name in enumerate(structure.node_names):
        rods = set(structure.rods_at[name])
        assert joined.get(row, set()) == rods - {int(forest.owner[row])}


def test_a_chain_pinned_at_its_top_is_the_thesis_chain():
    forest = spanning_forest(chain(np.random.default_rng(0), 6))
    assert forest.order.tolist() == [0, 1, 2, 3, 4, 5]
    assert forest.parent.tolist() == [-1, 0, 1, 2, 3, 4]
    assert forest.closures == ()


def test_a_free_chain_hangs_on_its_middle():
    forest = spanning_forest(chain(np.random.default_rng(0), 7, top=Support.free()))
    assert forest.roots.tolist() == [3]
    assert max(depth(forest, rod) for rod in range(7)) == 3


def test_rods_with_supports_are_roots_the_pinned_ones_first_and_where_they_meet_is_a_closure():
    line = Support.constrained([[0.0, 0.0, 1.0]], 0.0)
    forest = spanning_forest(bars([(0, 1), (1, 2), (2, 3)], {0: line, 2: Support.pinned(1.0)}))
    assert forest.roots.tolist() == [2, 0]
    assert forest.parent[1] == 2
    assert forest.closures == ((1, 0, 1),) or forest.closures == ((1, 1, 0),)


def test_a_ring_has_one_closure_and_every_further_rod_one_more():
    assert len(spanning_forest(bars([(0, 1), (1, 2), (2, 3), (3, 0)])).closures) == 1
    assert len(spanning_forest(bars([(0, 1), (1, 2), (2, 3), (3, 0), (0, 2)])).closures) == 2


def test_a_long_chain_takes_no_recursion():
    forest = spanning_forest(chain(np.random.default_rng(0), 5000, top=Support.free()))
    assert len(forest.closures) == 0
    assert forest.roots.tolist() == [2500]
