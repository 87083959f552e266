"""Self-stress, signs, mechanisms, prestress stability and super-stability, against answers that are known."""

from __future__ import annotations

import json

import numpy as np
import pytest
from numpy.typing import NDArray

import tensegrity_mj as tmj
from tensegrity_mj.library.tower import Topology, tower
from tensegrity_mj.model.members import PointMass, String
from tensegrity_mj.model.rigidity import free_motions
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.statics import Hold, StaticModel, find_equilibrium
from tensegrity_mj.statics.linear_systems import Linearized
from tensegrity_mj.statics.prestress import Prestressability, prestressability
from tensegrity_mj.statics.self_stress import self_stress
from tensegrity_mj.statics.stiffening import Verdict

Array = NDArray[np.float64]
ROUND_OFF = 1e-12  # of singular values between 0.1 and 3, and 1e2 operations


def made(nodes: object, rods: object, strings: object, **more: object) -> Structure:
    return Structure.from_arrays(nodes, rods, strings, rod_mass=1.0, stiffness=100.0, **more)  # type: ignore[arg-type]


def prism(twist: float, n: int = 3) -> Structure:
    """Rods from i to i + 1 above; twist [degrees] of the upper polygon, from straight above i."""
    angles = 2 * np.pi * np.arange(n) / n
    low = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(n)])
    angles = angles + np.radians(twist)
    high = np.column_stack([np.cos(angles), np.sin(angles), np.ones(n)])
    around = [(i, (i + 1) % n) for i in range(n)]
    strings = [*around, *((n + i, n + j) for i, j in around), *((i, n + i) for i in range(n))]
    return made(np.vstack([low, high]), [(i, n + j) for i, j in around], strings)


def crossed_square() -> Structure:
    corners = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    return made(corners, [(0, 2), (1, 3)], [(0, 1), (1, 2), (2, 3), (3, 0)])


def six_bar() -> Structure:
    """The expanded octahedron: three pairs of parallel rods, half a length apart, 24 strings."""
    places = []
    for axis in range(3):
        for side in (0.5, -0.5):
            for end in (1.0, -1.0):
                place = np.zeros(3)
                place[axis], place[(axis + 1) % 3] = end, side
                places.append(place)
    nodes = np.array(places)
    apart = np.linalg.norm(nodes[:, None] - nodes[None], axis=2)
    strings = [(i, j) for i in range(12) for j in range(i) if abs(apart[i, j] - np.sqrt(1.5)) < 1e-12]
    return made(nodes, [(2 * i, 2 * i + 1) for i in range(6)], strings)


def two_squares() -> Structure:
    """Crossed squares that share an edge: a state of self-stress each."""
    corners = [[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0], [1, 1, 0], [2, 1, 0]]
    return made(corners, [(0, 4), (1, 3), (1, 5), (2, 4)], [(0, 1), (1, 2), (3, 4), (4, 5), (0, 3), (1, 4), (2, 5)])


# S, m, motions of the whole, all can pull, prestress stable, super stable
KNOWN = {
    # A three-rod prism turned by 30° has one of each; Connelly and Terrell 1995: super stable.
    "prism": (lambda: prism(30), 1, 1, 6, True, Verdict.YES, Verdict.YES),
    "prism of five": (lambda: prism(54, 5), 1, 30 - 6 - (20 - 1), 6, True, Verdict.YES, Verdict.YES),
    # Turned the other way, rods and verticals change parts: one state, in which strings would push.
    "prism, the wrong way": (lambda: prism(-150), 1, 1, 6, False, Verdict.NO, Verdict.NO),
    "prism, half way": (lambda: prism(20), 0, 0, 6, False, Verdict.NO, Verdict.NO),
    # Out of its plane the square is a mechanism, which prestress holds (Connelly 1982: a Cauchy polygon).
    "crossed square": (crossed_square, 1, 1, 6, True, Verdict.YES, Verdict.YES),
    # 30 members on 36 - 6: Pellegrino 1986.
    "six bars": (six_bar, 1, 1, 6, True, Verdict.YES, Verdict.YES),
    # It folds along the shared edge, whatever the prestress.
    "two squares": (two_squares, 2, 3, 6, True, Verdict.NO, Verdict.NO),
}


@pytest.mark.parametrize("name", KNOWN)
def test_known_structures(name: str) -> None:
    make, S, m, p, pull, stable, superb = KNOWN[name]
    found = prestressability(make())
    assert (len(found.self_stress), found.mechanisms.shape[1], found.rigid_motions.shape[1]) == (S, m, p)
    assert found.rank_is_clear
    assert found.all_can_pull is pull
    assert (found.prestress_stable, found.super_stable) == (stable, superb)
    assert found.is_rigid_to_first_order is False
    check(found)


def check(found: Prestressability) -> None:
    """What every answer has to satisfy, by sums written here once more."""
    structure, nodes = found.structure, found.nodes
    M = len(structure.strings)
    pairs = np.concatenate([structure.string_nodes, structure.rod_nodes])
    spans = nodes[pairs[:, 1]] - nodes[pairs[:, 0]]
    lengths = np.linalg.norm(spans, axis=1)
    units = spans / lengths[:, None]
    Z = StaticModel.of(structure).boundary.Z if found.free_coordinates == 3 * len(nodes) else None

    def changes(motion: Array) -> Array:
        moved = motion.reshape(-1, 3)
        return np.asarray(np.einsum("tx,tx->t", units, moved[pairs[:, 1]] - moved[pairs[:, 0]]))

    if Z is not None:
        for state in found.self_stress:
            force = np.zeros_like(nodes)
            np.add.at(force, pairs[:, 1], state[:, None] * units)
            np.add.at(force, pairs[:, 0], -state[:, None] * units)
            assert np.abs(force).max() < ROUND_OFF
        # Maxwell: members - S = coordinates - m - motions of the whole.
        assert (
            len(pairs) - len(found.self_stress)
            == 3 * len(nodes) - found.mechanisms.shape[1] - found.rigid_motions.shape[1]
        )
    for motion in np.hstack([found.mechanisms, found.rigid_motions]).T:
        assert np.abs(changes(motion)).max() < ROUND_OFF
    both = np.hstack([found.mechanisms, found.rigid_motions])
    assert np.abs(both.T @ both - np.eye(both.shape[1])).max(initial=0.0) < ROUND_OFF
    if found.obstacle is None:
        assert found.can_pull.all()
    else:
        change = changes(found.obstacle)
        assert np.abs(change[M:]).max(initial=0.0) < 1e-8  # the linear program's tolerance is 1e-10
        assert change[:M].min() > -1e-8
        assert np.array_equal(change[:M] > 1e-6, ~found.can_pull)
    if found.prestress is not None and not found.own:
        t = found.prestress
        assert abs(t[:M].max() - 1) < 1e-9
        assert np.all((t[:M] > 1e-6) == found.can_pull)
        assert np.all(found.prestress_stiffness <= found.prestress_stiffness[-1:])
        if len(found.prestress_stiffness):
            # The energy of constant forces, to second order, of the softest motion.
            assert found.prestress_stiffness[0] <= found.stiffness_bound * (1 + 1e-9) + 1e-9
            for motion in found.taut_mechanisms.T:
                h = 1e-3
                moved = [nodes + s * h * motion.reshape(-1, 3) for s in (1, -1)]
                stretch = sum(np.linalg.norm(x[pairs[:, 1]] - x[pairs[:, 0]], axis=1) for x in moved) - 2 * lengths
                assert (
                    abs(t @ stretch / h**2 - _form(t, lengths, units, pairs, motion)) < 1e-4 * np.abs(t / lengths).sum()
                )
    json.dumps(found.to_dict())
    assert all(isinstance(line, str) and line for line in found.describe())


def _form(t: Array, lengths: Array, units: Array, pairs: Array, motion: Array) -> float:
    moved = motion.reshape(-1, 3)
    apart = moved[pairs[:, 1]] - moved[pairs[:, 0]]
    along = np.einsum("tx,tx->t", units, apart)
    return float(np.sum(t / lengths * (np.sum(apart**2, axis=1) - along**2)))


def test_the_prism_in_numbers() -> None:
    """At 30° force densities are 1 of verticals, -1 of rods, and h/l = 1/√3 of the triangles' strings (Motro 2003)."""
    found = prestressability(prism(30))
    density = found.force_densities[0] / found.force_densities[0][6]
    assert np.abs(density - [*[1 / np.sqrt(3)] * 6, 1, 1, 1, -1, -1, -1]).max() < 1e-12
    # The stress matrix has rank 6 - 4, and its kernel holds the nodes.
    values = np.linalg.eigvalsh(found.stress_matrix)
    assert np.sum(np.abs(values) < 1e-12) == 4
    assert values[0] > -1e-12
    assert np.abs(found.stress_matrix @ found.nodes).max() < 1e-12
    assert found.all_can_push
    assert found.can_push.all()


def test_one_mode_is_exact_and_its_bound_is_met() -> None:
    """With one state there is nothing to seek: the bound is the stiffness, for a largest string tension of 1 N."""
    found = prestressability(prism(30))
    assert abs(found.prestress_stiffness[0] / found.stiffness_bound - 1) < 1e-9


def test_the_stiffest_of_several_states() -> None:
    """A mass on four strings in a line: the best mix of three states is known.

    Two strings are 1 m long, two 2 m. With T1 and T2 in them they make 2 (T1/1 + T2/2) across the line; the largest is
    that of T1 = T2 = 1 N: 3 N/m, the same for y and z.
    """
    nodes = {"m": (0, 0, 0), "a": (1, 0, 0), "b": (-1, 0, 0), "c": (2, 0, 0), "d": (-2, 0, 0)}
    strings = tuple(String(f"s{name}", ("m", name), 10.0) for name in "abcd")
    structure = Structure(
        "mass", nodes, strings=strings, fixed_nodes=tuple("abcd"), point_masses=(PointMass("m", 1.0),)
    )
    found = prestressability(structure)
    assert (len(found.self_stress), found.mechanisms.shape[1], found.rigid_motions.shape[1]) == (3, 2, 0)
    # A state without one of them is in balance too: a and d alone, for one.
    assert found.all_can_pull
    assert found.prestress_stable is Verdict.YES
    assert 3 - 1e-9 <= found.stiffness_bound <= 3 * 1.002  # the search may stop within 1e-3 of the bound
    assert found.prestress_stiffness[0] > 0.5 * 3  # some of it is given up to keep all strings taut
    assert found.super_stable is Verdict.NOT_APPLICABLE


@pytest.mark.parametrize("name", ["tbar", "dbar", "cross", "net", "truss_arm", "prism", "suspended_cable"])
def test_states_of_self_stress_are_those_of_another_assembly(name: str) -> None:
    """`prestress.self_stress` has rods carry what they must; here they are members: the strings' part is the same."""
    scene = tmj.load_scene(name)
    found = prestressability(Scene(scene.structure))
    other = self_stress(scene.structure)
    M = len(scene.structure.strings)
    densities = found.force_densities[:, :M]
    if len(densities) and M:
        rods_alone = len(densities) - np.linalg.matrix_rank(densities, tol=1e-9)
        assert np.linalg.matrix_rank(densities, tol=1e-9) == len(other.modes)
        span = np.linalg.qr(other.modes.T)[0]
        assert np.abs(densities.T - span @ (span.T @ densities.T)).max() < 1e-9
    else:
        rods_alone = len(found.self_stress)
        assert not len(other.modes)
    # Redundant rods have states by themselves, and leave as many motions as rods that are not.
    assert rods_alone >= 0
    assert found.mechanisms.shape[1] + found.rigid_motions.shape[1] == other.mechanisms + other.rigid_motions
    model = StaticModel.of(scene.structure)
    both = np.hstack([found.mechanisms, found.rigid_motions])
    at = Linearized(model, model.start.ravel(), 0.0, np.zeros(len(model.rod_lengths)))
    T = model.boundary.Z @ at.tangent_basis()
    assert np.abs(both - T @ (T.T @ both)).max(initial=0.0) < 1e-9
    assert T.shape[1] == np.linalg.matrix_rank(free_motions(scene.structure))


@pytest.mark.parametrize("topology", list(Topology))
def test_two_stages(topology: Topology) -> None:
    """Snelson's: form-found, of 24 strings and 6 rods on 36 - 6 coordinates."""
    state = find_equilibrium(tower(2, topology=topology, form_found=False))
    own, best = prestressability(state), prestressability(state.scene())
    S = 3 if topology is Topology.REDUCED_A else 1
    for found in (own, best):
        assert len(found.self_stress) == found.mechanisms.shape[1] == S
        assert found.prestress_stable is Verdict.YES
        assert found.rank_is_clear
        check(found)
    assert own.own
    assert not best.own
    assert own.prestress is not None
    assert best.prestress is not None
    # What pulls in the state can pull; slack diagonals are those that cannot.
    assert np.array_equal(own.can_pull, best.can_pull)
    assert np.array_equal(best.can_pull, ~state.slack)
    assert best.all_can_pull is (topology is Topology.FULL)
    assert (best.super_stable is Verdict.YES) is (topology is Topology.FULL)
    # The state's own forces are one of the states of self-stress, none of which is stiffer than the bound.
    largest = own.prestress[:24].max()
    assert own.prestress_stiffness[0] / largest <= best.stiffness_bound * (1 + 1e-6)
    inside = best.self_stress.T @ (best.self_stress @ own.prestress)
    assert np.abs(inside - own.prestress).max() < 1e-9 * largest
    # And the stiffness of statics on the mechanisms is theirs, where strings' own stiffness has no part.
    K = state.model.hessian(state.x, state.rod_forces)
    form = np.linalg.eigvalsh(own.taut_mechanisms.T @ (K @ own.taut_mechanisms))
    assert np.abs(form - own.prestress_stiffness).max() < 1e-6 * form[-1]


def test_supports_and_holds_take_part() -> None:
    """A prism on the floor with its triangle held: the twist is left, and prestress of the other strings holds it."""
    structure = prism(30)
    free, held = prestressability(structure), prestressability(structure, holds=(Hold(("n1", "n2", "n3")),))
    assert held.free_coordinates == 9
    assert held.rigid_motions.shape[1] == 0
    # Three strings join held nodes: a state of self-stress each, besides that of the whole.
    assert len(held.self_stress) == 4
    assert held.mechanisms.shape[1] == 1
    assert held.prestress_stable is Verdict.YES
    assert held.super_stable is Verdict.NOT_APPLICABLE
    assert "supports" in held.reasons[1]
    assert free.prestress_stable is Verdict.YES
    # Held by one node it turns about it; two hold it on an axis.
    assert prestressability(structure, holds=(Hold(("n1",)),)).rigid_motions.shape[1] == 3
    assert prestressability(structure, holds=(Hold(("n1", "n2")),)).rigid_motions.shape[1] == 1
    guided = Hold(("n1",), ((0, 0, 1),))
    assert prestressability(structure, holds=(guided, Hold(("n2",), ((0, 0, 1),)))).rigid_motions.shape[1] in (3, 4)


def test_a_string_across_the_motion_of_the_prism_makes_it_rigid() -> None:
    """One string more, which the twist lengthens: no mechanism is left, and the string cannot pull."""
    plain = prism(30)
    strings = [*plain.string_nodes.tolist(), (0, 5)]
    wider = made(plain.positions, plain.rod_nodes, strings)
    found = prestressability(wider)
    check(found)
    assert found.mechanisms.shape[1] == 0
    assert len(found.self_stress) == 1
    # The state is that of the prism alone, and the added string has no part in it: the twist lengthens or shortens it.
    assert np.array_equal(found.can_pull, [*[True] * 9, False])
    assert "'s10'" in " ".join(found.describe())
    assert not found.is_rigid_to_first_order
    assert found.prestress_stable is Verdict.YES
    assert found.taut_mechanisms.shape[1] == 1
    # Tetrahedron with a centre: rods inside, strings outside; rigid to first order, as bars and with its signs.
    corners = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1], [0, 0, 0]], float)
    edges = [(i, j) for i in range(4) for j in range(i)]
    rigid = prestressability(made(corners, [(4, i) for i in range(4)], edges))
    check(rigid)
    assert rigid.is_rigid_to_first_order
    assert len(rigid.self_stress) == 1
    assert rigid.all_can_push
    # Its stress matrix is -w vvᵀ with v = (1, 1, 1, 1, -4); strings inside and rods outside make it w vvᵀ.
    assert rigid.super_stable is Verdict.NO
    assert (
        prestressability(made(corners, edges, [(4, i) for i in range(4)], point_masses={4: 1.0})).super_stable
        is Verdict.YES
    )


def test_broken_strings_and_unstable_prestress() -> None:
    model = StaticModel.of(prism(30), broken=("s1",))
    found = prestressability(model)
    assert len(found.self_stress) == 0
    assert not found.can_pull.any()
    assert found.prestress is None
    # A string pulled along a line between two points that push: rods in line, which are driven apart.
    line = made([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [(0, 1), (1, 2)], [(0, 2)]).with_strings(rest_length=1.5)
    state = find_equilibrium(StaticModel.of(line), stable=False)
    own = prestressability(state)
    assert own.prestress_stable is Verdict.NO
    assert own.prestress_stiffness[0] < 0
    assert prestressability(line).prestress_stable is Verdict.NO


def test_what_does_not_fit() -> None:
    state = find_equilibrium(tower(1))
    with pytest.raises(tmj.errors.OptionError, match="use a Structure"):
        prestressability("prism")  # type: ignore[arg-type]
    with pytest.raises(tmj.errors.OptionError, match="a state has its own"):
        prestressability(state, nodes=state.nodes)
    with pytest.raises(tmj.errors.OptionError, match="a model has its own"):
        prestressability(state.model, holds=(Hold(("b1_1",)),))
    flat = np.array(prism(30).positions)
    flat[4] = flat[1]
    with pytest.raises(tmj.errors.OptionError, match="no length at these nodes"):
        prestressability(prism(30), nodes=flat)


def test_it_shows_itself_in_four_lines() -> None:
    assert repr(prestressability(tmj.load_scene("prism"))).splitlines() == [
        "what    prism can carry by itself",
        "counts  12 strings and 3 rods on 12 free coordinates: 3 states of self-stress, 0 mechanisms, "
        "0 motions of the whole",
        "rank    12, clear",
        "verdict prestress stable: yes; super stable: not applicable",
    ]
