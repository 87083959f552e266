"""Many runs of the DAE at once against `mujoco.batch` without a law: `python -m evidence.speed.lanes`.

Whole calls of `simulate_many` on one thread, with set-up and recording, by processor time in turns: one run at a
time, and four and eight side by side. Ratios are to bare MuJoCo with the same model, in the same turn.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any
from unittest.mock import patch

from mujoco.batch import Batch

import tensegrity_mj as tmj
from tensegrity_mj.controllers import Lyapunov
from tensegrity_mj.engines.reference import in_lanes

H = 1e-3
ENGINE = tmj.DAE(method=tmj.Method.RK4, timestep=H)
WAYS = {"one at a time": (8, 2**31), "4 lanes": (4, 4), "8 lanes": (8, 4)}  # width, and how many runs make a block


def along(scene: tmj.Scene, law: Any, count: int) -> list[tmj.Scene]:
    """A scene from states along a second of its way."""
    run = tmj.simulate(scene, law, ENGINE, duration=1.0)
    places = [k * (len(run.time) - 1) // count for k in range(count)]
    return [scene.with_(initial_nodes=run.nodes[k], initial_velocities=run.velocities[k]) for k in places]


def stiffened(scene: tmj.Scene, share: float) -> tmj.Scene:
    """A scene with stiffer strings."""
    own = scene.structure
    strings = tuple(replace(one, stiffness=(1.0 + share) * one.stiffness) for one in own.strings)
    return scene.with_(structure=replace(own, strings=strings))


def cases(count: int) -> Iterator[tuple[str, list[tmj.Scene], Any]]:
    """Name, scenes and laws of each row of the table."""
    prism = tmj.load_scene("prism")
    law = tmj.controllers.from_scene(prism)
    starts = along(prism, law, count)
    yield "prism under the law of chapter 5", starts, law
    yield "six_bar_push without contact", along(tmj.load_scene("six_bar_push").with_(contact=None), None, count), None
    own = [stiffened(scene, 1e-4 * k) for k, scene in enumerate(starts)]
    yield "prism, a stiffness each", own, None
    target = starts[0].target
    assert target is not None
    laws = [Lyapunov(one.structure, target, decay_rate=1.0 + 1e-4 * k) for k, one in enumerate(own)]
    yield "prism, a stiffness and a law each", own, laws


def whole_call(scenes: list[tmj.Scene], laws: Any, steps: int) -> float:
    """Processor time [s] of `simulate_many`."""
    start = time.process_time()
    tmj.simulate_many(scenes, laws, ENGINE, duration=steps * H, output_interval=steps * H, threads=1)
    return time.process_time() - start


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=1024)
    parser.add_argument("--steps", type=int, default=1000)
    parser.add_argument("--repeats", type=int, default=5)
    given = parser.parse_args()
    print(f"| speed of bare MuJoCo = 1 | {' | '.join(WAYS)} |\n|---|{'---|' * len(WAYS)}")
    for name, scenes, laws in cases(given.runs):
        found: dict[str, list[float]] = {way: [] for way in WAYS}
        batch = Batch(tmj.MuJoCo(timestep=H).model(scenes[0]), given.runs, 1)
        for turn in range(given.repeats + 1):
            start = time.process_time()
            batch.step(nstep=given.steps)
            bare = time.process_time() - start
            for way, (width, fewest) in WAYS.items():
                with patch.multiple(in_lanes, native_width=partial(int, width), FEWEST=fewest):
                    seconds = whole_call(scenes, laws, given.steps)
                if turn:  # the first one compiles
                    found[way].append(bare / seconds)
        print(f"| {name} | {' | '.join(f'{statistics.median(one):.1f}' for one in found.values())} |", flush=True)


if __name__ == "__main__":
    main()
