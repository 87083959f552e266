"""The equations of `touching` where rods touch each other as well: all contacts of a state are solved together.

Two rods touch where the nearest points of their axes are less than both radii apart, by -r: at p, in the middle of the
overlap, with a normal from the first rod to the second. Parallel axes, which have no nearest points, do so at both ends
of the part in which they lie side by side, as in MuJoCo: one contact would not carry a rod. A contact has two sides:
the second rod, on which the force acts, and the first, on which its opposite does; that with the floor has one.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tensegrity_mj.dynamics.contact import Floor, push_all, system, three
from tensegrity_mj.dynamics.kernels import (
    accelerate_points,
    direction_of,
    multiplier,
    rod_accelerations,
    rod_forces,
    stretch_term,
    write_coordinates,
)
from tensegrity_mj.dynamics.native.pointers import address, borrowing, inlined
from tensegrity_mj.dynamics.native.vectors import ZERO, cross, dot, minus, over, plus, put, row_of, times
from tensegrity_mj.dynamics.touching import (
    by_unit_force,
    count_contact,
    felt,
    floor_gaps,
    in_frame,
    moved,
    note,
    of_frame,
    push_points,
    rate_of_r,
    wanted,
)

PARALLEL = 1e-8  # of both lengths' squares: axes with less of an area's square between them are parallel; MuJoCo's


@inlined
def _part(x: Any, u: Any, point: Any) -> float:
    """Place on a segment, from x along u, that is nearest to a point: a part of its length."""
    return min(max(dot(u, minus(point, x)) / dot(u, u), 0.0), 1.0)


@inlined
def _across(u: Any, w: Any) -> float:
    """Square of the sine between two directions: 0 of parallel ones."""
    area = cross(u, w)
    return dot(area, area) / (dot(u, u) * dot(w, w))


@inlined
def _nearest(x1: Any, u: Any, x2: Any, w: Any) -> tuple[float, float]:
    """Places on two segments, from x along u and w, that are nearest to each other: parts of their lengths."""
    apart = minus(x1, x2)
    uu, ww, uw, ua, wa = dot(u, u), dot(w, w), dot(u, w), dot(u, apart), dot(w, apart)
    s = min(max((uw * wa - ww * ua) / (uu * ww - uw * uw), 0.0), 1.0)
    t = _part(x2, w, plus(x1, times(s, u)))
    return _part(x1, u, plus(x2, times(t, w))), t


@inlined
def _meet(floor: Any, count: int, pair: Any, between: Any, parts: tuple[float, float], side: Any) -> int:
    """Add what two rods have in touch where their axes are `between` apart; `side`: the normal where that is 0."""
    radii, gaps = floor.radii, floor.gaps
    a, o = pair
    distance = np.sqrt(dot(between, between))
    gap = distance - radii[a] - radii[o]
    if gap >= 0.0 or count == len(gaps):
        return count
    between = between if distance > 0.0 else side
    normal = over(between, np.sqrt(dot(between, between)))
    floor.sides[count, 0], floor.sides[count, 1], gaps[count] = a, o, gap
    floor.parts[count, 0], floor.parts[count, 1] = parts
    put(floor.arms[count], 0, times(radii[a] + 0.5 * gap, normal))
    put(floor.arms[count], 1, times(-(radii[o] + 0.5 * gap), normal))
    _put_frame(floor.frames, count, normal)
    return count + 1


@inlined
def _square_to(n: Any) -> tuple[float, float, float]:
    """Any unit vector that is square to this one."""
    first = cross(n, (1.0, 0.0, 0.0) if abs(n[0]) < 0.6 else (0.0, 1.0, 0.0))
    return over(first, np.sqrt(dot(first, first)))


@inlined
def _put_frame(frames: Any, k: int, n: Any) -> None:
    """A frame of a normal and any two tangents."""
    first = _square_to(n)
    put(frames[k], 0, n)
    put(frames[k], 1, first)
    put(frames[k], 2, cross(n, first))


@borrowing
def _find(own: Any, floor: Any) -> int:
    """Find what touches: sides, places and frames of the contacts; how many they are."""
    rods, nodes, radii, count = own.rods, own.nodes, floor.radii, 0
    sides, parts, arms, gaps, frames = floor.sides, floor.parts, floor.arms, floor.gaps, floor.frames
    n = row_of(floor.frame, 0)
    if floor.there:
        for a in range(len(rods)):
            heights = floor_gaps(floor, a, rods[a], nodes)
            for end in range(2):
                gap = heights[end]
                if gap < 0.0 and count < len(gaps):
                    sides[count, 0], sides[count, 1], parts[count, 1], gaps[count] = -1, a, end, gap
                    put(arms[count], 1, times(-(radii[a] + 0.5 * gap), n))
                    for row in range(3):
                        put(frames[count], row, row_of(floor.frame, row))
                    count += 1
    for k in range(len(floor.pairs)):
        a, o = floor.pairs[k, 0], floor.pairs[k, 1]
        x1, x2 = row_of(nodes, rods[a].i), row_of(nodes, rods[o].i)
        u, w = minus(row_of(nodes, rods[a].j), x1), minus(row_of(nodes, rods[o].j), x2)
        parallel = _across(u, w) <= PARALLEL
        for end in range(2 if parallel else 1):
            if parallel:
                # An end of the second rod and where the first is nearest to it; beyond the first, the other way round.
                t = float(end)
                s = _part(x1, u, plus(x2, times(t, w)))
                t = t if 0.0 < s < 1.0 else _part(x2, w, plus(x1, times(s, u)))
            else:
                s, t = _nearest(x1, u, x2, w)
            between = minus(plus(x2, times(t, w)), plus(x1, times(s, u)))
            # Where a fast rod has come through the end of another, its axis may be in that of the other.
            side = _square_to(over(u, np.sqrt(dot(u, u)))) if parallel else cross(u, w)
            count = _meet(floor, count, (a, o), between, (s, t), side)
    return count


@borrowing
def _side(own: Any, floor: Any, q: Any, rates: Any, k: int, side: int) -> Any:
    """b, ḃ, the spin, the lever and ρ of one side of a contact."""
    a = floor.sides[k, side]
    rod = own.rods[a]
    b, b_rate = direction_of(rod, q, rod.q + rod.nz), direction_of(rod, rates, rod.q + rod.nz)
    spin = rates[floor.spin_place + a] if floor.spin_place >= 0 else 0.0
    return b, b_rate, spin, rod.length * (floor.parts[k, side] - rod.sigma), row_of(floor.arms[k], side)


@borrowing
def _pose(own: Any, floor: Any, q: Any, rates: Any, count: int) -> Any:
    """The equations of all contacts, for the accelerations without them in `floor.free`."""
    equations = system(address(floor.room), count)
    A, c, R = equations[0], equations[1], equations[2]
    for k in range(count):
        v, free, frame = ZERO, ZERO, floor.frames[k]
        for column in range(3 * k, 3 * k + 3):
            for row in range(3 * count):
                A[row, column] = 0.0
        for side in range(2):
            a, sign = floor.sides[k, side], 2.0 * side - 1.0
            if a < 0:
                continue
            rod, known = own.rods[a], floor.free[a]
            b, b_rate, spin, lever, rho = _side(own, floor, q, rates, k, side)
            r_rate = rate_of_r(own, rod, b_rate)
            v = plus(v, times(sign, moved(lever, rho, b, r_rate, b_rate, spin)))
            b_turn = minus(three(known, 3), times(dot(b, three(known, 3)) / dot(b, b), b))
            own_free = moved(lever, rho, b, three(known, 0), b_turn, 0.0)
            own_free = plus(own_free, times(spin, cross(b_rate, plus(times(lever, b), rho))))
            free = plus(free, times(sign, own_free))
            for x in range(3):
                force = times(sign, row_of(frame, x))
                r_part, b_part, s_part = by_unit_force(rod, floor.axial[a], b, lever, rho, force)
                for other in range(count):
                    for face in range(2):
                        if floor.sides[other, face] == a:
                            at = rod.length * (floor.parts[other, face] - rod.sigma)
                            there = moved(at, row_of(floor.arms[other], face), b, r_part, b_part, s_part)
                            there = in_frame(floor.frames[other], times(2.0 * face - 1.0, there))
                            for i in range(3):
                                A[3 * other + i, 3 * k + x] += there[i]
        d, aref = wanted(floor, floor.gaps[k], in_frame(frame, v))
        lacking = minus(in_frame(frame, free), aref)
        c[3 * k], c[3 * k + 1], c[3 * k + 2] = lacking
        A[3 * k, 3 * k] = felt(A[3 * k, 3 * k], own.rods[floor.sides[k, 1]].mass)
        R[3 * k] = (1.0 - d) / d * A[3 * k, 3 * k]
        R[3 * k + 1] = R[3 * k + 2] = R[3 * k] * floor.per_ratio
    return equations


@borrowing
def crowded_accelerations(own: Any, q: Any, rates: Any, out: Any) -> float:
    """See `touching_accelerations`."""
    rods, multipliers, floor, power = own.rods, own.multipliers, Floor(own.floor), 0.0
    loads, free, turning = floor.loads, floor.free, floor.spin_place
    for k in range(own.rod_count, len(multipliers)):
        multipliers[k] = 0.0
    for a in range(len(rods)):
        rod = rods[a]
        b, b_rate = direction_of(rod, q, rod.q + rod.nz), direction_of(rod, rates, rod.q + rod.nz)
        t_r, t_b = rod_forces(rod, own.forces, own.gravity)
        if turning >= 0:
            out[turning + a] = 0.0
            t_b = plus(t_b, times(floor.axial[a] * rates[turning + a], cross(b, b_rate)))
        c = stretch_term(rod, b, b_rate, own.kp, own.kd)
        r_acc, b_acc = rod_accelerations(rod, b, c, t_r, t_b)
        for x in range(3):
            loads[a, x], loads[a, 3 + x], free[a, x], free[a, 3 + x] = t_r[x], t_b[x], r_acc[x], b_acc[x]
    count = _find(own, floor)
    if count == len(floor.gaps):
        floor.beyond += 1
    if count > 0:
        equations = _pose(own, floor, q, rates, count)
        push_all(floor, equations)
        for k in range(count):
            force, normal = of_frame(floor.frames[k], three(equations[3], 3 * k)), equations[3][3 * k]
            count_contact(own, floor.gaps[k], normal)
            for side in range(2):
                a = floor.sides[k, side]
                if a < 0:
                    continue
                b, b_rate, _, lever, rho = _side(own, floor, q, rates, k, side)
                rod, on, s = rods[a], times(2.0 * side - 1.0, force), floor.parts[k, side]
                note(own, 2 * a, times(1.0 - s, on))
                note(own, 2 * a + 1, times(s, on))
                couple = cross(rho, on)
                turning_force = plus(times(lever, on), cross(couple, b))
                for x in range(3):
                    loads[a, x] += on[x]
                    loads[a, 3 + x] += turning_force[x]
                if turning >= 0 and floor.axial[a] > 0.0:
                    out[turning + a] += dot(b, couple) / floor.axial[a]
                r_rate = rate_of_r(own, rod, b_rate)
                power += dot(on, moved(lever, rho, b, r_rate, b_rate, 0.0))
    for a in range(len(rods)):
        rod = rods[a]
        b, b_rate = direction_of(rod, q, rod.q + rod.nz), direction_of(rod, rates, rod.q + rod.nz)
        c, t_b = stretch_term(rod, b, b_rate, own.kp, own.kd), three(loads[a], 3)
        r_acc, b_acc = rod_accelerations(rod, b, c, three(loads[a], 0), t_b)
        multipliers[a] = multiplier(rod, b, c, r_acc, t_b)
        write_coordinates(rod, rod.nz, r_acc, b_acc, out)
    if floor.there:
        power += push_points(own)
    accelerate_points(own.forces, own.points, own.gravity, out)
    return power
