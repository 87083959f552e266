"""What a law believes it controls, as array functions: how rods and masses move without strings, and answer forces."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np

from tensegrity_mj.engines.jax.arrays import Arrays, incidence, lifted, times
from tensegrity_mj.engines.jax.effects import array_effects
from tensegrity_mj.engines.jax.model import Model, Prepared
from tensegrity_mj.engines.jax.targets import array_target
from tensegrity_mj.model.actuation import Actuation


class Belief:
    """A model of the engine's own, of the scene that a law of chapters 4 to 6 accounts for, and where it is to go.

    Attributes:
        parameters: `gravity` (3,), `effects` and `target`, see `array_target`.
        points: (P, N), times nodes: r of the rods, behind them the point masses.
        bases: (P, 3, 3), whose columns are the directions that these are free to move in, behind them zeros.
        sizes: (P,) how many.
        spans: (R, N), times nodes: from each rod's first node to its second.
        aim: (p, t) -> r_d (P, 3, ...) [m] and b_d (R, 3, ...), for the parameter `target`.
    """

    def __init__(self, law: Any) -> None:
        self._model = Model(law.model, array_effects(law.model), None, Actuation.continuous(), 0.0)
        self._at = self._model.prepare(self._model.parameters)
        self.strings, structure = self._model.strings, law.structure
        lone = [structure.node_index[point.node] for point in structure.lone_masses]
        sigma = np.array([rod.support.sigma for rod in structure.rods])[:, None]
        self.spans = incidence(structure.rod_nodes, len(structure.nodes))
        one = np.eye(len(structure.nodes))
        self.points = np.concatenate([one[structure.rod_nodes[:, 0]] + sigma * self.spans, one[lone]])
        held = [rod.support.translation_basis for rod in structure.rods]
        held += [point.translation_basis for point in structure.lone_masses]
        self.sizes = np.array([E.shape[1] for E in held])
        self.bases = np.array([np.pad(E, ((0, 0), (0, 3 - E.shape[1]))) for E in held]).reshape(-1, 3, 3)
        target, self.aim = array_target(law.target, self.points, self.spans)
        self.parameters = {"target": target, **{name: self._model.parameters[name] for name in ("gravity", "effects")}}

    def motion(self, p: Arrays, t: Any, x: Any, v: Any) -> tuple[Any, Callable[[Any], Any]]:
        """Accelerations (N, 3, ...) without strings, and the symmetric function of forces that adds to them."""
        own = {name: p[name] for name in ("gravity", "effects")}
        at = Prepared({**self._at.parameters, **own}, self._at.mobility)
        system = self._model.system
        y, rates, still = times(system.fit, x), times(system.fit, v), system.prescribed(t)[2]
        mobility = self._model.mobility(at, t, x)

        def accelerate(rates: Any, forces: Any) -> Any:
            return times(system.maps, system.accelerate(mobility, y, rates, forces, still)[0])

        weight = lifted(mobility.mass @ system.shifted, x[:, 0])[:, None] * lifted(p["gravity"], x[0])
        known = times(system.maps.T, self._model.acting(at, t, x, v)[0])
        return accelerate(rates, weight + known), lambda forces: accelerate(
            jnp.zeros_like(rates), times(system.maps.T, forces)
        )


def ceilings(limits: Any, lengths: Any) -> Any:
    """The largest force densities (M, ...), min(u_max, max(k (1 - L0_min/L), 0)), of a law's `StringLimits`."""
    highest, shortest = limits.max_force_density, limits.min_rest_length
    of_state = np.isfinite(shortest)
    by_length = lifted(limits.structure.stiffness, lengths) * (
        1.0 - lifted(np.where(of_state, shortest, 0.0), lengths) / lengths
    )
    by_length = jnp.where(lifted(of_state, lengths), jnp.maximum(by_length, 0.0), jnp.inf)
    return jnp.minimum(lifted(highest, lengths), by_length)
