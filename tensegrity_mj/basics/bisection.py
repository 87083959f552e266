"""Where something ends, by halving."""

from collections.abc import Callable


def bisect(holds: Callable[[float], bool], start: float, end: float, within: float = 0.0) -> tuple[float, float]:
    """Two numbers between which something ends that holds at `start` and not at `end`.

    They are so far apart or, where floats are coarser, neighbours.
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
