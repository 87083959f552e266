"""`reproduce`: run what the thesis ran, draw its figures again, and judge what it states."""

from __future__ import annotations

import io
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Unpack

import numpy as np

from evidence.thesis import page
from evidence.thesis.appendix_c.beams import STUDIES
from evidence.thesis.catalog import selected
from evidence.thesis.chapter3.series import SERIES
from evidence.thesis.disturbance import Disturbance
from evidence.thesis.drawing import ThesisFigure
from evidence.thesis.experiments import OF_MOTION, EngineName, experiment_of
from evidence.thesis.ledger import Row, Verdict, judge
from evidence.thesis.runs import Computed, run_experiments
from tensegrity_mj.basics.files import made_folder, write_text
from tensegrity_mj.basics.jsontext import to_json
from tensegrity_mj.errors import OptionError, TensegrityError
from tensegrity_mj.pictures.figure import save_figure
from tensegrity_mj.runs.comparison import compare
from tensegrity_mj.runs.trajectory import Trajectory
from tensegrity_mj.studies.many import RunOptions
from tensegrity_mj.studies.workers import Workers

RUNS, FIGURES = "runs", "figures"
# Studies that are computed as wholes: the cables of chapter 3, the beams of chapter 7, in waves too, and of appendix C.
WHOLES: Mapping[str, Any] = {
    **SERIES,
    **STUDIES,
}
PAGE, DATA = "reproduction.html", "reproduction.json"


@dataclass(frozen=True, eq=False)
class Reproduction:
    """Result of a reproduction.

    Attributes:
        rows: a row for each statement.
        computed: the runs.
        files: the page, the data and the figures by number.
    """

    rows: list[Row]
    computed: Computed
    files: dict[str, Path]

    @property
    def unexplained(self) -> list[Row]:
        """The rows that differ otherwise than their tables record."""
        return [row for row in self.rows if row.verdict is Verdict.UNEXPLAINED]


def reproduce(
    figures: Sequence[str] = (),
    out: str | Path = "reproduction",
    *,
    engines: Sequence[EngineName] = (EngineName.DAE, EngineName.MUJOCO, EngineName.STATICS),
    disturbance: Disturbance | None = None,
    workers: Workers | None = None,
    progress: bool = False,
    picture_format: str = "png",
    draw: bool = True,
) -> Reproduction:
    """Run, judge and draw; a second call in the same folder computes only what is missing.

    Args:
        figures: numbers of figures or chapters; all where none is given.
        out: folder, made if absent: reproduction.html, reproduction.json, figures/ and runs/.
        engines: the columns of the ledger, each with the rows that it computes; figures of motions show the
            first as lines and the second as circles.
        disturbance: one quantity of the plant, or the gain of the law, is in error: a check that rows can turn red.
        picture_format: of the figures' files: png, svg or pdf (the page always holds PNG).
        draw: False for the ledger alone.

    Raises:
        OptionError: an unknown figure, no engine or none that computes the figures, or a folder that cannot be used.
        KeyboardInterrupt: what is finished is kept.
    """
    chosen, statements = selected(figures)
    if not engines:
        raise OptionError(f"engines: none was given; choose of {', '.join(one.value for one in EngineName)}")
    statements = [one for one in statements if set(one.columns) & set(engines)]
    if not statements:
        raise OptionError(
            f"engines: none of {', '.join(one.value for one in engines)} computes {', '.join(figures)}; motions "
            "are computed in dae, mujoco and ode, equilibria (in chapters 7 and C) in statics and mujoco"
        )
    folder = made_folder(out)
    drawn_needs = [name for figure in chosen for name in figure.needs] if draw else []
    names = list(dict.fromkeys([*drawn_needs, *(name for one in statements for name in one.needs)]))
    place = made_folder(folder / RUNS)
    computed = compute_runs(names, engines, place, disturbance, workers=workers, progress=progress)
    rows = judge(statements, computed)
    files: dict[str, Path] = {}
    pictures: list[tuple[ThesisFigure, bytes]] = []
    if draw:
        place = made_folder(folder / FIGURES)
        for figure in chosen:
            # The first engine that is drawn has all that is needed: the DAE alone computes some series of chapter 3.
            # Where statics is chosen, MuJoCo has only what confirms it.
            ranked = sorted(engines, key=lambda one: one is not EngineName.STATICS)
            able = [one for one in ranked if all(name in computed.runs[one] for name in figure.needs)]
            if not able or (able[0] is not engines[0] and not set(figure.needs) <= set(WHOLES)):
                continue  # its rows say why
            others = [one for one in ranked if any(name in computed.runs[one] for name in figure.needs)]
            order = [able[0], *(one for one in others if one is not able[0])]
            canvas = figure.draw({one: computed.runs[one] for one in order})
            path = save_figure(canvas, place / f"figure-{figure.number}.{picture_format}")
            files[figure.number] = path
            pictures.append((figure, _png(canvas, path)))
    moving = [one for one in engines if one in OF_MOTION]
    runs = _run_lines([name for name in names if name not in WHOLES], moving, computed)
    runs += _run_lines([name for name in names if name in WHOLES], engines, computed)
    note = "" if disturbance is None else f"In error: {disturbance}."
    write_text(folder / PAGE, page.html(rows, engines, pictures, runs, note))
    data = {
        "thesis": page.THESIS,
        "disturbance": None if disturbance is None else disturbance.plain,
        "counts": page.counts(rows),
        "classes": page.counts_by_class(rows),
        "rows": [page.row_data(row) for row in rows],
        "runs": runs,
        "figures": {figure.number: {"page": figure.page, "title": figure.title} for figure in chosen},
    }
    write_text(folder / DATA, to_json(data, indent=1) + "\n")
    return Reproduction(rows, computed, {"page": folder / PAGE, "data": folder / DATA, **files})


def compute_runs(
    names: Sequence[str],
    engines: Sequence[EngineName],
    place: Path,
    disturbance: Disturbance | None = None,
    **how: Unpack[RunOptions],
) -> Computed:
    """The experiments, series and studies of these names in those of the engines that compute them.

    Args:
        place: folder, exists; what it has is not computed again.
        how: workers and progress, see `run_many`.
    """
    moving = [one for one in engines if one in OF_MOTION]
    computed = run_experiments([name for name in names if name not in WHOLES], moving, place, disturbance, **how)
    runs: dict[EngineName, dict[str, Any]] = {engine: {**computed.runs.get(engine, {})} for engine in engines}
    failures = dict(computed.failures)
    able = [(WHOLES[name], one) for name in names if name in WHOLES for one in engines if one in WHOLES[name].engines]
    for whole, engine in able:
        try:
            started, how["label"] = time.perf_counter(), f"{whole.name}, {engine.value}"
            found = whole.compute(engine, place, disturbance, **how)
            runs[engine][whole.name] = replace(found, cost={"wall_time": time.perf_counter() - started})
        except OptionError:
            raise
        except TensegrityError as error:
            failures[engine, whole.name] = str(error)
    return Computed(runs, failures)


def _run_lines(names: Sequence[str], engines: Sequence[EngineName], computed: Computed) -> list[dict[str, Any]]:
    """A line for each run, series or study, with how far nodes or amplitudes are from those of the first engine."""
    lines = []
    for name in names:
        whole = WHOLES.get(name)
        first = computed.runs[engines[0]].get(name)
        for engine in (one for one in engines if whole is None or one in whole.engines):
            run = computed.runs[engine].get(name)
            missing = computed.failures.get((engine, name), "not run")
            ended = "completed" if whole is not None or run is None else run.status.value
            lines.append(
                {
                    "experiment": name,
                    "about": (experiment_of(name) if whole is None else whole).about,
                    "engine": engine.value if whole is not None or run is None else run.engine,
                    "status": missing if run is None else ended,
                    "wall time [s]": None if run is None else run.cost.get("wall_time"),
                    "from the first engine [m]": _apart(run, first),
                }
            )
    return lines


def _apart(run: Any, first: Any) -> float | None:
    """Return the distance of a run from that of the first engine [m]; None where there is nothing to compare."""
    if run is None or first is None or run is first:
        return None
    if not isinstance(run, Trajectory):
        return None if run.results is None else float(np.nanmax(np.abs(run.cases.amplitudes - first.cases.amplitudes)))
    try:
        found = compare(run, first).max_node_error
    except TensegrityError:  # one of them stopped before there was anything to compare
        return None
    return None if np.isnan(found) else found


def _png(canvas: Any, path: Path) -> bytes:
    if path.suffix == ".png":
        return path.read_bytes()
    buffer = io.BytesIO()
    canvas.savefig(buffer, format="png", dpi=110)
    return buffer.getvalue()
