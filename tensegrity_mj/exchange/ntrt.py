"""YAML structures of NTRT, the NASA Tensegrity Robotics Toolkit, with its rules of composition.

A file has nodes, pairs of nodes in groups of tags, builders by tag, substructures from other files (each rotated, then
scaled, offset and translated) and bonds between them (node to node, or nodes to the edges of another structure, which
moves there). Rules: NTRT's doc/source/yaml-model-builder.rst and src/yamlbuilder/TensegrityModel.cpp.

NTRT has y up, and its own programs count in decimetres: forces are then in 0.1 N, stiffness and damping in SI units,
densities in kg/dm³. Files are read as texts, lists and tables only, with no references and no key twice.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.dependencies import of_extra, optional
from tensegrity_mj.basics.files import content_of, table_beside
from tensegrity_mj.basics.texts import unknown
from tensegrity_mj.errors import FormatError
from tensegrity_mj.exchange.importing import Draft, ImportOptions
from tensegrity_mj.model.members import Rod, String
from tensegrity_mj.model.structure_checks import names_of
from tensegrity_mj.model.text.codec import Table, shown

MOST_DEPTH, MOST_FILES, MOST_PARTS = 16, 100, 10_000  # substructures within each other; files; structures in all
SAME = 1e-9  # of the size: nodes nearer than this are one point, as pairs of NTRT are by coordinates
ATTRIBUTES = ("path", "rotation", "translation", "scale", "offset")
_DEFAULTS = table_beside(__file__)
CABLES: tuple[str, ...] = tuple(_DEFAULTS["cables"])
BUILDERS: dict[str, dict[str, float]] = _DEFAULTS["rigid"] | dict.fromkeys(CABLES, _DEFAULTS["cable"])
Builder = tuple[str, dict[str, float]]  # a class and its numbers


yaml = optional("yaml", "a model of NTRT", of_extra("ntrt"))

MOST_BYTES = 300_000  # of a file: NTRT's largest has 10 kB, and PyYAML reads this many in some seconds


class _Loader(yaml.BaseLoader):  # type: ignore[misc,name-defined]
    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            raise yaml.MarkedYAMLError(problem="a reference (*name), which NTRT's files have not")
        return super().compose_node(parent, index)

    def construct_mapping(self, node: Any, deep: bool = False) -> Any:
        found: dict[str, Any] = {}
        for key, value in node.value:
            if str(key.value) in found:
                raise yaml.MarkedYAMLError(
                    problem=f"'{key.value}' stands twice in a table", problem_mark=key.start_mark
                )
            found[str(key.value)] = self.construct_object(value, deep=True)
        return found


class TextTable(Table):
    """A table all of whose values are words: numbers are made of them where they are read."""

    def _inside(self, name: str, data: Any, keys: Any) -> TextTable:
        return TextTable(data, self.file, f"{self.path}.{name}" if self.path else name, keys)

    def child(self, key: str) -> TextTable:
        """The table of a key, empty where it is missing."""
        return self._inside(key, self.data.get(key) or {}, None)

    def number(self, key: str, default: Any = ...) -> Any:
        self.data[key] = _number(self.data.get(key))
        return super().number(key, default)

    def position(self, key: str) -> Array:
        """Three numbers (3,)."""
        value = self.data.get(key)
        self.data[key] = [_number(one) for one in value] if isinstance(value, list) else value
        return np.array(self.vector(key))

    def pairs(self, key: str) -> Iterator[tuple[str, str]]:
        """The pairs of words of a list."""
        rows = self.get(key, "a list of pairs of names", lambda rows: isinstance(rows, list))
        for row in rows:
            if not (isinstance(row, list) and len(row) == 2 and all(isinstance(one, str) and one for one in row)):
                raise FormatError(f"{self.where}: {key}: {shown(row)}; it must be two names, as [first, second]")
            yield row[0], row[1]


def yaml_file(path: Path) -> TextTable:
    """The table of a file.

    Raises:
        FormatError: if it is no such file, too large, or not valid YAML.
    """
    content = content_of(path, MOST_BYTES)
    try:
        return TextTable(yaml.load(content, _Loader), str(path), "", None)
    except (yaml.YAMLError, ValueError) as error:
        mark, problem = getattr(error, "problem_mark", None), getattr(error, "problem", None) or error
        raise FormatError(f"{path}: not valid YAML{f', line {mark.line + 1}' if mark else ''}: {problem}") from None
    except RecursionError:
        raise FormatError(f"{path}: not valid YAML: values stand too deep in each other") from None


def _number(word: Any) -> Any:
    try:
        return float(word) if isinstance(word, str) and math.isfinite(float(word)) else word
    except ValueError:
        return word


class Node:
    """A node, wherever it has been moved to."""

    def __init__(self, name: str, at: Array) -> None:
        self.name, self.at = name, at


Pair = tuple[Node, Node, str]


class Part:
    """A structure with its nodes, pairs and substructures."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.nodes: dict[str, Node] = {}
        self.pairs: list[Pair] = []
        self.children: list[Part] = []

    def all(self) -> Iterator[Part]:
        """This part and those within it, the nearer ones first."""
        todo = [self]
        while todo:
            part = todo.pop(0)
            yield part
            todo += part.children

    def move(self, change: Callable[[Array], Array]) -> None:
        for part in self.all():
            for node in part.nodes.values():
                node.at = change(node.at)

    @property
    def centroid(self) -> Array:
        return np.asarray(np.mean([node.at for part in self.all() for node in part.nodes.values()] or [np.zeros(3)], 0))

    def child(self, name: str, where: str) -> Part:
        inner = [part for part in self.all() if part is not self]
        found = next((part for part in inner if part.name == name), None)
        if found is None:
            raise FormatError(f"{where}: {unknown(name, dict.fromkeys(part.name for part in inner), 'substructure')}")
        return found

    def node(self, path: str, where: str) -> Node:
        """A node by its name, or by its path, as "leg.knee.bottom"."""
        *parts, name = path.split(".")
        place = self
        for one in parts:
            place = place.child(one, where)
        for part in place.all():
            if name in part.nodes:
                return part.nodes[name]
        raise FormatError(f"{where}: {unknown(path, list(place.nodes), 'node')}")


class Composer:
    """Reads the files of a structure, and remembers each, and the builders of all."""

    def __init__(self) -> None:
        self.files: dict[Path, TextTable] = {}
        self.builders: dict[str, Builder] = {tag: (kind, BUILDERS[kind]) for tag, kind in _DEFAULTS["tags"].items()}
        self.parts = 0
        self.unused: dict[str, None] = {}

    def build(self, path: Path, name: str, above: tuple[Path, ...] = ()) -> Part:
        """The structure of a file, its substructures first: where both have a builder for a tag, this file's holds."""
        try:
            key = path.resolve()
        except (OSError, RuntimeError) as error:  # which a link to itself raises below Python 3.13
            raise FormatError(f"{path}: cannot be read ({getattr(error, 'strerror', None) or error})") from None
        self.parts += 1
        if key in above:
            raise FormatError(f"{path}: is a substructure of itself; NTRT's structures are trees")
        if len(above) >= MOST_DEPTH or self.parts > MOST_PARTS or len(self.files) > MOST_FILES:
            raise FormatError(
                f"{path}: more than {MOST_DEPTH} substructures within each other, {MOST_FILES} files or {MOST_PARTS} "
                "structures in all; import a part of it"
            )
        if key not in self.files:
            self.files[key] = yaml_file(path)
        root, part = self.files[key], Part(name)
        root.allow(("nodes", "pair_groups", "builders", "substructures", "bond_groups"))
        self._add_children(part, root.child("substructures"), path, (*above, key))
        builders, nodes, groups = (root.child(key) for key in ("builders", "nodes", "pair_groups"))
        for tag in builders.data:
            self._add_builder(tag, builders.child(tag))
        for node in nodes.data:
            part.nodes[node] = Node(node, nodes.position(node))
        for tags in groups.data:
            place = f"{groups.where}.{tags}"
            part.pairs += [(part.node(a, place), part.node(b, place), tags) for a, b in groups.pairs(tags)]
        self._add_bonds(part, root.child("bond_groups"))
        return part

    def _add_builder(self, tag: str, table: TextTable) -> None:
        table.allow(("class", "parameters"))
        kind, given = table.choice("class", BUILDERS), table.child("parameters")
        known = {name: given.number(name) for name in given.data if name in BUILDERS[kind]}
        self.unused |= dict.fromkeys(name for name in given.data if name not in known)
        self.builders[tag] = kind, {**BUILDERS[kind], **known}

    def _add_children(self, part: Part, tables: TextTable, path: Path, above: tuple[Path, ...]) -> None:
        """Make all substructures, rotate all, and then scale, offset and translate each."""
        attributes = {names: tables.child(names) for names in tables.data}
        for names, one in attributes.items():
            one.allow(ATTRIBUTES)
            if "path" in one.data:
                other = Path(one.text("path"))
                if other.is_absolute() or other.suffix not in (".yaml", ".yml"):
                    raise one.fail("path", "the relative path of a .yaml file")
                part.children += [self.build(path.parent / other, name, above) for name in names.split("/")]
        for names, one in attributes.items():
            for name in names.split("/") if "rotation" in one.data else ():
                _rotate(part.child(name, one.where), one.child("rotation"))
        for names, one in attributes.items():
            factor = one.number("scale") if "scale" in one.data else 1.0
            shifts = [one.position(key) if key in one.data else np.zeros(3) for key in ("offset", "translation")]
            for number, name in enumerate(names.split("/")):
                child = part.child(name, one.where)
                center, shift = child.centroid, number * shifts[0] + shifts[1]
                child.move(lambda at, c=center, by=shift, f=factor: c + f * (at - c) + by)  # type: ignore[misc]

    def _add_bonds(self, part: Part, tables: TextTable) -> None:
        """Bonds by tag, and by "child/child/.../kind" within it, or the other way about."""
        for first in tables.data:
            inner = tables.child(first)
            for second in inner.data:
                tags, bonds = (second, first) if "/" in first else (first, second)
                *names, kind = bonds.split("/")
                where = f"{inner.where}.{second}"
                if "/" in tags or len(names) < 2 or kind not in ("node_node", "node_edge"):
                    raise FormatError(f"{where}: a tag holds child1/child2/node_node or child1/child2/node_edge, or so")
                for one, other in pairwise(names):
                    children = part.child(one, where), part.child(other, where)
                    pairs = list(inner.pairs(second))
                    if kind == "node_edge":
                        self._bond_edges(part, children, pairs, tags, where)
                        continue
                    part.pairs += [(children[0].node(a, where), children[1].node(b, where), tags) for a, b in pairs]

    def _bond_edges(
        self, part: Part, children: tuple[Part, Part], pairs: list[tuple[str, str]], tags: str, where: str
    ) -> None:
        """Nodes of one child on the middles of strings of the other, which the second child moves to meet.

        These strings, and those between the nodes, give way to strings from the edges' ends to the nodes.
        """
        nodes: list[Node] = []
        edges: list[list[Node]] = []
        places: tuple[list[Array], list[Array]] = ([], [])
        for row in pairs:
            if sum("/" in text for text in row) != 1 or len(pairs) < 3:
                raise FormatError(f"{where}: {list(row)}: it must be a node and an edge, node1/node2, and three pairs")
            for child, text, place in zip(children, row, places, strict=True):
                ends = [child.node(name, where) for name in text.split("/")]
                (edges if len(ends) > 1 else nodes).append(ends if len(ends) > 1 else ends[0])  # type: ignore[arg-type]
                place.append(np.mean([node.at for node in ends], axis=0))
        _meet(children[1], np.array(places[0]), np.array(places[1]), where)
        gone = [frozenset(edge) for edge in edges] + [frozenset((a, b)) for a in nodes for b in nodes if a is not b]
        for inner in (inner for child in children for inner in child.all()):
            inner.pairs = [one for one in inner.pairs if frozenset(one[:2]) not in gone or self._is_rigid(one[2])]
        for (a, b), node in zip(edges, nodes, strict=True):
            part.pairs += [(a, node, tags), (node, b, tags)]

    def _is_rigid(self, tags: str) -> bool:
        found = self.builder_of(tags)
        return found is not None and found[1][0] not in CABLES

    def builder_of(self, tags: str) -> tuple[str, Builder] | None:
        """The tag and the builder of a pair: the last one whose tags the pair has all, rigid ones first."""
        fitting = [(tag, one) for tag, one in self.builders.items() if set(tag.split()) <= set(tags.split())]
        rigid = [row for row in fitting if row[1][0] not in CABLES]
        return (rigid or fitting)[-1] if fitting else None


def _rotate(child: Part, table: TextTable) -> None:
    table.allow(("axis", "angle", "reference"))
    axis, angle = table.position("axis"), table.number("angle")
    if not axis.any():
        raise table.fail("axis", "a direction")
    center = table.position("reference") if "reference" in table.data else child.centroid
    turn = Rotation.from_rotvec(math.radians(angle) * axis / np.linalg.norm(axis))
    child.move(lambda at: center + turn.apply(at - center))


def _meet(child: Part, to: Array, start: Array, where: str) -> None:
    """Move a part so that points (n, 3) of it come to others: plane to plane, centre to centre, first to first."""
    middle, target = start.mean(axis=0), to.mean(axis=0)
    normals = [np.cross(points[1] - points[0], points[2] - points[0]) for points in (start, to)]
    if not all(normal.any() for normal in normals):
        raise FormatError(f"{where}: its first three points lie on a line; choose others, which span a plane")
    # The normals come to lie upon each other; about them the first points are as near as they can be.
    turn, _ = Rotation.align_vectors(
        [normals[1], to[0] - target], [normals[0], start[0] - middle], weights=[math.inf, 1.0]
    )
    child.move(lambda at: target + turn.apply(at - middle))


def read(path: Path, options: ImportOptions) -> Draft:
    """The draft of a YAML structure, with z up.

    Raises:
        FormatError: for what NTRT would refuse, too, and for files that name others by absolute paths.
    """
    reader = Composer()
    whole = reader.build(path, "")
    unit = options.unit or 0.1
    draft = Draft(path.stem, f"NTRT, {path.name}")
    names = _name_nodes(draft, whole, unit)
    counts: Counter[str] = Counter()
    without: dict[str, None] = {}
    for one in whole.all():
        for first, second, tags in one.pairs:
            found = reader.builder_of(tags)
            if found is None:
                without[tags] = None
                continue
            tag, (kind, numbers) = found
            counts[tag] += 1
            label, ends = f"{tag}{counts[tag]}".replace(" ", "_"), (names[first], names[second])
            length = float(np.linalg.norm(np.subtract(second.at, first.at)))
            if kind in CABLES:
                draft.strings.append(_cable(label, ends, numbers, length, unit))
            elif kind == "tgSphereInfo":
                draft.notes.append(f"pair {tags}: a sphere stands on a node, not between two; left out")
            else:
                draft.rods.append(_rod(label, ends, (kind, numbers), length, unit))
    for one in whole.all():
        for node in one.nodes.values():
            builder = reader.builders.get(node.name)
            if builder is not None and builder[0] == "tgSphereInfo":
                numbers = builder[1]
                draft.masses[names[node]] = 4 / 3 * math.pi * numbers["radius"] ** 3 * numbers["density"]
    _add_notes(draft, reader, without, unit)
    return draft


def _name_nodes(draft: Draft, whole: Part, unit: float) -> dict[Node, str]:
    """A name for each node, by the path of its part; nodes that stand at one place are one."""
    places: dict[Node, str] = {}

    def collect(part: Part, prefix: str) -> None:
        for name, node in part.nodes.items():
            places[node] = f"{prefix}{name}"
        for child in part.children:
            collect(child, f"{prefix}{child.name}.")

    collect(whole, "")
    if not places:
        raise FormatError(f"{draft.source}: it has no nodes")
    points = np.array([node.at for node in places])
    size = float(np.ptp(points, axis=0).max()) or 1.0
    at: dict[tuple[int, ...], str] = {}
    names: dict[Node, str] = {}
    for node, name in places.items():
        key = tuple(np.round(node.at / (SAME * size)).astype(np.int64).tolist())
        if key in at:
            draft.notes.append(f"node '{name}' stands where '{at[key]}' does: they are one node")
        else:
            x, y, z = (unit * node.at).tolist()
            at[key], draft.nodes[name] = name, (x, 0.0 - z, y)
        names[node] = at[key]
    return names


def _rod(name: str, ends: tuple[str, str], builder: Builder, length: float, unit: float) -> Rod:
    kind, numbers = builder
    area = math.pi * numbers["radius"] ** 2 if kind == "tgRodInfo" else numbers["width"] * numbers["height"]
    return Rod(name, ends, numbers["density"] * area * length, unit * math.sqrt(abs(area) / math.pi))


def _cable(name: str, ends: tuple[str, str], numbers: Mapping[str, float], length: float, unit: float) -> String:
    k, least = numbers["stiffness"], unit * numbers["min_rest_length"]
    rest = unit * (length - numbers["pretension"] / k) if k > 0 else unit * length
    least_known = least if 0 < least <= rest else None
    speed = unit * numbers["target_velocity"] or None
    return String(name, ends, k, numbers["damping"], rest, min_rest_length=least_known, winch_speed=speed)


def _add_notes(draft: Draft, reader: Composer, without: Mapping[str, None], unit: float) -> None:
    notes = draft.notes
    notes.append(f"lengths of the file are taken as {unit:g} m each (NTRT's own programs count in decimetres)")
    notes.append("gravity, ground and controllers belong to NTRT's programs, not to the file: the scene has none")
    for tags in without:
        notes.append(f"pairs of '{tags}' have no builder, by which NTRT builds nothing: left out")
    if reader.unused:
        notes.append(f"parameters of builders without an equivalent here: {', '.join(reader.unused)}")
    if draft.strings:
        notes.append("strings end on the axes of rods; NTRT moves their ends to the surface")
    joints = [name for name, count in Counter(name for rod in draft.rods for name in rod.nodes).items() if count > 1]
    if joints:
        notes.append(
            f"rods that share a node are one rigid body in NTRT, and joined by a ball joint here: {names_of(joints)}"
        )
    boxes = [kind for kind, _ in reader.builders.values() if kind == "tgBoxInfo"]
    if len(boxes) > 1:
        notes.append("boxes are round rods of the same area and mass")
