"""Make seeded random runs at the extremes, and judge each: right, refused, stopped, or wrong without a warning."""

from __future__ import annotations

import argparse
import sys

from tensegrity_mj.commands.common import ExitCode, Outcome, add_several, add_workers

HELP = "random extreme runs: is any of them wrong without a warning?"
EXAMPLES = """\
examples:
  tensegrity-mj audit extremes --runs 1000 --seed 0 --out extremes
  tensegrity-mj audit extremes --runs 50 --kinds stiff slack past_limit
  tensegrity-mj audit extremes --runs 60 --kinds past_limit bad_law --autoreset  # here failures must show
"""

# As in studies.extremes.experiment.Kind: written here so that --help need not import it (tested to agree).
KINDS = (
    "stiff",
    "slack",
    "no_prestress",
    "negative_rest",
    "vanishing",
    "pole",
    "degenerate",
    "contrast",
    "bad_law",
    "wild_law",
    "infeasible",
    "past_limit",
    "spin",
    "joined",
    "moved",
    "resisted",
    "contact",
    "large",
    "long",
)


def configure(parser: argparse.ArgumentParser) -> None:
    """The options of `audit extremes`."""
    parser.add_argument("--runs", type=int, metavar="N", default=1000, help="how many (1000)")
    parser.add_argument("--seed", type=int, metavar="N", default=0, help="of everything random (0)")
    add_several(parser, "--kinds", KINDS, "KIND")
    add_workers(parser)
    parser.add_argument(
        "--autoreset",
        action="store_true",
        help="the test of the test: step MuJoCo as a script of one's own would, with its autoreset on and no check; "
        "failures that nobody detects must then be counted",
    )
    parser.add_argument(
        "--out", metavar="FOLDER", help="write extremes.json and extremes.html there; go on there if interrupted"
    )


def execute(options: argparse.Namespace) -> Outcome:
    """Run the study; exit code 1 where its demands are not met."""
    from tensegrity_mj.studies.extremes.experiment import Kind
    from tensegrity_mj.studies.extremes.study import PAGE, extremes
    from tensegrity_mj.studies.workers import Workers

    report = extremes(
        options.runs,
        options.seed,
        kinds=None if options.kinds is None else [Kind[name.upper()] for name in options.kinds],
        autoreset=options.autoreset,
        folder=options.out,
        workers=None if options.workers is None else Workers(options.workers),
        progress=True,
    )
    if report.folder is not None:
        print(f"wrote {report.folder / PAGE}", file=sys.stderr)
    # Parts of the demands are meant for the whole mixture only: nothing undetected holds for any part.
    undetected = report.data["table"][-1]["undetected"]
    passed = report.passed if options.kinds is None else undetected == 0
    code = ExitCode.SUCCESS if passed or options.autoreset else ExitCode.PROGRAM_ERROR
    return Outcome(report.data | {"timing": {"seconds": report.seconds}}, report.text, code)
