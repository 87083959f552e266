"""The laws that scene files and the command line can name: each module of this folder that has a `LAW`, by its name,
and those that installed packages have (entry points of the group `tensegrity_mj.laws`).

A new law is a file of its own, which ends as `lyapunov.py` does. The table imports a law when it is used.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache, cached_property
from importlib import import_module
from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tensegrity_mj.basics.dependencies import installed, load

if TYPE_CHECKING:
    from tensegrity_mj.controllers.own import OwnLaw
OF_SCENE = ("structure", "target", "gravity", "known")  # what a law has of its scene


@dataclass(frozen=True)
class NamedLaw:
    """A law with a name.

    Attributes:
        law: makes it, called as law(structure, target, *, gravity, known, **options); these are its options.
        more: type hints, by name, of options that are no arguments of `law`: its **options, and a `water`.
        needs_target: whether it goes anywhere; a program of strings does not.
    """

    law: Callable[..., Any]
    more: Mapping[str, Any] = field(default_factory=dict)
    needs_target: bool = True

    @cached_property
    def options(self) -> dict[str, Any]:
        """The type hint of each option, by name: what files may hold for it, see `basics.hints`."""
        from tensegrity_mj.basics.hints import hints_of  # needs numpy, which help does not

        hints, arguments = hints_of(self.law), signature(self.law).parameters.values()
        named = [one.name for one in arguments if one.kind is not one.VAR_KEYWORD and one.name not in OF_SCENE]
        return {name: hints.get(name) for name in named} | dict(self.more)


class _Laws(Mapping[str, "NamedLaw | OwnLaw"]):
    """The laws by their names: built-in ones in alphabetical order, then those of installed packages."""

    def __getitem__(self, name: str) -> NamedLaw | OwnLaw:
        if name in built_in():
            found: NamedLaw = import_module(f"tensegrity_mj.controllers.{name}").LAW
            return found
        from tensegrity_mj.controllers.own import OwnLaw

        return OwnLaw(name, load(installed("laws")[name]))

    def __contains__(self, name: object) -> bool:
        return name in built_in() or name in installed("laws")

    def __iter__(self) -> Iterator[str]:
        yield from built_in()
        yield from sorted(installed("laws").keys() - set(built_in()))

    def __len__(self) -> int:
        return sum(1 for _ in self)


@cache
def built_in() -> tuple[str, ...]:
    """Names of the laws of this folder, found in the text of the files, so that none is imported for its name alone."""
    files = [path for folder in sys.modules[__package__].__path__ for path in Path(folder).glob("*.py")]
    named = [path.stem for path in files if re.search(r"^LAW\b", path.read_text(encoding="utf-8"), re.MULTILINE)]
    return tuple(sorted(named))


LAWS = _Laws()
