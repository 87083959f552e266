"""The thesis' own form of the equations of chapter 3, for any forest of rods: a matrix of K x K for K rods.

It is independent of `joint_forces`, which is faster, and of the one large matrix of `assembly`, and checks both.

    engine = dae(DENSE, rtol=1e-12)      # simulates, and has accelerations, as any DAE

The mass matrix is constant: with Φ_i, Φ_j the (constant) derivatives of a rod's ends to q, it is the sum of
m/3 (Φ_iᵀΦ_i + Φ_jᵀΦ_j + (Φ_iᵀΦ_j + Φ_jᵀΦ_i)/2) over the rods, a linear profile of velocities integrated, and of what
they carry.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.dynamics.joint_forces import (
    LEAST_PIVOT,
    Joints,
    acceleration_of,
    moved_nodes_power,
    plan_joints,
    push_joint,
    set_ends,
)
from tensegrity_mj.dynamics.kernels import accelerate_points, direction_of, stretch_term
from tensegrity_mj.dynamics.linked import Linked, LinkedRecords, end_maps, loop_matrix
from tensegrity_mj.dynamics.native.compiling import c_function
from tensegrity_mj.dynamics.native.law import SOLVED
from tensegrity_mj.dynamics.native.plant import Plant
from tensegrity_mj.dynamics.native.pointers import TIMED, borrowing, owning
from tensegrity_mj.dynamics.native.vectors import add, dot, minus, times, vector
from tensegrity_mj.dynamics.native.views import Table, changing_view, fields_of, view_of
from tensegrity_mj.engines.reference import dae_kernels as linked_kernels
from tensegrity_mj.engines.reference.dae import DAE, EXTRA, Solver
from tensegrity_mj.engines.reference.equations import halves
from tensegrity_mj.engines.reference.integration import Equations
from tensegrity_mj.engines.request import Request
from tensegrity_mj.model.rods import mass_products, own_masses

DENSE = "dense"

# What compiled code sees of them; n coordinates of the rods, C closures.
Tree, _pack_tree = view_of(
    "TreeMatrices",
    inverse=("f8", "size", "size"),  # M⁻¹
    loops=("f8", "loop_count", "size"),  # (3C, n) derivatives of the closures' gaps to the coordinates
    maps=("f8", "map_count", "size"),  # (6R, n) derivatives of the rods' ends
    at=("i8", "rod_count"),  # where each rod's b starts among the coordinates
)


def tree_matrices(records: LinkedRecords) -> Table:
    """A `Tree`, whose coordinates are q of the records."""
    maps = end_maps(records)
    inverse, loops = np.linalg.inv(mass_matrix(records, maps)), loop_matrix(records, maps)
    at = records.rods["q"].copy()
    at[records.links["rod"]] += records.links["nz"]
    return _pack_tree(inverse=0.5 * (inverse + inverse.T), loops=loops, maps=maps.reshape(-1, len(inverse)), at=at)


def mass_matrix(records: LinkedRecords, maps: Array) -> Array:
    """M (n, n), constant; for a chain of free rods (3.13) with the corrections of its misprints."""
    weighted = np.sqrt(own_masses(records.structure) / 3)[:, None, None, None] * maps
    first, second = (weighted[:, end].reshape(-1, maps.shape[-1]) for end in (0, 1))
    cross = first.T @ second
    matrix = np.asarray(first.T @ first + second.T @ second + 0.5 * (cross + cross.T))
    for row in np.flatnonzero(records.structure.rod_lumps[0]):
        a, b, c = mass_products(0.0, records.structure.rod_lumps[:, row])
        (one, other), both = maps[row], maps[row, 0].T @ maps[row, 1]
        matrix += a * one.T @ one + b * other.T @ other + c * (both + both.T)
    return matrix


@borrowing
def _load_ends(address: int, joints_at: int, forces: Any, gravity: Any) -> None:
    """Forces at the rods' ends with their shares of its weight, in the frame that moves with the tree's support."""
    set_ends(address, forces, joints_at)
    linked, joints = Linked(address), Joints(joints_at)
    for k in range(len(linked.links)):
        link = linked.links[k]
        rod, pull = linked.rods[link.rod], minus(vector(gravity), acceleration_of(linked, link.drive))
        for end in range(2):
            share = (rod.center if end == 1 else 1.0 - rod.center) * rod.mass
            add(joints.ends[link.rod], end, times(share, pull))


@borrowing
def _gap_rates(linked: Any, joints: Any, kp: float, kd: float, right: Any) -> None:
    """What the closures' gaps must accelerate with beside what moved supports make of them, (3C, 1)."""
    for a in range(len(linked.gaps)):
        e = joints.closures[a]
        for x in range(3):
            right[3 * a + x, 0] = -kd * linked.gaps[a, 1, x] - kp * linked.gaps[a, 0, x]
        for k in range(len(linked.links)):
            link = linked.links[k]
            drive = acceleration_of(linked, link.drive)
            for x in range(3):
                if link.rod == joints.joints[e, 2]:
                    right[3 * a + x, 0] -= drive[x]
                if link.rod == joints.joints[e, 0]:
                    right[3 * a + x, 0] += drive[x]


@owning
def _solved(S: Any, X: Any, whole: Any, block: int, least: float) -> Any:
    """A solution Y (n, m) of S Y = X with S (n, n) symmetric positive semidefinite, whose redundant rows get zero.

    By elimination with the largest pivot; what is redundant has none above `least`, after scaling by the largest entry
    on the diagonal of each block of `whole`, of which S was made. These loops compile in a tenth of LAPACK's time.
    """
    n, m = len(S), X.shape[1]
    scale = np.empty(n)
    for r in range(n):
        largest, first = 0.0, block * (r // block)
        for k in range(first, first + block):
            largest = max(largest, whole[k, k])
        scale[r] = 1.0 / np.sqrt(largest)
    A, Y = np.empty((n, n + m)), np.zeros((n, m))
    for r in range(n):
        for c in range(n):
            A[r, c] = scale[r] * S[r, c] * scale[c]
        for c in range(m):
            A[r, n + c] = scale[r] * X[r, c]
    used, order = np.zeros(n, np.int64), np.full(n, -1)
    for k in range(n):
        best = -1
        for r in range(n):
            if not used[r] and (best < 0 or A[r, r] > A[best, best]):
                best = r
        if A[best, best] <= least:
            break
        used[best], order[k] = 1, best
        for r in range(n):
            if not used[r]:
                factor = A[r, best] / A[best, best]
                for c in range(n + m):
                    A[r, c] -= factor * A[best, c]
    for k in range(n - 1, -1, -1):
        r = order[k]
        if r >= 0:
            for c in range(m):
                total = A[r, n + c]
                for e in range(k + 1, n):
                    if order[e] >= 0:
                        total -= A[r, order[e]] * Y[order[e], c]
                Y[r, c] = total / A[r, r]
    for r in range(n):
        for c in range(m):
            Y[r, c] *= scale[r]
    return Y


@owning
def _product(A: Any, B: Any) -> Any:
    """A B of matrices."""
    C = np.zeros((A.shape[0], B.shape[1]))
    for i in range(A.shape[0]):
        for k in range(A.shape[1]):
            for j in range(B.shape[1]):
                C[i, j] += A[i, k] * B[k, j]
    return C


@owning
def dense_accelerations(model: Any, q: Any, rates: Any, out: Any) -> float:
    """As `joint_accelerations`, by (3.19)-(3.22) with a K x K matrix; closures by a Schur complement on top of it."""
    linked, joints, tree = Linked(model.linked), Joints(model.joints), Tree(model.tree)
    forces, kp, kd, multipliers = model.forces, model.kp, model.kd, model.multipliers
    inverse, loops = tree.inverse, tree.loops
    R, n, size = len(linked.rods), inverse.shape[0], len(loops)
    right, force = np.zeros((size, 1)), np.zeros((size, 1))
    _load_ends(model.linked, model.joints, forces, model.gravity)
    # M⁻¹ times u of (3.15), for any forest.
    free = _product(inverse, _product(tree.maps.T, joints.ends.copy().reshape((-1, 1))))
    _gap_rates(linked, joints, kp, kd, right)
    Y = np.zeros((R, 3))
    y = np.zeros(R)
    for k in range(len(linked.links)):
        rod = linked.rods[linked.links[k].rod]
        row, place = linked.links[k].rod, tree.at[linked.links[k].rod]
        b, b_rate = direction_of(rod, q, place), direction_of(rod, rates, place)
        for p in range(rod.nb):
            Y[row, p] = rod.rigid * rod.J * q[place + p]
        y[row] = -rod.J * dot(b, b) * stretch_term(rod, b, b_rate, kp, kd)
    # M⁻¹Y and W = YᵀM⁻¹Y, (3.20).
    answers, W, sides = np.zeros((R, n)), np.empty((R, R)), np.empty((R, size + 1))
    for a in range(R):
        for p in range(linked.rods[a].nb):
            factor = Y[a, p]
            for i in range(n):
                answers[a, i] += factor * inverse[tree.at[a] + p, i]
    for a in range(R):
        place, nb = tree.at[a], linked.rods[a].nb
        sides[a, size] = -y[a]
        for p in range(nb):
            sides[a, size] += Y[a, p] * free[place + p, 0]
        for e in range(R):
            total = 0.0
            for p in range(nb):
                total += Y[a, p] * answers[e, place + p]
            W[a, e] = total
        W[a, a] += 1.0 - linked.rods[a].rigid  # of an elastic rod: λ = 0
    # The closures' own Schur complement: what rods of constant length answer to forces at the closures.
    pulled = _product(loops, inverse)
    for a in range(R):
        for c in range(size):
            sides[a, c] = 0.0
            for p in range(linked.rods[a].nb):
                sides[a, c] += Y[a, p] * pulled[c, tree.at[a] + p]
    solved = _solved(W, sides, W, 1, 0.0)
    for a in range(R):
        multipliers[a] = solved[a, size]
    if size:
        whole, turned = _product(pulled, loops.T), _product(sides.T, solved)
        for i in range(n):
            out[i] = free[i, 0]
            for a in range(R):
                out[i] -= solved[a, size] * answers[a, i]
        for c in range(size):
            for i in range(n):
                right[c, 0] -= loops[c, i] * out[i]
        stiff = whole.copy()
        for c in range(size):
            for e in range(size):
                stiff[c, e] -= turned[c, e]
        force = _solved(stiff, right, whole, 3, LEAST_PIVOT)
        for a in range(R):
            for c in range(size):
                multipliers[a] += solved[a, c] * force[c, 0]
    for i in range(n):
        out[i] = free[i, 0]
        for c in range(size):
            out[i] += force[c, 0] * pulled[c, i]
        for a in range(R):
            out[i] -= multipliers[a] * answers[a, i]
    accelerate_points(forces, linked.points, model.gravity, out)
    return _supports_power(linked, joints, tree, out, force) + moved_nodes_power(model.linked, forces)


@owning
def _supports_power(linked: Any, joints: Any, tree: Any, accelerations: Any, force: Any) -> float:
    """Power of the supports of rods that move [W]: of momenta, what loads and closures (3C, 1) do not give them."""
    power = 0.0
    if len(linked.motions) == 0:
        return power
    for a in range(len(joints.closures)):
        push_joint(joints, joints.closures[a], force[3 * a : 3 * a + 3, 0])
    moves = np.zeros(len(tree.maps))  # of the ends, seen from the support, as their loads are
    for row in range(len(moves)):
        for i in range(tree.maps.shape[1]):
            moves[row] += tree.maps[row, i] * accelerations[i]
    for k in range(len(linked.links)):
        link = linked.links[k]
        rod, ends = linked.rods[link.rod], joints.ends[link.rod]
        if link.drive >= 0:
            for x in range(3):
                first, second = moves[6 * link.rod + x], moves[6 * link.rod + 3 + x]
                need = rod.mass * ((1.0 - rod.center) * first + rod.center * second)
                power += (need - ends[0, x] - ends[1, x]) * linked.motions[link.drive, 1, x]
    return power


FIELDS = fields_of(linked_kernels.LINKED, tree="size")  # the address of a `Tree`
_DenseView = changing_view("Dense", FIELDS)


@c_function(TIMED, "the equations (3.19) to (3.22) of the DAE")
def dense_accelerate(t, y_at, dy_at, table):  # type: ignore[no-untyped-def]
    own = _DenseView(table)
    own.given += dense_accelerations(own, *halves(own, y_at), halves(own, dy_at)[1])
    linked_kernels.report_gaps(own)
    return SOLVED


class DenseDAE(DAE):
    """The reference engine by these equations, wherever rods share nodes or not."""

    def as_one(self, scene: Any) -> bool:
        return False

    def _model(self, request: Request) -> Any:
        scene = request.scene
        if not scene.structure.rods:  # point masses alone have no matrix
            return super()._model(request)
        plant = Plant(scene, request.law, request.actuation, request.on_infeasible, FIELDS)
        records = LinkedRecords.of(scene.structure, scene.motions, plant["moved"])
        closures = len(records.forest.closures)
        plant.set(linked=records.table, joints=plan_joints(records), closure_count=closures)
        plant["tree"] = tree_matrices(records)
        equations = Equations(
            place=linked_kernels.linked_place,
            accelerate=dense_accelerate,
            project=linked_kernels.linked_project,
            extra=EXTRA if closures else 0,
        )
        return plant, records, equations


SOLVERS = [*Solver, DENSE]


def dae(solver: Solver | str, **options: Any) -> DAE:
    """The DAE with a solver of the package, or with this one."""
    return DenseDAE(solver=Solver.FULL, **options) if solver == DENSE else DAE(solver=solver, **options)
