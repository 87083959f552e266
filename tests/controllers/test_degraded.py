"""Laws made worse: sensor noise and delay, against their definitions, across engines, around any law."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import tensegrity_mj as tmj
from tensegrity_mj.controllers.degraded import Delayed, Noisy, add_noise, philox
from tensegrity_mj.errors import OptionError

PERIOD = 2e-3
HOLD = tmj.Actuation.hold_force_density(PERIOD)


class Recorder:
    """A Python law that notes what it is given and answers with it: u of string m is 0.05 + 0.01 sin(t + m)."""

    def __init__(self, size: int, command: tmj.Command = tmj.Command.FORCE_DENSITY) -> None:
        self.size, self.command = size, command
        self.seen: dict[int, tuple[Any, Any]] = {}

    def at(self, time: float) -> Any:
        return 0.05 + 0.01 * np.sin(20 * time + np.arange(self.size))

    def __call__(self, time: float, nodes: Any, velocities: Any) -> Any:
        self.seen[round(time / PERIOD)] = (nodes, velocities)
        return self.at(time)


@pytest.mark.parametrize(("counter", "block", "key"), [(0, 0, 0), (5, 3, 42), (10**6, 7, 2**62 + 1), (2**40, 0, 1)])
def test_the_generator_is_philox(counter: int, block: int, key: int) -> None:
    ours = np.zeros(4, np.uint64)
    philox(counter, block, key, 0, ours)
    # numpy's own advances its counter before it draws.
    start = (counter + (block << 64) - 1) % 2**256
    np.testing.assert_array_equal(ours, np.random.Philox(counter=start, key=key).random_raw(4))


def test_the_noise_is_normal_and_independent() -> None:
    rows, samples = 50, 400
    draws = np.zeros((2, samples, rows, 3))
    for stream in range(2):
        for sample in range(samples):
            add_noise(draws[stream, sample], 2.0, np.ones(rows, np.int64), sample, stream, 7)
    flat = draws.ravel() / 2.0
    n = flat.size  # 120,000
    # Five standard deviations of each statistic: mean 1/√n, variance √(2/n), third moment √(15/n), fourth √(96/n).
    assert abs(flat.mean()) < 5 / math.sqrt(n)
    assert abs((flat**2).mean() - 1) < 5 * math.sqrt(2 / n)
    assert abs((flat**3).mean()) < 5 * math.sqrt(15 / n)
    assert abs((flat**4).mean() - 3) < 5 * math.sqrt(96 / n)
    # Correlations between axes, rows, samples, streams: standard deviation 1/√(pairs).
    unit = draws / 2.0
    for a, b in (
        (unit[..., 0], unit[..., 1]),
        (unit[..., 1], unit[..., 2]),
        (unit[..., 0], unit[..., 2]),
        (unit[:, :, 1:], unit[:, :, :-1]),
        (unit[:, 1:], unit[:, :-1]),
        (unit[0], unit[1]),
    ):
        assert abs(np.mean(a * b)) < 5 / math.sqrt(a.size)


def test_noise_is_that_of_the_sample_and_the_seed_alone() -> None:
    def measured(seed: int, time: float) -> Any:
        return Noisy(Recorder(1), 1e-3, 1e-2, seed, PERIOD).measured(time, np.zeros((4, 3)), np.zeros((4, 3)))

    first = measured(3, 5 * PERIOD)
    for other, same in (((3, 5 * PERIOD * (1 + 1e-12)), True), ((4, 5 * PERIOD), False), ((3, 6 * PERIOD), False)):
        again = measured(*other)
        assert np.array_equal(first[0], again[0]) is same
        assert np.array_equal(first[1], again[1]) is same
    assert not np.any(first[0] == first[1] / 10)  # positions and velocities have their own


def test_a_compiled_and_a_python_law_are_given_the_same_noise(prism: Any) -> None:
    inner = Recorder(12)
    law = Noisy(inner, 1e-3, 1e-2, 11, PERIOD)
    run = tmj.simulate(prism, law, tmj.MuJoCo(1e-3), duration=0.1, actuation=HOLD, output_interval=PERIOD)
    assert len(inner.seen) == 51
    for sample in (0, 1, 17, 49):
        expected = law.measured(sample * PERIOD, run.nodes[sample], run.velocities[sample])
        np.testing.assert_array_equal(inner.seen[sample][0], expected[0])
        np.testing.assert_array_equal(inner.seen[sample][1], expected[1])


def test_fixed_nodes_are_known() -> None:
    scene = tmj.load_scene("pinned_rod")
    inner = Recorder(3)
    law = Noisy(inner, 1e-2, 1e-2, 0, PERIOD)
    tmj.simulate(scene, law, tmj.DAE(method=tmj.Method.RK4, timestep=1e-3), duration=0.01, actuation=HOLD)
    nodes, velocities = inner.seen[3]
    fixed = [scene.structure.node_index[name] for name in ("n2", "n3", "n4")]
    np.testing.assert_array_equal(nodes[fixed], scene.structure.positions[fixed])
    assert not np.any(velocities[fixed])
    assert np.all(velocities[scene.structure.node_index["n1"]] != 0)


@pytest.mark.parametrize("samples", [0, 1, 3, 10])
@pytest.mark.parametrize("engine", [tmj.MuJoCo(1e-3), tmj.DAE(method=tmj.Method.RK4, timestep=1e-3)], ids=str)
def test_a_delay_is_exact(prism: Any, engine: Any, samples: int) -> None:
    inner = Recorder(12)
    run = tmj.simulate(
        prism, Delayed(inner, samples, PERIOD), engine, duration=0.1, actuation=HOLD, output_interval=PERIOD
    )
    late = np.maximum(np.arange(51) - samples, 0) * PERIOD
    expected = np.array([inner.at(time) for time in late])
    # u = k (1 - L0/L) and back: round-off of k/u, about 40.
    np.testing.assert_allclose(run.force_densities, expected, rtol=1e-13)


def test_all_that_the_law_reports_is_late_too(prism: Any) -> None:
    law = tmj.controllers.from_scene(prism)
    run = tmj.simulate(
        prism, Delayed(law, 3, PERIOD), tmj.MuJoCo(1e-3), duration=0.1, actuation=HOLD, output_interval=PERIOD
    )
    V = [law.evaluate(t, n, v)[2] for t, n, v in zip(run.time, run.nodes, run.velocities, strict=True)]
    np.testing.assert_allclose(run.lyapunov[3:], V[:-3], rtol=1e-13)
    np.testing.assert_allclose(run.lyapunov[:3], V[0], rtol=1e-13)


def test_called_from_python_they_do_the_same(prism: Any) -> None:
    inner = Recorder(12)
    law = Delayed(inner, 2, PERIOD)
    nodes, velocities = np.array(prism.nodes0), np.array(prism.velocities0)
    answers = [law(sample * PERIOD, nodes, velocities) for sample in range(6)]
    np.testing.assert_array_equal(answers, [inner.at(max(sample - 2, 0) * PERIOD) for sample in range(6)])
    with pytest.raises(OptionError, match="sample 18 was left out"):
        law(20 * PERIOD, nodes, velocities)
    noisy = Noisy(tmj.controllers.from_scene(prism), 1e-4, 1e-3, 5, PERIOD)
    expected = noisy.law(0.01, *noisy.measured(0.01, nodes, velocities))
    np.testing.assert_array_equal(noisy(0.01, nodes, velocities), expected)


@pytest.mark.parametrize("python", [False, True], ids=["compiled", "python"])
@pytest.mark.parametrize("mode", ["hold_force_density", "hold_rest_length"])
def test_engines_agree_under_noise_and_delay(prism: Any, mode: str, python: bool) -> None:
    own = tmj.controllers.from_scene(prism)

    def law() -> Any:
        inner = (lambda t, n, v: own(t, n, v)) if python else own
        return Delayed(Noisy(inner, 1e-3, 1e-2, 1, PERIOD), 2, PERIOD)

    actuation = getattr(tmj.Actuation, mode)(PERIOD)
    duration = 0.3 if python else 1.0
    run = tmj.simulate(prism, law(), tmj.MuJoCo(1e-3), duration=duration, actuation=actuation)
    reference = tmj.simulate(prism, law(), tmj.DAE(rtol=1e-11, atol=1e-12), duration=duration, actuation=actuation)
    quiet = tmj.simulate(prism, own, tmj.MuJoCo(1e-3), duration=duration, actuation=actuation)
    # Between samples nothing jumps: RK4's error of order h⁴ and the DAE's tolerance, both far below the issue's bound.
    assert tmj.compare(run, reference).max_node_error <= 1e-8
    assert tmj.compare(run, quiet).max_node_error > 1e-5  # the noise is there


def test_two_runs_of_one_law_are_the_same(prism: Any) -> None:
    law = Delayed(Noisy(tmj.controllers.from_scene(prism), 1e-3, 1e-2, 1, PERIOD), 5, PERIOD)
    first, second = (tmj.simulate(prism, law, tmj.MuJoCo(1e-3), duration=0.1, actuation=HOLD) for _ in range(2))
    np.testing.assert_array_equal(first.nodes, second.nodes)


def test_a_law_without_a_solution_has_none_late(prism: Any) -> None:
    def fails(time: float, nodes: Any, velocities: Any) -> Any:
        if time > 9.5 * PERIOD:
            raise tmj.errors.InfeasibleError("no more")
        return np.full(12, 0.05)

    run = tmj.simulate(prism, Delayed(fails, 4, PERIOD), tmj.MuJoCo(1e-3), duration=0.1, actuation=HOLD)
    assert run.status is tmj.Status.INFEASIBLE
    assert run.time[-1] == pytest.approx(14 * PERIOD)
    assert "no more" in run.message


def test_an_error_of_the_law_is_reported_at_once(prism: Any) -> None:
    def fails(time: float, nodes: Any, velocities: Any) -> Any:
        raise ZeroDivisionError("oh")

    for law in (Delayed(fails, 4, PERIOD), Noisy(fails, 0.0, 0.0, 0, PERIOD)):
        with pytest.raises(tmj.errors.ControllerError, match=r"t = 0 s: ZeroDivisionError: oh"):
            tmj.simulate(prism, law, tmj.MuJoCo(1e-3), duration=0.1, actuation=HOLD)


def test_rest_lengths_pass_as_they_are(prism: Any) -> None:
    inner = Recorder(12, tmj.Command.REST_LENGTH)
    law = Delayed(Noisy(inner, 0.0, 0.0, 0, PERIOD), 1, PERIOD)
    assert law.command is tmj.Command.REST_LENGTH
    hold = tmj.Actuation.hold_rest_length(PERIOD)
    run = tmj.simulate(prism, law, tmj.MuJoCo(1e-3), duration=0.02, actuation=hold, output_interval=PERIOD)
    np.testing.assert_array_equal(run.rest_lengths[5], inner.at(4 * PERIOD))


@pytest.mark.parametrize("law", [Noisy(Recorder(12), 0.0, 0.0, 0, PERIOD), Delayed(Recorder(12), 1, PERIOD)])
def test_they_run_sampled_with_their_period_only(prism: Any, law: Any) -> None:
    with pytest.raises(OptionError, match="run it sampled"):
        tmj.simulate(prism, law, tmj.MuJoCo(1e-3), duration=0.1)
    with pytest.raises(OptionError, match=r"control period = 0\.001 s: .* samples each 0\.002 s"):
        tmj.simulate(prism, law, tmj.MuJoCo(1e-3), duration=0.1, actuation=tmj.Actuation.hold_force_density(1e-3))
    other = Delayed(law, 1, 2 * PERIOD)
    with pytest.raises(OptionError, match=r"period = 0\.004 s: the law within has samples each 0\.002 s"):
        tmj.simulate(
            prism, other, tmj.MuJoCo(1e-3), duration=0.1, actuation=tmj.Actuation.hold_force_density(2 * PERIOD)
        )


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Noisy(None, -1.0, 0.0, 0, 1.0), "position_std = -1.0"),
        (lambda: Noisy(None, 0.0, math.nan, 0, 1.0), "velocity_std = nan"),
        (lambda: Noisy(None, 0.0, 0.0, -1, 1.0), "seed = -1"),
        (lambda: Noisy(None, 0.0, 0.0, 0.5, 1.0), "seed = 0.5"),
        (lambda: Noisy(None, 0.0, 0.0, 0, 0.0), "period = 0.0"),
        (lambda: Delayed(None, -1, 1.0), "samples = -1"),
        (lambda: Delayed(None, 1.5, 1.0), "samples = 1.5"),
        (lambda: Delayed(None, 1, math.inf), "period = inf"),
        (lambda: Delayed(None, 1, 1.0).native(tmj.load_scene("prism").structure), "law = None"),
    ],
)
def test_bad_values_are_refused(make: Any, words: str) -> None:
    with pytest.raises(OptionError, match=words):
        make()
