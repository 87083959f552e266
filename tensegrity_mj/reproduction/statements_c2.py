"""What appendix C.2 of the thesis states of beams in waves: oscillation amplitude, wave height and prestress.

The amplitude is the largest of any stage along the waves, half the distance from its lowest to its highest place.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from tensegrity_mj.families.beam_in_waves import GRAVITY, STEEPNESS
from tensegrity_mj.reproduction.beam_wave_studies import (
    CHOSEN,
    DOUBLED,
    HEIGHTS,
    MODES,
    OPEN,
    PRINTED,
    STUDIES,
    TWICE,
    label_of,
)
from tensegrity_mj.reproduction.beams import BY_PRESTRESS, BeamRun
from tensegrity_mj.reproduction.experiments import EngineName
from tensegrity_mj.reproduction.measures_c import rises
from tensegrity_mj.reproduction.statement import (
    FITS,
    HOLDS,
    Interval,
    KnownDifference,
    Measure,
    ReadFrom,
    Statement,
    fills,
    near,
)

TEXT, AXIS = ReadFrom.TEXT, ReadFrom.AXIS
TRUE = "a sentence that holds or does not"
CLEAR, UNCLEAR = 2.5, 2.0  # m: above the one prestress decides, below the other it does not

SUPPORTS = (
    "neither supports nor weight are told, and the text's heights, 1 to 4 m, are not those of the figure's axis, 0 to "
    "9 m. If the text's numbers are amplitudes, waves are 2 to 8 m high, as the axis has them, and a beam that is "
    "clamped at both ends fulfils every sentence (rows with 'doubled'). Half of a beam in waves of 1 to 4 m has its "
    "second bending motion at their frequencies, and swings by much less"
)
CONTRADICTION = "text and axis contradict each other; both readings are computed"


def amplitude(run: BeamRun, beam: str, height: float) -> float:
    """[m] of the stage that swings most along the waves."""
    return float(run.of(label_of(beam, height), "along").max())


def grows(run: BeamRun, heights: Sequence[float]) -> bool:
    """Whether every beam swings more in higher waves."""
    return all(rises([amplitude(run, beam, height) for height in heights]) for beam in BY_PRESTRESS)


def falls(run: BeamRun, height: float) -> bool:
    """Whether beams swing less the more they are prestressed."""
    return rises([-amplitude(run, beam, height) for beam in BY_PRESTRESS])


def largest(run: BeamRun) -> float:
    """[m] of all that were run."""
    return max(float(np.max(values["along"])) for values in run.values.values())


def resonant_height(run: BeamRun, label: str, pair: int) -> float:
    """[m] of the wave whose frequency is that of a pair of bending motions in water, counted from 0."""
    omega = float(run.of(label, "in_water")[2 * pair])
    return STEEPNESS * 2 * math.pi * GRAVITY / omega**2


def _row(
    id_: str, place: str, says: str, stated: str, accepted: Interval, tolerance: str, study: str, measure: Measure,
    unit: str = "", known: KnownDifference | None = None, read_from: ReadFrom = TEXT, unjudged: str = "",
    engines: tuple[EngineName, ...] = (),
) -> Statement:  # fmt: skip
    """A row of one study, judged in all its engines unless told otherwise."""
    needs = () if unjudged else (study,)
    return Statement(
        id_, "C.8", place, 196, says, stated, read_from, accepted, tolerance, needs, measure, unit, known,
        engines or STUDIES[study].engines, unjudged,
    )  # fmt: skip


def _on(study: str, measure: Callable[[BeamRun], float | bool]) -> Measure:
    return lambda runs: measure(runs[study])


# fmt: off
def _rows() -> Iterator[Statement]:
    figure = "§C.2, Fig. C.8"
    yield _row(
        "C.8-heights", figure, "heights of the waves", "1 to 4 m in the text, 0 to 9 m on the axis", Interval(), "none",
        PRINTED, lambda runs: math.nan, unjudged=CONTRADICTION,
    )
    readings = (
        ("", "half of a beam, waves of 1 to 4 m", PRINTED, HEIGHTS, 1, 0.75),
        ("-doubled", "clamped beam, waves of 2 to 8 m", DOUBLED, TWICE, 2, math.nan),
    )
    for suffix, what, study, heights, times, ours in readings:
        high = [height for height in heights if height > times * CLEAR]
        low = [height for height in heights if height < times * UNCLEAR]
        differs = suffix == ""
        for name, says, stated, measure in (
            ("grows", "all beams swing more in higher waves", "increases with the wave height",
             lambda run, heights=heights: grows(run, heights)),
            ("order", f"in waves of {high[0]:g} to {high[-1]:g} m: less from TB1 to TB4 at every height",
             "decreases with increasing prestress above 2.5 m",
             lambda run, high=high: all(falls(run, h) for h in high)),
            ("no-order", f"in waves of {low[0]:g} to {low[-1]:g} m: not less from TB1 to TB4 at any height",
             "no clear correlation below 2.0 m", lambda run, low=low: not any(falls(run, h) for h in low)),
        ):
            yield _row(
                f"C.8-{name}{suffix}", figure, f"{what}: {says}", stated, HOLDS, TRUE, study, _on(study, measure),
                known=KnownDifference(SUPPORTS, near(0.0, 0.0)) if differs and name == "order" else None,
                engines=(EngineName.DAE,),  # MuJoCo confirms single points
            )
        yield _row(
            f"C.8-axis{suffix}", "Fig. C.8", f"{what}: largest amplitude", "axis to 3 m, ticks of 0.5", fills(3.0, 0.5),
            FITS, study, _on(study, largest), "m",
            KnownDifference(SUPPORTS, near(ours, 0.03)) if differs else None, AXIS,
        )
    ends = (("guided", 1, 1, "half of a beam: second"), ("clamped", 0, 2, "clamped beam: first"))
    for end, pair, times, words in ends:
        for beam in BY_PRESTRESS[::3]:
            text = "" if times == 1 else "half the "
            yield _row(
                f"C.8-resonance-{end}-{beam}", "§C.2",
                f"{words} bending frequency in water, {beam}: {text}height of the wave that has it",
                "resonance, where prestress does not decide", near(2.25, 0.75),
                "from 2.0 to 2.5 m the picture changes; 0.5 m each way, the width of a resonance", MODES,
                lambda runs, beam=beam, end=end, pair=pair, times=times:  # type: ignore[misc]
                resonant_height(runs[MODES], f"{beam} {end}", pair) / times, "m",
            )
    yield _row(
        "C.8-damping", "§C.2",
        "TB1 clamped, waves of 6 m: amplitude with strings damped by 400 N s/m over that without",
        "limited numerical damping", near(1.0, 0.05), "5 %: limited", OPEN,
        _on(OPEN, lambda run: _swing(run, "strings damped by 400 N s/m") / _swing(run, CHOSEN)),
    )


def _swing(run: BeamRun, label: str) -> float:
    return float(run.of(label, "along").max())


STATEMENTS: tuple[Statement, ...] = tuple(_rows())
