"""Events within one step: whichever comes first, and jumps that the last stage lies beyond, by other means.

A mass of 1 kg moves on one string along a line. Between events its string is slack, or taut on one piece of its curve,
or let go by its damper; each stretch of the motion is integrated by SciPy's DOP853 at 1e-13, which stops at the events
of that mode alone, and the next begins in the next mode. Nothing of the package is called for it.

Tolerances: RK4 errs by (ω h)⁴ ω T/120 of the amplitude A on smooth motion, ω² being the steepest slope over the mass;
a term of half an order less may come with it, so that half the step leaves no more than 2^-3.5, down to 1e-11 m: an
instant known to 1e-8 of h = 1 ms leaves c v/m 1e-11 s of velocity at a jump, of some 10 m/s².
"""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import tensegrity_mj as tmj
from tensegrity_mj.model.strings import StringLaw, tension

FLOOR = 1e-11  # m
RK4 = tmj.Method.RK4
LOCATED = {
    "DAE": lambda h: tmj.DAE(method=RK4, timestep=h, locate_slack=True),
    "MuJoCo": lambda h: tmj.MuJoCo(h, locate_slack=True),
}
every = pytest.mark.parametrize("make", LOCATED.values(), ids=LOCATED)


class Mass:
    """1 kg on a string of 1 m along x, at a stretch s and rate v; `pull` [N] acts on it away from the hook.

    Attributes:
        points: of the curve, or (s, T) of its stiffness.
        c: damping [N s/m].
    """

    def __init__(self, s, v, points, c, clipped=True, pull=0.0, duration=0.2):
        self.start, self.points, self.c, self.clipped, self.pull = (s, v), points, c, clipped, pull
        self.corners = [(0.0, 0.0), *points]
        string = {"curve": points} if len(points) > 1 else {"stiffness": points[0][1] / points[0][0]}
        structure = tmj.Structure(
            "line",
            {"hook": (0.0, 0.0, 0.0), "m": (1.0 + s, 0.0, 0.0)},
            strings=(tmj.String("s", ("hook", "m"), rest_length=1.0, damping=c, **string),),
            fixed_nodes=("hook",),
            point_masses=(tmj.PointMass("m", 1.0),),
            string_law=StringLaw.CLIPPED if clipped else StringLaw.UNCLIPPED,
        )
        velocities = np.array([[0.0, 0.0, 0.0], [v, 0.0, 0.0]])
        self.scene = tmj.Scene(structure, gravity=(pull, 0.0, 0.0), duration=duration, initial_velocities=velocities)

    def mode(self, s, v):
        """(s_j, T_j, k_j, c) of the force; all zero where there is none, the second True where a damper outweighs."""
        if s <= 0:
            return (0.0, 0.0, 0.0, 0.0), False
        place = min(sum(s > corner for corner, _ in self.corners), len(self.points)) - 1
        (s0, T0), (s1, T1) = self.corners[place], self.corners[place + 1]
        piece = (s0, T0, (T1 - T0) / (s1 - s0), self.c)
        return piece, self.clipped and T0 + piece[2] * (s - s0) + self.c * v < 0

    def stretches(self, times):
        """s at the times, and the instants of the events."""
        t, y, found, events = 0.0, np.array(self.start), [self.start[0]], []
        while t < times[-1]:
            s, v = y
            for _ in range(2):  # 1e-9 s ahead, by the force that acts there
                piece, outweighed = self.mode(s, v)
                s0, T0, k, c = piece
                a = self.pull - (0.0 if outweighed else T0 + k * (y[0] - s0) + c * y[1])
                s, v = y[0] + 1e-9 * y[1] + 0.5e-18 * a, y[1] + 1e-9 * a

            def rates(_, y, piece=piece, outweighed=outweighed):
                s0, T0, k, c = piece
                return [y[1], self.pull - (0.0 if outweighed else T0 + k * (y[0] - s0) + c * y[1])]

            def ends(_, y, piece=piece):
                s0, T0, k, c = piece
                return T0 + k * (y[0] - s0) + c * y[1]

            stops = [lambda _, y, level=level: y[0] - level for level, _ in self.corners]
            stops += [ends] if self.clipped and piece[3] > 0 else []
            for stop in stops:
                stop.terminal = True
            lead = 1e-6  # away from the event, by one step of which the error is nothing
            k1 = np.array(rates(0, y))
            k2 = np.array(rates(0, y + 0.5 * lead * k1))
            y, t = y + lead * k2, t + lead
            how = {"rtol": 1e-13, "atol": 1e-15, "max_step": 1e-3}  # two events of one kind are further apart
            run = solve_ivp(rates, (t, times[-1]), y, "DOP853", events=stops, dense_output=True, **how)
            t, y = run.t[-1], run.y[:, -1]
            inside = times[len(found) : np.searchsorted(times, t, side="right")]
            found += list(run.sol(inside)[0]) if len(inside) else []
            if run.status == 1:
                events.append(t)
        return np.array(found), np.array(events)

    def error(self, engine, samples=20):
        """The largest node error of an engine [m]."""
        run = tmj.simulate(self.scene, engine=engine, output_interval=self.scene.duration / samples)
        return np.abs(run.nodes[:, 1, 0] - 1.0 - self.stretches(run.time)[0]).max()

    def smooth(self, h, amplitude):
        """(ω h)⁴ ω T/120 of an amplitude [m]."""
        omega = max(np.sqrt((b[1] - a[1]) / (b[0] - a[0])) for a, b in itertools.pairwise(self.corners))
        return (max(omega, self.c) * h) ** 4 * max(1.0, max(omega, self.c) * self.scene.duration) / 120 * amplitude


def has_order_four(mass, make, h, amplitude, samples=20):
    """Errors are those of RK4, at h and at half of it."""
    coarse, fine = mass.error(make(h), samples), mass.error(make(h / 2), samples)
    # A part of a step whose length is any may double what whole steps err by.
    assert coarse < max(2 * mass.smooth(h, amplitude), FLOOR)
    assert fine < max(coarse / 2**3.5, FLOOR)


LETS_GO = Mass(0.2, -6.0, ((0.152, 60.8), (0.2, 99.2)), 10.6)


@pytest.mark.third_means(
    "slack._set_levels", "slack._turn", "curves.dip", "curves.cubic_root", by="SciPy's DOP853 from event to event"
)
@every
def test_a_string_that_is_let_go_passes_a_corner_in_the_same_step(make) -> None:
    """The pull ends before the corner is reached: of the two instants, the first counts."""
    _, events = LETS_GO.stretches(np.linspace(0, 0.2, 21))
    assert np.diff(events)[0] < 2e-3
    has_order_four(LETS_GO, make, 2e-3, 0.2)


@every
@pytest.mark.parametrize("accuracy", [1e-4, 1e-6])
def test_such_a_request_is_met(make, accuracy) -> None:
    engine = type(make(1e-3))(accuracy=accuracy)
    run = tmj.simulate(LETS_GO.scene, engine=engine)
    assert run.reports["accuracy"]["met"]
    assert np.abs(run.nodes[:, 1, 0] - 1.0 - LETS_GO.stretches(run.time)[0]).max() <= accuracy


@pytest.mark.third_means("slack._keep", "slack._let_change", "slack._jumps", by="SciPy's DOP853 from event to event")
@every
def test_a_damper_that_may_push_stops_at_an_instant(make) -> None:
    """It comes back, too: c v jumps both ways, and the instants may lie anywhere in their steps."""
    thrown = Mass(0.05, -2.0, ((1.0, 100.0),), 5.0, clipped=False, pull=30.0, duration=0.3)
    _, events = thrown.stretches(np.linspace(0, 0.3, 31))
    assert len(events) == 2
    has_order_four(thrown, make, 1e-3, 0.2)
    assert thrown.error(make(1e-3)) < 1e-9
    # 4.4 m/s · 5 N s/m over a part of a step: the plain method has an order of 1.
    plain = tmj.MuJoCo(1e-3) if make is LOCATED["MuJoCo"] else tmj.DAE(method=RK4, timestep=1e-3)
    assert thrown.error(plain) > 1e-6


@pytest.mark.third_means("slack._keep", "slack._let_change", "slack._jumps", by="SciPy's DOP853 from event to event")
@every
@pytest.mark.parametrize("late", [1e-7, 1e-6, 1e-5])
@pytest.mark.parametrize("comes_taut", [False, True])
def test_a_jump_that_the_last_stage_alone_lies_beyond_is_not_felt(make, late, comes_taut) -> None:
    """A stage at the end of a step is off it by some h³: it may lie beyond a jump that comes just after the step.

    A sixth of c v h of velocity would be wrong, 1.7e-3 m/s.
    """
    h = 1e-3
    pull, v = (400.0, 1.0) if comes_taut else (-400.0, -1.0)
    rough = Mass(-0.5 if comes_taut else 0.5, v, ((1.0, 100.0),), 10.0, clipped=comes_taut, pull=pull, duration=0.04)
    at = rough.stretches(np.linspace(0, 0.04, 5))[1]
    assert not len(at) or at[0] > 2 * h
    # Start where 20 steps end `late` before the jump.
    backwards = Mass(*rough.start, rough.points, rough.c, rough.clipped, pull, 0.2)
    instant = backwards.stretches(np.linspace(0, 0.2, 5))[1][0]
    steps = int((instant - late) / h)
    skip = instant - late - steps * h
    free = solve_ivp(
        lambda _, y: [y[1], pull - (0.0 if comes_taut else 100.0 * y[0] + 10.0 * y[1])],
        (0, skip), rough.start, "DOP853", rtol=1e-13, atol=1e-15,
    )  # fmt: skip
    mass = Mass(*free.y[:, -1], rough.points, rough.c, rough.clipped, pull, (steps + 20) * h)
    run = tmj.simulate(mass.scene, engine=make(h), output_interval=h)
    error = np.abs(run.nodes[:, 1, 0] - 1.0 - mass.stretches(run.time)[0]).max()
    assert error < max(2 * mass.smooth(h, 1.0), FLOOR)


@pytest.mark.third_means("slack._turn", "curves.dip", "curves.cubic_root", by="SciPy's DOP853 from event to event")
@every
@pytest.mark.parametrize("over", [3e-5, 1e-4])
def test_a_corner_that_is_passed_for_a_moment_within_a_step_is_seen(make, over) -> None:
    """The mass turns just beyond a corner where the slope rises fivefold; both ends of the step are below it.

    Thrown along the first piece, it would come to the corner and `over` beyond. There it is for so short a time that
    the first piece, ω = 10 /s, says what RK4 errs by; a corner that is not seen leaves 2e-5 m.
    """
    k, corner = 100.0, 0.2
    v = np.sqrt(k * ((corner + over) ** 2 - 0.1**2))
    mass = Mass(0.1, v, ((corner, k * corner), (0.4, k * corner + 5 * k * 0.2)), 0.0)
    _, events = mass.stretches(np.linspace(0, 0.2, 21))
    assert np.diff(events)[0] < 0.01
    for h in (0.02, 0.01):
        assert mass.error(make(h), 2) < 2 * (10 * h) ** 4 * (10 * 0.2) / 120 * 0.2


@pytest.mark.third_means("slack._turn", "curves.dip", "curves.cubic_root", by="SciPy's DOP853 from event to event")
@every
def test_a_pull_that_a_damper_outweighs_for_a_moment_within_a_step_is_seen(make) -> None:
    """k s + c ds/dt falls below zero and rises again; both ends of the first step pull."""
    mass = Mass(0.1036, -1.25, ((1.0, 100.0),), 8.0, pull=12.0, duration=0.064)
    _, events = mass.stretches(np.linspace(0, 0.064, 5))
    h = 0.016
    assert h < events[0] < events[1] < 2 * h
    assert len(events) == 2
    assert mass.error(make(h), 2) < 2 * mass.smooth(h, 0.1)  # one that is not seen leaves 8e-6 m


def hung(down: np.ndarray, k: float, c: float, m: float) -> tmj.Scene:
    """A mass on a string that is as long as at rest."""
    structure = tmj.Structure(
        "hung",
        {"hook": (0.1, 0.2, 1.0), "m": tuple(np.array([0.1, 0.2, 1.0]) + 0.9 * down)},
        strings=(tmj.String("s", ("hook", "m"), k, c),),
        fixed_nodes=("hook",),
        point_masses=(tmj.PointMass("m", m),),
    )
    return tmj.Scene(structure, gravity=tuple(9.81 * down), duration=0.1)


def stepping(engine: str, step: float, located: bool) -> Any:
    """An engine with RK4 in steps [s]; JAX, where it is installed, does not locate events."""
    if engine == "JAX":
        pytest.importorskip("diffrax")
        return tmj.JAX(method="rk4", timestep=step)
    if engine == "MuJoCo":
        return tmj.MuJoCo(step, locate_slack=located)
    return tmj.DAE(method=RK4, timestep=step, locate_slack=located)


@pytest.mark.third_means(
    "strings.over_rest", "strings.is_slack", "strings.rest_moves", by="an oscillator from s = ds/dt = 0 on"
)
@pytest.mark.parametrize(
    ("engine", "located"), [("DAE", False), ("DAE", True), ("MuJoCo", False), ("MuJoCo", True), ("JAX", False)]
)
@pytest.mark.parametrize("tilt", [0.0, 0.7])
def test_a_start_at_the_rest_length_has_the_order_of_the_method(engine, located, tilt) -> None:
    """A mass let go on a damped string that is as long as at rest: an oscillator from the start, s(0) = ds/dt(0) = 0.

    ω = 50 /s, δ = 12.5 /s, 0.1 s: (ω h)⁴ 5/120 of 2 g/ω² is 2e-9 m at 1 ms. A damper that is missed at the second
    stage leaves c g h²/(6 m) ω T, 1e-7 m and more. Tilted, the rest length is not a number that rounds to itself.
    """
    k, c, m = 5000.0, 50.0, 2.0
    down = np.array([np.sin(tilt), 0.0, -np.cos(tilt)])
    scene = hung(down, k, c, m)
    errors = []
    for h in (1e-3, 5e-4):
        run = tmj.simulate(scene, engine=stepping(engine, h, located), output_interval=0.01)
        delta = c / (2 * m)
        omega = np.sqrt(k / m - delta**2)
        rest, t = m * 9.81 / k, run.time
        s = rest - rest * np.exp(-delta * t) * (np.cos(omega * t) + delta / omega * np.sin(omega * t))
        errors.append(np.abs((run.nodes[:, 1] - run.nodes[0, 1]) @ down - s).max())
    assert errors[0] < (np.sqrt(k / m) * 1e-3) ** 4 * 5 / 120 * 2 * rest
    assert errors[1] < max(errors[0] / 2**3.5, 1e-14)


@pytest.mark.parametrize("speed", [0.3, -0.3])
def test_all_codings_have_the_same_rule_at_the_rest_length(speed) -> None:
    """Thrown from s = 0 exactly: c v where the string grows, nothing where it shortens; to round-off of the length."""
    down = np.array([0.0, 0.0, -1.0])
    scene = hung(down, 5000.0, 50.0, 2.0).with_(initial_velocities=[(0.0, 0.0, 0.0), tuple(speed * down)])
    expected = max(0.0, 50.0 * speed)
    for engine in ("DAE", "MuJoCo", "JAX"):
        run = tmj.simulate(scene, engine=stepping(engine, 1e-3, False), output_interval=0.01)
        assert run.tensions[0, 0] == pytest.approx(expected, abs=5000.0 * 1e-15)
    structure = scene.structure
    lengths, rates = (
        f(scene.nodes0, *v) for f, v in ((structure.string_lengths, ()), (structure.string_rates, (scene.velocities0,)))
    )
    rest = structure.rest_lengths
    found = tension(structure.curves, structure.damping, lengths, rates, rest, structure.clipped)
    assert found[0] == pytest.approx(expected, abs=5000.0 * 1e-15)


@every
def test_what_two_runs_begin_with_alike_is_no_evidence(make) -> None:
    """Steps of 12.5 and 6.25 ms begin with the same part, up to a corner, and are wrong by it alike, by 9e-8 m.

    A mass thrown across its string in space; its equation is integrated by DOP853 at 1e-12, in steps of 1 ms at most,
    whose error control takes short ones over corners.
    """
    hook, start = np.array([0.2013377, -0.1484853, 0.8069803]), np.array([0.1368892, -0.2633254, -0.2970875])
    velocity, m, c, rest = np.array([-0.3195997, 1.5581804, 3.1881024]), 0.7805848, 0.9903992, 1.0435918
    points = ((0.0484146, 8.4073067), (0.1369016, 50.633485))
    structure = tmj.Structure(
        "thrown",
        {"hook": tuple(hook), "m": tuple(start)},
        strings=(tmj.String("s", ("hook", "m"), curve=points, damping=c, rest_length=rest),),
        fixed_nodes=("hook",),
        point_masses=(tmj.PointMass("m", m),),
    )
    scene = tmj.Scene(
        structure, gravity=(0, 0, -9.81), duration=0.5, initial_velocities=np.array([np.zeros(3), velocity])
    )
    run = tmj.simulate(scene, engine=type(make(1e-3))(accuracy=2.8e-8))

    def rates(_, y):
        span, v = y[:3] - hook, y[3:]
        length = np.sqrt(span @ span)
        s = length - rest
        pull = np.interp(s, [0.0, *(x for x, _ in points)], [0.0, *(T for _, T in points)])
        total = max(0.0, pull + c * (span @ v) / length) if s > 0 else 0.0
        return [*v, *(np.array([0, 0, -9.81]) - total / m * span / length)]

    how = {"rtol": 1e-12, "atol": 1e-14, "max_step": 1e-3, "t_eval": run.time}
    true = solve_ivp(rates, (0.0, 0.5), [*start, *velocity], "DOP853", **how).y[:3].T
    assert np.linalg.norm(run.nodes[:, 1] - true, axis=1).max() <= 2.8e-8
    assert run.reports["accuracy"]["met"]
