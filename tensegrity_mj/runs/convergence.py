"""Error of a run, judged from runs of the same experiment with other steps: differences, Richardson, and doubt.

Only trajectories are needed, of any engine. For a method of order p, the largest node error of a run with step h
is close to C h^p. Two runs then differ by d = C (h1^p - h2^p), and the finer is wrong by d / ((h1/h2)^p - 1). Three
runs show the order that is really there, which is lower where strings go slack or a law has kinks, and nothing at
all where differences do not fall: then there is no error to state, and `Estimate.settled` is false.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.basics.arrays import Array, bisect
from tensegrity_mj.errors import OptionError
from tensegrity_mj.runs.trajectory import Trajectory

SAME_TIME = 1e-9  # of the run's length: recorded times of two grids that are meant to be one
SAFETY = 1.25  # of an order that two differences show: an order changes between them
LEAST_ORDER = 0.5  # observed; below it, differences fall too slowly to be a method's error
FALL_OF_TOLERANCES = 1.5  # least, of differences between tolerances a decade or more apart
ROUND_OFF = 1e-11  # of the structure's extent: differences below are those of round-off, which need not fall


def orders_between(steps: Sequence[float], errors: Sequence[float], floor: float = 0.0) -> list[float | None]:
    """log(e₁/e₂) / log(h₁/h₂) of each two runs in a row.

    None where the step does not fall, and where an error is within the floor, below which no order shows.
    """
    return [
        math.log(large / small) / math.log(coarse / fine) if coarse > fine and min(large, small) > floor else None
        for (coarse, large), (fine, small) in itertools.pairwise(zip(steps, errors, strict=True))
    ]


@dataclass(frozen=True)
class Estimate:
    """Estimate of the error of the finest of several runs.

    Attributes:
        value: upper estimate of its largest node error over the run [m]; infinite where runs ended differently.
        settled: whether `value` can be defended.
        reason: in words, how the estimate came about or why it did not settle.
    """

    value: float
    settled: bool
    reason: str


def node_difference(a: Trajectory, b: Trajectory) -> float:
    """Largest distance of a node of a from the same of b over the times that both recorded [m].

    It is infinite where one run ended before the other or otherwise than it, or is not finite.

    Raises:
        OptionError: if the runs are not of the same nodes, or have no time in common.
    """
    if a.nodes.shape[1:] != b.nodes.shape[1:]:
        raise OptionError(f"runs of {a.nodes.shape[1]} and {b.nodes.shape[1]} nodes: compare runs of one structure")
    if not len(a.time) or not len(b.time):
        return math.inf
    end = max(float(a.time[-1]), float(b.time[-1]))
    if a.status is not b.status or abs(a.time[-1] - b.time[-1]) > SAME_TIME * end:
        return math.inf
    first, second = common_times(a.time, b.time)
    if not len(first):
        raise OptionError("the runs have no recorded time in common: give both the same output_interval")
    with np.errstate(invalid="ignore", over="ignore"):
        distances = np.linalg.norm(a.nodes[first] - b.nodes[second], axis=-1)
    largest = float(np.max(distances, initial=0.0))
    return largest if math.isfinite(largest) else math.inf


def way_of(nodes: Array) -> float:
    """Largest distance [m] of a node from its start, of nodes (T, N, 3)."""
    return float(np.max(np.linalg.norm(nodes - nodes[:1], axis=-1), initial=0.0))


def common_times(a: Array, b: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Indices into two rising series of times (T,) [s] where they agree within `SAME_TIME`."""
    if not (len(a) and len(b)):
        return np.empty(0, np.intp), np.empty(0, np.intp)
    tolerance = SAME_TIME * max(a[-1], b[-1])
    nearest = np.clip(np.searchsorted(b, a - tolerance), 0, len(b) - 1)
    first = np.flatnonzero(np.abs(b[nearest] - a) <= tolerance)
    return first, nearest[first]


def estimate_error(runs: Sequence[Trajectory], steps: Sequence[float], order: int) -> Estimate:
    """The error of the last of two or more runs, from their differences.

    Args:
        runs: of one experiment, the finest last.
        steps: of the runs, falling [s].
        order: of the method on smooth motion.

    Raises:
        OptionError: for fewer than two runs, or steps that do not fall.
    """
    if len(runs) < 2 or len(steps) != len(runs) or any(h2 >= h1 for h1, h2 in itertools.pairwise(steps)):
        raise OptionError(f"{len(runs)} runs with steps {list(steps)}: give two or more, of falling steps")
    differences = [node_difference(a, b) for a, b in itertools.pairwise(runs)]
    nodes = runs[-1].nodes
    extent = float(np.max(np.abs(nodes), initial=1e-300)) if nodes.size else 1.0
    last = runs[-1]
    return judge(differences, steps, order, ROUND_OFF * extent, highest_order(last, order), has_kinks(last))


def highest_order(run: Trajectory, order: int) -> int:
    """The order that a method of fixed steps can have on this motion, where it has `order` on a smooth one.

    A step over a kink of the forces, where a string goes slack, is wrong by a part of h² that depends on where in the
    step it lies. The force of a string with a damper even jumps there, which leaves a part of h.
    """
    if not has_kinks(run):
        return order
    jumps = _at_times(run.force_densities > 0) & (run.scene.structure.damping > 0)
    return min(order, 1 if jumps.any() else 2)


def has_kinks(run: Trajectory) -> bool:
    """Return whether a string pulls at some samples and not at others, was slack between two, or passed a corner.

    By tensions: where a damper would push, a string has none although its u > 0.
    """
    return bool(_at_times(run.tensions != 0).any()) or _passes_corners(run) or _slack_between(run)


def pieces_along(run: Trajectory) -> NDArray[np.intp]:
    """Numbers (T, M) of the piece of its tension curve that each string is on."""
    structure = run.scene.structure
    return structure.curves.pieces(structure.string_lengths(run.nodes) - run.rest_lengths)


def _passes_corners(run: Trajectory) -> bool:
    """Return whether a string was on two pieces of its tension curve, or yielded."""
    structure = run.scene.structure
    if structure.curves.linear:
        return False
    pieces = pieces_along(run)
    return bool(np.any((pieces != pieces[:1]) | (structure.curves.yields & (pieces > 0))))


def _slack_between(run: Trajectory) -> bool:
    """Return whether a string that pulls at two samples in a row turned by over a right angle, slack on the way.

    Its second node then passed its first one, as seen from there: on a straight line at less than the rest length. Of
    a path, any segment may have turned.
    """
    paths = run.scene.structure.paths
    spans, rest = paths.spans(run.nodes), run.rest_lengths
    before, moved = spans[:-1], np.diff(spans, axis=0)
    turned = paths.total(np.sum(before * spans[1:], axis=-1) < 0)
    pulls = (run.tensions[:-1] > 0) & (run.tensions[1:] > 0)
    square = np.sum(moved * moved, axis=-1)
    part = np.clip(-np.sum(before * moved, axis=-1) / np.where(square > 0, square, 1.0), 0.0, 1.0)
    nearest = paths.total(np.linalg.norm(before + part[..., None] * moved, axis=-1))
    return bool(np.any(turned & pulls & (nearest < np.minimum(rest[:-1], rest[1:]))))


def _at_times(true: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Columns that are true at some times, and not at others."""
    return np.asarray(true.any(axis=0) & ~true.all(axis=0))


def judge(
    differences: Sequence[float],
    steps: Sequence[float],
    order: int,
    floor: float,
    highest: int | None = None,
    kinks: bool = False,
) -> Estimate:
    """Estimate the error from the differences [m] of neighbouring runs, of which the last two count.

    Args:
        differences: one fewer than steps.
        steps: falling [s].
        order: of the method on smooth motion.
        floor: differences below it are taken for round-off [m].
        highest: order that the motion allows, see `highest_order`; the method's by default. More is a coincidence.
        kinks: whether forces have kinks. The error then depends on where in the steps these lie, and steps that end
            there may be the same in two runs, which then are wrong alike: two runs are no evidence, and of three no
            order above 1 counts.
    """
    d, ratio = differences[-1], steps[-2] / steps[-1]
    if not math.isfinite(d):
        return Estimate(math.inf, False, "the two finest runs end differently")
    if d <= floor:
        return Estimate(2 * d + floor / 10, True, f"the two finest runs differ by round-off, {d:.2g} m")
    if len(differences) == 1 or not math.isfinite(differences[-2]):
        # No order is known yet: that of 1 is assumed, however high the method's, which leaves room where it is higher.
        value = d / (ratio - 1) * (SAFETY if order == 1 else 1.0)
        if kinks:
            return Estimate(value, False, f"two runs differ by {d:.2g} m, perhaps by coincidence: forces have kinks")
        return Estimate(value, True, f"two runs differ by {d:.2g} m; an order of 1 is assumed")
    before, ratio_before = differences[-2], steps[-3] / steps[-2]
    observed = observed_order(before / d, ratio_before, ratio, order)
    if observed < LEAST_ORDER:
        return Estimate(
            SAFETY * max(d, before),
            False,
            f"runs differ by {before:.2g} m and then by {d:.2g} m: the difference does not fall with the step",
        )
    allowed = order if highest is None else highest
    # Two runs may happen to agree, most easily about a kink: the last difference cannot be less than what the one
    # before becomes at full order, or at one order more than the motion allows.
    full = min(order, allowed + 1)
    expected = before * (ratio**full - 1) / (ratio_before**full - 1) * ratio**-full
    used, words = min(observed, float(allowed)), f"an order of {observed:.2g}"
    if observed >= order + 1:
        # The coarsest run was beyond what orders describe, and says nothing of the others; or they happen to agree.
        used, words = 1.0, "faster than the method can; an order of 1 is assumed"
        expected = expected if kinks else d
    elif kinks and used > 1:
        used, words = 1.0, f"{words}, of which 1 counts as forces have kinks"
    value = SAFETY * max(d, expected) / (ratio**used - 1)
    return Estimate(value, True, f"runs differ by {before:.2g} m and then by {d:.2g} m: {words}")


def judge_tolerances(differences: Sequence[float], floor: float, tolerance: float = 0.0) -> Estimate:
    """Estimate the error of a method that controls its own, from runs of tolerances that fall tenfold or more.

    Its error follows the tolerance by no fixed order. The last difference is the error of the run before the last, and
    so an upper estimate of that of the last, which is usually many times less. It cannot be less than what the last
    run was free to be wrong by in a step: where samples of a law or breaks end the steps, runs of two tolerances take
    the same ones, and have the same errors.

    Args:
        tolerance: [m] of the last run.
    """
    d = differences[-1]
    if not math.isfinite(d):
        return Estimate(math.inf, False, "the two finest runs end differently")
    if d <= floor:
        value = max(2 * d + floor / 10, tolerance)
        return Estimate(value, True, f"the two finest runs differ by round-off, {d:.2g} m")
    if len(differences) > 1 and differences[-2] < FALL_OF_TOLERANCES * d:
        return Estimate(
            SAFETY * max(d, differences[-2]),
            False,
            f"runs differ by {differences[-2]:.2g} m and then by {d:.2g} m: the difference does not fall with the "
            "tolerance",
        )
    reason = f"two runs of different tolerance differ by {d:.2g} m, the error of the coarser"
    return Estimate(max(d, tolerance), True, reason)


def observed_order(fall: float, ratio_before: float, ratio: float, order: int) -> float:
    """The p at which C h^p makes one difference `fall` times the next, by bisection; at most order + 1."""

    def predicted(p: float) -> float:
        return (ratio_before**p - 1) / (ratio**p - 1) * ratio**p

    low, high = 1e-6, order + 1.0
    if fall <= predicted(low):
        return 0.0
    if fall >= predicted(high):
        return high
    return bisect(lambda p: predicted(p) < fall, low, high)[0]
