"""What a rod without forces keeps: energy, and the momenta that its support cannot change. Both engines.

A support can only exert forces in the directions D that it holds, at the rod's point r = r(0) + E z, and on a planar
rod torques across the normal. Hence what is conserved, about r(0): the momentum Eᵀ P, and the components of the
angular momentum along the directions w with w · (E_i × D_j) = 0 for all i, j (planar: w along the normal).
"""

from __future__ import annotations

import numpy as np
import pytest
from momenta import angular_momentum, linear_momentum
from numpy.typing import NDArray

import tensegrity_mj as tmj
from evidence.random_structures import random_scene, random_structure
from tensegrity_mj.model import rods
from tensegrity_mj.model.members import Support, null_space_basis
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.runs.trajectory import Trajectory

Array = NDArray[np.float64]
Engine = tmj.DAE | tmj.MuJoCo

DURATION = 5.0  # s
TOLERANCE = 1e-10  # of quantities that are of order 1 in SI units: rods of about 1 kg and 1 m, at some m/s

ENGINES = [
    # RK4 loses (ω h)⁵ / 120 of the amplitude a step. A rod on a slide turns unevenly: 2 ω = 6 rad/s, which with 10,000
    # steps of 5e-4 s is 2e-11.
    pytest.param(tmj.MuJoCo(timestep=5e-4), id="mujoco"),
    # 1e-13 a step, and some hundred steps.
    pytest.param(tmj.DAE(rtol=1e-13, atol=1e-14), id="dae"),
]
SIGMAS = [0.0, 0.3, 0.5, 1.0]
LENGTH = 1.2  # m
NORMAL = (0.6, 0.0, 0.8)
IN_PLANE = (0.8, 0.5, -0.6)  # across the normal
SUPPORTS = {
    "free": lambda sigma: Support.free(sigma),
    "pinned": lambda sigma: Support.pinned(sigma),
    "on a plane": lambda sigma: Support.constrained([(1.0, -2.0, 0.5)], sigma),
    "along a line": lambda sigma: Support.constrained([(1.0, -2.0, 0.5), (0.3, 0.4, 2.0)], sigma),
    "planar free": lambda sigma: Support.free(sigma, NORMAL),
    "planar pinned": lambda sigma: Support.pinned(sigma, NORMAL),
    "planar along a line": lambda sigma: Support.constrained([IN_PLANE], sigma, plane=NORMAL),
}


def conserved(scene: Scene, run: Trajectory) -> dict[str, Array]:
    """Everything that must stand still, (T, ...) each."""
    structure = scene.structure
    support = structure.rods[0].support
    E, D = support.translation_basis, support.constraint_rows
    (first,), (second,) = rods.ends(structure, scene.nodes0)
    r = (1 - support.sigma) * first + support.sigma * second
    broken = [np.cross(e, d) for e in E.T for d in D]
    if support.plane is not None:
        broken += list(support.rotation_basis.T)
    kept = null_space_basis(np.array([row for row in broken if np.linalg.norm(row) > 1e-12]).reshape(-1, 3))
    return {
        "energy": run.kinetic_energy,
        "momentum": linear_momentum(structure, run.velocities) @ E,
        "angular momentum": angular_momentum(structure, run.nodes - r, run.velocities) @ kept,
    }


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("sigma", SIGMAS)
@pytest.mark.parametrize("support", SUPPORTS)
def test_a_rod_without_forces_keeps_energy_and_momenta(engine: Engine, support: str, sigma: float) -> None:
    held = SUPPORTS[support](sigma)
    b = np.array([0.64, 0.6, -0.48])  # across NORMAL
    turning = np.array([1.1, -0.7, 1.6] if held.plane is None else NORMAL) * 1.5  # rad/s
    r, r_rate = np.array([0.1, -0.2, 0.3]), held.translation_basis @ held.translation_basis.T @ [0.4, 0.9, -0.3]
    arms = LENGTH * np.array([-sigma, 1 - sigma])[:, None]
    structure = Structure.from_arrays(r + arms * b, [(0, 1)], [], rod_mass=1.3, stiffness=[], supports=[held])
    scene = Scene(structure, initial_velocities=r_rate + arms * np.cross(turning, b))
    run = tmj.simulate(scene, None, engine, duration=DURATION, output_interval=0.1)
    assert np.abs(run.nodes - run.nodes[0]).max() > 0.5, "a rod at rest would prove nothing"
    drifts = {name: np.abs(values - values[0]).max(initial=0.0) for name, values in conserved(scene, run).items()}
    print(f"{run.engine}, {support}, σ = {sigma}: " + ", ".join(f"{key} {drift:.1e}" for key, drift in drifts.items()))
    assert max(drifts.values()) <= TOLERANCE


@pytest.mark.parametrize("engine", [tmj.MuJoCo(timestep=1e-4), tmj.DAE(rtol=1e-12, atol=1e-13)], ids=["mujoco", "dae"])
@pytest.mark.parametrize("seed", range(3))
def test_strings_change_no_momentum(engine: Engine, seed: int) -> None:
    """Free rods and point masses with damped strings, slack ones among them: what they take here they give there."""
    rng = np.random.default_rng(seed)
    structure = random_structure(
        rng, rods=4, support="free", strings=12, fixed_nodes=0, point_masses=2, stretch=(-0.1, 0.5), damping=(0.1, 1.0)
    )
    scene = random_scene(rng, structure, moving=1.0)
    run = tmj.simulate(scene, None, engine, duration=0.5)
    assert np.any(run.tensions == 0)
    linear = linear_momentum(structure, run.velocities)
    angular = angular_momentum(structure, run.nodes, run.velocities)
    drifts = [float(np.abs(values - values[0]).max()) for values in (linear, angular)]
    print(f"{run.engine}: momentum {drifts[0]:.1e}, angular momentum {drifts[1]:.1e}")
    assert max(drifts) <= TOLERANCE
