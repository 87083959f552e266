"""A planar truss that stands out from a wall: braced by rods near the wall, by strings farther out."""

from __future__ import annotations

import math

from tensegrity_mj.basics import kinds
from tensegrity_mj.basics.checks import check_nodes
from tensegrity_mj.basics.fields import field, function_of, refused, value
from tensegrity_mj.errors import OptionError
from tensegrity_mj.library.cable import GRAVITY, scene_of
from tensegrity_mj.library.cross import PLANE
from tensegrity_mj.model.members import Rod, String, Support
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure

RADIUS = 0.005  # m


@value("truss_arm", OptionError, positional=2)
class TrussArm:
    """A cantilever of square or rectangular cells in the xz plane, let go from straight under its weight.

    Its lower chord has the joints b0, b1, ..., its upper one t0, t1, ...; b0 and t0 are on the wall. A braced cell has
    rods for both diagonals, one more than it needs to be rigid. In the others both diagonals are strings, which alone
    keep the cell's shape: shortened and let out, they bend the arm.

    Attributes:
        cells: 1 or more.
        braced: how many of them, from the wall on, have rods for diagonals.
        cell_length, height: size of a cell [m].
        line_mass: mass of rods per length [kg/m].
        stiffness, damping: stiffness and damping of strings [N/m], [N s/m].
        tension: tension of all strings while the arm is straight [N].
        gravity: [m/s²].
        duration: [s].
        name: name of scene and structure.

    Raises:
        OptionError, StructureError, SceneError: for parameters that make no such scene.
    """

    cells: int = field(kinds.whole(1), default=4)
    braced: int = field(kinds.whole(0), default=1)
    cell_length: float = field(kinds.positive("m"), default=0.25)
    height: float = field(kinds.positive("m"), default=0.25)
    line_mass: float = field(kinds.positive("kg/m"), default=0.2)
    stiffness: float = 500.0
    damping: float = 1.0
    tension: float = 10.0
    gravity: float = field(kinds.not_negative("m/s²"), default=GRAVITY)
    duration: float = 5.0
    name: str = "truss_arm"

    def __call__(self) -> Scene:
        count, step, rise = self.cells, self.cell_length, self.height
        check_nodes("truss_arm: cells", count, 2 * (count + 1))
        if self.braced > count:
            raise refused(self, f"braced = {self.braced!r}; it must be at most the number of cells, {count}")
        nodes = {}
        for k in range(count + 1):
            nodes[f"b{k}"], nodes[f"t{k}"] = (k * step, 0.0, 0.0), (k * step, 0.0, rise)
        slope = math.hypot(step, rise)
        rods, strings = [], []

        def rod(kind: str, k: int, i: str, j: str, length: float, support: Support) -> None:
            rods.append(Rod(f"{kind}{k}", (i, j), self.line_mass * length, RADIUS, support))

        hinge, loose = Support.pinned(0.0, plane=PLANE), Support.free(0.0, plane=PLANE)
        for k in range(1, count + 1):
            chord = hinge if k == 1 else loose
            rod("lower", k, f"b{k - 1}", f"b{k}", step, chord)
            rod("upper", k, f"t{k - 1}", f"t{k}", step, chord)
            rod("post", k, f"b{k}", f"t{k}", rise, loose)
            diagonals = (("rising", f"b{k - 1}", f"t{k}"), ("falling", f"t{k - 1}", f"b{k}"))
            for kind, i, j in diagonals:
                if k <= self.braced:
                    rod(kind, k, i, j, slope, loose)
                else:
                    strings.append(String(f"{kind}{k}", (i, j), self.stiffness, self.damping, tension=self.tension))
        structure = Structure(self.name, nodes, tuple(rods), tuple(strings))
        return scene_of(self, structure, "our own: rods and strings for diagonals")


truss_arm = function_of(TrussArm)
