"""The predicted largest stable step: against closed forms, against runs, and the warning before a run."""

from __future__ import annotations

import math
import warnings
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from equilibria import equilibrium_residual
from numpy.typing import NDArray

import tensegrity_mj as tmj
from evidence.random_structures import random_scene, random_structure
from evidence.random_taut import random_taut_structure
from evidence.stability import study
from evidence.stability.cases import AXES, base_structure, random_points, structure_of, varied
from evidence.stability.study import AGREEMENT, at_rest, measured_limit, steps_for
from tensegrity_mj import Integrator, Method, Scene, Structure, stable_step
from tensegrity_mj.dynamics.native.law import native_law
from tensegrity_mj.engines.table import NAMES, engine_of
from tensegrity_mj.errors import OptionError, StabilityWarning
from tensegrity_mj.model.actuation import Actuation, Mode
from tensegrity_mj.model.members import PointMass, Rod, String, Support
from tensegrity_mj.vibration import stable_step as inside
from tensegrity_mj.vibration.bodies import Bodies
from tensegrity_mj.vibration.bounds import HALF_DISC, bounds_at, bounds_of
from tensegrity_mj.vibration.closed_loop import LawAtStates, Loop
from tensegrity_mj.vibration.integrators import (
    amplification_matrix,
    is_stable,
    limit_of,
    polynomial,
    system_matrix,
)
from tensegrity_mj.vibration.small_motions import Vibration, vibration
from tensegrity_mj.vibration.step_warnings import before_run, explain_warnings
from tensegrity_mj.vibration.stepping import Scheme

Array = NDArray[np.float64]


def oscillator(omega: float = 10.0, zeta: float = 0.0, tension: float = 0.0) -> Structure:
    """1 kg on two strings along x, free along x alone: x'' = -ω² x - 2 ζ ω x'."""
    k, c = 0.5 * omega**2, zeta * omega
    return Structure(
        "oscillator",
        {"left": (-1.0, 0.0, 0.0), "right": (1.0, 0.0, 0.0), "m": (0.0, 0.0, 0.0)},
        rods=(),
        strings=tuple(String(name, (name, "m"), k, c, tension=tension or 0.3 * k) for name in ("left", "right")),
        fixed_nodes=("left", "right"),
        point_masses=(PointMass("m", 1.0, (0.0, 0.0, 1.0)),),
    )


def rod_on_springs(k: float = 300.0, mass: float = 2.0) -> Structure:
    """A rod pinned at its lower end, upright in a plane, its top between two strings along x: one angle."""
    return Structure(
        "rod on springs",
        {"o": (0.0, 0.0, 0.0), "t": (0.0, 0.0, 1.5), "l": (-1.0, 0.0, 1.5), "r": (1.0, 0.0, 1.5)},
        rods=(Rod("rod", ("o", "t"), mass, support=Support.pinned(0.0, (0.0, 1.0, 0.0))),),
        strings=(String("sl", ("t", "l"), k, tension=0.1 * k), String("sr", ("t", "r"), k, tension=0.1 * k)),
        fixed_nodes=("l", "r"),
    )


def model_of(structure: Structure, **changes: Any) -> Vibration:
    return vibration(
        Scene(structure), structure.positions, np.zeros_like(structure.positions), structure.rest_lengths, **changes
    )


def limit(structure: Structure, name: str) -> float:
    return stable_step(Scene(structure), engine_of(name, 1.0)).limit


# Closed forms ----------------------------------------------------------------------------------------------


def test_one_rod_on_two_springs() -> None:
    # J ω² = 2 k ℓ²: both strings along x resist, their tension T = 0.1 k does it across z: geometric stiffness of
    # a node that moves along x is zero along a string; moving on a circle, the rod's own tension is zero.
    omega = math.sqrt(2 * 300.0 / (2.0 / 3))
    structure = rod_on_springs()
    found = stable_step(Scene(structure), tmj.MuJoCo())
    assert found.omega == pytest.approx(omega, rel=1e-12)
    assert found.limit == pytest.approx(2 * math.sqrt(2) / omega, rel=1e-12)
    assert found.relative == pytest.approx(math.sqrt(2), rel=1e-12)
    assert (found.rod, found.rod_share) == ("rod", pytest.approx(1.0))
    assert found.string in ("sl", "sr")
    assert found.string_share == pytest.approx(0.5)
    for name in ("euler", "implicit", "implicitfast"):
        assert limit(structure, name) == pytest.approx(2 / omega, rel=1e-12)
    for name in ("dae", "ode"):
        assert limit(structure, name) == pytest.approx(2 * math.sqrt(2) / omega, rel=1e-12)
    assert limit(structure, "discrete") == math.inf


@pytest.mark.parametrize("zeta", [0.0, 0.05, 0.7, 1.0, 3.0, 10.0])
def test_one_damped_mode(zeta: float) -> None:
    omega = 10.0
    structure = oscillator(omega, zeta, tension=1e-9)  # next to no stiffness across
    root = math.sqrt(zeta**2 + 1)
    assert limit(structure, "euler") == pytest.approx(2 * (root - zeta) / omega, rel=1e-9)
    assert limit(structure, "implicit") == pytest.approx(2 * (root + zeta) / omega, rel=1e-9)
    # Runge-Kutta by the roots of its scalar amplification polynomial, searched by small steps.
    modes = np.roots([1.0, 2 * zeta * omega, omega**2])
    steps = np.arange(1e-6, 0.5, 1e-6)
    grows = np.abs(polynomial(np.outer(modes, steps))).max(axis=0) > 1 + 1e-9
    assert limit(structure, "rk4") == pytest.approx(steps[np.argmax(grows)], abs=3e-6)


def test_the_discrete_integrator_is_limited_by_what_prestress_alone_holds() -> None:
    # Across the strings, T/L = 30 N/m each on 1 kg: ω² = 60, h = 2/ω, whatever the strings' own stiffness is.
    for omega in (10.0, 1000.0):
        assert limit(oscillator(omega, tension=30.0), "discrete") == pytest.approx(2 / math.sqrt(60.0), rel=1e-9)


def test_dampers_between_bodies_count_half_in_the_implicit_integrators() -> None:
    # Two unit masses on one line, k and c between them alone, and none to the ground: relative motion has K = 2k,
    # D = 2c, but MuJoCo's derivative has each mass's own c only, Db = c: h² 2k/4 + h (2c/2 - c) = 1, so 2/√(2k).
    k, c = 50.0, 40.0
    structure = Structure(
        "two masses",
        {"a": (0.0, 0.0, 0.0), "b": (1.0, 0.0, 0.0)},
        strings=(String("s", ("a", "b"), k, c, tension=1e-9),),
        point_masses=(PointMass("a", 1.0), PointMass("b", 1.0)),
    )
    assert limit(structure, "implicit") == pytest.approx(2 / math.sqrt(2 * k), rel=1e-9)


# Two ways ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(6))
def test_the_matrices_have_the_eigenvalues_of_the_engines_linear_model(seed: int) -> None:
    rng = np.random.default_rng(seed)
    structure = random_structure(
        rng, rods=3, sigma=0.5, planar=bool(seed % 2), own_planes=0.5, stretch=(0.05, 0.4), damping=(0.1, 0.5),
        point_masses=seed % 3,
    )  # fmt: skip
    scene = random_scene(rng, structure, gravity=True, loads=2)
    model = vibration(scene, scene.nodes0, scene.velocities0, structure.rest_lengths)
    ours = np.sort(np.abs(np.linalg.eigvals(system_matrix(model))))
    theirs = np.sort(np.abs(tmj.linearize(scene, tmj.DAE()).eigenvalues))
    # Zeros of coordinates that supports forbid come first. Both are good to 1e-13 of the largest; where two
    # eigenvalues are close, an error ε becomes √ε.
    np.testing.assert_allclose(ours[-len(theirs) :], theirs, atol=1e-6 * theirs[-1])


@pytest.mark.parametrize("scheme", list(Scheme))
@pytest.mark.parametrize("seed", range(4))
def test_the_limit_is_where_the_steps_matrix_begins_to_grow(seed: int, scheme: Scheme) -> None:
    damping = [0.0, 0.1, 1.0, 8.0][seed]
    structure = random_taut_structure(np.random.default_rng(seed), rods=3, damping_ratio=(0.0, damping))
    model = model_of(structure)
    h, _ = limit_of(model, scheme)
    if math.isinf(h):
        assert scheme is Scheme.LINEARLY_IMPLICIT
        h = 1e4
    else:
        assert largest_growth(model, scheme, 1.01 * h) > 1 + 1e-4
        assert not is_stable(model, scheme, 1.001 * h)
    # No step below it: regions of instability inside would be missed by bisection, so every one of many is looked at.
    # Double eigenvalues at 1 (motions that nothing holds) split by √ε.
    for part in np.linspace(0.02, 0.999, 60):
        assert largest_growth(model, scheme, part * h) < 1 + 1e-6


def largest_growth(model: Vibration, scheme: Scheme, step: float) -> float:
    return float(np.abs(np.linalg.eigvals(amplification_matrix(model, scheme, step))).max())


@pytest.mark.parametrize("seed", range(5))
def test_the_cheap_bound_is_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    damping = float(rng.choice([0.0, 1.0, 10.0]))
    structure = random_taut_structure(rng, rods=4, planar=bool(seed % 2), damping_ratio=(0.0, damping))
    model = model_of(structure)
    bounds = bounds_at(
        Scene(structure),
        Bodies.of(structure),
        structure.positions,
        np.zeros_like(structure.positions),
        structure.rest_lengths,
    )
    for matrix, bound in zip((model.material, model.geometric, model.damper), bounds[:3], strict=True):
        assert np.linalg.eigvalsh(matrix)[-1] <= bound
    for scheme in Scheme:
        least, real = bounds.stable_step(scheme), limit_of(model, scheme)[0]
        assert 0 < least <= real
        if math.isfinite(real) and scheme is not Scheme.LINEARLY_IMPLICIT:
            assert least > 0.05 * real  # and not a useless one


def test_the_cheap_bound_of_a_loop_is_one() -> None:
    """Of |x* K x| and |x* D x|, which are below the largest eigenvalues of (A + Aᵀ)/2 and (A - Aᵀ)/2 i together."""
    scene = tmj.load_scene("prism")
    for rate in (1.0, 30.0):
        law = tmj.controllers.Lyapunov(scene.structure, scene.target, decay_rate=rate)
        loop = Loop(
            scene, Bodies.of(scene.structure), LawAtStates(scene, native_law(law, scene.structure)), Mode.CONTINUOUS
        )
        model = loop.at(scene.nodes0, scene.velocities0, None, 0.0)
        assert model.law is not None
        bounds = bounds_of(model)
        for matrix, bound in (
            (model.material + model.geometric + model.law.stiffness, bounds.material + bounds.rest),
            (model.damper + model.law.damping, bounds.damper + bounds.other),
        ):
            for sign in (1, -1):
                part = 0.5 * (matrix + sign * matrix.T)
                assert np.abs(np.linalg.eigvals(part)).max() <= bound
        assert 0.05 * limit_of(model, Scheme.RUNGE_KUTTA)[0] < bounds.stable_step(Scheme.RUNGE_KUTTA)
        assert bounds.stable_step(Scheme.RUNGE_KUTTA) <= limit_of(model, Scheme.RUNGE_KUTTA)[0]


def test_the_half_disc_of_runge_kutta() -> None:
    angle = np.linspace(0.0, np.pi, 1441)
    for radius in np.linspace(0.01, HALF_DISC, 50):
        z = radius * np.exp(1j * angle)
        assert np.all(np.abs(polynomial(z)) <= np.exp(2 * np.maximum(z.real, 0.0)) * (1 + 1e-12))


@pytest.mark.parametrize("damped", [False, True])
def test_sparse_and_dense_agree(damped: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    structure = random_taut_structure(np.random.default_rng(3), rods=12, damping_ratio=(0.0, 2.0 if damped else 0.0))
    dense = [limit_of(model_of(structure), scheme)[0] for scheme in Scheme]
    monkeypatch.setattr("tensegrity_mj.vibration.blocks.DENSE", 10)
    model = model_of(structure)
    assert not isinstance(model.material, np.ndarray)
    # The sparse solver stops at 1e-9 of an eigenvalue.
    np.testing.assert_allclose([limit_of(model, scheme)[0] for scheme in Scheme], dense, rtol=1e-7)


# The law in the loop ---------------------------------------------------------------------------------------


def test_the_loops_eigenvalues_are_those_of_linearize_along_a_run() -> None:
    scene = tmj.load_scene("prism")
    law = tmj.controllers.from_scene(scene)
    run = tmj.simulate(scene, law, tmj.MuJoCo(), duration=3.0)
    row = int(np.argmin(np.abs(run.time - 2.5)))
    state = {"nodes": run.nodes[row], "velocities": run.velocities[row], "time": float(run.time[row])}
    fastest = np.abs(tmj.linearize(scene, tmj.DAE(), law=law, **state).eigenvalues).max()
    found = stable_step(scene, tmj.MuJoCo(), law=law, **state)
    assert found.closed_loop
    # A real, stable pole: R(z) leaves [-1, 1] at z = -2.785294. What velocities do to the model is left out here.
    assert found.limit == pytest.approx(2.785294 / fastest, rel=1e-3)
    # The law's own poles are what limits the step: 10 ms is beyond it, 5 ms is not (and the run shows it).
    worst = stable_step(scene, tmj.MuJoCo(), law=law, run=run)
    assert 5e-3 < worst.limit < 1e-2
    assert stable_step(scene, tmj.MuJoCo(), law=None, run=run).limit > 0.5


def test_a_run_that_leaves_its_promise_for_the_step_says_so() -> None:
    scene = tmj.load_scene("prism")
    law = tmj.controllers.from_scene(scene)
    fine = tmj.simulate(scene, law, tmj.MuJoCo(5e-3))
    assert fine.reports["stability"] == {"step": 5e-3, "checked": True, "exceeded": False}
    engine = tmj.MuJoCo(1e-2)
    coarse = tmj.simulate(scene, law, engine)
    assert not coarse.reports["stability"]["exceeded"]  # at the start
    assert "explain_warnings" in coarse.reports["stability"]["along_the_run"]
    explain_warnings(coarse, engine, law)
    assert coarse.reports["stability"]["exceeded"]
    assert "along_the_run" not in coarse.reports["stability"]
    assert coarse.reports["stability"]["limit"] < 1e-2
    assert any("beyond the largest stable one" in text for text in coarse.reports["warnings"])
    before = dict(fine.reports)
    explain_warnings(fine, tmj.MuJoCo(5e-3), law)  # there is nothing to explain
    assert fine.reports == before


class Pull:
    """u = u₀ + g x of one string on each side: a proportional law in force densities, compiled by nobody."""

    def __init__(self, gain: float, calls: list[float]) -> None:
        self.gain, self.calls = gain, calls

    def __call__(self, time: float, nodes: Array, velocities: Array) -> Array:
        self.calls.append(time)
        return np.array([10.0 + self.gain * nodes[2, 0], 10.0 - self.gain * nodes[2, 0]])


@pytest.mark.parametrize("name", ["euler", "implicit", "rk4", "dae"])
def test_a_laws_stiffness_closes_the_loop(name: str) -> None:
    # Forces u₁ (-1 - x) + u₂ (1 - x) at u = 10 ± g x: x'' = -(20 + 2 g) x, whatever k is; across, -20.
    gain = 400.0
    structure = oscillator(1000.0)
    found = stable_step(Scene(structure), engine_of(name, 1.0), law=Pull(gain, []))
    reach = 2 * math.sqrt(2) if name in ("rk4", "dae") else 2.0
    # The allowance of 1e-3 a step lets a step pass that is by up to (1e-3)²/8 and less beyond the limit.
    assert found.limit == pytest.approx(reach / math.sqrt(20 + 2 * gain), rel=1e-5)


# The warning -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_a_run_warns_where_its_step_is_beyond_the_limit_and_only_there(name: str) -> None:
    structure = random_taut_structure(np.random.default_rng(5), rods=3)
    scene = Scene(structure)
    found = stable_step(scene, engine_of(name, 1.0))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        h = 0.99 * found.limit
        run = tmj.simulate(scene, None, engine_of(name, h), duration=4 * h)
        assert run.reports["stability"]["checked"]
        assert not run.reports["stability"]["exceeded"]
    h = 1.01 * found.limit
    with pytest.warns(StabilityWarning, match="beyond the largest stable one") as caught:
        run = tmj.simulate(scene, None, engine_of(name, h), duration=4 * h)
    assert caught[0].filename == __file__
    text = str(caught[0].message)
    assert f"'{found.rod}'" in text
    assert f"'{found.string}'" in text
    assert f"{found.limit:.3g} s" in text
    assert run.reports["stability"]["limit"] == pytest.approx(found.limit)
    assert run.reports["stability"]["string"] == found.string


def test_a_run_far_below_the_limit_is_passed_by_the_bound_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    def never(*_: object, **__: object) -> None:
        raise AssertionError("the model was made")

    monkeypatch.setattr("tensegrity_mj.vibration.closed_loop.vibration", never)
    run = tmj.simulate(tmj.load_scene("prism"), None, tmj.MuJoCo(), duration=0.01)
    assert run.reports["stability"]["at_least"] > 1e-3


def test_a_loop_far_below_the_limit_is_passed_without_eigenvalues(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = tmj.load_scene("prism")
    law = tmj.controllers.from_scene(scene)
    limit = stable_step(scene, tmj.MuJoCo(), law=law).limit

    def never(*_: object) -> None:
        raise AssertionError("eigenvalues were requested")

    monkeypatch.setattr(np.linalg, "eigvals", never)
    run = tmj.simulate(scene, law, tmj.MuJoCo(0.05 * limit), duration=0.1 * limit)
    assert run.reports["stability"] == {"step": 0.05 * limit, "checked": True, "exceeded": False}
    beyond, _ = before_run(scene, tmj.MuJoCo(1.01 * limit), native_law(law, scene.structure), Actuation.continuous())
    assert beyond == {"step": 1.01 * limit, "checked": False, "reason": "AssertionError: eigenvalues were requested"}


def test_what_chooses_its_steps_is_not_checked() -> None:
    scene = tmj.load_scene("prism")
    run = tmj.simulate(scene, None, tmj.DAE(), duration=0.01)
    assert "stability" not in run.reports
    assert stable_step(scene, tmj.DAE()).limit == math.inf

    assert tmj.MuJoCo(accuracy=1e-6).stepping.scheme is None
    assert tmj.DAE(accuracy=1e-6).stepping.scheme is None
    assert tmj.MuJoCo(1.0, Integrator.EULER).stepping.scheme is Scheme.SEMI_IMPLICIT


def test_the_check_never_calls_a_law_of_pythons_and_never_raises() -> None:
    scene = Scene(oscillator(10.0))
    calls: list[float] = []
    report, text = before_run(
        scene, tmj.MuJoCo(1.0), native_law(Pull(1.0, calls), scene.structure), Actuation.continuous()
    )
    assert report is not None
    assert not report["checked"]
    assert text == ""
    assert calls == []

    def broken(time: float) -> Array:
        if calls:
            raise KeyError("no load")
        return np.zeros((3, 3))

    loaded = scene.with_(loads=broken)
    calls.append(0.0)
    report, text = before_run(loaded, tmj.MuJoCo(1.0), native_law(None, scene.structure), Actuation.continuous())
    assert report is not None
    assert "no load" in report["reason"]
    assert text == ""


def test_a_diverged_run_keeps_what_was_found_before() -> None:
    structure = oscillator(10.0)
    velocities = np.array([[0, 0, 0], [0, 0, 0], [0.1, 0, 0]], float)
    scene = Scene(structure, initial_velocities=velocities)
    with pytest.warns(StabilityWarning), pytest.raises(tmj.errors.DivergenceError) as caught:
        tmj.simulate(scene, None, tmj.MuJoCo(0.5), duration=500.0)
    trajectory: Any = caught.value.trajectory
    assert trajectory.reports["stability"]["limit"] == pytest.approx(math.sqrt(8) / 10)


def test_scenes_without_strings_or_all_slack_have_no_limit() -> None:
    bare = Structure("rod", {"a": (0, 0, 0), "b": (1, 0, 0)}, rods=(Rod("r", ("a", "b"), 1.0),))
    assert stable_step(Scene(bare), tmj.MuJoCo()).limit == math.inf
    slack = rod_on_springs().with_strings(rest_length=5.0)
    found = stable_step(Scene(slack), tmj.MuJoCo())
    assert found.limit == math.inf
    assert "slack" in found.notes[0]
    tmj.simulate(Scene(bare), None, tmj.MuJoCo(), duration=0.01)


def test_broken_strings_drop_out() -> None:
    structure = oscillator(10.0)
    scene = Scene(structure, breaks=(tmj.model.Break("left", 1.0),))
    before = stable_step(scene, tmj.MuJoCo(integrator=Integrator.EULER))
    after = stable_step(scene, tmj.MuJoCo(integrator=Integrator.EULER), time=1.0)
    assert after.limit == pytest.approx(math.sqrt(2) * before.limit)


def test_held_commands_have_the_stiffness_of_what_is_held() -> None:
    scene = Scene(oscillator(1000.0))
    law = Pull(0.0, [])
    lengths = stable_step(scene, tmj.MuJoCo(), law=law, actuation=Actuation.hold_rest_length(0.01))
    densities = stable_step(scene, tmj.MuJoCo(), law=law, actuation=Actuation.hold_force_density(0.01))
    # Rest lengths: 2 k = 1e6 (its own stiffness); densities: 2 u = 20 in every direction. 1 kg.
    assert lengths.omega == pytest.approx(1000.0)
    assert densities.omega == pytest.approx(math.sqrt(20.0))


def test_baumgartes_frequency_limits_the_dae() -> None:
    structure = rod_on_springs(k=1e-3)
    engine = tmj.DAE(method=Method.RK4, timestep=1.0, drift=tmj.engines.Drift.BAUMGARTE, baumgarte_frequency=50.0)
    assert stable_step(Scene(structure), engine).limit == pytest.approx(2.785294 / 50.0, rel=1e-5)


def test_many_strings_without_tension_have_no_geometric_stiffness_to_iterate_on() -> None:
    # 200 coordinates: sparse, and a matrix of zeros, on which Lanczos iterations break down.
    found = stable_step(tmj.load_scene("planar_beam"), tmj.MuJoCo(integrator=Integrator.DISCRETE), law=None)
    assert found.limit == math.inf
    assert not found.motion.any()


def test_contact_is_named_as_what_the_model_leaves_out() -> None:
    found = stable_step(tmj.load_scene("prism_drop"), tmj.MuJoCo())
    assert any("contact is not in the model" in note for note in found.notes)


@pytest.mark.parametrize(
    "way", [(1, 0, 0), (0, 1, 0), (0.2, 0, 1), (0, -0.2, 1), (0, 0, 1), (0.05, 0, -1), (0, 0.05, 1)]
)
def test_rods_that_stand_upright_are_near_the_pole_of_the_angles(way: tuple[float, float, float]) -> None:
    """Where sin φ is below 0.1; rods that lie along x or y, or lean by 0.2 rad, are not."""
    rods, strings = (tmj.Rod("r", ("a", "b"), 1.0),), (tmj.String("s", ("b", "c"), 10.0, rest_length=0.5),)
    structure = tmj.Structure("rod", {"a": (0, 0, 0), "b": way, "c": (0, 0, 3)}, rods, strings, fixed_nodes=("c",))
    notes = [note for note in stable_step(tmj.Scene(structure), tmj.ODE()).notes if "near the pole" in note]
    assert len(notes) == (np.hypot(*way[:2]) < 0.1)


def spun(rate: float, damping: float, engine: Any) -> float:
    """Angular momentum of a prestressed prism in free flight after 1 s, over that at the start."""
    structure = tmj.load_scene("prism_drop").structure
    structure = structure.with_strings(damping=damping * structure.damping)
    nodes = structure.positions
    axis = np.array([1.0, 0.2, 0.1]) / math.hypot(1.0, 0.2, 0.1)
    scene = Scene(structure, initial_velocities=np.cross(rate * axis, nodes - nodes.mean(axis=0)), gravity=(0, 0, 0))
    run = tmj.simulate(scene, None, engine, duration=1.0, output_interval=0.1)

    def momentum(row: int) -> float:
        x, v = run.nodes[row] - run.nodes[row].mean(axis=0), run.velocities[row] - run.velocities[row].mean(axis=0)
        # Equal rods: Σ over rods of (m/12)(b × ḃ) and m r × ṙ is m/6 (2 a×ȧ + 2 b×ḃ + a×ḃ + b×ȧ) of their ends a, b.
        a, b = structure.rod_nodes.T
        total = 2 * np.cross(x[a], v[a]) + 2 * np.cross(x[b], v[b]) + np.cross(x[a], v[b]) + np.cross(x[b], v[a])
        return float(np.linalg.norm(total.sum(axis=0)))

    return momentum(-1) / momentum(0)


@pytest.mark.parametrize("integrator", [Integrator.IMPLICIT, Integrator.IMPLICITFAST])
def test_dampers_between_bodies_spin_a_structure_up_or_down_where_velocities_are_implicit(
    integrator: Integrator,
) -> None:
    # (1 + h Db)(v' - v) = h f with blocks Db of single bodies: strings' forces have no moment in sum, but what they do
    # to the velocities has one. It changes sign with the spin, and vanishes with c; the limit at rest is six times h.
    engine = tmj.MuJoCo(1e-3, integrator)
    assert spun(10.0, 1.0, engine) > 1.01
    assert spun(-10.0, 1.0, engine) < 0.99
    assert spun(10.0, 0.0, engine) == pytest.approx(1.0, abs=5e-3)
    found = stable_step(tmj.load_scene("prism_drop"), engine)
    assert found.limit > 5e-3
    assert any("does not keep angular momentum" in note for note in found.notes)
    for other in (Integrator.EULER, Integrator.DISCRETE, Integrator.RK4):
        # First order in h ω of the spin for the one-stage ones: 1e-3 at h Ω = 0.01 over the first jerk of the strings.
        assert spun(10.0, 1.0, tmj.MuJoCo(1e-3, other)) == pytest.approx(1.0, abs=1e-3)
        notes = stable_step(tmj.load_scene("prism_drop"), tmj.MuJoCo(1e-3, other)).notes
        assert not any("angular momentum" in note for note in notes)


@pytest.mark.parametrize(
    ("bad", "engine"),
    [
        ({"time": -1.0}, tmj.MuJoCo()),
        ({"run": "run.nc"}, tmj.MuJoCo()),
        ({"actuation": "continuous"}, tmj.MuJoCo()),
        ({}, None),
        ({}, tmj.MuJoCo),
        ({}, Method.RK4),
    ],
)
def test_what_is_no_state_engine_or_run_is_refused(bad: dict[str, Any], engine: Any) -> None:
    with pytest.raises(OptionError, match=next(iter(bad), "engine")):
        inside.stable_step(tmj.load_scene("prism"), engine, **bad)


@pytest.mark.parametrize("bad", [{"nodes": np.zeros((2, 3))}, {"rest_lengths": [1.0]}, {"time": math.nan}])
def test_bad_input_is_named(bad: dict[str, Any]) -> None:
    with pytest.raises(OptionError, match=next(iter(bad))):
        inside.stable_step(tmj.load_scene("prism"), tmj.MuJoCo(), **bad)
    with pytest.raises(OptionError, match="scene"):
        inside.stable_step("prism", tmj.MuJoCo())  # type: ignore[arg-type]


# Against runs ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("seed", "name"), [(1, "rk4"), *((seed, name) for seed in (2, 5) for name in NAMES)])
def test_predicted_and_measured_limits_agree_on_random_structures(seed: int, name: str) -> None:
    damping = {1: 0.0, 2: 0.3, 5: 5.0}[seed]
    structure = random_taut_structure(
        np.random.default_rng(seed), rods=1 + seed % 3, planar=seed == 5, damping_ratio=(0.0, damping)
    )
    found = at_rest(Scene(structure), name)
    assert found["agrees"], found
    # Bisection stops at 0.5 %, and growth is seen from 0.1 % on: see `measured_limit`.
    assert found["ratio"] == pytest.approx(1.0, abs=0.02)


def test_the_measurement_finds_known_limits() -> None:
    scene = Scene(oscillator(10.0))
    measured = measured_limit(scene, lambda h: tmj.MuJoCo(h, Integrator.EULER), 10.0)
    assert measured.limit == pytest.approx(0.2, rel=0.006)
    measured = measured_limit(scene, lambda h: tmj.MuJoCo(h), 10.0)
    assert measured.limit == pytest.approx(math.sqrt(8) / 10, rel=0.006)
    assert measured_limit(scene, lambda h: tmj.MuJoCo(h, Integrator.DISCRETE), 10.0, most=0.9).limit == math.inf


def test_dampers_that_pull_harder_in_the_stages_than_between_steps_do_not_hide_the_limit() -> None:
    # ζ up to 9 and strings stretched by 1e-4 of their length: at z = -3 the stages' rates are four times the step's, so
    # that strings go slack within a step, which stops the growth, where between steps nothing is near it.
    structure = structure_of(
        {
            "kind": "random", "seed": 1563192035, "rods": 20, "planar": True, "mass_ratio": 841.4914458524752,
            "stiffness": 10634.393484075068, "prestrain": [1e-4, 0.1483416997224218],
            "damping_ratio": 8.901227397289132,
        }
    )  # fmt: skip
    assert at_rest(Scene(structure), "dae")["ratio"] == pytest.approx(1.0, abs=0.01)


def test_fewer_steps_of_large_structures_still_find_the_limit() -> None:
    assert [steps_for(rods) for rods in (1, 30, 31, 100, 101, 500)] == [1000, 1000, 300, 300, 100, 100]
    scene = Scene(oscillator(10.0))
    measured = measured_limit(scene, lambda h: tmj.MuJoCo(h), 10.0, steps=100)
    # 0.5 % of the bisection, and growth seen from 0.8 % on: from 1e-11 of the size past ten times the floor of 3e-10
    # takes a factor of 300, and exp(100 · 7 · 0.008) = 270.
    assert measured.limit == pytest.approx(math.sqrt(8) / 10, rel=0.014)


def test_a_motion_that_is_large_from_the_first_sample_on_is_not_taken_for_a_stable_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # Growth that slack strings have stopped within the first quarter of the run: the quarters are alike.
    scene = Scene(oscillator(10.0))
    amplitude = study.AMPLITUDE * 2.0  # m a step: the structure is 2 m long

    def run(reach: float) -> Any:
        nodes = np.repeat(scene.nodes0[None], 9, axis=0)
        nodes[1:, 2, 1] = reach  # across the strings, whose lengths then hardly change
        return lambda *_: tmj.simulate(scene, None, tmj.MuJoCo(1e-3), duration=8e-3, output_interval=1e-3).__class__(
            **{**vars(tmj.simulate(scene, None, tmj.MuJoCo(1e-3), duration=8e-3, output_interval=1e-3)), "nodes": nodes}
        )

    monkeypatch.setattr(study, "_run", run(1.01 * study.FAR * amplitude * 100))
    assert "grew to" in study._why_unstable(scene, tmj.MuJoCo(1e-3), True, 100)
    monkeypatch.setattr(study, "_run", run(0.99 * study.FAR * amplitude * 100))
    assert study._why_unstable(scene, tmj.MuJoCo(1e-3), True, 100) == ""


# The structures ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("planar", [False, True])
@pytest.mark.parametrize("rods", [1, 2, 6, 40])
def test_random_taut_structures_are_taut_and_in_stable_equilibrium(rods: int, planar: bool) -> None:
    structure = random_taut_structure(np.random.default_rng(rods), rods=rods, planar=planar, mass_ratio=100.0)
    lengths = structure.string_lengths(structure.positions)
    u = structure.stiffness * (1 - structure.rest_lengths / lengths)
    assert np.all(u > 0)
    # `find_equilibrium` ends at round-off: 8 ε of the largest pull and stiffness, times what meets at a node.
    assert np.abs(equilibrium_residual(structure, None, u)).max() < 1e-11 * np.max(u * lengths)
    model = model_of(structure)
    matrix = model.material + model.geometric
    matrix = matrix if isinstance(matrix, np.ndarray) else matrix.toarray()
    moves = np.abs(matrix).sum(axis=0) > 0
    assert np.linalg.eigvalsh(matrix[np.ix_(moves, moves)])[0] > 0
    again = random_taut_structure(np.random.default_rng(rods), rods=rods, planar=planar, mass_ratio=100.0)
    assert again == structure
    assert rods == 1 or structure.rod_masses.max() / structure.rod_masses.min() == pytest.approx(100.0)


@pytest.mark.parametrize(
    "bad", [{"rods": 0}, {"prestrain": (0.0, 0.1)}, {"mass_ratio": 0.5}, {"damping_ratio": (1, 0)}]
)
def test_random_taut_structures_refuse_what_cannot_be(bad: dict[str, Any]) -> None:
    with pytest.raises(OptionError):
        random_taut_structure(np.random.default_rng(0), **bad)


@pytest.mark.parametrize("axis", [axis for axis in AXES if axis != "rods"])
def test_the_maps_vary_one_property_of_an_equilibrium(axis: str) -> None:
    base, text = base_structure(tmj.load_scene("prism"))
    assert "self-stress" in text
    for value in AXES[axis][1]:
        structure = varied(base, axis, value)
        u = structure.stiffness * (1 - structure.rest_lengths / structure.string_lengths(structure.positions))
        pull = np.maximum(0.0, u)
        scale = np.max(pull * structure.string_lengths(structure.positions), initial=1e-6)
        # Rest lengths have 16 digits: of u that leaves 1e-16 k.
        residual = np.abs(equilibrium_residual(structure, None, pull)).max()
        assert residual < 1e-12 * scale + 1e-15 * structure.stiffness.max()
        tallness = np.ptp(structure.positions, axis=0) / np.ptp(base.positions, axis=0)
        np.testing.assert_allclose(tallness, [1, 1, value if axis == "slenderness" else 1], rtol=1e-12)
        mass = float(structure.rod_masses[0] / structure.rod_masses[1])
        assert mass == pytest.approx(value if axis == "mass_ratio" else 1.0)
        assert structure.stiffness.max() == pytest.approx(value if axis == "stiffness" else 1000.0)
        if axis == "prestress":
            assert np.max(pull / structure.stiffness) == pytest.approx(value, abs=1e-15)
        zeta = structure.damping / (2 * np.sqrt(structure.stiffness * 0.25 * structure.rod_masses.mean()))
        np.testing.assert_allclose(zeta, value if axis == "damping" else 0.0)


def test_points_of_random_structures_are_the_same_each_time_and_no_two_alike() -> None:
    points = random_points(12, 3)
    assert points == random_points(20, 3)[:12]
    assert points != random_points(12, 4)
    assert len({point["seed"] for point in points}) == 12
    assert structure_of(points[0]) == structure_of(points[0])


def test_what_differs_is_explained() -> None:
    # Strings without tension pull during half of a motion: measured is what no linear model shows.
    structure = tmj.load_scene("cross").structure
    found = at_rest(Scene(structure), "euler")
    assert abs(found["ratio"] - 1) > AGREEMENT
    assert "edge of slackness" in found["cause"]


def test_masses_scale_the_limit() -> None:
    structure = random_taut_structure(np.random.default_rng(9), rods=3)
    heavy = replace(structure, rods=tuple(replace(rod, mass=4 * rod.mass) for rod in structure.rods))
    for name in ("euler", "rk4"):
        assert limit(heavy, name) == pytest.approx(2 * limit(structure, name), rel=1e-12)
