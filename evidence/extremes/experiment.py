"""Experiments of extreme runs, and draws that all kinds share."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from evidence.extremes import laws
from evidence.random_structures import random_structure
from tensegrity_mj.basics.arrays import Array, unit
from tensegrity_mj.model.actuation import Mode, OnInfeasible
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure

Rng = np.random.Generator


@dataclass(frozen=True)
class Experiment:
    """Experiment that is to be run, without its engine and its step.

    Attributes:
        scene: the scene.
        law: makes the law for a run of a given duration [s], or None.
        mode: of the actuation.
        on_infeasible: see `simulate`.
        rate: a rate that the law adds to those of the scene [1/s].
        force_density: largest u that the law commands [N/m].
        excess: the step as a multiple of the stability limit, or None where it is drawn well below it.
        cycles: range of durations, in fastest vibrations.
        steps: exactly so many steps, or None.
        engines: names of engines that are drawn from, or none for all that take the scene.
        facts: what was drawn, as text.
    """

    scene: Scene
    law: Callable[[float], Any] | None = None
    mode: Mode = Mode.CONTINUOUS
    on_infeasible: OnInfeasible = OnInfeasible.STOP
    rate: float = 0.0
    force_density: float = 0.0
    excess: float | None = None
    cycles: tuple[float, float] = (1.0, 30.0)
    steps: int | None = None
    engines: tuple[str, ...] = ()
    facts: dict[str, Any] = field(default_factory=dict)


# Strings that pull at any length draw a structure into itself, and it moves chaotically from then on, where no
# estimate of an error settles: such runs are short.
COLLAPSE = (0.3, 10.0)


def maybe_driven(rng: Rng, scene: Scene, facts: dict[str, Any]) -> Experiment:
    """A third of the scenes are driven by a smooth law about their own prestress."""
    constant = any(string.is_constant for string in scene.structure.strings)  # which no law commands
    if rng.uniform() > 1 / 3 or not scene.structure.strings or constant:
        return Experiment(scene, facts=facts | {"law": "none"})
    structure = scene.structure.massless  # as laws see it
    lengths = structure.string_lengths(structure.positions)
    u = structure.stiffness * np.abs(lengths - structure.rest_lengths) / lengths
    depth, beat = float(rng.uniform(0.1, 1.5)), float(rng.uniform(0.5, 5.0))

    def law(duration: float) -> laws.Waving:
        return laws.Waving(u, depth, beat * 2 * math.pi / duration)

    return Experiment(
        scene,
        law,
        Mode.CONTINUOUS,
        force_density=float(u.max()) * (1 + depth),
        facts=facts | {"law": f"waving, depth {depth:.2g}"},
    )


def ordinary(rng: Rng, **changes: Any) -> Structure:
    """A random structure of one to four rods that share no node; `changes` are options of `random_structure`."""
    options: dict[str, Any] = {"rods": int(rng.integers(1, 5)), "planar": bool(rng.integers(2)), "stretch": (0.05, 0.4)}
    return random_structure(rng, **options | changes)


def direction(rng: Rng, size: int = 3) -> Array:
    """A unit vector, all directions equally likely."""
    return unit(rng.normal(size=size))
