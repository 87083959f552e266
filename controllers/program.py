"""A program of rest lengths, open loop: strings are shortened and let out at given times, without any feedback.

It is how robots roll and walk by a sequence of shapes. Each move takes one string's rest length from where it is to a
fraction of its own, from rest to rest by the cubic 3 x² - 2 x³; between its moves it stands.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from tensegrity_mj.basics.checks import check_known, instance, sequence_of
from tensegrity_mj.controllers.replay import Cubics
from tensegrity_mj.controllers.table import NamedLaw
from tensegrity_mj.dynamics.native.law import Command, NativeLaw, check_made_for
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.model.target import Target

Move = tuple[str, float, float, float]  # string, begin [s], end [s], fraction of its own rest length
NEED = "each move is [string, begin, end, fraction], with 0 <= begin < end [s] and a fraction > 0 of its rest length"


class Program(Cubics):
    """Rest lengths by a list of moves.

    Args:
        structure: whose strings move; each starts at its own rest length.
        target: not used; a program needs none.
        moves: rows (string, begin, end, fraction): from `begin` to `end` [s] the rest length goes to this fraction of
            the string's own. Strings without a move keep theirs.
        gravity, known: not used.

    Raises:
        OptionError: for moves that are none, strings that are unknown, moves of one string that overlap.
    """

    command = Command.REST_LENGTH

    def __init__(
        self,
        structure: Structure,
        target: Target | None = None,
        *,
        moves: Sequence[Sequence[Any]] = (),
        gravity: Any = None,
        known: Any = (),
    ) -> None:
        instance("structure", structure, Structure, "use a Structure (scene.structure)")
        self.structure = structure
        rows = [
            _move(f"program: moves[{place}]", row) for place, row in enumerate(sequence_of("program: moves", moves))
        ]
        names = [string.name for string in structure.strings]
        for name, *_ in rows:
            check_known("program", name, names, "string")
        self.moves = tuple(sorted(rows, key=lambda row: row[1]))
        times = np.unique([0.0, *(time for _, begin, end, _ in rows for time in (begin, end))])
        self.times = times if len(times) > 1 else np.array([0.0, 1.0])
        # The last piece stands still: what a move ends with is held.
        self.coefficients = np.zeros((len(self.times), len(names), 4))
        self.coefficients[:, :, 3] = structure.rest_lengths
        until: dict[str, float] = {}
        for name, begin, end, fraction in self.moves:
            if begin < until.get(name, 0.0):
                raise OptionError(
                    f"program: string '{name}' is to move from {begin:g} s on, while it moves until {until[name]:g} s; "
                    "let one move end before the next begins"
                )
            until[name] = end
            self._add(names.index(name), begin, end, fraction * structure.rest_lengths[names.index(name)])

    def _add(self, string: int, begin: float, end: float, goal: float) -> None:
        """One move: the cubic in pieces from time to time, and its goal from then on."""
        first, last = np.searchsorted(self.times, (begin, end))
        start, wide = self.coefficients[first, string, 3], end - begin
        for piece in range(first, last):
            x = (self.times[piece] - begin) / wide
            change = (goal - start) * np.array([-2.0, 3.0 - 6.0 * x, 6.0 * x - 6.0 * x**2, x**2 * (3.0 - 2.0 * x)])
            self.coefficients[piece, string] = change / wide ** np.array([3.0, 2.0, 1.0, 0.0]) + [0.0, 0.0, 0.0, start]
        self.coefficients[last:, string] = [0.0, 0.0, 0.0, goal]

    def native(self, structure: Structure) -> NativeLaw:
        """The compiled law."""
        check_made_for(self.structure, structure)
        return super().native(structure)

    def describe(self) -> dict[str, Any]:
        """Plain values for the provenance of a run."""
        return {"law": "program", "moves": [list(move) for move in self.moves]}


def _move(what: str, row: Any) -> Move:
    found = sequence_of(what, row)
    if len(found) != 4 or not isinstance(found[0], str):
        raise OptionError(f"{what} = {row!r}; {NEED}")
    try:
        begin, end, fraction = (float(value) for value in found[1:])
    except (TypeError, ValueError):
        raise OptionError(f"{what} = {row!r}; {NEED}") from None
    if not (0 <= begin < end < np.inf and 0 < fraction < np.inf):
        raise OptionError(f"{what} = {row!r}; {NEED}")
    return found[0], begin, end, fraction


LAW = NamedLaw(Program, needs_target=False)
