"""Completion in the shell, by argcomplete: words of the parser, and by the metavar scenes, laws, files and folders.

In ~/.bashrc or ~/.zshrc: eval "$(register-python-argcomplete tensegrity-mj)"
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator

import argcomplete
from argcomplete.completers import DirectoriesCompleter, FilesCompleter

from tensegrity_mj.commands.parser import Parser
from tensegrity_mj.controllers.table import LAWS


def complete(parser: Parser) -> None:
    """Answer the shell that runs this program to complete a command line, and exit."""
    for action in _arguments(parser):
        action.completer = _Values(action.metavar)  # type: ignore[attr-defined]
    argcomplete.autocomplete(parser)


class _Values:
    """Completer for the values of an argument with this metavar."""

    def __init__(self, metavar: str | tuple[str, ...] | None) -> None:
        text = " ".join(metavar) if isinstance(metavar, tuple) else metavar or ""
        self.kinds = set(re.findall(r"[A-Z]+", text))
        self.suffixes = re.findall(r"FILE\.(\w+)", text)
        self.any_file = "FILE" in self.kinds and not self.suffixes

    def __call__(self, prefix: str, **_: object) -> list[str]:
        """The words that begin so, or that argcomplete then picks from."""
        found: list[str] = []
        suffixes = self.suffixes
        if "SCENE" in self.kinds:
            from tensegrity_mj.model.text.sources import scene_names

            found += scene_names()
            suffixes = [*suffixes, "toml"]
        if "LAW" in self.kinds:
            found += LAWS
            suffixes = [*suffixes, "py"]
        if "FOLDER" in self.kinds:
            found += DirectoriesCompleter()(prefix)
        if suffixes or self.any_file:
            found += FilesCompleter(suffixes)(prefix)
        return found


def _arguments(parser: Parser) -> Iterator[argparse.Action]:
    """The arguments of all commands that take a value and no choice."""
    yield from (action for action in parser._actions if action.choices is None and action.nargs != 0)
    for command in parser.commands.values():
        yield from _arguments(command)
