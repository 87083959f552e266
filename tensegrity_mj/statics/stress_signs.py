"""Members that can be in tension or compression in a state of self-stress, by linear programs over the states.

States (S, M + R) [N] are orthonormal member forces in balance, M strings first; strings only pull.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import check_known
from tensegrity_mj.errors import InfeasibleError
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.model.structure_checks import names_of

Flags = NDArray[np.bool_]

FAR = 1e6  # [N] weights of states: those of rods alone have no limit from strings
TOLERANCE = 1e-10  # of linear programs, the least that HiGHS takes


def can_pull(states: Array, strings: int) -> Flags:
    """(M,): states in which no string pushes are a cone; the one with the most strings above 1 has them all."""
    size = len(states)
    if not size or not strings:
        return np.zeros(strings, bool)
    result = solved_program(
        np.concatenate([np.zeros(size), -np.ones(strings)]),
        np.hstack([-states[:, :strings].T, np.eye(strings)]),
        np.zeros(strings),
        bounds=[(None, None)] * size + [(0.0, 1.0)] * strings,
    )
    return np.asarray(result.x[size:] > 0.5)


def can_push(states: Array, pulling: Flags) -> tuple[Flags, bool]:
    """(R,) each rod by itself, and whether all can at once, while no string pushes; `pulling` is of `can_pull`.

    To any such state, some of one in which every string that can pull does may be added: that one then pulls too.
    """
    size, M = len(states), len(pulling)
    count = states.shape[1] - M
    found = np.zeros(count, bool)
    if not pulling.any() or not count:
        return found, False
    kept, wanted = -states[:, :M].T, states[:, M:].T
    together = solved_program(
        np.append(np.zeros(size), -1.0),
        np.vstack([np.append(kept, np.zeros((M, 1)), axis=1), np.append(wanted, np.ones((count, 1)), axis=1)]),
        np.zeros(M + count),
        bounds=[(None, None)] * size + [(None, 1.0)],
    )
    if together.x[-1] > 0.5:
        return np.ones(count, bool), True
    for row in range(count):
        limits = np.append(np.zeros(M), 1.0)
        result = solved_program(wanted[row], np.vstack([kept, -wanted[row]]), limits, bounds=(-FAR, FAR))
        found[row] = bool(result.fun < -0.5)
    return found, False


def obstacle(lengthening: Array, rods: Array, barred: Flags) -> Array:
    """The certificate (q,) of the strings that cannot pull: free coordinates of a motion.

    Args:
        lengthening: (m, q) how the strings' lengths change with the free coordinates.
        rods: (R, q) how the rods' do.
        barred: (m,) strings that cannot pull.
    """
    q, count = lengthening.shape[1], int(barred.sum())
    pick = np.zeros((len(lengthening), count))
    pick[np.flatnonzero(barred), np.arange(count)] = 1.0
    result = solved_program(
        np.concatenate([np.zeros(q), -np.ones(count)]),
        np.hstack([-lengthening, pick]),
        np.zeros(len(lengthening)),
        kept=(np.hstack([rods, np.zeros((len(rods), count))]), np.zeros(len(rods))),
        bounds=[(None, None)] * q + [(0.0, 1.0)] * count,
    )
    return np.asarray(result.x[:q])


def linear_program(
    cost: Array,
    rows: Any,
    limits: Array,
    *,
    kept: tuple[Any, Array] | None = None,
    bounds: Any = (None, None),
    tolerance: float | None = TOLERANCE,
    presolve: bool = True,
) -> Any:
    """SciPy's result for the least cost @ x with rows @ x <= limits, and A @ x = b for (A, b) that is kept.

    Rows may be sparse. A tolerance of None is the solver's own.
    """
    from scipy.optimize import linprog

    equal, values = kept or (None, None)
    options: dict[str, Any] = {"presolve": presolve}
    options |= dict.fromkeys(("primal_feasibility_tolerance", "dual_feasibility_tolerance"), tolerance)
    return linprog(cost, rows, limits, equal, values, bounds, method="highs", options=options)


def solved_program(cost: Array, rows: Array, limits: Array, **options: Any) -> Any:
    """Solve a linear program as `linear_program` does; raise InfeasibleError where there is no solution."""
    result = linear_program(cost, rows, limits, **options)
    if result.status != 0:
        raise InfeasibleError(f"a linear program over states of self-stress was not solved: {result.message}")
    return result


def listed(names: Sequence[str], chosen: Flags, what: str) -> str:
    """Return text such as "strings 's1', 's2', ... (40 in all)" of the chosen names, twelve at most; "" for none."""
    found = [name for name, one in zip(names, chosen, strict=True) if one]
    return f"{what}{'s' if len(found) > 1 else ''} {names_of(found)}" if found else ""


def strings_named(what: str, names: Sequence[str], structure: Structure) -> Flags:
    """(M,): whether a string is among the named ones; OptionError for a name of none."""
    known = [string.name for string in structure.strings]
    chosen = [names] if isinstance(names, str) else list(names)
    for name in chosen:
        check_known(what, name, known, "string")
    return np.array([name in chosen for name in known], bool)
