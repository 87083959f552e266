"""`validate`: the controller's report of any law on any scene, as data, sentences and one self-contained HTML page."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tensegrity_mj.basics.checks import names_from, positive, whole
from tensegrity_mj.basics.files import table_beside
from tensegrity_mj.basics.jsontext import plain_values
from tensegrity_mj.basics.seconds import fitted
from tensegrity_mj.basics.texts import figure_text, shortened
from tensegrity_mj.basics.units import quantity
from tensegrity_mj.controllers import specs
from tensegrity_mj.controllers.scenes import SCENE_LAW, AnyLaw, named_in
from tensegrity_mj.engines.requirements import engines_for, only_one
from tensegrity_mj.engines.table import ENGINES, installed
from tensegrity_mj.errors import OptionError
from tensegrity_mj.library.named import load_scene
from tensegrity_mj.model.actuation import whole_ratio
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.text.writing import scene_to_toml
from tensegrity_mj.pictures import palette
from tensegrity_mj.pictures.figure import COLUMN, GREY, common_legend, frame, line_style, new_figure
from tensegrity_mj.pictures.findings import Finding, Judgement, Mark
from tensegrity_mj.pictures.page import Picture, Section, Table
from tensegrity_mj.studies.many import run_study
from tensegrity_mj.studies.plain import plain, value_at
from tensegrity_mj.studies.report import Page, Report, runs_in
from tensegrity_mj.studies.validation.findings import findings, left_promise
from tensegrity_mj.studies.validation.judging import Data, law_name, title, verdict
from tensegrity_mj.studies.validation.sections import SECTIONS, Extent, Setup, cases
from tensegrity_mj.studies.validation.task import TICK, run_point
from tensegrity_mj.studies.workers import Workers, workers_for

FORMAT = 2
DATA, PAGE = "validation.json", "validation.html"  # what a folder holds


@dataclass(frozen=True, eq=False)
class Validation(Report):
    """A finished report; docs/validate.md explains the keys of its `data`."""

    NAME = "validation"

    def page(self) -> Page:
        """Make the page of the report, section by section."""
        data = self.data
        setup, scene, name = data["setup"], data["scene"], law_name(data["law"])
        introduction = (
            f"Law {name} on scene {scene['name']} ({scene['source'] or 'no source given'}); {setup['runs']} runs of "
            f"{setup['duration']:g} s in {', '.join(title(engine) for engine in setup['engines'])}; RK4 at "
            f"{1e3 * setup['timestep']:g} ms where the step is fixed; control period "
            f"{1e3 * setup['control_period']:g} ms where the law must be sampled; seed {setup['seed']}. A run has "
            f"converged if it ends within {quantity(data['tolerance'], 'm', 2)} of its target, or of where the nominal "
            "run rests if there is none."
        )
        return Page(f"Validation of {name} on {scene['name']}", introduction, judgement_of(data), _sections(data))

    @property
    def summary(self) -> list[str]:
        """Summary of the report, in sentences."""
        return list(self.data["summary"])


def validate(
    scene: Scene | str | os.PathLike[str],
    law: AnyLaw | str | os.PathLike[str] = SCENE_LAW,
    *,
    law_options: Mapping[str, Any] | None = None,
    folder: str | os.PathLike[str] | None = None,
    engines: Sequence[str] | None = None,
    sections: Sequence[str] | None = None,
    duration: float | None = None,
    timestep: float = 1e-3,
    control_period: float = 1e-3,
    seed: int = 0,
    quick: bool = False,
    extent: Extent | None = None,
    workers: Workers | None = None,
    progress: bool = False,
) -> Validation:
    """Test a law on a scene in every engine: as it is meant to be, sampled, and with everything off that may be.

    Args:
        scene: a scene, or the name or the path of one; its loads must not be a Python function.
        law: the scene's own by default; a built-in law's name; "module:name" or "path.py:name" of your own; or a law
            object or function. What no other process can import is run in this one.
        law_options: of a law that a text names, or of the scene's, by their names.
        folder: where the report is written (validation.json, validation.html) and finished runs are kept, so that the
            same call goes on after an interruption; None keeps nothing.
        engines: "mujoco", "dae", ...; all that can simulate the scene by default. Sentences are of the first.
        sections: of `SECTIONS`; all by default. `nominal` is always run.
        duration: of each run [s]; the scene's by default; rounded to hundredths.
        timestep: of RK4 in every engine [s]; it must divide 10 ms.
        control_period: of runs that must be sampled (noise, delay, laws that jump) [s]; it must divide 10 ms.
        seed: of everything random, an integer >= 0.
        quick: a few points of each section.
        extent: exactly how much is run, in place of `quick`.
        workers: who computes; all cores by default.
        progress: show a bar with the time left on stderr.

    Returns:
        The report. Runs that fail, diverge or have no solution are results in it.

    Raises:
        OptionError: for options out of range, no law, or workers that cannot have the law.
        SceneError: for loads that are a Python function.
    """
    scene = scene if isinstance(scene, Scene) else load_scene(scene)
    spec = specs.spec_of(law, scene, law_options)
    if spec == specs.NO_LAW:
        raise OptionError(f"validate: there is no law to test; leave law out to test '{named_in(scene)}'")
    made = specs.make(spec, scene)
    description = plain(specs.describe(spec, made, scene), "what the law says of itself")
    setup = Setup(
        scene,
        made,
        _engines(scene, engines),
        TICK * max(1, round(positive("duration", scene.duration if duration is None else duration, "s") / TICK)),
        _part_of_a_tick("timestep", timestep),
        _part_of_a_tick("control_period", control_period),
        whole("seed", seed, 0),
        extent or (Extent.quick() if quick else Extent()),
    )
    chosen = names_from("sections", sections, tuple(SECTIONS))
    chosen = [name for name in SECTIONS if name == "nominal" or name in chosen]
    todo = cases(setup, chosen)
    study = run_study(
        run_point,
        [case.point for case in todo],
        runs_in(folder),
        f"validation of {scene.name}",
        {
            "identity": {"law": description, "format": FORMAT},
            "workers": workers_for(spec, workers),
            "progress": progress,
        },
        {"scene": scene_to_toml(scene), "spec": spec, **plain_values(setup, "duration", "timestep")},
    )
    data: dict[str, Any] = {
        "format": FORMAT,
        "scene": {"name": scene.name, "source": scene.source},
        "law": description,
        "setup": {
            "engines": list(setup.engines),
            "sections": chosen,
            **plain_values(setup, "duration", "timestep"),
            "control_period": setup.period,
            "seed": setup.seed,
            "runs": len(todo),
        },
        "versions": study.identity["versions"],
        **findings(setup, list(zip(todo, study.outcomes, strict=True))),
    }
    return Validation(data).kept(folder)


def _engines(scene: Scene, given: Sequence[str] | None) -> list[str]:
    able = engines_for(scene)
    if len(able) != 1:
        return names_from("engines", installed() if given is None else given, tuple(ENGINES))
    names = names_from("engines", able if given is None else given, tuple(ENGINES))
    others = [name for name in names if name not in able]
    if others:
        raise OptionError(f"engines: {', '.join(others)}: {only_one(scene)}: leave them out, or validate another scene")
    return names


def _part_of_a_tick(what: str, value: float) -> float:
    value, _ = fitted(positive(what, value, "s"), {"tick": TICK})
    try:
        whole_ratio(TICK, value, what)
    except OptionError:
        raise OptionError(
            f"{what} = {value:g}: it must divide {TICK:g} s, as 0.005, 0.002, 0.001 and 0.0005 do"
        ) from None
    return value


LONG = 8  # rows of a table, beyond which it is folded
MOST_NODES = 12  # that a cell holds
MOST_LETTERS = 30  # of a label that stays in one line
TABLE = table_beside(__file__)
COLUMNS, NOTES = TABLE["columns"], TABLE["notes"]


def judgement_of(data: Data) -> Judgement:
    """The verdict, and a finding a section, with its sentences."""
    engine, nominal = next(iter(data["nominal"]["engines"].items()))
    texts: dict[str, list[str]] = {}
    for section, sentence in zip(data["summary_sections"], data["summary"], strict=True):
        texts.setdefault(section, []).append(sentence)
    verdicts = {section: data[section][engine]["word"] for section in texts if section != "nominal"}
    verdicts["nominal"] = nominal["judgement"]["word"]
    found = [Finding(Mark(verdicts[section]), " ".join(sentences)) for section, sentences in texts.items()]
    return Judgement(verdict(data), found)


def _sections(data: Data) -> Iterator[Section]:
    yield _nominal(data)
    for section, heading in SECTIONS.items():
        if section == "nominal" or section not in data:
            continue
        parts: list[Picture | Table] = list(of_section(section, data))
        text = NOTES.get(section, "")
        for number, (engine, part) in enumerate(data[section].items()):
            against = part.get("reference", "").replace("continuous", "the law at every stage")
            text = text.replace("{reference}", against)
            parts += [
                replace(table, folded=number > 0 or len(table.rows) > LONG) for table in _engine(section, engine, part)
            ]
        if section == "starts" and data.get("starts_that_differ"):
            rows = [[one["label"], one["outcomes"]] for one in data["starts_that_differ"]]
            parts.append(Table("Starts that end differently in two engines", ("start", "outcomes"), rows))
        yield Section(heading[0].upper() + heading[1:], [text] if text else [], parts)
    law = data["law"]
    rows = [
        ["law", law["from"]],
        ["description", law["description"]],
        *([key, data[key]] for key in ("setup", "versions")),
    ]
    yield Section("How it was run", (), [Table("All options", ("", ""), rows, folded=True)])


def _engine(section: str, engine: str, part: Data) -> Iterator[Table]:
    if section == "gains" and part["trends"]:
        rows = [[one["statement"], one["shows"], _values(one)] for one in part["trends"]]
        yield Table(f"What §5.6 says, {title(engine)}", ("statement", "shows", "factor on the gain: value"), rows)
    if section == "starts":
        head = "law" if "law" in part["fractions"][0] else "amplitude"
        rows = [
            [one[head], one["starts"], _percent(one["converged"]), _percent(one["kept"]), one["outcomes"]]
            for one in part["fractions"]
        ]
        yield Table(title(engine), (head, "starts", "converge", "with V as promised", "outcomes"), rows)
        return
    columns = TABLE["shown"].get(section, TABLE["usual"])
    rows = [
        [*map(_whole, (one["label"], one["outcome"])), *map(one.get, columns[1:]), shortened(one["message"] or "", 160)]
        for one in part["rows"]
    ]
    count = len(columns) + (2 if any(row[-1] for row in rows) else 1)  # the last says why, where anything does
    heads = ("", *(COLUMNS[column] for column in columns), "why")
    yield Table(title(engine), heads[:count], [row[:count] for row in rows])


def _percent(part: float | None) -> str:
    return "–" if part is None else f"{100 * part:.0f} %"


def _values(one: Data) -> list[str]:
    texts = ["not settled" if value is None else f"{value:.4g}" for value in one["values"]]
    return [f"{factor:g}: {text}" for factor, text in zip(one["factors"], texts, strict=True)]


def _whole(text: str) -> str:
    """A short text that is not broken into lines."""
    return text.replace(" ", "\u00a0") if len(text) <= MOST_LETTERS else text


def _nominal(data: Data) -> Section:
    engines = data["nominal"]["engines"]
    runs = {engine: one for engine, one in engines.items() if "peaks" in one}
    rows = [[label, *(_value(one, *keys) for one in runs.values())] for label, keys in TABLE["nominal"].items()]
    parts: list[Picture | Table] = list(of_section("nominal", data))
    if runs:
        parts.append(Table("All numbers", ["", *map(title, runs)], rows, folded=True))
    failed = [[title(engine), one["outcome"], one["message"]] for engine, one in engines.items() if engine not in runs]
    if failed:
        parts.append(Table("Without a result", ("engine", "outcome", "why"), failed))
    if data["nominal"]["differences"]:
        rows = [
            [" and ".join(title(engine) for engine in one["engines"]), one["node_error"]]
            for one in data["nominal"]["differences"]
        ]
        parts.append(Table("Agreement", ("engines", "largest node difference [m]"), rows))
    for engine, one in list(runs.items())[:1]:
        parts += _strings(one, engine)
    return Section("Nominal run", (), parts)


def _value(one: Data, *keys: str) -> Any:
    value = value_at(one, keys)
    if isinstance(value, Mapping) and {"value", "time"} <= set(value):
        member = f"{value['of']}, " if "of" in value else ""
        return f"{value['value']:.4g} ({member}{value['time']:.4g} s)"
    if isinstance(value, Mapping) and keys[-1] == "nodes":
        if len(value) > MOST_NODES:
            return "see validation.json"
        return {name: ", ".join(f"{x + 0.0:.4f}" for x in place) for name, place in value.items()}
    return value


def _strings(one: Data, engine: str) -> Iterator[Table]:
    strings = one["winch"]["strings"]
    if not strings:
        return
    rates = one["switching"]["strings"]
    rows = [
        [name, work["done"], work["recovered"], work["peak"], work["mean"], rates[name]]
        for name, work in strings.items()
    ]
    heads = ("string", "work done [J]", "recovered [J]", "peak power [W]", "mean |power| [W]", "switches [1/s]")
    yield Table(f"Each winch, {title(engine)}", heads, rows, folded=len(rows) > LONG)


OUTCOME_COLORS: dict[str, Any] = {
    "converged": palette.TARGET,
    "still moving": palette.CYCLE[5],
    "off target": palette.CYCLE[4],
    "mirrored": palette.GHOST,
    "infeasible": palette.WARNING,
    "singular": palette.CYCLE[3],
    "diverged": palette.TEXT,
    "failed": GREY,
    "completed": palette.SLACK,
    "at rest": palette.TARGET,
    "elsewhere": palette.CYCLE[4],
    "grows": palette.WARNING,
    "refused": GREY,
}
GAIN_NAMES = {"decay_rate": "δ"}


def of_section(section: str, data: Data) -> Iterator[Picture]:
    makers = {"nominal": _nominal_runs, "sampling": _sampling, "gains": _gains, "starts": _starts}
    if section in makers:
        yield from makers[section](data)
    elif section in AGAINST:
        yield from _against(data[section], *AGAINST[section])


def _nominal_runs(data: Data) -> Iterator[Picture]:
    runs = {engine: one for engine, one in data["nominal"]["engines"].items() if one.get("series")}
    if not runs:
        return
    first = next(iter(runs.values()))
    panels = [*(["error"] if first["error"] else []), *(["lyapunov"] if first["lyapunov"] else []), "force_density"]
    figure = new_figure(len(panels) * COLUMN, 0.85 * COLUMN)
    labels = {"error": "target error [m]", "lyapunov": "V", "force_density": "largest u [N/m]"}
    for panel, name in zip(np.atleast_1d(figure.subplots(1, len(panels))), panels, strict=True):
        for number, (engine, one) in enumerate(runs.items()):
            series = one["series"]
            values = np.array([math.nan if value is None else value for value in series[name]], float)
            panel.plot(series["times"], values, color=palette.CYCLE[number], ls=line_style(number), label=title(engine))
            if name == "lyapunov" and one["lyapunov"] and one["lyapunov"]["promised_rate"]:
                V = one["lyapunov"]["initial"] * np.exp(-one["lyapunov"]["promised_rate"] * np.array(series["times"]))
                if number == 0:
                    panel.plot(series["times"], V, color=GREY, lw=3, alpha=0.4, zorder=0, label="promised")
        if name != "force_density" and np.all(np.isfinite(values)) and np.all(values > 0):
            panel.set_yscale("log")
        frame(panel, "", "t [s]", labels[name])
    yield Picture(figure, "The nominal run in each engine; lines that coincide agree.")


def _sampling(data: Data) -> Iterator[Picture]:
    figure = new_figure(2 * COLUMN, 1.05 * COLUMN)
    panel = figure.subplots()
    for number, (engine, part) in enumerate(data["sampling"].items()):
        for mode in dict.fromkeys(one["mode"] for one in part["rows"] if "period" in one):
            own = [one for one in part["rows"] if one["mode"] == mode and (one["node_error"] or 0) > 0]
            own.sort(key=lambda one: one["period"])
            if own:
                color = palette.CYCLE[0 if "force" in mode else 2]
                x, y = [1e3 * one["period"] for one in own], [one["node_error"] for one in own]
                panel.loglog(
                    x, y, color=color, ls=line_style(number), marker="o", ms=4, label=f"{mode}, {title(engine)}"
                )
    if panel.lines:
        frame(panel, "", "control period [ms]", "largest node error [m]")
        yield Picture(figure, "Error by sampling: the largest node error against the control period.")


def _gains(data: Data) -> Iterator[Picture]:
    engine, part = next(iter(data["gains"].items()))
    known = (("settling_10", "settled to 10 % [s]"), ("peak_force_density", "peak u [N/m]"))
    names = [named for named in known if any(one[named[0]] is not None for one in part["rows"])]
    if not names:
        return
    figure = new_figure(len(names) * COLUMN, COLUMN)
    for panel, (measured, label) in zip(np.atleast_1d(figure.subplots(1, len(names))), names, strict=True):
        for number, gain in enumerate(dict.fromkeys(one["gain"] for one in part["rows"])):
            own = [one for one in part["rows"] if one["gain"] == gain and one[measured] is not None]
            own.sort(key=lambda one: one["factor"])
            x, y = [one["factor"] for one in own], [one[measured] for one in own]
            panel.plot(x, y, color=palette.CYCLE[number], marker="o", ms=4, label=GAIN_NAMES.get(gain, gain))
        panel.set_xscale("log", base=2)
        if measured == "peak_force_density":
            panel.set_yscale("log")
        frame(panel, "", "factor on the gain", label)
    yield Picture(figure, f"Trends of the gains ({title(engine)}); runs that never settle are left out.")


# Sections whose final errors are drawn against facts: each fact, one that must be absent, and the axis; the caption.
AGAINST: dict[str, Any] = {
    "noise": (
        (
            ("position_std", "velocity_std", "noise of positions [m]"),
            ("velocity_std", "position_std", "of velocities [m/s]"),
        ),
        "Target error at the end, with sensor noise.",
    ),
    "delay": ((("samples", "", "delay [samples]"),), "Target error at the end, with a delay."),
}


def _against(section: Data, panels: Any, caption: str) -> Iterator[Picture]:
    """The final error against one fact, coloured by outcome."""
    figure = new_figure(max(1.6, len(panels)) * COLUMN, COLUMN)
    seen: set[str] = set()
    for panel, (key, other, label) in zip(np.atleast_1d(figure.subplots(1, len(panels))), panels, strict=True):
        for number, part in enumerate(section.values()):
            own = [one for one in part["rows"] if one[key] and not one.get(other) and one["final_error"] is not None]
            own.sort(key=lambda one: one[key])
            x, y = [one[key] for one in own], [one["final_error"] for one in own]
            panel.plot(x, y, color=GREY, ls=line_style(number), lw=1, zorder=1)
            for one in own:
                name = one["outcome"] if one["outcome"] not in seen else None
                seen.add(one["outcome"])
                panel.plot(one[key], one["final_error"], "o", ms=5, color=OUTCOME_COLORS[one["outcome"]], label=name)
        if panel.lines:
            panel.set_yscale("log")
        if other:
            panel.set_xscale("log")
        frame(panel, "", label, "final error [m]")
    if seen:
        yield Picture(figure, caption)


def _starts(data: Data) -> Iterator[Picture]:
    engine, part = next(iter(data["starts"].items()))
    rows = part["rows"]
    if "direction" in rows[0]:
        yield from _map(engine, rows)
        return
    if all(one["converged"] is None for own in data["starts"].values() for one in own["fractions"]):
        return
    figure = new_figure(1.6 * COLUMN, COLUMN)
    panel = figure.subplots()
    for number, (name, own) in enumerate(data["starts"].items()):
        x, y = [one["amplitude"] for one in own["fractions"]], [one["converged"] for one in own["fractions"]]
        panel.plot(x, y, color=palette.CYCLE[number], ls=line_style(number), marker="o", ms=4, label=title(name))
    panel.set_ylim(-0.05, 1.05)
    frame(panel, "", "amplitude of the perturbation [1]", "part of the starts that converge")
    yield Picture(figure, "Random starts of growing distance from the nominal one: in rad, and in mean rod lengths.")


def _map(engine: str, rows: Any) -> Iterator[Picture]:
    names = list(dict.fromkeys(one["law"] for one in rows))
    columns = 2
    lines = math.ceil(len(names) / columns)
    figure = new_figure(columns * 1.25 * COLUMN, lines * 0.8 * COLUMN)
    for number, name in enumerate(names):
        panel = figure.add_subplot(lines, columns, number + 1, projection="mollweide")
        for outcome, color in OUTCOME_COLORS.items():
            for hollow in (False, True):
                own = [
                    one for one in rows if (one["law"], one["outcome"], left_promise(one)) == (name, outcome, hollow)
                ]
                if not own:
                    continue
                b = np.array([one["direction"] for one in own])
                places = np.arctan2(b[:, 1], b[:, 0]), np.arcsin(np.clip(b[:, 2], -1, 1))
                face = "none" if hollow else color
                key = f"{outcome}, V not as promised" if hollow else outcome
                panel.scatter(*places, s=16, facecolors=face, edgecolors=color, lw=1.0, label=key)
        panel.set_title(figure_text(name), fontsize=9)
        panel.grid(color=palette.GRID, lw=0.5)
        panel.set_xticklabels([])
        panel.tick_params(labelsize=6)
    common_legend(figure, figure.axes)
    caption = f"Initial directions of the rod ({title(engine)}), laws side by side"
    yield Picture(figure, f"{caption}: Mollweide's projection, +x in the middle, +y to the right, +z up.")
