"""Linear constraints on nodes: a ladder, a slope, a trammel and a moving wall against closed forms, in both engines."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from constraint_scenes import G, incline, ladder, moving_wall, trammel
from scipy.integrate import solve_ivp

import tensegrity_mj as tmj
from tensegrity_mj.errors import OptionError, StructureError
from tensegrity_mj.model import Constraint, Scene, Support

ENGINES: dict[str, Callable[[float], tmj.MuJoCo | tmj.DAE]] = {
    "mujoco": lambda step: tmj.MuJoCo(timestep=step),
    "dae": lambda step: tmj.DAE(method=tmj.Method.RK4, timestep=step),
}
STEP = 2e-3
# RK4 at this step turns by ω h = 0.02 or less in the scenes here (ω < 10 /s, all angles over 0.5 s): a step's error is
# (ω h)⁵/120 of the lengths of 2 m, 250 of them 1.3e-9 m at the most.
TOLERANCE = 2e-9
A, F = 0.1, 2 * np.pi * 0.8  # of the moving wall


def wall(t):
    """(3, ...) place, speed and acceleration of the wall."""
    return np.array([A * np.sin(F * t), A * F * np.cos(F * t), -A * F * F * np.sin(F * t)])


def solved(rates, start, time):
    """States (T, n) of an ordinary differential equation, to 1e-12."""
    found = solve_ivp(rates, (0.0, time[-1]), start, "DOP853", time, rtol=1e-13, atol=1e-14)
    return found.y.T


def ladder_truth(time, moving: bool):
    """Nodes (T, 2, 3) of the ladder, and the wall's force (T,), by φ̈ = 3/(2 ℓ) (g sin φ - ẅ cos φ).

    With the foot at (w + ℓ sin φ, 0) and the head at (w, ℓ cos φ), T + V = m ℓ² φ̇²/6 + m ẇ (ẇ + ℓ cos φ φ̇)/2
    + m g ℓ cos φ/2 gives it. The wall's force is all that pushes the middle along x: m (ẅ + ℓ/2 (cos φ φ̈ - sin φ φ̇²)).
    """
    length, mass, phi, on = 2.0, 3.0, 0.4, float(moving)

    def rates(t, y):
        return [y[1], 1.5 / length * (G * np.sin(y[0]) - on * wall(t)[2] * np.cos(y[0]))]

    angle, rate = solved(rates, [phi, -1.5 * on * wall(0.0)[1] * np.cos(phi) / length], time).T
    w, _, w2 = on * wall(time)
    second = 1.5 / length * (G * np.sin(angle) - w2 * np.cos(angle))
    force = mass * (w2 + length / 2 * (np.cos(angle) * second - np.sin(angle) * rate**2))
    none = 0.0 * w
    foot, head = (w + length * np.sin(angle), none, none), (w, none, length * np.cos(angle))
    return np.stack([np.stack(foot, 1), np.stack(head, 1)], 1), force


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("moving", [False, True], ids=["still", "moving"])
def test_a_ladder_slides_down_a_wall(engine: str, moving: bool) -> None:
    run = tmj.simulate(
        moving_wall(A, 0.8) if moving else ladder(duration=0.9), None, ENGINES[engine](STEP), output_interval=0.01
    )
    nodes, force = ladder_truth(run.time, moving)
    assert np.abs(run.nodes - nodes).max() < TOLERANCE
    # Forces of m a: errors of place of 1e-9 m, times ω² m of 300 N/m.
    assert np.abs(run.constraint_forces[:, 0] - force).max() < 300 * TOLERANCE
    if not moving:  # cos φ = 2/3 cos φ₀ is where the wall begins to pull
        place = np.flatnonzero(np.diff(np.sign(run.constraint_forces[:, 0])))[-1]
        heights = 2 * np.cos(0.4) * 2 / 3 - run.nodes[place : place + 2, 1, 2]
        assert heights[0] < 0 < heights[1]
    # 4 m ω h⁴ of the energy that turns into motion: 16 times less at half the step.
    assert run.energy_residual < 1e-8


@pytest.mark.parametrize("engine", ENGINES)
def test_the_error_is_of_fourth_order(engine: str) -> None:
    errors = []
    for step in (2e-2, 1e-2):
        run = tmj.simulate(moving_wall(A, 0.8), None, ENGINES[engine](step), output_interval=0.1)
        errors.append((np.abs(run.nodes - ladder_truth(run.time, True)[0]).max(), run.energy_residual))
    (coarse, work), (fine, less) = errors
    assert 2**3.5 < coarse / fine < 2**5.5  # of order 4, or 5 where the leading terms are small
    assert 2**3.5 < work / less < 2**5.5


@pytest.mark.parametrize("engine", ENGINES)
def test_a_mass_slides_down_a_line_in_space(engine: str) -> None:
    """s = ½ g sin α t²: RK4 is exact but for round-off, some hundred steps of it."""
    scene, slope = incline(0.5), 0.5
    run = tmj.simulate(scene, None, ENGINES[engine](STEP), output_interval=0.1)
    down = np.outer(0.5 * G * np.sin(slope) * run.time**2, [np.cos(slope), 0, -np.sin(slope)])
    assert np.abs(run.nodes[:, 0] - scene.nodes0[0] - down).max() < 1e-13
    # Of the weight the plane takes m g cos α, the rail nothing.
    np.testing.assert_allclose(run.constraint_forces, np.outer(np.ones(6), [0.7 * G * np.cos(slope), 0]), atol=1e-9)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_trammel_draws_an_ellipse(engine: str) -> None:
    """I θ̈ + ½ I' θ̇² = m g ℓ sin θ/2 with I = m ℓ² [(½ - σ)² cos² θ + ¼ sin² θ + 1/12] of its angle θ to the z axis."""
    at, length = 0.3, 1.5
    run = tmj.simulate(trammel(at, length), None, ENGINES[engine](STEP), output_interval=0.01)

    def rates(t, y):
        sine, cosine = np.sin(y[0]), np.cos(y[0])
        inertia = (0.5 - at) ** 2 * cosine**2 + 0.25 * sine**2 + 1 / 12
        slope = 2 * sine * cosine * (0.25 - (0.5 - at) ** 2)
        return [y[1], (G * sine / (2 * length) - 0.5 * slope * y[1] ** 2) / inertia]

    angle = solved(rates, [0.7, 0.0], run.time)[:, 0]
    x, z = (1 - at) * length * np.sin(angle), length * np.cos(angle)
    assert np.abs(run.nodes[:, 1] - np.stack([x, 0 * x, z], 1)).max() < TOLERANCE
    ellipse = (run.nodes[:, 1, 0] / ((1 - at) * length)) ** 2 + (run.nodes[:, 1, 2] / length) ** 2
    assert np.abs(ellipse - 1).max() < TOLERANCE


@pytest.mark.parametrize("engine", ENGINES)
def test_gaps_do_not_grow(engine: str) -> None:
    """A swinging trammel of some periods: rows keep their values to the error of a few steps, (ω h)⁵/120 of 1.5 m."""
    scene = trammel(0.3).with_(gravity=(0.0, 0.0, G))
    run = tmj.simulate(scene, None, ENGINES[engine](5e-3), duration=10.0, output_interval=0.05)
    off = run.nodes.reshape(len(run.time), -1) @ scene.structure.constraint_rows.T
    assert np.abs(off).max() < 1e-9  # ω of 4 /s: 4e-11 m a step
    assert run.energy_residual < 1e-6


def test_euler_keeps_them_at_its_order() -> None:
    errors = []
    for step in (2e-3, 1e-3):
        run = tmj.simulate(moving_wall(A, 0.8), None, tmj.MuJoCo(timestep=step, integrator=tmj.Integrator.EULER))
        errors.append((np.abs(run.nodes - ladder_truth(run.time, True)[0]).max(), run.energy_residual))
    (coarse, work), (fine, less) = errors
    assert 1.7 < coarse / fine < 2.4
    assert 1.7 < work / less < 2.4


def test_a_row_that_a_support_implies_changes_nothing() -> None:
    """The foot's height is its support's already: the row gets no force in MuJoCo, and no place in the DAE."""
    scene = ladder()
    level = Constraint("level", {"foot": 1.0}, (0, 0, 1))
    twice = scene.with_(structure=replace(scene.structure, constraints=(*scene.structure.constraints, level)))
    for make in ENGINES.values():
        one, other = (tmj.simulate(each, None, make(STEP), output_interval=0.1) for each in (scene, twice))
        assert np.abs(one.nodes - other.nodes).max() < 1e-12
        np.testing.assert_allclose(one.constraint_forces[:, 0], other.constraint_forces[:, 0], atol=1e-8)


def test_a_rod_that_rows_hold_at_both_ends_stands_still() -> None:
    """Clamped: the rows of its ends carry its weight, a half each."""
    rows = [
        Constraint(f"{node}{axis}", {node: 1.0}, np.eye(3)[axis].tolist()) for node in ("a", "b") for axis in range(3)
    ]
    rod = tmj.Rod("r", ("a", "b"), 2.0)
    structure = tmj.Structure("clamped", {"a": (0, 0, 0), "b": (1, 0, 0)}, (rod,), constraints=tuple(rows))
    scene = Scene(structure, gravity=(0, 0, -G), duration=0.1)
    for make in ENGINES.values():
        run = tmj.simulate(scene, None, make(STEP))
        assert np.abs(run.nodes - scene.nodes0).max() < 1e-14
        np.testing.assert_allclose(run.constraint_forces[:, [2, 5]], np.full((len(run.time), 2), G), atol=1e-8)


def test_what_has_no_place_for_them_refuses_them() -> None:
    for engine, message in (
        (tmj.ODE(), "minimal coordinates are those that rods have by their own supports"),
        (tmj.MuJoCo(integrator=tmj.Integrator.IMPLICIT), "use Integrator.RK4 or EULER"),
    ):
        with pytest.raises((OptionError, StructureError), match=f"constraint 'wall' holds nodes.*{message}"):
            tmj.simulate(ladder(), None, engine)


def test_a_run_is_kept_with_its_forces(tmp_path) -> None:
    run = tmj.simulate(ladder(), None, tmj.MuJoCo(timestep=STEP), duration=0.1)
    again = tmj.Trajectory.load(run.save(tmp_path / "run.nc"))
    np.testing.assert_array_equal(again.constraint_forces, run.constraint_forces)
    assert again.scene.structure == run.scene.structure


def test_joined_rods_in_water_agree() -> None:
    """Two rods whose far end keeps to a rail, in waves: both engines with RK4, the added mass and λ found together."""
    free = Support.free()
    rods = (
        tmj.Rod("one", ("a", "b"), 2.0, 0.05, Support.pinned()),
        tmj.Rod("two", ("b", "c"), 1.0, 0.05, free),
    )
    nodes = {"a": (0, 0, -0.5), "b": (1.0, 0.2, -1.0), "c": (1.8, 0, -0.6)}
    rail = Constraint("rail", {"c": 0.7, "b": 0.3}, (0.1, 0.2, 1.0))
    structure = tmj.Structure("joined", nodes, rods, constraints=(rail,))
    water = tmj.model.Water(waves=(tmj.model.Wave(0.2, 6.0),), drag=1.0)
    scene = Scene(structure, gravity=(0, 0, -G), duration=0.5, water=water)
    one, other = (tmj.simulate(scene, None, make(STEP), output_interval=0.02) for make in ENGINES.values())
    assert np.abs(one.nodes - other.nodes).max() < TOLERANCE
    scale = np.abs(other.multipliers).max()
    assert np.abs(one.multipliers - other.multipliers).max() < 1e-5 * scale  # and where they hang together
    assert np.abs(one.constraint_forces - other.constraint_forces).max() < 1e-5 * np.abs(one.constraint_forces).max()
    assert max(one.energy_residual, other.energy_residual) < 1e-6
