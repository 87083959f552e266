"""Draw the thesis' figures of chapters 3 to 7 and appendix C again, and judge what it states: the ledger."""

from __future__ import annotations

import argparse

from tensegrity_mj.commands.common import ExitCode, Outcome, output_file, positive

HELP = "the thesis' figures again, and a ledger of what it states"
EXAMPLES = """\
examples:
  tensegrity-mj reproduce
  tensegrity-mj reproduce 3
  tensegrity-mj reproduce C
  tensegrity-mj reproduce 5.4 6.7 --out ledger/
  tensegrity-mj reproduce 5 --json
  tensegrity-mj reproduce 5 --mass-scale 1.1 --out heavier/
  tensegrity-mj reproduce --table docs/reproduction.md

Writes reproduction.html (the ledger and the figures), reproduction.json, figures/ and runs/ into the folder. Runs
that are there are not computed again. Exit code 0: every row is reproduced, or differs for the cause that is known;
1: some row differs without a known cause, which is a mistake of this program until a cause is found.
"""

# The values of `EngineName`: written here so that --help need not import it (tested to agree).
ENGINES = ("dae", "mujoco", "ode", "statics")


def configure(parser: argparse.ArgumentParser) -> None:
    """The options of `reproduce`."""
    parser.add_argument("figures", nargs="*", metavar="FIGURE", help="such as 5.4, or a chapter such as 5 or C (all)")
    parser.add_argument("--out", metavar="FOLDER", default="reproduction", help="made if absent (reproduction)")
    parser.add_argument(
        "--engine", nargs="+", choices=ENGINES, default=["dae", "mujoco", "statics"], help="(dae mujoco statics)"
    )
    parser.add_argument("--workers", type=int, metavar="N", help="runs at a time (all cores)")
    parser.add_argument("--format", choices=("png", "svg", "pdf"), default="png", help="of the figures' files (png)")
    parser.add_argument("--no-figures", action="store_true", help="the ledger alone")
    parser.add_argument("--table", metavar="FILE.md", help="write the ledger as a Markdown table too")
    parser.add_argument(
        "--mass-scale",
        type=positive,
        default=1.0,
        metavar="X",
        help="the plant's rods are X times as heavy as the laws believe, to see rows turn red (1)",
    )


def execute(options: argparse.Namespace) -> Outcome:
    """Run, judge, draw and say where the files are."""
    table = output_file(options.table, "--table", (".md",))

    from tensegrity_mj.reproduction import page
    from tensegrity_mj.reproduction.experiments import TITLES, EngineName
    from tensegrity_mj.reproduction.reproduce import reproduce
    from tensegrity_mj.studies.workers import Workers

    engines = [EngineName(name) for name in dict.fromkeys(options.engine)]
    found = reproduce(
        options.figures,
        options.out,
        engines=engines,
        mass_scale=options.mass_scale,
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
        "mass_scale": options.mass_scale,
        "counts": page.counts(found.rows),
        "rows": [page.row_data(row) for row in found.rows],
        "files": files,
    }
    heads = ["row", "thesis", *(TITLES[engine] for engine in engines), "verdict"]
    lines = [
        [
            row.statement.id,
            row.statement.stated,
            *page.value_texts(row, engines),
            row.verdict.value,
        ]
        for row in found.rows
    ]
    text = "\n".join([_columns([heads, *lines]), "", f"{page.summary(found.rows)}.", "", f"Written: {files['page']}"])
    return Outcome(data, text, ExitCode.PROGRAM_ERROR if found.unexplained else ExitCode.SUCCESS)


def _columns(lines: list[list[str]]) -> str:
    widths = [max(len(line[column]) for line in lines) for column in range(len(lines[0]))]
    return "\n".join("  ".join(f"{cell:<{width}}" for cell, width in zip(line, widths, strict=True)) for line in lines)
