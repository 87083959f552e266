"""Experiments on which the promise of `accuracy=` is measured: shipped scenes and random structures, drawn by seed.

Those of `Kind.EVENTS` have forces with more kinks and jumps than those of slack strings: corners of tension curves,
yields, dampers that may push, strings over pulleys, supports that follow data, and records of the ground.

Random ones go from where a fixed step is easy to where it is not: strings of any stiffness, dampers that stop a
structure within a step, rods that spin, rods so short that a string's tension turns them fast, rods near the pole of
the ODE's angles. Contact is left out, which one engine alone can compute.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from evidence.extremes.pace import pace
from evidence.random_linked import log_uniform, random_velocities
from evidence.random_structures import random_structure
from tensegrity_mj.basics.arrays import Array, unit
from tensegrity_mj.model.actuation import Actuation, Mode
from tensegrity_mj.model.ground import Ground
from tensegrity_mj.model.members import String
from tensegrity_mj.model.motion import Motion
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.strings import StringLaw
from tensegrity_mj.model.structure import Structure


class Kind(enum.Enum):
    """Kinds of scenes that experiments are drawn from."""

    RANDOM = "random"  # structures of 1 to 6 rods
    SHIPPED = "shipped"  # scenes of the package, open and closed loop, all actuation modes
    EVENTS = "events"  # structures of 1 to 3 rods whose forces have kinks and jumps of one sort


ENGINES = ("MuJoCo", "DAE", "ODE")
# Without `planar_beam` and `prism_drop`: the one takes an hour for its sweeps, the other has contact, which only one
# engine can compute, so that there is no truth to compare with.
SHIPPED = ("pinned_rod", "pinned_rod_mirror", "prism", "cross", "tbar")
REQUESTS = (1e-2, 1e-10)  # m
STIFFNESS = (1e-3, 1e10)  # N/m
SPEED = (1e-2, 10.0)  # m/s that the strings give a rod of 1 kg
LARGEST_STRETCH = 0.3
RATIO = (1e-3, 100.0)  # of dampers to critical ones
SPIN = (0.1, 100.0)  # rad/s
SHORTEST = 10**-4.5  # m, of rods
TILT = (2e-3, 0.1)  # rad from the pole of the ODE, which stops at 1e-3
TURNS = (3.0, 300.0)  # rad of the fastest vibration or turn in a run: a tight reference takes some 10 evaluations each
DECAYS = 3e3  # most time constants of the fastest damper in a run
LONGEST = 2.0  # s
DEPTH = (1.5, 7.0)  # decades from what the nodes move to the request
SORTS = ("curved", "yielding", "pushing", "pulleys", "moved", "shaken")  # of events


@dataclass(frozen=True)
class Experiment:
    """One drawn experiment, and which engine computes it to which accuracy.

    Attributes:
        scene: with its start.
        law: or None.
        actuation: of the law.
        engine: name of the engine's class.
        accuracy: [m] requested.
        description: what was drawn, for the report.
    """

    scene: Scene
    law: Any
    actuation: Actuation
    engine: str
    accuracy: float
    description: str


def draw(seed: int, number: int, kind: Kind = Kind.RANDOM) -> Experiment:
    """The experiment of a number: engines go round, all else is drawn."""
    rng = np.random.default_rng([seed, number])
    engine = ENGINES[number % 3]
    if kind is not Kind.SHIPPED:
        scene, distance, description = (
            _random(rng) if kind is Kind.RANDOM else _eventful(rng, SORTS[number // 3 % len(SORTS)])
        )
        accuracy = distance * 10 ** -rng.uniform(*DEPTH)
        return Experiment(scene, None, Actuation.continuous(), engine, _request(accuracy), f"random: {description}")
    decade = (number // 3) % 8  # 1e-2 .. 1e-9 and down to a tenth of it
    accuracy = 10.0 ** (-2 - decade - rng.uniform())
    scene, law, description = _shipped(rng, duration := float(rng.choice([0.5, 1.0, 2.0, 3.0])))
    actuation = Actuation.continuous()
    if law is not None:
        period = float(rng.choice([0.005, 0.01, 0.02]))
        mode = (Mode.CONTINUOUS, Mode.HOLD_FORCE_DENSITY, Mode.HOLD_REST_LENGTH)[int(rng.integers(3))]
        if mode is not Mode.CONTINUOUS:
            actuation = Actuation(mode, period)
            description += f", {actuation.mode.value} {period:g} s"
    return Experiment(scene, law, actuation, engine, _request(accuracy), f"shipped: {description}, {duration:g} s")


def _request(accuracy: float) -> float:
    """[m] of two digits, in the range that may be requested."""
    return min(max(float(f"{accuracy:.1e}"), REQUESTS[1]), REQUESTS[0])


def _shipped(rng: np.random.Generator, duration: float) -> tuple[Scene, Any, str]:
    from tensegrity_mj.controllers.scenes import from_scene
    from tensegrity_mj.library.named import load_scene

    name = str(rng.choice(SHIPPED))
    scene = load_scene(name).with_(duration=duration)
    closed = scene.control is not None and rng.uniform() < 0.6
    if not closed:
        moving = random_velocities(rng, scene.structure, scene.nodes0, float(rng.uniform(0.05, 0.5)))
        scene = scene.with_(initial_velocities=moving)
    law = from_scene(scene) if closed else None
    return scene, law, f"{name} {'closed' if closed else 'open'} loop"


def _random(rng: np.random.Generator) -> tuple[Scene, float, str]:
    """A scene, about how far its nodes move [m], and what it is in words."""
    rods, planar, gravity = int(rng.integers(1, 7)), bool(rng.uniform() < 0.25), bool(rng.uniform() < 0.5)
    structure = random_structure(
        rng,
        rods=rods,
        planar=planar,
        strings=int(rng.integers(2 * rods, 4 * rods + 2)),
        fixed_nodes=int(rng.integers(0, 3)),
    )
    oddity = rng.uniform()
    if oddity < 0.1:
        structure = _shortened(structure, length := log_uniform(rng, SHORTEST, 0.1))
        features = [f"a rod of {length:.1e} m"]
    elif oddity < 0.15 and not planar:
        structure = _tilted(structure, angle := log_uniform(rng, *TILT))
        features = [f"a rod {angle:.1e} from the pole"]
    else:
        features = []
    stiffness = log_uniform(rng, *STIFFNESS)
    ratio = 0.0 if rng.uniform() < 1 / 3 else log_uniform(rng, *RATIO)
    speed = log_uniform(rng, *SPEED)
    stretch = min(LARGEST_STRETCH, speed / math.sqrt(stiffness))
    least = 0.1 if rng.uniform() < 0.5 else -0.5  # of it: some strings begin slack
    lengths, M = structure.string_lengths(structure.positions), len(structure.strings)
    structure = structure.with_strings(
        stiffness=stiffness * rng.uniform(0.5, 1.0, M),
        damping=2 * ratio * math.sqrt(stiffness),
        rest_length=lengths * (1 - stretch * rng.uniform(least, 1.0, M)),
    )
    pull = tuple(9.81 * unit(rng.normal(size=3))) if gravity else (0.0, 0.0, 0.0)
    scene = Scene(structure, gravity=pull, name="random")
    spin = log_uniform(rng, *SPIN) if rng.uniform() < 0.5 else 0.0
    if spin:
        scene = scene.with_(initial_velocities=random_velocities(rng, structure, structure.positions, spin))
    rates = pace(scene)
    duration = log_uniform(rng, *TURNS) / max(rates.vibration, rates.spin, TURNS[0] / LONGEST)
    duration = float(f"{min(duration, LONGEST, DECAYS / max(rates.decay, 1e-300)):.3g}")
    pulled = speed / max(1.0, 2 * ratio)  # an overdamped rod creeps at the stretch times k / c
    distance = min(1.0, (spin + pulled) * duration + 5.0 * gravity * duration**2)
    features += [name for name, true in (("planar", planar), ("gravity", gravity)) if true]
    features += [f"damped {ratio:.2g} of critical"] * bool(ratio) + [f"spin {spin:.2g} rad/s"] * bool(spin)
    words = f"{rods} rods, {M} strings of {stiffness:.2g} N/m{''.join(', ' + one for one in features)}, {duration:g} s"
    return scene.with_(duration=duration), distance, words


def _eventful(rng: np.random.Generator, sort: str) -> tuple[Scene, float, str]:
    """Draw an experiment with events of one of `SORTS`."""
    rods = int(rng.integers(1, 4))
    law = StringLaw.UNCLIPPED if sort == "pushing" else StringLaw.CLIPPED
    structure = random_structure(
        rng,
        rods=rods,
        strings=int(rng.integers(2 * rods, 3 * rods + 2)),
        fixed_nodes=2,
        stiffness=(50.0, 500.0),
        damping=(0.0, 4.0) if rng.uniform() < 0.7 or sort == "pushing" else (0.0, 0.0),
        law=law,
    )
    strings = [_string_of(rng, structure, number, sort) for number in range(len(structure.strings))]
    structure = replace(structure, strings=tuple(strings))
    start = random_velocities(rng, structure, structure.positions, float(rng.uniform(0.3, 2.0)))
    scene = Scene(structure, gravity=(0.0, 0.0, -9.81), name="random", initial_velocities=start)
    uneven = 0.3 * float(rng.uniform() < 0.3)
    times = np.cumsum(rng.choice([0.04, 0.05, 0.07]) * (1.0 + uneven * rng.uniform(-1.0, 1.0, 30)))
    data = rng.normal(size=(30, 3))
    if sort == "moved":
        scene = scene.with_(motions=(Motion.data(structure.fixed_nodes[0], times, 0.02 * data),))
    elif sort == "shaken":
        scene = Ground(tuple(times.tolist()), tuple(map(tuple, (3.0 * data).tolist()))).shake(scene)
    duration = float(f"{rng.uniform(0.2, 0.8):.2f}")
    return scene.with_(duration=duration), 0.1, f"{sort}: {rods} rods, {len(strings)} strings, {duration:g} s"


def _string_of(rng: np.random.Generator, structure: Structure, number: int, sort: str) -> String:
    """A string of a structure, some with a curve, or over a fixed node, where events are of that sort."""
    string = structure.strings[number]
    changes: dict[str, Any] = {"tension": None, "force_density": None}
    changes["rest_length"] = float(structure.rest_lengths[number])
    free = [node for node in structure.fixed_nodes if node not in string.nodes]
    if sort in ("curved", "yielding") and rng.uniform() < 0.7:
        stretches, slopes = np.cumsum(rng.uniform(0.02, 0.1, 3)), string.stiffness * rng.uniform(0.3, 2.0, 3)
        slopes = np.minimum(slopes, slopes[0]) if sort == "yielding" else slopes
        tensions = np.cumsum(slopes * np.diff(stretches, prepend=0.0))
        curve = tuple(zip(stretches.tolist(), tensions.tolist(), strict=True))
        changes |= {"curve": curve, "yields": sort == "yielding", "stiffness": float(slopes[0])}
    elif sort == "pulleys" and free and rng.uniform() < 0.7:
        i, j = string.nodes
        nodes = (i, free[0], j)
        at = np.array([structure.nodes[node] for node in nodes])
        length = float(np.linalg.norm(np.diff(at, axis=0), axis=1).sum())
        changes |= {"nodes": nodes, "rest_length": length * float(rng.uniform(0.9, 1.05))}
    return replace(string, **changes)


def _shortened(structure: Structure, length: float) -> Structure:
    """The first rod that short [m], about its first node."""
    i, j = structure.rod_nodes[0]
    span = structure.positions[j] - structure.positions[i]
    return _with_second_node(structure, length * span / np.linalg.norm(span))


def _tilted(structure: Structure, angle: float) -> Structure:
    """The first rod at an angle [rad] from the vertical, where the ODE's angles have their pole."""
    rod = structure.rods[0]
    support = replace(rod.support, plane=None)  # its plane no longer holds it
    free = replace(structure, rods=(replace(rod, support=support), *structure.rods[1:]))
    return _with_second_node(free, structure.rod_lengths[0] * np.array([math.sin(angle), 0.0, math.cos(angle)]))


def _with_second_node(structure: Structure, span: Array) -> Structure:
    # No prestress to keep: it might leave no rest length at the new place.
    structure = structure.with_strings(rest_length=structure.string_lengths(structure.positions))
    i, j = structure.rods[0].nodes
    moved = np.array(structure.nodes[i]) + span
    x, y, z = moved.tolist()
    return replace(structure, nodes=dict(structure.nodes) | {j: (x, y, z)})
