"""The planar tensegrity beam of the thesis' section 4.6.2 and appendix B.2, straight to circular.

Pairs of crossing rods stand side by side along the beam, each pair in a sector of the angle φ, and overlap by φ/3: pair
k = 0, 1, ... reaches from the angle 2kφ/3 to (2k + 3)φ/3. Every end of a pair is an upright line with a node on the
inner and one on the outer rim. In their order along the beam these lines bound the cells, the first and last of
sector 2φ/3 and all others of φ/3, whose sides and diagonals are strings.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from tensegrity_mj.basics import kinds
from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import MOST_NODES, check_nodes, positive, sequence_of
from tensegrity_mj.basics.fields import field, function_of, refused, value
from tensegrity_mj.basics.texts import value_text
from tensegrity_mj.errors import OptionError
from tensegrity_mj.library.cross import HINGE, PLANE, SLIDER, THESIS
from tensegrity_mj.model.events import ControlSpec
from tensegrity_mj.model.members import Rod, String, Support
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.model.target import Target, chebyshev_points


def inner_radius(angle: float, rod_length: float, height: float) -> float:
    """r_i [m] of (4.15), with the parenthesis where the figure has it: ℓ² = (h + r_i (1 - cos φ))² + r_i² sin² φ."""
    # Both squares multiplied out: r_i² + h r_i = (ℓ² - h²) / (4 sin²(φ/2)).
    return float(np.sqrt(height**2 / 4 + (rod_length**2 - height**2) / (4 * np.sin(angle / 2) ** 2)) - height / 2)


def lines_of(cells: int) -> list[tuple[int, int]]:
    """The upright lines along the beam: (place in units of φ/3, pair)."""
    pairs = (cells + 1) // 2
    return sorted([(2 * k, k) for k in range(pairs)] + [(2 * k + 3, k) for k in range(pairs)])


def beam_nodes(angle: float, cells: int, rod_length: float, height: float) -> Array:
    """Node positions (2 (cells + 1), 3) [m] for a sector angle φ [rad].

    Rod 2k + 1 of pair k falls from left to right (n_{4k+1} to n_{4k+2}), rod 2k + 2 rises (n_{4k+3} to n_{4k+4}). The
    left line of the first pair stays upright at x = 0 with its lower node at the origin.
    """
    radius = inner_radius(angle, rod_length, height)

    def node(place: int, on_top: bool) -> list[float]:
        turn = place * angle / 3
        # r (cos - 1) as -2 r sin²(/2): r is thousands of metres where the beam is nearly straight.
        distance = radius + height if on_top else radius
        return [distance * np.sin(turn), 0.0, height * on_top - 2 * distance * np.sin(turn / 2) ** 2]

    nodes = []
    for k in range((cells + 1) // 2):
        left, right = 2 * k, 2 * k + 3
        nodes += [node(left, True), node(right, False), node(left, False), node(right, True)]
    return np.array(nodes)


def cell_strings(cells: int) -> list[tuple[str, ...]]:
    """Names of the six strings of each cell: left, top, bottom, rising, falling, right (figure 4.5)."""
    return [
        tuple(f"s{number}" for number in (1 if c == 0 else 5 * c + 1, *range(5 * c + 2, 5 * c + 7)))
        for c in range(cells)
    ]


@value("planar_beam", OptionError)
class PlanarBeam:
    """A beam of overlapping cells that bends from nearly straight into a circle, from rest to rest by one quintic in φ.

    Attributes:
        cells: odd, 3 or more; there are cells + 1 rods and 5 cells + 1 strings.
        rod_length, height: ℓ > h > 0 [m].
        angle: φ of a pair of rods at the start and at the end [rad]; not zero, where the radius is infinite. None at
            the end closes the beam to a full circle, its last line on its first: 6π / (cells + 2), 26.34° for 39 cells.
        rod_mass: [kg].
        stiffness: stiffness of each string [N/m].
        minimum_sum: u_sum [N/m] over all strings (strategy 1), or None.
        minimum_cell_sum: u_sum [N/m] of each cell (strategy 2), or None.
        duration: duration of the motion and of the scene [s].
        shapes: how many of them the target's curve is made of.

    Raises:
        OptionError, StructureError, SceneError: for parameters that make no such scene.
    """

    cells: int = field(None, default=39)
    rod_length: float = field(kinds.positive("m"), default=float(np.sqrt(2.0)))
    height: float = field(kinds.positive("m"), default=1.0)
    angle: tuple[float, float | None] = field(None, default=(float(np.radians(0.01)), None))
    rod_mass: float = 1.0
    stiffness: float = 2000.0
    minimum_sum: float | None = 1960.0
    minimum_cell_sum: float | None = None
    duration: float = 60.0
    shapes: int = field(kinds.whole(2), default=18)
    name: str = "planar_beam"

    def __call__(self) -> Scene:
        if not isinstance(self.cells, (int, np.integer)) or self.cells < 3 or self.cells % 2 == 0:
            raise refused(self, f"cells = {value_text(self.cells)}; it must be an odd number >= 3")
        nodes = 2 * (int(self.cells) + 1)
        check_nodes("planar_beam: cells", self.cells, nodes)
        if not self.rod_length > self.height:
            raise refused(self, f"rod_length = {self.rod_length!r} m; it must exceed the height of {self.height!r} m")
        check_nodes("planar_beam: shapes", self.shapes, nodes * self.shapes, 10 * MOST_NODES)  # in all of them
        pair = sequence_of("planar_beam: angle", self.angle, OptionError)
        if len(pair) != 2:
            raise refused(self, f"angle = {self.angle!r}; it must be two angles [rad], at the start and at the end")
        full = 6 * np.pi / (self.cells + 2)
        if full >= np.pi and None in pair:
            raise OptionError(
                f"planar_beam: angle = {self.angle!r}: {self.cells} cells close to no full circle, which takes 5 or "
                "more; give both angles within (0, π)"
            )
        first, last = (positive("planar_beam: angle", full if value is None else value, "rad") for value in pair)
        if first == last or max(first, last) >= np.pi:
            raise OptionError(
                f"planar_beam: angle = {self.angle!r}; it must be two different angles within (0, π), None for "
                f"6π / {self.cells + 2}"
            )
        low, high = min(first, last), max(first, last)
        parameters = chebyshev_points(low, high, self.shapes)
        curve = [beam_nodes(float(value), self.cells, self.rod_length, self.height) for value in parameters]
        positions = beam_nodes(first, self.cells, self.rod_length, self.height)
        names = [f"n{i + 1}" for i in range(len(positions))]
        free = Support.free(0.5, plane=PLANE)
        rods = tuple(
            Rod(f"rod{i + 1}", (names[2 * i], names[2 * i + 1]), self.rod_mass, 0.02, (SLIDER, HINGE, free)[min(i, 2)])
            for i in range(self.cells + 1)
        )
        structure = Structure(
            name=self.name,
            nodes=dict(zip(names, positions.tolist(), strict=True)),
            rods=rods,
            strings=tuple(
                String(f"s{number + 1}", (names[i], names[j]), self.stiffness)
                for number, (i, j) in enumerate(_string_pairs(self.cells))
            ),
        )
        sums: list[list[object]] = []
        if self.minimum_sum is not None:
            sums.append(["all", self.minimum_sum])
        if self.minimum_cell_sum is not None:
            sums += [[list(strings), self.minimum_cell_sum] for strings in cell_strings(self.cells)]
        return Scene(
            structure,
            name=self.name,
            source=f"{THESIS}, section 4.6.2 and appendix B.2, pages 98-105",
            target=Target.curve([0.0, self.duration], [first, last], parameters.tolist(), curve),
            control=ControlSpec("feedback_linearization", {"sums": sums} if sums else {}),
            duration=self.duration,
        )


planar_beam = function_of(PlanarBeam)


def _string_pairs(cells: int) -> list[tuple[int, int]]:
    """Node rows of the strings: the left upright, then of each cell top, bottom, rising, falling, right upright."""

    def ends(place: int, pair: int) -> tuple[int, int]:  # lower and upper node of a line
        return (4 * pair + 2, 4 * pair) if place == 2 * pair else (4 * pair + 1, 4 * pair + 3)

    lines = [ends(*line) for line in lines_of(cells)]
    pairs = [lines[0]]
    for (low, high), (next_low, next_high) in pairwise(lines):
        pairs += [(high, next_high), (low, next_low), (low, next_high), (high, next_low), (next_low, next_high)]
    return pairs
