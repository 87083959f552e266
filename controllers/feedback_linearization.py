"""Feedback linearization with optimal allocation: chapter 4 of the thesis, for any class 1 structure.

The coordinates are minimal, q = (z, β) of every rod (§2.3): the point at σ along the directions E that its support
leaves it, and one angle in a plane or (θ, φ) in space. The law demands

    ë = -K_p e - K_d ė,   e = q - q_d,   K_p = ω_o²,  K_d = 2 ζ ω_o,      (4.6)-(4.8)

which is linear in the force densities, A u = d (4.9), and takes of all that do so the u of least cost (4.10)-(4.13).
(In the printed (4.9) the sign of M⁻¹ g on the right is wrong.)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import real_array, state_of
from tensegrity_mj.basics.hints import hints_of
from tensegrity_mj.controllers.known import KnownWater, ModelLaw, PackedEffects, described
from tensegrity_mj.controllers.optimal_allocation import Allocation, Allocator, Equation, Sum
from tensegrity_mj.controllers.table import NamedLaw
from tensegrity_mj.dynamics.kernels import rod_accelerations, wet_rod_accelerations
from tensegrity_mj.dynamics.native.compiling import njit
from tensegrity_mj.dynamics.native.elements import known_forces
from tensegrity_mj.dynamics.native.law import SOLVED, Command, NativeLaw, Report, check_made_for, native_law
from tensegrity_mj.dynamics.native.pointers import inlined
from tensegrity_mj.dynamics.native.strings import share, string_length
from tensegrity_mj.dynamics.native.vectors import ZERO, column_of, dot, minus, over, plus, row_of, times, vector
from tensegrity_mj.dynamics.records import StructureRecords
from tensegrity_mj.dynamics.target import Aim, pack_target, point_target, rod_target
from tensegrity_mj.errors import InfeasibleError, OptionError
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.model.target import Target

# Part of K_p times a coordinate: a smaller error counts as zero. Strings can only pull, so that at a target that
# needs none of them, noise of the wrong sign would have no solution.
ROUND_OFF = 8 * float(np.finfo(float).eps)
POLE = 1e-6  # sin φ below which (θ, φ) do not define where a rod points


class Angles(NamedTuple):
    """β of a rod with its rate, and P, c of β̈ = P b̈ + c, by angle; a planar rod uses the first.

    P = (WᵀW)⁻¹Wᵀ, c = -P Ẇβ̇ (§2.3); `defined` is False at a pole.
    """

    beta: Any
    rate: Any
    P: Any
    c: Any
    defined: bool


@njit
def angles(rod: Any, b: Any, b_rate: Any) -> Angles:
    """Compute the angles of a direction b and their rates; a planar rod has one, from basis vector 1 towards 2."""
    if rod.nb == 2:
        first, second = column_of(rod.B, 0), column_of(rod.B, 1)
        x, y, x_rate, y_rate = dot(first, b), dot(second, b), dot(first, b_rate), dot(second, b_rate)
        square = x * x + y * y
        rate = (x * y_rate - y * x_rate) / square
        P = over(minus(times(x, second), times(y, first)), square)
        c = -2.0 * rate * (x * x_rate + y * y_rate) / square
        return Angles((np.arctan2(y, x), 0.0), (rate, 0.0), (P, ZERO), (c, 0.0), True)
    across = np.sqrt(b[0] * b[0] + b[1] * b[1])
    length = np.sqrt(across * across + b[2] * b[2])
    sin, cos = across / length, b[2] / length
    if not sin > POLE:
        return Angles((0.0, 0.0), (0.0, 0.0), (ZERO, ZERO), (0.0, 0.0), False)
    sin_theta, cos_theta = b[1] / across, b[0] / across
    turn = (-sin_theta / across, cos_theta / across, 0.0)
    tilt = (cos * cos_theta / length, cos * sin_theta / length, -sin / length)
    theta_rate, phi_rate = dot(turn, b_rate), dot(tilt, b_rate)
    c = (-2.0 * cos / sin * theta_rate * phi_rate, sin * cos * theta_rate * theta_rate)
    beta = (np.arctan2(b[1], b[0]), np.arctan2(across, b[2]))
    return Angles(beta, (theta_rate, phi_rate), (turn, tilt), c, True)


@njit
def _accelerations(rod: Any, b: Any, c: float, t_r: Any, t_b: Any, added: Any, effects: int) -> Any:
    return rod_accelerations(rod, b, c, t_r, t_b) if effects == 0 else wet_rod_accelerations(rod, b, c, t_r, t_b, added)


class Known(NamedTuple):
    """Structure, target and surroundings as the law knows them, for compiled code.

    Attributes:
        rods, points: `StructureRecords`.
        segments, ranges: (S, 2) their nodes, and (M, 2) those of each string.
        target: address of an `Aim`.
        gravity: (3,) [m/s²].
        effects: address of what else acts, see `known_forces`; 0 for nothing.
        gains: (2, n): K_p and K_d.
    """

    rods: Any
    points: Any
    segments: Any
    ranges: Any
    target: int
    gravity: Any
    effects: int
    gains: Any


@inlined
def _size(E: Any, r: Any, aim: Any) -> float:
    """Σ |E_k| (|r_k| + |aim_k|): what Eᵀ(r - aim) is a difference of."""
    size = 0.0
    for k in range(3):
        size += abs(E[k]) * (abs(r[k]) + abs(aim[k]))
    return size


@inlined
def _set_error(i: int, error: float, rate: float, needed: float, size: float, gains: Any, e: Any, d: Any) -> None:
    """Write the error of a coordinate with its rate, and the q̈ that the strings must add."""
    e[0, i], e[1, i] = error, rate
    d[i] = needed - (gains[0, i] * error + gains[1, i] * rate)
    if abs(d[i]) <= ROUND_OFF * gains[0, i] * size:
        d[i] = 0.0


@njit
def error_equation(t: float, nodes: Any, velocities: Any, known: Known, A: Any, d: Any, e: Any) -> int:
    """(4.9) as A u = d, and the errors e (2, n) with their rates; A (n, M), d and e are written.

    Returns:
        -1, or the number of a rod whose b, or whose target's b, is at a pole; -2 where what is known of failed.
    """
    rods, points, target, gains = known.rods, known.points, Aim(known.target), known.gains
    gravity, effects, segments, ranges = known.gravity, known.effects, known.segments, known.ranges
    A[:] = 0.0
    count, g = len(rods), vector(gravity)
    pull = np.zeros((count, 2, 5, 3))  # q̈ of each rod for a force on its first and on its second node
    owner = np.full((len(nodes), 2), -1)  # which rod (or point mass, from `count` on) a node is of, and which end
    start = np.empty(count + len(points), np.int64)
    pushed, added = np.zeros((len(nodes), 3)), np.zeros((count, 4))
    if effects != 0 and known_forces(effects, t, nodes, velocities, pushed, added) != SOLVED:
        return -2
    at = 0
    for a in range(count):
        rod = rods[a]
        start[a] = at
        owner[rod.i, 0], owner[rod.i, 1] = a, 0
        owner[rod.j, 0], owner[rod.j, 1] = a, 1
        ahead, back = (1.0 - rod.sigma) * rod.length, rod.sigma * rod.length
        first, first_rate = row_of(nodes, rod.i), row_of(velocities, rod.i)
        b = over(minus(row_of(nodes, rod.j), first), rod.length)
        b_rate = over(minus(row_of(velocities, rod.j), first_rate), rod.length)
        r, r_rate = plus(first, times(back, b)), plus(first_rate, times(back, b_rate))
        push_i, push_j = row_of(pushed, rod.i), row_of(pushed, rod.j)
        t_r = plus(plus(times(rod.mass, g), push_i), push_j)
        t_b = minus(plus(times(rod.f, g), times(ahead, push_j)), times(back, push_i))
        r_aim, b_aim = rod_target(rod, t, target)
        now, aim = angles(rod, b, b_rate), angles(rod, b_aim[0], b_aim[1])
        if not (now.defined and aim.defined):
            return a
        # q̈ without strings, M⁻¹ g, weight and what is known of included.
        own = (0.0, 0.0, 0.0, 0.0)
        if effects != 0:
            own = (added[a, 0], added[a, 1], added[a, 2], added[a, 3])
        r_acc, b_acc = _accelerations(rod, b, dot(b_rate, b_rate) / dot(b, b), t_r, t_b, own, effects)
        for p in range(rod.nz):
            E, needed = column_of(rod.E, p), minus(r_aim[2], r_acc)
            error, rate = dot(E, minus(r, r_aim[0])), dot(E, minus(r_rate, r_aim[1]))
            _set_error(at + p, error, rate, dot(E, needed), _size(E, r, r_aim[0]), gains, e, d)
        for x in range(rod.nb - 1):
            error, rate = now.beta[x] - aim.beta[x], now.rate[x] - aim.rate[x]
            if x == 0:  # θ goes round
                error -= 2.0 * np.pi * np.round(error / (2.0 * np.pi))
            needed, size = aim.c[x] - now.c[x], 0.0
            for k in range(3):
                needed += aim.P[x][k] * b_aim[2][k] - now.P[x][k] * b_acc[k]
                size += abs(now.P[x][k]) + abs(aim.P[x][k])
            _set_error(at + rod.nz + x, error, rate, needed, size, gains, e, d)
        for end in range(2):
            lever = rod.length * (end - rod.sigma)
            for axis in range(3):
                unit = (1.0 if axis == 0 else 0.0, 1.0 if axis == 1 else 0.0, 1.0 if axis == 2 else 0.0)
                r_acc, b_acc = _accelerations(rod, b, 0.0, unit, times(lever, unit), own, effects)
                for p in range(rod.nz):
                    pull[a, end, p, axis] = dot(column_of(rod.E, p), r_acc)
                for x in range(rod.nb - 1):
                    pull[a, end, rod.nz + x, axis] = dot(now.P[x], b_acc)
        at += rod.nz + rod.nb - 1
    for a in range(len(points)):
        point = points[a]
        start[count + a] = at
        owner[point.node, 0] = count + a
        aim, aim_rate, aim_acc = point_target(point, t, target)
        r, r_rate = row_of(nodes, point.node), row_of(velocities, point.node)
        needed = minus(minus(aim_acc, g), over(row_of(pushed, point.node), point.mass))
        for p in range(point.nz):
            E = column_of(point.E, p)
            error, rate = dot(E, minus(r, aim)), dot(E, minus(r_rate, aim_rate))
            _set_error(at + p, error, rate, dot(E, needed), _size(E, r, aim), gains, e, d)
        at += point.nz
    for m in range(len(ranges)):
        length = string_length(nodes, segments, ranges[m])
        for s in range(ranges[m, 0], ranges[m, 1]):
            span = minus(row_of(nodes, segments[s, 1]), row_of(nodes, segments[s, 0]))
            span = times(share(length, span), span)
            for side in range(2):
                node, sign = segments[s, side], 1.0 - 2.0 * side
                a = owner[node, 0]
                if a < 0:
                    continue
                for k in range(3):
                    if a < count:
                        for p in range(rods[a].nz + rods[a].nb - 1):
                            A[start[a] + p, m] += sign * pull[a, owner[node, 1], p, k] * span[k]
                    else:
                        point = points[a - count]
                        for p in range(point.nz):
                            A[start[a] + p, m] += sign * point.E[k, p] * span[k] / point.mass
    return -1


LARGEST = 1e9  # of ω_o [rad/s] and ζ: gains beyond would leave nothing of the rest of an equation


@dataclass(frozen=True, eq=False)
class FeedbackLinearization(ModelLaw):
    """The law of chapter 4.

    Attributes:
        ...: those of `ModelLaw`, such as its structure and its target.
        natural_frequency: ω_o [rad/s] > 0, a number or one for each of `coordinates`.
        damping: ζ >= 0 of the error dynamics, likewise.
        allocation: objective and constraints of the force densities.
        report: after each call, see `Report`.

    Raises:
        OptionError, SceneError: for options that are out of range, or a bad target.
    """

    natural_frequency: ArrayLike = 1.0
    damping: ArrayLike = 1.0
    allocation: Allocation = field(default_factory=Allocation)

    arrays = "tensegrity_mj.engines.jax.thesis_laws:linearizing_law"

    def __post_init__(self) -> None:
        super().__post_init__()
        frequency = real_array("natural_frequency", self.natural_frequency, (len(self.coordinates),), "rad/s")
        damping = real_array("damping", self.damping, (len(self.coordinates),))
        if not np.all((frequency > 0) & (frequency <= LARGEST)):
            raise OptionError(
                f"natural_frequency = {self.natural_frequency!r}; every value must be > 0 and <= {LARGEST:g} rad/s"
            )
        if not np.all((damping >= 0) & (damping <= LARGEST)):
            raise OptionError(f"damping = {self.damping!r}; every value must be >= 0 and <= {LARGEST:g}")
        Allocator(self.allocation, self.structure, self.coordinates)

    @cached_property
    def coordinates(self) -> list[Equation]:
        """q, in its order: every rod's z and angles, then every point mass' z; with the units of q̈."""
        found = []
        for rod in self.structure.rods:
            found += [Equation(f"{axis} of rod '{rod.name}'", "m/s²") for axis in _axes(rod.support.translation_basis)]
            planar = rod.support.plane is not None
            found += [Equation(f"{angle} of rod '{rod.name}'", "rad/s²") for angle in ("θ" if planar else "θφ")]
        for point in self.structure.lone_masses:
            found += [Equation(f"{axis} of node '{point.node}'", "m/s²") for axis in _axes(point.translation_basis)]
        return found

    @property
    def allocator(self) -> Allocator:
        """Solver for the force densities, with checked options."""
        return self._own.allocator

    @property
    def discontinuous(self) -> str:
        """Reason why the law cannot run continuously; "" where it can."""
        return self.allocation.discontinuous

    @property
    def report(self) -> Array:
        """Report (5,) of the last call, see `Report`."""
        return self._own.report

    def native(self, structure: Structure) -> NativeLaw:
        """The law as engines call it, fresh for each run: no run begins where another ended."""
        check_made_for(self.structure, structure)
        law = native_law(_Evaluation(self), structure)
        return replace(law, gravity=self.gravity, known=tuple(self.known), stateless=False)

    def __call__(self, time: float, nodes: Array, velocities: Array) -> Array:
        """u (M,) [N/m] at one state.

        Raises:
            InfeasibleError: where no admissible u exists, with the constraint at fault; or where a rod's angles are
                singular.
        """
        time, nodes, velocities = state_of(time, nodes, velocities, len(self.structure.nodes))
        try:
            return self._own(time, nodes, velocities)
        except InfeasibleError as error:
            raise InfeasibleError(f"t = {time:.6g} s: {error}") from None

    def error(self, time: float, nodes: Array, velocities: Array) -> tuple[Array, Array]:
        """e and ė (n,) of (4.6) at one state, in the order of `coordinates`."""
        _, _, e = self.equation(time, nodes, velocities)
        return e[0], e[1]

    def equation(self, time: float, nodes: Array, velocities: Array) -> tuple[Array, Array, Array]:
        """A (n, M), d (n,) of (4.9) as A u = d, and (e, ė) (2, n) at one state.

        Raises:
            InfeasibleError: where a rod in space points along z, so that its θ is singular.
        """
        return self._own.equation(*state_of(time, nodes, velocities, len(self.structure.nodes)))

    @cached_property
    def _own(self) -> _Evaluation:
        return _Evaluation(self)

    def describe(self) -> dict[str, Any]:
        """Plain values for the provenance of a run."""
        return {
            "law": "feedback_linearization",
            "natural_frequency": np.asarray(self.natural_frequency, float).tolist(),
            "damping": np.asarray(self.damping, float).tolist(),
            "allocation": self.allocation.describe(self.structure),
            **described(self.known),
        }


class _Evaluation:
    """The law in one run; between calls it keeps the start of its searches, and the u that it may hold."""

    command = Command.FORCE_DENSITY

    def __init__(self, law: FeedbackLinearization) -> None:
        structure, target = law.structure, law.target
        assert isinstance(target, Target)
        self.discontinuous = law.discontinuous
        self.describe: Callable[[], dict[str, Any]] = law.describe
        self.report = np.full(len(Report), np.nan)
        self.allocator = Allocator(law.allocation, structure, law.coordinates)
        n = len(law.coordinates)
        frequency = np.broadcast_to(np.asarray(law.natural_frequency, float), (n,))
        gains = np.array([frequency**2, 2 * np.asarray(law.damping, float) * frequency])  # (4.8)
        records = StructureRecords.of(structure)
        self.effects, self.target = PackedEffects(law.model), pack_target(target)
        self.known = Known(
            records.rods,
            records.points,
            np.array(structure.paths.nodes),
            np.array(structure.paths.ranges),
            self.target.address,
            np.array(law.gravity, float),
            self.effects.address,
            gains,
        )
        self.structure, self.size = structure, (n, len(structure.strings))

    def equation(self, time: float, nodes: Array, velocities: Array) -> tuple[Array, Array, Array]:
        n, M = self.size
        A, d, e = np.empty((n, M)), np.empty(n), np.empty((2, n))
        rod = error_equation(
            float(time),
            np.ascontiguousarray(nodes, float),
            np.ascontiguousarray(velocities, float),
            self.known,
            A,
            d,
            e,
        )
        if rod < -1:
            raise self.effects.failure.pop()
        if rod >= 0:
            raise InfeasibleError(
                f"rod '{self.structure.rods[rod].name}', or its target, points along z: its angle θ is singular "
                "there; keep φ away from 0 and π, or choose a law in non-minimal coordinates"
            )
        return A, d, e

    def __call__(self, time: float, nodes: Array, velocities: Array) -> Array:
        self.report[:] = np.nan
        A, d, _ = self.equation(time, nodes, velocities)
        u, violation = self.allocator.solve(A, d, nodes)
        self.report[Report.ALLOCATION_RESIDUAL] = violation
        return u


def _axes(basis: Array) -> list[str]:
    """Names of the columns of E: the world's axes where they are such."""
    names = []
    for number, column in enumerate(basis.T):
        along = [axis for axis, unit in zip("xyz", np.eye(3), strict=True) if np.array_equal(column, unit)]
        names.append(along[0] if along else f"z{number + 1}")
    return names


def from_options(
    structure: Structure,
    target: Target | Array,
    *,
    gravity: tuple[float, float, float] = (0.0, 0.0, 0.0),
    known: Sequence[Any] = (),
    natural_frequency: ArrayLike = 1.0,
    damping: ArrayLike = 1.0,
    sums: Sequence[Sequence[Any]] = (),
    **allocation: Any,
) -> FeedbackLinearization:
    """The law from options as a scene file holds them: `sums` as pairs [names or "all", minimum].

    Raises:
        OptionError, SceneError: as the law, and for sums of another form.
    """
    try:
        pairs = [(None if chosen == "all" else chosen, minimum) for chosen, minimum in sums]
    except (TypeError, ValueError):
        raise OptionError(f'sums = {sums!r}; it must be a list of pairs [["name", ...] or "all", minimum]') from None
    rows = []
    for number, (chosen, minimum) in enumerate(pairs):
        try:
            rows.append(Sum(minimum, chosen))
        except OptionError as error:
            raise OptionError(f"sums[{number}]: {error}") from None
    options = Allocation(sums=tuple(rows), **allocation)
    return FeedbackLinearization(structure, target, natural_frequency, damping, options, gravity=gravity, known=known)


LAW = NamedLaw(from_options, {**hints_of(Allocation), "water": KnownWater})
