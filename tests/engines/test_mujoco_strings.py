"""MuJoCo's tendon actuator and the engine's callback express the one string law, point by point."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

import tensegrity_mj as tmj
from tensegrity_mj import Command, Integrator
from tensegrity_mj.model import StringLaw, strings
from tensegrity_mj.model.members import PointMass, String
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure

Array = NDArray[np.float64]
COUNT = 300
EPS = np.finfo(float).eps


class RestLengths:
    """A law that sets given rest lengths, whatever the state."""

    command = Command.REST_LENGTH

    def __init__(self, values: Array) -> None:
        self.values = values

    def __call__(self, time: float, nodes: Array, velocities: Array) -> Array:
        return self.values


def random_strings(rng: np.random.Generator, law: StringLaw, damped: bool) -> tuple[Scene, Array]:
    """A fixed node with many strings to a moving point mass each, and a rest length [m] for every string."""
    directions = rng.normal(size=(COUNT, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    lengths = 10 ** rng.uniform(-2, 2, COUNT)
    positions = directions * lengths[:, None]
    # From creeping to faster than a string's length a millisecond, either way, and across.
    speeds = rng.choice([-1.0, 1.0], COUNT) * lengths * 10 ** rng.uniform(-3, 3, COUNT)
    velocities = directions * speeds[:, None] + rng.normal(size=(COUNT, 3))
    stiffness, damping = 10 ** rng.uniform(-1, 6, COUNT), 10 ** rng.uniform(-3, 3, COUNT)
    # A third each: slack, taut, and taut with a rest length that is zero or negative.
    kind = rng.permutation(np.arange(COUNT) % 3)
    rest = lengths * np.choose(kind, [rng.uniform(1, 3, COUNT), rng.uniform(0, 1, COUNT), rng.uniform(-3, 0, COUNT)])
    rest[kind == 2] *= rng.integers(0, 4, COUNT)[kind == 2] > 0  # exact zeros among them
    structure = Structure(
        "fan",
        {"o": (0.0, 0.0, 0.0), **{f"p{i}": tuple(x.tolist()) for i, x in enumerate(positions)}},
        strings=tuple(
            # Designed with another rest length than the one that will be set.
            String(f"s{i}", ("o", f"p{i}"), k, c if damped else 0.0, rest_length=float(designed))
            for i, (k, c, designed) in enumerate(
                zip(stiffness.tolist(), damping.tolist(), lengths * rng.uniform(0.1, 2, COUNT), strict=True)
            )
        ),
        fixed_nodes=("o",),
        point_masses=tuple(PointMass(f"p{i}", 10 ** float(rng.uniform(-1, 1))) for i in range(COUNT)),
        string_law=law,
    )
    return Scene(structure, initial_velocities=np.vstack([np.zeros(3), velocities])), rest


def expected(structure: Structure, nodes: Array, velocities: Array, rest: Array) -> tuple[Array, Array]:
    """Tensions by the law of `strings`, and what round-off may make of them."""
    k, c = structure.stiffness, structure.damping
    lengths, rates = structure.string_lengths(nodes), structure.string_rates(nodes, velocities)
    tensions = strings.tension(k, c, lengths, rates, rest, structure.string_law)
    # MuJoCo adds k (L0 - D), with D the designed rest length, to k D - k L - c dL/dt: four products and five sums,
    # each with a rounding of eps / 2 of a number not above k (|L0| + 2 |D| + L) + c |v|. L itself carries three
    # roundings more, and dL/dt, a scalar product of components up to |v|, about six of c |v|.
    speed = np.linalg.norm(velocities[1:], axis=1)
    scale = k * (np.abs(rest) + 2 * np.abs(structure.rest_lengths) + lengths) + c * speed
    return tensions, 8 * EPS * scale


@pytest.fixture(params=[(law, damped) for law in StringLaw for damped in (False, True)], ids=str)
def fan(request: pytest.FixtureRequest) -> tuple[Scene, Array]:
    law, damped = request.param
    return random_strings(np.random.default_rng([list(StringLaw).index(law), damped]), law, damped)


def test_the_draw_holds_every_branch_of_the_law(fan: tuple[Scene, Array]) -> None:
    scene, rest = fan
    structure = scene.structure
    lengths, rates = structure.string_lengths(scene.nodes0), structure.string_rates(scene.nodes0, scene.velocities0)
    slack, pushed = lengths <= rest, structure.stiffness * (lengths - rest) + structure.damping * rates < 0
    damped = bool(structure.damping.any())
    for branch in (slack & (rates > 0), slack & (rates < 0), ~slack & ~pushed, rest == 0, rest < 0):
        assert branch.sum() > 10
    assert ((~slack & pushed).sum() > 10) == damped  # the damper of a taut string that shortens fast
    assert ((slack & ~pushed).sum() > 10) == damped  # the damper of a slack string that opens fast


@pytest.mark.parametrize("integrator", [Integrator.EULER, Integrator.RK4, Integrator.DISCRETE])
def test_tensions_are_those_of_the_law(fan: tuple[Scene, Array], integrator: Integrator) -> None:
    (scene, rest), step = fan, 1e-9
    run = tmj.simulate(scene, RestLengths(rest), tmj.MuJoCo(step, integrator), duration=step)
    tensions, tolerance = expected(scene.structure, run.nodes[0], run.velocities[0], rest)
    np.testing.assert_array_equal(run.rest_lengths[0], rest)
    assert np.all(np.abs(run.tensions[0] - tensions) <= tolerance)
    slack = scene.structure.string_lengths(run.nodes[0]) <= rest
    assert not run.tensions[0, slack].any()  # exactly


def test_tensions_are_what_moves_the_masses(fan: tuple[Scene, Array]) -> None:
    (scene, rest), step = fan, 1e-6
    run = tmj.simulate(scene, RestLengths(rest), tmj.MuJoCo(step, Integrator.EULER), duration=step)
    tensions, tolerance = expected(scene.structure, run.nodes[0], run.velocities[0], rest)
    masses = np.array([point.mass for point in scene.structure.point_masses])
    start = run.nodes[0, 1:] - run.nodes[0, 0]
    pull = -start * (tensions / np.linalg.norm(start, axis=1))[:, None]
    found = (run.velocities[1, 1:] - run.velocities[0, 1:]) * (masses / step)[:, None]
    # The difference of two velocities, each with a rounding or two of its own size, and a few of the force.
    speed = np.abs(run.velocities[:, 1:]).max(axis=(0, 2))
    tolerance += 8 * EPS * (masses * speed / step + np.abs(tensions))
    assert np.all(np.abs(found - pull) <= tolerance[:, None])


def test_without_the_callback_the_model_has_the_law_but_for_slack_dampers(fan: tuple[Scene, Array]) -> None:
    scene, rest = fan
    structure = scene.structure
    model = tmj.MuJoCo().model(scene)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    data.ctrl[:] = rest - structure.rest_lengths
    mujoco.mj_forward(model, data)
    tensions, tolerance = expected(structure, scene.nodes0, scene.velocities0, rest)
    same = (structure.damping == 0) | (structure.string_lengths(scene.nodes0) > rest)
    assert same.sum() > COUNT / 2
    assert np.all(np.abs(-data.actuator_force - tensions)[same] <= tolerance[same])


@pytest.mark.parametrize("law", StringLaw)
def test_every_row_of_a_long_run_obeys_the_law(law: StringLaw) -> None:
    # Two masses on one damped string, thrown at each other, so that it goes slack and is caught, again and again.
    structure = Structure(
        "pair",
        {"a": (0.0, 0.0, 0.0), "b": (1.0, 0.3, 0.2)},
        strings=(String("s", ("a", "b"), 80.0, 0.4, rest_length=1.0),),
        point_masses=(PointMass("a", 1.0), PointMass("b", 0.5)),
        string_law=law,
    )
    scene = Scene(structure, initial_velocities=np.array([[1.0, 0.0, 0.0], [-2.0, 0.1, 0.0]]))
    run = tmj.simulate(scene, None, tmj.MuJoCo(1e-3), duration=4.0, output_interval=1e-3)
    lengths, rates = structure.string_lengths(run.nodes), structure.string_rates(run.nodes, run.velocities)
    assert 100 < np.sum(lengths <= 1.0) < len(run.time) - 100
    tensions = strings.tension(80.0, 0.4, lengths, rates, 1.0, law)
    # As in `expected`, of numbers below k (|L0| + 2 |D| + L) = 80 (3 + 5) and c |v| = 0.4 · 10.
    assert np.max(np.abs(run.tensions - tensions)) <= 8 * EPS * (80 * 8 + 0.4 * 10)


@pytest.mark.parametrize("law", StringLaw)
@pytest.mark.parametrize("integrator", Integrator)
def test_a_slack_string_does_not_hinder_whatever_the_integrator(integrator: Integrator, law: StringLaw) -> None:
    # Integrators that are implicit in springs and dampers must not count those of a slack string.
    structure = Structure(
        "leash",
        {"hook": (0.0, 0.0, 0.0), "m": (0.0, 0.0, -1.0)},
        strings=(String("s", ("hook", "m"), 100.0, 50.0, rest_length=5.0),),
        fixed_nodes=("hook",),
        point_masses=(PointMass("m", 1.0),),
        string_law=law,
    )
    run = tmj.simulate(Scene(structure, gravity=(0.0, 0.0, -2.0)), None, tmj.MuJoCo(0.01, integrator), duration=1.0)
    # 100 sums of -0.02 m/s, each with a rounding of a number below 2.
    assert abs(run.velocities[-1, 1, 2] + 2.0) <= 100 * 2 * EPS
    assert not run.tensions.any()
