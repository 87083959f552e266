"""Where a structure stands and starts as a whole: by closed forms, in two engines, and what the ground refuses."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import tensegrity_mj as tmj
from evidence.random_structures import random_structure
from tensegrity_mj.errors import FormatError, SceneError, TensegrityError
from tensegrity_mj.model.members import Support
from tensegrity_mj.model.motion import Motion
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.text.reading import scene_from_toml
from tensegrity_mj.model.text.writing import scene_to_toml

EPS = np.finfo(float).eps
BAR = """\
format = 1
name = "bar"

[structure]
nodes = { a = [0, 0, -0.5], b = [0, 0, 0.5] }
rods = [{ name = "bar", nodes = ["a", "b"], mass = 0.4 }]

[scene]
gravity = [0, 0, -9.81]
"""
HELD = """\
format = 1
name = "held"

[structure]
nodes = { foot = [0, 0, 0], tip = [0, 0, 1], hook = [0, 0, 3], side = [1, 0, 1] }
fixed_nodes = ["hook"]
rods = [{ name = "rod", nodes = ["foot", "tip"], mass = 1, support = { kind = "pinned" } }]
strings = [
    { name = "s", nodes = ["tip", "hook"], stiffness = 9 },
    { name = "t", nodes = ["tip", "side"], stiffness = 9 },
]
point_masses = [{ node = "side", mass = 0.5 }]

[scene]
"""

PINNED = (
    HELD.replace('fixed_nodes = ["hook"]', "")
    .replace(" hook = [0, 0, 3],", "")
    .replace('    { name = "s", nodes = ["tip", "hook"], stiffness = 9 },\n', "")
)


def with_whole(text: str, **keys: object) -> Scene:
    lines = [f"{key} = {list(value) if isinstance(value, tuple) else value}" for key, value in keys.items()]
    return scene_from_toml("\n".join([text, "[scene.whole]", *lines]), "mine.toml")


def test_a_thrown_bar_flies_as_it_must() -> None:
    """Its centre along a parabola, its direction at ω about an axis across it, in closed form."""
    whole = {"rotation": (0, 0.3, 0), "translation": (0, 0, 2), "velocity": (3, 0, 4), "angular_velocity": (0, 6, 0)}
    scene = with_whole(BAR, **whole)
    t = np.linspace(0, 0.5, 6)
    center = np.stack([3 * t, 0 * t, 2 + 4 * t - 9.81 * t**2 / 2], axis=1)
    along = np.stack([np.sin(0.3 + 6 * t), 0 * t, np.cos(0.3 + 6 * t)], axis=1)
    # RK4 at h = 1e-3: (ω h)⁵/120 of a radian a step, 500 steps of it: 3e-11; round-off is less.
    for engine in (tmj.MuJoCo(timestep=1e-3, integrator="rk4"), tmj.DAE(method="rk4", timestep=1e-3)):
        run = tmj.simulate(scene, None, engine, duration=0.5, output_interval=0.1)
        np.testing.assert_allclose(run.nodes[:, 1], center + along / 2, rtol=0, atol=1e-10)
        np.testing.assert_allclose(run.nodes[:, 0], center - along / 2, rtol=0, atol=1e-10)
        # 1/2 m v² + 1/2 (m l²/12) ω²
        assert run.kinetic_energy[0] == pytest.approx(0.5 * 0.4 * 25 + 0.5 * 0.4 / 12 * 36, rel=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_momentum_and_energy_of_the_whole_are_those_of_a_rigid_body(seed: int) -> None:
    rng = np.random.default_rng(seed)
    structure = random_structure(rng, rods=4, fixed_nodes=0, point_masses=2)
    structure = replace(structure, rods=tuple(replace(rod, support=Support.free()) for rod in structure.rods))
    v, w = rng.normal(size=3), rng.normal(size=3)
    scene = Scene(structure).moving(v, w)
    ends, rates = scene.nodes0[structure.rod_nodes], scene.velocities0[structure.rod_nodes]
    rows = [structure.node_index[point.node] for point in structure.point_masses]
    m, p = structure.rod_masses, np.array([point.mass for point in structure.point_masses])
    # A uniform rod has the moments of a sixth of its mass at each end, and two thirds in the middle (Simpson's rule).
    masses = np.concatenate([m / 6, m / 6, 2 * m / 3, p])
    places = np.concatenate([ends[:, 0], ends[:, 1], ends.mean(axis=1), scene.nodes0[rows]])
    speeds = np.concatenate([rates[:, 0], rates[:, 1], rates.mean(axis=1), scene.velocities0[rows]])
    M = masses.sum()
    c = masses @ places / M
    x = places - c
    J = sum(m * (y @ y * np.eye(3) - np.outer(y, y)) for m, y in zip(masses, x, strict=True))
    # Sums of some twenty products of numbers of order one to ten.
    np.testing.assert_allclose(masses @ speeds, M * v, atol=1e3 * EPS * M)
    np.testing.assert_allclose((masses[:, None] * np.cross(x, speeds)).sum(axis=0), J @ w, atol=1e3 * EPS * np.trace(J))
    energy = 0.5 * M * v @ v + 0.5 * w @ J @ w
    assert 0.5 * masses @ (speeds**2).sum(axis=1) == pytest.approx(energy, rel=1e-12)
    for engine in (tmj.MuJoCo(timestep=1e-4), tmj.DAE(method="rk4", timestep=1e-4)):
        run = tmj.simulate(scene, None, engine, duration=1e-4)
        assert run.kinetic_energy[0] == pytest.approx(energy, rel=1e-12)


def test_a_free_scene_moved_as_a_whole_moves_as_before_within_it() -> None:
    own = tmj.load_scene("prism_drop").with_(
        contact=None, gravity=(0, 0, 0), initial_nodes=None, initial_velocities=None
    )
    scene = own.with_(structure=own.structure.with_strings(rest_length=0.9 * own.structure.rest_lengths))
    turn, shift, velocity = (0.4, -0.2, 1.1), (1.0, -2.0, 3.0), (0.5, 0.25, -0.5)
    text = scene_to_toml(scene)
    elsewhere = with_whole(text, rotation=turn, translation=shift, velocity=velocity)
    matrix = elsewhere_matrix(turn)
    for engine in (tmj.MuJoCo(timestep=1e-3, integrator="rk4"), tmj.DAE(method="rk4", timestep=1e-3)):
        here, there = (
            tmj.simulate(one, None, engine, duration=0.3, output_interval=0.05) for one in (scene, elsewhere)
        )
        wanted = here.nodes @ matrix.T + shift + here.time[:, None, None] * np.array(velocity)
        assert np.abs(here.nodes - here.nodes[0]).max() > 0.01
        # 300 steps, each with some roundings of places up to 5 m, which vibrations do not let grow.
        np.testing.assert_allclose(there.nodes, wanted, rtol=0, atol=1e-11)
        np.testing.assert_allclose(there.tensions, here.tensions, rtol=1e-9, atol=1e-9)


def elsewhere_matrix(turn: tuple[float, float, float]) -> np.ndarray:
    """exp of the cross-product matrix, by its series."""
    x, y, z = turn
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    term, total = np.eye(3), np.eye(3)
    for k in range(1, 30):
        term = term @ K / k
        total = total + term
    return total


def test_what_stands_on_the_ground_turns_about_its_pin_alone() -> None:
    along = np.array([0, -math.sin(0.2), math.cos(0.2)])  # from the pin to the hook: both stay
    spin = {"angular_velocity": tuple((3 * along).tolist()), "center": (0, 0, 5)}
    scene = with_whole(HELD, rotation=(0.2, 0, 0), translation=(0, 0, 5), **spin)
    assert scene.structure.rods[0].support == Support.pinned()
    places = {name: scene.nodes0[row] for name, row in scene.structure.node_index.items()}
    np.testing.assert_allclose(places["tip"], along + np.array([0, 0, 5]), atol=8 * EPS)
    assert scene_from_toml(scene_to_toml(scene)) == scene


REFUSED = [
    ({"velocity": (1, 0, 0)}, SceneError,
     "whole: fixed node 'hook' has [1.0, 0.0, 0.0] m/s; it must be at rest: the ground holds it there, so that the "
     "whole cannot start with velocity = [1.0, 0.0, 0.0] and angular_velocity = [0.0, 0.0, 0.0]; give what its suppor"),
    ({"rotation": (0, 0, 90)}, SceneError,
     "scene.whole: rotation = [0.0, 0.0, 90.0]; its length is an angle in rad, of at most 2π"),
    ({"rotation": 3}, FormatError, "scene.whole: rotation = 3 (an integer); it must be three numbers [x, y, z]"),
    ({"velcity": (1, 0, 0)}, FormatError, "scene.whole: unknown key 'velcity' (did you mean 'velocity'?); allowed"),
    ({"velocity": (math.inf, 0, 0)}, SceneError, "scene.whole: velocity = [inf, 0, 0]; it must be three finite "),
]  # fmt: skip


@pytest.mark.parametrize(("keys", "error", "words"), REFUSED, ids=[str(keys) for keys, _, _ in REFUSED])
def test_what_cannot_be_is_refused(keys: dict[str, object], error: type[TensegrityError], words: str) -> None:
    with pytest.raises(error) as caught:
        with_whole(HELD, **keys)
    assert str(caught.value).startswith(f"mine.toml: {words}")
    assert len(str(caught.value)) < 500


def test_a_pin_that_would_leave_is_refused_and_a_node_on_the_axis_is_not() -> None:
    held = HELD.replace("[0, 0, 3]", "[0, 3, 3]")
    with pytest.raises(SceneError, match="whole: fixed node 'hook' has"):
        with_whole(held, angular_velocity=(0, 0, 1), center=(0, 0, 0))
    scene = with_whole(held, angular_velocity=(0, 0.1, 0.1), center=(0, 0, 0))  # the axis goes through pin and hook
    assert not scene.velocities0[scene.structure.node_index["hook"]].any()
    assert scene.velocities0[scene.structure.node_index["tip"]].tolist() == [0.1, 0.0, 0.0]
    with pytest.raises(
        SceneError, match=r"whole: rod 'rod' would leave its support at .* m/s at σ = 0.0; D ṙ must be "
    ):
        with_whole(PINNED, angular_velocity=(0, 0, 1))  # about the centre of mass


def test_the_start_of_a_file_moves_with_the_whole_and_its_target_does_not() -> None:
    text = BAR + (
        "initial_nodes = { a = [0, 0, 0.5], b = [0, 0, -0.5] }\n"
        "initial_velocities = { a = [0, 1, 0], b = [0, 1, 0] }\n"
        "target = { nodes = { a = [9, 0, 0], b = [9, 0, 1] } }\n"
    )
    scene = with_whole(text, rotation=(math.pi / 2, 0, 0), translation=(1, 0, 0), velocity=(0, 0, 5))
    np.testing.assert_allclose(scene.structure.positions, [[1, 0.5, 0], [1, -0.5, 0]], atol=EPS)
    np.testing.assert_allclose(scene.nodes0, [[1, -0.5, 0], [1, 0.5, 0]], atol=EPS)
    np.testing.assert_allclose(scene.velocities0, [[0, 0, 6], [0, 0, 6]], atol=8 * EPS)
    assert scene.target is not None
    assert scene.target.nodes[0].tolist() == [[9, 0, 0], [9, 0, 1]]


def test_the_velocity_adds_to_that_of_supports_that_move() -> None:
    scene = scene_from_toml(PINNED)
    moved = scene.with_(motions=(Motion.in_line("rod", 0.1, 1.0, (1, 0, 0)),))
    spun = moved.moving(angular_velocity=(0, 0, 2), center=(0, 0, 0))
    extra = spun.velocities0 - moved.velocities0
    np.testing.assert_allclose(extra, np.cross([0, 0, 2], scene.nodes0), atol=8 * EPS)
    assert moved.moving() is moved
