"""The experiments of a study: open loop, closed loop, and what is held between control samples."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.jsontext import plain_values
from tensegrity_mj.basics.units import quantity
from tensegrity_mj.dynamics.native.law import NativeLaw
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.actuation import Actuation, Mode, whole_ratio
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.runs.convergence import way_of
from tensegrity_mj.studies.tradeoff.options import Loop, TradeoffOptions

MOST_INTERVAL, LEAST_ROWS = 0.1, 50  # s; of the recorded samples
STILL = 1e-6  # of the structure's extent: a motion below it is none
WORDS = {Mode.HOLD_FORCE_DENSITY: "force density held", Mode.HOLD_REST_LENGTH: "rest length held"}


@dataclass(frozen=True)
class Experiment:
    """One motion that settings are compared on.

    Attributes:
        scene: what is simulated.
        law: the law, or None.
        native: the same as a C function, for what it costs.
        actuation: between evaluations of the law.
        duration: [s].
        note: what a reader must know about it.
    """

    scene: Scene
    law: Any
    native: NativeLaw | None
    actuation: Actuation
    duration: float
    note: str = ""

    @property
    def loop(self) -> Loop:
        """With the law or without."""
        return Loop.OPEN if self.law is None else Loop.CLOSED

    @property
    def key(self) -> str:
        """A short name without spaces."""
        if self.law is None:
            return "open"
        mode = self.actuation.mode.value.replace(" ", "-")
        return mode if self.actuation.period is None else f"{mode}-{self.actuation.period:g}"

    @property
    def title(self) -> str:
        """For people."""
        if self.law is None:
            return "open loop"
        if self.actuation.period is None:
            return "closed loop, law at every stage"
        return f"closed loop, {WORDS[self.actuation.mode]} for {quantity(self.actuation.period, 's', 4)}"

    @property
    def interval(self) -> float:
        """Between recorded samples [s]."""
        return recording_interval(self.duration)

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        own = plain_values(self, "key", "title", "loop")
        how = {"actuation": self.actuation.mode.value, "period": self.actuation.period}
        return {**own, **how, **plain_values(self, "duration", "interval", "note")}


def recording_interval(duration: float) -> float:
    """Between recorded samples [s]: the largest of 0.1, 0.05, 0.02, 0.01, ... that divides the run into 50 or more.

    Where none down to a thousandth of the run divides it, its hundredth part.
    """
    for exponent in range(1, 13):
        for digit in (1.0, 0.5, 0.2):
            interval = float(f"{digit * 10.0**-exponent:.1e}")
            if interval * LEAST_ROWS > duration * (1 + 1e-9):
                continue
            if duration / interval > 1000 and interval < MOST_INTERVAL:
                return duration / 100
            if divides(duration, interval):
                return interval
    return duration / 100


def divides(time: float, step: float) -> bool:
    """Whether a time is a whole number of steps."""
    with contextlib.suppress(OptionError):
        return whole_ratio(time, step, "time over the step") > 0
    return False


def closed_loops(scene: Scene, law: Any, native: NativeLaw, options: TradeoffOptions) -> list[Experiment]:
    """The closed-loop experiments that are requested, the continuous one first."""
    total = scene.duration if options.duration is None else options.duration
    actuations = []
    for mode in options.actuations:
        if mode is Mode.CONTINUOUS:
            actuations.append(Actuation.continuous())
        else:
            actuations += [Actuation(mode, period) for period in options.periods]
    return [Experiment(scene, law, native, actuation, total) for actuation in actuations]


def open_loop(scene: Scene, options: TradeoffOptions, start: Mapping[str, Any] | None) -> Experiment:
    """The experiment without a law: from the scene's start, or from nodes and velocities that a run had at a time."""
    total = scene.duration if options.duration is None else options.duration
    if start is None:
        return Experiment(scene, None, None, Actuation.continuous(), total)
    note = (
        "Without a law nothing moves from the scene's own start. This run begins where the closed loop has the most "
        f"kinetic energy, at {start['time']:g} s, and from there on rest lengths are the structure's own."
    )
    moved = scene.with_(initial_nodes=start["nodes"], initial_velocities=start["velocities"])
    return Experiment(moved, None, None, Actuation.continuous(), total, note)


def stays(nodes: Array) -> bool:
    """Whether nothing moves that could be measured, of nodes (T, N, 3) [m]."""
    extent = np.linalg.norm(np.ptp(nodes[0], axis=0))  # the diagonal of their box at first
    return not way_of(nodes) > STILL * extent
