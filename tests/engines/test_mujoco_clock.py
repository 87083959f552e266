"""MuJoCo's profiler is off in our loops, and on again after them."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

import tensegrity_mj as tmj
from tensegrity_mj.engines.mujoco import install as mujoco_clock
from tensegrity_mj.engines.mujoco.install import profiler_off

STEP = int(mujoco.mjtTimer.mjTIMER_STEP)


@pytest.fixture
def model() -> mujoco.MjModel:
    return tmj.MuJoCo(timestep=1e-3).model(tmj.load_scene("prism"))


def stepped(model: mujoco.MjModel) -> mujoco.MjData:
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 3)
    return data


def test_it_stands_still_within_and_runs_after(model: mujoco.MjModel) -> None:
    with profiler_off() as off:
        assert off
        with profiler_off():
            pass
        quiet = stepped(model)
    assert quiet.timer[STEP].duration == 0.0
    loud = stepped(model)
    assert loud.timer[STEP].duration > 0.0
    assert (quiet.qpos == loud.qpos).all()


def test_it_comes_back_after_an_error(model: mujoco.MjModel) -> None:
    with pytest.raises(ZeroDivisionError), profiler_off():
        raise ZeroDivisionError
    assert stepped(model).timer[STEP].duration > 0.0


def test_runs_and_laws_are_without_it(model: mujoco.MjModel) -> None:
    scene = tmj.load_scene("prism")
    law = tmj.controllers.from_scene(scene)
    with tmj.law_in(scene, law, tmj.MuJoCo(timestep=1e-3)) as closed:
        assert stepped(closed).timer[STEP].duration == 0.0
    seen = []

    def watching(time: float, nodes: object, velocities: object) -> object:
        seen.append(stepped(model).timer[STEP].duration)
        return np.zeros(len(scene.structure.strings))

    tmj.simulate(scene, watching, tmj.MuJoCo(timestep=1e-3), duration=2e-3)
    assert seen
    assert not any(seen)
    assert stepped(model).timer[STEP].duration > 0.0


def test_without_the_symbol_all_stays_as_it_is(model: mujoco.MjModel, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mujoco_clock, "LIBRARIES", ("no such library",))
    mujoco_clock._clock.cache_clear()
    try:
        with profiler_off() as off:
            assert not off
            assert stepped(model).timer[STEP].duration > 0.0
    finally:
        mujoco_clock._clock.cache_clear()
