"""Measures of chapter 3 on made-up motions, and the linear hanging chain against other ways to it. No engine runs."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hanging_chain import HangingChain, linear_model
from modal_superposition import response

from evidence.cable.amplitude import extremes, response_amplitude, whirl
from evidence.cable.chain import Chain
from evidence.cable.spectrum import Peak, PeakCriteria, Spectrum, peaks_of, picked, spectrum
from evidence.families.cables import refined
from tensegrity_mj.errors import OptionError
from tensegrity_mj.library.cable import Excitation, Start, cable

T = np.arange(0.0, 45.0 + 1e-9, 0.02)


# ------------------------------------------------------------------------------------------------------- amplitude


@pytest.mark.parametrize(("frequency", "phase"), [(0.3, 0.2), (1.2, 1.0), (3.0, -0.4)])
def test_amplitude_of_a_harmonic(frequency: float, phase: float) -> None:
    """2 a. Hermite's cubic is off by (ω h)⁴/384 of a at each end (h = 0.02 s)."""
    omega = 2 * np.pi * frequency
    x, v = 0.7 * np.sin(omega * T + phase), 0.7 * omega * np.cos(omega * T + phase)
    small = (omega * 0.02) ** 4
    assert response_amplitude(T, x, v) == pytest.approx(1.4, abs=1.4 * small / 384 + 1e-14)
    found = extremes(T, x, v)
    turns = (np.arange(1000) + 0.5) * np.pi - phase
    turns = turns[(turns > 0) & (turns < omega * 45.0)] / omega
    # The cubic's slope vanishes where its own error of order three in the slope, (ω h)³/100 of a ω, puts it.
    np.testing.assert_allclose(found.time, turns, atol=(omega * 0.02) ** 3 / omega)


def test_amplitude_is_that_of_successive_peaks_only() -> None:
    """A drifting motion a sin ωt + c t: from ωt = -θ to θ, cos θ = -c/(a ω), not between any two of its peaks."""
    a, c, omega = 0.7, 0.3, 2 * np.pi * 0.3
    x, v = a * np.sin(omega * T) + c * T, a * omega * np.cos(omega * T) + c
    turn = np.arccos(-c / (a * omega))
    rise = 2 * a * np.sin(turn) + 2 * c * turn / omega
    found = extremes(T, x, v)
    assert found.amplitude == pytest.approx(rise, abs=2 * a * (omega * 0.02) ** 4 / 384 + 1e-13)
    assert np.all(np.diff(np.sign(np.diff(found.value))) != 0)
    assert np.ptp(found.value) > 5 * rise


def test_extremes_of_a_cubic_are_exact() -> None:
    """t³ - 3 t turns at ∓1, at ±2, however far samples are apart."""
    t = np.array([-2.3, -0.4, 0.7, 2.2])
    found = extremes(t, t**3 - 3.0 * t, 3.0 * t**2 - 3.0)
    np.testing.assert_allclose(found.time, [-1.0, 1.0], atol=1e-13)
    np.testing.assert_allclose(found.value, [2.0, -2.0], atol=1e-13)


def test_an_extreme_on_a_sample_counts_once() -> None:
    t = np.linspace(0.0, 4.0, 5)
    x, v = [0.0, 1.0, 0.0, -1.0, 0.0], [np.pi / 2, 0.0, -np.pi / 2, 0.0, np.pi / 2]
    found = extremes(t, x, v)
    np.testing.assert_allclose(found.time, [1.0, 3.0], atol=1e-12)
    np.testing.assert_allclose(found.value, [1.0, -1.0], atol=1e-12)
    # A plateau of samples, where the rate is zero for long: two extremes that follow each other, and no more.
    assert len(extremes(np.arange(6.0), [0, 1, 1, 1, 0, -1], [1, 0, 0, 0, -1, -1]).time) == 1


def test_a_motion_without_two_peaks_has_no_amplitude() -> None:
    assert response_amplitude(T, T, np.ones_like(T)) == 0.0
    assert response_amplitude(T, (T - 20.0) ** 2, 2.0 * (T - 20.0)) == 0.0
    assert response_amplitude(T, np.zeros_like(T), np.zeros_like(T)) == 0.0


@pytest.mark.parametrize(
    "arguments",
    [([0, 1], [0], [0, 1]), ([0, 0], [0, 1], [0, 1]), ([0, 1], [0, math.nan], [0, 1]), ([0, 1], [0, 1], [0])],
)
def test_bad_motions_are_refused(arguments: tuple) -> None:
    with pytest.raises(OptionError, match="extremes"):
        extremes(*arguments)


# -------------------------------------------------------------------------------------------------------- spectrum


def test_a_spectrum_holds_the_power_of_the_motion() -> None:
    """Parseval: its integral is the variance, for a harmonic of whole bins a²/2; the window's leakage is far below."""
    f = 14 / 45.02  # whole cycles in the record of 2251 samples
    x = 0.3 * np.sin(2 * np.pi * f * T) + 1.7
    found = spectrum(T, x)
    assert np.sum(found.density) * found.frequency[1] == pytest.approx(0.3**2 / 2, rel=1e-6)
    assert found.density[0] < 1e-12  # no mean


@pytest.mark.parametrize("frequency", [0.2513, 0.3241, 0.7, 0.9329, 1.187])
def test_peaks_lie_where_the_motion_is(frequency: float) -> None:
    """Within 0.04 bins of 1/45 Hz, wherever it lies between bins."""
    x = np.sin(2 * np.pi * frequency * T + 0.3)
    peaks = peaks_of(spectrum(T, x))
    assert peaks[0].frequency == pytest.approx(frequency, abs=0.04 / 45)
    # Side lobes of Hann's window are below 7e-4 of the peak: the bound of 1e-3 leaves this one alone.
    assert len(peaks) == 1


def test_peaks_of_two_harmonics_have_their_ratio() -> None:
    """Powers as the squares of amplitudes. Midway between bins the window's main lobe is 0.7205, 0.7205 and 0.0288, the
    parabola's vertex 1.077: a peak's height is right to 8 %."""
    x = np.sin(2 * np.pi * 0.3333 * T) + 0.2 * np.sin(2 * np.pi * 0.9 * T)
    large, small = peaks_of(spectrum(T, x))
    assert small.density / large.density == pytest.approx(0.04, rel=0.08)


def test_the_two_criteria_pick_as_the_thesis_says() -> None:
    """The largest of each run; those above 10 % of it; and those above 1 % of the largest of all runs."""
    runs = [
        (Peak(0.3, 100.0), Peak(0.7, 9.0), Peak(0.9, 0.9)),  # 9 % of its own, but 9 % of all: by the global criterion
        (Peak(0.3, 0.5), Peak(0.8, 0.06), Peak(1.0, 0.04)),  # below 1 % of all: the largest, and 12 %, but not 8 %
        (),
    ]
    assert [[peak.frequency for peak in row] for row in picked(runs)] == [[0.3, 0.7], [0.3, 0.8], []]
    only = PeakCriteria(local=1.0, overall=1.0)
    assert [len(row) for row in picked(runs, only)] == [1, 1, 0]
    with pytest.raises(OptionError, match="local"):
        PeakCriteria(local=0.0)


def test_spectra_need_equal_distances() -> None:
    with pytest.raises(OptionError, match="equal distances"):
        spectrum(np.concatenate([T[:50], T[60:]]), np.zeros(len(T) - 10))
    assert peaks_of(Spectrum(np.arange(4.0), np.zeros(4))) == ()


# -------------------------------------------------------------------------------------------------------- whirling


def test_whirling_of_ellipses() -> None:
    """2 a b / (a² + b²), signed, over whole periods to the sampling's 1e-3; 0 along a line."""
    w = 2 * np.pi * 0.8
    for a, b in ((1.0, 1.0), (1.0, -0.5), (1.0, 0.0)):
        x, y = a * np.cos(w * T), b * np.sin(w * T)
        found = whirl(T, x, y, 1.25, (-a * w * np.sin(w * T), b * w * np.cos(w * T)))
        assert found.turning == pytest.approx(2 * a * b / (a * a + b * b), abs=1e-3)


def test_growth_out_of_the_plane() -> None:
    """e^(0.2 t) from 1e-6: its rate, until it is a tenth of the motion in the plane; the same from another seed."""
    w = 2 * np.pi * 0.8
    for seed in (1e-6, 1e-4):
        out = seed * np.exp(0.2 * T) * np.sin(w * T)
        found = whirl(T, np.cos(w * T), out, 1.25, (-w * np.sin(w * T), np.gradient(out, T)))
        assert found.growth == pytest.approx(0.2, rel=2e-3)
        # Windows of one period: the last over the first of them, 35 periods later.
        assert found.gain == pytest.approx(math.exp(0.2 * 35 * 1.25), rel=2e-2)
    none = np.zeros_like(T)
    assert math.isnan(whirl(T, np.cos(w * T), none, 1.25, (-w * np.sin(w * T), none)).growth)
    with pytest.raises(OptionError, match="window"):
        whirl(T, T, T, 30.0, (T, T))


# ------------------------------------------------------------------------------------------------ chain and markers


@pytest.mark.parametrize("elements", [3, 7, 13, 25, 40, 121])
def test_markers_of_any_number_of_elements(elements: int) -> None:
    """Each is on the straight line between the nodes beside it: rows of two neighbours at most, which sum to one."""
    chain = Chain.of(cable(elements, excitation=Excitation.NONE).structure)
    places = [0.13 + 0.25 * number for number in range(2, 12)]
    W = chain.weights(places)
    assert all(np.ptp(np.flatnonzero(np.abs(row) > 1e-12)) <= 1 for row in W)
    assert W.min() >= 0.0
    np.testing.assert_allclose(W @ chain.arc_lengths, places, atol=1e-13)
    np.testing.assert_allclose(W.sum(axis=1), 1.0, atol=1e-14)


def test_places_beyond_the_chain_are_refused() -> None:
    chain = Chain.of(cable(13, excitation=Excitation.NONE).structure)
    with pytest.raises(OptionError, match="within the chain"):
        chain.weights([2.94])


# ------------------------------------------------------------------------------------------------------ modal model


def thesis_chain(divisions: int = 1) -> HangingChain:
    return linear_model(cable(refined(divisions), excitation=Excitation.NONE))


def test_mass_matrix_by_node_displacements() -> None:
    """Another way to M, c and G: each rod's own mass matrix m/6 [[2, 1], [1, 2]] in its ends' transverse motions."""
    rng = np.random.default_rng(3)
    ell, m = rng.uniform(0.1, 1.0, 7), rng.uniform(0.1, 2.0, 7)
    chain = HangingChain(ell, m, 9.81)
    S = np.tril(np.ones((8, 7)), -1) * ell  # displacements of the nodes: sums of ℓ β
    N = np.zeros((8, 8))
    for k in range(7):
        N[k : k + 2, k : k + 2] += m[k] / 6.0 * np.array([[2.0, 1.0], [1.0, 2.0]])
    np.testing.assert_allclose(chain.mass_matrix, S.T @ N @ S, rtol=1e-13)
    np.testing.assert_allclose(chain.input, S.T @ N @ np.ones(8), rtol=1e-13)
    # Raised by ℓ (1 - cos β) = ℓ β²/2, everything from a rod's middle down: the energy's second derivative.
    raised = [9.81 * ell[i] * (m[i] / 2 + m[i + 1 :].sum()) for i in range(7)]
    np.testing.assert_allclose(chain.stiffness, raised, rtol=1e-13)


def test_one_rod_is_the_pendulum_of_the_thesis() -> None:
    """(3.28)."""
    chain = HangingChain(np.array([0.25]), np.array([2.0]))
    assert chain.frequencies[0] == pytest.approx(math.sqrt(1.5 * 9.81 / 0.25) / (2 * math.pi))


def test_frequencies_of_the_thesis_cable() -> None:
    """The issue's 0.3242 and 0.9329 Hz to their digits; at 121 elements within 0.5 % of them, converging as 1/K²."""
    coarse, middle, fine = (thesis_chain(divisions).frequencies for divisions in (1, 5, 10))
    assert coarse[0] == pytest.approx(0.3242, abs=5e-5)
    assert coarse[1] == pytest.approx(0.9329, abs=5e-5)
    np.testing.assert_allclose(fine[:2], coarse[:2], rtol=5e-3)
    # Elements five and ten times shorter: errors 1/25 and 1/100 of the first one, so differences as 24 : 99.
    np.testing.assert_allclose((coarse - middle[:13])[:2] / (coarse - fine[:13])[:2], 24 / 99 * 100 / 25, rtol=0.02)


def test_a_uniform_chain_is_bessels() -> None:
    """ω_n = j_0n/2 √(g/L) of the continuous chain, reached from above as 1/K²: 4 times nearer with twice the rods."""
    from scipy.special import jn_zeros

    exact = jn_zeros(0, 3) / 2 * math.sqrt(9.81 / 2.0) / (2 * math.pi)
    off = [HangingChain(np.full(K, 2.0 / K), np.full(K, 1.0 / K)).frequencies[:3] / exact - 1 for K in (100, 200)]
    assert np.all(np.abs(off[1]) < 1e-3)
    # The continuous chain's lower end is weightless, so the order is not quite two.
    np.testing.assert_allclose(off[0] / off[1], 4.0, rtol=0.2)


@pytest.mark.parametrize("start", list(Start))
@pytest.mark.parametrize("frequency", [0.05, 0.7, None])
def test_modal_superposition_solves_the_equations(start: Start, frequency: float | None) -> None:
    """Against scipy's integration of M β̈ + G β = -c d̈ at rtol 1e-11, at resonance (None) too: 1e-8 of the amplitude."""
    from scipy.integrate import solve_ivp

    chain = thesis_chain()
    f = float(chain.frequencies[1]) if frequency is None else frequency
    w, A, K = 2 * np.pi * f, 0.05, 13
    inverse = np.linalg.inv(chain.mass_matrix)

    def rates(t: float, y: np.ndarray) -> np.ndarray:
        force = chain.input * A * w**2 * np.sin(w * t) - chain.stiffness * y[:K]
        return np.concatenate([y[K:], inverse @ force])

    first = np.zeros(2 * K)
    if start is Start.LAB_FRAME:
        first[K] = -A * w / chain.lengths[0]
    times = np.linspace(0.0, 12.0, 25)
    found = solve_ivp(rates, (0.0, 12.0), first, t_eval=times, method="DOP853", rtol=1e-11, atol=1e-13)
    x, v = response(chain, times, A, f, start)
    moved = A * np.sin(w * times)[:, None] + np.cumsum(found.y[:K].T * chain.lengths, axis=1)
    np.testing.assert_allclose(x[:, 1:], moved, atol=1e-8 * np.abs(x).max())
    np.testing.assert_allclose(x[:, 0], A * np.sin(w * times), atol=1e-16)
    if start is Start.LAB_FRAME:
        np.testing.assert_allclose(v[0, 1:], 0.0, atol=1e-13)
    else:
        np.testing.assert_allclose(v[0], A * w, rtol=1e-12)


def test_amplitudes_of_both_starts() -> None:
    """The issue's 4.30 from the moving frame, and 2.00 from the lab frame, in the linear model to 1 %."""
    chain = thesis_chain()
    for start, value in ((Start.MOVING_FRAME, 4.30), (Start.LAB_FRAME, 2.00)):
        x, v = response(chain, T, 0.05, 0.7, start)
        assert response_amplitude(T, x[:, 12], v[:, 12]) / 0.1 == pytest.approx(value, rel=0.01)
