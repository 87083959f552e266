"""Interface of members, elements and laws to this engine: parameters, and functions of them and of arrays.

Positions x [m] and velocities v [m/s] are (N, 3, ...) with batches last, and so is what functions return. Parameters
are arrays without a batch, or with it last. Functions are called within `jax.jit`, `jax.grad` and `jax.vmap`: they use
`jax.numpy` and no Python branch on values.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import jax
import numpy as np

from tensegrity_mj.basics.arrays import IntArray

Arrays: TypeAlias = Mapping[str, Any]  # parameters by name; a value may be a mapping of its own


@dataclass(frozen=True)
class ArrayEffect:
    """An element as array functions of its parameters p: an energy, a dissipation potential, a force, or several.

    Attributes:
        parameters: numbers that may be changed and differentiated, as floats or arrays, by the names of their fields.
        energy: (p, t, x) -> (...) [J] that is stored; its forces are minus its gradient.
        dissipation: (p, t, x, v) -> (...) [W], whose forces are minus its gradient by v.
        force: (p, t, x, v) -> (N, 3, ...) [N], of what has no potential.
        given: (p, t, x, v) -> (...) [W], of what loses its work in surroundings that move: what these give.
        alpha: (p, t, x) -> (R, 2, 2, ...) [kg], added mass as `Element.alpha`.
        gives: whether the work of `force` is external; else it is lost. By `Element.work`, see `array_effects`.
    """

    parameters: Arrays = field(default_factory=dict)
    energy: Callable[[Arrays, Any, Any], Any] | None = None
    dissipation: Callable[[Arrays, Any, Any, Any], Any] | None = None
    force: Callable[[Arrays, Any, Any, Any], Any] | None = None
    given: Callable[[Arrays, Any, Any, Any], Any] | None = None
    alpha: Callable[[Arrays, Any, Any], Any] | None = None
    gives: bool = False


@dataclass(frozen=True)
class ArrayLaw:
    """A law as an array function.

    Attributes:
        parameters: numbers that may be changed and differentiated: gains, rates, weights of a network.
        command: (p, t, x, v) -> u (M, ...) [N/m], or rest lengths [m], and its report (5, ...) as `Report`.
        returns_lengths: whether it returns rest lengths.
    """

    parameters: Arrays
    command: Callable[[Arrays, Any, Any, Any], tuple[Any, Any]]
    returns_lengths: bool = False


def incidence(pairs: IntArray, count: int) -> Any:
    """Matrix (S, N) that takes positions to the spans from the first to the second node of pairs (S, 2).

    A product with it is differentiated into a product with its transpose, where a gather becomes a scatter.
    """
    out = np.zeros((len(pairs), count))
    rows = np.arange(len(pairs))
    np.add.at(out, (rows, pairs[:, 0]), -1.0)
    np.add.at(out, (rows, pairs[:, 1]), 1.0)
    return out


def times(matrix: Any, vectors: Any) -> Any:
    """A matrix (A..., N) times arrays (N, ...) -> (A..., ...), with all 32 bits on GPUs, too.

    It is a product of two matrices, and so backwards: with more dimensions XLA rearranges all arrays there.
    """
    (*first, size), (_, *last) = matrix.shape, vectors.shape
    rows, columns = matrix.reshape(math.prod(first), size), vectors.reshape(size, math.prod(last))
    return jax.numpy.matmul(rows, columns, precision="highest").reshape(*first, *last)


def settled(array: Any) -> Any:
    """An array (A, ...) times the unit matrix, where it has batches: what depends on it, either way, takes it as it is.

    XLA for CPUs repeats what leads to an array in each of its users, sines as well, but not a product of matrices.
    """
    return times(np.eye(len(array)), array) if array.ndim > 1 else array


def derivatives(function: Callable[[Any], Any], t: Any) -> tuple[Any, Any, Any]:
    """A function of time, its rate and its acceleration, at a time."""
    t = jax.numpy.asarray(t, float)

    def rate(t: Any) -> Any:
        return jax.jvp(function, (t,), (jax.numpy.ones_like(t),))[1]

    return function(t), *jax.jvp(rate, (t,), (jax.numpy.ones_like(t),))


def norm(vectors: Any, axis: int = 1) -> Any:
    """Lengths of vectors along an axis, by default (A, 3, ...) -> (A, ...); of none the derivative is zero, not NaN."""
    square = jax.numpy.sum(vectors * vectors, axis=axis)
    some = square > 0.0
    return jax.numpy.where(some, jax.numpy.sqrt(jax.numpy.where(some, square, 1.0)), 0.0)


def lifted(array: Any, like: Any) -> Any:
    """An array with as many dimensions as another one, so that (M,) and (M, B) broadcast alike with (M, B)."""
    array = jax.numpy.asarray(array)
    return array.reshape(array.shape + (1,) * (jax.numpy.ndim(like) - array.ndim))


def mapped(command: Callable[..., Any], parameters: Any) -> Callable[..., Any]:
    """A law's command (p, t, x, v) for single states, over batches of states and parameters too, which are last."""
    own = jax.tree_util.tree_map(jax.numpy.ndim, parameters)

    def many(p: Any, t: Any, x: Any, v: Any) -> Any:
        if x.ndim == 2:
            return command(p, t, x, v)
        axes = jax.tree_util.tree_map(lambda leaf, ndim: -1 if jax.numpy.ndim(leaf) > ndim else None, p, own)
        return jax.vmap(command, (axes, None, -1, -1), -1)(p, t, x, v)

    return many
