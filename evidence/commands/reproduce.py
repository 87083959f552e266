"""Draw the thesis' figures of chapters 3 to 7 and appendix C again, and judge what it states: the ledger."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from tensegrity_mj import studies
from tensegrity_mj.basics.texts import aligned
from tensegrity_mj.commands.common import ExitCode, Outcome
from tensegrity_mj.pictures.findings import Judgement

if TYPE_CHECKING:
    from evidence.thesis.disturbance import Disturbance


def execute(options: argparse.Namespace) -> Outcome:
    """Run, judge, draw and say where the files are."""
    from evidence.thesis import page
    from evidence.thesis.experiments import TITLES, EngineName
    from evidence.thesis.reproduction import reproduce

    engines = [EngineName(name) for name in dict.fromkeys(options.engine)]
    found = reproduce(
        options.figures,
        options.out,
        engines=engines,
        disturbance=_disturbance(options.disturb),
        workers=studies.Workers(options.workers),
        progress=True,
        picture_format=options.format,
        draw=not options.no_figures,
    )
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
    text = "\n".join([*aligned([heads, *lines]), "", f"Written: {files['page']}"])
    code = ExitCode.PROGRAM_ERROR if found.unexplained else ExitCode.SUCCESS
    return Outcome(data, text, code, judgement=Judgement(f"{page.summary(found.rows)}."))


def _disturbance(text: str | None) -> Disturbance | None:
    """The disturbance of QUANTITY=FACTOR.

    Raises:
        OptionError: for another text.
    """
    from evidence.thesis.disturbance import Disturbance, Quantity
    from tensegrity_mj.errors import OptionError

    if text is None:
        return None
    name, _, factor = text.partition("=")
    try:
        chosen = Quantity(name), float(factor)
    except ValueError:
        known = ", ".join(one.value for one in Quantity)
        raise OptionError(f"--disturb {text!r}: use QUANTITY=FACTOR, such as mass=1.1; quantities: {known}") from None
    return Disturbance(*chosen)
