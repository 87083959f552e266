"""Laws as array functions: user-defined ones, for every engine, and those of time alone."""

from __future__ import annotations

import pkgutil
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
from tensegrity_mj.engines.jax.arrays import ArrayLaw, lifted, mapped, times
from tensegrity_mj.engines.jax.strings import Strings
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

    arrays = "tensegrity_mj.engines.jax.laws:policy_law"

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


def array_law(law: Any, structure: Structure) -> ArrayLaw:
    """The array function of a law for the strings of a structure; where some of them are ropes, for their parts.

    Args:
        law: one whose attribute `arrays` is "module:function", of a function (law, structure) -> ArrayLaw.

    Where a law has no admissible command, its report's feasibility margin is zero or less, and its command void.

    Raises:
        OptionError: for a law without an array function.
        ElementError: where it accounts for an element that has none.
    """
    place = getattr(law, "arrays", "")
    if not place:
        raise OptionError(
            f"law {getattr(law, '__name__', type(law).__name__)} has no array function: state it in jax.numpy as "
            "engines.ArrayPolicy(function, parameters) (docs/own-law.md), or take another engine"
        )
    try:
        make = pkgutil.resolve_name(place)
    except (ImportError, AttributeError, ValueError) as error:
        raise OptionError(
            f"{law!r}.arrays = {place!r} cannot be imported ({error}); it must be 'module:function'"
        ) from error
    found: ArrayLaw = make(law, structure.massless)
    return _spread(found, structure) if structure.ropes else found


def cubic_law(law: Any, structure: Structure) -> ArrayLaw:
    """A program or a recording, of no state; its parameter `coefficients` (T, M, 4) is that of its `Cubics`."""
    moments, last = jnp.asarray(law.times), len(law.coefficients) - 1

    def of(p: Any, t: Any, x: Any, v: Any) -> tuple[Any, Any]:
        # A hair beyond a time counts as at it: samples and times differ by round-off.
        k = jnp.clip(jnp.searchsorted(moments, t + 1e-9 * (moments[1] - moments[0]), side="right") - 1, 0, last)
        since = jnp.clip(t, moments[0], moments[-1]) - moments[k]
        value = jnp.tensordot(p["coefficients"][k], since ** jnp.arange(3.0, -1.0, -1.0), ((1,), (0,)))
        batch = x.shape[2:]
        return lifted(value, x[:, 0]) + jnp.zeros(batch), jnp.full((len(Report), *batch), jnp.nan)

    return ArrayLaw({"coefficients": np.array(law.coefficients)}, of, law.command is Command.REST_LENGTH)


def _spread(law: ArrayLaw, structure: Structure) -> ArrayLaw:
    """Rest lengths of the parts of ropes, which the law knows as massless strings: their shares of L (1 - u/k)."""
    light = structure.massless
    shares = {rope.string.name: np.array(rope.shares) for rope in structure.ropes}
    parts = [shares.get(string.name, np.ones(1)) for string in light.strings]
    owns = np.repeat(np.eye(len(parts)), [len(part) for part in parts], axis=1)
    count, strings, compliance = len(light.nodes), Strings(structure, 0.0), 1.0 / light.stiffness

    def command(p: Any, t: Any, x: Any, v: Any) -> tuple[Any, Any]:
        rest, report = law.command(p, t, x[:count], v[:count])
        if not law.returns_lengths:
            rest = times(owns, strings.measure(x, v)[0]) * (1.0 - rest * lifted(compliance, rest))
        return times((owns * np.concatenate(parts)).T, rest), report

    return ArrayLaw(law.parameters, command, returns_lengths=True)
