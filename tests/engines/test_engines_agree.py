"""The two engines on random class 1 structures: every support, planar ones, point masses, gravity, loads, damping,
slack strings, both string laws.

They share no equation of motion: the DAE integrates (2.45)-(2.49) in q = (r, b), MuJoCo joint coordinates of bodies
whose mass, centre and inertia are written in the MJCF.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from engine_accelerations import dae_accelerations, mujoco_accelerations
from numpy.typing import NDArray
from random_states import SUPPORTS, random_state

import tensegrity_mj as tmj
from evidence.random_structures import random_scene, random_structure
from tensegrity_mj.model import rods
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.strings import StringLaw

Array = NDArray[np.float64]

REFERENCE = tmj.DAE(rtol=1e-13, atol=1e-14)
DURATION = 0.4  # s
INTERVAL = 0.01
FASTEST_TURN = 15.0  # rad/s
LAWS = list(StringLaw)


def run(scene: Scene, engine: tmj.DAE | tmj.MuJoCo) -> tmj.Trajectory:
    return tmj.simulate(scene, None, engine, duration=DURATION, output_interval=INTERVAL)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("planar", [False, True], ids=["space", "plane"])
@pytest.mark.parametrize("seed", range(12))
def test_accelerations_are_equal_at_random_states(seed: int, planar: bool, law: StringLaw) -> None:
    scene = random_state(seed, planar, law)
    dae, mujoco = dae_accelerations(scene), mujoco_accelerations(scene)
    scale = max(1.0, float(np.abs(dae).max()))
    error = float(np.abs(dae - mujoco).max())
    print(f"accelerations: {error / scale:.1e} of {scale:.1e} m/s²")
    # Inertias of rods of about 1 kg and 1 m have condition numbers below 1e3, MuJoCo's with the axial one below 1e6:
    # 1e6 times the machine precision of 2e-16.
    assert error <= 1e-10 * scale


def taut_scene(rng: np.random.Generator, support: str, planar: bool) -> tuple[Scene, tmj.Trajectory]:
    """A random experiment whose motion is smooth: no string slackens, no rod spins; and its reference run."""
    for _ in range(200):
        damped = bool(rng.integers(2))
        structure = random_structure(
            rng,
            rods=int(rng.integers(1, 5)),
            support=support,
            planar=planar,
            own_planes=0.3,
            point_masses=int(rng.integers(3)),
            stretch=(0.6, 0.9),
            stiffness=(3.0, 10.0),
            damping=(0.05, 0.3) if damped else (0.0, 0.0),
            law=LAWS[int(rng.integers(2))],
        )
        scene = random_scene(rng, structure, displaced=0.1, moving=0.5, gravity=True, loads=2)
        reference = run(scene, REFERENCE)
        # 0.5 N: between two samples no string of at most 10 N/m shortens by the 0.05 m that it would take. And none
        # becomes so short that its direction turns within a step.
        taut = np.all(reference.tensions > 0.5) and np.all(structure.string_lengths(reference.nodes) > 0.3)
        first, second = rods.ends(structure, reference.velocities)
        if taut and np.all(np.linalg.norm(second - first, axis=-1) <= FASTEST_TURN * structure.rod_lengths):
            return scene, reference
    raise AssertionError("no taut motion found")


@pytest.mark.parametrize("planar", [False, True], ids=["space", "plane"])
@pytest.mark.parametrize("support", SUPPORTS)
@pytest.mark.parametrize("seed", range(2))
def test_taut_motions_agree_and_the_difference_falls_with_order_four(seed: int, support: str, planar: bool) -> None:
    rng = np.random.default_rng([seed, SUPPORTS.index(support), planar])
    scene, reference = taut_scene(rng, support, planar)
    steps = (5e-3, 2.5e-3, 1.25e-3, 6.25e-4)
    runs = [run(scene, tmj.MuJoCo(timestep=h)) for h in steps]
    errors = [tmj.compare(each, reference).max_node_error for each in runs]
    orders = [float(np.log2(a / b)) for a, b in pairwise(errors) if b > 1e-11]
    listed = ", ".join(f"{h:g} s {e:.1e} m" for h, e in zip(steps, errors, strict=True))
    print(f"{support}: {listed}; orders {np.round(orders, 2)}")
    # The next term of the error is h ω times the leading one, 0.075 at the coarsest step and half of it at the next:
    # 0.0375 / ln 2 = 0.05 in the order; twice that for what is faster than a rod's turn.
    assert orders == pytest.approx([4.0] * len(orders), abs=0.1)
    # (ω h)⁴ ω T / 120 · 1 m at h = 6.25e-4 s is 4e-10 m.
    finest = tmj.compare(runs[-1], reference)
    assert finest.max_node_error <= 1e-9
    # As many times more as ω = 15 /s, k = 10 N/m, m ω² = 450 N/m, and 30 N for the terms of the energy.
    assert finest.max_velocity_error <= 1.5e-8
    assert finest.max_tension_error <= 1e-8
    assert finest.max_rod_force_error <= 4.5e-7
    for name in ("external_work", "dissipation", "kinetic_energy", "gravity_energy", "string_energy"):
        assert np.abs(getattr(runs[-1], name) - getattr(reference, name)).max() <= 3e-8, name
    # The ledgers close by themselves: nothing is lost beside what is booked.
    assert max(reference.energy_residual, runs[-1].energy_residual) <= 3e-8


@pytest.mark.parametrize(
    ("law", "damping", "lowest", "highest"),
    [
        (StringLaw.CLIPPED, (0.0, 0.0), 2, 2),
        (StringLaw.UNCLIPPED, (0.0, 0.0), 2, 2),
        (StringLaw.UNCLIPPED, (0.5, 3.0), 1, 1),
        (StringLaw.CLIPPED, (0.5, 3.0), 1, 2),  # clipped, the force is continuous where a string slackens
    ],
)
def test_slack_strings_cost_the_order_that_their_kink_or_jump_explains(
    law: StringLaw, damping: tuple[float, float], lowest: int, highest: int
) -> None:
    """A step in which a string slackens: a kink of the force (k dL/dt) makes it O(h²), a jump (c dL/dt) O(h).

    What it costs depends on where in the step it happens, so only the mean over many structures shows the order.
    """
    steps = (5e-3, 1.25e-3, 3.125e-4)
    errors, slackenings = [], 0
    for seed in range(10):
        rng = np.random.default_rng(seed)
        structure = random_structure(
            rng,
            rods=1 + seed % 4,
            planar=seed % 3 == 0,
            own_planes=0.3,
            point_masses=seed % 3,
            stretch=(-0.2, 0.3),
            damping=damping,
            law=law,
        )
        scene = random_scene(rng, structure, displaced=0.2, moving=1.5, gravity=True, loads=2)
        reference = run(scene, REFERENCE)
        slack = reference.tensions == 0
        slackenings += int(np.sum(slack[1:] & ~slack[:-1]))
        errors.append([tmj.compare(run(scene, tmj.MuJoCo(timestep=h)), reference).max_node_error for h in steps])
    assert slackenings >= 10, "strings that never slacken prove nothing"
    means = np.exp(np.mean(np.log(errors), axis=0))
    found = -float(np.polyfit(np.log(1 / np.array(steps)), np.log(means), 1)[0])
    print(f"{law.value}, damping {damping}: mean errors {means} m, order {found:.2f}, {slackenings} slackenings")
    # Errors that scatter by a factor of 3 have a mean over ten that scatters by 3^(1/√10) = 1.4. At both ends of a
    # range of 16 in h that is ln 1.4² / ln 16 = 0.25 in the order.
    assert lowest - 0.3 <= found <= highest + 0.3
