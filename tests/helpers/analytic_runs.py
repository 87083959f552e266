"""Runs whose motion is a formula: what pictures, plots and reports are tested with, without any engine."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.model.members import PointMass, Rod, String, Support
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.model.target import Target
from tensegrity_mj.runs.trajectory import Trajectory

Array = NDArray[np.float64]

RATE = 1.5  # rad/s
TILT = 0.6  # rad, of the rod from the vertical
STIFFNESS = 10.0


def cone_scene(name: str = "cone") -> Scene:
    """A rod pinned at the origin, three strings from its tip to fixed nodes, and a target upright."""
    fixed = {f"a{i}": (1.2 * math.cos(a), 1.2 * math.sin(a), 0.0) for i, a in enumerate((0.0, 2.1, 4.2))}
    structure = Structure(
        name,
        {"o": (0.0, 0.0, 0.0), "tip": (math.sin(TILT), 0.0, math.cos(TILT)), **fixed},
        rods=(Rod("rod", ("o", "tip"), 1.0, 0.02, Support.pinned(0.0)),),
        strings=tuple(String(f"s{i}", ("tip", key), STIFFNESS, force_density=0.1) for i, key in enumerate(fixed)),
        fixed_nodes=tuple(fixed),
    )
    upright = structure.positions.copy()
    upright[1] = (0.0, 0.0, 1.0)
    return Scene(structure, name=name, target=Target.set_point(upright))


def cone_motion(times: Array) -> tuple[Array, Array]:
    """Node positions and velocities (T, 5, 3) of the rod going round the vertical at a constant rate."""
    rest = cone_scene().structure.positions
    nodes = np.repeat(rest[None], len(times), axis=0)
    velocities = np.zeros_like(nodes)
    angle = RATE * times
    nodes[:, 1, 0] = math.sin(TILT) * np.cos(angle)
    nodes[:, 1, 1] = math.sin(TILT) * np.sin(angle)
    velocities[:, 1, 0] = -RATE * math.sin(TILT) * np.sin(angle)
    velocities[:, 1, 1] = RATE * math.sin(TILT) * np.cos(angle)
    return nodes, velocities


def cone_run(times: Array | None = None, engine: str = "formula A", scene: Scene | None = None) -> Trajectory:
    """The run; strings have force densities 0.1, 0.2, 0.3 N/m modulated in time."""
    times = np.linspace(0.0, 2.0, 21) if times is None else times
    nodes, velocities = cone_motion(times)
    force_densities = np.array([0.1, 0.2, 0.3]) * (1.0 + 0.5 * np.sin(times))[:, None]
    return run_of(scene or cone_scene(), times, nodes, velocities, force_densities, engine)


def two_masses() -> Scene:
    """Two point masses on a string: no rod, no target, free in space."""
    structure = Structure(
        "masses",
        {"p": (0.0, 0.0, 0.0), "q": (1.0, 0.0, 0.5)},
        strings=(String("s", ("p", "q"), STIFFNESS),),
        point_masses=(PointMass("p", 1.0), PointMass("q", 2.0)),
    )
    return Scene(structure)


def planar_scene(normal: tuple[float, float, float]) -> Scene:
    """Two crossed rods and four strings, all in the plane through the origin with the given normal."""
    n = np.array(normal) / np.linalg.norm(normal)
    first = np.cross(n, [0.3, 0.5, 0.9] if abs(n[2]) > 0.9 else [0.0, 0.0, 1.0])
    first /= np.linalg.norm(first)
    second = np.cross(n, first)
    corners = [first, second, -1.2 * first, -0.8 * second]
    return Scene(
        Structure.from_arrays(corners, [[0, 2], [1, 3]], [[0, 1], [1, 2], [2, 3], [3, 0]], rod_mass=1.0, stiffness=5.0)
    )


def run_of(
    scene: Scene, times: Array, nodes: Array, velocities: Array, force_densities: Array, engine: str = ""
) -> Trajectory:
    """A Trajectory from motion and force densities (T, M); rest lengths and tensions follow from the string law."""
    structure, count = scene.structure, len(times)
    lengths = structure.string_lengths(nodes)
    zeros, rods = np.zeros(count), np.zeros((count, len(structure.rods)))
    return Trajectory(
        scene=scene,
        time=times,
        nodes=nodes,
        velocities=velocities,
        force_densities=force_densities,
        rest_lengths=lengths * (1.0 - force_densities / structure.stiffness),
        tensions=force_densities * lengths,
        multipliers=rods - 0.25 - 0.1 * np.cos(times)[:, None],
        rod_force_densities=rods - 0.1,
        kinetic_energy=zeros + 0.1,
        gravity_energy=zeros,
        string_energy=zeros,
        winch_work=1e-9 * np.sin(times),
        external_work=zeros,
        dissipation=zeros,
        feasibility_margin=zeros + 0.2,
        lyapunov=np.exp(-times),
        lyapunov_error=0.7 * np.exp(-times),
        lyapunov_velocity=0.3 * np.exp(-times),
        allocation_residual=zeros,
        engine=engine,
        cost={"wall_time": 0.5, "steps": 100},
        reports={"largest constraint drift [m]": 1.5e-13},
        provenance={"mujoco": "4.0.0", "options": {"timestep": 1e-3}},
    )
