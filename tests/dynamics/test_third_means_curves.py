"""Strings with tension curves, that yield, or of constant force, against formulas by hand, in all engines.

As in `test_third_means_strings.py`, a mass of 1.5 kg hangs on one string from a hook. On each piece of a polygon it
is an oscillator M s̈ = M g - T_j - k_j (s - s_j) in closed form; pieces are joined where s passes a corner, and where it
turns on the curve of a string that yields. Nothing of the package is called for it.

Tolerances: error control of 1e-12 a step comes to 1e-10 over the run. RK4 at h = 1 ms with corners located errs between
them by (ω h)⁴ ω T / 120 of the amplitude: for ω <= 12 /s, T = 2 s and 1 m by 4e-9; a corner is located to a part ε of a
step, KINK_LEAST = 1e-6 and up, where it leaves Δk ΔT h² ε / M, less than that. 1e-8 m is both.
"""

from __future__ import annotations

import functools
import itertools

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

import tensegrity_mj as tmj

G, M = 9.81, 1.5
CLOSE = 1e-8  # m
RK4 = tmj.Method.RK4
LOCATED = {
    "DAE RK4": lambda h: tmj.DAE(method=RK4, timestep=h, locate_slack=True),
    "ODE RK4": lambda h: tmj.ODE(method=RK4, timestep=h, locate_slack=True),
    "MuJoCo": lambda h: tmj.MuJoCo(h, locate_slack=True),
}
ENGINES = {
    "DAE": tmj.DAE(rtol=1e-12, atol=1e-13),
    "Radau": tmj.DAE(method=tmj.Method.RADAU, rtol=1e-11, atol=1e-12),
    **{name: make(1e-3) for name, make in LOCATED.items()},
}
every = pytest.mark.parametrize("engine", ENGINES.values(), ids=ENGINES)
STIFFENS = ((0.2, 12.0), (0.4, 20.0), (0.6, 60.0))
GIVES = ((0.2, 30.0), (0.5, 36.0))


def hung(length, rate, duration=2.0, **string):
    """The mass `length` below the hook, moving down at `rate`; the string's rest length is 1 m."""
    string = {"rest_length": 1.0} | string
    structure = tmj.Structure(
        "hung",
        {"hook": (0.0, 0.0, 0.0), "m": (0.0, 0.0, -length)},
        strings=(tmj.String("s", ("hook", "m"), **string),),
        fixed_nodes=("hook",),
        point_masses=(tmj.PointMass("m", M),),
    )
    start = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -rate]])
    return tmj.Scene(structure, gravity=(0.0, 0.0, -G), duration=duration, initial_velocities=start)


def piece_at(points, s):
    """(s_j, T_j, k_j) of the polygon's piece at a stretch; (0, 0, 0) where it is slack."""
    corners = [(0.0, 0.0), *points]
    slopes = [(b[1] - a[1]) / (b[0] - a[0]) for a, b in zip(corners, points, strict=False)]
    place = min(sum(s > a for a, _ in corners), len(slopes)) - 1
    return (*corners[place], slopes[place]) if place >= 0 else (0.0, 0.0, 0.0)


def moved(t, s, v, piece):
    """Stretch and rate after t on a piece."""
    s_j, T_j, k = piece
    if k == 0:
        a = G - T_j / M
        return s + v * t + 0.5 * a * t * t, v + a * t
    omega, rest = np.sqrt(k / M), s_j + (M * G - T_j) / k
    c, d = np.cos(omega * t), np.sin(omega * t)
    return rest + (s - rest) * c + v / omega * d, v * c - (s - rest) * omega * d


def first_root(values, grid, function, falling=False):
    """The first root between points of a grid where its values change their sign, if there is one."""
    change = (values[1:] < 0) & (values[:-1] >= 0) if falling else values[1:] * values[:-1] < 0
    for at in np.flatnonzero(change)[:1]:
        yield brentq(function, grid[at], grid[at + 1], xtol=1e-15, rtol=1e-15)


def joined(times, s, v, points, yields=False):
    """Stretches, rates, tensions and losses at the times, piece by piece; events by the closed form of each piece."""
    t, found, longest = 0.0, [], 0.0
    corners, k = [0.0, *(point[0] for point in points)], points[0][1] / points[0][0]

    def curve(x):
        s_j, T_j, slope = piece_at(points, x)
        return T_j + slope * (x - s_j)

    def loss(x):
        return quad(curve, 0.0, x, points=[c for c in corners if 0 < c < x] or None)[0] - curve(x) ** 2 / (2 * k)

    grid = np.linspace(1e-6, times[-1] + 1e-3, 20001)
    while True:
        ahead = s + 1e-9 * np.sign(v if v else G)
        permanent = longest - curve(longest) / k if longest > 0 else 0.0
        elastic = yields and ahead < longest
        if elastic:
            piece = (permanent, 0.0, k) if ahead > permanent else (0.0, 0.0, 0.0)
            levels = [permanent, longest]
        else:
            piece, levels = piece_at(points, ahead), corners
        path, rates = moved(grid, s, v, piece)
        now = functools.partial(moved, s=s, v=v, piece=piece)
        events = [(times[-1] + 1.0, False)]
        events += [
            (at, False)
            for level in levels
            for at in first_root(path - level, grid, lambda x, c=level, here=now: here(x)[0] - c)
        ]
        if yields and not elastic:
            events += [(at, True) for at in first_root(rates, grid, lambda x, here=now: here(x)[1], falling=True)]
        h, turns = min(events)
        while len(found) < len(times) and times[len(found)] <= t + h:
            x, rate = now(times[len(found)] - t)
            reached = max(longest, x) if yields and not elastic else longest
            lost = loss(reached) if yields and reached > 0 else 0.0
            found.append((x, rate, max(0.0, piece[1] + piece[2] * (x - piece[0])), lost, reached))
        if len(found) == len(times):
            return np.array(found).T
        t, (s, v) = t + h, now(h)
        if turns:
            v = -1e-300
        if yields and not elastic:
            longest = max(longest, s)


@pytest.mark.third_means(
    "curves.curved_pull",
    "curves.curved_energy",
    "curves._polygon",
    "curves._piece",
    "curves._work",
    by="oscillators joined at the corners",
)
@every
def test_a_mass_on_a_polygon_is_an_oscillator_on_each_piece(engine) -> None:
    """Thrown, it passes all corners both ways, leaves its string and falls into it."""
    run = tmj.simulate(hung(1.05, 3.0, curve=STIFFENS), engine=engine)
    s, rate, tension, _, _ = joined(run.time, 0.05, 3.0, STIFFENS)
    assert s.min() < 0
    assert s.max() > 0.6
    assert np.abs(run.nodes[:, 1, 2] + 1 + s).max() < CLOSE
    assert np.abs(run.velocities[:, 1, 2] + rate).max() < 20 * CLOSE
    assert np.abs(run.tensions[:, 0] - tension).max() < 200 * CLOSE
    # The energy of a polygon, by quadrature of the tension.
    fine = np.linspace(0.0, 1.0, 100001)
    pull = np.interp(fine, [0, 0.2, 0.4, 0.6, 1.0], [0, 12, 20, 60, 140])
    energy = np.concatenate([[0.0], np.cumsum(0.5e-5 * (pull[1:] + pull[:-1]))])  # exact: its corners are grid points
    # Between grid points the energy is a parabola: its chord is above it by up to k (1e-5 m)²/8 = 2.5e-9 J.
    assert np.abs(run.string_energy - np.interp(s, fine, energy)).max() < 100 * CLOSE
    assert run.energy_residual < 100 * CLOSE


@pytest.mark.third_means(
    "curves.yield_strings",
    "curves.spent_since",
    "curves._spent",
    "curves.cubic",
    "curves.turn_of_cubic",
    by="oscillators joined where it yields and turns; areas of trapezoids",
)
@every
@pytest.mark.parametrize("points", [GIVES, ((0.2, 30.0), (0.5, 30.0))], ids=["hardens", "stays level"])
def test_a_string_that_yields_is_an_oscillator_between_yields(engine, points) -> None:
    """Loaded, it yields; unloaded and loaded again, it is linear about its permanent stretch; it goes slack at that."""
    run = tmj.simulate(hung(1.05, 4.0, curve=points, yields=True), engine=engine)
    s, rate, tension, lost, longest = joined(run.time, 0.05, 4.0, points, yields=True)
    assert longest[-1] > 0.6
    assert (tension == 0).any()
    assert np.abs(run.nodes[:, 1, 2] + 1 + s).max() < CLOSE
    assert np.abs(run.velocities[:, 1, 2] + rate).max() < 20 * CLOSE
    assert np.abs(run.tensions[:, 0] - tension).max() < 200 * CLOSE
    # ∫ f ds up to the largest stretch less what it gives back: in closed form, by areas of trapezoids.
    x, (s1, T1), (s2, T2) = longest[-1], *points
    top = T1 + (T2 - T1) / (s2 - s1) * (x - s1)
    area = 0.5 * s1 * T1 + 0.5 * (T1 + top) * (x - s1) - 0.5 * top * top / (T1 / s1)
    assert lost[-1] == pytest.approx(area, abs=1e-9)
    assert np.abs(run.dissipation - lost).max() < 100 * CLOSE
    assert np.abs(run.permanent_stretch[-1, 0] - (x - top * s1 / T1)) < CLOSE
    assert run.energy_residual < 100 * CLOSE


@pytest.mark.third_means(
    "curves.corner_between",
    "slack._set_levels",
    "slack._over_level",
    by="oscillators joined at the corners, at the order of RK4",
)
@pytest.mark.parametrize("make", LOCATED.values(), ids=LOCATED)
@pytest.mark.parametrize("yields", [False, True])
def test_rk4_keeps_its_order_at_corners_that_are_located(make, yields) -> None:
    """Sixteenfold for half the step, but for half an order of what comes next, and a floor where instants are known.

    Until the yielded string comes back to its largest stretch: without a loss, it touches that corner and no more.
    """
    points = GIVES if yields else STIFFENS
    errors = []
    for h in (4e-3, 2e-3):
        run = tmj.simulate(hung(1.05, 3.0, 0.9, curve=points, yields=yields), engine=make(h))
        s = joined(run.time, 0.05, 3.0, points, yields)[0]
        errors.append(np.abs(run.nodes[:, 1, 2] + 1 + s).max())
    print(errors)
    assert errors[1] < max(errors[0] / 2**3.5, CLOSE)


@pytest.mark.parametrize("make", [lambda h: tmj.DAE(method=RK4, timestep=h), tmj.MuJoCo], ids=["DAE", "MuJoCo"])
def test_corners_that_are_not_located_leave_an_error_of_the_second_order(make) -> None:
    """Each corner leaves up to Δk v h²/(8 M) of a velocity, wherever it lies in its step, which grows with the time.

    Δk = 160 N/m, v = 3 m/s and twelve corners in 2 s: 12 · 160 · 3 / 12 h² · 2 s.
    """
    run = tmj.simulate(hung(1.05, 3.0, curve=STIFFENS), engine=make(1e-3))
    s = joined(run.time, 0.05, 3.0, STIFFENS)[0]
    assert CLOSE < np.abs(run.nodes[:, 1, 2] + 1 + s).max() < 12 * 160 * 3 / (8 * M) * 1e-6 * 2


@pytest.mark.third_means("curves.curved_pull", "curves.curved_energy", by="a period by quadrature")
@every
def test_the_period_of_a_stiffening_string_is_that_of_its_energy_integral(engine) -> None:
    """T = 30 s + 500 s³ by twelve pieces: √2 ∫ ds/√((E - V)/M) between the turns, V with the polygon's own integral."""
    s_of = np.linspace(0.0, 0.6, 13)
    T_of = 30 * s_of + 500 * s_of**3
    V_of = np.concatenate([[0.0], np.cumsum(0.5 * np.diff(s_of) * (T_of[1:] + T_of[:-1]))])

    def potential(s):
        j = min(np.searchsorted(s_of, s, side="right") - 1, 11)
        slope = (T_of[j + 1] - T_of[j]) / (s_of[j + 1] - s_of[j])
        return V_of[j] + T_of[j] * (s - s_of[j]) + 0.5 * slope * (s - s_of[j]) ** 2 - M * G * s

    top = 0.1
    energy = potential(top)
    low = brentq(lambda s: potential(s) - energy, 0.3, 0.6, xtol=1e-15)
    # s = mean + half sin φ takes the roots of the ends out of the integral; the polygon's corners are points of it.
    mean, half = 0.5 * (top + low), 0.5 * (low - top)
    corners = [np.arcsin((x - mean) / half) for x in s_of if abs(x - mean) < half * (1 - 1e-9)]

    def speed(phi):
        s = mean + half * np.sin(phi)
        return half * np.cos(phi) / np.sqrt(max(2 / M * (energy - potential(s)), 1e-300))

    edge = np.pi / 2 - 1e-7
    parts = np.array([-edge, *corners, edge])
    half_period = sum(quad(speed, a, b, epsabs=1e-13, epsrel=1e-12)[0] for a, b in itertools.pairwise(parts))
    # Turned by 1e-7 rad at either end less: there the integrand is finite, √(half M / force), below 0.3 s.
    half_period += 1e-7 * (speed(-edge * (1 - 1e-4)) + speed(edge * (1 - 1e-4)))
    curve = tuple(zip(s_of[1:], T_of[1:], strict=True))
    duration = 2 * half_period
    run = tmj.simulate(hung(1 + top, 0.0, curve=curve), engine=engine, duration=float(np.round(duration, 3)))
    # It is back at the top at the period T, where s = top + ½ a (t - T)²: what is left of 1 ms in the duration is that.
    a = (M * G - np.interp(top, s_of, T_of)) / M
    late = run.time[-1] - duration
    assert -run.nodes[-1, 1, 2] - 1 == pytest.approx(top + 0.5 * a * late**2, abs=1e-7)
    assert -run.velocities[-1, 1, 2] == pytest.approx(a * late, abs=5e-7)


@pytest.mark.third_means("curves.curved_pull", by="even acceleration")
@every
def test_a_constant_force_accelerates_a_mass_evenly(engine) -> None:
    """z̈ = T/M - g whatever the length: RK4 and error control integrate it exactly, but for round-off of 2000 steps."""
    run = tmj.simulate(hung(1.0, 0.5, stiffness=0.0, tension=10.0, rest_length=None), engine=engine)
    fall = 0.5 * run.time + 0.5 * (G - 10.0 / M) * run.time**2
    assert np.abs(run.nodes[:, 1, 2] + 1.0 + fall).max() < 1e-11
    np.testing.assert_allclose(run.tensions, 10.0, rtol=0, atol=1e-12)
    np.testing.assert_allclose(run.string_energy, 10.0 * (1.0 + fall), rtol=1e-12)
    assert run.energy_residual < 1e-10
    assert not run.reports["warnings"]


@every
def test_a_counterweight_balances_what_an_atwood_machine_does(engine) -> None:
    """A constant force of m g over a pulley is a mass m without inertia: M z̈ = m g - M g, on a path of two segments."""
    structure = tmj.Structure(
        "counter",
        {"hook": (-0.6, 0.0, 1.0), "pulley": (0.0, 0.0, 1.0), "m": (0.0, 0.0, 0.0)},
        strings=(tmj.String("s", ("hook", "pulley", "m"), 0.0, tension=1.0 * G),),
        fixed_nodes=("hook", "pulley"),
        point_masses=(tmj.PointMass("m", M),),
    )
    run = tmj.simulate(tmj.Scene(structure, gravity=(0.0, 0.0, -G)), None, engine, duration=0.5)
    assert np.abs(run.nodes[:, 2, 2] + 0.5 * G * (1 - 1 / M) * run.time**2).max() < 1e-12


def test_a_constant_force_that_breaks_lets_go() -> None:
    """Free fall from then on, in both engines; with a damper too, where MuJoCo's actuator must not push."""
    for engine in (tmj.DAE(method=RK4, timestep=1e-3), tmj.MuJoCo(1e-3)):
        scene = hung(1.0, 0.0, 0.5, stiffness=0.0, tension=10.0, rest_length=None, damping=0.4)
        run = tmj.simulate(scene.with_(breaks=(tmj.model.Break("s", 0.2),)), None, engine, output_interval=0.01)
        at, after = np.searchsorted(run.time, 0.2 - 1e-9), run.time > 0.2 + 1e-9
        z0, v0, t = run.nodes[at, 1, 2], run.velocities[at, 1, 2], run.time[after] - 0.2
        assert np.abs(run.nodes[after, 1, 2] - (z0 + v0 * t - 0.5 * G * t**2)).max() < 1e-11
        assert not run.tensions[after].any()
        assert run.energy_residual < 1e-9


class Densities:
    """u(t) [N/m], or rest lengths L0(t) [m]."""

    def __init__(self, command):
        self.command = command

    def __call__(self, time, nodes, velocities):
        return [
            10.0 + 8.0 * np.sin(3 * time) if self.command is tmj.Command.FORCE_DENSITY else 1 + 0.1 * np.sin(3 * time)
        ]


@pytest.mark.third_means("curves.stretch_of", "actuation._curved_lengths", by="L - f⁻¹(u L) by hand, and -∫ T dL0")
@pytest.mark.parametrize("engine", [tmj.DAE(rtol=1e-12, atol=1e-13), tmj.MuJoCo(5e-4)], ids=["DAE", "MuJoCo"])
def test_a_commanded_force_density_is_that_of_a_curve_by_its_inverse(engine) -> None:
    """M L̈ = M g - u(t) L by other means, T = u L; the rest length is L less the stretch of that tension by hand, and
    the winch's work -∫ T dL0.
    """
    from scipy.integrate import solve_ivp

    run = tmj.simulate(hung(1.3, 1.0, 1.0, curve=STIFFENS), Densities(tmj.Command.FORCE_DENSITY), engine)
    force = lambda t: 10.0 + 8.0 * np.sin(3 * t)  # noqa: E731
    exact = solve_ivp(
        lambda t, y: [y[1], G - force(t) * y[0] / M], (0, 1), [1.3, 1.0], "DOP853", rtol=1e-12, atol=1e-13,
        t_eval=run.time, dense_output=True,
    )  # fmt: skip
    L = exact.y[0]
    assert np.abs(run.nodes[:, 1, 2] + L).max() < CLOSE
    assert np.abs(run.tensions[:, 0] - force(run.time) * L).max() < 30 * CLOSE
    stretch = lambda T: np.interp(T, [0, 12, 20, 60, 260], [0, 0.2, 0.4, 0.6, 1.6])  # noqa: E731
    assert np.abs(run.rest_lengths[:, 0] - (L - stretch(force(run.time) * L))).max() < CLOSE
    t = np.linspace(0, 1, 200001)
    T, L = force(t) * exact.sol(t)[0], exact.sol(t)[0]
    work = -np.sum(0.5 * (T[1:] + T[:-1]) * np.diff(L - stretch(T)))
    # The trapezoidal rule of 5 µs: below 1e-9 J; RK4's motion times forces of 40 N.
    assert run.winch_work[-1] == pytest.approx(work, abs=50 * CLOSE)
    assert run.energy_residual < 50 * CLOSE


@pytest.mark.parametrize("command", list(tmj.Command), ids=lambda command: command.value)
@pytest.mark.parametrize("mode", ["hold_rest_length", "hold_force_density"])
@pytest.mark.parametrize("curve", [{"curve": STIFFENS}, {"curve": ((0.2, 16.0), (0.5, 30.0)), "yields": True}])
def test_held_commands_close_the_ledger_and_agree(command, mode, curve) -> None:
    """Between samples strings are as above; at a sample winches do what strings store more, and lose by yielding."""
    scene, actuation = hung(1.3, 1.0, 1.0, **curve), getattr(tmj.Actuation, mode)(0.02)
    engines = (tmj.DAE(rtol=1e-12, atol=1e-13), LOCATED["DAE RK4"](5e-4), LOCATED["MuJoCo"](5e-4))
    runs = [
        tmj.simulate(scene, Densities(command), engine, actuation=actuation, output_interval=0.02) for engine in engines
    ]
    for run in runs:
        assert np.abs(run.nodes - runs[0].nodes).max() < CLOSE
        assert np.abs(run.winch_work - runs[0].winch_work).max() < 50 * CLOSE
        assert run.energy_residual < 50 * CLOSE
        sums = tmj.runs.winch_power(run).sum() * 0.02
        assert np.isnan(sums) if "yields" in curve else sums == pytest.approx(run.winch_work[-1], abs=1e-6)
    assert abs(runs[0].winch_work[-1]) > 0.1


@pytest.mark.third_means("curves.stretch_of", "actuation._curved_lengths", by="L - f⁻¹(u L) by hand, cut at the limits")
def test_limits_cut_what_a_law_commands_of_a_curve() -> None:
    """u <= 15 N/m, by force densities and by rest lengths alike: the same as a law that commands no more."""
    limited = hung(1.3, 1.0, 1.0, curve=STIFFENS, max_force_density=15.0)

    class Short:
        command = tmj.Command.REST_LENGTH

        def __call__(self, time, nodes, velocities):
            return [0.2]

    for law, wanted in (
        (Densities(tmj.Command.FORCE_DENSITY), lambda t: 10 + 8 * np.sin(3 * t)),
        (Short(), lambda t: 99),
    ):
        run = tmj.simulate(limited, law, tmj.MuJoCo(1e-3))
        assert np.abs(run.force_densities[:, 0] - np.minimum(15.0, wanted(run.time))).max() < 1e-9
