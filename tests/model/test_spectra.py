"""Irregular seas: their energy, their peak, what their components keep of it, and what is measured of a run of them.

Truth is the spectrum as it is published, written down here, SciPy's adaptive quadrature of it, and closed forms.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad

import tensegrity_mj as tmj
from tensegrity_mj.commands.scenes import describe
from tensegrity_mj.errors import OptionError, SceneError
from tensegrity_mj.model import IrregularSea
from tensegrity_mj.model.elements.water import sea_of
from tensegrity_mj.model.text.reading import scene_from_toml
from tensegrity_mj.model.text.writing import scene_to_toml
from tensegrity_mj.studies.parameters import Draft

HEIGHT, PERIOD = 2.5, 9.0
PEAK = 2 * math.pi / PERIOD
VARIANCE = HEIGHT**2 / 16
SEAS = {
    "pierson": IrregularSea("pierson_moskowitz", HEIGHT, PERIOD),
    "jonswap": IrregularSea("jonswap", HEIGHT, PERIOD),
    "sharp": IrregularSea("jonswap", HEIGHT, PERIOD, peak_enhancement=7.0),
    "broad": IrregularSea("jonswap", HEIGHT, PERIOD, peak_enhancement=1.5),
    "none": IrregularSea("jonswap", HEIGHT, PERIOD, peak_enhancement=1.0),
}
GAMMA = {"pierson": 1.0, "jonswap": 3.3, "sharp": 7.0, "broad": 1.5, "none": 1.0}


def published(name: str, omega: float) -> float:
    """The spectrum of Hasselmann et al. (1973), whose energy is left to be found."""
    width = 0.07 if omega <= PEAK else 0.09
    peaked = GAMMA[name] ** math.exp(-((omega - PEAK) ** 2) / (2 * width**2 * PEAK**2))
    return 5 / 16 * HEIGHT**2 * PEAK**4 * omega**-5 * math.exp(-1.25 * (PEAK / omega) ** 4) * peaked


def energy(name: str, low: float, high: float) -> float:
    """∫ of `published`, split at the kink of the peak and where it bends; to 1e-11, which quad reports."""
    cuts = [low, *(x * PEAK for x in (0.6, 0.8, 1.0, 1.2, 1.6, 3.0) if low < x * PEAK < high), high]
    parts = (quad(lambda w: published(name, w), *pair, epsabs=1e-13, epsrel=1e-12) for pair in pairwise(cuts))
    return sum(part for part, _ in parts)


@pytest.mark.parametrize("name", SEAS)
def test_the_spectrum_is_the_published_one_with_the_energy_of_the_height(name: str) -> None:
    # The midpoint rule with cells of h = 2e-5 errs by at most h²/24 of the largest |d²/de² γ^r|, which is that at the
    # peak: 7 ln 7 / 0.07² / (ω_p de/dω)² for γ = 7, with ω_p de/dω = 5 e^(-5/4): 2.3e-8 in all.
    whole = energy(name, 0.05 * PEAK, math.inf)
    for omega in PEAK * np.array([0.5, 0.9, 1.0, 1.05, 2.0, 6.0]):
        expected = published(name, omega) * VARIANCE / whole
        assert float(SEAS[name].density(omega)) == pytest.approx(expected, rel=2.3e-8)
    if name == "pierson":
        assert whole == pytest.approx(VARIANCE, rel=1e-10)


@pytest.mark.parametrize("name", SEAS)
def test_the_peak_is_at_the_peak_period(name: str) -> None:
    near = PEAK * (1 + np.linspace(-1e-2, 1e-2, 2001))  # on the grid, the peak itself
    found = near[int(np.argmax(SEAS[name].density(near)))]
    assert found == pytest.approx(PEAK, rel=1e-12)


@pytest.mark.parametrize("name", SEAS)
@pytest.mark.parametrize("count", [1, 7, 100, 1000])
def test_components_have_the_energy_of_the_sea_each_where_its_bin_is_halved(name: str, count: int) -> None:
    sea = IrregularSea(SEAS[name].spectrum, HEIGHT, PERIOD, 3, count, 0.4, SEAS[name].peak_enhancement)
    assert sum(wave.amplitude**2 for wave in sea.waves) / 2 == pytest.approx(VARIANCE, rel=1e-12)
    assert {wave.direction for wave in sea.waves} == {0.4}
    whole = energy(name, 0.05 * PEAK, math.inf)
    for number in {0, count // 3, count - 1}:
        # Interpolation in a cell of h = 2e-5 of e: h²/8 times the slope of γ^r, below 7 ln 7 / 0.07 / 1.4 / 1.6 = 90.
        part = energy(name, 0.05 * PEAK, float(sea.frequencies[number])) / whole
        assert part == pytest.approx((number + 0.5) / count, abs=3e-8)


def test_what_the_components_lose_of_the_tail_is_as_stated() -> None:
    """With x the energy above ω, ω² = ω_p² √(5/4) (-ln(1 - x))^(-½), which is x^(-½) (1 + O(x)) in the tail.

    Midpoints of N cells err by ζ(½, ½) √h = (√2 - 1) ζ(½) √h of ∫ x^(-½) dx, and by less than h where the rest is
    smooth or falls to 0 at once, at either end. The integral of the whole is √(5/4) √π.
    """
    for count in (25, 100, 400, 1000):
        sea = IrregularSea("pierson_moskowitz", HEIGHT, PERIOD, components=count)
        second = float(np.mean(sea.frequencies**2)) / (PEAK**2 * math.sqrt(1.25 * math.pi))
        lost = (math.sqrt(2) - 1) * -1.4603545 / math.sqrt(math.pi * count)
        assert second - 1 == pytest.approx(lost, abs=1 / count)
        assert lost == pytest.approx(-0.341 / math.sqrt(count), rel=1e-3)  # the docs' number


@pytest.mark.parametrize(("seed", "name"), [(0, "pierson"), (5, "jonswap")])
def test_the_height_of_three_hours_is_the_significant_one(seed: int, name: str) -> None:
    """The mean square over T differs from H_s²/16 by what does not cancel, within four standard deviations of it.

    That is A²/2 sinc of half of each difference and sum of frequencies times T, of independent phases. Samples of 0.5 s
    take sums of frequencies of up to 5.6 rad/s, so that none is mistaken for a slow one (2 π/0.5 s = 12.6 rad/s).
    """
    sea = IrregularSea(SEAS[name].spectrum, HEIGHT, PERIOD, seed)
    T, spacing = 10800.0, 0.5
    time = spacing * (np.arange(int(T / spacing)) + 0.5) - 0.5 * T
    water = tmj.model.Sea.of(sea.waves, 9.81)
    elevation = water.elevation(time, 12.0, 3.0)
    omega, half = sea.frequencies, 0.5 * sea.waves[0].amplitude ** 2
    i, j = np.triu_indices(len(omega), 1)
    kept = [half * np.sinc((omega[i] + sign * omega[j]) * T / (2 * np.pi)) for sign in (-1, 1)]
    alone = half * np.sinc(omega * T / np.pi)
    deviation = math.sqrt(0.5 * (2 * (np.sum(kept[0] ** 2) + np.sum(kept[1] ** 2)) + np.sum(alone**2)))
    assert abs(float(np.mean(elevation**2)) - VARIANCE) < 4 * deviation
    assert 4 * float(np.std(elevation)) == pytest.approx(HEIGHT, rel=0.05)
    assert deviation < 0.02 * VARIANCE  # the test says something


def test_a_seed_decides_the_phases_and_nothing_else() -> None:
    one, again, other = (IrregularSea("jonswap", 1.0, 6.0, seed).waves for seed in (0, 0, 1))
    assert one == again
    assert [wave.phase for wave in one] != [wave.phase for wave in other]
    assert [wave.angular_frequency for wave in one] == [wave.angular_frequency for wave in other]
    # The Mersenne twister's first numbers for the seed 0, as they stand everywhere.
    first = np.array([wave.phase for wave in one[:3]]) / (2 * math.pi)
    np.testing.assert_allclose(first, [0.5488135, 0.71518937, 0.60276338], atol=5e-9)


def scene(**water: Any) -> tmj.Scene:
    rod = tmj.Rod("r", ("a", "b"), 5.0, 0.05, tmj.Support.pinned(0.5))
    structure = tmj.Structure("held", {"a": (0.0, -0.5, -1.0), "b": (0.0, 0.5, -1.0)}, (rod,))
    return tmj.Scene(structure, gravity=(0, 0, -9.81), duration=0.2, water=tmj.Water(**water))


def test_a_sea_adds_to_waves_and_has_the_depth_of_the_water() -> None:
    sea, wave = IrregularSea("jonswap", 1.0, 6.0, components=20), tmj.model.Wave(0.3, 20.0)
    shallow = sea_of(scene(waves=(wave,), sea=sea, depth=4.0))
    assert len(shallow.amplitude) == 21
    np.testing.assert_array_equal(shallow.frequency[1:], sea.frequencies)
    k = shallow.number
    np.testing.assert_allclose(9.81 * k * np.tanh(4 * k), shallow.frequency**2, rtol=1e-14)  # some ulp
    both = sea_of(scene(waves=(wave, *sea.waves), depth=4.0))
    np.testing.assert_array_equal(shallow.elevation(3.0, 1.0, 2.0), both.elevation(3.0, 1.0, 2.0))


def test_files_hold_a_sea_and_sweeps_set_it() -> None:
    sea = IrregularSea("jonswap", 2.0, 8.0, 1, 50, 0.3)
    made = scene(sea=sea, above="constant")
    text = scene_to_toml(made)
    assert 'sea = { spectrum = "jonswap", significant_height = 2.0, peak_period = 8.0, seed = 1' in text
    again = scene_from_toml(text)
    assert again.water == made.water
    assert "jonswap sea of H_s = 2 m and T_p = 8 s, 50 components, seed 1, towards 17.19°" in describe(made)["water"]
    higher = Draft(made).apply({"scene.water.sea.significant_height": 3.0, "scene.water.sea.seed": 7}).scene
    assert higher.water is not None
    assert higher.water.sea == IrregularSea("jonswap", 3.0, 8.0, 7, 50, 0.3)
    with pytest.raises(OptionError, match="water has no sea"):
        Draft(scene()).apply({"scene.water.sea.seed": 7})


def test_a_run_states_the_numbers_of_the_peak_and_where_the_theory_ends() -> None:
    """The rod is held across the waves, so that its speed is the water's; the period is T_p, that of the peak."""
    sea = IrregularSea("jonswap", 1.0, 6.0, 2)
    run = tmj.simulate(scene(sea=sea), engine=tmj.DAE())
    numbers = tmj.runs.flow_numbers(run)
    # Rn = u d / ν and KC = u T / d: KC = Rn ν T / d².
    assert numbers.keulegan_carpenter[0] == pytest.approx(numbers.reynolds[0] * 1.19e-6 * 6.0 / 0.1**2, rel=1e-12)
    assert any('give above = "constant"' in note for note in numbers.notes)
    held = tmj.simulate(scene(sea=sea, above="constant"), engine=tmj.DAE())
    assert not any("above" in note for note in tmj.runs.flow_numbers(held).notes)
    steep = tmj.simulate(scene(sea=IrregularSea("jonswap", 4.0, 1.0, components=1)), engine=tmj.DAE())
    assert any(note.startswith("component 0 of the sea is") for note in tmj.runs.flow_numbers(steep).notes)


def test_a_sea_that_is_steeper_than_waves_can_be_is_noted() -> None:
    """2π H_s/(g T_p²) = 1/7 at T_p = 4 s: H_s = 3.57 m."""
    limit = 9.81 * 4.0**2 / (7 * 2 * np.pi)
    for height, noted in ((0.99 * limit, False), (1.01 * limit, True)):
        run = tmj.simulate(scene(sea=IrregularSea("jonswap", height, 4.0, 2)), engine=tmj.DAE(), duration=0.1)
        notes = " ".join(tmj.runs.flow_numbers(run).notes)
        assert ("2π H_s/(g T_p²) = 0.144; waves above 1/7 break" in notes) == noted


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"spectrum": "bretschneider"}, "spectrum = 'bretschneider'; it must be one of"),
        ({"significant_height": 0.0}, "significant_height = 0.0; it must be > 0 m"),
        ({"peak_period": -1.0}, "peak_period = -1.0; it must be > 0 s"),
        ({"seed": -1}, "seed = -1; it must be an integer from 0"),
        ({"components": 1001}, "components = 1001; it must be an integer from 1 to 1000"),
        ({"peak_enhancement": 9.0}, r"peak_enhancement = 9.0; it must be within \[1, 7\], or None for 3.3"),
        ({"spectrum": "pierson_moskowitz", "peak_enhancement": 2.0}, "has no peak_enhancement: leave it out"),
    ],
)
def test_what_is_no_sea_is_refused(options: dict[str, Any], said: str) -> None:
    with pytest.raises(SceneError, match="sea: .*" + said):
        IrregularSea(**({"spectrum": "jonswap", "significant_height": 1.0, "peak_period": 6.0} | options))


def test_a_sea_needs_gravity() -> None:
    with pytest.raises(SceneError, match="waves without gravity"):
        scene(sea=IrregularSea("jonswap", 1.0, 6.0)).with_(gravity=(0, 0, 0))
