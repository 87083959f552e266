"""The examples that learn and play: LQR against standing still, and a policy as a law against itself as a player."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import tensegrity_mj as tmj
from tensegrity_mj.learning.tasks import World, task_of


@pytest.mark.parametrize("name", ["PrismReach", "SpineReach"])
def test_lqr_reaches_what_standing_still_does_not(
    name: str, example: Callable[[str], ModuleType], monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is left at the end is what the linear model does not know: of goals up to 85 mm away, for members of some

    0.2 m, parts of the square of that, 0.2.
    """
    baselines = example("baselines")
    monkeypatch.setattr(baselines, "SEEDS", range(1000, 1003))
    task = task_of(name)
    long, short = (replace(task, steps=steps) for steps in (60, 50))
    last = {}
    for policy in ("stands", "LQR"):
        way = [baselines.episodes(one, baselines.PLAYERS[name][policy](one))[1]["distance"] for one in (long, short)]
        last[policy] = np.abs(way[0] - way[1]) / 10  # the mean distance from the goal over the last ten periods [m]
    assert np.all(last["LQR"] < 0.2 * last["stands"])


def test_a_learned_policy_is_the_same_as_a_law(example: Callable[[str], ModuleType], tmp_path: Path) -> None:
    """Round-off alone is between them: the same commands are held for the same time, by the same engine."""
    learned = example("learn_to_roll")
    task = replace(task_of("SixBarRoll"), start=None)
    generator, sizes = np.random.default_rng(4), (72, 8, 5)
    weights = {"mean": np.zeros(72), "variance": np.full(72, 0.1), "layers": 2}
    for number, (into, out) in enumerate(zip(sizes[1:], sizes[:-1], strict=True)):
        weights[f"weight{number}"] = generator.normal(size=(into, out)) / np.sqrt(out)
        weights[f"bias{number}"] = generator.normal(size=into)
    weights |= {"weight": generator.normal(size=(24, 5)) / 5, "bias": np.full(24, 0.7)}
    np.savez(tmp_path / "policy.npz", **weights)
    policy = learned.Policy(task.scene, str(tmp_path / "policy.npz"))
    world, play = World(task, 1), learned.held(policy)
    only = np.zeros(1, int)
    world.start(only, [generator])
    for period in range(2 * learned.HELD):
        world.step(only, play(world.state(), period))
    held = tmj.Actuation.hold_rest_length(task.period)
    run = tmj.simulate(task.scene, policy, task.engine, duration=2 * learned.HELD * task.period, actuation=held)
    np.testing.assert_allclose(world.state().nodes[0], run.nodes[-1], rtol=0, atol=1e-9)
    assert np.abs(run.nodes[-1] - run.nodes[0]).max() > 0.01
