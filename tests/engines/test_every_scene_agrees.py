"""DAE, ODE and MuJoCo's RK4 in closed loop, for every scene and law of chapters 4 to 6: nodes within 1e-7 m.

The law acts continuously. It is the same object in each run, so that only the plants differ.
"""

from __future__ import annotations

import itertools
from typing import Any

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
    "beam": ("planar_beam", {}, 1e-2, 60.0),
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
