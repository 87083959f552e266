"""Statics, small motions and stable steps with strings over pulleys: closed forms, and differences of what they derive
from.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from pulley_scenes import G, atwood, ringed, slung, threaded
from scipy.optimize import brentq

import tensegrity_mj as tmj
from tensegrity_mj import statics
from tensegrity_mj.statics.model import StaticModel
from tensegrity_mj.statics.stiffening import Assembly
from tensegrity_mj.vibration.bodies import Bodies
from tensegrity_mj.vibration.bounds import bounds_at
from tensegrity_mj.vibration.small_motions import vibration

ENGINES = {"mujoco": tmj.MuJoCo(1e-3), "dae": tmj.DAE(), "ode": tmj.ODE()}
K = 800.0


def tension_of_slung() -> float:
    """T of 2 kg on the sling: both sides stand at sin θ = 1/L to the vertical, 2 T cos θ = m g, and L = 1.5 + T/k."""

    def left(T: float) -> float:
        return 2 * T * math.sqrt(1 - (1.5 + T / K) ** -2) - 2 * G

    return float(brentq(left, 1.0, 100.0, xtol=1e-14))


@pytest.mark.parametrize("rise", [0.0, 0.3])
def test_a_load_on_a_sling_hangs_where_both_sides_make_the_same_angle(rise: float) -> None:
    """Where the foci of its ellipse are is no matter of the angle, sin θ = 1/L: they are 1 m apart along x."""
    state = statics.find_equilibrium(slung(rise))
    a, m, b = state.nodes
    T = tension_of_slung()
    # Newton's iterations end at round-off of forces of 10 N over the softest stiffness, 19.5 N/m: 1e-14 m.
    assert state.tensions[0] == pytest.approx(T, rel=1e-11)
    assert state.lengths[0] == pytest.approx(1.5 + T / K, rel=1e-12)
    for end in (a, b):
        assert abs(m - end)[0] / np.linalg.norm(m - end) == pytest.approx(1 / (1.5 + T / K), rel=1e-11)
    assert state.force_densities[0] == pytest.approx(T / (1.5 + T / K), rel=1e-11)
    assert state.is_stable


def test_its_small_oscillations_are_those_of_closed_forms() -> None:
    """Along x ω² = g cos θ/l, across the plane that of a pendulum as long as the sling is deep, and the stretching."""
    T = tension_of_slung()
    length = 0.5 * (1.5 + T / K)
    cos = math.sqrt(1 - (0.5 / length) ** 2)
    stiff = 4 * K * cos**2 + 2 * T * (1 - cos**2) / length
    expected = np.sqrt([G * cos / length, G / (length * cos), stiff / 2.0])
    state = statics.find_equilibrium(slung())
    found = 2 * math.pi * statics.natural_modes(state).frequencies
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    scene = slung().with_(initial_nodes=state.nodes)
    for engine in ENGINES.values():
        values = np.linalg.eigvals(tmj.linearize(scene, engine).A)
        # Differences of accelerations over 1e-6 m or so: 1e-7 of the largest entry, 911 /s², beside 9.7 /s².
        np.testing.assert_allclose(np.sort(np.abs(values.imag))[::2], expected, rtol=1e-5)


def test_atwoods_elastic_mode_sets_the_stable_step() -> None:
    """ω² = k (1/m + 1/M); RK4 is stable up to ω h = 2√2, and the string is to blame."""
    omega = math.sqrt(1000.0 * (1 + 1 / 1.5))
    found = tmj.stable_step(atwood(), tmj.MuJoCo(1e-3))
    assert found.omega == pytest.approx(omega, rel=1e-9)
    assert found.limit == pytest.approx(2 * math.sqrt(2) / omega, rel=1e-6)
    assert (found.string, found.string_share) == ("s", 1.0)


@pytest.mark.parametrize("scene", [ringed, threaded, slung])
def test_the_hessian_is_the_derivative_of_the_gradient(scene) -> None:  # type: ignore[no-untyped-def]
    """Central differences over 1e-6 m: h² T/l³ of error at most, and round-off of some 100 N over h."""
    model = StaticModel.of(scene())
    x = model.start.ravel() + np.random.default_rng(3).normal(scale=0.01, size=model.start.size)
    none = np.zeros(len(model.structure.rods))
    h, eye = 1e-6, np.eye(len(x))
    expected = np.array([(model.gradient(x + h * e) - model.gradient(x - h * e)) / (2 * h) for e in eye])
    largest = np.abs(expected).max()
    for found in (model.hessian(x, none).toarray(), model.dense_hessian(x, none)):
        np.testing.assert_allclose(found, expected, atol=1e-6 * largest)
    slope = (model.energy(x + h * eye[0]) - model.energy(x - h * eye[0])) / (2 * h)
    assert model.gradient(x)[0] == pytest.approx(slope, abs=1e-5)


@pytest.mark.parametrize("scene", [ringed, threaded, slung, atwood])
def test_bounds_of_eigenvalues_hold_for_paths(scene) -> None:  # type: ignore[no-untyped-def]
    """And are no more than 2 n times too large, of n ends of a string's segments: (Σ a)² <= n Σ a²."""
    found = scene().with_(initial_velocities=None)
    rest = 0.5 * found.structure.rest_lengths  # all taut
    model = vibration(found, found.nodes0, found.velocities0, rest)
    bounds = bounds_at(found, Bodies.of(found.structure), found.nodes0, found.velocities0, rest)
    ends = 2 * max(len(string.nodes) - 1 for string in found.structure.strings)
    for bound, matrix in ((bounds.material, model.material), (bounds.damper, model.string_damper)):
        largest = float(np.linalg.eigvalsh(matrix).max())
        assert largest * (1 - 1e-12) <= bound
        assert bound <= max(2 * ends * largest, 1e-9) or scene is threaded  # joints only lower what is bounded


def test_a_ring_through_all_nodes_has_mechanisms_that_three_strings_have_not() -> None:
    """A string that slides around a triangle holds its circumference alone: two of three lengths are free, twice."""
    one, three = (statics.prestressability(ringed(rings, turning=False).structure) for rings in (True, False))
    assert one.mechanisms.shape[1] == three.mechanisms.shape[1] + 4
    assert len(one.self_stress) == len(three.self_stress) == 1
    assert three.prestress_stable is statics.Verdict.YES
    assert one.prestress_stable is statics.Verdict.NO
    assert one.super_stable is statics.Verdict.NOT_APPLICABLE
    # The state of self-stress has T of the three strings in the ring, so a third of their force density.
    ratio = three.self_stress[0][[0, 3, 6]] / one.self_stress[0][[0, 3, 4]]
    np.testing.assert_allclose(ratio, ratio[0], rtol=1e-12)
    np.testing.assert_allclose(one.force_densities[0][3] * 3 * ratio[0], three.force_densities[0][3], rtol=1e-12)


def test_forms_are_second_derivatives_of_lengths() -> None:
    """Σ over segments of (v·v - (v·s)²)/l, by central second differences: h² fourth derivatives, round-off over h²."""
    structure = ringed(turning=False).structure
    nodes = structure.positions + np.random.default_rng(4).normal(scale=0.05, size=(6, 3))
    at = Assembly.of(structure, StaticModel.of(ringed()).boundary, nodes, np.ones(5, bool))
    v = np.random.default_rng(5).normal(size=(18, 1))
    h = 1e-4
    moved = [structure.string_lengths(nodes + s * h * v.reshape(6, 3)) for s in (-1, 0, 1)]
    expected = (moved[0] - 2 * moved[1] + moved[2]) / h**2
    np.testing.assert_allclose(at.forms(v)[:5, 0, 0], expected, atol=1e-6 * np.abs(expected).max())
    slopes = (moved[2] - moved[0]) / (2 * h)
    np.testing.assert_allclose((at.B @ at.boundary.Z.T @ v)[:5, 0], slopes, atol=1e-6)


def test_the_least_mass_of_a_string_counts_all_of_its_length() -> None:
    """One string alone, of a tension that its load sets: ρ L T/σ."""
    state = statics.find_equilibrium(slung())
    structure = slung().structure.placed(state.nodes)
    loads = np.zeros((3, 3))
    loads[1, 2] = -2 * G
    sized = statics.minimal_mass(structure, loads, rods=statics.STEEL, strings=statics.STEEL)
    steel, T = statics.STEEL, tension_of_slung()
    expected = steel.density * (1.5 + T / K) * T / steel.yield_stress
    assert sized.mass == pytest.approx(expected, rel=1e-6)  # its tolerance
