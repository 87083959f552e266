"""Energy of a run: the work of its winches, what it exchanged, against which its balance is held, and divergence.

A law sets rest lengths against the tension of the strings, and that is work on them. Power is counted as done on the
strings, P = -T dL0/dt with T the elastic tension: positive where a winch hauls in, negative where a string pulls line
out of it. A winch that stands still holds any tension at no power.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from tensegrity_mj.basics.arrays import Array, norm
from tensegrity_mj.dynamics.native.plant import Plant
from tensegrity_mj.errors import DivergenceError
from tensegrity_mj.model import rods
from tensegrity_mj.model.actuation import Mode
from tensegrity_mj.runs.recorded import LAW_REPORTS, variables_of
from tensegrity_mj.runs.trajectory import Trajectory

if TYPE_CHECKING:
    from tensegrity_mj.runs.trajectory import Trajectory


# A run has diverged when it has gained this many times the energy that it was ever given, or when a rod's length is off
# by this part. The errors of a step that is merely coarse stay below; an unstable one passes any bound soon.
ENERGY_BOUND = 2.0
WINCH_BOUND = 10.0  # where winches work
# In the continuous mode: this part of all the energy that was exchanged. Measured on the prism and the pinned rod with
# every integrator: a coarse step gains up to 0.87 of it, past the limit it is 0.95 to 1.5 for errors of any size.
GAIN_BOUND = 0.9
STRAIN_BOUND = 0.5
BEYOND = 1e10  # m, m/s: mjMAXVAL, what MuJoCo takes for a divergence too; it zeroes all controls for one of them
# Of bᵀb - 1: rods half as much off their lengths. The energy need not see it, where it is mostly that of prestress.
DRIFT_WARNING = 1e-3


@np.errstate(over="ignore", invalid="ignore")
def check_energy(run: Trajectory, remedy: str, dampers_as_recorded: bool = True) -> None:
    """Raise DivergenceError, with what came before, if a run is not finite, tore its rods, or made energy from nothing.

    Args:
        run: all of it, or what there was when it ended.
        remedy: what the message advises.
        dampers_as_recorded: whether the dampers' forces that were recorded are those that acted. An integrator that is
            implicit in them applies others, so that the recorded dissipation may exceed what there was to dissipate.
    """
    sane = np.ones(len(run.time), bool)
    motion = BEYOND * max(1.0, float(np.abs(run.scene.nodes0).max(initial=0.0)))
    for name in variables_of(run.scene):
        if name not in LAW_REPORTS:  # NaN where the law has none
            values = np.abs(getattr(run, name)) < (motion if name in ("nodes", "velocities") else np.inf)
            if not values.all():
                sane &= values.all(axis=tuple(range(1, values.ndim)))
    good = len(sane) if sane.all() else int(np.argmin(sane))
    cause = f"positions or velocities are beyond {motion:g} m or m/s, or forces are no longer finite"
    for bad, reason in (_torn_rods(run.until(good)), _energy_from_nowhere(run.until(good), dampers_as_recorded)):
        if bad < good:
            good, cause = bad, reason
    if good == len(run.time):
        return
    at = float(run.time[good])
    raise DivergenceError(f"diverged by t = {at:.6g} s: {cause}; {remedy}", at, run.until(good))


def blame_divergence(
    partial: Trajectory, plant: Plant, time: float, remedy: str, dampers_as_recorded: bool = True
) -> None:
    """Raise DivergenceError if a law or a load stopped a run because its state was none of a structure any more.

    Args:
        partial: what was recorded before.
        plant: with the nodes that the law was given last.
        time: when it stopped the run [s].
        remedy, dampers_as_recorded: as for `check_energy`.
    """
    check_energy(partial, remedy, dampers_as_recorded)
    if not all(np.all(np.abs(plant[name]) < BEYOND) for name in ("nodes", "velocities")):
        raise DivergenceError(
            f"diverged by t = {time:.6g} s: positions or velocities are beyond {BEYOND:g} m or m/s; {remedy}",
            time,
            partial,
        )


def _torn_rods(run: Trajectory) -> tuple[int, str]:
    """The first sample at which a rod is not nearly as long as it should be (none: their number), and what to say."""
    structure = run.scene.structure
    first, second = rods.ends(structure, run.nodes)
    strain = np.where(structure.elastic, 0.0, norm(second - first) / structure.rod_lengths - 1)
    bad = np.any(np.abs(strain) > STRAIN_BOUND, axis=1)
    if not bad.any():
        return len(bad), ""
    at = int(np.argmax(bad))
    worst = int(np.argmax(np.abs(strain[at])))
    return at, f"rod '{structure.rods[worst].name}' has {strain[at, worst] + 1:.3g} times its length"


def _energy_from_nowhere(run: Trajectory, dampers_as_recorded: bool) -> tuple[int, str]:
    """The first sample with more energy than there can be (none: their number), and what to say."""
    if len(run.time) == 0:
        return 0, ""
    # A damper that gives back what it took, as one does beyond the limit of an explicit step, gives from nowhere.
    given_back = np.maximum.accumulate(run.dissipation) - run.dissipation
    gained = run.energy_balance + (given_back if dampers_as_recorded else -run.dissipation)
    if run.provenance["actuation"]["mode"] == Mode.CONTINUOUS.value and np.any(run.winch_work):
        # Winch work by parts contains the strings' work itself, which grows with any error: held
        # against what was exchanged, or what strings hold at the start or bent joints at any time, if that is more.
        stored = np.maximum.accumulate(np.maximum(np.abs(run.element_energy), run.string_energy[0]))
        bound, given = GAIN_BOUND, np.maximum(energy_exchanged(run), stored)
    else:
        bound, given = WINCH_BOUND if np.any(run.winch_work) else ENERGY_BOUND, _energy_given(run)
    # What the round-off of positions alone makes of the energy [J], in the stiffest string and under gravity.
    floor = 1e-12 * (1.0 + float(np.max(run.scene.structure.stiffness, initial=0.0)))
    # In the first steps from rest next to nothing has been given yet, and its relative error is large: the verdict is
    # by the largest of the whole run, its time by the first.
    if not gained.max() > bound * given[-1] + floor:
        return len(run.time), ""
    at = int(np.argmax(gained > bound * given + floor))
    return at, f"energy came from nowhere: {gained[at]:.3g} J gained, {given[at]:.3g} J given"


def energy_unresolved(run: Trajectory) -> float:
    """Residual [J] that round-off explains: of sums of energies, and of places where forces act.

    A place is known to 1e-16 of its coordinates, and the energy to that times the force; steps add up as a random walk.
    Measured on random prestressed structures: up to 1e-16 of forces times coordinates in 1000 steps. To it comes what
    prestressed rods do where their lengths drift, which has a warning of its own: the DAE lets them by its tolerance.
    """
    structure = run.scene.structure
    terms = (
        run.kinetic_energy,
        run.gravity_energy,
        run.string_energy,
        run.element_energy,
        run.winch_work,
        run.external_work,
        run.dissipation,
    )
    total = sum(float(np.max(np.abs(term), initial=0.0)) for term in terms)
    forces = float(
        np.max(run.tensions, axis=0, initial=0.0).sum() + rods.total_mass(structure) * np.linalg.norm(run.scene.gravity)
    )
    extent = float(np.max(np.abs(run.nodes), initial=0.0))
    walk = max(1.0, float(np.sqrt(run.cost.get("steps", 0.0))) / 30)
    first, second = rods.ends(structure, run.nodes)
    drift = np.abs(np.sum((second - first) ** 2, axis=-1) - rods.lengths(structure, run.nodes) ** 2)
    drifted = 0.0
    if np.all(drift <= DRIFT_WARNING * structure.rod_lengths**2):  # beyond, nothing is excused
        drifted = float(np.max(np.sum(np.abs(run.rod_force_densities) * drift, axis=1), initial=0.0))
    return 1e-14 * total + 1e-15 * walk * forces * extent + drifted


def _energy_given(run: Trajectory) -> Array:
    """Initial energy plus the largest works of winches, loads and gravity up to each time (T,) [J]."""
    given = np.full(len(run.time), run.kinetic_energy[0] + run.string_energy[0] + run.element_energy[0])
    for term in (run.winch_work, run.external_work, run.gravity_energy - run.gravity_energy[0]):
        given += np.maximum.accumulate(np.abs(term))
    return given


def energy_exchanged(run: Trajectory) -> Array:
    """Energy (T,) [J] that was exchanged up to each time, against which an error of the energy is to be held.

    The largest of the kinetic energy, of the works of strings, gravity and bent joints since the start, of the work of
    loads, contact and supports, and of what dampers took. Energy that strings only store is none of it: prestress may
    hold a million times what a vibration moves to and fro, and would hide the loss of all of that. The strings' work is
    their energy less the winches' work, which may cancel: where a law sets force densities both grow, the work not.
    """
    terms = (
        run.kinetic_energy,
        run.string_energy - run.string_energy[:1] - run.winch_work,
        run.gravity_energy - run.gravity_energy[:1],
        run.element_energy - run.element_energy[:1],
        run.external_work,
        run.dissipation,
    )
    return np.asarray(np.maximum.accumulate(np.max(np.abs(terms), axis=0)))


def winch_increments(run: Trajectory) -> Array:
    """Work of each string's winch between samples, -∫ T dL0 [J], (T - 1, M); T is the elastic tension.

    Exact where rest lengths or force densities are held and every control sample is recorded; else by the trapezoidal
    rule, of second order in the recorded interval. Of the interval in which a string breaks, what its winch did is
    known only where a sample is recorded at the break. NaN for strings that yield, where commands are held.
    """
    structure = run.scene.structure
    curves, k = structure.curves, structure.stiffness
    L, L0 = structure.string_lengths(run.nodes), run.rest_lengths
    elastic = run.force_densities * L
    mode = (run.provenance.get("actuation") or {}).get("mode", Mode.CONTINUOUS.value)
    intact = run.time[:, None] < run.scene.break_times  # what a breaking string sets free is no winch's work
    gradual = np.asarray(-0.5 * (elastic[1:] + elastic[:-1]) * np.diff(L0, axis=0))
    if not curves.linear and mode != Mode.CONTINUOUS.value:
        if mode == Mode.HOLD_REST_LENGTH.value:
            jumps = curves.energy(L[1:] - L0[1:]) - curves.energy(L[1:] - L0[:-1])
        else:
            stored = curves.energy(curves.stretch(elastic))
            jumps = np.diff(stored, axis=0) - 0.5 * run.force_densities[:-1] * np.diff(L**2, axis=0)
        return np.where(curves.yields, np.nan, np.where(intact[1:], jumps, 0.0))
    if mode == Mode.HOLD_REST_LENGTH.value:
        # All of it at the sample, where the string's length does not change.
        before, after = np.maximum(L[1:] - L0[:-1], 0.0), np.maximum(L[1:] - L0[1:], 0.0)
        return np.asarray(intact[1:] * k / 2 * (after**2 - before**2))
    if mode == Mode.HOLD_FORCE_DENSITY.value:
        # u is held from sample to sample while the string moves, then jumps.
        u = run.force_densities
        between = -0.5 * u[:-1] * (1 - u[:-1] / k) * (L[1:] ** 2 - L[:-1] ** 2)
        return np.asarray(between + intact[1:] * 0.5 * (u[1:] ** 2 - u[:-1] ** 2) * L[1:] ** 2 / k)
    return gradual


def winch_power(run: Trajectory) -> Array:
    """Mean power of each string's winch from each recorded time to the next [W], (T - 1, M), positive where it hauls.

    Times the intervals it adds up to the run's `winch_work`: to round-off and what fixed steps add in the sampled modes
    if every control sample is recorded, else to second order in the recorded interval (see `winch_increments`). Empty
    for a run of less than two samples.
    """
    return np.asarray(winch_increments(run) / np.diff(run.time)[:, None])
