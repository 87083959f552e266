"""Linear stability of fixed-step integrators: the amplification of one step, and the largest stable step.

With matrices of `small_motions` (M = 1; K, D with a law's parts; Ks, Ds what an integrator takes of strings; Db the
blocks of Ds on single bodies: what a damper does between two kinematic trees is not in MuJoCo's derivative), one
step of length h of MuJoCo's one-stage integrators is

    W (v' - v) = -h (K q + (D + h S) v),      q' = q + h v'

    Euler:                   W = 1,                  S = 0       semi-implicit; the strings' dampers are explicit
    implicit, implicitfast:  W = 1 + h Db,           S = 0       at rest the two are one
    discrete:                W = 1 + h Ds + h² Ks,   S = Ks      Ks has the material part alone

and classical Runge-Kutta multiplies each mode e^(λt) of the linear model by R(z) = 1 + z + z²/2 + z³/6 + z⁴/24, z = hλ.

Without a law all matrices are symmetric and (q, v) = zⁿ x gives, with x* x = 1, a real quadratic in z whose last
coefficient is at most 1 while the middle one is in bounds: as h grows, an eigenvalue leaves the unit circle through
z = -1 and nowhere else (z = 1 belongs to a structure that is itself unstable). There

    Euler:                   h² K / 4           + h D / 2    has the largest eigenvalue 1
    implicit, implicitfast:  h² K / 4           + h D / 2 - h Db      (D <= 2 Db, since (a - b)² <= 2 a² + 2 b²)
    discrete:                h² (K - 2 Ks) / 4  - h D / 2

(for the second with rods that share nodes, and damped strings, see the end).

For one body: ω h = 2 (√(ζ² + 1) - ζ), 2 (√(ζ² + 1) + ζ), and for `discrete` no limit but that of motions which the
prestress alone holds: there K = geometric, Ks = 0, and ω h = 2. Runge-Kutta's is ω h = 2 √2 without damping and
2.785 / |λ| for a mode that is all damping. With a law the eigenvalues of the step's matrix are searched.

MuJoCo moves rods that share nodes as bodies that hang on each other. Its derivative of the forces by the velocities has
an entry for two bodies only where one hangs on the other, however far down: what a damper does between two branches is
left out. With w the rates of the tree (of each body its translations, and its rotation relative to the body that it
hangs on), M, K, D the matrices of mass, stiffness and damping in these, and B the entries of the strings' part of D
that are known,

    (M + h B)(w' - w) = -h (K θ + D w),      θ' = θ + h w'

An eigenvalue z of this step leaves the unit circle through -1, where

    G(h) = M + h (B - D/2) - h² K / 4

is singular. While G is positive definite, so is M + h B (K and D are not negative), and for every eigenvector
|z|² = 1 - h x*Dx / x*(M + h B)x <= 1. G's least eigenvalue is concave in h and above zero at h = 0: it has one root,
which is the limit. B - D/2 is not definite: a damper between two branches may *lower* the limit.

The spin of a thin rod about its own axis, which no node of its own has, carries what hangs on it. It counts.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array, bisect
from tensegrity_mj.model.forest import spanning_forest
from tensegrity_mj.model.rods import centers_and_moments, own_masses
from tensegrity_mj.vibration.bodies import SLOTS, motion_of_bodies
from tensegrity_mj.vibration.bounds import bounds_of
from tensegrity_mj.vibration.small_motions import Vibration
from tensegrity_mj.vibration.stepping import Scheme

# With a law a motion may grow by this part a step, and at twice the rate of its own growth: what is less is a matter
# of accuracy.
ALLOWANCE = 1e-3
GRID = 1.05  # ratio of the steps that the search with a law looks at
FLAT = 1e-12  # of the largest: a stiffness below it is round-off
AXIAL_INERTIA = 1e-2  # of a rod in a tree, as a part of the transverse one: that of the MJCF (tested to agree)
HALVINGS = 60
REACH = 4.0  # |z| up to which R(z) is evaluated; it is above 1 for all larger ones of Re z <= 0


def limit_of(model: Vibration, scheme: Scheme, extra: tuple[complex, ...] = ()) -> tuple[float, Array]:
    """The largest stable step [s], ∞ for none, and the coordinates y (n,) of the motion that grows beyond it.

    Args:
        model: about a state.
        scheme: of the integrator.
        extra: further eigenvalues [1/s] that Runge-Kutta has to do with (stabilized constraints).
    """
    if model.law is not None:
        return _limit_with_law(model, scheme)
    if scheme is Scheme.RUNGE_KUTTA:
        limit, y = _runge_kutta_limit(model)
        if extra:
            other = float(np.min(_radii(np.array(extra)) / np.abs(extra)))
            if other < limit:
                return other, np.zeros(model.size)
        return limit, y
    K, D = model.material + model.geometric, model.damper
    if scheme is Scheme.SEMI_IMPLICIT:
        return _first_root(model, K, D)
    if scheme is Scheme.VELOCITY_IMPLICIT:
        if model.state.joints is not None and _scale(model.string_damper) > 0 and has_tree_model(model):
            return tree_limit(tree_model(model))
        return _first_root(model, K, D - 2 * model.body_damper)
    return _first_root(model, K - 2 * model.seen, D - 2 * model.string_damper)


def is_stable(model: Vibration, scheme: Scheme, step: float, extra: tuple[complex, ...] = ()) -> bool:
    """Return whether a step is within the limit; with a law only this step is checked, without a search."""
    if model.law is None:
        return step <= limit_of(model, scheme, extra)[0]
    if scheme is Scheme.RUNGE_KUTTA and step <= bounds_of(model).stable_step(scheme):
        return True  # without eigenvalues, whose libraries alone take some MB
    return _is_stable(model, scheme, step)


def amplification_matrix(model: Vibration, scheme: Scheme, step: float) -> Array:
    """Matrix (2n, 2n) of one step for (y, ẏ). Dense, for models of moderate size."""
    K, D = _dense_matrices(model)
    n, h = model.size, step
    one, zero = np.eye(n), np.zeros((n, n))
    if scheme is Scheme.RUNGE_KUTTA:
        z = h * np.block([[zero, one], [-K, -D]])
        P = np.eye(2 * n)
        for k in (4, 3, 2, 1):
            P = np.eye(2 * n) + z @ P / k
        return P
    W = one
    if scheme is Scheme.VELOCITY_IMPLICIT:
        W = one + h * _dense(model.body_damper)
    elif scheme is Scheme.LINEARLY_IMPLICIT:
        seen = _dense(model.seen)
        W, D = one + h * _dense(model.string_damper) + h * h * seen, D + h * seen
    forces = np.hstack([K, D])
    moving = -h * (forces if W is one else np.linalg.solve(W, forces))
    moving[:, n:] += one
    found = np.vstack([h * moving, moving])
    found[:n, :n] += one
    return found


def system_matrix(model: Vibration) -> Array:
    """A (2n, 2n) of ẋ = A x, x = (y, ẏ). Dense."""
    n, (K, D) = model.size, _dense_matrices(model)
    return np.block([[np.zeros((n, n)), np.eye(n)], [-K, -D]])


def largest_frequency(model: Vibration) -> float:
    """ω [1/s] of the stiffest motion, without dampers and law."""
    return math.sqrt(max(0.0, _largest(model, model.material + model.geometric)[0]))


def polynomial(z: Any) -> Any:
    """R(z) of classical Runge-Kutta."""
    return 1 + z * (1 + z / 2 * (1 + z / 3 * (1 + z / 4)))


def _dense_matrices(model: Vibration) -> tuple[Array, Array]:
    """K and D, with what a law adds."""
    K, D = _dense(model.material + model.geometric), _dense(model.damper)
    return (K, D) if model.law is None else (K + model.law.stiffness, D + model.law.damping)


def _dense(matrix: Any) -> Array:
    return matrix if isinstance(matrix, np.ndarray) else matrix.toarray()


def _largest(model: Vibration, matrix: Any) -> tuple[float, Array]:
    """The largest eigenvalue of a symmetric matrix of a model, among motions that joints allow, and its vector."""
    n = matrix.shape[0]
    if n == 0:
        return 0.0, np.zeros(0)
    if isinstance(matrix, np.ndarray):
        values, vectors = np.linalg.eigh(0.5 * (matrix + matrix.T))
        return float(values[-1]), vectors[:, -1]
    if not _scale(matrix) > 0:  # Lanczos iterations break down on a matrix of zeros
        return 0.0, np.zeros(n)
    from scipy.sparse.linalg import eigsh

    # A start that no symmetry of the structure makes orthogonal to a mode, and the same each time.
    start = np.cos(np.arange(n) ** 1.5) + 0.1
    even = 0.5 * (matrix + matrix.T)
    values, vectors = eigsh(_projected(model, even), k=1, which="LA", v0=model.project(start), tol=1e-9)
    return float(values[0]), vectors[:, 0]


def _projected(model: Vibration, matrix: Any) -> Any:
    """P A P of a sparse A, as something that can be multiplied with."""
    if model.state.joints is None:
        return matrix
    from scipy.sparse.linalg import LinearOperator

    project = model.state.joints.project
    return LinearOperator(matrix.shape, matvec=lambda y: project(matrix @ project(np.ravel(y))), dtype=float)


def _scale(matrix: Any) -> float:
    """A bound on the eigenvalues of a symmetric matrix."""
    return float(abs(matrix).sum(axis=0).max()) if matrix.shape[0] else 0.0


def _first_root(model: Vibration, P: Any, B: Any) -> tuple[float, Array]:
    """The smallest h > 0 at which h² P / 4 + h B / 2 has the largest eigenvalue 1, and its vector; B is >= 0 or <= 0.

    For one vector x that is a scalar quadratic, whose root is not below the one sought; the vector that is largest at
    one h gives the next, from above and with quadratic convergence (Rayleigh's quotient).
    """
    largest, x = _largest(model, P)
    if not largest > FLAT * _scale(P):
        largest, x = _largest(model, B)
        if not largest > FLAT * _scale(B):
            return math.inf, x
    h = math.inf
    for _ in range(60):
        a, b = float(x @ (P @ x)), float(x @ (B @ x))
        # a h²/4 + b h/2 = 1, in the form that does not cancel.
        root = math.sqrt(max(0.0, b * b + 4 * a))
        over, under = (4.0, b + root) if b >= 0 else (root - b, a)
        found = over / under if under > 0 else math.inf
        if not found < h * (1 - 1e-12):
            break
        h = found
        _, x = _largest(model, 0.25 * h * h * P + 0.5 * h * B)
    return h, x


def _radii(values: Any) -> Array:
    """The smallest |z| on the ray of each value at which R(z) grows: above 1, and at over twice the mode's own rate."""
    direction = values / np.abs(values)
    steps = np.linspace(0.0, REACH, 2001)[1:]

    def grows(radius: Any) -> Any:
        z = direction[..., None] * radius
        return np.abs(polynomial(z)) > np.exp(2 * np.maximum(z.real, 0.0)) * (1 + 1e-9)

    unstable = grows(steps)
    first = np.where(unstable.any(axis=1), np.argmax(unstable, axis=1), len(steps) - 1)
    high, low = steps[first], steps[first] - steps[0]
    for _ in range(40):
        middle = 0.5 * (low + high)
        bad = grows(middle[:, None])[:, 0]
        high, low = np.where(bad, middle, high), np.where(bad, low, middle)
    return np.where(unstable.any(axis=1), low, np.inf)


def _runge_kutta_limit(model: Vibration) -> tuple[float, Array]:
    K, D = model.material + model.geometric, model.damper
    if _scale(D) <= 0:
        largest, y = _largest(model, K)
        if not largest > FLAT * _scale(K):
            return math.inf, y
        return math.sqrt(8 / largest), y
    if model.is_dense:
        values, vectors = np.linalg.eig(system_matrix(model))
    else:
        values, vectors = _largest_modes(model, K, D)
    return _of_modes(values, vectors[: model.size])


def _of_modes(values: Any, shapes: Any) -> tuple[float, Array]:
    """The limit of Runge-Kutta for eigenvalues and the positions (n, ...) of their vectors."""
    moving = np.abs(values) > FLAT * np.abs(values).max(initial=0.0)
    if not moving.any():
        return math.inf, np.zeros(len(shapes))
    values, shapes = values[moving], shapes[:, moving]
    limits = _radii(values) / np.abs(values)
    worst = int(np.argmin(limits))
    return float(limits[worst]), _real_shape(shapes[:, worst])


def _real_shape(shape: Any) -> Array:
    """A real motion of a complex mode: at its largest."""
    turned = shape * np.exp(-0.5j * np.angle(np.sum(shape**2)))
    norm = float(np.linalg.norm(turned.real))
    return np.asarray(turned.real / norm) if norm > 0 else np.zeros(len(shape))


def _largest_modes(model: Vibration, K: Any, D: Any) -> tuple[Any, Any]:
    """Eigenvalues of A that are not far from the largest, and their vectors: no other can be the first to grow.

    R's region of stability reaches from |z| = 2.6 to 3.0 in Re z <= 0.
    """
    from scipy.sparse.linalg import LinearOperator, eigs

    n = K.shape[0]
    project = model.project

    def rates(x: Array) -> Array:
        moved, moving = project(np.ravel(x)[:n]), project(np.ravel(x)[n:])
        return np.concatenate([moving, -project(K @ moved + D @ moving)])

    A: Any = LinearOperator((2 * n, 2 * n), matvec=rates, dtype=float)
    start, count = np.cos(np.arange(2 * n) ** 1.5) + 0.1, 8
    while True:
        values, vectors = eigs(A, k=count, which="LM", v0=start, tol=1e-8)
        sizes = np.abs(values)
        if sizes.min() < 0.85 * sizes.max() or count >= 64:
            return values, vectors
        count *= 2


def _limit_with_law(model: Vibration, scheme: Scheme) -> tuple[float, Array]:
    """The first crossing on a grid of steps, then bisection."""
    A = system_matrix(model)
    values, vectors = np.linalg.eig(A)
    fastest = float(np.abs(values).max(initial=0.0))
    if fastest == 0.0:
        return math.inf, np.zeros(model.size)
    if scheme is Scheme.RUNGE_KUTTA:
        return _of_modes(values, vectors[: model.size])
    # Slower than the stiffest string that the scheme knows nothing should be; beyond 1e4 times it there is no limit.
    low, high, h = 0.0, math.inf, 0.02 / fastest
    while h < 1e4 / fastest:
        if not _is_stable(model, scheme, h, values):
            high = h
            break
        low, h = h, h * GRID
    if math.isinf(high):
        return math.inf, np.zeros(model.size)
    low, high = bisect(lambda step: _is_stable(model, scheme, step, values), low, high, 1e-9 * high)
    found, shapes = np.linalg.eig(amplification_matrix(model, scheme, high))
    return low, _real_shape(shapes[: model.size, int(np.argmax(np.abs(found)))])


def _is_stable(model: Vibration, scheme: Scheme, step: float, values: Any = None) -> bool:
    """Return whether no motion grows beyond the allowance; `values` are A's eigenvalues, where they are known."""
    found = 0.0
    if scheme is not Scheme.RUNGE_KUTTA:
        found = np.abs(np.linalg.eigvals(amplification_matrix(model, scheme, step))).max(initial=0.0)
        if found <= 1 + ALLOWANCE:
            return True
    if values is None:
        values = np.linalg.eigvals(system_matrix(model))
    if scheme is Scheme.RUNGE_KUTTA:
        z = step * values
        allowed = np.exp(np.clip(2 * z.real, 0.0, 700.0)) * (1 + 1e-9)
        with np.errstate(over="ignore", invalid="ignore"):  # what overflows is beyond what is allowed
            return bool(np.all(np.abs(polynomial(z)) <= allowed))
    own = max(0.0, float(values.real.max(initial=0.0)))
    return bool(found <= math.exp(min(700.0, 2 * own * step)) * (1 + ALLOWANCE))


@dataclass(frozen=True, eq=False)
class TreeModel:
    """The matrices of a state in the rates w of the tree (nv,).

    Attributes:
        mass, stiffness, damper, known: (nv, nv) M, K, D and B above.
        coordinates: (n, nv) from w to the coordinates y of `small_motions`.
    """

    mass: Array = field(repr=False)
    stiffness: Array = field(repr=False)
    damper: Array = field(repr=False)
    known: Array = field(repr=False)
    coordinates: Array = field(repr=False)


def has_tree_model(model: Vibration) -> bool:
    """Return whether a model consists of trees of rods, and is small: no loops, no driven supports, no bodies."""
    if model.state.joints is None or not model.is_dense or model.scene.motions or model.scene.contact is not None:
        return False
    structure = model.scene.structure
    return not (structure.elastic.any() or structure.bodies or spanning_forest(structure).closures)


def tree_model(model: Vibration) -> TreeModel:
    """The matrices in the rates of the tree; see `has_tree_model`."""
    structure, bodies = model.scene.structure, model.state.bodies
    forest = spanning_forest(structure)
    R, B = len(structure.rods), len(bodies.mass)
    nodes = model.state.nodes
    # Rates in sequence: a body, its translation, and its axis of rotation.
    rates: list[tuple[int, Array, Array]] = []
    none = np.zeros(3)
    for number, rod in enumerate(structure.rods):
        if forest.parent[number] < 0:
            rates += [(number, axis, none) for axis in rod.support.translation_basis.T]
        axes = np.eye(3) if rod.support.plane is None else bodies.planes[number : number + 1]
        rates += [(number, none, axis) for axis in axes]
    for number, point in enumerate(structure.lone_masses, R):
        rates += [(number, axis, none) for axis in point.translation_basis.T]
    owner, count = [body for body, _, _ in rates], len(rates)
    above = np.eye(B, dtype=bool)  # whether the second is the first, or hangs on it
    for child in forest.order:
        if forest.parent[child] >= 0:
            above[:, child] |= above[:, forest.parent[child]]

    first, second = (nodes[rows] for rows in structure.rod_nodes.T)
    sigma, pivot = bodies.sigma[:, None], np.zeros((B, 3))
    hinges = nodes[np.maximum(forest.hinge, 0)]
    pivot[:R] = np.where(np.array(forest.parent)[:, None] < 0, (1 - sigma) * first + sigma * second, hinges)
    motion = motion_of_bodies(bodies, nodes)
    spatial = ~np.any(bodies.planes != 0, axis=1)
    Y = np.zeros((B, SLOTS, count))
    spin = np.zeros((R, count))
    for k, (body, slide, turn) in enumerate(rates):
        tail, head = (slide + np.cross(turn, end - pivot[body]) for end in (first, second))
        moved = np.tile(slide, (B, 1))
        moved[:R] = (1 - sigma) * tail + sigma * head
        plain = np.zeros((B, SLOTS))
        plain[:, :3] = np.einsum("bxz,bx->bz", bodies.E, moved)
        plain[:R, 3:] = np.einsum("rxt,rx->rt", motion.T[:R], head - tail) / bodies.length[:, None]
        found = np.linalg.solve(motion.inverse, plain[:, :, None])[:, :, 0]
        Y[:, :, k] = np.where(above[body][:, None], found, 0.0)
        spin[:, k] = np.where(above[body, :R] & spatial, motion.b @ turn, 0.0)
    flat = Y.reshape(B * SLOTS, count)
    own, lumps = AXIAL_INERTIA * own_masses(structure), AXIAL_INERTIA * structure.rod_lumps
    _, axial = centers_and_moments(own, structure.rod_lengths, lumps)
    strings = flat.T @ model.string_damper @ flat
    together = above[np.ix_(owner, owner)] | above[np.ix_(owner, owner)].T
    return TreeModel(
        mass=flat.T @ flat + spin.T @ (axial[:, None] * spin),
        stiffness=flat.T @ (model.material + model.geometric) @ flat,
        damper=flat.T @ model.damper @ flat,
        known=np.where(together, strings, 0.0),
        coordinates=flat,
    )


def tree_limit(tree: TreeModel) -> tuple[float, Array]:
    """The largest stable step [s], ∞ for none, and the coordinates y (n,) of the motion that grows beyond it."""
    if not len(tree.mass):
        return math.inf, np.zeros(len(tree.coordinates))
    root = np.linalg.cholesky(tree.mass)

    def scaled(matrix: Array) -> Array:
        half = np.linalg.solve(root, matrix)
        both = np.linalg.solve(root, half.T)
        return np.asarray(0.5 * (both + both.T))

    K, E = scaled(tree.stiffness), scaled(tree.known - 0.5 * tree.damper)
    one = np.eye(len(K))

    def least(h: float) -> tuple[float, Array]:
        values, vectors = np.linalg.eigh(one + h * E - 0.25 * h * h * K)
        return float(values[0]), vectors[:, 0]

    stiffest = float(np.linalg.eigvalsh(K)[-1])
    slowest = float(np.linalg.eigvalsh(E)[0])
    rate = math.sqrt(max(stiffest, 0.0)) + max(0.0, -slowest)
    if not rate > 0:
        return math.inf, np.zeros(len(tree.coordinates))
    # Below, G is definite for sure; a step beyond which it is none is found by doubling.
    low, high = 0.0, 1 / rate
    for _ in range(HALVINGS):
        if least(high)[0] <= 0:
            break
        low, high = high, 2 * high
    else:
        return math.inf, np.zeros(len(tree.coordinates))
    low, high = bisect(lambda step: least(step)[0] > 0, low, high)
    y = tree.coordinates @ np.linalg.solve(root.T, least(high)[1])
    size = float(np.linalg.norm(y))
    return low, np.asarray(y / size) if size > 0 else y
