"""Feedback linearization: the error dynamics it promises, for any structure; the cross of §4.6.1; what it reports."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from members import Members
from numpy.typing import NDArray

import tensegrity_mj as tmj
from evidence.random_linked import random_velocities
from evidence.random_structures import random_configuration, random_structure
from tensegrity_mj.controllers import Allocation, FeedbackLinearization, Sum, WhenInfeasible
from tensegrity_mj.dynamics.kernels import accelerations, place_nodes
from tensegrity_mj.dynamics.records import StructureRecords
from tensegrity_mj.errors import InfeasibleError, OptionError
from tensegrity_mj.library.cross import cross, cross_nodes

Array = NDArray[np.float64]
TIGHT = tmj.DAE(rtol=1e-12, atol=1e-13)


def errors_of(law: FeedbackLinearization, run: tmj.Trajectory) -> tuple[Array, Array]:
    """(T, n) e and ė along a run."""
    rows = zip(run.time, run.nodes, run.velocities, strict=True)
    e = np.array([law.error(t, nodes, velocities) for t, nodes, velocities in rows])
    return e[:, 0], e[:, 1]


def configurations(rng: np.random.Generator, structure: tmj.Structure) -> Iterator[Array]:
    """Random ones without end."""
    while True:
        yield random_configuration(rng, structure, 1.0)


def clear_of_the_pole(structure: tmj.Structure, nodes: Array) -> bool:
    """Whether every rod is 20° or more from the z axis, near which differences are rough."""
    b = (nodes[structure.rod_nodes[:, 1]] - nodes[structure.rod_nodes[:, 0]]) / structure.rod_lengths[:, None]
    return bool(np.all(np.hypot(b[:, 0], b[:, 1]) > 0.34))


# The equation, for any structure ---------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(40))
def test_the_equation_is_that_of_the_error_dynamics(seed: int) -> None:
    """A u - d = ë + K_d ė + K_p e for any u, with ë by differences of ė along the motion of the thesis' model."""
    rng = np.random.default_rng(seed)
    structure = random_structure(rng, rods=3, planar=seed % 3 == 0, own_planes=0.2, point_masses=seed % 2)
    nodes = next(x for x in configurations(rng, structure) if clear_of_the_pole(structure, x))
    velocities = random_velocities(rng, structure, nodes, 0.5)
    ends = [random_configuration(rng, structure, 0.4) for _ in range(2)]
    target = tmj.Target.path([0.0, 2.0], ends) if seed % 4 else tmj.Target.set_point(ends[0])
    gravity = tuple(rng.normal(size=3))
    count = len(FeedbackLinearization(structure, target).coordinates)
    omega, zeta = rng.uniform(0.5, 2, count), rng.uniform(0, 2, count)
    law = FeedbackLinearization(structure, target, omega, zeta, gravity=gravity)
    records = StructureRecords.of(structure)
    time, u = 0.8, rng.uniform(0, 3, len(structure.strings))
    # q̈ of the DAE's model for these forces: s = n_j - n_i pulls i forward and j back, (2.62).
    forces = np.zeros_like(nodes)
    for m, (i, j) in enumerate(structure.string_nodes):
        pull = u[m] * (nodes[j] - nodes[i])
        forces[i] += pull
        forces[j] -= pull
    q, rates = records.coordinates(nodes), records.coordinates(velocities)
    acc, multipliers = np.empty(records.nq), np.empty(len(structure.rods))
    accelerations(Members(records.rods, records.points, np.array(gravity), forces, multipliers), q, rates, acc)

    def error_rate(dt: float) -> Array:
        there, moving = structure.positions.copy(), np.zeros_like(nodes)
        place_nodes(q + dt * rates + dt**2 / 2 * acc, rates + dt * acc, records.rods, records.points, there, moving)
        return law.error(time + dt, there, moving)[1]

    h = 1e-4
    e, rate = law.error(time, nodes, velocities)
    ddot = (error_rate(h) - error_rate(-h)) / (2 * h)
    A, d, _ = law.equation(time, nodes, velocities)
    expected = ddot + 2 * zeta * omega * rate + omega**2 * e
    # h²/6 times third derivatives, which are of the order of a hundred at most away from the pole.
    np.testing.assert_allclose(A @ u - d, expected, rtol=0, atol=1e-5 * (1 + np.abs(expected).max()))


def test_coordinates_are_named_in_their_order() -> None:
    rods = (
        tmj.Rod("slider", ("a", "b"), 1.0, support=tmj.Support.constrained([[0, 0, 1]])),
        tmj.Rod("flat", ("c", "d"), 1.0, support=tmj.Support.free(plane=(0, 1, 0))),
    )
    nodes = {"a": (0, 0, 0), "b": (0, 1, 0), "c": (2, 0, 0), "d": (3, 0, 0), "p": (5, 5, 5)}
    strings = (tmj.String("s", ("b", "p"), 1.0),)
    structure = tmj.Structure("named", nodes, rods, strings, (), (tmj.PointMass("p", 1.0),))
    law = FeedbackLinearization(structure, tmj.Target.set_point(structure.positions))
    names = [f"{one.name} [{one.unit}]" for one in law.coordinates]
    assert names == [
        *("x of rod 'slider' [m/s²]", "y of rod 'slider' [m/s²]"),
        *("θ of rod 'slider' [rad/s²]", "φ of rod 'slider' [rad/s²]"),
        *("x of rod 'flat' [m/s²]", "z of rod 'flat' [m/s²]", "θ of rod 'flat' [rad/s²]"),
        *("x of node 'p' [m/s²]", "y of node 'p' [m/s²]", "z of node 'p' [m/s²]"),
    ]


def test_angles_go_the_short_way_round() -> None:
    structure = cross().structure
    there = cross_nodes(1.0, np.radians(175.0), np.radians(-170.0))
    aim = cross_nodes(1.0, np.radians(-175.0), np.radians(170.0))
    e, _ = FeedbackLinearization(structure, aim).error(0.0, there, np.zeros_like(there))
    # Two signs: the plane's basis may turn either way.
    np.testing.assert_allclose(np.abs(e), [0.0, np.radians(10.0), np.radians(20.0)], atol=1e-14)
    assert e[1] * e[2] < 0


# Error dynamics --------------------------------------------------------------------------------------------


@pytest.mark.third_means("laws, in a closed loop", by="(1 + t) e^{-t}")
@pytest.mark.parametrize("minimum_sum", [0.0, 1.2])
def test_a_set_point_is_approached_as_it_must_be(minimum_sum: float) -> None:
    scene = cross(minimum_sum=minimum_sum)
    scene = scene.with_(target=tmj.Target.set_point(scene.target.nodes[-1]))  # type: ignore[union-attr]
    law = tmj.controllers.from_scene(scene)
    run = tmj.simulate(scene, law, TIGHT)
    assert run.status is tmj.Status.COMPLETED
    e, rate = errors_of(law, run)
    t = run.time[:, None]
    np.testing.assert_allclose(e, (1 + t) * np.exp(-t) * e[0], rtol=0, atol=1e-9 * np.abs(e[0]).max())
    np.testing.assert_allclose(rate, -t * np.exp(-t) * e[0], rtol=0, atol=1e-9 * np.abs(e[0]).max())
    assert np.all(run.force_densities >= 0)


def test_each_coordinate_may_have_its_own_dynamics() -> None:
    scene = cross(minimum_sum=4.0)
    scene = scene.with_(target=tmj.Target.set_point(cross_nodes(1.2, -1.1, 1.15)))
    omega, zeta = np.array([0.8, 1.0, 1.5]), np.array([0.6, 1.0, 2.0])
    law = tmj.controllers.from_scene(scene, natural_frequency=omega, damping=zeta)
    run = tmj.simulate(scene, law, TIGHT, duration=4.0)
    e, _ = errors_of(law, run)
    t = run.time
    expected = np.empty_like(e)
    for i in range(3):
        # e'' + 2 ζ ω e' + ω² e = 0 from rest, by the matrix exponential.
        w, V = np.linalg.eig(np.array([[0, 1], [-(omega[i] ** 2), -2 * zeta[i] * omega[i] + 1e-9 * (i == 1)]], complex))
        c = np.linalg.solve(V, [e[0, i], 0])
        expected[:, i] = np.real(V[0, 0] * c[0] * np.exp(w[0] * t) + V[0, 1] * c[1] * np.exp(w[1] * t))
    # The critically damped one differs from its neighbour by 1e-9 of damping, and eigenvectors lose 1e-16/1e-5.
    np.testing.assert_allclose(e, expected, rtol=0, atol=1e-8 * np.abs(e[0]).max())
    assert run.status is tmj.Status.COMPLETED


def tripod() -> tmj.Scene:
    """A rod on a ball joint that lies near the x axis, held by four strings round its tip, under gravity."""
    tip = np.array([np.cos(0.2), np.sin(0.2), 0.0])
    nodes = {"O": (0, 0, 0), "tip": tuple(tip), "up": (0.9, 0, 2), "down": (0.9, 0, -2), "left": (0.9, 2, 0)}
    nodes["right"] = (0.9, -2, 0)
    rod = tmj.Rod("rod", ("O", "tip"), 1.0, support=tmj.Support.pinned())
    strings = tuple(tmj.String(name, ("tip", name), 100.0) for name in ("up", "down", "left", "right"))
    structure = tmj.Structure("tripod", nodes, (rod,), strings, ("up", "down", "left", "right"))  # type: ignore[arg-type]
    aim = structure.positions.copy()
    aim[1] = [np.cos(0.3), 0, np.sin(0.3)]
    return tmj.Scene(structure, gravity=(0, 0, -9.81), target=tmj.Target.set_point(aim), duration=8.0)


def test_it_holds_in_space_and_under_gravity() -> None:
    scene = tripod()
    law = FeedbackLinearization(scene.structure, scene.target, gravity=scene.gravity)  # type: ignore[arg-type]
    runs = [tmj.simulate(scene, law, engine) for engine in (TIGHT, tmj.MuJoCo(1e-2), tmj.ODE(rtol=1e-11, atol=1e-12))]
    for run in runs:
        assert tmj.compare(run, runs[0]).max_node_error < 1e-7
    e, _ = errors_of(law, runs[0])
    t = runs[0].time[:, None]
    np.testing.assert_allclose(e, (1 + t) * np.exp(-t) * e[0], rtol=0, atol=1e-9 * np.abs(e[0]).max())
    blind = FeedbackLinearization(scene.structure, scene.target)  # type: ignore[arg-type]
    fallen = tmj.simulate(scene, blind, TIGHT)
    assert np.abs(errors_of(law, fallen)[0][-1]).max() > 0.1  # what gravity does to a law that does not account for it
    assert any("gravity" in warning for warning in fallen.reports["warnings"])


def test_a_path_in_space_is_followed() -> None:
    scene = tripod()
    path = tmj.Target.path([0.0, 3.0], [scene.nodes0, scene.target.nodes[0]])  # type: ignore[union-attr]
    law = FeedbackLinearization(scene.structure, path, gravity=scene.gravity)
    run = tmj.simulate(scene.with_(target=path), law, TIGHT, duration=4.0)
    assert np.abs(errors_of(law, run)[0]).max() < 1e-10  # the integration's error; there is none of the law's


def test_a_rod_at_the_pole_is_named() -> None:
    scene = tripod()
    nodes = scene.nodes0.copy()
    nodes[1] = [0, 0, 1]
    law = FeedbackLinearization(scene.structure, scene.target)  # type: ignore[arg-type]
    with pytest.raises(InfeasibleError, match=r"t = 1\.5 s.*rod 'rod'.*singular"):
        law(1.5, nodes, np.zeros_like(nodes))


# The cross of §4.6.1 ----------------------------------------------------------------------------------------


def test_the_cross_is_that_of_the_thesis() -> None:
    scene = tmj.load_scene("cross")
    assert scene == cross()
    np.testing.assert_allclose(scene.nodes0[[0, 3]], [[0, 0, 1.33], [0.4836895, 0, 1.3289260]], atol=1e-7)
    law = tmj.controllers.from_scene(scene)
    assert len(law.coordinates) == 3


def run_cross(minimum_sum: float, engine: Any = TIGHT, **options: Any) -> tmj.Trajectory:
    scene = cross(minimum_sum=minimum_sum)
    return tmj.simulate(scene, tmj.controllers.from_scene(scene), engine, output_interval=0.02, **options)


def test_figure_44() -> None:
    high, middle, none = (run_cross(value) for value in (1.2, 0.4, 0.0))
    for run in (high, middle, none):
        law = tmj.controllers.from_scene(run.scene)
        assert np.abs(errors_of(law, run)[0]).max() < 1e-10
        assert np.nanmax(run.allocation_residual) < 1e-12
    # 1.2: always on its bound, every u >= 0.12 (read off), smooth.
    np.testing.assert_allclose(high.force_densities.sum(axis=1), 1.2, rtol=0, atol=1e-11)
    assert 0.12 < high.force_densities.min() < 0.13
    # 0.4: off its bound in two intervals; its peak is that of no criterion at all.
    total = middle.force_densities.sum(axis=1)
    assert total.min() > 0.4 - 1e-11
    off = total > 0.4 + 1e-9
    edges = middle.time[np.flatnonzero(np.diff(off.astype(int)))]
    np.testing.assert_allclose(edges, [0.62, 3.48, 6.06, 9.36], rtol=0, atol=0.021)  # recorded each 0.02 s
    assert total.max() == pytest.approx(0.694, abs=5e-4)
    free = none.force_densities.sum(axis=1)
    np.testing.assert_allclose(free[off], total[off], rtol=0, atol=1e-9)
    assert free[0] == pytest.approx(0, abs=1e-12)
    assert free[-1] == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize("minimum_sum", [1.2, 0.4])
def test_the_engines_agree_and_stiffness_has_no_influence(minimum_sum: float) -> None:
    reference = run_cross(minimum_sum)
    for engine in (tmj.MuJoCo(1e-2), tmj.ODE(rtol=1e-11, atol=1e-12)):
        assert tmj.compare(run_cross(minimum_sum, engine), reference).max_node_error < 1e-7
    scene = cross(minimum_sum=minimum_sum, stiffness=7.0)
    softer = tmj.simulate(scene, tmj.controllers.from_scene(scene), TIGHT, output_interval=0.02)
    assert np.abs(softer.nodes - reference.nodes).max() < 1e-9
    np.testing.assert_allclose(softer.force_densities, reference.force_densities, rtol=0, atol=1e-8)


def test_a_law_keeps_nothing_from_one_run_to_the_next() -> None:
    scene = cross(minimum_sum=0.4)
    law = tmj.controllers.from_scene(scene)
    first, second = (tmj.simulate(scene, law, tmj.MuJoCo(1e-2), duration=3.0) for _ in range(2))
    np.testing.assert_array_equal(first.nodes, second.nodes)
    np.testing.assert_array_equal(first.force_densities, second.force_densities)
    # Nor from one call to the next: states in any order have their u.
    order = np.random.default_rng(0).permutation(len(first.time))
    for row in order[:50]:
        u = law(first.time[row], first.nodes[row], first.velocities[row])
        np.testing.assert_allclose(u, first.force_densities[row], rtol=0, atol=1e-10)


# Where there is no solution ---------------------------------------------------------------------------------


def test_a_run_stops_with_the_constraint_at_fault() -> None:
    scene = cross(minimum_sum=1.2)
    law = tmj.controllers.from_scene(scene, maximum_force_density=0.35)
    run = tmj.simulate(scene, law, tmj.MuJoCo(1e-2))
    assert run.status is tmj.Status.INFEASIBLE
    assert 0.1 < run.time[-1] < 9.0
    for part in ("no admissible force densities", "of rod '", "is missed by", "at its maximum of 0.35 N/m"):
        assert part in run.message


def test_relaxed_runs_report_what_they_miss() -> None:
    scene = cross(minimum_sum=1.2)
    law = tmj.controllers.from_scene(scene, maximum_force_density=0.35, on_infeasible="relax")
    runs = [tmj.simulate(scene, law, engine) for engine in (tmj.MuJoCo(1e-2), tmj.DAE(rtol=1e-9, atol=1e-10))]
    assert all(run.status is tmj.Status.COMPLETED for run in runs)
    assert tmj.compare(*runs).max_node_error < 1e-5  # kinks where the bound comes in
    residual = runs[0].allocation_residual
    assert residual[0] < 1e-12
    assert 1e-3 < np.nanmax(residual) < 1.0
    assert runs[0].force_densities.max() <= 0.35 + 1e-12
    assert law.report.shape == (5,)


def test_holding_is_for_sampled_runs() -> None:
    scene = cross(minimum_sum=1.2)
    law = tmj.controllers.from_scene(scene, maximum_force_density=0.35, on_infeasible="hold")
    with pytest.raises(OptionError, match="sampled"):
        tmj.simulate(scene, law, tmj.MuJoCo(1e-2))
    run = tmj.simulate(
        scene,
        law,
        tmj.MuJoCo(1e-2),
        actuation=tmj.Actuation.hold_force_density(0.01),
        duration=3.0,
        output_interval=0.01,
    )
    assert run.status is tmj.Status.COMPLETED
    missed = run.allocation_residual > 1e-9
    first = int(np.argmax(missed))
    assert missed.any()
    np.testing.assert_allclose(run.force_densities[first], run.force_densities[first - 1], rtol=0, atol=1e-9)
    # Another run, which has no solution from the first, has nothing to hold: not what the run before held either.
    beside = scene.with_(initial_nodes=cross_nodes(1.0, -1.0, 1.0))
    lost = tmj.simulate(beside, law, tmj.MuJoCo(1e-2), actuation=tmj.Actuation.hold_force_density(0.01), duration=1.0)
    assert lost.status is tmj.Status.INFEASIBLE
    assert "t = 0 s" in lost.message


def test_the_linear_objective_runs_sampled() -> None:
    scene = cross(minimum_sum=0.4)
    law = tmj.controllers.from_scene(scene, linear=[1.0, 1.0, 1.0, 1.0])
    with pytest.raises(OptionError, match="sampled"):
        tmj.simulate(scene, law, TIGHT)
    run = tmj.simulate(
        scene, law, tmj.MuJoCo(1e-2), actuation=tmj.Actuation.hold_force_density(0.01), output_interval=0.1
    )
    # Four strings, three equations: one free parameter, whose sum has its least where the criterion or a bound stops
    # it. Where the sum is off its bound both objectives stop at the same bound, so the sums agree, up to sampling.
    quadratic = run_cross(0.4, tmj.MuJoCo(1e-2))
    total = run.force_densities.sum(axis=1)
    assert total.max() == pytest.approx(quadratic.force_densities.sum(axis=1).max(), abs=5e-3)
    assert total.min() > 0.4 - 1e-7
    assert run.target_error().max() < 1e-3


def test_options_that_are_refused() -> None:
    scene = cross()
    for options, part in (
        ({"natural_frequency": 0.0}, "natural_frequency"),
        ({"natural_frequency": [1.0, 2.0]}, "shape (3,)"),
        ({"damping": -1.0}, "damping"),
        ({"sums": [["none", 1.0]]}, "strings = 'none'"),
        ({"sums": [[["left", "top"], 1.0]]}, "unknown string 'top'"),
        ({"sums": 1.2}, "list of pairs"),
        ({"on_infeasible": "give up"}, "stop, relax, hold"),
        ({"gain": 1.0}, "no option 'gain'"),
    ):
        with pytest.raises(OptionError) as caught:
            tmj.controllers.from_scene(scene, **options)
        assert part in str(caught.value)
    with pytest.raises(OptionError, match="target"):
        FeedbackLinearization(scene.structure, None)  # type: ignore[arg-type]
    with pytest.raises(OptionError, match="other nodes or strings"):
        tmj.simulate(tmj.load_scene("prism"), tmj.controllers.from_scene(scene))


def test_what_it_reports_of_itself() -> None:
    law = FeedbackLinearization(
        cross().structure,
        cross().target,  # type: ignore[arg-type]
        2.0,
        0.7,
        Allocation(sums=(Sum(1.2), Sum(0.1, ("left",))), on_infeasible=WhenInfeasible.RELAX),
    )
    reported = law.describe()
    assert (reported["law"], reported["natural_frequency"], reported["damping"]) == ("feedback_linearization", 2.0, 0.7)
    assert reported["allocation"]["sums"] == [[["left", "lower", "right", "upper"], 1.2], [["left"], 0.1]]
    assert reported["allocation"]["on_infeasible"] == "relax"
    run = tmj.simulate(cross(), law, tmj.MuJoCo(1e-2), duration=0.1)
    assert run.provenance["controller"] == reported
    assert np.all(np.isnan(run.feasibility_margin))


def test_round_off_at_a_target_requires_nothing_of_the_strings() -> None:
    """Where a structure rests at its target the errors are round-off, and their sign must not decide feasibility."""
    rng = np.random.default_rng(3)
    scene = tmj.load_scene("pinned_rod")
    for trial in range(50):
        nodes = scene.nodes0.copy()
        rod = scene.structure.rods[0]
        tip = scene.structure.node_index[rod.nodes[1]]
        law = FeedbackLinearization(scene.structure, nodes.copy())
        nodes[tip] *= 1 + 2e-16 * rng.integers(-2, 3, 3)
        np.testing.assert_array_equal(law(0.0, nodes, np.zeros_like(nodes)), 0.0, err_msg=str(trial))
    # A real error is not mistaken for round-off.
    nodes = scene.nodes0.copy()
    nodes[tip] += 1e-12 * np.cross(nodes[tip], [0.0, 0.0, 1.0])
    _, d, _ = law.equation(0.0, nodes, np.zeros_like(nodes))
    assert np.max(np.abs(d)) > 0


def test_a_cross_of_other_forms_is_refused() -> None:
    for options, words in (
        ({"start": (1.0, 2.0)}, "start"),
        ({"start": None}, "start"),
        ({"end": ("a", 1.0, 1.0)}, "end"),
        ({"minimum_sum": "much"}, "minimum_sum"),
    ):
        with pytest.raises(OptionError, match=words):
            cross(**options)  # type: ignore[arg-type]


def test_states_that_no_law_can_be_evaluated_at() -> None:
    """Compiled code would read beyond arrays that are too short."""
    scene = tmj.load_scene("cross")
    nodes, velocities = scene.nodes0, scene.velocities0
    for name in ("feedback_linearization", "lyapunov", "projection"):
        law = tmj.controllers.from_scene(scene, name)
        calls = [law, law.equation, law.error] if name == "feedback_linearization" else [law, law.evaluate, law.terms]
        for call in calls:
            for state, words in (
                ((0.0, nodes[:2], velocities), "nodes"),
                ((0.0, nodes, velocities[:2]), "velocities"),
                ((0.0, nodes * np.nan, velocities), "nodes"),
                ((0.0, "here", velocities), "nodes"),
                (("now", nodes, velocities), "time"),
            ):
                with pytest.raises(OptionError, match=words):
                    call(*state)
