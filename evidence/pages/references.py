"""Compute the references of the benchmark pack: models/pack/NAME/reference.csv (docs/benchmark.md).

    .venv/bin/python -m evidence.pages.references [NAME...]

Each is the tightest run that there is. Its error bar is three times the largest of two differences: from a run at ten
times its tolerance, and from a second formulation. Three, because what one difference shows may be less than either
run is wrong by, and because a correct program adds an error of its own (FLOOR_FACTOR of studies/tradeoff/reference.py).
MuJoCo's RK4 at a fine step is listed, too; where it is no part of the bar, its difference is the error of its step.

In water it is the limit of many segments, by Richardson's extrapolation, and half as many segments stand for ten times
the tolerance. Second formulations are the ODE; for the closed loop of rods the DAE's one matrix of all coordinates and
multipliers; for the mass on a damped string flights and oscillations in closed form; and for the law, the contact and
the water the equations of docs/benchmark.md, written out here and integrated by SciPy. Nothing of the package is in
these: they show that another code can be written from the page.
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import tensegrity_mj as tmj

Array = NDArray[np.float64]

PACK = Path(__file__).resolve().parents[2] / "models" / "pack"
TIMES = 50  # after the start
RTOL = 1e-13
PERIOD = 0.02  # of the law's samples [s]
FACTOR = 3.0

# In one line each: what the scene is, for the pack's README.
ABOUT = {
    "free": "three rods and nine strings, off their equilibrium, fly and spin in free space",
    "pinned": "a rod on a ball joint between three strings, under gravity",
    "class_k": "four rods joined end to end in a closed loop hang from one corner, stretched by three strings",
    "slack": "a rod on a ball joint falls into two strings that are slack at first and again and again",
    "damped": "a prism of three rods and twelve strings hangs on three soft strings; all strings have dampers",
    "closed_loop": "a rod that tends to fall over is turned upright by a sampled law through two winches",
    "contact": "a rod on a hinge falls on a floor, bounces and settles",
    "water": "a moored rod below the surface of a wave and a current",
    "bounce": "a mass falls into a damped string and is thrown up, again and again, lower each time",
}


def upright_rod(rtol: float, mass: float = 1.0) -> Array:
    """The motion of `closed_loop`, tip (51, 3) [m]: one angle, and the law evaluated at each sample."""
    gravity, stiffness, least, frequency, damping = 9.81, 200.0, 2.0, 3.0, 0.7
    hooks, inertia, goal = np.array([[-0.8, 0.4], [1.0, 0.0]]), mass / 3, np.arctan2(-0.28, 0.96)

    def tip(angle: float) -> Array:
        return np.array([np.sin(angle), np.cos(angle)])

    def arms(angle: float) -> Array:
        """Moments of both strings' unit force densities [m²]."""
        return (hooks - tip(angle)) @ np.array([np.cos(angle), -np.sin(angle)])

    def lengths(angle: float) -> Array:
        return np.linalg.norm(hooks - tip(angle), axis=1)

    def sample(angle: float, rate: float) -> Array:
        """Rest lengths until the next sample."""
        wanted = inertia * (-(frequency**2) * (angle - goal) - 2 * damping * frequency * rate)
        needed, arm = wanted - mass * gravity / 2 * np.sin(angle), arms(angle)
        # Among all u >= least that give the moment, the one of least squares: both free, or either at its least.
        choices = [arm * needed / (arm @ arm)]
        for held in (0, 1):
            u = np.full(2, least)
            u[1 - held] = (needed - arm[held] * least) / arm[1 - held]
            choices.append(u)
        u = min((u for u in choices if u.min() >= least), key=np.linalg.norm)
        return lengths(angle) * (1 - u / stiffness)

    def rates(time: float, state: Array, rest: Array) -> list[float]:
        length = lengths(state[0])
        pull = np.maximum(0.0, stiffness * (length - rest)) / length
        return [state[1], (mass * gravity / 2 * np.sin(state[0]) + arms(state[0]) @ pull) / inertia]

    state, found = np.array([np.arctan2(0.6, 0.8), 0.0]), []
    for number in range(151):
        if number % 3 == 0:
            found.append(tip(state[0]))
        rest = sample(*state)
        state = solve_ivp(rates, (0, PERIOD), state, "DOP853", rtol=rtol, atol=rtol / 10, args=(rest,)).y[:, -1]
    return np.array([[x, 0.0, z] for x, z in found])


def bouncing_rod(rtol: float, mass: float = 1.0) -> Array:
    """The motion of `contact`, tip (51, 3) [m]: one angle above the horizontal, and docs/contact.md for one contact."""
    gravity, inertia, radius, height, hook, rest, pull = 9.81, mass / 3, 0.02, 0.5, (1.2, 1.5), 0.9, 5.0
    stiffness, brake, first, last, width, power = 1e4, 100.0, 0.9, 0.95, 0.001, 2

    def impedance(depth: float) -> float:
        part = min(depth / width, 1.0)
        shape = 0.5 * (2 * part) ** power if part <= 0.5 else 1 - 0.5 * (2 * (1 - part)) ** power
        return first + (last - first) * shape

    def rates(time: float, state: Array) -> list[float]:
        angle, rate = state
        lever = np.cos(angle)
        x, z = lever, height + np.sin(angle)
        span = np.array([hook[0] - x, hook[1] - z])
        length = float(np.linalg.norm(span))
        moment = max(0.0, pull * (length - rest)) / length * (lever * span[1] - np.sin(angle) * span[0])
        free = (moment - mass * gravity / 2 * lever) / inertia
        gap = z - radius
        if gap < 0:
            d = impedance(-gap)
            wanted = -brake / last * lever * rate - stiffness * d / last**2 * gap
            free = max(free, ((1 - d) * lever * free + d * wanted) / lever)
        return [rate, free]

    times = np.linspace(0, 2.0, TIMES + 1)
    # Steps so small that no touch is passed over.
    found = solve_ivp(rates, (0, 2.0), [0.0, 0.0], "DOP853", times, rtol=rtol, atol=rtol / 10, max_step=1e-3)
    return np.column_stack([np.cos(found.y[0]), np.zeros(TIMES + 1), 0.5 + np.sin(found.y[0])])


def moored_rod(rtol: float, mass: float = 1.0) -> Array:
    """The motion of `water`, a and b (51, 2, 3) [m]: the rod's centre and direction, Morison's loads along it.

    `mass` is a factor of the rod's.
    """
    gravity, density, depth, drag, radius = 9.81, 1025.0, 8.0, 1.2, 0.07
    amplitude, heading, k = 0.5, 0.5, 2 * np.pi / 20
    weight, ends = 10.0 * mass, np.array([[-1.0, 0.0, -5.0], [1.0, 0.2, -4.5]])
    beds = np.array([[-2, 1.5, -8], [-2, -1.5, -8], [2, 1.5, -8], [2, -1.5, -8.0]])
    side, stiffness, tension = np.array([0, 0, 1, 1]), 400.0, 60.0
    length = np.linalg.norm(ends[1] - ends[0])
    rest = np.linalg.norm(beds - ends[side], axis=1) - tension / stiffness
    frequency, way = np.sqrt(gravity * k * np.tanh(k * depth)), np.array([np.cos(heading), np.sin(heading), 0.0])
    # Gauss-Legendre points along the rod, in lengths from its centre, and their shares: the integrals of the page.
    places, shares = (column / 2 for column in np.polynomial.legendre.leggauss(24))
    piece = density * np.pi * radius**2 * length * shares  # the mass of water that a part displaces
    inertia = weight * length**2 / 12 + np.sum(piece * (places * length) ** 2)
    up, current = np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.2, 0.0])

    def rates(time: float, state: Array) -> Array:
        centre, n, speed, turn = state.reshape(4, 3)
        points, moves = centre + np.outer(places, length * n), speed + np.outer(places, length * turn)
        angle, height = frequency * time - k * points @ way, k * (points[:, 2] + depth)
        whole, part = np.cosh(height) / np.sinh(k * depth), np.sinh(height) / np.sinh(k * depth)
        water = frequency * amplitude * (np.outer(whole * np.sin(angle), way) + np.outer(part * np.cos(angle), up))
        gains = frequency**2 * amplitude * (np.outer(whole * np.cos(angle), way) - np.outer(part * np.sin(angle), up))
        slip = water + current - moves
        slip -= np.outer(slip @ n, n)
        loads = piece[:, None] * (2 * (gains - np.outer(gains @ n, n)) + gravity * up)
        loads += density * drag * radius * length * (shares * np.linalg.norm(slip, axis=1))[:, None] * slip
        force, moment = (
            loads.sum(axis=0) - weight * gravity * up,
            np.cross(np.outer(places, length * n), loads).sum(axis=0),
        )
        for arm, bed, slack in zip((side - 0.5) * length, beds, rest, strict=True):
            span = bed - centre - arm * n
            far = np.linalg.norm(span)
            pull = stiffness * max(0.0, far - slack) / far * span
            force, moment = force + pull, moment + np.cross(arm * n, pull)
        along = force @ n * n
        gain = along / weight + (force - along) / (weight + piece.sum())  # added mass acts across the rod alone
        return np.concatenate([speed, turn, gain, np.cross(moment, n) / inertia - turn @ turn * n])

    times = np.linspace(0, 10.0, TIMES + 1)
    start = np.concatenate([ends.mean(axis=0), (ends[1] - ends[0]) / length, np.zeros(6)])
    found = solve_ivp(rates, (0, 10.0), start, "DOP853", times, rtol=rtol, atol=rtol / 10).y.T
    half = length / 2 * found[:, 3:6]
    return np.stack([found[:, :3] - half, found[:, :3] + half], axis=1)


def bouncing_mass(rtol: float, mass: float = 1.0) -> Array:
    """The motion of `bounce`, mass (51, 3) [m]: flights and damped oscillations in closed form, joined."""
    gravity, stiffness, damping, rest = 9.81, 200.0, 2.0, 1.0
    times = np.linspace(0, 3.0, TIMES + 1)
    decay, level = damping / (2 * mass), mass * gravity / stiffness
    frequency = np.sqrt(stiffness / mass - decay**2)

    def flight(t: Any, s: float, v: float) -> Array:
        """Stretch beyond the rest length and its rate, which fall."""
        return np.array([s + v * t + gravity * t**2 / 2, v + gravity * t])

    def taut(t: Any, s: float, v: float) -> Array:
        a, b = s - level, (v + decay * (s - level)) / frequency
        c, d, fade = np.cos(frequency * t), np.sin(frequency * t), np.exp(-decay * t)
        rate = fade * ((b * frequency - a * decay) * c - (a * frequency + b * decay) * d)
        return np.array([level + fade * (a * c + b * d), rate])

    def pull(t: float, s: float, v: float) -> float:
        stretch, rate = taut(t, s, v)
        return float(stiffness * stretch + damping * rate)

    now, state, found = 0.0, (-0.5, 0.0), np.zeros((0, 3))
    while now < times[-1]:
        s, v = state
        pulls = s >= 0 and v > 0  # the string has just come taut
        if pulls:
            trial = np.linspace(1e-9, 2 * np.pi / frequency, 200)
            slack = next((k for k, t in enumerate(trial) if pull(t, s, v) < 0), None)
            length = np.inf if slack is None else brentq(pull, trial[slack - 1], trial[slack], (s, v), xtol=1e-15)
        else:
            assert s <= 0 or v**2 > 2 * gravity * s  # it flies above the rest length before it comes taut again
            length = (-v + np.sqrt(v**2 - 2 * gravity * s)) / gravity
        motion = taut if pulls else flight
        own = times[(times >= now) & (times < now + length)]
        heights = -rest - motion(own - now, s, v)[0]
        found = np.vstack([found, np.column_stack([0 * heights, 0 * heights, heights])])
        if length == np.inf:
            break
        now, state = now + length, tuple(motion(length, s, v))
        state = state if pulls else (0.0, state[1])
    return found


# Equations of motion of each scene, written by hand.
OWN: dict[str, tuple[Callable[..., Array], tuple[str, ...]]] = {
    "closed_loop": (upright_rod, ("tip",)),
    "contact": (bouncing_rod, ("tip",)),
    "water": (moored_rod, ("a", "b")),
    "bounce": (bouncing_mass, ("mass",)),
}


def simulated(name: str, engine: Any, segments: int = 0) -> Array:
    """Nodes (51, N, 3) of a run [m]; of so many segments of rods in water, in place of the scene's."""
    scene = tmj.load_scene(f"pack/{name}")
    law = tmj.controllers.from_scene(scene) if scene.control else None
    actuation = tmj.Actuation.hold_rest_length(PERIOD) if law else None
    if segments and scene.water is not None:
        scene = scene.with_(water=replace(scene.water, segments=segments))
    run = tmj.simulate(scene, law, engine, actuation=actuation, output_interval=scene.duration / TIMES)
    assert run.status is tmj.Status.COMPLETED
    return run.nodes


def by_own_equations(name: str, rtol: float = RTOL, mass: float = 1.0) -> Array:
    """Nodes (51, N, 3) of a scene by the equations of docs/benchmark.md; `mass` is a factor of the rod's."""
    motion, names = OWN[name]
    scene, moved = tmj.load_scene(f"pack/{name}"), motion(rtol, mass)
    nodes = np.repeat(scene.nodes0[None], len(moved), axis=0)
    nodes[:, [scene.structure.node_names.index(node) for node in names]] = moved.reshape(len(moved), -1, 3)
    return nodes


def second(name: str) -> tuple[str, Array]:
    """The second formulation: what it is, and its nodes."""
    if name in OWN:
        return "the equations of docs/benchmark.md, by SciPy", by_own_equations(name)
    if name == "class_k":
        engine = tmj.DAE(rtol=RTOL, atol=RTOL / 10, solver=tmj.engines.Solver.FULL)
        return "the DAE's one matrix of all coordinates and multipliers", simulated(name, engine)
    return "the ODE in minimal coordinates", simulated(name, tmj.ODE(rtol=RTOL, atol=RTOL / 10))


def reference(name: str) -> tuple[dict[str, Any], Array]:
    """Return the header of a reference, and its nodes (51, N, 3) [m]."""
    scene = tmj.load_scene(f"pack/{name}")
    interval = scene.duration / TIMES
    step = interval / (60 if name != "contact" else 40_000)
    beside = f"MuJoCo, RK4 at {step:.3g} s", simulated(name, tmj.MuJoCo(step))
    if name == "water":
        # Midpoints of segments err by the square of their length: the limit of many, by Richardson's extrapolation.
        coarse, middle, fine = (simulated(name, tmj.DAE(rtol=RTOL, atol=RTOL / 10), count) for count in (32, 64, 128))
        by = "the DAE, DOP853, the limit of 64 and 128 segments"
        nodes, looser, other = fine + (fine - middle) / 3, middle + (middle - coarse) / 3, second(name)
    else:
        by = "the DAE, DOP853"
        nodes, looser = (simulated(name, tmj.DAE(rtol=rtol, atol=rtol / 10)) for rtol in (RTOL, 10 * RTOL))
        other = second(name)
    less = "half as many segments" if name == "water" else "ten times the tolerance"
    runs = {less: looser, other[0]: other[1], beside[0]: beside[1]}
    differences = {words: float(f"{_largest(nodes - found):.2g}") for words, found in runs.items()}
    own = max(differences[less], differences[other[0]])
    facts: dict[str, Any] = {"scene": name, "about": ABOUT[name], "by": f"{by}, rtol = {RTOL:g}"}
    facts |= {"differences": differences, "error": float(f"{FACTOR * own:.2g}")}
    if scene.control:
        facts["actuation"] = f"--actuation hold-rest-length --control-period {PERIOD:g}"
    return facts, nodes


def _largest(differences: Array) -> float:
    return float(np.linalg.norm(differences, axis=-1).max())


def write(name: str) -> None:
    """Write the table of a scene."""
    import tomli_w

    facts, nodes = reference(name)
    scene = tmj.load_scene(f"pack/{name}")
    differences = facts.pop("differences")
    with (PACK / name / "reference.csv").open("w", encoding="utf-8", newline="") as file:
        for line in tomli_w.dumps(facts).splitlines():
            file.write(f"# {line}\n")
        for words, difference in differences.items():
            file.write(f"# from {words}: {difference:g} m\n")
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["time", *(f"{node}.{axis}" for node in scene.structure.node_names for axis in "xyz")])
        for number, row in enumerate(nodes.reshape(len(nodes), -1).tolist()):
            writer.writerow([number * scene.duration / TIMES, *row])
    print(name, facts["error"], differences)


if __name__ == "__main__":
    for chosen in sys.argv[1:] or sorted(ABOUT):
        write(chosen)
