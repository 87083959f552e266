"""What reports say in words must not hang on the last digit: inputs moved by an ulp, and structures that are turned."""

from __future__ import annotations

import numpy as np
import pytest

import tensegrity_mj as tmj
from evidence.random_structures import random_rotation
from tensegrity_mj.model.redundancy import redundancy
from tensegrity_mj.model.strings import on_taut_side
from tensegrity_mj.statics import analyse, find_equilibrium
from tensegrity_mj.statics.prestress import Prestressability, prestressability
from tensegrity_mj.statics.stiffening import Verdict

# Strings as long as at rest (the first four), states of self-stress, redundant rods, strings over pulleys, no strings.
SCENES = (
    "cross",
    "pinned_rod",
    "pinned_rod_mirror",
    "prism",
    "tbar",
    "dbar",
    "six_bar_drop",
    "truss_arm",
    "pulley",
    "net",
)


def ulps(values: np.ndarray, seed: int) -> np.ndarray:
    """Values moved by an ulp of the largest, or not."""
    return values + np.spacing(np.abs(values).max()) * np.random.default_rng(seed).integers(-1, 2, values.shape)


def words(found: Prestressability) -> tuple[object, ...]:
    counts = (found.rank, found.rank_is_clear, found.mechanisms.shape[1], found.taut_mechanisms.shape[1])
    signs = (found.can_pull.tolist(), found.can_push.tolist(), found.all_can_push)
    return (*counts, *signs, found.prestress_stable, found.super_stable)


@pytest.mark.parametrize("name", SCENES)
def test_what_a_structure_can_carry_is_the_same_turned_shifted_and_an_ulp_away(name: str) -> None:
    structure = tmj.load_scene(name).structure
    expected = words(prestressability(structure))
    turned = structure.moved(random_rotation(np.random.default_rng(1)), np.array([100.0, -30.0, 7.0]))
    redundant = redundancy(structure, structure.positions)
    for other, nodes in ((structure, ulps(structure.positions, 0)), (turned, turned.positions)):
        assert words(prestressability(other, nodes=nodes)) == expected
        assert redundancy(other, nodes) == redundant


@pytest.mark.parametrize("name", ["cross", "pinned_rod", "pinned_rod_mirror", "prism", "tbar", "pulley"])
def test_what_a_state_holds_is_the_same_an_ulp_away(name: str) -> None:
    """Forces of round-off, and strings at the edge of slackness, hold nothing, and drive nothing on."""
    scene = tmj.load_scene(name)
    found = []
    for nodes in (scene.nodes0, *(ulps(scene.nodes0, seed) for seed in range(3))):
        state = find_equilibrium(tmj.statics.StaticModel.of(scene, nodes=nodes))
        found.append(words(prestressability(state)))
    assert found == found[:1] * len(found)
    if name in ("cross", "pinned_rod", "pinned_rod_mirror"):  # no string has any tension
        assert found[0][-2] is Verdict.UNDECIDED


@pytest.mark.parametrize(("shortened", "number"), [((), 0), (("side",), 1), (("side", "back"), 2)])
def test_a_note_counts_the_strings_at_the_edge_beside_taut_ones(shortened: tuple[str, ...], number: int) -> None:
    """A mass hangs on one string; two others are level and 1 m long, and as long at rest or 1.5 m."""
    nodes = {"m": (0, 0, 0), "up": (0, 0, 1), "side": (1, 0, 0), "back": (0, -1, 0)}
    level = [
        tmj.String(name, ("m", name), 50.0, rest_length=1.0 if name in shortened else 1.5) for name in ("side", "back")
    ]
    strings = (tmj.String("up", ("up", "m"), 100.0, tension=2 * 9.81), *level)
    masses = (tmj.PointMass("m", 2.0),)
    structure = tmj.Structure("hung", nodes, (), strings, fixed_nodes=("up", "side", "back"), point_masses=masses)
    notes = [note for note in analyse(tmj.Scene(structure, gravity=(0.0, 0.0, -9.81))).notes if "edge of" in note]
    assert len(notes) == (number > 0)
    assert all(f": {number} string{'s' * (number > 1)} ('side' is one)" in note for note in notes)


@pytest.mark.parametrize("away", [0.0, 1e3, 5e6])
def test_a_string_as_long_as_at_rest_is_at_the_edge_wherever_it_stands(away: float) -> None:
    """5,000 km from the origin, as in coordinates of maps, an ulp of a node is 1e-9 of a string of a metre."""
    rng = np.random.default_rng(0)
    for _ in range(50):
        direction = rng.normal(size=3)
        start = away * rng.uniform(-1, 1, 3)
        nodes = np.array([start, start + direction / np.linalg.norm(direction)])
        length = np.linalg.norm(nodes[1:] - nodes[:1], axis=1)
        taut, edge = on_taut_side(length, np.ones(1), nodes)
        assert taut.all()
        assert edge.all()
        assert not on_taut_side(length, np.ones(1) - 1e-7, nodes)[1].any()
