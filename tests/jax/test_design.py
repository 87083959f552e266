"""Design by gradient: frequencies and optima as array functions, and the example that designs a tower with them."""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from scipy.linalg import eigh

import tensegrity_mj as tmj

jax = pytest.importorskip("jax")
pytest.importorskip("diffrax")

from tensegrity_mj.engines.jax.small_motions import frequency_squares  # noqa: E402

EPS = np.finfo(float).eps


def slopes(function: Callable[[Any], Any], y: np.ndarray, step: float = 1e-3) -> np.ndarray:
    """(..., y) fourth-order central differences."""
    columns = []
    for row in np.eye(len(y)):
        at = [np.asarray(function(y + n * step * row)) for n in (-2, -1, 1, 2)]
        columns.append((at[0] - 8 * at[1] + 8 * at[2] - at[3]) / (12 * step))
    return np.stack(columns, axis=-1)


def test_squares_of_frequencies_and_their_derivatives() -> None:
    """ω² to round-off of the largest; derivatives, forward and reverse, to what differences of steps h = 1e-3 leave.

    For numbers of about one that is h⁴/30 of their fifth derivative and eps/h of the largest: below 1e-9.
    """
    generator = np.random.default_rng(3)
    basis, _ = np.linalg.qr(generator.normal(size=(5, 5)))
    turns = [one + one.T for one in generator.normal(size=(4, 5, 5))]
    stiff, mass = basis @ np.diag([1.0, 4.0, 9.0, 16.0, 25.0]) @ basis.T, 2 * np.eye(5) + 0.1 * turns[0]

    @jax.jit
    def squares(y: Any) -> Any:
        return frequency_squares(stiff + 0.1 * (y[0] * turns[1] + y[1] * turns[2]), mass + 0.1 * y[1] * turns[3])

    y = np.array([0.3, -0.2])
    found = np.asarray(squares(y))
    truth = eigh(stiff + 0.1 * (y[0] * turns[1] + y[1] * turns[2]), mass + 0.1 * y[1] * turns[3], eigvals_only=True)
    np.testing.assert_allclose(found, truth, rtol=0, atol=50 * EPS * truth[-1])
    for derive in (jax.jacfwd, jax.jacrev):
        np.testing.assert_allclose(np.asarray(jax.jit(derive(squares))(y)), slopes(squares, y), rtol=0, atol=1e-9)


def test_equal_frequencies_have_derivatives_where_they_stay_equal() -> None:
    """Two of three are equal for any y, in a basis that hides it: ω² = y/2, y/2, 3 y² by hand."""
    basis, _ = np.linalg.qr(np.random.default_rng(4).normal(size=(3, 3)))

    def squares(y: Any) -> Any:
        scale = jax.numpy.diag(jax.numpy.stack([y / 2, y / 2, 3 * y**2]))
        return frequency_squares(basis @ scale @ basis.T, np.eye(3))

    for derive in (jax.jacfwd, jax.jacrev):
        np.testing.assert_allclose(jax.jit(derive(squares))(2.0), [0.5, 0.5, 12.0], rtol=0, atol=50 * EPS * 12)


def test_an_optimum_at_an_equation_a_limit_and_a_bound(example: Callable[[str], ModuleType]) -> None:
    """The point of x + y + z = 2, x >= 0.9 and z <= 0.4 that is nearest to zero is (0.9, 0.7, 0.4).

    z alone would be 0.55. A kept first entry leaves (1.1, 0.5, 0.4); its multiplier at the limit is zero. SLSQP's last
    step gains less than 1e-13 of the cost, which is quadratic: y is as near as the root of that.
    """

    least = example("optimum").least

    def functions(y: Any, total: Any) -> Any:
        return (y**2).sum(), y.sum()[None] - total, y[:1] - 0.9

    bounds = np.array([[-5.0, 5.0], [-5.0, 5.0], [-5.0, 0.4]])
    best = least(functions, [0.0, 3.0, 0.0], bounds, arguments=(2.0,))
    np.testing.assert_allclose(best.y, [0.9, 0.7, 0.4], rtol=0, atol=1e-6)
    assert best.converged
    assert list(best.active) == [0]
    assert max(best.residual, best.violation) < 1e-6
    kept = least(functions, [1.1, 3.0, 0.0], bounds, arguments=(2.0,), kept=1)
    np.testing.assert_allclose(kept.y, [1.1, 0.5, 0.4], rtol=0, atol=1e-6)
    assert not len(kept.active)


def test_slopes_of_the_tower_are_those_of_differences(example: Callable[[str], ModuleType]) -> None:
    """Mass, equations and margins, at a form and forces by chance, relative to the largest slope of each.

    Steps are h = 1e-3 in units of about one: h⁴/30 of fifth derivatives, and round-off. Frequencies are the worst: ω²
    has eps times the largest, of rods along themselves, (2e4/50)² of the lowest: 4e-11, and over h 4e-8. So 1e-7.
    """
    tower = example("design_tower")
    y, _ = tower.start()
    y = y * np.random.default_rng(0).uniform(0.95, 1.05, len(y))
    for row, of in enumerate(("mass", "equations", "margins")):

        def one(at: Any, row: int = row) -> Any:
            return jax.numpy.atleast_1d(tower.functions()(at, 100.0, 8.0)[row])

        compiled = jax.jit(one)
        derived, truth = np.asarray(jax.jit(jax.jacfwd(one))(y)), slopes(compiled, y)
        scale = np.abs(truth).max(axis=1, keepdims=True)
        assert np.abs((derived - truth) / scale).max() < 1e-7, of


@pytest.mark.parametrize("alike", [True, False])
def test_gradients_find_the_least_mass_of_linear_programs(alike: bool, example: Callable[[str], ModuleType]) -> None:
    """At one form, with and without symmetry: that of `minimal_mass`, which is proven to 1e-9 of it.

    What `least` violates, in units of limits, and what KKT's equations leave move the mass by as much, times
    multipliers of about one: 1e-9 as well.
    """
    tower = example("design_tower")
    proven = tmj.statics.minimal_mass(
        tower.layout(tower.place(tower.BY_HAND)),
        rods=tmj.statics.ALUMINIUM,
        strings=tmj.statics.UHMWPE,
        gravity=tower.GRAVITY,
        least_force_density=tower.SLACKEST,
        tolerance=1e-9,
    )
    found = tower.least(tower.functions(alike, False), *tower.start(alike), arguments=(0.0, 1.0), kept=8)
    assert found.converged
    assert max(found.residual, found.violation) < 1e-9
    assert abs(found.cost - proven.mass) < 2e-9 * proven.mass


@pytest.mark.slow
def test_the_designed_tower_bears_what_it_must(example: Callable[[str], ModuleType]) -> None:
    """Lighter over form than at one, and as the package's own statics, modes and engines say, what was promised.

    Nodes: at rest to 1e-10 of the 2 m. Frequencies: ω² has eps times its largest, (2e4/50)² of the lowest, and rods of
    some 10 kN/m beside 5 MN/m, below 1e-9. In wind margins are of first order: members turn by its displacements over
    their lengths, 1e-3, so that forces are off by the square of that; 1e-3 is far above. A swing of 10 µm is one of the
    first mode but for its stretches over rest lengths, 1e-5 m / 0.2 m, and its return for the period's round-off.
    """
    tower = example("design_tower")
    y, bounds = tower.start()
    wind, hertz = 100.0, 8.0
    by_hand = tower.least(tower.functions(), y, bounds, arguments=(wind, hertz), kept=8)
    found = tower.least(tower.functions(), by_hand.y, bounds, arguments=(wind, hertz))
    assert by_hand.converged
    assert found.converged
    assert found.violation < 1e-9
    assert found.residual < 1e-6
    assert found.cost < 0.75 * by_hand.cost
    values = tower.values_of(found.y, wind, hertz)
    assert {"buckling rod1", "buckling rod2", "frequency 1", "frequency 2"} <= set(tower.named(values, found.active))
    scene = tower.built(values)
    assert abs(float(values.mass) - _mass(tower, scene)) < 1e-12
    told = tower.judged(scene, wind)
    assert told["nodes are off their equilibrium by [m]"] < 2e-10
    assert abs(told["first frequency [Hz]"] / hertz - 1) < 1e-9
    assert told["utilisation"] < 1
    assert told["utilisation in wind"] < 1 + 1e-3
    assert told["least force density in wind [N/m]"] > tower.SLACKEST * (1 - 1e-3)
    assert told["clearance of rods [m]"] > 0
    for engine in ("MuJoCo", "DAE"):
        assert told[f"{engine}: nodes move by [m]"] < 2e-10
        assert told[f"{engine}: off after a period, of the swing"] < 1e-4


def _mass(tower: Any, scene: tmj.Scene) -> float:
    """[kg] of rods as the scene has them, and of strings by their strength."""
    structure, material = scene.structure, tmj.statics.UHMWPE
    areas = np.array([string.strength for string in structure.strings]) / material.yield_stress
    lengths = structure.string_lengths(scene.nodes0)
    return float(sum(rod.mass for rod in structure.rods) + material.density * (areas * lengths).sum())
