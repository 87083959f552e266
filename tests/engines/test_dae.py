"""The DAE against a second formulation, and what it does about drift.

The second formulation is the textbook one: the kinetic energy's mass matrix in all coordinates q, the constraints
bᵀb = 1 as rows of a saddle-point system, solved densely. It shares no formula with (2.45)-(2.49).
"""

from __future__ import annotations

import natural_coordinates as natural
import numpy as np
import pytest
from members import Members

import tensegrity_mj as tmj
from evidence.random_structures import random_scene, random_structure
from tensegrity_mj.dynamics.kernels import accelerations, place_nodes
from tensegrity_mj.dynamics.records import StructureRecords
from tensegrity_mj.engines.reference.engine import integrate
from tensegrity_mj.model import rods


def saddle_point(records, q, rates, forces, gravity):
    """q̈ and λ from the dense system [M Gᵀ; G 0]."""
    structure = records.structure
    phi, _ = records.affine_map
    nq, count = records.nq, len(records.rods)

    def kinetic(v):
        return rods.kinetic_energy(structure, (phi @ v).reshape(-1, 3))

    basis = np.eye(nq)
    mass = np.array([[kinetic(a + b) - kinetic(a) - kinetic(b) for a in basis] for b in basis])
    G, right = np.zeros((count, nq)), np.zeros(count)
    for row, rod in enumerate(records.rods):
        b = slice(rod["q"] + rod["nz"], rod["q"] + rod["nz"] + rod["nb"])
        G[row, b], right[row] = q[b], -rates[b] @ rates[b]
    load = phi.T @ (forces + rods.lumped_masses(structure)[:, None] * gravity).ravel()
    matrix = np.block([[mass, G.T], [G, np.zeros((count, count))]])
    solution = np.linalg.solve(matrix, np.concatenate([load, right]))
    return solution[:nq], solution[nq:] / records.rods["J"]


@pytest.mark.parametrize("planar", [False, True])
@pytest.mark.parametrize("seed", range(10))
def test_accelerations_and_multipliers_equal_the_dense_saddle_point_system(seed, planar):
    rng = np.random.default_rng(seed)
    structure = random_structure(rng, rods=4, planar=planar, own_planes=0.3, point_masses=1)
    scene = random_scene(rng, structure, displaced=0.3, moving=1.0)
    records = StructureRecords.of(structure)
    q, rates = records.coordinates(scene.nodes0), records.coordinates(scene.velocities0)
    forces, gravity = rng.normal(size=(len(structure.nodes), 3)), rng.normal(size=3)
    out, multipliers = np.zeros(records.nq), np.zeros(len(records.rods))
    accelerations(Members(records.rods, records.points, gravity, forces, multipliers), q, rates, out)
    expected, expected_multipliers = saddle_point(records, q, rates, forces, gravity)
    # Round-off: the dense system's condition number is below 1e4 for rods of about 1 kg and 1 m, times 1e-16, times
    # a margin of 100 for the sums.
    scale = max(1.0, np.abs(expected).max(), np.abs(expected_multipliers).max())
    assert np.abs(out - expected).max() <= 1e-10 * scale
    assert np.abs(multipliers - expected_multipliers).max() <= 1e-10 * scale


@pytest.mark.parametrize("seed", range(5))
def test_affine_map_places_nodes_and_velocities(seed):
    rng = np.random.default_rng(seed)
    structure = random_structure(rng, rods=3, own_planes=0.3, point_masses=1, fixed_nodes=2)
    scene = random_scene(rng, structure, displaced=0.3, moving=1.0)
    records = StructureRecords.of(structure)
    phi, y = records.affine_map
    q, rates = records.coordinates(scene.nodes0), records.coordinates(scene.velocities0)
    nodes, velocities = np.array(structure.positions), np.zeros_like(structure.positions)
    place_nodes(q, rates, records.rods, records.points, nodes, velocities)
    # Coordinates of about 1 m: a few units of round-off.
    assert np.abs((phi @ q + y).reshape(-1, 3) - nodes).max() < 1e-14
    assert np.abs((phi @ rates).reshape(-1, 3) - velocities).max() < 1e-14
    assert np.abs(nodes - scene.nodes0).max() < 1e-14
    assert np.abs(velocities - scene.velocities0).max() < 1e-14


@pytest.fixture(scope="module")
def spinning():
    """A prestressed free structure that turns several times: where drift shows."""
    rng = np.random.default_rng(4)
    return random_scene(rng, random_structure(rng, rods=3, support="free", strings=9), moving=2.0, duration=10.0)


def test_drift_treatments_reduce_the_drift_and_keep_the_motion(spinning):
    step = 5e-3
    runs = {
        drift: tmj.simulate(spinning, None, tmj.DAE(tmj.Method.RK4, timestep=step, drift=drift))
        for drift in tmj.engines.Drift
    }
    drift = {kind: run.reports["drift"] for kind, run in runs.items()}
    # RK4 leaves O(h⁴) of drift, which adds up; normalizing leaves round-off; Baumgarte lets it decay.
    assert drift[tmj.engines.Drift.NORMALIZE] < 1e-14
    assert drift[tmj.engines.Drift.BAUMGARTE] < 0.1 * drift[tmj.engines.Drift.MONITOR]
    assert drift[tmj.engines.Drift.MONITOR] > 1e-12
    assert runs[tmj.engines.Drift.NORMALIZE].reports["rate_drift"] < 1e-13
    exact = tmj.simulate(spinning, None, tmj.DAE(rtol=1e-12, atol=1e-13, drift=tmj.engines.Drift.NORMALIZE))
    monitored = tmj.compare(runs[tmj.engines.Drift.MONITOR], exact).max_node_error
    for run in runs.values():
        # A treatment acts at the order of the method's own error: it may not make the motion worse by much.
        assert tmj.compare(run, exact).max_node_error <= 5 * monitored


@pytest.mark.parametrize("damping", [0.5, 1.0, 2.0])
def test_baumgarte_s_gains_are_those_of_its_options(damping):
    """A length that is off: φ = (‖b‖² - 1)/2 obeys φ̈ + 2 ζ ω φ̇ + ω² φ = 0 exactly, by (3.25) with (3.26)."""
    omega, off = 8.0, 1e-3
    nodes = {"a": (0.0, 0.0, 0.0), "b": (1.0, 0.0, 0.0)}
    structure = tmj.Structure("rod", nodes, (tmj.Rod("rod", ("a", "b"), 2.0),))
    scene = tmj.Scene(structure, initial_velocities=np.array([[0, 0, 0], [0, 1.5, 0]]), duration=1.0)
    engine = tmj.DAE(
        tmj.Method.RK4,
        timestep=1e-3,
        drift=tmj.engines.Drift.BAUMGARTE,
        baumgarte_frequency=omega,
        baumgarte_damping=damping,
    )
    run = engine.prepared(natural.request(scene))
    run.y[3:6] *= 1 + off  # b of the one rod, after its centre
    made = integrate(run)
    spans = made.nodes[:, 1] - made.nodes[:, 0]
    found = (np.sum(spans**2, axis=1) - 1) / 2
    # φ(0) = off + off²/2 and φ̇(0) = b·ḃ = 0: b was made longer along itself, and ḃ is normal to it.
    start, roots = off + off**2 / 2, np.roots([1.0, 2 * damping * omega, omega**2]).astype(complex)
    if damping == 1.0:
        expected = start * np.exp(-omega * made.time) * (1 + omega * made.time)
    else:
        first, second = roots
        rows = first * np.exp(second * made.time) - second * np.exp(first * made.time)
        expected = (start * rows / (first - second)).real
    # RK4: (λ h)⁵/120 of φ a step for |λ| up to 2 (1 + √3/2) ω = 30/s, 1000 steps: 2e-7 of φ(0); and of the turning rod,
    # 1.5 rad/s, (1.5 h)⁵/120 a step of b, 6e-14 after all.
    np.testing.assert_allclose(found, expected, rtol=0, atol=3e-7 * start)


@pytest.mark.parametrize("drift", list(tmj.engines.Drift))
def test_rk4_converges_with_order_four(spinning, drift):
    scene = spinning.with_(structure=spinning.structure.with_strings(rest_length=0.05), duration=1.0)
    exact = tmj.simulate(scene, None, tmj.DAE(rtol=1e-13, atol=1e-14))
    assert exact.tensions.min() > 0, "the test needs taut strings: slack ones break the order"
    steps = np.array([2.5e-3, 1.25e-3, 6.25e-4])  # coarser ones are outside the asymptotic window
    errors = [
        tmj.compare(tmj.simulate(scene, None, tmj.DAE(tmj.Method.RK4, timestep=h, drift=drift)), exact).max_node_error
        for h in steps
    ]
    order = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    print(f"DAE RK4, {drift.value}: errors {errors}, order {order:.2f}")
    assert abs(order - 4) < 0.2


@pytest.mark.parametrize("method", [tmj.Method.DOP853, tmj.Method.RADAU])
def test_error_controlled_methods_follow_their_tolerance(spinning, method):
    scene = spinning.with_(duration=1.0)
    exact = tmj.simulate(scene, None, tmj.DAE(rtol=1e-13, atol=1e-15))
    errors = [
        tmj.compare(tmj.simulate(scene, None, tmj.DAE(method, rtol=r, atol=0.01 * r)), exact).max_node_error
        for r in (1e-5, 1e-7, 1e-9)
    ]
    assert errors[0] > errors[1] > errors[2] > 0
    # The local error is kept at rtol a step; a hundred steps and the motion's own sensitivity stay below 1e3.
    assert all(error <= 1e3 * r for error, r in zip(errors, (1e-5, 1e-7, 1e-9), strict=True))


def test_radau_takes_overdamped_strings_in_fewer_steps():
    rng = np.random.default_rng(1)
    structure = random_structure(
        rng,
        rods=2,
        strings=4,
        support="free",
        stiffness=(1e6, 1e6),
        damping=(1e4, 1e4),
        stretch=(0.01, 0.02),
        law=tmj.model.StringLaw.UNCLIPPED,  # a clipped damper lets go at once, and nothing is stiff any more
    )
    scene = random_scene(rng, structure, duration=0.05)
    stiff = tmj.simulate(scene, None, tmj.DAE(tmj.Method.RADAU, rtol=1e-6, atol=1e-9))
    explicit = tmj.simulate(scene, None, tmj.DAE(tmj.Method.DOP853, rtol=1e-6, atol=1e-9))
    assert stiff.cost["steps"] < 0.5 * explicit.cost["steps"]
    assert tmj.compare(stiff, explicit).max_node_error < 1e-5  # 10 rtol


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"method": "rk5"}, ("method", "mean 'rk4'", "Method.DOP853")),
        ({"method": tmj.Method.RK4}, ("timestep", "> 0")),
        ({"timestep": 1e-3}, ("timestep", "leave it out")),
        ({"rtol": 0.0}, ("rtol = 0.0", "2.3e-14")),
        ({"atol": float("nan")}, ("atol", "nan")),
        ({"rtol": 1e-16}, ("rtol", "2.3e-14")),
        ({"drift": "none"}, ("drift", "Drift.MONITOR")),
        ({"drift": tmj.engines.Drift.BAUMGARTE, "baumgarte_frequency": -1.0}, ("baumgarte_frequency", "-1.0")),
        ({"max_steps": 0}, ("max_steps", ">= 1")),
    ],
)
def test_bad_options_are_refused(options, words):
    with pytest.raises(tmj.errors.OptionError) as caught:
        tmj.DAE(**options)
    assert all(word in str(caught.value) for word in words)
