"""Any structure as one system, against the equations of rods alone, of joints, and of node coordinates."""

from __future__ import annotations

import natural_coordinates as natural
import numpy as np
import pytest
from linked_scenes import everything_moves, four_bar
from momenta import linear_momentum
from natural_coordinates import chain, request

import tensegrity_mj as tmj
from tensegrity_mj.engines import Solver
from tensegrity_mj.engines.reference.dae import DAE, Drift
from tensegrity_mj.model import rods

GENERAL = Solver.GENERAL
# Matrices of some hundred coordinates whose masses differ by 1e3 at most: 1e-16 times a condition number of 1e6.
TOLERANCE = 1e-10


def answers(scene, solver):
    """Node accelerations at the start, and λ."""
    engine = DAE(solver=solver)
    run = engine.prepared(request(scene))
    run.rates_at(0.0, run.y, None)
    _, found = engine.accelerations(request(scene))(0.0, scene.nodes0, scene.velocities0)
    return found, run.multipliers[: len(scene.structure.rods)].copy()


def spread(one, other):
    return float(np.abs(one - other).max() / np.abs(other).max())


SHIPPED = ["cable", "dbar", "net", "planar_beam", "pulley", "suspended_cable", "tbar", "tower", "tower_waves"]


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_scenes_have_the_accelerations_and_multipliers_of_their_usual_equations(name):
    scene = tmj.load_scene(name)
    scene = scene if scene.water else scene.with_(gravity=(0.3, -0.5, -9.81))
    given = np.random.default_rng(2).normal(size=scene.nodes0.shape)
    velocities = natural.consistent_velocities(scene.structure, scene.nodes0, given)
    scene = scene.with_(initial_velocities=velocities, motions=())
    expected, multipliers = answers(scene, Solver.JOINTS)
    found, forces = answers(scene, GENERAL)
    assert spread(found, expected) <= TOLERANCE
    assert spread(forces, multipliers) <= TOLERANCE


@pytest.mark.parametrize("planar", [False, True])
def test_supports_that_move_carry_what_hangs_on_them_and_give_the_same_work(planar):
    scene = everything_moves(planar)
    runs = [
        tmj.simulate(scene, None, DAE(method="rk4", timestep=1e-3, solver=solver, drift="monitor"), duration=0.3)
        for solver in (Solver.JOINTS, GENERAL)
    ]
    # Round-off of 300 steps.
    assert np.abs(runs[1].nodes - runs[0].nodes).max() <= 1e-12
    assert np.abs(runs[1].external_work - runs[0].external_work).max() <= 1e-11
    assert runs[1].reports["closure_drift"] <= 1e-12


def test_elastic_rods_lengthen_as_by_their_usual_equations():
    scene = everything_moves(planar=False)
    section = tmj.model.Section.solid(0.004, 2e8)
    scene = scene.with_(structure=scene.structure.with_sections(section).with_elastic_rods(damping=2.0))
    stretched = scene.nodes0 * 1.001
    stretched[[0, 6, 7, 8]] = scene.nodes0[[0, 6, 7, 8]]  # held
    scene = scene.with_(initial_nodes=stretched)
    found, expected = (answers(scene, solver)[0] for solver in (GENERAL, Solver.JOINTS))
    assert spread(found, expected) <= TOLERANCE


@pytest.mark.parametrize("name", ["ladder", "tower_beam"])
def test_rods_without_places_of_their_own_move_as_those_that_have_them(name):
    """Linear constraints, joints, loops."""
    scene = tmj.load_scene(name)
    expected, multipliers = answers(scene, GENERAL)
    found, forces = answers(scene, Solver.FULL)
    assert spread(found, expected) <= TOLERANCE
    assert spread(forces, multipliers) <= TOLERANCE


def wet(weights):
    """A loop in waves, on supports that move."""
    scene = everything_moves(planar=False)
    water = tmj.Water(waves=(tmj.model.Wave(0.1, 3.0),), current=(0.2, 0.1, 0.0), weights=weights)
    return scene.with_(water=water)


@pytest.mark.parametrize("weights", tmj.model.Weights)
def test_added_mass_is_that_of_the_thesis_matrix(weights):
    expected, multipliers = answers(wet(weights), Solver.FULL)
    found, forces = answers(wet(weights), GENERAL)
    assert spread(found, expected) <= TOLERANCE
    assert spread(forces, multipliers) <= TOLERANCE
    dry, _ = answers(wet(weights).with_(water=None), GENERAL)
    assert spread(dry, expected) > 1e-2


def stretch(run):
    """The most that any rod differs from its length [m]."""
    first, second = rods.ends(run.scene.structure, run.nodes)
    return np.abs(np.linalg.norm(second - first, axis=-1) - run.scene.structure.rod_lengths).max()


@pytest.mark.parametrize("seed", range(3))
def test_projection_closes_all_constraints_without_impulse(seed):
    """The least changes in the metric of the masses are those of inner forces: no momentum comes of them."""
    structure = chain(np.random.default_rng(40 + seed), 6, top=tmj.Support.free(0.3))
    velocities = natural.consistent_velocities(
        structure, structure.positions, np.random.default_rng(seed).normal(size=structure.positions.shape, scale=5.0)
    )
    scene = tmj.Scene(structure, initial_velocities=velocities)
    engines = [DAE(method="rk4", timestep=4e-3, solver=GENERAL, drift=drift) for drift in (Drift.NORMALIZE, "monitor")]
    run, loose = (tmj.simulate(scene, None, engine, duration=0.2, output_interval=4e-3) for engine in engines)
    assert stretch(loose) > 1e-9
    assert stretch(run) <= 1e-14
    assert run.reports["closure_drift"] <= 1e-13
    assert run.reports["closure_rate_drift"] <= 1e-12
    momentum = linear_momentum(structure, run.velocities)
    # Round-off of 50 steps of velocities of 10 m/s.
    assert np.abs(momentum - momentum[0]).max() <= 1e-12


@pytest.mark.parametrize("plane", [False, True])
def test_a_loop_in_a_plane_keeps_the_rows_that_it_needs(plane):
    """Three rods in a plane between two pins: of 9 rows of joints and 6 of pins, those across the plane come thrice."""
    scene = four_bar(plane)
    records = DAE(solver=GENERAL).prepared(request(scene)).records
    # In space 6 of pins and 6 of joints; in the plane 4 and 4, and the plane holds both vectors of three rods.
    assert len(records.table["rows"]) == (4 + 4 + 6 if plane else 12)
    assert records.table["redundant"] == 0
