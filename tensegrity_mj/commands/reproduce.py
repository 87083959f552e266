"""Draw the thesis' figures of chapters 3 to 7 and appendix C again, and judge what it states: the ledger."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from tensegrity_mj.commands.common import ExitCode, Outcome, add_workers, output_file

if TYPE_CHECKING:
    from tensegrity_mj.thesis.disturbance import Disturbance

HELP = "the thesis' figures again, and a ledger of what it states"
EXAMPLES = """\
examples:
  tensegrity-mj reproduce
  tensegrity-mj reproduce 3
  tensegrity-mj reproduce C
  tensegrity-mj reproduce 5.4 6.7 --out ledger/
  tensegrity-mj reproduce 5 --json
  tensegrity-mj reproduce 5 --disturb mass=1.1 --out heavier/
  tensegrity-mj reproduce 4 5 6 --sensitivity tensegrity_mj/thesis/tables/sensitivity.json --out errors/
  tensegrity-mj reproduce --table docs/reproduction.md

Writes reproduction.html (the ledger and the figures), reproduction.json, figures/ and runs/ into the folder. Runs
that are there are not computed again. Exit code 0: every row is reproduced, or differs as its table records;
1: some row differs otherwise, which is a mistake of this program until a cause is found.
"""

# The values of `EngineName`: written here so that --help need not import it (tested to agree).
ENGINES = ("dae", "mujoco", "ode", "statics")
# Those of `Quantity`, likewise.
QUANTITIES = ("mass", "stiffness", "damping", "gain", "geometry")


def configure(parser: argparse.ArgumentParser) -> None:
    """The options of `reproduce`."""
    parser.add_argument("figures", nargs="*", metavar="FIGURE", help="such as 5.4, or a chapter such as 5 or C (all)")
    parser.add_argument("--out", metavar="FOLDER", default="reproduction", help="made if absent (reproduction)")
    parser.add_argument(
        "--engine", nargs="+", choices=ENGINES, default=["dae", "mujoco", "statics"], help="(dae mujoco statics)"
    )
    add_workers(parser)
    parser.add_argument("--format", choices=("png", "svg", "pdf"), default="png", help="of the figures' files (png)")
    parser.add_argument("--no-figures", action="store_true", help="the ledger alone")
    parser.add_argument("--table", metavar="FILE.md", help="write the ledger as a Markdown table too")
    parser.add_argument(
        "--disturb",
        metavar="QUANTITY=FACTOR",
        help=f"one quantity in error, to see rows turn red: {', '.join(QUANTITIES)}",
    )
    parser.add_argument(
        "--sensitivity",
        metavar="FILE.json",
        help="instead of the ledger: which rows notice errors of 1 and 10 %%, put into this table",
    )


def execute(options: argparse.Namespace) -> Outcome:
    """Run, judge, draw and say where the files are."""
    table = output_file(options.table, "--table", (".md",))
    noticed = output_file(options.sensitivity, "--sensitivity", (".json",))
    if noticed is not None:
        return _sensitivity(options, noticed)

    from tensegrity_mj.studies.workers import Workers
    from tensegrity_mj.thesis import page
    from tensegrity_mj.thesis.experiments import TITLES, EngineName
    from tensegrity_mj.thesis.reproduction import reproduce

    engines = [EngineName(name) for name in dict.fromkeys(options.engine)]
    found = reproduce(
        options.figures,
        options.out,
        engines=engines,
        disturbance=_disturbance(options.disturb),
        workers=Workers(options.workers),
        progress=True,
        picture_format=options.format,
        draw=not options.no_figures,
    )
    if table is not None:
        page.write(table, page.markdown(found.rows))
    files = {what: str(path.absolute()) for what, path in found.files.items()}
    data = {
        "status": "unexplained" if found.unexplained else "completed",
        "disturbance": options.disturb,
        "counts": page.counts(found.rows),
        "classes": page.counts_by_class(found.rows),
        "rows": [page.row_data(row) for row in found.rows],
        "files": files,
    }
    heads = ["row", "class", "thesis", *(TITLES[engine] for engine in engines), "verdict"]
    lines = [
        [
            row.statement.id,
            row.statement.kind.value,
            row.statement.stated,
            *page.value_texts(row, engines),
            row.verdict.value,
        ]
        for row in found.rows
    ]
    text = "\n".join([_columns([heads, *lines]), "", f"{page.summary(found.rows)}.", "", f"Written: {files['page']}"])
    return Outcome(data, text, ExitCode.PROGRAM_ERROR if found.unexplained else ExitCode.SUCCESS)


def _disturbance(text: str | None) -> Disturbance | None:
    """The disturbance of QUANTITY=FACTOR.

    Raises:
        OptionError: for another text.
    """
    from tensegrity_mj.errors import OptionError
    from tensegrity_mj.thesis.disturbance import Disturbance, Quantity

    if text is None:
        return None
    name, _, factor = text.partition("=")
    try:
        chosen = Quantity(name), float(factor)
    except ValueError:
        raise OptionError(
            f"--disturb {text!r}: use QUANTITY=FACTOR, such as mass=1.1; quantities: {', '.join(QUANTITIES)}"
        ) from None
    return Disturbance(*chosen)


def _sensitivity(options: argparse.Namespace, file: Path) -> Outcome:
    """Which rows notice errors, as a table."""
    from tensegrity_mj.studies.workers import Workers
    from tensegrity_mj.thesis.sensitivity import sensitivity

    workers = Workers(options.workers)
    table = sensitivity(options.figures, options.out, file, workers=workers, progress=True)
    lines = [[name, ", ".join(f"{what} {size} %" for what, size in found.items()) or "nothing"]
             for name, found in table["rows"].items()]  # fmt: skip
    text = "\n".join([_columns([["row", "notices"], *lines]), "", f"Written: {file.absolute()}"])
    return Outcome(table, text, ExitCode.SUCCESS)


def _columns(lines: list[list[str]]) -> str:
    widths = [max(len(line[column]) for line in lines) for column in range(len(lines[0]))]
    return "\n".join("  ".join(f"{cell:<{width}}" for cell, width in zip(line, widths, strict=True)) for line in lines)
