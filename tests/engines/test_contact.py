"""Contact: against the documented law integrated apart, at rest, in friction, in the ledger; and who refuses it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest
from contact_law import acceleration, impedance
from momenta import linear_momentum
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

import tensegrity_mj as tmj
from tensegrity_mj.engines.mujoco.mjcf import scene_to_mjcf
from tensegrity_mj.model import rods
from tensegrity_mj.model.elements.contact import FRICTION_IMPEDANCE, Contact, overlaps, segment_distances
from tensegrity_mj.model.text.reading import scene_from_toml
from tensegrity_mj.model.text.writing import scene_to_toml
from tensegrity_mj.studies.parameter_values import Scaled, encoded
from tensegrity_mj.studies.parameters import Draft

Array = NDArray[np.float64]
G = 9.81
SMOOTH = Contact(floor=0.0, friction=0.0)


def falling_rod(angle: float, mass: float = 0.7, **scene: Any) -> tmj.Scene:
    """A rod of 0.6 m in the xz plane, at an angle [rad] from the vertical, its lower end 0.1 m above the floor."""
    structure = tmj.Structure(
        "rod",
        nodes={"a": (0, 0, 0.12), "b": (0.6 * np.sin(angle), 0, 0.12 + 0.6 * np.cos(angle))},
        rods=(tmj.Rod("rod", ("a", "b"), mass, 0.02, tmj.Support.free(0.5, plane=(0, 1, 0))),),
        strings=(),
    )
    return tmj.Scene(structure, gravity=(0, 0, -G), contact=SMOOTH, **scene)


def integrated_rod(scene: tmj.Scene, duration: float) -> Array:
    """Height of the middle and angle of that rod at the end, from the law and Newton's equations: no MuJoCo."""
    rod, contact = scene.structure.rods[0], scene.contact
    assert contact is not None
    half, inertia = 0.3, rod.mass * 0.6**2 / 12
    a, b = scene.nodes0

    def rates(_: float, y: Array) -> Array:
        z, angle, z_rate, turn = y
        # Of the lower end: its gap z - half cos(angle) - radius, and that gap's derivative by the coordinates.
        lever = half * np.sin(angle)
        gap, rate = z - half * np.cos(angle) - rod.radius, z_rate + lever * turn
        mobility = 1 / rod.mass + lever**2 / inertia
        force = (acceleration(contact, gap, rate, -G) + G) / mobility
        return np.array([z_rate, turn, force / rod.mass - G, force * lever / inertia])

    start = np.array([(a[2] + b[2]) / 2, np.arctan2(b[0] - a[0], b[2] - a[2]), 0.0, 0.0])
    solution = solve_ivp(rates, (0, duration), start, rtol=1e-10, atol=1e-12, max_step=1e-4)
    return np.asarray(solution.y[:2, -1])


def test_the_law_of_a_single_contact_is_the_documented_one() -> None:
    """A rod that lands upright feels its mass; a tilted one that of its end. Both bounce off and fall again.

    RK4 steps over the touch, where the damper makes the acceleration jump by d₀ b v = 0.01 · 421 /s · 1.4 m/s = 6 m/s².
    A step of h = 1e-5 s over it errs by up to 6e-5 m/s, and in the 0.1 s that follow by 6e-6 m (measured: 5e-7).
    """
    for angle in (0.0, 0.5):
        for damping in (400.0, 100.0):
            scene = falling_rod(angle).with_(contact=replace(SMOOTH, damping=damping))
            run = tmj.simulate(scene, None, tmj.MuJoCo(1e-5), duration=0.25)
            a, b = run.nodes[-1]
            found = np.array([(a[2] + b[2]) / 2, np.arctan2(b[0] - a[0], b[2] - a[2])])
            np.testing.assert_allclose(found, integrated_rod(scene, 0.25), rtol=0, atol=6e-6)
            assert max(run.reports["contact"]["touching"]) == 1


def test_before_the_first_touch_a_run_is_the_free_flight_of_the_dae() -> None:
    """Turning at 9 rad/s, so that the strings vibrate. RK4 at 0.25 ms: below 1e-9 m, as without contact."""
    scene = tmj.load_scene("prism_drop")
    spin = np.cross([3.0, 6.0, -6.0], scene.nodes0 - scene.nodes0.mean(axis=0))
    scene = scene.with_(initial_velocities=spin)
    run = tmj.simulate(scene, None, tmj.MuJoCo(2.5e-4), duration=0.2)
    free = tmj.simulate(scene.with_(contact=None), None, tmj.DAE(rtol=1e-12, atol=1e-13), duration=0.2)
    assert max(run.reports["contact"]["touching"]) == 0
    assert np.ptp(run.tensions, axis=0).max() > 0.1
    assert tmj.compare(run, free).max_node_error < 1e-9
    np.testing.assert_allclose(run.multipliers, free.multipliers, rtol=0, atol=1e-6 * np.abs(free.multipliers).max())


def settled(friction: float = 0.6) -> tmj.Trajectory:
    scene = tmj.load_scene("prism_drop")
    assert scene.contact is not None
    return tmj.simulate(
        scene.with_(contact=replace(scene.contact, friction=friction)), None, tmj.MuJoCo(1e-3), duration=12.0
    )


def test_at_rest_the_floor_carries_the_weight_and_every_node_is_in_balance() -> None:
    run = settled()
    structure = run.scene.structure
    weight = 0.6 * G
    assert run.kinetic_energy[-1] < 1e-8  # it creeps: friction is soft (see docs/contact.md)
    contact = run.reports["contact"]
    assert contact["touching"][-1] == 3
    assert set(contact["final_forces"]) == {"a1", "a2", "a3"}
    forces = np.zeros((6, 3))
    for name, force in contact["final_forces"].items():
        forces[structure.node_index[name]] = force
    # What is left of the settling accelerates by some 1e-6 m/s².
    np.testing.assert_allclose(forces.sum(axis=0), [0, 0, weight], rtol=0, atol=1e-6 * weight)
    # Each node: strings, half its rod's weight, the rod's force, the floor. λ thus knows the contact.
    total = forces + rods.string_forces(structure, run.nodes[-1], run.tensions[-1])
    total += rods.lumped_masses(structure)[:, None] * np.array(run.scene.gravity)
    for (i, j), density in zip(structure.rod_nodes, run.rod_force_densities[-1], strict=True):
        pull = density * (run.nodes[-1, j] - run.nodes[-1, i])
        total[i] += pull
        total[j] -= pull
    assert np.abs(total).max() < 1e-5 * run.tensions[-1].max()
    assert np.abs(forces[:, 2]).max() > 1e-2 * run.tensions[-1].max()  # without them it would not balance


def test_sliding_and_sticking_on_a_slope() -> None:
    """A rod that lies along the slope slides by Coulomb's law, or creeps as the softness of the friction has it."""
    structure = tmj.Structure(
        "log", nodes={"a": (0, 0, 0.0), "b": (0.8, 0, 0.0)}, rods=(tmj.Rod("log", ("a", "b"), 2.0, 0.03),), strings=()
    )
    contact = Contact(floor=-0.03, friction=0.5)
    for degrees in (20.0, 35.0):
        tilt = np.radians(degrees)
        gravity = (G * np.sin(tilt), 0.0, -G * np.cos(tilt))
        scene = tmj.Scene(structure, gravity=gravity, contact=contact, duration=1.0)
        run = tmj.simulate(scene, None, tmj.MuJoCo(5e-4))
        speed = run.velocities[:, 0, 0]
        late = run.time >= 0.5
        if degrees > 30:  # arctan 0.5 is 26.6 degrees
            # Coulomb's law with the normal force that acts: as it slides faster it rises by parts of its depth.
            slope, rise = (np.polyfit(run.time[late], run.velocities[late].mean(axis=1)[:, k], 1)[0] for k in (0, 2))
            assert slope == pytest.approx(G * np.sin(tilt) - 0.5 * (G * np.cos(tilt) + rise), rel=1e-8)
            assert abs(rise) < 1e-3
            continue
        # Both ends creep at one speed v: each carries b v / R, R = (1 - d) / d A / FRICTION_IMPEDANCE by its own depth,
        # with A = 1/m + (ℓ/2)²/(m ℓ²/12) what a rod's end yields across the rod.
        depths = 0.0 - run.nodes[-1, :, 2]
        d = np.array([impedance(contact, depth) for depth in depths])
        softness = (1 - d) / d * (4 / 2.0) / FRICTION_IMPEDANCE
        creep = 2.0 * G * np.sin(tilt) / np.sum(contact.spring.damping / contact.spring.impedance[1] / softness)
        np.testing.assert_allclose(speed[late], creep, rtol=1e-5)
        assert 0 < creep < 2e-4


def test_rods_that_meet_keep_their_momentum_and_obey_the_law() -> None:
    """Two crossed rods meet at their middles: a contact between their centres, so that the law is one-dimensional."""
    structure = tmj.Structure(
        "cross",
        nodes={"a": (-0.5, 0, 0.05), "b": (0.5, 0, 0.05), "c": (0, -0.4, -0.05), "d": (0, 0.4, -0.05)},
        rods=(tmj.Rod("r1", ("a", "b"), 1.0, 0.02), tmj.Rod("r2", ("c", "d"), 3.0, 0.01)),
        strings=(),
    )
    contact = Contact(rods=True, damping=100.0)
    speeds = np.array([[0, 0, -1.0], [0, 0, -1.0], [0, 0, 0.5], [0, 0, 0.5]])
    scene = tmj.Scene(structure, contact=contact, initial_velocities=speeds, duration=0.1)
    run = tmj.simulate(scene, None, tmj.MuJoCo(1e-5))
    momentum = linear_momentum(structure, run.velocities)
    np.testing.assert_allclose(momentum, np.tile(momentum[0], (len(momentum), 1)), rtol=0, atol=1e-13)

    def rates(_: float, y: Array) -> Array:
        return np.array([y[1], acceleration(contact, y[0], y[1], 0.0)])

    apart = solve_ivp(rates, (0, 0.1), [0.1 - 0.03, -1.5], rtol=1e-10, atol=1e-12, max_step=1e-4).y[:, -1]
    assert apart[1] > 0.1  # they bounced
    assert run.nodes[-1, 0, 2] - run.nodes[-1, 2, 2] - 0.03 == pytest.approx(apart[0], abs=2e-7)
    assert run.velocities[-1, 0, 2] - run.velocities[-1, 2, 2] == pytest.approx(apart[1], abs=1e-4)
    # They touch from 0.07 m / (1.5 m/s) = 0.047 s on: then each pushes the other, at its middle.
    early = tmj.simulate(scene, None, tmj.MuJoCo(1e-4), duration=0.05).reports["contact"]["final_forces"]
    pushes = np.array([early[name] for name in "abcd"])
    assert pushes[0, 2] > 1
    np.testing.assert_allclose(pushes, pushes[0, 2] * np.outer([1, 1, -1, -1], [0, 0, 1]), rtol=0, atol=1e-9)
    through = tmj.simulate(scene.with_(contact=Contact(floor=-9.0)), None, tmj.MuJoCo(1e-3))
    assert max(through.reports["contact"]["touching"]) == 0
    assert through.nodes[-1, 0, 2] < through.nodes[-1, 2, 2]


def test_contact_works_only_while_it_touches() -> None:
    scene = tmj.load_scene("prism_drop")
    run = tmj.simulate(scene, None, tmj.MuJoCo(2.5e-4), duration=0.5, output_interval=0.01)
    assert -run.external_work.min() > 0.5  # J, of 1.8 J of weight falling 0.3 m
    assert np.abs(run.external_work[:25]).max() < 1e-20  # nothing before it touches, up to round-off of spins
    assert not any("energy" in text for text in run.reports["warnings"])


@pytest.mark.parametrize("integrator", list(tmj.Integrator))
def test_the_work_of_contact_is_counted_with_every_integrator(integrator: tmj.Integrator) -> None:
    """A rod alone, so that contact is all that works besides gravity.

    One stage: h F (v + v')/2 is the change of kinetic energy exactly, where the mass matrix is constant, as it is for
    a rod that lands upright. RK4's quadrature errs at the kinks of touch and lift-off.
    """
    scene = falling_rod(0.0)
    run = tmj.simulate(scene, None, tmj.MuJoCo(1e-4, integrator), duration=0.5)
    lost = -run.external_work[-1]
    assert lost > 0.5
    # Gravity's potential at the ends of a semi-implicit step differs from its work by m g² h²/2 a step.
    bound = 1e-4 * lost if integrator is tmj.Integrator.RK4 else 0.7 * G**2 * 1e-4 * 0.5 + 1e-9
    assert run.energy_residual < bound


@pytest.mark.parametrize("integrator", [tmj.Integrator.RK4, tmj.Integrator.EULER, tmj.Integrator.DISCRETE])
def test_multipliers_know_the_forces_of_contact(integrator: tmj.Integrator) -> None:
    """λ of a tilted rod that slides as it lands, against the floor's force from the motion that was recorded.

    The force is F = m (r̈ - g), with r̈ by central differences over 2h = 4e-6 s of a contact that grows hard over its
    width of 0.5 mm, at a rate of up to 2 · 1.4 m/s / width = 6e3 /s: they err by (6e3 h)²/6, and one-stage integrators
    by the half step between force and speed, 6e3 h: 0.012.
    """
    scene, h = falling_rod(0.4).with_(contact=replace(SMOOTH, friction=0.3)), 2e-6
    scene = scene.with_(initial_nodes=scene.nodes0 - [0, 0, 0.099], initial_velocities=[[0, 0, -1.4]] * 2)
    run = tmj.simulate(scene, None, tmj.MuJoCo(h, integrator), duration=0.01, output_interval=h)
    inner = np.flatnonzero(np.array(run.reports["contact"]["touching"]) > 0)[4:-4]
    assert len(inner) > 100
    b, rate = ((values[:, 1] - values[:, 0]) / 0.6 for values in (run.nodes, run.velocities))
    force = 0.7 * (np.gradient(run.velocities.mean(axis=1), run.time, axis=0) - np.array(scene.gravity))
    # (2.36) with σ = 1/2, f = 0 and the force on the first node, of the rod with J = m ℓ²/12.
    expected = np.sum(rate**2, axis=1) - 0.3 * np.sum(b * force, axis=1) / (0.7 * 0.6**2 / 12)
    scale = np.abs(expected[inner]).max()
    assert scale > 100
    np.testing.assert_allclose(run.multipliers[inner, 0], expected[inner], rtol=0, atol=0.02 * scale)


def test_the_report_is_of_the_recorded_states() -> None:
    """Touches, depth and force follow from each row's own gap and rate, by the law: one contact, of all the mass.

    MuJoCo's solver stops at 1e-15 of its cost, of forces of 100 N at most.
    """
    scene, contact = falling_rod(0.0), SMOOTH
    run = tmj.simulate(scene, None, tmj.MuJoCo(1e-3), duration=0.25)
    gaps, rates = run.nodes[:, 0, 2] - 0.02, run.velocities[:, 0, 2]
    forces = [0.7 * (acceleration(contact, gap, rate, -G) + G) for gap, rate in zip(gaps, rates, strict=True)]
    reported = run.reports["contact"]
    assert reported["touching"] == (gaps < 0).astype(int).tolist()
    assert reported["deepest"] == pytest.approx(-gaps.min(), rel=1e-12)
    assert reported["largest_normal_force"] == pytest.approx(max(forces), rel=1e-9)
    assert 10 < max(forces) < 500
    assert forces[-1] == 0 or reported["final_forces"]["a"][2] == pytest.approx(forces[-1], rel=1e-9)
    free = tmj.simulate(scene, None, tmj.MuJoCo(1e-3), duration=0.1).reports["contact"]
    assert (free["deepest"], free["largest_normal_force"], free["final_forces"]) == (0, 0, {})


def test_touches_only_what_the_scene_requires() -> None:
    scene = tmj.load_scene("prism_drop")
    model = mujoco.MjModel.from_xml_string(scene_to_mjcf(scene))
    touch = [
        (i, j)
        for i in range(model.ngeom)
        for j in range(i + 1, model.ngeom)
        if model.geom_contype[i] & model.geom_conaffinity[j] or model.geom_contype[j] & model.geom_conaffinity[i]
    ]
    assert touch == [(0, 1), (0, 2), (0, 3)]  # the floor and each rod
    both = mujoco.MjModel.from_xml_string(scene_to_mjcf(scene.with_(contact=Contact(floor=0.0, rods=True))))
    assert np.all(both.geom_contype[1:] & both.geom_conaffinity[1:])
    free = mujoco.MjModel.from_xml_string(scene_to_mjcf(scene.with_(contact=None)))
    assert free.ngeom == 3
    assert free.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CONTACT
    assert not free.opt.enableflags


def test_a_point_mass_lands_on_its_point() -> None:
    structure = tmj.Structure(
        "ball", nodes={"p": (0, 0, 0.2), "q": (0, 0, 1.0)}, rods=(), fixed_nodes=("q",),
        strings=(tmj.String("s", ("p", "q"), 1.0, rest_length=2.0),), point_masses=(tmj.PointMass("p", 0.5),),
    )  # fmt: skip
    scene = tmj.Scene(structure, gravity=(0, 0, -G), contact=Contact(floor=0.1, normal=(0, 0, 2.0)), duration=1.0)
    run = tmj.simulate(scene)
    np.testing.assert_allclose(run.reports["contact"]["final_forces"]["p"], [0, 0, 0.5 * G], atol=1e-6)
    assert 0.1 - 2e-3 < run.nodes[-1, 0, 2] < 0.1


def test_engines_without_contact_say_so() -> None:
    scene = tmj.load_scene("prism_drop")
    with pytest.raises(tmj.errors.OptionError, match=r"has contact.*use MuJoCo or DAE, or .*with_\(contact=None\)"):
        tmj.simulate(scene, None, tmj.ODE(), duration=0.1)


def test_linear_models_are_those_without_touch() -> None:
    scene = tmj.load_scene("prism_drop")
    with_floor, without = tmj.linearize(scene), tmj.linearize(scene.with_(contact=None))
    np.testing.assert_array_equal(with_floor.A, without.A)
    low = scene.nodes0 - [0, 0, 0.405]
    with pytest.raises(tmj.errors.OptionError, match=r"inside the floor.*no linear model"):
        tmj.linearize(scene, nodes=low)


def test_a_start_inside_something_is_refused() -> None:
    scene = tmj.load_scene("prism_drop")
    with pytest.raises(
        tmj.errors.SceneError, match=r"rod 'rod3' at node 'a3' is 0.01 m inside the floor: start higher"
    ):
        scene.with_(contact=Contact(floor=0.31))
    with pytest.raises(tmj.errors.SceneError, match=r"\(and 5 more\): start higher"):
        scene.with_(contact=Contact(floor=9.0))
    with pytest.raises(tmj.errors.SceneError, match=r"rods 'rod1' and 'rod2' overlap by 0.01 m.*thinner"):
        tmj.Scene(_crossed(), contact=Contact(rods=True))


def _crossed() -> tmj.Structure:
    nodes = {"a": (0, 0, 0), "b": (1, 0, 0), "c": (0.5, -0.5, 0.01), "d": (0.5, 0.5, 0.01)}
    members = (tmj.Rod("rod1", ("a", "b"), 1.0), tmj.Rod("rod2", ("c", "d"), 1.0))
    return tmj.Structure("crossed", nodes=nodes, rods=members, strings=())


@pytest.mark.parametrize(
    ("contact", "message"),
    [
        (lambda: "soft", "use Contact"),
        (lambda: Contact(), "neither a floor nor contact between rods"),
        (lambda: Contact(floor=float("nan")), "floor = nan"),
        (lambda: Contact(floor=0.0, normal=(0, 0, 0)), "normal"),
        (lambda: Contact(floor=0.0, friction=-1), "friction = -1"),
        (lambda: Contact(floor=0.0, stiffness=0), "stiffness = 0"),
        (lambda: Contact(floor=0.0, damping=-1.0), "damping = -1"),
        (lambda: Contact(floor=0.0, rods=1), "rods = 1"),  # type: ignore[arg-type]
        (lambda: Contact(floor=0.0, impedance=(0.9, 0.95)), "five numbers"),  # type: ignore[arg-type]
        (lambda: Contact(floor=0.0, impedance=(0.9, 1.0, 1e-3, 0.5, 2)), "d1 = 1.0"),
        (lambda: Contact(floor=0.0, impedance=(0.9, 0.95, 0.0, 0.5, 2)), "width = 0.0"),
        (lambda: Contact(floor=0.0, friction=1e-6), r"friction = 1e-06; it must be 0, or within \[1e-5, 1e5\]"),
        (lambda: Contact(floor=0.0, friction=1e300), r"friction = 1e\+300"),
        (lambda: Contact(floor=0.0, stiffness=1e300), r"stiffness = 1e\+300; it must be > 0 and at most 1e12 \[1/s²\]"),
        (lambda: Contact(floor=0.0, damping=1e300), r"damping = 1e\+300; it must be within \[0, 1e7\]"),
        (
            lambda: Contact(floor=0.0, impedance=(0.95, 0.9, 2e-3, 0.5, 2)),
            "d1 = 0.9 at .* is below d0 = 0.95 .*least d0",
        ),
        (lambda: Contact(floor=0.0, impedance=(0.9, 0.95, 1e-12, 0.5, 2)), "width = 1e-12; it must be at least 1e-9 m"),
        (lambda: Contact(floor=0.0, impedance=(0.9, 0.95, 1e-3, 1e-5, 2)), "midpoint = 1e-05"),
        (
            lambda: Contact(floor=0.0, impedance=(0.9, 0.95, 1e-3, 0.5, 1e3)),
            r"power = 1000.0; it must be within \[1",
        ),
    ],
)
def test_what_is_no_contact_is_refused(contact: Callable[[], Any], message: str) -> None:
    with pytest.raises(tmj.errors.SceneError, match=message):
        tmj.load_scene("prism_drop").with_(contact=contact())


@pytest.mark.parametrize(
    "values",
    [
        (1e-4, 0.9999, 1e-9, 1e-4, 50.0),
        (0.9999, 0.9999, 1e3, 0.9999, 50.0),
        (1e-4, 1e-4, 2e-3, 0.5, 1.0),
        (0.01, 0.95, 2e-3, 1e-4, 2.0),
        (0.01, 0.95, 2e-3, 0.9999, 2.0),
    ],
)
def test_mujoco_takes_all_that_is_allowed_as_it_is(values: tuple[float, float, float, float, float]) -> None:
    """d, K and B of MuJoCo's constraint row at the ends of the ranges are those of the documented law.

    Powers of up to 50 of x near 1 multiply its round-off by 50.
    """
    contact = Contact(floor=0.0, friction=1e5, stiffness=1e12, damping=1e7, impedance=values)
    scene = falling_rod(0.0).with_(contact=contact)
    model = mujoco.MjModel.from_xml_string(scene_to_mjcf(scene))
    data = mujoco.MjData(model)
    for part in (0.3, 0.7, 1.5):
        depth = min(part * values[2], 0.05)
        data.qpos[1] = -0.1 - depth  # the second joint slides upwards
        mujoco.mj_forward(model, data)
        assert data.ncon == 1
        gap = data.contact[0].dist
        d, d1 = impedance(contact, -gap), values[1]
        k, b, found = data.efc_KBIP[data.contact[0].efc_address][:3]
        assert found == pytest.approx(d, rel=1e-12)
        assert k == pytest.approx(contact.stiffness / d1**2, rel=1e-12)
        assert b == pytest.approx(contact.spring.damping / d1, rel=1e-12)
        assert data.contact[0].friction[0] == 1e5
        assert np.all(np.isfinite(data.qacc))


def test_files_hold_contact_without_loss() -> None:
    scene = tmj.load_scene("prism_drop")
    odd = Contact(-0.1, (0.1, 0.0, 2.0), True, 0.25, 1e5, 321.5, (0.3, 0.9, 1e-3, 0.4, 3.0), spin="free")
    for contact in (scene.contact, odd, Contact(rods=True), None):
        other = scene.with_(contact=contact)
        assert scene_from_toml(scene_to_toml(other)) == other
        assert (other == scene) is (contact == scene.contact)
    text = scene_to_toml(scene)
    for old, new, message in (
        ("floor = 0.0", "flor = 0.0", r"unknown key 'flor' \(did you mean 'floor'"),
        ("floor = 0.0", 'floor = "low"', "floor = 'low'.*number"),
        ("floor = 0.0", "floor = 0.0, rods = 1", "rods = 1.*true or false"),
        ("floor = 0.0", "floor = 0.0, impedance = [0.9]", "impedance.*five numbers"),
    ):
        assert old in text
        with pytest.raises(tmj.errors.FormatError, match=message):
            scene_from_toml(text.replace(old, new))


def test_sweeps_reach_the_parameters_of_contact() -> None:
    settings = {"scene.contact.friction": 0.1, "scene.contact.stiffness": encoded(Scaled(2.0))}
    draft = Draft(tmj.load_scene("prism_drop")).apply(settings)
    assert draft.scene.contact == Contact(floor=0.0, friction=0.1, stiffness=3.2e5)
    for scene, path, message in (
        ("prism", "scene.contact.friction", "no contact"),
        ("prism_drop", "scene.contact.fiction", "fiction"),
        ("prism_drop", "scene.contact", "part of contact"),
    ):
        with pytest.raises(tmj.errors.OptionError, match=message):
            Draft(tmj.load_scene(scene)).apply({path: 0.1})


def test_pictures_show_the_floor() -> None:
    """A plate in shades of grey, the shadow's among them, over a part of the picture."""
    scene = tmj.load_scene("prism_drop")
    tilted = replace(scene.contact, normal=(0.2, 0.0, 1.0))
    areas = {}
    for name, contact in (("level", scene.contact), ("tilted", tilted), ("none", None)):
        source = scene.with_(contact=contact)
        image = np.asarray(
            tmj.pictures.render_frame(source, size=(320, 240), text=False, quality=tmj.pictures.Quality.FAST)
        )
        bright = image.mean(axis=-1)  # rods are darker, the background is brighter
        areas[name] = np.sum((np.ptp(image, axis=-1) <= 16) & (bright > 130) & (bright < 235))
    assert min(areas["level"], areas["tilted"]) > 2 * areas["none"]  # without a floor: the lines of the grid


def test_distances_of_segments() -> None:
    """Against a fine grid over both segments, whose own error is half a cell of each segment's length."""
    rng = np.random.default_rng(5)
    a, b, c, d = rng.normal(size=(4, 60, 3))
    aside = np.array([0.1, 0, 0])
    c[:10], d[:10] = a[:10] + aside, b[:10] + aside  # parallel
    found = segment_distances(a, b, c, d)
    s = np.linspace(0, 1, 401)
    for row in range(60):
        p = a[row] + s[:, None] * (b[row] - a[row])
        q = c[row] + s[:, None] * (d[row] - c[row])
        least = np.sqrt(((p[:, None] - q) ** 2).sum(axis=-1)).min()
        cell = (np.linalg.norm(b[row] - a[row]) + np.linalg.norm(d[row] - c[row])) / 800
        assert least - cell <= found[row] <= least + 1e-12


def test_overlaps_are_reported_in_words() -> None:
    found = overlaps(_crossed(), Contact(floor=0.0, rods=True), np.array(list(_crossed().nodes.values()), float))
    assert found[0] == "rod 'rod1' at node 'a' is 0.01 m inside the floor"
    assert found[-1] == "rods 'rod1' and 'rod2' overlap by 0.01 m"


def test_the_floor_is_where_the_scene_has_it() -> None:
    """A plane of the MJCF through floor · n with the normal n, and forces along n: a point mass shows it."""
    normal = np.array([1.0, -2.0, 4.0]) / np.sqrt(21.0)
    contact = Contact(floor=-0.7, normal=(1.0, -2.0, 4.0))
    structure = tmj.Structure(
        "pair", nodes={"p": (0, 0, 0), "q": (0, 0, 9.0)}, rods=(), fixed_nodes=("q",),
        strings=(tmj.String("s", ("p", "q"), 1.0, rest_length=20.0),), point_masses=(tmj.PointMass("p", 0.5),),
    )  # fmt: skip
    scene = tmj.Scene(structure, gravity=tuple(-G * normal), contact=contact)
    model = mujoco.MjModel.from_xml_string(scene_to_mjcf(scene))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    place, axes = data.geom("floor").xpos, data.geom("floor").xmat.reshape(3, 3)
    np.testing.assert_allclose(axes[:, 2], normal, rtol=0, atol=1e-15)
    assert place @ normal == pytest.approx(-0.7, abs=1e-15)
    run = tmj.simulate(scene, None, tmj.MuJoCo(1e-3), duration=1.5)
    # It falls 0.7 m along the normal, and rests with the weight on it, at a depth of parts of a millimetre.
    assert run.nodes[-1, 0] @ normal == pytest.approx(-0.7, abs=1e-3)
    np.testing.assert_allclose(run.reports["contact"]["final_forces"]["p"], 0.5 * G * normal, rtol=0, atol=1e-6)


def test_a_start_may_rest_on_a_floor_and_no_deeper_than_twice_as_deep() -> None:
    """A ball of mass m under a load of nine times its weight presses with A = 10 g: (1 - d) A = d k r at rest.

    With d₀ = d₁ = d that is r = (1 - d) A d₁² / (d² stiffness) = (1 - d) A / stiffness, of which twice is allowed.
    """
    depth = 2 * (1 - 0.9) * 10 * 9.81 / 1e4
    contact = tmj.model.Contact(floor=0.0, stiffness=1e4, impedance=(0.9, 0.9, 1e-3, 0.5, 2))
    structure = tmj.Structure("ball", {"p": (0.0, 0.0, 0.0)}, point_masses=[tmj.PointMass("p", 2.0)])
    load = tmj.model.Load("p", (0.0, 0.0, -9 * 2.0 * 9.81))

    def start(z: float) -> tmj.Scene:
        scene = tmj.Scene(structure, gravity=(0, 0, -9.81), loads=(load,))
        return scene.with_(initial_nodes=[[0.0, 0.0, z]], contact=contact)

    start(-0.999 * depth)
    with pytest.raises(tmj.errors.SceneError, match=rf"inside the floor: start higher.*; {depth:.3g} m are allowed"):
        start(-1.001 * depth)


def test_a_run_begins_where_a_landing_came_to_rest() -> None:
    """It was refused at 1.06 mm: the weight of the prism on three feet; on one, 2 x 1.32 mm are allowed."""
    scene = tmj.load_scene("prism_drop")
    run = tmj.simulate(scene, None, tmj.MuJoCo(5e-4), duration=1.5)
    again = tmj.simulate(scene.with_(initial_nodes=run.nodes[-1]), None, tmj.MuJoCo(5e-4), duration=0.05)
    assert again.status is tmj.Status.COMPLETED
