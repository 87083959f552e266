"""Linear models of a scene about a state, from each engine's own equations, all in the same coordinates.

    ẋ = A x + B v + e,   y = C x,   x = (δ, δ̇)

The chart δ is built from the state alone, so that engines can be compared number by number. It has, in the order of the
structure: for each rod the translations z - z₀ along its support's `translation_basis`, then the central projection of
b onto the tangent plane at b₀,

    b = (b₀ + T δ_b) / ‖b₀ + T δ_b‖,     δ_b = Tᵀ b / (b₀ᵀ b),

with T = `null_space_basis(b₀)` (3, 2) in space, and in a plane the one unit vector that b₀ turns to when the angle of
the minimal model grows; for each point mass the translations along its `translation_basis`. Straight lines through
δ = 0 are great circles of b. So δ_b is the angle turned, up to its third power, and A at an equilibrium is that of any
such chart.

v are changes of the rest lengths [m], or of the force densities [N/m], from those at the state; y are the node
positions' changes (3N,) [m], nodes one after another. e is what an equilibrium would have as zero: (δ̇, δ̈) at the state.

How the derivatives are taken. An engine's accelerations are affine in the strings' tensions T, and tensions have the
only kinks. So each string that is taut at the state is kept taut, by an offset of its tension that is far above all
changes of it and is subtracted again,

    a(T) = a(T + c) - (a(T + 3c) - a(T + c)) / 2,

and each slack one is kept slack. What is left is smooth in δ and quadratic in δ̇, and affine in v. Central differences
in δ̇ and v are then exact. In δ, 2 n points with the step h have a truncation error of (n!)² (h/R)^(2n) and a round-off
of 4 ε R / h, relative to k, where R is the distance within which a tension is analytic: the shortest string or rod.
n = 6 and h = 0.022 R make 7e-15 and 4e-14 of them. Engines differ by their round-off alone.
"""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tensegrity_mj.actuation import Actuation, OnInfeasible
from tensegrity_mj.capabilities import require_still_supports
from tensegrity_mj.checks import finite, member, real_array
from tensegrity_mj.contact import overlaps
from tensegrity_mj.dynamics.linked import LinkedRecords
from tensegrity_mj.dynamics.tree_equations import loop_matrix
from tensegrity_mj.engines.run import Accelerations, Request
from tensegrity_mj.errors import InfeasibleError, OptionError
from tensegrity_mj.files import checked, replacing
from tensegrity_mj.jsontext import to_json
from tensegrity_mj.law import NO_SOLUTION, Command, Law, native_law
from tensegrity_mj.native.plant import (
    NODES,
    REST,
    STATUS,
    VELOCITIES,
    Plant,
    break_times,
    measure_strings,
    set_rest_lengths,
)
from tensegrity_mj.scene import Scene
from tensegrity_mj.strings import StringLaw
from tensegrity_mj.structure import Structure, null_space_basis

Array = NDArray[np.float64]

# f'(0) h = Σ w (f(k h) - f(-k h)), k = 1 to n: of order 2 n (Lagrange's weights).
PAIRS = 6
WEIGHTS = tuple(
    -((-1) ** k) * math.factorial(PAIRS) ** 2 / (k * math.factorial(PAIRS - k) * math.factorial(PAIRS + k))
    for k in range(1, PAIRS + 1)
)
STEP = 0.022  # of R
# Of that, where rods close loops: what closes them is a root of equations, analytic in a shorter distance. The lowest
# ω² of `net` is 118 with the whole step, and 67.30030945 with this part of it and with a quarter of this.
LOOP_STEP = 0.15
EDGE = 1e-12  # of its length: within round-off of its rest length, a string is at the edge of slackness
# A law's derivative: steps tried, relative to R. Where its kinks are near, only short ones are right.
LAW_STEPS = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)
KINK = 1e-3  # of the largest derivative: what the two sides may differ by
FLAT = 1e-10  # of the largest |λ|²: below it, ω² is that of a motion that nothing holds
LOOP_RANK = 1e-9  # of the largest: below it, a loop says what others say already
NEWTON_STEPS = 30
STILL = 1e-12  # of the largest |λ|: a damping below it is none


class LinearizableEngine(Protocol):
    """An engine that tells the accelerations of the nodes."""

    def accelerations(self, request: Request) -> Accelerations:
        """See `engines.run.Accelerations`."""
        ...


@dataclass(frozen=True, eq=False)
class Linearization:
    """A linear model, see the module's text; n coordinates δ, M strings, N nodes.

    Attributes:
        engine: one line.
        scene: what was linearized.
        time: [s].
        nodes, velocities, rest_lengths: the state, (N, 3), (N, 3), (M,).
        inputs: what B's columns change.
        A: (2n, 2n); with a law, that of the closed loop.
        B: (2n, M), the plant's.
        C: (3N, 2n).
        residual: (2n,) ẋ at the state: zero at an equilibrium.
        gain: (M, 2n) derivative of the law's rest lengths (force densities), or None without a law.
        coordinates: (n,) a name for each δ, such as "rod r1: z1" or "rod r1: b2".
        warnings: what the numbers do not tell, such as strings at the edge of slackness.
    """

    engine: str
    scene: Scene
    time: float
    nodes: Array
    velocities: Array
    rest_lengths: Array
    inputs: Command
    A: Array
    B: Array
    C: Array
    residual: Array
    gain: Array | None
    coordinates: tuple[str, ...]
    warnings: tuple[str, ...]

    @property
    def is_equilibrium(self) -> bool:
        """Whether the state stands still: ẋ below 1e-9 of what A makes of a metre or a radian."""
        return bool(np.abs(self.residual).max(initial=0.0) <= 1e-9 * max(np.abs(self.A).max(initial=0.0), 1e-300))

    @property
    def eigenvalues(self) -> Array:
        """(2n,) complex [1/s], by ascending modulus, conjugates with the positive imaginary part first."""
        return self._modes()[0]

    @property
    def modes(self) -> Array:
        """(3N, 2n) complex: the nodes' motion in each mode, in the order of `eigenvalues`, its largest entry 1."""
        return self._modes()[1]

    @property
    def frequencies(self) -> Array:
        """|λ| / 2π [Hz] of the modes that swing or are held, ascending: one of each conjugate pair, no rigid motion."""
        values = self.eigenvalues
        held = np.abs(values) ** 2 > FLAT * np.abs(values).max(initial=0.0) ** 2
        return np.abs(values[held & (values.imag >= 0)]) / (2 * np.pi)

    @property
    def damping_ratios(self) -> Array:
        """-Re λ / |λ| of the same modes."""
        values = self.eigenvalues
        values = values[(np.abs(values) ** 2 > FLAT * np.abs(values).max(initial=0.0) ** 2) & (values.imag >= 0)]
        return np.asarray(-values.real / np.abs(values))

    def _modes(self) -> tuple[Array, Array]:
        n = len(self.coordinates)
        stiffness, damping = -self.A[n:, :n], -self.A[n:, n:]
        scale = np.sqrt(np.abs(stiffness).max(initial=0.0))
        if np.abs(damping).max(initial=0.0) <= STILL * scale:
            # From ω² rather than from ±iω, which are not half as accurate where one mode is far softer than another.
            squares, shapes = np.linalg.eig(stiffness)
            roots = np.sqrt(-squares.astype(complex))
            roots = np.where(roots.imag < 0, -roots, roots)
            values = np.concatenate([roots, roots.conj() if np.isrealobj(squares) else -roots])
            values[n:] = np.where(np.abs(roots.imag) <= STILL * np.abs(roots), -roots, values[n:])
            vectors = np.concatenate([shapes, shapes], axis=1)
            moved = self.C[:, :n] @ vectors
        else:
            values, vectors = np.linalg.eig(self.A)
            moved = self.C @ vectors
        order = np.lexsort((-values.imag, np.round(np.abs(values), 9)))
        moved = moved[:, order]
        if moved.size:
            largest = moved[np.argmax(np.abs(moved), axis=0), np.arange(moved.shape[1])]
            moved = moved / np.where(largest == 0, 1, largest)
        return values[order], moved

    def deviation(self, nodes: ArrayLike, velocities: ArrayLike) -> Array:
        """x (2n,) of node positions and velocities (N, 3): what they differ by from the state of this model."""
        structure = self.scene.structure
        shape = (len(structure.nodes), 3)
        chart = Chart(structure, self.nodes)
        here = real_array("nodes", nodes, shape, "m", False), real_array("velocities", velocities, shape, "m/s", False)
        delta, rate = chart.coordinates(*here)
        return np.concatenate([delta, rate - chart.coordinates(self.nodes, self.velocities)[1]])

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write everything as .json, or its arrays and names as .npz; returns the path.

        Raises:
            OptionError: for another suffix, or a place where no file can be written.
        """
        destination = checked(path, (".npz", ".json"), "linear model")
        data = self.to_dict()
        with replacing(destination) as part:
            if destination.suffix.lower() == ".json":
                part.write_text(to_json(data) + "\n", encoding="utf-8")
            else:
                del data["warnings"], data["gain"]
                data["eigenvalues"] = self.eigenvalues
                if self.gain is not None:
                    data["gain"] = self.gain
                arrays: dict[str, Any] = {key: np.asarray(value) for key, value in data.items()}
                np.savez_compressed(part, **arrays)
        return destination

    def to_dict(self) -> dict[str, Any]:
        """Everything as plain values, for JSON."""
        return {
            "engine": self.engine,
            "scene": self.scene.name,
            "time": self.time,
            "inputs": self.inputs.value,
            "coordinates": list(self.coordinates),
            "strings": [string.name for string in self.scene.structure.strings],
            "nodes": list(self.scene.structure.node_names),
            "positions": self.nodes.tolist(),
            "velocities": self.velocities.tolist(),
            "rest_lengths": self.rest_lengths.tolist(),
            "A": self.A.tolist(),
            "B": self.B.tolist(),
            "C": self.C.tolist(),
            "gain": None if self.gain is None else self.gain.tolist(),
            "residual": self.residual.tolist(),
            "equilibrium": self.is_equilibrium,
            "eigenvalues": [[float(value.real), float(value.imag)] for value in self.eigenvalues],
            "frequencies": self.frequencies.tolist(),
            "damping_ratios": self.damping_ratios.tolist(),
            "warnings": list(self.warnings),
        }


class Chart:
    """Coordinates δ about a state, and the state of (δ, δ̇).

    Rods that hang on others have no translations of their own. Where joints close loops, as many δ as the loops
    determine are left out, and are found from the others by Newton's method; which ones is chosen by pivoting, so that
    the others determine them best.

    Attributes:
        size: n, the number of coordinates δ.
        names: (n,) of them.
    """

    def __init__(self, structure: Structure, nodes: Array) -> None:
        self.records = records = LinkedRecords.of(structure)
        self.q0 = records.coordinates(nodes)
        names: list[str] = []
        roots, count = records.forest.parent < 0, len(records.rods)
        self._b0, self._T = np.zeros((count, 3)), np.zeros((count, 3, 2))
        straight, turned, parts = [], [], []  # (in q, in δ) of z; (rod, component, in δ) of δ_b; (rod, component, in q)
        for number, rod in enumerate(records.rods):
            at, nz, nb = int(rod["q"]), int(rod["nz"]) if roots[number] else 0, int(rod["nb"])
            b0 = self.q0[at + nz : at + nz + nb]
            b0 = b0 / np.linalg.norm(b0)
            self._b0[number, :nb] = b0
            self._T[number, :nb, : nb - 1] = null_space_basis(b0[None]) if nb == 3 else [[-b0[1]], [b0[0]]]
            straight += [(at + k, len(names) + k) for k in range(nz)]
            turned += [(number, k, len(names) + nz + k) for k in range(nb - 1)]
            parts += [(number, k, at + nz + k) for k in range(nb)]
            label = f"rod {structure.rods[number].name}"
            names += [f"{label}: z{k + 1}" for k in range(nz)] + [f"{label}: b{k + 1}" for k in range(nb - 1)]
        for number, point in enumerate(records.points):
            at, nz = int(point["q"]), int(point["nz"])
            straight += [(at + k, len(names) + k) for k in range(nz)]
            names += [f"point mass {structure.point_masses[number].node}: z{k + 1}" for k in range(nz)]
        self._straight = np.array(straight, np.int64).reshape(-1, 2).T
        self._turned = np.array(turned, np.int64).reshape(-1, 3).T
        self._parts = np.array(parts, np.int64).reshape(-1, 3).T
        self._all = len(names)
        self._loops = loop_matrix(records)
        self._chosen, self._determined = np.arange(self._all), np.arange(0)
        if len(self._loops):
            from scipy.linalg import qr

            _, R, order = qr(self._slopes(np.zeros(self._all)), mode="economic", pivoting=True)
            size = np.abs(np.diag(R))
            rank = int(np.sum(size > LOOP_RANK * size[0]))
            self._determined, self._chosen = np.sort(order[:rank]), np.sort(order[rank:])
        self.names = tuple(names[k] for k in self._chosen)
        self.size = len(self.names)

    def state(self, delta: Array, rate: Array) -> tuple[Array, Array]:
        """Node positions and velocities (N, 3) of δ, δ̇ (n,)."""
        return self.records.place(*self._q(*self._completed(delta, rate)))

    @property
    def has_loops(self) -> bool:
        """Whether some δ follow from others."""
        return len(self._determined) > 0

    def coordinates(self, nodes: Array, velocities: Array) -> tuple[Array, Array]:
        """δ, δ̇ (n,) of node positions and velocities (N, 3); every b within a right angle of b₀."""
        q, q_rate = self.records.coordinates(nodes), self.records.coordinates(velocities)
        delta, rate = np.zeros(self._all), np.zeros(self._all)
        in_q, in_delta = self._straight
        delta[in_delta], rate[in_delta] = q[in_q] - self.q0[in_q], q_rate[in_q]
        (b, along), (b_rate, along_rate) = self._directions(q), self._directions(q_rate)
        x = self._across(b) / along
        rods, columns, places = self._turned
        delta[places] = x[rods, columns]
        rate[places] = ((self._across(b_rate) - x * along_rate) / along)[rods, columns]
        return delta[self._chosen], rate[self._chosen]

    def accelerations(self, delta: Array, rate: Array, nodes: Array) -> Array:
        """δ̈ (n,) of node accelerations (N, 3) at δ, δ̇: of δ_b = Tᵀ b / (b₀ᵀ b), differentiated twice."""
        delta, rate = self._completed(delta, rate)
        q_acc = self.records.coordinates(nodes)
        out = np.zeros(self._all)
        in_q, in_delta = self._straight
        out[in_delta] = q_acc[in_q]
        x, v = self._turns(delta), self._turns(rate)
        norm = np.sqrt(1 + np.sum(x * x, axis=1, keepdims=True))
        s = 1 / norm  # b₀ᵀ b
        s_rate = -np.sum(x * v, axis=1, keepdims=True) / norm**3
        b_acc, along_acc = self._directions(q_acc)
        rods, columns, places = self._turned
        out[places] = ((self._across(b_acc) - x * along_acc - 2 * v * s_rate) / s)[rods, columns]
        return out[self._chosen]

    def _directions(self, q: Array) -> tuple[Array, Array]:
        """b (R, 3) of q, zero where a planar rod has no third component, and b₀ᵀ b (R, 1)."""
        rods, columns, places = self._parts
        b = np.zeros_like(self._b0)
        b[rods, columns] = q[places]
        return b, np.sum(self._b0 * b, axis=1, keepdims=True)

    def _across(self, b: Array) -> Array:
        """Tᵀ b (R, 2)."""
        return np.einsum("rki,rk->ri", self._T, b)

    def _turns(self, delta: Array) -> Array:
        """δ_b (R, 2) of all δ, the second of a planar rod zero."""
        rods, columns, places = self._turned
        x = np.zeros((len(self._b0), 2))
        x[rods, columns] = delta[places]
        return x

    def _q(self, delta: Array, rate: Array) -> tuple[Array, Array]:
        """q and q̇ of all δ, δ̇."""
        q, q_rate = self.q0.copy(), np.zeros_like(self.q0)
        in_q, in_delta = self._straight
        q[in_q] += delta[in_delta]
        q_rate[in_q] = rate[in_delta]
        x, v = self._turns(delta), self._turns(rate)
        norm = np.sqrt(1 + np.sum(x * x, axis=1, keepdims=True))
        b = (self._b0 + np.einsum("rki,ri->rk", self._T, x)) / norm
        b_rate = (np.einsum("rki,ri->rk", self._T, v) - b * (np.sum(x * v, axis=1, keepdims=True) / norm)) / norm
        rods, columns, places = self._parts
        q[places], q_rate[places] = b[rods, columns], b_rate[rods, columns]
        return q, q_rate

    def _slopes(self, delta: Array) -> Array:
        """(3C, all δ): derivatives of the loops' gaps."""
        out = np.zeros((len(self._loops), self._all))
        in_q, in_delta = (part[self._straight[0] < self._loops.shape[1]] for part in self._straight)
        out[:, in_delta] = self._loops[:, in_q]
        x = self._turns(delta)
        norm = np.sqrt(1 + np.sum(x * x, axis=1))[:, None, None]
        b = (self._b0 + np.einsum("rki,ri->rk", self._T, x))[:, :, None] / norm
        turned = (self._T - b * x[:, None, :] / norm) / norm
        loops = np.zeros((len(self._loops), *self._b0.shape))
        rods, columns, places = self._parts
        loops[:, rods, columns] = self._loops[:, places]
        rods, columns, places = self._turned
        out[:, places] = np.einsum("crk,rki->cri", loops, turned)[:, rods, columns]
        return out

    def _completed(self, delta: Array, rate: Array) -> tuple[Array, Array]:
        """All δ, δ̇ of those chosen, with every loop closed."""
        if not len(self._determined):
            return delta, rate
        full, full_rate = np.zeros(self._all), np.zeros(self._all)
        full[self._chosen], full_rate[self._chosen] = delta, rate
        before = np.inf
        for _ in range(NEWTON_STEPS):
            gap = self._loops @ (self._q(full, full_rate)[0] - self.q0)[: self._loops.shape[1]]
            size = float(np.abs(gap).max())
            if size == 0 or size > 0.5 * before:
                break
            before = size
            slopes = self._slopes(full)[:, self._determined]
            full[self._determined] -= np.linalg.lstsq(slopes, gap, rcond=LOOP_RANK)[0]
        slopes = self._slopes(full)
        pushed = slopes[:, self._chosen] @ rate
        full_rate[self._determined] = -np.linalg.lstsq(slopes[:, self._determined], pushed, rcond=LOOP_RANK)[0]
        return full, full_rate


def linearize(
    scene: Scene,
    engine: LinearizableEngine | None = None,
    *,
    nodes: ArrayLike | None = None,
    velocities: ArrayLike | None = None,
    rest_lengths: ArrayLike | None = None,
    law: Law | Callable[..., ArrayLike] | None = None,
    time: float = 0.0,
    inputs: Command = Command.REST_LENGTH,
) -> Linearization:
    """The linear model of a scene about a state, from an engine's own equations.

    Args:
        scene: structure, gravity, loads, and the strings that have broken by `time`. Nothing must touch at the state:
            contact has no linear model, and the model is that of the scene without it.
        engine: `MuJoCo(...)` (default), `DAE(...)` or `ODE(...)`; only its equations count, not its steps.
        nodes, velocities: (N, 3) the state; the scene's start by default. Velocities may be nonzero: then the model is
            that of the motion's next moment.
        rest_lengths: (M,) [m]; the structure's by default, or what `law` sets at the state.
        law: closes the loop continuously: A is then A + B ∂v/∂x.
        time: [s], at which loads and the law are evaluated, and strings have broken or not yet.
        inputs: what B's columns change. With force densities u, A is that at constant u, too.

    Raises:
        OptionError: for options out of range, where the engine's coordinates cannot hold the state, and where something
            touches.
        SceneError: for a state that stretches a rod or breaks a support, and where supports move: the model would
            depend on time. Leave motions out with scene.with_(motions=()).
        InfeasibleError, ControllerError: what the law says at the state.
    """
    if not isinstance(scene, Scene):
        raise OptionError(f"scene = {scene!r}; use a Scene, or load_scene(name or path)")
    if engine is None:
        from tensegrity_mj.engines.mujoco import MuJoCo

        engine = MuJoCo()
    if isinstance(engine, type) or not callable(getattr(engine, "accelerations", None)):
        raise OptionError(f"engine = {engine!r}; use MuJoCo(...), DAE(...) or ODE(...)")
    member("inputs", inputs, Command)
    time = finite("time", time, " [s]")
    require_still_supports(scene, "linearization is")
    structure, contact = scene.structure, scene.contact
    broken = break_times(scene) <= time
    scene = scene.with_(
        initial_nodes=scene.nodes0 if nodes is None else nodes,
        initial_velocities=scene.velocities0 if velocities is None else velocities,
        breaks=(),
        contact=None,
    )
    touching = [] if contact is None else overlaps(structure, contact, scene.nodes0)
    if touching:
        raise OptionError(
            f"linearize: {touching[0]}: contact has no linear model; choose a state where nothing touches, or leave "
            "contact out (scene.with_(contact=None))"
        )
    chart = Chart(structure, scene.nodes0)
    _, rate0 = chart.coordinates(scene.nodes0, scene.velocities0)
    reach = _reach(structure, scene.nodes0)
    loop = None if law is None else _RestLengths(scene, law, time)
    if rest_lengths is not None and law is not None:
        raise OptionError("rest_lengths and law: the law sets the rest lengths; leave one of them out")
    if rest_lengths is not None:
        rest = real_array("rest_lengths", rest_lengths, (len(structure.strings),), "m").copy()
    else:
        rest = np.array(structure.rest_lengths) if loop is None else loop(scene.nodes0, scene.velocities0)
    strings = _Strings(structure, scene, rest, broken, inputs, PAIRS * STEP * reach, reach)
    request = Request(
        scene, native_law(None, structure), Actuation.continuous(), OnInfeasible.STOP, 1.0, None, progress=False
    )
    field = engine.accelerations(request)

    def motion(delta: Array, rate: Array, change: Array) -> tuple[Array, Array]:
        """Node positions (3N,) and δ̈ (n,) at δ, δ̇ and a change of the inputs."""
        here, speeds = chart.state(delta, rate)
        lengths = structure.string_lengths(here)
        placed, once = field(time, here, speeds, strings.rest_lengths(lengths, change, 1.0))
        if np.any(strings.taut):
            thrice = field(time, here, speeds, strings.rest_lengths(lengths, change, 3.0))[1]
            once = once - 0.5 * (thrice - once)
        return placed.ravel(), chart.accelerations(delta, rate, once)

    n, M = chart.size, len(structure.strings)
    none, zero = np.zeros(n), np.zeros(M)
    A, B, C = np.zeros((2 * n, 2 * n)), np.zeros((2 * n, M)), np.zeros((3 * len(structure.nodes), 2 * n))
    A[:n, n:] = np.eye(n)
    step = STEP * (LOOP_STEP if chart.has_loops else 1.0)
    for k in range(n):
        unit = np.eye(n)[k]
        h = step * reach / _lever(structure, chart, k)
        for p, weight in enumerate(WEIGHTS, start=1):
            ahead, behind = motion(p * h * unit, rate0, zero), motion(-p * h * unit, rate0, zero)
            C[:, k] += weight / h * (ahead[0] - behind[0])
            A[n:, k] += weight / h * (ahead[1] - behind[1])
        A[n:, n + k] = 0.5 * (motion(none, rate0 + unit, zero)[1] - motion(none, rate0 - unit, zero)[1])
    for m in np.flatnonzero(strings.taut):
        h = strings.input_step[m]
        change = h * np.eye(M)[m]
        B[n:, m] = (motion(none, rate0, change)[1] - motion(none, rate0, -change)[1]) / (2 * h)
    residual = np.concatenate([rate0, motion(none, rate0, zero)[1]])
    gain, remarks = None, strings.losses() + (strings.remarks() if loop is None else [])
    if loop is not None:
        gain, kinks = loop.derivative(chart, rate0, reach, strings, inputs)
        remarks += kinks
        A = A + B @ gain
    return Linearization(
        engine=str(engine),
        scene=scene,
        time=time,
        nodes=np.array(scene.nodes0),
        velocities=np.array(scene.velocities0),
        rest_lengths=rest,
        inputs=inputs,
        A=A,
        B=B,
        C=C,
        residual=residual,
        gain=gain,
        coordinates=chart.names,
        warnings=tuple(remarks),
    )


def _lever(structure: Structure, chart: Chart, k: int) -> float:
    """[m] or 1: how far the farthest node moves for a unit of δ_k."""
    unit = np.zeros(chart.size)
    unit[k] = 1.0
    return float(np.linalg.norm(chart.state(np.zeros(chart.size), unit)[1], axis=1).max())


def _reach(structure: Structure, nodes: Array) -> float:
    """R [m]: the shortest of strings and rods, the distance in which directions change."""
    lengths = np.concatenate([structure.string_lengths(nodes), structure.rod_lengths])
    return float(lengths.min()) if len(lengths) else 1.0


class _Strings:
    """Which strings pull, and the rest lengths that keep it so.

    Attributes:
        taut: (M,) bool.
        input_step: (M,) of an input, [m] or [N/m].
    """

    def __init__(
        self,
        structure: Structure,
        scene: Scene,
        rest: Array,
        broken: NDArray[np.bool_],
        inputs: Command,
        move: float,
        reach: float,
    ) -> None:
        self.structure, self.rest, self.broken, self.inputs = structure, rest, broken, inputs
        lengths = structure.string_lengths(scene.nodes0)
        if np.any(lengths == 0):
            name = structure.strings[int(np.argmin(lengths))].name
            raise OptionError(f"string '{name}' has no length at this state, and so no direction: linearize elsewhere")
        rates = structure.string_rates(scene.nodes0, scene.velocities0)
        stretch = lengths - rest
        edge = EDGE * np.maximum(lengths, np.abs(rest))
        self.at_edge = (np.abs(stretch) <= edge) & ~broken
        elastic = structure.stiffness * stretch
        dampers = structure.damping * rates
        clipped = structure.string_law is StringLaw.CLIPPED
        # A clipped string whose damper pushes more than it pulls carries nothing, and goes on so.
        self.taut = (stretch >= -edge) & ~(clipped & ~self.at_edge & (elastic + dampers <= 0)) & ~broken
        self.u = structure.stiffness * stretch / lengths
        self.input_step = (
            np.full(len(rest), STEP * reach)
            if inputs is Command.REST_LENGTH
            else STEP * structure.stiffness * np.ones(len(rest))
        )
        # Above all that nodes that move by `move`, inputs, and dampers at unit rates of δ can make of a tension.
        self.offset = (
            structure.stiffness * (np.abs(stretch) + 4 * move)
            + 2 * self.input_step * (structure.stiffness if inputs is Command.REST_LENGTH else lengths)
            + 2 * structure.damping * (np.abs(rates) + 2 * float(structure.rod_lengths.max(initial=1.0)))
        )

    def rest_lengths(self, lengths: Array, change: Array, offsets: float) -> Array:
        """(M,) [m] for the tension at these lengths and inputs plus a number of offsets."""
        k = self.structure.stiffness
        if self.inputs is Command.REST_LENGTH:
            elastic = k * (lengths - self.rest - change)
        else:
            elastic = (self.u + change) * lengths
        return np.where(self.taut, lengths - (elastic + offsets * self.offset) / k, 3 * lengths)

    def remarks(self) -> list[str]:
        """What the caller should know of strings at the edge."""
        names = self._named(self.at_edge)
        if not names:
            return []
        return [
            f"strings {names} are at the edge of slackness (their length is their rest length): the model "
            "is that of the taut side; it has a kink there"
        ]

    def losses(self) -> list[str]:
        """What the caller should know of broken strings."""
        names = self._named(self.broken)
        return [f"strings {names} have broken by this time: the model is that of the others"] if names else []

    def _named(self, chosen: NDArray[np.bool_]) -> str:
        return ", ".join(s.name for s, one in zip(self.structure.strings, chosen, strict=True) if one)


class _RestLengths:
    """The rest lengths that a law sets, as a function of the state."""

    def __init__(self, scene: Scene, law: Any, time: float) -> None:
        native = native_law(law, scene.structure)
        if native.discontinuous:
            raise OptionError(native.discontinuous)
        self.scene, self.time = scene, time
        self.plant = Plant(scene, native, Actuation.continuous(), OnInfeasible.STOP)

    def __call__(self, nodes: Array, velocities: Array) -> Array:
        """(M,) [m].

        Raises:
            InfeasibleError, ControllerError: what the law says there.
        """
        plant = self.plant
        plant[NODES][:], plant[VELOCITIES][:] = nodes, velocities
        measure_strings(plant.table)
        status = int(set_rest_lengths(plant.table, self.time))
        plant.raise_if_failed(max(status, int(plant.table[STATUS])), self.time)
        if status == NO_SOLUTION:
            raise InfeasibleError(plant.infeasible_message(self.time))
        return np.array(plant[REST])

    def derivative(
        self, chart: Chart, rate0: Array, reach: float, strings: _Strings, inputs: Command
    ) -> tuple[Array, list[str]]:
        """∂v/∂x (M, 2n) by central differences, and remarks about kinks.

        For each column that step is taken whose result differs least from that of the next shorter one.
        """
        structure = self.scene.structure
        n = chart.size

        def value(x: Array) -> Array:
            nodes, velocities = chart.state(x[:n], rate0 + x[n:])
            rest = self(nodes, velocities)
            if inputs is Command.REST_LENGTH:
                return rest
            return structure.stiffness * (1 - rest / structure.string_lengths(nodes))

        here = value(np.zeros(2 * n))
        gain = np.zeros((len(structure.strings), 2 * n))
        gaps = np.zeros_like(gain)
        for k in range(2 * n):
            unit = np.eye(2 * n)[k]
            scale = reach / _lever(structure, chart, k % n)
            tried = [_central(lambda x, u=unit: value(x * u), h * scale) for h in LAW_STEPS]  # type: ignore[misc]
            changes = [float(np.abs(a - b).max(initial=0.0)) for a, b in itertools.pairwise(tried)]
            gain[:, k] = tried[int(np.argmin(changes)) + 1 if changes[0] > min(changes) else 0]
            h = LAW_STEPS[-1] * scale
            ahead, behind = value(h * unit) - here, here - value(-h * unit)
            gaps[:, k] = (ahead - behind) / h
        rows = np.abs(gaps).max(axis=1, initial=0.0) > KINK * np.abs(gain).max(initial=0.0)
        if not rows.any():
            return gain, []
        names = ", ".join(s.name for s, kink in zip(structure.strings, rows, strict=True) if kink)
        return gain, [f"the law has a kink at this state in strings {names}: the closed loop is the mean of its sides"]


def _central(function: Callable[[float], Array], h: float) -> Array:
    """f'(0) by the points of WEIGHTS."""
    total: Any = 0.0
    for p, weight in enumerate(WEIGHTS, start=1):
        total = total + weight / h * (function(p * h) - function(-p * h))
    return np.asarray(total)
