"""Motions of a whole structure as one body: which of them loads drive, which nothing resists, which nothing stops."""

from __future__ import annotations

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.errors import InfeasibleError
from tensegrity_mj.model.rigidity import body_motions, turned
from tensegrity_mj.statics.boundary import Boundary
from tensegrity_mj.statics.model import StaticModel

FEET = 1e-3  # of the extent: nodes within it of the lowest are feet


def require_held(model: StaticModel, parameter: float) -> None:
    """Raise InfeasibleError where weights and loads push the whole along a straight line that nothing holds."""
    resisted = (model.element_stiffness(model.start.ravel()) / model.scale[1],) if model.elements else ()
    free = model.boundary.straight_ways(*resisted)
    external = model.external(parameter)
    force = free @ (free.T @ external.reshape(-1, 3).sum(axis=0))
    if np.linalg.norm(force) <= 1e-9 * np.abs(external).sum():
        return
    scene = model.scene
    remedy = "take gravity out (gravity = (0, 0, 0), --no-gravity) to see it as it falls freely"
    if scene.water is not None and scene.structure.rods:
        remedy = (
            "buoyancy is that of the start, wherever it would float, so take gravity out, and buoyancy with it "
            "(gravity = (0, 0, 0), --no-gravity)"
        )
    floor = "" if scene.contact is None else _standing(model)
    raise InfeasibleError(
        f"'{scene.name}': what acts on it pushes the whole with ({force[0]:.6g}, {force[1]:.6g}, {force[2]:.6g}) N, "
        f"and nothing holds it in that direction: there is no equilibrium; {remedy}, or hold nodes (holds, --hold) to "
        f"see it stand{floor}"
    )


def _standing(model: StaticModel) -> str:
    """Explain how to replace the contact that statics leaves out by a floor: by the heights of the lowest nodes."""
    contact, names, nodes = model.scene.contact, model.structure.node_names, model.start
    if contact is None or contact.floor is None or contact.terrain is not None:
        return "; statics leaves the scene's contact out"
    heights = nodes @ contact.up
    least = max(FEET * float(np.ptp(nodes, axis=0).max()), float(np.sort(heights)[:3].max() - heights.min()))
    feet = [name for name, height in zip(names, heights - heights.min(), strict=True) if height <= least]
    first = ", ".join(f'"{name}"' for name in feet[:3])
    held = f"--hold {','.join(feet)}:z" if abs(contact.up[2]) > 1 - 1e-9 else ""
    held = f"{held}, in Python " if held else ""
    return (
        f"; statics leaves the scene's contact out: on a floor without friction it stands by the heights of its feet, "
        f"{held}tmj.statics.stand(scene, [{first}])"
    )


def neutral_motions(model: StaticModel, x: Array, parameter: float, rod_forces: Array) -> Array:
    """Orthonormal motions (3N, p) of the whole as one body that change no energy: what no stiffness resists.

    Translations across the external forces, and turns about an axis to which all of these are parallel, as far as
    supports and holds leave them, and as far as these keep them on their way: a node that a guide holds on a
    straight line leaves the circle about an axis at once, and the reaction of the guide resists.

    At x (3N,) [m], for the parameter of a path, under axial forces N (R,) [N] of the rods.
    """
    G, Z = model.boundary.quick
    bodies = body_motions(x.reshape(-1, 3))
    forces = model.external(parameter)
    largest = float(np.abs(forces).max(initial=0.0))
    rows = [np.zeros((6, 6)), np.asarray(G @ bodies)]

    def by_turning(force: Array) -> Array:
        """Return the change of forces (3N,) when the whole turns, on the free coordinates (q, 6)."""
        change = np.asarray(Z.T @ turned(force.reshape(-1, 3)))
        return np.hstack([np.zeros_like(change), change])

    if largest > 0:
        free = Z @ (Z.T @ forces) / largest
        rows += [(free @ bodies)[None], by_turning(free)]
    if model.elements:
        rows.append(Z.T @ (model.element_stiffness(x) @ bodies) / model.scale[1])
    if G.shape[0]:
        inside = model.gradient(x, parameter)
        carried = np.concatenate([model.tensions(model.lengths(x)), rod_forces])
        scale = float(np.abs(carried).max(initial=0.0)) + largest
        held = inside + model.rod_pulls(x, rod_forces)
        if scale > 0:
            rows.append(by_turning((held - Z @ (Z.T @ held)) / scale))
    _, singular, right = np.linalg.svd(np.vstack(rows), full_matrices=False)
    found = bodies @ right[singular < 1e-7].T
    left, singular, _ = np.linalg.svd(found, full_matrices=False)
    # Nodes on one line: turning about it moves none; nearly on one: as little as the bound above lets through.
    return np.asarray(left[:, singular > 1e-6])


def lasting_motions(boundary: Boundary, nodes: Array) -> Array:
    """Orthonormal motions (3N, p) of the whole as one body that go on, as far as supports and holds leave them.

    A turn is one of them where what holds the nodes turns into itself: where it does not, the nodes leave the
    circle, and the motion is a mechanism of the structure and its supports.
    """
    G, Z = boundary.rows, boundary.Z
    bodies = body_motions(nodes)
    rows = [np.zeros((6, 6)), np.asarray(G @ bodies)]
    for held in G.toarray():
        change = np.asarray(Z.T @ turned(held.reshape(-1, 3)))
        rows.append(np.hstack([np.zeros_like(change), change]))
    _, values, right = np.linalg.svd(np.vstack(rows), full_matrices=False)
    left, size, _ = np.linalg.svd(bodies @ right[values < 1e-7].T, full_matrices=False)
    return np.asarray(left[:, size > 1e-9])
