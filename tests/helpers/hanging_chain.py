"""The linear model of a hanging chain, by (3.13) to (3.15): small rotations about the vertical, of numpy alone.

The transverse components β (K,) of the rods' directions obey

    M β̈ + G β = -c d̈,   M_ii = m_i ℓ_i²/3 + ℓ_i² Σ_{k>i} m_k,   M_ij = ℓ_i m_j ℓ_j/2 + ℓ_i ℓ_j Σ_{k>j} m_k for i < j,
    G_ii = g ℓ_i (m_i/2 + Σ_{k>i} m_k),   c_i = m_i ℓ_i/2 + ℓ_i Σ_{k>i} m_k,

with M of (3.13), G from (3.8) and c the input column of (3.15), where f_i = m_i ℓ_i/2 and J_i = m_i ℓ_i²/3, and lengths
that the print lacks are restored. d is the displacement of the top.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from evidence.cable.chain import Chain
from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.model.scene import Scene


@dataclass(frozen=True, eq=False)
class HangingChain:
    """Rods from the top down.

    Attributes:
        lengths: (K,) [m].
        masses: (K,) [kg].
        gravity: [m/s²].
    """

    lengths: Array
    masses: Array
    gravity: float = 9.81

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


def linear_model(scene: Scene) -> HangingChain:
    """The linear model of a chain that hangs in a scene's gravity."""
    return HangingChain.of(Chain.of(scene.structure), float(np.linalg.norm(scene.gravity)))
