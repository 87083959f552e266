"""The energy ledger: kinetic + gravity + strings - winch work - external work + dissipation stays put."""

from __future__ import annotations

import numpy as np
import pytest

import tensegrity_mj as tmj
from tensegrity_mj.controllers import from_scene
from tensegrity_mj.families.random_structures import random_scene, random_structure

ACTUATIONS = {
    "continuous": tmj.Actuation.continuous(),
    "held force density": tmj.Actuation.hold_force_density(1e-2),
    "held rest length": tmj.Actuation.hold_rest_length(1e-2),
}


def rich_scene(seed, law=tmj.StringLaw.CLIPPED):
    rng = np.random.default_rng(seed)
    structure = random_structure(
        rng, rods=3, strings=8, point_masses=1, own_planes=0.3, damping=(0.5, 2.0), stretch=(0.0, 0.3), law=law
    )
    return random_scene(rng, structure, moving=1.0, gravity=True, loads=2, duration=1.0)


@pytest.mark.parametrize("law", list(tmj.StringLaw))
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
