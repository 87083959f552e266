"""Simulate one scene in one engine, and keep what happened as a file, a video or a plot."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import tensegrity_mj.library as library
from tensegrity_mj import controllers, model, pictures, runs
from tensegrity_mj.basics.jsontext import plain_values
from tensegrity_mj.commands import common, experiment
from tensegrity_mj.commands.common import table
from tensegrity_mj.commands.render import FILM_OPTIONS, film_of
from tensegrity_mj.errors import DivergenceError, OptionError


def execute(options: argparse.Namespace) -> common.Outcome:
    """Check all options first; then simulate, and write what they name."""
    out, video, plot, web = options.out, options.video, options.plot, options.web
    if video is None:
        shown = ("speed", "thickness") if options.view else ()  # the window has these, too
        common.refuse(options, [name for name in FILM_OPTIONS if name not in shown], "needs --video FILE.mp4")
    since = Path(options.from_.rpartition("@")[0] or options.from_) if options.from_ else None
    common.distinct({"--replay": Path(options.replay) if options.replay else None, "--from": since, "--out": out})
    experiment.refuse_options_of_other_engines(options, (options.engine,))
    if options.replay is not None:
        common.refuse(options, ("law", *experiment.LAW_OPTIONS), "means nothing in a replay, which has no control law")
    experiment.check_control(options)
    if video:
        experiment.require_off_screen_opengl()
    if web:
        from tensegrity_mj.pictures.web import plotly_script

        plotly_script()
    if options.view:
        from tensegrity_mj.pictures.viewer import require_display

        require_display()

    scene = library.load_scene(options.scene)
    before = _before(options.from_, scene)
    if options.water_loads and scene.water is None:
        raise OptionError(f"--water-loads: scene '{scene.name}' has no water")
    if options.replay:
        law, actuation, duration = _replay_of(options)
    else:
        law, actuation, duration = experiment.law_of(options, scene), experiment.actuation_of(options), options.duration
    if before is not None:
        left = scene.start_time + scene.duration - float(before.time[-1])
        duration = duration or (left if left > 0 else None)
    held = actuation if before is None or options.actuation else None  # that of the run that goes on
    engine = experiment.engine_of(options.engine, options, duration or scene.duration)
    after = options.statistics
    begin = scene.start_time if before is None else float(before.time[-1])
    if after is not None and after >= begin + (duration or scene.duration):
        raise OptionError(f"--statistics {after:g}: the run ends before; make it longer, or begin earlier")
    try:
        run = experiment.simulated(options, before or scene, law, engine, held, duration, options.output_interval)
    except DivergenceError as error:
        if error.trajectory is None:
            raise
        run = replace(cast("runs.Trajectory", error.trajectory), status=runs.Status.DIVERGED, message=str(error))
    if out:
        run.save(out, options.water_loads and len(run.time) > 1)
    if not len(run.time):  # it diverged where it began: there is nothing to draw
        video = plot = web = None
    if plot:
        with common.for_paper(options.paper):
            pictures.plots.plot_run(run, plot)
    if video:
        pictures.render(run, video, progress=True, **film_of(options))
    if web:
        pictures.make_web_page(run).save(web)
    if options.view and len(run.time):
        pictures.play(run, options.speed or 1.0, thickness=bool(options.thickness))
    from tensegrity_mj.pictures.page import judgement_of_runs

    judgement = judgement_of_runs([run])
    common.warn_of_findings(judgement, simulated=True)
    data = summary(run) | {"out": out, "video": video, "plot": plot, "web": web}
    text = describe(data)
    if after is not None and (run.time >= after).sum() < 2:
        common.warn(f"--statistics {after:g}: the run ended at {begin + data['duration']:g} s: there are none")
        data["statistics"] = None
    elif after is not None:
        found = {name: run.statistics(name, after) for name in ("tension", "rod_force")}
        data["statistics"] = {"after": after, **{name: one.report() for name, one in found.items()}}
        text = "\n\n".join([text, *(repr(one) for one in found.values() if one.names)])
    return common.Outcome(data, text, common.code_of_status(run.status), judgement=judgement, warned=True)


def summary(run: runs.Trajectory) -> dict[str, Any]:
    """The numbers of one run, for --json."""
    duration = float(run.time[-1] - run.time[0]) if len(run.time) else 0.0
    wall_time = run.cost.get("wall_time", float("nan"))
    error = run.target_error()
    worst = ("max_force_density", "min_feasibility_margin", "energy_residual", "error_estimate")
    return plain_values(run, "status", "message", "engine", *worst, "cost", "reports") | {
        "scene": run.scene.name,
        "duration": duration,
        "samples": len(run.time),
        "final_error": float(error[-1]) if len(error) else float("nan"),
        "real_time_factor": duration / wall_time if wall_time else float("nan"),
        "wall_time": wall_time,
    }


def describe(data: dict[str, Any]) -> str:
    """Text of the numbers of one run."""
    rows = [
        ("status", data["status"] + (f": {data['message']}" if data["message"] else "")),
        ("engine", data["engine"]),
        ("simulated time", common.number(data["duration"], "s")),
        ("distance to the target at the end", common.number(data["final_error"], "m")),
        ("largest force density", common.number(data["max_force_density"], "N/m")),
        ("smallest feasibility margin", common.number(data["min_feasibility_margin"])),
        ("energy residual", common.number(data["energy_residual"], "J")),
        *([("largest node error, estimated", _error(data))] if "accuracy" in data["reports"] else []),
        *([("forces not unique", ", ".join(loose))] if (loose := data["reports"].get("undetermined_forces")) else []),
        *([("left out", left)] if (left := data["reports"].get("left_out")) else []),
        *(_flow(water) if (water := data["reports"].get("water")) else []),
        ("real-time factor", common.number(data["real_time_factor"])),
    ]
    rows += [(name, str(data[name])) for name in ("out", "video", "plot", "web") if data[name]]
    return table(rows)


def _before(path: str | None, scene: model.Scene) -> runs.Trajectory | None:
    """The run of --from, with the scene as it is now."""
    from tensegrity_mj.model.structure_checks import CONSTRAINT_TOLERANCE, size_of

    if path is None:
        return None
    file, _, time = ("", "", path) if Path(path).is_file() else path.rpartition("@")
    before = runs.Trajectory.load(file or time)
    if file:
        before = before.at(time)
    was, now = before.scene.structure, scene.structure
    if was.node_names != now.node_names:
        raise OptionError(f"--from {path}: a run of scene '{before.scene.name}', whose nodes are others")
    moved, limit = abs(was.positions - now.positions).max(axis=1), CONSTRAINT_TOLERANCE * size_of(now)
    if moved.max() > limit or was.rod_nodes.tolist() != now.rod_nodes.tolist():
        raise OptionError(
            f"--from {path}: a run of scene '{before.scene.name}', whose rods, or the places of its nodes, are others "
            f"(by up to {moved.max():.3g} m): a run goes on with the same ones"
        )
    return replace(before, scene=scene)


def _error(data: dict[str, Any]) -> str:
    """The estimate of an accuracy, with whether it can be relied on."""
    found = data["reports"]["accuracy"]
    doubt = "" if found["settled"] else ", not settled"
    return f"{common.number(found['error_estimate'], 'm')}{doubt} ({found['requested']:g} m requested)"


def _flow(found: dict[str, Any]) -> list[tuple[str, str]]:
    """The numbers of the flow around rods where there are any, and what is outside the ranges of coefficients."""
    from tensegrity_mj.model.elements.water_segments import count_text

    texts, rods = [count_text(found["segments"]), *found["notes"]], found["reynolds"] is not None
    if rods:
        text = f"Rn up to {found['reynolds']:.3g}"
        if found["keulegan_carpenter"] is not None:
            text += ", KC {:.3g} to {:.3g}".format(*found["keulegan_carpenter"])
        texts = [text, *texts]
    return [("flow across rods" if rods else "water", "; ".join(texts))]


def _replay_of(options: argparse.Namespace) -> tuple[Any, model.Actuation, float | None]:
    """Law, actuation and duration of a recorded run, unless options say otherwise."""
    from tensegrity_mj.dynamics.native.law import Command
    from tensegrity_mj.model.actuation import Mode

    recorded = runs.Trajectory.load(options.replay)
    if len(recorded.time) < 2:
        raise OptionError(
            f"--replay {options.replay}: it holds {len(recorded.time)} samples; a replay needs two or more"
        )
    quantity = Command.FORCE_DENSITY if options.replay_quantity == "force-density" else Command.REST_LENGTH
    law = controllers.Replay.of_run(recorded, quantity)
    actuation = experiment.actuation_of(options)
    if law.held and options.actuation is None:
        was = recorded.provenance["actuation"]
        actuation = model.Actuation(Mode(was["mode"]), was["period"])
    return law, actuation, options.duration or float(recorded.time[-1])
