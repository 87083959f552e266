"""STEDY's reference files as scenes: bars, strings, supports, loads as the file states them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.model.events import Load
from tensegrity_mj.model.members import Support
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.strings import StringLaw
from tensegrity_mj.model.structure import Structure

Array = NDArray[np.float64]


def scene_of(data: dict[str, Array]) -> Scene:
    """The scene of a STEDY file whose bars share no node (class 1); the file's own constants to the last digit."""
    nodes = data["N0"].T
    rods, strings = pairs(data["Cb"]), pairs(data["Cs"])
    held = data["fixed"].T.astype(bool)
    points = zip(data["point_mass_location"], data["point_mass"], strict=True)
    structure = Structure.from_arrays(
        nodes,
        rods,
        strings,
        rod_mass=data["bar_mass"],
        stiffness=data["k"],
        damping=data["c"],
        rest_length=data["L0"],
        supports=[support(held[i], held[j]) for i, j in rods],
        point_masses={int(np.argmax(where)): float(mass) for where, mass in points},
        name="stedy",
        string_law=StringLaw.UNCLIPPED,
    )
    loads = []
    if "extF_pattern" in data:
        # pattern · sin t
        loads = [
            Load(name, tuple(force), angular_frequency=1.0, phase=-np.pi / 2)
            for name, force in zip(structure.nodes, data["extF_pattern"], strict=True)
            if np.any(force != 0)
        ]
    return Scene(
        structure,
        gravity=tuple(data["g"]),
        initial_velocities=data["V0"].T,
        loads=tuple(loads),
        duration=float(data["t"][-1]),
    )


def pairs(connectivity: Array) -> list[tuple[int, int]]:
    """(start, end) of each row, -1 where a member starts and +1 where it ends."""
    return [(int(np.argmin(row)), int(np.argmax(row))) for row in connectivity]


def support(first: Array, second: Array) -> Support:
    """A bar's support from the held coordinates of its ends (3,) bool: free, one end pinned, or that in a plane."""
    if not first.any() and not second.any():
        return Support.free()
    assert first.all() != second.all(), "at most one end of a bar may be fixed in space"
    sigma, other = (0.0, second) if first.all() else (1.0, first)
    assert other.sum() <= 1, "the other end may be held in one direction at most"
    plane = np.eye(3)[int(np.argmax(other))] if other.any() else None
    return Support.pinned(sigma, plane)


def largest_frequency(data: dict[str, Array]) -> float:
    """An upper bound of the natural frequencies [rad/s].

    A string's stiffness is at most k in every direction (its tension is below k L), and rods that are rigid only
    lower frequencies; beside the strings there is gravity on a pinned rod, √(3 g / 2 ℓ).
    """
    stiffness = np.kron(data["Cs"].T @ (data["k"][:, None] * data["Cs"]), np.eye(3))
    squares = np.linalg.eigvals(np.linalg.solve(data["mass_matrix"], stiffness)).real
    pendulum = 1.5 * np.linalg.norm(data["g"]) / data["bar_len"].min()
    return float(np.sqrt(squares.max() + pendulum))
