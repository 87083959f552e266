"""Equilibria that engines find by their own accelerations, against those of statics."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

import tensegrity_mj as tmj
from evidence.random_structures import random_scene, random_structure
from tensegrity_mj.library.tower import tower
from tensegrity_mj.model.members import PointMass, Rod, String, Support
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.statics import StaticModel, find_equilibrium, linear_systems
from tensegrity_mj.statics.engines import EngineEquilibrium, engine_equilibrium

Array = NDArray[np.float64]
ENGINES = {"dae": tmj.DAE(), "mujoco": tmj.MuJoCo()}
AGREEMENT = 1e-8  # of a member's length: the project's bound; what is reached is round-off where the energy is smooth
DOWN = (0.0, 0.0, -9.81)


def distances(nodes: Array) -> Array:
    """Between all nodes: what motions of the whole leave."""
    return np.asarray(np.linalg.norm(nodes[:, None] - nodes[None], axis=2))


def pushed(scene: Scene, size: float = 0.05, seed: int = 0) -> Array:
    """A start that is off by a part of the mean member, with rods of their lengths."""
    model = StaticModel.of(scene)
    free = np.random.default_rng(seed).normal(size=model.boundary.Z.shape[1])
    x = model.start.ravel() + size * model.scale[0] * (model.boundary.Z @ free)
    there = linear_systems.projected(model, x, model.rod_lengths)
    assert there is not None
    return there.reshape(-1, 3)


def compare(scene: Scene, found: EngineEquilibrium, other: Array, bound: float = AGREEMENT) -> None:
    members = np.concatenate([scene.structure.rod_lengths, scene.structure.string_lengths(other)])
    gap = np.abs(distances(found.nodes) - distances(other)).max() / members.mean()
    print(f"{scene.name}, {found.engine}: {gap:.1e} of a member after {found.evaluations} evaluations")
    assert gap < bound
    assert found.growth < 1e-6 * max(1.0, np.abs(found.growth))
    assert np.array_equal(found.scene.nodes0, found.nodes)
    assert not found.scene.velocities0.any()


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(
    "make",
    [
        lambda: tower(2, form_found=False),
        lambda: tower(2, form_found=False, pinned_base=True, gravity=9.81),
        lambda: tmj.load_scene("tbar"),
        lambda: tmj.load_scene("dbar").with_(gravity=DOWN),
        lambda: tmj.load_scene("truss_arm").with_(contact=None),
        lambda: tmj.load_scene("cable").with_(motions=()),
    ],
    ids=["free tower", "tower on its base", "tbar", "dbar", "truss_arm", "bent cable"],
)
def test_engines_find_the_equilibria_of_statics(make: object, engine: str) -> None:
    """From perturbed starts, and towers from where they are laid out: each comes to rest where the energy is least."""
    scene: Scene = make()  # type: ignore[operator]
    start = pushed(scene)
    found = engine_equilibrium(scene, ENGINES[engine], nodes=start)
    compare(scene, found, find_equilibrium(StaticModel.of(scene, nodes=start)).nodes)
    # From there statics goes nowhere.
    again = find_equilibrium(StaticModel.of(found.scene))
    assert np.abs(again.nodes - found.nodes).max() < AGREEMENT


@pytest.mark.slow
@pytest.mark.parametrize("engine", ENGINES)
def test_a_net_of_rods(engine: str) -> None:
    scene = tmj.load_scene("net((3, 3))")
    start = pushed(scene, 0.02)
    found = engine_equilibrium(scene, ENGINES[engine], nodes=start)
    compare(scene, found, find_equilibrium(StaticModel.of(scene, nodes=start)).nodes)


@pytest.mark.parametrize("seed", range(3))
def test_random_structures(seed: int) -> None:
    """Supports, planes, point masses, slack strings, loads. Statics starts where the engine ended."""
    rng = np.random.default_rng([7, seed])
    structure = random_structure(
        rng, rods=1 + seed, support=("pinned", "constrained"), point_masses=seed % 2, stretch=(0.2, 0.4), own_planes=0.3
    )
    scene = random_scene(rng, structure, displaced=0.1, moving=0.0, gravity=True, loads=1)
    for engine in ENGINES.values():
        found = engine_equilibrium(scene, engine)
        state = find_equilibrium(StaticModel.of(scene, nodes=found.nodes))
        compare(scene, found, state.nodes)
        assert state.is_stable


def mass_between(at: float) -> Scene:
    """A mass on two strings, pressed between them: straight it is unstable, to either side it is not."""
    structure = Structure(
        "pressed",
        {"a": (-1, 0, 0), "b": (1, 0, 0), "m": (0, 0, at), "t": (0, 0, 2)},
        (Rod("r", ("m", "t"), 0.5),),
        (String("s1", ("a", "m"), 100.0, rest_length=0.8), String("s2", ("m", "b"), 100.0, rest_length=0.8)),
        fixed_nodes=("a", "b"),
    )
    return Scene(structure, gravity=DOWN)


@pytest.mark.parametrize("engine", ENGINES)
def test_unstable_equilibria_are_left(engine: str) -> None:
    """A rod that stands upright on a cable: it falls to where it hangs."""
    scene = mass_between(0.0)
    found = engine_equilibrium(scene, ENGINES[engine])
    state = find_equilibrium(scene)
    assert found.nodes[3, 2] < found.nodes[2, 2]
    assert abs(found.nodes[2, 2] - state.nodes[2, 2]) < AGREEMENT
    upright = Structure("rod", {"a": (0, 0, 0), "b": (0, 0, 1)}, (Rod("r", ("a", "b"), 1.0, support=Support.pinned()),))
    hanging = engine_equilibrium(Scene(upright, gravity=DOWN), ENGINES[engine])
    assert np.abs(hanging.nodes[1] - [0, 0, -1]).max() < AGREEMENT
    # δ̈ = -(3 g / 2 ℓ) δ.
    assert abs(hanging.growth + 1.5 * 9.81) < 1e-6


def test_what_resists_motion_has_no_part() -> None:
    scene = tower(1, damping=5.0)
    plain = engine_equilibrium(scene, tmj.DAE())
    thick = scene.with_(resistance=tmj.Resistance(viscous=3.0), contact=tmj.model.Contact(floor=-2.0))
    assert np.abs(engine_equilibrium(thick, tmj.DAE()).nodes - plain.nodes).max() < AGREEMENT


def test_what_does_not_fit() -> None:
    scene = tower(1)
    with pytest.raises(tmj.errors.OptionError, match="use a Scene"):
        engine_equilibrium(scene.structure, tmj.DAE())  # type: ignore[arg-type]
    with pytest.raises(tmj.errors.OptionError, match="use MuJoCo"):
        engine_equilibrium(scene, tmj.DAE)  # type: ignore[arg-type]
    with pytest.raises(tmj.errors.OptionError, match="nodes"):
        engine_equilibrium(scene, tmj.DAE(), nodes=np.zeros((2, 3)))
    with pytest.raises(tmj.errors.SceneError):
        engine_equilibrium(scene, tmj.DAE(), nodes=2 * scene.nodes0)
    with pytest.raises(tmj.errors.SceneError, match="stand still"):
        engine_equilibrium(tmj.load_scene("cable"), tmj.DAE())
    falling = Structure("drop", {"m": (0, 0, 0)}, point_masses=(PointMass("m", 1.0),))
    with pytest.raises(tmj.errors.InfeasibleError, match="no equilibrium"):
        engine_equilibrium(Scene(falling, gravity=DOWN), tmj.DAE(), iterations=20)
    with pytest.raises(tmj.errors.InfeasibleError, match="no equilibrium"):
        engine_equilibrium(tower(2, form_found=False), tmj.DAE(), iterations=1)
