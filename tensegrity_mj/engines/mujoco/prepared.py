"""Preparation of a scene for a run in MuJoCo, made once per layout, not once per run.

A layout is all of a scene that its compiled model depends on, but for the numbers of strings. These, the time step and
the integrator are set in each copy of the model, as the compiler would set them. Each model is held against its scene:
nodes, centers of mass, geometry.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.remembered import MOST, Remembered
from tensegrity_mj.engines.mujoco import contact, install, mjcf, run_view
from tensegrity_mj.engines.mujoco.mjcf_tree import SNAP, BodyTree, Names, body_tree, joint_coordinates
from tensegrity_mj.errors import StructureError
from tensegrity_mj.model.rods import mass_at_ends
from tensegrity_mj.model.scene import Scene

_remembered = Remembered()
_layouts: dict[Any, Prepared] = {}  # those used last
_spare: dict[str, Prepared] = {}  # "last": what the last run gave back
SMALL = 2**20  # bytes of data that are kept for another run


@dataclass(frozen=True, eq=False)
class Prepared:
    """A scene as MuJoCo steps it.

    Attributes:
        model: compiled; a run's own copy, since a run changes the limits of its actuators.
        tree: of the model's bodies.
        velocities: (nv,) joint velocities at the start; the positions at the start are the model's own.
        nodes: site, body and root of the kinematic tree of each node, (N,) int64 each.
        slides: (R, 11) of each rod, the number of its translational coordinates, their first dof, and their axes (3, 3)
            padded, by rows. Zeros where rods share nodes, whose accelerations are found afterwards.
        data: what runs are made in (`within`).
        table: of runs in it, with what is the same for all of them.
    """

    model: mujoco.MjModel
    tree: BodyTree
    velocities: Array
    nodes: tuple[Any, Any, Any]
    slides: Array
    data: Any = None
    table: Any = None  # a `Table`


def prepared(scene: Scene, timestep: float, integrator: str, userdata: int = 0) -> Prepared:
    """A scene for MuJoCo's integrator of that name and a step [s]; the model is a copy, with so many userdata.

    What is compiled is remembered while the scene lives, and of the last few layouts for other scenes.

    Raises:
        StructureError, SceneError, OptionError: as `MuJoCo.model`.
    """
    found = _known(scene, userdata)
    return _set(replace(found, model=copy.copy(found.model)), scene, timestep, integrator)


def lent(scene: Scene, timestep: float, integrator: str) -> Prepared:
    """Lend what `prepared` gives, with data at the start of the model, to a run that gives it back as it is.

    To make the objects of a small model takes as long as hundreds of its steps.
    """
    # No law_in of another thread, whose models have no userdata, takes such a model for its own.
    found = _known(scene, run_view.USERDATA_SIZE)
    spare = _spare.pop("last", found)
    if spare.tree is not found.tree or spare.data is None:
        spare = within(replace(found, model=copy.copy(found.model)))
    mujoco.mj_resetData(spare.model, spare.data)
    return _set(spare, scene, timestep, integrator)


def within(ready: Prepared, data: mujoco.MjData | None = None) -> Prepared:
    """Return a copy with the table of runs in `data`, by default new data."""
    data = mujoco.MjData(ready.model) if data is None else data
    return replace(ready, data=data, table=run_view.bound(ready.model, data, ready.nodes, ready.slides))


def give_back(ready: Prepared) -> None:
    """Keep what was `lent` for the next run of the layout, unless it is large; the run must not use it any more."""
    if ready.data is not None and ready.data.nbuffer < SMALL:
        _spare["last"] = ready


def _set(ready: Prepared, scene: Scene, timestep: float, integrator: str) -> Prepared:
    """Set what models of a layout do not share."""
    model = ready.model
    model.opt.timestep = timestep
    model.opt.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{integrator.upper()}")
    model.eq_solref[:, 0] = mjcf.CONNECT_STEPS * timestep
    gains, biases, most = mjcf.actuator_numbers(scene.structure)
    model.actuator_gainprm[:, 0], model.actuator_biasprm[:, :3], model.actuator_forcerange[:, 1] = gains, biases, most
    return ready


def _known(scene: Scene, userdata: int) -> Prepared:
    install.refuse_other_callbacks()
    found: Prepared = _remembered.get(scene, userdata, lambda: _of_layout(scene, userdata))
    return found


def _of_layout(scene: Scene, userdata: int) -> Prepared:
    layout = (userdata, _layout(scene))
    found = _layouts.pop(layout, None) or _compile(scene, userdata)
    while len(_layouts) >= MOST:
        _layouts.pop(next(iter(list(_layouts))), None)  # a copy: other threads may change it meanwhile
    _layouts[layout] = found
    return found


def _layout(scene: Scene) -> tuple[Any, ...]:
    """Key of all models that differ only in string parameters, time step or integrator."""
    structure = scene.structure
    return (
        (scene.name, scene.gravity, scene.contact, scene.motions),
        (structure.node_names, structure.fixed_nodes, structure.rods, structure.point_masses, structure.bodies),
        tuple((string.name, string.nodes) for string in structure.strings),
        tuple(array.tobytes() for array in (structure.positions, scene.nodes0, scene.velocities0)),
    )


def prepared_with(model: mujoco.MjModel, scene: Scene) -> Prepared:
    """Prepare a model that was made of a scene's MJCF."""
    tree = body_tree(scene)
    velocities = joint_coordinates(scene, tree, scene.nodes0, scene.velocities0)[1]
    sites = np.array([model.site(name).id for name in scene.structure.nodes], np.int64)
    bodies = model.site_bodyid[sites].astype(np.int64)
    nodes = (sites, bodies, model.body_rootid[bodies].astype(np.int64))
    return Prepared(model, tree, velocities, nodes, _slides(scene, model, tree))


def _compile(scene: Scene, userdata: int) -> Prepared:
    far = np.abs(scene.nodes0).max(axis=1) > mujoco.mjMAXVAL
    if far.any():
        number = int(np.argmax(far))
        raise StructureError(
            f"node '{scene.structure.node_names[number]}' is at {scene.nodes0[number].tolist()} m: MuJoCo takes "
            f"coordinates beyond {mujoco.mjMAXVAL:g} m for a divergence; move the structure nearer to the origin"
        )
    text = mjcf.scene_to_mjcf(scene)
    try:
        spec = mujoco.MjSpec.from_string(text)
        spec.nuserdata = userdata
        model = spec.compile()
    except ValueError as error:
        reason = " ".join(str(error).split())
        if "A + B >= C" in reason:
            reason += (
                ": a rod is thicker for its length than MuJoCo lets turn about its axis, beyond length/√3 if solid"
            )
        raise StructureError(
            f"structure '{scene.structure.name}': MuJoCo cannot hold it ({reason}); masses [kg] and moments of "
            f"inertia [kg m²] must be above {mujoco.mjMINVAL:g}: use units of the structure's own size, or the DAE"
        ) from error
    contact.hold_spins(model, scene)
    found = prepared_with(model, scene)
    check_places(scene, model, found.tree)
    return found


def _slides(scene: Scene, model: mujoco.MjModel, tree: BodyTree) -> Array:
    structure = scene.structure
    slides = np.zeros((len(structure.rods), 11))
    if structure.class_number > 1:
        return slides
    for row, rod, joint in zip(slides, structure.rods, tree.joints, strict=True):
        if rod.stiffness is not None:
            continue  # its λ follows from its length
        axes = joint.axes
        basis = np.zeros((3, 3))
        basis[:, : axes.shape[1]] = axes
        body = model.site_bodyid[model.site(rod.nodes[0]).id]
        row[0], row[1], row[2:] = axes.shape[1], model.body_dofadr[body], basis.ravel()
    return slides


TOLERANCE = 1e-12  # of the structure's size
ROUND_OFF = 8 * float(np.finfo(float).eps)  # of coordinates, for each body that a frame is carried by


def check_places(scene: Scene, model: mujoco.MjModel, tree: BodyTree | None = None) -> None:
    """Check that sites, centers of mass and capsules of a scene's model are where its structure has them.

    MuJoCo's compiler takes frames nearer than 1e-6 m for one, which `must_turn` avoids: this is the proof. The
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
