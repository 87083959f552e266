"""Rods in water: two implementations, closed forms, energy, and both engines."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp

import tensegrity_mj as tmj
from tensegrity_mj.commands.scenes import describe
from tensegrity_mj.dynamics.native.elements import let_act
from tensegrity_mj.dynamics.native.law import native_law
from tensegrity_mj.dynamics.native.plant import Plant
from tensegrity_mj.engines.mujoco import engine as mujoco_engine
from tensegrity_mj.engines.mujoco.mjcf import scene_to_mjcf
from tensegrity_mj.engines.mujoco.mjcf_tree import place as mujoco_accelerations_place
from tensegrity_mj.engines.request import request_for
from tensegrity_mj.model.actuation import Actuation, OnInfeasible
from tensegrity_mj.model.elements.water import sea_of, water_forces, wet_parts, wetness
from tensegrity_mj.model.text.reading import scene_from_toml
from tensegrity_mj.model.text.writing import scene_to_toml

G, RHO = 9.81, 1025.0
DOWN = (0.0, 0.0, -G)
LENGTH, RADIUS = 1.22, 0.05
D = 2 * RADIUS
DISPLACED = RHO * math.pi * D**2 / 4 * LENGTH  # kg of water in place of the rod: 9.82
FINE = tmj.DAE(rtol=1e-12, atol=1e-13)
WAVES = (
    tmj.model.Wave(0.5, 15.0, direction=0.3, phase=0.4),
    tmj.model.Wave(0.2, angular_frequency=2.0, direction=2.0),
)
ENGINES = [tmj.DAE(), tmj.MuJoCo()]
NAMES = ["DAE", "MuJoCo"]


def one(direction=(1.0, 0.0, 0.0), center=(0.0, 0.0, -5.0), mass=3.0, support=None, water=None, turn=None, **scene):
    """One rod of §7.2.3's size; `turn` is the velocity [m/s] of both ends, or of each."""
    b = np.array(direction, float) / np.linalg.norm(direction)
    ends = [tuple((np.array(center) + side * 0.5 * LENGTH * b).tolist()) for side in (-1, 1)]
    rod = tmj.Rod("rod", ("a", "b"), mass, RADIUS, support or tmj.Support.free())
    structure = tmj.Structure("one", {"a": ends[0], "b": ends[1]}, (rod,))
    velocities = None if turn is None else np.broadcast_to(turn, (2, 3))
    return tmj.Scene(
        structure,
        gravity=DOWN,
        water=water or tmj.Water(),
        initial_velocities=velocities,
        **({"duration": 1.0} | scene),
    )


def crowd(seed, weights=tmj.model.Weights.RIGID, depth=None, above=tmj.model.AboveLevel.EXPONENTIAL, segments=5):
    """Six rods of every kind of support around the surface, joined by strings, in motion."""
    rng, S = np.random.default_rng(seed), tmj.Support
    supports = [
        S.free(),
        S.pinned(0.0),
        S.pinned(0.3),
        S.free(plane=(0, 1, 0)),
        S.constrained([[1, 0, 0]], 0.2),
        S.constrained([[1, 0, 0], [0, 1, 0]], 0.6),
    ]
    nodes, rods, velocities = {}, [], []
    for number, support in enumerate(supports):
        a, b, spin = rng.normal(size=3) * (2, 2, 0.4), rng.normal(size=3), rng.normal(size=3)
        if support.plane is not None:
            b[1], spin = 0.0, spin * (0, 1, 0)
        end = a + LENGTH * b / np.linalg.norm(b)
        nodes |= {f"a{number}": tuple(a), f"b{number}": tuple(end)}
        rods.append(tmj.Rod(f"r{number}", (f"a{number}", f"b{number}"), 2.0, RADIUS, support))
        E = support.translation_basis
        slide, held = E @ rng.normal(size=E.shape[1]), (1 - support.sigma) * a + support.sigma * end
        velocities += [slide + np.cross(spin, a - held), slide + np.cross(spin, end - held)]
    ends = [(f"a{n}", f"b{(n + 1) % 6}") for n in range(6)]
    rest = [0.9 * float(np.linalg.norm(np.subtract(nodes[a], nodes[b]))) for a, b in ends]
    strings = [tmj.String(f"s{n}", ends[n], 500.0, 2.0, rest_length=rest[n]) for n in range(6)]
    water = tmj.Water(
        RHO, depth, WAVES, (0.3, -0.2, 0.1), 1.2, 0.1, 0.7, segments=segments, weights=weights, above=above
    )
    structure = tmj.Structure("crowd", nodes, tuple(rods), tuple(strings))
    return tmj.Scene(structure, gravity=DOWN, water=water, initial_velocities=velocities)


def accelerations(scene, engine, time=0.0, nodes=None, velocities=None):
    request = request_for(scene, None, None, None, OnInfeasible.STOP, None, False)
    nodes = scene.nodes0 if nodes is None else nodes
    return engine.accelerations(request)(time, nodes, scene.velocities0 if velocities is None else velocities)[1]


def compiled(scene, time=0.0):
    """F⁰ (N, 3), its power, and α (R, 2, 2), from what every engine calls."""
    plant = Plant(scene, native_law(None, scene.structure), Actuation.continuous(), OnInfeasible.STOP)
    power = let_act(plant.address, time)[0]
    return plant["forces"].copy(), power, plant.elements.added.reshape(-1, 2, 2).copy()


# What is under water


def test_the_wet_part_is_that_of_a_cylinder_that_a_plane_cuts() -> None:
    # The area of a circle below a chord at u radii is (2/π) ∫ √(1 - t²) dt. Its integrals U and V along a segment in
    # closed form, by parts: part = ΔU/Δu, part · place = U_2/Δu - ΔV/Δu². Round-off of these is ε/Δu².
    def circle(u):
        return 2 / math.pi * quad(lambda t: math.sqrt(1 - t * t), -1, min(max(u, -1), 1), epsabs=1e-13)[0]

    def integrals(u):
        if abs(u) >= 1:
            return (0.0, 0.0) if u < 0 else (u, (u * u + 0.25) / 2)
        root, angle = math.sqrt(1 - u * u), math.asin(u)
        first = u / 2 + (u * angle + root - root**3 / 3) / math.pi
        inside = (u * u / 2 + 1 / 8) * angle + 5 / 8 * u * root - u * root**3 / 12
        return first, u * u / 4 + 1 / 16 + inside / math.pi

    for u in (-3.0, -1.0, -0.7, 0.0, 0.4, 1.0, 2.0):
        assert float(wetness(u)) == pytest.approx(circle(u), abs=1e-10)
    for u in (-0.8, 0.1, 0.9):  # the closed forms are integrals of what they should be
        slopes = (np.array(integrals(u + 1e-5)) - integrals(u - 1e-5)) / 2e-5
        assert slopes == pytest.approx([float(wetness(u)), integrals(u)[0]], abs=1e-9)
    rng = np.random.default_rng(3)
    cases = [(-0.3, 0.7), (-3, 5), (2, -0.5), (-1.5, -0.9), (-500, 3), (0.2, 0.25), (4, -4), (1.5, 2.5), (-2, -1)]
    for first, second in cases + [tuple(pair) for pair in rng.normal(size=(50, 2)) * 1.5]:
        step, (u1, v1), (u2, v2) = second - first, integrals(first), integrals(second)
        part, place = wet_parts(first, second)
        assert float(part) == pytest.approx((u2 - u1) / step, abs=1e-12 + 1e-15 / abs(step))
        assert float(part * place) == pytest.approx(u2 / step - (v2 - v1) / step**2, abs=1e-12 + 1e-14 / step**2)
    for step in (0.0, 1e-9, 9.9e-6, 1.01e-5, 1e-4):  # all but level: a linear function of place
        for u in (-0.9, 0.0, 0.6):
            part, place = wet_parts(u, u + step)
            slope = 2 / math.pi * math.sqrt(1 - u * u)
            assert float(part) == pytest.approx(float(wetness(u)) + slope * step / 2, abs=1e-10 + step**2)
            assert float(place) == pytest.approx(0.5 + slope * step / 12 / float(part), abs=1e-10 + 10 * step**2)


def test_loads_and_their_places_are_continuous() -> None:
    # A rod is turned and lifted through the surface, through every branch: vertical, level, all in, all out. A load may
    # change by its slope times the step, at most its whole per R.
    scene = one(water=tmj.Water(waves=WAVES, current=(0.5, 0, 0)))

    def loads(heights, tilts):
        heights, tilts = np.broadcast_arrays(heights, tilts)
        b = np.stack([np.cos(tilts), 0 * tilts, np.sin(tilts)], axis=-1)
        center = heights[:, None] * np.array([0, 0, 1.0])
        nodes = np.stack([center - 0.5 * LENGTH * b, center + 0.5 * LENGTH * b], axis=1)
        force, alpha = water_forces(scene, np.zeros(len(nodes)), nodes, np.zeros_like(nodes))
        return np.hstack([force.reshape(-1, 6) / (DISPLACED * G), alpha.reshape(-1, 4) / DISPLACED])

    for tilt in (0.0, 1e-7, 3e-6, 1e-3, 0.3, 1.2, math.pi / 2):
        values = loads(np.linspace(-1.5, 1.5, 3001), tilt)
        step = np.abs(np.diff(values, axis=0)).max()
        assert step < 5 * 1e-3 / RADIUS, tilt
        assert np.ptp(values, axis=0).max() > 0.4
    # Finely across the change of rule at NEARLY_LEVEL, at half depth and where the rod begins to touch: no jump beyond
    # 1e-9 of the load, where the loads change by up to 1e-5 of themselves over the 40 steps.
    surface = float(sea_of(scene).elevation(0.0, 0.0, 0.0))
    for height in (surface, surface + RADIUS, surface - RADIUS):
        tilts = np.linspace(-2e-6, 2e-6, 41) + 0.036  # of the local slope of the waves
        values = loads(height, tilts)
        assert np.abs(np.diff(values, 2, axis=0)).max() < 1e-9


def test_buoyancy_is_the_weight_of_the_volume_below_the_surface() -> None:
    # A quarter turn from level to upright, at several depths: the volume by counting slices of the cylinder.
    quiet = tmj.Water(drag=0.0, segments=7)
    for tilt in (0.0, 0.2, 0.9, math.pi / 2):
        for height in (-0.4, -0.03, 0.0, 0.02, 0.3):
            scene = one((math.cos(tilt), 0, math.sin(tilt)), (0, 0, height), water=quiet)
            force = water_forces(scene, 0.0, scene.nodes0, scene.velocities0)[0]
            s = (np.arange(20000) + 0.5) / 20000
            depth = -(scene.nodes0[0, 2] + s * (scene.nodes0[1, 2] - scene.nodes0[0, 2]))
            part = wetness(depth / (RADIUS * max(math.cos(tilt), 1e-6)))
            assert force.sum(axis=0) == pytest.approx([0, 0, DISPLACED * G * part.mean()], abs=5e-3)
            if 0 < part.mean() < 1:  # the force acts at the centre of the volume, along the rod
                place = float(np.sum(s * part) / np.sum(part))
                assert force[1, 2] / force[:, 2].sum() == pytest.approx(place, abs=1e-4)


def test_the_compiled_loads_are_those_of_the_formulas() -> None:
    for seed in range(40):
        scene = crowd(
            seed,
            list(tmj.model.Weights)[seed % 2],
            [None, 4.0][seed // 2 % 2],
            list(tmj.model.AboveLevel)[seed // 4 % 2],
            1 + seed % 7,
        )
        force, power, alpha = compiled(scene)
        expected, added = water_forces(scene, 0.0, scene.nodes0, scene.velocities0)
        # Round-off: waves and forces of 1e2 N, amplified by up to 1e3 where segments barely touch.
        assert np.allclose(force, expected, rtol=1e-11, atol=1e-10)
        assert np.allclose(alpha, added, rtol=1e-11, atol=1e-12)
        assert power == pytest.approx(float(np.sum(expected * scene.velocities0)), rel=1e-10, abs=1e-9)


def test_times_go_with_positions() -> None:
    scene, times = crowd(1), np.array([0.0, 0.7, 1.9])
    nodes = scene.nodes0 + 0.1 * np.arange(3)[:, None, None]
    velocities = np.broadcast_to(scene.velocities0, nodes.shape)
    force, alpha = water_forces(scene, times, nodes, velocities)
    for row, time in enumerate(times):
        single = water_forces(scene, time, nodes[row], velocities[row])
        assert np.array_equal(force[row], single[0])
        assert np.array_equal(alpha[row], single[1])


# Closed forms


@pytest.mark.parametrize("engine", ENGINES, ids=NAMES)
@pytest.mark.parametrize("direction", [(1, 0, 0), (0, 0, 1), (1, 0, 1), (0.3, -2, 0.7)])
@pytest.mark.parametrize("added", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("density", [2700.0, 2700 * 0.19])  # solid, and hollow of §7.2.3, which floats
def test_first_acceleration_of_a_rod_released_from_rest(engine, direction, added, density) -> None:
    # Along the rod its mass is its own, across it m + C_a m_w; the force is (m_w - m) g upwards. Round-off only: the
    # accelerations are of the order of g and the equations well conditioned.
    mass = density * math.pi * D**2 / 4 * LENGTH
    scene = one(direction, mass=mass, water=tmj.Water(added_mass=added))
    b = np.array(direction) / np.linalg.norm(direction)
    force = np.array([0, 0, (DISPLACED - mass) * G])
    along = b * (b @ force)
    expected = along / mass + (force - along) / (mass + added * DISPLACED)
    assert np.max(np.abs(accelerations(scene, engine) - expected)) < 1e-11


@pytest.mark.parametrize("engine", ENGINES, ids=NAMES)
@pytest.mark.parametrize("weights", list(tmj.model.Weights), ids=lambda w: w.value)
def test_first_acceleration_of_a_pinned_rod_has_the_moments_of_segments(engine, weights) -> None:
    # A level rod pinned at one end: (m ℓ²/3 + C_a m_w ℓ² Σ h(s) s / L) φ̈ = (m_w - m) g ℓ/2, s = (k + ½)/L, where
    # h(s) = s with the rigid weights and s² (3 - 2 s) with the thesis'. Both share a constant load alike, and differ by
    # 5 % in how a load that grows along the rod turns it.
    water = tmj.Water(added_mass=0.8, weights=weights)
    s = (np.arange(5) + 0.5) / 5
    h = s if weights is tmj.model.Weights.RIGID else s**2 * (3 - 2 * s)
    inertia = 3.0 * LENGTH**2 / 3 + 0.8 * DISPLACED * LENGTH**2 * np.mean(h * s)
    spin = (DISPLACED - 3.0) * G * LENGTH / 2 / inertia
    found = accelerations(one(support=tmj.Support.pinned(0.0), water=water), engine)
    assert found[1, 2] == pytest.approx(spin * LENGTH, rel=1e-12)
    assert np.mean(s * s) == pytest.approx(1 / 3 - 1 / 12 / 25, rel=1e-14)  # 1/L² of 1/4 off the integral


@pytest.mark.parametrize(("direction", "sinks"), [((1, 0, 0), True), ((0, 1, 0), False), ((0, 0, 1), True)])
def test_a_rod_sinks_and_rises_to_its_terminal_velocity(direction, sinks) -> None:
    # M v̇ = W - c v², M = m + C_a m_w across or m along, c = ½ ρ C_d d ℓ or ½ ρ C_t π d ℓ: v = v_t tanh(t √(W c) / M).
    mass, upright = (30.0 if sinks else 3.0), direction[2] > 0
    scene = one(direction, (0, 0, -40.0), mass, water=tmj.Water(tangential_drag=0.1), duration=3.0)
    moved = mass + (0.0 if upright else DISPLACED)
    drag = 0.5 * RHO * LENGTH * D * (0.1 * math.pi if upright else 1.2)
    weight = abs(mass - DISPLACED) * G
    run = tmj.simulate(scene, engine=FINE)
    speed = math.sqrt(weight / drag) * np.tanh(run.time * math.sqrt(weight * drag) / moved)
    sign = -1 if sinks else 1
    assert np.max(np.abs(run.velocities[:, 0, 2] - sign * speed)) < 1e-9  # rtol 1e-12 of 3 m/s, over 3 s
    assert upright or speed[-1] > 0.99 * math.sqrt(weight / drag)


def test_a_current_carries_a_rod_along() -> None:
    # A neutral rod across a current U: u̇ = -c u² / M of u = U - v, so u = U / (1 + U c t / M).
    scene = one((0, 1, 0), mass=DISPLACED, water=tmj.Water(current=(0.8, 0, 0)), duration=3.0)
    run = tmj.simulate(scene, engine=FINE)
    rate = 0.8 * 0.5 * RHO * 1.2 * D * LENGTH / (2 * DISPLACED)
    assert np.max(np.abs(run.velocities[:, 1, 0] - 0.8 * (1 - 1 / (1 + rate * run.time)))) < 1e-10
    assert run.velocities[-1, 0, 0] > 0.6


def zero_crossings(time, values):
    at = np.flatnonzero(np.diff(np.sign(values)) > 0)
    return time[at] - values[at] * (time[at + 1] - time[at]) / (values[at + 1] - values[at])


@pytest.mark.parametrize("added", [0.0, 1.0])
@pytest.mark.parametrize("segments", [1, 5])
def test_a_floating_rod_heaves_and_pitches_with_the_stiffness_of_its_waterplane(added, segments) -> None:
    # Half under water: m = m_w/2 and added mass C_a m_w/2. The waterplane is d ℓ: heave, ρ g d ℓ over m + C_a m_w/2,
    # which is ω² = 8 g / (π d (1 + C_a)). Pitch: ρ g d ℓ³/12 over m ℓ²/12 + C_a m_w/2 ℓ²/12 (1 - 1/L²), the added mass
    # of segments at their centres, and the volume of each exact. Gravity and buoyancy both act on the axis, so that
    # nothing else turns it. Amplitude 1e-3 d: the frequency is off by its square, 1e-6.
    mass, small = DISPLACED / 2, 1e-4
    water = tmj.Water(drag=0.0, added_mass=added, segments=segments)
    heave = math.sqrt(8 * G / (math.pi * D * (1 + added)))
    inertia = mass * (1 + added * (1 - 1 / segments**2)) * LENGTH**2 / 12
    pitch = math.sqrt(RHO * G * D * LENGTH**3 / 12 / inertia)
    lifted = one(center=(0, 0, small), mass=mass, water=water)
    tilted = one((math.cos(small), 0, math.sin(small)), (0, 0, 0), mass, water=water)
    for scene, omega, sign in ((lifted, heave, 1), (tilted, pitch, -1)):
        run = tmj.simulate(scene, engine=tmj.DAE(), duration=4.0, output_interval=1e-3)
        value = run.nodes[:, 1, 2] + sign * run.nodes[:, 0, 2]
        crossings = zero_crossings(run.time, value)
        assert len(crossings) > 4
        assert 2 * math.pi / np.mean(np.diff(crossings)) == pytest.approx(omega, rel=1e-4)


def test_a_neutral_rod_moves_with_the_water_in_a_long_wave() -> None:
    # Across the wave, without drag, C_M = 1 + C_a and m = m_w give ẍ = a(x, t) whatever C_a is: integrated here by
    # another method, from the water's own velocity. It goes round the orbit A e^{kz} within k A of it.
    wave = tmj.model.Wave(0.01, 30.0, phase=0.3)
    for added in (0.0, 1.0):
        water = tmj.Water(waves=(wave,), drag=0.0, added_mass=added)
        scene = one((0, 1, 0), (1.0, 0, -2.0), DISPLACED, water=water, duration=4.4)
        sea, center = sea_of(scene), np.array([1.0, 0, -2.0])
        start = sea.velocity(0.0, center)
        run = tmj.simulate(scene.with_(initial_velocities=np.tile(start, (2, 1))), engine=FINE)
        solved = solve_ivp(
            lambda t, y: np.concatenate([y[3:], sea.acceleration(t, y[:3])]),  # noqa: B023
            (0, 4.4),
            np.concatenate([center, start]),
            t_eval=run.time,
            rtol=1e-12,
            atol=1e-14,
        )
        middle = run.nodes.mean(axis=1)
        assert np.max(np.abs(middle - solved.y[:3].T)) < 1e-10
        orbit = 0.01 * math.exp(-2.0 * 2 * math.pi / 30)
        assert np.ptp(middle[:, 2]) / 2 == pytest.approx(orbit, rel=1e-2)


def test_inertia_may_be_given_apart_from_added_mass() -> None:
    # A rod that is all but held by its mass of 1e9 kg: the force across it is C_M m_w a + drag.
    wave = (tmj.model.Wave(0.3, 20.0, phase=1.0),)
    for inertia, factor in ((None, 1.5), (2.0, 2.0), (0.0, 0.0)):
        water = tmj.Water(waves=wave, drag=0.0, added_mass=0.5, inertia=inertia)
        scene = one((0, 1, 0), mass=1e9, water=water)
        force = water_forces(scene, 0.0, scene.nodes0, scene.velocities0)[0].sum(axis=0)
        expected = factor * DISPLACED * sea_of(scene).acceleration(0.0, [0, 0, -5.0]) + [0, 0, DISPLACED * G]
        assert force == pytest.approx(expected, rel=1e-13)


def test_hermite_weights_share_loads_as_the_thesis_has_it() -> None:
    # An inclined rod with its lower half under water: buoyancy across it by the cubic, along it by halves.
    direction = (math.cos(0.5), 0.0, math.sin(0.5))
    water = tmj.Water(drag=0.0, segments=20, weights=tmj.model.Weights.HERMITE)
    scene = one(direction, (0, 0, 0), water=water)
    force = water_forces(scene, 0.0, scene.nodes0, scene.velocities0)[0]
    shared = scene.with_(water=replace(water, weights=tmj.model.Weights.RIGID))
    rigid = water_forces(shared, 0.0, scene.nodes0, scene.velocities0)
    b, up = np.array(direction), DISPLACED * G * np.array([0, 0, 1.0])
    # Over s from 0 to ½: ∫ s²(3 - 2s) = 1/8 - 1/32 against ∫ s = 1/8; the surface cuts a slope of R/ℓ: 1e-2 of it.
    across, along = up - b * (b @ up), b * (b @ up)
    assert force[1] == pytest.approx((1 / 8 - 1 / 32) * across + along / 4, rel=3e-2)
    assert rigid[0][1] == pytest.approx((across + along) / 8, rel=3e-2)
    assert force.sum(axis=0) == pytest.approx(rigid[0].sum(axis=0), rel=1e-12)


def test_added_mass_by_segments_and_weights() -> None:
    s = (np.arange(4) + 0.5) / 4
    for weights, h in ((tmj.model.Weights.RIGID, s), (tmj.model.Weights.HERMITE, s**2 * (3 - 2 * s))):
        alpha = compiled(one(water=tmj.Water(added_mass=0.6, segments=4, weights=weights)))[2][0]
        expected = [[np.mean((1 - h) * (1 - s)), np.mean((1 - h) * s)], [np.mean(h * (1 - s)), np.mean(h * s)]]
        assert alpha == pytest.approx(0.6 * DISPLACED * np.array(expected), rel=1e-13)


def test_the_diameter_is_the_rods_own_or_one_for_all() -> None:
    own, given = compiled(one()), compiled(one(water=tmj.Water(diameter=2 * D)))
    assert given[0] == pytest.approx(4 * own[0], rel=1e-14)
    assert given[2] == pytest.approx(4 * own[2], rel=1e-14)


# Energy, engines


def largest_term(run):
    terms = (run.kinetic_energy, run.gravity_energy - run.gravity_energy[0], run.string_energy, run.external_work)
    return max(float(np.max(np.abs(term))) for term in terms)


def test_external_work_is_force_times_velocity() -> None:
    # By quadrature over recorded rows: F⁰ from the formulas, added mass from differences of recorded velocities.
    scene = crowd(4)
    run = tmj.simulate(scene, engine=FINE, duration=0.4, output_interval=1e-3)
    force, alpha = water_forces(scene, run.time, run.nodes, run.velocities)
    acceleration = np.gradient(run.velocities, run.time, axis=0, edge_order=2)
    pairs = scene.structure.rod_nodes
    b = run.nodes[:, pairs[:, 1]] - run.nodes[:, pairs[:, 0]]
    b /= np.linalg.norm(b, axis=-1, keepdims=True)
    for end in range(2):
        for other in range(2):
            a = acceleration[:, pairs[:, other]]
            a = a - b * np.sum(a * b, axis=-1, keepdims=True)
            force[:, pairs[:, end]] -= alpha[..., end, other, None] * a
    power = np.sum(force * run.velocities, axis=(1, 2))
    work = np.concatenate([[0.0], np.cumsum(0.5 * (power[1:] + power[:-1]) * 1e-3)])
    # Trapezoids and central differences of 1 ms, of motions of up to some 10 rad/s: (h ω)² / 6 ~ 2e-5, and kinks.
    assert np.max(np.abs(work - run.external_work)) < 1e-3 * np.max(np.abs(work))


@pytest.mark.parametrize("weights", list(tmj.model.Weights), ids=lambda w: w.value)
def test_both_engines_have_the_same_accelerations(weights) -> None:
    # MuJoCo's come from its own inertia, bias and joints; every kind of support, wet, dry and partly wet rods.
    for seed in range(12):
        scene = crowd(seed, weights, [None, 4.0][seed % 2])
        reference, found = (accelerations(scene, engine, 1.3) for engine in ENGINES)
        assert np.max(np.abs(found - reference)) < 1e-12 * np.max(np.abs(reference))


def test_a_spin_about_the_axis_that_mujoco_could_have_does_not_matter(monkeypatch) -> None:
    # A body of MuJoCo may spin about its rod, which no node shows. It changes no acceleration of a node but for the
    # moment of inertia about the axis, 1e-5 of the transverse one: 1e-5 of spin times rate of turning times ℓ.
    place = mujoco_accelerations_place

    def spinning(data, *state):
        place(data, *state)
        data.qvel[5] = 7.0

    scene = one((1, 0, 0), turn=[[0, -1.0, 2.0], [0, 1.0, -2.0]])
    reference = accelerations(scene, tmj.MuJoCo())
    monkeypatch.setattr(mujoco_engine, "place", spinning)
    rate = 2 * math.sqrt(5) / LENGTH
    assert np.max(np.abs(accelerations(scene, tmj.MuJoCo()) - reference)) < 1e-4 * 7.0 * rate * LENGTH


def test_both_engines_move_alike_and_have_the_same_forces_of_rods() -> None:
    # Both RK4 are of order 4 but for strings that slacken and the roots of w, and differ from each other by less than
    # from the reference.
    scene = crowd(5)
    reference = tmj.simulate(scene, engine=FINE, duration=1.0)
    errors = []
    for step in (2e-3, 1e-3):
        run = tmj.simulate(scene, engine=tmj.MuJoCo(timestep=step), duration=1.0)
        errors.append(np.max(np.abs(run.nodes - reference.nodes)))
        again = tmj.simulate(scene, engine=tmj.DAE(method=tmj.Method.RK4, timestep=step), duration=1.0)
        assert np.max(np.abs(run.nodes - again.nodes)) < max(1e-9, 0.1 * errors[-1])
        scale = np.max(np.abs(reference.rod_force_densities))
        assert np.max(np.abs(run.rod_force_densities - reference.rod_force_densities)) < 1e-3 * scale
    assert errors[0] < 1e-4
    assert errors[1] < 0.5 * errors[0]


def test_eulers_method_converges_to_the_same_motion_and_ledger() -> None:
    scene, euler = crowd(5), tmj.Integrator.EULER
    reference = tmj.simulate(scene, engine=tmj.DAE(), duration=0.5)
    runs = [tmj.simulate(scene, engine=tmj.MuJoCo(h, euler), duration=0.5) for h in (1e-3, 5e-4)]
    errors = [np.max(np.abs(run.nodes - reference.nodes)) for run in runs]
    works = [np.max(np.abs(run.external_work - reference.external_work)) for run in runs]
    assert errors[1] == pytest.approx(errors[0] / 2, rel=0.1)
    assert works[1] == pytest.approx(works[0] / 2, rel=0.2)


def test_rods_that_water_does_not_reach_move_as_if_there_were_none() -> None:
    scene = one((1, 0.2, 0.3), (0, 0, 60.0), turn=[[0.2, -1, 0], [-0.2, 1, 0]], water=tmj.Water(waves=WAVES))
    for engine in (tmj.DAE(), tmj.MuJoCo()):
        wet = tmj.simulate(scene, engine=engine)
        dry = tmj.simulate(scene.with_(water=None), engine=engine)
        # Fixed steps: the same forces to round-off; error-controlled ones too, since nothing differs but round-off.
        assert np.max(np.abs(wet.nodes - dry.nodes)) < 1e-12


def test_resistance_goes_with_water() -> None:
    scene = crowd(2).with_(resistance=tmj.Resistance(viscous=2.0))
    run = tmj.simulate(scene, engine=tmj.DAE(), duration=0.5)
    other = tmj.simulate(scene, engine=tmj.MuJoCo(), duration=0.5)
    assert run.dissipation[-1] > 1.0
    assert run.energy_residual < 1e-6 * largest_term(run)
    assert np.max(np.abs(run.nodes - other.nodes)) < 1e-4


# What is refused, what is reported


def test_what_cannot_be_in_water_says_so() -> None:
    scene = one()
    for integrator in (tmj.Integrator.IMPLICIT, tmj.Integrator.IMPLICITFAST, tmj.Integrator.DISCRETE):
        words = rf"Integrator.{integrator.name}: water adds mass .* does not step with those"
        with pytest.raises(tmj.errors.OptionError, match=words):
            tmj.simulate(scene, engine=tmj.MuJoCo(1e-3, integrator))
    with pytest.raises(tmj.errors.SceneError, match=r"MuJoCo: water adds mass .* before the forces of contact"):
        tmj.simulate(one(contact=tmj.model.Contact(floor=-8.0)), engine=tmj.MuJoCo(1e-4))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"density": 0.0}, "water: density = 0.0; it must be > 0 kg/m³"),
        ({"depth": -1.0}, "water: depth = -1.0; it must be > 0 m, or None"),
        ({"drag": float("nan")}, "water: drag = nan; it must be >= 0"),
        ({"tangential_drag": -1}, "water: tangential_drag = -1; it must be >= 0"),
        ({"added_mass": "1"}, "water: added_mass = '1'; it must be >= 0"),
        ({"inertia": -0.1}, "water: inertia = -0.1; it must be >= 0, or None for 1 \\+ added_mass"),
        ({"segments": 0}, "water: segments = 0; it must be an integer from 1 to 1000"),
        ({"segments": 2.5}, "water: segments = 2.5; it must be an integer"),
        ({"weights": "rigit"}, r"weights = 'rigit' \(did you mean 'rigid'\?\); it must be one of Weights.RIGID"),
        ({"above": None}, "water: above = None; it must be one of AboveLevel"),
        ({"diameter": 0}, "water: diameter = 0; it must be > 0 m"),
        ({"viscosity": -1.0}, "water: viscosity = -1.0; it must be > 0 m²/s"),
        ({"current": (1, 2)}, r"water: current = \(1, 2\); it must be three finite numbers"),
        ({"waves": 3}, "water: waves = 3; it must be a sequence"),
        ({"waves": (1,)}, r"water: waves\[0\] = 1; use Wave\("),
    ],
)
def test_water_is_validated(change, message) -> None:
    with pytest.raises(tmj.errors.SceneError, match=message):
        one(water=replace(tmj.Water(), **change))


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"amplitude": -1.0, "wavelength": 5.0}, "wave: amplitude = -1.0; it must be >= 0 m"),
        ({"amplitude": 1.0}, "wave: wavelength = None.*give one of the two"),
        (
            {"amplitude": 1.0, "wavelength": 5.0, "angular_frequency": 2.0},
            "wavelength = 5.0.*give one of the two",
        ),
        ({"amplitude": 1.0, "wavelength": 0.0}, "wave: wavelength = 0.0; it must be > 0 m"),
        ({"amplitude": 1.0, "wavelength": 5.0, "phase": math.inf}, "wave: phase = inf; it must be a finite number"),
    ],
)
def test_waves_are_validated(given, message) -> None:
    with pytest.raises(tmj.errors.SceneError, match=message):
        tmj.model.Wave(**given)


def test_water_needs_gravity_that_fits_it_and_rods() -> None:
    with pytest.raises(tmj.errors.SceneError, match="the still surface is z = 0"):
        one().with_(gravity=(0.0, 1.0, -9.0))
    with pytest.raises(tmj.errors.SceneError, match="waves without gravity"):
        one(water=tmj.Water(waves=WAVES)).with_(gravity=(0.0, 0.0, 0.0))
    with pytest.raises(tmj.errors.SceneError, match="use Water"):
        one().with_(water="sea")
    points = tmj.Structure(
        "points",
        {"a": (0, 0, 0), "b": (0, 0, -1)},
        strings=(tmj.String("s", ("a", "b"), 100.0),),
        fixed_nodes=("a",),
        point_masses=(tmj.PointMass("b", 1.0),),
    )
    with pytest.raises(tmj.errors.SceneError, match="has no rod"):
        tmj.Scene(points, gravity=DOWN, water=tmj.Water())
    # Without gravity nothing floats, and drag and added mass are as ever.
    weightless = one(turn=(0, 0, 1.0)).with_(gravity=(0.0, 0.0, 0.0))
    run = tmj.simulate(weightless, engine=FINE)
    rate = 0.5 * RHO * 1.2 * D * LENGTH / (3.0 + DISPLACED)
    assert np.max(np.abs(run.velocities[:, 0, 2] - 1 / (1 + rate * run.time))) < 1e-10


def test_water_is_written_and_read_without_loss(tmp_path) -> None:
    water = tmj.Water(1000, 8, list(WAVES), (0.1, 0, 0), 1, 0.1, 0.5, 1.4, 3, tmj.model.Weights.HERMITE, 0.11)
    water = replace(water, above=tmj.model.AboveLevel.CONSTANT, viscosity=1e-6)
    for scene in (one(water=water), one(), crowd(1)):
        assert scene_from_toml(scene_to_toml(scene)) == scene
    run = tmj.simulate(one(water=water), engine=tmj.DAE(), duration=0.1)
    assert tmj.Trajectory.load(run.save(tmp_path / "wet.nc")).scene == run.scene
    text = scene_to_toml(one(water=water))
    for old, new, message in (
        ('weights = "hermite"', 'weights = "beam"', 'weights = .beam. .a text.; it must be "rigid" or "hermite"'),
        ("segments = 3", "segments = 3.5", "segments = 3.5 .a number.; it must be an integer"),
        ("wavelength", "length", "unknown key 'length'"),
        ("viscosity", "viscousity", "unknown key 'viscousity'"),
    ):
        with pytest.raises(tmj.errors.FormatError, match=message):
            scene_from_toml(text.replace(old, new))


def test_descriptions_name_water() -> None:
    scene = one(water=tmj.Water(waves=WAVES, current=(0.1, 0, 0)))
    reported = describe(scene)
    assert "waves of 1 m, 15 m long, towards 17.19°" in reported["water"]
    assert "C_M = 2" in reported["water"]
    assert describe(scene.with_(water=None))["water"] is None
    # The rod weighs 3 kg and displaces 9.82: what is unbalanced at rest has buoyancy in it, half on either node.
    assert describe(one())["unbalanced_force"] == pytest.approx((DISPLACED - 3.0) * G / 2, rel=1e-12)
    assert "The water of the scene is not in this file." in scene_to_mjcf(scene)
    assert any("water" in reason for reason in tmj.studies.requirements(scene).reasons)
    assert any("water is not in the model" in note for note in tmj.stable_step(crowd(1), tmj.MuJoCo()).notes)


def test_reynolds_and_keulegan_carpenter_numbers() -> None:
    # A rod across the wave, pinned at its middle: nothing turns it. The speed is A ω e^{kz} at all times.
    wave = tmj.model.Wave(0.5, 15.0)
    omega, k = math.sqrt(G * 2 * math.pi / 15), 2 * math.pi / 15
    scene = one((0, 1, 0), (0, 0, -1.0), support=tmj.Support.pinned(0.5), water=tmj.Water(waves=(wave,)), duration=4.0)
    run = tmj.simulate(scene, engine=tmj.DAE(), output_interval=0.1)
    speed = 0.5 * omega * math.exp(-k)
    numbers = tmj.runs.flow_numbers(run)
    assert numbers.reynolds[0] == pytest.approx(speed * D / 1.19e-6, rel=1e-6)
    assert numbers.keulegan_carpenter[0] == pytest.approx(speed * 2 * math.pi / omega / D, rel=1e-6)
    assert numbers.undisturbed_reynolds[0] == pytest.approx(numbers.reynolds[0], rel=1e-6)
    assert numbers.notes == ()  # Rn 5.6e4, KC 20.7: within §7.2.2
    assert json.dumps(run.reports["water"])

    fast = tmj.simulate(scene.with_(water=replace(scene.water, waves=(replace(wave, amplitude=2.5),))), duration=4.0)
    notes = fast.reports["water"]["notes"]
    assert len(notes) == 3
    assert "0.333 of its length high" in notes[0]
    assert "Reynolds numbers of 1 of 1 rods are above 200000" in notes[1]
    assert "Keulegan-Carpenter numbers of 1 of 1 rods are outside 15 to 45" in notes[2]

    # A free neutral rod goes with the water: what it meets is far less than what there is.
    free = one((0, 1, 0), (0, 0, -1.0), DISPLACED, water=tmj.Water(waves=(wave,)), duration=4.0)
    start = np.tile(sea_of(free).velocity(0.0, [0, 0, -1.0]), (2, 1))
    loose = tmj.runs.flow_numbers(tmj.simulate(free.with_(initial_velocities=start), engine=tmj.DAE()))
    assert loose.reynolds[0] < 0.8 * loose.undisturbed_reynolds[0]
    assert len(loose.notes) == 1

    calm = tmj.simulate(one(water=tmj.Water(current=(1, 0, 0))), engine=tmj.DAE())
    assert calm.reports["water"]["keulegan_carpenter"] is None
    assert np.isnan(tmj.runs.flow_numbers(calm).keulegan_carpenter).all()
    with pytest.raises(tmj.errors.OptionError, match="has no water"):
        tmj.runs.flow_numbers(tmj.simulate(one().with_(water=None), engine=tmj.DAE()))


def test_each_rod_has_the_period_of_the_waves_where_it_is() -> None:
    """Short chop fades with e^(kz): at 5 m deep 3 m waves are e^(-10.5) of themselves, and say nothing of the flow.

    In deep water the orbits are ω A e^(kz): 0.30 m/s of the long waves there, 2.5e-5 m/s of the chop, but 0.51 and
    0.91 m/s at the surface. A rod in the air meets none, and has no number.
    """
    rod = tmj.Rod("r", ("a", "b"), 5.0, 0.05, tmj.Support.pinned(0.5))

    def number(z: float) -> float:
        structure = tmj.Structure("s", {"a": (0.0, -0.5, z), "b": (0.0, 0.5, z)}, (rod,))
        waves = (tmj.model.Wave(0.5, 60.0), tmj.model.Wave(0.2, 3.0))
        scene = tmj.Scene(structure, gravity=(0, 0, -9.81), water=tmj.Water(waves=waves))
        run = tmj.simulate(scene, None, tmj.DAE(), duration=8.0, output_interval=0.05)
        return float(tmj.runs.flow_numbers(run).undisturbed_keulegan_carpenter[0])

    k = 2 * np.pi / 60
    # The speed's peak is met within half a sample's turn of the phase, 1e-3 of itself, and the chop adds 1e-4.
    assert number(-5.0) == pytest.approx(2 * np.pi * 0.5 * np.exp(-5 * k) / 0.1, rel=2e-3)
    assert np.isnan(number(5.0))


def test_waves_beyond_linear_theory_are_reported() -> None:
    rod = tmj.Rod("r", ("a", "b"), 5.0, 0.05, tmj.Support.pinned(0.5))
    structure = tmj.Structure("s", {"a": (0.0, -0.5, -3.0), "b": (0.0, 0.5, -3.0)}, (rod,))

    def notes(water: tmj.Water) -> str:
        scene = tmj.Scene(structure, gravity=(0, 0, -9.81), water=water)
        run = tmj.simulate(scene, None, tmj.DAE(), duration=0.02)
        return " ".join(tmj.runs.flow_numbers(run).notes)

    assert "waves above 1/7 break" in notes(tmj.Water(waves=(tmj.model.Wave(1.0, 13.9),)))
    assert "1/7" not in notes(tmj.Water(waves=(tmj.model.Wave(1.0, 14.1),)))
    assert "0.78 of the depth" in notes(tmj.Water(waves=(tmj.model.Wave(1.6, 60.0),), depth=4.0))
    assert "below the bottom at -2 m" in notes(tmj.Water(depth=2.0))
    assert notes(tmj.Water()) == ""


def test_dry_rods_high_above_short_waves_feel_nothing() -> None:
    rod = tmj.Rod("r", ("a", "b"), 5.0, 0.05)
    structure = tmj.Structure("s", {"a": (0.0, -0.5, 80.0), "b": (0.0, 0.5, 80.0)}, (rod,))
    scene = tmj.Scene(structure, gravity=(0, 0, -9.81), water=tmj.Water(waves=(tmj.model.Wave(0.01, 0.5),)))
    forces, alpha = water_forces(scene, 0.0, scene.nodes0, scene.velocities0)
    assert not forces.any()
    assert not alpha.any()
