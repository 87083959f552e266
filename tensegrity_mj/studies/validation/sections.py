"""Cases of each section of the report, as points for `task.run_point`."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.files import table_beside
from tensegrity_mj.controllers import specs
from tensegrity_mj.controllers.table import LAWS
from tensegrity_mj.dynamics.native.law import native_law
from tensegrity_mj.engines.table import ENGINES, option_names
from tensegrity_mj.model.actuation import Mode
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure

TABLE = table_beside(__file__)
SECTIONS: dict[str, str] = TABLE["sections"]
FULL = TABLE["full"]
OFF = 0.2  # part by which masses and stiffnesses are off
TIGHT = {"rtol": 1e-12, "atol": 1e-13}  # of the error-controlled methods

UNDER_TEST = "under test"
SIDE_BY_SIDE: dict[str, dict[str, Any]] = TABLE["side_by_side"]


@dataclass(frozen=True)
class Extent:
    """Extent of the report; `quick()` is what a test can afford."""

    periods: Sequence[float] = tuple(FULL["periods"])
    factors: Mapping[str, Sequence[float]] = field(default_factory=lambda: FULL["factors"])
    rates: Sequence[float] = tuple(FULL["rates"])
    random_plants: int = FULL["random_plants"]
    noise: Sequence[float] = tuple(FULL["noise"])
    delays: Sequence[int] = tuple(FULL["delays"])
    broken: int = FULL["broken"]
    gravity: Sequence[float] = tuple(FULL["gravity"])
    map_starts: int = FULL["map_starts"]
    amplitudes: Sequence[float] = tuple(FULL["amplitudes"])
    starts: int = FULL["starts"]

    @classmethod
    def quick(cls) -> Extent:
        """A few points of each section."""
        return cls(**TABLE["quick"])


@dataclass(frozen=True)
class Setup:
    """Settings that all sections share.

    Attributes:
        scene, law: under test.
        engines: names of `engines.table.ENGINES`.
        duration, timestep, period: of the runs, of RK4, of the control samples where a run must be sampled [s].
        seed: of everything random.
        extent: how much is run.
    """

    scene: Scene
    law: Any
    engines: Sequence[str]
    duration: float
    timestep: float
    period: float
    seed: int
    extent: Extent

    @property
    def continuous(self) -> bool:
        """True where the law may be evaluated at every stage."""
        return not getattr(self.law, "discontinuous", "")

    def fixed_step(self, engine: str, step: float) -> dict[str, Any]:
        """The classical Runge-Kutta method of an engine."""
        return {**ENGINES[engine].fixed_step, "timestep": step}

    def sampled(self, engine: str, mode: Mode, period: float) -> dict[str, Any]:
        """A run whose law is sampled; its step divides the period."""
        step = period / math.ceil(period / self.timestep * (1 - 1e-9))
        options = self.fixed_step(engine, step)
        return {"engine": engine, "engine_options": options, "mode": mode.value, "period": period}

    def usual(self, engine: str) -> dict[str, Any]:
        """Continuous where the law may be, else force densities held for the control period; with fixed steps."""
        if self.continuous:
            return {"engine": engine, "engine_options": self.fixed_step(engine, self.timestep)}
        return self.sampled(engine, Mode.HOLD_FORCE_DENSITY, self.period)

    def generator(self, *keys: int) -> np.random.Generator:
        """Random numbers that depend on the seed and the keys alone."""
        return np.random.default_rng([self.seed, *keys])


@dataclass(frozen=True)
class Case:
    """One run: where it belongs, what it is (for tables), and its point."""

    section: str
    label: str
    point: dict[str, Any]
    facts: dict[str, Any] = field(default_factory=dict)


def cases(setup: Setup, chosen: Sequence[str]) -> list[Case]:
    """All runs of the chosen sections, and the nominal ones, in every engine."""
    makers = {
        "sampling": _sampling,
        "gains": _gains,
        "mass": _mass,
        "stiffness": _stiffness,
        "noise": _noise,
        "delay": _delay,
        "breaks": _breaks,
        "gravity": _gravity,
        "starts": _starts,
    }
    found: list[Case] = []
    for engine in setup.engines:
        found += _nominal(setup, engine)
        for name, maker in makers.items():
            if name in chosen:
                found += maker(setup, engine)
    return found


def _nominal(setup: Setup, engine: str) -> Iterator[Case]:
    point = setup.usual(engine)
    if setup.continuous and set(TIGHT) <= set(option_names(engine)):
        point = {"engine": engine, "engine_options": TIGHT}
    yield Case("nominal", "nominal", point | {"keep_nodes": True})


def _sampling(setup: Setup, engine: str) -> Iterator[Case]:
    if setup.continuous:
        yield Case(
            "sampling", "continuous", setup.usual(engine) | {"keep_nodes": True}, {"mode": Mode.CONTINUOUS.value}
        )
    for mode in (Mode.HOLD_FORCE_DENSITY, Mode.HOLD_REST_LENGTH):
        for period in setup.extent.periods:
            point = setup.sampled(engine, mode, period) | {"keep_nodes": True}
            yield Case("sampling", f"{mode.value}, {1e3 * period:g} ms", point, {"mode": mode.value, "period": period})


def _gains(setup: Setup, engine: str) -> Iterator[Case]:
    if not specs.has_gains(setup.law):
        return
    scans = {**setup.extent.factors, **({"decay_rate": setup.extent.rates} if setup.extent.rates else {})}
    for gain, factors in scans.items():
        for factor in factors:
            point = setup.usual(engine) | {"gain": [gain, factor]}
            name = "δ" if gain == "decay_rate" else gain
            yield Case("gains", f"{name} × {factor:g}", point, {"gain": gain, "factor": factor})


def _mass(setup: Setup, engine: str) -> Iterator[Case]:
    structure = setup.scene.structure
    members = {f"rods[{rod.name}].mass": rod.mass for rod in structure.rods}
    members |= {f"point_masses[{point.node}].mass": point.mass for point in structure.point_masses}
    yield from _off(setup, engine, "mass", members, 1)


def _stiffness(setup: Setup, engine: str) -> Iterator[Case]:
    members = {f"strings[{string.name}].stiffness": string.stiffness for string in setup.scene.structure.strings}
    yield from _off(setup, engine, "stiffness", members, 2)


def _off(setup: Setup, engine: str, section: str, numbers: Mapping[str, float], key: int) -> Iterator[Case]:
    """All these numbers of members off by ±20 %, and each by a random part of it."""
    off: list[tuple[str, list[float], dict[str, Any]]] = []
    if numbers:
        off += [(f"all × {f:g}", [f] * len(numbers), {"factor": f}) for f in (1 - OFF, 1 + OFF)]
    for draw in range(setup.extent.random_plants if len(numbers) > 1 else 0):
        factors = setup.generator(key, draw).uniform(1 - OFF, 1 + OFF, len(numbers)).tolist()
        off.append((f"each by up to ±{100 * OFF:.0f} %, draw {draw + 1}", factors, {"factors": factors}))
    for label, factors, facts in off:
        pairs = zip(numbers.items(), factors, strict=True)
        settings = {f"plant.{path}": value * factor for (path, value), factor in pairs}
        yield Case(section, label, setup.usual(engine) | {"settings": settings}, facts)


def _noise(setup: Setup, engine: str) -> Iterator[Case]:
    base = setup.sampled(engine, Mode.HOLD_FORCE_DENSITY, setup.period)
    for std in setup.extent.noise:
        for label, pair in (
            (f"positions {std:g} m", (std, 0.0)),
            (f"velocities {10 * std:g} m/s", (0.0, 10 * std)),
            (f"positions {std:g} m and velocities {10 * std:g} m/s", (std, 10 * std)),
        ):
            facts = {"position_std": pair[0], "velocity_std": pair[1]}
            yield Case("noise", label, base | {"noise": [*pair, setup.seed]}, facts)


def _delay(setup: Setup, engine: str) -> Iterator[Case]:
    base = setup.sampled(engine, Mode.HOLD_FORCE_DENSITY, setup.period)
    for samples in setup.extent.delays:
        facts = {"samples": samples, "time": samples * setup.period}
        yield Case("delay", f"{samples} × {1e3 * setup.period:g} ms", base | {"delay": samples}, facts)


def _breaks(setup: Setup, engine: str) -> Iterator[Case]:
    names = [string.name for string in setup.scene.structure.strings]
    count = min(len(names), setup.extent.broken)
    time = 0.01 * max(1, round(0.1 * setup.duration / 0.01))
    for number in sorted({round(i) for i in np.linspace(0, len(names) - 1, count)}):
        point = setup.usual(engine) | {"settings": {f"plant.breaks[{names[number]}].time": time}}
        yield Case("breaks", f"{names[number]} at {time:g} s", point, {"string": names[number], "time": time})


def _gravity(setup: Setup, engine: str) -> Iterator[Case]:
    now = np.array(setup.scene.gravity)
    if np.any(now):
        levels = [(f"× {factor:g}", now * factor) for factor in (0.0, 1 - OFF, 1 + OFF)]
    else:
        levels = [(f"{g:g} m/s²", np.array([0.0, 0.0, -g])) for g in setup.extent.gravity]
    for label, vector in levels:
        for known in (False, True) if specs.has_option(setup.law, "gravity") else (False,):
            facts = {"gravity": vector.tolist(), "known_to_the_law": known}
            text = f"{label}, {'known' if known else 'unknown'} to the law"
            point = setup.usual(engine) | {"settings": {"plant.gravity": vector.tolist()}}
            yield Case("gravity", text, point | ({"known_gravity": vector.tolist()} if known else {}), facts)


# --------------------------------------------------------------------------------------------------- initial states


def is_pinned_rod(structure: Structure) -> bool:
    """Return whether one rod, pinned in space, is all that moves: its states at rest are then a sphere."""
    if len(structure.rods) != 1 or structure.point_masses:
        return False
    support = structure.rods[0].support
    return len(support.directions) == 3 and support.plane is None


def _starts(setup: Setup, engine: str) -> Iterator[Case]:
    if is_pinned_rod(setup.scene.structure) and setup.scene.target is not None:
        yield from _map(setup, engine)
        return
    for level, amplitude in enumerate(setup.extent.amplitudes):
        for draw in range(setup.extent.starts):
            nodes = perturbed(setup.scene, amplitude, setup.generator(3, level, draw))
            facts = {"amplitude": amplitude, "draw": draw}
            point = setup.usual(engine) | {"nodes": nodes.tolist()}
            yield Case("starts", f"amplitude {amplitude:g}, draw {draw + 1}", point, facts)


def _map(setup: Setup, engine: str) -> Iterator[Case]:
    """The pinned rod, at rest in random directions, under this law and the thesis' laws side by side."""
    directions = setup.generator(4).normal(size=(setup.extent.map_starts, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    control = setup.scene.control
    under_test = native_law(setup.law, setup.scene.structure).description
    compared: dict[str, Any] = {UNDER_TEST: None}  # None stands for the law under test
    for name, spec in SIDE_BY_SIDE.items():
        if control is None or control.law not in LAWS:
            # The scene says nothing of them: e^-9 of V(0) is left at the end, as in §5.4.
            spec = spec | {"options": {**spec["options"], "decay_rate": 9.0 / setup.duration}}
        law = specs.make(spec, setup.scene)
        if native_law(law, setup.scene.structure).description == under_test:
            compared = {(f"{name} ({UNDER_TEST})" if key == UNDER_TEST else key): own for key, own in compared.items()}
        elif setup.continuous or not law.discontinuous:
            compared[name] = spec
    for name, spec in compared.items():
        for draw, b in enumerate(directions):
            nodes = turned(setup.scene, b)
            facts = {"law": name, "draw": draw, "direction": b.tolist()}
            point = setup.usual(engine) | {"nodes": nodes.tolist(), "law": spec}
            yield Case("starts", f"{name}, draw {draw + 1}", point, facts)


def turned(scene: Scene, b: Array) -> Array:
    """Nodes (N, 3) of a scene with one pinned rod, turned into direction b."""
    structure = scene.structure
    nodes = scene.nodes0.copy()
    (i, j), sigma, length = structure.rod_nodes[0], structure.rods[0].support.sigma, structure.rod_lengths[0]
    pivot = (1 - sigma) * nodes[i] + sigma * nodes[j]
    nodes[i], nodes[j] = pivot - sigma * length * b, pivot + (1 - sigma) * length * b
    return nodes


def perturbed(scene: Scene, amplitude: float, generator: np.random.Generator) -> Array:
    """Nodes (N, 3) of a start with every rod turned by `amplitude` [rad] about a random axis and moved by that part of
    the mean rod length (of the spread of nodes where there are no rods) in a random direction, within its support."""
    structure = scene.structure
    nodes = scene.nodes0.copy()
    size = float(structure.rod_lengths.mean() if len(structure.rods) else np.ptp(nodes, axis=0).max())
    for a, rod in enumerate(structure.rods):
        i, j = structure.rod_nodes[a]
        sigma, length = rod.support.sigma, structure.rod_lengths[a]
        b = (nodes[j] - nodes[i]) / length
        r = (1 - sigma) * nodes[i] + sigma * nodes[j]
        turn = rod.support.rotation_basis
        across = turn @ generator.normal(size=turn.shape[1])
        across -= b * (b @ across)
        b = math.cos(amplitude) * b + math.sin(amplitude) * across / np.linalg.norm(across)
        b /= np.linalg.norm(b)
        r = r + _moved(rod.support.translation_basis, amplitude * size, generator)
        nodes[i], nodes[j] = r - sigma * length * b, r + (1 - sigma) * length * b
    for point in structure.lone_masses:
        row = structure.node_index[point.node]
        nodes[row] += _moved(point.translation_basis, amplitude * size, generator)
    return nodes


def _moved(basis: Array, distance: float, generator: np.random.Generator) -> Array:
    direction = generator.normal(size=basis.shape[1])
    length = float(np.linalg.norm(direction))
    return np.asarray(basis @ direction * (distance / length)) if length > 0 else np.zeros(3)
