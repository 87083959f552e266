"""Structures whose supports move: checks of the motions, and the start of everything that hangs on them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.errors import SceneError
from tensegrity_mj.model.members import Rod, null_space_basis
from tensegrity_mj.model.motion import Motion
from tensegrity_mj.model.rods import mass_products
from tensegrity_mj.model.ropes import with_ropes
from tensegrity_mj.model.structure import Structure

if TYPE_CHECKING:
    from tensegrity_mj.model.scene import Scene


# A direction, or a velocity, counts as held where it is off by less than this part.
TOLERANCE = 1e-9
MOST_JOINED = 3000  # rods of a cluster for which velocities are found: some matrices of 10^8 numbers, a minute
# A function's velocity and acceleration are compared with its differences over this time [s], at this many instants
# of the scene, to this part of the largest of them: coarse, since it is mistakes that are to be found, not round-off.
DIFFERENCE, INSTANTS, AGREEMENT = 1e-5, 9, 1e-2


def check_motions(scene: Scene) -> None:
    """Raise SceneError unless each motion is one that its support can make."""
    structure = scene.structure
    rods, fixed = {rod.name: rod for rod in structure.rods}, set(structure.fixed_nodes)
    held = {one.name: one for one in structure.constraints}
    kinds = {"a rod": rods, "a fixed node": fixed, "a constraint": held}
    seen: set[str] = set()
    for motion in scene.motions:
        name = motion.support
        what = f"motion of '{name}'"
        if name in seen:
            raise SceneError(f"{what}: it is given twice; give one motion a support, with the harmonics of both")
        seen.add(name)
        called = [kind for kind, names in kinds.items() if name in names]
        if len(called) > 1:
            raise SceneError(f"{what}: {' and '.join(called)} both have that name; rename one of them")
        if not called:
            raise SceneError(f"{what}: {_unknown(structure)}")
        displacements = _displacements(scene, motion)
        if name in rods:
            _check_held(what, rods[name], displacements)
        if name in held and not np.any(displacements @ held[name].unit):
            raise SceneError(
                f"{what}: nothing of it is along {list(held[name].direction)}, in which the constraint holds its nodes"
            )
        if motion.function is not None:
            _check_derivatives(scene, what, motion)
    check_motions_until(scene, scene.start_time + scene.duration)
    _check_joints(scene, seen)


def check_motions_until(scene: Scene, end: float) -> None:
    """Raise SceneError where data would stop, or start, with a jump of the velocity within a run until then [s]."""
    for motion in scene.motions:
        if not motion.velocities:
            continue
        starts = motion.times[0] > scene.start_time and np.any(motion.velocities[0])
        ends = scene.start_time <= motion.times[-1] < end * (1 - TOLERANCE) and np.any(motion.velocities[-1])
        if starts or ends:
            raise SceneError(
                f"motion of '{motion.support}': the data stand still before {motion.times[0]:g} s and after "
                f"{motion.times[-1]:g} s, but move with {motion.jump}: let them be at rest there, or cover the run of "
                f"{end:g} s"
            )


def held_directions(rod: Rod) -> Array:
    """Orthonormal rows (k, 3) along which the support of a rod holds its point at σ, and so can move it.

    The normal of a planar rod is none: its plane stands still.
    """
    others = list(rod.support.translation_basis.T)
    if rod.support.plane is not None:
        others.append(np.array(rod.support.plane))
    return null_space_basis(np.array(others).reshape(-1, 3)).T


def moved_positions(structure: Structure, motions: Sequence[Motion], time: float = 0.0) -> Array:
    """Node positions (N, 3) [m] at a time [s]: the reference, everything displaced as the support that it hangs on.

    Rods that hang together by supports which no one displacement fits stay: the scene must say where their nodes are.
    """
    nodes = np.array(structure.positions)
    starts = {motion.support: motion.at(float(time))[0] for motion in motions}
    for name in structure.fixed_nodes:
        nodes[structure.node_index[name]] += starts.get(name, np.zeros(3))
    for cluster in structure.clusters:
        shift, fits = _common(structure, cluster, starts)
        if fits:
            nodes[_rows_of(structure, cluster)] += shift
    nodes = with_ropes(structure, nodes, structure.positions)
    nodes.flags.writeable = False
    return nodes


def velocities_with_supports(
    structure: Structure, nodes: Array, motions: Sequence[Motion], velocities: Array | None = None, time: float = 0.0
) -> Array:
    """Node velocities (N, 3) [m/s] at a time [s] that fit the motions and change given ones least.

    Without `velocities`, rods that hang together start with the one velocity that fits their supports best: at rest in
    the frame of their support, where there is one; points of ropes are at rest in the world. What their supports and
    lengths do not allow of that, or of the velocities given, is taken away with the least kinetic energy, as a blow on
    the supports does.

    Args:
        structure: the structure that moves.
        nodes: (N, 3) [m] where it is.
        motions: of its supports; the others are at rest.
        velocities: (N, 3) [m/s] to start from.

    Raises:
        SceneError: where no velocities fit.
    """
    starts = {motion.support: motion.at(float(time))[1] for motion in motions}
    given = np.zeros_like(nodes) if velocities is None else np.array(velocities, float)
    for name in structure.fixed_nodes:
        given[structure.node_index[name]] = starts.get(name, np.zeros(3))
    for cluster in structure.clusters:
        rows = _rows_of(structure, cluster)
        if velocities is None:
            given[rows], fits = _common(structure, cluster, starts)
            if fits:
                continue
        given[rows] = _projected(structure, nodes, cluster, rows, starts, given[rows])
    if structure.constraints:  # which may join any rods and point masses
        others = {*structure.fixed_nodes, *(node for body in structure.bodies for node in body.nodes)}
        rows = [row for row, name in enumerate(structure.node_names) if name not in others]
        given[rows] = _projected(structure, nodes, range(len(structure.rods)), rows, starts, given[rows])
    given.flags.writeable = False
    return given


def _common(structure: Structure, cluster: Sequence[int], starts: dict[str, Array]) -> tuple[Array, bool]:
    """The vector (3,) nearest to what the supports of a cluster start with, and whether it fits all of them."""
    rods = _held_rods(structure, cluster)
    if not rods:
        return np.zeros(3), True
    own = [starts.get(rod.name, np.zeros(3)) for rod in rods]
    held = [held_directions(rod) for rod in rods]
    rows, values = np.concatenate(held), np.concatenate([D @ v for D, v in zip(held, own, strict=True)])
    limit = TOLERANCE * float(np.abs(values).max(initial=0.0))
    # One of them as it is, rather than with the round-off of a solution.
    for vector in sorted(own, key=lambda v: -float(np.abs(v).max())):
        if np.all(np.abs(rows @ vector - values) <= limit * 1e-6):
            return vector, True
    vector = np.linalg.lstsq(rows, values, rcond=1e-12)[0]
    return vector, bool(np.all(np.abs(rows @ vector - values) <= limit))


def _projected(
    structure: Structure, nodes: Array, cluster: Sequence[int], rows: list[int], starts: dict[str, Array], given: Array
) -> Array:
    """The velocities (n, 3) of a cluster nearest to those given, in its kinetic energy, that keep its constraints."""
    if len(cluster) > MOST_JOINED:
        raise SceneError(
            f"motions: {len(cluster)} rods hang together on supports that do not start alike; the velocities that fit "
            f"are found for at most {MOST_JOINED} rods: let all supports start with the same velocity"
        )
    place = {row: k for k, row in enumerate(rows)}
    size = 3 * len(rows)
    mass = np.zeros((len(rows), len(rows)))  # the same for each component
    lines: list[Array] = []
    values: list[float] = []

    def require(terms: Sequence[tuple[int, Array]], value: float) -> None:
        line = np.zeros(size)
        for node, part in terms:
            line[3 * place[node] : 3 * place[node] + 3] += part
        lines.append(line)
        values.append(value)

    for number in cluster:
        rod, (i, j) = structure.rods[number], (int(row) for row in structure.rod_nodes[number])
        first, second, both = mass_products(0.0, structure.rod_lumps[:, number])
        shares = ((i, i, 1 / 3, first), (i, j, 1 / 6, both), (j, i, 1 / 6, both), (j, j, 1 / 3, second))
        for one, other, share, carried in shares:
            mass[place[one], place[other]] += share * rod.mass + carried
        b = (nodes[j] - nodes[i]) / np.linalg.norm(nodes[j] - nodes[i])
        require([(i, -b), (j, b)], 0.0)
        support = rod.support
        rate = starts.get(rod.name, np.zeros(3))
        for direction in support.constraint_rows:
            row = direction / np.linalg.norm(direction)
            require([(i, (1 - support.sigma) * row), (j, support.sigma * row)], float(row @ rate))
        if support.plane is not None:
            normal = np.array(support.plane) / np.linalg.norm(support.plane)
            require([(i, -normal), (j, normal)], 0.0)
    for point in structure.lone_masses:
        row = structure.node_index[point.node]
        if row in place:
            mass[place[row], place[row]] = point.mass
            for normal in null_space_basis(point.translation_basis.T).T:
                require([(row, normal)], 0.0)
    for held in structure.constraints:
        terms = [(structure.node_index[node], weight * held.unit) for node, weight in held.nodes.items()]
        if all(node in place for node, _ in terms):
            require(terms, float(held.unit @ starts.get(held.name, np.zeros(3))))
    C = np.array(lines)
    missing = np.array(values) - C @ given.ravel()
    largest = max(float(np.abs(given).max(initial=0.0)), float(np.abs(np.array(values)).max(initial=0.0)))
    if np.abs(missing).max() <= 1e-6 * TOLERANCE * largest:
        return given  # they fit, but for round-off
    change = _least_energy(mass, C, missing, 1e-3 * TOLERANCE * largest)
    left = float(np.abs(C @ change - missing).max(initial=0.0))
    if left > TOLERANCE * largest:
        names = ", ".join(f"'{rod.name}'" for rod in _held_rods(structure, cluster))
        names += "".join(f", constraint '{one.name}'" for one in structure.constraints)
        raise SceneError(
            f"motions: the supports of rods {names} start at velocities that the rods between them cannot follow (off "
            f"by {left:.3g} m/s): choose motions or a start that the structure allows"
        )
    found = given + change.reshape(-1, 3)
    return np.asarray(found if np.abs(found).max() > TOLERANCE * largest else 0.0 * found)  # round-off of what is held


def _least_energy(mass: Array, C: Array, missing: Array, limit: float) -> Array:
    """dv (3n,) of the least dvᵀ (m ⊗ 1) dv with C dv = missing, or as near to it as can be; m (n, n), C (L, 3n)."""
    count = len(mass)
    columns = C.reshape(-1, count, 3).transpose(1, 0, 2).reshape(count, -1)
    moved = np.linalg.solve(mass, columns).reshape(count, -1, 3).transpose(1, 0, 2).reshape(len(C), -1)  # C M⁻¹
    blows = C @ moved.T
    try:
        change = moved.T @ np.linalg.solve(blows, missing)
        change = change + moved.T @ np.linalg.solve(blows, missing - C @ change)
        if np.abs(C @ change - missing).max() <= limit:
            return np.asarray(change)
    except np.linalg.LinAlgError:
        pass
    # Constraints that repeat each other. y = Lᵀ dv of least length with C L⁻ᵀ y = missing:
    root = np.kron(np.linalg.cholesky(mass), np.eye(3))
    scaled = np.linalg.solve(root, C.T).T
    return np.asarray(np.linalg.solve(root.T, np.linalg.lstsq(scaled, missing, rcond=1e-12)[0]))


def _held_rods(structure: Structure, cluster: Sequence[int]) -> list[Rod]:
    return [structure.rods[row] for row in cluster if structure.rods[row].support.directions]


def _rows_of(structure: Structure, cluster: Sequence[int]) -> list[int]:
    return sorted({int(node) for row in cluster for node in structure.rod_nodes[row]})


def _displacements(scene: Scene, motion: Motion) -> Array:
    """Displacements (T, 3) that span all that the motion makes; of a function, those at some instants."""
    if motion.function is None:
        rows = [item.amplitude for item in motion.harmonics]
        for part in (motion.displacements, motion.velocities, motion.accelerations):
            rows += list(part)
        return np.array(rows)
    return np.concatenate([motion.at(float(time)) for time in _instants(scene)])


def _instants(scene: Scene) -> Array:
    """Times within the scene, the start among them, and no period's multiples."""
    return float(scene.start_time) + float(scene.duration) * np.sqrt(np.arange(INSTANTS) / INSTANTS)


def _check_held(what: str, rod: Rod, displacements: Array) -> None:
    held = held_directions(rod)
    off = displacements - displacements @ held.T @ held
    lengths, largest = np.abs(off).max(axis=1), np.abs(displacements).max(axis=1)
    if np.any(lengths > TOLERANCE * largest.max(initial=0.0)):
        worst = displacements[int(np.argmax(lengths))]
        along = "nowhere: it is free" if not len(held) else f"along {np.round(held, 9).tolist()} only"
        plane = "" if rod.support.plane is None else f", and its plane of normal {rod.support.plane} stands still"
        raise SceneError(
            f"{what}: {worst.tolist()} leaves the directions that the support holds; rod '{rod.name}' is held at "
            f"σ = {rod.support.sigma} {along}{plane}"
        )


def _check_derivatives(scene: Scene, what: str, motion: Motion) -> None:
    """Raise SceneError where a function's velocity or acceleration is not that of its displacement."""
    times = _instants(scene)[1:]
    here = np.array([motion.at(float(t)) for t in times])
    slopes = np.array([motion.at(float(t) + DIFFERENCE) - motion.at(float(t) - DIFFERENCE) for t in times])
    slopes /= 2 * DIFFERENCE
    for order, name in ((1, "velocity"), (2, "acceleration")):
        given, found = here[:, order], slopes[:, order - 1]
        # Round-off of a displacement of d over DIFFERENCE, and of the times themselves.
        floor = 1e-9 * float(np.abs(here[:, order - 1]).max()) + 1e-300
        scale = max(float(np.abs(given).max()), float(np.abs(found).max()))
        wrong = np.abs(given - found).max(axis=1) > AGREEMENT * scale + floor
        if np.sum(wrong) > len(times) // 2:  # a kink or two are the function's right
            k = int(np.argmax(wrong))
            raise SceneError(
                f"{what}: at t = {times[k]:.6g} s its function gives the {name} {given[k].tolist()}, where its values "
                f"beside it give {found[k].tolist()}: it must return displacement, velocity and acceleration"
            )


def _check_joints(scene: Scene, moved: set[str]) -> None:
    """Raise SceneError where a moved rod and another one hold the same joint in the same direction."""
    structure = scene.structure
    for name, rows in structure.rods_at.items():
        holding = [structure.rods[row] for row in rows if structure.rods[row].support.directions]
        holding = [rod for rod in holding if rod.support.sigma == float(rod.nodes[1] == name)]
        if len(holding) < 2 or not moved & {rod.name for rod in holding}:
            continue
        directions = np.concatenate([held_directions(rod) for rod in holding])
        if np.linalg.matrix_rank(directions, tol=1e-6) < len(directions):
            names = " and ".join(f"'{rod.name}'" for rod in holding)
            raise SceneError(
                f"motions: node '{name}' is held by rods {names} in the same direction, and not all of them may move: "
                "hold it by one of them"
            )


def _unknown(structure: Structure) -> str:
    held = [rod.name for rod in structure.rods if rod.support.directions]
    held += [*structure.fixed_nodes, *(one.name for one in structure.constraints)]
    names = ", ".join(f"'{name}'" for name in held[:12])
    return f"there is no such support; rods with one, fixed nodes and constraints: {names or 'none'}"
