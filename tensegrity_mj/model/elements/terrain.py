"""Uneven ground: heights above the level of a floor, on a grid of places.

    Contact(floor=0.0, terrain=Stairs(rise=0.05, tread=0.4))
    Contact(floor=0.0, terrain=Rough(roughness=0.02, length=0.4, seed=3))

Between the grid's points the surface is made of triangles, two a cell, as in MuJoCo's height fields: a stair's riser is
as wide as a cell. Beyond the edges there is the endless floor, `base` below the lowest point.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.fields import field, refused, register, value
from tensegrity_mj.basics.kinds import each, finite, many, not_negative, positive, rows, whole, within

MOST_POINTS = 250_000  # of a grid, which stand in the MJCF as text
WAVES = 200  # of a rough surface; its heights are normally distributed but for 1 / WAVES in the fourth moment
STEEPEST = 1.5  # [rad] of a ramp
BALL = tuple(  # places within a unit disc, from the middle outwards, at which a ball is held against the surface
    (r * np.cos(a), r * np.sin(a))
    for r, count in ((0.0, 1), (0.35, 6), (0.7, 12), (0.95, 16))
    for a in 2 * np.pi * np.arange(count) / count
)


class Terrain:
    """Heights z(x, y) above the level of a floor; a subclass is a value class of a registered kind.

    Attributes:
        spacing: of the grid [m].
        base: how far below the lowest point the endless floor lies [m].
    """

    spacing: float
    base: float

    def grid(self) -> tuple[Array, Array, Array]:
        """x (I,), y (J,) and heights (I, J) of the grid's points [m]; x and y ascend in equal steps."""
        raise NotImplementedError

    @cached_property
    def points(self) -> tuple[Array, Array, Array]:
        """`grid`, found once."""
        return self.grid()

    @cached_property
    def lowest(self) -> float:
        """Height of the endless floor around it [m]."""
        return float(self.points[2].min()) - self.base

    def height_field(self) -> tuple[Array, Array, Array]:
        """MuJoCo's: its origin (3,) above the level of the floor [m], its four sizes [m], and shares (J, I) of them."""
        x, y, z = self.points
        low, span = z.min(), np.ptp(z)
        middle = np.array([0.5 * (x[0] + x[-1]), 0.5 * (y[0] + y[-1]), low])
        # A level one has a height all the same, of which it has nothing.
        sizes = [0.5 * (x[-1] - x[0]), 0.5 * (y[-1] - y[0]), span or self.spacing, self.base]
        return middle, np.array(sizes), (z.T - low) / (span or 1.0)

    def height(self, places: Array) -> Array:
        """Heights (...) [m] at places (..., 2), bilinear within cells; that of the endless floor beyond the edges."""
        x, y, z = self.points
        i, s, inside_x = _cell(x, places[..., 0])
        j, t, inside_y = _cell(y, places[..., 1])
        low = (1 - s) * z[i, j] + s * z[i + 1, j]
        high = (1 - s) * z[i, j + 1] + s * z[i + 1, j + 1]
        return np.where(inside_x & inside_y, (1 - t) * low + t * high, self.lowest)

    def stretch_above(self, start: Array, end: Array, radius: float) -> tuple[Array, Array]:
        """The ends (3,) of the part of a segment that is above the grid, or within a radius of it [m].

        Of a segment that passes the grid it is one point.
        """
        low, high = 0.0, 1.0
        for axis, marks in enumerate(self.points[:2]):
            edges = np.array([marks[0] - radius, marks[-1] + radius]) - start[axis]
            along = end[axis] - start[axis]
            if along == 0:
                high = high if edges[0] <= 0 <= edges[1] else low
                continue
            with np.errstate(over="ignore"):
                first, last = np.sort(edges / along)
            low, high = max(low, float(first)), min(high, float(last))
        low = min(low, 1.0)
        return start + low * (end - start), start + max(low, high) * (end - start)

    def clearance(self, centres: Array, radius: Array) -> Array:
        """Distances (P,) [m] that balls can sink before they touch; negative where they must rise.

        Each ball is compared with the surface at 35 places, which is accurate to some per cent of its radius.

        Args:
            centres: (P, 3) [m], heights above the level of the floor.
            radius: (P,) [m].
        """
        offsets = np.array(BALL)
        below = np.sqrt(1 - np.sum(offsets**2, axis=1))
        places = centres[:, None, :2] + radius[:, None, None] * offsets
        gaps = centres[:, None, 2] - radius[:, None] * below - self.height(places)
        return np.asarray(gaps.min(axis=1))


def _cell(marks: Array, at: Array) -> tuple[NDArray[np.int64], Array, NDArray[np.bool_]]:
    """The cell of a row of marks in which places are, where in it (0 to 1), and whether they are in any."""
    along = (at - marks[0]) / (marks[1] - marks[0])
    cell = np.clip(np.nan_to_num(along).astype(int), 0, len(marks) - 2)
    return cell, along - cell, (along >= 0) & (along <= len(marks) - 1)


@value("terrain", kw_only=True)
class Area(Terrain):
    """A terrain by a formula, about the origin.

    Attributes:
        size: of its sides along x and y [m], rounded to whole spacings to either side of the origin.
    """

    size: tuple[float, float] = field(each("[x, y] [m]", x=positive("m"), y=positive("m")), default=(10.0, 10.0))
    spacing: float = field(positive("m"), default=0.05)
    base: float = field(positive("m"), default=0.5)

    def __attrs_post_init__(self) -> None:
        # As floats: sizes beyond all measure are refused here, too.
        if (self.size[0] / self.spacing + 1) * (self.size[1] / self.spacing + 1) > MOST_POINTS:
            raise refused(
                self,
                f"size = {list(self.size)} m with spacing = {self.spacing:g} m has more than {MOST_POINTS:,} points: "
                "make it smaller, or the spacing larger",
            )
        self.resolve(f"size = {list(self.size)} m: its shorter side", min(self.size))

    def resolve(self, what: str, length: float) -> None:
        """Raise SceneError unless a length [m] is at least two spacings."""
        if length < 2 * self.spacing:
            raise refused(self, f"{what} = {length:g} m; it must be at least two spacings, {2 * self.spacing:g} m")

    def grid(self) -> tuple[Array, Array, Array]:
        # About the origin, so that a point is there.
        counts = [round(side / self.spacing / 2) for side in self.size]
        x, y = (self.spacing * np.arange(-count, count + 1.0) for count in counts)
        return x, y, self.formula(*np.meshgrid(x, y, indexing="ij"))

    def formula(self, x: Array, y: Array) -> Array:
        """Heights [m] at places [m]."""
        raise NotImplementedError


@value("ramp", kw_only=True)
class Ramp(Area):
    """Level up to x = 0, a slope from there on. (A slope without an end is a floor with a `normal`.)

    Attributes:
        angle: of the slope [rad], negative downhill.
    """

    angle: float = field(within(-STEEPEST, STEEPEST, "rad"))

    def formula(self, x: Array, y: Array) -> Array:
        return np.asarray(np.tan(self.angle) * np.maximum(x, 0.0))


@value("stairs", kw_only=True)
class Stairs(Area):
    """Level for x < 0, steps from there on. A riser is a slope over the last spacing before its step.

    Attributes:
        rise: of a step [m], negative downhill.
        tread: of a step [m], at least two spacings; steps begin at its multiples, or the grid's next points.
    """

    rise: float = field(finite("m"))
    tread: float = field(positive("m"))

    def __attrs_post_init__(self) -> None:
        super().__attrs_post_init__()
        self.resolve("tread", self.tread)

    def formula(self, x: Array, y: Array) -> Array:
        # Round-off puts no point that is on an edge before it.
        return np.asarray(self.rise * np.maximum(np.floor(x / self.tread + 1e-9) + 1, 0.0))


@value("rough", kw_only=True)
class Rough(Area):
    """Random ground: heights of a normal distribution, whose correlation over a distance d is exp(-d²/length²).

    A sum of waves whose numbers, directions and phases are drawn. It is the same surface at every size and spacing.

    Attributes:
        roughness: standard deviation of the heights [m].
        length: of correlation [m], at least two spacings.
        seed: of the random numbers.
        level: radius about the origin within which it is level [m]; it reaches its roughness at twice that.
    """

    roughness: float = field(not_negative("m"))
    length: float = field(positive("m"))
    seed: int = field(whole(0), default=0)
    level: float = field(not_negative("m"), default=0.0)

    def __attrs_post_init__(self) -> None:
        super().__attrs_post_init__()
        self.resolve("length", self.length)

    def formula(self, x: Array, y: Array) -> Array:
        random = np.random.default_rng(self.seed)
        # The spectrum of exp(-d²/length²) is a normal distribution of wave numbers.
        numbers = random.normal(scale=np.sqrt(2.0) / self.length, size=(WAVES, 2))
        phases = random.uniform(0.0, 2 * np.pi, WAVES)
        z = np.zeros_like(x)
        for (along_x, along_y), phase in zip(numbers, phases, strict=True):
            z += np.cos(along_x * x + along_y * y + phase)
        z *= self.roughness * np.sqrt(2.0 / WAVES)
        if self.level == 0.0:
            return z
        share = np.clip(np.hypot(x, y) / self.level - 1.0, 0.0, 1.0)
        return np.asarray(z * share**2 * (3 - 2 * share))


@value("heights", kw_only=True)
class Heights(Terrain):
    """Terrain of given heights, as measured for instance.

    Attributes:
        heights: rows along x, one after the other along y [m]; the origin is in the middle of all.
    """

    heights: tuple[tuple[float, ...], ...] = field(many(rows(), "rows of heights [m]"))
    spacing: float = field(positive("m"))
    base: float = field(positive("m"), default=0.5)

    def __attrs_post_init__(self) -> None:
        many, wide = len(self.heights), sorted({len(row) for row in self.heights})
        if many < 2 or len(wide) > 1 or wide[0] < 2 or many * wide[0] > MOST_POINTS:
            raise refused(
                self,
                f"heights: {many} rows of {' and '.join(map(str, wide))} numbers; give two rows or more, all of the "
                f"same two numbers or more, and at most {MOST_POINTS:,} in all",
            )

    def grid(self) -> tuple[Array, Array, Array]:
        z = np.array(self.heights).T
        x, y = (self.spacing * (np.arange(count) - 0.5 * (count - 1)) for count in z.shape)
        return x, y, z


for kind, cls in {"ramp": Ramp, "stairs": Stairs, "rough": Rough, "heights": Heights}.items():
    register(kind, cls)
