"""Moved supports in a MuJoCo run: what drives them, exactly, and the work that they do.

A motion drives slide joints, each along one direction and with an armature beside which nothing else counts.
The force on each is as much times d̈ at the stage's own time, so that MuJoCo's integrator sees the acceleration d̈(t) and
nothing reacts on it. It is set in the control callback, which comes before MuJoCo sums up forces. At the start of a
step the slide's place and velocity are put on the exact d and ḋ: what the integrator makes of them in a step
is off by its own local error (RK4: h⁵), and so nothing adds up. With RK4 everything is of order 4, with the other
integrators of order 1, as without motion. Places and velocities are the world's, whatever moves.

Work. All nodes of the tree of bodies that a slide carries move with it along its direction e, so that the support's
force along it is R = dp/dt - M g·e - F, with p the tree's momentum along e and F what strings, loads, contacts and
joints that close loops pull along e. No acceleration is needed for the work of R: by parts,

    ∫ R ḋ dt = Δ(p ḋ) - ∫ p d̈ dt - ∫ (M g·e + F) ḋ dt,

whose integrals are counted beside the state, as those of strings and loads are. What constraints pull MuJoCo knows only
after the callback: it is counted at the next stage.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.dynamics.native.pointers import address_of, borrowing, floats, integers, records_reader
from tensegrity_mj.engines.mujoco.mjcf_bodies import Names
from tensegrity_mj.engines.mujoco.mjcf_tree import BodyTree
from tensegrity_mj.model.scene import Scene

SLIDE = np.dtype(
    [
        ("motion", "i8"),
        ("place", "i8"),  # in qpos
        ("dof", "i8"),
        ("drive", "f8"),  # its armature [kg]
        ("axis", "f8", (3,)),
        ("offset", "f8"),  # along the axis, of d where qpos is 0
        ("weight", "f8"),  # M g·e of the tree
        ("kept", "f8"),  # ḋ of the stage whose constraint forces are not yet known
    ],
    align=True,
)
_read_slides = records_reader(SLIDE)

# Of the supports' own table: sizes, addresses, and whether a stage awaits its constraint forces.
COUNT, NODES, STRINGS, SLIDES, MASSES, MEMBERS, REACH, WAITS, RESETS = range(9)
SUPPORTS_SIZE = 9


@borrowing
def drive(supports: Any, moved_at: int, places_at: int, rates_at: int, forces_at: int, first_stage: bool) -> None:
    """Push the slides with d̈; at the first stage of a step also put them on d and ḋ."""
    slides = _read_slides(supports[SLIDES], supports[COUNT])
    for s in range(len(slides)):
        slide = slides[s]
        moved = floats(moved_at + 72 * slide.motion, (3, 3))
        floats(forces_at + 8 * slide.dof, 1)[0] = slide.drive * _along(slide.axis, moved[2])
        if first_stage and supports[RESETS]:
            floats(places_at + 8 * slide.place, 1)[0] = _along(slide.axis, moved[0]) - slide.offset
            floats(rates_at + 8 * slide.dof, 1)[0] = _along(slide.axis, moved[1])


@borrowing
def _along(axis: Any, v: Any) -> float:
    return axis[0] * v[0] + axis[1] * v[1] + axis[2] * v[2]


@borrowing
def _momentum(supports: Any, s: int, axis: Any, velocities: Any) -> float:
    """p of a slide's tree."""
    N = supports[NODES]
    masses, total = floats(supports[MASSES] + 8 * s * N, (N,)), 0.0
    for n in range(N):
        if masses[n] != 0.0:
            total += masses[n] * _along(axis, velocities[n])
    return total


@borrowing
def carried(supports: Any, moved_at: int, velocities_at: int) -> float:
    """Σ p ḋ [J]."""
    slides = _read_slides(supports[SLIDES], supports[COUNT])
    velocities, total = floats(velocities_at, (supports[NODES], 3)), 0.0
    for s in range(len(slides)):
        rate = _along(slides[s].axis, floats(moved_at + 72 * slides[s].motion, (3, 3))[1])
        total += rate * _momentum(supports, s, slides[s].axis, velocities)
    return total


@borrowing
def support_power(
    supports: Any,
    moved_at: int,
    nodes_at: int,
    velocities_at: int,
    loads_at: int,
    pairs_at: int,
    tensions_at: int,
    lengths_at: int,
) -> float:
    """-Σ [p d̈ + (M g·e + F) ḋ] [W], F of strings and loads (`loads_at` = 0 for none)."""
    N, M = supports[NODES], supports[STRINGS]
    slides = _read_slides(supports[SLIDES], supports[COUNT])
    nodes, velocities = floats(nodes_at, (N, 3)), floats(velocities_at, (N, 3))
    pairs, tensions, lengths = integers(pairs_at, (M, 2)), floats(tensions_at, (M,)), floats(lengths_at, (M,))
    total = 0.0
    for s in range(len(slides)):
        slide = slides[s]
        moved = floats(moved_at + 72 * slide.motion, (3, 3))
        force, reach = slide.weight, floats(supports[REACH] + 8 * s * M, (M,))
        for m in range(M):
            if reach[m] != 0.0 and tensions[m] != 0.0:
                i, j = pairs[m, 0], pairs[m, 1]
                pull = _along(slide.axis, nodes[j]) - _along(slide.axis, nodes[i])
                force += reach[m] * tensions[m] / lengths[m] * pull
        if loads_at != 0:
            loads, members = floats(loads_at, (N, 3)), floats(supports[MEMBERS] + 8 * s * N, (N,))
            for n in range(N):
                if members[n] != 0.0:
                    force += _along(slide.axis, loads[n])
        rate, change = _along(slide.axis, moved[1]), _along(slide.axis, moved[2])
        total -= _momentum(supports, s, slide.axis, velocities) * change + force * rate
    return total


@borrowing
def keep_rates(supports: Any, moved_at: int) -> None:
    """Keep ḋ of this stage until its constraint forces are known."""
    slides = _read_slides(supports[SLIDES], supports[COUNT])
    for s in range(len(slides)):
        slides[s].kept = _along(slides[s].axis, floats(moved_at + 72 * slides[s].motion, (3, 3))[1])
    supports[WAITS] = 1


@borrowing
def constraint_work(supports: Any, moved_at: int, constraint_at: int, weight: float, one_stage: bool) -> float:
    """-∫ F ḋ dt [J] over the stage before, of this weight [s], F of contacts and of joints that close loops.

    An integrator of one stage holds its forces over the step: their work counts the speeds at both ends.
    """
    if not supports[WAITS]:
        return 0.0
    supports[WAITS] = 0
    slides, total = _read_slides(supports[SLIDES], supports[COUNT]), 0.0
    for s in range(len(slides)):
        slide = slides[s]
        rate = slide.kept
        if one_stage:
            rate = 0.5 * (rate + _along(slide.axis, floats(moved_at + 72 * slide.motion, (3, 3))[1]))
        total -= floats(constraint_at + 8 * slide.dof, 1)[0] * rate
    return weight * total


class SupportTable:
    """The table of a run whose supports move, and the arrays behind it.

    Attributes:
        table: int64, see the slots above.
        slides: records of `SLIDE`.
    """

    def __init__(
        self, scene: Scene, tree: BodyTree, model: mujoco.MjModel, start: Scene | None = None, resets: bool = True
    ) -> None:
        """Of a scene in a model; `start` is the scene that the model was made from, where that is another."""
        structure = scene.structure
        names = Names(scene, tree)
        rods = [model.body(name).id for name in names.rods]
        sites = model.site_bodyid[[model.site(name).id for name in structure.node_names]]
        roots = model.body_rootid
        N, M = len(structure.nodes), len(structure.strings)
        places: list[tuple[int, int, Array, int]] = []  # body, slides before the driven ones, axes, motion
        for number, motion in enumerate(scene.motions):
            for rod, joint in enumerate(tree.joints):
                if structure.rods[rod].name == motion.support:
                    places.append((rods[rod], joint.slides.shape[1], joint.moved, number))
            for (row, axes), name in zip(tree.moved_nodes, names.moved, strict=True):
                if structure.node_names[row] == motion.support:
                    places.append((model.body(name).id, 0, axes, number))
        count = sum(axes.shape[1] for _, _, axes, _ in places)
        self.slides = np.zeros(count, SLIDE)
        masses, members, reach = np.zeros((count, N)), np.zeros((count, N)), np.zeros((count, M))
        at = 0
        for body, before, axes, number in places:
            origin = (start or scene).motions[number].at(0.0)[0]
            for k, axis in enumerate(axes.T):
                slide = self.slides[at]
                slide["motion"], slide["axis"], slide["offset"] = number, axis, axis @ origin
                slide["place"] = model.jnt_qposadr[model.body_jntadr[body] + before + k]
                slide["dof"] = model.body_dofadr[body] + before + k
                slide["drive"] = model.dof_armature[slide["dof"]]
                members[at] = roots[sites] == body
                reach[at] = members[at][structure.string_nodes] @ [1.0, -1.0] if M else 0.0
                for rod, pair in enumerate(structure.rod_nodes):
                    if roots[rods[rod]] == body:
                        masses[at, pair] += 0.5 * structure.rod_masses[rod]
                slide["weight"] = masses[at].sum() * (np.array(scene.gravity) @ axis)
                at += 1
        self._keep = (masses, members, reach)
        self.table = np.zeros(SUPPORTS_SIZE, np.int64)
        self.table[COUNT], self.table[NODES], self.table[STRINGS] = count, N, M
        arrays = (self.slides, masses, members, reach)
        for slot, array in zip((SLIDES, MASSES, MEMBERS, REACH), arrays, strict=True):
            self.table[slot] = address_of(array)
        self.table[RESETS] = resets

    def forces(self, scene: Scene, time: float, nv: int) -> Array:
        """What drives the supports at a time: generalized forces (nv,)."""
        out = np.zeros(nv)
        for slide in self.slides:
            out[slide["dof"]] = slide["drive"] * (slide["axis"] @ scene.motions[slide["motion"]].at(time)[2])
        return out
