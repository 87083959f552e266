"""The equations of `kernels` for rods and point masses that touch a floor, and the forces of contacts.

A rod's half ball, of its radius about a node, is r = n·x - level - radius above the floor, with n upwards. Where r < 0
it touches at p = x - n (radius + r/2), ρ = p - x from the node. A point of the rod there moves with v = ẋ + ω × ρ,
ω = b × ḃ + s b, b being a unit vector and s the spin about the rod's own axis, and a force f there acts on b as a
couple does by (ρ × f) × b. Where spin is held s = 0, and what is along b turns nothing. Where it is free,

    I s' = b · (ρ × f),      t_b gets I s b × ḃ,      I the rod's axial moment of inertia,

which does no work on b. The angle that belongs to s is a coordinate behind the others, which nothing depends on.
"""

from __future__ import annotations

from typing import Any

from tensegrity_mj.dynamics.contact import (
    COULOMB,
    Floor,
    block,
    impedance,
    push,
    push_all,
    room_size,
    system,
    three,
)
from tensegrity_mj.dynamics.kernels import (
    accelerate_points,
    direction_of,
    multiplier,
    rod_accelerations,
    rod_forces,
    stretch_term,
    write_coordinates,
)
from tensegrity_mj.dynamics.native.pointers import borrowing, inlined, stack_doubles
from tensegrity_mj.dynamics.native.vectors import (
    ZERO,
    add,
    column_of,
    cross,
    dot,
    minus,
    over,
    plus,
    row_of,
    times,
    vector,
)

ROOM_OF_TWO = room_size(2)
LEAST = 1e-9  # of 1/m: what answers a force by less is held there


@inlined
def felt(a: float, mass: float) -> float:
    """A_nn of a contact [1/kg]; of what is held there so much that no force acts, which would move nothing."""
    return a if a > LEAST / mass else 1.0 / (LEAST * mass)


@inlined
def in_frame(frame: Any, v: Any) -> tuple[float, float, float]:
    """Components of a vector by the frame's rows: along the normal, and along both tangents."""
    return dot(row_of(frame, 0), v), dot(row_of(frame, 1), v), dot(row_of(frame, 2), v)


@inlined
def of_frame(frame: Any, f: Any) -> tuple[float, float, float]:
    """The vector of these components."""
    return plus(plus(times(f[0], row_of(frame, 0)), times(f[1], row_of(frame, 1))), times(f[2], row_of(frame, 2)))


@inlined
def moved(lever: float, rho: Any, b: Any, r_part: Any, b_part: Any, spin: float) -> tuple[float, float, float]:
    """Velocity of a rod's point of contact of ṙ, ḃ and s, or what its acceleration has of r̈, b̈ and s'."""
    return plus(plus(r_part, times(lever, b_part)), cross(plus(cross(b, b_part), times(spin, b)), rho))


@inlined
def wanted(law: Any, gap: float, v: Any) -> tuple[float, Any]:
    """d of a contact, and aref in the frame: -damping/d₁ v, and -stiffness d/d₁² r along the normal."""
    d = impedance(law, -gap)
    rate = law.damping / law.d1
    return d, (-rate * v[0] - law.stiffness * d / (law.d1 * law.d1) * gap, -rate * v[1], -rate * v[2])


@inlined
def by_unit_force(rod: Any, axial: float, b: Any, lever: float, rho: Any, direction: Any) -> tuple[Any, Any, float]:
    """r̈, b̈ and s' of a unit force at a point of contact."""
    couple = cross(rho, direction)
    r_part, b_part = rod_accelerations(rod, b, 0.0, direction, plus(times(lever, direction), cross(couple, b)))
    return r_part, b_part, dot(b, couple) / axial if axial > 0.0 else 0.0


@inlined
def _lever(rod: Any, end: int) -> float:
    return float(rod.length * (end - rod.sigma))


@inlined
def rate_of_r(own: Any, rod: Any, b_rate: Any) -> Any:
    """ṙ of a rod, from its first node's velocity."""
    return minus(row_of(own.velocities, rod.i), times(_lever(rod, 0), b_rate))


@inlined
def floor_gaps(law: Any, a: int, rod: Any, nodes: Any) -> tuple[float, float]:
    """Heights of both half balls of a rod above the floor [m]."""
    n = row_of(law.frame, 0)
    return dot(n, row_of(nodes, rod.i)) - law.lowest[a, 0], dot(n, row_of(nodes, rod.j)) - law.lowest[a, 1]


@borrowing
def push_rod(own: Any, a: int, rod: Any, b: Any, b_rate: Any, spin: float, r_acc: Any, b_acc: Any) -> Any:
    """Contributions of a rod's contacts to t_r, t_b and s', and their power [W] but for that on the spin.

    `r_acc`, `b_acc`: accelerations without them.
    """
    law, nodes = Floor(own.floor), own.nodes
    frame, radius, axial = law.frame, law.radii[a], law.axial[a]
    n = row_of(frame, 0)
    t_r, t_b, power, spun = ZERO, ZERO, 0.0, 0.0
    gaps = floor_gaps(law, a, rod, nodes)
    count, first = 0, 0
    equations = system(stack_doubles(ROOM_OF_TWO), 2)
    A, c, R, f = equations[0], equations[1], equations[2], equations[3]
    # MuJoCo leaves out what q̇ adds to an acceleration: of the node about r, and of ρ.
    exact = law.kind == COULOMB
    b_turn = b_acc if exact else minus(b_acc, times(dot(b, b_acc) / dot(b, b), b))
    r_rate = rate_of_r(own, rod, b_rate)
    for end in range(2):
        gap = gaps[end]
        if gap >= 0.0:
            continue
        at, lever = 3 * count, _lever(rod, end)
        first = end if count == 0 else first
        rho = times(-(radius + 0.5 * gap), n)
        v = moved(lever, rho, b, r_rate, b_rate, spin)
        free = moved(lever, rho, b, r_acc, b_turn, 0.0)
        if exact:
            turn, node = plus(cross(b, b_rate), times(spin, b)), plus(r_rate, times(lever, b_rate))
            free = plus(free, cross(turn, times(-0.5 * dot(n, node), n)))
            free = plus(free, times(spin, cross(b_rate, rho)))
        else:
            free = plus(free, times(spin, cross(b_rate, plus(times(lever, b), rho))))
        d, aref = wanted(law, gap, in_frame(frame, v))
        free = minus(in_frame(frame, free), aref)
        for k in range(3):
            c[at + k] = free[k]
            r_part, b_part, s_part = by_unit_force(rod, axial, b, lever, rho, row_of(frame, k))
            for other in range(count + 1):
                place = first if other == 0 else end
                there = times(-(radius + 0.5 * gaps[place]), n)
                column = in_frame(frame, moved(_lever(rod, place), there, b, r_part, b_part, s_part))
                for i in range(3):
                    A[3 * other + i, at + k] = column[i]
                    A[at + k, 3 * other + i] = column[i]
        A[at, at] = felt(A[at, at], rod.mass)
        R[at] = (1.0 - d) / d * A[at, at]
        R[at + 1] = R[at + 2] = R[at] * law.per_ratio
        count += 1
    if count == 2:
        push_all(law, equations)
    else:
        f[0], f[1], f[2] = push(law, block(A, R, 0), three(c, 0))
    count = 0
    for end in range(2):
        if gaps[end] >= 0.0:
            continue
        force, lever = of_frame(frame, three(f, 3 * count)), _lever(rod, end)
        note(own, 2 * a + end, force)
        count_contact(own, gaps[end], f[3 * count])
        count += 1
        rho = times(-(radius + 0.5 * gaps[end]), n)
        t_r = plus(t_r, force)
        couple = cross(rho, force)
        t_b = plus(t_b, plus(times(lever, force), cross(couple, b)))
        spun += dot(b, couple) / axial if axial > 0.0 else 0.0
        power += dot(force, moved(lever, rho, b, r_rate, b_rate, 0.0))
    return t_r, t_b, spun, power


@inlined
def note(own: Any, place: int, force: Any) -> None:
    """Add to a force behind λ."""
    for x in range(3):
        own.multipliers[own.rod_count + 3 * place + x] += force[x]


@inlined
def count_contact(own: Any, gap: float, normal: float) -> None:
    """Count a contact: how many there are, the largest normal force, and the largest depth, at the end behind λ."""
    seen, last = own.multipliers, len(own.multipliers)
    seen[last - 3] += 1.0
    seen[last - 2], seen[last - 1] = max(seen[last - 2], normal), max(seen[last - 1], -gap)


@borrowing
def touching_accelerations(own: Any, q: Any, rates: Any, out: Any) -> float:
    """q̈ and λ as `accelerations` has them, with contact; the contacts' forces [N] behind λ, and their power [W].

    `own` also has the nodes' places and velocities, and the address of a `floor`.
    """
    rods, gravity, kp, kd, power = own.rods, own.gravity, own.kp, own.kd, 0.0
    multipliers, nodes, floor = own.multipliers, own.nodes, Floor(own.floor)
    turning = floor.spin_place
    for k in range(own.rod_count, len(multipliers)):
        multipliers[k] = 0.0
    for a in range(len(rods)):
        rod = rods[a]
        b, b_rate = direction_of(rod, q, rod.q + rod.nz), direction_of(rod, rates, rod.q + rod.nz)
        t_r, t_b = rod_forces(rod, own.forces, gravity)
        c, spin = stretch_term(rod, b, b_rate, kp, kd), 0.0
        if turning >= 0:
            spin, out[turning + a] = rates[turning + a], 0.0
            t_b = plus(t_b, times(floor.axial[a] * spin, cross(b, b_rate)))
        r_acc, b_acc = rod_accelerations(rod, b, c, t_r, t_b)
        if min(floor_gaps(floor, a, rod, nodes)) < 0.0:
            more_r, more_b, spun, given = push_rod(own, a, rod, b, b_rate, spin, r_acc, b_acc)
            if turning >= 0:
                out[turning + a] = spun
            t_r, t_b, power = plus(t_r, more_r), plus(t_b, more_b), power + given
            r_acc, b_acc = rod_accelerations(rod, b, c, t_r, t_b)
        multipliers[a] = multiplier(rod, b, c, r_acc, t_b)
        write_coordinates(rod, rod.nz, r_acc, b_acc, out)
    power += push_points(own)
    accelerate_points(own.forces, own.points, gravity, out)
    return power


@borrowing
def push_points(own: Any) -> float:
    """Add contact forces to those on point masses; their power [W]."""
    law, points, power = Floor(own.floor), own.points, 0.0
    frame = law.frame
    n = row_of(frame, 0)
    for p in range(len(points)):
        point = points[p]
        gap = dot(n, row_of(own.nodes, point.node)) - law.ground[p]
        if gap >= 0.0:
            continue
        pull = plus(over(row_of(own.forces, point.node), point.mass), vector(own.gravity))
        v = row_of(own.velocities, point.node)
        d, aref = wanted(law, gap, in_frame(frame, v))
        c = minus(in_frame(frame, _along(point, pull)), aref)
        a0 = in_frame(frame, _along(point, over(row_of(frame, 0), point.mass)))
        a1 = in_frame(frame, _along(point, over(row_of(frame, 1), point.mass)))
        a2 = in_frame(frame, _along(point, over(row_of(frame, 2), point.mass)))
        own_a = felt(a0[0], point.mass)
        normal = (1.0 - d) / d * own_a
        tangent = normal * law.per_ratio
        H = (own_a + normal, a0[1], a0[2], a1[1] + tangent, a1[2], a2[2] + tangent)
        f = push(law, H, c)
        force = of_frame(frame, f)
        note(own, 2 * own.rod_count + p, force)
        count_contact(own, gap, f[0])
        add(own.forces, point.node, force)
        power += dot(force, v)
    return power


@inlined
def _along(point: Any, v: Any) -> tuple[float, float, float]:
    """E Eᵀ v"""
    own = ZERO
    for k in range(point.nz):
        column = column_of(point.E, k)
        own = plus(own, times(dot(column, v), column))
    return own
