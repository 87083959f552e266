"""Runs side by side in the DAE: each has the bits of a single run, whatever width, threads and neighbours."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import tensegrity_mj as tmj
from tensegrity_mj.controllers import Gains, Lyapunov
from tensegrity_mj.engines.reference import in_lanes
from tensegrity_mj.errors import DivergenceError
from tensegrity_mj.model import Break, Load, Motion

H = 1e-3
DAE = tmj.DAE(method="rk4", timestep=H)
EVERYTHING = (
    *("time", "nodes", "velocities", "rest_lengths", "tensions", "multipliers", "winch_work", "external_work"),
    *("dissipation", "lyapunov", "feasibility_margin"),
)


@pytest.fixture(params=in_lanes.WIDTHS)
def width(request, monkeypatch) -> int:
    """Also of registers that this processor does not have: compilers make several of it."""
    monkeypatch.setattr(in_lanes, "native_width", lambda: request.param)
    return int(request.param)


def check_each_alone(scenes: Any, laws: Any, threads: int = 1, **options: Any) -> Any:
    """Runs in lanes are the single runs, to the last bit and the last word; where both end, so does what goes on."""
    runs = tmj.simulate_many(scenes, laws, DAE, threads=threads, **options)
    for number, scene in enumerate(scenes):
        law = laws[number] if isinstance(laws, list) else laws
        if runs.status[number] is tmj.Status.DIVERGED:
            with pytest.raises(DivergenceError) as single:
                tmj.simulate(scene, law, DAE, **options)
            with pytest.raises(DivergenceError) as among:
                _ = runs[number]
            assert str(among.value) == str(single.value)
            continue
        run, alone = runs[number], tmj.simulate(scene, law, DAE, **options)
        assert (run.status, run.message) == (alone.status, alone.message)
        for name in EVERYTHING:
            assert getattr(run, name).tobytes() == getattr(alone, name).tobytes(), (number, name)
        found, expected = ({k: v for k, v in one.reports.items() if k != "stability"} for one in (run, alone))
        assert repr(found) == repr(expected)
        assert run.provenance.get("end") == alone.provenance.get("end")
        assert [run.cost[what] for what in ("steps", "evaluations")] == [
            alone.cost[what] for what in ("steps", "evaluations")
        ]
    return runs


def along(scene: tmj.Scene, law: Any, count: int) -> list[tmj.Scene]:
    """A scene from states along its way."""
    run = tmj.simulate(scene, law, DAE, duration=0.3)
    places = np.linspace(0, len(run.time) - 1, count).astype(int)
    return [scene.with_(initial_nodes=run.nodes[k], initial_velocities=run.velocities[k]) for k in places]


@pytest.mark.parametrize("threads", [1, 2])
def test_a_run_in_a_lane_is_the_single_run_to_the_last_bit(prism, law, width, threads) -> None:
    starts = along(prism, law, 2 * width + 3)  # the last block is not full
    for one in (law, None):
        runs = check_each_alone(starts, one, threads, duration=0.05)
        assert runs.cost["lanes"] == {"width": width, "runs": len(starts), "alone": {}}
        assert runs.cost["steps"] == 50 * len(starts)


def test_neighbours_have_no_part_in_it(prism, law, width) -> None:
    starts = along(prism, law, width + 5)
    there = tmj.simulate_many(starts, law, DAE, duration=0.05).nodes
    back = tmj.simulate_many(starts[::-1], law, DAE, duration=0.05).nodes
    assert there.tobytes() == back[::-1].tobytes()


@pytest.mark.parametrize("name", ["six_bar_drop", "pinned_rod", "planar_beam", "cross", "arrester"])
def test_strings_that_go_slack_planes_and_point_masses(name, width) -> None:
    scene = tmj.load_scene(name).with_(contact=None)
    if any(scene.effects) or not scene.structure.curves.linear:
        scene = scene.with_(elements=(), loads=(), resistance=None, water=None)
    runs = check_each_alone(along(scene, None, 5), None, duration=0.05)
    if scene.structure.curves.linear:
        assert runs.cost["lanes"]["runs"] == 5


def test_a_lane_whose_law_has_no_solution_is_made_alone(width) -> None:
    """A rod in the plane of its strings' anchors cannot be lifted out of it (§5.4); others in the block go on."""
    scene = tmj.load_scene("pinned_rod")
    flat, up = np.array(scene.nodes0), np.array(scene.target.nodes[0])  # type: ignore[union-attr]
    flat[1], up[1] = (0.0, -1.0, 0.0), (0.0, 0.0, 1.0)
    lifting = Lyapunov(scene.structure, up, decay_rate=0.15)
    scenes = [scene, *[scene.with_(initial_nodes=flat)] * 2, scene, scene]
    for choice, status in ((tmj.OnInfeasible.STOP, "infeasible"), (tmj.OnInfeasible.PASSIVE, "completed")):
        runs = check_each_alone(scenes, lifting, duration=0.05, on_infeasible=choice)
        assert [one.value for one in runs.status] == ["completed", status, status, "completed", "completed"]
        lanes = runs.cost["lanes"]
        assert (lanes["runs"], list(lanes["alone"].values())) == (3, [2])


def test_a_lane_that_diverges_is_made_alone(prism, width) -> None:
    starts = along(prism, None, 5)
    starts[1] = starts[1].with_(initial_velocities=1e98 * np.array(starts[1].velocities0))
    runs = check_each_alone(starts, None, duration=0.05)
    assert runs.status[1] is tmj.Status.DIVERGED
    assert runs.cost["lanes"]["runs"] == 4


def test_impossible_commands_are_counted_by_lane(prism, width) -> None:
    """A law in haste asks for rest lengths below zero, in each run at other steps."""
    law = Lyapunov(prism.structure, prism.target, decay_rate=100.0)
    runs = check_each_alone(along(prism, None, 5), law, duration=0.05)
    counts = [run.reports["nonpositive_rest_lengths"]["steps"] for run in runs]
    assert max(counts) > 0
    assert len(set(counts)) > 1
    assert runs.cost["lanes"]["runs"] == 5


def test_numbers_of_structures_and_laws_are_lanes_of_their_own(prism, width) -> None:
    """Masses, stiffness, damping, rest lengths, gravity; gains, decay rates, targets."""
    own = prism.structure

    def other(k: float) -> tmj.Scene:
        rods = tuple(replace(rod, mass=rod.mass * (1.0 + k)) for rod in own.rods)
        strings = tuple(replace(one, stiffness=one.stiffness * (1.0 + k), damping=0.3 * k) for one in own.strings)
        structure = replace(own, rods=rods, strings=strings)
        return prism.with_(structure=structure, gravity=(0.0, k, -9.81))

    scenes = [other(0.07 * k) for k in range(width + 2)]
    ways = along(prism, None, len(scenes))
    laws = [
        Lyapunov(one.structure, way.nodes0, decay_rate=1.0 + k, rotation=Gains(1.0 + k, 1.0, 1.5), gravity=one.gravity)
        for k, (one, way) in enumerate(zip(scenes, ways, strict=True))
    ]
    for chosen, threads in ((None, 2), (laws, 1), (laws, 2)):
        runs = check_each_alone(scenes, chosen, threads, duration=0.05)
        assert runs.cost["lanes"] == {"width": width, "runs": len(scenes), "alone": {}}
    # Of one structure as well, whose runs share all else.
    leaning = [prism.with_(gravity=(0.0, 0.1 * k, -9.81)) for k in range(width + 2)]
    assert check_each_alone(leaning, None, duration=0.05).cost["lanes"]["runs"] == width + 2
    # Laws by other formulas, as of gains that are no multiples of one, are of another kind.
    skew = Lyapunov(prism.structure, ways[1].nodes0, rotation=Gains(np.diag([1.0, 2.0, 3.0]), 0.5, 2.0))
    runs = check_each_alone([*scenes, prism], [*laws, skew], duration=0.02)
    assert runs.cost["lanes"]["alone"] == {"too few others are like it": 1}


def test_what_does_not_go_into_lanes_runs_beside_them(prism, law, width) -> None:
    broken = prism.with_(breaks=(Break(prism.structure.strings[3].name, 0.02),))
    pushed = prism.with_(loads=(Load(prism.structure.node_names[0], (0.1, 0.0, 0.0), 10.0),))
    starts = along(prism, law, 5)
    scenes = [broken, starts[0], pushed, *starts[1:]]
    runs = check_each_alone(scenes, law, 2, duration=0.05)
    assert runs.cost["lanes"] == {"width": width, "runs": 5, "alone": {"strings break": 1, "elements act": 1}}
    dropped = tmj.load_scene("six_bar_drop")
    scenes = [dropped.with_(contact=None), dropped, *[dropped.with_(contact=None)] * 3]
    runs = check_each_alone(scenes, None, duration=0.02)
    assert runs.cost["lanes"]["alone"] == {"it may touch something": 1}
    rod = tmj.load_scene("pinned_rod")
    lifted = Motion.in_line("n3", amplitude=0.01, direction=(0.0, 0.0, 1.0), frequency=5.0)
    runs = check_each_alone([rod, rod, rod.with_(motions=(lifted,)), rod, rod], None, duration=0.02)
    assert runs.cost["lanes"]["alone"] == {"supports move": 1}
    held = tmj.Actuation.hold_rest_length(0.01)
    sampled = tmj.simulate_many(starts, law, DAE, duration=0.05, actuation=held)
    assert sampled.cost["lanes"]["alone"] == {"its law is sampled": 5}
    whose = "lanes are of the DAE of rods that share no nodes, by its default solver"
    for engine, reason in (
        (tmj.DAE(rtol=1e-6), "DOP853 chooses its steps"),
        (tmj.ODE(method="rk4", timestep=H), whose),
        (tmj.DAE(method="rk4", timestep=H, solver="full"), whose),
    ):
        lanes = tmj.simulate_many(starts, None, engine, duration=0.02).cost["lanes"]
        assert lanes == {"width": 1, "runs": 0, "alone": {reason: 5}}


def test_a_run_goes_on_from_the_end_of_its_lane(prism, law, width) -> None:
    runs = tmj.simulate_many(along(prism, law, 4), law, DAE, duration=0.05)
    alone = tmj.simulate(runs[2].scene, law, DAE, duration=0.1)
    on = tmj.simulate(runs[2], law, DAE, duration=0.05)
    assert on.nodes[-1].tobytes() == alone.nodes[-1].tobytes()
