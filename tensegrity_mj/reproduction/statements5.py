"""What chapter 5 of the thesis states: Lyapunov control of the pinned rod (§5.4) and of the prism (§5.5)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np

from tensegrity_mj.landscape import angles
from tensegrity_mj.reproduction import measures
from tensegrity_mj.reproduction.shared_rows import LINE, panel_statements, parameter_statements, prism_statements
from tensegrity_mj.reproduction.statement import (
    HOLDS,
    Interval,
    KnownDifference,
    Measure,
    ReadFrom,
    Runs,
    Statement,
    near,
    of,
)
from tensegrity_mj.trajectory import Trajectory


def _initial_b(run: Trajectory) -> float:
    printed = np.array([1.0, -math.sqrt(2.0), math.sqrt(2.0)]) / math.sqrt(5.0)
    return float(np.abs(measures.directions(run)[0, 0] - printed).max())


def _initial_angle(run: Trajectory) -> float:
    return math.degrees(angles(run).phi[0])


def _last_angle(run: Trajectory) -> float:
    return float(angles(run).phi[-1])


def _top_angular_rate(run: Trajectory) -> float:
    return float(np.abs(angles(run).phi_rate).max())


def _landscape_angles(run: Trajectory) -> float:
    return float(angles(run).phi.max())


def _coordinates_go_astray(run: Trajectory) -> bool:
    """V falls all the time, and yet the error of some coordinate grows for a while."""
    error = np.abs(measures.directions(run) - measures.directions(run, measures.aims(run)))
    grows = np.maximum.accumulate(error[::-1], axis=0)[::-1] - error  # to its largest later value
    return bool(np.all(np.diff(run.lyapunov) < 0.0)) and float(grows.max()) > LINE


def _paths_differ(runs: Runs) -> float:
    tips = [measures.directions(runs[name])[:, 0] for name in ("pinned", "pinned-p1", "pinned-pinf")]
    pairs = ((0, 1), (0, 2), (1, 2))
    return float(min(np.linalg.norm(tips[a] - tips[b], axis=1).max() for a, b in pairs))


def _least_norms(run: Trajectory) -> bool:
    """Along the run, each law's u has the least of its own norm."""
    from tensegrity_mj import controllers

    laws = {p: controllers.from_scene(run.scene, norm=p) for p in (1, 2, math.inf)}
    for k in range(0, len(run.time), 50):
        state = run.time[k], run.nodes[k], run.velocities[k]
        u = {p: law(*state) for p, law in laws.items()}
        for p in u:
            norms = {other: np.linalg.norm(u[other], p) for other in u}
            if norms[p] > min(norms.values()) * (1.0 + 1e-9):
                return False
    return True


# ---------------------------------------------------------------------------------------------------- pinned rod

# panel, experiment, norm, decay rate
_PANELS = (("a", "pinned", "2", 0.15), ("b", "pinned-p1", "1", 0.15), ("c", "pinned-pinf", "∞", 0.15))
# fmt: off


def _pinned_rod() -> Iterator[Statement]:
    run = "pinned"
    yield from parameter_statements("5.3", "§5.4", 118, run, 1.0, "1")
    yield Statement(
        "5.1-start", "5.1", "§5.4, Fig. 5.1", 119, "angle φ between the printed b(0) and b_d", "98.70°",
        ReadFrom.TEXT, near(math.degrees(math.acos((math.sqrt(2.0) - 2.0) / math.sqrt(15.0))), 1e-6),
        "b(0)ᵀb_d = (√2 − 2)/√15 exactly", (run,), of(run, _initial_angle), "°",
    )
    yield Statement(
        "5.1-phi", "5.1", "Fig. 5.1", 110, "largest φ of the trajectory", "axis from −π to π", ReadFrom.AXIS,
        Interval(0.0, math.pi), "the panel ends there", ("pinned-fast",), of("pinned-fast", _landscape_angles), "rad",
    )
    yield Statement(
        "5.1-rate", "5.1", "Fig. 5.1", 110, "largest |φ̇| of the trajectory", "axis from −1 to 1", ReadFrom.AXIS,
        Interval(0.0, 1.0), "the panel ends there", ("pinned-fast",), of("pinned-fast", _top_angular_rate), "rad/s",
    )
    yield Statement(
        "5.1-end", "5.1", "Fig. 5.1", 110, "φ at the end: the trajectory runs into the minimum at 0", "0",
        ReadFrom.CURVES, Interval(0.0, LINE * math.pi), "the thickness of a line, 2 % of π", ("pinned-fast",),
        of("pinned-fast", _last_angle), "rad",
    )
    yield Statement(
        "5.3-apart", "5.3", "Fig. 5.3", 120, "least distance by which two of the three paths (p = 2, 1, ∞) part",
        "three paths that can be told apart", ReadFrom.CURVES, Interval(0.1), "a tenth of the rod's length",
        ("pinned", "pinned-p1", "pinned-pinf"), _paths_differ, "m",
    )
    yield Statement(
        "5.3-start", "5.3", "§5.4", 119, "largest difference of b(0) from the printed (1, −√2, √2)/√5", "0",
        ReadFrom.TEXT, Interval(0.0, 1e-12), "printed exactly", (run,), of(run, _initial_b),
    )
    for panel, name, norm, decay_rate in _PANELS:
        yield from panel_statements("5.4", panel, name, f"p = {norm}", 121, decay_rate)
    yield Statement(
        "5.4a-continuous", "5.4", "§5.3, Fig. 5.4(a)", 117,
        "p = 2: largest change of a u within 10 ms, of the largest u", "a continuous function", ReadFrom.TEXT,
        Interval(0.0, 0.05), "a curve, where p = 1 and ∞ leap by most of it", (run,), of(run, measures.largest_jump),
    )
    for panel, name, norm in (("b", "pinned-p1", "1"), ("c", "pinned-pinf", "∞")):
        yield Statement(
            f"5.4{panel}-leaps", "5.4", f"§5.4, Fig. 5.4({panel})", 119,
            f"p = {norm}: largest change of a u within 10 ms, of the largest u", "discontinuity and chattering",
            ReadFrom.TEXT, Interval(0.2), "a leap; p = 2 changes by less than 5 %", (name,),
            of(name, measures.largest_jump),
        )
    yield Statement(
        "5.4b-one", "5.4", "§5.3, §5.6", 126, "p = 1: most strings that pull at one time", "1", ReadFrom.TEXT,
        near(1.0, 0.0), "a count", ("pinned-p1",), of("pinned-p1", lambda r: int(measures.active_strings(r).max())),
    )
    yield Statement(
        "5.4c-equal", "5.4", "§5.3, §5.6", 126, "p = ∞: largest difference between nonzero u, of the larger", "0",
        ReadFrom.TEXT, Interval(0.0, 1e-9), "equal by Lemma 5.1 c); rounding of rest lengths", ("pinned-pinf",),
        of("pinned-pinf", measures.spread_of_active),
    )
    yield Statement(
        "5.4-chatter", "5.4", "§5.4", 119, "switching per shown sample of 10 ms: p = 1 over p = ∞",
        "chattering, particularly for p = 1", ReadFrom.TEXT, Interval(1.0), "more than the other",
        ("pinned-p1", "pinned-pinf"),
        lambda runs: measures.switches(runs["pinned-p1"]) / max(1, measures.switches(runs["pinned-pinf"])),
    )
    yield Statement(
        "5.4-least", "5.4", "§5.3", 114, "along the run of p = 2, each law's u has the least of its own norm", "true",
        ReadFrom.TEXT, HOLDS, "equality to 1e-9", (run,), of(run, _least_norms),
    )
    for name, norm in (("pinned", "2"), ("pinned-p1", "1"), ("pinned-pinf", "∞")):
        yield Statement(
            f"5.4-feasible-{norm}", "5.4", "§5.3", 117, f"p = {norm}: smallest margin max(v/α) of (5.18)",
            "> 0: infeasibility never occurred", ReadFrom.TEXT, Interval(1e-6), "positive", (name,),
            of(name, lambda r: r.min_feasibility_margin), "m²",
        )
    yield Statement(
        "5.4-uniform", "5.4", "§5.6, Fig. 5.4", 125, "V falls uniformly, yet coordinates do not converge uniformly",
        "true", ReadFrom.TEXT, HOLDS, "a coordinate's error grows by more than a line's width", (run,),
        of(run, _coordinates_go_astray),
    )


# --------------------------------------------------------------------------------------------------------- prism

# Printed in §5.5 in four digits: node, axis, value; at the start and at the target.
PRINTED_START = {
    ("b1", 0): 0.4243,
    ("b1", 1): 0.4243,
    ("b1", 2): 0.8,
    ("b2", 0): -0.5796,
    ("b2", 1): 0.1553,
    ("b2", 2): 0.8,
    ("b3", 0): 0.1553,
    ("b3", 1): -0.5796,
    ("b3", 2): 0.8,
    ("r2", 0): 0.4659,
    ("r2", 1): 0.2690,
    ("r3", 1): 0.5379,
}
PRINTED_TARGET = {
    ("b1", 0): 0.5657,
    ("b1", 1): 0.5657,
    ("b1", 2): 0.6,
    ("b2", 0): -0.7727,
    ("b2", 1): 0.2071,
    ("b2", 2): 0.6,
    ("b3", 0): 0.2071,
    ("b3", 1): -0.7727,
    ("b3", 2): 0.6,
    ("r2", 0): 0.6212,
    ("r2", 1): 0.3586,
    ("r3", 1): 0.7173,
}


def _off_printed(run: Trajectory, positions: measures.Array, printed: dict[tuple[str, int], float]) -> float:
    b, r = measures.directions(run, positions), measures.points(run, positions)
    parts = {"b": b, "r": r}
    return max(abs(float(parts[key[0]][int(key[1]) - 1, axis]) - value) for (key, axis), value in printed.items())


def _unbalanced(run: Trajectory, where: str) -> float:
    """Least unbalanced force [N] where all u >= 0 and sum to 1 N/m: zero where the shape can be prestressed."""
    from scipy.optimize import nnls

    from tensegrity_mj.prestress import equilibrium_matrix

    positions = run.nodes[0] if where == "start" else measures.aims(run)[-1]
    matrix = equilibrium_matrix(run.scene.structure, positions)
    ones = np.ones((1, matrix.shape[1]))
    return float(nnls(np.vstack([matrix, ones]), np.append(np.zeros(len(matrix)), 1.0))[1])



def _prism() -> Iterator[Statement]:
    yield from parameter_statements("5.6", "§5.5", 122, "prism", 1.0, "1")
    yield from prism_statements("5.7", "5.6", "prism", (125, 126))
    digits = "half a unit of the fourth printed digit, and 3e-5 by which the print is off (its |b| is not 1)"
    yield Statement(
        "5.6-printed-start", "5.6", "§5.5", 124, "largest difference of the start from the 12 printed components",
        "0", ReadFrom.TEXT, Interval(0.0, 8e-5), digits, ("prism",),
        of("prism", lambda run: _off_printed(run, run.nodes[0], PRINTED_START)),
    )
    yield Statement(
        "5.6-printed-target", "5.6", "§5.5", 124, "largest difference of the target from the 12 printed components",
        "0", ReadFrom.TEXT, Interval(0.0, 8e-5), digits, ("prism",),
        of("prism", lambda run: _off_printed(run, measures.aims(run)[-1], PRINTED_TARGET)),
    )
    yield Statement(
        "5.6-height-start", "5.6", "§5.5", 124, "height at the start", "0.8 m", ReadFrom.TEXT, near(0.8, 1e-9),
        "printed exactly", ("prism",), of("prism", lambda run: measures.height(run, run.nodes[0])), "m",
    )
    for where in ("start", "target"):
        for figure, name, section in (("5.4", "pinned", "§5.2, §5.4"), ("5.6", "prism", "§5.5")):
            yield Statement(
                f"{figure}-equilibrium-{where}", figure, section, 113 if name == "pinned" else 123,
                f"{where}: least unbalanced force under strings that pull with 1 N/m in sum",
                "0 (a prestressable equilibrium)", ReadFrom.TEXT, Interval(0.0, 1e-9), "rounding", (name,),
                of(name, _unbalanced, where), "N",
            )


# -------------------------------------------------------------------------------------------------- gains of §5.6


def _ratio(quantity: Callable[[Trajectory], float], changed: str, usual: str) -> Measure:
    return lambda runs: quantity(runs[changed]) / quantity(runs[usual])


def _gain_trends() -> Iterator[Statement]:
    more, less = Interval(1.001), Interval(-math.inf, 0.999)
    why = "a trend: by more than a thousandth"
    at_rest = (
        "at rest a = M⁻ᵀYᵀe does not hold Z: the largest u, that of the start, is the same to the last digit; and "
        "afterwards the slower rod needs less"
    )
    for name, title in (("pinned", "pinned rod"), ("prism", "prism")):
        yield Statement(
            f"5.6gains-{name}-Z-speed", "", "§5.6", 125, f"{title}: top speed with Z = 1.8 over that with 3/2",
            "slower with larger Z", ReadFrom.TEXT, less, why, (f"{name}-Z18", name),
            _ratio(measures.top_speed, f"{name}-Z18", name),
        )
        yield Statement(
            f"5.6gains-{name}-Z-u", "", "§5.6", 125, f"{title}: largest u with Z = 1.8 over that with 3/2",
            "larger with larger Z", ReadFrom.TEXT, more, why, (f"{name}-Z18", name),
            _ratio(measures.peak, f"{name}-Z18", name), "",
            KnownDifference(at_rest, near(1.0, 1e-6)) if name == "pinned" else None,
        )
        yield Statement(
            f"5.6gains-{name}-Y-u", "", "§5.6", 125, f"{title}: largest u with Y = 0.8 over that with 1",
            "larger with smaller Y", ReadFrom.TEXT, more, why, (f"{name}-Y08", name),
            _ratio(measures.peak, f"{name}-Y08", name),
        )
        yield Statement(
            f"5.6gains-{name}-Y-time", "", "§5.6", 125,
            f"{title}: time until the error stays below half, with Y = 1.2 over that with 1", "slower with larger Y",
            ReadFrom.TEXT, more, why, (f"{name}-Y12", name),
            _ratio(lambda run: measures.time_below(run, 0.5), f"{name}-Y12", name),
        )


STATEMENTS: tuple[Statement, ...] = (*_pinned_rod(), *_prism(), *_gain_trends())
