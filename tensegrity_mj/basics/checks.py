"""Checks of arguments, with one message for each kind of mistake; warnings that point at the caller."""

from __future__ import annotations

import enum
import sys
import warnings
from collections.abc import Collection, Sequence
from contextlib import nullcontext
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.basics import kinds
from tensegrity_mj.basics.kinds import Kind, Wrong
from tensegrity_mj.basics.texts import closest, unknown, value_text
from tensegrity_mj.errors import OptionError, TensegrityError


def checked(what: str, value: Any, kind: Kind, error: type[TensegrityError] = OptionError) -> Any:
    """The value made plain, as its kind has it.

    Raises:
        TensegrityError: of that class, naming what it is, its value and what is allowed.
    """
    try:
        return kind.plain(value)
    except Wrong as wrong:
        raise error(f"{what}{wrong}") from None


def positive(what: str, value: Any, unit: str = "") -> float:
    """The value as a finite float > 0, from `SMALLEST` to `LARGEST`; of seconds, a text that means one, too.

    Raises:
        OptionError: naming what it is and its value.
    """
    return checked(what, value, kinds.number(f"a finite number > 0{unit and ' ' + unit}", lambda x: x > 0))


def finite(what: str, value: Any, more: str = "") -> float:
    """The value as a finite float of at most `LARGEST`; numbers of any library pass, bools and texts do not.

    Raises:
        OptionError: naming what it is and its value.
    """
    return checked(what, value, kinds.number(f"a finite number{more}", lambda x: True))


def shape_of(value: Any) -> tuple[int, ...] | None:
    """The shape of an array or of nested sequences; None of what has none, as rows of several lengths."""
    try:
        return np.shape(value)
    except ValueError:
        return None


def real_array(
    what: str,
    value: Any,
    shape: tuple[int, ...],
    unit: str = "",
    scalar: bool = True,
    error: type[TensegrityError] = OptionError,
) -> NDArray[np.float64]:
    """The value as a real, finite array of the given shape; one number stands for all of them where `scalar`.

    Raises:
        TensegrityError: of that class, naming what it is, the shape it has and the shape it must have.
    """
    try:
        array = np.asarray(value)
        if array.dtype.kind in "cb":  # complex, or bool
            raise TypeError
        array = array.astype(float)
        if array.shape != shape:
            if not scalar or array.shape:
                raise ValueError
            array = np.broadcast_to(array, shape)
    except (TypeError, ValueError, OverflowError):
        allowed = f"{'a number or ' if scalar else ''}an array of shape {shape}"
        found = f" of shape {shape_of(value)}" if shape_of(value) else ""
        given = f"{what} = {value_text(value)}{found}"
        raise error(f"{given}; it must be {allowed}{unit and ' [' + unit + ']'}") from None
    if not np.all(np.isfinite(array)):
        place = np.argwhere(~np.isfinite(array))[0].tolist() if shape_of(value) else []
        found = array[tuple(place)] if place else value_text(kinds.shown(value))
        raise error(f"{what}{place or ''} = {found}; every number must be finite")
    return array


def check_definite(what: str, matrix: NDArray[np.float64], semi: bool = False, remedy: str = "") -> None:
    """Raise OptionError unless a matrix (n, n) is symmetric and positive definite; semidefinite, up to round-off."""
    round_off = 1e-12 * np.abs(matrix).max()
    if not np.allclose(matrix, matrix.T, rtol=0, atol=round_off):
        raise OptionError(f"{what} = {value_text(matrix.tolist())} must be symmetric")
    smallest = float(np.linalg.eigvalsh(matrix)[0])
    if not (smallest >= -round_off if semi else smallest > 0):
        kind = "semidefinite" if semi else "definite"
        raise OptionError(f"{what} must be positive {kind}; its smallest eigenvalue is {smallest:.3g}{remedy}")


def state_of(
    time: Any, nodes: Any, velocities: Any, count: int
) -> tuple[float, NDArray[np.float64], NDArray[np.float64]]:
    """A time [s] and fresh arrays of `count` node positions [m] and velocities [m/s], (N, 3).

    Compiled code, which would read beyond arrays that are too short, may be given these.

    Raises:
        OptionError: naming which of them it is, and the shape it must have.
    """
    return (
        finite("time", time, " [s]"),
        np.array(real_array("nodes", nodes, (count, 3), "m", scalar=False)),
        np.array(real_array("velocities", velocities, (count, 3), "m/s", scalar=False)),
    )


def member(what: str, value: Any, kind: type[enum.Enum]) -> None:
    """Raise OptionError unless the value is a member of an enum: functions inside take no texts in their place."""
    if not isinstance(value, kind):
        raise OptionError(f"{what} = {value_text(value)}; it must be one of {', '.join(map(str, kind))}")


def instance(what: str, value: Any, of: type | tuple[type, ...], remedy: str) -> None:
    """Raise OptionError unless the value is of a class, or of one of them; `remedy` says what to give."""
    if not isinstance(value, of):
        raise OptionError(f"{what} = {value_text(value)}; {remedy}")


def check_known(where: str, name: str, names: Collection[str], what: str) -> None:
    """Raise OptionError, with the name that was probably meant, unless a name is among the known ones of a kind."""
    if not isinstance(name, str) or name not in names:
        raise OptionError(f"{where}: {unknown(str(name), names, what)}")


def choice_from(path: str, kind: type[enum.Enum], value: Any) -> Any:
    """The member of an enum with that value, in which - may stand for spaces; OptionError where there is none."""
    found = kinds.member_of(kind, value) if isinstance(value, str) else None
    if found is not None:
        return found
    allowed = [str(one.value) for one in kind]
    meant = closest(value, allowed) if isinstance(value, str) else ""
    raise OptionError(f"{path} = {value!r}{meant}; allowed: {', '.join(allowed)}")


def names_from(what: str, given: Sequence[str] | None, known: Sequence[str]) -> list[str]:
    """Return the names chosen of the known ones, each once; all of them for None.

    Raises:
        OptionError: for a name of nothing, or none at all.
    """
    names = list(known if given is None else [given] if isinstance(given, str) else given)
    for name in names:
        check_known(what, name, known, "name")
    if not names:
        raise OptionError(f"{what}: name at least one of {', '.join(known)}")
    return list(dict.fromkeys(names))


# Nodes of a family's scene. Laid out by formulas, so many take some ten seconds; where an equilibrium is found first,
# the time grows with the square to the cube of their number, and this many take minutes.
MOST_NODES, MOST_FOUND = 30_000, 3_000


def whole(what: str, value: Any, least: int) -> int:
    """The value as an integer of at least `least`.

    Raises:
        OptionError: naming what it is and its value.
    """
    return checked(what, value, kinds.whole(least))


def sequence_of(what: str, values: Any, error: type[TensegrityError] = OptionError) -> tuple[Any, ...]:
    """The values as a tuple; raise `error` if they are a text, or no sequence at all."""
    return checked(what, values, Kind(kinds.sequence), error)


def check_nodes(what: str, value: Any, nodes: int, most: int = MOST_NODES) -> None:
    """Refuse an argument that makes more nodes than a family builds, before anything is built.

    Args:
        what: the argument, for the message.
        value: the argument's value.
        nodes: how many nodes it makes, or sets of one node's numbers.
        most: how many there may be.

    Raises:
        OptionError: naming the argument, its value, and both numbers of nodes.
    """
    if nodes > most:
        raise OptionError(
            f"{what} = {value_text(value)}: that makes {value_text(nodes)} nodes, and at most {most} are built; choose "
            "a smaller one"
        )


INSIDE = "tensegrity_mj."


def warn_caller(text: str, category: type[Warning]) -> None:
    """Warn with the place of the first caller outside the package."""
    level, frame = 2, sys._getframe(1)
    while frame.f_back is not None and frame.f_globals.get("__name__", "").startswith(INSIDE):
        level, frame = level + 1, frame.f_back
    bars: Any = getattr(sys.modules.get("tqdm"), "tqdm", None)  # whose line is cleared meanwhile
    with bars.external_write_mode(sys.stderr) if getattr(bars, "_instances", ()) else nullcontext():
        warnings.warn(text, category, stacklevel=level)
