"""Masses on rods and on their nodes, dampers of point masses: as values, in files, and in what follows from them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from loaded_rods import cloud, loaded, mass_of_nodes

import tensegrity_mj as tmj
from evidence.random_linked import random_velocities
from evidence.thesis.disturbance import Disturbance, Quantity, disturbed
from tensegrity_mj import exchange
from tensegrity_mj.engines.mujoco.mjcf import save_mjcf, scene_to_mjcf
from tensegrity_mj.exchange.importing import import_scene
from tensegrity_mj.exchange.mjcf import rod_of_body
from tensegrity_mj.model import PointMass, RodMass, rods
from tensegrity_mj.model.elements.element import forces_of
from tensegrity_mj.model.text.reading import scene_from_toml
from tensegrity_mj.model.text.writing import scene_to_toml
from tensegrity_mj.statics import find_equilibrium, natural_modes
from tensegrity_mj.statics.lightest import STEEL, minimal_mass
from tensegrity_mj.statics.modes import mass_matrix
from tensegrity_mj.studies.sweep import Sweep, drafted

MASS, LENGTH = 0.7, 1.3
LUMPS = (RodMass(0.2, 0.5), RodMass(0.9, 0.3, 8e-3))
GRAVITY = (0.0, 0.0, -9.81)


def prism() -> tmj.Scene:
    """The prism with masses on two rods, one of them with an inertia, and a damped one on a node of each."""
    return loaded(tmj.load_scene("prism").with_(control=None, target=None, gravity=GRAVITY), damping=0.4)


def moments(sigma: float) -> tuple[float, float]:
    """f and J of (2.30), ∫ (s - σ) ℓ dm and ∫ (s - σ)² ℓ² dm, by Gauss' rule of four points, which is exact."""
    structure = tmj.Structure(
        "rod", {"i": (0, 0, 0), "j": (LENGTH, 0, 0)}, (tmj.Rod("r", ("i", "j"), MASS, masses=LUMPS),)
    )
    f = sum(m * (s - sigma) * LENGTH for _, s, m in cloud(structure))
    return f, sum(m * ((s - sigma) * LENGTH) ** 2 for _, s, m in cloud(structure))


@pytest.mark.parametrize("sigma", [0.0, 0.3, 0.5, 1.0])
def test_the_inertia_of_2_30_is_an_integral_along_the_rod(sigma: float) -> None:
    """A quadratic of some ten terms of order one: round-off alone is between them."""
    rod = tmj.Rod("r", ("i", "j"), MASS, support=tmj.Support.free(sigma), masses=LUMPS)
    structure = tmj.Structure("rod", {"i": (0, 0, 0), "j": (0, LENGTH, 0)}, (rod,))
    (f,), (J,) = rods.inertia_of_rods(structure)
    np.testing.assert_allclose((f, J), moments(sigma), rtol=0, atol=1e-15)
    (center,), (moment,) = rods.centers_and_moments(np.array([MASS]), np.array([LENGTH]), structure.rod_lumps)
    total = MASS + 0.8
    assert structure.rod_masses[0] == pytest.approx(total)
    assert center == pytest.approx(moments(0.0)[0] / (total * LENGTH))
    assert moment == pytest.approx(moments(center)[1])


def test_energies_and_weights_are_those_of_points_of_mass() -> None:
    scene = prism()
    structure, rng = scene.structure, np.random.default_rng(1)
    velocities = random_velocities(rng, structure, scene.nodes0, 1.0)
    mass = mass_of_nodes(structure)
    kinetic = 0.5 * np.einsum("ik,ij,jk", velocities, mass, velocities)
    assert float(rods.kinetic_energy(structure, velocities)) == pytest.approx(kinetic, rel=1e-14)
    # Weights are what the mass matrix gives a common acceleration.
    np.testing.assert_allclose(rods.lumped_masses(structure), mass.sum(axis=1), rtol=1e-14)
    assert rods.total_mass(structure) == pytest.approx(mass.sum(), rel=1e-14)
    np.testing.assert_allclose(mass_matrix(structure).toarray(), np.kron(mass, np.eye(3)), atol=1e-15)


def test_a_point_mass_on_a_node_of_rods_is_the_first_rods() -> None:
    nodes = {"a": (0, 0, 0), "b": (1, 0, 0), "c": (1, 0, 1)}
    pair = (tmj.Rod("r1", ("b", "a"), 1.0), tmj.Rod("r2", ("b", "c"), 1.0))
    structure = tmj.Structure("two", nodes, pair, point_masses=(PointMass("b", 0.4), PointMass("c", 0.5)))
    assert structure.lone_masses == ()
    np.testing.assert_array_equal(structure.rod_lumps, [[0.4, 0.5], [0.0, 0.5], [0.0, 0.5]])
    np.testing.assert_array_equal(structure.rod_masses, [1.4, 1.5])


def test_files_hold_them_without_loss_and_none_is_written_where_there_is_none(tmp_path: Path) -> None:
    scene = prism()
    text = scene_to_toml(scene)
    assert scene_from_toml(text) == scene
    assert "damping = 0.4" in text
    assert text.count("masses = [{ at = ") == 2  # the first rod has none
    assert "masses" not in scene_to_toml(tmj.load_scene("prism"))
    shared = scene_to_toml(tmj.load_scene("prism")).replace(
        "\nrods = [", "\ndefaults.rods.masses = [{ at = 0.5, mass = 0.1 }]\nrods = [", 1
    )
    assert all(rod.masses == (RodMass(0.5, 0.1),) for rod in scene_from_toml(shared).structure.rods)
    with pytest.raises(tmj.errors.StructureError, match=r"rods\[1\] 'rod2'\.masses\[0\]: at = 2\.0; it must be within"):
        scene_from_toml(
            scene_to_toml(tmj.load_scene("prism")).replace(
                "D = [[0.0, 0.0, 1.0]] } }", "D = [[0.0, 0.0, 1.0]] }, masses = [{ at = 2.0, mass = 1.0 }] }"
            )
        )


def test_a_sweep_sets_and_scales_them() -> None:
    scene = prism()
    draft = drafted(Sweep(scene).common())
    set_ = draft.apply({"structure.rods[rod2].masses[1].mass": 0.25}).scene.structure
    assert [one.mass for one in set_.rods[1].masses] == [scene.structure.rods[1].masses[0].mass, 0.25]
    all_ = draft.apply({"structure.rods[rod2,rod3].masses.at": 0.5}).scene.structure
    assert {one.at for rod in all_.rods for one in rod.masses} == {0.5}
    assert draft.apply({"structure.point_masses.damping": 0.0}).scene.effects == ()
    with pytest.raises(tmj.errors.OptionError, match="rod 'rod1' has no masses"):
        draft.apply({"structure.rods[rod1].masses[0].mass": 1.0})


def test_the_mjcf_has_one_body_with_the_whole_inertia_and_comes_back(tmp_path: Path) -> None:
    scene = prism()
    structure = scene.structure
    path = tmp_path / "prism.xml"
    save_mjcf(scene, path)
    model = mujoco.MjModel.from_xml_path(str(path))
    bodies = [model.body(rod.name).id for rod in structure.rods]
    np.testing.assert_allclose(model.body_mass[bodies], structure.rod_masses, rtol=1e-15)
    _, moment = rods.centers_and_moments(rods.own_masses(structure), structure.rod_lengths, structure.rod_lumps)
    np.testing.assert_allclose(model.body_inertia[bodies, 0], moment, rtol=1e-14)
    balls = [
        int(np.sum((model.geom_bodyid == one) & (model.geom_type == mujoco.mjtGeom.mjGEOM_SPHERE))) for one in bodies
    ]
    assert balls == [0, 2, 2]
    theirs = import_scene(path).scene.structure
    np.testing.assert_allclose(theirs.rod_masses, structure.rod_masses, rtol=1e-14)
    for one, other in zip(rods.inertia_of_rods(theirs), rods.inertia_of_rods(structure), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize(
    ("center", "part"), [(0.5, 1.0), (0.5, 1.005), (0.5, 3.0), (0.3, 1.2), (0.9, 0.3), (0.02, 0.02)]
)
def test_a_rod_and_one_mass_have_a_bodys_inertia(center: float, part: float) -> None:
    mass, length = 2.0, 0.8
    moment = part * mass * length**2 / 12
    found = rod_of_body(mass, length, center, moment)
    assert found is not None
    own, carried = found
    assert bool(carried) == (part not in (1.0, 1.005))  # within one in a hundred of a thin rod's
    if carried:
        (one,) = carried
        lumps = (one.mass, one.mass * one.at, one.mass * one.at**2 + one.inertia / length**2)
        assert own + one.mass == pytest.approx(mass, rel=1e-15)
        np.testing.assert_allclose(rods.centers_and_moments(own, length, lumps), (center, moment), rtol=1e-12)
    assert rod_of_body(mass, length, 1.2, moment) is None


def test_other_programs_files_say_what_they_leave_out(tmp_path: Path) -> None:
    scene = prism()
    paths, notes = exchange.save_csv(scene, tmp_path / "p_nodes.csv")
    assert {"the damping of point masses is left out", "the masses that rods carry are left out"} <= set(notes)
    back = import_scene(paths[0]).scene.structure
    assert [(one.node, one.mass) for one in back.point_masses] == [
        (one.node, one.mass) for one in scene.structure.point_masses
    ]
    _, notes = exchange.save_mat(scene, tmp_path / "p.mat")
    assert "point masses where rods end are left out" in notes


def test_copies_that_are_moved_mirrored_and_merged_keep_them() -> None:
    structure = prism().structure
    moved = structure.moved((0.3, 0.2, 0.1), (1.0, 2.0, 3.0))
    for one in (moved, structure.mirrored((1, 0, 0))):
        # ℓ of the places as they are rounded there.
        np.testing.assert_allclose(one.rod_lumps, structure.rod_lumps, rtol=1e-14)
    both = structure.merged(structure.moved(translation=(3.0, 0.0, 0.0)), prefix="b_")
    np.testing.assert_allclose(both.rod_lumps, np.hstack([structure.rod_lumps] * 2), rtol=1e-13)
    assert structure.merged(structure, join=True) == structure


def test_the_damping_of_point_masses_is_an_element_in_both_forms() -> None:
    scene = prism()
    rng = np.random.default_rng(2)
    velocities = rng.normal(size=(3, *scene.nodes0.shape))
    forces = forces_of(scene.effects, scene, 0.0, np.broadcast_to(scene.nodes0, velocities.shape), velocities)
    expected = np.zeros_like(velocities)
    for point in scene.structure.point_masses:
        row = scene.structure.node_index[point.node]
        expected[:, row] = -point.damping * velocities[:, row]
    np.testing.assert_array_equal(forces, expected)


def test_modes_of_a_prestressed_prism_are_those_of_its_own_matrices() -> None:
    """K by differences of forces on nodes, M of points of mass, on motions that keep rods and supports.

    K of a step of 1e-6 m is good to 1e-9 of the stiffest string. Linear models of the engines have the same, of
    differences of their own of 1e-6.
    """
    scene = tmj.load_scene("prism").with_(control=None, target=None)
    tight = scene.structure.with_strings(rest_length=0.93 * scene.structure.rest_lengths)
    state = find_equilibrium(loaded(scene.with_(structure=tight)))
    assert state.tensions.min() > 1e-3  # no string is at the edge of being slack
    modes, here = natural_modes(state), state.scene()
    structure, x = here.structure, state.nodes.copy()

    def forces(nodes: np.ndarray) -> np.ndarray:
        out = np.zeros_like(nodes)
        for string, rest in zip(structure.strings, structure.rest_lengths, strict=True):
            i, j = (structure.node_index[name] for name in string.nodes)
            d = nodes[j] - nodes[i]
            pull = string.stiffness * max(0.0, float(np.linalg.norm(d)) - rest) * d / np.linalg.norm(d)
            out[i] += pull
            out[j] -= pull
        for (i, j), force, length in zip(structure.rod_nodes, state.rod_forces, structure.rod_lengths, strict=True):
            # Of a rod whose force stays: N/ℓ along it, which turns as it does.
            d = (nodes[j] - nodes[i]) / length * force
            out[i] += d
            out[j] -= d
        return out.ravel()

    n, h = x.size, 1e-6
    K = np.array([(forces(x - h * e) - forces(x + h * e)) / (2 * h) for e in np.eye(n).reshape(n, *x.shape)])
    held = []
    for rod, (i, j) in zip(structure.rods, structure.rod_nodes, strict=True):
        row = np.zeros_like(x)
        row[j], row[i] = x[j] - x[i], x[i] - x[j]
        held.append(row.ravel())
        for direction in rod.support.directions:  # at σ = 0
            row = np.zeros_like(x)
            row[i] = direction
            held.append(row.ravel())
    _, size, V = np.linalg.svd(np.array(held))
    Z = V[int(np.sum(size > 1e-9)) :].T
    M = np.kron(mass_of_nodes(structure), np.eye(3))
    squares = np.sort(np.linalg.eigvals(np.linalg.solve(Z.T @ M @ Z, Z.T @ K @ Z)).real)
    np.testing.assert_allclose(np.sort(modes.squares), squares, atol=1e-7 * squares[-1])
    for engine in (tmj.DAE(), tmj.ODE(), tmj.MuJoCo()):
        found = np.linalg.eigvals(tmj.linearize(here, engine=engine).A)
        np.testing.assert_allclose(np.sort(found.imag**2)[::2], squares, atol=1e-5 * squares[-1])


def test_the_lightest_mast_carries_what_is_on_it() -> None:
    """A mass in the middle is half at the foot, which is held, and half at the top, as a point mass there is."""

    def mass(masses: tuple[RodMass, ...], points: tuple[PointMass, ...]) -> float:
        nodes = {"foot": (0, 0, 0), "top": (0, 0, 1), "a": (1, 0, 0), "b": (-1, 1, 0), "c": (-1, -1, 0)}
        rod = tmj.Rod("mast", ("foot", "top"), 1.0, support=tmj.Support.pinned(), masses=masses)
        guys = tuple(tmj.String(f"to {name}", (name, "top"), 1e4) for name in "abc")
        mast = tmj.Structure("mast", nodes, (rod,), guys, ("a", "b", "c"), points)
        found = minimal_mass(mast, rods=STEEL, strings=STEEL, gravity=GRAVITY, least_force_density=10.0)
        return float(found.rod_masses[0])

    with_point = mass((), (PointMass("top", 200.0),))
    assert mass((RodMass(0.5, 400.0),), ()) == pytest.approx(with_point, rel=1e-5)  # its tolerance is 1e-6
    assert mass((RodMass(1.0, 200.0),), ()) == pytest.approx(with_point, rel=1e-5)
    assert with_point > 1.1 * mass((), ())


def test_an_error_of_masses_is_one_of_what_rods_carry_too() -> None:
    scene = prism()
    heavy = disturbed(scene, Disturbance(Quantity.MASS, 1.1)).structure
    np.testing.assert_allclose(heavy.rod_lumps, 1.1 * scene.structure.rod_lumps, rtol=1e-14)
    np.testing.assert_allclose(heavy.rod_masses, 1.1 * scene.structure.rod_masses, rtol=1e-14)
    slow = disturbed(scene, Disturbance(Quantity.DAMPING, 2.0)).structure
    assert {point.damping for point in slow.point_masses} == {0.8}


def test_a_scene_without_them_has_the_mjcf_that_it_had() -> None:
    """Masses of nothing do not change a digit: a rod's inertia is what m ℓ²/12 rounds to."""
    scene = tmj.load_scene("prism")
    text = scene_to_mjcf(scene)
    for rod, length in zip(scene.structure.rods, scene.structure.rod_lengths.tolist(), strict=True):
        assert f'mass="{rod.mass!r}" diaginertia="{rod.mass * length**2 / 12!r} ' in text
    heavy = replace(scene.structure.rods[1], masses=(RodMass(0.5, 1.0),))
    other = replace(scene.structure, rods=(scene.structure.rods[0], heavy, scene.structure.rods[2]))
    changed = [
        line
        for line, new in zip(text.splitlines(), scene_to_mjcf(scene.with_(structure=other)).splitlines(), strict=False)
        if line != new
    ]
    assert changed
    assert 'name="rod1"' not in changed[0]
