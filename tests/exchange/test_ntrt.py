"""Structures of NTRT: published ones by their counts and numbers, the rules of composition, and what is refused."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import tensegrity_mj as tmj
from tensegrity_mj.exchange import ImportOptions, import_scene

DATA = Path(__file__).resolve().parents[1] / "data" / "exchange" / "ntrt"


def written(folder: Path, text: str, name: str = "one.yaml") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def test_the_prism_has_its_published_numbers() -> None:
    found = import_scene(DATA / "prism.yaml")
    prism = found.scene.structure
    assert (len(prism.nodes), len(prism.rods), len(prism.strings)) == (6, 3, 9)
    # NTRT's y is up, and its unit a decimetre: (x, y, z) becomes (x, -z, y) / 10.
    np.testing.assert_allclose(prism.positions[prism.node_index["top3"]], [0, -0.866, 0.5], rtol=0, atol=1e-15)
    # 3000 and 1000 of 0.1 N on strings of 1000 N/m are 0.3 m and 0.1 m; tops are 1 m apart, uprights 0.5 m long.
    tension = prism.stiffness * (prism.string_lengths(prism.positions) - prism.rest_lengths)
    np.testing.assert_allclose(tension, [300.0] * 6 + [100.0] * 3, rtol=1e-12)
    # 0.688 kg/dm³ on π (0.31 dm)² and the length of a bar, 5² + 5² + 8.66² dm² or 10² + 5².
    lengths = [math.hypot(10, 5), math.hypot(5, 5, 8.66), math.hypot(5, 5, 8.66)]
    np.testing.assert_allclose(prism.rod_masses, [0.688 * math.pi * 0.31**2 * length for length in lengths], rtol=1e-12)
    assert {string.damping for string in prism.strings} == {10.0}
    assert prism.rods[0].radius == pytest.approx(0.031, rel=1e-12)
    assert "gravity, ground and controllers" in " ".join(found.notes)


def test_a_spine_of_prisms_has_its_published_members_and_its_nodes_on_edges() -> None:
    spine = import_scene(DATA / "prism_spine.yaml").scene.structure
    # Six prisms of 9 strings; each of five bonds takes 3 edges and 3 strings between the nodes, and makes 6.
    assert (len(spine.nodes), len(spine.rods), len(spine.strings)) == (36, 18, 54)
    for lower, upper in zip(range(1, 6), range(2, 7), strict=True):
        nodes = {name: spine.positions[spine.node_index[name]] for name in spine.nodes}
        tops = np.array([nodes[f"p{lower}.top{k}"] for k in (1, 2, 3)])
        ends = np.array([[nodes[f"p{upper}.bottom{k}"] for k in pair] for pair in ((1, 2), (2, 3), (3, 1))])
        middles = ends.mean(axis=1)
        # Plane on plane, centre on centre, and the first node in the direction of the first edge.
        np.testing.assert_allclose(middles.mean(axis=0), tops.mean(axis=0), rtol=0, atol=1e-12)
        normals = [np.cross(p[1] - p[0], p[2] - p[0]) for p in (tops, middles)]
        assert np.linalg.norm(np.cross(*normals)) < 1e-12
        arms = [p[0] - tops.mean(axis=0) for p in (tops, middles)]
        assert arms[0] @ arms[1] == pytest.approx(np.linalg.norm(arms[0]) * np.linalg.norm(arms[1]), rel=1e-12)
    # A bond's strings run from an edge's ends to the node, and the edge and the strings between the nodes are gone.
    joined = {frozenset(string.nodes) for string in spine.strings}
    assert {frozenset(("p2.bottom1", "p1.top1")), frozenset(("p1.top1", "p2.bottom2"))} <= joined
    assert frozenset(("p2.bottom1", "p2.bottom2")) not in joined
    assert frozenset(("p1.top1", "p1.top2")) not in joined


def test_the_tetrahedral_spine_has_its_published_members_and_says_that_its_joints_are_loose() -> None:
    found = import_scene(DATA / "spine.yaml")
    spine = found.scene.structure
    assert (len(spine.nodes), len(spine.rods), len(spine.strings)) == (30, 24, 40)
    step = spine.positions[spine.node_index["t6.middle"]] - spine.positions[spine.node_index["t1.middle"]]
    np.testing.assert_allclose(step, [0, 5 * 1.2, 0], rtol=0, atol=1e-12)  # -12 dm of z is 1.2 m of y
    notes = " ".join(found.notes)
    assert "one rigid body in NTRT" in notes
    assert "'t1.middle'" in notes
    assert "history, max_tension" in notes
    assert spine.strings[0].winch_speed == pytest.approx(1.2)


def test_substructures_are_rotated_then_scaled_offset_and_moved(tmp_path: Path) -> None:
    written(tmp_path, "nodes: {a: [0, 0, 0], b: [2, 0, 0]}\npair_groups: {rod: [[a, b]]}\n", "stick.yaml")
    text = """
substructures:
  s1/s2:
    path: stick.yaml
    translation: [0, 0, 10]
    offset: [0, 5, 0]
    scale: 2
    rotation: {angle: 90, axis: [0, 0, 2]}
  s3: {path: stick.yaml, rotation: {axis: [0, 1, 0], angle: 180, reference: [0, 0, 0]}, translation: [0, 0, -10]}
bond_groups:
  s1/s2/node_node: {string: [[a, a], [b, b]]}
  string: {s2/s3/node_node: [[s2.b, s3.b]]}
"""
    text = text.replace("s2.b, s3.b", "b, b")
    structure = import_scene(written(tmp_path, text), options=ImportOptions(unit=1.0)).scene.structure
    at = dict(structure.nodes)
    # Turned about its middle (1, 0, 0), doubled there, 0 and 5 up, 10 along z; then z up: (x, -z, y).
    for name, place in {"s1.a": (1, -10, -2), "s1.b": (1, -10, 2), "s2.a": (1, -10, 3), "s2.b": (1, -10, 7)}.items():
        np.testing.assert_allclose(at[name], place, rtol=0, atol=1e-12)
    np.testing.assert_allclose(at["s3.b"], (-2, 10, 0), rtol=0, atol=1e-12)
    assert [set(string.nodes) for string in structure.strings] == [{"s1.a", "s2.a"}, {"s1.b", "s2.b"}, {"s2.b", "s3.b"}]


@pytest.mark.parametrize("order", [("string", "rod"), ("rod", "string")])
def test_a_rigid_builder_holds_over_a_cables_and_the_last_over_the_first(
    order: tuple[str, str], tmp_path: Path
) -> None:
    """Whatever their order: a pair whose tags are those of both is a rod."""
    builders = {
        "string": "{class: tgBasicActuatorInfo, parameters: {stiffness: 3000, pretension: 0}}",
        "rod": "{class: tgRodInfo, parameters: {density: 3, radius: 0.1}}",
    }
    lines = "".join(f"  {tag}: {builders[tag]}\n" for tag in order)
    text = (
        "nodes: {a: [0, 0, 0], b: [0, 0, 10], c: [5, 0, 0], d: [5, 0, 10]}\n"
        "pair_groups: {string rod: [[a, b]], string: [[a, c], [b, d]], rod thick: [[c, d]]}\n"
        f"builders:\n{lines}  rod thick: {{class: tgRodInfo, parameters: {{density: 3, radius: 0.2}}}}\n"
    )
    structure = import_scene(written(tmp_path, text)).scene.structure
    assert {rod.nodes: rod.radius for rod in structure.rods} == pytest.approx({("a", "b"): 0.01, ("c", "d"): 0.02})
    assert sorted(string.nodes for string in structure.strings) == [("a", "c"), ("b", "d")]


def test_two_strings_between_the_same_nodes_pull_with_both_tensions(tmp_path: Path) -> None:
    """One stands for both: stiffness, damping and tension are sums; tensions are 40 and 60 times 0.1 N."""
    one = "{class: tgBasicActuatorInfo, parameters: {stiffness: %d, pretension: %d, damping: %d}}"
    text = (
        "nodes: {a: [0, 0, 0], b: [0, 0, 10], c: [5, 0, 0], d: [5, 0, 10]}\n"
        "pair_groups: {rod: [[a, b], [c, d]], thin: [[a, c]], thick: [[c, a]]}\n"
        "builders: {rod: {class: tgRodInfo, parameters: {density: 3, radius: 0.1}}, "
        f"thin: {one % (2000, 40, 5)}, thick: {one % (3000, 60, 7)}}}\n"
    )
    found = import_scene(written(tmp_path, text))
    (string,) = found.scene.structure.strings
    assert (string.stiffness, string.damping) == (5000.0, 12.0)
    length = 0.5  # m
    assert string.rest_length is not None
    assert string.stiffness * (length - string.rest_length) == pytest.approx(10.0, rel=1e-12)
    assert "one string stands for both" in " ".join(found.notes)


def test_an_outer_builder_holds_over_an_inner_one_and_what_none_builds_is_listed(tmp_path: Path) -> None:
    written(
        tmp_path,
        "nodes: {a: [0, 0, 0], b: [2, 0, 0], c: [0, 3, 0]}\n"
        "pair_groups: {rod: [[a, b]], 'my string': [[a, c]], odd: [[b, c]]}\n"
        "builders: {rod: {class: tgRodInfo, parameters: {density: 3}}, "
        "c: {class: tgSphereInfo, parameters: {radius: 1}}}\n",
        "inner.yaml",
    )
    outer = "substructures: {i: {path: inner.yaml}}\n"
    outer += "builders: {rod: {class: tgBoxInfo, parameters: {width: 0.5, height: 0.2}}}\n"
    found = import_scene(written(tmp_path, outer))
    structure = found.scene.structure
    assert structure.rods[0].mass == pytest.approx(0.5 * 0.2 * 2)
    assert structure.point_masses[0].mass == pytest.approx(4 / 3 * math.pi)
    assert structure.strings[0].stiffness == 1000.0
    notes = " ".join(found.notes)
    assert "pairs of 'odd' have no builder" in notes
    assert "boxes are round rods" in notes


REFUSED = {
    "nodes: {a: [0, 0]}": "nodes: a = [0.0, 0.0] (a list); it must be three numbers",
    "nodes: {a: [0, 0, x]}": "it must be three numbers [x, y, z]",
    "nodes: {a: [0, 0, nan], b: [1, 0, 0]}\npair_groups: {rod: [[a, b]]}": "it must be three numbers [x, y, z]",
    "nodes: {a: [0, 0, 0], a: [1, 0, 0]}": "not valid YAML, line 1: 'a' stands twice in a table",
    "nodes: {a: &x [0, 0, 0], b: *x}": "a reference (*name)",
    "nodes: !!python/object/apply:os.system ['true']": "must be a table",
    "nods: {}": "unknown key 'nods' (did you mean 'nodes'?); allowed: nodes, pair_groups, builders, subs",
    "nodes: {a: [0, 0, 0]}\npair_groups: {rod: [[a, b]]}": "there is no node 'b'; allowed: a",
    "nodes: {a: [0, 0, 0]}\npair_groups: {rod: [[a]]}": "pair_groups: rod: ['a'] (a list); it must be two names",
    "builders: {rod: {class: tgRod}}": 'it must be "tgRodInfo" or',
    "builders: {rod: {parameters: {}}}": "builders.rod: 'class' is missing",
    "builders: {rod: {class: tgRodInfo, parameters: {radius: big}}}": "radius = 'big' (a text); it must be a number",
    "substructures: {s: {path: /etc/passwd}}": "path = '/etc/passwd' (a text); it must be the relative path",
    "substructures: {s: {path: other.txt}}": "it must be the relative path of a .yaml file",
    "substructures: {s: {path: none.yaml}}": "none.yaml: no such file",
    "substructures: {s: {path: one.yaml}}": "is a substructure of itself",
    "substructures: {s: {rotation: {axis: [0, 0, 1], angle: 1}}}": "there is no substructure 's'",
    "bond_groups: {string: {a/node_node: []}}": "a tag holds child1/child2/node_node",
    "bond_groups: {string: {a/b/glue: []}}": "a tag holds child1/child2/node_node",
    "[1, 2": "not valid YAML",
    "- 1": "it must be a table",
    "{}": "it has no nodes",
    "a: " + "[" * 3000: "not valid YAML",
    "nodes: {a: [0, 0, 0], b: [1, 0, 0]}\npair_groups: {string: [[a, b]]}": "neither rods nor point masses",
}


@pytest.mark.parametrize("text", REFUSED, ids=lambda text: text[:40])
def test_what_is_wrong_is_named_in_one_line(text: str, tmp_path: Path) -> None:
    with pytest.raises(tmj.TensegrityError) as error:
        import_scene(written(tmp_path, text))
    message = str(error.value)
    assert REFUSED[text] in message
    assert message.startswith(str(tmp_path))
    assert "\n" not in message


def test_a_substructure_that_is_a_link_to_itself_is_named(tmp_path: Path) -> None:
    (tmp_path / "loop.yaml").symlink_to("loop.yaml")
    with pytest.raises(tmj.TensegrityError, match=r"loop\.yaml: (no such file|cannot be read)"):
        import_scene(written(tmp_path, "substructures: {s: {path: loop.yaml}}"))


def test_sizes_are_limited_before_they_are_made(tmp_path: Path) -> None:
    with pytest.raises(tmj.TensegrityError, match=r"more than 0\.3 MB"):
        import_scene(written(tmp_path, "#" * 300_001))
    written(tmp_path, "nodes: {a: [0, 0, 0]}", "f0.yaml")
    for level in range(1, 12):  # ten to the eleventh structures, in twelve small files
        names = "/".join(f"s{number}" for number in range(10))
        written(tmp_path, f"substructures: {{{names}: {{path: f{level - 1}.yaml}}}}", f"f{level}.yaml")
    with pytest.raises(tmj.TensegrityError, match="10000 structures in all"):
        import_scene(tmp_path / "f11.yaml")


def test_a_pretension_that_leaves_no_rest_length_is_refused(tmp_path: Path) -> None:
    text = (DATA / "prism.yaml").read_text(encoding="utf-8").replace("pretension: 3000", "pretension: 10001")
    with pytest.raises(tmj.TensegrityError, match="string 'level1': rest_length = "):
        import_scene(written(tmp_path, text))
