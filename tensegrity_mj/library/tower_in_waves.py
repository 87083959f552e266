"""Towers in waves: the simulations of the thesis, section 7.2.3, and others of their kind.

    tower_in_waves()                                   # the softest of the thesis' nine
    tower_in_waves(3e4, 0.20)                          # its stiffest
    tower_in_waves(stages=8, wave_height=0.6, wavelength=9.0, direction=0.5)

The tower is form-found without gravity and water, lies along x, its base towards waves that travel along +x, and starts
at rest with its axis `start_depth` below the still surface, from where it rises and floats.
"""

from __future__ import annotations

from tensegrity_mj.basics import kinds
from tensegrity_mj.basics.fields import field, function_of, value
from tensegrity_mj.errors import OptionError
from tensegrity_mj.library import cable, cross, thesis_towers, tower
from tensegrity_mj.model.elements.water import Water, Weights
from tensegrity_mj.model.elements.waves import Wave
from tensegrity_mj.model.members import Vector
from tensegrity_mj.model.scene import Scene

WAVE_HEIGHT, WAVELENGTH = 1.0, 15.0  # m, §7.2.3
START_DEPTH = 1.0  # m: the axes of figures 7.6 and 7.7 have the beam 1 m below z = 0


@value("tower_in_waves", OptionError, positional=2)
class TowerInWaves:
    """A free tower of aluminium tubes of 1.22 m in one harmonic wave; the defaults are §7.2.3's softest case.

    The thesis leaves open which strings there are, how wide a stage is, and where in the wave the tower starts.

    Attributes:
        stiffness: of every string [N/m]; 10, 20 and 30 kN/m in the thesis.
        prestress_measure: L - L0 of every string before form-finding [m]; 0.10, 0.15 and 0.20 m in the thesis.
        stages: 1 or more.
        topology: which diagonals.
        radius: R of a stage before form-finding [m]; ℓ/√6 = 0.498 m by default.
        damping: of every string [N s/m]; the thesis states none.
        wave_height: H = 2 A [m], >= 0; 0 for still water.
        wavelength: [m].
        direction: to which waves travel [rad], from the tower's axis, x, towards y.
        phase: ε of the wave [rad]; its elevation is A sin(ω t + ε) where the base is.
        water_depth: [m]; None for deep water.
        current: [m/s].
        drag, tangential_drag, added_mass: C_d, C_t, C_a of the rods.
        segments, weights: how loads are gathered along a rod, see `Water`; None for as many as the wave needs.
        start_depth: of the tower's axis below the still surface [m]; below zero above it.
        duration: [s].
        name: of scene and structure.

    Raises:
        OptionError, InfeasibleError, StructureError, SceneError: for parameters that make no such scene.
    """

    stiffness: float = thesis_towers.STIFFNESSES[0]
    prestress_measure: float = thesis_towers.PRESTRESS_MEASURES[0]
    stages: int = thesis_towers.CHAPTER7_STAGES
    topology: tower.Topology = tower.Topology.FULL
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
        water = Water(depth=self.water_depth, waves=(wave,) if height else (), **tower.shared_fields(Water, self))
        scene = tower.tower_like(self, origin=(0.0, 0.0, -self.start_depth), gravity=cable.GRAVITY)
        return scene.with_(water=water, source=f"{cross.THESIS}, section 7.2.3, pages 154-157")


tower_in_waves = function_of(TowerInWaves)
