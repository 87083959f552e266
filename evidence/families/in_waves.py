"""Towers in waves: beams held under waves from their side (thesis, appendix C.2), and free towers (section 7.2.3).

    beam_in_waves("TB1", 2.0)                                  # a point of figure C.8
    beam_in_waves("TB4", 4.0, end=BeamEnd.CLAMPED)
    held_in_waves(tower(6, tension=2e3, stiffness=1e5), Water(waves=(Wave(0.2, 8.0, direction=1.5),)), 3.0)
    tower_in_waves()                                           # the softest of the thesis' nine
    tower_in_waves(3e4, 0.20)                                  # its stiffest
    tower_in_waves(stages=8, wave_height=0.6, wavelength=9.0, direction=0.5)

The beam is form-found without gravity and water and lies along x, its base at x = 0; waves travel along +y. The thesis
does not say how it is held. Appendix C.1 holds a beam for its lateral stiffness so that it is one half of a beam that
is clamped at both ends: the base does not move, the top keeps its place along the beam and does not turn. That is the
default here. Neither does it give the weight: a steel tube of Table C.1 weighs three times the water that it displaces,
and the beam is so soft that it would hang 8 m down, below the waves that it is to be tried in. So the default carries
the weight in water by constant forces on the nodes, and the beam is straight at rest.

The free tower is form-found without gravity and water, too. It lies along x, its base towards waves that travel along
+x, and starts at rest with its axis `start_depth` below the still surface, from where it rises and floats.
"""

from __future__ import annotations

import enum
import math

import numpy as np

from evidence.families import thesis_towers
from evidence.families.towers import shared_fields, tower_like
from tensegrity_mj.basics import kinds
from tensegrity_mj.basics.checks import member, positive
from tensegrity_mj.basics.fields import field, function_of, value
from tensegrity_mj.errors import OptionError
from tensegrity_mj.library.cable import GRAVITY
from tensegrity_mj.library.cross import THESIS
from tensegrity_mj.library.tower import Topology, with_supports
from tensegrity_mj.model.elements.water import Water, Weights
from tensegrity_mj.model.elements.waves import Wave
from tensegrity_mj.model.events import Load
from tensegrity_mj.model.members import Support, Vector
from tensegrity_mj.model.rods import diameters
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.statics import find_equilibrium

STEEPNESS = 1 / 7  # height over length
SUBMERGENCE = 4.0  # m
DRAG, TANGENTIAL_DRAG, ADDED_MASS, INERTIA = 1.0, 0.1, 0.5, 1.5
ALONG, UPWARDS = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)


class BeamEnd(enum.Enum):
    """Supports of the three nodes of a beam's top; those of its base do not move at all."""

    GUIDED = "guided"  # they move across the beam only: the middle of a beam that is twice as long and clamped
    GUIDED_ALONG_WAVES = "guided_along_waves"  # they move only as the waves travel: C.1.4 to the letter
    CLAMPED = "clamped"  # they do not move
    FREE = "free"


class BeamWeight(enum.Enum):
    """Treatments of a beam's weight in water."""

    CARRIED = "carried"  # constant forces on the nodes balance it as long as they are under water
    HANGING = "hanging"  # it acts, and the beam starts at rest where it hangs in still water


@value("beam_in_waves", OptionError, positional=2)
class BeamInWaves:
    """A beam of appendix C under a regular wave from its side; the defaults are a point of figure C.8.

    Attributes:
        which: "TB1" to "TB7", a row of Table C.2; figure C.8 has the first four.
        wave_height: H = 2 A [m], > 0; 1 to 4 m in the thesis.
        steepness: H over the wavelength, > 0.
        submergence: depth of the beam's axis below the still surface [m], > 0.
        end, weight: see `BeamEnd` and `BeamWeight`.
        damping: damping of every string [N s/m]; the thesis damps numerically, with α = -0.05 of Hilber, Hughes and
            Taylor.
        drag, tangential_drag, added_mass, inertia: coefficients of the rods, see `Water`.
        segments: number of segments of each rod; with more than three, motions in waves of 6 m differ by less than a
            thousandth. None for as many as the waves need.
        phase: ε of the wave [rad]; its elevation at the beam is A sin(ω t + ε).
        duration: [s].
        name: name of scene and structure; by default that of the row.

    Raises:
        OptionError, InfeasibleError, StructureError, SceneError: for parameters that make no such scene.
    """

    which: str = "TB1"
    wave_height: float = field(kinds.positive("m"), default=2.0)
    steepness: float = field(kinds.positive(), default=STEEPNESS)
    submergence: float = SUBMERGENCE
    end: BeamEnd = BeamEnd.GUIDED
    weight: BeamWeight = BeamWeight.CARRIED
    damping: float = 0.0
    drag: float = DRAG
    tangential_drag: float = TANGENTIAL_DRAG
    added_mass: float = ADDED_MASS
    inertia: float | None = INERTIA
    segments: int | None = 3
    phase: float = 0.0
    duration: float = 60.0
    name: str = ""

    def __call__(self) -> Scene:
        tower = thesis_towers.appendix_beam(self.which, damping=self.damping, duration=self.duration, name=self.name)
        wave = Wave(0.5 * self.wave_height, self.wave_height / self.steepness, None, 0.5 * math.pi, self.phase)
        water = Water(waves=(wave,), **shared_fields(Water, self))
        return held_in_waves(tower, water, self.submergence, self.end, self.weight).with_(
            source=f"{THESIS}, appendix C.2, pages 194-196"
        )


beam_in_waves = function_of(BeamInWaves)


WAVE_HEIGHT, WAVELENGTH = 1.0, 15.0  # m, §7.2.3
START_DEPTH = 1.0  # m: the axes of figures 7.6 and 7.7 have the beam 1 m below z = 0


@value("tower_in_waves", OptionError, positional=2)
class TowerInWaves:
    """A free tower of aluminium tubes of 1.22 m in one harmonic wave; the defaults are §7.2.3's softest case.

    The thesis leaves open which strings there are, how wide a stage is, and where in the wave the tower starts.

    Attributes:
        stiffness: stiffness of every string [N/m]; 10, 20 and 30 kN/m in the thesis.
        prestress_measure: L - L0 of every string before form-finding [m]; 0.10, 0.15 and 0.20 m in the thesis.
        stages: 1 or more.
        topology: which diagonals.
        radius: R of a stage before form-finding [m]; ℓ/√6 = 0.498 m by default.
        damping: damping of every string [N s/m]; the thesis states none.
        wave_height: H = 2 A [m], >= 0; 0 for still water.
        wavelength: [m].
        direction: to which waves travel [rad], from the tower's axis, x, towards y.
        phase: ε of the wave [rad]; its elevation is A sin(ω t + ε) where the base is.
        water_depth: [m]; None for deep water.
        current: [m/s].
        drag, tangential_drag, added_mass: C_d, C_t, C_a of the rods.
        segments, weights: how loads are gathered along a rod, see `Water`; None for as many as the wave needs.
        start_depth: depth of the tower's axis below the still surface [m]; below zero above it.
        duration: [s].
        name: name of scene and structure.

    Raises:
        OptionError, InfeasibleError, StructureError, SceneError: for parameters that make no such scene.
    """

    stiffness: float = thesis_towers.STIFFNESSES[0]
    prestress_measure: float = thesis_towers.PRESTRESS_MEASURES[0]
    stages: int = thesis_towers.CHAPTER7_STAGES
    topology: Topology = Topology.FULL
    radius: float | None = None
    damping: float = 0.0
    wave_height: float = field(kinds.not_negative("m"), default=WAVE_HEIGHT)
    wavelength: float = field(kinds.positive("m"), default=WAVELENGTH)
    direction: float = 0.0
    phase: float = 0.0
    water_depth: float | None = None
    current: Vector = (0.0, 0.0, 0.0)
    drag: float = 1.2
    tangential_drag: float = 0.0
    added_mass: float = 1.0
    segments: int | None = None
    weights: Weights = Weights.RIGID
    start_depth: float = START_DEPTH
    duration: float = 40.0
    name: str = "tower_in_waves"

    def __call__(self) -> Scene:
        height = self.wave_height
        wave = Wave(0.5 * height, self.wavelength, None, self.direction, self.phase)
        water = Water(depth=self.water_depth, waves=(wave,) if height else (), **shared_fields(Water, self))
        scene = tower_like(self, origin=(0.0, 0.0, -self.start_depth), gravity=GRAVITY)
        return scene.with_(water=water, source=f"{THESIS}, section 7.2.3, pages 154-157")


tower_in_waves = function_of(TowerInWaves)


def held_in_waves(
    tower: Scene,
    water: Water,
    submergence: float,
    end: BeamEnd = BeamEnd.GUIDED,
    weight: BeamWeight = BeamWeight.CARRIED,
) -> Scene:
    """A tower under water, held at its ends.

    Args:
        tower: made by `tower`, lying along x and in equilibrium; its gravity, loads and supports are replaced.
        water: and its waves.
        submergence: by how much the tower is lowered [m], > 0.
        end, weight: as of `beam_in_waves`.

    Raises:
        OptionError: for arguments that do not fit, and a scene that is no tower.
        InfeasibleError, SceneError: where nothing balances a hanging beam, or the water does not fit.
    """
    member("end", end, BeamEnd)
    member("weight", weight, BeamWeight)
    depth = positive("submergence", submergence, "m")
    structure = _held(tower.structure, end).moved(translation=(0.0, 0.0, -depth))
    forces = _weights_in_water(structure, water)
    loads = tuple(Load(key, (0.0, 0.0, force)) for key, force in forces.items())
    # Without water and gravity: statics has no water, and under it buoyancy and weight are constant.
    dry = tower.with_(structure=structure, gravity=(0.0, 0.0, 0.0), loads=(), water=None)
    if weight is BeamWeight.CARRIED:
        return dry.with_(gravity=(0.0, 0.0, -GRAVITY), loads=loads, water=water)
    pulled = tuple(Load(load.node, (0.0, 0.0, -load.force[2])) for load in loads)
    hanging = find_equilibrium(dry.with_(loads=pulled)).nodes
    return dry.with_(gravity=(0.0, 0.0, -GRAVITY), initial_nodes=hanging, water=water)


def _held(structure: Structure, end: BeamEnd) -> Structure:
    """The structure with the base pinned and its top held."""
    stages = len(structure.rods) // 3
    base, top = ([rod for rod in structure.rods if rod.name.startswith(f"rod{s}_")] for s in (1, stages))
    if stages < 2 or len(base) != 3 or len(top) != 3:
        raise OptionError(
            f"held_in_waves: '{structure.name}' is no tower of two stages or more: its rods must be rod1_1 to rodN_3, "
            "as those of tower(N, ...)"
        )
    ends = {
        BeamEnd.GUIDED: Support.constrained([ALONG], 1.0),
        BeamEnd.GUIDED_ALONG_WAVES: Support.constrained([ALONG, UPWARDS], 1.0),
        BeamEnd.CLAMPED: Support.pinned(1.0),
        BeamEnd.FREE: Support.free(),
    }
    supports = {rod.name: Support.free() for rod in structure.rods}
    supports |= {rod.name: ends[end] for rod in top}
    supports |= {rod.name: Support.pinned(0.0) for rod in base}
    return with_supports(structure, supports)


def _weights_in_water(structure: Structure, water: Water) -> dict[str, float]:
    """[N] of weight less buoyancy on each node, of rods that are closed and wholly under water."""
    displaced = water.density * np.pi * diameters(structure, water.diameter) ** 2 / 4 * structure.rod_lengths
    forces: dict[str, float] = {}
    for rod, mass in zip(structure.rods, displaced, strict=True):
        for node in rod.nodes:
            forces[node] = forces.get(node, 0.0) + 0.5 * GRAVITY * (rod.mass - float(mass))
    return forces
