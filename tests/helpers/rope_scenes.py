"""Strings with mass: alone between two points, and in structures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from linked_scenes import hung
from numpy.typing import NDArray
from scipy.optimize import brentq

import tensegrity_mj as tmj

G = 9.81


def rope(segments: int, *, mass: float = 0.4, length: float = 2.0, stiffness: float = 1e4, **more: Any) -> tmj.Scene:
    """Between two fixed points at (0, 0, 0) and (length, 0, 0), without gravity."""
    string = tmj.String("s1", ("a", "b"), stiffness, mass=mass, segments=segments, **more)
    nodes = {"a": (0.0, 0.0, 0.0), "b": (length, 0.0, 0.0)}
    return tmj.Scene(tmj.Structure("rope", nodes, strings=(string,), fixed_nodes=("a", "b")))


def mast(**rope: Any) -> tmj.Scene:
    """A rod on a pin, held by two massless strings and one of these numbers, which stays taut."""
    places = ((0.0, 0.0, 0.0), (0.1, 0.0, 1.0), (1.0, 0.0, 0.2), (-0.5, 0.8, 0.0), (-0.6, -0.9, 0.1))
    nodes = dict(zip(("foot", "tip", "a", "b", "c"), places, strict=True))
    given = {"mass": 0.2, "segments": 4, "rest_length": 0.95} | rope
    strings = (
        tmj.String("s0", ("tip", "b"), 300.0, 0.3, tension=100.0),
        tmj.String("s1", ("tip", "a"), 400.0, 0.5, **given),
        tmj.String("s2", ("tip", "c"), 300.0, 0.3, tension=100.0),
    )
    rod = tmj.Rod("mast", ("foot", "tip"), 1.0, support=tmj.Support.pinned())
    structure = tmj.Structure("mast", nodes, (rod,), strings, ("a", "b", "c"))
    return tmj.Scene(structure, gravity=(0.0, 0.0, -G), duration=0.5)


def weighted() -> tmj.Scene:
    """`hung` with mass on two of its strings."""
    scene = hung()
    one, *others, last = scene.structure.strings
    heavy = (replace(one, mass=0.3, segments=3), *others, replace(last, mass=0.2, segments=2))
    return scene.with_(structure=replace(scene.structure, strings=heavy))


def weightless(scene: tmj.Scene) -> tmj.Scene:
    """The same with massless strings."""
    starts = {key: getattr(scene, key) for key in ("initial_nodes", "initial_velocities")}
    count = len(scene.structure.massless.nodes)
    cut = {key: None if start is None else start[:count] for key, start in starts.items()}
    return scene.with_(structure=scene.structure.massless, **cut)


Shape = Callable[[NDArray[np.float64]], tuple[NDArray[np.float64], NDArray[np.float64]]]


def catenary(span: float, rest: float, mass: float, stiffness: float) -> tuple[float, Shape]:
    """Of an elastic rope between two points at one height: its horizontal tension H [N], and x, z [m] by arc length.

    H.M. Irvine, Cable Structures (1981), section 1.3, with E A = k L0 and the weight m g; arc lengths are unstretched.
    """
    weight, modulus, half = mass * G / rest, stiffness * rest, mass * G / 2

    def gap(H: float) -> float:
        return float(H * rest / modulus + 2 * H / weight * np.arcsinh(half / H) - span)

    H = float(brentq(gap, 1e-6 * mass * G, 1e4 * mass * G, xtol=1e-13, rtol=1e-14))

    def shape(s: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        V = weight * s - half
        x = H * s / modulus + H / weight * (np.arcsinh(V / H) + np.arcsinh(half / H))
        z = weight * s / modulus * (s / 2 - half / weight) + H / weight * (np.hypot(1, V / H) - np.hypot(1, half / H))
        return x, z

    return H, shape
