"""Dynamic relaxation finds what Newton's method finds."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import tensegrity_mj as tmj
from evidence.families.towers import base_nodes
from evidence.random_linked import random_linked_structure
from evidence.random_taut import random_taut_structure
from tensegrity_mj.errors import InfeasibleError, OptionError
from tensegrity_mj.library.tower import tower
from tensegrity_mj.model.section import Section
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.statics.boundary import Hold
from tensegrity_mj.statics.equilibrium import find_equilibrium, relax
from tensegrity_mj.statics.model import Rods, StaticModel
from tensegrity_mj.statics.state import StaticState

Array = NDArray[np.float64]

# Forces that are left are below 1e-12 of the largest, and the softest motion of these structures is some 1e-3 as stiff
# as their strings: positions are equal within 1e-8 of their size with room to spare.
SAME = 1e-8


def is_same(relaxed: StaticState, newton: StaticState) -> bool:
    """Up to motions that nothing resists, of the whole or of slack strings: forces and rods' lengths show."""
    size, stiffness = newton.model.scale
    forces = float(np.abs(newton.tensions).max()) + float(np.abs(newton.rod_forces).max(initial=0.0))
    return bool(
        np.allclose(relaxed.tensions, newton.tensions, rtol=0, atol=SAME * size * stiffness)
        and np.allclose(relaxed.rod_lengths, newton.rod_lengths, rtol=0, atol=SAME * size)
        and np.allclose(relaxed.rod_forces, newton.rod_forces, rtol=0, atol=1e-7 * forces)
    )


def kicked(model: StaticModel, state: StaticState, seed: int, part: float = 0.03) -> StaticModel:
    """The model that starts near a state, everything displaced at random."""
    shift = np.random.default_rng(seed).normal(size=state.nodes.shape) * part * model.scale[0]
    Z = model.boundary.Z
    return model.with_(start=state.nodes + (Z @ (Z.T @ shift.ravel())).reshape(-1, 3))


@pytest.mark.parametrize("elastic", [False, True])
@pytest.mark.parametrize("seed", [1, 2])
def test_a_random_net_comes_to_rest_where_newton_finds_it(seed: int, elastic: bool) -> None:
    rng = np.random.default_rng(seed)
    structure = random_taut_structure(rng, rods=3, pinned=0.3)
    options: dict[str, Any] = {}
    if elastic:
        structure, options = structure.with_sections(Section(1e-4, 1e-9, 3e8)), {"rods": Rods.ELASTIC}
    loads = 0.5 * rng.normal(size=(len(structure.nodes), 3))
    model = StaticModel.of(structure, loads=loads, **options)
    newton = find_equilibrium(model)
    relaxed = relax(kicked(model, newton, seed))
    assert is_same(relaxed, newton)
    assert np.allclose(relaxed.nodes, newton.nodes, rtol=0, atol=SAME * model.scale[0])
    if elastic:
        assert np.abs(newton.rod_lengths - model.rod_lengths).max() > 1e-5


def test_linked_rods_come_to_rest_where_newton_finds_them() -> None:
    structure = random_linked_structure(np.random.default_rng(3), rods=3, strings=10, stretch=(0.1, 0.4))
    newton = find_equilibrium(structure)
    assert is_same(relax(kicked(newton.model, newton, 0)), newton)


@pytest.mark.parametrize("held", [False, True])
def test_a_tower_comes_to_rest_free_or_held_and_loaded(held: bool) -> None:
    scene = tower(2, form_found=False)
    model = StaticModel.of(scene)
    if held:
        found = find_equilibrium(scene).scene()
        count = len(found.structure.nodes)
        loads = np.zeros((count, 3))
        loads[-1] = (5.0, -20.0, 10.0)
        model = StaticModel.of(found, loads=loads, holds=[Hold(tuple(base_nodes()), displacement=(0.1, 0.0, 0.0))])
    newton, relaxed = find_equilibrium(model), relax(model)
    assert is_same(relaxed, newton)
    if held:
        assert np.allclose(relaxed.nodes, newton.nodes, rtol=0, atol=SAME)
        assert np.allclose(relaxed.reactions, newton.reactions, atol=1e-5)


def test_a_parameter_scales_loads() -> None:
    """A mass between two strings of 50 N/m moves by s f / 100."""
    structure = Structure.from_arrays(
        [[-1, 0, 0], [0, 0, 0], [1, 0, 0]],
        np.zeros((0, 2), int),
        [(0, 1), (1, 2)],
        rod_mass=np.zeros(0),
        stiffness=50.0,
        tension=10.0,
        fixed_nodes=(0, 2),
        point_masses={1: 1.0},
    )
    loads = np.zeros((3, 3))
    loads[1, 0] = 4.0
    for parameter in (0.5, -2.0):
        state = relax(StaticModel.of(structure, loads=loads), parameter=parameter)
        assert state.nodes[1] == pytest.approx([0.04 * parameter, 0, 0], abs=1e-12)


def test_it_says_what_does_not_come_to_rest() -> None:
    scene = tower(2, form_found=False)
    with pytest.raises(InfeasibleError, match="not at rest after 3 steps"):
        relax(scene, iterations=3)
    with pytest.raises(InfeasibleError, match="nothing holds it"):
        relax(tower(2, form_found=False, gravity=9.81))
    with pytest.raises(OptionError, match="tolerance"):
        relax(scene, tolerance=0.0)


@pytest.mark.parametrize("name", ["pinned_rod", "pinned_rod_mirror"])
def test_one_rod_alone_relaxes(name: str) -> None:
    scene = tmj.load_scene(name)
    structure = scene.structure.with_strings(rest_length=0.5 * scene.structure.string_lengths(scene.nodes0))
    first, second = (find(scene.with_(structure=structure)) for find in (find_equilibrium, relax))
    assert np.abs(first.nodes - second.nodes).max() < 1e-8


def test_an_elastic_rod_takes_up_what_a_hold_moves_it_by() -> None:
    """N = EA d / ℓ, to round-off of the length: 4e-16 of it against a stretch of 1e-6 is 4e-10."""
    section = tmj.model.Section.solid(0.01, 70e9)
    rod = tmj.Rod("r", ("a", "b"), 1.0, 0.01, tmj.Support.pinned(0.0), section)
    structure = tmj.Structure("bar", {"a": (0.0, 0.0, 0.0), "b": (1.0, 0.0, 0.0)}, (rod,))
    model = StaticModel.of(structure, rods=Rods.ELASTIC, holds=(Hold("b", None, (1e-6, 0.0, 0.0)),))
    assert find_equilibrium(model).rod_forces[0] == pytest.approx(section.axial_stiffness * 1e-6, rel=1e-9)
