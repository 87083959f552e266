# PYTHON_ARGCOMPLETE_OK
"""The command line `tensegrity-mj`: arguments in, exit code out. Every command is a module of `commands`."""

from __future__ import annotations

import argparse
import contextlib
import errno
import os
import sys
import traceback
import warnings
from collections.abc import Iterator, Sequence
from typing import Any

from tensegrity_mj import errors
from tensegrity_mj.basics.dependencies import distribution_of
from tensegrity_mj.basics.jsontext import to_json
from tensegrity_mj.commands import (
    clearance,
    compare,
    demo,
    doctor,
    export,
    identify,
    import_scene,
    linearize,
    render,
    run,
    scenes,
    stability,
    statics,
    sweep,
    tradeoff,
    validate,
    view,
)
from tensegrity_mj.commands.common import ExitCode, Outcome, warn
from tensegrity_mj.commands.parser import Groups, Parser, UsageError, build, commands_of_others, prepare

GROUPS: Groups = {
    "simulate and see": {
        "run": run,
        "compare": compare,
        "view": view,
        "render": render,
        "import": import_scene,
        "export": export,
    },
    "analyse": {"statics": statics, "linearize": linearize, "stability": stability, "clearance": clearance},
    "many runs": {"sweep": sweep, "identify": identify, "tradeoff": tradeoff, "validate": validate},
    "scenes and installation": {"scenes": scenes, "doctor": doctor, "demo": demo},
}
DESCRIPTION = "Simulate tensegrity structures in MuJoCo and in an independent reference model, and compare them."
EPILOG = "example:\n  tensegrity-mj run prism --out prism.nc --video prism.mp4\n\nSI units and radians everywhere."


def build_parser(arguments: Sequence[str] = ()) -> Parser:
    """Make the parser of the whole command line; that of arguments which begin with an own command has no others."""
    first = next((word for word in arguments if not word.startswith("-")), "")
    own = any(first in group for group in GROUPS.values())
    return build(GROUPS if own else {**GROUPS, **commands_of_others()}, DESCRIPTION, EPILOG)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code."""
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    as_json = "--json" in arguments
    try:
        parser = build_parser(arguments)
        if "_ARGCOMPLETE" in os.environ:
            from tensegrity_mj.commands.completion import complete

            complete(parser)
        options = parser.parse_args(arguments)
        if options.version:
            from importlib.metadata import version

            return int(ExitCode.SUCCESS if _print(version("tensegrity-mj")) else ExitCode.BAD_INPUT)
        if not hasattr(options, "execute"):
            parser.error(f"name a command: {', '.join(parser.commands)}")
        with _stdout_to_stderr(), _warnings_in_one_line():
            outcome = _executed(options)
            print(*map(errors.printable, outcome.notes), sep="\n", end="\n" if outcome.notes else "")
        answer = to_json(outcome.answer) if as_json else errors.printable(outcome.words, keep="\n")
    except UsageError as error:
        return _fail(ExitCode.BAD_INPUT, str(error), as_json)
    except errors.TensegrityError as error:
        return _fail(_code_of_error(error), str(error), as_json)
    except OSError as error:
        return _fail(ExitCode.BAD_INPUT, f"a file or a folder could not be used: {error}", as_json)
    except KeyboardInterrupt as interrupt:  # whose message says what is kept
        return _fail(ExitCode.INTERRUPTED, f"interrupted: {interrupt}".removesuffix(": "), as_json)
    except Exception as error:
        name = error.name or "" if isinstance(error, ModuleNotFoundError) else ""
        if name and name.partition(".")[0] != "tensegrity_mj":
            remedy = f"install it with python -m pip install {distribution_of(name)}"
            message = f"the Python package '{name}' is missing: {remedy}"
            return _fail(ExitCode.MISSING_LIBRARY, message, as_json)
        *_, (frame, _) = traceback.walk_tb(error.__traceback__)
        package = str(frame.f_globals.get("__name__", "")).partition(".")[0]
        if isinstance(error, ImportError) and not name and package != "tensegrity_mj":
            remedy = "tensegrity-mj doctor names what is wrong with the packages"
            message = f"the Python package '{package}' cannot be imported ({error}): {remedy}"
            return _fail(ExitCode.MISSING_LIBRARY, message, as_json)
        # A mistake of ours: Python prints its traceback, but who requested JSON gets an answer too.
        if not as_json:
            raise
        traceback.print_exc()
        return _fail(ExitCode.PROGRAM_ERROR, f"{type(error).__name__}: {error}", as_json)
    return int(outcome.code) if _print(answer) else int(ExitCode.BAD_INPUT)


def _code_of_error(error: errors.TensegrityError) -> ExitCode:
    kinds = {
        errors.InfeasibleError: ExitCode.INFEASIBLE,
        errors.DivergenceError: ExitCode.DIVERGED,
        errors.MissingLibraryError: ExitCode.MISSING_LIBRARY,
    }
    return next((code for kind, code in kinds.items() if isinstance(error, kind)), ExitCode.BAD_INPUT)


_STATUSES = (ExitCode.INFEASIBLE, ExitCode.DIVERGED, ExitCode.INTERRUPTED)


def _fail(code: ExitCode, message: str, as_json: bool) -> int:
    message = errors.printable_message(message)
    print(f"tensegrity-mj: {message}", file=sys.stderr)
    if as_json:
        _print(to_json({"status": code.name.lower() if code in _STATUSES else "error", "error": message}))
    return int(code)


def _print(text: str) -> bool:
    """Print on stdout, or report on stderr why that fails; a reader that went away (`| head`) is no error of ours."""
    try:
        if sys.stdout is None:
            raise OSError(errno.EBADF, "it is closed")
        print(text)
        sys.stdout.flush()
    except OSError as error:
        if sys.stdout is not None:  # else Python tries again as it ends
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if isinstance(error, BrokenPipeError):
            return True
        print(
            f"tensegrity-mj: the answer cannot be printed on stdout ({error.strerror}); the work is done, and the "
            "files that were named are written: send stdout to a place that takes it",
            file=sys.stderr,
        )
        return False
    return True


def _executed(options: argparse.Namespace) -> Outcome:
    """Run the command; OptionError where a law exits, whose code would be taken for the command's."""
    prepare(options)
    try:
        outcome: Outcome = options.execute(options)
    except SystemExit as leaving:
        raise errors.OptionError(f"a law, or what else the command runs, exits: SystemExit: {leaving}") from None
    return outcome


@contextlib.contextmanager
def _stdout_to_stderr() -> Iterator[None]:
    """Send what libraries and child processes print to stderr: stdout is for the answer alone."""
    try:
        kept = os.dup(1)
    except OSError:  # stdout is closed
        kept = None
    try:
        if kept is not None:
            os.dup2(2, 1)
        with contextlib.redirect_stdout(sys.stderr):
            yield
    finally:
        if kept is not None:
            os.dup2(kept, 1)
            os.close(kept)


@contextlib.contextmanager
def _warnings_in_one_line() -> Iterator[None]:
    """Print warnings of steps and fits as `warn` does: Python would add the path and the line of our code."""
    with warnings.catch_warnings():
        usual = warnings.showwarning

        def show(message: Warning | str, category: type[Warning], *place: Any, **more: Any) -> None:
            if issubclass(category, (errors.StabilityWarning, errors.IdentificationWarning)):
                warn(str(message))
            else:
                usual(message, category, *place, **more)

        warnings.showwarning = show
        yield


if __name__ == "__main__":
    sys.exit(main())
