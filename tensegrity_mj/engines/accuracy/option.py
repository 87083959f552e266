"""The option `accuracy` of engines, checked; an engine without it does without the rest of this folder."""

from __future__ import annotations

from typing import Any

from tensegrity_mj.basics.checks import positive
from tensegrity_mj.errors import OptionError

LEAST, MOST = 1e-10, 1e-2  # m, what may be asked for


def check_accuracy(engine: str, value: Any, chosen: dict[str, tuple[Any, Any]]) -> float:
    """The accuracy as a float.

    Args:
        engine: its name.
        value: [m].
        chosen: by name, what the options are that the accuracy chooses, and their defaults.

    Raises:
        OptionError: out of range, or where an option is given that the accuracy chooses.
    """
    accuracy = positive(f"{engine}: accuracy", value, "m")
    if not LEAST <= accuracy <= MOST:
        raise OptionError(f"{engine}: accuracy = {accuracy:g} m; it must be from {LEAST:g} to {MOST:g} m")
    for name, (given, default) in chosen.items():
        if given != default:
            raise OptionError(
                f"{engine}: {name} = {getattr(given, 'value', given)!r} with accuracy = {accuracy:g} m: the accuracy "
                f"chooses it; leave out one of the two"
            )
    return accuracy
