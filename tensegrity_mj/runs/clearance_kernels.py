"""Searches over all pairs of elements of a motion: least distances, histories, and stretches of time. Compiled."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tensegrity_mj.basics.arrays import Array, IntArray
from tensegrity_mj.dynamics.native.compiling import njit
from tensegrity_mj.runs.least_distance import least
from tensegrity_mj.runs.moving_segments import Ends, Motion, at_sample
from tensegrity_mj.runs.near_stretches import stretches


class Elements(NamedTuple):
    """Rods, then strings.

    Attributes:
        nodes: (E, 2).
        until: (E,) [s] when each is gone.
        radii: (E,) [m].
    """

    nodes: IntArray
    until: Array
    radii: Array


class Couples(NamedTuple):
    """Pairs of elements (P, 2) and their kinds (P,)."""

    pairs: IntArray
    kinds: IntArray


@njit
def couple(elements: Elements, i: int, j: int) -> tuple[Ends, float, float]:
    """The four nodes of two elements, the sum of their radii [m], and when the first of them is gone [s]."""
    nodes, until, radii = elements
    ends = (nodes[i, 0], nodes[i, 1], nodes[j, 0], nodes[j, 1])
    return ends, radii[i] + radii[j], min(until[i], until[j])


@njit
def search(
    motion: Motion, elements: Elements, couples: Couples, limits: Array, own: bool, tolerance: float, out: Array
) -> None:
    """Write (surface distance, interval, part, width) of the least distance of pairs of elements (P, 2).

    Of each kind only what is below limits[kind] is found, which it then becomes; with `own` that of every pair.
    """
    pairs, kinds = couples
    for p in range(len(pairs)):
        i, j = pairs[p]
        ends, thick, stop = couple(elements, i, j)
        limit = np.inf if own else limits[kinds[p]] + thick
        best, where, part, width = least(motion, (i, j), ends, (motion.time[0], stop), limit, tolerance)
        out[p, 0], out[p, 1], out[p, 2], out[p, 3] = best - thick, where, part, width
        if width >= 0.0:
            limits[kinds[p]] = min(limits[kinds[p]], best - thick)


@njit
def history(motion: Motion, elements: Elements, couples: Couples, out: Array) -> None:
    """Lower out (3, T) to the least surface distances of each kind at the samples."""
    time, way = motion.time, motion.way
    pairs, kinds = couples
    for p in range(len(pairs)):
        i, j = pairs[p]
        ends, thick, stop = couple(elements, i, j)
        kind = kinds[p]
        known, base = -np.inf, 0.0
        for k in range(len(time)):
            if time[k] > stop:
                break
            if known - (way[i, k] + way[j, k] - base) >= out[kind, k]:
                continue
            known, base = at_sample(motion, ends, k) - thick, way[i, k] + way[j, k]
            out[kind, k] = min(out[kind, k], known)


@njit
def all_stretches(
    motion: Motion, elements: Elements, pairs: IntArray, level: float, tolerance: float
) -> list[tuple[int, float, float]]:
    """Stretches of time at a surface distance of at most the level: the pair's row, start and end [s]."""
    found = []
    for p in range(len(pairs)):
        i, j = pairs[p]
        ends, thick, stop = couple(elements, i, j)
        if level + thick >= 0.0:
            for start, end in stretches(motion, (i, j), ends, stop, level + thick, tolerance):
                found.append((p, start, end))
    return found
