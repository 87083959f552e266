"""Contact in the reference engine: what its compiled functions read of a scene, and the report of a run."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.dynamics.contact import COULOMB, FLOOR, MUJOCO, room_size
from tensegrity_mj.dynamics.native.views import Table
from tensegrity_mj.model.elements.contact import FRICTION_IMPEDANCE, Contact, ContactLaw, Spin, held_nodes
from tensegrity_mj.model.rods import axial_moment
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure

CROWD = 400  # contacts at a time where rods touch each other, which are solved together: of more, a run warns
LONGEST_STEP = 5e-3  # s, of methods that choose their steps: a body that falls into a longer one may be out of it again


def packed(contact: Contact, structure: Structure, coordinates: int) -> Table:
    """The floor and its law, for compiled functions; `coordinates`: how many there are before those of spins."""
    normal = contact.up
    # Friction is the same along both tangents: any two will do.
    first = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    first /= np.linalg.norm(first)
    stiffness, damping, (d0, d1, width, middle, power) = contact.spring
    axial, radii = axial_moments(contact, structure), np.array([rod.radius for rod in structure.rods], float)
    lowest = np.where(held_nodes(structure, contact), -np.inf, contact.floor or 0.0)
    table = Table("Floor", FLOOR)
    table.set(
        radii=radii,
        axial=axial,
        spin_place=coordinates if axial.any() else -1,
        lowest=lowest[structure.rod_nodes] + radii[:, None],
        ground=lowest[[structure.node_index[point.node] for point in structure.lone_masses]],
        frame=np.stack([normal, first, np.cross(normal, first)]),
        kind=COULOMB if contact.law is ContactLaw.COULOMB else MUJOCO,
        friction=contact.friction,
        stiffness=stiffness,
        damping=damping,
        d0=d0,
        d1=d1,
        width=width,
        middle=middle,
        power=power,
        per_ratio=1.0 / FRICTION_IMPEDANCE,
    )
    if contact.rods:
        table.set(there=contact.floor is not None, **_crowd(contact, structure))
    return table


def _crowd(contact: Contact, structure: Structure) -> dict[str, Any]:
    """The pairs of rods that touch each other, and room for what is found of a state's contacts."""
    rods = len(structure.rods)
    apart = {frozenset(names) for names in contact.exclude}
    pairs = np.array(
        [
            (a, o)
            for a, o in itertools.combinations(range(rods), 2)
            if {structure.rods[a].name, structure.rods[o].name} not in apart
        ],
        np.int64,
    ).reshape(-1, 2)
    most = min(2 * rods + 2 * len(pairs), CROWD) + 1
    return {
        "pairs": pairs,
        "sides": np.zeros((most, 2), np.int64),
        "parts": np.zeros((most, 2)),
        "arms": np.zeros((most, 2, 3)),
        "gaps": np.zeros(most),
        "frames": np.zeros((most, 3, 3)),
        "loads": np.zeros((rods, 6)),
        "free": np.zeros((rods, 6)),
        "room": np.zeros(room_size(most)),
    }


def axial_moments(contact: Contact, structure: Structure) -> Array:
    """(R,) [kg m²]: moments of inertia about the rods' own axes, 0 of those that contact does not turn about them."""
    free = contact.spin is Spin.FREE and contact.friction > 0
    return np.array([axial_moment(rod) if free and rod.support.plane is None else 0.0 for rod in structure.rods])


def contact_columns(structure: Structure) -> int:
    """Count of numbers behind λ: forces on each end of a rod and each point mass, the number of
    contacts, the largest normal force [N] and the largest depth [m].
    """
    return 3 * (2 * len(structure.rods) + len(structure.lone_masses) + 1)


def contact_warnings(floor: Table, looked: int) -> list[str]:
    """Sentences on states whose contact forces were not found, of those that the run looked at."""
    unsolved, beyond = floor["unsolved"], floor["beyond"]
    found = []
    if beyond:
        found.append(
            f"at {beyond} of {looked} states more than {CROWD} contacts touched, and those beyond {CROWD} were left "
            "out: use MuJoCo, or fewer rods that touch"
        )
    if unsolved:
        found.append(
            f"the forces of contacts were not found {unsolved} times in {looked} states: with much friction on hard "
            "ones there may be no unique ones; use less friction, an impedance with a smaller d1, or by Coulomb's law "
            "law = 'mujoco'"
        )
    return found


def contact_report(scene: Scene, rows: Array, at: int) -> dict[str, Any]:
    """`reports["contact"]` of recorded rows, whose contact forces begin at a column."""
    structure, contact = scene.structure, scene.contact
    assert contact is not None
    ends = structure.rod_nodes.ravel()
    points = np.array([structure.node_index[point.node] for point in structure.lone_masses], int)
    touched = np.concatenate([ends, points])
    forces = rows[:, at : at + 3 * len(touched)].reshape(len(rows), -1, 3)
    counts, normal_forces, depths = np.nan_to_num(rows[:, at + 3 * len(touched) :]).T
    final = np.zeros((len(structure.nodes), 3))
    np.add.at(final, touched, forces[-1])
    return {
        "touching": counts.astype(int).tolist(),  # contacts at each recorded time
        "largest_normal_force": float(normal_forces.max(initial=0.0)),  # [N], at the recorded times
        "deepest": float(depths.max(initial=0.0)),  # [m]: largest overlap at the recorded times
        "final_forces": {  # [N], on the nodes at the last recorded time
            name: force.tolist() for name, force in zip(structure.node_names, final, strict=True) if force.any()
        },
    }
