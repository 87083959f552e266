"""Cables and nets of rods that hang at rest: the rope of the thesis' chapter 3 between two supports, and a net."""

from __future__ import annotations

import enum
import math
from collections.abc import Sequence

import numpy as np

from tensegrity_mj.basics import kinds
from tensegrity_mj.basics.arrays import Array, bisect
from tensegrity_mj.basics.checks import MOST_FOUND, check_nodes, positive, whole
from tensegrity_mj.basics.fields import field, function_of, value
from tensegrity_mj.errors import InfeasibleError, OptionError
from tensegrity_mj.library import cable
from tensegrity_mj.library.cross import THESIS
from tensegrity_mj.model.events import Load
from tensegrity_mj.model.members import Rod, Support
from tensegrity_mj.model.motion import Motion
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.statics.equilibrium import find_equilibrium
from tensegrity_mj.statics.model import StaticModel


def catenary(span: float, rise: float, length: float, elements: int) -> Array:
    """Nodes (K + 1, 3) [m] at equal arc lengths of a catenary from the origin to (span, 0, rise), length > distance.

    With a its parameter, x = a (u - u₀), z = a (cosh u - cosh u₀) and s = a (sinh u - sinh u₀), where u runs over
    m - X to m + X: tanh m = rise / length, and X = span / 2a solves sinh X / X = √(length² - rise²) / span.
    """
    # A fold so narrow that only its width, which is in proportion, depends on the span.
    wide = max(span, 1e-12 * length)
    flat = math.sqrt(1 - (rise / length) ** 2) * (length / wide)
    X = 0.5 * sum(bisect(lambda x: math.sinh(x) < flat * x, 0.0, 100.0, 1e-58))  # sinh X / X is monotonic
    a, middle = wide / (2 * X), math.atanh(rise / length)
    first = middle - X
    u = np.arcsinh(np.linspace(0.0, length / a, elements + 1) + math.sinh(first))
    u[0], u[-1] = first, middle + X
    nodes = np.column_stack([a * (u - first) * (span / wide), 0 * u, a * (np.cosh(u) - math.cosh(first))])
    nodes[-1] = span, 0.0, rise
    return nodes


@value("suspended_cable", OptionError, positional=1)
class SuspendedCable:
    """A chain of equal rods between two supports, at the start where it hangs; the right support moves to and fro.

    The left support is the origin, the right one at (span, 0, rise); it moves along x by amplitude · sin(2πft).

    Attributes:
        elements: rods, 3 or more.
        span, rise: place of the right support, along x and z [m].
        length, mass: length and mass of the cable [m], [kg].
        amplitude: amplitude of the right support [m]; 0 for supports that stand still.
        frequency: frequency of the right support [Hz].
        gravity: [m/s²].
        duration: [s].
        name: name of scene and structure.

    Raises:
        OptionError, InfeasibleError, StructureError, SceneError: for parameters that make no such scene.
    """

    elements: int = field(kinds.whole(3), default=22)
    span: float = field(kinds.positive("m"), default=2.0)
    rise: float = 0.0
    length: float = field(kinds.positive("m"), default=cable.ROPE_LENGTH)
    mass: float = field(kinds.positive("kg"), default=cable.RopeMass.TABLE.kilograms)
    amplitude: float = field(kinds.not_negative("m"), default=0.03)
    frequency: float = 0.6
    gravity: float = cable.GRAVITY
    duration: float = 10.0
    name: str = "suspended_cable"

    def __call__(self) -> Scene:
        count, size = self.elements, self.amplitude
        check_nodes("suspended_cable: elements", count, count + 1, MOST_FOUND)
        farthest = math.hypot(self.span + size, self.rise)
        if not farthest < self.length:
            raise OptionError(
                f"suspended_cable: length = {self.length!r} m; it must exceed the {farthest:.6g} m that the supports "
                "come to be apart"
            )
        guess = catenary(self.span, self.rise, self.length, count)
        motions: tuple[Motion, ...] = ()
        if size:
            hertz = positive("suspended_cable: frequency", self.frequency, "Hz")
            motions = (Motion.in_line(f"rod{count}", size, hertz, (1.0, 0.0, 0.0)),)
        held = {0: Support.pinned(0.0), count - 1: Support.pinned(1.0)}
        masses, radii = [self.mass / count] * count, [cable.ROPE_RADIUS] * count
        structure = cable.chain(self.name, guess, masses, radii, held, Support.free(0.0))
        source = f"our own; the rope of {THESIS}, section 3.3, pages 66-69"
        return cable.scene_of(self, hung(structure, self.length / count, self.gravity), source, motions=motions)


suspended_cable = function_of(SuspendedCable)


SPRINGS = (0.0, 1e-2, 1e-4)  # what stands in for rods at first: by which part they stretch under the whole weight
PUSHED = 1e-9  # of the weight: a rod that is compressed by less is not


def hung(structure: Structure, length: float, gravity: float) -> Structure:
    """The structure where its rods, each of that length [m], hang from its supports under gravity [m/s²] along -z.

    Its nodes are a first guess, between which rods may have other lengths. Where the rods come to no rest from there,
    or to one in which some are compressed, it starts again from where springs in place of the rods hang. Where every
    rod pulls, the equilibrium is a stable one, however it was found.

    Raises:
        OptionError: for gravity that is not > 0.
        InfeasibleError: where no equilibrium is found: held nodes too far from each other, for one.
    """
    weight = positive("gravity", gravity, "m/s²") * float(structure.rod_masses.sum())
    model = StaticModel.of(Scene(structure, gravity=(0.0, 0.0, -gravity)))
    model = model.with_(rod_lengths=np.full(len(structure.rods), length))
    found = None
    for part in SPRINGS:
        try:
            springs = model.with_(compliance=part * model.rod_lengths / weight)
            start = find_equilibrium(springs, stable=False).nodes if part else model.start
            found = find_equilibrium(model.with_(start=start), stable=False)
        except InfeasibleError:
            continue
        if found.rod_forces.min() >= -PUSHED * weight:
            break
    if found is None:
        raise InfeasibleError(
            f"the rods of '{structure.name}' hang in no equilibrium that could be found: held nodes may be too far "
            "from each other, or the first guess too far from where it hangs"
        )
    return structure.placed(found.nodes)


class Held(enum.Enum):
    """Nodes of a net that are fixed in space."""

    CORNERS = "corners"
    EDGES = "edges"  # all nodes of the first and of the last row: a hammock


@value("net", OptionError, positional=1)
class Net:
    """A net at the start where it hangs; from then on a weight pulls at the node in its middle.

    Rows run along y and follow each other along x. Nodes are `n{row}_{column}`, rods `x{row}_{column}` and
    `y{row}_{column}` by the node that they start at.

    Attributes:
        cells: (along x, along y), 2 or more; 1 or more along held edges.
        held: its corners, or its first and last row (whose rods are left out then).
        slack: within (0, 1): the part by which held nodes are nearer to each other than flat: in both directions for
            corners, in x for edges.
        spacing: length of each rod [m].
        rod_mass: mass of each rod [kg].
        load: [N] downwards on the node in the middle (rounded down), from t = 0 on; 0 for none.
        gravity: [m/s²].
        duration: [s].
        name: name of scene and structure.

    Raises:
        OptionError, InfeasibleError, StructureError, SceneError: for parameters that make no such scene.
    """

    cells: tuple[int, int] = field(None, default=(4, 4))
    held: Held = Held.CORNERS
    slack: float = field(kinds.number("within (0, 1)", lambda x: 0 < x < 1), default=0.1)
    spacing: float = field(kinds.positive("m"), default=0.25)
    rod_mass: float = field(kinds.positive("kg"), default=cable.ROPE_ELEMENT_MASS)
    load: float = field(kinds.not_negative("N"), default=0.5)
    gravity: float = cable.GRAVITY
    duration: float = 3.0
    name: str = "net"

    def __call__(self) -> Scene:
        if not isinstance(self.cells, (Sequence, np.ndarray)) or isinstance(self.cells, str) or len(self.cells) != 2:
            raise OptionError(f"net: cells = {self.cells!r}; it must be two numbers of cells, along x and along y")
        across, along = (whole("net: cells", value, 1) for value in self.cells)
        check_nodes("net: cells", self.cells, (across + 1) * (along + 1), MOST_FOUND)
        edges = self.held is Held.EDGES
        if across < 2 or (along < 2 and not edges):
            raise OptionError(
                f"net: cells = {self.cells!r}: there must be 2 or more between held nodes, which are nearer to each "
                "other than flat"
            )

        def row_of(i: int, j: int) -> int:
            return i * (along + 1) + j

        # u, v within [0, 1]; the guess hangs about as deep as a rope of that slack does.
        u, v = (
            a.ravel() for a in np.meshgrid(np.linspace(0, 1, across + 1), np.linspace(0, 1, along + 1), indexing="ij")
        )
        width, depth = (
            across * self.spacing * (1 - self.slack),
            along * self.spacing * (1.0 if edges else 1 - self.slack),
        )
        sag = np.sqrt(0.75 * self.slack)
        z = -sag * (width * 4 * u * (1 - u) + (0.0 if edges else depth * 4 * v * (1 - v))) / 2
        guess = np.column_stack([width * u, depth * v, z])
        rods: dict[str, tuple[int, int]] = {}
        for i in range(across + 1):
            for j in range(along + 1):
                if i < across:
                    rods[f"x{i}_{j}"] = (row_of(i, j), row_of(i + 1, j))
                if j < along and not (edges and i in (0, across)):
                    rods[f"y{i}_{j}"] = (row_of(i, j), row_of(i, j + 1))
        columns = range(along + 1) if edges else (0, along)
        fixed = [row_of(i, j) for i in (0, across) for j in columns]
        names = [f"n{i}_{j}" for i in range(across + 1) for j in range(along + 1)]
        supports: dict[str, Support] = {}
        for row in fixed:  # one rod for each node that is held, one that holds no other
            rod = next(key for key, pair in rods.items() if row in pair and key not in supports)
            supports[rod] = Support.pinned(float(rods[rod][1] == row))
        structure = Structure(
            name=self.name,
            nodes=dict(zip(names, guess.tolist(), strict=True)),
            rods=tuple(
                Rod(key, (names[i], names[j]), self.rod_mass, cable.ROPE_RADIUS, supports.get(key, Support.free(0.0)))
                for key, (i, j) in rods.items()
            ),
        )
        middle = names[row_of(across // 2, along // 2)]
        source = f"our own; rods like those of the cable of {THESIS}, section 3.3, pages 66-69"
        loads = (Load(middle, (0.0, 0.0, -self.load)),) if self.load else ()
        return cable.scene_of(self, hung(structure, self.spacing, self.gravity), source, loads=loads)


net = function_of(Net)
