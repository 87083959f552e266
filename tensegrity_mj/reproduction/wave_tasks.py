"""What is computed of the beams of appendix C.2 in waves: tasks of `run_many`, plain values in and out.

A point has "beam", arguments of `beam_in_waves` with enums by their values, and may have "engine", "dae" (default) or
"mujoco", and "timestep" [s]. Both engines take the classical Runge-Kutta steps. "twice" doubles the wave's amplitude
and leaves its length.

A beam starts at rest and is watched over the last whole wave periods of `WATCHED` seconds. Its stages' centres, each
the mean of six nodes, move along the waves (y) and upwards (z); the amplitude of such a motion is half the distance
from its lowest to its highest value.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.families.beam_in_waves import GRAVITY, BeamEnd, BeamWeight, beam_in_waves
from tensegrity_mj.families.tower import top_nodes
from tensegrity_mj.scene import Scene
from tensegrity_mj.trajectory import Trajectory
from tensegrity_mj.waves import angular_frequency

Array = NDArray[np.float64]

DURATION, WATCHED = 90.0, 30.0  # s
TIMESTEP = 3e-3  # s; 4.1e-3 s is the largest stable one
SAMPLES = 10  # steps between samples


def scene_of(point: dict[str, Any]) -> Scene:
    """The scene of a point."""
    given = {"duration": DURATION, **point["beam"]}
    for name, kind in (("end", BeamEnd), ("weight", BeamWeight)):
        if name in given:
            given[name] = kind(given[name])
    scene = beam_in_waves(**given)
    if not point.get("twice", False):
        return scene
    assert scene.water is not None
    higher = tuple(replace(wave, amplitude=2 * wave.amplitude) for wave in scene.water.waves)
    return scene.with_(water=replace(scene.water, waves=higher))


def frequency_of(scene: Scene) -> float:
    """ω [rad/s] of its wave."""
    assert scene.water is not None and scene.water.waves[0].wavelength is not None
    return angular_frequency(2 * math.pi / scene.water.waves[0].wavelength, GRAVITY)


def in_waves(point: dict[str, Any]) -> dict[str, Any]:
    """Amplitudes [m] of the stages and of the top, their means, tensions and what slackens, of one run."""
    from tensegrity_mj.simulation import simulate

    scene, step = scene_of(point), point.get("timestep", TIMESTEP)
    run = simulate(scene, None, _engine(point.get("engine", "dae"), step), output_interval=SAMPLES * step)
    return measured(run)


def measured(run: Trajectory) -> dict[str, Any]:
    """What is found in a run over its last `WATCHED` seconds, and how it differs from as many periods before."""
    scene, period = run.scene, 2 * math.pi / frequency_of(run.scene)
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


def _engine(name: str, timestep: float) -> Any:
    if name == "mujoco":
        from tensegrity_mj.engines.mujoco import MuJoCo

        return MuJoCo(timestep=timestep)
    from tensegrity_mj.engines.dae import DAE
    from tensegrity_mj.engines.integration import Method

    return DAE(method=Method.RK4, timestep=timestep)
