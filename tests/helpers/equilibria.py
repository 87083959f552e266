"""How far nodes and force densities are from an equilibrium, by the equations of `model.rigidity`."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tensegrity_mj.model.rigidity import equilibrium_equations, free_motions, nodes_of
from tensegrity_mj.model.structure import Structure


def equilibrium_residual(
    structure: Structure,
    nodes: ArrayLike | None,
    force_densities: ArrayLike,
    gravity: ArrayLike | None = None,
    loads: ArrayLike | None = None,
) -> NDArray[np.float64]:
    """(q,) [N]: the forces that are left on the free coordinates; arguments as `static_forces`."""
    positions = nodes_of(structure, nodes)
    motions = free_motions(structure, positions)
    matrix, external = equilibrium_equations(structure, positions, motions, gravity, loads)
    return matrix @ np.asarray(force_densities, float) + external
