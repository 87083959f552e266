"""A mass that falls, comes taut on a damped string, and swings on it: all in closed form."""

from __future__ import annotations

import numpy as np

import tensegrity_mj as tmj

K, C, REST, MASS, G, DEPTH = 400.0, 3.0, 1.0, 0.5, 9.81, 0.9  # N/m, N s/m, m, kg, m/s², m
TAUT = float(np.sqrt(2 * (REST - DEPTH) / G))  # s


def caught() -> tmj.Scene:
    """The mass, DEPTH below its hook at rest, on a string that is slack there."""
    structure = tmj.Structure(
        "caught",
        {"hook": (0, 0, 0), "a": (0, 0, -DEPTH)},
        strings=(tmj.String("s", ("hook", "a"), stiffness=K, damping=C, rest_length=REST),),
        fixed_nodes=("hook",),
        point_masses=(tmj.PointMass("a", MASS),),
    )
    return tmj.Scene(structure, gravity=(0, 0, -G))


def height(time: float, depth: float = DEPTH, damping: float = C, stiffness: float = K) -> float:
    """z [m] after the string came taut, and before it goes slack again.

    From v = √(2 g (L0 - depth)) the stretch is s = m g/k + e^{-a t} (A cos ω t + B sin ω t), s(0) = 0 and ṡ(0) = v.
    """
    fall = np.sqrt(2 * (REST - depth) / G)
    a, still, t = damping / (2 * MASS), MASS * G / stiffness, time - fall
    omega = np.sqrt(stiffness / MASS - a * a)
    A, B = -still, (G * fall - a * still) / omega
    return float(-REST - still - np.exp(-a * t) * (A * np.cos(omega * t) + B * np.sin(omega * t)))


def slope(time: float, **at: float) -> float:
    """The derivative of `height` by one of its arguments at a value, by differences of the fourth order."""
    ((name, value),) = at.items()
    h = 1e-3 * value

    def moved(steps: float) -> float:
        return height(time, **{name: value + steps * h})

    return (8 * (moved(1) - moved(-1)) - (moved(2) - moved(-2))) / (12 * h)
