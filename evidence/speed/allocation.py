"""Time of one optimal allocation on the planar beam, 196 unknowns and 117 equations, compared with daqp.

    python -m evidence.speed.allocation

The allocator as the law calls it, along the reference motion at 100 Hz for 20 s, against daqp from a cold start.
"""

from __future__ import annotations

import time

import daqp
import numpy as np

import tensegrity_mj as tmj
from tensegrity_mj.controllers.optimal_allocation import Allocator
from tensegrity_mj.dynamics.target import target_nodes
from tensegrity_mj.library.planar_beam import planar_beam

CASES = {"sum 1960": 1960.0, "sum 980": 980.0, "no criterion": None}
PERIOD = 0.01


def main() -> None:
    """Measure and print."""
    titles = "".join(f"{word:>10s}" for word in ("median", "99 %", "longest", "daqp", "residual", "least u"))
    print(f"{'planar_beam':14s}{titles}")
    for title, minimum in CASES.items():
        scene = planar_beam(minimum_sum=minimum)
        law = tmj.controllers.from_scene(scene)
        assert scene.target is not None
        times = np.arange(1, 2001, dtype=np.float64) * PERIOD
        nodes = target_nodes(scene.structure, scene.target, times)
        rates = np.gradient(nodes, times, axis=0)
        allocator = Allocator(law.allocation, scene.structure, law.coordinates)
        M = len(scene.structure.strings)
        taken, library, residual, least = [], [], 0.0, np.inf
        for step, t in enumerate(times):
            A, d, _ = law.equation(t, nodes[step], rates[step])
            start = time.perf_counter()
            u, violation = allocator.solve(A, d)
            taken.append(time.perf_counter() - start)
            residual, least = max(residual, violation), min(least, float(u.min()))
            if step % 100 == 50:
                rows, sums = np.vstack([A, allocator.sum_rows]), allocator.sum_values
                above = np.concatenate([np.full(M, 1e30), d, np.full(len(sums), 1e30)])
                kinds = np.concatenate([np.zeros(M), np.full(len(d), 5), np.zeros(len(sums))]).astype(np.int32)
                start = time.perf_counter()
                daqp.solve(np.eye(M), np.zeros(M), rows, above, np.concatenate([np.zeros(M), d, sums]), kinds)
                library.append(time.perf_counter() - start)
        median, high, longest = (1e3 * float(np.quantile(taken[5:], q)) for q in (0.5, 0.99, 1.0))
        other = 1e3 * float(np.median(library))
        spent = "".join(f"{value:7.2f} ms" for value in (median, high, longest, other))
        print(f"{title:14s}{spent}{residual:10.1e}{least:10.1e}")


if __name__ == "__main__":
    main()
