"""Texts from files and users where they leave the program: in messages, as names of files, in figures.

A scene's name is a free text, and a file may come from anyone. Whatever shows such a text, or makes a path of it, uses
one of these functions.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable, Sequence

from tensegrity_mj.errors import printable

MOST_BYTES = 100  # of a file name: file systems take 255, some 143, and suffixes come after it
MOST_SHOWN = 400  # letters of a line of `at_a_glance`
MARK_BYTES = 8  # of the mark of a changed name

# Devices on Windows, with any suffix.
_RESERVED = frozenset({"CON", "PRN", "AUX", "NUL", *(f"{port}{n}" for port in ("COM", "LPT") for n in range(1, 10))})


def value_text(value: object) -> str:
    """Return a value as Python writes it, or the beginning of a long one."""
    try:
        text = repr(value)
    except ValueError:  # Python writes no integers of more than some thousand digits
        text = f"an integer of {value.bit_length()} bits" if isinstance(value, int) else f"a {type(value).__name__}"
    return shortened(text, 100)


def shortened(text: str, most: int) -> str:
    """Return a text, or the beginning of a long one."""
    return text if len(text) <= most else f"{text[: most - 3]}..."


def at_a_glance(rows: Iterable[tuple[str, str]]) -> str:
    """Format rows (name, text) as the lines that Python prints for an object, in printable characters."""
    return "\n".join(f"{name:<7} {shortened(printable(text), MOST_SHOWN)}" for name, text in rows)


def file_name(text: str) -> str:
    """Make a name for a file or a folder: the text itself where it is harmless, otherwise its harmless part.

    The result has no separator, no control character and no device's name, is neither empty nor hidden, starts with
    no hyphen, and has at most `MOST_BYTES` bytes. Texts that differ get names that differ: a name that had to be
    changed ends in a mark made from the whole text.
    """
    name = re.sub(r"[^\w .,+=@()-]+", "_", unicodedata.normalize("NFC", text))
    name = name.lstrip(" .-").rstrip(" .")
    if name.partition(".")[0].rstrip().upper() in _RESERVED:
        name = f"_{name}"
    if name and name == text and len(name.encode()) <= MOST_BYTES:
        return name
    import hashlib  # OpenSSL comes with it: 4 MB

    mark = hashlib.sha256(text.encode(errors="surrogatepass")).hexdigest()[:MARK_BYTES]
    head = name.encode(errors="ignore")[: MOST_BYTES - MARK_BYTES - 1].decode(errors="ignore").rstrip(" .")
    return f"{head or 'unnamed'}-{mark}"


def figure_text(text: str, most: int = 120) -> str:
    """Escape a text for matplotlib, so that no $ begins a formula and no label is hidden.

    Longer texts are cut. Formulas of our own may be in the same label, but not directly behind this text.
    """
    shown = shortened(printable(text), most).replace("$", r"\$")
    # Labels that begin with an underscore stay out of legends.
    return rf"$\_${shown[1:]}" if shown.startswith("_") else shown


def aligned(rows: Sequence[Sequence[object]], *, numbers: bool = False) -> list[str]:
    """Lines with the cells of rows in columns; all but the first column to the right where they are numbers."""
    texts = [[str(cell) for cell in row] for row in rows]
    widths = [max(map(len, column)) for column in zip(*texts, strict=True)]
    forms = [f"{'>' if numbers and place else '<'}{width}" for place, width in enumerate(widths)]
    return ["  ".join(map(format, line, forms)).rstrip() for line in texts]


def nearest(word: str, known: Iterable[str]) -> str:
    """Find the known word that a misspelt one was probably meant to be; "" for none."""
    import difflib  # only where something is misspelt

    candidates = list(known)
    # Letters in another order are the likeliest mistake, which difflib does not know: 'dea' is as near to 'ode'.
    swapped = [one for one in candidates if sorted(one.casefold()) == sorted(word.casefold())]
    match = swapped or difflib.get_close_matches(word, candidates, 1)
    if not match and len(word) > 2:  # an abbreviation
        match = [one for one in candidates if one.startswith(word)]
    return match[0] if match else ""


def closest(word: str, known: Iterable[str]) -> str:
    """Suggest a known word for a misspelt one, as the end of a sentence; "" where none is near."""
    meant = nearest(word, known)
    return f" (did you mean '{meant}'?)" if meant else ""


def unknown(given: str, known: Iterable[str], what: str) -> str:
    """Make the message about an unknown name: the allowed ones, and the one probably meant."""
    names = list(known)
    return f"there is no {what} '{given}'{closest(given, names)}; allowed: {', '.join(names)}"
