"""The studies of appendix C.2: which beams are tried in which waves, and in which engine.

The thesis does not tell how its beams are held, and contradicts itself on the waves: its text has heights of 1 to 4 m,
the axis of figure C.8 goes to 9 m. Two readings are computed:

    as printed   half of a clamped beam, as C.1 holds it across its axis, in waves of 1 to 4 m
    doubled      a whole beam, clamped at both ends, in waves of 2 to 8 m, whose amplitudes are 1 to 4 m
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from tensegrity_mj.thesis.appendix_c import beam_wave_tasks
from tensegrity_mj.thesis.appendix_c.beams import BY_PRESTRESS, BeamStudy, Values
from tensegrity_mj.thesis.experiments import EngineName

PRINTED, DOUBLED, OPEN, MODES = "beam-waves", "beam-waves-doubled", "beam-waves-open", "beam-waves-modes"

HEIGHTS = (1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0)  # m, of the text
TWICE = tuple(2 * height for height in HEIGHTS)
CLAMPED_DURATION = 60.0  # s: its slowest motion is four times as fast as that of half a beam, and settles sooner
CONFIRMED = ("TB1 8 m", "TB4 8 m")  # by MuJoCo
SOURCES = ("thesis/appendix_c/beam_wave_tasks.py",)

CHOSEN = "as in the figure"
# What the thesis leaves open, and numbers of ours: TB1, clamped, in waves of 6 m, with one thing changed.
CHANGES: Mapping[str, Values] = {
    CHOSEN: {},
    "half the step": {"timestep": 0.5 * beam_wave_tasks.TIMESTEP},
    "6 segments": {"beam": {"segments": 6}},
    "strings damped by 400 N s/m": {"beam": {"damping": 400.0}},
    "another phase": {"beam": {"phase": 2.0}},
    "its weight acts": {"beam": {"weight": "hanging"}},
}


def label_of(beam: str, height: float) -> str:
    """The name of a point's values."""
    return f"{beam} {height:g} m"


def _grid(heights: tuple[float, ...], **more: Any) -> dict[str, Values]:
    return {
        label_of(beam, height): {"beam": {"which": beam, "wave_height": height, **more}}
        for height in heights
        for beam in BY_PRESTRESS
    }


_CLAMPED: Values = {"end": "clamped", "duration": CLAMPED_DURATION}
_DAE, _MUJOCO, _STATICS = EngineName.DAE, EngineName.MUJOCO, EngineName.STATICS

STUDIES: Mapping[str, BeamStudy] = {
    one.name: one
    for one in (
        BeamStudy(
            PRINTED, "Fig. C.8: half of a clamped beam in waves of 1 to 4 m", _grid(HEIGHTS),
            {_DAE: beam_wave_tasks.in_waves}, sources=SOURCES,
        ),
        BeamStudy(
            DOUBLED, "Fig. C.8: a beam clamped at both ends in waves of 2 to 8 m", _grid(TWICE, **_CLAMPED),
            dict.fromkeys((_DAE, _MUJOCO), beam_wave_tasks.in_waves), of_mujoco=CONFIRMED,
            sources=SOURCES,
        ),
        BeamStudy(
            OPEN, "Fig. C.8: what the thesis leaves open, TB1 clamped in waves of 6 m",
            {
                label: {**change, "beam": {"which": "TB1", "wave_height": 6.0, **_CLAMPED, **change.get("beam", {})}}
                for label, change in CHANGES.items()
            },
            {_DAE: beam_wave_tasks.in_waves}, sources=SOURCES,
        ),
        BeamStudy(
            MODES, "§C.2: natural frequencies in water",
            {
                f"{beam} {end}": {"beam": {"which": beam, "end": end}}
                for end in ("guided", "clamped") for beam in BY_PRESTRESS
            },
            {_STATICS: beam_wave_tasks.modes}, sources=SOURCES,
        ),
    )
}  # fmt: skip
