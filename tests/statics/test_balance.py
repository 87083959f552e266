"""What neither rods nor supports can balance: one number for all commands, against forces by hand, another solver."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import minimize

import tensegrity_mj as tmj
from evidence.random_structures import random_scene, random_structure
from evidence.random_taut import random_taut_structure
from tensegrity_mj.cli import main
from tensegrity_mj.commands.scenes import describe
from tensegrity_mj.model.elements.resistance import Bending, Resistance
from tensegrity_mj.model.members import Support
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.model.text.sources import scene_names
from tensegrity_mj.statics.equilibrium import Balance, balance, find_equilibrium, unheld_gravity
from tensegrity_mj.statics.model import Rods, StaticModel

Array = NDArray[np.float64]
GRAVITY = (0.0, 0.0, -9.81)

QUAD = (
    """
format = 1
name = "quad_prism"
[structure]
nodes.b0 = [0.3, 0.0, 0.0]
nodes.b1 = [0.0, 0.3, 0.0]
nodes.b2 = [-0.3, 0.0, 0.0]
nodes.b3 = [0.0, -0.3, 0.0]
nodes.t0 = [0.2121, 0.2121, 0.8]
nodes.t1 = [-0.2121, 0.2121, 0.8]
nodes.t2 = [-0.2121, -0.2121, 0.8]
nodes.t3 = [0.2121, -0.2121, 0.8]
rods = [
  {name="r0", nodes=["b0","t1"], mass=0.2}, {name="r1", nodes=["b1","t2"], mass=0.2},
  {name="r2", nodes=["b2","t3"], mass=0.2}, {name="r3", nodes=["b3","t0"], mass=0.2},
]
strings = [
"""
    + "\n".join(
        f'{{name="{kind}{k}", nodes=["{a}{k}","{b}{(k + more) % 4}"], stiffness=500, damping=1, tension=10}},'
        for k in range(4)
        for kind, a, b, more in (("bot", "b", "b", 1), ("top", "t", "t", 1), ("ver", "b", "t", 0))
    )
    + "\n]\n[scene]\nduration = 3.0\n"
)


def test_a_prism_of_four_rods_by_hand(tmp_path: Any, capsys: pytest.CaptureFixture[str]) -> None:
    """Each node has three strings of 10 N and one rod: what is left is their sum less its part along the rod."""
    file = tmp_path / "quad.toml"
    file.write_text(QUAD, encoding="utf-8")
    structure = tmj.load_scene(str(file)).structure
    x, left = structure.positions, []
    for node in range(8):
        pull = np.zeros(3)
        for i, j in structure.string_nodes.tolist():
            if node in (i, j):
                away = x[j if node == i else i] - x[node]
                pull += 10 * away / np.linalg.norm(away)
        (rod,) = (b for b in structure.rod_nodes.tolist() if node in b)
        b = (x[rod[1]] - x[rod[0]]) / np.linalg.norm(x[rod[1]] - x[rod[0]])
        left.append((pull, b, rod[0] == node))
    # One axial force at both ends: half the difference of what the strings push the ends together with.
    sizes = np.zeros(8)
    for i, j in structure.rod_nodes.tolist():
        (f, b, _), (g, _, _) = left[i], left[j]
        axial = 0.5 * float(b @ (g - f))
        sizes[i], sizes[j] = np.linalg.norm(f + axial * b), np.linalg.norm(g - axial * b)
    expected = pytest.approx(float(sizes.max()), rel=1e-12)
    found = {}
    for command in (["scenes", str(file)], ["statics", str(file)]):
        assert main([*command, "--json"]) == 0
        found[command[0]] = json.loads(capsys.readouterr().out)
        assert main(command) == 0
        line = next(row for row in capsys.readouterr().out.splitlines() if row.strip().startswith("unbalanced force"))
        assert f"{sizes.max():.5g} N on node 'b" in line
        assert "the largest that neither rods nor supports can balance" in line
    assert found["scenes"]["unbalanced_force"] == expected
    assert found["statics"]["start"]["unbalanced"] == expected
    assert not found["scenes"]["in_equilibrium"]
    assert not found["statics"]["start"]["equilibrium"]


def by_least_squares(scene: Scene) -> Array:
    """r (N, 3): forces less the closest ones that rods and supports can make, assembled rod by rod."""
    structure, x = scene.structure, scene.nodes0
    forces = scene.nodal_forces(0.0).copy()
    for rod, (i, j) in zip(structure.rods, structure.rod_nodes.tolist(), strict=True):
        forces[[i, j]] += 0.5 * rod.mass * np.array(scene.gravity)
    for point in structure.point_masses:
        forces[structure.node_index[point.node]] += point.mass * np.array(scene.gravity)
    for string, (i, j) in zip(structure.strings, structure.string_nodes.tolist(), strict=True):
        span = x[j] - x[i]
        length = float(np.linalg.norm(span))
        rest = structure.rest_lengths[[s.name for s in structure.strings].index(string.name)]
        pull = string.stiffness * max(0.0, length - rest) * span / length
        forces[i] += pull
        forces[j] -= pull
    made = []

    def add(*parts: tuple[int, Array]) -> None:
        column = np.zeros_like(x)
        for node, force in parts:
            column[node] += force
        made.append(column.ravel())

    for rod, (i, j) in zip(structure.rods, structure.rod_nodes.tolist(), strict=True):
        b = (x[j] - x[i]) / np.linalg.norm(x[j] - x[i])
        add((i, b), (j, -b))
        support = rod.support
        for row in np.array(support.directions).reshape(-1, 3):
            add((i, (1 - support.sigma) * row), (j, support.sigma * row))
        if support.plane is not None:  # it stays at its height, and turns in its plane
            normal = np.array(support.plane)
            add((i, (1 - support.sigma) * normal), (j, support.sigma * normal))
            add((i, -np.array(support.plane)), (j, np.array(support.plane)))
    for name in structure.fixed_nodes:
        for axis in np.eye(3):
            add((structure.node_index[name], axis))
    for point in structure.point_masses:
        if point.plane is not None:
            add((structure.node_index[point.node], np.array(point.plane)))
    basis = np.array(made).T.reshape(x.size, -1)
    taken = np.linalg.lstsq(basis, forces.ravel(), rcond=1e-12)[0]
    return np.asarray(forces - (basis @ taken).reshape(-1, 3))


@pytest.mark.parametrize("seed", range(8))
def test_it_is_what_another_assembly_leaves(seed: int) -> None:
    rng = np.random.default_rng(seed)
    planar = seed % 4 == 3
    structure = random_structure(rng, rods=1 + seed % 4, planar=planar, own_planes=0.3, point_masses=seed % 3)
    scene = random_scene(rng, structure, moving=False, gravity=bool(seed % 2), loads=1)
    found, expected = balance(StaticModel.of(scene)), by_least_squares(scene)
    scale = float(np.abs(expected).max()) + float(np.abs(scene.nodal_forces(0.0)).max()) + structure.stiffness.max()
    # Directions that supports hold are given by rounded rows: some ε of all forces.
    np.testing.assert_allclose(found.left, expected, rtol=0, atol=1e-12 * scale)
    assert found.unbalanced == pytest.approx(np.linalg.norm(expected, axis=1).max(), rel=1e-9, abs=1e-12 * scale)


def test_it_is_the_same_in_any_coordinates() -> None:
    rng = np.random.default_rng(3)
    structure = random_taut_structure(rng, rods=3)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    nodes = structure.positions + 0.1 * rng.normal(size=structure.positions.shape)
    sizes = []
    for x in (nodes, nodes @ turn.T):
        scene = StaticModel.of(structure, nodes=x)
        sizes.append(np.sort(np.linalg.norm(balance(scene).left, axis=1)))
    assert sizes[0].max() > 1.0
    np.testing.assert_allclose(sizes[0], sizes[1], rtol=1e-10)


@pytest.mark.parametrize("name", scene_names())
def test_both_commands_say_the_same_of_shipped_scenes(name: str) -> None:
    """Without the weight of what falls freely, which `scenes` leaves out; what floats freely has no study."""
    scene = tmj.load_scene(name)
    if scene.control is not None or (scene.water is not None and unheld_gravity(scene).any()):
        return
    if len(scene.structure.strings) > 100:
        return  # its study takes seconds, and says nothing else
    reported = describe(scene)
    scene = scene.with_(gravity=tuple(np.array(scene.gravity) - unheld_gravity(scene)))
    found: Balance = tmj.statics.analyse(scene, modes=1).start
    assert (reported["unbalanced_force"], reported["in_equilibrium"]) == (found.unbalanced, found.is_equilibrium)
    assert reported["unbalanced"] == found.describe()


def test_equilibria_are_said_to_be_equilibria() -> None:
    for scene in (tmj.load_scene("tbar"), tmj.load_scene("net"), tmj.load_scene("truss_arm")):
        there = find_equilibrium(scene).scene()
        found = balance(StaticModel.of(there))
        assert found.is_equilibrium
        assert "an equilibrium" in found.describe()
        reported = describe(there)
        assert reported["in_equilibrium"]
    # Of bent joints alone: a straight chain is at rest, a bent one is not.
    for bend, rests in ((0.0, True), (0.3, False)):
        chain = Structure.from_arrays(
            [[0, 0, 0], [0, 0, 1], [bend, 0, 2]], [(0, 1), (1, 2)], [], rod_mass=1.0, stiffness=1.0
        )
        found = balance(StaticModel.of(Scene(chain, resistance=Resistance(bending=Bending(7.0)))))
        assert found.is_equilibrium is rests
        assert (found.unbalanced > 1.0) is not rests


def test_elastic_rods_carry_what_their_lengths_say() -> None:
    """At their lengths nothing: the strings' whole pull is left."""
    structure = tmj.load_scene("tbar").structure.with_sections(tmj.model.Section.tube(5e-3, 1e-3, 70e9, 2e8))
    rigid, elastic = (balance(StaticModel.of(structure, rods=rods)) for rods in (Rods.RIGID, Rods.ELASTIC))
    assert elastic.unbalanced > rigid.unbalanced


def test_what_falls_freely_gets_no_advice_to_add_supports(capsys: pytest.CaptureFixture[str]) -> None:
    for scene, falls in (
        (tmj.load_scene("prism_drop"), True),
        (tmj.load_scene("prism_drop").with_(contact=None), True),
        (tmj.load_scene("prism_drop").with_(gravity=(0.0, 0.0, 0.0)), False),
        (tmj.load_scene("tbar").with_(gravity=GRAVITY), False),
    ):
        reported = describe(scene)
        assert reported["falls_freely"] is falls
        assert "add strings or supports" not in reported["why_not"]
    floating = describe(tmj.load_scene("tower_waves"))
    assert (floating["falls_freely"], floating["floats_freely"]) == (False, True)
    assert floating["can_be_prestressed"] or "add strings or supports" not in floating["why_not"]
    reported = describe(tmj.load_scene("prism_drop"))
    assert reported["in_equilibrium"]
    assert reported["can_be_prestressed"]
    assert main(["scenes", "prism_drop"]) == 0
    assert "nothing holds it against gravity" in capsys.readouterr().out
    # Led along x alone, gravity along it makes it fall, and gravity across it is borne.
    guide = Support.constrained([(0, 1, 0), (0, 0, 1)], 0.5)
    rod = Structure("led", {"a": (0, 0, 0), "b": (0, 0, 1)}, (tmj.Rod("r", ("a", "b"), 1.0, support=guide),), ())
    np.testing.assert_allclose(unheld_gravity(Scene(rod, gravity=(3.0, 0.0, -4.0))), (3.0, 0.0, 0.0), atol=1e-15)
    assert unheld_gravity(Scene(rod, gravity=(0.0, 0.0, -4.0))).tolist() == [0.0, 0.0, 0.0]
    # A structure without strings has nothing to prestress.
    assert describe(Scene(rod))["why_not"] == "there are no strings"


def test_the_least_is_the_least() -> None:
    """No axial forces leave less in the sum of squares: by a minimiser that knows nothing of the solution."""
    structure = tmj.load_scene("prism_drop").structure
    nodes = structure.positions + 0.05 * np.random.default_rng(0).normal(size=structure.positions.shape)
    model = StaticModel.of(structure, nodes=nodes)
    x = nodes.ravel()

    def squares(forces: Array) -> float:
        return float(np.sum((model.gradient(x, 0.0) + model.rod_pulls(x, forces)) ** 2))

    best = minimize(squares, np.zeros(3), tol=1e-12)
    assert np.sum(balance(model).left ** 2) == pytest.approx(best.fun, rel=1e-9)
