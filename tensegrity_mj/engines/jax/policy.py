"""User-defined laws as array functions, for every engine."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.dynamics.native.law import Command, Report
from tensegrity_mj.engines.jax.arrays import ArrayLaw, mapped
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.structure import Structure


@dataclass(frozen=True, eq=False)
class ArrayPolicy:
    """A law as a function in `jax.numpy` and its parameters, by which the differentiable engine differentiates.

    It is an ordinary law too, and so runs in every engine: called, it returns the function's values.

    Attributes:
        function: (parameters, time [s], nodes (N, 3) [m], velocities (N, 3) [m/s]) -> u (M,) [N/m], or rest lengths
            [m]. A function of these alone, in `jax.numpy`; batches are mapped over it.
        parameters: arrays and numbers, in dicts, lists or tuples: gains, weights of a network.
        command: whether it returns force densities or rest lengths.
    """

    function: Callable[[Any, Any, Any, Any], Any]
    parameters: Any
    command: Command = Command.FORCE_DENSITY

    arrays = "tensegrity_mj.engines.jax.policy:policy_law"

    @property
    def name(self) -> str:
        """Name of the function."""
        return getattr(self.function, "__name__", type(self.function).__name__)

    @cached_property
    def _jitted(self) -> Callable[[Any, Any, Any, Any], Any]:
        return jax.jit(self.function)

    def __call__(self, time: float, nodes: ArrayLike, velocities: ArrayLike) -> Array:
        """The command (M,) at one state."""
        return np.asarray(self._jitted(self.parameters, time, np.asarray(nodes), np.asarray(velocities)), float)

    def describe(self) -> dict[str, Any]:
        """Plain values for the provenance of a run."""
        sizes = [int(np.size(leaf)) for leaf in jax.tree_util.tree_leaves(self.parameters)]
        return {"law": self.name, "parameters": sum(sizes)}


def policy_law(law: ArrayPolicy, structure: Structure) -> ArrayLaw:
    """The array function of a policy.

    Raises:
        OptionError: where it cannot be traced, or returns another shape than (M,).
    """
    count, state = len(structure.strings), jax.ShapeDtypeStruct((len(structure.nodes), 3), float)

    def values(*at: Any) -> Any:
        return jnp.asarray(law.function(*at))

    try:
        found = jax.eval_shape(values, law.parameters, 0.0, state, state).shape
    except Exception as error:
        raise OptionError(f"law {law.name}: it failed within JAX: {type(error).__name__}: {error}") from error
    if found != (count,):
        raise OptionError(f"law {law.name}: it returned shape {found}; it must return ({count},), a value a string")
    function = mapped(values, law.parameters)

    def command(p: Any, t: Any, x: Any, v: Any) -> tuple[Any, Any]:
        return function(p, t, x, v), jnp.full((len(Report), *x.shape[2:]), jnp.nan)

    return ArrayLaw(law.parameters, command, law.command is Command.REST_LENGTH)
