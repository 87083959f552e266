"""Requests of an accuracy where forces have kinks at times of data, by other means: SciPy's DOP853 from time to time.

A mass of 1 kg hangs on an undamped string of 1 m whose hook follows a record of the ground, or whose rest length
follows a program. Between the times of the data all is smooth, and integrated to 1e-13; nothing of the package is
called for it.
"""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import tensegrity_mj as tmj
from tensegrity_mj.model.ground import Baseline

G, K, DURATION = 9.81, 400.0, 0.39
ENGINES = pytest.mark.parametrize("engine", [tmj.DAE, tmj.MuJoCo], ids=["DAE", "MuJoCo"])
REQUESTS = (1e-4, 1e-5, 1e-6, 1e-7, 2e-8)  # m


def hung() -> tmj.Structure:
    """The mass where the string carries it."""
    return tmj.Structure(
        "hung",
        {"hook": (0.0, 0.0, 0.0), "m": (0.0, 0.0, -1.0 - G / K)},
        strings=(tmj.String("s", ("hook", "m"), K, rest_length=1.0),),
        fixed_nodes=("hook",),
        point_masses=(tmj.PointMass("m", 1.0),),
    )


def heights(times, knots, hook, rest):
    """z of the mass at the times; `hook` is z of the hook, `rest` the rest length, functions smooth between knots."""
    ends = [0.0, *(t for t in knots if 0 < t < DURATION), DURATION]
    y, found = np.array([-1.0 - G / K, 0.0]), [-1.0 - G / K]
    for begin, end in itertools.pairwise(ends):
        middle = 0.5 * (begin + end)

        def rates(t, y, middle=middle):
            return [y[1], -G + K * (hook(t, middle) - y[0] - rest(t, middle))]

        run = solve_ivp(rates, (begin, end), y, "DOP853", rtol=1e-13, atol=1e-15, dense_output=True)
        y = run.y[:, -1]
        assert np.all(hook(end, middle) - run.y[0][-1] > rest(end, middle))  # taut
        inside = times[len(found) : np.searchsorted(times, end * (1 + 1e-12), side="right")]
        found += list(run.sol(np.minimum(inside, end))[0]) if len(inside) else []
    return np.array(found)


def check(engine, scene, law, truth, aligned=True) -> None:
    """Every request is met, and where steps end at all times of the data RK4 has its order, but for half of one."""
    for accuracy in REQUESTS:
        run = tmj.simulate(scene, law, engine(accuracy=accuracy))
        assert run.reports["accuracy"]["met"]
        assert np.abs(run.nodes[:, 1, 2] - truth(run.time)).max() <= accuracy
    if aligned and engine is tmj.MuJoCo:  # which has no other method here
        step, interval = run.reports["accuracy"]["chosen"]["timestep"], float(run.time[1])
        finer = tmj.simulate(scene, law, tmj.MuJoCo(step / 2, locate_slack=True), output_interval=interval)
        before, last = (np.abs(one.nodes[:, 1, 2] - truth(one.time)).max() for one in (run, finer))
        assert last < before / 2**3.5


@pytest.mark.third_means("motion.piece_at between times of a record", by="SciPy's DOP853 from time to time")
@ENGINES
@pytest.mark.parametrize("even", [True, False], ids=["even", "uneven"])
@pytest.mark.parametrize("seed", range(2))
def test_a_record_of_the_ground(engine, even, seed) -> None:
    """Accelerations are linear between its times, and jump in their rate there. No step divides uneven times."""
    rng = np.random.default_rng(seed)
    knots = np.arange(9) * 0.05
    knots = knots if even else np.sort(knots + np.append(0.0, rng.uniform(0.0, 0.02, 8)))
    a = rng.normal(size=9) * 2
    ground = tmj.model.Ground(tuple(knots), tuple((0.0, 0.0, one) for one in a), baseline=Baseline.NONE)
    h = np.diff(knots)
    speeds = np.append(0.0, np.cumsum(0.5 * h * (a[1:] + a[:-1])))
    places = np.append(0.0, np.cumsum(h * speeds[:-1] + h**2 * (2 * a[:-1] + a[1:]) / 6))

    def hook(t, middle):
        k = np.searchsorted(knots, middle) - 1
        x = t - knots[k]
        return places[k] + speeds[k] * x + 0.5 * a[k] * x**2 + (a[k + 1] - a[k]) / h[k] * x**3 / 6

    scene = ground.shake(tmj.Scene(hung(), gravity=(0.0, 0.0, -G), duration=DURATION))
    check(engine, scene, None, lambda times: heights(times, knots, hook, lambda t, middle: 1.0), even)


@pytest.mark.third_means("programs of rest lengths", by="SciPy's DOP853 from time to time")
@ENGINES
def test_a_program_of_rest_lengths(engine) -> None:
    """Each move is a cubic from rest to rest, whose second derivative jumps where it begins and ends."""
    moves = (("s", 0.05, 0.13, 0.995), ("s", 0.15, 0.22, 1.004), ("s", 0.22, 0.29, 0.997))
    scene = tmj.Scene(hung(), gravity=(0.0, 0.0, -G), duration=DURATION)
    law = tmj.controllers.Program(scene.structure, moves=moves)

    def rest(t, middle):
        length = 1.0
        for _, begin, end, goal in moves:
            x = min(max((t - begin) / (end - begin), 0.0), 1.0) if begin < middle else 0.0
            length += (goal - length) * x**2 * (3 - 2 * x)
        return length

    knots = sorted({time for _, begin, end, _ in moves for time in (begin, end)})
    check(engine, scene, law, lambda times: heights(times, knots, lambda t, middle: 0.0, rest))
