"""Small motions about a state: mass, stiffness and damping of all rods, point masses and taut strings.

    ÿ + (D + D_law) ẏ + (K + K_law) y = 0

in coordinates that make the mass matrix one. A body (a rod, then a point mass) has five of them: three for its
translations z along the support's basis E (2.41), two for the ways that b can turn; what a support forbids stays zero.
Where rods are elastic there is a sixth, by which b lengthens: their k and c are part of what is said of strings below.
With M = L Lᵀ the mass matrix of a body (m, f, J of (2.30)), (z, turns) = L⁻ᵀ y, and a node moves by X y.

    K = material + geometric
    material  = Σ k Xᵀ s sᵀ X                       of the taut strings, s the unit vector along a string
    geometric = Σ T/L Xᵀ (1 - s sᵀ) X + Σ (t_b - f r̈)·b on the turns of each rod
    D = Σ c Xᵀ s sᵀ X

X being the difference of a string's two nodes (of a path of more, Xᵀ s is the sum of its segments', and T/L stands for
each segment with its own length), t_b the generalized force on b (2.55): a rod's compression makes the
last term negative. It is the linear model of `linearization`, from closed forms, without what the velocities of the
state do to it (centrifugal and gyroscopic terms), and away from an equilibrium without one term, of the accelerations
of rods that are held at a point of σ ≠ 1/2 with translations left, that is not symmetric.

Where rods share nodes, `joints` takes out what the joints forbid, and the forces of the joints are part of
t_b: a hanging cable is held by the weight that its rods carry, a swinging one by more. There velocities do count: the
forces are those that turn the rods on their ways, and what is left of -J |ḃ|² on a rod's own turns is added. That is
all of the tangential stiffness of the motion but a part that is not above zero. Supports that move push with -d̈.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.kinds import SMALLEST
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.strings import on_taut_side
from tensegrity_mj.vibration.blocks import Blocks, is_dense, spring_blocks
from tensegrity_mj.vibration.bodies import Bodies
from tensegrity_mj.vibration.state import State, geometric_of_rods


@dataclass(frozen=True, eq=False)
class LawDerivative:
    """Contribution of a law to the linear model, in the coordinates y: matrices (n, n), not symmetric."""

    stiffness: Array
    damping: Array


@dataclass(frozen=True, eq=False)
class Vibration:
    """The linear model of one state; n coordinates. Matrices are dense up to `DENSE` coordinates, else sparse.

    Attributes:
        state: the scene and its state.
        taut: (M,) bool.
        at_edge: (M,) bool, taut without tension: half of any motion makes it slack.
        tension: (M,) [N].
        stiffness: (M,) [N/m] of each string in this model: k, or its curve's slope; u where force densities are held.
        damping: (M,) [N s/m].
        law: contribution of a law in the loop, or None.

    Its matrices are made when they are first used. Dense ones leave out the motions that joints of the state forbid;
    for sparse ones `project` removes them.
    """

    state: State
    taut: NDArray[np.bool_]
    at_edge: NDArray[np.bool_]
    tension: Array
    stiffness: Array
    damping: Array
    law: LawDerivative | None = None

    @cached_property
    def rods(self) -> tuple[Array, Array]:
        """Blocks (B, slots, slots) [1/s²] of the geometric stiffness that bodies have, and ÿ (n,), `acceleration`."""
        paths, directions = self.scene.structure.paths, self.state.segments.directions
        return geometric_of_rods(self.state, directions * self.tension[paths.strings, None])

    @property
    def acceleration(self) -> Array:
        """(n,) [√kg m/s²] ÿ of the state: zero at rest in an equilibrium."""
        return self.rods[1]

    @cached_property
    def bars(self) -> Any:
        """(n, n) [1/s²] the part of `material` that elastic rods have."""
        return self.state.assembly.sum(self.state.bars()[0])

    @cached_property
    def material(self) -> Any:
        """(n, n) [1/s²] the part of K above of strings that stretch, and of what else resists motions."""
        own = self._of_strings(along=self.stiffness) + self.bars
        return sum((self.state.assembly.sum(part) for part in self.state.resisting[0]), own)

    @cached_property
    def geometric(self) -> Any:
        """(n, n) [1/s²] the part of K above of tensions and of the forces on rods."""
        rows = np.arange(len(self.rods[0]))
        return self._of_strings(Blocks(self.rods[0], rows, rows), across=self.pull_per_length)

    @cached_property
    def damper(self) -> Any:
        """(n, n) [1/s] D above."""
        return sum((self.state.assembly.sum(part) for part in self.state.resisting[1]), self.string_damper)

    @cached_property
    def string_damper(self) -> Any:
        """(n, n) [1/s] the part of D that strings have: what MuJoCo's `discrete` integrator counts with."""
        return self._of_strings(self.state.bars()[1], along=self.damping)

    @cached_property
    def body_damper(self) -> Any:
        """(n, n) [1/s] the blocks of `string_damper` on single bodies: what the implicit integrators count with.

        Where rods share nodes half of `string_damper`, as if there were no dampers: in a tree of MuJoCo's bodies, which
        dampers an implicit integrator knows depends on the tree, and `integrators.TreeModel` has them.
        """
        if self.state.joints is not None:
            return 0.5 * self.string_damper
        return self._of_strings(self.state.bars()[1], between=False, along=self.damping)

    @cached_property
    def seen(self) -> Any:
        """(n, n) [1/s²] the material stiffness that MuJoCo's `discrete` integrator counts with: of k, always."""
        return self._of_strings(along=np.where(self.taut, self.scene.structure.stiffness, 0.0)) + self.bars

    def _of_strings(
        self,
        blocks: Blocks | None = None,
        between: bool = True,
        along: Array | None = None,
        across: Array | None = None,
    ) -> Any:
        """The matrix of stiffnesses or dampers (M,) along strings or (S,) across segments, with blocks added."""
        paths, directions = self.scene.structure.paths, self.state.segments.directions
        along = np.zeros(len(self.taut)) if along is None else along
        across = np.zeros(len(directions)) if across is None else across
        return self.state.assembly(spring_blocks(paths, directions, along, across), blocks, between)

    @property
    def scene(self) -> Scene:
        """Scene of the model."""
        return self.state.scene

    @property
    def size(self) -> int:
        """n."""
        return self.state.bodies.slots * len(self.state.bodies.mass)

    @property
    def pull_per_length(self) -> Array:
        """(S,) [N/m] T/l of each segment: what it resists motions across it with."""
        lengths = self.state.segments.lengths
        strings = self.scene.structure.paths.strings
        return np.asarray(self.tension[strings] / np.where(lengths > 0, lengths, 1.0))

    @property
    def is_dense(self) -> bool:
        """True where the matrices are dense arrays."""
        return is_dense(len(self.state.bodies.mass))

    def project(self, y: Array) -> Array:
        """Project y (n, ...) onto the motions that the joints allow."""
        return y if self.state.joints is None else self.state.joints.project(y)

    def motion(self, y: Array) -> Array:
        """(..., N, 3) displacements of the nodes of coordinates y (..., n), of what joints allow."""
        bodies, turned = self.state.bodies, self.state.motion.turned
        B, slots = len(bodies.mass), bodies.slots
        parts = np.zeros((*y.shape[:-1], B + 1, slots))
        parts[..., :B, :] = y.reshape(*y.shape[:-1], B, slots)
        return np.asarray(np.einsum("nxs,...ns->...nx", turned, parts[..., bodies.body, :]))


def vibration(
    scene: Scene,
    nodes: Array,
    velocities: Array,
    rest_lengths: Array,
    *,
    force_densities: Array | None = None,
    broken: NDArray[np.bool_] | None = None,
    time: float = 0.0,
    bodies: Bodies | None = None,
) -> Vibration:
    """The linear model about a state, with no law in the loop (`closed_loop` adds one).

    Args:
        scene: structure, gravity and loads.
        nodes, velocities: (N, 3); velocities count in the dampers' tensions alone.
        rest_lengths: (M,) [m].
        force_densities: (M,) [N/m] that are held instead of the rest lengths: a string then has the stiffness u in
            every direction.
        broken: (M,) strings that carry nothing.
        time: [s] of the loads.
        bodies: of the structure, where they are known already.
    """
    structure = scene.structure
    state = State(scene, bodies or Bodies.of(structure), nodes, velocities, time)
    length, curves = state.lengths, structure.curves
    taut, at_edge = on_taut_side(length, rest_lengths, nodes, broken)
    pull = curves.stiffness * (length - rest_lengths) if curves.linear else curves.tension(length - rest_lengths)
    total = pull + structure.damping * state.rates
    total = np.where(structure.clipped, np.maximum(0.0, total), total)
    tension = np.where(taut, total, 0.0)
    # At the edge of slackness, that of the taut side.
    k = curves.slope(np.maximum(length - rest_lengths, SMALLEST))
    stiffness = np.where(taut, k if force_densities is None else force_densities, 0.0)
    damping = np.where(taut, structure.damping, 0.0)

    return Vibration(state, taut, at_edge, tension, stiffness, damping)
