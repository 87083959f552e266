"""Where a target is at a time: set-points, and paths along great circles and straight lines with quintic timing."""

from __future__ import annotations

from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.dynamics.records import StructureRecords
from tensegrity_mj.native.pointers import address_of, floats, integers
from tensegrity_mj.scene import Target
from tensegrity_mj.structure import Structure

Array = NDArray[np.float64]
njit = numba.njit(cache=True, error_model="numpy")


class TargetArrays(NamedTuple):
    """A target as compiled code sees it: times (W,) [s] and node positions (W, N, 3) [m] of the waypoints."""

    times: Any
    nodes: Any


class PackedTarget:
    """The arrays of a target and a table of their addresses, to be kept alive while compiled code reads them."""

    def __init__(self, target: Target) -> None:
        self.arrays = TargetArrays(np.array(target.times, float), np.array(target.nodes, float))
        sizes = self.arrays.nodes.shape[:2]
        self.table = np.array([*sizes, *(address_of(array) for array in self.arrays)], np.int64)

    @property
    def address(self) -> int:
        """Of the table."""
        return address_of(self.table)


@njit
def read_target(address: int) -> Any:
    """The arrays of a `PackedTarget`."""
    table = integers(address, (4,))
    return TargetArrays(floats(table[2], (table[0],)), floats(table[3], (table[0], table[1], 3)))


@njit
def locate(t: float, times: Any) -> tuple[int, float, float, float]:
    """Segment, and the quintic s = 10 τ³ - 15 τ⁴ + 6 τ⁵ with its first two time derivatives; s = 0 when standing."""
    last = len(times) - 1
    if t <= times[0] or last == 0:
        return 0, 0.0, 0.0, 0.0
    if t >= times[last]:
        return last, 0.0, 0.0, 0.0
    k = int(np.searchsorted(times, t, side="right")) - 1
    span = times[k + 1] - times[k]
    x = (t - times[k]) / span
    s = x * x * x * (10.0 + x * (6.0 * x - 15.0))
    rate = 30.0 * x * x * (1.0 - x) * (1.0 - x) / span
    acc = 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / (span * span)
    return k, s, rate, acc


@njit
def along_line(start: Any, end: Any, s: float, rate: float, acc: float, out: Any) -> None:
    """Position, velocity and acceleration (3, 3) on the straight line from start to end."""
    for i in range(3):
        step = end[i] - start[i]
        out[0, i] = start[i] + s * step
        out[1, i] = rate * step
        out[2, i] = acc * step


@njit
def along_great_circle(start: Any, end: Any, s: float, rate: float, acc: float, out: Any) -> None:
    """The same for a unit vector turning from start to end (not opposite to it) on the great circle."""
    dot = start[0] * end[0] + start[1] * end[1] + start[2] * end[2]
    side = np.empty(3)
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


@njit
def rod_target(rod: Any, t: float, target: Any, r: Any, b: Any) -> None:
    """r and b of a rod's target (`TargetArrays`) with two derivatives each, (3, 3)."""
    times, nodes = target.times, target.nodes
    k, s, rate, acc = locate(t, times)
    m = min(k + 1, len(times) - 1)
    if rate == 0.0 and s == 0.0:
        _standing_target(rod, nodes[k], r, b)
        return
    ends = np.empty((2, 2, 3))
    for w in range(2):
        row = k if w == 0 else m
        length = 0.0
        for i in range(3):
            first, second = nodes[row, rod.i, i], nodes[row, rod.j, i]
            ends[w, 0, i] = (1.0 - rod.sigma) * first + rod.sigma * second
            ends[w, 1, i] = second - first
            length += (second - first) ** 2
        for i in range(3):
            ends[w, 1, i] /= np.sqrt(length)
    along_line(ends[0, 0], ends[1, 0], s, rate, acc, r)
    along_great_circle(ends[0, 1], ends[1, 1], s, rate, acc, b)


@njit
def _standing_target(rod: Any, nodes: Any, r: Any, b: Any) -> None:
    length = 0.0
    for i in range(3):
        first, second = nodes[rod.i, i], nodes[rod.j, i]
        r[0, i] = (1.0 - rod.sigma) * first + rod.sigma * second
        b[0, i] = second - first
        length += b[0, i] * b[0, i]
        r[1, i], r[2, i], b[1, i], b[2, i] = 0.0, 0.0, 0.0, 0.0
    for i in range(3):
        b[0, i] /= np.sqrt(length)


@njit
def point_target(point: Any, t: float, target: Any, r: Any) -> None:
    """Position of a point mass' target with two derivatives, (3, 3)."""
    times, nodes = target.times, target.nodes
    k, s, rate, acc = locate(t, times)
    m = min(k + 1, len(times) - 1)
    along_line(nodes[k, point.node], nodes[m, point.node], s, rate, acc, r)


@njit
def _target_nodes(times_out: Any, rods: Any, points: Any, target: Any, out: Any) -> None:
    r, b = np.empty((3, 3)), np.empty((3, 3))
    for n in range(len(times_out)):
        for a in range(len(rods)):
            rod = rods[a]
            rod_target(rod, times_out[n], target, r, b)
            for i in range(3):
                out[n, rod.i, i] = r[0, i] - rod.sigma * rod.length * b[0, i]
                out[n, rod.j, i] = r[0, i] + (1.0 - rod.sigma) * rod.length * b[0, i]
        for a in range(len(points)):
            point_target(points[a], times_out[n], target, r)
            for i in range(3):
                out[n, points[a].node, i] = r[0, i]


def target_nodes(structure: Structure, target: Target, times: Array) -> Array:
    """Node positions (T, N, 3) [m] of the target at the given times (T,)."""
    records = StructureRecords.of(structure)
    out = np.empty((len(times), len(structure.nodes), 3))
    out[:] = structure.positions
    _target_nodes(np.asarray(times, float), records.rods, records.points, PackedTarget(target).arrays, out)
    return out
