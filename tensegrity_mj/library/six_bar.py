"""The six-bar robot: the expanded octahedron, whose twelve nodes are nearly those of an icosahedron."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any

import numpy as np

from tensegrity_mj.basics import kinds
from tensegrity_mj.basics.fields import field, function_of, refused, value
from tensegrity_mj.errors import OptionError
from tensegrity_mj.library.cable import GRAVITY
from tensegrity_mj.library.robots import UPRIGHT, force_density, on_floor
from tensegrity_mj.model.members import Rod, String, Vector
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure

SKELTON = "R. E. Skelton and M. C. de Oliveira, Tensegrity Systems, Springer 2009"
SABELHAUS = (
    "A. P. Sabelhaus et al., System design and locomotion of SUPERball, an untethered tensegrity robot, ICRA 2015; "
    "numbers of its version 1.5 as in NASA's Tensegrity Robotics Toolkit (T6Model.cpp)"
)
# SUPERball's strings with a motor: two of each node, none in two opposite triangles, two in each other one.
ACTIVE = """r1a_r4a r1a_r6b r1b_r3a r1b_r5b r2a_r4b r2a_r6a r2b_r3b r2b_r5a r3a_r6b r3b_r5b r4a_r6a r4b_r5a""".split()


@value("icosahedron", OptionError)
class Icosahedron:
    """Six rods in three parallel pairs, half a rod's length apart, and 24 strings, above a floor.

    Rods r1 and r2 are along x before it is stood up, r3 and r4 along y, r5 and r6 along z, each from r{i}a to r{i}b.
    Each node has four strings, to the ends of the four rods that are not of its pair: all are √6/4 of a rod long, and
    in balance under one force density u, rods at -3/2 u. Strings are named by their nodes. Eight of the twenty faces
    are triangles of three strings (closed); twelve have two strings and the half rod's length between ends of a pair.

    Attributes:
        rod_length, rod_mass, radius: [m], [kg], [m].
        stiffness, damping: stiffness and damping of every string [N/m], [N s/m].
        prestress: force density over stiffness, (L - L0)/L; 0.1 where there is no `tension` either.
        tension: tension of every string [N] instead.
        base: three nodes on which it stands; a closed triangle by default.
        tilt, drop, friction, gravity, duration, name: as of `Prism` [rad], [m], [1], [m/s²], [s].

    Raises:
        OptionError, StructureError, SceneError: for parameters that make no such scene.
    """

    rod_length: float = field(kinds.positive("m"), default=0.6)
    rod_mass: float = field(kinds.positive("kg"), default=0.2)
    radius: float = field(kinds.positive("m"), default=0.012)
    stiffness: float = field(kinds.positive("N/m"), default=1000.0)
    damping: float = 10.0
    prestress: float | None = field(kinds.within(0, 0.9), none="None", default=None)
    tension: float | None = field(kinds.not_negative("N"), none="None", default=None)
    base: tuple[str, ...] = field(kinds.names("node"), default=("r1a", "r4a", "r6b"))
    tilt: Vector = field(kinds.vector("rad"), default=UPRIGHT)
    drop: float = field(kinds.not_negative("m"), default=0.0)
    friction: float = 0.6
    gravity: float = field(kinds.not_negative("m/s²"), default=GRAVITY)
    duration: float = 3.0
    name: str = "icosahedron"

    def __call__(self) -> Scene:
        return on_floor(self, self.structure(), self.base, f"our own sizes; the shape: {SKELTON}")

    def structure(self) -> Structure:
        """The structure, its centre at the origin, each rod along an axis."""
        half, near = self.rod_length / 2, self.rod_length / 4
        nodes: dict[str, Any] = {}
        for i in range(6):
            axis = i // 2
            for end, sign in (("a", -1.0), ("b", 1.0)):
                place = np.zeros(3)
                place[axis], place[axis - 1] = sign * half, near if i % 2 == 0 else -near
                nodes[f"r{i + 1}{end}"] = place
        density = force_density(self, length := self.rod_length * np.sqrt(6) / 4)
        if not density < self.stiffness:
            raise refused(
                self,
                f"tension = {self.tension!r} N; strings of {length:.6g} m and {self.stiffness:g} N/m carry less than "
                f"{self.stiffness * length:.6g} N",
            )
        pairs = [
            (i, j)
            for i, j in itertools.combinations(nodes, 2)
            if abs(np.linalg.norm(nodes[i] - nodes[j]) - length) < 1e-3 * length
        ]
        return Structure(
            self.name,
            {name: place.tolist() for name, place in nodes.items()},
            tuple(Rod(f"r{i}", (f"r{i}a", f"r{i}b"), self.rod_mass, self.radius) for i in range(1, 7)),
            tuple(String(f"{i}_{j}", (i, j), self.stiffness, self.damping, force_density=density) for i, j in pairs),
        )


icosahedron = function_of(Icosahedron)


def superball(tension: float = 83.0, drop: float = 0.0, duration: float = 3.0) -> Scene:
    """NASA's SUPERball: rods of 1.7 m and 3.45 kg, twelve active strings and twelve soft, passive ones.

    Strings of both groups, `active` (3152.36 N/m) and `passive` (998.25 N/m), have one tension, which the symmetric
    shape needs; in the published model all are stretched by 4 cm, by 126 and 40 N, of which the default is the mean.
    Damping is 50 N s/m, the floor's friction 0.99.

    Args:
        tension: tension of every string [N].
        drop: height of the lowest surface above the floor [m].
        duration: [s].
    """
    robot = Icosahedron(
        rod_length=1.7,
        rod_mass=3.45,
        radius=0.04,
        stiffness=3152.36,
        damping=50.0,
        tension=tension,
        drop=drop,
        friction=0.99,
        duration=duration,
        name="superball",
    )
    structure = robot.structure()
    strings = (
        replace(string, group="active") if string.name in ACTIVE else replace(string, group="passive", stiffness=998.25)
        for string in structure.strings
    )
    return on_floor(robot, replace(structure, strings=tuple(strings)), robot.base, SABELHAUS)
