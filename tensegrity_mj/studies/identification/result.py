"""`identify`: parameters of a scene from measurements; and what it returns."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tensegrity_mj.basics import checks, texts, units
from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.controllers.scenes import SCENE_LAW, law_for
from tensegrity_mj.controllers.specs import spec_of
from tensegrity_mj.engines.table import checked_engine, engine_settings
from tensegrity_mj.errors import printable
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.text.writing import scene_to_toml
from tensegrity_mj.pictures import palette
from tensegrity_mj.pictures.figure import COLUMN, ROW, Figure, frame, grid_of_panels, new_figure
from tensegrity_mj.pictures.findings import Finding, Judgement, Mark
from tensegrity_mj.pictures.page import Picture, Table, pictures_and_tables
from tensegrity_mj.runs.judgement import in_short
from tensegrity_mj.simulation import versions
from tensegrity_mj.studies.identification.fitting import FitOptions, Problem, fit
from tensegrity_mj.studies.identification.measurements import Observation
from tensegrity_mj.studies.identification.predictions import StoredPredictions, predictions_of
from tensegrity_mj.studies.identification.unknowns import Parameter, Unknowns
from tensegrity_mj.studies.plain import digest, plain
from tensegrity_mj.studies.report import Page, Report, runs_in
from tensegrity_mj.studies.store import opened


@dataclass(frozen=True, eq=False, repr=False)
class Identification(Report):
    """Parameters that were found, and how well they are known: `data` has everything, as plain values.

    Attributes:
        scene: with the values that were found.
    """

    scene: Scene = field(kw_only=True)

    NAME = "identification"

    @property
    def values(self) -> dict[str, float]:
        """The estimates by their paths."""
        return {row["path"]: row["value"] for row in self.data["parameters"]}

    @property
    def intervals(self) -> dict[str, tuple[float, float]]:
        """The intervals of confidence by paths; NaN of what was held or is at its bound."""
        return {row["path"]: (row["low"], row["high"]) for row in self.data["parameters"]}

    @property
    def correlation(self) -> Array:
        """(K, K) of the parameters `data["correlated"]`."""
        return np.array(self.data["correlation"], float)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values, for JSON."""
        return self.data

    @property
    def judgement(self) -> Judgement:
        """Judgement of how the fit ended, and of what it leaves undetermined."""
        return judgement_of(self.data)

    def page(self) -> Page:
        """Measured against fitted, intervals, information and residuals."""
        data = self.data
        level = f"{data['level']:.3g}"
        heads = {"name": "parameter", "start": "start", "value": "estimate", "deviation": "standard deviation"}
        heads |= {"low": f"interval of {level} from", "high": "to", "note": ""}
        matrix = [[name, *row] for name, row in zip(data["correlated"], data["correlation"], strict=True)]
        tables = [
            Table.of("Parameters", heads, data["parameters"]),
            Table("Correlation of the estimates", ["", *data["correlated"]], matrix, folded=True),
        ]
        pictures = [
            Picture(_fitted(data), "Measured (dots) and fitted (lines): the series that move most."),
            Picture(
                _information_figure(data),
                f"Intervals of {level} confidence, starts as crosses; information by parameters in parts of their "
                "starts, before and after the fit; what is left, of which 95 % are within the dashed lines where it is "
                "white.",
            ),
        ]
        sections = pictures_and_tables(pictures, tables)
        return Page(f"Identification of {data['scene']}", data["source"], judgement_of(data), sections)

    def __repr__(self) -> str:
        return printable("\n".join([*self.judgement.lines(), "", *self.table()]), "\n")

    def table(self) -> list[str]:
        """The lines of the estimates, for a terminal."""
        heads = ("parameter", "start", "estimate", f"interval of {self.data['level']:.3g}", "")
        rows = []
        for row in self.data["parameters"]:
            interval = "{low:.6g} to {high:.6g}" if np.isfinite(row["deviation"]) else "none"
            forms = ("{name}", "{start:.6g}", "{value:.6g}", interval, "{note}")
            rows.append([form.format(**row) for form in forms])
        return texts.aligned([heads, *rows])


def identify(
    scene: Scene,
    measurements: Any,
    parameters: Iterable[Parameter | str],
    engine: Any = None,
    *,
    law: Any = SCENE_LAW,
    options: FitOptions | None = None,
    folder: str | os.PathLike[str] | None = None,
    progress: bool = False,
) -> Identification:
    """Find parameters of a scene by which its runs are as it was measured.

    Args:
        scene: what was measured, with its start, loads and motions.
        measurements: a run, a table or the path of one, of which node positions count, with noise that is not known;
            what `studies.measured` makes of one by quantities, members and noise; or several of these.
        parameters: `studies.Parameter`, or paths as in sweeps: "structure.strings[s1].stiffness".
        engine: `JAX(...)`, which differentiates runs; any other does by central differences; `MuJoCo(...)` by default.
        law: that was at work, which stays as it is; the scene's own by default, None for none.
        options: see `studies.FitOptions`.
        folder: made where it is absent; identification.json and .html are written there, and the same call goes on
            after an interruption.
        progress: show a bar.

    Returns:
        What was found; its `scene` has the values.

    Warns:
        IdentificationWarning: before the fit, of combinations of parameters that the measurements do not see.

    Raises:
        OptionError: for parameters and measurements that do not fit the scene, or a folder of another study.
        TensegrityError: as `simulate`, of the run with the starts.
    """
    checks.instance("scene", scene, Scene, "use a Scene, or load_scene(name or path)")
    law = law_for(scene, law)
    engine, chosen = checked_engine(engine), FitOptions() if options is None else options
    checks.instance("options", chosen, FitOptions, "use FitOptions(...)")
    name, settings = engine_settings(engine)
    unknowns, observed = Unknowns.of(scene, parameters), Observation.of(scene.structure, measurements)
    predictions = predictions_of(unknowns, observed, engine, law, chosen.actuation)
    facts = {"scene": scene.name, "source": scene.source, "engine": {"name": name, "options": settings}}
    study = {}
    if folder is not None:
        study = {
            "task": "identify",
            "scene": scene_to_toml(scene),
            "engine": facts["engine"],
            "law": None if law is None else spec_of(law, scene),
            "actuation": str(chosen.actuation),
            "parameters": [unknowns.paths, unknowns.scaled, unknowns.sizes, unknowns.low, unknowns.high],
            "measurements": digest([observed.labels, observed.times, observed.rows, observed.columns]),
            "versions": versions(engine),
        }
    with opened(runs_in(folder), plain(study, "the study")) as store:
        model = predictions if folder is None else StoredPredictions(predictions, store)
        try:
            found = fit(Problem(model, unknowns, observed), chosen, progress)
            values = np.array([row["value"] for row in found["parameters"]])
            found["doubts"] = model.doubts(values)
        except KeyboardInterrupt:
            raise KeyboardInterrupt(store.stopped("{} runs are finished")) from None
    draft = unknowns.at(values)
    data = {**facts, "versions": versions(engine), **found}
    return Identification(data, scene=draft.plant or draft.scene).kept(folder)


Data = dict[str, Any]
MOST_SERIES = 9  # that are drawn: those that move most, in parts of the largest of their unit
DOUBTFUL = 0.01  # p below which χ² or whiteness is evidence against noise or model


def judgement_of(data: Data) -> Judgement:
    """Judge how the fit ended, with a finding for each further sentence; none is good of a fit that did not end."""
    (ended, verdict), *others = verdicts(data)
    marks = {Mark.GOOD: Mark.GOOD if ended is Mark.GOOD else Mark.LIMITED}
    return Judgement(verdict, tuple(Finding(marks.get(mark, mark), text) for mark, text in others))


def verdicts(data: Data) -> Iterator[tuple[Mark, str]]:
    """Sentences with their marks: how the fit ended, its residuals, and what it leaves undetermined."""
    count, ended = sum(len(one["time"]) for one in data["series"]), "ended" if data["converged"] else "did not end"
    sure = data["converged"] and not data["doubts"]
    of = len(data["parameters"])
    yield (
        Mark.GOOD if sure else Mark.LIMITED if data["converged"] else Mark.BAD,
        f"{of} parameter{'' if of == 1 else 's'} of {count} numbers: the fit {ended} at run {data['runs']}"
        + (f"; the run with the estimates is in doubt: {in_short(data['doubts'])}." if data["doubts"] else "."),
    )
    if (p := data["p_value"]) is not None:
        text = f"χ² is {data['chi_squared']:.5g} of {data['degrees']} degrees of freedom (p = {p:.2g}"
        if p < DOUBTFUL:
            yield Mark.LIMITED, f"{text}): the noise or the model is not as given."
        elif p > 1 - DOUBTFUL:
            yield Mark.LIMITED, f"{text}): the residuals are smaller than the noise that was given."
        else:
            yield Mark.GOOD, f"{text}, allowed {DOUBTFUL:g} to {1 - DOUBTFUL:g})."
    if data["estimated_noise"] is not None:
        noise = units.quantity(data["estimated_noise"], data["series"][0]["unit"])
        yield Mark.UNJUDGED, f"The noise, estimated, is {noise}: none was given to hold it against."
    if (p := data["whiteness"]["p_value"]) is not None:
        what = "white" if p >= DOUBTFUL else "correlated in time, and intervals too narrow"
        text = f"Residuals are {what} (Ljung and Box, {data['whiteness']['lags']} lags: p = {p:.2g}, allowed "
        yield Mark.GOOD if p >= DOUBTFUL else Mark.LIMITED, f"{text}{DOUBTFUL:g} or more)."
    for one in data["after"]["unseen"]:
        yield Mark.LIMITED, f"The measurements do not see: {one}."
    for row in data["parameters"]:
        if row["note"]:
            yield Mark.LIMITED, f"{row['name']} is {row['note']}, without an interval."


def _fitted(data: Data) -> Figure:
    series = [one for one in data["series"] if one["time"]]
    spans = [float(np.ptp(one["fitted"])) for one in series]
    most = {
        one["unit"]: max(s for s, two in zip(spans, series, strict=True) if two["unit"] == one["unit"])
        for one in series
    }
    order = sorted(range(len(series)), key=lambda k: -spans[k] / (most[series[k]["unit"]] or 1.0))[:MOST_SERIES]
    from tensegrity_mj.pictures.ticks import alike

    figure, panels = grid_of_panels(len(order), 3, COLUMN, ROW)
    for panel, one in zip(panels, (series[k] for k in order), strict=True):
        panel.plot(one["time"], one["measured"], ".", ms=3, color=palette.color_of(0), alpha=0.5)
        panel.plot(one["time"], one["fitted"], color=palette.color_of(2), lw=1.2)
        frame(panel, texts.figure_text(one["label"]), "t [s]", f"[{one['unit']}]")
    alike(figure)
    return figure


def _information_figure(data: Data) -> Figure:
    """Intervals; eigenvalues of the Fisher information; autocorrelation of the residuals."""
    known = [row for row in data["parameters"] if math.isfinite(row["deviation"]) and row["value"]]
    figure = new_figure(3 * COLUMN, max(ROW, 0.8 + 0.22 * len(known)))
    left, middle, right = figure.subplots(1, 3)
    places, white = np.arange(len(known)), data["whiteness"]
    reach = [(row["high"] - row["value"]) / abs(row["value"]) for row in known]
    left.errorbar(np.ones(len(known)), places, xerr=reach, fmt="o", ms=4, capsize=3, color=palette.color_of(0))
    left.plot([row["start"] / row["value"] for row in known], places, "x", color=palette.GUIDE)
    left.set_yticks(places, [texts.figure_text(row["name"]) for row in known])
    left.invert_yaxis()
    for number, when in enumerate(("before", "after")):
        values = np.array(data[when]["eigenvalues"])
        shown, look = np.where(values > 0, values, np.nan), {"label": when, "color": palette.color_of(number)}
        middle.semilogy(np.arange(1, len(values) + 1), shown, "ox"[number], **look)
    middle.xaxis.get_major_locator().set_params(integer=True)
    right.bar(np.arange(1, white["lags"] + 1), white["autocorrelation"], color=palette.color_of(0), width=0.5)
    for bound in () if white["bound"] is None else (white["bound"], -white["bound"]):
        right.axhline(bound, color=palette.GUIDE, ls="--", lw=0.9)
    frame(left, "intervals, in parts of the estimate")
    frame(middle, "eigenvalues of the Fisher information")
    frame(right, "autocorrelation of the residuals", "lag in samples")
    return figure
