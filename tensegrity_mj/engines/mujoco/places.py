"""Whether a compiled model stands where its scene does: nodes, centers of mass, and geometry of rods."""

from __future__ import annotations

import mujoco
import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.engines.mujoco.mjcf_bodies import Names
from tensegrity_mj.engines.mujoco.mjcf_frames import SNAP
from tensegrity_mj.engines.mujoco.mjcf_tree import BodyTree, body_tree
from tensegrity_mj.errors import StructureError
from tensegrity_mj.model.rods import mass_at_ends
from tensegrity_mj.model.scene import Scene

TOLERANCE = 1e-12  # of the structure's size
ROUND_OFF = 8 * float(np.finfo(float).eps)  # of coordinates, for each body that a frame is carried by


def check_places(scene: Scene, model: mujoco.MjModel, tree: BodyTree | None = None) -> None:
    """Check that sites, centers of mass and capsules of a scene's model are where its structure has them.

    MuJoCo's compiler takes frames nearer than 1e-6 m for one, which `mjcf_frames` avoids: this is the proof. The
    tolerance is 1e-12 of the structure's size, the round-off of its coordinates, and by how much given start positions
    stretch rods, within what `validation` allows.

    Raises:
        StructureError: naming what stands elsewhere, and how far.
    """
    tree = body_tree(scene) if tree is None else tree
    structure, nodes = scene.structure, scene.nodes0
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    size = float(np.max(np.ptp(nodes, axis=0), initial=0.0))
    first, second = structure.rod_nodes.T
    rigid = [row for row, rod in enumerate(structure.rods) if rod.stiffness is None]
    stretched = np.abs(np.linalg.norm(nodes[second] - nodes[first], axis=1) - structure.rod_lengths)[rigid]
    unknown = ROUND_OFF * float(np.max(np.abs(nodes), initial=0.0)) + float(np.max(stretched, initial=0.0))
    allowed = TOLERANCE * size + (1 + tree.depth) * unknown

    sites = np.array([model.site(name).id for name in structure.node_names], int)
    _compare("node", structure.node_names, data.site_xpos[sites], nodes, allowed)
    centers = np.array([frame.placed(nodes)[0] for frame in structure.frames]).reshape(-1, 3)
    names = tuple(Names(scene, tree).bodies)
    bodies = np.array([model.body(name).id for name in names], int)
    _compare("center of mass of body", names, data.xipos[bodies], centers, allowed)
    if not structure.rods:
        return
    # Where a rod ends at a node that another rod's body carries, and a constraint joins the two.
    ends = tuple(Names(scene, tree).ends)
    joined = np.array([nodes[node] for node, _, _ in tree.forest.closures]).reshape(-1, 3)
    sites = np.array([model.site(name).id for name in ends], int)
    _compare("end", ends, data.site_xpos[sites], joined, allowed)
    names = tuple(structure.rods[row].name for row in rigid)
    geoms = np.array([model.geom(name).id for name in names], int)
    bodies = model.geom_bodyid[geoms]
    middle = 0.5 * (nodes[first] + nodes[second])[rigid]
    share = (mass_at_ends(structure)[:, 1] / structure.rod_masses)[:, None]
    centers = ((1.0 - share) * nodes[first] + share * nodes[second])[rigid]
    _compare("center of mass of rod", names, data.xipos[bodies], centers, allowed)
    _compare("capsule of rod", names, data.geom_xpos[geoms], middle, allowed)


def _compare(kind: str, names: tuple[str, ...], found: Array, wanted: Array, allowed: float) -> None:
    gaps = np.max(np.abs(found - wanted), axis=1, initial=0.0)
    if not len(gaps) or np.max(gaps) <= allowed:
        return
    worst = int(np.argmax(gaps))
    raise StructureError(
        f"{kind} '{names[worst]}' is {gaps[worst]:.3g} m off its place {wanted[worst].tolist()} m in the compiled "
        f"MuJoCo model (allowed: {allowed:.3g} m); MuJoCo takes frames nearer than {0.5 * SNAP:g} m for one: use "
        "larger units of length, or the DAE"
    )
