"""A mass that a string catches again and again, and its motion by another integrator stopped at every catch."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

import tensegrity_mj as tmj

MASS, STIFFNESS, REST = 0.7, 40.0, 0.5
GRAVITY = 3.0
START, SPEED = 0.13, 0.9  # m, m/s


def bob(damping: float = 0.0, *, duration: float = 2.0, **changes: Any) -> tmj.Scene:
    """A mass that falls along x, caught by a string from the origin again and again."""
    structure = tmj.Structure(
        "bob",
        {"anchor": (0.0, 0.0, 0.0), "bob": (START, 0.0, 0.0)},
        point_masses=(tmj.PointMass("bob", MASS),),
        strings=(tmj.String("string", ("anchor", "bob"), STIFFNESS, rest_length=REST, damping=damping),),
        fixed_nodes=("anchor",),
        **changes,
    )
    velocities = np.array([[0.0, 0.0, 0.0], [SPEED, 0.0, 0.0]])
    return tmj.Scene(structure, gravity=(GRAVITY, 0.0, 0.0), duration=duration, initial_velocities=velocities)


def bob_at(times: np.ndarray, damping: float) -> np.ndarray:
    """Its x by LSODA, stopped at every change of the string's force, which is smooth between."""
    at, y, found, t = 0, [START, SPEED], [], 0.0

    def stretch(_: float, y: Any) -> float:
        return float(y[0] - REST)

    def pull(_: float, y: Any) -> float:
        return float(STIFFNESS * (y[0] - REST) + damping * y[1])

    taut = False
    while at < len(times):

        def rates(t: float, y: Any, taut: bool = taut) -> list[float]:
            return [y[1], GRAVITY - (pull(t, y) / MASS if taut else 0.0)]

        # A slack string comes taut where it is stretched; a taut one lets go where its damper outweighs its spring, and
        # may be stretched then, until it is slack.
        event: Any = (lambda t, y: pull(t, y)) if taut else (lambda t, y: stretch(t, y))
        event.terminal, event.direction = True, -1.0 if taut else 1.0
        piece = solve_ivp(
            rates, (t, times[-1]), y, "DOP853", rtol=1e-13, atol=1e-14, events=event, dense_output=True, max_step=0.02
        )
        while at < len(times) and times[at] <= piece.t[-1]:
            found.append(float(piece.sol(times[at])[0]))
            at += 1
        t, y, taut = float(piece.t[-1]), list(piece.y[:, -1]), not taut
    return np.array(found)
