"""Computations on the beams of appendix C.2 in waves: tasks of `run_many`, plain values in and out.

A point has "beam", arguments of `beam_in_waves` with enums by their values, and may have "timestep" [s] and "engine",
"dae" (the default) or "mujoco", both with classical Runge-Kutta steps.

A beam starts at rest and is watched over the last whole wave periods of `WATCHED` seconds. Its stages' centres, each
the mean of six nodes, move along the waves (y) and upwards (z); the amplitude of such a motion is half the distance
from its lowest to its highest value.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy.linalg import eigh

from evidence.families.in_waves import beam_in_waves
from evidence.families.towers import top_nodes
from evidence.thesis.disturbance import disturbance_of, disturbed
from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.engines.table import engine_of
from tensegrity_mj.model.elements.water import sea_of, water_forces
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.runs.trajectory import Trajectory
from tensegrity_mj.simulation import simulate
from tensegrity_mj.statics import find_equilibrium
from tensegrity_mj.statics.modes import mass_matrix

DURATION, WATCHED = 90.0, 30.0  # s
TIMESTEP = 3e-3  # s; 4.1e-3 s is the largest stable one
SAMPLES = 10  # steps between samples
COUNT = 6  # of natural motions


def scene_of(point: dict[str, Any]) -> Scene:
    """The scene of a point."""
    scene = beam_in_waves(**{"duration": DURATION, **point["beam"]})
    return disturbed(scene, disturbance_of(point.get("disturbance")))


def in_waves(point: dict[str, Any]) -> dict[str, Any]:
    """Amplitudes [m] of the stages and of the top, their means, tensions and what slackens, in the point's engine."""
    step = point.get("timestep", TIMESTEP)
    engine = engine_of(point.get("engine", "dae"), step)
    return measured(simulate(scene_of(point), None, engine, output_interval=SAMPLES * step))


def measured(run: Trajectory) -> dict[str, Any]:
    """Measure a run over its last `WATCHED` seconds, and how it differs from as many periods before."""
    scene, period = run.scene, 2 * math.pi / float(sea_of(run.scene).frequency[0])
    stages = len(scene.structure.rods) // 3
    centres = run.nodes.reshape(len(run.time), stages, 6, 3).mean(axis=2)
    top = run.nodes[:, [scene.structure.node_index[key] for key in top_nodes(stages)]].mean(axis=1)
    points = np.concatenate([centres, top[:, None]], axis=1)[..., 1:]  # (T, stages + 1, 2)
    points = points - np.concatenate([
        scene.structure.positions.reshape(stages, 6, 3).mean(axis=1), scene.structure.positions[-3:].mean(axis=0)[None]
    ])[:, 1:]  # fmt: skip
    watched = period * math.floor(WATCHED / period)
    late = run.time >= run.time[-1] - watched
    before = (run.time >= run.time[-1] - 2 * watched) & ~late
    amplitudes, earlier = (0.5 * np.ptp(points[rows], axis=0) for rows in (late, before))
    swing = np.exp(-1j * 2 * math.pi / period * run.time[late])[:, None, None]
    at_wave = 2 * np.abs(np.mean((points[late] - points[late].mean(axis=0)) * swing, axis=0))
    return {
        "along": amplitudes[:, 0].tolist(),
        "up": amplitudes[:, 1].tolist(),
        "at_wave_frequency": at_wave[:, 0].tolist(),
        "mean": points[late].mean(axis=0).tolist(),
        "settling": float(np.abs(amplitudes - earlier).max()),
        "period": period,
        "least_tension": float(run.tensions[late].min()),
        "slack": int(np.any(run.tensions[late] <= 0, axis=0).sum()),
        "status": run.status.value,
    }


def modes(point: dict[str, Any]) -> dict[str, Any]:
    """ω [rad/s] of the slowest motions about the straight beam, in air and with added mass, and what takes part in y.

    Drag, which only damps, and waves are left out. "taking_part" is the mass [kg] that moves with a motion along y, in
    water: bending motions come in pairs of equal frequency, one across the other.
    """
    scene = scene_of(point)
    state = find_equilibrium(scene.with_(water=None, gravity=(0.0, 0.0, 0.0), loads=()))
    K, moves = state.stiffness(), state.motions()
    dry = mass_matrix(scene.structure).toarray()
    wet = dry + added_mass_matrix(scene)
    in_air = eigh(0.5 * (K + K.T), moves.T @ dry @ moves, eigvals_only=True)
    squares, shapes = eigh(0.5 * (K + K.T), moves.T @ wet @ moves)
    sideways = np.tile([0.0, 1.0, 0.0], len(scene.nodes0))
    return {
        "in_air": np.sqrt(in_air[:COUNT]).tolist(),
        "in_water": np.sqrt(squares[:COUNT]).tolist(),
        "taking_part": ((shapes[:, :COUNT].T @ (moves.T @ (wet @ sideways))) ** 2).tolist(),
    }


def added_mass_matrix(scene: Scene) -> Array:
    """(3N, 3N) [kg] of the rods at the scene's start: forces of water are those without it less this times ẍ."""
    nodes = scene.nodes0
    added = np.zeros((nodes.size, nodes.size))
    alphas = water_forces(scene, 0.0, nodes, np.zeros_like(nodes))[1]
    for ends, alpha in zip(scene.structure.rod_nodes, alphas, strict=True):
        axis = nodes[ends[1]] - nodes[ends[0]]
        axis = axis / np.linalg.norm(axis)
        across = np.eye(3) - np.outer(axis, axis)
        places = (3 * ends[:, None] + np.arange(3)).ravel()
        added[np.ix_(places, places)] += np.kron(alpha, across)
    return added
