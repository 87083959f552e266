"""What a rod without forces keeps: energy, and the momenta that its support cannot change. Both engines.

A support can only exert forces in the directions D that it holds, at the rod's point r = r(0) + E z, and on a planar
rod torques across the normal. Hence what is conserved, about r(0): the momentum Eᵀ P, and the components of the
angular momentum along the directions w with w · (E_i × D_j) = 0 for all i, j (planar: w along the normal).
"""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from random_structures import random_scene, random_structure

import tensegrity_mj as tmj
from tensegrity_mj import rods
from tensegrity_mj.scene import Scene
from tensegrity_mj.structure import null_space_basis
from tensegrity_mj.trajectory import Trajectory

Array = NDArray[np.float64]

DURATION = 10.0  # s
TOLERANCE = 1e-10  # of quantities that are of order 1 in SI units: rods of about 1 kg and 1 m, at about 1 m/s

ENGINES = [
    # Errors accumulate over about 10 radians. RK4: (ω h)⁴ / 120 a radian, 1e-10 / 120 · 10 for ω = 3 rad/s, h = 1e-3.
    pytest.param(tmj.MuJoCo(timestep=1e-3), id="mujoco"),
    # A tolerance a step of 1e-13, a few hundred steps.
    pytest.param(tmj.DAE(rtol=1e-13, atol=1e-14), id="dae"),
]
SUPPORTS = ["free", "pinned", "constrained"]


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
        "momentum": rods.linear_momentum(structure, run.velocities) @ E,
        "angular momentum": rods.angular_momentum(structure, run.nodes - r, run.velocities) @ kept,
    }


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("sigma", [0.0, 0.3, 0.5, 1.0])
@pytest.mark.parametrize("planar", [False, True], ids=["space", "plane"])
@pytest.mark.parametrize("support", SUPPORTS)
def test_a_rod_without_forces_keeps_energy_and_momenta(
    engine: tmj.MuJoCo | tmj.DAE, support: str, planar: bool, sigma: float
) -> None:
    rng = np.random.default_rng([SUPPORTS.index(support), planar, int(10 * sigma)])
    structure = random_structure(
        rng, rods=1, support=support, planar=planar, sigma=sigma, strings=0, fixed_nodes=0
    )
    scene = random_scene(rng, structure, moving=1.5)
    run = tmj.simulate(scene, None, engine, duration=DURATION, output_interval=0.1)
    moved = np.abs(run.nodes - run.nodes[0]).max()
    assert moved > 0.5, "a rod at rest would prove nothing"
    for name, values in conserved(scene, run).items():
        drift = np.abs(values - values[0]).max(initial=0.0)
        print(f"{run.engine}, {support}, σ = {sigma}: {name} drifts by {drift:.1e}")
        assert drift <= TOLERANCE, name
