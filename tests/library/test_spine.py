"""The spine of tetrahedral vertebrae: in equilibrium as made, swaying alike in both engines, refused where it must."""

from __future__ import annotations

import numpy as np
import pytest

import tensegrity_mj as tmj
from tensegrity_mj.library.named import family_scene
from tensegrity_mj.library.spine import spine


@pytest.mark.parametrize("vertebrae", [2, 4, 7])
def test_a_spine_stands_as_it_is_made_and_each_joint_carries_what_is_above(vertebrae):
    scene = spine(vertebrae, push=0.0)
    state = tmj.statics.find_equilibrium(scene)
    assert np.abs(state.nodes - scene.nodes0).max() <= 1e-12
    assert state.is_stable
    # Vertical balance of what stands on a joint: four upright strings pull down with 20 N, and so do saddles up, whose
    # slope is (height - spacing)/length.
    slope = 0.05 / np.sqrt(2 * 0.075**2 + 0.05**2)
    for joint in range(vertebrae - 1):
        weight = (vertebrae - 1 - joint) * 0.136 * 9.81
        saddles = state.tensions[8 * joint + 4 : 8 * joint + 8]
        assert 4 * saddles * slope == pytest.approx(np.full(4, 4 * 20.0 + weight), rel=1e-12)
    assert np.trace(scene.structure.bodies[0].inertia_matrix) == pytest.approx(
        2 * 0.136 / 3 * (2 * 0.075**2), rel=1e-12
    )


def test_the_shipped_spine_is_the_family_and_both_engines_swing_it_alike_at_the_fourth_order():
    scene = tmj.load_scene("spine")
    assert family_scene("spine()") == scene
    reference = tmj.simulate(scene, None, tmj.DAE(rtol=1e-11, atol=1e-13), duration=0.5)
    errors = []
    for step in (1e-3, 5e-4):
        run = tmj.simulate(scene, None, tmj.MuJoCo(step), duration=0.5)
        errors.append(tmj.compare(run, reference).max_node_error)
    # The stiffest mode, 81 Hz, turns by 0.5 and 0.25 a step.
    assert errors[1] <= min(errors[0] / 2**3.5, 1e-6)
    assert run.tensions.min() > 5.0
    state = tmj.statics.find_equilibrium(scene.with_(initial_velocities=None))
    # As the README has them.
    assert tmj.statics.natural_modes(state).frequencies[:2] == pytest.approx([5.17, 5.85], abs=0.006)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"vertebrae": 1}, "vertebrae = 1; it must be an integer >= 2"),
        ({"spacing": 0.15}, "spacing = 0.15 m; it must be below the height"),
        ({"mass": -1.0}, "mass = -1.0; it must be > 0 kg"),
    ],
)
def test_what_makes_no_spine_is_refused(changes, message):
    with pytest.raises(tmj.errors.OptionError, match=message):
        spine(**changes)
