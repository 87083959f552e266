"""What the thesis states of the tower in waves, §7.2.3 and figures 7.8 and 7.9."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.families.thesis_towers import PRESTRESS_MEASURES, STIFFNESSES
from tensegrity_mj.reproduction.beams import BeamRun
from tensegrity_mj.reproduction.statement import (
    HOLDS,
    Interval,
    KnownDifference,
    ReadFrom,
    Runs,
    Statement,
    inside,
    near,
)
from tensegrity_mj.reproduction.waves import ENGINES, STUDY
from tensegrity_mj.studies.waves.cases import label_of

Array = NDArray[np.float64]

SOFT, STIFF = (label_of(STIFFNESSES[k], PRESTRESS_MEASURES[k]) for k in (0, 2))
SHOWN = label_of(STIFFNESSES[2], PRESTRESS_MEASURES[0])  # of figure 7.8
PERIODS = 3  # of the wave, at the end of each run
LIKE = 0.1  # of D: how far periods may differ that count as alike

OPEN = (
    "the strings (180 are counted), the radius of a stage, the place in the wave and the length of a run are not told, "
    "and D depends on them by factors (docs/waves.md)"
)
SHARES = (
    f"{OPEN}. Of those tried, the full tower with R = 0.60 m gives 28.4, 26.9 and 60.4 % after 30 s where the thesis "
    "has 25.9, 27.5 and 58.9, with a quarter of the D"
)
FLOATS = (
    "tubes of half the water's weight float half out of it: with its axis near the surface, a tower one metre wide has "
    "its top half a metre above it, and crests are half a metre high. How the thesis cuts off what is not under water "
    "is not told"
)
FORCE = "the prestress that form-finding leaves depends on the strings and the radius alone: " + OPEN


def _run(runs: Runs) -> BeamRun:
    found: BeamRun = runs[STUDY]
    return found


def grid(run: BeamRun, name: str = "largest") -> Array:
    """(3, 3): of each stiffness a row, over prestress measures."""
    return np.array([[run.values[label_of(k, p)][name] for p in PRESTRESS_MEASURES] for k in STIFFNESSES], float)


def cyclic(run: BeamRun, label: str) -> float:
    """How much the largest D of the last periods differ, over their mean."""
    time, D = run.of(label, "time"), run.of(label, "D")
    period = run.values[label]["period"]
    largest = [D[(time > time[-1] - (n + 1) * period) & (time <= time[-1] - n * period)].max() for n in range(PERIODS)]
    return float(np.ptp(largest) / np.mean(largest))


def _afloat(run: BeamRun, label: str) -> bool:
    """Whether the axis was below the surface and then is about it."""
    height = run.of(label, "height")
    return bool(height[0] < -0.9 and abs(height[-len(height) // 8 :].mean()) < 0.5)


def _cyclic(runs: Runs) -> bool:
    run = _run(runs)
    return all(cyclic(run, label) < LIKE and _afloat(run, label) for label in run.values)


def _lowest(runs: Runs) -> float:
    nodes = _run(runs).of(SHOWN, "nodes")[1:]
    return float(nodes[..., 2].min())


def _highest(runs: Runs) -> float:
    nodes = _run(runs).of(SHOWN, "nodes")[1:]
    return float(nodes[..., 2].max())


def _falls(axis: int, name: str) -> Callable[[Runs], bool]:
    return lambda runs: bool(np.all(np.diff(grid(_run(runs), name), axis=axis) < 0))


def _row(
    id_: str, place: str, page: int, says: str, stated: str, read_from: ReadFrom, accepted: Interval, tolerance: str,
    measure: Callable[[Runs], float | bool], unit: str = "", known: KnownDifference | None = None,
) -> Statement:  # fmt: skip
    head = id_.partition("-")[0]
    return Statement(
        id_, head if head in ("7.8", "7.9") else "", place, page, says, stated, read_from, accepted, tolerance,
        (STUDY,), measure, unit, known, ENGINES,
    )  # fmt: skip


# fmt: off
def _rows() -> Iterator[Statement]:
    text, axis = ReadFrom.TEXT, ReadFrom.AXIS
    sentence = "a sentence that holds or does not"
    yield _row(
        "7.2.3-cyclic", "§7.2.3", 156, "from below the surface the tower comes to float, and its motion to repeat: the "
        "largest D of the last three periods are alike within 10 %, in all nine cases",
        "a transient behaviour, then a cyclic one", text, HOLDS, sentence, _cyclic,
    )
    yield _row(
        "7.8-lowest", "Fig. 7.8", 156, "30 kN/m, 0.10 m, within one period: lowest node", "ticks from −1.5 to 0.5",
        axis, inside(-2.0, 0.0), "within the ticks that would follow", _lowest, "m",
    )
    yield _row(
        "7.8-highest", "Fig. 7.8", 156, "30 kN/m, 0.10 m, within one period: highest node", "ticks from −1.5 to 0.5",
        axis, inside(0.0, 1.0), "within the ticks that would follow", _highest, "m",
        KnownDifference(FLOATS, near(1.012, 0.01)),
    )
    for name, when in (("largest", "of the run"), ("steady", "after 30 s")):
        for along, what in ((0, "stiffness"), (1, "prestress")):
            yield _row(
                f"7.9-falls-{what}-{name}", "§7.2.3", 157, f"the largest D {when} falls with {what}, over the grid",
                "the expected trend", text, HOLDS, sentence, _falls(along, name),
            )
    stiffer = zip(range(3), PRESTRESS_MEASURES, (25.9, 27.5, 28.6), (9.9, 16.2, 16.7), strict=True)
    for index, p, percent, ours in stiffer:
        yield _row(
            f"7.9-stiffness-{p:g}", "§7.2.3", 157, f"prestress {p:.2f} m: D is reduced from 10 to 20 kN/m by",
            f"{percent} %", text, near(percent, 3), "3 points", lambda runs, index=index: _reduced(  # type: ignore[misc]
                runs, (0, index), (1, index)), "%", KnownDifference(SHARES, near(ours, 1.5)),
        )
    tighter = zip(range(3), STIFFNESSES, (27.5, 30.1, 34.6), (13.4, 19.9, 22.2), strict=True)
    for index, k, percent, ours in tighter:
        yield _row(
            f"7.9-prestress-{k / 1e3:g}", "§7.2.3", 157, f"{k / 1e3:g} kN/m: D is reduced from 0.10 to 0.20 m by",
            f"{percent} %", text, near(percent, 3), "3 points", lambda runs, index=index: _reduced(  # type: ignore[misc]
                runs, (index, 0), (index, 2)), "%", KnownDifference(SHARES, near(ours, 1.5)),
        )
    yield _row(
        "7.9-extremes", "§7.2.3", 157, "D is reduced from the softest to the stiffest case by", "58.9 %", text,
        near(58.9, 3), "3 points", lambda runs: _reduced(runs, (0, 0), (2, 2)), "%",
        KnownDifference(SHARES, near(38.2, 1.5)),
    )
    for name, where, value, ours in (("soft", (0, 0), 1.19, 0.708), ("stiff", (2, 2), 0.49, 0.438)):
        yield _row(
            f"7.9-{name}", "§7.2.3", 157, f"largest D of the {name}est case", f"{value} m", text,
            near(value, 0.1 * value), "10 %", lambda runs, where=where: float(grid(_run(runs))[where]), "m",  # type: ignore[misc]
            KnownDifference(OPEN, near(ours, 0.002)),
        )
    for name, label, value, force in (("soft", SOFT, 1.45, 1.731), ("stiff", STIFF, 8.68, 11.60)):
        yield _row(
            f"7.2.3-waves-force-{name}", "§7.2.3", 157, f"mean force of the rods in waves, {name}est case",
            f"{value} kN", text, near(value, 0.1 * value), "10 %",
            lambda runs, label=label: float(_run(runs).of(label, "mean_force")), "kN",  # type: ignore[misc]
            KnownDifference(FORCE, near(force, 0.02 * force)),
        )


def _reduced(runs: Runs, before: tuple[int, int], after: tuple[int, int]) -> float:
    """[%]"""
    D = grid(_run(runs))
    return float(100 * (1 - D[after] / D[before]))


STATEMENTS: tuple[Statement, ...] = tuple(_rows())
