"""Laws that account for water: exact where they know all, wrong by what statics says where not; and winch power."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from engine_accelerations import mujoco_accelerations_at

import tensegrity_mj as tmj
from tensegrity_mj.controllers import (
    FeedbackLinearization,
    KnownWater,
    Lyapunov,
    Onto,
    Projection,
    from_scene,
)
from tensegrity_mj.model.actuation import Actuation
from tensegrity_mj.model.elements.water import water_forces

FINE = tmj.DAE(rtol=1e-11, atol=1e-12)
BARE = {"drag": 0.0, "added_mass": 0.0, "inertia": 0.0}


def scene() -> tmj.Scene:
    return tmj.load_scene("shape_control")


def held(current: float) -> tmj.Scene:
    """The start as the target, in another current."""
    moving = scene()
    water = replace(moving.water, current=(current, 0.0, 0.0))
    return moving.with_(target=tmj.Target.set_point(moving.nodes0), water=water)


def waves(of: tmj.Scene) -> tmj.Scene:
    return of.with_(water=replace(of.water, waves=(tmj.model.Wave(0.5, 15.0, direction=0.4),), tangential_drag=0.1))


def pierced(of: tmj.Scene) -> tmj.Scene:
    """With the rods half out of the water."""
    up = {name: (x, y, z + 7.5) for name, (x, y, z) in of.structure.nodes.items()}
    return of.with_(structure=replace(of.structure, nodes=up), target=None, control=None)


def state(of: tmj.Scene, seed: int):
    """Positions and velocities near the target that rods and supports allow."""
    rng, structure = np.random.default_rng(seed), of.structure
    nodes, velocities = of.nodes0.copy(), np.zeros_like(of.nodes0)
    for rod, (i, j) in zip(structure.rods, structure.rod_nodes, strict=True):
        E = rod.support.translation_basis
        shift, rate = E @ rng.normal(0, 0.05, E.shape[1]), E @ rng.normal(0, 0.3, E.shape[1])
        b = nodes[j] - nodes[i] + rng.normal(0, 0.1, 3)
        b *= np.linalg.norm(of.nodes0[j] - of.nodes0[i]) / np.linalg.norm(b)
        nodes[i] += shift
        nodes[j], velocities[i] = nodes[i] + b, rate
        velocities[j] = rate + np.cross(rng.normal(0, 0.3, 3), b)
    return nodes, velocities


@pytest.mark.parametrize("weights", list(tmj.model.Weights))
@pytest.mark.parametrize("seed", range(3))
def test_the_engine_accelerates_as_the_laws_foresee(seed: int, weights: tmj.model.Weights) -> None:
    # Both solve the same equations for the same forces, to round-off of accelerations of up to 1e2 m/s²; V̇ has terms of
    # up to 1e2 too. HERMITE makes α of rods that are partly wet unsymmetric, which the quadratic laws need transposed.
    of = pierced(waves(scene()))
    of = of.with_(water=replace(of.water, weights=weights))
    nodes, velocities = state(of, seed)
    rng = np.random.default_rng(100 + seed)
    u = rng.uniform(0, 200, len(of.structure.strings))
    acc = mujoco_accelerations_at(of, nodes, velocities, u)
    aim = of.nodes0
    for law in (
        Lyapunov(of.structure, aim, gravity=of.gravity, known=(of.water,)),
        Projection(of.structure, aim, gravity=of.gravity, known=(of.water,), stiffness=0.3),
        Projection(of.structure, aim, gravity=of.gravity, known=(of.water,), onto=Onto.TARGET),
    ):
        terms = law.terms(0.0, nodes, velocities)
        step = 1e-5  # V is smooth: the error is step² V⃛/6 of some 1e4 /s³, 2e-7, and round-off 1e-10
        V = [
            sum(law.terms(0.0, nodes + h * velocities + h**2 / 2 * acc, velocities + h * acc)[:2])
            for h in (-step, step)
        ]
        foreseen = terms.beta - terms.f @ u
        assert (V[1] - V[0]) / (2 * step) == pytest.approx(foreseen, abs=1e-6 * max(1.0, np.abs(terms.f) @ u))
        dry = replace(law, known=()).terms(0.0, nodes, velocities)
        assert abs(dry.beta - dry.f @ u - foreseen) > 1e-2  # it matters
    law = FeedbackLinearization(of.structure, aim, gravity=of.gravity, known=(of.water,))
    A, d, e = law.equation(0.0, nodes, velocities)
    # ë of the engine, by differences of the law's own ė, is -K_p e - K_d ė + A u - d.
    rates = [law.error(0.0, nodes + h * velocities, velocities + h * acc)[1] for h in (-1e-5, 1e-5)]
    np.testing.assert_allclose((rates[1] - rates[0]) / 2e-5, A @ u - d - e[0] - 2 * e[1], rtol=1e-6, atol=1e-5)


@pytest.mark.parametrize("kind", ["lyapunov", "projection"])
def test_v_decays_as_promised_in_waves_and_current(kind: str) -> None:
    # V follows V(0) e^{-δt} but for the integrator's error: rtol 1e-10 in each step; its steps add.
    aim = scene().target.nodes[-1]
    of = waves(scene()).with_(target=tmj.Target.set_point(aim), control=None)
    law = from_scene(of, kind, decay_rate=1.0)
    run = tmj.simulate(of, law, tmj.DAE(rtol=1e-10, atol=1e-11), duration=0.5)
    np.testing.assert_allclose(run.lyapunov, run.lyapunov[0] * np.exp(-run.time), rtol=1e-7)
    assert "warnings" not in run.reports or not any("reckons" in text for text in run.reports["warnings"])
    # Without the knowledge the promise is broken at once, and a warning says so.
    blind = tmj.simulate(of, from_scene(of, kind, water="still"), FINE, duration=0.02)
    assert np.max(np.abs(blind.lyapunov / (blind.lyapunov[0] * np.exp(-blind.time)) - 1)) > 1e-3
    assert any("other water than the scene's" in text for text in blind.reports["warnings"])


def test_the_path_is_kept_in_both_engines() -> None:
    # The start is on the path (force densities are kept to 1e-10 N/m), and the law leaves ë = -K_p e - K_d ė:
    # all errors are the engine's. RK4 has an error of h⁴ times a constant, which its runs show: 2.6e-10 m at 20 ms.
    of = scene()
    reference = tmj.simulate(of, from_scene(of), FINE, duration=4.0, output_interval=0.02)
    errors = []
    for step in (0.02, 0.01):
        run = tmj.simulate(of, from_scene(of), tmj.MuJoCo(step), duration=4.0, output_interval=0.02)
        errors.append(tmj.compare(run, reference).max_node_error)
        assert run.target_error().max() < 1e-9
        assert run.winch_work == pytest.approx(reference.winch_work, abs=1e-7 * np.abs(reference.winch_work).max())
    assert errors[0] < 1e-9
    assert errors[1] < errors[0] / 8


def mass_matrix(of: tmj.Scene, jacobian):
    """Jᵀ (rods' mass + α P) J: energy of uniform rods m/6 [[2, 1], [1, 2]], and of the water that they move."""
    nodes = of.nodes0
    _, alpha = water_forces(of, 0.0, nodes, np.zeros_like(nodes))
    whole = np.zeros((nodes.size, nodes.size))
    for row, (rod, pair) in enumerate(zip(of.structure.rods, of.structure.rod_nodes, strict=True)):
        b = nodes[pair[1]] - nodes[pair[0]]
        across = np.eye(3) - np.outer(b, b) / (b @ b)
        for a in range(2):
            for c in range(2):
                block = rod.mass / 6 * (2 if a == c else 1) * np.eye(3) + alpha[row, a, c] * across
                whole[3 * pair[a] : 3 * pair[a] + 3, 3 * pair[c] : 3 * pair[c] + 3] += block
    return jacobian.T @ whole @ jacobian


def jacobian_of(of: tmj.Scene):
    """∂nodes/∂q (3N, n) of z and the angles (θ, φ), σ = 0: the second node goes with b = (cθ sφ, sθ sφ, cφ)."""
    columns = []
    for rod, (i, j) in zip(of.structure.rods, of.structure.rod_nodes, strict=True):
        span = of.nodes0[j] - of.nodes0[i]
        for direction in rod.support.translation_basis.T:
            column = np.zeros_like(of.nodes0)
            column[i] = column[j] = direction
            columns.append(column.ravel())
        flat = np.hypot(span[0], span[1])
        for turn in ((-span[1], span[0], 0.0), (span[2] * span[0] / flat, span[2] * span[1] / flat, -flat)):
            column = np.zeros_like(of.nodes0)
            column[j] = turn
            columns.append(column.ravel())
    return np.array(columns).T


@pytest.mark.parametrize("frequency", [10.0, 20.0])
def test_an_unknown_current_bends_the_shape_as_springs_would(frequency: float) -> None:
    # The law makes each coordinate a spring of the stiffness ω_o² M, M with added mass: M ω_o² e = Jᵀ (F - F_still). To
    # first order: the rest is about e² times the coefficients of curvature, some units.
    of = held(0.5)
    law = from_scene(of, water="still", natural_frequency=frequency)
    run = tmj.simulate(of, law, tmj.MuJoCo(5e-3), duration=40.0 / frequency)
    e, rate = law.error(run.time[-1], run.nodes[-1], run.velocities[-1])
    still = of.with_(water=KnownWater.STILL.of(of.water))
    J, at_rest = jacobian_of(of), np.zeros_like(of.nodes0)
    unknown = water_forces(of, 0.0, of.nodes0, at_rest)[0] - water_forces(still, 0.0, of.nodes0, at_rest)[0]
    predicted = np.linalg.solve(frequency**2 * mass_matrix(of, J), J.T @ unknown.ravel())
    size = np.abs(predicted).max()
    assert size > 1e-3
    # What is left of the transient: e^{-40} (1 + 40) of it.
    assert np.abs(rate).max() < 1e-8
    assert np.abs(e - predicted).max() < 5 * size**2 + 1e-6 * size
    # And a law that knows holds the shape.
    known = from_scene(of, natural_frequency=frequency)
    assert tmj.simulate(of, known, tmj.MuJoCo(5e-3), duration=1.0).target_error().max() < 1e-9


def test_water_that_does_nothing_changes_nothing() -> None:
    # No drag, no added mass, and weight as much less as water lifts: the dry run under the rest of gravity. Buoyancy of
    # uniform rods is a uniform force, so that equations are the same to round-off; 2 s at rates of some 10 /s.
    of = scene()
    rod = of.structure.rods[0]
    length = float(of.structure.rod_lengths[0])
    lift = of.water.density * np.pi * rod.radius**2 * length / rod.mass  # of the weight
    wet = of.with_(water=replace(of.water, current=(0, 0, 0), **BARE))
    dry = of.with_(water=None, gravity=(0.0, 0.0, -9.81 * (1 - lift)))
    for options in ({}, {"natural_frequency": 5.0}):
        runs = [tmj.simulate(s, from_scene(s, **options), tmj.MuJoCo(0.01), duration=2.0) for s in (wet, dry)]
        assert np.max(np.abs(runs[0].nodes - runs[1].nodes)) < 1e-10
        assert np.max(np.abs(runs[0].force_densities - runs[1].force_densities)) < 1e-8
        assert np.max(np.abs(runs[0].winch_work - runs[1].winch_work)) < 1e-8


def test_winch_power_integrates_to_winch_work() -> None:
    of = scene()
    errors = []
    for interval in (0.1, 0.05):
        run = tmj.simulate(of, from_scene(of), tmj.MuJoCo(0.01), duration=4.0, output_interval=interval)
        power = tmj.runs.winch_power(run)
        assert power.shape == (len(run.time) - 1, len(of.structure.strings))
        errors.append(abs((power.sum(axis=1) * np.diff(run.time)).sum() - run.winch_work[-1]))
    assert errors[1] == pytest.approx(errors[0] / 4, rel=0.1)  # the trapezoidal rule's second order
    assert errors[1] < 1e-3 * abs(run.winch_work[-1])
    # Its sign: a winch that hauls against tension does work, P = -T dL0/dt.
    hauls = np.diff(run.rest_lengths, axis=0) < -1e-9
    assert hauls.any()
    assert np.all(power[hauls & (run.tensions[1:] > 1) & (run.tensions[:-1] > 1)] > 0)
    # Sampled, every sample recorded: exact but for the step's error, as the ledger has it.
    for mode in (Actuation.hold_force_density, Actuation.hold_rest_length):
        run = tmj.simulate(
            of, from_scene(of), tmj.MuJoCo(2e-3), duration=0.5, actuation=mode(0.01), output_interval=0.01
        )
        total = (tmj.runs.winch_power(run).sum(axis=1) * np.diff(run.time)).sum()
        assert total == pytest.approx(run.winch_work[-1] - run.winch_work[0], abs=1e-6)
    # A shape that is held in a steady current costs tension, but no power.
    for current in (0.0, 1.0):
        still = held(current)
        run = tmj.simulate(still, from_scene(still), tmj.MuJoCo(0.01), duration=1.0)
        assert np.abs(tmj.runs.winch_power(run)).max() < 1e-9 * run.tensions.max()


def test_what_laws_know_of_water_is_reported_and_checked() -> None:
    of = scene()
    assert from_scene(of).known == (of.water,)
    assert from_scene(of, water=KnownWater.NONE).known == ()
    assert from_scene(of, water="still").known == (replace(of.water, current=(0.0, 0.0, 0.0)),)
    assert from_scene(of.with_(water=None), water="all").known == ()
    with pytest.raises(
        tmj.errors.OptionError, match=r"water = 'some'; it must be one of .* its text \(all, still, none\)"
    ):
        from_scene(of, water="some")
    for law in (FeedbackLinearization, Lyapunov, Projection):
        with pytest.raises(tmj.errors.SceneError, match="density = 0"):
            law(of.structure, of.target, known=(replace(of.water, density=0.0),))
        with pytest.raises(tmj.errors.OptionError, match="known = 'sea'; it must hold"):
            law(of.structure, of.target, known="sea")
        with pytest.raises(tmj.errors.OptionError, match="2 of Water; a scene has one"):
            law(of.structure, of.target, known=(of.water, of.water))
        reported = law(of.structure, of.target, gravity=of.gravity, known=(of.water,)).describe()
        assert reported["water"]["current"] == [1.0, 0.0, 0.0]
        assert "water" not in law(of.structure, of.target).describe()
        made = law(of.structure, of.target, gravity=of.gravity, known=(of.water,))
        assert made.native(of.structure).stateless is (law is not FeedbackLinearization)  # which starts from its last u
    # For an instant: to make up for drag that is not there is to push ever harder.
    run = tmj.simulate(of.with_(water=None), from_scene(of), tmj.MuJoCo(1e-3), duration=0.01)
    assert any("assumes water, and the scene has none" in text for text in run.reports["warnings"])
    # The weight of rods that do not float would need strings that push.
    none = from_scene(of, water="none")
    run = tmj.simulate(of, none, tmj.MuJoCo(0.01), duration=0.1)
    assert run.status is tmj.Status.INFEASIBLE
    assert "no admissible force densities" in run.message


def test_a_law_that_knows_of_water_keeps_nothing_between_its_calls() -> None:
    of, engine = waves(scene()), tmj.MuJoCo(1e-3)
    law = Lyapunov(of.structure, of.target, gravity=of.gravity, known=(of.water,), minimum_force_density=1.0)
    alone = tmj.simulate(of, law, engine, duration=0.02)
    with tmj.law_in(of, law, engine) as model:
        data = mujoco.MjData(model)
        mujoco.mj_step(model, data, 20)
    mujoco.mj_kinematics(model, data)
    sites = [model.site(name).id for name in of.structure.nodes]
    # The same compiled code, at times that MjData.time adds up where `simulate` multiplies: 20 times 1e-17 s.
    assert np.abs(data.site_xpos[sites] - alone.nodes[-1]).max() < 1e-13
