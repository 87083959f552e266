"""What must not matter: where an experiment stands in the world, the order of its members, and the units.

Each experiment is run twice with the same fixed-step method, whose steps turn, permute and scale with it, so that only
round-off is between the two: 2e-16 m a step, 1e-13 m after 400 steps if all of it had one sign. The motion spreads it
by less than tenfold in 0.4 s. Velocities and forces carry it times a frequency or a stiffness of below 100.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

import tensegrity_mj as tmj
from evidence.random_structures import random_rotation, random_scene, random_structure
from tensegrity_mj.model.events import Load
from tensegrity_mj.model.members import PointMass, String
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.strings import StringLaw
from tensegrity_mj.model.structure import Structure

Array = NDArray[np.float64]
Engine = tmj.DAE | tmj.MuJoCo

DURATION, STEP = 0.4, 1e-3  # s
TOLERANCE = 1e-12


def dae(step: float) -> Engine:
    return tmj.DAE(method=tmj.Method.RK4, timestep=step)


def mujoco(step: float) -> Engine:
    return tmj.MuJoCo(timestep=step)


every_engine = pytest.mark.parametrize("engine", [dae, mujoco])
every_structure = pytest.mark.parametrize("planar", [False, True], ids=["space", "plane"])
seeds = pytest.mark.parametrize("seed", range(4))


def experiment(seed: int, planar: bool) -> Scene:
    """Rods of all supports, a point mass, gravity, loads, damping."""
    rng = np.random.default_rng([seed, planar])
    structure = random_structure(
        rng,
        rods=4,
        planar=planar,
        own_planes=0.3,
        point_masses=1,
        fixed_nodes=2,
        damping=(0.1, 1.0),
        law=list(StringLaw)[seed % 2],
    )
    return random_scene(rng, structure, displaced=0.1, moving=1.0, gravity=True, loads=3)


def run(scene: Scene, engine: Engine, duration: float = DURATION, interval: float = 0.02) -> tmj.Trajectory:
    return tmj.simulate(scene, None, engine, duration=duration, output_interval=interval)


def vector(values: Array) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return (x, y, z)


@seeds
@every_structure
@every_engine
def test_a_turned_and_shifted_experiment_moves_the_same_way(engine, planar: bool, seed: int) -> None:
    scene = experiment(seed, planar)
    rng = np.random.default_rng(seed)
    rotation, shift = random_rotation(rng), rng.uniform(-2, 2, 3)
    elsewhere = Scene(
        scene.structure.moved(rotation, shift),
        gravity=vector(rotation @ scene.gravity),
        initial_nodes=scene.nodes0 @ rotation.T + shift,
        initial_velocities=scene.velocities0 @ rotation.T,
        loads=tuple(replace(load, force=vector(rotation @ load.force)) for load in scene.loads),
    )
    here, there = run(scene, engine(STEP)), run(elsewhere, engine(STEP))
    # Up to 10 m from the origin, where round-off is ten times as large.
    assert np.abs(there.nodes - (here.nodes @ rotation.T + shift)).max() <= 10 * TOLERANCE
    assert np.abs(there.velocities - here.velocities @ rotation.T).max() <= 100 * TOLERANCE
    for name in ("tensions", "rod_force_densities"):
        scale = np.abs(getattr(here, name)).max()
        assert np.abs(getattr(there, name) - getattr(here, name)).max() <= 100 * TOLERANCE * scale, name


@seeds
@every_structure
@every_engine
def test_the_order_of_members_and_of_their_ends_does_not_matter(engine, planar: bool, seed: int) -> None:
    scene = experiment(seed, planar)
    rng = np.random.default_rng(seed)
    structure = scene.structure

    def shuffled(items: Sequence) -> list:
        return [items[k] for k in rng.permutation(len(items))]

    def turned(rod: tmj.Rod) -> tmj.Rod:
        return replace(rod, nodes=rod.nodes[::-1], support=replace(rod.support, sigma=1 - rod.support.sigma))

    order = shuffled(structure.node_names)
    rows = [structure.node_index[name] for name in order]
    rods = shuffled(structure.rods)
    strings = shuffled(structure.strings)
    other = replace(
        structure,
        nodes={name: structure.nodes[name] for name in order},
        rods=tuple(turned(rod) if rng.integers(2) else rod for rod in rods),
        strings=tuple(replace(s, nodes=s.nodes[::-1]) if rng.integers(2) else s for s in strings),
        fixed_nodes=tuple(shuffled(structure.fixed_nodes)),
    )
    relabelled = scene.with_(
        structure=other,
        initial_nodes=scene.nodes0[rows],
        initial_velocities=scene.velocities0[rows],
        loads=tuple(shuffled(scene.loads)),
    )
    first, second = run(scene, engine(STEP)), run(relabelled, engine(STEP))
    assert np.abs(second.nodes - first.nodes[:, rows]).max() <= TOLERANCE
    columns = [structure.strings.index(s) for s in strings]
    scale = np.abs(first.tensions).max()
    assert np.abs(second.tensions - first.tensions[:, columns]).max() <= 100 * TOLERANCE * scale


@seeds
@every_structure
@every_engine
def test_other_units_of_mass_length_and_time(engine, planar: bool, seed: int) -> None:
    scene = experiment(seed, planar)
    mass, length, time = 3.7, 0.21, 5.3
    force, speed = mass * length / time**2, length / time
    structure = scene.structure

    def string(s: String) -> String:
        rest = {
            "rest_length": s.rest_length and s.rest_length * length,
            "tension": s.tension and s.tension * force,
            "force_density": s.force_density and s.force_density * force / length,
        }
        return replace(s, stiffness=s.stiffness * force / length, damping=s.damping * force / speed, **rest)

    other = Structure(
        name="other units",
        nodes={name: vector(length * np.array(p)) for name, p in structure.nodes.items()},
        rods=tuple(replace(r, mass=r.mass * mass) for r in structure.rods),
        strings=tuple(string(s) for s in structure.strings),
        fixed_nodes=structure.fixed_nodes,
        point_masses=tuple(PointMass(p.node, p.mass * mass, p.plane) for p in structure.point_masses),
        string_law=structure.string_law,
    )
    scaled = Scene(
        other,
        gravity=vector(np.array(scene.gravity) * length / time**2),
        initial_nodes=scene.nodes0 * length,
        initial_velocities=scene.velocities0 * speed,
        loads=tuple(
            Load(a.node, vector(force * np.array(a.force)), a.angular_frequency / time, a.phase) for a in scene.loads
        ),
    )
    here, there = run(scene, engine(STEP)), run(scaled, engine(STEP * time), DURATION * time, 0.02 * time)
    assert np.abs(there.nodes / length - here.nodes).max() <= TOLERANCE
    assert np.abs(there.velocities / speed - here.velocities).max() <= 100 * TOLERANCE
    for name, unit in (
        ("tensions", force),
        ("multipliers", time**-2),
        ("rod_force_densities", force / length),
        ("kinetic_energy", force * length),
        ("string_energy", force * length),
        ("external_work", force * length),
        ("dissipation", force * length),
    ):
        expected = getattr(here, name)
        error = np.abs(getattr(there, name) / unit - expected).max()
        assert error <= 100 * TOLERANCE * np.abs(expected).max(), name
