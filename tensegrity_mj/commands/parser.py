"""The parser of the command line: commands in groups, errors of usage in one line, and what was probably meant.

The texts of a command, its help, its examples and its arguments, are in the TOML file next to its module:

    help = "the mass of a structure"
    examples = "..."
    arguments = [
        { use = "scene" },
        { name = "--of", choices = ["rods", "point-masses", "all"], default = "all", help = "members (default: all)" },
    ]

A row has `name` and what argparse's `add_argument` takes, `type` as the name of a function of the command's module, of
`experiment` or of `common`, or int. Choices may be "engines": those that there are. `several` are choices of
which some may be given, all by default. `use` stands for the rows of that name in `shared.toml`. The file's `[groups]`
have rows by the titles of argparse's groups. Choices that are values of enums stand in these files, so that --help need
not import the enums; tests compare both.

Before the command begins, `prepare` checks three keys of rows: `needs` begins with the option without which this one
means nothing, and goes on in words; `writes` are the endings of the file to write, `holds` the files of the folder.

Other distributions add commands by entry points; each names a module like those here, with its TOML file beside it:

    [project.entry-points."tensegrity_mj.commands"]
    audit = "evidence.commands.audit"
"""

from __future__ import annotations

import argparse
import functools
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from types import ModuleType
from typing import Any, NoReturn

from tensegrity_mj.basics.dependencies import EVIDENCE_MISSING
from tensegrity_mj.basics.files import checked, table_beside
from tensegrity_mj.basics.texts import nearest
from tensegrity_mj.commands import common, experiment
from tensegrity_mj.engines.table import ENGINES
from tensegrity_mj.errors import MissingLibraryError, OptionError

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
            if value in EVIDENCE and not self.words:
                raise MissingLibraryError(f"{value}: {EVIDENCE_MISSING}")
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
    parser = Parser(prog=PROGRAM, description=description, epilog=f"{epilog}\n\n{common.EXIT_CODES}")
    parser.add_argument("--version", action="store_true", help="print the version and exit")
    _add_commands(parser, {name: module for group in groups.values() for name, module in group.items()})
    parser.groups = {title: list(group) for title, group in groups.items()}
    return parser


def _add_commands(parser: Parser, modules: Mapping[str, ModuleType], required: bool = False) -> None:
    places = parser.add_subparsers(metavar="COMMAND", required=required)
    for name, module in modules.items():
        inner: Mapping[str, ModuleType] = getattr(module, "COMMANDS", {})
        texts = words_of(module)
        epilog = f"{texts.get('examples', '').rstrip()}\n\n{common.EXIT_CODES}".strip()
        command = places.add_parser(name, help=texts["help"], description=module.__doc__, epilog=epilog)
        parser.commands[name] = command
        if inner:
            _add_commands(command, inner, required=True)
            command.groups = {"commands": list(inner)}
            continue
        add_arguments(command, module)
        command.add_argument(
            "--json", action="store_true", help="print one JSON object on stdout; everything else goes to stderr"
        )
        command.set_defaults(command=command.words, execute=module.execute)


EVIDENCE = ("reproduce", "audit")  # commands of tensegrity-mj-evidence, which stands beside this package


@functools.cache
def commands_of_others() -> dict[str, dict[str, ModuleType]]:
    """Return commands by the names of their distributions; warn of those that cannot be imported."""
    from tensegrity_mj.basics.dependencies import installed, load

    found: dict[str, dict[str, ModuleType]] = {}
    for name, point in sorted(installed("commands").items()):
        try:
            found.setdefault(point.dist.name if point.dist else "others", {})[name] = load(point)
        except OptionError as error:
            common.warn(str(error))
    return {home: commands for home, commands in found.items() if commands}


Row = dict[str, Any]


@functools.cache
def words_of(module: ModuleType) -> dict[str, Any]:
    """Read the TOML file next to a command's module."""
    return table_beside(str(module.__file__))


def add_arguments(parser: argparse.ArgumentParser, module: ModuleType) -> None:
    """Add the arguments of a command, those of groups after the others."""
    words = words_of(module)
    places: list[tuple[Any, Sequence[Row]]] = [(parser, words.get("arguments", ()))]
    places += [(parser.add_argument_group(title), rows) for title, rows in words.get("groups", {}).items()]
    prepared: dict[str, Row] = {}
    for place, rows in places:
        for row in _expanded(rows):
            own = {key: row.pop(key) for key in ("needs", "writes", "holds") if key in row} | {"name": row["name"]}
            prepared[place.add_argument(row.pop("name"), **_settings(row, module)).dest] = own
    parser.set_defaults(prepared=prepared)


def prepare(options: argparse.Namespace) -> None:
    """Refuse options without those that they need, and make paths of files and folders that can be written."""
    values = vars(options)
    given = {key: row for key, row in options.prepared.items() if values[key] is not None and values[key] is not False}
    for row in given.values():
        needed = re.match(r"--([\w-]+)", row.get("needs", ""))
        if needed and needed[1].replace("-", "_") not in given:
            raise OptionError(f"{row['name']} needs {row['needs']}")
    for key, row in given.items():
        if "writes" in row:
            setattr(options, key, checked(values[key], row["writes"], row["name"]))
        if "holds" in row:
            setattr(options, key, common.output_folder(values[key], row["holds"]))


def _expanded(rows: Sequence[Row]) -> Iterator[Row]:
    for row in rows:
        yield from _expanded(common.SHARED[row["use"]]) if "use" in row else [dict(row)]


def _settings(row: Row, module: ModuleType) -> Row:
    """Turn a row of the file into keyword arguments of argparse."""
    row.pop("instead", None)  # for messages of `experiment`
    for key in ("choices", "several"):
        if row.get(key) == "engines":
            row[key] = list(ENGINES)
    if "several" in row:
        choices = row.pop("several")
        row |= {"nargs": "+", "choices": choices, "help": f"some of {', '.join(choices)} (default: all)"}
    if "type" in row:
        homes = (module, experiment, common)
        row["type"] = next((getattr(one, row["type"]) for one in homes if hasattr(one, row["type"])), int)
    if isinstance(row.get("metavar"), list):
        row["metavar"] = tuple(row["metavar"])
    return row
