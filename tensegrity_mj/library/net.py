"""A rectangular net of rods that hangs from its corners, or from two of its edges."""

from __future__ import annotations

import enum
from collections.abc import Sequence

import numpy as np

from tensegrity_mj.basics import kinds
from tensegrity_mj.basics.checks import MOST_FOUND, check_nodes, whole
from tensegrity_mj.basics.fields import field, function_of, value
from tensegrity_mj.errors import OptionError
from tensegrity_mj.library import cable, cross, suspended_cable
from tensegrity_mj.model.events import Load
from tensegrity_mj.model.members import Rod, Support
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure


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
        rod_mass: of each rod [kg].
        load: [N] downwards on the node in the middle (rounded down), from t = 0 on; 0 for none.
        gravity: [m/s²].
        duration: [s].
        name: of scene and structure.

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
        source = f"our own; rods like those of the cable of {cross.THESIS}, section 3.3, pages 66-69"
        loads = (Load(middle, (0.0, 0.0, -self.load)),) if self.load else ()
        return cable.scene_of(self, suspended_cable.hung(structure, self.spacing, self.gravity), source, loads=loads)


net = function_of(Net)
