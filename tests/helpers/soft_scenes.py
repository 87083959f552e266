"""Small scenes with elastic rods."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import tensegrity_mj as tmj

MASS, K, C, LENGTH = 3.0, 400.0, 2.0, 1.25  # of `bar`


def bar(
    support: tmj.Support | None = None,
    *,
    stretch: float = 0.0,
    gravity: tuple[float, float, float] = (0.0, 0.0, 0.0),
    stiffness: float | None = K,
    damping: float = C,
    direction: tuple[float, float, float] = (0.48, 0.6, 0.64),
) -> tmj.Scene:
    """One elastic rod along a unit vector, stretched by so much [m] at the start, its first node at the origin.

    Its point at σ stays where it is.
    """
    way = np.array(direction)
    nodes = {"a": (0.0, 0.0, 0.0), "b": tuple((LENGTH * way).tolist())}
    rod = tmj.Rod("bar", ("a", "b"), MASS, support=support or tmj.Support.free(), stiffness=stiffness, damping=damping)
    start = np.array([-rod.support.sigma * stretch * way, (LENGTH + (1 - rod.support.sigma) * stretch) * way])
    return tmj.Scene(tmj.Structure("bar", nodes, (rod,)), gravity=gravity, initial_nodes=start)


def rigid(scene: tmj.Scene) -> tmj.Scene:
    """The same scene with rigid rods."""
    rods = (replace(rod, stiffness=None, damping=0.0, rest_length=None) for rod in scene.structure.rods)
    return scene.with_(structure=replace(scene.structure, rods=tuple(rods)))


def soft_pair() -> tmj.Scene:
    """A pinned and a free elastic rod, joined by damped strings, under gravity."""
    nodes = {"a": (0, 0, 0.0), "b": (1, 0, -0.2), "c": (0.2, 1, -0.5), "d": (1.1, 1.2, -0.1), "hook": (0.3, 0.5, 1.0)}
    rods = (
        tmj.Rod("r1", ("a", "b"), 4.0, support=tmj.Support.pinned(), stiffness=300.0, damping=1.5),
        tmj.Rod("r2", ("c", "d"), 3.0, support=tmj.Support.free(0.3), stiffness=200.0, damping=0.5),
    )
    ends = (("a", "c"), ("b", "d"), ("a", "d"), ("b", "c"), ("c", "hook"))
    strings = tuple(tmj.String(f"s{n}", pair, 15.0, 0.3, rest_length=0.02) for n, pair in enumerate(ends))
    return tmj.Scene(tmj.Structure("soft pair", nodes, rods, strings, ("hook",)), gravity=(0.0, 0.0, -9.81))


def laden_pair() -> tmj.Scene:
    """The same with masses along the rods and on a node of one."""
    scene = soft_pair()
    masses = ((tmj.model.RodMass(0.8, 1.5), tmj.model.RodMass(0.1, 0.4)), (tmj.model.RodMass(0.25, 0.7),))
    rods = tuple(replace(rod, masses=own) for rod, own in zip(scene.structure.rods, masses, strict=True))
    structure = replace(scene.structure, rods=rods, point_masses=(tmj.PointMass("d", 0.5),))
    return scene.with_(structure=structure)


def soft_chain(closed: bool = False) -> tmj.Scene:
    """Rigid and elastic rods that share nodes, one of them shorter without force than it is; `closed` in a loop."""
    nodes = {"o": (0, 0, 0), "a": (1, 0.2, 0), "b": (2, 0, 0.3), "c": (1.2, -0.5, 1.0)}
    rods = [
        tmj.Rod("r1", ("o", "a"), 2.0, support=tmj.Support.pinned()),
        tmj.Rod("r2", ("a", "b"), 1.0, stiffness=300.0, damping=1.0),
        tmj.Rod("r3", ("c", "b"), 1.5),
    ]
    if closed:
        rods.append(tmj.Rod("r4", ("a", "c"), 0.7, stiffness=200.0, rest_length=1.1))
    return tmj.Scene(tmj.Structure("soft chain", nodes, tuple(rods)), gravity=(0.0, 0.0, -9.81))
