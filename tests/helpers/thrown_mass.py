"""A mass on two strings, thrown aside: a small scene that may have all that a run must remember."""

from __future__ import annotations

from typing import Any

import numpy as np

import tensegrity_mj as tmj


def hung(yields: bool = True, string_law: str = "clipped", **more: Any) -> tmj.Scene:
    """A mass on a string that may yield and one whose damper follows `string_law`; it lands in them within 0.05 s."""
    structure = tmj.Structure(
        "hung",
        {"top": (0.0, 0.0, 1.0), "left": (-1.0, 0.0, 0.2), "p": (0.0, 0.0, 0.0)},
        point_masses=[tmj.PointMass("p", 1.0)],
        strings=[
            tmj.String(
                "y", ("top", "p"), 4000.0, 1.0, rest_length=0.99, curve=[(0.005, 20.0), (0.05, 30.0)], yields=yields
            ),
            tmj.String("s", ("left", "p"), 300.0, 0.5, rest_length=1.0, string_law=tmj.model.StringLaw(string_law)),
        ],
        fixed_nodes=("top", "left"),
    )
    start = np.array([[0, 0, 0], [0.3 * np.pi if "motions" in more else 0, 0, 0], [0.3, 0.2, -1.0]])
    return tmj.Scene(structure, gravity=(0, 0, -9.81), initial_velocities=start, duration=0.1, **more)
