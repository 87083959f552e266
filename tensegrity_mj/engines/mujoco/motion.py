"""Moved supports in a MuJoCo run: what drives them, exactly, and the work that they do.

A motion drives slide joints, each along one direction and with an armature next to which all other mass is negligible.
The force on each is as much times d̈ at the stage's own time, so that MuJoCo's integrator sees the acceleration d̈(t) and
nothing reacts on it. It is set in the control callback, which comes before MuJoCo sums up forces. At the start of a
step the slide's place and velocity are put on the exact d and ḋ: what the integrator makes of them in a step
is off by its own local error (RK4: h⁵), and so nothing adds up. With RK4 everything is of order 4, with the other
integrators of order 1, as without motion. Places and velocities are always the world's.

Work. All nodes of the tree of bodies that a slide carries move with it along its direction e, so that the support's
force along it is R = dp/dt - M g·e - F, with p the tree's momentum along e and F what strings, loads, contacts and
joints that close loops pull along e. No acceleration is needed for the work of R: by parts,

    ∫ R ḋ dt = Δ(p ḋ) - ∫ p d̈ dt - ∫ (M g·e + F) ḋ dt,

whose integrals are counted along with the state, as those of strings and loads are. MuJoCo knows the forces of
constraints only after the callback: they are counted at the next stage.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.dynamics.native.pointers import borrowing, copy
from tensegrity_mj.dynamics.native.vectors import dot
from tensegrity_mj.dynamics.native.views import Table
from tensegrity_mj.engines.mujoco.mjcf_tree import BodyTree, Names
from tensegrity_mj.engines.mujoco.run_view import SLIDE
from tensegrity_mj.model.rods import mass_at_ends
from tensegrity_mj.model.scene import Scene


@borrowing
def drive(run: Any, first_stage: bool) -> None:
    """Push the slides with d̈; at the first stage of a step also put them on d and ḋ."""
    slides, places, rates, forces, resets = run.driven, run.qpos, run.qvel, run.qfrc_applied, run.resets
    moved = run.moved
    for s in range(len(slides)):
        slide = slides[s]
        forces[slide.dof] = slide.drive * dot(slide.axis, moved[slide.motion, 2])
        if first_stage and resets:
            places[slide.place] = dot(slide.axis, moved[slide.motion, 0]) - slide.offset
            rates[slide.dof] = dot(slide.axis, moved[slide.motion, 1])


@borrowing
def _momentum(masses: Any, axis: Any, velocities: Any) -> float:
    """p of a slide's tree."""
    total = 0.0
    for n in range(len(masses)):
        if masses[n] != 0.0:
            total += masses[n] * dot(axis, velocities[n])
    return total


@borrowing
def carried(run: Any) -> float:
    """Σ p ḋ [J]."""
    slides, masses, moved, velocities = run.driven, run.driven_masses, run.moved, run.velocities
    total = 0.0
    for s in range(len(slides)):
        axis = slides[s].axis
        total += dot(axis, moved[slides[s].motion, 1]) * _momentum(masses[s], axis, velocities)
    return total


@borrowing
def support_power(run: Any) -> float:
    """-Σ [p d̈ + (M g·e + F) ḋ] [W], F of strings, whose segments have been measured, and elements."""
    slides, masses, members, reach = run.driven, run.driven_masses, run.driven_nodes, run.driven_segments
    nodes, velocities, forces, moved = run.nodes, run.velocities, run.forces, run.moved
    pairs, ranges, tensions, lengths = run.segments, run.ranges, run.tensions, run.segment_lengths
    total = 0.0
    for s in range(len(slides)):
        slide = slides[s]
        force = slide.weight
        for m in range(len(ranges)):
            if tensions[m] == 0.0:
                continue
            for p in range(ranges[m, 0], ranges[m, 1]):
                if reach[s, p] != 0.0:
                    start, end = nodes[pairs[p, 0]], nodes[pairs[p, 1]]
                    pull = dot(slide.axis, end) - dot(slide.axis, start)
                    force += reach[s, p] * tensions[m] / lengths[p] * pull
        if run.element_count > 0 or run.implicit != 0:
            for n in range(len(forces)):
                if members[s, n] != 0.0:
                    force += dot(slide.axis, forces[n])
        rate, change = dot(slide.axis, moved[slide.motion, 1]), dot(slide.axis, moved[slide.motion, 2])
        total -= _momentum(masses[s], slide.axis, velocities) * change + force * rate
    return total


@borrowing
def note_rates(run: Any) -> None:
    """Keep velocities and ḋ of this stage until its constraint forces are known."""
    slides, moved = run.driven, run.moved
    if run.touches:
        copy(run.qvel, run.stage_rates)
    for s in range(len(slides)):
        slides[s].rate = dot(slides[s].axis, moved[slides[s].motion, 1])
    run.awaits_constraints = 1


@borrowing
def count_constraints(run: Any, weight: float, one_stage: bool) -> float:
    """Count the work of contacts over the stage before, of this weight [s], and -∫ F ḋ dt of supports.

    F is of contacts and of joints that close loops. Returns -Σ F ḋ [W]. An integrator of one stage holds its forces
    over the step: their work counts the speeds at both ends.
    """
    if not run.awaits_constraints:
        return 0.0
    run.awaits_constraints = 0
    slides, moved, pulls, before, now = run.driven, run.moved, run.qfrc_constraint, run.stage_rates, run.qvel
    power, total = 0.0, 0.0
    if run.touches:
        for i in range(len(pulls)):
            power += pulls[i] * (0.5 * (before[i] + now[i]) if one_stage else before[i])
    for s in range(len(slides)):
        slide = slides[s]
        rate = slide.rate
        if one_stage:
            rate = 0.5 * (rate + dot(slide.axis, moved[slide.motion, 1]))
        total -= pulls[slide.dof] * rate
    run.work[2] += weight * power
    run.work[2] += weight * total
    return total


def set_supports(scene: Scene, tree: BodyTree, model: mujoco.MjModel, run: Table, start: Scene | None = None) -> None:
    """Set the moved supports of a scene in the table of a run; `start`: what its model was made from, if another."""
    structure = scene.structure
    names = Names(scene, tree)
    rods = [model.body(name).id for name in names.rods]
    sites = model.site_bodyid[[model.site(name).id for name in structure.node_names]]
    roots = model.body_rootid
    N, paths = len(structure.nodes), structure.paths
    places: list[tuple[int, int, Array, int]] = []  # body, slides before the driven ones, axes, motion
    for number, motion in enumerate(scene.motions):
        for rod, joint in enumerate(tree.joints):
            if structure.rods[rod].name == motion.support:
                places.append((rods[rod], joint.slides.shape[1], joint.moved, number))
        for (row, axes), name in zip(tree.moved_nodes, names.moved, strict=True):
            if structure.node_names[row] == motion.support:
                places.append((model.body(name).id, 0, axes, number))
    count = sum(axes.shape[1] for _, _, axes, _ in places)
    slides = np.zeros(count, SLIDE)
    shares = mass_at_ends(structure)
    masses, members, reach = np.zeros((count, N)), np.zeros((count, N)), np.zeros((count, len(paths.nodes)))
    at = 0
    for body, before, axes, number in places:
        made = start or scene
        origin = made.motions[number].at(float(made.start_time))[0]
        for k, axis in enumerate(axes.T):
            slide = slides[at]
            slide["motion"], slide["axis"], slide["offset"] = number, axis, axis @ origin
            slide["place"] = model.jnt_qposadr[model.body_jntadr[body] + before + k]
            slide["dof"] = model.body_dofadr[body] + before + k
            slide["drive"] = model.dof_armature[slide["dof"]]
            members[at] = roots[sites] == body
            reach[at] = members[at][paths.nodes] @ [1.0, -1.0]
            for rod, pair in enumerate(structure.rod_nodes):
                if roots[rods[rod]] == body:
                    masses[at, pair] += shares[rod]
            slide["weight"] = masses[at].sum() * (np.array(scene.gravity) @ axis)
            at += 1
    run.set(
        driven=slides,
        driven_masses=masses,
        driven_nodes=members,
        driven_segments=reach,
    )


def driving_forces(slides: Any, scene: Scene, time: float, nv: int) -> Array:
    """Generalized forces (nv,) that drive supports by `slides` at a time."""
    out = np.zeros(nv)
    for slide in slides:
        out[slide["dof"]] = slide["drive"] * (slide["axis"] @ scene.motions[slide["motion"]].at(time)[2])
    return out
