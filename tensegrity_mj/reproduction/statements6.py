"""What chapter 6 of the thesis states: projection based control of the pinned rod (§6.2) and of the prism (§6.3)."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from tensegrity_mj.landscape import angles
from tensegrity_mj.reproduction import measures
from tensegrity_mj.reproduction.shared_rows import LINE, panel_statements, prism_statements
from tensegrity_mj.reproduction.statement import (
    HOLDS,
    INSIDE,
    Interval,
    ReadFrom,
    Runs,
    Statement,
    fills,
    near,
    of,
)
from tensegrity_mj.trajectory import Trajectory

_LAWS = (("projection", "onto b⊥"), ("pinned", "Lyapunov, δ = 0.15"), ("pinned-fast", "Lyapunov, δ = 0.20"))
_SEEN = "two panels of one size: what differs by a quarter is seen at once"


def _scalars(run: Trajectory) -> tuple[measures.Array, ...]:
    """b_dᵀb, b_dᵀḃ, ḃᵀḃ of the first rod, (T,) each."""
    b, rate = measures.directions(run)[:, 0], measures.rates(run)[:, 0]
    goal = measures.directions(run, measures.aims(run))[:, 0]
    return np.sum(goal * b, axis=1), np.sum(goal * rate, axis=1), np.sum(rate * rate, axis=1)


def _v1(run: Trajectory) -> measures.Array:
    aligned, along, square = _scalars(run)
    return 1.0 - aligned - along + 0.75 * square


def _v2(run: Trajectory) -> measures.Array:
    aligned, along, square = _scalars(run)
    return 0.5 - 0.5 * aligned**2 - along + 0.75 * square


def _v3(run: Trajectory) -> measures.Array:
    aligned, along, square = _scalars(run)
    return 0.5 - 0.5 * aligned**2 - aligned * along + 0.75 * square


def _off(formula: Callable[[Trajectory], measures.Array]) -> Callable[[Trajectory], float]:
    """Largest difference of a formula from the V that the law reports."""
    return lambda run: float(np.abs(formula(run) - run.lyapunov).max())


def _in_angles(name: str) -> Callable[[Trajectory], float]:
    """Largest difference of V_φ + V_θ, (6.21) to (6.23), from the V that the law reports."""

    def measure(run: Trajectory) -> float:
        way = angles(run)
        phi, rate = way.phi, way.phi_rate
        first = 1.0 - np.cos(phi) if name == "V1" else 0.5 * np.sin(phi) ** 2
        mixed = rate * np.sin(phi) * (np.cos(phi) if name == "V3" else 1.0)
        turning = 0.75 * (np.sin(phi) * way.theta_rate) ** 2
        return float(np.abs(first + mixed + 0.75 * rate**2 + turning - run.lyapunov).max())

    return measure


def _start_angle(run: Trajectory) -> float:
    return float(np.degrees(angles(run).phi[0]))


def _final_angle(run: Trajectory) -> float:
    return float(np.degrees(angles(run).phi[-1]))


def _comparable(runs: Runs) -> bool:
    """Whether the error falls to a tenth at a time nearer to that of δ = 0.20 than to that of δ = 0.15."""
    times = {name: measures.time_below(runs[name], 0.1) for name in ("projection", "pinned", "pinned-fast")}
    return abs(times["projection"] - times["pinned-fast"]) < abs(times["projection"] - times["pinned"])


def _parts_add_up(run: Trajectory) -> float:
    return float(np.abs(run.lyapunov_error + run.lyapunov_velocity - run.lyapunov).max())


def _in_order(runs: Runs) -> bool:
    """Whether the Lyapunov law and projection onto b⊥ reach the target, and projection onto b_d⊥ does not."""
    reached = [_final_angle(runs[name]) < 2.0 for name in ("mirror-lyapunov", "mirror-b", "mirror-bd")]
    return reached == [True, True, False]


def _apart(values: measures.Array, reference: measures.Array) -> float:
    return float(np.linalg.norm(values - reference) / np.linalg.norm(reference))


# Rows read better with several arguments on a line.
# fmt: off


def _pinned_rod() -> Iterator[Statement]:
    yield Statement(
        "6.2-start", "6.2", "Fig. 6.2", 131, "φ at the start", "98.70°", ReadFrom.TEXT, near(98.6994, 1e-3),
        "(√2 − 2)/√15 of §5.4: \"identical\" start and target", ("projection",), of("projection", _start_angle), "°",
    )
    yield Statement(
        "6.2-rate", "6.2", "Fig. 6.2", 131, "largest |φ̇| of the trajectory", "axis from −1 to 1", ReadFrom.AXIS,
        Interval(0.0, 1.0), "the panel ends there", ("projection",),
        of("projection", lambda run: float(np.abs(angles(run).phi_rate).max())), "rad/s",
    )
    yield Statement(
        "6.2-end", "6.2", "Fig. 6.2", 131, "φ at the end: the trajectory runs into the minimum at 0", "0°",
        ReadFrom.CURVES, Interval(0.0, LINE * 180.0), "the thickness of a line, 2 % of π", ("projection",),
        of("projection", _final_angle), "°",
    )
    for name, title in _LAWS:
        yield Statement(
            f"6.3-{name}", "6.3", "Fig. 6.3", 133, f"{title}: distance of the tip from the target at 60 s", "0",
            ReadFrom.CURVES, Interval(0.0, LINE), "the thickness of a line, 2 % of the rod", (name,),
            of(name, lambda run: float(run.target_error()[-1])), "m",
        )
    yield from panel_statements("6.4", "a", "projection", "onto b⊥", 134, 0.15)
    yield from panel_statements("6.4", "b", "pinned", "Lyapunov, δ = 0.15", 134, 0.15)
    yield from panel_statements("6.4", "c", "pinned-fast", "Lyapunov, δ = 0.20", 134, 0.20)
    yield Statement(
        "6.4-peak", "6.4", "§6.2, Fig. 6.4", 133, "largest u of projection over that of the comparable Lyapunov law",
        "significantly smaller peak", ReadFrom.TEXT, Interval(0.0, 0.75),
        f"{_SEEN}; after the first second alone it is 1.21", ("projection", "pinned-fast"),
        lambda runs: measures.peak(runs["projection"]) / measures.peak(runs["pinned-fast"]),
    )
    yield Statement(
        "6.4-comparable", "6.4", "§6.2", 132,
        "projection at δ = 0.15 converges as the Lyapunov law at 0.20, not 0.15", "true", ReadFrom.TEXT, HOLDS,
        "the time at which the error has fallen to a tenth for good", ("projection", "pinned", "pinned-fast"),
        _comparable,
    )
    yield Statement(
        "6.4-differ", "6.4", "§6.2", 132, "V(0) of projection over V(0) of the Lyapunov law, at the same start",
        "different values", ReadFrom.TEXT, Interval(0.0, 0.75), _SEEN, ("projection", "pinned"),
        lambda runs: float(runs["projection"].lyapunov[0] / runs["pinned"].lyapunov[0]),
    )


def _second_start() -> Iterator[Statement]:
    names = ("mirror-b", "mirror-bd", "mirror-lyapunov")
    yield Statement(
        "6.5-start", "6.5", "§6.2", 135, "angle of the start from the target: nearer to the mirror image", "> 90°",
        ReadFrom.TEXT, Interval(90.0, 180.0), "the text gives no more; the start is our choice (see the scene)",
        names, of("mirror-b", _start_angle), "°",
    )
    for name, title in (("mirror-b", "projection onto b⊥"), ("mirror-lyapunov", "Lyapunov law")):
        yield Statement(
            f"6.5-{name}", "6.5", "§6.2, Fig. 6.5", 135, f"{title}: angle from the target at 60 s",
            "0°: converges to the target", ReadFrom.TEXT, Interval(0.0, 2.0),
            "the thickness of a line, 2 % of the rod", (name,), of(name, _final_angle), "°",
        )
    yield Statement(
        "6.5-mirror-bd", "6.5", "§6.2, Fig. 6.5", 135, "projection onto b_d⊥: angle from the target at 60 s",
        "180°: converges to the mirror image", ReadFrom.TEXT, Interval(178.0, 180.0),
        "the thickness of a line, 2 % of the rod", ("mirror-bd",), of("mirror-bd", _final_angle), "°",
    )
    yield Statement(
        "6.6-errors-rise", "6.6", "§6.2, Fig. 6.6", 136,
        "V₂: its orientation terms rise before they fall, to this part of their start", "rise", ReadFrom.CURVES,
        Interval(1.05), "a rise that is seen", ("mirror-b",),
        of("mirror-b", lambda run: float(run.lyapunov_error.max() / run.lyapunov_error[0])),
    )
    yield Statement(
        "6.6-V2-low", "6.6", "Fig. 6.6", 136, "V₂: lowest of the velocity terms", "axis to −0.2, ticks of 0.1",
        ReadFrom.AXIS, fills(-0.2, 0.1), INSIDE, ("mirror-b",),
        of("mirror-b", lambda run: float(run.lyapunov_velocity.min())),
    )
    yield Statement(
        "6.6-V2-high", "6.6", "Fig. 6.6", 136, "V₂: highest of the orientation terms", "axis to 0.6, ticks of 0.1",
        ReadFrom.AXIS, fills(0.6, 0.1), "the axis ends below the next tick; 1/2 at φ = 90°", ("mirror-b",),
        of("mirror-b", lambda run: float(run.lyapunov_error.max())),
    )
    yield Statement(
        "6.6-V3-low", "6.6", "Fig. 6.6", 136, "V₃: lowest of the velocity terms", "axis to −0.1, ticks of 0.1",
        ReadFrom.AXIS, Interval(-0.2, 0.0), INSIDE, ("mirror-bd",),
        of("mirror-bd", lambda run: float(run.lyapunov_velocity.min())),
    )
    yield Statement(
        "6.6-V3-high", "6.6", "Fig. 6.6", 136, "V₃: highest of the orientation terms", "axis to 0.5, ticks of 0.1",
        ReadFrom.AXIS, fills(0.5, 0.1), INSIDE, ("mirror-bd",),
        of("mirror-bd", lambda run: float(run.lyapunov_error.max())),
    )
    yield Statement(
        "6.6-effective", "6.6", "§6.2", 136, "lowest velocity terms of V₃ over those of V₂",
        "less effective in giving a negative contribution", ReadFrom.TEXT, Interval(0.0, 0.5),
        "less than half is less", ("mirror-b", "mirror-bd"),
        lambda runs: float(runs["mirror-bd"].lyapunov_velocity.min() / runs["mirror-b"].lyapunov_velocity.min()),
    )
    for name, symbol in (("mirror-b", "V₂"), ("mirror-bd", "V₃")):
        yield Statement(
            f"6.6-sum-{name}", "6.6", "Fig. 6.6", 136, f"{symbol}: largest difference of V and the sum of its parts",
            "0", ReadFrom.CAPTION, Interval(0.0, 1e-12), "rounding", (name,), of(name, _parts_add_up),
        )
        yield Statement(
            f"6.6-decay-{name}", "6.6", "Fig. 6.6", 136, f"{symbol}: largest deviation from V(0) e^(−δt), δ = 0.15",
            "0", ReadFrom.CURVES, Interval(0.0, 1e-5),
            "exact in the law; the integration's tolerance over V at the end", (name,),
            of(name, lambda run: measures.decay_error(run, 0.15)),
        )
    formulas = (
        ("6.18", "V1", "mirror-lyapunov", _v1), ("6.19", "V2", "mirror-b", _v2), ("6.20", "V3", "mirror-bd", _v3),
    )
    for number, (equation, symbol, name, formula) in enumerate(formulas):
        yield Statement(
            f"6.6-{equation}", "6.6", f"({equation})", 136,
            f"largest difference of the printed {symbol}(b, ḃ) from the law's V along the run", "0", ReadFrom.TEXT,
            Interval(0.0, 1e-8), "rounding, and ‖b‖ = 1 to 1e-9", (name,), of(name, _off(formula)),
        )
        yield Statement(
            f"6.7-{6.21 + 0.01 * number:.2f}", "6.7", f"({6.21 + 0.01 * number:.2f})", 137,
            f"largest difference of the printed {symbol}(φ, φ̇) + V_θ(φ, θ̇) from the law's V along the run", "0",
            ReadFrom.TEXT, Interval(0.0, 1e-8), "rounding, and ‖b‖ = 1 to 1e-9", (name,),
            of(name, _in_angles(symbol)),
        )
    yield Statement(
        "6.7-end", "6.7", "Fig. 6.7", 137, "φ at the end: the trajectory runs into the minimum at π", "180°",
        ReadFrom.CURVES, Interval(180.0 - LINE * 180.0, 180.0), "the thickness of a line, 2 % of π", ("mirror-bd",),
        of("mirror-bd", _final_angle), "°",
    )
    yield Statement(
        "6.7-rate", "6.7", "Fig. 6.7", 137, "largest |φ̇| of the trajectory", "axis from −1 to 1", ReadFrom.AXIS,
        Interval(0.0, 1.0), "the panel ends there", ("mirror-bd",),
        of("mirror-bd", lambda run: float(np.abs(angles(run).phi_rate).max())), "rad/s",
    )
    yield Statement(
        "6.7-region", "6.7", "§6.2, §6.4", 137,
        "from the second start, laws that reach the target: Lyapunov, b⊥, b_d⊥",
        "the regions of attraction fall in this order", ReadFrom.TEXT, HOLDS,
        "one start that tells b_d⊥ from the others; it does not tell Lyapunov from b⊥", names, _in_order,
    )


def _prism() -> Iterator[Statement]:
    name = "prism-projection"
    yield from prism_statements("6.9", "6.8", name, (138, 139))
    yield Statement(
        "6.8-similar", "6.8", "§6.3", 138, "largest distance of a node from where the Lyapunov law has it",
        "very similar results", ReadFrom.TEXT, Interval(0.0, 0.01), "1 % of a rod: the two figures look the same",
        (name, "prism"), lambda runs: float(np.linalg.norm(runs[name].nodes - runs["prism"].nodes, axis=-1).max()),
        "m",
    )
    yield Statement(
        "6.9-similar", "6.9", "§6.3", 138, "RMS difference of the u from the Lyapunov law's, over the RMS of these",
        "very similar results", ReadFrom.TEXT, Interval(0.0, 0.1), "a tenth: the two figures look the same",
        (name, "prism"), lambda runs: _apart(runs[name].force_densities, runs["prism"].force_densities),
    )


STATEMENTS: tuple[Statement, ...] = (*_pinned_rod(), *_second_start(), *_prism())
