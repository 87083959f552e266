"""The minimal ODE against the DAE: the same structures in coordinates that share no equation with the DAE's.

Beside what is here, tests/engines/test_actuation.py runs its modes of actuation in the ODE too.
"""

from __future__ import annotations

import numpy as np
import pytest
import truth
from engine_accelerations import dae_accelerations, ode_accelerations
from members import Members
from momenta import angular_momentum, linear_momentum
from numpy.typing import NDArray
from random_states import random_state
from stedy import largest_frequency, scene_of

import tensegrity_mj as tmj
from evidence.random_structures import random_scene, random_structure
from tensegrity_mj.controllers import from_scene
from tensegrity_mj.dynamics.minimal import (
    MinimalRecords,
    minimal_accelerations,
    node_accelerations,
    place_minimal,
)
from tensegrity_mj.model import rods
from tensegrity_mj.model.events import Break
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.strings import StringLaw

Array = NDArray[np.float64]
TIGHT = {"rtol": 1e-12, "atol": 1e-13}


def sines(scene: Scene) -> Array:
    """sin φ of the rods that turn in space."""
    first, second = rods.ends(scene.structure, scene.nodes0)
    b = (second - first) / scene.structure.rod_lengths[:, None]
    space = [rod.support.plane is None for rod in scene.structure.rods]
    return np.hypot(b[:, 0], b[:, 1])[space]


@pytest.mark.parametrize("law", list(StringLaw))
@pytest.mark.parametrize("planar", [False, True], ids=["space", "plane"])
@pytest.mark.parametrize("seed", range(12))
def test_accelerations_and_multipliers_are_those_of_the_dae(seed: int, planar: bool, law: StringLaw) -> None:
    scene = random_state(seed, planar, law)
    ode, dae = ode_accelerations(scene), dae_accelerations(scene)
    # Inertias of rods of about 1 kg and 1 m have condition numbers below 1e3, and θ̇ is lost by 1 / sin φ <= 1e2:
    # 1e5 times the machine precision of 2e-16.
    assert sines(scene).min(initial=1.0) > 1e-2
    scale = max(1.0, float(np.abs(dae).max()))
    error = float(np.abs(ode - dae).max())
    print(f"accelerations: {error / scale:.1e} of {scale:.1e} m/s²")
    assert error <= 1e-10 * scale
    runs = [
        tmj.simulate(scene, None, engine(tmj.Method.RK4, timestep=1e-9), duration=1e-9) for engine in (tmj.ODE, tmj.DAE)
    ]
    multipliers = [run.multipliers[0] for run in runs]
    assert np.abs(multipliers[0] - multipliers[1]).max() <= 1e-10 * max(1.0, np.abs(multipliers[1]).max())


@pytest.mark.parametrize("planar", [False, True], ids=["space", "plane"])
@pytest.mark.parametrize("seed", range(8))
def test_inertia_and_forces_have_the_same_power_in_every_virtual_motion(seed: int, planar: bool) -> None:
    """Φᵀ (M̄ (Φ q̈ + a⁰) - f - w) = 0, M̄ of the kinetic energy (2.25), Φ the derivative of Υ(q), a⁰ that of q̈ = 0."""
    scene = random_state(seed, planar)
    rng = np.random.default_rng(seed)
    records = MinimalRecords.of(scene.structure)
    q, rates = records.state(scene.nodes0, scene.velocities0)
    forces, gravity = rng.normal(size=scene.nodes0.shape), rng.normal(size=3)
    expected, multipliers = np.zeros(records.nq), np.zeros(len(records.rods))
    members = Members(records.rods, records.points, gravity, forces, multipliers)
    minimal_accelerations(members, q, rates, expected)

    def placed(at: Array, along: Array) -> tuple[Array, Array]:
        nodes, velocities = np.array(scene.nodes0), np.zeros_like(scene.nodes0)
        place_minimal(at, along, records.rods, records.points, nodes, velocities)
        return nodes.ravel(), velocities.ravel()

    def moved(second: Array) -> Array:
        out = np.zeros_like(scene.nodes0)
        node_accelerations(q, rates, second, records.rods, records.points, out)
        return out.ravel()

    def power(a: Array, b: Array) -> float:
        """aᵀ M̄ b."""
        both, one, other = (rods.kinetic_energy(scene.structure, v.reshape(-1, 3)) for v in (a + b, a, b))
        return float(both - one - other)

    nodes, velocities = placed(q, rates)
    # Coordinates of some metres, angles lost by 1 / sin φ in rates only, which sin φ gives back.
    assert np.abs(nodes - scene.nodes0.ravel()).max() < 1e-14
    assert np.abs(velocities - scene.velocities0.ravel()).max() < 1e-13
    phi = np.column_stack([placed(q, unit)[1] for unit in np.eye(records.nq)])
    assert np.abs(phi @ rates - velocities).max() < 1e-13
    step = 1e-5  # h² ℓ / 6 and eps / h: 2e-11 both
    columns = [(placed(q + step * e, rates)[0] - placed(q - step * e, rates)[0]) / (2 * step) for e in np.eye(len(q))]
    assert np.abs(phi - np.column_stack(columns)).max() < 1e-9
    # The nodes' accelerations are the rate of their velocities along q(t), whatever Ẇ β̇ the kernels compute with.
    ahead, behind = (placed(q + h * rates + 0.5 * h * h * expected, rates + h * expected)[1] for h in (step, -step))
    scale = max(1.0, np.abs(moved(expected)).max())
    # h² times third derivatives, which are 1e4 of the accelerations where θ̇ is 1e2: 1e-6.
    assert np.abs((ahead - behind) / (2 * step) - moved(expected)).max() < 1e-6 * scale
    bias = moved(np.zeros(records.nq))
    inertia = np.array([[power(a, b) for a in phi.T] for b in phi.T])
    weights = rods.lumped_masses(scene.structure)[:, None] * gravity
    given = phi.T @ (forces + weights).ravel() - [power(column, bias) for column in phi.T]
    # Condition numbers below 1e4, with 1 / sin² φ <= 1e4 on top: 1e8 times 2e-16, of what is added up.
    found = np.linalg.solve(inertia, given)
    assert np.abs(found - expected).max() <= 1e-7 * max(1.0, np.abs(expected).max())


def free_motion() -> Scene:
    """A free structure that turns, whose strings stay taut (kinks cost digits) and whose rods avoid the poles."""
    rng = np.random.default_rng(11)
    structure = random_structure(rng, rods=3, support="free", strings=9, fixed_nodes=0, point_masses=1)
    return random_scene(rng, structure.with_strings(rest_length=0.05), moving=1.0, duration=2.0)


def test_energy_and_momentum_are_conserved() -> None:
    scene = free_motion()
    run = tmj.simulate(scene, None, tmj.ODE(rtol=1e-13, atol=1e-14))
    assert run.status is tmj.Status.COMPLETED, run.message
    assert run.tensions.min() > 0
    linear = linear_momentum(scene.structure, run.velocities)
    angular = angular_momentum(scene.structure, run.nodes, run.velocities)
    # 1e-13 a step and some thousand steps, of quantities that are of order 1 to 10.
    assert run.energy_residual < 1e-9
    assert np.abs(linear - linear[0]).max() < 1e-9
    assert np.abs(angular - angular[0]).max() < 1e-9
    assert np.ptp(run.kinetic_energy) > 0.1  # it did exchange energy
    assert run.reports["drift"] < 1e-14  # nothing to drift


def test_pinned_rod_in_closed_loop_agrees_with_the_dae_for_a_minute() -> None:
    scene = tmj.load_scene("pinned_rod")
    law = from_scene(scene)
    ode, dae = (tmj.simulate(scene, law, engine(**TIGHT), duration=60.0) for engine in (tmj.ODE, tmj.DAE))
    comparison = tmj.compare(ode, dae)
    print(f"pinned rod, 60 s, ODE against DAE: {comparison.max_node_error:.1e} m")
    assert comparison.max_node_error <= 1e-8
    assert comparison.max_rod_force_error <= 1e-8
    assert np.abs(ode.lyapunov / (ode.lyapunov[0] * np.exp(-0.15 * ode.time)) - 1).max() < 1e-8


@pytest.mark.parametrize(
    ("options", "bound"),
    [
        (TIGHT, 1e-9),
        ({"method": tmj.Method.RADAU, "rtol": 1e-8, "atol": 1e-10}, 1e-7),
        # (ω h)⁴ with kinks of u: what DAE and MuJoCo have at 2 ms, tests/engines/test_closed_loop.py.
        ({"method": tmj.Method.RK4, "timestep": 2e-3}, 1e-7),
    ],
    ids=["dop853", "radau", "rk4"],
)
def test_prism_in_closed_loop_agrees_with_the_dae(options: dict[str, object], bound: float) -> None:
    scene = tmj.load_scene("prism")
    law = from_scene(scene)
    ode = tmj.simulate(scene, law, tmj.ODE(**options), duration=4.0)  # type: ignore[arg-type]
    dae = tmj.simulate(scene, law, tmj.DAE(**TIGHT), duration=4.0)
    error = tmj.compare(ode, dae).max_node_error
    print(f"prism, 4 s, {ode.engine}: {error:.1e} m")
    assert 0 < error <= bound


def test_rk4_converges_with_order_four() -> None:
    scene = free_motion()
    scene = scene.with_(duration=0.5)
    exact = tmj.simulate(scene, None, tmj.DAE(rtol=1e-13, atol=1e-14))
    assert exact.tensions.min() > 0, "the test needs taut strings: slack ones break the order"
    steps = np.array([1.25e-3, 6.25e-4, 3.125e-4])
    errors = [
        tmj.compare(tmj.simulate(scene, None, tmj.ODE(tmj.Method.RK4, timestep=h)), exact).max_node_error for h in steps
    ]
    order = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    print(f"ODE RK4: errors {errors}, order {order:.2f}")
    # The next term is below a tenth of the leading one at these steps: 0.2 in the order.
    assert abs(order - 4) < 0.2


def test_breaking_strings_mean_the_same_as_in_the_dae() -> None:
    scene = tmj.load_scene("prism")
    law = from_scene(scene)
    tightest = int(np.argmax(tmj.simulate(scene, law, tmj.DAE(), duration=0.5).tensions[-1]))
    scene = scene.with_(breaks=(Break(scene.structure.strings[tightest].name, 0.5),))
    for actuation in (tmj.Actuation.continuous(), tmj.Actuation.hold_rest_length(1e-2)):
        ode, dae = (
            tmj.simulate(
                scene,
                law,
                engine(**TIGHT),
                duration=1.0,
                actuation=actuation,
                on_infeasible=tmj.OnInfeasible.PASSIVE,
            )
            for engine in (tmj.ODE, tmj.DAE)
        )
        assert tmj.compare(ode, dae).max_node_error < 1e-10  # a hundred times rtol over a second
        assert np.all(ode.tensions[ode.time >= 0.5, tightest] == 0)
        assert np.all(ode.tensions[ode.time < 0.49, tightest] > 0)
        # Energies of about 1e-2 J.
        for name in ("winch_work", "dissipation", "string_energy"):
            assert np.abs(getattr(ode, name) - getattr(dae, name)).max() < 1e-10, name


@pytest.mark.parametrize(
    ("name", "bound"),
    [
        ("pendulum", 1e-10),
        ("tbar_undamped", 1e-10),
        ("tbar_damped", 1e-10),
        ("prism_free_undamped", 1e-9),
        ("ball", 1e-9),
    ],
)
def test_the_published_trajectories_come_out(name: str, bound: float) -> None:
    """As tests/engines/test_truth.py has it for the DAE, with the same bounds [m]."""
    data = truth.load(f"stedy_{name}")
    scene = scene_of(data)
    run = tmj.simulate(scene, None, tmj.ODE(rtol=1e-13, atol=1e-14), output_interval=float(data["t"][1]))
    assert run.status is tmj.Status.COMPLETED, run.message
    nodes = np.linalg.norm(run.nodes - data["pos"], axis=-1).max()
    print(f"ODE, {name}: {nodes:.1e} m")
    assert nodes <= bound
    assert np.linalg.norm(run.velocities - data["vel"], axis=-1).max() <= bound * largest_frequency(data)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"method": "rk5"}, ("ODE: method", "Method.DOP853")),
        ({"method": tmj.Method.RK4}, ("ODE: timestep", "> 0")),
        ({"timestep": 1e-3}, ("ODE: timestep", "leave it out")),
        ({"rtol": 0.0}, ("ODE: rtol = 0.0", "2.3e-14")),
        ({"rtol": 1e-16}, ("2.3e-14",)),
        ({"max_steps": 0}, ("ODE: max_steps", ">= 1")),
        ({"least_sine": 0.0}, ("ODE: least_sine = 0.0", "1e-08")),
        ({"least_sine": 0.9}, ("ODE: least_sine = 0.9", "0.5")),
    ],
)
def test_bad_options_are_refused(options: dict[str, object], words: tuple[str, ...]) -> None:
    with pytest.raises(tmj.errors.OptionError) as caught:
        tmj.ODE(**options)  # type: ignore[arg-type]
    assert all(word in str(caught.value) for word in words)


def test_an_engine_says_what_it_is() -> None:
    assert str(tmj.ODE()) == "ODE DOP853, rtol = 1e-10, atol = 1e-12"
    assert str(tmj.ODE(tmj.Method.RK4, timestep=1e-3)) == "ODE RK4, h = 0.001 s"
    run = tmj.simulate(tmj.load_scene("tbar"), None, tmj.ODE(), duration=0.1)
    assert run.engine == str(tmj.ODE())
    assert run.provenance["engine"]["name"] == "ODE"
    assert run.provenance["engine"]["least_sine"] == 1e-3
