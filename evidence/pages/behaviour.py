"""Record of what the code computes, against which a change of its structure can be held.

    python -m evidence.pages.behaviour record evidence/pages/behaviour.json.gz  # before
    python -m evidence.pages.behaviour compare evidence/pages/behaviour.json.gz  # after; 1 if any differs

Every shipped scene in every engine that takes it (each integrator, the three actuations, 100 steps of 1 ms), linear
models, stable steps, equilibria, and what the commands print as JSON. Arrays are kept as a hash of their bytes and as
sums of their entries and of their absolute values, weighted at random from a fixed seed: the hash says whether they are
the same bit for bit, the sums by how much they differ if not. A record is of one machine: another one rounds otherwise.
"""

from __future__ import annotations

import contextlib
import gzip
import hashlib
import io
import json
import math
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import tensegrity_mj as tmj
from tensegrity_mj import cli

SCENES = sorted(path.parent.name for path in (Path(__file__).parents[2] / "models").glob("*/scene.toml"))
STEPS = 100
TIMES = (
    "wall_time",
    "real_time",
    "law_time",
    "seconds",
    "elapsed",
    "time_per_step",
    "microseconds",
    "per_step",
    "created",
    "memory",
)
COMMANDS = (
    "scenes",
    "scenes prism --json",
    "run prism --duration 0.1 --json",
    "run prism_drop --duration 0.1 --json",
    "run tower_waves --timestep 2e-3 --duration 0.1 --json",
    "run net --engine dae --duration 0.1 --json",
    "compare prism --timestep 5e-3 --duration 0.5 --json",
    "compare cross --engine ode --reference dae --duration 0.5 --json",
    "statics truss_arm --load t4=0,0,-20 --json",
    "statics prism --json",
    "stability prism --json",
    "reproduce 5.4 6.7 --no-figures --json",
)


def digest(value: Any) -> dict[str, Any]:
    """Hash and weighted sums of an array."""
    array = np.ascontiguousarray(np.asarray(value, float))
    weights = np.random.default_rng(array.size).uniform(-1.0, 1.0, array.size)
    flat = array.ravel()
    finite = np.where(np.isfinite(flat), flat, 0.0)
    return {
        "hash": hashlib.sha256((array + 0.0).tobytes()).hexdigest()[:16],
        "sum": math.fsum(weights * finite),
        "size": math.fsum(np.abs(weights * finite)),
        "shape": list(array.shape),
    }


def engines() -> dict[str, Callable[[float], Any]]:
    """Engines by name, each made from a step [s]."""
    made: dict[str, Callable[[float], Any]] = {
        f"mujoco {one.value}": partial(tmj.MuJoCo, integrator=one) for one in tmj.Integrator
    }
    made["mujoco located"] = lambda step: tmj.MuJoCo(step, locate_slack=True)
    made["dae rk4"] = lambda step: tmj.DAE(method=tmj.Method.RK4, timestep=step)
    made["dae normalized"] = lambda step: tmj.DAE(
        method=tmj.Method.RK4, timestep=step, drift=tmj.engines.Drift.NORMALIZE
    )
    made["dae dop853"] = lambda step: tmj.DAE(rtol=1e-9, atol=1e-10)
    made["ode rk4"] = lambda step: tmj.ODE(method=tmj.Method.RK4, timestep=step)
    made["ode dop853"] = lambda step: tmj.ODE(rtol=1e-9, atol=1e-10)
    return made


def runs(name: str) -> Iterator[tuple[str, Any]]:
    """Short runs of a scene, and what is derived from its equations."""
    scene = tmj.load_scene(name)
    law = tmj.controllers.from_scene(scene) if scene.control is not None else None
    actuations = {"continuous": tmj.Actuation.continuous()}
    step = 1e-3
    if law is not None:
        actuations["force density"] = tmj.Actuation.hold_force_density(10 * step)
        actuations["rest length"] = tmj.Actuation.hold_rest_length(10 * step)
    for engine_name, make in engines().items():
        for actuation_name, actuation in actuations.items():
            key = f"{name} | {engine_name} | {actuation_name}"
            try:
                run = tmj.simulate(
                    scene, law, make(step), duration=STEPS * step, output_interval=10 * step, actuation=actuation
                )
            except tmj.TensegrityError as error:
                yield key, {"error": f"{type(error).__name__}: {error}"}
                continue
            kept = ("nodes", "velocities", "tensions", "rest_lengths", "multipliers", "winch_work", "external_work")
            yield key, {part: digest(getattr(run, part)) for part in (*kept, "dissipation", "lyapunov")}
            yield f"{key} | warnings", {"words": run.reports["warnings"]}
    linear: dict[str, Any] = {"mujoco": tmj.MuJoCo(), "dae": tmj.DAE(), "ode": tmj.ODE()}
    for engine_name, engine in linear.items():
        if len(scene.structure.rods) > 20:
            continue
        key = f"{name} | {engine_name} | linear"
        try:
            model = tmj.linearize(scene, engine, law=law)
        except tmj.TensegrityError as error:
            yield key, {"error": f"{type(error).__name__}: {error}"}
        else:
            yield key, {"A": digest(model.A), "B": digest(model.B), "C": digest(model.C)}
    for integrator in tmj.Integrator:
        key = f"{name} | {integrator.value} | stable step"
        try:
            yield key, {"step": digest(tmj.stable_step(scene, tmj.MuJoCo(1e-3, integrator), law=None).limit)}
        except tmj.TensegrityError as error:
            yield key, {"error": f"{type(error).__name__}: {error}"}
    if len(scene.structure.rods) <= 20:
        key = f"{name} | equilibrium"
        try:
            yield key, {"nodes": digest(tmj.statics.find_equilibrium(scene).nodes)}
        except tmj.TensegrityError as error:
            yield key, {"error": f"{type(error).__name__}: {error}"}


def leaves(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Paths and values of a JSON object, without what a clock measured."""
    if isinstance(value, dict):
        for key, one in value.items():
            if not any(time in key for time in TIMES):
                yield from leaves(one, f"{path}.{key}")
    elif isinstance(value, list):
        for number, one in enumerate(value):
            yield from leaves(one, f"{path}[{number}]")
    else:
        yield path, value


def commands() -> Iterator[tuple[str, Any]]:
    """Exit status and the JSON of commands."""
    for line in COMMANDS:
        out = io.StringIO()
        with (
            tempfile.TemporaryDirectory() as folder,
            contextlib.chdir(folder),
            contextlib.redirect_stdout(out),
            contextlib.redirect_stderr(io.StringIO()),
        ):
            status = cli.main(line.split())
        found: dict[str, Any] = {"status": status}
        if "--json" in line:
            values = dict(leaves(json.loads(out.getvalue())))
            numbers = [value for value in values.values() if isinstance(value, float | int)]
            found |= {"numbers": digest(numbers), "keys": digest([hash_of(key) for key in values])}
        yield f"$ {line}", found


def hash_of(text: str) -> int:
    """A number of 32 bits of a text."""
    return int(hashlib.sha256(text.encode()).hexdigest()[:8], 16)


def record() -> dict[str, Any]:
    """Compute all records, by key."""
    found: dict[str, Any] = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name in SCENES:
            print(name, file=sys.stderr, flush=True)
            found.update(runs(name))
        print("commands", file=sys.stderr, flush=True)
        found.update(commands())
    return found


def differences(before: dict[str, Any], after: dict[str, Any]) -> Iterator[str]:
    """A line for each thing that is not the same."""
    for key in sorted(before.keys() | after.keys()):
        if key not in before or key not in after:
            yield f"{key}: {'new' if key not in before else 'gone'}"
            continue
        for part in sorted(before[key].keys() | after[key].keys()):
            old, new = before[key].get(part), after[key].get(part)
            if old == new:
                continue
            if isinstance(old, dict) and isinstance(new, dict) and old["shape"] == new["shape"]:
                off = abs(old["sum"] - new["sum"]) / max(old["size"], 1e-300)
                yield f"{key}: {part} differs by {off:.1e} of its size"
            else:
                yield f"{key}: {part} was {old}, is {new}"


def main() -> int:
    """The command line above."""
    action, path = sys.argv[1], Path(sys.argv[2])
    found = json.loads(json.dumps(record()))
    if action == "record":
        path.write_bytes(gzip.compress(json.dumps(found, indent=0).encode(), mtime=0))
        return 0
    lines = list(differences(json.loads(gzip.decompress(path.read_bytes())), found))
    print("\n".join(lines) or "the same, bit for bit")
    return bool(lines)


if __name__ == "__main__":
    raise SystemExit(main())
