"""Linear models, stable steps and statics of strings that are not linear: slopes of the pieces on which they are."""

from __future__ import annotations

import math

import numpy as np
import pytest

import tensegrity_mj as tmj
from tensegrity_mj.statics.model import StaticModel

G, M = 9.81, 2.0
POINTS = ((0.1, 10.0), (0.2, 40.0), (0.4, 50.0))
ENGINES = [tmj.MuJoCo(1e-3), tmj.DAE(), tmj.ODE()]


def hung(length: float, **string) -> tmj.Scene:
    """A mass on one string of 1 m, and beside it the weight that `load` makes of it."""
    given = {"curve": POINTS, "rest_length": 1.0} | string
    structure = tmj.Structure(
        "hung",
        {"h": (0.0, 0.0, 0.0), "m": (0.0, 0.0, -length)},
        strings=(tmj.String("s", ("h", "m"), **given),),
        fixed_nodes=("h",),
        point_masses=(tmj.PointMass("m", M),),
    )
    return tmj.Scene(structure, gravity=(0.0, 0.0, -G))


@pytest.mark.parametrize("engine", ENGINES, ids=["MuJoCo", "DAE", "ODE"])
@pytest.mark.parametrize(("stretch", "slope", "tension"), [(0.05, 100.0, 5.0), (0.15, 300.0, 25.0), (0.3, 50.0, 45.0)])
def test_a_linear_model_has_the_slope_of_its_piece(engine, stretch: float, slope: float, tension: float) -> None:
    """-A = slope/M along the string and T/(L M) across it; B = slope/M of a rest length, by hand.

    Engines differ from the closed form by their round-off: 4 ε R/h of k/M (linearization.linearizing).
    """
    length = 1 + stretch
    model = tmj.linearize(hung(length), engine)
    across = tension / length / M
    np.testing.assert_allclose(-model.A[3:, :3], np.diag([across, across, slope / M]), atol=1e-9 * slope)
    np.testing.assert_allclose(model.B[3:, 0], [0, 0, -slope / M], atol=1e-9 * slope)
    np.testing.assert_allclose(model.residual[3:], [0, 0, tension / M - G], atol=1e-10)
    densities = tmj.linearize(hung(length), engine, inputs=tmj.Command.FORCE_DENSITY)
    np.testing.assert_allclose(-densities.A[3:, :3], np.eye(3) * across, atol=1e-9 * slope)
    np.testing.assert_allclose(densities.B[3:, 0], [0, 0, length / M], atol=1e-9)


@pytest.mark.parametrize("engine", ENGINES, ids=["MuJoCo", "DAE", "ODE"])
def test_small_motions_of_a_yielding_string_are_elastic_and_of_a_constant_force_pendular(engine) -> None:
    yields = tmj.linearize(hung(1.3, curve=((0.1, 10.0), (0.4, 16.0)), yields=True), engine)
    np.testing.assert_allclose(-yields.A[3:, :3], np.diag([14 / 1.3 / M, 14 / 1.3 / M, 100 / M]), atol=1e-7)
    assert "yield: the model has them unload and reload" in " ".join(yields.warnings)
    constant = tmj.linearize(hung(1.3, stiffness=0.0, curve=(), tension=M * G, rest_length=None), engine)
    np.testing.assert_allclose(-constant.A[3:, :3], np.diag([G / 1.3, G / 1.3, 0.0]), atol=1e-9)
    assert not constant.B.any()
    assert np.abs(constant.residual).max() < 1e-12


def test_a_run_vibrates_with_the_frequency_of_the_linear_model() -> None:
    """0.1 mm about the equilibrium on the steep piece: one period later it is back, by its slope of 300 N/m."""
    hang = 0.1 + (M * G - 10) / 300
    scene = hung(1 + hang + 1e-4)
    period = 2 * math.pi / math.sqrt(300 / M)
    run = tmj.simulate(scene, None, tmj.DAE(rtol=1e-12, atol=1e-14), duration=period)
    # Along a straight piece the motion is harmonic, whatever its size.
    assert np.abs(run.nodes[-1] - run.nodes[0]).max() < 1e-11


@pytest.mark.parametrize(("stretch", "slope"), [(0.05, 100.0), (0.15, 300.0), (0.3, 50.0)])
def test_the_largest_stable_step_is_that_of_the_slope(stretch: float, slope: float) -> None:
    """2/ω of semi-implicit Euler, and 2√2/ω of Runge-Kutta."""
    scene, omega = hung(1 + stretch), math.sqrt(slope / M)
    assert tmj.stable_step(scene, tmj.MuJoCo(1e-3, "euler")).limit == pytest.approx(2 / omega, rel=1e-9)
    assert tmj.stable_step(scene, tmj.MuJoCo(1e-3)).limit == pytest.approx(math.sqrt(8) / omega, rel=1e-9)


def test_a_step_that_a_piece_ahead_makes_unstable_is_warned_of() -> None:
    """The cheap bound is by the steepest piece: 300 N/m. At 2.1/ω of it the model of the start is looked at, too."""
    from tensegrity_mj.vibration.bodies import Bodies
    from tensegrity_mj.vibration.bounds import bounds_at
    from tensegrity_mj.vibration.stepping import Scheme

    scene = hung(1.05)
    found = bounds_at(scene, Bodies.of(scene.structure), scene.nodes0, scene.velocities0, scene.structure.rest_lengths)
    assert found.stable_step(Scheme.SEMI_IMPLICIT) <= 2 / math.sqrt(300 / M)
    assert found.stable_step(Scheme.LINEARLY_IMPLICIT) < math.inf  # that integrator knows 100 N/m of it


@pytest.mark.parametrize("curve", [POINTS, ((0.1, 30.0), (0.4, 40.0))])
def test_statics_finds_where_the_curve_carries_the_weight(curve) -> None:
    corners = np.array([(0.0, 0.0), *curve])
    hang = np.interp(M * G, corners[:, 1], corners[:, 0])
    found = tmj.statics.find_equilibrium(hung(1.02, curve=curve))
    assert found.nodes[1, 2] == pytest.approx(-1 - hang, abs=1e-9)
    assert found.tensions[0] == pytest.approx(M * G, abs=1e-8)
    place = np.searchsorted(corners[:, 0], hang) - 1
    slope = np.diff(corners[:, 1])[place] / np.diff(corners[:, 0])[place]
    modes = tmj.statics.natural_modes(found)
    assert max(modes.frequencies) == pytest.approx(math.sqrt(slope / M) / (2 * math.pi), rel=1e-9)


def test_the_stiffness_of_statics_is_the_derivative_of_its_gradient_and_that_of_its_energy() -> None:
    """Central differences of 1e-6 m, within pieces: round-off of 1e-16 · 50 N / 1e-6 m, and third derivatives T/L²."""
    structure = tmj.Structure(
        "three",
        {"a": (0.0, 0.0, 0.0), "b": (2.0, 0.0, 0.0), "c": (1.0, 1.5, 0.2), "m": (1.0, 0.3, -0.6)},
        strings=(
            tmj.String("curve", ("a", "m"), curve=POINTS, tension=22.0),
            tmj.String("yields", ("b", "m"), curve=((0.1, 10.0), (0.4, 16.0)), yields=True, tension=12.0),
            tmj.String("constant", ("c", "m"), 0.0, tension=7.0),
        ),
        fixed_nodes=("a", "b", "c"),
        point_masses=(tmj.PointMass("m", M),),
    )
    model = StaticModel.of(tmj.Scene(structure, gravity=(0.0, 0.0, -G)))
    x, h = model.start.ravel(), 1e-6
    K = model.dense_hessian(x, np.zeros(0))
    np.testing.assert_allclose(model.hessian(x, np.zeros(0)).toarray(), K, atol=1e-12)
    for k in range(9, 12):
        unit = np.eye(12)[k] * h
        slope = (model.gradient(x + unit) - model.gradient(x - unit)) / (2 * h)
        np.testing.assert_allclose(slope, K[:, k], atol=1e-6)
        assert (model.energy(x + unit) - model.energy(x - unit)) / (2 * h) == pytest.approx(
            model.gradient(x)[k], abs=1e-7
        )


def test_a_broken_constant_force_carries_nothing() -> None:
    structure = hung(1.3, stiffness=0.0, curve=(), tension=50.0, rest_length=None).structure
    both = tmj.Structure(
        "two",
        dict(structure.nodes) | {"k": (0.0, 0.0, 0.5)},
        strings=(*structure.strings, tmj.String("t", ("k", "m"), 100.0, rest_length=1.0)),
        fixed_nodes=("h", "k"),
        point_masses=structure.point_masses,
    )
    scene = tmj.Scene(both, gravity=(0.0, 0.0, -G))
    found = tmj.statics.find_equilibrium(StaticModel.of(scene, broken=["s"]))
    assert found.tensions.tolist() == [0.0, pytest.approx(M * G)]
    whole = StaticModel.of(scene)
    assert whole.tensions(whole.lengths(whole.start.ravel()))[0] == 50.0


def test_a_load_path_goes_round_the_corners_of_a_curve() -> None:
    """Pulled down with up to 60 N: at each load the string has the stretch that carries it."""
    scene = hung(1 + 0.1 + (M * G - 10) / 300)
    loads = np.zeros((2, 3))
    loads[1, 2] = -25.0
    path = tmj.statics.follow(scene, loads=loads)
    for state in path.states:
        wanted = np.interp(M * G + 25.0 * state.parameter, [0, 10, 40, 50], [0, 0.1, 0.2, 0.4])
        assert -state.nodes[1, 2] - 1 == pytest.approx(wanted, abs=1e-8)
    assert path.states[-1].parameter == pytest.approx(1.0)


def test_a_run_has_the_stable_step_of_its_yielded_strings_and_pictures_show_them_slack() -> None:
    """Caught at 4 m/s on 30 N, it unloads with 300 N/m: 2/√(300/M) wherever it pulls, none where it is slack."""
    from tensegrity_mj.pictures.motion import Motion

    down = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -4.0]])
    scene = hung(1.05, curve=((0.1, 30.0), (0.6, 36.0)), yields=True).with_(initial_velocities=down, duration=1.5)
    engine = tmj.MuJoCo(1e-3, "euler")
    run = tmj.simulate(scene, None, tmj.MuJoCo(1e-3), output_interval=0.01)
    assert tmj.stable_step(scene, engine, run=run).limit == pytest.approx(2 / math.sqrt(300 / M), rel=1e-6)
    lengths = scene.structure.string_lengths(run.nodes)
    slack = (run.tensions == 0)[:, 0]
    assert (lengths > 1.0)[slack].any()
    motion = Motion.of(run)
    np.testing.assert_array_equal((motion.rest_lengths >= lengths)[:, 0][slack], True)
