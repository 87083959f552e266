"""The laws of chapters 4 to 6 with strings through more than two nodes, each commanded as one by u = T/L."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from pulley_scenes import G, ringed, threaded

import tensegrity_mj as tmj
from tensegrity_mj.controllers.allocation import StringLimits
from tensegrity_mj.controllers.feedback_linearization import FeedbackLinearization
from tensegrity_mj.controllers.lyapunov import Lyapunov
from tensegrity_mj.controllers.projection import Projection

Array = NDArray[np.float64]


def skewed(rings: bool) -> tmj.Structure:
    """The prism at nodes without symmetry, whose rings are one string each or three."""
    structure = ringed(rings, turning=False).structure
    return structure.placed(structure.positions + np.random.default_rng(2).normal(scale=0.05, size=(6, 3)))


def of_segments(separate: Array, structure: tmj.Structure) -> Array:
    """Columns (..., 5) of the prism with rings, of those (..., 9) of its three-string twin: T = u L along each segment
    is a force density u L/l there.
    """
    nodes = structure.positions
    found = [separate[..., n] for n in range(3)]
    for first, where in ((3, "b"), (6, "t")):
        places = np.array([structure.nodes[f"{where}{n % 3}"] for n in range(4)])
        lengths = np.linalg.norm(np.diff(places, axis=0), axis=1)
        found.append(separate[..., first : first + 3] @ (lengths.sum() / lengths))
    assert nodes.shape == (6, 3)
    return np.stack(found, axis=-1)


@pytest.mark.third_means("strings.string_length", "strings.share", by="T/L along two segments by hand")
def test_the_linear_equation_of_a_string_over_pulleys() -> None:
    whole, parts = skewed(True), skewed(False)
    state = (0.0, whole.positions, 0.3 * np.random.default_rng(1).normal(size=(6, 3)))
    A, d, _ = FeedbackLinearization(whole, tmj.Target.set_point(whole.positions)).equation(*state)
    A_parts, d_parts, _ = FeedbackLinearization(parts, tmj.Target.set_point(whole.positions)).equation(*state)
    np.testing.assert_array_equal(d, d_parts)
    expected = of_segments(A_parts, whole)
    np.testing.assert_allclose(A, expected, atol=1e-14 * np.abs(expected).max() * 10)  # sums of three terms


@pytest.mark.parametrize("kind", [Lyapunov, Projection])
def test_the_scalar_equation_of_a_string_over_pulleys(kind) -> None:  # type: ignore[no-untyped-def]
    whole, parts = skewed(True), skewed(False)
    aim = tmj.Target.set_point(whole.moved((0.1, -0.2, 0.3), (0.0, 0.1, 0.2)).positions)
    state = (0.0, whole.positions, 0.3 * np.random.default_rng(1).normal(size=(6, 3)))
    one, other = kind(whole, aim).terms(*state), kind(parts, aim).terms(*state)
    assert (one.V_error, one.V_velocity, one.beta) == (other.V_error, other.V_velocity, other.beta)
    expected = of_segments(other.f, whole)
    np.testing.assert_allclose(one.f, expected, atol=1e-13 * np.abs(expected).max())


def hoist(pulley: bool, stiffness: float = 5e3) -> tmj.Scene:
    """2 kg that hang midway between two points, on a string to each or on one string that runs through the load."""
    nodes = {"a": (-0.5, 0.0, 0.0), "m": (0.0, 0.0, -1.0), "b": (0.5, 0.0, 0.0)}
    if pulley:
        strings = (tmj.String("s", ("a", "m", "b"), stiffness),)
    else:
        strings = tuple(tmj.String(f"s{end}", (end, "m"), 2 * stiffness) for end in "ab")
    structure = tmj.Structure("hoist", nodes, (), strings, ("a", "b"), (tmj.PointMass("m", 2.0),))
    return tmj.Scene(structure, name="hoist", gravity=(0.0, 0.0, -G), duration=2.0)


AIM = np.array([[-0.5, 0.0, 0.0], [0.0, 0.0, -0.7], [0.5, 0.0, 0.0]])
ACTUATIONS = {
    "continuous": tmj.Actuation.continuous(),
    "force densities": tmj.Actuation.hold_force_density(0.02),
    "rest lengths": tmj.Actuation.hold_rest_length(0.02),
}
LAWS = {
    "lyapunov": lambda structure, aim: Lyapunov(structure, aim, decay_rate=2.0, gravity=(0.0, 0.0, -G)),
    "projection": lambda structure, aim: Projection(structure, aim, decay_rate=2.0, gravity=(0.0, 0.0, -G)),
    "feedback linearization": lambda structure, aim: FeedbackLinearization(structure, aim, 3.0, gravity=(0, 0, -G)),
}


@pytest.mark.third_means("strings.string_length", "strings.share", by="two strings that share the tension")
@pytest.mark.parametrize("actuation", ACTUATIONS)
@pytest.mark.parametrize("law", LAWS)
def test_a_law_holds_a_load_on_a_pulley_as_on_two_strings(law: str, actuation: str) -> None:
    """By symmetry both strings have one tension T, and the one over the load has it too: the same accelerations.

    u = T/L of the one string is half that of the two, T/l; rest lengths are L0 = L - T/k = 2 (l - T/2k). Both runs
    differ by their round-off alone, over 400 steps.
    """
    runs = []
    for pulley in (True, False):
        scene = hoist(pulley)
        made = LAWS[law](scene.structure, tmj.Target.set_point(AIM))
        runs.append(tmj.simulate(scene, made, tmj.MuJoCo(5e-3), actuation=ACTUATIONS[actuation], output_interval=0.1))
    one, two = runs
    np.testing.assert_allclose(one.nodes, two.nodes, atol=1e-11)
    np.testing.assert_allclose(one.tensions[:, 0], two.tensions[:, 0], atol=1e-7)
    np.testing.assert_allclose(one.tensions[:, 0], two.tensions[:, 1], atol=1e-7)
    assert one.nodes[-1, 1, 2] > -0.995  # it does rise


def test_v_falls_as_promised_with_strings_over_pulleys() -> None:
    """V(t) = V(0) e^{-δ t} in MuJoCo, which measures the string itself: the law's column must be right for it.

    By RK4, whose residual falls with h by more than 4 a halving (a law's thresholds cost its order here and there).
    """
    scene = hoist(True)
    law = LAWS["lyapunov"](scene.structure, tmj.Target.set_point(AIM))
    left = []
    for h in (2e-2, 1e-2, 5e-3):
        run = tmj.simulate(scene, law, tmj.MuJoCo(h), duration=0.3)
        left.append(float(np.max(np.abs(run.lyapunov / (run.lyapunov[0] * np.exp(-2.0 * run.time)) - 1))))
    print(left)
    assert left[0] > 4 * left[1] > 16 * left[2]
    assert left[2] < 1e-6


def test_ceilings_of_rest_lengths_are_of_the_whole_string() -> None:
    scene = hoist(True)
    structure = scene.structure.with_strings(min_rest_length=1.2)
    length = 2 * math.hypot(0.5, 1.0)
    assert StringLimits.of(structure).ceilings(structure.positions) == pytest.approx([5e3 * (1 - 1.2 / length)])


def test_a_compiled_law_gets_the_segments_of_paths() -> None:
    def pull(time, nodes, velocities, strings, parameters, command):  # type: ignore[no-untyped-def]
        segments, ranges = strings
        for m in range(len(ranges)):
            length = 0.0
            for p in range(ranges[m, 0], ranges[m, 1]):
                i, j = segments[p, 0], segments[p, 1]
                s = nodes[j] - nodes[i]
                length += (s[0] ** 2 + s[1] ** 2 + s[2] ** 2) ** 0.5
            command[m] = parameters[0] / length
        return True

    def of_pairs(time, nodes, velocities, string_nodes, parameters, command):  # type: ignore[no-untyped-def]
        command[0] = string_nodes[0, 1]
        return True

    scene = hoist(True)
    law = tmj.controllers.CompiledLaw(pull, scene.structure, parameters=[11.0])
    run = tmj.simulate(scene, law, tmj.MuJoCo(1e-3), duration=0.05)
    np.testing.assert_allclose(run.tensions, 11.0, rtol=1e-12)
    assert law(0.0, scene.nodes0, scene.velocities0) == pytest.approx([11.0 / (2 * math.hypot(0.5, 1.0))])
    with pytest.raises(tmj.errors.OptionError, match="numba cannot compile"):
        tmj.controllers.CompiledLaw(of_pairs, scene.structure)


def test_laws_are_made_for_the_same_paths() -> None:
    scene = threaded()
    *others, last = scene.structure.strings
    other = scene.with_(structure=replace(scene.structure, strings=(*others, replace(last, nodes=("n1", "n5", "n3")))))
    law = Lyapunov(hoist(True).structure, tmj.Target.set_point(hoist(True).structure.positions))
    with pytest.raises(tmj.errors.OptionError, match="has other nodes or strings"):
        law.native(other.structure)
