"""Scenes with linear constraints on nodes, for tests of several rooms."""

from __future__ import annotations

import numpy as np

import tensegrity_mj as tmj
from tensegrity_mj.model import Constraint, PointMass, Rod, Scene, Structure, Support

G = 9.81


def ladder(length: float = 2.0, mass: float = 3.0, angle: float = 0.4, **changes: object) -> Scene:
    """A rod whose foot slides on a floor (its support) and whose head on a wall (a constraint), `angle` from the wall.

    The two differ in what they are called only: the foot's z and the head's x.
    """
    foot, head = (length * np.sin(angle), 0.0, 0.0), (0.0, 0.0, length * np.cos(angle))
    rod = Rod("ladder", ("foot", "head"), mass, support=Support.constrained([0, 0, 1], plane=(0, 1, 0)))
    wall = Constraint("wall", {"head": 1.0}, (1, 0, 0))
    structure = Structure("ladder", {"foot": foot, "head": head}, (rod,), constraints=(wall,))
    return Scene(structure, gravity=(0, 0, -G), duration=0.5).with_(**changes)


def incline(slope: float = 0.5) -> Scene:
    """A point mass on a line: two constraints leave it the direction (cos, 0, -sin) of the slope."""
    held = (
        Constraint("plane", {"m": 1.0}, (np.sin(slope), 0, np.cos(slope))),
        Constraint("rail", {"m": 2.0}, (0, 3, 0)),
    )
    structure = Structure("incline", {"m": (0.3, 0.2, 1.0)}, point_masses=(PointMass("m", 0.7),), constraints=held)
    return Scene(structure, gravity=(0, 0, -G), duration=0.5)


def trammel(at: float = 0.5, length: float = 1.5, angle: float = 0.7) -> Scene:
    """A free rod whose first node stays on the x axis, and its point at σ = `at` on the z axis: an ellipsograph."""
    first = np.array([-at * length * np.sin(angle), 0.0, 0.0])
    nodes = {"a": first, "b": first + length * np.array([np.sin(angle), 0.0, np.cos(angle)])}
    rod = Rod("arm", ("a", "b"), 1.2)
    rows = [Constraint("axis", {"a": 1.0}, (0, 0, 1)), Constraint("flat", {"a": 1.0}, (0, 1, 0))]
    rows += [Constraint.along("guide", rod, at, (1, 0, 0)), Constraint.along("level", rod, at, (0, 1, 0))]
    places = {name: tuple(place.tolist()) for name, place in nodes.items()}
    structure = Structure("trammel", places, (rod,), constraints=tuple(rows))
    return Scene(structure, gravity=(0, 0, -G), duration=0.5)


def moving_wall(amplitude: float = 0.1, frequency: float = 0.8) -> Scene:
    """The ladder against a wall that moves to and fro."""
    return ladder(motions=(tmj.model.Motion.in_line("wall", amplitude, frequency, (1, 0, 0)),))
