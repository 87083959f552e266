"""What the laws of chapters 5 and 6 share: a quadratic V of the errors and their rates, and V̇ = -δ V by strings.

With e_z = z - z_d, e_b = b - b_d and their rates, V sums over the rods (5.19)

    ½ [e_zᵀ X e_z + 2 e_zᵀ Y ė_z + ė_zᵀ Z ė_z] + ½ [pᵀ X p + 2 pᵀ Y ė_b + ė_bᵀ Z ė_b] + ½ e_bᵀ K e_b,

where p = e_b in chapter 5, (5.4)-(5.5), and p = P(b) e_b or P(b_d) e_b in chapter 6, (6.3) and (6.20). Since ṗ depends
on positions and velocities only, V̇ = γ + cᵀ(q̈ - q̈_d) with γ = ṗᵀ(X p + Y ė_b) + e_bᵀ K ė_b and c = Yᵀ p + Z ė_b, and
likewise for z with p = e_z. That makes V̇ = β - fᵀu. The law asks for fᵀu = β + δ V, (5.15), with the smallest u
between thresholds and ceilings (Lemma 5.1). Targets may move: their velocities and accelerations are in ė and q̈_d.

Known forces belong to g of (5.10): weight, and where the law knows of water its loads, with the added mass in M.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import positive, real_array, state_of
from tensegrity_mj.controllers.allocation import feasibility_margin, least_norm, least_squares
from tensegrity_mj.controllers.gains import GAINS, Gains, gain_records
from tensegrity_mj.controllers.known_water import checked_water, described_water, packed_water, water_address
from tensegrity_mj.controllers.limits import StringLimits, write_ceilings
from tensegrity_mj.dynamics.kernels import rod_accelerations
from tensegrity_mj.dynamics.native.compiling import c_function
from tensegrity_mj.dynamics.native.law import NO_SOLUTION, SOLVED, NativeLaw, Report, check_made_for
from tensegrity_mj.dynamics.native.pointers import (
    LAW_SIGNATURE,
    STACK_LIMIT,
    address_of,
    floats,
    inlined,
    integers,
    records_reader,
    stack_doubles,
)
from tensegrity_mj.dynamics.native.vectors import ZERO, apply, apply_transposed, dot, minus, plus, row_of, times, vector
from tensegrity_mj.dynamics.native.water import PackedWater, added_masses, immerse
from tensegrity_mj.dynamics.records import POINT, ROD, StructureRecords
from tensegrity_mj.dynamics.target import (
    PackedTarget,
    point_target,
    read_target,
    rod_target,
    standing_at,
    standing_targets,
)
from tensegrity_mj.dynamics.wet_rods import wet_rod_accelerations
from tensegrity_mj.errors import InfeasibleError, OptionError
from tensegrity_mj.model.elements.water import Water
from tensegrity_mj.model.scene_checks import check_target
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.model.target import Target

SCALARS = [("scalars_z", "f8", (3,)), ("scalars_b", "f8", (3,))]
# Gains in world components, and where a block's three matrices are multiples of one, the scalars x, y, z > 0 (else 0).
WORLD_GAINS = np.dtype([*((name, GAINS[name]) for name in GAINS.names or ()), *SCALARS], align=True)
_read_rods, _read_points, _read_gains = records_reader(ROD), records_reader(POINT), records_reader(WORLD_GAINS)

# The report's places, as plain numbers for compiled code.
MARGIN, V_ALL, V_ERROR, V_VELOCITY = (
    int(Report.FEASIBILITY_MARGIN),
    int(Report.LYAPUNOV),
    int(Report.LYAPUNOV_ERROR),
    int(Report.LYAPUNOV_VELOCITY),
)

DISCONTINUOUS = (
    "the law that minimizes the {name} switches strings discontinuously, so an integrator's stages would see different "
    "laws: run it sampled (hold force density or hold rest length)"
)


class Onto(enum.Enum):
    """What the errors of b are projected onto."""

    CURRENT = "current"  # b⊥, orthogonal to the rod as it is: (6.3), (6.19)
    TARGET = "target"  # b_d⊥, orthogonal to the rod as it shall be: (6.20)


PLAIN, ONTO_CURRENT, ONTO_TARGET = 0, 1, 2  # the same in compiled code
UNBOUNDED, FIXED, OF_STATE = 0, 1, 2  # thresholds and ceilings: none at all, constant, or ceilings of the state
TABLE_SIZE = 17


class Terms(NamedTuple):
    """V = V_error + V_velocity and V̇ = β - fᵀu at one state.

    Attributes:
        V_error: the terms in the errors alone.
        V_velocity: the terms with velocities.
        beta: V̇ without strings.
        f: (M,), what each string's force density takes from V̇.
    """

    V_error: float
    V_velocity: float
    beta: float
    f: Array


@inlined
def _quadratic(scalars: Any, X: Any, Y: Any, Z: Any, p: Any, p_rate: Any, rate: Any) -> tuple[float, float, float, Any]:
    """½ pᵀXp, pᵀYė + ½ ėᵀZė, γ, and c = Yᵀ p + Z ė of one block; `scalars` are X, Y, Z where Z's is not 0."""
    if scalars[2] != 0.0:
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
    t: float,
    nodes: Any,
    velocities: Any,
    rods: Any,
    points: Any,
    gains: Any,
    kind: int,
    string_nodes: Any,
    target: Any,
    standing: Any,
    gravity: Any,
    water: int,
    wet: Any,
    influence: Any,
    f: Any,
) -> tuple[float, float, float]:
    """Both parts of V, β of (5.11) or (6.13), and f of (5.12) or (6.14) into (M,); weight and water are known forces.

    Args:
        gains: in world components, see `QuadraticForm.compiled`.
        target, standing: where it moves, and where it stands (`standing_targets`).
        water: address of a `PackedWater`'s table, 0 for none.
        wet: (N, 3), written where there is water: its forces on the nodes.
        influence: (N, 3), written: Φ Aᵀ c, how each node's force enters V̇.
    """
    V_error, V_velocity, beta = 0.0, 0.0, 0.0
    g, still = vector(gravity), standing_at(t, target)
    r_aim, b_aim = floats(stack_doubles(9), (3, 3)), floats(stack_doubles(9), (3, 3))
    for n in range(len(nodes)):
        for k in range(3):
            influence[n, k] = 0.0
    added = floats(0, (len(rods), 4))
    if water != 0:
        for n in range(len(nodes)):
            for k in range(3):
                wet[n, k] = 0.0
        immerse(water, t, nodes, velocities, wet)
        added = floats(added_masses(water), (len(rods), 4))
    for a in range(len(rods)):
        rod, gain = rods[a], gains[a]
        first, first_rate = row_of(nodes, rod.i), row_of(velocities, rod.i)
        b = times(rod.per_length, minus(row_of(nodes, rod.j), first))
        b_rate = times(rod.per_length, minus(row_of(velocities, rod.j), first_rate))
        back, ahead = rod.sigma * rod.length, (1.0 - rod.sigma) * rod.length
        if still >= 0:
            r_d, b_d = row_of(standing[still, a], 0), row_of(standing[still, a], 1)
            r_d_rate = r_d_acc = b_d_rate = b_d_acc = ZERO
        else:
            rod_target(rod, t, target, r_aim, b_aim)
            r_d, r_d_rate, r_d_acc = row_of(r_aim, 0), row_of(r_aim, 1), row_of(r_aim, 2)
            b_d, b_d_rate, b_d_acc = row_of(b_aim, 0), row_of(b_aim, 1), row_of(b_aim, 2)
        e, rate = minus(b, b_d), minus(b_rate, b_d_rate)
        if kind == PLAIN:
            error, velocity, gamma, c_b = _quadratic(gain.scalars_b, gain.Xb, gain.Yb, gain.Zb, e, rate, rate)
        else:
            if kind == ONTO_CURRENT:
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
        if water == 0:
            r_c, b_c = rod_accelerations(rod, b, 0.0, c_z, c_b)
        else:
            own = (added[a, 0], added[a, 2], added[a, 1], added[a, 3])
            r_c, b_c = wet_rod_accelerations(rod, b, 0.0, c_z, c_b, own)
        turning = dot(b_rate, b_rate) / dot(b, b)
        beta += rod.mass * dot(r_c, g) + rod.f * dot(b_c, g) + turning * (rod.f * dot(r_c, b) - dot(c_b, b))
        at_i, at_j = minus(r_c, times(back, b_c)), plus(r_c, times(ahead, b_c))
        for k in range(3):
            influence[rod.i, k], influence[rod.j, k] = at_i[k], at_j[k]
    for a in range(len(points)):
        point, gain = points[a], gains[len(rods) + a]
        if still >= 0:
            r_d = row_of(standing[still, len(rods) + a], 0)
            r_d_rate = r_d_acc = ZERO
        else:
            point_target(point, t, target, r_aim)
            r_d, r_d_rate, r_d_acc = row_of(r_aim, 0), row_of(r_aim, 1), row_of(r_aim, 2)
        e, rate = minus(row_of(nodes, point.node), r_d), minus(row_of(velocities, point.node), r_d_rate)
        error, velocity, gamma, c_z = _quadratic(gain.scalars_z, gain.Xz, gain.Yz, gain.Zz, e, rate, rate)
        V_error += error
        V_velocity += velocity
        beta += gamma + dot(c_z, minus(g, r_d_acc))
        at_i = times(1.0 / point.mass, c_z)
        for k in range(3):
            influence[point.node, k] = at_i[k]
    if water != 0:
        for n in range(len(nodes)):
            beta += dot(row_of(influence, n), row_of(wet, n))
    for m in range(len(string_nodes)):
        i, j = string_nodes[m, 0], string_nodes[m, 1]
        s = minus(row_of(nodes, j), row_of(nodes, i))
        f[m] = dot(minus(row_of(influence, j), row_of(influence, i)), s)
    return V_error, V_velocity, beta


@inlined
def _room(nodes: int, strings: int, water: int) -> int:
    return (6 if water != 0 else 3) * nodes + 2 * strings


@inlined
def _evaluate(
    t: float, nodes_at: int, velocities_at: int, table: Any, command_at: int, report_at: int, room: int
) -> int:
    """The law; `room` is the address of scratch, `_room` numbers."""
    count, size, kind, bounds = table[0], table[1], table[2], table[3]
    rods, points = _read_rods(table[4], table[5]), _read_points(table[6], table[7])
    gains = _read_gains(table[8], table[5] + table[7])
    string_nodes = integers(table[9], (size, 2))
    target = read_target(table[10])
    settings = floats(table[11], (5,))  # decay rate, norm, gravity
    limits = floats(table[13], (3, size))
    u, report = floats(command_at, (size,)), floats(report_at, (4,))
    nodes = floats(nodes_at, (count, 3))
    influence = floats(room, (count, 3))
    f, ceiling = floats(room + 24 * count, (size,)), floats(room + 24 * count + 8 * size, (size,))
    wet = floats(room + 24 * count + 16 * size if table[16] else 0, (count, 3))
    V_error, V_velocity, beta = quadratic_terms(
        t,
        nodes,
        floats(velocities_at, (count, 3)),
        rods,
        points,
        gains,
        kind,
        string_nodes,
        target,
        floats(table[14], (len(target.times), len(rods) + len(points), 2, 3)),
        floats(table[11] + 16, (3,)),
        table[16],
        wet,
        influence,
        f,
    )
    V = V_error + V_velocity
    alpha = beta + settings[0] * V
    if bounds == UNBOUNDED and settings[1] == 2.0:
        margin = least_squares(f, alpha, u)
    else:
        if bounds == OF_STATE:
            write_ceilings(nodes, string_nodes, limits, ceiling)
        else:
            for m in range(size):
                ceiling[m] = limits[0, m]
        margin = least_norm(f, alpha, floats(table[12], (size,)), ceiling, settings[1], u)
    report[MARGIN], report[V_ALL], report[V_ERROR], report[V_VELOCITY] = margin, V, V_error, V_velocity
    return SOLVED if margin > 0.0 else NO_SOLUTION


@c_function(LAW_SIGNATURE)
def _law(t, nodes_at, velocities_at, context, command_at, report_at):  # type: ignore[no-untyped-def]
    table = integers(context, (TABLE_SIZE,))
    room = table[15] if table[15] else stack_doubles(_room(table[0], table[1], table[16]))
    return _evaluate(t, nodes_at, velocities_at, table, command_at, report_at, room)


class QuadraticForm:
    """The checked options of a law, and its compiled form.

    Args:
        structure, target, decay_rate, norm, translation, rotation, gravity, water, respect_limits: as in the laws.
        minimum, maximum: ū and u_max [N/m], scalars or (M,).
        onto: what errors of b are projected onto; None for no projection.
        stiffness: K of (6.3), of every rod or by rod name.

    Raises:
        OptionError, SceneError: for gains that are not positive definite, δ <= 0, another norm, a bad target, a ceiling
            below its threshold.
    """

    def __init__(
        self,
        structure: Structure,
        target: Target | Array,
        decay_rate: float,
        norm: float,
        translation: Gains | Mapping[str, Gains],
        rotation: Gains | Mapping[str, Gains],
        minimum: ArrayLike,
        maximum: ArrayLike,
        respect_limits: bool,
        gravity: tuple[float, float, float],
        water: Water | None = None,
        onto: Onto | None = None,
        stiffness: ArrayLike | Mapping[str, ArrayLike] = 0.0,
    ) -> None:
        if target is None:
            raise OptionError("target = None: the law needs a target; give node positions (N, 3) or a Target")
        if not isinstance(structure, Structure):
            raise OptionError(f"structure = {structure!r}; use a Structure (scene.structure)")
        self.structure, self.onto = structure, onto
        self.target = target if isinstance(target, Target) else Target.set_point(target)
        check_target(structure, self.target)
        self.decay_rate = positive("decay_rate", decay_rate, "1/s")
        if isinstance(norm, bool) or not np.isscalar(norm) or norm not in (1, 2, math.inf):
            raise OptionError(f"norm = {norm!r}; allowed: 1, 2, math.inf")
        self.norm = float(norm)
        self.floor = np.array(real_array("minimum_force_density", minimum, (len(structure.strings),), "N/m"))
        if np.any(self.floor < 0):
            raise OptionError(f"minimum_force_density = {minimum!r}; every value must be >= 0 N/m")
        if not isinstance(respect_limits, (bool, np.bool_)):
            raise OptionError(f"respect_limits = {respect_limits!r}; allowed: True, False")
        self.limits = StringLimits.of(structure, maximum, bool(respect_limits))
        for string, low, high in zip(structure.strings, self.floor, self.limits.max_force_density, strict=True):
            if high < low:
                raise OptionError(
                    f"string '{string.name}': the law's minimum_force_density {low:g} N/m is above the largest force "
                    f"density {high:g} N/m that it may have; lower the one or raise the other"
                )
        x, y, z = (float(v) for v in real_array("gravity", gravity, (3,), "m/s²", scalar=False))
        self.gravity = (x, y, z)
        self.water = checked_water(structure, self.gravity, water)
        self.gains = gain_records(structure, translation, rotation, stiffness)

    @property
    def discontinuous(self) -> str:
        """Why the law cannot run continuously; empty for norm 2."""
        names = {1.0: "1-norm", math.inf: "∞-norm"}
        return DISCONTINUOUS.format(name=names[self.norm]) if self.norm in names else ""

    @property
    def _kind(self) -> int:
        return PLAIN if self.onto is None else ONTO_CURRENT if self.onto is Onto.CURRENT else ONTO_TARGET

    @cached_property
    def _packed(self) -> _Packed:
        return _Packed(self)

    @cached_property
    def _packed_water(self) -> PackedWater | None:
        return packed_water(self.structure, self.gravity, self.water)

    @cached_property
    def compiled(self) -> NativeLaw:
        """The compiled law."""
        return self._compile()

    def _compile(self) -> NativeLaw:
        own, packed = self.structure, self._packed
        string_nodes = np.array(own.string_nodes)
        settings = np.array([self.decay_rate, self.norm, *self.gravity], float)
        limited = bool(np.any(self.floor > 0)) or bool(np.any(np.isfinite(self.limits.max_force_density)))
        kind = OF_STATE if self.limits.of_state else FIXED if limited else UNBOUNDED
        rods, points = packed.records.rods, packed.records.points
        table = np.zeros(TABLE_SIZE, np.int64)
        table[:4] = len(own.nodes), len(own.strings), self._kind, kind
        table[4:8] = address_of(rods), len(rods), address_of(points), len(points)
        table[8:11] = address_of(packed.gains), address_of(string_nodes), packed.target.address
        table[11:14] = address_of(settings), address_of(self.floor), address_of(self.limits.packed)
        table[14] = address_of(packed.standing)
        # Scratch lies on the stack, which each thread has, or is the law's own where it is too large for that.
        water = packed_water(own, self.gravity, self.water)  # each compiled law has its own: it is written into
        table[16] = water_address(water)
        room = _room(len(own.nodes), len(own.strings), int(table[16]))
        scratch = np.empty(room if room > STACK_LIMIT else 0)
        table[15] = address_of(scratch) if len(scratch) else 0
        return NativeLaw(
            address=_law.address,
            context=address_of(table),
            keep=(self, packed, string_nodes, settings, table, scratch, water),
            discontinuous=self.discontinuous,
            gravity=self.gravity,
            water=self.water,
            decay_rate=self.decay_rate,
            stateless=len(scratch) == 0 and water is None,
        )

    def native(self, structure: Structure) -> NativeLaw:
        """The compiled law, for a plant with the same nodes and strings.

        Raises:
            OptionError: for any other.
        """
        check_made_for(self.structure, structure)
        return self.compiled if self.compiled.stateless else self._compile()

    def evaluate(self, time: float, nodes: Array, velocities: Array) -> tuple[Array, Array]:
        """u (M,) [N/m] and the report (see `law.Report`) at one state."""
        law = self.compiled
        time, nodes, velocities = state_of(time, nodes, velocities, len(self.structure.nodes))
        u, report = np.zeros(len(self.structure.strings)), np.full(len(Report), np.nan)
        places = (address_of(nodes), address_of(velocities), law.context, address_of(u), address_of(report))
        _law.ctypes(time, *places)
        return u, report

    def control(self, time: float, nodes: Array, velocities: Array) -> Array:
        """u (M,) [N/m] at one state.

        Raises:
            InfeasibleError: where no admissible u exists, with the margin.
        """
        u, report = self.evaluate(time, nodes, velocities)
        margin = report[Report.FEASIBILITY_MARGIN]
        if margin > 0:
            return u
        text = f"no admissible u at t = {time:.6g} s: feasibility margin max(v/α) = {margin:.3g} <= 0 (5.18)"
        if margin == -np.inf:
            low = int(np.argmin(self.limits.ceilings(nodes) - self.floor))
            text += f"; string '{self.structure.strings[low].name}' is too short to keep its minimum_force_density"
        else:
            terms = self.terms(time, nodes, velocities)
            alpha = terms.beta + self.decay_rate * (terms.V_error + terms.V_velocity)
            if feasibility_margin(terms.f, alpha, self.floor, np.full(len(u), np.inf)) > 0:
                text += "; without the ceilings of the strings there would be one"
        raise InfeasibleError(text)

    def terms(self, time: float, nodes: Array, velocities: Array) -> Terms:
        """The parts of V, and β and f of V̇ = β - fᵀu."""
        packed, count = self._packed, len(self.structure.nodes)
        f = np.empty(len(self.structure.strings))
        error, velocity, beta = quadratic_terms(
            *state_of(time, nodes, velocities, count),
            packed.records.rods,
            packed.records.points,
            packed.gains,
            self._kind,
            self.structure.string_nodes,
            packed.target.arrays,
            packed.standing,
            np.array(self.gravity),
            water_address(self._packed_water),
            np.empty((count, 3)),
            np.empty((count, 3)),
            f,
        )
        return Terms(error, velocity, beta, f)

    def target_equilibrium(self) -> dict[str, Any]:
        """Is the (last) target an equilibrium, as Theorem 5.1 assumes? Residual [N], u [N/m], self-stress modes."""
        from tensegrity_mj.model.rigidity import equilibrium_force_densities

        u, residual, modes = equilibrium_force_densities(self.structure, self.target.nodes[-1], self.gravity)
        return {"residual": float(residual), "force_densities": np.asarray(u).tolist(), "self_stress_modes": int(modes)}

    def describe(self) -> dict[str, Any]:
        """Plain values for the provenance of a run."""
        highest = self.limits.max_force_density
        return {
            "decay_rate": self.decay_rate,
            "norm": "inf" if self.norm == math.inf else int(self.norm),
            "minimum_force_density": self.floor.tolist(),
            "maximum_force_density": [u if math.isfinite(u) else None for u in highest.tolist()],
            "keeps_min_rest_length": self.limits.of_state,
            "target_equilibrium": self.target_equilibrium(),
            **described_water(self.water),
        }


class _Packed:
    """The arrays of a law that compiled code reads: records, target, gains.

    Attributes:
        gains: in world components, as if b and r were free: E X Eᵀ for z = Eᵀ r. V sees the symmetric parts of X and Z.
    """

    def __init__(self, form: QuadraticForm) -> None:
        self.records, self.target = StructureRecords.of(form.structure), PackedTarget(form.target)
        rods, points = self.records.rods, self.records.points
        self.standing = standing_targets(rods, points, self.target.arrays)
        self.gains = np.zeros(len(form.gains), WORLD_GAINS)
        for name in GAINS.names or ():
            self.gains[name] = form.gains[name]
        for gain, member in zip(self.gains, [*rods, *points], strict=True):
            gain["scalars_z"] = _scalars([gain[name] for name in ("Xz", "Yz", "Zz")], int(member["nz"]))
            gain["scalars_b"] = _scalars([gain[name] for name in ("Xb", "Yb", "Zb")], 3)
            E = member["E"]  # its columns beyond nz are zero
            for name in ("Xz", "Yz", "Zz"):
                gain[name] = E @ gain[name] @ E.T
            for name in ("Xz", "Zz", "Xb", "Zb", "Kb"):
                gain[name] = 0.5 * (gain[name] + gain[name].T)


def _scalars(matrices: list[Array], n: int) -> Array:
    """x, y, z of X = x 1, Y = y 1, Z = z 1 in their leading n coordinates; zeros where they are no such multiples."""
    found = np.array([matrix[0, 0] for matrix in matrices])
    same = all(np.array_equal(A[:n, :n], x * np.eye(n)) for A, x in zip(matrices, found, strict=True))
    return found if same else np.zeros(3)
