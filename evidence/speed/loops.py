"""Speed before and after, in alternating repetitions: `python -m evidence.speed.loops --before 326d43e`.

Every number of evidence/docs/speed.md about start-up, whole calls, batches and right-hand sides. Several separate runs
(three by default) take turns between the two trees. Each measures in a process of its own, as medians of interleaved
repetitions; the table has the median over the runs, with the smallest and the largest. Times are of CPU, user and
system together, so that other load on the machine matters less; measure on an idle one all the same. Bare MuJoCo is
`mj_step(nstep)` or `Batch.step` of the same model without a law, as it comes, with the clock of its profiler.

`--before` takes a commit, which is checked out elsewhere, or a folder; without it only this tree is measured.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import json
import os
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
H = 1e-3  # s, of every fixed step
SIMULATIONS = 1024  # in a batch
GIVEN = ("same scene", "stiffness changed")
START = [sys.executable, "-m", "tensegrity_mj", "run", "prism", "--duration", "1"]
ROWS = {  # what is measured, and the digits that it is printed with
    "cold start [s]": 2,
    "warm start [s]": 2,
    "memory, warm [MiB]": 0,
    "a call's fixed cost, same scene [ms]": 1,
    "a call's fixed cost, stiffness changed [ms]": 1,
    "save [ms]": 1,
    **{
        f"simulate, {seconds} s, {name}, {what}": 2
        for seconds in (2, 10)
        for name in ("RK4", "Euler")
        for what in GIVEN
    },
    **{f"{loop}, {name}, 1 thread": 2 for loop in ("law_in", "simulate_many") for name in ("RK4", "Euler")},
    "DAE, right-hand sides a second [1e6]": 2,
}


# In one tree ------------------------------------------------------------------------------------------------------


def seconds(call: Callable[[], object]) -> float:
    """CPU time of a call."""
    start = time.process_time()
    call()
    return time.process_time() - start


def ratio(bare: Callable[[], object], ours: Callable[[], object], repeats: int) -> float:
    """The median of the bare one's time over ours, in turns."""
    return statistics.median(seconds(bare) / seconds(ours) for _ in range(repeats))


class Measure:
    """Measurements of one process: the prism under its law."""

    def __init__(self, repeats: int) -> None:
        time.perf_counter = time.process_time  # also where the package measures its own loops
        import tensegrity_mj as tmj

        self.tmj, self.repeats = tmj, repeats
        self.scene = tmj.load_scene("prism")
        self.law = tmj.controllers.from_scene(self.scene)
        self.engines = {"RK4": tmj.MuJoCo(H, tmj.Integrator.RK4), "Euler": tmj.MuJoCo(H, tmj.Integrator.EULER)}
        self.changes = 0

    def given(self, what: str) -> Any:
        """The scene, or one whose strings have another stiffness than ever before."""
        if what == "same scene":
            return self.scene
        self.changes += 1
        structure, part = self.scene.structure, 1.0 + 1e-9 * self.changes
        strings = [dataclasses.replace(string, stiffness=part * string.stiffness) for string in structure.strings]
        return self.scene.with_(structure=dataclasses.replace(structure, strings=tuple(strings)))

    def run(self, scene: Any, engine: Any, duration: float) -> Any:
        return self.tmj.simulate(scene, self.law, engine, duration=duration)

    def all(self) -> dict[str, float]:
        found = {f"a call's fixed cost, {what} [ms]": self.fixed_cost(what) for what in GIVEN}
        found["save [ms]"] = self.save()
        for name, engine in self.engines.items():
            for seconds_, what in itertools.product((2, 10), GIVEN):
                found[f"simulate, {seconds_} s, {name}, {what}"] = self.whole_call(engine, seconds_, what)
            inside, recorded = self.batches(engine, 20 if name == "RK4" else 50)
            found[f"law_in, {name}, 1 thread"] = inside
            found[f"simulate_many, {name}, 1 thread"] = recorded
        found["DAE, right-hand sides a second [1e6]"] = self.right_hand_sides()
        return found

    def fixed_cost(self, what: str) -> float:
        """Measure the cost of a call that makes one step [ms]."""
        scenes = [self.given(what) for _ in range(20 + self.repeats)]
        return 1e3 * statistics.median(seconds(partial(self.run, x, self.engines["RK4"], H)) for x in scenes)

    def save(self) -> float:
        """Measure the time to save a second of a run [ms]."""
        run = self.run(self.scene, self.engines["RK4"], 1.0)
        with tempfile.TemporaryDirectory() as folder:
            return 1e3 * statistics.median(
                seconds(lambda: run.save(Path(folder) / "run.nc")) for _ in range(self.repeats)
            )

    def whole_call(self, engine: Any, duration: int, what: str) -> float:
        """Measure `simulate`, with set-up, recording and checks, as a ratio to bare steps; scenes are not changed."""
        import mujoco

        model, count = engine.model(self.scene), round(duration / H)
        scenes = [self.given(what) for _ in range(self.repeats)]
        return ratio(
            lambda: mujoco.mj_step(model, mujoco.MjData(model), count),
            lambda: self.run(scenes.pop(), engine, duration),
            self.repeats,
        )

    def batches(self, engine: Any, steps: int) -> tuple[float, float]:
        """Measure a law in a batch of 1024, and the loop of `simulate_many`, as ratios to a bare batch."""
        from mujoco.batch import Batch

        opened, closed = (Batch(engine.model(self.scene), SIMULATIONS, 1) for _ in range(2))

        def bare() -> None:
            opened.step(nstep=steps)

        def inside() -> None:
            with self.tmj.law_in(self.scene, self.law, engine):
                closed.step(nstep=steps)

        def recorded() -> float:
            scenes = [self.scene] * SIMULATIONS
            cost = self.tmj.simulate_many(scenes, self.law, engine, duration=steps * H, threads=1).cost
            return float(cost["wall_time"])

        many = statistics.median(seconds(bare) / recorded() for _ in range(self.repeats))
        return ratio(bare, inside, self.repeats), many

    def right_hand_sides(self) -> float:
        """Measure the right-hand sides of the DAE by RK4, a second [1e6]."""
        engine = self.tmj.DAE(method=self.tmj.Method.RK4, timestep=H)
        costs = [self.run(self.scene, engine, 5.0).cost for _ in range(self.repeats)]
        return 1e-6 * statistics.median(cost["evaluations"] / cost["wall_time"] for cost in costs)


# Of both trees, in turns ------------------------------------------------------------------------------------------


def laid_out(tree: Path, folder: Path) -> Path:
    """The package of a tree as an installation has it, in a folder for PYTHONPATH."""
    ignored = shutil.ignore_patterns("__pycache__", "shipped")
    shutil.copytree(tree / "tensegrity_mj", folder / "tensegrity_mj", ignore=ignored)
    for name in ("controllers", "models"):
        shutil.copytree(tree / name, folder / "tensegrity_mj" / name, ignore=ignored)
    subprocess.run([sys.executable, "-m", "compileall", "-q", str(folder)], check=True)  # as installers do
    return folder


def start(environment: dict[str, str]) -> tuple[float, float]:
    """CPU time [s] and memory [MiB] of one run from the command line."""
    process = subprocess.Popen(START, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"{' '.join(START)} ended with {process.returncode}")
    return used.ru_utime + used.ru_stime, used.ru_maxrss / 1024


def one_run(package: Path, cache: Path, repeats: int, cold: bool) -> dict[str, float]:
    """Measure one tree once: start-up, then a process that measures the rest."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("NUMBA_")}
    environment |= {"PYTHONPATH": str(package), "NUMBA_CACHE_DIR": str(cache), "PYTHONSAFEPATH": "1"}
    found = {}
    if cold:
        with tempfile.TemporaryDirectory() as empty:
            found["cold start [s]"] = start(environment | {"NUMBA_CACHE_DIR": empty})[0]
    start(environment)  # compiles what is missing
    warm = [start(environment) for _ in range(5)]
    found["warm start [s]"] = statistics.median(one for one, _ in warm)
    found["memory, warm [MiB]"] = statistics.median(one for _, one in warm)
    command = [sys.executable, str(Path(__file__).resolve()), "--measure", "--repeats", str(repeats)]
    subprocess.run([*command[:-1], "1"], env=environment, check=True, capture_output=True)  # compiles
    done = subprocess.run(command, env=environment, check=True, capture_output=True, text=True)
    measured: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return found | measured


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--before", metavar="COMMIT_OR_FOLDER", help="the tree to compare with")
    parser.add_argument("--runs", type=int, default=3, help="separate runs of each tree (3)")
    parser.add_argument("--repeats", type=int, default=11, help="interleaved repetitions in each (11)")
    parser.add_argument("--no-cold", action="store_true", help="leave the cold start out: minutes")
    parser.add_argument("--measure", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.measure:
        print(json.dumps(Measure(options.repeats).all()))
        return
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    with tempfile.TemporaryDirectory(prefix="speed-") as name:
        folder = Path(name)
        trees = {"after": ROOT}
        if options.before:
            trees = {"before": _tree(options.before, folder / "checkout"), **trees}
        packages = {which: laid_out(tree, folder / which) for which, tree in trees.items()}
        runs: dict[str, list[dict[str, float]]] = {which: [] for which in trees}
        for number in range(options.runs):
            for which, package in packages.items():
                print(f"run {number + 1} of {options.runs}, {which} ...", file=sys.stderr, flush=True)
                cache = folder / f"cache-{which}"
                runs[which].append(one_run(package, cache, options.repeats, not options.no_cold))
    print(f"| median (least to most of {options.runs} runs) | " + " | ".join(trees) + " |")
    print("|---|" + "---|" * len(trees))
    for row, digits in ROWS.items():
        cells = []
        for found in runs.values():
            values = sorted(one[row] for one in found if row in one)
            spread = f"{values[0]:.{digits}f} to {values[-1]:.{digits}f}" if values else ""
            cells.append(f"{statistics.median(values):.{digits}f} ({spread})" if values else "-")
        print(f"| {row} | " + " | ".join(cells) + " |")


def _tree(given: str, place: Path) -> Path:
    if Path(given).is_dir():
        return Path(given)
    subprocess.run(["git", "-C", str(ROOT), "clone", "-q", "--shared", str(ROOT), str(place)], check=True)
    subprocess.run(["git", "-C", str(place), "checkout", "-q", given], check=True)
    return place


if __name__ == "__main__":
    main()
