"""Cost of a string with mass against its segments written by hand: `python -m evidence.speed.ropes`.

Both scenes are run in turns in one process; printed is the median of the ratios of their CPU times, and their range.
"""

from __future__ import annotations

import argparse
import statistics
import time
from dataclasses import replace
from typing import Any

import tensegrity_mj as tmj

DURATION, H = 10.0, 1e-3  # s


def line(segments: int) -> tmj.Scene:
    """The scene massive_string, shaken for as long as is measured."""
    scene = tmj.load_scene("massive_string")
    (string,) = scene.structure.given.strings
    return scene.with_(structure=replace(scene.structure, strings=(replace(string, segments=segments),)))


def by_hand(scene: tmj.Scene) -> tmj.Scene:
    """Return the scene with light strings and point masses of other names, which are of no string with mass."""
    own = scene.structure
    names = {name: f"p{row}" for row, name in enumerate(own.nodes)} | {name: name for name in own.fixed_nodes}
    strings = (
        replace(one, name=f"q{row}", nodes=tuple(names[node] for node in one.nodes))
        for row, one in enumerate(own.strings)
    )
    points = (replace(one, node=names[one.node]) for one in own.point_masses)
    nodes = {names[name]: place for name, place in own.nodes.items()}
    return scene.with_(structure=tmj.Structure("by hand", nodes, (), tuple(strings), own.fixed_nodes, tuple(points)))


def seconds(scene: tmj.Scene, engine: Any) -> float:
    """CPU time of a run."""
    start = time.process_time()
    tmj.simulate(scene, None, engine, duration=DURATION, output_interval=DURATION)
    return time.process_time() - start


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repetitions", type=int, default=7)
    repetitions = parser.parse_args().repetitions
    engines = {"MuJoCo": tmj.MuJoCo(timestep=H), "DAE": tmj.DAE(method=tmj.Method.RK4, timestep=H)}
    for segments in (10, 40):
        scene = line(segments)
        pair = (scene, by_hand(scene))
        for name, engine in engines.items():
            for one in pair:
                seconds(one, engine)
            times = [tuple(seconds(one, engine) for one in pair) for _ in range(repetitions)]
            ratios = [rope / hand for rope, hand in times]
            step = statistics.median(rope for rope, _ in times) / (DURATION / H)
            print(
                f"{segments:>3} segments, {name:<6} {1e6 * step:6.2f} µs a step, "
                f"{statistics.median(ratios):.3f} x by hand ({min(ratios):.3f} to {max(ratios):.3f})"
            )


if __name__ == "__main__":
    main()
