"""Gains of the quadratic laws: X, Y, Z of (5.4)-(5.5) and K of (6.3), checked, as records for compiled code."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import check_definite, check_known, real_array
from tensegrity_mj.basics.kinds import Kind, Wrong
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


def _one(value: Any, more: str = "") -> Gains:
    if isinstance(value, Mapping) and set(value) <= {"X", "Y", "Z"}:
        return Gains(**value)
    if not isinstance(value, Gains):
        raise Wrong(f" = {value!r}; it must be Gains(X, Y, Z), or a table with X, Y, Z{more}")
    return value


def _by_rod(value: Any) -> Gains | dict[str, Gains]:
    if not isinstance(value, Mapping) or set(value) <= {"X", "Y", "Z"}:
        return _one(value, ", or one by rod name")
    found = {}
    for name, entry in value.items():
        try:
            found[name] = _one(entry)
        except Wrong as wrong:
            raise Wrong(f".{name}{wrong}") from None
    return found


GainsOfRods = Annotated[Gains | Mapping[str, Gains], Kind(_by_rod)]  # of all rods, or by the rod's name


def gain_records(
    structure: Structure,
    translation: GainsOfRods,
    rotation: GainsOfRods,
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
            if n == 0:
                continue
            X, Y, Z = (_matrix(getattr(gains, key), n, f"{key}{block} of '{name}'") for key in ("X", "Y", "Z"))
            where = f"gains of '{name}', block {block}"
            check_definite(f"{where}: X", X)
            check_definite(f"{where}: Z", Z)
            schur = X - Y @ np.linalg.solve(Z, Y.T)  # Lemma 2.2
            check_definite(
                f"{where}: X - Y Z⁻¹ Yᵀ (Schur complement of (5.6))",
                (schur + schur.T) / 2,
                remedy=": enlarge X or Z, or reduce Y",
            )
            for key, matrix in (("X", X), ("Y", Y), ("Z", Z)):
                records[number][f"{key}{block}"][:n, :n] = matrix
        if number < len(structure.rods):
            value = stiffness.get(name, 0.0) if isinstance(stiffness, Mapping) else stiffness
            K = _matrix(value, 3, f"K of '{name}'")
            check_definite(f"stiffness K of '{name}' (6.6)", K, semi=True)
            records[number]["Kb"] = K
    return records


def _matrix(value: ArrayLike, n: int, what: str) -> Array:
    matrix = real_array(f"gain {what}", value, (n, n))
    return matrix * np.eye(n) if np.ndim(value) == 0 else matrix
