"""Tasks by name in dm_control: what they are in Gymnasium."""

from __future__ import annotations

import numpy as np
import pytest

import tensegrity_mj as tmj
from tensegrity_mj.learning.tasks import World, task_of

pytest.importorskip("tensegrity_mj.learning.dm_control", exc_type=tmj.errors.MissingPackageError)

from tensegrity_mj.learning.dm_control import task_environment


@pytest.mark.parametrize("name", ["PrismReach", "SpineReach", "SixBarRoll"])
def test_a_task_by_name_is_that_of_gymnasium(name: str) -> None:
    """Starts, goals, observations, terms. dm_control sums in another order, and sees slackness of damped strings once a
    step: strings here stay taut, except the rolling robot's, which lie slack before it lands: its first steps."""
    task, world, one = task_of(name), World(name), np.zeros(1, np.int64)
    env = task_environment(name, seed=3)
    seen = env.reset().observation
    mine = world.start(one, [np.random.default_rng(3)])[0]
    actions = np.random.default_rng(0).uniform(-0.2, 0.2, (5, len(task.low)))
    for action in actions:
        assert list(seen) == list(world.slices)
        for part, place in world.slices.items():
            # Single precision, 6e-8 of at most 100 N; 250 steps of round-off are 1e-11.
            np.testing.assert_allclose(np.ravel(seen[part]), mine[place], rtol=1e-6, atol=1e-5, err_msg=part)
        timestep = env.step(task.commanded(action))
        out = world.step(one, action[None])
        seen, mine = timestep.observation, out.observation[0]
        assert timestep.reward == pytest.approx(out.reward[0], abs=1e-9)
        assert env.task.terms(env.physics) == pytest.approx({key: term[0] for key, term in out.terms.items()}, abs=1e-9)


def test_an_episode_has_the_tasks_length_and_an_unknown_task_is_refused() -> None:
    env = task_environment("PrismReach")
    steps, timestep = 0, env.reset()
    while not timestep.last():
        timestep, steps = env.step(env.action_spec().minimum), steps + 1
    assert steps == task_of("PrismReach").steps
    with pytest.raises(tmj.errors.OptionError, match="PrismReach"):
        task_environment("PrismReac")
