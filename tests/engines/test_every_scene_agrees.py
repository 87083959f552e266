"""MuJoCo's RK4 and the reference engines over whole scenes.

In closed loop, for every scene and law of chapters 4 to 6, nodes of all three formulations agree within 1e-7 m. The law
acts continuously. It is the same object in each run, so that only the plants differ. Scenes of strings over pulleys,
with mass or curves, of bodies, constraints, moorings and nets agree with the DAE within 1e-8 m, at the method's order.
"""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest

import tensegrity_mj as tmj

# Scene, law and its options, MuJoCo's step [s], duration [s]. RK4 errs by C h⁴ on smooth motion and by about C h² where
# u >= 0 has kinks; the steps are those at which a run at twice the step is within 1e-7 m, too, or nearly so.
CASES: dict[str, tuple[str, dict[str, Any], float, float]] = {
    "pinned rod, Lyapunov": ("pinned_rod", {}, 2e-3, 60.0),
    "pinned rod, Lyapunov, faster": ("pinned_rod", {"decay_rate": 0.20}, 2e-3, 60.0),
    "pinned rod, projection": ("pinned_rod", {"law": "projection"}, 2e-3, 60.0),
    "mirrored, onto b": ("pinned_rod_mirror", {"law": "projection"}, 2e-3, 60.0),
    "mirrored, onto the target": ("pinned_rod_mirror", {"law": "projection", "onto": "target"}, 2e-3, 60.0),
    "prism, Lyapunov": ("prism", {}, 1e-3, 10.0),
    "prism, projection": ("prism", {"law": "projection"}, 1e-3, 10.0),
    "cross": ("cross", {}, 2e-3, 10.0),
    "beam": ("planar_beam", {}, 1e-2, 5.0),
}


@pytest.mark.parametrize("case", CASES)
def test_three_formulations_agree(case: str) -> None:
    name, options, step, duration = CASES[case]
    scene = tmj.load_scene(name)
    law = tmj.controllers.from_scene(scene, **options)
    engines = (
        tmj.MuJoCo(step),
        tmj.DAE(rtol=1e-11, atol=1e-12),
        tmj.ODE(rtol=1e-11, atol=1e-12),
    )
    runs = [tmj.simulate(scene, law, engine, duration=duration) for engine in engines]
    assert abs(runs[0].nodes[-1] - runs[0].nodes[0]).max() > 0.1
    for one, other in itertools.combinations(runs, 2):
        assert one.status is other.status is tmj.Status.COMPLETED
        error = tmj.compare(one, other).max_node_error
        print(f"{case}: {one.engine} against {other.engine}: {error:.2g} m")
        assert error < 1e-7


# Scene, MuJoCo's step [s], whether it locates where strings come taut or slack, and the part of the scene's duration.
MEMBERS = {
    "pulley": (1e-3, False, 1.0),
    "ladder": (2e-3, False, 1.0),
    "massive_string": (2.5e-4, False, 0.4),
    "spine": (1.25e-4, False, 0.4),
    "fish_net": (5e-4, False, 0.2),
    "moored_chain": (5e-3, False, 0.2),
    "arrester": (5e-4, True, 1.0),
}


@pytest.mark.parametrize("name", MEMBERS)
def test_scenes_of_all_members_agree_at_order_four(name: str) -> None:
    """Errors C h⁴ (1 + O(h)): at twice the step 16 times, and half of that or twice where h is not small yet."""
    step, locate, part = MEMBERS[name]
    scene = tmj.load_scene(name)
    scene = scene.with_(duration=part * scene.duration)
    reference = tmj.simulate(scene, None, tmj.DAE(rtol=1e-12, atol=1e-13))
    assert np.abs(reference.nodes - reference.nodes[0]).max() > 0.01
    runs = [tmj.simulate(scene, None, tmj.MuJoCo(h, locate_slack=locate)) for h in (2 * step, step)]
    coarse, fine = (tmj.compare(run, reference).max_node_error for run in runs)
    print(f"{name}: {fine:.2g} m at {step:g} s, {coarse / fine:.1f} times as much at twice the step")
    assert fine < 1e-8
    assert 8 < coarse / fine < 32
