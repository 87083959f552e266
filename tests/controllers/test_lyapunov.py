"""The Lyapunov law: V̇ = -δ V by finite differences of the DAE's motion, gains, targets, bad input."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from members import Members
from random_laws import random_law

import tensegrity_mj as tmj
from evidence.random_structures import random_configuration, random_scene, random_structure
from tensegrity_mj.controllers import Gains, Lyapunov, from_scene
from tensegrity_mj.dynamics.kernels import accelerations, place_nodes
from tensegrity_mj.dynamics.records import StructureRecords
from tensegrity_mj.dynamics.target import target_nodes
from tensegrity_mj.model import rods
from tensegrity_mj.model.rigidity import Equilibrium, equilibrium_force_densities


@pytest.mark.parametrize("path", [False, True])
@pytest.mark.parametrize("seed", range(12))
def test_v_decays_at_the_promised_rate(seed, path):
    """dV/dt along the exact second-order Taylor expansion of the motion equals -δ V."""
    rng = np.random.default_rng(seed)
    structure = random_structure(rng, rods=3, strings=9, point_masses=1, own_planes=0.3)
    scene = random_scene(rng, structure, displaced=0.3, moving=0.7, gravity=True)
    law = random_law(rng, structure, scene.gravity, path)
    time = 0.6
    u, margin, V = law.evaluate(time, scene.nodes0, scene.velocities0)
    if not margin > 0:
        pytest.skip("no admissible control at this random state")
    records = StructureRecords.of(structure)
    q, rates = records.coordinates(scene.nodes0), records.coordinates(scene.velocities0)
    forces = rods.string_forces(structure, scene.nodes0, u * structure.string_lengths(scene.nodes0))
    acceleration, multipliers = np.zeros(records.nq), np.zeros(len(records.rods))
    g = np.array(scene.gravity)
    members = Members(records.rods, records.points, g, forces, multipliers)
    accelerations(members, q, rates, acceleration)

    def value(s):
        nodes, velocities = np.array(structure.positions), np.zeros_like(structure.positions)
        moved = q + s * rates + 0.5 * s * s * acceleration
        place_nodes(moved, rates + s * acceleration, records.rods, records.points, nodes, velocities)
        return law.evaluate(time + s, nodes, velocities)[2]

    def derivative(h):
        return (value(h) - value(-h)) / (2 * h)

    # Richardson over central differences: truncation O(h⁴), round-off 1e-16 V / h; the best h is about 1e-3, where
    # both are below 1e-10 of the accelerations' scale.
    h = 1e-3 / (1 + np.abs(acceleration).max())
    rate = (4 * derivative(h / 2) - derivative(h)) / 3
    scale = abs(law.decay_rate * V) + np.sqrt(V) * np.abs(acceleration).max()
    assert abs(rate + law.decay_rate * V) <= 1e-8 * scale


def test_v_is_zero_only_at_the_target():
    rng = np.random.default_rng(3)
    structure = random_structure(rng, rods=2)
    target = random_configuration(rng, structure, 0.5)
    law = Lyapunov(structure, target)
    still = np.zeros_like(target)
    assert law.evaluate(0.0, target, still)[2] == pytest.approx(0.0, abs=1e-28)  # round-off squared
    assert law.evaluate(0.0, structure.positions, still)[2] > 1e-3


@pytest.mark.third_means("laws, their paths", by="half the angle at half the time of a quintic")
def test_paths_turn_on_great_circles_and_stand_still_at_waypoints():
    rng = np.random.default_rng(6)
    structure = random_structure(rng, rods=2, point_masses=1)
    ends = [random_configuration(rng, structure, 0.7) for _ in range(2)]
    target = tmj.Target.path([1.0, 3.0], ends)
    times = np.linspace(0, 4, 401)
    nodes = target_nodes(structure, target, times)
    assert np.allclose(nodes[times <= 1.0], ends[0], atol=1e-14)
    assert np.allclose(nodes[times >= 3.0], ends[1], atol=1e-14)
    first, second = rods.ends(structure, nodes)
    assert np.allclose(np.linalg.norm(second - first, axis=-1), structure.rod_lengths, rtol=1e-14)
    # Quintic timing: half way at half time, with 15/8 of the mean speed there.
    middle = np.argmin(np.abs(times - 2.0))
    b = (second - first)[middle] / structure.rod_lengths[:, None]
    halves = (second - first)[0] / structure.rod_lengths[:, None] + (second - first)[-1] / structure.rod_lengths[
        :, None
    ]
    assert np.allclose(b, halves / np.linalg.norm(halves, axis=1)[:, None], atol=1e-13)


def test_v_decays_along_a_path():
    scene = tmj.load_scene("pinned_rod")
    path = tmj.Target.path([0.0, 20.0], [scene.nodes0, scene.target.nodes[0]])
    off = np.array(scene.nodes0)
    off[1] += (0.3, 0.2, 0.1)
    off[1] /= np.linalg.norm(off[1])
    start = scene.with_(target=path, initial_nodes=off)
    run = tmj.simulate(start, Lyapunov(scene.structure, path, decay_rate=0.3), tmj.DAE(rtol=1e-10), duration=10.0)
    assert run.status is tmj.Status.COMPLETED
    # 100 rtol for about a hundred steps.
    assert run.lyapunov == pytest.approx(run.lyapunov[0] * np.exp(-0.3 * run.time), rel=1e-8)
    # The path has turned by half of 98.7° by then, so V about its start is at least (1 - 1/Z) |e|²/2 with |e| > 0.7.
    still = Lyapunov(scene.structure, path.nodes[0], decay_rate=0.3)
    assert still.evaluate(10.0, run.nodes[-1], run.velocities[-1])[2] > 0.08 > 2 * run.lyapunov[-1]


def test_the_targets_equilibrium_is_checked():
    prism = tmj.load_scene("prism")
    report = from_scene(prism).target_equilibrium()
    assert report["residual"] < 1e-12
    assert report["self_stress_modes"] >= 1
    # One string cannot hold a rod up against gravity: a residual of the order of the weight stays.
    rod = tmj.load_scene("pinned_rod")
    nodes = {name: rod.structure.nodes[name] for name in ("O", "n1", "n2")}
    hanging = replace(rod.structure, strings=rod.structure.strings[:1], nodes=nodes, fixed_nodes=("n2",))
    aim = rod.target.nodes[0][:3]
    assert Lyapunov(hanging, aim, gravity=(0.0, 0.0, -9.81)).target_equilibrium()["residual"] > 1.0


def test_the_law_refuses_a_structure_it_was_not_made_for():
    prism, rod = tmj.load_scene("prism"), tmj.load_scene("pinned_rod")
    with pytest.raises(tmj.errors.OptionError, match="other nodes or strings"):
        tmj.simulate(rod, from_scene(prism), tmj.DAE())


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"decay_rate": 0.0}, ("decay_rate", "0.0", "> 0")),
        ({"decay_rate": math.nan}, ("decay_rate", "nan")),
        ({"norm": 3}, ("norm", "3", "math.inf")),
        ({"rotation": Gains(X=0.5, Y=1.0, Z=1.5)}, ("rod1", "Schur complement")),
        ({"rotation": Gains(Z=-1.0)}, ("rod1", "Z must be positive definite")),
        ({"rotation": Gains(X=np.array([[1, 0.5, 0], [0, 1, 0], [0, 0, 1]]))}, ("symmetric",)),
        ({"rotation": Gains(X=np.eye(2))}, ("Xb", "(3, 3)")),
        ({"translation": {"nobody": Gains()}}, ("nobody", "rod1")),
        ({"translation": 3.0}, ("Gains",)),
        ({"minimum_force_density": -0.1}, ("minimum_force_density", ">= 0")),
        ({"minimum_force_density": [1.0, 2.0]}, ("minimum_force_density", "(12,)")),
        ({"gravity": (0.0, 0.0)}, ("gravity", "(3,)")),
        ({"gravity": 9.81}, ("gravity", "(3,)")),
        ({"norm": True}, ("norm", "True")),
        ({"decay_rate": True}, ("decay_rate", "True")),
        ({"structure": "prism"}, ("structure", "scene.structure")),
        ({"target": None}, ("target",)),
    ],
)
def test_bad_options_are_refused(options, words):
    scene = tmj.load_scene("prism")
    arguments = {"structure": scene.structure, "target": scene.target} | options
    with pytest.raises(tmj.TensegrityError) as caught:
        Lyapunov(**arguments)
    assert all(word in str(caught.value) for word in words), str(caught.value)


def test_a_target_that_stretches_a_rod_is_refused():
    scene = tmj.load_scene("prism")
    nodes = np.array(scene.target.nodes[0])
    nodes[1] *= 1.1
    with pytest.raises(tmj.errors.SceneError, match="rod 'rod1'"):
        Lyapunov(scene.structure, nodes)


def test_residual_prestress_is_kept():
    scene = tmj.load_scene("prism")
    law = Lyapunov(scene.structure, scene.target, minimum_force_density=0.02)
    run = tmj.simulate(scene, law, tmj.DAE(rtol=1e-9, atol=1e-11), duration=2.0)
    assert run.status is tmj.Status.COMPLETED
    assert run.force_densities.min() >= 0.02 * (1 - 1e-12)
    assert run.lyapunov == pytest.approx(run.lyapunov[0] * np.exp(-run.time), rel=1e-7)  # 100 rtol


@pytest.mark.parametrize("engine", [tmj.DAE(), tmj.MuJoCo(1e-3)], ids=["DAE", "MuJoCo"])
def test_a_support_that_moves_is_not_known_to_the_law(engine) -> None:
    scene = tmj.load_scene("pinned_rod")
    law = tmj.controllers.from_scene(scene)
    moved = scene.with_(motions=(tmj.model.Motion.in_line("rod", 0.01, 0.2, (1.0, 0.0, 0.0)),))
    reported = [
        text for text in tmj.simulate(moved, law, engine, duration=0.05).reports["warnings"] if "'rod' moves" in text
    ]
    assert len(reported) == 1
    assert not tmj.simulate(scene, law, engine, duration=0.05).reports["warnings"]


def test_a_law_too_large_for_the_stack_has_room_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    from tensegrity_mj.controllers import quadratic_law

    scene = tmj.load_scene("prism")
    engine = tmj.MuJoCo(1e-3)
    on_stack = tmj.simulate(scene, tmj.controllers.from_scene(scene), engine, duration=0.1)
    monkeypatch.setattr(quadratic_law, "STACK_LIMIT", 10)
    law = tmj.controllers.from_scene(scene)
    first, second = law.native(scene.structure), law.native(scene.structure)
    assert not first.stateless
    assert first.context != second.context  # each run has its own
    np.testing.assert_array_equal(tmj.simulate(scene, law, engine, duration=0.1).nodes, on_stack.nodes)
    many = tmj.simulate_many([scene] * 3, law, engine, duration=0.1, threads=2)
    for run in many:
        np.testing.assert_array_equal(run.nodes, on_stack.nodes)


def test_the_equilibrium_at_the_target_is_found_once_for_scenes_of_one_structure(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found, scene = [], tmj.load_scene("prism")

    def count(*given: object) -> Equilibrium:
        found.append(given)
        return equilibrium_force_densities(*given)  # type: ignore[arg-type]

    monkeypatch.setattr("tensegrity_mj.controllers.quadratic_law.equilibrium_force_densities", count)
    starts = [scene.with_(initial_velocities=scale * scene.velocities0) for scale in (0.5, 0.6)]
    assert from_scene(starts[0]).describe() == from_scene(starts[1]).describe()
    assert len(found) == 1
    from_scene(scene.with_(gravity=(0.0, 0.0, -1.0))).describe()
    assert len(found) == 2
