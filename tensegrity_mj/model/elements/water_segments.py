"""Number of segments that a rod needs in waves: an error bound for loads taken at the centres of segments.

Along a rod of length ℓ, at s from 0 to 1, a wave of number k is e^{μs} with μ = κ (sin φ - i cos φ cos χ), κ = k ℓ, φ
the rod's inclination and χ its heading against the wave: |μ| <= κ, however the rod turns. In water of finite depth it
is the sum of two such functions. A segment, Δ = 1/n of the rod, counts with its load per length f at its centre c,
which errs by

    ∫ g ds - Δ g(c) = ∫ ½ (½ Δ - |s - c|)² g'' ds,

g being f for the force and (s - ½) f for the moment about the rod's centre, of which |g''| <= 2 |f'| + ½ |f''|. With
f̂(s) the amplitude of the load, F̂ = ℓ ∫ f̂ ds and ½ ℓ F̂ the largest moment that it could have, the errors are at most

    force  (|f''|/f̂) / 24 n²        moment  (4 |f'| + |f''|)/f̂ / 24 n²

of these: f̂ is convex, and the weight of g'' above is Δ³/24 of one that lies nearer to the centre than an even one. Of
a wave, they are

    inertia   f ~ e^{μs}   |f'| <= κ f̂,     |f''| <= κ² f̂        force κ² / 24 n²,  moment κ (κ + 4) / 24 n²
    drag      f ~ |u| u    |f'| <= 2 κ f̂,   |f''| <= 4 κ² f̂      force κ² / 6 n²,   moment κ (κ + 2) / 6 n²

as |f''| <= 2 |u| |u''| + 2 |u'|², and of waves and a current together, u = Σ u_i, the sums: with amplitudes as they
are at the still surface, below which short waves have a smaller part. Neither error can be larger than twice F̂ or
½ ℓ F̂, as f̂ is convex. A segment that is partly wet, 0 <= w <= 1, counts at the centre of that part, and as
∫ w (s - c)² ds <= Δ³/12 the same holds of it with the largest f̂ on it. The surface is taken for straight between the
ends of a segment, which is off by at most κ² A / 8 n²; buoyancy, ρ g d times that on a rod that lies in it, errs by at
most κ² / 12 n² of ρ g d A ℓ. Not in the bound: the bend of `AboveLevel.CONSTANT` at z = 0, within one segment, and the
rod's own turning, whose added mass and drag are off by 1/n² of their moments in any wave.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.model.elements.water import MOST_SEGMENTS, Water, sea_of
from tensegrity_mj.model.elements.waves import Sea

if TYPE_CHECKING:
    from tensegrity_mj.model.scene import Scene

PART = 0.01  # of the largest wave load: the bound that a chosen number keeps
WARNED = 0.05  # a number that was given is warned of where its bound is larger
FEWEST, MOST_CHOSEN = 5, 200  # that are chosen: five as in the thesis, p. 154; each costs time


@dataclass(frozen=True)
class SegmentCount:
    """The segments of each rod of a scene in water, and how far waves' loads may be off with them.

    Attributes:
        count: L.
        chosen: whether it follows from the waves; otherwise it was given.
        needed: the least number, 5 or more, whose bound is at most `PART`; None where 1000 are not enough.
        force_error, moment_error: bounds for the longest member, as parts of the largest force of waves on it and of
            half its length times that, 2 at most; zero without waves.
        member: the longest rod, or string that takes drag.
        length: ℓ of it [m].
        wave_number: the largest k [1/m]; zero without waves.
        kinds: of members that the water loads: "rod", "string", or both.
    """

    count: int
    chosen: bool
    needed: int | None
    force_error: float
    moment_error: float
    member: str
    length: float
    wave_number: float
    kinds: tuple[str, ...]

    @property
    def error_bound(self) -> float:
        """The larger of the two bounds."""
        return max(self.force_error, self.moment_error)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings of a run where the bound is too large."""
        if self.error_bound <= (PART if self.chosen else WARNED):
            return ()
        chosen = f"segments = {self.count}" + (", the most that are chosen," if self.chosen else "")
        if self.needed is None:
            remedy = f"give segments = {MOST_SEGMENTS}, the most there may be"
        else:
            free = not self.chosen and self.needed <= MOST_CHOSEN
            remedy = f"give segments = {self.needed}{' or leave segments out' if free else ''}, for {100 * PART:g} %"
        return (
            f"water: {chosen} are too few for the waves along {self.member} of {self.length:.4g} m (k ℓ up to "
            f"{self.wave_number * self.length:.3g}): their loads may be off by {100 * self.error_bound:.3g} % of the "
            f"largest; {remedy}",
        )

    def report(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return {
            "count": self.count,
            "kinds": list(self.kinds),
            "chosen": self.chosen,
            "needed": self.needed,
            "force_error_bound": self.force_error,
            "moment_error_bound": self.moment_error,
        }

    def text(self) -> str:
        """Summary of the report as text."""
        count = count_text(self.report())
        return (
            f"{count}: wave loads within {100 * self.error_bound:.2g} % of the largest" if self.wave_number else count
        )


def count_text(report: Mapping[str, Any]) -> str:
    """Describe the number of segments a member in a `SegmentCount.report`."""
    members = " or ".join(report["kinds"])
    return f"{report['count']} segments a {members}, {'chosen' if report['chosen'] else 'given'}"


def segment_count(scene: Scene) -> SegmentCount:
    """The segments of each rod of a scene that has water: those given, or those that its waves need."""
    water, structure, sea = scene.water, scene.structure, sea_of(scene)
    assert water is not None
    lengths, names = structure.rod_lengths, [f"rod '{rod.name}'" for rod in structure.rods]
    if water.string_diameter is not None:
        lengths = np.concatenate([lengths, np.linalg.norm(structure.paths.spans(scene.nodes0), axis=-1)])
        names += [f"string '{structure.strings[row].name}'" for row in structure.paths.strings]
    kinds = {"rod": bool(structure.rods), "string": water.string_diameter is not None}
    row = int(np.argmax(lengths))
    length = float(lengths[row])
    force, moment = error_factors(sea, water, length)
    least = max(FEWEST, math.ceil(min(math.sqrt(max(force, moment) / PART), 2.0 * MOST_SEGMENTS)))
    count = min(least, MOST_CHOSEN) if water.segments is None else water.segments
    return SegmentCount(
        count,
        water.segments is None,
        least if least <= MOST_SEGMENTS else None,
        min(force / count**2, 2.0),
        min(moment / count**2, 2.0),
        names[row],
        length,
        float(np.max(sea.number[sea.amplitude > 0], initial=0.0)),
        tuple(kind for kind, there in kinds.items() if there),
    )


def error_factors(sea: Sea, water: Water, length: float) -> tuple[float, float]:
    """n² times the bounds of the errors of wave loads on a rod with n segments.

    Args:
        sea: of the water.
        water: whose coefficients say which loads there are.
        length: of the rod [m].

    Returns:
        Of the force, as a part of F̂, and of the moment, as a part of ½ ℓ F̂: the largest of inertia, drag and buoyancy;
        zero without waves.
    """
    waves = sea.amplitude > 0
    if not waves.any():
        return 0.0, 0.0
    k, height, speed = sea.number[waves] * length, sea.amplitude[waves], sea.orbit_speeds(0.0)[waves]
    force = [2 * _mean(height, k**2)]
    moment = force.copy()
    if water.inertia_coefficient > 0:
        gain = sea.frequency[waves] * speed
        force.append(_mean(gain, k**2))
        moment.append(force[-1] + 4 * _mean(gain, k))
    if water.drag > 0 or water.tangential_drag > 0:
        part = float(speed.sum() / (speed.sum() + np.linalg.norm(sea.current)))  # of the waves in the largest speed
        first, second = part * _mean(speed, k), part * _mean(speed, k**2)
        force.append(2 * second + 2 * first**2)
        moment.append(force[-1] + 8 * first)
    return max(force) / 24, max(moment) / 24


def _mean(weights: Array, values: Array) -> float:
    return float(weights @ values / weights.sum())
