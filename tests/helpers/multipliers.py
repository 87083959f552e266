"""A third coding of a scene's motion: nodes' coordinates, lengths held by multipliers, SciPy's solvers.

It shares the string law (`strings.tension`) and nothing else with the engines: no b, no angles, no bodies, no compiled
function, no search for where strings go slack. Accelerations are those of `natural_coordinates`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from natural_coordinates import accelerations
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

import tensegrity_mj as tmj
from tensegrity_mj.model.rods import string_forces
from tensegrity_mj.model.strings import tension

Array = NDArray[np.float64]


def nodes_of(scene: tmj.Scene, times: Array, method: str = "DOP853", rtol: float = 1e-11) -> tuple[Array, int]:
    """(T, N, 3) node positions [m] at rising times, and the evaluations that it took.

    Raises:
        RuntimeError: where SciPy gives up.
    """
    structure = scene.structure
    shape, half = (len(structure.nodes), 3), 3 * len(structure.nodes)

    def rates(_: float, y: Array) -> Array:
        nodes, velocities = y[:half].reshape(shape), y[half:].reshape(shape)
        pulls = tension(
            structure.stiffness,
            structure.damping,
            structure.string_lengths(nodes),
            structure.string_rates(nodes, velocities),
            structure.rest_lengths,
            structure.string_law,
        )
        forces = string_forces(structure, nodes, pulls)
        found: Any = accelerations(structure, nodes, velocities, forces, scene.gravity)[0]
        return np.concatenate([velocities.ravel(), found.ravel()])

    start = np.concatenate([scene.nodes0.ravel(), scene.velocities0.ravel()])
    found = solve_ivp(rates, (0.0, float(times[-1])), start, method=method, rtol=rtol, atol=0.01 * rtol, t_eval=times)
    if not found.success:
        raise RuntimeError(found.message)
    return found.y[:half].T.reshape(-1, *shape), int(found.nfev)
