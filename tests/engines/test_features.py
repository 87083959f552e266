"""Whatever may act on a structure, in every engine that has it: the same motion, and an energy ledger that closes.

The engines share no equation of motion, and each integrates the work of forces beside its state. What one of them left
out of the motion would show between them; what it left out of the ledger would show as a residual. Both must fall with
the step as its order says, and each feature must matter, or the test is empty.
"""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np
import pytest
from features import FEATURES
from numpy.typing import NDArray

import tensegrity_mj as tmj

REFERENCE = tmj.DAE(rtol=1e-12, atol=1e-13)
# [s] Each term of the motion turns by some radians. In 0.3 s the energy of bodies errs by more than the leading term.
DURATION, LONGER = 0.3, {"bodies": 0.5}
# What the reference's own tolerance leaves of motions of 1 m and energies of 10 J: some ten times rtol of each.
FLOOR, ENERGY_FLOOR = 2e-11, 2e-10

ENGINES: dict[str, Callable[[float], tmj.DAE | tmj.MuJoCo]] = {
    "dae": lambda step: tmj.DAE(method=tmj.Method.RK4, timestep=step),
    "general dae": lambda step: tmj.DAE(method=tmj.Method.RK4, timestep=step, solver=tmj.engines.Solver.GENERAL),
    "mujoco": lambda step: tmj.MuJoCo(timestep=step),
}


@functools.cache
def run(name: str, engine: tmj.DAE | tmj.MuJoCo, within: bool = True) -> tmj.Trajectory:
    feature = FEATURES[name]
    scene = feature.scene() if within else feature.without(feature.scene())
    return tmj.simulate(scene, None, engine, duration=LONGER.get(name, DURATION), output_interval=0.02)


def reference(name: str, within: bool = True) -> tmj.Trajectory:
    return run(name, REFERENCE if FEATURES[name].in_dae else tmj.MuJoCo(timestep=FEATURES[name].steps[1] / 8), within)


def falls(first: float, second: float, order: int, floor: float) -> bool:
    """Whether half the step leaves what an order says, or nothing beyond a floor.

    The next term of the error is h ω times the leading one, 0.05 for the fastest turn of about 25 /s at the coarser
    step: that and kinks of |u| u are within the half of an order that is allowed.
    """
    return second <= max(first / 2 ** (order - 0.5), floor)


CASES = [(name, engine) for name in FEATURES for engine in ENGINES if engine == "mujoco" or FEATURES[name].in_dae]


@pytest.mark.parametrize("name", FEATURES)
def test_it_matters(name: str) -> None:
    one, other = reference(name).nodes, reference(name, within=False).nodes
    count = min(one.shape[1], other.shape[1])  # points of strings with mass are behind the other nodes
    moved = np.abs(one[:, :count] - other[:, :count]).max()
    assert moved > 1e-3


@pytest.mark.parametrize(("name", "engine"), CASES)
def test_engines_agree(name: str, engine: str) -> None:
    errors = [
        tmj.compare(run(name, ENGINES[engine](step)), reference(name)).max_node_error for step in FEATURES[name].steps
    ]
    print(f"{name}, {engine}: {errors} m")
    assert falls(*errors, FEATURES[name].order, FLOOR)
    assert errors[0] < 1e-2


def exchanged(found: tmj.Trajectory) -> float:
    """The largest change of any term of the ledger [J]."""
    terms: tuple[NDArray[np.float64], ...] = (
        found.kinetic_energy,
        found.gravity_energy,
        found.string_energy,
        found.external_work,
        found.dissipation,
    )
    return max(float(np.ptp(term)) for term in terms)


@pytest.mark.parametrize(("name", "engine"), CASES)
def test_the_ledger_closes(name: str, engine: str) -> None:
    coarse, fine = (run(name, ENGINES[engine](step)) for step in FEATURES[name].steps)
    print(f"{name}, {engine}: {coarse.energy_residual} and {fine.energy_residual} of {exchanged(fine)} J")
    assert falls(coarse.energy_residual, fine.energy_residual, FEATURES[name].order, ENERGY_FLOOR)
    assert coarse.energy_residual < 1e-2 * exchanged(coarse)
    if FEATURES[name].in_dae:
        assert reference(name).energy_residual <= ENERGY_FLOOR
        for term in ("external_work", "dissipation"):
            assert getattr(fine, term) == pytest.approx(getattr(reference(name), term), abs=1e-5 * exchanged(fine))


@pytest.mark.parametrize("name", [name for name in FEATURES if FEATURES[name].in_dae])
def test_an_implicit_method_gives_the_same(name: str) -> None:
    """Radau with error control: its global error is at most some hundred times its tolerance of 1e-7."""
    found = run(name, tmj.DAE(method=tmj.Method.RADAU, rtol=1e-7, atol=1e-9))
    assert tmj.compare(found, reference(name)).max_node_error < 1e-5
    assert found.energy_residual < 1e-5 * exchanged(found)
