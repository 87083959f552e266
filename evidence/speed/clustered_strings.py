"""Cost of a string over pulleys against as many strings of two nodes: `python -m evidence.speed.clustered_strings`.

A row of masses between two supports, each between springs of its own; one string runs over all of them, or one from
each to the next. Medians of interleaved repetitions, by processor time, of runs that are `STEPS` longer than others.
"""

from __future__ import annotations

import argparse
import itertools
import time

import numpy as np

import tensegrity_mj as tmj

SEGMENTS = (2, 4, 8, 16, 32, 64)
STEPS = 1000
H = 1e-3
REPEATS = 9


def row(segments: int, clustered: bool) -> tmj.Scene:
    """Masses at x = 1, 2, ... on springs upwards and downwards, under a string of the same tension either way."""
    names = [f"n{i}" for i in range(segments + 1)]
    nodes = {name: (float(i), 0.0, 0.1 * (i % 2)) for i, name in enumerate(names)}
    held = [names[0], names[-1]]
    strings, masses = [], []
    for name in names[1:-1]:
        x, _, z = nodes[name]
        masses.append(tmj.PointMass(name, 1.0))
        for side, way in (("up", 1.0), ("down", -1.0)):
            held.append(f"{name} {side}")
            nodes[held[-1]] = (x, 0.0, z + way)
            strings.append(tmj.String(held[-1], (name, held[-1]), 500.0, 1.0, tension=100.0))
    paths = [tuple(names)] if clustered else list(itertools.pairwise(names))
    k = 1000.0 if clustered else 1000.0 * segments
    strings += [tmj.String(" ".join(path[:2]), path, k, 1.0, tension=50.0) for path in paths]
    structure = tmj.Structure("row", nodes, (), tuple(strings), tuple(held), tuple(masses))
    return tmj.Scene(structure, name="row", gravity=(0.0, 0.0, -9.81))


def step_time(scene: tmj.Scene, engine: object) -> float:
    """Processor time of a step [s]: the difference of two runs, without what a run begins with."""
    taken = []
    for steps in (STEPS // 10, STEPS + STEPS // 10):
        start = time.process_time()
        tmj.simulate(scene, None, engine, duration=steps * H, output_interval=10 * H)  # type: ignore[arg-type]
        taken.append(time.process_time() - start)
    return (taken[1] - taken[0]) / STEPS


def main() -> None:
    """Measure and print, side by side."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=REPEATS)
    repeats = parser.parse_args().repeats
    engines = {"MuJoCo RK4": tmj.MuJoCo(H), "DAE RK4": tmj.DAE(method=tmj.Method.RK4, timestep=H)}
    print(f"{'engine':12s}{'segments':>9s}{'one string':>13s}{'a string each':>15s}{'ratio':>8s}{'of a segment':>14s}")
    for title, engine in engines.items():
        for segments in SEGMENTS:
            scenes = [row(segments, clustered) for clustered in (True, False)]
            rounds = np.array([[step_time(scene, engine) for scene in scenes] for _ in range(repeats + 1)])[1:]
            one, each = 1e6 * np.median(rounds, axis=0)
            ratio = float(np.median(rounds[:, 0] / rounds[:, 1]))
            more = (one - each) / segments
            print(f"{title:12s}{segments:9d}{one:10.2f} µs{each:12.2f} µs{ratio:8.2f}{more:+11.3f} µs")


if __name__ == "__main__":
    main()
