"""Scenes from files of other programs: the table of formats, and what came of a file."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components, maximum_bipartite_matching

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.fields import field, value
from tensegrity_mj.basics.files import write_text
from tensegrity_mj.basics.kinds import not_negative, positive
from tensegrity_mj.basics.texts import closest, file_name
from tensegrity_mj.errors import FormatError, OptionError, SceneError, StructureError, printable
from tensegrity_mj.model.constraints import Constraint
from tensegrity_mj.model.events import Load
from tensegrity_mj.model.members import PointMass, Rod, String, Support
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.section import warnings_of
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.model.structure_checks import names_of
from tensegrity_mj.model.text.writing import scene_to_toml


@dataclass(frozen=True)
class Format:
    """A format of files: what it is, how the names of its files end, and the module whose `read` makes a draft."""

    title: str
    suffixes: tuple[str, ...]
    home: str


FORMATS = {
    "ntrt": Format("NTRT's YAML structures", (".yaml", ".yml"), "tensegrity_mj.exchange.ntrt"),
    "mat": Format("MATLAB data of STEDY, MOTES, TsgFEM", (".mat",), "tensegrity_mj.exchange.matlab_file"),
    "matlab": Format("MATLAB scripts of STEDY and MOTES", (".m",), "tensegrity_mj.exchange.matlab_script"),
    "csv": Format("tables nodes.csv and members.csv", (".csv",), "tensegrity_mj.exchange.tables"),
    "mjcf": Format("MJCF of capsules and tendons", (".xml", ".mjcf"), "tensegrity_mj.exchange.mjcf"),
}


@dataclass(frozen=True)
class Imported:
    """A scene from a file of another program.

    Attributes:
        scene: the scene.
        notes: what could not be carried over, and what was assumed, a sentence each.
        format: the name of the file's format in `FORMATS`.
    """

    scene: Scene
    notes: tuple[str, ...]
    format: str

    def to_toml(self) -> str:
        """The scene as TOML text, with the notes as comments at its top."""
        heading, _, rest = scene_to_toml(self.scene).partition("\n")
        title = [f"# Imported ({FORMATS[self.format].title}). Differences from the source file:"]
        notes = [f"# - {printable(note)}" for note in self.notes] or ["# - none"]
        return "\n".join([heading, *title, *notes, rest])

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write `to_toml`, atomically; returns the path.

        Raises:
            FormatError: if the file cannot be written.
        """
        return write_text(path, self.to_toml())


def import_scene(
    path: str | os.PathLike[str], format: str | None = None, options: ImportOptions | None = None
) -> Imported:
    """The scene of a file of another program; no code of the file is run.

    Args:
        path: the file.
        format: its name in `FORMATS`; by default what the file's name ends in.
        options: units, and values for what the file does not give.

    Raises:
        OptionError: for a format that does not exist, or a file whose name ends in no known way.
        FormatError, StructureError, SceneError: for what is wrong in the file, with its place.
    """
    file = Path(path)
    if format is not None and format not in FORMATS:
        raise OptionError(f"format = {format!r}{closest(str(format), FORMATS)}; allowed: {', '.join(FORMATS)}")
    name = format or next((key for key, one in FORMATS.items() if file.suffix.lower() in one.suffixes), None)
    if name is None:
        endings = ", ".join(f"{'/'.join(one.suffixes)} ({key})" for key, one in FORMATS.items())
        hint = "; a .toml file is a scene of this package already" if file.suffix == ".toml" else ""
        raise OptionError(f"{file}: no format has such a name: {endings}; name the format (--from){hint}")
    if options is not None and options.unit is not None and name != "ntrt":
        raise OptionError(
            f"unit = {options.unit:g}: only NTRT's files count in a unit of their own; others are in SI units"
        )
    read: Callable[[Path, ImportOptions], Draft] = import_module(FORMATS[name].home).read
    try:
        draft = read(file, options or ImportOptions())
        draft.name = file_name(draft.name)
        scene = draft.scene()
        return Imported(scene, (*draft.notes, *warnings_of(scene.structure)), name)
    except (StructureError, SceneError) as error:
        raise type(error)(f"{file}: {error}") from None
    except FormatError as error:
        raise (
            error if str(error).startswith((str(file), f"{file.parent}/")) else FormatError(f"{file}: {error}")
        ) from None


@value("import options", OptionError)
class ImportOptions:
    """Values for what a file does not say; None for none, and a file that needs one is refused.

    Attributes:
        unit: length of one unit of a file of NTRT [m]; None for a decimetre, which its own programs count in.
        stiffness, damping: values for each string without its own [N/m], [N s/m].
        rod_mass, rod_radius: values for each rod without its own [kg], [m].
        node_mass: mass of each node without a rod that is not fixed [kg].
    """

    unit: float | None = field(positive("m"), default=None, none="None")
    stiffness: float | None = field(positive("N/m"), default=None, none="None")
    damping: float | None = field(not_negative("N s/m"), default=None, none="None")
    rod_mass: float | None = field(positive("kg"), default=None, none="None")
    rod_radius: float | None = field(positive("m"), default=None, none="None")
    node_mass: float | None = field(positive("kg"), default=None, none="None")


AXES = "xyz"
ALL = frozenset(AXES)


@dataclasses.dataclass
class Draft:
    """A scene in the making, from a file of another program: members, and coordinates of nodes that are held.

    Others hold coordinates of nodes where this package holds rods. A draft finds a rod for each node that is held, and
    notes all that it cannot carry over.

    Attributes:
        name, source: name and source of the scene.
        nodes: name -> position (3,) [m].
        rods, strings: the members; rods that have a support keep it.
        held: node -> the axes in which it is held, some of "xyz".
        masses: node -> point mass [kg].
        loads, velocities: forces on nodes; node -> velocity (3,) [m/s].
        constraints: linear ones of nodes, and those that hold what no support of a rod does.
        settings: other fields of `Scene`, and "string_law" of `Structure`.
        notes: what cannot be carried over, a sentence each.
    """

    name: str
    source: str = ""
    nodes: dict[str, Any] = dataclasses.field(default_factory=dict)
    rods: list[Rod] = dataclasses.field(default_factory=list)
    strings: list[String] = dataclasses.field(default_factory=list)
    held: dict[str, frozenset[str]] = dataclasses.field(default_factory=dict)
    masses: dict[str, float] = dataclasses.field(default_factory=dict)
    loads: list[Load] = dataclasses.field(default_factory=list)
    velocities: dict[str, Any] = dataclasses.field(default_factory=dict)
    constraints: list[Constraint] = dataclasses.field(default_factory=list)
    settings: dict[str, Any] = dataclasses.field(default_factory=dict)
    notes: list[str] = dataclasses.field(default_factory=list)

    def scene(self) -> Scene:
        """The scene; may add notes.

        Raises:
            StructureError, SceneError: for what is wrong with its members.
        """
        self._merge_rods()
        self._remove_held_rods()
        self._merge_strings()
        self._remove_unused_nodes()
        rods = self._supported()
        ends = {name for rod in rods for name in rod.nodes}
        points = []
        for name in self.nodes:
            held = frozenset() if name in ends else self.held.get(name, frozenset())
            if held == ALL or name not in self.masses:
                continue
            axis = min(held, default=None)
            self._hold(name, held - {axis})
            points.append(PointMass(name, self.masses[name], None if axis is None else unit_of(axis)))
        fixed = tuple(n for n in self.nodes if n not in ends and self.held.get(n) == ALL)
        structure = Structure(
            name=self.name,
            nodes={name: tuple(float(x) for x in at) for name, at in self.nodes.items()},  # type: ignore[misc]
            rods=tuple(rods),
            strings=tuple(self.strings),
            fixed_nodes=fixed,
            point_masses=tuple(points),
            constraints=tuple(_loose(self.constraints, {*self.nodes} - {*fixed})),
            **{key: self.settings.pop(key) for key in ("string_law",) if key in self.settings},
        )
        velocities = np.array([np.asarray(self.velocities.get(name, (0, 0, 0)), float) for name in self.nodes])
        return Scene(
            structure,
            name=self.name,
            source=self.source,
            loads=tuple(load for load in self.loads if load.node in self.nodes),
            initial_velocities=velocities if velocities.any() else None,
            **self.settings,
        )

    def _hold(self, name: str, axes: Iterable[str]) -> None:
        """Hold coordinates of a node by constraints."""
        self.constraints += [Constraint(f"{name} {axis}", {name: 1.0}, unit_of(axis)) for axis in sorted(axes)]

    def _merge_rods(self) -> None:
        """One rod between two nodes, as structures have them."""
        merged: dict[frozenset[str], Rod] = {}
        for rod in self.rods:
            first = merged.setdefault(frozenset(rod.nodes), rod)
            if first is not rod:
                self.notes.append(f"rod '{rod.name}' joins the nodes of '{first.name}', which stands for both")
                merged[frozenset(rod.nodes)] = dataclasses.replace(first, mass=first.mass + rod.mass)
        self.rods = list(merged.values())

    def _remove_held_rods(self) -> None:
        """Take out rods whose both ends are held, which cannot move; strings then end on fixed nodes."""
        fixed = [row for row, rod in enumerate(self.rods) if all(self.held.get(name) == ALL for name in rod.nodes)]
        if fixed:
            names = names_of(self.rods[row].name for row in fixed)
            self.rods = [rod for row, rod in enumerate(self.rods) if row not in set(fixed)]
            self.notes.append(f"rods held at both ends cannot move, and are left out: {names}; their nodes are fixed")

    def _merge_strings(self) -> None:
        """One string between two nodes, and none along a rod: as structures have them."""
        along = {frozenset(rod.nodes): rod.name for rod in self.rods}
        merged: dict[tuple[str, ...], String] = {}
        for string in self.strings:
            ends, rod = string.unordered, along.get(frozenset(string.nodes))
            if rod is not None:
                self.notes.append(
                    f"string '{string.name}' runs along rod '{rod}', so that its length cannot change: left out"
                )
            elif ends in merged:
                first = merged[ends]
                self.notes.append(
                    f"string '{string.name}' joins the nodes of '{first.name}': one string stands for both"
                )
                merged[ends] = _together(first, string, self._length(string))
            else:
                merged[ends] = string
        self.strings = list(merged.values())

    def _length(self, string: String) -> float:
        places = np.array([self.nodes[name] for name in string.nodes], float)
        return float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())

    def _remove_unused_nodes(self) -> None:
        ends = [rod.nodes for rod in self.rods] + [string.nodes for string in self.strings]
        used = {name for pair in ends for name in pair} | self.masses.keys()
        loose = [name for name in self.nodes if name not in used]
        if loose:
            self.notes.append(f"nodes of no member are left out: {names_of(loose)}")
            self.nodes = {name: at for name, at in self.nodes.items() if name in used}

    def _supported(self) -> list[Rod]:
        """The rods with supports that hold what is held of their nodes."""
        planes = self._planes()
        wanted = [
            (name, held - planes.get(name, frozenset()))
            for name, held in self.held.items()
            if any(name in rod.nodes for rod in self.rods)
        ]
        wanted = [(name, held) for name, held in wanted if held]
        free = [row for row, rod in enumerate(self.rods) if rod.support == Support()]
        chosen = _matching([name for name, _ in wanted], [self.rods[row].nodes for row in free])
        supports: dict[int, Support] = {}
        for (name, held), place in zip(wanted, chosen, strict=True):
            if place < 0:
                self._hold(name, held)  # its rods are all held elsewhere, where each has one support
                continue
            rod = self.rods[free[place]]
            sigma, plane = float(rod.nodes.index(name)), _plane(planes, name)
            if held | planes.get(name, frozenset()) == ALL:
                supports[free[place]] = Support.pinned(sigma, plane)
            else:
                rows = [unit_of(axis) for axis in sorted(held)]
                supports[free[place]] = Support.constrained(rows, sigma, plane=plane)
        for row in free:
            plane = _plane(planes, self.rods[row].nodes[0])
            if row not in supports and plane is not None:
                supports[row] = Support.free(plane=plane)
        return [dataclasses.replace(rod, support=supports.get(row, rod.support)) for row, rod in enumerate(self.rods)]

    def _planes(self) -> dict[str, frozenset[str]]:
        """Node -> the axis along which all nodes are held that hang together with it: these rods move in a plane."""
        names = list(dict.fromkeys(name for rod in self.rods for name in rod.nodes))
        at = {name: row for row, name in enumerate(names)}
        pairs = np.array([[at[name] for name in rod.nodes] for rod in self.rods], int).reshape(-1, 2)
        graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(names), len(names)))
        _, labels = connected_components(graph, directed=False)
        common: dict[int, frozenset[str]] = {}
        for name, label in zip(names, labels.tolist(), strict=True):
            common[label] = common.get(label, ALL) & self.held.get(name, frozenset())
        planes = {label: frozenset("y" if "y" in axes else max(axes)) for label, axes in common.items() if axes}
        return {name: planes[label] for name, label in zip(names, labels.tolist(), strict=True) if label in planes}


def held_axes(structure: Structure) -> tuple[dict[str, frozenset[str]], list[str]]:
    """Node -> the axes in which supports and planes hold it, and notes of what holds something else than nodes."""
    held: dict[str, set[str]] = {name: set(AXES) for name in structure.fixed_nodes}
    notes = []
    for rod in structure.rods:
        support = rod.support
        axes = _axes_of(support.directions)
        plane = _axes_of(() if support.plane is None else (support.plane,))
        if support.directions and (axes is None or support.sigma not in (0.0, 1.0)):
            notes.append(f"the support of rod '{rod.name}', which holds no axis of one of its nodes, is left out")
        elif axes:
            held.setdefault(rod.nodes[int(support.sigma)], set()).update(axes)
        if plane is None:
            notes.append(f"the plane of rod '{rod.name}', which is across no axis, is left out")
        for name in rod.nodes if plane else ():
            held.setdefault(name, set()).update(plane or ())
    for point in structure.point_masses:
        plane = _axes_of(() if point.plane is None else (point.plane,))
        if plane is None:
            notes.append(f"the plane of the point mass on node '{point.node}', which is across no axis, is left out")
        elif plane:
            held[point.node] = set(plane)
    for one in structure.constraints:
        axes = _axes_of((one.direction,))
        if axes is None or len(one.nodes) > 1:
            notes.append(f"the constraint '{one.name}', which holds no axis of one node, is left out")
        else:
            held.setdefault(next(iter(one.nodes)), set()).update(axes)
    return {name: frozenset(axes) for name, axes in held.items()}, notes


def _loose(constraints: Iterable[Constraint], free: Collection[str]) -> list[Constraint]:
    """Return the constraints' parts on nodes that are free, each value of which the reference gives."""
    reduced = [({node: w for node, w in one.nodes.items() if node in free}, one) for one in constraints]
    return [dataclasses.replace(one, nodes=nodes) for nodes, one in reduced if nodes]


def _axes_of(rows: Sequence[Sequence[float]]) -> str | None:
    """The axes that rows (r, 3) span, or None where they span other directions."""
    D: Array = np.array(rows, float).reshape(-1, 3)
    axes = "".join(axis for axis, column in zip(AXES, D.T, strict=True) if column.any())
    return axes if len(axes) == len(D) else None


def _matching(names: Sequence[str], ends: Sequence[tuple[str, str]]) -> list[int]:
    """Match as many nodes as possible with a member of their own that ends there: its row, or -1 for none."""
    found = [(row, column) for row, name in enumerate(names) for column, pair in enumerate(ends) if name in pair]
    if not found:
        return [-1] * len(names)
    rows, columns = np.array(found).T
    graph = coo_array((np.ones(len(rows)), (rows, columns)), shape=(len(names), len(ends))).tocsr()
    return [int(column) for column in maximum_bipartite_matching(graph, perm_type="column")]


def _together(first: String, second: String, length: float) -> String:
    """One string for two between the same nodes, of this length [m]: stiffness, damping, tension and mass add up."""

    def tension(string: String) -> float:
        if string.rest_length is not None:
            return string.stiffness * (length - string.rest_length)
        return string.tension if string.tension is not None else (string.force_density or 0.0) * length

    k, c = first.stiffness + second.stiffness, first.damping + second.damping
    if k == 0:  # constant forces
        return dataclasses.replace(first, damping=c, tension=tension(first) + tension(second))
    rest = length - (tension(first) + tension(second)) / k
    mass = (first.mass or 0.0) + (second.mass or 0.0) or None
    return dataclasses.replace(
        first, stiffness=k, damping=c, rest_length=rest, mass=mass, tension=None, force_density=None
    )


def _plane(planes: Mapping[str, frozenset[str]], name: str) -> tuple[float, float, float] | None:
    axes = planes.get(name)
    return None if not axes else unit_of(min(axes))


def unit_of(axis: str) -> tuple[float, float, float]:
    """The unit vector of an axis, "x", "y" or "z"."""
    return (float(axis == "x"), float(axis == "y"), float(axis == "z"))
