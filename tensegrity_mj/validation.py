"""What makes a structure or a scene valid. Every message: the item, its value, what is allowed, the remedy."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tensegrity_mj.errors import SceneError, StructureError
from tensegrity_mj.strings import StringLaw

if TYPE_CHECKING:
    from tensegrity_mj.scene import Scene, Target
    from tensegrity_mj.structure import Rod, String, Structure

Array = NDArray[np.float64]

# Initial motions are accepted when they break a rigid constraint by less than this part of the structure's size
# (or of its fastest node): well above the round-off of 17 digits, well below anything that would be seen.
CONSTRAINT_TOLERANCE = 1e-9

# Between the shapes of a curve a polynomial may stretch rods by this part of the structure's size; targets of rods are
# normalised, so that it is the error of where they are that this bounds.
CURVE_TOLERANCE = 1e-6


def array_of_shape(what: str, values: Any, shape: tuple[int, ...], broadcast: bool = True) -> Array:
    """The values as a finite float array of the given shape (-1: any length; scalars pass if `broadcast`).

    Raises:
        StructureError: naming what it is, the shape it has and the shape it must have.
    """
    try:
        array = np.array(values, float)
    except (TypeError, ValueError, OverflowError):
        raise StructureError(f"{what}: {values!r} is not an array of numbers of shape {shape}") from None
    fits = array.ndim == len(shape) and all(want in (-1, got) for want, got in zip(shape, array.shape, strict=True))
    if not fits and not (broadcast and array.ndim == 0):
        raise StructureError(f"{what}: shape {array.shape}; it must be {shape}" + (" or a scalar" if broadcast else ""))
    if not np.all(np.isfinite(array)):
        where = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0]) if array.ndim else ()
        raise StructureError(f"{what}{list(where) if where else ''} = {array[where]}: every number must be finite")
    return array


def index_pairs(what: str, values: Any, count: int, allow_equal: bool = False) -> list[tuple[int, int]]:
    """The values as pairs of different node indices below `count`."""
    pairs = []
    for row, value in enumerate(sequence_of(what, values)):
        try:
            i, j = (int(x) for x in value)
        except (TypeError, ValueError, OverflowError):
            raise StructureError(f"{what}[{row}] = {value!r}: it must be a pair of node indices") from None
        whole = i == value[0] and j == value[1]
        if not whole:
            raise StructureError(f"{what}[{row}] = {list(value)}: node indices must be integers")
        if not (0 <= i < count and 0 <= j < count):
            raise StructureError(f"{what}[{row}] = ({i}, {j}): node indices run from 0 to {count - 1}")
        if i == j and not allow_equal:
            raise StructureError(f"{what}[{row}] = ({i}, {j}): it must join two different nodes")
        pairs.append((i, j))
    return pairs


def sequence_of(what: str, values: Any, error: type[Exception] = StructureError) -> tuple[Any, ...]:
    """The values as a tuple; raise `error` if they are a text, or no sequence at all."""
    if not isinstance(values, str):
        try:
            return tuple(values)
        except TypeError:
            pass
    raise error(f"{what} = {values!r}; it must be a sequence (a list or tuple, of one item too)")


def check_structure(structure: Structure) -> None:
    """Raise StructureError if the structure is not valid."""
    from tensegrity_mj.structure import PointMass, Rod, String

    _check_text("name of the structure", structure.name, StructureError)
    nodes = structure.nodes
    if not isinstance(nodes, Mapping):
        raise StructureError(f"nodes: a {type(nodes).__name__}; it must map each node's name to its position")
    for what, members, kind in (
        ("rods", structure.rods, Rod),
        ("strings", structure.strings, String),
        ("point_masses", structure.point_masses, PointMass),
    ):
        for number, member in enumerate(members):
            if not isinstance(member, kind):
                raise StructureError(f"{what}[{number}] = {member!r}; it must be a {kind.__name__}")
    if not nodes:
        raise StructureError(f"structure '{structure.name}' has no nodes; it needs at least a rod or a point mass")
    for name, position in nodes.items():
        _check_name("node", name)
        check_vector(f"node '{name}'", position)
    if not isinstance(structure.string_law, StringLaw):
        allowed = ", ".join(f"StringLaw.{law.name}" for law in StringLaw)
        raise StructureError(f"string_law = {structure.string_law!r}; allowed: {allowed}")
    if not structure.rods and not structure.point_masses:
        raise StructureError(f"structure '{structure.name}' has neither rods nor point masses: nothing can move")
    _check_unique("rod", (rod.name for rod in structure.rods))
    _check_unique("string", (string.name for string in structure.strings))

    owner = _check_node_roles(structure)
    size = _size(structure)
    for rod in structure.rods:
        _check_rod(structure, rod, size)
    along = _check_joints(structure)
    for point in structure.point_masses:
        check_number(f"point mass on node '{point.node}': mass", point.mass, "> 0 kg", lambda x: x > 0)
        if point.plane is not None:
            _check_normal(f"point mass on node '{point.node}'", point.plane)
    seen: dict[frozenset[str], str] = {}
    for string in structure.strings:
        _check_string(structure, string, size)
        ends = frozenset(string.nodes)
        if ends in seen:
            raise StructureError(
                f"string '{string.name}' joins {_pair(string)} as string '{seen[ends]}' does: "
                "remove one of them, or give one string their summed stiffness"
            )
        seen[ends] = string.name
        if ends in along:
            raise StructureError(
                f"string '{string.name}' runs along rod '{along[ends]}' ({_pair(string)}): "
                "its length cannot change; remove it"
            )
        # A string between two fixed points is harmless, and found in published data: it loads nothing that moves.
    used = set(owner) | {name for string in structure.strings for name in string.nodes}
    for name in nodes:
        if name not in used:
            raise StructureError(f"node '{name}' is used by no rod, string or point mass: remove it or use it")
        if name not in owner:
            raise StructureError(
                f"node '{name}' is an end of strings only and would have no mass: "
                "put it on a rod, give it a point mass, or add it to fixed_nodes"
            )


def check_scene(scene: Scene) -> None:
    """Raise SceneError if the scene does not fit its structure."""
    from tensegrity_mj.moved_supports import check_motions
    from tensegrity_mj.scene import Load, Target
    from tensegrity_mj.structure import Structure
    from tensegrity_mj.validation_resistance import check_resistance

    structure = scene.structure
    if not isinstance(structure, Structure):
        raise SceneError(f"structure = {structure!r}; it must be a Structure")
    count = len(structure.nodes)
    _check_text("name of the scene", scene.name, SceneError)
    _check_text("source", scene.source, SceneError)
    check_vector("gravity", scene.gravity, SceneError, "m/s²")
    check_number("duration", scene.duration, "> 0 s", lambda x: x > 0, SceneError)
    for what in ("initial_nodes", "initial_velocities"):
        value = getattr(scene, what)
        if value is not None:
            _check_node_array(structure, what, value)
    check_motions(scene)
    start = {motion.support: motion.at(0.0) for motion in scene.motions}
    check_configuration(structure, scene.nodes0, "initial_nodes", {name: d[0] for name, d in start.items()})
    _check_initial_velocities(scene, {name: d[1] for name, d in start.items()})
    _check_no_vanishing_string(scene)

    if not callable(scene.loads):
        for number, load in enumerate(scene.loads):
            if not isinstance(load, Load):
                raise SceneError(f"loads[{number}] = {load!r}: it must be a Load, or loads a function of time")
            if not isinstance(load.node, str) or load.node not in structure.node_index:
                raise SceneError(f"loads[{number}]: {_unknown_node(load.node, structure)}")
            check_vector(f"loads[{number}] on node '{load.node}': force", load.force, SceneError, "N")
            for what in ("angular_frequency", "phase"):
                check_number(f"loads[{number}].{what}", getattr(load, what), "finite", lambda x: True, SceneError)
    else:
        try:
            forces = np.asarray(scene.loads(0.0), float)
        except Exception as error:
            raise SceneError(f"loads: the function failed at t = 0: {type(error).__name__}: {error}") from error
        if forces.shape != (count, 3) or not np.all(np.isfinite(forces)):
            raise SceneError(
                f"loads: the function gave shape {forces.shape} at t = 0; it must give finite ({count}, 3) [N]"
            )

    _check_breaks(scene)
    if scene.contact is not None:
        _check_contact(scene)
    if scene.resistance is not None:
        check_resistance(scene.structure, scene.resistance)
    if scene.target is not None:
        if not isinstance(scene.target, Target):
            raise SceneError(f"target = {scene.target!r}: use Target.set_point(nodes), Target.path or Target.curve")
        check_target(structure, scene.target)
    if scene.control is not None:
        _check_control(scene.control)


def check_target(structure: Structure, target: Any) -> None:
    """Raise SceneError unless every waypoint is a configuration of the structure and times increase."""
    count = len(structure.nodes)
    if target.nodes.ndim != 3 or target.nodes.shape[1:] != (count, 3) or len(target.times) != len(target.nodes):
        raise SceneError(
            f"target: {len(target.times)} times and nodes of shape {target.nodes.shape}; "
            f"it needs nodes (W, {count}, 3), one set of them a time"
        )
    times = np.array(target.times, float)
    if len(times) == 0 or not np.all(np.isfinite(times)) or np.any(np.diff(times) <= 0):
        raise SceneError(f"target: times {list(target.times)} must be finite and increase")
    if target.along is not None:
        _check_curve(structure, target)
        return
    for number, nodes in enumerate(target.nodes):
        where = "target" if len(times) == 1 else f"target waypoint {number} (t = {times[number]} s)"
        _check_node_array(structure, where, nodes)
        check_configuration(structure, nodes, where)


def _check_curve(structure: Structure, target: Target) -> None:
    """Raise SceneError unless the shapes are configurations and what lies between them nearly so."""
    curve = target.along
    assert curve is not None
    for number, nodes in enumerate(curve.shapes):
        where = f"target shape {number} (parameter {curve.parameters[number]})"
        _check_node_array(structure, where, nodes)
        check_configuration(structure, nodes, where)
    first, last = curve.interval
    lowest, highest = curve.extremes(target.times)
    slack = 1e-12 * (last - first)
    if lowest < first - slack or highest > last + slack:
        raise SceneError(
            f"target: the parameter moves within [{lowest:.12g}, {highest:.12g}], but shapes are known in "
            f"[{first:.12g}, {last:.12g}] only: give shapes beyond, or smaller rates and accelerations"
        )
    between = np.linspace(first, last, 8 * len(curve.parameters) + 1)
    pairs = structure.rod_nodes
    nodes = curve.nodes(between)
    lengths = np.linalg.norm(nodes[:, pairs[:, 1]] - nodes[:, pairs[:, 0]], axis=-1)
    stretch = np.abs(lengths - structure.rod_lengths)
    again = float(np.abs(curve.nodes(curve.parameters) - curve.shapes).max())
    if again > CONSTRAINT_TOLERANCE * _size(structure) or stretch.max(initial=0.0) > CURVE_TOLERANCE * _size(structure):
        row, rod = np.unravel_index(np.argmax(stretch), stretch.shape) if stretch.size else (0, 0)
        raise SceneError(
            f"target: the polynomial through the {len(curve.parameters)} shapes stretches rods by up to "
            f"{stretch.max(initial=0.0):.3g} m (rod '{structure.rods[rod].name}' at parameter {between[row]:.6g}) and "
            f"misses the shapes by {again:.3g} m: give more shapes, at chebyshev_points of the parameter"
        )


def check_configuration(
    structure: Structure, nodes: Array, where: str, moved: Mapping[str, Array] | None = None
) -> None:
    """Raise SceneError unless node positions keep rod lengths, supports, planes and fixed nodes.

    Supports in `moved` (rod or fixed node -> displacement (3,) [m]) are that far from where the structure has them.
    """
    size = _size(structure)
    moved = moved or {}
    still = np.zeros(3)
    for name in structure.fixed_nodes:
        row = structure.node_index[name]
        gap = float(np.linalg.norm(nodes[row] - structure.positions[row] - moved.get(name, still)))
        if gap > CONSTRAINT_TOLERANCE * size:
            raise SceneError(f"{where}: fixed node '{name}' is {gap:.3g} m from its place; it must stay there")
    for number, rod in enumerate(structure.rods):
        i, j = structure.rod_nodes[number]
        length = structure.rod_lengths[number]
        stretch = float(np.linalg.norm(nodes[j] - nodes[i]) - length)
        if abs(stretch) > CONSTRAINT_TOLERANCE * size:
            raise SceneError(
                f"{where}: rod '{rod.name}' would be {length + stretch:.12g} m long; its length is {length:.12g} m"
            )
        sigma = rod.support.sigma
        r = (1 - sigma) * nodes[i] + sigma * nodes[j]
        reference = (1 - sigma) * structure.positions[i] + sigma * structure.positions[j]
        rows = rod.support.constraint_rows
        shift = moved.get(rod.name, still)
        broken = np.abs(_unit_rows(rows) @ (r - reference - shift)) if len(rows) else np.zeros(0)
        if np.any(broken > CONSTRAINT_TOLERANCE * size):
            raise SceneError(
                f"{where}: rod '{rod.name}' breaks its support by {broken.max():.3g} m at σ = {sigma}: "
                "the point must keep D r = r̄ of the reference nodes"
                + (f", moved by {shift.tolist()} m" if rod.name in moved else "")
            )
        if rod.support.plane is not None:
            off = abs(float(_unit_rows(np.array([rod.support.plane]))[0] @ (nodes[j] - nodes[i])))
            if off > CONSTRAINT_TOLERANCE * size:
                raise SceneError(
                    f"{where}: rod '{rod.name}' leaves its plane by {off:.3g} m; its direction must be orthogonal "
                    f"to the normal {rod.support.plane}"
                )
    for point in structure.point_masses:
        if point.plane is not None:
            row = structure.node_index[point.node]
            off = abs(float(_unit_rows(np.array([point.plane]))[0] @ (nodes[row] - structure.positions[row])))
            if off > CONSTRAINT_TOLERANCE * size:
                raise SceneError(f"{where}: the point mass on node '{point.node}' is {off:.3g} m out of its plane")


def _check_node_roles(structure: Structure) -> dict[str, str]:
    owner: dict[str, str] = {}
    for rod in structure.rods:
        _check_ends(f"rod '{rod.name}'", rod.nodes, structure)
        for name in rod.nodes:
            owner.setdefault(name, f"rod '{rod.name}'")
    _check_unique("fixed node", structure.fixed_nodes)
    for name in structure.fixed_nodes:
        _check_known("fixed_nodes", name, structure)
        if name in owner:
            raise StructureError(
                f"fixed node '{name}' is an end of {owner[name]}: pin the rod there instead (support pinned at σ = 0 "
                "or 1); where several rods meet, pin one of them"
            )
        owner[name] = "a fixed node"
    for point in structure.point_masses:
        _check_known("point mass", point.node, structure)
        if point.node in owner:
            raise StructureError(
                f"point mass on node '{point.node}', which is {owner[point.node]} already: "
                "point masses stand on nodes of their own"
            )
        owner[point.node] = f"the point mass on node '{point.node}'"
    return owner


def _check_joints(structure: Structure) -> dict[frozenset[str], str]:
    """The name of the rod between each pair of nodes; raise StructureError unless rods that meet fit each other."""
    along: dict[frozenset[str], str] = {}
    joined: dict[str, str] = {}  # node -> the node that stands for all nodes of its cluster

    def root(name: str) -> str:
        while joined.get(name, name) != name:
            joined[name] = joined.get(joined[name], joined[name])
            name = joined[name]
        return name

    for rod in structure.rods:
        ends = frozenset(rod.nodes)
        if ends in along:
            raise StructureError(
                f"rod '{rod.name}' joins {_pair(rod)} as rod '{along[ends]}' does: give one rod the mass of both"
            )
        along[ends] = rod.name
        joined[root(rod.nodes[0])] = root(rod.nodes[1])
    first: dict[str, Rod] = {}
    for rod in structure.rods:
        other = first.setdefault(root(rod.nodes[0]), rod)
        one, two = other.support.plane, rod.support.plane
        parallel = one is None and two is None
        if one is not None and two is not None:
            normals = _unit_rows(np.array([one, two], float))
            parallel = float(np.linalg.norm(np.cross(*normals))) <= CONSTRAINT_TOLERANCE
        if not parallel:
            raise StructureError(
                f"rods '{other.name}' and '{rod.name}' are joined, but turn in {_plane(one)} and in {_plane(two)}: "
                "rods that hang together all turn in one plane, or all in space"
            )
    return along


def _plane(normal: ArrayLike | None) -> str:
    return "space" if normal is None else f"the plane of normal {_shown(normal)}"


def _check_rod(structure: Structure, rod: Rod, size: float) -> None:
    from tensegrity_mj.structure import Support

    what = f"rod '{rod.name}'"
    check_number(f"{what}: mass", rod.mass, "> 0 kg", lambda x: x > 0)
    check_number(f"{what}: radius", rod.radius, "> 0 m", lambda x: x > 0)
    a, b = (np.array(structure.nodes[name], float) for name in rod.nodes)
    length = _distance(a, b)
    # Below this part of the coordinates, their round-off decides where a rod points.
    if not 1e-12 * max(float(np.abs(a).max()), float(np.abs(b).max())) < length < np.inf:
        raise StructureError(
            f"{what} has length {length:.3g} m between {_pair(rod)}; it must be longer than zero, and finite"
        )
    support = rod.support
    if not isinstance(support, Support):
        raise StructureError(f"{what}: support = {support!r}; use Support.free, Support.pinned or Support.constrained")
    check_number(f"{what}: σ", support.sigma, "within [0, 1]", lambda x: 0 <= x <= 1)
    for number, row in enumerate(sequence_of(f"{what}: D", support.directions)):
        check_vector(f"{what}: row {number} of D", row, unit="no unit")
    D = np.array(support.directions, float).reshape(-1, 3)
    if len(D) > 3 or (len(D) and np.linalg.matrix_rank(_unit_rows(D), tol=1e-6) < len(D)):
        raise StructureError(
            f"{what}: the rows of D = {D.tolist()} contradict or repeat each other; they must be independent"
        )
    if support.values is not None:
        values = sequence_of(f"{what}: r̄", support.values)
        if len(values) != len(D):
            raise StructureError(f"{what}: r̄ has {len(values)} values for {len(D)} rows of D; it must have one a row")
        for number, value in enumerate(values):
            check_number(f"{what}: r̄[{number}]", value, "a finite number", lambda x: True)
        r = (1 - support.sigma) * a + support.sigma * b
        gap = np.abs(D @ r - np.array(support.values, float)) / np.linalg.norm(D, axis=1)
        if not np.all(gap <= CONSTRAINT_TOLERANCE * size):
            raise StructureError(
                f"{what}: its nodes put D r = {(D @ r).tolist()} at σ = {support.sigma}, but r̄ = "
                f"{list(values)}: move the nodes onto the support, or leave r̄ out to take it from them"
            )
    if support.plane is not None:
        normal = _check_normal(what, support.plane)
        off = abs(float(normal @ (b - a)))
        if off > CONSTRAINT_TOLERANCE * size:
            raise StructureError(
                f"{what}: its direction leaves the plane of normal {support.plane} by {off:.3g} m over its length; "
                "a planar rod must lie in its plane"
            )


def _check_string(structure: Structure, string: String, size: float) -> None:
    what = f"string '{string.name}'"
    _check_ends(what, string.nodes, structure)
    check_number(f"{what}: stiffness", string.stiffness, "> 0 N/m", lambda x: x > 0)
    check_number(f"{what}: damping", string.damping, ">= 0 N s/m", lambda x: x >= 0)
    given = [name for name in ("rest_length", "tension", "force_density") if getattr(string, name) is not None]
    if len(given) > 1:
        raise StructureError(f"{what}: {' and '.join(given)} are given; give at most one of them")
    for name in given:
        limit = "a finite number" if name == "rest_length" else ">= 0"
        check_number(f"{what}: {name}", getattr(string, name), limit, lambda x, n=name: n == "rest_length" or x >= 0)
    for name, unit in (("max_force_density", "N/m"), ("min_rest_length", "m"), ("winch_speed", "m/s")):
        if getattr(string, name) is not None:
            check_number(f"{what}: {name}", getattr(string, name), f"> 0 {unit}, or absent", lambda x: x > 0)
    a, b = (np.array(structure.nodes[name], float) for name in string.nodes)
    length = _distance(a, b)
    if not 1e-12 * size < length < np.inf:
        raise StructureError(
            f"{what} has length {length:.3g} m between {_pair(string)}; it must be longer than zero, and finite"
        )


def _check_control(control: Any) -> None:
    from tensegrity_mj.scene import ControlSpec

    if not isinstance(control, ControlSpec):
        raise SceneError(f"control = {control!r}: use ControlSpec(law, options)")
    if not isinstance(control.law, str) or not control.law:
        raise SceneError(f"control: law = {control.law!r}; it must be the name of a law")
    _check_text("control: law", control.law, SceneError)
    if not isinstance(control.options, Mapping):
        raise SceneError(f"control: options = {control.options!r}; they must map each option's name to its value")
    for key, value in control.options.items():
        if not isinstance(key, str) or not key:
            raise SceneError(f"control: option {key!r}: its name must be a non-empty string")
        _check_text("control: name of an option", key, SceneError)
        _check_option(f"control: option '{key}'", value)


def _check_option(what: str, value: Any) -> None:
    if isinstance(value, list):
        for item in value:
            _check_option(what, item)
    elif isinstance(value, str):
        _check_text(what, value, SceneError)
    elif not isinstance(value, (bool, int, float)) or value != value:
        raise SceneError(f"{what}: {value!r} is no number, text or truth value, nor a list of them")


def _check_breaks(scene: Scene) -> None:
    from tensegrity_mj.scene import Break

    known = [string.name for string in scene.structure.strings]
    for number, event in enumerate(scene.breaks):
        if not isinstance(event, Break):
            raise SceneError(f"breaks[{number}] = {event!r}: it must be a Break(string, time)")
        if event.string not in known:
            raise SceneError(f"breaks[{number}]: unknown string '{event.string}'; the strings are {', '.join(known)}")
        what = f"breaks[{number}] of string '{event.string}': time"
        check_number(what, event.time, ">= 0 s", lambda x: x >= 0, SceneError)
        if event.string in [other.string for other in scene.breaks[:number]]:
            raise SceneError(f"breaks[{number}]: string '{event.string}' breaks twice; give one time for each string")


def _check_contact(scene: Scene) -> None:
    from tensegrity_mj.contact import Contact, overlaps

    contact = scene.contact
    if not isinstance(contact, Contact):
        raise SceneError(f"contact = {contact!r}: use Contact(floor=0.0), Contact(rods=True) or both, or None")

    def number(name: str, value: Any, allowed: str, test: Any) -> None:
        check_number(f"contact: {name}", value, allowed, test, SceneError)

    if contact.floor is not None:
        number("floor", contact.floor, "a finite height [m], or None for no floor", lambda x: True)
    if not isinstance(contact.rods, (bool, np.bool_)):
        raise SceneError(f"contact: rods = {contact.rods!r}; it must be True or False")
    if contact.floor is None and not contact.rods:
        raise SceneError("contact: there is neither a floor nor contact between rods: give one, or leave contact out")
    if contact.rods and len(scene.structure.rods) < 2:
        raise SceneError("contact: rods = True, but there are no two rods that could touch: leave it out")
    _check_normal("contact", contact.normal, SceneError)
    number("friction", contact.friction, "0, or within [1e-5, 1e5]", lambda x: x == 0 or 1e-5 <= x <= 1e5)
    # MuJoCo takes an acceleration beyond 1e10 m/s² for a divergence: these reach it at 1 cm and at 1 km/s.
    number("stiffness", contact.stiffness, "> 0 and at most 1e12 [1/s²]", lambda x: 0 < x <= 1e12)
    number("damping", contact.damping, "within [0, 1e7] [1/s]", lambda x: 0 <= x <= 1e7)
    names, values = ("d0", "d1", "width", "midpoint", "power"), sequence_of("impedance", contact.impedance, SceneError)
    if len(values) != len(names):
        raise SceneError(f"contact: impedance = {contact.impedance!r}; it must be five numbers ({', '.join(names)})")
    # Beyond these MuJoCo takes others without a word, or overflows: (midpoint)^(1 - power) must be finite.
    share = ("within [0.0001, 0.9999]", lambda x: 1e-4 <= x <= 0.9999)
    length = ("at least 1e-9 m", lambda x: x >= 1e-9)
    allowed = (share, share, length, share, ("within [1, 50]", lambda x: 1 <= x <= 50))
    for name, value, (text, test) in zip(names, values, allowed, strict=True):
        number(f"impedance: {name}", value, text, test)
    if values[1] < values[0]:
        raise SceneError(
            f"contact: impedance: d1 = {values[1]:g} at the depth `width` is below d0 = {values[0]:g} at touch; a "
            "contact that softens as it is pressed may give energy: make d1 at least d0"
        )
    found = overlaps(scene.structure, contact, scene.nodes0)
    if found:
        more = f" (and {len(found) - 1} more)" if len(found) > 1 else ""
        remedy = (
            "start higher, lower the floor, or make rods thinner"
            if "floor" in found[0]
            else ("move them apart, make them thinner, or leave rods = False")
        )
        raise SceneError(f"contact: at the start {found[0]}{more}: {remedy}")


def _check_initial_velocities(scene: Scene, moved: Mapping[str, Array]) -> None:
    """Raise SceneError unless velocities keep all constraints; `moved` are the velocities (3,) of moved supports."""
    structure, nodes, velocities = scene.structure, scene.nodes0, scene.velocities0
    speed = max(float(np.abs(array).max(initial=0.0)) for array in (velocities, *moved.values()))
    if speed == 0.0:
        return
    limit = CONSTRAINT_TOLERANCE * speed
    still = np.zeros(3)
    for name in structure.fixed_nodes:
        v = velocities[structure.node_index[name]]
        if name not in moved and np.any(v != 0):
            raise SceneError(f"initial_velocities: fixed node '{name}' has {v.tolist()} m/s; it must be at rest")
        if np.any(np.abs(v - moved.get(name, still)) > limit):
            raise SceneError(
                f"initial_velocities: fixed node '{name}' has {v.tolist()} m/s; its motion starts with "
                f"{moved[name].tolist()} m/s"
            )
    for number, rod in enumerate(structure.rods):
        i, j = structure.rod_nodes[number]
        b = (nodes[j] - nodes[i]) / np.linalg.norm(nodes[j] - nodes[i])
        stretch = float(b @ (velocities[j] - velocities[i]))
        if abs(stretch) > limit:
            raise SceneError(
                f"initial_velocities: rod '{rod.name}' would lengthen at {stretch:.3g} m/s; the velocities of its "
                "nodes must be equal along it"
            )
        sigma = rod.support.sigma
        at_support = (1 - sigma) * velocities[i] + sigma * velocities[j]
        rows = rod.support.constraint_rows
        rate = moved.get(rod.name, still)
        broken = np.abs(_unit_rows(rows) @ (at_support - rate)) if len(rows) else np.zeros(0)
        if np.any(broken > limit):
            raise SceneError(
                f"initial_velocities: rod '{rod.name}' would leave its support at {broken.max():.3g} m/s at σ = "
                f"{sigma}; "
                + (f"its motion starts with {rate.tolist()} m/s" if rod.name in moved else "D ṙ must be zero")
            )
        if rod.support.plane is not None:
            off = abs(float(_unit_rows(np.array([rod.support.plane]))[0] @ (velocities[j] - velocities[i])))
            if off > limit:
                raise SceneError(f"initial_velocities: rod '{rod.name}' would turn out of its plane at {off:.3g} m/s")
    for point in structure.point_masses:
        if point.plane is not None:
            off = abs(float(_unit_rows(np.array([point.plane]))[0] @ velocities[structure.node_index[point.node]]))
            if off > limit:
                raise SceneError(
                    f"initial_velocities: the point mass on '{point.node}' leaves its plane at {off:.3g} m/s"
                )


def _check_no_vanishing_string(scene: Scene) -> None:
    lengths = scene.structure.string_lengths(scene.nodes0)
    for string, length in zip(scene.structure.strings, lengths, strict=True):
        if length <= 1e-12 * _size(scene.structure):
            raise SceneError(f"initial_nodes: string '{string.name}' has length {length:.3g} m; it must be longer")


def _check_node_array(structure: Structure, what: str, value: Array) -> None:
    count = len(structure.nodes)
    if value.shape != (count, 3):
        raise SceneError(f"{what}: shape {value.shape}; it must be ({count}, 3), a row for each of {_names(structure)}")
    if not np.all(np.isfinite(value)):
        row = int(np.argwhere(~np.isfinite(value))[0][0])
        raise SceneError(f"{what}: node '{structure.node_names[row]}' has {value[row].tolist()}; it must be finite")


def _check_ends(what: str, nodes: Sequence[str], structure: Structure) -> None:
    if len(sequence_of(f"{what}: nodes", nodes)) != 2:
        raise StructureError(f"{what}: nodes = {nodes!r}; it must name two nodes")
    for name in nodes:
        _check_known(what, name, structure)
    if nodes[0] == nodes[1]:
        raise StructureError(f"{what} starts and ends on node '{nodes[0]}'; it must join two different nodes")


def _check_unique(kind: str, names: Iterable[str]) -> None:
    seen: set[str] = set()
    for name in names:
        _check_name(kind, name)
        if name in seen:
            raise StructureError(f"{kind} '{name}' is defined twice; names must be unique")
        seen.add(name)


def _check_name(kind: str, name: Any) -> None:
    # Printable: names go into TOML, MJCF and NetCDF, and XML cannot hold control characters.
    if not isinstance(name, str) or not name or not name.isprintable():
        raise StructureError(f"{kind} {name!r}: its name must be a non-empty string of printable characters")


def _check_text(what: str, value: Any, error: type[Exception]) -> None:
    try:
        value.encode()
    except (AttributeError, UnicodeEncodeError):
        raise error(f"{what} = {value!r}; it must be a text that UTF-8 can hold") from None


def _check_known(what: str, name: Any, structure: Structure) -> None:
    if not isinstance(name, str) or name not in structure.nodes:
        raise StructureError(f"{what}: {_unknown_node(name, structure)}")


def check_number(what: str, value: Any, allowed: str, test: Any, error: type[Exception] = StructureError) -> None:
    """Raise `error` unless the value is a finite number that passes the test; `allowed` says in words which do."""
    number = isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)
    try:
        valid = number and np.isfinite(float(value)) and test(value)
    except OverflowError:  # an integer beyond the floats
        valid = False
    if not valid:
        raise error(f"{what} = {_shown(value)!r}; it must be {allowed}")


def check_vector(what: str, value: Any, error: type[Exception] = StructureError, unit: str = "m") -> None:
    """Raise `error` unless the value is three finite numbers."""
    try:
        array = np.array(value, float)
    except (TypeError, ValueError, OverflowError):
        array = np.array([])
    if array.shape != (3,) or not np.all(np.isfinite(array)):
        raise error(f"{what} = {_shown(value)!r}; it must be three finite numbers [{unit}]")


def _shown(value: Any) -> Any:
    """The value without NumPy's wrappers, for messages."""
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    return type(value)(_shown(x) for x in value) if type(value) in (list, tuple) else value


def _check_normal(what: str, plane: ArrayLike, error: type[Exception] = StructureError) -> Array:
    check_vector(f"{what}: plane normal", plane, error)
    if not 0.0 < _distance(np.zeros(3), np.array(plane, float)) < np.inf:
        raise error(f"{what}: plane normal = {_shown(plane)!r}; its length must be neither zero nor infinite")
    return _unit_rows(np.array([plane], float))[0]


def _distance(a: Array, b: Array) -> float:
    with np.errstate(over="ignore"):  # infinite is what the caller checks for
        return float(np.linalg.norm(b - a))


def _unit_rows(rows: Array) -> Array:
    return rows / np.where(np.linalg.norm(rows, axis=1) > 0, np.linalg.norm(rows, axis=1), 1.0)[:, None]


def _size(structure: Structure) -> float:
    """What tolerances of lengths are relative to [m]: the extent, or for a single node its distance from 0, or 1."""
    positions = np.array(list(structure.nodes.values()), float).reshape(-1, 3)
    return float(np.ptp(positions, axis=0).max()) or float(np.abs(positions).max()) or 1.0


def _pair(member: Rod | String) -> str:
    return f"'{member.nodes[0]}' and '{member.nodes[1]}'"


def _unknown_node(name: object, structure: Structure) -> str:
    return f"unknown node {name!r}; the nodes are {_names(structure)}"


def _names(structure: Structure) -> str:
    names = list(structure.nodes)
    shown = ", ".join(f"'{name}'" for name in names[:12])
    return shown if len(names) <= 12 else f"{shown}, ... ({len(names)} in all)"
