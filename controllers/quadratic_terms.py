"""Gains and terms that the laws of chapters 5 and 6 share: a quadratic V of errors and rates, V̇ = -δ V by strings.

With e_z = z - z_d, e_b = b - b_d and their rates, V sums over the rods (5.19)

    ½ [e_zᵀ X e_z + 2 e_zᵀ Y ė_z + ė_zᵀ Z ė_z] + ½ [pᵀ X p + 2 pᵀ Y ė_b + ė_bᵀ Z ė_b] + ½ e_bᵀ K e_b,

where p = e_b in chapter 5, (5.4)-(5.5), and p = P(b) e_b or P(b_d) e_b in chapter 6, (6.3) and (6.20). Since ṗ depends
on positions and velocities only, V̇ = γ + cᵀ(q̈ - q̈_d) with γ = ṗᵀ(X p + Y ė_b) + e_bᵀ K ė_b and c = Yᵀ p + Z ė_b, and
likewise for z with p = e_z. That makes V̇ = β - fᵀu. The law demands fᵀu = β + δ V, (5.15), with the smallest u
between thresholds and ceilings (Lemma 5.1). Targets may move: their velocities and accelerations are in ė and q̈_d.

Known forces belong to g of (5.10): weight, and what else the law accounts for; what water adds to the mass is in M.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import check_definite, check_known, real_array
from tensegrity_mj.basics.kinds import Kind, Wrong
from tensegrity_mj.dynamics.kernels import place_ends, rod_accelerations, wet_rod_accelerations
from tensegrity_mj.dynamics.native.elements import known_forces
from tensegrity_mj.dynamics.native.lanes import any_of
from tensegrity_mj.dynamics.native.law import SOLVED
from tensegrity_mj.dynamics.native.pointers import floats, inlined
from tensegrity_mj.dynamics.native.strings import share, string_length
from tensegrity_mj.dynamics.native.vectors import (
    ZERO,
    apply,
    apply_transposed,
    dot,
    minus,
    plus,
    put,
    row_of,
    times,
    vector,
)
from tensegrity_mj.dynamics.native.views import view_of
from tensegrity_mj.dynamics.records import POINT, ROD
from tensegrity_mj.dynamics.target import Aim, point_target, rod_target, standing_at
from tensegrity_mj.model.structure import Structure

SCALARS = [("scalars_z", "f8", (3,)), ("scalars_b", "f8", (3,))]
GAINS = np.dtype([(name, "f8", (3, 3)) for name in ("Xz", "Yz", "Zz", "Xb", "Yb", "Zb", "Kb")], align=True)


@dataclass(frozen=True)
class Gains:
    """X, Y, Z of (5.4) or (5.5): scalars or symmetric-where-needed matrices; [X Y; Yᵀ Z] must be positive definite.

    Matrices for z are (nz, nz) in the coordinates of the support's basis E, those for b (3, 3) in the world frame.
    """

    X: ArrayLike = 1.0
    Y: ArrayLike = 1.0
    Z: ArrayLike = 1.5


def _one(value: Any, more: str = "") -> Gains:
    if isinstance(value, Mapping) and set(value) <= {"X", "Y", "Z"}:
        return Gains(**value)
    if not isinstance(value, Gains):
        raise Wrong(f" = {value!r}; it must be Gains(X, Y, Z), or a table with X, Y, Z{more}")
    return value


def _by_rod(value: Any) -> Gains | dict[str, Gains]:
    if not isinstance(value, Mapping) or set(value) <= {"X", "Y", "Z"}:
        return _one(value, ", or one by rod name")
    found = {}
    for name, entry in value.items():
        try:
            found[name] = _one(entry)
        except Wrong as wrong:
            raise Wrong(f".{name}{wrong}") from None
    return found


GainsOfRods = Annotated[Gains | Mapping[str, Gains], Kind(_by_rod)]  # of all rods, or by the rod's name


def gain_records(
    structure: Structure,
    translation: GainsOfRods,
    rotation: GainsOfRods,
    stiffness: ArrayLike | Mapping[str, ArrayLike] = 0.0,
) -> np.ndarray[Any, Any]:
    """Gains of every rod and point mass as records.

    Raises:
        OptionError: naming the rod and the matrix, unless [X Y; Yᵀ Z] is symmetric and positive definite, and K
            symmetric and positive semidefinite.
    """
    names = [rod.name for rod in structure.rods] + [point.node for point in structure.lone_masses]
    sizes = [rod.support.translation_basis.shape[1] for rod in structure.rods]
    sizes += [point.translation_basis.shape[1] for point in structure.lone_masses]
    rods = names[: len(structure.rods)]
    for what, given, known, kind in (
        ("translation", translation, names, "rod or point mass"),
        ("rotation", rotation, names, "rod or point mass"),
        ("stiffness K", stiffness, rods, "rod"),
    ):
        for name in given if isinstance(given, Mapping) else ():
            check_known(what, name, known, kind)
    records = np.zeros(len(names), GAINS)
    blocks = _blocks_of(records)
    for number, (name, n) in enumerate(zip(names, sizes, strict=True)):
        if n > 0:
            blocks[number, :3, :n, :n] = _checked(_of(translation, name, Gains()), n, "z", name)
        if number < len(rods):
            blocks[number, 3:6] = _checked(_of(rotation, name, Gains()), 3, "b", name)
            blocks[number, 6] = _stiffness(_of(stiffness, name, 0.0), name)
    return records


def _of(given: Any, name: str, default: Any) -> Any:
    return given.get(name, default) if isinstance(given, Mapping) else given


def _blocks_of(gains: np.ndarray[Any, Any]) -> Array:
    """(K, 7, 3, 3): a view of K records of gains, matrix by matrix in the order of `GAINS`."""
    return gains.view(float).reshape(-1, 7, 3, 3)


def _is_plain(value: Any) -> bool:
    return type(value) in (int, float) and abs(value) < 1e100


def _stiffness(value: Any, name: str) -> Array:
    """K (3, 3) of a rod, which is semidefinite; OptionError where not."""
    if _is_plain(value) and value >= 0:
        return float(value) * np.eye(3)
    K = _matrix(value, 3, f"K of '{name}'")
    check_definite(f"stiffness K of '{name}' (6.6)", K, semi=True)
    return K


def _checked(gains: Gains, n: int, block: str, name: str) -> Array:
    """X, Y, Z (3, n, n) of a block of a rod or point mass, of which [X Y; Yᵀ Z] is definite; OptionError where not."""
    numbers: tuple[Any, ...] = (gains.X, gains.Y, gains.Z)
    if all(map(_is_plain, numbers)):
        x, y, z = map(float, numbers)
        if x > 0 and z > 0 and x * z > (1 + 1e-12) * y * y:  # by more than round-off
            return np.asarray(np.multiply.outer((x, y, z), np.eye(n)))
    X, Y, Z = (_matrix(one, n, f"{key}{block} of '{name}'") for key, one in zip("XYZ", numbers, strict=True))
    where = f"gains of '{name}', block {block}"
    check_definite(f"{where}: X", X)
    check_definite(f"{where}: Z", Z)
    schur = X - Y @ np.linalg.solve(Z, Y.T)  # Lemma 2.2
    check_definite(
        f"{where}: X - Y Z⁻¹ Yᵀ (Schur complement of (5.6))",
        (schur + schur.T) / 2,
        remedy=": enlarge X or Z, or reduce Y",
    )
    return np.array([X, Y, Z])


def _matrix(value: ArrayLike, n: int, what: str) -> Array:
    matrix = real_array(f"gain {what}", value, (n, n))
    return matrix * np.eye(n) if np.ndim(value) == 0 else matrix


# Gains in world components, and where a block's three matrices are multiples of one, the scalars x, y, z > 0 (else 0).
WORLD_GAINS = np.dtype([*((name, GAINS[name]) for name in GAINS.names or ()), *SCALARS], align=True)


class Onto(enum.Enum):
    """Plane that the errors of b are projected onto."""

    CURRENT = "current"  # b⊥, orthogonal to the rod as it is: (6.3), (6.19)
    TARGET = "target"  # b_d⊥, orthogonal to the rod as it shall be: (6.20)


PLAIN, ONTO_CURRENT, ONTO_TARGET = 0, 1, 2  # the same in compiled code
PROJECTIONS = {None: PLAIN, Onto.CURRENT: ONTO_CURRENT, Onto.TARGET: ONTO_TARGET}


class Terms(NamedTuple):
    """V = V_error + V_velocity and V̇ = β - fᵀu at one state.

    Attributes:
        V_error: the terms in the errors alone.
        V_velocity: the terms with velocities.
        beta: V̇ without strings.
        f: (M,), the reduction of V̇ by each string's unit force density.
    """

    V_error: float
    V_velocity: float
    beta: float
    f: Array


# Structure, target, surroundings and options of the law, as compiled code reads them.
Known, pack_known = view_of(
    "QuadraticLaw",
    node_count="size",
    rods=(ROD, "rod_count"),
    points=(POINT, "point_count"),
    gains=(WORLD_GAINS, "member_count"),
    kind="size",  # PLAIN, ONTO_CURRENT or ONTO_TARGET
    segments=("i8", "segment_count", 2),
    ranges=("i8", "string_count", 2),
    target="size",  # address of an `Aim`: where it moves
    standing=("f8", "time_count", "member_count", 2, 3),  # and where it stands (`standing_targets`)
    gravity=("f8", 3),  # [m/s²]
    effects="size",  # address of what else acts, see `known_forces`; 0 for nothing
    bounds="size",  # what limits u, see `quadratic_law`
    floor=("f8", "string_count"),
    limits=("f8", 3, "string_count"),
    scratch="size",  # address of room, 0 where the stack has enough
    decay_rate="each",
    norm="real",
)


@inlined
def _quadratic(scalars: Any, X: Any, Y: Any, Z: Any, p: Any, p_rate: Any, rate: Any) -> tuple[float, float, float, Any]:
    """½ pᵀXp, pᵀYė + ½ ėᵀZė, γ, and c = Yᵀ p + Z ė of one block; `scalars` are X, Y, Z where Z's is not 0."""
    if any_of(scalars[2] != 0.0):
        Xp, Ye, Ze, Yp = times(scalars[0], p), times(scalars[1], rate), times(scalars[2], rate), times(scalars[1], p)
    else:
        Xp, Ye, Ze, Yp = apply(X, p), apply(Y, rate), apply(Z, rate), apply_transposed(Y, p)
    error, velocity = 0.5 * dot(p, Xp), dot(p, Ye) + 0.5 * dot(rate, Ze)
    return error, velocity, dot(p_rate, plus(Xp, Ye)), plus(Yp, Ze)


@inlined
def _project(a: Any, a_rate: Any, e: Any, rate: Any) -> tuple[Any, Any]:
    """p = P(a) e = e - a (aᵀe)/(aᵀa) of (2.10), and its rate, for any axis a ≠ 0 that moves."""
    square = dot(a, a)
    s = dot(a, e) / square
    s_rate = (dot(a_rate, e) + dot(a, rate) - 2.0 * s * dot(a, a_rate)) / square
    return minus(e, times(s, a)), minus(minus(rate, times(s_rate, a)), times(s, a_rate))


@inlined
def quadratic_terms(
    t: float, nodes: Any, velocities: Any, known: Any, influence: Any, pushed: Any, f: Any
) -> tuple[int, float, float, float]:
    """A status, both parts of V, β of (5.11) or (6.13), and f of (5.12) or (6.14) into (M,).

    Args:
        known: a `Known`.
        pushed: (2N, 3), written where there are `effects`: their forces on the nodes, behind them α (R, 4) of the rods.
        influence: (N, 3), written: Φ Aᵀ c, how each node's force enters V̇.
    """
    rods, points, gains, effects = known.rods, known.points, known.gains, known.effects
    status, V_error, V_velocity, beta = SOLVED, 0.0, 0.0, 0.0
    g, target = vector(known.gravity), Aim(known.target)
    still = standing_at(t, target)
    for n in range(len(nodes)):
        put(influence, n, ZERO)
    added = floats(0, (len(rods), 4))
    if effects != 0:
        added = floats(pushed.ctypes.data + 24 * len(nodes), (len(rods), 4))
        status = known_forces(effects, t, nodes, velocities, pushed, added)
    for a in range(len(rods)):
        rod, gain = rods[a], gains[a]
        first, first_rate = row_of(nodes, rod.i), row_of(velocities, rod.i)
        b = times(rod.per_length, minus(row_of(nodes, rod.j), first))
        b_rate = times(rod.per_length, minus(row_of(velocities, rod.j), first_rate))
        back = rod.sigma * rod.length
        if still >= 0:
            r_d, b_d = row_of(known.standing[still, a], 0), row_of(known.standing[still, a], 1)
            r_d_rate = r_d_acc = b_d_rate = b_d_acc = ZERO
        else:
            (r_d, r_d_rate, r_d_acc), (b_d, b_d_rate, b_d_acc) = rod_target(rod, t, target)
        e, rate = minus(b, b_d), minus(b_rate, b_d_rate)
        if known.kind == PLAIN:
            error, velocity, gamma, c_b = _quadratic(gain.scalars_b, gain.Xb, gain.Yb, gain.Zb, e, rate, rate)
        else:
            if known.kind == ONTO_CURRENT:
                p, p_rate = _project(b, b_rate, e, rate)
            else:
                p, p_rate = _project(b_d, b_d_rate, e, rate)
            error, velocity, gamma, c_b = _quadratic(gain.scalars_b, gain.Xb, gain.Yb, gain.Zb, p, p_rate, rate)
            Ke = apply(gain.Kb, e)
            error += 0.5 * dot(e, Ke)
            gamma += dot(Ke, rate)
        V_error += error
        V_velocity += velocity
        beta += gamma - dot(c_b, b_d_acc)
        c_z = ZERO
        if rod.nz > 0:
            e = minus(plus(first, times(back, b)), r_d)
            rate = minus(plus(first_rate, times(back, b_rate)), r_d_rate)
            error, velocity, gamma, c_z = _quadratic(gain.scalars_z, gain.Xz, gain.Yz, gain.Zz, e, rate, rate)
            V_error += error
            V_velocity += velocity
            beta += gamma - dot(c_z, r_d_acc)
        # cᵀ of the accelerations without strings, where A = M⁻¹ H is symmetric: aᵀ H = (A c)ᵀ. They are A g, weight
        # included, and what turning adds: -(‖ḃ‖/‖b‖)² b to b̈, and f times that to the forces on r. Added mass, which
        # acts across b, has no part in that; and A is as symmetric as α is, so that Aᵀ has α_12 and α_21 exchanged.
        if effects == 0:
            r_c, b_c = rod_accelerations(rod, b, 0.0, c_z, c_b)
        else:
            own = (added[a, 0], added[a, 2], added[a, 1], added[a, 3])
            r_c, b_c = wet_rod_accelerations(rod, b, 0.0, c_z, c_b, own)
        turning = dot(b_rate, b_rate) / dot(b, b)
        beta += rod.mass * dot(r_c, g) + rod.f * dot(b_c, g) + turning * (rod.f * dot(r_c, b) - dot(c_b, b))
        place_ends(rod, r_c, b_c, influence)
    for a in range(len(points)):
        point, gain = points[a], gains[len(rods) + a]
        if still >= 0:
            r_d = row_of(known.standing[still, len(rods) + a], 0)
            r_d_rate = r_d_acc = ZERO
        else:
            r_d, r_d_rate, r_d_acc = point_target(point, t, target)
        e, rate = minus(row_of(nodes, point.node), r_d), minus(row_of(velocities, point.node), r_d_rate)
        error, velocity, gamma, c_z = _quadratic(gain.scalars_z, gain.Xz, gain.Yz, gain.Zz, e, rate, rate)
        V_error += error
        V_velocity += velocity
        beta += gamma + dot(c_z, minus(g, r_d_acc))
        put(influence, point.node, times(1.0 / point.mass, c_z))
    if effects != 0:
        for n in range(len(nodes)):
            beta += dot(row_of(influence, n), row_of(pushed, n))
    segments, ranges = known.segments, known.ranges
    for m in range(len(ranges)):
        length, total = string_length(nodes, segments, ranges[m]), 0.0
        for p in range(ranges[m, 0], ranges[m, 1]):
            i, j = segments[p, 0], segments[p, 1]
            s = minus(row_of(nodes, j), row_of(nodes, i))
            total += share(length, s) * dot(minus(row_of(influence, j), row_of(influence, i)), s)
        f[m] = total
    return status, V_error, V_velocity, beta


def world_gains(gains: np.ndarray[Any, Any], members: list[Any]) -> np.ndarray[Any, Any]:
    """Turn gains to world components, as if b and r were free: E X Eᵀ for z = Eᵀ r, X and Z made symmetric."""
    found, blocks = np.zeros(len(gains), WORLD_GAINS), _blocks_of(gains)
    E = np.array([member["E"] for member in members]).reshape(-1, 1, 3, 3)  # columns beyond nz are zero
    sizes = np.array([[int(member["nz"])] * 3 + [3] * 3 for member in members]).reshape(-1, 6)
    # x, y, z of X = x 1, Y = y 1, Z = z 1 in their leading coordinates; else zeros.
    first = blocks[:, :6, 0, 0]
    ones = np.eye(3) * (np.arange(3) < sizes[:, :, None])[:, :, None]
    same = (first[:, :, None, None] * ones == blocks[:, :6]).all(axis=(2, 3)).reshape(-1, 2, 3).all(axis=2)
    found["scalars_z"], found["scalars_b"] = (first.reshape(-1, 2, 3) * same[:, :, None]).swapaxes(0, 1)
    world = blocks.copy()
    world[:, :3] = E @ blocks[:, :3] @ E.swapaxes(2, 3)
    even = 0.5 * (world + world.swapaxes(2, 3))
    for number, name in enumerate(GAINS.names or ()):
        found[name] = world[:, number] if name[0] == "Y" else even[:, number]
    return found
