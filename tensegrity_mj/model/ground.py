"""Ground that shakes: all supports follow a record of accelerations, the table [scene.ground] of a file.

Between the record's times the acceleration is linear, so that the displacement is a cubic, which the quintics of a
motion's data (`Motion.data`) are exactly: the record is integrated once, without error but round-off, from rest.

A record that was measured ends with a velocity, and far away, as errors of its zero add up. With s from 0 to 1 over the
record, s (1 - s) (α + β s) is subtracted from the acceleration, α and β such that the ground comes to rest at its own
place (`Baseline.RETURN`): nothing is left that a fit could choose. The quintics are exact still. For rest alone,
wherever that is, β = 0 (`Baseline.STOP`). So that the acceleration does not jump, which would cost methods of fixed
steps their order, it rises from zero and falls to zero over one more interval where the record does not do so itself.
"""

from __future__ import annotations

import enum
from functools import cached_property

import numpy as np
from numpy.polynomial.polynomial import polyint, polyval

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import instance
from tensegrity_mj.basics.fields import field, refused, value
from tensegrity_mj.basics.kinds import choice, finite, rows
from tensegrity_mj.model.members import Vector
from tensegrity_mj.model.motion import Motion
from tensegrity_mj.model.moved_supports import TOLERANCE, held_directions
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure

MOST_STATES = 1_000_000  # of all supports at all times


class Baseline(enum.Enum):
    """Baseline correction: the curve that is subtracted from a record of accelerations."""

    RETURN = "return"  # a cubic of time: the ground ends at rest where it began
    STOP = "stop"  # a parabola: it ends at rest
    NONE = "none"  # nothing: the record must cover the run, or end at rest


@value("ground")
class Ground:
    """Accelerations of the ground at increasing times, linear between them.

    Attributes:
        times: (T,) [s], two or more, the first >= 0; the ground is at rest until then.
        accelerations: (T, 3) in the world frame, times `scale` [m/s²].
        baseline: see `Baseline`.
        scale: [m/s²] of a unit of the accelerations: 9.81 for a record in g.
    """

    times: tuple[float, ...] = field(rows())
    accelerations: tuple[Vector, ...] = field(rows(3))
    baseline: Baseline = field(choice(Baseline), default=Baseline.RETURN)
    scale: float = field(finite("m/s²"), default=1.0)

    def __attrs_post_init__(self) -> None:
        if len(self.times) < 2 or len(self.accelerations) != len(self.times):
            raise refused(
                self,
                f"{len(self.times)} times and {len(self.accelerations)} accelerations; there must be two or more, and "
                "as many of both",
            )
        rises = np.diff(self.times) > 0
        if self.times[0] < 0 or not rises.all():
            wrong = int(np.argmin(rises)) + 1 if self.times[0] >= 0 else 0
            found = f"times[{wrong}] is {self.times[wrong]:g} s" + (
                f" after {self.times[wrong - 1]:g} s" if wrong else ""
            )
            raise refused(self, f"its times must increase from 0 or later; {found}")

    @cached_property
    def record(self) -> tuple[Array, Array]:
        """Times (K,) [s] and accelerations (K, 3) [m/s²] that begin and end with zero, unless nothing is subtracted."""
        t, a = np.array(self.times), self.scale * np.array(self.accelerations)
        if self.baseline is not Baseline.NONE:
            if t[0] > 0 and np.any(a[0]):
                t, a = np.array([max(2 * t[0] - t[1], 0.0), *t]), np.array([np.zeros(3), *a])
            if np.any(a[-1]):
                t, a = np.array([*t, 2 * t[-1] - t[-2]]), np.array([*a, np.zeros(3)])
        return t, a

    @cached_property
    def states(self) -> Array:
        """(K, 3, 3): displacement [m], velocity [m/s] and acceleration [m/s²] at the record's times, corrected."""
        t, a = self.record
        h, first, second = np.diff(t)[:, None], a[:-1], a[1:]
        found = np.stack([np.zeros_like(a), np.zeros_like(a), a], axis=1)
        found[1:, 1] = np.cumsum(0.5 * h * (first + second), axis=0)
        found[1:, 0] = np.cumsum(h * found[:-1, 1] + h**2 * (2 * first + second) / 6, axis=0)
        if self.baseline is Baseline.NONE:
            return found
        T = t[-1] - t[0]
        place, velocity = found[-1, 0] / T**2, found[-1, 1] / T
        # ∫ s (1 - s) (α + β s) ds = α/6 + β/12, and α/12 + β/30 integrated twice.
        beta = 60 * velocity - 120 * place if self.baseline is Baseline.RETURN else np.zeros(3)
        alpha = 6 * velocity - 0.5 * beta
        cubic = np.array([np.zeros(3), alpha, beta - alpha, -beta])
        for order in range(3):
            found[:, order] -= T ** (2 - order) * polyval((t - t[0]) / T, polyint(cubic, 2 - order)).T
        found[-1, 1:] = 0.0  # but for round-off
        if self.baseline is Baseline.RETURN:
            found[-1, 0] = 0.0
        return found

    def motions(self, structure: Structure) -> tuple[Motion, ...]:
        """The motion of each support: of a fixed node, all; of a rod, what its support holds; of constraints.

        Raises:
            SceneError: where nothing is held, or the plane of a rod or a point mass does not let it follow.
        """
        held = {rod.name: held_directions(rod) for rod in structure.rods if rod.support.directions}
        held |= dict.fromkeys(structure.fixed_nodes, np.eye(3))
        weights = {one.name: sum(one.nodes.values()) for one in structure.constraints}
        held |= {one.name: one.unit[None] for one in structure.constraints if weights[one.name]}
        if not held:
            raise refused(self, f"structure '{structure.name}' has neither a support nor a fixed node that could shake")
        if len(held) * len(self.times) > MOST_STATES:
            raise refused(
                self,
                f"{len(self.times)} times for {len(held)} supports; at most {MOST_STATES} in all: give fewer times",
            )
        states = self.states
        planes = [("rod", rod.name, rod.support.plane) for rod in structure.rods]
        planes += [("point mass", point.node, point.plane) for point in structure.point_masses]
        for kind, name, plane in planes:
            if plane is not None:
                across = np.abs(states @ (np.array(plane) / np.linalg.norm(plane)))
                if np.any(across > TOLERANCE * np.abs(states).max()):
                    raise refused(
                        self,
                        f"it shakes across the plane of {kind} '{name}' of normal {list(plane)}, which stands still: "
                        "leave that direction out of the record, or the plane out of the structure",
                    )
        found = ((name, weights.get(name, 1.0) * (states @ axes.T @ axes)) for name, axes in held.items())
        moving = [(name, own) for name, own in found if name not in weights or np.any(own)]
        return tuple(Motion.data(name, self.record[0], *np.moveaxis(own, 1, 0)) for name, own in moving)

    def shake(self, scene: Scene) -> Scene:
        """The scene whose supports follow the record.

        Raises:
            OptionError: for what is no scene.
            SceneError: where supports have motions of their own or cannot follow, or a floor stands still.
        """
        instance("scene", scene, Scene, "use a Scene, or load_scene(name or path)")
        if scene.contact is not None and scene.contact.floor is not None:
            raise refused(self, "the floor of contacts stands still: hold the structure by supports, or leave one out")
        return scene.with_(motions=(*scene.motions, *self.motions(scene.structure)))
