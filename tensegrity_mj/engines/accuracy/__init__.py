"""The accuracy of a run, in place of a step: here as an option of an engine; `search` finds the step that meets it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from tensegrity_mj.basics.fields import refused
from tensegrity_mj.basics.kinds import number

LEAST, MOST = 1e-10, 1e-2  # m, what may be requested
ACCURACY = number(f"from {LEAST:g} to {MOST:g} m", lambda x: LEAST <= x <= MOST)


def check_accuracy(options: Any, chosen: Sequence[str]) -> None:
    """Check the options of an engine whose accuracy chooses some of them.

    Raises:
        OptionError: where one of these is given with an accuracy.
    """
    for name in () if options.accuracy is None else chosen:
        given = getattr(options, name)
        if given != getattr(type(options), name):
            raise refused(
                options,
                f"{name} = {getattr(given, 'value', given)!r} with accuracy = {options.accuracy:g} m: the accuracy "
                "chooses it; leave out one of the two",
            )
