"""Towers of three-rod prisms, as Snelson's needle tower: thesis, section 7.2.3 and appendix C.1.

    tower(15)                                # form-found, lying along x, free
    before = tower(15, form_found=False)     # rods where they are laid out, strings pulled in
    after = form_find(before)                # the same tower in equilibrium

Stage s = 1 ... N stands on the one below, turned against it by 60°. Its nodes b{s}_1 to b{s}_3 at the bottom and
t{s}_1 to t{s}_3 above them are at the angles 120° (i - 1) + 60° (s - 1). A right-handed stage has rods b{s}_i to
t{s}_{i+1}, a left-handed one b{s}_i to t{s}_{i-1}, i counted around. Strings are the triangles at both ends, `base_i`
and `top_i`; `vertical{s}_i`, b{s}_i to t{s}_i; six `saddle{s}_j` between t{s} and b{s+1}, each with its two neighbours;
and `diagonal{s}_j`, of which there are three choices (`Topology`). Before form-finding all strings but saddles and
diagonals are as long as in a single prism, and the rods of one stage end where those of the next begin.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from tensegrity_mj.basics import kinds
from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import MOST_FOUND, MOST_NODES, check_nodes
from tensegrity_mj.basics.fields import field, function_of, refused, value
from tensegrity_mj.errors import OptionError
from tensegrity_mj.library.cable import scene_of
from tensegrity_mj.library.cross import THESIS
from tensegrity_mj.model.members import Rod, String, Support, Vector
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.section import Section
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.statics import find_equilibrium

Ends = tuple[str, str]

ROD_LENGTH = 1.22  # m, §7.2.3
PRESTRESS_MEASURE = 0.10  # m, §7.2.3


class Topology(enum.Enum):
    """Diagonals of a tower of N stages; they lean with the rods of their stage."""

    FULL = "full"  # 15N - 6 strings: from b of a stage up to b of the next, and from t of a stage down to t of the last
    REDUCED_A = "reduced_a"  # 12N: from b to t within each stage
    REDUCED_B = "reduced_b"  # 12N: from b of a stage up to b of the next, and from b to t within the last stage


class Axis(enum.Enum):
    """Directions of a tower's axis from its base."""

    X = "x"  # lying, as in chapter 7 and appendix C
    Z = "z"  # standing


@value("tower", OptionError, positional=1)
class Tower:
    """A tower of `stages` prisms at rest; the defaults are the aluminium tubes and softest strings of §7.2.3.

    A stage is ℓ long along its rods, H high and R wide, ℓ² = H² + 3 R²; at most two of them are given. With ℓ alone
    R = ℓ/√6, H = ℓ/√2: appendix C's prism, whose triangles have sides as long as it is high.

    Attributes:
        stages: N, 1 or more.
        rod_length, radius, height: ℓ, R, H [m]; 1.22 m for ℓ where neither it nor both others are given.
        topology: which diagonals.
        alternating: whether every second stage leans the other way (appendix C), or none does (chapter 7).
        mirrored: whether the first stage is left-handed; the mirror image of the other tower.
        stiffness, damping: stiffness and damping of every string [N/m], [N s/m].
        prestress_measure: L - L0 of every string before form-finding [m]; 0.10 m where `tension` is not given either.
        tension: tension of every string before form-finding [N] instead: L0 = L - tension / stiffness.
        outer_diameter, inner_diameter: diameters of the rods [m]; an inner one of 0 makes them solid.
        density, elasticity_modulus, yield_stress: material of the rods [kg/m³], [Pa], [Pa]; the yield stress may be
            unknown.
        axis: lying or standing.
        origin: centre of the base triangle [m].
        pinned_base: whether the three nodes of the base are fixed in space; where form-finding leaves them.
        form_found: whether the strings have found their equilibrium, see `form_find`; else nodes are as laid out.
        gravity: [m/s²] downwards; form-finding does not account for it.
        duration: [s].
        name: name of scene and structure.

    Raises:
        OptionError, InfeasibleError, StructureError, SceneError: for parameters that make no such tower.
    """

    stages: int = field(kinds.whole(1))
    rod_length: float | None = field(kinds.positive("m"), none="None", default=None)
    radius: float | None = field(kinds.positive("m"), none="None", default=None)
    height: float | None = field(kinds.positive("m"), none="None", default=None)
    topology: Topology = Topology.FULL
    alternating: bool = False
    mirrored: bool = False
    stiffness: float = field(kinds.positive("N/m"), default=1e4)
    damping: float = 0.0
    prestress_measure: float | None = field(kinds.positive("m"), none="None", default=None)
    tension: float | None = field(kinds.positive("N"), none="None", default=None)
    outer_diameter: float = field(kinds.positive("m"), default=0.10)
    inner_diameter: float = field(kinds.not_negative("m"), default=0.09)
    density: float = field(kinds.positive("kg/m³"), default=2700.0)
    elasticity_modulus: float = field(kinds.positive("Pa"), default=70e9)
    yield_stress: float | None = field(kinds.positive("Pa"), none="None where it is unknown", default=None)
    axis: Axis = Axis.X
    origin: Vector = field(kinds.vector("m"), default=(0.0, 0.0, 0.0))
    pinned_base: bool = False
    form_found: bool = True
    gravity: float = field(kinds.not_negative("m/s²"), default=0.0)
    duration: float = 5.0
    name: str = "tower"

    def __call__(self) -> Scene:
        check_nodes("tower: stages", self.stages, 6 * self.stages, MOST_FOUND if self.form_found else MOST_NODES)
        wide, high = _proportions(self.rod_length, self.radius, self.height)
        outer = self.outer_diameter
        if not self.inner_diameter < outer:
            raise refused(
                self, f"inner_diameter = {self.inner_diameter!r} m; it must be less than outer_diameter = {outer:g} m"
            )
        section = Section.tube(outer / 2, (outer - self.inner_diameter) / 2, self.elasticity_modulus, self.yield_stress)
        spring = self.stiffness
        mass = self.density * section.area * math.hypot(high, math.sqrt(3) * wide)
        nodes = _laid_out(self.stages, wide, high, self.axis, np.array(self.origin))
        hands = [(-1 if self.mirrored else 1) * (-1 if self.alternating and s % 2 else 1) for s in range(self.stages)]
        pairs = dict(_strings(hands, self.topology))
        lengths = {key: float(np.linalg.norm(nodes[j] - nodes[i])) for key, (i, j) in pairs.items()}
        short = _shortening(self.prestress_measure, self.tension, spring)
        tightest = min(lengths, key=lambda key: lengths[key])
        if not short < lengths[tightest]:
            raise OptionError(
                f"tower: strings are to be {short:g} m shorter at rest than before form-finding, but '{tightest}' is "
                f"{lengths[tightest]:.6g} m long; give less tension or a smaller prestress_measure, or stiffer strings"
            )
        structure = Structure(
            self.name,
            {key: place.tolist() for key, place in nodes.items()},
            tuple(
                Rod(
                    f"rod{s + 1}_{i + 1}", (_node("b", s, i), _node("t", s, i + hand)), mass, outer / 2, section=section
                )
                for s, hand in enumerate(hands)
                for i in range(3)
            ),
            tuple(
                String(key, ends, spring, self.damping, rest_length=lengths[key] - short) for key, ends in pairs.items()
            ),
        )
        if self.pinned_base:
            structure = with_supports(structure, {f"rod1_{i}": Support.pinned(0.0) for i in (1, 2, 3)})
        source = f"{THESIS}, section 7.2.3 and appendix C.1, pages 154-157 and 185-194"
        scene = scene_of(self, structure, source)
        return form_find(scene) if self.form_found else scene


tower = function_of(Tower)


def form_find(scene: Scene) -> Scene:
    """The tower in the equilibrium of its strings, without gravity and loads, and free at both ends.

    The centre of its base, the direction of its axis and that of b1_1 from it stay. Strings keep their rest lengths. A
    base that is pinned is pinned where it then is.

    Raises:
        InfeasibleError: if the strings have no such equilibrium.
    """
    structure = scene.structure
    free = with_supports(structure, dict.fromkeys((rod.name for rod in structure.rods), Support.free()))
    found = find_equilibrium(Scene(free)).nodes
    origin, frame = _frame(structure.positions)
    centre, turned = _frame(found)
    nodes = origin + (found - centre) @ turned.T @ frame
    return scene.with_(structure=structure.with_strings(rest_length=structure.rest_lengths).placed(nodes))


def _proportions(rod_length: float | None, radius: float | None, height: float | None) -> tuple[float, float]:
    """R and H [m] of a stage before form-finding."""
    if rod_length is not None and radius is not None and height is not None:
        raise OptionError(
            f"tower: rod_length = {rod_length!r}, radius = {radius!r}, height = {height!r}; two of them make the third"
        )
    if radius is not None and height is not None:
        return radius, height
    long = ROD_LENGTH if rod_length is None else rod_length
    if height is not None:
        if height >= long:
            raise OptionError(f"tower: height = {height!r} m; it must be less than rod_length = {long:g} m")
        return math.sqrt((long - height) * (long + height) / 3), height
    wide = long / math.sqrt(6) if radius is None else radius
    across = math.sqrt(3) * wide
    if across >= long:
        raise OptionError(
            f"tower: radius = {radius!r} m; it must be less than rod_length / √3 = {long / math.sqrt(3):.6g} m, where "
            "rods lie flat"
        )
    return wide, math.sqrt((long - across) * (long + across))


def _shortening(prestress_measure: float | None, tension: float | None, stiffness: float) -> float:
    """L - L0 [m] of every string before form-finding."""
    if prestress_measure is not None and tension is not None:
        raise OptionError(
            f"tower: prestress_measure = {prestress_measure!r} m and tension = {tension!r} N; give one of them"
        )
    if tension is not None:
        return tension / stiffness
    return PRESTRESS_MEASURE if prestress_measure is None else prestress_measure


def _laid_out(stages: int, radius: float, height: float, axis: Axis, origin: Array) -> dict[str, Array]:
    """Name and position [m] of every node before form-finding, stage after stage."""
    nodes = {}
    for s in range(stages):
        for kind, level in (("b", s * height), ("t", (s + 1) * height)):
            for i in range(3):
                angle = math.radians(120 * i + 60 * s)
                place = np.array([radius * math.cos(angle), radius * math.sin(angle), level])
                nodes[_node(kind, s, i)] = origin + (np.roll(place, 1) if axis is Axis.X else place)
    return nodes


def _strings(hands: list[int], topology: Topology) -> Iterable[tuple[str, Ends]]:
    """Name and nodes of every string; hands are 1 for right-handed stages, -1 for left-handed ones.

    A diagonal leans with the rods of its stage: from b around by half a corner in the rods' sense where it goes up to
    the next b, and from t against it where it goes down to the last t. In the numbers of the nodes half a corner
    forward is i from one stage to the next and i + 1 to the last, half a corner back i - 1 and i. Within a
    stage rod and vertical take two of the three nodes that a diagonal may go to.
    """
    last = len(hands) - 1
    for i in range(3):
        yield f"base_{i + 1}", (_node("b", 0, i), _node("b", 0, i + 1))
    for s, hand in enumerate(hands):
        for i in range(3):
            yield f"vertical{s + 1}_{i + 1}", (_node("b", s, i), _node("t", s, i))
        diagonals = []
        if topology is not Topology.REDUCED_A and s < last:
            diagonals += [(_node("b", s, i), _node("b", s + 1, i if hand > 0 else i - 1)) for i in range(3)]
        if topology is Topology.FULL and s > 0:
            diagonals += [(_node("t", s, i), _node("t", s - 1, i if hand > 0 else i + 1)) for i in range(3)]
        if topology is Topology.REDUCED_A or (topology is Topology.REDUCED_B and s == last):
            diagonals += [(_node("b", s, i), _node("t", s, i - hand)) for i in range(3)]
        for number, ends in enumerate(diagonals, 1):
            yield f"diagonal{s + 1}_{number}", ends
        for i in range(3 if s < last else 0):
            for number, j in ((2 * i + 1, i), (2 * i + 2, i - 1)):
                yield f"saddle{s + 1}_{number}", (_node("t", s, i), _node("b", s + 1, j))
    for i in range(3):
        yield f"top_{i + 1}", (_node("t", last, i), _node("t", last, i + 1))


def _node(kind: str, stage: int, corner: int) -> str:
    """The name of a node; stages and corners count from 0 here, corners around."""
    return f"{kind}{stage + 1}_{corner % 3 + 1}"


def with_supports(structure: Structure, supports: dict[str, Support]) -> Structure:
    """The structure with other supports of the rods named."""
    return replace(
        structure, rods=tuple(replace(rod, support=supports.get(rod.name, rod.support)) for rod in structure.rods)
    )


def _frame(nodes: Array) -> tuple[Array, Array]:
    """Centre (3,) [m] of the base, and rows (3, 3): along the axis, from the centre to b1_1 across it, their normal."""
    centre = nodes[:3].mean(axis=0)
    along = nodes[-3:].mean(axis=0) - centre
    along /= np.linalg.norm(along)
    across = nodes[0] - centre
    across = across - (across @ along) * along
    across /= np.linalg.norm(across)
    return centre, np.array([along, across, np.cross(along, across)])
