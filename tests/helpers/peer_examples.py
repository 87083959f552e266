"""Examples of STEDY and MOTES as their scripts state them, and their motion by a coding of its own.

A bar has the consistent mass matrix m/6 [2 1; 1 2] between its two nodes; lengths of rigid bars, held coordinates and
rows of N P = D are constraints, whose forces a least-squares solution of one dense system gives; SciPy integrates.
Nothing of the package is called.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import truth
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

Array = NDArray[np.float64]
Pairs = list[tuple[int, int]]  # of nodes, counted from 1 as there


@dataclass
class Example:
    """What a script states. `held` (N, 3) marks coordinates that stay; `P` (N, r) has the columns of N P = D."""

    nodes: Array
    bars: Pairs
    strings: Pairs
    stiffness: Array
    rest_lengths: Array
    damping: float = 0.0
    bar_masses: Array = field(default_factory=lambda: np.zeros(0))
    bar_stiffness: Array | None = None
    point_masses: dict[int, float] = field(default_factory=dict)
    held: Array | None = None
    P: Array | None = None
    gravity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    loads: Callable[[float], Array] = lambda t: np.zeros(3)  # (N, 3), or what adds to that
    velocities: Array | None = None

    def motion(self, times: Array, rtol: float = 1e-12) -> Array:
        """(T, N, 3) at rising times."""
        N = len(self.nodes)
        mass = np.zeros((N, N))
        for (i, j), m in zip(self.bars, self.bar_masses, strict=True):
            mass[np.ix_([i - 1, j - 1], [i - 1, j - 1])] += m / 6 * np.array([[2, 1], [1, 2]])
        for node, m in self.point_masses.items():
            mass[node - 1, node - 1] += m
        weights = mass.sum(axis=1)
        inverse = np.kron(np.linalg.inv(mass), np.eye(3))
        fixed = [np.eye(3 * N)[row] for row in np.flatnonzero(np.zeros(3 * N) if self.held is None else self.held)]
        fixed += [] if self.P is None else list(np.kron(self.P.T, np.eye(3)))
        starts = [np.linalg.norm(self.nodes[j - 1] - self.nodes[i - 1]) for i, j in self.bars]

        soft = self.bar_stiffness is not None
        members = np.array(self.strings + (self.bars if soft else []), int).reshape(-1, 2).T - 1
        bars = np.array([] if soft else self.bars, int).reshape(-1, 2).T - 1
        count, own = len(self.strings), [] if self.bar_stiffness is None else self.bar_stiffness
        k, L0 = np.concatenate([self.stiffness, own]), np.concatenate([self.rest_lengths, starts if soft else []])
        c = np.where(np.arange(len(k)) < count, self.damping, 0.0)
        held = np.array(fixed).reshape(-1, 3 * N)
        rows = np.arange(bars.shape[1])

        def rates(t: float, y: Array) -> Array:
            x, v = y.reshape(2, N, 3)
            force = weights[:, None] * np.array(self.gravity) + self.loads(t)
            i, j = members
            span = x[j] - x[i]
            length = np.sqrt(np.sum(span**2, axis=1))
            pull = k * (length - L0) + c * np.sum(span * (v[j] - v[i]), axis=1) / length
            pull[:count] = np.where(length[:count] > L0[:count], np.maximum(pull[:count], 0.0), 0.0)
            vectors = (pull / length)[:, None] * span
            np.add.at(force, i, vectors)
            np.subtract.at(force, j, vectors)
            i, j = bars
            span, rate = x[j] - x[i], v[j] - v[i]
            lines = np.zeros((len(rows), N, 3))
            lines[rows, i], lines[rows, j] = -span, span
            J = np.concatenate([held, lines.reshape(-1, 3 * N)])
            right = np.concatenate([np.zeros(len(held)), -np.sum(rate**2, axis=1)])
            free = inverse @ force.ravel()
            if len(J):
                free += inverse @ J.T @ np.linalg.lstsq(J @ inverse @ J.T, right - J @ free, rcond=1e-12)[0]
            return np.concatenate([v.ravel(), free])

        start = np.array([self.nodes, np.zeros((N, 3)) if self.velocities is None else self.velocities]).ravel()
        found = solve_ivp(rates, (0.0, times[-1]), start, "DOP853", times, rtol=rtol, atol=0.1 * rtol)
        assert found.success
        return found.y.T.reshape(len(times), 2, N, 3)[:, 0]


def rest(nodes: Array, pairs: Pairs, parts: list[float]) -> Array:
    """Parts of the lengths that strings have."""
    return np.array(
        [part * np.linalg.norm(nodes[j - 1] - nodes[i - 1]) for (i, j), part in zip(pairs, parts, strict=True)]
    )


# MOTES ----------------------------------------------------------------------------------------------------------------
def motes_double_pendulum() -> Example:
    """00: two bars of 1 m and 1 kg, 45° from the vertical, joined and pinned by N P = D; g = 9.8 m/s² along -y."""
    h = np.sqrt(2) / 2
    P = np.zeros((4, 2))
    P[0, 0], P[1, 1], P[2, 1] = 1, 1, -1
    nodes = np.array([[0, 0, 0], [h, -h, 0], [h, -h, 0], [2 * h, -2 * h, 0]])
    return Example(nodes, [(1, 2), (3, 4)], [], np.zeros(0), np.zeros(0), 0.0, np.ones(2), P=P, gravity=(0, -9.8, 0))


def motes_string_only() -> Example:
    """01: four masses of 1 kg at the corners of a square, six strings of 100 N/m, the fourth of 0.9 m."""
    nodes = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    pairs = [(1, 2), (2, 3), (3, 4), (4, 1), (2, 4), (1, 3)]
    lengths = rest(nodes, pairs, [1, 1, 1, 0.9, 1, 1])
    return Example(nodes, [], pairs, np.full(6, 100.0), lengths, point_masses=dict.fromkeys((1, 2, 3, 4), 1.0))


def motes_dbar_constraint() -> Example:
    """03: four bars of 1 kg, each with nodes of its own, in a square that N P = D joins and pins at one corner."""
    square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    P = np.vstack([np.eye(4), -np.eye(4)])
    P = np.column_stack([P, np.eye(8)[0]])
    bars, strings = [(4 + 4, 1), (5, 2), (6, 3), (7, 4)], [(2, 4), (1, 3)]
    return Example(
        np.vstack([square, square]), bars, strings, np.full(2, 100.0), np.array([1, 0.5]), 0.0, np.ones(4), P=P
    )


def motes_pendulum() -> Example:
    """04: one bar, pinned by N P = D, thrown at 10 m/s, with 10 N on its end; its string, along it, never pulls."""
    P, down = np.array([[1.0], [0.0]]), np.array([[0.0, 0, 0], [0, -10, 0]])
    nodes = np.array([[0.0, 0, 0], [1, 0, 0]])
    return Example(nodes, [(1, 2)], [], np.zeros(0), np.zeros(0), 0.0, np.ones(1), P=P,
                   loads=lambda t: down, velocities=down.copy())  # fmt: skip


def motes_x() -> Example:
    """05: two pinned bars of 1 kg, crossed, and seven strings of 100 N/m, four of which meet in a mass of 10 g."""
    nodes = np.array([[0.0, 0, 0], [12, 0, 0], [8, 4, 0], [4, 4, 0], [6, 1, 0]])
    pairs = [(1, 5), (2, 5), (1, 4), (2, 3), (4, 3), (4, 5), (3, 5)]
    P, start = np.eye(5)[:, :2], np.zeros((5, 3))
    start[4, 1] = -10.0
    return Example(nodes, [(1, 3), (2, 4)], pairs, np.full(7, 100.0), rest(nodes, pairs, [1.0] * 7), 0.0, np.ones(2),
                   point_masses={5: 0.01}, P=P, velocities=start)  # fmt: skip


def motes_prism() -> Example:
    """06: three bars of 1 kg, nine strings of three parts each (100 N/m, 10 N s/m), with masses of 50 g between."""
    nodes = np.array([[0.5, 0, 0], [0, 0.866, 0], [-0.5, 0, 0], [0.5, 0, 1], [0, 0.866, 1], [-0.5, 0, 1]])
    whole = [(1, 2), (2, 3), (3, 1), (4, 5), (5, 6), (6, 4), (1, 4), (2, 5), (3, 6)]
    places, pairs = list(nodes), []
    for i, j in whole:
        places += [nodes[i - 1] + part / 3 * (nodes[j - 1] - nodes[i - 1]) for part in (1, 2)]
        pairs += [(i, len(places) - 1), (len(places) - 1, len(places)), (len(places), j)]
    every = np.array(places)
    masses = dict.fromkeys(range(7, 25), 0.05)
    return Example(every, [(3, 5), (1, 6), (2, 4)], pairs, np.full(27, 100.0), rest(every, pairs, [0.95] * 27), 10.0,
                   np.ones(3), point_masses=masses)  # fmt: skip


# STEDY ----------------------------------------------------------------------------------------------------------------
def soft(nodes: Array, bars: Pairs, radius: float, density: float, E: float) -> tuple[Array, Array]:
    """Masses and stiffnesses E A/L of round bars."""
    lengths, area = rest(nodes, bars, [1.0] * len(bars)), np.pi * radius**2
    return density * area * lengths, E * area / lengths


def stedy_tbar_soft() -> Example:
    """Tbar_soft: two crossed bars of HDPE with pinned feet, nylon strings, 100 N s/m; four harmonics push node 3."""
    s = 5 * np.sqrt(0.5)
    nodes = np.array([[0.0, 0, 0], [s, 0, 0], [s, 0, s], [0, 0, s]])
    bars, strings = [(1, 3), (2, 4)], [(1, 2), (2, 3), (3, 4), (4, 1)]
    masses, k = soft(nodes, bars, 0.05, 960.0, 1e9)
    lengths = rest(nodes, strings, [1.0] * 4)
    held = np.array([[1, 1, 1], [1, 1, 1], [0, 1, 0], [0, 1, 0]])
    push = np.zeros((4, 3))
    push[2, 0] = 100.0

    def loads(t: float) -> Array:
        return push * (np.sin(10 * t) + np.sin(20 * t) + np.cos(15 * t) + np.cos(50 * t)) / 4

    return Example(
        nodes, bars, strings, 2e9 * np.pi * 1e-6 / lengths, lengths, 100.0, masses, k, held=held, loads=loads
    )


def stedy_tbar_flex() -> Example:
    """TBar_flex, whose feet are held along x and y alone; as its strings are at rest there, two have 0.7 as in TBar."""
    c, s = 0.5, np.sqrt(0.75)
    nodes = np.array([[0.0, 0, 0], [6 * c, 0, 0], [6 * c, 0, 6 * s], [c, 0, 5 * s]])
    bars, strings = [(1, 3), (2, 4)], [(1, 2), (2, 3), (3, 4), (4, 1)]
    masses, k = soft(nodes, bars, 0.05, 500.0, 200e9)
    lengths = rest(nodes, strings, [1.0, 0.7, 1.0, 0.7])
    held = np.array([[1, 1, 0], [1, 1, 0], [0, 1, 0], [0, 1, 0]])
    return Example(nodes, bars, strings, 7e7 * np.pi * 1e-6 / lengths, lengths, 1.0, masses, k, held=held)


def stedy_strut3() -> Example:
    """strut3: a prism of three bars of HDPE on three pins, nylon strings, gravity; 30 sin t N on each upper node.

    The program finds a prestress by a linear program whose solution is not unique; here all strings have 0.99.
    """
    r = np.sqrt(3) / 2
    nodes = np.array([[0, 1, 0], [-r, -0.5, 0], [r, -0.5, 0], [0, -1, 1], [-r, 0.5, 1], [r, 0.5, 1]])
    bars = [(1, 4), (2, 6), (3, 5)]
    strings = [(1, 2), (2, 3), (3, 1), (4, 5), (5, 6), (6, 4), (1, 6), (2, 5), (3, 4)]
    masses, k = soft(nodes, bars, 0.02, 960.0, 1e9)
    lengths = rest(nodes, strings, [0.99] * 9)
    held = np.zeros((6, 3))
    held[:3] = 1
    push = np.zeros((6, 3))
    push[3, 0] = push[4, 2] = push[5, 2] = 30.0
    return Example(nodes, bars, strings, 2e9 * np.pi * 1e-6 / lengths, lengths, 0.0, masses, k, held=held,
                   gravity=(0, 0, -9.806), loads=lambda t: push * np.sin(t))  # fmt: skip


def stedy_ball_soft() -> Example:
    """Ball_soft: the ball of `tests/data/truth` with bars of HDPE, and all strings at 0.99 as in `stedy_strut3`."""
    ball = truth.load("stedy_ball")
    nodes, held = ball["N0"].T, ball["fixed"].T
    bars, strings = (
        [(int(np.argmin(row)) + 1, int(np.argmax(row)) + 1) for row in ball[name]] for name in ("Cb", "Cs")
    )
    masses, k = soft(nodes, bars, 0.02, 960.0, 1e9)
    lengths = rest(nodes, strings, [0.99] * len(strings))
    return Example(
        nodes,
        bars,
        strings,
        2e9 * np.pi * 1e-6 / lengths,
        lengths,
        0.0,
        masses,
        k,
        {13: 1.0},
        held,
        gravity=(0, 0, -9.806),
        loads=lambda t: ball["extF_pattern"] * np.sin(t),
    )


def stedy_plate() -> Example:
    """Plate_LinSys: three T-bars in a row, five bars of HDPE and one of aluminium, feet held along x and y.

    Its strings, which a linear program prestresses there, have 0.7 here.
    """
    s = 5 * np.sqrt(0.5)
    nodes = np.array([[x * s, 0, z * s] for x, z in ((0, 0), (1, 0), (1, 1), (0, 1), (2, 0), (3, 0), (3, 1), (2, 1))])
    bars = [(1, 3), (2, 4), (2, 8), (5, 3), (5, 7), (6, 8)]
    strings = [(1, 2), (2, 3), (3, 4), (4, 1), (2, 5), (5, 6), (6, 7), (7, 8), (3, 8), (5, 8)]
    masses, k = soft(nodes, bars, 0.05, 960.0, 1e9)
    masses[5], k[5] = masses[5] * 2700 / 960, k[5] * 200
    lengths = rest(nodes, strings, [0.7] * 10)
    held = np.tile([0, 1, 0], (8, 1))
    held[[0, 1, 4, 5], 0] = 1
    return Example(nodes, bars, strings, 7e7 * np.pi * 1e-6 / lengths, lengths, 0.0, masses, k, held=held)
