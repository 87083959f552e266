"""Prescribed motions of supports in compiled code: displacement, velocity and acceleration of each at a time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.dynamics.native.compiling import called_from_c
from tensegrity_mj.dynamics.native.pointers import LOAD_SIGNATURE, array_at, borrowing, call_load, floats, inlined
from tensegrity_mj.dynamics.native.views import view_of
from tensegrity_mj.model.motion import Motion

HARMONIC = np.dtype([("amplitude", "f8", (3,)), ("frequency", "f8"), ("phase", "f8")], align=True)
MOTION = np.dtype(
    [
        ("harmonics", "i8"),  # where its harmonics start, and how many there are
        ("harmonic_count", "i8"),
        ("times", "i8"),  # where the times of its data start, how many, and where its pieces start
        ("time_count", "i8"),
        ("pieces", "i8"),
        ("function", "i8"),  # address, or 0
    ],
    align=True,
)
Motions, pack_motions = view_of(
    "Motions",
    motions=(MOTION, "count"),
    harmonics=(HARMONIC, "harmonic_count"),
    times=("f8", "time_count"),
    pieces=("f8", "piece_count", 6, 3),
)


class PackedMotions:
    """Some motions as compiled code reads them, to be kept alive meanwhile.

    Attributes:
        motions: what was packed.
        address: of their `Motions`; 0 where there are none.
        failure: the first exception that a motion's function raised.
    """

    def __init__(self, motions: Sequence[Motion]) -> None:
        self.motions = tuple(motions)
        self.failure: list[BaseException] = []
        self.address = 0
        if not self.motions:
            return
        records = np.zeros(len(self.motions), MOTION)
        harmonics = np.zeros(sum(len(motion.harmonics) for motion in self.motions), HARMONIC)
        times: list[float] = []
        pieces: list[Array] = []
        self._functions: list[Any] = []
        used = 0
        for record, motion in zip(records, self.motions, strict=True):
            record["harmonics"], record["harmonic_count"] = used, len(motion.harmonics)
            for item in motion.harmonics:
                harmonics[used]["amplitude"] = item.amplitude
                harmonics[used]["frequency"], harmonics[used]["phase"] = item.angular_frequency, item.phase
                used += 1
            record["times"], record["time_count"] = len(times), len(motion.times)
            record["pieces"] = len(pieces)
            times += motion.times
            pieces += list(motion.pieces)
            if motion.function is not None:
                record["function"] = self._function(motion)
        self._packed = pack_motions(
            motions=records,
            harmonics=harmonics,
            times=np.array(times, float),
            pieces=np.array(pieces, float).reshape(-1, 6, 3),
        )
        self.address = self._packed.address

    def _function(self, motion: Motion) -> int:
        def call(time: float, out: int) -> int:
            try:
                array_at(out, 3, 3)[:] = motion.at(time)
            except BaseException as error:
                if not self.failure:
                    self.failure.append(error)
                return 1
            return 0

        function, address = called_from_c(LOAD_SIGNATURE, call)
        self._functions.append(function)
        return address


@inlined
def piece_at(t: float, times: Any, low: int, high: int) -> int:
    """The last k of low to high - 1 with times[k] <= t, or low - 1. `np.searchsorted` takes seconds to compile."""
    while low < high:
        middle = (low + high) // 2
        if times[middle] <= t:
            low = middle + 1
        else:
            high = middle
    return low - 1


@borrowing
def motion_at(packed: int, number: int, t: float, out_at: int) -> int:
    """Write displacement, velocity and acceleration (3, 3) of a motion at t [s]; not 0 where its function failed."""
    all_, out = Motions(packed), floats(out_at, (3, 3))
    motion = all_.motions[number]
    for row in range(3):
        for k in range(3):
            out[row, k] = 0.0
    if motion.function != 0:
        return call_load(motion.function, t, out_at)
    harmonics = all_.harmonics
    for h in range(motion.harmonics, motion.harmonics + motion.harmonic_count):
        item = harmonics[h]
        omega, angle = item.frequency, item.frequency * t + item.phase
        sine, cosine = np.sin(angle), np.cos(angle)
        for k in range(3):
            a = item.amplitude[k]
            out[0, k] += a * sine
            out[1, k] += a * omega * cosine
            out[2, k] -= a * omega * omega * sine
    if motion.time_count > 0:
        first, last = motion.times, motion.times + motion.time_count - 1
        _add_piece(all_.times, first, last, all_.pieces, motion.pieces, t, out)
    return 0


@borrowing
def _add_piece(times: Any, first: int, last: int, pieces: Any, start: int, t: float, out: Any) -> None:
    """Add the quintic of data between times[first] and times[last]; outside they stand still."""
    inside = times[first] <= t <= times[last]
    at = min(max(t, times[first]), times[last])
    low = min(piece_at(at, times, first, last + 1), last - 1)
    x, c = at - times[low], start + low - first
    for k in range(3):
        d, rate, acc = 0.0, 0.0, 0.0
        for p in range(5, -1, -1):
            acc = acc * x + 2.0 * rate
            rate = rate * x + d
            d = d * x + pieces[c, p, k]
        out[0, k] += d
        if inside:
            out[1, k] += rate
            out[2, k] += acc
