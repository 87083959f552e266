"""Reference motions along a curve of shapes: one parameter, moved in time by quintics, (4.2)-(4.5) of the thesis.

The shapes are node positions (N, 3) [m] given at some values of the parameter; one polynomial passes through all of
them. Its derivatives, and those of the quintics, are exact.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import finite, positive, real_array
from tensegrity_mj.basics.fields import SAME_ARRAY, field, refused, value
from tensegrity_mj.basics.kinds import array, part, rows
from tensegrity_mj.errors import OptionError

MOST_SHAPES = 1000  # of a curve: its polynomial takes a dense matrix of that size


def quintic(span: float, start: ArrayLike, end: ArrayLike) -> Array:
    """Coefficients (6,), lowest power first, of the y(t - t_a) that solves (4.5).

    Args:
        span: t_b - t_a > 0 [s].
        start, end: (y, ẏ, ÿ) at t_a and at t_b.

    Raises:
        OptionError: for a span that is not > 0, or ends that are not three finite numbers.
    """
    span = positive("quintic: span", span, "s")
    y, v, a = real_array("quintic: start", start, (3,), scalar=False)
    end_y, end_v, end_a = real_array("quintic: end", end, (3,), scalar=False)
    # With τ = (t - t_a)/span; what is left at the end after constant, rate and acceleration of the start.
    v, a = v * span, a * span**2
    rest = end_y - y - v - a / 2
    rest_v = end_v * span - v - a
    rest_a = end_a * span**2 - a
    third = 10 * rest - 4 * rest_v + rest_a / 2
    fourth = -15 * rest + 7 * rest_v - rest_a
    fifth = 6 * rest - 3 * rest_v + rest_a / 2
    return np.asarray(np.array([y, v, a / 2, third, fourth, fifth]) / span ** np.arange(6))


def chebyshev_points(first: float, last: float, count: int) -> Array:
    """(count,) increasing parameters, both ends included, at which shapes determine a curve best.

    Raises:
        OptionError: unless count is an integer >= 2 and first < last.
    """
    first, last = finite("chebyshev_points: first", first), finite("chebyshev_points: last", last)
    if isinstance(count, bool) or not isinstance(count, (int, np.integer)) or count < 2 or not first < last:
        raise OptionError(
            f"chebyshev_points({first:g}, {last:g}, {count!r}): first must be below last, count an integer >= 2"
        )
    points = (first + last) / 2 - (last - first) / 2 * np.cos(np.pi * np.arange(count) / (count - 1))
    points[0], points[-1] = first, last
    return np.asarray(points)


@value("target")
class Curve:
    """Shapes along a parameter, and how the parameter moves at the target's times.

    Attributes:
        values: (W,) the parameter at the times.
        rates, accelerations: (W,) its derivatives there, zero by default: at rest.
        parameters: (P,) increasing; `chebyshev_points` give the best curve.
        shapes: (P, N, 3) node positions [m] at these parameters.
    """

    values: tuple[float, ...] = field(rows())
    parameters: tuple[float, ...] = field(rows())
    shapes: Array = field(array("(P, N, 3)"), eq=SAME_ARRAY)
    rates: tuple[float, ...] = field(rows(), default=())
    accelerations: tuple[float, ...] = field(rows(), default=())

    __hash__ = None  # type: ignore[assignment]

    def __attrs_post_init__(self) -> None:
        W, P = len(self.values), len(self.parameters)
        for name in ("rates", "accelerations"):
            if not getattr(self, name):
                object.__setattr__(self, name, (0.0,) * W)
            if len(getattr(self, name)) != W:
                raise refused(self, f"{len(getattr(self, name))} {name} for {W} values; give one a value")
        if P > MOST_SHAPES:
            raise refused(self, f"{P} shapes; the polynomial of a curve goes through at most {MOST_SHAPES}")
        if P < 2 or np.any(np.diff(self.parameters) <= 0):
            raise refused(self, f"parameters {list(self.parameters)}; they must be two or more, and increase")
        if self.shapes.ndim != 3 or len(self.shapes) != P:
            raise refused(self, f"shapes of shape {self.shapes.shape} for {P} parameters; they must be ({P}, nodes, 3)")

    @property
    def interval(self) -> tuple[float, float]:
        """The parameters between which shapes are known."""
        return self.parameters[0], self.parameters[-1]

    @cached_property
    def coefficients(self) -> Array:
        """(P, N, 3) Chebyshev coefficients of the nodes over `interval`."""
        basis = np.polynomial.chebyshev.chebvander(self._scaled(np.array(self.parameters)), len(self.parameters) - 1)
        try:
            with np.errstate(all="ignore"):  # what is not finite is for the check of the target to say
                flat = np.linalg.solve(basis, self.shapes.reshape(len(self.shapes), -1))
        except np.linalg.LinAlgError:
            raise refused(
                self, f"the parameters {list(self.parameters)} lie too close to each other for a polynomial"
            ) from None
        return np.asarray(flat.reshape(self.shapes.shape))

    def _scaled(self, parameter: Array) -> Array:
        first, last = self.interval
        return np.asarray((2 * parameter - first - last) / (last - first))

    def nodes(self, parameter: ArrayLike) -> Array:
        """Node positions (..., N, 3) [m] at parameters (...)."""
        given = np.asarray(parameter, float)
        basis = np.polynomial.chebyshev.chebvander(self._scaled(given), len(self.parameters) - 1)
        with np.errstate(all="ignore"):
            return np.asarray(np.tensordot(basis, self.coefficients, 1))

    def quintics(self, times: Sequence[float]) -> Array:
        """(W - 1, 6) coefficients of the parameter between consecutive times (W,) [s], lowest power first."""
        ends = np.array([self.values, self.rates, self.accelerations]).T
        pieces = [quintic(times[k + 1] - times[k], ends[k], ends[k + 1]) for k in range(len(times) - 1)]
        return np.array(pieces).reshape(-1, 6)

    def extremes(self, times: Sequence[float]) -> tuple[float, float]:
        """Smallest and largest parameter between the times (W,) [s]: at waypoints, or where a quintic turns."""
        found = list(self.values)
        for piece, span in zip(self.quintics(times), np.diff(times), strict=True):
            # In units of the span, so that coefficients compare; a root of round-off adds a harmless point.
            powers = piece * float(span) ** np.arange(6)
            for root in np.roots((powers[1:] * np.arange(1, 6))[::-1]):
                if abs(root.imag) < 1e-6 and 0 < root.real < 1:
                    found.append(float(np.polynomial.polynomial.polyval(root.real, powers)))
        return min(found), max(found)


@value("target")
class Target:
    """Target positions of the nodes for a controller: a set-point, a path through waypoints, or a curve of shapes.

    On a path, every rod's b moves along the great circle and its r along the straight line between two waypoints, with
    quintic timing (at rest at each waypoint). On a curve, the nodes follow one polynomial through given shapes, whose
    parameter moves by quintics. Before the first time and after the last a target stands still.

    Attributes:
        times: (W,) increasing [s]; a set-point has one.
        nodes: (W, N, 3) node positions [m] at these times.
        along: the curve, or None.
    """

    times: tuple[float, ...] = field(rows())
    nodes: Array = field(array("(W, N, 3)"), eq=SAME_ARRAY)
    along: Curve | None = field(
        part(Curve, "Target.curve(times, values, parameters, shapes)"), default=None, none="None"
    )

    __hash__ = None  # type: ignore[assignment]

    def __attrs_post_init__(self) -> None:
        if self.along is not None:
            object.__setattr__(self, "nodes", array("").plain(self.along.nodes(self.along.values)))

    @classmethod
    def set_point(cls, nodes: ArrayLike) -> Target:
        """A constant target: node positions (N, 3)."""
        return cls((0.0,), [nodes])  # type: ignore[arg-type]

    @classmethod
    def path(cls, times: Sequence[float], nodes: ArrayLike) -> Target:
        """A path: times (W,), node positions (W, N, 3)."""
        return cls(times, nodes)  # type: ignore[arg-type]

    @classmethod
    def curve(
        cls,
        times: Sequence[float],
        values: Sequence[float],
        parameters: Sequence[float],
        shapes: ArrayLike,
        rates: Sequence[float] | None = None,
        accelerations: Sequence[float] | None = None,
    ) -> Target:
        """Shapes (P, N, 3) at parameters (P,); the parameter has these values, rates and accelerations at times (W,).

        Rates and accelerations are zero unless given. Between the times the parameter follows quintics, (4.2)-(4.5);
        the nodes follow the polynomial through all shapes (`chebyshev_points` says where to take them).
        """
        none: Sequence[float] = ()
        along = Curve(
            values,  # type: ignore[arg-type]
            parameters,  # type: ignore[arg-type]
            shapes,  # type: ignore[arg-type]
            none if rates is None else rates,  # type: ignore[arg-type]
            none if accelerations is None else accelerations,  # type: ignore[arg-type]
        )
        return cls(times, along.nodes(along.values), along)  # type: ignore[arg-type]
