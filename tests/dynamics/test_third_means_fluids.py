"""Viscous forces, drag, bending, waves, buoyancy and added mass against formulas by hand, in both engines.

MuJoCo and the DAE call the same compiled functions for these, so that their agreement says nothing of them. What is
expected here is written in NumPy from its physics and calls nothing of the package. The table in
docs/developing/third-means.md lists which function is checked where.

Tolerances of motions: the DAE's error control, 1e-12 of a step, grows to 1e-10 over the run; RK4 at h = 1 ms errs by
(r h)⁴ r T / 120 of the motion with rates r <= 15 /s and T <= 2 s: 1e-8 of it at the most. 2e-8 of motions of 0.1 to
3 m is both with a margin, and 1e4 times less than what a hundredth of a coefficient does. Forces are single
evaluations, to round-off.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad

import tensegrity_mj as tmj
from tensegrity_mj.dynamics.native.elements import let_act
from tensegrity_mj.dynamics.native.law import native_law
from tensegrity_mj.dynamics.native.plant import Plant
from tensegrity_mj.engines.request import request_for
from tensegrity_mj.model.actuation import Actuation, OnInfeasible

G, RHO, L, R = 9.81, 1025.0, 1.22, 0.05
D = 2 * R
DISPLACED = RHO * np.pi * R**2 * L  # kg of water in place of the rod: 9.82
CLOSE = 2e-8
FINE = [tmj.DAE(rtol=1e-12, atol=1e-13), tmj.MuJoCo(1e-3)]
pytestmark = pytest.mark.third_means(
    "plant.write_row", "vectors.*", "pointers.*", "elements.clear", by="rows and parts of its formulas"
)
both = pytest.mark.parametrize("engine", FINE, ids=["DAE", "MuJoCo"])


def one(b=(1.0, 0.0, 0.0), center=(0.0, 0.0, 0.0), mass=3.0, velocities=None, gravity=G, support=None, **scene):
    """One rod of 1.22 m along b; velocities [m/s] of both ends, or of each."""
    b = np.array(b, float) / np.linalg.norm(b)
    ends = [tuple((np.array(center) + side * 0.5 * L * b).tolist()) for side in (-1, 1)]
    rod = tmj.Rod("rod", ("a", "b"), mass, R, support or tmj.Support.free())
    if velocities is not None:
        scene["initial_velocities"] = np.broadcast_to(velocities, (2, 3))
    structure = tmj.Structure("one", {"a": ends[0], "b": ends[1]}, (rod,))
    return tmj.Scene(structure, gravity=(0.0, 0.0, -gravity), **({"duration": 2.0} | scene))


def forces_on(scene, time=0.0):
    """(2, 3) [N] that the engines' compiled code puts on the nodes, but for what answers accelerations."""
    plant = Plant(scene, native_law(None, scene.structure), Actuation.continuous(), OnInfeasible.STOP)
    let_act(plant.address, time)
    return plant["forces"].copy()


def added_mass_of(scene):
    """α (2, 2) [kg] of the rod."""
    plant = Plant(scene, native_law(None, scene.structure), Actuation.continuous(), OnInfeasible.STOP)
    let_act(plant.address, 0.0)
    return plant.elements.added.reshape(2, 2).copy()


def first_accelerations(scene, engine):
    request = request_for(scene, None, None, None, OnInfeasible.STOP, None, False)
    return engine.accelerations(request)(0.0, scene.nodes0, scene.velocities0)[1]


# Resistance


@pytest.mark.third_means(
    "resistance.add_fluid",
    "elements.let_act of wind",
    "elements.held_powers of wind",
    by="e^{-cℓt/m}; work of the wind less what moves",
)
@both
def test_viscous_forces_and_wind_bring_a_rod_to_the_winds_speed_and_stop_its_spin(engine) -> None:
    # c per length and velocity: m v̇ = c ℓ (w - v), and the same rate for a spin, as mass and drag are spread alike.
    c, m, spin, wind = 1.1, 3.0, 2.0, np.array([0.6, -0.4, 0.3])
    ends = np.array([[0, -0.5, 0], [0, 0.5, 0]]) * spin * L
    scene = one(velocities=ends, gravity=0.0, resistance=tmj.Resistance(viscous=c, wind=tuple(wind)))
    run = tmj.simulate(scene, engine=engine)
    t, rate = run.time[:, None], c * L / m
    blown = wind * (t - (1 - np.exp(-rate * t)) / rate)
    angle = spin * (1 - np.exp(-rate * t)) / rate
    b = np.hstack([np.cos(angle), np.sin(angle), 0 * angle])
    for node, side in ((0, -0.5), (1, 0.5)):
        assert np.abs(run.nodes[:, node] - blown - side * L * b).max() < CLOSE
    v = wind * (1 - np.exp(-rate * t))
    # The wind gives F w = m v̇ w; what is not in the motion is lost.
    kinetic = 0.5 * m * np.sum(v * v, axis=1) + 0.5 * m * L**2 / 12 * (spin * np.exp(-rate * run.time)) ** 2
    assert np.abs(run.external_work - m * v @ wind).max() < CLOSE
    assert np.abs(run.dissipation - (m * v @ wind - kinetic + kinetic[0])).max() < CLOSE


@pytest.mark.third_means("resistance._normal_drag", by="v_t tanh(g t/v_t)")
@both
@pytest.mark.parametrize(("b", "C"), [((0, 1, 0), 1.3), ((0, 0, 1), 0.4 * np.pi)], ids=["level", "upright"])
def test_a_falling_rod_comes_to_its_terminal_velocity(engine, b, C) -> None:
    # m v̇ = m g - ½ ρ C d ℓ v²: v = v_t tanh(g t / v_t), v_t² = 2 m g / (ρ C d ℓ); C_t acts on the circumference π d.
    m = 0.3
    drag = tmj.model.Drag(1.3, 0.4, 20.0)
    run = tmj.simulate(one(b, mass=m, resistance=tmj.Resistance(drag=drag)), engine=engine)
    v_t = np.sqrt(2 * m * G / (20.0 * C * D * L))
    fallen = v_t**2 / G * np.log(np.cosh(G * run.time / v_t))
    assert np.abs(run.nodes[:, :, 2] - run.nodes[0, :, 2] + fallen[:, None]).max() < CLOSE
    assert run.velocities[-1, 0, 2] == pytest.approx(-v_t, rel=1e-3)
    kinetic = 0.5 * m * (v_t * np.tanh(G * run.time / v_t)) ** 2
    assert np.abs(run.dissipation - (m * G * fallen - kinetic)).max() < 10 * CLOSE


@pytest.mark.third_means("resistance._normal_drag", by="ω₀/(1 + K ω₀ t)")
@both
def test_drag_slows_a_spin_as_one_over_time(engine) -> None:
    # (m ℓ²/12) ω̇ = -∫ ½ ρ C d |ω x| ω x x dx = -ρ C d ω² ℓ⁴/64: ω = ω₀ / (1 + K ω₀ t).
    m, spin = 0.5, 3.0
    ends = np.array([[0, -0.5, 0], [0, 0.5, 0]]) * spin * L
    scene = one(mass=m, velocities=ends, gravity=0.0, resistance=tmj.Resistance(drag=tmj.model.Drag(1.2, 0.0, 30.0)))
    run = tmj.simulate(scene, engine=engine)
    slows = 12 * 30.0 * 1.2 * D * L**2 / (64 * m) * spin
    angle = spin / slows * np.log1p(slows * run.time)
    assert np.abs(run.nodes[:, 1] - 0.5 * L * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)).max() < CLOSE
    assert angle[-1] > 0.7


@pytest.mark.third_means("resistance.add_bending", by="ω² = 24 κ/(m ℓ²) of two free rods, and its damping")
@both
def test_a_bent_joint_swings_with_the_frequency_of_its_stiffness(engine) -> None:
    # Two free rods of ℓ and m in a V of a small angle θ each: their centres stay on a line, T = 2 · m ℓ² θ̇²/24. With
    # 2 θ between them, V = ½ κ (2θ)² and γ (2θ̇)² is lost a second: θ̈ + 24 γ/(m ℓ²) θ̇ + 24 κ/(m ℓ²) θ = 0.
    length, m, kappa, gamma, theta = 0.4, 0.7, 0.5, 0.004, 1e-3
    lift, reach = 0.5 * length * np.sin(theta), length * np.cos(theta)
    nodes = {"a": (-reach, 0.0, lift), "o": (0.0, 0.0, -lift), "b": (reach, 0.0, lift)}
    rods = (tmj.Rod("p", ("a", "o"), m), tmj.Rod("q", ("o", "b"), m))
    scene = tmj.Scene(
        tmj.Structure("v", nodes, rods),
        resistance=tmj.Resistance(bending=tmj.model.Bending(kappa, gamma)),
        duration=2.0,
    )
    run = tmj.simulate(scene, engine=engine)
    delta = 12 * gamma / (m * length**2)
    omega = np.sqrt(24 * kappa / (m * length**2) - delta**2)
    swing = theta * np.exp(-delta * run.time) * (np.cos(omega * run.time) + delta / omega * np.sin(omega * run.time))
    # The frequency is off by some θ² of itself, over ω T = 21 rad: 2e-5 of θ; a hundredth of κ makes 0.1 of it.
    found = np.arcsin((run.nodes[:, 0, 2] - run.nodes[:, 1, 2]) / length)
    assert np.abs(found - swing).max() < 3e-5 * theta
    assert run.dissipation[-1] == pytest.approx(
        0.5 * kappa * 4 * theta**2 - run.bending_energy[-1] - run.kinetic_energy[-1], rel=1e-4
    )


# Waves


MORISON = [
    # A level rod along y at x = 2 m and z = -3 m, C_d = 1.1, C_M = 1.8, in a wave of A = 0.6 m, 20 m long, ε = 0.3 rad:
    # k = 0.314159 /m; the masses and areas make ½ ρ C_d d ℓ = 68.7775 kg/m and C_M ρ π d²/4 ℓ = 17.67853 kg.
    # Deep water: ω² = g k = 3.081902, e^{kz} = 0.3896611; ω A e^{kz} = 0.4104382 m/s and ω² A e^{kz} = 0.7205386 m/s²
    # in all directions in turn: drag is 11.58622 N along the velocity, inertia 12.73806 N a quarter turn ahead.
    # θ = 1.7555348 t + 0.3 - 0.6283185: F_x = 12.73806 cos θ + 11.58622 sin θ, F_z = -12.73806 sin θ + 11.58622 cos θ
    (None, 0.0, 8.321669, 15.074768),
    (None, 1.0, 13.289658, -10.949146),
    (None, 2.0, -13.204009, -11.052283),
    # 4 m deep: ω² = g k tanh 1.256637 = 2.620031; cosh k(z+h) / sinh kh = 0.6502094, sinh / sinh = 0.1978042. At t = 0,
    # θ = -0.3283185: v = (-0.2036210, 0.1818444) m/s, of 0.2730026, a = (0.9675124, 0.1002633) m/s².
    (4.0, 0.0, 13.281523, 5.186929),
    (4.0, 1.0, 30.423444, -3.054644),
    (4.0, 2.0, -15.211283, -4.313258),
]


@pytest.mark.third_means("water._flow", by="Morison's force at three instants, in numbers, deep and 4 m deep")
@pytest.mark.parametrize(("depth", "time", "F_x", "F_z"), MORISON)
def test_the_force_of_a_wave_on_a_held_rod_is_morisons(depth, time, F_x, F_z) -> None:
    # Buoyancy is ρ g π d²/4 ℓ = 96.347974 N more. Seven digits were written down.
    water = tmj.Water(
        RHO, depth, (tmj.model.Wave(0.6, 20.0, phase=0.3),), drag=1.1, added_mass=0.5, inertia=1.8, diameter=0.1
    )
    found = forces_on(one((0, 1, 0), (2.0, 0.0, -3.0), water=water), time)
    assert found.sum(axis=0) == pytest.approx([F_x, 0.0, F_z + 96.347974], abs=5e-6)
    assert np.abs(found[0] - found[1]).max() < 1e-12  # all along the rod alike


@pytest.mark.third_means("water._flow", by="sums of Morison's forces of each wave, across the rod")
def test_waves_and_current_add_up_and_only_what_is_across_a_rod_counts() -> None:
    # One segment: the loads of the centre. Two waves, by length and by frequency, of any direction; an inclined rod.
    rng = np.random.default_rng(2)
    for _ in range(20):
        A, chi, eps = rng.uniform(0.1, 0.5, 2), rng.uniform(0, 6, 2), rng.uniform(0, 6, 2)
        wavelength, omega2, t, current = 12.0, 2.2, rng.uniform(0, 9), rng.normal(size=3) * 0.3
        b, center, rates = rng.normal(size=3), np.array([1.0, -2.0, -2.5]), rng.normal(size=3)
        b /= np.linalg.norm(b)
        u, a = current - rates, np.zeros(3)
        for k, omega, i in ((2 * np.pi / 12, np.sqrt(G * 2 * np.pi / 12), 0), (omega2**2 / G, omega2, 1)):
            along = np.array([np.cos(chi[i]), np.sin(chi[i]), 0.0])
            theta = omega * t + eps[i] - k * (along @ center)
            size = omega * A[i] * np.exp(k * center[2])
            u = u + size * (along * np.sin(theta) + [0, 0, np.cos(theta)])
            a = a + omega * size * (along * np.cos(theta) - [0, 0, np.sin(theta)])
        P = np.eye(3) - np.outer(b, b)
        slip = b @ u
        expected = 1.7 * DISPLACED * P @ a + 0.5 * RHO * 1.1 * D * L * np.linalg.norm(P @ u) * P @ u
        expected += 0.5 * RHO * 0.2 * np.pi * D * L * abs(slip) * slip * b + [0, 0, DISPLACED * G]
        waves = (
            tmj.model.Wave(A[0], wavelength, None, chi[0], eps[0]),
            tmj.model.Wave(A[1], None, omega2, chi[1], eps[1]),
        )
        water = tmj.Water(RHO, None, waves, tuple(current), 1.1, 0.2, 0.7, segments=1)
        found = forces_on(one(b, center, velocities=rates, water=water), t).sum(axis=0)
        assert np.abs(found - expected).max() < 1e-12 * np.abs(expected).max() + 1e-11


@pytest.mark.third_means("water._flow above the still surface", by="linear theory continued, or held, by hand")
def test_the_field_above_the_still_surface_is_as_chosen() -> None:
    # In the crest of a wave of A = 1 m, at z = 0.5 m: θ = π/2, so that u = ω A e^{kz} along x alone, and a along -z.
    k = 2 * np.pi / 30
    omega = np.sqrt(G * k)
    for above, fades in ((tmj.model.AboveLevel.EXPONENTIAL, np.exp(0.5 * k)), (tmj.model.AboveLevel.CONSTANT, 1.0)):
        water = tmj.Water(waves=(tmj.model.Wave(1.0, 30.0, phase=np.pi / 2),), above=above)
        found = forces_on(one((0, 1, 0), (0, 0, 0.5), water=water)).sum(axis=0)
        drag = 0.5 * RHO * 1.2 * D * L * (omega * fades) ** 2
        assert found == pytest.approx([drag, 0.0, DISPLACED * (G - 2 * omega**2 * fades)], rel=1e-12)


# Buoyancy


def circle_below(u):
    """The part of a circle's area below a chord at u radii above its centre, by the angle of its segment."""
    u = min(1.0, max(-1.0, u))
    half = np.arccos(u)
    return 1 - (half - np.sin(half) * np.cos(half)) / np.pi


@pytest.mark.third_means("water._wet", "water._wet_part", by="draft, by the angle of a circle's segment")
@both
def test_a_rod_floats_where_it_displaces_its_mass(engine) -> None:
    # Level, with the axis 0.4 radii above and 0.4 below the surface; upright, two thirds under water: it stays.
    for center, b, part in (
        ((0, 0, 0.4 * R), (1, 0, 0), circle_below(-0.4)),
        ((0, 0, -0.4 * R), (1, 0, 0), circle_below(0.4)),
        ((0, 0, 0.5 * L - 2 / 3 * L), (0, 0, 1), 2 / 3),
    ):
        scene = one(b, center, part * DISPLACED, water=tmj.Water())
        assert np.abs(first_accelerations(scene, engine)).max() < 1e-11 * G
        lighter = one(b, center, 0.99 * part * DISPLACED, water=tmj.Water(added_mass=0.0))
        assert first_accelerations(lighter, engine)[:, 2] == pytest.approx(G * 0.01 / 0.99, rel=1e-9)


@pytest.mark.third_means("water._wet", "water._wet_part", by="the segment's area, integrated along the rod")
def test_an_inclined_rod_is_carried_by_the_volume_below_the_surface_at_its_centre() -> None:
    # A cross-section at the height z is wet up to -z / (R cos φ) radii: volume and moment by integration of circles.
    for tilt, height in ((0.05, 0.01), (0.4, -0.2), (0.4, 0.3), (1.1, 0.1), (1.5, -0.4)):
        for segments in (1, 3):
            water = tmj.Water(drag=0.0, segments=segments)
            found = forces_on(one((np.cos(tilt), 0, np.sin(tilt)), (0, 0, height), water=water))

            def wet(s, tilt=tilt, height=height):
                return circle_below(-(height + (s - 0.5) * L * np.sin(tilt)) / (R * np.cos(tilt)))

            reach = R / np.tan(tilt) / L  # the surface cuts the rod between these places
            middle = 0.5 - height / (L * np.sin(tilt))
            ends = [s for s in (middle - reach, middle + reach) if 0 < s < 1] or None
            second = quad(lambda s: s * wet(s), 0, 1, points=ends, epsabs=1e-12)[0]
            whole = quad(wet, 0, 1, points=ends, epsabs=1e-12)[0]
            assert found[:, 2] == pytest.approx(DISPLACED * G * np.array([whole - second, second]), abs=1e-7)
            assert np.abs(found[:, :2]).max() < 1e-11


@pytest.mark.third_means("water._elevation", by="the circle below two waves")
def test_the_surface_rises_and_falls_with_the_wave() -> None:
    # A rod along the crests in the still surface, wave heights of half its radius: the elevation of two waves together.
    waves = (tmj.model.Wave(0.3 * R, 8.0, phase=0.5), tmj.model.Wave(0.2 * R, None, 3.0, np.pi, 1.0))
    water = tmj.Water(waves=waves, drag=0.0, inertia=0.0, added_mass=0.0)
    omega = np.sqrt(G * 2 * np.pi / 8)
    for t in (0.0, 0.4, 1.3):
        first = 0.3 * R * np.sin(omega * t + 0.5 - 2 * np.pi / 8 * 0.7)
        second = 0.2 * R * np.sin(3.0 * t + 1.0 + 9.0 / G * 0.7)
        found = forces_on(one((0, 1, 0), (0.7, 0.0, 0.0), water=water), t).sum(axis=0)
        assert found[2] == pytest.approx(DISPLACED * G * circle_below((first + second) / R), rel=1e-12)


@pytest.mark.third_means("water.immerse", by="heave of the waterplane")
@both
def test_a_spar_heaves_as_an_oscillator_and_a_level_rod_nearly_so(engine) -> None:
    # Upright: buoyancy grows evenly with depth, ω² = ρ g π R²/m, and no mass is added along the rod: exact. Level and
    # half under water: ρ g d ℓ of stiffness over M = m + C_a m_w/2, ω² = 8 g/(π d (1 + C_a)). With the amplitude
    # a = 1e-3 R the wet part is ½ - (2/π)(x - x³/6), x in R: the cube slows it by 1e-6/16 of itself, 1e-6 rad over 17;
    # and M is M (1 - ε x/a), ε = 2 C_a/(1 + C_a) · (2/π) a/R, so that ÿ + y = -cos² τ of the part ε y, τ = ω t, which
    # leaves ε² = 2e-7.
    still, lift = tmj.Water(drag=0.0, added_mass=0.6), 0.05
    m = 0.6 * DISPLACED
    run = tmj.simulate(one((0, 0, 1), (0, 0, -0.1 * L + lift), m, water=still), engine=engine)
    omega = np.sqrt(RHO * G * np.pi * R**2 / m)
    assert np.abs(run.nodes.mean(axis=1)[:, 2] + 0.1 * L - lift * np.cos(omega * run.time)).max() < CLOSE
    small = 1e-3 * R
    run = tmj.simulate(one((0, 1, 0), (0, 0, small), 0.5 * DISPLACED, water=still), engine=engine, duration=1.5)
    omega = np.sqrt(8 * G / (np.pi * D * 1.6))
    tau, part = omega * run.time, 2 * 0.6 / 1.6 * 2 / np.pi * 1e-3
    expected = np.cos(tau) + part * (-0.5 + np.cos(2 * tau) / 6 + np.cos(tau) / 3)
    # RK4 at 1 ms adds (ω h)⁴ ω T / 120 = 4e-9.
    assert np.abs(run.nodes[:, 0, 2] / small - expected).max() < 3e-6


# Added mass and drag in water


@pytest.mark.third_means("water.immerse with added mass", by="(m_w - m) g over m + C_a m_w")
@both
@pytest.mark.parametrize("b", [(1, 0, 0), (0, 0, 1), (1, 0, 1)])
def test_a_rod_let_go_under_water_rises_with_the_mass_that_it_moves(engine, b) -> None:
    # (m_w - m) g upwards; m along the rod, m + C_a m_w across it.
    b = np.array(b) / np.linalg.norm(b)
    force = np.array([0, 0, (DISPLACED - 3.0) * G])
    along = b * (b @ force)
    expected = along / 3.0 + (force - along) / (3.0 + 0.7 * DISPLACED)
    found = first_accelerations(one(b, (0, 0, -5), water=tmj.Water(added_mass=0.7)), engine)
    assert np.abs(found - expected).max() < 1e-11


@pytest.mark.third_means("water.immerse with added mass", by="its period on springs")
@both
def test_a_rod_on_springs_under_water_heaves_with_its_added_mass(engine) -> None:
    # Level, on two strings straight up: (m + C_a m_w) z̈ = -2 k (z - z_e), 2 k s_e = (m - m_w) g.
    m, k, C_a, lift = 30.0, 400.0, 0.8, 0.1
    ends = {"a": (-0.5 * L, 0, -6.0), "b": (0.5 * L, 0, -6.0), "up_a": (-0.5 * L, 0, -4.0), "up_b": (0.5 * L, 0, -4.0)}
    stretch = (m - DISPLACED) * G / (2 * k)
    strings = tuple(tmj.String(f"s{x}", (f"up_{x}", x), k, rest_length=2.0 - stretch + lift) for x in "ab")
    structure = tmj.Structure("hung", ends, (tmj.Rod("rod", ("a", "b"), m, R),), strings, fixed_nodes=("up_a", "up_b"))
    water = tmj.Water(drag=0.0, added_mass=C_a)
    run = tmj.simulate(tmj.Scene(structure, gravity=(0, 0, -G), water=water, duration=2.0), engine=engine)
    omega = np.sqrt(2 * k / (m + C_a * DISPLACED))
    moved = -lift * (1 - np.cos(omega * run.time))
    assert run.tensions.min() > 1.0
    assert np.abs(run.nodes[:, :2, 2] + 6.0 - moved[:, None]).max() < CLOSE
    # External work is all of the water's: what the rod's own energy and the strings' do not account for.
    v = -lift * omega * np.sin(omega * run.time)
    work = 0.5 * m * v**2 + m * G * moved + k * ((stretch - lift - moved) ** 2 - (stretch - lift) ** 2)
    assert np.abs(run.external_work - work).max() < 500 * CLOSE


@pytest.mark.third_means("water.immerse", "water._across", by="v_t tanh(t √(W c)/M)")
@both
@pytest.mark.parametrize(
    ("b", "moved", "C"), [((1, 0, 0), 1.0, 1.2), ((0, 0, 1), 0.0, 0.1 * np.pi)], ids=["level", "upright"]
)
def test_a_rod_sinks_to_its_terminal_velocity(engine, b, moved, C) -> None:
    # M v̇ = W - ½ ρ C d ℓ v², M = m + C_a m_w across and m along: v = v_t tanh(t √(W c)/M).
    m, current = 14.0, (0.0, 0.0, 0.0)
    water = tmj.Water(tangential_drag=0.1, current=current)
    run = tmj.simulate(one(b, (0, 0, -40), m, water=water), engine=engine)
    M, W, c = m + moved * DISPLACED, (m - DISPLACED) * G, 0.5 * RHO * C * D * L
    v_t, rate = np.sqrt(W / c), np.sqrt(W * c) / M
    fallen = v_t / rate * np.log(np.cosh(rate * run.time))
    assert np.abs(run.nodes[:, 0, 2] - run.nodes[0, 0, 2] + fallen).max() < CLOSE
    v = v_t * np.tanh(rate * run.time)
    assert np.abs(run.external_work - (0.5 * m * v**2 - m * G * fallen)).max() < 1000 * CLOSE


@pytest.mark.third_means("water.immerse with added mass", by="its moment of inertia by segments")
@both
def test_water_slows_a_spin_by_its_segments(engine) -> None:
    # Neutral, level, n = 7 segments at s_k: I = m ℓ²/12 + C_a m_w ℓ² Σ (s_k - ½)²/n, and a moment of
    # ½ ρ C_d d ℓ/n Σ |s_k - ½|³ ℓ³ ω².
    n, spin, C_a = 7, 1.5, 0.5
    s = (np.arange(n) + 0.5) / n - 0.5
    inertia = DISPLACED * L**2 / 12 + C_a * DISPLACED * L**2 * np.mean(s * s)
    slows = 0.5 * RHO * 1.2 * D * L * L**3 * np.mean(np.abs(s) ** 3) / inertia * spin
    ends = np.array([[0, -0.5, 0], [0, 0.5, 0]]) * spin * L
    water = tmj.Water(added_mass=C_a, segments=n)
    run = tmj.simulate(one(center=(0, 0, -5), mass=DISPLACED, velocities=ends, water=water), engine=engine)
    angle = spin / slows * np.log1p(slows * run.time)
    place = 0.5 * L * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    assert np.abs(run.nodes[:, 1] - place - [0, 0, -5]).max() < CLOSE


@pytest.mark.third_means("water.immerse", by="shares of ¼ and ¾")
def test_hermites_weights_share_a_load_and_added_mass_by_the_cubic() -> None:
    # Two segments, at ¼ and ¾: h = s² (3 - 2 s) is 5/32 and 27/32. A rod that turns about its first node meets 1/16 and
    # 9/16 of the drag of its end; upright, half of the axial buoyancy goes to either node.
    water = tmj.Water(RHO, drag=1.1, added_mass=0.6, segments=2, weights=tmj.model.Weights.HERMITE)
    scene = one(center=(0, 0, -5), velocities=[[0, 0, 0], [0, 2.0, 0]], water=water)
    f = -0.5 * RHO * 1.1 * D * L / 2 * 4.0 * np.array([1 / 16, 9 / 16])
    h = np.array([5 / 32, 27 / 32])
    assert forces_on(scene)[:, 1] == pytest.approx([f @ (1 - h), f @ h], rel=1e-13)
    s = np.array([0.25, 0.75])
    expected = [[(1 - h) @ (1 - s), (1 - h) @ s], [h @ (1 - s), h @ s]]
    assert added_mass_of(scene) == pytest.approx(0.6 * DISPLACED / 2 * np.array(expected), rel=1e-13)
    upright = one((0, 0, 1), (0, 0, 0), water=water)  # half under water
    assert forces_on(upright)[:, 2] == pytest.approx([DISPLACED * G / 4] * 2, rel=1e-12)
