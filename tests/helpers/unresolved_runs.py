"""Random runs at steps that are stable and coarse: what their errors are, and what the runs say of themselves."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from linked_scenes import random_tree
from numpy.typing import NDArray

import tensegrity_mj as tmj
from evidence.random_structures import random_scene, random_structure
from tensegrity_mj.errors import StabilityWarning

Array = NDArray[np.float64]

WRONG = 0.05  # of the motion
LONGEST = 5.0  # s: what is soft and tumbles longer is chaos, of which no reference knows the truth
KNOWN = 0.005  # of the motion: to which the truth must be known


@dataclass(frozen=True)
class Outcome:
    """One run.

    Attributes:
        seed: of the draw.
        kind: engine and actuation, for people.
        part: the step over the largest stable one at the start.
        steps: how many.
        error: largest node error over the largest motion; ∞ for a divergence.
        warned: what it said: warnings, or the divergence.
        doubt: difference of two references over the motion.
        estimate: the run's own, over its motion.
    """

    seed: int
    kind: str
    part: float
    steps: int
    error: float
    warned: tuple[str, ...]
    doubt: float
    estimate: float

    @property
    def silent(self) -> bool:
        """Wrong by more than 5 % of the motion, without a warning."""
        return self.error > WRONG and not self.warned

    @property
    def known(self) -> bool:
        """Whether the references agree well enough to judge."""
        return self.doubt < KNOWN


def engine_of(rng: np.random.Generator, linked: bool, step: float = 1.0) -> Any:
    """One of all fixed-step engines and integrators."""
    integrators = list(tmj.Integrator)
    number = int(rng.integers(len(integrators) + (1 if linked else 2) + 1))
    if number < len(integrators):
        return tmj.MuJoCo(step, integrators[number])
    if number == len(integrators):
        return tmj.MuJoCo(step)
    engine = tmj.DAE if number == len(integrators) + 1 else tmj.ODE
    return engine(tmj.Method.RK4, timestep=step, locate_slack=bool(rng.integers(3) == 0))


def scene_of(rng: np.random.Generator) -> tuple[tmj.Scene, bool]:
    """1 to 6 rods at rest or in motion, soft to stiff, with and without dampers, gravity and loads."""
    linked = rng.uniform() < 0.2
    k = 10 ** rng.uniform(1, 6)
    if linked:
        scene = random_tree(rng, int(rng.integers(1, 5)), planar=bool(rng.integers(2)))
        factor = k / 20
        strings = [
            replace(string, stiffness=string.stiffness * factor, rest_length=float(length * rng.uniform(0.95, 0.999)))
            for string, length in zip(
                scene.structure.strings, scene.structure.string_lengths(scene.nodes0), strict=True
            )
        ]
        return scene.with_(structure=replace(scene.structure, strings=tuple(strings))), True
    rods = int(rng.integers(1, 7))
    structure = random_structure(
        rng,
        rods=rods,
        point_masses=int(rng.integers(2)),
        planar=bool(rng.integers(3) == 0),
        stretch=(-0.02, 10 ** rng.uniform(-3, -0.5)),
        stiffness=(k, k * 10 ** rng.uniform(0, 2)),
        damping=(0.0, 0.0) if rng.integers(2) else (0.0, 0.1 * float(np.sqrt(k))),
    )
    scene = random_scene(
        rng,
        structure,
        moving=float(rng.choice([0.0, 10 ** rng.uniform(-2, 1)])),
        gravity=bool(rng.integers(2)),
        loads=int(rng.integers(3)),
    )
    return scene, False


def actuation_of(rng: np.random.Generator, scene: tmj.Scene) -> tuple[Any, str]:
    """None, or a law of constant force densities, or of rest lengths that move, with how it acts."""
    number = int(rng.integers(8))
    structure = scene.structure
    if number > 3 or not structure.strings:
        return None, "no law"
    if number == 3:
        rest, speed = structure.rest_lengths, 0.02 * structure.rest_lengths

        class Winches:
            command = tmj.Command.REST_LENGTH

            def __call__(self, time: float, nodes: Array, velocities: Array) -> Array:
                return np.asarray(rest * (1 - 0.02 * np.sin(5 * time)) + 0 * speed)

        return Winches(), "hold rest length"
    lengths = structure.string_lengths(scene.nodes0)
    u = np.maximum(0.0, structure.stiffness * (1 - structure.rest_lengths / lengths))
    return (lambda time, nodes, velocities: u), ("continuous", "hold force density", "hold rest length")[number]


def random_run(seed: int) -> Outcome | None:
    """One draw; None where nothing is stiff, so that every step is stable."""
    rng = np.random.default_rng([1914, seed])
    scene, linked = scene_of(rng)
    engine = engine_of(rng, linked)
    law, mode = actuation_of(rng, scene)
    continuous = mode in ("no law", "continuous")
    hold = None if continuous else getattr(tmj.Actuation, mode.replace(" ", "_"))
    options: dict[str, Any] = {"law": law} | ({} if continuous else {"actuation": hold(1.0)})
    limit = tmj.stable_step(scene, engine, **options).limit
    euler = tmj.stable_step(scene, tmj.MuJoCo(1.0, tmj.Integrator.EULER), **options).limit
    limit = min(limit, 4 * euler)  # `discrete` has none, or one far away
    if not np.isfinite(limit):
        return None
    part, steps = float(rng.uniform(0.5, 1.0)), int(np.exp(rng.uniform(np.log(2), np.log(150))))
    h = part * limit
    steps = min(steps, max(2, int(LONGEST / h)))
    ratio = int(rng.integers(1, 4))
    actuation = None if continuous else hold(ratio * h)
    steps = steps if continuous else max(1, steps // ratio) * ratio
    common = {"duration": steps * h, "actuation": actuation, "output_interval": h}
    engine = replace(engine, timestep=h)
    kind = f"{engine}, {mode}"
    try:
        truth = tmj.simulate(scene, law, tmj.DAE(rtol=1e-10, atol=1e-12), **common)
        other = tmj.simulate(scene, law, tmj.DAE(rtol=1e-8, atol=1e-10), **common)
    except tmj.errors.DivergenceError:
        return Outcome(seed, kind, part, steps, np.nan, (), np.inf, np.nan)
    motion = float(np.max(np.linalg.norm(truth.nodes - truth.nodes[0], axis=-1)))
    if not motion > 1e-9:
        return None
    doubt = tmj.compare(truth, other).max_node_error / motion
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", StabilityWarning)
        try:
            run = tmj.simulate(scene, law, engine, **common)
        except tmj.errors.DivergenceError as error:
            return Outcome(seed, kind, part, steps, np.inf, (str(error),), doubt, np.inf)
    if run.status is not tmj.Status.COMPLETED:
        return Outcome(seed, kind, part, steps, np.inf, (run.message,), doubt, np.inf)
    said = tuple(run.reports["warnings"]) + tuple(str(w.message) for w in caught if w.category is StabilityWarning)
    error = tmj.compare(run, truth).max_node_error / motion
    found = run.reports["resolution"]
    return Outcome(seed, kind, part, steps, error, said, doubt, found["error_estimate"] / max(found["motion"], 1e-300))
