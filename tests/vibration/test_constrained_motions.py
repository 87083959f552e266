"""Linear constraints in linear models, in modes and in statics, against closed forms and the engines' accelerations."""

from dataclasses import replace

import numpy as np
import pytest
from constraint_scenes import G, ladder, trammel
from linked_scenes import hung

import tensegrity_mj as tmj
from tensegrity_mj.linearization.linearizing import Request, native_law
from tensegrity_mj.model import Constraint
from tensegrity_mj.model.motion import Harmonic
from tensegrity_mj.statics.equilibrium import find_equilibrium
from tensegrity_mj.vibration.small_motions import vibration

AT, LENGTH = 0.3, 1.5
# About its rest on the axis a trammel turns by θ̈ = -g θ/(2 ℓ ((1/2 - σ)² + 1/12)), see its I(θ) at θ = 0.
SQUARE = G / (2 * LENGTH * ((0.5 - AT) ** 2 + 1 / 12))


def at_rest():
    return trammel(AT, LENGTH, 0.0).with_(gravity=(0.0, 0.0, G))


@pytest.mark.parametrize("engine", [tmj.MuJoCo(), tmj.DAE()], ids=["mujoco", "dae"])
def test_a_linear_model_has_the_freedom_that_is_left(engine) -> None:
    found = tmj.linearize(at_rest(), engine)
    np.testing.assert_allclose(found.A, [[0, 1], [-SQUARE, 0]], atol=1e-9 * SQUARE)  # six central differences
    np.testing.assert_allclose(found.residual, 0, atol=1e-12)


def test_small_motions_have_the_same_mode_and_step() -> None:
    scene = at_rest()
    model = vibration(scene, scene.nodes0, scene.velocities0, np.zeros(0))
    values = np.linalg.eigvalsh(model.material + model.geometric)
    np.testing.assert_allclose(values, [0, 0, 0, 0, SQUARE], atol=1e-13 * SQUARE)
    # The classical Runge-Kutta method is stable up to ω h = 2 √2.
    assert tmj.stable_step(scene, tmj.MuJoCo()).limit == pytest.approx(np.sqrt(8 / SQUARE), rel=1e-9)


def test_accelerations_of_small_motions_are_the_engines() -> None:
    """Of rods that hang together, on strings, at rest, with a row that begins to move."""
    rail, quarter = Constraint("rail", {"n3": 0.7, "n5": 0.5}, (0.2, 0.1, 1.0)), np.pi / 2
    pushed = (Harmonic((0, 0, 0.05), 8.0, quarter), Harmonic((0, 0, -0.05), 0.0, quarter))
    scene = hung()
    structure = replace(scene.structure, constraints=(rail,))
    scene = scene.with_(structure=structure, motions=(tmj.model.Motion("rail", pushed),))
    model = vibration(scene, scene.nodes0, scene.velocities0, structure.rest_lengths)
    request = Request(scene, native_law(None, structure))
    for engine in (tmj.MuJoCo(), tmj.DAE()):
        found = engine.accelerations(request)(0.0, scene.nodes0, scene.velocities0)[1]
        # Round-off of a solution of 30 equations: 1e3 units in the last place of the largest, 37 m/s².
        np.testing.assert_allclose(model.motion(model.acceleration), found, atol=1e-11)


def test_an_equilibrium_keeps_them() -> None:
    """A string holds the foot of a ladder with T = m g tan φ/2: of stiffness k it is L = L0 + T/k long."""
    scene, k = ladder(), 200.0
    structure = replace(
        scene.structure,
        nodes={**scene.structure.nodes, "corner": (0.0, 0.0, 0.0)},
        fixed_nodes=("corner",),
        strings=(tmj.String("s", ("corner", "foot"), k, rest_length=0.7),),
    )
    found = find_equilibrium(tmj.Scene(structure, gravity=scene.gravity))
    foot, head = (found.nodes[structure.node_index[name]] for name in ("foot", "head"))
    assert abs(head[0]) < 1e-12
    # The residual of the equilibrium is 1e-12 of its forces or less, its stiffness 200 N/m.
    assert k * (foot[0] - 0.7) == pytest.approx(3.0 * G * foot[0] / head[2] / 2, rel=1e-9)


def test_the_shipped_ladder_swings_as_its_energy_says() -> None:
    """V'' = -m g ℓ cos φ/2 + k ℓ² cos² φ - T ℓ sin φ of V = m g ℓ cos φ/2 + k (ℓ sin φ - L0)²/2, over m ℓ²/3."""
    scene = tmj.load_scene("ladder")
    mass, k, tension = 8.0, 100.0, 13.08
    stiffness = -mass * G * 3.0 / 2 + k * 9.0 - tension * 1.0
    damping, inertia = 1.0 * 9.0, mass * 10.0 / 3
    found = tmj.linearize(scene, tmj.MuJoCo(), velocities=np.zeros((3, 3))).A
    # δ̈ = -(K δ + C δ̇)/I for any coordinate of one freedom.
    np.testing.assert_allclose(found[1], [-stiffness / inertia, -damping / inertia], rtol=1e-8)
    run = tmj.simulate(scene, None, tmj.MuJoCo(timestep=1e-3), output_interval=0.1)
    assert run.constraint_forces.min() > 0  # the wall pushes all the time
    assert run.tensions.min() > 0
