"""A planar truss that stands out from a wall: braced by rods near the wall, by strings farther out."""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, dataclass

from tensegrity_mj.basics.checks import check_nodes, finite, positive, whole
from tensegrity_mj.basics.functions import function_of
from tensegrity_mj.errors import OptionError
from tensegrity_mj.library.cable import GRAVITY
from tensegrity_mj.library.cross import PLANE
from tensegrity_mj.model.members import Rod, String, Support
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure

RADIUS = 0.005  # m


@dataclass(frozen=True, eq=False)
class TrussArm:
    """A cantilever of square or rectangular cells in the xz plane, let go from straight under its weight.

    Its lower chord has the joints b0, b1, ..., its upper one t0, t1, ...; b0 and t0 are on the wall. A braced cell has
    rods for both diagonals, one more than it needs to be rigid. In the others both diagonals are strings, which alone
    keep the cell's shape: shortened and let out, they bend the arm.

    Attributes:
        cells: 1 or more.
        braced: how many of them, from the wall on, have rods for diagonals.
        cell_length, height: of a cell [m].
        line_mass: of rods [kg/m].
        stiffness, damping: of strings [N/m], [N s/m].
        tension: of all strings while the arm is straight [N].
        gravity: [m/s²].
        duration: [s].
        name: of scene and structure.

    Raises:
        OptionError, StructureError, SceneError: for parameters that make no such scene.
    """

    cells: int = 4
    braced: int = 1
    _: KW_ONLY
    cell_length: float = 0.25
    height: float = 0.25
    line_mass: float = 0.2
    stiffness: float = 500.0
    damping: float = 1.0
    tension: float = 10.0
    gravity: float = GRAVITY
    duration: float = 5.0
    name: str = "truss_arm"

    def __call__(self) -> Scene:
        count = whole("truss_arm: cells", self.cells, 1)
        check_nodes("truss_arm: cells", self.cells, 2 * (count + 1))
        if whole("truss_arm: braced", self.braced, 0) > count:
            raise OptionError(f"truss_arm: braced = {self.braced!r}; it must be at most the number of cells, {count}")
        step, rise = (
            positive("truss_arm: cell_length", self.cell_length, "m"),
            positive("truss_arm: height", self.height, "m"),
        )
        density = positive("truss_arm: line_mass", self.line_mass, "kg/m")
        if finite("truss_arm: gravity", self.gravity, " [m/s²]") < 0:
            raise OptionError(f"truss_arm: gravity = {self.gravity!r} m/s²; it must be >= 0 m/s²")
        nodes = {}
        for k in range(count + 1):
            nodes[f"b{k}"], nodes[f"t{k}"] = (k * step, 0.0, 0.0), (k * step, 0.0, rise)
        slope = math.hypot(step, rise)
        rods, strings = [], []

        def rod(kind: str, k: int, i: str, j: str, length: float, support: Support) -> None:
            rods.append(Rod(f"{kind}{k}", (i, j), density * length, RADIUS, support))

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
        return Scene(
            structure,
            name=self.name,
            source="our own: rods and strings for diagonals",
            gravity=(0.0, 0.0, -float(self.gravity)),
            duration=self.duration,
        )


truss_arm = function_of(TrussArm)
