"""The words that a command's option takes, as its parser has them."""

from __future__ import annotations

from tensegrity_mj.cli import build_parser


def choices_of(command: str, option: str) -> list[str]:
    """Those of an option, such as "audit drift" and "--methods"."""
    parser = build_parser()
    for word in command.split():
        parser = parser.commands[word]
    return list(parser._option_string_actions[option].choices or ())
