"""What chapter 7 of the thesis states: so far of the tower's form-finding (§7.2.3)."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tensegrity_mj.families.thesis_towers import CHAPTER7_STAGES
from tensegrity_mj.reproduction.beams import TOWER, BeamRun, tower_label
from tensegrity_mj.reproduction.experiments import EngineName
from tensegrity_mj.reproduction.figures7 import FIRST, STAGES
from tensegrity_mj.reproduction.statement import (
    FITS,
    HOLDS,
    Interval,
    KnownDifference,
    Measure,
    ReadFrom,
    Runs,
    Statement,
    fills,
    near,
)

SOFT, STIFF, WITHIN, BETWEEN = (tower_label(*one) for one in TOWER)
NEEDS = ("tower-form",)

COUNT = (
    "the full tower of saddles, verticals and diagonals has 15 N − 6 = 219 strings; which of them the 180 are is not "
    "told. It is the full one that reproduces appendix C"
)
OPEN = (
    "topology and radius of a stage are open, and the thesis' numbers are of the simulation in waves: these are of the "
    "form that was found, without water"
)


def _row(
    id_: str, place: str, page: int, says: str, stated: str, read_from: ReadFrom, accepted: Interval, tolerance: str,
    measure: Measure, unit: str = "", known: KnownDifference | None = None,
) -> Statement:  # fmt: skip
    head = id_.partition("-")[0]
    return Statement(
        id_, head if head == "7.6" else "", place, page, says, stated, read_from, accepted, tolerance, NEEDS, measure,
        unit, known, (EngineName.STATICS,),
    )  # fmt: skip


def _run(runs: Runs) -> BeamRun:
    found: BeamRun = runs["tower-form"]
    return found


def _mean_force(run: BeamRun, label: str) -> float:
    """[kN] of the rods' compression."""
    return float(-run.of(label, "rod_forces").mean()) / 1e3


def _turn(run: BeamRun) -> float:
    """[°] by which each stage is turned from the one below, before form-finding, within 120°."""
    nodes = run.of(SOFT, "before").reshape(CHAPTER7_STAGES, 2, 3, 3)
    angles = np.degrees(np.arctan2(nodes[:, 0, 0, 2], nodes[:, 0, 0, 1]))
    return float(np.max(np.mod(np.diff(angles), 120.0)))


def _extent(run: BeamRun, name: str, axis: int) -> float:
    """[m] of the three stages that figure 7.6 shows here."""
    nodes = run.of(SOFT, name)[6 * (FIRST - 1) : 6 * (FIRST - 1 + STAGES)]
    return float(np.ptp(nodes[:, axis]))


# fmt: off
def _rows() -> Iterator[Statement]:
    text, axis = ReadFrom.TEXT, ReadFrom.AXIS
    yield _row(
        "7.2.3-rods", "§7.2.3", 154, "rods of fifteen stages", "45", text, near(45, 0), "a count",
        lambda runs: float(_run(runs).of(SOFT, "rods_count")),
    )
    yield _row(
        "7.2.3-strings", "§7.2.3", 154, "strings of the full tower", "180", text, near(180, 0), "a count",
        lambda runs: float(_run(runs).of(SOFT, "strings_count")), known=KnownDifference(COUNT, near(219, 0)),
    )
    for label, what in ((WITHIN, "within the stages"), (BETWEEN, "upwards between stages")):
        yield _row(
            f"7.2.3-strings-{label.partition(' ')[0].replace('_', '-')}", "§7.2.3", 154,
            f"strings of the tower with diagonals {what} only", "180", text, near(180, 0), "a count",
            lambda runs, label=label: float(_run(runs).of(label, "strings_count")),  # type: ignore[misc]
        )
    yield _row(
        "7.6-turned", "§7.2.3", 154, "each stage is turned about the axis from the one below by", "60°", text,
        near(60, 1e-6), "geometry", lambda runs: _turn(_run(runs)), "°",
    )
    yield _row(
        "7.6-away", "§7.2.3", 155, "before form-finding: largest force that no rod balances, over the strings' largest",
        "away from static equilibrium", text, Interval(0.01), "1 % and more", lambda runs: float(
            _run(runs).of(SOFT, "unbalanced_before")),
    )
    yield _row(
        "7.6-equilibrium", "§7.2.3", 155, "after it: force that is left over the largest tension",
        "all elements in static equilibrium", text, Interval(0.0, 1e-9), "round-off",
        lambda runs: float(_run(runs).of(SOFT, "unbalanced_after")),
    )
    yield _row(
        "7.6-taut", "§7.2.3", 155, "after it: every rod is compressed and every string taut", "a tensegrity", text,
        HOLDS, "a sentence that holds or does not",
        lambda runs: bool(_run(runs).of(SOFT, "least_tension") > 0 and _run(runs).of(SOFT, "rod_forces").max() < 0),
    )
    for name, when in (("before", "before"), ("nodes", "after")):
        yield _row(
            f"7.6-length-{when}", "Fig. 7.6", 155, f"three stages {when} form-finding: extent along the beam",
            "axis of 3 m, ticks of 0.5", axis, fills(3.0, 0.5), FITS,
            lambda runs, name=name: _extent(_run(runs), name, 0), "m",  # type: ignore[misc]
        )
        yield _row(
            f"7.6-width-{when}", "Fig. 7.6", 155, f"three stages {when} form-finding: extent across the beam",
            "axis of 1 m, ticks of 0.5", axis, fills(1.0, 0.5), FITS,
            lambda runs, name=name: _extent(_run(runs), name, 1), "m",  # type: ignore[misc]
        )
    for label, value, low, high in ((SOFT, 1.45, 1.6, 1.8), (STIFF, 8.68, 11.3, 11.9)):
        yield _row(
            f"7.2.3-force-{'soft' if label == SOFT else 'stiff'}", "§7.2.3", 157,
            f"mean force of the rods after form-finding, {label.partition(' ')[2]}", f"{value} kN, in waves", text,
            near(value, 0.1 * value), "10 %", lambda runs, label=label: _mean_force(_run(runs), label), "kN",  # type: ignore[misc]
            KnownDifference(OPEN, Interval(low, high)),
        )


STATEMENTS: tuple[Statement, ...] = tuple(_rows())
