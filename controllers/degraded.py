"""Imperfect loops: the measurement noise and the delay of a real loop, around any law, compiled or Python.

`Noisy` measures nodes with normally distributed errors, `Delayed` answers some samples late. Both belong to a control
period and run sampled. Both depend on the number of the sample alone, not on the engine nor on how often they are
called, so that runs in different engines stay comparable. They can be nested.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import checked, positive
from tensegrity_mj.basics.jsontext import plain_values
from tensegrity_mj.basics.kinds import not_negative, whole
from tensegrity_mj.dynamics.native.compiling import c_function, njit
from tensegrity_mj.dynamics.native.law import (
    FAILED,
    NO_SOLUTION,
    WITHIN,
    Command,
    NativeLaw,
    Report,
    native_law,
    wrapped,
)
from tensegrity_mj.dynamics.native.pointers import LAW_SIGNATURE, address, call_law, floats
from tensegrity_mj.dynamics.native.views import Table, view_of
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.structure import Structure

NOISY = "sensor noise is drawn anew for each control sample: run it sampled (hold force density or hold rest length)"
DELAYED = "its delay is counted in control samples: run it sampled (hold force density or hold rest length)"
REPORT_SIZE = len(Report)
HALF = np.uint64(0xFFFFFFFF)
SHIFT = np.uint64(32)


@njit
def _high(a: Any, b: Any) -> Any:
    """The upper 64 of the 128 bits of a product."""
    a0, a1, b0, b1 = a & HALF, a >> SHIFT, b & HALF, b >> SHIFT
    middle = a1 * b0 + ((a0 * b0) >> SHIFT)
    return a1 * b1 + (middle >> SHIFT) + (((middle & HALF) + a0 * b1) >> SHIFT)


@njit
def philox(counter0: Any, counter1: Any, key0: Any, key1: Any, out: Any) -> None:
    """Philox4x64-10: four random 64-bit integers of a counter and a key, into out (4,) uint64.

    J. K. Salmon, M. A. Moraes, R. O. Dror, D. E. Shaw: Parallel random numbers: as easy as 1, 2, 3. SC'11.
    """
    x0, x1, x2, x3 = np.uint64(counter0), np.uint64(counter1), np.uint64(0), np.uint64(0)
    k0, k1 = np.uint64(key0), np.uint64(key1)
    m0, m1 = np.uint64(0xD2E7470EE14C6C93), np.uint64(0xCA5A826395121157)
    for _ in range(10):
        high0, low0, high1, low1 = _high(m0, x0), m0 * x0, _high(m1, x2), m1 * x2
        x0, x1, x2, x3 = high1 ^ x1 ^ k0, low1, high0 ^ x3 ^ k1, low0
        k0 += np.uint64(0x9E3779B97F4A7C15)
        k1 += np.uint64(0xBB67AE8584CAA73B)
    out[0], out[1], out[2], out[3] = x0, x1, x2, x3


@njit
def add_noise(values: Any, std: float, moving: Any, sample: int, stream: int, seed: int) -> None:
    """Add std times standard normal numbers to the moving rows of values (N, 3), by Box and Muller.

    A row's numbers depend on the seed, the sample, the stream and the number of the row alone.
    """
    bits = np.empty(4, np.uint64)
    for row in range(len(values)):
        if not moving[row]:
            continue
        philox(sample, 2 * row + stream, seed, 0, bits)
        for pair in range(2):
            # Uniform in (0, 1] and in [0, 1).
            first = (float(bits[2 * pair] >> np.uint64(11)) + 1.0) * 2.0**-53
            turn = 2.0 * math.pi * float(bits[2 * pair + 1] >> np.uint64(11)) * 2.0**-53
            radius = std * math.sqrt(-2.0 * math.log(first))
            values[row, 2 * pair] += radius * math.cos(turn)
            if pair == 0:
                values[row, 1] += radius * math.sin(turn)


_NoisyView, _pack_noisy = view_of(
    "NoisyLaw",
    **WITHIN,
    seed="size",
    period="real",
    position_std="real",
    velocity_std="real",
    nodes=("f8", "node_count", 3),  # as measured
    velocities=("f8", "node_count", 3),
    moving=("i8", "node_count"),  # 0 for fixed nodes
)
_DelayedView, _pack_delayed = view_of(
    "DelayedLaw",
    **WITHIN,
    slots="size",  # samples of delay, and one
    period="real",
    # By the number of a sample modulo slots: that number, and what the law answered.
    numbers=("i8", "slots"),
    statuses=("i8", "slots"),
    commands=("f8", "slots", "string_count"),
    reports=("f8", "slots", REPORT_SIZE),
)


@c_function(LAW_SIGNATURE, "sensor noise")
def _noisy(t, nodes_at, velocities_at, context, command, report):  # type: ignore[no-untyped-def]
    own = _NoisyView(context)
    nodes, velocities = own.nodes, own.velocities
    nodes[:] = floats(nodes_at, (own.node_count, 3))
    velocities[:] = floats(velocities_at, (own.node_count, 3))
    sample = round(t / own.period)
    add_noise(nodes, own.position_std, own.moving, sample, 0, own.seed)
    add_noise(velocities, own.velocity_std, own.moving, sample, 1, own.seed)
    return call_law(own.law, t, address(nodes), address(velocities), own.context, command, report)


@c_function(LAW_SIGNATURE, "a law's delay")
def _delayed(t, nodes, velocities, context, command_at, report_at):  # type: ignore[no-untyped-def]
    own = _DelayedView(context)
    slots, numbers, statuses, commands, reports = own.slots, own.numbers, own.statuses, own.commands, own.reports
    command, report = floats(command_at, (own.string_count,)), floats(report_at, (REPORT_SIZE,))
    sample = round(t / own.period)
    now = sample % slots
    status = call_law(own.law, t, nodes, velocities, own.context, command_at, report_at)
    if status > NO_SOLUTION:
        return status
    numbers[now], statuses[now], commands[now], reports[now] = sample, status, command, report
    wanted = max(sample - slots + 1, 0)
    then = wanted % slots
    if numbers[then] != wanted:
        return FAILED
    command[:] = commands[then]
    report[:] = reports[then]
    return statuses[then]


class _Sampled:
    """Base of the imperfect loops: the law within, and its control period."""

    law: Any
    period: float
    discontinuous: str

    @property
    def command(self) -> Command:
        """Quantity that the law within returns."""
        return getattr(self.law, "command", Command.FORCE_DENSITY)

    def _wrapped(self, inner: NativeLaw, function: Any, packed: Table) -> NativeLaw:
        """Wrap the law within in a compiled function whose context is `packed`."""
        return replace(
            wrapped(inner, function, packed),
            discontinuous=self.discontinuous,
            period=self.period,
            decay_rate=None,
            stateless=False,
        )


class Noisy(_Sampled):
    """A law that measures node positions and velocities with independent, normally distributed errors.

    Nodes that are fixed in space have none. The errors are drawn at each control sample, from a generator whose
    numbers depend on the seed and the sample alone (Philox4x64-10).

    Args:
        law: any law.
        position_std: standard deviation of each coordinate [m], >= 0.
        velocity_std: the same of velocities [m/s].
        seed: an integer >= 0.
        period: period of the control samples [s]; the run must have the same.

    Raises:
        OptionError: for values out of range.
    """

    discontinuous = NOISY

    def __init__(self, law: Any, position_std: float, velocity_std: float, seed: int, period: float) -> None:
        self.law = law
        self.position_std: float = checked("Noisy: position_std", position_std, not_negative("m"))
        self.velocity_std: float = checked("Noisy: velocity_std", velocity_std, not_negative("m/s"))
        self.seed: int = checked("Noisy: seed", seed, whole(0, 2**63 - 1))
        self.period = positive("Noisy: period", period, "s")

    def measured(self, time: float, nodes: ArrayLike, velocities: ArrayLike, fixed: Any = ()) -> tuple[Array, Array]:
        """Positions and velocities (N, 3) as measured; rows in `fixed` without errors."""
        positions, rates = np.array(nodes, float), np.array(velocities, float)
        moving = np.ones(len(positions), np.int64)
        moving[list(fixed)] = 0
        sample = round(time / self.period)
        add_noise(positions, self.position_std, moving, sample, 0, self.seed)
        add_noise(rates, self.velocity_std, moving, sample, 1, self.seed)
        return positions, rates

    def __call__(self, time: float, nodes: Array, velocities: Array) -> ArrayLike:
        """The law's command for what is measured, every node with errors."""
        value: ArrayLike = self.law(time, *self.measured(time, nodes, velocities))
        return value

    def native(self, structure: Structure) -> NativeLaw:
        """The law for a plant, compiled."""
        inner = _inner(self.law, structure, self.period)
        count = len(structure.nodes)
        moving = np.array([name not in structure.fixed_nodes for name in structure.node_names], np.int64)
        packed = _pack_noisy(
            law=inner.address,
            context=inner.context,
            seed=self.seed,
            period=self.period,
            position_std=self.position_std,
            velocity_std=self.velocity_std,
            nodes=np.zeros((count, 3)),
            velocities=np.zeros((count, 3)),
            moving=moving,
        )
        return self._wrapped(inner, _noisy, packed)

    def describe(self) -> dict[str, Any]:
        """Plain values for the provenance of a run."""
        own = plain_values(self, "position_std", "velocity_std", "seed", "period")
        return {"law": "noisy", "of": _description(self.law), **own}


class Delayed(_Sampled):
    """A law whose commands, with their reports, come some control samples late.

    At sample n the answer is that of sample n - `samples`. Until the first has come through it is that of sample 0: the
    structure is taken to have stood at its start before.

    Args:
        law: any law.
        samples: the delay, an integer >= 0.
        period: period of the control samples [s]; the run must have the same.

    Raises:
        OptionError: for values out of range.
    """

    discontinuous = DELAYED

    def __init__(self, law: Any, samples: int, period: float) -> None:
        self.law = law
        self.samples: int = checked("Delayed: samples", samples, whole(0))
        self.period = positive("Delayed: period", period, "s")
        self._commands: dict[int, ArrayLike] = {}

    def __call__(self, time: float, nodes: Array, velocities: Array) -> ArrayLike:
        """The command of an earlier sample; to be called at every sample, from 0 on.

        Raises:
            OptionError: if the earlier sample was left out.
        """
        sample = round(time / self.period)
        if sample == 0:
            self._commands.clear()
        self._commands[sample] = self.law(time, nodes, velocities)
        wanted = max(sample - self.samples, 0)
        if wanted not in self._commands:
            raise OptionError(f"Delayed: sample {wanted} was left out; call the law at every sample, from 0 on")
        for old in [number for number in self._commands if number < wanted]:
            del self._commands[old]
        return self._commands[wanted]

    def native(self, structure: Structure) -> NativeLaw:
        """The law for one run, compiled."""
        inner = _inner(self.law, structure, self.period)
        size, slots = len(structure.strings), self.samples + 1
        packed = _pack_delayed(
            law=inner.address,
            context=inner.context,
            period=self.period,
            numbers=np.full(slots, -1, np.int64),
            statuses=np.zeros(slots, np.int64),
            commands=np.zeros((slots, size)),
            reports=np.full((slots, REPORT_SIZE), np.nan),
        )
        return self._wrapped(inner, _delayed, packed)

    def describe(self) -> dict[str, Any]:
        """Plain values for the provenance of a run."""
        return {"law": "delayed", "of": _description(self.law), "samples": self.samples, "period": self.period}


def _inner(law: Any, structure: Structure, period: float) -> NativeLaw:
    inner = native_law(law, structure)
    if not inner.address:
        raise OptionError("law = None: there is no law that could be made noisy or late")
    if inner.period is not None and abs(inner.period / period - 1) > 1e-9:
        raise OptionError(f"period = {period:g} s: the law within has samples each {inner.period:g} s; use that")
    return inner


def _description(law: Any) -> Any:
    describe = getattr(law, "describe", None)
    return describe() if callable(describe) else getattr(law, "__name__", type(law).__name__)
