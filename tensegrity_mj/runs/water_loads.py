"""Loads of water on each rod and string along a run: Morison's at the recorded states, added mass included.

Drag, inertia of the water and buoyancy follow from recorded positions and velocities exactly. Added mass answers the
rods' accelerations, which are the slopes of the cubic spline through the recorded velocities: off by about h³/24 of
their third derivative between samples h apart, and more at the ends of the run. Strings take drag alone.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import check_known
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.elements.water import rod_loads, samples_at_once, string_loads
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.runs.recorded import RecordedRun

# What a scene in water lacks whose members of a kind have no loads.
ABSENT = {"rod": "rods", "string": "string_diameter in its water, by which strings take drag"}


def loaded_by_water(scene: Scene) -> tuple[str, ...]:
    """The kinds of members that the water of a scene loads: "rod", "string", both, or none without water."""
    return () if scene.water is None else scene.water_segments.kinds


def water_loads(run: RecordedRun, of: str = "rod") -> Array:
    """The force [N] of the water on each rod (T, R, 3), or on each string (T, M, 3), in the world frame.

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
