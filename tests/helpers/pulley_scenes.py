"""Scenes of strings that run through more than two nodes."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from linked_scenes import hung

import tensegrity_mj as tmj

G = 9.81


def atwood(stretch: float = 0.0, damping: float = 0.0) -> tmj.Scene:
    """Atwood's machine: 1 and 1.5 kg on one string over two fixed pulleys, its tension that of motion at rest plus k
    `stretch` [m].
    """
    one, other, k = 1.0, 1.5, 1000.0
    nodes = {"a": (0.0, 0.0, -1.0), "p": (0.0, 0.0, 0.0), "q": (0.4, 0.0, 0.0), "b": (0.4, 0.0, -0.8)}
    tension = 2 * one * other / (one + other) * G
    rest = 2.2 - tension / k - stretch
    string = tmj.String("s", ("a", "p", "q", "b"), k, damping, rest_length=rest)
    masses = (tmj.PointMass("a", one), tmj.PointMass("b", other))
    structure = tmj.Structure("atwood", nodes, (), (string,), ("p", "q"), masses)
    return tmj.Scene(structure, name="atwood", gravity=(0.0, 0.0, -G), duration=0.5)


def slung(rise: float = 0.0, k: float = 800.0) -> tmj.Scene:
    """2 kg that hang on a string of 1.5 m at rest, free to slide, between points 1 m apart, one `rise` [m] higher."""
    nodes = {"a": (0.0, 0.0, 0.0), "m": (0.45, 0.0, -0.6), "b": (1.0, 0.0, rise)}
    string = tmj.String("s", ("a", "m", "b"), k, rest_length=1.5)
    structure = tmj.Structure("slung", nodes, (), (string,), ("a", "b"), (tmj.PointMass("m", 2.0),))
    return tmj.Scene(structure, name="slung", gravity=(0.0, 0.0, -G))


def ringed(rings: bool = True, turning: bool = True) -> tmj.Scene:
    """A free prism whose two triangles are each one string that runs around (or, without `rings`, three strings of
    the same tension as long as the prism keeps its symmetry: a third of the length, three times as stiff).
    """
    angles = 2 * np.pi * np.arange(3) / 3
    bottom = {f"b{i}": (0.5 * math.cos(a), 0.5 * math.sin(a), 0.0) for i, a in enumerate(angles)}
    twist = 5 * math.pi / 6
    top = {f"t{i}": (0.5 * math.cos(a + twist), 0.5 * math.sin(a + twist), 0.9) for i, a in enumerate(angles)}
    rods = tuple(tmj.Rod(f"r{i}", (f"b{i}", f"t{i}"), 1.0) for i in range(3))
    upright = [tmj.String(f"v{i}", (f"b{i}", f"t{(i + 2) % 3}"), 300.0, 2.0, tension=30.0) for i in range(3)]
    around = []
    side, pull = 0.5 * math.sqrt(3), 12.0
    for where in "bt":
        if rings:
            path = tuple(f"{where}{i % 3}" for i in range(4))
            around.append(tmj.String(f"{where} ring", path, 200.0, 1.5, rest_length=3 * side - pull / 200))
        else:
            pairs = [(f"{where}{i}", f"{where}{(i + 1) % 3}") for i in range(3)]
            rest = side - pull / 600
            around += [tmj.String(f"{where}{i}", p, 600.0, 4.5, rest_length=rest) for i, p in enumerate(pairs)]
    structure = tmj.Structure("ringed", bottom | top, rods, (*upright, *around))
    v = None
    if turning:
        v = structure.positions @ np.array([[0.0, 0.5, 0.1], [-0.5, 0.0, 0.2], [-0.1, -0.2, 0.0]])
    return tmj.Scene(structure, name="ringed", initial_velocities=v)


def threaded(scene: tmj.Scene | None = None, path: tuple[str, ...] = ("n1", "n3", "n5", "n2")) -> tmj.Scene:
    """Rods in a chain from a pin, or another scene, with a damped string through more nodes, that stays taut."""
    scene = scene or hung()
    structure = scene.structure
    nodes = scene.nodes0[[structure.node_index[name] for name in path]]
    length = float(np.linalg.norm(np.diff(nodes, axis=0), axis=1).sum())
    string = tmj.String("threaded", path, 10.0, 0.3, rest_length=0.2 * length)
    return scene.with_(structure=replace(structure, strings=(*structure.strings, string)))
