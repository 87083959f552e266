"""Strings, actuation, loads and moved supports against formulas by hand, in both engines.

MuJoCo and the DAE call the same compiled functions for these, so that their agreement says nothing of them. Here a
mass of 1.5 kg hangs on one string from a hook, and moves as an oscillator does: what is expected is written in NumPy
from Newton's law and calls nothing of the package. The table in
docs/developing/third-means.md lists which function is checked where.

Tolerances: the DAE's error control, 1e-12 of a step, grows to 1e-10 over the run; RK4 at h = 1 ms errs by
(ω h)⁴ ω T / 120 of the amplitude, for ω <= 7 rad/s and T <= 2 s by 3e-10. 2e-9 m of motions of 0.1 m and more is both
with a margin, and 5e5 times less than a hundredth of the motion. Forces are k times that, energies their largest force
times that.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

import tensegrity_mj as tmj

G, M, K = 9.81, 1.5, 60.0
OMEGA = np.sqrt(K / M)
CLOSE = 2e-9  # m
FINE = [tmj.DAE(rtol=1e-12, atol=1e-13), tmj.MuJoCo(1e-3)]
LOCATED = [tmj.DAE(method=tmj.Method.RK4, timestep=1e-3, locate_slack=True), tmj.MuJoCo(1e-3, locate_slack=True)]
pytestmark = pytest.mark.third_means(
    "plant.write_row", "vectors.*", "pointers.*", "elements.clear", by="rows and parts of its formulas"
)
both = pytest.mark.parametrize("engine", FINE, ids=["DAE", "MuJoCo"])


def hung(length=1.4, damping=0.0, rate=0.0, law=tmj.model.StringLaw.CLIPPED, limits=None, hook=True, **scene):
    """The mass `length` below the hook, moving down at `rate`; the string's rest length is 1 m."""
    nodes = {"hook": (0.0, 0.0, 0.0), "m": (0.0, 0.0, -length)}
    structure = tmj.Structure(
        "hung",
        nodes,
        strings=(tmj.String("s", ("hook", "m"), K, damping, rest_length=1.0, **(limits or {})),),
        fixed_nodes=("hook",),
        point_masses=(tmj.PointMass("m", M),),
        string_law=law,
    )
    if rate:
        scene["initial_velocities"] = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -rate]])
    return tmj.Scene(structure, gravity=(0.0, 0.0, -G), **({"duration": 2.0} | scene))


def oscillation(t, stretch, rate, damping=0.0, stiffness=K, pull=M * G):
    """s and ṡ of M s̈ = pull - k s - c ṡ from s and ṡ at t = 0; under critical damping."""
    delta, rest = damping / (2 * M), pull / stiffness
    omega = np.sqrt(stiffness / M - delta**2)
    a, b = stretch - rest, (rate + delta * (stretch - rest)) / omega
    fade, c, s = np.exp(-delta * t), np.cos(omega * t), np.sin(omega * t)
    return rest + fade * (a * c + b * s), fade * ((b * omega - delta * a) * c - (a * omega + delta * b) * s)


class Command:
    """A law that is a function of time and the string's length."""

    def __init__(self, function, command=tmj.Command.REST_LENGTH):
        self.function, self.command = function, command

    def __call__(self, time, nodes, velocities):
        return [self.function(time, nodes[0, 2] - nodes[1, 2])]


# The string


@pytest.mark.third_means(
    "strings.measure_strings",
    "strings.tighten_strings",
    "strings.add_string_forces",
    by="a damped oscillator: motion, tension, energy, loss",
)
@both
def test_a_mass_on_a_damped_string_is_a_damped_oscillator(engine) -> None:
    c = 0.8
    run = tmj.simulate(hung(1.4, c), engine=engine)
    s, rate = oscillation(run.time, 0.4, 0.0, c)
    assert s.min() > 0.01  # taut
    assert np.abs(run.nodes[:, 1, 2] + 1 + s).max() < CLOSE
    assert np.abs(run.velocities[:, 1, 2] + rate).max() < 7 * CLOSE
    assert np.abs(run.tensions[:, 0] - K * s - c * rate).max() < K * CLOSE
    assert np.abs(run.force_densities[:, 0] - K * s / (1 + s)).max() < K * CLOSE
    assert np.abs(run.string_energy - 0.5 * K * s**2).max() < 24 * CLOSE
    # What is gone from ½ m ṡ² + ½ k s² - m g s is lost: forces of up to 24 N along it.
    energy = 0.5 * M * rate**2 + 0.5 * K * s**2 - M * G * s
    assert np.abs(run.dissipation - (energy[0] - energy)).max() < 50 * CLOSE
    assert run.dissipation[-1] > 0.4
    assert not run.winch_work.any()


@pytest.mark.third_means(
    "slack.*",
    "strings.tighten_strings where it clips, or lets the damper push",
    by="free flight and oscillator, joined where the pull is zero: 2 v/g, and the root of k s + c ṡ",
)
@pytest.mark.parametrize("engine", LOCATED, ids=["DAE", "MuJoCo"])
@pytest.mark.parametrize("law", list(tmj.model.StringLaw), ids=lambda law: law.value)
def test_a_mass_thrown_up_falls_into_its_string_and_leaves_it(engine, law) -> None:
    # Up at 3.5 m/s from where the string is just slack; back at 2 v/g with v downwards, which the damper meets with a
    # jump of c v; then the oscillator. Clipped, it leaves where k s + c ṡ is zero, which is no jump, and is free until
    # that is positive again. Unclipped, the damper pushes until s = 0: a jump that no engine places, where this ends.
    c, v, clipped = 1.5, 3.5, law is tmj.model.StringLaw.CLIPPED
    scene = hung(1.0, c, -v, law, duration=1.9)
    run = tmj.simulate(scene, engine=engine, output_interval=1e-3)

    def pull(s, rate):
        return K * s + c * rate

    grid = np.linspace(1e-3, 1.0, 1000)
    s, rate = oscillation(grid, 0.0, v, c)
    first = int(np.argmax((pull(s, rate) if clipped else s) < 0))
    left = brentq(lambda t: pull(*oscillation(t, 0.0, v, c)), 0.5 * grid[first], grid[first], xtol=1e-14)
    caught, t = 2 * v / G, run.time
    s_left, rate_left = oscillation(left, 0.0, v, c)
    after = t - caught - left
    free, speed = s_left + rate_left * after + 0.5 * G * after**2, rate_left + G * after
    end = caught + grid[first] - 1e-3
    if clipped:
        end = t[np.argmax((after > 1e-3) & (pull(free, speed) > 0))] - 1e-3
    flight, taut = t < caught, (t >= caught) & (t < caught + left if clipped else t < end)
    later = clipped & (after >= 0) & (t < end)
    assert min(flight.sum(), taut.sum()) > 100
    assert later.sum() > 100 or not clipped
    s, rate = oscillation(t - caught, 0.0, v, c)
    expected = np.where(flight, -v * t + 0.5 * G * t**2, np.where(taut, s, free))
    kept = flight | taut | later
    # The jump is placed within 1e-8 of a step: c v/M 1e-11 s of speed, 4e-11 m/s; the kink within 1e-2 of it, with
    # k v/M h² 1e-4, 1e-8 m/s: over 0.2 s, 2e-9 m.
    assert np.abs(run.nodes[:, 1, 2] + 1 + expected)[kept].max() < 5 * CLOSE
    assert not run.tensions[flight | later].any()
    # Rows of the steps in which the string comes taut or slack may be of either kind.
    assert np.abs(run.tensions[:, 0] - pull(s, rate))[taut][2:-2].max() < 10 * K * CLOSE
    assert (run.tensions[taut].min() < -1) == (not clipped)
    plain = tmj.simulate(scene, engine=dataclasses.replace(engine, locate_slack=False), output_interval=1e-3)
    # Without, the damper's jump of 3.5 m/s² is off by a part of a step.
    assert np.abs(plain.nodes[:, 1, 2] + 1 + expected)[kept].max() > 100 * CLOSE


@pytest.mark.third_means("actuation.break_strings", by="oscillator, then free fall; ½ k s² is lost")
@both
def test_a_string_that_breaks_lets_go_and_its_energy_is_lost(engine) -> None:
    run = tmj.simulate(hung(1.4, breaks=(tmj.model.Break("s", 0.5),), duration=0.8), engine=engine)
    s, rate = oscillation(0.5, 0.4, 0.0)
    after = np.maximum(run.time - 0.5, 0.0)
    expected = np.where(run.time <= 0.5, oscillation(run.time, 0.4, 0.0)[0], s + rate * after + 0.5 * G * after**2)
    assert np.abs(run.nodes[:, 1, 2] + 1 + expected).max() < CLOSE
    assert run.dissipation[-1] == pytest.approx(0.5 * K * s**2, abs=24 * CLOSE)
    assert not run.tensions[run.time > 0.5].any()


# Actuation


@pytest.mark.third_means(
    "actuation.evaluate_law",
    "actuation.set_rest_lengths",
    "actuation.winch_work",
    "actuation.start_ledger",
    "strings.string_energy",
    by="a driven oscillator; -∫ T dL0 by quadrature",
)
@both
def test_a_winch_that_follows_a_law_drives_an_oscillator_and_works(engine) -> None:
    # L0 = 1 + b sin Ω t: M L̈ = M g - k (L - L0), so that L is 1 + M g/k and b ω²/(ω² - Ω²) (sin Ω t - Ω/ω sin ω t).
    b, drive = 0.1, 3.0
    start = 1 + M * G / K
    run = tmj.simulate(hung(start), Command(lambda t, L: 1 + b * np.sin(drive * t)), engine)
    size = b * OMEGA**2 / (OMEGA**2 - drive**2)

    def length(t):
        return start + size * (np.sin(drive * t) - drive / OMEGA * np.sin(OMEGA * t))

    assert np.abs(run.nodes[:, 1, 2] + length(run.time)).max() < CLOSE
    assert np.abs(run.rest_lengths[:, 0] - 1 - b * np.sin(drive * run.time)).max() < 1e-12

    def power(t):
        tension = K * (length(t) - 1 - b * np.sin(drive * t))
        assert tension > 0
        return -tension * b * drive * np.cos(drive * t)

    for row in (50, 123, 200):
        work = quad(power, 0, run.time[row], epsabs=1e-12, limit=200)[0]
        assert run.winch_work[row] == pytest.approx(work, abs=30 * CLOSE)
    assert np.ptp(run.winch_work) > 0.5


@pytest.mark.third_means(
    "actuation.evaluate_law", "actuation.command_as_lengths", "actuation.set_rest_lengths", by="M L̈ = M g - u L"
)
@both
def test_a_force_density_is_a_spring_of_no_length(engine) -> None:
    # T = u L: M L̈ = M g - u L, whatever the string's stiffness; L0 = L (1 - u/k).
    u = 20.0
    run = tmj.simulate(hung(1.2), Command(lambda t, L: u, tmj.Command.FORCE_DENSITY), engine)
    length = M * G / u + (1.2 - M * G / u) * np.cos(np.sqrt(u / M) * run.time)
    assert length.min() > 0.1
    assert np.abs(run.nodes[:, 1, 2] + length).max() < CLOSE
    assert np.abs(run.rest_lengths[:, 0] - length * (1 - u / K)).max() < CLOSE
    assert np.abs(run.tensions[:, 0] - u * length).max() < u * CLOSE


def sampled(times, length, rate, period, renew):
    """L and the energy of a mass; at each sample, `renew(L, number)` gives ('L0', value) or ('u', value)."""
    found, energy, kinds = [], [], []
    for t in times:
        number = int(t / period + 1e-9)
        while len(kinds) <= number:
            if kinds:
                length, rate = piece(kinds[-1], length, rate, period)
            kinds.append(renew(length, len(kinds)))
        L, dL = piece(kinds[number], length, rate, t - number * period)
        kind, value = kinds[number]
        tension = value * L if kind == "u" else K * max(0.0, L - value)
        found.append(L)
        energy.append(0.5 * M * dL**2 - M * G * L + 0.5 * tension**2 / K)
    return np.array(found), np.array(energy)


def piece(kind, length, rate, t):
    """L and its rate after a time t with one command."""
    if kind[0] == "u":
        return oscillation(t, length, rate, stiffness=kind[1])
    s, ds = oscillation(t, length - kind[1], rate)
    return kind[1] + s, ds


@pytest.mark.third_means(
    "actuation.take_sample",
    "actuation.winch_work",
    "actuation._held_work",
    "strings.string_energy",
    by="an oscillator from sample to sample, and the energy gained between them",
)
@both
@pytest.mark.parametrize("held", ["force density", "rest length"])
def test_what_a_sampled_law_commands_is_held_and_its_winch_works(engine, held) -> None:
    # u = 15 + 10 (L - 1), sampled each 50 ms: an oscillator from sample to sample. Where u is held, its stiffness is u
    # and its rest length 0; where the rest length is, k and L (1 - u/k) of the sample. Nothing is lost, so that the
    # winch's work is what the energy gains, jumps at samples included, from the first sample on.
    period = 0.05
    actuation = (
        tmj.Actuation.hold_force_density(period) if held == "force density" else tmj.Actuation.hold_rest_length(period)
    )

    def u(L):
        return 15 + 10 * (L - 1)

    law = Command(lambda t, L: u(L), tmj.Command.FORCE_DENSITY)
    run = tmj.simulate(hung(1.25), law, engine, actuation=actuation, output_interval=0.025, duration=1.5)

    def renew(L, number):
        return ("u", u(L)) if held == "force density" else ("L0", L * (1 - u(L) / K))

    length, energy = sampled(run.time, 1.25, 0.0, period, renew)
    assert np.abs(run.nodes[:, 1, 2] + length).max() < CLOSE
    assert np.abs(run.winch_work - (energy - energy[0])).max() < 50 * CLOSE
    assert np.ptp(run.winch_work) > 0.1


@pytest.mark.third_means("actuation._limit_command", by="oscillators of the limits")
@both
def test_limits_cut_what_a_law_commands(engine) -> None:
    # The largest force density, 12 of 20 N/m: a spring of 12 N/m. The smallest rest length, 0.9 of 0.5 m: an oscillator
    # about 0.9 m. The winch's speed, 0.8 m/s: 4 cm each 50 ms, from 1 m to 0.8 m.
    dense = Command(lambda t, L: 20.0, tmj.Command.FORCE_DENSITY)
    run = tmj.simulate(hung(1.25, limits={"max_force_density": 12.0}), dense, engine)
    length = M * G / 12 + (1.25 - M * G / 12) * np.cos(np.sqrt(12 / M) * run.time)
    assert np.abs(run.nodes[:, 1, 2] + length).max() < CLOSE
    run = tmj.simulate(hung(1.25, limits={"min_rest_length": 0.9}), Command(lambda t, L: 0.5), engine)
    assert np.abs(run.nodes[:, 1, 2] + 0.9 + oscillation(run.time, 0.35, 0.0)[0]).max() < CLOSE
    run = tmj.simulate(
        hung(1.25, limits={"winch_speed": 0.8}),
        Command(lambda t, L: 0.8),
        engine,
        actuation=tmj.Actuation.hold_rest_length(0.05),
        output_interval=0.025,
    )
    length, _ = sampled(run.time, 1.25, 0.0, 0.05, lambda L, n: ("L0", max(0.8, 1 - 0.04 * (n + 1))))
    assert np.abs(run.nodes[:, 1, 2] + length).max() < CLOSE


@pytest.mark.third_means("actuation.remember", by="an oscillator from then on")
@both
def test_where_a_law_has_no_solution_the_last_rest_length_is_held(engine) -> None:
    def function(t, L):
        if t > 0.3 - 1e-9:
            raise tmj.errors.InfeasibleError("no more")
        return 12.0 + 5 * t

    # Sampled: at 0.3 s, with no solution, the rest length of that moment is held.
    law = Command(function, tmj.Command.FORCE_DENSITY)
    options = {"on_infeasible": tmj.OnInfeasible.PASSIVE, "duration": 1.0, "output_interval": 0.025}
    run = tmj.simulate(hung(1.25), law, engine, actuation=tmj.Actuation.hold_force_density(0.05), **options)
    at = {}

    def renew(L, number):
        if number < 6:
            at["u"] = 12 + 0.25 * number
            return "u", at["u"]
        return "L0", at.setdefault("L0", L * (1 - at["u"] / K))

    length, _ = sampled(run.time, 1.25, 0.0, 0.05, renew)
    assert np.abs(run.nodes[:, 1, 2] + length).max() < CLOSE


@pytest.mark.third_means("actuation.remember", by="an oscillator from then on")
@pytest.mark.parametrize(
    "engine", [tmj.DAE(method=tmj.Method.RK4, timestep=1e-3), tmj.MuJoCo(1e-3)], ids=["DAE", "MuJoCo"]
)
def test_a_law_at_every_stage_leaves_the_rest_length_of_the_last_whole_step(engine) -> None:
    # L0 = 0.9 + 0.2 t until 0.3 s, which the law cannot answer any more; then L0 of 0.299 s, the start of the step.
    # That step itself is made with what lies between: 0.2 h off over h, a speed of ω² 0.2 h² and a swing of 0.2 h² ω.
    def function(t, L):
        if t > 0.3 - 1e-9:
            raise tmj.errors.InfeasibleError("no more")
        return 0.9 + 0.2 * t

    run = tmj.simulate(
        hung(1.3), Command(function), engine, on_infeasible=tmj.OnInfeasible.PASSIVE, duration=1.0, output_interval=0.02
    )

    def ramp(t):
        s, rate = oscillation(t, 0.4, 0.0)
        return 0.9 + s + 0.2 * (t - np.sin(OMEGA * t) / OMEGA), rate + 0.2 * (1 - np.cos(OMEGA * t))

    stop = 0.299
    L, rate = ramp(stop)
    later = 0.9598 + oscillation(np.maximum(run.time - stop, 0), L - 0.9598, rate)[0]
    expected = np.where(run.time <= stop, ramp(run.time)[0], later)
    assert np.abs(run.nodes[:, 1, 2] + expected).max() < 0.2e-6 * OMEGA
    assert np.abs(run.rest_lengths[run.time > 0.305, 0] - 0.9598).max() < 1e-12


# Loads and moved supports


@pytest.mark.third_means(
    "elements.let_act", "elements.power_of", "elements._counted", by="M ẍ = F cos(ω t + φ) in closed form, and its work"
)
@both
@pytest.mark.parametrize("as_function", [False, True], ids=["records", "function"])
def test_a_load_in_time_and_gravity_move_a_free_mass(engine, as_function) -> None:
    # M ẍ = F cos(ω t + φ): x = F/(M ω²) (cos φ - cos(ω t + φ) - ω t sin φ); and it falls.
    F, omega, phi = np.array([3.0, -2.0, 1.0]), 4.0, 0.7
    structure = tmj.Structure("free", {"m": (0.0, 0.0, 0.0)}, point_masses=(tmj.PointMass("m", M),))
    loads = (lambda t: [F * np.cos(omega * t + phi)]) if as_function else (tmj.model.Load("m", tuple(F), omega, phi),)
    run = tmj.simulate(tmj.Scene(structure, gravity=(0, 0, -G), loads=loads, duration=2.0), engine=engine)
    t = run.time[:, None]
    moved = F / (M * omega**2) * (np.cos(phi) - np.cos(omega * t + phi) - omega * t * np.sin(phi))
    expected = moved + 0.5 * np.array([0, 0, -G]) * t**2
    assert np.abs(run.nodes[:, 0] - expected).max() < CLOSE
    rate = F / (M * omega) * (np.sin(omega * t + phi) - np.sin(phi)) + np.array([0, 0, -G]) * t
    work = 0.5 * M * np.sum(rate**2, axis=1) + M * G * expected[:, 2]
    assert np.abs(run.external_work - work).max() < 100 * CLOSE  # forces of 15 N, and speeds of 20 m/s
    assert np.abs(run.gravity_energy - M * G * expected[:, 2]).max() < 20 * CLOSE


@pytest.mark.third_means("elements.set_motions", "motion.motion_at", by="a driven oscillator, and the work of the hook")
@both
def test_a_hook_that_moves_up_and_down_drives_an_oscillator(engine) -> None:
    # z_h = a sin(Ω t + ε): M z̈ = -M g + k (z_h - z - 1), z = -1 - M g/k + p sin(Ω t + ε) and the oscillator's own.
    a, drive, phase = 0.05, 3.0, 0.4
    motion = tmj.model.Motion("hook", (tmj.model.Harmonic((0.0, 0.0, a), drive, phase),))
    scene = hung(1 + M * G / K, motions=(motion,))
    run = tmj.simulate(scene, engine=engine)
    t = run.time
    z_h = a * np.sin(drive * t + phase)
    assert np.abs(run.nodes[:, 0, 2] - z_h).max() < 1e-12
    assert np.abs(run.velocities[:, 0, 2] - a * drive * np.cos(drive * t + phase)).max() < 1e-12
    p = a * OMEGA**2 / (OMEGA**2 - drive**2)
    start, speed = run.nodes[0, 1, 2] + 1 + M * G / K, run.velocities[0, 1, 2]
    x, y = start - p * np.sin(phase), (speed - p * drive * np.cos(phase)) / OMEGA
    moved = p * np.sin(drive * t + phase) + x * np.cos(OMEGA * t) + y * np.sin(OMEGA * t)
    assert np.abs(run.nodes[:, 1, 2] + 1 + M * G / K - moved).max() < CLOSE
    # The hook works against the pull: all that the mass gains.
    gained = (
        0.5 * M * run.velocities[:, 1, 2] ** 2
        + M * G * run.nodes[:, 1, 2]
        + 0.5 * K * (z_h - run.nodes[:, 1, 2] - 1) ** 2
    )
    assert np.abs(run.external_work - (gained - gained[0])).max() < 50 * CLOSE


@pytest.mark.third_means("motion._add_piece", "motion.piece_at", by="10 x³ - 15 x⁴ + 6 x⁵")
@both
def test_a_hook_that_follows_data_does_so_by_quintics(engine) -> None:
    # From rest to rest in 1.5 s: d (10 x³ - 15 x⁴ + 6 x⁵); then it stands still.
    d = np.array([0.2, -0.1, 0.05])
    motion = tmj.model.Motion.data("hook", [0.25, 1.75], [np.zeros(3), d])
    run = tmj.simulate(hung(1 + M * G / K, motions=(motion,)), engine=engine)
    x = np.clip((run.time - 0.25) / 1.5, 0, 1)[:, None]
    assert np.abs(run.nodes[:, 0] - d * (10 * x**3 - 15 * x**4 + 6 * x**5)).max() < 1e-12
    assert np.abs(run.velocities[:, 0] - d * 30 * x**2 * (1 - x) ** 2 / 1.5).max() < 1e-12


@pytest.mark.third_means("motion._add_piece", "motion.piece_at", by="g tan φ of a plumb line")
@both
def test_a_rod_on_an_accelerated_support_hangs_aside(engine) -> None:
    # A support that accelerates evenly along x by g tan φ, as quintic data do: a rod that starts at φ stays there.
    phi, length = 0.3, 0.7
    b = np.array([-np.sin(phi), 0.0, -np.cos(phi)])
    rod = tmj.Rod("rod", ("a", "b"), M, 0.01, tmj.Support.pinned(0.0))
    structure = tmj.Structure("car", {"a": (0.0, 0.0, 0.0), "b": tuple((length * b).tolist())}, (rod,))
    a = G * np.tan(phi)
    times = np.array([0.0, 0.5, 1.0, 2.0])
    along = np.array([1.0, 0.0, 0.0])
    motion = tmj.model.Motion.data(
        "rod", times, np.outer(0.5 * a * times**2, along), np.outer(a * times, along), np.outer(a + 0 * times, along)
    )
    scene = tmj.Scene(structure, gravity=(0, 0, -G), motions=(motion,), duration=1.0)
    run = tmj.simulate(scene, engine=engine)
    assert np.abs(run.nodes[:, 0] - np.outer(0.5 * a * run.time**2, along)).max() < 1e-12
    assert np.abs(run.nodes[:, 1] - run.nodes[:, 0] - length * b).max() < CLOSE
    assert run.external_work[-1] == pytest.approx(0.5 * M * (a * 1.0) ** 2, abs=50 * CLOSE)


@both
def test_arrays_of_any_order_mean_the_same(engine) -> None:
    # Columns after each other in memory, as a transpose has them, and one row for all, as broadcasting makes it.
    nodes = {"hook": (0.1, 0.2, 0.3), "m": (0.3, 0.1, -1.0)}
    base = hung().structure
    structure = tmj.Structure(
        "aside", nodes, strings=base.strings, fixed_nodes=base.fixed_nodes, point_masses=base.point_masses
    )
    rates = np.array([[0.0, 0.0, 0.0], [0.3, 0.2, 0.1]])
    scene = tmj.Scene(structure, gravity=(0.0, 0.0, -G), initial_velocities=rates)
    swapped = scene.with_(
        initial_nodes=np.asfortranarray(scene.nodes0), initial_velocities=np.ascontiguousarray(rates.T).T
    )
    runs = [tmj.simulate(one, engine=engine, duration=0.2) for one in (scene, swapped)]
    assert np.array_equal(runs[0].nodes, runs[1].nodes)


@pytest.mark.parametrize("engine", [*FINE, tmj.ODE(rtol=1e-12, atol=1e-13)], ids=["DAE", "MuJoCo", "ODE"])
@pytest.mark.parametrize("usual", list(tmj.model.StringLaw), ids=lambda law: law.value)
def test_clipped_and_unclipped_strings_in_one_structure(engine, usual) -> None:
    """Masses of 1 kg on strings with critical dampers, s = (s₀ + (v₀ + ω s₀) t) e^(-ω t); nothing else acts.

    One mass of either law is let go, and no damper pushes until t = 1/ω, where this ends. The others are thrown at
    their anchors by ω s₀, so that s = s₀ e^(-ω t) under a pull of -k s: unclipped. Clipped, they fly at -ω s₀. No
    string has a kink on the way, so that RK4 errs by (ω h)⁴ of it or less.
    """
    omega, stretch, laws = 10.0, 0.1, ("clipped", "unclipped")
    cases = [(law, thrown) for law in laws for thrown in (False, True)]
    nodes = {f"h{k}": (0.0, float(k), 0.0) for k in range(4)}
    nodes |= {f"m{k}": (1.0 + stretch, float(k), 0.0) for k in range(4)}
    strings = tuple(
        tmj.String(
            f"s{k}",
            (f"h{k}", f"m{k}"),
            omega**2,
            2 * omega,
            rest_length=1.0,
            string_law=None if law == usual.value else law,
        )
        for k, (law, _) in enumerate(cases)
    )
    masses = tuple(tmj.PointMass(f"m{k}", 1.0) for k in range(4))
    fixed = tuple(f"h{k}" for k in range(4))
    structure = tmj.Structure("mixed", nodes, (), strings, fixed, masses, usual)
    assert structure.clipped.tolist() == [True, True, False, False]
    speeds = np.zeros((8, 3))
    speeds[4:, 0] = [-omega * stretch * thrown for _, thrown in cases]
    scene = tmj.Scene(structure, initial_velocities=speeds, duration=1 / omega)
    run = tmj.simulate(scene, engine=engine, output_interval=1e-2)
    t = run.time
    fade = stretch * np.exp(-omega * t)
    let_go = (1 + omega * t) * fade
    s = np.stack([let_go, stretch - omega * stretch * t, let_go, fade], axis=1)
    pulls = omega**2 * np.stack([(1 - omega * t) * fade, 0 * t, (1 - omega * t) * fade, -fade], axis=1)
    assert np.abs(run.nodes[:, 4:, 0] - 1 - s).max() < CLOSE
    # The stretch of the mass that flies ends at 0, where its string goes slack, which changes nothing.
    assert np.abs(run.tensions - pulls).max() < omega**2 * 10 * CLOSE
    assert run.tensions[:, 3].max() < -3.0  # the damper pushes all the way
