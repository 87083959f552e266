"""The string law: what makes it a string, its energy, and the two ways to state prestress."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tensegrity_mj.model import strings
from tensegrity_mj.model.strings import StringLaw

positive = st.floats(1e-3, 1e3)
rate = st.floats(-1e3, 1e3)
rest = st.floats(-10.0, 1e3)  # not positive rest lengths are legal at run time: reported, not refused
fair = settings(derandomize=True, max_examples=200, deadline=None)


@fair
@given(positive, st.floats(0.0, 1e3), positive, rate, rest)
def test_a_clipped_string_never_pushes(k: float, c: float, length: float, speed: float, rest_length: float) -> None:
    assert strings.tension(k, c, length, speed, rest_length) >= 0.0


@fair
@given(positive, st.floats(0.0, 1e3), positive, rate, rest, st.sampled_from(StringLaw))
def test_a_slack_string_is_not_there(
    k: float, c: float, length: float, speed: float, rest_length: float, law: StringLaw
) -> None:
    slack = max(rest_length, length * (1 + 2 * strings.EDGE))  # at the border, a string that grows is taut
    assert strings.tension(k, c, length, speed, slack, law) == 0.0
    assert strings.energy(k, length, slack) == 0.0
    assert strings.force_density(k, length, slack) == 0.0


@fair
@given(positive, st.floats(0.0, 1e3), positive, rate, rest)
def test_the_laws_differ_only_where_the_damper_would_push(
    k: float, c: float, length: float, speed: float, rest_length: float
) -> None:
    clipped = strings.tension(k, c, length, speed, rest_length)
    unclipped = strings.tension(k, c, length, speed, rest_length, StringLaw.UNCLIPPED)
    assert clipped == max(0.0, unclipped)


@pytest.mark.parametrize("law", StringLaw)
def test_worked_examples(law: StringLaw) -> None:
    # k (L - L0) + c dL/dt = 10 · 0.2 + 3 · 0.5 = 3.5 N.
    assert strings.tension(10.0, 3.0, 1.2, 0.5, 1.0, law) == pytest.approx(3.5, rel=1e-14)
    # 10 · 0.2 - 3 · 2 = -4 N: a string gives 0, the unclipped variant pushes.
    expected = 0.0 if law is StringLaw.CLIPPED else -4.0
    assert strings.tension(10.0, 3.0, 1.2, -2.0, 1.0, law) == pytest.approx(expected, rel=1e-14)
    assert strings.energy(10.0, 1.2, 1.0) == pytest.approx(0.2, rel=1e-14)


@fair
@given(positive, positive, st.floats(-10.0, 1e3))
def test_elastic_tension_is_the_slope_of_the_energy(k: float, length: float, rest_length: float) -> None:
    # The energy is quadratic on either side of L0, so that the central difference is exact but for round-off
    # (eps E / h each side), and but for the kink, which spoils it by at most k h / 4 where |L - L0| < h.
    h = 1e-3
    slope = (strings.energy(k, length + h, rest_length) - strings.energy(k, length - h, rest_length)) / (2 * h)
    round_off = 4 * np.finfo(float).eps * strings.energy(k, length + h, rest_length) / h
    # L ± h are rounded too: eps L each, and the slope of the energy is the tension.
    round_off += 4 * np.finfo(float).eps * (length + abs(rest_length)) * k * (length + h + abs(rest_length)) / h
    kink = k * h / 4 if abs(length - rest_length) < h else 0.0
    assert abs(slope - strings.elastic_tension(k, length, rest_length)) <= round_off + kink + 1e-300


@fair
@given(positive, positive, st.floats(0.0, 5.0))
def test_rest_length_and_force_density_are_inverse(k: float, length: float, part: float) -> None:
    u = part * k
    rest_length = strings.rest_length(k, length, u)
    # L0 = L (1 - u/k) and back: a few roundings of numbers of the size of max(k, u).
    assert abs(strings.force_density(k, length, rest_length) - u) <= 8 * np.finfo(float).eps * max(k, u)
    assert (rest_length <= 0.0) == (u / k >= 1.0)


def test_arguments_broadcast_over_time_and_strings() -> None:
    lengths = np.array([[1.0, 2.0, 3.0], [1.5, 2.5, 3.5]])
    values = strings.tension([1.0, 2.0, 3.0], 0.1, lengths, np.zeros((2, 3)), 1.0)
    np.testing.assert_array_equal(values, [[0.0, 2.0, 6.0], [0.5, 3.0, 7.5]])
