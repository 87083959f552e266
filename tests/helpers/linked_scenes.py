"""Small scenes of rods that share nodes, for the tests of class k: chains, trees, loops."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.model.members import Rod, String, Support
from tensegrity_mj.model.motion import Motion
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure

Array = NDArray[np.float64]
Y = (0.0, 1.0, 0.0)
GRAVITY = (0.0, 0.0, -9.81)


def random_tree(rng: np.random.Generator, rods: int, planar: bool, held: str = "pinned") -> Scene:
    """A tree of rods in motion, ends in any order, with strings between its nodes and to a fixed node."""
    plane = Y if planar else None
    places, pairs = [np.zeros(3)], []
    for _ in range(rods):
        node = int(rng.integers(len(places)))
        step = rng.normal(size=3) * ([1, 0, 1] if planar else 1)
        places.append(places[node] + step / np.linalg.norm(step) * rng.uniform(0.3, 0.8))
        pairs.append((node, len(places) - 1))
    velocities = np.zeros((rods + 2, 3))
    if held == "free":
        velocities[:] = rng.normal(size=3) * ([1, 0, 1] if planar else 1)
    for i, j in pairs:
        spin = rng.normal(size=3) * ([0, 2, 0] if planar else 2)
        velocities[j] = velocities[i] + np.cross(spin, places[j] - places[i])
    nodes = {f"n{k}": tuple(place.tolist()) for k, place in enumerate(places)}
    nodes["fixed"] = (0.4, 0.0, 1.5)
    velocities[-1] = 0.0
    members = []
    for k, (i, j) in enumerate(pairs):
        swapped = bool(rng.integers(2))
        ends = (f"n{j}", f"n{i}") if swapped else (f"n{i}", f"n{j}")
        support = Support.free(float(rng.uniform()), plane)
        if k == 0 and held == "pinned":
            support = Support.pinned(float(swapped), plane)
        members.append(Rod(f"r{k}", ends, float(rng.uniform(0.2, 2.0)), support=support))
    strings = tuple(
        String(f"s{k}", ends, float(rng.uniform(5, 30)), rest_length=0.1)
        for k, ends in enumerate((("fixed", f"n{rods}"), ("fixed", f"n{rods // 2}")))
        if ends[1] != "n0" or held == "free"
    )
    structure = Structure("tree", nodes, tuple(members), strings, fixed_nodes=("fixed",))
    return Scene(structure, gravity=GRAVITY, initial_velocities=velocities)


def hanging_chain(
    lengths: Sequence[float], masses: Sequence[float], motions: tuple[Motion, ...] = (), planar: bool = False
) -> Scene:
    """A chain that hangs straight down from a support, its rods r0, r1, ..."""
    plane = Y if planar else None
    heights = -np.concatenate([[0.0], np.cumsum(lengths)])
    nodes = {f"n{k}": (0.0, 0.0, float(z)) for k, z in enumerate(heights)}
    rods = tuple(
        Rod(
            f"r{k}",
            (f"n{k}", f"n{k + 1}"),
            float(m),
            support=Support.free(plane=plane) if k else Support.pinned(0.0, plane),
        )
        for k, m in enumerate(masses)
    )
    return Scene(Structure("chain", nodes, rods), gravity=GRAVITY, motions=motions)


def thesis_cable(motions: tuple[Motion, ...] = ()) -> Scene:
    """The rigid bar cable of thesis 3.3.3 with 13 rods."""
    return hanging_chain([0.13] + 11 * [0.25] + [0.05], [0.0506] + 11 * [0.0129] + [0.0513], motions)


FOUR_BAR = np.array([1.0, 1.6, 1.1]), np.array([1.0, 2.0, 1.5]), 1.5, -2.2  # lengths, masses, ground, angle


def four_bar(planar: bool) -> Scene:
    """Three rods that hang between two pins: a loop with the ground."""
    plane = Y if planar else None
    _, masses, ground, start = FOUR_BAR
    B, C = four_bar_nodes(start)
    nodes = {"A": (0.0, 0.0, 0.0), "B": (B[0], 0.0, B[1]), "C": (C[0], 0.0, C[1]), "D": (ground, 0.0, 0.0)}
    rods = (
        Rod("a", ("A", "B"), float(masses[0]), support=Support.pinned(0.0, plane)),
        Rod("b", ("C", "B"), float(masses[1]), support=Support.free(plane=plane)),
        Rod("c", ("C", "D"), float(masses[2]), support=Support.pinned(1.0, plane)),
    )
    return Scene(Structure("four bar", nodes, rods), gravity=GRAVITY, duration=2.0)


def four_bar_nodes(angle: float) -> tuple[list[float], list[float]]:
    """Where (x, z) the crank's angle puts B and C."""
    (first, second, third), _, ground, _ = FOUR_BAR
    B = first * np.array([np.cos(angle), np.sin(angle)])
    across = np.array([ground, 0.0]) - B
    d = float(np.linalg.norm(across))
    along = (second**2 - third**2 + d**2) / (2 * d)
    normal = np.array([-across[1], across[0]]) / d
    C = B + along * across / d - np.sqrt(second**2 - along**2) * normal
    return B.tolist(), C.tolist()


def suspended(planar: bool, motions: tuple[Motion, ...] = ()) -> Scene:
    """Six rods between two pins, with strings that stay taut, to fixed nodes and across."""
    plane = Y if planar else None
    angles = np.linspace(np.pi, 2 * np.pi, 7)
    nodes = {f"n{k}": (float(np.cos(a)), 0.0, float(0.6 * np.sin(a))) for k, a in enumerate(angles)}
    nodes |= {"p": (0.3, 0.0 if planar else 0.4, 1.4), "q": (-0.4, 0.0 if planar else -0.5, 1.2)}
    supports = [Support.pinned(0.0, plane), *4 * [Support.free(plane=plane)], Support.pinned(1.0, plane)]
    rods = tuple(
        Rod(f"r{k}", (f"n{k}", f"n{k + 1}"), 0.3 + 0.05 * k, support=support) for k, support in enumerate(supports)
    )
    strings = (
        String("s1", ("p", "n2"), 8.0, 0.3, rest_length=0.1),
        String("s2", ("q", "n4"), 5.0, 0.2, rest_length=0.1),
        String("s3", ("n1", "n4"), 3.0, 0.1, rest_length=0.1),
    )
    structure = Structure("suspended", nodes, rods, strings, fixed_nodes=("p", "q"))
    return Scene(structure, gravity=GRAVITY, motions=motions, duration=0.5)


def everything_moves(planar: bool) -> Scene:
    """The suspended chain, both its ends and one fixed node moved, each in its own way."""
    return suspended(
        planar,
        (
            Motion.in_line("r0", 0.05, 0.7, (1, 0, 0.5)),
            Motion.circular("r5", 0.04, 0.9, Y),
            Motion.in_line("p", 0.1, 1.1, (0.3, 0, 1)),
        ),
    )


def hung() -> Scene:
    """Six rods in a chain from a pin, on damped strings that stay taut: loops would cost MuJoCo's RK4 its order."""
    scene = suspended(planar=False)
    *others, last = scene.structure.rods
    return scene.with_(structure=replace(scene.structure, rods=(*others, replace(last, support=Support.free()))))
