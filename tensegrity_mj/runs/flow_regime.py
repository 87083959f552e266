"""Loads of water along a run, and its Reynolds and Keulegan-Carpenter numbers, against the ranges of §7.2.2.

Both numbers are of the largest speed across a rod, over the recorded times and the wet parts of its segments, of the
water as the moving rod meets it: that is what its drag and its added mass depend on. The speed of the undisturbed
water, which is that of a structure that is held, gives the other pair.

    Rn = u d / ν        C_d = 1.2 and the like are those of subcritical flow, Rn <= 2e5
    KC = u T / d        T the period of the component with the fastest orbits where the rod is, that of the peak in an
                        irregular sea; §7.2.2 assumes 15 to 45
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import check_known
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.elements.water import rod_loads, samples_at_once, sea_of, segments_of, string_loads
from tensegrity_mj.model.elements.waves import AboveLevel
from tensegrity_mj.model.rods import diameters
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.runs.recorded import RecordedRun

LARGEST_REYNOLDS = 2e5
KEULEGAN_CARPENTER = (15.0, 45.0)
STEEPEST = np.pi / 7  # k A: a height of 1/7 of the length
STEEPEST_SEA = 1 / 7  # 2π H_s/(g T_p²): height over length of such a wave in deep water, where it is longest
HIGHEST = 0.39  # A of the depth: a height of 0.78 of it


@dataclass(frozen=True, eq=False)
class FlowNumbers:
    """Reynolds and Keulegan-Carpenter numbers of the flow around the rods of a run.

    Attributes:
        reynolds, keulegan_carpenter: (R,) of the flow that the rods meet; KC is NaN of rods that meet no waves.
        undisturbed_reynolds, undisturbed_keulegan_carpenter: (R,) of the flow as it would be without them moving.
        notes: what is outside the ranges of §7.2.2, in words.
    """

    reynolds: Array
    keulegan_carpenter: Array
    undisturbed_reynolds: Array
    undisturbed_keulegan_carpenter: Array
    notes: tuple[str, ...]

    def report(self) -> dict[str, Any]:
        """The largest Rn (None without rods), the least and the largest KC (None without waves) and notes, for JSON."""
        met = self.keulegan_carpenter[~np.isnan(self.keulegan_carpenter)]
        return {
            "reynolds": float(self.reynolds.max()) if len(self.reynolds) else None,
            "keulegan_carpenter": [float(met.min()), float(met.max())] if len(met) else None,
            "notes": list(self.notes),
        }


def flow_numbers(run: RecordedRun) -> FlowNumbers:
    """The numbers of a run.

    Raises:
        OptionError: where its scene has no water.
    """
    scene, water = run.scene, run.scene.water
    if water is None:
        raise OptionError(f"flow_numbers: scene '{scene.name}' has no water")
    R = len(scene.structure.rods)
    d, sea = diameters(scene.structure, water.diameter), sea_of(scene)
    met, undisturbed, orbits = np.zeros(R), np.zeros(R), np.zeros((R, len(sea.amplitude)))
    piece = samples_at_once(scene)
    for first in range(0, len(run.time), piece):
        rows = slice(first, first + piece)
        wet = segments_of(scene, run.time[rows], run.nodes[rows], run.velocities[rows])
        for most, flow in ((met, wet.flow), (undisturbed, wet.undisturbed)):
            across = flow - np.sum(flow * wet.axes, axis=-1, keepdims=True) * wet.axes
            speed = np.where(wet.part > 0, np.linalg.norm(across, axis=-1), 0.0)
            np.maximum(most, speed.max(axis=(0, 2), initial=0.0), out=most)
        if orbits.size:
            fast = np.where((wet.part > 0)[..., None], sea.orbit_speeds(wet.points[..., 2]), 0.0)
            np.maximum(orbits, fast.max(axis=(0, 2)), out=orbits)
    period = np.full(R, np.nan)
    moved = orbits.max(axis=1, initial=0.0) > 0
    if moved.any():
        peak = None if water.sea is None else water.sea.peak_period
        period[moved] = peak or 2 * np.pi / sea.frequency[orbits[moved].argmax(axis=1)]
    numbers = [(speed * d / water.viscosity, speed * period / d) for speed in (met, undisturbed)]
    return FlowNumbers(*numbers[0], *numbers[1], _notes(run, *numbers[0]))


def _notes(run: RecordedRun, reynolds: Array, keulegan_carpenter: Array) -> tuple[str, ...]:
    names, notes = [rod.name for rod in run.scene.structure.rods], _beyond_linear_theory(run)
    fast = reynolds > LARGEST_REYNOLDS
    if fast.any():
        notes.append(
            f"Reynolds numbers of {_of(fast)} are above {LARGEST_REYNOLDS:g}, up to {reynolds.max():.3g} "
            f"(rod '{names[int(np.argmax(reynolds))]}'): the flow is no longer subcritical, and drag may be smaller"
        )
    low, high = KEULEGAN_CARPENTER
    outside = (keulegan_carpenter < low) | (keulegan_carpenter > high)  # False where there are no waves
    if outside.any():
        found = keulegan_carpenter[outside]
        notes.append(
            f"Keulegan-Carpenter numbers of {_of(outside)} are outside {low:g} to {high:g}, from {found.min():.3g} to "
            f"{found.max():.3g}: coefficients of drag and added mass depend on them"
        )
    return tuple(notes)


def _beyond_linear_theory(run: RecordedRun) -> list[str]:
    sea, notes = sea_of(run.scene), []
    steepness = sea.number * sea.amplitude
    if np.any(steepness > STEEPEST):
        worst = int(steepness.argmax())
        notes.append(
            f"{_component(run, worst)} is {steepness[worst] / np.pi:.3g} of its length high; waves above 1/7 break, "
            "and linear theory does not hold for them"
        )
    if np.any(sea.amplitude > HIGHEST * sea.depth):
        worst = int(sea.amplitude.argmax())
        notes.append(
            f"{_component(run, worst)} has an amplitude of {sea.amplitude[worst]:g} m in {sea.depth:g} m of water; "
            "waves higher than 0.78 of the depth break, and linear theory does not hold for them"
        )
    water, crest = run.scene.water, float(np.max(sea.number, initial=0.0))
    if water is not None and (irregular := water.sea) is not None:
        steep = 2 * np.pi * irregular.significant_height / (sea.gravity * irregular.peak_period**2)
        if steep > STEEPEST_SEA:
            notes.append(
                f"the sea has a steepness 2π H_s/(g T_p²) = {steep:.3g}; waves above 1/7 break, and linear theory does "
                "not hold for them"
            )
        crest *= irregular.significant_height
        if crest > 1 and water.above is AboveLevel.EXPONENTIAL:
            notes.append(
                f"the sea's shortest component has k H_s = {crest:.3g}, so that its velocities are exaggerated "
                'in crests above the still surface: give above = "constant"'
            )
    lowest = float(run.nodes[..., 2].min(initial=0.0))
    if lowest < -sea.depth:
        notes.append(f"a node is at z = {lowest:.3g} m, below the bottom at {-sea.depth:g} m, which nothing here stops")
    return notes


def _component(run: RecordedRun, number: int) -> str:
    """Name of a component of the water in messages."""
    assert run.scene.water is not None
    own = len(run.scene.water.waves)
    return f"waves[{number}]" if number < own else f"component {number - own} of the sea"


def _of(chosen: NDArray[np.bool_]) -> str:
    return f"{int(chosen.sum())} of {len(chosen)} rods"


# What a scene in water lacks whose members of a kind have no loads.
ABSENT = {"rod": "rods", "string": "string_diameter in its water, by which strings take drag"}


def loaded_by_water(scene: Scene) -> tuple[str, ...]:
    """The kinds of members that the water of a scene loads: "rod", "string", both, or none without water."""
    return () if scene.water is None else scene.water_segments.kinds


def water_loads(run: RecordedRun, of: str = "rod") -> Array:
    """The force [N] of the water on each rod (T, R, 3), or on each string (T, M, 3), in the world frame.

    Morison's loads at the recorded states, added mass included. Drag, inertia of the water and buoyancy follow from
    recorded positions and velocities exactly. Added mass answers the rods' accelerations, which are the slopes of the
    cubic spline through the recorded velocities: off by about h³/24 of their third derivative between samples h apart,
    and more at the ends of the run. Strings take drag alone.

    Raises:
        OptionError: where the scene has no water, no rods, or no string_diameter that strings take drag by; where the
            run has fewer than the two samples that accelerations of rods need.
    """
    scene = run.scene
    check_known("water_loads", of, ABSENT, "kind of member")
    if of not in loaded_by_water(scene):
        raise OptionError(f"water_loads: scene '{scene.name}' has no {ABSENT[of] if scene.water else 'water'}")
    return _on_rods(run) if of == "rod" else _on_strings(run)


def _on_strings(run: RecordedRun) -> Array:
    """Loads (T, M, 3) [N] on strings."""
    scene, paths = run.scene, run.scene.structure.paths
    found, piece = np.zeros((len(run.time), len(paths.ranges), 3)), samples_at_once(scene)
    for first in range(0, len(run.time), piece):
        rows = slice(first, first + piece)
        loads = string_loads(scene, run.time[rows], run.nodes[rows], run.velocities[rows])
        found[rows] = paths.total(loads.sum(axis=-2), axis=-2)
    return found


def _on_rods(run: RecordedRun) -> Array:
    """Loads (T, R, 3) [N] on rods."""
    if len(run.time) < 2:
        raise OptionError(f"water_loads: the run has {len(run.time)} samples; two are needed for accelerations")
    scene, structure = run.scene, run.scene.structure
    from scipy.interpolate import CubicSpline

    ends = CubicSpline(run.time, run.velocities).derivative()(run.time)[:, structure.rod_nodes]
    span = np.diff(run.nodes[:, structure.rod_nodes], axis=2)
    axes = span / np.linalg.norm(span, axis=-1, keepdims=True)
    across = ends - np.sum(ends * axes, axis=-1, keepdims=True) * axes
    found, piece = np.zeros_like(across[:, :, 0]), samples_at_once(scene)
    for first in range(0, len(run.time), piece):
        rows = slice(first, first + piece)
        loads, alpha = rod_loads(scene, run.time[rows], run.nodes[rows], run.velocities[rows])
        found[rows] = loads.sum(axis=-2) - np.einsum("trij,trjx->trx", alpha, across[rows])
    return found
