"""Gains of the quadratic laws: X, Y, Z of (5.4)-(5.5) and K of (6.3), checked, as records for compiled code."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import check_known, real_array
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.structure import Structure

GAINS = np.dtype([(name, "f8", (3, 3)) for name in ("Xz", "Yz", "Zz", "Xb", "Yb", "Zb", "Kb")], align=True)


@dataclass(frozen=True)
class Gains:
    """X, Y, Z of (5.4) or (5.5): scalars or symmetric-where-needed matrices; [X Y; Yᵀ Z] must be positive definite.

    Matrices for z are (nz, nz) in the coordinates of the support's basis E, those for b (3, 3) in the world frame.
    """

    X: ArrayLike = 1.0
    Y: ArrayLike = 1.0
    Z: ArrayLike = 1.5


def gain_records(
    structure: Structure,
    translation: Gains | Mapping[str, Gains],
    rotation: Gains | Mapping[str, Gains],
    stiffness: ArrayLike | Mapping[str, ArrayLike] = 0.0,
) -> np.ndarray[Any, Any]:
    """Gains of every rod and point mass as records.

    Raises:
        OptionError: naming the rod and the matrix, unless [X Y; Yᵀ Z] is symmetric and positive definite, and K
            symmetric and positive semidefinite.
    """
    names = [rod.name for rod in structure.rods] + [point.node for point in structure.lone_masses]
    sizes = [rod.support.translation_basis.shape[1] for rod in structure.rods]
    sizes += [point.translation_basis.shape[1] for point in structure.lone_masses]
    rods = names[: len(structure.rods)]
    for what, given, known, kind in (
        ("translation", translation, names, "rod or point mass"),
        ("rotation", rotation, names, "rod or point mass"),
        ("stiffness K", stiffness, rods, "rod"),
    ):
        for name in given if isinstance(given, Mapping) else ():
            check_known(what, name, known, kind)
    records = np.zeros(len(names), GAINS)
    for number, (name, size) in enumerate(zip(names, sizes, strict=True)):
        blocks = [("z", translation, size)]
        if number < len(structure.rods):
            blocks.append(("b", rotation, 3))
        for block, given, n in blocks:
            gains = given.get(name, Gains()) if isinstance(given, Mapping) else given
            if not isinstance(gains, Gains):
                raise OptionError(f"gains of '{name}' = {gains!r}; use Gains(X, Y, Z)")
            if n == 0:
                continue
            X, Y, Z = (_matrix(getattr(gains, key), n, f"{key}{block} of '{name}'") for key in ("X", "Y", "Z"))
            _check_definite(X, Y, Z, f"'{name}', block {block}")
            for key, matrix in (("X", X), ("Y", Y), ("Z", Z)):
                records[number][f"{key}{block}"][:n, :n] = matrix
        if number < len(structure.rods):
            value = stiffness.get(name, 0.0) if isinstance(stiffness, Mapping) else stiffness
            records[number]["Kb"] = _semidefinite(value, f"K of '{name}'")
    return records


def _check_definite(X: Array, Y: Array, Z: Array, where: str) -> None:
    """(5.6) by the Schur complement (Lemma 2.2): Z ≻ 0 and X - Y Z⁻¹ Yᵀ ≻ 0."""
    for key, matrix in (("X", X), ("Z", Z)):
        if not np.allclose(matrix, matrix.T, rtol=0, atol=1e-12 * np.abs(matrix).max()):
            raise OptionError(f"gains of {where}: {key} = {matrix.tolist()} must be symmetric")
    smallest = float(np.linalg.eigvalsh(Z)[0])
    if not smallest > 0:
        raise OptionError(f"gains of {where}: Z must be positive definite; its smallest eigenvalue is {smallest:.3g}")
    smallest = float(np.linalg.eigvalsh(X - Y @ np.linalg.solve(Z, Y.T))[0])
    if not smallest > 0:
        raise OptionError(
            f"gains of {where}: X - Y Z⁻¹ Yᵀ must be positive definite (Schur complement of (5.6)); its smallest "
            f"eigenvalue is {smallest:.3g}: enlarge X or Z, or reduce Y"
        )


def _semidefinite(value: ArrayLike, what: str) -> Array:
    K = _matrix(value, 3, what)
    size = np.abs(K).max()
    if not np.allclose(K, K.T, rtol=0, atol=1e-12 * size):
        raise OptionError(f"stiffness {what} = {K.tolist()} must be symmetric")
    smallest = float(np.linalg.eigvalsh(K)[0])
    if smallest < -1e-12 * size:  # round-off of the eigenvalues
        raise OptionError(
            f"stiffness {what} must be positive semidefinite, (6.6); its smallest eigenvalue is {smallest:.3g}"
        )
    return K


def _matrix(value: ArrayLike, n: int, what: str) -> Array:
    matrix = real_array(f"gain {what}", value, (n, n))
    return matrix * np.eye(n) if np.ndim(value) == 0 else matrix
