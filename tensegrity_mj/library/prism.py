"""Regular tensegrity prisms of any number of rods, and the robot of three."""

from __future__ import annotations

import math

from tensegrity_mj.basics import kinds
from tensegrity_mj.basics.checks import check_nodes
from tensegrity_mj.basics.fields import field, function_of, refused, value
from tensegrity_mj.errors import OptionError
from tensegrity_mj.library.cable import GRAVITY
from tensegrity_mj.library.robots import UPRIGHT, force_density, on_floor, polygon
from tensegrity_mj.model.members import Rod, String, Vector
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure

CONNELLY = "R. Connelly and M. Terrell, Globally rigid symmetric tensegrities, Structural Topology 21 (1995) 59-78"
CHEN = (
    "N. Chen et al., Learning differentiable tensegrity dynamics using graph neural networks, CoRL 2024, and the "
    "configuration of their three-bar robot (github.com/nchen9191/tensegrity_gnn_simulator_public)"
)


@value("prism", OptionError, positional=1)
class Prism:
    """A prism of n rods and 3n strings in equilibrium without gravity, above a floor.

    Rod r{i} runs from r{i}a in the bottom polygon to r{i}b in the top one. The top one is turned so that each `side`
    string spans the angle π/2 - π/n and each rod π/2 + π/n: at this twist alone, and with force densities of

        side u,      bottom and top u / (2 sin(π/n)),      rods -u,

    every node is in balance.

    Attributes:
        n: rods, 3 or more.
        rod_length, height: length of a rod, and distance of the polygons [m]; the polygons' radius follows.
        rod_mass, radius: mass and radius of a rod [kg], [m].
        stiffness, damping: stiffness and damping of every string [N/m], [N s/m].
        side_stiffness: stiffness of the side strings [N/m], where it is another.
        prestress: force density of bottom and top over `stiffness`, (L - L0)/L; 0.1 where there is no `tension` either.
        tension: tension of bottom and top [N] instead.
        base: three nodes on which it stands; of the bottom by default.
        tilt: by which it is then turned [rad], along the axis.
        drop: height of its lowest surface above the floor [m].
        friction: coefficient of friction of the floor.
        gravity: [m/s²] downwards.
        duration: [s].
        name: name of scene and structure.

    Raises:
        OptionError, StructureError, SceneError: for parameters that make no such scene.
    """

    n: int = field(kinds.whole(3), default=3)
    rod_length: float = field(kinds.positive("m"), default=0.5)
    height: float = field(kinds.positive("m"), default=0.3)
    rod_mass: float = field(kinds.positive("kg"), default=0.2)
    radius: float = field(kinds.positive("m"), default=0.008)
    stiffness: float = field(kinds.positive("N/m"), default=1500.0)
    damping: float = 20.0
    side_stiffness: float | None = field(kinds.positive("N/m"), none="None", default=None)
    prestress: float | None = field(kinds.within(0, 0.9), none="None", default=None)
    tension: float | None = field(kinds.not_negative("N"), none="None", default=None)
    base: tuple[str, ...] | None = field(kinds.names("node"), none="None", default=None)
    tilt: Vector = field(kinds.vector("rad"), default=UPRIGHT)
    drop: float = field(kinds.not_negative("m"), default=0.0)
    friction: float = 0.6
    gravity: float = field(kinds.not_negative("m/s²"), default=GRAVITY)
    duration: float = 3.0
    name: str = "prism"

    def __call__(self) -> Scene:
        return self.scene(f"our own sizes; the twist of regular prisms: {CONNELLY}")

    def scene(self, source: str) -> Scene:
        """The scene, with where its numbers come from."""
        n, half = self.n, math.pi / self.n
        check_nodes("prism: n", n, 2 * n)
        if not self.height < self.rod_length:
            raise refused(self, f"height = {self.height!r} m; it must be less than rod_length = {self.rod_length:g} m")
        across = math.sqrt((self.rod_length - self.height) * (self.rod_length + self.height))
        wide = across / (2 * math.sin(math.pi / 4 + half / 2))  # rods span π/2 + π/n
        flat = force_density(self, 2 * wide * math.sin(half))
        side = flat * 2 * math.sin(half)
        stiff = self.stiffness if self.side_stiffness is None else self.side_stiffness
        if not (flat < self.stiffness and side < stiff):
            raise refused(
                self,
                f"force densities of {flat:.6g} N/m in the polygons and {side:.6g} N/m in the sides; they must be less "
                f"than the strings' stiffness, {self.stiffness:g} and {stiff:g} N/m: give less tension",
            )
        low, high = polygon(n, wide, 0.0, 0.0), polygon(n, wide, math.pi / 2 + half, self.height)
        names = [f"r{i + 1}" for i in range(n)]
        nodes = {
            f"{rod}{end}": place
            for end, rows in (("a", low), ("b", high))
            for rod, place in zip(names, rows, strict=True)
        }
        pairs = list(zip(names, names[1:] + names[:1], strict=True))
        strings = [
            *((f"bottom{i + 1}", (f"{x}a", f"{y}a")) for i, (x, y) in enumerate(pairs)),
            *((f"top{i + 1}", (f"{x}b", f"{y}b")) for i, (x, y) in enumerate(pairs)),
            *((f"side{i + 1}", (f"{y}a", f"{x}b")) for i, (x, y) in enumerate(pairs)),
        ]
        structure = Structure(
            self.name,
            {name: place.tolist() for name, place in nodes.items()},
            tuple(Rod(rod, (f"{rod}a", f"{rod}b"), self.rod_mass, self.radius) for rod in names),
            tuple(
                String(name, ends, stiff, self.damping, force_density=side)
                if name[0] == "s"
                else String(name, ends, self.stiffness, self.damping, force_density=flat)
                for name, ends in strings
            ),
        )
        return on_floor(self, structure, self.base or tuple(f"{rod}a" for rod in names[:3]), source)


prism = function_of(Prism)


def three_bar_robot(
    prestress: float = 0.21, base: tuple[str, str, str] = ("r1a", "r3b", "r2b"), friction: float = 0.92
) -> Scene:
    """The three-bar robot of Rutgers and Yale as a regular prism on its side: six active strings, three passive.

    From its published configuration: rods of 0.325 m, of 133 g with two motors and two end caps each if its masses are
    grams, round ends of 17.5 mm, passive side strings a tenth as stiff as those of the triangles and stretched by 21 %
    of their length, friction of 0.92. Triangles of 0.236 m there make the regular prism 0.19 m high, with sides of
    0.203 m (0.209 m there). Stiffness and damping are ours.

    Args:
        prestress: force density of the side strings over their stiffness, (L - L0)/L.
        base: three nodes on which it stands.
        friction: coefficient of friction of the floor.
    """
    softness = 0.1  # of the sides, against the triangles' strings
    robot = Prism(
        rod_length=0.325,
        height=0.19,
        rod_mass=0.133,
        radius=0.0175,
        stiffness=4000.0,
        side_stiffness=4000.0 * softness,
        damping=5.0,
        prestress=prestress * softness / math.sqrt(3),
        base=base,
        friction=friction,
        name="three_bar_robot",
    )
    return robot.scene(CHEN)
