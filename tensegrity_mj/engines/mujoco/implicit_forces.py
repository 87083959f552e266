"""Forces that depend on accelerations inside MuJoCo: added mass of rods in water, and linear constraints on nodes.

MuJoCo solves M q̈ = Q with the thin rods' own M. In water each rod also feels -Σ_j α_ij P a_j at its nodes, a_j being
the accelerations that are to be found, and constraints pull with the forces Gᵀ λ that keep G n at its value. So the
callback finds accelerations first, one tree of bodies after another, from the numbers that MuJoCo has for its degrees
of freedom when it calls: with J_i the velocities of a node i for each of them (from `cdof`), a_i⁰ what it accelerates
by without any q̈ (from `cdof_dot`), and Q = `qfrc_passive` - `qfrc_bias` + `qfrc_applied` + Σ J_nᵀ f_n, where f_n are
the forces of elements and strings on the nodes n, it solves

    (M + Σ_ij α_ij J_iᵀ P J_j) q̈ = Q - Σ_ij α_ij J_iᵀ P a_j⁰ + Σ_n J_nᵀ G_nᵀ λ,    Σ_n G_n (J_n q̈ + a_n⁰) = g̈

and applies -Σ_j α_ij P a_j of this q̈, and Gᵀ λ, as external forces. MuJoCo then finds the same q̈ by itself. No number
of the DAE takes part, and both agree to round-off.

Each tree gives what it accelerates by, and what it would for a unit of each λ. With these the rows' accelerations are
S λ + what there is without λ, and λ is what makes them those of the prescribed values. Rows that others imply get no
force. Accelerations alone let round-off and the integrator's error grow. So each step begins with the gap c of a row
and its rate ċ, and adds -(c/4h² + 7 ċ/8h) to the row's acceleration, the same at all stages: without other errors both
are then halved from step to step (a double root of 1/2 of what c and ċ become in a step h of constant acceleration).
What is added is of the order of the integrator's error, and constant over the step, so that RK4 keeps its order.

Joints that close loops, and contact, act through forces that MuJoCo finds after the callback: they are refused. So are
integrators whose step is not made of these accelerations: `implicit`, `implicitfast` and `discrete` solve M + h D.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import mujoco
import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.dynamics.kernels import own_mass, solve_with_pivots
from tensegrity_mj.dynamics.native.elements import clear
from tensegrity_mj.dynamics.native.pointers import borrowing, floats, inlined
from tensegrity_mj.dynamics.native.strings import add_string_forces, measure_segments
from tensegrity_mj.dynamics.native.vectors import add, cross, dot, minus, plus, put, row_of, times
from tensegrity_mj.dynamics.native.views import Table, view_of
from tensegrity_mj.engines.mujoco.mjcf_tree import BodyTree, Names
from tensegrity_mj.engines.mujoco.run_view import RunView
from tensegrity_mj.model.scene import Scene

OF_GAP, OF_RATE = 0.25, 0.875  # see above
DEPENDENT = 1e-12  # of `scales`, what other rows leave of a row's compliance: squares of singular values

# trees: first degree of freedom, how many, and the first and how many of `rods`, of `loaded` and of `terms`. rods: row,
# its nodes, its body, the root of its tree, the last degree of freedom that moves it. loaded: node, root, and that of
# the nodes. terms: of the constraints' sums, tree by tree: which constraint, node, body, root, and that of the node;
# pulls: the weight times the direction of each. drives: the motion of a constraint, or -1; units: its direction;
# values: what its terms give where nothing moves. rows: where the row of each degree of freedom is in M, and its
# length; columns: of the entries of M. chains: where the degrees of freedom that move what one of them moves are in
# `chain`, and how many. size: of the largest tree.
ImplicitForces, _pack = view_of(
    "ImplicitForces",
    trees=("i8", "tree_count", 8),
    rods=("i8", "rod_count", 6),
    loaded=("i8", "load_count", 3),
    terms=("i8", "term_count", 5),
    pulls=("f8", "term_count", 3),
    drives=("i8", "held"),
    units=("f8", "held", 3),
    values=("f8", "held"),
    rows=("i8", "dofs", 2),
    columns=("i8", "entries"),
    chains=("i8", "dofs", 2),
    chain=("i8", "links"),
    size="size",
)


class Links(NamedTuple):
    """Scratch of C constraints in a model of nv degrees of freedom.

    Attributes:
        forces: (C,) λ [N].
        closing: (C,) [m/s²] what closes the gaps.
        scales: (C,) [1/kg] what the compliance of each would be at the most: its terms without their directions.
        rows: (C, C + 1) S, and what is to be made up.
        responses: (nv, 1 + C) accelerations without λ, and of a unit of each.
    """

    forces: Array
    closing: Array
    scales: Array
    rows: Array
    responses: Array


def links_room(count: int, nv: int) -> int:
    """Numbers that `links_at` takes."""
    return count * (count + 4) + nv * (count + 1)


@inlined
def links_at(room: int, count: int, nv: int) -> Links:
    """The scratch at an address."""
    rows = room + 24 * count
    return Links(
        floats(room, count),
        floats(room + 8 * count, count),
        floats(room + 16 * count, count),
        floats(rows, (count, count + 1)),
        floats(rows + 8 * count * (count + 1), (nv, count + 1)),
    )


def set_implicit_forces(scene: Scene, tree: BodyTree, model: mujoco.MjModel, run: Table) -> int:
    """Set in the table of a run what compiled code reads of the trees of a scene's model; the numbers of its scratch.

    Nothing where no rod is in water, and no node is held.
    """
    wet = bool(run["wet_rods"])
    if not (wet or scene.structure.constraints):
        return 0
    structure, roots = scene.structure, model.body_rootid
    bodies = [int(model.body(name).id) for name in Names(scene, tree).rods]
    sites = [int(model.site_bodyid[model.site(name).id]) for name in structure.node_names]
    last = np.full(model.nbody, -1, np.int64)  # degree of freedom that moves a body
    for body in range(1, model.nbody):
        count = int(model.body_dofnum[body])
        last[body] = model.body_dofadr[body] + count - 1 if count else last[model.body_parentid[body]]
    trees: list[Any] = []
    rods: list[Any] = []
    loaded: list[Any] = []
    terms: list[Any] = []
    pulls: list[Any] = []
    held = structure.constraint_rows.reshape(-1, len(sites), 3)
    moving = [body for body in bodies if wet] + [sites[node] for node in np.flatnonzero(held.any(axis=(0, 2)))]
    for root in dict.fromkeys(int(roots[body]) for body in moving if last[body] >= 0):
        dofs = np.flatnonzero(roots[model.dof_bodyid] == root)
        own = [
            (row, *structure.rod_nodes[row], body, root, last[body])
            for row, body in enumerate(bodies)
            if wet and roots[body] == root and last[body] >= 0
        ]
        pushed = [(n, root, last[body]) for n, body in enumerate(sites) if roots[body] == root and last[body] >= 0]
        ties = [(row, n, sites[n], *rest) for n, *rest in pushed for row in np.flatnonzero(held[:, n].any(axis=1))]
        trees.append((dofs[0], len(dofs), len(rods), len(own), len(loaded), len(pushed), len(terms), len(ties)))
        rods += own
        loaded += pushed
        terms += ties
        pulls += [held[row, n] for row, n, *_ in ties]
    chains = [_chain(model, d) for d in range(model.nv)]
    counts = np.array([len(chain) for chain in chains], np.int64)
    N, C, size = len(structure.nodes), len(held), max((tree[1] for tree in trees), default=0)
    values = np.zeros(C)
    for (row, node, *_), pull in zip(terms, pulls, strict=True):
        values[row] += structure.positions[node] @ pull
    motions = [motion.support for motion in scene.motions]
    drives = [motions.index(one.name) if one.name in motions else -1 for one in structure.constraints]
    room = np.zeros(links_room(C, model.nv) + 3 * N + size * (size + 1 + C) + 6 * size)
    packed = _pack(
        trees=np.array(trees).reshape(-1, 8),
        rods=np.array(rods).reshape(-1, 6),
        loaded=np.array(loaded).reshape(-1, 3),
        terms=np.array(terms).reshape(-1, 5),
        pulls=np.array(pulls).reshape(-1, 3),
        drives=np.array(drives, np.int64),
        units=np.array([one.unit for one in structure.constraints]).reshape(-1, 3),
        values=values,
        rows=np.stack([model.M_rowadr, model.M_rownnz], axis=1),
        columns=model.M_colind,
        chains=np.stack([np.cumsum(counts) - counts, counts], axis=1),
        chain=np.concatenate([*chains, np.zeros(0, np.int64)]),
        size=size,
    )
    run.set(implicit=packed, implicit_room=room, constraint_count=C)
    return len(room)


def _chain(model: mujoco.MjModel, dof: int) -> list[int]:
    """A degree of freedom and those that carry it."""
    found = []
    while dof >= 0:
        found.append(dof)
        dof = int(model.dof_parentid[dof])
    return found[::-1]


@borrowing
def add_implicit_forces(table: int, h: float) -> float:
    """Add these forces to the nodal forces, which are all but those of strings; their power [W].

    Gaps of constraints are measured if h > 0, the step [s] that begins to close them; 0: as last measured; < 0: none.
    """
    run, power = RunView(table), 0.0
    water, N, C = ImplicitForces(run.implicit), run.node_count, run.constraint_count
    links, size = links_at(run.implicit_room, C, run.nv), water.size
    room = run.implicit_room + 8 * (C * (C + 4) + run.nv * (C + 1))
    forces, nodes, velocities, held, pulls = run.forces, run.nodes, run.velocities, run.held_mass, floats(room, (N, 3))
    clear(held)
    for n in range(N):
        put(pulls, n, row_of(forces, n))
    measure_segments(table)
    add_string_forces(table, pulls)
    room += 24 * N
    A, J = floats(room, (size, size + 1 + C)), floats(room + 8 * size * (size + 1 + C), (2, size, 3))
    added, M, axes, centers = run.added, run.M, run.cdof, run.subtree_com
    bias, passive, applied = run.qfrc_bias, run.qfrc_passive, run.qfrc_applied
    start_rows(water, links, run, h)
    for k in range(water.tree_count):
        tree = water.trees[k]
        start, n = tree[0], tree[1]
        for d in range(n):
            for e in range(n):
                A[d, e] = 0.0
            A[d, size] = passive[start + d] - bias[start + d] + applied[start + d]
        for d in range(n):
            for c in range(water.rows[start + d, 0], water.rows[start + d, 0] + water.rows[start + d, 1]):
                e = water.columns[c] - start
                A[d, e] = A[e, d] = M[c]
        for p in range(tree[4], tree[4] + tree[5]):
            node, root, last = water.loaded[p, 0], water.loaded[p, 1], water.loaded[p, 2]
            offset, pull = minus(row_of(nodes, node), row_of(centers, root)), row_of(pulls, node)
            for c in range(water.chains[last, 0], water.chains[last, 0] + water.chains[last, 1]):
                d = water.chain[c]
                A[d - start, size] += dot(_carried_by(axes, d, offset), pull)
        coupled = tree[7] > 0
        for r in range(tree[2], tree[2] + tree[3]):
            rod = water.rods[r]
            alpha = own_mass((added,), rod[0])
            if alpha[0] + alpha[1] + alpha[2] + alpha[3] == 0.0:
                continue
            coupled = True
            axis, a1, a2 = _free(rod, run, water)
            held1, held2 = _added(alpha, axis, a1, a2)
            first, count = _jacobians(rod, run, water, J)
            for e in range(count):
                column = water.chain[first + e] - start
                A[column, size] -= dot(row_of(J[0], e), held1) + dot(row_of(J[1], e), held2)
                one, two = _added(alpha, axis, row_of(J[0], e), row_of(J[1], e))
                for d in range(count):
                    A[water.chain[first + d] - start, column] += dot(row_of(J[0], d), one) + dot(row_of(J[1], d), two)
        if coupled:
            add_columns(water, tree, links, run, A)
            solve_with_pivots(A, n, size)
            couple_rows(water, tree, links, run, A)
    solve_rows(links)
    for r in range(water.rod_count):
        rod = water.rods[r]
        alpha, i, j = own_mass((added,), rod[0]), rod[1], rod[2]
        if alpha[0] + alpha[1] + alpha[2] + alpha[3] == 0.0:
            continue
        axis, a1, a2 = _free(rod, run, water)
        first, count = _jacobians(rod, run, water, J)
        for d in range(count):
            change = links.responses[water.chain[first + d], 0]
            a1, a2 = plus(a1, times(change, row_of(J[0], d))), plus(a2, times(change, row_of(J[1], d)))
        held1, held2 = _added(alpha, axis, a1, a2)
        power -= dot(held1, row_of(velocities, i)) + dot(held2, row_of(velocities, j))
        add(held, i, times(-1.0, held1))
        add(held, j, times(-1.0, held2))
    power += add_pulls(water, links, velocities, held)
    for n in range(N):
        add(forces, n, row_of(held, n))
    return power


@inlined
def _jacobians(rod: Any, run: Any, water: Any, J: Any) -> Any:
    """J of both nodes of a rod, by the chain of its last degree of freedom; where that starts, and how many."""
    center, axes = row_of(run.subtree_com, rod[4]), run.cdof
    first, count = water.chains[rod[5], 0], water.chains[rod[5], 1]
    for end in range(2):
        offset = minus(row_of(run.nodes, rod[1 + end]), center)
        for d in range(count):
            put(J[end], d, _carried_by(axes, water.chain[first + d], offset))
    return first, count


@inlined
def _free(rod: Any, run: Any, water: Any) -> Any:
    """The rod's direction, and a⁰ of both its nodes."""
    span = minus(row_of(run.nodes, rod[2]), row_of(run.nodes, rod[1]))
    a1, a2 = (_drift(run, water, rod[1], rod[3], rod[4], rod[5]), _drift(run, water, rod[2], rod[3], rod[4], rod[5]))
    return times(1.0 / np.sqrt(dot(span, span)), span), a1, a2


@inlined
def _added(alpha: Any, axis: Any, a1: Any, a2: Any) -> Any:
    """Σ_j α_ij P a_j of both ends."""
    p1, p2 = minus(a1, times(dot(a1, axis), axis)), minus(a2, times(dot(a2, axis), axis))
    return plus(times(alpha[0], p1), times(alpha[1], p2)), plus(times(alpha[2], p1), times(alpha[3], p2))


@borrowing
def start_rows(own: Any, links: Links, run: Any, h: float) -> None:
    """Set rows to prescribed accelerations and what closes gaps (h > 0: anew; < 0: nothing), and λ to zero."""
    nodes, velocities, moved, last = run.nodes, run.velocities, run.moved, len(links.forces)
    for c in range(last):
        links.scales[c] = links.forces[c] = 0.0
        for e in range(last + 1):
            links.rows[c, e] = 0.0
        motion = own.drives[c]
        if h != 0.0:
            links.closing[c] = 0.0
        if motion >= 0:
            links.rows[c, last] = dot(row_of(own.units, c), row_of(moved[motion], 2))
        if h > 0.0:
            links.closing[c] = OF_GAP * own.values[c] / (h * h)
            if motion >= 0:
                place, rate = row_of(moved[motion], 0), row_of(moved[motion], 1)
                ahead = plus(times(OF_GAP / (h * h), place), times(OF_RATE / h, rate))
                links.closing[c] += dot(row_of(own.units, c), ahead)
    if h > 0.0:
        for p in range(own.term_count):
            node, pull = own.terms[p, 1], row_of(own.pulls, p)
            gone = plus(times(OF_GAP / (h * h), row_of(nodes, node)), times(OF_RATE / h, row_of(velocities, node)))
            links.closing[own.terms[p, 0]] -= dot(pull, gone)
    for c in range(last):
        links.rows[c, last] += links.closing[c]


@borrowing
def add_columns(own: Any, tree: Any, links: Links, run: Any, A: Array) -> None:
    """Set what a unit of each λ pulls at a tree, right of its equations, and count what its nodes accelerate by."""
    nodes, centers, axes = run.nodes, run.subtree_com, run.cdof
    count, start, right = len(links.forces), tree[0], A.shape[1] - len(links.forces)
    for d in range(tree[1]):
        for c in range(count):
            A[d, right + c] = 0.0
    for p in range(tree[6], tree[6] + tree[7]):
        row, node, last, pull = own.terms[p, 0], own.terms[p, 1], own.terms[p, 4], row_of(own.pulls, p)
        offset = minus(row_of(nodes, node), row_of(centers, own.terms[p, 3]))
        drift = _drift(run, own, node, own.terms[p, 2], own.terms[p, 3], last)
        links.rows[row, count] -= dot(pull, drift)
        for e in range(own.chains[last, 0], own.chains[last, 0] + own.chains[last, 1]):
            d = own.chain[e]
            moves = _carried_by(axes, d, offset)
            A[d - start, right + row] += dot(pull, moves)
            links.scales[row] += dot(pull, pull) * dot(moves, moves) / A[d - start, d - start]


@borrowing
def couple_rows(own: Any, tree: Any, links: Links, run: Any, A: Array) -> None:
    """Keep the responses of a tree, whose equations are solved, and add them to the rows."""
    nodes, centers, axes = run.nodes, run.subtree_com, run.cdof
    count, start, right = len(links.forces), tree[0], A.shape[1] - len(links.forces)
    for d in range(tree[1]):
        for c in range(count + 1):
            links.responses[start + d, c] = A[d, right - 1 + c]
    for p in range(tree[6], tree[6] + tree[7]):
        row, last, pull = own.terms[p, 0], own.terms[p, 4], row_of(own.pulls, p)
        offset = minus(row_of(nodes, own.terms[p, 1]), row_of(centers, own.terms[p, 3]))
        for e in range(own.chains[last, 0], own.chains[last, 0] + own.chains[last, 1]):
            d = own.chain[e]
            along = dot(pull, _carried_by(axes, d, offset))
            links.rows[row, count] -= along * A[d - start, right - 1]
            for c in range(count):
                links.rows[row, c] += along * A[d - start, right + c]


@borrowing
def solve_rows(links: Links) -> None:
    """Solve the rows for λ, by elimination with the largest pivots of the diagonal, as long as there are any."""
    rows, forces, scales = links.rows, links.forces, links.scales
    count = len(forces)
    for _ in range(count):
        best, most = -1, DEPENDENT
        for c in range(count):
            if scales[c] > 0.0 and rows[c, c] > most * scales[c]:
                best, most = c, rows[c, c] / scales[c]
        if best < 0:
            break
        for c in range(count):
            factor = rows[c, best] / rows[best, best]
            if c != best and factor != 0.0:
                for e in range(count + 1):
                    rows[c, e] -= factor * rows[best, e]
        scales[best] = -scales[best]  # it is done
    for c in range(count):
        if scales[c] < 0.0:
            forces[c] = rows[c, count] / rows[c, c]
    for d in range(len(links.responses)):
        for c in range(count):
            links.responses[d, 0] += forces[c] * links.responses[d, 1 + c]


@borrowing
def add_pulls(own: Any, links: Links, velocities: Array, held: Array) -> float:
    """Add the forces of the constraints to those on the nodes; their power [W]."""
    power = 0.0
    for p in range(own.term_count):
        node, force = own.terms[p, 1], times(links.forces[own.terms[p, 0]], row_of(own.pulls, p))
        power += dot(force, row_of(velocities, node))
        add(held, node, force)
    return power


@inlined
def _carried_by(axes: Any, d: int, offset: Any) -> Any:
    """Velocity of a point per unit of a degree of freedom's, at an offset from the centre of mass of its tree."""
    turn, slide = row_of(axes, d), (axes[d, 3], axes[d, 4], axes[d, 5])
    return plus(slide, cross(turn, offset))


@inlined
def _drift(run: Any, own: Any, node: int, body: int, root: int, last: int) -> Any:
    """a⁰ of a node of a body, of this root, that degree of freedom `last` is the last to move."""
    offset, axis_rates, rates = minus(row_of(run.nodes, node), row_of(run.subtree_com, root)), run.cdof_dot, run.qvel
    found = cross(row_of(run.cvel, body), row_of(run.velocities, node))
    for c in range(own.chains[last, 0], own.chains[last, 0] + own.chains[last, 1]):
        d = own.chain[c]
        found = plus(found, times(rates[d], _carried_by(axis_rates, d, offset)))
    return found
