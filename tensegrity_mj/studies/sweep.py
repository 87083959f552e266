"""`Sweep`: simulations of one scene over parameters of scene, structure, law, engine and actuation, by `run_many`.

Each run is kept as its measures, which have units and meanings here, and the outcome of a sweep is rows of them.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
import os
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property, lru_cache, partial
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np

from tensegrity_mj.basics import kinds
from tensegrity_mj.basics.checks import check_known
from tensegrity_mj.basics.fields import field, kind_of, register, registered, value
from tensegrity_mj.controllers.own import Spec, is_own
from tensegrity_mj.controllers.scenes import SCENE_LAW, AnyLaw
from tensegrity_mj.controllers.specs import own_of, spec_of
from tensegrity_mj.controllers.table import LAWS, built_in
from tensegrity_mj.engines.table import engine_settings
from tensegrity_mj.errors import OptionError, TensegrityError
from tensegrity_mj.library.named import is_family_call, load_scene
from tensegrity_mj.model.actuation import Actuation, Mode, OnInfeasible
from tensegrity_mj.model.elements.element import Element
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.text.reading import scene_from_toml
from tensegrity_mj.model.text.writing import scene_to_toml
from tensegrity_mj.runs.deformation import deformation, is_tower
from tensegrity_mj.runs.judgement import doubts, in_short
from tensegrity_mj.runs.trajectory import Status, Trajectory
from tensegrity_mj.simulation import simulate_as_far
from tensegrity_mj.studies import many, parameter_values, plain, scene_parameters
from tensegrity_mj.studies.parameter_values import Axis, Choice, Draw, Scaled, Together, Vary
from tensegrity_mj.studies.parameters import Draft
from tensegrity_mj.studies.workers import DONE, WithFiles, Workers, workers_for

TRAJECTORY = "trajectory.nc"


@value("Sweep", OptionError)
class Sweep:
    """Simulations of a scene, one for every combination of values and every draw.

    Sample j of a seed is the same at every combination, and for any number of samples: combinations are compared
    under equal conditions, and a larger study contains the smaller one.

    Attributes:
        scene: a scene, or the name or the path of one, or a family's call in a text, such as "tower(stages=10)": then
            `family.<argument>` is a parameter, and the family makes the scene anew for each value. Its loads must not
            be a Python function.
        axes: `Vary` and `Together`; all combinations are run, the last axis fastest.
        draws: random parameters, drawn `samples` times at every combination.
        samples, seed: of the draws; a seed is needed where something is drawn.
        fixed: parameters with one value, path -> value.
        engine: an engine, MuJoCo() by default; the parameter `engine` chooses another with its own defaults.
        law: the scene's own by default, None for none; the name of one, "module:name" or "path.py:name" of your own; a
            function of a module, (scene, **options) -> law; or a law object, which workers must be able to import or
            make again, or else this process computes alone. Its options are set by `law.<option>`.
        actuation, on_infeasible, output_interval: as for `simulate`.
        keep_trajectories: keep every run as a .nc file in the study's folder.
        family: the call; taken from `scene`.
    """

    scene: Scene | str | os.PathLike[str] = field(None)
    axes: Sequence[Vary | Together] = field(kinds.parts(Axis, "Vary(parameter, values) or Together([...])"), default=())
    draws: Sequence[Draw] = field(kinds.parts(Draw, "Draw(parameter, distribution)"), default=())
    samples: int = field(kinds.whole(1), default=1)
    seed: int | None = field(kinds.whole(0), default=None, none="None where nothing is drawn")
    fixed: Mapping[str, Any] = field(
        kinds.mapping(kinds.text(), kinds.Kind(lambda one: one), "a mapping of paths to values", "parameter"),
        factory=dict,
    )
    engine: Any = field(None, default=None)
    law: AnyLaw | str | os.PathLike[str] = field(None, default=SCENE_LAW)
    actuation: Actuation = field(kinds.part(Actuation), factory=Actuation.continuous)
    on_infeasible: OnInfeasible = field(kinds.choice(OnInfeasible), default=OnInfeasible.STOP)
    output_interval: float | None = field(kinds.positive("s"), default=None, none="None for the engine's own")
    keep_trajectories: bool = field(kinds.flag(), default=False)
    family: str = field(kinds.text(), default="")

    def __attrs_post_init__(self) -> None:
        if not isinstance(self.scene, Scene):
            if isinstance(self.scene, str) and is_family_call(self.scene):
                object.__setattr__(self, "family", self.scene)
            object.__setattr__(self, "scene", load_scene(self.scene))
        if self.draws and self.seed is None:
            raise OptionError("Sweep: what is drawn needs a seed, so that it can be drawn again; give one, such as 0")
        if self.samples > 1 and not self.draws:
            raise OptionError(f"Sweep: samples = {self.samples}, and nothing is drawn; add draws, or leave it out")
        object.__setattr__(self, "draws", scene_parameters.single_draws(cast(Scene, self.scene), self.draws))
        self._check()

    @property
    def parameters(self) -> list[str]:
        """The parameters that take several values, in order: those of the axes, then those drawn."""
        axes = [one for axis in self.axes for one in axis.axes]
        return [axis.parameter for axis in axes if len(axis.values) > 1] + [draw.parameter for draw in self.draws]

    def points(self, samples: int | None = None) -> Iterator[dict[str, Any]]:
        """Path -> value of each point, as points hold it; of so many samples, all of them by default."""
        fixed = {name: parameter_values.encoded(value) for name, value in self.fixed.items()}
        drawn = [self.sample(number) for number in range(self.samples if samples is None else samples)]
        rows = [list(zip(*(one.values for one in axis.axes), strict=True)) for axis in self.axes]
        names = [one.parameter for axis in self.axes for one in axis.axes]
        for combination in itertools.product(*rows):
            values = map(parameter_values.encoded, itertools.chain(*combination))
            settings = fixed | dict(zip(names, values, strict=True))
            for sample in drawn:
                yield settings | sample

    def sample(self, number: int) -> dict[str, Any]:
        """The draws of one sample."""
        if not self.draws:
            return {}
        assert self.seed is not None
        generator = np.random.default_rng([self.seed, number])
        return {draw.parameter: draw.sample(generator) for draw in self.draws}

    def common(self) -> dict[str, Any]:
        """Return as plain values what all points share: everything that the task needs except their parameters."""
        engine, options = ("mujoco", {}) if self.engine is None else engine_settings(self.engine)
        return {
            **({"family": self.family} if self.family else {}),
            **elements_of(cast(Scene, self.scene)),
            "scene": scene_to_toml(cast(Scene, self.scene)),
            "law": self._law,
            **({"own_laws": self._own_laws} if self._own_laws else {}),
            "engine": {"name": engine, "options": options},
            "actuation": {"mode": self.actuation.mode.value, "period": self.actuation.period},
            "on_infeasible": self.on_infeasible.value,
            "output_interval": self.output_interval,
            "keep_trajectories": self.keep_trajectories,
        }

    def run(
        self,
        folder: str | os.PathLike[str] | None = None,
        *,
        workers: Workers | None = None,
        progress: bool = False,
    ) -> many.Study:
        """Run it, or go on with it; see `run_many`.

        Raises:
            OptionError: as `run_many`, and for trajectories that no folder is given for.
        """
        if self.keep_trajectories and folder is None:
            raise OptionError("Sweep: keep_trajectories needs a folder to keep them in")
        points = [{"parameters": settings} for settings in self.points()]
        label = f"sweep of {cast(Scene, self.scene).name}"
        how: many.RunOptions = {"workers": workers_for(self._law, workers), "progress": progress}
        return many.run_study(simulate_point, points, folder, label, how, self.common())

    @cached_property
    def _law(self) -> Spec | None:
        scene = cast(Scene, self.scene)
        if self.law is SCENE_LAW and (scene.control is None or scene.control.law in built_in()):
            return None
        return spec_of(self.law, scene)  # an installed law has a digest, which the study must know

    @cached_property
    def _own_laws(self) -> dict[str, Spec]:
        """Own and installed laws that the parameter `law` takes, by their texts: workers make what was read here."""
        axes = [one for axis in self.axes for one in axis.axes]
        draws = [draw.distribution for draw in self.draws if draw.parameter == "law"]
        values = [value for axis in axes if axis.parameter == "law" for value in axis.values]
        values += [value for one in draws if isinstance(one, Choice) for value in one.values]
        values += [self.fixed["law"]] if "law" in self.fixed else []
        texts = [text for text in values if isinstance(text, str) and text not in built_in()]
        return {text: spec_of(text, cast(Scene, self.scene)) for text in texts if is_own(text) or text in LAWS}

    def _check(self) -> None:
        """Refuse what cannot be meant, before anything runs: names of nothing, and values of a wrong kind.

        Engines and actuations must be possible in every combination. A value that the structure or the law refuses is
        no mistake of the sweep: its point fails as data.
        """
        axes = [one for axis in self.axes for one in axis.axes]
        parameter_values.once([*self.fixed, *(one.parameter for one in axes), *(draw.parameter for draw in self.draws)])
        if each := next((one.parameter for one in axes if "[*]" in one.parameter), ""):
            raise OptionError(f"{each}: [*] is for draws; without it all of them take the value")
        singles = [*self.fixed.items(), *((one.parameter, value) for one in axes for value in one.values)]
        for spec in [*([self._law] if self._law is not None else []), *self._own_laws.values()]:
            own_of(spec)
        singles += self.sample(0).items()
        common = self.common()
        for path, setting in singles:
            try:
                drafted(common).apply({path: parameter_values.encoded(setting)})
            except OptionError:
                raise
            except TensegrityError:
                pass
        tried: set[str] = set()
        for settings in self.points(samples=1):
            how = {path: value for path, value in settings.items() if path.partition(".")[0] in ("engine", "actuation")}
            if how and plain.canonical(how) not in tried:
                tried.add(plain.canonical(how))
                draft = drafted(common).apply(how)
                draft.make_engine()
                Actuation(draft.actuation, draft.period)


def simulate_point(point: dict[str, Any]) -> dict[str, Any] | WithFiles:
    """The task of a sweep: simulate one point, and return its measures."""
    draft = drafted(point).apply(point["parameters"])
    scene = draft.plant or draft.scene
    run = simulate_as_far(
        scene,
        draft.make_law(),
        draft.make_engine(),
        actuation=Actuation(draft.actuation, draft.period),
        on_infeasible=draft.on_infeasible,
        output_interval=draft.output_interval,
    )
    values = measure(run) | {"doubts": doubts(run, of_the_law=draft.plant is None)}
    if not point["keep_trajectories"]:
        return values
    with tempfile.TemporaryDirectory() as folder:
        return WithFiles(values, {TRAJECTORY: run.save(Path(folder) / TRAJECTORY).read_bytes()})


def drafted(common: Mapping[str, Any]) -> Draft:
    """The experiment of what all points of a sweep share; raise OptionError for an element that cannot be imported."""
    known = registered(Element)
    for kind, place in common.get("elements", {}).items():  # of `elements_of`
        module, _, name = place.partition(":")
        try:
            if kind not in known:
                register(kind, getattr(import_module(module), name))
        except (ImportError, AttributeError) as error:
            raise OptionError(
                f"elements: kind '{kind}' is the class {name} of {module}, which another process cannot import: define "
                "it in a module, or run the study in this process"
            ) from error
    return Draft(
        scene=scene_of(common["scene"]),
        family=common.get("family", ""),
        law_spec=common["law"],
        own_laws=common.get("own_laws", {}),
        engine=common["engine"]["name"],
        engine_options=dict(common["engine"]["options"]),
        actuation=Mode(common["actuation"]["mode"]),
        period=common["actuation"]["period"],
        on_infeasible=OnInfeasible(common["on_infeasible"]),
        output_interval=common["output_interval"],
    )


def elements_of(scene: Scene) -> dict[str, Any]:
    """Return where a process of a study finds the classes of a scene's elements that a call has registered here."""
    kinds = {kind_of(type(element)): type(element) for element in scene.elements}
    places = {kind: f"{cls.__module__}:{cls.__qualname__}" for kind, cls in kinds.items() if kind}
    return {"elements": places} if places else {}


@lru_cache(maxsize=16)
def scene_of(text: str) -> Scene:
    """The scene of a text, which many points of a study share."""
    return scene_from_toml(text, where="the scene of the study")


class Measure(NamedTuple):
    """One number of a run."""

    unit: str
    meaning: str
    of: Callable[[Trajectory], Any]


def _last(values: Any) -> Any:
    return values[-1] if len(values) else None


def _largest(values: Any) -> Any:
    return np.max(values) if values.size else None


def _margin_time(run: Trajectory) -> Any:
    margins = run.feasibility_margin
    return run.time[np.nanargmin(margins)] if np.any(~np.isnan(margins)) else None


def _bent(run: Trajectory, late: bool = False) -> Any:
    """The largest D of a tower; that of the last quarter of the run."""
    if not is_tower(run.scene.structure) or not len(run.time):
        return None
    rows = run.time >= (run.scene.start_time + 0.75 * run.scene.duration if late else 0.0)
    return np.max(deformation(run)[rows]) if rows.any() else None


def _mean_rod_force(run: Trajectory) -> Any:
    return np.mean(run.rod_forces) if run.rod_force_densities.size else None


# Shown unless others are chosen.
USUAL = ("final_error", "max_force_density", "min_margin", "energy_residual")


def _at(part: str, *keys: str) -> Callable[[Trajectory], Any]:
    """Make a function that returns the value at the end of these keys in a run's reports, or in its cost."""
    return lambda run: plain.value_at(getattr(run, part), keys)


_report, _cost = partial(_at, "reports"), partial(_at, "cost")
BELOW = "nonpositive_rest_lengths"  # a report
DOUBTFUL = "in doubt"  # how a completed run counts that something speaks against


LAW = "as the law defines"
MEASURES: dict[str, Measure] = {
    "status": Measure("", "how the run ended", lambda run: run.status.value),
    "message": Measure("", "why it was not completed", lambda run: run.message),
    "end_time": Measure("s", "simulated time that was reached", lambda run: _last(run.time)),
    "final_error": Measure(
        "m", "largest distance of a node from its target at the end", lambda run: _last(run.target_error())
    ),
    "max_force_density": Measure("N/m", "largest u of a string", lambda run: _largest(run.force_densities)),
    "max_tension": Measure("N", "largest tension of a string", lambda run: _largest(run.tensions)),
    "max_compression": Measure(
        "N/m", "largest compressive force density -Jλ/ℓ² of a rod", lambda run: _largest(-run.rod_force_densities)
    ),
    "mean_rod_force": Measure("N", "internal force of rods, their mean over rods and time", _mean_rod_force),
    "deformation": Measure("m", "of a tower: largest D, of the centres between stages from a line", _bent),
    "late_deformation": Measure("m", "the same in the last quarter of the scene's duration", partial(_bent, late=True)),
    "min_margin": Measure(LAW, "smallest feasibility margin", lambda run: run.min_feasibility_margin),
    "min_margin_time": Measure("s", "when the feasibility margin is smallest", _margin_time),
    "final_lyapunov": Measure(LAW, "V at the end", lambda run: _last(run.lyapunov)),
    "decay_error": Measure("", "largest relative error of V against V(0) exp(-δt)", _report("decay_error")),
    "energy_residual": Measure("J", "largest error of the energy balance", lambda run: run.energy_residual),
    "drift": Measure("", "largest error of bᵀb = 1", _report("drift")),
    "nonpositive_rest_lengths": Measure("", "recorded samples with a rest length <= 0", _report(BELOW, "samples")),
    "nonpositive_since": Measure("s", "when the first was, at any step", _report(BELOW, "first_time")),
    "holding_ratio": Measure("", "largest ratio of what holding adds to the load", _report("largest_holding_ratio")),
    "steps": Measure("", "steps of the integrator", _cost("steps")),
    "evaluations": Measure("", "evaluations of the right-hand side", _cost("evaluations")),
    "warnings": Measure("", "what the run warned of", lambda run: list(run.reports.get("warnings", []))),
    "doubts": Measure("", "all that speaks against the run: growth, warnings, limits that were reached", doubts),
}


def measure(run: Trajectory) -> dict[str, Any]:
    """Every measure of a run as a plain value; None where a run has no such thing."""
    return {name: _plain(one.of(run)) for name, one in MEASURES.items()}


def _plain(value: Any) -> Any:
    value = value.item() if isinstance(value, np.generic) else value
    return None if isinstance(value, float) and math.isnan(value) else value


@dataclasses.dataclass(frozen=True)
class Row:
    """One point.

    Attributes:
        parameters: path -> value.
        status: how its run ended, or failed; "in doubt" where it was completed and something speaks against it.
        reason: why it was not completed.
        values: its measures; none where it failed.
    """

    parameters: dict[str, Any]
    status: str
    reason: str
    values: dict[str, Any]


def rows_of(study: many.Study) -> list[Row]:
    rows = []
    for point, outcome in zip(study.points, study.outcomes, strict=True):
        if outcome["status"] == DONE:
            values = outcome["values"]
            doubtful = values["doubts"] if values["status"] == Status.COMPLETED.value else []
            status = DOUBTFUL if doubtful else values["status"]
            rows.append(Row(point["parameters"], status, values["message"] or in_short(doubtful), values))
        else:
            rows.append(Row(point["parameters"], "failed", f"{outcome['error']}: {outcome['reason']}", {}))
    return rows


def counts(rows: Sequence[Row]) -> dict[str, int]:
    """Count the points by how they ended, without ends that no point has."""
    order = dict.fromkeys((Status.COMPLETED.value, DOUBTFUL, *(status.value for status in Status), "failed"))
    return {status: count for status in order if (count := sum(row.status == status for row in rows))}


def check_measures(names: Sequence[str]) -> list[str]:
    """Return the names; raise OptionError for one that is no measure."""
    for name in names:
        check_known("measures", name, MEASURES, "measure")
    return list(names)


def as_number(value: Any) -> float | None:
    """A number, or the factor of a scaled value; None for all else."""
    value = parameter_values.decoded(value)
    value = value.factor if isinstance(value, Scaled) else value
    return float(value) if isinstance(value, (int, float)) and not isinstance(value, bool) else None


def shown(value: Any) -> str:
    if isinstance(value, str) and value.startswith("*"):
        return f"×{as_number(value):.6g}"
    if isinstance(value, float):
        return f"{value:.6g}"
    return "-" if value is None else str(value)


def parameter_label(path: str) -> str:
    """Return a path as text, without its `structure.`."""
    return path.removeprefix("structure.")


def measure_label(name: str) -> str:
    """Return a measure's name as text, with its unit."""
    unit = MEASURES[name].unit
    return name.replace("_", " ") + (f" ({unit})" if unit == LAW else f" [{unit}]" if unit else "")
