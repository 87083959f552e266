"""A spine of tetrahedral vertebrae, as of the ULTRA Spine: bodies that strings alone hold apart, eight a joint."""

from __future__ import annotations

from typing import Any

import numpy as np

from tensegrity_mj.basics import kinds
from tensegrity_mj.basics.checks import check_nodes
from tensegrity_mj.basics.fields import field, function_of, refused, value
from tensegrity_mj.errors import InfeasibleError, OptionError
from tensegrity_mj.library.cable import GRAVITY, scene_of
from tensegrity_mj.model.bodies import Body
from tensegrity_mj.model.members import String
from tensegrity_mj.model.rigidity import equilibrium_matrix, free_motions, loads_on
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure

CORNERS = ("left", "right", "front", "back")
SOURCE = (
    "A. P. Sabelhaus et al., Inverse statics optimization for compound tensegrity robots, IEEE RA-L 2020, and "
    "ultra-spine-simulations (BEST Lab, Berkeley): shape, mass and strings of a vertebra"
)


@value("spine", OptionError, positional=1)
class Spine:
    """Vertebrae above each other, the lowest held; each carries the next by eight strings, in equilibrium.

    A vertebra is four equal thin rods from its centre: two down to the left and right corner, two up to the front and
    back one. Four strings run up between the same corners of two vertebrae, four are saddles from the upper corners of
    one to the lower corners of the next, which hangs between them.

    Attributes:
        vertebrae: 2 or more, with the one that is held.
        height, width: height of a vertebra, and distance from its centre to a corner's side [m].
        spacing: distance of the vertebrae [m], less than their height: the saddles pull down.
        mass: mass of a vertebra [kg].
        stiffness, damping: stiffness and damping of strings [N/m], [N s/m].
        tension: tension of the upright strings at least [N].
        push: with which the highest vertebra starts aside [m/s].
        gravity: [m/s²].
        duration: [s].
        name: name of scene and structure.

    Raises:
        OptionError, StructureError, SceneError: for parameters that make no such scene.
        InfeasibleError: where strings that pull cannot carry it upright.
    """

    vertebrae: int = field(kinds.whole(2), default=4)
    height: float = field(kinds.positive("m"), default=0.15)
    width: float = field(kinds.positive("m"), default=0.075)
    spacing: float = field(kinds.positive("m"), default=0.1)
    mass: float = field(kinds.positive("kg"), default=0.136)
    stiffness: float = 2000.0
    damping: float = 0.5
    tension: float = field(kinds.positive("N"), default=20.0)
    push: float = field(kinds.finite("m/s"), default=1.5)
    gravity: float = field(kinds.not_negative("m/s²"), default=GRAVITY)
    duration: float = 3.0
    name: str = "spine"

    def __call__(self) -> Scene:
        count, half, w = self.vertebrae, self.height / 2, self.width
        check_nodes("spine: vertebrae", count, 4 * count)
        if self.spacing >= self.height:
            raise refused(self, f"spacing = {self.spacing:g} m; it must be below the height, {self.height:g} m")
        ends = np.array([[-w, 0, -half], [w, 0, -half], [0, -w, half], [0, w, half]])
        # Four thin rods of m/4 from the centre to the corners p: Σ m/12 (p·p 1 - p pᵀ), diagonal here.
        inertia = tuple((self.mass / 12 * (np.sum(ends**2) - np.sum(ends**2, axis=0))).tolist())
        nodes: dict[str, Any] = {}
        bodies, strings = [], []
        for k in range(count):
            places = ends + np.array([0, 0, k * self.spacing + half])
            names = tuple(f"{corner}{k}" for corner in CORNERS)
            nodes |= dict(zip(names, map(tuple, places.tolist()), strict=True))
            bodies.append(Body(f"vertebra{k}", names, self.mass, inertia, held=k == 0))
        for k in range(1, count):
            pairs = [(f"upright_{corner}{k}", f"{corner}{k - 1}", f"{corner}{k}") for corner in CORNERS]
            saddles = [(high, low) for high in CORNERS[2:] for low in CORNERS[:2]]
            pairs += [(f"saddle_{high}_{low}{k}", f"{high}{k - 1}", f"{low}{k}") for high, low in saddles]
            strings += [String(name, (i, j), self.stiffness, self.damping) for name, i, j in pairs]
        structure = Structure(self.name, nodes, strings=tuple(strings), bodies=tuple(bodies))
        structure = structure.with_strings(force_density=self._force_densities(structure))
        rates = np.zeros((len(nodes), 3))
        rates[-4:, 0] = self.push
        return scene_of(self, structure, SOURCE, initial_velocities=rates if self.push else None)

    def _force_densities(self, structure: Structure) -> list[float]:
        """u [N/m] that balance the weights: the upright strings of each joint alike, and the saddles alike."""
        joints = self.vertebrae - 1
        groups = np.kron(np.eye(2 * joints), np.ones((4, 1)))  # four upright ones, four saddles, joint by joint
        A = equilibrium_matrix(structure) @ groups
        weight = free_motions(structure).T @ loads_on(structure, (0.0, 0.0, -self.gravity), None).ravel()
        # Upright strings as tense as is wanted; saddles follow, joint by joint from above.
        upright = np.full(joints, self.tension / self.spacing)
        known = A[:, ::2] @ upright + weight
        saddles, *_ = np.linalg.lstsq(A[:, 1::2], -known, rcond=None)
        found = np.empty(2 * joints)
        found[::2], found[1::2] = upright, saddles
        if np.abs(A @ found + weight).max() > 1e-9 * np.abs(A).max() * upright[0] or saddles.min() <= 0:
            raise InfeasibleError(
                f"spine: strings that pull do not carry it upright with tension = {self.tension:g} N: use a larger one"
            )
        return [float(u) for u in groups @ found]


spine = function_of(Spine)
