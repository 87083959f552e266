"""What is worth choosing: the Pareto front of cost and error, and the cheapest setting for an accuracy."""

from __future__ import annotations

import math
from collections.abc import Sequence

DECADES = tuple(float(f"1e-{number}") for number in range(1, 13))  # m


def pareto(costs: Sequence[float | None], errors: Sequence[float | None], floor: float = 0.0) -> list[int]:
    """Indices of the points that no other beats in cost and error alike, the cheapest first.

    Args:
        costs, errors: one a point; None, NaN and infinity are points without a result, which are never on the front.
        floor: errors below it count as equal to it: differences there say nothing.
    """
    known = [
        (cost, max(error, floor), number)
        for number, (cost, error) in enumerate(zip(costs, errors, strict=True))
        if cost is not None and error is not None and math.isfinite(cost) and math.isfinite(error)
    ]
    front: list[int] = []
    best = math.inf
    for _, error, number in sorted(known):
        if error < best:
            front.append(number)
            best = error
    return front


def cheapest(
    costs: Sequence[float | None], bounds: Sequence[float | None], tolerance: float, alike: float = 1.0
) -> int | None:
    """Index of the cheapest point whose error is at most the tolerance; None where there is none.

    Args:
        alike: costs up to so many times the least count as the least; of those points the first is taken.
    """
    adequate = [
        (cost, number)
        for number, (cost, bound) in enumerate(zip(costs, bounds, strict=True))
        if cost is not None and bound is not None and math.isfinite(cost) and bound <= tolerance
    ]
    if not adequate:
        return None
    least = min(adequate)[0]
    return min(number for cost, number in adequate if cost <= alike * least)


def decades(motion: float, bounds: Sequence[float | None]) -> list[float]:
    """Accuracies 1e-1, 1e-2, ... [m] below the size of the motion, down to the first that no point has."""
    known = [bound for bound in bounds if bound is not None and math.isfinite(bound)]
    best = min(known, default=math.inf)
    below = [tolerance for tolerance in DECADES if tolerance < motion]
    return below[: sum(best <= tolerance for tolerance in below) + 1]
