"""Paths of equilibria against closed forms, finite differences, virtual work and themselves."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path as FilePath
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import eigh

import tensegrity_mj as tmj
from evidence.families.towers import base_nodes, top_nodes
from evidence.random_taut import random_taut_structure
from tensegrity_mj.cli import main
from tensegrity_mj.errors import InfeasibleError, OptionError
from tensegrity_mj.library.tower import tower
from tensegrity_mj.model.elements.resistance import Bending, Resistance
from tensegrity_mj.model.members import Support
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.section import Section
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.statics import boundary
from tensegrity_mj.statics.boundary import Hold
from tensegrity_mj.statics.equilibrium import balance, find_equilibrium
from tensegrity_mj.statics.model import Rods, StaticModel
from tensegrity_mj.statics.path import End, Path, Response, follow
from tensegrity_mj.statics.path_steps import Kind, Walk
from tensegrity_mj.statics.state import StaticState

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


@pytest.mark.parametrize("points", [12, 30])
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
    path = follow(truss.model, loads=2 * peak * truss.down, points=20, longest=20.0)
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
    # Enclosed to 1e-10 of the change of its eigenvalue, the state has hardly any stiffness sideways: round-off of the
    # forces, some ε EA, moves it by ε EA / (1e-10 EA/ℓ) = 2e-6 ℓ, and the mode turns by about as much.
    assert np.allclose(path.criticals[0].mode[1], [1, 0, 0], atol=2e-5)


def test_several_critical_points_within_one_step_are_distinguished() -> None:
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


@pytest.mark.parametrize("points", [12, 30])
def test_through_a_soft_string_the_truss_snaps_back(points: int) -> None:
    """Its end goes down by D = h - z + P(z)/k (of the string): D turns where dP/dz = k, at L³ = b²/(1/ℓ + k/2EA)."""
    half, height, k = 1.0, 0.4, 20.0
    truss = VonMises(half, height)
    structure = Structure.from_arrays(
        [[-half, 0, 0], [0, 0, height], [half, 0, 0], [0, 0, -5]],
        [(0, 1), (1, 2)],
        [(1, 3)],
        rod_mass=1.0,
        stiffness=k,
        rest_length=height + 5,
        point_masses={3: 1.0},
    ).with_sections(Section(1e-4, 1e-9, VonMises.EA / 1e-4))
    far = 1.2 * float(truss.load(truss.limit[0]) / k + height)
    holds = [Hold(("n1", "n3")), Hold(("n2",), ((1, 0, 0), (0, 1, 0))), Hold(("n4",), displacement=(0, 0, -far))]
    path = follow(StaticModel.of(structure, rods=Rods.ELASTIC, holds=holds), points=points, longest=20.0)
    turn = math.sqrt((half**2 / (1 / truss.length + k / (2 * truss.EA))) ** (2 / 3) - half**2)
    assert truss.slope(turn) == pytest.approx(k)
    expected = [height - z + float(truss.load(z)) / k for z in (turn, -turn)]
    assert expected[0] > expected[1]  # it does go back
    # A string cannot push: it hangs slack from the flat truss while its end goes up past the apex, and pulls it on
    # upwards, turned over: 2 L0 further up.
    expected[1] -= 2 * (height + 5)
    ends = [one for one in path.criticals if one.kind is Kind.LIMIT]
    assert (ends[0].unstable_before, ends[0].unstable_after) == (0, 1)
    assert [one.parameter * far for one in ends] == pytest.approx(expected, rel=LOCATED)
    z = path.nodes[:, 1, 2]
    side = np.where(truss.load(z) < 0, 2 * (height + 5), 0.0)
    taut = ~np.array([state.slack[0] for state in path.states])
    assert np.allclose((path.parameters * far)[taut], (height - z - side + truss.load(z) / k)[taut], atol=1e-9)
    assert np.all(np.min(np.abs([z, z + height, z - height]), axis=0)[~taut] < 1e-12)


# ----------------------------------------------------------------------------------------------------------- struts


def strut(bending: float, planar: bool) -> tuple[StaticModel, Array]:
    """Two rigid rods of 1 m in a line along z, whose joint resists bending; P pushes the upper end down.

    With both rods at θ the energy is κ (1 - cos 2θ) - 2 P (1 - cos θ): bent equilibria have P = 2 κ cos θ.
    """
    structure = Structure.from_arrays(
        [[0, 0, 0], [0, 0, 1], [0, 0, 2]], [(0, 1), (1, 2)], [], rod_mass=1.0, stiffness=1.0
    )
    holds = [Hold(("n1",)), Hold(("n3",), ((1, 0, 0), (0, 1, 0)))]
    holds += [Hold(("n2",), ((0, 1, 0),))] if planar else []
    scene = Scene(structure, resistance=Resistance(bending=Bending(bending)))
    return StaticModel.of(scene, holds=holds), load(structure, "n3", (0, 0, -1.0))


@pytest.mark.parametrize("planar", [True, False])
def test_a_strut_with_a_stiff_joint_buckles(planar: bool) -> None:
    kappa = 3.0
    model, down = strut(kappa, planar)
    path = follow(model, loads=10 * down, points=7)
    assert path.end is End.REACHED
    count = 1 if planar else 2  # in space it buckles to any side
    assert kinds(path) == [(Kind.BIFURCATION, 0, count)]
    (critical,) = path.criticals
    assert critical.parameter * 10 == pytest.approx(2 * kappa, rel=LOCATED)
    assert critical.modes.shape == (count, 3, 3)
    assert np.allclose(np.abs(critical.modes).max(axis=(1, 2)), 1, atol=1e-12)
    assert np.allclose(critical.modes[:, [0, 2]], 0, atol=1e-9)
    assert np.allclose(path.nodes, path.nodes[0], atol=1e-14)


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("planar", [True, False])
def test_the_branch_of_the_strut_is_followed_from_its_critical_state(planar: bool, side: float) -> None:
    kappa = 3.0
    model, down = strut(kappa, planar)
    critical = follow(model, loads=10 * down, points=7).criticals[0]
    branch = follow(critical.state, direction=side * critical.mode, points=20, longest=0.7)
    bent = branch.nodes[1:, 1] @ critical.mode[1]
    assert np.all(np.diff(np.concatenate([[0], side * bent])) > 0)
    assert side * bent[-1] > 0.3
    # Rods of 1 m: sin θ is how far the joint is off the line.
    theta = np.arcsin(np.linalg.norm(branch.nodes[:, 1, :2], axis=1))
    assert np.allclose(branch.parameters * 10, 2 * kappa * np.cos(theta), rtol=0, atol=1e-9)
    # It falls, so the bent strut is unstable under a load that is set; in space it turns freely besides.
    assert np.all(branch.unstable[1:] == 1)


class Column:
    """Rigid rods in a line along z, pinned at the bottom, led along z at the top; joints between them resist bending.

    Small deflections w of the joints have the energy Σ ½ κ ((w_i - w_{i-1})/ℓ_i - (w_{i+1} - w_i)/ℓ_{i+1})² and lower
    the top by Σ (w_i - w_{i-1})²/(2 ℓ_i): Euler's loads are the eigenvalues of the pair. Both ends are hinges without
    springs. For n rods of one length, w_i = sin(π i/n) gives the lowest: P = 4 κ/ℓ sin²(π/2n).
    """

    kappa = 500.0

    def __init__(self, lengths: Array, off: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> None:
        self.lengths = lengths
        count = len(lengths)
        places = np.zeros((count + 1, 3))
        places[1:, 2] = np.cumsum(lengths)
        self.structure = Structure.from_arrays(
            places + np.array(off), [(k, k + 1) for k in range(count)], [], rod_mass=1e-3, stiffness=1.0
        )
        scene = Scene(self.structure, resistance=Resistance(bending=Bending(self.kappa)))
        self.top = f"n{count + 1}"
        self.model = StaticModel.of(scene, holds=[Hold(("n1",)), Hold((self.top,), ((1, 0, 0), (0, 1, 0)))])
        self.down = load(self.structure, self.top, (0, 0, -1.0))

    @property
    def loads(self) -> Array:
        """Euler's, ascending [N]."""
        slopes = np.diff(np.eye(len(self.lengths) + 1), axis=0)[:, 1:-1] / self.lengths[:, None]
        bends = slopes[:-1] - slopes[1:]
        lowered = (slopes * self.lengths[:, None]).T @ slopes
        return np.asarray(eigh(self.kappa * bends.T @ bends, lowered, eigvals_only=True))

    def bent(self, state: StaticState, plane: Array) -> Array:
        """Torques [N m] that are left on rods at angles θ to z: those of joints, of the load, and of the lead's push.

        κ e = κ (b_i - b_{i+1}) of unit vectors b is a torque of κ sin(θ_{i+1} - θ_i).
        """
        b = np.diff(state.nodes, axis=0) / self.lengths[:, None]
        theta = np.arctan2(b @ plane, b[:, 2])
        joint = self.kappa * np.sin(np.diff(theta))
        torque = np.append(joint, 0.0) - np.append(0.0, joint)
        down = -float(state.model.loads[-1, 2]) * state.parameter
        torque += down * self.lengths * np.sin(theta)
        push = self.lengths * np.cos(theta)  # of 1 N
        return np.asarray(torque - push * float(push @ torque) / float(push @ push))


@pytest.mark.parametrize("lengths", [np.full(10, 0.2), np.array([0.3, 0.1, 0.25, 0.2, 0.15, 0.4]), np.full(4, 50.0)])
def test_a_column_of_links_has_eulers_load_and_its_branch(lengths: Array) -> None:
    column = Column(lengths)
    first, second = column.loads[:2]
    if np.ptp(lengths) == 0:
        count = len(lengths)
        assert first == pytest.approx(4 * column.kappa / lengths[0] * math.sin(math.pi / (2 * count)) ** 2, rel=1e-10)
    full = 0.9 * second
    path = follow(column.model, loads=full * column.down, points=20)
    assert path.end is End.REACHED
    assert kinds(path) == [(Kind.BIFURCATION, 0, 2)]
    (critical,) = path.criticals
    assert critical.parameter * full == pytest.approx(first, rel=LOCATED)
    assert np.allclose(path.rod_forces[-1], -full, rtol=1e-12)
    branch = follow(critical.state, direction=critical.mode, points=12, longest=1.0)
    plane = critical.mode[1] / np.linalg.norm(critical.mode[1])
    sideways = np.abs(branch.nodes @ plane).max(axis=1)
    assert sideways[-1] > 0.05 * lengths.sum()
    # Near the start it is a parabola, P = P1 + O(w²), and rises as an elastica between hinges does.
    assert np.all(np.diff(branch.parameters) > 0)
    assert np.all(branch.unstable[1:] == 0)
    for state in branch.states[1:]:
        # Round-off of forces is some ε κ/ℓ a rod, and so some ε κ of torque.
        assert np.abs(column.bent(state, plane)).max() < 1e3 * np.finfo(float).eps * column.kappa


def test_a_column_far_from_the_origin_has_the_same_load() -> None:
    """Positions have errors of ε 1000 m: forces of 6 κ/ℓ² times that, some 2e-8 N, or 1e-10 of the load."""
    column = Column(np.full(10, 0.2), off=(600.0, -800.0, 500.0))
    path = follow(column.model, loads=500 * column.down, points=8)
    assert [one.parameter * 500 for one in path.criticals] == [pytest.approx(column.loads[0], rel=1e-7)]


@pytest.mark.parametrize("seed", range(4))
def test_a_column_in_any_direction_starts_and_buckles(seed: int) -> None:
    """At its start round-off leaves forces of ε κ/ℓ, and nothing but bending says that these are none."""
    rng = np.random.default_rng(seed)
    column = Column(rng.uniform(0.1, 0.4, 7))
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    structure = replace(column.structure, nodes={n: tuple(turn @ x) for n, x in column.structure.nodes.items()})
    scene = column.model.scene.with_(structure=structure)
    holds = [Hold(("n1",)), Hold((column.top,), (tuple(turn[:, 0]), tuple(turn[:, 1])))]
    model = StaticModel.of(scene, holds=holds)
    start = find_equilibrium(model)
    assert start.iterations == 0
    assert balance(model).is_equilibrium
    left = model.gradient(start.x) + model.rod_pulls(start.x, start.rod_forces)
    assert 0 < np.abs(left).max() < 1e-10  # some ε κ/ℓ = 1e-12 N a joint
    path = follow(model, loads=500 * column.down @ turn.T, points=6, stop_at_critical=True)
    assert path.end is End.CRITICAL
    assert path.parameters[-1] * 500 == pytest.approx(column.loads[0], rel=LOCATED)


def test_a_path_without_any_other_force_than_bending_starts(
    tmp_path: FilePath, capsys: pytest.CaptureFixture[str]
) -> None:
    """Nothing pulls at the start: what is left there is to be seen against the joints' stiffness."""
    column = Column(np.full(10, 0.2))
    rods = tuple(
        replace(rod, support=Support.pinned(0.0)) if not k else rod for k, rod in enumerate(column.structure.rods)
    )
    scene = column.model.scene.with_(structure=replace(column.structure, rods=rods), gravity=(0.0, 0.0, 0.0))
    file = tmj.save_scene(scene, tmp_path / "column.toml")
    assert main(["statics", str(file), "--hold", "n11:xy", "--load", "n11=0,0,-500", "--path", "--json"]) == 0
    (critical,) = json.loads(capsys.readouterr().out)["path"]["criticals"]
    assert critical["kind"] == "bifurcation"
    assert critical["parameter"] * 500 == pytest.approx(column.loads[0], rel=LOCATED)


class Mast:
    """A rigid rod of length a on a pin, held by two strings of stiffness k to points d away along y; P on its top."""

    a, d, k = 2.0, 1.5, 50.0

    def __init__(self, tension: float = 6.0) -> None:
        a, d = self.a, self.d
        self.tension = tension
        nodes = [[0, 0, 0], [0, 0, a], [0, d, a], [0, -d, a]]
        self.structure = Structure.from_arrays(
            nodes,
            [(0, 1)],
            [(1, 2), (1, 3)],
            rod_mass=1.0,
            stiffness=self.k,
            rest_length=d - tension / self.k,
            fixed_nodes=(2, 3),
        )
        self.model = StaticModel.of(self.structure, holds=[Hold(("n1",))])
        self.down = load(self.structure, "n2", (0, 0, -1.0))


def test_a_mast_buckles_across_its_strings_and_carries_more_on_the_branch() -> None:
    """Towards x, across both strings: L² = d² + 2 a² (1 - cos θ); 2 k (1 - L0/L) a² sin θ = P a sin θ.

    Towards y, along them, at first order P = 2 k a, some 10 times more: the second critical point.
    """
    mast = Mast()
    rest = mast.d - mast.tension / mast.k
    first, second = 2 * mast.tension / mast.d * mast.a, 2 * mast.k * mast.a
    top = 1.2 * second
    path = follow(mast.model, loads=top * mast.down, points=9)
    assert kinds(path) == [(Kind.BIFURCATION, 0, 1), (Kind.BIFURCATION, 1, 2)]
    assert [one.parameter * top for one in path.criticals] == pytest.approx([first, second], rel=LOCATED)
    assert np.allclose(path.criticals[0].mode[1], [1, 0, 0], atol=1e-9)
    branch = follow(path.criticals[0].state, direction=path.criticals[0].mode, points=12, longest=0.5)
    cosine = branch.nodes[:, 1, 2] / mast.a
    lengths = np.sqrt(mast.d**2 + 2 * mast.a**2 * (1 - cosine))
    assert np.allclose(branch.parameters * top, 2 * mast.k * mast.a * (1 - rest / lengths), rtol=0, atol=1e-9 * top)
    assert np.all(np.diff(branch.parameters) > 0)
    assert np.all(branch.unstable[1:] == 0)
    assert cosine[-1] < 0.9


def test_without_a_direction_a_critical_state_leads_on_along_the_path_itself() -> None:
    mast = Mast()
    path = follow(mast.model, loads=60 * mast.down, points=9)
    on = follow(path.criticals[0].state, points=5)
    assert on.end is End.REACHED
    assert np.allclose(on.nodes, path.nodes[0], atol=1e-9)


# ----------------------------------------------------------------------------------------------------- slack strings


@pytest.mark.parametrize("points", [3, 20])
def test_the_slope_of_a_path_changes_where_a_string_becomes_slack(points: int) -> None:
    """A mass between two strings, k = 100 and 1 N/m, tension .5 N: the stiff one is slack at .505 N, at .005 m."""
    structure = Structure.from_arrays(
        [[-1, 0, 0], [0, 0, 0], [1, 0, 0]],
        np.zeros((0, 2), int),
        [(0, 1), (1, 2)],
        rod_mass=np.zeros(0),
        stiffness=[100.0, 1.0],
        tension=0.5,
        fixed_nodes=(0, 2),
        point_masses={1: 1.0},
    )
    model = StaticModel.of(structure, holds=[Hold(("n2",), ((0, 1, 0), (0, 0, 1)))])
    path = follow(model, loads=load(structure, "n2", (-0.7, 0, 0)), points=points, longest=30.0)
    assert path.end is End.REACHED
    force = 0.7 * path.parameters
    assert np.allclose(-path.nodes[:, 1, 0], np.where(force <= 0.505, force / 101, 0.005 + (force - 0.505)), atol=1e-12)
    assert not path.criticals
    # As many as wanted, and the two next to where the string becomes slack.
    assert len(path.states) <= points + 3
    first = Response.of(path).slack_events[0]
    assert np.allclose(force[first.point - 1 : first.point + 1], 0.505, atol=0.7 / points)
    assert (first.string, first.slack) == ("s1", True)
    assert not path.states[first.point - 1].slack.any()


@pytest.mark.parametrize("points", [6, 40])
def test_a_slack_string_takes_stability_and_the_parameter_turns(points: int) -> None:
    """A mast under P, k a < P < 2 k a, is pushed along its strings: once one is slack, the push must fall."""
    mast = Mast(tension=3.0)
    a, d, k = mast.a, mast.d, mast.k
    weight = 1.5 * k * a
    rest = d - mast.tension / k
    model = StaticModel.of(mast.structure, holds=[Hold(("n1",)), Hold(("n2",), ((1, 0, 0),))], loads=weight * mast.down)
    start = find_equilibrium(model)
    path = follow(start, loads=load(mast.structure, "n2", (0, 10.0, 0)), points=points, longest=3.0)
    # The string ahead is slack where |(0, d, a) - a (0, sin θ, cos θ)| = L0.
    thetas = np.linspace(0, 0.2, 200_001)

    def lengths(theta: Array, side: float) -> Array:
        return np.hypot(a * np.sin(theta) - side * d, a * (1 - np.cos(theta)))

    at = float(np.interp(0.0, rest - lengths(thetas, 1), thetas))

    def push(theta: Array) -> Array:
        """From the couple about the pin: Σ k (L - L0)₊ dL/dθ - P a sin θ = H a cos θ."""
        couple = -weight * a * np.sin(theta)
        for side in (1, -1):
            L = lengths(theta, side)
            slope = (
                (a * np.sin(theta) - side * d) * a * np.cos(theta) + a**2 * (1 - np.cos(theta)) * np.sin(theta)
            ) / L
            couple = couple + k * np.maximum(0, L - rest) * slope
        return np.asarray(couple / (a * np.cos(theta)))

    assert kinds(path)[0] == (Kind.SLACK, 0, 1)
    assert path.criticals[0].parameter * 10 == pytest.approx(float(push(np.array(at))), rel=1e-6)
    theta = np.arcsin(path.nodes[:, 1, 1] / a)
    assert np.all(np.diff(theta) > 0)
    assert theta[-1] > 1.5 * at
    assert np.allclose(10 * path.parameters, push(theta), atol=1e-9)
    peak = int(np.argmax(path.parameters))
    assert np.all(np.diff(path.parameters[: peak + 1]) > 0)
    assert path.parameters[-1] < path.parameters[peak]


# ------------------------------------------------------------------------------------------ work, rates, and itself


def prism(stages: int = 2, **options: Any) -> Any:
    return find_equilibrium(tower(stages, stiffness=1e4, prestress_measure=0.1, **options))


BASE, TOP = tuple(base_nodes()), tuple(top_nodes(2))


def elastic(structure: Structure) -> Structure:
    return structure.with_sections(Section(1e-4, 1e-9, 2e5 / 1e-4))


def starts() -> list[tuple[str, StaticModel, list[Hold], Array]]:
    """Models, holds that move them, and loads: a tower, rigid or elastic, heavy, taut nets, linked rods."""
    out = []
    state = prism()
    scene = state.scene()
    count = len(scene.structure.nodes)
    shove = np.zeros((count, 3))
    shove[3] = (5.0, 30.0, -20.0)
    holds = [Hold(BASE), Hold(TOP, displacement=(-0.05, 0.03, 0.02))]
    heavy = scene.with_(gravity=(0.0, 0.0, -9.81))
    out.append(("tower", StaticModel.of(scene, holds=[Hold(BASE), Hold(TOP)]), holds, shove))
    out.append(
        (
            "heavy elastic tower",
            StaticModel.of(
                heavy.with_(structure=elastic(heavy.structure)), rods=Rods.ELASTIC, holds=[Hold(BASE), Hold(TOP)]
            ),
            holds,
            shove,
        )
    )
    rng = np.random.default_rng(5)
    taut = random_taut_structure(rng, rods=3, pinned=0.0, prestrain=(0.03, 0.1))
    name = taut.rods[0].nodes[0]
    pull = np.zeros((len(taut.nodes), 3))
    pull[taut.node_index[taut.rods[1].nodes[1]]] = (1.0, -0.6, 0.3)
    out.append(
        ("net", StaticModel.of(taut, holds=[Hold((name,))]), [Hold((name,), displacement=(0.006, 0.01, -0.006))], pull)
    )
    nodes = np.array([[0, 0, 0], [0, 0, 1], [0.3, 0, 1.9], [2, 2, 1.5], [-2, 2, 1.5], [2, -2, 1.5], [-2, -2, 1.4]])
    strings = [(i, j) for i in (1, 2) for j in (3, 4, 5, 6)]
    lengths = np.array([np.linalg.norm(nodes[i] - nodes[j]) for i, j in strings])
    linked = Structure.from_arrays(
        nodes,
        [(0, 1), (1, 2)],
        strings,
        rod_mass=1.0,
        stiffness=50.0,
        rest_length=0.7 * lengths,
        fixed_nodes=(3, 4, 5, 6),
    )
    pin, along = Hold(("n1",)), ((0.0, 0.0, 1.0),)
    there = find_equilibrium(StaticModel.of(linked, holds=[pin])).scene()
    pull = load(linked, "n2", (2.0, -1.0, 0.5))
    model = StaticModel.of(there, holds=[pin, Hold(("n3",), along)])
    out.append(("linked", model, [pin, Hold(("n3",), along, (0.0, 0.0, -0.05))], pull))
    return out


STARTS = {name: (model, holds, loads) for name, model, holds, loads in starts()}


def internal_energy(path: Path) -> Array:
    """(P,) [J] without the loads that the parameter multiplies, from places at which nothing else is set to zero."""
    return np.array(
        [
            state.energy + state.parameter * float(np.sum(state.model.loads * (state.nodes - state.model.start)))
            for state in path.states
        ]
    )


@pytest.mark.parametrize("name", STARTS)
def test_reactions_and_loads_do_the_work_that_the_energy_takes(name: str) -> None:
    """∫ R·dd + s f·dx = ΔU, over a cubic spline of the power: its error falls with the fourth power of the steps."""
    model, holds, loads = STARTS[name]
    path = follow(model, loads=loads, holds=holds, points=24)
    assert path.end is End.REACHED
    rates = path.rates / path.parameter_rates[:, None]
    moved = path.model.boundary.moved
    power = np.array(
        [
            float(state.reactions.ravel() @ moved) + state.parameter * float(path.model.loads.ravel() @ rate)
            for state, rate in zip(path.states, rates, strict=True)
        ]
    )
    energy = internal_energy(path)
    from scipy.interpolate import CubicSpline

    total = CubicSpline(path.parameters, power).integrate(0.0, 1.0)
    assert total == pytest.approx(energy[-1] - energy[0], rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("name", STARTS)
def test_the_rate_of_a_reaction_is_its_derivative(name: str) -> None:
    model, holds, loads = STARTS[name]
    path = follow(model, loads=loads, holds=holds, points=6)
    middle = path.states[3]
    nodes, h = list(holds[-1].nodes), 1e-4
    before, after = (follow(middle, to=middle.parameter + sign * h, points=2) for sign in (-1, 1))
    difference = (after.reaction(nodes)[-1] - before.reaction(nodes)[-1]) / (2 * h)
    # Central differences: h² of the third derivative, and 1e-12 of the forces over h.
    scale = float(np.abs(path.reaction(nodes)).max()) + float(np.abs(path.reaction_rate(nodes)).max())
    assert np.allclose(path.reaction_rate(nodes)[3], difference, rtol=0, atol=1e-6 * scale)


@pytest.mark.parametrize("name", STARTS)
def test_there_and_back_and_by_other_steps_it_is_the_same(name: str) -> None:
    model, holds, loads = STARTS[name]
    path = follow(model, loads=loads, holds=holds, points=4)
    back = follow(path.states[-1], to=0.0, points=7)
    assert back.parameters[-1] == 0.0
    size = model.scale[0]
    assert np.allclose(back.nodes[-1], path.nodes[0], rtol=0, atol=1e-9 * size)
    fine = follow(model, loads=loads, holds=holds, points=11)
    assert np.allclose(fine.nodes[-1], path.nodes[-1], rtol=0, atol=1e-9 * size)
    # Newton's method from the start finds the same state.
    direct = find_equilibrium(path.model, parameter=1.0)
    assert np.allclose(direct.nodes, path.nodes[-1], rtol=0, atol=1e-8 * size)


def test_set_loads_and_set_displacements_agree_before_the_limit_point() -> None:
    state = prism()
    held = StaticModel.of(state.scene(), holds=[Hold(BASE), Hold(TOP)])
    moved = follow(held, holds=[Hold(BASE), Hold(TOP, displacement=(-0.06, 0.0, 0.0))], points=8)
    forces = moved.states[-1].reactions[[held.structure.node_index[n] for n in TOP]]
    loads = np.zeros_like(state.nodes)
    loads[[held.structure.node_index[n] for n in TOP]] = forces
    pushed = follow(StaticModel.of(state.scene(), holds=[Hold(BASE)]), loads=loads, points=8)
    assert np.allclose(pushed.nodes[-1], moved.nodes[-1], rtol=0, atol=1e-8)


def test_a_floating_tower_is_pulled_at_both_ends() -> None:
    """Nothing holds it: only loads that balance each other, and turns about their line move nothing."""
    state = prism(3)
    loads = np.zeros_like(state.nodes)
    loads[:3, 0], loads[-3:, 0] = -100.0 / 3, 100.0 / 3
    path = follow(state, loads=loads, points=8)
    assert path.end is End.REACHED
    assert not path.criticals
    assert path.states[-1].neutral_motions.shape[1] == 4  # three shifts, and a turn about the line of the loads

    def length(nodes: Array) -> float:
        return float(np.linalg.norm(nodes[-3:].mean(axis=0) - nodes[:3].mean(axis=0)))

    assert length(path.nodes[-1]) > length(path.nodes[0])
    # Virtual work of the whole: the force at its ends is dU/d(length), by Simpson's rule over the points.
    from scipy.interpolate import CubicSpline

    lengths = np.array([length(nodes) for nodes in path.nodes])
    taken = CubicSpline(lengths, 100.0 * path.parameters).integrate(lengths[0], lengths[-1])
    energy = internal_energy(path)
    assert taken == pytest.approx(energy[-1] - energy[0], rel=1e-5)


# ------------------------------------------------------------------------------------------------- starts and words


def test_a_path_goes_on_from_a_state_that_is_on_it_and_what_was_applied_stays() -> None:
    model, holds, loads = STARTS["tower"]
    whole = follow(model, loads=loads, holds=holds, points=4)
    half = follow(model, loads=loads, holds=holds, to=0.5, points=4)
    on = follow(half.states[-1], points=4)
    assert np.allclose(on.nodes[-1], whole.nodes[-1], atol=1e-9)
    # Further holds from there, with the loads as they are: there and back is where it began.
    further = follow(half.states[-1], holds=[Hold(BASE), Hold(TOP, displacement=(0.01, 0.0, 0.0))], points=3)
    assert np.allclose(further.states[0].reactions, half.states[-1].reactions, atol=1e-6)
    assert np.allclose(further.nodes[-1][-3:], half.nodes[-1][-3:] + np.array([0.01, 0, 0]), atol=1e-12)
    # Further loads: holds stay where they are.
    loaded = follow(half.states[-1], loads=loads, points=3)
    assert np.allclose(loaded.nodes[-1][-3:], half.nodes[-1][-3:], atol=1e-12)
    assert not np.allclose(loaded.nodes[-1], half.nodes[-1], atol=1e-4)


@pytest.mark.parametrize("points", [7, 40])
def test_a_path_has_at_most_as_many_points_as_wanted(points: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """A truss that snaps through goes some five times the arc of a straight path."""
    steps = []
    arrived = Walk.step
    monkeypatch.setattr(Walk, "step", lambda *given, **options: steps.append(1) or arrived(*given, **options))
    truss = VonMises(1.0, 0.2)
    path = follow(truss.model, loads=2 * truss.limit[1] * truss.down, points=points, longest=20.0)
    assert path.end is End.REACHED
    assert len(path.criticals) == 2
    assert points / 2 < len(path.states) <= points + 1
    # Steps are √2/points long at first, and arc/points later: points (1 + log(arc/√2)) of them, and those that look
    # for two critical points and for where the curve bends.
    assert len(steps) < 3 * points + 60
    heights = path.nodes[:, 1, 2]
    assert np.all(np.diff(heights) < 0)
    assert np.allclose(path.parameters * 2 * truss.limit[1], truss.load(heights), rtol=0, atol=1e-9 * truss.limit[1])


@pytest.mark.parametrize("name", ["column", *STARTS])
def test_dense_and_sparse_matrices_give_the_same_path(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    column = Column(np.full(4, 0.2))
    model, holds, loads = STARTS[name] if name in STARTS else (column.model, None, 400 * column.down)
    dense = follow(model, loads=loads, holds=holds, points=6)
    monkeypatch.setattr(boundary, "SMALL", 0)
    other = follow(model.with_(), loads=loads, holds=holds, points=6)
    assert not other.model.boundary.is_small
    size = model.scale[0]
    assert np.allclose(other.nodes, dense.nodes, rtol=0, atol=1e-9 * size)
    assert np.allclose(other.lowest, dense.lowest, rtol=1e-6, atol=1e-9 * model.scale[1])
    assert kinds(other) == kinds(dense)


def test_a_negative_end_is_the_path_of_opposite_loads() -> None:
    model, _, loads = STARTS["tower"]
    down, up = follow(model, loads=loads, to=-1.0, points=3), follow(model, loads=-loads, points=3)
    assert down.parameters[-1] == -1.0
    assert np.allclose(down.nodes[-1], up.nodes[-1], atol=1e-9)


def test_units_do_not_matter() -> None:
    """The mast in other units of length, and with forces a million times larger."""
    mast = Mast()
    for length, force in ((1e6, 1.0), (1.0, 1e6), (1e-3, 1e-3)):
        structure = Structure.from_arrays(
            np.array(mast.structure.positions) * length,
            [(0, 1)],
            [(1, 2), (1, 3)],
            rod_mass=1.0,
            rod_radius=1e-3 * length,
            stiffness=mast.k * force / length,
            rest_length=(mast.d - mast.tension / mast.k) * length,
            fixed_nodes=(2, 3),
        )
        path = follow(StaticModel.of(structure, holds=[Hold(("n1",))]), loads=60 * force * mast.down, points=4)
        assert kinds(path) == [(Kind.BIFURCATION, 0, 1)]
        assert path.criticals[0].parameter * 60 == pytest.approx(2 * mast.tension / mast.d * mast.a, rel=LOCATED)


def test_it_ends_where_stability_is_lost_if_requested() -> None:
    mast = Mast()
    path = follow(mast.model, loads=60 * mast.down, points=9, stop_at_critical=True)
    assert path.end is End.CRITICAL
    assert path.parameters[-1] == path.criticals[0].parameter == pytest.approx(16 / 60, rel=LOCATED)


def test_redundant_rigid_rods_do_no_harm() -> None:
    """A rigid body of ten rods between five points, one more than it takes, pulled by strings and a load."""
    rng = np.random.default_rng(2)
    points = rng.uniform(-0.5, 0.5, (5, 3))
    anchors = 2.0 * np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1.0]])
    rods = [(i, j) for i in range(5) for j in range(i)]
    strings = [(i, 5 + (i + j) % 4) for i in range(5) for j in range(2)]
    nodes = np.vstack([points, anchors])
    lengths = np.array([np.linalg.norm(nodes[i] - nodes[j]) for i, j in strings])
    structure = Structure.from_arrays(
        nodes,
        rods,
        strings,
        rod_mass=1.0,
        stiffness=100.0,
        rest_length=0.8 * lengths,
        fixed_nodes=(5, 6, 7, 8),
    )
    path = follow(structure, loads=load(structure, "n1", (10.0, 5.0, -3.0)), points=4)
    assert path.end is End.REACHED
    assert max(state.residual for state in path.states) < 1e-9
    found = path.nodes[-1]
    apart = [np.linalg.norm(found[i] - found[j]) - np.linalg.norm(points[i] - points[j]) for i, j in rods]
    assert np.abs(apart).max() < 1e-12
    direct = find_equilibrium(path.model)
    assert np.allclose(found, direct.nodes, atol=1e-8)


def test_what_gives_way_at_the_start_is_said() -> None:
    loose = Structure.from_arrays([[0, 0, 0], [0, 0, 1]], [(0, 1)], [], rod_mass=1.0, stiffness=1.0)
    model = StaticModel.of(loose, holds=[Hold(("n1",))])
    with pytest.raises(InfeasibleError, match="gives way"):
        follow(model, loads=load(loose, "n2", (1.0, 0, 0)))
    truss = VonMises(1.0, 0.2)
    top = follow(truss.model, loads=2 * truss.limit[1] * truss.down, points=15, stop_at_critical=True)
    with pytest.raises(InfeasibleError, match="limit point"):
        follow(top.states[-1])
    on = follow(top.states[-1], direction=top.criticals[0].mode * -1, points=15, longest=0.3)
    assert np.all(np.diff(on.nodes[:, 1, 2]) < 0)
    assert np.all(np.diff(on.parameters) < 0)


def test_errors_name_what_is_wrong() -> None:
    model, holds, loads = STARTS["tower"]
    with pytest.raises(OptionError, match="the loads of the scene itself stay constant"):
        follow(model, holds=[Hold(BASE)])
    with pytest.raises(OptionError, match="is there already"):
        follow(model, loads=loads, to=0.0)
    with pytest.raises(OptionError, match="direction: it moves nothing"):
        follow(model, loads=loads, direction=np.zeros_like(loads))
    with pytest.raises(OptionError, match=r"loads = 1\.0; it must be an array of shape"):
        follow(model, loads=1.0)
    with pytest.raises(OptionError, match="contradict"):
        follow(model, holds=[*holds, Hold(TOP[:1], displacement=(0.0, 0.0, 1.0))])
    path = follow(model, holds=holds, points=2)
    with pytest.raises(InfeasibleError, match="nothing holds any more"):
        follow(path.states[-1], holds=[Hold(BASE)], loads=loads)
    with pytest.raises(OptionError, match="no node 'x'"):
        path.reaction(["x"])


def test_a_path_is_as_long_as_allowed() -> None:
    truss = VonMises(1.0, 0.2)
    path = follow(truss.model, loads=2 * truss.limit[1] * truss.down, points=10, longest=0.5)
    assert path.end is End.LONG
    assert len(path.states) <= 8


@pytest.mark.slow
def test_a_beam_of_thirty_stages_buckles_and_bears_no_more() -> None:
    """Appendix C's TB1 between fixed ends: two ways to bend at once, and hardly any stiffness once it is bent.

    An elastica between hinges rises by P/(2 L) a length of shortening, L = 24.7 m here; a beam that is also soft in
    shear by less. Straight, the beam has 10.4 kN/m.
    """
    from evidence.families.thesis_towers import appendix_beam

    state = find_equilibrium(appendix_beam("TB1"))
    top = top_nodes(30)
    path = follow(state, holds=[Hold(BASE), Hold(tuple(top), displacement=(-1.2, 0.0, 0.0))], points=4)
    assert kinds(path) == [(Kind.BIFURCATION, 0, 2)]
    assert path.criticals[0].parameter * 1.2 == pytest.approx(1.030496, abs=2e-6)
    branch = follow(path.criticals[0].state, direction=path.criticals[0].mode, points=5, longest=0.3)
    rates = branch.reaction_rate(top)[1:, 0] / -1.2
    load = -branch.reaction(top)[0, 0]
    assert np.all((rates > 0) & (rates < load / 24.7 / 2))
