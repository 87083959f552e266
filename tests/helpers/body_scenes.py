"""Scenes of rigid bodies, and their motion without forces by quaternions."""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import tensegrity_mj as tmj
from tensegrity_mj.model import Body

CORNERS = {"a": (0.3, 0.1, 0.0), "b": (-0.2, 0.4, 0.1), "c": (0.0, -0.3, 0.2), "d": (0.1, 0.1, 0.5)}
CENTER = (0.02, 0.03, 0.1)
MOMENTS = (0.05, 0.08, 0.11, 0.01, -0.005, 0.008)


def stone(**changes) -> Body:
    """No symmetry at all: no principal axis along the world's, its centre of mass off its nodes' mean."""
    given = {"name": "stone", "nodes": tuple(CORNERS), "mass": 2.0, "inertia": MOMENTS, "center": CENTER}
    return Body(**(given | changes))


def thrown(body: Body, spin, velocity=(0.1, 0.2, 0.3), gravity=(0.0, 0.0, 0.0), nodes=CORNERS) -> tmj.Scene:
    """A body alone, with a velocity of its centre [m/s] and an angular velocity [rad/s]."""
    structure = tmj.Structure("thrown", nodes, bodies=(body,))
    center = structure.positions.mean(axis=0) if body.center is None else np.array(body.center)
    rates = np.array(velocity) + np.cross(spin, structure.positions - center)
    return tmj.Scene(structure, gravity=gravity, initial_velocities=rates)


def turned(moments, spin, times):
    """Rotations (T, 3, 3) of a body without torque: I ω' = I ω × ω in its axes, and its quaternion."""
    matrix = np.asarray(moments)

    def rates(_, y):
        (s, x, y_, z), w = y[:4], y[4:]
        v = np.array([x, y_, z])
        turn = 0.5 * np.concatenate([[-v @ w], s * w + np.cross(v, w)])
        return np.concatenate([turn, np.linalg.solve(matrix, np.cross(matrix @ w, w))])

    start = [1.0, 0.0, 0.0, 0.0, *spin]
    found = solve_ivp(rates, (0.0, times[-1]), start, method="DOP853", t_eval=times, rtol=1e-13, atol=1e-14)
    return Rotation.from_quat(found.y[[1, 2, 3, 0]].T).as_matrix()


def slung(**changes) -> tmj.Scene:
    """The stone in motion on damped strings from fixed nodes, which stay taut, beside a rod and a point mass."""
    nodes = {
        **CORNERS,
        "f": (0.5, 0.4, 1.6),
        "g": (-0.6, 0.3, 1.5),
        "h": (0.1, -0.8, 1.4),
        "p": (0.9, 0.0, 0.1),
        "q": (1.2, 0.5, 0.4),
        "m": (-0.7, -0.3, -0.4),
    }
    ends = ("fa", "gb", "hc", "fd", "gd", "ap", "bq", "cm", "fq", "gm", "fp", "hm")
    strings = tuple(tmj.String(f"s{n}", tuple(pair), 20.0 + n, 0.3, rest_length=0.05) for n, pair in enumerate(ends))
    structure = tmj.Structure(
        "slung",
        nodes,
        (tmj.Rod("r", ("p", "q"), 1.5),),
        strings,
        ("f", "g", "h"),
        (tmj.model.PointMass("m", 0.8),),
        bodies=(stone(),),
    )
    velocities = np.zeros((len(nodes), 3))
    places = structure.positions[:4] - CENTER
    velocities[:4] = np.array([0.1, -0.3, 0.2]) + np.cross([2.0, -1.0, 1.5], places)
    scene = tmj.Scene(structure, gravity=(0.0, 0.0, -9.81), initial_velocities=velocities)
    return scene.with_(**changes)
