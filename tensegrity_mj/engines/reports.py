"""Reports of a run, `Trajectory.reports`, and the warnings that follow from them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.basics.arrays import Array, dot
from tensegrity_mj.dynamics.native.plant import Plant
from tensegrity_mj.dynamics.native.resolution import STAGES, unresolved
from tensegrity_mj.dynamics.native.watch import NONE, impossible
from tensegrity_mj.model import rods
from tensegrity_mj.model.actuation import Mode
from tensegrity_mj.model.capabilities import DRY_BODIES
from tensegrity_mj.model.elements.water import Water
from tensegrity_mj.model.members import LIMITS
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.runs.energy import DRIFT_WARNING, energy_exchanged, energy_unresolved
from tensegrity_mj.runs.trajectory import Trajectory

if TYPE_CHECKING:
    from tensegrity_mj.engines.request import Request


ENERGY_WARNING = 0.01  # part of the energy exchanged beyond which a run says that its balance is off
# Part of the motion that local errors add up to, beyond which a run says that its steps resolve nothing: of RK4, whose
# estimate falls as h⁴, and of methods of order 1. What is unresolved also grows, up to thirtyfold in random runs
# near the limit of stability (test_unresolved_steps.py); the shipped scenes stay below 5e-5 at their defaults.
RESOLUTION_WARNING, FIRST_ORDER_WARNING = 0.002, 0.01
# What no winch can do is no error of a run: what its warnings say, which studies of errors leave out.
NO_LINE, NO_PUSH = "no winch hauls in more line than there is", "a winch cannot push"
BUCKLES = "is pushed with more than Euler's load"  # which is no error of a run either
RESOLUTION_FLOOR = 1e-10  # of the structure's size: what errs by less is near round-off
LIMIT_ROUND_OFF = 1e-6  # part of a limit: u = k (1 - L0/L) loses digits where k is much larger than u
DECAY_WARNING = 0.01  # part of V
V_ROUND_OFF = 1e-26  # V of errors of 1e-13 m and rad: one that starts below it starts at the target
V_RESOLVED = 1e-20  # of V(0): below it, errors squared are not far from round-off squared


def reports_of(request: Request, run: Trajectory, plant: Plant | None, step: float | None) -> dict[str, Any]:
    """The reports of a run, with what its plant counted, or its samples show; `step` [s] is that of fixed steps."""
    structure = run.scene.structure
    drift, rate_drift = _drifts(run)
    decay_error, since = _decay_error(request, run)
    limits = _limits(request, run)
    rest, pushed = _impossible_samples(run) if plant is None else impossible(plant)
    resolution = None if step is None or plant is None else _resolution(run, plant, step)
    twice, bent = run.scene.redundancy, _buckled(run)
    warnings = [
        *_balance_warnings(run),
        *_drift_warnings(run, drift),
        *([] if resolution is None or step is None else _resolution_warnings(run, resolution, step)),
        *([twice.warning] if twice.singular else []),
        *_law_warnings(request, run, decay_error, since),
        *_limit_warnings(limits),
        *_buckling_warnings(bent),
        *_string_warnings(structure, rest, pushed),
    ]
    below = np.asarray(((run.rest_lengths <= 0) & ~structure.curves.constant).any(axis=1))
    rows = np.flatnonzero(below)
    reports: dict[str, Any] = {
        "warnings": warnings,
        "limits": limits,
        "decay_error": decay_error,  # of V against V(0) e^(-δt), relative
        "drift": float(drift.max(initial=0.0)),  # of bᵀb - 1
        "rate_drift": float(rate_drift.max(initial=0.0)),  # of bᵀḃ [1/s]
        "energy_residual": run.energy_residual,
        # Rods whose λ and force density are one choice of many; None where too many hang together to be checked.
        "undetermined_forces": None if twice.skipped else list(twice.undetermined),
        "singular_start": list(twice.singular),
        "nonpositive_rest_lengths": {
            "samples": len(rows),  # and intervals: at recorded times
            "intervals": _intervals(run.time, below),
            **_sorted(rest),
        },
        "negative_force_densities": _sorted(pushed),  # that a law commanded
    }
    if dry := DRY_BODIES.find(run.scene):
        reports["left_out"] = dry
    if bent is not None:
        reports["buckling"] = bent
    if resolution is not None:
        reports["resolution"] = resolution
    if run.scene.water is not None and len(run.time):
        from tensegrity_mj.runs.flow_regime import flow_numbers

        reports["water"] = flow_numbers(run).report() | {"segments": run.scene.water_segments.report()}
        warnings.extend(run.scene.water_segments.warnings)
    if request.sampled:
        reports["largest_holding_ratio"] = _holding_ratio(request, run)
    return reports


def _sorted(found: dict[str, Any]) -> dict[str, Any]:
    return found | {"strings": sorted(found["strings"])}


def _impossible_samples(run: Trajectory) -> tuple[dict[str, Any], dict[str, Any]]:
    """Count `impossible` of recorded samples, if nothing else is known; of force densities below zero none is."""
    structure = run.scene.structure
    whole = run.time[:, None] <= run.scene.break_times
    below = (run.rest_lengths <= 0.0) & whole & (structure.stiffness > 0.0)
    rows, columns = np.nonzero(below)
    if not len(rows):
        return NONE, NONE
    found = {
        "steps": int(below.sum(axis=0).max()),
        "strings": [structure.strings[column].name for column in dict.fromkeys(columns.tolist())],
        "first_time": float(run.time[rows[0]]),
        "least": float(run.rest_lengths[below].min()),
    }
    return found, NONE


def _holding_ratio(request: Request, run: Trajectory) -> float:
    """Ratio that must be small for a held rest length, which adds a viscosity of the order of k H (docs/laws.md)."""
    structure, period = run.scene.structure, request.actuation.period or 0.0
    lengths = structure.string_lengths(run.nodes)
    rates = np.abs(structure.string_rates(run.nodes, run.velocities))
    loaded = run.force_densities > 0
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(loaded, structure.stiffness * period * rates / (run.force_densities * lengths), 0.0)
    return float(ratio.max(initial=0.0))


def _drifts(run: Trajectory) -> tuple[Array, Array]:
    """Drifts (T, R) of the rods, |bᵀb - 1| and |bᵀḃ| [1/s], zero of elastic ones."""
    structure = run.scene.structure
    first, second = rods.ends(structure, run.nodes)
    b = (second - first) / structure.rod_lengths[:, None]
    first, second = rods.ends(structure, run.velocities)
    b_rate = (second - first) / structure.rod_lengths[:, None]
    return tuple(np.where(structure.elastic, 0.0, np.abs(part)) for part in (dot(b, b) - 1, dot(b, b_rate)))  # type: ignore[return-value]


def _balance_warnings(run: Trajectory) -> list[str]:
    exchanged = float(energy_exchanged(run)[-1]) if len(run.time) else 0.0
    residual, allowed = run.energy_residual, ENERGY_WARNING * exchanged
    if residual <= allowed or residual <= allowed + energy_unresolved(run):
        return []
    return [
        f"the energy balance is off by {residual:.2g} J of {exchanged:.2g} J exchanged: "
        "reduce the time step or the tolerances before trusting this run"
    ]


def _drift_warnings(run: Trajectory, drift: Array) -> list[str]:
    if drift.max(initial=0.0) <= DRIFT_WARNING:
        return []
    row, column = np.unravel_index(np.argmax(drift), drift.shape)
    first, second = (end[row, column] for end in rods.ends(run.scene.structure, run.nodes))
    rod, length = run.scene.structure.rods[int(column)].name, run.scene.structure.rod_lengths[column]
    since = float(run.time[np.argmax(np.any(drift > DRIFT_WARNING, axis=1))])
    return [
        f"rod '{rod}' drifts off its length by {abs(np.linalg.norm(second - first) / length - 1):.2g} of it (bᵀb by "
        f"{DRIFT_WARNING:g} first at t = {since:.6g} s): reduce the time step or the tolerances, or let the DAE keep "
        "lengths with Drift.NORMALIZE, before trusting this run"
    ]


def _resolution(run: Trajectory, plant: Plant, step: float) -> dict[str, Any]:
    estimate, motion, node = unresolved(plant, step)
    names = run.scene.structure.node_names
    return {
        "step": step,
        "order": 4 if plant["resolution_kind"] == STAGES else 1,
        "error_estimate": estimate,
        "motion": motion,
        "node": names[node] if names else "",
    }


def _resolution_warnings(run: Trajectory, found: dict[str, Any], step: float) -> list[str]:
    estimate, motion = found["error_estimate"], found["motion"]
    extent = float(np.max(np.ptp(run.scene.nodes0, axis=0), initial=0.0))
    allowed = RESOLUTION_WARNING if found["order"] == 4 else FIRST_ORDER_WARNING
    if not estimate > max(allowed * motion, RESOLUTION_FLOOR * extent):
        return []
    omega, stiffest = _stiffest(run), ""
    if omega > 0:
        count = 2 * np.pi / omega / step
        stiffest = f" (the stiffest motion at the start, ω = {omega:.3g} rad/s, has {count:.2g} steps a period)"
    return [
        f"the step of {step:g} s does not resolve the motion: local errors add up to {estimate:.2g} m at node "
        f"'{found['node']}', where the largest motion is {motion:.2g} m{stiffest}: reduce the time step, or use "
        "accuracy=..., before trusting this run"
    ]


def _stiffest(run: Trajectory) -> float:
    """Frequency ω [rad/s] of the stiffest small motion at the start, without law and dampers; 0 if it is not found."""
    from tensegrity_mj.vibration.integrators import largest_frequency
    from tensegrity_mj.vibration.small_motions import vibration

    scene = run.scene
    try:
        return largest_frequency(vibration(scene, scene.nodes0, scene.velocities0, scene.structure.rest_lengths))
    except Exception:  # loads are a user's code, and solvers of eigenvalues may give up: the warning does without
        return 0.0


def _law_warnings(request: Request, run: Trajectory, decay_error: float | None, since: float) -> list[str]:
    warnings, law, scene = [], request.law, run.scene
    known = law.gravity
    if known is not None and known != scene.gravity:
        warnings.append(f"the law assumes gravity {known}, the scene has {scene.gravity} m/s²")
    water = next((one for one in law.known if isinstance(one, Water)), None)
    if known is not None and water != scene.water:
        kind = "no water" if water is None else "other water than the scene's" if scene.water else "water"
        warnings.append(f"the law assumes {kind}" + ("" if scene.water else ", and the scene has none"))
    there = (*(() if callable(scene.loads) else scene.loads), scene.resistance, *scene.elements)
    for one in law.known:
        if not isinstance(one, Water) and one not in there:
            warnings.append(f"the law assumes {one!r}, which the scene has not")
    if known is not None and scene.motions:
        warnings.append(f"the law assumes supports at rest, and '{scene.motions[0].support}' moves")
    if decay_error is not None and decay_error > DECAY_WARNING and not request.sampled:
        warnings.append(
            f"V leaves the decay that the law promises by {decay_error:.2g} of itself (by {DECAY_WARNING:g} first at "
            f"t = {since:.6g} s): the law is near a singularity there (its margin falls to zero), the step is too "
            "coarse, or forces act that the law does not know"
        )
    if law.until is not None and law.until < request.duration * (1 - 1e-9):
        warnings.append(f"the recording ends at {law.until:g} s; until {request.duration:g} s its last values are held")
    return warnings


def _buckled(run: Trajectory) -> dict[str, Any] | None:
    """List rods that are pushed with more than Euler's load of their sections: when first, push and load [N].

    None where no rod has a section. Nothing buckles in a run: rods stay straight.
    """
    members = run.scene.structure.rods
    if all(rod.section is None for rod in members):
        return None
    lengths, forces, found = rods.lengths(run.scene.structure, run.nodes), run.rod_forces, {}
    for number, rod in enumerate(members):
        if rod.section is None:
            continue
        loads = rod.section.euler_load(1.0) / np.broadcast_to(lengths, forces.shape)[:, number] ** 2
        beyond = -forces[:, number] > loads
        if beyond.any():
            row = int(np.argmax(beyond))
            found[rod.name] = {"time": run.time[row], "push": -forces[row, number], "euler_load": loads[row]}
    return {name: {key: float(value) for key, value in one.items()} for name, one in found.items()}


def _buckling_warnings(bent: dict[str, Any] | None) -> list[str]:
    if not bent:
        return []
    name, first = min(bent.items(), key=lambda item: item[1]["time"])
    more = f" (and {len(bent) - 1} more)" if len(bent) > 1 else ""
    return [
        f"rod '{name}'{more} {BUCKLES} of its section, {first['push']:.3g} N of {first['euler_load']:.3g} N at t = "
        f"{first['time']:.6g} s: it would bend out there, and stays straight here; give it a stiffer section"
    ]


def _limit_warnings(limits: dict[str, Any]) -> list[str]:
    return [
        f"{name} of string '{bound['string']}' is exceeded: {bound['exceeded']:.3g} at t = {bound['time']:.6g} "
        f"s, allowed {bound['limit']:.3g}; docs/laws.md says which actuation keeps which limit"
        for name, bound in limits.items()
        if bound["exceeded"] is not None
    ]


def _string_warnings(structure: Structure, rest: dict[str, Any], pushed: dict[str, Any]) -> list[str]:
    """Warnings about commands that no string and no winch can follow; the run goes on by the string law."""
    warnings = []
    if rest["strings"]:
        k = next(string.stiffness for string in structure.strings if string.name == rest["strings"][0])
        warnings.append(
            f"string {_named(rest)} has a rest length of zero or less from t = {rest['first_time']:.6g} s (at "
            f"{rest['steps']} steps; the least is {rest['least']:.3g} m): a rest length cannot be negative, {NO_LINE}. "
            f"Where it follows from a force density u at or above the stiffness k = {k:.3g} N/m, by "
            "L0 = L (1 - u/k), use stiffer strings, or give them max_force_density or min_rest_length"
        )
    if pushed["strings"]:
        warnings.append(
            f"the law commands a negative force density of string {_named(pushed)} from t = "
            f"{pushed['first_time']:.6g} s (at {pushed['steps']} steps; the least is {pushed['least']:.3g} N/m): "
            f"{NO_PUSH}, the string is slack instead. Keep the law's solution at u >= 0"
        )
    return warnings


def _named(found: dict[str, Any]) -> str:
    more = len(found["strings"]) - 1
    return f"'{found['strings'][0]}'" + (f" (and {more} more)" if more else "")


def _limits(request: Request, run: Trajectory) -> dict[str, Any]:
    """Report each limit that some string has: how long any string was at or beyond it, and the worst beyond it."""
    structure = run.scene.structure
    given = [name for name in LIMITS if np.isfinite(structure.limits(name)).any()]
    if not given or not len(run.time):
        return {}
    mode, period = request.actuation.mode, request.actuation.period or 0.0
    spacing = np.maximum(np.diff(run.time), period if mode is Mode.HOLD_REST_LENGTH else 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        speed = np.abs(np.diff(run.rest_lengths, axis=0)) / spacing[:, None]
    values = {
        "max_force_density": (run.force_densities, 1.0),
        "min_rest_length": (run.rest_lengths, -1.0),
        # From sample to sample, so that a winch that may only move at samples is not taken for a fast one.
        "winch_speed": (
            np.concatenate([np.zeros_like(speed[:1]), speed]) if len(run.time) > 1 else 0 * run.tensions,
            1.0,
        ),
    }
    found: dict[str, Any] = {}
    for name in given:
        (value, sign), limit = values[name], structure.limits(name)
        beyond = np.where(np.isfinite(limit), sign * (value - limit) / np.abs(limit), -np.inf)
        row, column = np.unravel_index(np.argmax(beyond), beyond.shape)
        over = beyond[row, column] > LIMIT_ROUND_OFF
        found[name] = {
            "reached": _intervals(run.time, np.any(beyond > -LIMIT_ROUND_OFF, axis=1)),
            "strings": [
                s.name for s, at in zip(structure.strings, beyond.max(axis=0), strict=True) if at > -LIMIT_ROUND_OFF
            ],
            "exceeded": float(value[row, column]) if over else None,
            "string": structure.strings[int(column)].name if over else None,
            "time": float(run.time[row]) if over else None,
            "limit": float(limit[column]) if over else None,
        }
    return found


def _decay_error(request: Request, run: Trajectory) -> tuple[float | None, float]:
    """Largest relative error of V against V(0) e^(-δt), and when it first exceeds what is warned of.

    None where the law promises no decay, or where the run starts at the target, so that V(0) is round-off.
    """
    if request.law.decay_rate is None or len(run.time) == 0 or not run.lyapunov[0] > V_ROUND_OFF:
        return None, 0.0
    promised = run.lyapunov[0] * np.exp(-request.law.decay_rate * (run.time - run.time[0]))
    resolved = promised > V_RESOLVED * run.lyapunov[0]
    error = np.abs(run.lyapunov[resolved] / promised[resolved] - 1)
    return float(error.max()), float(run.time[resolved][np.argmax(error > DECAY_WARNING)])


def _intervals(time: Array, true: NDArray[np.bool_]) -> list[list[float]]:
    """First and last recorded time of each stretch in which something holds."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], true, [False]]).astype(int)))
    return [[float(time[a]), float(time[b - 1])] for a, b in edges.reshape(-1, 2)]
