"""Contact in the DAE: against MuJoCo at states and along runs, against closed forms, and its law of Coulomb's."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from contact_law import impedance
from scipy.optimize import brentq
from touching_scenes import Array, State, held_rod, logs, pile, reaction, touching_robot, touching_rod

import tensegrity_mj as tmj
from tensegrity_mj.dynamics.contact import COULOMB, FLOOR, MUJOCO, Floor, push, push_all, room_size, system
from tensegrity_mj.dynamics.native.compiling import njit
from tensegrity_mj.dynamics.native.law import native_law
from tensegrity_mj.dynamics.native.pointers import address
from tensegrity_mj.dynamics.native.views import Table
from tensegrity_mj.engines.request import Request
from tensegrity_mj.model import Contact
from tensegrity_mj.model.actuation import Actuation, OnInfeasible

G = 9.81
SCENES = ("prism_drop", "six_bar_drop", "six_bar_push", "six_bar_roll")
STEP = 1e-4


@pytest.fixture
def solved(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let MuJoCo's solver go on until its cost falls no more: it stops by a cost, of which forces are the root."""
    monkeypatch.setattr("tensegrity_mj.engines.mujoco.mjcf.SOLVER_TOLERANCE", 0.0)
    monkeypatch.setattr("tensegrity_mj.engines.mujoco.prepared._layouts", {})  # models of this tolerance


def states() -> dict[str, list[State]]:
    rng = np.random.default_rng(32)
    found = {f"{ends} ends": [touching_rod(rng, ends) for _ in range(100)] for ends in (1, 2)}
    for name in SCENES[:2]:
        scene = tmj.load_scene(name)
        found[name] = [touching_robot(scene, rng) for _ in range(50)]
    found["held"] = [held_rod(rng) for _ in range(60)]
    found["pile"] = [pile(rng) for _ in range(100)]
    found["logs"] = [logs(rng) for _ in range(100)]
    return found


@pytest.mark.usefixtures("solved")
@pytest.mark.parametrize("where", list(states()))
def test_accelerations_are_those_of_mujoco(where: str) -> None:
    """At 560 states. Forces are those of springs D = 1/R on accelerations in MuJoCo, of R_t = (1 - d)/(100 d) A: digits
    of 1/R_t >= 1/2000 of A are lost of 16, which leaves 1e-12 of the largest acceleration. What holds spin there leaves
    a part of 12 (ρ/ℓ)² 1e-9 <= 3e-12 of 1/m, in a pile, of rods of up to 20 mm, 1.3e-11; and there are a few of each.
    """
    for scene, nodes, velocities in states()[where]:
        ours, theirs = (reaction(scene, engine, nodes, velocities) for engine in (tmj.DAE(), tmj.MuJoCo()))
        free = reaction(scene.with_(contact=None), tmj.DAE(), nodes, velocities)
        size = max(np.abs(theirs).max(), np.abs(free).max(), np.abs(theirs - free).max())
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=(5e-11 if where in ("pile", "logs") else 1e-11) * size)


@pytest.mark.parametrize(("name", "duration"), [("prism_drop", 0.5), ("six_bar_push", 0.3)])
def test_runs_are_those_of_mujoco(name: str, duration: float) -> None:
    """The same RK4 step: truncation of both, in other coordinates, falls with h⁴: 8e-11 m at 0.1 ms."""
    _agree(tmj.load_scene(name), duration)


def test_rods_spin_as_those_of_mujoco() -> None:
    scene = tmj.load_scene("six_bar_push")
    assert scene.contact is not None
    scene = scene.with_(contact=replace(scene.contact, spin="free"))
    held = tmj.simulate(tmj.load_scene("six_bar_push"), None, tmj.DAE(), duration=0.3)
    run = _agree(scene, 0.3)
    assert np.abs(run.nodes[-1] - held.nodes[-1]).max() > 1e-4


@pytest.mark.study
@pytest.mark.parametrize("name", SCENES)
def test_whole_runs_are_those_of_mujoco(name: str) -> None:
    scene = tmj.load_scene(name)
    _agree(scene, scene.duration)


def _agree(scene: tmj.Scene, duration: float) -> tmj.Trajectory:
    law = tmj.controllers.from_scene(scene) if scene.control else None
    engines = (tmj.DAE(method="rk4", timestep=STEP), tmj.MuJoCo(STEP))
    ours, theirs = (tmj.simulate(scene, law, engine, duration=duration) for engine in engines)
    assert np.abs(ours.nodes - theirs.nodes).max() < 1e-9
    np.testing.assert_allclose(ours.external_work, theirs.external_work, rtol=0, atol=1e-8)
    np.testing.assert_allclose(
        ours.multipliers, theirs.multipliers, rtol=0, atol=1e-7 * np.abs(theirs.multipliers).max()
    )
    found, wanted = ours.reports["contact"], theirs.reports["contact"]
    assert found.keys() == wanted.keys()
    assert max(found["touching"]) > 0
    assert found["touching"] == wanted["touching"]
    assert found["deepest"] == pytest.approx(wanted["deepest"], abs=1e-9)
    assert found["largest_normal_force"] == pytest.approx(wanted["largest_normal_force"], rel=1e-6)
    assert found["final_forces"].keys() == wanted["final_forces"].keys()
    for node, force in found["final_forces"].items():
        np.testing.assert_allclose(force, wanted["final_forces"][node], rtol=0, atol=1e-6)
    return ours


def test_dop853_has_the_truth_to_a_tenth_of_a_nanometre() -> None:
    """Tolerances a tenth as large change nothing by more, and the ledger closes; RK4 tends to it, by its touches."""
    scene = tmj.load_scene("prism_drop")
    engines = (tmj.DAE(rtol=1e-12, atol=1e-14), tmj.DAE(rtol=1e-13, atol=1e-15))
    truth, finer = (tmj.simulate(scene, None, engine, duration=1.0) for engine in engines)
    assert np.abs(truth.nodes - finer.nodes).max() < 1e-10
    assert truth.energy_residual < 1e-9
    assert truth.external_work[-1] < -0.1  # friction and damping took it
    errors = [
        np.abs(tmj.simulate(scene, None, tmj.DAE(method="rk4", timestep=h), duration=1.0).nodes - finer.nodes).max()
        for h in (5e-4, 1e-4)
    ]
    assert errors[1] < 1e-4
    assert errors[1] < errors[0] / 4


def test_rods_that_cross_touch_each_other_as_in_mujoco() -> None:
    """A robot of thick rods, squeezed by its own strings, lands on its side: floor and rods at the same time."""
    scene = tmj.load_scene("prism_drop")
    assert scene.contact is not None
    rods = [replace(rod, radius=0.025) for rod in scene.structure.rods]
    strings = scene.structure.with_strings(rest_length=0.8 * np.array(scene.structure.rest_lengths)).strings
    structure = replace(scene.structure, rods=tuple(rods), strings=strings)
    contact = replace(scene.contact, rods=True)
    start = {"initial_nodes": scene.nodes0 - [0, 0, 0.28], "initial_velocities": [(0.5, 0, -1.0)] * 6}
    squeezed = scene.with_(structure=structure, contact=contact, **start)
    run = _agree(squeezed, 0.1)
    assert max(run.reports["contact"]["touching"]) > 3
    alone = tmj.simulate(squeezed.with_(contact=scene.contact), None, tmj.DAE(), duration=0.1)
    assert np.abs(alone.nodes[-1] - run.nodes[-1]).max() > 1e-3


# The law of Coulomb's, by other ways than the product's.


@njit
def _one(floor, H, c, f):  # type: ignore[no-untyped-def]
    f[0], f[1], f[2] = push(Floor(floor), (H[0, 0], H[0, 1], H[0, 2], H[1, 1], H[1, 2], H[2, 2]), (c[0], c[1], c[2]))


@njit
def _two(floor, given, room):  # type: ignore[no-untyped-def]
    equations = system(address(room), 2)
    equations[0][:], equations[1][:], equations[2][:] = given
    push_all(Floor(floor), equations)
    return equations[3].copy()


def law_of(kind: int, friction: float) -> Table:
    table = Table("Floor", FLOOR)
    table.set(kind=kind, friction=friction)
    return table


def problem(rng: np.random.Generator) -> tuple[float, Array, Array, Array]:
    """μ, and A (6, 6), c (6,), R (6,) of both ends of a rod that lies nearly or not at all."""
    b = rng.normal(size=3) * (rng.choice([0.02, 1.0]), 1.0, 1.0)
    b /= np.linalg.norm(b)
    ends = [level * b - (rng.uniform(0.001, 0.05), 0.0, 0.0) for level in (-0.5, 0.5)]
    turns = [(np.eye(3) - np.outer(b, b)) @ np.cross(x, np.eye(3)).T for x in ends]
    inertia = rng.uniform(0.02, 0.1)
    A = np.block([[np.eye(3) + one.T @ other / inertia for other in turns] for one in turns])
    d = rng.uniform(0.01, 0.97, 2)
    R = np.concatenate(
        [(1 - one) / one * A[at, at] * np.array([1, 0.01, 0.01]) for one, at in zip(d, (0, 3), strict=True)]
    )
    c = rng.normal(size=6) * 10 ** rng.uniform(-1, 2, 6)
    c[[0, 3]] = np.where(rng.random(2) < 0.7, -np.abs(c[[0, 3]]), c[[0, 3]])
    return float(rng.choice([0.05, 0.3, 0.6, 1.0, 2.0, 5.0])), A, c, R


def by_slip(mu: float, H: Array, c: Array) -> Array:
    """f of Coulomb's law by one number x >= 0, f_t = -w_t / x: for each x three linear equations, then |f_t| = μ f_n.

    At x = 0 it sticks; at a large one friction vanishes, so that a root is between wherever it does not stick.
    """
    if c[0] >= 0:
        return np.zeros(3)

    def force(x: float) -> Array:
        return np.asarray(np.linalg.solve(H + np.diag([0.0, x, x]), -c))

    def outside(log: float) -> float:
        f = force(float(np.exp(log)))
        return float(np.hypot(f[1], f[2]) - mu * f[0])

    stuck = force(0.0)
    if np.hypot(stuck[1], stuck[2]) <= mu * stuck[0]:
        return stuck
    return force(float(np.exp(brentq(outside, -40.0, 40.0, xtol=1e-15, rtol=1e-15, maxiter=500))))


def test_coulombs_law_of_one_contact_is_that_of_another_solver() -> None:
    """600 problems. The root is known to 1e-15 of its logarithm, and f to that and some roundings of H⁻¹ c."""
    rng = np.random.default_rng(853)
    kinds = {"apart": 0, "stuck": 0, "slides": 0}
    for _ in range(600):
        mu, A, c, R = problem(rng)
        H, law, f = A[:3, :3] + np.diag(R[:3]), law_of(COULOMB, mu), np.zeros(3)
        _one(law.address, H, c[:3].copy(), f)
        assert law["unsolved"] == 0
        wanted = by_slip(mu, H, c[:3])
        np.testing.assert_allclose(f, wanted, rtol=0, atol=1e-11 * np.abs(wanted).max())
        slides = abs(np.hypot(f[1], f[2]) - mu * f[0]) < 1e-9 * f[0]
        kinds["slides" if slides else "stuck" if f[0] > 0 else "apart"] += 1
    assert min(kinds.values()) > 50


@pytest.mark.parametrize("kind", [MUJOCO, COULOMB])
@pytest.mark.parametrize("count", [1, 2])
def test_forces_satisfy_the_laws_as_they_are_stated(kind: int, count: int) -> None:
    """f and f - w/H_nn have the same nearest point in the set of the law, which is f: to 1e-11 of the largest force."""
    rng = np.random.default_rng(45)
    for _ in range(600):
        mu, A, c, R = problem(rng)
        law, f = law_of(kind, mu), np.zeros(3 * count)
        if count == 1:
            _one(law.address, A[:3, :3] + np.diag(R[:3]), c[:3].copy(), f)
        else:
            f = _two(law.address, (A, c, R), np.zeros(room_size(2)))
        assert law["unsolved"] == 0
        size = 3 * count
        w = (A + np.diag(R))[:size, :size] @ f + c[:size]
        for at in range(0, size, 3):
            own = f[at : at + 3]
            moved = own - w[at : at + 3] / (A[at, at] + R[at])
            slip = float(np.hypot(moved[1], moved[2]))
            if kind == COULOMB:
                nearest = np.array([max(moved[0], 0.0), *moved[1:] * min(1.0, mu * own[0] / slip)])
            elif mu * slip <= -moved[0]:
                nearest = np.zeros(3)
            elif slip <= mu * moved[0]:
                nearest = moved
            else:
                part = (moved[0] + mu * slip) / (1 + mu**2)
                nearest = np.array([part, *(mu * part / slip * moved[1:])])
            np.testing.assert_allclose(own, nearest, rtol=0, atol=1e-11 * np.abs(f).max())


@pytest.mark.parametrize("spin", ["held", "free"])
def test_coulombs_law_is_of_the_acceleration_that_contacts_have(spin: str) -> None:
    """With w = dv/dt - aref + R f and v = ẋ + ω × ρ of a contact, differentiated along the motion that the DAE gives:
    w_n = 0 and w_t is against f_t. So J̇ v is in it. Central differences of 1e-6 s leave (1e-6 ω)² and eps v / 1e-6 s.
    """
    rng = np.random.default_rng(7)
    pushed = 0
    for _ in range(40):
        scene, nodes, velocities = touching_rod(rng, 1, law="coulomb", spin=spin)
        contact, law = scene.contact, native_law(None, scene.structure)
        assert contact is not None
        request = Request(scene, law, Actuation.continuous(), OnInfeasible.STOP, 1.0, None, False)
        run = tmj.DAE().prepared(request)
        nq, up = run.records.nq, contact.up
        run.y[:nq], run.y[nq : 2 * nq] = run.records.state(nodes, velocities)
        if nq > 6:
            run.y[2 * nq - 1] = rng.normal() * 10
        rates = run.rates_at(0.0, run.y, None)
        f = run.multipliers[1:4].copy()
        gap, v = contact_motion(run, rates, 0.0)
        change = (contact_motion(run, rates, 1e-6)[1] - contact_motion(run, rates, -1e-6)[1]) / 2e-6
        stiffness, damping, (_, d1, *_) = contact.spring
        d, rod = impedance(contact, -gap), run.records.rods[0]
        b = (nodes[1] - nodes[0]) / np.linalg.norm(nodes[1] - nodes[0])
        arm, inertia = rod["length"] * rod["center"], rod["J"] - rod["f"] ** 2 / rod["mass"]
        R = (1 - d) / d * (1 / rod["mass"] + arm**2 * (1 - (b @ up) ** 2) / inertia)
        w = change + damping / d1 * v + 0.01 * R * f
        normal = w @ up + 0.99 * R * (f @ up) + stiffness * d / d1**2 * gap
        slip, tangent = w - (w @ up) * up, f - (f @ up) * up
        size = np.abs(change).max() + damping * np.abs(v).max()
        if f @ up == 0.0:
            assert normal >= -1e-7 * size
            continue
        pushed += 1
        assert abs(normal) < 1e-7 * size
        if contact.friction == 0:
            continue
        assert np.linalg.norm(np.cross(slip, tangent)) <= 1e-7 * size * np.linalg.norm(tangent)
        assert slip @ tangent <= 1e-7 * size * np.linalg.norm(tangent)
    assert pushed > 10


def contact_motion(run: Any, rates: Array, t: float) -> tuple[float, Array]:
    """Gap and velocity of the contact at the first end of a rod, a little later than the run's state."""
    nq, y, contact = run.records.nq, run.y.copy(), run.request.scene.contact
    y[:nq] += t * y[nq : 2 * nq] + 0.5 * t**2 * rates[nq : 2 * nq]
    y[nq : 2 * nq] += t * rates[nq : 2 * nq]
    run.rates_at(0.0, y, None)
    (first, second), (v, w) = run.plant["nodes"], run.plant["velocities"]
    span, radius = second - first, run.request.scene.structure.rods[0].radius
    gap = float(first @ contact.up) - contact.floor - radius
    turn = np.cross(span, w - v) / (span @ span) + (y[2 * nq - 1] * span / np.linalg.norm(span) if nq > 6 else 0.0)
    return gap, v + np.cross(turn, -contact.up * (radius + gap / 2))


# Closed forms.


def upright(contact: Contact, **more: Any) -> tmj.Scene:
    """A rod that stands upright, an end 1 mm above the floor."""
    nodes = {"a": (0, 0, 0.021), "b": (0, 0, 0.621)}
    return tmj.Scene(tmj.Structure("rod", nodes, (tmj.Rod("rod", ("a", "b"), 0.7, 0.02),)), contact=contact, **more)


@pytest.mark.parametrize("law", ["mujoco", "coulomb"])
@pytest.mark.parametrize("ratio", [0.3, 0.7])
def test_a_rod_bounces_as_a_damped_spring_does(law: str, ratio: float) -> None:
    """e = exp(-ζ/√(1 - ζ²) (π - 2 arcsin ζ)) of a spring that pushes only, with no weight; all that it loses is in the
    ledger. DOP853 meets two kinks, of which each errs by its tolerance.
    """
    contact = Contact(floor=0.0, damping=2 * ratio * 200, stiffness=4e4, impedance=(0.95, 0.95, 2e-3, 0.5, 2), law=law)
    scene = upright(contact, initial_velocities=[(0, 0, -1.0)] * 2)
    run = tmj.simulate(scene, None, tmj.DAE(), duration=0.05)
    root = np.sqrt(1 - ratio**2)
    wanted = np.exp(-ratio / root * (np.pi - 2 * np.arcsin(ratio)))
    assert run.velocities[-1, 0, 2] == pytest.approx(wanted, abs=1e-8)
    assert run.external_work[-1] == pytest.approx(-0.35 * (1 - wanted**2), abs=1e-8)


def log_on_a_slope(contact: Contact, tangent: float, **more: Any) -> tmj.Scene:
    """A rod that lies along a slope of this tangent, as deep as it rests without friction."""
    angle = np.arctan(tangent)
    nodes = {"a": (0, 0, 0.03), "b": (0.8, 0, 0.03)}
    gravity = (G * np.sin(angle), 0.0, -G * np.cos(angle))
    structure = tmj.Structure("log", nodes, (tmj.Rod("log", ("a", "b"), 2.0, 0.03),))
    return tmj.Scene(structure, gravity=gravity, contact=contact, **more)


def test_by_coulombs_law_what_slides_does_not_rise() -> None:
    """A rod that slides along itself gets faster by g (sin α - μ cos α) and stays as deep as it is; by MuJoCo's law it
    rises as it gets faster. It has swung in after 0.5 s, by e^-100.
    """
    tangent, mu = 0.9, 0.5
    angle = np.arctan(tangent)
    for law, rises in (("coulomb", False), ("mujoco", True)):
        scene = log_on_a_slope(Contact(floor=0.0, friction=mu, law=law), tangent)
        run = tmj.simulate(scene, None, tmj.DAE(), duration=1.0, output_interval=0.25)
        speed, height = run.velocities[2:, 0, 0], run.nodes[2:, 0, 2]
        wanted = G * (np.sin(angle) - mu * np.cos(angle)) * 0.25
        assert (np.diff(speed) == pytest.approx(wanted, rel=1e-8)) is not rises
        assert (height == pytest.approx(height[0], abs=1e-10)) is not rises


@pytest.mark.parametrize("law", ["mujoco", "coulomb"])
def test_what_sticks_creeps_as_a_damper_does(law: str) -> None:
    """Both ends creep at one speed v: each carries b v / R_t, R_t = (1 - d)/(100 d) 4/m by its depth, b = damping/d₁.

    What swings at first has gone by e^-100 and more.
    """
    contact = Contact(
        floor=0.0, friction=0.6, stiffness=4e4, damping=400.0, impedance=(0.5, 0.9, 1e-3, 0.5, 2), law=law
    )
    scene = log_on_a_slope(contact, 0.2)
    run = tmj.simulate(scene, None, tmj.DAE(), duration=2.0, output_interval=1.0)
    d = np.array([impedance(contact, depth) for depth in 0.03 - run.nodes[-1, :, 2]])
    softness = (1 - d) / d * (4 / 2.0) / 100
    wanted = 2.0 * G * np.sin(np.arctan(0.2)) / (400 / 0.9 / softness).sum()
    np.testing.assert_allclose(run.velocities[-1, :, 0], wanted, rtol=1e-7)


def test_a_log_that_slides_sideways_ends_up_rolling() -> None:
    """With a part 1/(1 + I/(m ρ²)) of its speed, about 2/3: friction P takes P/m of it and gives a spin of P ρ/I.

    It starts as deep as it rests, 2 g (1 - d)/d = k d r/d₁² (both ends carry m g/2, A = 4/m), and by Coulomb's law
    stays so, at ρ = radius - r/2. Where spin is held it stops.
    """
    contact = Contact(floor=0.0, friction=0.3, law="coulomb", spin="free")
    stiffness, _, (_, d1, width, *_) = contact.spring

    def unbalanced(depth: float) -> float:
        d = impedance(contact, depth)
        return float(stiffness * d * depth / d1**2 - 2 * G * (1 - d) / d)

    depth = float(brentq(unbalanced, 1e-9, 10 * width, xtol=1e-16))
    nodes = {"a": (0, 0, 0.03 - depth), "b": (0.8, 0, 0.03 - depth)}
    structure = tmj.Structure("log", nodes, (tmj.Rod("log", ("a", "b"), 2.0, 0.03),))
    start = {"gravity": (0, 0, -G), "initial_velocities": [(0, 1.0, 0)] * 2}
    run = tmj.simulate(tmj.Scene(structure, contact=contact, **start), None, tmj.DAE(), duration=1.0)
    inertia, arm = 0.5 * 2.0 * 0.03**2, 0.03 - depth / 2
    np.testing.assert_allclose(run.velocities[-1, :, 1], 1 / (1 + inertia / (2.0 * arm**2)), rtol=1e-8)
    held = tmj.Scene(structure, contact=replace(contact, spin="held"), **start)
    assert np.abs(tmj.simulate(held, None, tmj.DAE(), duration=1.0).velocities[-1]).max() < 1e-8


def test_what_the_dae_has_no_contact_of_is_refused_by_name() -> None:
    from tensegrity_mj.model import Ramp

    def refusal(engine: Any, **changes: Any) -> str:
        scene = tmj.load_scene("prism_drop")
        assert scene.contact is not None
        scene = scene.with_(contact=replace(scene.contact, **changes))
        with pytest.raises(tmj.errors.TensegrityError) as caught:
            tmj.simulate(scene, None, engine, duration=0.01)
        return str(caught.value)

    for changes, words in (
        ({"rolling": 0.01}, "friction of turning or rolling"),
        ({"terrain": Ramp(angle=0.1)}, "a terrain"),
        ({"torsion": 0.01}, "friction of turning or rolling"),
    ):
        text = refusal(tmj.DAE(), **changes)
        assert words in text
        assert "use MuJoCo, or " in text
    assert "locate_slack" in refusal(tmj.DAE(method="rk4", timestep=1e-3, locate_slack=True))
    assert "Solver.FULL" in refusal(tmj.DAE(solver="full"))
    assert "law 'coulomb'" in (text := refusal(tmj.MuJoCo(), law="coulomb"))
    assert "use DAE, or set contact.law = 'mujoco'" in text
    assert "contact of rods with each other" in refusal(tmj.DAE(), law="coulomb", rods=True)


def test_a_scene_file_has_the_law() -> None:
    from tensegrity_mj.model.text.reading import scene_from_toml
    from tensegrity_mj.model.text.writing import scene_to_toml

    scene = upright(Contact(floor=0.0, law="coulomb"))
    text = scene_to_toml(scene)
    assert 'law = "coulomb"' in text
    assert scene_from_toml(text) == scene
    with pytest.raises(tmj.errors.SceneError, match=r"law.*coulomb"):
        Contact(floor=0.0, law="columb")
