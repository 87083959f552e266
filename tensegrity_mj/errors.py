"""The errors of tensegrity_mj: one root class, and one class a kind of remedy.

Every message names the offending item, its value, what is allowed, and what to do about it.
"""

from __future__ import annotations


class TensegrityError(Exception):
    """Root of all errors that this package raises on purpose.

    Its message may quote a file: it is kept on one line of printable characters, and of a few hundred at most.
    """

    def __init__(self, message: object = "") -> None:
        super().__init__(printable_message(str(message)))


class StructureError(TensegrityError, ValueError):
    """A structure that is not physically or topologically valid."""


class SceneError(TensegrityError, ValueError):
    """A scene whose motion, loads or target do not fit its structure."""


class FormatError(TensegrityError, ValueError):
    """A file that cannot be read as what it should be."""


class OptionError(TensegrityError, ValueError):
    """An option outside its range, or one that contradicts another."""


class ControllerError(TensegrityError, RuntimeError):
    """A control law that failed: an exception, a wrong shape, or a value that is not finite."""


class ElementError(TensegrityError, RuntimeError):
    """An element that failed during a run: an exception, a wrong shape, or a value that is not finite."""


class InfeasibleError(TensegrityError, RuntimeError):
    """A problem that has no admissible solution (prestress, control)."""


class DivergenceError(TensegrityError, RuntimeError):
    """A simulation that left the finite world.

    Attributes:
        time: simulated time [s] at which it was detected.
        trajectory: what was recorded before it, or None.
    """

    def __init__(self, message: str, time: float, trajectory: object | None = None) -> None:
        super().__init__(message)
        self.time = time
        self.trajectory = trajectory


class MissingLibraryError(TensegrityError, RuntimeError):
    """A system library or optional package that this machine lacks; the message says how to get it."""


class MissingPackageError(MissingLibraryError, ModuleNotFoundError):
    """A Python package that is not installed, found by the import of what needs it."""


class ClusterError(TensegrityError, RuntimeError):
    """A cluster that was lost while it computed a study; what was finished is kept."""


class StabilityWarning(UserWarning):
    """A run whose step is beyond the largest stable one, or too coarse for its contact, reported before it starts."""


class IdentificationWarning(UserWarning):
    """Parameters that measurements do not see, reported before they are fitted."""


class DerivativeWarning(UserWarning):
    """Derivatives of a run that may miss the jump of a damped string that comes taut."""


MOST_LETTERS = 600  # of a message


TAIL = 200  # of them from the end, where the remedy stands


def printable(text: str, keep: str = "") -> str:
    """The text with every character that does not print written as in Python (\\x1b, \\n, \\u202e), but for `keep`."""
    if text.isprintable():
        return text
    return "".join(one if one.isprintable() or one in keep else repr(one)[1:-1] for one in text)


def printable_message(text: str) -> str:
    """The text on one line of printable characters; of a long one the beginning and the end."""
    if len(text) > 2 * MOST_LETTERS:  # before each letter of a file of megabytes is looked at
        text = text[:MOST_LETTERS] + text[-MOST_LETTERS:]
    shown = printable(text)
    if len(shown) <= MOST_LETTERS:
        return shown
    return f"{shown[: MOST_LETTERS - TAIL - 5]} ... {shown[-TAIL:]}"
