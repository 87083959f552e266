"""Shared parts of the commands: exit codes, outcomes, and output files that are checked before work starts."""

from __future__ import annotations

import argparse
import enum
import math
import os
import sys
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tensegrity_mj.basics.files import checked, made_folder, table_beside
from tensegrity_mj.basics.seconds import Rounded, read
from tensegrity_mj.basics.texts import aligned
from tensegrity_mj.errors import OptionError, printable

if TYPE_CHECKING:
    from tensegrity_mj.pictures.findings import Finding, Judgement
    from tensegrity_mj.runs.trajectory import Status


class ExitCode(enum.IntEnum):
    """The exit codes of `tensegrity-mj`, each with one meaning in every command."""

    SUCCESS = 0
    PROGRAM_ERROR = 1
    BAD_INPUT = 2
    INFEASIBLE = 3
    DIVERGED = 4
    MISSING_LIBRARY = 5
    SINGULAR = 6
    WRONG = 7
    INTERRUPTED = 130


SHARED = table_beside(str(Path(__file__).with_name("shared")))
EXIT_CODES: str = SHARED["exit_codes"]


@dataclass(frozen=True)
class Outcome:
    """The answer of a command.

    Attributes:
        data: for --json.
        text: the answer as text.
        code: the exit code.
        notes: a line each on stderr.
        judgement: added to both data and text; its page has the same.
        warned: whether its doubts were warnings on stderr, and the verdict and other findings are left to say.
    """

    data: dict[str, Any] = field(default_factory=dict)
    text: str = ""
    code: ExitCode = ExitCode.SUCCESS
    notes: Sequence[str] = ()
    judgement: Judgement | None = None
    warned: bool = False

    @property
    def answer(self) -> dict[str, Any]:
        """Everything, for --json."""
        return self.data if self.judgement is None else {**self.data, **self.judgement.to_dict()}

    @property
    def words(self) -> str:
        """Everything as text, the judgement first."""
        if self.judgement is None:
            return self.text
        left = [one for one in self.judgement.findings if not (self.warned and is_doubt(one))]
        judged = replace(self.judgement, findings=left).lines()
        return "\n\n".join(filter(None, ["\n".join(judged), self.text]))


def code_of_status(status: Status) -> ExitCode:
    """The exit code of a run that ended with a status."""
    return ExitCode.SUCCESS if status.value == "completed" else ExitCode[status.name]


def wrote(folder: Path | None, page: str) -> tuple[str, ...]:
    """The note of a page that was written into a folder, where there is one."""
    return () if folder is None else (f"wrote {folder / page}",)


def table(rows: Sequence[tuple[str, str]]) -> str:
    """Lines of names and values, the values in one column."""
    return "\n".join(aligned(rows))


def number(value: float | None, unit: str = "") -> str:
    """Write a number as text: four digits and its unit; '-' for None and NaN."""
    if value is None or math.isnan(value):
        return "-"
    return f"{value:.4g} {unit}".rstrip()


def warn(text: str) -> None:
    """Print a warning on stderr."""
    print(f"warning: {printable(text)}", file=sys.stderr)


def is_doubt(finding: Finding) -> bool:
    """Return whether a finding speaks against a run, as its warnings do."""
    return finding.mark is not None and finding.mark.value == "limited"


def warn_of_findings(judgement: Judgement, simulated: bool) -> None:
    """Print doubts about runs as warnings; of runs simulated just now, those that `simulate` has not warned of."""
    from tensegrity_mj.runs.judgement import is_of_the_step

    for finding in judgement.findings:
        if is_doubt(finding) and not (simulated and is_of_the_step(finding.text)):
            warn(finding.text)


def output_folder(path: str | os.PathLike[str], files: Sequence[str]) -> Path:
    """The folder of --out, made if it is absent, once it is certain that these files can be written in it.

    Raises:
        OptionError: as `basics.files.checked`, or where no folder can be made.
    """
    folder = made_folder(path)
    for file in files:
        checked(folder / file, (Path(file).suffix,), "--out")
    return folder


def for_paper(width: str | None) -> AbstractContextManager[None]:
    """Context in which plots are as wide as a paper's "column" or "page"; with None, for the screen."""
    if width is None:
        return nullcontext()
    from tensegrity_mj.pictures.figure import paper

    return paper(1 if width == "column" else 2)


def distinct(outputs: Mapping[str, Path | None]) -> None:
    """Refuse two options that would write, or read and write, the same file, with an OptionError that names both."""
    seen: dict[Path, str] = {}
    for option, path in outputs.items():
        if path is None:
            continue
        place = path.resolve()
        if place in seen:
            raise OptionError(f"{seen[place]} and {option} both name {path}; give them different files")
        seen[place] = option


def refuse(options: argparse.Namespace, names: Sequence[str], why: str) -> None:
    """Refuse options that mean nothing here, with an OptionError that names the first of them and why."""
    for name in names:
        if getattr(options, name.replace("-", "_")) is not None:
            raise OptionError(f"--{name} {why}")


def whole(text: str, most: int) -> int:
    """argparse type, with `most`: a whole number > 0."""
    if not text.isascii() or not text.isdigit() or not 1 <= int(text) <= most:
        raise argparse.ArgumentTypeError(f"{text!r}: write a whole number from 1 to {most}")
    return int(text)


def finite(text: str, bound: str = "") -> float:
    """argparse type: a finite number; with a bound, "> 0" or ">= 0", one within it."""
    try:
        value = float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"{text!r} is no number; write one such as 0.5 or 1e-3, without a unit"
        ) from None
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text}: it must be finite")
    if bound and not (value > 0 or (value == 0 and bound == ">= 0")):
        raise argparse.ArgumentTypeError(f"{text}: it must be {bound}")
    return value


def seconds(text: str) -> Rounded:
    """argparse type: a time > 0 [s], a number or a quotient such as 1/4800."""
    value = read(text)
    if not isinstance(value, Rounded):
        positive(text)  # which says what it is not
    if not 0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"{text}: it must be > 0")
    return value


positive, not_negative = partial(finite, bound="> 0"), partial(finite, bound=">= 0")


def size(text: str) -> tuple[int, int]:
    """argparse type: a picture size such as 1280x720, both even (mp4 needs it) and at most 4096."""
    parts = text.lower().split("x")
    if len(parts) != 2 or not all(part.isascii() and part.isdigit() for part in parts):
        raise argparse.ArgumentTypeError(f"{text!r}: write WIDTHxHEIGHT, for example 1280x720")
    width, height = (int(part) for part in parts)
    for value in (width, height):
        if not 16 <= value <= 4096 or value % 2:
            raise argparse.ArgumentTypeError(f"{text}: width and height must be even, from 16 to 4096")
    return width, height
