"""What the laws of chapters 5 and 6 share: a quadratic V of the errors and their rates, and V̇ = -δ V by strings.

With e_z = z - z_d, e_b = b - b_d and their rates, V sums over the rods (5.19)

    ½ [e_zᵀ X e_z + 2 e_zᵀ Y ė_z + ė_zᵀ Z ė_z] + ½ [pᵀ X p + 2 pᵀ Y ė_b + ė_bᵀ Z ė_b] + ½ e_bᵀ K e_b,

where p = e_b in chapter 5, (5.4)-(5.5), and p = P(b) e_b or P(b_d) e_b in chapter 6, (6.3) and (6.20). Since ṗ depends
on positions and velocities only, V̇ = γ + cᵀ(q̈ - q̈_d) with γ = ṗᵀ(X p + Y ė_b) + e_bᵀ K ė_b and c = Yᵀ p + Z ė_b, and
likewise for z with p = e_z. That makes V̇ = β - fᵀu. The law asks for fᵀu = β + δ V, (5.15), with the smallest u
between thresholds and ceilings (Lemma 5.1). Targets may move: their velocities and accelerations are in ė and q̈_d.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping
from functools import cached_property
from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray

from tensegrity_mj.checks import positive, real_array, state_of
from tensegrity_mj.controllers.allocation import feasibility_margin, least_norm
from tensegrity_mj.controllers.gains import GAINS, Gains, gain_records
from tensegrity_mj.controllers.limits import StringLimits, write_ceilings
from tensegrity_mj.dynamics.kernels import rod_accelerations
from tensegrity_mj.dynamics.records import POINT, ROD, StructureRecords
from tensegrity_mj.dynamics.target import PackedTarget, point_target, read_target, rod_target
from tensegrity_mj.errors import InfeasibleError, OptionError
from tensegrity_mj.law import NO_SOLUTION, SOLVED, NativeLaw, Report
from tensegrity_mj.native.pointers import LAW_SIGNATURE, address_of, floats, integers, records_reader
from tensegrity_mj.scene import Target
from tensegrity_mj.structure import Structure
from tensegrity_mj.validation import check_target

Array = NDArray[np.float64]
njit = numba.njit(cache=True, error_model="numpy")

_read_rods, _read_points, _read_gains = records_reader(ROD), records_reader(POINT), records_reader(GAINS)

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


@njit
def _quadratic(X: Any, Y: Any, Z: Any, n: int, p: Any, p_rate: Any, rate: Any, c: Any) -> tuple[float, float, float]:
    """½ pᵀXp, pᵀYė + ½ ėᵀZė, γ, and c = Yᵀ p + Z ė of one block of size n."""
    error, velocity, gamma = 0.0, 0.0, 0.0
    for i in range(n):
        x, y, z, c[i] = 0.0, 0.0, 0.0, 0.0
        for j in range(n):
            x += X[i, j] * p[j]
            y += Y[i, j] * rate[j]
            z += Z[i, j] * rate[j]
            c[i] += Z[j, i] * rate[j] + Y[j, i] * p[j]
        error += 0.5 * p[i] * x
        velocity += p[i] * y + 0.5 * rate[i] * z
        gamma += p_rate[i] * (x + y)
    return error, velocity, gamma


@njit
def _project(axis: Any, axis_rate: Any, e: Any, rate: Any, p: Any, p_rate: Any) -> None:
    """p = P(a) e = e - a (aᵀe)/(aᵀa) of (2.10), and its rate, for any axis a ≠ 0 that moves."""
    square, turning, along, along_rate = 0.0, 0.0, 0.0, 0.0
    for k in range(3):
        square += axis[k] * axis[k]
        turning += axis[k] * axis_rate[k]
        along += axis[k] * e[k]
        along_rate += axis_rate[k] * e[k] + axis[k] * rate[k]
    s = along / square
    s_rate = (along_rate - 2.0 * s * turning) / square
    for k in range(3):
        p[k] = e[k] - s * axis[k]
        p_rate[k] = rate[k] - s_rate * axis[k] - s * axis_rate[k]


@njit
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
    gravity: Any,
    f: Any,
) -> tuple[float, float, float]:
    """Both parts of V, β of (5.11) or (6.13), and f of (5.12) or (6.14) into (M,); weight counts as a known force."""
    V_error, V_velocity, beta = 0.0, 0.0, 0.0
    influence = np.zeros(nodes.shape)  # Φ A c: how each node's force enters V̇
    work = np.empty((25, 3))  # one allocation: this is called at every stage
    scratch, r_aim, b_aim = work[:4], work[4:7], work[7:10]
    b, b_rate, r, r_rate, e, rate = work[10], work[11], work[12], work[13], work[14], work[15]
    c, c_z, c_b, t_r, t_b, r_acc, b_acc = work[16], work[17], work[18], work[19], work[20], work[21], work[22]
    p, p_rate = work[23], work[24]
    for a in range(len(rods)):
        rod, gain = rods[a], gains[a]
        square, rate2 = 0.0, 0.0
        for k in range(3):
            b[k] = (nodes[rod.j, k] - nodes[rod.i, k]) / rod.length
            b_rate[k] = (velocities[rod.j, k] - velocities[rod.i, k]) / rod.length
            r[k] = nodes[rod.i, k] + rod.sigma * rod.length * b[k]
            r_rate[k] = velocities[rod.i, k] + rod.sigma * rod.length * b_rate[k]
            square += b[k] * b[k]
            rate2 += b_rate[k] * b_rate[k]
        rod_target(rod, t, target, r_aim, b_aim)
        # Accelerations without strings: M⁻¹ g, weight included.
        for k in range(3):
            t_r[k], t_b[k] = rod.mass * gravity[k], rod.f * gravity[k]
        rod_accelerations(rod, b, rate2 / square, t_r, t_b, r_acc, b_acc, scratch)
        for k in range(3):
            e[k], rate[k] = b[k] - b_aim[0, k], b_rate[k] - b_aim[1, k]
        if kind == PLAIN:
            error, velocity, gamma = _quadratic(gain.Xb, gain.Yb, gain.Zb, 3, e, rate, rate, c_b)
        else:
            if kind == ONTO_CURRENT:
                _project(b, b_rate, e, rate, p, p_rate)
            else:
                _project(b_aim[0], b_aim[1], e, rate, p, p_rate)
            error, velocity, gamma = _quadratic(gain.Xb, gain.Yb, gain.Zb, 3, p, p_rate, rate, c_b)
            for i in range(3):
                for j in range(3):
                    error += 0.5 * e[i] * gain.Kb[i, j] * e[j]
                    gamma += e[i] * gain.Kb[i, j] * rate[j]
        V_error += error
        V_velocity += velocity
        beta += gamma
        for k in range(3):
            beta += c_b[k] * (b_acc[k] - b_aim[2, k])
            c_z[k] = 0.0
        for i in range(rod.nz):
            e[i], rate[i] = 0.0, 0.0
            for k in range(3):
                e[i] += rod.E[k, i] * (r[k] - r_aim[0, k])
                rate[i] += rod.E[k, i] * (r_rate[k] - r_aim[1, k])
        if rod.nz > 0:
            error, velocity, gamma = _quadratic(gain.Xz, gain.Yz, gain.Zz, rod.nz, e, rate, rate, c)
            V_error += error
            V_velocity += velocity
            beta += gamma
            for k in range(3):
                for i in range(rod.nz):
                    c_z[k] += rod.E[k, i] * c[i]
                beta += c_z[k] * (r_acc[k] - r_aim[2, k])
        # aᵀ H = (A c)ᵀ, A = M⁻¹ H being symmetric.
        rod_accelerations(rod, b, 0.0, c_z, c_b, r_acc, b_acc, scratch)
        for k in range(3):
            influence[rod.i, k] = r_acc[k] - rod.sigma * rod.length * b_acc[k]
            influence[rod.j, k] = r_acc[k] + (1.0 - rod.sigma) * rod.length * b_acc[k]
    for a in range(len(points)):
        point, gain = points[a], gains[len(rods) + a]
        point_target(point, t, target, r_aim)
        for i in range(point.nz):
            e[i], rate[i] = 0.0, 0.0
            for k in range(3):
                e[i] += point.E[k, i] * (nodes[point.node, k] - r_aim[0, k])
                rate[i] += point.E[k, i] * (velocities[point.node, k] - r_aim[1, k])
        error, velocity, gamma = _quadratic(gain.Xz, gain.Yz, gain.Zz, point.nz, e, rate, rate, c)
        V_error += error
        V_velocity += velocity
        beta += gamma
        for i in range(point.nz):
            for k in range(3):
                beta += c[i] * point.E[k, i] * (gravity[k] - r_aim[2, k])
                influence[point.node, k] += point.E[k, i] * c[i] / point.mass
    for m in range(len(string_nodes)):
        i, j = string_nodes[m, 0], string_nodes[m, 1]
        f[m] = 0.0
        for k in range(3):
            f[m] += (influence[j, k] - influence[i, k]) * (nodes[j, k] - nodes[i, k])
    return V_error, V_velocity, beta


@numba.cfunc(LAW_SIGNATURE, cache=True, error_model="numpy")
def _law(t, nodes_at, velocities_at, context, command_at, report_at):  # type: ignore[no-untyped-def]
    table = integers(context, (16,))
    count, size, kind, of_state = table[0], table[1], table[2], table[3]
    rods, points = _read_rods(table[4], table[5]), _read_points(table[6], table[7])
    gains = _read_gains(table[8], table[5] + table[7])
    string_nodes = integers(table[9], (size, 2))
    settings = floats(table[11], (5,))  # decay rate, norm, gravity
    limits = floats(table[13], (3, size))
    u, report = floats(command_at, (size,)), floats(report_at, (4,))
    nodes = floats(nodes_at, (count, 3))
    f = np.empty(size)
    V_error, V_velocity, beta = quadratic_terms(
        t,
        nodes,
        floats(velocities_at, (count, 3)),
        rods,
        points,
        gains,
        kind,
        string_nodes,
        read_target(table[10]),
        settings[2:],
        f,
    )
    V = V_error + V_velocity
    ceiling = limits[0]
    if of_state:
        ceiling = np.empty(size)
        write_ceilings(nodes, string_nodes, limits, ceiling)
    margin = least_norm(f, beta + settings[0] * V, floats(table[12], (size,)), ceiling, settings[1], u)
    report[MARGIN], report[V_ALL], report[V_ERROR], report[V_VELOCITY] = margin, V, V_error, V_velocity
    return SOLVED if margin > 0.0 else NO_SOLUTION


class QuadraticForm:
    """The checked options of a law, and its compiled form.

    Args:
        structure, target, decay_rate, norm, translation, rotation, gravity, respect_limits: as in the laws.
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
    def compiled(self) -> NativeLaw:
        """The compiled law."""
        own = self.structure
        records, packed = StructureRecords.of(own), PackedTarget(self.target)
        string_nodes = np.array(own.string_nodes)
        settings = np.array([self.decay_rate, self.norm, *self.gravity], float)
        table = np.zeros(16, np.int64)
        table[:4] = len(own.nodes), len(own.strings), self._kind, self.limits.of_state
        table[4:8] = address_of(records.rods), len(records.rods), address_of(records.points), len(records.points)
        table[8:11] = address_of(self.gains), address_of(string_nodes), packed.address
        table[11:14] = address_of(settings), address_of(self.floor), address_of(self.limits.packed)
        return NativeLaw(
            address=_law.address,
            context=address_of(table),
            keep=(self, records, packed, string_nodes, settings, table),
            discontinuous=self.discontinuous,
            gravity=self.gravity,
            decay_rate=self.decay_rate,
        )

    def native(self, structure: Structure) -> NativeLaw:
        """The compiled law, for a plant with the same nodes and strings.

        Raises:
            OptionError: for any other.
        """
        own = self.structure
        if (len(own.nodes), own.string_nodes.tolist()) != (len(structure.nodes), structure.string_nodes.tolist()):
            raise OptionError(
                f"the law was made for '{own.name}' with {len(own.nodes)} nodes and {len(own.strings)} strings; "
                f"'{structure.name}' has other nodes or strings"
            )
        return self.compiled

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
        records = StructureRecords.of(self.structure)
        f = np.empty(len(self.structure.strings))
        error, velocity, beta = quadratic_terms(
            *state_of(time, nodes, velocities, len(self.structure.nodes)),
            records.rods,
            records.points,
            self.gains,
            self._kind,
            self.structure.string_nodes,
            PackedTarget(self.target).arrays,
            np.array(self.gravity),
            f,
        )
        return Terms(error, velocity, beta, f)

    def target_equilibrium(self) -> dict[str, Any]:
        """Is the (last) target an equilibrium, as Theorem 5.1 assumes? Residual [N], u [N/m], self-stress modes."""
        from tensegrity_mj.prestress import equilibrium_force_densities

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
        }
