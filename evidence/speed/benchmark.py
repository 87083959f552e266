"""Speed as ratios, measured side by side in one run: what the law, the ledger and Python cost relative to bare MuJoCo.

Each figure is the best of several interleaved repetitions, so that other load on the machine hits both sides of a
ratio. Wall times depend on the machine; ratios hardly do.
"""

from __future__ import annotations

import itertools
import os
import platform
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

import mujoco

from tensegrity_mj.basics import kinds
from tensegrity_mj.basics.fields import field, refused, value
from tensegrity_mj.basics.jsontext import plain_values
from tensegrity_mj.basics.texts import aligned
from tensegrity_mj.dynamics.native.law import native_law
from tensegrity_mj.engines.mujoco.install import profiler_off
from tensegrity_mj.engines.mujoco.settings import Integrator, MuJoCo
from tensegrity_mj.engines.reference.dae import DAE
from tensegrity_mj.engines.reference.method import Method
from tensegrity_mj.engines.reference.ode import ODE
from tensegrity_mj.errors import MissingLibraryError, OptionError, TensegrityError
from tensegrity_mj.model.actuation import Actuation
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.simulation import simulate, versions
from tensegrity_mj.simulation.ensemble import law_in, simulate_many

INTEGRATORS = (Integrator.RK4, Integrator.EULER)
CONTROL_PERIOD = 0.01  # s, of laws that cost more than a step


@value("benchmark", OptionError)
class Benchmark:
    """Options of the benchmark.

    Attributes:
        scenes: with a control law each.
        repeats: interleaved repetitions; the best counts.
        timestep: of every fixed step [s].
        sample: least wall time of one sample of the bare loop [s].
        simulations: in a batch; 0 leaves batches out.
        threads: of the batches.
        renderer, startup: whether to measure these.

    Raises:
        OptionError: for values out of range.
    """

    scenes: tuple[Scene, ...] = field(kinds.parts(Scene))
    repeats: int = field(kinds.whole(1), default=15)
    timestep: float = field(kinds.positive("s"), default=1e-3)
    sample: float = field(kinds.positive("s"), default=0.1)
    simulations: int = field(kinds.whole(0), default=1024)
    threads: tuple[int, ...] = field(kinds.many(kinds.whole(1), "a list of integers"), default=(1, 2))
    renderer: bool = True
    startup: bool = True

    def __attrs_post_init__(self) -> None:
        if not self.scenes:
            raise refused(self, "name at least one scene")


def run_benchmark(options: Benchmark, report: Callable[[str], None] = lambda text: None) -> dict[str, Any]:
    """Measure; `report` is called with what is being measured. Everything measured is under "timing".

    Raises:
        OptionError: for a scene without a law.
    """
    timing: dict[str, Any] = {"single": [], "batch": [], "references": []}
    for scene in options.scenes:
        report(f"{scene.name}: single runs")
        timing["single"] += _single(options, scene)
        report(f"{scene.name}: reference models")
        timing["references"] += _references(options, scene)
        if options.simulations:
            report(f"{scene.name}: {options.simulations} simulations at once")
            timing["batch"] += _batches(options, scene)
    if options.renderer:
        report("renderer")
        timing["renderer"] = _renderer(options)
    if options.startup:
        report("start-up")
        timing["startup"] = _startup(options)
    return {
        "settings": {
            "scenes": [scene.name for scene in options.scenes],
            **plain_values(options, "repeats", "timestep", "sample", "simulations", "threads"),
        },
        "machine": {"processor": platform.machine(), "cores": os.cpu_count(), "versions": versions()},
        "timing": timing,
    }


def _law(scene: Scene) -> tuple[Any, Actuation]:
    """The scene's own law, at every stage where it is cheap enough for that, else sampled."""
    from tensegrity_mj.controllers.scenes import from_scene

    law = from_scene(scene)
    cheap = native_law(law, scene.structure).failure is None  # compiled
    return law, Actuation.continuous() if cheap else Actuation.hold_force_density(CONTROL_PERIOD)


def _seconds(call: Callable[[], object]) -> float:
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


def _interleaved(bare: Callable[[], float], loop: Callable[[], float], repeats: int) -> dict[str, float]:
    """Rates per second of loops, taken in turn: the best of each, their ratio, and the median ratio of pairs.

    The bare loop is as MuJoCo comes, reading a clock for its profiler; in a second loop, without, as our own loops are.
    """

    def unclocked() -> float:
        with profiler_off():
            return bare()

    rounds = [(bare(), unclocked(), loop()) for _ in range(repeats)]
    opened, without_clock, closed = (max(column) for column in zip(*rounds, strict=True))
    return {
        "open": opened,
        "open_without_clock": without_clock,
        "closed": closed,
        "ratio": closed / opened,
        "median_ratio": statistics.median(c / a for a, _, c in rounds),
        "ratio_without_clock": closed / without_clock,
    }


def _steps(options: Benchmark, scene: Scene, engine: MuJoCo) -> int:
    """Steps of one sample: a multiple of the control period, within the scene's duration."""
    model = engine.model(scene)
    data = mujoco.MjData(model)
    trial = 64
    seconds = _seconds(lambda: mujoco.mj_step(model, data, trial))
    unit = max(1, round(CONTROL_PERIOD / engine.timestep))
    wanted = min(options.sample * trial / seconds, scene.duration / engine.timestep)
    return unit * max(1, int(wanted / unit))


def _single(options: Benchmark, scene: Scene) -> list[dict[str, Any]]:
    law, actuation = _law(scene)
    found = []
    for integrator in INTEGRATORS:
        engine = MuJoCo(options.timestep, integrator)
        steps = _steps(options, scene, engine)
        model = engine.model(scene)

        def bare(model: Any = model, steps: int = steps) -> float:
            data = mujoco.MjData(model)
            return steps / _seconds(lambda: mujoco.mj_step(model, data, steps))

        def closed(engine: MuJoCo = engine, steps: int = steps) -> float:
            run = simulate(scene, law, engine, duration=steps * engine.timestep, actuation=actuation)
            return run.cost["steps"] / run.cost["wall_time"]

        rates = _interleaved(bare, closed, options.repeats)
        found.append(
            {
                "scene": scene.name,
                "integrator": integrator.value,
                "law": "at every stage" if actuation.period is None else f"each {actuation.period:g} s",
                "steps": steps,
                **rates,
                "real_time_factor": rates["closed"] * options.timestep,
            }
        )
    return found


def _references(options: Benchmark, scene: Scene) -> list[dict[str, Any]]:
    """Right-hand sides a second of DAE and ODE, closed loop."""
    law, actuation = _law(scene)
    steps = _steps(options, scene, MuJoCo(options.timestep, Integrator.RK4))
    found = []
    for engine in (
        DAE(Method.RK4, timestep=options.timestep),
        ODE(Method.RK4, timestep=options.timestep),
        DAE(rtol=1e-10, atol=1e-12),
        ODE(rtol=1e-10, atol=1e-12),
    ):
        best, why = 0.0, ""
        for _ in range(options.repeats):
            try:
                run = simulate(scene, law, engine, duration=steps * options.timestep, actuation=actuation)
            except TensegrityError as error:  # the ODE at a pole, a law without a solution
                why = str(error)
                break
            best = max(best, run.cost["evaluations"] / run.cost["wall_time"])
        came_out = {"evaluations_per_second": best} if best else {"skipped": why}
        found.append({"scene": scene.name, "engine": str(engine), **came_out})
    return found


def _batches(options: Benchmark, scene: Scene) -> list[dict[str, Any]]:
    """Many simulations: `mujoco.batch.Batch` with and without the law inside, and `simulate_many`, which records."""
    from mujoco.batch import Batch

    law, actuation = _law(scene)
    if actuation.period is not None:
        return [{"scene": scene.name, "skipped": "its law is sampled in Python: only simulate_many runs it"}]
    found = []
    for integrator, threads in itertools.product(INTEGRATORS, options.threads):
        engine = MuJoCo(options.timestep, integrator)
        count = options.simulations
        steps = max(1, min(_steps(options, scene, engine) * 2 // count, 100))
        opened = Batch(engine.model(scene), count, threads)
        closed = Batch(engine.model(scene), count, threads)

        def bare(batch: Any = opened, steps: int = steps) -> float:
            return batch.nsim * steps / _seconds(lambda: batch.step(nstep=steps))

        def inside(batch: Any = closed, steps: int = steps, engine: MuJoCo = engine) -> float:
            with law_in(scene, law, engine):
                return batch.nsim * steps / _seconds(lambda: batch.step(nstep=steps))

        def recorded(engine: MuJoCo = engine, steps: int = steps, threads: int = threads, n: int = count) -> float:
            runs = simulate_many([scene] * n, law, engine, duration=steps * engine.timestep, threads=threads)
            return float(runs.cost["steps"]) / float(runs.cost["wall_time"])

        common = {"scene": scene.name, "integrator": integrator.value, "threads": threads, "simulations": count}
        for label, loop in (("law_in", inside), ("simulate_many", recorded)):
            found.append({**common, "loop": label, "steps": steps, **_interleaved(bare, loop, options.repeats)})
    return found


def _renderer(options: Benchmark) -> dict[str, Any]:
    """Frames a second of the first scene at 1280x720, without encoding."""
    from tensegrity_mj.pictures.video import frames

    scene = options.scenes[0]
    run = simulate(scene, None, MuJoCo(options.timestep), duration=min(scene.duration, 1.0))
    spent: list[float] = []
    try:
        times = [time.perf_counter()]
        times += [time.perf_counter() for _ in frames(run)]
        spent = sorted(b - a for a, b in itertools.pairwise(times))
    except MissingLibraryError as error:
        return {"scene": scene.name, "skipped": str(error)}
    return {
        "scene": scene.name,
        "frames": len(spent),
        "frames_per_second": 1.0 / spent[len(spent) // 2],  # of the median frame
        "best_frames_per_second": 1.0 / spent[0],
    }


def _startup(options: Benchmark) -> dict[str, Any]:
    """Seconds until `tensegrity-mj --help` has answered, and what of it is Python's own; the slowest imports."""

    def best(*arguments: str) -> float:
        command = [sys.executable, *arguments]
        return min(
            _seconds(lambda: subprocess.run(command, check=True, capture_output=True)) for _ in range(options.repeats)
        )

    traced = subprocess.run(
        [sys.executable, "-X", "importtime", "-m", "tensegrity_mj", "--help"],
        check=True,
        capture_output=True,
        text=True,
    )
    imports = []
    for line in traced.stderr.splitlines():
        parts = line.removeprefix("import time:").split("|")
        if len(parts) == 3 and parts[1].strip().isdigit():
            imports.append((parts[2].strip(), int(parts[0]) * 1e-6))
    slowest = sorted(imports, key=lambda entry: -entry[1])[:5]
    return {
        "help": best("-m", "tensegrity_mj", "--help"),
        "python": best("-c", "pass"),
        "slowest_imports": [{"module": name, "seconds": seconds} for name, seconds in slowest],
    }


def lines(result: dict[str, Any]) -> list[str]:
    """Return the result as lines of text."""
    timing = result["timing"]
    rates = ("steps/s", "bare MuJoCo", "ratio", "median", "no clock", "ratio")
    single = [(row["scene"], row["integrator"], row["law"], *_rates(row)) for row in timing["single"]]
    out = aligned([("single run", "integrator", "law", *rates), *single])
    if timing["batch"]:
        batch = [
            (row["scene"], row["integrator"], row["loop"], *_rates(row), f"{row['threads']} ({row['simulations']})")
            for row in timing["batch"]
            if "skipped" not in row
        ]
        out += ["", *aligned([("at once", "integrator", "loop", *rates, "threads (simulations)"), *batch])]
        out += [f"{row['scene']}: {row['skipped']}" for row in timing["batch"] if "skipped" in row]
    out += [
        "bare MuJoCo: mj_step(nstep) or Batch without a law, as it comes; no clock: the same with its profiler off, as "
        "our runs have it",
    ]
    references = [
        (row["scene"], row["engine"], row.get("skipped") or f"{row['evaluations_per_second']:,.0f}")
        for row in timing["references"]
    ]
    out += ["", *aligned([("reference", "engine", "right-hand sides/s"), *references])]
    if "renderer" in timing:
        row = timing["renderer"]
        text = row.get("skipped") or (
            f"{row['frames_per_second']:.0f} frames/s at 1280x720 (median; best {row['best_frames_per_second']:.0f})"
        )
        out += ["", f"renderer, {row['scene']}: {text}"]
    if "startup" in timing:
        row = timing["startup"]
        out += [
            "",
            f"start-up: tensegrity-mj --help answers in {row['help']:.2f} s (Python alone {row['python']:.2f} s)",
        ]
    return out


def _rates(row: dict[str, Any]) -> tuple[str, ...]:
    speeds = [f"{row[name]:,.0f}" for name in ("closed", "open", "open_without_clock")]
    ratios = [f"{row[name]:.2f}" for name in ("ratio", "median_ratio", "ratio_without_clock")]
    return (*speeds[:2], *ratios[:2], speeds[2], ratios[2])
