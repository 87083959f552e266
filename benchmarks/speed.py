"""Speed as ratios, measured side by side in one run: `python benchmarks/speed.py`.

The prism of §5.5 in closed loop (Lyapunov law, p = 2, evaluated at every stage) against the bare C loop
`mj_step(nstep)` of the same model without any law, and the right-hand sides of DAE and ODE against bare Euler steps.
Each figure is the best of several interleaved repetitions, so that other load on the machine hits both sides.
"""

from __future__ import annotations

import itertools
import time

import mujoco

import tensegrity_mj as tmj

REPEATS = 7
STEPS = 10_000
STEP = 1e-3


def bare(scene: tmj.Scene, engine: tmj.MuJoCo) -> float:
    """Steps a second of MuJoCo alone."""
    model = engine.model(scene)
    data = mujoco.MjData(model)
    start = time.perf_counter()
    mujoco.mj_step(model, data, STEPS)
    return STEPS / (time.perf_counter() - start)


def closed(scene: tmj.Scene, engine: object, key: str) -> float:
    """Steps or evaluations a second of a closed-loop run."""
    law = tmj.controllers.from_scene(scene)
    run = tmj.simulate(scene, law, engine, duration=STEPS * STEP)
    return run.cost[key] / run.cost["wall_time"]


def main() -> None:
    """Measure and print."""
    print(f"{'scene':12s} {'closed loop':42s} {'per second':>12s} {'bare MuJoCo':>22s} {'ratio':>6s}")
    for name in ("prism", "pinned_rod"):
        scene = tmj.load_scene(name)
        engines = {
            integrator: tmj.MuJoCo(STEP, integrator) for integrator in (tmj.Integrator.RK4, tmj.Integrator.EULER)
        }
        integrated = {
            "DAE DOP853, rtol 1e-12": tmj.DAE(rtol=1e-12, atol=1e-13),
            "DAE RK4": tmj.DAE(tmj.Method.RK4, timestep=STEP),
            "ODE DOP853, rtol 1e-12": tmj.ODE(rtol=1e-12, atol=1e-13),
            "ODE RK4": tmj.ODE(tmj.Method.RK4, timestep=STEP),
        }
        best: dict[str, float] = {}
        for _ in range(REPEATS):
            for integrator, engine in engines.items():
                for label, value in (
                    (f"bare {integrator.value}", bare(scene, engine)),
                    (f"MuJoCo {integrator.value}", closed(scene, engine, "steps")),
                ):
                    best[label] = max(best.get(label, 0.0), value)
            for label, reference in integrated.items():
                best[label] = max(best.get(label, 0.0), closed(scene, reference, "evaluations"))
        for label, against in (
            ("MuJoCo rk4", "bare rk4"),
            ("MuJoCo euler", "bare euler"),
            *((label, "bare euler") for label in integrated),
        ):
            unit = "right-hand sides" if label in integrated else "steps"
            shown = f"{against} {best[against]:,.0f}/s"
            ratio = best[label] / best[against]
            print(f"{name:12s} {label + ', ' + unit:42s} {best[label]:12,.0f} {shown:>22s} {ratio:6.2f}")


def draw() -> None:
    """Milliseconds a frame at 1280x720, without encoding: the median and the least."""
    from tensegrity_mj.rendering import frames

    scene = tmj.load_scene("prism")
    run = tmj.simulate(scene, tmj.controllers.from_scene(scene), tmj.MuJoCo(STEP))
    for label, options in (
        ("one run", {}),
        ("two overlaid", {"other": run}),
        ("two side by side", {"other": run, "layout": tmj.Layout.SIDE_BY_SIDE}),
    ):
        times = [time.perf_counter()]
        times += [time.perf_counter() for _ in frames(run, **options)]
        spent = sorted(1e3 * (b - a) for a, b in itertools.pairwise(times))
        print(f"drawing, {label:17s} median {spent[len(spent) // 2]:5.1f} ms a frame, least {spent[0]:5.1f} ms")


if __name__ == "__main__":
    main()
    draw()
