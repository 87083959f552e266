"""Robots that land, many at once: `python -m evidence.speed.contact_at_once`.

Steps a second of `simulate_many` and of `law_in`, as ratios to `Batch.step` and to `mujoco.rollout` of the same model
without a law or a ledger, on the same threads and over the same landing, in contact from the first steps on: medians
of interleaved turns in one process, with the least and the most. "loop" is the integration with recording and ledger,
"call" all of a call, set-up included.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
from mujoco import rollout
from mujoco.batch import Batch

import tensegrity_mj as tmj


class Measure:
    """One scene and integrator, with a number of robots."""

    def __init__(self, scene: tmj.Scene, engine: tmj.MuJoCo, robots: int, threads: int, steps: int) -> None:
        self.scene, self.engine, self.robots, self.threads, self.steps = scene, engine, robots, threads, steps
        self.model, structure = engine.model(scene), scene.structure
        springs = np.column_stack([structure.stiffness, structure.rest_lengths]).ravel()
        self.law = tmj.controllers.CompiledLaw(passive, structure, parameters=springs)

    def rates(self) -> dict[str, float]:
        """Steps a second of all robots, each."""
        found = {"batch": self._rate(self._batch), "rollout": self._rate(self._rollout), "law_in": 0.0}
        with tmj.law_in(self.scene, self.law, self.engine):
            found["law_in"] = self._rate(self._batch)
        start = time.perf_counter()
        runs = tmj.simulate_many(
            [self.scene] * self.robots, None, self.engine, duration=self.steps * self.engine.timestep,
            threads=self.threads,
        )  # fmt: skip
        found["call"] = self.robots * self.steps / (time.perf_counter() - start)
        found["loop"] = runs.cost["steps"] / runs.cost["wall_time"]
        return found

    def _rate(self, loop: Callable[[], Callable[[], Any]]) -> float:
        run = loop()
        start = time.perf_counter()
        run()
        return self.robots * self.steps / (time.perf_counter() - start)

    def _batch(self) -> Callable[[], Any]:
        batch = Batch(self.model, self.robots, self.threads)
        batch.bind("qvel")[:] = self.model.key_qvel[0]
        return lambda: batch.step(nstep=self.steps)

    def _rollout(self) -> Callable[[], Any]:
        full = mujoco.mjtState.mjSTATE_FULLPHYSICS.value
        states = np.zeros((self.robots, mujoco.mj_stateSize(self.model, full)))
        start = mujoco.MjData(self.model)
        start.qvel[:] = self.model.key_qvel[0]
        for row in states:
            mujoco.mj_getState(self.model, start, row, full)
        data = [mujoco.MjData(self.model) for _ in range(self.threads)]
        return lambda: rollout.rollout(self.model, data, states, nstep=self.steps)


def landing(scene: tmj.Scene) -> tmj.Scene:
    """The scene with its floor 0.1 mm below it, and on its way down."""
    assert scene.contact is not None
    up = scene.contact.up
    reach = np.concatenate([scene.nodes0[list(rod)] @ up - r.radius for rod, r in zip(
        scene.structure.rod_nodes, scene.structure.rods, strict=True)])  # fmt: skip
    floor = replace(scene.contact, floor=float(reach.min()) - 1e-4)
    return scene.with_(contact=floor, initial_velocities=np.tile(-2.0 * up, (len(scene.nodes0), 1)))


def passive(time, nodes, velocities, string_nodes, parameters, command):  # type: ignore[no-untyped-def]
    """The force densities of strings whose rest lengths no law changes."""
    for m in range(len(string_nodes)):
        i, j = string_nodes[m, 0], string_nodes[m, 1]
        square = 0.0
        for x in range(3):
            square += (nodes[j, x] - nodes[i, x]) ** 2
        command[m] = max(parameters[2 * m] * (1.0 - parameters[2 * m + 1] / np.sqrt(square)), 0.0)
    return True


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", nargs="?", default="six_bar_drop")
    parser.add_argument("--robots", type=int, nargs="+", default=[1, 64, 1024])
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--timestep", type=float, default=5e-4, help="[s]")
    parser.add_argument("--steps", type=int, default=100, help="of each of many robots (100); ten times as many of one")
    parser.add_argument("--cpu", action="store_true", help="CPU time of all threads, on a busy machine")
    options = parser.parse_args()
    if options.cpu:
        time.perf_counter = time.process_time  # also where the package measures its own loops
    scene = landing(tmj.load_scene(options.scene))
    print("| | robots | steps/s | of batch: loop | call | of rollout: loop | law_in of batch |")
    print("|---|---|---|---|---|---|---|")
    for integrator in (tmj.Integrator.RK4, tmj.Integrator.EULER):
        engine = tmj.MuJoCo(options.timestep, integrator)
        for robots in options.robots:
            threads = min(options.threads, robots)
            measure = Measure(scene, engine, robots, threads, options.steps * (10 if robots == 1 else 1))
            rounds = [measure.rates() for _ in range(options.repeats + 1)][1:]  # the first compiles
            cells = [f"{statistics.median(one['loop'] for one in rounds):,.0f}"]
            for ours, bare in (("loop", "batch"), ("call", "batch"), ("loop", "rollout"), ("law_in", "batch")):
                ratios = sorted(one[ours] / one[bare] for one in rounds)
                cells.append(f"{statistics.median(ratios):.2f} ({ratios[0]:.2f} to {ratios[-1]:.2f})")
            print(f"| {integrator.value} | {robots} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
