"""Both engines against trajectories that other codes computed (STEDY, see the README of the reference data).

Bounds in metres are the project's own: 1e-10 for the three slow files, 1e-9 for the two stiff ones, whose own two
codes differ by 2e-12 and 5e-12. A velocity may be off by the largest natural frequency times as much, and the work of
a force by that force times as much.

What slack strings do to fixed steps. The tension is continuous but has a kink at L = L0; with damping it jumps there.
- tbar_undamped: string 3 comes back to L0 at t = 1.8 s without crossing it. A Runge-Kutta stage is off by O(h²), so
  during a time of O(h) stages see it slack that is not: a wrong force of k O(h²) for a time O(h), order 3.
- tbar_damped: string 3 starts at L = L0 exactly, where the law jumps by c dL/dt: whether the first stages see a
  damper is decided by the last bit of L. Rest lengths shorter by 1e-12 of themselves leave no choice, and
  move nothing by more than about 1e-11 m.
- ball: strings slacken while moving. The step with the kink is off by O(h²) instead of O(h⁵); at the steps used
  here that is still hidden below the smooth error of order 4.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pytest
import truth
from engine_accelerations import dae_accelerations, mujoco_accelerations
from numpy.typing import NDArray
from stedy import largest_frequency, scene_of

import tensegrity_mj as tmj
from tensegrity_mj.model.scene import Scene

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Case:
    """One file, and how it is to be met.

    Attributes:
        bound: on node positions, DAE, over the whole file [m].
        force: the largest force that does external or damper work [N].
        steps: of the fixed-step methods [s]: within the window where the error's leading term rules.
        order: of that term.
        mujoco_bound: on node positions at the finest step [m].
        radau_rtol: loose enough to be quick, since an order 5 method needs many steps.
    """

    name: str
    bound: float
    force: float
    steps: tuple[float, float, float]
    order: int
    mujoco_bound: float
    radau_rtol: float


CASES = [
    Case("pendulum", 1e-10, 0.0, (1e-2, 5e-3, 2.5e-3), 4, 1e-8, 1e-9),
    Case("tbar_undamped", 1e-10, 0.0, (1e-3, 5e-4, 2.5e-4), 3, 1e-8, 1e-9),
    # three dampers of 1 N s/m, at up to 3.1 m/s
    Case("tbar_damped", 1e-10, 10.0, (1e-2, 5e-3, 2.5e-3), 4, 1e-8, 1e-9),
    Case("prism_free_undamped", 1e-9, 0.0, (1e-3, 5e-4, 2.5e-4), 4, 1e-8, 1e-8),
    # three loads of 30 N
    Case("ball", 1e-9, 90.0, (1e-3, 5e-4, 2.5e-4), 4, 1e-6, 1e-8),
]
QUICK_BY_RADAU = [case for case in CASES if not case.name.endswith("undamped")]  # undamped ones take thousands of steps
every_case = pytest.mark.parametrize("case", CASES, ids=[case.name for case in CASES])


def load(case: Case) -> tuple[dict[str, Array], Scene]:
    data = truth.load(f"stedy_{case.name}")
    return data, scene_of(data)


def simulated(scene: Scene, data: dict[str, Array], engine: tmj.DAE | tmj.MuJoCo) -> tmj.Trajectory:
    """A run with output at the file's times."""
    run = tmj.simulate(scene, None, engine, output_interval=float(data["t"][1]))
    np.testing.assert_allclose(run.time, data["t"], rtol=0, atol=1e-12)
    return run


def position_error(run: tmj.Trajectory, data: dict[str, Array]) -> float:
    return float(np.linalg.norm(run.nodes - data["pos"], axis=-1).max())


@every_case
def test_dae_follows_the_reference_over_the_whole_file(case: Case) -> None:
    data, scene = load(case)
    run = simulated(scene, data, tmj.DAE(method=tmj.Method.DOP853, rtol=1e-13, atol=1e-14))
    nodes = position_error(run, data)
    velocities = np.linalg.norm(run.velocities - data["vel"], axis=-1).max()
    work = np.abs(run.external_work - run.dissipation - data["work"]).max()
    print(f"DAE DOP853, {case.name}: {nodes:.1e} m, {velocities:.1e} m/s, {work:.1e} J")
    assert nodes <= case.bound
    assert velocities <= case.bound * largest_frequency(data)
    assert work <= case.bound * case.force


@pytest.mark.filterwarnings("error::RuntimeWarning")  # an overflow on the way is no result
@pytest.mark.parametrize("case", QUICK_BY_RADAU, ids=[case.name for case in QUICK_BY_RADAU])
def test_radau_follows_the_reference_over_the_whole_file(case: Case) -> None:
    data, scene = load(case)
    run = simulated(scene, data, tmj.DAE(method=tmj.Method.RADAU, rtol=case.radau_rtol, atol=1e-2 * case.radau_rtol))
    error = position_error(run, data)
    print(f"DAE Radau, {case.name}: {error:.1e} m")
    assert error <= case.bound


@every_case
def test_rk4_of_both_engines_converges_to_the_reference_at_its_order(case: Case) -> None:
    data, scene = load(case)
    if case.name == "tbar_damped":
        structure = scene.structure
        scene = scene.with_(structure=structure.with_strings(rest_length=structure.rest_lengths * (1 - 1e-12)))
    for name, engine in (
        ("MuJoCo", lambda h: tmj.MuJoCo(timestep=h)),
        ("DAE", lambda h: tmj.DAE(method=tmj.Method.RK4, timestep=h)),
    ):
        errors = [position_error(simulated(scene, data, engine(h)), data) for h in case.steps]
        orders = [float(np.log2(coarse / fine)) for coarse, fine in pairwise(errors)]
        listed = ", ".join(f"{h:g} s {e:.1e} m" for h, e in zip(case.steps, errors, strict=True))
        print(f"{name} RK4, {case.name}: {listed}; orders {np.round(orders, 2)}")
        # A next term that is a fifth of the leading one at the coarsest step shifts the first order by 0.15.
        assert orders == pytest.approx([case.order] * 2, abs=0.15)
        assert errors[-1] <= case.mujoco_bound


@every_case
def test_initial_accelerations(case: Case) -> None:
    data, scene = load(case)
    expected = data["acc0"].reshape(-1, 3)
    # Round-off: a length of about 1 m has eps, times k it is a force, over a thin rod's quarter mass an acceleration;
    # a dozen strings and operations on each.
    heaviest_pull = float(np.max(data["k"], initial=1.0)) / (0.25 * data["bar_mass"].min())
    bound = 100 * np.finfo(float).eps * max(heaviest_pull, np.abs(expected).max())
    for name, accelerations in (("DAE", dae_accelerations), ("MuJoCo", mujoco_accelerations)):
        error = np.abs(accelerations(scene) - expected).max()
        print(f"{name}, {case.name}: {error:.1e} of {np.abs(expected).max():.1e} m/s²")
        assert error <= bound


def test_the_dbar_of_mujoco_nears_the_reference_as_rk4_of_the_dae_does() -> None:
    """A loop, and a string that goes slack and taut 36 times: of order 1, whatever holds the loop together.

    A step sees any part of a jump c V h and of a kink k V h² / 2 at each instant. They turn the bars, of I = 0.68 kg m²
    for the angle, by 1.74 m per rad; the loop swings on with ω = 36 rad/s, its far corner 2 m per rad, V < 10 m/s.
    `test_mujoco_class_k` separates the parts of the error.
    """
    data = truth.load("stedy_dbar")
    scene, errors = tmj.load_scene("dbar"), []
    for h in (1e-3, 2.5e-4):
        errors.append(position_error(simulated(scene, data, tmj.MuJoCo(h)), data))
        without = position_error(simulated(scene, data, tmj.DAE(method=tmj.Method.RK4, timestep=h)), data)
        print(f"dbar, RK4, {h:g} s: MuJoCo {errors[-1]:.1e} m, DAE {without:.1e} m")
        assert errors[-1] == pytest.approx(without, rel=0.02)
        assert errors[-1] < 36 * 2 * 10 * (0.1 * h + 222 * h**2 / 2) * 1.74 / 0.68 / 36
    assert errors[1] < errors[0] / 4
