"""The energy ledger: kinetic + gravity + strings - winch work - external work + dissipation stays put."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import tensegrity_mj as tmj
from evidence.random_structures import random_scene, random_structure
from evidence.random_taut import random_taut_structure
from tensegrity_mj.controllers import from_scene
from tensegrity_mj.model import rods
from tensegrity_mj.runs.energy import energy_exchanged

ACTUATIONS = {
    "continuous": tmj.Actuation.continuous(),
    "held force density": tmj.Actuation.hold_force_density(1e-2),
    "held rest length": tmj.Actuation.hold_rest_length(1e-2),
}


def rich_scene(seed, law=tmj.model.StringLaw.CLIPPED):
    rng = np.random.default_rng(seed)
    structure = random_structure(
        rng, rods=3, strings=8, point_masses=1, own_planes=0.3, damping=(0.5, 2.0), stretch=(0.0, 0.3), law=law
    )
    return random_scene(rng, structure, moving=1.0, gravity=True, loads=2, duration=1.0)


@pytest.mark.parametrize("law", list(tmj.model.StringLaw))
@pytest.mark.parametrize("seed", range(3))
def test_the_ledger_closes_with_dampers_loads_and_gravity(seed, law):
    scene = rich_scene(seed, law)
    run = tmj.simulate(scene, None, tmj.DAE(rtol=1e-12, atol=1e-13))
    terms = (run.kinetic_energy, run.gravity_energy, run.string_energy, run.external_work, run.dissipation)
    scale = max(np.ptp(term) for term in terms)
    assert min(np.ptp(term) for term in terms) > 1e-3 * scale, "every term must take part, or the test is empty"
    assert run.energy_residual <= 1e-9 * scale  # rtol 1e-12, a few hundred steps, kinks of the clipped law
    residuals = [tmj.simulate(scene, None, tmj.MuJoCo(h)).energy_residual for h in (2e-3, 1e-3, 5e-4)]
    print(
        f"seed {seed}, {law.value}: DAE {run.energy_residual:.1e}, MuJoCo at 2, 1, 0.5 ms: {residuals} of {scale:.1f} J"
    )
    # Order 4 where smooth; slack events leave order 2 with scatter. At least a factor of 4 over two halvings.
    assert residuals[2] <= max(residuals[0] / 4, 1e-12 * scale)


@pytest.mark.parametrize("name", list(ACTUATIONS))
def test_winch_work_closes_the_ledger_in_every_mode(name):
    scene = tmj.load_scene("prism")
    law = from_scene(scene)
    reference = tmj.simulate(scene, law, tmj.DAE(rtol=1e-12, atol=1e-14), duration=3.0, actuation=ACTUATIONS[name])
    # Round-off and rtol of works of about 0.01 J, over a few thousand steps.
    assert np.ptp(reference.winch_work) > 5e-3
    assert reference.energy_residual <= 1e-11
    run = tmj.simulate(scene, law, tmj.MuJoCo(1e-3), duration=3.0, actuation=ACTUATIONS[name])
    # Strings go slack between samples where a rest length is held: order 2 at 1 ms of 0.01 J.
    assert run.energy_residual <= 1e-8
    assert np.abs(run.winch_work - reference.winch_work).max() <= 1e-7


def test_winch_work_of_a_winch_alone():
    """One string, pulled in at constant speed on a pinned rod that cannot move: the work is the string's energy."""
    structure = tmj.Structure.from_arrays(
        [[0, 0, 0], [0, 0, 1], [0, 0, 3]],
        [[0, 1]],
        [[1, 2]],
        rod_mass=1.0,
        stiffness=5.0,
        fixed_nodes=[2],
        supports=[tmj.Support.pinned()],
    )

    class PullIn:
        command = tmj.Command.REST_LENGTH

        def __call__(self, time, nodes, velocities):
            return [2.0 - 0.5 * time]

    scene = tmj.Scene(structure, duration=2.0)
    for actuation in (tmj.Actuation.continuous(), tmj.Actuation.hold_rest_length(1e-2)):
        for engine in (tmj.MuJoCo(1e-2), tmj.DAE()):
            run = tmj.simulate(scene, PullIn(), engine, actuation=actuation)
            # Energy k (L - L0)²/2 with L = 2, L0 = 2 - t/2, from t = 0 on; sums of two hundred terms of round-off.
            assert run.winch_work == pytest.approx(0.5 * 5.0 * (0.5 * run.time) ** 2, abs=1e-13)


@pytest.mark.parametrize("integrator", list(tmj.Integrator))
def test_integrators_rank_by_the_energy_they_lose(integrator):
    """A free swing without any loss: RK4 keeps energy best, `discrete` loses most."""
    rng = np.random.default_rng(2)
    scene = random_scene(rng, random_structure(rng, rods=2, strings=6, stretch=(0.2, 0.4)), moving=0.5, duration=1.0)
    residual = tmj.simulate(scene, None, tmj.MuJoCo(1e-3, integrator)).energy_residual
    best = tmj.simulate(scene, None, tmj.MuJoCo(1e-3)).energy_residual
    worst = tmj.simulate(scene, None, tmj.MuJoCo(1e-3, tmj.Integrator.DISCRETE)).energy_residual
    assert best <= residual <= worst
    assert worst > 1e3 * best


def test_winch_work_is_the_integral_of_tension_over_rest_length():
    """Against a trapezoid over dense samples of T and L0 themselves, which knows no integration by parts."""
    scene = tmj.load_scene("prism")
    run = tmj.simulate(scene, from_scene(scene), tmj.DAE(rtol=1e-11, atol=1e-13), duration=2.0, output_interval=2e-4)
    T, L0 = run.tensions, run.rest_lengths
    pieces = -0.5 * (T[1:] + T[:-1]) * np.diff(L0, axis=0)
    summed = np.concatenate([[0.0], np.cumsum(pieces.sum(axis=1))])
    # Trapezoid: h²/12 T'' per second; T changes by 0.1 N within 0.1 s at the most, so 1e-8 · 10 / 12 · 2 s.
    assert np.abs(run.winch_work - summed).max() <= 1e-7
    assert np.ptp(summed) > 5e-3


@pytest.mark.parametrize("engine", [tmj.MuJoCo(1e-3), tmj.DAE()], ids=["MuJoCo", "DAE"])
def test_what_stands_still_is_not_warned_of(engine):
    """Where nothing is exchanged, the residual is round-off, however large a part of nothing it is."""
    hanging = tmj.Structure.from_arrays(
        [[0, 0, 0], [0.3, 0.4, -1.2]], [[0, 1]], [], rod_mass=1.0, stiffness=1.0, supports=[tmj.Support.pinned()]
    )
    along = tuple(-9.81 * np.array([-0.3, -0.4, 1.2]) / 1.3)
    run = tmj.simulate(tmj.Scene(hanging, gravity=along, duration=2.0), None, engine)
    assert run.kinetic_energy.max() < 1e-20
    assert run.reports["warnings"] == []


def taut_mass(speed: float) -> tmj.Scene:
    """1 kg between two strings of 1e5 N/m, each stretched by 0.1 m: they hold 1000 J, the motion speed²/2."""
    structure = tmj.Structure(
        "taut",
        {"left": (-1, 0, 0), "mass": (0, 0, 0), "right": (1, 0, 0)},
        strings=(
            tmj.String("a", ("left", "mass"), 1e5, rest_length=0.9),
            tmj.String("b", ("mass", "right"), 1e5, rest_length=0.9),
        ),
        fixed_nodes=("left", "right"),
        point_masses=(tmj.PointMass("mass", 1.0),),
    )
    return tmj.Scene(structure, initial_velocities=[[0, 0, 0], [speed, 0, 0], [0, 0, 0]], duration=0.2)


def test_prestress_does_not_hide_that_a_vibration_is_lost():
    """ω² = 2e5: at ω h = 0.089 `discrete` damps by ζ = ω h / 2 = 0.045 and leaves e^(-2 ζ ω t) = e^(-8) of 5e-5 J."""
    scene = taut_mass(0.01)
    h = 2e-4
    lossy = tmj.simulate(scene, None, tmj.MuJoCo(h, tmj.Integrator.DISCRETE))
    assert lossy.string_energy[0] == pytest.approx(1000.0)
    assert lossy.energy_residual == pytest.approx(5e-5, rel=1e-3)  # all of it; and 5e-8 of what the strings hold
    # The works of both strings cancel but for k x², which is the kinetic energy's counterpart: 5e-5 J at the most.
    assert energy_exchanged(lossy)[-1] == pytest.approx(5e-5, rel=1e-3)
    assert any("energy balance" in warning for warning in lossy.reports["warnings"])
    # RK4 loses (ω h)⁶ / 72 of the energy a step: 1000 steps of 7.1e-9.
    good = tmj.simulate(scene, None, tmj.MuJoCo(h))
    assert good.energy_residual < 1e-5 * 5e-5 + 1e-12 * 1e3
    assert good.reports["warnings"] == []


@pytest.mark.parametrize("engine", [tmj.MuJoCo(1e-3), tmj.DAE()], ids=["MuJoCo", "DAE"])
def test_what_prestress_holds_at_rest_is_not_warned_of(engine):
    """Nothing moves in a balance: what round-off of 1000 J makes is no loss."""
    run = tmj.simulate(taut_mass(0.0), None, engine)
    assert energy_exchanged(run)[-1] < 1e-9
    assert run.reports["warnings"] == []


def test_what_is_exchanged_is_the_largest_of_what_moved():
    """Each term by itself, from arrays that are made up."""
    run = tmj.simulate(taut_mass(0.01), None, tmj.MuJoCo(2e-4))
    zero = np.zeros_like(run.time)
    still = dict.fromkeys(("kinetic_energy", "winch_work", "external_work", "dissipation"), zero)
    bare = replace(run, **still, string_energy=zero + 7.0, gravity_energy=zero - 3.0)
    assert not energy_exchanged(bare).any()
    bump = np.where(np.arange(len(zero)) == 5, 2.0, 0.0)
    for name in (*still, "string_energy", "gravity_energy"):
        found = energy_exchanged(replace(bare, **{name: getattr(bare, name) - bump}))
        assert np.array_equal(found, np.where(np.arange(len(zero)) >= 5, 2.0, 0.0))
    # Winches that put in what the strings then hold: no work of the strings on anything that moves.
    both = replace(bare, string_energy=bare.string_energy + bump, winch_work=bump)
    assert not energy_exchanged(both).any()


def test_rods_that_drift_by_a_tolerance_under_prestress_are_not_warned_of():
    """At rest the DAE's rods drift by its tolerance, and 100 N times that is all its residual: nothing moved."""
    structure = random_taut_structure(np.random.default_rng(1), rods=3, stiffness=1e5, prestrain=(1e-3, 0.1))
    run = tmj.simulate(tmj.Scene(structure, duration=1.0), None, tmj.DAE(rtol=1e-6, atol=1e-8))
    assert np.abs(run.nodes - run.nodes[0]).max() < 1e-7
    assert run.energy_residual > 10 * energy_exchanged(run)[-1] * 0.01  # or the test would be empty
    assert run.reports["warnings"] == []
    # The power of a rod's force density over ℓ² bᵀb: half of the product.
    first, second = rods.ends(structure, run.nodes)
    drift = np.sum((second - first) ** 2, axis=-1) - structure.rod_lengths**2
    done = 0.5 * np.sum(run.rod_force_densities * drift, axis=1)
    assert np.abs(done).max() == pytest.approx(run.energy_residual, rel=0.1)
