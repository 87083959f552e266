"""Moorings and nets of fish farming in waves and a current, at rest at the start where still water holds them."""

from __future__ import annotations

import math

import numpy as np

from tensegrity_mj.basics import kinds
from tensegrity_mj.basics.checks import check_nodes
from tensegrity_mj.basics.fields import field, function_of, refused, value
from tensegrity_mj.errors import OptionError
from tensegrity_mj.library.cable import GRAVITY, chain
from tensegrity_mj.model.elements.water import Water
from tensegrity_mj.model.elements.waves import Wave
from tensegrity_mj.model.events import Load
from tensegrity_mj.model.members import PointMass, String, Support, Vector
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure


@value("moored_chain", OptionError, positional=1)
class MooredChain:
    """A chain of equal rods from an anchor to a float, in waves and a current that begin at t = 0.

    The start is at rest where still water holds it: with the weight w of a rod in water, the float's own lift B and the
    pull H, the k-th of n rods has the slope (B - (n - k + ½) w) / H, which is that of its catenary.

    Attributes:
        elements: n of the chain, 1 or more; the float is one rod more.
        length, line_mass, diameter: length [m], mass [kg/m] and thickness [m] of the chain.
        float_length, float_mass, float_diameter: size [m], mass [kg] and thickness [m] of the float, whose lower end
            is the chain's upper one.
        pull: H [N] along x, constant, where the chain meets the float.
        depth: depth of the anchor, which is at the bottom [m].
        wave_height, wavelength: size of a wave along x [m]; a height of 0 for none.
        current: [m/s].

    Raises:
        OptionError, StructureError, SceneError: for parameters that make no such scene, such as a float that carries
            less than the chain, or that would come out of the water.
    """

    elements: int = field(kinds.whole(1), default=12)
    length: float = field(kinds.positive("m"), default=24.0)
    line_mass: float = field(kinds.positive("kg/m"), default=12.0)
    diameter: float = field(kinds.positive("m"), default=0.04)
    float_length: float = field(kinds.positive("m"), default=2.0)
    float_mass: float = field(kinds.positive("kg"), default=150.0)
    float_diameter: float = field(kinds.positive("m"), default=0.6)
    pull: float = field(kinds.positive("N"), default=1500.0)
    depth: float = field(kinds.positive("m"), default=25.0)
    wave_height: float = field(kinds.not_negative("m"), default=1.5)
    wavelength: float = field(kinds.positive("m"), default=40.0)
    current: Vector = (0.3, 0.2, 0.0)

    def __call__(self) -> Scene:
        count, step = self.elements, self.length / self.elements
        check_nodes("moored_chain: elements", count, count + 2)
        waves = (Wave(0.5 * self.wave_height, self.wavelength),) if self.wave_height else ()
        water = Water(depth=self.depth, waves=waves, current=self.current)
        sections = math.pi / 4 * np.array([self.diameter, self.float_diameter]) ** 2
        weight = GRAVITY * step * (self.line_mass - water.density * sections[0])
        lift = GRAVITY * (water.density * sections[1] * self.float_length - self.float_mass)
        rises = lift - weight * (np.arange(count, 0, -1) - 0.5)
        if rises[0] - 0.5 * weight <= 0:
            raise refused(self, f"its float lifts {lift:.6g} N, less than its chain's {count * weight:.6g} N in water")
        along = np.column_stack([np.full(count, self.pull), np.zeros(count), rises])
        steps = [*(step * along / np.linalg.norm(along, axis=1)[:, None]), [0.0, 0.0, self.float_length]]
        nodes = np.cumsum([[0.0, 0.0, -self.depth], *steps], axis=0)
        if nodes[-1, 2] > -0.5 * self.wave_height:
            raise refused(self, f"its float ends at {nodes[-1, 2]:.6g} m, above troughs; use a shorter chain")
        masses = [self.line_mass * step] * count + [self.float_mass]
        radii = [0.5 * self.diameter] * count + [0.5 * self.float_diameter]
        structure = chain("moored_chain", nodes, masses, radii, {0: Support.pinned(0.0)}, Support.free(0.0))
        return Scene(
            structure,
            name="moored_chain",
            source="our own, for the moorings of fish farming",
            gravity=(0.0, 0.0, -GRAVITY),
            loads=(Load(f"n{count}", (self.pull, 0.0, 0.0)),),
            water=water,
            duration=20.0,
        )


@value("fish_net", OptionError, positional=2)
class FishNet:
    """A plane net in the yz plane, held at its upper edge and at both sides, across a wave and a current along x.

    Knots are `n{row}_{column}`, rows from the collar downwards; twines are `down{row}_{column}` and
    `across{row}_{column}` by the knot that they start at, each standing for all those of the width of a mesh. At the
    start the panel is plane and at rest, where still water holds it.

    Attributes:
        rows, columns: meshes downwards and across, 1 and 2 or more.
        mesh: width and height of one [m].
        solidity: what twines shade of the panel, both ways together; each string is ½ of it times `mesh` thick.
        stiffness: stiffness of each string [N/m].
        spread: tension of the strings across at the start [N].
        knot_mass, sinker: mass of each knot, and of what the lowest carry in addition [kg], less the water displaced.
        top: depth of the collar below the still surface [m].
        wave_height, wavelength: size of a wave along x [m]; a height of 0 for none.
        current: [m/s].

    Raises:
        OptionError, StructureError, SceneError: for parameters that make no such scene.
    """

    rows: int = field(kinds.whole(1), default=4)
    columns: int = field(kinds.whole(2), default=4)
    mesh: float = field(kinds.positive("m"), default=1.0)
    solidity: float = field(kinds.number("within (0, 1)", lambda x: 0 < x < 1), default=0.2)
    stiffness: float = field(kinds.positive("N/m"), default=2e4)
    spread: float = field(kinds.positive("N"), default=100.0)
    knot_mass: float = field(kinds.positive("kg"), default=0.5)
    sinker: float = field(kinds.not_negative("kg"), default=10.0)
    top: float = field(kinds.not_negative("m"), default=1.0)
    wave_height: float = field(kinds.not_negative("m"), default=1.0)
    wavelength: float = field(kinds.positive("m"), default=25.0)
    current: Vector = (0.5, 0.0, 0.0)

    def __call__(self) -> Scene:
        down, across, mesh = self.rows, self.columns, self.mesh
        check_nodes("fish_net: meshes", (down, across), (down + 1) * (across + 1))
        places = [(i, j) for i in range(down + 1) for j in range(across + 1) if i > 0 or 0 < j < across]
        fixed = {(i, j) for i, j in places if i == 0 or j in (0, across)}
        masses = {p: self.knot_mass + (self.sinker if p[0] == down else 0.0) for p in places if p not in fixed}
        strings = []
        for i, j in places:
            ends = (f"n{i}_{j}", f"n{i}_{j + 1}")
            if i > 0 and j < across:
                strings.append(String(f"across{i}_{j}", ends, self.stiffness, tension=self.spread))
            if i < down and 0 < j < across:
                pull = GRAVITY * sum(masses[k, j] for k in range(i + 1, down + 1))
                strings.append(String(f"down{i}_{j}", (ends[0], f"n{i + 1}_{j}"), self.stiffness, tension=pull))
        structure = Structure(
            "fish_net",
            {f"n{i}_{j}": (0.0, (j - 0.5 * across) * mesh, -self.top - i * mesh) for i, j in places},
            (),
            tuple(strings),
            tuple(f"n{i}_{j}" for i, j in places if (i, j) in fixed),
            tuple(PointMass(f"n{i}_{j}", mass) for (i, j), mass in masses.items()),
        )
        waves = (Wave(0.5 * self.wave_height, self.wavelength),) if self.wave_height else ()
        thick = 0.5 * self.solidity * mesh
        return Scene(
            structure,
            name="fish_net",
            source="our own, for the nets of fish farming",
            gravity=(0.0, 0.0, -GRAVITY),
            water=Water(waves=waves, current=self.current, string_diameter=thick),
            duration=10.0,
        )


moored_chain = function_of(MooredChain)
fish_net = function_of(FishNet)
