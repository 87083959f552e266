"""Which steps a run can have so that its duration, samples, control periods and breaks are multiples of them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.actuation import Mode
from tensegrity_mj.engines.run import DEFAULT_INTERVAL, Request
from tensegrity_mj.errors import OptionError
from tensegrity_mj.law import Command
from tensegrity_mj.structure import Structure

Array = NDArray[np.float64]

COARSEST = 0.1  # s; steps are begun with here, where nothing asks for less
FEWEST_STEPS = 20  # of the coarsest run
MANY = 4
AS_ONE = 1e-9  # relative: what `whole_ratio` takes for a multiple
FINEST = 1e-6  # of the duration: times whose common divisor is less have none


@dataclass(frozen=True)
class Steps:
    """Steps unit / k, k = 1, 2, 3, ...

    Attributes:
        unit: [s], the coarsest; every run records its multiples, so that any two runs can be compared.
        duration: [s].
        interval: [s] between samples where the caller asked for it, or None.
    """

    unit: float
    duration: float
    interval: float | None

    @classmethod
    def of(cls, request: Request, fastest: float) -> Steps:
        """The steps of a request.

        Args:
            fastest: [1/s] largest rate of the motion that is known; the coarsest step is 4 / fastest at most.

        Raises:
            OptionError: where duration, output interval, control period and breaks have no common divisor.
        """
        times = {"duration": request.duration}
        if request.output_interval is not None:
            times["output interval"] = request.output_interval
        if request.sampled:
            assert request.actuation.period is not None
            times["control period"] = request.actuation.period
        times |= {f"break of '{e.string}'": e.time for e in request.scene.breaks if 0 < e.time < request.duration}
        base = common_divisor(list(times.values()), request.duration)
        if base is None:
            shown = ", ".join(f"{name} {value:.12g} s" for name, value in times.items())
            raise OptionError(f"accuracy: no step divides all of {shown}; use round numbers")
        most = min(COARSEST, request.duration / FEWEST_STEPS, 4 / fastest if fastest > 0 else math.inf)
        return cls(base / max(1, math.ceil(base / most * (1 - AS_ONE))), request.duration, request.output_interval)

    def step(self, k: int) -> float:
        """[s]."""
        return self.unit / k

    def count(self, k: int) -> int:
        """Of the whole run."""
        return round(self.duration / self.unit) * k

    def divisions(self, step: float) -> int:
        """k of the coarsest step that is not coarser than this one [s]."""
        k = max(1, math.ceil(self.unit / step * (1 - AS_ONE)))
        # Many steps in a unit are a multiple of as many as make 0.01 s, so that samples can be that far apart.
        return k if k < MANY * self._samples else math.ceil(k / self._samples) * self._samples

    def recorded_each(self, k: int) -> float:
        """[s] between samples of the run with unit / k: about 0.01 s, a step at least, and multiples of unit hit."""
        if self.interval is not None:
            return self.interval
        if self.unit <= DEFAULT_INTERVAL:
            # Samples are counted from 0, and the unit divides the duration.
            return self.unit * math.floor(DEFAULT_INTERVAL / self.unit * (1 + AS_ONE))
        samples = next((m for m in range(self._samples, k) if k % m == 0), k)
        return self.step(k) * (k // samples)

    @property
    def _samples(self) -> int:
        """The least number of equal parts of a unit that are no longer than the usual interval."""
        return max(1, math.ceil(self.unit / DEFAULT_INTERVAL * (1 - AS_ONE)))


def common_divisor(times: list[float], duration: float) -> float | None:
    """The largest number of which all are multiples, by Euclid's algorithm; None if that is next to nothing."""
    divisor = times[0]
    for time in times[1:]:
        a, b = max(divisor, time), min(divisor, time)
        while b > AS_ONE * max(divisor, time):
            a, b = b, abs(a - round(a / b) * b)
        divisor = a
    # Remainders gather round-off: the divisor of the first time is exact.
    return None if divisor < FINEST * duration else times[0] / round(times[0] / divisor)


def known_rate(request: Request) -> float:
    """`fastest_rate` of a request at its start.

    A law in force densities sets the elastic tension itself, so that the strings' stiffness does not act.
    """
    law, scene = request.law, request.scene
    forces = (
        law.address and law.command is Command.FORCE_DENSITY and request.actuation.mode is not Mode.HOLD_REST_LENGTH
    )
    return fastest_rate(scene.structure, scene.nodes0, with_stiffness=not forces)


def fastest_rate(structure: Structure, nodes: Array, with_stiffness: bool) -> float:
    """Upper bound [1/s] of √λ(M⁻¹K) of the strings' stiffness and of λ(M⁻¹D) of their dampers, all strings taut.

    Free thin rods move most: an impulse at one end of a rod of mass m moves it by I/m + 3 (I - bbᵀ)/m, the other end by
    I/m - 3 (I - bbᵀ)/m. Supports only take freedom away, and cannot raise a frequency (Cauchy's interlacing). By power
    iteration from a start that is the same each time; good to some percent, enough to begin with.
    """
    pairs = structure.string_nodes
    if not len(pairs):
        return 0.0
    span = nodes[pairs[:, 1]] - nodes[pairs[:, 0]]
    along = span / np.maximum(np.linalg.norm(span, axis=1), 1e-300)[:, None]
    rods = structure.rod_nodes
    axes = nodes[rods[:, 1]] - nodes[rods[:, 0]]
    b = axes / np.maximum(np.linalg.norm(axes, axis=1), 1e-300)[:, None]
    masses = structure.rod_masses[:, None]
    points = [(structure.node_index[point.node], point.mass) for point in structure.point_masses]

    def moved(forces: Array) -> Array:
        out = np.zeros_like(forces)
        if len(rods):
            first, second = forces[rods[:, 0]], forces[rods[:, 1]]
            across = second - first
            across = across - b * np.sum(across * b, axis=1, keepdims=True)
            mean = (first + second) / masses
            out[rods[:, 0]] = mean - 3 * across / masses
            out[rods[:, 1]] = mean + 3 * across / masses
        for row, mass in points:
            out[row] = forces[row] / mass
        return out

    def largest(weights: Array) -> float:
        root = np.sqrt(weights)[:, None] * along
        x, value = np.cos(np.arange(len(pairs)) + 1.0), 0.0  # of no string's pattern
        for _ in range(40):
            x = x / max(float(np.linalg.norm(x)), 1e-300)
            forces = np.zeros_like(nodes)
            np.add.at(forces, pairs[:, 1], root * x[:, None])
            np.add.at(forces, pairs[:, 0], -root * x[:, None])
            motion = moved(forces)
            x = np.sum(root * (motion[pairs[:, 1]] - motion[pairs[:, 0]]), axis=1)
            value = float(np.linalg.norm(x))
        return value

    rate = largest(structure.damping) if np.any(structure.damping) else 0.0
    return max(rate, math.sqrt(largest(structure.stiffness))) if with_stiffness else rate
