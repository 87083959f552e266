"""Natural frequencies and shapes: closed forms, other codes, linearized engines; and their animation."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import truth
from linked_scenes import random_tree
from numpy.typing import NDArray

import tensegrity_mj as tmj
from evidence.random_taut import random_taut_structure
from tensegrity_mj.library.tower import tower
from tensegrity_mj.model import rods as thin
from tensegrity_mj.model.members import PointMass, Rod, String, Support
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.section import Section
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.statics import Rods, StaticModel, StaticState, find_equilibrium, linear_systems
from tensegrity_mj.statics import modes as modes_module
from tensegrity_mj.statics.linear_systems import Linearized
from tensegrity_mj.statics.modes import mass_matrix, mode_trajectory, natural_modes

Array = NDArray[np.float64]
TOLERANCE = 1e-6  # the project's bound
G = 9.81


def prism_of_tnsgrt() -> tuple[Structure, dict[str, NDArray]]:
    data = truth.load("tnsgrt_prism_default")
    strings = int(data["n_strings"])
    structure = Structure.from_arrays(
        data["nodes"].T,
        data["members"].T[strings:],
        data["members"].T[:strings],
        rod_mass=data["mass"][strings:],
        stiffness=data["member_stiffness"][:strings],
        force_density=data["force_density"][:strings],
    )
    return structure, data


def test_frequencies_of_the_prism_against_tnsgrt() -> None:
    structure, data = prism_of_tnsgrt()
    modes = natural_modes(find_equilibrium(structure))
    expected = np.sort(data["freq_hz_rigid_thin_bars_massless_strings"])[6:]
    assert modes.neutral.shape[1] == 6
    assert len(modes.squares) == 9
    error = np.abs(modes.frequencies / expected - 1)
    print(f"largest relative error of 9 frequencies: {error.max():.1e}")
    # The softest ω² is 2e-8 of the largest: 9 EPS / 2e-8 = 1e-7 of it, half of that in f.
    assert error.max() < TOLERANCE


def test_elastic_stiffness_of_the_prism_against_tnsgrt() -> None:
    """Its bars carry their forces at the nodes' distances, and are longer without them."""
    structure, data = prism_of_tnsgrt()
    strings = int(data["n_strings"])
    forces, compliance = data["force"][strings:], 1 / data["member_stiffness"][strings:]
    rigid = StaticModel.of(structure)
    model = rigid.with_(compliance=compliance, rod_lengths=rigid.rod_lengths - forces * compliance)
    x = model.start.ravel()
    found = model.rod_forces_from_lengths(x, forces)
    assert np.abs(found / forces - 1).max() < 1e-7  # EPS of 2 m over a stretch of 7e-8 m
    K = np.asarray(Linearized(model, x, 0.0, forces).stiffness)
    assert np.abs(K - data["K"]).max() < 1e-12 * np.abs(K).max()
    values, expected = np.sort(np.linalg.eigvalsh(K)), np.sort(data["eig_K"])
    assert np.abs(values[:6]).max() < 1e-15 * 10 * values[-1]
    error = np.abs(values[6:] / expected[6:] - 1)
    print(f"largest relative error of 12 eigenvalues: {error.max():.1e}")
    assert error.max() < TOLERANCE
    # About the equilibrium of the same energy, 12 modes besides the whole's.
    modes = natural_modes(find_equilibrium(model))
    assert modes.neutral.shape[1] == 6
    assert len(modes.squares) == 12
    assert not modes.unstable.any()


def test_the_mass_matrix_is_the_kinetic_energy() -> None:
    rng = np.random.default_rng(0)
    for name in ("tbar", "net", "cable"):
        structure = tmj.load_scene(name).structure
        v = rng.normal(size=(len(structure.nodes), 3))
        energy = 0.5 * v.ravel() @ (mass_matrix(structure) @ v.ravel())
        assert abs(energy / float(thin.kinetic_energy(structure, v)) - 1) < 1e-13


def chain(count: int, rest: float = 0.8, k: float = 50.0, mass: float = 0.3) -> Structure:
    """Masses along x between two fixed ends, 1 m apart, on strings."""
    nodes = {f"n{i}": (float(i), 0.0, 0.0) for i in range(count + 2)}
    strings = tuple(String(f"s{i}", (f"n{i}", f"n{i + 1}"), k, rest_length=rest) for i in range(count + 1))
    points = tuple(PointMass(f"n{i}", mass) for i in range(1, count + 1))
    return Structure("chain", nodes, strings=strings, fixed_nodes=("n0", f"n{count + 1}"), point_masses=points)


def chain_squares(count: int, k: float = 50.0, mass: float = 0.3, rest: float = 0.8) -> Array:
    j = np.arange(1, count + 1)
    wave = 4 * np.sin(j * np.pi / (2 * (count + 1))) ** 2 / mass
    across = k * (1 - rest) / 1.0
    return np.sort(np.concatenate([k * wave, across * wave, across * wave]))


def test_a_chain_of_masses() -> None:
    """ω² = 4 k/m sin²(j π / 2(n+1)) along, and T/L in place of k across."""
    state = find_equilibrium(chain(7))
    modes = natural_modes(state)
    expected = chain_squares(7)
    assert np.abs(modes.squares / expected - 1).max() < 1e-12
    assert modes.complete
    assert not modes.loose.any()
    assert modes.neutral.shape[1] == 0
    some = natural_modes(state, 4)
    assert len(some.squares) == 4
    assert not some.complete
    assert np.array_equal(some.squares, modes.squares[:4])
    unit = modes.shapes.T @ (modes.masses @ modes.shapes)
    assert np.abs(unit - np.eye(len(unit))).max() < 1e-12
    # What moves is all of the mass.
    assert np.abs(modes.effective_masses.sum(axis=0) - 7 * 0.3).max() < 1e-12


@pytest.mark.parametrize("make", [lambda: find_equilibrium(chain(11)), lambda: find_equilibrium(tower(2))])
def test_large_structures_are_solved_alike(make: object, monkeypatch: pytest.MonkeyPatch) -> None:
    """By inverse iteration: with rods' lengths and neutral motions as constraints."""
    state: StaticState = make()  # type: ignore[operator]
    dense = natural_modes(state)
    monkeypatch.setattr(modes_module.linear_systems, "DENSE", 5)
    found = natural_modes(state, 6)
    assert len(found.squares) == 6
    assert not found.complete
    # The ridge of 1e-14 and the iteration's EPS, over ω² of 1e-3 of the largest.
    assert np.abs(found.squares / dense.squares[:6] - 1).max() < 1e-8
    assert len(natural_modes(state).squares) == modes_module.LEAST_COUNT
    lengths = state.model.rod_slopes(state.x) @ found.shapes
    assert np.abs(lengths).max(initial=0.0) < 1e-9


def test_pendulum_upright_and_spinning_freely() -> None:
    structure = Structure(
        "rod", {"a": (0, 0, 0), "b": (0, 0, 2)}, (Rod("r", ("a", "b"), 3.0, support=Support.pinned()),)
    )
    scene = Scene(structure, gravity=(0.0, 0.0, -G))
    hanging, upright = natural_modes(find_equilibrium(scene)), natural_modes(find_equilibrium(scene, stable=False))
    expected = 3 * G / (2 * 2.0)  # 3 g / 2 ℓ of a thin rod
    assert np.abs(hanging.squares / expected - 1).max() < 1e-12
    assert np.abs(upright.squares / -expected - 1).max() < 1e-12
    assert upright.unstable.all()
    assert np.isnan(upright.frequencies).all()
    assert np.abs(upright.growth - np.sqrt(expected)).max() < 1e-12
    assert "unstable" in " ".join(upright.describe())
    alone = natural_modes(
        find_equilibrium(Structure("one", {"a": (0, 0, 0), "b": (1, 0, 0)}, (Rod("r", ("a", "b"), 1.0),)))
    )
    assert alone.neutral.shape[1] == 5
    assert not len(alone.squares)
    assert alone.complete
    assert alone.describe()[-1] == "no further motion is free"
    # A mass on a slack string: held by nothing, yet no motion of the whole.
    loose = natural_modes(find_equilibrium(chain(1, rest=1.5)))
    assert loose.loose.all()
    assert np.array_equal(loose.frequencies, np.zeros(3))


@pytest.mark.parametrize("mass", [0.1, 10.0])
def test_an_elastic_rod_swings_along_itself(mass: float) -> None:
    """Held at one end, of linear displacement: ω² = (EA/ℓ) / (m/3)."""
    section = Section.solid(0.01, 2e6)
    structure = Structure(
        "rod",
        {"a": (0, 0, 0), "b": (0, 0, -1)},
        (Rod("r", ("a", "b"), mass, support=Support.pinned(), section=section),),
    )
    model = StaticModel.of(Scene(structure, gravity=(0, 0, -G)), rods=Rods.ELASTIC)
    state = find_equilibrium(model)
    modes = natural_modes(state)
    stiffness = section.axial_stiffness
    assert abs(modes.squares[-1] / (3 * stiffness / mass) - 1) < 1e-9
    # Across: its force of half of its weight over its length, over the same mass.
    length = 1 + mass * G / 2 / stiffness
    assert np.abs(modes.squares[:2] / (mass * G / 2 / length * 3 / mass) - 1).max() < 1e-9


def against_engines(state: StaticState, engines: tuple[object, ...] = (tmj.DAE(), tmj.MuJoCo())) -> float:
    """The largest relative difference of frequencies from those of linearized engines."""
    modes, worst = natural_modes(state), 0.0
    for engine in engines:
        model = tmj.linearize(state.scene(), engine)  # type: ignore[arg-type]
        n = len(model.coordinates)
        squares = np.sort(np.linalg.eigvals(-model.A[n:, :n]).real)
        whole = modes.neutral.shape[1]
        assert len(squares) == whole + len(modes.squares)
        order = np.argsort(np.abs(squares))
        assert np.abs(squares[order[:whole]]).max(initial=0.0) < 1e-9 * np.abs(squares).max()
        held = np.sort(squares[order[whole:]])
        worst = max(worst, float(np.abs(np.sqrt(held / modes.squares) - 1).max()))
    return worst


@pytest.mark.parametrize(
    "make",
    [
        lambda: tower(2, pinned_base=True, gravity=G),
        lambda: tower(2),
        lambda: tmj.load_scene("truss_arm"),
        lambda: tmj.load_scene("dbar"),
        lambda: tmj.load_scene("cable").with_(motions=()),
        lambda: random_tree(np.random.default_rng(3), 4, False).with_(initial_velocities=None),
    ],
    ids=["tower on its base", "free tower", "truss_arm", "dbar", "bent cable", "tree"],
)
def test_frequencies_are_those_of_linearized_engines(make: object) -> None:
    state = find_equilibrium(make())  # type: ignore[operator]
    error = against_engines(state)
    print(f"{state.model.scene.name}: largest relative difference {error:.1e}")
    assert error < 1e-9  # reached; the project's bound is TOLERANCE


@pytest.mark.slow
@pytest.mark.parametrize(
    "make", [lambda: tmj.load_scene("net((2, 2))"), lambda: tower(3)], ids=["net", "tower of three"]
)
def test_frequencies_of_larger_structures(make: object) -> None:
    assert against_engines(find_equilibrium(make())) < 1e-9  # type: ignore[operator]


@pytest.mark.parametrize("seed", range(4))
def test_frequencies_of_random_structures(seed: int) -> None:
    structure = random_taut_structure(np.random.default_rng(seed))
    state = find_equilibrium(structure)
    # Of structures that are hardly held round-off is a larger part.
    low = natural_modes(state).squares
    assert against_engines(state) < 1e-6
    assert low[0] > 1e-9 * low[-1]


def test_shapes_move_as_linearized() -> None:
    """A shape is one of the linear model: K φ = ω² M φ on admissible motions, with K from differences of forces."""
    state = find_equilibrium(tower(2, pinned_base=True))
    modes = natural_modes(state)
    T = state.motions()
    for k in (0, 5, len(modes.squares) - 1):
        shape = modes.shapes[:, k]
        h = 1e-5
        there = [linear_systems.projected(state.model, state.x + s * h * shape, state.rod_lengths) for s in (1, -1)]
        forces = [state.model.gradient(x) + state.model.rod_slopes(x).T @ state.rod_forces for x in there]  # type: ignore[arg-type]
        change = T.T @ (forces[0] - forces[1]) / (2 * h)
        assert np.abs(change - modes.squares[k] * (T.T @ (modes.masses @ shape))).max() < 1e-5 * np.abs(change).max()


def test_a_mode_as_a_film(tmp_path: Path) -> None:
    state = find_equilibrium(tower(2))
    modes = natural_modes(state)
    run = mode_trajectory(modes, 0, frames=40)
    pairs = state.model.structure.rod_nodes
    lengths = np.linalg.norm(run.nodes[:, pairs[:, 1]] - run.nodes[:, pairs[:, 0]], axis=2)
    assert np.abs(lengths / state.rod_lengths - 1).max() < 1e-13
    assert len(run.time) == 81
    assert abs(run.time[-1] - 2 / modes.frequencies[0]) < 1e-12
    moved = np.linalg.norm(run.nodes - state.nodes, axis=2).max()
    assert 0.08 * state.model.scale[0] < moved < 0.12 * state.model.scale[0]
    assert np.abs(run.nodes[0] - state.nodes).max() < 1e-14
    # At its start it passes the equilibrium: forces of rods are those of the state.
    assert np.abs(run.rod_force_densities[0] * lengths[0] / state.rod_forces - 1).max() < 1e-9
    assert np.abs(thin.force_densities(state.model.structure, run.multipliers) - run.rod_force_densities).max() < 1e-9
    # Velocities are those of the positions: between samples h apart the cubic errs by h⁴/384 of the fourth derivative.
    h = run.time[1]
    middle = (run.nodes[:-1] + run.nodes[1:]) / 2 + h / 8 * (run.velocities[:-1] - run.velocities[1:])
    finer = mode_trajectory(modes, 0, frames=80)
    assert np.abs(middle - finer.nodes[1::2]).max() < 10 * moved * (2 * np.pi / 40) ** 4 / 384
    # Small, it keeps its energy: ½ A² ω² φᵀMφ, to A² of the modes' curvature.
    small = mode_trajectory(modes, 0, amplitude=1e-4, frames=40)
    energy = small.kinetic_energy + small.string_energy
    assert np.ptp(energy) < 1e-2 * small.kinetic_energy.max()
    run.save(tmp_path / "mode.nc")
    back = tmj.Trajectory.load(tmp_path / "mode.nc")
    assert np.array_equal(back.nodes, run.nodes)
    assert "Hz" in back.engine
    json.dumps(modes.to_dict())


def test_films_of_elastic_and_unstable_modes() -> None:
    section = Section.solid(0.01, 2e6)
    scene = tower(1)
    model = StaticModel.of(scene.with_(structure=scene.structure.with_sections(section)), rods=Rods.ELASTIC)
    modes = natural_modes(find_equilibrium(model))
    run = mode_trajectory(modes, len(modes.squares) - 1, amplitude=0.01, frames=16)
    pairs = model.structure.rod_nodes
    lengths = np.linalg.norm(run.nodes[:, pairs[:, 1]] - run.nodes[:, pairs[:, 0]], axis=2)
    assert np.ptp(lengths, axis=0).max() > 1e-4
    assert np.abs(run.rod_force_densities * lengths - (lengths - model.rod_lengths) / model.compliance).max() < 1e-6
    upright = Structure("rod", {"a": (0, 0, 0), "b": (0, 0, 2)}, (Rod("r", ("a", "b"), 3.0, support=Support.pinned()),))
    falling = natural_modes(find_equilibrium(Scene(upright, gravity=(0, 0, -G)), stable=False))
    film = mode_trajectory(falling, 0)
    assert "unstable" in film.engine
    assert abs(film.time[-1] - 2.0) < 1e-12


def test_what_does_not_fit() -> None:
    modes = natural_modes(find_equilibrium(tower(1)))
    with pytest.raises(tmj.errors.OptionError, match="use a StaticState"):
        natural_modes(tower(1))  # type: ignore[arg-type]
    with pytest.raises(tmj.errors.OptionError, match="count"):
        natural_modes(modes.state, 0)
    for number in (-1, 99, True, 0.5):
        with pytest.raises(tmj.errors.OptionError, match="number"):
            mode_trajectory(modes, number)  # type: ignore[arg-type]
    with pytest.raises(tmj.errors.OptionError, match="amplitude"):
        mode_trajectory(modes, 0, amplitude=-1.0)
    with pytest.raises(tmj.errors.OptionError, match="longer than the mean member"):
        mode_trajectory(modes, 0, amplitude=1e3)


def test_modes_show_themselves_in_some_lines() -> None:
    modes = natural_modes(find_equilibrium(tmj.load_scene("prism")))
    assert repr(modes).splitlines() == ["modes   of prism", *(f"{'':<8}{line}" for line in modes.describe())]
