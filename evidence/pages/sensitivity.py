"""Find which errors the ledger's numbers and statements notice: evidence/thesis/tables/sensitivity.json.

    .venv/bin/python -m evidence.pages.sensitivity 4 5 6 --out errors/  # or figures; all by default

Plants (or laws) in error are judged again; runs that are in the folder are not computed again. A row notices an error
if its verdict is another one then: what was reproduced differs, what differs leaves the recorded difference, or its
runs stop. Each error is tried in both directions, in the DAE, or in statics.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from evidence.thesis.catalog import selected
from evidence.thesis.chapter3.series import SERIES
from evidence.thesis.disturbance import Disturbance, Quantity, disturbed
from evidence.thesis.experiments import EXPERIMENTS, EngineName
from evidence.thesis.ledger import Verdict, judge
from evidence.thesis.reproduction import RUNS, WHOLES, compute_runs
from evidence.thesis.runs import Computed
from evidence.thesis.statement import Statement
from evidence.thesis.tables import SENSITIVITY
from tensegrity_mj.basics.files import made_folder, write_text
from tensegrity_mj.studies.workers import Workers

SIZES = (10, 1)  # %
ENGINES = (EngineName.DAE, EngineName.STATICS)
OF_STATICS = (Quantity.STIFFNESS, Quantity.GEOMETRY)  # what an equilibrium has


def evidence(statements: Sequence[Statement]) -> list[Statement]:
    """The rows that are tried: numbers and statements that are judged, of runs."""
    return [one for one in statements if one.kind.is_evidence and not one.unjudged and one.needs]


def applies(name: str, quantity: Quantity) -> bool:
    """Return whether an experiment, a series or a study has the quantity that would be in error."""
    slight = Disturbance(quantity, 1.01)
    if name in EXPERIMENTS:
        scene = EXPERIMENTS[name].load()
        return quantity is Quantity.GAIN or (
            # The law sets u: what follows from it hangs on no stiffness, u = k (1 - L0/L) being solved for L0.
            quantity is not Quantity.STIFFNESS and disturbed(scene, slight) is not scene
        )
    if name in SERIES:
        return quantity in (Quantity.MASS, Quantity.GEOMETRY)
    if EngineName.STATICS in WHOLES[name].engines:
        return quantity in OF_STATICS
    return quantity is not Quantity.GAIN


def sensitivity(
    figures: Sequence[str],
    out: str | Path,
    file: Path,
    *,
    sizes: Sequence[int] = SIZES,
    workers: Workers | None = None,
    progress: bool = False,
) -> dict[str, Any]:
    """Try all errors on the rows of these figures or chapters, and put what they notice into the table.

    Args:
        out: folder of the runs; those that are there are not computed again.
        file: the table, JSON; rows of it that are not tried stay.

    Returns:
        The table.

    Raises:
        OptionError: an unknown figure, or a folder that cannot be used.
        KeyboardInterrupt: runs that are finished are kept.
    """
    rows = evidence(selected(figures)[1])
    folder = made_folder(out)
    names = list(dict.fromkeys(name for row in rows for name in row.needs))
    how: dict[str, Any] = {"workers": workers, "progress": progress}
    usual = compute_runs(names, ENGINES, made_folder(folder / RUNS), **how)
    before = _verdicts(rows, usual)
    found: dict[str, dict[str, int]] = {row.id: {} for row in rows if row.id in before}
    for quantity in Quantity:
        changed = [name for name in names if applies(name, quantity)]
        for size in sorted(sizes, reverse=True) if changed else ():
            for factor in (1.0 + size / 100.0, 1.0 - size / 100.0):
                place = made_folder(folder / f"{quantity.value}-{factor:g}" / RUNS)
                other = compute_runs(changed, ENGINES, place, disturbance=Disturbance(quantity, factor), **how)
                after = _verdicts(rows, _merged(usual, other))
                for name in found:
                    if after.get(name) is not before[name]:
                        found[name][quantity.value] = size
    table = json.loads(file.read_text(encoding="utf-8")) if file.is_file() else {"rows": {}}
    table["rows"] |= found
    table["sizes"] = list(SIZES)
    order = {row.id: number for number, row in enumerate(selected(())[1])}
    table["rows"] = {name: table["rows"][name] for name in sorted(table["rows"], key=lambda one: order.get(one, -1))
                     if name in order}  # fmt: skip
    write_text(file, json.dumps(table, ensure_ascii=False, indent=1) + "\n")
    return dict(table)


def _verdicts(rows: Sequence[Statement], computed: Computed) -> Mapping[str, Verdict]:
    return {one.statement.id: one.verdict for one in judge(rows, computed) if one.verdict is not Verdict.UNJUDGED}


def _merged(usual: Computed, other: Computed) -> Computed:
    """The runs in error, and the usual ones where nothing is in error."""
    lost = {(engine, name) for engine, name in other.failures}
    runs = {
        engine: {name: run for name, run in {**own, **other.runs.get(engine, {})}.items() if (engine, name) not in lost}
        for engine, own in usual.runs.items()
    }
    return Computed(runs, {**usual.failures, **other.failures})


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("figures", nargs="*", metavar="FIGURE", help="such as 5.4, or a chapter such as 5 or C (all)")
    parser.add_argument("--out", metavar="FOLDER", default="reproduction", help="of the runs (reproduction)")
    parser.add_argument("--workers", type=int, metavar="N", help="runs at a time (all cores)")
    given = parser.parse_args()
    table = sensitivity(given.figures, given.out, SENSITIVITY, workers=Workers(given.workers), progress=True)
    for name, found in table["rows"].items():
        print(f"{name}: {', '.join(f'{what} {size} %' for what, size in found.items()) or 'nothing'}")
