"""Position of a target at a time: set-points, paths along great circles and straight lines, curves of shapes.

All move by quintics in time, and all derivatives are exact.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.dynamics.kernels import place_ends
from tensegrity_mj.dynamics.native.compiling import c_function
from tensegrity_mj.dynamics.native.motion import piece_at
from tensegrity_mj.dynamics.native.pointers import borrowing, inlined
from tensegrity_mj.dynamics.native.vectors import ZERO, dot, minus, over, plus, put, row_of, times
from tensegrity_mj.dynamics.native.views import Table, view_of
from tensegrity_mj.dynamics.records import POINT, ROD, StructureRecords
from tensegrity_mj.model.ropes import completed
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.model.target import Target

# A target as compiled code sees it.
Aim, _pack_aim = view_of(
    "Target",
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


@inlined
def along_line(start: Any, end: Any, s: float, rate: float, acc: float) -> Any:
    """Position, velocity and acceleration on the straight line from start to end."""
    step = minus(end, start)
    return plus(start, times(s, step)), times(rate, step), times(acc, step)


@borrowing
def along_great_circle(start: Any, end: Any, s: float, rate: float, acc: float) -> Any:
    """Direction, its rate and acceleration on the great circle from start to end (not opposite to it)."""
    cosine = dot(start, end)
    side = minus(end, times(cosine, start))
    sine = np.sqrt(dot(side, side))
    if sine < 1e-14:
        return start, ZERO, ZERO
    angle = np.arctan2(sine, cosine)
    phi, phi_rate, phi_acc = s * angle, rate * angle, acc * angle
    cos, sin, e = np.cos(phi), np.sin(phi), over(side, sine)
    tangent, b = minus(times(cos, e), times(sin, start)), plus(times(cos, start), times(sin, e))
    return b, times(phi_rate, tangent), minus(times(phi_acc, tangent), times(phi_rate * phi_rate, b))


@borrowing
def _along_curve(t: float, target: Any, node: int) -> Any:
    """Position, velocity and acceleration of a node of a curve from its first to before its last time."""
    moments, quintics, shapes = target.times, target.quintics, target.shapes
    k = piece_at(t, moments, 0, len(moments))
    tau = t - moments[k]
    x, rate, acc = 0.0, 0.0, 0.0  # of the scaled parameter, by Horner
    for power in range(5, -1, -1):
        acc = acc * tau + 2.0 * rate
        rate = rate * tau + x
        x = x * tau + quintics[k, power]
    place, velocity, acceleration = ZERO, ZERO, ZERO
    # Chebyshev polynomials with two derivatives: T_n = 2 x T_{n-1} - T_{n-2}, differentiated.
    T, dT, ddT = 1.0, 0.0, 0.0
    back, d_back, dd_back = x, 1.0, 0.0  # T_{-1} = T_1 = x starts the recurrence with T_1 = 2 x T_0 - T_{-1}
    for p in range(len(shapes)):
        c = row_of(shapes[p], node)
        place = plus(place, times(T, c))
        velocity = plus(velocity, times(dT * rate, c))
        acceleration = plus(acceleration, times(ddT * rate * rate + dT * acc, c))
        T, dT, ddT, back, d_back, dd_back = (
            2.0 * x * T - back,
            2.0 * (T + x * dT) - d_back,
            2.0 * (2.0 * dT + x * ddT) - dd_back,
            T,
            dT,
            ddT,
        )
    return place, velocity, acceleration


@inlined
def _moves_on_curve(t: float, target: Any) -> bool:
    # With its rates from the first time on: a sample there sees how the curve goes on.
    return len(target.shapes) > 0 and target.times[0] <= t < target.times[-1]


@inlined
def _unit_with_derivatives(v: Any, v_rate: Any, v_acc: Any) -> Any:
    """v/‖v‖ with two derivatives, from v with two derivatives."""
    length = np.sqrt(dot(v, v))
    b = over(v, length)
    along, more = dot(b, v_rate), 0.0
    b_rate = over(minus(v_rate, times(along, b)), length)
    for i in range(3):
        more += b_rate[i] * v_rate[i] + b[i] * v_acc[i]
    # d/dt of ℓ ḃ = v̇ - (bᵀv̇) b, with ℓ̇ = bᵀv̇.
    return b, b_rate, over(minus(minus(v_acc, times(more, b)), times(2.0 * along, b_rate)), length)


@inlined
def _between(rod: Any, first: Any, second: Any) -> Any:
    """r of a rod between these places of its nodes, or its rate from theirs."""
    return plus(times(1.0 - rod.sigma, first), times(rod.sigma, second))


@borrowing
def _rod_on_curve(rod: Any, t: float, target: Any) -> Any:
    x1, v1, a1 = _along_curve(t, target, rod.i)
    x2, v2, a2 = _along_curve(t, target, rod.j)
    r = _between(rod, x1, x2), _between(rod, v1, v2), _between(rod, a1, a2)
    return r, _unit_with_derivatives(minus(x2, x1), minus(v2, v1), minus(a2, a1))


@borrowing
def rod_target(rod: Any, t: float, target: Any) -> Any:
    """r and b of a rod's target (an `Aim`), each with two derivatives."""
    if _moves_on_curve(t, target):
        return _rod_on_curve(rod, t, target)
    k, s, rate, acc = locate(t, target.times)
    r, b = _rod_at(rod, target.nodes[k])
    if rate == 0.0 and s == 0.0:
        return (r, ZERO, ZERO), (b, ZERO, ZERO)
    r_next, b_next = _rod_at(rod, target.nodes[min(k + 1, len(target.times) - 1)])
    return along_line(r, r_next, s, rate, acc), along_great_circle(b, b_next, s, rate, acc)


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


@inlined
def _rod_at(rod: Any, nodes: Any) -> tuple[Any, Any]:
    """r and b of a rod between nodes (N, 3)."""
    first, second = row_of(nodes, rod.i), row_of(nodes, rod.j)
    b = minus(second, first)
    return _between(rod, first, second), over(b, np.sqrt(dot(b, b)))


@borrowing
def point_target(point: Any, t: float, target: Any) -> Any:
    """Position of a point mass' target with two derivatives."""
    if _moves_on_curve(t, target):
        return _along_curve(t, target, point.node)
    k, s, rate, acc = locate(t, target.times)
    m = min(k + 1, len(target.times) - 1)
    return along_line(row_of(target.nodes[k], point.node), row_of(target.nodes[m], point.node), s, rate, acc)


_Places, _pack_places = view_of(
    "TargetPlaces",
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
    for n in range(own.count):
        for a in range(own.rod_count):
            r, b = rod_target(own.rods[a], own.times[n], target)
            place_ends(own.rods[a], r[0], b[0], out[n])
        for a in range(own.point_count):
            put(out[n], own.points[a].node, point_target(own.points[a], own.times[n], target)[0])
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
