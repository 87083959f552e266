"""Paths of equilibria against closed forms, finite differences, virtual work and themselves."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tensegrity_mj.errors import InfeasibleError, OptionError
from tensegrity_mj.families.random_linked import random_linked_structure
from tensegrity_mj.families.random_taut import random_taut_structure
from tensegrity_mj.families.tower import base_nodes, top_nodes, tower
from tensegrity_mj.resistance import Bending, Resistance
from tensegrity_mj.scene import Scene
from tensegrity_mj.section import Section
from tensegrity_mj.statics.boundary import Hold
from tensegrity_mj.statics.equilibrium import find_equilibrium
from tensegrity_mj.statics.model import Rods, StaticModel
from tensegrity_mj.statics.path import End, Kind, Path, follow
from tensegrity_mj.structure import Structure

Array = NDArray[np.float64]

# A critical point is enclosed within 1e-10 of the arc between two points, and its eigenvalue has errors of about 1e-15
# of the stiffest member: relative to the parameter less than this in all problems below.
LOCATED = 1e-8
X, Y, Z = np.eye(3).tolist()


def load(structure: Structure, node: str, force: tuple[float, float, float]) -> Array:
    """(N, 3) of a force on one node."""
    out = np.zeros((len(structure.nodes), 3))
    out[structure.node_index[node]] = force
    return out


def kinds(path: Path) -> list[tuple[Kind, int, int]]:
    return [(one.kind, one.unstable_before, one.unstable_after) for one in path.criticals]


# ------------------------------------------------------------------------------------------------- von Mises' truss


class VonMises:
    """Two elastic rods from (-b, 0, 0) and (b, 0, 0) to an apex at height z that P pushes down.

    With L² = b² + z², ℓ without force: P = 2 EA z (1/L - 1/ℓ), as each rod carries N = EA (L/ℓ - 1) and P = -2 N z/L.
    """

    EA = 1000.0

    def __init__(self, half: float, height: float, sideways: bool = False) -> None:
        self.b, self.h = half, height
        self.length = math.hypot(half, height)
        structure = Structure.from_arrays(
            [[-half, 0, 0], [0, 0, height], [half, 0, 0]], [(0, 1), (1, 2)], [], rod_mass=1.0, stiffness=1.0
        ).with_sections(Section(1e-4, 1e-9, self.EA / 1e-4))
        apex = Hold(("n2",), ((0, 1, 0),) if sideways else ((1, 0, 0), (0, 1, 0)))
        self.model = StaticModel.of(structure, rods=Rods.ELASTIC, holds=[Hold(("n1", "n3")), apex])
        self.down = load(structure, "n2", (0, 0, -1.0))

    def load(self, z: Array | float) -> Any:
        return 2 * self.EA * z * (1 / np.sqrt(self.b**2 + np.square(z)) - 1 / self.length)

    def slope(self, z: float) -> float:
        """dP/dz = 2 EA (b²/L³ - 1/ℓ)."""
        return 2 * self.EA * (self.b**2 / math.hypot(self.b, z) ** 3 - 1 / self.length)

    @property
    def limit(self) -> tuple[float, float]:
        """Height and load where dP/dz = 0: L³ = ℓ b²."""
        z = math.sqrt((self.length * self.b**2) ** (2 / 3) - self.b**2)
        return z, float(self.load(z))

    @property
    def sideways(self) -> list[float]:
        """Heights at which the apex may leave sideways: 2 EA/ℓ b²/L² + 2 N z²/L³ = 0, so L³ - ℓ L² + ℓ b² = 0."""
        roots = np.roots([1, -self.length, 0, self.length * self.b**2])
        lengths = sorted(float(r.real) for r in roots if abs(r.imag) < 1e-12 and self.b < r.real < self.length)
        return [math.sqrt(L**2 - self.b**2) for L in lengths[::-1]]


@pytest.mark.parametrize("points", [15, 60])
@pytest.mark.parametrize(("half", "height"), [(1.0, 0.2), (3.0, 1.0)])
def test_a_flat_truss_snaps_through_two_limit_points(half: float, height: float, points: int) -> None:
    truss = VonMises(half, height)
    z, peak = truss.limit
    path = follow(truss.model, loads=2 * peak * truss.down, points=points, longest=20.0)
    assert path.end is End.REACHED
    assert path.parameters[-1] == 1.0
    assert kinds(path) == [(Kind.LIMIT, 0, 1), (Kind.LIMIT, 1, 0)]
    for one, sign in zip(path.criticals, (1, -1), strict=True):
        assert one.parameter == pytest.approx(sign * 0.5, rel=LOCATED)
        # The curve is flat there: a height is known to the root of what the load is known to.
        assert one.state.nodes[1, 2] == pytest.approx(sign * z, rel=1e-6)
        assert np.allclose(one.mode, [[0, 0, 0], [0, 0, 1], [0, 0, 0]], atol=1e-12)
    heights = path.nodes[:, 1, 2]
    assert np.allclose(path.parameters * 2 * peak, truss.load(heights), rtol=0, atol=1e-9 * peak)
    assert np.all(np.diff(heights) < 0)
    assert heights[-1] < -truss.h


def test_a_steep_truss_leaves_sideways_before_it_snaps() -> None:
    truss = VonMises(0.3, 1.0, sideways=True)
    assert truss.b**2 < 4 * truss.length**2 / 27  # where L³ - ℓ L² + ℓ b² has roots
    (first, second), (z, peak) = truss.sideways, truss.limit
    assert first > z > second > 0
    path = follow(truss.model, loads=2 * peak * truss.down, points=50, longest=20.0)
    assert kinds(path) == [
        (Kind.BIFURCATION, 0, 1),
        (Kind.LIMIT, 1, 2),
        (Kind.BIFURCATION, 2, 1),
        (Kind.BIFURCATION, 1, 2),
        (Kind.LIMIT, 2, 1),
        (Kind.BIFURCATION, 1, 0),
    ]
    expected = [first, z, second, -second, -z, -first]
    assert [one.parameter * 2 * peak for one in path.criticals] == pytest.approx(
        [float(truss.load(at)) for at in expected], rel=LOCATED
    )
    assert np.allclose(path.criticals[0].mode[1], [1, 0, 0], atol=1e-9)


def test_several_critical_points_within_one_step_are_told_apart() -> None:
    """Steps so long that bifurcation and limit point fall into one."""
    truss = VonMises(0.3, 1.0, sideways=True)
    first, (z, peak) = truss.sideways[0], truss.limit
    path = follow(truss.model, loads=1.5 * peak * truss.down, points=4, longest=20.0)
    assert kinds(path)[:2] == [(Kind.BIFURCATION, 0, 1), (Kind.LIMIT, 1, 2)]
    assert [one.parameter * 1.5 * peak for one in path.criticals[:2]] == pytest.approx(
        [float(truss.load(first)), float(truss.load(z))], rel=LOCATED
    )


def test_a_prescribed_height_goes_through_limit_points_without_losing_stability() -> None:
    truss = VonMises(1.0, 0.2)
    pushed = [*truss.model.holds[:1], Hold(("n2",), displacement=(0, 0, -3 * truss.h))]
    path = follow(truss.model.with_(holds=tuple(pushed)), points=30)
    assert path.end is End.REACHED
    assert not path.criticals
    heights = path.nodes[:, 1, 2]
    assert np.allclose(heights, truss.h * (1 - 3 * path.parameters), atol=1e-14)
    assert np.allclose(-path.reaction(["n2"])[:, 2], truss.load(heights), atol=1e-10 * truss.EA)
    rate = path.reaction_rate(["n2"])[:, 2] / (-3 * truss.h)
    assert np.allclose(rate, [-truss.slope(z) for z in heights], atol=1e-10 * truss.EA)
    assert np.allclose(path.reaction(["n1", "n3"]), -path.reaction(["n2"]), atol=1e-10 * truss.EA)


@pytest.mark.parametrize("points", [20, 60])
def test_through_a_soft_string_the_truss_snaps_back(points: int) -> None:
    """Its end is pulled down by D = h - z + P(z)/k (of the string): D turns where dP/dz = k, at L³ = b²/(1/ℓ + k/2EA)."""
    half, height, k = 1.0, 0.4, 20.0
    truss = VonMises(half, height)
    structure = Structure.from_arrays(
        [[-half, 0, 0], [0, 0, height], [half, 0, 0], [0, 0, -5]],
        [(0, 1), (1, 2)],
        [(1, 3)],
        rod_mass=1.0,
        stiffness=k,
        rest_length=height + 5,
        fixed_nodes=(),
    )
    structure = structure.with_sections(Section(1e-4, 1e-9, VonMises.EA / 1e-4)) if structure.rods else structure
    far = 1.2 * float(truss.load(truss.limit[0]) / k + height)
    holds = [Hold(("n1", "n3")), Hold(("n2",), ((1, 0, 0), (0, 1, 0))), Hold(("n4",), displacement=(0, 0, -far))]
    path = follow(
        StaticModel.of(structure, rods=Rods.ELASTIC, holds=holds), points=points, longest=20.0
    )
    turn = math.sqrt((half**2 / (1 / truss.length + k / (2 * truss.EA))) ** (2 / 3) - half**2)
    assert truss.slope(turn) == pytest.approx(k)
    expected = [height - z + float(truss.load(z)) / k for z in (turn, -turn)]
    assert kinds(path) == [(Kind.LIMIT, 0, 1), (Kind.LIMIT, 1, 0)]
    assert [one.parameter * far for one in path.criticals] == pytest.approx(expected, rel=LOCATED)
    assert expected[0] > expected[1]  # it does go back
    z = path.nodes[:, 1, 2]
    assert np.allclose(path.parameters * far, height - z + truss.load(z) / k, atol=1e-9)
