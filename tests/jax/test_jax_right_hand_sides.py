"""The third means: accelerations of the differentiable engine, which shares no equation and no compiled function with
the DAE, against the DAE's, over all members, elements and shipped scenes.

Each force f that is added up has a relative round-off ε, and accelerations are the mobility W times them, so that they
agree within some ε Σ |W| |f|. Forces are those of strings, rods, elements and weight; k (L - L0) of a string loses
L/(L - L0) digits besides, which is ε k L in place of ε T. Joints, supports and matrices of up to 200 coordinates take
another factor of some hundred, so that 1e-12 of that sum is required; W is that of the engine at those nodes.
"""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np
import pytest

import tensegrity_mj as tmj
from tensegrity_mj.basics.arrays import Array, norm
from tensegrity_mj.engines.request import request_for
from tensegrity_mj.engines.requirements import require
from tensegrity_mj.errors import OptionError, SceneError, StructureError
from tensegrity_mj.model.actuation import OnInfeasible
from tensegrity_mj.model.elements.element import forces_of
from tensegrity_mj.model.rods import lumped_masses

pytest.importorskip("jax")
pytest.importorskip("diffrax")

from features import FEATURES

TIMES = (0.0, 0.05, 0.1)
# What the engine refuses, and what the message names.
REFUSED = {
    "contact": "contact: no array function",
    "strings that yield": "yields",
    "states of elements": "no array function",
    "arrester": "yields",
    "prism_drop": "contact: no array function",
    "six_bar_drop": "contact: no array function",
    "six_bar_push": "contact: no array function",
    "six_bar_roll": "contact: no array function",
}
# Shipped scenes that stay at rest without their law, whose rest lengths move them here.
RESTING = ("cross", "pinned_rod", "pinned_rod_mirror", "prism", "planar_beam", "shape_control")
MODELS = Path(__file__).resolve().parents[2] / "models"
SHIPPED = sorted(path.parent.name for path in MODELS.glob("*/scene.toml"))
SCENES = [*FEATURES, *SHIPPED]


@functools.cache
def scene_of(name: str) -> tmj.Scene:
    return FEATURES[name].scene() if name in FEATURES else tmj.load_scene(name)


def magnitudes(scene: tmj.Scene, run: tmj.Trajectory, row: int) -> Array:
    """(N,) the sum of the magnitudes of all forces on each node [N]."""
    structure, nodes = scene.structure, run.nodes[row]
    paths = structure.paths
    found = np.zeros(len(nodes))
    pulls = np.where(structure.curves.constant, run.tensions[row], structure.stiffness * run.rest_lengths[row])
    pulls = np.maximum(np.abs(pulls) + np.abs(run.tensions[row] - pulls), run.tensions[row])
    for (i, j), string in zip(paths.nodes, paths.strings, strict=True):
        found[[i, j]] += pulls[string]
    for (i, j), force, k in zip(structure.rod_nodes, run.rod_forces[row], structure.rod_stiffness, strict=True):
        found[[i, j]] += abs(force) + (k * norm(nodes[j] - nodes[i]) if np.isfinite(k) else 0.0)
    for element in scene.effects:
        acting = forces_of((element,), scene, float(run.time[row]), nodes, run.velocities[row])
        found += np.abs(acting).sum(axis=1)
    speeds = (run.velocities[row] ** 2).sum(axis=1)  # centripetal forces m v²/ℓ
    shortest = min([*structure.rod_lengths, np.inf])
    return found + np.abs(lumped_masses(structure)) * (np.linalg.norm(scene.gravity) + speeds.max() / shortest)


def mobility(scene: tmj.Scene) -> Array:
    """(N, N) the largest accelerations [1/kg] of nodes by forces on nodes, of what supports hold and rods do not."""
    from tensegrity_mj.engines.jax.system import System

    system = System(scene)
    W = system.mobility(system.parameters()).whole  # without added mass, which makes nothing lighter
    blocks = np.abs(W) if W.ndim == 2 else np.abs(W).max(axis=(1, 3))
    return np.asarray(np.abs(system.maps) @ blocks @ np.abs(system.maps.T))


@pytest.mark.parametrize("name", [name for name in SCENES if name not in REFUSED])
def test_accelerations_are_those_of_the_dae(name: str) -> None:
    scene = scene_of(name)
    law = tmj.controllers.from_scene(scene) if name in RESTING else None
    run = tmj.simulate(scene, law, tmj.DAE(), duration=TIMES[-1], output_interval=TIMES[1])
    request = request_for(scene, None, None, None, OnInfeasible.STOP, None, False)
    ours, theirs = tmj.JAX().accelerations(request), tmj.DAE().accelerations(request)
    reach, worst, largest = mobility(scene), 0.0, 0.0
    for row, time in enumerate(run.time):
        state = (float(time), run.nodes[row], run.velocities[row], run.rest_lengths[row])
        (places, found), (others, expected) = ours(*state), theirs(*state)
        np.testing.assert_allclose(places, others, atol=1e-13 * (1 + np.abs(others).max()))
        scale = reach @ magnitudes(scene, run, row) + np.abs(expected).max()
        worst = max(worst, float((np.abs(found - expected).max(axis=1) / scale).max()))
        largest = max(largest, float(np.abs(expected).max()))
    print(f"{name}: {worst:.1e} of Σ |W| |f|, accelerations up to {largest:.1e} m/s²")
    assert worst < 1e-12
    assert largest > 1e-6  # in motion, or a comparison of zeros


@pytest.mark.parametrize("name", ["dampers", "constraints"])
def test_what_is_known_before_a_run_needs_no_compiling(name: str) -> None:
    """JAX would compile each operation on arrays that it has not seen the shape of, 20 to 30 ms each."""
    from tensegrity_mj.engines.jax.system import System

    system = System(scene_of(name))
    assert all(isinstance(one, np.ndarray) for one in system.mobility(system.parameters())[:3])


@pytest.mark.parametrize("name", REFUSED)
def test_what_has_no_array_function_is_refused_by_name(name: str) -> None:
    with pytest.raises((SceneError, StructureError, OptionError), match=REFUSED[name]):
        require(tmj.JAX(), scene_of(name))
