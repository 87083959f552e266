"""Forces of contacts with friction, compiled: of one contact, and of several that feel each other.

In a frame of the floor's normal and two tangents, the contact's own acceleration without it is a⁰, and A is how that
answers a force f. With the acceleration that the law wants, aref, and the regularization R = diag(R_n, R_t, R_t),

    w = (A + R) f + c,      c = a⁰ - aref,

one of two laws holds (docs/contact.md):

    MUJOCO   f in the cone |f_t| <= μ f_n, w in its dual w_n >= μ |w_t|, f·w = 0: the minimum of a convex function
    COULOMB  w_n >= 0, f_n >= 0, f_n w_n = 0; |f_t| <= μ f_n, and where they are equal, f_t against w_t

What slides has f = s (1, μ e) with a unit vector e of one angle, which Newton's method finds: e × w_t = 0 in both laws,
and s from f·w = 0 or from w_n = 0. Symmetric matrices are tuples (nn, n1, n2, 11, 12, 22).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tensegrity_mj.dynamics.native.pointers import borrowing, floats, inlined
from tensegrity_mj.dynamics.native.vectors import ZERO, dot, plus, times
from tensegrity_mj.dynamics.native.views import changing_view, fields_of

MUJOCO, COULOMB = range(2)
FLOOR = fields_of(
    lowest=("f8", "rods", 2),  # normal · x of a rod's nodes at touch, -∞ of those that touch no floor
    ground=("f8", "points"),  # and of point masses
    frame=("f8", 3, 3),  # rows: the normal, upwards, and two tangents
    radii=("f8", "rods"),
    axial=("f8", "rods"),  # moments of inertia about the rods' own axes, 0 of those that do not turn about them
    spin_place="size",  # of their spins among the coordinates, -1 where none turns
    kind="size",  # the law
    friction="real",
    stiffness="real",
    damping="real",
    d0="real",
    d1="real",
    width="real",
    middle="real",
    power="real",
    per_ratio="real",  # R_t by R_n
    unsolved="state",  # contacts whose equations were not solved, so far
    beyond="state",  # states with more contacts than there is room for
    # Where rods touch each other: whether there is a floor as well; which do; and of the contacts of a state, of each
    # side, the rod (-1 for none), its part of the length, and ρ; gaps and frames; of each rod t_r and t_b, r̈ and b̈.
    there="size",
    pairs=("i8", "pair_count", 2),
    sides=("i8", "most", 2),
    parts=("f8", "most", 2),
    arms=("f8", "most", 2, 3),
    gaps=("f8", "most"),
    frames=("f8", "most", 3, 3),
    loads=("f8", "rods", 6),
    free=("f8", "rods", 6),
    room=("f8", "room_size"),
)
Floor = changing_view("Floor", FLOOR)
ANGLE_STEPS = 40  # Newton's take 3 to 6
CLOSE = 1e-9  # a step [rad] after which the angle is known to its square
SCANNED = 256  # directions that are tried where Newton's method does not come to the one that slides
HALVINGS = 60
FLAT = 0.1  # of the slope at its start, up to which a step is as long as it should be
ROUNDS, POLISH = 40, 40  # of several contacts: rounds of one after the other, and Newton's steps for all after each
STEADY = 1e-8  # a part of the forces: a step of Newton's as small is followed by one more, the last


@inlined
def impedance(law: Any, depth: float) -> float:
    """d(r) at a depth [m]."""
    x = min(depth / law.width, 1.0)
    low = x <= law.middle
    part = x / law.middle if low else (1.0 - x) / (1.0 - law.middle)
    raised = part * part if law.power == 2.0 else part**law.power
    share = law.middle * raised if low else 1.0 - (1.0 - law.middle) * raised
    return float(law.d0 + (law.d1 - law.d0) * share)


@inlined
def times_symmetric(H: Any, f: Any) -> tuple[float, float, float]:
    """H f"""
    return (
        H[0] * f[0] + H[1] * f[1] + H[2] * f[2],
        H[1] * f[0] + H[3] * f[1] + H[4] * f[2],
        H[2] * f[0] + H[4] * f[1] + H[5] * f[2],
    )


@inlined
def solved(H: Any, c: Any) -> tuple[float, float, float]:
    """-H⁻¹ c by L D Lᵀ."""
    l1, l2 = H[1] / H[0], H[2] / H[0]
    d1 = H[3] - l1 * H[1]
    k = H[4] - l1 * H[2]
    l3 = k / d1
    d2 = H[5] - l2 * H[2] - l3 * k
    x1 = -c[1] + l1 * c[0]
    x2 = (-c[2] + l2 * c[0] - l3 * x1) / d2
    x1 = x1 / d1 - l3 * x2
    return -c[0] / H[0] - l1 * x1 - l2 * x2, x1, x2


@inlined
def _sliding(law: Any, H: Any, c: Any, e1: float, e2: float) -> tuple[float, float, float, float]:
    """s of f = s (1, μ e), e × w_t, its derivative by the angle of e, and -e · w_t, which is >= 0 of what slides."""
    mu = law.friction
    u, across = (1.0, mu * e1, mu * e2), (0.0, -e2, e1)
    Hu, Hq = times_symmetric(H, u), times_symmetric(H, across)
    if law.kind == COULOMB:
        s = -c[0] / Hu[0]
        turned = -s * mu * Hq[0] / Hu[0]
    else:
        per = 1.0 / dot(u, Hu)
        s = -dot(u, c) * per
        turned = -mu * (dot(across, c) + 2.0 * s * dot(across, Hu)) * per
    w = plus(times(s, Hu), c)
    against = -(e1 * w[1] + e2 * w[2])
    slope = against + turned * dot(across, Hu) + s * mu * dot(across, Hq)
    return s, dot(across, w), slope, against


@inlined
def _turned(e1: float, e2: float, step: float) -> tuple[float, float]:
    """A unit vector turned by the angle of this tangent."""
    e1, e2 = e1 - step * e2, e2 + step * e1
    per = 1.0 / np.sqrt(e1 * e1 + e2 * e2)
    return e1 * per, e2 * per


@borrowing
def _slide(law: Any, H: Any, c: Any) -> tuple[float, float, float]:
    """The force of a contact that slides."""
    push = max(-c[0] / H[0], 0.0)
    e1, e2 = -c[1] - H[1] * push, -c[2] - H[2] * push  # against the slip without friction
    size = np.sqrt(e1 * e1 + e2 * e2)
    e1, e2 = (e1 / size, e2 / size) if size > 0.0 else (1.0, 0.0)
    step = 1.0
    for _ in range(ANGLE_STEPS):
        _, value, slope, _ = _sliding(law, H, c, e1, e2)
        step = -value / slope if slope > 0.0 else -np.sign(value)
        e1, e2 = _turned(e1, e2, step)
        if abs(step) <= CLOSE:
            break
    s, _, _, against = _sliding(law, H, c, e1, e2)
    if not (abs(step) <= CLOSE and s >= 0.0 and against >= 0.0):
        e1, e2 = _scan(law, H, c)
        s, _, _, _ = _sliding(law, H, c, e1, e2)
    return s, s * law.friction * e1, s * law.friction * e2


@borrowing
def _scan(law: Any, H: Any, c: Any) -> tuple[float, float]:
    """The direction that slides, between two of many; where there is none, (1, 0) and one more that is not solved."""
    e1, e2 = 1.0, 0.0
    step = np.tan(2.0 * np.pi / SCANNED)
    s, value, _, _ = _sliding(law, H, c, e1, e2)
    for _ in range(SCANNED):
        a1, a2, was, pushed = e1, e2, value, s
        e1, e2 = _turned(e1, e2, step)
        s, value, _, _ = _sliding(law, H, c, e1, e2)
        if was <= 0.0 < value and (s > 0.0 or pushed > 0.0):
            b1, b2 = e1, e2
            for _ in range(HALVINGS):
                m1, m2 = a1 + b1, a2 + b2
                per = 1.0 / np.sqrt(m1 * m1 + m2 * m2)
                m1, m2 = m1 * per, m2 * per
                if _sliding(law, H, c, m1, m2)[1] <= 0.0:
                    a1, a2 = m1, m2
                else:
                    b1, b2 = m1, m2
            found, _, _, against = _sliding(law, H, c, a1, a2)
            if found >= 0.0 and against >= 0.0:
                return a1, a2
    law.unsolved += 1
    return 1.0, 0.0


@borrowing
def push(law: Any, H: Any, c: Any) -> tuple[float, float, float]:
    """The force of one contact, for H = A + R: it is apart, or sticks, or slides."""
    mu = law.friction
    if mu == 0.0:
        return max(-c[0] / H[0], 0.0), 0.0, 0.0
    enough = 0.0 if law.kind == COULOMB else mu * np.sqrt(c[1] * c[1] + c[2] * c[2])
    if c[0] >= enough:
        return ZERO
    f = solved(H, c)
    if f[0] > 0.0 and f[1] * f[1] + f[2] * f[2] <= mu * mu * f[0] * f[0]:
        return f
    return _slide(law, H, c)


@inlined
def _response(law: Any, R: Any, y: Any) -> tuple[float, float, float]:
    """The force f(y) that w = y + R f and the law give for an acceleration y."""
    mu, n, t = law.friction, R[0], R[1]
    slip, coulomb = np.sqrt(y[1] * y[1] + y[2] * y[2]), law.kind == COULOMB
    if y[0] >= (0.0 if coulomb else mu * slip):
        return ZERO
    if mu > 0.0 and slip * n <= -mu * t * y[0]:
        return -y[0] / n, -y[1] / t, -y[2] / t
    s = -y[0] / n if coulomb else (mu * slip - y[0]) / (n + mu * mu * t)
    across = -mu * s / slip if slip > 0.0 else 0.0
    return s, across * y[1], across * y[2]


@inlined
def _put_slope(G: Any, at: int, law: Any, R: Any, y: Any) -> None:
    """Write the derivative of f(y), rows from `at` on."""
    mu, n, t = law.friction, R[0], R[1]
    slip, coulomb = np.sqrt(y[1] * y[1] + y[2] * y[2]), law.kind == COULOMB
    for i in range(3):
        for j in range(3):
            G[at + i, j] = 0.0
    if y[0] >= (0.0 if coulomb else mu * slip):
        return
    if mu > 0.0 and slip * n <= -mu * t * y[0]:
        G[at, 0], G[at + 1, 1], G[at + 2, 2] = -1.0 / n, -1.0 / t, -1.0 / t
        return
    e1, e2 = (-y[1] / slip, -y[2] / slip) if slip > 0.0 else (0.0, 0.0)
    per = 1.0 / n if coulomb else 1.0 / (n + mu * mu * t)
    s = per * (-y[0] if coulomb else mu * slip - y[0])
    across = mu * s / slip if slip > 0.0 else 0.0
    slow1, slow2 = (0.0, 0.0) if coulomb else (-mu * per * e1, -mu * per * e2)  # of s by y_t
    G[at, 0], G[at, 1], G[at, 2] = -per, slow1, slow2
    G[at + 1, 0], G[at + 2, 0] = -mu * e1 * per, -mu * e2 * per
    G[at + 1, 1] = mu * e1 * slow1 - across * e2 * e2
    G[at + 1, 2] = mu * e1 * slow2 + across * e1 * e2
    G[at + 2, 1] = mu * e2 * slow1 + across * e1 * e2
    G[at + 2, 2] = mu * e2 * slow2 - across * e1 * e1


@borrowing
def _eliminate(K: Any, x: Any) -> None:
    """Solve K x = x in place, with pivots."""
    m = len(x)
    for k in range(m):
        best = k
        for i in range(k + 1, m):
            if abs(K[i, k]) > abs(K[best, k]):
                best = i
        if best != k:
            for j in range(k, m):
                K[k, j], K[best, j] = K[best, j], K[k, j]
            x[k], x[best] = x[best], x[k]
        for i in range(k + 1, m):
            part = K[i, k] / K[k, k]
            if part != 0.0:
                for j in range(k, m):
                    K[i, j] -= part * K[k, j]
                x[i] -= part * x[k]
    for k in range(m - 1, -1, -1):
        for j in range(k + 1, m):
            x[k] -= K[k, j] * x[j]
        x[k] /= K[k, k]


@inlined
def three(f: Any, at: int) -> tuple[float, float, float]:
    """Three numbers of an array from a place on."""
    return f[at], f[at + 1], f[at + 2]


@inlined
def _acceleration(A: Any, c: Any, at: int, f: Any) -> tuple[float, float, float]:
    """The three rows from `at` on of A f + c."""
    y0, y1, y2 = three(c, at)
    for j in range(len(f)):
        y0, y1, y2 = y0 + A[at, j] * f[j], y1 + A[at + 1, j] * f[j], y2 + A[at + 2, j] * f[j]
    return y0, y1, y2


def room_size(contacts: int) -> int:
    """Count of numbers that `system` needs."""
    m = 3 * contacts
    return m * (2 * m + 9)


@inlined
def system(at: int, contacts: int) -> Any:
    """A (m, m), c, R and f (m,) of m = 3 contacts equations, and room to solve them, at an address."""
    m = 3 * contacts
    A, K, G = floats(at, (m, m)), floats(at + 8 * m * m, (m, m)), floats(at + 16 * m * m, (m, 3))
    at += 8 * m * (2 * m + 3)
    c, R, f = floats(at, m), floats(at + 8 * m, m), floats(at + 16 * m, m)
    return A, c, R, f, K, G, floats(at + 24 * m, m), floats(at + 32 * m, m), floats(at + 40 * m, m)


@borrowing
def _descent(law: Any, equations: Any, part: float) -> float:
    """x·A (h - f(A h + c)) at h = g + part x: the slope along x of the convex function that MuJoCo's law minimizes."""
    A, c, R, _, _, _, x, g, h = equations
    for i in range(len(g)):
        h[i] = g[i] + part * x[i]
    slope = 0.0
    for at in range(0, len(g), 3):
        f = _response(law, three(R, at), _acceleration(A, c, at, h))
        for i in range(3):
            along = 0.0
            for j in range(len(g)):
                along += A[at + i, j] * x[j]
            slope += along * (h[at + i] - f[i])
    return slope


@borrowing
def _newton_step(law: Any, equations: Any) -> tuple[float, float]:
    """One of Newton's steps towards g = f(A g + c), no further than that function falls; its largest part, and that of
    the forces."""
    A, c, R, _, K, G, x, g, _ = equations
    m = len(g)
    for at in range(0, m, 3):
        y = _acceleration(A, c, at, g)
        _put_slope(G, at, law, three(R, at), y)
        x[at], x[at + 1], x[at + 2] = _response(law, three(R, at), y)
        for i in range(at, at + 3):
            x[i] -= g[i]
            for j in range(m):
                K[i, j] = -(G[i, 0] * A[at, j] + G[i, 1] * A[at + 1, j] + G[i, 2] * A[at + 2, j])
            K[i, i] += 1.0
    _eliminate(K, x)
    part, begin, end = 1.0, _descent(law, equations, 0.0), _descent(law, equations, 1.0)
    if begin < 0.0 and end > -FLAT * begin:
        low, high = 0.0, 1.0
        for _ in range(HALVINGS):
            part = 0.5 * (low + high)
            slope = _descent(law, equations, part)
            if abs(slope) <= -FLAT * begin:
                break
            if slope < 0.0:
                low = part
            else:
                high = part
    most, largest = 0.0, 0.0
    for i in range(m):
        g[i] += part * x[i]
        most, largest = max(most, abs(x[i])), max(largest, abs(g[i]))
    return most, largest


@inlined
def block(A: Any, R: Any, at: int) -> tuple[float, float, float, float, float, float]:
    """A + R of one of several contacts."""
    return (
        A[at, at] + R[at],
        A[at, at + 1],
        A[at, at + 2],
        A[at + 1, at + 1] + R[at + 1],
        A[at + 1, at + 2],
        A[at + 2, at + 2] + R[at + 2],
    )


@borrowing
def push_all(law: Any, equations: Any) -> None:
    """Forces f of contacts that feel each other, of a `system`.

    Each is solved with the others' forces as they are, which finds how all behave, and Newton's method for all takes it
    from there: by itself the former takes thousands of rounds where a rod that lies may slide along itself.
    """
    A, c, R, f, _, _, _, g, h = equations
    m = len(f)
    for i in range(m):
        f[i] = 0.0
    for _ in range(ROUNDS):
        for at in range(0, m, 3):
            for i in range(m):
                h[i] = f[i]
            h[at] = h[at + 1] = h[at + 2] = 0.0
            f[at], f[at + 1], f[at + 2] = push(law, block(A, R, at), _acceleration(A, c, at, h))
        for i in range(m):
            g[i] = f[i]
        for _ in range(POLISH):
            most, largest = _newton_step(law, equations)
            if most <= STEADY * largest:
                _newton_step(law, equations)
                for i in range(m):
                    f[i] = g[i]
                return
            if not most < np.inf:
                break
    law.unsolved += 1
