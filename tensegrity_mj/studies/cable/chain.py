"""A hanging chain as the studies see it: its nodes from the top down, places of markers along it, its linear model.

For small rotations about the vertical, the transverse components β (K,) of the rods' directions obey

    M β̈ + G β = -c d̈,   M_ii = m_i ℓ_i²/3 + ℓ_i² Σ_{k>i} m_k,   M_ij = ℓ_i m_j ℓ_j/2 + ℓ_i ℓ_j Σ_{k>j} m_k for i < j,
    G_ii = g ℓ_i (m_i/2 + Σ_{k>i} m_k),   c_i = m_i ℓ_i/2 + ℓ_i Σ_{k>i} m_k,

with M of (3.13), G from (3.8) and c the input column of (3.15), where f_i = m_i ℓ_i/2 and J_i = m_i ℓ_i²/3, and lengths
that the print lacks are restored. d is the displacement of the top.
The linear model is of numpy alone; an engine takes part in `engine_frequencies` only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import positive
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.actuation import OnInfeasible
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.simulation import request_for

DIRECTION = (0.0, 1.0, 0.0)  # of the thesis' in-line excitation
LEAN = 1e-3  # of a rod, for central differences of order four: their error is 1e-12 of a frequency, round-off less


@dataclass(frozen=True, eq=False)
class Chain:
    """A chain of rods that hangs from one pinned end.

    Attributes:
        nodes: (K + 1,) rows of its nodes in the structure, from the top down.
        rods: (K,) rows of its rods.
        lengths: (K,) [m].
        masses: (K,) [kg].
    """

    nodes: NDArray[np.int64]
    rods: NDArray[np.int64]
    lengths: Array
    masses: Array

    @classmethod
    def of(cls, structure: Structure) -> Chain:
        """The chain that a structure is.

        Raises:
            OptionError: if it is none: rods that branch or part, more supports than the one at the top, strings or
                point masses.
        """
        where = f"structure '{structure.name}'"
        if structure.strings or structure.point_masses or structure.rod_lumps.any():
            raise OptionError(f"{where}: a chain is of rods alone; this has strings or point masses")
        held = [row for row, rod in enumerate(structure.rods) if len(rod.support.directions)]
        if len(held) != 1 or structure.rods[held[0]].support.sigma not in (0.0, 1.0):
            raise OptionError(f"{where}: a hanging chain is held at one end of one rod; {len(held)} rods are held")
        if len(structure.rods[held[0]].support.directions) != 3 and structure.rods[held[0]].support.plane is None:
            raise OptionError(f"{where}: the chain's top must be pinned")
        pairs = structure.rod_nodes
        rod, end = held[0], int(structure.rods[held[0]].support.sigma)
        nodes, rods = [int(pairs[rod, end])], [rod]
        nodes.append(int(pairs[rod, 1 - end]))
        left = set(range(len(pairs))) - {rod}
        while left:
            following = [row for row in left if nodes[-1] in pairs[row]]
            if len(following) != 1:
                raise OptionError(
                    f"{where}: its rods are no chain; it branches or parts at '{list(structure.nodes)[nodes[-1]]}'"
                )
            (rod,) = following
            i, j = (int(one) for one in pairs[rod])
            rods.append(rod)
            nodes.append(j if i == nodes[-1] else i)
            left.remove(rod)
        if len(set(nodes)) != len(nodes):
            raise OptionError(f"{where}: its rods are no chain; they close a loop")
        order = np.array(rods)
        return cls(np.array(nodes), order, structure.rod_lengths[order], structure.rod_masses[order])

    @property
    def arc_lengths(self) -> Array:
        """(K + 1,) [m] from the top, along the chain."""
        return np.concatenate([[0.0], np.cumsum(self.lengths)])

    def weights(self, places: Sequence[float]) -> Array:
        """(P, K + 1): rows times the positions of `nodes` are those of points at arc lengths [m] from the top.

        Raises:
            OptionError: for a place beyond the chain's ends.
        """
        s = self.arc_lengths
        at = np.asarray(places, float)
        if at.ndim != 1 or not np.all((at >= 0.0) & (at <= s[-1] * (1 + 1e-9))):
            raise OptionError(f"markers at {list(places)!r} m; each must be within the chain, 0 to {s[-1]:g} m")
        # Linear functions of the arc length are what they are at the nodes: those that are 1 at one of them.
        return np.stack([np.interp(at, s, row) for row in np.eye(len(s))], axis=1)


@dataclass(frozen=True, eq=False)
class HangingChain:
    """Rods from the top down.

    Attributes:
        lengths: (K,) [m].
        masses: (K,) [kg].
        gravity: [m/s²].

    Raises:
        OptionError: for lengths or masses that are not > 0, or not as many.
    """

    lengths: Array
    masses: Array
    gravity: float = 9.81

    def __post_init__(self) -> None:
        ell, m = np.array(self.lengths, float), np.array(self.masses, float)
        if ell.ndim != 1 or ell.shape != m.shape or not len(ell) or not (np.all(ell > 0) and np.all(m > 0)):
            raise OptionError(
                f"hanging chain: lengths {ell.shape} and masses {m.shape} must be as many numbers > 0, one a rod"
            )
        object.__setattr__(self, "lengths", ell)
        object.__setattr__(self, "masses", m)
        object.__setattr__(self, "gravity", positive("hanging chain: gravity", self.gravity, "m/s²"))

    @classmethod
    def of(cls, chain: Chain, gravity: float = 9.81) -> HangingChain:
        """That of a chain of a structure."""
        return cls(chain.lengths, chain.masses, gravity)

    @cached_property
    def below(self) -> Array:
        """(K,) mass [kg] that hangs on each rod's lower end."""
        return np.concatenate([np.cumsum(self.masses[::-1])[::-1][1:], [0.0]])

    @cached_property
    def mass_matrix(self) -> Array:
        """M (K, K) [kg m²] of (3.13)."""
        ell, m = self.lengths, self.masses
        # For i < j the column j has one factor: ℓ_i (m_j ℓ_j/2 + ℓ_j Σ m_k) = ℓ_i c_j.
        upper = np.triu(np.outer(ell, self.input), 1)
        return upper + upper.T + np.diag(m * ell**2 / 3.0 + ell**2 * self.below)

    @cached_property
    def stiffness(self) -> Array:
        """Diagonal of G (K,) [N m]."""
        return self.gravity * self.lengths * (0.5 * self.masses + self.below)

    @cached_property
    def input(self) -> Array:
        """c (K,) [kg m] of (3.15)."""
        return self.lengths * (0.5 * self.masses + self.below)

    @cached_property
    def modes(self) -> tuple[Array, Array]:
        """ω (K,) [rad/s] ascending, and modes (K, K) with XᵀMX = 1."""
        # M = L Lᵀ; G^½ M⁻¹ G^½ would do as well, but this one keeps the low frequencies to round-off of their own.
        root = np.sqrt(self.stiffness)
        inverse, shapes = np.linalg.eigh(self.mass_matrix / np.outer(root, root))
        omega = 1.0 / np.sqrt(inverse[::-1])
        # (M/√G√G) y = y/ω², x = y/√G; yᵀy = 1 makes xᵀMx = 1/ω².
        return omega, (shapes[:, ::-1] / root[:, None]) * omega

    @property
    def frequencies(self) -> Array:
        """(K,) [Hz], ascending."""
        return self.modes[0] / (2.0 * np.pi)

    @property
    def fastest(self) -> float:
        """Largest angular frequency [rad/s]: what decides the largest stable step."""
        return float(self.modes[0][-1])


def engine_frequencies(scene: Scene, engine: Any, direction: tuple[float, float, float] = DIRECTION) -> Array:
    """Frequencies (K,) [Hz], ascending, of a chain's motion in a vertical plane.

    Each rod in turn is inclined by little, and the engine's accelerations show how all directions are accelerated.

    Args:
        scene: a chain that hangs at rest, its top at rest too.
        engine: MuJoCo(...), DAE(...).
        direction: of the plane.
    """
    chain = Chain.of(scene.structure)
    along = np.asarray(direction, float) / np.linalg.norm(direction)
    up = -np.asarray(scene.gravity) / np.linalg.norm(scene.gravity)
    at = engine.accelerations(request_for(scene, None, None, None, OnInfeasible.STOP, None, False))
    top = scene.nodes0[chain.nodes[0]]
    still = np.zeros_like(scene.nodes0)

    def directions_accelerated(rod: int, lean: float) -> Array:
        b = np.tile(-up, (len(chain.rods), 1))
        b[rod] = lean * along - np.sqrt(1.0 - lean**2) * up
        nodes = np.array(scene.nodes0)
        nodes[chain.nodes] = top + np.vstack([np.zeros(3), np.cumsum(chain.lengths[:, None] * b, axis=0)])
        acceleration = at(0.0, nodes, still)[1][chain.nodes]
        return np.diff(acceleration @ along) / chain.lengths

    A = np.empty((len(chain.rods),) * 2)
    for rod in range(len(chain.rods)):
        near, far = (directions_accelerated(rod, k * LEAN) - directions_accelerated(rod, -k * LEAN) for k in (1, 2))
        A[:, rod] = (8.0 * near - far) / (12.0 * LEAN)
    return np.sort(np.sqrt(-np.linalg.eigvals(A).real)) / (2.0 * np.pi)
