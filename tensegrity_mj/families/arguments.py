"""Checks of what builders of scenes are given."""

from __future__ import annotations

from typing import Any

import numpy as np

from tensegrity_mj.errors import OptionError
from tensegrity_mj.texts import value_text

# Nodes of a family's scene. Laid out by formulas, so many take some ten seconds; where an equilibrium is found first,
# the time grows with the square to the cube of their number, and this many take minutes.
MOST_NODES, MOST_FOUND = 30_000, 3_000


def whole(what: str, value: Any, least: int) -> int:
    """The value as an integer of at least `least`.

    Raises:
        OptionError: naming what it is and its value.
    """
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, np.integer)) or value < least:
        raise OptionError(f"{what} = {value_text(value)}; it must be an integer >= {least}")
    return int(value)


def check_nodes(what: str, value: Any, nodes: int, most: int = MOST_NODES) -> None:
    """Refuse an argument that makes more nodes than a family builds, before anything is built.

    Args:
        what: the argument, for the message.
        value: of it.
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
