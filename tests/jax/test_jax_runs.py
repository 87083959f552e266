"""Runs of the differentiable engine against the DAE's: motion, ledger of energy, breaks, order, many at once."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from features import FEATURES
from linked_scenes import hung

import tensegrity_mj as tmj
from tensegrity_mj.errors import DivergenceError, OptionError

pytest.importorskip("jax")
pytest.importorskip("diffrax")

DURATION, INTERVAL = 0.4, 0.02  # s
REFERENCE = tmj.DAE(rtol=1e-12, atol=1e-13)
FINE = tmj.JAX(rtol=1e-12, atol=1e-13)
# Both engines' own tolerances, of motions of 1 m and energies of 10 J: some ten times rtol each.
FLOOR, ENERGY_FLOOR = 4e-11, 4e-10
RUN: dict[str, Any] = {"duration": DURATION, "output_interval": INTERVAL}
REFUSED = ("contact", "strings that yield", "states of elements")
# Each is compiled for seconds. Right-hand sides of all are compared elsewhere: these have all kinds of ledgers.
SOME = (
    "paths, moved supports",
    "bodies",
    "masses on rods, water",
    "elastic rods, resistance",
    "tension curves",
    "constraints, moved",
    "breaks",
    "water, Hermite",
    "surface",
)
ALL = [pytest.param(name, marks=() if name in SOME else pytest.mark.study) for name in FEATURES if name not in REFUSED]


@pytest.mark.parametrize("name", ALL)
def test_motion_and_ledger_are_those_of_the_dae(name: str) -> None:
    scene = FEATURES[name].scene()
    found, expected = tmj.simulate(scene, None, FINE, **RUN), tmj.simulate(scene, None, REFERENCE, **RUN)
    print(f"{name}: {tmj.compare(found, expected).max_node_error} m, {found.energy_residual} J")
    assert tmj.compare(found, expected).max_node_error < FLOOR
    assert found.energy_residual < ENERGY_FLOOR
    for term in ("external_work", "dissipation", "winch_work", "string_energy", "kinetic_energy"):
        np.testing.assert_allclose(getattr(found, term), getattr(expected, term), atol=ENERGY_FLOOR)
    scale = float(np.abs(expected.rod_forces).max(initial=1.0))
    np.testing.assert_allclose(found.rod_forces, expected.rod_forces, atol=1e-7 * scale)
    np.testing.assert_allclose(found.constraint_forces, expected.constraint_forces, atol=1e-7 * scale)
    np.testing.assert_allclose(found.tensions, expected.tensions, atol=1e-7 * scale)


@pytest.mark.parametrize("name", ["moved supports", "breaks"])
def test_fixed_steps_have_the_fourth_order(name: str) -> None:
    scene = FEATURES[name].scene()
    reference = tmj.simulate(scene, None, REFERENCE, **RUN)
    coarse, fine = (
        tmj.compare(tmj.simulate(scene, None, tmj.JAX(method="rk4", timestep=h), **RUN), reference).max_node_error
        for h in (2e-3, 1e-3)
    )
    # As in test_features.py: the next term of the error is within half an order.
    assert fine <= max(coarse / 2**3.5, FLOOR)
    assert coarse < 1e-2


def test_many_at_once_are_what_one_is() -> None:
    """The same operations on longer arrays, but for the order of sums: round-off, grown by 400 steps."""
    scene = hung()
    factors = (1.0, 0.9, 1.1)
    scenes = [
        scene.with_(structure=scene.structure.with_strings(rest_length=f * scene.structure.rest_lengths, damping=f))
        for f in factors
    ]
    engine = tmj.JAX(method="rk4", timestep=1e-3)
    together = tmj.simulate_many(scenes, None, engine, **RUN)
    for one, run in zip(scenes, together, strict=True):
        alone = tmj.simulate(one, None, engine, **RUN)
        np.testing.assert_allclose(run.nodes, alone.nodes, atol=1e-12)
        np.testing.assert_allclose(run.dissipation, alone.dissipation, atol=1e-11)
        assert run.energy_residual == pytest.approx(alone.energy_residual, abs=1e-11)
    assert np.abs(together.nodes[0] - together.nodes[1]).max() > 1e-3


def test_many_differ_in_starts_and_strings_alone() -> None:
    scene, engine = hung(), tmj.JAX(method="rk4", timestep=1e-3)
    with pytest.raises(OptionError, match="gravity differ"):
        tmj.simulate_many([scene, scene.with_(gravity=(0, 0, -1))], None, engine, **RUN)
    with pytest.raises(OptionError, match=r"Method\.RK4"):
        tmj.simulate_many([scene], None, tmj.JAX(), **RUN)


def test_a_run_beyond_its_stable_step_diverges_with_the_time_and_what_was_recorded() -> None:
    structure = hung().structure.with_strings(stiffness=1e9, rest_length=0.1)
    with (
        pytest.warns(tmj.errors.StabilityWarning),
        pytest.raises(DivergenceError, match=r"reduce the time step \(h = 0.01 s\)") as error,
    ):
        tmj.simulate(hung().with_(structure=structure), None, tmj.JAX(method="rk4", timestep=1e-2), duration=0.5)
    assert isinstance(error.value.trajectory, tmj.Trajectory)
