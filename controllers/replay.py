"""Replay: recorded force densities or rest lengths, open loop.

The plain cross-model experiment, in which no law can hide a plant's error: what one engine did is done to the other.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import checked, member, positive
from tensegrity_mj.basics.kinds import flag
from tensegrity_mj.dynamics.native.compiling import c_function
from tensegrity_mj.dynamics.native.law import SOLVED, Command, NativeLaw
from tensegrity_mj.dynamics.native.pointers import LAW_SIGNATURE, floats
from tensegrity_mj.dynamics.native.views import view_of
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.runs.trajectory import Trajectory

_Record, _pack_record = view_of(
    "Replay",
    times=("f8", "time_count"),
    coefficients=("f8", "piece_count", "string_count", 4),  # of cubics from each time on, highest power first
)


@c_function(LAW_SIGNATURE, "the replay of a run")
def _replay(t, nodes_at, velocities_at, context, command_at, report_at):  # type: ignore[no-untyped-def]
    own = _Record(context)
    times, coefficients = own.times, own.coefficients
    out = floats(command_at, (own.string_count,))
    # A hair beyond a breakpoint counts as at it: sample times and breakpoints differ by round-off.
    piece = np.searchsorted(times, t + 1e-9 * (times[1] - times[0]), side="right") - 1
    piece = min(max(piece, 0), own.piece_count - 1)
    x = min(max(t, times[0]), times[own.time_count - 1]) - times[piece]
    for m in range(own.string_count):
        c = coefficients[piece, m]
        out[m] = c[3] + x * (c[2] + x * (c[1] + x * c[0]))
    return SOLVED


def cubics(times: Array, coefficients: Array, command: Command) -> NativeLaw:
    """The compiled law of `Cubics` of these."""
    packed = _pack_record(times=times, coefficients=coefficients)
    kinks = tuple(times.tolist())
    return NativeLaw(_replay.address, packed.address, (packed,), command=command, kinks=kinks, stateless=True)


class Cubics:
    """A law of time alone: cubics from each time on, with which values stand still before the first and after the last.

    Attributes:
        times: (T,) increasing [s], T >= 2.
        coefficients: (T, M, 4) or (T - 1, M, 4) in the time since each of these, highest power first.
        command: what they are.
    """

    times: Array
    coefficients: Array
    command: Command
    arrays = "tensegrity_mj.engines.jax.laws:cubic_law"

    def __call__(self, time: float, nodes: Array | None = None, velocities: Array | None = None) -> Array:
        """The values (M,) at a time [s]."""
        at = np.searchsorted(self.times, time + 1e-9 * (self.times[1] - self.times[0]), side="right") - 1
        piece = min(max(int(at), 0), len(self.coefficients) - 1)
        since = min(max(time, self.times[0]), self.times[-1]) - self.times[piece]
        return np.asarray(self.coefficients[piece] @ since ** np.array([3.0, 2.0, 1.0, 0.0]))

    def native(self, structure: Structure) -> NativeLaw:
        """The compiled law."""
        return cubics(self.times, self.coefficients, self.command)


class Replay(Cubics):
    """Values over time as a law: between the given times they are held, or follow a cubic spline.

    Args:
        times: (T,) increasing [s], T >= 2; before the first and after the last the values stand still.
        values: (T, M) force densities [N/m], not negative, or rest lengths [m], above zero.
        command: which of the two.
        held: values stand from each time to the next (what a sampled run did); such a replay jumps and runs
            sampled only. Otherwise they are interpolated by a not-a-knot cubic spline.
        period: the control period [s] that held values must be played with; None allows any.

    Raises:
        OptionError: for shapes that do not match, times that do not increase, or values that are not finite or that no
            winch can set.
    """

    def __init__(
        self,
        times: ArrayLike,
        values: ArrayLike,
        command: Command = Command.REST_LENGTH,
        held: bool = False,
        period: float | None = None,
    ) -> None:
        member("replay: command", command, Command)
        try:
            self.times, self.values = np.array(times, float), np.array(values, float)
        except (TypeError, ValueError, OverflowError):
            self.times, self.values = np.zeros(0), np.zeros(0)
        self.command = command
        self.held = checked("replay: held", held, flag())
        self.period = None if period is None else positive("replay: period", period, "s")
        if self.times.ndim != 1 or len(self.times) < 2 or self.values.ndim != 2 or len(self.values) != len(self.times):
            raise OptionError(
                f"replay: times of shape {self.times.shape} and values of shape {self.values.shape}; they must be "
                "numbers of shapes (T,) and (T, strings) with T >= 2"
            )
        if not np.all(np.diff(self.times) > 0) or not np.all(np.isfinite(self.times)):
            raise OptionError("replay: the times must be finite and increase")
        if not np.all(np.isfinite(self.values)):
            row, column = np.argwhere(~np.isfinite(self.values))[0]
            raise OptionError(
                f"replay: value {self.values[row, column]} of string number {column} at t = {self.times[row]} s; "
                "all values must be finite"
            )
        lengths = command is Command.REST_LENGTH
        bad = self.values <= 0 if lengths else self.values < 0
        if bad.any():
            row, column = np.argwhere(bad)[0]
            what, allowed = ("rest length", "> 0 m") if lengths else ("force density", ">= 0 N/m: a winch cannot push")
            raise OptionError(
                f"replay: {what} {self.values[row, column]:g} of string number {column} at t = {self.times[row]:g} s; "
                f"it must be {allowed}" + ("; where u >= k made it so, replay Command.FORCE_DENSITY" if lengths else "")
            )

    @classmethod
    def of_run(cls, run: Trajectory, command: Command = Command.REST_LENGTH) -> Replay:
        """Make a replay of a run. A sampled run is replayed held, and must have recorded every sample of what it held.

        Raises:
            OptionError: where the run held the other quantity, or recorded it too seldom.
        """
        values = run.rest_lengths if command is Command.REST_LENGTH else run.force_densities
        if run.scene.structure.ropes:  # each of them is one string to a law
            light = run.scene.structure.massless
            values, lengths = (
                np.stack([of(string.name) for string in light.strings], axis=1) for of in (run.rest_length, run.length)
            )
            if command is Command.FORCE_DENSITY:
                values = light.stiffness * (1 - values / lengths)
        actuation = run.provenance.get("actuation") or {}
        mode = actuation.get("mode", "continuous")
        if mode == "continuous":
            return cls(run.time, values, command)
        if mode != f"hold {command.value}":
            other = next(c for c in Command if c is not command)
            raise OptionError(
                f"replay: the run held its {other.value}, and its {command.value} jumps; replay Command.{other.name}"
            )
        spacing = float(np.max(np.diff(run.time), initial=0.0))
        if spacing > actuation["period"] * (1 + 1e-9):
            raise OptionError(
                f"replay: the run held its {command.value} for {actuation['period']:g} s but recorded it each "
                f"{spacing:g} s only; record it with output_interval = {actuation['period']:g}"
            )
        return cls(run.time, values, command, held=True, period=actuation["period"])

    @property
    def discontinuous(self) -> str:
        """Reason why it cannot run continuously; empty where the values are interpolated."""
        if not self.held:
            return ""
        return (
            "the replayed values are held between their times and jump there: run it sampled with the period they were "
            "recorded with (hold rest length or hold force density)"
        )

    def native(self, structure: Structure) -> NativeLaw:
        """The compiled law.

        Raises:
            OptionError: if the number of strings differs.
        """
        size = len(structure.strings)
        if self.values.shape[1] != size:
            raise OptionError(
                f"replay: values for {self.values.shape[1]} strings, but structure '{structure.name}' has {size}"
            )
        return replace(
            super().native(structure), discontinuous=self.discontinuous, period=self.period, until=float(self.times[-1])
        )

    @cached_property
    def coefficients(self) -> Array:  # type: ignore[override]
        """(T, M, 4) of held values, (T - 1, M, 4) of a spline through them."""
        if self.held:
            return np.pad(self.values[:, :, None], ((0, 0), (0, 0), (3, 0)))
        return np.ascontiguousarray(np.moveaxis(self._spline_of(slice(None)).c, 0, -1))

    def _spline_of(self, which: slice) -> Any:
        from scipy.interpolate import CubicSpline

        return CubicSpline(self.times[which], self.values[which], bc_type="not-a-knot")

    def interpolation_error(self) -> float:
        """Largest error at every second time of a spline through the others: an upper estimate of the spline's own."""
        if self.held or len(self.times) < 9:
            return 0.0
        sparse = self._spline_of(slice(None, None, 2))
        inside = self.times[1::2] <= self.times[::2][-1]
        return float(np.max(np.abs(sparse(self.times[1::2][inside]) - self.values[1::2][inside]), initial=0.0))

    def describe(self) -> dict[str, Any]:
        """Plain values for the provenance of a run."""
        return {
            "law": "replay",
            "command": self.command.value,
            "held": self.held,
            "samples": len(self.times),
            "until": float(self.times[-1]),
            "interpolation_error": self.interpolation_error(),
        }
