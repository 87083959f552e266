"""The parser of the command line: commands in groups, errors of usage in one line, and what was probably meant."""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterable, Mapping, Sequence
from types import ModuleType
from typing import Any, NoReturn

from tensegrity_mj.basics.texts import nearest
from tensegrity_mj.commands import arguments, common, installed
from tensegrity_mj.errors import MissingLibraryError

PROGRAM = "tensegrity-mj"
Groups = Mapping[str, Mapping[str, ModuleType]]
FORMER = {"benchmark": "speed", "long-runs": "drift"}  # what commands were, or are also, called
_NEGATIVE_NUMBER = re.compile(r"-\.?\d")


class UsageError(Exception):
    """Arguments that the parser refuses."""


class Parser(argparse.ArgumentParser):
    """An argparse parser that raises instead of exiting, and says in one line what is wrong and what was meant."""

    def __init__(self, *args: Any, **settings: Any) -> None:
        fixed = {"allow_abbrev": False, "formatter_class": argparse.RawDescriptionHelpFormatter}
        super().__init__(*args, **(settings | fixed))
        self.commands: dict[str, Parser] = {}
        self.groups: dict[str, list[str]] = {}

    @property
    def words(self) -> str:
        """The command's own words: 'run', 'audit drift', or nothing for the whole command line."""
        return self.prog.removeprefix(PROGRAM).strip()

    def error(self, message: str) -> NoReturn:
        """Raise `UsageError` with the command and the message, as 'run: --timestep: 0: it must be > 0'."""
        missing = message.removeprefix("the following arguments are required: ")
        if missing != message:
            message = f"{missing}: missing; see {self.prog} --help"
            if self.commands:
                message = f"name a command: {', '.join(self.commands)}"
        message = re.sub("ignored explicit argument (.*)", r"\1: it takes no value; leave it out", message)
        raise UsageError(": ".join(part for part in (self.words, message.removeprefix("argument ")) if part))

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> tuple[Any, list[str]]:
        """Parse as argparse does, but refuse first an option that does not exist, then arguments that are missing."""
        for word in self._own(args or ()):
            name = word.partition("=")[0]
            if name not in self._option_string_actions:
                options = {option.lstrip("-"): option for option in self._option_string_actions}
                meant = nearest(name.lstrip("-"), options)
                more = f"did you mean {options[meant]}?" if meant else f"see {self.prog} --help"
                self.error(f"{name}: there is no such option; {more}")
        found, rest = super().parse_known_args(args, namespace)
        if rest and not self.commands:
            self.error(f"{' '.join(rest)}: more than it takes; see {self.prog} --help")
        return found, rest

    def _own(self, words: Sequence[str]) -> Iterable[str]:
        """The words that are options of this parser by their looks, rather than of a command's."""
        for word in words:
            if word == "--" or (self.commands and not word.startswith("-")):
                return
            if word.startswith("-") and word != "-" and " " not in word and not _NEGATIVE_NUMBER.match(word):
                yield word

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """Refuse a value that is not among the choices of an argument."""
        if action.choices is None or value in action.choices:
            return
        allowed = [str(choice) for choice in action.choices]
        if isinstance(action, argparse._SubParsersAction):
            if value in installed.EVIDENCE and not self.words:
                raise MissingLibraryError(f"{value}: {installed.MISSING}")
            meant = self._command_like(str(value))
            more = f"did you mean {meant}?" if meant else f"allowed: {', '.join(allowed)}"
            raise argparse.ArgumentError(None, f"{value}: there is no such command; {more}")
        meant = nearest(str(value), allowed)
        more = f"; did you mean {meant}?" if meant else ""
        raise argparse.ArgumentError(action, f"{value!r}: allowed: {', '.join(allowed)}{more}")

    def _command_like(self, word: str) -> str:
        """The command that a word is probably meant to be, also one of a group: 'drift' is `audit drift`."""
        if word == "help":
            return f"{self.words} --help".strip()
        if not self.words:
            from tensegrity_mj.model.text.sources import scene_names  # loads numpy

            if word in scene_names():
                return f"run {word}"
        phrases = {name: name for name in self.commands}
        for name, command in self.commands.items():
            phrases |= {inner: f"{name} {inner}" for inner in command.commands if inner not in phrases}
        meant = FORMER.get(word) or nearest(word, phrases)
        if meant not in phrases:
            return ""
        return f"{self.words} {phrases[meant]}".strip()

    def format_help(self) -> str:
        """Format the help as argparse does, with the commands by their groups."""
        if not self.groups:
            return super().format_help()
        formatter = self._get_formatter()
        formatter.add_usage(self.usage, self._actions, self._mutually_exclusive_groups)
        formatter.add_text(self.description)
        listed = next(action for action in self._actions if isinstance(action, argparse._SubParsersAction))
        lines = {action.dest: action for action in listed._get_subactions()}
        sections: dict[str, list[argparse.Action]] = {
            title: [lines[name] for name in names] for title, names in self.groups.items()
        }
        sections["options"] = [action for action in self._actions if action.option_strings]
        for title, actions in sections.items():
            formatter.start_section(title)
            formatter.add_arguments(actions)
            formatter.end_section()
        formatter.add_text(self.epilog)
        return formatter.format_help()


def build(groups: Groups, description: str, epilog: str) -> Parser:
    """The parser of all commands, by groups."""
    parser = Parser(prog=PROGRAM, description=description, epilog=f"{epilog}\n\n{common.EXIT_CODES}")
    parser.add_argument("--version", action="store_true", help="print the version and exit")
    _add_commands(parser, {name: module for group in groups.values() for name, module in group.items()})
    parser.groups = {title: list(group) for title, group in groups.items()}
    return parser


def _add_commands(parser: Parser, modules: Mapping[str, ModuleType], required: bool = False) -> None:
    places = parser.add_subparsers(metavar="COMMAND", required=required)
    for name, module in modules.items():
        inner: Mapping[str, ModuleType] = getattr(module, "COMMANDS", {})
        words = arguments.words_of(module)
        epilog = f"{words.get('examples', '').rstrip()}\n\n{common.EXIT_CODES}".strip()
        command = places.add_parser(name, help=words["help"], description=module.__doc__, epilog=epilog)
        parser.commands[name] = command
        if inner:
            _add_commands(command, inner, required=True)
            command.groups = {"commands": list(inner)}
            continue
        arguments.add_arguments(command, module)
        command.add_argument(
            "--json", action="store_true", help="print one JSON object on stdout; everything else goes to stderr"
        )
        command.set_defaults(command=command.words, execute=module.execute)
