"""MuJoCo as a script of one's own would step it: autoreset on, no check. The test of the test.

With `--autoreset` the study's MuJoCo runs are made this way. What the engine would have stopped is then completed and
wrong, so that the count of undetected failures must rise: a study that stays at zero would see nothing.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from evidence.extremes.setups import OUTPUTS, Attempt, Setup, caught
from evidence.extremes.verdicts import USEFUL
from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.engines.mujoco.mjcf import scene_to_mjcf
from tensegrity_mj.engines.mujoco.mjcf_tree import initial_velocities
from tensegrity_mj.engines.mujoco.settings import MuJoCo
from tensegrity_mj.runs.convergence import Estimate, way_of
from tensegrity_mj.runs.recorded import VARIABLES, sizes_of
from tensegrity_mj.runs.trajectory import Trajectory


def applies(setup: Setup) -> bool:
    """Return whether the setup can be run so: in MuJoCo, and without what the engine's callback would have to do."""
    scene, structure = setup.experiment.scene, setup.experiment.scene.structure
    resisted = scene.resistance is not None or any(point.damping for point in structure.point_masses)
    plain = not (scene.motions or resisted or scene.water or structure.constraints) and structure.curves.linear
    return plain and not setup.engine.startswith(("dae", "ode"))


def claim(run: Trajectory) -> Estimate:
    """Return the error that is expected of such a run: the least demand on any run that is to be of use."""
    return Estimate(USEFUL * way_of(run.nodes), True, "a script of one's own estimates nothing")


def attempt(setup: Setup, engine: MuJoCo) -> Attempt:
    """Run a setup with a loop of `mj_step`, the law evaluated once a step."""
    return caught(lambda: _run(setup, engine))


def _run(setup: Setup, engine: MuJoCo) -> Trajectory:
    scene = setup.experiment.scene
    structure = scene.structure
    xml = scene_to_mjcf(scene, engine.timestep, engine.word).replace('autoreset="disable"', 'autoreset="enable"')
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    data.qvel[:] = initial_velocities(scene)
    sites = [model.site(name).id for name in structure.node_names]
    law = None if setup.experiment.law is None else setup.experiment.law(setup.duration)
    steps = round(setup.duration / engine.timestep)
    stride = steps // OUTPUTS
    times, nodes = [], []
    mujoco.mj_forward(model, data)
    for step in range(steps + 1):
        mujoco.mj_kinematics(model, data)  # a step leaves the sites where they were before it
        if step % stride == 0:
            times.append(data.time)  # which a reset puts back to zero
            nodes.append(data.site_xpos[sites].copy())
        if law is not None:
            u = np.asarray(law(data.time, data.site_xpos[sites], np.zeros((len(sites), 3))))
            lengths = structure.string_lengths(data.site_xpos[sites])
            data.ctrl[:] = lengths * (1 - u / structure.stiffness) - structure.rest_lengths
        if scene.loads:
            data.qfrc_applied[:] = 0
            for site, force in zip(sites, scene.nodal_forces(data.time), strict=True):
                if force.any():
                    at, body = data.site_xpos[site], model.site_bodyid[site]
                    mujoco.mj_applyFT(model, data, force, np.zeros(3), at, body, data.qfrc_applied)
        mujoco.mj_step(model, data)
    return _trajectory(setup, np.array(times), np.array(nodes))


def _trajectory(setup: Setup, times: Array, nodes: Array) -> Trajectory:
    """Make a trajectory of which only the nodes are known; the rest is zero."""
    scene = setup.experiment.scene
    sizes = sizes_of(scene, len(times))
    arrays: dict[str, Any] = {name: np.zeros([sizes[one] for one in own]) for name, (own, _, _) in VARIABLES.items()}
    return Trajectory(scene, **(arrays | {"time": times, "nodes": nodes}), engine="MuJoCo by hand, with autoreset")
