"""Prisms of any number of rods, the six-bar robot, published ones: equilibrium in closed form, and pushed over."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import tensegrity_mj as tmj
from tensegrity_mj.errors import OptionError
from tensegrity_mj.library.prism import prism, three_bar_robot
from tensegrity_mj.library.robots import pushed
from tensegrity_mj.library.six_bar import icosahedron, superball
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.runs.standing import standing
from tensegrity_mj.statics.self_stress import prestress

G = 9.81


def unbalanced(structure: Structure, rod_densities: np.ndarray) -> float:
    """Largest force [N] that strings and rods of these force densities leave on a node, over the largest tension."""
    nodes, total = structure.positions, np.zeros((len(structure.nodes), 3))
    pulls = structure.stiffness * (structure.string_lengths(nodes) - structure.rest_lengths)
    u = pulls / structure.string_lengths(nodes)
    for pairs, densities in ((structure.string_nodes, u), (structure.rod_nodes, rod_densities)):
        for (i, j), density in zip(pairs, densities, strict=True):
            total[i] += density * (nodes[j] - nodes[i])
            total[j] -= density * (nodes[j] - nodes[i])
    return float(np.abs(total).max() / pulls.max())


@pytest.mark.parametrize("n", [3, 4, 5, 6, 9, 30])
def test_a_prism_is_in_balance_at_its_closed_form(n: int) -> None:
    """Sines of the twist balance around the axis, and sides against rods along it: all to round-off."""
    scene = prism(n, tension=30.0)
    structure = scene.structure
    assert (len(structure.rods), len(structure.strings)) == (n, 3 * n)
    np.testing.assert_allclose(structure.rod_lengths, 0.5, rtol=1e-13)
    assert np.ptp(structure.positions[:, 2]) == pytest.approx(0.3, rel=1e-13)
    lengths = structure.string_lengths(structure.positions)
    tensions = structure.stiffness * (lengths - structure.rest_lengths)
    np.testing.assert_allclose(tensions[: 2 * n], 30.0, rtol=1e-12)
    u = tensions / lengths
    assert u[-1] == pytest.approx(2 * np.sin(np.pi / n) * u[0], rel=1e-12)
    assert unbalanced(structure, np.full(n, -u[-1])) < 1e-13
    first, second = (structure.positions - structure.positions.mean(axis=0))[structure.string_nodes[-1], :2]
    assert first @ second / np.linalg.norm(first) / np.linalg.norm(second) == pytest.approx(
        np.cos(np.pi / 2 - np.pi / n), abs=1e-12
    )
    # What form finding in general makes of it: one state of self-stress.
    found = prestress(structure, 10.0)
    np.testing.assert_allclose(found / found[0], u / u[0], rtol=1e-9)


def test_the_expanded_octahedron_is_in_balance_and_has_its_triangles() -> None:
    scene = icosahedron(rod_length=1.7, tension=50.0)
    structure = scene.structure
    lengths = structure.string_lengths(structure.positions)
    np.testing.assert_allclose(lengths, 1.7 * np.sqrt(6) / 4, rtol=1e-14)
    assert unbalanced(structure, np.full(6, -1.5 * 50.0 / lengths[0])) < 1e-13
    strings = {frozenset(string.nodes) for string in structure.strings}
    corners = itertools.combinations(structure.nodes, 3)
    closed = [
        three for three in corners if all(frozenset(pair) in strings for pair in itertools.combinations(three, 2))
    ]
    assert (len(strings), len(closed)) == (24, 8)
    assert all(sum(name in pair for pair in strings) == 4 for name in structure.nodes)


def test_a_level_is_a_fraction_or_a_tension() -> None:
    by_share, by_tension = icosahedron(prestress=0.2), icosahedron(tension=0.2 * 1000 * 0.6 * np.sqrt(6) / 4)
    np.testing.assert_allclose(by_share.structure.rest_lengths, by_tension.structure.rest_lengths, rtol=1e-14)
    lengths = by_share.structure.string_lengths(by_share.structure.positions)
    np.testing.assert_allclose(1 - by_share.structure.rest_lengths / lengths, 0.2, rtol=1e-12)


def test_superball_has_its_published_numbers() -> None:
    structure = superball().structure
    assert structure.rod_masses.sum() == pytest.approx(6 * 3.45)
    groups = {group: [s for s in structure.strings if s.group == group] for group in ("active", "passive")}
    assert [len(some) for some in groups.values()] == [12, 12]
    assert {s.stiffness for s in groups["active"]} == {3152.36}
    assert {s.stiffness for s in groups["passive"]} == {998.25}
    for name in structure.nodes:
        assert sum(name in s.nodes for s in groups["active"]) == 2
    assert unbalanced(structure, np.full(6, -1.5 * 83.0 / (1.7 * np.sqrt(6) / 4))) < 1e-13


def test_the_three_bar_robot_comes_to_rest_on_its_side() -> None:
    scene = three_bar_robot()
    assert unbalanced(scene.structure, np.full(3, -0.21 * 400.0)) < 1e-13
    run = tmj.simulate(scene, None, tmj.MuJoCo(5e-4), duration=2.0)
    assert standing(run).landings(0.5)[-1][1] == ("r1a", "r2b", "r3b")
    assert np.abs(run.velocities[-1]).max() < 0.02


@pytest.mark.parametrize(
    ("call", "message"),
    [
        ("prism(2)", "prism: n = 2; it must be an integer"),
        ("prism(height=0.5)", "height = 0.5 m; it must be less than rod_length = 0.5 m"),
        ("prism(tension=1e4)", "must be less than the strings' stiffness, 1500 and 1500 N/m"),
        ("prism(tension=5.0, prestress=0.1)", "prestress = 0.1 and tension = 5.0 N; give one of them"),
        ("icosahedron(tension=1e3)", "strings of 0.367423 m and 1000 N/m carry less than 367.423 N"),
        ("icosahedron(base=('r1a', 'r1b', 'r3a'))", "other nodes are up to .* m below: name three outer ones"),
        ("icosahedron(base=('r1a', 'r1b'))", "base = .*three nodes"),
        ("icosahedron(base=('r1a', 'r1b', 'r9a'))", "there is no node 'r9a'"),
        ("icosahedron(drop=-1)", "drop = -1; it must be >= 0 m"),
    ],
)
def test_wrong_robots_are_refused(call: str, message: str) -> None:
    with pytest.raises(OptionError, match=message):
        tmj.load_scene(call)


def test_a_push_tips_it_where_its_energy_lifts_the_centre_of_mass_over_the_edge() -> None:
    """A rigid body that rolls about an edge without slipping tips if ½ I ω² exceeds m g (√(h² + d²) - h).

    h is the height of its centre of mass above the edge's nodes, d its distance from their line, I the moment of
    inertia of thin rods about the line on the floor below. Strings of 10 kN/m bend under the weight by m g/(k ℓ) = 0.2
    % of the size, and friction's creep and the contacts' depth of 1 mm take some of the energy: it must tip at 1.04 ω
    and not at .96 ω.
    """
    for scene, edge in (
        (icosahedron(stiffness=1e4, damping=20.0, friction=1.5), ("r1a", "r6b")),
        (prism(3, stiffness=1e4, friction=1.5), ("r1a", "r2a")),
    ):
        structure, nodes = scene.structure, scene.nodes0
        first, second = (nodes[structure.node_index[name]] for name in edge)
        along = (second - first) / np.linalg.norm(second - first)
        arms = np.cross(along, nodes - (first - [0.0, 0.0, structure.rods[0].radius]))
        a, b = arms[structure.rod_nodes[:, 0]], arms[structure.rod_nodes[:, 1]]
        inertia = float((structure.rod_masses[:, None] / 3 * (a * a + a * b + b * b)).sum())
        centre = nodes.mean(axis=0)  # of equal rods
        h = centre[2] - first[2]
        d = abs(float(np.cross(along, [0.0, 0.0, 1.0]) @ (centre - first)))
        speed = np.sqrt(2 * structure.rod_masses.sum() * G * (np.hypot(h, d) - h) / inertia)
        bases = [
            standing(tmj.simulate(pushed(scene, edge, factor * speed), None, tmj.MuJoCo(5e-4), duration=2.0)).landings()
            for factor in (0.96, 1.04)
        ]
        start = tuple(name for name in structure.nodes if nodes[structure.node_index[name], 2] < first[2] + 1e-6)
        assert bases[0][-1][1] == start
        assert bases[1][-1][1] != start
        assert set(edge) < set(bases[1][-1][1])
