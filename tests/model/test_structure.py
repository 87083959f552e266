"""Structures: what is refused and in which words, what arrays give, and the bases of supports."""

from __future__ import annotations

import math
import pickle
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from evidence.random_structures import random_rotation, random_structure
from tensegrity_mj.errors import StructureError
from tensegrity_mj.model.members import PointMass, Rod, RodMass, String, Support, null_space_bases, null_space_basis
from tensegrity_mj.model.strings import StringLaw
from tensegrity_mj.model.structure import Structure

NODES = {"a": (0.0, 0.0, 0.0), "b": (1.0, 0.0, 0.0), "c": (0.0, 0.0, 2.0), "d": (0.0, 1.0, 2.0), "f": (3.0, 0.0, 0.0)}
NAN, INF = math.nan, math.inf


def build(**changes: Any) -> Structure:
    """Two rods, a fixed node, three strings; anything may be replaced."""
    parts: dict[str, Any] = {
        "name": "two rods",
        "nodes": NODES,
        "rods": (Rod("r1", ("a", "b"), 1.0), Rod("r2", ("c", "d"), 2.0)),
        "strings": (String("s1", ("b", "f"), 5.0), String("s2", ("a", "c"), 5.0), String("s3", ("b", "d"), 5.0)),
        "fixed_nodes": ("f",),
    }
    return Structure(**(parts | changes))


def with_rod(**changes: Any) -> Structure:
    good = build()
    return build(rods=(replace(good.rods[0], **changes), good.rods[1]))


def with_support(support: Any) -> Structure:
    return with_rod(support=support)


def with_string(**changes: Any) -> Structure:
    good = build()
    return build(strings=(*good.strings[:2], replace(good.strings[2], **changes)))


def with_node(**positions: Any) -> Structure:
    return build(nodes=NODES | positions)


def with_mass(point: Any) -> Structure:
    return build(nodes=NODES | {"p": (0.0, 5.0, 0.0)}, point_masses=(point,))


def chain(*planes: Any) -> Structure:
    """Three rods one after another, the outer ones with these planes, the middle one with the first's."""
    ends = [("a", "b"), ("b", "c"), ("c", "d")]
    nodes = {name: (float(k), 0.0, 0.1 * k * k) for k, name in enumerate("abcd")}
    of = (planes[0], planes[0], planes[-1])
    rods = [Rod(f"r{k + 1}", pair, 1.0, support=Support.free(plane=of[k])) for k, pair in enumerate(ends)]
    return Structure("chain", nodes, tuple(rods))


D_TWICE = [[1, 0, 0], [-2, 0, 0]]

# What is wrong -> (how to build it, what the message must name: the item, its value, what is allowed).
INVALID: dict[str, tuple[Callable[[], Structure], tuple[str, ...]]] = {
    # nodes
    "no nodes": (lambda: build(nodes={}), ("two rods", "no nodes")),
    "nodes are no mapping": (lambda: build(nodes=[(0, 0, 0)]), ("nodes = [(0, 0, 0)]", "node name")),
    "nodes are a list in NaN": (lambda: with_node(c=(0.0, NAN, 2.0)), ("'c'", "nan", "finite")),
    "infinite node": (lambda: with_node(c=(0.0, INF, 2.0)), ("'c'", "inf", "finite")),
    "node of two numbers": (lambda: with_node(c=(0.0, 2.0)), ("'c'", "(0.0, 2.0)", "three")),
    "node that is a text": (lambda: with_node(c="top"), ("'c'", "'top'", "three")),
    "node without name": (lambda: build(nodes=NODES | {"": (0, 0, 1)}), ("node ''", "non-empty")),
    "node named by a number": (lambda: build(nodes=NODES | {7: (0, 0, 1)}), ("node 7", "string")),
    "node named with a control character": (lambda: build(nodes=NODES | {"x\n": (0, 0, 1)}), ("'x\\n'", "printable")),
    "unused node": (lambda: with_node(x=(9, 9, 9)), ("'x'", "used by no", "remove")),
    "massless node": (
        lambda: build(nodes=NODES | {"x": (9, 9, 9)}, strings=(String("s9", ("a", "x"), 1.0), *build().strings)),
        ("'x'", "no mass", "fixed_nodes"),
    ),
    "nothing moves": (lambda: build(rods=(), strings=(), nodes={"f": (0, 0, 0)}), ("neither rods nor point masses",)),
    # names, kinds
    "name of the structure": (lambda: build(name=3), ("structure", "name = 3", "text")),
    "rods are a text": (lambda: build(rods="r1"), ("rods", "'r1'", "sequence")),
    "one rod instead of a tuple": (lambda: build(rods=Rod("r1", ("a", "b"), 1.0)), ("rods", "sequence")),
    "rod of another kind": (lambda: build(rods=(("a", "b"),)), ("rods[0]", "('a', 'b')", "Rod")),
    "string of another kind": (lambda: build(strings=(build().rods[0],)), ("strings[0]", "String")),
    "rod without name": (lambda: with_rod(name=""), ("rod: name = ''", "non-empty")),
    "rod name twice": (lambda: with_rod(name="r2"), ("rod 'r2'", "twice", "unique")),
    "string name twice": (lambda: with_string(name="s1"), ("string 's1'", "twice", "unique")),
    "string law": (lambda: build(string_law="cut"), ("'cut'", "StringLaw.CLIPPED", "StringLaw.UNCLIPPED")),
    # rods
    "rod to an unknown node": (lambda: with_rod(nodes=("a", "z")), ("rod 'r1'", "'z'", "'a', 'b', 'c', 'd', 'f'")),
    "rod with three ends": (lambda: with_rod(nodes=("a", "b", "c")), ("rod 'r1'", "two nodes")),
    "rod whose ends are a text": (lambda: with_rod(nodes="ab"), ("rod 'r1'", "'ab'", "must name two nodes")),
    "rod whose end is a list": (
        lambda: with_rod(nodes=(["a"], "b")),
        ("'r1'", "nodes[0] = ['a']", "name of a node"),
    ),
    "rod on one node": (lambda: with_rod(nodes=("a", "a")), ("rod 'r1'", "'a'", "two different nodes")),
    "rods along each other": (
        lambda: with_rod(nodes=("d", "c")),
        ("rod 'r2'", "rod 'r1'", "'c' and 'd'", "mass of both"),
    ),
    "joined rods in other planes": (
        lambda: chain((0, 1, 0), (-5e-7, 1, 1e-6)),
        ("rods 'r1' and 'r3'", "joined", "(0.0, 1.0, 0.0)", "(-5e-07, 1.0, 1e-06)", "one plane"),
    ),
    "a planar rod joined to one in space": (
        lambda: chain(None, (0, 1, 0)),
        ("rods 'r1' and 'r3'", "in space", "the plane of normal (0.0, 1.0, 0.0)", "one plane"),
    ),
    "zero-length rod": (lambda: with_node(b=(0, 0, 0)), ("rod 'r1'", "length 0 m", "'a'", "'b'", "longer")),
    "rod of endless length": (lambda: with_node(b=(1e200, 0, 0)), ("node 'b'", "1e+200", "at most 1e+100")),
    "mass zero": (lambda: with_rod(mass=0.0), ("rod 'r1'", "mass = 0.0", "> 0 kg")),
    "negative mass": (lambda: with_rod(mass=np.float64(-2.0)), ("rod 'r1'", "mass = -2.0;", "> 0 kg")),
    "mass NaN": (lambda: with_rod(mass=NAN), ("rod 'r1'", "mass = nan", "> 0 kg")),
    "mass that is a text": (lambda: with_rod(mass="heavy"), ("rod 'r1'", "mass = 'heavy'", "> 0 kg")),
    "mass that is true": (lambda: with_rod(mass=True), ("rod 'r1'", "mass = True", "> 0 kg")),
    "mass beyond the floats": (lambda: with_rod(mass=10**400), ("rod 'r1'", "mass = 1000", "> 0 kg")),
    "radius": (lambda: with_rod(radius=-0.1), ("rod 'r1'", "radius = -0.1", "> 0 m")),
    # supports
    "support of another kind": (lambda: with_support("pinned"), ("rod 'r1'", "'pinned'", "Support.pinned")),
    "sigma": (lambda: with_support(Support.pinned(1.5)), ("support", "sigma = 1.5", "[0, 1]")),
    "sigma NaN": (lambda: with_support(Support.free(NAN)), ("support", "sigma = nan", "[0, 1]")),
    "rows of D that contradict": (
        lambda: with_support(Support.constrained(D_TWICE)),
        ("support", "[[1.0, 0.0, 0.0], [-2.0, 0.0, 0.0]]", "contradict or repeat", "independent"),
    ),
    "zero row of D": (lambda: with_support(Support.constrained([0, 0, 0])), ("support", "independent")),
    "four rows of D": (lambda: with_support(Support.constrained(np.ones((4, 3)))), ("support", "independent")),
    "NaN in D": (lambda: with_support(Support(0.0, ((NAN, 0, 0),))), ("support", "D[0] = (nan, 0, 0)", "finite")),
    "D is no sequence": (lambda: with_support(Support(0.0, 5)), ("support", "D = 5", "sequence")),  # type: ignore[arg-type]
    "r̄ away from the nodes": (
        lambda: with_support(Support.constrained([0, 0, 2], values=[0.5])),
        ("rod 'r1'", "D r = [0.0]", "σ = 0.0", "[0.5]", "move the nodes"),
    ),
    "r̄ of the wrong size": (
        lambda: with_support(Support(0.0, ((0.0, 0.0, 1.0),), (0.0, 0.0))),
        ("support", "2 values", "1 rows"),
    ),
    "r̄ NaN": (lambda: with_support(Support(0.0, ((0.0, 0.0, 1.0),), (NAN,))), ("support", "values = (nan,)", "finite")),
    "plane that the rod leaves": (
        lambda: with_support(Support.free(plane=(1, 0, 1))),
        ("rod 'r1'", "(1.0, 0.0, 1.0)", "0.707 m", "must lie in its plane"),
    ),
    "plane without normal": (
        lambda: with_support(Support.free(plane=(0, 0, 0))),
        ("plane = (0, 0, 0)", "zero"),
    ),
    "plane NaN": (lambda: with_support(Support(0.5, plane=(0, NAN, 1))), ("support", "plane = (0, nan, 1)", "finite")),
    # strings
    "string to an unknown node": (lambda: with_string(nodes=("b", "z")), ("string 's3'", "'z'", "'a', 'b', 'c'")),
    "string on one node": (lambda: with_string(nodes=("b", "b")), ("string 's3'", "'b'", "two different nodes")),
    "duplicated string": (lambda: with_string(nodes=("c", "a")), ("string 's3'", "'c' and 'a'", "'s2'", "remove")),
    "string along its own rod": (lambda: with_string(nodes=("d", "c")), ("string 's3'", "rod 'r2'", "'d' and 'c'")),
    "zero-length string": (lambda: with_node(f=(1, 0, 0)), ("string 's1'", "length 0 m", "'b'", "'f'", "longer")),
    "stiffness zero": (lambda: with_string(stiffness=0), ("string 's3'", "stiffness = 0", "> 0 N/m")),
    "negative stiffness": (lambda: with_string(stiffness=-5.0), ("string 's3'", "stiffness = -5.0", "> 0 N/m")),
    "infinite stiffness": (lambda: with_string(stiffness=INF), ("string 's3'", "stiffness = inf", "> 0 N/m")),
    "negative damping": (lambda: with_string(damping=-1.0), ("string 's3'", "damping = -1.0", ">= 0 N s/m")),
    "rest length NaN": (lambda: with_string(rest_length=NAN), ("string 's3'", "rest_length = nan", "finite")),
    "negative tension": (lambda: with_string(tension=-1.0), ("string 's3'", "tension = -1.0", ">= 0")),
    "negative force density": (
        lambda: with_string(force_density=-1.0),
        ("string 's3'", "force_density = -1.0", ">= 0"),
    ),
    "two prestresses": (
        lambda: with_string(rest_length=1.0, tension=1.0),
        ("string 's3'", "rest_length and tension", "at most one"),
    ),
    # fixed nodes
    "unknown fixed node": (lambda: build(fixed_nodes=("f", "z")), ("fixed_nodes", "'z'", "'a', 'b'")),
    "fixed node twice": (lambda: build(fixed_nodes=("f", "f")), ("fixed node 'f'", "twice")),
    "fixed nodes are a text": (lambda: build(fixed_nodes="f"), ("fixed_nodes", "'f'", "sequence")),
    "fixed end of a rod": (
        lambda: build(fixed_nodes=("f", "a")),
        ("'a'", "rod 'r1'", "pin the rod", "pin one of them"),
    ),
    # point masses
    "point mass on an unknown node": (lambda: with_mass(PointMass("z", 1.0)), ("point mass", "'z'", "'a', 'b'")),
    "point mass on a rod, in a plane": (
        lambda: build(point_masses=(PointMass("a", 1.0, (0, 0, 1)),)),
        ("point mass on node 'a'", "plane = ", "rod 'r1' ends there", "leave the plane out"),
    ),
    "two point masses on a rod's end": (
        lambda: build(point_masses=(PointMass("a", 1.0), PointMass("a", 2.0))),
        ("point mass on node 'a'", "is the point mass on node 'a' already"),
    ),
    "negative damping of a point mass": (
        lambda: with_mass(PointMass("p", 1.0, damping=-1.0)),
        ("'p'", "damping = -1.0", ">= 0 N s/m"),
    ),
    "mass beside a rod": (lambda: RodMass(1.2, 1.0), ("mass on a rod", "at = 1.2", "[0, 1]")),
    "mass of nothing on a rod": (lambda: RodMass(0.2, 0.0), ("mass on a rod", "mass = 0.0", "> 0 kg")),
    "inertia below zero": (lambda: RodMass(0.2, 1.0, -1.0), ("mass on a rod", "inertia = -1.0", ">= 0 kg m²")),
    "masses that are none": (lambda: with_rod(masses=(1.0,)), ("rod 'r1'", "masses[0] = 1.0", "RodMass(at, mass")),
    "point mass on a fixed node": (lambda: with_mass(PointMass("f", 1.0)), ("point mass", "'f'", "a fixed node")),
    "massless point mass": (lambda: with_mass(PointMass("p", 0.0)), ("'p'", "mass = 0.0", "> 0 kg")),
    "plane of a point mass": (lambda: with_mass(PointMass("p", 1.0, (0, 0, 0))), ("'p'", "plane = (0, 0, 0)", "zero")),
}


@pytest.mark.parametrize("case", INVALID)
def test_refused_and_named(case: str) -> None:
    make, words = INVALID[case]
    with pytest.raises(StructureError) as caught:
        make()
    for word in words:
        assert word in str(caught.value)


def test_the_structure_that_the_cases_spoil_is_valid() -> None:
    structure = build()
    assert structure.node_names == ("a", "b", "c", "d", "f")
    assert with_mass(PointMass("p", 1.0)).point_masses[0].mass == 1.0


def test_rods_may_share_nodes() -> None:
    """A closed triangle with a leg, a rod of its own, and a fixed node: clusters, class and joints by hand."""
    pairs = [("a", "b"), ("b", "c"), ("c", "a"), ("g", "h"), ("c", "d")]
    places = {"a": (0, 0, 0), "b": (1, 0, 0), "c": (0, 1, 0), "d": (0, 1, 2), "g": (5, 0, 0), "h": (6, 0, 0)}
    made = Structure(
        "linked",
        places | {"f": (9, 9, 9)},
        tuple(Rod(f"r{k}", pair, 1.0) for k, pair in enumerate(pairs)),
        (String("s", ("d", "f"), 1.0), String("t", ("g", "a"), 1.0)),
        ("f",),
    )
    assert made.class_number == 3
    ends = {"a": (0, 2), "b": (0, 1), "c": (1, 2, 4), "d": (4,), "g": (3,), "h": (3,), "f": ()}
    assert made.rods_at == ends
    assert made.clusters == ((0, 1, 2, 4), (3,))
    assert (build().class_number, build().clusters) == (1, ((0,), (1,)))
    # A closed loop may be held at a joint by two of its rods, which is one support too many, and no contradiction.
    twice = replace(made, rods=tuple(replace(rod, support=Support.pinned(0.0)) for rod in made.rods))
    assert twice.class_number == 3
    lone = Structure("mass", {"p": (0, 0, 0)}, point_masses=(PointMass("p", 1.0),))
    assert (lone.class_number, lone.clusters, lone.rods_at) == (0, (), {"p": ()})
    assert chain((0, 1, 0), (0, -2, 0)).clusters == ((0, 1, 2),)


@settings(derandomize=True, max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(2, 12), st.integers(1, 20))
def test_clusters_are_the_connected_components(seed: int, nodes: int, rods: int) -> None:
    rng = np.random.default_rng(seed)
    pairs = sorted({tuple(sorted(rng.choice(nodes, 2, replace=False).tolist())) for _ in range(rods)})
    used = sorted({node for pair in pairs for node in pair})
    made = Structure.from_arrays(
        rng.normal(size=(len(used), 3)),
        [(used.index(i), used.index(j)) for i, j in pairs],
        [],
        rod_mass=1.0,
        stiffness=[],
    )
    # A power of the adjacency of the rods, to which they are long connected: another way.
    ends = np.zeros((len(pairs), len(used)))
    for row, pair in enumerate(made.rod_nodes):
        ends[row, pair] = 1
    joined = np.linalg.matrix_power(np.eye(len(pairs)) + np.minimum(ends @ ends.T, 1), len(pairs)) > 0
    assert made.clusters == tuple(sorted({tuple(np.flatnonzero(row).tolist()) for row in joined}))
    assert made.class_number == int(ends.sum(axis=0).max())


def test_a_string_between_two_immovable_points_is_allowed() -> None:
    pinned = (
        Rod("r1", ("a", "b"), 1.0, support=Support.pinned(0.0)),
        Rod("r2", ("c", "d"), 1.0, support=Support.pinned(0.0)),
    )
    assert build(rods=pinned).strings[1].nodes == ("a", "c")
    nodes = NODES | {"g": (4.0, 0.0, 0.0)}
    strings = (*build().strings, String("s4", ("f", "g"), 1.0))
    assert len(build(nodes=nodes, fixed_nodes=("f", "g"), strings=strings).strings) == 4


def test_everything_becomes_plain_tuples_and_floats() -> None:
    listed = build(
        nodes={name: list(position) for name, position in NODES.items()},
        rods=[Rod("r1", ["a", "b"], np.float64(1)), Rod("r2", ["c", "d"], 2, support=Support(0, [[0, 0, 1]], [2]))],  # type: ignore[arg-type, list-item]
        strings=[String("s1", ["b", "f"], 5), String("s2", ["a", "c"], 5), String("s3", ["b", "d"], 5)],  # type: ignore[arg-type]
        fixed_nodes=["f"],
    )
    support = Support.constrained([0, 0, 1], 0.0, [2.0])
    assert listed == build(rods=(Rod("r1", ("a", "b"), 1.0), Rod("r2", ("c", "d"), 2.0, support=support)))
    assert type(listed.rods[1].mass) is float
    assert type(listed.rods[1].support.directions[0]) is tuple
    assert hash(listed.rods[0]) == hash(build().rods[0])
    assert pickle.loads(pickle.dumps(listed)) == listed


def test_structures_are_immutable() -> None:
    structure = build()
    with pytest.raises(AttributeError):
        structure.rods = ()  # type: ignore[misc]
    for array in (structure.positions, structure.stiffness, structure.rest_lengths, structure.string_nodes):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 7.0


# Arrays ----------------------------------------------------------------------------------------------------

GRID = np.array([[0, 0, 0], [1, 0, 0], [0, 0, 2], [0, 1, 2], [3, 0, 0]], float)


def from_arrays(**changes: Any) -> Structure:
    parts: dict[str, Any] = {
        "nodes": GRID,
        "rods": [(0, 1), (2, 3)],
        "strings": [(1, 4), (0, 2)],
        "rod_mass": [1.0, 2.0],
        "stiffness": 5.0,
        "fixed_nodes": [4],
    }
    return Structure.from_arrays(**(parts | changes))


def test_from_arrays_is_the_structure_written_out() -> None:
    written = Structure(
        name="structure",
        nodes={f"n{i + 1}": tuple(row) for i, row in enumerate(GRID.tolist())},
        rods=(
            Rod("r1", ("n1", "n2"), 1.0, 0.01, Support.pinned(0.0)),
            Rod("r2", ("n3", "n4"), 2.0, 0.01, Support.constrained([0, 0, 1])),
        ),
        strings=(String("s1", ("n2", "n5"), 5.0, 0.1, tension=3.0), String("s2", ("n1", "n3"), 5.0, 0.2, tension=3.0)),
        fixed_nodes=("n5",),
        string_law=StringLaw.UNCLIPPED,
    )
    supports = [Support.pinned(0.0), Support.constrained([0, 0, 1])]
    arrays = from_arrays(tension=3.0, damping=[0.1, 0.2], supports=supports, string_law=StringLaw.UNCLIPPED)
    assert arrays == written


def test_from_arrays_takes_numpy_indices_and_point_masses() -> None:
    nodes = np.vstack([GRID, [0, 5, 0]])
    structure = from_arrays(
        nodes=nodes, rods=np.array([[0, 1], [2, 3]]), strings=np.array([[1.0, 4.0]]), point_masses={np.int64(5): 2}
    )
    assert structure.point_masses == (PointMass("n6", 2.0),)
    assert structure.strings[0].nodes == ("n2", "n5")


BAD_ARRAYS: dict[str, tuple[dict[str, Any], tuple[str, ...]]] = {
    "nodes in a row": ({"nodes": [0.0, 1.0, 2.0]}, ("nodes", "(3,)", "(N, 3)")),
    "nodes in columns": ({"nodes": GRID.T}, ("nodes", "(3, 5)", "(N, 3)")),
    "NaN": ({"nodes": np.where(GRID == 3, NAN, GRID)}, ("nodes[4, 0]", "nan", "finite")),
    "ragged nodes": ({"nodes": [[0, 0, 0], [1]]}, ("nodes", "an array of shape")),
    "index beyond": ({"rods": [(0, 1), (2, 5)]}, ("rods[1]", "(2, 5)", "0 to 4")),
    "negative index": ({"strings": [(-1, 2)]}, ("strings[0]", "(-1, 2)", "0 to 4")),
    "half an index": ({"strings": [(0.5, 2)]}, ("strings[0]", "integers")),
    "infinite index": ({"strings": [(INF, 2)]}, ("strings[0]", "pair of node indices")),
    "three ends": ({"rods": [(0, 1, 2), (2, 3, 4)]}, ("rods[0]", "(0, 1, 2)", "pair")),
    "pairs laid flat": ({"rods": [0, 1, 2, 3]}, ("rods[0]", "0", "pair")),
    "no pairs at all": ({"rods": 3}, ("rods", "3", "sequence")),
    "equal ends": ({"strings": [(2, 2)]}, ("string 's1'", "'n3'", "two different nodes")),
    "masses": ({"rod_mass": [1.0, 2.0, 3.0]}, ("rod_mass", "(3,)", "(2,)", "a number")),
    "negative mass": ({"rod_mass": [1.0, -2.0]}, ("rod 'r2'", "mass = -2.0", "> 0 kg")),
    "stiffness NaN": ({"stiffness": [1.0, NAN]}, ("stiffness[1]", "nan", "finite")),
    "supports": ({"supports": [Support.free()]}, ("supports: 1 for 2 rods",)),
    "fixed node beyond": ({"fixed_nodes": [7]}, ("fixed_nodes[0]", "0 to 4")),
    "point mass beyond": ({"point_masses": {9: 1.0}}, ("point_masses[0]", "0 to 4")),
    "two prestresses": ({"tension": 1.0, "rest_length": 1.0}, ("string 's1'", "at most one")),
}


@pytest.mark.parametrize("case", BAD_ARRAYS)
def test_bad_arrays_are_refused_and_named(case: str) -> None:
    changes, words = BAD_ARRAYS[case]
    with pytest.raises(StructureError) as caught:
        from_arrays(**changes)
    for word in words:
        assert word in str(caught.value)


@pytest.mark.parametrize(
    ("D", "message"),
    [
        ([[1, 0], [0, 1]], "D[0] = [1, 0]; it must be three finite numbers of at most"),
        ([1, 0], "D[0] = [1, 0]; it must be three finite numbers of at most"),
        ("xyz", "D = 'xyz'; it must be a sequence"),
        ([[1, 0, 0], [1]], "D[1] = [1]; it must be three finite numbers of at most"),
        (5.0, "D = 5.0; it must be a sequence"),
        ([], "D = []; it must be one to three rows of three numbers, as [[0, 0, 1]]; use Support.free"),
        (np.zeros((0, 3)), "D = []; it must be one to three rows"),
    ],
)
def test_d_of_another_shape_is_refused(D: Any, message: str) -> None:
    with pytest.raises(StructureError) as caught:
        Support.constrained(D)
    assert str(caught.value).startswith(f"support: {message}")


def test_plane_of_another_shape_is_refused() -> None:
    with pytest.raises(StructureError, match=r"plane = \(1, 0\); it must be three finite numbers"):
        Support.free(plane=(1, 0))


# What a structure works out -----------------------------------------------------------------------------


def test_rest_lengths_of_every_way_to_state_prestress() -> None:
    # s1 is 2 m long, s2 2 m, s3 sqrt(1 + 1 + 4) m, all of stiffness 5 N/m.
    ends = [("b", "f"), ("a", "c"), ("b", "d")]
    ways: list[dict[str, float]] = [{"rest_length": 1.5}, {"tension": 2.0}, {"force_density": 0.5}]
    strings = [String(f"s{i + 1}", pair, 5.0, **way) for i, (pair, way) in enumerate(zip(ends, ways, strict=True))]
    expected = [1.5, 2.0 - 2.0 / 5.0, math.sqrt(6) * (1 - 0.5 / 5.0)]
    np.testing.assert_allclose(build(strings=strings).rest_lengths, expected, rtol=1e-15)
    np.testing.assert_allclose(build().rest_lengths, [2.0, 2.0, math.sqrt(6)], rtol=1e-15)


def test_with_strings_replaces_the_prestress_that_was_there() -> None:
    structure = build().with_strings(tension=[1.0, 2.0, 3.0])
    assert [s.tension for s in structure.strings] == [1.0, 2.0, 3.0]
    softer = structure.with_strings(stiffness=4.0, force_density=0.5)
    assert [(s.tension, s.force_density, s.stiffness) for s in softer.strings] == [(None, 0.5, 4.0)] * 3
    assert softer.with_strings(force_density=None) == build().with_strings(stiffness=4.0)
    with pytest.raises(StructureError, match=r"'colour'.*stiffness"):
        structure.with_strings(colour=1.0)
    with pytest.raises(StructureError, match=r"tension = .* of shape \(2,\)"):
        structure.with_strings(tension=[1.0, 2.0])


@settings(derandomize=True, max_examples=50, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_string_rates_are_the_slopes_of_the_lengths(seed: int) -> None:
    rng = np.random.default_rng(seed)
    structure = random_structure(rng, rods=3, point_masses=1)
    velocities = rng.normal(size=structure.positions.shape)
    h = 1e-5
    ahead = structure.string_lengths(structure.positions + h * velocities)
    behind = structure.string_lengths(structure.positions - h * velocities)
    # Central difference: h²/6 times the third derivative, which is at most 3 v³ / L² with L > 0.2 m (the generator)
    # and v < 8 m/s (two normal vectors): 7e-7 m/s; round-off eps L / h adds 1e-10.
    exact = structure.string_rates(structure.positions, velocities)
    np.testing.assert_allclose((ahead - behind) / (2 * h), exact, atol=1e-6)


# Supports -----------------------------------------------------------------------------------------------


@settings(derandomize=True, max_examples=100, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 3), st.integers(-12, 12))
def test_the_basis_is_orthonormal_and_orthogonal_to_the_rows(seed: int, count: int, scale: int) -> None:
    rng = np.random.default_rng(seed)
    rows = random_rotation(rng)[:count]
    rows[0] *= 10.0**scale  # the length of a row must not matter
    basis = null_space_basis(rows)
    assert basis.shape == (3, 3 - count)
    np.testing.assert_allclose(basis.T @ basis, np.eye(3 - count), atol=1e-14)
    np.testing.assert_allclose(random_rotation(np.random.default_rng(seed))[:count] @ basis, 0.0, atol=1e-14)


def test_bases_of_many_are_those_of_each() -> None:
    for count in (1, 2):
        stack = np.random.default_rng(count).normal(size=(20, count, 3))
        np.testing.assert_array_equal(null_space_bases(stack), [null_space_basis(rows) for rows in stack])


def test_axis_parallel_supports_give_unit_vectors_exactly() -> None:
    np.testing.assert_array_equal(Support.constrained([0, 0, 2]).translation_basis, np.eye(3)[:, :2])
    np.testing.assert_array_equal(Support.constrained([[1, 0, 0], [0, 0, 1]]).translation_basis, np.eye(3)[:, 1:2])
    np.testing.assert_array_equal(Support.free().translation_basis, np.eye(3))
    assert Support.pinned().translation_basis.shape == (3, 0)


def test_a_plane_holds_the_rod_at_its_height_too() -> None:
    free = Support.free(plane=(0, 1, 0))
    np.testing.assert_array_equal(free.translation_basis[1], [0.0, 0.0])
    assert free.translation_basis.shape == (3, 2)
    assert free.rotation_basis.shape == (3, 2)
    assert Support.constrained([1, 0, 0], plane=(0, 1, 0)).translation_basis.shape == (3, 1)
    # A D that holds the height already is not a second constraint.
    assert Support.constrained([0, 1, 0], plane=(0, 1, 0)).translation_basis.shape == (3, 2)
    assert Support.pinned(plane=(0, 1, 0)).translation_basis.shape == (3, 0)
    assert PointMass("p", 1.0, (0, 1, 0)).translation_basis.shape == (3, 2)


@settings(derandomize=True, max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.booleans(), st.integers(-6, 6))
def test_random_structures_are_valid_at_any_size_and_place(seed: int, planar: bool, scale: int) -> None:
    rng = np.random.default_rng(seed)
    size = 10.0**scale
    structure = random_structure(rng, rods=3, planar=planar, own_planes=0.5, fixed_nodes=2, point_masses=1, size=size)
    turned = structure.moved(random_rotation(rng), size * rng.normal(size=3))
    np.testing.assert_allclose(turned.rod_lengths, structure.rod_lengths, rtol=1e-12)


def test_rows_are_in_the_order_of_the_names_given_not_of_the_alphabet() -> None:
    nodes = {"z": (0.0, 0.0, 0.0), "n10": (1.0, 0.0, 0.0), "n9": (0.0, 2.0, 0.0), "a": (0.0, 2.0, 3.0)}
    made = Structure("names", nodes, (Rod("r1", ("z", "n10"), 1.0), Rod("r2", ("a", "n9"), 1.0)))
    assert made.node_names == ("z", "n10", "n9", "a")
    assert [made.node_index[name] for name in made.node_names] == [0, 1, 2, 3]
    assert [tuple(made.positions[made.node_index[name]]) for name in made.node_names] == list(nodes.values())
    assert made.rod_nodes.tolist() == [[0, 1], [3, 2]]


@pytest.mark.parametrize("nodes", [3, None, "abc", [], [[0, 0, 0], [1, 0]], np.zeros((2, 3, 3))])
def test_nodes_that_are_no_rows_of_three_are_refused(nodes: Any) -> None:
    with pytest.raises(StructureError, match=r"nodes = .*shape \(N, 3\) \[m\]"):
        from_arrays(nodes=nodes)


def test_numbers_beyond_floats_are_refused_by_name() -> None:
    with pytest.raises(StructureError, match="stiffness = "):
        from_arrays(stiffness=10**400)
