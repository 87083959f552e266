"""Forces that answer accelerations inside MuJoCo: added mass of rods in water, and linear constraints on nodes.

MuJoCo solves M q̈ = Q with the thin rods' own M. In water each rod also feels -Σ_j α_ij P a_j at its nodes, a_j being
the accelerations that are to be found, and constraints pull with the forces Gᵀ λ that keep G n at its value. So the
callback finds accelerations first, one tree of bodies after another, from the numbers that MuJoCo has for its degrees
of freedom when it calls: with J_i the velocities of a node i for each of them (from `cdof`), a_i⁰ what it accelerates
by without any q̈ (from `cdof_dot`), and Q = `qfrc_passive` - `qfrc_bias` + `qfrc_applied` + Σ J_nᵀ f_n, where f_n are
the forces of elements and strings on the nodes n, it solves

    (M + Σ_ij α_ij J_iᵀ P J_j) q̈ = Q - Σ_ij α_ij J_iᵀ P a_j⁰ + Σ_n J_nᵀ G_nᵀ λ,    Σ_n G_n (J_n q̈ + a_n⁰) = g̈

and applies -Σ_j α_ij P a_j of this q̈, and Gᵀ λ, as external forces (`constraints`). MuJoCo then finds the same q̈ by
itself. No number of the DAE takes part, and both agree to round-off.

Joints that close loops, and contact, act through forces that MuJoCo finds after the callback: they are refused. So are
integrators whose step is not made of these accelerations: `implicit`, `implicitfast` and `discrete` solve M + h D.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from tensegrity_mj.dynamics.kernels import own_mass, solve_with_pivots
from tensegrity_mj.dynamics.native.elements import clear
from tensegrity_mj.dynamics.native.pointers import borrowing, floats, inlined
from tensegrity_mj.dynamics.native.strings import add_string_forces, measure_segments
from tensegrity_mj.dynamics.native.vectors import add, dot, minus, plus, put, row_of, times
from tensegrity_mj.dynamics.native.views import Table, view_of
from tensegrity_mj.engines.mujoco.constraints import (
    add_columns,
    add_pulls,
    carried_by,
    couple_rows,
    drifting,
    links_at,
    links_room,
    solve_rows,
    start_rows,
)
from tensegrity_mj.engines.mujoco.mjcf_bodies import Names
from tensegrity_mj.engines.mujoco.mjcf_tree import BodyTree
from tensegrity_mj.engines.mujoco.run_view import RunView
from tensegrity_mj.model.scene import Scene

# trees: first degree of freedom, how many, and the first and how many of `rods`, of `loaded` and of `terms`. rods: row,
# its nodes, its body, the root of its tree, the last degree of freedom that moves it. loaded: node, root, and that of
# the nodes. terms: of the constraints' sums, tree by tree: which constraint, node, body, root, and that of the node;
# pulls: the weight times the direction of each. drives: the motion of a constraint, or -1; units: its direction;
# values: what its terms give where nothing moves. rows: where the row of each degree of freedom is in M, and its
# length; columns: of the entries of M. chains: where the degrees of freedom that move what one of them moves are in
# `chain`, and how many. size: of the largest tree.
Answering, _pack = view_of(
    "Answering",
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


def set_answering(scene: Scene, tree: BodyTree, model: mujoco.MjModel, run: Table) -> int:
    """Set in the table of a run what compiled code reads of the trees of a scene's model; the numbers of its scratch.

    Nothing where nothing answers accelerations: where no rod is in water, and no node is held.
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
    run.set(answering=packed, answer_room=room, constraint_count=C)
    return len(room)


def _chain(model: mujoco.MjModel, dof: int) -> list[int]:
    """A degree of freedom and those that carry it."""
    found = []
    while dof >= 0:
        found.append(dof)
        dof = int(model.dof_parentid[dof])
    return found[::-1]


@borrowing
def add_answers(table: int, h: float) -> float:
    """Add what answers accelerations to the nodal forces, which are all but those of strings; its power [W].

    Gaps of constraints are measured if h > 0, the step [s] that begins to close them; 0: as last measured; < 0: none.
    """
    run, power = RunView(table), 0.0
    water, N, C = Answering(run.answering), run.node_count, run.constraint_count
    links, size = links_at(run.answer_room, C, run.nv), water.size
    room = run.answer_room + 8 * (C * (C + 4) + run.nv * (C + 1))
    forces, nodes, velocities, held, pulls = run.forces, run.nodes, run.velocities, run.held_mass, floats(room, (N, 3))
    clear(held)
    for n in range(N):
        put(pulls, n, row_of(forces, n))
    measure_segments(table)
    add_string_forces(table, pulls)
    room += 24 * N
    A, J = floats(room, (size, size + 1 + C)), floats(room + 8 * size * (size + 1 + C), (2, size, 3))
    added, M, axes, axis_rates = run.added, run.M, run.cdof, run.cdof_dot
    twists, centers, rates = run.cvel, run.subtree_com, run.qvel
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
                A[d - start, size] += dot(carried_by(axes, d, offset), pull)
        answers = tree[7] > 0
        for r in range(tree[2], tree[2] + tree[3]):
            rod = water.rods[r]
            alpha = own_mass((added,), rod[0])
            if alpha[0] + alpha[1] + alpha[2] + alpha[3] == 0.0:
                continue
            answers = True
            axis, a1, a2 = _free(rod, nodes, velocities, centers, twists, axis_rates, rates, water)
            held1, held2 = _added(alpha, axis, a1, a2)
            first, count = _jacobians(rod, nodes, centers, axes, water, J)
            for e in range(count):
                column = water.chain[first + e] - start
                A[column, size] -= dot(row_of(J[0], e), held1) + dot(row_of(J[1], e), held2)
                one, two = _added(alpha, axis, row_of(J[0], e), row_of(J[1], e))
                for d in range(count):
                    A[water.chain[first + d] - start, column] += dot(row_of(J[0], d), one) + dot(row_of(J[1], d), two)
        if answers:
            add_columns(water, tree, links, run, A)
            solve_with_pivots(A, n, size)
            couple_rows(water, tree, links, run, A)
    solve_rows(links)
    for r in range(water.rod_count):
        rod = water.rods[r]
        alpha, i, j = own_mass((added,), rod[0]), rod[1], rod[2]
        if alpha[0] + alpha[1] + alpha[2] + alpha[3] == 0.0:
            continue
        axis, a1, a2 = _free(rod, nodes, velocities, centers, twists, axis_rates, rates, water)
        first, count = _jacobians(rod, nodes, centers, axes, water, J)
        for d in range(count):
            change = links.answers[water.chain[first + d], 0]
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
def _jacobians(rod: Any, nodes: Any, centers: Any, axes: Any, water: Any, J: Any) -> Any:
    """J of both nodes of a rod, by the chain of its last degree of freedom; where that starts, and how many."""
    center, last = row_of(centers, rod[4]), rod[5]
    first, count = water.chains[last, 0], water.chains[last, 1]
    for end in range(2):
        offset = minus(row_of(nodes, rod[1 + end]), center)
        for d in range(count):
            put(J[end], d, carried_by(axes, water.chain[first + d], offset))
    return first, count


@inlined
def _free(
    rod: Any, nodes: Any, velocities: Any, centers: Any, twists: Any, axis_rates: Any, rates: Any, water: Any
) -> Any:
    """The rod's direction, and a⁰ of both its nodes."""
    x1, x2, center, last = row_of(nodes, rod[1]), row_of(nodes, rod[2]), row_of(centers, rod[4]), rod[5]
    spin, span = row_of(twists, rod[3]), minus(x2, x1)
    a1 = drifting(minus(x1, center), row_of(velocities, rod[1]), spin, last, axis_rates, rates, water)
    a2 = drifting(minus(x2, center), row_of(velocities, rod[2]), spin, last, axis_rates, rates, water)
    return times(1.0 / np.sqrt(dot(span, span)), span), a1, a2


@inlined
def _added(alpha: Any, axis: Any, a1: Any, a2: Any) -> Any:
    """Σ_j α_ij P a_j of both ends."""
    p1, p2 = minus(a1, times(dot(a1, axis), axis)), minus(a2, times(dot(a2, axis), axis))
    return plus(times(alpha[0], p1), times(alpha[1], p2)), plus(times(alpha[2], p1), times(alpha[3], p2))
