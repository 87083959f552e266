"""A state of equilibrium: positions, forces, stiffness, and the scene that starts there.

Where rigid rods and supports have states of self-stress s of their own, Zᵀ Cᵀ s = 0, every N + Σ a s is in equilibrium
with the same loads. The forces of all rods in some s are a choice, and so are the reactions that it changes, (1 - Z Zᵀ)
Cᵀ s. Chosen is the least sum of squares: Σ N² is, but for a factor, the energy of rods of equal stiffness EA/ℓ, so that
these are the forces of such rods as they become stiff.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.events import Load
from tensegrity_mj.model.redundancy import MOST_RODS, SHARE
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.statics import linear_systems
from tensegrity_mj.statics.linear_systems import Linearized
from tensegrity_mj.statics.model import StaticModel, round_off, weights_and_loads

RULE = "the least sum of squares, as of rods of one stiffness EA/ℓ"
REMEDY = "--rods elastic finds the forces of rods with sections"


@dataclass(frozen=True)
class Determinacy:
    """Determined and chosen forces of one state.

    Attributes:
        states: how many states of self-stress rigid rods and supports have alone; None where it was not looked at.
        chosen: names of the rods whose forces are a choice.
        reactions: names of the nodes whose reactions are.
        is_clear: whether their number does not hang on digits that the nodes do not have.
    """

    states: int | None = 0
    chosen: tuple[str, ...] = ()
    reactions: tuple[str, ...] = ()
    is_clear: bool = True

    def describe(self) -> str:
        """Return a remark on the forces that are a choice, or ""."""
        if self.states is None:
            return f"not checked whether forces are determined: more than {MOST_RODS} rigid rods; {REMEDY}"
        if not self.is_clear:
            return f"undecided whether forces are determined: rods are nearly redundant; {REMEDY}"
        if not self.chosen:
            return ""
        rods = ", ".join(f"'{name}'" for name in self.chosen[:8]) + (", ..." if len(self.chosen) > 8 else "")
        held = f", and the reactions at {len(self.reactions)} nodes with them" if self.reactions else ""
        return (
            f"{len(self.chosen)} of them ({rods}) are a choice{held}: these rigid rods are redundant, so that "
            f"equilibrium does not determine their forces; shown is {RULE}; {REMEDY}"
        )


def determinacy(model: StaticModel, x: Array) -> Determinacy:
    """Find which forces of rigid rods at x (3N,) are a choice; lengths determine those of elastic rods."""
    rigid = int(np.sum(model.compliance == 0))
    if not rigid:
        return Determinacy()
    if rigid > MOST_RODS:
        return Determinacy(None)
    own, clear = linear_systems.own_stresses(model, x)
    # A state of unit length is known to 1e-12 over the least singular value that counts: SHARE.
    inside = np.abs(own).max(axis=1, initial=0.0) > SHARE
    pushed = model.rod_slopes(x).T @ own
    pushed = pushed - model.boundary.Z @ (model.boundary.Z.T @ pushed)
    held = np.abs(pushed).max(axis=1, initial=0.0).reshape(-1, 3).max(axis=1) > SHARE
    structure = model.structure
    rods = tuple(rod.name for rod, chosen in zip(structure.rods, inside, strict=False) if chosen)
    nodes = tuple(name for name, chosen in zip(structure.node_names, held, strict=True) if chosen)
    return Determinacy(own.shape[1], rods, nodes if rods else (), clear)


EDGE = 1e-9  # of a string's length: nearer than that to its rest length, it is neither slack nor taut
NOISE = 100.0  # of what round-off leaves on a coordinate: a member that shares it with others may carry so much


@dataclass(frozen=True, eq=False)
class StaticState:
    """A structure in equilibrium; N nodes, R rods, M strings.

    Attributes:
        model: the problem that it solves.
        nodes: (N, 3) [m].
        bar_forces: [N] axial forces of the model's `bars`, rods first, negative in compression. Where rigid rods
            are redundant, nothing determines their own states of self-stress: these are the forces of least sum of
            squares, which have none of them (`determinacy` says of which).
        parameter: of the path that it is on: what further loads and holds' displacements are multiplied by.
        iterations: how many it took.
    """

    model: StaticModel
    nodes: Array
    bar_forces: Array
    parameter: float = 1.0
    iterations: int = 0

    @property
    def x(self) -> Array:
        """(3N,) the node positions, one after another."""
        return self.nodes.ravel()

    @cached_property
    def lengths(self) -> Array:
        """(M,) [m] of the strings."""
        return self.model.lengths(self.x)

    @cached_property
    def tensions(self) -> Array:
        """(M,) [N]."""
        return self.model.tensions(self.lengths)

    @property
    def force_densities(self) -> Array:
        """(M,) [N/m] of the strings."""
        return self.tensions / np.where(self.lengths > 0, self.lengths, 1.0)

    @property
    def slack(self) -> NDArray[np.bool_]:
        """(M,) strings without tension."""
        return self.tensions <= 0

    @property
    def at_edge(self) -> NDArray[np.bool_]:
        """(M,) strings as long as their rest length: neither slack nor taut."""
        return np.asarray(np.abs(self.lengths - self.model.rest_lengths) <= EDGE * self.lengths)

    def settled(self, forces: Array) -> Array:
        """Forces [N] of members with zero for those that round-off may have made."""
        least = NOISE * round_off(self.model, self.x, self.parameter, self.bar_forces)
        return np.where(np.abs(forces) <= least, 0.0, forces)

    @property
    def rod_forces(self) -> Array:
        """(R,) [N] axial forces of the rods."""
        return self.bar_forces[: len(self.model.structure.rods)]

    @cached_property
    def determinacy(self) -> Determinacy:
        """Forces of rods and reactions that equilibrium does not determine, so that they are a choice."""
        return determinacy(self.model, self.x)

    @property
    def rod_lengths(self) -> Array:
        """(R,) [m]: as they are; those of elastic rods change with their forces."""
        return self.bar_lengths[: len(self.model.structure.rods)]

    @cached_property
    def bar_lengths(self) -> Array:
        """[m] of the model's `bars`."""
        return self.model.rods(self.x).lengths

    @cached_property
    def residual(self) -> float:
        """[N]: the largest force that is left on a free coordinate."""
        return float(np.abs(self.linearized.left).max(initial=0.0))

    @cached_property
    def reactions(self) -> Array:
        """(N, 3) [N]: what supports and holds push the nodes with."""
        return self.model.reactions(self.x, self.bar_forces, self.parameter)

    @property
    def loads(self) -> Array:
        """(N, 3) [N] on the nodes from outside: weights, loads, wind, water, and elements that store energy."""
        return self.model.external(self.parameter).reshape(-1, 3) + self.model.element_forces(self.x).reshape(-1, 3)

    @property
    def energy(self) -> float:
        """[J] of strings, elastic rods, bent joints, weights and loads (the latter two from the model's start)."""
        return self.model.energy(self.x, self.parameter) + self.model.rod_energy(self.x)

    @property
    def linearized(self) -> Linearized:
        """The equations of equilibrium and their derivatives here."""
        return Linearized(self.model, self.x, self.parameter, self.bar_forces)

    @cached_property
    def neutral_motions(self) -> Array:
        """(3N, p) orthonormal: motions of the whole as one body that nothing resists."""
        return self.linearized.neutral

    @cached_property
    def lowest_stiffness(self) -> float:
        """[N/m]: the lowest eigenvalue of the stiffness on all motions but neutral ones; above zero: stable."""
        values, _ = self.softest(1)
        return float(values[0]) if len(values) else float("inf")

    @property
    def is_stable(self) -> bool:
        """True where every motion but neutral ones is resisted, beyond round-off."""
        return self.lowest_stiffness > 1e-12 * self.model.scale[1]

    def softest(self, count: int = 6) -> tuple[Array, Array]:
        """The lowest eigenvalues (m,) [N/m] of the stiffness, and their motions (3N, m), neutral ones left out."""
        return linear_systems.lowest_stiffness(self.linearized, count)

    def stiffness(self) -> Array:
        """K (t, t) [N/m] on the motions of `motions()`."""
        T = (at := self.linearized).tangent_basis()
        return np.asarray(T.T @ (at.stiffness @ T))

    def motions(self) -> Array:
        """(3N, t) orthonormal: all motions that supports, holds and rigid rods admit, to first order."""
        return np.asarray(self.model.boundary.Z @ self.linearized.tangent_basis())

    def scene(self, name: str | None = None) -> Scene:
        """The scene that starts here at rest, with these nodes as its structure's reference; strings keep their L0.

        Rods without a stiffness are rigid, as long as they are here. Holds, further loads and broken strings are of the
        study, not of the scene.
        """
        scene, structure = self.model.scene, self.model.structure
        there = structure.with_strings(rest_length=self.model.rest_lengths).placed(self.nodes)
        rods = [
            rod if rod.stiffness is None else replace(rod, rest_length=length)
            for rod, length in zip(there.rods, structure.rod_lengths.tolist(), strict=True)
        ]
        return scene.with_(
            structure=replace(there, name=name or structure.name, rods=tuple(rods)),
            initial_nodes=None,
            initial_velocities=None,
            name=scene.name if name is None else name,
        )


def standalone_scene(state: StaticState) -> Scene:
    """The scene that starts in this state at rest: further loads are loads of it, and broken strings are left out.

    Loads that are no Python function are as they are at t = 0, and so is the scene in balance there. Holds are of the
    study: where there are any, the scene lets go of them.

    Raises:
        StructureError, SceneError: where what is left makes no valid scene.
    """
    scene, model = state.scene(), state.model
    whole = model.whole
    if not whole.all():
        strings = scene.structure.strings
        gone = {string.name for string, there in zip(strings, whole, strict=True) if not there}
        kept = tuple(string for string in strings if string.name not in gone)
        scene = scene.with_(
            structure=replace(scene.structure, strings=kept),
            breaks=tuple(event for event in scene.breaks if event.string not in gone),
        )
    # In addition to weights and the scene's own loads: the state of a path that began under loads has some.
    further = state.parameter * model.loads + (model.forces - weights_and_loads(state.model.scene, model.start))
    return _loaded(scene, further) if np.any(further) else scene


def require_rigid_and_free(model: StaticModel) -> None:
    """Refuse what engines do not have.

    Raises:
        OptionError: for elastic rods, and holds.
    """
    if np.any((model.compliance > 0) & ~model.structure.elastic):
        raise OptionError(
            "engine: rods without a stiffness are rigid there, and the study's are elastic: use with_elastic_rods() of "
            "the structure, or leave one of the two out"
        )
    if model.holds:
        raise OptionError("engine: it has no holds; give the structure a support there, or leave the engine out")


def _loaded(scene: Scene, further: Array) -> Scene:
    if callable(scene.loads):
        own: Callable[[float], object] = scene.loads
        return scene.with_(loads=lambda time: np.asarray(own(time), float) + further)
    names = scene.structure.node_names
    added = tuple(
        Load(name, (float(f[0]), float(f[1]), float(f[2]))) for name, f in zip(names, further, strict=True) if np.any(f)
    )
    return scene.with_(loads=(*scene.loads, *added))
