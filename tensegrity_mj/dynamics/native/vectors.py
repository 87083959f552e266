"""Vectors of three numbers in compiled code, as tuples: they live in registers and read as formulas."""

from __future__ import annotations

from typing import Any

from tensegrity_mj.dynamics.native.pointers import inlined

ZERO = (0.0, 0.0, 0.0)


@inlined
def vector(row: Any) -> tuple[float, float, float]:
    """The first three numbers of an array."""
    return row[0], row[1], row[2]


@inlined
def row_of(array: Any, n: int) -> tuple[float, float, float]:
    """Row n of an array (n, 3)."""
    return array[n, 0], array[n, 1], array[n, 2]


@inlined
def column_of(A: Any, n: int) -> tuple[float, float, float]:
    """Column n of a matrix (3, n)."""
    return A[0, n], A[1, n], A[2, n]


@inlined
def put(array: Any, n: int, a: Any) -> None:
    """Write a into row n of an array (n, 3)."""
    array[n, 0], array[n, 1], array[n, 2] = a[0], a[1], a[2]


@inlined
def add(array: Any, n: int, a: Any) -> None:
    """Add a to row n of an array (n, 3)."""
    for x in range(3):
        array[n, x] += a[x]


@inlined
def plus(a: Any, b: Any) -> tuple[float, float, float]:
    """a + b"""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@inlined
def minus(a: Any, b: Any) -> tuple[float, float, float]:
    """a - b"""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@inlined
def times(s: float, a: Any) -> tuple[float, float, float]:
    """s a"""
    return s * a[0], s * a[1], s * a[2]


@inlined
def over(a: Any, s: float) -> tuple[float, float, float]:
    """a / s"""
    return a[0] / s, a[1] / s, a[2] / s


@inlined
def dot(a: Any, b: Any) -> float:
    """aᵀb"""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def cross(a: Any, b: Any) -> tuple[float, float, float]:
    """a × b"""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inlined
def apply(A: Any, v: Any) -> tuple[float, float, float]:
    """A v of a matrix (3, 3)."""
    return (
        A[0, 0] * v[0] + A[0, 1] * v[1] + A[0, 2] * v[2],
        A[1, 0] * v[0] + A[1, 1] * v[1] + A[1, 2] * v[2],
        A[2, 0] * v[0] + A[2, 1] * v[1] + A[2, 2] * v[2],
    )


@inlined
def apply_transposed(A: Any, v: Any) -> tuple[float, float, float]:
    """Aᵀv of a matrix (3, 3)."""
    return (
        A[0, 0] * v[0] + A[1, 0] * v[1] + A[2, 0] * v[2],
        A[0, 1] * v[0] + A[1, 1] * v[1] + A[2, 1] * v[2],
        A[0, 2] * v[0] + A[1, 2] * v[1] + A[2, 2] * v[2],
    )
