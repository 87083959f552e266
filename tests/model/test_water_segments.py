"""Segments of rods in waves: errors against integrals in closed form, their bounds, and the number that is chosen.

The formulas here are written anew from linear theory: nothing of `waves` or `water` is called for what is expected.
Rods are under water and at rest, so that inertia, drag and buoyancy add up and each is looked at alone.
"""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad

import tensegrity_mj as tmj
from evidence.families.in_waves import beam_in_waves, tower_in_waves
from tensegrity_mj.commands.run import describe as describe_run
from tensegrity_mj.commands.run import summary
from tensegrity_mj.commands.scenes import describe
from tensegrity_mj.engines.request import request_for
from tensegrity_mj.model.actuation import OnInfeasible
from tensegrity_mj.model.elements.water import water_forces
from tensegrity_mj.model.text.reading import scene_from_toml
from tensegrity_mj.model.text.writing import scene_to_toml

G, RHO, RADIUS = 9.81, 1025.0, 0.15
DISPLACED = RHO * np.pi * RADIUS**2  # kg/m


def rod_scene(start, along, length, water, mass=1500.0, **scene):
    """One free rod from a point along a direction."""
    end = np.array(start) + length * np.array(along) / np.linalg.norm(along)
    rod = tmj.Rod("rod", ("a", "b"), mass, RADIUS)
    structure = tmj.Structure("long", {"a": tuple(start), "b": tuple(end.tolist())}, (rod,))
    return tmj.Scene(structure, gravity=(0.0, 0.0, -G), water=water, **({"duration": 5.0} | scene))


def long_rod(segments=None, **scene):
    """20 m in a wave of 15 m: 1.33 waves along it."""
    water = tmj.Water(waves=(tmj.model.Wave(0.5, 15.0),), segments=segments)
    return rod_scene((0.0, 0.0, -1.0), (1, 0, 0), 20.0, water, **scene)


def force_and_moment(scene, time):
    """Sum of the nodes' forces [N] and the moment about the centre [N m], as a vector across the rod's own axis."""
    first, second = water_forces(scene, time, scene.nodes0, scene.velocities0)[0]
    return first + second, (second - first) * scene.structure.rod_lengths[0] / 2


def of_inertia(scene, time, C_M):
    """Force, moment and F̂ of C_M m' P a along a rod in deep water, a = ω² A e^{kz} (cos χ cos θ, sin χ cos θ, -sin θ).

    With θ = ω t + ε - k (x cos χ + y sin χ), e^{kz + iθ} is c e^{μσ} at σ metres along the rod; e^{μσ} and σ e^{μσ}
    have integrals in closed form.
    """
    wave, x = scene.water.waves[0], scene.nodes0[0]
    length = float(scene.structure.rod_lengths[0])
    b = (scene.nodes0[1] - x) / length
    k = 2 * np.pi / wave.wavelength
    omega = np.sqrt(G * k)
    heading = np.array([np.cos(wave.direction), np.sin(wave.direction), 0.0])
    mu = k * (b[2] - 1j * (b @ heading))
    c = np.exp(k * x[2] + 1j * (omega * time + wave.phase - k * (x @ heading)))
    whole = c * (np.exp(mu * length) - 1) / mu
    moment = c * (np.exp(mu * length) * (length / 2 / mu - 1 / mu**2) + length / 2 / mu + 1 / mu**2)
    size = C_M * DISPLACED * omega**2 * wave.amplitude
    vectors = [size * (i.real * heading - i.imag * np.array([0.0, 0.0, 1.0])) for i in (whole, moment)]
    rise = k * b[2]
    largest = size * np.exp(k * x[2]) * (np.expm1(rise * length) / rise if abs(rise) > 1e-12 else length)
    return *(v - b * (b @ v) for v in vectors), largest


def inclined_rods(count, seed=4):
    """Rods of 2 to 30 m of any direction, their upper ends 1.2 m deep, in waves of 4 to 40 m of any direction."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        wave = tmj.model.Wave(0.3, rng.uniform(4, 40), None, rng.uniform(0, 6), rng.uniform(0, 6))
        b, length = rng.normal(size=3), rng.uniform(2, 30)
        top = (rng.uniform(-9, 9), rng.uniform(-9, 9), -1.2 - max(0.0, length * b[2] / np.linalg.norm(b)))
        yield wave, top, b, length


@pytest.mark.third_means("water.immerse by segments", by="inertia of an inclined rod in closed form")
def test_inertia_of_inclined_rods_errs_by_no_more_than_its_bound_and_falls_with_the_square_of_segments() -> None:
    worst = {"force": 0.0, "moment": 0.0}
    for wave, start, b, length in inclined_rods(60):
        kappa = 2 * np.pi / wave.wavelength * length
        errors = []
        for n in (5, 10, 40, 80):
            water = tmj.Water(waves=(wave,), drag=0.0, added_mass=0.3, segments=n)
            scene = rod_scene(start, b, length, water)
            force, moment = force_and_moment(scene, 1.3)
            still = force_and_moment(scene.with_(water=replace(water, waves=())), 1.3)  # buoyancy, in the centre
            exact, turning, largest = of_inertia(scene, 1.3, 1.3)
            parts = [
                np.linalg.norm(force - still[0] - exact) / largest,
                np.linalg.norm(moment - still[1] - turning) / (largest * length / 2),
            ]
            surface = kappa**2 / 12 / n**2
            inertia = kappa**2 / 24 / n**2, kappa * (kappa + 4) / 24 / n**2
            found = scene.water_segments.force_error, scene.water_segments.moment_error
            assert found == pytest.approx([min(2, surface), min(2, max(surface, inertia[1]))], rel=1e-12)
            for (name, most), part, bound in zip(worst.items(), parts, inertia, strict=True):
                assert part <= bound + 1e-12  # round-off: forces up to 1e3 of F̂
                worst[name] = max(most, part / bound)
            errors.append(parts)
        # Of second order: the next term is (κ/2n)²/10 of the first, 2 % at 40 segments of the longest.
        assert np.array(errors[2]) == pytest.approx(4 * np.array(errors[3]), rel=0.1, abs=1e-9)
    assert worst["force"] > 0.6  # the bounds are near what happens
    assert worst["moment"] > 0.3


def drag_along(scene, time):
    """Force, moment and F̂ of ½ ρ C_d d |P u| P u, integrated to 1e-9 between the places where P u is small."""
    water, x = scene.water, scene.nodes0[0]
    length = float(scene.structure.rod_lengths[0])
    b = (scene.nodes0[1] - x) / length

    def flow(s):
        u, place = np.array(water.current, float), x + s * length * b
        for wave in water.waves:
            k = 2 * np.pi / wave.wavelength
            omega = np.sqrt(G * k)
            heading = np.array([np.cos(wave.direction), np.sin(wave.direction), 0.0])
            angle = omega * time + wave.phase - k * (place @ heading)
            u = u + omega * wave.amplitude * np.exp(k * place[2]) * (
                np.sin(angle) * heading + np.cos(angle) * np.array([0.0, 0.0, 1.0])
            )
        return u - b * (b @ u)

    def speed(s):
        """Û: all in phase."""
        total = np.linalg.norm(water.current)
        for wave in water.waves:
            k = 2 * np.pi / wave.wavelength
            total += np.sqrt(G * k) * wave.amplitude * np.exp(k * (x[2] + s * length * b[2]))
        return total

    grid = np.linspace(0, 1, 401)
    speeds = np.array([np.linalg.norm(flow(s)) for s in grid])
    low = grid[1:-1][(speeds[1:-1] < speeds[:-2]) & (speeds[1:-1] <= speeds[2:])]
    factor = 0.5 * RHO * 2 * RADIUS * water.drag * length

    def integral(f):
        return factor * quad(f, 0, 1, points=list(low) or None, limit=400, epsabs=1e-9)[0]

    exact = [
        np.array(
            [integral(lambda s, i=i, p=p: (s - 0.5) ** p * np.linalg.norm(flow(s)) * flow(s)[i]) for i in range(3)]
        )
        for p in (0, 1)
    ]
    return exact[0], exact[1] * length, integral(lambda s: speed(s) ** 2)


@pytest.mark.third_means("water.immerse by segments", by="drag of an inclined rod by quadrature")
@pytest.mark.parametrize("current", [(0.0, 0.0, 0.0), (0.4, -0.3, 0.0)], ids=["still", "current"])
def test_drag_of_inclined_rods_errs_by_no_more_than_its_bound(current) -> None:
    worst = {"force": 0.0, "moment": 0.0}
    for number, (wave, start, b, length) in enumerate(inclined_rods(12, seed=7)):
        more = (tmj.model.Wave(0.1, 0.4 * wave.wavelength, None, 2.0, 1.0),) if number % 3 == 0 else ()
        for n in (6, 25):
            water = tmj.Water(waves=(wave, *more), current=current, inertia=0.0, added_mass=0.0, segments=n)
            scene = rod_scene(start, b, length, water)
            force, moment = force_and_moment(scene, 0.7)
            dry = replace(water, drag=0.0)
            still = force_and_moment(scene.with_(water=dry), 0.7)
            exact, turning, largest = drag_along(scene, 0.7)
            numbers = [2 * np.pi / one.wavelength * length for one in water.waves]
            speeds = [np.sqrt(G * 2 * np.pi / one.wavelength) * one.amplitude for one in water.waves]
            whole = sum(speeds) + np.linalg.norm(current)
            first = sum(k * u for k, u in zip(numbers, speeds, strict=True)) / whole
            second = sum(k * k * u for k, u in zip(numbers, speeds, strict=True)) / whole
            bound = (2 * second + 2 * first**2) / 24 / n**2
            bounds = bound, bound + 8 * first / 24 / n**2
            assert scene.water_segments.moment_error == pytest.approx(min(2, bounds[1]), rel=1e-12)
            parts = [
                np.linalg.norm(force - still[0] - exact) / largest,
                np.linalg.norm(moment - still[1] - turning) / (largest * length / 2),
            ]
            for (name, most), part, limit in zip(worst.items(), parts, bounds, strict=True):
                assert part <= limit + 1e-9
                worst[name] = max(most, part / limit)
    # |u| u turns while it grows: the bounds take the worst of all directions.
    assert worst["force"] > 0.05
    assert worst["moment"] > 0.02


@pytest.mark.third_means("water.immerse by segments", by="∫ e^{2kz} dz, and ∫ |cos| cos along a wave")
def test_drag_of_upright_and_of_level_rods_in_closed_form() -> None:
    # Upright: P u keeps its direction, ∫ e^{2kz} dz. Level along the wave: P u = w cos θ, and ∫ |cos| cos is
    # x/2 + sin(2x)/4 with the sign of the cosine, from zero to zero.
    wave, n = tmj.model.Wave(0.4, 9.0, phase=0.6), 40
    k = 2 * np.pi / 9
    omega = np.sqrt(G * k)
    water = tmj.Water(waves=(wave,), inertia=0.0, added_mass=0.0, segments=n)
    factor = 0.5 * RHO * 1.2 * 2 * RADIUS * (omega * 0.4) ** 2
    upright = rod_scene((0.0, 0.0, -8.0), (0, 0, 1), 7.0, water)
    expected = factor * abs(np.sin(0.6)) * np.sin(0.6) * (np.exp(-2 * k) - np.exp(-16 * k)) / (2 * k)
    assert abs(force_and_moment(upright, 0.0)[0][0] / expected - 1) <= (7 * k) ** 2 / 6 / n**2

    level = rod_scene((0.0, 0.0, -1.0), (1, 0, 0), 12.0, water)
    turns = np.sort([0.6, 0.6 - 12 * k, *(np.pi * (np.arange(-4, 1) + 0.5))])
    turns = turns[(turns <= 0.6) & (turns >= 0.6 - 12 * k)]
    steps = np.diff(turns / 2 + np.sin(2 * turns) / 4) * np.sign(np.cos(0.5 * (turns[1:] + turns[:-1])))
    buoyancy = DISPLACED * 12 * G
    expected = factor * np.exp(-2 * k) / k * steps.sum()
    largest = factor * np.exp(-2 * k) * 12
    assert abs(force_and_moment(level, 0.0)[0][2] - buoyancy - expected) <= (12 * k) ** 2 / 6 / n**2 * largest


@pytest.mark.third_means("water.immerse by segments", "water._wet_part", by="ρ g d ∫ ζ of low waves")
def test_buoyancy_of_a_rod_in_the_surface_errs_by_the_chords_of_its_wave() -> None:
    # Waves of a thousandth of the radius: the wet part is ½ + (2/π) ζ/R, so that buoyancy is ρ g d ∫ ζ, within (ζ/R)².
    amplitude = 1e-3 * RADIUS
    for n in (5, 10, 20):
        water = tmj.Water(waves=(tmj.model.Wave(amplitude, 6.0),), drag=0.0, inertia=0.0, added_mass=0.0, segments=n)
        scene = rod_scene((0.5, 0.0, 0.0), (1, 0, 0), 7.5, water)
        k = 2 * np.pi / 6
        for time in (0.0, 0.3, 0.9):
            angle = np.sqrt(G * k) * time - k * np.array([0.5, 8.0])
            expected = RHO * G * 2 * RADIUS * amplitude * (np.cos(angle[1]) - np.cos(angle[0])) / k
            largest = RHO * G * 2 * RADIUS * amplitude * 7.5
            found = force_and_moment(scene, time)[0][2] - DISPLACED * 7.5 * G / 2
            error = abs(found - expected) / largest
            assert error <= (7.5 * k) ** 2 / 12 / n**2 + 1e-5
            # Each chord is low by k² A h²/12 in the mean, of what there is.
            assert error == pytest.approx(abs(expected) / largest * (k * 7.5 / n) ** 2 / 12, rel=0.1, abs=1e-5)


def accelerations(scene, engine, time=0.0):
    request = request_for(scene, None, None, None, OnInfeasible.STOP, None, False)
    return engine.accelerations(request)(time, scene.nodes0, scene.velocities0)[1]


def exact_turning(time):
    """φ̈ [rad/s²] of `long_rod` in closed form: m ℓ²/12 + C_a m' ℓ³/12 against the moments of inertia and drag."""
    k, length = 2 * np.pi / 15, 20.0
    omega = np.sqrt(G * k)
    inertia = of_inertia(long_rod(), time, 2.0)[1][2]
    # Drag: |cos θ| cos θ, θ = ω t - k x, and x times it, from zero to zero of the cosine.
    ends = omega * time - k * np.array([length, 0.0])
    zeros = np.pi * (np.arange(-9, 9) + 0.5)
    angles = np.sort([*ends, *zeros[(zeros > ends[0]) & (zeros < ends[1])]])
    signs = np.sign(np.cos(0.5 * (angles[1:] + angles[:-1])))
    x = (omega * time - angles) / k - length / 2
    # ∫ x cos² θ dx = x²/4 - x sin 2θ / 4k + cos 2θ / 8k², as dθ = -k dx.
    F = x**2 / 4 - x * np.sin(2 * angles) / (4 * k) + np.cos(2 * angles) / (8 * k**2)
    drag = 0.5 * RHO * 1.2 * 2 * RADIUS * (omega * 0.5 * np.exp(-k)) ** 2 * np.sum(signs * (F[:-1] - F[1:]))
    return (inertia + drag) / (1500.0 * length**2 / 12 + DISPLACED * length**3 / 12)


@pytest.mark.third_means("water.immerse by segments", by="its angular acceleration in closed form")
@pytest.mark.parametrize("engine", [tmj.DAE(), tmj.MuJoCo()], ids=["DAE", "MuJoCo"])
def test_a_rod_longer_than_its_wave_turns_as_in_closed_form(engine) -> None:
    # The bounds of both loads, and of the added mass, 1/n² of the moment of inertia.
    k = 2 * np.pi / 15
    kappa, depth, omega = 20 * k, np.exp(-k), np.sqrt(G * k)
    times = 2 * np.pi / omega * np.arange(8) / 8
    exact = np.array([exact_turning(t) for t in times])
    moment_of_inertia = 1500.0 * 400 / 12 + DISPLACED * 8000 / 12
    for segments in (None, 5):
        scene = long_rod(segments)
        n = scene.water_segments.count
        a = np.array([accelerations(scene, engine, t)[:, 2] for t in times])
        error = np.abs((a[:, 1] - a[:, 0]) / 20 - exact)
        inertia = 2 * DISPLACED * 20 * omega**2 * 0.5 * depth * kappa * (kappa + 4) / 24 / n**2
        drag = 0.5 * RHO * 1.2 * 2 * RADIUS * 20 * (omega * 0.5 * depth) ** 2 * kappa * (kappa + 2) / 6 / n**2
        assert np.all(error <= (inertia + drag) * 10 / moment_of_inertia + np.abs(exact) / n**2 * 1.05)
        largest = np.max(error) / np.max(np.abs(exact))
        assert largest < 0.01 if segments is None else largest > 0.3, largest


def test_the_number_is_chosen_from_the_waves_and_what_was_given_is_kept() -> None:
    # κ (κ + 2) / 6 n² = 0.01 for κ = 8.378: n = 38.07.
    chosen = long_rod().water_segments
    assert (chosen.count, chosen.chosen, chosen.needed, chosen.warnings) == (39, True, 39, ())
    assert chosen.moment_error == pytest.approx(8.37758 * 10.37758 / 6 / 39**2, rel=1e-5)
    assert chosen.force_error == pytest.approx(8.37758**2 / 6 / 39**2, rel=1e-5)
    given = long_rod(5).water_segments
    assert (given.count, given.chosen, given.needed) == (5, False, 39)
    (warning,) = given.warnings
    assert "segments = 5 are too few for the waves along rod 'rod' of 20 m" in warning
    assert "58 % of the largest; give segments = 39 or leave segments out, for 1 %" in warning
    assert long_rod(20).water_segments.warnings == ()  # 3.6 %: more than is chosen, not more than is warned of
    # The longest rod decides; the current is part of the drag; of small chop on a swell little depends.
    water = tmj.Water(waves=(tmj.model.Wave(0.5, 15.0),))

    def count(**change):
        return rod_scene((0, 0, -1), (0, 1, 0), 20.0, replace(water, **change)).water_segments.count

    assert count() == 39
    assert count(current=(2.0, 0, 0)) < 39
    assert count(drag=0.0) == 25  # the surface: κ²/12 n² = 0.01, n = 24.18, against κ (κ + 4)/24 of inertia
    assert count(waves=(tmj.model.Wave(0.5, 60.0),)) == 12  # κ = 2.094: n = 11.95
    swell = count(waves=(tmj.model.Wave(1.0, 150.0),), current=(1.0, 0.0, 0.0))
    assert swell < count(waves=(tmj.model.Wave(1.0, 150.0), tmj.model.Wave(0.02, 3.0)), current=(1.0, 0.0, 0.0)) < 84
    assert count(waves=()) == count(waves=(tmj.model.Wave(0.0, 0.01),)) == 5
    shallow = count(depth=1.5)
    assert shallow == 39  # of one wave, κ alone decides


def test_there_is_a_limit_that_is_reported() -> None:
    sea = tmj.Water(waves=(tmj.model.Wave(0.01, 1.0),))
    capped = rod_scene((0, 0, -1), (1, 0, 0), 20.0, sea).water_segments
    assert (capped.count, capped.chosen) == (200, True)
    assert capped.needed == 518  # κ (κ + 2)/6 = 0.01 n², κ = 125.66
    assert "segments = 200, the most that are chosen, are too few" in capped.warnings[0]
    assert "6.68 % of the largest; give segments = 518, for 1 %" in capped.warnings[0]
    beyond = rod_scene((0, 0, -1), (1, 0, 0), 20.0, replace(sea, waves=(tmj.model.Wave(1e-3, 0.01),))).water_segments
    assert (beyond.count, beyond.needed, beyond.force_error, beyond.moment_error) == (200, None, 2.0, 2.0)
    assert "give segments = 1000, the most there may be" in beyond.warnings[0]
    enough = replace(sea, segments=518)
    assert rod_scene((0, 0, -1), (1, 0, 0), 20.0, enough).water_segments.warnings == ()


def test_shipped_scenes_and_towers_keep_their_five() -> None:
    for scene in (tmj.load_scene("tower_waves"), tmj.load_scene("shape_control"), tower_in_waves(stages=3)):
        assert scene.water.segments is None
        assert scene.water_segments.count == 5
        assert not scene.water_segments.warnings
    assert tower_in_waves(stages=3, wavelength=5.0).water_segments.count == 10
    assert beam_in_waves("TB1", 4.0).water_segments.warnings == ()
    assert beam_in_waves("TB1", 4.0, segments=None).water_segments.count == 5
    assert "7.69 % of the largest" in beam_in_waves("TB1", 1.0).water_segments.warnings[0]


def described(run):
    return describe_run(summary(run) | {"out": None, "video": None, "plot": None, "web": None})


def test_runs_files_and_commands_report_it(tmp_path) -> None:
    run = tmj.simulate(long_rod(), engine=tmj.DAE(), duration=0.05)
    reported = run.reports["water"]["segments"]
    assert (reported["count"], reported["chosen"], reported["needed"]) == (39, True, 39)
    assert reported["moment_error_bound"] == long_rod().water_segments.moment_error
    assert json.loads(json.dumps(reported)) == reported
    again = tmj.Trajectory.load(run.save(tmp_path / "long.nc"))
    assert again.reports["water"]["segments"] == reported
    assert again.scene.water.segments is None
    assert "39 segments a rod, chosen" in described(run)
    assert not any("segments" in warning for warning in run.reports["warnings"])
    few = tmj.simulate(long_rod(5), engine=tmj.DAE(), duration=0.05)
    assert [w for w in few.reports["warnings"] if "segments = 5 are too few" in w] == list(
        long_rod(5).water_segments.warnings
    )
    assert "5 segments a rod, given" in described(few)
    found = describe(long_rod())
    assert "39 segments a rod, chosen: wave loads within 0.95 % of the largest" in found["water"]
    assert found["water_segments"] == reported
    assert "are too few for the waves" in describe(long_rod(5))["water"]
    for scene in (long_rod(), long_rod(5)):
        text = scene_to_toml(scene)
        assert ("segments" in text) == (scene.water.segments is not None)
        assert scene_from_toml(text) == scene
