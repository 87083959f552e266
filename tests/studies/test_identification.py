"""Identification: its statistics against closed forms, recovery from data of another engine, what data do not see."""

from __future__ import annotations

import io
import itertools
import json
import re
import sys
import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import caught_mass
import numpy as np
import pytest
from scipy import stats
from tqdm import tqdm

import tensegrity_mj as tmj
from tensegrity_mj.basics.checks import warn_caller
from tensegrity_mj.cli import main
from tensegrity_mj.errors import IdentificationWarning, OptionError
from tensegrity_mj.runs import Table
from tensegrity_mj.studies import FitOptions, Parameter, identify, measured
from tensegrity_mj.studies.identification import fitting, predictions, result
from tensegrity_mj.studies.identification.fitting import Problem, fit
from tensegrity_mj.studies.identification.measurements import Observation
from tensegrity_mj.studies.identification.predictions import predictions_of
from tensegrity_mj.studies.identification.unknowns import Unknowns

Array = np.ndarray
SPLIT = 1e-3  # of all runs of these tests that binomial bounds are wide enough for, in each tail: seeds are fixed


class Formula:
    """Predictions by a formula, and their Jacobian."""

    noise = 1e-9

    def __init__(self, predict: Callable[[Array], Array], jacobian: Callable[[Array], Array]) -> None:
        self.predict, self.jacobian = predict, jacobian


def problem(model: Any, names: str, start: Any, times: Array, values: Array, sigma: float | None = None) -> Problem:
    """Of parameters without bounds and one series of numbers."""
    first = np.array(start, float)
    free = np.full(len(first), np.inf)
    prior = np.full(len(first), np.nan)
    unknowns = Unknowns(None, tuple(names.split()), (False,) * len(first), first, -free, free, prior)  # type: ignore[arg-type]
    zeros, at = np.zeros(len(times), int), np.arange(len(times))
    size = np.full(len(times), sigma or 1.0)
    seen = Observation(times, ("x",), ("m",), values, size, sigma is not None, zeros, at, zeros)
    return Problem(model, unknowns, seen)


def column(found: dict[str, Any], key: str) -> Array:
    return np.array([row[key] for row in found["parameters"]], float)


@pytest.mark.parametrize("known", [True, False])
def test_a_linear_fit_has_the_estimates_and_intervals_of_the_textbook(known: bool) -> None:
    """Least squares of A θ: θ = A⁺ y, covariance σ² (Aᵀ A)⁻¹, normal or Student's t with s² = r²/(n - P)."""
    rng = np.random.default_rng(1)
    times = np.linspace(0, 2, 40)
    A = np.stack([np.ones(40), times, np.sin(5 * times)], axis=1)
    y = A @ [1.0, -2.0, 0.5] + 0.1 * rng.standard_normal(40)
    found = fit(
        problem(Formula(lambda p: A @ p, lambda p: A), "a b c", [2, 1, 1], times, y, 0.1 if known else None),
        FitOptions(level=0.9),
    )
    theta, (left,), *_ = np.linalg.lstsq(A, y)
    variance = 0.01 if known else left / 37
    covariance = variance * np.linalg.inv(A.T @ A)
    # The fit ends where neither parameters nor the sum change by 1e-10 of themselves; one step is exact.
    assert column(found, "value") == pytest.approx(theta, rel=1e-8)
    assert column(found, "deviation") == pytest.approx(np.sqrt(np.diag(covariance)), rel=1e-10)
    quantile = stats.norm.ppf(0.95) if known else stats.t(37).ppf(0.95)
    assert column(found, "high") - column(found, "value") == pytest.approx(quantile * column(found, "deviation"))
    scaled = covariance / np.sqrt(np.outer(np.diag(covariance), np.diag(covariance)))
    assert np.array(found["correlation"]) == pytest.approx(scaled, abs=1e-10)
    assert found["degrees"] == 37
    if known:
        assert found["chi_squared"] == pytest.approx(left / 0.01, rel=1e-8)
        assert found["p_value"] == pytest.approx(stats.chi2.sf(left / 0.01, 37), rel=1e-6)
    else:
        assert found["estimated_noise"] == pytest.approx(np.sqrt(left / 37), rel=1e-8)
        assert found["p_value"] is None


def oscillator(times: Array) -> Formula:
    """x of m ẍ + c ẋ + k x = 0 from rest at 1 m, by p = (k, c, m); its slopes by complex steps, which are exact."""

    def predict(p: Array) -> Array:
        k, c, m = p
        rate, omega = c / (2 * m), np.sqrt(k / m - (c / (2 * m)) ** 2)
        return np.exp(-rate * times) * (np.cos(omega * times) + rate / omega * np.sin(omega * times))

    def jacobian(p: Array) -> Array:
        steps = 1e-30j * np.eye(3)
        return np.stack([predict(p + step).imag / 1e-30 for step in steps], axis=1)

    return Formula(predict, jacobian)


TIMES = np.linspace(0, 3, 151)
TRUTH = np.array([50.0, 0.8, 1.0])


def test_what_an_oscillator_does_not_see_is_all_three_together() -> None:
    """Its motion is that of k/m and c/m: what is left unseen is dk/k = dc/c = dm/m, and nothing else."""
    model = oscillator(TIMES)
    y = model.predict(TRUTH) + 1e-3 * np.random.default_rng(2).standard_normal(151)
    case = problem(model, "k c m", [48, 1.0, 1.1], TIMES, y, 1e-3)
    with pytest.warns(IdentificationWarning, match=r"\+1 k, \+1 c, \+1 m \(at all\)"):
        found = fit(case, FitOptions())
    assert found["before"]["unseen"] == ["+1 k, +1 c, +1 m (at all)"]
    assert np.isinf(column(found, "deviation")).all()
    with pytest.warns(IdentificationWarning, match="held at their starts: "):
        found = fit(case, FitOptions(hold_unseen=True))
    held = [row["name"] for row in found["parameters"] if row["note"] == "held at its start"]
    assert len(held) == 1
    k, c, m = column(found, "value")
    # Each of the ratios within 4 of its deviations, which is wrong once in 16,000.
    known = {row["name"]: row["deviation"] for row in found["parameters"]}
    assert not found["after"]["unseen"]
    assert abs(k / m - 50) < 4 * 50 * max(known[n] / v for n, v in (("k", k), ("m", m)) if n not in held)
    assert abs(c / m - 0.8) < 4 * 0.8 * max(known[n] / v for n, v in (("c", c), ("m", m)) if n not in held)
    # A prior of the mass makes all three seen, and its own deviation is that of the prior.
    unknowns = replace(case.unknowns, prior=np.array([np.nan, np.nan, 0.05]))
    found = fit(replace(case, unknowns=unknowns), FitOptions())
    assert not found["before"]["unseen"]
    assert column(found, "deviation")[2] == pytest.approx(0.05, rel=1e-6)


@pytest.mark.parametrize("count", [1, 2])
def test_a_fit_that_ends_with_every_parameter_at_a_bound_says_so(count: int) -> None:
    full = oscillator(TIMES)
    whole = partial(np.append, values=TRUTH[count:])
    model = Formula(lambda p: full.predict(whole(p)), lambda p: full.jacobian(whole(p))[:, :count])
    case = problem(model, "k c m"[: 2 * count - 1], [45.0, 1.0][:count], TIMES, full.predict(TRUTH), 1e-3)
    bounds = {"low": np.array([40.0, 0.95])[:count], "high": np.array([46.0, 1.2])[:count]}  # TRUTH is outside
    found = fit(replace(case, unknowns=replace(case.unknowns, **bounds)), FitOptions())
    assert [row["note"] for row in found["parameters"]] == ["at its bound"] * count
    assert np.isnan(column(found, "deviation")).all()
    assert found["correlated"] == []
    assert found["after"]["eigenvalues"] == []


def coverage(found: list[dict[str, Any]], truth: Array) -> tuple[int, tuple[float, float]]:
    """How many intervals have the truth in them, and the bounds of the binomial distribution of as many independent
    ones of 95 %: estimates of one draw are correlated, so that its count is of draws, each parameter by itself."""
    inside = sum((column(one, "low") < truth) & (truth < column(one, "high")) for one in found)
    count = len(found)
    return inside, tuple(stats.binom(count, 0.95).ppf([SPLIT / len(truth), 1 - SPLIT / len(truth)]))


@pytest.mark.parametrize("known", [True, False])
def test_intervals_of_an_oscillator_cover_the_truth_as_often_as_they_say(known: bool) -> None:
    full = oscillator(TIMES)
    two = Formula(lambda p: full.predict(np.array([*p, 1.0])), lambda p: full.jacobian(np.array([*p, 1.0]))[:, :2])
    rng, clean = np.random.default_rng(3), full.predict(TRUTH)
    found = [
        fit(
            problem(two, "k c", [45, 1.0], TIMES, clean + 0.02 * rng.standard_normal(151), 0.02 if known else None),
            FitOptions(),
        )
        for _ in range(200)
    ]
    inside, (low, high) = coverage(found, TRUTH[:2])
    assert np.all((low <= inside) & (inside <= high)), (inside, low, high)
    if known:  # χ² of as many degrees of freedom: its p-values are even; the bound is Kolmogorov's of p = 1e-3
        assert stats.kstest([one["p_value"] for one in found], "uniform").pvalue > SPLIT
    false = sum(one["whiteness"]["p_value"] < 0.05 for one in found)
    assert false <= stats.binom(200, 0.05).ppf(1 - SPLIT)


def test_residuals_that_are_not_white_are_found() -> None:
    """Ljung and Box' statistic by their formula, and an AR(1) noise of 0.5, whose ρ_1 is 7 of its deviations."""
    rng = np.random.default_rng(4)
    white = rng.standard_normal(200)
    rho = [np.sum(white[k:] * white[: 200 - k]) / np.sum(white**2) for k in range(1, 11)]
    found = fitting.whiteness([white])
    assert found["statistic"] == pytest.approx(200 * 202 * sum(r * r / (200 - k) for k, r in enumerate(rho, 1)))
    assert found["p_value"] == pytest.approx(stats.chi2.sf(found["statistic"], 10))
    assert found["p_value"] > 0.01
    assert found["autocorrelation"] == pytest.approx(rho)
    for n in range(1, 200):
        white[n] += 0.5 * white[n - 1]
    assert fitting.whiteness([white])["p_value"] < 1e-6
    assert fitting.whiteness([np.zeros(200), white[:10]])["p_value"] is None


def between_walls(damping: float = 0.3) -> tmj.Scene:
    """A mass on a line between two walls, on two taut strings, let go beside its equilibrium."""
    structure = tmj.Structure(
        "between walls",
        {"a": (-1.0, 0.0, 0.0), "b": (1.0, 0.0, 0.0), "m": (0.1, 0.0, 0.0)},
        point_masses=(tmj.PointMass("m", 1.0),),
        strings=tuple(
            tmj.String(name, (wall, "m"), 30.0, rest_length=0.6, damping=damping)
            for name, wall in (("s1", "a"), ("s2", "b"))
        ),
        fixed_nodes=("a", "b"),
    )
    return tmj.Scene(structure, duration=2.0)


@pytest.mark.parametrize("engine", [tmj.DAE(), tmj.MuJoCo(timestep=1e-3)])
def test_derivatives_by_differences_are_those_of_the_oscillator(engine: Any) -> None:
    """The mass between walls is an oscillator of 2 k, 2 c and m. Differences of 1e-4 of a size are wrong by 1e-8/6 of a
    third derivative, 10² of the first, and by errors of runs of 1e-9 over 2e-4: less than the 1e-5 that is stated."""
    scene = between_walls()
    times = np.array([0.3, 0.5, 1.1, 2.0])
    run = tmj.simulate(scene, engine="dae", output_interval=0.1)
    seen = Observation.of(scene.structure, measured(Table(times, ("m",), run.nodes[[3, 5, 11, 20], 2:]), nodes=1.0))
    unknowns = Unknowns.of(
        scene, ["structure.strings.stiffness", "structure.strings.damping", "structure.point_masses.mass"]
    )
    model = predictions_of(unknowns, seen, engine)
    exact, numbers = oscillator(times), np.array([60.0, 0.6, 1.0])
    assert model.predict(unknowns.start)[:4] == pytest.approx(0.1 * exact.predict(numbers), abs=1e-8)
    ours = model.jacobian(unknowns.start)[:4] * unknowns.sizes
    theirs = 0.1 * exact.jacobian(numbers) * numbers
    assert np.abs(ours - theirs).max() < 1e-5 * np.abs(theirs).max()


def test_what_is_seen_too_badly_is_reported_with_how_badly() -> None:
    """σ of 0.5 of y = a + b t, t from 0 to 1 in 10,001 steps: σ_b = √12 σ / √n = 0.0173, of b = 0.01 1.73 of its size,
    and a is known to 0.01 of its size. The combination is b with a / a₀ = -½ b, b₀ = 0.01 being small beside a₀ = 1."""
    times = np.linspace(0, 1, 10_001)
    A = np.stack([np.ones_like(times), times], axis=1)
    case = problem(Formula(lambda p: A @ p, lambda p: A), "a b", [1.0, 0.01], times, A @ [1.0, 0.02], 0.5)
    with pytest.warns(IdentificationWarning, match=r"do not see: b \(better than ± 1.7 of its size\)$"):
        found = fit(case, FitOptions())
    assert column(found, "deviation")[1] == pytest.approx(np.sqrt(12 / 10_001) * 0.5, rel=1e-3)
    with pytest.warns(IdentificationWarning, match="held at their starts: b$"):
        fit(case, FitOptions(hold_unseen=True))


def test_jumps_of_dampers_are_differentiated_or_reported() -> None:
    """A mass that a damped string catches, against differences of an integrator that stops at each catch."""
    scene, times = caught_mass.bob(2.0), np.array([1.0, 2.0])
    seen = Observation.of(scene.structure, measured(Table(times, ("bob",), np.zeros((2, 1, 3))), nodes=1.0))
    unknowns = Unknowns.of(scene, ["structure.strings.damping"])
    low, high = (caught_mass.bob_at(times, 2.0 + change) for change in (-2e-4, 2e-4))
    exact = (high - low)[1] / 4e-4
    for engine in (tmj.DAE(), tmj.MuJoCo(timestep=1e-3, locate_slack=True)):
        with warnings.catch_warnings():
            warnings.simplefilter("error", IdentificationWarning)
            slope = predictions_of(unknowns, seen, engine).jacobian(unknowns.start)[1, 0]
        # Runs that differ by 4e-4 · 0.055 m are within 1e-8 m of the exact ones, 4e-4 of that.
        assert slope == pytest.approx(exact, rel=1e-3)
    with pytest.warns(IdentificationWarning, match="string 'string' has a damper and comes taut"):
        slope = predictions_of(unknowns, seen, tmj.MuJoCo(timestep=1e-3)).jacobian(unknowns.start)[1, 0]
    assert abs(slope / exact - 1) > 0.1


def noisy(run: tmj.Trajectory, seed: int, sigma: float = 1e-3) -> Table:
    rng = np.random.default_rng(seed)
    moved = run.nodes + sigma * rng.standard_normal(run.nodes.shape)
    return Table(run.time, tuple(run.scene.structure.node_names), moved)


def test_of_two_dampers_of_one_motion_their_sum_alone_is_seen() -> None:
    """Both strings lie on the line of the motion: forces are of c1 + c2, and of both tensions."""
    scene = between_walls()
    data = measured(noisy(tmj.simulate(scene, engine="dae", output_interval=0.02), 5), ["m"], nodes=1e-3)
    paths = ["structure.strings[*].damping=0.2"]
    with pytest.warns(IdentificationWarning, match=r"strings\[s1\].damping, .*strings\[s2\].damping"):
        found = identify(scene, data, paths, tmj.DAE())
    (unseen,) = found.data["before"]["unseen"]
    assert unseen.startswith("+1 strings[s1].damping, -1 strings[s2].damping (")
    assert "do not see" in repr(found)
    with pytest.warns(IdentificationWarning, match="held at their starts"):
        held = identify(scene, data, paths, tmj.DAE(), options=FitOptions(hold_unseen=True))
    assert re.search(r"damping +0.2 +0.2 +none +held at its start", repr(held))
    row = next(row for row in held.data["parameters"] if not row["note"])
    assert abs(sum(held.values.values()) - 0.6) < 4 * row["deviation"]
    # As one value of both it is seen, and so are tensions' own.
    shared = identify(scene, data, ["structure.strings.damping=0.2"], tmj.DAE())
    ((low, high),) = shared.intervals.values()
    assert 2 * shared.values["structure.strings.damping"] == pytest.approx(sum(held.values.values()), rel=1e-4)
    assert high - low < 0.1


def prism_at_work() -> tmj.Scene:
    """The prism on strings of k = 20 N/m, c = 0.5 N s/m, a fifth shorter than they are, so that all stay taut."""
    scene = tmj.load_scene("prism")
    lengths = scene.structure.string_lengths(scene.nodes0)
    strings = tuple(
        replace(one, stiffness=20.0, damping=0.5, force_density=None, rest_length=0.8 * float(length))
        for one, length in zip(scene.structure.strings, lengths, strict=True)
    )
    return scene.with_(structure=replace(scene.structure, strings=strings), duration=1.5, control=None, target=None)


PATHS = {
    "structure.strings[s1,s2,s3].stiffness": 20.0,
    "structure.strings[s9].damping": 0.5,
    "structure.strings[s5].rest_length": None,
    "structure.rods[rod2].mass": 1.0,
}


@pytest.fixture(scope="module")
def run() -> tmj.Trajectory:
    """Of MuJoCo, whose error is far below the noise of 1 mm."""
    found = tmj.simulate(prism_at_work(), engine="mujoco", timestep=1e-3, output_interval=0.03)
    assert found.tensions.min() > 0
    return found


@pytest.mark.slow
def test_parameters_of_another_engines_data_are_covered() -> None:
    """5 draws of noise on MuJoCo's run, fitted by the DAE from 15 % beside the truth; short, for 125 runs."""
    scene = prism_at_work().with_(duration=0.5)
    run = tmj.simulate(scene, engine="mujoco", timestep=1e-3, output_interval=0.02)
    assert run.tensions.min() > 0
    truth = np.array([20.0, 0.5, scene.structure.rest_lengths[4], 1.0])
    starts = [
        Parameter(path, start=value * off)
        for path, value, off in zip(PATHS, truth, (1.15, 0.85, 0.98, 1.15), strict=True)
    ]
    unknowns = Unknowns.of(scene, starts)
    model = predictions_of(unknowns, Observation.of(scene.structure, measured(run, nodes=1e-3)), tmj.DAE())
    found = []
    for seed in range(5):
        seen = Observation.of(scene.structure, measured(noisy(run, seed), nodes=1e-3))
        found.append(fit(Problem(model, unknowns, seen), FitOptions()))
    assert all(one["converged"] for one in found)
    inside, (low, high) = coverage(found, truth)
    assert np.all((low <= inside) & (inside <= high)), (inside, low, high)
    # χ² of all draws together has as many degrees of freedom as all of them: within 4 deviations √(2 ν) of ν.
    total, degrees = (sum(one[key] for one in found) for key in ("chi_squared", "degrees"))
    assert abs(total - degrees) < 4 * np.sqrt(2 * degrees)


def test_lengths_and_tensions_at_times_of_their_own_are_fitted(run: tmj.Trajectory, tmp_path: Path) -> None:
    """Of two files, one with gaps, the other between the samples: exact data give the truth, as far as runs agree."""
    times = np.array([0.0137, 0.2903, 0.5, 1.0011, 1.2104])
    fine = tmj.simulate(run.scene, engine="dae", output_interval=1e-4, duration=1.5)
    assert tmj.compare(run, fine).max_node_error < 1e-7
    at = np.searchsorted(fine.time, times - 1e-9)
    rows = [f"{t},{a},{b}" for t, a, b in zip(times, fine.tension("s1")[at], fine.length("s9")[at], strict=True)]
    rows[2] = f"{times[2]},,{fine.length('s9')[at][2]}"
    (tmp_path / "loads.csv").write_text("time,s1.tension,s9.length\n" + "\n".join(rows) + "\n", encoding="utf-8")
    data = measured(tmp_path / "loads.csv", tensions=0.01, lengths=1e-3), measured(run, ["n4"], nodes=1e-3)
    found = identify(
        run.scene, data, ["structure.strings[s1].stiffness=18", "structure.strings[s9].damping=*0.9"], tmj.DAE()
    )
    assert [one["label"] for one in found.data["series"]] == ["s9.length", "s1.tension", "n4.x", "n4.y", "n4.z"]
    assert [len(one["time"]) for one in found.data["series"][:2]] == [5, 4]
    # An estimate is off by at most its deviation times |δ/σ| of all errors δ of the data (Cauchy and Schwarz, J⁺ δ/σ):
    # 153 numbers of the other engine by 1e-4 σ each; 4 tensions, on straight lines over 1 ms, by h² T''/8 of a motion
    # of 10 rad/s and 2 N, 2.5e-5 N or 2.5e-3 σ: together below 6e-3.
    for row, truth in zip(found.data["parameters"], (20.0, 1.0), strict=True):
        assert abs(row["value"] - truth) < 6e-3 * row["deviation"]
    assert found.data["p_value"] == pytest.approx(1.0)
    assert found.scene.structure.strings[0].stiffness == pytest.approx(20.0, rel=1e-3)


@pytest.mark.parametrize("apart", [1e-6, 1e-9])
def test_two_clocks_a_moment_apart_take_no_more_samples(run: tmj.Trajectory, apart: float) -> None:
    """Interpolated over h = 1 ms: positions to h⁴/384 d⁴n/dt⁴, tensions to h² T''/8, as above."""
    times = np.sort(np.concatenate([np.arange(1, 11) * 0.1, np.arange(1, 11) * 0.1 + apart]))
    fine = tmj.simulate(run.scene, engine="dae", output_interval=1e-4, duration=1.1)
    at = np.searchsorted(fine.time, times - 1e-5)
    names, pulls = tuple(fine.scene.structure.node_names), {"s1": fine.tension("s1")[at]}
    table = Table(times, names, fine.nodes[at], tensions=pulls)
    seen = Observation.of(run.scene.structure, measured(table, nodes=1e-3, tensions=0.01))
    model = predictions_of(Unknowns.of(run.scene, ["structure.strings[s1].stiffness"]), seen, tmj.DAE())
    assert model._grid[1] == 1e-3
    off = model.predict(model.unknowns.start) - seen.values
    # Where `apart` is 1e-6 s, what the table has is at the sample before: at 0.3 m/s and 3 N/s.
    assert np.abs(off[seen.columns < 18]).max() < 1e-8 + apart
    assert np.abs(off[seen.columns >= 18]).max() < 2.5e-5 + 10 * apart


def test_a_fit_goes_on_where_it_was_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = between_walls()
    data = noisy(tmj.simulate(scene, engine="dae", output_interval=0.05), 6)
    paths = ["structure.strings.stiffness=25", "structure.strings.damping=0.2"]
    whole = identify(scene, data, paths, tmj.DAE())
    counted, simulate = itertools.count(), predictions.simulate

    def stopped(*args: Any, **options: Any) -> Any:
        if next(counted) == 12:
            raise KeyboardInterrupt
        return simulate(*args, **options)

    def interrupted(*args: Any, **options: Any) -> Any:
        raise KeyboardInterrupt

    monkeypatch.setattr(predictions, "simulate", stopped)
    with monkeypatch.context() as at_once:
        at_once.setattr(predictions, "simulate", interrupted)
        with pytest.raises(KeyboardInterrupt, match=r"^nothing is kept: give a folder"):
            identify(scene, data, paths, tmj.DAE())
    with pytest.raises(KeyboardInterrupt, match="kept in"):
        identify(scene, data, paths, tmj.DAE(), folder=tmp_path)
    first = next(counted)
    found = identify(scene, data, paths, tmj.DAE(), folder=tmp_path)
    # Of the first call, at most the Jacobian that it was stopped in, of four runs, is computed again.
    monkeypatch.setattr(predictions, "simulate", lambda *args, **options: pytest.fail("it is kept"))
    again = identify(scene, data, paths, tmj.DAE(), folder=tmp_path)
    assert first == 13
    assert json.dumps(found.data) == json.dumps(whole.data) == json.dumps(again.data)
    assert json.loads((tmp_path / "identification.json").read_text("utf-8"))["runs"] == found.data["runs"]
    shown = (tmp_path / "identification.html").read_text("utf-8")
    assert "strings.stiffness" in shown
    assert "Measured (dots)" in shown
    with pytest.raises(OptionError, match="another study"):
        identify(scene, data, paths[:1], tmj.DAE(), folder=tmp_path)


def test_verdicts_are_good_where_both_tails_and_the_run_are() -> None:
    series = [{"time": [0.0], "unit": "m"}]
    data: dict[str, Any] = {"parameters": [], "series": series, "converged": True, "runs": 3, "doubts": []}
    data |= {"p_value": 0.5, "chi_squared": 9.3, "degrees": 10, "estimated_noise": None, "after": {"unseen": []}}
    data |= {"whiteness": {"p_value": 0.5, "lags": 2}}

    def marks(**changes: Any) -> list[str]:
        return [mark.value for mark, _ in result.verdicts(data | changes)]

    assert marks() == ["good", "good", "good"]
    # A fit without residuals shows noise that was given too large, or a run that was compared with itself.
    assert marks(p_value=1.0, chi_squared=0.0)[1] == "limited"
    assert marks(p_value=1e-3)[1] == "limited"
    assert marks(doubts=["the energy balance is off"])[0] == "limited"
    assert marks(converged=False)[0] == "bad"
    assert {one.mark.value for one in result.judgement_of(data | {"converged": False}).findings} == {"limited"}
    # Nothing was given to hold an estimated noise against.
    assert marks(p_value=None, estimated_noise=0.3)[1] == "not judged"


def test_the_picture_has_all_that_it_tells() -> None:
    parameters = [{"name": "k", "value": 4.0, "deviation": 0.1, "low": 3.8, "high": 4.2, "start": 5.0}]
    seen = {"before": [0.0, 0.25, 40.0], "after": [3.0]}
    data: dict[str, Any] = {name: {"eigenvalues": values} for name, values in seen.items()} | {"parameters": parameters}
    data["whiteness"] = {"lags": 2, "autocorrelation": [0.1, -0.2], "bound": 0.3}
    left, middle, right = result._information_figure(data).axes
    assert [line.get_ydata().tolist() for line in left.get_lines() if line.get_marker() == "x"] == [[0]]
    assert [line.get_xdata().tolist() for line in left.get_lines() if line.get_marker() == "x"] == [[1.25]]
    drawn = [line.get_ydata() for line in middle.get_lines()]
    # All that is positive: a logarithmic axis has no other.
    assert [values[np.isfinite(values)].tolist() for values in drawn] == [[0.25, 40.0], [3.0]]
    assert [line.get_label() for line in middle.get_lines()] == ["before", "after"]
    assert [bar.get_height() for bar in right.patches] == [0.1, -0.2]
    assert sorted(line.get_ydata()[0] for line in right.get_lines()) == [-0.3, 0.3]


def test_the_run_with_the_estimates_is_looked_at() -> None:
    scene = between_walls()
    data = noisy(tmj.simulate(scene, engine="dae", output_interval=0.1), 6)
    # ω = √(2 k/m) = 7.7/s: steps of 0.1 s err by z⁵/120 = 0.2 % of the amplitude each, ten times what 20 steps may.
    found = identify(scene, data, ["structure.strings.stiffness=25"], tmj.DAE(method=tmj.Method.RK4, timestep=0.1))
    sound = identify(scene, data, ["structure.strings.stiffness=25"], tmj.DAE())
    assert sound.data["doubts"] == []
    assert found.data["doubts"]
    assert "the run with the estimates is in doubt" in found.judgement.verdict


def test_friction_is_found_by_the_engine_that_has_it() -> None:
    """A rod thrown along a floor is slowed by μ g: exact data of MuJoCo's give its μ back."""
    scene = tmj.load_scene("prism_drop").with_(duration=0.6)
    run = tmj.simulate(scene, engine="mujoco", timestep=1e-3, output_interval=0.02)
    truth = scene.contact.friction
    found = identify(
        scene, measured(run, nodes=1e-3), [f"scene.contact.friction={1.2 * truth}"], tmj.MuJoCo(timestep=1e-3)
    )
    (row,) = found.data["parameters"]
    assert abs(row["value"] - truth) < 0.1 * row["deviation"]
    with pytest.raises(OptionError, match="contact"):
        identify(scene, run, ["scene.contact.friction"], tmj.ODE())


CASES: dict[str, tuple[list[Any], str]] = {
    "structure.strings[s9].stifness": ([], "did you mean 'stiffness'"),
    "structure.strings[s9].stiffness=1:2": ([], "write PATH, PATH=START"),
    "structure.strings[s1].stiffness=40:0:20": ([], "its start 40 is not within 0 to 20"),
    "law.decay_rate": ([], "a part of structure, scene, plant"),
    "structure.strings.rest_length": ([], r"3 values; give a start, or a factor on each: .*=\*1"),
    "structure.strings[s1].stiffness": (["structure.strings[s1].stiffness=2"], "given twice"),
}


@pytest.mark.parametrize("text", CASES)
def test_parameters_that_mean_nothing_are_refused(text: str, run: tmj.Trajectory) -> None:
    more, message = CASES[text]
    with pytest.raises(OptionError, match=message):
        identify(run.scene, run, [text, *more])


def test_what_is_of_another_kind_is_refused(run: tmj.Trajectory) -> None:
    path = ["structure.strings.stiffness"]
    for given, options, message in (
        ((run, [3]), {}, "parameters = 3; use a Parameter"),
        ((run, path[0]), {}, "parameters = 'structure.strings.stiffness'.* sequence"),
        ((run, path), {"options": {"level": 0.9}}, r"options = .*; use FitOptions\(...\)"),
        ((np.array([0.4, 0.5]), path), {}, r"measurements = array\(\[0.4, 0.5\]\); use a run"),
    ):
        with pytest.raises(OptionError, match=message):
            identify(run.scene, *given, **options)
    with pytest.raises(OptionError, match=r"members = 'n1'.* sequence"):
        measured(run, "n1")


def test_numbers_that_are_infinite_or_too_few_are_refused(run: tmj.Trajectory) -> None:
    table = noisy(run, 0)
    moved = table.positions.copy()
    moved[3, 1, 2] = np.inf
    with pytest.raises(OptionError, match=rf"{table.nodes[1]}.z at 0.09 s is inf; NaN marks"):
        identify(run.scene, Table(table.time, table.nodes, moved), ["structure.strings.stiffness"])
    pull = Table(run.time[[0, 5]], (), np.zeros((2, 0, 3)), tensions={"s1": run.tension("s1")[[0, 5]]})
    names = ["structure.strings[s1].stiffness", "structure.strings[s2].stiffness"]
    with pytest.raises(OptionError, match="2 numbers do not determine 2 parameters and the noise"):
        identify(run.scene, pull, names, tmj.DAE())
    with pytest.warns(IdentificationWarning):  # noise that is known leaves the third to its prior
        found = identify(run.scene, measured(pull, tensions=0.01), [*names, "structure.rods[rod2].mass"], tmj.DAE())
    assert found.data["degrees"] == -1


def test_a_warning_is_a_line_of_its_own_beside_a_bar(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", screen := io.StringIO())
    with tqdm(desc="fit", file=sys.stderr), warnings.catch_warnings():
        warnings.simplefilter("always")
        monkeypatch.setattr(warnings, "showwarning", lambda message, *_: screen.write(f"{message}\n"))
        warn_caller("not seen", IdentificationWarning)
    assert "\rnot seen\n" in screen.getvalue()


def test_measurements_that_mean_nothing_are_refused(run: tmj.Trajectory) -> None:
    path, table = ["structure.strings.stiffness"], noisy(run, 0)
    strange = Table(table.time, ("n9",), table.positions[:, :1])
    pulls = Table(
        table.time, (), table.positions[:, :0], tensions={"s1": run.tension("s1")}, lengths={"s1": run.length("s1")}
    )
    for data, message in (
        ([], "there is none"),
        (strange, "no node 'n9'"),
        (pulls, "has lengths, tensions: name what counts"),
        (measured(pulls, tensions=None, lengths=None), "give the noise of all"),
        ([measured(table, nodes=1e-3), measured(pulls, tensions=None)], "give the noise of all"),
        (Table(np.array([-1.0, 1.0]), table.nodes, table.positions[:2]), "runs begin at 0 s"),
    ):
        with pytest.raises(OptionError, match=message):
            identify(run.scene, data, path)
    for options, message in (({"tension": 1.0}, "did you mean 'tensions'"), ({"nodes": -1.0}, "sigma of nodes = -1.0")):
        with pytest.raises(OptionError, match=message):
            measured(run, **options)
    with pytest.raises(OptionError, match="node or string 'n7'"):
        measured(run, ["n7"])


def test_the_command_fits_and_writes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = between_walls()
    tmj.save_scene(scene, tmp_path / "scene.toml")
    tmj.simulate(scene, engine="dae", output_interval=0.05).save(tmp_path / "run.nc")
    words = f"identify {tmp_path}/scene.toml --data {tmp_path}/run.nc --engine dae --sigma 1e-3 --members m"
    more = ["--parameter", "structure.strings[s1].stiffness=28:1:90", "--out", f"{tmp_path}/fit"]
    assert main([*words.split(), *more, "--scene-out", f"{tmp_path}/found.toml", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["status"] == "completed"
    # Runs of one engine at the same times: nothing but the fit's own tolerance is between them.
    assert found["parameters"][0]["value"] == pytest.approx(30.0, rel=1e-6)
    assert tmj.load_scene(tmp_path / "found.toml").structure.strings[0].stiffness == found["parameters"][0]["value"]
    assert (tmp_path / "fit" / "identification.html").is_file()
    # Of several files, each takes what it has; what the data do not see is said in a line.
    (tmp_path / "lengths.csv").write_text("time,s1.length\n0.1,1.0\n0.5,1.1\n", encoding="utf-8")
    (tmp_path / "pulls.csv").write_text("time,s1.tension,s2.tension\n0.2,12,12\n0.5,15,9\n", encoding="utf-8")
    command = f"identify {tmp_path}/scene.toml --data {tmp_path}/lengths.csv --data {tmp_path}/pulls.csv --engine dae"
    command += " --sigma lengths=1e-3 --sigma tensions=0.1 --members s1"
    unseen = "--parameter structure.strings.damping=0.2 --parameter structure.nodes[b].y --hold-unseen".split()
    assert main([*command.split(), *unseen, "--json"]) == 0
    answer = capsys.readouterr()
    assert [one["label"] for one in json.loads(answer.out)["series"]] == ["s1.length", "s1.tension"]
    assert "\nwarning: the measurements do not see" in f"\n{answer.err}"
    assert main([*command.replace("--sigma tensions", "--sigma nodes").split(), *unseen]) == 2
    assert "no quantity 'nodes'" in capsys.readouterr().err
    assert main([*command.replace("--members s1", "--members s3").split(), *unseen]) == 2
    assert "no node or string 's3'" in capsys.readouterr().err
    for wrong, message in (
        ("--sigma 1e-3 --sigma 2e-3", "--sigma: a quantity is given twice"),
        ("--sigma 1mm", "1mm"),
        ("--level 2", "between 0 and 1"),
        ("--actuation hold-rest-length --control-period 0.1", "without a law"),
    ):
        assert main([*words.replace("--sigma 1e-3 ", "").split(), *more[:2], *wrong.split()]) == 2
        assert message in capsys.readouterr().err
