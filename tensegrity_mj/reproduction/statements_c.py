"""What appendix C.1 of the thesis states of the strength of seven tensegrity beams: form, stiffness, buckling."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from functools import cache

import numpy as np

from tensegrity_mj.families.thesis_towers import TABLE_C2, appendix_beam
from tensegrity_mj.reproduction.beam_tasks import INITIAL_LENGTH
from tensegrity_mj.reproduction.beams import BEAMS, BY_PRESTRESS, BY_STIFFNESS, PRINTED, STUDIES, BeamRun
from tensegrity_mj.reproduction.experiments import EngineName
from tensegrity_mj.reproduction.measures_c import (
    anisotropy,
    apart,
    before_buckling,
    buckling,
    first_slack,
    gain,
    initial,
    largest_stress,
    last,
    length_ratio,
    median_stress,
    rises,
    spread,
    stiffest_before,
    stiffness,
    stress_rate,
    turns_negative,
)
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
from tensegrity_mj.scene import Scene
from tensegrity_mj.section import Section

TEXT, AXIS, CURVES = ReadFrom.TEXT, ReadFrom.AXIS, ReadFrom.CURVES
STATICS, BOTH = (EngineName.STATICS,), (EngineName.STATICS, EngineName.MUJOCO)
DRAWN = ("C.2", "C.3", "C.4", "C.6", "C.7")

TRUE = "a sentence that holds or does not"
ROUNDED = "two printed digits, and half as much for what is between 'about' and them"
STRESS = "5 %: the printed digit makes 2 to 6 %"
ABOUT_SAME = (
    "'approximately the same', 'close to constant': 20 %; what is said to change does by two to three times that"
)

TABLE = (
    "Table C.2 contradicts itself: TB6 has 1.5 times the tension and 1.5 times the spring stiffness of TB1, so it is "
    "TB1 with 1.5 times its forces; TB7 has nearly TB2's ratio of both at 1.5 times its stiffness. The rows with a "
    "star have what the rest asks for"
)
ROUND_SPRINGS = (
    "springs of exactly 9 MPa are 1160 (TB5), 1522 (TB6) and 1957 kN/m (TB7); stress falls steeply with the stiffness "
    "at given tension, and 1200, 1600 and 2000 kN/m are what these round to"
)
BRANCH = (
    "the perfect beam may stay straight: its stiffness never drops, it only becomes unstable, in two bending motions "
    "at once. What drops is the stiffness of the bent beam, on the path of an imperfect one"
)
BENDING = (
    "across the beam the springs resist from the start, as they do not along it: at equal prestress the stiffness goes "
    "from 0.14 to 0.33 kN/m with 2.5 times stiffer springs. It is a thirtieth of the figure's axis, which hides it"
)
ENDS = (
    "TB7* passes 32 kN/m at 1.57 m; where the thesis' curves end is not told, and the true springs of TB7 are not known"
)
SIZE = (
    "it hangs on the imperfection, which the thesis does not tell: TB1 and TB5 are 17 % apart with 10 N across the "
    "middle, and 27 % with the 100 N of this row. TB5 to TB7* also have 6 to 12 % less prestress than TB1, and buckle "
    "later for it"
)
SAME_AXES = (
    "either panel (a) has the axis of panel (b), which TB4 fills from the start, or the thesis' beams stayed straight "
    "well beyond where they become unstable, as perfect ones may: then `C.4a-axis` fits"
)
ORDER = (
    "which comes first hangs on the imperfection: TB2's first string becomes slack by the bending itself, soon after "
    "it has begun. The perfect beam has no slack string at all up to 3.5 m"
)


def _row(
    id_: str, place: str, page: int, says: str, stated: str, read_from: ReadFrom, accepted: Interval, tolerance: str,
    needs: tuple[str, ...], measure: Measure, unit: str = "", known: KnownDifference | None = None,
) -> Statement:  # fmt: skip
    """A row whose figure is that of its id, judged in the engines that compute all its studies."""
    engines = BOTH if all(EngineName.MUJOCO in STUDIES[name].engines for name in needs) else STATICS
    return _row_in(engines, id_, place, page, says, stated, read_from, accepted, tolerance, needs, measure, unit, known)


def _row_in(
    engines: tuple[EngineName, ...], id_: str, place: str, page: int, says: str, stated: str, read_from: ReadFrom,
    accepted: Interval, tolerance: str, needs: tuple[str, ...], measure: Measure, unit: str = "",
    known: KnownDifference | None = None, unjudged: str = "",
) -> Statement:  # fmt: skip
    head = id_.partition("-")[0]
    return Statement(
        id_, head if head in DRAWN else "", place, page, says, stated, read_from, accepted, tolerance, needs, measure,
        unit, known, engines, unjudged,
    )  # fmt: skip


def _unjudged(id_: str, place: str, page: int, says: str, stated: str, why: str) -> Statement:
    return _row_in(
        STATICS, id_, place, page, says, stated, TEXT, Interval(), "none", (), lambda runs: math.nan, unjudged=why
    )


def _on(name: str, measure: Callable[[BeamRun], float | bool]) -> Measure:
    """The measure of one study."""
    return lambda runs: measure(runs[name])


def _through(name: str, value: Callable[[BeamRun, str], float], beams: Sequence[str]) -> Callable[[Runs], list[float]]:
    """A value of each of these beams."""
    return lambda runs: [value(runs[name], beam) for beam in beams]


@cache
def _scene() -> Scene:
    return appendix_beam("TB1", form_found=False)


def _section() -> Section:
    section = _scene().structure.rods[0].section
    assert section is not None
    return section


def _euler_stress() -> float:
    """[MPa]."""
    return _section().euler_load(float(_scene().structure.rod_lengths[0])) / _section().area / 1e6


# Rows read better with several arguments on a line.
# fmt: off


def _form() -> Iterator[Statement]:
    beams, model = ("beams",), ("beams",)
    yield _row_in(
        STATICS, "C.1.1-stages", "§C.1.1", 185, "rods of the beam", "thirty cells of three rods", TEXT, near(90, 0),
        "a count", model, lambda runs: float(len(_scene().structure.rods)),
    )
    yield _row_in(
        STATICS, "C.1.1-rod", "§C.1.1, Table C.1", 187, "length of a rod, with sides and height of one metre",
        "1414 mm", TEXT, near(1.414, 0.0005), "its last digit", model,
        lambda runs: float(_scene().structure.rod_lengths[0]), "m",
    )
    yield _row_in(
        STATICS, "C.1.3-euler", "Table C.1", 187, "Euler buckling load of a rod", "3189 kN", TEXT, near(3189, 8),
        "0.25 %: a radius of gyration rounded to 31.7 mm gives both printed numbers", model,
        lambda runs: _section().euler_load(float(_scene().structure.rod_lengths[0])) / 1e3, "kN",
    )
    yield _row_in(
        STATICS, "C.1.3-euler-stress", "Table C.1", 187, "Euler buckling stress of a rod", "1041 MPa", TEXT,
        near(1041, 2.6), "0.25 %, as of the load", model, lambda runs: _euler_stress(), "MPa",
    )
    yield _row_in(
        STATICS, "C.1.3-yields", "§C.1.3", 187, "buckling stress of a rod over its yield stress",
        "above the yield stress", TEXT, Interval(1.0), "above it", model,
        lambda runs: 1e6 * _euler_stress() / float(_section().yield_stress or 0.0),
    )
    yield _row_in(
        STATICS, "C.1.3-no-yield", "§C.1.3", 187,
        "largest stress of a rod in any case, all beams as printed and corrected",
        "none reached yield, 200 MPa", TEXT, Interval(0.0, 200.0), "the yield stress",
        ("tension", "compression", "imperfect", "lateral"),
        lambda runs: largest_stress([runs[name] for name in ("tension", "compression", "imperfect", "lateral")]), "MPa",
    )
    yield _row_in(
        STATICS, "C.1.2-tensegrity", "§C.1.2", 187,
        "after form-finding: every rod is in compression, every string in tension, in all beams",
        "all combinations fulfil this", TEXT, HOLDS, TRUE, beams,
        _on("beams", lambda run: all(
            min(v["stresses"]) > 0 and v["least_tension"] > 0 for v in run.values.values())),
    )
    yield _row_in(
        STATICS, "C.1.1-length", "§C.1.1", 186, "length after form-finding, mean of the seven beams",
        "about 25 m, from 30 m", TEXT, near(25.0, 1.0), "'about': Table C.2's own ratios make 25.2 to 25.8 m", beams,
        lambda runs: INITIAL_LENGTH * float(np.mean(_through("beams", length_ratio, PRINTED)(runs))), "m",
    )
    yield _row_in(
        STATICS, "C.2-overlap", "§C.1.4, Fig. C.2", 189, "TB1 after form-finding: a stage reaches into the next by",
        "stages overlap; 0 before", TEXT, Interval(0.01, 0.5), "it can be seen, and is less than half a cell", beams,
        _on("beams", lambda run: float(run.of("TB1", "overlap"))), "m",
    )
    for beam in BEAMS:
        row = TABLE_C2[beam.rstrip("*")]
        star = beam.endswith("*")
        what = f"{beam}{', springs as corrected' if star else ''}"
        both = beam in BY_PRESTRESS
        yield _row_in(
            BOTH if both else STATICS, f"C.2-{beam}-ratio", "Table C.2", 189, f"{what}: length after over before",
            f"{row.length_ratio:g}", TEXT, near(row.length_ratio, 0.01), ROUNDED, beams,
            _on("beams", lambda run, beam=beam: length_ratio(run, beam)),  # type: ignore[misc]
        )
        yield _row_in(
            STATICS, f"C.2-{beam}-stress", "Table C.2", 189, f"{what}: median of the rods' stress after form-finding",
            f"{row.stress / 1e6:g} MPa", TEXT, near(row.stress / 1e6, 0.05 * row.stress / 1e6), STRESS, beams,
            _on("beams", lambda run, beam=beam: median_stress(run, beam)), "MPa", _stress_known(beam),  # type: ignore[misc]
        )
    yield _row_in(
        STATICS, "C.2-contraction", "§C.1.4", 189, "largest ratio of the lengths less the smallest, seven beams",
        "nearly equal; 0.86 − 0.84", TEXT, near(0.02, 0.01), "the printed digits", beams,
        lambda runs: float(np.ptp(_through("beams", length_ratio, PRINTED)(runs))),
    )
    yield _row_in(
        STATICS, "C.2-rigid", "§C.1.3", 187, "TB4: median stress with rigid rods over that with elastic ones",
        "rods of finite stiffness", TEXT, near(1.0, 0.01), "1 %, below every tolerance here", beams,
        _on("beams", lambda run: float(run.of("TB4", "rigid_stress")) / 1e6 / median_stress(run, "TB4")),
    )


def _stress_known(beam: str) -> KnownDifference | None:
    ours = {"TB5": 8.45, "TB6*": 7.93, "TB7*": 8.42, "TB6": 13.52, "TB7": 19.70}
    if beam not in ours:
        return None
    return KnownDifference(TABLE if beam in ("TB6", "TB7") else ROUND_SPRINGS, near(ours[beam], 0.05))


def _tension() -> Iterator[Statement]:
    drawn = ("tension",)
    for beam, value in zip(BY_PRESTRESS, (10.8, 16.3, 21.5, 30.6), strict=True):
        yield _row(
            f"C.3-{beam}-initial", "Fig. C.3(b)", 190, f"{beam}: axial stiffness at zero load", f"about {value} kN/m",
            CURVES, near(value, 0.03 * value), "3 %: a line's thickness, and reading it", ("beams",),
            _on("beams", lambda run, beam=beam: initial(run, beam)), "kN/m",  # type: ignore[misc]
        )
    yield _row(
        "C.3-increases", "§C.1.4, Fig. C.3", 190, "all beams: the stiffness in tension increases with the deformation",
        "increases uniformly", TEXT, HOLDS, TRUE, drawn,
        _on("tension", lambda run: all(rises(stiffness(run, beam)) for beam in BEAMS)),
    )
    yield _row(
        "C.3a-initial", "§C.1.4, Fig. C.3(a)", 190, "TB1, TB5, TB6*, TB7*: most initial stiffness over least, less one",
        "more or less independent of the springs", TEXT, Interval(0.0, 0.15),
        "'more or less': 15 %, a tenth of what prestress does to it", drawn,
        _on("tension", lambda run: spread([stiffness(run, beam)[0] for beam in BY_STIFFNESS])),
    )
    yield _row(
        "C.3a-initial-printed", "§C.1.4, Fig. C.3(a)", 190, "TB1, TB5, TB6, TB7 as printed: the same",
        "more or less independent of the springs", TEXT, Interval(0.0, 0.15), "as above", drawn,
        _on("tension", lambda run: spread([stiffness(run, beam)[0] for beam in ("TB1", "TB5", "TB6", "TB7")])),
        known=KnownDifference(TABLE, near(1.2, 0.15)),
    )
    yield _row(
        "C.3a-steeper", "§C.1.4, Fig. C.3(a)", 190, "TB1, TB5, TB6*, TB7*: the stiffness rises ever more",
        "steeper with high spring stiffness", TEXT, HOLDS, TRUE, drawn,
        lambda runs: rises(_through("tension", gain, BY_STIFFNESS)(runs)),
    )
    yield _row(
        "C.3a-stress", "§C.1.4", 190, "TB1, TB5, TB6*, TB7*: the stress rises ever more",
        "at a higher rate with higher spring stiffness", TEXT, HOLDS, TRUE, drawn,
        lambda runs: rises(_through("tension", stress_rate, BY_STIFFNESS)(runs)),
    )
    yield _row(
        "C.3b-higher", "§C.1.4, Fig. C.3(b)", 190, "TB1 to TB4: the stiffness is higher at every deformation",
        "clearly higher for higher prestress", TEXT, HOLDS, TRUE, drawn,
        _on("tension", lambda run: all(
            np.all(np.interp(run.of(a, "w"), run.of(b, "w"), stiffness(run, b)) > stiffness(run, a))
            for a, b in itertools.pairwise(BY_PRESTRESS))),
    )
    yield _row(
        "C.3b-same-slope", "§C.1.4, Fig. C.3(b), Table C.3", 190,
        "TB1 to TB4: most rise of the stiffness over least, less one", "the slopes are the same", TEXT,
        Interval(0.0, 0.2), ABOUT_SAME, drawn, lambda runs: spread(_through("tension", gain, BY_PRESTRESS)(runs)),
    )
    for letter, beams, ticks in (("a", BY_STIFFNESS, (30.0, 2.0)), ("b", BY_PRESTRESS, (40.0, 5.0))):
        yield _row(
            f"C.3{letter}-axis", f"Fig. C.3({letter})", 190, f"{', '.join(beams)}: largest stiffness up to 1.6 m",
            f"axis to {ticks[0]:g} kN/m, ticks of {ticks[1]:g}", AXIS, fills(*ticks), FITS, drawn,
            lambda runs, beams=beams: max(_through("tension", last, beams)(runs)), "kN/m",  # type: ignore[misc]
            KnownDifference(ENDS, near(32.6, 0.1)) if letter == "a" else None,
        )


def _compression() -> Iterator[Statement]:
    pushed, bent = ("compression",), ("imperfect",)
    both = (*pushed, *bent)

    def deformations(runs: Runs, beams: Sequence[str]) -> list[float]:
        return [buckling(runs["imperfect"], beam).deformation for beam in beams]

    def loads(runs: Runs, beams: Sequence[str]) -> list[float]:
        return [buckling(runs["imperfect"], beam).load for beam in beams]

    yield _row(
        "C.4-identical", "§C.1.4, Figs C.3(a), C.4(a)", 191,
        "all beams: largest difference of the first stiffness in compression from that in tension", "identical", TEXT,
        Interval(0.0, 1e-6), "the same tangent on both paths, to round-off", ("tension", *pushed),
        lambda runs: max(
            abs(stiffness(runs["compression"], beam)[0] / stiffness(runs["tension"], beam)[0] - 1.0) for beam in BEAMS),
    )
    yield _row(
        "C.4-faster-in-tension", "§C.1.4", 191,
        "all beams: at 1 m in tension the stiffness has risen more than in compression",
        "higher in tension than in compression", TEXT, HOLDS, TRUE, ("tension", *pushed),
        lambda runs: all(_at(runs["tension"], b, 1.0) > _at(runs["compression"], b, 1.0) for b in BEAMS),
    )
    yield _row(
        "C.4-drop", "§C.1.4, Fig. C.4", 191, "all imperfect beams: the stiffness drops to below zero",
        "leaves it negative", TEXT, HOLDS, TRUE, bent,
        _on("imperfect", lambda run: all(turns_negative(run, beam) for beam in BEAMS)),
    )
    yield _row(
        "C.4-drop-perfect", "§C.1.4, Fig. C.4", 191,
        "TB1, perfect and straight: least stiffness up to 3.5 m over the first",
        "leaves it negative", TEXT, Interval(high=0.0), "below zero", pushed,
        _on("compression", lambda run: float(stiffness(run, "TB1").min() / stiffness(run, "TB1")[0])),
        known=KnownDifference(BRANCH, near(0.96, 0.02)),
    )
    yield _row(
        "C.4-pairs", "§C.1.4", 191, "all perfect beams: motions that become unstable at once",
        "the beam will buckle", TEXT, near(2, 0), "bending has no preferred direction: two", pushed,
        _on("compression", lambda run: float(np.mean([run.values[beam]["modes"] for beam in BEAMS]))),
    )
    for beam in BEAMS:
        yield _row_in(
            STATICS, f"C.4-{beam}-deformation", "Fig. C.4", 192, f"{beam}: deformation at which it buckles",
            "in the curves alone", CURVES, Interval(0.0, 3.5), "on the thesis' axis", bent,
            _on("imperfect", lambda run, beam=beam: buckling(run, beam).deformation), "m",  # type: ignore[misc]
        )
    yield _row(
        "C.4a-initial", "§C.1.4, Fig. C.4(a)", 191, "TB1, TB5, TB6*, TB7*: most initial stiffness over least, less one",
        "more or less independent of the springs", TEXT, Interval(0.0, 0.15), "as in tension", pushed,
        _on("compression", lambda run: spread([stiffness(run, beam)[0] for beam in BY_STIFFNESS])),
    )
    yield _row(
        "C.4a-larger", "§C.1.4, Fig. C.4(a)", 191, "TB1, TB5, TB6*, TB7*: the stiffness at 1 m rises from beam to beam",
        "the increase is larger for higher spring stiffness", TEXT, HOLDS, TRUE, pushed,
        _on("compression", lambda run: rises([_at(run, beam, 1.0) for beam in BY_STIFFNESS])),
    )
    yield _row(
        "C.4a-deformation", "§C.1.4, Table C.3", 191,
        "TB1, TB5, TB6*, TB7*: most deformation at buckling over least, less one", "approximately the same", TEXT,
        Interval(0.0, 0.2), ABOUT_SAME, bent, lambda runs: spread(deformations(runs, BY_STIFFNESS)),
        known=KnownDifference(SIZE, near(0.44, 0.05)),
    )
    yield _row(
        "C.4a-scaled", "§C.1.4", 191,
        "TB6 as printed, which is TB1 with 1.5 times its forces: deformation at buckling over TB1's",
        "depends on the prestress only", TEXT, near(1.0, 0.05), "the imperfection is not scaled", bent,
        lambda runs: deformations(runs, ("TB6",))[0] / deformations(runs, ("TB1",))[0],
    )
    yield _row(
        "C.4a-load", "§C.1.4, Table C.3", 191, "TB1, TB5, TB6*, TB7*: load at buckling of the last over the first",
        "higher for higher spring stiffness", TEXT, Interval(1.0), "above one", bent,
        lambda runs: loads(runs, BY_STIFFNESS)[-1] / loads(runs, BY_STIFFNESS)[0],
    )
    yield _row(
        "C.4b-early", "§C.1.4, Fig. C.4(b), Table C.3", 191, "TB1 to TB4 buckle at ever smaller deformations",
        "more prestress loses stiffness early", TEXT, HOLDS, TRUE, bent,
        lambda runs: rises(deformations(runs, BY_PRESTRESS[::-1])),
    )
    yield _row(
        "C.4b-load", "Table C.3", 195, "TB1 to TB4: most load at buckling over least, less one", "close to constant",
        TEXT, Interval(0.0, 0.4), "a sixth of what the prestress grows by, 236 %", bent,
        lambda runs: spread(loads(runs, BY_PRESTRESS)),
    )
    orders = {"TB2": ORDER, "TB7": TABLE}
    for beam in BEAMS:
        later = beam in ("TB3", "TB4")
        yield _row(
            f"C.4-{beam}-slack", "§C.1.4", 191, f"{beam}: deformation at the first slack string over that at buckling",
            "strings go slack later" if later else "strings go slack before", TEXT,
            Interval(low=1.0) if later else Interval(0.0, 1.0), "after it or before it", bent,
            _on("imperfect", lambda run, beam=beam: first_slack(run, beam) / buckling(run, beam).deformation),  # type: ignore[misc]
            known=KnownDifference(orders[beam], Interval(1.01, 1.1)) if beam in orders else None,
        )
    yield _row(
        "C.4-kinds", "§C.1.4", 191,
        "change of the stiffness up to buckling: TB4, of less prestress TB1, of stiff springs TB7*",
        "decreasing, constant, increasing", TEXT, HOLDS, "below −2 %, within 2 %, above 2 %", both,
        lambda runs: before_buckling(runs["compression"], runs["imperfect"], "TB4") < -0.02
        and abs(before_buckling(runs["compression"], runs["imperfect"], "TB1")) <= 0.02
        and before_buckling(runs["compression"], runs["imperfect"], "TB7*") > 0.02,
    )
    yield _row(
        "C.4b-slope", "Table C.3", 195, "TB1 to TB4: change of the stiffness up to 0.4 m falls from beam to beam",
        "the slope decreases", TEXT, HOLDS, TRUE, pushed,
        _on("compression", lambda run: rises([-_at(run, b, 0.4) for b in BY_PRESTRESS])),
    )
    for letter, beams in (("a", BY_STIFFNESS), ("b", BY_PRESTRESS)):
        yield _row(
            f"C.4{letter}-axis", f"Fig. C.4({letter})", 192,
            f"{', '.join(beams)}, perfect: largest stiffness up to 3.5 m",
            "axis to 40 kN/m, ticks of 5", AXIS, fills(40.0, 5.0), FITS, pushed,
            lambda runs, beams=beams: max(  # type: ignore[misc]
                float(stiffness(runs["compression"], b).max()) for b in beams), "kN/m",
        )
    yield _row(
        "C.4a-axis-imperfect", "Fig. C.4(a)", 192,
        f"{', '.join(BY_STIFFNESS)}, imperfect: largest stiffness before they buckle", "axis to 40 kN/m, ticks of 5",
        AXIS, fills(40.0, 5.0), FITS, bent,
        lambda runs: max(_through("imperfect", stiffest_before, BY_STIFFNESS)(runs)), "kN/m",
        KnownDifference(SAME_AXES, near(14.0, 1.0)),
    )


def _at(run: BeamRun, label: str, deformation: float) -> float:
    """By how much the stiffness has changed there [kN/m]."""
    K = stiffness(run, label)
    return float(np.interp(deformation, run.of(label, "w"), K) - K[0])


def _lateral() -> Iterator[Statement]:
    moved = ("lateral",)

    def firsts(beams: Sequence[str]) -> Callable[[Runs], list[float]]:
        return lambda runs: [float(stiffness(runs["lateral"], f"{beam} y")[0]) for beam in beams]

    yield _unjudged(
        "C.1.4-node", "§C.1.4", 192, "the stiffness depends on which node of the end is pulled", "sensitively",
        "of these preliminary simulations neither load nor supports are told",
    )
    for beam in BY_PRESTRESS:
        yield _row(
            f"C.6-{beam}-isotropic", "§C.1.4, Figs C.6, C.7", 193,
            f"{beam}: lateral stiffness at zero load, most of any direction over least, less one",
            "the same in both directions", TEXT, Interval(0.0, 0.01), "1 %", ("beams",),
            _on("beams", lambda run, beam=beam: anisotropy(run, beam)),  # type: ignore[misc]
        )
    yield _row(
        "C.7-same", "§C.1.4, Figs C.6, C.7", 193, "all beams: largest difference of the stiffness in y and z up to 8 m",
        "the same in both directions", TEXT, Interval(0.0, 0.5), "half a tick of the axes: they are two figures", moved,
        _on("lateral", lambda run: max(apart(run, beam) for beam in BEAMS)), "kN/m",
    )
    for axis, number, page in (("y", "C.6", 193), ("z", "C.7", 194)):
        for letter, beams in (("a", BY_STIFFNESS), ("b", BY_PRESTRESS)):
            yield _row(
                f"{number}{letter}-axis", f"Fig. {number}({letter})", page,
                f"{', '.join(beams)}: largest lateral stiffness up to 8 m", "axis to 6 kN/m, ticks of 1", AXIS,
                fills(6.0, 1.0), FITS, moved,
                lambda runs, beams=beams, axis=axis: max(last(runs["lateral"], f"{b} {axis}") for b in beams),  # type: ignore[misc]
                "kN/m",
            )
    yield _row(
        "C.6-grows", "§C.1.4, Fig. C.6", 193, "all beams, y and z: the stiffness at 8 m is above that at zero load",
        "increases as deformation grows", TEXT, HOLDS, TRUE, moved,
        _on("lateral", lambda run: all(gain(run, f"{b} {axis}") > 0 for b in BEAMS for axis in "yz")),
    )
    yield _row(
        "C.6b-initial", "§C.1.4, Table C.3", 193, "TB1 to TB4: initial lateral stiffness of the last over the first",
        "a small increase with prestress", TEXT, Interval(1.05), "5 % and more", moved,
        lambda runs: firsts(BY_PRESTRESS)(runs)[-1] / firsts(BY_PRESTRESS)(runs)[0],
    )
    yield _row(
        "C.6a-initial", "§C.1.4, Fig. C.6(a)", 193,
        "TB1, TB5, TB6*, TB7*: most initial lateral stiffness less the least", "no influence of the springs", TEXT,
        Interval(0.0, 0.3), "5 % of the panel: less is not to be seen", moved,
        lambda runs: float(np.ptp(firsts(BY_STIFFNESS)(runs))), "kN/m",
    )
    yield _row(
        "C.6a-relative", "§C.1.4, Table C.3", 193,
        "TB1, TB5, TB6*, TB7*: most initial lateral stiffness over least, less one", "constant", TEXT,
        Interval(0.0, 0.2), ABOUT_SAME, moved, lambda runs: spread(firsts(BY_STIFFNESS)(runs)),
        known=KnownDifference(BENDING, near(1.386, 0.05)),
    )
    yield _row(
        "C.6b-slope", "Table C.3", 195, "TB1 to TB4: the lateral stiffness up to 8 m rises ever more",
        "the slope increases", TEXT, HOLDS, TRUE, moved,
        _on("lateral", lambda run: rises([gain(run, f"{b} y") for b in BY_PRESTRESS])),
    )
    yield _row(
        "C.6a-slope", "Table C.3", 195, "TB1, TB5, TB6*, TB7*: the same", "a small increase", TEXT, HOLDS, TRUE, moved,
        _on("lateral", lambda run: rises([gain(run, f"{b} y") for b in BY_STIFFNESS])),
    )
    yield _unjudged(
        "C.6-skelton", "§C.1.4", 193, "Skelton et al. (2001) saw no increase of the stiffness with the deformation",
        "no increase", "it is about another structure, of two stages, and other boundary conditions",
    )


STATEMENTS: tuple[Statement, ...] = (*_form(), *_tension(), *_compression(), *_lateral())
