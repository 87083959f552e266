"""A moored chain and a net of fish farming, against closed forms of where they hang and what the water does."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import tensegrity_mj as tmj
from tensegrity_mj.errors import OptionError
from tensegrity_mj.library.fish_farm import fish_net, moored_chain
from tensegrity_mj.model.elements.water import water_forces
from tensegrity_mj.statics.equilibrium import balance
from tensegrity_mj.statics.model import StaticModel

G, RHO = 9.81, 1025.0
STILL: dict[str, Any] = {"wave_height": 0.0, "current": (0.0, 0.0, 0.0)}
ENGINES = [tmj.DAE(), tmj.MuJoCo(1e-3)]
both = pytest.mark.parametrize("engine", ENGINES, ids=["DAE", "MuJoCo"])


@pytest.mark.parametrize("elements", [1, 12, 40])
def test_a_chain_is_balanced_in_still_water_and_pulls_aside_as_it_is_pulled(elements: int) -> None:
    """Forces along rods whose weight is at their nodes have the pull H for their horizontal part.

    Sums of some thousand newtons have round-off of 1e-12 N each; times the number of rods, and a slope, 1e-9 N.
    """
    scene = moored_chain(elements, **STILL)
    model = StaticModel.of(scene)
    assert balance(model).is_equilibrium
    state = tmj.statics.find_equilibrium(scene)
    np.testing.assert_allclose(state.nodes, scene.nodes0, atol=1e-9)
    spans = np.diff(scene.nodes0, axis=0)[:-1]
    slopes = spans[:, 0] / np.linalg.norm(spans, axis=1)
    np.testing.assert_allclose(state.rod_forces[:-1] * slopes, 1500.0, atol=1e-7)


def catenary(s: Any, length: float, line: float, lift: float, pull: float) -> Any:
    """x, z at arc lengths s from the anchor: dx/dz = H / (B - w (l - s)), w per length."""
    bottom = lift - line * length
    up = bottom + line * np.asarray(s)
    x = pull / line * (np.arcsinh(up / pull) - np.arcsinh(bottom / pull))
    return x, (np.hypot(pull, up) - np.hypot(pull, bottom)) / line


def test_the_chain_hangs_as_a_catenary_to_second_order() -> None:
    """A rod has the direction that the catenary has in its middle: Taylor's remainder is l h²/24 max |t''|.

    With the slope's change w cos²θ/H, |t''| <= (w/H)² (cos⁴θ + 2 cos³θ sin θ) < 1.65 (w/H)².
    """
    length, pull = 24.0, 1500.0
    line = G * (12.0 - RHO * np.pi * 0.02**2)
    lift = G * (RHO * np.pi * 0.3**2 * 2.0 - 150.0)
    errors = []
    for count in (12, 24, 48):
        nodes = moored_chain(count, length=length, pull=pull).nodes0[:-1]
        x, z = catenary(np.linspace(0.0, length, count + 1), length, line, lift, pull)
        errors.append(float(np.hypot(nodes[:, 0] - x, nodes[:, 2] + 25.0 - z).max()))
        assert errors[-1] < length * (length / count) ** 2 / 24 * 1.65 * (line / pull) ** 2
    np.testing.assert_allclose(np.array(errors[:-1]) / errors[1:], 4.0, rtol=0.01)


@both
def test_a_float_on_one_rod_swings_as_a_double_pendulum_upwards(engine: Any) -> None:
    """Small angles of chain and float: K = diag(B l - w l/2, B d/2), M of rods with added mass across them.

    Added mass is taken at the centres of five segments of a rod: its moment is 1/3 - 1/300 of m l², not 1/3. The pull
    of 1e-6 N tilts the chain by 1e-10 rad. Narrow differences are right to 1e-7 of ω² (`tests/model/test_afloat.py`).
    """
    ell, d = 10.0, 2.0
    scene = moored_chain(1, length=ell, depth=14.0, pull=1e-6, **STILL)
    masses = np.array([12.0 * ell, 150.0])
    added = RHO * np.pi / 4 * np.array([0.04**2 * ell, 0.6**2 * d])
    weight, lift = G * (masses[0] - added[0]), G * (added[1] - masses[1])
    moments = masses / 3 + added * (1 / 3 - 1 / 300)
    moving = masses[1] + added[1]
    M = np.array([[moments[0] * ell**2 + moving * ell**2, 0.5 * moving * ell * d], [0.0, moments[1] * d**2]])
    M[1, 0] = M[0, 1]
    K = np.diag([lift * ell - 0.5 * weight * ell, 0.5 * lift * d])
    expected = np.sqrt(np.linalg.eigvals(np.linalg.solve(M, K)))
    found = 2 * np.pi * tmj.linearize(scene, engine=engine).frequencies
    for omega in expected:
        assert (np.abs(found**2 / omega**2 - 1) < 1e-6).sum() == 2  # in both planes


@pytest.mark.parametrize(
    ("changes", "words"),
    [({"float_mass": 500.0}, "less than its"), ({"length": 26.0}, "shorter chain"), ({"pull": 0.0}, "pull")],
)
def test_chains_that_cannot_be_are_refused(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(OptionError, match=words):
        moored_chain(**changes)


def test_a_net_hangs_plane_in_still_water_and_its_drag_is_the_sum_over_its_twines() -> None:
    """½ ρ C_d d u² on the length of each string, all of which are across the current; to the sum's round-off."""
    scene = fish_net(**STILL)
    assert balance(StaticModel.of(scene)).is_equilibrium
    u, speed = 0.8, np.array([0.8, 0.0, 0.0])
    flowed = fish_net(wave_height=0.0, current=tuple(speed.tolist()))
    push = water_forces(flowed, 0.0, flowed.nodes0, np.zeros_like(flowed.nodes0))[0]
    total = 0.5 * RHO * 1.2 * 0.1 * u**2 * len(scene.structure.strings) * 1.0
    np.testing.assert_allclose(push.sum(axis=0), [total, 0.0, 0.0], rtol=1e-12, atol=1e-9)
    # An inner knot has four half strings.
    inner = scene.structure.node_index["n1_1"]
    assert push[inner, 0] == pytest.approx(0.5 * RHO * 1.2 * 0.1 * u**2 * 2.0, rel=1e-12)


@pytest.mark.parametrize(("name", "count"), [("moored_chain", 13), ("fish_net", 0)])
def test_engines_agree_in_waves_and_current(name: str, count: int) -> None:
    """RK4 with equal steps is the same function in both engines: round-off, of which nothing unstable makes more.

    Energy balances to order 4 in the step, of which a factor 8 is asked, or to round-off: 1e-14 of 1e5 J.
    """
    scene = tmj.load_scene(name)
    made = {"moored_chain": moored_chain, "fish_net": fish_net}[name]()
    assert scene.structure == made.structure
    assert scene.water == made.water
    runs = [
        tmj.simulate(scene, None, engine, duration=1.0)
        for engine in (tmj.MuJoCo(2e-3), tmj.DAE(method="rk4", timestep=2e-3), tmj.MuJoCo(1e-3))
    ]
    assert tmj.compare(*runs[:2]).max_node_error < 1e-11
    assert runs[2].energy_residual < max(runs[0].energy_residual / 8, 1e-9)
    assert len(scene.structure.rods) == count
    assert not scene.structure.strings or runs[0].tensions.min() > 1.0
