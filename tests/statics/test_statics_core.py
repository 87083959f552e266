"""The core of statics: energy, gradient and Hessian, boundary conditions, motions that nothing resists, equilibria."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from equilibria import equilibrium_residual
from linked_scenes import random_tree
from numpy.typing import NDArray
from scipy.linalg import null_space

import tensegrity_mj as tmj
from evidence.random_structures import random_scene, random_structure
from tensegrity_mj.library.tower import tower
from tensegrity_mj.library.truss_arm import truss_arm
from tensegrity_mj.linearization.linearizing import central, reach_of
from tensegrity_mj.model.members import PointMass, Rod, String, Support
from tensegrity_mj.model.rigidity import free_motions
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.section import Section
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.statics import Hold, Rods, StaticModel, StaticState, find_equilibrium, follow, relax
from tensegrity_mj.statics.linear_systems import Linearized
from tensegrity_mj.statics.page import structure_figure

Array = NDArray[np.float64]
EPS = float(np.finfo(float).eps)
DOWN = (0.0, 0.0, -9.81)

# Differences of order 12 with points up to 6 h, h = 0.003 of the shortest member R: within R everything is analytic.
# The truncation is (6!)² (h/R)^12 = 3e-25 of k, the round-off 4 EPS R / h = 3e-13 of forces over R, and of energies
# over R.
STEP = 0.003
TRUNCATED = 1e-8  # the project's bound
ROUND_OFF = 1e-10  # what is reached: 3e-13, times energies of 1e2 in units of the largest force times R


def section() -> Section:
    """Soft, so that rods and strings share what they stretch."""
    return Section(area=1e-6, second_moment=1e-10, elasticity_modulus=3e7)


def parted(structure: Structure, nodes: Array, rng: np.random.Generator) -> Structure:
    """Strings well taut or well slack: farther from the kink than differences reach."""
    lengths = structure.string_lengths(nodes)
    factor = np.where(rng.uniform(size=len(lengths)) < 0.75, rng.uniform(0.4, 0.8, len(lengths)), 1.3)
    return structure.with_strings(rest_length=factor * lengths)


def random_model(seed: int, rods: Rods) -> StaticModel:
    rng = np.random.default_rng(seed)
    structure = random_structure(
        rng,
        rods=1 + seed % 4,
        support=("free", "pinned", "constrained"),
        planar=bool(seed % 5 == 4),
        own_planes=0.3,
        point_masses=seed % 3,
        stretch=(0.2, 0.4),
    )
    scene = random_scene(rng, structure, displaced=0.2, moving=0.0, gravity=True, loads=2)
    structure = parted(structure, scene.nodes0, rng).with_sections(section())
    hold = Hold((structure.node_names[0],), ((1.0, 2.0, 0.5),))
    loads = rng.normal(size=scene.nodes0.shape)
    free = StaticModel.of(scene.with_(structure=structure), rods=rods, loads=loads)
    held = StaticModel.of(scene.with_(structure=structure), rods=rods, loads=loads, holds=(hold,) if seed % 2 else ())
    assert held.boundary.Z.shape[1] in (free.boundary.Z.shape[1], free.boundary.Z.shape[1] - 1)
    return held


def shipped_model(name: str, rods: Rods) -> StaticModel:
    scene = tmj.load_scene(name)
    rng = np.random.default_rng(0)
    structure = parted(scene.structure, scene.nodes0, rng).with_sections(section())
    return StaticModel.of(scene.with_(structure=structure, gravity=(1.0, -2.0, -9.0)), rods=rods)


MODELS = [*range(10), "cable", "net", "truss_arm", "dbar"]


def made(case: int | str, rods: Rods) -> StaticModel:
    return shipped_model(case, rods) if isinstance(case, str) else random_model(case, rods)


@pytest.mark.parametrize("rods", list(Rods))
@pytest.mark.parametrize("case", MODELS)
def test_gradient_and_hessian_are_derivatives_of_the_energy(case: int | str, rods: Rods) -> None:
    """Supports of every kind, planes, point masses, holds, loads, gravity, bent joints, class k, elastic rods."""
    model, rng = made(case, rods), np.random.default_rng(99)
    n = model.start.size
    x = model.start.ravel() + 0.01 * reach_of(model.structure, model.start) * rng.normal(
        size=n
    )  # rods off their lengths
    reach = reach_of(model.structure, x.reshape(-1, 3))
    N = rng.normal(size=len(model.rod_lengths)) * 10
    parameter = 0.7
    slack = model.lengths(x) < model.rest_lengths
    assert case == "cable" or case == "net" or not slack.all()
    forces = model.gradient(x, parameter)
    K = model.hessian(x, N).toarray()
    stiff = Linearized(model, x, 0.0, model.rod_forces_from_lengths(x, N)).stiffness
    Z = model.boundary.Z.toarray()
    # Round-off of energies and forces, in units of force and stiffness.
    tension = float(
        np.sum(model.structure.stiffness * model.lengths(x)) + np.abs(model.external(parameter)).sum() + np.abs(N).sum()
    )
    rod = 0.0 if rods is Rods.RIGID else float(np.sum(model.rod_lengths / model.compliance))
    for _ in range(3):
        direction = rng.normal(size=n)
        direction /= np.abs(direction).max() * np.sqrt(12)  # members' ends approach each other by less than a unit

        slope = central(lambda h, d=direction: np.array(model.energy(x + h * d, parameter)), STEP * reach)  # type: ignore[misc]
        assert abs(slope - forces @ direction) < ROUND_OFF * tension

        change = central(
            lambda h, d=direction: model.gradient(x + h * d, parameter) + model.rod_slopes(x + h * d).T @ N,  # type: ignore[misc]
            STEP * reach,
        )
        assert np.abs(change - K @ direction).max() < ROUND_OFF * tension / reach

        stretched = central(lambda h, d=direction: model.rods(x + h * d).lengths, STEP * reach)  # type: ignore[misc]
        assert np.abs(stretched - model.rod_slopes(x) @ direction).max(initial=0.0) < ROUND_OFF
        if rods is Rods.RIGID:
            continue

        def whole(h: float, d: Array = direction) -> Array:
            return np.array(model.energy(x + h * d, parameter) + model.rod_energy(x + h * d))

        def force(h: float, d: Array) -> Array:
            y = x + h * d
            return Z.T @ (model.gradient(y, parameter) + model.rod_slopes(y).T @ model.rod_forces_from_lengths(y, N))

        total = forces + model.rod_slopes(x).T @ model.rod_forces_from_lengths(x, N)
        assert abs(central(whole, STEP * reach) - total @ direction) < ROUND_OFF * (tension + rod)
        free = rng.normal(size=Z.shape[1])
        free /= np.abs(Z @ free).max() * np.sqrt(12)
        found = central(lambda h, d=Z @ free: force(h, d), STEP * reach)  # type: ignore[misc]
        assert np.abs(found - stiff @ free).max() < ROUND_OFF * (tension + rod) / reach
    assert ROUND_OFF <= TRUNCATED


@pytest.mark.parametrize("case", MODELS)
def test_free_motions_are_those_of_another_assembly(case: int | str) -> None:
    """`rigidity.free_motions` takes rods apart, and joins them; here nodes are joined, and rods keep their lengths."""
    model = made(case, Rods.RIGID)
    model = StaticModel.of(model.scene, nodes=model.structure.positions)  # without holds
    Z, G = model.boundary.Z.toarray(), model.boundary.rows
    assert np.abs(Z.T @ Z - np.eye(Z.shape[1])).max() < 1e-14 * len(Z)
    assert np.abs(G @ Z).max(initial=0.0) < 1e-14 * len(Z)
    ours = Z @ Linearized(model, model.start.ravel(), 0.0, np.zeros(len(model.rod_lengths))).tangent_basis()
    theirs = free_motions(model.structure)
    assert np.linalg.matrix_rank(theirs) == ours.shape[1]
    # Orthonormal columns and unit motions of members: 1e-9 is the tolerance of both ranks.
    assert np.abs(theirs - ours @ (ours.T @ theirs)).max() < 1e-9 * max(1.0, np.abs(theirs).max())


def hanging(rest: float = 0.7, k: float = 100.0, mass: float = 2.0, at: float = 0.0) -> Scene:
    structure = Structure(
        "hanging",
        {"a": (at, 0, 0), "b": (at + 1, 0, 0)},
        strings=(String("s", ("a", "b"), k, rest_length=rest),),
        fixed_nodes=("a",),
        point_masses=(PointMass("b", mass),),
    )
    return Scene(structure, gravity=DOWN)


@pytest.mark.parametrize("at", [0.0, 1e4])
def test_a_mass_on_a_string(at: float) -> None:
    """Also far from the origin, where positions have fewer digits: 1e4 EPS."""
    state = find_equilibrium(hanging(at=at))
    weight = 2.0 * 9.81
    digits = EPS * max(at, 1.0)
    assert abs(state.nodes[1, 2] + 0.7 + weight / 100.0) < 8 * digits
    assert abs(state.tensions[0] - weight) < 1e3 * digits
    assert np.abs(state.reactions[0] - [0, 0, weight]).max() < 1e4 * digits
    # Along k, across T/L; the turn about the vertical moves nothing.
    assert abs(state.lowest_stiffness - weight / state.lengths[0]) < 1e4 * digits
    assert state.neutral_motions.shape[1] == 0
    assert state.is_stable


def pinned(place: tuple[float, float, float], gravity: float = 9.81) -> Scene:
    structure = Structure("rod", {"a": (0, 0, 0), "b": place}, (Rod("r", ("a", "b"), 3.0, support=Support.pinned()),))
    return Scene(structure, gravity=(0.0, 0.0, -gravity))


@pytest.mark.parametrize("place", [(1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.6, -0.8)])
@pytest.mark.parametrize("gravity", [9.81, 1e6])
def test_a_pendulum_hangs_whatever_its_start(place: tuple[float, float, float], gravity: float) -> None:
    """Upright it is in equilibrium, an unstable one that is left."""
    state = find_equilibrium(pinned(place, gravity))
    weight = 3.0 * gravity
    assert np.abs(state.nodes[1] - [0, 0, -1]).max() < 1e-13
    assert abs(state.rod_forces[0] - weight / 2) < 1e-13 * weight
    assert abs(state.lowest_stiffness - weight / 2) < 1e-12 * weight
    if place == (0.0, 0.0, 1.0):
        upright = find_equilibrium(pinned(place, gravity), stable=False)
        assert upright.nodes[1, 2] == 1.0
        assert not upright.is_stable
        assert abs(upright.lowest_stiffness + weight / 2) < 1e-12 * weight


SCENES = {
    "free tower": (lambda: tower(2), 6),
    "tower under gravity, pinned": (lambda: tower(2, pinned_base=True, gravity=9.81), 0),
    "dbar": (lambda: tmj.load_scene("dbar"), 1),
    "net": (lambda: tmj.load_scene("net"), 0),
    "truss_arm": (lambda: tmj.load_scene("truss_arm"), 0),
    "one rod": (lambda: Scene(Structure("one", {"a": (0, 0, 0), "b": (1, 0, 0)}, (Rod("r", ("a", "b"), 1.0),))), 5),
    "balanced": (
        lambda: Scene(
            Structure("b", {"a": (0, 0, 0), "b": (1, 0, 0)}, (Rod("r", ("a", "b"), 1.0, support=Support.pinned(0.5)),)),
            gravity=DOWN,
        ),
        2,
    ),
    "pendulum off its axis": (
        lambda: Scene(
            Structure(
                "off",
                {"a": (0, 0, 0), "b": (1, 0, 0), "c": (1, 1, 0)},
                (Rod("r", ("a", "b"), 1.0, support=Support.pinned()),),
                (String("s", ("b", "c"), 10.0, rest_length=0.5),),
                point_masses=(PointMass("c", 1.0),),
            ),
            gravity=DOWN,
        ),
        0,
    ),
}


@pytest.mark.parametrize("name", SCENES)
def test_neutral_motions_are_those_that_the_stiffness_does_not_resist(name: str) -> None:
    make, expected = SCENES[name]
    state = find_equilibrium(make())
    motions = state.neutral_motions
    assert motions.shape[1] == expected
    assert np.abs(motions.T @ motions - np.eye(expected)).max(initial=0.0) < 1e-12
    T, K = state.motions(), state.stiffness()
    assert np.abs(motions - T @ (T.T @ motions)).max(initial=0.0) < 1e-9
    # K v is turned forces that are left: their round-off, 1e-12 of the largest, over lengths.
    assert np.abs(K @ (T.T @ motions)).max(initial=0.0) < 1e-9 * max(np.abs(K).max(initial=0.0), 1e-9)
    # And no others: further motions have a stiffness.
    assert int(np.sum(np.abs(np.linalg.eigvalsh(0.5 * (K + K.T))) < 1e-9 * np.abs(K).max(initial=1.0))) == expected


@pytest.mark.parametrize("start", [0.0, 0.3])
def test_a_guide_resists_what_turns_off_it(start: float) -> None:
    """A mass in the plane x = 1 on a string to the origin: turns about the origin leave the plane, and T/L resists."""
    structure = Structure(
        "rail",
        {"a": (0, 0, 0), "b": (1, start, 0)},
        strings=(String("s", ("a", "b"), 100.0, rest_length=0.5),),
        fixed_nodes=("a",),
        point_masses=(PointMass("b", 1.0, (1, 0, 0)),),
    )
    state = find_equilibrium(structure)
    assert np.abs(state.nodes[1] - [1, 0, 0]).max() < 1e-14
    assert state.neutral_motions.shape[1] == 0
    assert abs(state.lowest_stiffness - 50.0) < 1e-11
    assert np.abs(state.reactions[1] - [50.0, 0, 0]).max() < 1e-12


def test_loads_on_what_is_held_do_no_harm() -> None:
    """A load across a pin changes its reaction and nothing else: the pendulum still turns freely about the vertical."""
    scene = pinned((1.0, 0.0, 0.0))
    structure = replace(
        scene.structure,
        nodes={**scene.structure.nodes, "c": (2, 0, 0)},
        strings=(String("s", ("b", "c"), 100.0, rest_length=0.8),),
        point_masses=(PointMass("c", 1.0),),
    )
    loads = np.array([[5.0, 0, 0], [0, 0, 0], [0, 0, 0]])
    plain = find_equilibrium(Scene(structure, gravity=DOWN))
    loaded = find_equilibrium(StaticModel.of(Scene(structure, gravity=DOWN), loads=loads))
    assert np.abs(plain.nodes - loaded.nodes).max() < 1e-12
    assert np.abs(loaded.reactions[0] - plain.reactions[0] + [5.0, 0, 0]).max() < 1e-11
    assert abs(plain.lowest_stiffness - loaded.lowest_stiffness) < 1e-9


def test_forces_of_redundant_rods_are_the_least() -> None:
    """The brace of the truss has one rod too many: one state of self-stress of its rods, which nothing determines."""
    scene = truss_arm()
    structure = scene.structure
    turned = np.array([[0.8, 0.0, -0.6], [0.0, 1.0, 0.0], [0.6, 0.0, 0.8]])
    rotated = structure.moved(turned, np.array([3.0, -2.0, 5.0]))
    loads = np.zeros((len(structure.nodes), 3))
    loads[-1, 2] = -20.0
    down = tuple((turned @ np.array(scene.gravity)).tolist())
    states = [
        find_equilibrium(scene),
        relax(scene),
        find_equilibrium(Scene(rotated, gravity=down)),
        follow(StaticModel.of(scene, loads=loads), points=10).states[-1],
        find_equilibrium(StaticModel.of(scene, loads=loads)),
    ]
    for state in states:
        # Columns: what 1 N of each rod does to the joints that the wall does not hold, in the plane of the truss.
        pairs, nodes = structure.rod_nodes, state.nodes
        b = (nodes[pairs[:, 1]] - nodes[pairs[:, 0]]) / structure.rod_lengths[:, None]
        pushes = np.zeros((len(nodes), 3, len(pairs)))
        for row, (i, j) in enumerate(pairs):
            pushes[i, :, row], pushes[j, :, row] = b[row], -b[row]
        free = [structure.node_index[name] for name in structure.nodes if name not in ("b0", "t0")]
        own = null_space(pushes[free].reshape(-1, len(pairs)), rcond=1e-9)
        assert own.shape[1] == 1
        # Two null vectors of one matrix, each off by round-off over the gap of its singular values, some 1e-14.
        assert abs(float(own[:, 0] @ state.rod_forces)) < 1e-11 * np.linalg.norm(state.rod_forces)
    # What is determined then is all: the same whatever way it is found. Newton's forces are off by 1e-9 of the largest.
    largest = np.abs(states[0].rod_forces).max()
    for other in states[1:3]:
        np.testing.assert_allclose(other.rod_forces, states[0].rod_forces, atol=1e-8 * largest)
    np.testing.assert_allclose(states[3].rod_forces, states[4].rod_forces, atol=1e-8 * largest)


@pytest.mark.parametrize("name", ["tbar", "dbar", "truss_arm", "net", "prism"])
@pytest.mark.parametrize("gravity", [(0.0, 0.0, 0.0), (0.3, 0.0, -9.81)])
def test_equilibria_are_those_of_another_assembly(name: str, gravity: tuple[float, float, float]) -> None:
    """Of `rigidity.equilibrium_equations`, for rods taken apart; it is in newtons too."""
    scene = tmj.load_scene(name).with_(gravity=gravity, resistance=None)
    state = find_equilibrium(scene)
    left = equilibrium_residual(scene.structure, state.nodes, state.force_densities, gravity, scene.nodal_forces(0.0))
    largest = float(np.max(state.model.structure.stiffness * state.lengths, initial=0.0)) + float(
        np.abs(state.model.forces).max()
    )
    assert np.abs(left).max() < 1e-11 * largest
    assert np.abs(state.rod_lengths / scene.structure.rod_lengths - 1).max() < 1e-13
    again = find_equilibrium(StaticModel.of(scene, nodes=state.nodes))
    assert np.abs(again.nodes - state.nodes).max() < 1e-9


@pytest.mark.parametrize("seed", range(6))
def test_trees_of_rods_find_where_they_hang(seed: int) -> None:
    scene = random_tree(np.random.default_rng(seed), 2 + seed % 4, planar=bool(seed % 2))
    state = find_equilibrium(scene.with_(initial_velocities=None))
    assert state.residual < 1e-10
    assert state.lowest_stiffness > 1e-6
    ours = state.scene()
    assert np.abs(ours.nodes0 - state.nodes).max() == 0.0


def braced_square() -> Structure:
    """A square of rods with both diagonals, one more than it takes, hanging from a string at each upper corner."""
    places = {
        "a": (0.0, 0, 0),
        "b": (1.0, 0, 0),
        "c": (1.0, 0, 1),
        "d": (0.0, 0, 1),
        "u": (0.1, 0, 2),
        "v": (0.9, 0, 2),
    }
    pairs = [("a", "b"), ("b", "c"), ("c", "d"), ("d", "a"), ("a", "c"), ("b", "d")]
    rods = tuple(Rod(f"r{k}", pair, 1.0) for k, pair in enumerate(pairs))
    strings = tuple(String(f"s{k}", pair, 500.0, rest_length=0.8) for k, pair in enumerate((("u", "d"), ("v", "c"))))
    return Structure("braced", places, rods, strings, fixed_nodes=("u", "v"))


def test_redundant_rigid_rods() -> None:
    state = find_equilibrium(Scene(braced_square(), gravity=DOWN))
    assert state.residual < 1e-11
    assert abs(state.reactions[:, 2].sum() - 6 * 9.81) < 1e-10
    assert state.is_stable
    # The limit of elastic rods, whose forces are unique: their compliance decides, alike for all.
    stiff = Section(area=1.0, second_moment=1.0, elasticity_modulus=1e9)
    elastic = StaticModel.of(Scene(braced_square().with_sections(stiff), gravity=DOWN), rods=Rods.ELASTIC)
    near = find_equilibrium(elastic)
    # Stretches of 60 N / 1e9 N/m.
    assert np.abs(near.nodes - state.nodes).max() < 1e-6
    assert near.residual < 1e-5


def test_what_cannot_be_held_says_so() -> None:
    with pytest.raises(tmj.errors.InfeasibleError, match="nothing holds it in that direction"):
        find_equilibrium(
            Scene(Structure("one", {"a": (0, 0, 0), "b": (1, 0, 0)}, (Rod("r", ("a", "b"), 1.0),)), gravity=DOWN)
        )
    with pytest.raises(tmj.errors.InfeasibleError, match=r"9\.81|19\.6"):
        find_equilibrium(StaticModel.of(hanging(), broken="s"), iterations=50)
    with pytest.raises(tmj.errors.OptionError, match="no string 'x'"):
        StaticModel.of(hanging(), broken="x")
    with pytest.raises(tmj.errors.OptionError, match="contradict a support"):
        StaticModel.of(hanging(), holds=(Hold(("a",), displacement=(0.1, 0, 0)),))
    with pytest.raises(tmj.errors.OptionError, match="there is no node 'x'"):
        StaticModel.of(hanging(), holds=(Hold(("x",)),))
    with pytest.raises(tmj.errors.OptionError, match="not along its directions"):
        Hold(("a",), ((1, 0, 0),), (0, 1, 0))
    with pytest.raises(tmj.errors.StructureError, match="has no section"):
        StaticModel.of(pinned((1, 0, 0)), rods=Rods.ELASTIC)
    with pytest.raises(tmj.errors.InfeasibleError, match="off its length"):
        find_equilibrium(StaticModel.of(pinned((1, 0, 0)), holds=(Hold(("b",), displacement=(0.2, 0, 0)),)))


def test_moved_holds() -> None:
    """Two masses in a row on strings; the first is moved by 0.2 m, and the other follows at its rest length."""
    structure = Structure(
        "row",
        {"a": (0, 0, 0), "b": (1, 0, 0), "c": (2, 0, 0)},
        strings=(String("s", ("a", "b"), 100.0, rest_length=0.7), String("t", ("b", "c"), 100.0, rest_length=0.7)),
        fixed_nodes=("a",),
        point_masses=(PointMass("b", 1.0), PointMass("c", 1.0)),
    )
    scene = Scene(structure, loads=(tmj.model.Load("c", (3.0, 0, 0)),))
    for parameter in (0.0, 0.5, 1.0):
        state = find_equilibrium(
            StaticModel.of(scene, holds=(Hold("b", displacement=(0.2, 0, 0)),)),
            parameter=parameter,  # type: ignore[arg-type]
        )
        assert np.abs(state.nodes[1] - [1 + 0.2 * parameter, 0, 0]).max() < 1e-14
        assert abs(state.nodes[2, 0] - state.nodes[1, 0] - 0.73) < 1e-13
        # On b: the strings pull with 3 N ahead and k stretch behind.
        expected = 100 * (0.3 + 0.2 * parameter) - 3
        assert abs(state.reactions[1, 0] - expected) < 1e-11


def test_elastic_rods_approach_rigid_ones() -> None:
    """Their stretch falls as 1/EA."""
    scene = tower(1)
    rigid = find_equilibrium(scene)
    gaps = []
    for modulus in (1e9, 1e10, 1e11):
        tube = Section.tube(0.05, 0.005, modulus)
        state: StaticState = find_equilibrium(
            StaticModel.of(scene.with_(structure=scene.structure.with_sections(tube)), rods=Rods.ELASTIC)
        )
        assert (
            np.abs(
                state.rod_forces
                / (state.rod_lengths - scene.structure.rod_lengths)
                / tube.axial_stiffness
                * scene.structure.rod_lengths
                - 1
            ).max()
            < 1e-6
        )
        gaps.append(float(np.abs(state.lengths - rigid.lengths).max()))
    # Forces of 1e3 N over EA of 1e6 N: 1e-3 of the length, to first order.
    assert abs(gaps[0] / gaps[1] - 10) < 0.1
    assert abs(gaps[1] / gaps[2] - 10) < 0.01


def test_the_picture_of_an_upright_structure_has_no_empty_half():
    scene = tmj.load_scene("prism")  # 0.8 m high and 0.5 m wide
    figure = structure_figure(scene.nodes0, find_equilibrium(scene))
    figure.draw_without_rendering()
    panel, _ = figure.axes
    assert panel.get_window_extent().width > 0.5 * figure.bbox.width
