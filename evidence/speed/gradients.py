"""Cost of the differentiable engine: `python -m evidence.speed.gradients`, or `--only many` and so on.

    compile     seconds to compile a run and its gradients, nothing kept from before
    step        CPU time a step next to MuJoCo and the DAE at the same step, and of reverse derivatives over the run
    memory      of reverse derivatives over 10,000 steps, as XLA plans it, by steps a recorded row
    many        steps a second of `simulate_many` as ratios to MuJoCo's, 1,024 prisms under their law on two threads
    single      `--only single --count 10000`: the same runs in 32 bits on the device that JAX finds, their rate and
                their error; and a thousand in 64 bits

Ratios are medians of interleaved turns in one process, with the least and the most.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import tensegrity_mj as tmj

H = 1e-3  # s
ENGINE: dict[str, Any] = {"method": "rk4", "timestep": H}


def scenes() -> dict[str, tuple[tmj.Scene, Any]]:
    """Scenes and their laws."""
    prism = tmj.load_scene("prism")
    return {
        "prism with its law": (prism, tmj.controllers.from_scene(prism)),
        "tower": (tmj.load_scene("tower"), None),
    }


def program(
    scene: tmj.Scene, law: Any, steps: int, stride: int = 100, count: int | None = None
) -> tuple[Any, Callable[..., Any]]:
    """The parameters that are differentiated, and a scalar of the last nodes of a run, or of many, by them."""
    run = tmj.JAX(**ENGINE).model(scene, law, duration=steps * H, output_interval=stride * H)
    names = ["rest_lengths"] if law is None else ["law"]
    wanted = {name: run.parameters[name] for name in names}

    if count is not None:
        wanted |= {
            name: jnp.repeat(run.parameters[name][..., None], count, axis=-1) for name in ("nodes", "velocities")
        }

    def last(chosen: Any) -> Any:
        return jnp.sum(run.run({**run.parameters, **chosen}).nodes[-1] ** 2)

    return wanted, last


def ratios(of: list[float], to: list[float]) -> str:
    """Median, least and most."""
    found = sorted(a / b for a, b in zip(of, to, strict=True))
    return f"{statistics.median(found):.2f} ({found[0]:.2f} to {found[-1]:.2f})"


def compiled(function: Any, given: Any) -> None:
    """Trace and compile a jitted function."""
    function.lower(given).compile()


def timed(function: Callable[[], Any], clock: Callable[[], float] = time.process_time) -> float:
    """Seconds."""
    start = clock()
    found = function()
    if not isinstance(found, tmj.Trajectory):
        jax.block_until_ready(found)
    return clock() - start


def compile_times() -> None:
    """Wall time of compiling."""
    jax.config.update("jax_enable_compilation_cache", False)
    for name, (scene, law) in scenes().items():
        wanted, last = program(scene, law, 1000)
        for what, function in (("run", last), ("its gradient", jax.grad(last))):
            lowered = jax.jit(function)
            seconds = timed(partial(compiled, lowered, wanted), time.perf_counter)
            print(f"{name}, {what}: compiled in {seconds:.1f} s", flush=True)


def step_times(repeats: int, steps: int = 2000, stride: int = 10, together: int = 256) -> None:
    """CPU time a step; calls of the other engines with their set-up."""
    others: dict[str, tmj.MuJoCo | tmj.DAE] = {
        "MuJoCo": tmj.MuJoCo(H),
        "DAE": tmj.DAE(method=tmj.Method.RK4, timestep=H),
    }
    for name, (scene, law) in scenes().items():
        runs: dict[str, Callable[[], Any]] = {}
        for what, count, n in (("one", None, steps), (f"{together} at once", together, steps // 20)):
            if count is not None and law is None:
                continue
            wanted, last = program(scene, law, n, stride, count)
            for kind, function in (("", jax.jit(last)), (", reverse", jax.jit(jax.value_and_grad(last)))):
                runs[what + kind] = partial(function, wanted)
        for other, engine in others.items():
            options: dict[str, Any] = {"duration": steps * H, "output_interval": stride * H}
            runs[other] = partial(tmj.simulate, scene, law, engine, **options)
        turns = [{what: timed(run) for what, run in runs.items()} for _ in range(repeats + 1)][1:]  # the first compiles
        found = {what: [turn[what] for turn in turns] for what in runs}
        for what, times in found.items():
            taken = steps // 20 * together if "at once" in what else steps
            print(f"{name}, {what}: {1e6 * statistics.median(times) / taken:.2f} µs a step", end="")
            base = what.removesuffix(", reverse")
            print(f", {ratios(times, found[base])} of forward" if base != what else "", flush=True)
        for other in others:
            print(f"{name}: one over {other} {ratios(found['one'], found[other])}", flush=True)


def memory(steps: int = 10_000) -> None:
    """Print the memory that XLA sets aside for temporary arrays."""
    for name, (scene, law) in scenes().items():
        for stride in (1, 10, 100, 1000):
            wanted, last = program(scene, law, steps, stride)
            plan = jax.jit(jax.grad(last)).lower(wanted).compile().memory_analysis()
            print(f"{name}, {steps} steps, {stride} a row: {plan.temp_size_in_bytes / 1e6:.1f} MB", flush=True)


def many(repeats: int, count: int, steps: int, threads: int) -> None:
    """Loops, without set-up and compiling, and whole calls."""
    scene, law = scenes()["prism with its law"]
    run = tmj.simulate(scene, law, tmj.MuJoCo(H), duration=1.0)
    places = [round(k * (len(run.time) - 1) / count) for k in range(count)]
    starts = [scene.with_(initial_nodes=run.nodes[k], initial_velocities=run.velocities[k]) for k in places]
    engines = {"JAX": tmj.JAX(**ENGINE), "MuJoCo": tmj.MuJoCo(H)}
    rates: dict[str, list[float]] = {what: [] for engine in engines for what in (f"{engine} loop", f"{engine} call")}
    for turn in range(repeats + 1):
        for name, engine in engines.items():
            begun = time.perf_counter()
            runs = tmj.simulate_many(
                starts, law, engine, duration=steps * H, output_interval=steps * H, threads=threads
            )
            if turn:
                rates[f"{name} loop"].append(count * steps / runs.cost["wall_time"])
                rates[f"{name} call"].append(count * steps / (time.perf_counter() - begun))
    for what in ("loop", "call"):
        ours, theirs = (rates[f"{engine} {what}"] for engine in engines)
        print(
            f"{count} prisms with their law, {steps} steps, {what}: JAX {statistics.median(ours):,.0f} steps/s, "
            f"MuJoCo {statistics.median(theirs):,.0f}, {ratios(ours, theirs)}",
            flush=True,
        )


def single(repeats: int, count: int, steps: int) -> None:
    """Steps a second in 32 and in 64 bits of runs of the prism under its law, and the largest error of 32 bits.

    32 bits are set for all of JAX while a program is made, traced and run.
    """
    (scene, law), (device, *_) = scenes()["prism with its law"], jax.devices()
    print(f"{device.platform}: {device.device_kind}", flush=True)
    starts = tmj.simulate(scene, law, tmj.MuJoCo(H), duration=1.0)
    places = np.linspace(0, len(starts.time) - 1, count).astype(int)
    found = {}
    for bits, number in ((64, min(count, 1024)), (32, count)):
        jax.config.update("jax_enable_x64", bits == 64)
        model = tmj.JAX(**ENGINE).model(scene, law, duration=steps * H, output_interval=steps * H)
        at = places[:number] if bits == 64 else places
        batch = {"nodes": starts.nodes, "velocities": starts.velocities}
        given = model.parameters | {name: np.moveaxis(rows[at], 0, -1) for name, rows in batch.items()}
        given = jax.device_put(jax.tree.map(jnp.asarray, given))
        run = jax.jit(lambda p, model=model: model.run(p).nodes[-1])
        found[bits] = np.asarray(run(given), float)[..., : min(count, 1024)]  # compiles
        rates = [number * steps / timed(partial(run, given), time.perf_counter) for _ in range(repeats)]
        print(f"{number} prisms, {steps} steps, {bits} bits: {statistics.median(rates):,.0f} steps/s", flush=True)
    jax.config.update("jax_enable_x64", True)
    print(f"32 bits are off by {np.abs(found[32] - found[64]).max():.1e} m at most after {steps * H:g} s", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", choices=["compile", "step", "memory", "many", "single"], nargs="+")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--count", type=int, default=1024)
    parser.add_argument("--steps", type=int, default=500, help="of each of many")
    parser.add_argument("--threads", type=int, default=2)
    options = parser.parse_args()
    parts: dict[str, Callable[[], None]] = {
        "step": lambda: step_times(options.repeats),
        "many": lambda: many(options.repeats, options.count, options.steps, options.threads),
        "single": lambda: single(options.repeats, options.count, options.steps),
        "memory": memory,
        "compile": compile_times,  # last: it turns off what is kept
    }
    for name, part in parts.items():
        if options.only is None or name in options.only:
            part()


if __name__ == "__main__":
    main()
