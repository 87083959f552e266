"""Rows that chapters 5 and 6 share: figures of the same panels, for the pinned rod and for the prism."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from tensegrity_mj.reproduction import measures
from tensegrity_mj.reproduction.statement import (
    FITS,
    INSIDE,
    Interval,
    KnownDifference,
    ReadFrom,
    Statement,
    fills,
    inside,
    near,
    of,
)

TRANSIENT = 1.0  # s; the first instants, which a panel of 60 s does not resolve
LINE = 0.02  # of a panel's height: what the thickness of a line hides
OUT_OF_PANEL = (
    "the law's value at rest, where a = M⁻ᵀYᵀe: it follows from the printed data alone, and lies beyond the axis for "
    "at most half a second, one line's width of the 60 s shown. All panels of figs. 5.4 and 6.4 have the same axes, "
    "set by hand"
)

# Largest u and lowest λ of the first instant: ours, with 1 % for the sampling and nothing for the physics.
_FIRST_U = {"pinned": 0.08019, "pinned-p1": 0.08124, "pinned-pinf": 0.07289, "pinned-fast": 0.10692}
_FIRST_LAMBDA = {"pinned": -0.4760, "pinned-p1": -0.4693, "pinned-pinf": -0.5224, "pinned-fast": -0.6347}
BELOW_THE_AXIS = KnownDifference(
    "for 0.9 s of 60, about 14 s, λ is below the axis, just when u reaches the top of its own (0.06 N/m). All panels "
    "of figs. 5.4 and 6.4 have the same axes, set by hand",
    near(-0.389, 0.004),
)
EXACT = "exact in the law; the integration's tolerance, 1e-10 of V(0), over V at the end, 1e-5 of V(0)"
SAMPLED = "sampled each 1/60000 of the run: V̇ = −δV holds at the samples only, to the first order in the period"


def _first_u(name: str) -> KnownDifference | None:
    if name not in _FIRST_U:
        return None
    return KnownDifference(OUT_OF_PANEL, near(_FIRST_U[name], 0.01 * _FIRST_U[name]))


def _first_multiplier(name: str) -> KnownDifference | None:
    if name not in _FIRST_LAMBDA:
        return BELOW_THE_AXIS if name == "projection" else None
    return KnownDifference(OUT_OF_PANEL, near(_FIRST_LAMBDA[name], -0.01 * _FIRST_LAMBDA[name]))


# Rows read better with several arguments on a line.
# fmt: off


def parameter_statements(
    figure: str, section: str, page: int, name: str, mass: float, length: str
) -> Iterator[Statement]:
    """Mass and length of every rod."""
    yield Statement(
        f"{figure}-mass", figure, section, page, "mass of a rod", f"{mass:g} kg", ReadFrom.TEXT, near(mass, 1e-12),
        "printed exactly", (name,), of(name, lambda run: float(run.scene.structure.rod_masses.max())), "kg",
    )
    yield Statement(
        f"{figure}-length", figure, section, page, "length of a rod", f"{length} m", ReadFrom.TEXT,
        near(math.sqrt(2.0) if length == "√2" else 1.0, 1e-12), "printed exactly", (name,),
        of(name, lambda run: float(run.scene.structure.rod_lengths.max())), "m",
    )


def panel_statements(
    figure: str, panel: str, name: str, title: str, page: int, decay_rate: float
) -> Iterator[Statement]:
    """The rows of one line of panels of figures 5.4 and 6.4: coordinates, controls, λ."""
    place, start = f"Fig. {figure}({panel})", f"{figure}{panel}"
    sampled = name in ("pinned-p1", "pinned-pinf")
    yield Statement(
        f"{start}-coordinates", figure, place, page, f"{title}: lowest coordinate of b", "axis to −0.5, ticks of 0.5",
        ReadFrom.AXIS, inside(-1.0, -0.25), FITS, (name,), of(name, measures.lowest_coordinate),
    )
    yield Statement(
        f"{start}-final", figure, place, page, f"{title}: at 60 s every coordinate lies on its dotted target",
        "0 between the lines", ReadFrom.CURVES, Interval(0.0, LINE), "the thickness of a line, 2 % of the panel",
        (name,), of(name, measures.final_coordinate_error),
    )
    yield Statement(
        f"{start}-norm", figure, place, page, f"{title}: largest | ‖b‖ − 1 | (dashed line)", "‖b‖² = 1",
        ReadFrom.CURVES, Interval(0.0, 1e-9), "a constraint; the engines keep it to their tolerance", (name,),
        of(name, measures.unit_length_error),
    )
    yield Statement(
        f"{start}-u", figure, place, page, f"{title}: largest u after the first second",
        "axis to 0.06 N/m, ticks of 0.01", ReadFrom.AXIS, fills(0.06, 0.01), FITS, (name,),
        of(name, lambda run: measures.peak(run, TRANSIENT)), "N/m",
    )
    yield Statement(
        f"{start}-u-first", figure, place, page, f"{title}: largest u of the whole run",
        "axis to 0.06 N/m, ticks of 0.01", ReadFrom.AXIS, fills(0.06, 0.01), FITS, (name,), of(name, measures.peak),
        "N/m",
        _first_u(name),
    )
    yield Statement(
        f"{start}-lambda", figure, place, page, f"{title}: lowest λ after the first second",
        "axis to −0.3 1/s², ticks of 0.05", ReadFrom.AXIS, fills(-0.3, 0.05), FITS, (name,),
        of(name, lambda run: measures.lowest_multiplier(run, TRANSIENT)), "1/s²",
        BELOW_THE_AXIS if name == "projection" else None,
    )
    yield Statement(
        f"{start}-lambda-first", figure, place, page, f"{title}: lowest λ of the whole run",
        "axis to −0.3 1/s², ticks of 0.05", ReadFrom.AXIS, fills(-0.3, 0.05), FITS, (name,),
        of(name, lambda run: measures.lowest_multiplier(run, 0.0)), "1/s²", _first_multiplier(name),
    )
    yield Statement(
        f"{start}-lambda-top", figure, place, page, f"{title}: highest λ", "axis to 0, ticks of 0.05", ReadFrom.AXIS,
        inside(-0.05, 0.05), INSIDE, (name,), of(name, measures.highest_multiplier), "1/s²",
    )
    yield Statement(
        f"{start}-decay", figure, place, page,
        f"{title}: largest deviation of V(t) from V(0) e^(−δt), δ = {decay_rate:.2f}", "0 (exponential convergence)",
        ReadFrom.CAPTION, Interval(0.0, 0.01 if sampled else 1e-5), SAMPLED if sampled else EXACT, (name,),
        of(name, lambda run: measures.decay_error(run, decay_rate)),
    )


def prism_statements(error_figure: str, path_figure: str, name: str, pages: tuple[int, int]) -> Iterator[Statement]:
    """The rows of figures 5.6 and 5.7, or 6.8 and 6.9."""
    paths, errors = f"Fig. {path_figure}", f"Fig. {error_figure}"
    for axis, letter, high in ((0, "x", 1.0), (1, "y", 1.0), (2, "z", 1.0)):
        low, from_text = (-0.4, "−0.2") if letter != "z" else (-0.2, "0")
        yield Statement(
            f"{path_figure}-{letter}", path_figure, paths, pages[0], f"largest {letter} of the nodes",
            f"axis from {from_text} to 0.8 m, ticks of 0.2", ReadFrom.AXIS, Interval(0.4, high), FITS, (name,),
            of(name, measures.largest_coordinate, axis), "m",
        )
        yield Statement(
            f"{path_figure}-{letter}-low", path_figure, paths, pages[0], f"smallest {letter} of the nodes",
            f"axis from {from_text} to 0.8 m, ticks of 0.2", ReadFrom.AXIS, Interval(low, 0.0001), INSIDE, (name,),
            of(name, measures.smallest_coordinate, axis), "m",
        )
    yield Statement(
        f"{path_figure}-height", path_figure, f"§5.5, {paths}", 124, "height at 10 s", "0.6 m", ReadFrom.TEXT,
        near(0.6, 0.005), "drawn as the final configuration: 2 % of the axis' 0.2 m ticks", (name,),
        of(name, lambda run: measures.height(run, run.nodes[-1])), "m",
    )
    yield Statement(
        f"{error_figure}-error", error_figure, errors, pages[1], "largest error, ‖e_b‖ or ‖e_r‖",
        "axis to 0.3 m, ticks of 0.05", ReadFrom.AXIS, fills(0.3, 0.05), FITS, (name,),
        of(name, lambda run: float(measures.errors(run).max())), "m",
    )
    yield Statement(
        f"{error_figure}-first", error_figure, f"§5.5, {errors}", 124,
        "‖e_b(0)‖ of the three rods, from the printed vectors", "0.2828", ReadFrom.TEXT,
        near(math.hypot(0.2, 0.2), 5e-5), "a quarter unit of the last printed digit in each component", (name,),
        of(name, lambda run: float(measures.rotation_errors(run)[0].mean())),
    )
    yield Statement(
        f"{error_figure}-final", error_figure, errors, pages[1], "largest error at 10 s", "0 m", ReadFrom.CURVES,
        Interval(0.0, LINE * 0.3), "the thickness of a line, 2 % of the panel", (name,),
        of(name, lambda run: float(measures.errors(run)[-1].max())), "m",
    )
    yield Statement(
        f"{error_figure}-u", error_figure, errors, pages[1], "largest u", "axis to 0.15 N/m, ticks of 0.05",
        ReadFrom.AXIS, fills(0.15, 0.05), FITS, (name,), of(name, measures.peak), "N/m",
    )
    yield Statement(
        f"{error_figure}-lambda", error_figure, errors, pages[1], "lowest λ", "axis to −0.5 1/s², ticks of 0.1",
        ReadFrom.AXIS, fills(-0.5, 0.1), FITS, (name,), of(name, lambda run: measures.lowest_multiplier(run, 0.0)),
        "1/s²",
    )
    yield Statement(
        f"{error_figure}-lambda-top", error_figure, errors, pages[1], "highest λ", "axis to 0, ticks of 0.1",
        ReadFrom.AXIS, inside(-0.1, 0.1), INSIDE, (name,), of(name, measures.highest_multiplier), "1/s²",
    )
    yield Statement(
        f"{error_figure}-final-lambda", error_figure, errors, pages[1],
        "largest |λ| at 10 s: strings have gone slack", "0", ReadFrom.CURVES, Interval(0.0, LINE * 0.5),
        "the thickness of a line, 2 % of the panel", (name,), of(name, measures.final_multiplier), "1/s²",
    )
    yield Statement(
        f"{error_figure}-decay", error_figure, f"§5.6, {errors}" if error_figure == "5.7" else f"(6.17), {errors}",
        125 if error_figure == "5.7" else 132, "largest deviation of V(t) from V(0) e^(−δt), δ = 1",
        "0 (exponential convergence)", ReadFrom.TEXT, Interval(0.0, 1e-5), EXACT, (name,),
        of(name, lambda run: measures.decay_error(run, 1.0)),
    )
    if error_figure == "6.9":
        return  # what follows is said of chapter 5's examples alone
    yield Statement(
        f"{error_figure}-feasible", error_figure, "§5.3", 117,
        "smallest margin max(v/α) of (5.18)", "> 0: infeasibility never occurred", ReadFrom.TEXT, Interval(1e-6),
        "positive", (name,), of(name, lambda run: run.min_feasibility_margin), "m²",
    )
    yield Statement(
        f"{error_figure}-all", error_figure, "§5.6", 126, "p = 2: strings that pull at some time", "all 12",
        ReadFrom.TEXT, near(12.0, 0.0), "a count", (name,),
        of(name, lambda run: int(np.sum(run.force_densities.max(axis=0) > measures.ACTIVE))),
    )
