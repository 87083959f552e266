"""Feedback linearization with optimal allocation: chapter 4 of the thesis, for any class 1 structure.

The coordinates are minimal, q = (z, β) of every rod (§2.3): the point at σ along the directions E that its support
leaves it, and one angle in a plane or (θ, φ) in space. The law asks for

    ë = -K_p e - K_d ė,   e = q - q_d,   K_p = ω_o²,  K_d = 2 ζ ω_o,      (4.6)-(4.8)

which is linear in the force densities, A u = d (4.9), and takes of all that do so the u of least cost (4.10)-(4.13).
(In the printed (4.9) the sign of M⁻¹ g on the right is wrong.)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import real_array, state_of
from tensegrity_mj.controllers.known_water import checked_water, described_water, packed_water, water_address
from tensegrity_mj.controllers.optimal_allocation import Allocation, Allocator, Equation, Sum
from tensegrity_mj.dynamics.kernels import rod_accelerations
from tensegrity_mj.dynamics.native.compiling import njit
from tensegrity_mj.dynamics.native.law import Command, NativeLaw, Report, check_made_for, native_law
from tensegrity_mj.dynamics.native.pointers import floats
from tensegrity_mj.dynamics.native.vectors import vector
from tensegrity_mj.dynamics.native.water import added_masses, immerse
from tensegrity_mj.dynamics.records import StructureRecords
from tensegrity_mj.dynamics.target import PackedTarget, point_target, rod_target
from tensegrity_mj.dynamics.wet_rods import wet_rod_accelerations
from tensegrity_mj.errors import InfeasibleError, OptionError
from tensegrity_mj.model.elements.water import Water
from tensegrity_mj.model.scene_checks import check_target
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.model.target import Target

# Of K_p times a coordinate: what its error cannot be told from zero by. Strings can only pull, so that at a target that
# needs none of them, noise of the wrong sign would have no solution.
ROUND_OFF = 8 * float(np.finfo(float).eps)
LARGEST = 1e9  # of ω_o [rad/s] and ζ: gains beyond would leave nothing of the rest of an equation
POLE = 1e-6  # sin φ below which (θ, φ) do not tell where a rod points


@njit
def angles(rod: Any, b: Any, rate: Any, beta: Any, beta_rate: Any, P: Any, c: Any) -> bool:
    """β and β̇ of a direction b and its rate, and P (2, 3), c (2,) of β̈ = P b̈ + c; False at a pole.

    P = (WᵀW)⁻¹Wᵀ, c = -P Ẇβ̇ (§2.3). Planar rods have one angle, from the first of the plane's basis to the second.
    """
    if rod.nb == 2:
        x, y, x_rate, y_rate = 0.0, 0.0, 0.0, 0.0
        for k in range(3):
            x += rod.B[k, 0] * b[k]
            y += rod.B[k, 1] * b[k]
            x_rate += rod.B[k, 0] * rate[k]
            y_rate += rod.B[k, 1] * rate[k]
        square = x * x + y * y
        beta[0] = np.arctan2(y, x)
        beta_rate[0] = (x * y_rate - y * x_rate) / square
        for k in range(3):
            P[0, k] = (x * rod.B[k, 1] - y * rod.B[k, 0]) / square
        c[0] = -2.0 * beta_rate[0] * (x * x_rate + y * y_rate) / square
        return True
    across = np.sqrt(b[0] * b[0] + b[1] * b[1])
    length = np.sqrt(across * across + b[2] * b[2])
    sin, cos = across / length, b[2] / length
    if not sin > POLE:
        return False
    sin_theta, cos_theta = b[1] / across, b[0] / across
    beta[0], beta[1] = np.arctan2(b[1], b[0]), np.arctan2(across, b[2])
    P[0, 0], P[0, 1], P[0, 2] = -sin_theta / across, cos_theta / across, 0.0
    P[1, 0], P[1, 1], P[1, 2] = cos * cos_theta / length, cos * sin_theta / length, -sin / length
    for p in range(2):
        beta_rate[p] = P[p, 0] * rate[0] + P[p, 1] * rate[1] + P[p, 2] * rate[2]
    c[0] = -2.0 * cos / sin * beta_rate[0] * beta_rate[1]
    c[1] = sin * cos * beta_rate[0] * beta_rate[0]
    return True


@njit
def _accelerations(rod: Any, b: Any, c: float, t_r: Any, t_b: Any, added: Any, water: int) -> Any:
    return rod_accelerations(rod, b, c, t_r, t_b) if water == 0 else wet_rod_accelerations(rod, b, c, t_r, t_b, added)


@njit
def error_equation(
    t: float,
    nodes: Any,
    velocities: Any,
    rods: Any,
    points: Any,
    string_nodes: Any,
    target: Any,
    gravity: Any,
    water: int,
    gains: Any,
    A: Any,
    d: Any,
    e: Any,
) -> int:
    """(4.9) as A u = d, and the errors e (2, n) with their rates.

    Args:
        water: address of a `PackedWater`'s table, 0 for none.
        gains: (2, n): K_p and K_d.
        A, d, e: written; A (n, M).

    Returns:
        -1, or the number of a rod whose b, or whose target's b, is at a pole.
    """
    A[:] = 0.0
    count = len(rods)
    pull = np.zeros((count, 2, 5, 3))  # q̈ of each rod for a force on its first and on its second node
    owner = np.full((len(nodes), 2), -1)  # which rod (or point mass, from `count` on) a node is of, and which end
    start = np.empty(count + len(points), np.int64)
    work = np.empty((18, 3))
    r_aim, b_aim = work[:3], work[3:6]
    b, b_rate, r, r_rate, t_r, t_b = work[6], work[7], work[8], work[9], work[10], work[11]
    c, aim_c = work[12], work[13]
    beta, beta_rate, aim, aim_rate = work[14], work[15], work[16], work[17]
    P, aim_P = np.empty((2, 3)), np.empty((2, 3))
    wet, added = np.zeros((len(nodes), 3)), floats(0, (count, 4))
    if water != 0:
        immerse(water, t, nodes, velocities, wet)
        added = floats(added_masses(water), (count, 4))
    at = 0
    for a in range(count):
        rod = rods[a]
        start[a] = at
        owner[rod.i, 0], owner[rod.i, 1] = a, 0
        owner[rod.j, 0], owner[rod.j, 1] = a, 1
        square, rate2 = 0.0, 0.0
        for k in range(3):
            b[k] = (nodes[rod.j, k] - nodes[rod.i, k]) / rod.length
            b_rate[k] = (velocities[rod.j, k] - velocities[rod.i, k]) / rod.length
            r[k] = nodes[rod.i, k] + rod.sigma * rod.length * b[k]
            r_rate[k] = velocities[rod.i, k] + rod.sigma * rod.length * b_rate[k]
            square += b[k] * b[k]
            rate2 += b_rate[k] * b_rate[k]
            ahead, back = (1.0 - rod.sigma) * rod.length, rod.sigma * rod.length
            t_r[k] = rod.mass * gravity[k] + wet[rod.i, k] + wet[rod.j, k]
            t_b[k] = rod.f * gravity[k] + ahead * wet[rod.j, k] - back * wet[rod.i, k]
        rod_target(rod, t, target, r_aim, b_aim)
        if not angles(rod, b, b_rate, beta, beta_rate, P, c):
            return a
        if not angles(rod, b_aim[0], b_aim[1], aim, aim_rate, aim_P, aim_c):
            return a
        # q̈ without strings, M⁻¹ g, weight and water included.
        own = (0.0, 0.0, 0.0, 0.0)
        if water != 0:
            own = (added[a, 0], added[a, 1], added[a, 2], added[a, 3])
        r_acc, b_acc = _accelerations(rod, vector(b), rate2 / square, vector(t_r), vector(t_b), own, water)
        turns = rod.nb - 1
        for p in range(rod.nz + turns):
            i = at + p
            size = 0.0
            if p < rod.nz:
                e[0, i], e[1, i], d[i] = 0.0, 0.0, 0.0
                for k in range(3):
                    size += abs(rod.E[k, p]) * (abs(r[k]) + abs(r_aim[0, k]))
                    e[0, i] += rod.E[k, p] * (r[k] - r_aim[0, k])
                    e[1, i] += rod.E[k, p] * (r_rate[k] - r_aim[1, k])
                    d[i] += rod.E[k, p] * (r_aim[2, k] - r_acc[k])
            else:
                x = p - rod.nz
                for k in range(3):
                    size += abs(P[x, k]) + abs(aim_P[x, k])
                e[0, i] = beta[x] - aim[x]
                if x == 0:  # θ goes round
                    e[0, i] -= 2.0 * np.pi * np.round(e[0, i] / (2.0 * np.pi))
                e[1, i] = beta_rate[x] - aim_rate[x]
                d[i] = aim_c[x] - c[x]
                for k in range(3):
                    d[i] += aim_P[x, k] * b_aim[2, k] - P[x, k] * b_acc[k]
            d[i] -= gains[0, i] * e[0, i] + gains[1, i] * e[1, i]
            if abs(d[i]) <= ROUND_OFF * gains[0, i] * size:
                d[i] = 0.0
        for end in range(2):
            lever = rod.length * (end - rod.sigma)
            for axis in range(3):
                for k in range(3):
                    t_r[k] = 1.0 if k == axis else 0.0
                    t_b[k] = lever * t_r[k]
                r_acc, b_acc = _accelerations(rod, vector(b), 0.0, vector(t_r), vector(t_b), own, water)
                for p in range(rod.nz + turns):
                    for k in range(3):
                        if p < rod.nz:
                            pull[a, end, p, axis] += rod.E[k, p] * r_acc[k]
                        else:
                            pull[a, end, p, axis] += P[p - rod.nz, k] * b_acc[k]
        at += rod.nz + turns
    for a in range(len(points)):
        point = points[a]
        start[count + a] = at
        owner[point.node, 0] = count + a
        point_target(point, t, target, r_aim)
        for p in range(point.nz):
            i = at + p
            size = 0.0
            e[0, i], e[1, i], d[i] = 0.0, 0.0, 0.0
            for k in range(3):
                size += abs(point.E[k, p]) * (abs(nodes[point.node, k]) + abs(r_aim[0, k]))
                e[0, i] += point.E[k, p] * (nodes[point.node, k] - r_aim[0, k])
                e[1, i] += point.E[k, p] * (velocities[point.node, k] - r_aim[1, k])
                d[i] += point.E[k, p] * (r_aim[2, k] - gravity[k])
            d[i] -= gains[0, i] * e[0, i] + gains[1, i] * e[1, i]
            if abs(d[i]) <= ROUND_OFF * gains[0, i] * size:
                d[i] = 0.0
        at += point.nz
    for m in range(len(string_nodes)):
        for side in range(2):
            node, other = string_nodes[m, side], string_nodes[m, 1 - side]
            a = owner[node, 0]
            if a < 0:
                continue
            for k in range(3):
                s = nodes[other, k] - nodes[node, k]
                if a < count:
                    for p in range(rods[a].nz + rods[a].nb - 1):
                        A[start[a] + p, m] += pull[a, owner[node, 1], p, k] * s
                else:
                    point = points[a - count]
                    for p in range(point.nz):
                        A[start[a] + p, m] += point.E[k, p] * s / point.mass
    return -1


@dataclass(frozen=True, eq=False)
class FeedbackLinearization:
    """The law of chapter 4.

    Attributes:
        structure: what the law believes it controls (masses, supports, lengths).
        target: set-point, path or curve; an array (N, 3) counts as a set-point.
        natural_frequency: ω_o [rad/s] > 0, a number or one for each of `coordinates`.
        damping: ζ >= 0 of the error dynamics, likewise.
        allocation: of the force densities.
        gravity: g [m/s²] that the law knows of.
        water: what the law knows of it, waves and current included; None for nothing.
        report: after each call, see `Report`.

    Raises:
        OptionError, SceneError: for options that are out of range, or a bad target.
    """

    structure: Structure
    target: Target | Array
    natural_frequency: ArrayLike = 1.0
    damping: ArrayLike = 1.0
    allocation: Allocation = field(default_factory=Allocation)
    gravity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    water: Water | None = None

    command = Command.FORCE_DENSITY

    def __post_init__(self) -> None:
        if not isinstance(self.structure, Structure):
            raise OptionError(f"structure = {self.structure!r}; use a Structure (scene.structure)")
        if self.target is None:
            raise OptionError("target = None: feedback linearization needs one; give node positions (N, 3) or a Target")
        target = self.target if isinstance(self.target, Target) else Target.set_point(self.target)
        object.__setattr__(self, "target", target)
        check_target(self.structure, target)
        gravity = real_array("gravity", self.gravity, (3,), "m/s²", scalar=False)
        x, y, z = (float(x) for x in gravity)
        object.__setattr__(self, "gravity", (x, y, z))
        object.__setattr__(self, "water", checked_water(self.structure, (x, y, z), self.water))
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
        for point in self.structure.point_masses:
            found += [Equation(f"{axis} of node '{point.node}'", "m/s²") for axis in _axes(point.translation_basis)]
        return found

    @property
    def discontinuous(self) -> str:
        """Why the law cannot run continuously; "" where it can."""
        return self.allocation.discontinuous

    @property
    def report(self) -> Array:
        """Of the last call, see `Report`."""
        return self._own.report

    def native(self, structure: Structure) -> NativeLaw:
        """The law as engines call it, fresh for each run: no run begins where another ended."""
        check_made_for(self.structure, structure)
        law = native_law(_Evaluation(self), structure)
        return replace(law, gravity=self.gravity, water=self.water, stateless=False)

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
            **described_water(self.water),
        }


class _Evaluation:
    """The law in one run: what it keeps from call to call is where its searches start, and what it may hold."""

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
        self.gains = np.array([frequency**2, 2 * np.asarray(law.damping, float) * frequency])  # (4.8)
        self.records = StructureRecords.of(structure)
        self.target = PackedTarget(target)
        self.gravity = np.array(law.gravity, float)
        self.water = packed_water(structure, law.gravity, law.water)
        self.string_nodes = np.array(structure.string_nodes)
        self.structure, self.size = structure, (n, len(structure.strings))

    def equation(self, time: float, nodes: Array, velocities: Array) -> tuple[Array, Array, Array]:
        n, M = self.size
        A, d, e = np.empty((n, M)), np.empty(n), np.empty((2, n))
        rod = error_equation(
            float(time),
            np.ascontiguousarray(nodes, float),
            np.ascontiguousarray(velocities, float),
            self.records.rods,
            self.records.points,
            self.string_nodes,
            self.target.arrays,
            self.gravity,
            water_address(self.water),
            self.gains,
            A,
            d,
            e,
        )
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
    water: Water | None = None,
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
        pairs = [(chosen, minimum) for chosen, minimum in sums]
    except (TypeError, ValueError):
        raise OptionError(f'sums = {sums!r}; it must be a list of pairs [["name", ...] or "all", minimum]') from None
    rows = []
    for number, (chosen, minimum) in enumerate(pairs):
        if chosen != "all" and (isinstance(chosen, str) or not isinstance(chosen, Sequence)):
            raise OptionError(f'sums[{number}]: strings = {chosen!r}; it must be a list of names, or "all"')
        rows.append(Sum(minimum, None if chosen == "all" else tuple(chosen)))
    options = Allocation(sums=tuple(rows), **allocation)
    return FeedbackLinearization(structure, target, natural_frequency, damping, options, gravity, water)
