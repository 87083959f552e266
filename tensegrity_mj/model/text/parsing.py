"""TOML texts into tables, in time and memory that grow as the text does, whatever it holds."""

from __future__ import annotations

import re
import tomllib
from typing import Any

from tensegrity_mj.basics.texts import value_text
from tensegrity_mj.errors import FormatError
from tensegrity_mj.model.text.keys import MOST_DEPTH

# Texts in quotes, closed or not, and comments: each alternative takes what it can and never goes back.
_TEXTS = re.compile(
    r'"""(?:[^"\\]|\\.|"(?!""))*+(?:""")?+'
    r"|'''(?:[^']|'(?!''))*+(?:''')?+"
    r'|"(?:[^"\\\n]|\\.)*+"?+'
    r"|'[^'\n]*+'?+"
    r"|\#[^\n]*+",
    re.DOTALL,
)
_LONG_KEY = re.compile(rf"(?<![\w-])(?:[\w-]++[ \t]*+\.[ \t]*+){{{MOST_DEPTH}}}")


def parse(text: str, where: str) -> dict[str, Any]:
    """The table that a TOML text describes.

    Raises:
        FormatError: if it is not valid TOML, has a key of more than `MOST_DEPTH` parts (the time to read one grows as
            their square), or values that stand in each other deeper than that.
    """
    found = _LONG_KEY.search(_TEXTS.sub(_as_word, text))
    if found is not None:
        raise FormatError(
            f"{where}: a dotted key, {found[0]}..., has more than {MOST_DEPTH} parts; docs/format.md describes the keys"
        )
    try:
        data = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # TOMLDecodeError; numbers of thousands of digits; deep nesting
        found = re.search(r"at line (\d+)", str(error))
        line = text.splitlines()[int(found[1]) - 1 :][:1] if found else []
        quoted = f": {value_text(line[0].strip())}" if line else ""
        raise FormatError(f"{where}: not valid TOML: {error}{quoted}; docs/format.md shows how to write it") from error
    if _deeper(data, MOST_DEPTH):
        raise FormatError(
            f"{where}: its tables and lists stand in each other more than {MOST_DEPTH} deep; write what docs/format.md "
            "describes"
        )
    return data


def _as_word(found: re.Match[str]) -> str:
    """What stands for a text in quotes, which may be a part of a key; nothing for a comment."""
    return "" if found[0].startswith("#") else "q"


def _deeper(data: Any, most: int) -> bool:
    """Whether tables and lists stand in each other more than `most` deep."""
    level = [data]
    for _ in range(most):
        insides = [item.values() if isinstance(item, dict) else item for item in level]
        level = [item for inside in insides for item in inside if isinstance(item, (dict, list))]
        if not level:
            return False
    return True
