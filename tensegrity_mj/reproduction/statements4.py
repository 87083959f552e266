"""What chapter 4 of the thesis states: feedback linearization of the cross (§4.6.1) and of the planar beam (§4.6.2)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np

from tensegrity_mj.reproduction import measures
from tensegrity_mj.reproduction.experiments import BEAM_STRINGS
from tensegrity_mj.reproduction.shared_rows import LINE, parameter_statements
from tensegrity_mj.reproduction.statement import (
    FITS,
    HOLDS,
    INSIDE,
    Interval,
    KnownDifference,
    Measure,
    ReadFrom,
    Runs,
    Statement,
    fills,
    near,
    of,
)
from tensegrity_mj.trajectory import Trajectory

COORDINATES = ("y₁", "θ₁", "θ₂")
UNITS = ("m", "°", "°")
START, END = (1.33, -70.0, 70.0), (0.48, -20.0, 20.0)
_AXES = (("y₁", "m", 0.4, 1.4), ("θ₁", "°", -100.0, 100.0), ("θ₂", "°", -100.0, 100.0))
CROSS = ("cross-1.2", "cross-0.4", "cross-0")
ONE_SUM = ("beam-1960", "beam-980", "beam-0")
SNAPSHOTS = (0.0, 20.0, 40.0, 60.0)
BY_CELLS = ("beam-cells-60", "beam-cells-30", "beam-0")
ON_BOUND = 1e-6  # relative; what the allocation's accuracy leaves
ALMOST_CONSTANT = (
    "the rods' length, the height and the overlap decide this length: it follows from (4.15), and is constant to the "
    "width of a drawn line, but not exactly"
)


def _error_dynamics(run: Trajectory) -> float:
    """Largest deviation of an error of q from (1 + t) e^(-t) e(0), over e(0)."""
    goal = measures.cross_coordinates(run, measures.aims(run)[-1])
    error = measures.cross_coordinates(run) - goal
    promised = ((1.0 + run.time) * np.exp(-run.time))[:, None] * error[0]
    return float(np.max(np.abs(error - promised) / np.abs(error[0])))


def _tracking_error(run: Trajectory) -> float:
    return float(run.target_error().max())


def _sum_off(bound: float) -> Callable[[Trajectory], float]:
    """Largest distance of the sum from its bound, over the bound."""
    return lambda run: float(np.abs(measures.sums(run) / bound - 1.0).max())


def _interval(bound: float, number: int, end: int) -> Callable[[Trajectory], float]:
    def measure(run: Trajectory) -> float:
        found = measures.times_off(run, bound)
        return found[number][end] if number < len(found) else math.nan

    return measure


def _top_sum(run: Trajectory) -> float:
    return float(measures.sums(run).max())


def _least(run: Trajectory) -> float:
    return float(run.force_densities.min())


def _ordered_sums(runs: Runs) -> bool:
    """Whether at every time the sum without criterion is the least, and that of 0.40 N/m not above that of 1.20 N/m."""
    low, middle, high = (measures.sums(runs[name]) for name in ("cross-0", "cross-0.4", "cross-1.2"))
    return bool(np.all(low <= middle + 1e-9) and np.all(middle <= high + 1e-9))


def _printed(value: float, unit: str) -> str:
    """A printed value with its unit."""
    return f"{value:g}{'' if unit == '°' else ' '}{unit}".replace("-", "−")


def _coordinate(run: Trajectory, sample: int, k: int) -> float:
    return float(measures.cross_coordinates(run)[sample, k])


def _within(run: Trajectory, k: int, low: float, high: float) -> bool:
    values = measures.cross_coordinates(run)[:, k]
    return bool(np.all((values > low) & (values < high)))


def _smallest_drawn(run: Trajectory, axis: int) -> float:
    return float(min(measures.at(run, time, run.nodes[..., axis]).min() for time in SNAPSHOTS))


def _largest_drawn(run: Trajectory, axis: int) -> float:
    return float(max(measures.at(run, time, run.nodes[..., axis]).max() for time in SNAPSHOTS))


def _shape_equation(run: Trajectory) -> float:
    """Largest residual of (4.15) over ℓ², with h = 1 m and ℓ² = 2 m²."""
    phi, inner = measures.sector_angle(run), measures.radii(run)[:, 0]
    found = (1.0 + inner * (1.0 - np.cos(phi))) ** 2 + (inner * np.sin(phi)) ** 2
    return float(np.abs(found / 2.0 - 1.0).max())


def _covered(run: Trajectory) -> float:
    """The angle that the 40 rods cover at the end [°]: 20 sectors, each turned by 2/3 of one."""
    return math.degrees(float(measures.sector_angle(run)[-1])) * (1.0 + 19.0 * 2.0 / 3.0)


def _change(run: Trajectory, column: int) -> float:
    length = measures.describing_lengths(run)[:, column]
    return float(np.ptp(length))


def _mean(run: Trajectory, group: str) -> float:
    return float(measures.beam_group(run, group).mean())


def _altered(group: str) -> Measure:
    return lambda runs: _mean(runs["beam-1960"], group) / _mean(runs["beam-980"], group)


def _mean_over_all(run: Trajectory, group: str) -> float:
    return _mean(run, group) / float(run.force_densities.mean())


def _rims_lead(run: Trajectory) -> bool:
    rims = _mean(run, "rims")
    return all(rims > 2.0 * _mean(run, group) for group in ("verticals", "even", "odd"))


def _spread_of_cells(run: Trajectory) -> float:
    """Largest over smallest sum of a cell, at the time where that is most."""
    cells = measures.cell_sums(run)
    return float((cells.max(axis=1) / cells.min(axis=1)).max())


# Rows read better with several arguments on a line.
# fmt: off


def _cross_motion() -> Iterator[Statement]:
    run = "cross-1.2"
    yield from parameter_statements("4.2", "§4.6.1", 95, run, 5.0, "√2")
    for k, (name, unit) in enumerate(zip(COORDINATES, UNITS, strict=True)):
        yield Statement(
            f"4.2-start-{k + 1}", "4.2", "§4.6.1, Fig. 4.2", 95, f"{name} at 0 s", _printed(START[k], unit),
            ReadFrom.TEXT, near(START[k], 1e-9), "printed exactly", (run,), of(run, _coordinate, 0, k), unit,
        )
        yield Statement(
            f"4.2-end-{k + 1}", "4.2", "§4.6.1, Fig. 4.2", 95, f"{name} at 10 s", _printed(END[k], unit),
            ReadFrom.TEXT, near(END[k], 1e-6), "printed exactly; the integration's tolerance", (run,),
            of(run, _coordinate, -1, k), unit,
        )
    for axis, letter in ((0, "x"), (2, "y")):
        yield Statement(
            f"4.2-{letter}", "4.2", "Fig. 4.2", 96, f"largest {letter} of the nodes", "axis to 1.5 m, ticks of 0.5",
            ReadFrom.AXIS, fills(1.5, 0.5), FITS, (run,), of(run, measures.largest_coordinate, axis), "m",
        )
    yield Statement(
        "4.3-tracking", "4.3", "Fig. 4.3", 97, "tracking: largest distance of a node from its reference",
        "references and actual coordinates are equal", ReadFrom.CAPTION, Interval(0.0, 1e-8),
        "exact in the law; the integration's tolerance of 1e-10 over 10 s", (run,), of(run, _tracking_error), "m",
    )
    yield Statement(
        "4.3-rate", "4.3", "§4.2, Fig. 4.3", 97, "tracking: largest |ẏ₁|, at half time",
        "15/8 of the mean: 0.1594 m/s", ReadFrom.TEXT, near(15.0 / 8.0 * 0.085, 1e-6),
        "of the fifth-order polynomial with rest at both ends; sampled each 10 ms, about the maximum", (run,),
        of(run, lambda r: float(np.abs(r.velocities[:, 0, 2]).max())), "m/s",
    )
    for k, (name, unit, low, high) in enumerate(_AXES):
        for kind, which in (("tracking", run), ("set-point", "cross-set-point")):
            yield Statement(
                f"4.3-{kind}-{k + 1}", "4.3", "Fig. 4.3", 97, f"{kind}: {name} stays within its axis",
                f"axis from {_printed(low, unit)} to {_printed(high, unit)}", ReadFrom.AXIS, HOLDS, INSIDE, (which,),
                of(which, _within, k, low, high),
            )
    yield Statement(
        "4.3-error", "4.3", "(4.7), (4.8)", 97,
        "set-point: largest deviation of an error from (1 + t) e^(−t) e(0), over e(0)", "0 (ω_o = ζ = 1)",
        ReadFrom.TEXT, Interval(0.0, 1e-8), "exact in the law; the integration's tolerance", ("cross-set-point",),
        of("cross-set-point", _error_dynamics),
    )
    yield Statement(
        "4.3-settled", "4.3", "Fig. 4.3", 97, "set-point: error of y₁ at 10 s", "0 m between the lines",
        ReadFrom.CURVES, Interval(0.0, LINE),
        "the thickness of a line, 2 % of the panel's 1 m; 11 e^(−10) of 0.85 m is left", ("cross-set-point",),
        of("cross-set-point", lambda r: float(abs(measures.cross_coordinates(r)[-1, 0] - END[0]))), "m",
    )


def _cross_controls() -> Iterator[Statement]:
    for name, bound in (("cross-1.2", 1.2), ("cross-0.4", 0.4), ("cross-0", 0.0)):
        yield Statement(
            f"4.4-u-{bound:.1f}", "4.4", "Fig. 4.4", 98, f"u_sum = {bound:.2f} N/m: largest u",
            "axis to 0.5 or 0.6 N/m, ticks of 0.1", ReadFrom.AXIS, Interval(0.25, 0.7), FITS, (name,),
            of(name, measures.peak), "N/m",
        )
        yield Statement(
            f"4.4-sum-{bound:.1f}", "4.4", "Fig. 4.4", 98, f"u_sum = {bound:.2f} N/m: largest sum",
            "axis to 1.5 N/m, ticks of 0.5", ReadFrom.AXIS, Interval(0.0, 2.0), INSIDE, (name,), of(name, _top_sum),
            "N/m",
        )
    yield Statement(
        "4.4-constant", "4.4", "§4.6.1, Fig. 4.4", 97,
        "u_sum = 1.20 N/m: largest distance of the sum from its bound, over it", "0: constant, at the lower boundary",
        ReadFrom.TEXT, Interval(0.0, ON_BOUND), "the accuracy of the allocation", ("cross-1.2",),
        of("cross-1.2", _sum_off(1.2)),
    )
    yield Statement(
        "4.4-smooth", "4.4", "§4.6.1, §4.7", 97, "u_sum = 1.20 N/m: smallest u: never at the lower saturation limit",
        "> 0 (about 0.12 N/m in the figure)", ReadFrom.CURVES, Interval(0.11, 0.14), "a tenth of a tick",
        ("cross-1.2",), of("cross-1.2", _least), "N/m",
    )
    yield Statement(
        "4.4-saturates", "4.4", "Fig. 4.4", 98, "no sum: smallest u", "0: strings at the lower limit",
        ReadFrom.CURVES, Interval(0.0, 1e-6), "the accuracy of the allocation", ("cross-0",), of("cross-0", _least),
        "N/m",
    )
    yield Statement(
        "4.4-partly", "4.4", "§4.6.1, Fig. 4.4", 97,
        "u_sum = 0.40 N/m: part of the time that the sum is on its bound", "only partly at the lower boundary",
        ReadFrom.TEXT, Interval(0.05, 0.95), "neither never nor always", ("cross-0.4",),
        of("cross-0.4", lambda r: float(np.mean(measures.sums(r) <= 0.4 * (1.0 + 1e-3)))),
    )
    for number, (first, last) in enumerate(((0.62, 3.48), (6.06, 9.36))):
        for end, (word, value) in enumerate((("leaves", first), ("is back on", last))):
            yield Statement(
                f"4.4-off-{2 * number + end + 1}", "4.4", "Fig. 4.4", 98,
                f"u_sum = 0.40 N/m: the sum {word} its bound", f"about {value:.2f} s", ReadFrom.CURVES,
                near(value, 0.05), "reading of the curve: a fortieth of the tick of 2 s", ("cross-0.4",),
                of("cross-0.4", _interval(0.4, number, end)), "s",
            )
    yield Statement(
        "4.4-peak", "4.4", "Fig. 4.4", 98, "u_sum = 0.40 N/m: largest sum", "about 0.694 N/m", ReadFrom.CURVES,
        near(0.694, 0.005), "reading of the curve: a hundredth of the tick of 0.5 N/m", ("cross-0.4",),
        of("cross-0.4", _top_sum), "N/m",
    )
    yield Statement(
        "4.4-lowest", "4.4", "§4.6.1", 98, "at every time the sums are ordered as their criteria: none least", "true",
        ReadFrom.TEXT, HOLDS, "1e-9 N/m", CROSS, _ordered_sums,
    )


def _beam_shape() -> Iterator[Statement]:
    run = "beam-1960"
    yield from parameter_statements("4.7", "§4.6.2", 99, run, 1.0, "√2")
    yield Statement(
        "4.5-strings", "4.7", "§4.6.2", 98, "number of strings", "196", ReadFrom.TEXT, near(196.0, 0.0), "a count",
        (run,), of(run, lambda r: len(r.scene.structure.strings)),
    )
    yield Statement(
        "4.5-rods", "4.7", "§4.6.2", 98, "number of rods", "40", ReadFrom.TEXT, near(40.0, 0.0), "a count", (run,),
        of(run, lambda r: len(r.scene.structure.rods)),
    )
    yield Statement(
        "4.7-shape", "4.7", "(4.15)", 100, "largest residual of the corrected (4.15), over ℓ² = 2 m²", "0",
        ReadFrom.TEXT, Interval(0.0, 1e-6), "lengths of 1e-10 m over sin φ = 2e-4 at the start", (run,),
        of(run, _shape_equation),
    )
    yield Statement(
        "4.7-angle", "4.7", "Fig. 4.7", 100, "sector angle φ at 60 s", "axis to 30°, ticks of 5°", ReadFrom.AXIS,
        Interval(15.0, 35.0), "the thesis does not give it: the scene has 26.3°, where the ring closes", (run,),
        of(run, lambda r: math.degrees(float(measures.sector_angle(r)[-1]))), "°",
    )
    yield Statement(
        "4.7-straight", "4.7", "Fig. 4.7", 100, "sector angle φ at 0 s", "0° between the lines", ReadFrom.CURVES,
        Interval(0.0, 30.0 * LINE), "the thickness of a line, 2 % of 30°", (run,),
        of(run, lambda r: math.degrees(float(measures.sector_angle(r)[0]))), "°",
    )
    yield Statement(
        "4.7-radius", "4.7", "Fig. 4.7", 100, "outer radius at 0 s", "logarithmic axis to 10⁴ m, ticks of a decade",
        ReadFrom.AXIS, Interval(1e3, 1e5), "in its last decade", (run,),
        of(run, lambda r: float(measures.radii(r)[0, 1])), "m",
    )
    yield Statement(
        "4.7-inner", "4.7", "Fig. 4.7", 100, "inner radius at 60 s", "logarithmic axis from 10⁰ m, ticks of a decade",
        ReadFrom.AXIS, Interval(1.0, 10.0), "in its first decade", (run,),
        of(run, lambda r: float(measures.radii(r)[-1, 0])), "m",
    )
    yield Statement(
        "4.7-difference", "4.7", "§4.6.2", 100, "largest | r_o − r_i − h | at 60 s", "0 (r_o = r_i + h)",
        ReadFrom.TEXT, Interval(0.0, 1e-8), "the integration's tolerance", (run,),
        of(run, lambda r: float(abs(measures.radii(r)[-1, 1] - measures.radii(r)[-1, 0] - 1.0))), "m",
    )
    yield Statement(
        "4.7-lengths-high", "4.7", "Fig. 4.7", 100, "largest of the six string lengths",
        "axis to 1.2 m, ticks of 0.2", ReadFrom.AXIS, fills(1.2, 0.2), FITS, (run,),
        of(run, lambda r: float(measures.describing_lengths(r).max())), "m",
    )
    yield Statement(
        "4.7-lengths-low", "4.7", "Fig. 4.7", 100, "smallest of the six string lengths",
        "axis from 0.2 m, ticks of 0.2", ReadFrom.AXIS, Interval(0.0, 0.4), INSIDE, (run,),
        of(run, lambda r: float(measures.describing_lengths(r).min())), "m",
    )
    yield Statement(
        "4.7-four", "4.7", "§4.6.2", 100, "how many of the six lengths change by more than a line's width",
        "four time-varying string lengths", ReadFrom.TEXT, near(4.0, 0.0), "a line is 2 % of the panel's 1 m", (run,),
        of(run, lambda r: sum(_change(r, column) > LINE for column in range(6))),
    )
    for column, cells, ours in ((4, "odd", 0.0018), (5, "even", 0.0008)):
        yield Statement(
            f"4.7-constant-{cells}", "4.7", "§4.6.2", 100, f"crossing strings of {cells} cells: change of length",
            "0: constant", ReadFrom.TEXT, Interval(0.0, 1e-6), "the integration's tolerance", (run,),
            of(run, _change, column), "m", KnownDifference(ALMOST_CONSTANT, near(ours, 1e-4)),
        )
    for axis, letter, low, high in ((0, "x", -5.0, 15.0), (2, "y", -8.0, 2.0)):
        yield Statement(
            f"4.8-{letter}-low", "4.8", "Fig. 4.8", 101, f"smallest {letter} of the nodes at 0, 20, 40 and 60 s",
            f"axis from {_printed(low, 'm')}", ReadFrom.AXIS, Interval(low, 0.5 * low), INSIDE, (run,),
            of(run, _smallest_drawn, axis), "m",
        )
        yield Statement(
            f"4.8-{letter}-high", "4.8", "Fig. 4.8", 101, f"largest {letter} of the nodes at 0, 20, 40 and 60 s",
            f"axis to {high:g} m", ReadFrom.AXIS, Interval(0.5 * high, high), INSIDE, (run,),
            of(run, _largest_drawn, axis), "m",
        )
    yield Statement(
        "4.8-straight", "4.8", "Fig. 4.8", 101,
        "at 0 s: largest distance of a node from the straight beam 0 <= y <= 1 m", "a straight beam", ReadFrom.CURVES,
        Interval(0.0, 10.0 * LINE), "the thickness of a line, 2 % of 10 m", (run,),
        of(run, lambda r: float(np.abs(r.nodes[0, :, 2] - np.round(r.nodes[0, :, 2])).max())), "m",
    )
    yield Statement(
        "4.8-circle", "4.8", "§4.6.2, Fig. 4.8", 100, "at 60 s: angle that the beam covers",
        "360°: a circular configuration", ReadFrom.TEXT, near(360.0, 5.0), "the width of a rod's end in the figure",
        (run,), of(run, _covered), "°",
    )
    for name in (*ONE_SUM, *BY_CELLS[:2]):
        yield Statement(
            f"4.8-tracking-{name}", "4.8", "§4.6.2", 100, f"{name}: largest distance of a node from its reference",
            "tracking with correct initial configuration", ReadFrom.TEXT, Interval(0.0, 1e-7),
            "exact in the law; the integration's tolerance over 60 s and 20 rods in a row", (name,),
            of(name, _tracking_error), "m",
        )


def _one_sum() -> Iterator[Statement]:
    yield Statement(
        "4.9-constant", "4.9", "§4.7, Fig. 4.9", 105, "1960 N/m: largest distance of the sum from its bound, over it",
        "0: no more than the minimum was needed", ReadFrom.TEXT, Interval(0.0, ON_BOUND),
        "the accuracy of the allocation", ("beam-1960",), of("beam-1960", _sum_off(1960.0)),
    )
    for factor, name, bound in (("ten", "beam-1960", 1960.0), ("five", "beam-980", 980.0)):
        yield Statement(
            f"4.9-{bound:.0f}", "4.9", "§4.6.2", 100, f"smallest sum over the number of strings, {bound:.0f} N/m",
            f"{factor} times the number of strings", ReadFrom.TEXT, near(bound / BEAM_STRINGS, 1e-5),
            "the accuracy of the allocation", (name,),
            of(name, lambda r: float(measures.sums(r).min()) / len(r.scene.structure.strings)), "N/m",
        )
    for end, (word, value) in enumerate((("leaves", 6.5), ("is back on", 18.3))):
        yield Statement(
            f"4.9-off-{end + 1}", "4.9", "§4.7, Fig. 4.9", 105, f"980 N/m: the sum {word} its bound",
            f"insufficient for the manoeuvre; about {value:g} s", ReadFrom.CURVES, near(value, 0.3),
            "reading of the curve, 1.5 % of the tick of 20 s; it leaves the bound slowly", ("beam-980",),
            of("beam-980", _interval(980.0, 0, end)), "s",
        )
    for name in ("beam-980", "beam-0"):
        yield Statement(
            f"4.9-peak-{name}", "4.9", "Fig. 4.9", 102, f"{name}: largest sum", "about 1249 N/m", ReadFrom.CURVES,
            near(1249.0, 10.0), "reading of the curve: a fiftieth of the tick of 500 N/m", (name,),
            of(name, _top_sum), "N/m",
        )
    for name in ONE_SUM:
        yield Statement(
            f"4.9-u-{name}", "4.9", "Fig. 4.9", 102, f"{name}: largest u", "axis to 80 N/m, ticks of 20",
            ReadFrom.AXIS, fills(80.0, 20.0), FITS, (name,), of(name, measures.peak), "N/m",
        )
        yield Statement(
            f"4.9-sum-{name}", "4.9", "Fig. 4.9", 102, f"{name}: largest sum", "axis to 2500 N/m, ticks of 500",
            ReadFrom.AXIS, Interval(0.0, 3000.0), INSIDE, (name,), of(name, _top_sum), "N/m",
        )
    yield Statement(
        "4.9-inactive", "4.9", "§4.7", 105, "no sum: smallest sum", "the criterion was not active", ReadFrom.TEXT,
        Interval(0.0, 50.0), "far below the bounds of the other cases: the sum starts from 0", ("beam-0",),
        of("beam-0", lambda r: float(measures.sums(r).min())), "N/m",
    )
    yield Statement(
        "4.9-rims", "4.9", "§4.7", 105, "1960 N/m: the rims' mean u is more than twice that of any other group",
        "true", ReadFrom.TEXT, HOLDS, "\"most active\"", ("beam-1960",), of("beam-1960", _rims_lead),
    )
    for group, title in (("rims", "rims"), ("even", "crossing strings of even cells")):
        yield Statement(
            f"4.9-altered-{group}", "4.9", "§4.7", 105, f"{title}: mean u with 1960 N/m over that with 980 N/m",
            "altered substantially by the criterion", ReadFrom.TEXT, Interval(1.5), "by half or more",
            ("beam-1960", "beam-980"), _altered(group),
        )
    for group, title in (("odd", "crossing strings of odd cells"), ("verticals", "vertical strings")):
        yield Statement(
            f"4.9-low-{group}", "4.9", "§4.7", 105, f"1960 N/m: mean u of the {title}, over that of all strings",
            "close to zero", ReadFrom.TEXT, Interval(0.0, 0.1), "a tenth of the mean", ("beam-1960",),
            of("beam-1960", _mean_over_all, group),
        )
    yield Statement(
        "4.9-rough", "4.9", "§4.7", 105, "1960 N/m: how often a string begins or ceases to pull",
        "non-smooth control inputs", ReadFrom.TEXT, Interval(1.0), "at least once", ("beam-1960",),
        of("beam-1960", measures.switches),
    )


def _cells() -> Iterator[Statement]:
    for name, bound in (("beam-cells-60", 60.0), ("beam-cells-30", 30.0)):
        yield Statement(
            f"4.10-bound-{bound:.0f}", "4.10", "§4.6.2", 102, f"{bound:.0f} N/m a cell: smallest sum of a cell",
            f"{bound:.0f} N/m", ReadFrom.TEXT, near(bound, 1e-4), "the accuracy of the allocation", (name,),
            of(name, lambda r: float(measures.cell_sums(r).min())), "N/m",
        )
        yield Statement(
            f"4.10-varies-{bound:.0f}", "4.10", "§4.7", 105,
            f"{bound:.0f} N/m a cell: largest over smallest sum of all u", "no longer reaches a constant limit",
            ReadFrom.TEXT, Interval(1.01), "more than a line's width of the panel", (name,),
            of(name, lambda r: float(measures.sums(r).max() / measures.sums(r).min())),
        )
    for name in BY_CELLS:
        yield Statement(
            f"4.10-u-{name}", "4.10", "Fig. 4.10", 103, f"{name}: largest u", "axis to 100 N/m, ticks of 20",
            ReadFrom.AXIS, fills(100.0, 20.0), FITS, (name,), of(name, measures.peak), "N/m",
        )
    yield Statement(
        "4.10-sum", "4.10", "Figs. 4.10, 4.11", 103, "60 N/m a cell: largest sum of all u",
        "axis to 3500 N/m, ticks of 500", ReadFrom.AXIS, fills(3500.0, 500.0), FITS, ("beam-cells-60",),
        of("beam-cells-60", _top_sum), "N/m",
    )
    yield Statement(
        "4.10-even", "4.10", "§4.7", 105,
        "largest ratio of two cells' sums: second strategy over the first (1960 N/m)",
        "distributes the pretension more evenly", ReadFrom.TEXT, Interval(0.0, 1.0), "less than the other",
        ("beam-cells-60", "beam-1960"),
        lambda runs: _spread_of_cells(runs["beam-cells-60"]) / _spread_of_cells(runs["beam-1960"]),
    )
    yield Statement(
        "4.10-zero", "4.10", "§4.7", 105, "60 N/m a cell: smallest u", "some control inputs close to zero",
        ReadFrom.TEXT, Interval(0.0, 1.0), "1 % of the axis", ("beam-cells-60",), of("beam-cells-60", _least), "N/m",
    )
    for name in BY_CELLS:
        yield Statement(
            f"4.11-{name}", "4.11", "Fig. 4.11", 104, f"{name}: largest sum of a cell",
            "axis to 150 N/m, ticks of 50", ReadFrom.AXIS, fills(150.0, 50.0), FITS, (name,),
            of(name, lambda r: float(measures.cell_sums(r).max())), "N/m",
        )
    yield Statement(
        "4.11-odd", "4.11", "§4.7, Fig. 4.11", 105, "60 N/m a cell: mean sum of cells 3, 5 … 37 over the bound",
        "low values, close to the lower criterion", ReadFrom.TEXT, Interval(1.0 - 1e-6, 1.1),
        "a tenth above the bound", ("beam-cells-60",),
        of("beam-cells-60", lambda r: float(measures.cell_sums(r)[:, 2:37:2].mean()) / 60.0),
    )
    yield Statement(
        "4.11-raised", "4.11", "§4.7, Fig. 4.11", 105,
        "60 N/m a cell: smallest sum of cells 2, 4 … 38 over the bound", "raised above it", ReadFrom.TEXT,
        Interval(1.1), "by more than a tenth", ("beam-cells-60",),
        of("beam-cells-60", lambda r: float(measures.cell_sums(r)[:, 1:38:2].min()) / 60.0),
    )


STATEMENTS: tuple[Statement, ...] = (
    *_cross_motion(),
    *_cross_controls(),
    *_beam_shape(),
    *_one_sum(),
    *_cells(),
)
