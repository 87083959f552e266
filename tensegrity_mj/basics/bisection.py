"""Bisection."""

from collections.abc import Callable


def bisect(holds: Callable[[float], bool], start: float, end: float, within: float = 0.0) -> tuple[float, float]:
    """Bracket the number at which a condition that holds at `start` and not at `end` ceases to hold.

    The two numbers are at most `within` apart or, where floats are coarser, neighbours.
    """
    while end - start > within:
        middle = 0.5 * (start + end)
        if not start < middle < end:
            break
        if holds(middle):
            start = middle
        else:
            end = middle
    return start, end
