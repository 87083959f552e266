"""Elastic rods as an element: axial forces that pull their nodes together, or push them apart.

A rod of stiffness k is the two-node bar of finite elements: straight, its velocity linear along it, so that it has the
kinetic energy of a rigid thin rod (2.25), which now moves along itself, too. It pulls its nodes together with
N = k (L - ℓ) + c dL/dt, of which ½ k (L - ℓ)² is stored and c (dL/dt)² is lost.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.model.elements.element import Element, Work
from tensegrity_mj.model.rods import Bars

if TYPE_CHECKING:
    from tensegrity_mj.model.scene import Scene


def carried(scene: Scene) -> tuple[Element, ...]:
    """Return the effects in a scene for an engine that computes the pull of elastic rods itself."""
    return tuple(ElasticRods(carried=True) if isinstance(one, ElasticRods) else one for one in scene.effects)


@dataclass(frozen=True)
class ElasticRods(Element):
    """The elastic rods of its scene's structure; `carried` where the engine itself lets them pull."""

    carried: bool = False
    work = Work.STORED
    smooth = True
    vectorized = True
    loses = True
    compiled = "tensegrity_mj.dynamics.native.elastic_rods:pack_elastic_rods"
    arrays = "tensegrity_mj.engines.jax.effects:elastic_rods"
    label = "elastic rods"

    def act(self, scene: Scene, time: Array | float, nodes: Array, velocities: Array) -> Array:
        bars, out = Bars.of(scene.structure), np.zeros_like(nodes)
        spans, lengths, forces = bars.stretched(nodes, velocities)
        pulls = (forces / lengths)[..., None] * spans
        for row, (i, j) in enumerate(bars.nodes):
            out[..., i, :] += pulls[..., row, :]
            out[..., j, :] -= pulls[..., row, :]
        return out

    def energy(self, scene: Scene, nodes: Array) -> Array:  # type: ignore[override]
        """Σ ½ k (L - ℓ)² [J]."""
        bars = Bars.of(scene.structure)
        stretch = bars.stretched(nodes, np.zeros_like(nodes))[1] - bars.lengths
        return np.asarray(0.5 * np.sum(bars.stiffness * stretch**2, axis=-1))
