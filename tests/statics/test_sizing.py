"""Minimal-mass sizing against closed forms, published results, enumeration, and choices at random."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import linprog

from evidence.families.towers import base_nodes, top_nodes
from tensegrity_mj.basics.jsontext import to_json
from tensegrity_mj.errors import InfeasibleError, OptionError
from tensegrity_mj.library.tower import tower
from tensegrity_mj.model.members import PointMass, Rod, String, Support
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.statics.boundary import Hold
from tensegrity_mj.statics.equilibrium import find_equilibrium
from tensegrity_mj.statics.least_mass import Problem, Search
from tensegrity_mj.statics.lightest import ALUMINIUM, STEEL, UHMWPE, Governs, Material, Sizing, minimal_mass
from tensegrity_mj.statics.model import Rods, StaticModel
from tensegrity_mj.statics.strength import Criterion, check_members

Array = NDArray[np.float64]

SQUARE = [[-1.0, 0, 0], [0, -1, 0], [1, 0, 0], [0, 1, 0]]
RING, CROSS = [(0, 1), (1, 2), (2, 3), (3, 0)], [(0, 2), (1, 3)]
SQUEEZE = np.array([[1e4, 0, 0], [0, 0, 0], [-1e4, 0, 0], [0, 0, 0]])
DBAR = Structure.from_arrays(SQUARE, RING, CROSS, rod_mass=1.0, stiffness=1.0, name="dbar")
TBAR = Structure.from_arrays(SQUARE, CROSS, RING, rod_mass=1.0, stiffness=1.0, name="tbar")

# Units in which a bar of 1 m yields at 1 kg/N and buckles at 1 kg/√N: the switch is at 1 N.
UNIT = Material(1.0, 4.0 / math.pi, 1.0)


def buckling_mass(material: Material, length: float, force: float) -> float:
    """ρ π r² ℓ with r from Euler's load π² E (π r⁴ / 4) / ℓ² = force."""
    radius = (4 * force * length**2 / (math.pi**3 * material.elasticity_modulus)) ** 0.25
    return material.density * math.pi * radius**2 * length


def mass_of(sizing: Sizing, rod_forces: Array, tensions: Array) -> float:
    """The mass that rods and strings need under those forces (K, R) and (K, M), from areas, member by member."""
    total = 0.0
    for forces, length, stuff in zip(rod_forces.T, sizing.given.rod_lengths, sizing.rod_materials, strict=True):
        need = 0.0
        for force in forces:
            area = abs(force) / stuff.yield_stress
            if force < 0:
                area = max(area, buckling_mass(stuff, length, -force) / stuff.density / length)
            need = max(need, stuff.density * length * area)
        total += need
    lengths = sizing.given.string_lengths(sizing.given.positions)
    for pulls, length, stuff in zip(tensions.T, lengths, sizing.string_materials, strict=True):
        total += stuff.density * length * max(pulls) / stuff.yield_stress
    return total


def balance(structure: Structure) -> Array:
    """Forces on the nodes (3N, R + M) of unit forces in rods and strings, node by node."""
    columns = []
    for member in (*structure.rods, *structure.strings):
        i, j = (structure.node_index[name] for name in member.nodes)
        unit = structure.positions[j] - structure.positions[i]
        unit = unit / np.linalg.norm(unit)
        column = np.zeros((len(structure.nodes), 3))
        column[i], column[j] = unit, -unit
        columns.append(column.ravel())
    return np.array(columns).T


def is_sound(sizing: Sizing, loads: Array) -> None:
    """Forces are in balance, strings pull, masses are what forces need, and the bound is below."""
    matrix = balance(sizing.given)
    cases = loads.reshape(-1, matrix.shape[0])
    size = max(float(np.abs(cases).max()), float(np.abs(sizing.rod_forces).max(initial=0.0)))
    for forces, tensions, reactions, load in zip(
        sizing.rod_forces, sizing.tensions, sizing.reactions, cases, strict=True
    ):
        left = matrix @ np.concatenate([forces, tensions]) + load + reactions.ravel()
        assert np.abs(left).max() <= 1e-11 * size  # round-off of a few dozen members
    assert sizing.tensions.min(initial=0.0) >= 0.0
    assert sizing.mass == pytest.approx(mass_of(sizing, sizing.rod_forces, sizing.tensions), rel=1e-12)
    assert sizing.lower_bound <= sizing.mass
    assert sizing.is_proven


# Published results, in closed form --------------------------------------------------------------------------


def test_the_dbar_of_motes() -> None:
    """10 kN squeezes a square of four bars of √2 m: each carries 10 kN / √2, the string across 10 kN. MOTES: 8.858 kg.

    Tension in the string along the load would only add to the bars' force: the least is without.
    """
    sizing = minimal_mass(DBAR, SQUEEZE, rods=ALUMINIUM, strings=ALUMINIUM)
    bars = 4 * buckling_mass(ALUMINIUM, math.sqrt(2), 1e4 / math.sqrt(2))
    string = 2700 * 2 * 1e4 / 110e6
    assert sizing.mass == pytest.approx(bars + string, rel=1e-12)
    assert f"{sizing.mass:.3f}" == "8.858"
    assert sizing.rod_force_densities[0] == pytest.approx([-5000.0] * 4, rel=1e-12)
    assert sizing.force_densities[0] == pytest.approx([0.0, 5000.0], abs=1e-8)
    assert sizing.rod_governs == (Governs.BUCKLING,) * 4
    assert sizing.string_governs == (Governs.NOTHING, Governs.YIELD)
    assert sizing.rod_radii == pytest.approx([(8 * 1e4 / math.sqrt(2) / (math.pi**3 * 60e9)) ** 0.25] * 4, rel=1e-12)
    is_sound(sizing, SQUEEZE)


def test_the_tbar_of_motes() -> None:
    """A bar of 2 m under 10 kN, and nothing else. MOTES: 4.975 kg."""
    sizing = minimal_mass(TBAR, SQUEEZE, rods=ALUMINIUM, strings=ALUMINIUM)
    assert sizing.mass == pytest.approx(buckling_mass(ALUMINIUM, 2.0, 1e4), rel=1e-12)
    assert f"{sizing.mass:.3f}" == "4.975"
    assert sizing.rod_governs == (Governs.BUCKLING, Governs.NOTHING)
    is_sound(sizing, SQUEEZE)


@pytest.mark.parametrize("factor", [1e-3, 7.0])
def test_how_mass_scales_with_the_load(factor: float) -> None:
    """Bars that buckle: √factor; bars and strings that yield: factor."""
    one, other = (minimal_mass(DBAR, load, rods=ALUMINIUM, strings=ALUMINIUM) for load in (SQUEEZE, factor * SQUEEZE))
    assert other.rod_masses == pytest.approx(one.rod_masses * math.sqrt(factor), rel=1e-12)
    assert other.string_masses == pytest.approx(one.string_masses * factor, rel=1e-12, abs=1e-14)
    heavy = minimal_mass(DBAR, 1e6 * SQUEEZE, rods=UHMWPE, strings=STEEL)
    heavier = minimal_mass(DBAR, factor * 1e6 * SQUEEZE, rods=UHMWPE, strings=STEEL)
    if factor > 1:
        assert set(heavier.rod_governs) == {Governs.YIELD}
        assert heavier.mass == pytest.approx(heavy.mass * factor, rel=1e-12)


# Closed forms of single members -----------------------------------------------------------------------------


def strut(length: float = 1.0) -> Structure:
    rod = Rod("rod", ("o", "tip"), 1.0, support=Support.pinned())
    return Structure("strut", {"o": (0.0, 0.0, 0.0), "tip": (0.0, 0.0, length)}, (rod,))


def push(force: float) -> Array:
    return np.array([[0.0, 0, 0], [0, 0, -force]])


@pytest.mark.parametrize(
    ("force", "mass", "why"),
    [
        (0.25, 0.5, Governs.BUCKLING),
        (0.999, math.sqrt(0.999), Governs.BUCKLING),
        (1.001, 1.001, Governs.YIELD),
        (9.0, 9.0, Governs.YIELD),
        (-0.25, 0.25, Governs.YIELD),
    ],
)
def test_what_decides_of_one_bar(force: float, mass: float, why: Governs) -> None:
    """In the units of `UNIT` √P below 1 N of compression, P above, |N| in tension."""
    sizing = minimal_mass(strut(), push(force), rods=UNIT, strings=UNIT)
    assert sizing.mass == pytest.approx(mass, rel=1e-12)
    assert sizing.rod_governs == (why,)
    assert sizing.reactions[0, 0, 2] == pytest.approx(force, rel=1e-12)


def test_the_worst_of_several_load_cases_counts() -> None:
    cases = np.array([push(0.25), push(-0.7), push(0.04)])
    sizing = minimal_mass(strut(), cases, rods=UNIT, strings=UNIT)
    assert sizing.mass == pytest.approx(0.7, rel=1e-12)  # in tension; √0.25 is less
    assert sizing.rod_forces[:, 0] == pytest.approx([-0.25, 0.7, -0.04], rel=1e-12)
    is_sound(sizing, cases)


def test_a_bar_bears_its_own_weight() -> None:
    """Hanging: m = F + m g / 2 in the units of `UNIT`. Standing in yield: the same; in buckling m² = F + m g / 2."""
    g = 0.3
    hanging = minimal_mass(strut(), push(-2.0), rods=UNIT, strings=UNIT, gravity=(0, 0, g))
    assert hanging.mass == pytest.approx(2.0 / (1 - g / 2), rel=1e-9)
    standing = minimal_mass(strut(), push(0.2), rods=UNIT, strings=UNIT, gravity=(0, 0, -g))
    assert standing.rod_governs == (Governs.BUCKLING,)
    # The mass is proven to 1e-6; tangents stop when they gain nothing.
    assert standing.mass == pytest.approx(g / 4 + math.sqrt(g**2 / 16 + 0.2), rel=2e-6)
    assert standing.reactions[0, 0, 2] == pytest.approx(0.2 + standing.mass * g, rel=1e-9)
    with pytest.raises(InfeasibleError, match="their own weight"):
        minimal_mass(strut(), push(-2.0), rods=UNIT, strings=UNIT, gravity=(0, 0, 2.1))


def test_point_masses_have_weight() -> None:
    """A mass of 3 kg in a fork of two strings at 45°: each pulls 3 g / √2."""
    nodes = {"l": (-1.0, 0.0, 1.0), "r": (1.0, 0.0, 1.0), "m": (0.0, 0.0, 0.0)}
    cords = (String("s", ("l", "m"), 1.0), String("t", ("r", "m"), 1.0))
    fork = Structure("fork", nodes, (), cords, ("l", "r"), (PointMass("m", 3.0),))
    sizing = minimal_mass(fork, rods=STEEL, strings=STEEL, gravity=(0, 0, -9.81))
    assert sizing.tensions[0] == pytest.approx([3 * 9.81 / math.sqrt(2)] * 2, rel=1e-12)
    assert sizing.mass == pytest.approx(2 * 8000 * math.sqrt(2) * 3 * 9.81 / math.sqrt(2) / 300e6, rel=1e-12)


# Global optimality ------------------------------------------------------------------------------------------


def truss(seed: int, count: int, bars: int, amount: float) -> tuple[Structure, Array]:
    """A planar ring with bars across it, strings between all other nodes, and loads at random in its plane."""
    rng = np.random.default_rng(seed)
    nodes = rng.uniform(-1, 1, (count, 3))
    nodes[:, 1] = 0.0
    ring = [(i, (i + 1) % count) for i in range(count)]
    others = [pair for pair in combinations(range(count), 2) if pair not in ring and pair[::-1] not in ring]
    chosen = [others[k] for k in rng.permutation(len(others))]
    structure = Structure.from_arrays(
        nodes, ring + chosen[: bars - count], chosen[bars - count :], rod_mass=1.0, stiffness=1.0, name=f"truss {seed}"
    )
    loads = amount * rng.normal(size=(count, 3))
    loads[:, 1] = 0.0
    return structure, loads


HELD = [Hold(("n1", "n2"))]


def cells(sizing: Sizing, loads: Array) -> float:
    """The least mass by enumeration of what each bar does: pulls, buckles (below P*), or yields (above P*).

    Within one such cell the mass is concave, so that its least is at a vertex of the cell: all vertices of the polytope
    that all cells' walls cut out of the balance are tried. For problems of few redundant forces only.
    """
    structure = sizing.given
    matrix = balance(structure)
    free = np.ones(matrix.shape[0], bool)
    free[:6] = False
    free[1::3] = False
    matrix, load = matrix[free], loads.ravel()[free]
    particular = np.linalg.lstsq(matrix, -load, rcond=None)[0]
    _, singular, right = np.linalg.svd(matrix)
    modes = right[int(np.sum(singular > 1e-9 * singular[0])) :].T
    R, size = len(structure.rods), modes.shape[1]
    walls = [(k, 0.0) for k in range(matrix.shape[1])]
    for k, (length, stuff) in enumerate(zip(structure.rod_lengths, sizing.rod_materials, strict=True)):
        walls.append((k, -4 * stuff.yield_stress**2 * length**2 / (math.pi * stuff.elasticity_modulus)))
    best = math.inf
    for chosen in combinations(walls, size):
        rows = [k for k, _ in chosen]
        if abs(np.linalg.det(modes[rows])) < 1e-9:
            continue
        point = particular + modes @ np.linalg.solve(modes[rows], [v for _, v in chosen] - particular[rows])
        # The root would make something of the round-off of a bar without force.
        point = np.where(np.abs(point) < 1e-9 * np.abs(point).max(), 0.0, point)
        if point[R:].min() > -1e-9 * np.abs(load).max():
            best = min(best, mass_of(sizing, point[None, :R], np.maximum(point[None, R:], 0.0)))
    return best


@pytest.mark.parametrize(("seed", "amount"), [(5, 1e2), (5, 1e6), (4, 1e4), (6, 1e5)])
def test_against_all_vertices(seed: int, amount: float) -> None:
    structure, loads = truss(seed, 5, 6, amount)
    sizing = minimal_mass(structure, loads, rods=STEEL, strings=UHMWPE, holds=HELD)
    is_sound(sizing, loads)
    # The search stops within 1e-6 of the least, and what enumeration finds is the least.
    best = cells(sizing, loads)
    assert best * (1 - 1e-11) <= sizing.mass <= best * (1 + 1.1e-6)


@pytest.mark.parametrize("seed", [1, 5])
def test_yield_alone_is_a_linear_program(seed: int) -> None:
    """Loads so large that no bar buckles: the least mass is that of Michell's linear program, set up here anew."""
    structure, loads = truss(seed, 7, 9, 1e9)
    sizing = minimal_mass(structure, loads, rods=STEEL, strings=STEEL, holds=HELD)
    matrix, R = balance(structure), len(structure.rods)
    free = np.ones(matrix.shape[0], bool)
    free[:6] = False
    free[1::3] = False
    lengths = np.concatenate([structure.rod_lengths, structure.string_lengths(structure.positions)])
    columns = np.hstack([matrix, -matrix[:, :R]])[free]
    cost = np.concatenate([lengths, lengths[:R]])
    answer = linprog(cost, A_eq=columns, b_eq=-loads.ravel()[free] / 1e9, method="highs")
    assert set(sizing.rod_governs) <= {Governs.YIELD, Governs.NOTHING}
    assert sizing.mass == pytest.approx(answer.fun * 1e9 * 8000 / 300e6, rel=1e-6)
    is_sound(sizing, loads)


def test_no_choice_of_forces_is_lighter() -> None:
    """Feasible forces at random: corners of the polytope in directions at random, and mixtures of them."""
    structure, loads = truss(4, 8, 12, 1e4)
    sizing = minimal_mass(structure, loads, rods=STEEL, strings=STEEL, holds=HELD)
    is_sound(sizing, loads)
    matrix, R = balance(structure), len(structure.rods)
    free = np.ones(matrix.shape[0], bool)
    free[:6] = False
    free[1::3] = False
    rng = np.random.default_rng(11)
    corners = []
    for _ in range(60):
        # Prices at random on |N| and T; with N = N⁺ - N⁻, of which a corner has one only.
        price = rng.uniform(0.1, 1.0, R + len(structure.strings))
        columns = np.hstack([matrix, -matrix[:, :R]])[free]
        answer = linprog(np.concatenate([price, price[:R]]), A_eq=columns, b_eq=-loads.ravel()[free], method="highs")
        assert answer.status == 0
        x = answer.x[: len(price)]
        x[:R] -= answer.x[len(price) :]
        corners.append(x)
    mixtures = rng.dirichlet(np.full(60, 0.05), 200) @ np.array(corners)
    masses = [mass_of(sizing, x[None, :R], x[None, R:]) for x in (*corners, *mixtures)]
    assert min(masses) >= sizing.lower_bound * (1 - 1e-9)
    assert min(masses) < 1.1 * sizing.mass  # some choices were good ones


def test_tightened_bounds_keep_what_is_better() -> None:
    """One bar under 0.25 N of compression: bounds close in on that from both sides, by 1e-9 less than programs say."""
    one, none = np.ones((1, 1)), np.zeros((1, 0))
    empty = np.zeros(0)
    problem = Problem(none, one, 0 * one, 0.25 * one, empty, one[0], one[0], empty, empty, np.zeros(1))
    search = Search(problem, 1e-6, 100)
    low, high = np.full((1, 1), -np.inf), np.full((1, 1), np.inf)
    root = search.solve(low, high)
    assert root is not None
    search.improve(root)
    low, high = search.tightened(low, high)
    assert low[0, 0] <= 0.25 <= high[0, 0]
    assert high[0, 0] - low[0, 0] <= 3e-9


def test_a_search_that_is_cut_short_says_so() -> None:
    structure, loads = truss(7, 8, 12, 1e3)
    whole = minimal_mass(structure, loads, rods=STEEL, strings=STEEL, holds=HELD)
    assert whole.is_proven
    assert whole.programs > 50
    short = minimal_mass(structure, loads, rods=STEEL, strings=STEEL, holds=HELD, most_programs=4)
    assert short.programs <= 12
    assert not short.is_proven
    assert short.lower_bound < whole.mass <= short.mass * (1 + 1e-6)
    assert "not proven to be the least" in "\n".join(short.describe())
    assert "the least possible" in "\n".join(whole.describe())


# Towers and prestress ---------------------------------------------------------------------------------------


def test_prestress_of_a_tower() -> None:
    """A tower has one state of self-stress: the least force density decides it, and with it every force."""
    structure = tower(2).structure
    sizing = minimal_mass(structure, rods=STEEL, strings=STEEL, least_force_density=500.0)
    matrix = balance(structure)
    _, singular, right = np.linalg.svd(matrix)
    modes = right[int(np.sum(singular > 1e-9 * singular[0])) :]
    assert len(modes) == 1
    R, lengths = len(structure.rods), structure.string_lengths(structure.positions)
    mode = modes[0] * np.sign(modes[0, R])
    forces = mode * 500.0 / np.min(mode[R:] / lengths)
    # The tower's nodes are in balance to round-off of its form-finding only.
    assert sizing.tensions[0] == pytest.approx(forces[R:], rel=1e-6)
    assert sizing.rod_forces[0] == pytest.approx(forces[:R], rel=1e-6)
    assert sizing.force_densities.min() >= 500.0 * (1 - 1e-12)


def test_a_bent_tower_under_its_weight() -> None:
    structure = tower(3).structure
    loads = np.zeros((len(structure.nodes), 3))
    for name in top_nodes(3):
        loads[structure.node_index[name]] = (0.0, 1e3, 0.0)
    hold = [Hold(tuple(base_nodes()))]
    dry = minimal_mass(structure, loads, rods=STEEL, strings=STEEL, holds=hold)
    is_sound(dry, loads)
    heavy = minimal_mass(structure, loads, rods=STEEL, strings=STEEL, holds=hold, gravity=(0, 0, -9.81))
    assert heavy.is_proven
    assert heavy.mass > dry.mass
    # What holds it pushes with the loads and the weight of the rods, less the strings' none.
    total = heavy.reactions[0].sum(axis=0) + loads.sum(axis=0)
    assert total == pytest.approx([0.0, 0.0, 9.81 * heavy.rod_masses.sum()], abs=1e-8 * 3e3)


# The sized structure ----------------------------------------------------------------------------------------


def test_the_sized_structure_is_at_its_limits() -> None:
    """Its members' utilisations are all 1 by what governs them, and statics finds the forces that it was sized for.

    Pulled apart, prestressed, and held in its plane, so that it is stable; else it is in balance, and folds.
    """
    loads = -SQUEEZE
    sizing = minimal_mass(DBAR, loads, rods=ALUMINIUM, strings=STEEL, least_force_density=100.0, least_radius=1e-4)
    assert sizing.force_densities[0] == pytest.approx([5100.0, 100.0], rel=1e-12)
    structure = sizing.structure
    assert structure.rod_masses == pytest.approx(sizing.rod_masses, rel=1e-14)
    check = check_members(structure, structure.positions, sizing.rod_forces[0], sizing.tensions[0])
    assert check.unchecked == ()
    assert check.loads.buckling == pytest.approx(np.ones((1, 4)), rel=1e-9)
    assert check.loads.breaking == pytest.approx(np.ones((1, 2)), rel=1e-9)
    assert structure.strings[0].strength == pytest.approx(10200.0, rel=1e-9)
    flat = [Hold(structure.node_names, directions=((0.0, 0.0, 1.0),))]
    state = find_equilibrium(StaticModel.of(structure, rods=Rods.RIGID, loads=loads, holds=flat))
    assert state.is_stable
    # Newton's residual is round-off of EA, 1e-16 of 8 MN: 1e-9 N of 1e4 N.
    assert state.nodes == pytest.approx(structure.positions, abs=1e-9)
    assert state.rod_forces == pytest.approx(sizing.rod_forces[0], rel=1e-8)
    assert state.tensions == pytest.approx(sizing.tensions[0], rel=1e-8)


def test_a_member_without_mass_is_no_member() -> None:
    sizing = minimal_mass(TBAR, SQUEEZE, rods=ALUMINIUM, strings=ALUMINIUM)
    with pytest.raises(OptionError, match=r"rod 'r2' carries nothing, .* give minimal_mass a least_radius"):
        sizing.structure  # noqa: B018
    least = minimal_mass(TBAR, SQUEEZE, rods=ALUMINIUM, strings=ALUMINIUM, least_radius=2e-3)
    extra = 2700 * math.pi * 2e-3**2 * (2.0 + 4 * math.sqrt(2))
    assert least.mass == pytest.approx(sizing.mass + extra, rel=1e-12)
    assert least.structure.rods[1].radius == pytest.approx(2e-3, rel=1e-12)
    assert least.rod_governs == (Governs.BUCKLING, Governs.LEAST_RADIUS)


def test_materials_one_each_and_plain_values() -> None:
    mixed = [STEEL, ALUMINIUM, STEEL, ALUMINIUM]
    sizing = minimal_mass(DBAR, SQUEEZE, rods=mixed, strings=[STEEL, UHMWPE])
    force = 1e4 / math.sqrt(2)
    expected = 2 * sum(buckling_mass(stuff, math.sqrt(2), force) for stuff in (STEEL, ALUMINIUM))
    assert sizing.mass == pytest.approx(expected + 970 * 2 * 1e4 / 2.7e9, rel=1e-12)
    plain = sizing.to_dict()
    assert to_json(plain)
    assert plain["proven"] is True
    assert plain["rods"]["r1"]["governs"] == "buckling"
    assert plain["strings"]["s2"]["tensions"] == pytest.approx([1e4])
    lines = sizing.describe()
    assert lines[2] == "rods: 4 by buckling"
    assert lines[3] == "strings: 1 by yield, 1 by nothing"


def test_nothing_to_bear() -> None:
    sizing = minimal_mass(DBAR, rods=STEEL, strings=STEEL)
    assert sizing.mass == 0.0
    assert sizing.is_proven
    assert set(sizing.rod_governs + sizing.string_governs) == {Governs.NOTHING}


def test_criteria_have_the_same_names() -> None:
    assert {Governs.YIELD.value, Governs.BUCKLING.value} == {Criterion.YIELD.value, Criterion.BUCKLING.value}


# What is refused --------------------------------------------------------------------------------------------


def test_loads_that_nothing_balances() -> None:
    out_of_plane = np.zeros((4, 3))
    out_of_plane[[0, 1, 2, 3], 2] = [5.0, -5.0, 5.0, -5.0]
    with pytest.raises(InfeasibleError, match=r"push with 5 N along motions that change no member's length"):
        minimal_mass(DBAR, out_of_plane, rods=STEEL, strings=STEEL)
    pushed = replace(TBAR, rods=(*TBAR.rods[:1], Rod("r2", ("n2", "n4"), 1.0)))
    nodes = {"a": (0.0, 0.0, 0.0), "m": (0.0, 0.0, 1.0)}
    alone = Structure("alone", nodes, (), (String("s", ("a", "m"), 1.0),), ("a",), (PointMass("m", 1.0),))
    with pytest.raises(InfeasibleError, match="while strings only pull: at best 7 N are left"):
        minimal_mass(alone, [[0, 0, 0], [0, 0, -7.0]], rods=STEEL, strings=STEEL)
    cases = np.array([SQUEEZE, out_of_plane])
    with pytest.raises(InfeasibleError, match="of load case 1"):
        minimal_mass(pushed, cases, rods=STEEL, strings=STEEL)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"loads": [[0.0, 0.0, 1.0]]}, r"loads .* shape \(4, 3\)"),
        ({"loads": np.full((4, 3), np.nan)}, "loads"),
        ({"loads": np.zeros((2, 3, 3))}, "loads"),
        ({"loads": "none"}, "loads"),
        ({"rods": [STEEL]}, "rods: 1 materials for 4"),
        ({"strings": "steel"}, "strings = 'steel'; it must be a Material"),
        ({"tolerance": 0.0}, "tolerance"),
        ({"most_programs": 0}, "most_programs"),
        ({"most_programs": 1.5}, "most_programs"),
        ({"least_radius": -1.0}, "least_radius = -1.0; it must be >= 0"),
        ({"least_force_density": [1.0]}, "least_force_density"),
        ({"gravity": 9.81}, "gravity"),
        ({"holds": [Hold(("x",))]}, "hold: there is no node 'x'"),
    ],
)
def test_wrong_arguments_are_refused(arguments: dict[str, Any], words: str) -> None:
    with pytest.raises(OptionError, match=words):
        minimal_mass(DBAR, **({"loads": SQUEEZE, "rods": STEEL, "strings": STEEL} | arguments))


@pytest.mark.parametrize(("name", "value"), [("density", 0.0), ("elasticity_modulus", math.nan), ("yield_stress", "1")])
def test_materials_are_checked(name: str, value: Any) -> None:
    with pytest.raises(OptionError, match=f"material: {name} = "):
        replace(STEEL, **{name: value})


def test_a_rod_that_is_bent_is_refused() -> None:
    nodes = {"o": (0.0, 0.0, 0.0), "tip": (0.0, 0.0, 1.0)}
    bent = Structure("bent", nodes, (Rod("rod", ("o", "tip"), 1.0, support=Support.pinned(0.25)),))
    with pytest.raises(OptionError, match=r"rod 'rod' is supported between its ends, at σ = 0\.25"):
        minimal_mass(bent, push(1.0), rods=STEEL, strings=STEEL)
    # Held in a plane it is not: both of its ends are.
    flat = replace(bent, rods=(Rod("rod", ("o", "tip"), 1.0, support=Support.free(0.5, plane=(0, 1, 0))),))
    both = np.array([[0.0, 3.0, 5.0], [0.0, -4.0, -5.0]])
    assert minimal_mass(flat, both, rods=UNIT, strings=UNIT).mass == pytest.approx(5.0, rel=1e-12)
    assert Scene(flat).structure is flat


@pytest.mark.parametrize(("length", "load"), [(1.0, 1e-5), (1.0, 1e-2), (1.0, 1e6), (100.0, 1e-2), (100.0, 1e3)])
def test_a_column_bears_itself(length: float, load: float) -> None:
    """Half of its weight and the load press a column, P = F + M g/2, and buckling needs M = c √P.

    With c = 2 ρ ℓ² / √(π E) (a round bar: A = 2 ℓ √(P / π E)), M = c² g/4 + √((c² g/4)² + c² F); yield needs less
    here, but where F is far above c² g².
    """
    rod = Rod("r", ("a", "b"), 1.0, 0.01, Support.pinned(0.0))
    structure = Structure("column", {"a": (0.0, 0.0, 0.0), "b": (0.0, 0.0, length)}, (rod,))
    loads, g = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -load]]), 9.81
    found = minimal_mass(structure, loads, rods=ALUMINIUM, strings=UHMWPE, gravity=(0, 0, -g))
    c = 2 * ALUMINIUM.density * length**2 / np.sqrt(np.pi * ALUMINIUM.elasticity_modulus)
    buckling = c**2 * g / 4 + np.sqrt((c**2 * g / 4) ** 2 + c**2 * load)
    a = ALUMINIUM.density * length / ALUMINIUM.yield_stress
    crushing = a * load / (1 - a * g / 2)
    assert found.mass == pytest.approx(max(buckling, crushing), rel=2e-6)  # its own tolerance is 1e-6


def test_loads_that_cannot_be_distinguished_from_none_are_refused() -> None:
    rod = Rod("r", ("a", "b"), 1.0, 0.01, Support.pinned(0.0))
    structure = Structure("column", {"a": (0.0, 0.0, 0.0), "b": (0.0, 0.0, 100.0)}, (rod,))
    loads = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -1e-5]])
    with pytest.raises(InfeasibleError, match="too small to matter: columns weigh"):
        minimal_mass(structure, loads, rods=ALUMINIUM, strings=UHMWPE, gravity=(0, 0, -9.81))
