"""Linear constraints on nodes inside MuJoCo: the forces λ that keep weighted sums of nodes at their value.

Each tree of bodies gives what it accelerates by, and what it would for a unit of each λ (`answers`). With these the
rows' accelerations are S λ + what there is without λ, and λ is what makes them those of the prescribed values. Rows
that others imply get no force.

Accelerations alone let round-off and the integrator's error grow. So each step begins with the gap c of a row and its
rate ċ, and adds -(c/4h² + 7 ċ/8h) to the row's acceleration, the same at all stages: without other errors both are then
halved from step to step (a double root of 1/2 of what c and ċ become in a step h of constant acceleration). What is
added is of the order of the integrator's error, and constant over the step, so that RK4 keeps its order.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.dynamics.native.pointers import borrowing, floats, inlined
from tensegrity_mj.dynamics.native.vectors import add, cross, dot, minus, plus, row_of, times

OF_GAP, OF_RATE = 0.25, 0.875  # see above
DEPENDENT = 1e-12  # of `scales`, what other rows leave of a row's compliance: squares of singular values


class Links(NamedTuple):
    """Scratch of C constraints in a model of nv degrees of freedom.

    Attributes:
        forces: (C,) λ [N].
        closing: (C,) [m/s²] what closes the gaps.
        scales: (C,) [1/kg] what the compliance of each would be at the most: its terms without their directions.
        rows: (C, C + 1) S, and what is to be made up.
        answers: (nv, 1 + C) accelerations without λ, and of a unit of each.
    """

    forces: Array
    closing: Array
    scales: Array
    rows: Array
    answers: Array


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
    nodes, velocities, centers = run.nodes, run.velocities, run.subtree_com
    twists, axes, axis_rates, rates = run.cvel, run.cdof, run.cdof_dot, run.qvel
    count, start, right = len(links.forces), tree[0], A.shape[1] - len(links.forces)
    for d in range(tree[1]):
        for c in range(count):
            A[d, right + c] = 0.0
    for p in range(tree[6], tree[6] + tree[7]):
        row, node, last, pull = own.terms[p, 0], own.terms[p, 1], own.terms[p, 4], row_of(own.pulls, p)
        offset = minus(row_of(nodes, node), row_of(centers, own.terms[p, 3]))
        velocity, spin = row_of(velocities, node), row_of(twists, own.terms[p, 2])
        drift = drifting(offset, velocity, spin, last, axis_rates, rates, own)
        links.rows[row, count] -= dot(pull, drift)
        for e in range(own.chains[last, 0], own.chains[last, 0] + own.chains[last, 1]):
            d = own.chain[e]
            moves = carried_by(axes, d, offset)
            A[d - start, right + row] += dot(pull, moves)
            links.scales[row] += dot(pull, pull) * dot(moves, moves) / A[d - start, d - start]


@borrowing
def couple_rows(own: Any, tree: Any, links: Links, run: Any, A: Array) -> None:
    """Keep the answers of a tree, whose equations are solved, and add them to the rows."""
    nodes, centers, axes = run.nodes, run.subtree_com, run.cdof
    count, start, right = len(links.forces), tree[0], A.shape[1] - len(links.forces)
    for d in range(tree[1]):
        for c in range(count + 1):
            links.answers[start + d, c] = A[d, right - 1 + c]
    for p in range(tree[6], tree[6] + tree[7]):
        row, last, pull = own.terms[p, 0], own.terms[p, 4], row_of(own.pulls, p)
        offset = minus(row_of(nodes, own.terms[p, 1]), row_of(centers, own.terms[p, 3]))
        for e in range(own.chains[last, 0], own.chains[last, 0] + own.chains[last, 1]):
            d = own.chain[e]
            along = dot(pull, carried_by(axes, d, offset))
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
    for d in range(len(links.answers)):
        for c in range(count):
            links.answers[d, 0] += forces[c] * links.answers[d, 1 + c]


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
def carried_by(axes: Any, d: int, offset: Any) -> Any:
    """Velocity of a point per unit of a degree of freedom's, at an offset from the centre of mass of its tree."""
    turn, slide = row_of(axes, d), (axes[d, 3], axes[d, 4], axes[d, 5])
    return plus(slide, cross(turn, offset))


@inlined
def drifting(offset: Any, velocity: Any, spin: Any, last: int, axis_rates: Any, rates: Any, own: Any) -> Any:
    """a⁰ of a point of a body that this degree of freedom is the last to move."""
    found = cross(spin, velocity)
    for c in range(own.chains[last, 0], own.chains[last, 0] + own.chains[last, 1]):
        d = own.chain[c]
        found = plus(found, times(rates[d], carried_by(axis_rates, d, offset)))
    return found
