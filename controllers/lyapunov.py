"""Lyapunov control of non-minimal realizations: chapter 5 of the thesis, for any number of rods.

V is quadratic in the errors of z and b and their rates, (5.3)-(5.5), summed over the rods (5.19). With
V̇ = β - fᵀu, the law asks for V̇ = -δ V, that is fᵀu = β + δ V, (5.15), with the u >= ū of smallest norm (Lemma 5.1).
A moving target (path following, §5.2) adds its velocity and acceleration to the errors.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray

from tensegrity_mj.checks import positive, real_array
from tensegrity_mj.controllers.allocation import least_norm
from tensegrity_mj.dynamics.kernels import rod_accelerations
from tensegrity_mj.dynamics.records import POINT, ROD, StructureRecords
from tensegrity_mj.dynamics.target import PackedTarget, point_target, read_target, rod_target
from tensegrity_mj.errors import InfeasibleError, OptionError
from tensegrity_mj.law import NO_SOLUTION, SOLVED, Command, NativeLaw
from tensegrity_mj.native.pointers import LAW_SIGNATURE, address_of, floats, integers, records_reader
from tensegrity_mj.scene import Target
from tensegrity_mj.structure import Structure
from tensegrity_mj.validation import check_target

Array = NDArray[np.float64]
njit = numba.njit(cache=True, error_model="numpy")

GAINS = np.dtype([(name, "f8", (3, 3)) for name in ("Xz", "Yz", "Zz", "Xb", "Yb", "Zb")], align=True)
_read_rods, _read_points, _read_gains = records_reader(ROD), records_reader(POINT), records_reader(GAINS)

DISCONTINUOUS = (
    "the law that minimizes the {name} switches strings discontinuously, so an integrator's stages would see different "
    "laws: run it sampled (hold force density or hold rest length)"
)


@dataclass(frozen=True)
class Gains:
    """X, Y, Z of (5.4) or (5.5): scalars or symmetric-where-needed matrices; [X Y; Yᵀ Z] must be positive definite.

    Matrices for z are (nz, nz) in the coordinates of the support's basis E, those for b (3, 3) in the world frame.
    """

    X: ArrayLike = 1.0
    Y: ArrayLike = 1.0
    Z: ArrayLike = 1.5


@njit
def _quadratic(X: Any, Y: Any, Z: Any, n: int, e: Any, rate: Any, c: Any) -> tuple[float, float]:
    """V and γ of (5.4)/(5.13) of one block, and c = Zᵀ ė + Yᵀ e of (5.14), for errors e and ė of size n."""
    V, gamma = 0.0, 0.0
    for i in range(n):
        x, y, z, c[i] = 0.0, 0.0, 0.0, 0.0
        for j in range(n):
            x += X[i, j] * e[j]
            y += Y[i, j] * rate[j]
            z += Z[i, j] * rate[j]
            c[i] += Z[j, i] * rate[j] + Y[j, i] * e[j]
        V += 0.5 * (e[i] * x + 2.0 * e[i] * y + rate[i] * z)
        gamma += rate[i] * (x + y)
    return V, gamma


@njit
def lyapunov_terms(
    t: float,
    nodes: Any,
    velocities: Any,
    rods: Any,
    points: Any,
    gains: Any,
    string_nodes: Any,
    target: Any,
    gravity: Any,
    f: Any,
) -> tuple[float, float]:
    """V and β of (5.3), (5.11), and f of (5.12) into (M,); weight counts as a known force."""
    V, beta = 0.0, 0.0
    influence = np.zeros(nodes.shape)  # Φ A c: how each node's force enters V̇
    work = np.empty((23, 3))  # one allocation: this is called at every stage
    scratch, r_aim, b_aim = work[:4], work[4:7], work[7:10]
    b, b_rate, r, r_rate, e, rate = work[10], work[11], work[12], work[13], work[14], work[15]
    c, c_z, c_b, t_r, t_b, r_acc, b_acc = work[16], work[17], work[18], work[19], work[20], work[21], work[22]
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
        V_b, gamma = _quadratic(gain.Xb, gain.Yb, gain.Zb, 3, e, rate, c_b)
        V += V_b
        beta += gamma
        for k in range(3):
            beta += c_b[k] * (b_acc[k] - b_aim[2, k])
            c_z[k] = 0.0
        for p in range(rod.nz):
            e[p], rate[p] = 0.0, 0.0
            for k in range(3):
                e[p] += rod.E[k, p] * (r[k] - r_aim[0, k])
                rate[p] += rod.E[k, p] * (r_rate[k] - r_aim[1, k])
        if rod.nz > 0:
            V_z, gamma = _quadratic(gain.Xz, gain.Yz, gain.Zz, rod.nz, e, rate, c)
            V += V_z
            beta += gamma
            for k in range(3):
                for p in range(rod.nz):
                    c_z[k] += rod.E[k, p] * c[p]
                beta += c_z[k] * (r_acc[k] - r_aim[2, k])
        # aᵀ H = (A c)ᵀ, A = M⁻¹ H being symmetric.
        rod_accelerations(rod, b, 0.0, c_z, c_b, r_acc, b_acc, scratch)
        for k in range(3):
            influence[rod.i, k] = r_acc[k] - rod.sigma * rod.length * b_acc[k]
            influence[rod.j, k] = r_acc[k] + (1.0 - rod.sigma) * rod.length * b_acc[k]
    for a in range(len(points)):
        point, gain = points[a], gains[len(rods) + a]
        point_target(point, t, target, r_aim)
        for p in range(point.nz):
            e[p], rate[p] = 0.0, 0.0
            for k in range(3):
                e[p] += point.E[k, p] * (nodes[point.node, k] - r_aim[0, k])
                rate[p] += point.E[k, p] * (velocities[point.node, k] - r_aim[1, k])
        V_z, gamma = _quadratic(gain.Xz, gain.Yz, gain.Zz, point.nz, e, rate, c)
        V += V_z
        beta += gamma
        for p in range(point.nz):
            for k in range(3):
                beta += c[p] * point.E[k, p] * (gravity[k] - r_aim[2, k])
                influence[point.node, k] += point.E[k, p] * c[p] / point.mass
    for m in range(len(string_nodes)):
        i, j = string_nodes[m, 0], string_nodes[m, 1]
        f[m] = 0.0
        for k in range(3):
            f[m] += (influence[j, k] - influence[i, k]) * (nodes[j, k] - nodes[i, k])
    return V, beta


@numba.cfunc(LAW_SIGNATURE, cache=True, error_model="numpy")
def _lyapunov(t, nodes_at, velocities_at, context, command_at, report_at):  # type: ignore[no-untyped-def]
    table = integers(context, (16,))
    count, size = table[0], table[1]
    rods, points = _read_rods(table[3], table[4]), _read_points(table[5], table[6])
    gains = _read_gains(table[7], table[4] + table[6])
    settings = floats(table[11], (5,))  # decay rate, norm, gravity
    u, report = floats(command_at, (size,)), floats(report_at, (2,))
    f = np.empty(size)
    V, beta = lyapunov_terms(
        t,
        floats(nodes_at, (count, 3)),
        floats(velocities_at, (count, 3)),
        rods,
        points,
        gains,
        integers(table[8], (size, 2)),
        read_target(table[9]),
        settings[2:],
        f,
    )
    margin = least_norm(f, beta + settings[0] * V, floats(table[12], (size,)), settings[1], u)
    report[0], report[1] = margin, V
    return SOLVED if margin > 0.0 else NO_SOLUTION


@dataclass(frozen=True, eq=False)
class Lyapunov:
    """The law of Theorem 5.1 with the explicit minima of Lemma 5.1.

    Attributes:
        structure: what the law believes it controls (masses, supports, lengths).
        target: set-point or path; an array (N, 3) counts as a set-point.
        decay_rate: δ [1/s] > 0 of V̇ = -δ V.
        norm: 1, 2 or math.inf. 1 and ∞ give discontinuous laws, which run sampled only.
        translation, rotation: gains of every rod, or a mapping rod name -> Gains (others keep the default).
        minimum_force_density: ū [N/m] >= 0, scalar or (M,): the residual prestress at the end of §5.3.
        gravity: g [m/s²] that the law knows of.

    Raises:
        OptionError, SceneError: for gains that are not positive definite, δ <= 0, another norm, a bad target.
    """

    structure: Structure
    target: Target | Array
    decay_rate: float = 1.0
    norm: float = 2
    translation: Gains | Mapping[str, Gains] = field(default_factory=Gains)
    rotation: Gains | Mapping[str, Gains] = field(default_factory=Gains)
    minimum_force_density: ArrayLike = 0.0
    gravity: tuple[float, float, float] = (0.0, 0.0, 0.0)

    command = Command.FORCE_DENSITY

    def __post_init__(self) -> None:
        if self.target is None:
            raise OptionError("target = None: the Lyapunov law needs a target; give node positions (N, 3) or a Target")
        if not isinstance(self.structure, Structure):
            raise OptionError(f"structure = {self.structure!r}; use a Structure (scene.structure)")
        if not isinstance(self.target, Target):
            object.__setattr__(self, "target", Target.set_point(self.target))
        check_target(self.structure, self.target)
        object.__setattr__(self, "decay_rate", positive("decay_rate", self.decay_rate, "1/s"))
        if isinstance(self.norm, bool) or not np.isscalar(self.norm) or self.norm not in (1, 2, math.inf):
            raise OptionError(f"norm = {self.norm!r}; allowed: 1, 2, math.inf")
        floor = real_array("minimum_force_density", self.minimum_force_density, (len(self.structure.strings),), "N/m")
        if np.any(floor < 0):
            raise OptionError(f"minimum_force_density = {self.minimum_force_density!r}; every value must be >= 0 N/m")
        gravity = real_array("gravity", self.gravity, (3,), "m/s²", scalar=False)
        object.__setattr__(self, "gravity", tuple(float(x) for x in gravity))
        gain_records(self.structure, self.translation, self.rotation)

    @property
    def discontinuous(self) -> str:
        """Why the law cannot run continuously; empty for norm 2."""
        names = {1: "1-norm", math.inf: "∞-norm"}
        return DISCONTINUOUS.format(name=names[self.norm]) if self.norm in names else ""

    def native(self, structure: Structure) -> NativeLaw:
        """The compiled law, for a plant with the same nodes and strings."""
        own = self.structure
        if (len(own.nodes), own.string_nodes.tolist()) != (len(structure.nodes), structure.string_nodes.tolist()):
            raise OptionError(
                f"the law was made for '{own.name}' with {len(own.nodes)} nodes and {len(own.strings)} strings; "
                f"'{structure.name}' has other nodes or strings"
            )
        return self._native

    @cached_property
    def _native(self) -> NativeLaw:
        own, target = self.structure, self.target
        assert isinstance(target, Target)
        records = StructureRecords.of(own)
        gains = gain_records(own, self.translation, self.rotation)
        arrays = (
            np.array(own.string_nodes),
            np.array([self.decay_rate, self.norm, *self.gravity], float),
            np.array(np.broadcast_to(np.asarray(self.minimum_force_density, float), (len(own.strings),))),
        )
        table = np.zeros(16, np.int64)
        packed = PackedTarget(target)
        table[:2] = len(own.nodes), len(own.strings)
        table[3:7] = address_of(records.rods), len(records.rods), address_of(records.points), len(records.points)
        table[7] = address_of(gains)
        table[8], table[9] = address_of(arrays[0]), packed.address
        table[11:13] = [address_of(array) for array in arrays[1:]]
        return NativeLaw(
            address=_lyapunov.address,
            context=address_of(table),
            keep=(records, gains, arrays, packed, table),
            discontinuous=self.discontinuous,
            gravity=self.gravity,
            decay_rate=self.decay_rate,
        )

    def __call__(self, time: float, nodes: Array, velocities: Array) -> Array:
        """u (M,) [N/m] at one state.

        Raises:
            InfeasibleError: where no admissible u exists, with the margin.
        """
        u, margin, _ = self.evaluate(time, nodes, velocities)
        if not margin > 0:
            raise InfeasibleError(
                f"no admissible u at t = {time:.6g} s: feasibility margin max(v/α) = {margin:.3g} <= 0 (5.18)"
            )
        return u

    def evaluate(self, time: float, nodes: Array, velocities: Array) -> tuple[Array, float, float]:
        """u (M,) [N/m], the feasibility margin max(v/α) and V at one state."""
        native = self._native
        nodes = np.ascontiguousarray(nodes, float)
        velocities = np.ascontiguousarray(velocities, float)
        u, report = np.zeros(len(self.structure.strings)), np.zeros(2)
        _lyapunov.ctypes(
            float(time),
            address_of(nodes),
            address_of(velocities),
            native.context,
            address_of(u),
            address_of(report),
        )
        return u, float(report[0]), float(report[1])

    def target_equilibrium(self) -> dict[str, Any]:
        """Is the (last) target an equilibrium, as Theorem 5.1 assumes? Residual [N], u [N/m], self-stress modes."""
        from tensegrity_mj.prestress import equilibrium_force_densities

        target = self.target
        assert isinstance(target, Target)
        u, residual, modes = equilibrium_force_densities(self.structure, target.nodes[-1], self.gravity)
        return {"residual": float(residual), "force_densities": np.asarray(u).tolist(), "self_stress_modes": int(modes)}

    def describe(self) -> dict[str, Any]:
        """Plain values for the provenance of a run."""
        return {
            "law": "lyapunov",
            "decay_rate": float(self.decay_rate),
            "norm": "inf" if self.norm == math.inf else int(self.norm),
            "minimum_force_density": np.asarray(self.minimum_force_density, float).tolist(),
            "target_equilibrium": self.target_equilibrium(),
        }


def gain_records(
    structure: Structure, translation: Gains | Mapping[str, Gains], rotation: Gains | Mapping[str, Gains]
) -> np.ndarray[Any, Any]:
    """Gains of every rod and point mass as records.

    Raises:
        OptionError: naming the rod and the matrix, unless [X Y; Yᵀ Z] is symmetric and positive definite.
    """
    names = [rod.name for rod in structure.rods] + [point.node for point in structure.point_masses]
    sizes = [rod.support.translation_basis.shape[1] for rod in structure.rods]
    sizes += [point.translation_basis.shape[1] for point in structure.point_masses]
    for given in (translation, rotation):
        if isinstance(given, Mapping):
            for name in given:
                if name not in names:
                    raise OptionError(
                        f"gains for '{name}', which is no rod or point mass; there are {', '.join(names)}"
                    )
    records = np.zeros(len(names), GAINS)
    for number, (name, size) in enumerate(zip(names, sizes, strict=True)):
        blocks = [("z", translation, size)]
        if number < len(structure.rods):
            blocks.append(("b", rotation, 3))
        for block, given, n in blocks:
            gains = given.get(name, Gains()) if isinstance(given, Mapping) else given
            if not isinstance(gains, Gains):
                raise OptionError(f"gains of '{name}' = {gains!r}; use Gains(X, Y, Z)")
            if n == 0:
                continue
            X, Y, Z = (_matrix(getattr(gains, key), n, f"{key}{block} of '{name}'") for key in ("X", "Y", "Z"))
            _check_definite(X, Y, Z, f"'{name}', block {block}")
            for key, matrix in (("X", X), ("Y", Y), ("Z", Z)):
                records[number][f"{key}{block}"][:n, :n] = matrix
    return records


def _check_definite(X: Array, Y: Array, Z: Array, where: str) -> None:
    """(5.6) by the Schur complement (Lemma 2.2): Z ≻ 0 and X - Y Z⁻¹ Yᵀ ≻ 0."""
    for key, matrix in (("X", X), ("Z", Z)):
        if not np.allclose(matrix, matrix.T, rtol=0, atol=1e-12 * np.abs(matrix).max()):
            raise OptionError(f"gains of {where}: {key} = {matrix.tolist()} must be symmetric")
    smallest = float(np.linalg.eigvalsh(Z)[0])
    if not smallest > 0:
        raise OptionError(f"gains of {where}: Z must be positive definite; its smallest eigenvalue is {smallest:.3g}")
    smallest = float(np.linalg.eigvalsh(X - Y @ np.linalg.solve(Z, Y.T))[0])
    if not smallest > 0:
        raise OptionError(
            f"gains of {where}: X - Y Z⁻¹ Yᵀ must be positive definite (Schur complement of (5.6)); its smallest "
            f"eigenvalue is {smallest:.3g}: enlarge X or Z, or reduce Y"
        )


def _matrix(value: ArrayLike, n: int, what: str) -> Array:
    try:
        array = np.array(value, float)
    except (TypeError, ValueError):
        array = np.array([np.nan])
    if array.ndim == 0:
        array = array * np.eye(n)
    if array.shape != (n, n) or not np.all(np.isfinite(array)):
        raise OptionError(f"gain {what} = {value!r}; it must be a finite number or a ({n}, {n}) matrix")
    return array
