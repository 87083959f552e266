"""Where a target is at a time: set-points, paths along great circles and straight lines, curves of shapes.

All move by quintics in time, and all derivatives are exact.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.dynamics.native.compiling import c_function
from tensegrity_mj.dynamics.native.motion import piece_at
from tensegrity_mj.dynamics.native.pointers import borrowing, floats, inlined, stack_doubles
from tensegrity_mj.dynamics.native.views import Table, view_of
from tensegrity_mj.dynamics.records import POINT, ROD, StructureRecords
from tensegrity_mj.model.ropes import completed
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.model.target import Target

# A target as compiled code sees it.
Aim, _pack_aim = view_of(
    "Target",
    count="size",
    node_count="size",
    piece_count="size",
    shape_count="size",
    times=("f8", "count"),  # [s]
    nodes=("f8", "count", "node_count", 3),  # [m] at these times
    # Of a curve's parameter, lowest power of t - times[k] first; scaled so that the shapes lie between -1 and 1.
    quintics=("f8", "piece_count", 6),
    shapes=("f8", "shape_count", "node_count", 3),  # Chebyshev coefficients of a curve [m]; none for other targets
)


def pack_target(target: Target) -> Table:
    """An `Aim`, to be kept alive while compiled code reads it."""
    times, nodes = np.array(target.times, float), np.array(target.nodes, float)
    if target.along is None:
        quintics, shapes = np.zeros((0, 6)), np.zeros((0, *nodes.shape[1:]))
    else:
        first, last = target.along.interval
        quintics = 2.0 * target.along.quintics(target.times) / (last - first)
        values = (2.0 * np.array(target.along.values[:-1]) - first - last) / (last - first)
        quintics[:, 0] = values
        shapes = target.along.coefficients
    return _pack_aim(times=times, nodes=nodes, quintics=quintics, shapes=shapes)


@inlined
def locate(t: float, times: Any) -> tuple[int, float, float, float]:
    """Segment, and the quintic s = 10 τ³ - 15 τ⁴ + 6 τ⁵ with its first two time derivatives; s = 0 when standing."""
    last = len(times) - 1
    if t <= times[0] or last == 0:
        return 0, 0.0, 0.0, 0.0
    if t >= times[last]:
        return last, 0.0, 0.0, 0.0
    k = piece_at(t, times, 0, len(times))
    span = times[k + 1] - times[k]
    x = (t - times[k]) / span
    s = x * x * x * (10.0 + x * (6.0 * x - 15.0))
    rate = 30.0 * x * x * (1.0 - x) * (1.0 - x) / span
    acc = 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / (span * span)
    return k, s, rate, acc


@borrowing
def along_line(start: Any, end: Any, s: float, rate: float, acc: float, out: Any) -> None:
    """Position, velocity and acceleration (3, 3) on the straight line from start to end."""
    for i in range(3):
        step = end[i] - start[i]
        out[0, i] = start[i] + s * step
        out[1, i] = rate * step
        out[2, i] = acc * step


@borrowing
def along_great_circle(start: Any, end: Any, s: float, rate: float, acc: float, out: Any) -> None:
    """The same for a unit vector turning from start to end (not opposite to it) on the great circle."""
    dot = start[0] * end[0] + start[1] * end[1] + start[2] * end[2]
    side = floats(stack_doubles(3), (3,))
    square = 0.0
    for i in range(3):
        side[i] = end[i] - dot * start[i]
        square += side[i] * side[i]
    sine = np.sqrt(square)
    if sine < 1e-14:
        for i in range(3):
            out[0, i], out[1, i], out[2, i] = start[i], 0.0, 0.0
        return
    angle = np.arctan2(sine, dot)
    phi, phi_rate, phi_acc = s * angle, rate * angle, acc * angle
    cos, sin = np.cos(phi), np.sin(phi)
    for i in range(3):
        e = side[i] / sine
        tangent = cos * e - sin * start[i]
        out[0, i] = cos * start[i] + sin * e
        out[1, i] = phi_rate * tangent
        out[2, i] = phi_acc * tangent - phi_rate * phi_rate * out[0, i]


@borrowing
def _along_curve(t: float, target: Any, node: int, out: Any) -> None:
    """Position, velocity and acceleration (3, 3) of a node of a curve from its first to before its last time."""
    times, quintics, shapes = target.times, target.quintics, target.shapes
    k = piece_at(t, times, 0, len(times))
    tau = t - times[k]
    x, rate, acc = 0.0, 0.0, 0.0  # of the scaled parameter, by Horner
    for power in range(5, -1, -1):
        acc = acc * tau + 2.0 * rate
        rate = rate * tau + x
        x = x * tau + quintics[k, power]
    for i in range(3):
        out[0, i], out[1, i], out[2, i] = 0.0, 0.0, 0.0
    # Chebyshev polynomials with two derivatives: T_n = 2 x T_{n-1} - T_{n-2}, differentiated.
    T, dT, ddT = 1.0, 0.0, 0.0
    back, d_back, dd_back = x, 1.0, 0.0  # T_{-1} = T_1 = x starts the recurrence with T_1 = 2 x T_0 - T_{-1}
    for p in range(len(shapes)):
        first = dT * rate
        second = ddT * rate * rate + dT * acc
        for i in range(3):
            c = shapes[p, node, i]
            out[0, i] += c * T
            out[1, i] += c * first
            out[2, i] += c * second
        T, dT, ddT, back, d_back, dd_back = (
            2.0 * x * T - back,
            2.0 * (T + x * dT) - d_back,
            2.0 * (2.0 * dT + x * ddT) - dd_back,
            T,
            dT,
            ddT,
        )


@inlined
def _moves_on_curve(t: float, target: Any) -> bool:
    # With its rates from the first time on: a sample there sees how the curve goes on.
    return len(target.shapes) > 0 and target.times[0] <= t < target.times[-1]


@borrowing
def _unit_with_derivatives(v: Any, b: Any) -> None:
    """b = v/‖v‖ with two derivatives (3, 3), from v with two derivatives."""
    square, dot, more = 0.0, 0.0, 0.0
    for i in range(3):
        square += v[0, i] * v[0, i]
    length = np.sqrt(square)
    for i in range(3):
        b[0, i] = v[0, i] / length
        dot += b[0, i] * v[1, i]
    for i in range(3):
        b[1, i] = (v[1, i] - dot * b[0, i]) / length
        more += b[1, i] * v[1, i] + b[0, i] * v[2, i]
    # d/dt of ℓ ḃ = v̇ - (bᵀv̇) b, with ℓ̇ = bᵀv̇.
    for i in range(3):
        b[2, i] = (v[2, i] - more * b[0, i] - 2.0 * dot * b[1, i]) / length


@borrowing
def _rod_on_curve(rod: Any, t: float, target: Any, r: Any, b: Any) -> None:
    work = floats(stack_doubles(27), (3, 3, 3))
    first, second, along = work[0], work[1], work[2]
    _along_curve(t, target, rod.i, first)
    _along_curve(t, target, rod.j, second)
    for order in range(3):
        for i in range(3):
            r[order, i] = (1.0 - rod.sigma) * first[order, i] + rod.sigma * second[order, i]
            along[order, i] = second[order, i] - first[order, i]
    _unit_with_derivatives(along, b)


@borrowing
def rod_target(rod: Any, t: float, target: Any, r: Any, b: Any) -> None:
    """r and b of a rod's target (an `Aim`) with two derivatives each, (3, 3)."""
    if _moves_on_curve(t, target):
        _rod_on_curve(rod, t, target, r, b)
        return
    times, nodes = target.times, target.nodes
    k, s, rate, acc = locate(t, times)
    m = min(k + 1, len(times) - 1)
    if rate == 0.0 and s == 0.0:
        _standing_target(rod, nodes[k], r, b)
        return
    ends = floats(stack_doubles(12), (2, 2, 3))
    for w in range(2):
        _rod_at(rod, nodes[k if w == 0 else m], ends[w, 0], ends[w, 1])
    along_line(ends[0, 0], ends[1, 0], s, rate, acc, r)
    along_great_circle(ends[0, 1], ends[1, 1], s, rate, acc, b)


@inlined
def standing_at(t: float, target: Any) -> int:
    """Number of the target's time at whose nodes it stands still at time t; -1 where it moves."""
    if _moves_on_curve(t, target):
        return -1
    k, s, rate, _acc = locate(t, target.times)
    return k if rate == 0.0 and s == 0.0 else -1


def standing_targets(rods: Any, points: Any, target: Table) -> Array:
    """r and b of every rod, and r of every point mass, where the target stands: (W, R + P, 2, 3)."""
    first, second = target["nodes"][:, rods["i"]], target["nodes"][:, rods["j"]]
    sigma = rods["sigma"][:, None]
    out = np.zeros((target["count"], len(rods) + len(points), 2, 3))
    out[:, : len(rods), 0] = (1.0 - sigma) * first + sigma * second
    b = second - first
    length = np.sqrt(b[..., 0] * b[..., 0] + b[..., 1] * b[..., 1] + b[..., 2] * b[..., 2])  # as compiled code adds
    out[:, : len(rods), 1] = b / length[..., None]
    out[:, len(rods) :, 0] = target["nodes"][:, points["node"]]
    return out


@borrowing
def _standing_target(rod: Any, nodes: Any, r: Any, b: Any) -> None:
    _rod_at(rod, nodes, r[0], b[0])
    for i in range(3):
        r[1, i], r[2, i], b[1, i], b[2, i] = 0.0, 0.0, 0.0, 0.0


@borrowing
def _rod_at(rod: Any, nodes: Any, r: Any, b: Any) -> None:
    """r and b (3,) of a rod between nodes (N, 3)."""
    length = 0.0
    for i in range(3):
        first, second = nodes[rod.i, i], nodes[rod.j, i]
        r[i] = (1.0 - rod.sigma) * first + rod.sigma * second
        b[i] = second - first
        length += b[i] * b[i]
    for i in range(3):
        b[i] /= np.sqrt(length)


@borrowing
def point_target(point: Any, t: float, target: Any, r: Any) -> None:
    """Position of a point mass' target with two derivatives, (3, 3)."""
    if _moves_on_curve(t, target):
        _along_curve(t, target, point.node, r)
        return
    times, nodes = target.times, target.nodes
    k, s, rate, acc = locate(t, times)
    m = min(k + 1, len(times) - 1)
    along_line(nodes[k, point.node], nodes[m, point.node], s, rate, acc, r)


_Places, _pack_places = view_of(
    "TargetPlaces",
    count="size",
    node_count="size",
    rod_count="size",
    point_count="size",
    target="size",  # address of an `Aim`
    times=("f8", "count"),
    rods=(ROD, "rod_count"),
    points=(POINT, "point_count"),
    nodes=("f8", "count", "node_count", 3),  # written
)


@c_function("int64(int64)", "the nodes of targets")
def _target_nodes(table):  # type: ignore[no-untyped-def]
    own = _Places(table)
    target, out = Aim(own.target), own.nodes
    r, b = floats(stack_doubles(9), (3, 3)), floats(stack_doubles(9), (3, 3))
    for n in range(own.count):
        for a in range(own.rod_count):
            rod = own.rods[a]
            rod_target(rod, own.times[n], target, r, b)
            for i in range(3):
                out[n, rod.i, i] = r[0, i] - rod.sigma * rod.length * b[0, i]
                out[n, rod.j, i] = r[0, i] + (1.0 - rod.sigma) * rod.length * b[0, i]
        for a in range(own.point_count):
            point_target(own.points[a], own.times[n], target, r)
            for i in range(3):
                out[n, own.points[a].node, i] = r[0, i]
    return 0


def target_nodes(structure: Structure, target: Target, times: Array) -> Array:
    """Node positions (T, N, 3) [m] of the target at the given times (T,); ropes, which have none, are straight."""
    light = structure.massless
    records, packed = StructureRecords.of(light), pack_target(target)
    out = np.empty((len(times), len(light.nodes), 3))
    out[:] = light.positions
    table = _pack_places(target=packed.address, times=times, rods=records.rods, points=records.points, nodes=out)
    _target_nodes(table.address)
    return completed(structure, out, structure.positions)


def target_positions(structure: Structure, target: Target | None, times: Array) -> Array | None:
    """Node positions (T, N, 3) [m] of a target at times (T,) [s]; None without a target."""
    if target is None:
        return None
    moments = np.atleast_1d(np.asarray(times, float))
    if len(target.times) == 1:
        nodes = completed(structure, target.nodes[0], structure.positions)
        return np.broadcast_to(nodes, (len(moments), *nodes.shape))

    return target_nodes(structure, target, moments)
