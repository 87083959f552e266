"""`identify`: parameters of a scene from measurements; and what it returns."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import instance
from tensegrity_mj.basics.files import made_folder
from tensegrity_mj.basics.texts import aligned
from tensegrity_mj.controllers.scenes import SCENE_LAW, law_for
from tensegrity_mj.controllers.specs import spec_of
from tensegrity_mj.engines.table import checked_engine, engine_settings
from tensegrity_mj.errors import printable
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.text.writing import scene_to_toml
from tensegrity_mj.pictures.findings import Judgement
from tensegrity_mj.simulation import versions
from tensegrity_mj.studies.identification.fitting import FitOptions, Problem, fit
from tensegrity_mj.studies.identification.measurements import Observation
from tensegrity_mj.studies.identification.page import judgement_of, page_of
from tensegrity_mj.studies.identification.predictions import Kept, predictions_of
from tensegrity_mj.studies.identification.unknowns import Parameter, Unknowns
from tensegrity_mj.studies.plain import digest, plain
from tensegrity_mj.studies.report import Page, Report
from tensegrity_mj.studies.store import opened

RUNS = "runs"


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
        """Everything, as plain values."""
        return self.data

    @property
    def judgement(self) -> Judgement:
        """How the fit ended, and what it leaves undetermined."""
        return judgement_of(self.data)

    def page(self) -> Page:
        """Measured against fitted, intervals, information and residuals."""
        return page_of(self.data)

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
        return aligned([heads, *rows])


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
    instance("scene", scene, Scene, "use a Scene, or load_scene(name or path)")
    law = law_for(scene, law)
    engine, chosen = checked_engine(engine), FitOptions() if options is None else options
    instance("options", chosen, FitOptions, "use FitOptions(...)")
    name, settings = engine_settings(engine)
    unknowns, observed = Unknowns.of(scene, parameters), Observation.of(scene.structure, measurements)
    predictions = predictions_of(unknowns, observed, engine, law, chosen.actuation)
    facts = {"scene": scene.name, "source": scene.source, "engine": {"name": name, "options": settings}}
    runs, study = None, {}
    if folder is not None:
        runs = made_folder(folder) / RUNS
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
    with opened(runs, plain(study, "the study")) as kept:
        model = predictions if folder is None else Kept(predictions, kept)
        try:
            found = fit(Problem(model, unknowns, observed), chosen, progress)
            values = np.array([row["value"] for row in found["parameters"]])
            found["doubts"] = model.doubts(values)
        except KeyboardInterrupt:
            raise KeyboardInterrupt(kept.stopped("{} runs are finished")) from None
    draft = unknowns.at(values)
    data = {**facts, "versions": versions(engine), **found}
    return Identification(data, scene=draft.plant or draft.scene).kept(folder)
