"""Experiments on which the promise of `accuracy=` is measured: shipped scenes and random structures, drawn by seed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.actuation import Actuation
from tensegrity_mj.families.random_structures import random_scene, random_structure, random_velocities
from tensegrity_mj.scene import Scene

Array = NDArray[np.float64]

KINDS = ("shipped", "lively", "calm")
ENGINES = ("MuJoCo", "DAE", "ODE")
# Without `planar_beam` and `prism_drop`: the one takes an hour for its sweeps, the other has contact, which only one
# engine can compute, so that there is no truth to compare with.
SHIPPED = ("pinned_rod", "pinned_rod_mirror", "prism", "cross", "tbar")
DAMPED_TIME = 20.0  # s, in which a random structure comes to rest before a calm experiment
FAR = 10.0  # m; a structure that gets there falls
REQUESTS = (1e-2, 1e-10)  # m


@dataclass(frozen=True)
class Experiment:
    """One drawn experiment, and what of it is asked of which engine.

    Attributes:
        scene: with its start.
        law: or None.
        actuation: of the law.
        engine: name of the engine's class.
        accuracy: [m] asked for.
        words: what was drawn, for the report.
    """

    scene: Scene
    law: Any
    actuation: Actuation
    engine: str
    accuracy: float
    words: str


def draw(seed: int, number: int) -> Experiment:
    """The experiment of a number: kinds, engines and decades of requests go round, all else is drawn."""
    rng = np.random.default_rng([seed, number])
    kind, engine = KINDS[number % 3], ENGINES[(number // 3) % 3]
    decade = (number // 9) % 8  # 1e-2 .. 1e-9 and down to a tenth of it
    accuracy = float(f"{10.0 ** (-2 - decade - rng.uniform()):.1e}")
    accuracy = min(max(accuracy, REQUESTS[1]), REQUESTS[0])
    duration = float(rng.choice([0.5, 1.0, 2.0, 3.0]))
    if kind == "shipped":
        scene, law, words = _shipped(rng, duration)
    else:
        scene, words = _random(rng, duration, calm=kind == "calm")
        law = None
    actuation = Actuation.continuous()
    if law is not None:
        period = float(rng.choice([0.005, 0.01, 0.02]))
        mode = int(rng.integers(3))
        if mode:
            make = Actuation.hold_force_density if mode == 1 else Actuation.hold_rest_length
            actuation = make(period)
            words += f", {actuation.mode.value} {period:g} s"
    return Experiment(scene, law, actuation, engine, accuracy, f"{kind}: {words}, {duration:g} s")


def _shipped(rng: np.random.Generator, duration: float) -> tuple[Scene, Any, str]:
    from tensegrity_mj import controllers
    from tensegrity_mj.textformat import load_scene

    name = str(rng.choice(SHIPPED))
    scene = load_scene(name).with_(duration=duration)
    closed = scene.control is not None and rng.uniform() < 0.6
    if not closed:
        moving = random_velocities(rng, scene.structure, scene.nodes0, float(rng.uniform(0.05, 0.5)))
        scene = scene.with_(initial_velocities=moving)
    law = controllers.from_scene(scene) if closed else None
    return scene, law, f"{name} {'closed' if closed else 'open'} loop"


def _random(rng: np.random.Generator, duration: float, calm: bool) -> tuple[Scene, str]:
    rods, planar = int(rng.integers(1, 5)), bool(rng.uniform() < 0.25)
    stiffness = float(10 ** rng.uniform(1, 3.5))
    damped = bool(rng.uniform() < 0.4)
    damping = (0.0, float(stiffness * 10 ** rng.uniform(-4, -1.5))) if damped else (0.0, 0.0)
    gravity = bool(rng.uniform() < 0.5)
    structure = random_structure(
        rng,
        rods=rods,
        planar=planar,
        strings=int(rng.integers(2 * rods, 4 * rods + 2)),
        stiffness=(stiffness / 2, stiffness),
        damping=damping,
        stretch=(0.05, 0.3) if rng.uniform() < 0.5 else (-0.1, 0.3),
        fixed_nodes=int(rng.integers(0, 3)),
    )
    speed = float(rng.uniform(0.02, 0.2) if calm else rng.uniform(0.1, 1.0))
    scene = random_scene(rng, structure, moving=0.0 if calm else speed, gravity=gravity, duration=duration)
    if calm:
        start = _at_rest(scene)
        still = scene.with_(initial_nodes=start)
        scene = still.with_(initial_velocities=random_velocities(rng, structure, start, speed))
    told = [name for name, true in (("planar", planar), ("damped", damped), ("gravity", gravity)) if true]
    strings = len(structure.strings)
    return scene, f"{rods} rods, {strings} strings of {stiffness:.2g} N/m{''.join(', ' + one for one in told)}"


def _at_rest(scene: Scene) -> Array:
    """Where the structure comes to rest, or nearly so: after a damped run; without gravity, if it falls."""
    from tensegrity_mj.engines.dae import DAE, Drift
    from tensegrity_mj.simulation import simulate

    structure = scene.structure
    mass = float(np.min(structure.rod_masses))
    damped = scene.with_(structure=structure.with_strings(damping=np.sqrt(structure.stiffness * mass)))
    nodes = scene.nodes0
    for gravity in (scene.gravity, (0.0, 0.0, 0.0)):
        run = simulate(
            damped.with_(gravity=gravity),
            None,
            DAE(rtol=1e-6, atol=1e-8, drift=Drift.NORMALIZE),
            duration=DAMPED_TIME,
            output_interval=DAMPED_TIME,
        )
        nodes = np.array(run.nodes[-1])
        if np.max(np.abs(nodes)) < FAR:
            break
    # Rods exactly as long as they are: a sample between two steps is off by the tolerance.
    for rod, length, (i, j) in zip(structure.rods, structure.rod_lengths, structure.rod_nodes, strict=True):
        sigma, span = rod.support.sigma, nodes[j] - nodes[i]
        held, span = (1 - sigma) * nodes[i] + sigma * nodes[j], span * length / np.linalg.norm(span)
        nodes[i], nodes[j] = held - sigma * span, held + (1 - sigma) * span
    return nodes
